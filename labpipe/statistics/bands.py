"""Mean curves at common displacements, with pointwise and simultaneous 95 % bands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from labpipe.records.arrays import Floats
from labpipe.records.group import Band
from labpipe.records.quality import Reason
from labpipe.statistics.means import LEVEL, t_quantile

POINTS = 201
"""Displacements of a mean curve: 0.25 mm apart over 50 mm."""


@dataclass(frozen=True, slots=True, eq=False)
class CommonCurves:
    """Curves at the displacements they share.

    Parameters
    ----------
    displacement : shape (n,), m, increasing; empty where the curves share no range
    force : shape (curves, n), N, without NaN
    reason : ``empty_group``, ``no_data`` or ``no_overlap`` with the ranges; else None
    """

    displacement: Floats
    force: Floats
    reason: Reason | None = None


def common_curves(
    curves: Sequence[tuple[Floats, Floats]], names: Sequence[str] = (), points: int = POINTS
) -> CommonCurves:
    """Read curves at displacements where every one of them has data.

    Parameters
    ----------
    curves : displacement (m) and force (any unit) of each, both of shape (its own n,)
    names : one per curve, for messages
    points : evenly spaced displacements from the last beginning to the first end

    Returns
    -------
    Forces by linear interpolation between neighbours, never beyond the data of a curve. A NaN
    opens a gap from the datum before it to the one after; displacements in a gap of any curve are
    left out. A curve whose displacement steps back is put in order of displacement.
    """
    nothing = np.zeros(0), np.zeros((len(curves), 0))
    if not curves:
        return CommonCurves(*nothing, Reason("empty_group", "there is no curve to average"))
    called = list(names) or [f"curve {number}" for number in range(1, len(curves) + 1)]
    ordered = [_in_order(*curve) for curve in curves]
    spans = [_span(*curve) for curve in ordered]
    blank = [name for name, span in zip(called, spans, strict=True) if np.isnan(span[0])]
    if blank:
        message = f"no curve to average in {', '.join(blank)}"
        return CommonCurves(*nothing, Reason("no_data", message))
    start, stop = max(span[0] for span in spans), min(span[1] for span in spans)
    if stop <= start:
        return CommonCurves(*nothing, _no_overlap(called, spans))
    grid = np.linspace(start, stop, points)
    force = np.array([np.interp(grid, *curve) for curve in ordered])
    shared = ~np.isnan(force).any(axis=0)
    return CommonCurves(grid[shared], force[:, shared])


def _in_order(displacement: Floats, force: Floats) -> tuple[Floats, Floats]:
    """A curve in order of displacement; a point of unknown displacement is a gap in the force."""
    known = ~np.isnan(displacement)
    if not known.any():
        return np.zeros(0), np.zeros(0)
    number = np.arange(len(displacement), dtype=np.float64)
    at = np.interp(number, number[known], displacement[known])
    order = np.argsort(at, kind="stable")
    return at[order], np.where(known, force, np.nan)[order]


def _span(displacement: Floats, force: Floats) -> tuple[float, float]:
    known = np.flatnonzero(~np.isnan(force))
    if not len(known):
        return float("nan"), float("nan")
    return float(displacement[known[0]]), float(displacement[known[-1]])


def _no_overlap(names: Sequence[str], spans: Sequence[tuple[float, float]]) -> Reason:
    starts, stops = (np.array(ends) for ends in zip(*spans, strict=True))
    late, early = int(np.argmax(starts)), int(np.argmin(stops))
    return Reason(
        "no_overlap",
        f"no displacement that every curve has: {names[late]} begins at "
        f"{1e3 * starts[late]:.4g} mm, {names[early]} ends at {1e3 * stops[early]:.4g} mm",
    )


def mean_band(curves: CommonCurves, over: str = "samples") -> Band:
    """Mean of curves with a pointwise and a simultaneous 95 % band.

    Parameters
    ----------
    curves : independent curves at common displacements
    over : what one curve is: ``samples`` or ``spool means``

    Returns
    -------
    The pointwise band holds the true mean at any one displacement chosen beforehand in 95 % of
    groups; the simultaneous band holds the whole true mean curve in at least 95 %. One curve: no
    band, reason ``one_curve``. Two curves: no simultaneous band, reason ``two_curves``.

    Notes
    -----
    mean -+ c s / sqrt(n) at each displacement, s with n - 1. Pointwise c is the quantile of t.
    Simultaneous c: `simultaneous_quantile`.
    """
    n = len(curves.force)
    if curves.reason or not len(curves.displacement):
        reason = curves.reason or Reason(
            "no_overlap", "every displacement lies in a gap of some curve"
        )
        return _bare(np.zeros(0), np.zeros(0), n, over, reason)
    mean = curves.force.mean(axis=0)
    if n == 1:
        reason = Reason("one_curve", "a band needs the scatter of two curves, there is one")
        return _bare(curves.displacement, mean, n, over, reason)
    error = curves.force.std(axis=0, ddof=1) / np.sqrt(n)
    half, half_all = t_quantile(n - 1) * error, simultaneous_quantile(curves.force) * error
    why = f"no simultaneous band over two {over}, which may cross and then show no scatter at all"
    return Band(
        curves.displacement,
        mean,
        mean - half,
        mean + half,
        mean - half_all,
        mean + half_all,
        n,
        over,
        None if n > 2 else Reason("two_curves", why),
    )


def _bare(displacement: Floats, mean: Floats, n: int, over: str, reason: Reason) -> Band:
    nothing = np.full(len(displacement), np.nan)
    return Band(displacement, mean, nothing, nothing, nothing, nothing, n, over, reason)


def simultaneous_quantile(curves: Floats) -> float:
    """Multiple of the standard error that holds a whole mean curve with 95 %.

    Parameters
    ----------
    curves : shape (n, points), without NaN

    Returns
    -------
    Dimensionless, at least the quantile of t. NaN for fewer than three curves: two that cross
    have no scatter where they do, and no multiple of it holds anything.

    Notes
    -----
    The chance that |t| exceeds c anywhere along the curve is at most the chance that it does so at
    the first point and the expected number of times that it rises through c later:
    2 [P(t > c) + L / (2 pi) (1 + c^2 / v)^(-(v - 1) / 2)], v = n - 1 (Telschow and Schwartzman,
    J. Stat. Plan. Inference 216 (2022) 70, the Gaussian kinematic formula of t processes). L, how
    far the scatter turns along the curve, is measured as the length of the path of the residuals
    brought to unit norm (Taylor and Worsley, J. Am. Stat. Assoc. 102 (2007) 913), which is
    unbiased. The union bound over the points (Bonferroni) is taken where it is smaller, as with
    curves as rough as noise. Measured coverage: docs/explanations/statistics.md.
    """
    n, points = curves.shape
    if n < 3:
        return float("nan")
    free, outside = n - 1, 1.0 - LEVEL
    turning = _turning(curves - curves.mean(axis=0))

    def exceeding(c: float) -> float:
        rises: float = turning / (2.0 * np.pi) * (1.0 + c**2 / free) ** (-0.5 * (free - 1))
        return 2.0 * (float(special.stdtr(free, -c)) + rises) - outside

    bonferroni = t_quantile(free, outside / points)
    if exceeding(bonferroni) >= 0.0:
        return bonferroni
    return float(optimize.brentq(exceeding, 0.0, bonferroni, full_output=False))


def _turning(residuals: Floats) -> float:
    """Length of the path of residuals on the unit sphere, past points without scatter."""
    norm = np.linalg.norm(residuals, axis=0)
    size = np.abs(residuals).max(initial=0.0)
    unit = residuals[:, norm > 1e-12 * size] / norm[norm > 1e-12 * size]
    cosine = np.clip(np.sum(unit[:, 1:] * unit[:, :-1], axis=0), -1.0, 1.0)
    return float(np.sum(np.arccos(cosine)))
