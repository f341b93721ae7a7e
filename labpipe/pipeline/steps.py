"""The steps of a protocol: one case each, from the words of the YAML to the pure function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import assert_never

import numpy as np

from labpipe.errors import ProcessingError
from labpipe.pipeline.bench import Bench, MarkerBench, Signal
from labpipe.pipeline.zeros import FEWEST, LEAST, line_zero, mean_level, needed
from labpipe.protocol.overrides import in_test_sheet
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats, median
from labpipe.records.declarations import Span
from labpipe.records.quality import Severity
from labpipe.records.step_settings import (
    Decimate,
    FitShape,
    LowPass,
    RepairMarkers,
    Smooth,
    SpecimenFrame,
    Step,
    ThreePointShape,
    TravelFromSpeed,
    Zero,
)
from labpipe.signal.filters import (
    in_pieces,
    low_pass,
    seconds_to_window,
    smoothed,
    window_length,
)


class ShortStretchError(ValueError):
    """A stretch to zero on holds too few samples.

    Parameters
    ----------
    message : for people
    needed : s, how long it would have to be
    """

    def __init__(self, message: str, needed: float) -> None:
        super().__init__(message)
        self.needed = needed


def step_or_refuse(bench: Bench, markers: MarkerBench, step: Step, protocol: Protocol) -> None:
    """Carry out one step, or say why not, with its key and what to do.

    Parameters
    ----------
    bench, markers, step, protocol : as for `take_step`

    Raises
    ------
    ProcessingError
        If the data cannot go through the step.
    """
    try:
        take_step(bench, markers, step, protocol)
    except ValueError as error:
        remedy = "Look at the exports with `labpipe inspect`, and at this step of the protocol."
        if isinstance(error, ShortStretchError):
            remedy = f"Write {in_test_sheet(f'{step.key}.over', f'{error.needed:.2g} s')}."
        message = f"{step.key} ({step.step}): {error}. {remedy}"
        raise ProcessingError(message) from error


def take_step(bench: Bench, markers: MarkerBench, step: Step, protocol: Protocol) -> None:
    """Carry out one step and note what it did.

    Parameters
    ----------
    bench : gets the new signals and notes
    markers : gets repaired tracks, frame and shape
    step : of the protocol
    protocol : for what steps share: markers, rig

    Raises
    ------
    ValueError
        If the data cannot go through the step.
    """
    match step:
        case RepairMarkers() | SpecimenFrame() | FitShape():
            _take_marker_step(bench, markers, step, protocol)
        case ThreePointShape():
            from labpipe.pipeline.three_point import bend_between_supports  # for these tests alone

            bend_between_supports(bench, markers, step, protocol)
        case TravelFromSpeed():
            from labpipe.pipeline.travel_from_speed import travel_from_speed

            travel_from_speed(bench, step, protocol.rig)
        case Zero():
            _zero(bench, step)
        case Smooth():
            _smooth(bench, step, protocol)
        case LowPass():
            signal = bench.signals[step.channel]
            _need_time(signal, step.channel, "a cutoff in Hz")
            rate = 1.0 / median(np.diff(signal.time))
            _filter(
                bench,
                step.channel,
                partial(low_pass, cutoff=step.cutoff, rate=rate, order=step.order),
            )
        case Decimate():
            _decimate(bench, step)
        case _ as never:
            assert_never(never)


def _take_marker_step(
    bench: Bench,
    markers: MarkerBench,
    step: RepairMarkers | SpecimenFrame | FitShape,
    protocol: Protocol,
) -> None:
    # A test on a load frame alone does not load what takes markers to a shape.
    from labpipe.pipeline.marker_steps import fit_shapes, repair, turn_into_specimen

    match step:
        case RepairMarkers():
            repair(bench, markers, step, protocol.markers)
        case SpecimenFrame():
            turn_into_specimen(bench, markers, step, protocol.markers)
        case FitShape():
            fit_shapes(bench, markers, step, protocol.markers)


def _zero(bench: Bench, step: Zero) -> None:
    signal = bench.signals[step.channel]
    _need_time(signal, step.channel, "a stretch in s")
    first, last = _stretch(signal, step)
    over = max(step.over, float(signal.time[last - 1] - signal.time[first]))
    start = float(signal.time[0] if step.at == "start" else signal.time[-1] - over)
    rest = signal.values[first:last]
    known = rest[~np.isnan(rest)]
    beside = signal.values[last:] if step.at == "start" else signal.values[:first]
    least = needed(beside)
    if len(known) < least:
        apart = median(np.diff(signal.time))
        message = (
            f"{step.channel}: {len(known)} samples in the {over:.4g} s to zero on, {least} are "
            f"needed, and there are {1.0 / apart:.4g} per second"
        )
        raise ShortStretchError(message, (least + 0.5) * apart)
    if step.by == "mean":
        bench.zeroed[step.channel] = (start, start + over)
        level, error = mean_level(known, beside)
        how = f"the mean over {over:.4g} s"
    else:
        bench.lined[step.channel] = (start, start + over)
        values = known if step.at == "start" else known[::-1]
        level, error, rested = line_zero(values, beside)
        lasts = over * rested / len(values)
        how = f"the outer end of a line over {over:.4g} s"
        how = f"the mean over the {lasts:.3g} s before the motion" if rested else how
    bench.taken_off[step.channel] = bench.taken_off.get(step.channel, 0.0) + level
    zeroed = replace(signal, values=signal.values - level, zero_error=error)
    raw = bench.raw[step.channel]
    bench.raw[step.channel] = (
        zeroed if raw is signal else replace(raw, values=raw.values - level, zero_error=error)
    )
    bench.signals[step.channel] = zeroed
    said = f"zero at {round(level, 12):.6g} {signal.unit}, {how} at the {step.at}"
    if len(known) < LEAST:
        said += f", {len(known)} samples: their noise is judged by the rest of the record"
    bench.note("zeroed", Severity.INFO, step.channel, said)


def _stretch(signal: Signal, step: Zero) -> tuple[int, int]:
    """Samples to zero on, from the first to behind the last: `FEWEST` at least.

    A stretch that suits a quick recorder holds two samples of a slow one.
    """
    time = signal.time
    if step.at == "start":
        last = int(np.searchsorted(time, time[0] + step.over, side="right"))
        return 0, min(max(last, FEWEST), len(time))
    first = int(np.searchsorted(time, time[-1] - step.over))
    return max(min(first, len(time) - FEWEST), 0), len(time)


def _need_time(signal: Signal, name: str, what: str) -> None:
    """Refuse a length in seconds where the export has rows but no time."""
    if not signal.has_time:
        message = f"{name}: {what} needs times, and the export has none"
        raise ValueError(message)


def _smooth(bench: Bench, step: Smooth, protocol: Protocol) -> None:
    signal = bench.signals[step.channel]
    window = _window(step.span, signal, protocol)
    _filter(bench, step.channel, partial(smoothed, window=window))
    seconds = window * median(np.diff(signal.time))
    length = f" ({seconds:.4g} s)" if signal.has_time else ""
    said = f"moving average over {window} samples{length}"
    bench.note("smoothed", Severity.INFO, step.channel, said)


def _filter(bench: Bench, name: str, act: Callable[[Floats], Floats], stride: int = 1) -> None:
    """Filter a signal, and write down how, to do it anew piece by piece once corners are known."""
    signal, made = bench.signals[name], (act, stride)
    other = signal.alternative
    bench.filters[name] = (*bench.filters.get(name, ()), made)
    bench.signals[name] = replace(
        signal,
        time=signal.time[::stride],
        values=in_pieces(signal.values, (), [made]),
        alternative=None if other is None else other[::stride],
    )


def _window(span: Span, signal: Signal, protocol: Protocol) -> int:
    """Samples of a span; travel and branches are turned into seconds by the rig's speed."""
    count = len(signal.values)
    if span.kind == "samples":
        return window_length(max(1.0, span.value), count)
    _need_time(signal, "smooth", f"a span of {span.kind}")
    if span.kind == "time":
        return seconds_to_window(span.value, signal.time)
    speed, stroke = protocol.rig.crosshead_speed, protocol.rig.stroke
    if speed is None or (span.kind == "branch" and stroke is None):
        message = f"span: a span of {span.kind} needs rig.crosshead_speed and rig.stroke"
        raise ValueError(message)
    travel = span.value if span.kind == "travel" else span.value * (stroke or 0.0)
    return seconds_to_window(travel / speed, signal.time)


def _decimate(bench: Bench, step: Decimate) -> None:
    window = step.factor + 1 - step.factor % 2 if step.method == "filtered" else 1
    _filter(bench, step.channel, partial(smoothed, window=window), step.factor)
    said = f"every {step.factor}th sample kept ({step.method})"
    bench.note("decimated", Severity.INFO, step.channel, said)
