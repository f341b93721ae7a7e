"""From samples to groups: every result averaged, the mean curve, what was left out and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from re import ASCII, split

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.group import Band, Difference, Group, GroupNumber, NestedMean, Sample
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.result import Result, Status
from labpipe.statistics.bands import CommonCurves, block_means, common_curves, mean_band
from labpipe.statistics.comparison import compare
from labpipe.statistics.methods import apart, method_notes
from labpipe.statistics.nested import USUAL, PoolingLimits, nested_mean
from labpipe.statistics.outliers import mark_outliers, too_few_for_outliers

__all__ = ["PoolingLimits", "build_group", "compare_groups", "group_number", "loading_band"]

_POINTS = 500
"""Points of a curve before it is averaged with others, each the mean of its samples: noise that is
faster says nothing about the sample and makes the band of the whole curve wide."""


def build_group(
    name: str,
    protocol: str,
    samples: Sequence[Sample],
    *,
    limits: PoolingLimits = USUAL,
    scaled: bool = False,
) -> Group:
    """Put the samples of one type together.

    Parameters
    ----------
    name : of the group
    protocol : that all samples were tested by
    samples : in any order; none is a group too, with an empty band
    limits : when spools may be pooled
    scaled : whether to average force / peak force as well

    Returns
    -------
    Samples in order of spool, sample and test; one number per result that any sample has, in the
    order in which they first appear; the mean of the first loading branches; and notes on all that
    was left out.
    """
    ordered = tuple(sorted(samples, key=_order))
    names = dict.fromkeys(result.name for sample in ordered for result in sample.results)
    numbers = tuple(group_number(each, ordered, limits) for each in names)
    band, notes = loading_band(ordered, limits)
    scaled_band, scaled_notes = _scaled_band(ordered, limits) if scaled else (None, [])
    told = [*method_notes(numbers, ordered), *_sample_notes(ordered), *_number_notes(numbers)]
    return Group(
        name, protocol, ordered, numbers, band, scaled_band, (*told, *notes, *scaled_notes)
    )


def _order(sample: Sample) -> list[list[tuple[int, str]]]:
    """Sample 2 before sample 10."""
    parts = (sample.specimen.spool, sample.specimen.sample, sample.test, sample.source)
    return [
        [
            (int(piece), "") if piece.isdecimal() else (0, piece)
            for piece in split(r"(\d+)", part, flags=ASCII)
        ]
        for part in parts
    ]


def _keys(samples: Sequence[Sample]) -> list[str]:
    """One name per sample: its test, with the file behind it where two tests share a name."""
    times = Counter(sample.test for sample in samples)
    return [
        sample.test if times[sample.test] == 1 else f"{sample.test} ({sample.source or number})"
        for number, sample in enumerate(samples, start=1)
    ]


def group_number(
    name: str, samples: Sequence[Sample], limits: PoolingLimits = USUAL
) -> GroupNumber:
    """Average one result over samples.

    Parameters
    ----------
    name : of the result
    samples : with or without it
    limits : when spools may be pooled

    Returns
    -------
    Doubtful results enter like good ones and keep their status in `values`. Left out, each with
    its reason: failed results, samples that have no such result (``no_result``), values in another
    unit than the first (``other_unit``).
    """
    found = {
        key: next((result for result in sample.results if result.name == name), None)
        for key, sample in zip(_keys(samples), samples, strict=True)
    }
    spools = dict(zip(found, (sample.specimen.spool for sample in samples), strict=True))
    units = [each.unit for each in found.values() if each is not None]
    unit = units[0] if units else ""
    left_out = {key: _why_not(result, name, unit) for key, result in found.items()}
    values = {key: each for key, each in found.items() if each is not None and not left_out[key]}
    return GroupNumber(
        name=name,
        unit=unit,
        mean=_nested({key: _value(each) for key, each in values.items()}, spools, limits),
        values=values,
        left_out={key: reason for key, reason in left_out.items() if reason},
        outliers=mark_outliers({key: _value(each) for key, each in values.items()}, spools),
    )


def _why_not(result: Result | None, name: str, unit: str) -> str:
    if result is None:
        return f"no_result: the test has no {name}"
    if result.value is None:
        return result.reason
    if not np.isfinite(result.value):
        return f"not_finite: the value is {result.value}"
    if result.unit != unit:
        return f"other_unit: in {result.unit}, where the first sample is in {unit}"
    return ""


def _value(result: Result) -> float:
    return float("nan") if result.value is None else result.value


def _nested(
    values: Mapping[str, float], spools: Mapping[str, str], limits: PoolingLimits
) -> NestedMean | None:
    by_spool: dict[str, list[float]] = {}
    for key, value in values.items():
        by_spool.setdefault(spools[key], []).append(value)
    return nested_mean(by_spool, limits) if by_spool else None


def loading_band(
    samples: Sequence[Sample],
    limits: PoolingLimits = USUAL,
    *,
    divisors: Mapping[str, float] | None = None,
) -> tuple[Band, list[QualityNote]]:
    """Mean curve of the first loading branch of each sample.

    Parameters
    ----------
    samples : those without a loading branch are left out, with a note
    limits : when spools may be pooled
    divisors : N, by sample: what its force is divided by; samples without one are left out

    Returns
    -------
    The band and notes. Over spool means unless the mean forces over the common range say that
    spools may be pooled: one decision for the whole curve, since the width of a band that decides
    at every displacement would jump.
    """
    drawn = [
        (key, sample)
        for key, sample in zip(_keys(samples), samples, strict=True)
        if sample.loading and (divisors is None or key in divisors)
    ]
    curves = [
        (
            block_means(sample.loading[0].displacement, _POINTS),
            block_means(sample.loading[0].force, _POINTS) / (divisors or {}).get(key, 1.0),
        )
        for key, sample in drawn
    ]
    shared = common_curves(curves, [key for key, _ in drawn])
    notes = [*_curve_notes(samples, shared)]
    if not len(shared.displacement):
        return mean_band(shared), notes
    spools = [sample.specimen.spool for _, sample in drawn]
    decision = _curve_decision(shared, spools, limits)
    if len(set(spools)) > 1:
        by = "Mean curve, by the mean force of each sample over the common range."
        notes.append(_note("curve_pooling", f"{by} {decision.decision}"))
    if decision.is_pooled:
        return mean_band(shared), notes
    return mean_band(_spool_curves(shared, spools), over="spool means"), notes


def _curve_decision(
    shared: CommonCurves, spools: Sequence[str], limits: PoolingLimits
) -> NestedMean:
    level = shared.force.mean(axis=1)
    by_spool = {spool: level[np.array(spools) == spool] for spool in dict.fromkeys(spools)}
    return nested_mean(by_spool, limits)


def _spool_curves(shared: CommonCurves, spools: Sequence[str]) -> CommonCurves:
    """Mean curve of each spool."""
    labels = np.array(spools)
    means = [shared.force[labels == spool].mean(axis=0) for spool in dict.fromkeys(spools)]
    return CommonCurves(shared.displacement, np.array(means))


def _scaled_band(
    samples: Sequence[Sample], limits: PoolingLimits
) -> tuple[Band, list[QualityNote]]:
    peaks = dict(zip(_keys(samples), (_peak(sample) for sample in samples), strict=True))
    usable = {key: peak for key, peak in peaks.items() if peak > 0}
    band, notes = loading_band(samples, limits, divisors=usable)
    without = [key for key in peaks if key not in usable]
    told = [_note(f"{note.code}_scaled", f"Force / peak force: {note.message}") for note in notes]
    if without:
        message = f"not in the mean of force / peak force, without a peak force: {_list(without)}"
        told.append(_note("no_peak_force", message, Severity.WARNING))
    return band, [note for note in told if not note.code.startswith("no_curve")]


def _peak(sample: Sample) -> float:
    """Peak force of the first cycle, N; its largest force where that is no result; NaN without."""
    stated = [result for result in sample.results if result.name == "peak_force.1"]
    if stated:
        return _value(stated[0])
    forces: Floats = sample.loading[0].force if sample.loading else np.zeros(0)
    known = forces[~np.isnan(forces)]
    return float(known.max()) if len(known) else float("nan")


def _note(code: str, message: str, severity: Severity = Severity.INFO) -> QualityNote:
    return QualityNote(code, severity, "group", message)


def _list(names: Sequence[str]) -> str:
    return ", ".join(names)


def _curve_notes(samples: Sequence[Sample], shared: CommonCurves) -> list[QualityNote]:
    without = [
        key for key, sample in zip(_keys(samples), samples, strict=True) if not sample.loading
    ]
    notes = []
    if without:
        message = f"not in the mean curve, without a loading branch: {_list(without)}"
        notes.append(_note("no_curve", message, Severity.WARNING))
    gaps = _gaps(shared.displacement)
    if gaps:
        message = f"the mean curve leaves out where a sample has a gap: {_list(gaps)}"
        notes.append(_note("gap_in_curves", message, Severity.WARNING))
    return notes


def _gaps(displacement: Floats) -> list[str]:
    """Ranges, in words, where an evenly spaced grid has points missing."""
    steps = np.diff(displacement)
    if not len(steps):
        return []
    wide = np.flatnonzero(steps > 1.5 * steps.min())
    ends = [(1e3 * displacement[at], 1e3 * displacement[at + 1]) for at in wide]
    return [f"{start:.4g} mm to {stop:.4g} mm" for start, stop in ends]


def _sample_notes(samples: Sequence[Sample]) -> list[QualityNote]:
    """What a reader of means must know of the samples behind them."""
    if not samples:
        return [_note("empty_group", "there is no sample in this group", Severity.WARNING)]
    notes = []
    if len(samples) == 1:
        message = f"one sample ({samples[0].test}): no interval and no band"
        notes.append(_note("one_sample", message, Severity.WARNING))
    times = Counter((sample.specimen.spool, sample.specimen.sample) for sample in samples)
    for (spool, sample), count in times.items():
        if count > 1:
            message = (
                f"sample {sample} of spool {spool} was tested {count} times; "
                f"the means count it as {count} samples"
            )
            notes.append(_note("sample_repeated", message, Severity.WARNING))
    return [*notes, *_dimension_notes(samples)]


def _dimension_notes(samples: Sequence[Sample]) -> list[QualityNote]:
    names = dict.fromkeys(name for sample in samples for name in sample.specimen.dimensions)
    notes = []
    for name in names:
        given = [sample.specimen.dimensions.get(name, float("nan")) for sample in samples]
        low, high = float(np.nanmin(given)), float(np.nanmax(given))
        if high - low > 0.01 * abs(high):
            message = (
                f"the samples differ in {name}: {1e3 * low:.4g} mm to {1e3 * high:.4g} mm; "
                "a mean over them mixes what this changes with scatter"
            )
            notes.append(_note("dimensions_differ", message, Severity.WARNING))
    return notes


def _number_notes(numbers: Sequence[GroupNumber]) -> list[QualityNote]:
    doubtful = [
        f"{number.name} ({_list(doubted)})" for number in numbers if (doubted := _doubted(number))
    ]
    notes = []
    if doubtful:
        message = f"doubtful values are in the means of: {'; '.join(doubtful)}"
        notes.append(_note("doubtful_in_mean", message, Severity.WARNING))
    few = [number.name for number in numbers if number.values and _too_few(number)]
    if few:
        message = f"too few samples for a test of outliers: {'; '.join(few)}"
        notes.append(_note("outliers_not_tested", message))
    return notes


def _doubted(number: GroupNumber) -> list[str]:
    return [key for key, each in number.values.items() if each.status is Status.DOUBTFUL]


def _too_few(number: GroupNumber) -> str:
    if number.mean is None:
        return ""
    spools = [name for name, mean in number.mean.spool_means.items() for _ in range(mean.n)]
    return too_few_for_outliers(spools)


def compare_groups(
    first: Group, second: Group, *, names: Sequence[str] = (), margin: float | None = None
) -> tuple[Difference, ...]:
    """Tell how two groups differ in the results that both have.

    Parameters
    ----------
    first, second : tested by one protocol
    names : of the results to compare; all if empty
    margin : difference that does not matter in practice, as a share of the mean of the first
        group; None where nobody has said it

    Returns
    -------
    One per result that has a mean in both groups and one unit, in the order of `names`. The margin
    in the unit of the result is taken as known, though the mean behind it was measured. The verdict
    says so where the numbers of the two were not made alike.
    """
    one = {number.name: number for number in first.numbers}
    two = {number.name: number for number in second.numbers}
    wanted = [name for name in (names or one) if name in one and name in two]
    found = (_difference(first.name, one[name], second.name, two[name], margin) for name in wanted)
    return tuple(each for each in found if each is not None)


def _difference(
    first: str, one: GroupNumber, second: str, two: GroupNumber, margin: float | None
) -> Difference | None:
    if one.mean is None or two.mean is None or one.unit != two.unit:
        return None
    size = abs(one.mean.chosen.mean)
    room = None if margin is None or size == 0 else margin * size
    found = compare(one.name, one.unit, (first, one.mean), (second, two.mean), room)
    return replace(found, verdict=found.verdict + apart(one, two))
