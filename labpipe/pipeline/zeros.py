"""The level that a signal stands at while the machine rests: what its zero is taken from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labpipe.pipeline.bench import Bench, Signal
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Interval
from labpipe.records.quality import Severity
from labpipe.signal.rests_and_jumps import samples_at_rest
from labpipe.uncertainty.linear_fits import fit_linear
from labpipe.uncertainty.noise import long_run_variance, smooth_stretches

LEAST = 8
"""Samples below which a stretch alone says nothing of its level."""
FEWEST = 3
"""Samples that do where the rest of the record says what the noise is like."""
SHORT = 100
"""Samples of a stretch below which the rest of the record says what its noise is like."""


_QUARTER = 25
"""Samples of the stretches that a record of fewer than `SHORT` is cut into."""


def needed(beside: Floats) -> int:
    """Samples that a stretch to zero on must hold.

    Parameters
    ----------
    beside : shape (m,), the rest of the record

    Notes
    -----
    Beside a hundred more samples, three are enough: with 3 to 6 of them the intervals of
    `mean_level` and `end_level` hold 94 to 96 of 100 true values, in white noise and in noise that
    remembers ten samples. Beside 25 they hold as many in noise that remembers up to two samples,
    and 73 in noise that remembers ten, which so short a record cannot tell from its curve.
    """
    return FEWEST if _cut(beside) else LEAST


def mean_level(values: Floats, beside: Floats) -> tuple[float, float]:
    """Mean of a stretch, with its standard error.

    Parameters
    ----------
    values : shape (n,), the stretch, evenly sampled, without NaN
    beside : shape (m,), the rest of the record: a stretch of a few samples cannot tell how far its
        noise remembers
    """
    stretches = _stretches(values, beside)
    if stretches:
        fit = fit_linear(np.ones((len(values), 1)), values, beside=stretches)
        half = float(fit.half_widths[0])
        return float(fit.coefficients[0]), Interval(-half, half).standard_error
    blocks = _blocks(values)
    error = float(np.sqrt(long_run_variance(blocks, parameters=1) / len(blocks)))
    return float(values.mean()), error


def end_level(values: Floats, beside: Floats) -> tuple[float, float]:
    """First value of a straight line through a stretch, with its standard error.

    Parameters
    ----------
    values, beside : as for `mean_level`
    """
    blocks = _blocks(values)
    size = len(values) // len(blocks)
    middles = np.arange(len(blocks)) + 0.5 * (size - 1) / size  # in blocks from the first sample
    design = np.column_stack([np.ones(len(blocks)), middles])
    fit = fit_linear(design, blocks, beside=_stretches(values, beside))
    # As wide as the t-based interval: a stretch for a zero holds few samples.
    interval = Interval(-float(fit.half_widths[0]), float(fit.half_widths[0]))
    return float(fit.coefficients[0]), interval.standard_error


def line_zero(values: Floats, beside: Floats) -> tuple[float, float, int]:
    """Level where a machine stood before it moved, from a stretch in which it moves.

    Parameters
    ----------
    values, beside : as for `mean_level`; the stretch begins at its outer end

    Returns
    -------
    level, error : of the outer end. Where the stretch begins with a rest, the mean over that; of a
        rest of too few samples, what a line through the motion says of its begin
    rested : samples of that rest; 0 where the motion begins with the stretch, or before
    """
    rested = samples_at_rest(values)
    if rested >= needed(beside):
        return *mean_level(values[:rested], np.concatenate([values[rested:], beside])), rested
    moving = values[rested:] if len(values) - rested >= LEAST else values
    return *end_level(moving, beside), 0


def _stretches(values: Floats, beside: Floats) -> Sequence[Floats]:
    return _cut(beside) if len(values) < SHORT else ()


def _cut(beside: Floats) -> Sequence[Floats]:
    return smooth_stretches(beside, width=SHORT if len(beside) >= SHORT else _QUARTER)


def _blocks(values: Floats) -> Floats:
    """Averages over at most 1000 blocks: as good for a mean, and quick to correlate."""
    size = max(1, len(values) // 1000)
    means: Floats = values[: len(values) // size * size].reshape(-1, size).mean(axis=1)
    return means


def use_rest_there_is(bench: Bench, branches: tuple[Branch, ...]) -> None:
    """Take zeros again whose stretch reaches into the motion: from its part at rest.

    Parameters
    ----------
    bench : its zeroed signals are used and shifted; gets a note for each
    branches : of the motion, on the clock of the curve

    Notes
    -----
    What is known of a zero from a shorter stretch is in its standard error. A part at rest of
    fewer than `LEAST` samples says nothing: then the zero stays, to be doubted.
    """
    if not branches:
        return
    for name, (start, stop) in list(bench.zeroed.items()):
        signal = bench.raw[name]
        begins, ends = (
            _on_own_clock(bench, signal, at)
            for at in (branches[0].start_time, branches[-1].stop_time)
        )
        if start < begins < stop:
            _zero_again(bench, name, (start, begins), wanted=stop - start)
        elif start < ends < stop:
            _zero_again(bench, name, (ends, stop), wanted=stop - start)


def _on_own_clock(bench: Bench, signal: Signal, at: float) -> float:
    """Put a time of the curve on the clock of a signal."""
    fit = bench.other_clocks.get(signal.clock, bench.clock_fit)
    if fit is None or signal.clock == bench.signals[bench.displacement].clock:
        return at
    return fit.to_force_seconds(at)


def _zero_again(bench: Bench, name: str, rest: tuple[float, float], *, wanted: float) -> None:
    raw = bench.raw[name]
    inside = (raw.time >= rest[0]) & (raw.time <= rest[1])
    known = raw.values[inside & ~np.isnan(raw.values)]
    if len(known) < LEAST:
        return
    level, error = mean_level(known, raw.values[~inside])
    bench.taken_off[name] = bench.taken_off.get(name, 0.0) + level
    for signals in (bench.raw, bench.signals):
        old = signals[name]
        signals[name] = replace(old, values=old.values - level, zero_error=error)
    bench.zeroed[name] = rest
    lasts = rest[1] - rest[0]
    message = (
        f"the machine rests for {lasts:.2f} s, less than the {wanted:g} s to zero on: the zero is "
        f"the mean over these {lasts:.2f} s"
    )
    bench.note("short_rest", Severity.INFO, name, message)
