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
from labpipe.protocol.sheet_grammar import SHEET_NAME, TestSheet, format_test_sheet
from labpipe.protocol.source import ROLES
from labpipe.readers.workbooks import Table, read_campaign_sheet
from labpipe.store.replace import map_errors, replace_file

_REQUIRED_COLUMNS = ("test", "protocol", "type", "spool", "sample")
"""Columns that each campaign table has."""
_DIMENSIONS = ("length", "gauge_length", "span", "width", "thickness", "diameter")
"""Columns of the dimensions of the specimen."""
_BUNDLE_KEYS = {"bundle_wires": "wires", "bundle_number": "number"} | {
    key: key for key in ("arrangement", "tape", "taping", "conduit", "conduit_bore")
}
"""Key of each column of a bundle in the block ``bundle`` of the specimen."""
_KEY_PATHS = (
    {key: (key,) for key in ("test", "protocol")}
    | {key: ("specimen", key) for key in ("type", "spool", "sample", *_DIMENSIONS)}
    | {column: ("specimen", "bundle", key) for column, key in _BUNDLE_KEYS.items()}
    | {key: (key,) for key in ("date", "operator")}
    | {role: ("files", role) for role in ROLES}
)
"""Path of each column in a test sheet, in the order of the sheet."""
_DOTTED_BLOCKS = ("section", "labels", "observed")
"""Blocks of the specimen with columns such as ``section.area`` and ``labels.cured``."""
TABLE_COLUMNS = (*_KEY_PATHS, "because")
"""Columns of a campaign table without a dot in their names."""
_UNIT_IN_HEADING = re.compile(r"([^(\[]+)[(\[](.+)[)\]]")
"""Heading with a unit, such as ``length (mm)`` or ``length [mm]``."""


@dataclass(frozen=True, slots=True)
class WrittenSheet:
    """Test sheet that was written, or existed and was kept.

    Parameters
    ----------
    path : path of the test sheet
    is_kept : whether the sheet existed before and was not changed
    remarks : sentences on the sources of the values, contradictions and missing exports
    open_keys : keys whose values the user must fill in
    """

    path: Path
    is_kept: bool = False
    remarks: tuple[str, ...] = ()
    open_keys: tuple[str, ...] = ()


def write_inferred_sheets(
    folder: Path, stated_values: Mapping[str, str], *, overwrite: bool = False
) -> Iterator[WrittenSheet]:
    """Infer and write the test sheet of a folder, or of each folder of a campaign.

    Parameters
    ----------
    folder : folder of a test or of a campaign
    stated_values : texts of values that replace inferred values. A key is a column of
        `TABLE_COLUMNS`, a label (``labels.cured``), or a dotted key of the protocol
    overwrite : whether existing test sheets are replaced; if False, those of a campaign are kept

    Yields
    ------
    The test sheets. Required values that cannot be inferred are left open for the user.

    Raises
    ------
    UsageError
        If stated values are not valid, or if the sheet of a single test exists already. One message
        lists all invalid values.
    StoreError
        If a file cannot be written.
    """
    errors = [error for name in stated_values for error in _check_column(name, name, folder, name)]
    if errors:
        raise UsageError("\n".join(map(str, errors)))
    test_folders = list_test_folders(folder)
    if not test_folders:
        if (folder / SHEET_NAME).exists() and not overwrite:
            raise UsageError.about("process.sheet_exists", folder / SHEET_NAME)
        yield write_inferred_sheet(infer_test(folder, stated_values))
        return
    kept_folders = [path for path in test_folders if not overwrite and (path / SHEET_NAME).exists()]
    yield from (WrittenSheet(path / SHEET_NAME, is_kept=True) for path in kept_folders)
    new_folders = [path for path in test_folders if path not in kept_folders]
    for test in infer_tests(new_folders, stated_values):
        yield write_inferred_sheet(test)


def write_inferred_sheet(test: InferredTest) -> WrittenSheet:
    """Write the test sheet of an inferred test.

    Parameters
    ----------
    test : inferred test

    Raises
    ------
    UsageError
        If values are not valid; the message lists all of them.
    StoreError
        If the file cannot be written.
    """
    path = test.folder / SHEET_NAME
    open_columns = [key for key in test.open_keys if key in _KEY_PATHS or "." in key]
    data = _arrange_sheet({**test.values, **test.files, **dict.fromkeys(open_columns)})
    _add_blocks(data, test.blocks)
    if faults := [*_list_faults(data, test.values, {}, path, open_keys=test.open_keys)]:
        raise UsageError("\n".join(faults))
    _write_sheet(path, data)
    return WrittenSheet(path, remarks=test.remarks, open_keys=test.open_keys)


def write_table_sheets(file: Path, folder: Path, *, overwrite: bool = False) -> list[WrittenSheet]:
    """Write one test sheet per row of a campaign table.

    Parameters
    ----------
    file : xlsx or csv file of the table. Its columns are `TABLE_COLUMNS`, labels, or dotted keys of
        the protocol, in any order. A heading may state the unit of its column, as in
        ``length (mm)``
    folder : folder of the campaign, with a folder for each test
    overwrite : whether existing test sheets are replaced; if False, they are kept

    Returns
    -------
    The test sheets, in the order of the table.

    Raises
    ------
    ReadError
        If the table cannot be read or has faults. The message lists all faults, each with its cell,
        and nothing is written.
    StoreError
        If a file cannot be written.
    """
    table = read_campaign_sheet(file)
    columns = [_parse_heading(cell.text) for cell in table.heading]
    if errors := [*_check_headings(table, [name for name, _ in columns], file)]:
        raise ReadError("\n".join(map(str, errors)))
    faults = list[str]()
    rows: dict[str, tuple[dict[str, Any], list[str]]] = {}
    for row in table.rows:
        cells = [(*column, cell) for column, cell in zip(columns, row, strict=True)]
        values = {name: _add_unit(cell.text, unit) for name, unit, cell in cells if cell.text}
        places = {name: cell.place for name, _, cell in cells}
        data, test = _arrange_sheet(values), values.get("test", "")
        faults += _list_faults(data, values, places, file, test_folder=folder / test)
        if test and test.casefold() in rows:  # A1 and a1 are one folder in some file systems
            error = ReadError.about("process.row_twice", file, places["test"], test=test)
            faults.append(str(error))
        exports = [name for role in ROLES for name in split_file_names(values.get(role, ""))]
        rows[test.casefold()] = (data, exports)
    if faults:
        raise ReadError("\n".join(faults))
    sheets = []
    for data, exports in rows.values():
        path = folder / data["test"] / SHEET_NAME
        if path.exists() and not overwrite:
            sheets.append(WrittenSheet(path, is_kept=True))
            continue
        names = ", ".join(name for name in exports if not (path.parent / name).exists())
        remarks = (format_sentence("process.not_there_yet", names=names),) if names else ()
        _write_sheet(path, data)
        sheets.append(WrittenSheet(path, remarks=remarks))
    return sheets


def _parse_heading(heading: str) -> tuple[str, str]:
    """Split a heading into the name of its column and the unit of its numbers, empty if none."""
    match = _UNIT_IN_HEADING.fullmatch(heading)
    name, unit = (match[1].strip(), match[2]) if match else (heading, "")
    return (name if "." in name else name.casefold()), unit


def _add_unit(text: str, unit: str) -> str:
    """Add the unit of a heading to a number without one."""
    is_number = re.fullmatch(r"[-+0-9.eE]+", text) is not None
    return f"{text} {unit}" if unit and is_number else text


def _choose_path(column: str) -> tuple[str, ...]:
    """Choose the path of a column in a test sheet; dotted keys of the protocol are overrides."""
    block, _, key = column.partition(".")
    path = ("specimen", block, key) if block in _DOTTED_BLOCKS else ("overrides", column, "value")
    return _KEY_PATHS.get(column, path)


def _arrange_sheet(values: Mapping[str, object]) -> dict[str, Any]:
    """Arrange values into the blocks of a test sheet.

    Parameters
    ----------
    values : texts, or tuples of the names of exports, keyed by column; None for a value that the
        user fills in
    """
    data: dict[str, Any] = {}
    columns = [column for column in _KEY_PATHS if column in values]
    for column in [*columns, *(column for column in values if "." in column)]:
        *block_names, key = _choose_path(column)
        block, value = data, values[column]
        for name in block_names:
            block = block.setdefault(name, {})
        if column in ROLES and isinstance(value, str):
            value = split_file_names(value)
        if isinstance(value, tuple):
            value = value[0] if len(value) == 1 else list(value)
        block[key] = value
    overrides = data.pop("overrides", {})
    if "because" in values:
        because = {"because": values["because"]}
        overrides = {key: override | because for key, override in overrides.items()}
    data.setdefault("specimen", {})
    data.setdefault("files", None)
    return data | ({"overrides": overrides} if overrides else {})


def _add_blocks(data: dict[str, Any], blocks: Mapping[str, Any]) -> None:
    """Add blocks to the data of a test sheet, without replacing its values."""
    for key, value in blocks.items():
        if isinstance(data.get(key), dict) and isinstance(value, Mapping):
            _add_blocks(data[key], value)
        elif value:
            data.setdefault(key, value)


def _check_headings(table: Table, names: Sequence[str], file: Path) -> Iterator[ReadError]:
    """Yield the errors of unknown, repeated and missing columns."""
    for index, (name, cell) in enumerate(zip(names, table.heading, strict=True)):
        yield from _check_column(name, cell.text, file, cell.place)
        if name in names[:index]:
            yield ReadError.about("process.column_twice", file, cell.place, name=name)
    place = table.heading[0].place
    for name in _REQUIRED_COLUMNS:
        if name not in names:
            yield ReadError.about("process.column_missing", file, place, name=name)


def _check_column(name: str, heading: str, file: Path, place: str) -> Iterator[ReadError]:
    """Yield an error if a column is neither known nor a dotted key."""
    if name not in TABLE_COLUMNS and "." not in name:
        names = sort_by_likeness(heading, list(TABLE_COLUMNS))
        facts = {"similar": ", ".join(map(repr, names)), "likely": names[0], "name": heading}
        yield ReadError.about("process.column_unknown", file, place, **facts)


def _list_faults(
    data: Mapping[str, object],
    values: Mapping[str, str],
    places: Mapping[str, str],
    file: Path,
    *,
    test_folder: Path | None = None,
    open_keys: Sequence[str] = (),
) -> Iterator[str]:
    """Yield messages on the faults of one test, each with its cell or option.

    Parameters
    ----------
    data : values of the test, arranged as a test sheet
    values : texts of the values, keyed by column
    places : name of each cell, keyed by column; empty if the values are options
    file : file of the table, or path of the test sheet to be written
    test_folder : folder in which protocols are searched; None for that of the file
    open_keys : keys that the user fills in, whose faults are not reported
    """
    open_names = {key.rpartition(".")[2] for key in open_keys}
    _, sheet_faults = TestSheet.read(data)
    faults = [fault for fault in sheet_faults if not set(map(str, fault.path)) & open_names]
    if "protocol" in values:
        protocol = find_protocol(values["protocol"], sheet_folder=test_folder or file.parent)
        faults += [protocol] if isinstance(protocol, Fault) else []
    paths = _KEY_PATHS | {column: _choose_path(column) for column in values if "." in column}
    for fault in faults:
        path = (*map(str, fault.path), *([fault.missing] if fault.missing else []))
        column = next((x for x in paths if path[: len(paths[x])] == paths[x]), path[-1])
        place = places.get(column) or places.get("test")
        parts = {"expected": fault.expected, "found": fault.found, "remedy": fault.remedy}
        if fault.missing:
            parts = format_error_parts("process.value_missing", column=column)
        yield format_error(file, f"{place} ({column})" if place else column, **parts).rstrip()


def _write_sheet(path: Path, data: Mapping[str, object]) -> None:
    """Write a test sheet, either completely or not at all."""
    with map_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(path) as temporary_path:
        temporary_path.write_text(format_test_sheet(data), encoding="utf-8", newline="\n")
