"""Write and verify result files, and read all or parts of them."""

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
    read_optional_table,
    read_record,
    read_recording,
    read_results,
    read_specimen,
    read_table,
    write_aligned,
    write_attributes,
    write_bending,
    write_curve,
    write_optional_table,
    write_raw,
    write_record,
    write_results,
    write_specimen,
    write_table,
)
from labpipe.store.replace import replace_file


def write_result(result: TestResult, path: Path) -> None:
    """Write a test, and keep an earlier file until the new one is verified.

    Parameters
    ----------
    result : processed test
    path : path of the file, usually ``result.h5``

    Raises
    ------
    StoreError
        If the file cannot be written, or its content differs when it is read again. An earlier file
        at `path` is then unchanged.

    Notes
    -----
    The same result gives the same bytes, because the file contains no times and no host names. The
    file is created in memory, because the HDF5 library cannot close a file properly when the disk
    becomes full. It needs about as much memory as space on the disk.
    """
    image, arrays = _build_image(result)
    with replace_file(path) as temporary:
        temporary.write_bytes(image)
        _verify(temporary, path, image, arrays)


def _build_image(result: TestResult) -> tuple[bytes, dict[str, NDArray[Any]]]:
    """Build the file as bytes, and return it with its arrays, keyed by path of the dataset."""
    with (
        ThreadPoolExecutor(max(os.cpu_count() or 1, 2)) as pool,
        h5py.File("result", "w", driver="core", backing_store=False, block_size=1 << 20) as root,
    ):
        target = Target(root, pool)
        _write_root(target, result)
        root.flush()
        return root.id.get_file_image(), target.arrays


def _verify(temporary: Path, path: Path, image: bytes, arrays: dict[str, NDArray[Any]]) -> None:
    """Raise an error if bytes of a file, or chunks of an array read by HDF5, are not as written.

    An array in several groups has the same chunks in each, so that it is read only once.
    """
    is_identical = temporary.read_bytes() == image
    if is_identical:
        try:
            with h5py.File(temporary, "r") as root:
                unique = {locate_array(array): name for name, array in arrays.items()}.values()
                is_identical = all(
                    has_same_content(open_dataset(root, name), arrays[name]) for name in unique
                )
        except OSError:  # a wrong checksum
            is_identical = False
    if not is_identical:
        raise StoreError.about("store.not_verified", path)


def _write_root(target: Target, result: TestResult) -> None:
    """Write all parts of a test into the root of its file."""
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
    write_optional_table(target, layout.INSTRUMENTS, Instrument, result.instruments)
    write_results(target, result.results)
    write_table(target, layout.QUALITY, QualityNote, result.quality)


@dataclass(frozen=True, slots=True, eq=False)
class RawTest:
    """Parts of a result file that are sufficient to process the test again.

    Parameters
    ----------
    test : name of the test
    specimen : specimen that was tested
    protocol : name of the protocol
    protocol_yaml : YAML text of the resolved protocol
    test_yaml : YAML text of the test sheet
    labpipe_version : version of labpipe that wrote the file
    inputs : exports with their SHA-256
    recordings : recordings, keyed by role
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
    path : path of a file that `write_result` wrote

    Returns
    -------
    The test; arrays are read-only.

    Raises
    ------
    StoreError
        If the file is missing, not a result file of labpipe, of another schema, truncated or
        damaged, or if files of its folder are being replaced.
    """
    with open_result(path) as root:
        return _read_test(root, ("raw", "aligned", "shape", "bending"))


def read_outcome(path: Path) -> TestResult:
    """Read the curve and the results of a test, without recordings and shapes.

    Parameters
    ----------
    path : path of a file that `write_result` wrote

    Returns
    -------
    The test without recordings. Aligned signals are read only if slips were repaired, to show the
    measured force.

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with open_result(path) as root:
        return _read_test(root)


FrameChoice = Callable[[TestResult, Floats], tuple[Ints, Floats]]
"""Function that chooses frames, given the test and the times of all frames, s.

It returns the indices of the chosen frames, in increasing order, and their deflections, m.
"""


@dataclass(frozen=True, slots=True, eq=False)
class ReportedTest:
    """Parts of a result file for a report.

    Parameters
    ----------
    result : test as `read_outcome` returns it
    shapes : shapes at the chosen frames; None without shapes
    law : moment-curvature law of the first loading; None without a measured law
    """

    result: TestResult
    shapes: DrawnShapes | None
    law: DrawnLaw | None


def read_reported(path: Path, choose_frames: FrameChoice) -> ReportedTest:
    """Read the parts of a result file that a report shows.

    Parameters
    ----------
    path : path of a file that `write_result` wrote
    choose_frames : function that chooses the frames whose shapes are read

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with open_result(path) as root:
        result = _read_test(root)
        shapes = _read_drawn_shapes(root, result, choose_frames)
        return ReportedTest(result, shapes, _read_drawn_law(root))


def _read_drawn_shapes(
    root: Any, result: TestResult, choose_frames: FrameChoice
) -> DrawnShapes | None:
    """Read the shapes at the frames that a function chooses; None without shapes."""
    if layout.SHAPE not in root:
        return None
    group, fields = root[layout.SHAPE], list_datasets(Shape)
    frames, deflection = choose_frames(result, read_array(group, "time", fields["time"]))
    positions = read_array_rows(group, "positions", fields["positions"], frames)
    return DrawnShapes(deflection, positions[:, :, :2])


def _read_drawn_law(root: Any) -> DrawnLaw | None:
    """Read the measured law of the first loading; None without a measured law."""
    group = root.get(f"{layout.BENDING}/{layout.LAW}")
    if group is None:
        return None
    names = ("curvature", "moment", "moment_lower", "moment_upper")
    return DrawnLaw(**read_arrays(group, MeasuredLaw, names))


def read_stages(path: Path) -> TestResult:
    """Read aligned signals, shapes, curve and results of a test, without recordings.

    Parameters
    ----------
    path : path of a file that `write_result` wrote

    Returns
    -------
    The test without recordings and without its measured moment-curvature.

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with open_result(path) as root:
        return _read_test(root, ("aligned", "shape"))


def read_raw(path: Path) -> RawTest:
    """Read the parts needed to process a test again without its exports.

    Parameters
    ----------
    path : path of a file that `write_result` wrote

    Returns
    -------
    The recordings with the protocol, the test sheet and the SHA-256 of the exports.

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with open_result(path) as root:
        return RawTest(**_read_common_fields(root))


def read_name(path: Path) -> str:
    """Read only the name of a test.

    Parameters
    ----------
    path : path of a file that `write_result` wrote

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with open_result(path) as root:
        return read_text(root, "test")


def read_run(path: Path) -> str:
    """Read only the key of the inputs of a test.

    Parameters
    ----------
    path : path of a file that `write_result` wrote

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with open_result(path) as root:
        return read_text(root, "run")


def _read_common_fields(root: Any, *, has_raw: bool = True) -> dict[str, Any]:
    """Read the fields that `TestResult` and `RawTest` share, with or without recordings."""
    group = root[layout.RAW]
    roles = read_texts(group, "roles") if has_raw else ()
    return {
        **read_attributes(root, RawTest),
        "specimen": read_specimen(root),
        "inputs": read_inputs(group),
        "recordings": {role: read_recording(group[role]) for role in roles},
    }


def _read_test(root: Any, stages: Collection[str] = ()) -> TestResult:
    """Read curve and results, the requested stages, and aligned signals if slips were repaired."""
    display = json.loads(read_text(root, "display"))
    curve = read_curve(root)
    is_repaired = any(slip.decision is SlipDecision.REPAIRED for slip in curve.get("slips", ()))
    has_shape = "shape" in stages and layout.SHAPE in root
    return TestResult(
        **_read_common_fields(root, has_raw="raw" in stages),
        **read_attributes(root, TestResult, skip=list_attributes(RawTest)),
        **curve,
        results=read_results(root),
        quality=read_table(root, layout.QUALITY, QualityNote),
        display={str(key): str(unit) for key, unit in display.items()},
        instruments=read_optional_table(root, layout.INSTRUMENTS, Instrument),
        aligned=read_aligned(root) if "aligned" in stages or is_repaired else None,
        shape=read_record(root[layout.SHAPE], Shape) if has_shape else None,
        bending=read_bending(root) if "bending" in stages else None,
    )
