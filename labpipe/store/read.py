"""Read result files: HDF5 to TestResult, as a whole or in parts."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import DrawnLaw, DrawnShapes, MeasuredLaw, Shape, SlipDecision
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Recording
from labpipe.records.result import InputFile, Instrument, Specimen, TestResult
from labpipe.store import layout
from labpipe.store.datasets import open_result, read_array, read_array_rows, read_text, read_texts
from labpipe.store.layout import list_attributes, list_datasets
from labpipe.store.parts import (
    read_aligned,
    read_bending,
    read_curve,
    read_inputs,
    read_recording,
    read_results,
    read_rows,
    read_specimen,
)
from labpipe.store.stored_records import read_arrays, read_attributes, read_record, read_table


@dataclass(frozen=True, slots=True, eq=False)
class RawTest:
    """The content of a result file before processing: sufficient to process the test again.

    Parameters
    ----------
    test : name of the test
    specimen : the tested specimen
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
        If the file is missing, not a result file of labpipe, of another schema, truncated or
        damaged, or if its folder is unfinished.
    """
    with open_result(path) as root:
        return _read(root, ("raw", "aligned", "shape", "bending"))


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
        return _read(root)


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
    choose : function of the outcome and the times of all frames, s; returns the frames to read, in
        increasing order, and their deflections, m

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with open_result(path) as root:
        result = _read(root)
        return ReportedTest(result, _read_drawn_shapes(root, result, choose), _read_drawn_law(root))


def _read_drawn_shapes(
    root: Any, result: TestResult, choose: Callable[[TestResult, Floats], tuple[Ints, Floats]]
) -> DrawnShapes | None:
    if layout.SHAPE not in root:
        return None
    group, fields = root[layout.SHAPE], list_datasets(Shape)
    frames, deflection = choose(result, read_array(group, "time", fields["time"]))
    positions = read_array_rows(group, "positions", fields["positions"], frames)
    return DrawnShapes(deflection, positions[:, :, :2])


def _read_drawn_law(root: Any) -> DrawnLaw | None:
    group = root.get(f"{layout.BENDING}/{layout.LAW}")
    if group is None:
        return None
    names = ("curvature", "moment", "moment_lower", "moment_upper")
    return DrawnLaw(**read_arrays(group, MeasuredLaw, names))


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
        return _read(root, ("aligned", "shape"))


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
        return RawTest(**_read_head(root))


def read_name(path: Path) -> str:
    """Read only the name of the test.

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
    """Read only the key of the run.

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


def _read_head(root: Any, *, raw: bool = True) -> dict[str, Any]:
    """Read the fields that `TestResult` and `RawTest` share."""
    group = root[layout.RAW]
    roles = read_texts(group, "roles") if raw else ()
    return {
        **read_attributes(root, RawTest),
        "specimen": read_specimen(root),
        "inputs": read_inputs(group),
        "recordings": {role: read_recording(group[role]) for role in roles},
    }


def _read(root: Any, stages: Collection[str] = ()) -> TestResult:
    """Read the outcome and the requested stages; aligned signals also if slips were repaired."""
    display = json.loads(read_text(root, "display"))
    curve = read_curve(root)
    is_repaired = any(slip.decision is SlipDecision.REPAIRED for slip in curve.get("slips", ()))
    has_shape = "shape" in stages and layout.SHAPE in root
    return TestResult(
        **_read_head(root, raw="raw" in stages),
        **read_attributes(root, TestResult, skip=list_attributes(RawTest)),
        **curve,
        results=read_results(root),
        quality=read_table(root, layout.QUALITY, QualityNote),
        display={str(key): str(unit) for key, unit in display.items()},
        instruments=read_rows(root, layout.INSTRUMENTS, Instrument),
        aligned=read_aligned(root) if "aligned" in stages or is_repaired else None,
        shape=read_record(root[layout.SHAPE], Shape) if has_shape else None,
        bending=read_bending(root) if "bending" in stages else None,
    )
