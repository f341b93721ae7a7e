"""Intervals of means that cannot be negative: on a log scale, about the plain mean.

Over two spools, Student's t is 12.7, and mean -+ t s / sqrt(n) of a stiffness easily begins below
zero. On a log scale the same half width is a factor: the interval is
from mean / factor to mean x factor.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp

from labpipe.records.curve import Interval
from labpipe.records.group import MeanInterval, NestedMean
from labpipe.records.result import Result


def can_be_on_a_log_scale(values: list[Result]) -> bool:
    """Return whether all values and estimates are above zero.

    Parameters
    ----------
    values : of a mean
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
    mean : with the half widths of Student's t and of the common causes of a rig

    Returns
    -------
    The same means and scatters; each interval is middle x exp(-+ half width / middle).

    Notes
    -----
    The standard error of log(mean) is that of the mean over the mean. So the interval is for the
    arithmetic mean, not the geometric one, and can be computed in a spreadsheet:
    ``AVERAGE(x)*EXP(T.INV.2T(0.05;n-1)*STDEV.S(x)/SQRT(n)/AVERAGE(x))``. For its
    coverage see docs/explanations/statistics.md.
    """
    return replace(
        mean,
        chosen=_log_interval(mean.chosen),
        over_samples=_log_interval(mean.over_samples),
        over_spools=mean.over_spools and _log_interval(mean.over_spools),
        spool_means={
            name: _log_interval(spool_mean) for name, spool_mean in mean.spool_means.items()
        },
    )


def _log_interval(mean: MeanInterval) -> MeanInterval:
    max_exponent = 300.0  # keeps the ends finite and above zero
    if mean.interval is None or not mean.middle > 0.0:
        return mean
    factor = exp(min(mean.half / mean.middle, max_exponent))
    ends = Interval(mean.middle / factor, mean.middle * factor, mean.interval.level)
    return replace(mean, interval=ends, is_log=True)
