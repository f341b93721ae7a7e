"""The mean curve of a group: of which samples, over spools or not, as force or as its share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.group import Band, NestedMean, Sample
from labpipe.records.quality import QualityNote, Severity
from labpipe.statistics.bands import CommonCurves, common_curves, mean_band
from labpipe.statistics.block_means import block_means
from labpipe.statistics.group_notes import group_note, sample_keys
from labpipe.statistics.nested import USUAL, PoolingLimits, nested_mean

_POINTS = 500
"""Points of a curve before it is averaged with others, each the mean of its samples: noise that is
faster says nothing about the sample and makes the band of the whole curve wide."""


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
        for key, sample in zip(sample_keys(samples), samples, strict=True)
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
        notes.append(group_note("curve_pooling", f"{by} {decision.decision}"))
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


def scaled_band(samples: Sequence[Sample], limits: PoolingLimits) -> tuple[Band, list[QualityNote]]:
    """Mean curve of force over the peak force of the same sample.

    Parameters
    ----------
    samples : those without a positive peak force are left out, with a note
    limits : when spools may be pooled

    Returns
    -------
    The band (force without a unit) and notes, as `loading_band` gives them; their codes end in
    ``_scaled``.
    """
    peaks = dict(zip(sample_keys(samples), (_peak(sample) for sample in samples), strict=True))
    usable = {key: peak for key, peak in peaks.items() if peak > 0}
    band, notes = loading_band(samples, limits, divisors=usable)
    without = [key for key in peaks if key not in usable]
    told = [
        group_note(f"{note.code}_scaled", f"Force / peak force: {note.message}")
        for note in notes
        if note.code != "no_curve"
    ]
    if without:
        message = (
            f"not in the mean of force / peak force, without a peak force: {', '.join(without)}"
        )
        told.append(group_note("no_peak_force", message, Severity.WARNING))
    return band, told


def _peak(sample: Sample) -> float:
    """Peak force of the first cycle, N; its largest force where that is no result; NaN without."""
    stated = [result for result in sample.results if result.name == "peak_force.1"]
    if stated:
        return float("nan") if stated[0].value is None else stated[0].value
    forces: Floats = sample.loading[0].force if sample.loading else np.zeros(0)
    known = forces[~np.isnan(forces)]
    return float(known.max()) if len(known) else float("nan")


def _curve_notes(samples: Sequence[Sample], shared: CommonCurves) -> list[QualityNote]:
    without = [
        key for key, sample in zip(sample_keys(samples), samples, strict=True) if not sample.loading
    ]
    notes = []
    if without:
        message = f"not in the mean curve, without a loading branch: {', '.join(without)}"
        notes.append(group_note("no_curve", message, Severity.WARNING))
    gaps = _gaps(shared.displacement)
    if gaps:
        message = f"the mean curve leaves out where a sample has a gap: {', '.join(gaps)}"
        notes.append(group_note("gap_in_curves", message, Severity.WARNING))
    return notes


def _gaps(displacement: Floats) -> list[str]:
    """Ranges, in words, where an evenly spaced grid has points missing."""
    steps = np.diff(displacement)
    if not len(steps):
        return []
    wide = np.flatnonzero(steps > 1.5 * steps.min())
    ends = [(1e3 * displacement[at], 1e3 * displacement[at + 1]) for at in wide]
    return [f"{start:.4g} mm to {stop:.4g} mm" for start, stop in ends]
