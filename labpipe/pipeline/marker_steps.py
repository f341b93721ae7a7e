"""The steps that take marker tracks to the shape of the specimen."""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase

import numpy as np

from labpipe.errors import ProcessingError, complaint, nearest
from labpipe.markers.rings import ring_centres, rings_by_body
from labpipe.markers.specimen_frame import SpecimenFrame, specimen_frame
from labpipe.markers.specimen_shape import ShapeFit, deflection, fit_shape
from labpipe.markers.track_repair import RepairedTracks, repair_tracks
from labpipe.markers.tracklets import frozen_samples
from labpipe.pipeline.bench import Bench, MarkerBench, Signal, rms
from labpipe.pipeline.zeros import LEAST, mean_level
from labpipe.protocol.schema import Markers
from labpipe.records.arrays import Flags, Floats, times_of
from labpipe.records.estimates import Estimate, Failure
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import MarkerTracks, RigidBody
from labpipe.records.step_settings import FitShape, RepairMarkers
from labpipe.records.step_settings import SpecimenFrame as SpecimenFrameStep
from labpipe.signal.turning_points import find_strokes, noise_level

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


def repair(bench: Bench, markers: MarkerBench, step: RepairMarkers, words: Markers | None) -> None:
    """Carry out ``repair-markers``: labels, stale poses, gaps; then rings."""
    tracks, words = _needed(markers, words)
    markers.clamp = _clamp(bench, tracks, words, step, markers.role)
    repaired = repair_tracks(
        tracks,
        along=_along(bench, tracks, words, markers.role),
        max_gap=step.max_gap,
        max_jump=step.max_jump,
        frozen=step.frozen,
        reference=markers.clamp,
    )
    if words.rings == "by-body":
        repaired = _rings(repaired)
    markers.repaired = repaired
    _take_notes(bench, repaired.notes, markers.role)


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
    bench: Bench, markers: MarkerBench, step: SpecimenFrameStep, words: Markers | None
) -> None:
    """Carry out ``specimen-frame``: the frame, and with a clamp the signal ``travel``."""
    tracks, words = _needed(markers, words)
    if markers.repaired is None:
        message = "expected repair-markers before it"
        raise ValueError(message)
    markers.rest = np.asarray(tracks.time <= tracks.time[0] + step.over)
    markers.frame = _frame(markers.clamp, markers.repaired, markers.rest, step)
    still = _still(tracks.time, markers.frame, markers.clamp)
    if LEAST <= (markers.rest & still).sum() < markers.rest.sum():
        markers.rest &= still
        markers.frame = _frame(markers.clamp, markers.repaired, markers.rest, step)
        message = (
            f"the clamp rests for {float(np.ptp(tracks.time[markers.rest])):.2f} s, less than the "
            f"{step.over:g} s of 'over': these are taken as the rest"
        )
        bench.note("short_rest", Severity.INFO, markers.role, message)
    _take_notes(bench, markers.frame.notes, markers.role)
    said = (
        f"markers lie {1e3 * markers.frame.out_of_plane:.3g} mm rms off their plane, the clamp "
        f"{1e3 * markers.frame.travel_residual:.3g} mm rms off its line"
    )
    bench.note("specimen_frame", Severity.INFO, markers.role, said)
    if markers.clamp is not None:
        travel = -markers.frame.to_specimen(markers.clamp)[:, 1]
        travel = travel - np.nanmean(travel[markers.rest])
        signal = Signal(tracks.time, travel, "m", markers.role)
        bench.raw["travel"] = bench.signals["travel"] = signal


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


def fit_shapes(bench: Bench, markers: MarkerBench, step: FitShape, words: Markers | None) -> None:
    """Carry out ``fit-shape``: the shape and the signal ``deflection``."""
    tracks, words = _needed(markers, words)
    frame, repaired, rest = markers.frame, markers.repaired, markers.rest
    if frame is None or repaired is None or rest is None:
        message = "expected repair-markers and specimen-frame before it"
        raise ValueError(message)
    order = list(frame.order)
    fit = fit_shape(
        frame.to_specimen(repaired.positions[:, order]),
        repaired.flags[:, order],
        [repaired.names[column] for column in order],
        tracks.time,
        clamp_specimen=None if markers.clamp is None else frame.to_specimen(markers.clamp),
        rotation_lab_to_specimen=frame.rotation_lab_to_specimen,
        grip_offset=words.grip_offset,
        pull_offset=words.pull_offset,
        centre_offset=words.centre_offset,
        terms=step.terms,
        tip=step.tip,
        rest=rest,
    )
    bench.shape = fit.shape
    _take_notes(bench, fit.notes, markers.role)
    misfit, at_rest = rms(fit.residual), rms(fit.residual[rest])
    if misfit > 3.0 * at_rest + 1e-5 and markers.clamp is not None:
        message = (
            f"markers lie {1e3 * misfit:.3g} mm rms off the fitted curve over the test, "
            f"{1e3 * at_rest:.3g} mm at rest: look at grip_offset, centre_offset and terms"
        )
        bench.doubt("displacement", "shape_misfit", message, where=markers.role)
    said = (
        f"markers lie {1e3 * rms(fit.residual):.3g} mm rms off the fitted curve, the clamped end "
        f"points {np.degrees(fit.clamp_angle):.2f} deg off x"
    )
    bench.note("shape_fit", Severity.INFO, markers.role, said)
    if markers.clamp is not None:
        signal = _deflection(fit, rest, markers.role)
        bench.raw["deflection"] = bench.signals["deflection"] = signal
        stretch = tracks.time[rest]
        bench.zeroed["deflection"] = (float(stretch[0]), float(stretch[-1]))


def _deflection(fit: ShapeFit, rest: Flags, role: str) -> Signal:
    """Deflection of the pull point, with what one more term of the shape would make of it."""
    values = deflection(fit.shape, rest=rest)
    seen = ~np.isnan(values)
    _, error = mean_level(values[rest & seen], values[~rest])
    change = fit.tip_systematic[:, 1]
    usable = not np.isnan(change[rest]).all()
    other = values + change - np.nanmean(change[rest]) if usable else None
    return Signal(fit.shape.time, values, "m", role, zero_error=error, alternative=other)


def tip_travel(bench: Bench) -> Estimate | Failure:
    """How far the last point of the shape gets from where it began, m."""
    if bench.shape is None:
        return Failure("no_shape", "the protocol fits no shape")
    tip = bench.shape.positions[:, -1]
    known = np.isfinite(tip).all(axis=1)
    if known.sum() < 16:
        return Failure("too_few_samples", f"the tip is seen in {int(known.sum())} frames")
    begin = tip[known][:5].mean(axis=0)
    away = np.linalg.norm(tip[known] - begin, axis=1)
    error = np.sqrt(2.0) * noise_level(away)
    return Estimate(float(away.max()), float(error), int(known.sum()))


def _take_notes(bench: Bench, notes: Iterable[QualityNote], role: str) -> None:
    """Keep notes; one that leaves the shape in doubt marks what rests on the displacement."""
    for note in notes:
        if note.code in _DOUBTFUL:
            bench.doubt_stretches("displacement", note, role)
        else:
            bench.note(note.code, note.severity, note.where, note.message)


def _needed(markers: MarkerBench, words: Markers | None) -> tuple[MarkerTracks, Markers]:
    if markers.tracks is None or words is None:
        message = "expected a role with marker tracks and a block markers:"
        raise ValueError(message)
    return markers.tracks, words


def _clamp(
    bench: Bench, tracks: MarkerTracks, words: Markers, step: RepairMarkers, role: str
) -> Floats | None:
    if words.clamp is None:
        return None
    body = tracks.body(words.clamp)
    if body is None:
        known = nearest(words.clamp, [body.name for body in tracks.bodies])
        message = complaint(
            role,
            "rigid bodies",
            expected=f"the clamp {words.clamp!r}",
            found=", ".join(map(repr, known)) if known else "no rigid body in the take",
            remedy="Name the body of the take in markers.clamp, or export the take with it.",
        )
        raise ProcessingError(message)
    if np.isnan(body.position).all():
        message = complaint(
            role,
            f"rigid body {words.clamp!r}",
            expected="positions",
            found="blanks in every frame",
            remedy="Solve the body in Motive and export the take again.",
        )
        raise ProcessingError(message)
    return _steady(bench, tracks, body, step, role)


def _steady(
    bench: Bench, tracks: MarkerTracks, body: RigidBody, step: RepairMarkers, role: str
) -> Floats:
    """Path of the clamp without stale poses, its short gaps bridged by straight lines."""
    together = np.concatenate([body.position[:, None], tracks.positions], axis=1)
    stale = frozen_samples(together, tracks.time, frozen=step.frozen)[:, 0]
    path: Floats = np.where(stale[:, None], np.nan, body.position)
    if stale.any():
        message = f"{body.name} holds its last pose in {int(stale.sum())} frames: taken as lost"
        when = times_of(stale, tracks.time)
        note = QualityNote("clamp_frozen", Severity.WARNING, body.name, message, when)
        bench.doubt_stretches("displacement", note, role)
    lost = np.isnan(path).any(axis=1)
    if not lost.any():
        return path
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
    bench.note("clamp_lost", Severity.WARNING, body.name, message)
    return path


def _along(bench: Bench, tracks: MarkerTracks, words: Markers, role: str) -> list[str]:
    """Names of the tracks along the specimen, unlabelled ones included."""
    bodies = [body.name for body in tracks.bodies] if words.along == "all" else []
    # Motive 1.2x parts body and marker by a colon, 1.1 by a hyphen.
    own = tuple(f"{name}{mark}" for name in {*bodies, words.clamp} if name for mark in ":-")
    candidates = [name for name in tracks.names if not name.startswith(own)]
    others = sorted({name for name in bodies if name != words.clamp})
    if others:
        message = f"markers of {', '.join(others)} are not the specimen's: name them to use them"
        bench.note("bodies_left_out", Severity.INFO, role, message)
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
        message = complaint(
            role,
            "markers",
            expected="at least 3 markers along the specimen",
            found=f"{len(seen)}: {', '.join(seen) or 'none'}",
            remedy="Look at the take with `labpipe inspect`, and at markers.along.",
        )
        raise ProcessingError(message)
    return candidates
