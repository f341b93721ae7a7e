"""A sudden drop of the load: where it begins and ends, how much is lost, and if it is noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.special import stdtr

from labpipe.records.arrays import Floats, median
from labpipe.records.curve import Interval
from labpipe.uncertainty.autocorrelation import cubic_basis, smooth_stretches
from labpipe.uncertainty.linear_fits import fit_linear

MAD = 1.4826
"""Standard deviation of normal noise over its median absolute deviation."""
MAD_SHARE = 0.37
"""Degrees of freedom of a median absolute deviation over those of a standard deviation."""
_SIDE = 8
"""Samples on each side of a drop at least."""
_STRETCH = 100
"""Samples of the stretches that the noise is judged by."""


@dataclass(frozen=True, slots=True)
class LoadDrop:
    """A sudden loss of force.

    Parameters
    ----------
    start, stop : last sample before it and first one after
    middle : of the likeliest drop, in samples; of all alike, where the data do not tell them apart
    drop, drop_interval : N
    earliest, latest : samples between which it may have been, by drops over whole samples
    slope_before, slope_behind : N/m
    slope_error : N/m, standard error of their difference
    """

    start: int
    stop: int
    middle: float
    drop: float
    drop_interval: Interval
    earliest: int
    latest: int
    slope_before: float
    slope_behind: float
    slope_error: float


@dataclass(frozen=True, slots=True, eq=False)
class PullCurve:
    """A curve that drops are looked for in.

    Parameters
    ----------
    d, f : shape (n,), m, N, samples or means of neighbours, without NaN, evenly spaced
    most : how many of them the longest drop takes
    blurred : 1 for means, which a drop may lie inside of; 0 for samples
    """

    d: Floats
    f: Floats
    most: int
    blurred: int

    def without(self, drops: Sequence[LoadDrop]) -> PullCurve:
        """The curve with drops added back; a straight line between start and stop of each."""
        f = self.f.copy()
        for drop in drops:
            f[drop.stop :] += drop.drop
            inside = np.arange(drop.start + 1, drop.stop)
            ends = [drop.start, drop.stop]
            f[inside] = np.interp(inside, ends, f[ends])
        return replace(self, f=f)


def fit_load_drop(pull: PullCurve, place: int) -> LoadDrop | None:
    """Fit a sudden loss of force near a place.

    Parameters
    ----------
    pull : the curve, other drops added back
    place : sample that it is looked for around

    Returns
    -------
    The drop; None where there is none that noise does not explain.

    Notes
    -----
    A polynomial with a step over a window around the place: 25 samples on each side and degree
    three; 15 and two, or 10 and one, where that fails. A longer window would have less noise but
    more of the curve's bends, which a step takes for its own: of a curvature that changes within
    the window it takes up to 4 % of the deviation (the trade between the two is that of jumps in
    regressions: Hahn, Todd and van der Klaauw, Econometrica 69 (2001) 201). The force falls evenly
    from any quarter of a sample on; all beginnings and lengths are tried in first-order
    autoregressive noise, whose correlation comes from the whole curve. Those whose whitened sum of
    squares exceeds the least by no more than 3.84 variances may be true: the samples that lie
    inside any of them have levels of their own, and the loss is the step by generalised least
    squares, its interval that of `fit_linear` with the rest of the curve beside it.

    Noise must not explain the drop with a chance of more than 1e-3 in a whole curve, shared by all
    places and lengths: neither as it is here (F-test of the sums of squares) nor as it is elsewhere
    (the same step fitted at all other places, by its robust deviation, whose degrees of freedom
    count how much these places share).
    """
    # Samples on each side of a slip, and the degree of the polynomial through both that bends less
    # than noise over that length; the longest is tried first.
    side_lengths = ((25, 3), (15, 2), (10, 1))
    factor = _correlation(pull.f)
    drops = (_fit_within(pull, place, side, factor) for side in side_lengths)
    return next((drop for drop in drops if drop is not None), None)


def _fit_within(
    pull: PullCurve, place: int, reach: tuple[int, int], factor: float
) -> LoadDrop | None:
    """Fit a polynomial and a drop with every pair of start and stop near a place."""
    # A possible drop exceeds the smallest sum of squares by at most this many variances: chi-
    # squared with one degree of freedom, 95 %.
    max_excess_variances = 3.84
    (side, degree), most = reach, pull.most
    low, high = max(0, place - most - side), min(len(pull.f), place + most + side + 1)
    if place - low < _SIDE or high - place < _SIDE + 1:
        return None
    window = _Window(low, high, degree, factor)
    drops = _possible(window, place, most)
    costs, variance, without = _costs(pull, window, drops)
    # A drop between two samples has the same cost wherever it is between them.
    best = drops[costs <= costs.min() + 1e-9 * variance].mean(axis=0)
    if best[1] > most:
        return None  # it would rather take longer than the longest slip
    allowed = drops[costs <= costs.min() + max_excess_variances * variance]
    whole = np.all(drops % 1.0 == 0.0, axis=1)
    around = drops[whole & (costs <= costs[whole].min() + max_excess_variances * variance)]
    explained = without - float(costs.min())
    if explained <= 0.0:
        return None  # a converter shows nothing but one of its steps
    if not _is_clear(pull, window, explained / variance if variance > 0.0 else np.inf):
        return None
    drop = _measured(pull, window, (best, allowed, around))
    return drop if drop is not None and _is_rare(pull, window, drop) else None


def _possible(window: _Window, place: int, most: int) -> Floats:
    """Beginnings and lengths of drops near a place, in samples: a drop begins between samples."""
    # Starts of drops are tried in steps of this many samples.
    start_step = 0.25
    first, last = max(window.low + 4, place - most), min(window.high - 5, place + most)
    begins = np.arange(first, last, start_step)
    lengths = np.append(np.arange(start_step, 2.0, start_step), np.arange(2.0, most + 2.0))
    drops = np.array(np.meshgrid(begins, lengths)).reshape(2, -1).T
    near: Floats = drops[drops.sum(axis=1) <= window.high - 5]
    return near


@dataclass(frozen=True, slots=True)
class _Window:
    """Samples from `low` to before `high`, polynomial and lag-one correlation for them."""

    low: int
    high: int
    degree: int
    factor: float

    @property
    def freedom(self) -> int:
        return max(self.high - self.low - self.degree - 4, 1)


def _chance(pull: PullCurve) -> float:
    """Chance that noise may have to make a drop at one place."""
    # For a whole curve, shared by all places and lengths.
    false_alarm_rate = 1e-3
    return false_alarm_rate / (len(pull.f) * (pull.most + 1))


def _is_clear(pull: PullCurve, window: _Window, squared: float) -> bool:
    """Whether noise as it is here, with what the polynomial misses, does not explain a drop.

    The F-test of the whitened sums of squares.
    """
    t = float(np.sqrt(max(squared, 0.0)))
    return bool(stdtr(window.freedom, -t) <= _chance(pull))


def _is_rare(pull: PullCurve, window: _Window, drop: LoadDrop) -> bool:
    """Whether noise as it is elsewhere, of whatever correlation, does not explain a drop.

    The same step is fitted at every other place; its robust deviation is the yardstick.
    """
    kernel = _step_kernel(window, drop)
    here = -float(kernel @ pull.f[window.low : window.high])
    elsewhere = np.convolve(pull.without([drop]).f, kernel[::-1], mode="valid")
    spread = max(MAD * median(np.abs(elsewhere)), 1e-9 * float(np.ptp(pull.f)))
    freedom = int(MAD_SHARE * len(elsewhere) / _shared(kernel, window.factor))
    return bool(stdtr(max(freedom, 1), -here / spread) <= _chance(pull))


def _step_kernel(window: _Window, drop: LoadDrop) -> Floats:
    """Weights of the samples of a window in its generalised least-squares step."""
    rows = np.arange(window.low, window.high)
    ramp = np.clip((rows - drop.start) / (drop.stop - drop.start), 0.0, 1.0)
    design = np.column_stack([*_powers(rows.astype(np.float64), window.degree), ramp])
    weights = np.linalg.pinv(design[1:] - window.factor * design[:-1])[-1]
    kernel: Floats = np.append(0.0, weights) - window.factor * np.append(weights, 0.0)
    return kernel


def _powers(x: Floats, degree: int) -> list[Floats]:
    scaled = (x - x.mean()) / (float(np.ptp(x)) or 1.0)
    return [scaled**power for power in range(degree + 1)]


def _shared(kernel: Floats, factor: float) -> float:
    """Neighbouring places that together say as much of a variance as one.

    The sum of squared correlations of what a kernel makes of autoregressive noise.
    """
    lags = np.abs(np.arange(1 - len(kernel), len(kernel)))
    alike = np.convolve(np.correlate(kernel, kernel, mode="full"), factor**lags, mode="same")
    return float(np.sum((alike / alike.max()) ** 2))


def _correlation(f: Floats) -> float:
    """Lag-one correlation of the noise: median over windows, of residuals about cubics."""
    width = min(_STRETCH, len(f))
    basis = cubic_basis(width).T
    starts = range(0, len(f) - width + 1, max(width // 4, 1))
    pieces = np.array([f[start : start + width] for start in starts])
    left = pieces - (pieces @ basis) @ basis.T
    power = np.maximum(np.sum(left**2, axis=1), np.finfo(float).tiny)
    seen = float(np.median(np.sum(left[:, 1:] * left[:, :-1], axis=1) / power))
    factors, expected = _seen_correlations(width)
    return float(np.interp(seen, expected, factors))


@cache
def _seen_correlations(width: int) -> tuple[Floats, Floats]:
    """Lag-one correlations of noise, and what residuals about a cubic show of each.

    Residuals of a fit know less of each other than the noise does: Kendall, Biometrika 41 (1954).
    """
    factors = np.array([*np.linspace(0.0, 0.9, 10), 0.94, 0.97, 0.985])
    basis = cubic_basis(width).T
    lags = np.abs(np.subtract.outer(np.arange(width), np.arange(width)))
    expected = []
    for factor in factors:
        noise = factor**lags
        half = noise - basis @ (basis.T @ noise)
        left = half - (half @ basis) @ basis.T
        expected.append(float(np.trace(left, offset=1) / np.trace(left)))
    return factors, np.array(expected)


def _costs(pull: PullCurve, window: _Window, drops: Floats) -> tuple[Floats, float, float]:
    """Whitened sum of squares of each drop, the variance of one term, and the sum with no drop.

    The force falls evenly.
    """
    rows = np.arange(window.low, window.high)
    f, factor = pull.f[rows], window.factor
    ramps = np.clip((rows[:, None] - drops[:, 0]) / drops[:, 1], 0.0, 1.0)
    lines = np.column_stack(_powers(pull.d[rows], window.degree))
    base, ramps, target = (line[1:] - factor * line[:-1] for line in (lines, ramps, f - f[0]))
    base = np.linalg.qr(base)[0]
    ramps, target = ramps - base @ (base.T @ ramps), target - base @ (base.T @ target)
    power = np.maximum(np.sum(ramps**2, axis=0), 1e-12)
    without = float(target @ target)
    squares: Floats = without - np.minimum(target @ ramps, 0.0) ** 2 / power
    return squares, float(squares.min()) / window.freedom, without


def _measured(
    pull: PullCurve, window: _Window, drops: tuple[Floats, Floats, Floats]
) -> LoadDrop | None:
    (best, allowed, around), blurred = drops, pull.blurred
    start, stop = int(np.floor(best[0])), int(np.ceil(best.sum()))
    first = int(np.floor(allowed[:, 0].min())) + 1 - blurred
    last = int(np.ceil(allowed.sum(axis=1).max())) + blurred
    if min(first - 1 - window.low, window.high - last) < 4:
        return None
    rows = np.arange(window.low, window.high)
    after = (rows >= stop).astype(np.float64)
    d, f = pull.d, pull.f[rows]
    x = d[rows] - 0.5 * (d[start] + d[stop])
    x = x / (float(np.ptp(x)) or 1.0)
    powers = [x**power for power in range(window.degree + 1)]
    # A sample that may be inside has a level of its own: it would make the loss too small.
    inside = np.eye(len(rows))[:, first - window.low : last - window.low]
    design = np.column_stack([after, *powers, inside])
    drop = fit_linear(design, f, weighted=True, beside=_beside(pull, window)).estimate(0)
    if drop.interval is None or drop.interval.upper >= 0.0:
        return None
    around_it = slice(max(first - 1, window.low), last + 1)
    if float(np.diff(pull.f[around_it]).min(initial=0.0)) >= 0.0:
        return None  # the force rises at every sample: its slope changes, nothing falls
    both = fit_linear(np.column_stack([np.ones(len(rows)), x, after, x * after, inside]), f)
    before, change = float(both.coefficients[1]), float(both.coefficients[3])
    return LoadDrop(
        start=start,
        stop=stop,
        middle=float(best[0] + 0.5 * best[1]),
        drop=-drop.value,
        drop_interval=Interval(-drop.interval.upper, -drop.interval.lower),
        earliest=int(around[:, 0].min()),
        latest=int(around.sum(axis=1).max()),
        slope_before=before,
        slope_behind=before + change,
        slope_error=float(np.sqrt(both.covariance[3, 3])),
    )


def _beside(pull: PullCurve, window: _Window) -> list[Floats]:
    """Stretches of the curve outside a window, which say what the noise is like."""
    before, behind = pull.f[: window.low], pull.f[window.high :]
    return [
        smooth_stretch
        for part in (before, behind)
        for smooth_stretch in smooth_stretches(part, width=_STRETCH)
    ]
