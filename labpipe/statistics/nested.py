"""Means of samples that were cut from spools, and the decision whether spools may be pooled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.group import Decision, MeanInterval, NestedMean
from labpipe.statistics.means import mean_interval
from labpipe.statistics.spools import SpoolScatter, equal_spools_p, smallest_p, spool_scatter


@dataclass(frozen=True, slots=True)
class PoolingLimits:
    """When samples of several spools may be taken as independent.

    Parameters
    ----------
    min_p : smallest p-value of the k-sample Anderson-Darling test that allows it; 0.05 is custom
    max_spool_share : largest share of the variance that may lie between spools; at 0.1 and three
        samples a spool the pooled interval is at most 9 % too short
    confidence : how sure the data must be that the share is below; at 0.999 spools are pooled for
        want of evidence so rarely that the interval still covers in 95 % of groups
    """

    min_p: float = 0.05
    max_spool_share: float = 0.1
    confidence: float = 0.999


USUAL = PoolingLimits()


def nested_mean(
    spools: Mapping[str, Sequence[float] | Floats], limits: PoolingLimits = USUAL
) -> NestedMean:
    """Mean of samples nested in spools, with the interval that holds for the type.

    Parameters
    ----------
    spools : values of the samples, by spool; NaN count as absent, and so does a spool without any
    limits : when spools may be pooled

    Returns
    -------
    In the unit of the values. `chosen` is over the spool means, as many as there are spools,
    unless the Anderson-Darling test does not tell the spools apart *and* the upper confidence
    limit of the share of variance between spools is below the limit. Spools count alike, however
    many samples they have. One spool: over its samples, and `decision` says what that leaves out.

    Notes
    -----
    A test that finds no difference between two or three spools says next to nothing, since it
    would hardly find one; so it is the upper limit that decides. Measured coverage of the chosen
    interval: docs/explanations/statistics.md.
    """
    kept = {name: _known(values) for name, values in spools.items()}
    kept = {name: values for name, values in kept.items() if len(values)}
    values = list(kept.values())
    over_samples = mean_interval(np.concatenate([np.zeros(0), *values]), "sample")
    means = {name: mean_interval(each, "sample") for name, each in kept.items()}
    if len(kept) < 2:
        return _one_spool(over_samples, means)
    scatter = spool_scatter(values, limits.confidence)
    p = equal_spools_p(values)
    is_pooled = bool(p >= limits.min_p and scatter.share_upper < limits.max_spool_share)
    over_spools = mean_interval([mean.mean for mean in means.values()], "spool")
    return NestedMean(
        chosen=over_samples if is_pooled else over_spools,
        over_samples=over_samples,
        over_spools=over_spools,
        is_pooled=is_pooled,
        decision=_decision(values, scatter, p, limits, is_pooled=is_pooled),
        spool_means=means,
        within=scatter.within,
        between=scatter.between,
        spool_p=p,
    )


def _known(values: Sequence[float] | Floats) -> Floats:
    given = np.asarray(values, dtype=np.float64)
    return given[~np.isnan(given)]


def _one_spool(over_samples: MeanInterval, means: Mapping[str, MeanInterval]) -> NestedMean:
    said = Decision("No samples")
    if over_samples.n:
        counted = "1 sample" if over_samples.n == 1 else f"{over_samples.n} samples"
        why = (
            "how spools differ is not known, so the interval speaks of this spool and not of the "
            "type"
        )
        said = Decision(f"Over {counted} of one spool", (why,))
    nan = float("nan")
    return NestedMean(
        chosen=over_samples,
        over_samples=over_samples,
        over_spools=None,
        is_pooled=True,
        decision=said,
        spool_means=means,
        within=over_samples.deviation,
        between=nan,
        spool_p=nan,
    )


def _decision(
    spools: Sequence[Floats],
    scatter: SpoolScatter,
    p: float,
    limits: PoolingLimits,
    *,
    is_pooled: bool,
) -> Decision:
    """The decision in words: what was averaged, and the numbers that say so."""
    counts = tuple(len(values) for values in spools)
    done = (
        f"Pooled over {sum(counts)} samples of {len(counts)} spools"
        if is_pooled
        else f"Over {len(counts)} spool means, not pooled over {sum(counts)} samples"
    )
    if max(counts) > 1 and np.ptp(np.concatenate(spools)) == 0.0:
        why = "all values are equal, so there is no scatter to tell spools apart by"
        return Decision(done, (why,))
    return Decision(done, (*_share_words(scatter, limits), _test_words(p, counts, limits)))


def _share_words(scatter: SpoolScatter, limits: PoolingLimits) -> tuple[str, ...]:
    """How the variance is shared out, and what is asked of it."""
    if np.isnan(scatter.within):
        return ("no spool has two samples, so the scatter within spools is not known",)
    upper = f"{100.0 * scatter.share_upper:.3g} %"
    if scatter.between == 0.0:
        found = (
            "the spools differ no more than their samples explain, "
            f"yet up to {upper} of the variance may lie between them"
        )
    else:
        found = f"{100 * scatter.share:.3g} % of the variance lies between spools{_ratio(scatter)}"
        found += f", and it may be up to {upper}"
    needed = (
        f"pooling needs that share below {100 * limits.max_spool_share:.3g} % "
        f"with {100 * limits.confidence:.4g} % confidence"
    )
    return found, needed


def _ratio(scatter: SpoolScatter) -> str:
    if scatter.within == 0.0:
        return ""
    return f" (spools scatter {scatter.between / scatter.within:.3g} times as much as samples)"


def _test_words(p: float, counts: tuple[int, ...], limits: PoolingLimits) -> str:
    if np.isnan(p):
        return "the Anderson-Darling test of equal spools needs two samples in each spool"
    least = smallest_p(counts)
    if least >= limits.min_p:
        sizes = f"{', '.join(map(str, counts[:-1]))} and {counts[-1]}"
        return (
            f"with {sizes} samples the Anderson-Darling test of equal spools cannot tell, "
            f"as its p is never below {least:.2g}"
        )
    verdict = "does not tell them apart" if p >= limits.min_p else "tells them apart"
    return (
        f"the Anderson-Darling test of equal spools {verdict} "
        f"(p = {p:.2g}, pooling needs {limits.min_p:.2g})"
    )
