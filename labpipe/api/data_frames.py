"""Make pandas tables of one test (results, budgets, curves, notes, recordings) and of many tests.

Tables of results have a column ``unit``. Units of other tables are in ``frame.attrs["units"]``.
"""

from __future__ import annotations

import os
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pandas as pd

from labpipe.errors import (
    LabpipeError,
    StoreError,
    UsageError,
    describe_system_error,
    sort_by_likeness,
)
from labpipe.process.output_paths import RESULT_FILE, find_results, list_files_below
from labpipe.report.wording import Scale, choose_unit
from labpipe.store.layout import UNSTATED_UNIT
from labpipe.store.replace import is_unfinished
from labpipe.store.summaries import SUMMARY_FILE, read_summary
from labpipe.units import get_conversion_factor

if TYPE_CHECKING:
    from labpipe.records.curve import Curve
    from labpipe.records.group import Group, GroupNumber
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

    def choose_result_scale(self, name: str, unit: str) -> Scale:
        """Choose the unit of a result, or of its change, and the factor from the SI unit."""
        if self.display is None:
            return Scale(1.0, unit)
        return choose_unit(name, unit, self.display)

    def choose_quantity_scale(self, quantity: str, unit: str) -> Scale:
        """Choose the unit of a quantity such as ``force``, and the factor from the SI unit."""
        target = unit if self.display is None else self.display.get(quantity, unit)
        return Scale(1.0 / get_conversion_factor(target, unit), target)


def _make_frame(types: Mapping[str, str], rows: Iterable[Sequence[object]]) -> pd.DataFrame:
    """Make a table from rows; None in a float64 column becomes NaN.

    Parameters
    ----------
    types : types of the columns, keyed by name
    rows : values of each row in the order of the columns
    """
    return pd.DataFrame(list(rows), columns=list(types)).astype(dict(types))


_VALUE_TYPES = {
    **dict.fromkeys(("value", "estimate", "lower", "upper"), "float64"),
    **dict.fromkeys(("unit", "status", "code", "reason"), "str"),
}
"""Types of the columns of a result, except its name, keyed by column."""
_BUDGET_TYPES = {"cause": "str", "change": "float64", "share": "float64", "is_common": "bool"}
"""Types of the columns of a budget, keyed by column."""
_NOTE_TYPES = dict.fromkeys(("code", "severity", "where", "message"), "str")
"""Types of the columns of quality notes, keyed by column."""


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
    if there is no reason; several codes are separated by commas).
    """

    def make_row(result: Result) -> list[object]:
        """Make the row of a result, with None for values that are not available."""
        factor, unit = units.choose_result_scale(result.name, result.unit)
        ends = (result.interval.lower, result.interval.upper) if result.interval else (None, None)
        values = (result.value, result.best_estimate, *ends)
        scaled_values = [None if value is None else value * factor for value in values]
        texts = [unit, result.status, ", ".join(result.codes), result.reason_text]
        return [result.name, *scaled_values, *texts]

    types = {"name": "str", **_VALUE_TYPES}
    return _make_frame(types, map(make_row, results)).set_index("name")


def make_budget_frame(result: Result, units: Units) -> pd.DataFrame:
    """Make a table of the contributions to the interval of a result.

    Parameters
    ----------
    result : result with or without a budget
    units : units of the values

    Returns
    -------
    Table with index ``cause`` and columns ``change`` (change of the result by one standard
    uncertainty of the cause), ``share`` (fraction of the variance) and ``is_common`` (whether the
    cause is common to all tests of a rig). The table is empty if the result has no budget.
    """
    factor, unit = units.choose_result_scale(result.name, result.unit)
    rows = [
        (contribution.cause, factor * contribution.change, share, contribution.is_common)
        for contribution, share in zip(result.budget, result.fractions, strict=True)
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
        "displacement": units.choose_quantity_scale("displacement", "m"),
        "force": units.choose_quantity_scale("force", "N"),
    }
    columns = {name: scale.factor * getattr(curve, name) for name, scale in scales.items()}
    branch, cycle = curve.assign_samples()
    frame = pd.DataFrame(columns | {"branch": branch, "cycle": cycle})
    frame.attrs["units"] = {name: scale.unit for name, scale in scales.items()}
    return frame


def make_position_frame(
    time: np.ndarray, names: Sequence[str], positions: np.ndarray, kind: str, unit: str
) -> pd.DataFrame:
    """Make a table of positions.

    Parameters
    ----------
    time : shape (n_frames,), s
    names : name of each point
    positions : shape (n_frames, n_points, 3), in `unit`; NaN for a missing point
    kind : kind of the points, ``point`` or ``marker``
    unit : unit of the positions

    Returns
    -------
    Table with index ``time`` and columns (kind, axis) for x, y and z of each point.
    """
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
    ``<role>/<body>`` with x, y, z, the quaternion qx, qy, qz, qw, and error. Indexing with an
    unknown name raises a `UsageError`.

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
        arguments = tracks.time, tracks.names, tracks.positions, "marker", "m"
        yield name, partial(make_position_frame, *arguments)
        for body in tracks.bodies:
            yield f"{role}/{body.name}", partial(_make_body_frame, tracks, body)


def _make_channel_frame(recording: Recording, clock_name: str) -> pd.DataFrame:
    """Make a table of the channels of a clock; a channel without a unique name has its path."""
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


PathLike: TypeAlias = str | os.PathLike[str]
"""Path of a file or a folder."""
Paths: TypeAlias = PathLike | Iterable[PathLike]
"""One path or several."""


def parse_path(location: PathLike) -> Path:
    """Convert a location to a path that the system accepts, even if no file exists.

    Parameters
    ----------
    location : path of a file or a folder

    Raises
    ------
    UsageError
        If the system refuses the path, for example because it is too long, contains a zero byte, or
        leads into a folder without access.
    """
    path = Path(location)
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return path  # the caller reports missing files
    except OSError as error:
        raise UsageError(describe_system_error(error)) from error
    except ValueError as error:
        raise UsageError.about("api.no_path", repr(os.fspath(location)), found=error) from error
    return path


def parse_paths(locations: Paths) -> list[Path]:
    """Convert one location or several to paths.

    Parameters
    ----------
    locations : path of a file or a folder, or a list of paths

    Raises
    ------
    UsageError
        If the list is empty, or the system refuses a path.
    """
    location_list = [locations] if isinstance(locations, str | os.PathLike) else list(locations)
    if not location_list:
        raise UsageError.about("api.no_folders", "folder")
    return [parse_path(location) for location in location_list]


def parse_fields(by: str | Sequence[str]) -> tuple[str, ...]:
    """Convert the name of one field, or the names of several, to a tuple of names."""
    return (by,) if isinstance(by, str) else tuple(by)


_TEST_COLUMNS = ("protocol", "date", "operator", "folder")
"""Columns of a test after the fields of its specimen."""


class LeftOutWarning(UserWarning):
    """Warning that a table lacks some tests because their summaries cannot be read."""


def table(folder: Paths, *, by: str | Sequence[str] = ()) -> pd.DataFrame:
    """Put the results of processed tests into one table.

    Parameters
    ----------
    folder : folder with processed tests at any depth, or several such folders
    by : field or fields of the test sheets, whose columns follow ``test`` and which sort the rows

    Returns
    -------
    Table with a row for each result of each test. Its columns are ``test``; the fields of the
    sheets (``type``, ``spool``, ``sample``, dimensions in m as float64, fields of a bundle, labels,
    observations; a label or observation with the name of another column is ``label_<name>``);
    ``protocol``, ``date`` (datetime64), ``operator``, ``folder``; ``result`` (name of the result),
    ``value``, ``estimate``, ``lower``, ``upper`` (SI, float64, NaN if not available), ``unit``,
    ``status``, ``code``, ``reason``. A missing field is NaN, a missing date NaT.
    ``attrs["left_out"]`` has the reason for each test that is left out, keyed by folder.

    Raises
    ------
    UsageError
        If a folder has no processed test, or a field of `by` is in no sheet.
    StoreError
        If no summary can be read.

    Warns
    -----
    LeftOutWarning
        If some summaries cannot be read.

    Examples
    --------
    >>> labpipe.table("processed/A2", by=["type", "length"])  # doctest: +SKIP
    """
    by_fields = parse_fields(by)
    tests, failure_reasons = _read_summaries(_find_summaries(parse_paths(folder)))
    names = dict.fromkeys(name for test, _ in tests for name in test if name not in _TEST_COLUMNS)
    sheet_fields = [name for name in names if name != "test"]
    for field in by_fields:
        if field not in sheet_fields:
            valid_fields = ", ".join(sort_by_likeness(field, sheet_fields))
            raise UsageError.about("api.no_field", "by", fields=valid_fields, found=field)
    column_names = dict.fromkeys(("test", *by_fields, *names, *_TEST_COLUMNS))
    columns = {name: [test.get(name) for test, _ in tests] for name in column_names}
    n_results = [len(results) for _, results in tests]
    frame = pd.DataFrame({name: _make_column(name, values) for name, values in columns.items()})
    frame = frame.loc[np.repeat(np.arange(len(tests)), n_results)].reset_index(drop=True)
    all_results = (result for _, results in tests for result in results)
    frame = frame.join(_make_frame({"result": "str", **_VALUE_TYPES}, all_results))
    if by_fields:
        frame = frame.sort_values(list(by_fields), kind="stable", ignore_index=True)
    frame.attrs["left_out"] = failure_reasons
    return frame


def _find_summaries(folders: Sequence[Path]) -> list[Path]:
    """Find the summaries of processed tests; those without a result file are ignored."""
    summaries: dict[Path, None] = {}
    for folder in folders:
        files = list_files_below(folder, SUMMARY_FILE) if folder.is_dir() else []
        files = [file for file in files if (file.parent / RESULT_FILE).exists()]
        if not files:
            found = "none" if folder.is_dir() else "a file" if folder.exists() else "nothing there"
            raise UsageError.about("api.no_tests", folder, found=found)
        summaries |= dict.fromkeys(files)
    return list(summaries)


_TestCells: TypeAlias = tuple[dict[str, Any], list[list[object]]]
"""Cells of a test, keyed by column, and the list of cells of each result."""


def _read_summaries(files: Iterable[Path]) -> tuple[list[_TestCells], dict[str, str]]:
    """Read summaries; also return the reason of each failure, keyed by folder."""
    tests: list[_TestCells] = []
    failure_reasons: dict[str, str] = {}
    for file in files:
        try:
            tests.append(_read_test(file))
        except LabpipeError as error:
            failure_reasons[str(file.parent)] = str(error)
    if not tests:
        raise StoreError("\n".join(failure_reasons.values()))
    if failure_reasons:
        warnings.warn("\n".join(failure_reasons.values()), LeftOutWarning, stacklevel=3)
    return tests, failure_reasons


def _read_test(file: Path) -> _TestCells:
    """Read the cells of a test and of its results from its summary."""
    if is_unfinished(file.parent):
        raise StoreError.about("api.cut_off", file, folder=file.parent)
    content = read_summary(file)
    try:
        date_text = content.get("date")
        test_cells = {
            "test": str(content["test"]),
            **_list_fields(content["specimen"]),
            "protocol": str(content["protocol"]),
            "date": date.fromisoformat(date_text) if date_text else None,
            "operator": str(content.get("operator") or ""),
            "folder": str(file.parent),
        }
        return test_cells, [_parse_result(entry) for entry in content["results"]]
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise StoreError.about("api.damaged_summary", file, found=error) from error


def _list_fields(specimen: Mapping[str, Any]) -> dict[str, Any]:
    """List the fields of a specimen as cells, keyed by column, without the wires of a bundle."""
    simple_fields = {name: value for name, value in specimen.items() if not isinstance(value, dict)}
    bundle = dict(specimen.get("bundle", {}))
    bundle_fields = {name: value for name, value in bundle.items() if not isinstance(value, list)}
    other_columns = ("test", "result", *_TEST_COLUMNS, *_VALUE_TYPES)
    reserved_names = {*simple_fields, *bundle_fields, *other_columns}
    labels = {
        f"label_{name}" if name in reserved_names else str(name): str(text)
        for key in ("labels", "observed")
        for name, text in dict(specimen.get(key, {})).items()
    }
    return simple_fields | bundle_fields | labels


def _parse_result(entry: Mapping[str, Any]) -> list[object]:
    """Convert a result of a summary to the cells of a row; None for a missing number."""
    numbers = [
        entry[name] for name, column_type in _VALUE_TYPES.items() if column_type == "float64"
    ]
    texts = [str(entry[name]) for name, column_type in _VALUE_TYPES.items() if column_type == "str"]
    return [str(entry["name"]), *(None if x is None else float(x) for x in numbers), *texts]


def _make_column(name: str, values: Sequence[Any]) -> pd.Series:
    """Make a column: dates in ``date``, numbers if all present values are numbers, otherwise texts.

    Missing values are None in `values`, and NaN or NaT in the column.
    """
    if name == "date":
        return pd.Series(pd.to_datetime(pd.Series(values, dtype="object")))
    known_values = [value for value in values if value is not None]
    is_number = bool(known_values) and all(isinstance(x, int | float) for x in known_values)
    return pd.Series(values, dtype="float64" if is_number else "str")


def groups(
    folder: Paths, *, by: str | Sequence[str] = (), say: Callable[[str], None] = lambda _: None
) -> pd.DataFrame:
    """Group processed tests as ``labpipe report`` does, with means and intervals.

    Parameters
    ----------
    folder : folder with processed tests at any depth, or several such folders
    by : field or fields of the test sheets, whose values make the groups; if empty, the fields by
        which a report groups tests
    say : function that is called with the folder name of each test before it is read

    Returns
    -------
    Table with a row for each result of each group. Its columns are ``group``, ``protocol``,
    ``result``, ``mean``, ``estimate`` (mean without the contribution of noise), ``lower``,
    ``upper`` (95 % interval of the estimate), ``deviation`` (standard deviation of the averaged
    values; all in SI, float64), ``n`` (number of averaged values: samples, or means of spools),
    ``tests`` (number of tests whose result is averaged), ``unit``, ``how`` (which values are
    averaged, and why), ``reason`` (why there is no interval; otherwise empty).
    ``attrs["left_out"]`` has the reason for each test that cannot be used, keyed by file; rejected
    tests are not in it.

    Raises
    ------
    LabpipeError
        If there is no processed test, none can be read, all are rejected, two have the same name,
        or a field of `by` is in no test sheet.
    """
    # This import takes half a second.
    from labpipe.campaign.reporting import ReportOptions, make_campaign, read_tests

    tests = read_tests(find_results(parse_paths(folder)), say)
    campaign = make_campaign(tests, "", ReportOptions(by=parse_fields(by)))
    rows = [_make_group_row(group, result) for group in campaign.groups for result in group.numbers]
    frame = _make_frame(_GROUP_TYPES, rows)
    frame.attrs["left_out"] = dict(campaign.failures)
    return frame


_GROUP_TYPES = {
    **dict.fromkeys(("group", "protocol", "result"), "str"),
    **dict.fromkeys(("mean", "estimate", "lower", "upper", "deviation"), "float64"),
    **dict.fromkeys(("n", "tests"), "int64"),
    **dict.fromkeys(("unit", "how", "reason"), "str"),
}
"""Types of the columns of a result of a group, keyed by column."""


def _make_group_row(group: Group, result: GroupNumber) -> list[object]:
    """Make the row of one result of a group, with the cells of `_GROUP_TYPES`."""
    mean, n_tests, unit = result.mean.chosen, len(result.values), result.unit
    names = [group.name, group.protocol, result.name]
    if not n_tests:
        return [*names, *[np.nan] * 5, 0, 0, unit, "", "no test has this result"]
    ends = (mean.interval.lower, mean.interval.upper) if mean.interval else (np.nan, np.nan)
    values = [mean.mean, mean.middle, *ends, mean.deviation, mean.n, n_tests]
    return [*names, *values, unit, str(result.mean.decision), str(mean.reason or "")]
