"""Write and verify result files, and read all or parts of them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
from numpy.typing import NDArray

from labpipe.errors import LabpipeError, StoreError
from labpipe.records.curve import FigureLaw, FigureShapes
from labpipe.records.result import TestResult
from labpipe.store.datasets import GroupWriter, has_same_content, locate_array, read_text
from labpipe.store.layout import SCHEMA_ATTRIBUTE, SCHEMA_VERSION
from labpipe.store.parts import (
    FrameChoice,
    RawTest,
    read_raw_test,
    read_reported_test,
    read_test,
    write_test,
)
from labpipe.store.replace import is_unfinished, replace_file


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
    becomes full. The file needs about as much memory as space on the disk.
    """
    image, arrays = _build_image(result)
    with replace_file(path) as temporary_file:
        temporary_file.write_bytes(image)
        _verify_file(temporary_file, path, image, arrays)


def _build_image(result: TestResult) -> tuple[bytes, dict[str, NDArray[Any]]]:
    """Build the file as bytes, and return it with its arrays, keyed by path of the dataset."""
    with (
        ThreadPoolExecutor(max(os.cpu_count() or 1, 2)) as pool,
        h5py.File("result", "w", driver="core", backing_store=False, block_size=1 << 20) as root,
    ):
        target = GroupWriter(root, pool)
        write_test(target, result)
        root.flush()
        return root.id.get_file_image(), target.arrays


def _verify_file(file: Path, path: Path, image: bytes, arrays: dict[str, NDArray[Any]]) -> None:
    """Raise an error if bytes of a file, or chunks of an array read by HDF5, are not as written.

    An array that several groups contain is compared only once, because its chunks are the same.
    """
    is_identical = file.read_bytes() == image
    if is_identical:
        try:
            with h5py.File(file, "r") as root:
                names = {locate_array(array): name for name, array in arrays.items()}.values()
                is_identical = all(has_same_content(root[name], arrays[name]) for name in names)
        except OSError:  # HDF5 reports a wrong checksum
            is_identical = False
    if not is_identical:
        raise StoreError.about("store.not_verified", path)


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
    with _open_result(path) as root:
        return read_test(root, ("raw", "aligned", "shape", "bending"))


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
    with _open_result(path) as root:
        return read_test(root)


def read_report_parts(
    path: Path, choose_frames: FrameChoice
) -> tuple[TestResult, FigureShapes | None, FigureLaw | None]:
    """Read the parts of a result file that a report shows.

    Parameters
    ----------
    path : path of a file that `write_result` wrote
    choose_frames : function that chooses the frames whose shapes are read

    Returns
    -------
    result : test as `read_outcome` returns it
    shapes : shapes at the chosen frames; None without shapes
    law : moment-curvature law of the first loading; None without a measured law

    Raises
    ------
    StoreError
        As `read_result`.
    """
    with _open_result(path) as root:
        return read_reported_test(root, choose_frames)


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
    with _open_result(path) as root:
        return read_test(root, ("aligned", "shape"))


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
    with _open_result(path) as root:
        return read_raw_test(root)


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
    with _open_result(path) as root:
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
    with _open_result(path) as root:
        return read_text(root, "run")


@contextmanager
def _open_result(path: Path) -> Iterator[Any]:
    """Open a result file of the current schema, and convert all errors to StoreError."""
    try:
        if is_unfinished(path.parent):
            raise StoreError.about("store.cut_off", path, target=path)
        if not h5py.is_hdf5(path):
            raise StoreError.about("store.no_hdf5", path, found=_describe_file(path))
        with h5py.File(path, "r") as root:
            _check_schema(path, root)
            _check_links(path, root)
            yield root
    except LabpipeError:
        raise
    except MemoryError as error:
        raise StoreError.about("store.too_large", path, reason=error) from error
    except Exception as error:
        reason = " ".join(str(error).split())
        raise StoreError.about("store.damaged", path, reason=reason) from error


def _describe_file(path: Path) -> str:
    """Describe the content of a path that is not an HDF5 file."""
    if not path.exists():
        return "nothing"
    with path.open("rb") as file:  # raises if the file is not readable
        first_byte = file.read(1)
    return "a file that is not HDF5" if first_byte else "an empty file"


def _check_schema(path: Path, root: Any) -> None:
    """Raise StoreError if a file has another schema, or no schema."""
    schema, current_schema = root.attrs.get(SCHEMA_ATTRIBUTE), SCHEMA_VERSION
    if schema is None:
        raise StoreError.about("store.foreign", path, SCHEMA_ATTRIBUTE, known=current_schema)
    if schema != current_schema:
        is_newer = schema > current_schema
        raise StoreError.about(
            "store.newer_schema" if is_newer else "store.other_schema",
            path,
            SCHEMA_ATTRIBUTE,
            known=current_schema,
            schema=schema,
        )


def _check_links(path: Path, root: Any) -> None:
    """Raise StoreError if a result file has links to other files, because it must be complete."""
    internal_types = h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT
    link = root.id.links.visit(
        lambda name, link: None if link.type in internal_types else name, info=True
    )
    if link is not None:
        raise StoreError.about("store.link", path, link.decode(errors="replace"))
