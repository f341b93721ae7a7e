"""Reading of result files: HDF5 to TestResult, fully checked."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import date
from math import isnan
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import (
    Aligned,
    Branch,
    ClockFit,
    Curve,
    FittedLine,
    Interval,
    Series,
    Shape,
    Slip,
    SlipDecision,
)
from labpipe.records.figure_data import DrawnLaw, DrawnShapes
from labpipe.records.recording import Recording
from labpipe.records.result import (
    Contribution,
    InputFile,
    Instrument,
    Result,
    Specimen,
    Status,
    TestResult,
)
from labpipe.store import layout
from labpipe.store.datasets import array, array_rows, arrays, opened, rows, strings, text, texts
from labpipe.store.hdf5_objects import get_number, has_attribute
from labpipe.store.stored_parts import (
    read_bending,
    read_notes,
    read_reasons,
    read_recording,
    read_specimen,
)

_R = TypeVar("_R")


@dataclass(frozen=True, slots=True, eq=False)
class RawTest:
    """The content of a result file before processing: sufficient to process the test again.

    Parameters
    ----------
    test : name of the test
    specimen : what was tested
    protocol : name of the protocol
    protocol_yaml : the resolved protocol
    test_yaml : the test sheet as written
    labpipe_version : the version that wrote the file
    inputs : the exports, with their fingerprints
    recordings : by role
    """

    test: str
    specimen: Specimen
    protocol: str
    protocol_yaml: str
    test_yaml: str
    labpipe_version: str
    inputs: tuple[InputFile, ...]
    recordings: Mapping[str, Recording]


def read_result(path: Path) -> TestResult:
    """Read a complete result file.

    Parameters
    ----------
    path : a file that `write_result` made

    Returns
    -------
    The test; arrays are read-only.

    Raises
    ------
    StoreError
        If the file is none of labpipe's, of a newer schema, truncated or damaged.
    """
    with opened(path) as root:
        shape = _shape(root[layout.SHAPE]) if layout.SHAPE in root else None
        bending = read_bending(root[layout.BENDING]) if layout.BENDING in root else None
        return TestResult(
            **_head(root),
            **_outcome(root),
            aligned=_aligned(root),
            shape=shape,
            bending=bending,
        )


def read_outcome(path: Path) -> TestResult:
    """Read the parts of a result file for a report: curve and results, no recordings or shapes.

    Parameters
    ----------
    path : a file that `write_result` made

    Returns
    -------
    The test with empty recordings; the aligned signals only if slips were repaired, to show the
    measured force.

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with opened(path) as root:
        return _read_reported(root)


@dataclass(frozen=True, slots=True, eq=False)
class Drawable:
    """The parts of a result file for a report.

    Parameters
    ----------
    result : as from `read_outcome`
    shapes : at the chosen frames; None without shapes
    law : None without a measured law
    """

    result: TestResult
    shapes: DrawnShapes | None
    law: DrawnLaw | None


def read_drawable(
    path: Path, choose: Callable[[TestResult, Floats], tuple[Ints, Floats]]
) -> Drawable:
    """Read the parts of a result file for a report: outcome, few shapes and measured law.

    Parameters
    ----------
    path : a file that `write_result` made
    choose : function of the outcome and the times of all frames, s; returns the wanted frames, in
        order, and their deflections, m

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with opened(path) as root:
        result = _read_reported(root)
        return Drawable(result, _read_drawn_shapes(root, result, choose), _read_drawn_law(root))


def _read_drawn_shapes(
    root: Any, result: TestResult, choose: Callable[[TestResult, Floats], tuple[Ints, Floats]]
) -> DrawnShapes | None:
    if layout.SHAPE not in root:
        return None
    group, fields = root[layout.SHAPE], layout.SHAPE_FIELDS
    frames, deflection = choose(result, array(group, "time", fields["time"]))
    places = array_rows(group, "positions", fields["positions"], frames)
    return DrawnShapes(deflection, places[:, :, :2])


def _read_drawn_law(root: Any) -> DrawnLaw | None:
    group = root.get(f"{layout.BENDING}/{layout.LAW}")
    if group is None:
        return None
    names = ("curvature", "moment", "moment_lower", "moment_upper")
    return DrawnLaw(**arrays(group, {name: layout.LAW_FIELDS[name] for name in names}))


def _read_reported(root: Any) -> TestResult:
    """Return the outcome, with the aligned signals only if slips were repaired."""
    outcome = _outcome(root)
    is_repaired = any(slip.decision is SlipDecision.REPAIRED for slip in outcome["slips"])
    aligned = _aligned(root) if is_repaired else None
    return TestResult(**_head(root, raw=False), **outcome, aligned=aligned, shape=None)


def read_stages(path: Path) -> TestResult:
    """Read the stages of processing: aligned signals, shapes and outcome, no recordings.

    Parameters
    ----------
    path : a file that `write_result` made

    Returns
    -------
    The test with empty recordings, and without its measured moment-curvature.

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with opened(path) as root:
        shape = _shape(root[layout.SHAPE]) if layout.SHAPE in root else None
        head = _head(root, raw=False)
        return TestResult(**head, **_outcome(root), aligned=_aligned(root), shape=shape)


def read_raw(path: Path) -> RawTest:
    """Read the parts needed to process a test again without its exports.

    Parameters
    ----------
    path : a file that `write_result` made

    Returns
    -------
    The recordings with the protocol, the test sheet and the fingerprints of the exports.

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with opened(path) as root:
        return RawTest(**_head(root))


def read_name(path: Path) -> str:
    """Read the name of the test only.

    Parameters
    ----------
    path : a file that `write_result` made

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with opened(path) as root:
        return text(root, "test")


def read_run(path: Path) -> str:
    """Read the key of the run only.

    Parameters
    ----------
    path : a file that `write_result` made

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with opened(path) as root:
        return text(root, layout.RUN)


def _head(root: Any, *, raw: bool = True) -> dict[str, Any]:
    """Read the fields that `TestResult` and `RawTest` share."""
    group = root[layout.RAW]
    roles = texts(group, "roles") if raw else ()
    return {
        **{name: text(root, name) for name in layout.ROOT_TEXTS},
        "specimen": read_specimen(root),
        "inputs": _inputs(group),
        "recordings": {role: read_recording(group[role]) for role in roles},
    }


def _outcome(root: Any) -> dict[str, Any]:
    """Read the outcome of processing: curve and numbers."""
    curve, display = root.get(layout.CURVE), json.loads(text(root, layout.DISPLAY))
    return {
        "curve": None if curve is None else _curve(curve),
        "results": _results(root),
        "quality": read_notes(root[layout.QUALITY]),
        "display": {str(key): str(unit) for key, unit in display.items()},
        "run": text(root, layout.RUN),
        "figures": texts(root, layout.FIGURES),
        "slips": _records(Slip, rows(curve or {}, layout.SLIPS, layout.SLIP_TABLE)),
        "lines": _records(FittedLine, rows(curve or {}, layout.LINES, layout.LINE_TABLE)),
        **_circumstances(root),
    }


def _circumstances(root: Any) -> dict[str, Any]:
    """Read operator, date and instruments of the test."""
    day = text(root, layout.DATE)
    return {
        "date": date.fromisoformat(day) if day else None,
        "operator": text(root, layout.OPERATOR),
        "instruments": tuple(
            _instrument(row) for row in rows(root, layout.INSTRUMENTS, layout.INSTRUMENT_TABLE)
        ),
    }


def _instrument(row: Mapping[str, Any]) -> Instrument:
    return Instrument(
        channel=row["channel"],
        measures=tuple(row["measures"].split(", ")),
        certificate=row["certificate"],
        calibrated=date.fromisoformat(row["calibrated"]),
        due=date.fromisoformat(row["due"]) if row["due"] else None,
        uncertainty=None if isnan(row["uncertainty"]) else row["uncertainty"],
        k=row["k"],
    )


def _inputs(raw: Any) -> tuple[InputFile, ...]:
    inputs: dict[int, InputFile] = {}
    for role, group in raw.items():
        rows = zip(
            group.attrs[layout.INPUT_ORDER],
            texts(group, "file"),
            texts(group, "sha256"),
            group.attrs["bytes"],
            strict=True,
        )
        inputs |= {int(i): InputFile(role, file, sha, int(size)) for i, file, sha, size in rows}
    return tuple(inputs[number] for number in sorted(inputs))


def _aligned(root: Any) -> Aligned | None:
    if layout.ALIGNED not in root:
        return None
    group = root[layout.ALIGNED]
    series = {
        text(group[name], "name"): Series(
            array(group, name, layout.SERIES), text(group[name], "unit")
        )
        for name in texts(group, "series")
    }
    fit = _clock_fit(group) if layout.EVENTS in group else None
    time = array(group, layout.TIME, layout.CLOCK_TIME)
    return Aligned(time, series, fit, text(group[layout.TIME], "unit"))


def _clock_fit(group: Any) -> ClockFit:
    return ClockFit(
        offset=float(group.attrs["offset"]),
        drift=float(group.attrs["drift"]),
        offset_interval=_interval(group, "offset_"),
        drift_interval=_interval(group, "drift_"),
        residual=float(group.attrs["residual"]),
        **arrays(group[layout.EVENTS], layout.EVENT_FIELDS),
        method=text(group, "method"),
    )


def _interval(group: Any, prefix: str = "") -> Interval:
    return Interval(*(get_number(group, prefix + end) for end in layout.INTERVAL_NUMBERS))


def _curve(group: Any) -> Curve:
    time_unit = text(group[layout.TIME], "unit")
    return Curve(
        time=array(group, layout.TIME, layout.CLOCK_TIME),
        **arrays(group, layout.CURVE_FIELDS),
        branches=_records(Branch, rows(group, layout.BRANCHES, layout.BRANCH_TABLE, time_unit)),
        time_unit=time_unit,
    )


def _records(record_type: type[_R], table: Iterable[Any]) -> tuple[_R, ...]:
    """Convert the rows of a table to records."""
    hints = get_type_hints(record_type).items()
    return tuple(record_type(**{key: _cell(row, key, of) for key, of in hints}) for row in table)


def _cell(row: Any, name: str, cell_type: Any) -> object:
    """Return one field of a record; ``drop_interval`` is in ``drop_lower`` and ``drop_upper``."""
    if cell_type is Interval:
        ends = (f"{name.removesuffix('_interval')}_{end}" for end in ("lower", "upper"))
        return Interval(*(row[end] for end in ends))
    return cell_type(row[name])


def _shape(group: Any) -> Shape:
    return Shape(
        **arrays(group, layout.SHAPE_FIELDS),
        names=strings(group, layout.NAMES, "point"),
        length=float(group.attrs["length"]),
    )


def _results(root: Any) -> tuple[Result, ...]:
    group, budgets = root[layout.RESULTS], _budgets(root)
    return tuple(
        _result(name, group[name], tuple(budgets.get(name, ()))) for name in texts(group, "order")
    )


def _budgets(root: Any) -> dict[str, list[Contribution]]:
    """Return the rows of the budgets by result."""
    budgets: dict[str, list[Contribution]] = {}
    for row in rows(root, layout.BUDGETS, layout.BUDGET_TABLE):
        contribution = Contribution(row["cause"], row["change"], bool(row["is_common"]))
        budgets.setdefault(row["result"], []).append(contribution)
    return budgets


def _result(name: str, group: Any, budget: tuple[Contribution, ...]) -> Result:
    status = Status(text(group, "status"))
    result = Result(
        name=name,
        value=None if status is Status.FAILED else get_number(group, "value"),
        unit=text(group, "unit"),
        interval=_interval(group) if has_attribute(group, "lower") else None,
        status=status,
        reasons=read_reasons(group),
        n=int(get_number(group, "n")),
        estimate=get_number(group, layout.ESTIMATE)
        if has_attribute(group, layout.ESTIMATE)
        else None,
        budget=budget,
        method=text(group, "method"),
        made_of=text(group, "made_of"),
        remark=text(group, "remark"),
    )
    if text(group, "seal") != result.seal:
        message = f"results/{name}: its numbers were changed after they were written"
        raise ValueError(message)
    return result
