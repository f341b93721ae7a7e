"""Describe the program, channels, rates, gaps and notes of one export for `labpipe inspect`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labpipe.readers import recognise_export
from labpipe.readers.recording_checks import (
    SAMPLED_ON_EVENT,
    TIME_VARIABLE,
    count_longest_run,
    find_blank_frames,
    find_holes,
    find_unchanged_steps,
)
from labpipe.records.arrays import Floats, drop_missing, find_runs, median
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody
from labpipe.units import get_conversion_factor

_DISPLAYED_UNITS = ("s", "m", "N", "Pa", "V", "1", "N m", "m/s", "Hz", "K", "kg")
"""Units to which channels are converted; a channel has the first unit with its dimension."""
_ANGLE_UNITS = frozenset({"rad", "mrad", "deg", "degree", "degrees", "°"})
"""Units of angles, which have the dimension of a pure number."""
_TABLE_NOTE_CODES = frozenset({"marker_gaps", "body_gaps"})
"""Codes of notes that only repeat the content of the table of rigid bodies and markers."""


@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """Export and its recording.

    Parameters
    ----------
    file : path of the export
    recording : content of the export
    """

    file: Path
    recording: Recording


def inspect_export(path: Path) -> Inspection:
    """Recognise an export by its content and read all of it.

    Parameters
    ----------
    path : path of the export

    Returns
    -------
    The inspection. A time axis that cannot be processed is reported by a note of severity error.

    Raises
    ------
    ReadError
        If the format of the file is unknown, or the file is too damaged to be read.
    """
    return Inspection(path, recognise_export(path).read(path))


def make_inspection_record(inspection: Inspection) -> dict[str, Any]:
    """Convert an inspection to the data of `labpipe inspect --json`.

    Parameters
    ----------
    inspection : inspection of an export

    Returns
    -------
    Data for JSON. Values are in SI units if the export states the unit. Otherwise they are the
    values of the file, and ``unit`` is None. A missing value is None. Frames of gaps are counted
    from 0.
    """
    recording = inspection.recording
    return {
        "file": str(inspection.file),
        "reader": recording.reader,
        "program": recording.program,
        "version": recording.program_version,
        "streams": [_describe_stream(clock, recording) for clock in recording.clocks],
        "markers": None if recording.markers is None else _describe_markers(recording.markers),
        "notes": [
            {key: str(getattr(note, key)) for key in ("code", "severity", "where", "message")}
            for note in recording.notes
        ],
        "metadata": dict(recording.metadata),
    }


def _describe_stream(clock: Clock, recording: Recording) -> dict[str, Any]:
    """Describe a clock and its channels."""
    note_codes = {note.code for note in recording.notes if note.where == f"clock {clock.name}"}
    is_uneven = clock.name in SAMPLED_ON_EVENT or TIME_VARIABLE in note_codes
    channels = [channel for channel in recording.channels if channel.clock == clock.name]
    return {
        "clock": clock.name,
        "unit": clock.unit,
        "samples": len(clock.time),
        **_describe_times(clock.time, is_uneven=is_uneven),
        "channels": [_describe_channel(channel) for channel in channels],
    }


def _describe_times(time: Floats, *, is_uneven: bool = False) -> dict[str, Any]:
    """Describe a time axis; long steps of an unevenly sampled clock are not holes."""
    steps = np.diff(time)
    holes = () if is_uneven else find_holes(time)
    return {
        "start": _reduce_finite(time[:1]),
        "end": _reduce_finite(time[-1:]),
        "step_median": _reduce_finite([median(steps)] if len(steps) else []),
        "step_min": _reduce_finite(steps, np.min),
        "step_max": _reduce_finite(steps, np.max),
        "holes": [{"at": hole.time, "length": hole.duration} for hole in holes],
    }


def _describe_channel(channel: Channel) -> dict[str, Any]:
    """Describe the units and the range of a channel."""
    unit, factor = _choose_unit(channel)
    values = channel.values * factor
    finite = drop_missing(values)
    return {
        "name": channel.name,
        "path": channel.path,
        "unit": unit,
        "unit_in_file": channel.unit_in_file,
        "first": _reduce_finite(values[:1]),
        "last": _reduce_finite(values[-1:]),
        "min": _reduce_finite(finite, np.min),
        "max": _reduce_finite(finite, np.max),
        "missing": len(values) - len(finite),
    }


def _choose_unit(channel: Channel) -> tuple[str | None, float]:
    """Choose the displayed unit of a channel, and its factor; None and 1 if it is not known."""
    if channel.unit is not None or not channel.unit_in_file:
        return channel.unit, 1.0
    for unit in ("rad",) if channel.unit_in_file in _ANGLE_UNITS else _DISPLAYED_UNITS:
        with suppress(ValueError):
            return unit, get_conversion_factor(channel.unit_in_file, unit)
    return None, 1.0


def _reduce_finite(
    values: Floats | Sequence[float], reduce: Callable[[Any], Any] = np.min
) -> float | None:
    """Reduce values to one number; None without values, or if the number is not finite."""
    value = reduce(values) if len(values) else np.nan
    return float(value) if np.isfinite(value) else None


def _describe_markers(tracks: MarkerTracks) -> dict[str, Any]:
    """Describe the markers and rigid bodies of a camera recording."""
    markers = {name: _describe_track(tracks.positions[:, i]) for i, name in enumerate(tracks.names)}
    return {
        "frames": len(tracks.time),
        "rate": _reduce_finite([tracks.rate]),
        **_describe_times(tracks.time),
        "first_frame": _reduce_finite(tracks.frames[:1]),
        "last_frame": _reduce_finite(tracks.frames[-1:]),
        "unit_in_file": tracks.unit_in_file,
        "names": list(tracks.names),
        "missing": tracks.n_missing,
        "gaps": {name: marker["gaps"] for name, marker in markers.items()},
        "frozen": {name: marker["frozen"] for name, marker in markers.items()},
        "rigid_bodies": [_describe_body(body) for body in tracks.bodies],
    }


def _describe_track(track: Floats) -> dict[str, Any]:
    """Describe the missing and the unchanged frames of a marker or rigid body."""
    max_listed = 100  # gaps; the count includes all gaps
    is_missing, is_unchanged = find_blank_frames(track), find_unchanged_steps(track)
    gaps = find_runs(is_missing)
    ranges = [[start, stop - 1] for start, stop in gaps[:max_listed]]
    return {
        "missing": int(is_missing.sum()),
        "gaps": {"count": len(gaps), "longest": count_longest_run(is_missing), "ranges": ranges},
        "frozen": {"steps": int(is_unchanged.sum()), "longest": count_longest_run(is_unchanged)},
    }


def _describe_body(body: RigidBody) -> dict[str, Any]:
    """Describe the track of a rigid body, and whether it has rotations and errors."""
    track = _describe_track(body.position)
    frozen = track.pop("frozen")
    return {
        "name": body.name,
        **track,
        "frozen_steps": frozen["steps"],
        "longest_frozen_run": frozen["longest"],
        "has_rotation": bool(np.isfinite(body.rotation).any()),
        "has_error": bool(np.isfinite(body.error).any()),
    }


def format_inspection(inspection: Inspection) -> str:
    """Convert an inspection to readable text.

    Parameters
    ----------
    inspection : inspection of an export

    Returns
    -------
    Lines without a newline at the end.
    """
    record = make_inspection_record(inspection)
    program = f"{record['program']} {record['version']}".strip() or "unknown program"
    lines = [record["file"], f"  {program}, read by {record['reader']}"]
    for stream in record["streams"]:
        lines += ["", *_format_stream(stream)]
    if record["markers"] is not None:
        lines += ["", *_format_markers(record["markers"])]
    notes = [
        f"  {note['severity']:7}  {note['where']}: {note['message']}"
        for note in record["notes"]
        if note["code"] not in _TABLE_NOTE_CODES
    ]
    return "\n".join([*lines, *(["", "Notes"] if notes else []), *notes])


def _format_stream(stream: dict[str, Any]) -> list[str]:
    """Format a clock and the table of its channels."""
    heading = f"Clock {stream['clock']}: {_format_times(stream, 'samples')}"
    if stream["unit"] != "s":
        heading = f"Rows, no clock: {stream['samples']} samples"
    rows = [["channel", "unit", "first", "last", "min", "max", "missing"]]
    for channel in stream["channels"]:
        unit = channel["unit"] or channel["unit_in_file"] or "-"
        numbers = [_format_number(channel[key]) for key in ("first", "last", "min", "max")]
        rows.append([channel["path"], unit, *numbers, str(channel["missing"])])
    return [heading, *_format_table(rows)]


def _format_markers(markers: dict[str, Any]) -> list[str]:
    """Format the clock of a camera recording, and the table of its rigid bodies and markers."""
    times = _format_times(markers, "frames")
    heading = f"Markers: {times}; lengths in {markers['unit_in_file'] or 'metres (assumed)'}"
    objects = [
        (body["name"], "rigid body", body["missing"], body["gaps"], body["frozen_steps"])
        for body in markers["rigid_bodies"]
    ]
    objects += [
        (name, "marker", markers["missing"][name], gaps, markers["frozen"][name]["steps"])
        for name, gaps in markers["gaps"].items()
    ]
    if not objects:
        return [heading, "  no rigid body and no marker"]
    rows = [["object", "kind", "missing", "gaps", "longest", "unchanged"]]
    for name, kind, missing, gaps, unchanged in objects:
        rows.append([name, kind, *map(str, (missing, gaps["count"], gaps["longest"], unchanged))])
    return [heading, *_format_table(rows)]


def _format_times(times: dict[str, Any], counted: str) -> str:
    """Format count, start, end, rate and holes of ``samples`` or ``frames`` in one line."""
    text = f"{times[counted]} {counted}"
    if times["start"] is not None:
        text += f", {_format_number(times['start'])} to {_format_number(times['end'])} s"
    step = times["step_median"]
    if step is not None and step > 0.0:
        text += f", step {1e3 * step:.6g} ms ({1.0 / step:.5g} per second)"
    return f"{text}, holes: {len(times['holes'])}" if times["holes"] else text


def _format_number(value: float | None) -> str:
    """Format a number with six digits; None becomes a dash."""
    return "-" if value is None else f"{value:.6g}"


def _format_table(rows: list[list[str]]) -> list[str]:
    """Format a table with two columns of text aligned left, and numbers aligned right."""
    n_text_columns = 2
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    formats = [
        f"{{:{'<' if i < n_text_columns else '>'}{width}}}" for i, width in enumerate(widths)
    ]
    return [f"  {'  '.join(formats)}".format(*row).rstrip() for row in rows]
