"""Three-point bending seen by cameras: the bent axis, its clock, curvature and twist."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from labpipe.fits.loops import secant_stiffness
from labpipe.markers.rings import Sections, find_sections
from labpipe.markers.three_point_axis import SpanShape, fit_span
from labpipe.pipeline.bench import Bench, MarkerBench, Signal, SpanBend
from labpipe.pipeline.corrections import loading_branch
from labpipe.pipeline.outcomes import (
    NO_BRANCH,
    Asked,
    blocked_or,
    to_result,
    while_loading,
    with_force_scale,
)
from labpipe.pipeline.turns import turning_points
from labpipe.protocol.results import MidSpan
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import Branch, ClockFit, Curve, Interval, PointFlag, Shape
from labpipe.records.estimates import Estimate, Failure, widened
from labpipe.records.quality import Severity
from labpipe.records.result import Result
from labpipe.records.step_settings import ThreePointShape
from labpipe.signal.clock_alignment import match_peaks
from labpipe.signal.turning_points import Stroke, find_strokes
from labpipe.uncertainty.linear_fits import fit_linear
from labpipe.uncertainty.noise import long_run_variance

NO_SPAN = Failure(
    "no_span",
    "specimen.span, the distance of the supports, is not given: write it into the specimen of the "
    "test sheet, such as 'span: 152.4 mm'",
)
_WINDOW = 25.0
"""s on each side of a turn of mid-span."""
_AT_TURN = 2.0
"""s on each side of the turn that a value there is read from."""
_BESIDE, _LEAST = 8.0, 5
"""s on each side beyond that, which speak of the noise; frames that each side needs."""
_DRIFT = 1e-4 / sqrt(3.0)
"""Standard uncertainty of the rate of the cameras' clock, which one turn does not show."""
_DRAWN = 9
"""Degree of the curve that is stored to be drawn."""


def bend_between_supports(
    bench: Bench, markers: MarkerBench, step: ThreePointShape, protocol: Protocol
) -> None:
    """Carry out ``three-point-shape``: the bent axis, and the signal ``mid_span``.

    Parameters
    ----------
    bench : gets axis, shape and signal, or why there is none
    markers : repaired tracks
    step : of the protocol
    protocol : its span and its marker block

    Raises
    ------
    ValueError
        If the markers were not repaired before.
    """
    tracks, words, repaired = markers.tracks, protocol.markers, markers.repaired
    if tracks is None or words is None or repaired is None:
        message = "expected a role with marker tracks, a block markers: and repair-markers before"
        raise ValueError(message)
    span = protocol.specimen.span
    if span is None:
        _give_up(bench, NO_SPAN)
        return
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
        _give_up(bench, Failure("too_few_markers", str(error)))
        return
    bench.span = SpanBend(shape, tracks.time, rest)
    bench.shape = _stored(sections, shape, tracks.time, repaired.flags)
    deflection = shape.bent.deflection
    known = deflection[rest & np.isfinite(deflection)]
    zero = float(np.sqrt(long_run_variance(known, parameters=1) / len(known)))
    signal = Signal(tracks.time, deflection - known.mean(), "m", markers.role, zero_error=zero)
    bench.raw["mid_span"] = bench.signals["mid_span"] = signal
    said = (
        f"{sections.count} sections of markers, {int((shape.lever > 0.0).sum())} of them with two "
        f"or more around the axis; points lie {1e6 * shape.bent.noise:.3g} um off the bent axis"
    )
    bench.note("three_point_shape", Severity.INFO, markers.role, said)


def _give_up(bench: Bench, why: Failure) -> None:
    bench.span = why
    bench.note(why.code, Severity.ERROR, "markers", why.message)


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
    bench: Bench, motion: Signal, strokes: tuple[Stroke, ...], *, min_stroke: float
) -> None:
    """Fit the clock of the cameras to that of the motion: mid-span turns when the frame does.

    Parameters
    ----------
    bench : its ``mid_span`` is used; gets the clock, and its shape on the clock of the curve
    motion, strokes : the displacement
    min_stroke : m, of the protocol
    """
    seen = bench.raw.get("mid_span")
    if seen is None or seen.clock == motion.clock:
        return
    own = find_strokes(seen.time, seen.values, min_stroke=min_stroke)
    turns = turning_points(motion, strokes, window=_WINDOW)
    found = turning_points(seen, own, window=_WINDOW)
    first = np.array([turn.middle for turn in turns if strokes[turn.stroke].sign > 0])
    second = np.array([turn.middle for turn in found if own[turn.stroke].sign > 0])
    pairs, _ = match_peaks(first, second)
    if not len(pairs):
        message = "the cameras did not see mid-span turn where the motion does"
        _give_up(bench, Failure("no_camera_clock", message))
        return
    errors = [turn.arrival.time_error for turn in found if own[turn.stroke].sign > 0]
    fit = _camera_fit(first[pairs[:, 0]], second[pairs[:, 1]], np.array(errors)[pairs[:, 1]])
    bench.other_clocks[seen.clock] = fit
    if bench.shape is not None:
        bench.shape = replace(bench.shape, time=fit.to_marker_time(bench.shape.time))
    said = (
        f"the cameras are {fit.offset:.4f} s ahead of the motion, known to "
        f"{1.96e3 * fit.offset_interval.standard_error:.2g} ms; the shape stands on the motion's"
        " clock"
    )
    bench.note("camera_clock", Severity.INFO, seen.clock, said)


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


def mid_span_results(bench: Bench, entry: MidSpan) -> list[Result]:
    """``mid_span_bending_stiffness`` (N m^2) and ``mid_span_curvature`` (1/m)."""
    large = "large-deflection" in entry.corrections
    moment = "P L / 4 + P tan(slope at the supports) x deflection / 2" if large else "P L / 4"
    method = (
        f"slope of the moment {moment} against the curvature at mid-span from "
        f"{1e3 * entry.start:g} mm to {1e3 * entry.stop:g} mm of the first loading, time as "
        "instrument"
    )
    stiffness = Asked("mid_span_bending_stiffness", "N*m^2", _RESTS_ON, method)
    how = "curvature at mid-span where the motion turns, against rest"
    curvature = Asked("mid_span_curvature", "1/m", ("displacement", "clock"), how)
    parts = _at_hand(bench)
    if isinstance(parts, Failure):
        return [to_result(bench, each, parts) for each in (stiffness, curvature)]
    bend, _, branch, time = parts
    during = while_loading(bench)
    return [
        to_result(bench, stiffness, _stiffness(bench, parts, entry, large=large), during=during),
        to_result(bench, curvature, _peak_curvature(bend, branch, time), during=during),
    ]


_RESTS_ON = ("force", "displacement", "clock")
_Parts = tuple[SpanBend, Curve, Branch, Floats]


def _at_hand(bench: Bench) -> _Parts | Failure:
    """Axis, curve, first loading, and the times of the frames on the clock of the curve."""
    bend, curve, branch = bench.span, bench.curve, loading_branch(bench)
    if isinstance(bend, Failure):
        return bend
    if bend is None or curve is None or branch is None:
        return blocked_or(bench, NO_BRANCH)
    fit = bench.other_clocks.get(bench.raw["mid_span"].clock)
    return bend, curve, branch, bend.time if fit is None else fit.to_marker_time(bend.time)


def _stiffness(bench: Bench, parts: _Parts, entry: MidSpan, *, large: bool) -> Estimate | Failure:
    bend, curve, branch, time = parts
    inside = (time >= branch.start_time) & (time < branch.stop_time)
    travelled = np.interp(time, curve.time, curve.displacement)
    if not (travelled[inside] > entry.stop).any():
        reached = 1e3 * float(np.max(travelled[inside], initial=0.0))
        asked = f"{1e3 * entry.stop:.4g} mm is asked"
        return Failure("not_reached", f"the first loading reaches {reached:.4g} mm, {asked}")
    inside &= (travelled >= entry.start) & (travelled <= entry.stop)
    bent = bend.shape.bent
    force = np.interp(time, curve.time, curve.force, left=np.nan, right=np.nan)
    moment = 0.25 * bent.span * force
    if large:
        moment = moment + 0.5 * force * bent.support_slope * np.clip(bent.deflection, 0.0, None)
    found = secant_stiffness(time, bent.mid_span, moment, inside)
    other = secant_stiffness(time, bend.shape.fewer_terms, moment, inside)
    if isinstance(found, Failure) or isinstance(other, Failure):
        return found
    change = abs(other.value - found.value) / sqrt(3.0)  # a rectangle of that half width
    side = bend.shape.side_share * abs(found.value) / sqrt(3.0)
    return with_force_scale(bench, widened(found, change, side))


def _peak_curvature(bend: SpanBend, branch: Branch, time: Floats) -> Estimate | Failure:
    found = _at_turn(bend.shape.bent.mid_span, bend.rest, branch, time)
    other = _at_turn(bend.shape.fewer_terms, bend.rest, branch, time)
    if isinstance(found, Failure) or isinstance(other, Failure):
        return found
    side = bend.shape.side_share * abs(found.value) / sqrt(3.0)
    return widened(found, abs(other.value - found.value) / sqrt(3.0), side)


def _at_turn(values: Floats, rest: Flags, branch: Branch, time: Floats) -> Estimate | Failure:
    """What a quantity is at the end of loading, less what it is at rest."""
    still = values[rest & np.isfinite(values)]
    if len(still) < 8:
        return Failure("no_rest", f"{len(still)} frames before the loading show it, 8 are needed")
    window = min(_AT_TURN, 0.4 * (branch.stop_time - branch.start_time))
    found = _height_of_turn(time - branch.stop_time, values - still.mean(), window)
    if isinstance(found, Failure):
        return found
    zero = float(np.sqrt(long_run_variance(still, parameters=1) / len(still)))
    return widened(found, zero)


def _height_of_turn(time: Floats, values: Floats, window: float) -> Estimate | Failure:
    """Where two parabolas meet at time zero; few frames know little of their noise, hence t."""
    known = np.isfinite(values)
    near = known & (np.abs(time) <= window)
    t, y = time[near], values[near]
    if min((t <= 0.0).sum(), (t > 0.0).sum()) < _LEAST:
        return Failure("too_few_samples", f"{len(t)} frames within {window:.3g} s of the turn")
    ahead, behind = np.maximum(t, 0.0), np.minimum(t, 0.0)
    design = np.column_stack([np.ones_like(t), ahead, ahead**2, behind, behind**2])
    stretches = [(time > low) & (time <= low + _BESIDE) for low in (-window - _BESIDE, window)]
    beside = [values[each] for each in stretches if each.sum() >= 8 and known[each].all()]
    return fit_linear(design, y, beside=beside).estimate(0)


def twist_result(bench: Bench) -> list[Result]:
    """``twist`` (rad): how far the section at mid-span has turned about the axis at the turn."""
    method = (
        "size of the turn of the markers of the section nearest to mid-span about the axis, where "
        "the motion turns"
    )
    asked, parts = Asked("twist", "rad", ("displacement", "clock"), method), _at_hand(bench)
    if isinstance(parts, Failure):
        return [to_result(bench, asked, parts)]
    bend, _, branch, time = parts
    shape = bend.shape
    able = np.flatnonzero(shape.lever > 0.0)
    if not len(able):
        message = (
            f"twist needs two markers at different places around the axis in one section, none of "
            f"the {len(shape.lever)} sections has them"
        )
        return [to_result(bench, asked, Failure("too_few_markers", message))]
    x = np.nanmean(shape.centres[bend.rest][..., 0], axis=0)
    number = int(able[np.argmin(np.abs(x[able]))])
    bench.note(
        "twist_section",
        Severity.INFO,
        "markers",
        f"twist is that of the section {1e3 * x[number]:+.1f} mm from mid-span",
    )
    turned = _at_turn(shape.twist[:, number], bend.rest, branch, time)
    if isinstance(turned, Estimate) and turned.value < 0.0:
        # which way it turns is only a matter of which end of the conduit is called the first
        turned = _at_turn(-shape.twist[:, number], bend.rest, branch, time)
    return [to_result(bench, asked, turned, during=while_loading(bench))]
