"""Average the results and curves of a group of samples, and compare two groups."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, average_blocks
from labpipe.records.group import Band, Difference, Group, GroupNumber, Sample
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Result, find_result
from labpipe.statistics.group_samples import (
    find_other_methods,
    find_shared_fields,
    make_method_caveats,
    make_method_notes,
    make_natural_sort_key,
    make_number_notes,
    make_sample_notes,
    name_samples,
)
from labpipe.statistics.means import (
    ALPHA,
    DEFAULT_LIMITS,
    PoolingLimits,
    add_common_causes,
    are_positive,
    compute_nested_mean,
    compute_t_quantile,
    convert_to_log_scale,
)
from labpipe.statistics.significance import compare_means

_MIN_BLOCK_MEANS = 500
"""Smallest number of block means to which a curve is reduced.

The noise within a block gives no information on the sample, and would widen the simultaneous band.
"""
N_DISPLACEMENTS = 201
"""Number of displacements of a mean curve; the step is 0.25 mm over 50 mm."""


def average_loading(
    samples: Sequence[Sample],
    limits: PoolingLimits = DEFAULT_LIMITS,
    *,
    divisors: Mapping[str, float] | None = None,
) -> tuple[Band, list[QualityNote]]:
    """Average the first loading branches of samples.

    Parameters
    ----------
    samples : samples of one group; those without a loading branch are excluded, with a note
    limits : conditions under which spools are pooled
    divisors : divisors of the force, N, keyed by name of the sample; samples without a divisor are
        excluded

    Returns
    -------
    The band, reduced for few curves (`reduce_band`), and notes. Spool means are averaged, unless
    there is one spool, or `compute_nested_mean` pools the mean forces over the common range. One
    decision applies to the whole curve, because separate decisions would make the width of the band
    discontinuous.
    """
    named_samples = [
        (name, sample)
        for name, sample in zip(name_samples(samples), samples, strict=True)
        if sample.loading and (divisors is None or name in divisors)
    ]
    curves = []
    for name, sample in named_samples:
        loading, divisor = sample.loading[0], 1.0 if divisors is None else divisors[name]
        displacement = average_blocks(loading.displacement, _MIN_BLOCK_MEANS)
        curves.append((displacement, average_blocks(loading.force, _MIN_BLOCK_MEANS) / divisor))
    common_curves = interpolate_curves(curves, [name for name, _ in named_samples])
    notes = [*_make_curve_notes(samples, common_curves)]
    if not len(common_curves.displacement):
        return compute_band(common_curves), notes
    spools = [sample.specimen.spool for _, sample in named_samples]
    mean_forces = common_curves.force.mean(axis=1)
    forces = {spool: mean_forces[np.array(spools) == spool] for spool in dict.fromkeys(spools)}
    nested_mean = compute_nested_mean(forces, limits)
    if len(forces) > 1:
        note = QualityNote.of("statistics.curve_pooling", "group", decision=nested_mean.decision)
        notes.append(note)
    if nested_mean.is_pooled:
        return reduce_band(compute_band(common_curves)), notes
    means = [common_curves.force[np.array(spools) == spool].mean(axis=0) for spool in forces]
    spool_curves = CommonCurves(common_curves.displacement, np.array(means))
    return reduce_band(compute_band(spool_curves, members="spool means")), notes


def reduce_band(band: Band) -> Band:
    """Reduce or remove the bands of a mean of a few curves.

    Parameters
    ----------
    band : confidence band of any number of curves

    Returns
    -------
    The band of one curve, or of six and more curves, is unchanged. The band of three to five curves
    (``few_curves``) has pointwise intervals at a quarter, at half and at the end of the
    displacements. It is NaN elsewhere, because a filled area would look like a simultaneous band
    and hide the curves. The band of two curves (``two_curves``) has no interval, because the
    quantile of t is 12.7.
    """
    # The quantile of the simultaneous band of fewer curves is 4 to 60, too wide to be useful.
    min_band_curves = 6
    if not 2 <= band.n < min_band_curves or not len(band.displacement):
        return band
    nans = np.full(len(band.displacement), np.nan)
    lower, upper = nans.copy(), nans.copy()
    reason = Reason.of("statistics.too_few_curves", members=band.members)
    if band.n > 2:
        rows = [round(fraction * (len(nans) - 1)) for fraction in (0.25, 0.5, 1.0)]
        lower[rows], upper[rows] = band.lower[rows], band.upper[rows]
        facts = {"count": band.n, "members": band.members, "minimum": min_band_curves}
        reason = Reason.of("statistics.few_curves", **facts)
    return replace(band, lower=lower, upper=upper, lower_all=nans, upper_all=nans, reason=reason)


def average_scaled_loading(
    samples: Sequence[Sample], limits: PoolingLimits
) -> tuple[Band, list[QualityNote]]:
    """Average the force divided by the peak force of the same sample.

    Parameters
    ----------
    samples : samples; those without a positive peak force are excluded, with a note
    limits : conditions under which spools are pooled

    Returns
    -------
    The band, with forces relative to the peak force, and the notes of `average_loading` with
    severity info and codes that end in ``_scaled``. A note on missing peak forces replaces the note
    on missing curves.
    """
    peak_forces = dict(zip(name_samples(samples), map(_get_peak_force, samples), strict=True))
    divisors = {name: peak for name, peak in peak_forces.items() if peak > 0}
    band, notes = average_loading(samples, limits, divisors=divisors)
    scaled_notes = []
    for note in notes:
        if note.code != "no_curve":
            text = format_sentence("statistics.scaled", message=note.message)
            scaled_notes.append(QualityNote(f"{note.code}_scaled", Severity.INFO, "group", text))
    if tests := ", ".join(name for name in peak_forces if name not in divisors):
        scaled_notes.append(QualityNote.of("statistics.no_peak_force", "group", tests=tests))
    return band, scaled_notes


def _get_peak_force(sample: Sample) -> float:
    """Return the peak force of the first cycle or, without this result, the largest force, N.

    Return NaN without a finite force.
    """
    peak = find_result(sample.results, "peak_force.1")
    if peak is not None:
        return float("nan") if peak.value is None else peak.value
    forces: Floats = sample.loading[0].force if sample.loading else np.zeros(0)
    finite_forces = forces[~np.isnan(forces)]
    return float(finite_forces.max()) if len(finite_forces) else float("nan")


def _make_curve_notes(samples: Sequence[Sample], curves: CommonCurves) -> Iterator[QualityNote]:
    """Make notes on samples without a curve, and on gaps in the common range of the curves."""
    named_samples = zip(name_samples(samples), samples, strict=True)
    if tests := ", ".join(name for name, sample in named_samples if not sample.loading):
        yield QualityNote.of("statistics.no_curve", "group", tests=tests)
    if gaps := ", ".join(_describe_gaps(curves.displacement)):
        yield QualityNote.of("statistics.gap_in_curves", "group", gaps=gaps)


def _describe_gaps(displacement: Floats) -> list[str]:
    """Describe the ranges in which evenly spaced displacements, m, are missing."""
    max_step_ratio = 1.5  # a larger step shows that at least one point is missing
    steps = np.diff(displacement)
    gaps = np.flatnonzero(steps > max_step_ratio * steps.min(initial=np.inf))
    ends = [(1e3 * displacement[index], 1e3 * displacement[index + 1]) for index in gaps]
    return [f"{start:.4g} mm to {stop:.4g} mm" for start, stop in ends]


@dataclass(frozen=True, slots=True, eq=False)
class CommonCurves:
    """Curves that are interpolated at common displacements.

    Parameters
    ----------
    displacement : shape (n,), m, increasing; empty without a common range
    force : shape (curves, n), N, without NaN
    reason : reason why there is no common range: ``empty_group``, ``no_data`` or ``no_overlap``;
        None with a common range
    """

    displacement: Floats
    force: Floats
    reason: Reason | None = None


def interpolate_curves(
    curves: Sequence[tuple[Floats, Floats]],
    names: Sequence[str] = (),
    n_displacements: int = N_DISPLACEMENTS,
) -> CommonCurves:
    """Interpolate curves at common displacements.

    Parameters
    ----------
    curves : displacement (m) and force (any unit) of each curve, both of the same shape (n,), where
        n may differ between curves
    names : name of each curve, for messages
    n_displacements : number of evenly spaced displacements from the last start to the first end

    Returns
    -------
    The curves, sorted by displacement, then interpolated linearly and without extrapolation. A NaN
    is a gap between its neighbours. Displacements in a gap of any curve are excluded.
    """
    empty = np.zeros(0), np.zeros((len(curves), 0))
    if not curves:
        return CommonCurves(*empty, Reason.of("statistics.no_curves"))
    labels = list(names) or [f"curve {index}" for index in range(1, len(curves) + 1)]
    sorted_curves = [_sort_by_displacement(*curve) for curve in curves]
    # For each curve, the displacements at which there is a force.
    displacements = [displacement[~np.isnan(force)] for displacement, force in sorted_curves]
    if names_without_data := [
        name for name, values in zip(labels, displacements, strict=True) if not len(values)
    ]:
        reason = Reason.of("statistics.no_data", names=", ".join(names_without_data))
        return CommonCurves(*empty, reason)
    starts, stops = (np.array([values[end] for values in displacements]) for end in (0, -1))
    last_index, first_index = int(np.argmax(starts)), int(np.argmin(stops))
    start, stop = starts[last_index], stops[first_index]
    if stop <= start:
        late_name, early_name = labels[last_index], labels[first_index]
        facts = {"late": late_name, "early": early_name, "start": 1e3 * start, "stop": 1e3 * stop}
        reason = Reason.of("statistics.no_overlap", **facts)
        return CommonCurves(*empty, reason)
    grid = np.linspace(start, stop, n_displacements)
    force = np.array([np.interp(grid, *curve) for curve in sorted_curves])
    is_common = ~np.isnan(force).any(axis=0)
    return CommonCurves(grid[is_common], force[:, is_common])


def _sort_by_displacement(displacement: Floats, force: Floats) -> tuple[Floats, Floats]:
    """Sort a curve by displacement; a point without displacement becomes a gap in the force."""
    is_finite = ~np.isnan(displacement)
    if not is_finite.any():
        return np.zeros(0), np.zeros(0)
    rows = np.arange(len(displacement), dtype=np.float64)
    filled_displacement = np.interp(rows, rows[is_finite], displacement[is_finite])
    order = np.argsort(filled_displacement, kind="stable")
    return filled_displacement[order], np.where(is_finite, force, np.nan)[order]


def compute_band(curves: CommonCurves, members: str = "samples") -> Band:
    """Compute the mean of curves with a pointwise and a simultaneous 95 % band.

    Parameters
    ----------
    curves : independent curves at common displacements
    members : ``samples`` or ``spool means``

    Returns
    -------
    The mean and its bands. The pointwise band contains the true mean at any given displacement in
    95 % of groups. The simultaneous band contains the whole true mean curve in at least 95 % of
    groups. The mean of one curve has no band (``one_curve``). The mean of two curves has
    no simultaneous band (``two_curves``).

    Notes
    -----
    The band is mean -+ c s / sqrt(n) at each displacement, with the standard deviation s of n - 1
    degrees of freedom. For the pointwise band, c is the quantile of t. For the simultaneous band, c
    is that of `compute_simultaneous_quantile`.
    """
    n, displacement, reason = len(curves.force), curves.displacement, curves.reason
    if reason is None and not len(displacement):
        reason = Reason.of("statistics.gaps_everywhere")
    elif reason is None and n == 1:
        reason = Reason.of("statistics.one_curve")
    elif reason is None and n == 2:
        reason = Reason.of("statistics.two_curves", members=members)
    mean = curves.force.sum(axis=0) / max(n, 1)
    pointwise = simultaneous = np.full(len(displacement), np.nan)  # half widths of the bands
    if n > 1 and len(displacement):
        error = curves.force.std(axis=0, ddof=1) / np.sqrt(n)
        pointwise = compute_t_quantile(n - 1) * error
        simultaneous = compute_simultaneous_quantile(curves.force) * error
    ends = (mean - pointwise, mean + pointwise, mean - simultaneous, mean + simultaneous)
    return Band(displacement, mean, *ends, n, members, reason)


def compute_simultaneous_quantile(curves: Floats) -> float:
    """Compute the half width of the simultaneous band as a multiple of the standard error.

    Parameters
    ----------
    curves : shape (n, points), values of the curves in any unit, without NaN

    Returns
    -------
    The multiple with which the band covers the whole mean curve in 95 % of groups, at least the
    quantile of t. NaN for fewer than three curves, because two curves have no scatter where they
    cross.

    Notes
    -----
    The probability that |t| exceeds c anywhere along the curve is at most the probability at the
    first point plus the expected number of later upcrossings of c. By the Gaussian kinematic
    formula of t processes (Telschow and Schwartzman, J. Stat. Plan. Inference 216 (2022) 70), this
    bound is 2 [P(t > c) + L / (2 pi) (1 + c^2 / v)^(-(v - 1) / 2)] with v = n - 1. L is estimated
    by the length of the path that the vector of the n residuals, normalised to unit length, follows
    along the curve. The estimate is unbiased (Taylor and Worsley, J. Am. Stat. Assoc. 102 (2007)
    913). The union bound over the points (Bonferroni) is used if it is smaller, as for curves as
    rough as noise. The explanation docs/explanations/statistics.md states the measured coverage.
    """
    n, n_points = curves.shape
    if n < 3:
        return float("nan")
    degrees = n - 1
    path_length = _compute_path_length(curves - curves.mean(axis=0))

    def compute_excess(c: float) -> float:
        decay: float = (1.0 + c**2 / degrees) ** (-0.5 * (degrees - 1))
        upcrossings = path_length / (2.0 * np.pi) * decay
        return 2.0 * (float(scipy.special.stdtr(degrees, -c)) + upcrossings) - ALPHA

    low, high = 0.0, compute_t_quantile(degrees, ALPHA / n_points)  # the union bound
    if compute_excess(high) >= 0.0:
        return high
    while low < (middle := 0.5 * (low + high)) < high:  # scipy.optimize would take longer to import
        low, high = (middle, high) if compute_excess(middle) > 0.0 else (low, middle)
    return middle


def _compute_path_length(residuals: Floats) -> float:
    """Compute the path length of normalised residuals; points without scatter are excluded."""
    rounding_error = 1e-12  # relative to the largest residual
    norm = np.linalg.norm(residuals, axis=0)
    has_scatter = norm > rounding_error * np.abs(residuals).max(initial=0.0)
    unit_residuals = residuals[:, has_scatter] / norm[has_scatter]
    cosine = np.clip(np.sum(unit_residuals[:, 1:] * unit_residuals[:, :-1], axis=0), -1.0, 1.0)
    return float(np.sum(np.arccos(cosine)))


def build_group(
    name: str,
    protocol: str,
    samples: Sequence[Sample],
    *,
    limits: PoolingLimits = DEFAULT_LIMITS,
    scaled: bool = False,
    signed_names: Container[str] = (),
    rig_names: Container[str] = (),
) -> Group:
    """Build the group of the samples of one type.

    Parameters
    ----------
    name : name of the group
    protocol : protocol of the tests of all samples
    samples : samples in any order; may be empty
    limits : conditions under which spools are pooled
    scaled : whether the ratio of force to peak force is also averaged
    signed_names : names, without cycle number, of results that can be negative, such as ``slack``.
        Intervals of the means of other results are on a log scale, if all their values are positive
    rig_names : names, without cycle number, of results that the rig sets

    Returns
    -------
    The group. Its samples are in order of spool, sample and test. Its numbers are the results of
    all samples, in the order of first occurrence. It also has the mean of the first loading
    branches, notes (also on exclusions), and the fields with one value in all specimens.
    """
    samples = tuple(sorted(samples, key=_make_sample_sort_key))
    exclusions = find_other_methods(samples)
    numbers = []
    for result_name in dict.fromkeys(
        result.name for sample in samples for result in sample.results
    ):
        quantity, reasons = result_name.partition(".")[0], exclusions.get(result_name, {})
        is_signed = quantity in signed_names
        number = average_result(
            result_name, samples, limits, exclusions=reasons, is_signed=is_signed
        )
        numbers.append(replace(number, is_set_by_rig=quantity in rig_names))
    band, notes = average_loading(samples, limits)
    scaled_band, scaled_notes = average_scaled_loading(samples, limits) if scaled else (None, [])
    notes = [
        *make_method_notes(exclusions, samples),
        *make_sample_notes(samples),
        *make_number_notes(numbers),
        *notes,
        *scaled_notes,
    ]
    bands, fields = (band, scaled_band), find_shared_fields(samples)
    return Group(name, protocol, samples, tuple(numbers), *bands, tuple(notes), fields)


def _make_sample_sort_key(sample: Sample) -> list[tuple[tuple[int, str], ...]]:
    """Make a sort key with sample 2 before sample 10."""
    texts = (sample.specimen.spool, sample.specimen.sample, sample.test, sample.source)
    return list(map(make_natural_sort_key, texts))


def average_result(
    name: str,
    samples: Sequence[Sample],
    limits: PoolingLimits = DEFAULT_LIMITS,
    *,
    exclusions: Mapping[str, Reason] | None = None,
    is_signed: bool = False,
) -> GroupNumber:
    """Average one result over samples.

    Parameters
    ----------
    name : name of the result
    samples : samples with or without the result
    limits : conditions under which spools are pooled
    exclusions : reasons why samples are excluded from the mean, keyed by name of the sample
        (`name_samples`)
    is_signed : whether the result can be negative; otherwise intervals are on a log scale
        (`convert_to_log_scale`), if all values and estimates are positive

    Returns
    -------
    The result over all samples. The mean includes doubtful results, which keep their status in
    `values`. It excludes, each with its reason, failed results, samples without the result
    (``no_result``), values that are not finite (``not_finite``) or in another unit than most
    results (``other_unit``), and `exclusions`.
    """
    results, spools = dict[str, Result | None](), dict[str, str]()
    for key, sample in zip(name_samples(samples), samples, strict=True):
        results[key], spools[key] = find_result(sample.results, name), sample.specimen.spool
    units = [result.unit for result in results.values() if result is not None]
    unit = max(units, key=units.count, default="")
    reasons = {key: _list_exclusion_reasons(result, name, unit) for key, result in results.items()}
    for key, reason in (exclusions or {}).items():
        reasons[key] = reasons[key] or (reason,)
    values = {
        key: result for key, result in results.items() if result is not None and not reasons[key]
    }
    results_by_spool: dict[str, list[Result]] = {}
    for key, result in values.items():
        results_by_spool.setdefault(spools[key], []).append(result)
    arrays = {
        spool: np.array([result.value for result in items], dtype=np.float64)
        for spool, items in results_by_spool.items()
    }
    mean = add_common_causes(compute_nested_mean(arrays, limits), results_by_spool)
    if not is_signed and are_positive(values.values()):
        mean = convert_to_log_scale(mean)
    all_exclusions = {key: items for key, items in reasons.items() if items}
    return GroupNumber(name, unit, mean, values, all_exclusions)


def _list_exclusion_reasons(result: Result | None, name: str, unit: str) -> tuple[Reason, ...]:
    """List the reasons why a result is excluded from a mean; empty if it is included."""
    if result is None:
        return (Reason.of("statistics.no_result", name=name),)
    if result.value is None:
        return result.reasons
    if not np.isfinite(result.value):
        return (Reason.of("statistics.not_finite", value=result.value),)
    if result.unit != unit:
        return (Reason.of("statistics.other_unit", unit=result.unit, usual=unit),)
    return ()


def compare_groups(
    first: Group, second: Group, *, names: Sequence[str] = (), margin: float | None = None
) -> tuple[Difference, ...]:
    """Compare two groups in their common results.

    Parameters
    ----------
    first, second : groups that were tested by one protocol
    names : names of the results to compare; all if empty
    margin : largest difference without practical importance, as a fraction of the mean of the first
        group, or None

    Returns
    -------
    The difference in each result that has a mean in both groups in the same unit, in the order of
    `names` or of the first group. Caveats state different methods, groups of a single spool, and
    common causes. The verdict is added by `judge_family`.
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
