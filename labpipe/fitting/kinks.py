"""The kink of a loading curve: where its slope falls, as wires begin to slip on one another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.fitting.correlated import fit_linear
from labpipe.fitting.estimates import Estimate, Failure
from labpipe.fitting.segments import TwoSegments, fit_two_segments
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval

_END = 0.05
"""Share of the stretch next to its ends in which a kink is not one of the specimen."""


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
        return Failure("no_kink", _as_good(displacement, force, fit)) if _is_straight(fit) else fit
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


def _is_straight(failure: Failure) -> bool:
    return failure.code == "no_bend"


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
