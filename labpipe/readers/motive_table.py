"""Table-style exports of Motive: header, columns and marker tracks."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labpipe.readers.raw_files import unreadable
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import MarkerTracks, RigidBody
from labpipe.units import whole_number

Columns = Mapping[int, Floats]
"""Values by column number in the file, shape (frames,); NaN where blank."""
Cells = Sequence[str]
LENGTH_UNITS = {"Meters": 1.0, "Centimeters": 0.01, "Millimeters": 0.001}
"""Length Units of the export, in m."""
KNOWN_VERSIONS = frozenset({"1.21", "1.23", "1.24", "1.25"})
"""Format versions of known files."""
_EXPORT_AGAIN = "Export the take from Motive as CSV again."
_LABELS = ("Type", "Name", "ID")
_KEYS = (
    *("Format Version", "Take Name", "Take Notes", "Capture Frame Rate", "Export Frame Rate"),
    *("Capture Start Time", "Capture Start Frame", "Total Frames in Take"),
    *("Total Exported Frames", "Rotation Type", "Length Units", "Coordinate Space"),
)


def needed_columns(header: Header) -> list[int]:
    """Return the columns of a recording: frame, time, bodies and measured markers."""
    needed = {0} | ({header.time_column} if header.time_column is not None else set())
    for group in header.groups:
        if group.type == "Marker":
            needed |= {*(group.axes("Position", "XYZ") or [])}
        if group.type == "Rigid Body":
            needed |= {*group.columns.values()}
    return sorted(needed)


def marker_tracks(
    header: Header, columns: Columns, path: Path
) -> tuple[MarkerTracks, list[QualityNote]]:
    """Convert columns to tracks in SI.

    Parameters
    ----------
    header : the header
    columns : at least the `needed_columns`
    path : named in errors

    Returns
    -------
    The tracks, and notes on the time column.

    Raises
    ------
    ReadError
        If a frame number is missing, or an object lacks one of X, Y and Z.
    """
    frames = _frames(header, columns, path)
    time, rate, notes = _time(header, columns, frames)
    markers = [group for group in header.groups if group.type == "Marker"]
    bodies = [group for group in header.groups if group.type == "Rigid Body"]
    places = [place for group in markers for place in _position(group, header, path)]
    positions = _stack_columns(columns, places) * header.length_unit
    tracks = MarkerTracks(
        time=time,
        frames=frames,
        rate=rate,
        names=unique_names([(group.name, group.id) for group in markers]),
        positions=positions.reshape(len(frames), len(markers), 3),
        bodies=tuple(
            _body(name, group, header, columns, path)
            for name, group in zip(
                unique_names([(group.name, group.id) for group in bodies]), bodies, strict=True
            )
        ),
        unit_in_file=header.about["Length Units"],
    )
    return tracks, notes + _euler_note(bodies, header)


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
    repeated = Counter(names)
    seen: Counter[str] = Counter()
    unique = []
    for name in names:
        seen[name] += 1
        unique.append(f"{name} #{seen[name]}" if repeated[name] > 1 else name)
    return tuple(unique)


def header_notes(header: Header, path: Path) -> list[QualityNote]:
    """Return notes on a header.

    Parameters
    ----------
    header : the header
    path : the export

    Returns
    -------
    Notes ``version_unseen``, ``take_name_differs``, ``start_time_unclear``, ``fitted_markers``,
    ``columns_left_out``, ``names_not_unique``.
    """
    notes = []
    if header.version not in KNOWN_VERSIONS:
        message = f"Format Version {header.version} has not been seen in a real file:"
        message += f" read by the rules of {', '.join(sorted(KNOWN_VERSIONS))}"
        notes.append(QualityNote("version_unseen", Severity.WARNING, "file", message))
    take, start = (header.about.get(key, "") for key in ("Take Name", "Capture Start Time"))
    if take and take != path.stem:
        message = f"the take is called '{take}', the file '{path.name}'"
        notes.append(QualityNote("take_name_differs", Severity.INFO, "file", message))
    if start and not start.endswith((" AM", " PM")):
        message = f"Capture Start Time '{start}': AM or PM is missing"
        notes.append(QualityNote("start_time_unclear", Severity.INFO, "file", message))
    return notes + _left_out_notes(header.groups) + _shared_names(header.groups)


def _frames(header: Header, columns: Columns, path: Path) -> Floats:
    frames = columns[0]
    bad = np.flatnonzero(~np.isfinite(frames))
    if len(bad):
        place = f"line {header.rows + 1 + int(bad[0])}, cell 1"
        remedy = "Export the take from Motive as CSV again; the file may have been edited."
        raise unreadable(path, place, "a frame number", "none", remedy)
    return frames


def _time(
    header: Header, columns: Columns, frames: Floats
) -> tuple[Floats, float, list[QualityNote]]:
    """Return frame / export rate if the time column agrees with it, else the time column."""
    # Deviation in s of the time column from frame / rate: 1.23 rounds to whole milliseconds.
    max_time_deviation = 0.6e-3
    # Deviation in s of a time column that is not rounded to milliseconds.
    rounding = 2e-6
    written = None if header.time_column is None else columns[header.time_column]
    if header.rate is None:
        time = frames * np.nan if written is None else written
        message = "line 1 states no Export Frame Rate: it is derived from the times"
        return time, derived_rate(time), [_note("rate_not_stated", message)]
    time = frames / header.rate
    if written is None or not len(time):
        return time, header.rate, []
    deviation = np.abs(written - time)
    if not np.isfinite(deviation).all() or deviation.max() > max_time_deviation:
        worst = float(np.nanmax(deviation)) if np.isfinite(deviation).any() else np.nan
        message = f"the column of times is up to {1e3 * worst:.4g} ms off frame / rate: kept"
        return written, header.rate, [_note("time_column_differs", message)]
    if deviation.max() > rounding:
        message = "the column of times is rounded to milliseconds"
        message += f" (up to {1e3 * deviation.max():.3g} ms off): frame / rate is used"
        return time, header.rate, [_note("time_rounded", message, Severity.INFO)]
    return time, header.rate, []


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


def _note(code: str, message: str, severity: Severity = Severity.WARNING) -> QualityNote:
    return QualityNote(code, severity, "clock of the take", message)


def _position(group: Group, header: Header, path: Path) -> list[int]:
    axes = group.axes("Position", "XYZ")
    if axes is not None:
        return axes
    raise unreadable(
        path,
        f"line {header.rows}, {group.type} '{group.name}'",
        "the columns X, Y and Z of Position",
        ", ".join(" ".join(key).strip() for key in group.columns),
        "Export the take with positions.",
    )


def _body(name: str, group: Group, header: Header, columns: Columns, path: Path) -> RigidBody:
    position = _stack_columns(columns, _position(group, header, path)) * header.length_unit
    errors = [quantity for quantity in group.scalars if "Error" in quantity]
    error = np.full(len(position), np.nan)
    if errors:
        error = columns[group.columns[errors[0], ""]] * header.length_unit
    return RigidBody(name, position, _rotation(group, header.about, columns), error)


def _rotation(group: Group, about: Mapping[str, str], columns: Columns) -> Floats:
    """Return quaternions x, y, z, w; from Euler angles if the export contains those."""
    quaternion = group.axes("Rotation", "XYZW")
    if quaternion is not None:
        return _stack_columns(columns, quaternion)
    order = _euler_order(about)
    angles = group.axes("Rotation", order) if order else None
    if angles is None:
        return np.full((len(columns[0]), 4), np.nan)
    from scipy.spatial.transform import Rotation

    degrees = _stack_columns(columns, angles)
    rotation = np.full((len(degrees), 4), np.nan)
    is_known = np.isfinite(degrees).all(axis=1)
    if is_known.any():
        turned = Rotation.from_euler(order, degrees[is_known], degrees=True)
        rotation[is_known] = turned.as_quat()
    return rotation


def _has_euler(group: Group, about: Mapping[str, str]) -> bool:
    order = _euler_order(about)
    return bool(order and not group.axes("Rotation", "XYZW") and group.axes("Rotation", order))


def _euler_order(about: Mapping[str, str]) -> str:
    order = about.get("Rotation Type", "")
    return order if sorted(order) == ["X", "Y", "Z"] else ""


def _euler_note(bodies: Sequence[Group], header: Header) -> list[QualityNote]:
    convention = header.about.get("Rotation Type", "")
    turned = [body.name for body in bodies if _has_euler(body, header.about)]
    if not turned:
        return []
    message = (
        f"Euler angles of type '{convention}' in degrees were converted to quaternions as intrinsic"
    )
    message += " rotations: no real file has confirmed that convention"
    return [QualityNote("rotation_from_euler", Severity.WARNING, ", ".join(turned), message)]


def _left_out_notes(groups: Sequence[Group]) -> list[QualityNote]:
    count = Counter(group.type for group in groups)
    notes = []
    fitted = count.pop("Rigid Body Marker", 0)
    if fitted:
        message = f"{fitted} Rigid Body Marker are fitted positions, not measurements: left out"
        notes.append(QualityNote("fitted_markers", Severity.INFO, "markers", message))
    others = {asset: n for asset, n in count.items() if asset not in {"Marker", "Rigid Body"}}
    if others:
        message = "left out: " + ", ".join(f"{n} of type {asset}" for asset, n in others.items())
        notes.append(QualityNote("columns_left_out", Severity.INFO, "columns", message))
    return notes


def _shared_names(groups: Sequence[Group]) -> list[QualityNote]:
    kept = [(g.type, g.name) for g in groups if g.type in {"Marker", "Rigid Body"}]
    shared = [name for (_, name), n in Counter(kept).items() if n > 1]
    if not shared:
        return []
    message = f"objects with the same name have their id added: {', '.join(shared[:5])}"
    return [QualityNote("names_not_unique", Severity.INFO, "markers", message)]


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

    @property
    def scalars(self) -> list[str]:
        """Return the quantities without axes."""
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
        """Return the content of each column, for messages."""
        names = ["Frame", *[""] * (self.width - 1)]
        for group in self.groups:
            for quantity, column in group.columns.items():
                names[column] = " ".join((group.name, *quantity)).strip()
        return names

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
        return LENGTH_UNITS[self.about["Length Units"]]


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
    if about.get("Length Units") not in LENGTH_UNITS:
        expected = f"Length Units, one of {', '.join(LENGTH_UNITS)}"
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
        key_columns = [i for i, cell in enumerate(cells) if cell in _KEYS]
        ends = [*key_columns[1:], len(cells)]
        pairs = {
            cells[i]: ",".join(cells[i + 1 : end]) for i, end in zip(key_columns, ends, strict=True)
        }
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
