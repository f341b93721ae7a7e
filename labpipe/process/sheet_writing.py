"""Write test sheets from the exports in a folder, from options, or from a campaign table."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from labpipe.errors import Fault, ReadError, UsageError, format_error, sort_by_likeness
from labpipe.messages import format_sentence
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

_OPTIONAL_TOP_LEVEL_COLUMNS = ("date", "operator")
_NEEDED = ("test", "protocol", "type", "spool", "sample")
DIMENSIONS = ("length", "span", "width", "thickness", "diameter")
"""Dimensions of a specimen that have a column of their own."""
BUNDLE_KEY_BY_COLUMN = {"bundle_wires": "wires", "bundle_number": "number"} | {
    key: key for key in ("arrangement", "tape", "taping", "conduit", "conduit_bore")
}
"""Columns of a harness bundle and their keys in its block."""
WORDS = ("labels", "observed")
"""Blocks of the specimen whose words have columns such as ``labels.cured``."""
COLUMNS = (
    *_NEEDED,
    *_OPTIONAL_TOP_LEVEL_COLUMNS,
    *DIMENSIONS,
    *BUNDLE_KEY_BY_COLUMN,
    *ROLES,
    "because",
)
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
    folder: Path, stated: Mapping[str, str], *, overwrite: bool = False
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
    _raise_if_any(UsageError, (x for name in stated for x in _unknown(name, name, folder, name)))
    below = folders_of_tests(folder)
    existing = [path for path in below or [folder] if (path / SHEET_NAME).exists()]
    if existing == [folder] and not overwrite:
        raise UsageError.about("process.sheet_exists", folder / SHEET_NAME)
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
    _raise_if_any(UsageError, _faults(test.values, {}, data, path, left_open=test.open))
    _write(path, data)
    return WrittenSheet(path, False, test.remarks, test.open)


def _raise_if_any(error: type[UsageError | ReadError], faults: Iterator[str]) -> None:
    if texts := list(faults):
        raise error("\n".join(texts))


def _inferred_data(test: InferredTest) -> dict[str, object]:
    """Arrange inferred values into the blocks of a test sheet; None for those to be filled in."""
    open_values = dict.fromkeys(key for key in test.open if key in (*_NEEDED, *DIMENSIONS))
    files = {role: test.files.get(role) for role in ROLES if role in {*test.files, *test.open}}
    data = _sheet_data({**test.values, **open_values}, files)
    shared, own = test.blocks.get("specimen", {}), _block(data, "specimen")
    words = {name: _block(shared, name) | _block(own, name) for name in WORDS}
    data["specimen"] = {**shared, **own} | {name: block for name, block in words.items() if block}
    overrides = test.blocks.get("overrides")
    return data | ({"overrides": overrides} if overrides else {})


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
    _raise_if_any(ReadError, _heading_faults(table.heading, [name for name, _ in columns], sheet))
    faults, tests, names = list[str](), [], set[str]()
    for row in table.rows:
        cells = [(*column, cell) for column, cell in zip(columns, row, strict=True)]
        values = {name: _with_unit(cell.text, unit) for name, unit, cell in cells if cell.text}
        places = {name: cell.place for name, _, cell in cells}
        files = {role: file_names(values[role]) for role in ROLES if role in values}
        data, test = _sheet_data(values, files), values.get("test", "")
        faults += _faults(values, places, data, sheet, beside=folder / test)
        if test and test.casefold() in names:  # some file systems take A1 and a1 for one folder
            faults.append(
                str(ReadError.about("process.row_twice", sheet, places["test"], test=test))
            )
        names.add(test.casefold())
        tests.append((folder / test / SHEET_NAME, data, files))
    _raise_if_any(ReadError, iter(faults))
    sheets = []
    for path, data, files in tests:
        kept = path.exists() and not overwrite
        missing = [x for names in files.values() for x in names if not (path.parent / x).exists()]
        remark = format_sentence("process.not_there_yet", names=", ".join(missing))
        if not kept:
            _write(path, data)
        sheets.append(WrittenSheet(path, kept, (remark,) if missing and not kept else ()))
    return sheets


def _column(heading: str) -> tuple[str, str]:
    """Split a heading into the name of the column and the unit of its numbers."""
    match = _UNIT_IN_HEADING.fullmatch(heading)
    name, unit = (match[1].strip(), match[2]) if match else (heading, "")
    return (name if "." in name else name.casefold()), unit


def _with_unit(text: str, unit: str) -> str:
    is_number = re.fullmatch(r"[-+0-9.eE]+", text) is not None
    return f"{text} {unit}" if unit and is_number else text


def _heading_faults(heading: Sequence[Cell], names: Sequence[str], sheet: Path) -> Iterator[str]:
    for number, (name, cell) in enumerate(zip(names, heading, strict=True)):
        yield from _unknown(name, cell.text, sheet, cell.place)
        if name in names[:number]:
            yield str(ReadError.about("process.column_twice", sheet, cell.place, name=name))
    for name in _NEEDED:
        if name not in names:
            yield str(ReadError.about("process.column_missing", sheet, heading[0].place, name=name))


def _unknown(name: str, written: str, file: Path, place: str) -> Iterator[str]:
    """Describe a column that is neither known nor a dotted key."""
    if name not in COLUMNS and "." not in name:
        columns = sort_by_likeness(written, list(COLUMNS))
        near = ", ".join(map(repr, columns))
        yield str(
            ReadError.about(
                "process.column_unknown", file, place, near=near, name=written, likely=columns[0]
            )
        )


def _faults(
    values: Mapping[str, str],
    places: Mapping[str, str],
    data: Mapping[str, object],
    file: Path,
    *,
    beside: Path | None = None,
    left_open: Sequence[str] = (),
) -> Iterator[str]:
    """Describe the faults of one test, each with its cell or option, except open values."""
    faults = [
        fault for fault in test_sheet_faults(data) if not set(map(str, fault.path)) & set(left_open)
    ]
    protocol = values.get("protocol")
    path = find_protocol(protocol, beside=beside or file.parent) if protocol else None
    for fault in [*faults, path] if isinstance(path, Fault) else faults:
        column = _column_of(fault)
        place = places.get(column) or places.get("test")
        place = f"{place} ({column})" if place else column
        expected, found, remedy = fault.expected, fault.found, fault.remedy
        if fault.missing:
            expected, found, remedy = f"a value for {column!r}", "none", "Fill it in."
        yield format_error(file, place, expected=expected, found=found, remedy=remedy).rstrip()


def _column_of(fault: Fault) -> str:
    path = [str(part) for part in fault.path]
    if path[:2] == ["specimen", "bundle"]:
        key = fault.missing or path[2]
        return next(column for column, filled in BUNDLE_KEY_BY_COLUMN.items() if filled == key)
    if fault.missing:
        return fault.missing
    if path[0] == "specimen" and path[1] in WORDS:
        return f"{path[1]}.{path[2]}"
    return path[1] if path[0] in ("specimen", "files", "overrides") and len(path) > 1 else path[0]


def _sheet_data(
    values: Mapping[str, str | None], files: Mapping[str, Sequence[str] | None]
) -> dict[str, object]:
    """Arrange values by column and files by role into the blocks of a test sheet."""

    def block(columns: Mapping[str, str]) -> dict[str, object]:
        return {key: values[column] for column, key in columns.items() if column in values}

    words = {
        name: {key: key.partition(".")[2] for key in values if key.startswith(f"{name}.")}
        for name in WORDS
    }
    because = block({"because": "because"})
    overridden = [key for key in values if "." in key and key.partition(".")[0] not in WORDS]
    specimen = block({key: key for key in (*_NEEDED[2:], *DIMENSIONS)})
    blocks = {"bundle": block(BUNDLE_KEY_BY_COLUMN)}
    blocks |= {name: block(columns) for name, columns in words.items()}
    data = block({key: key for key in _NEEDED[:2]})
    data["specimen"] = specimen | {key: inner for key, inner in blocks.items() if inner}
    data |= block({key: key for key in _OPTIONAL_TOP_LEVEL_COLUMNS})
    data["files"] = {
        role: names[0] if names is not None and len(names) == 1 else names and list(names)
        for role, names in files.items()
    } or None
    overrides = {key: {"value": values[key]} | because for key in overridden}
    return data | ({"overrides": overrides} if overrides else {})


def _write(path: Path, data: Mapping[str, object]) -> None:
    """Write a test sheet completely or not at all."""
    with storing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        part.write_text(write_test_sheet(data), encoding="utf-8", newline="\n")
