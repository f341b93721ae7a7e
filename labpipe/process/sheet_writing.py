"""Write test sheets from the exports in a folder, from options, or from a campaign table."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from labpipe.errors import Fault, ReadError, UsageError, error_text, nearest
from labpipe.process.raw_folder import folders_of_tests
from labpipe.process.sheet_inference import InferredTest, file_names, infer_test, infer_tests
from labpipe.protocol.load import find_protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME, test_sheet_faults, write_test_sheet
from labpipe.protocol.source import ROLES
from labpipe.readers.sheet_cells import Cell, Table, read_campaign_sheet
from labpipe.store.replace import replacing, storing

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
_PLAIN = ("test", "protocol", "date", "operator")
_SPECIMEN = ("type", "spool", "sample")
COLUMNS = (*_PLAIN, *_SPECIMEN, *DIMENSIONS, *BUNDLE, *ROLES, "because")
"""Columns of a campaign table, in addition to dotted keys of the protocol and labels."""
_NEEDED = ("test", "protocol", *_SPECIMEN)
_UNIT_IN_HEADING = re.compile(r"([^(\[]+)[(\[](.+)[)\]]")


@dataclass(frozen=True, slots=True)
class NewTest:
    """The values of a test sheet as the user wrote them.

    Parameters
    ----------
    values : text by column: those of `COLUMNS`, labels, and dotted keys of the protocol
    places : place of each value by column, for messages
    """

    values: Mapping[str, str]
    places: Mapping[str, str] = field(default_factory=dict)


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
    below = folders_of_tests(folder)
    unknown = [_unknown(column, folder, column) for column in stated if not _is_column(column)]
    if unknown:
        raise UsageError("\n".join(unknown))
    if not below:
        path = folder / SHEET_NAME
        if path.exists() and not overwrite:
            remedy, actual = "Edit it, or ask to overwrite it.", "an existing one"
            message = error_text(path, "", expected="no such file yet", found=actual, remedy=remedy)
            raise UsageError(message)
        yield write_inferred_sheet(infer_test(folder, stated))
        return
    existing = [path for path in below if (path / SHEET_NAME).exists() and not overwrite]
    yield from (WrittenSheet(path / SHEET_NAME, kept=True) for path in existing)
    for test in infer_tests([path for path in below if path not in existing], stated):
        yield write_inferred_sheet(test)


def write_inferred_sheet(seen: InferredTest) -> WrittenSheet:
    """Write the test sheet of an inferred test.

    Parameters
    ----------
    seen : from `infer_test`

    Raises
    ------
    UsageError
        If a value is wrong; all of them are in one message.
    StoreError
        If the file cannot be written.
    """
    path = seen.folder / SHEET_NAME
    data = _inferred_data(seen)
    new_test = NewTest(seen.values)
    faults = _faults(new_test, data, path, seen.folder, left_open=seen.open)
    if faults:
        raise UsageError("\n".join(faults))
    _write(path, write_test_sheet(data))
    return WrittenSheet(path, False, seen.remarks, seen.open)


def _inferred_data(test: InferredTest) -> dict[str, object]:
    """Arrange inferred values into the blocks of a test sheet; None for those to be filled in."""
    data = _sheet_data(test.values)
    files = {role: _one_or_list(names) for role, names in test.files.items()}
    roles = [role for role in ROLES if role in {*files, *test.open}]
    data["files"] = {role: files.get(role) for role in roles} or None
    if "protocol" in test.open:
        rest = {key: value for key, value in data.items() if key != "test"}
        data = {"test": data["test"], "protocol": None, **rest}
    specimen = data["specimen"] if isinstance(data["specimen"], dict) else {}
    keys = [*_SPECIMEN, *(key for key in test.open if key in DIMENSIONS)]
    blocks = {key: dict(block) for key, block in test.blocks.items() if block}
    shared = blocks.pop("specimen", {})
    labels = {**_block(shared, "labels"), **_block(specimen, "labels")}
    filled: dict[str, object] = {key: specimen.get(key) for key in keys} | shared | specimen
    data["specimen"] = filled | ({"labels": labels} if labels else {})
    return data | blocks


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
    faults = list(_heading_faults(table.heading, sheet))
    if faults:
        raise ReadError("\n".join(faults))
    tests = [_from_row(table, row) for row in table.rows]
    for test in tests:
        test_folder = folder / test.values.get("test", "")
        faults += _faults(test, _sheet_data(test.values), sheet, test_folder)
    faults += _repeated(tests, sheet)
    if faults:
        raise ReadError("\n".join(faults))
    sheets = []
    for test in tests:
        path = folder / test.values["test"] / SHEET_NAME
        if path.exists() and not overwrite:
            sheets.append(WrittenSheet(path, kept=True))
            continue
        _write(path, write_test_sheet(_sheet_data(test.values)))
        names = [name for role in ROLES for name in file_names(test.values.get(role, ""))]
        missing = ", ".join(name for name in names if not (path.parent / name).exists())
        remarks = (f"not there yet: {missing}",) if missing else ()
        sheets.append(WrittenSheet(path, remarks=remarks))
    return sheets


def _column(cell: Cell) -> tuple[str, str]:
    """Split a heading into the name of the column and the unit of its numbers."""
    match = _UNIT_IN_HEADING.fullmatch(cell.text)
    name, unit = (match[1].strip(), match[2]) if match else (cell.text, "")
    return (name if "." in name else name.casefold()), unit


def _is_column(name: str) -> bool:
    return name in COLUMNS or "." in name


def _heading_faults(heading: Sequence[Cell], sheet: Path) -> Iterator[str]:
    names = [_column(cell)[0] for cell in heading]
    for number, (name, cell) in enumerate(zip(names, heading, strict=True)):
        if not name or not _is_column(name):
            yield _unknown(cell.text, sheet, cell.place)
        elif name in names[:number]:
            actual, remedy = f"{name!r} again", "Remove or rename one of them."
            yield error_text(
                sheet, cell.place, expected="each column once", found=actual, remedy=remedy
            )
    for name in _NEEDED:
        if name not in names:
            expected, remedy = f"a column {name!r}", "Add it."
            yield error_text(
                sheet, heading[0].place, expected=expected, found="none", remedy=remedy
            )


def _unknown(name: str, file: Path, place: str) -> str:
    near_columns = nearest(name, list(COLUMNS))
    expected = f"one of {', '.join(repr(word) for word in near_columns)}, ..., or a dotted key"
    remedy = f"Did you mean {near_columns[0]!r}?"
    return error_text(file, place, expected=expected, found=repr(name), remedy=remedy)


def _from_row(table: Table, row: Sequence[Cell]) -> NewTest:
    values, places = {}, {}
    for heading, cell in zip(table.heading, row, strict=True):
        name, unit = _column(heading)
        places[name] = cell.place
        if cell.text:
            has_unit = re.fullmatch(r"[-+0-9.eE]+", cell.text) is None
            values[name] = cell.text if has_unit or not unit else f"{cell.text} {unit}"
    return NewTest(values, places)


def _faults(
    test: NewTest,
    data: Mapping[str, object],
    file: Path,
    folder: Path,
    *,
    left_open: Sequence[str] = (),
) -> list[str]:
    """Describe the faults of one test, except open values."""
    value_faults = test_sheet_faults(data)
    faults = [fault for fault in value_faults if not set(map(str, fault.path)) & set(left_open)]
    protocol = test.values.get("protocol")
    path = find_protocol(protocol, beside=folder) if protocol else None
    if isinstance(path, Fault):
        faults.append(path)
    return [_fault_text(fault, test, file) for fault in faults]


def _fault_text(fault: Fault, test: NewTest, file: Path) -> str:
    """Describe a fault with its cell or option."""
    column = _column_of(fault)
    place = test.places.get(column) or test.places.get("test")
    place = f"{place} ({column})" if place else column
    if fault.missing:
        expected, remedy = f"a value for {column!r}", "Fill it in."
        return error_text(file, place, expected=expected, found="none", remedy=remedy)
    text = error_text(file, place, expected=fault.expected, found=fault.found, remedy=fault.remedy)
    return text.rstrip()


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


def _sheet_data(values: Mapping[str, str]) -> dict[str, object]:
    """Arrange text by column into the blocks of a test sheet."""
    files = {role: _one_or_list(file_names(values[role])) for role in ROLES if values.get(role)}
    dotted = {
        key: value for key, value in values.items() if "." in key and not key.startswith(LABELS)
    }
    because = {"because": values["because"]} if "because" in values else {}
    data: dict[str, object] = {key: values[key] for key in ("test", "protocol") if key in values}
    data["specimen"] = _specimen_data(values)
    data |= {key: values[key] for key in ("date", "operator") if key in values}
    data["files"] = files
    if dotted:
        data["overrides"] = {key: {"value": value} | because for key, value in dotted.items()}
    return data


def _specimen_data(values: Mapping[str, str]) -> dict[str, object]:
    plain = (*_SPECIMEN, *DIMENSIONS)
    specimen: dict[str, object] = {key: values[key] for key in plain if key in values}
    bundle = {key: values[column] for column, key in BUNDLE.items() if column in values}
    labels = {
        key.removeprefix(LABELS): value for key, value in values.items() if key.startswith(LABELS)
    }
    blocks = {"bundle": bundle, "labels": labels}
    return specimen | {key: block for key, block in blocks.items() if block}


def _one_or_list(names: Sequence[str]) -> str | list[str]:
    return names[0] if len(names) == 1 else list(names)


def _repeated(tests: Sequence[NewTest], sheet: Path) -> Iterator[str]:
    seen: set[str] = set()
    for test in tests:
        name = test.values.get("test", "")
        if name and name.casefold() in seen:  # some file systems take A1 and a1 for one folder
            place, remedy = test.places["test"], "Give each test another name."
            yield error_text(
                sheet, place, expected="each test once", found=f"{name!r} again", remedy=remedy
            )
        seen.add(name.casefold())


def _write(path: Path, text: str) -> None:
    """Write a file completely or not at all."""
    with storing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8", newline="\n")
