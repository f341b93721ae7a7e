"""Header of Motive's table-style exports: what each column holds, found by words."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from labpipe.readers.files import unreadable
from labpipe.units import whole_number

Cells = Sequence[str]

LENGTHS = {"Meters": 1.0, "Centimeters": 0.01, "Millimeters": 0.001}
"""Length Units of the export, in m."""

SEEN = frozenset({"1.21", "1.23", "1.24", "1.25"})
"""Format versions that real files have shown."""

_AGAIN = "Export the take from Motive as CSV again."
_WORDS = ("Type", "Name", "ID")
_KEYS = (
    *("Format Version", "Take Name", "Take Notes", "Capture Frame Rate", "Export Frame Rate"),
    *("Capture Start Time", "Capture Start Frame", "Total Frames in Take"),
    *("Total Exported Frames", "Rotation Type", "Length Units", "Coordinate Space"),
)


@dataclass(frozen=True, slots=True)
class Group:
    """The columns of one object.

    Parameters
    ----------
    type, name, id : as in the header rows
    columns : column number by quantity and axis: ``("Position", "X")``, ``("Marker Quality", "")``
    """

    type: str
    name: str
    id: str
    columns: Mapping[tuple[str, str], int]

    def axes(self, quantity: str, axes: str) -> list[int] | None:
        """Column numbers of a quantity along some axes; None unless all are there."""
        found = [self.columns.get((quantity, axis)) for axis in axes]
        known = [column for column in found if column is not None]
        return known if len(known) == len(axes) else None

    @property
    def scalars(self) -> list[str]:
        """Quantities that have no axes."""
        return [quantity for quantity, axis in self.columns if not axis]


@dataclass(frozen=True, slots=True)
class Header:
    """The head of a table-style export.

    Parameters
    ----------
    about : keys and values of line 1
    groups : the objects in the order of their columns
    time_column : number of the column of times, None if there is none
    width : number of cells of a whole line, padding included
    rows : number of header rows; the data begin in the next
    """

    about: Mapping[str, str]
    groups: tuple[Group, ...]
    time_column: int | None
    width: int
    rows: int

    @property
    def names(self) -> list[str]:
        """What each column holds, for messages."""
        names = ["Frame", *[""] * (self.width - 1)]
        for group in self.groups:
            for quantity, column in group.columns.items():
                names[column] = " ".join((group.name, *quantity)).strip()
        return names

    @property
    def version(self) -> str:
        """Format version as text."""
        return self.about.get("Format Version", "")

    @property
    def rate(self) -> float | None:
        """Export frame rate in 1/s (the capture rate where it is not stated)."""
        for key in ("Export Frame Rate", "Capture Frame Rate"):
            text = self.about.get(key, "")
            if re.fullmatch(r"\d+(\.\d*)?", text) and float(text) > 0.0:
                return float(text)
        return None

    @property
    def stated_rows(self) -> int | None:
        """Number of exported frames as line 1 states it."""
        text = self.about.get("Total Exported Frames", "").removesuffix(".0")
        return whole_number(text)

    @property
    def length_unit(self) -> float:
        """Length Units in m."""
        return LENGTHS[self.about["Length Units"]]


def parse_header(rows: Sequence[Cells], path: Path) -> Header:
    """Read the rows above the data.

    Parameters
    ----------
    rows : cells of the first lines, at least to the row that begins with ``Frame``
    path : named in errors

    Returns
    -------
    The header.

    Raises
    ------
    ReadError
        If a row that is needed is missing, the version is not of the 1.x family, the unit of
        length is unknown, or columns of data have no type.
    """
    about = _key_values(rows[0])
    _check_version(about, path)
    last = _last_row(rows, path)
    start, time_column = _leading_columns(rows[last])
    labels = _labels(rows[1:last], start, last, path)
    if about.get("Length Units") not in LENGTHS:
        expected = f"Length Units, one of {', '.join(LENGTHS)}"
        found = f"'{about.get('Length Units', '')}'"
        raise unreadable(path, "line 1", expected, found, _AGAIN)
    groups = _groups(labels, rows[last], start, last, path)
    furthest = max((max(group.columns.values()) for group in groups), default=0)
    return Header(
        about=about,
        groups=groups,
        time_column=time_column,
        width=max(len(rows[last]), furthest + 1),
        rows=last + 1,
    )


def _key_values(cells: Cells) -> dict[str, str]:
    """Pair keys and values of line 1; an unquoted comma inside a value is put back."""
    pairs = dict(zip(cells[::2], cells[1::2], strict=False))
    if "Length Units" not in pairs and "Length Units" in cells:
        known = [i for i, cell in enumerate(cells) if cell in _KEYS]
        ends = [*known[1:], len(cells)]
        pairs = {cells[i]: ",".join(cells[i + 1 : end]) for i, end in zip(known, ends, strict=True)}
    return {key.strip(): value.strip().rstrip(",") for key, value in pairs.items() if key.strip()}


def _check_version(about: Mapping[str, str], path: Path) -> None:
    version = about.get("Format Version", "")
    if re.fullmatch(r"1\.\d+", version):
        return
    found = f"'{version}'" if version else "no version"
    remedy = "Export the take with Format Version 1.2x (Motive 2 or 3)."
    expected = "Format Version 1.x after the first comma"
    raise unreadable(path, "line 1", expected, found, remedy)


def _last_row(rows: Sequence[Cells], path: Path) -> int:
    """Number of the row that begins with Frame: it is the last of the header."""
    for i, row in enumerate(rows):
        if row and row[0].strip() == "Frame":
            return i
    place = f"lines 1 to {len(rows)}"
    expected, found = "a header row that begins with Frame", "none"
    raise unreadable(path, place, expected, found, _AGAIN)


def _leading_columns(row: Cells) -> tuple[int, int | None]:
    """First column that belongs to an object, and the column of times.

    An optional column ``TimeCode`` stands between (1.24).
    """
    start, time_column = 1, None
    for i, cell in enumerate(row[1:3], start=1):
        word = cell.strip().casefold().replace(" ", "")
        if word == "timecode":
            start = i + 1
        elif word.startswith("time"):
            start, time_column = i + 1, i
    return start, time_column


def _labels(rows: Sequence[Cells], start: int, last: int, path: Path) -> dict[str, Cells]:
    """Rows of labels by their word; by their order where the words are missing (1.21)."""
    filled = [row for row in rows if any(cell.strip() for cell in row)]
    words = [next((cell.strip() for cell in row[:start] if cell.strip()), "") for row in filled]
    named = {word: row for word, row in zip(words, filled, strict=True) if word}
    if named:
        quantity = [row for word, row in zip(words, filled, strict=True) if not word]
        found: dict[str, Cells] = {**named, "Quantity": quantity[-1] if quantity else []}
    else:
        found = dict(zip((*_WORDS, "Quantity"), filled, strict=False))
    missing = [word for word in _WORDS if word not in found]
    if missing and (named or filled):
        place = f"lines 2 to {last}"
        expected = f"header rows {', '.join(_WORDS)}"
        found_ = f"none for {', '.join(missing)}"
        raise unreadable(path, place, expected, found_, _AGAIN)
    return found


def _groups(
    labels: Mapping[str, Cells], axes: Cells, start: int, last: int, path: Path
) -> tuple[Group, ...]:
    """Collect the columns of each object, keyed on type, name and id."""
    groups: dict[tuple[str, str, str, int], dict[tuple[str, str], int]] = {}
    width = max([len(axes), *(len(row) for row in labels.values())])
    for column in range(start, width):
        type_, name, id_, quantity = (
            _cell(labels.get(word, []), column) for word in (*_WORDS, "Quantity")
        )
        axis = _cell(axes, column).upper()
        if not (type_ or name or quantity or axis):
            continue  # padding of a spreadsheet
        if not type_:
            place = f"line {last + 1}, cell {column + 1}"
            raise unreadable(path, place, "a column with a type", "none", _AGAIN)
        number = 0
        while (quantity, axis) in groups.get((type_, name, id_, number), {}):
            number += 1  # the same name and id again: another object
        groups.setdefault((type_, name, id_, number), {})[quantity, axis] = column
    return tuple(Group(key[0], key[1], key[2], columns) for key, columns in groups.items())


def _cell(row: Cells, column: int) -> str:
    return row[column].strip() if column < len(row) else ""
