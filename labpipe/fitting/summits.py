"""Height of a curve at its top or at its end, from the smooth stretch there and nothing beyond."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from labpipe.fitting.correlated import LinearFit, fit_linear
from labpipe.fitting.estimates import Estimate, scaled
from labpipe.fitting.medians import running_median
from labpipe.fitting.noise_spectra import cubic_basis, smooth_stretches
from labpipe.records.arrays import Floats, median
from labpipe.records.curve import Interval

LEAST = 12
"""Samples that a parabola needs."""
_BLOCKS = 400
"""Block means that kinks are looked for in."""
_SMOOTH = 6
"""Degree of a polynomial that a smooth top follows within the noise: what does better is a kink."""
_DEGREES = (2, 4, 6, 8)
"""Degrees that a top without kinks is fitted with."""
_NEAR = 8
"""Stretches before a top that say what its noise is like."""
_OWN = 200
"""Samples of a top from which on it tells its noise as well as others do."""
_ALIKE = 4.0
"""Times the variance of the top that such a stretch may have."""
_CLEAR = 4.0
"""Standard errors of a kink or a step that ends a smooth stretch."""
_REACH = 3.0
"""Blocks from the cut within which two sides must meet, or there is a step between them."""
_CLIFF = 6.0
"""Robust deviations of the steps that a cliff exceeds."""


@dataclass(frozen=True, slots=True)
class _Kink:
    """The clearest kink or step of a stretch: its first sample behind, and what meets there."""

    sample: int
    height: Estimate
    slope_before: float
    slope_behind: float
    is_corner: bool
    is_step: bool


def short_median(force: Floats) -> Floats:
    """Median of five neighbours; at the ends the last sample counts more than once."""
    return running_median(force, min(5, len(force)))


def height_at_end(d: Floats, f: Floats, *, step: float) -> Estimate:
    """Height where a curve ends: half a step beyond its last sample.

    Parameters
    ----------
    d, f : shape (n,), m, N; without NaN; up to the last sample before the loss
    step : m, to the next sample, somewhere in which the curve ended

    Returns
    -------
    N. A parabola through the last smooth stretch, of up to a fifth of the samples; the median of
    the last five at most where fewer than 12 samples are smooth.
    """
    first = max(len(d) - max(len(d) // 5, LEAST), 0)
    first = max(first, _bounds(f, len(f) - 1)[0])
    while len(d) - first >= LEAST:
        kink = _clearest_kink(d[first:], f[first:])
        if kink is None:
            smooth = _Smooth(d[first:], f[first:], _beside(f[:first], f[first:]))
            height, slope = smooth.carried(float(d[-1]) + 0.5 * step)
            return _blurred(height, slope * step)
        first += kink.sample
    return _median_height(f, max(first, len(f) - 5, _bounds(f, len(f) - 1)[0]), len(f))


def height_of_top(d: Floats, f: Floats, *, share: float, step: float) -> Estimate:
    """Height of the top of a curve.

    Parameters
    ----------
    d, f : shape (n,), m, N; without NaN; up to the last sample before the loss
    share : the top that is looked at: the stretch around the largest median of five in which this
        median stays above (1 - share) of it
    step : m, to the next sample, somewhere in which the curve ended

    Returns
    -------
    N. See `labpipe.fitting.failure.peak_before_failure`.
    """
    level = short_median(f)
    top = int(np.argmax(level))
    low, high = _bounds(f, top)
    below = np.flatnonzero(level < (1.0 - share) * level[top])
    first = max(low, int(below[below < top].max(initial=-1)) + 1)
    last = min(high, int(below[below > top].min(initial=len(f))))
    is_open = last == high
    step = float(d[high] - d[high - 1]) if high < len(f) else step
    while last - first >= LEAST:
        kink = _clearest_kink(d[first:last], f[first:last])
        if kink is None:
            beside = _beside(f[:first], f[first:last])
            smooth = _Smooth(d[first:last], f[first:last], beside)
            return _smooth_top(smooth, step if is_open else 0.0)
        cut = first + kink.sample
        if kink.is_step:
            first, last = (cut, last) if top >= cut else (first, cut)
            is_open = is_open or last == cut
            step = float(d[cut] - d[cut - 1]) if last == cut else step
        elif kink.slope_before > 0.0 >= kink.slope_behind:
            if kink.is_corner:
                return kink.height
            first, last, is_open = (cut + first) // 2, (cut + last) // 2 + 1, False
        elif kink.slope_behind > 0.0 and (kink.slope_before > 0.0 or top >= cut):
            first = cut
        else:
            last, is_open = cut, False
    return _median_height(f, max(low, top - 2), min(high, top + 3))


def _bounds(f: Floats, at: int) -> tuple[int, int]:
    """First sample, and the one behind the last, of the stretch around one without a cliff."""
    steps = np.diff(f)
    usual = median(steps)
    spread = 1.4826 * median(np.abs(steps - usual))
    least = _CLIFF * spread + 3.0 * abs(usual) + 1e-9 * float(np.ptp(f))
    cliffs = np.flatnonzero(np.abs(steps - usual) > least)
    low = int(cliffs[cliffs < at].max(initial=-1)) + 1
    return low, int(cliffs[cliffs >= at].min(initial=len(f) - 1)) + 1


def _clearest_kink(d: Floats, f: Floats) -> _Kink | None:
    """The kink that helps a parabola most, if it is there beyond doubt."""
    size = -(-len(d) // _BLOCKS)
    count = len(d) // size
    lost = len(d) - count * size
    x, y = (each[lost:].reshape(count, size).mean(axis=1) for each in (d, f))
    scale = float(np.ptp(x))
    if count < LEAST or scale <= 0.0:
        return None
    x = (x - x[0]) / scale
    places = np.arange(3, count - 3)
    offsets = x[:, None] - 0.5 * (x[places] + x[places - 1])
    basis = np.linalg.qr(np.vander(2.0 * x - 1.0, _SMOOTH + 1))[0]
    ramps, steps = (
        each - basis @ (basis.T @ each)
        for each in (np.maximum(offsets, 0.0), np.heaviside(offsets, 1.0))
    )
    powers = np.maximum(np.sum(ramps**2, axis=0), 1e-12)
    bends = (y @ ramps) ** 2 / powers
    steps -= ramps * (np.sum(ramps * steps, axis=0) / powers)
    jumps = (y @ steps) ** 2 / np.maximum(np.sum(steps**2, axis=0), 1e-12)
    both, one = int(np.argmax(bends + jumps)), int(np.argmax(bends))
    left = y - basis @ (basis.T @ y)
    noise = float(left @ left - bends[both] - jumps[both]) / (count - _SMOOTH - 3)
    # A step must do better than the best corner anywhere, not only than the one at its own place.
    is_better = bends[both] + jumps[both] - bends[one] > _CLEAR**2 * noise
    step = _step(x, y, int(places[both]), (lost, size)) if is_better else None
    return step or _corner(x, y, int(places[one]), (lost, size))


def _columns(x: Floats, place: int) -> list[Floats]:
    """Parabola, change of slope and step at a place."""
    z = x - 0.5 * (x[place] + x[place - 1])
    return [np.ones_like(z), z, z * z, np.maximum(z, 0.0), np.heaviside(z, 1.0)]


def _beyond_smooth(x: Floats, place: int, count: int) -> Floats:
    """Change of slope at a place, and step if two are asked for, beside a smooth polynomial."""
    z = 2.0 * (x - x[0]) / float(np.ptp(x)) - 1.0
    return np.column_stack([*_columns(x, place)[3 : 3 + count], np.vander(z, _SMOOTH + 1)])


def _step(x: Floats, y: Floats, place: int, blocks: tuple[int, int]) -> _Kink | None:
    """A step, if it is there beyond doubt and the two sides do not meet near it."""
    fit = fit_linear(np.column_stack(_columns(x, place)), y)
    slope, bend, jump = (float(fit.coefficients[each]) for each in (1, 3, 4))
    meets = abs(jump) <= _REACH * float(np.ptp(x)) / len(x) * abs(bend)
    if meets or not _is_clear(fit_linear(_beyond_smooth(x, place, 2), y), 1, y):
        return None
    sample = blocks[0] + place * blocks[1]
    return _Kink(sample, _meeting(fit, len(y) * blocks[1]), slope, slope + bend, False, True)


def _corner(x: Floats, y: Floats, place: int, blocks: tuple[int, int]) -> _Kink | None:
    """A change of slope, if it is there beyond doubt, and where the two sides meet."""
    columns = _columns(x, place)
    design = np.column_stack(columns[:4])
    fit = fit_linear(design, y)
    if not _is_clear(fit_linear(_beyond_smooth(x, place, 1), y), 0, y):
        return None
    left = y - design @ fit.coefficients
    basis = np.linalg.qr(np.vander(2.0 * x - 1.0, _SMOOTH + 1))[0]
    smooth = y - basis @ (basis.T @ y)
    slope, bend = (float(fit.coefficients[each]) for each in (1, 3))
    return _Kink(
        sample=blocks[0] + place * blocks[1],
        height=_meeting(fit_linear(np.column_stack(columns), y), len(y) * blocks[1]),
        slope_before=slope,
        slope_behind=slope + bend,
        is_corner=float(left @ left) < float(smooth @ smooth),
        is_step=False,
    )


def _is_clear(fit: LinearFit, number: int, y: Floats) -> bool:
    size, error = abs(fit.coefficients[number]), np.sqrt(fit.covariance[number, number])
    return bool(size > _CLEAR * error and size > 1e-9 * np.ptp(y))


def _meeting(fit: LinearFit, count: int) -> Estimate:
    """Height where two sides meet that may be a little left or right of where they were cut.

    With a jump h and a change of slope c at the cut they meet at -h / c, at a - b h / c.
    """
    a, b, _, c, h = (float(each) for each in fit.coefficients)
    if c == 0.0:
        return Estimate(a, 0.0, count)
    along = fit.along(np.array([1.0, -h / c, 0.0, b * h / c**2, -b / c]))
    value, half = a - b * h / c, fit.quantile * along.error
    return Estimate(value, along.error, count, Interval(value - half, value + half))


@dataclass(frozen=True, slots=True, eq=False)
class _Smooth:
    """A stretch without kinks, and stretches of the same curve that speak of its noise."""

    d: Floats
    f: Floats
    beside: Sequence[Floats]

    @property
    def length(self) -> float:
        return float(np.ptp(self.d)) or 1.0

    def around(self, at: float, degree: int) -> LinearFit:
        """A polynomial in the distance from a place, in lengths of the stretch."""
        powers = np.vander((self.d - at) / self.length, degree + 1, increasing=True)
        return fit_linear(powers, self.f, beside=self.beside)

    def carried(self, at: float, degree: int = 2) -> tuple[Estimate, float]:
        """Height and slope of a polynomial at a place."""
        fit = self.around(at, degree)
        return fit.estimate(0), float(fit.coefficients[1]) / self.length

    def degree(self) -> int:
        """Degree from which on two more terms say nothing: both within their 95 % intervals."""
        x = 2.0 * (self.d - self.d[0]) / self.length - 1.0
        for degree, more in pairwise(_DEGREES):
            if len(x) < LEAST * more:
                return degree
            terms = np.polynomial.legendre.legvander(x, more)
            fit = fit_linear(terms, self.f, beside=self.beside)
            if np.all(np.abs(fit.coefficients[-2:]) < fit.half_widths[-2:]):
                return degree
        return _DEGREES[-1]

    def is_flat(self) -> bool:
        """Whether slope and curvature are both within their 95 % intervals of zero."""
        x = (self.d - self.d.mean()) / self.length
        columns = np.column_stack([np.ones_like(x), x, x * x - np.mean(x * x)])
        fit = fit_linear(columns, self.f, beside=self.beside)
        return bool(np.all(np.abs(fit.coefficients[1:]) < fit.half_widths[1:]))

    def highest(self, end: float, degree: int) -> float:
        """Place of the largest value of a polynomial between the first sample and an end."""
        start = float(self.d[0])
        curve = np.polynomial.Polynomial.fit(self.d, self.f, degree)
        turns = curve.deriv().roots()
        inside = turns.real[(turns.imag == 0.0) & (turns.real > start) & (turns.real < end)]
        places = np.concatenate([[start, end], inside])
        return float(places[int(np.argmax(curve(places)))])

    def vertex(self, at: float, degree: int) -> Estimate:
        """Height of a turning point: the highest of noisy values is too high by what is taken off.

        A slope known to a standard error s moves the vertex of curvature c by s / c and lifts it
        by s^2 / (2 c) on average (Box, J. R. Stat. Soc. B 33 (1971) 171).
        """
        fit = self.around(at, degree)
        height = fit.estimate(0)
        bend = 4.0 * abs(float(fit.coefficients[2]))
        lift = min(float(fit.covariance[1, 1]) / bend if bend > 0.0 else np.inf, height.error)
        return scaled(_lowered(height, lift), more=lift)


def _beside(before: Floats, top: Floats) -> list[Floats]:
    """The last stretches before a short top that bend and scatter no more than it does."""
    if len(top) >= _OWN:
        return []
    most = _ALIKE * _about_cubic(top)
    return [each for each in smooth_stretches(before)[-_NEAR:] if _about_cubic(each) <= most]


def _about_cubic(values: Floats) -> float:
    """Variance of what is left of values about a cubic."""
    basis = cubic_basis(len(values))
    left = values - (basis @ values) @ basis
    return float(left @ left) / (len(values) - len(basis))


def _smooth_top(smooth: _Smooth, step: float) -> Estimate:
    """Largest value of a polynomial: at a turning point, or at an end; half a step beyond the last.

    The mean where the stretch is flat: the highest value would follow the noise.
    """
    if smooth.is_flat():
        return fit_linear(np.ones((len(smooth.f), 1)), smooth.f, beside=smooth.beside).estimate(0)
    end = float(smooth.d[-1]) + 0.5 * step
    degree = smooth.degree()
    at = smooth.highest(end, degree)
    if smooth.d[0] < at < end:
        return _vertex(smooth, end, degree + 2)
    height, slope = smooth.carried(at, degree)
    return height if at < end else _blurred(height, slope * step)


def _vertex(smooth: _Smooth, end: float, degree: int) -> Estimate:
    """The turning point by two degrees more: terms that the test cannot see still move it."""
    if len(smooth.d) < LEAST * degree:
        degree -= 2
    at = smooth.highest(end, degree)
    if smooth.d[0] < at < end:
        return smooth.vertex(at, degree)
    return smooth.carried(at, degree)[0]


def _lowered(estimate: Estimate, by: float) -> Estimate:
    interval = estimate.interval
    if interval is not None:
        interval = Interval(interval.lower - by, interval.upper - by)
    return replace(estimate, value=estimate.value - by, interval=interval)


def _median_height(f: Floats, first: int, last: int) -> Estimate:
    """Median of a few samples; how far they differ is in its interval, and so is the noise."""
    near = f[first:last]
    bends = np.diff(f, 2)
    noise = 1.4826 * float(np.median(np.abs(bends - np.median(bends)))) / np.sqrt(6.0)
    half = 3.5 * noise / np.sqrt(len(near)) + 0.5 * float(np.ptp(near))
    value = float(np.median(near))
    return Estimate(value, half / 1.96, len(near), Interval(value - half, value + half))


def _blurred(estimate: Estimate, width: float) -> Estimate:
    """The estimate of a number that may lie anywhere in a range of a width around it."""
    return scaled(estimate, more=width / np.sqrt(12.0))
