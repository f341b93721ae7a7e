"""Intervals of means that cannot be negative: on a log scale, about the plain mean.

Over two spools, Student's t is 12.7, and mean -+ t s / sqrt(n) of a stiffness easily begins below
zero, where no stiffness is. On a log scale the same half width is a factor: the interval lies
between mean / factor and mean x factor.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp

from labpipe.records.curve import Interval
from labpipe.records.group import MeanInterval, NestedMean
from labpipe.records.result import Result


def can_be_on_a_log_scale(values: list[Result]) -> bool:
    """Tell whether all values and estimates are above zero.

    Parameters
    ----------
    values : that are averaged
    """
    return all(
        value.value is not None
        and value.value > 0.0
        and (value.estimate is None or value.estimate > 0.0)
        for value in values
    )


def on_log_scale(mean: NestedMean) -> NestedMean:
    """Put the intervals of the mean of a positive number on a log scale.

    Parameters
    ----------
    mean : with the half widths of Student's t and of what all tests of a rig share

    Returns
    -------
    The same means and scatters; each interval is middle x exp(-+ half width / middle).

    Notes
    -----
    The standard error of log(mean) is that of the mean over the mean. So the interval holds the
    arithmetic mean that stands beside it, not the geometric one, and a spreadsheet gives it:
    ``AVERAGE(x)*EXP(T.INV.2T(0.05;n-1)*STDEV.S(x)/SQRT(n)/AVERAGE(x))``. What holds it less often,
    or more often: docs/explanations/statistics.md.
    """
    return replace(
        mean,
        chosen=_put(mean.chosen),
        over_samples=_put(mean.over_samples),
        over_spools=mean.over_spools and _put(mean.over_spools),
        spool_means={name: _put(spool_mean) for name, spool_mean in mean.spool_means.items()},
    )


def _put(mean: MeanInterval) -> MeanInterval:
    # Keeps the ends finite and above zero.
    max_exponent = 300.0
    if mean.interval is None or not mean.middle > 0.0:
        return mean
    factor = exp(min(mean.half / mean.middle, max_exponent))
    ends = Interval(mean.middle / factor, mean.middle * factor, mean.interval.level)
    return replace(mean, interval=ends, is_log=True)
