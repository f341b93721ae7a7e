"""Fit the bent axis between two supports to marker tracks, and align the clock of the cameras."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from labpipe.markers.rings import Sections, find_sections
from labpipe.markers.three_point_axis import SpanShape, fit_span
from labpipe.process.calibrated_signals import Prepared, Take
from labpipe.process.motion import turning_points
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import ClockFit, Interval, PointFlag, Shape
from labpipe.records.declarations import ThreePointShape
from labpipe.records.estimates import Failure
from labpipe.records.quality import (
    Finding,
    info_note,
    not_available,
)
from labpipe.records.signals import Signal
from labpipe.results.reduced_test import SpanBend
from labpipe.signal.clock_alignment import match_peaks
from labpipe.signal.turning_points import Stroke, find_strokes
from labpipe.uncertainty.autocorrelation import long_run_variance

NO_SPAN = Failure(
    "no_span",
    "specimen.span, the distance of the supports, is not given: write it into the specimen of the "
    "test sheet, such as 'span: 152.4 mm'",
)
_DRIFT = 1e-4 / sqrt(3.0)
"""Standard uncertainty of the drift of the camera clock, which one turn does not show."""


def bend_between_supports(
    prepared: Prepared, step: ThreePointShape, protocol: Protocol
) -> tuple[Prepared, list[Finding]]:
    """Carry out ``three-point-shape``: the bent axis, and the signal ``mid_span``.

    Parameters
    ----------
    prepared : with repaired tracks
    step : of the protocol
    protocol : with span and marker block

    Returns
    -------
    The test with axis, shape and signal, or the reason why there are none.

    Raises
    ------
    ValueError
        If the markers were not repaired before.
    """
    take, settings = prepared.take, protocol.markers
    tracks, repaired = take.tracks, take.repaired
    if tracks is None or settings is None or repaired is None:
        message = "expected a role with marker tracks, a block markers: and repair-markers before"
        raise ValueError(message)
    span = protocol.specimen.span
    if span is None:
        return _without_span(prepared, NO_SPAN)
    rest = np.asarray(tracks.time <= tracks.time[0] + step.over)
    try:
        sections = find_sections(repaired.positions, rest=rest, min_distance=step.section)
        shape = fit_span(
            sections,
            span=span,
            radius=settings.centre_offset,
            facing=step.facing,
            bent_most=_is_bent_most(sections),
        )
    except ValueError as error:
        return _without_span(prepared, Failure("too_few_markers", str(error)))
    summary = (
        f"{sections.count} sections of markers, {int((shape.lever > 0.0).sum())} of them with two "
        f"or more around the axis; points lie {1e6 * shape.bent.noise:.3g} um off the bent axis"
    )
    bent = replace(
        prepared,
        signals=prepared.signals.with_new("mid_span", _mid_span(shape, tracks.time, rest, take)),
        shape=_span_shape(sections, shape, tracks.time, repaired.flags),
        span=SpanBend(shape, tracks.time, rest),
    )
    return bent, [info_note("three_point_shape", take.role, summary)]


def _without_span(prepared: Prepared, reason: Failure) -> tuple[Prepared, list[Finding]]:
    return replace(prepared, span=reason), [not_available(reason.code, "markers", reason.message)]


def _mid_span(shape: SpanShape, time: Floats, rest: Flags, take: Take) -> Signal:
    deflection = shape.bent.deflection
    at_rest = deflection[rest & np.isfinite(deflection)]
    zero = float(np.sqrt(long_run_variance(at_rest, parameters=1) / len(at_rest)))
    return replace(take.signal_of(time, deflection - at_rest.mean()), zero_error=zero)


def _is_bent_most(sections: Sections) -> Flags:
    """Flag frames with more than half of the largest deflection."""
    moved = np.abs(sections.markers[..., 1] - sections.at_rest[:, 1])
    far = np.max(np.nan_to_num(moved), axis=1)
    return np.asarray(far > 0.5 * far.max(), dtype=np.bool_)


def _span_shape(
    sections: Sections, shape: SpanShape, time: Floats, flags: NDArray[np.uint8]
) -> Shape:
    """Make the shape: section centres as points, and a power series of the axis for figures."""
    # Of the stored power series, which only the figure uses.
    degree = 9
    section_flags = flags[:, sections.columns]
    is_finite = np.isfinite(shape.centres).all(axis=2)
    of_section = np.stack(
        [section_flags[:, sections.section == k].max(axis=1) for k in range(sections.count)], axis=1
    )
    x = sections.x - shape.mid_span
    share = np.linspace(0.0, 1.0, 61)
    drawn = x[0] + share * (x[-1] - x[0])
    to_terms = np.linalg.pinv(np.vander(share, degree + 1, increasing=True))
    height = shape.bent.y(drawn) @ to_terms.T
    coefficients = np.zeros((len(time), 3, degree + 1))
    coefficients[:, 0, :2] = [x[0], x[-1] - x[0]]
    coefficients[:, 1] = height
    coefficients[np.isnan(height).any(axis=1)] = np.nan
    return Shape(
        time=time,
        positions=shape.centres,
        names=tuple(f"section {number + 1}" for number in range(sections.count)),
        flags=np.where(is_finite, of_section, PointFlag.MISSING).astype(np.uint8),
        arc_length=x - x[0],
        coefficients=coefficients,
        length=float(x[-1] - x[0]),
        rotation_lab_to_specimen=sections.rotation_lab_to_specimen,
    )


def align_cameras(
    prepared: Prepared, motion: Signal, strokes: tuple[Stroke, ...], *, min_stroke: float
) -> tuple[Prepared, dict[str, ClockFit], list[Finding]]:
    """Fit the clock of the cameras to that of the motion, at the turns of mid-span.

    Parameters
    ----------
    prepared : its ``mid_span`` is used
    motion, strokes : the displacement
    min_stroke : m, of the protocol

    Returns
    -------
    The test with its shape on the clock of the motion, the clock of the cameras by name, findings.
    """
    # s on each side of a turn of mid-span.
    window = 25.0
    mid_span = prepared.signals.raw.get("mid_span")
    if mid_span is None or mid_span.clock == motion.clock:
        return prepared, {}, []
    own_strokes = find_strokes(mid_span.time, mid_span.values, min_stroke=min_stroke)
    turns = turning_points(motion, strokes, window=window)
    camera_turns = turning_points(mid_span, own_strokes, window=window)
    first = np.array([turn.middle for turn in turns if strokes[turn.stroke].sign > 0])
    second = np.array([turn.middle for turn in camera_turns if own_strokes[turn.stroke].sign > 0])
    pairs, _ = match_peaks(first, second)
    if not len(pairs):
        message = "the cameras recorded no turn of mid-span at a turn of the motion"
        prepared, findings = _without_span(prepared, Failure("no_camera_clock", message))
        return prepared, {}, findings
    errors = [turn.arrival.time_error for turn in camera_turns if own_strokes[turn.stroke].sign > 0]
    fit = _camera_fit(first[pairs[:, 0]], second[pairs[:, 1]], np.array(errors)[pairs[:, 1]])
    shape = prepared.shape
    if shape is not None:
        shape = replace(shape, time=fit.to_marker_time(shape.time))
    message = (
        f"the cameras are {fit.offset:.4f} s ahead of the motion, known to "
        f"{1.96e3 * fit.offset_interval.standard_error:.2g} ms; the shape is on the clock "
        "of the motion"
    )
    note = info_note("camera_clock", mid_span.clock, message)
    return replace(prepared, shape=shape), {mid_span.clock: fit}, [note]


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
