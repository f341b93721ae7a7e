"""Make pandas tables of results, curves, shapes and recordings.

Units are in ``frame.attrs["units"]``, keyed by column, or in a column ``unit``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from labpipe.errors import UsageError, sort_by_likeness
from labpipe.report.wording import Scale, find_display_unit
from labpipe.store.layout import UNSTATED_UNIT
from labpipe.units import get_conversion_factor

if TYPE_CHECKING:
    from collections.abc import Callable

    from labpipe.records.curve import Curve, Shape
    from labpipe.records.quality import QualityNote
    from labpipe.records.recording import MarkerTracks, Recording, RigidBody
    from labpipe.records.result import Result

_AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Units:
    """Units of the values in tables.

    Parameters
    ----------
    display : display units of a protocol, keyed by quantity; None for SI
    """

    display: Mapping[str, str] | None = None

    def scale_result(self, name: str, unit: str) -> Scale:
        """Choose factor and unit of a result, or of a change of it."""
        if self.display is None:
            return Scale(1.0, unit)
        return find_display_unit(name, unit, self.display)

    def scale_quantity(self, quantity: str, unit: str) -> Scale:
        """Choose factor and unit of a quantity, such as ``force``."""
        target = unit if self.display is None else self.display.get(quantity, unit)
        return Scale(1.0 / get_conversion_factor(target, unit), target)


def _make_frame(columns: Mapping[str, str], rows: Iterable[Sequence[object]]) -> pd.DataFrame:
    """Make a table from rows; None in a float64 column becomes NaN.

    Parameters
    ----------
    columns : types of the columns, keyed by name
    rows : values of each row in the order of the columns
    """
    return pd.DataFrame(list(rows), columns=list(columns)).astype(dict(columns))


_RESULT_TYPES = {
    "name": "str",
    **dict.fromkeys(("value", "estimate", "lower", "upper"), "float64"),
    **dict.fromkeys(("unit", "status", "code", "reason"), "str"),
}
_BUDGET_TYPES = {"cause": "str", "change": "float64", "share": "float64", "is_common": "bool"}
_NOTE_TYPES = dict.fromkeys(("code", "severity", "where", "message"), "str")


def make_results_frame(results: Iterable[Result], units: Units) -> pd.DataFrame:
    """Make a table of results.

    Parameters
    ----------
    results : results of one test
    units : units of the values

    Returns
    -------
    Table with index ``name`` and columns ``value``, ``estimate``, ``lower``, ``upper`` (float64,
    NaN if not available), ``unit``, ``status``, ``code``, ``reason`` (text; the last two are empty
    if there is no reason).
    """

    def make_row(result: Result) -> list[object]:
        factor, unit = units.scale_result(result.name, result.unit)
        ends = (result.interval.lower, result.interval.upper) if result.interval else (None, None)
        values = (result.value, result.best_estimate, *ends)
        scaled_values = [np.nan if value is None else value * factor for value in values]
        texts = [unit, result.status, ", ".join(result.codes), result.reason_text]
        return [result.name, *scaled_values, *texts]

    return _make_frame(_RESULT_TYPES, map(make_row, results)).set_index("name")


def make_budget_frame(result: Result, units: Units) -> pd.DataFrame:
    """Make a table of the contributions to the interval of a result.

    Parameters
    ----------
    result : result with or without a budget
    units : units of the values

    Returns
    -------
    Table with index ``cause`` and columns ``change`` (by one standard uncertainty of the cause, in
    the unit of the result), ``share`` (of the variance) and ``is_common`` (to all tests of a rig).
    It is empty without a budget.
    """
    factor, unit = units.scale_result(result.name, result.unit)
    rows = [
        (contribution.cause, factor * contribution.change, share, contribution.is_common)
        for contribution, share in zip(result.budget, result.shares, strict=True)
    ]
    frame = _make_frame(_BUDGET_TYPES, rows).set_index("cause")
    frame.attrs["units"] = {"change": unit, "share": "1"}
    return frame


def make_curve_frame(curve: Curve, units: Units) -> pd.DataFrame:
    """Make a table of a curve.

    Parameters
    ----------
    curve : curve of one test
    units : units of the values

    Returns
    -------
    Table with columns ``time``, ``displacement``, ``force`` (float64), ``branch`` (int64, counted
    from 0; -1 outside of every branch) and ``cycle`` (int64, counted from 1; 0 outside of every
    cycle).
    """
    scales = {
        "time": Scale(1.0, curve.time_unit),
        "displacement": units.scale_quantity("displacement", "m"),
        "force": units.scale_quantity("force", "N"),
    }
    columns = {name: scale.factor * getattr(curve, name) for name, scale in scales.items()}
    branch, cycle = curve.assign_samples()
    frame = pd.DataFrame(columns | {"branch": branch, "cycle": cycle})
    frame.attrs["units"] = {name: scale.unit for name, scale in scales.items()}
    return frame


def make_shape_frame(shape: Shape, units: Units) -> pd.DataFrame:
    """Make a table of positions along the specimen.

    Parameters
    ----------
    shape : shape of one test
    units : units of the values

    Returns
    -------
    Table with index ``time`` (s) and a column (point, axis) for x, y and z of the clamped end, of
    each marker and of the pull point, in the specimen frame; NaN if a marker is missing.
    """
    factor, unit = units.scale_quantity("displacement", "m")
    return _make_position_frame(shape.time, shape.names, factor * shape.positions, "point", unit)


def _make_position_frame(
    time: np.ndarray, names: tuple[str, ...], positions: np.ndarray, kind: str, unit: str
) -> pd.DataFrame:
    """Make a table of positions, shape (frames, names, 3), with columns (kind, axis)."""
    columns = pd.MultiIndex.from_product([names, _AXES], names=[kind, "axis"])
    index = pd.Index(time, name="time")
    frame = pd.DataFrame(positions.reshape(len(time), -1), index=index, columns=columns)
    frame.attrs["units"] = {"time": "s", "position": unit}
    return frame


def make_quality_frame(notes: Iterable[QualityNote]) -> pd.DataFrame:
    """Make a table of quality notes with columns ``code``, ``severity``, ``where``, ``message``.

    Parameters
    ----------
    notes : quality notes of one test or export
    """
    rows = [[getattr(note, name) for name in _NOTE_TYPES] for note in notes]
    return _make_frame(_NOTE_TYPES, rows)


class Recordings(Mapping[str, pd.DataFrame]):
    """Recordings of a test as tables, keyed by name.

    The name is usually the role of the export, such as ``force``, and the table has the channels of
    the export, with index ``time``. An export with several clocks, or with clocks and markers, has
    a table ``<role>/<clock>`` for each clock. Markers have a table with columns (marker, axis),
    which is named ``<role>/markers`` if the export has clocks, too. Each rigid body has a table
    ``<role>/<body>`` with x, y, z, the quaternion qx, qy, qz, qw, and error. An unknown name raises
    a `UsageError`.

    Parameters
    ----------
    recordings : recordings, keyed by role
    """

    def __init__(self, recordings: Mapping[str, Recording]) -> None:
        self._tables = {
            name: make_table
            for role, recording in recordings.items()
            for name, make_table in _list_tables(role, recording)
        }

    def __getitem__(self, name: str) -> pd.DataFrame:
        if not self._tables:
            raise UsageError.about("api.no_recordings", "raw")
        if name not in self._tables:
            names = ", ".join(sort_by_likeness(name, list(self._tables)))
            raise UsageError.about("api.no_recording", "raw", name=name, names=names)
        return self._tables[name]()

    def get(self, name: str, default: Any = None, /) -> Any:
        """Return the table of a name, or a default if there is none."""
        return self._tables[name]() if name in self._tables else default

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)

    def __contains__(self, name: object) -> bool:
        return name in self._tables

    def __repr__(self) -> str:
        return f"<labpipe recordings: {', '.join(self._tables) or 'none'}>"

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._tables)


def _list_tables(
    role: str, recording: Recording
) -> Iterator[tuple[str, Callable[[], pd.DataFrame]]]:
    """Yield the names of the tables of a recording, and functions that make them."""
    tracks = recording.markers
    is_single = len(recording.clocks) == 1 and tracks is None
    for clock in recording.clocks:
        name = role if is_single else f"{role}/{clock.name}"
        yield name, partial(_make_channel_frame, recording, clock.name)
    if tracks is not None:
        name = f"{role}/markers" if recording.clocks else role
        positions = tracks.time, tracks.names, tracks.positions, "marker", "m"
        yield name, partial(_make_position_frame, *positions)
        for body in tracks.bodies:
            yield f"{role}/{body.name}", partial(_make_body_frame, tracks, body)


def _make_channel_frame(recording: Recording, clock_name: str) -> pd.DataFrame:
    """Make a table of the channels of a clock; a repeated name is replaced by the path."""
    clock = recording.get_clock(clock_name)
    channels = [channel for channel in recording.channels if channel.clock == clock_name]
    counts = Counter(channel.name for channel in channels)
    columns_by_name = {
        channel.name if counts[channel.name] == 1 else channel.path: channel for channel in channels
    }
    columns = {name: channel.values for name, channel in columns_by_name.items()}
    frame = pd.DataFrame(columns, index=pd.Index(clock.time, name="time"))
    units = {name: channel.unit or UNSTATED_UNIT for name, channel in columns_by_name.items()}
    frame.attrs["units"] = {"time": clock.unit} | units
    return frame


def _make_body_frame(tracks: MarkerTracks, body: RigidBody) -> pd.DataFrame:
    """Make a table of position, rotation and error of a rigid body."""
    values = np.column_stack([body.position, body.rotation, body.error])
    names = [*_AXES, "qx", "qy", "qz", "qw", "error"]
    frame = pd.DataFrame(values, index=pd.Index(tracks.time, name="time"), columns=names)
    units = {name: "1" if name.startswith("q") else "m" for name in names}
    frame.attrs["units"] = {"time": "s"} | units
    return frame
