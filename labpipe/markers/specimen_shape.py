"""Fit the shape of the specimen in every frame: a smooth curve in arc length to its markers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from labpipe.markers.curve_fits import (
    SETTLED,
    EndConditions,
    FrameFits,
    RestCurve,
    fit_frames,
    fit_rest_curve,
)
from labpipe.markers.specimen_frame import Selection
from labpipe.markers.track_repair import MIN_MARKERS
from labpipe.markers.tracklets import is_in_sight
from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, find_run_times
from labpipe.records.causes import CENTRE, GRIP, PULL
from labpipe.records.curve import PointFlag, Shape
from labpipe.records.quality import QualityNote

CLAMPED_END = "clamped end"
PULL_POINT = "pull point"


@dataclass(frozen=True, slots=True, eq=False)
class ShapeFit:
    """The fitted shape and its uncertainty.

    Parameters
    ----------
    shape : points of every frame in order along the specimen: clamped end (with a clamp), markers,
        pull point (if there is one)
    clamp_angle : rad, from x to the specimen at the clamped end, towards the pull
    residual : shape (frames,), m, root mean square distance per coordinate between markers and
        curve in the plane of bending; NaN where there is no fit
    marker_noise : m, standard deviation of one coordinate of one marker, from the scatter of the
        residuals at rest; NaN if it is unknown
    tip_gain : shape (frames, 3), standard error of the last point per unit of `marker_noise`
    tip_systematic : shape (frames, 3), m, change of the last point with one more coefficient; NaN
        if the markers do not allow one more
    perturbed_tip : by cause, shape (frames,), m, y of the last point with one offset increased by
        its standard uncertainty; empty for a specimen without a clamp or with exact offsets
    notes : quality notes
    """

    shape: Shape
    clamp_angle: float
    residual: Floats
    marker_noise: float
    tip_gain: Floats
    tip_systematic: Floats
    perturbed_tip: Mapping[str, Floats]
    notes: tuple[QualityNote, ...]


@dataclass(frozen=True, slots=True)
class Offsets:
    """Offsets between markers and specimen, m.

    Parameters
    ----------
    grip : pivot to clamped end along the specimen; unused without a clamp
    pull : last marker to pull point along the specimen; 0 for no pull point
    centre : axis to marker centre, positive towards the pull
    """

    grip: float = 0.0
    pull: float = 0.0
    centre: float = 0.0

    def perturb(self, by: Offsets) -> dict[str, Offsets]:
        """Return, by cause, the offsets with one uncertain offset increased.

        Parameters
        ----------
        by : standard uncertainties; an offset with 0 is left out
        """
        increased = {
            GRIP: replace(self, grip=self.grip + by.grip),
            PULL: replace(self, pull=self.pull + by.pull),
            CENTRE: replace(self, centre=self.centre + by.centre),
        }
        return {cause: offsets for cause, offsets in increased.items() if offsets != self}


EXACT: Final = Offsets()
"""Standard uncertainties of exact offsets."""


def fit_shape(
    markers_specimen: Floats,
    flags: NDArray[np.uint8],
    names: Sequence[str],
    time: Floats,
    *,
    clamp_specimen: Floats | None,
    rotation_lab_to_specimen: Floats,
    offsets: Offsets,
    uncertainties: Offsets = EXACT,
    terms: int,
    tip: Literal["free", "loaded"],
    rest: Selection,
) -> ShapeFit:
    """Fit a smooth curve in arc length to the markers of every frame.

    Parameters
    ----------
    markers_specimen : shape (frames, markers, 3), m, in the specimen frame, in order along the
        specimen; NaN where missing
    flags : shape (frames, markers), values of `PointFlag`
    names : one per marker
    time : shape (frames,), s
    clamp_specimen : shape (frames, 3), m, pivot of the clamp; None for a specimen without a clamp,
        which begins at its first marker and keeps the origin of the frame
    rotation_lab_to_specimen : shape (3, 3), copied to the shape
    offsets : between markers and specimen
    uncertainties : standard uncertainties of `offsets`
    terms : coefficients per coordinate
    tip : ``free``: no moment at the last point; ``loaded``: no condition there
    rest : frames before the first loading

    Returns
    -------
    The fit. A frame with too few markers is NaN.

    Raises
    ------
    ValueError
        If shapes differ, or if there are too few markers for `terms`, or fewer than three at rest.

    Notes
    -----
    Relative to the clamp, which does not turn, x(s), y(s), z(s) are power series in s / L with
    r(0) and r'(0) given by the shape at rest (`fit_rest_curve`), and r''(L) = 0 for a free tip. The
    centre of marker i is r(s_i) + h n(s_i), n = (-y', x', 0), so least squares is linear, and one
    pseudo-inverse is enough for all frames with the same markers. A quartic y(x) would fail as the
    tip approaches the vertical.

    With 8 markers on 85 mm and 7 terms the error of the tip of an elastic wire is below 7 um up to
    53 mm of deflection; if the wire kinks (bilinear law), it is below 0.1 mm, as `tip_systematic`
    shows.
    """
    # m, change of arc lengths at convergence; errors of `perturbed_tip` below 1e-5 m do not matter
    perturbed_settled = 1e-8
    actual, expected = (markers_specimen.shape, flags.shape), (len(time), len(names))
    if actual != ((*expected, 3), expected):
        raise ValueError(format_sentence("markers.shapes_differ", found=actual, expected=expected))
    clamped, free_tip = clamp_specimen is not None, tip == "free"
    relative = markers_specimen - (0.0 if clamp_specimen is None else clamp_specimen[:, None])
    is_seen_at_rest = np.asarray(is_in_sight(relative[rest]).any(axis=0), dtype=np.bool_)
    markers = relative[:, is_seen_at_rest]
    if (count := markers.shape[1]) < MIN_MARKERS:
        raise ValueError(format_sentence("markers.few_at_rest", count=count, needed=MIN_MARKERS))
    mean_markers = np.nanmean(markers[rest], axis=0)
    fit_rest = partial(_fit_rest, mean_markers, clamped=clamped, free_tip=free_tip)
    perturbed_offsets = offsets.perturb(uncertainties) if clamped else {}
    perturbed_tip = {}
    for cause, increased_offsets in perturbed_offsets.items():
        rest_curve, ends = fit_rest(increased_offsets, settled=perturbed_settled)
        fit = fit_frames(
            markers - rest_curve.clamped_end,
            rest_curve.arc_length,
            increased_offsets.centre,
            ends,
            terms=terms,
        )
        perturbed_tip[cause] = fit.last_point[:, 1]
    rest_curve, ends = fit_rest(offsets)
    markers = markers - (rest_curve.clamped_end if clamped else 0.0)
    fit_inputs = (markers, rest_curve.arc_length, offsets.centre, ends)
    fit = fit_frames(*fit_inputs, terms=terms)
    finer_fit = fit_frames(*fit_inputs, terms=terms + 1) if fit.n_spare > 0 else None
    marker_flags = np.where(is_in_sight(markers), flags[:, is_seen_at_rest], PointFlag.MISSING)
    marker_names = np.array(names)[is_seen_at_rest].tolist()
    points = [(markers, marker_flags, rest_curve.arc_length, marker_names)]
    if clamped:
        is_visible = is_in_sight(markers).any(axis=1, keepdims=True)
        positions = np.where(is_visible, np.zeros(3), np.nan)
        points.insert(0, _make_point(positions, 0.0, CLAMPED_END))
    if ends.length > rest_curve.arc_length[-1]:
        points.append(_make_point(fit.last_point, ends.length, PULL_POINT))
    point_positions, point_flags, arc_length, point_names = zip(*points, strict=True)
    return ShapeFit(
        shape=Shape(
            time=time,
            positions=np.concatenate(point_positions, axis=1),
            names=tuple(chain.from_iterable(point_names)),
            flags=np.concatenate(point_flags, axis=1).astype(np.uint8),
            arc_length=np.concatenate(arc_length),
            coefficients=fit.coefficients,
            length=ends.length,
            rotation_lab_to_specimen=rotation_lab_to_specimen,
        ),
        clamp_angle=float(np.arctan2(rest_curve.tangent[1], rest_curve.tangent[0])),
        residual=fit.residual,
        marker_noise=fit.noise(rest),
        tip_gain=fit.gain,
        tip_systematic=(
            np.full_like(fit.gain, np.nan)
            if finer_fit is None
            else finer_fit.last_point - fit.last_point
        ),
        perturbed_tip=perturbed_tip,
        notes=_make_notes(names, is_seen_at_rest, fit, time),
    )


def _fit_rest(
    markers: Floats, offsets: Offsets, *, clamped: bool, free_tip: bool, settled: float = SETTLED
) -> tuple[RestCurve, EndConditions]:
    """Return the curve at rest through mean markers (markers, 3), and the end conditions."""
    rest_curve = fit_rest_curve(
        markers,
        grip_offset=offsets.grip if clamped else None,
        pull_offset=offsets.pull,
        centre_offset=offsets.centre,
        free_tip=free_tip,
        settled=settled,
    )
    ends = EndConditions(
        length=float(rest_curve.arc_length[-1]) + offsets.pull,
        direction=rest_curve.tangent if clamped else None,
        free_tip=free_tip,
    )
    return rest_curve, ends


def compute_deflection(shape: Shape, *, rest: Selection) -> Floats:
    """Compute the deflection of the last point relative to the first, normal to the specimen.

    Parameters
    ----------
    shape : from `fit_shape`
    rest : frames in which the deflection is zero on average

    Returns
    -------
    shape (frames,), m, along y; NaN where either point is missing.

    Raises
    ------
    ValueError
        If no frame of `rest` has both points.
    """
    relative_y: Floats = shape.positions[:, -1, 1] - shape.positions[:, 0, 1]
    y_at_rest = relative_y[rest]
    y_at_rest = y_at_rest[np.isfinite(y_at_rest)]
    if not len(y_at_rest):
        raise ValueError(format_sentence("markers.no_ends_at_rest"))
    return np.asarray(relative_y - y_at_rest.mean(), dtype=np.float64)


def _make_point(
    positions: Floats, arc_length: float, name: str
) -> tuple[Floats, NDArray[Any], Floats, list[str]]:
    """Return a constructed point of the shape: positions, flags, arc length and name."""
    flags = np.where(is_in_sight(positions), PointFlag.CONSTRUCTED, PointFlag.MISSING)
    return positions[:, None], flags[:, None], np.array([arc_length]), [name]


def _make_notes(
    names: Sequence[str], is_seen_at_rest: Flags, fit: FrameFits, time: Floats
) -> tuple[QualityNote, ...]:
    notes = [
        QualityNote.of("markers.marker_not_at_rest", name, name=name)
        for name in np.array(names)[~is_seen_at_rest].tolist()
    ]
    is_missing = ~is_in_sight(fit.last_point)
    missing_frames = np.flatnonzero(is_missing)
    if len(missing_frames):
        share = f"{len(missing_frames)} of {len(time)} frames"
        span = f"{time[missing_frames[0]]:.3f} s to {time[missing_frames[-1]]:.3f} s"
        note = QualityNote.of(
            "markers.shape_missing",
            "markers",
            *find_run_times(is_missing, time),
            share=share,
            span=span,
            needed=fit.min_markers,
        )
        notes.append(note)
    return tuple(notes)
