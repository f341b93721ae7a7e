"""Writing of result files: TestResult to HDF5, verified before the old file is replaced."""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from labpipe.errors import StoreError
from labpipe.records.curve import (
    Aligned,
    Bending,
    Branch,
    Curve,
    FittedLine,
    Interval,
    Series,
    Slip,
)
from labpipe.records.quality import QualityNote
from labpipe.records.result import Instrument, Result, TestResult
from labpipe.store import layout
from labpipe.store.datasets import Target, has_same_content, locate_array
from labpipe.store.hdf5_objects import open_dataset, set_number, set_text
from labpipe.store.layout import BudgetRow, ResultRow, list_datasets, make_link_name
from labpipe.store.replace import replacing
from labpipe.store.stored_parts import write_recording, write_specimen
from labpipe.store.stored_records import write_arrays, write_attributes, write_record, write_table


def write_result(result: TestResult, path: Path) -> None:
    """Write a test; an earlier file is kept until the new one is verified.

    Parameters
    ----------
    result : a processed test
    path : the file, usually ``result.h5``

    Raises
    ------
    StoreError
        If it cannot be written, or does not read back as written. An earlier file at `path` is
        then unchanged.

    Notes
    -----
    The same result gives the same bytes: no times, no host names. The file is created in memory
    (about as large as on disk), because the HDF5 library cannot close a file properly when the disk
    becomes full.
    """
    image, written = _image(result)
    with replacing(path) as temporary:
        temporary.write_bytes(image)
        _verify(temporary, path, image, written)


def _image(result: TestResult) -> tuple[bytes, dict[str, NDArray[Any]]]:
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
    """Read the file from the disk again: every byte, and every array through its checksums.

    An array in several groups has the same chunks in each: it is read once.
    """
    is_whole = temporary.read_bytes() == image
    if is_whole:
        try:
            with h5py.File(temporary, "r") as root:
                unique = {locate_array(array): name for name, array in written.items()}.values()
                is_whole = all(
                    has_same_content(open_dataset(root, name), written[name]) for name in unique
                )
        except OSError:  # a wrong checksum
            is_whole = False
    if not is_whole:
        raise StoreError.about("store.not_verified", path)


def _write_root(target: Target, result: TestResult) -> None:
    target.group.attrs[layout.SCHEMA_ATTRIBUTE] = layout.SCHEMA
    write_attributes(target, result)
    set_text(target.group, "display", json.dumps(dict(result.display), ensure_ascii=False))
    write_specimen(target, result.specimen)
    _write_raw(target.open_group(layout.RAW), result)
    if result.aligned is not None:
        _write_aligned(target.open_group(layout.ALIGNED), result.aligned)
    if result.curve is not None:
        _write_curve(target.open_group(layout.CURVE), result, result.curve)
    if result.shape is not None:
        write_record(target.open_group(layout.SHAPE), result.shape)
    if result.bending is not None:
        _write_bending(target.open_group(layout.BENDING), result.bending)
    if result.instruments:
        write_table(target, layout.INSTRUMENTS, Instrument, result.instruments)
    _write_results(target.open_group(layout.RESULTS), result.results)
    budget = [
        BudgetRow(entry.name, row.cause, row.change, entry.unit, share, row.is_common)
        for entry in result.results
        for row, share in zip(entry.budget, entry.shares, strict=True)
    ]
    if budget:
        write_table(target, layout.BUDGETS, BudgetRow, budget)
    write_table(target, layout.QUALITY, QualityNote, result.quality)


def _write_raw(target: Target, result: TestResult) -> None:
    """Write recordings by role, with fingerprints and order of their exports."""
    roles = dict.fromkeys([*result.recordings, *(export.role for export in result.inputs)])
    target.write_texts("roles", tuple(result.recordings))
    for role in roles:
        inside = target.open_group(role)
        places = [place for place, export in enumerate(result.inputs) if export.role == role]
        inputs = [result.inputs[place] for place in places]
        inside.write_texts("file", tuple(export.file for export in inputs))
        inside.write_texts("sha256", tuple(export.sha256 for export in inputs))
        sizes = np.array([export.bytes for export in inputs], dtype=np.int64)
        inside.group.attrs["bytes"] = sizes
        inside.group.attrs["input_order"] = np.array(places, dtype=np.int64)
        if role in result.recordings:
            write_recording(inside, result.recordings[role])


def _write_aligned(target: Target, aligned: Aligned) -> None:
    write_arrays(target, aligned)
    names: list[str] = []
    for name, series in aligned.series.items():
        names.append(make_link_name(name, [*target.group, layout.EVENTS]))
        dataset = target.write_array(
            names[-1], series.values, list_datasets(Series)["values"], series.unit
        )
        set_text(dataset, "name", name)
    target.write_texts("series", tuple(names))
    target.attach_scales()
    if aligned.clock_fit is not None:
        write_attributes(target, aligned.clock_fit)
        write_arrays(target.open_group(layout.EVENTS), aligned.clock_fit)


def _write_curve(target: Target, result: TestResult, curve: Curve) -> None:
    write_arrays(target, curve)
    write_table(target, layout.BRANCHES, Branch, curve.branches, curve.time_unit)
    if result.slips:
        write_table(target, layout.SLIPS, Slip, result.slips)
    if result.lines:
        write_table(target, layout.LINES, FittedLine, result.lines)


def _write_bending(target: Target, bending: Bending) -> None:
    write_record(target, bending.cloud)
    write_attributes(target, bending)
    if bending.law is not None:
        write_record(target.open_group(layout.LAW), bending.law)


def _write_results(target: Target, results: tuple[Result, ...]) -> None:
    target.write_texts("order", tuple(result.name for result in results))
    for result in results:
        inside = target.open_group(result.name)
        set_number(inside.group, "value", np.nan if result.value is None else float(result.value))
        set_text(inside.group, "seal", result.seal)
        write_attributes(inside, result, skip=("name", "value"))
    write_table(target, "table", ResultRow, [_row_of(result) for result in results])


def _row_of(result: Result) -> ResultRow:
    ends = result.interval or Interval(np.nan, np.nan, np.nan)
    return ResultRow(
        result.name,
        result.value,
        result.best_estimate,
        ends.lower,
        ends.upper,
        result.unit,
        ends.level,
        result.status,
        ", ".join(result.codes),
        result.reason_text,
    )
