"""Writing test sheets: by what lies in a folder, from options, or from a campaign's table."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from labpipe.errors import Fault, ReadError, UsageError, error_text, nearest
from labpipe.process.raw_folder import folders_of_tests
from labpipe.process.sheet_inference import InferredTest, infer_test, infer_tests
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
"""Columns of a harness bundle, and the keys of its block that they fill."""
LABELS = "labels."
"""With this before its name, a column is a label of the specimen."""
_PLAIN = ("test", "protocol", "date", "operator")
_SPECIMEN = ("type", "spool", "sample")
COLUMNS = (*_PLAIN, *_SPECIMEN, *DIMENSIONS, *BUNDLE, *ROLES, "because")
"""The columns of a campaign's table; besides them, every dotted key of a protocol is one, and every
label."""
_NEEDED = ("test", "protocol", *_SPECIMEN)
_UNIT_IN_HEADING = re.compile(r"([^(\[]+)[(\[](.+)[)\]]")


@dataclass(frozen=True, slots=True)
class NewTest:
    """What a test sheet says, as a person wrote it.

    Parameters
    ----------
    values : text by column: those of `COLUMNS`, labels, and dotted keys of the protocol
    places : where each of them was written, for messages; by column
    """

    values: Mapping[str, str]
    places: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class NewTests:
    """What became of the rows of a campaign's table.

    Parameters
    ----------
    written : the test sheets written
    kept : those that were there already and were left as they are
    absent : exports that the written sheets name and that are not there, by test sheet
    """

    written: tuple[Path, ...]
    kept: tuple[Path, ...]
    absent: Mapping[Path, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class InferredSheet:
    """A test sheet that was written by what lies in the folder of the test.

    Parameters
    ----------
    path : of the test sheet
    kept : whether it was there already, and was left as it is
    said : sentences on where its values come from, and on what does not agree
    open : keys that are to be filled in
    """

    path: Path
    kept: bool = False
    said: tuple[str, ...] = ()
    open: tuple[str, ...] = ()


def new_seen(
    folder: Path,
    given: Mapping[str, str],
    *,
    overwrite: bool = False,
    protocols: Path | None = None,
) -> Iterator[InferredSheet]:
    """Write the test sheet of a folder, or of each folder of a campaign, by what lies there.

    Parameters
    ----------
    folder : of a test, or of a campaign
    given : text by column of `COLUMNS`, by label (``labels.cured``), or by dotted key of the
        protocol; they count before what is seen
    overwrite : whether test sheets that are there already may go; in a campaign they are kept else
    protocols : folder of the lab's protocols; ``protocols`` in the working folder if None

    Yields
    ------
    Each test sheet. What is needed and cannot be seen is marked in it as to be filled in.

    Raises
    ------
    UsageError
        If given values are wrong (all of them in one message), or the only sheet is there already.
    StoreError
        If the file cannot be written.
    """
    below = folders_of_tests(folder)
    unknown = [_unknown(column, folder, column) for column in given if not _is_column(column)]
    if unknown:
        raise UsageError("\n".join(unknown))
    if not below:
        _refuse_existing(folder / SHEET_NAME, overwrite=overwrite)
        yield write_seen(infer_test(folder, given, protocols=protocols), protocols=protocols)
        return
    there = [each for each in below if (each / SHEET_NAME).exists() and not overwrite]
    yield from (InferredSheet(each / SHEET_NAME, kept=True) for each in there)
    wanted = [each for each in below if each not in there]
    for seen in infer_tests(wanted, given, protocols=protocols):
        yield write_seen(seen, protocols=protocols)


def write_seen(seen: InferredTest, *, protocols: Path | None = None) -> InferredSheet:
    """Write the test sheet of a test that was looked at.

    Parameters
    ----------
    seen : from `infer_test`
    protocols : folder of the lab's protocols; ``protocols`` in the working folder if None

    Raises
    ------
    UsageError
        If a value is wrong; all of them are in one message.
    StoreError
        If the file cannot be written.
    """
    path = seen.folder / SHEET_NAME
    data = _seen_data(seen)
    test = NewTest(seen.values)
    faults = _faults(test, data, path, seen.folder, protocols=protocols, left_open=seen.open)
    if faults:
        raise UsageError("\n".join(faults))
    _write(path, write_test_sheet(data))
    return InferredSheet(path, False, seen.said, seen.open)


def _seen_data(seen: InferredTest) -> dict[str, object]:
    """Arrange what was seen into the blocks of a test sheet; None for what is to be filled in."""
    data = _sheet_data(seen.values)
    files = {
        role: names[0] if len(names) == 1 else list(names) for role, names in seen.files.items()
    }
    roles = [role for role in ROLES if role in {*files, *seen.open}]
    data["files"] = {role: files.get(role) for role in roles} or None
    if "protocol" in seen.open:
        rest = {key: value for key, value in data.items() if key != "test"}
        data = {"test": data["test"], "protocol": None, **rest}
    specimen = data["specimen"] if isinstance(data["specimen"], dict) else {}
    keys = [*_SPECIMEN, *(key for key in seen.open if key in DIMENSIONS)]
    blocks = {key: dict(block) for key, block in seen.blocks.items() if block}
    shared = blocks.pop("specimen", {})
    labels = {**_block(shared, "labels"), **_block(specimen, "labels")}
    filled: dict[str, object] = {key: specimen.get(key) for key in keys} | shared | specimen
    data["specimen"] = filled | ({"labels": labels} if labels else {})
    return data | blocks


def _block(data: Mapping[str, object], key: str) -> dict[str, object]:
    found = data.get(key)
    return dict(found) if isinstance(found, Mapping) else {}


def _refuse_existing(path: Path, *, overwrite: bool) -> None:
    if path.exists() and not overwrite:
        remedy = "Edit it, or ask to overwrite it."
        found = "one that is there already"
        text = error_text(path, "", expected="no such file yet", found=found, remedy=remedy)
        raise UsageError(text)


def new_from_sheet(
    sheet: Path, folder: Path, *, overwrite: bool = False, protocols: Path | None = None
) -> NewTests:
    """Write one test sheet per row of a campaign's table.

    Parameters
    ----------
    sheet : xlsx or csv with the columns `COLUMNS`, in any order; ``length (mm)`` states a unit for
        the whole column; a column may also be a label, or a dotted key of the protocol
    folder : of the campaign; each test gets a folder of its name in it
    overwrite : whether test sheets that are there already may go; else they are kept
    protocols : folder of the lab's protocols; ``protocols`` in the working folder if None

    Returns
    -------
    What was written and what was kept.

    Raises
    ------
    ReadError
        If the table cannot be read, or anything in it is wrong: all faults are in one message, each
        with its cell, and nothing is written.
    StoreError
        If a file cannot be written.
    """
    table = read_campaign_sheet(sheet)
    faults = list(_heading_faults(table.heading, sheet))
    if faults:
        raise ReadError("\n".join(faults))
    tests = [_from_row(table, row) for row in table.rows]
    for test in tests:
        goal = folder / test.values.get("test", "")
        faults += _faults(test, _sheet_data(test.values), sheet, goal, protocols=protocols)
    faults += _repeated(tests, sheet)
    if faults:
        raise ReadError("\n".join(faults))
    written, kept = [], []
    absent: dict[Path, tuple[str, ...]] = {}
    for test in tests:
        path = folder / test.values["test"] / SHEET_NAME
        if path.exists() and not overwrite:
            kept.append(path)
        else:
            _write(path, write_test_sheet(_sheet_data(test.values)))
            written.append(path)
            named = [name for role in ROLES for name in _names(test.values.get(role, ""))]
            missing = tuple(name for name in named if not (path.parent / name).exists())
            absent |= {path: missing} if missing else {}
    return NewTests(tuple(written), tuple(kept), absent)


def _column(cell: Cell) -> tuple[str, str]:
    """Part a heading into the name of the column and the unit of its numbers."""
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
            found, remedy = f"{name!r} again", "Remove or rename one of them."
            yield error_text(
                sheet, cell.place, expected="each column once", found=found, remedy=remedy
            )
    for name in _NEEDED:
        if name not in names:
            expected, remedy = f"a column {name!r}", "Add it."
            yield error_text(
                sheet, heading[0].place, expected=expected, found="none", remedy=remedy
            )


def _unknown(name: str, file: Path, place: str) -> str:
    near = nearest(name, list(COLUMNS))
    expected = f"one of {', '.join(repr(word) for word in near)}, ..., or a dotted key"
    remedy = f"Did you mean {near[0]!r}?"
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
    protocols: Path | None,
    left_open: Sequence[str] = (),
) -> list[str]:
    """Word what is wrong with one test, but not what is left open."""
    found_in = test_sheet_faults(data)
    faults = [each for each in found_in if not set(map(str, each.path)) & set(left_open)]
    wanted = test.values.get("protocol")
    found = find_protocol(wanted, beside=folder, protocols=protocols) if wanted else None
    if isinstance(found, Fault):
        faults.append(found)
    return [_worded(fault, test, file) for fault in faults]


def _worded(fault: Fault, test: NewTest, file: Path) -> str:
    """Word a fault at the cell, or the option, that it comes from."""
    column = _column_of(fault)
    place = test.places.get(column) or test.places.get("test")
    place = f"{place} ({column})" if place else column
    if fault.missing:
        expected, remedy = f"a value for {column!r}", "Fill it in."
        return error_text(file, place, expected=expected, found="none", remedy=remedy)
    said = (fault.expected, fault.found)
    return error_text(file, place, expected=said[0], found=said[1], remedy=fault.remedy).rstrip()


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
    files = {role: _parts(values[role]) for role in ROLES if values.get(role)}
    dotted = {key: value for key, value in values.items() if "." in key and not _is_label(key)}
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
    labels = {key.removeprefix(LABELS): word for key, word in values.items() if _is_label(key)}
    blocks = {"bundle": bundle, "labels": labels}
    return specimen | {key: block for key, block in blocks.items() if block}


def _is_label(column: str) -> bool:
    return column.startswith(LABELS)


def _parts(text: str) -> str | list[str]:
    parts = _names(text)
    return parts[0] if len(parts) == 1 else parts


def _names(text: str) -> list[str]:
    return [part.strip() for part in text.split(";")] if text else []


def _repeated(tests: Sequence[NewTest], sheet: Path) -> Iterator[str]:
    seen: set[str] = set()
    for test in tests:
        name = test.values.get("test", "")
        if name and name.casefold() in seen:  # some file systems take A1 and a1 for one folder
            place, remedy = test.places["test"], "Give each test a name of its own."
            yield error_text(
                sheet, place, expected="each test once", found=f"{name!r} again", remedy=remedy
            )
        seen.add(name.casefold())


def _write(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    with storing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8", newline="\n")
