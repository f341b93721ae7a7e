"""Laying the recordings of a test on the bench: signals in SI, marker tracks, first notes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from labpipe.errors import ProcessingError, complaint
from labpipe.pipeline.bench import Bench, MarkerBench, Signal
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import ChannelSource
from labpipe.records.arrays import Floats, times_of
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording

_LARGEST = {"channel": 1e15, "marker": 1e6}
"""SI; no transducer and no camera measures beyond this, damaged files do."""

_FEWEST = 8
"""Samples of a channel; with fewer, nothing can be said."""

_AT_ENDS = 0.02
"""Share of a channel that may be blank before its first and behind its last sample."""


def lay_out(recordings: Mapping[str, Recording], protocol: Protocol) -> tuple[Bench, MarkerBench]:
    """Put calibrated signals and marker tracks on the bench.

    Parameters
    ----------
    recordings : by role; channels carry the names and units of the protocol
    protocol : resolved

    Returns
    -------
    The bench with its first signals and the readers' notes, and the bench of the markers.

    Raises
    ------
    ProcessingError
        If a clock runs backwards, a channel has no finite sample, or a number is impossibly large.
    """
    bench, markers = Bench(), MarkerBench()
    curve = protocol.curve
    words = {} if curve is None else {curve.force: "force", curve.displacement: "displacement"}
    for role, recording in recordings.items():
        bench.notes.extend(replace(note, where=_at(role, note.where)) for note in recording.notes)
        if recording.markers is not None:
            _check_clock(recording.markers.time, role, fewest=2)
            _check_markers(recording.markers, role)
            markers.tracks, markers.role = recording.markers, role
        for channel in recording.channels:
            clock, source = recording.clock(channel.clock), protocol.channels[channel.name]
            _check_clock(clock.time, role, fewest=_FEWEST)
            signal = _signal(channel, source, clock, role)
            if curve is not None and words.get(channel.name) in (curve.reverse or ()):
                signal = replace(signal, values=-signal.values)
            bench.raw[channel.name] = bench.signals[channel.name] = signal
            quantity = words.get(channel.name, channel.name)
            _note_missing(bench, channel, signal, quantity)
            _check_peak(bench, signal, (channel.name, quantity), source.peak_range)
    return bench, markers


def _at(role: str, where: str) -> str:
    return f"{role}: {where}" if where else role


def _signal(channel: Channel, source: ChannelSource, clock: Clock, role: str) -> Signal:
    values = channel.values
    if source.calibration is not None:
        values = source.gain * values + source.offset
    if not np.isfinite(values[:1]).all() and not np.isfinite(values).any():
        message = complaint(
            role,
            f"channel {channel.path!r}",
            expected="numbers",
            found="none: every sample is blank or not finite",
            remedy="Look at the export with `labpipe inspect`.",
        )
        raise ProcessingError(message)
    _check_size(values, "channel", role, f"channel {channel.path!r}")
    return Signal(
        time=clock.time,
        values=values,
        unit=source.target_unit,
        clock=role,
        relative_error=source.gain_uncertainty,
        time_unit=clock.unit,
    )


def _check_peak(
    bench: Bench, signal: Signal, names: tuple[str, str], peak_range: tuple[float, float] | None
) -> None:
    """Doubt a channel whose peak no such specimen has: a unit that is not what the file says."""
    if peak_range is None:
        return
    peak, (least, most) = float(np.nanmax(np.abs(signal.values))), peak_range
    if not least <= peak <= most:
        message = (
            f"the largest value is {peak:.4g} {signal.unit}, plausible are {least:.4g} to "
            f"{most:.4g} {signal.unit}: is the unit right, and is it this channel?"
        )
        name, quantity = names
        bench.doubt(quantity, "implausible_peak", message, where=name)


def _check_markers(tracks: MarkerTracks, role: str) -> None:
    for column, name in enumerate(tracks.names):
        _check_size(tracks.positions[:, column], "marker", role, f"marker {name!r}")
    for body in tracks.bodies:
        _check_size(body.position, "marker", role, f"rigid body {body.name!r}")


def _check_size(values: Floats, kind: str, role: str, place: str) -> None:
    """Refuse numbers that cannot be measurements, before they overflow."""
    largest = max(float(np.nanmax(values, initial=0.0)), -float(np.nanmin(values, initial=0.0)))
    if not largest > _LARGEST[kind]:
        return
    at = int(np.argmax(np.nan_to_num(np.abs(values)).reshape(len(values), -1).max(axis=1)))
    message = complaint(
        role,
        f"{place}, sample {at + 1}",
        expected=f"numbers up to {_LARGEST[kind]:g} in SI units",
        found=f"{largest:.3g}",
        remedy="The file is damaged, or a unit is wrong: export the recording again.",
    )
    raise ProcessingError(message)


def _note_missing(bench: Bench, channel: Channel, signal: Signal, quantity: str) -> None:
    missing = np.isnan(signal.values)
    if not missing.any():
        return
    message = f"{int(missing.sum())} of {len(missing)} samples are blank or not finite"
    bench.note("missing_samples", Severity.WARNING, channel.name, message)
    known = np.flatnonzero(~missing)
    if known[0] + len(missing) - 1 - known[-1] <= _AT_ENDS * len(missing):
        missing[: known[0]] = missing[known[-1] :] = False  # it begins later, and ends earlier
    if missing.any():
        when = times_of(missing, signal.time)
        note = QualityNote("missing_samples", Severity.WARNING, channel.name, message, when)
        bench.doubt_stretches(quantity, note, signal.clock)


def _check_clock(time: Floats, role: str, *, fewest: int) -> None:
    if len(time) < fewest:
        expected, found = f"at least {fewest} samples", f"{len(time)}"
        remedy = "The recording was aborted; leave this test out."
        message = complaint(role, "time", expected=expected, found=found, remedy=remedy)
        raise ProcessingError(message)
    steps = np.diff(time)
    backwards = np.flatnonzero(~(steps > 0))
    if len(backwards):
        at = int(backwards[0]) + 1
        message = complaint(
            role,
            f"sample {at + 1}",
            expected="a time axis that grows",
            found=f"{time[at]:.6f} s after {time[at - 1]:.6f} s",
            remedy="Export the recording again.",
        )
        raise ProcessingError(message)
