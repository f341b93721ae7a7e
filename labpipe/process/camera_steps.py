"""The steps that take marker tracks to the shape of the specimen."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from math import sqrt

import numpy as np

from labpipe.errors import ProcessingError, error_text, nearest
from labpipe.markers.rings import ring_centres, rings_by_body
from labpipe.markers.specimen_frame import SpecimenFrame, specimen_frame
from labpipe.markers.specimen_shape import Offsets, ShapeFit, deflection, fit_shape
from labpipe.markers.track_repair import RepairedTracks, repair_tracks
from labpipe.markers.tracklets import frozen_samples
from labpipe.process.calibrated_signals import Prepared, Take
from labpipe.process.zeros import LEAST, mean_level
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

_MOVES = 0.1
"""Share of its stroke by which the clamp has moved when it has begun to."""
UNLABELLED = ("Unlabeled", "Unlabelled")
_DOUBTFUL = {
    "label_ambiguous",
    "marker_missing",
    "marker_not_at_rest",
    "out_of_plane",
    "shape_missing",
}
"""Notes after which a number that rests on the shape may be wrong. A repair that the rule settles
is noted and flagged, and leaves the numbers as good as they were."""


def repair(
    prepared: Prepared, step: RepairMarkers, words: Markers | None
) -> tuple[Prepared, list[Finding]]:
    """Carry out ``repair-markers``: labels, stale poses, gaps; then rings."""
    take = prepared.take
    tracks, words = _needed(take, words)
    clamp, found = _clamp(tracks, words, step, take.role)
    along, left_out = _along(tracks, words, take.role)
    repaired = repair_tracks(
        tracks,
        along=along,
        max_gap=step.max_gap,
        max_jump=step.max_jump,
        frozen=step.frozen,
        reference=clamp,
    )
    if words.rings == "by-body":
        repaired = _rings(repaired)
    found += [*left_out, *_said(repaired.notes, take.role)]
    return replace(prepared, take=replace(take, clamp=clamp, repaired=repaired)), found


def _rings(repaired: RepairedTracks) -> RepairedTracks:
    rings = rings_by_body(repaired.names)
    if len(rings) < 3:
        message = (
            f"rings by-body make {len(rings)} of {len(repaired.names)} markers ({', '.join(rings)})"
            ": expected at least 3 rings along the specimen, or rings: none"
        )
        raise ValueError(message)
    return ring_centres(repaired, rings)


def turn_into_specimen(
    prepared: Prepared, step: SpecimenFrameStep, words: Markers | None
) -> tuple[Prepared, list[Finding]]:
    """Carry out ``specimen-frame``: the frame, and with a clamp the signal ``travel``."""
    take, found = prepared.take, list[Finding]()
    tracks, words = _needed(take, words)
    if take.repaired is None:
        message = "expected repair-markers before it"
        raise ValueError(message)
    rest = np.asarray(tracks.time <= tracks.time[0] + step.over)
    frame = _frame(take.clamp, take.repaired, rest, step)
    still = _still(tracks.time, frame, take.clamp)
    if LEAST <= (rest & still).sum() < rest.sum():
        rest &= still
        frame = _frame(take.clamp, take.repaired, rest, step)
        message = (
            f"the clamp rests for {float(np.ptp(tracks.time[rest])):.2f} s, less than the "
            f"{step.over:g} s of 'over': these are taken as the rest"
        )
        found.append(info_note("short_rest", take.role, message))
    said = (
        f"markers lie {1e3 * frame.out_of_plane:.3g} mm rms off their plane, the clamp "
        f"{1e3 * frame.travel_residual:.3g} mm rms off its line"
    )
    found += [*_said(frame.notes, take.role), info_note("specimen_frame", take.role, said)]
    signals = prepared.signals
    if take.clamp is not None:
        travel = -frame.to_specimen(take.clamp)[:, 1]
        travel = travel - np.nanmean(travel[rest])
        signals = signals.with_new("travel", take.seen(tracks.time, travel))
    return replace(prepared, signals=signals, take=replace(take, frame=frame, rest=rest)), found


def _frame(
    clamp: Floats | None, repaired: RepairedTracks, rest: Flags, step: SpecimenFrameStep
) -> SpecimenFrame:
    return specimen_frame(
        clamp,
        repaired.positions,
        rest=rest,
        moving=None,
        out_of_plane_limit=step.max_out_of_plane,
    )


def _still(time: Floats, frame: SpecimenFrame, clamp: Floats | None) -> Flags:
    """Frames before the clamp begins to move; all of a take without a clamp."""
    if clamp is None:
        return np.ones(len(time), dtype=np.bool_)
    travel = frame.to_specimen(clamp)[:, 1]
    least = _MOVES * float(np.nanmax(travel) - np.nanmin(travel))
    strokes = find_strokes(time, travel, min_stroke=least)
    return np.asarray(time < (time[strokes[0].start] if strokes else np.inf), dtype=np.bool_)


def fit_shapes(
    prepared: Prepared, step: FitShape, words: Markers | None
) -> tuple[Prepared, list[Finding]]:
    """Carry out ``fit-shape``: the shape and the signal ``deflection``."""
    take, signals = prepared.take, prepared.signals
    tracks, words = _needed(take, words)
    frame, rest = take.frame, take.rest
    if frame is None or rest is None:
        message = "expected repair-markers and specimen-frame before it"
        raise ValueError(message)
    fit = _shape(take, tracks, frame, step, words)
    found = list(_said(fit.notes, take.role))
    misfit, at_rest = rms(fit.residual), rms(fit.residual[rest])
    if misfit > 3.0 * at_rest + 1e-5 and take.clamp is not None:
        message = (
            f"markers lie {1e3 * misfit:.3g} mm rms off the fitted curve over the test, "
            f"{1e3 * at_rest:.3g} mm at rest: look at grip_offset, centre_offset and terms"
        )
        found.append(doubtful("shape_misfit", take.role, message, "displacement"))
    said = (
        f"markers lie {1e3 * misfit:.3g} mm rms off the fitted curve, the clamped end "
        f"points {np.degrees(fit.clamp_angle):.2f} deg off x"
    )
    found.append(info_note("shape_fit", take.role, said))
    if take.clamp is not None:
        signals = signals.with_new("deflection", _deflection(fit, rest, take))
        stretch = tracks.time[rest]
        at_rest_for = (float(stretch[0]), float(stretch[-1]))
        signals = replace(signals, zeroed={**signals.zeroed, "deflection": at_rest_for})
    return replace(prepared, signals=signals, shape=fit.shape), found


def _shape(
    take: Take, tracks: MarkerTracks, frame: SpecimenFrame, step: FitShape, words: Markers
) -> ShapeFit:
    if take.repaired is None or take.rest is None:
        message = "expected repair-markers and specimen-frame before it"
        raise ValueError(message)
    order = list(frame.order)
    return fit_shape(
        frame.to_specimen(take.repaired.positions[:, order]),
        take.repaired.flags[:, order],
        [take.repaired.names[column] for column in order],
        tracks.time,
        clamp_specimen=None if take.clamp is None else frame.to_specimen(take.clamp),
        rotation_lab_to_specimen=frame.rotation_lab_to_specimen,
        offsets=Offsets(words.grip_offset, words.pull_offset, words.centre_offset),
        uncertainties=Offsets(
            words.offset_uncertainty, words.offset_uncertainty, words.centre_uncertainty
        ),
        terms=step.terms,
        tip=step.tip,
        rest=take.rest,
    )


def _deflection(fit: ShapeFit, rest: Flags, take: Take) -> Signal:
    """Deflection of the pull point, and what it is with other offsets and another shape.

    One more term is as good an assumption as the one taken: the change counts as the half width of
    a rectangle, whose standard uncertainty is 1 / sqrt(3) of it.
    """
    values = deflection(fit.shape, rest=rest)
    seen = ~np.isnan(values)
    _, error = mean_level(values[rest & seen], values[~rest])
    change = fit.tip_systematic[:, 1]
    usable = not np.isnan(change[rest]).all()
    moved = {cause: lift - np.nanmean(lift[rest]) for cause, lift in fit.tip_moved.items()}
    if usable:
        moved[SHAPE] = values + (change - np.nanmean(change[rest])) / sqrt(3.0)
    return replace(take.seen(fit.shape.time, values), zero_error=error, moved=moved)


def _said(notes: Iterable[QualityNote], role: str) -> Iterator[Finding]:
    """Findings of notes; one that leaves the shape in doubt touches the displacement."""
    for note in notes:
        if note.code in _DOUBTFUL:
            yield doubtful_stretches("displacement", note, role)
        else:
            yield Finding(note)


def _needed(take: Take, words: Markers | None) -> tuple[MarkerTracks, Markers]:
    if take.tracks is None or words is None:
        message = "expected a role with marker tracks and a block markers:"
        raise ValueError(message)
    return take.tracks, words


def _clamp(
    tracks: MarkerTracks, words: Markers, step: RepairMarkers, role: str
) -> tuple[Floats | None, list[Finding]]:
    if words.clamp is None:
        return None, []
    body = tracks.body(words.clamp)
    if body is None:
        known = nearest(words.clamp, [body.name for body in tracks.bodies])
        message = error_text(
            role,
            "rigid bodies",
            expected=f"the clamp {words.clamp!r}",
            found=", ".join(map(repr, known)) if known else "no rigid body in the take",
            remedy="Name the body of the take in markers.clamp, or export the take with it.",
        )
        raise ProcessingError(message)
    if np.isnan(body.position).all():
        message = error_text(
            role,
            f"rigid body {words.clamp!r}",
            expected="positions",
            found="blanks in every frame",
            remedy="Solve the body in Motive and export the take again.",
        )
        raise ProcessingError(message)
    return _steady(tracks, body, step, role)


def _steady(
    tracks: MarkerTracks, body: RigidBody, step: RepairMarkers, role: str
) -> tuple[Floats, list[Finding]]:
    """Path of the clamp without stale poses, its short gaps bridged by straight lines."""
    together = np.concatenate([body.position[:, None], tracks.positions], axis=1)
    stale = frozen_samples(together, tracks.time, frozen=step.frozen)[:, 0]
    path: Floats = np.where(stale[:, None], np.nan, body.position)
    found: list[Finding] = []
    if stale.any():
        message = f"{body.name} holds its last pose in {int(stale.sum())} frames: taken as lost"
        when = times_of(stale, tracks.time)
        note = QualityNote("clamp_frozen", Severity.WARNING, body.name, message, when)
        found.append(doubtful_stretches("displacement", note, role))
    lost = np.isnan(path).any(axis=1)
    if not lost.any():
        return path, found
    known = np.flatnonzero(~lost)
    before = np.searchsorted(known, np.flatnonzero(lost)) - 1
    inside = (before >= 0) & (before < len(known) - 1)
    gap = np.full(len(before), np.inf)
    gap[inside] = np.diff(tracks.time[known])[before[inside]]
    bridged = np.flatnonzero(lost)[gap <= step.max_gap]
    for axis in range(3):
        at, seen = tracks.time[bridged], path[known, axis]
        path[bridged, axis] = np.interp(at, tracks.time[known], seen)
    message = (
        f"{body.name} is lost in {int(lost.sum())} frames, {len(bridged)} of them bridged by "
        f"straight lines (gaps up to {step.max_gap:g} s)"
    )
    return path, [*found, warning("clamp_lost", body.name, message)]


def _along(tracks: MarkerTracks, words: Markers, role: str) -> tuple[list[str], list[Finding]]:
    """Names of the tracks along the specimen, unlabelled ones included."""
    found: list[Finding] = []
    bodies = [body.name for body in tracks.bodies] if words.along == "all" else []
    # Motive 1.2x parts body and marker by a colon, 1.1 by a hyphen.
    own = tuple(f"{name}{mark}" for name in {*bodies, words.clamp} if name for mark in ":-")
    candidates = [name for name in tracks.names if not name.startswith(own)]
    others = sorted({name for name in bodies if name != words.clamp})
    if others:
        message = f"markers of {', '.join(others)} are not the specimen's: name them to use them"
        found.append(info_note("bodies_left_out", role, message))
    if words.along != "all":
        patterns = words.along
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
            remedy="Look at the take with `labpipe inspect`, and at markers.along.",
        )
        raise ProcessingError(message)
    return candidates, found


def rms(values: Floats) -> float:
    """Root mean square of what is not NaN; NaN when nothing is."""
    known = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
