"""Measure curvature and moment (the cloud), and fit the law of the first loading.

Markers give the shape and the force gives the moment; no stiffness is assumed. The frame is that of
the specimen: x along its undeformed axis from the clamped end, y in the plane of bending towards
the pull. The shapes that follow from a law are compared with the markers. The fit of the law
differentiates no curve, so its curvatures are much more accurate than those of the cloud, which are
second derivatives.

The wire keeps its length and its direction at the clamp. Its angle in frame f is

    theta_f(s) = theta_rest(s) + integral from 0 to s of [kappa(M_f) - kappa(M_rest)] ds'

with one law kappa(M) for all places and frames. If the weight of the specimen or at its tip had
bent it the other way, it reverses by Masing's rule until it is bent as much this way:

    kappa - kappa(M_rest) = 2 kappa((M_f - M_rest) / 2).

x = integral cos theta, y = integral sin theta, and markers are offset along the normal.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.polynomial.polynomial import polyder, polyint, polyval

from labpipe.markers.specimen_shape import (
    EndConditions,
    FrameFits,
    build_curve_basis,
    build_marker_design,
    fit_frames,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import NORMAL_95, Bending, BendingCloud, MeasuredLaw, PointFlag, Shape
from labpipe.records.quality import Reason

N_FIT_MEANS = 80
"""Number of means for the fit of the first loading: at least this, less than twice this.

Fewer if the loading has fewer frames, or if means have no shape or force.
"""
N_CLOUD_ROWS = 50
"""Number of rows of the cloud in the first loading, with the limits of `N_FIT_MEANS`."""
N_CLOUD_STATIONS = 17
"""Number of places along the specimen in the cloud."""
RECTANGULAR_DEVIATION = 1.0 / np.sqrt(3.0)
"""Standard deviation of a rectangular distribution of half-width one."""


@dataclass(frozen=True, slots=True, eq=False)
class TipPull:
    """The force at the tip, from the reading of the load cell.

    Parameters
    ----------
    string : m, length of the string from the load cell to the tip; None for a force normal to the
        clamped axis
    weight : N, at the tip
    tension_at_rest : N, in the string before the loading, removed by the zero of the force
    anchor : m, place of the load cell along x
    self_weight : N/m, of the level specimen
    """

    string: float | None
    weight: float
    tension_at_rest: float
    anchor: float
    self_weight: float = 0.0

    def compute_force(self, reading: Floats, tip: Floats) -> Floats:
        """Return the force at the tip, N.

        Parameters
        ----------
        reading : shape (n,), N, the tension less that at rest; NaN gives NaN
        tip : shape (n,), m, place of the tip along x

        Returns
        -------
        shape (n, 2), N, along x and y. The y component is NaN if the tip is farther from the anchor
        along x than the string is long; the x component is not.

        Notes
        -----
        The load cell is above the tip at rest, so the string leans towards the anchor as the tip
        moves inward: sin(beta) = (anchor - x) / string.
        """
        tension = reading + self.tension_at_rest
        lean = np.zeros_like(tip) if self.string is None else (self.anchor - tip) / self.string
        force_across = tension * np.sqrt(np.where(np.abs(lean) <= 1.0, 1.0 - lean**2, np.nan))
        return np.stack([tension * lean, force_across - self.weight], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class StationCurves:
    """Curves at stations; arrays of shape (n, stations).

    Parameters
    ----------
    x, y : m
    angle : rad, of the tangent from x
    curvature : 1/m
    """

    x: Floats
    y: Floats
    angle: Floats
    curvature: Floats


def evaluate_curves(coefficients: Floats, length: float, arc_length: Floats) -> StationCurves:
    """Evaluate fitted curves in the plane of bending.

    Parameters
    ----------
    coefficients : shape (n, 3, terms), m, power series in s / length; NaN gives NaN
    length : m
    arc_length : shape (stations,), m

    Returns
    -------
    Place, direction and curvature.

    Notes
    -----
    kappa = (x' y'' - y' x'') / (x'^2 + y'^2)^(3/2): the parameter of a fitted curve is only nearly
    its arc length.
    """
    powers, u = np.moveaxis(coefficients[:, :2], -1, 0), arc_length / length
    (x, y), (rate_x, rate_y), (bend_x, bend_y) = (
        np.moveaxis(polyval(u, polyder(powers, order)), 1, 0) / length**order for order in range(3)
    )
    curvature = (rate_x * bend_y - rate_y * bend_x) / np.hypot(rate_x, rate_y) ** 3
    return StationCurves(x, y, np.arctan2(rate_y, rate_x), curvature)


@dataclass(frozen=True, slots=True)
class BendingErrors:
    """Standard errors of force and places.

    Parameters
    ----------
    force_noise : N, of the curve's force in one frame
    force_zero : N
    force_scale : a share
    offset : m, of the clamped end and of the pull point along the specimen
    other_tension_at_rest : N, a tension at rest as probable as the assumed one, or None
    centre : m, of the markers' centres across the specimen
    """

    force_noise: float
    force_zero: float
    force_scale: float
    offset: float
    other_tension_at_rest: float | None = None
    centre: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FittedFrames:
    """Means over consecutive frames of a branch, with shape and force, and the curves through them.

    Parameters
    ----------
    time, force : shape (n,), s, N
    branch : shape (n,)
    markers : shape (n, markers, 3), m, from the clamped end; NaN if a marker was not measured in
        every frame of the mean
    per_mean : frames of each mean
    coefficients : shape (n, 3, terms), m
    finer : shape (n, 3, terms + 1), m; None if the markers do not determine one more coefficient
    tip_gain : shape (n,), standard error of the tip in x or y, whichever is larger, per standard
        deviation of a marker coordinate
    """

    time: Floats
    force: Floats
    branch: Ints
    markers: Floats
    per_mean: int
    coefficients: Floats
    finer: Floats | None
    tip_gain: Floats


@dataclass(frozen=True, slots=True, eq=False)
class SpecimenAtRest:
    """The specimen at rest.

    Parameters
    ----------
    markers : shape (markers, 3), m, mean places
    coefficients : shape (1, 3, terms), m, of the mean curve
    finer : the same with one more coefficient; with as many if the markers determine no more
    frames : number of frames with all markers
    noise : m, standard deviation of a marker coordinate; NaN without residuals
    """

    markers: Floats
    coefficients: Floats
    finer: Floats
    frames: int
    noise: float


def average_frames(shape: Shape, branch: Ints, *, per_mean: int) -> tuple[Ints, Floats]:
    """Average the markers of consecutive frames of a branch.

    Parameters
    ----------
    shape : marker positions. A marker is averaged if it is known in all frames of a mean, and
        measured in three quarters of them; the others were filled across short gaps
    branch : shape (frames,); frames of a negative branch are excluded
    per_mean : frames; the remainder at the end of a branch is excluded

    Returns
    -------
    rows : shape (n, per_mean), the frames of each mean, in order of time
    markers : shape (n, markers, 3), m, from the clamped end
    """
    min_measured_share = 0.75
    edges = np.concatenate([[0], np.flatnonzero(np.diff(branch)) + 1, [len(branch)]])
    groups = [
        np.arange(first, last - per_mean + 1, per_mean)
        for first, last in pairwise(edges)
        if branch[first] >= 0
    ]
    rows = np.concatenate([np.zeros(0, np.int64), *groups])[:, None] + np.arange(per_mean)
    points = rows[..., None], np.flatnonzero(_flag_markers(shape))
    flags = shape.flags[points]
    is_measured = np.isin(flags, (PointFlag.MEASURED, PointFlag.RELABELLED))
    is_used = is_measured.mean(axis=1, keepdims=True) >= min_measured_share
    is_used = is_used & (is_measured | (flags == PointFlag.FILLED))
    return rows, np.where(is_used[..., None], shape.positions[points], np.nan).mean(axis=1)


def _flag_markers(shape: Shape) -> Flags:
    """Flag the points of a shape that are markers, not constructed: shape (points,)."""
    return np.asarray(~(shape.flags == PointFlag.CONSTRUCTED).any(axis=0), dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class BendingTest:
    """A bending test with shape and curve; arrays of shape (frames,).

    Parameters
    ----------
    shape : shape fitted in every frame, with clamped end and pull point
    force : N, of the curve at the frames; NaN without one
    branch, cycle : branch and cycle of the curve at the frames
    first : branch of the first loading
    rest : frames before the loading
    centre_offset : m, axis to marker centre, positive towards the pull
    free_tip : whether the shapes were fitted without a moment at the tip
    pull : pull at the tip
    errors : errors of force and positions
    """

    shape: Shape
    force: Floats
    branch: Ints
    cycle: Ints
    first: int
    rest: Flags
    centre_offset: float
    free_tip: bool
    pull: TipPull
    errors: BendingErrors

    @cached_property
    def marker_places(self) -> Floats:
        """Return the arc lengths of the markers from the clamped end, m, shape (markers,)."""
        return self.shape.arc_length[_flag_markers(self.shape)]

    @cached_property
    def ends(self) -> EndConditions:
        """Return the conditions at the ends with which the shapes were fitted.

        Raises
        ------
        ValueError
            If no frame has a curve.
        """
        shape = self.shape
        fitted = np.flatnonzero(np.isfinite(shape.coefficients).all(axis=(1, 2)))
        if not len(fitted):
            raise ValueError(format_sentence("results.no_fitted_frame"))
        direction = shape.coefficients[fitted[0], :, 1] / shape.length
        return EndConditions(length=shape.length, direction=direction, free_tip=self.free_tip)

    def fit_curves(self, markers: Floats, *, extra_terms: int = 0) -> FrameFits:
        """Fit the curve through markers of shape (n, markers, 3), with extra coefficients."""
        terms = int(self.shape.coefficients.shape[2]) + extra_terms
        return fit_frames(markers, self.marker_places, self.centre_offset, self.ends, terms=terms)

    @cached_property
    def specimen_at_rest(self) -> SpecimenAtRest:
        """Return the specimen at rest.

        Raises
        ------
        ValueError
            If fewer than two frames at rest show all markers, or no frame has a curve.
        """
        _, markers = average_frames(self.shape, np.where(self.rest, 0, -1), per_mean=1)
        markers = markers[np.isfinite(markers).all(axis=(1, 2))]
        if len(markers) < 2:
            raise ValueError(format_sentence("results.few_frames_at_rest", count=len(markers)))
        fit, middle = self.fit_curves(markers), markers.mean(axis=0)
        return SpecimenAtRest(
            markers=middle,
            coefficients=fit.coefficients.mean(axis=0)[None],
            finer=self.fit_curves(middle[None], extra_terms=min(fit.n_spare, 1)).coefficients,
            frames=len(markers),
            noise=fit.estimate_noise(slice(None)),
        )

    def fit_means(self, branch: Ints, *, per_mean: int) -> FittedFrames:
        """Fit curves through means over consecutive frames.

        Parameters
        ----------
        branch : shape (frames,); frames of a negative branch are excluded
        per_mean : frames

        Raises
        ------
        ValueError
            If no frame has a curve, or no mean has both a shape and a force.
        """
        rows, markers = average_frames(self.shape, branch, per_mean=per_mean)
        fit, force = self.fit_curves(markers), self.force[rows].mean(axis=1)
        usable = np.isfinite(fit.coefficients).all(axis=(1, 2)) & np.isfinite(force)
        if not usable.any():
            raise ValueError(format_sentence("results.no_means"))
        rows, markers = rows[usable], markers[usable]
        return FittedFrames(
            time=self.shape.time[rows].mean(axis=1),
            force=force[usable],
            branch=branch[rows[:, 0]],
            markers=markers,
            per_mean=per_mean,
            coefficients=fit.coefficients[usable],
            finer=self.fit_curves(markers, extra_terms=1).coefficients if fit.n_spare > 0 else None,
            tip_gain=fit.gain[usable, :2].max(axis=1),
        )

    def compute_moments(self, coefficients: Floats, reading: Floats, places: Floats) -> Floats:
        """Return bending moments along fitted curves.

        Parameters
        ----------
        coefficients : shape (n, 3, terms), m
        reading : shape (n,), N, tension less that at rest
        places : shape (stations,), m

        Returns
        -------
        shape (n, stations), N m: M(s) = Py (x_L - x) - Px (y_L - y), positive where it bends
        towards the pull, less the moment of the specimen's weight beyond s.
        """
        length, pull = self.shape.length, self.pull
        curves = evaluate_curves(coefficients, length, places)
        tip = evaluate_curves(coefficients, length, np.array([length]))
        force = pull.compute_force(reading, tip.x[:, 0])
        moment = force[:, 1:] * (tip.x - curves.x) - force[:, :1] * (tip.y - curves.y)
        if pull.self_weight == 0.0:
            return np.asarray(moment, dtype=np.float64)
        integral = polyint(coefficients[:, 0].T)
        beyond = polyval(np.ones(1), integral) - polyval(places / length, integral)
        lever = length * beyond - (length - places) * curves.x
        return np.asarray(moment - pull.self_weight * lever, dtype=np.float64)

    def compute_curvature_gain(
        self, markers: Floats, shape: StationCurves, arc_length: Floats
    ) -> Floats:
        """Return the standard error of curvature per standard deviation of a marker coordinate.

        Parameters
        ----------
        markers : shape (n, markers, 3), of the fitted curves; NaN where not visible
        shape : the curves at the stations
        arc_length : shape (stations,), m

        Returns
        -------
        shape (n, stations), 1/m^2; NaN for too few markers.

        Notes
        -----
        With n = (-sin, cos) and t = (cos, sin): d kappa = n . d r'' - 2 kappa t . d r', where r''
        and r' are linear in the markers by the least-squares operator of the fit.
        """
        length, terms = self.shape.length, int(self.shape.coefficients.shape[2])
        basis = build_curve_basis(terms=terms, length=length, clamped=True, free_tip=self.free_tip)
        bend = polyval(arc_length / length, polyder(basis.matrix, 2)).T / length**2
        slope, is_visible = basis.compute_slopes(arc_length), np.isfinite(markers).all(axis=2)
        gain = np.full(shape.angle.shape, np.nan)
        for pattern in np.unique(is_visible, axis=0):
            if pattern.sum() < basis.unknowns:
                continue
            design = build_marker_design(basis, self.marker_places[pattern], self.centre_offset)
            x, y = np.split(np.linalg.pinv(design), 2)
            operators = np.stack([bend @ x, bend @ y, slope @ x, slope @ y])
            gram = np.einsum("isk,jsk->sij", operators, operators)
            chosen = (is_visible == pattern).all(axis=1)
            angle, twice = shape.angle[chosen], 2.0 * shape.curvature[chosen]
            sine, cosine = np.sin(angle), np.cos(angle)
            weights = np.stack([-sine, cosine, -twice * cosine, -twice * sine], axis=-1)
            gain[chosen] = np.sqrt(np.einsum("nsi,sij,nsj->ns", weights, gram, weights))
        return gain


def measure_bending(test: BendingTest) -> Bending:
    """Measure moment against curvature: the cloud, and the law of the first loading.

    Parameters
    ----------
    test : shapes and force

    Returns
    -------
    Both, or the cloud and the reason of a missing law.

    Raises
    ------
    ValueError
        If fewer than two frames at rest show all markers, no frame has a curve, or no mean has
        shape and force.
    """
    cloud = measure_cloud(test)
    try:
        law = fit_loading_law(test, cloud)
    except ValueError as error:
        return Bending(cloud, None, Reason("no_law", str(error)))
    return Bending(cloud, law)


def measure_cloud(test: BendingTest) -> BendingCloud:
    """Compute curvature and moment, less those at rest.

    Parameters
    ----------
    test : shapes and force

    Returns
    -------
    One row per mean over consecutive frames of a branch: see `N_CLOUD_ROWS` for the first loading;
    means of the other branches have as many frames. A mean without shape or force is left out.

    Raises
    ------
    ValueError
        If fewer than two frames at rest show all markers, no frame has a curve, or no mean has
        shape and force.

    Notes
    -----
    Moments are those of `BendingTest.compute_moments`, with the specimen's weight. Errors of the
    curvature from the noise of the markers take it to be independent from frame to frame. The
    systematic one is the change with one more coefficient.
    """
    count = int((test.branch == test.first).sum())
    frames = test.fit_means(test.branch, per_mean=max(1, count // N_CLOUD_ROWS))
    rest, errors, length = test.specimen_at_rest, test.errors, test.shape.length
    places = np.linspace(0.0, length, N_CLOUD_STATIONS)

    def compute_curvature(coefficients: Floats) -> Floats:
        return evaluate_curves(coefficients, length, places).curvature

    loaded_curves = evaluate_curves(frames.coefficients, length, places)
    curvature = loaded_curves.curvature - compute_curvature(rest.coefficients)
    systematic = np.full(curvature.shape, np.nan)
    if frames.finer is not None:
        finer = compute_curvature(frames.finer) - compute_curvature(rest.finer)
        systematic = np.abs(finer - curvature)
    at_rest = test.compute_moments(rest.coefficients, np.zeros(1), places)[0]
    moment = test.compute_moments(frames.coefficients, frames.force, places) - at_rest
    share = np.sqrt(1.0 / frames.per_mean + 1.0 / rest.frames)
    gain = test.compute_curvature_gain(frames.markers, loaded_curves, places)
    force_error = np.hypot(errors.force_zero, errors.force_noise / np.sqrt(frames.per_mean))
    push_error = force_error * (loaded_curves.x[:, -1:] - loaded_curves.x)
    # With markers farther from the axis, the lever is shorter by the angle of the tip.
    centre = errors.centre * np.sin(loaded_curves.angle[:, -1])
    noise = rest.noise * frames.tip_gain / np.sqrt(frames.per_mean)
    place_error = np.hypot(np.hypot(errors.offset, centre), noise) * frames.force
    squares = push_error**2 + (errors.force_scale * moment) ** 2 + place_error[:, None] ** 2
    return BendingCloud(
        time=frames.time,
        branch=frames.branch,
        cycle=test.cycle[np.searchsorted(test.shape.time, frames.time)],
        force=frames.force,
        arc_length=places,
        curvature=curvature,
        curvature_error=rest.noise * share * gain,
        curvature_systematic=systematic,
        moment=moment,
        moment_error=np.sqrt(squares),
        moment_at_rest=at_rest,
        frames_per_mean=frames.per_mean,
    )


def fit_loading_law(test: BendingTest, cloud: BendingCloud) -> MeasuredLaw:
    """Fit one law to all frames of the first loading.

    Parameters
    ----------
    test : shapes and force
    cloud : moments and curvatures of the test, whose noise limits the range of known curvatures

    Returns
    -------
    The law, from about `N_FIT_MEANS` means over consecutive frames.

    Raises
    ------
    ValueError
        If the first loading has too few means, its largest moment is not above that at rest, or
        the means do not determine the law.

    Notes
    -----
    Moments are those of the fitted shapes. Changes of the compliances from causes common to all
    frames (zero of the force, a tension at rest removed by the zero, ends of the specimen, distance
    of marker centres from the axis, moments of shapes with one more coefficient) are computed to
    first order and added as independent errors; an equally probable alternative counts as a
    rectangle, 1 / sqrt(3) of the change. So does a law with half as many knots.
    """
    min_points = 24
    is_first, rest, length = test.branch == test.first, test.specimen_at_rest, test.shape.length
    per_mean = max(1, int(is_first.sum()) // N_FIT_MEANS)
    frames = test.fit_means(np.where(is_first, test.branch, -1), per_mean=per_mean)
    n_means = len(frames.force)
    if n_means < min_points:
        raise ValueError(format_sentence("results.few_means", count=n_means, needed=min_points))
    points, marker_points = divide_wire(test.marker_places, length)
    loaded = LawData(
        arc_length=points,
        marker_points=marker_points,
        moment=test.compute_moments(frames.coefficients, frames.force, points),
        moment_at_rest=test.compute_moments(rest.coefficients, np.zeros(1), points)[0],
        angle_at_rest=evaluate_curves(rest.coefficients, length, points).angle[0],
        markers=frames.markers[..., :2],
        markers_at_rest=rest.markers[:, :2],
        rest_weight=rest.frames / per_mean,
        centre_offset=test.centre_offset,
    )
    largest, at_rest = loaded.moment.max(), np.abs(loaded.moment_at_rest).max()
    if not largest > at_rest:
        raise ValueError(format_sentence("results.no_moment", largest=largest, at_rest=at_rest))
    fit, change_with_knots = refine_law(loaded)

    movement = fit.compute_movement(loaded)
    changes = [change_with_knots]
    for changed_test, share in _list_alternatives(test, frames, loaded):
        changes.append(share * fit.shift(fit.compute_movement(changed_test) - movement))
    return tabulate(
        fit,
        changes,
        scale_error=test.errors.force_scale,
        noise=rest.noise / np.sqrt(per_mean),
        curvature_noise=float(np.nanmedian(cloud.noise[cloud.branch == test.first])),
        n_frames=n_means * per_mean,
    )


def _list_alternatives(
    test: BendingTest, frames: FittedFrames, loaded: LawData
) -> Iterator[tuple[LawData, float]]:
    """Yield the data with each common input changed, and the share of the change that counts."""
    errors, rest, length = test.errors, test.specimen_at_rest, test.shape.length
    places, no_load = loaded.arc_length, np.zeros(1)

    def recompute(
        test: BendingTest = test,
        curves: Floats = frames.coefficients,
        at_rest: Floats = rest.coefficients,
        force_change: float = 0.0,
    ) -> LawData:
        return replace(
            loaded,
            moment=test.compute_moments(curves, frames.force + force_change, places),
            moment_at_rest=test.compute_moments(at_rest, no_load, places)[0],
        )

    yield recompute(force_change=errors.force_zero), 1.0
    if errors.other_tension_at_rest is not None:
        pull = replace(test.pull, tension_at_rest=errors.other_tension_at_rest)
        yield recompute(replace(test, pull=pull)), RECTANGULAR_DEVIATION
    if frames.finer is not None:
        yield recompute(curves=frames.finer, at_rest=rest.finer), RECTANGULAR_DEVIATION
    if errors.offset > 0.0:  # the clamped end farther back, the pull point farther out
        first = places[loaded.marker_points[0]]
        displaced = places + errors.offset * np.minimum(places / first, 1.0)
        from_tip = displaced - (displaced[-1] - length)
        moment = test.compute_moments(frames.coefficients, frames.force, from_tip)
        yield replace(loaded, arc_length=displaced, moment=moment), 1.0
        tip = evaluate_curves(frames.coefficients, length, np.array([length]))
        force = test.pull.compute_force(frames.force, tip.x[:, 0])
        lever = force[:, 1:] * np.cos(tip.angle) - force[:, :1] * np.sin(tip.angle)
        yield replace(loaded, moment=loaded.moment + errors.offset * lever), 1.0
    if errors.centre > 0.0:  # marker centres farther from the axis
        with_offset = replace(test, centre_offset=test.centre_offset + errors.centre)
        clamp_angle = loaded.angle_at_rest[0]
        marker_shift = errors.centre * np.array([-np.sin(clamp_angle), np.cos(clamp_angle), 0.0])
        curves = with_offset.fit_curves(frames.markers + marker_shift).coefficients
        at_rest = with_offset.fit_curves(rest.markers[None] + marker_shift).coefficients
        angle = evaluate_curves(at_rest, length, places).angle[0]
        moved_test, offset = recompute(with_offset, curves, at_rest), with_offset.centre_offset
        yield replace(moved_test, angle_at_rest=angle, centre_offset=offset), 1.0


def evaluate_law(
    knots: Floats, compliance: Floats, covariance: Floats, curvature: Floats, *, scale_error: float
) -> dict[str, tuple[Floats, Floats]]:
    """Evaluate a law at curvatures.

    Parameters
    ----------
    knots, compliance, covariance : fields of a `MeasuredLaw`
    curvature : shape (n,), 1/m, none negative
    scale_error : standard uncertainty of the scale of the force, as a share

    Returns
    -------
    Values and standard errors, each of shape (n,), of ``moment`` (N m), ``secant`` and ``tangent``
    (N m^2). Values are NaN beyond the largest curvature of the law, where errors have no meaning,
    and the secant also at zero curvature. For zero compliance, errors are not finite.

    Notes
    -----
    At a given curvature kappa = k(M) an error dk of the law moves the moment by -dk / k'(M); the
    scale of the force changes all moments in proportion.
    """
    n_fine = 4000
    basis, fine = LawBasis(knots), np.linspace(0.0, knots[-1], n_fine)
    reached = basis.compute_values(fine) @ compliance
    is_in_range = (curvature >= 0.0) & (curvature <= reached[-1] * (1.0 + 1e-12))
    moment = np.where(is_in_range, np.interp(curvature, reached, fine), np.nan)
    finite_moment = np.nan_to_num(moment)
    slopes = basis.compute_slopes(finite_moment)
    place = np.clip(np.searchsorted(knots, finite_moment, side="right") - 1, 0, len(knots) - 2)
    bend = (np.diff(compliance) / np.diff(knots))[place]  # second derivative of the law

    def propagate(gradient: Floats, scale: Floats) -> Floats:
        squares = np.einsum("nk,kj,nj->n", gradient, covariance, gradient)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0) + scale**2), dtype=np.float64)

    with np.errstate(divide="ignore", invalid="ignore"):
        softness = slopes @ compliance
        by_law = -basis.compute_values(finite_moment) / softness[:, None]
        by_slope = -(slopes + bend[:, None] * by_law) / softness[:, None] ** 2
        tangent, moment_error = 1.0 / softness, propagate(by_law, scale_error * moment)
        tangent_error = propagate(by_slope, scale_error * tangent)
        return {
            "moment": (moment, moment_error),
            "secant": (moment / curvature, moment_error / curvature),
            "tangent": (np.where(is_in_range, tangent, np.nan), tangent_error),
        }


def tabulate(
    fit: LawFit,
    common: Sequence[Floats],
    *,
    scale_error: float,
    noise: float,
    curvature_noise: float,
    n_frames: int,
) -> MeasuredLaw:
    """Build the table of a law.

    Parameters
    ----------
    fit : the law with its scatter
    common : standard errors from common causes of all frames, as changes of the compliances, each
        of shape (knots,)
    scale_error : standard uncertainty of the scale of the force, as a share
    noise : m, of a marker coordinate in a mean of the fit
    curvature_noise : 1/m, median standard error of the cloud's curvatures in the first loading
    n_frames : number of frames used

    Returns
    -------
    The law.

    Notes
    -----
    A curvature is known if it is above 1.96 times the noise of the curvatures of the cloud, and if
    the interval of the law excludes a moment of zero. A moment is kept without its interval where
    that is not finite, a stiffness only where the curvature is known.
    """
    n_rows = 41
    knots, compliance = fit.basis.knots, fit.compliance
    covariance = fit.covariance + sum(np.outer(change, change) for change in common)
    largest = float(fit.basis.compute_values(knots[-1:])[0] @ compliance)
    curvature = largest * (np.arange(n_rows) / (n_rows - 1)) ** 2
    points = evaluate_law(knots, compliance, covariance, curvature, scale_error=scale_error)
    floor = NORMAL_95 * curvature_noise
    moment, moment_error = points["moment"]
    is_known = (curvature > floor) & (NORMAL_95 * moment_error < moment)
    columns = dict[str, Floats]()
    for name, (values, errors) in points.items():
        is_shown = np.isfinite(errors) if name == "moment" else is_known
        value = values if name == "moment" else np.where(is_known, values, np.nan)
        margin = NORMAL_95 * np.where(is_shown, errors, np.nan)
        columns |= {name: value, f"{name}_lower": value - margin, f"{name}_upper": value + margin}
    unknown, reason = curvature[1:][~is_known[1:]], None
    if count := len(unknown):
        last, rows = unknown.max(), n_rows - 1
        reason = Reason.of(
            "results.law_below_noise", unknown=count, count=rows, last=last, floor=floor
        )
    return MeasuredLaw(
        curvature=curvature,
        **columns,
        is_known=is_known,
        reason=reason,
        floor=floor,
        scale_error=scale_error,
        residual=fit.residual,
        noise=noise,
        n_frames=n_frames,
        knots=knots,
        compliance=compliance,
        compliance_covariance=covariance,
    )


@dataclass(frozen=True, slots=True, eq=False)
class LawFit:
    """A law, and its dependence on the markers.

    Parameters
    ----------
    basis : basis functions of the law
    compliance : shape (knots,), 1/(N m^2), none negative
    covariance : shape (knots, knots), from the scatter of the markers about the law
    sensitivity : shape (knots, n, 2 markers), change of the compliances per metre of a marker
        coordinate
    residual : m, root mean square misfit per coordinate
    n : number of marker coordinates in all frames
    variance : m^2, of independent noise with the same overall scatter of the compliances
    """

    basis: LawBasis
    compliance: Floats
    covariance: Floats
    sensitivity: Floats
    residual: float
    n: int
    variance: float

    def compute_movement(self, data: LawData) -> Floats:
        """Return the movement of the markers by the law, shape (n, 2 markers), m."""
        return data.compute_movement(data.compute_turns(self.basis) @ self.compliance)

    def shift(self, movement: Floats) -> Floats:
        """Return the change of the compliances for another movement of the markers.

        Parameters
        ----------
        movement : shape (n, 2 markers), m, additional movement with the same law

        Returns
        -------
        shape (knots,), to first order.
        """
        return np.asarray(-np.tensordot(self.sensitivity, movement, axes=2), dtype=np.float64)


def refine_law(loaded: LawData) -> tuple[LawFit, Floats]:
    """Fit a law with 13 knots, or with 25 if they fit the markers much better.

    Parameters
    ----------
    loaded : moments, markers and rest

    Returns
    -------
    The law, and the standard error of its compliances from the number of knots, fully correlated:
    shape (knots,), 1 / sqrt(3) of the change with half as many intervals between knots.

    Raises
    ------
    ValueError
        As `fit_law`, for any of 7, 13 and 25 knots: all three laws are fitted.

    Notes
    -----
    Thirteen knots describe a smooth law to 0.1 % of its moment. A wire whose strands all slip at
    once has a law with a kink: the intervals are halved if that reduces the sum of squares by more
    than log n times the variance of the noise for each added knot (Schwarz, Ann. Stat. 6 (1978)
    461).
    """
    # Each level has all the knots of the one before.
    level_knots = (7, 13, 25)
    largest = float(loaded.moment.max())
    coarse, fit, fine = (fit_law(loaded, choose_knots(largest, count)) for count in level_knots)
    gain = fine.n * (fit.residual**2 - fine.residual**2)
    if gain > fine.variance * np.log(fine.n) * (level_knots[2] - level_knots[1]):
        coarse, fit = fit, fine
    # The knots of the coarse law are among those of the fine one.
    coarse_compliance: Floats = coarse.basis.compute_slopes(fit.basis.knots) @ coarse.compliance
    return fit, RECTANGULAR_DEVIATION * (coarse_compliance - fit.compliance)


def fit_law(loaded: LawData, basis: LawBasis) -> LawFit:
    """Fit the law to the marker positions by least squares.

    Parameters
    ----------
    loaded : moments, markers and rest
    basis : knots of the law

    Returns
    -------
    The law.

    Raises
    ------
    ValueError
        If the markers do not determine all compliances: too few frames, or moments too small.

    Notes
    -----
    Gauss-Newton from one compliance for all knots; the inner step is non-negative least squares
    (Lawson and Hanson, Solving Least Squares Problems, 1974, chapter 23) if the unconstrained one
    is negative. Every marker coordinate has its own offset, known from the frames at rest, which
    are one more row: so the noise of the mean at rest, common to all frames, is in the covariance.
    That is a sandwich estimator with the long-run covariance of the residuals between coordinates
    (Newey and West, Econometrica 55 (1987) 703): the pivot of the clamp and the force move all of
    them, and a smoothed force for several frames.
    """
    max_rounds = 12
    convergence_share = 1e-7
    is_measured = np.isfinite(loaded.moved)
    measured = np.where(is_measured, loaded.moved, 0.0)
    weight = is_measured.sum(axis=0) + loaded.rest_weight

    def subtract_offsets(values: Floats) -> Floats:
        """Subtract the offset of each coordinate: (n, 2 markers, k) to (n + 1, 2 markers, k)."""
        values = np.where(is_measured[..., None], values, 0.0)
        offset = values.sum(axis=0) / weight[:, None]
        centred = np.where(is_measured[..., None], values - offset, 0.0)
        return np.concatenate([centred, -np.sqrt(loaded.rest_weight) * offset[None]])

    turns, ones = loaded.compute_turns(basis), np.ones(len(basis.knots))
    slope_changes = loaded.compute_slopes(turns, 0.0 * ones) @ ones
    scale = float((slope_changes**2).sum())
    if not scale > 0.0:
        raise ValueError(format_sentence("results.no_change_of_moment"))
    compliance: Floats = ones * abs(float((slope_changes * measured).sum())) / scale
    for _ in range(max_rounds):
        slope_changes = loaded.compute_movement(turns @ compliance)
        residuals = subtract_offsets((measured - slope_changes)[..., None])
        design = subtract_offsets(loaded.compute_slopes(turns, compliance))
        flat = design.reshape(-1, len(ones))
        normal = flat.T @ flat
        solution = _solve(normal, flat.T @ residuals.ravel() + normal @ compliance)
        change = float(np.abs(solution - compliance).max() / np.abs(solution).max())
        compliance = solution
        if change < convergence_share:
            break
    residuals, count = residuals[:-1, :, 0], int(is_measured.sum())
    sensitivity = np.einsum("kj,nmj->knm", _invert(normal), design)[:, :-1]
    freedom = max(float(count) - len(ones) - is_measured.shape[1], 1.0)
    noise = _estimate_long_run_covariance(residuals, is_measured) * float(count) / freedom
    covariance = np.einsum("knm,ml,jnl->kj", sensitivity, noise, sensitivity, optimize=True)
    return LawFit(
        basis=basis,
        compliance=compliance,
        covariance=covariance,
        sensitivity=sensitivity,
        residual=float(np.sqrt((residuals**2).sum() / max(count, 1))),
        n=count,
        variance=float(np.trace(covariance @ normal)) / len(ones),
    )


def _solve(normal: Floats, right: Floats) -> Floats:
    """Solve for compliances, none of them negative."""
    solution: Floats = _invert(normal) @ right
    if (solution >= 0.0).all():
        return solution
    from scipy.optimize import nnls  # slow import, not for all tests

    scale = np.sqrt(np.diag(normal))
    triangle = np.linalg.cholesky(normal / np.outer(scale, scale))
    return nnls(triangle.T, np.linalg.solve(triangle, right / scale))[0] / scale


def _invert(normal: Floats) -> Floats:
    max_condition = 1e12
    scale = np.sqrt(np.diag(normal))
    if not (scale > 0.0).all() or np.linalg.cond(normal / np.outer(scale, scale)) > max_condition:
        raise ValueError(format_sentence("results.law_not_determined", knots=len(scale)))
    inverse = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.asarray(inverse, dtype=np.float64)


def _estimate_long_run_covariance(residuals: Floats, is_measured: Flags) -> Floats:
    """Return the long-run covariance between columns of residuals, with Bartlett's weights."""
    count = len(residuals)
    lags = min(round(4.0 * (count / 100.0) ** (2.0 / 9.0)) + 1, count // 4)
    weights = is_measured.astype(np.float64)
    total = residuals.T @ residuals / np.maximum(weights.T @ weights, 1.0)
    for lag in range(1, lags + 1):
        together = np.maximum(weights[lag:].T @ weights[:-lag], 1.0)
        lagged = residuals[lag:].T @ residuals[:-lag] / together
        total += (1.0 - lag / (lags + 1.0)) * (lagged + lagged.T)
    return np.asarray(total, dtype=np.float64)


def divide_wire(markers: Floats, length: float) -> tuple[Floats, Ints]:
    """Divide a wire finely, with points at the markers and at the tip.

    Parameters
    ----------
    markers : shape (markers,), m, arc lengths from the clamped end
    length : m

    Returns
    -------
    Arc lengths of the points, m, and the numbers of those that are markers.
    """
    max_step = 0.0015  # m
    ends = np.concatenate([[0.0], markers, [length]])
    ends = ends[np.concatenate([[True], np.diff(ends) > 1e-9])]
    counts = np.maximum(np.ceil(np.diff(ends) / max_step).astype(np.int64), 1)
    parts = [
        np.linspace(first, last, count, endpoint=False)
        for (first, last), count in zip(pairwise(ends), counts, strict=True)
    ]
    points = np.concatenate([*parts, ends[-1:]])
    return points, np.searchsorted(points, markers - 1e-10).astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class LawData:
    """Data for the fit of a law, and the shapes of the wire for laws.

    Parameters
    ----------
    arc_length : shape (points,), m, of points along the wire from the clamped end to the tip
    marker_points : shape (markers,), which of them are markers
    moment : shape (n, points), N m, of the loaded frames
    moment_at_rest : shape (points,), N m
    angle_at_rest : shape (points,), rad
    markers : shape (n, markers, 2), m, in the plane of bending, from the clamped end; NaN are
        ignored
    markers_at_rest : shape (markers, 2), m
    rest_weight : frames of the rest over frames of a mean
    centre_offset : m, axis to marker centre
    """

    arc_length: Floats
    marker_points: Ints
    moment: Floats
    moment_at_rest: Floats
    angle_at_rest: Floats
    markers: Floats
    markers_at_rest: Floats
    rest_weight: float
    centre_offset: float

    @property
    def moved(self) -> Floats:
        """Return the displacements from rest, shape (n, 2 markers), m: x of all markers, then y."""
        movements = self.markers - self.markers_at_rest
        return np.concatenate([movements[..., 0], movements[..., 1]], axis=1)

    def compute_turns(self, basis: LawBasis) -> Floats:
        """Return the turns from rest per unit of compliance, rad, shape (n, points, knots)."""
        return self._integrate(basis.compute_changes(self.moment_at_rest, self.moment))

    def compute_movement(self, turn: Floats) -> Floats:
        """Return the movement of the markers from rest, m.

        Parameters
        ----------
        turn : shape (n, points), rad, of the wire from rest

        Returns
        -------
        Shape (n, 2 markers): x of all markers, then y.
        """
        rest = self.angle_at_rest[None]
        return self._compute_centres(rest + turn) - self._compute_centres(rest)

    def compute_slopes(self, turns: Floats, compliance: Floats) -> Floats:
        """Return the derivatives of the movement by the compliances, (n, 2 markers, knots).

        Parameters
        ----------
        turns : shape (n, points, knots), from `compute_turns`
        compliance : shape (knots,), 1/(N m^2)
        """
        angle = (self.angle_at_rest + turns @ compliance)[..., None]
        sine, cosine, height = np.sin(angle) * turns, np.cos(angle) * turns, self.centre_offset
        along = -self._integrate(sine) - height * cosine
        across = self._integrate(cosine) - height * sine
        return np.concatenate([x[:, self.marker_points] for x in (along, across)], axis=1)

    def _compute_centres(self, angle: Floats) -> Floats:
        """Return the marker centres, shape (n, 2 markers): x of all, then y."""
        sine, cosine, height = np.sin(angle), np.cos(angle), self.centre_offset
        x, y = self._integrate(cosine) - height * sine, self._integrate(sine) + height * cosine
        return np.concatenate([x[:, self.marker_points], y[:, self.marker_points]], axis=1)

    def _integrate(self, values: Floats) -> Floats:
        """Integrate values (n, points, ...) from the clamped end by trapezoids."""
        steps = np.diff(self.arc_length).reshape(-1, *(1,) * (values.ndim - 2))
        integral = np.zeros_like(values)
        np.cumsum(steps * (values[:, 1:] + values[:, :-1]) / 2.0, axis=1, out=integral[:, 1:])
        return integral


@dataclass(frozen=True, slots=True, eq=False)
class LawBasis:
    """Laws whose slope d kappa / d M is linear between knots, and constant beyond the last.

    Parameters
    ----------
    knots : shape (knots,), N m, from 0 up
    """

    knots: Floats

    def compute_slopes(self, moment: Floats) -> Floats:
        """Return the slope of the law per unit of compliance at each knot; (*moment, knots)."""
        hats = np.eye(len(self.knots))
        return np.stack([np.interp(np.abs(moment), self.knots, hat) for hat in hats], axis=-1)

    def compute_values(self, moment: Floats) -> Floats:
        """Return the curvature per unit of compliance at each knot, odd; (*moment, knots)."""
        widths, size = np.diff(self.knots), np.abs(moment)
        size_in_range = np.clip(size, 0.0, self.knots[-1])
        lengths = np.clip(size_in_range[..., None] - self.knots[:-1], 0, widths)
        rising = lengths**2 / (2.0 * widths)
        values = np.zeros((*np.shape(size), len(self.knots)))
        values[..., :-1] += lengths - rising
        values[..., 1:] += rising
        values[..., -1] += np.maximum(size - self.knots[-1], 0.0)
        return np.asarray(np.sign(moment)[..., None] * values, dtype=np.float64)

    def compute_changes(self, start: Floats, moment: Floats) -> Floats:
        """Return the change of curvature from a rest after first loading, per unit of compliance.

        Parameters
        ----------
        start : shape (points,), N m
        moment : shape (n, points), N m

        Returns
        -------
        shape (n, points, knots).
        """
        changes = self.compute_values(moment) - self.compute_values(start)
        rise = moment - start
        turned = (rise * start < 0.0) & (np.abs(rise) < 2.0 * np.abs(start))
        changes[turned] = 2.0 * self.compute_values(0.5 * rise[turned])
        return changes


def choose_knots(largest: float, count: int) -> LawBasis:
    """Choose knots, denser near zero, where every frame has a part of its wire.

    Parameters
    ----------
    largest : N m, the largest moment
    count : number of knots, at least 2
    """
    return LawBasis(largest * (np.arange(count) / (count - 1)) ** 1.6)
