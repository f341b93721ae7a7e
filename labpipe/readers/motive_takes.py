"""Reader of OptiTrack Motive takes exported as CSV, or saved as xlsx by a spreadsheet.

**Writes this file**: Motive (and Tracking Tools before it), "export tracking data".

**Recording**: measured markers and rigid bodies. Fitted Rigid Body Markers are not read.

**Units**: from the key Length Units. Row style states no unit, so metres are assumed.

**Missing data**: blank and infinite cells (table style) and NAN (row style) become NaN. In row
style, the pose and the mean error of a body whose counter of lost frames is not 0 become NaN too.

**Clock and frame**: in table style, times are frame number / export rate if the column of times is
missing or agrees within 0.6 ms, and otherwise those of that column. In row style, they are those of
the frame lines. Positions stay in the frame of the motion-capture system.

**File structure**: table style (keys and values in line 1, header rows to the one that begins with
``Frame``, data), or row style (every line begins with its type). Header rows and columns are found
by their labels, not by their positions.

**Known versions**: table style 1.21, 1.23, 1.24, 1.25; row style 1.0, 1.1.
"""

from __future__ import annotations

import csv
import re
from codecs import BOM_UTF8
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count, pairwise, zip_longest
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.channels import ChannelChoice
from labpipe.readers.number_table import Body, make_row_count_notes, read_columns
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
"""Size of each length unit, m, keyed by the value of Length Units in the export."""
_KNOWN_VERSIONS = ("1.21", "1.23", "1.24", "1.25")
"""Versions of the table style of known files."""
_READ_TYPES = ("Marker", "Rigid Body")
"""Types of objects whose columns are read."""
_OBJECT_LABELS = ("Type", "Name", "ID")
"""Labels of the header rows above the row of quantities."""
_PROPERTY_KEYS = (
    *("Format Version", "Take Name", "Take Notes", "Capture Frame Rate", "Export Frame Rate"),
    *("Capture Start Time", "Capture Start Frame", "Total Frames in Take"),
    *("Total Exported Frames", "Rotation Type", "Length Units", "Coordinate Space"),
)
"""Known keys in line 1."""
Columns = Mapping[int, Floats]
"""Values of each column, shape (frames,), keyed by index of the column; NaN in blank cells."""
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
    path : a Motive export, or a workbook saved from one, of which the first sheet with a Motive
        header is read
    channels : not used, because takes are read completely

    Returns
    -------
    The recording, with marker tracks and without channels.

    Raises
    ------
    ReadError
        If the file cannot be opened, the version is not 1.x, or the unit of length is unknown. If
        the workbook, the header, a row or a cell is damaged. If no sheet has a Motive header, a
        row-style file has no frames, or the times contradict the frame rate.
    """
    with map_read_errors(path, "a take of Motive"):
        if is_workbook(path):
            sheets, sheet_name = open_sheets(path), _find_sheet(path)
            if sheet_name is None:
                raise ContentError.of("readers.no_sheet_of_take")
            clear_sheet_cache()
            rows = format_rows(sheets[sheet_name]).encode()
            return _read_table_style(rows, path, f"sheet '{sheet_name}'")
        content = read_content(path).data
        if not content.startswith(_ROW_STYLE_STARTS):
            return _read_table_style(content, path)
        return parse_rows(content.decode("utf-8", errors="replace"))


def _read_table_style(content: bytes, path: Path, sheet_label: str = "") -> Recording:
    """Read a table-style text, or the text of a sheet, in which tabs separate the cells."""
    separator = "\t" if sheet_label else ","
    lines = content.split(b"\n", _MAX_HEADER_LINES)[:_MAX_HEADER_LINES]
    text = b"\n".join(lines).decode("utf-8", errors="replace")
    rows = [next(csv.reader([line], delimiter=separator), []) for line in text.split("\n")]
    header = parse_header(rows)
    stated_frames = header.properties.get("Total Exported Frames", "")
    body = Body(
        data=content[sum(len(line) + 1 for line in lines[: header.n_rows]) :],
        names=header.names,
        columns=header.needed_columns,
        first_line=header.n_rows + 1,
        separator=separator,
        decimal=".",
        stated_rows=parse_count(stated_frames.removesuffix(".0")),
        as_exported=not sheet_label,
        sheet=sheet_label,
    )
    columns, notes = read_columns(body)
    if n_infinite := sum(int(np.isinf(values).sum()) for values in columns.values()):
        columns = {i: np.where(np.isinf(values), np.nan, values) for i, values in columns.items()}
        notes.append(QualityNote.of("readers.infinite_numbers", "take", count=n_infinite))
    tracks, track_notes = _convert_tracks(header, columns)
    objects = [{"type": group.type, "name": group.name, "id": group.id} for group in header.groups]
    properties = {**header.properties, "objects": objects}
    notes = [*_make_header_notes(header, path), *notes, *track_notes]
    reader = "motive-xlsx" if sheet_label else "motive-csv"
    return make_recording(reader, header.properties["Format Version"], tracks, properties, notes)


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
    """The columns of one object of a table-style export, such as a marker or a rigid body.

    Parameters
    ----------
    type, name, id : type, name and id of the object in the header rows
    columns : index of each column in the file, keyed by quantity and axis, such as
        ``("Position", "X")`` or ``("Marker Quality", "")``
    """

    type: str
    name: str
    id: str
    columns: Mapping[tuple[str, str], int]

    def find_columns(self, quantity: str, axes: str) -> list[int] | None:
        """Find the columns of a quantity, one for each axis; None if one is missing."""
        keys = [(quantity, axis) for axis in axes if (quantity, axis) in self.columns]
        return [self.columns[key] for key in keys] if len(keys) == len(axes) else None


@dataclass(frozen=True, slots=True)
class Header:
    """The header of a table-style export.

    Parameters
    ----------
    properties : values in line 1, keyed by the keys in that line
    groups : column groups, one for each object, in the order of the file
    time_column : index of the column of times; None if there is none
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
        """Size of the length unit, m."""
        return _LENGTH_UNITS[self.properties["Length Units"]]


def parse_header(rows: Sequence[Cells]) -> Header:
    """Parse the rows above the data.

    Parameters
    ----------
    rows : cells of the first lines, including the row that begins with ``Frame``

    Returns
    -------
    The header.

    Raises
    ------
    ContentError
        If a required row is missing, the version is not 1.x, the unit of length is unknown, or a
        column of data has no type.
    """
    properties = _parse_properties(rows[0])
    version, unit = (properties.get(key, "") for key in ("Format Version", "Length Units"))
    if not re.fullmatch(r"1\.\d+", version):
        raise ContentError.of("readers.take_version", "line 1", version=version)
    axis_row = next((i for i, row in enumerate(rows) if row and row[0].strip() == "Frame"), None)
    if axis_row is None:
        raise ContentError.of("readers.no_row_of_frames", f"lines 1 to {len(rows)}")
    # An optional column ``TimeCode`` (version 1.24) is before or after the column of times.
    titles = [cell.strip().casefold().replace(" ", "") for cell in rows[axis_row][:3]]
    leading_columns = [0, *(i for i, title in enumerate(titles) if title.startswith("time"))]
    time_column = next((i for i in leading_columns[1:] if titles[i] != "timecode"), None)
    first_column = leading_columns[-1] + 1
    label_rows = _find_label_rows(rows[1:axis_row], first_column)
    if unit not in _LENGTH_UNITS:
        units = ", ".join(_LENGTH_UNITS)
        raise ContentError.of("readers.length_units", "line 1", units=units, unit=unit)
    ordered_rows = [label_rows.get(label, []) for label in (*_OBJECT_LABELS, "Quantity")]
    groups = _group_columns([*ordered_rows, rows[axis_row]], first_column, axis_row)
    last_column = max((max(group.columns.values()) for group in groups), default=0)
    width = max(len(rows[axis_row]), last_column + 1)
    return Header(properties, groups, time_column, width=width, n_rows=axis_row + 1)


def _parse_properties(cells: Cells) -> dict[str, str]:
    """Parse the keys and values of line 1, and restore unquoted commas within values."""
    entries = dict(zip(cells[::2], cells[1::2], strict=False))
    if "Length Units" not in entries and "Length Units" in cells:
        bounds = [*(i for i, cell in enumerate(cells) if cell in _PROPERTY_KEYS), len(cells)]
        entries = {cells[i]: ",".join(cells[i + 1 : end]) for i, end in pairwise(bounds)}
    return {key.strip(): value.strip().rstrip(",") for key, value in entries.items() if key.strip()}


def _find_label_rows(rows: Sequence[Cells], first_column: int) -> dict[str, Cells]:
    """Find the header rows below line 1, keyed by the label left of the first column of an object.

    Rows without labels (version 1.21) have the order of `_OBJECT_LABELS`.
    """
    filled_rows = [row for row in rows if any(cell.strip() for cell in row)]
    labels = [next((x.strip() for x in row[:first_column] if x.strip()), "") for row in filled_rows]
    rows_by_label: dict[str, Cells] = dict(zip(labels, filled_rows, strict=True))
    if any(labels):
        rows_by_label["Quantity"] = rows_by_label.pop("", [])  # this row has no label
    else:
        rows_by_label = dict(zip((*_OBJECT_LABELS, "Quantity"), filled_rows, strict=False))
    missing_labels = [label for label in _OBJECT_LABELS if label not in rows_by_label]
    if missing_labels and filled_rows:
        names = ", ".join(missing_labels)
        raise ContentError.of("readers.no_labels", f"lines 2 to {len(rows) + 1}", names=names)
    return rows_by_label


def _group_columns(
    rows: Sequence[Cells], first_column: int, axis_row: int
) -> tuple[ObjectColumns, ...]:
    """Group the columns by object, which has a type, a name and an id.

    The rows contain the types, names, ids, quantities and axes of the columns.
    """
    groups: dict[tuple[str, str, str, int], dict[tuple[str, str], int]] = {}
    for column, cells in enumerate(zip_longest(*rows, fillvalue="")):
        kind, name, id_, quantity, axis = (cell.strip() for cell in cells)
        if column < first_column or not (kind or name or quantity or axis):
            continue  # the column contains frames or times, or is padding of a spreadsheet
        if not kind:
            raise ContentError.of("readers.no_type", f"line {axis_row + 1}, cell {column + 1}")
        key = quantity, axis.upper()
        n_namesakes = 0  # number of earlier objects with the same type, name and id
        while key in groups.get((kind, name, id_, n_namesakes), {}):
            n_namesakes += 1
        groups.setdefault((kind, name, id_, n_namesakes), {})[key] = column
    return tuple(ObjectColumns(*key[:3], columns) for key, columns in groups.items())


def _convert_tracks(header: Header, columns: Columns) -> tuple[MarkerTracks, list[QualityNote]]:
    """Convert columns to tracks in SI units, with notes on the clock and converted rotations."""
    frames = columns[0]
    if len(invalid_frames := np.flatnonzero(~np.isfinite(frames))):
        place = f"line {header.n_rows + 1 + int(invalid_frames[0])}, cell 1"
        raise ContentError.of("readers.no_frame_number", place)
    time, rate, notes = _compute_time(header, columns, frames)
    markers, bodies = (
        [group for group in header.groups if group.type == kind] for kind in _READ_TYPES
    )
    position_columns = [i for group in markers for i in _get_position_columns(group, header)]
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
        body.name for body in bodies if _find_euler_columns(body, header.properties)
    ):
        order = header.properties["Rotation Type"]
        notes.append(QualityNote.of("readers.rotation_from_euler", converted_names, order=order))
    return tracks, notes


def _stack_columns(columns: Columns, indices: Sequence[int]) -> Floats:
    """Stack the columns of some indices side by side, shape (frames, indices)."""
    return np.transpose([columns[i] for i in indices])


def make_object_names(objects: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Make a unique name for each object.

    Parameters
    ----------
    objects : name and id of each object

    Returns
    -------
    The names. A repeated name is followed by the id, and a repeated pair of both by ``#1``, ``#2``.

    Examples
    --------
    >>> make_object_names([("a", "1"), ("b", "2"), ("a", "3")])
    ('a 1', 'b', 'a 3')
    """
    n_objects = Counter(name for name, _ in objects)
    names = [f"{name} {id_}".strip() if n_objects[name] > 1 else name for name, id_ in objects]
    n_names, counters = Counter(names), defaultdict[str, Iterator[int]](lambda: count(1))
    return tuple(f"{x} #{next(counters[x])}" if n_names[x] > 1 else x for x in names)


def _make_header_notes(header: Header, path: Path) -> Iterator[QualityNote]:
    """Make notes on the version, the name of the take, unread columns and repeated names."""
    if (version := header.properties["Format Version"]) not in _KNOWN_VERSIONS:
        versions = ", ".join(_KNOWN_VERSIONS)
        yield QualityNote.of("readers.version_unseen", "file", version=version, known=versions)
    take_name = header.properties.get("Take Name", "")
    if take_name and take_name != path.stem:
        yield QualityNote.of("readers.take_name_differs", "file", take=take_name, file=path.name)
    unread_types = Counter(x.type for x in header.groups if x.type not in _READ_TYPES)
    if n_fitted := unread_types.pop("Rigid Body Marker", 0):
        yield QualityNote.of("readers.fitted_markers", "markers", count=n_fitted)
    if other_columns := ", ".join(f"{n} of type {kind}" for kind, n in unread_types.items()):
        yield QualityNote.of("readers.columns_left_out", "columns", types=other_columns)
    objects = Counter((x.type, x.name) for x in header.groups if x.type in _READ_TYPES)
    if repeated_names := ", ".join([name for (_, name), n in objects.items() if n > 1][:5]):
        yield QualityNote.of("readers.objects_of_one_name", "markers", names=repeated_names)


def _compute_time(
    header: Header, columns: Columns, frames: Floats
) -> tuple[Floats, float, list[QualityNote]]:
    """Compute the time of each frame, s, and the frame rate, 1/s, with notes.

    The times are frame / rate if the time column agrees or is missing. Otherwise, and without a
    stated rate, the times and the rate are those of the time column. A stated rate that differs by
    a factor of ten or more from that of the time column is refused.
    """
    # The time column agrees if it deviates by up to `max_deviation`, s, because version 1.23 rounds
    # times to whole milliseconds. Up to `max_rounding`, s, there is no note on the deviation.
    max_deviation, max_rounding = 0.6e-3, 2e-6
    max_rate_ratio = 10.0
    where = "clock of the take"
    stated_time = None if header.time_column is None else columns[header.time_column]
    if header.rate is None:
        time = frames * np.nan if stated_time is None else stated_time
        return time, derive_rate(time), [QualityNote.of("readers.rate_not_stated", where)]
    time = frames / header.rate
    if stated_time is None or not len(time):
        return time, header.rate, []
    rate, expected_rate = derive_rate(stated_time), derive_rate(time)
    if max(rate, expected_rate) >= max_rate_ratio * min(rate, expected_rate):
        place = f"line {header.n_rows}, column of times"
        rates = {"rate": header.rate, "expected": 1.0 / expected_rate, "found": 1.0 / rate}
        raise ContentError.of("readers.times_of_another_rate", place, **rates)
    deviation_ms = 1e3 * float(np.abs(stated_time - time).max())  # NaN if a time is missing
    if not deviation_ms <= 1e3 * max_deviation:
        note = QualityNote.of("readers.time_column_differs", where, apart=deviation_ms)
        return stated_time, rate, [note]
    if deviation_ms <= 1e3 * max_rounding:
        return time, header.rate, []
    return time, header.rate, [QualityNote.of("readers.time_rounded", where, apart=deviation_ms)]


def derive_rate(time: Floats) -> float:
    """Derive the frame rate from time stamps, as the inverse of the mean step without gaps.

    Parameters
    ----------
    time : shape (frames,), s

    Returns
    -------
    The rate, 1/s; NaN if there are fewer than two frames, or the median step is not positive.
    """
    max_step_ratio = 1.5  # a step of more median steps is a gap
    steps = np.diff(time)
    if not len(steps) or not np.median(steps) > 0.0:
        return float("nan")
    return float(1.0 / steps[steps <= max_step_ratio * np.median(steps)].mean())


def _get_position_columns(group: ObjectColumns, header: Header) -> list[int]:
    """Get the columns of the position of an object, or raise ContentError if one is missing."""
    columns = group.find_columns("Position", "XYZ")
    if columns is None:
        place = f"line {header.n_rows}, {group.type} '{group.name}'"
        titles = ", ".join(" ".join(key).strip() for key in group.columns)
        raise ContentError.of("readers.no_position", place, columns=titles)
    return columns


def _convert_body(name: str, group: ObjectColumns, header: Header, columns: Columns) -> RigidBody:
    """Convert the columns of a rigid body to SI units, with NaN for quantities not exported."""
    position = _stack_columns(columns, _get_position_columns(group, header)) * header.length_unit
    error_columns = [i for (x, axis), i in group.columns.items() if "Error" in x and not axis]
    error = columns[error_columns[0]] if error_columns else np.full(len(position), np.nan)
    rotation = _convert_rotation(group, header.properties, columns)
    return RigidBody(name, position, rotation, error * header.length_unit)


def _convert_rotation(
    group: ObjectColumns, properties: Mapping[str, str], columns: Columns
) -> Floats:
    """Return the quaternions x, y, z, w of a body, converted from Euler angles if not exported.

    They are NaN where angles are missing, and if there are neither quaternions nor angles.
    """
    if (quaternion := group.find_columns("Rotation", "XYZW")) is not None:
        return _stack_columns(columns, quaternion)
    rotation = np.full((len(columns[0]), 4), np.nan)
    if angle_columns := _find_euler_columns(group, properties):
        from scipy.spatial.transform import Rotation

        angles = _stack_columns(columns, angle_columns)  # deg
        is_full, order = np.isfinite(angles).all(axis=1), properties["Rotation Type"]
        if is_full.any():
            rotation[is_full] = Rotation.from_euler(order, angles[is_full], degrees=True).as_quat()
    return rotation


def _find_euler_columns(group: ObjectColumns, properties: Mapping[str, str]) -> list[int] | None:
    """Find the columns of Euler angles, in the order of rotations; None if there are quaternions.

    The result is also None if an angle or the order of rotations is missing.
    """
    order = properties.get("Rotation Type", "")
    if sorted(order) != ["X", "Y", "Z"] or group.find_columns("Rotation", "XYZW"):
        return None
    return group.find_columns("Rotation", order)


NumbersByFrame = dict[int, list[float]]
"""Numbers of one object in each frame, keyed by index of the frame line."""


@dataclass(slots=True)
class _RowStyleTake:
    """Contents of the lines of a row-style take, which is filled line by line.

    Parameters
    ----------
    title : text of the first comment line
    handedness : ``righthanded`` or ``lefthanded``
    info : values of the info lines, keyed by their keys
    bodies : id and number of markers of each rigid body, keyed by name
    frames : frame number, time (s), number of bodies and number of points of each frame line
    poses : position (m), quaternion and mean error (mm) of each body, keyed by name of the body
    markers : position (m) of each measured marker of the bodies, keyed by name of the marker and id
        of its body
    points : position (m) of each labelled point, keyed by name and id of the point
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
        If a line before the last is faulty, the version is not 1.x, or there are no frames. A
        faulty line has a wrong number of cells, an invalid number, an unknown type or body, or is a
        body line before its frame line.

    Notes
    -----
    A body that is no longer tracked repeats its last pose. The pose and the mean error are NaN in
    frames in which the counter of frames since the body was tracked is not 0. A faulty last line is
    omitted with a note.
    """
    take, notes = _parse_lines(text.splitlines())
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


def _parse_lines(lines: Sequence[str]) -> tuple[_RowStyleTake, list[QualityNote]]:
    """Parse all lines, with a note on a faulty last line."""
    take, notes = _RowStyleTake(), []
    for number, line in enumerate(lines, start=1):
        try:
            if cells := next(csv.reader([line]), []):
                _add_line(take, cells)
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
    """Make notes on the unit, the number of frames, frames without bodies and visible markers."""
    n_bodies, n_points = np.array(take.frames)[:, 2:].astype(int).T
    n_frames, n_empty = len(n_bodies), int((n_bodies == 0).sum())
    yield QualityNote.of("readers.unit_assumed", "take")
    yield from make_row_count_notes(parse_count(take.info.get("framecount", "")), n_frames)
    if n_empty:
        yield QualityNote.of("readers.frames_without_body", "take", count=n_empty, total=n_frames)
    extremes = {"least": n_points.min(), "most": n_points.max()}
    yield QualityNote.of("readers.visible_markers", "markers", **extremes)
    n_body_markers = np.isfinite(tracks.positions[:, : len(take.markers), 0]).sum(axis=1)
    n_anonymous = np.maximum(n_points - n_body_markers, 0).sum()
    if n_anonymous and not take.points:  # version 1.0 does not label points
        yield QualityNote.of("readers.anonymous_markers", "markers", count=n_anonymous)


def _add_line(take: _RowStyleTake, cells: list[str]) -> None:
    """Add the contents of a line to a take, by the type of the line in its first cell.

    A body line has a frame number in its second cell and a known body in its fourth. A line of the
    same type that declares a body has the name, the id and the number of markers of the body there.
    """
    match cells[0]:
        case "comment":
            take.title = take.title or cells[1]
        case "info":
            take.info[cells[1]] = cells[2]
        case "righthanded" | "lefthanded" as handedness:
            take.handedness = handedness
        case "frame":
            _add_frame(take, cells)
        case "trackable" | "rigidbody":
            if parse_count(cells[1]) is not None and cells[3] in take.bodies:
                _add_body(take, cells)
            else:
                name, id_, n_markers = cells[1], cells[2], int(cells[3])
                n_cells = len(cells)
                require(n_cells == 4 + 3 * n_markers, f"{n_cells} cells for {n_markers} markers")
                take.bodies[name], take.poses[name] = (id_, n_markers), {}
                for number in range(1, n_markers + 1):
                    take.markers[f"{name}-Marker {number}", id_] = {}
        case _:
            require(False, "unknown row type")


def _add_frame(take: _RowStyleTake, cells: list[str]) -> None:
    """Add a frame line: number, time, the poses of the bodies, and the visible points."""
    body_cells = 11  # id, x y z, qx qy qz qw, yaw pitch roll
    point_cells = 5 if take.version != "1.0" else 4  # x y z, id, and since version 1.1 the name
    n_bodies = int(cells[3])
    points_start = 4 + body_cells * n_bodies
    n_points = int(cells[points_start])
    n_cells = points_start + 1 + point_cells * n_points
    require(len(cells) == n_cells, f"{len(cells)} instead of {n_cells} cells")
    frame = float(cells[1]), float(cells[2]), n_bodies, n_points
    names_by_id = {id_: name for name, (id_, _) in take.bodies.items()}
    poses = [
        (names_by_id[cells[i]], [*map(float, cells[i + 1 : i + 8])])
        for i in range(4, points_start, body_cells)
    ]
    points = [
        (cells[i + 3 : i + point_cells], [*map(float, cells[i : i + 3])])
        for i in range(points_start + 1, len(cells), point_cells)
    ]
    row = len(take.frames)  # all cells have been parsed, so no part of a faulty line is stored
    take.frames.append(frame)
    for name, pose in poses:
        take.poses[name][row] = [*pose, np.nan]
    for label, position in points:
        if len(label) == 2:
            take.points.setdefault((label[1], label[0]), {})[row] = position


def _add_body(take: _RowStyleTake, cells: list[str]) -> None:
    """Add a body line: counter of lost frames, measured markers and mean error.

    The markers of the model of the body are omitted.
    """
    model_cells = 4 if take.version != "1.0" else 3  # cells of a marker of the model
    name, count = cells[3], int(cells[6])
    n_cells = 7 + (model_cells + 5) * count + 1
    require(len(cells) == n_cells, f"{len(cells)} instead of {n_cells} cells")
    start = 7 + model_cells * count
    positions = [[*map(float, cells[i : i + 3])] for i in range(start, start + 3 * count, 3)]
    mean_error, is_tracked = float(cells[-1]), int(cells[5]) == 0
    follows_frame = bool(take.frames) and float(cells[1]) == take.frames[-1][0]
    require(follows_frame, f"frame {cells[1]} has no frame line before it")
    row = len(take.frames) - 1
    id_, n_markers = take.bodies[name]
    for number, position in enumerate(positions[:n_markers], start=1):
        take.markers[f"{name}-Marker {number}", id_][row] = position
    if is_tracked:
        take.poses[name].setdefault(row, [np.nan] * 8)[-1] = mean_error
    else:
        take.poses[name].pop(row, None)  # the frame line repeats the last pose of a lost body


def _build_row_style_tracks(take: _RowStyleTake) -> MarkerTracks:
    """Build tracks of bodies, their measured markers and, in version 1.1, other labelled points."""
    frame_numbers, time = np.array(take.frames)[:, :2].T
    body_markers = {name for name, _ in take.markers}
    points = {label: xyz for label, xyz in take.points.items() if label[0] not in body_markers}
    markers = take.markers | points
    positions = [_arrange_by_frame(position, 3, len(time)) for position in markers.values()]
    poses = {name: _arrange_by_frame(pose, 8, len(time)) for name, pose in take.poses.items()}
    return MarkerTracks(
        time=time,
        frames=frame_numbers,
        rate=derive_rate(time),
        names=make_object_names([*markers]),
        positions=np.stack(positions, axis=1) if positions else np.empty((len(time), 0, 3)),
        bodies=tuple(  # the mean error is in mm, while positions are in metres
            RigidBody(name, pose[:, :3], pose[:, 3:7], 1e-3 * pose[:, 7])
            for name, pose in poses.items()
        ),
    )


def _arrange_by_frame(numbers: NumbersByFrame, width: int, n_frames: int) -> Floats:
    """Arrange the numbers of an object, shape (n_frames, width), with NaN in other frames."""
    table = np.full((n_frames, width), np.nan)
    table[list(numbers)] = [*numbers.values()] or np.empty((0, width))
    return table
