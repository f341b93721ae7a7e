"""Calibrate the channels of recordings to signals in SI units, and run the steps of a protocol.

Channels are checked before the steps run. A zero is the level of a signal at rest, with the
standard error of that level.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from labpipe.errors import ProcessingError, format_overrides
from labpipe.messages import format_sentence
from labpipe.process.motion import Motion, average_whole_blocks, orient_force
from labpipe.protocol.schema import Protocol, Rig
from labpipe.protocol.source import ChannelSource
from labpipe.records import declarations
from labpipe.records.arrays import Flags, Floats, compute_median_step, find_run_times
from labpipe.records.causes import SPEED, TURN
from labpipe.records.curve import Interval, Shape
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, QualityNote, doubt_stretches
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
"""Largest SI values of recordings; larger ones come from damaged files."""


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """The camera recording at each stage from marker tracks to the shape of the specimen.

    Parameters
    ----------
    tracks : tracks of all markers and rigid bodies; None for a test without a take
    role : role of the recording
    clamp : shape (frames, 3), m, pivot of the clamp as exported; None for a take without a clamp
    repaired : tracks of the markers along the specimen
    frame : coordinate frame of the specimen
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
    signals, take : signals and camera recording after the steps so far
    shape : shape of the specimen; None if no step fits one
    span : the bent axis between two supports, or why there is none; None if no step fits one
    """

    signals: Signals
    take: Take = Take()
    shape: Shape | None = None
    span: SpanBend | Failure | None = None


def calibrate(
    recordings: Mapping[str, Recording], protocol: Protocol
) -> tuple[Prepared, list[Finding]]:
    """Calibrate the channels of all recordings, and check their clocks, sizes and samples.

    Parameters
    ----------
    recordings : recordings by role, whose channels have the names and units of the protocol
    protocol : resolved protocol

    Returns
    -------
    Signals and marker tracks; the notes of the readers and the findings of the first checks.

    Raises
    ------
    ProcessingError
        If a clock has too few samples or does not increase, a channel has no finite sample, a
        number is impossibly large, or a strain has no gauge length.
    """
    min_samples = 8
    curve, findings = protocol.curve, list[Finding]()
    signals = Signals() if curve is None else Signals(curve.force, curve.displacement)
    take = Take()
    scales: dict[str, float] = {
        role: source.gain_uncertainty for role, source in protocol.sources.items()
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
            tracks = recording.markers
            for column, name in enumerate(tracks.names):
                _check_size(tracks.positions[:, column], "marker", role, f"marker {name!r}")
            for body in tracks.bodies:
                _check_size(body.position, "marker", role, f"rigid body {body.name!r}")
            take = Take(tracks, role, scale_error=scales[role])
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
        values = source.gain * values
        values += source.offset
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
    peak = float(np.nanmax(np.abs(signal.values)))
    if peak_range[0] <= peak <= peak_range[1]:
        return []
    return [
        Finding.of(
            "process.implausible_peak", name, quantity, peak=peak, signal=signal, limits=peak_range
        )
    ]


def _check_size(values: Floats, quantity: str, role: str, place: str) -> None:
    """Refuse numbers that are too large to be measurements."""
    largest = max(float(np.nanmax(values, initial=0.0)), -float(np.nanmin(values, initial=0.0)))
    if not largest > MAX_SI_VALUE[quantity]:
        return
    sample = int(np.argmax(np.nan_to_num(np.abs(values)).reshape(len(values), -1).max(axis=1)))
    place, max_value = f"{place}, sample {sample + 1}", MAX_SI_VALUE[quantity]
    raise ProcessingError.about(
        "process.number_too_large", role, place, most=max_value, found=largest
    )


def _check_missing(name: str, signal: Signal, quantity: str) -> list[Finding]:
    """Report blank samples; they are doubtful, except a few at the ends of the record."""
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
    reversed_steps = np.flatnonzero(~(time[1:] > time[:-1]))
    if len(reversed_steps):
        sample = int(reversed_steps[0]) + 1
        place, later_time, earlier_time = f"sample {sample + 1}", time[sample], time[sample - 1]
        raise ProcessingError.about(
            "process.time_backwards", role, place, after=later_time, before=earlier_time
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
        pair = signals.raw.get(counterparts.get(name, ""))
        pair_values = pair.values if pair is not None and pair.clock == signal.clock else None
        runs = find_stuck_runs(signal.time, signal.values, pair_values)
        quantity = quantities.get(name, name)
        saturated = [run for run in runs if run.is_clipped]
        if saturated:
            note = _make_saturation_note(name, signal, saturated)
            yield doubt_stretches(quantity, note, signal.clock)
            if getattr(protocol.align, "channel", "") == name:  # the times of its peaks are wrong
                yield doubt_stretches("clock", replace(note, stretches=()), signal.clock)
        for run in (run for run in runs if not run.is_clipped):
            times = _find_run_times(signal, run)
            note = QualityNote.of(
                "process.frozen_channel",
                name,
                times,
                value=float(signal.values[run.start]),
                signal=signal,
                times=times,
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


MIN_SAMPLES_NOISE_UNKNOWN = 8
"""Samples that a zero needs if the rest of the record is too short to show its noise."""
MIN_SAMPLES_NOISE_KNOWN = 3
"""Samples that a zero needs if the rest of the record shows its noise."""
SHORT_STRETCH = 100
"""Samples below which the noise of a stretch is taken from the rest of the record."""


def compute_travel_from_speed(
    signals: Signals, step: declarations.TravelFromSpeed, rig: Rig
) -> tuple[Signals, list[Finding]]:
    """Run ``travel-from-speed``: compute the displacement on the clock of the force.

    Parameters
    ----------
    signals : signals with the force
    step : step of the protocol
    rig : its crosshead speed and stroke

    Returns
    -------
    The signals with the channel; a note, and a doubt if loading began before the record.

    Raises
    ------
    ValueError
        If speed or stroke are not stated, the force has no times, or its turn is not found with a
        standard error below 0.5 s.

    Notes
    -----
    The turn is the corner of the force; loading began stroke / speed before it (the dissertation,
    App. A.6, uses the largest force as the turn, and 58.8 s). In the perturbed signals the turn is
    one standard error later, or the speed is higher by its uncertainty.
    """
    if rig.crosshead_speed is None or rig.stroke is None:
        raise ValueError(format_sentence("process.speed_needs_rig"))
    force, duration = orient_force(signals.raw[step.force]), rig.stroke / rig.crosshead_speed
    corner = _find_turn(force, step)
    start, speed = corner.time - duration, rig.crosshead_speed
    time = np.arange(force.time[0], force.time[-1], 1.0 / step.rate)

    def compute_travel(delay: float) -> Floats:
        """Return the displacement with a delayed loading: 0 before it and after the return."""
        loading_time = np.clip(time - start - delay, 0.0, duration)
        unloading_time = np.clip(time - corner.time - delay, 0.0, duration)
        return np.asarray(speed * (loading_time - unloading_time), dtype=np.float64)

    values = compute_travel(0.0)
    perturbed = {
        TURN: compute_travel(corner.time_error),
        SPEED: (1.0 + step.speed_uncertainty) * values,
    }
    signal = Signal(time, values, "m", force.clock, perturbed=perturbed)
    findings = [
        Finding.of(
            "process.displacement_from_speed",
            step.channel,
            speed=1e3 * speed,
            duration=duration,
            time=corner.time,
            error=1e3 * corner.time_error,
        )
    ]
    delay = float(force.time[0]) - start
    tolerance = 2.0 * float(np.hypot(corner.time_error, step.speed_uncertainty * duration))
    if delay > tolerance:
        findings.append(
            Finding.of("process.start_missed", "force", "force", delay=delay, within=tolerance)
        )
    return signals.add_signal(step.channel, signal), findings


def _find_turn(force: Signal, step: declarations.TravelFromSpeed) -> Corner:
    max_time_error = 0.5  # s
    if not force.has_time:
        raise ValueError(format_sentence("process.needs_times", channel=step.force, what="a speed"))
    record, window = (force.time, force.values), step.window
    turn_time = find_sharpest_turn(*record, width=window)
    if turn_time is not None:
        reversal = fit_reversal(*record, guess=turn_time, window=window)
    if turn_time is None or reversal is None or not reversal.time_error < max_time_error:
        raise ValueError(format_sentence("process.no_turn", channel=step.force))
    return reversal


def run_steps(prepared: Prepared, protocol: Protocol) -> tuple[Prepared, list[Finding]]:
    """Run the steps of a protocol.

    Parameters
    ----------
    prepared : calibrated
    protocol : resolved protocol

    Returns
    -------
    The test after the steps, and the findings.

    Raises
    ------
    ProcessingError
        If a step cannot be run on the data; the message has its key and a remedy.
    """
    findings: list[Finding] = []
    for step in protocol.steps:
        prepared, step_findings = run_step(prepared, step, protocol)
        findings += step_findings
    return prepared, findings


def run_step(
    prepared: Prepared, step: declarations.Step, protocol: Protocol
) -> tuple[Prepared, list[Finding]]:
    """Run one step; add its key and a remedy to the message of an error.

    Parameters
    ----------
    prepared : test after the steps before
    step : step of the protocol
    protocol : protocol with markers, rig and specimen

    Returns
    -------
    The test after the step, and the findings.

    Raises
    ------
    ProcessingError
        If the step cannot be run on the data.
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
                from labpipe.process.camera_steps import run_marker_step  # only these tests load it

                span = protocol.specimen.span
                return run_marker_step(prepared, step, protocol.markers, span)
    except ValueError as error:
        text, *remedies = error.args
        remedy = remedies[0] if remedies else format_sentence("process.step_remedy")
        message = f"{step.key} ({step.step}): {text}. {remedy}"
        raise ProcessingError(message) from error
    return replace(prepared, signals=signals), findings


def zero_signal(signals: Signals, step: declarations.Zero) -> tuple[Signals, list[Finding]]:
    """Subtract the level of a signal at rest, and record the stretch of that zero.

    Parameters
    ----------
    signals : signals of the test
    step : step with channel, stretch and method

    Returns
    -------
    The signals after the subtraction, and a note on the level.

    Raises
    ------
    ValueError
        If the signal has no times, or the stretch holds too few samples.
    """
    name = step.channel
    signal = signals.filtered[name]
    _require_time(signal, name, "a stretch in s")
    time, first, last = signal.time, 0, len(signal.time)
    if step.at == "start":
        stop = int(np.searchsorted(time, time[0] + step.over, side="right"))
        last = min(max(stop, MIN_SAMPLES_NOISE_KNOWN), last)
    else:
        start_sample = int(np.searchsorted(time, time[-1] - step.over))
        first = max(min(start_sample, last - MIN_SAMPLES_NOISE_KNOWN), 0)
    duration = max(step.over, float(time[last - 1] - time[first]))
    start = float(time[0] if step.at == "start" else time[-1] - duration)
    rest_values = signal.values[first:last]
    finite = rest_values[~np.isnan(rest_values)]
    other_values = signal.values[last:] if step.at == "start" else signal.values[:first]
    if len(finite) < (min_samples := count_required_samples(other_values)):
        time_step = compute_median_step(signal.time)
        message = format_sentence(
            "process.short_stretch",
            channel=name,
            count=len(finite),
            duration=duration,
            needed=min_samples,
            rate=1.0 / time_step,
        )
        needed = f"{(min_samples + 0.5) * time_step:.2g} s"
        remedy = f"Write {format_overrides(f'{step.key}.over', needed)}."
        raise ValueError(message, remedy)
    stretch = {name: (start, start + duration)}
    if step.by == "mean":
        signals = replace(signals, zero_stretches={**signals.zero_stretches, **stretch})
        level, error = average_level(finite, other_values)
        method = f"the mean over {duration:.4g} s"
    else:
        stretches = {**signals.moving_zero_stretches, **stretch}
        signals = replace(signals, moving_zero_stretches=stretches)
        values = finite if step.at == "start" else finite[::-1]
        level, error, rest_samples = measure_moving_zero(values, other_values)
        rest_time = duration * rest_samples / len(values)
        method = f"the outer end of a line over {duration:.4g} s"
        if rest_samples:
            method = f"the mean over the {rest_time:.3g} s before the motion"
    is_short = len(finite) < MIN_SAMPLES_NOISE_UNKNOWN
    note = Finding.of(
        "process.zeroed_on_few" if is_short else "process.zeroed",
        name,
        level=round(level, 12),
        unit=signal.unit,
        method=method,
        end=step.at,
        count=len(finite),
    )
    return signals.subtract_level(name, level, error), [note]


def _require_time(signal: Signal, name: str, what: str) -> None:
    """Refuse a setting in seconds or hertz if the export has no times."""
    if not signal.has_time:
        raise ValueError(format_sentence("process.needs_times", channel=name, what=what))


def _filter_signal(
    signals: Signals,
    step: declarations.Smooth | declarations.LowPass | declarations.Decimate,
    protocol: Protocol,
) -> tuple[Signals, list[Finding]]:
    """Filter a signal; `curve_corrections` filters a curve by branches once their ends are known.

    Until then, `Smooth` does not change a signal of the curve.
    """
    name = step.channel
    signal, findings = signals.filtered[name], list[Finding]()
    filter_step: Filter
    match step:
        case declarations.Smooth():
            window = _convert_span(step.span, signal, protocol)
            length = (
                f" ({window * compute_median_step(signal.time):.4g} s)" if signal.has_time else ""
            )
            filter_step = Smoothing(window), 1
            findings = [Finding.of("process.smoothed", name, window=window, length=length)]
            if protocol.curve and protocol.branches and name in signals.quantities:
                return signals.with_filtered(name, signal, filter_step), findings
        case declarations.LowPass():
            _require_time(signal, name, "a cutoff in Hz")
            filter_step = (
                Butterworth(step.cutoff, 1.0 / compute_median_step(signal.time), step.order),
                1,
            )
        case declarations.Decimate():
            window = step.factor + 1 - step.factor % 2 if step.method == "filtered" else 1
            filter_step, factor = (Smoothing(window), step.factor), step.factor
            findings = [Finding.of("process.decimated", name, kept=factor, method=step.method)]
    signal = replace(signal, time=signal.time[:: filter_step[1]])
    signal = signal.map_values(lambda values: filter_pieces(values, (), [filter_step]))
    return signals.with_filtered(name, signal, filter_step), findings


def _convert_span(span: declarations.Span, signal: Signal, protocol: Protocol) -> int:
    """Convert a span to samples; travel and branches by the speed of the rig."""
    count = len(signal.values)
    if span.kind == "samples":
        return compute_window(max(1.0, span.value), count)
    _require_time(signal, "smooth", f"a span of {span.kind}")
    if span.kind == "time":
        return convert_seconds_to_window(span.value, signal.time)
    speed, stroke = protocol.rig.crosshead_speed, protocol.rig.stroke
    if speed is None or (span.kind == "branch" and stroke is None):
        raise ValueError(format_sentence("process.span_needs_rig", kind=span.kind))
    travel = span.value if span.kind == "travel" else span.value * (stroke or 0.0)
    return convert_seconds_to_window(travel / speed, signal.time)


def count_required_samples(other_values: Floats) -> int:
    """Return the number of samples that a zero needs.

    Parameters
    ----------
    other_values : shape (m,), the rest of the record

    Notes
    -----
    Three samples suffice if the rest of the record has at least 100 finite samples, or at least 25
    if its length is below 100. Otherwise eight are needed. With 3 to 6 samples, the 95 %
    intervals of `average_level` and `fit_end_level` then cover the true value in 94 to 96 % of
    cases, in white noise and in noise with a correlation length of ten samples. If the rest of the
    record has only 25 samples, the coverage is the same for a correlation length of two samples. It
    is 73 % for one of ten samples, because so short a record does not separate such noise from its
    curve.
    """
    count = len(other_values) - np.count_nonzero(np.isnan(other_values))
    shows_noise = count >= _choose_stretch_width(other_values)
    return MIN_SAMPLES_NOISE_KNOWN if shows_noise else MIN_SAMPLES_NOISE_UNKNOWN


def average_level(values: Floats, other_values: Floats) -> tuple[float, float]:
    """Return the mean of a stretch and its standard error.

    Parameters
    ----------
    values : shape (n,), the stretch, evenly sampled, without NaN
    other_values : shape (m,), the rest of the record, for the noise of a stretch that is shorter
        than `SHORT_STRETCH`

    Returns
    -------
    Mean and its standard error, in the unit of `values`.
    """
    stretches = _select_noise_stretches(values, other_values)
    if stretches:
        fit = fit_linear(np.ones((len(values), 1)), values, other_stretches=stretches)
        half_width = float(fit.half_widths[0])
        return float(fit.coefficients[0]), Interval(-half_width, half_width).standard_error
    blocks = average_whole_blocks(values, 1000)  # fewer values make autocorrelation fast
    error = float(np.sqrt(estimate_long_run_variance(blocks, parameters=1) / len(blocks)))
    return float(values.mean()), error


def fit_end_level(values: Floats, other_values: Floats) -> tuple[float, float]:
    """Fit a line to a stretch; return the line at the first sample and its standard error.

    Parameters
    ----------
    values, other_values : values of the stretch, and of the rest of the record
    """
    blocks = average_whole_blocks(values, 1000)  # fewer values make autocorrelation fast
    size = len(values) // len(blocks)
    middles = np.arange(len(blocks)) + 0.5 * (size - 1) / size  # in blocks from the first sample
    design = np.column_stack([np.ones(len(blocks)), middles])
    fit = fit_linear(design, blocks, other_stretches=_select_noise_stretches(values, other_values))
    # As wide as the interval by Student's t, because a zero has few samples.
    interval = Interval(-float(fit.half_widths[0]), float(fit.half_widths[0]))
    return float(fit.coefficients[0]), interval.standard_error


def measure_moving_zero(values: Floats, other_values: Floats) -> tuple[float, float, int]:
    """Measure the level before a machine moved, from a stretch in which it moves.

    Parameters
    ----------
    values, other_values : as for `average_level`; `values` begin at the outer end of the stretch

    Returns
    -------
    level, error : the mean of a rest at the beginning of the stretch; if the rest is too short, the
        first value of a line through the samples after it (through all if fewer than eight follow)
    rest_samples : number of samples in that rest; 0 if the level is from a line
    """
    rest_samples = count_rest_samples(values)
    if rest_samples >= count_required_samples(other_values):
        return *average_level(
            values[:rest_samples], np.concatenate([values[rest_samples:], other_values])
        ), rest_samples
    moving = (
        values[rest_samples:] if len(values) - rest_samples >= MIN_SAMPLES_NOISE_UNKNOWN else values
    )
    return *fit_end_level(moving, other_values), 0


def _select_noise_stretches(values: Floats, other_values: Floats) -> Sequence[Floats]:
    if len(values) >= SHORT_STRETCH:
        return ()
    return cut_smooth_stretches(other_values, width=_choose_stretch_width(other_values))


def _choose_stretch_width(other_values: Floats) -> int:
    short_width = 25
    return SHORT_STRETCH if len(other_values) >= SHORT_STRETCH else short_width


def rezero_at_rest(signals: Signals, motion: Motion) -> tuple[Signals, list[Finding]]:
    """Recompute each mean zero in whose stretch the motion begins or ends, from the part at rest.

    Parameters
    ----------
    signals : zeroed
    motion : motion of the test, with joined clocks

    Returns
    -------
    The shifted signals, and a note on each recomputed zero.

    Notes
    -----
    The standard error is that of the shorter stretch. With fewer than `MIN_SAMPLES_NOISE_UNKNOWN`
    samples at rest the zero is not recomputed, and `check_rest` makes it doubtful.
    """
    findings: list[Finding] = []
    branches = motion.branches
    for name, (start, stop) in signals.zero_stretches.items() if branches else ():
        raw = signals.raw[name]
        motion_start, motion_end = (
            motion.clocks.from_curve(end, raw.clock)
            for end in (branches[0].start_time, branches[-1].stop_time)
        )
        if start < motion_start < stop:
            rest_stretch = (start, motion_start)
        elif start < motion_end < stop:
            rest_stretch = (motion_end, stop)
        else:
            continue
        is_at_rest = (raw.time >= rest_stretch[0]) & (raw.time <= rest_stretch[1])
        rest_values = raw.values[is_at_rest & ~np.isnan(raw.values)]
        if len(rest_values) >= MIN_SAMPLES_NOISE_UNKNOWN:
            level, error = average_level(rest_values, raw.values[~is_at_rest])
            zeroed = {**signals.zero_stretches, name: rest_stretch}
            signals = replace(signals.subtract_level(name, level, error), zero_stretches=zeroed)
            duration, stated = rest_stretch[1] - rest_stretch[0], stop - start
            findings.append(
                Finding.of("process.short_rest", name, duration=duration, stated=stated)
            )
    return signals, findings
