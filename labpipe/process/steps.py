"""Calibrate the channels of recordings, check them, and run the steps of a protocol.

The zero of a signal is the level at rest that is subtracted from it. It has a standard error.

References
----------
.. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
       dissertation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.errors import ProcessingError, format_overrides
from labpipe.messages import format_sentence
from labpipe.process.motion import Motion, orient_force
from labpipe.protocol.schema import Protocol, Rig
from labpipe.protocol.source import ChannelSource
from labpipe.records import declarations
from labpipe.records.arrays import (
    Flags,
    Floats,
    average_blocks,
    compute_median_step,
    drop_missing,
    find_run_times,
)
from labpipe.records.causes import SPEED, TURN
from labpipe.records.curve import NORMAL_95, Shape
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, QualityNote, make_stretch_finding
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording
from labpipe.records.signals import Filter, Signal, Signals
from labpipe.results.kinds import SpanBend
from labpipe.signal.bad_samples import StuckRun, find_stuck_runs
from labpipe.signal.corners import Corner, fit_reversal
from labpipe.signal.filters import (
    Butterworth,
    Smoothing,
    compute_window,
    convert_seconds_to_window,
    filter_pieces,
)
from labpipe.signal.turning_points import count_rest_samples, find_sharpest_turn
from labpipe.uncertainty.autocorrelation import (
    cut_smooth_stretches,
    estimate_long_run_variance,
    fit_linear,
)

if TYPE_CHECKING:
    from labpipe.markers.specimen_frame import SpecimenFrame
    from labpipe.markers.track_repair import RepairedTracks


MAX_SI_VALUE = {"channel": 1e15, "marker": 1e6}
"""Largest absolute values of channels and of marker positions, in SI units.

A file with a larger value is treated as damaged.
"""
MIN_ZERO_SAMPLES_NOISE_UNKNOWN = 8
"""Smallest number of samples of a zero if the noise cannot be estimated from other samples."""
MIN_ZERO_SAMPLES_NOISE_KNOWN = 3
"""Smallest number of samples of a zero if the noise is estimated from the other samples."""
MIN_SELF_NOISE_SAMPLES = 100
"""Smallest number of samples of a stretch from which its noise is estimated.

The noise of a shorter stretch is estimated from the other samples of the record.
"""
_MIN_BLOCKS = 1000
"""Smallest number of blocks into which a long stretch is averaged, to save time."""


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """Camera recording of a test, with its marker tracks and the quantities derived from them.

    Parameters
    ----------
    tracks : tracks of all markers and rigid bodies; None for a test without cameras
    role : role of the recording in the protocol
    clamp_positions : shape (frames, 3), m, pivot of the clamp as exported; None without a clamp
    repaired_tracks : repaired tracks of the markers along the specimen; None before the step
        ``repair-markers``
    frame : coordinate frame of the specimen; None before the step ``specimen-frame``
    is_at_rest : shape (frames,), whether the specimen is at rest in each camera frame. The frames
        at rest define the coordinate frame. None before the step ``specimen-frame``
    scale_uncertainty : relative standard uncertainty of the scale of the cameras
    """

    tracks: MarkerTracks | None = None
    role: str = "markers"
    clamp_positions: Floats | None = None
    repaired_tracks: RepairedTracks | None = None
    frame: SpecimenFrame | None = None
    is_at_rest: Flags | None = None
    scale_uncertainty: float = 0.0

    def make_signal(self, time: Floats, values: Floats) -> Signal:
        """Make a signal from lengths (m) on the clock of the cameras, with their scale error."""
        return Signal(time, values, "m", self.role, relative_error=self.scale_uncertainty)


@dataclass(frozen=True, slots=True, eq=False)
class PreparedTest:
    """Test before its force and displacement are combined into a curve.

    Parameters
    ----------
    signals : signals after the steps that were run
    take : camera recording after the steps that were run
    shape : shape of the specimen; None if no step fits one
    span : bent axis between two supports, or the reason why there is none; None if no step fits one
    """

    signals: Signals
    take: Take = Take()
    shape: Shape | None = None
    span: SpanBend | Failure | None = None


def calibrate(
    recordings: Mapping[str, Recording], protocol: Protocol
) -> tuple[PreparedTest, list[Finding]]:
    """Calibrate the channels of all recordings, and check their clocks, magnitudes and samples.

    Parameters
    ----------
    recordings : recordings, keyed by role; channels have the names and units of the protocol
    protocol : resolved protocol

    Returns
    -------
    The test with signals and marker tracks, and the findings, which are the notes of the readers
    and the findings of the checks of single channels.

    Raises
    ------
    ProcessingError
        If a clock has too few samples or does not increase, a channel has no finite sample, a value
        exceeds `MAX_SI_VALUE`, or the gauge length of a strain is not stated.
    """
    min_samples, min_frames, gauge_length = 8, 2, protocol.specimen.gauge_length
    curve, findings = protocol.curve, list[Finding]()
    signals = Signals() if curve is None else Signals(curve.force, curve.displacement)
    take = Take()
    scale_errors: dict[str, float] = {x: y.gain_uncertainty for x, y in protocol.sources.items()}
    reversed_channels = [getattr(curve, name) for name in (curve and curve.reverse) or ()]
    for role, recording in recordings.items():
        quantities = {x.path: signals.quantities.get(x.name) for x in recording.channels}
        for note in recording.notes:
            located_note = replace(note, where=f"{role}: {note.where}" if note.where else role)
            quantity = quantities.get(note.where) if note.code == "columns_disagree" else None
            finding = make_stretch_finding(quantity, located_note, "") if quantity else None
            findings.append(finding or Finding(located_note))
        if recording.markers is not None:
            tracks = recording.markers
            _check_clock(tracks.time, role, min_samples=min_frames)
            for index, name in enumerate(tracks.names):
                _check_magnitude(tracks.positions[:, index], "marker", role, f"marker {name!r}")
            for body in tracks.bodies:
                _check_magnitude(body.position, "marker", role, f"rigid body {body.name!r}")
            take = Take(tracks, role, scale_uncertainty=scale_errors[role])
        for channel in recording.channels:
            name, clock = channel.name, recording.get_clock(channel.clock)
            _check_clock(clock.time, role, min_samples=min_samples)
            channel_source = protocol.channels[name]
            signal = _calibrate_channel(channel, channel_source, clock, role, gauge_length)
            if name in reversed_channels:
                signal = replace(signal, values=-signal.values)
            signals = signals.add_signal(name, signal)
            quantity = signals.quantities.get(name, name)
            findings += _check_missing(name, signal, quantity)
            findings += _check_peak(name, signal, quantity, channel_source.peak_range)
    return PreparedTest(signals, take), findings


def _calibrate_channel(
    channel: Channel, settings: ChannelSource, clock: Clock, role: str, gauge_length: float | None
) -> Signal:
    """Convert a strain, if any, to an extension, and apply the calibration of the protocol."""
    values, place = channel.values, f"channel {channel.path!r}"
    if settings.is_extension and channel.unit == "1":
        if gauge_length is None:
            raise ProcessingError.about("process.strain_without_gauge", role, place)
        values = gauge_length * values
    if settings.calibration is not None:
        values = settings.gain * values
        values += settings.offset
    if not np.isfinite(values[:1]).all() and not np.isfinite(values).any():
        raise ProcessingError.about("process.no_numbers", role, place)
    _check_magnitude(values, "channel", role, place)
    return Signal(
        time=clock.time,
        values=values,
        unit=settings.target_unit,
        clock=role,
        relative_error=settings.gain_uncertainty,
        zero_drift=settings.zero_drift or 0.0,
        time_unit=clock.unit,
    )


def _check_peak(
    name: str, signal: Signal, quantity: str, peak_range: tuple[float, float] | None
) -> Iterator[Finding]:
    """Report an implausible peak of a channel, which may result from a wrong unit."""
    if peak_range is None:
        return
    peak = float(np.nanmax(np.abs(signal.values)))
    if not peak_range[0] <= peak <= peak_range[1]:
        facts: dict[str, Any] = {"peak": peak, "signal": signal, "limits": peak_range}
        yield Finding.of("process.implausible_peak", name, quantity, **facts)


def _check_magnitude(values: Floats, kind: str, role: str, place: str) -> None:
    """Raise an error for values that are too large to be measurements.

    Parameters
    ----------
    values : shape (samples, ...), values in SI units
    kind : ``channel`` or ``marker``
    role : role of the recording, for the message
    place : channel, marker or rigid body, for the message
    """
    largest = max(float(np.nanmax(values, initial=0.0)), -float(np.nanmin(values, initial=0.0)))
    if not largest > MAX_SI_VALUE[kind]:
        return
    magnitudes = np.nan_to_num(np.abs(values)).reshape(len(values), -1).max(axis=1)
    where, limit = f"{place}, sample {int(np.argmax(magnitudes)) + 1}", MAX_SI_VALUE[kind]
    raise ProcessingError.about("process.number_too_large", role, where, limit=limit, found=largest)


def _check_missing(name: str, signal: Signal, quantity: str) -> list[Finding]:
    """Report missing samples, and mark their times as doubtful.

    The times of a few missing samples at the ends of the record are not doubtful.
    """
    max_end_fraction = 0.02  # missing samples at both ends together, over all samples
    is_missing = np.isnan(signal.values)
    if not is_missing.any():
        return []
    count, total = int(is_missing.sum()), len(is_missing)
    first, last = np.flatnonzero(~is_missing)[[0, -1]]
    n_missing_at_ends = first + total - 1 - last
    if n_missing_at_ends <= max_end_fraction * total:
        is_missing[:first] = is_missing[last:] = False
    times = find_run_times(is_missing, signal.time)
    note = QualityNote.of("process.missing_samples", name, *times, count=count, total=total)
    return [make_stretch_finding(quantity, note, signal.clock) if times else Finding(note)]


def _check_clock(time: Floats, role: str, *, min_samples: int) -> None:
    """Raise an error for a clock with too few samples, or one that does not increase."""
    if len(time) < min_samples:
        facts = {"needed": min_samples, "found": len(time)}
        raise ProcessingError.about("process.few_samples_of_clock", role, "time", **facts)
    is_increasing = time[1:] > time[:-1]
    if not is_increasing.all():
        sample = int(np.argmin(is_increasing)) + 1
        facts = {"time": time[sample], "previous": time[sample - 1]}
        raise ProcessingError.about("process.time_backwards", role, f"sample {sample + 1}", **facts)


def check_channels(signals: Signals, protocol: Protocol) -> Iterator[Finding]:
    """Report the times at which channels are saturated or frozen.

    Parameters
    ----------
    signals : signals of the test, whose raw samples are checked
    protocol : protocol with the channels that separate the branches and align the clocks
    """
    quantities = {} if protocol.curve is None else signals.quantities
    # The force is paired with the displacement, and vice versa.
    paired_names = dict(zip(quantities, reversed(quantities), strict=True))
    for name, signal in signals.raw.items():
        paired = signals.raw.get(paired_names.get(name, ""))
        paired_values = None if paired is None or paired.clock != signal.clock else paired.values
        runs = find_stuck_runs(signal.time, signal.values, paired_values)
        quantity = quantities.get(name, name)
        saturated_runs = [run for run in runs if run.is_clipped]
        frozen_runs = [run for run in runs if not run.is_clipped]
        if saturated_runs:
            note = _make_saturation_note(name, signal, saturated_runs)
            yield make_stretch_finding(quantity, note, signal.clock)
            if getattr(protocol.align, "channel", "") == name:
                # The clocks are aligned at peaks whose times are wrong.
                yield make_stretch_finding("clock", replace(note, stretches=()), signal.clock)
        for run in frozen_runs:
            times = _get_adjacent_times(signal, run)
            time_unit = "s" if signal.has_time else "of the samples"
            facts = {"value": float(signal.values[run.start]), "signal": signal}
            facts |= {"times": times, "time_unit": time_unit}
            note = QualityNote.of("process.frozen_channel", name, times, **facts)
            yield make_stretch_finding(quantity, note, signal.clock)
            if protocol.branches is not None and protocol.branches.channel == name:
                # The branches begin and end at wrong times.
                yield make_stretch_finding("force", note, signal.clock)


def _make_saturation_note(name: str, signal: Signal, runs: list[StuckRun]) -> QualityNote:
    """Make the note of all stretches in which a channel is saturated."""
    levels = sorted({float(signal.values[run.start]) for run in runs})
    levels_text = " and ".join(f"{level:.6g} {signal.unit}" for level in levels)
    count = sum(run.stop - run.start for run in runs)
    facts = {"count": count, "runs": len(runs), "levels": levels_text}
    stretches = [_get_adjacent_times(signal, run) for run in runs]
    return QualityNote.of("process.saturation", name, *stretches, **facts)


def _get_adjacent_times(signal: Signal, run: StuckRun) -> tuple[float, float]:
    """Return the times of the last sample before a run and of the first one after it."""
    first, last = max(run.start - 1, 0), min(run.stop, len(signal.time) - 1)
    return float(signal.time[first]), float(signal.time[last])


def compute_travel_from_speed(
    signals: Signals, step: declarations.TravelFromSpeed, rig: Rig
) -> tuple[Signals, list[Finding]]:
    """Run ``travel-from-speed``: compute the displacement on the clock of the force.

    Parameters
    ----------
    signals : signals with the force
    step : step of the protocol
    rig : rig with crosshead speed and stroke

    Returns
    -------
    The signals with the computed channel, and the findings: a note on the computed displacement
    and, if the loading began significantly before the record of the force, a finding that the force
    is doubtful.

    Raises
    ------
    ValueError
        If speed or stroke is not stated, the force has no times, or its turn is not found with a
        standard error below 0.5 s.

    Notes
    -----
    The motion turns at the corner of the force, and the loading begins stroke / speed before the
    turn. In appendix A.6 of [1]_ the loading begins 58.8 s before the largest force. In one
    perturbed signal the turn is later by its standard error. In the other, the speed is higher by
    its standard uncertainty.
    """
    if rig.crosshead_speed is None or rig.stroke is None:
        raise ValueError(format_sentence("process.speed_needs_rig"))
    force, speed = orient_force(signals.raw[step.force]), rig.crosshead_speed
    corner, duration = _fit_reversal_corner(force, step), rig.stroke / speed  # s, of the loading
    loading_start = corner.time - duration
    time = np.arange(force.time[0], force.time[-1], 1.0 / step.rate)

    def compute_travel(delay: float) -> Floats:
        """Compute the displacement (m) of a motion that begins and turns later by a delay (s)."""
        loading_time = np.clip(time - loading_start - delay, 0.0, duration)
        unloading_time = np.clip(time - corner.time - delay, 0.0, duration)
        return np.asarray(speed * (loading_time - unloading_time), dtype=np.float64)

    values, time_error = compute_travel(0.0), corner.time_error
    faster_values = (1.0 + step.speed_uncertainty) * values
    perturbed_values = {TURN: compute_travel(time_error), SPEED: faster_values}
    signal = Signal(time, values, "m", force.clock, variants=perturbed_values)
    facts: dict[str, Any] = {"speed": 1e3 * speed, "duration": duration}
    facts |= {"time": corner.time, "error": 1e3 * time_error}
    findings = [Finding.of("process.displacement_from_speed", step.channel, **facts)]
    missed_time = float(force.time[0]) - loading_start
    coverage_factor = 2.0  # of the uncertainty of the start of the loading
    half_width = coverage_factor * float(np.hypot(time_error, step.speed_uncertainty * duration))
    if missed_time > half_width:
        facts = {"missed_time": missed_time, "half_width": half_width}
        findings.append(Finding.of("process.start_missed", "force", "force", **facts))
    return signals.add_signal(step.channel, signal), findings


def _fit_reversal_corner(force: Signal, step: declarations.TravelFromSpeed) -> Corner:
    """Fit the corner of a force where the motion turns.

    Raises
    ------
    ValueError
        If there is no corner whose time has a standard error below 0.5 s.
    """
    max_time_error = 0.5  # s
    _require_time(force, step.force, setting="a speed")
    corner, record = None, (force.time, force.values)
    turn_time = find_sharpest_turn(*record, width=step.window)
    if turn_time is not None:
        corner = fit_reversal(*record, guess=turn_time, window=step.window)
    if corner is None or not corner.time_error < max_time_error:
        raise ValueError(format_sentence("process.no_turn", channel=step.force))
    return corner


def run_step(
    prepared: PreparedTest, step: declarations.Step, protocol: Protocol
) -> tuple[PreparedTest, list[Finding]]:
    """Run one step of a protocol on a test.

    Parameters
    ----------
    prepared : test after the earlier steps
    step : step of the protocol
    protocol : protocol with markers, rig and specimen

    Returns
    -------
    The test after the step, and its findings.

    Raises
    ------
    ProcessingError
        If the step cannot be run on the data; the message contains its key and a remedy.
    """
    signals = prepared.signals
    try:
        match step:
            case declarations.TravelFromSpeed():
                signals, findings = compute_travel_from_speed(signals, step, protocol.rig)
            case declarations.Zero():
                signals, findings = zero_signal(signals, step)
            case declarations.Smooth() | declarations.LowPass() | declarations.Decimate():
                signals, findings = _filter_signal(signals, step, protocol)
            case _:
                # The import is slow, and only tests with cameras need it.
                from labpipe.process.camera_steps import run_marker_step

                span = protocol.specimen.span
                return run_marker_step(prepared, step, protocol.markers, span)
    except ValueError as error:
        text, *remedies = error.args
        remedy = remedies[0] if remedies else format_sentence("process.step_remedy")
        message = f"{step.key} ({step.step}): {text}. {remedy}"
        raise ProcessingError(message) from error
    return replace(prepared, signals=signals), findings


def zero_signal(signals: Signals, step: declarations.Zero) -> tuple[Signals, list[Finding]]:
    """Run ``zero``: subtract the level of a signal at rest, and record the stretch of this zero.

    Parameters
    ----------
    signals : signals of the test
    step : step of the protocol with channel, stretch and method

    Returns
    -------
    The signals after the subtraction, and a note with the level.

    Raises
    ------
    ValueError
        If the signal has no times, or the stretch contains too few samples.
    """
    name, is_at_start = step.channel, step.at == "start"
    signal = signals.filtered[name]
    _require_time(signal, name, "a stretch in s")
    time, first, stop = signal.time, 0, len(signal.time)
    if is_at_start:
        stated_stop = int(np.searchsorted(time, time[0] + step.over, side="right"))
        stop = min(max(stated_stop, MIN_ZERO_SAMPLES_NOISE_KNOWN), stop)
    else:
        stated_first = int(np.searchsorted(time, time[-1] - step.over))
        first = max(min(stated_first, stop - MIN_ZERO_SAMPLES_NOISE_KNOWN), 0)
    duration = max(step.over, float(time[stop - 1] - time[first]))
    start_time = float(time[0] if is_at_start else time[-1] - duration)
    values = drop_missing(signal.values[first:stop])
    other_values = signal.values[stop:] if is_at_start else signal.values[:first]
    min_samples = compute_min_zero_samples(other_values)
    if len(values) < min_samples:
        time_step = compute_median_step(time)
        facts: dict[str, Any] = {"needed": min_samples, "rate": 1.0 / time_step}
        facts |= {"channel": name, "count": len(values), "duration": duration}
        duration_text = f"{(min_samples + 0.5) * time_step:.2g} s"
        remedy = f"Write {format_overrides(f'{step.key}.over', duration_text)}."
        raise ValueError(format_sentence("process.short_stretch", **facts), remedy)
    stretch = {name: (start_time, start_time + duration)}
    if step.by == "mean":
        signals = replace(signals, zero_stretches={**signals.zero_stretches, **stretch})
        level, error = average_level(values, other_values)
        method = f"the mean over {duration:.4g} s"
    else:
        stretches = {**signals.moving_zero_stretches, **stretch}
        signals = replace(signals, moving_zero_stretches=stretches)
        inward_values = values if is_at_start else values[::-1]  # from the end of the record
        level, error, n_rest = estimate_level_before_motion(inward_values, other_values)
        method = f"the outer end of a line over {duration:.4g} s"
        if n_rest:
            rest_duration = duration * n_rest / len(values)
            method = f"the mean over the {rest_duration:.3g} s before the motion"
    facts = {"level": round(level, 12), "unit": signal.unit, "method": method}
    facts |= {"end": step.at, "count": len(values)}
    is_short = len(values) < MIN_ZERO_SAMPLES_NOISE_UNKNOWN
    finding = Finding.of("process.zeroed_on_few" if is_short else "process.zeroed", name, **facts)
    return signals.subtract_level(name, level, error), [finding]


def _require_time(signal: Signal, name: str, setting: str) -> None:
    """Raise an error if a setting, such as a cutoff in Hz, needs times that a signal lacks."""
    if not signal.has_time:
        raise ValueError(format_sentence("process.needs_times", channel=name, setting=setting))


def _filter_signal(
    signals: Signals,
    step: declarations.Smooth | declarations.LowPass | declarations.Decimate,
    protocol: Protocol,
) -> tuple[Signals, list[Finding]]:
    """Run ``smooth``, ``low-pass`` or ``decimate`` on a signal.

    For a force or displacement of the curve, ``smooth`` is recorded but not applied here, because
    `curve_corrections` applies it to each branch.
    """
    name = step.channel
    signal, findings = signals.filtered[name], list[Finding]()
    time_step = compute_median_step(signal.time)
    filter_step: Filter
    match step:
        case declarations.Smooth():
            window = _convert_span(step.span, signal, protocol)
            duration = f" ({window * time_step:.4g} s)" if signal.has_time else ""
            filter_step = Smoothing(window), 1
            findings = [Finding.of("process.smoothed", name, window=window, duration=duration)]
            if protocol.curve and protocol.branches and name in signals.quantities:
                return signals.replace_filtered(name, signal, filter_step), findings
        case declarations.LowPass():
            _require_time(signal, name, "a cutoff in Hz")
            filter_step = Butterworth(step.cutoff, 1.0 / time_step, step.order), 1
        case declarations.Decimate():
            window = step.factor + 1 - step.factor % 2 if step.method == "filtered" else 1
            filter_step = Smoothing(window), step.factor
            findings = [Finding.of("process.decimated", name, step=step)]
    signal = replace(signal, time=signal.time[:: filter_step[1]])
    signal = signal.map_values(lambda values: filter_pieces(values, (), [filter_step]))
    return signals.replace_filtered(name, signal, filter_step), findings


def _convert_span(span: declarations.Span, signal: Signal, protocol: Protocol) -> int:
    """Convert a span in samples, seconds, travel or branches to a number of samples."""
    if span.kind == "samples":
        return compute_window(max(1.0, span.value), len(signal.values))
    _require_time(signal, "smooth", f"a span of {span.kind}")
    if span.kind == "time":
        return convert_seconds_to_window(span.value, signal.time)
    speed, stroke = protocol.rig.crosshead_speed, protocol.rig.stroke
    if speed is None or (span.kind == "branch" and stroke is None):
        raise ValueError(format_sentence("process.span_needs_rig", kind=span.kind))
    travel = span.value if span.kind == "travel" else span.value * (stroke or 0.0)
    return convert_seconds_to_window(travel / speed, signal.time)


def compute_min_zero_samples(other_values: Floats) -> int:
    """Compute the smallest number of samples from which a zero is computed.

    Parameters
    ----------
    other_values : shape (m,), all samples of the record outside the stretch of the zero

    Notes
    -----
    Three samples suffice if the noise can be estimated from the other samples. For this estimate,
    at least 100 of them must be finite, or at least 25 if there are fewer than 100. Otherwise eight
    samples are needed. With 3 to 6 samples, the 95 % intervals of `average_level` and
    `fit_end_level` then cover the true value in 94 to 96 % of cases, in white noise and in noise
    with a correlation length of ten samples. With only 25 other samples the coverage is the same
    for a correlation length of two samples. For a correlation length of ten samples it is 73 %,
    because such noise cannot be distinguished from the curve of so short a record.
    """
    count = len(other_values) - np.count_nonzero(np.isnan(other_values))
    has_noise_estimate = count >= _choose_stretch_width(other_values)
    return MIN_ZERO_SAMPLES_NOISE_KNOWN if has_noise_estimate else MIN_ZERO_SAMPLES_NOISE_UNKNOWN


def average_level(values: Floats, other_values: Floats) -> tuple[float, float]:
    """Average a stretch of samples, and estimate the standard error of its mean.

    Parameters
    ----------
    values : shape (n,), evenly spaced samples of the stretch without NaN
    other_values : shape (m,), all other samples of the record, from which the noise is estimated
        if the stretch is shorter than `MIN_SELF_NOISE_SAMPLES`

    Returns
    -------
    The mean and its standard error, in the unit of `values`.
    """
    stretches = _select_noise_stretches(values, other_values)
    if stretches:
        fit = fit_linear(np.ones((len(values), 1)), values, other_stretches=stretches)
        return float(fit.coefficients[0]), float(fit.half_widths[0]) / NORMAL_95
    blocks = average_blocks(values, _MIN_BLOCKS, has_remainder=False)
    error = float(np.sqrt(estimate_long_run_variance(blocks, n_parameters=1) / len(blocks)))
    return float(values.mean()), error


def fit_end_level(values: Floats, other_values: Floats) -> tuple[float, float]:
    """Fit a line to a stretch, and estimate the standard error of the line at the first sample.

    Parameters
    ----------
    values, other_values : samples as for `average_level`

    Returns
    -------
    The value of the line at the first sample and its standard error, in the unit of `values`.
    """
    blocks = average_blocks(values, _MIN_BLOCKS, has_remainder=False)
    block_size = len(values) // len(blocks)
    # The unit of positions is the length of a block, and the first sample is at 0.
    positions = np.arange(len(blocks)) + 0.5 * (block_size - 1) / block_size
    design = np.column_stack([np.ones(len(blocks)), positions])
    fit = fit_linear(design, blocks, other_stretches=_select_noise_stretches(values, other_values))
    # 1.96 of the returned standard errors are as wide as the interval from Student's t.
    return float(fit.coefficients[0]), float(fit.half_widths[0]) / NORMAL_95


def estimate_level_before_motion(values: Floats, other_values: Floats) -> tuple[float, float, int]:
    """Estimate the level before a motion, from a stretch that includes the start of the motion.

    Parameters
    ----------
    values, other_values : samples as for `average_level`; the first of `values` is the first
        sample of the record, or the last one if the stretch is at the end and its order is reversed

    Returns
    -------
    level, error : mean over the period at rest at the beginning of the stretch, and its standard
        error. If that period is too short, they are results of `fit_end_level` for the samples
        after it, or for all samples if fewer than `MIN_ZERO_SAMPLES_NOISE_UNKNOWN` follow
    n_rest : number of samples in the period at rest; 0 if the level is from a line
    """
    n_rest = count_rest_samples(values)
    rest_values, moving_values = values[:n_rest], values[n_rest:]
    if n_rest >= compute_min_zero_samples(other_values):
        other_values = np.concatenate([moving_values, other_values])
        return *average_level(rest_values, other_values), n_rest
    if len(moving_values) < MIN_ZERO_SAMPLES_NOISE_UNKNOWN:
        moving_values = values
    return *fit_end_level(moving_values, other_values), 0


def _select_noise_stretches(values: Floats, other_values: Floats) -> Sequence[Floats]:
    """Select smooth stretches of the other samples, from which the noise is estimated."""
    if len(values) >= MIN_SELF_NOISE_SAMPLES:
        return ()
    return cut_smooth_stretches(other_values, width=_choose_stretch_width(other_values))


def _choose_stretch_width(other_values: Floats) -> int:
    """Choose the number of samples of a stretch from which the noise is estimated."""
    short_width = 25
    return MIN_SELF_NOISE_SAMPLES if len(other_values) >= MIN_SELF_NOISE_SAMPLES else short_width


def rezero_at_rest(signals: Signals, motion: Motion) -> tuple[Signals, list[Finding]]:
    """Recompute each zero whose stretch includes motion, from the samples at rest alone.

    Parameters
    ----------
    signals : signals after the steps
    motion : motion of the test with its branches and clocks

    Returns
    -------
    The signals with recomputed zeros, and a note on each of these zeros.

    Notes
    -----
    Only zeros that are means are recomputed. The standard error is that of the samples at rest.
    With fewer than `MIN_ZERO_SAMPLES_NOISE_UNKNOWN` samples at rest the zero is not recomputed, and
    `check_zeros` reports it as doubtful.
    """
    findings: list[Finding] = []
    branches = motion.branches
    for name, (start, stop) in signals.zero_stretches.items() if branches else ():
        raw_signal = signals.raw[name]
        time, values = raw_signal.time, raw_signal.values
        motion_start = motion.clocks.from_curve(branches[0].start_time, raw_signal.clock)
        motion_end = motion.clocks.from_curve(branches[-1].stop_time, raw_signal.clock)
        if start < motion_start < stop:
            rest_period = (start, motion_start)
        elif start < motion_end < stop:
            rest_period = (motion_end, stop)
        else:
            continue
        is_at_rest = (time >= rest_period[0]) & (time <= rest_period[1])
        rest_values = drop_missing(values[is_at_rest])
        if len(rest_values) >= MIN_ZERO_SAMPLES_NOISE_UNKNOWN:
            level, error = average_level(rest_values, values[~is_at_rest])
            stretches = {**signals.zero_stretches, name: rest_period}
            signals = replace(signals.subtract_level(name, level, error), zero_stretches=stretches)
            duration, stated = rest_period[1] - rest_period[0], stop - start
            finding = Finding.of("process.short_rest", name, duration=duration, stated=stated)
            findings.append(finding)
    return signals, findings
