"""Build groups of samples (means of all results, mean curve, notes), and compare two groups."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace

import numpy as np

from labpipe.records.group import Difference, Group, GroupNumber, NestedMean, Sample
from labpipe.records.quality import Reason
from labpipe.records.result import Result, find_result
from labpipe.statistics.group_fields import find_shared_fields, make_natural_sort_key
from labpipe.statistics.group_notes import (
    find_other_methods,
    make_method_caveats,
    make_method_notes,
    make_number_notes,
    make_sample_notes,
    name_samples,
)
from labpipe.statistics.mean_curves import average_loading, average_scaled_loading
from labpipe.statistics.means import (
    DEFAULT_LIMITS,
    PoolingLimits,
    add_common_causes,
    are_positive,
    compute_nested_mean,
    convert_to_log_scale,
)
from labpipe.statistics.two_groups import compare_means

__all__ = ["PoolingLimits", "average_result", "build_group", "compare_groups"]


def build_group(
    name: str,
    protocol: str,
    samples: Sequence[Sample],
    *,
    limits: PoolingLimits = DEFAULT_LIMITS,
    scaled: bool = False,
    signed: Container[str] = (),
    set_by_rig: Container[str] = (),
) -> Group:
    """Build the group of the samples of one type.

    Parameters
    ----------
    name : of the group
    protocol : of the tests of all samples
    samples : in any order; may be empty
    limits : when spools may be pooled
    scaled : whether to average force / peak force as well
    signed : stems of results that can be negative, such as ``slack``; intervals of the means of all
        others are on a log scale, if all their values are positive
    set_by_rig : stems of results that are set by the rig

    Returns
    -------
    Samples in order of spool, sample and test; one number per result that any sample has, in the
    order in which they first appear; the mean of the first loading branches; notes, among them
    those on exclusions; and the fields that the specimens share.
    """
    ordered = tuple(sorted(samples, key=_make_sample_sort_key))
    names = dict.fromkeys(result.name for sample in ordered for result in sample.results)
    made_otherwise = find_other_methods(ordered)
    numbers = tuple(
        replace(
            average_result(
                name,
                ordered,
                limits,
                excluded=made_otherwise.get(name, {}),
                is_signed=name.partition(".")[0] in signed,
            ),
            is_set_by_rig=name.partition(".")[0] in set_by_rig,
        )
        for name in names
    )
    band, notes = average_loading(ordered, limits)
    share, share_notes = average_scaled_loading(ordered, limits) if scaled else (None, [])
    all_notes = (
        *make_method_notes(made_otherwise, ordered),
        *make_sample_notes(ordered),
        *make_number_notes(numbers),
        *notes,
        *share_notes,
    )
    return Group(
        name, protocol, ordered, numbers, band, share, all_notes, find_shared_fields(ordered)
    )


def _make_sample_sort_key(sample: Sample) -> list[tuple[tuple[int, str], ...]]:
    """Return a sort key with sample 2 before sample 10."""
    texts = (sample.specimen.spool, sample.specimen.sample, sample.test, sample.source)
    return list(map(make_natural_sort_key, texts))


def average_result(
    name: str,
    samples: Sequence[Sample],
    limits: PoolingLimits = DEFAULT_LIMITS,
    *,
    excluded: Mapping[str, Reason] | None = None,
    is_signed: bool = False,
) -> GroupNumber:
    """Average one result over samples.

    Parameters
    ----------
    name : of the result
    samples : with or without it
    limits : when spools may be pooled
    excluded : reason by the sample's name (`name_samples`), for samples whose number is excluded
        from the mean
    is_signed : whether it can be negative; else intervals are on a log scale
        (`convert_to_log_scale`), if no value or estimate is zero or below

    Returns
    -------
    The mean includes doubtful results, which keep their status in `values`. It excludes, each with
    its reason, failed results, samples without the result (``no_result``), values not finite
    (``not_finite``) or in another unit than the first (``other_unit``), and `excluded`.
    """
    results = {
        key: find_result(sample.results, name)
        for key, sample in zip(name_samples(samples), samples, strict=True)
    }
    spools = dict(zip(results, (sample.specimen.spool for sample in samples), strict=True))
    units = [result.unit for result in results.values() if result is not None]
    unit = units[0] if units else ""
    left_out = {key: _find_exclusion_reasons(result, name, unit) for key, result in results.items()}
    for key, reason in (excluded or {}).items():
        left_out[key] = left_out[key] or (reason,)
    values = {
        key: result for key, result in results.items() if result is not None and not left_out[key]
    }
    by_spool: dict[str, list[Result]] = {}
    for key, result in values.items():
        by_spool.setdefault(spools[key], []).append(result)
    return GroupNumber(
        name=name,
        unit=unit,
        mean=_average_nested(by_spool, limits, is_signed=is_signed),
        values=values,
        left_out={key: reasons for key, reasons in left_out.items() if reasons},
    )


def _find_exclusion_reasons(result: Result | None, name: str, unit: str) -> tuple[Reason, ...]:
    if result is None:
        return (Reason.of("statistics.no_result", name=name),)
    if result.value is None:
        return result.reasons
    if not np.isfinite(result.value):
        return (Reason.of("statistics.not_finite", value=result.value),)
    if result.unit != unit:
        return (Reason.of("statistics.other_unit", unit=result.unit, usual=unit),)
    return ()


def _average_nested(
    spools: Mapping[str, Sequence[Result]], limits: PoolingLimits, *, is_signed: bool
) -> NestedMean:
    values = {
        name: np.array([result.value for result in results], dtype=np.float64)
        for name, results in spools.items()
    }
    mean = add_common_causes(compute_nested_mean(values, limits), spools)
    all_results = [result for results in spools.values() for result in results]
    return mean if is_signed or not are_positive(all_results) else convert_to_log_scale(mean)


def compare_groups(
    first: Group, second: Group, *, names: Sequence[str] = (), margin: float | None = None
) -> tuple[Difference, ...]:
    """Compute the differences of two groups in their common results, before judgement.

    Parameters
    ----------
    first, second : tested by one protocol
    names : of the results to compare; all if empty
    margin : difference without practical importance, as a share of the mean of the first group, or
        None

    Returns
    -------
    One per result that has a mean in both groups and one unit, in the order of `names` or else of
    the first group, without a verdict (`judge_family`). Its caveats name methods that differ,
    groups of a single spool, and shared causes.
    """
    first_numbers = {number.name: number for number in first.numbers}
    second_numbers = {number.name: number for number in second.numbers}
    differences = []
    for name in names or first_numbers:
        first_number, second_number = first_numbers.get(name), second_numbers.get(name)
        if first_number is None or second_number is None or first_number.unit != second_number.unit:
            continue
        if first_number.values and second_number.values:
            means = (first.name, first_number.mean), (second.name, second_number.mean)
            difference = compare_means(name, first_number.unit, *means, margin)
            caveats = (*difference.caveats, *make_method_caveats(first_number, second_number))
            differences.append(replace(difference, caveats=caveats))
    return tuple(differences)
