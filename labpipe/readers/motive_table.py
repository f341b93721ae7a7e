"""Marker tracks from the body of Motive's table-style exports."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from labpipe.readers.files import unreadable
from labpipe.readers.motive_header import SEEN, Group, Header
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import MarkerTracks, RigidBody

TIME_TOLERANCE = 0.6e-3
"""Agreement of the time column with frame / rate, s: 1.23 rounds times to whole milliseconds."""

_ROUNDED = 2e-6
"""Agreement of a time column that is not rounded to milliseconds, s."""


Columns = Mapping[int, Floats]
"""Numbers of an export by their column number in the file, shape (frames,); NaN where blank."""


def needed_columns(header: Header) -> list[int]:
    """Columns that a recording is made of: frame, time, bodies and measured markers."""
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
    """Turn columns into tracks in SI.

    Parameters
    ----------
    header : what the columns are
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
    positions = _together(columns, places) * header.length_unit
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


def _together(columns: Columns, chosen: Sequence[int]) -> Floats:
    """Columns side by side, shape (frames, chosen)."""
    return np.transpose([columns[column] for column in chosen])


def unique_names(objects: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Make names unique: a repeated one carries its id, and a number where that repeats too.

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
    """Say what is odd about a header.

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
    if header.version not in SEEN:
        message = f"Format Version {header.version} has not been seen in a real file:"
        message += f" read by the rules of {', '.join(sorted(SEEN))}"
        notes.append(QualityNote("version_unseen", Severity.WARNING, "file", message))
    take, start = (header.about.get(key, "") for key in ("Take Name", "Capture Start Time"))
    if take and take != path.stem:
        message = f"the take is called '{take}', the file '{path.name}'"
        notes.append(QualityNote("take_name_differs", Severity.INFO, "file", message))
    if start and not start.endswith((" AM", " PM")):
        message = f"Capture Start Time '{start}': before or after noon is not said in English"
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
    """Time as frame / export rate where the column of times agrees, else the column."""
    written = None if header.time_column is None else columns[header.time_column]
    if header.rate is None:
        time = frames * np.nan if written is None else written
        message = "line 1 states no Export Frame Rate: it is derived from the times"
        return time, derived_rate(time), [_note("rate_not_stated", message)]
    time = frames / header.rate
    if written is None or not len(time):
        return time, header.rate, []
    apart = np.abs(written - time)
    if not np.isfinite(apart).all() or apart.max() > TIME_TOLERANCE:
        worst = float(np.nanmax(apart)) if np.isfinite(apart).any() else np.nan
        message = f"the column of times is up to {1e3 * worst:.4g} ms off frame / rate: kept"
        return written, header.rate, [_note("time_column_differs", message)]
    if apart.max() > _ROUNDED:
        message = "the column of times is rounded to milliseconds"
        message += f" (up to {1e3 * apart.max():.3g} ms off): frame / rate is used"
        return time, header.rate, [_note("time_rounded", message, Severity.INFO)]
    return time, header.rate, []


def derived_rate(time: Floats) -> float:
    """Frames per second from time stamps: the inverse mean step, holes left out.

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
    found = group.axes("Position", "XYZ")
    if found is not None:
        return found
    raise unreadable(
        path,
        f"line {header.rows}, {group.type} '{group.name}'",
        "the columns X, Y and Z of Position",
        ", ".join(" ".join(key).strip() for key in group.columns),
        "Export the take with positions.",
    )


def _body(name: str, group: Group, header: Header, columns: Columns, path: Path) -> RigidBody:
    position = _together(columns, _position(group, header, path)) * header.length_unit
    errors = [quantity for quantity in group.scalars if "Error" in quantity]
    error = np.full(len(position), np.nan)
    if errors:
        error = columns[group.columns[errors[0], ""]] * header.length_unit
    return RigidBody(name, position, _rotation(group, header.about, columns), error)


def _rotation(group: Group, about: Mapping[str, str], columns: Columns) -> Floats:
    """Quaternion x, y, z, w; made from Euler angles where the export holds those."""
    quaternion = group.axes("Rotation", "XYZW")
    if quaternion is not None:
        return _together(columns, quaternion)
    order = _euler_order(about)
    angles = group.axes("Rotation", order) if order else None
    if angles is None:
        return np.full((len(columns[0]), 4), np.nan)
    from scipy.spatial.transform import Rotation

    degrees = _together(columns, angles)
    rotation = np.full((len(degrees), 4), np.nan)
    known = np.isfinite(degrees).all(axis=1)
    if known.any():
        turned = Rotation.from_euler(order, degrees[known], degrees=True)
        rotation[known] = turned.as_quat()
    return rotation


def _has_euler(group: Group, about: Mapping[str, str]) -> bool:
    order = _euler_order(about)
    return bool(order and not group.axes("Rotation", "XYZW") and group.axes("Rotation", order))


def _euler_order(about: Mapping[str, str]) -> str:
    order = about.get("Rotation Type", "")
    return order if sorted(order) == ["X", "Y", "Z"] else ""


def _euler_note(bodies: Sequence[Group], header: Header) -> list[QualityNote]:
    kind = header.about.get("Rotation Type", "")
    turned = [body.name for body in bodies if _has_euler(body, header.about)]
    if not turned:
        return []
    message = f"Euler angles of type '{kind}' in degrees were made quaternions, each turn about"
    message += " the axes already turned: no real file has confirmed that order"
    return [QualityNote("rotation_from_euler", Severity.WARNING, ", ".join(turned), message)]


def _left_out_notes(groups: Sequence[Group]) -> list[QualityNote]:
    count = Counter(group.type for group in groups)
    notes = []
    fitted = count.pop("Rigid Body Marker", 0)
    if fitted:
        message = f"{fitted} Rigid Body Marker are fitted places, not measurements: left out"
        notes.append(QualityNote("fitted_markers", Severity.INFO, "markers", message))
    others = {kind: n for kind, n in count.items() if kind not in {"Marker", "Rigid Body"}}
    if others:
        message = "left out: " + ", ".join(f"{n} of type {kind}" for kind, n in others.items())
        notes.append(QualityNote("columns_left_out", Severity.INFO, "columns", message))
    return notes


def _shared_names(groups: Sequence[Group]) -> list[QualityNote]:
    kept = [(g.type, g.name) for g in groups if g.type in {"Marker", "Rigid Body"}]
    shared = [name for (_, name), n in Counter(kept).items() if n > 1]
    if not shared:
        return []
    message = f"names that several objects share carry their id: {', '.join(shared[:5])}"
    return [QualityNote("names_not_unique", Severity.INFO, "markers", message)]
