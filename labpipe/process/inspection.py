"""Describe an export without processing it: program, channels, rates, gaps, notes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labpipe.readers import recognise_export
from labpipe.readers.time_axes import SAMPLED_ON_EVENT, TIME_VARIABLE, find_holes
from labpipe.readers.tracking import blank, longest, unchanged
from labpipe.records.arrays import Floats, median, stretches_of
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody
from labpipe.units import si_factor

_SI_UNITS = ("s", "m", "N", "Pa", "V", "1", "N m", "m/s", "Hz", "K", "kg")
"""Units to which the unit of a channel is converted."""

_ANGLE_UNITS = frozenset({"rad", "mrad", "deg", "degree", "degrees", "°"})
"""Units of pure numbers that mean an angle."""

_TABLE_NOTES = frozenset({"marker_gaps", "body_gaps"})
"""Notes that repeat the table of objects."""


@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """An export and its recording.

    Parameters
    ----------
    file : the export
    recording : its content
    """

    file: Path
    recording: Recording


def inspect_export(path: Path) -> Inspection:
    """Recognise an export by its content and read all of it.

    Parameters
    ----------
    path : the export

    Returns
    -------
    The inspection. A time axis that cannot be processed is a note of severity error.

    Raises
    ------
    ReadError
        If the format of the file is unknown, or the file is too damaged to be read.
    """
    return Inspection(path, recognise_export(path).read(path))


def as_json(inspection: Inspection) -> dict[str, Any]:
    """Convert an inspection to the data that `labpipe inspect --json` prints.

    Parameters
    ----------
    inspection : from `inspect_export`

    Returns
    -------
    Data for JSON. Numbers are in SI if the export states the unit, else as in the file with
    ``unit`` None; a missing number is None; rows are counted from 0.
    """
    recording = inspection.recording
    return {
        "file": str(inspection.file),
        "reader": recording.reader,
        "program": recording.program,
        "version": recording.program_version,
        "streams": [_stream(clock, recording) for clock in recording.clocks],
        "markers": None if recording.markers is None else _markers(recording.markers),
        "notes": [
            {
                "code": note.code,
                "severity": note.severity.value,
                "where": note.where,
                "message": note.message,
            }
            for note in recording.notes
        ],
        "metadata": dict(recording.metadata),
    }


def _stream(clock: Clock, recording: Recording) -> dict[str, Any]:
    return {
        "clock": clock.name,
        "unit": clock.unit,
        **_timing(clock.time, on_event=_is_uneven(clock, recording)),
        "channels": [
            _channel(channel) for channel in recording.channels if channel.clock == clock.name
        ],
    }


def _is_uneven(clock: Clock, recording: Recording) -> bool:
    """Check whether the program samples unevenly, so that long steps are not losses."""
    notes = {note.code for note in recording.notes if note.where == f"clock {clock.name}"}
    return clock.name in SAMPLED_ON_EVENT or TIME_VARIABLE in notes


def _timing(time: Floats, *, on_event: bool) -> dict[str, Any]:
    steps = np.diff(time)
    holes = () if on_event else find_holes(time)
    return {
        "samples": len(time),
        "start": _end(time, 0),
        "end": _end(time, -1),
        "step_median": _number(median(steps)) if len(steps) else None,
        "step_min": _number(steps.min()) if len(steps) else None,
        "step_max": _number(steps.max()) if len(steps) else None,
        "holes": [{"at": hole.at, "length": hole.length} for hole in holes],
    }


def _channel(channel: Channel) -> dict[str, Any]:
    unit, factor = _si(channel)
    finite = channel.values[~np.isnan(channel.values)] * factor
    return {
        "name": channel.name,
        "path": channel.path,
        "unit": unit,
        "unit_in_file": channel.unit_in_file,
        "first": _end(channel.values * factor, 0),
        "last": _end(channel.values * factor, -1),
        "min": _number(finite.min()) if len(finite) else None,
        "max": _number(finite.max()) if len(finite) else None,
        "missing": len(channel.values) - len(finite),
    }


def _si(channel: Channel) -> tuple[str | None, float]:
    """Return the SI unit of a channel and the factor to it; None and 1 without a unit."""
    if channel.unit is not None or not channel.unit_in_file:
        return channel.unit, 1.0
    for unit in ("rad",) if channel.unit_in_file in _ANGLE_UNITS else _SI_UNITS:
        try:
            return unit, si_factor(channel.unit_in_file, unit)
        except ValueError:
            continue
    return None, 1.0


def _end(values: Floats, place: int) -> float | None:
    return _number(values[place]) if len(values) else None


def _number(value: float | np.floating) -> float | None:
    """Return a float, or None for NaN and infinity."""
    return float(value) if np.isfinite(value) else None


def _markers(tracks: MarkerTracks) -> dict[str, Any]:
    timing = _timing(tracks.time, on_event=False)
    columns = {name: tracks.positions[:, i] for i, name in enumerate(tracks.names)}
    return {
        "frames": timing.pop("samples"),
        "rate": _number(tracks.rate),
        **timing,
        "first_frame": _end(tracks.frames, 0),
        "last_frame": _end(tracks.frames, -1),
        "unit_in_file": tracks.unit_in_file,
        "names": list(tracks.names),
        "missing": tracks.missing,
        "gaps": {name: _gaps(track) for name, track in columns.items()},
        "frozen": {name: _frozen(track) for name, track in columns.items()},
        "rigid_bodies": [_body(body) for body in tracks.bodies],
    }


def _gaps(track: Floats) -> dict[str, Any]:
    # The count in the output is of all gaps.
    max_ranges = 100
    missing = blank(track)
    stretches = stretches_of(missing)
    return {
        "count": len(stretches),
        "longest": longest(missing),
        "ranges": [[start, stop - 1] for start, stop in stretches[:max_ranges]],
    }


def _frozen(track: Floats) -> dict[str, int]:
    still = unchanged(track)
    return {"steps": int(still.sum()), "longest": longest(still)}


def _body(body: RigidBody) -> dict[str, Any]:
    frozen = _frozen(body.position)
    return {
        "name": body.name,
        "missing": int(blank(body.position).sum()),
        "gaps": _gaps(body.position),
        "frozen_steps": frozen["steps"],
        "longest_frozen_run": frozen["longest"],
        "has_rotation": bool(np.isfinite(body.rotation).any()),
        "has_error": bool(np.isfinite(body.error).any()),
    }


def as_text(inspection: Inspection) -> str:
    """Convert an inspection to readable text.

    Parameters
    ----------
    inspection : from `inspect_export`

    Returns
    -------
    Lines without the last newline.
    """
    facts, recording = as_json(inspection), inspection.recording
    program = f"{recording.program} {recording.program_version}".strip() or "unknown program"
    lines = [str(inspection.file), f"  {program}, read by {recording.reader}"]
    for stream in facts["streams"]:
        lines += ["", *_stream_lines(stream)]
    if facts["markers"] is not None:
        lines += ["", *_marker_lines(facts["markers"])]
    notes = [note for note in facts["notes"] if note["code"] not in _TABLE_NOTES]
    if notes:
        lines += ["", "Notes"]
        lines += [f"  {n['severity']:7}  {n['where']}: {n['message']}" for n in notes]
    return "\n".join(lines)


def _stream_lines(stream: dict[str, Any]) -> list[str]:
    head = f"Clock {stream['clock']}: {_timing_text(stream, 'samples')}"
    if stream["unit"] != "s":
        head = f"Rows, no clock: {stream['samples']} samples"
    rows = [["channel", "unit", "first", "last", "min", "max", "missing"]]
    for channel in stream["channels"]:
        unit = channel["unit"] or channel["unit_in_file"] or "-"
        numbers = [_short(channel[key]) for key in ("first", "last", "min", "max")]
        rows.append([channel["path"], unit, *numbers, str(channel["missing"])])
    return [head, *_table(rows)]


def _marker_lines(facts: dict[str, Any]) -> list[str]:
    timing = _timing_text(facts, "frames")
    head = f"Markers: {timing}; lengths in {facts['unit_in_file'] or 'metres (assumed)'}"
    rows = [
        [body["name"], "rigid body", body["missing"], body["gaps"], body["frozen_steps"]]
        for body in facts["rigid_bodies"]
    ]
    rows += [
        [name, "marker", facts["missing"][name], gaps, facts["frozen"][name]["steps"]]
        for name, gaps in facts["gaps"].items()
    ]
    if not rows:
        return [head, "  no rigid body and no marker"]
    table = [["object", "kind", "missing", "gaps", "longest", "unchanged"]]
    for name, asset_type, missing, gaps, unchanged_steps in rows:
        numbers = missing, gaps["count"], gaps["longest"], unchanged_steps
        table.append([name, asset_type, *map(str, numbers)])
    return [head, *_table(table)]


def _timing_text(timing: dict[str, Any], what: str) -> str:
    """Describe a time axis in one line: count, start, end, rate, holes."""
    text = f"{timing[what]} {what}"
    if timing["start"] is not None:
        text += f", {_short(timing['start'])} to {_short(timing['end'])} s"
    step = timing["step_median"]
    if step is not None and step > 0.0:
        text += f", step {1e3 * step:.6g} ms ({1.0 / step:.5g} per second)"
    return f"{text}, holes: {len(timing['holes'])}" if timing["holes"] else text


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.6g}"


def _table(rows: list[list[str]]) -> list[str]:
    """Format a table: text aligned left, numbers aligned right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  "
        + "  ".join(
            cell.ljust(width) if i < 2 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
