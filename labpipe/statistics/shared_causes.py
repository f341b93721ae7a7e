"""Common causes of all tests of a rig in the mean of a group, which do not average out.

A load cell that reads 0.3 % too high does so in every test. The scatter of the samples does not
show it, and more samples do not reduce it; so it is added to the interval of the mean. The mean
effect of noise on each number does not average out either; it is known, and subtracted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from labpipe.records.curve import Interval
from labpipe.records.group import MeanInterval, NestedMean
from labpipe.records.result import Contribution, Result


@dataclass(frozen=True, slots=True)
class _Shared:
    """Errors of one result, or of a mean, that scatter does not show.

    Parameters
    ----------
    off : value less estimate
    changes : by common cause of all tests of a rig
    """

    off: float
    changes: Mapping[str, float]


def add_common_causes(mean: NestedMean, spools: Mapping[str, Sequence[Result]]) -> NestedMean:
    """Add the common causes of all tests to the intervals of a mean.

    Parameters
    ----------
    mean : of `spools`, from the scatter alone
    spools : the averaged results, by spool

    Returns
    -------
    The same means and scatter. Every interval is about the mean of the estimates, and is widened by
    common causes (`widened_by`), which are named in the decision.

    Notes
    -----
    A common cause moves all numbers at once, each by its own signed change, and so moves their
    mean by the mean of the changes. Causes are independent (GUM, JCGM 100:2008, 5.2.2, note 1).
    """
    results_by_spool = {
        name: [_shared_of_result(spool) for spool in spools[name]] for name in mean.spool_means
    }
    means = {name: _mean_shared(results) for name, results in results_by_spool.items()}
    samples = _mean_shared([result for results in results_by_spool.values() for result in results])
    over_samples = _add_shared(mean.over_samples, samples)
    over_spools = mean.over_spools and _add_shared(
        mean.over_spools, _mean_shared(list(means.values()))
    )
    chosen = over_samples if mean.is_pooled or over_spools is None else over_spools
    causes = tuple(contribution.cause for contribution in chosen.common)
    because = (f"its interval holds what all tests of a rig share: {', '.join(causes)}",)
    decision = replace(
        mean.decision, because=(*mean.decision.because, *(because if causes else ()))
    )
    return replace(
        mean,
        chosen=chosen,
        over_samples=over_samples,
        over_spools=over_spools,
        spool_means={
            name: _add_shared(spool_mean, means[name])
            for name, spool_mean in mean.spool_means.items()
        },
        decision=decision,
    )


def _shared_of_result(result: Result) -> _Shared:
    value = 0.0 if result.value is None else result.value
    estimate = value if result.estimate is None else result.estimate
    changes = {
        contribution.cause: contribution.change
        for contribution in result.budget
        if contribution.is_common
    }
    return _Shared(value - estimate, changes)


def _mean_shared(several: Sequence[_Shared]) -> _Shared:
    """Average results; a missing cause counts as no change."""
    causes = dict.fromkeys(cause for shared in several for cause in shared.changes)
    if not several:
        return _Shared(0.0, {})
    changes = {
        cause: float(np.mean([shared.changes.get(cause, 0.0) for shared in several]))
        for cause in causes
    }
    return _Shared(float(np.mean([shared.off for shared in several])), changes)


def _add_shared(mean: MeanInterval, shared: _Shared) -> MeanInterval:
    common = tuple(
        Contribution(cause, change, is_common=True) for cause, change in shared.changes.items()
    )
    estimate = mean.mean - shared.off if shared.off else None
    moved = mean.interval and Interval(
        mean.interval.lower - shared.off, mean.interval.upper - shared.off
    )
    interval = moved and widened_by(moved, common)
    return replace(mean, interval=interval, estimate=estimate, common=common)


def standard_uncertainty(common: Sequence[Contribution]) -> float:
    """Return the combined standard uncertainty of independent causes."""
    return hypot(*(contribution.change for contribution in common))


def widened_by(interval: Interval, common: Sequence[Contribution]) -> Interval:
    """Widen the t interval of a mean by common causes.

    Parameters
    ----------
    interval : of Student's t, about its middle
    common : changes of the mean

    Returns
    -------
    Its half width in quadrature with the normal 95 % half width of the common causes.

    Notes
    -----
    With effective degrees of freedom (GUM, G.4.1) a common cause would make the interval of two
    values *shorter*, since t falls from 12.7 faster than the uncertainty grows. Half widths in
    quadrature never do; for their coverage see docs/explanations/statistics.md.
    """
    middle = 0.5 * (interval.lower + interval.upper)
    shared = Interval.normal_95(0.0, standard_uncertainty(common)).upper
    half = hypot(0.5 * (interval.upper - interval.lower), shared)
    return Interval(middle - half, middle + half, interval.level) if shared else interval


def difference_of(
    first: Sequence[Contribution], second: Sequence[Contribution]
) -> tuple[Contribution, ...]:
    """Return the changes by common causes of the difference of two means, second less first.

    Parameters
    ----------
    first, second : changes of two means of tests on one rig: a cause acts on both alike
    """
    one, two = (
        {contribution.cause: contribution.change for contribution in contributions}
        for contributions in (first, second)
    )
    return tuple(
        Contribution(cause, two.get(cause, 0.0) - one.get(cause, 0.0), is_common=True)
        for cause in dict.fromkeys([*one, *two])
    )
