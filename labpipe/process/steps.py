"""Run the steps of a protocol on the signals of a test: zeros, filters, markers, travel.

A zero is the level of a signal at rest, with the standard error of that level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labpipe.errors import ProcessingError, format_overrides
from labpipe.messages import format_sentence
from labpipe.process.calibrated_signals import Prepared
from labpipe.process.motion import Motion, average_whole_blocks, orient_force
from labpipe.protocol.schema import Protocol, Rig
from labpipe.records import declarations
from labpipe.records.arrays import Floats
from labpipe.records.causes import SPEED, TURN
from labpipe.records.curve import Interval
from labpipe.records.quality import Finding
from labpipe.records.signals import Filter, Signal, Signals
from labpipe.signal.corners import Corner
from labpipe.signal.filters import (
    Butterworth,
    Smoothing,
    compute_window,
    filter_pieces,
    seconds_to_window,
)
from labpipe.signal.rests_and_jumps import count_rest_samples
from labpipe.signal.reversals import fit_reversal
from labpipe.signal.turning_points import find_sharpest_turn
from labpipe.uncertainty.autocorrelation import cut_smooth_stretches, estimate_long_run_variance
from labpipe.uncertainty.linear_fits import fit_linear

MIN_SAMPLES_NOISE_UNKNOWN = 8
"""Samples that a zero needs if the rest of the record is too short to show its noise."""
MIN_SAMPLES_NOISE_KNOWN = 3
"""Samples that a zero needs if the rest of the record shows its noise."""
SHORT_STRETCH = 100
"""Samples below which the noise of a stretch is taken from the rest of the record."""


def travel_from_speed(
    signals: Signals, step: declarations.TravelFromSpeed, rig: Rig
) -> tuple[Signals, list[Finding]]:
    """Run ``travel-from-speed``: compute the displacement on the clock of the force.

    Parameters
    ----------
    signals : with the force
    step : of the protocol
    rig : its crosshead speed and stroke

    Returns
    -------
    The signals with the channel; a note, and a doubt if the force contradicts speed and stroke.

    Raises
    ------
    ValueError
        If speed or stroke are not stated, or the force has no turn.

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
        up = np.clip(time - start - delay, 0.0, duration)
        down = np.clip(time - corner.time - delay, 0.0, duration)
        return np.asarray(speed * (up - down), dtype=np.float64)

    values = compute_travel(0.0)
    moved = {
        TURN: compute_travel(corner.time_error),
        SPEED: (1.0 + step.speed_uncertainty) * values,
    }
    signal = Signal(time, values, "m", force.clock, perturbed=moved)
    note = Finding.of(
        "process.displacement_from_speed",
        step.channel,
        speed=1e3 * speed,
        duration=duration,
        time=corner.time,
        error=1e3 * corner.time_error,
    )
    delay = float(force.time[0]) - start
    tolerance = 2.0 * float(np.hypot(corner.time_error, step.speed_uncertainty * duration))
    missed = Finding.of("process.start_missed", "force", "force", delay=delay, within=tolerance)
    return signals.add_signal(step.channel, signal), [note, missed] if delay > tolerance else [note]


def _find_turn(force: Signal, step: declarations.TravelFromSpeed) -> Corner:
    max_time_error = 0.5  # s
    if not force.has_time:
        raise ValueError(format_sentence("process.needs_times", channel=step.force, what="a speed"))
    turn_time, window = find_sharpest_turn(force.time, force.values, width=step.window), step.window
    reversal = None
    if turn_time is not None:
        part = slice(*np.searchsorted(force.time, [turn_time - window, turn_time + window]))
        inside = force.time[part], force.values[part]
        reversal = fit_reversal(*inside, near=turn_time, window=window)
    if reversal is None or not reversal.corner.time_error < max_time_error:
        raise ValueError(format_sentence("process.no_turn", channel=step.force))
    return reversal.corner


def run_steps(prepared: Prepared, protocol: Protocol) -> tuple[Prepared, list[Finding]]:
    """Run the steps of a protocol.

    Parameters
    ----------
    prepared : calibrated
    protocol : resolved

    Returns
    -------
    The signals after the steps, and the findings.

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
    prepared, step, protocol : as for `apply_step`

    Raises
    ------
    ProcessingError
        If the step cannot be run on the data.
    """
    try:
        return apply_step(prepared, step, protocol)
    except ValueError as error:
        text, *remedies = error.args
        remedy = remedies[0] if remedies else format_sentence("process.step_remedy")
        message = f"{step.key} ({step.step}): {text}. {remedy}"
        raise ProcessingError(message) from error


def apply_step(
    prepared: Prepared, step: declarations.Step, protocol: Protocol
) -> tuple[Prepared, list[Finding]]:
    """Run one step.

    Parameters
    ----------
    prepared : after the steps before
    step : of the protocol
    protocol : with markers and rig

    Returns
    -------
    The signals after the step, and the findings.

    Raises
    ------
    ValueError
        If the step cannot be run on the data: what is wrong, and a remedy if it has its own.
    """
    signals = prepared.signals
    match step:
        case declarations.TravelFromSpeed():
            signals, findings = travel_from_speed(signals, step, protocol.rig)
        case declarations.Zero():
            signals, findings = zero_signal(signals, step)
        case declarations.Smooth() | declarations.LowPass() | declarations.Decimate():
            signals, findings = _filter_signal(signals, step, protocol)
        case _:
            from labpipe.process.camera_steps import run_marker_step  # only these tests load it

            return run_marker_step(prepared, step, protocol.markers, protocol.specimen.span)
    return replace(prepared, signals=signals), findings


def zero_signal(signals: Signals, step: declarations.Zero) -> tuple[Signals, list[Finding]]:
    """Subtract the level of a signal at rest.

    Parameters
    ----------
    signals : by name
    step : with channel, stretch and method

    Raises
    ------
    ValueError
        If the stretch holds too few samples.
    """
    name = step.channel
    signal = signals.filtered[name]
    _require_time(signal, name, "a stretch in s")
    first, last = _find_zero_stretch(signal, step)
    duration = max(step.over, float(signal.time[last - 1] - signal.time[first]))
    start = float(signal.time[0] if step.at == "start" else signal.time[-1] - duration)
    rest = signal.values[first:last]
    finite = rest[~np.isnan(rest)]
    other_values = signal.values[last:] if step.at == "start" else signal.values[:first]
    if len(finite) < (min_samples := required_samples(other_values)):
        time_step = _median_step(signal)
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


def _find_zero_stretch(signal: Signal, step: declarations.Zero) -> tuple[int, int]:
    """Return first and last sample of a zero, at least `MIN_SAMPLES_NOISE_KNOWN` samples apart."""
    time = signal.time
    if step.at == "start":
        last = int(np.searchsorted(time, time[0] + step.over, side="right"))
        return 0, min(max(last, MIN_SAMPLES_NOISE_KNOWN), len(time))
    first = int(np.searchsorted(time, time[-1] - step.over))
    return max(min(first, len(time) - MIN_SAMPLES_NOISE_KNOWN), 0), len(time)


def _require_time(signal: Signal, name: str, what: str) -> None:
    """Refuse a setting in seconds or hertz if the export has no times."""
    if not signal.has_time:
        raise ValueError(format_sentence("process.needs_times", channel=name, what=what))


def _filter_signal(
    signals: Signals,
    step: declarations.Smooth | declarations.LowPass | declarations.Decimate,
    protocol: Protocol,
) -> tuple[Signals, list[Finding]]:
    """Filter a signal; `curve_corrections` repeats this for each branch once its ends are known."""
    name = step.channel
    signal, findings = signals.filtered[name], list[Finding]()
    filter_step: Filter
    match step:
        case declarations.Smooth():
            window = _window_samples(step.span, signal, protocol)
            length = f" ({window * _median_step(signal):.4g} s)" if signal.has_time else ""
            filter_step = Smoothing(window), 1
            findings = [Finding.of("process.smoothed", name, window=window, length=length)]
        case declarations.LowPass():
            _require_time(signal, name, "a cutoff in Hz")
            filter_step = Butterworth(step.cutoff, 1.0 / _median_step(signal), step.order), 1
        case declarations.Decimate():
            window = step.factor + 1 - step.factor % 2 if step.method == "filtered" else 1
            filter_step, factor = (Smoothing(window), step.factor), step.factor
            findings = [Finding.of("process.decimated", name, kept=factor, method=step.method)]
    signal = replace(signal, time=signal.time[:: filter_step[1]])
    signal = signal.map_values(lambda values: filter_pieces(values, (), [filter_step]))
    return signals.with_filtered(name, signal, filter_step), findings


def _median_step(signal: Signal) -> float:
    """Return the median step of the clock of a signal, s.

    `labpipe.records.arrays.median` takes thirty times as long as numpy's if few values differ.
    """
    return float(np.median(np.diff(signal.time)))


def _window_samples(span: declarations.Span, signal: Signal, protocol: Protocol) -> int:
    """Convert a span to samples; travel and branches by the speed of the rig."""
    count = len(signal.values)
    if span.kind == "samples":
        return compute_window(max(1.0, span.value), count)
    _require_time(signal, "smooth", f"a span of {span.kind}")
    if span.kind == "time":
        return seconds_to_window(span.value, signal.time)
    speed, stroke = protocol.rig.crosshead_speed, protocol.rig.stroke
    if speed is None or (span.kind == "branch" and stroke is None):
        raise ValueError(format_sentence("process.span_needs_rig", kind=span.kind))
    travel = span.value if span.kind == "travel" else span.value * (stroke or 0.0)
    return seconds_to_window(travel / speed, signal.time)


def required_samples(other_values: Floats) -> int:
    """Find how many samples a zero needs.

    Parameters
    ----------
    other_values : shape (m,), the rest of the record

    Notes
    -----
    Three samples suffice if the rest of the record has at least 100. With 3 to 6 samples, the 95 %
    intervals of `average_level` and `fit_end_level` then cover the true value in 94 to 96 % of
    cases, in white noise and in noise with a correlation length of ten samples. If the rest of the
    record has only 25 samples, the coverage is the same for a correlation length of two samples. It
    is 73 % for one of ten samples, because so short a record does not separate such noise from its
    curve.
    """
    return (
        MIN_SAMPLES_NOISE_KNOWN if _cut_noise_stretches(other_values) else MIN_SAMPLES_NOISE_UNKNOWN
    )


def average_level(values: Floats, other_values: Floats) -> tuple[float, float]:
    """Return the mean of a stretch and its standard error.

    Parameters
    ----------
    values : shape (n,), the stretch, evenly sampled, without NaN
    other_values : shape (m,), the rest of the record, for the correlation of the noise

    Returns
    -------
    Mean and its standard error, in the unit of `values`.
    """
    stretches = _noise_for_short_stretch(values, other_values)
    if stretches:
        fit = fit_linear(np.ones((len(values), 1)), values, beside=stretches)
        half = float(fit.half_widths[0])
        return float(fit.coefficients[0]), Interval(-half, half).standard_error
    blocks = average_whole_blocks(values, 1000)  # correlations are then quick
    error = float(np.sqrt(estimate_long_run_variance(blocks, parameters=1) / len(blocks)))
    return float(values.mean()), error


def fit_end_level(values: Floats, other_values: Floats) -> tuple[float, float]:
    """Fit a line to a stretch, and return its first value and the standard error of that value.

    Parameters
    ----------
    values, other_values : as for `average_level`
    """
    blocks = average_whole_blocks(values, 1000)  # correlations are then quick
    size = len(values) // len(blocks)
    middles = np.arange(len(blocks)) + 0.5 * (size - 1) / size  # in blocks from the first sample
    design = np.column_stack([np.ones(len(blocks)), middles])
    fit = fit_linear(design, blocks, beside=_noise_for_short_stretch(values, other_values))
    # As wide as the interval by Student's t, because a zero has few samples.
    interval = Interval(-float(fit.half_widths[0]), float(fit.half_widths[0]))
    return float(fit.coefficients[0]), interval.standard_error


def measure_moving_zero(values: Floats, other_values: Floats) -> tuple[float, float, int]:
    """Measure the level before a machine moved, from a stretch in which it moves.

    Parameters
    ----------
    values, other_values : as for `average_level`; the stretch begins at its outer end

    Returns
    -------
    level, error : of the outer end: the mean of a rest at the beginning of the stretch, or the
        first value of a line if the rest is too short
    rest_samples : number of samples in that rest; 0 if the level is from a line
    """
    rest_samples = count_rest_samples(values)
    if rest_samples >= required_samples(other_values):
        return *average_level(
            values[:rest_samples], np.concatenate([values[rest_samples:], other_values])
        ), rest_samples
    moving = (
        values[rest_samples:] if len(values) - rest_samples >= MIN_SAMPLES_NOISE_UNKNOWN else values
    )
    return *fit_end_level(moving, other_values), 0


def _noise_for_short_stretch(values: Floats, other_values: Floats) -> Sequence[Floats]:
    return _cut_noise_stretches(other_values) if len(values) < SHORT_STRETCH else ()


def _cut_noise_stretches(other_values: Floats) -> Sequence[Floats]:
    short_width = 25
    return cut_smooth_stretches(
        other_values, width=SHORT_STRETCH if len(other_values) >= SHORT_STRETCH else short_width
    )


def rezero_at_rest(signals: Signals, motion: Motion) -> tuple[Signals, list[Finding]]:
    """Recompute each zero whose stretch overlaps the motion, from the part at rest.

    Parameters
    ----------
    signals : zeroed
    motion : with clocks that are joined

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
        begins, ends = (
            motion.clocks.from_curve(end, raw.clock)
            for end in (branches[0].start_time, branches[-1].stop_time)
        )
        if start < begins < stop:
            rest_stretch = (start, begins)
        elif start < ends < stop:
            rest_stretch = (ends, stop)
        else:
            continue
        inside = (raw.time >= rest_stretch[0]) & (raw.time <= rest_stretch[1])
        rest_values = raw.values[inside & ~np.isnan(raw.values)]
        if len(rest_values) >= MIN_SAMPLES_NOISE_UNKNOWN:
            level, error = average_level(rest_values, raw.values[~inside])
            zeroed = {**signals.zero_stretches, name: rest_stretch}
            signals = replace(signals.subtract_level(name, level, error), zero_stretches=zeroed)
            duration, stated = rest_stretch[1] - rest_stretch[0], stop - start
            findings.append(
                Finding.of("process.short_rest", name, duration=duration, stated=stated)
            )
    return signals, findings
