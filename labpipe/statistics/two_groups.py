"""Comparison of two groups: their difference, and whether it matters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from labpipe.records.curve import Interval
from labpipe.records.group import Difference, MeanInterval, NestedMean
from labpipe.statistics.means import LEVEL, t_quantile
from labpipe.statistics.shared_causes import difference_of, standard_uncertainty, widened_by

_FARTHEST = 8.0
"""Standard deviations beyond which a chance, 1e-15, counts as none."""


def difference_of_means(first: MeanInterval, second: MeanInterval) -> MeanInterval:
    """Second mean minus first with its 95 % interval.

    Parameters
    ----------
    first, second : over independent values; their deviations need not be equal

    Returns
    -------
    n counts the values of both; deviation is NaN, since two scatters stand behind it. No interval
    where one of the means has none, with its reason. The interval lies about the difference of the
    estimates. What all tests of a rig share acts on both means alike: what it changes in their
    difference is in the interval.

    Notes
    -----
    Welch, Biometrika 34 (1947) 28: standard error^2 = s1^2/n1 + s2^2/n2, degrees of freedom after
    Satterthwaite.
    """
    found, n = second.mean - first.mean, first.n + second.n
    common = difference_of(first.common, second.common)
    reason = first.reason or second.reason
    if reason:
        return MeanInterval(found, None, np.nan, n, reason, common=common)
    half, middle = _welch(first, second).half, second.middle - first.middle
    interval = widened_by(Interval(middle - half, middle + half), common)
    estimate = None if middle == found else middle
    return MeanInterval(found, interval, np.nan, n, estimate=estimate, common=common)


@dataclass(frozen=True, slots=True)
class _Welch:
    """Standard error of a difference, and its degrees of freedom."""

    error: float
    degrees: float

    @property
    def half(self) -> float:
        """Half the width of the 95 % interval; zero where nothing scatters."""
        return t_quantile(self.degrees) * self.error if self.error > 0 else 0.0


def _welch(first: MeanInterval, second: MeanInterval) -> _Welch:
    one, two = first.deviation**2 / first.n, second.deviation**2 / second.n
    spread = one**2 / (first.n - 1) + two**2 / (second.n - 1)
    degrees = (one + two) ** 2 / spread if spread > 0 else float(first.n + second.n - 2)
    return _Welch(float(np.sqrt(one + two)), degrees)


def equivalence_p(first: MeanInterval, second: MeanInterval, margin: float) -> float:
    """p-value of the two one-sided tests that two means differ by less than a margin.

    Parameters
    ----------
    first, second : as in `difference_of_means`
    margin : above 0, in the unit of the means

    Returns
    -------
    The larger of the two p-values; below 0.05 the groups are equivalent, which is when the 90 %
    interval of the difference lies within the margin. NaN where there is no interval.

    Notes
    -----
    Schuirmann, J. Pharmacokinetics and Biopharmaceutics 15 (1987) 657, with Welch's degrees of
    freedom. What all tests share is added as in the interval: p is where the quantiles of scatter
    and of common causes reach the margin in quadrature.
    """
    if first.reason or second.reason:
        return float("nan")
    spread = _welch(first, second)
    shared = standard_uncertainty(difference_of(first.common, second.common))
    room = margin - abs(second.middle - first.middle)
    p = _tail(abs(room), spread, shared)
    return p if room > 0 else 1.0 - p


def _tail(room: float, spread: _Welch, shared: float) -> float:
    """Chance that scatter and a normal doubt together go beyond some room on one side."""
    if shared == 0.0:
        return float(special.stdtr(spread.degrees, -room / spread.error)) if spread.error else 0.0

    def beyond(sigmas: float) -> float:
        quantile = special.stdtrit(spread.degrees, float(special.ndtr(-sigmas)))
        of_scatter = quantile * spread.error
        return float(np.hypot(of_scatter, sigmas * shared)) - room

    if beyond(_FARTHEST) <= 0.0:
        return 0.0
    return float(special.ndtr(-optimize.brentq(beyond, 0.0, _FARTHEST)))


def compare(
    name: str,
    unit: str,
    first: tuple[str, NestedMean],
    second: tuple[str, NestedMean],
    margin: float | None = None,
) -> Difference:
    """How two groups differ in one result.

    Parameters
    ----------
    name, unit : of the result
    first, second : name of the group and its mean; the chosen means are compared, over spool means
        where spools were not pooled
    margin : difference that does not matter in practice, above 0, in `unit`

    Returns
    -------
    The verdict is ``different`` when the 95 % interval of the difference leaves zero out,
    ``equivalent`` when the two one-sided tests find it within the margin at 5 %, both when the
    difference is real and small, and ``cannot tell`` when neither.
    """
    one, two = first[1].chosen, second[1].chosen
    found = difference_of_means(one, two)
    p = float("nan") if margin is None else equivalence_p(one, two, margin)
    verdict = _verdict(found, margin, p, share=_relative(margin, one.mean))
    caveats = (*_caveats([first, second]), *_shared(found))
    return Difference(name, unit, first[0], second[0], found, margin, p, verdict, caveats)


def _relative(margin: float | None, mean: float) -> str:
    """A margin in words: as a share of the first mean, which needs no unit."""
    if margin is None or mean == 0 or np.isnan(mean):
        return "the margin"
    return f"the margin ({100 * margin / abs(mean):.3g} % of the first mean)"


def _verdict(found: MeanInterval, margin: float | None, p: float, *, share: str) -> str:
    if found.interval is None:
        why = found.reason.message if found.reason else "there is no interval"
        return f"cannot tell: {why}"
    differs = not found.interval.lower <= 0.0 <= found.interval.upper
    if p < 1.0 - LEVEL:
        real = "different, but " if differs else ""
        return f"{real}equivalent within {share}: p = {p:.2g} in the two one-sided tests"
    if differs:
        return "different: the 95 % interval of the difference leaves zero out"
    said = (
        "no margin is stated"
        if margin is None
        else f"and it is not shown to lie within {share}: p = {p:.2g} in the two one-sided tests"
    )
    return f"cannot tell: the 95 % interval of the difference holds zero, {said}"


def _shared(found: MeanInterval) -> tuple[str, ...]:
    """Which causes act on both groups alike."""
    causes = ", ".join(each.cause for each in found.common)
    said = f"both groups share {causes}: the interval holds what that changes in their difference"
    return (said,) if causes else ()


def _caveats(groups: list[tuple[str, NestedMean]]) -> tuple[str, ...]:
    """What the comparison cannot know where all samples of a group are from one spool."""
    single = [name for name, mean in groups if len(mean.spool_means) == 1]
    if not single:
        return ()
    return (f"{' and '.join(single)}: one spool, so how spools differ is not in it",)
