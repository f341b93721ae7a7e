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
from labpipe.records.arrays import Flags, Floats
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
    names = _clock_names([name for name, _ in export.axes])
    used = range(len(names)) if channels is None else sorted({t.clock for t in traces})
    clocks = {i: Clock(names[i], _samples(export.axes[i][1]())) for i in used}
    loaded = [_channel(trace, clocks[trace.clock], path) for trace in traces]
    version = _PROGRAM_VERSION.search(export.origin)
    return Recording(
        reader=reader,
        program="ControlDesk",
        program_version=version[1].rstrip(".") if version else "",
        clocks=tuple(clocks.values()),
        channels=tuple(loaded),
        metadata={**export.metadata, "channels": {t.path: dict(t.about) for t in traces}},
        notes=(
            *export.notes,
            *_clock_count_note(names),
            *_path_notes(traces),
            *(note for clock in clocks.values() for note in clock_notes(clock)),
            *_start_note(list(clocks.values()), export.start),
            *_value_notes(traces, loaded),
            *channel_notes(loaded),
        ),
    )


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


def _clock_names(rasters: Sequence[str]) -> list[str]:
    names = [raster or "time" for raster in rasters]
    return [f"{name} [{i + 1}]" if names.count(name) > 1 else name for i, name in enumerate(names)]


def _samples(values: object) -> Floats:
    return np.asarray(values, dtype=np.float64).ravel()


def _channel(trace: Trace, clock: Clock, path: Path) -> Channel:
    values = _samples(trace.load())
    if len(values) != len(clock.time):
        raise unreadable(
            path,
            f"channel '{trace.path}'",
            f"{len(clock.time)} samples as on its time axis '{clock.name}'",
            f"{len(values)}",
            "Export the recording again; the file may have been edited.",
        )
    infinite = np.isinf(values)
    if infinite.any():
        values = np.where(infinite, np.nan, values)
    return Channel(
        trace.name, trace.path, values, clock=clock.name, unit_in_file=trace.unit_in_file
    )


def _clock_count_note(clocks: Sequence[str]) -> list[QualityNote]:
    if len(clocks) < 2:
        return []
    message = f"{len(clocks)} time axes: {', '.join(clocks)}"
    return [QualityNote("several_clocks", Severity.INFO, "file", message)]


def _path_notes(traces: Sequence[Trace]) -> list[QualityNote]:
    broken = [trace.path for trace in traces if "\\n" in trace.path]
    if not broken:
        return []
    message = f"a path holds the two characters backslash-n: '{broken[0]}'"
    return [QualityNote("line_break_in_path", Severity.INFO, "channels", message)]


def _start_note(clocks: Sequence[Clock], stated: float | None) -> list[QualityNote]:
    """Compare the stated start with the first time axis, to within half a step."""
    if stated is None or not clocks or len(clocks[0].time) < 2:
        return []
    first, second = clocks[0].time[:2]
    if abs(stated - first) <= 0.5 * abs(second - first):
        return []
    message = f"StartTimestamp says {stated:.7g} s, the time axis begins at {first:.7g} s: kept"
    return [QualityNote("start_differs", Severity.INFO, f"clock {clocks[0].name}", message)]


def _value_notes(traces: Sequence[Trace], channels: Sequence[Channel]) -> list[QualityNote]:
    pairs = [(t, c, np.isnan(c.values)) for t, c in zip(traces, channels, strict=True)]
    return [_blank_note(trace, blank, of.path) for trace, of, blank in pairs if blank.any()]


def _blank_note(trace: Trace, blank: Flags, where: str) -> QualityNote:
    infinite = int(np.isinf(_samples(trace.load())).sum())
    first = int(np.flatnonzero(blank)[0]) + 1
    message = f"{int(blank.sum())} of {len(blank)} samples are not numbers"
    message += f" ({infinite} of them infinite)" if infinite else ""
    message += f", the first at sample {first}"
    return QualityNote("not_finite", Severity.WARNING, where, message)


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
    if match is None or match.group(1) not in _MONTHS:
        return None
    return _day(int(match.group(3)), _MONTHS.index(match.group(1)) + 1, int(match.group(2)))


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
