"""Fit the shape of the specimen in every frame, as a smooth curve in arc length, to markers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from labpipe.markers.specimen_frame import Selection
from labpipe.markers.track_repair import MIN_MARKERS
from labpipe.markers.tracklets import is_in_sight
from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, Ints, find_run_times
from labpipe.records.causes import CENTRE, GRIP, PULL
from labpipe.records.curve import PointFlag, Shape
from labpipe.records.quality import QualityNote

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Nodes and weights of Gauss-Legendre quadrature on [-1, 1]."""


@dataclass(frozen=True, slots=True, eq=False)
class CurveBasis:
    """Basis functions, power series in u = s / length, that satisfy the end conditions.

    Parameters
    ----------
    length : arc length s at u = 1, m
    matrix : shape (terms, unknowns), coefficients of the power series of each basis function
    """

    length: float
    matrix: Floats

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns per coordinate."""
        return int(self.matrix.shape[1])

    def compute_values(self, arc_length: Floats) -> Floats:
        """Compute the basis functions at arc lengths (n,), m; shape (n, unknowns)."""
        return compute_powers(arc_length / self.length, len(self.matrix)) @ self.matrix

    def compute_slopes(self, arc_length: Floats) -> Floats:
        """Compute the derivatives with respect to arc length, 1/m; shape (n, unknowns)."""
        slopes = compute_power_slopes(arc_length / self.length, len(self.matrix)) / self.length
        return slopes @ self.matrix


def compute_powers(u: Floats, terms: int) -> Floats:
    """Compute the powers 0 to terms - 1 of u, shape (n, terms)."""
    return np.asarray(np.vander(u, terms, increasing=True), dtype=np.float64)


def compute_power_slopes(u: Floats, terms: int) -> Floats:
    """Compute the derivatives of the powers of u, shape (n, terms)."""
    return compute_powers(u, terms) @ np.diag(np.arange(1.0, terms), k=1)


def build_curve_basis(*, terms: int, length: float, has_clamp: bool, free_tip: bool) -> CurveBasis:
    """Build the basis of curves that satisfy the end conditions.

    Parameters
    ----------
    terms : number of coefficients per coordinate
    length : length of the curve, m
    has_clamp : whether position and direction at s = 0 are given; the series then begins with u^2
    free_tip : whether the moment, and thus the second derivative, is zero at s = length

    Returns
    -------
    The basis, orthonormal over 10 `terms` evenly spaced points, for good conditioning.

    Raises
    ------
    ValueError
        If the end conditions leave no free coefficient.
    """
    powers = np.arange(2 if has_clamp else 0, terms)
    if len(powers) < 1 + free_tip:
        needed = (2 if has_clamp else 0) + 1 + free_tip
        raise ValueError(format_sentence("markers.few_terms", terms=terms, needed=needed))
    basis = np.eye(terms)[:, powers]
    if free_tip:
        tip_curvature = (powers * (powers - 1.0))[:, None]
        basis = basis @ np.linalg.qr(tip_curvature, mode="complete")[0][:, 1:]
    _, triangle = np.linalg.qr(compute_powers(np.linspace(0, 1, 10 * terms), terms) @ basis)
    return CurveBasis(length, basis @ np.linalg.inv(triangle))


def build_marker_design(basis: CurveBasis, arc_length: Floats, centre_offset: float) -> Floats:
    """Build the design matrix of the positions of marker centres in x and y.

    Parameters
    ----------
    basis : basis functions of each coordinate
    arc_length : shape (markers,), m, arc lengths of the markers
    centre_offset : distance from the axis to the centre of a marker along n = (-y', x'), m

    Returns
    -------
    Shape (2 x markers, 2 x unknowns). The rows are x, then y of the markers; the columns are the
    unknowns of x, then those of y.
    """
    axis = basis.compute_values(arc_length)
    offset = centre_offset * basis.compute_slopes(arc_length)
    return np.block([[axis, -offset], [offset, axis]])


@dataclass(frozen=True, slots=True, eq=False)
class RestCurve:
    """The specimen at rest, relative to the pivot or, without a clamp, to the origin of positions.

    Parameters
    ----------
    clamped_end : shape (3,), m, position of the clamped end or, without a clamp, of the beginning
    tangent : shape (3,), unit vector along the specimen at this point
    arc_length : shape (markers,), m, arc length from this point to each marker
    ends : conditions at the ends of the curve, which are the same in every frame
    """

    clamped_end: Floats
    tangent: Floats
    arc_length: Floats
    ends: EndConditions


def fit_rest_curve(
    markers: Floats,
    *,
    offsets: Offsets,
    has_clamp: bool,
    free_tip: bool,
    max_change: float = 1e-10,
) -> RestCurve:
    """Fit the clamped end, the tangent there and the arc lengths of markers to the shape at rest.

    Parameters
    ----------
    markers : shape (markers, 3), m, relative to the pivot, in order along the specimen, with x
        along the specimen
    offsets : offsets between markers and specimen
    has_clamp : whether the specimen has a clamp; otherwise it begins at its first marker
    free_tip : whether the moment at the pull point is zero
    max_change : largest change of arc lengths at convergence, m

    Returns
    -------
    The curve at rest.

    Notes
    -----
    A cubic in arc length is fitted (or a lower power for few markers), whose position
    and slope at the beginning are free. The arc lengths are first computed from the chords between
    the markers, and then up to 30 times from the fitted curve, until they converge. The
    beginning of the curve is moved along the tangent there until the distance from the pivot in
    this direction is `offsets.grip`. The pivot need not be on the axis.
    """
    max_rounds, max_terms = 30, 4  # a cubic is enough, because the specimen is nearly straight
    terms = min(max_terms, len(markers) - 1 + free_tip)
    unit_basis = build_curve_basis(terms=terms, length=1.0, has_clamp=False, free_tip=free_tip)
    chords = np.linalg.norm(np.diff(markers, axis=0), axis=1)
    arc_length = np.r_[0.0, np.cumsum(chords)]
    if has_clamp:
        arc_length += markers[0, 0] - offsets.grip
    for _ in range(max_rounds):
        length = float(arc_length[-1]) + offsets.pull
        basis = replace(unit_basis, length=length)
        design = build_marker_design(basis, arc_length, offsets.centre)
        in_plane = np.linalg.lstsq(design, markers[:, :2].T.ravel(), rcond=None)[0].reshape(2, -1)
        values = basis.compute_values(arc_length)
        out_of_plane = np.linalg.lstsq(values, markers[:, 2], rcond=None)[0]
        coefficients = np.vstack([in_plane, out_of_plane]) @ basis.matrix.T
        previous_arc_length = arc_length
        arc_length = _compute_curve_lengths(coefficients, arc_length, length)
        tangent = coefficients[:, 1] / np.linalg.norm(coefficients[:, 1])
        shift = coefficients[:, 0] @ tangent - offsets.grip if has_clamp else 0.0
        arc_length += shift if has_clamp else -arc_length[0]
        if np.abs(arc_length - previous_arc_length).max() < max_change:
            break
    length, direction = float(arc_length[-1]) + offsets.pull, tangent if has_clamp else None
    ends = EndConditions(length=length, direction=direction, free_tip=free_tip)
    return RestCurve(coefficients[:, 0] - shift * tangent, tangent, arc_length, ends)


def _compute_curve_lengths(coefficients: Floats, arc_length: Floats, length: float) -> Floats:
    """Compute the length of the curve up to each value of `arc_length`, its parameter, (n,), m."""
    half_length = arc_length[:, None] / 2
    u = half_length * (1 + _NODES) / length
    tangents = compute_power_slopes(u.ravel(), coefficients.shape[1]) @ coefficients.T / length
    speed = np.linalg.norm(tangents, axis=1).reshape(u.shape)
    return np.asarray((half_length * speed * _WEIGHTS).sum(axis=1), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class EndConditions:
    """Conditions at the ends of the curve.

    Parameters
    ----------
    length : arc length of the last point, m
    direction : shape (3,), unit tangent at the clamped end, which is the origin; None if the
        beginning is free
    free_tip : whether the moment at the last point is zero
    """

    length: float
    direction: Floats | None
    free_tip: bool


@dataclass(frozen=True, slots=True, eq=False)
class FrameFits:
    """Fitted curves of all frames; NaN where there are too few markers.

    Parameters
    ----------
    coefficients : shape (frames, 3, terms), m, coefficients of the power series in s / length
    misfit : shape (frames, 2, markers), m, position of each marker minus that on the curve, x and y
    gain : shape (frames, 3), standard error of the last point per standard deviation of a marker
        coordinate
    freedom : shape (frames,), degrees of freedom per coordinate
    min_markers : smallest number of markers for a fit
    """

    coefficients: Floats
    misfit: Floats
    gain: Floats
    freedom: Ints
    min_markers: int

    @property
    def last_point(self) -> Floats:
        """Position at s = length, shape (frames, 3), m."""
        return np.asarray(self.coefficients.sum(axis=2), dtype=np.float64)

    @property
    def n_spare(self) -> int:
        """Number of further coefficients per coordinate that a frame with all markers allows."""
        return int(self.misfit.shape[2]) - self.min_markers

    @property
    def residual(self) -> Floats:
        """Root mean square misfit per coordinate, shape (frames,), m."""
        is_fitted = np.isfinite(self.misfit)
        squares = np.where(is_fitted, self.misfit**2, 0.0).sum(axis=(1, 2))
        count = is_fitted.sum(axis=(1, 2))
        return np.asarray(np.sqrt(squares / np.where(count > 0, count, np.nan)), dtype=np.float64)

    def estimate_noise(self, rest_frames: Selection) -> float:
        """Estimate the standard deviation of a marker coordinate, m, from the misfit at rest.

        Deviations of the specimen from the model are constant at rest and are removed with the
        mean. The result is NaN for fewer than two complete frames, or without degrees of freedom.
        """
        misfit, freedom = self.misfit[rest_frames], self.freedom[rest_frames]
        is_complete = np.isfinite(misfit).all(axis=(1, 2))
        if is_complete.sum() < 2 or freedom[is_complete][0] < 1:
            return float("nan")
        scatter = np.var(misfit[is_complete], axis=0, ddof=1).mean()
        return float(np.sqrt(scatter * misfit.shape[2] / freedom[is_complete][0]))


def fit_frames(
    markers: Floats,
    arc_length: Floats,
    centre_offset: float,
    conditions: EndConditions,
    *,
    terms: int,
) -> FrameFits:
    """Fit one curve to each frame, in groups of frames with the same visible markers.

    Parameters
    ----------
    markers : shape (frames, markers, 3), m, relative to the clamped end; NaN where missing
    arc_length : shape (markers,), m, arc lengths of the markers
    centre_offset : distance from the axis to the centre of a marker, m
    conditions : conditions at the ends of the curves
    terms : number of coefficients per coordinate

    Returns
    -------
    The fitted curves.

    Raises
    ------
    ValueError
        If there are fewer markers than free coefficients per coordinate, or no free coefficient.

    Notes
    -----
    The design matrix depends on arc length only, so its pseudo-inverse is the same for all frames
    with the same visible markers.
    """
    has_clamp, length = conditions.direction is not None, conditions.length
    free_tip = conditions.free_tip
    basis = build_curve_basis(terms=terms, length=length, has_clamp=has_clamp, free_tip=free_tip)
    n_frames, n_markers = markers.shape[:2]
    if basis.n_unknowns > n_markers:
        facts = {"largest": terms - basis.n_unknowns + n_markers, "count": n_markers}
        raise ValueError(format_sentence("markers.many_terms", terms=terms, **facts))
    given_terms = np.zeros((3, terms))
    direction = np.zeros(3) if conditions.direction is None else conditions.direction
    given_terms[:, 1] = direction * length
    normal = np.array([-direction[1], direction[0], 0.0])
    # The given terms do not depend on the unknowns, so their contribution is subtracted.
    offsets = markers - (arc_length[:, None] * direction + centre_offset * normal)
    fits = FrameFits(
        coefficients=np.full((n_frames, 3, terms), np.nan),
        misfit=np.full((n_frames, 2, n_markers), np.nan),
        gain=np.full((n_frames, 3), np.nan),
        freedom=np.zeros(n_frames, dtype=np.int64),
        min_markers=basis.n_unknowns,
    )
    for is_visible, rows in _group_by_visible_markers(is_in_sight(markers)):
        if is_visible.sum() >= basis.n_unknowns:
            columns, group_arc_length = np.flatnonzero(is_visible), arc_length[is_visible]
            group_offsets = offsets[np.ix_(rows, columns)]
            group = _fit_group(group_offsets, basis, group_arc_length, centre_offset)
            unknowns, fits.misfit[np.ix_(rows, np.arange(2), columns)], fits.gain[rows] = group
            series = unknowns.reshape(-1, basis.n_unknowns) @ np.ascontiguousarray(basis.matrix.T)
            fits.coefficients[rows] = given_terms + series.reshape(-1, 3, terms)
            fits.freedom[rows] = len(columns) - basis.n_unknowns
    return fits


def _fit_group(
    offsets: Floats, basis: CurveBasis, arc_length: Floats, centre_offset: float
) -> tuple[Floats, Floats, Floats]:
    """Fit frames with the same visible markers.

    The offsets of the markers from the given terms of the curve have the shape
    (frames, markers, 3). Return unknowns (frames, 3, unknowns), misfit (frames, 2, markers) and the
    gain of the last point (3,).
    """
    n, design = basis.n_unknowns, build_marker_design(basis, arc_length, centre_offset)
    inverse, inverse_z = np.linalg.pinv(design), np.linalg.pinv(basis.compute_values(arc_length))
    offsets_xy = np.concatenate([offsets[..., 0], offsets[..., 1]], axis=1)
    unknowns_xy = offsets_xy @ inverse.T
    unknowns_z = np.ascontiguousarray(offsets[..., 2]) @ inverse_z.T
    unknowns = np.stack([unknowns_xy[:, :n], unknowns_xy[:, n:], unknowns_z], axis=1)
    misfit = (offsets_xy - unknowns_xy @ design.T).reshape(len(offsets), 2, -1)
    last_values = basis.compute_values(np.array([basis.length]))[0]
    inverses = (inverse[:n], inverse[n:], inverse_z)
    gain = np.array([np.linalg.norm(last_values @ matrix) for matrix in inverses])
    return unknowns, misfit, gain


def _group_by_visible_markers(is_visible: Flags) -> list[tuple[Flags, Ints]]:
    """Group frames by their visible markers; return the flags of the markers, and the frames."""
    codes = np.packbits(is_visible, axis=1)  # sorting rows of flags is far slower
    first_frames, group = np.unique(codes, axis=0, return_index=True, return_inverse=True)[1:]
    patterns = enumerate(is_visible[first_frames])
    return [(pattern, np.flatnonzero(group.ravel() == index)) for index, pattern in patterns]


CLAMPED_END = "clamped end"
PULL_POINT = "pull point"
"""Names of the constructed points of a shape."""


@dataclass(frozen=True, slots=True, eq=False)
class ShapeFit:
    """The fitted shape and its uncertainty.

    Parameters
    ----------
    shape : points of every frame in order along the specimen: clamped end (with a clamp), markers,
        pull point (if there is one)
    clamp_angle : angle from x to the specimen at the clamped end at rest, towards the pull, rad
    residual : shape (frames,), m, root mean square distance per coordinate between markers and
        curve in the plane of bending; NaN in frames without a fit
    marker_noise : standard deviation of one coordinate of one marker, from the scatter of the
        residuals at rest, m; NaN if it is unknown
    tip_gain : shape (frames, 3), standard error of the last point per unit of `marker_noise`
    tip_change : shape (frames, 3), m, change of the last point with one more coefficient, which
        shows the systematic error; NaN if the markers do not allow one more
    perturbed_tip : y of the last point with one offset increased by its standard uncertainty, shape
        (frames,), m, keyed by cause; empty for a specimen without a clamp or with exact offsets
    notes : quality notes
    """

    shape: Shape
    clamp_angle: float
    residual: Floats
    marker_noise: float
    tip_gain: Floats
    tip_change: Floats
    perturbed_tip: Mapping[str, Floats]
    notes: tuple[QualityNote, ...]


@dataclass(frozen=True, slots=True)
class Offsets:
    """Offsets between markers and specimen, m.

    Parameters
    ----------
    grip : distance from the pivot to the clamped end along the specimen; not used without a clamp
    pull : distance from the last marker to the pull point along the specimen; 0 without a pull
        point
    centre : distance from the axis to the centre of a marker, positive towards the pull
    """

    grip: float = 0.0
    pull: float = 0.0
    centre: float = 0.0

    def perturb(self, uncertainties: Offsets) -> dict[str, Offsets]:
        """Increase one uncertain offset at a time by its standard uncertainty.

        Parameters
        ----------
        uncertainties : standard uncertainties of the offsets

        Returns
        -------
        The increased offsets, keyed by the cause of the uncertainty; an exact offset has no entry.
        """
        perturbed_offsets = {
            GRIP: replace(self, grip=self.grip + uncertainties.grip),
            PULL: replace(self, pull=self.pull + uncertainties.pull),
            CENTRE: replace(self, centre=self.centre + uncertainties.centre),
        }
        return {cause: offsets for cause, offsets in perturbed_offsets.items() if offsets != self}


NO_UNCERTAINTY: Final = Offsets()
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
    uncertainties: Offsets = NO_UNCERTAINTY,
    terms: int,
    tip: Literal["free", "loaded"],
    rest_frames: Selection,
) -> ShapeFit:
    """Fit a smooth curve in arc length to the markers of every frame.

    Parameters
    ----------
    markers_specimen : shape (frames, markers, 3), m, in the specimen frame, in order along the
        specimen; NaN where missing
    flags : shape (frames, markers), values of `PointFlag`
    names : name of each marker
    time : shape (frames,), s, times of the frames
    clamp_specimen : shape (frames, 3), m, position of the pivot of the clamp; None for a specimen
        without a clamp, which begins at its first marker. Positions of the shape are then relative
        to the origin of the specimen frame, and otherwise relative to the clamped end
    rotation_lab_to_specimen : shape (3, 3), rotation of the specimen frame, copied to the shape
    offsets : offsets between markers and specimen
    uncertainties : standard uncertainties of `offsets`
    terms : number of coefficients per coordinate
    tip : ``free`` if the moment at the last point is zero; ``loaded`` if it is unknown
    rest_frames : frames before the first loading

    Returns
    -------
    The fit, which is NaN in frames with too few markers.

    Raises
    ------
    ValueError
        If shapes differ, or if there are too few markers for `terms`, or fewer than three at rest.

    Notes
    -----
    Relative to the clamp, which does not turn, x(s), y(s), z(s) are power series in s / L. The
    shape at rest (`fit_rest_curve`) determines r(0) and r'(0), and r''(L) = 0 for a free tip. The
    centre of marker i is r(s_i) + h n(s_i), n = (-y', x', 0). Least squares is therefore linear,
    and one pseudo-inverse is enough for all frames with the same visible markers. A quartic y(x)
    would fail when the tip approaches the vertical.

    With 8 markers on 85 mm and 7 terms, the error of the tip of an elastic wire is below 7 um up to
    53 mm of deflection. The error of a wire that kinks (bilinear law) is below 0.1 mm, which
    `tip_change` shows.
    """
    # Errors of `perturbed_tip` below 1e-5 m have no effect on the uncertainty.
    perturbed_max_change = 1e-8  # change of arc lengths at convergence, m
    shapes, expected = (markers_specimen.shape, flags.shape), (len(time), len(names))
    if shapes != ((*expected, 3), expected):
        raise ValueError(format_sentence("markers.shapes_differ", found=shapes, expected=expected))
    has_clamp, free_tip = clamp_specimen is not None, tip == "free"
    all_markers = markers_specimen - (0.0 if clamp_specimen is None else clamp_specimen[:, None])
    is_seen_at_rest = np.asarray(is_in_sight(all_markers[rest_frames]).any(axis=0), dtype=np.bool_)
    markers = all_markers[:, is_seen_at_rest]
    if (count := markers.shape[1]) < MIN_MARKERS:
        raise ValueError(format_sentence("markers.few_at_rest", count=count, needed=MIN_MARKERS))
    mean_markers = np.nanmean(markers[rest_frames], axis=0)
    fit_rest = partial(fit_rest_curve, mean_markers, has_clamp=has_clamp, free_tip=free_tip)

    def fit_all(curve: RestCurve, offsets: Offsets, terms: int = terms) -> FrameFits:
        """Fit all frames relative to a curve at rest."""
        positions = markers - (curve.clamped_end if has_clamp else 0.0)
        return fit_frames(positions, curve.arc_length, offsets.centre, curve.ends, terms=terms)

    perturbed_tip = {}
    for cause, increased_offsets in (offsets.perturb(uncertainties) if has_clamp else {}).items():
        perturbed_curve = fit_rest(offsets=increased_offsets, max_change=perturbed_max_change)
        perturbed_tip[cause] = fit_all(perturbed_curve, increased_offsets).last_point[:, 1]
    rest_curve = fit_rest(offsets=offsets)
    ends, fit = rest_curve.ends, fit_all(rest_curve, offsets)
    tip_change = np.full_like(fit.gain, np.nan)
    if fit.n_spare > 0:
        tip_change = fit_all(rest_curve, offsets, terms + 1).last_point - fit.last_point
    markers = markers - (rest_curve.clamped_end if has_clamp else 0.0)
    marker_flags = np.where(is_in_sight(markers), flags[:, is_seen_at_rest], PointFlag.MISSING)
    marker_names = np.array(names)[is_seen_at_rest].tolist()
    points = [(markers, marker_flags, rest_curve.arc_length, marker_names)]
    if has_clamp:
        is_visible = is_in_sight(markers).any(axis=1, keepdims=True)
        clamped_end = np.where(is_visible, np.zeros(3), np.nan)
        points.insert(0, _make_point(clamped_end, 0.0, CLAMPED_END))
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
        marker_noise=fit.estimate_noise(rest_frames),
        tip_gain=fit.gain,
        tip_change=tip_change,
        perturbed_tip=perturbed_tip,
        notes=tuple(_make_notes(names, is_seen_at_rest, fit, time)),
    )


def compute_deflection(shape: Shape, *, rest_frames: Selection) -> Floats:
    """Compute the deflection of the last point relative to the first, normal to the specimen.

    Parameters
    ----------
    shape : shape from `fit_shape`
    rest_frames : frames in which the deflection is zero on average

    Returns
    -------
    Shape (frames,), m, along y; NaN where one of the points is missing.

    Raises
    ------
    ValueError
        If no frame of `rest_frames` has both points.
    """
    relative_y: Floats = shape.positions[:, -1, 1] - shape.positions[:, 0, 1]
    y_at_rest = relative_y[rest_frames]
    y_at_rest = y_at_rest[np.isfinite(y_at_rest)]
    if not len(y_at_rest):
        raise ValueError(format_sentence("markers.no_ends_at_rest"))
    return np.asarray(relative_y - y_at_rest.mean(), dtype=np.float64)


def _make_point(
    positions: Floats, arc_length: float, name: str
) -> tuple[Floats, NDArray[Any], Floats, list[str]]:
    """Make the positions, flags, arc length and name of a constructed point of the shape."""
    flags = np.where(is_in_sight(positions), PointFlag.CONSTRUCTED, PointFlag.MISSING)
    return positions[:, None], flags[:, None], np.array([arc_length]), [name]


def _make_notes(
    names: Sequence[str], is_seen_at_rest: Flags, fit: FrameFits, time: Floats
) -> Iterator[QualityNote]:
    """Make notes on markers that are not seen at rest, and on frames without a shape."""
    for name in np.array(names)[~is_seen_at_rest].tolist():
        yield QualityNote.of("markers.marker_not_at_rest", name, name=name)
    is_missing = ~is_in_sight(fit.last_point)
    if is_missing.any():
        times, stretches = time[is_missing], find_run_times(is_missing, time)
        yield QualityNote.of(
            "markers.shape_missing",
            "markers",
            *stretches,
            share=f"{len(times)} of {len(time)} frames",
            span=f"{times[0]:.3f} s to {times[-1]:.3f} s",
            needed=fit.min_markers,
        )
