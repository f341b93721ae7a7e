"""Height of a curve at its top or at its end, from the smooth stretch there and nothing beyond."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.fitting.correlated import LinearFit, fit_linear, orthonormal
from labpipe.fitting.estimates import Estimate, scaled
from labpipe.fitting.medians import running_median
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval

LEAST = 12
"""Samples that a parabola needs."""
_BLOCKS = 400
"""Block means that kinks are looked for in."""
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
            height, slope = _carried(d[first:], f[first:], float(d[-1]) + 0.5 * step)
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
            return _parabola_top(d[first:last], f[first:last], step if is_open else 0.0)
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
    usual = float(np.median(steps))
    spread = 1.4826 * float(np.median(np.abs(steps - usual)))
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
    basis = np.linalg.qr(np.vander(x, 3))[0]
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
    noise = float(left @ left - bends[both] - jumps[both]) / (count - 5)
    # A step must do better than the best corner anywhere, not only than the one at its own place.
    is_better = bends[both] + jumps[both] - bends[one] > _CLEAR**2 * noise
    step = _step(x, y, int(places[both]), (lost, size)) if is_better else None
    return step or _corner(x, y, int(places[one]), (lost, size))


def _columns(x: Floats, place: int) -> list[Floats]:
    """Parabola, change of slope and step at a place."""
    z = x - 0.5 * (x[place] + x[place - 1])
    return [np.ones_like(z), z, z * z, np.maximum(z, 0.0), np.heaviside(z, 1.0)]


def _step(x: Floats, y: Floats, place: int, blocks: tuple[int, int]) -> _Kink | None:
    """A step, if it is there beyond doubt and the two sides do not meet near it."""
    fit = fit_linear(np.column_stack(_columns(x, place)), y)
    slope, bend, jump = (float(fit.coefficients[each]) for each in (1, 3, 4))
    meets = abs(jump) <= _REACH * float(np.ptp(x)) / len(x) * abs(bend)
    if meets or not _is_clear(fit, 4, y):
        return None
    sample = blocks[0] + place * blocks[1]
    return _Kink(sample, _meeting(fit, len(y) * blocks[1]), slope, slope + bend, False, True)


def _corner(x: Floats, y: Floats, place: int, blocks: tuple[int, int]) -> _Kink | None:
    """A change of slope, if it is there beyond doubt, and where the two sides meet."""
    columns = _columns(x, place)
    design = np.column_stack(columns[:4])
    fit = fit_linear(design, y)
    if not _is_clear(fit, 3, y):
        return None
    left = y - design @ fit.coefficients
    quartic = np.linalg.qr(np.vander(x, 5))[0]
    smooth = y - quartic @ (quartic.T @ y)
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


def _parabola_top(d: Floats, f: Floats, step: float) -> Estimate:
    """Vertex of a parabola, or its value at the end that is higher; half a step beyond the last.

    The mean where the parabola says nothing: the highest of its values would follow the noise.
    """
    if _is_flat(d, f):
        return fit_linear(np.ones((len(f), 1)), f).estimate(0)
    end = float(d[-1]) + 0.5 * step
    scale = float(np.ptp(d)) or 1.0
    basis, to_coefficients = orthonormal(np.vander((d - end) / scale, 3))
    curvature, slope, _ = (float(each) for each in to_coefficients @ (basis @ f))
    vertex = end - scale * slope / (2.0 * curvature) if curvature < 0.0 else end
    if d[0] < vertex < end:
        return _carried(d, f, vertex)[0]
    first = (float(d[0]) - end) / scale
    if (curvature * first + slope) * first > 0.0:
        return _carried(d, f, float(d[0]))[0]
    height, slope = _carried(d, f, end)
    return _blurred(height, slope * step)


def _is_flat(d: Floats, f: Floats) -> bool:
    """Whether slope and curvature are both within their 95 % intervals of zero."""
    x = (d - d.mean()) / (float(np.ptp(d)) or 1.0)
    fit = fit_linear(np.column_stack([np.ones_like(x), x, x * x - np.mean(x * x)]), f)
    return bool(np.all(np.abs(fit.coefficients[1:]) < fit.half_widths[1:]))


def _median_height(f: Floats, first: int, last: int) -> Estimate:
    """Median of a few samples; how far they differ is in its interval, and so is the noise."""
    near = f[first:last]
    bends = np.diff(f, 2)
    noise = 1.4826 * float(np.median(np.abs(bends - np.median(bends)))) / np.sqrt(6.0)
    half = 3.5 * noise / np.sqrt(len(near)) + 0.5 * float(np.ptp(near))
    value = float(np.median(near))
    return Estimate(value, half / 1.96, len(near), Interval(value - half, value + half))


def _carried(d: Floats, f: Floats, at: float) -> tuple[Estimate, float]:
    """Height and slope of a parabola at a place."""
    scale = float(np.ptp(d)) or 1.0
    x = (d - at) / scale
    fit = fit_linear(np.column_stack([np.ones_like(x), x, x * x]), f)
    return fit.estimate(0), float(fit.coefficients[1]) / scale


def _blurred(estimate: Estimate, width: float) -> Estimate:
    """The estimate of a number that may lie anywhere in a range of a width around it."""
    return scaled(estimate, more=width / np.sqrt(12.0))
