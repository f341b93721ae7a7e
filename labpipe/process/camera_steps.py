"""Run the marker steps: repair tracks, find the specimen axes, fit the shape, join the cameras."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import partial
from math import sqrt
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from labpipe.errors import ProcessingError, sort_by_likeness
from labpipe.markers.specimen_frame import SpecimenFrame, find_specimen_frame
from labpipe.markers.specimen_shape import Offsets, ShapeFit, compute_deflection, fit_shape
from labpipe.markers.three_point_axis import Sections, SpanShape, find_sections, fit_span
from labpipe.markers.track_repair import compute_ring_centres, group_rings, repair_tracks
from labpipe.markers.tracklets import find_frozen_samples, is_unlabelled
from labpipe.messages import format_sentence
from labpipe.process.motion import Motion, find_motion_turns
from labpipe.process.steps import MIN_SAMPLES_NOISE_UNKNOWN, Prepared, Take, average_level
from labpipe.protocol.schema import Markers
from labpipe.records import declarations
from labpipe.records.arrays import Flags, Floats, find_run_times
from labpipe.records.causes import SHAPE
from labpipe.records.curve import ClockFit, PointFlag, Shape
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, QualityNote, Severity, doubt_stretches
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
"""Codes of notes that make the displacement doubtful; other repairs are only noted."""


MarkerStep: TypeAlias = (
    declarations.RepairMarkers
    | declarations.SpecimenFrame
    | declarations.FitShape
    | declarations.ThreePointShape
)
StepOutcome: TypeAlias = tuple[Prepared, list[Finding]]
T = TypeVar("T")


def run_marker_step(
    prepared: Prepared, step: MarkerStep, settings: Markers | None, span: float | None = None
) -> StepOutcome:
    """Run one marker step.

    Parameters
    ----------
    prepared : test with a take, after the steps that the step needs
    step : step of the protocol
    settings, span : block ``markers`` of the protocol, and span of the specimen, m

    Returns
    -------
    The test after the step, and the findings.

    Raises
    ------
    ValueError
        If there is no block ``markers``, or no result of an earlier step; or as the step raises.
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


def _require(value: T | None) -> T:
    """Return a value; raise a ValueError if no export or earlier step has provided it."""
    if value is None:
        raise ValueError(format_sentence("process.needs_markers"))
    return value


def repair_marker_tracks(
    prepared: Prepared, step: declarations.RepairMarkers, settings: Markers
) -> StepOutcome:
    """Run ``repair-markers``: repair labels, frozen poses and gaps; compute ring centres."""
    take = prepared.take
    tracks = _require(take.tracks)
    clamp_path, findings = _find_clamp(tracks, settings, step, take.role)
    names, body_findings = _select_specimen_tracks(tracks, settings, take.role)
    limits = {"max_gap": step.max_gap, "max_jump": step.max_jump, "frozen": step.frozen}
    repaired = repair_tracks(tracks, along=names, reference=clamp_path, **limits)
    if settings.rings == "by-body":
        rings = group_rings(repaired.names)
        if len(rings) < 3:
            n_rings, n_markers, ring_names = len(rings), len(repaired.names), ", ".join(rings)
            raise ValueError(
                format_sentence(
                    "process.few_rings", count=n_rings, markers=n_markers, names=ring_names
                )
            )
        repaired = compute_ring_centres(repaired, rings)
    findings += [*body_findings, *_make_shape_findings(repaired.notes, take.role)]
    return replace(prepared, take=replace(take, clamp=clamp_path, repaired=repaired)), findings


def find_specimen_axes(prepared: Prepared, step: declarations.SpecimenFrame) -> StepOutcome:
    """Run ``specimen-frame``: find the specimen axes, and with a clamp the signal ``travel``."""
    take, findings, signals = prepared.take, list[Finding](), prepared.signals
    tracks, positions, role = _require(take.tracks), _require(take.repaired).positions, take.role
    is_at_rest = np.asarray(tracks.time <= tracks.time[0] + step.over)
    limit = step.max_out_of_plane
    find_frame = partial(find_specimen_frame, take.clamp, positions, out_of_plane_limit=limit)
    frame = find_frame(rest=is_at_rest)
    is_before_motion = _flag_before_motion(tracks.time, frame, take.clamp)
    if MIN_SAMPLES_NOISE_UNKNOWN <= (is_at_rest & is_before_motion).sum() < is_at_rest.sum():
        is_at_rest &= is_before_motion
        frame = find_frame(rest=is_at_rest)
        duration, stated = float(np.ptp(tracks.time[is_at_rest])), step.over
        findings.append(
            Finding.of("process.short_rest_of_clamp", role, duration=duration, stated=stated)
        )
    findings += _make_shape_findings(frame.notes, role)
    plane, line = 1e3 * frame.out_of_plane, 1e3 * frame.travel_residual
    findings.append(Finding.of("process.specimen_frame", role, plane=plane, line=line))
    if take.clamp is not None:
        travel = -frame.to_specimen(take.clamp)[:, 1]
        travel = travel - np.nanmean(travel[is_at_rest])
        signals = signals.add_signal("travel", take.make_signal(tracks.time, travel))
    take = replace(take, frame=frame, rest=is_at_rest)
    return replace(prepared, signals=signals, take=take), findings


def _flag_before_motion(time: Floats, frame: SpecimenFrame, clamp: Floats | None) -> Flags:
    """Flag frames before the first stroke of the clamp; all frames of a take without a clamp."""
    min_stroke_share = 0.1  # of the range of the clamp; smaller movements are ignored
    if clamp is None:
        return np.ones(len(time), dtype=np.bool_)
    travel = frame.to_specimen(clamp)[:, 1]
    min_stroke = min_stroke_share * float(np.nanmax(travel) - np.nanmin(travel))
    strokes = find_strokes(time, travel, min_stroke=min_stroke)
    return np.asarray(time < (time[strokes[0].start] if strokes else np.inf), dtype=np.bool_)


def fit_specimen_shapes(
    prepared: Prepared, step: declarations.FitShape, settings: Markers
) -> StepOutcome:
    """Run ``fit-shape``: fit the shape, and with a clamp add the signal ``deflection``."""
    take, signals, role = prepared.take, prepared.signals, prepared.take.role
    tracks, repaired = _require(take.tracks), _require(take.repaired)
    frame, is_at_rest = _require(take.frame), _require(take.rest)
    order, grip_error = list(frame.order), settings.offset_uncertainty
    fit = fit_shape(
        frame.to_specimen(repaired.positions[:, order]),
        repaired.flags[:, order],
        [repaired.names[column] for column in order],
        tracks.time,
        clamp_specimen=None if take.clamp is None else frame.to_specimen(take.clamp),
        rotation_lab_to_specimen=frame.rotation_lab_to_specimen,
        offsets=Offsets(settings.grip_offset, settings.pull_offset, settings.centre_offset),
        uncertainties=Offsets(grip_error, grip_error, settings.centre_uncertainty),
        terms=step.terms,
        tip=step.tip,
        rest=is_at_rest,
    )
    findings = list(_make_shape_findings(fit.notes, role))
    off, quiet = 1e3 * compute_rms(fit.residual), 1e3 * compute_rms(fit.residual[is_at_rest])
    if off > 3.0 * quiet + 1e-2 and take.clamp is not None:
        findings.append(
            Finding.of("process.shape_misfit", role, "displacement", off=off, quiet=quiet)
        )
    angle = float(np.degrees(fit.clamp_angle))
    findings.append(Finding.of("process.shape_fit", role, off=off, angle=angle))
    if take.clamp is not None:
        signals = signals.add_signal("deflection", _make_deflection_signal(fit, is_at_rest, take))
        rest_times = tracks.time[is_at_rest]
        stretch = {"deflection": (float(rest_times[0]), float(rest_times[-1]))}
        signals = replace(signals, zero_stretches={**signals.zero_stretches, **stretch})
    return replace(prepared, signals=signals, shape=fit.shape), findings


def _make_deflection_signal(fit: ShapeFit, at_rest: Flags, take: Take) -> Signal:
    """Compute the deflection of the pull point, also for perturbed offsets and a perturbed shape.

    The change with one more term is the half-width of a rectangular distribution; its standard
    uncertainty is 1 / sqrt(3) of the half-width.
    """
    values = compute_deflection(fit.shape, rest=at_rest)
    is_measured = ~np.isnan(values)
    _, zero_error = average_level(values[at_rest & is_measured], values[~at_rest])
    shape_change = fit.tip_systematic[:, 1]
    has_shape_change = not np.isnan(shape_change[at_rest]).all()
    perturbed = {
        cause: deflection - np.nanmean(deflection[at_rest])
        for cause, deflection in fit.perturbed_tip.items()
    }
    if has_shape_change:
        perturbed[SHAPE] = values + (shape_change - np.nanmean(shape_change[at_rest])) / sqrt(3.0)
    return replace(
        take.make_signal(fit.shape.time, values), zero_error=zero_error, perturbed=perturbed
    )


def _make_shape_findings(notes: Iterable[QualityNote], role: str) -> Iterator[Finding]:
    """Convert notes to findings; notes in `_SHAPE_DOUBT_CODES` make the displacement doubtful."""
    for note in notes:
        if note.code in _SHAPE_DOUBT_CODES:
            yield doubt_stretches("displacement", note, role)
        else:
            yield Finding(note)


def _find_clamp(
    tracks: MarkerTracks, settings: Markers, step: declarations.RepairMarkers, role: str
) -> tuple[Floats | None, list[Finding]]:
    if settings.clamp is None:
        return None, []
    body = tracks.find_body(settings.clamp)
    if body is None:
        similar_names = sort_by_likeness(settings.clamp, [body.name for body in tracks.bodies])
        listed_names = ", ".join(map(repr, similar_names)) or "no rigid body in the take"
        raise ProcessingError.about(
            "process.no_clamp", role, "rigid bodies", clamp=settings.clamp, found=listed_names
        )
    if np.isnan(body.position).all():
        raise ProcessingError.about(
            "process.clamp_never_seen", role, f"rigid body {settings.clamp!r}"
        )
    return _repair_clamp_path(tracks, body, step, role)


def _repair_clamp_path(
    tracks: MarkerTracks, body: RigidBody, step: declarations.RepairMarkers, role: str
) -> tuple[Floats, list[Finding]]:
    """Return the path of the clamp without stale poses, short gaps interpolated linearly."""
    all_positions = np.concatenate([body.position[:, None], tracks.positions], axis=1)
    is_stale = find_frozen_samples(all_positions, tracks.time, min_frozen_time=step.frozen)[:, 0]
    path: Floats = np.where(is_stale[:, None], np.nan, body.position)
    findings: list[Finding] = []
    if is_stale.any():
        stretches, count = find_run_times(is_stale, tracks.time), int(is_stale.sum())
        frozen_note = QualityNote.of(
            "process.clamp_frozen", body.name, *stretches, body=body.name, count=count
        )
        findings.append(doubt_stretches("displacement", frozen_note, role))
    is_missing = np.isnan(path).any(axis=1)
    if not is_missing.any():
        return path, findings
    measured_times, missing_times = tracks.time[~is_missing], tracks.time[is_missing]
    following = np.searchsorted(measured_times, missing_times)
    edges = np.concatenate([[-np.inf], measured_times, [np.inf]])
    bridged_samples = np.flatnonzero(is_missing)[
        edges[following + 1] - edges[following] <= step.max_gap
    ]
    for axis in range(3):
        path[bridged_samples, axis] = np.interp(
            tracks.time[bridged_samples], measured_times, path[~is_missing, axis]
        )
    note = Finding.of(
        "process.clamp_lost",
        body.name,
        body=body.name,
        lost=int(is_missing.sum()),
        bridged=len(bridged_samples),
        gap=step.max_gap,
    )
    return path, [*findings, note]


def _select_specimen_tracks(
    tracks: MarkerTracks, settings: Markers, role: str
) -> tuple[list[str], list[Finding]]:
    """List the tracks along the specimen, including unlabelled ones."""
    patterns = ("*",) if settings.along == "all" else settings.along
    bodies = [body.name for body in tracks.bodies] if settings.along == "all" else []
    # Motive 1.2x separates body and marker by a colon, 1.1 by a hyphen.
    prefixes = tuple(
        f"{name}{separator}" for name in {*bodies, settings.clamp} if name for separator in ":-"
    )
    candidates = [
        name
        for name in tracks.names
        if not name.startswith(prefixes)
        and (is_unlabelled(name) or any(name == x or fnmatchcase(name, x) for x in patterns))
    ]
    others = ", ".join(sorted({name for name in bodies if name != settings.clamp}))
    findings = [Finding.of("process.bodies_left_out", role, bodies=others)] if others else []
    visible_names = [name for name in candidates if tracks.missing_counts[name] < len(tracks.time)]
    if len(visible_names) < 3:
        names = ", ".join(visible_names) or "none"
        raise ProcessingError.about(
            "process.few_markers", role, "markers", count=len(visible_names), names=names
        )
    return candidates, findings


def compute_rms(values: Floats) -> float:
    """Return the root mean square of the values that are not NaN; NaN if there are none."""
    valid = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(valid**2))) if len(valid) else float("nan")


_DRIFT_UNCERTAINTY = 1e-4 / sqrt(3.0)
"""Standard uncertainty, s/s, of the drift of the camera clock, which the fit assumes to be 0."""


def fit_three_point_shape(
    prepared: Prepared, step: declarations.ThreePointShape, settings: Markers, span: float | None
) -> StepOutcome:
    """Run ``three-point-shape``: fit the bent axis, and add the signal ``mid_span``.

    Parameters
    ----------
    prepared : test with repaired tracks
    step, settings, span : step, settings of the markers, and span (m) of the protocol

    Returns
    -------
    The test with axis, shape and signal, or the reason why there are none; and a finding.
    """
    take = prepared.take
    time, repaired = _require(take.tracks).time, _require(take.repaired)
    if span is None:
        return _reject_span(prepared, Failure.of("process.no_span"))
    is_at_rest = np.asarray(time <= time[0] + step.over)
    try:
        sections = find_sections(repaired.positions, rest=is_at_rest, min_distance=step.section)
        moves = np.abs(sections.markers[..., 1] - sections.at_rest[:, 1])
        largest_moves = np.max(np.nan_to_num(moves), axis=1)  # of each frame
        shape = fit_span(
            sections,
            span=span,
            radius=settings.centre_offset,
            side=step.facing,
            is_bent=np.asarray(largest_moves > 0.5 * largest_moves.max(), dtype=np.bool_),
        )
    except ValueError as error:
        return _reject_span(prepared, Failure("too_few_markers", str(error)))
    deflection = shape.axis.deflection
    at_rest = deflection[is_at_rest & np.isfinite(deflection)]
    count, needed = len(at_rest), 4  # for their variance
    if count < needed:
        reason = Failure.of("process.no_sections_at_rest", count=count, needed=needed)
        return _reject_span(prepared, reason)
    variance = estimate_long_run_variance(at_rest, parameters=1) / len(at_rest)
    mid_span = take.make_signal(time, deflection - at_rest.mean())
    mid_span = replace(mid_span, zero_error=float(np.sqrt(variance)))
    prepared = replace(
        prepared,
        signals=prepared.signals.add_signal("mid_span", mid_span),
        shape=_make_span_shape(sections, shape, time, repaired.flags),
        span=SpanBend(shape, time, is_at_rest),
    )
    count, around, noise = sections.count, int((shape.lever > 0.0).sum()), 1e6 * shape.axis.noise
    return prepared, [
        Finding.of("process.three_point_shape", take.role, count=count, around=around, noise=noise)
    ]


def _reject_span(prepared: Prepared, reason: Failure) -> StepOutcome:
    note = QualityNote(reason.code, Severity.ERROR, "markers", reason.message)
    return replace(prepared, span=reason), [Finding(note)]


def _make_span_shape(
    sections: Sections, shape: SpanShape, time: Floats, flags: NDArray[np.uint8]
) -> Shape:
    """Make the shape: section centres as points, and a power series of the axis for figures."""
    degree = 9  # of the stored power series, which only the figure uses
    section_flags = flags[:, sections.columns]
    is_finite = np.isfinite(shape.centres).all(axis=2)
    flags_of_sections = np.stack(
        [section_flags[:, sections.section == k].max(axis=1) for k in range(sections.count)], axis=1
    )
    x = sections.x - shape.mid_span
    share = np.linspace(0.0, 1.0, 61)
    drawn_x = x[0] + share * (x[-1] - x[0])
    to_terms = np.linalg.pinv(np.vander(share, degree + 1, increasing=True))
    height = shape.axis.compute_y(drawn_x) @ to_terms.T
    coefficients = np.zeros((len(time), 3, degree + 1))
    coefficients[:, 0, :2] = [x[0], x[-1] - x[0]]
    coefficients[:, 1] = height
    coefficients[np.isnan(height).any(axis=1)] = np.nan
    return Shape(
        time=time,
        positions=shape.centres,
        names=tuple(f"section {number + 1}" for number in range(sections.count)),
        flags=np.where(is_finite, flags_of_sections, PointFlag.MISSING).astype(np.uint8),
        arc_length=x - x[0],
        coefficients=coefficients,
        length=float(x[-1] - x[0]),
        rotation_lab_to_specimen=sections.rotation_lab_to_specimen,
    )


def align_cameras(
    prepared: Prepared, motion: Motion, *, min_stroke: float
) -> tuple[Prepared, dict[str, ClockFit], list[Finding]]:
    """Fit the clock of the cameras to that of the motion at the upper turns of mid-span.

    Parameters
    ----------
    prepared : unchanged without ``mid_span``, or if that has the clock of the motion
    motion : the displacement
    min_stroke : m, of the protocol

    Returns
    -------
    The test with its shape on the clock of the motion; the clock fit of the cameras, by name; and
    the findings. If the turns of mid-span match none of the motion, the span is not available.
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
    known_to = 1.96e3 * fit.offset_interval.standard_error
    note = Finding.of("process.camera_clock", mid_span.clock, offset=fit.offset, known_to=known_to)
    return replace(prepared, shape=shape), {mid_span.clock: fit}, [note]


def _find_upper_turns(motion: Motion) -> Floats:
    """Return the time of each upper turn of a motion and its standard error, shape (turns, 2)."""
    window = 25.0  # s on each side of a turn
    turns = find_motion_turns(motion, window=window)
    upper_turns = [turn for turn in turns if motion.strokes[turn.stroke].sign > 0]
    times = [(turn.middle, turn.arrival.time_error) for turn in upper_turns]
    return np.array(times, dtype=np.float64).reshape(-1, 2)


def _fit_camera_clock(events: Floats) -> ClockFit:
    motion, cameras, errors = events
    weights, method = errors**-2.0, "turns of mid-span and of the motion, drift taken as zero"
    offset = float(np.average(cameras - motion, weights=weights))
    drift_error = _DRIFT_UNCERTAINTY * np.average(motion, weights=weights)
    error = float(np.hypot(weights.sum() ** -0.5, drift_error))
    drift, method = (0.0, _DRIFT_UNCERTAINTY), f"{method} within a bound"
    return make_clock_fit((offset, error), drift, events, method)
