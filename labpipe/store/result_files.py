"""Write result files, verified before an old file is replaced, and read them whole or in part."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
from numpy.typing import NDArray

from labpipe.errors import StoreError
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import DrawnLaw, DrawnShapes, MeasuredLaw, Shape, SlipDecision
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Recording
from labpipe.records.result import InputFile, Instrument, Specimen, TestResult
from labpipe.store import layout
from labpipe.store.datasets import (
    Target,
    has_same_content,
    locate_array,
    open_dataset,
    open_result,
    read_array,
    read_array_rows,
    read_text,
    read_texts,
    set_text,
)
from labpipe.store.layout import list_attributes, list_datasets
from labpipe.store.parts import (
    read_aligned,
    read_arrays,
    read_attributes,
    read_bending,
    read_curve,
    read_inputs,
    read_record,
    read_recording,
    read_results,
    read_rows,
    read_specimen,
    read_table,
    write_aligned,
    write_attributes,
    write_bending,
    write_curve,
    write_raw,
    write_record,
    write_results,
    write_rows,
    write_specimen,
    write_table,
)
from labpipe.store.replace import replacing


def write_result(result: TestResult, path: Path) -> None:
    """Write a test; an earlier file is kept until the new one is verified.

    Parameters
    ----------
    result : a processed test
    path : the file, usually ``result.h5``

    Raises
    ------
    StoreError
        If the file cannot be written, or its content differs when it is read again. An earlier file
        at `path` is then unchanged.

    Notes
    -----
    The same result gives the same bytes: no times, no host names. The file is created in memory
    (about as large as on disk), because the HDF5 library cannot close a file properly when the disk
    becomes full.
    """
    image, written = _build_image(result)
    with replacing(path) as temporary:
        temporary.write_bytes(image)
        _verify(temporary, path, image, written)


def _build_image(result: TestResult) -> tuple[bytes, dict[str, NDArray[Any]]]:
    """Return the file as bytes, with the arrays by dataset for verification."""
    with (
        ThreadPoolExecutor(max(os.cpu_count() or 1, 2)) as pool,
        h5py.File("result", "w", driver="core", backing_store=False, block_size=1 << 20) as root,
    ):
        target = Target(root, pool)
        _write_root(target, result)
        root.flush()
        return root.id.get_file_image(), target.written


def _verify(temporary: Path, path: Path, image: bytes, written: dict[str, NDArray[Any]]) -> None:
    """Read the file from the disk again: every byte, and chunks of every array through HDF5.

    An array in several groups has the same chunks in each: it is read once.
    """
    is_identical = temporary.read_bytes() == image
    if is_identical:
        try:
            with h5py.File(temporary, "r") as root:
                unique = {locate_array(array): name for name, array in written.items()}.values()
                is_identical = all(
                    has_same_content(open_dataset(root, name), written[name]) for name in unique
                )
        except OSError:  # a wrong checksum
            is_identical = False
    if not is_identical:
        raise StoreError.about("store.not_verified", path)


def _write_root(target: Target, result: TestResult) -> None:
    target.group.attrs[layout.SCHEMA_ATTRIBUTE] = layout.SCHEMA
    write_attributes(target, result)
    set_text(target.group, "display", json.dumps(dict(result.display), ensure_ascii=False))
    write_specimen(target, result.specimen)
    write_raw(target.open_group(layout.RAW), result)
    if result.aligned is not None:
        write_aligned(target.open_group(layout.ALIGNED), result.aligned)
    if result.curve is not None:
        write_curve(target.open_group(layout.CURVE), result, result.curve)
    if result.shape is not None:
        write_record(target.open_group(layout.SHAPE), result.shape)
    if result.bending is not None:
        write_bending(target.open_group(layout.BENDING), result.bending)
    write_rows(target, layout.INSTRUMENTS, Instrument, result.instruments)
    write_results(target, result.results)
    write_table(target, layout.QUALITY, QualityNote, result.quality)


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
    recordings : recordings by role
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
    result : result as `read_outcome` returns it
    shapes : shapes at the chosen frames; None without shapes
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
