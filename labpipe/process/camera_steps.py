"""The steps that take marker tracks to the shape of the specimen, clamped or on two supports."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from labpipe.errors import ProcessingError, complaint, nearest
from labpipe.markers.rings import Sections, find_sections, ring_centres, rings_by_body
from labpipe.markers.specimen_frame import SpecimenFrame, specimen_frame
from labpipe.markers.specimen_shape import Offsets, ShapeFit, deflection, fit_shape
from labpipe.markers.three_point_axis import SpanShape, fit_span
from labpipe.markers.track_repair import RepairedTracks, repair_tracks
from labpipe.markers.tracklets import frozen_samples
from labpipe.process.calibrated_signals import Prepared, Take
from labpipe.process.motion import turning_points
from labpipe.process.zeros import LEAST, mean_level
from labpipe.protocol.schema import Markers, Protocol
from labpipe.records.arrays import Flags, Floats, times_of
from labpipe.records.causes import SHAPE
from labpipe.records.curve import ClockFit, Interval, PointFlag, Shape
from labpipe.records.declarations import FitShape, RepairMarkers, ThreePointShape
from labpipe.records.declarations import SpecimenFrame as SpecimenFrameStep
from labpipe.records.estimates import Failure
from labpipe.records.quality import (
    Finding,
    QualityNote,
    Severity,
    doubtful,
    doubtful_stretches,
    not_available,
    warning,
    worth_knowing,
)
from labpipe.records.recording import MarkerTracks, RigidBody
from labpipe.records.signals import Signal
from labpipe.results.evidence import SpanBend
from labpipe.signal.clock_alignment import match_peaks
from labpipe.signal.turning_points import Stroke, find_strokes
from labpipe.uncertainty.noise import long_run_variance

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
        found.append(worth_knowing("short_rest", take.role, message))
    said = (
        f"markers lie {1e3 * frame.out_of_plane:.3g} mm rms off their plane, the clamp "
        f"{1e3 * frame.travel_residual:.3g} mm rms off its line"
    )
    found += [*_said(frame.notes, take.role), worth_knowing("specimen_frame", take.role, said)]
    signals = prepared.signals
    if take.clamp is not None:
        travel = -frame.to_specimen(take.clamp)[:, 1]
        travel = travel - np.nanmean(travel[rest])
        signals = signals.with_new("travel", _seen(tracks.time, travel, take))
    return replace(prepared, signals=signals, take=replace(take, frame=frame, rest=rest)), found


def _seen(time: Floats, values: Floats, take: Take) -> Signal:
    """A length that cameras saw, on their clock and with what is known of their scale."""
    return Signal(time, values, "m", take.role, relative_error=take.scale_error)


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
    found.append(worth_knowing("shape_fit", take.role, said))
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
    return replace(_seen(fit.shape.time, values, take), zero_error=error, moved=moved)


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
        found.append(worth_knowing("bodies_left_out", role, message))
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
    return candidates, found


def rms(values: Floats) -> float:
    """Root mean square of what is not NaN; NaN when nothing is."""
    known = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


NO_SPAN = Failure(
    "no_span",
    "specimen.span, the distance of the supports, is not given: write it into the specimen of the "
    "test sheet, such as 'span: 152.4 mm'",
)
_WINDOW = 25.0
"""s on each side of a turn of mid-span."""
_DRIFT = 1e-4 / sqrt(3.0)
"""Standard uncertainty of the rate of the cameras' clock, which one turn does not show."""
_DRAWN = 9
"""Degree of the curve that is stored to be drawn."""


def bend_between_supports(
    prepared: Prepared, step: ThreePointShape, protocol: Protocol
) -> tuple[Prepared, list[Finding]]:
    """Carry out ``three-point-shape``: the bent axis, and the signal ``mid_span``.

    Parameters
    ----------
    prepared : with repaired tracks
    step : of the protocol
    protocol : its span and its marker block

    Returns
    -------
    With axis, shape and signal, or why there is none.

    Raises
    ------
    ValueError
        If the markers were not repaired before.
    """
    take, words = prepared.take, protocol.markers
    tracks, repaired = take.tracks, take.repaired
    if tracks is None or words is None or repaired is None:
        message = "expected a role with marker tracks, a block markers: and repair-markers before"
        raise ValueError(message)
    span = protocol.specimen.span
    if span is None:
        return _given_up(prepared, NO_SPAN)
    rest = np.asarray(tracks.time <= tracks.time[0] + step.over)
    try:
        sections = find_sections(repaired.positions, rest=rest, apart=step.section)
        shape = fit_span(
            sections,
            span=span,
            radius=words.centre_offset,
            facing=step.facing,
            bent_most=_bent_most(sections),
        )
    except ValueError as error:
        return _given_up(prepared, Failure("too_few_markers", str(error)))
    said = (
        f"{sections.count} sections of markers, {int((shape.lever > 0.0).sum())} of them with two "
        f"or more around the axis; points lie {1e6 * shape.bent.noise:.3g} um off the bent axis"
    )
    made = replace(
        prepared,
        signals=prepared.signals.with_new("mid_span", _mid_span(shape, tracks.time, rest, take)),
        shape=_stored(sections, shape, tracks.time, repaired.flags),
        span=SpanBend(shape, tracks.time, rest),
    )
    return made, [worth_knowing("three_point_shape", take.role, said)]


def _given_up(prepared: Prepared, why: Failure) -> tuple[Prepared, list[Finding]]:
    return replace(prepared, span=why), [not_available(why.code, "markers", why.message)]


def _mid_span(shape: SpanShape, time: Floats, rest: Flags, take: Take) -> Signal:
    deflection = shape.bent.deflection
    known = deflection[rest & np.isfinite(deflection)]
    zero = float(np.sqrt(long_run_variance(known, parameters=1) / len(known)))
    return replace(_seen(time, deflection - known.mean(), take), zero_error=zero)


def _bent_most(sections: Sections) -> Flags:
    """Frames in which the specimen is bent more than half as far as it ever is."""
    moved = np.abs(sections.markers[..., 1] - sections.at_rest[:, 1])
    far = np.max(np.nan_to_num(moved), axis=1)
    return np.asarray(far > 0.5 * far.max(), dtype=np.bool_)


def _stored(sections: Sections, shape: SpanShape, time: Floats, flags: NDArray[np.uint8]) -> Shape:
    """Section centres as points; a power series through the axis, to be drawn."""
    own = flags[:, sections.columns]
    seen = np.isfinite(shape.centres).all(axis=2)
    of_section = np.stack(
        [own[:, sections.section == k].max(axis=1) for k in range(sections.count)], axis=1
    )
    x = sections.x - shape.mid_span
    share = np.linspace(0.0, 1.0, 61)
    drawn = x[0] + share * (x[-1] - x[0])
    to_terms = np.linalg.pinv(np.vander(share, _DRAWN + 1, increasing=True))
    height = shape.bent.y(drawn) @ to_terms.T
    coefficients = np.zeros((len(time), 3, _DRAWN + 1))
    coefficients[:, 0, :2] = [x[0], x[-1] - x[0]]
    coefficients[:, 1] = height
    coefficients[np.isnan(height).any(axis=1)] = np.nan
    return Shape(
        time=time,
        positions=shape.centres,
        names=tuple(f"section {number + 1}" for number in range(sections.count)),
        flags=np.where(seen, of_section, PointFlag.MISSING).astype(np.uint8),
        arc_length=x - x[0],
        coefficients=coefficients,
        length=float(x[-1] - x[0]),
        rotation_lab_to_specimen=sections.rotation_lab_to_specimen,
    )


def align_cameras(
    prepared: Prepared, motion: Signal, strokes: tuple[Stroke, ...], *, min_stroke: float
) -> tuple[Prepared, dict[str, ClockFit], list[Finding]]:
    """Fit the clock of the cameras to that of the motion: mid-span turns when the frame does.

    Parameters
    ----------
    prepared : its ``mid_span`` is used
    motion, strokes : the displacement
    min_stroke : m, of the protocol

    Returns
    -------
    With its shape on the clock of the motion, that of the cameras by name, and a note.
    """
    seen = prepared.signals.raw.get("mid_span")
    if seen is None or seen.clock == motion.clock:
        return prepared, {}, []
    own = find_strokes(seen.time, seen.values, min_stroke=min_stroke)
    turns = turning_points(motion, strokes, window=_WINDOW)
    found = turning_points(seen, own, window=_WINDOW)
    first = np.array([turn.middle for turn in turns if strokes[turn.stroke].sign > 0])
    second = np.array([turn.middle for turn in found if own[turn.stroke].sign > 0])
    pairs, _ = match_peaks(first, second)
    if not len(pairs):
        message = "the cameras did not see mid-span turn where the motion does"
        prepared, why = _given_up(prepared, Failure("no_camera_clock", message))
        return prepared, {}, why
    errors = [turn.arrival.time_error for turn in found if own[turn.stroke].sign > 0]
    fit = _camera_fit(first[pairs[:, 0]], second[pairs[:, 1]], np.array(errors)[pairs[:, 1]])
    shape = prepared.shape
    if shape is not None:
        shape = replace(shape, time=fit.to_marker_time(shape.time))
    said = (
        f"the cameras are {fit.offset:.4f} s ahead of the motion, known to "
        f"{1.96e3 * fit.offset_interval.standard_error:.2g} ms; the shape stands on the motion's"
        " clock"
    )
    note = worth_knowing("camera_clock", seen.clock, said)
    return replace(prepared, shape=shape), {seen.clock: fit}, [note]


def _camera_fit(motion: Floats, cameras: Floats, errors: Floats) -> ClockFit:
    weights = errors**-2.0
    offset = float(np.average(cameras - motion, weights=weights))
    error = float(np.hypot(weights.sum() ** -0.5, _DRIFT * np.average(motion, weights=weights)))
    return ClockFit(
        offset=offset,
        drift=0.0,
        offset_interval=Interval.normal_95(offset, error),
        drift_interval=Interval.normal_95(0.0, _DRIFT),
        residual=float(np.sqrt(np.mean((cameras - motion - offset) ** 2))),
        event_times_motion=motion,
        event_times_force=cameras,
        event_errors=errors,
        method="turns of mid-span and of the motion, drift taken as zero within a bound",
    )
