"""Write test sheets from the exports in a folder, from options, or from a campaign table."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labpipe.errors import Fault, ReadError, UsageError, format_error, sort_by_likeness
from labpipe.messages import format_error_parts, format_sentence
from labpipe.process.sheet_inference import (
    InferredTest,
    infer_test,
    infer_tests,
    list_test_folders,
    split_file_names,
)
from labpipe.protocol.load import find_protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME, find_sheet_faults, write_test_sheet
from labpipe.protocol.source import ROLES
from labpipe.readers.workbooks import Table, read_campaign_sheet
from labpipe.store.replace import map_errors, replace_file

_REQUIRED = ("test", "protocol", "type", "spool", "sample")
_DIMENSIONS = ("length", "gauge_length", "span", "width", "thickness", "diameter")
_BUNDLE_KEYS = {"bundle_wires": "wires", "bundle_number": "number"} | {
    key: key for key in ("arrangement", "tape", "taping", "conduit", "conduit_bore")
}
_KEY_PATHS = (
    {key: (key,) for key in ("test", "protocol")}
    | {key: ("specimen", key) for key in ("type", "spool", "sample", *_DIMENSIONS)}
    | {column: ("specimen", "bundle", key) for column, key in _BUNDLE_KEYS.items()}
    | {key: (key,) for key in ("date", "operator")}
    | {role: ("files", role) for role in ROLES}
)
"""Place of each column in a test sheet, in the order of the sheet."""
_DOTTED_BLOCKS = ("section", "labels", "observed")
"""Blocks of the specimen with columns such as ``section.area`` and ``labels.cured``."""
TABLE_COLUMNS = (*_KEY_PATHS, "because")
"""Columns of a campaign table without a dot in their names."""
_UNIT_IN_HEADING = re.compile(r"([^(\[]+)[(\[](.+)[)\]]")


@dataclass(frozen=True, slots=True)
class WrittenSheet:
    """A test sheet that was written or kept.

    Parameters
    ----------
    path : path of the test sheet
    kept : whether it existed already and was not changed
    remarks : sentences on the sources of the values, contradictions and missing exports
    open_keys : keys to be filled in
    """

    path: Path
    kept: bool = False
    remarks: tuple[str, ...] = ()
    open_keys: tuple[str, ...] = ()


def write_inferred_sheets(
    folder: Path, stated: Mapping[str, str], *, overwrite: bool = False
) -> Iterator[WrittenSheet]:
    """Infer and write the test sheet of a folder, or of each folder of a campaign.

    Parameters
    ----------
    folder : folder of a test or of a campaign
    stated : text by column of `TABLE_COLUMNS`, by label (``labels.cured``), or by dotted key of the
        protocol; it has priority over inferred values
    overwrite : whether existing test sheets are replaced; in a campaign they are kept otherwise

    Yields
    ------
    Each test sheet. Required values that cannot be inferred are marked in it, to be filled in.

    Raises
    ------
    UsageError
        If stated values are wrong (all of them in one message), or the only sheet exists already.
    StoreError
        If a file cannot be written.
    """
    if faults := [x for column in stated for x in _find_unknown(column, column, folder, column)]:
        raise UsageError("\n".join(map(str, faults)))
    test_folders = list_test_folders(folder)
    if not test_folders:
        if (folder / SHEET_NAME).exists() and not overwrite:
            raise UsageError.about("process.sheet_exists", folder / SHEET_NAME)
        yield write_inferred_sheet(infer_test(folder, stated))
        return
    existing = [path for path in test_folders if not overwrite and (path / SHEET_NAME).exists()]
    yield from (WrittenSheet(path / SHEET_NAME, kept=True) for path in existing)
    for test in infer_tests([path for path in test_folders if path not in existing], stated):
        yield write_inferred_sheet(test)


def write_inferred_sheet(test: InferredTest) -> WrittenSheet:
    """Write the test sheet of an inferred test.

    Parameters
    ----------
    test : inferred test

    Raises
    ------
    UsageError
        If a value is wrong; all of them are in one message.
    StoreError
        If the file cannot be written.
    """
    path = test.folder / SHEET_NAME
    open_values = {
        column: None for column in test.open_keys if column in _KEY_PATHS or "." in column
    }
    data = _arrange({**test.values, **test.files, **open_values})
    _add_blocks(data, test.blocks)
    if faults := [*_list_faults(data, test.values, {}, path, open_keys=test.open_keys)]:
        raise UsageError("\n".join(faults))
    _write(path, data)
    return WrittenSheet(path, False, test.remarks, test.open_keys)


def write_table_sheets(sheet: Path, folder: Path, *, overwrite: bool = False) -> list[WrittenSheet]:
    """Write one test sheet per row of a campaign table.

    Parameters
    ----------
    sheet : xlsx or csv with columns of `TABLE_COLUMNS`, in any order; ``length (mm)`` states a unit
        for the whole column; a column may also be a label, or a dotted key of the protocol
    folder : folder of the campaign, with a folder for each test
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
    columns = [_parse_heading(cell.text) for cell in table.heading]
    if heading_faults := [*_list_heading_faults(table, [name for name, _ in columns], sheet)]:
        raise ReadError("\n".join(map(str, heading_faults)))
    faults = list[str]()
    rows: dict[str, tuple[dict[str, Any], list[str]]] = {}
    for row in table.rows:
        cells = [(*column, cell) for column, cell in zip(columns, row, strict=True)]
        values = {name: _add_unit(cell.text, unit) for name, unit, cell in cells if cell.text}
        places = {name: cell.place for name, _, cell in cells}
        data, test = _arrange(values), values.get("test", "")
        faults += _list_faults(data, values, places, sheet, test_folder=folder / test)
        if test and test.casefold() in rows:  # some file systems take A1 and a1 for one folder
            error = ReadError.about("process.row_twice", sheet, places["test"], test=test)
            faults.append(str(error))
        exports = [name for role in ROLES for name in split_file_names(values.get(role, ""))]
        rows[test.casefold()] = (data, exports)
    if faults:
        raise ReadError("\n".join(faults))
    sheets = []
    for data, exports in rows.values():
        path = folder / data["test"] / SHEET_NAME
        if path.exists() and not overwrite:
            sheets.append(WrittenSheet(path, kept=True))
            continue
        missing = [name for name in exports if not (path.parent / name).exists()]
        remark = format_sentence("process.not_there_yet", names=", ".join(missing))
        _write(path, data)
        sheets.append(WrittenSheet(path, remarks=(remark,) if missing else ()))
    return sheets


def _parse_heading(heading: str) -> tuple[str, str]:
    """Split a heading into the name of the column and the unit of its numbers."""
    match = _UNIT_IN_HEADING.fullmatch(heading)
    name, unit = (match[1].strip(), match[2]) if match else (heading, "")
    return (name if "." in name else name.casefold()), unit


def _add_unit(text: str, unit: str) -> str:
    """Add the unit of a heading to a number without one."""
    is_number = re.fullmatch(r"[-+0-9.eE]+", text) is not None
    return f"{text} {unit}" if unit and is_number else text


def _find_path(column: str) -> tuple[str, ...]:
    """Return the path of a column in a test sheet; a key of the protocol is an override."""
    block, _, key = column.partition(".")
    dotted = ("specimen", block, key) if block in _DOTTED_BLOCKS else ("overrides", column, "value")
    return _KEY_PATHS.get(column, dotted)


def _arrange(values: Mapping[str, object]) -> dict[str, Any]:
    """Arrange values into the blocks of a test sheet.

    Parameters
    ----------
    values : text by column, or names of exports; None for what is to be filled in
    """
    data: dict[str, Any] = {}
    columns = [column for column in _KEY_PATHS if column in values]
    for column in [*columns, *(column for column in values if "." in column)]:
        *blocks, key = _find_path(column)
        block, value = data, values[column]
        for name in blocks:
            block = block.setdefault(name, {})
        if column in ROLES and isinstance(value, str):
            value = split_file_names(value)
        if isinstance(value, tuple):
            value = value[0] if len(value) == 1 else list(value)
        block[key] = value
    overrides = data.pop("overrides", {})
    if "because" in values:
        overrides = {
            key: entry | {"because": values["because"]} for key, entry in overrides.items()
        }
    data.setdefault("specimen", {})
    data.setdefault("files", None)
    return data | ({"overrides": overrides} if overrides else {})


def _add_blocks(data: dict[str, Any], blocks: Mapping[str, Any]) -> None:
    """Add blocks to nested data; values of the data have priority."""
    for key, value in blocks.items():
        if isinstance(data.get(key), dict) and isinstance(value, Mapping):
            _add_blocks(data[key], value)
        elif value:
            data.setdefault(key, value)


def _list_heading_faults(table: Table, names: Sequence[str], sheet: Path) -> Iterator[ReadError]:
    for number, (name, cell) in enumerate(zip(names, table.heading, strict=True)):
        yield from _find_unknown(name, cell.text, sheet, cell.place)
        if name in names[:number]:
            yield ReadError.about("process.column_twice", sheet, cell.place, name=name)
    place = table.heading[0].place
    for name in _REQUIRED:
        if name not in names:
            yield ReadError.about("process.column_missing", sheet, place, name=name)


def _find_unknown(name: str, written: str, file: Path, place: str) -> Iterator[ReadError]:
    """Yield the error of a column that is neither known nor a dotted key."""
    if name not in TABLE_COLUMNS and "." not in name:
        nearest = sort_by_likeness(written, list(TABLE_COLUMNS))
        nearest_names, likely = ", ".join(map(repr, nearest)), nearest[0]
        yield ReadError.about(
            "process.column_unknown", file, place, near=nearest_names, name=written, likely=likely
        )


def _list_faults(
    data: Mapping[str, object],
    values: Mapping[str, str],
    places: Mapping[str, str],
    file: Path,
    *,
    test_folder: Path | None = None,
    open_keys: Sequence[str] = (),
) -> Iterator[str]:
    """Yield the faults of one test, each with its cell or option.

    Parameters
    ----------
    data, values : arranged as a test sheet, and by column
    places : cell of each column; empty if the values are options
    file : the table, or the test sheet to be written
    test_folder : folder in which to look for protocols; None for that of the file
    open_keys : keys to be filled in, whose faults are not reported
    """
    is_open = {key.rpartition(".")[2] for key in open_keys}
    faults = [x for x in find_sheet_faults(data) if not set(map(str, x.path)) & is_open]
    if "protocol" in values:
        protocol = find_protocol(values["protocol"], sheet_folder=test_folder or file.parent)
        faults += [protocol] if isinstance(protocol, Fault) else []
    paths = {x: _find_path(x) for x in (*_KEY_PATHS, *values) if "." in x or x in _KEY_PATHS}
    for fault in faults:
        path = (*map(str, fault.path), *([fault.missing] if fault.missing else []))
        column = next((x for x in paths if path[: len(paths[x])] == paths[x]), path[-1])
        place = places.get(column) or places.get("test")
        parts = {"expected": fault.expected, "found": fault.found, "remedy": fault.remedy}
        if fault.missing:
            parts = format_error_parts("process.value_missing", column=column)
        yield format_error(file, f"{place} ({column})" if place else column, **parts).rstrip()


def _write(path: Path, data: Mapping[str, object]) -> None:
    """Write a test sheet completely or not at all."""
    with map_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(path) as part:
        part.write_text(write_test_sheet(data), encoding="utf-8", newline="\n")
