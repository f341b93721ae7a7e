"""Write test sheets from the exports in a folder, from options, or from a campaign table."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from labpipe.errors import Fault, ReadError, UsageError, error_text, nearest
from labpipe.process.sheet_inference import (
    InferredTest,
    file_names,
    folders_of_tests,
    infer_test,
    infer_tests,
)
from labpipe.protocol.load import find_protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME, test_sheet_faults, write_test_sheet
from labpipe.protocol.source import ROLES
from labpipe.readers.workbooks import Cell, read_campaign_sheet
from labpipe.store.replace import replacing, storing

_PLAIN = ("date", "operator")
_NEEDED = ("test", "protocol", "type", "spool", "sample")
DIMENSIONS = ("length", "span", "width", "thickness", "diameter")
"""Dimensions of a specimen that have a column of their own."""
BUNDLE = {
    "bundle_wires": "wires",
    "bundle_number": "number",
    "arrangement": "arrangement",
    "tape": "tape",
    "taping": "taping",
    "conduit": "conduit",
    "conduit_bore": "conduit_bore",
}
"""Columns of a harness bundle and their keys in its block."""
LABELS = "labels."
"""Prefix of columns that are labels of the specimen."""
COLUMNS = (*_NEEDED, *_PLAIN, *DIMENSIONS, *BUNDLE, *ROLES, "because")
"""Columns of a campaign table, in addition to dotted keys of the protocol and labels."""
_UNIT_IN_HEADING = re.compile(r"([^(\[]+)[(\[](.+)[)\]]")


@dataclass(frozen=True, slots=True)
class WrittenSheet:
    """A test sheet of a row of a campaign table, or inferred from the folder of the test.

    Parameters
    ----------
    path : of the test sheet
    kept : whether it existed already and was not changed
    remarks : sentences on the sources of the values, contradictions and missing exports
    open : keys to be filled in
    """

    path: Path
    kept: bool = False
    remarks: tuple[str, ...] = ()
    open: tuple[str, ...] = ()


def write_inferred_sheets(
    folder: Path,
    stated: Mapping[str, str],
    *,
    overwrite: bool = False,
) -> Iterator[WrittenSheet]:
    """Infer and write the test sheet of a folder, or of each folder of a campaign.

    Parameters
    ----------
    folder : of a test, or of a campaign
    stated : text by column of `COLUMNS`, by label (``labels.cured``), or by dotted key of the
        protocol; they have priority over inferred values
    overwrite : whether existing test sheets are replaced; in a campaign they are kept otherwise

    Yields
    ------
    Each test sheet. Required values that cannot be inferred are marked in it, to be filled in.

    Raises
    ------
    UsageError
        If stated values are wrong (all of them in one message), or the only sheet exists already.
    StoreError
        If the file cannot be written.
    """
    unknown = [_unknown(column, folder, column) for column in stated if not _is_column(column)]
    if unknown:
        raise UsageError("\n".join(unknown))
    below = folders_of_tests(folder)
    existing = [path for path in below or [folder] if (path / SHEET_NAME).exists()]
    if existing == [folder] and not overwrite:
        remedy, actual, path = "Edit it, or ask to overwrite it.", "an existing one", folder
        message = error_text(
            path / SHEET_NAME, "", expected="no such file yet", found=actual, remedy=remedy
        )
        raise UsageError(message)
    if not below:
        yield write_inferred_sheet(infer_test(folder, stated))
        return
    kept = [] if overwrite else existing
    yield from (WrittenSheet(path / SHEET_NAME, kept=True) for path in kept)
    for test in infer_tests([path for path in below if path not in kept], stated):
        yield write_inferred_sheet(test)


def write_inferred_sheet(test: InferredTest) -> WrittenSheet:
    """Write the test sheet of an inferred test.

    Parameters
    ----------
    test : from `infer_test`

    Raises
    ------
    UsageError
        If a value is wrong; all of them are in one message.
    StoreError
        If the file cannot be written.
    """
    path, data = test.folder / SHEET_NAME, _inferred_data(test)
    faults = _faults(test.values, {}, data, path, left_open=test.open)
    if faults:
        raise UsageError("\n".join(faults))
    _write(path, data)
    return WrittenSheet(path, False, test.remarks, test.open)


def _inferred_data(test: InferredTest) -> dict[str, object]:
    """Arrange inferred values into the blocks of a test sheet; None for those to be filled in."""
    open_values = dict.fromkeys(key for key in test.open if key in (*_NEEDED, *DIMENSIONS))
    files = {role: test.files.get(role) for role in ROLES if role in {*test.files, *test.open}}
    shared = dict(test.blocks.get("specimen", {}))
    data = _sheet_data({**test.values, **open_values}, files)
    specimen = shared | _block(data, "specimen")
    if labels := _block(shared, "labels") | _block(_block(data, "specimen"), "labels"):
        specimen["labels"] = labels
    overrides = test.blocks.get("overrides")
    return data | {"specimen": specimen} | ({"overrides": overrides} if overrides else {})


def _block(data: Mapping[str, object], key: str) -> dict[str, object]:
    block = data.get(key)
    return dict(block) if isinstance(block, Mapping) else {}


def new_from_sheet(sheet: Path, folder: Path, *, overwrite: bool = False) -> list[WrittenSheet]:
    """Write one test sheet per row of a campaign table.

    Parameters
    ----------
    sheet : xlsx or csv with the columns `COLUMNS`, in any order; ``length (mm)`` states a unit for
        the whole column; a column may also be a label, or a dotted key of the protocol
    folder : of the campaign, with a folder for each test
    overwrite : whether existing test sheets are replaced; otherwise they are kept

    Returns
    -------
    The test sheets, in the order of the table.

    Raises
    ------
    ReadError
        If the table cannot be read or has faults: all are in one message, each with its cell, and
        nothing is written.
    StoreError
        If a file cannot be written.
    """
    table = read_campaign_sheet(sheet)
    columns = [_column(cell.text) for cell in table.heading]
    if faults := list(_heading_faults(table.heading, [name for name, _ in columns], sheet)):
        raise ReadError("\n".join(faults))
    tests, names = [], set[str]()
    for row in table.rows:
        cells = [(*column, cell) for column, cell in zip(columns, row, strict=True)]
        values = {name: _with_unit(cell.text, unit) for name, unit, cell in cells if cell.text}
        places = {name: cell.place for name, _, cell in cells}
        files = {role: file_names(values[role]) for role in ROLES if role in values}
        data, test = _sheet_data(values, files), values.get("test", "")
        faults += _faults(values, places, data, sheet, beside=folder / test)
        if test and test.casefold() in names:  # some file systems take A1 and a1 for one folder
            place, remedy = places["test"], "Give each test another name."
            actual = f"{test!r} again"
            faults.append(
                error_text(sheet, place, expected="each test once", found=actual, remedy=remedy)
            )
        names.add(test.casefold())
        tests.append((folder / test / SHEET_NAME, data, files))
    if faults:
        raise ReadError("\n".join(faults))
    sheets = []
    for path, data, files in tests:
        kept = path.exists() and not overwrite
        missing = [x for names in files.values() for x in names if not (path.parent / x).exists()]
        remarks = (f"not there yet: {', '.join(missing)}",) if missing and not kept else ()
        if not kept:
            _write(path, data)
        sheets.append(WrittenSheet(path, kept, remarks))
    return sheets


def _column(heading: str) -> tuple[str, str]:
    """Split a heading into the name of the column and the unit of its numbers."""
    match = _UNIT_IN_HEADING.fullmatch(heading)
    name, unit = (match[1].strip(), match[2]) if match else (heading, "")
    return (name if "." in name else name.casefold()), unit


def _with_unit(text: str, unit: str) -> str:
    is_number = re.fullmatch(r"[-+0-9.eE]+", text) is not None
    return f"{text} {unit}" if unit and is_number else text


def _is_column(name: str) -> bool:
    return name in COLUMNS or "." in name


def _heading_faults(heading: Sequence[Cell], names: Sequence[str], sheet: Path) -> Iterator[str]:
    for number, (name, cell) in enumerate(zip(names, heading, strict=True)):
        if not _is_column(name):
            yield _unknown(cell.text, sheet, cell.place)
        elif name in names[:number]:
            actual, remedy = f"{name!r} again", "Remove or rename one of them."
            yield error_text(
                sheet, cell.place, expected="each column once", found=actual, remedy=remedy
            )
    for name in _NEEDED:
        if name not in names:
            place, expected = heading[0].place, f"a column {name!r}"
            yield error_text(sheet, place, expected=expected, found="none", remedy="Add it.")


def _unknown(name: str, file: Path, place: str) -> str:
    near_columns = nearest(name, list(COLUMNS))
    expected = f"one of {', '.join(repr(word) for word in near_columns)}, ..., or a dotted key"
    remedy = f"Did you mean {near_columns[0]!r}?"
    return error_text(file, place, expected=expected, found=repr(name), remedy=remedy)


def _faults(
    values: Mapping[str, str],
    places: Mapping[str, str],
    data: Mapping[str, object],
    file: Path,
    *,
    beside: Path | None = None,
    left_open: Sequence[str] = (),
) -> list[str]:
    """Describe the faults of one test, each with its cell or option, except open values."""
    faults = [
        fault for fault in test_sheet_faults(data) if not set(map(str, fault.path)) & set(left_open)
    ]
    protocol = values.get("protocol")
    path = find_protocol(protocol, beside=beside or file.parent) if protocol else None
    texts = []
    for fault in [*faults, path] if isinstance(path, Fault) else faults:
        column = _column_of(fault)
        place = places.get(column) or places.get("test")
        place = f"{place} ({column})" if place else column
        expected, remedy = fault.expected, fault.remedy
        if fault.missing:
            expected, remedy = f"a value for {column!r}", "Fill it in."
        found = "none" if fault.missing else fault.found
        texts.append(error_text(file, place, expected=expected, found=found, remedy=remedy))
    return [text.rstrip() for text in texts]


def _column_of(fault: Fault) -> str:
    path = [str(part) for part in fault.path]
    if path[:2] == ["specimen", "bundle"]:
        key = fault.missing or path[2]
        return next(column for column, filled in BUNDLE.items() if filled == key)
    if fault.missing:
        return fault.missing
    if path[:2] == ["specimen", "labels"]:
        return f"{LABELS}{path[2]}"
    return path[1] if path[0] in ("specimen", "files", "overrides") and len(path) > 1 else path[0]


def _sheet_data(
    values: Mapping[str, str | None], files: Mapping[str, Sequence[str] | None]
) -> dict[str, object]:
    """Arrange values by column and files by role into the blocks of a test sheet."""

    def block(columns: Mapping[str, str]) -> dict[str, object]:
        return {key: values[column] for column, key in columns.items() if column in values}

    labels = {key: key.removeprefix(LABELS) for key in values if key.startswith(LABELS)}
    dotted = [key for key in values if "." in key and key not in labels]
    because = block({"because": "because"})
    specimen = block({key: key for key in (*_NEEDED[2:], *DIMENSIONS)})
    blocks = {"bundle": block(BUNDLE), "labels": block(labels)}
    data = block({key: key for key in _NEEDED[:2]})
    data["specimen"] = specimen | {key: inner for key, inner in blocks.items() if inner}
    data |= block({key: key for key in _PLAIN})
    data["files"] = {
        role: names[0] if names is not None and len(names) == 1 else names and list(names)
        for role, names in files.items()
    } or None
    overrides = {key: {"value": values[key]} | because for key in dotted}
    return data | ({"overrides": overrides} if overrides else {})


def _write(path: Path, data: Mapping[str, object]) -> None:
    """Write a test sheet completely or not at all."""
    with storing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        part.write_text(write_test_sheet(data), encoding="utf-8", newline="\n")
