"""Measure curvature and moment (the cloud), and fit the law of the first loading.

Markers give the shape and the force gives the moment; no stiffness is assumed. The frame is that of
the specimen: x along its undeformed axis from the clamped end, y in the plane of bending towards
the pull. The shapes that follow from a law are compared with the markers. The fit of the law
differentiates no curve, so its curvatures are much more accurate than those of the cloud, which are
second derivatives.

The wire keeps its length and its direction at the clamp. Its angle in frame f is

    theta_f(s) = theta_rest(s) + integral from 0 to s of [kappa(M_f) - kappa(M_rest)] ds'

with one law kappa(M) for all cross-sections and frames. Where a weight bent the wire away from the
pull at rest, it unloads by Masing's rule until it is bent as far towards the pull:

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
"""Number of means over consecutive frames in the fit of the first loading: at least this, less than
twice this.

The fit has fewer if the loading has fewer frames, or if means have no shape or force.
"""
N_CLOUD_MEANS = 50
"""Number of means of the first loading in the cloud, with the limits of `N_FIT_MEANS`."""
N_CLOUD_STATIONS = 17
"""Number of equidistant stations along the specimen in the cloud."""
RECTANGULAR_DEVIATION = 1.0 / np.sqrt(3.0)
"""Standard deviation of a rectangular distribution of half-width one."""


@dataclass(frozen=True, slots=True, eq=False)
class TipPull:
    """The force at the tip, from the reading of the load cell.

    Parameters
    ----------
    string_length : m, from the load cell to the tip; None for a force normal to the clamped axis
    tip_weight : N, weight that hangs at the tip
    tension_at_rest : N, tension of the string before the loading, which the zeroed force omits
    anchor_x : m, position of the load cell along x
    self_weight : N/m, weight of the level specimen per length
    """

    string_length: float | None
    tip_weight: float
    tension_at_rest: float
    anchor_x: float
    self_weight: float = 0.0

    def compute_force(self, reading: Floats, tip_x: Floats) -> Floats:
        """Return the force at the tip, N.

        Parameters
        ----------
        reading : shape (n,), N, the tension less that at rest; NaN gives NaN
        tip_x : shape (n,), m, position of the tip along x

        Returns
        -------
        shape (n, 2), N, along x and y. The y component is NaN if the tip is farther from the anchor
        along x than the string is long; the x component is not.

        Notes
        -----
        The load cell is above the tip at rest, so the string leans towards the anchor as the tip
        moves inward: sin(beta) = (anchor_x - tip_x) / string_length.
        """
        tension = reading + self.tension_at_rest
        sine = (self.anchor_x - tip_x) / (self.string_length or np.inf)
        cosine = np.sqrt(np.where(np.abs(sine) <= 1.0, 1.0 - sine**2, np.nan))
        return np.stack([tension * sine, tension * cosine - self.tip_weight], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class StationCurves:
    """Fitted curves at stations along the specimen, in arrays of shape (n, stations).

    Parameters
    ----------
    x, y : m, positions in the plane of bending
    angle : rad, from the x axis to the tangent
    curvature : 1/m, positive towards the pull
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
    length : m, free length of the specimen
    arc_length : shape (stations,), m, stations from the clamped end

    Returns
    -------
    Positions, directions and curvatures of the n curves at the stations.

    Notes
    -----
    kappa = (x' y'' - y' x'') / (x'^2 + y'^2)^(3/2): the parameter of a fitted curve is only nearly
    its arc length.
    """
    powers, u = np.moveaxis(coefficients[:, :2], -1, 0), arc_length / length
    (x, y), (dx, dy), (ddx, ddy) = (
        np.moveaxis(polyval(u, polyder(powers, order)), 1, 0) / length**order for order in range(3)
    )
    curvature = (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3
    return StationCurves(x, y, np.arctan2(dy, dx), curvature)


@dataclass(frozen=True, slots=True)
class BendingErrors:
    """Standard errors of force and positions.

    Parameters
    ----------
    force_noise : N, noise of the force in one frame
    force_zero : N, error of the zero of the force
    force_scale : error of the scale of the force, as a fraction of the force
    end_position : m, error of the clamped end, and of the pull point, along the specimen
    alternative_tension : N, a tension at rest as probable as the assumed one, or None
    centre_offset : m, error of the distance of the marker centres from the axis
    """

    force_noise: float
    force_zero: float
    force_scale: float
    end_position: float
    alternative_tension: float | None = None
    centre_offset: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FittedMeans:
    """Means over consecutive frames of a branch, with shape and force, and the curves through them.

    Parameters
    ----------
    time, force : shape (n,), s, N, mean time and mean force
    branch : shape (n,), index of the branch
    markers : shape (n, markers, 3), m, mean positions from the clamped end; NaN if a marker was not
        measured in every frame of the mean
    frames_per_mean : number of frames of one mean
    coefficients : shape (n, 3, terms), m, power series of the fitted curves
    finer_series : shape (n, 3, terms + 1), m; None if the markers do not determine one more
        coefficient
    tip_gain : shape (n,), standard error of the tip in x or y, whichever is larger, per standard
        deviation of a marker coordinate
    """

    time: Floats
    force: Floats
    branch: Ints
    markers: Floats
    frames_per_mean: int
    coefficients: Floats
    finer_series: Floats | None
    tip_gain: Floats


@dataclass(frozen=True, slots=True, eq=False)
class SpecimenAtRest:
    """Mean markers and mean curve of the specimen before the loading.

    Parameters
    ----------
    markers : shape (markers, 3), m, mean positions from the clamped end
    coefficients : shape (1, 3, terms), m, power series of the mean curve
    finer_series : shape (1, 3, terms + 1), m; (1, 3, terms) if the markers do not determine
        one more coefficient
    n_frames : number of frames that show all markers
    marker_noise : m, standard deviation of a marker coordinate; NaN without residuals
    """

    markers: Floats
    coefficients: Floats
    finer_series: Floats
    n_frames: int
    marker_noise: float


def average_frames(shape: Shape, branch: Ints, *, frames_per_mean: int) -> tuple[Ints, Floats]:
    """Average the markers of consecutive frames of a branch.

    Parameters
    ----------
    shape : marker positions. A marker is averaged if it has a position in all frames of a mean, and
        was measured in three quarters of them; its other positions were filled across short gaps
    branch : shape (frames,), index of the branch; frames of a negative one are excluded
    frames_per_mean : number of frames of one mean; the remainder of a branch is excluded

    Returns
    -------
    rows : shape (n, frames_per_mean), indices of the frames of each mean, in order of time
    markers : shape (n, markers, 3), m, mean positions from the clamped end
    """
    edges = np.concatenate([[0], np.flatnonzero(np.diff(branch)) + 1, [len(branch)]])
    groups = [
        np.arange(first, last - frames_per_mean + 1, frames_per_mean)
        for first, last in pairwise(edges)
        if branch[first] >= 0
    ]
    rows = np.concatenate([np.zeros(0, np.int64), *groups])[:, None] + np.arange(frames_per_mean)
    indices = rows[..., None], np.flatnonzero(_flag_markers(shape))
    flags = shape.flags[indices]
    is_measured = np.isin(flags, (PointFlag.MEASURED, PointFlag.RELABELLED))
    is_used = is_measured.mean(axis=1, keepdims=True) >= 0.75
    is_used = is_used & (is_measured | (flags == PointFlag.FILLED))
    return rows, np.where(is_used[..., None], shape.positions[indices], np.nan).mean(axis=1)


def _flag_markers(shape: Shape) -> Flags:
    """Return which points of a shape are markers, not constructed points: shape (points,)."""
    return np.asarray(~(shape.flags == PointFlag.CONSTRUCTED).any(axis=0), dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class BendingTest:
    """A bending test with shape and curve, in arrays of shape (frames,).

    Parameters
    ----------
    shape : shape fitted in every frame, with clamped end and pull point
    force : N, force of the curve at the time of the frames; NaN outside the curve
    branch, cycle : index of the branch, and number of the cycle, of the curve at the frames
    first_branch : index of the branch of the first loading
    is_at_rest : whether the frame was taken before the loading
    centre_offset : m, axis to marker centre, positive towards the pull
    free_tip : whether the shapes were fitted without a moment at the tip
    pull : pull of string and weights at the tip
    errors : standard errors of force and positions
    """

    shape: Shape
    force: Floats
    branch: Ints
    cycle: Ints
    first_branch: int
    is_at_rest: Flags
    centre_offset: float
    free_tip: bool
    pull: TipPull
    errors: BendingErrors

    @cached_property
    def marker_arc_length(self) -> Floats:
        """Arc lengths of the markers from the clamped end, m, shape (markers,)."""
        return self.shape.arc_length[_flag_markers(self.shape)]

    def fit_curves(self, markers: Floats, *, extra_terms: int = 0) -> FrameFits:
        """Fit curves through markers, with the conditions at the ends of the fitted shapes.

        Parameters
        ----------
        markers : shape (n, markers, 3), m, positions
        extra_terms : number of coefficients in addition to those of the shapes

        Raises
        ------
        ValueError
            If no frame has a curve.
        """
        length, coefficients = self.shape.length, self.shape.coefficients
        fitted = np.flatnonzero(np.isfinite(coefficients).all(axis=(1, 2)))
        if not len(fitted):
            raise ValueError(format_sentence("results.no_fitted_frame"))
        direction, terms = coefficients[fitted[0], :, 1] / length, coefficients.shape[2]
        ends = EndConditions(length=length, direction=direction, free_tip=self.free_tip)
        arc_length, offset = self.marker_arc_length, self.centre_offset
        return fit_frames(markers, arc_length, offset, ends, terms=terms + extra_terms)

    @cached_property
    def specimen_at_rest(self) -> SpecimenAtRest:
        """Mean markers and mean curve of the specimen before the loading.

        Raises
        ------
        ValueError
            If fewer than two frames at rest show all markers, or no frame has a curve.
        """
        _, markers = average_frames(self.shape, np.where(self.is_at_rest, 0, -1), frames_per_mean=1)
        markers = markers[np.isfinite(markers).all(axis=(1, 2))]
        if len(markers) < 2:
            raise ValueError(format_sentence("results.few_frames_at_rest", count=len(markers)))
        fit, mean = self.fit_curves(markers), markers.mean(axis=0)
        return SpecimenAtRest(
            markers=mean,
            coefficients=fit.coefficients.mean(axis=0)[None],
            finer_series=self.fit_curves(mean[None], extra_terms=min(fit.n_spare, 1)).coefficients,
            n_frames=len(markers),
            marker_noise=fit.estimate_noise(slice(None)),
        )

    def fit_means(self, branch: Ints, *, frames_per_mean: int) -> FittedMeans:
        """Fit curves through means over consecutive frames.

        Parameters
        ----------
        branch : shape (frames,), index of the branch; frames of a negative one are excluded
        frames_per_mean : number of frames of one mean

        Returns
        -------
        The means that have both a shape and a force.

        Raises
        ------
        ValueError
            If no frame has a curve, or no mean has both a shape and a force.
        """
        rows, markers = average_frames(self.shape, branch, frames_per_mean=frames_per_mean)
        fit, force = self.fit_curves(markers), self.force[rows].mean(axis=1)
        is_usable = np.isfinite(fit.coefficients).all(axis=(1, 2)) & np.isfinite(force)
        if not is_usable.any():
            raise ValueError(format_sentence("results.no_means"))
        rows, markers = rows[is_usable], markers[is_usable]
        finer = self.fit_curves(markers, extra_terms=1).coefficients if fit.n_spare > 0 else None
        return FittedMeans(
            time=self.shape.time[rows].mean(axis=1),
            force=force[is_usable],
            branch=branch[rows[:, 0]],
            markers=markers,
            frames_per_mean=frames_per_mean,
            coefficients=fit.coefficients[is_usable],
            finer_series=finer,
            tip_gain=fit.gain[is_usable, :2].max(axis=1),
        )

    def compute_moments(self, coefficients: Floats, reading: Floats, arc_length: Floats) -> Floats:
        """Compute bending moments along fitted curves.

        Parameters
        ----------
        coefficients : shape (n, 3, terms), m, power series of the curves
        reading : shape (n,), N, tension of the string less that at rest
        arc_length : shape (stations,), m, stations from the clamped end

        Returns
        -------
        shape (n, stations), N m: M(s) = Py (x_L - x) - Px (y_L - y), positive if it bends towards
        the pull, less the moment of the specimen's weight between s and the tip.
        """
        length, pull = self.shape.length, self.pull
        curves = evaluate_curves(coefficients, length, arc_length)
        tip = evaluate_curves(coefficients, length, np.array([length]))
        force = pull.compute_force(reading, tip.x[:, 0])
        moment = force[:, 1:] * (tip.x - curves.x) - force[:, :1] * (tip.y - curves.y)
        x_integral = polyint(coefficients[:, 0].T)
        from_station = polyval(np.ones(1), x_integral) - polyval(arc_length / length, x_integral)
        lever = length * from_station - (length - arc_length) * curves.x
        return np.asarray(moment - pull.self_weight * lever, dtype=np.float64)

    def compute_curvature_gain(
        self, markers: Floats, curves: StationCurves, arc_length: Floats
    ) -> Floats:
        """Compute the standard error of curvature per standard deviation of a marker coordinate.

        Parameters
        ----------
        markers : shape (n, markers, 3), m, positions to which the curves were fitted; NaN where not
            visible
        curves : the fitted curves at the stations
        arc_length : shape (stations,), m, stations from the clamped end

        Returns
        -------
        shape (n, stations), 1/m^2; NaN for too few markers.

        Notes
        -----
        With n = (-sin, cos) and t = (cos, sin): d kappa = n . d r'' - 2 kappa t . d r', where r''
        and r' are linear in the markers by the least-squares operator of the fit.
        """
        length, n = self.shape.length, int(self.shape.coefficients.shape[2])
        basis = build_curve_basis(terms=n, length=length, has_clamp=True, free_tip=self.free_tip)
        second = polyval(arc_length / length, polyder(basis.matrix, 2)).T / length**2
        first, is_visible = basis.compute_slopes(arc_length), np.isfinite(markers).all(axis=2)
        gain = np.full(curves.angle.shape, np.nan)
        for pattern in np.unique(is_visible, axis=0):
            if pattern.sum() < basis.n_unknowns:
                continue
            design = build_marker_design(basis, self.marker_arc_length[pattern], self.centre_offset)
            x, y = np.split(np.linalg.pinv(design), 2)
            operators = np.stack([second @ x, second @ y, first @ x, first @ y])
            gram = np.einsum("isk,jsk->sij", operators, operators)
            has_pattern = (is_visible == pattern).all(axis=1)
            angle, double_curvature = curves.angle[has_pattern], 2.0 * curves.curvature[has_pattern]
            normal, tangent = [-np.sin(angle), np.cos(angle)], [np.cos(angle), np.sin(angle)]
            weights = np.stack([*normal, *(-double_curvature * t for t in tangent)], axis=-1)
            gain[has_pattern] = np.sqrt(np.einsum("nsi,sij,nsj->ns", weights, gram, weights))
        return gain


def measure_bending(test: BendingTest) -> Bending:
    """Measure moment against curvature: the cloud, and the law of the first loading.

    Parameters
    ----------
    test : shapes and force of the test

    Returns
    -------
    The cloud with the law, or with the reason why the law is missing.

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
    test : shapes and force of the test

    Returns
    -------
    One row per mean over consecutive frames of a branch. `N_CLOUD_MEANS` sets the number of frames
    of one mean, for all branches. A mean without shape or force is left out.

    Raises
    ------
    ValueError
        If fewer than two frames at rest show all markers, no frame has a curve, or no mean has
        shape and force.

    Notes
    -----
    Moments are those of `BendingTest.compute_moments`, with the specimen's weight. The error of the
    curvature takes the noise of the markers to be independent from frame to frame. Its systematic
    error is the change with one more coefficient.
    """
    count = int((test.branch == test.first_branch).sum())
    means = test.fit_means(test.branch, frames_per_mean=max(1, count // N_CLOUD_MEANS))
    rest, errors, length = test.specimen_at_rest, test.errors, test.shape.length
    stations = np.linspace(0.0, length, N_CLOUD_STATIONS)

    def compute_curvature(coefficients: Floats) -> Floats:
        return evaluate_curves(coefficients, length, stations).curvature

    loaded_curves = evaluate_curves(means.coefficients, length, stations)
    curvature = loaded_curves.curvature - compute_curvature(rest.coefficients)
    systematic = np.full(curvature.shape, np.nan)
    if means.finer_series is not None:
        finer = compute_curvature(means.finer_series) - compute_curvature(rest.finer_series)
        systematic = np.abs(finer - curvature)
    moment_at_rest = test.compute_moments(rest.coefficients, np.zeros(1), stations)[0]
    moment = test.compute_moments(means.coefficients, means.force, stations) - moment_at_rest
    n_frames = means.frames_per_mean
    noise_factor = np.sqrt(1.0 / n_frames + 1.0 / rest.n_frames)
    gain = test.compute_curvature_gain(means.markers, loaded_curves, stations)
    force_error = np.hypot(errors.force_zero, errors.force_noise / np.sqrt(n_frames))
    by_force = force_error * (loaded_curves.x[:, -1:] - loaded_curves.x)
    # Marker centres farther from the axis shorten the lever by the sine of the tip's angle.
    centre_error = errors.centre_offset * np.sin(loaded_curves.angle[:, -1])
    tip_error = rest.marker_noise * means.tip_gain / np.sqrt(n_frames)
    by_lever = np.hypot(np.hypot(errors.end_position, centre_error), tip_error) * means.force
    squares = by_force**2 + (errors.force_scale * moment) ** 2 + by_lever[:, None] ** 2
    return BendingCloud(
        time=means.time,
        branch=means.branch,
        cycle=test.cycle[np.searchsorted(test.shape.time, means.time)],
        force=means.force,
        arc_length=stations,
        curvature=curvature,
        curvature_error=rest.marker_noise * noise_factor * gain,
        curvature_systematic=systematic,
        moment=moment,
        moment_error=np.sqrt(squares),
        moment_at_rest=moment_at_rest,
        frames_per_mean=n_frames,
    )


def fit_loading_law(test: BendingTest, cloud: BendingCloud) -> MeasuredLaw:
    """Fit one law to all frames of the first loading.

    Parameters
    ----------
    test : shapes and force of the test
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
    first order and added as independent errors. An equally probable alternative counts with
    1 / sqrt(3) of its change, the standard deviation of a rectangular distribution. So does a law
    with half as many knots.
    """
    min_means = 24
    is_first, rest = test.branch == test.first_branch, test.specimen_at_rest
    frames_per_mean = max(1, int(is_first.sum()) // N_FIT_MEANS)
    means = test.fit_means(np.where(is_first, test.branch, -1), frames_per_mean=frames_per_mean)
    n_means = len(means.force)
    if n_means < min_means:
        raise ValueError(format_sentence("results.few_means", count=n_means, needed=min_means))
    points, marker_points = divide_wire(test.marker_arc_length, test.shape.length)
    data = LawData(
        arc_length=points,
        marker_points=marker_points,
        moment=test.compute_moments(means.coefficients, means.force, points),
        moment_at_rest=test.compute_moments(rest.coefficients, np.zeros(1), points)[0],
        angle_at_rest=evaluate_curves(rest.coefficients, test.shape.length, points).angle[0],
        markers=means.markers[..., :2],
        markers_at_rest=rest.markers[:, :2],
        rest_weight=rest.n_frames / frames_per_mean,
        centre_offset=test.centre_offset,
    )
    largest, at_rest = data.moment.max(), np.abs(data.moment_at_rest).max()
    if not largest > at_rest:
        raise ValueError(format_sentence("results.no_moment", largest=largest, at_rest=at_rest))
    fit, knot_error = refine_law(data)

    displacement = fit.compute_displacement(data)
    common_errors = [knot_error]
    for alternative, factor in _generate_alternatives(test, means, data):
        change = fit.compute_displacement(alternative) - displacement
        common_errors.append(factor * fit.compute_compliance_change(change))
    return tabulate_law(
        fit,
        common_errors,
        scale_error=test.errors.force_scale,
        noise=rest.marker_noise / np.sqrt(frames_per_mean),
        curvature_noise=float(np.nanmedian(cloud.total_error[cloud.branch == test.first_branch])),
        n_frames=n_means * frames_per_mean,
    )


def _generate_alternatives(
    test: BendingTest, means: FittedMeans, data: LawData
) -> Iterator[tuple[LawData, float]]:
    """Yield the data for a change of each common input, and standard errors per change."""
    errors, rest, length = test.errors, test.specimen_at_rest, test.shape.length
    points, no_load = data.arc_length, np.zeros(1)

    def recompute(
        test: BendingTest = test,
        curves: Floats = means.coefficients,
        at_rest: Floats = rest.coefficients,
        force_change: float = 0.0,
    ) -> LawData:
        return replace(
            data,
            moment=test.compute_moments(curves, means.force + force_change, points),
            moment_at_rest=test.compute_moments(at_rest, no_load, points)[0],
        )

    yield recompute(force_change=errors.force_zero), 1.0
    if errors.alternative_tension is not None:
        pull = replace(test.pull, tension_at_rest=errors.alternative_tension)
        yield recompute(replace(test, pull=pull)), RECTANGULAR_DEVIATION
    if means.finer_series is not None:
        yield recompute(curves=means.finer_series, at_rest=rest.finer_series), RECTANGULAR_DEVIATION
    if errors.end_position > 0.0:
        # The clamped end is farther from the first marker.
        first = points[data.marker_points[0]]
        displaced = points + errors.end_position * np.minimum(points / first, 1.0)
        from_tip = displaced - (displaced[-1] - length)
        moment = test.compute_moments(means.coefficients, means.force, from_tip)
        yield replace(data, arc_length=displaced, moment=moment), 1.0
        # The pull point is farther out.
        tip = evaluate_curves(means.coefficients, length, np.array([length]))
        force = test.pull.compute_force(means.force, tip.x[:, 0])
        normal_force = force[:, 1:] * np.cos(tip.angle) - force[:, :1] * np.sin(tip.angle)
        yield replace(data, moment=data.moment + errors.end_position * normal_force), 1.0
    if errors.centre_offset > 0.0:
        # Marker centres are farther from the axis.
        farther = replace(test, centre_offset=test.centre_offset + errors.centre_offset)
        clamp_angle = data.angle_at_rest[0]
        clamp_normal = np.array([-np.sin(clamp_angle), np.cos(clamp_angle), 0.0])
        marker_shift = errors.centre_offset * clamp_normal
        curves = farther.fit_curves(means.markers + marker_shift).coefficients
        at_rest = farther.fit_curves(rest.markers[None] + marker_shift).coefficients
        alternative = recompute(farther, curves, at_rest)
        angle, offset = evaluate_curves(at_rest, length, points).angle[0], farther.centre_offset
        yield replace(alternative, angle_at_rest=angle, centre_offset=offset), 1.0


def evaluate_law(
    knots: Floats, compliance: Floats, covariance: Floats, curvature: Floats, *, scale_error: float
) -> dict[str, tuple[Floats, Floats]]:
    """Evaluate a law at curvatures.

    Parameters
    ----------
    knots : shape (knots,), N m, moments of the compliances, from 0 up
    compliance : shape (knots,), 1/(N m^2), slope of curvature against moment at the knots
    covariance : shape (knots, knots), 1/(N m^2)^2, of the compliances
    curvature : shape (n,), 1/m, none negative
    scale_error : standard uncertainty of the scale of the force, as a fraction of the force

    Returns
    -------
    Values and standard errors, each of shape (n,), of ``moment`` (N m), ``secant`` and ``tangent``
    (N m^2). Values are NaN beyond the largest curvature of the law, where errors have no meaning,
    and the secant also at zero curvature. For zero compliance, errors are not finite.

    Notes
    -----
    At a given curvature kappa = k(M), an error dk of the law changes the moment by -dk / k'(M). The
    scale of the force changes all moments in proportion.
    """
    n_fine = 4000
    basis, fine_moment = LawBasis(knots), np.linspace(0.0, knots[-1], n_fine)
    fine_curvature = basis.compute_curvatures(fine_moment) @ compliance
    is_in_range = (curvature >= 0.0) & (curvature <= fine_curvature[-1] * (1.0 + 1e-12))
    moment = np.where(is_in_range, np.interp(curvature, fine_curvature, fine_moment), np.nan)
    finite_moment = np.nan_to_num(moment)
    weights = basis.compute_compliances(finite_moment)
    interval = np.clip(np.searchsorted(knots, finite_moment, side="right") - 1, 0, len(knots) - 2)
    compliance_slope = (np.diff(compliance) / np.diff(knots))[interval]

    def propagate(gradient: Floats, scale: Floats) -> Floats:
        squares = np.einsum("nk,kj,nj->n", gradient, covariance, gradient)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0) + scale**2), dtype=np.float64)

    with np.errstate(divide="ignore", invalid="ignore"):
        local_compliance = weights @ compliance
        moment_gradient = -basis.compute_curvatures(finite_moment) / local_compliance[:, None]
        compliance_gradient = weights + compliance_slope[:, None] * moment_gradient
        tangent_gradient = -compliance_gradient / local_compliance[:, None] ** 2
        tangent = 1.0 / local_compliance
        moment_error = propagate(moment_gradient, scale_error * moment)
        tangent_error = propagate(tangent_gradient, scale_error * tangent)
        return {
            "moment": (moment, moment_error),
            "secant": (moment / curvature, moment_error / curvature),
            "tangent": (np.where(is_in_range, tangent, np.nan), tangent_error),
        }


def tabulate_law(
    fit: LawFit,
    common_errors: Sequence[Floats],
    *,
    scale_error: float,
    noise: float,
    curvature_noise: float,
    n_frames: int,
) -> MeasuredLaw:
    """Tabulate a law with its intervals.

    Parameters
    ----------
    fit : compliances of the law, with the covariance of their scatter
    common_errors : standard errors from causes common to all frames, as changes of the compliances,
        each of shape (knots,)
    scale_error : standard uncertainty of the scale of the force, as a fraction of the force
    noise : m, standard deviation of a marker coordinate in a mean of the fit
    curvature_noise : 1/m, median standard error of the cloud's curvatures in the first loading
    n_frames : number of frames used

    Returns
    -------
    Moments and stiffnesses at 41 curvatures from zero up, denser near zero.

    Notes
    -----
    A curvature is known if it is above 1.96 times the noise of the curvatures of the cloud, and if
    the interval of the law excludes a moment of zero. Where an interval is not finite, the moment
    is given without it. Stiffnesses are given where the curvature is known.
    """
    n_rows = 41
    knots, compliance = fit.basis.knots, fit.compliance
    covariance = fit.covariance + sum(np.outer(error, error) for error in common_errors)
    largest_curvature = float(fit.basis.compute_curvatures(knots[-1:])[0] @ compliance)
    curvature = largest_curvature * (np.arange(n_rows) / (n_rows - 1)) ** 2
    points = evaluate_law(knots, compliance, covariance, curvature, scale_error=scale_error)
    floor = NORMAL_95 * curvature_noise
    moment, moment_error = points["moment"]
    is_known = (curvature > floor) & (NORMAL_95 * moment_error < moment)
    columns = dict[str, Floats]()
    for name, (values, errors) in points.items():
        has_interval = np.isfinite(errors) if name == "moment" else is_known
        value = values if name == "moment" else np.where(is_known, values, np.nan)
        margin = NORMAL_95 * np.where(has_interval, errors, np.nan)
        columns |= {name: value, f"{name}_lower": value - margin, f"{name}_upper": value + margin}
    unknown, reason = curvature[1:][~is_known[1:]], None
    if n_unknown := len(unknown):
        facts = {"unknown": n_unknown, "count": n_rows - 1, "last": unknown.max(), "floor": floor}
        reason = Reason.of("results.law_below_noise", **facts)
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
    """A fitted law, and its dependence on the markers.

    Parameters
    ----------
    basis : basis functions of the law
    compliance : shape (knots,), 1/(N m^2), slope of the law at the knots, none negative
    covariance : shape (knots, knots), 1/(N m^2)^2, from the scatter of the markers about the law
    sensitivity : shape (knots, n, 2 markers), change of the compliances per metre of a marker
        coordinate
    residual : m, root mean square misfit per coordinate
    n_coordinates : number of measured marker coordinates in all frames
    noise_variance : m^2, variance of independent noise that would scatter the compliances as much
    """

    basis: LawBasis
    compliance: Floats
    covariance: Floats
    sensitivity: Floats
    residual: float
    n_coordinates: int
    noise_variance: float

    def compute_displacement(self, data: LawData) -> Floats:
        """Compute the displacement of the markers by the law, shape (n, 2 markers), m."""
        return data.compute_displacement(data.compute_rotations(self.basis) @ self.compliance)

    def compute_compliance_change(self, change: Floats) -> Floats:
        """Compute how the fitted compliances change with the data of the fit.

        Parameters
        ----------
        change : shape (n, 2 markers), m, change of the displacement that the same law gives

        Returns
        -------
        shape (knots,), 1/(N m^2), to first order.
        """
        return np.asarray(-np.tensordot(self.sensitivity, change, axes=2), dtype=np.float64)


def refine_law(data: LawData) -> tuple[LawFit, Floats]:
    """Fit a law with 13 knots, or with 25 if they fit the markers much better.

    Parameters
    ----------
    data : moments and markers of the loaded frames and at rest

    Returns
    -------
    fit : the law
    knot_error : shape (knots,), 1/(N m^2), standard errors of the compliances from the number of
        knots, fully correlated: 1 / sqrt(3) of the change with half as many intervals between knots

    Raises
    ------
    ValueError
        As `fit_law`, for any of 7, 13 and 25 knots: all three laws are fitted.

    Notes
    -----
    Thirteen knots describe a smooth law to 0.1 % of its moment. A wire whose strands all slip at
    once has a law with a kink. The intervals are therefore halved if that reduces the sum of
    squares by more than log n times the variance of the noise for each added knot (Schwarz, Ann.
    Stat. 6 (1978) 461).
    """
    knot_counts = (7, 13, 25)
    largest = float(data.moment.max())
    coarse, fit, fine = (fit_law(data, choose_knots(largest, count)) for count in knot_counts)
    gain = fine.n_coordinates * (fit.residual**2 - fine.residual**2)
    penalty = fine.noise_variance * np.log(fine.n_coordinates)
    if gain > penalty * (knot_counts[2] - knot_counts[1]):
        coarse, fit = fit, fine
    # The knots of the coarse law are among those of the fine one.
    coarse_law: Floats = coarse.basis.compute_compliances(fit.basis.knots) @ coarse.compliance
    return fit, RECTANGULAR_DEVIATION * (coarse_law - fit.compliance)


def fit_law(data: LawData, basis: LawBasis) -> LawFit:
    """Fit a law to the marker positions by least squares.

    Parameters
    ----------
    data : moments and markers of the loaded frames and at rest
    basis : basis functions with the knots of the law

    Returns
    -------
    The law, with the covariance of its compliances from the scatter of the markers.

    Raises
    ------
    ValueError
        If the markers do not determine all compliances: too few frames, or moments too small.

    Notes
    -----
    The method is Gauss-Newton, from one compliance for all knots. A step to a negative compliance
    is replaced by non-negative least squares (Lawson and Hanson, Solving Least Squares Problems,
    1974, chapter 23). Every marker coordinate has its own offset, known from the frames at rest,
    which are one more row of the design. The covariance therefore includes the noise of the mean at
    rest, which is common to all frames. It is a sandwich estimator with the long-run covariance of
    the residuals between coordinates (Newey and West, Econometrica 55 (1987) 703), because an error
    of the clamp's pivot or of the force moves all coordinates, and that of a smoothed force lasts
    for several frames.
    """
    max_steps = 12
    relative_tolerance = 1e-7
    is_measured = np.isfinite(data.displacement)
    measured = np.where(is_measured, data.displacement, 0.0)
    weight = is_measured.sum(axis=0) + data.rest_weight

    def subtract_offsets(values: Floats) -> Floats:
        """Subtract the offset of each coordinate: (n, 2 markers, k) to (n + 1, 2 markers, k)."""
        values = np.where(is_measured[..., None], values, 0.0)
        offset = values.sum(axis=0) / weight[:, None]
        centred = np.where(is_measured[..., None], values - offset, 0.0)
        return np.concatenate([centred, -np.sqrt(data.rest_weight) * offset[None]])

    rotations, ones = data.compute_rotations(basis), np.ones(len(basis.knots))
    unit_displacement = data.compute_derivatives(rotations, 0.0 * ones) @ ones
    scale = float((unit_displacement**2).sum())
    if not scale > 0.0:
        raise ValueError(format_sentence("results.no_change_of_moment"))
    compliance: Floats = ones * abs(float((unit_displacement * measured).sum())) / scale
    for _ in range(max_steps):
        misfit = measured - data.compute_displacement(rotations @ compliance)
        residuals = subtract_offsets(misfit[..., None])
        design = subtract_offsets(data.compute_derivatives(rotations, compliance))
        rows = design.reshape(-1, len(ones))
        normal = rows.T @ rows
        solution = _solve_non_negative(normal, rows.T @ residuals.ravel() + normal @ compliance)
        change = float(np.abs(solution - compliance).max() / np.abs(solution).max())
        compliance = solution
        if change < relative_tolerance:
            break
    residuals, count = residuals[:-1, :, 0], int(is_measured.sum())
    sensitivity = np.einsum("kj,nmj->knm", _invert(normal), design)[:, :-1]
    degrees_of_freedom = max(float(count) - len(ones) - is_measured.shape[1], 1.0)
    noise = _estimate_long_run_covariance(residuals, is_measured) * count / degrees_of_freedom
    covariance = np.einsum("knm,ml,jnl->kj", sensitivity, noise, sensitivity, optimize=True)
    return LawFit(
        basis=basis,
        compliance=compliance,
        covariance=covariance,
        sensitivity=sensitivity,
        residual=float(np.sqrt((residuals**2).sum() / max(count, 1))),
        n_coordinates=count,
        noise_variance=float(np.trace(covariance @ normal)) / len(ones),
    )


def _solve_non_negative(normal: Floats, right: Floats) -> Floats:
    """Solve normal equations for compliances, none of them negative."""
    solution: Floats = _invert(normal) @ right
    if (solution >= 0.0).all():
        return solution
    from scipy.optimize import nnls  # a slow import, which few tests need

    scale = np.sqrt(np.diag(normal))
    triangle = np.linalg.cholesky(normal / np.outer(scale, scale))
    return nnls(triangle.T, np.linalg.solve(triangle, right / scale))[0] / scale


def _invert(normal: Floats) -> Floats:
    """Invert a matrix of normal equations, scaled to a unit diagonal."""
    max_condition = 1e12
    scale = np.sqrt(np.diag(normal))
    if not (scale > 0.0).all() or np.linalg.cond(normal / np.outer(scale, scale)) > max_condition:
        raise ValueError(format_sentence("results.law_not_determined", knots=len(scale)))
    inverse = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.asarray(inverse, dtype=np.float64)


def _estimate_long_run_covariance(residuals: Floats, is_measured: Flags) -> Floats:
    """Estimate the long-run covariance between columns of residuals, with Bartlett's weights."""
    count = len(residuals)
    lags = min(round(4.0 * (count / 100.0) ** (2.0 / 9.0)) + 1, count // 4)
    weights = is_measured.astype(np.float64)
    total = residuals.T @ residuals / np.maximum(weights.T @ weights, 1.0)
    for lag in range(1, lags + 1):
        pair_counts = np.maximum(weights[lag:].T @ weights[:-lag], 1.0)
        lagged = residuals[lag:].T @ residuals[:-lag] / pair_counts
        total += (1.0 - lag / (lags + 1.0)) * (lagged + lagged.T)
    return np.asarray(total, dtype=np.float64)


def divide_wire(markers: Floats, length: float) -> tuple[Floats, Ints]:
    """Divide a wire finely, with points at the markers and at the tip.

    Parameters
    ----------
    markers : shape (markers,), m, arc lengths of the markers from the clamped end
    length : m, free length of the wire

    Returns
    -------
    points : shape (points,), m, arc lengths from the clamped end to the tip
    marker_points : shape (markers,), indices of the points that are markers
    """
    max_step = 0.0015  # m
    ends = np.concatenate([[0.0], markers, [length]])
    ends = ends[np.concatenate([[True], np.diff(ends) > 1e-9])]
    counts = np.maximum(np.ceil(np.diff(ends) / max_step).astype(np.int64), 1)
    segments = [
        np.linspace(first, last, count, endpoint=False)
        for (first, last), count in zip(pairwise(ends), counts, strict=True)
    ]
    points = np.concatenate([*segments, ends[-1:]])
    return points, np.searchsorted(points, markers - 1e-10).astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class LawData:
    """Moments and markers to which a law is fitted.

    Parameters
    ----------
    arc_length : shape (points,), m, points along the wire from the clamped end to the tip
    marker_points : shape (markers,), indices of the points that are markers
    moment : shape (n, points), N m, moments of n means over loaded frames
    moment_at_rest : shape (points,), N m, moments before the loading
    angle_at_rest : shape (points,), rad, direction of the wire before the loading
    markers : shape (n, markers, 2), m, mean positions in the plane of bending, from the clamped
        end; NaN are ignored
    markers_at_rest : shape (markers, 2), m, mean positions before the loading
    rest_weight : number of frames at rest over number of frames of a mean
    centre_offset : m, axis to marker centre, positive towards the pull
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
    def displacement(self) -> Floats:
        """Displacement of the markers from rest, shape (n, 2 markers), m: x of all, then y."""
        displacement = self.markers - self.markers_at_rest
        return np.concatenate([displacement[..., 0], displacement[..., 1]], axis=1)

    def compute_rotations(self, basis: LawBasis) -> Floats:
        """Compute rotations of the wire from rest per unit of compliance at each knot.

        Parameters
        ----------
        basis : basis functions of the law

        Returns
        -------
        shape (n, points, knots), rad N m^2.
        """
        return self._integrate(basis.compute_curvature_changes(self.moment_at_rest, self.moment))

    def compute_displacement(self, rotation: Floats) -> Floats:
        """Compute the displacement of the markers from rest.

        Parameters
        ----------
        rotation : shape (n, points), rad, rotation of the wire from rest

        Returns
        -------
        shape (n, 2 markers), m: x of all markers, then y.
        """
        angles = self.angle_at_rest + rotation, self.angle_at_rest[None]
        loaded, at_rest = (self._place_centres(np.cos(x), np.sin(x)) for x in angles)
        return loaded - at_rest

    def compute_derivatives(self, rotations: Floats, compliance: Floats) -> Floats:
        """Compute the derivatives of the displacement with respect to the compliances.

        Parameters
        ----------
        rotations : shape (n, points, knots), rad N m^2, from `compute_rotations`
        compliance : shape (knots,), 1/(N m^2)

        Returns
        -------
        shape (n, 2 markers, knots), N m^3.
        """
        angle = (self.angle_at_rest + rotations @ compliance)[..., None]
        return self._place_centres(-np.sin(angle) * rotations, np.cos(angle) * rotations)

    def _place_centres(self, dx: Floats, dy: Floats) -> Floats:
        """Integrate tangents (dx, dy), and add the offset normal to them, at the markers."""
        offset = self.centre_offset
        x, y = self._integrate(dx) - offset * dy, self._integrate(dy) + offset * dx
        return np.concatenate([x[:, self.marker_points], y[:, self.marker_points]], axis=1)

    def _integrate(self, values: Floats) -> Floats:
        """Integrate values of shape (n, points, ...) from the clamped end by trapezoids."""
        steps = np.diff(self.arc_length).reshape(-1, *(1,) * (values.ndim - 2))
        integral = np.zeros_like(values)
        np.cumsum(steps * (values[:, 1:] + values[:, :-1]) / 2.0, axis=1, out=integral[:, 1:])
        return integral


@dataclass(frozen=True, slots=True, eq=False)
class LawBasis:
    """Basis of laws whose compliance d kappa / d M is linear between knots.

    The compliance is constant beyond the last knot.

    Parameters
    ----------
    knots : shape (knots,), N m, moments from 0 up
    """

    knots: Floats

    def compute_compliances(self, moment: Floats) -> Floats:
        """Compute the compliance per unit of compliance at each knot, shape (*moment, knots)."""
        hats = np.eye(len(self.knots))
        return np.stack([np.interp(np.abs(moment), self.knots, hat) for hat in hats], axis=-1)

    def compute_curvatures(self, moment: Floats) -> Floats:
        """Compute the curvature per unit of compliance at each knot, N m, shape (*moment, knots).

        The curvature is an odd function of the moment.
        """
        widths, size = np.diff(self.knots), np.abs(moment)
        size_in_range = np.clip(size, 0.0, self.knots[-1])
        lengths = np.clip(size_in_range[..., None] - self.knots[:-1], 0, widths)
        by_upper_knot = lengths**2 / (2.0 * widths)
        curvatures = np.zeros((*np.shape(size), len(self.knots)))
        curvatures[..., :-1] += lengths - by_upper_knot
        curvatures[..., 1:] += by_upper_knot
        curvatures[..., -1] += np.maximum(size - self.knots[-1], 0.0)
        return np.asarray(np.sign(moment)[..., None] * curvatures, dtype=np.float64)

    def compute_curvature_changes(self, start_moment: Floats, moment: Floats) -> Floats:
        """Compute curvature less that at the start, per unit of compliance at each knot.

        Parameters
        ----------
        start_moment : shape (points,), N m, moments that a first loading reached
        moment : shape (n, points), N m, moments after them

        Returns
        -------
        shape (n, points, knots), N m.
        """
        changes = self.compute_curvatures(moment) - self.compute_curvatures(start_moment)
        rise = moment - start_moment
        unloads = (rise * start_moment < 0.0) & (np.abs(rise) < 2.0 * np.abs(start_moment))
        changes[unloads] = 2.0 * self.compute_curvatures(0.5 * rise[unloads])
        return changes


def choose_knots(largest_moment: float, count: int) -> LawBasis:
    """Choose knots at moments in proportion to the power 1.6 of their index.

    They are denser near zero, since every frame has cross-sections with small moments.

    Parameters
    ----------
    largest_moment : N m, moment of the last knot
    count : number of knots, at least 2

    Returns
    -------
    The basis functions with these knots.
    """
    return LawBasis(largest_moment * (np.arange(count) / (count - 1)) ** 1.6)
