"""Reading of result files: HDF5 to TestResult, fully checked."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import (
    Aligned,
    Bending,
    BendingCloud,
    Branch,
    ClockFit,
    Curve,
    FittedLine,
    MeasuredLaw,
    Series,
    Shape,
    Slip,
    SlipDecision,
)
from labpipe.records.group import DrawnLaw, DrawnShapes
from labpipe.records.quality import QualityNote
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
from labpipe.store.datasets import open_result, read_array, read_array_rows, read_text, read_texts
from labpipe.store.hdf5_objects import get_number
from labpipe.store.layout import BudgetRow, list_attributes, list_datasets
from labpipe.store.stored_parts import read_recording, read_specimen
from labpipe.store.stored_records import read_arrays, read_attributes, read_record, read_table

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
    with open_result(path) as root:
        return TestResult(
            **_head(root),
            **_outcome(root),
            aligned=_aligned(root),
            shape=_shape(root),
            bending=_bending(root),
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
    with open_result(path) as root:
        return _read_reported(root)


@dataclass(frozen=True, slots=True, eq=False)
class ReportedTest:
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


def read_reported(
    path: Path, choose: Callable[[TestResult, Floats], tuple[Ints, Floats]]
) -> ReportedTest:
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
    with open_result(path) as root:
        result = _read_reported(root)
        return ReportedTest(result, _read_drawn_shapes(root, result, choose), _read_drawn_law(root))


def _read_drawn_shapes(
    root: Any, result: TestResult, choose: Callable[[TestResult, Floats], tuple[Ints, Floats]]
) -> DrawnShapes | None:
    if layout.SHAPE not in root:
        return None
    group, fields = root[layout.SHAPE], list_datasets(Shape)
    frames, deflection = choose(result, read_array(group, "time", fields["time"]))
    places = read_array_rows(group, "positions", fields["positions"], frames)
    return DrawnShapes(deflection, places[:, :, :2])


def _read_drawn_law(root: Any) -> DrawnLaw | None:
    group = root.get(f"{layout.BENDING}/{layout.LAW}")
    if group is None:
        return None
    names = ("curvature", "moment", "moment_lower", "moment_upper")
    return DrawnLaw(**read_arrays(group, MeasuredLaw, names))


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
    with open_result(path) as root:
        head = _head(root, raw=False)
        return TestResult(**head, **_outcome(root), aligned=_aligned(root), shape=_shape(root))


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
    with open_result(path) as root:
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
    with open_result(path) as root:
        return read_text(root, "test")


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
    with open_result(path) as root:
        return read_text(root, "run")


def _head(root: Any, *, raw: bool = True) -> dict[str, Any]:
    """Read the fields that `TestResult` and `RawTest` share."""
    group = root[layout.RAW]
    roles = read_texts(group, "roles") if raw else ()
    return {
        **read_attributes(root, RawTest),
        "specimen": read_specimen(root),
        "inputs": _inputs(group),
        "recordings": {role: read_recording(group[role]) for role in roles},
    }


def _outcome(root: Any) -> dict[str, Any]:
    """Read the outcome of processing: curve, numbers and circumstances."""
    group, display = root.get(layout.CURVE, {}), json.loads(read_text(root, "display"))
    return {
        **read_attributes(root, TestResult, skip=list_attributes(RawTest)),
        "curve": _curve(group) if group else None,
        "results": _results(root),
        "quality": read_table(root, layout.QUALITY, QualityNote),
        "display": {str(key): str(unit) for key, unit in display.items()},
        "slips": _optional_table(group, layout.SLIPS, Slip),
        "lines": _optional_table(group, layout.LINES, FittedLine),
        "instruments": _optional_table(root, layout.INSTRUMENTS, Instrument),
    }


def _optional_table(parent: Any, name: str, kind: type[_R]) -> tuple[_R, ...]:
    return read_table(parent, name, kind) if name in parent else ()


def _inputs(raw: Any) -> tuple[InputFile, ...]:
    inputs: dict[int, InputFile] = {}
    for role, group in raw.items():
        rows = zip(
            group.attrs["input_order"],
            read_texts(group, "file"),
            read_texts(group, "sha256"),
            group.attrs["bytes"],
            strict=True,
        )
        inputs |= {int(i): InputFile(role, file, sha, int(size)) for i, file, sha, size in rows}
    return tuple(inputs[number] for number in sorted(inputs))


def _aligned(root: Any) -> Aligned | None:
    if layout.ALIGNED not in root:
        return None
    group, values = root[layout.ALIGNED], list_datasets(Series)["values"]
    series = {
        read_text(group[name], "name"): Series(
            read_array(group, name, values), read_text(group[name], "unit")
        )
        for name in read_texts(group, "series")
    }
    fit = None
    if layout.EVENTS in group:
        events = read_arrays(group[layout.EVENTS], ClockFit)
        fit = ClockFit(**events, **read_attributes(group, ClockFit))
    return read_record(group, Aligned, series=series, clock_fit=fit)


def _curve(group: Any) -> Curve:
    time_unit = read_text(group[layout.TIME], "unit")
    branches = read_table(group, layout.BRANCHES, Branch, time_unit)
    return read_record(group, Curve, branches=branches)


def _shape(root: Any) -> Shape | None:
    return read_record(root[layout.SHAPE], Shape) if layout.SHAPE in root else None


def _bending(root: Any) -> Bending | None:
    if layout.BENDING not in root:
        return None
    group = root[layout.BENDING]
    law = read_record(group[layout.LAW], MeasuredLaw) if layout.LAW in group else None
    return read_record(group, Bending, cloud=read_record(group, BendingCloud), law=law)


def _results(root: Any) -> tuple[Result, ...]:
    group, budgets = root[layout.RESULTS], dict[str, list[Contribution]]()
    for row in _optional_table(root, layout.BUDGETS, BudgetRow):
        contribution = Contribution(row.cause, row.change, row.is_common)
        budgets.setdefault(row.result, []).append(contribution)
    return tuple(
        _result(name, group[name], tuple(budgets.get(name, ())))
        for name in read_texts(group, "order")
    )


def _result(name: str, group: Any, budget: tuple[Contribution, ...]) -> Result:
    fields = read_attributes(group, Result, skip=("name", "value"))
    value = None if fields["status"] is Status.FAILED else get_number(group, "value")
    result = Result(name=name, value=value, budget=budget, **fields)
    if read_text(group, "seal") != result.seal:
        message = f"results/{name}: its numbers were changed after they were written"
        raise ValueError(message)
    return result
