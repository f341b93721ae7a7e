"""Write result files: TestResult to HDF5, verified before the old file is replaced."""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
from numpy.typing import NDArray

from labpipe.errors import StoreError
from labpipe.records.quality import QualityNote
from labpipe.records.result import Instrument, TestResult
from labpipe.store import layout
from labpipe.store.datasets import Target, has_same_content, locate_array, open_dataset, set_text
from labpipe.store.parts import (
    write_aligned,
    write_bending,
    write_curve,
    write_raw,
    write_results,
    write_rows,
    write_specimen,
)
from labpipe.store.replace import replacing
from labpipe.store.stored_records import write_attributes, write_record, write_table


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
