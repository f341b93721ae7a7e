"""Reader of OptiTrack Motive takes exported as CSV, or saved as xlsx by a spreadsheet.

**Writes this file**: Motive (and Tracking Tools before it), "export tracking data".

**Recording**: measured markers and rigid bodies; fitted Rigid Body Markers are left out.

**Units**: from the key Length Units; row style states none and is taken as metres.

**Missing data**: blank cells (table), NAN or a counter above 0 (row style) become NaN.

**Clock and frame**: frame / export rate where the column of times agrees within 0.6 ms, else the
column; positions stay in the frame of the motion-capture system.

**File structure**: table style (line 1 keys and values, rows of labels, ``Frame``, data), or row
style (every line begins with its type). Everything is found by labels, not by line numbers.

**Known versions**: table style 1.21, 1.23, 1.24, 1.25; row style 1.0, 1.1.
"""

from __future__ import annotations

import csv
import re
from codecs import BOM_UTF8
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.channels import ReportOptions
from labpipe.readers.number_table import Body, read_columns, rows_note, sheet_columns
from labpipe.readers.raw_files import read_head, reading, unreadable
from labpipe.readers.text_cells import as_text
from labpipe.readers.time_axes import clock_notes
from labpipe.readers.tracking import track_notes
from labpipe.readers.workbooks import forget_sheets, is_workbook, open_sheets
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Clock, MarkerTracks, Recording, RigidBody
from labpipe.units import whole_number

_TABLE_STARTS = (b"Format Version", b'"Format Version')
_ROW_STARTS = (b"comment,", b'"comment",')
_HEADER_LINES = 40
"""Lines searched for header rows; the longest real header has 8."""
_LENGTH_UNITS = {"Meters": 1.0, "Centimeters": 0.01, "Millimeters": 0.001}
"""Length Units of the export, in m."""
_KNOWN_VERSIONS = ("1.21", "1.23", "1.24", "1.25")
"""Format versions of known files."""
_READ_TYPES = ("Marker", "Rigid Body")
_EXPORT_AGAIN = "Export the take from Motive as CSV again."
_LABELS = ("Type", "Name", "ID")
_KEYS = (
    *("Format Version", "Take Name", "Take Notes", "Capture Frame Rate", "Export Frame Rate"),
    *("Capture Start Time", "Capture Start Frame", "Total Frames in Take"),
    *("Total Exported Frames", "Rotation Type", "Length Units", "Coordinate Space"),
)
Columns = Mapping[int, Floats]
"""Values by column number in the file, shape (frames,); NaN where blank."""
Cells = Sequence[str]


def recognise(path: Path) -> bool:
    """Return whether a file is a Motive export of either style, or a workbook with one."""
    if not is_workbook(path):
        return read_head(path, 64).removeprefix(BOM_UTF8).startswith(_TABLE_STARTS + _ROW_STARTS)
    try:
        return _find_sheet(path) is not None
    except ReadError:
        return False


def _find_sheet(path: Path) -> str | None:
    """Return the name of the first sheet that begins with a Motive header."""
    sheets = open_sheets(path).items()
    return next((name for name, rows in sheets if rows and "Format Version" in rows[0][:1]), None)


def read(path: Path, *, channels: Sequence[ReportOptions] | None = None) -> Recording:  # noqa: ARG001
    """Read a Motive export.

    Parameters
    ----------
    path : the export of Motive, or a workbook saved from it; of a workbook the first sheet with a
        Motive header is read
    channels : not used; takes are read completely

    Returns
    -------
    The recording: marker tracks, no channels.

    Raises
    ------
    ReadError
        If the workbook, the header or a cell is damaged, or the version is unknown.
    """
    if is_workbook(path):
        return _read_workbook(path)
    with reading(path, "a readable file"):
        content = path.read_bytes().removeprefix(BOM_UTF8)
    if not content.startswith(_ROW_STARTS):
        return _read_table_style(content, path)
    from labpipe.readers.motive_rows import parse_rows

    with reading(path, "lines of a row-style export"):
        export = parse_rows(content.decode("utf-8", errors="replace"), path)
    return _recording("motive-csv", export.version, export.tracks, export.about, export.notes)


def _read_table_style(content: bytes, path: Path) -> Recording:
    lines = content.split(b"\n", _HEADER_LINES)[:_HEADER_LINES]
    with reading(path, "header rows of cells separated by commas"):
        text = b"\n".join(lines).decode("utf-8", errors="replace")
        rows = [next(csv.reader([line]), []) for line in text.split("\n")]
    header = parse_header(rows, path)
    body = Body(
        data=content[sum(len(line) + 1 for line in lines[: header.rows]) :],
        names=header.names,
        columns=header.needed_columns,
        first_line=header.rows + 1,
        separator=",",
        decimal=".",
        stated_rows=header.stated_rows,
        as_exported=True,
    )
    return _table_recording("motive-csv", header, *read_columns(body, path), path)


def _read_workbook(path: Path) -> Recording:
    sheets, name = open_sheets(path), _find_sheet(path)
    if name is None:
        remedy = "Save the sheet of the take alone as xlsx."
        expected = "a sheet whose first cell is Format Version"
        raise unreadable(path, "", expected, "none", remedy)
    forget_sheets()
    rows = sheets[name]
    header = parse_header([[as_text(cell) for cell in row] for row in rows[:_HEADER_LINES]], path)
    wanted = {column: header.names[column] for column in header.needed_columns}
    columns, notes = sheet_columns(rows, header.rows, wanted, (path, f"sheet '{name}'"))
    notes += rows_note(header.stated_rows, len(columns[0]))
    return _table_recording("motive-xlsx", header, columns, notes, path)


def _table_recording(
    reader: str, header: Header, columns: Columns, notes: list[QualityNote], path: Path
) -> Recording:
    infinite = np.array([np.isinf(values) for values in columns.values()])
    if infinite.any():
        columns = {i: np.where(np.isinf(column), np.nan, column) for i, column in columns.items()}
        row = int(np.flatnonzero(infinite.any(axis=0))[0]) + 1
        message = f"{int(infinite.sum())} infinite numbers count as blank, the first in data row"
        notes = [*notes, _note("not_finite", f"{message} {row}", Severity.WARNING)]
    tracks, track_notes = _marker_tracks(header, columns, path)
    objects = [{"type": group.type, "name": group.name, "id": group.id} for group in header.groups]
    about = {**header.about, "objects": objects}
    notes = [*_header_notes(header, path), *notes, *track_notes]
    return _recording(reader, header.version, tracks, about, notes)


def _recording(
    reader: str,
    version: str,
    tracks: MarkerTracks,
    about: Mapping[str, object],
    notes: Sequence[QualityNote],
) -> Recording:
    return Recording(
        reader=reader,
        program="Motive",
        program_version=version,
        markers=tracks,
        metadata=about,
        notes=(*notes, *clock_notes(Clock("frames", tracks.time)), *track_notes(tracks)),
    )


def _note(
    code: str, message: str, severity: Severity = Severity.INFO, where: str = "take"
) -> QualityNote:
    return QualityNote(code, severity, where, message)


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
        """Return the column numbers of a quantity along some axes; None if one is missing."""
        columns = [self.columns.get((quantity, axis)) for axis in axes]
        present = [column for column in columns if column is not None]
        return present if len(present) == len(axes) else None


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
        """Return the content of each column, for messages."""
        names = ["Frame", *[""] * (self.width - 1)]
        for group in self.groups:
            for quantity, column in group.columns.items():
                names[column] = " ".join((group.name, *quantity)).strip()
        return names

    @property
    def needed_columns(self) -> list[int]:
        """Return the columns of a recording: frame, time, bodies and measured markers."""
        needed = {0} | ({self.time_column} if self.time_column is not None else set())
        for group in self.groups:
            if group.type == "Marker":
                needed |= {*(group.axes("Position", "XYZ") or [])}
            if group.type == "Rigid Body":
                needed |= {*group.columns.values()}
        return sorted(needed)

    @property
    def version(self) -> str:
        """Return the format version as text."""
        return self.about.get("Format Version", "")

    @property
    def rate(self) -> float | None:
        """Return the export frame rate in 1/s (the capture rate if it is not stated)."""
        for key in ("Export Frame Rate", "Capture Frame Rate"):
            text = self.about.get(key, "")
            if re.fullmatch(r"\d+(\.\d*)?", text) and float(text) > 0.0:
                return float(text)
        return None

    @property
    def stated_rows(self) -> int | None:
        """Return the number of exported frames stated in line 1."""
        text = self.about.get("Total Exported Frames", "").removesuffix(".0")
        return whole_number(text)

    @property
    def length_unit(self) -> float:
        """Return the length unit in m."""
        return _LENGTH_UNITS[self.about["Length Units"]]


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
    if about.get("Length Units") not in _LENGTH_UNITS:
        expected = f"Length Units, one of {', '.join(_LENGTH_UNITS)}"
        found = f"'{about.get('Length Units', '')}'"
        raise unreadable(path, "line 1", expected, found, _EXPORT_AGAIN)
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
    """Return the values of line 1 by key; unquoted commas within values are restored."""
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
    """Return the number of the last header row, which begins with Frame."""
    for i, row in enumerate(rows):
        if row and row[0].strip() == "Frame":
            return i
    place = f"lines 1 to {len(rows)}"
    expected, found = "a header row that begins with Frame", "none"
    raise unreadable(path, place, expected, found, _EXPORT_AGAIN)


def _leading_columns(row: Cells) -> tuple[int, int | None]:
    """Return the first column of an object, and the column of times.

    An optional column ``TimeCode`` is between them (1.24).
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
    """Return rows of labels by their name; by their order if the names are missing (1.21)."""
    filled = [row for row in rows if any(cell.strip() for cell in row)]
    heads = [next((cell.strip() for cell in row[:start] if cell.strip()), "") for row in filled]
    named = {word: row for word, row in zip(heads, filled, strict=True) if word}
    if named:
        quantity = [row for word, row in zip(heads, filled, strict=True) if not word]
        labels: dict[str, Cells] = {**named, "Quantity": quantity[-1] if quantity else []}
    else:
        labels = dict(zip((*_LABELS, "Quantity"), filled, strict=False))
    missing = [word for word in _LABELS if word not in labels]
    if missing and (named or filled):
        place = f"lines 2 to {last}"
        expected = f"header rows {', '.join(_LABELS)}"
        missing_text = f"none for {', '.join(missing)}"
        raise unreadable(path, place, expected, missing_text, _EXPORT_AGAIN)
    return labels


def _groups(
    labels: Mapping[str, Cells], axes: Cells, start: int, last: int, path: Path
) -> tuple[Group, ...]:
    """Collect the columns of each object, keyed on type, name and id."""
    groups: dict[tuple[str, str, str, int], dict[tuple[str, str], int]] = {}
    width = max([len(axes), *(len(row) for row in labels.values())])
    for column in range(start, width):
        type_, name, id_, quantity = (
            _cell(labels.get(word, []), column) for word in (*_LABELS, "Quantity")
        )
        axis = _cell(axes, column).upper()
        if not (type_ or name or quantity or axis):
            continue  # padding of a spreadsheet
        if not type_:
            place = f"line {last + 1}, cell {column + 1}"
            raise unreadable(path, place, "a column with a type", "none", _EXPORT_AGAIN)
        number = 0
        while (quantity, axis) in groups.get((type_, name, id_, number), {}):
            number += 1  # the same name and id again: another object
        groups.setdefault((type_, name, id_, number), {})[quantity, axis] = column
    return tuple(Group(key[0], key[1], key[2], columns) for key, columns in groups.items())


def _cell(row: Cells, column: int) -> str:
    return row[column].strip() if column < len(row) else ""


def _marker_tracks(
    header: Header, columns: Columns, path: Path
) -> tuple[MarkerTracks, list[QualityNote]]:
    """Convert columns to tracks in SI; return notes on the column of times and on rotations."""
    frames = columns[0]
    bad = np.flatnonzero(~np.isfinite(frames))
    if len(bad):
        place = f"line {header.rows + 1 + int(bad[0])}, cell 1"
        remedy = f"{_EXPORT_AGAIN[:-1]}; the file may have been edited."
        raise unreadable(path, place, "a frame number", "none", remedy)
    time, rate, notes = _time(header, columns, frames)
    markers, bodies = (
        [group for group in header.groups if group.type == kind] for kind in _READ_TYPES
    )
    places = [column for group in markers for column in _position(group, header, path)]
    positions = _stack_columns(columns, places) * header.length_unit
    body_names = unique_names([(group.name, group.id) for group in bodies])
    tracks = MarkerTracks(
        time=time,
        frames=frames,
        rate=rate,
        names=unique_names([(group.name, group.id) for group in markers]),
        positions=positions.reshape(len(frames), len(markers), 3),
        bodies=tuple(
            _body(name, group, header, columns, path)
            for name, group in zip(body_names, bodies, strict=True)
        ),
        unit_in_file=header.about["Length Units"],
    )
    turned = [body.name for body in bodies if _euler_axes(body, header.about)]
    if turned:
        message = f"Euler angles of type '{header.about['Rotation Type']}' in degrees were"
        message += " converted to quaternions as intrinsic rotations: no real file has confirmed"
        message += " that convention"
        notes.append(_note("rotation_from_euler", message, Severity.WARNING, ", ".join(turned)))
    return tracks, notes


def _stack_columns(columns: Columns, chosen: Sequence[int]) -> Floats:
    """Return columns side by side, shape (frames, chosen)."""
    return np.transpose([columns[column] for column in chosen])


def unique_names(objects: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Make names unique: repeated ones get their id, and a number if that repeats as well.

    Parameters
    ----------
    objects : name and id of each

    Returns
    -------
    One name for each.

    Examples
    --------
    >>> unique_names([("a", "1"), ("b", "2"), ("a", "3")])
    ('a 1', 'b', 'a 3')
    """
    total = Counter(name for name, _ in objects)
    names = [f"{name} {id_}".strip() if total[name] > 1 else name for name, id_ in objects]
    return tuple(
        f"{name} #{names[: i + 1].count(name)}" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    )


def _header_notes(header: Header, path: Path) -> list[QualityNote]:
    notes = []
    if header.version not in _KNOWN_VERSIONS:
        message = f"Format Version {header.version} has not been seen in a real file:"
        message += f" read by the rules of {', '.join(_KNOWN_VERSIONS)}"
        notes.append(_note("version_unseen", message, Severity.WARNING, "file"))
    take, start = (header.about.get(key, "") for key in ("Take Name", "Capture Start Time"))
    if take and take != path.stem:
        message = f"the take is called '{take}', the file '{path.name}'"
        notes.append(_note("take_name_differs", message, where="file"))
    if start and not start.endswith((" AM", " PM")):
        message = f"Capture Start Time '{start}': AM or PM is missing"
        notes.append(_note("start_time_unclear", message, where="file"))
    count = Counter(group.type for group in header.groups)
    fitted = count.pop("Rigid Body Marker", 0)
    if fitted:
        message = f"{fitted} Rigid Body Marker are fitted positions, not measurements: left out"
        notes.append(_note("fitted_markers", message, where="markers"))
    others = [f"{n} of type {kind}" for kind, n in count.items() if kind not in _READ_TYPES]
    if others:
        notes.append(_note("columns_left_out", f"left out: {', '.join(others)}", where="columns"))
    names = Counter((group.type, group.name) for group in header.groups)
    shared = [name for (kind, name), n in names.items() if n > 1 and kind in _READ_TYPES]
    if shared:
        message = f"objects with the same name have their id added: {', '.join(shared[:5])}"
        notes.append(_note("names_not_unique", message, where="markers"))
    return notes


def _time(
    header: Header, columns: Columns, frames: Floats
) -> tuple[Floats, float, list[QualityNote]]:
    """Return frame / export rate if the time column agrees with it, else the time column."""
    # Deviations in s of the time column: 1.23 rounds to whole milliseconds.
    max_deviation, rounding = 0.6e-3, 2e-6
    where = "clock of the take"
    written = None if header.time_column is None else columns[header.time_column]
    if header.rate is None:
        time = frames * np.nan if written is None else written
        message = "line 1 states no Export Frame Rate: it is derived from the times"
        return (
            time,
            derived_rate(time),
            [_note("rate_not_stated", message, Severity.WARNING, where)],
        )
    time = frames / header.rate
    if written is None or not len(time):
        return time, header.rate, []
    apart = np.abs(written - time)
    if not np.isfinite(apart).all() or apart.max() > max_deviation:
        worst = float(np.nanmax(apart)) if np.isfinite(apart).any() else np.nan
        message = f"the column of times is up to {1e3 * worst:.4g} ms off frame / rate: kept"
        note = _note("time_column_differs", message, Severity.WARNING, where)
        return written, header.rate, [note]
    if apart.max() <= rounding:
        return time, header.rate, []
    message = "the column of times is rounded to milliseconds"
    message += f" (up to {1e3 * apart.max():.3g} ms off): frame / rate is used"
    return time, header.rate, [_note("time_rounded", message, where=where)]


def derived_rate(time: Floats) -> float:
    """Return the frame rate from time stamps: the inverse mean step without holes.

    Parameters
    ----------
    time : shape (frames,), s

    Returns
    -------
    The rate in 1/s; NaN if there are fewer than two frames.
    """
    steps = np.diff(time)
    if not len(steps) or not np.median(steps) > 0.0:
        return float("nan")
    return float(1.0 / steps[steps <= 1.5 * np.median(steps)].mean())


def _position(group: Group, header: Header, path: Path) -> list[int]:
    axes = group.axes("Position", "XYZ")
    if axes is None:
        place = f"line {header.rows}, {group.type} '{group.name}'"
        found = ", ".join(" ".join(key).strip() for key in group.columns)
        expected, remedy = "the columns X, Y and Z of Position", "Export the take with positions."
        raise unreadable(path, place, expected, found, remedy)
    return axes


def _body(name: str, group: Group, header: Header, columns: Columns, path: Path) -> RigidBody:
    position = _stack_columns(columns, _position(group, header, path)) * header.length_unit
    error = next(
        (i for (what, axis), i in group.columns.items() if "Error" in what and not axis), None
    )
    return RigidBody(
        name,
        position,
        _rotation(group, header.about, columns),
        np.full(len(position), np.nan) if error is None else columns[error] * header.length_unit,
    )


def _rotation(group: Group, about: Mapping[str, str], columns: Columns) -> Floats:
    """Return quaternions x, y, z, w; from Euler angles if the export contains those."""
    quaternion, angles = group.axes("Rotation", "XYZW"), _euler_axes(group, about)
    if quaternion is not None:
        return _stack_columns(columns, quaternion)
    rotation = np.full((len(columns[0]), 4), np.nan)
    if angles:
        from scipy.spatial.transform import Rotation

        degrees = _stack_columns(columns, angles)
        rows = np.isfinite(degrees).all(axis=1)
        if rows.any():
            turned = Rotation.from_euler(about["Rotation Type"], degrees[rows], degrees=True)
            rotation[rows] = turned.as_quat()
    return rotation


def _euler_axes(group: Group, about: Mapping[str, str]) -> list[int] | None:
    """Return the columns of Euler angles in their order, if there are any and no quaternions."""
    order = about.get("Rotation Type", "")
    if sorted(order) != ["X", "Y", "Z"] or group.axes("Rotation", "XYZW"):
        return None
    return group.axes("Rotation", order)
