"""Run the marker steps: repair tracks, find the specimen axes, fit the shape, align the cameras."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import partial
from math import sqrt
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from labpipe.errors import ProcessingError, sort_by_likeness
from labpipe.markers.specimen_frame import SpecimenFrame, find_specimen_frame
from labpipe.markers.specimen_shape import Offsets, ShapeFit, compute_deflection, fit_shape
from labpipe.markers.three_point_axis import Sections, SpanShape, find_sections, fit_specimen_shape
from labpipe.markers.track_repair import compute_ring_centres, group_rings, repair_tracks
from labpipe.markers.tracklets import find_frozen_samples, is_unlabelled
from labpipe.messages import format_sentence
from labpipe.process.consistency import compute_rms
from labpipe.process.motion import Motion, find_motion_turns
from labpipe.process.steps import MIN_ZERO_SAMPLES_NOISE_UNKNOWN, PreparedTest, Take, average_level
from labpipe.protocol.schema import Markers
from labpipe.records import declarations
from labpipe.records.arrays import Flags, Floats, drop_missing, find_run_times
from labpipe.records.causes import SHAPE
from labpipe.records.curve import ClockFit, PointFlag, Shape
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, QualityNote, Severity, make_stretch_finding
from labpipe.records.recording import MarkerTracks, RigidBody
from labpipe.records.signals import Signal
from labpipe.results.kinds import SpanBend
from labpipe.signal.clock_alignment import make_clock_fit, match_peaks
from labpipe.signal.turning_points import find_strokes
from labpipe.uncertainty.autocorrelation import estimate_long_run_variance

_SHAPE_DOUBT_CODES = {
    "label_ambiguous",
    "marker_missing",
    "marker_not_at_rest",
    "out_of_plane",
    "shape_missing",
}
"""Codes of notes on markers and shapes that make the displacement doubtful."""

MarkerStep: TypeAlias = (
    declarations.RepairMarkers
    | declarations.SpecimenFrame
    | declarations.FitShape
    | declarations.ThreePointShape
)
StepOutcome: TypeAlias = tuple[PreparedTest, list[Finding]]
"""The test after a step, and the findings of the step."""
_T = TypeVar("_T")


def run_marker_step(
    prepared: PreparedTest, step: MarkerStep, settings: Markers | None, span: float | None = None
) -> StepOutcome:
    """Run one marker step.

    Parameters
    ----------
    prepared : test with a take, after the earlier steps
    step : step of the protocol
    settings : block ``markers`` of the protocol; None if it has none
    span : span of the specimen, m; None if the protocol does not state it

    Returns
    -------
    The test after the step, and its findings.

    Raises
    ------
    ValueError
        If the test has no marker tracks, the protocol has no block ``markers``, an earlier step is
        missing, or the step cannot be run on the data.
    """
    settings = _require(settings)
    match step:
        case declarations.RepairMarkers():
            return repair_marker_tracks(prepared, step, settings)
        case declarations.SpecimenFrame():
            return find_specimen_axes(prepared, step)
        case declarations.FitShape():
            return fit_specimen_shapes(prepared, step, settings)
        case declarations.ThreePointShape():
            return fit_three_point_shape(prepared, step, settings, span)


def _require(value: _T | None, step: str = "") -> _T:
    """Return a value that an earlier step computes, or marker data; raise a ValueError for None."""
    if value is None:
        if step:
            raise ValueError(format_sentence("process.needs_step", step=step))
        raise ValueError(format_sentence("process.needs_markers"))
    return value


def repair_marker_tracks(
    prepared: PreparedTest, step: declarations.RepairMarkers, settings: Markers
) -> StepOutcome:
    """Run ``repair-markers``: repair labels, frozen poses and gaps, and compute ring centres."""
    min_rings = 3  # rings along the specimen, which the shape needs
    take = prepared.take
    tracks = _require(take.tracks)
    clamp_path, findings = _read_clamp_path(tracks, settings, step, take.role)
    track_names, body_findings = _select_specimen_tracks(tracks, settings, take.role)
    limits = {"max_gap": step.max_gap, "max_jump": step.max_jump, "frozen_time": step.frozen}
    repaired_tracks = repair_tracks(tracks, track_names=track_names, clamp=clamp_path, **limits)
    if settings.rings == "by-body":
        rings = group_rings(repaired_tracks.names)
        if len(rings) < min_rings:
            facts: dict[str, Any] = {"count": len(rings), "names": ", ".join(rings)}
            facts |= {"markers": len(repaired_tracks.names)}
            raise ValueError(format_sentence("process.few_rings", **facts))
        repaired_tracks = compute_ring_centres(repaired_tracks, rings)
    findings += [*body_findings, *_make_shape_findings(repaired_tracks.notes, take.role)]
    take = replace(take, clamp_positions=clamp_path, repaired_tracks=repaired_tracks)
    return replace(prepared, take=take), findings


def find_specimen_axes(prepared: PreparedTest, step: declarations.SpecimenFrame) -> StepOutcome:
    """Run ``specimen-frame``: find the specimen axes, and add the signal ``travel`` of a clamp."""
    take, findings, signals = prepared.take, list[Finding](), prepared.signals
    tracks, role = _require(take.tracks), take.role
    positions = _require(take.repaired_tracks, "repair-markers").positions
    is_at_rest = np.asarray(tracks.time <= tracks.time[0] + step.over)
    clamp_path, limit = take.clamp_positions, step.max_out_of_plane
    find_frame = partial(find_specimen_frame, clamp_path, positions, plane_limit=limit)
    frame = find_frame(rest_frames=is_at_rest)
    is_before_motion = _flag_before_motion(tracks.time, frame, clamp_path)
    if MIN_ZERO_SAMPLES_NOISE_UNKNOWN <= (is_at_rest & is_before_motion).sum() < is_at_rest.sum():
        is_at_rest &= is_before_motion
        frame = find_frame(rest_frames=is_at_rest)
        duration = float(np.ptp(tracks.time[is_at_rest]))
        facts: dict[str, Any] = {"duration": duration, "stated": step.over}
        findings.append(Finding.of("process.short_rest_of_clamp", role, **facts))
    findings += _make_shape_findings(frame.notes, role)
    facts = {"plane": 1e3 * frame.out_of_plane_distance, "line": 1e3 * frame.travel_residual}
    findings.append(Finding.of("process.specimen_frame", role, **facts))
    if clamp_path is not None:
        travel = -frame.to_specimen(clamp_path)[:, 1]
        travel = travel - np.nanmean(travel[is_at_rest])
        signals = signals.add_signal("travel", take.make_signal(tracks.time, travel))
    take = replace(take, frame=frame, is_at_rest=is_at_rest)
    return replace(prepared, signals=signals, take=take), findings


def _flag_before_motion(time: Floats, frame: SpecimenFrame, clamp_path: Floats | None) -> Flags:
    """Flag the frames before the first stroke of the clamp; without a stroke, flag all frames."""
    min_stroke_fraction = 0.1  # of the travel of the clamp; smaller movements are ignored
    if clamp_path is None:
        return np.ones(len(time), dtype=np.bool_)
    travel = frame.to_specimen(clamp_path)[:, 1]
    min_stroke = min_stroke_fraction * float(np.nanmax(travel) - np.nanmin(travel))
    strokes = find_strokes(time, travel, min_stroke=min_stroke)
    return np.asarray(time < (time[strokes[0].start] if strokes else np.inf), dtype=np.bool_)


def fit_specimen_shapes(
    prepared: PreparedTest, step: declarations.FitShape, settings: Markers
) -> StepOutcome:
    """Run ``fit-shape``: fit the shape, and add the signal ``deflection`` if there is a clamp."""
    misfit_factor, misfit_offset = 3.0, 1e-2  # multiple of the rms deviation at rest; mm
    take, signals, role = prepared.take, prepared.signals, prepared.take.role
    tracks = _require(take.tracks)
    repaired_tracks = _require(take.repaired_tracks, "repair-markers")
    frame = _require(take.frame, "specimen-frame")
    is_at_rest = _require(take.is_at_rest, "specimen-frame")
    order, grip_error = list(frame.marker_order), settings.offset_uncertainty
    has_clamp = take.clamp_positions is not None
    fit = fit_shape(
        frame.to_specimen(repaired_tracks.positions[:, order]),
        repaired_tracks.flags[:, order],
        [repaired_tracks.names[index] for index in order],
        tracks.time,
        clamp_specimen=frame.to_specimen(_require(take.clamp_positions)) if has_clamp else None,
        rotation_lab_to_specimen=frame.rotation_lab_to_specimen,
        offsets=Offsets(settings.grip_offset, settings.pull_offset, settings.centre_offset),
        uncertainties=Offsets(grip_error, grip_error, settings.centre_uncertainty),
        terms=step.terms,
        tip=step.tip,
        rest_frames=is_at_rest,
    )
    findings = list(_make_shape_findings(fit.notes, role))
    rms, rest_rms = 1e3 * compute_rms(fit.residual), 1e3 * compute_rms(fit.residual[is_at_rest])
    facts: dict[str, Any] = {"rms": rms, "rest_rms": rest_rms}
    if rms > misfit_factor * rest_rms + misfit_offset and has_clamp:
        findings.append(Finding.of("process.shape_misfit", role, "displacement", **facts))
    angle = float(np.degrees(fit.clamp_angle))
    findings.append(Finding.of("process.shape_fit", role, rms=rms, angle=angle))
    if has_clamp:
        signals = signals.add_signal("deflection", _make_deflection_signal(fit, is_at_rest, take))
        rest_times = tracks.time[is_at_rest]
        stretch = {"deflection": (float(rest_times[0]), float(rest_times[-1]))}
        signals = replace(signals, zero_stretches={**signals.zero_stretches, **stretch})
    return replace(prepared, signals=signals, shape=fit.shape), findings


def _make_deflection_signal(fit: ShapeFit, is_at_rest: Flags, take: Take) -> Signal:
    """Make the signal of the deflection of the pull point, with its perturbed signals.

    The offsets and the shape are perturbed. A shape with one more term changes the deflection. This
    change is the half-width of a rectangular distribution. The perturbation is therefore the change
    divided by sqrt(3).
    """
    values = compute_deflection(fit.shape, rest_frames=is_at_rest)
    _, zero_error = average_level(drop_missing(values[is_at_rest]), values[~is_at_rest])
    perturbed_values = {
        cause: deflection - np.nanmean(deflection[is_at_rest])
        for cause, deflection in fit.perturbed_tip.items()
    }
    tip_change = fit.tip_change[:, 1]
    if not np.isnan(tip_change[is_at_rest]).all():
        change_from_rest = tip_change - np.nanmean(tip_change[is_at_rest])
        perturbed_values[SHAPE] = values + change_from_rest / sqrt(3.0)
    signal = take.make_signal(fit.shape.time, values)
    return replace(signal, zero_error=zero_error, variants=perturbed_values)


def _make_shape_findings(notes: Iterable[QualityNote], role: str) -> Iterator[Finding]:
    """Convert notes to findings; notes in `_SHAPE_DOUBT_CODES` make the displacement doubtful."""
    for note in notes:
        if note.code in _SHAPE_DOUBT_CODES:
            yield make_stretch_finding("displacement", note, role)
        else:
            yield Finding(note)


def _read_clamp_path(
    tracks: MarkerTracks, settings: Markers, step: declarations.RepairMarkers, role: str
) -> tuple[Floats | None, list[Finding]]:
    """Read the path of the clamp, m, and repair it; None if the protocol names no clamp."""
    if settings.clamp is None:
        return None, []
    body = tracks.find_body(settings.clamp)
    if body is None:
        similar_names = sort_by_likeness(settings.clamp, [body.name for body in tracks.bodies])
        body_names = ", ".join(map(repr, similar_names)) or "no rigid body in the take"
        facts = {"clamp": settings.clamp, "found": body_names}
        raise ProcessingError.about("process.no_clamp", role, "rigid bodies", **facts)
    if np.isnan(body.position).all():
        place = f"rigid body {body.name!r}"
        raise ProcessingError.about("process.clamp_never_seen", role, place)
    return _repair_clamp_path(tracks, body, step, role)


def _repair_clamp_path(
    tracks: MarkerTracks, body: RigidBody, step: declarations.RepairMarkers, role: str
) -> tuple[Floats, list[Finding]]:
    """Remove frozen poses from the path of the clamp, and interpolate its short gaps linearly."""
    all_positions = np.concatenate([body.position[:, None], tracks.positions], axis=1)
    is_frozen = find_frozen_samples(all_positions, tracks.time, min_frozen_time=step.frozen)[:, 0]
    path: Floats = np.where(is_frozen[:, None], np.nan, body.position)
    findings, name = list[Finding](), body.name
    if is_frozen.any():
        stretches, count = find_run_times(is_frozen, tracks.time), int(is_frozen.sum())
        note = QualityNote.of("process.clamp_frozen", name, *stretches, body=name, count=count)
        findings.append(make_stretch_finding("displacement", note, role))
    is_missing = np.isnan(path).any(axis=1)
    if not is_missing.any():
        return path, findings
    measured_times, missing_times = tracks.time[~is_missing], tracks.time[is_missing]
    next_samples = np.searchsorted(measured_times, missing_times)
    gap_ends = np.concatenate([[-np.inf], measured_times, [np.inf]])
    gaps = gap_ends[next_samples + 1] - gap_ends[next_samples]
    short_gaps = np.flatnonzero(is_missing)[gaps <= step.max_gap]  # indices of their frames
    gap_times = tracks.time[short_gaps]
    for coordinate in path.T:
        coordinate[short_gaps] = np.interp(gap_times, measured_times, coordinate[~is_missing])
    facts: dict[str, Any] = {"lost": int(is_missing.sum()), "bridged": len(short_gaps)}
    finding = Finding.of("process.clamp_lost", name, body=name, gap=step.max_gap, **facts)
    return path, [*findings, finding]


def _select_specimen_tracks(
    tracks: MarkerTracks, settings: Markers, role: str
) -> tuple[list[str], list[Finding]]:
    """Select the names of the tracks along the specimen, including unlabelled markers.

    The finding lists the rigid bodies whose markers are left out, if any.
    """
    min_tracks = 3  # visible tracks, which the shape needs
    patterns = ("*",) if settings.along == "all" else settings.along
    bodies = [body.name for body in tracks.bodies] if settings.along == "all" else []
    # Motive 1.2x separates body and marker by a colon, 1.1 by a hyphen.
    prefixes = tuple(
        f"{name}{separator}" for name in {*bodies, settings.clamp} if name for separator in ":-"
    )
    selected_names = [
        name
        for name in tracks.names
        if not name.startswith(prefixes)
        and (is_unlabelled(name) or any(name == x or fnmatchcase(name, x) for x in patterns))
    ]
    visible_names = [name for name in selected_names if tracks.n_missing[name] < len(tracks.time)]
    if len(visible_names) < min_tracks:
        facts = {"count": len(visible_names), "names": ", ".join(visible_names) or "none"}
        raise ProcessingError.about("process.few_markers", role, "markers", **facts)
    other_bodies = ", ".join(sorted({name for name in bodies if name != settings.clamp}))
    finding = Finding.of("process.bodies_left_out", role, bodies=other_bodies)
    return selected_names, [finding] if other_bodies else []


def fit_three_point_shape(
    prepared: PreparedTest,
    step: declarations.ThreePointShape,
    settings: Markers,
    span: float | None,
) -> StepOutcome:
    """Run ``three-point-shape``: fit the bent axis, and add the signal ``mid_span``.

    Parameters
    ----------
    prepared : test with repaired tracks
    step : step of the protocol
    settings : block ``markers`` of the protocol
    span : span of the specimen, m; None if the protocol does not state it

    Returns
    -------
    The test with the bent axis, the shape and the signal, or with the reason why there are none,
    and one finding.
    """
    # Fraction of the largest deflection above which the axis is bent; frames at rest, from which
    # the variance is estimated.
    bent_fraction, min_rest_frames = 0.5, 4
    take = prepared.take
    time = _require(take.tracks).time
    repaired_tracks = _require(take.repaired_tracks, "repair-markers")
    if span is None:
        return _reject_span(prepared, Failure.of("process.no_span"))
    is_at_rest = np.asarray(time <= time[0] + step.over)
    try:
        sections = find_sections(repaired_tracks.positions, is_at_rest, min_distance=step.section)
        deflections = np.abs(sections.markers[..., 1] - sections.rest_xyz[:, 1])
        max_deflections = np.max(np.nan_to_num(deflections), axis=1)  # of each frame
        is_bent = np.asarray(max_deflections > bent_fraction * max_deflections.max())
        radius, side = settings.centre_offset, step.facing
        shape = fit_specimen_shape(sections, span=span, radius=radius, side=side, is_bent=is_bent)
    except ValueError as error:
        return _reject_span(prepared, Failure("too_few_markers", str(error)))
    deflection = shape.axis.deflection
    rest_values = deflection[is_at_rest & np.isfinite(deflection)]
    count = len(rest_values)
    if count < min_rest_frames:
        reason = Failure.of("process.no_sections_at_rest", count=count, needed=min_rest_frames)
        return _reject_span(prepared, reason)
    variance = estimate_long_run_variance(rest_values, n_parameters=1) / count
    mid_span = take.make_signal(time, deflection - rest_values.mean())
    mid_span = replace(mid_span, zero_error=float(np.sqrt(variance)))
    signals = prepared.signals.add_signal("mid_span", mid_span)
    span_shape = _make_span_shape(sections, shape, time, repaired_tracks.flags)
    n_around, noise = int((shape.lever_arm > 0.0).sum()), 1e6 * shape.axis.noise
    facts: dict[str, Any] = {"count": sections.n_sections, "n_around": n_around, "noise": noise}
    finding = Finding.of("process.three_point_shape", take.role, **facts)
    span_bend = SpanBend(shape, time, is_at_rest)
    return replace(prepared, signals=signals, shape=span_shape, span=span_bend), [finding]


def _reject_span(prepared: PreparedTest, reason: Failure) -> StepOutcome:
    """Replace the bent axis by the reason why there is none, and report it as an error."""
    note = QualityNote(reason.code, Severity.ERROR, "markers", reason.message)
    return replace(prepared, span=reason), [Finding(note)]


def _make_span_shape(
    sections: Sections, shape: SpanShape, time: Floats, flags: NDArray[np.uint8]
) -> Shape:
    """Make the shape from the section centres, and fit a power series to the axis for figures."""
    degree, n_fitted = 9, 61  # degree of the power series; number of points to which it is fitted
    section_flags = flags[:, sections.marker_columns]
    is_finite = np.isfinite(shape.centres).all(axis=2)
    masks = [sections.section_index == index for index in range(sections.n_sections)]  # of markers
    worst_flags = np.stack([section_flags[:, mask].max(axis=1) for mask in masks], axis=1)
    x = sections.x - shape.mid_span
    relative_x = np.linspace(0.0, 1.0, n_fitted)
    y = shape.axis.compute_y(x[0] + relative_x * (x[-1] - x[0]))
    y_terms = y @ np.linalg.pinv(np.vander(relative_x, degree + 1, increasing=True)).T
    coefficients = np.zeros((len(time), 3, degree + 1))
    coefficients[:, 0, :2] = [x[0], x[-1] - x[0]]
    coefficients[:, 1] = y_terms
    coefficients[np.isnan(y_terms).any(axis=1)] = np.nan
    return Shape(
        time=time,
        positions=shape.centres,
        names=tuple(f"section {k + 1}" for k in range(sections.n_sections)),
        flags=np.where(is_finite, worst_flags, PointFlag.MISSING).astype(np.uint8),
        arc_length=x - x[0],
        coefficients=coefficients,
        length=float(x[-1] - x[0]),
        rotation_lab_to_specimen=sections.rotation_lab_to_specimen,
    )


def align_cameras(
    prepared: PreparedTest, motion: Motion, *, min_stroke: float
) -> tuple[PreparedTest, dict[str, ClockFit], list[Finding]]:
    """Align the clock of the cameras with that of the motion at the upper turns of mid-span.

    Parameters
    ----------
    prepared : test with the signal ``mid_span`` of the cameras, if they recorded it
    motion : motion of the displacement with its strokes
    min_stroke : smallest stroke of mid-span, m

    Returns
    -------
    prepared : test with its shape on the clock of the motion. If no turn of mid-span matches a turn
        of the motion, the bent axis is replaced by the reason. The test is unchanged without
        ``mid_span``, or if ``mid_span`` and the motion are on one clock
    fits : relation of the clocks, keyed by the clock of the cameras; empty if it is not fitted
    findings : findings of the fit
    """
    mid_span = prepared.signals.raw.get("mid_span")
    if mid_span is None or mid_span.clock == motion.signal.clock:
        return prepared, {}, []
    strokes = find_strokes(mid_span.time, mid_span.values, min_stroke=min_stroke)
    motion_turns = _find_upper_turns(motion)
    camera_turns = _find_upper_turns(Motion(mid_span, strokes=strokes))
    pairs, _ = match_peaks(motion_turns[:, 0], camera_turns[:, 0])
    if not len(pairs):
        prepared, findings = _reject_span(prepared, Failure.of("process.no_camera_clock"))
        return prepared, {}, findings
    motion_times, (camera_times, errors) = motion_turns[pairs[:, 0], 0], camera_turns[pairs[:, 1]].T
    fit = _fit_camera_clock(np.stack([motion_times, camera_times, errors]))
    shape = prepared.shape
    if shape is not None:
        shape = replace(shape, time=fit.to_marker_time(shape.time))
    clock, half_width = mid_span.clock, 1.96e3 * fit.offset_interval.standard_error
    finding = Finding.of("process.camera_clock", clock, offset=fit.offset, half_width=half_width)
    return replace(prepared, shape=shape), {clock: fit}, [finding]


def _find_upper_turns(motion: Motion) -> Floats:
    """Find the times and standard errors of the upper turns of a motion, shape (turns, 2), s."""
    window = 25.0  # s, on each side of a turn
    turns = find_motion_turns(motion, window=window)
    upper_turns = [turn for turn in turns if motion.strokes[turn.stroke_index].sign > 0]
    times = [(turn.middle_time, turn.arrival.time_error) for turn in upper_turns]
    return np.array(times, dtype=np.float64).reshape(-1, 2)


def _fit_camera_clock(events: Floats) -> ClockFit:
    """Fit the offset of the camera clock to events, shape (3, events), s, with a drift of zero."""
    drift_error = 1e-4 / sqrt(3.0)  # standard uncertainty of a drift of at most 100 ppm
    motion_times, camera_times, errors = events
    weights = errors**-2.0
    offset = float(np.average(camera_times - motion_times, weights=weights))
    error_from_drift = drift_error * np.average(motion_times, weights=weights)
    error = float(np.hypot(weights.sum() ** -0.5, error_from_drift))
    method = "turns of mid-span and of the motion, drift taken as zero within a bound"
    return make_clock_fit((offset, error), (0.0, drift_error), events, method)
