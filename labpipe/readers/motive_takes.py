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
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.channels import ChannelChoice
from labpipe.readers.number_table import Body, read_columns
from labpipe.readers.raw_files import read_content, read_head, reading
from labpipe.readers.recording_checks import make_clock_notes, make_track_notes
from labpipe.readers.workbooks import clear_sheet_cache, format_rows, is_workbook, open_sheets
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Clock, MarkerTracks, Recording, RigidBody
from labpipe.units import parse_count

_TABLE_STARTS = (b"Format Version", b'"Format Version')
_ROW_STARTS = (b"comment,", b'"comment",')
_HEADER_LINES = 40
"""Lines searched for header rows; the longest real header has 8."""
_LENGTH_UNITS = {"Meters": 1.0, "Centimeters": 0.01, "Millimeters": 0.001}
"""Length Units of the export, in m."""
_KNOWN_VERSIONS = ("1.21", "1.23", "1.24", "1.25")
"""Format versions of known files."""
_READ_TYPES = ("Marker", "Rigid Body")
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


def read(path: Path, *, channels: Sequence[ChannelChoice] | None = None) -> Recording:  # noqa: ARG001
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
        sheets, name = open_sheets(path), _find_sheet(path)
        if name is None:
            raise ReadError.about("readers.no_sheet_of_take", path)
        clear_sheet_cache()
        return _read_table_style(format_rows(sheets[name]).encode(), path, f"sheet '{name}'")
    content = read_content(path).data
    if not content.startswith(_ROW_STARTS):
        return _read_table_style(content, path)
    from labpipe.readers.motive_rows import parse_rows

    with reading(path, "lines of a row-style export"):
        return parse_rows(content.decode("utf-8", errors="replace"), path)


def _read_table_style(content: bytes, path: Path, sheet: str = "") -> Recording:
    separator = "\t" if sheet else ","
    lines = content.split(b"\n", _HEADER_LINES)[:_HEADER_LINES]
    with reading(path, "header rows of cells separated by commas"):
        text = b"\n".join(lines).decode("utf-8", errors="replace")
        rows = [next(csv.reader([line], delimiter=separator), []) for line in text.split("\n")]
    header = parse_header(rows, path)
    body = Body(
        data=content[sum(len(line) + 1 for line in lines[: header.rows]) :],
        names=header.names,
        columns=header.needed_columns,
        first_line=header.rows + 1,
        separator=separator,
        decimal=".",
        stated_rows=parse_count(header.about.get("Total Exported Frames", "").removesuffix(".0")),
        as_exported=not sheet,
        sheet=sheet,
    )
    columns, notes = read_columns(body, path)
    if count := sum(int(np.isinf(values).sum()) for values in columns.values()):
        columns = {i: np.where(np.isinf(column), np.nan, column) for i, column in columns.items()}
        notes.append(QualityNote.of("readers.infinite_numbers", "take", count=count))
    tracks, notes_on_tracks = _convert_tracks(header, columns, path)
    objects = [{"type": group.type, "name": group.name, "id": group.id} for group in header.groups]
    about = {**header.about, "objects": objects}
    notes = [*_make_header_notes(header, path), *notes, *notes_on_tracks]
    reader, version = "motive-xlsx" if sheet else "motive-csv", header.about["Format Version"]
    return make_recording(reader, version, tracks, about, notes)


def make_recording(
    reader: str,
    version: str,
    tracks: MarkerTracks,
    about: Mapping[str, object],
    notes: Sequence[QualityNote],
) -> Recording:
    """Make a recording of marker tracks, with the notes on their clock and positions."""
    return Recording(
        reader=reader,
        program="Motive",
        program_version=version,
        markers=tracks,
        metadata=about,
        notes=(*notes, *make_clock_notes(Clock("frames", tracks.time)), *make_track_notes(tracks)),
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
    def rate(self) -> float | None:
        """Return the export frame rate in 1/s (the capture rate if it is not stated)."""
        for key in ("Export Frame Rate", "Capture Frame Rate"):
            text = self.about.get(key, "")
            if re.fullmatch(r"\d+(\.\d*)?", text) and float(text) > 0.0:
                return float(text)
        return None

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
    about = _parse_keys(rows[0])
    version, unit = (about.get(key, "") for key in ("Format Version", "Length Units"))
    if not re.fullmatch(r"1\.\d+", version):
        raise ReadError.about("readers.take_version", path, "line 1", version=version)
    last = next((i for i, row in enumerate(rows) if row and row[0].strip() == "Frame"), None)
    if last is None:
        raise ReadError.about("readers.no_row_of_frames", path, f"lines 1 to {len(rows)}")
    start, time_column = _find_leading_columns(rows[last])
    labels = _find_label_rows(rows[1:last], start, last, path)
    if unit not in _LENGTH_UNITS:
        units = ", ".join(_LENGTH_UNITS)
        raise ReadError.about("readers.length_units", path, "line 1", units=units, unit=unit)
    label_rows = [*(labels.get(label, []) for label in (*_LABELS, "Quantity")), rows[last]]
    groups = _group_columns(label_rows, start, last, path)
    furthest = max((max(group.columns.values()) for group in groups), default=0)
    return Header(about, groups, time_column, max(len(rows[last]), furthest + 1), last + 1)


def _parse_keys(cells: Cells) -> dict[str, str]:
    """Return the values of line 1 by key; unquoted commas within values are restored."""
    pairs = dict(zip(cells[::2], cells[1::2], strict=False))
    if "Length Units" not in pairs and "Length Units" in cells:
        known = [i for i, cell in enumerate(cells) if cell in _KEYS]
        ends = [*known[1:], len(cells)]
        pairs = {cells[i]: ",".join(cells[i + 1 : end]) for i, end in zip(known, ends, strict=True)}
    return {key.strip(): value.strip().rstrip(",") for key, value in pairs.items() if key.strip()}


def _find_leading_columns(row: Cells) -> tuple[int, int | None]:
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


def _find_label_rows(rows: Sequence[Cells], start: int, last: int, path: Path) -> dict[str, Cells]:
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
    if missing and filled:
        names = ", ".join(missing)
        raise ReadError.about("readers.no_labels", path, f"lines 2 to {last}", names=names)
    return labels


def _group_columns(rows: Sequence[Cells], start: int, last: int, path: Path) -> tuple[Group, ...]:
    """Collect the columns of each object, keyed on type, name and id.

    `rows` are those of `_LABELS`, of quantities, and of axes.
    """
    groups: dict[tuple[str, str, str, int], dict[tuple[str, str], int]] = {}
    for column, cells in enumerate(zip_longest(*rows, fillvalue="")):
        kind, name, id_, quantity, axis = (cell.strip() for cell in cells)
        if column < start or not (kind or name or quantity or axis):
            continue  # frame and time, or padding of a spreadsheet
        if not kind:
            place = f"line {last + 1}, cell {column + 1}"
            raise ReadError.about("readers.no_type", path, place)
        number, key = 0, (quantity, axis.upper())
        while key in groups.get((kind, name, id_, number), {}):
            number += 1  # the same name and id again: another object
        groups.setdefault((kind, name, id_, number), {})[key] = column
    return tuple(Group(key[0], key[1], key[2], columns) for key, columns in groups.items())


def _convert_tracks(
    header: Header, columns: Columns, path: Path
) -> tuple[MarkerTracks, list[QualityNote]]:
    """Convert columns to tracks in SI; return notes on the column of times and on rotations."""
    frames = columns[0]
    if len(invalid_frames := np.flatnonzero(~np.isfinite(frames))):
        place = f"line {header.rows + 1 + int(invalid_frames[0])}, cell 1"
        raise ReadError.about("readers.no_frame_number", path, place)
    time, rate, notes = _compute_time(header, columns, frames)
    markers, bodies = (
        [group for group in header.groups if group.type == kind] for kind in _READ_TYPES
    )
    places = [column for group in markers for column in _find_position(group, header, path)]
    positions = _stack_columns(columns, places) * header.length_unit
    body_names = make_names_unique([(group.name, group.id) for group in bodies])
    tracks = MarkerTracks(
        time=time,
        frames=frames,
        rate=rate,
        names=make_names_unique([(group.name, group.id) for group in markers]),
        positions=positions.reshape(len(frames), len(markers), 3),
        bodies=tuple(
            _convert_body(name, group, header, columns, path)
            for name, group in zip(body_names, bodies, strict=True)
        ),
        unit_in_file=header.about["Length Units"],
    )
    if converted_names := ", ".join(
        body.name for body in bodies if _find_euler_axes(body, header.about)
    ):
        order = header.about["Rotation Type"]
        notes.append(QualityNote.of("readers.rotation_from_euler", converted_names, order=order))
    return tracks, notes


def _stack_columns(columns: Columns, chosen: Sequence[int]) -> Floats:
    """Return columns side by side, shape (frames, chosen)."""
    return np.transpose([columns[column] for column in chosen])


def make_names_unique(objects: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Make names unique: repeated ones get their id, and a number if that repeats as well.

    Parameters
    ----------
    objects : name and id of each

    Returns
    -------
    One name for each.

    Examples
    --------
    >>> make_names_unique([("a", "1"), ("b", "2"), ("a", "3")])
    ('a 1', 'b', 'a 3')
    """
    total = Counter(name for name, _ in objects)
    names = [f"{name} {id_}".strip() if total[name] > 1 else name for name, id_ in objects]
    return tuple(
        f"{name} #{names[: i + 1].count(name)}" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    )


def _make_header_notes(header: Header, path: Path) -> Iterator[QualityNote]:
    if (version := header.about["Format Version"]) not in _KNOWN_VERSIONS:
        known = ", ".join(_KNOWN_VERSIONS)
        yield QualityNote.of("readers.version_unseen", "file", version=version, known=known)
    take = header.about.get("Take Name", "")
    if take and take != path.stem:
        yield QualityNote.of("readers.take_name_differs", "file", take=take, file=path.name)
    left_out = Counter(group.type for group in header.groups if group.type not in _READ_TYPES)
    if fitted := left_out.pop("Rigid Body Marker", 0):
        yield QualityNote.of("readers.fitted_markers", "markers", count=fitted)
    if others := ", ".join(f"{n} of type {kind}" for kind, n in left_out.items()):
        yield QualityNote.of("readers.columns_left_out", "columns", types=others)
    names = Counter((group.type, group.name) for group in header.groups)
    shared = [name for (kind, name), n in names.items() if n > 1 and kind in _READ_TYPES]
    if shared:
        yield QualityNote.of("readers.objects_of_one_name", "markers", names=", ".join(shared[:5]))


def _compute_time(
    header: Header, columns: Columns, frames: Floats
) -> tuple[Floats, float, list[QualityNote]]:
    """Return frame / export rate if the time column agrees with it, else the time column."""
    # Deviations in s of the time column: 1.23 rounds to whole milliseconds.
    max_deviation, rounding = 0.6e-3, 2e-6
    where = "clock of the take"
    stated_time = None if header.time_column is None else columns[header.time_column]
    if header.rate is None:
        time = frames * np.nan if stated_time is None else stated_time
        return time, derive_rate(time), [QualityNote.of("readers.rate_not_stated", where)]
    time = frames / header.rate
    if stated_time is None or not len(time):
        return time, header.rate, []
    deviation = 1e3 * float(np.abs(stated_time - time).max())  # NaN if a time is missing
    if not deviation <= 1e3 * max_deviation:
        note = QualityNote.of("readers.time_column_differs", where, apart=deviation)
        return stated_time, header.rate, [note]
    if deviation <= 1e3 * rounding:
        return time, header.rate, []
    return time, header.rate, [QualityNote.of("readers.time_rounded", where, apart=deviation)]


def derive_rate(time: Floats) -> float:
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


def _find_position(group: Group, header: Header, path: Path) -> list[int]:
    axes = group.axes("Position", "XYZ")
    if axes is None:
        place = f"line {header.rows}, {group.type} '{group.name}'"
        found = ", ".join(" ".join(key).strip() for key in group.columns)
        raise ReadError.about("readers.no_position", path, place, columns=found)
    return axes


def _convert_body(
    name: str, group: Group, header: Header, columns: Columns, path: Path
) -> RigidBody:
    position = _stack_columns(columns, _find_position(group, header, path)) * header.length_unit
    error = next(
        (i for (what, axis), i in group.columns.items() if "Error" in what and not axis), None
    )
    return RigidBody(
        name,
        position,
        _convert_rotation(group, header.about, columns),
        np.full(len(position), np.nan) if error is None else columns[error] * header.length_unit,
    )


def _convert_rotation(group: Group, about: Mapping[str, str], columns: Columns) -> Floats:
    """Return quaternions x, y, z, w; from Euler angles if the export contains those."""
    if (quaternion := group.axes("Rotation", "XYZW")) is not None:
        return _stack_columns(columns, quaternion)
    rotation = np.full((len(columns[0]), 4), np.nan)
    if angles := _find_euler_axes(group, about):
        from scipy.spatial.transform import Rotation

        degrees = _stack_columns(columns, angles)
        rows = np.isfinite(degrees).all(axis=1)
        if rows.any():
            rotations = Rotation.from_euler(about["Rotation Type"], degrees[rows], degrees=True)
            rotation[rows] = rotations.as_quat()
    return rotation


def _find_euler_axes(group: Group, about: Mapping[str, str]) -> list[int] | None:
    """Return the columns of Euler angles in their order, if there are any and no quaternions."""
    order = about.get("Rotation Type", "")
    if sorted(order) != ["X", "Y", "Z"] or group.axes("Rotation", "XYZW"):
        return None
    return group.axes("Rotation", order)
