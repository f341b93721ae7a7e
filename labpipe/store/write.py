"""TestResult to result.h5 and summary.json: written beside the old files, verified, renamed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from hashlib import sha256
from math import isfinite
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from labpipe.errors import StoreError, complaint
from labpipe.records.curve import Aligned, ClockFit, Curve, Shape
from labpipe.records.harness_bundle import Bundle
from labpipe.records.result import Result, Specimen, TestResult
from labpipe.store import layout
from labpipe.store.datasets import Target, place_of, same_content
from labpipe.store.layout import link_name
from labpipe.store.replace import replacing
from labpipe.store.stored_parts import (
    write_bending,
    write_notes,
    write_reasons,
    write_recording,
    write_specimen,
)

_BLOCK = 1 << 20


def write_result(result: TestResult, path: Path) -> None:
    """Write everything known of a test; an earlier file stays until the new one is verified.

    Parameters
    ----------
    result : a processed test
    path : the file, by custom ``result.h5``

    Raises
    ------
    StoreError
        If it cannot be written, or does not read back as it was written. What stood at `path`
        before still stands there then.

    Notes
    -----
    The same result gives the same bytes: no times, no names of machines. The file is put together
    in memory (about as large as on disk), because an HDF5 library that meets a full disk half-way
    cannot close its file in good order.
    """
    image, written = _image(result)
    with replacing(path) as temporary:
        temporary.write_bytes(image)
        _verify(temporary, path, image, written)


def _image(result: TestResult) -> tuple[bytes, dict[str, NDArray[Any]]]:
    """Put the whole file together in memory; with the arrays by dataset, to verify it."""
    with (
        ThreadPoolExecutor(max(os.cpu_count() or 1, 2)) as pool,
        h5py.File("result", "w", driver="core", backing_store=False, block_size=_BLOCK) as root,
    ):
        target = Target(root, pool)
        _write_root(target, result)
        root.flush()
        return root.id.get_file_image(), target.written


def _verify(temporary: Path, path: Path, image: bytes, written: dict[str, NDArray[Any]]) -> None:
    """Read the file again from its disk: every byte, and every array through its checksums.

    An array that stands in several groups has the same chunks in each: one of them is read.
    """
    is_whole = temporary.read_bytes() == image
    if is_whole:
        try:
            with h5py.File(temporary, "r") as root:
                once = {place_of(array): name for name, array in written.items()}
                is_whole = all(same_content(root[name], written[name]) for name in once.values())
        except OSError:  # a checksum that does not fit
            is_whole = False
    if not is_whole:
        message = complaint(
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
    _write_results(target.inside(layout.RESULTS), result.results)
    _write_budgets(target, result.results)
    write_notes(target.inside(layout.QUALITY), result.quality)


def _write_raw(target: Target, result: TestResult) -> None:
    """Recordings by role, with fingerprints of their exports and the place of each among all."""
    roles = dict.fromkeys([*result.recordings, *(given.role for given in result.inputs)])
    target.texts("roles", tuple(result.recordings))
    for role in roles:
        inside = target.inside(role)
        places = [place for place, given in enumerate(result.inputs) if given.role == role]
        inputs = [result.inputs[place] for place in places]
        inside.texts("file", tuple(given.file for given in inputs))
        inside.texts("sha256", tuple(given.sha256 for given in inputs))
        sizes = np.array([given.bytes for given in inputs], dtype=np.int64)
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
    target.inside(layout.EVENTS).fields(fit, layout.EVENT_FIELDS)


def _write_curve(target: Target, result: TestResult, curve: Curve) -> None:
    target.array(layout.TIME, curve.time, layout.CLOCK_TIME, curve.time_unit)
    target.fields(curve, layout.CURVE_FIELDS)
    branches = _table(curve.branches, layout.BRANCH_COLUMNS)
    target.array(layout.BRANCHES, branches, layout.branch_table(curve.time_unit))
    if result.slips:
        slips = _table(result.slips, layout.SLIP_COLUMNS)
        target.array(layout.SLIPS, slips, layout.SLIP_TABLE)
    if result.lines:
        lines = _table(result.lines, layout.LINE_COLUMNS)
        target.array(layout.LINES, lines, layout.LINE_TABLE)


def _table(records: Iterable[object], columns: tuple[tuple[str, str], ...]) -> NDArray[Any]:
    """Rows of a table; ``drop_lower`` is the lower end of a record's ``drop_interval``."""
    return _typed(
        [tuple(_cell(record, *column) for column in columns) for record in records], columns
    )


def _typed(rows: list[tuple[Any, ...]], columns: tuple[tuple[str, str], ...]) -> NDArray[Any]:
    """Rows as a table whose columns of text are as wide as their longest word."""
    kinds = list(columns)
    for place, (name, kind) in enumerate(columns):
        if kind.startswith("S"):  # numpy would cut words short that are longer than this
            longest = max([int(kind[1:]), *(len(row[place]) for row in rows)])
            kinds[place] = (name, f"S{longest}")
    return np.array(rows, dtype=kinds)


def _cell(record: object, column: str, kind: str) -> Any:
    name, _, end = column.rpartition("_")
    if name and end in layout.INTERVAL_NUMBERS:
        return getattr(getattr(record, f"{name}_interval"), end)
    value = getattr(record, column)
    return str(value).encode() if kind.startswith("S") else value


def _write_shape(target: Target, shape: Shape) -> None:
    target.fields(shape, layout.SHAPE_FIELDS)
    target.strings(layout.NAMES, shape.names, "point")
    target.group.attrs["length"] = float(shape.length)
    target.group.attrs["length_unit"] = "m"


def _write_results(target: Target, results: tuple[Result, ...]) -> None:
    target.texts("order", tuple(result.name for result in results))
    for result in results:
        inside = target.inside(result.name)
        attributes = inside.group.attrs
        attributes["value"] = np.nan if result.value is None else float(result.value)
        attributes["n"] = int(result.n)
        for name in layout.RESULT_TEXTS:
            attributes[name] = str(getattr(result, name))
        write_reasons(inside, result.reasons)
        if result.interval is not None:
            for end in layout.INTERVAL_NUMBERS:
                attributes[end] = float(getattr(result.interval, end))
        if result.estimate is not None:
            attributes[layout.ESTIMATE] = float(result.estimate)


def _write_budgets(target: Target, results: tuple[Result, ...]) -> None:
    rows = [
        (result.name.encode(), each.cause.encode(), each.change, result.unit.encode(), share,
         each.is_common)
        for result in results
        for each, share in zip(result.budget, result.shares, strict=True)
    ]  # fmt: skip
    if rows:
        target.array(layout.BUDGETS, _typed(rows, layout.BUDGET_COLUMNS), layout.BUDGET_TABLE)


SUMMARY_SCHEMA = 2


def summary(result: TestResult) -> dict[str, object]:
    """Sum up a test in plain SI numbers.

    Parameters
    ----------
    result : a processed test

    Returns
    -------
    What ``summary.json`` holds; only what JSON can say. A number that is not finite, or not
    available, is None; the status and the reasons say why.
    """
    return {
        "schema": SUMMARY_SCHEMA,
        "test": result.test,
        "specimen": _specimen(result.specimen),
        "protocol": result.protocol,
        "labpipe": result.labpipe_version,
        "inputs": [
            {"role": given.role, "file": given.file, "sha256": given.sha256}
            for given in result.inputs
        ],
        "run": result.run,
        "made_of": {
            "sheet": sha256(result.test_yaml.encode()).hexdigest(),
            "protocol": sha256(result.protocol_yaml.encode()).hexdigest(),
        },
        "results": [_entry(entry) for entry in result.results],
        "quality": [
            {"code": note.code, "severity": str(note.severity), "message": note.message}
            for note in result.quality
        ],
    }


def write_summary(result: TestResult, path: Path) -> None:
    """Write ``summary.json``; an earlier one stays until the new one is whole.

    Parameters
    ----------
    result : a processed test
    path : the file

    Raises
    ------
    StoreError
        If it cannot be written: full disk, no permission.
    """
    text = json.dumps(summary(result), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with replacing(path) as temporary:
        temporary.write_bytes(text.encode())


def _specimen(specimen: Specimen) -> dict[str, object]:
    said: dict[str, object] = {
        "type": specimen.type,
        "spool": specimen.spool,
        "sample": specimen.sample,
        **{name: _number(value) for name, value in specimen.dimensions.items()},
    }
    if specimen.bundle is not None:
        said["bundle"] = _bundle(specimen.bundle)
    if specimen.labels:
        said["labels"] = dict(specimen.labels)
    return said


def _bundle(bundle: Bundle) -> dict[str, object]:
    return {
        "composition": bundle.composition,
        "number": bundle.number,
        "wires": [
            {"type": wire.type, "number": wire.number, "diameter": _number(wire.diameter)}
            for wire in bundle.wires
        ],
        "arrangement": bundle.arrangement,
        "positions": [list(place) for place in bundle.positions],
        "tape": bundle.tape,
        "taping": bundle.taping,
        "conduit": bundle.conduit,
        "conduit_bore": _number(bundle.conduit_bore),
    }


def _entry(result: Result) -> dict[str, object]:
    interval = result.interval
    return {
        "name": result.name,
        "value": _number(result.value),
        "unit": result.unit,
        "lower": _number(interval.lower) if interval else None,
        "upper": _number(interval.upper) if interval else None,
        "level": _number(interval.level) if interval else None,
        "estimate": _number(result.value if result.estimate is None else result.estimate),
        "status": str(result.status),
        "reasons": [asdict(reason) for reason in result.reasons],
        "method": result.how,
        "budget": [
            {
                "cause": each.cause,
                "change": _number(each.change),
                "share": _number(share),
                "common": each.is_common,
            }
            for each, share in zip(result.budget, result.shares, strict=True)
        ],
    }


def _number(value: float | None) -> float | None:
    """The number itself; None for what JSON cannot say (NaN, infinities)."""
    return float(value) if value is not None and isfinite(value) else None
