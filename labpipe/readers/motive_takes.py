"""Reader of OptiTrack Motive takes exported as CSV, or saved as xlsx by a spreadsheet.

**Writes this file**: Motive (and Tracking Tools before it), "export tracking data".

**Recording**: measured markers and rigid bodies; fitted Rigid Body Markers are left out.

**Units**: from the key Length Units; row style states no unit, so metres are assumed.

**Missing data**: blank and infinite cells (table style) and NAN (row style) become NaN. So do the
pose and the mean error of a body whose counter of lost frames is not 0 (row style).

**Clock and frame**: in table style, times are frame number / export rate if the column of times is
missing or agrees within 0.6 ms, and otherwise those of that column. In row style, they are those of
the frame lines. Positions stay in the frame of the motion-capture system.

**File structure**: table style (line 1 keys and values, rows of labels, ``Frame``, data), or row
style (every line begins with its type). Everything is found by labels, not by line numbers.

**Known versions**: table style 1.21, 1.23, 1.24, 1.25; row style 1.0, 1.1.
"""

from __future__ import annotations

import csv
import re
from codecs import BOM_UTF8
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count, zip_longest
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.channels import ChannelChoice
from labpipe.readers.number_table import Body, compare_row_counts, read_columns
from labpipe.readers.raw_files import (
    ContentError,
    map_read_errors,
    read_content,
    read_head,
    require,
)
from labpipe.readers.recording_checks import make_clock_notes, make_track_notes
from labpipe.readers.workbooks import clear_sheet_cache, format_rows, is_workbook, open_sheets
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Clock, MarkerTracks, Recording, RigidBody
from labpipe.units import parse_count

_TABLE_STYLE_STARTS = (b"Format Version", b'"Format Version')
_ROW_STYLE_STARTS = (b"comment,", b'"comment",')
_MAX_HEADER_LINES = 40
"""Number of lines in which header rows are searched; the longest known header has 8."""
_LENGTH_UNITS = {"Meters": 1.0, "Centimeters": 0.01, "Millimeters": 0.001}
"""Length unit in m, keyed by the value of Length Units in the export."""
_KNOWN_VERSIONS = ("1.21", "1.23", "1.24", "1.25")
"""Format versions of known files."""
_CONVERTED_TYPES = ("Marker", "Rigid Body")
"""Types of objects whose columns are read."""
_LABELS = ("Type", "Name", "ID")
"""Labels of the header rows above the row of quantities."""
_KEYS = (
    *("Format Version", "Take Name", "Take Notes", "Capture Frame Rate", "Export Frame Rate"),
    *("Capture Start Time", "Capture Start Frame", "Total Frames in Take"),
    *("Total Exported Frames", "Rotation Type", "Length Units", "Coordinate Space"),
)
"""Known keys in line 1."""
Columns = Mapping[int, Floats]
"""Columns of shape (frames,), keyed by their index in the file; NaN where blank."""
Cells = Sequence[str]
"""Texts of the cells of one row."""


def recognise(path: Path) -> bool:
    """Return whether a file is a Motive export of either style, or a workbook of table style."""
    if not is_workbook(path):
        head = read_head(path, 64).removeprefix(BOM_UTF8)
        return head.startswith(_TABLE_STYLE_STARTS + _ROW_STYLE_STARTS)
    try:
        return _find_sheet(path) is not None
    except ReadError:
        return False


def _find_sheet(path: Path) -> str | None:
    """Find the name of the first sheet that begins with a Motive header, or None."""
    sheets = open_sheets(path).items()
    return next((name for name, rows in sheets if rows and "Format Version" in rows[0][:1]), None)


def read(path: Path, *, channels: Sequence[ChannelChoice] | None = None) -> Recording:  # noqa: ARG001
    """Read a Motive export.

    Parameters
    ----------
    path : an export of Motive, or a workbook saved from it, in which the first sheet with a Motive
        header is read
    channels : not used, because takes are read completely

    Returns
    -------
    The recording, with marker tracks and without channels.

    Raises
    ------
    ReadError
        If the file cannot be opened, the workbook, the header or a cell is damaged, no sheet has a
        Motive header, a row-style file has no frames, or the version is not 1.x.
    """
    with map_read_errors(path, "a take of Motive"):
        if is_workbook(path):
            sheets, name = open_sheets(path), _find_sheet(path)
            if name is None:
                raise ContentError.of("readers.no_sheet_of_take")
            clear_sheet_cache()
            rows = format_rows(sheets[name]).encode()
            return _read_table_style(rows, path, f"sheet '{name}'")
        content = read_content(path).data
        if not content.startswith(_ROW_STYLE_STARTS):
            return _read_table_style(content, path)
        return parse_rows(content.decode("utf-8", errors="replace"))


def _read_table_style(content: bytes, path: Path, sheet: str = "") -> Recording:
    """Read a table-style export, with tabs between the cells of a sheet."""
    separator = "\t" if sheet else ","
    lines = content.split(b"\n", _MAX_HEADER_LINES)[:_MAX_HEADER_LINES]
    text = b"\n".join(lines).decode("utf-8", errors="replace")
    rows = [next(csv.reader([line], delimiter=separator), []) for line in text.split("\n")]
    header = parse_header(rows)
    stated_rows = header.properties.get("Total Exported Frames", "")
    body = Body(
        data=content[sum(len(line) + 1 for line in lines[: header.n_rows]) :],
        names=header.names,
        columns=header.needed_columns,
        first_line=header.n_rows + 1,
        separator=separator,
        decimal=".",
        stated_rows=parse_count(stated_rows.removesuffix(".0")),
        as_exported=not sheet,
        sheet=sheet,
    )
    columns, notes = read_columns(body)
    if count := sum(int(np.isinf(values).sum()) for values in columns.values()):
        columns = {i: np.where(np.isinf(column), np.nan, column) for i, column in columns.items()}
        notes.append(QualityNote.of("readers.infinite_numbers", "take", count=count))
    tracks, track_notes = _convert_tracks(header, columns)
    objects = [{"type": group.type, "name": group.name, "id": group.id} for group in header.groups]
    properties = {**header.properties, "objects": objects}
    notes = [*_make_header_notes(header, path), *notes, *track_notes]
    reader, version = "motive-xlsx" if sheet else "motive-csv", header.properties["Format Version"]
    return make_recording(reader, version, tracks, properties, notes)


def make_recording(
    reader: str,
    version: str,
    tracks: MarkerTracks,
    properties: Mapping[str, object],
    notes: Sequence[QualityNote],
) -> Recording:
    """Make a recording of marker tracks, with notes on their clock and positions."""
    return Recording(
        reader=reader,
        program="Motive",
        program_version=version,
        markers=tracks,
        metadata=properties,
        notes=(*notes, *make_clock_notes(Clock("frames", tracks.time)), *make_track_notes(tracks)),
    )


@dataclass(frozen=True, slots=True)
class ObjectColumns:
    """The columns of one object.

    Parameters
    ----------
    type, name, id : type, name and id of the object in the header rows
    columns : indices of columns, keyed by quantity and axis, such as ``("Position", "X")`` or
        ``("Marker Quality", "")``
    """

    type: str
    name: str
    id: str
    columns: Mapping[tuple[str, str], int]

    def find_columns(self, quantity: str, axes: str) -> list[int] | None:
        """Find the indices of the columns of a quantity along some axes; None if one is missing."""
        keys = [(quantity, axis) for axis in axes if (quantity, axis) in self.columns]
        return [self.columns[key] for key in keys] if len(keys) == len(axes) else None


@dataclass(frozen=True, slots=True)
class Header:
    """The header of a table-style export.

    Parameters
    ----------
    properties : values in line 1, keyed as there
    groups : columns of each object, in the order of the file
    time_column : index of the column of times, None if there is none
    width : number of cells of a complete line, padding included
    n_rows : number of header rows
    """

    properties: Mapping[str, str]
    groups: tuple[ObjectColumns, ...]
    time_column: int | None
    width: int
    n_rows: int

    @property
    def names(self) -> list[str]:
        """Name of each column for messages; empty for a column without an object."""
        names = ["Frame", *[""] * (self.width - 1)]
        for group in self.groups:
            for quantity, column in group.columns.items():
                names[column] = " ".join((group.name, *quantity)).strip()
        return names

    @property
    def needed_columns(self) -> list[int]:
        """Indices of the columns of frame, time, bodies and measured markers, ascending."""
        columns = {0} | ({self.time_column} if self.time_column is not None else set())
        for group in self.groups:
            if group.type == "Marker":
                columns |= {*(group.find_columns("Position", "XYZ") or [])}
            if group.type == "Rigid Body":
                columns |= {*group.columns.values()}
        return sorted(columns)

    @property
    def rate(self) -> float | None:
        """Export frame rate or, if not stated, capture frame rate, 1/s; None without both."""
        for key in ("Export Frame Rate", "Capture Frame Rate"):
            text = self.properties.get(key, "")
            if re.fullmatch(r"\d+(\.\d*)?", text) and float(text) > 0.0:
                return float(text)
        return None

    @property
    def length_unit(self) -> float:
        """Length unit, m."""
        return _LENGTH_UNITS[self.properties["Length Units"]]


def parse_header(rows: Sequence[Cells]) -> Header:
    """Parse the rows above the data.

    Parameters
    ----------
    rows : cells of the first lines, at least to the row that begins with ``Frame``

    Returns
    -------
    The header.

    Raises
    ------
    ContentError
        If a required row is missing, the version is not 1.x, the unit of length is unknown, or
        columns of data have no type.
    """
    properties = _parse_keys(rows[0])
    version, unit = (properties.get(key, "") for key in ("Format Version", "Length Units"))
    if not re.fullmatch(r"1\.\d+", version):
        raise ContentError.of("readers.take_version", "line 1", version=version)
    last = next((i for i, row in enumerate(rows) if row and row[0].strip() == "Frame"), None)
    if last is None:
        raise ContentError.of("readers.no_row_of_frames", f"lines 1 to {len(rows)}")
    # An optional column ``TimeCode`` (version 1.24) is before or after the column of times.
    titles = [cell.strip().casefold().replace(" ", "") for cell in rows[last][:3]]
    leading_columns = [0, *(i for i, title in enumerate(titles) if title.startswith("time"))]
    time_column = next((i for i in leading_columns[1:] if titles[i] != "timecode"), None)
    start = leading_columns[-1] + 1
    labels = _find_label_rows(rows[1:last], start, last)
    if unit not in _LENGTH_UNITS:
        units = ", ".join(_LENGTH_UNITS)
        raise ContentError.of("readers.length_units", "line 1", units=units, unit=unit)
    label_rows = [*(labels.get(label, []) for label in (*_LABELS, "Quantity")), rows[last]]
    groups = _group_columns(label_rows, start, last)
    last_column = max((max(group.columns.values()) for group in groups), default=0)
    return Header(properties, groups, time_column, max(len(rows[last]), last_column + 1), last + 1)


def _parse_keys(cells: Cells) -> dict[str, str]:
    """Parse the keys and values of line 1, and restore unquoted commas within values."""
    pairs = dict(zip(cells[::2], cells[1::2], strict=False))
    if "Length Units" not in pairs and "Length Units" in cells:
        starts = [i for i, cell in enumerate(cells) if cell in _KEYS]
        ends = [*starts[1:], len(cells)]
        pairs = {
            cells[i]: ",".join(cells[i + 1 : end]) for i, end in zip(starts, ends, strict=True)
        }
    return {key.strip(): value.strip().rstrip(",") for key, value in pairs.items() if key.strip()}


def _find_label_rows(rows: Sequence[Cells], start: int, last: int) -> dict[str, Cells]:
    """Find the label rows by their names, or by their order if they have none (version 1.21)."""
    filled_rows = [row for row in rows if any(cell.strip() for cell in row)]
    labels = [next((x.strip() for x in row[:start] if x.strip()), "") for row in filled_rows]
    rows_by_label: dict[str, Cells] = dict(zip(labels, filled_rows, strict=True))
    if any(labels):
        rows_by_label["Quantity"] = rows_by_label.pop("", [])  # the last row without a label
    else:
        rows_by_label = dict(zip((*_LABELS, "Quantity"), filled_rows, strict=False))
    missing_labels = [label for label in _LABELS if label not in rows_by_label]
    if missing_labels and filled_rows:
        names = ", ".join(missing_labels)
        raise ContentError.of("readers.no_labels", f"lines 2 to {last}", names=names)
    return rows_by_label


def _group_columns(rows: Sequence[Cells], start: int, last: int) -> tuple[ObjectColumns, ...]:
    """Collect the columns of each object, by its type, name and id.

    The rows are those of `_LABELS`, of quantities, and of axes.
    """
    groups: dict[tuple[str, str, str, int], dict[tuple[str, str], int]] = {}
    for column, cells in enumerate(zip_longest(*rows, fillvalue="")):
        kind, name, id_, quantity, axis = (cell.strip() for cell in cells)
        if column < start or not (kind or name or quantity or axis):
            continue  # frame and time, or padding of a spreadsheet
        if not kind:
            place = f"line {last + 1}, cell {column + 1}"
            raise ContentError.of("readers.no_type", place)
        repeat, key = 0, (quantity, axis.upper())
        while key in groups.get((kind, name, id_, repeat), {}):
            repeat += 1  # another object has the same name and id
        groups.setdefault((kind, name, id_, repeat), {})[key] = column
    return tuple(ObjectColumns(key[0], key[1], key[2], columns) for key, columns in groups.items())


def _convert_tracks(header: Header, columns: Columns) -> tuple[MarkerTracks, list[QualityNote]]:
    """Convert columns to tracks in SI units, with notes on the clock."""
    frames = columns[0]
    if len(invalid_frames := np.flatnonzero(~np.isfinite(frames))):
        place = f"line {header.n_rows + 1 + int(invalid_frames[0])}, cell 1"
        raise ContentError.of("readers.no_frame_number", place)
    time, rate, notes = _compute_time(header, columns, frames)
    markers, bodies = (
        [group for group in header.groups if group.type == kind] for kind in _CONVERTED_TYPES
    )
    position_columns = [column for group in markers for column in _find_position(group, header)]
    positions = _stack_columns(columns, position_columns) * header.length_unit
    body_names = make_object_names([(group.name, group.id) for group in bodies])
    tracks = MarkerTracks(
        time=time,
        frames=frames,
        rate=rate,
        names=make_object_names([(group.name, group.id) for group in markers]),
        positions=positions.reshape(len(frames), len(markers), 3),
        bodies=tuple(
            _convert_body(name, group, header, columns)
            for name, group in zip(body_names, bodies, strict=True)
        ),
        unit_in_file=header.properties["Length Units"],
    )
    if converted_names := ", ".join(
        body.name for body in bodies if _find_euler_axes(body, header.properties)
    ):
        order = header.properties["Rotation Type"]
        notes.append(QualityNote.of("readers.rotation_from_euler", converted_names, order=order))
    return tracks, notes


def _stack_columns(columns: Columns, indices: Sequence[int]) -> Floats:
    """Stack some columns side by side, shape (frames, indices)."""
    return np.transpose([columns[i] for i in indices])


def make_object_names(objects: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Make a unique name of each object, from name, id if the name repeats, and number if both do.

    Parameters
    ----------
    objects : name and id of each object

    Returns
    -------
    The unique name of each object.

    Examples
    --------
    >>> make_object_names([("a", "1"), ("b", "2"), ("a", "3")])
    ('a 1', 'b', 'a 3')
    """
    total = Counter(name for name, _ in objects)
    names = [f"{name} {id_}".strip() if total[name] > 1 else name for name, id_ in objects]
    total, numbers = Counter(names), defaultdict[str, Iterator[int]](lambda: count(1))
    return tuple(f"{name} #{next(numbers[name])}" if total[name] > 1 else name for name in names)


def _make_header_notes(header: Header, path: Path) -> Iterator[QualityNote]:
    """Make notes on version, name of the take, unused columns, and repeated names."""
    if (version := header.properties["Format Version"]) not in _KNOWN_VERSIONS:
        versions = ", ".join(_KNOWN_VERSIONS)
        yield QualityNote.of("readers.version_unseen", "file", version=version, known=versions)
    take = header.properties.get("Take Name", "")
    if take and take != path.stem:
        yield QualityNote.of("readers.take_name_differs", "file", take=take, file=path.name)
    unused_types = Counter(x.type for x in header.groups if x.type not in _CONVERTED_TYPES)
    if fitted := unused_types.pop("Rigid Body Marker", 0):
        yield QualityNote.of("readers.fitted_markers", "markers", count=fitted)
    if other_columns := ", ".join(f"{n} of type {kind}" for kind, n in unused_types.items()):
        yield QualityNote.of("readers.columns_left_out", "columns", types=other_columns)
    objects = Counter((x.type, x.name) for x in header.groups if x.type in _CONVERTED_TYPES)
    if repeated_names := ", ".join([name for (_, name), n in objects.items() if n > 1][:5]):
        yield QualityNote.of("readers.objects_of_one_name", "markers", names=repeated_names)


def _compute_time(
    header: Header, columns: Columns, frames: Floats
) -> tuple[Floats, float, list[QualityNote]]:
    """Compute times, s, and the rate, 1/s, with notes.

    The times are frame / rate if the time column agrees or is missing, and otherwise those of the
    time column. Without a stated rate, the times and the rate are those of the time column. Rates
    that differ by a factor of ten or more are refused.
    """
    # These deviations of the time column, s, are accepted with and without a note. Version 1.23
    # rounds times to whole milliseconds.
    max_deviation, max_rounding = 0.6e-3, 2e-6
    max_ratio = 10.0  # of the stated rate and that of the time column, or the inverse
    where = "clock of the take"
    stated_time = None if header.time_column is None else columns[header.time_column]
    if header.rate is None:
        time = frames * np.nan if stated_time is None else stated_time
        return time, derive_rate(time), [QualityNote.of("readers.rate_not_stated", where)]
    time = frames / header.rate
    if stated_time is None or not len(time):
        return time, header.rate, []
    rate, expected_rate = derive_rate(stated_time), derive_rate(time)
    if max(rate, expected_rate) >= max_ratio * min(rate, expected_rate):
        place = f"line {header.n_rows}, column of times"
        rates = {"rate": header.rate, "expected": 1.0 / expected_rate, "found": 1.0 / rate}
        raise ContentError.of("readers.times_of_another_rate", place, **rates)
    deviation = 1e3 * float(np.abs(stated_time - time).max())  # NaN if a time is missing
    if not deviation <= 1e3 * max_deviation:
        note = QualityNote.of("readers.time_column_differs", where, apart=deviation)
        return stated_time, header.rate, [note]
    if deviation <= 1e3 * max_rounding:
        return time, header.rate, []
    return time, header.rate, [QualityNote.of("readers.time_rounded", where, apart=deviation)]


def derive_rate(time: Floats) -> float:
    """Derive the frame rate from time stamps, as the inverse mean step without gaps.

    Parameters
    ----------
    time : shape (frames,), s

    Returns
    -------
    The rate, 1/s; NaN if there are fewer than two frames, or the median step is not positive.
    """
    steps = np.diff(time)
    if not len(steps) or not np.median(steps) > 0.0:
        return float("nan")
    # A step of more than 1.5 median steps is a gap.
    return float(1.0 / steps[steps <= 1.5 * np.median(steps)].mean())


def _find_position(group: ObjectColumns, header: Header) -> list[int]:
    """Find the indices of the columns of a position, or raise ContentError if one is missing."""
    columns = group.find_columns("Position", "XYZ")
    if columns is None:
        place = f"line {header.n_rows}, {group.type} '{group.name}'"
        found = ", ".join(" ".join(key).strip() for key in group.columns)
        raise ContentError.of("readers.no_position", place, columns=found)
    return columns


def _convert_body(name: str, group: ObjectColumns, header: Header, columns: Columns) -> RigidBody:
    """Convert the columns of a rigid body to SI units, with NaN for quantities not exported."""
    position = _stack_columns(columns, _find_position(group, header)) * header.length_unit
    error_columns = [i for (x, axis), i in group.columns.items() if "Error" in x and not axis]
    error = columns[error_columns[0]] if error_columns else np.full(len(position), np.nan)
    rotation = _convert_rotation(group, header.properties, columns)
    return RigidBody(name, position, rotation, error * header.length_unit)


def _convert_rotation(
    group: ObjectColumns, properties: Mapping[str, str], columns: Columns
) -> Floats:
    """Convert quaternions x, y, z, w or, without them, Euler angles; NaN without both."""
    if (quaternion := group.find_columns("Rotation", "XYZW")) is not None:
        return _stack_columns(columns, quaternion)
    rotation = np.full((len(columns[0]), 4), np.nan)
    if angles := _find_euler_axes(group, properties):
        from scipy.spatial.transform import Rotation

        degrees = _stack_columns(columns, angles)
        rows, order = np.isfinite(degrees).all(axis=1), properties["Rotation Type"]
        if rows.any():
            rotation[rows] = Rotation.from_euler(order, degrees[rows], degrees=True).as_quat()
    return rotation


def _find_euler_axes(group: ObjectColumns, properties: Mapping[str, str]) -> list[int] | None:
    """Find the columns of Euler angles in their order, if there are any and no quaternions."""
    order = properties.get("Rotation Type", "")
    if sorted(order) != ["X", "Y", "Z"] or group.find_columns("Rotation", "XYZW"):
        return None
    return group.find_columns("Rotation", order)


NumbersByFrame = dict[int, list[float]]
"""Numbers of one object, keyed by index of the frame line."""


@dataclass(slots=True)
class _RowStyleTake:
    """A row-style take while its lines are read.

    Parameters
    ----------
    title, handedness, info : contents of the header lines
    bodies : id and number of markers of each rigid body, keyed by name
    frames : frame number, time (s), number of bodies and number of points of each frame line
    poses : position (m), quaternion and mean error (mm) of each body, keyed by its name
    markers : position (m) of each measured marker of the bodies, keyed by its name and the id of
        its body
    points : position (m) of each labelled point, keyed by its name and id
    """

    title: str = ""
    handedness: str = ""
    info: dict[str, str] = field(default_factory=dict)
    bodies: dict[str, tuple[str, int]] = field(default_factory=dict)
    frames: list[tuple[float, float, int, int]] = field(default_factory=list)
    poses: dict[str, NumbersByFrame] = field(default_factory=dict)
    markers: dict[tuple[str, str], NumbersByFrame] = field(default_factory=dict)
    points: dict[tuple[str, str], NumbersByFrame] = field(default_factory=dict)

    @property
    def version(self) -> str:
        """Version of the format."""
        return self.info.get("version", "1.0")


def parse_rows(text: str) -> Recording:
    """Parse a row-style export.

    Parameters
    ----------
    text : text of the whole file

    Returns
    -------
    The recording. The measured markers of a body are named ``<body>-Marker <n>``, as in version
    1.1. The file states no unit, and positions are assumed to be in metres.

    Raises
    ------
    ContentError
        If a line before the last is faulty (in its number of cells, a number or its type, or as a
        body before its frame line), the version is not 1.x, or there are no frames.

    Notes
    -----
    A lost body repeats its last pose. Its pose and mean error are NaN in frames in which the
    counter of frames since it was last tracked is not 0. A faulty last line is omitted with a note.
    """
    take, notes = _read_lines(text.splitlines())
    tracks = _build_row_style_tracks(take)
    bodies = {name: {"id": id_, "markers": n} for name, (id_, n) in take.bodies.items()}
    properties: dict[str, object] = {
        "title": take.title,
        "handedness": take.handedness,
        "info": take.info,
        "rigid_bodies": bodies,
    }
    notes += _make_row_style_notes(take, tracks)
    return make_recording("motive-csv", take.version, tracks, properties, notes)


def _read_lines(lines: Sequence[str]) -> tuple[_RowStyleTake, list[QualityNote]]:
    """Read all lines, with a note on a faulty last line."""
    take, notes = _RowStyleTake(), []
    for number, line in enumerate(lines, start=1):
        try:
            if cells := next(csv.reader([line]), []):
                _read_line(take, cells)
        except (ValueError, IndexError, KeyError, csv.Error) as error:
            if number < len(lines):
                facts = {"line": line[:20], "reason": error}
                raise ContentError.of("readers.line_of_take", f"line {number}", **facts) from error
            notes.append(QualityNote.of("readers.truncated", "file", line=number))
    if not take.version.startswith("1."):
        raise ContentError.of("readers.take_version", "info", version=take.version)
    if not take.frames:
        raise ContentError.of("readers.no_frames", f"lines 1 to {len(lines)}")
    return take, notes


def _make_row_style_notes(take: _RowStyleTake, tracks: MarkerTracks) -> Iterator[QualityNote]:
    """Make notes on unit, number of frames, lost bodies and visible markers."""
    n_bodies, n_points = np.array(take.frames)[:, 2:].astype(int).T
    total, without_body = len(n_bodies), int((n_bodies == 0).sum())
    yield QualityNote.of("readers.unit_assumed", "take")
    yield from compare_row_counts(parse_count(take.info.get("framecount", "")), total)
    if without_body:
        yield QualityNote.of("readers.frames_without_body", "take", count=without_body, total=total)
    ends = {"least": n_points.min(), "most": n_points.max()}
    yield QualityNote.of("readers.visible_markers", "markers", **ends)
    n_body_markers = np.isfinite(tracks.positions[:, : len(take.markers), 0]).sum(axis=1)
    count = np.maximum(n_points - n_body_markers, 0).sum()
    if count and not take.points:  # version 1.0 does not label points
        yield QualityNote.of("readers.anonymous_markers", "markers", count=count)


def _read_line(take: _RowStyleTake, cells: list[str]) -> None:
    match cells[0]:
        case "comment":
            take.title = take.title or cells[1]
        case "info":
            take.info[cells[1]] = cells[2]
        case "righthanded" | "lefthanded" as handedness:
            take.handedness = handedness
        case "frame":
            _read_frame(take, cells)
        case "trackable" | "rigidbody":
            if parse_count(cells[1]) is not None and cells[3] in take.bodies:
                _read_body(take, cells)
            else:
                name, id_, count = cells[1], cells[2], int(cells[3])
                require(len(cells) == 4 + 3 * count, f"{len(cells)} cells for {count} markers")
                take.bodies[name], take.poses[name] = (id_, count), {}
                for number in range(1, count + 1):
                    take.markers[f"{name}-Marker {number}", id_] = {}
        case _:
            require(False, "unknown row type")


def _read_frame(take: _RowStyleTake, cells: list[str]) -> None:
    """Read a frame line with number, time, bodies with their poses, and visible points."""
    # The cells of a body are id, x y z, qx qy qz qw, yaw pitch roll.
    pose_cells = 11
    count = int(cells[3])
    start = 4 + pose_cells * count
    n_points, width = int(cells[start]), 5 if take.version != "1.0" else 4
    n_cells = start + 1 + width * n_points
    require(len(cells) == n_cells, f"{len(cells)} instead of {n_cells} cells")
    frame = float(cells[1]), float(cells[2]), count, n_points
    names_by_id = {id_: name for name, (id_, _) in take.bodies.items()}
    poses = [
        (names_by_id[cells[i]], _parse_floats(cells[i + 1 : i + 8]))
        for i in range(4, start, pose_cells)
    ]
    points = [
        (cells[i + 3 : i + width], _parse_floats(cells[i : i + 3]))
        for i in range(start + 1, len(cells), width)
    ]
    row = len(take.frames)  # all cells have been read, so no part of a faulty line is stored
    take.frames.append(frame)
    for name, pose in poses:
        take.poses[name][row] = [*pose, np.nan]
    for label, position in points:
        if len(label) == 2:
            take.points.setdefault((label[1], label[0]), {})[row] = position


def _read_body(take: _RowStyleTake, cells: list[str]) -> None:
    """Read a body line with counter, markers of the model, measured markers and mean error."""
    name, count, model_cells = cells[3], int(cells[6]), 4 if take.version != "1.0" else 3
    n_cells = 7 + (model_cells + 5) * count + 1
    require(len(cells) == n_cells, f"{len(cells)} instead of {n_cells} cells")
    start = 7 + model_cells * count
    positions = [_parse_floats(cells[i : i + 3]) for i in range(start, start + 3 * count, 3)]
    error, is_tracked = float(cells[-1]), int(cells[5]) == 0
    follows_frame = bool(take.frames) and float(cells[1]) == take.frames[-1][0]
    require(follows_frame, f"frame {cells[1]} has no frame line before it")
    row, (id_, n_markers) = len(take.frames) - 1, take.bodies[name]
    for number, position in enumerate(positions[:n_markers], start=1):
        take.markers[f"{name}-Marker {number}", id_][row] = position
    if is_tracked:
        take.poses[name].setdefault(row, [np.nan] * 8)[-1] = error
    else:
        take.poses[name].pop(row, None)  # it is the last known pose


def _parse_floats(cells: Sequence[str]) -> list[float]:
    return [float(cell) for cell in cells]


def _build_row_style_tracks(take: _RowStyleTake) -> MarkerTracks:
    """Build tracks of the measured markers of bodies and, in version 1.1, other labelled points."""
    frame_numbers, time = np.array(take.frames)[:, :2].T
    body_markers = {name for name, _ in take.markers}
    points = {label: xyz for label, xyz in take.points.items() if label[0] not in body_markers}
    markers = take.markers | points
    positions = [_fill_frames(position, 3, len(time)) for position in markers.values()]
    poses = {name: _fill_frames(pose, 8, len(time)) for name, pose in take.poses.items()}
    return MarkerTracks(
        time=time,
        frames=frame_numbers,
        rate=derive_rate(time),
        names=make_object_names([*markers]),
        positions=np.stack(positions, axis=1) if positions else np.empty((len(time), 0, 3)),
        bodies=tuple(  # the mean error is in mm per marker, while positions are in metres
            RigidBody(name, pose[:, :3], pose[:, 3:7], 1e-3 * pose[:, 7])
            for name, pose in poses.items()
        ),
    )


def _fill_frames(numbers: NumbersByFrame, width: int, n_frames: int) -> Floats:
    """Arrange the numbers of an object by frame, shape (n_frames, width), with NaN elsewhere."""
    table = np.full((n_frames, width), np.nan)
    table[list(numbers)] = [*numbers.values()] or np.empty((0, width))
    return table
