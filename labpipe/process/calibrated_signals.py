"""Calibrate the channels of recordings to signals in SI units, and check each channel alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from labpipe.errors import ProcessingError
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import ChannelSource
from labpipe.records.arrays import Flags, Floats, find_run_times
from labpipe.records.curve import Shape
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, QualityNote, doubt_stretches
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording
from labpipe.records.signals import Signal, Signals
from labpipe.results.kinds import SpanBend
from labpipe.signal.bad_samples import StuckRun, find_stuck_runs

if TYPE_CHECKING:
    from labpipe.markers.specimen_frame import SpecimenFrame
    from labpipe.markers.track_repair import RepairedTracks


MAX_SI_VALUE = {"channel": 1e15, "marker": 1e6}
"""Largest SI values of recordings; larger ones come from damaged files."""


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """The camera recording at each stage from marker tracks to the shape of the specimen.

    Parameters
    ----------
    tracks, role : the take and its role; None for a test without one
    clamp : shape (frames, 3), m, pivot of the clamp as exported; None for a take without a clamp
    repaired : tracks of the markers along the specimen
    frame : of the specimen
    rest : shape (frames,), frames at rest, from which the specimen frame was found
    scale_error : standard uncertainty of the scale of the cameras, as a ratio
    """

    tracks: MarkerTracks | None = None
    role: str = "markers"
    clamp: Floats | None = None
    repaired: RepairedTracks | None = None
    frame: SpecimenFrame | None = None
    rest: Flags | None = None
    scale_error: float = 0.0

    def make_signal(self, time: Floats, values: Floats) -> Signal:
        """Make a signal of a length (m) on the clock of the cameras, with their scale error."""
        return Signal(time, values, "m", self.role, relative_error=self.scale_error)


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A test before force and displacement are combined into a curve.

    Parameters
    ----------
    signals, take : after the steps so far
    shape : of the specimen; None if no step fits one
    span : the bent axis between two supports, or why there is none; None if no step fits one
    """

    signals: Signals
    take: Take = Take()
    shape: Shape | None = None
    span: SpanBend | Failure | None = None


def calibrate(
    recordings: Mapping[str, Recording], protocol: Protocol
) -> tuple[Prepared, list[Finding]]:
    """Calibrate the channels of all recordings.

    Parameters
    ----------
    recordings : by role; channels carry the names and units of the protocol
    protocol : resolved

    Returns
    -------
    Signals and marker tracks; the notes of the readers and the findings of the first checks.

    Raises
    ------
    ProcessingError
        If a clock runs backwards, a channel has no finite sample, or a number is impossibly large.
    """
    min_samples = 8
    curve, findings = protocol.curve, list[Finding]()
    signals = Signals() if curve is None else Signals(curve.force, curve.displacement)
    take = Take()
    scales: dict[str, float] = {
        role: source.camera_uncertainty for role, source in protocol.sources.items()
    }
    reverse = () if curve is None or curve.reverse is None else curve.reverse
    reversed_channels = [getattr(curve, quantity) for quantity in reverse]
    for role, recording in recordings.items():
        findings += [
            Finding(replace(note, where=f"{role}: {note.where}" if note.where else role))
            for note in recording.notes
        ]
        if recording.markers is not None:
            _check_clock(recording.markers.time, role, min_samples=2)
            _check_markers(recording.markers, role)
            take = Take(recording.markers, role, scale_error=scales[role])
        for channel in recording.channels:
            clock, source = recording.clock(channel.clock), protocol.channels[channel.name]
            _check_clock(clock.time, role, min_samples=min_samples)
            signal = _calibrate_channel(
                channel, source, clock, role, protocol.specimen.gauge_length
            )
            if channel.name in reversed_channels:
                signal = replace(signal, values=-signal.values)
            signals = signals.add_signal(channel.name, signal)
            quantity = signals.quantities.get(channel.name, channel.name)
            findings += _check_missing(channel.name, signal, quantity)
            findings += _check_peak(channel.name, signal, quantity, source.peak_range)
    return Prepared(signals, take), findings


def _calibrate_channel(
    channel: Channel, source: ChannelSource, clock: Clock, role: str, gauge_length: float | None
) -> Signal:
    values = channel.values
    if source.is_extension and channel.unit == "1":
        if gauge_length is None:
            raise ProcessingError.about(
                "process.strain_without_gauge", role, f"channel {channel.path!r}"
            )
        values = gauge_length * values
    if source.calibration is not None:
        values = source.gain * values + source.offset
    if not np.isfinite(values[:1]).all() and not np.isfinite(values).any():
        raise ProcessingError.about("process.no_numbers", role, f"channel {channel.path!r}")
    _check_size(values, "channel", role, f"channel {channel.path!r}")
    return Signal(
        time=clock.time,
        values=values,
        unit=source.target_unit,
        clock=role,
        relative_error=source.gain_uncertainty,
        zero_drift=source.zero_drift or 0.0,
        time_unit=clock.unit,
    )


def _check_peak(
    name: str, signal: Signal, quantity: str, peak_range: tuple[float, float] | None
) -> list[Finding]:
    """Report a channel whose peak is implausible: the unit in the file may be wrong."""
    if peak_range is None:
        return []
    peak, (lowest, highest) = float(np.nanmax(np.abs(signal.values))), peak_range
    if lowest <= peak <= highest:
        return []
    return [
        Finding.of(
            "process.implausible_peak",
            name,
            quantity,
            peak=peak,
            unit=signal.unit,
            lowest=lowest,
            highest=highest,
        )
    ]


def _check_markers(tracks: MarkerTracks, role: str) -> None:
    for column, name in enumerate(tracks.names):
        _check_size(tracks.positions[:, column], "marker", role, f"marker {name!r}")
    for body in tracks.bodies:
        _check_size(body.position, "marker", role, f"rigid body {body.name!r}")


def _check_size(values: Floats, quantity: str, role: str, place: str) -> None:
    """Refuse numbers that are too large to be measurements."""
    largest = max(float(np.nanmax(values, initial=0.0)), -float(np.nanmin(values, initial=0.0)))
    if not largest > MAX_SI_VALUE[quantity]:
        return
    sample = int(np.argmax(np.nan_to_num(np.abs(values)).reshape(len(values), -1).max(axis=1)))
    place, most = f"{place}, sample {sample + 1}", MAX_SI_VALUE[quantity]
    raise ProcessingError.about("process.number_too_large", role, place, most=most, found=largest)


def _check_missing(name: str, signal: Signal, quantity: str) -> list[Finding]:
    """Report blank samples; except at the ends of the record, they are doubtful."""
    max_blank_end_share = 0.02  # of the samples of a channel, at both ends together
    missing = np.isnan(signal.values)
    if not missing.any():
        return []
    count = int(missing.sum())
    finite = np.flatnonzero(~missing)
    if finite[0] + len(missing) - 1 - finite[-1] <= max_blank_end_share * len(missing):
        missing[: finite[0]] = missing[finite[-1] :] = False
    times, total = find_run_times(missing, signal.time), len(missing)
    note = QualityNote.of("process.missing_samples", name, *times, count=count, total=total)
    return [doubt_stretches(quantity, note, signal.clock) if times else Finding(note)]


def _check_clock(time: Floats, role: str, *, min_samples: int) -> None:
    if len(time) < min_samples:
        raise ProcessingError.about(
            "process.few_samples_of_clock", role, "time", least=min_samples, found=len(time)
        )
    backwards = np.flatnonzero(~(np.diff(time) > 0))
    if len(backwards):
        sample = int(backwards[0]) + 1
        place, after, before = f"sample {sample + 1}", time[sample], time[sample - 1]
        raise ProcessingError.about(
            "process.time_backwards", role, place, after=after, before=before
        )


def check_channels(signals: Signals, protocol: Protocol) -> Iterator[Finding]:
    """Report channels while they are saturated or frozen.

    Parameters
    ----------
    signals : the raw ones are checked
    protocol : names the channel that splits the branches and the one that joins the clocks
    """
    quantities = {} if protocol.curve is None else signals.quantities
    counterparts = dict(zip(quantities, reversed(quantities), strict=True))
    for name, signal in signals.raw.items():
        other = signals.raw.get(counterparts.get(name, ""))
        other_values = other.values if other is not None and other.clock == signal.clock else None
        runs = find_stuck_runs(signal.time, signal.values, other_values)
        quantity = quantities.get(name, name)
        saturated = [run for run in runs if run.is_clipped]
        if saturated:
            note = _make_saturation_note(name, signal, saturated)
            yield doubt_stretches(quantity, note, signal.clock)
            if getattr(protocol.align, "channel", "") == name:  # the times of its peaks are wrong
                yield doubt_stretches("clock", replace(note, stretches=()), signal.clock)
        for run in (run for run in runs if not run.is_clipped):
            start, stop = times = _find_run_times(signal, run)
            note = QualityNote.of(
                "process.frozen_channel",
                name,
                times,
                value=float(signal.values[run.start]),
                unit=signal.unit,
                start=start,
                stop=stop,
                of="s" if signal.has_time else "of the samples",
            )
            yield doubt_stretches(quantity, note, signal.clock)
            if protocol.branches is not None and protocol.branches.channel == name:
                # the branches are at wrong times
                yield doubt_stretches("force", note, signal.clock)


def _make_saturation_note(name: str, signal: Signal, runs: list[StuckRun]) -> QualityNote:
    levels = sorted({float(signal.values[run.start]) for run in runs})
    return QualityNote.of(
        "process.saturation",
        name,
        *(_find_run_times(signal, run) for run in runs),
        count=sum(run.stop - run.start for run in runs),
        runs=len(runs),
        levels=" and ".join(f"{level:.6g} {signal.unit}" for level in levels),
    )


def _find_run_times(signal: Signal, run: StuckRun) -> tuple[float, float]:
    """Return the times of the last sample before a run and the first one after it."""
    first, last = max(run.start - 1, 0), min(run.stop, len(signal.time) - 1)
    return float(signal.time[first]), float(signal.time[last])
