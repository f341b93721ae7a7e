"""Common parts of the readers of dSPACE ControlDesk exports."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np

from labpipe.readers.channels import ReportOptions, channel_notes, find_channel, unique_names
from labpipe.readers.raw_files import unreadable
from labpipe.readers.time_axes import clock_notes
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Channel, Clock, Recording

_PROGRAM_VERSION = re.compile(r"ControlDesk version:\s*([\w.]+)")
_SAVED = re.compile(r"Created on: \w{3} (\w{3}) +(\d{1,2}) [\d:]+ (\d{4})")
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")


@dataclass(frozen=True, slots=True)
class Trace:
    """A channel of an export whose samples are not loaded yet.

    Parameters
    ----------
    name, path, unit_in_file : as in `Channel`
    clock : index of its time axis
    load : returns its samples
    about : its other properties in the export
    """

    name: str
    path: str
    unit_in_file: str
    clock: int
    load: Callable[[], object]
    about: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Export:
    """The contents of one export, not loaded yet.

    Parameters
    ----------
    axes : name (raster, may be empty) and samples of each time axis
    traces : the channels in the order of the file
    origin : the export's text on model and program
    metadata : its properties
    notes : notes from its header
    start : s, stated start time; None if not stated
    """

    axes: Sequence[tuple[str, Callable[[], object]]]
    traces: Sequence[Trace]
    origin: str
    metadata: Mapping[str, object]
    notes: Sequence[QualityNote] = ()
    start: float | None = None


def load_export(
    export: Export, *, reader: str, path: Path, channels: Sequence[ReportOptions] | None
) -> Recording:
    """Load the wanted channels on their time axes.

    Parameters
    ----------
    export : its head
    reader : name of the reader
    path : named in errors
    channels : names or paths wanted, None for all; only their time axes are loaded

    Returns
    -------
    The recording; values as in the file, infinities replaced by NaN, units not set.

    Raises
    ------
    ReadError
        If a wanted channel does not exist, or a channel is not as long as its time axis.
    """
    paths = unique_names([trace.path for trace in export.traces])
    traces = [replace(trace, path=path) for trace, path in zip(export.traces, paths, strict=True)]
    if channels is not None:
        known_traces = [(trace.name, trace.path) for trace in traces]
        chosen = sorted({find_channel(wanted, known_traces, path) for wanted in channels})
        traces = [traces[i] for i in chosen]
    rasters = [raster or "time" for raster, _ in export.axes]
    names = [
        f"{name} [{i}]" if rasters.count(name) > 1 else name
        for i, name in enumerate(rasters, start=1)
    ]
    used = range(len(names)) if channels is None else sorted({t.clock for t in traces})
    clocks = {i: Clock(names[i], _samples(export.axes[i][1]())) for i in used}
    notes = [*export.notes]
    if len(names) > 1:
        message = f"{len(names)} time axes: {', '.join(names)}"
        notes.append(QualityNote("several_clocks", Severity.INFO, "file", message))
    broken = [trace.path for trace in traces if "\\n" in trace.path]
    if broken:
        message = f"a path holds the two characters backslash-n: '{broken[0]}'"
        notes.append(QualityNote("line_break_in_path", Severity.INFO, "channels", message))
    for clock in clocks.values():
        notes += clock_notes(clock)
    if export.start is not None and clocks:
        notes += _start_note(next(iter(clocks.values())), export.start)
    loaded = []
    for trace in traces:
        channel, its_notes = _channel(trace, clocks[trace.clock], path)
        loaded.append(channel)
        notes += its_notes
    version = _PROGRAM_VERSION.search(export.origin)
    return Recording(
        reader=reader,
        program="ControlDesk",
        program_version=version[1].rstrip(".") if version else "",
        clocks=tuple(clocks.values()),
        channels=tuple(loaded),
        metadata={**export.metadata, "channels": {t.path: dict(t.about) for t in traces}},
        notes=(*notes, *channel_notes(loaded)),
    )


def _samples(values: object) -> Floats:
    return np.asarray(values, dtype=np.float64).ravel()


def _start_note(clock: Clock, stated: float) -> list[QualityNote]:
    """Compare the stated start with the first time axis, to within half a step."""
    first, second = clock.time[:2] if len(clock.time) > 1 else (stated, stated)
    if abs(stated - first) <= 0.5 * abs(second - first):
        return []
    message = f"StartTimestamp says {stated:.7g} s, the time axis begins at {first:.7g} s: kept"
    return [QualityNote("start_differs", Severity.INFO, f"clock {clock.name}", message)]


def _channel(trace: Trace, clock: Clock, path: Path) -> tuple[Channel, list[QualityNote]]:
    """Load a channel; infinities become NaN, which are noted."""
    values = _samples(trace.load())
    if len(values) != len(clock.time):
        expected = f"{len(clock.time)} samples as on its time axis '{clock.name}'"
        remedy = "Export the recording again; the file may have been edited."
        raise unreadable(path, f"channel '{trace.path}'", expected, f"{len(values)}", remedy)
    infinite, blank = int(np.isinf(values).sum()), np.flatnonzero(~np.isfinite(values))
    notes = []
    if infinite:
        values = np.where(np.isinf(values), np.nan, values)
    if len(blank):
        message = f"{len(blank)} of {len(values)} samples are not numbers"
        message += f" ({infinite} of them infinite)" if infinite else ""
        message += f", the first at sample {blank[0] + 1}"
        notes.append(QualityNote("not_finite", Severity.WARNING, trace.path, message))
    unit = trace.unit_in_file
    return Channel(trace.name, trace.path, values, clock=clock.name, unit_in_file=unit), notes


def to_json(value: object) -> object:
    """Convert a value for JSON: infinities and NaN become text, arrays become lists."""
    if isinstance(value, Mapping):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return to_json(value.item() if value.size == 1 else value.ravel()[:16].tolist())
    if isinstance(value, list | tuple):
        items = [to_json(item) for item in value]
        return items[0] if len(items) == 1 else items
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def day_of_saving(header: str) -> date | None:
    """Return the day in the header text of a MAT file, which is always in English.

    Parameters
    ----------
    header : ``MATLAB 5.0 MAT-file, Platform: PCWIN, Created on: Thu May 04 17:31:15 2023``

    Returns
    -------
    The day; None if there is none.
    """
    match = _SAVED.search(header)
    if match is None or match[1] not in _MONTHS:
        return None
    return _day(int(match[3]), _MONTHS.index(match[1]) + 1, int(match[2]))


def written_date(text: str, near: date | None) -> str:
    """Resolve the order of day and month in a date by a known nearby day.

    Parameters
    ----------
    text : as ControlDesk wrote it
    near : the day of saving, at most a few days later; None if unknown

    Returns
    -------
    ISO date; empty if no order gives a date within a week of `near`.

    Examples
    --------
    >>> written_date("4-5-2023 17:30:33", date(2023, 5, 4))
    '2023-05-04'
    """
    # Of a day, a month or a year.
    max_digits = 4
    max_days_to_saving = 7
    digits = re.findall(r"\d+", text)[:3]
    if len(digits) < 3 or near is None or max(map(len, digits)) > max_digits:
        return ""
    a, b, c = map(int, digits)
    orders = [(a, b, c)] if a > 31 else [(c, a, b), (c, b, a)]
    days = [day for order in orders if (day := _day(*order)) is not None]
    days.sort(key=lambda day: abs((day - near).days))
    return days[0].isoformat() if days and abs((days[0] - near).days) <= max_days_to_saving else ""


def _day(year: int, month: int, day: int) -> date | None:
    try:
        return date(year, month, day)
    except ValueError:
        return None
