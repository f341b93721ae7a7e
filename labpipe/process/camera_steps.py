"""The steps that take marker tracks to the shape of the specimen."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import partial
from math import sqrt

import numpy as np

from labpipe.errors import ProcessingError, error_text, nearest
from labpipe.markers.rings import ring_centres, rings_by_body
from labpipe.markers.specimen_frame import SpecimenFrame, specimen_frame
from labpipe.markers.specimen_shape import Offsets, ShapeFit, deflection, fit_shape
from labpipe.markers.track_repair import RepairedTracks, repair_tracks
from labpipe.markers.tracklets import frozen_samples
from labpipe.process.calibrated_signals import Prepared, Take
from labpipe.process.zeros import MIN_SAMPLES_NOISE_UNKNOWN, mean_level
from labpipe.protocol.schema import Markers
from labpipe.records.arrays import Flags, Floats, times_of
from labpipe.records.causes import SHAPE
from labpipe.records.declarations import FitShape, RepairMarkers
from labpipe.records.declarations import SpecimenFrame as SpecimenFrameStep
from labpipe.records.quality import (
    Finding,
    QualityNote,
    Severity,
    doubtful,
    doubtful_stretches,
    info_note,
    warning,
)
from labpipe.records.recording import MarkerTracks, RigidBody
from labpipe.records.signals import Signal
from labpipe.signal.turning_points import find_strokes

UNLABELLED = ("Unlabeled", "Unlabelled")
_DOUBTFUL = {
    "label_ambiguous",
    "marker_missing",
    "marker_not_at_rest",
    "out_of_plane",
    "shape_missing",
}
"""Notes after which numbers that use the shape may be wrong. A repair by a rule is only noted."""


def repair(
    prepared: Prepared, step: RepairMarkers, settings: Markers | None
) -> tuple[Prepared, list[Finding]]:
    """Carry out ``repair-markers``: labels, stale poses, gaps; then rings."""
    take = prepared.take
    tracks, settings = _require_markers(take, settings)
    clamp, findings = _find_clamp(tracks, settings, step, take.role)
    names, left_out = _specimen_tracks(tracks, settings, take.role)
    repaired = repair_tracks(
        tracks,
        along=names,
        max_gap=step.max_gap,
        max_jump=step.max_jump,
        frozen=step.frozen,
        reference=clamp,
    )
    if settings.rings == "by-body":
        repaired = _ring_centres(repaired)
    findings += [*left_out, *_shape_findings(repaired.notes, take.role)]
    return replace(prepared, take=replace(take, clamp=clamp, repaired=repaired)), findings


def _ring_centres(repaired: RepairedTracks) -> RepairedTracks:
    rings = rings_by_body(repaired.names)
    if len(rings) < 3:
        message = (
            f"rings by-body make {len(rings)} of {len(repaired.names)} markers ({', '.join(rings)})"
            ": expected at least 3 rings along the specimen, or rings: none"
        )
        raise ValueError(message)
    return ring_centres(repaired, rings)


def turn_into_specimen(
    prepared: Prepared, step: SpecimenFrameStep, settings: Markers | None
) -> tuple[Prepared, list[Finding]]:
    """Carry out ``specimen-frame``: the frame, and with a clamp the signal ``travel``."""
    take, findings = prepared.take, list[Finding]()
    tracks, settings = _require_markers(take, settings)
    if take.repaired is None:
        message = "expected the step repair-markers before it"
        raise ValueError(message)
    rest = np.asarray(tracks.time <= tracks.time[0] + step.over)
    find_frame = partial(
        specimen_frame,
        take.clamp,
        take.repaired.positions,
        out_of_plane_limit=step.max_out_of_plane,
    )
    frame = find_frame(rest=rest)
    still = _before_motion(tracks.time, frame, take.clamp)
    if MIN_SAMPLES_NOISE_UNKNOWN <= (rest & still).sum() < rest.sum():
        rest &= still
        frame = find_frame(rest=rest)
        message = (
            f"the clamp rests for {float(np.ptp(tracks.time[rest])):.2f} s, less than the "
            f"{step.over:g} s of 'over': only this time is used as rest"
        )
        findings.append(info_note("short_rest", take.role, message))
    summary = (
        f"the markers are {1e3 * frame.out_of_plane:.3g} mm rms off their plane, the clamp "
        f"{1e3 * frame.travel_residual:.3g} mm rms off its line"
    )
    findings += [
        *_shape_findings(frame.notes, take.role),
        info_note("specimen_frame", take.role, summary),
    ]
    signals = prepared.signals
    if take.clamp is not None:
        travel = -frame.to_specimen(take.clamp)[:, 1]
        travel = travel - np.nanmean(travel[rest])
        signals = signals.with_new("travel", take.signal_of(tracks.time, travel))
    return replace(prepared, signals=signals, take=replace(take, frame=frame, rest=rest)), findings


def _before_motion(time: Floats, frame: SpecimenFrame, clamp: Floats | None) -> Flags:
    """Flag frames before the clamp begins to move; all frames of a take without a clamp."""
    # Share of the stroke of the clamp at which it counts as moving.
    moved_share = 0.1
    if clamp is None:
        return np.ones(len(time), dtype=np.bool_)
    travel = frame.to_specimen(clamp)[:, 1]
    min_stroke = moved_share * float(np.nanmax(travel) - np.nanmin(travel))
    strokes = find_strokes(time, travel, min_stroke=min_stroke)
    return np.asarray(time < (time[strokes[0].start] if strokes else np.inf), dtype=np.bool_)


def fit_shapes(
    prepared: Prepared, step: FitShape, settings: Markers | None
) -> tuple[Prepared, list[Finding]]:
    """Carry out ``fit-shape``: the shape and the signal ``deflection``."""
    take, signals = prepared.take, prepared.signals
    tracks, settings = _require_markers(take, settings)
    frame, rest = take.frame, take.rest
    if frame is None or rest is None:
        message = "expected the steps repair-markers and specimen-frame before it"
        raise ValueError(message)
    fit = _fit_shape(take, tracks, frame, step, settings)
    findings = list(_shape_findings(fit.notes, take.role))
    misfit, at_rest = rms(fit.residual), rms(fit.residual[rest])
    if misfit > 3.0 * at_rest + 1e-5 and take.clamp is not None:
        message = (
            f"the markers are {1e3 * misfit:.3g} mm rms off the fitted curve over the test, "
            f"{1e3 * at_rest:.3g} mm at rest: check grip_offset, centre_offset and terms"
        )
        findings.append(doubtful("shape_misfit", take.role, message, "displacement"))
    summary = (
        f"the markers are {1e3 * misfit:.3g} mm rms off the fitted curve, the clamped end "
        f"is {np.degrees(fit.clamp_angle):.2f} deg off the x axis"
    )
    findings.append(info_note("shape_fit", take.role, summary))
    if take.clamp is not None:
        signals = signals.with_new("deflection", _deflection(fit, rest, take))
        stretch = tracks.time[rest]
        at_rest_for = (float(stretch[0]), float(stretch[-1]))
        signals = replace(signals, zeroed={**signals.zeroed, "deflection": at_rest_for})
    return replace(prepared, signals=signals, shape=fit.shape), findings


def _fit_shape(
    take: Take, tracks: MarkerTracks, frame: SpecimenFrame, step: FitShape, settings: Markers
) -> ShapeFit:
    if take.repaired is None or take.rest is None:
        message = "expected the steps repair-markers and specimen-frame before it"
        raise ValueError(message)
    order = list(frame.order)
    return fit_shape(
        frame.to_specimen(take.repaired.positions[:, order]),
        take.repaired.flags[:, order],
        [take.repaired.names[column] for column in order],
        tracks.time,
        clamp_specimen=None if take.clamp is None else frame.to_specimen(take.clamp),
        rotation_lab_to_specimen=frame.rotation_lab_to_specimen,
        offsets=Offsets(settings.grip_offset, settings.pull_offset, settings.centre_offset),
        uncertainties=Offsets(
            settings.offset_uncertainty, settings.offset_uncertainty, settings.centre_uncertainty
        ),
        terms=step.terms,
        tip=step.tip,
        rest=take.rest,
    )


def _deflection(fit: ShapeFit, rest: Flags, take: Take) -> Signal:
    """Compute the deflection of the pull point, also with other offsets and another shape.

    The change with one more term is the half width of a rectangular distribution, whose standard
    uncertainty is 1 / sqrt(3) of it.
    """
    values = deflection(fit.shape, rest=rest)
    seen = ~np.isnan(values)
    _, error = mean_level(values[rest & seen], values[~rest])
    change = fit.tip_systematic[:, 1]
    usable = not np.isnan(change[rest]).all()
    moved = {cause: lift - np.nanmean(lift[rest]) for cause, lift in fit.tip_moved.items()}
    if usable:
        moved[SHAPE] = values + (change - np.nanmean(change[rest])) / sqrt(3.0)
    return replace(take.signal_of(fit.shape.time, values), zero_error=error, moved=moved)


def _shape_findings(notes: Iterable[QualityNote], role: str) -> Iterator[Finding]:
    """Make findings of notes; those that make the shape doubtful also doubt the displacement."""
    for note in notes:
        if note.code in _DOUBTFUL:
            yield doubtful_stretches("displacement", note, role)
        else:
            yield Finding(note)


def _require_markers(take: Take, settings: Markers | None) -> tuple[MarkerTracks, Markers]:
    if take.tracks is None or settings is None:
        message = "expected a role with marker tracks and a block markers:"
        raise ValueError(message)
    return take.tracks, settings


def _find_clamp(
    tracks: MarkerTracks, settings: Markers, step: RepairMarkers, role: str
) -> tuple[Floats | None, list[Finding]]:
    if settings.clamp is None:
        return None, []
    body = tracks.body(settings.clamp)
    if body is None:
        near_names = nearest(settings.clamp, [body.name for body in tracks.bodies])
        message = error_text(
            role,
            "rigid bodies",
            expected=f"the clamp {settings.clamp!r}",
            found=", ".join(map(repr, near_names)) if near_names else "no rigid body in the take",
            remedy="Name the body of the take in markers.clamp, or export the take with it.",
        )
        raise ProcessingError(message)
    if np.isnan(body.position).all():
        message = error_text(
            role,
            f"rigid body {settings.clamp!r}",
            expected="positions",
            found="blanks in every frame",
            remedy="Solve the body in Motive and export the take again.",
        )
        raise ProcessingError(message)
    return _clamp_path(tracks, body, step, role)


def _clamp_path(
    tracks: MarkerTracks, body: RigidBody, step: RepairMarkers, role: str
) -> tuple[Floats, list[Finding]]:
    """Return the path of the clamp without stale poses, short gaps interpolated linearly."""
    together = np.concatenate([body.position[:, None], tracks.positions], axis=1)
    stale = frozen_samples(together, tracks.time, frozen=step.frozen)[:, 0]
    path: Floats = np.where(stale[:, None], np.nan, body.position)
    findings: list[Finding] = []
    if stale.any():
        message = f"{body.name} keeps its last pose for {int(stale.sum())} frames: treated as lost"
        times = times_of(stale, tracks.time)
        note = QualityNote("clamp_frozen", Severity.WARNING, body.name, message, times)
        findings.append(doubtful_stretches("displacement", note, role))
    lost = np.isnan(path).any(axis=1)
    if not lost.any():
        return path, findings
    seen_frames = np.flatnonzero(~lost)
    before = np.searchsorted(seen_frames, np.flatnonzero(lost)) - 1
    inside = (before >= 0) & (before < len(seen_frames) - 1)
    gap = np.full(len(before), np.inf)
    gap[inside] = np.diff(tracks.time[seen_frames])[before[inside]]
    bridged = np.flatnonzero(lost)[gap <= step.max_gap]
    for axis in range(3):
        bridge_times, coordinates = tracks.time[bridged], path[seen_frames, axis]
        path[bridged, axis] = np.interp(bridge_times, tracks.time[seen_frames], coordinates)
    message = (
        f"{body.name} is lost in {int(lost.sum())} frames, {len(bridged)} of them bridged by "
        f"linear interpolation (gaps up to {step.max_gap:g} s)"
    )
    return path, [*findings, warning("clamp_lost", body.name, message)]


def _specimen_tracks(
    tracks: MarkerTracks, settings: Markers, role: str
) -> tuple[list[str], list[Finding]]:
    """List the tracks along the specimen, including unlabelled ones."""
    findings: list[Finding] = []
    bodies = [body.name for body in tracks.bodies] if settings.along == "all" else []
    # Motive 1.2x separates body and marker by a colon, 1.1 by a hyphen.
    prefixes = tuple(f"{name}{mark}" for name in {*bodies, settings.clamp} if name for mark in ":-")
    candidates = [name for name in tracks.names if not name.startswith(prefixes)]
    other_bodies = sorted({name for name in bodies if name != settings.clamp})
    if other_bodies:
        message = f"markers of {', '.join(other_bodies)} are not used; markers.along can name them"
        findings.append(info_note("bodies_left_out", role, message))
    if settings.along != "all":
        patterns = settings.along
        candidates = [
            name
            for name in candidates
            if name.startswith(UNLABELLED)
            or any(name == pattern or fnmatchcase(name, pattern) for pattern in patterns)
        ]
    seen = [name for name in candidates if tracks.missing[name] < len(tracks.time)]
    if len(seen) < 3:
        message = error_text(
            role,
            "markers",
            expected="at least 3 markers along the specimen",
            found=f"{len(seen)}: {', '.join(seen) or 'none'}",
            remedy="Check the take with `labpipe inspect`, and markers.along.",
        )
        raise ProcessingError(message)
    return candidates, findings


def rms(values: Floats) -> float:
    """Return the root mean square of the finite values; NaN if there are none."""
    finite = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")
