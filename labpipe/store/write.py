"""Writing of result files: TestResult to HDF5, verified before the old file is replaced."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from labpipe.errors import StoreError, error_text
from labpipe.records.curve import Aligned, ClockFit, Curve, Interval, Shape
from labpipe.records.result import Result, TestResult
from labpipe.store import layout
from labpipe.store.datasets import Target, place_of, same_content
from labpipe.store.hdf5_objects import open_dataset, set_number, set_text
from labpipe.store.layout import Table, link_name
from labpipe.store.replace import replacing
from labpipe.store.stored_parts import (
    write_bending,
    write_notes,
    write_reasons,
    write_recording,
    write_specimen,
)


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
                unique = {place_of(array): name for name, array in written.items()}.values()
                is_whole = all(
                    same_content(open_dataset(root, name), written[name]) for name in unique
                )
        except OSError:  # a wrong checksum
            is_whole = False
    if not is_whole:
        message = error_text(
            path,
            "",
            expected="to read back what was written",
            found="something else",
            remedy="Check the disk; the earlier result, if any, is untouched.",
        )
        raise StoreError(message)


def _write_root(target: Target, result: TestResult) -> None:
    attributes = target.group.attrs
    attributes[layout.SCHEMA_ATTRIBUTE] = layout.SCHEMA
    for name in layout.ROOT_TEXTS:
        attributes[name] = getattr(result, name)
    attributes[layout.RUN] = result.run
    attributes[layout.DISPLAY] = json.dumps(dict(result.display), ensure_ascii=False)
    target.texts(layout.FIGURES, result.figures)
    for name, attribute in layout.SPECIMEN_TEXTS.items():
        attributes[attribute] = getattr(result.specimen, name)
    write_specimen(target.inside(layout.SPECIMEN), result.specimen)
    _write_raw(target.inside(layout.RAW), result)
    if result.aligned is not None:
        _write_aligned(target.inside(layout.ALIGNED), result.aligned)
    if result.curve is not None:
        _write_curve(target.inside(layout.CURVE), result, result.curve)
    if result.shape is not None:
        _write_shape(target.inside(layout.SHAPE), result.shape)
    if result.bending is not None:
        write_bending(target.inside(layout.BENDING), result.bending)
    _write_circumstances(target, result)
    _write_results(target.inside(layout.RESULTS), result.results)
    _write_budgets(target, result.results)
    write_notes(target.inside(layout.QUALITY), result.quality)


def _write_circumstances(target: Target, result: TestResult) -> None:
    """Write date, operator and instruments of the test."""
    target.group.attrs[layout.DATE] = str(result.date or "")
    target.group.attrs[layout.OPERATOR] = result.operator
    rows = [
        (
            *(instrument.channel, ", ".join(instrument.measures), instrument.certificate),
            *(str(instrument.calibrated), str(instrument.due or "")),
            *(np.nan if instrument.uncertainty is None else instrument.uncertainty, instrument.k),
        )
        for instrument in result.instruments
    ]
    if rows:
        target.inside(layout.INSTRUMENTS).columns(layout.INSTRUMENT_TABLE, rows)


def _write_raw(target: Target, result: TestResult) -> None:
    """Write recordings by role, with fingerprints and order of their exports."""
    roles = dict.fromkeys([*result.recordings, *(export.role for export in result.inputs)])
    target.texts("roles", tuple(result.recordings))
    for role in roles:
        inside = target.inside(role)
        places = [place for place, export in enumerate(result.inputs) if export.role == role]
        inputs = [result.inputs[place] for place in places]
        inside.texts("file", tuple(export.file for export in inputs))
        inside.texts("sha256", tuple(export.sha256 for export in inputs))
        sizes = np.array([export.bytes for export in inputs], dtype=np.int64)
        inside.group.attrs["bytes"] = sizes
        inside.group.attrs[layout.INPUT_ORDER] = np.array(places, dtype=np.int64)
        if role in result.recordings:
            write_recording(inside, result.recordings[role])


def _write_aligned(target: Target, aligned: Aligned) -> None:
    target.array(layout.TIME, aligned.time, layout.CLOCK_TIME, aligned.time_unit)
    names: list[str] = []
    for name, series in aligned.series.items():
        names.append(link_name(name, [*target.group, layout.EVENTS]))
        dataset = target.array(names[-1], series.values, layout.SERIES, series.unit)
        dataset.attrs["name"] = name
    target.texts("series", tuple(names))
    target.scaled(layout.SAMPLE_SCALES)
    if aligned.clock_fit is not None:
        _write_clock_fit(target, aligned.clock_fit)


def _write_clock_fit(target: Target, fit: ClockFit) -> None:
    attributes = target.group.attrs
    attributes["method"] = fit.method
    for name, unit in layout.CLOCK_FIT_UNITS.items():
        attributes[name] = float(getattr(fit, name))
        attributes[f"{name}_unit"] = unit
    for name in layout.CLOCK_FIT_INTERVALS:
        interval = getattr(fit, f"{name}_interval")
        for end in layout.INTERVAL_NUMBERS:
            attributes[f"{name}_{end}"] = float(getattr(interval, end))
    events = target.inside(layout.EVENTS)
    events.fields(fit, layout.EVENT_FIELDS)
    events.scaled(layout.EVENT_SCALES)


def _write_curve(target: Target, result: TestResult, curve: Curve) -> None:
    target.array(layout.TIME, curve.time, layout.CLOCK_TIME, curve.time_unit)
    target.fields(curve, layout.CURVE_FIELDS)
    target.scaled(layout.SAMPLE_SCALES)
    branches = _rows(curve.branches, layout.BRANCH_TABLE)
    target.inside(layout.BRANCHES).columns(layout.BRANCH_TABLE, branches, curve.time_unit)
    if result.slips:
        slips = _rows(result.slips, layout.SLIP_TABLE)
        target.inside(layout.SLIPS).columns(layout.SLIP_TABLE, slips)
    if result.lines:
        lines = _rows(result.lines, layout.LINE_TABLE)
        target.inside(layout.LINES).columns(layout.LINE_TABLE, lines)


def _rows(records: Iterable[object], table: Table) -> list[tuple[Any, ...]]:
    """Return rows of a table; ``drop_lower`` is the lower end of a record's ``drop_interval``."""
    return [tuple(_cell(record, column) for column in table.columns) for record in records]


def _cell(record: object, column: str) -> Any:
    name, _, end = column.rpartition("_")
    if name and end in layout.INTERVAL_NUMBERS:
        return getattr(getattr(record, f"{name}_interval"), end)
    return getattr(record, column)


def _write_shape(target: Target, shape: Shape) -> None:
    target.fields(shape, layout.SHAPE_FIELDS)
    target.strings(layout.NAMES, shape.names, "point")
    target.scaled(layout.SHAPE_SCALES)
    target.group.attrs["length"] = float(shape.length)
    target.group.attrs["length_unit"] = "m"


def _write_results(target: Target, results: tuple[Result, ...]) -> None:
    target.texts("order", tuple(result.name for result in results))
    for result in results:
        inside = target.inside(result.name)
        set_number(inside.group, "value", np.nan if result.value is None else float(result.value))
        set_number(inside.group, "n", int(result.n))
        for name in layout.RESULT_TEXTS:
            set_text(inside.group, name, str(getattr(result, name)))
        write_reasons(inside, result.reasons)
        if result.interval is not None:
            for end in layout.INTERVAL_NUMBERS:
                set_number(inside.group, end, float(getattr(result.interval, end)))
        if result.estimate is not None:
            set_number(inside.group, layout.ESTIMATE, float(result.estimate))
    _write_table(target.inside(layout.RESULT_TABLE), results)


def _write_table(target: Target, results: tuple[Result, ...]) -> None:
    """Write the results as columns; missing values are NaN, with `code` and `reason`."""
    rows = []
    for result in results:
        interval = result.interval or Interval(np.nan, np.nan, np.nan)
        numbers = (result.value, result.likely, interval.lower, interval.upper)
        rows.append((
            result.name, *(np.nan if number is None else number for number in numbers), result.unit,
            interval.level, str(result.status), ", ".join(result.codes), result.why,
        ))  # fmt: skip
    target.columns(layout.RESULT_COLUMNS, rows)


def _write_budgets(target: Target, results: tuple[Result, ...]) -> None:
    rows = [
        (
            result.name,
            contribution.cause,
            contribution.change,
            result.unit,
            share,
            contribution.is_common,
        )
        for result in results
        for contribution, share in zip(result.budget, result.shares, strict=True)
    ]
    if rows:
        target.inside(layout.BUDGETS).columns(layout.BUDGET_TABLE, rows)
