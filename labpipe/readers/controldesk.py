"""Load recordings of dSPACE ControlDesk, for the readers of CSV, MAT and MF4 files."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, timedelta
from email.utils import parsedate
from itertools import permutations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.channels import (
    ChannelChoice,
    find_channel,
    make_channel_notes,
    make_names_unique,
)
from labpipe.readers.raw_files import add_file_name
from labpipe.readers.recording_checks import get_time_factor, make_clock_notes
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Channel, Clock, Recording

_PROGRAM_VERSION = re.compile(r"ControlDesk version:\s*([\w.]+)")


class Axis(NamedTuple):
    """A time axis of an export with a function that loads its times.

    Parameters
    ----------
    raster : name of the raster; may be empty
    unit_in_file : unit of the times; empty if not stated, for seconds
    load : function that returns the times in the unit of the file
    """

    raster: str
    unit_in_file: str
    load: Callable[[], object]


@dataclass(frozen=True, slots=True)
class Trace:
    """A channel of an export with a function that loads its samples.

    Parameters
    ----------
    name, path, unit_in_file : name, path and unit of the channel, as in `Channel`
    axis_index : index of the time axis of the channel in `Export.axes`
    load : function that returns the samples in the unit of the file
    properties : further properties of the channel in the export
    """

    name: str
    path: str
    unit_in_file: str
    axis_index: int
    load: Callable[[], object]
    properties: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Export:
    """The content of one export, before its samples are loaded.

    Parameters
    ----------
    axes : time axes
    traces : channels in the order of the file
    origin : text in the export that names the model and the program
    metadata : properties of the export
    notes : quality notes on the header of the export
    """

    axes: Sequence[Axis]
    traces: Sequence[Trace]
    origin: str
    metadata: Mapping[str, object]
    notes: Sequence[QualityNote] = ()


def load_export(
    export: Export, *, reader: str, path: Path, channels: Sequence[ChannelChoice] | None
) -> Recording:
    """Load the wanted channels and their time axes.

    Parameters
    ----------
    export : content of the export, before its samples are loaded
    reader : name of the reader
    path : path of the export, for errors
    channels : names or paths of the wanted channels, None for all; only their time axes are loaded

    Returns
    -------
    The recording. The values are those of the file, in the units of the file, with NaN instead of
    infinities. The times are in seconds.

    Raises
    ------
    ReadError
        If a wanted channel does not exist or is ambiguous, a channel is not as long as its time
        axis, or the unit of a time axis is not one of time.
    """
    paths = make_names_unique([trace.path for trace in export.traces])
    traces = [replace(trace, path=path) for trace, path in zip(export.traces, paths, strict=True)]
    if channels is not None:
        pairs = [(trace.name, trace.path) for trace in traces]
        indices = sorted({find_channel(choice, pairs, path) for choice in channels})
        traces = [traces[i] for i in indices]
    clock_names = make_names_unique([axis.raster or "time" for axis in export.axes])
    used_axes = range(len(clock_names)) if channels is None else {x.axis_index for x in traces}
    clocks = {}
    for i in sorted(used_axes):
        with add_file_name(path):
            factor = get_time_factor(export.axes[i].unit_in_file or "s", f"clock {clock_names[i]}")
        time = np.asarray(export.axes[i].load(), dtype=np.float64).ravel()
        clocks[i] = Clock(clock_names[i], time if factor == 1.0 else factor * time)
    notes = [note for clock in clocks.values() for note in make_clock_notes(clock)]
    loaded_channels = []
    for trace in traces:
        values = np.asarray(trace.load(), dtype=np.float64).ravel()
        clock = clocks[trace.axis_index]
        if (n_samples := len(values)) != (n_times := len(clock.time)):
            facts = {"wanted": n_times, "axis": clock.name, "total": n_samples}
            raise ReadError.about(
                "readers.channel_length", path, f"channel '{trace.path}'", **facts
            )
        if n_invalid := len(invalid_samples := np.flatnonzero(~np.isfinite(values))):
            values = np.where(np.isinf(values), np.nan, values)
            facts = {"count": n_invalid, "total": n_samples, "first": invalid_samples[0] + 1}
            notes.append(QualityNote.of("readers.not_finite", trace.path, **facts))
        unit = trace.unit_in_file
        channel = Channel(trace.name, trace.path, values, clock.name, unit_in_file=unit)
        loaded_channels.append(channel)
    version = _PROGRAM_VERSION.search(export.origin)
    return Recording(
        reader=reader,
        program="ControlDesk",
        program_version=version[1].rstrip(".") if version else "",
        clocks=tuple(clocks.values()),
        channels=tuple(loaded_channels),
        metadata={**export.metadata, "channels": {t.path: dict(t.properties) for t in traces}},
        notes=(*export.notes, *notes, *make_channel_notes(loaded_channels)),
    )


def to_json(value: object) -> object:
    """Convert a property of an export to a value that JSON can represent.

    Infinities, NaN and values of types that JSON does not have become text. Arrays become flat
    lists of at most `max_items` items, and lists of one item become that item.
    """
    max_items = 16
    if isinstance(value, Mapping):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return to_json(value.item() if value.size == 1 else value.ravel()[:max_items].tolist())
    if isinstance(value, list | tuple):
        items = [to_json(item) for item in value]
        return items[0] if len(items) == 1 else items
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def parse_save_date(header: str) -> date | None:
    """Parse the date on which a MAT file was saved, from its header text in English.

    Parameters
    ----------
    header : text such as ``MATLAB 5.0 MAT-file, Platform: PCWIN, Created on: Thu May 04 17:31:15
        2023``

    Returns
    -------
    The date; None if the text does not contain one.
    """
    date_fields = parsedate(header.partition("Created on: ")[2])
    return _make_date(*date_fields[:3]) if date_fields else None


def resolve_date(text: str, save_date: date | None) -> str:
    """Resolve the order of day, month and year in a date by comparison with the date of saving.

    Parameters
    ----------
    text : date as ControlDesk wrote it
    save_date : date on which the file was saved, at most a few days later; None if unknown

    Returns
    -------
    ISO date nearest to `save_date`; empty if `save_date` is unknown, or if no order gives a date
    within a week before or after it.

    Examples
    --------
    >>> resolve_date("4-5-2023 17:30:33", date(2023, 5, 4))
    '2023-05-04'
    """
    max_days = timedelta(days=7)  # between the date and that of saving
    if save_date is None:
        return ""
    orders = permutations(re.findall(r"\d+", text)[:3])
    dates = [day for order in orders if (day := _make_date(*order)) is not None]
    nearest_date = min(dates, key=lambda day: abs(day - save_date), default=date.max)
    return nearest_date.isoformat() if abs(nearest_date - save_date) <= max_days else ""


def _make_date(*numbers: str | int) -> date | None:
    """Make a date from year, month and day; return None if there is no such date."""
    try:
        return date(*map(int, numbers))
    except (TypeError, ValueError, OverflowError):
        return None
