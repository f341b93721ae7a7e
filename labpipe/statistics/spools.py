"""How much of the scatter of samples is scatter between their spools."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations
from math import factorial, prod

import numpy as np
from scipy import special, stats

from labpipe.records.arrays import Floats

_MOST_PARTITIONS = 100
"""Up to here the Anderson-Darling test counts every way to deal the samples out to the spools."""


@dataclass(frozen=True, slots=True)
class SpoolScatter:
    """Scatter of samples within spools and of spools.

    Parameters
    ----------
    within : standard deviation of samples of one spool; NaN where no spool has two samples
    between : standard deviation of the true means of spools; 0 where the spool means scatter no
        more than their samples make them; NaN where `within` is
    share : between^2 / (between^2 + within^2)
    share_upper : upper confidence limit of the share; 1 where it cannot be had
    """

    within: float
    between: float
    share: float
    share_upper: float


def spool_scatter(spools: Sequence[Floats], confidence: float) -> SpoolScatter:
    """Tell the scatter between spools from the scatter within them.

    Parameters
    ----------
    spools : values of the samples of each spool, two spools or more, none empty, without NaN
    confidence : one-sided level of the upper limit of the share

    Returns
    -------
    In the unit of the values.

    Notes
    -----
    One-way analysis of variance on unweighted spool means, with the harmonic mean h of the numbers
    of samples: between^2 = S^2 - within^2 / h, S^2 the variance of the spool means. The limit of
    the share inverts the F distribution of h S^2 / within^2 (Thomas and Hultquist, Annals of
    Statistics 6 (1978) 582); for equal numbers of samples it is exact.
    """
    counts = np.array([len(values) for values in spools])
    free = int(np.sum(counts - 1))
    if free == 0:
        return SpoolScatter(np.nan, np.nan, np.nan, 1.0)
    within = float(sum(np.sum((values - values.mean()) ** 2) for values in spools)) / free
    harmonic = len(spools) / float(np.sum(1.0 / counts))
    means = float(np.var([values.mean() for values in spools], ddof=1))
    between = max(means - within / harmonic, 0.0)
    total = between + within
    low = float(special.fdtri(len(spools) - 1, free, 1.0 - confidence))
    return SpoolScatter(
        float(np.sqrt(within)),
        float(np.sqrt(between)),
        between / total if total > 0 else np.nan,
        _share_at(harmonic * means, within * low, harmonic),
    )


def _share_at(observed: float, expected: float, harmonic: float) -> float:
    """Share between spools at which a quantile of the mean square of spools is the observed one."""
    if expected == 0.0:
        return 1.0
    excess = observed / expected - 1.0
    return max(excess, 0.0) / (max(excess, 0.0) + harmonic)


def equal_spools_p(spools: Sequence[Floats]) -> float:
    """p-value of the k-sample Anderson-Darling test that all spools are alike.

    Parameters
    ----------
    spools : values of the samples of each spool, without NaN

    Returns
    -------
    NaN for fewer than two spools, a spool of one sample, or when all values are equal.

    Notes
    -----
    Scholz and Stephens, J. Am. Stat. Assoc. 82 (1987) 918, with midranks (scipy). Where there are
    few ways to deal the samples out to the spools (20 for two spools of three), all are counted
    and p is exact; else it is read from their table, which ends at 0.001 and 0.25.
    """
    counts = [len(values) for values in spools]
    if len(counts) < 2 or min(counts) < 2 or np.ptp(np.concatenate(spools)) == 0.0:
        return float("nan")
    exact = stats.PermutationMethod(n_resamples=_MOST_PARTITIONS)
    with warnings.catch_warnings():
        # The ends of the table are documented above.
        warnings.filterwarnings("ignore", message="p-value (capped|floored)", category=UserWarning)
        found = stats.anderson_ksamp(
            spools,
            variant="midrank",
            method=exact if _partitions(counts) <= _MOST_PARTITIONS else None,
        )
    return float(found.pvalue)


def _partitions(counts: Sequence[int]) -> int:
    """Ways to deal samples out to spools of these sizes."""
    return factorial(sum(counts)) // prod(factorial(count) for count in counts)


@lru_cache(maxsize=64)
def smallest_p(counts: tuple[int, ...]) -> float:
    """Smallest p-value that `equal_spools_p` can give, which is that of spools wholly apart.

    Parameters
    ----------
    counts : samples of each spool

    Returns
    -------
    0.1 for 3 and 3 samples: of the 20 ways to deal six out, two keep them apart. 0.001, the end of
    the table, where not all ways are counted; NaN where there is no test.
    """
    if len(counts) < 2 or min(counts) < 2:
        return float("nan")
    if _partitions(counts) > _MOST_PARTITIONS:
        return 0.001
    orders = set(permutations(sorted(counts)))
    ranks = np.arange(sum(counts), dtype=np.float64)
    return min(equal_spools_p(np.split(ranks, np.cumsum(order)[:-1])) for order in orders)
