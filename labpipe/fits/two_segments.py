"""Two straight segments that meet, and the kink of a loading curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate, Failure
from labpipe.uncertainty.linear_fits import LinearFit, fit_linear

_SIDE = 4
"""Samples on each side of the break at least."""
_LEAST = 16
_BEND_ERRORS = 4.0
"""Standard errors by which the slopes must differ: the break was chosen to make them differ most,
so that a straight line reaches two by chance far more often than once in twenty."""
_END = 0.05
"""Share of the stretch next to its ends in which a kink is not one of the specimen."""


@dataclass(frozen=True, slots=True, eq=False)
class TwoSegments:
    """Two lines that meet.

    Parameters
    ----------
    first, second : N/m, slopes before and behind the break
    break_point : m, with an interval that may be asymmetric
    level : N, force at the break
    squares : N^2, sum of squared residuals at the optimum
    start, stop : m, ends of the stretch
    """

    first: Estimate
    second: Estimate
    break_point: Estimate
    level: float
    squares: float
    start: float
    stop: float


def fit_two_segments(displacement: Floats, force: Floats) -> TwoSegments | Failure:
    """Continuous line of two straight segments, the global least-squares optimum.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; a stretch of a loading branch in order of time, evenly
        sampled; NaN in either are left out

    Returns
    -------
    Slopes, break point and their 95 % intervals, or a failure: ``too_few_samples`` (fewer than 16),
    ``not_increasing`` when the displacement does not grow over the stretch, ``no_bend`` when one
    straight line does as well, or the break point may be an end of the stretch.

    Notes
    -----
    Between two neighbouring samples the optimum is either the crossing of the two separate lines,
    when it lies there, or one of the two samples (Hudson, J. Am. Stat. Assoc. 61 (1966) 1097).
    Both have closed forms in cumulative sums, so the scan is O(n) after sorting by displacement.
    Slopes: intervals of the linearised model for correlated noise (`fit_linear`). Break point: all
    places whose sum of squares exceeds the optimum by no more than the square of the linearised
    half width in units of independent noise; this profile of the sum of squares may be asymmetric.
    At least four samples stand on each side.
    """
    scan = _scan(displacement, force)
    return scan if isinstance(scan, Failure) else _described(scan, scan.best())


def _scan(displacement: Floats, force: Floats) -> _Scan | Failure:
    known = ~np.isnan(displacement) & ~np.isnan(force)
    d, f = displacement[known], force[known]
    if len(d) < _LEAST:
        return Failure("too_few_samples", f"{len(d)} samples in the stretch, {_LEAST} are needed")
    if d[-1] <= d[0] or (np.arange(len(d)) - 0.5 * (len(d) - 1)) @ d <= 0.0:
        found = f"the displacement goes from {d[0]:.6g} m to {d[-1]:.6g} m"
        return Failure("not_increasing", found)
    order = np.argsort(d, kind="stable")
    return _Scan.of(d[order], f[order])


def _described(scan: _Scan, at: float) -> TwoSegments | Failure:
    hinge = fit_linear(scan.design(at)[:, :3], scan.y)
    first, second = float(hinge.coefficients[1]), float(hinge.coefficients[2])
    bend = hinge.along(np.array([0.0, -1.0, 1.0]))
    if abs(bend.value) <= _BEND_ERRORS * bend.error:
        return Failure(
            "no_bend",
            f"slopes {first:.6g} and {second:.6g} N/m differ by {abs(bend.value):.3g} N/m, "
            f"{_BEND_ERRORS} standard errors of {bend.error:.3g} N/m are needed",
        )
    whole = fit_linear(scan.design(at), scan.y)
    half, error = float(whole.half_widths[3]), float(np.sqrt(whole.covariance[3, 3]))
    interval = scan.places_within(at, half / float(whole.unit_errors[3]))
    if interval is None:
        ends = f"{scan.d[0]:.6g} to {scan.d[-1]:.6g} m"
        return Failure("no_bend", f"the break may be at an end of the stretch, {ends}")
    return TwoSegments(
        first=_centred(whole, 1, first),
        second=_centred(whole, 2, second),
        break_point=Estimate(scan.d_of(at), error / abs(bend.value), whole.n, interval),
        level=float(hinge.coefficients[0]),
        squares=hinge.residual_deviation**2 * (hinge.n - len(hinge.coefficients)),
        start=float(scan.d[0]),
        stop=float(scan.d[-1]),
    )


def _centred(fit: LinearFit, number: int, value: float) -> Estimate:
    """An estimate with the width of a coefficient of a fit around another value."""
    found, half = fit.estimate(number), float(fit.half_widths[number])
    return Estimate(value, found.error, fit.n, Interval(value - half, value + half))


@dataclass(frozen=True, slots=True, eq=False)
class _Scan:
    """Sums of squares of all two-segment lines through sorted samples, from cumulative sums.

    d, y : shape (n,), as measured; x : d centred and scaled; r : residuals of one straight line, so
    that the sums do not cancel; sums : shape (5, n + 1), running sums of 1, x, x^2, r, x r.
    """

    d: Floats
    y: Floats
    x: Floats
    r: Floats
    sums: Floats

    @classmethod
    def of(cls, d: Floats, y: Floats) -> _Scan:
        x = (d - 0.5 * (d[0] + d[-1])) * (2.0 / (d[-1] - d[0]))
        lever = x - x.mean()
        r = y - y.mean() - lever * ((lever @ y) / (lever @ lever))
        sums = np.zeros((5, len(x) + 1))
        np.cumsum([np.ones_like(x), x, x * x, r, x * r], axis=1, out=sums[:, 1:])
        return cls(d, y, x, r, sums)

    def d_of(self, x: float) -> float:
        """Displacement of a place, m."""
        return float(0.5 * (self.d[0] + self.d[-1]) + 0.5 * (self.d[-1] - self.d[0]) * x)

    def design(self, at: float) -> Floats:
        """Columns: level at the break, slope before, slope behind, jump at the break."""
        ahead = self.d - self.d_of(at)
        jump = (ahead >= 0.0).astype(np.float64)
        return np.column_stack(
            [np.ones_like(ahead), np.minimum(ahead, 0.0), np.maximum(ahead, 0.0), jump]
        )

    def squares_at(self, at: Floats) -> Floats:
        """Least sum of squares with the break held, shape of `at`."""
        below = self.sums[:, np.searchsorted(self.x, at, side="right")]
        total = self.sums[:, -1]
        n, sx, sxx, sr, sxr = total[:, None] - below
        # Sums with h = max(x - c, 0).
        sh, sxh, shr = sx - at * n, sxx - at * sx, sxr - at * sr
        shh = sxx - 2.0 * at * sx + at * at * n
        count, mx, mxx = total[0], total[1] / total[0], total[2] - total[1] ** 2 / total[0]
        # h without its line: r is without one already.
        cross = sxh - mx * sh
        left = shh - sh * sh / count - cross * cross / mxx
        gain = np.where(left > 1e-14 * count, shr * shr / np.where(left > 0.0, left, 1.0), 0.0)
        rest: Floats = float(self.r @ self.r) - gain
        return rest

    def crossings(self) -> Floats:
        """Where the separate lines before and behind each gap between samples meet inside it."""
        below = self.sums[:, _SIDE : len(self.x) - _SIDE + 1]
        first, second = _lines(below), _lines(self.sums[:, -1:] - below)
        with np.errstate(divide="ignore", invalid="ignore"):
            meet = (second[0] - first[0]) / (first[1] - second[1])
        low = self.x[_SIDE - 1 : len(self.x) - _SIDE]
        high = self.x[_SIDE : len(self.x) - _SIDE + 1]
        found: Floats = meet[(meet >= low) & (meet <= high)]
        return found

    def best(self) -> float:
        """Break of the global optimum."""
        inside = self.x[_SIDE - 1 : len(self.x) - _SIDE + 1]
        places = np.concatenate([inside, self.crossings()])
        return float(places[int(np.argmin(self.squares_at(places)))])

    def places_within(self, at: float, reach: float) -> Interval | None:
        """Ends of all breaks whose sum of squares exceeds the least by at most reach^2."""
        inside = self.x[_SIDE - 1 : len(self.x) - _SIDE + 1]
        least = float(self.squares_at(np.array([at]))[0])
        allowed = np.flatnonzero(self.squares_at(inside) - least <= reach * reach)
        ends = []
        for outermost, outwards in ((allowed[:1], -1), (allowed[-1:], 1)):
            near = float(inside[outermost[0]]) if len(outermost) else at
            near = min(near, at) if outwards < 0 else max(near, at)
            beyond = inside[inside < near][-1:] if outwards < 0 else inside[inside > near][:1]
            if len(beyond) == 0:
                return None
            ends.append(self._crossing(near, float(beyond[0]), least + reach * reach))
        return Interval(self.d_of(ends[0]), self.d_of(ends[1]))

    def _crossing(self, inner: float, outer: float, height: float) -> float:
        """Where the sum of squares passes a height between two places, to a millionth of them."""
        for _ in range(3):
            places = np.linspace(inner, outer, 101)
            over = np.flatnonzero(self.squares_at(places) >= height)
            if len(over) == 0 or over[0] == 0:
                return outer if len(over) == 0 else inner
            inner, outer = float(places[over[0] - 1]), float(places[over[0]])
        return 0.5 * (inner + outer)


def _lines(sums: Floats) -> tuple[Floats, Floats]:
    """Level and slope of the least-squares line of each column of sums."""
    n, sx, sxx, sr, sxr = sums
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (n * sxr - sx * sr) / (n * sxx - sx * sx)
        return (sr - slope * sx) / n, slope


@dataclass(frozen=True, slots=True, eq=False)
class Kink:
    """Where two straight lines meet, the second one less steep.

    Parameters
    ----------
    displacement, force : m, N, of the place where they meet
    first, second : N/m, slopes before and behind it
    start, stop : m, ends of the stretch
    """

    displacement: Estimate
    force: Estimate
    first: Estimate
    second: Estimate
    start: float
    stop: float


def fit_kink(displacement: Floats, force: Floats) -> Kink | Failure:
    """Kink of a stretch of a loading curve at which the slope falls.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; the stretch in order of time, evenly sampled; NaN in
        either are left out

    Returns
    -------
    The kink with 95 % intervals, or a failure: ``no_kink`` when one straight line does as well or
    the slope rises, ``kink_at_end`` when the two lines meet in the first or the last twentieth of
    the stretch, ``too_few_samples`` (fewer than 16), ``not_increasing``.

    Notes
    -----
    `fit_two_segments` finds the lines, the place and its interval. The force where they meet is a
    linear combination of the coefficients of the model linearised in that place, so that its
    interval holds what the place does not know. A kink is the elbow of two lines, not the first
    slip: a cantilever under an end load whose moment-curvature law has two straight pieces leaves
    its first line where the moment at the clamp reaches the knee of the law, and its asymptotes
    meet at 3/2 of that force (from double integration of the curvature; small slopes).

    Examples
    --------
    >>> d = np.linspace(0.0002, 0.005, 97)
    >>> kink = fit_kink(d, np.where(d < 0.002, 900.0, 300.0) * (d - 0.002) + 1.8)
    >>> round(1e3 * kink.displacement.value, 6), round(kink.force.value, 6)
    (2.0, 1.8)
    """
    fit = fit_two_segments(displacement, force)
    if isinstance(fit, Failure):
        if fit.code != "no_bend":
            return fit
        return Failure("no_kink", _as_good(displacement, force, fit))
    if fit.second.value >= fit.first.value:
        found = f"the slope rises from {fit.first.value:.5g} to {fit.second.value:.5g} N/m"
        return Failure("no_kink", f"{found} at {1e3 * fit.break_point.value:.4g} mm")
    margin = _END * (fit.stop - fit.start)
    if not fit.start + margin <= fit.break_point.value <= fit.stop - margin:
        return Failure(
            "kink_at_end",
            f"the slope falls at {1e3 * fit.break_point.value:.4g} mm, next to an end of the "
            f"stretch from {1e3 * fit.start:.4g} to {1e3 * fit.stop:.4g} mm",
        )
    level = _force_where_they_meet(displacement, force, fit)
    return Kink(fit.break_point, level, fit.first, fit.second, fit.start, fit.stop)


def _as_good(displacement: Floats, force: Floats, failure: Failure) -> str:
    """Why there is no kink, with what a straight line leaves over."""
    known = ~np.isnan(displacement) & ~np.isnan(force)
    d, f = displacement[known], force[known]
    left = f - np.polynomial.Polynomial.fit(d, f, 1)(d)
    deviation = float(np.sqrt(left @ left / (len(d) - 2)))
    return (
        f"one straight line does as well, to within {deviation:.3g} N from {1e3 * d.min():.4g} to "
        f"{1e3 * d.max():.4g} mm: {failure.message}"
    )


def _force_where_they_meet(displacement: Floats, force: Floats, fit: TwoSegments) -> Estimate:
    """Force at the kink; a kink moved along the first line moves its force by that slope."""
    known = ~np.isnan(displacement) & ~np.isnan(force)
    ahead, f = displacement[known] - fit.break_point.value, force[known]
    columns = [np.ones_like(ahead), np.minimum(ahead, 0.0), np.maximum(ahead, 0.0), ahead >= 0.0]
    first, fall = fit.first.value, fit.first.value - fit.second.value
    direction = np.array([1.0, 0.0, 0.0, first / fall])
    whole = fit_linear(np.column_stack(columns), f)
    error = whole.along(direction).error
    half = whole.quantile * error
    return Estimate(fit.level, error, whole.n, Interval(fit.level - half, fit.level + half))
