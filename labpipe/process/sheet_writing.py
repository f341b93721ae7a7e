"""Write test sheets from the exports in a folder, from options, or from a campaign table."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labpipe.errors import Fault, ReadError, UsageError, format_error, sort_by_likeness
from labpipe.messages import format_sentence
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
from labpipe.readers.workbooks import Cell, read_campaign_sheet
from labpipe.store.replace import replacing, storing

_REQUIRED = ("test", "protocol", "type", "spool", "sample")
DIMENSIONS = ("length", "gauge_length", "span", "width", "thickness", "diameter")
"""Dimensions of a specimen that have a column of their own."""
BUNDLE_KEY_BY_COLUMN = {"bundle_wires": "wires", "bundle_number": "number"} | {
    key: key for key in ("arrangement", "tape", "taping", "conduit", "conduit_bore")
}
"""Columns of a harness bundle and their keys in its block."""
_KEY_PATHS = (
    {key: (key,) for key in ("test", "protocol")}
    | {key: ("specimen", key) for key in ("type", "spool", "sample", *DIMENSIONS)}
    | {column: ("specimen", "bundle", key) for column, key in BUNDLE_KEY_BY_COLUMN.items()}
    | {key: (key,) for key in ("date", "operator")}
    | {role: ("files", role) for role in ROLES}
)
"""Place of each column in a test sheet, in the order of the sheet."""
DOTTED_BLOCKS = ("section", "labels", "observed")
"""Blocks of the specimen with columns such as ``section.area`` and ``labels.cured``."""
COLUMNS = (*_KEY_PATHS, "because")
"""Columns of a campaign table, in addition to labels and dotted keys of the protocol."""
_UNIT_IN_HEADING = re.compile(r"([^(\[]+)[(\[](.+)[)\]]")


@dataclass(frozen=True, slots=True)
class WrittenSheet:
    """A test sheet that was written or kept.

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
    folder: Path, stated: Mapping[str, str], *, overwrite: bool = False
) -> Iterator[WrittenSheet]:
    """Infer and write the test sheet of a folder, or of each folder of a campaign.

    Parameters
    ----------
    folder : of a test, or of a campaign
    stated : text by column of `COLUMNS`, by label (``labels.cured``), or by dotted key of the
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
        If the file cannot be written.
    """
    faults = [x for column in stated for x in _unknown_column(column, column, folder, column)]
    _raise_if_any(UsageError, faults)
    test_folders = list_test_folders(folder)
    existing = [path for path in test_folders or [folder] if (path / SHEET_NAME).exists()]
    if existing == [folder] and not overwrite:
        raise UsageError.about("process.sheet_exists", folder / SHEET_NAME)
    if not test_folders:
        yield write_inferred_sheet(infer_test(folder, stated))
        return
    kept_folders = [] if overwrite else existing
    yield from (WrittenSheet(path / SHEET_NAME, kept=True) for path in kept_folders)
    for test in infer_tests([path for path in test_folders if path not in kept_folders], stated):
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
    path = test.folder / SHEET_NAME
    open_values = {column: None for column in test.open if column in _KEY_PATHS or "." in column}
    data = _arrange({**test.values, **test.files, **open_values})
    plan, specimen = dict[str, Any](test.blocks.get("specimen", {})), data["specimen"]
    if labels := {**plan.get("labels", {}), **specimen.get("labels", {})}:
        specimen["labels"] = labels
    data["specimen"] = plan | specimen
    if overrides := test.blocks.get("overrides"):
        data["overrides"] = overrides
    _raise_if_any(UsageError, _describe_faults(test.values, {}, data, path, open_keys=test.open))
    _write(path, data)
    return WrittenSheet(path, False, test.remarks, test.open)


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
    columns = [_parse_heading(cell.text) for cell in table.heading]
    _raise_if_any(ReadError, _heading_faults(table.heading, [name for name, _ in columns], sheet))
    faults, rows, names = list[str](), [], set[str]()
    for row in table.rows:
        cells = [(*column, cell) for column, cell in zip(columns, row, strict=True)]
        values = {name: _add_unit(cell.text, unit) for name, unit, cell in cells if cell.text}
        places = {name: cell.place for name, _, cell in cells}
        files = {role: split_file_names(values[role]) for role in ROLES if role in values}
        data, test = _arrange({**values, **files}), values.get("test", "")
        faults += _describe_faults(values, places, data, sheet, test_folder=folder / test)
        if test and test.casefold() in names:  # some file systems take A1 and a1 for one folder
            faults.append(
                str(ReadError.about("process.row_twice", sheet, places["test"], test=test))
            )
        names.add(test.casefold())
        rows.append((folder / test, data, [name for several in files.values() for name in several]))
    _raise_if_any(ReadError, faults)
    sheets = []
    for test_folder, data, exports in rows:
        path = test_folder / SHEET_NAME
        if path.exists() and not overwrite:
            sheets.append(WrittenSheet(path, kept=True))
            continue
        missing = [name for name in exports if not (test_folder / name).exists()]
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


def _arrange(values: Mapping[str, object]) -> dict[str, Any]:
    """Arrange values into the blocks of a test sheet.

    Parameters
    ----------
    values : text by column, names of exports by role; None for what is to be filled in
    """
    paths = {column: path for column, path in _KEY_PATHS.items() if column in values}
    dotted = [column.partition(".") for column in values if "." in column]
    paths |= {f"{x}.{key}": ("specimen", x, key) for x, _, key in dotted if x in DOTTED_BLOCKS}
    data: dict[str, Any] = {}
    for column, (*blocks, key) in paths.items():
        block = data
        for name in blocks:
            block = block.setdefault(name, {})
        value = values[column]
        if isinstance(value, tuple):
            value = value[0] if len(value) == 1 else list(value)
        block[key] = value
    data.setdefault("specimen", {})
    data.setdefault("files", None)
    because = {"because": values["because"]} if "because" in values else {}
    overrides = {
        name: {"value": values[name]} | because
        for name in map("".join, dotted)
        if name not in paths
    }
    return data | ({"overrides": overrides} if overrides else {})


def _raise_if_any(error: type[UsageError | ReadError], faults: Iterator[str] | list[str]) -> None:
    if texts := list(faults):
        raise error("\n".join(texts))


def _heading_faults(heading: Sequence[Cell], names: Sequence[str], sheet: Path) -> Iterator[str]:
    for number, (name, cell) in enumerate(zip(names, heading, strict=True)):
        yield from _unknown_column(name, cell.text, sheet, cell.place)
        if name in names[:number]:
            yield str(ReadError.about("process.column_twice", sheet, cell.place, name=name))
    for name in _REQUIRED:
        if name not in names:
            yield str(ReadError.about("process.column_missing", sheet, heading[0].place, name=name))


def _unknown_column(name: str, written: str, file: Path, place: str) -> list[str]:
    """Describe a column that is neither known nor a dotted key."""
    if name in COLUMNS or "." in name:
        return []
    columns = sort_by_likeness(written, list(COLUMNS))
    near, likely = ", ".join(map(repr, columns)), columns[0]
    error = ReadError.about(
        "process.column_unknown", file, place, near=near, name=written, likely=likely
    )
    return [str(error)]


def _describe_faults(
    values: Mapping[str, str],
    places: Mapping[str, str],
    data: Mapping[str, object],
    file: Path,
    *,
    test_folder: Path | None = None,
    open_keys: Sequence[str] = (),
) -> Iterator[str]:
    """Describe the faults of one test, each with its cell or option.

    Parameters
    ----------
    values, data : by column, and arranged as a test sheet
    places : cell of each column; empty if the values are options
    file : the table, or the test sheet to be written
    test_folder : in which to look for protocols; that of `file` if None
    open_keys : keys to be filled in, whose faults are not reported
    """
    is_open = {key.rpartition(".")[2] for key in open_keys}
    faults = [x for x in find_sheet_faults(data) if not set(map(str, x.path)) & is_open]
    protocol = values.get("protocol")
    protocol_file = find_protocol(protocol, beside=test_folder or file.parent) if protocol else None
    for fault in [*faults, protocol_file] if isinstance(protocol_file, Fault) else faults:
        column = _column_of_fault(fault)
        place = places.get(column) or places.get("test")
        place = f"{place} ({column})" if place else column
        expected, actual, remedy = fault.expected, fault.found, fault.remedy
        if fault.missing:
            expected, actual, remedy = f"a value for {column!r}", "none", "Fill it in."
        yield format_error(file, place, expected=expected, found=actual, remedy=remedy).rstrip()


def _column_of_fault(fault: Fault) -> str:
    """Return the column whose value is at fault or missing."""
    path = tuple(str(part) for part in (*fault.path, fault.missing) if part != "")
    for column, column_path in _KEY_PATHS.items():
        if path[: len(column_path)] == column_path:
            return column
    if fault.missing:
        return fault.missing
    if path[0] == "specimen" and len(path) > 2 and path[1] in DOTTED_BLOCKS:
        return f"{path[1]}.{path[2]}"
    return path[1] if path[0] == "overrides" and len(path) > 1 else path[-1]


def _write(path: Path, data: Mapping[str, object]) -> None:
    """Write a test sheet completely or not at all."""
    with storing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        part.write_text(write_test_sheet(data), encoding="utf-8", newline="\n")
