"""Measure curvature and moment (the cloud), and fit the law of the first loading.

Shapes are measured by markers and moments by the force; no stiffness is assumed. The axes are those
of the specimen: x along its undeformed axis from the clamped end, y in the plane of bending towards
the pull. Curvatures of the cloud are computed from second derivatives of curves through the
markers. The fit of the law compares the markers with the shapes that the law predicts. It
differentiates no curve, so its curvatures are much more accurate.

The model wire does not stretch, and its direction at the clamp is fixed. The angle of its axis in
frame f of the cameras is

    theta_f(s) = theta_rest(s) + integral from 0 to s of [kappa(M_f) - kappa(M_rest)] ds'

with one law kappa(M) for all cross-sections and frames. If a weight bends the wire at rest away
from the pull, the loading first unloads the wire. Masing's rule then holds until the moment towards
the pull is as large as that at rest:

    kappa - kappa(M_rest) = 2 kappa((M_f - M_rest) / 2).

The axis is x = integral cos theta, y = integral sin theta. Marker centres are offset from the axis
along its normal.
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
"""Number of means over consecutive frames of the first loading in the fit of the law.

All means have the same whole number of frames, so the loading has from this number to twice this
number of means. It has fewer if it has fewer frames, or if means have no shape or force.
"""
N_CLOUD_MEANS = 50
"""Number of means of the first loading in the cloud, in the sense of `N_FIT_MEANS`."""
N_CLOUD_STATIONS = 17
"""Number of equidistant stations along the specimen in the cloud."""
RECTANGULAR_DEVIATION = 1.0 / np.sqrt(3.0)
"""Standard deviation of a rectangular distribution of half-width one."""


@dataclass(frozen=True, slots=True, eq=False)
class TipPull:
    """Pull of a string and a weight at the tip, as a function of the reading of the load cell.

    Parameters
    ----------
    string_length : m, length of the string from its anchor at the load cell to the tip; None for a
        force normal to the clamped axis
    tip_weight : N, weight that hangs at the tip
    tension_at_rest : N, tension of the string before the loading, which the zeroed force omits
    anchor_x : m, position of the anchor along x
    self_weight : N/m, weight of the level specimen per length
    """

    string_length: float | None
    tip_weight: float
    tension_at_rest: float
    anchor_x: float
    self_weight: float = 0.0

    def compute_force(self, reading: Floats, tip_x: Floats) -> Floats:
        """Compute the force at the tip.

        Parameters
        ----------
        reading : shape (n,), N, the tension less that at rest; NaN gives NaN
        tip_x : shape (n,), m, position of the tip along x

        Returns
        -------
        Shape (n, 2), N, along x and y. The y component is NaN if the distance of the tip from the
        anchor along x exceeds the length of the string; the x component is then finite.

        Notes
        -----
        The angle beta of the string from the y axis increases as the tip moves away from the anchor
        along x: sin(beta) = (anchor_x - tip_x) / string_length.
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
    Positions, angles and curvatures of the n curves at the stations.

    Notes
    -----
    The curvature is kappa = (x' y'' - y' x'') / (x'^2 + y'^2)^(3/2). The denominator is not 1,
    because the parameter s of a fitted curve is only approximately its arc length.
    """
    series, u = np.moveaxis(coefficients[:, :2], -1, 0), arc_length / length
    (x, y), (dx, dy), (ddx, ddy) = (
        np.moveaxis(polyval(u, polyder(series, order)), 1, 0) / length**order for order in range(3)
    )
    curvature = (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3
    return StationCurves(x, y, np.arctan2(dy, dx), curvature)


@dataclass(frozen=True, slots=True)
class BendingErrors:
    """Standard errors of force and positions, and an alternative tension at rest.

    Parameters
    ----------
    force_noise : N, noise of the force in one frame
    force_zero : N, error of the zero of the force
    force_scale : error of the scale of the force, as a fraction of the force
    end_position : m, error of the position of the clamped end along the specimen, and of that of
        the pull point
    alternative_tension : N, another tension at rest that is as probable as the assumed one, or None
    centre_offset : m, error of the distance from the axis to the marker centres
    """

    force_noise: float
    force_zero: float
    force_scale: float
    end_position: float
    alternative_tension: float | None = None
    centre_offset: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FittedMeans:
    """Means of markers and force over consecutive frames of a branch, and curves through the means.

    Parameters
    ----------
    time, force : shape (n,), s and N, mean time and mean force
    branch : shape (n,), index of the branch of each mean
    markers : shape (n, markers, 3), m, mean positions from the clamped end; NaN if a marker was not
        measured in every frame of the mean
    coefficients : shape (n, 3, terms), m, power series of the fitted curves
    finer_series : shape (n, 3, terms + 1), m, power series with one more coefficient; None if
        the markers do not determine it
    tip_gain : shape (n,), larger standard error of both coordinates of the tip, over the standard
        deviation of a marker coordinate
    """

    time: Floats
    force: Floats
    branch: Ints
    markers: Floats
    coefficients: Floats
    finer_series: Floats | None
    tip_gain: Floats


@dataclass(frozen=True, slots=True, eq=False)
class SpecimenAtRest:
    """Mean markers of the specimen before the loading, and the mean curve through them.

    Parameters
    ----------
    markers : shape (markers, 3), m, mean positions from the clamped end
    coefficients : shape (1, 3, terms), m, power series of the mean curve
    finer_series : shape (1, 3, terms + 1), m, power series with one more coefficient; that of
        `coefficients` if the markers do not determine it
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
        was measured in at least three quarters of them; the others were filled across short gaps
    branch : shape (frames,), index of the branch of each frame; frames with a negative index are
        excluded
    frames_per_mean : number of frames of one mean; the remainder of a branch is excluded

    Returns
    -------
    rows : shape (n, frames_per_mean), indices of the frames of each mean, in order of time
    markers : shape (n, markers, 3), m, mean positions from the clamped end; NaN for a marker
        that is not averaged
    """
    min_measured_fraction = 0.75
    branch_ends = np.concatenate([[0], np.flatnonzero(np.diff(branch)) + 1, [len(branch)]])
    first_rows = [
        np.arange(start, stop - frames_per_mean + 1, frames_per_mean)
        for start, stop in pairwise(branch_ends)
        if branch[start] >= 0
    ]
    rows = np.concatenate([np.arange(0), *first_rows])[:, None] + np.arange(frames_per_mean)
    indices = rows[..., None], np.flatnonzero(_flag_markers(shape))
    flags = shape.flags[indices]
    is_measured = np.isin(flags, (PointFlag.MEASURED, PointFlag.RELABELLED))
    is_used = is_measured.mean(axis=1, keepdims=True) >= min_measured_fraction
    is_used = is_used & (is_measured | (flags == PointFlag.FILLED))
    return rows, np.where(is_used[..., None], shape.positions[indices], np.nan).mean(axis=1)


def _flag_markers(shape: Shape) -> Flags:
    """Flag the points of a shape that are markers, not constructed points, shape (points,)."""
    return np.asarray(~(shape.flags == PointFlag.CONSTRUCTED).any(axis=0), dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class BendingTest:
    """Shapes and forces of a bending test; all arrays have shape (frames,).

    Parameters
    ----------
    shape : shape of the specimen in every frame, with clamped end and pull point
    force : N, force of the curve at the time of each frame; NaN outside the curve
    branch, cycle : index of the branch, and number of the cycle, of the curve at each frame
    first_branch : index of the branch of the first loading
    is_at_rest : whether the frame was taken before the loading
    centre_offset : m, distance from the axis to the marker centres, positive towards the pull
    free_tip : whether the shapes were fitted without a moment at the tip
    pull : pull of string and weight on the tip
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

        Returns
        -------
        One curve for each row of `markers`.

        Raises
        ------
        ValueError
            If no frame has a curve.
        """
        length, coefficients = self.shape.length, self.shape.coefficients
        fitted_frames = np.flatnonzero(np.isfinite(coefficients).all(axis=(1, 2)))
        if not len(fitted_frames):
            raise ValueError(format_sentence("results.no_fitted_frame"))
        direction = coefficients[fitted_frames[0], :, 1] / length
        ends = EndConditions(length=length, direction=direction, free_tip=self.free_tip)
        terms = coefficients.shape[2] + extra_terms
        return fit_frames(markers, self.marker_arc_length, self.centre_offset, ends, terms=terms)

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
        branch : shape (frames,), index of the branch of each frame; frames with a negative index
            are excluded
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
        finer_fit = self.fit_curves(markers, extra_terms=1) if fit.n_spare > 0 else None
        return FittedMeans(
            time=self.shape.time[rows].mean(axis=1),
            force=force[is_usable],
            branch=branch[rows[:, 0]],
            markers=markers,
            coefficients=fit.coefficients[is_usable],
            finer_series=None if finer_fit is None else finer_fit.coefficients,
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
        Shape (n, stations), N m, positive if the moment bends towards the pull: M(s) =
        Py (x_L - x) - Px (y_L - y), less the moment of the specimen's weight between s and the tip.
        """
        length, pull = self.shape.length, self.pull
        curves = evaluate_curves(coefficients, length, arc_length)
        tip = evaluate_curves(coefficients, length, np.array([length]))
        force = pull.compute_force(reading, tip.x[:, 0])
        moment = force[:, 1:] * (tip.x - curves.x) - force[:, :1] * (tip.y - curves.y)
        x_integral = polyint(coefficients[:, 0].T)
        tip_integral = polyval(np.ones(1), x_integral)
        integral_to_tip = length * (tip_integral - polyval(arc_length / length, x_integral))
        first_moment = integral_to_tip - (length - arc_length) * curves.x  # m^2, about the station
        return np.asarray(moment - pull.self_weight * first_moment, dtype=np.float64)

    def compute_curvature_gain(
        self, markers: Floats, curves: StationCurves, arc_length: Floats
    ) -> Floats:
        """Compute the ratio of the standard error of curvature to the noise of a coordinate.

        Parameters
        ----------
        markers : shape (n, markers, 3), m, positions to which the curves were fitted; NaN for a
            marker that is not visible
        curves : the fitted curves at the stations
        arc_length : shape (stations,), m, stations from the clamped end

        Returns
        -------
        Shape (n, stations), 1/m^2; NaN for a curve with too few markers.

        Notes
        -----
        With the normal n = (-sin, cos) and the tangent t = (cos, sin) of the curve, d kappa =
        n . d r'' - 2 kappa t . d r'. The least-squares fit makes r'' and r' linear in the markers.
        """
        length, free_tip = self.shape.length, self.free_tip
        terms = int(self.shape.coefficients.shape[2])
        basis = build_curve_basis(terms=terms, length=length, has_clamp=True, free_tip=free_tip)
        second_derivative = polyval(arc_length / length, polyder(basis.matrix, 2)).T / length**2
        derivatives = second_derivative, basis.compute_slopes(arc_length)
        is_visible = np.isfinite(markers).all(axis=2)
        gain = np.full(curves.angle.shape, np.nan)
        for pattern in np.unique(is_visible, axis=0):
            if pattern.sum() < basis.n_unknowns:
                continue
            design = build_marker_design(basis, self.marker_arc_length[pattern], self.centre_offset)
            fit_operators = np.split(np.linalg.pinv(design), 2)  # of x and of y
            operators = np.stack([matrix @ fit for matrix in derivatives for fit in fit_operators])
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
        return Bending(cloud, fit_loading_law(test, cloud))
    except ValueError as error:
        return Bending(cloud, None, Reason("no_law", str(error)))


def measure_cloud(test: BendingTest) -> BendingCloud:
    """Measure curvatures and moments, less those at rest, at stations along the specimen.

    Parameters
    ----------
    test : shapes and force of the test

    Returns
    -------
    One row per mean over consecutive frames of a branch. `N_CLOUD_MEANS` sets the number of frames
    of one mean, for all branches. A mean without a shape or a force is omitted.

    Raises
    ------
    ValueError
        If fewer than two frames at rest show all markers, no frame has a curve, or no mean has
        shape and force.

    Notes
    -----
    Moments are those of `BendingTest.compute_moments`, with the specimen's weight. The standard
    error of the curvature assumes that the noise of the markers is independent from frame to frame.
    The systematic error is the change of the curvature with one more coefficient.
    """
    n_loading_frames = int((test.branch == test.first_branch).sum())
    frames_per_mean = max(1, n_loading_frames // N_CLOUD_MEANS)
    means = test.fit_means(test.branch, frames_per_mean=frames_per_mean)
    rest, errors, length = test.specimen_at_rest, test.errors, test.shape.length
    stations = np.linspace(0.0, length, N_CLOUD_STATIONS)

    def compute_curvature(coefficients: Floats) -> Floats:
        return evaluate_curves(coefficients, length, stations).curvature

    loaded_curves = evaluate_curves(means.coefficients, length, stations)
    curvature = loaded_curves.curvature - compute_curvature(rest.coefficients)
    systematic_error = np.full(curvature.shape, np.nan)
    if means.finer_series is not None:
        finer = compute_curvature(means.finer_series) - compute_curvature(rest.finer_series)
        systematic_error = np.abs(finer - curvature)
    moment_at_rest = test.compute_moments(rest.coefficients, np.zeros(1), stations)[0]
    moment = test.compute_moments(means.coefficients, means.force, stations) - moment_at_rest
    noise_factor = np.sqrt(1.0 / frames_per_mean + 1.0 / rest.n_frames)
    gain = test.compute_curvature_gain(means.markers, loaded_curves, stations)
    force_error = np.hypot(errors.force_zero, errors.force_noise / np.sqrt(frames_per_mean))
    error_from_force = force_error * (loaded_curves.x[:, -1:] - loaded_curves.x)
    # If marker centres are farther from the axis by d, the lever is shorter by d times the sine of
    # the angle at the tip.
    centre_error = errors.centre_offset * np.sin(loaded_curves.angle[:, -1])
    tip_error = rest.marker_noise * means.tip_gain / np.sqrt(frames_per_mean)
    lever_error = np.hypot(np.hypot(errors.end_position, centre_error), tip_error)
    error_from_lever = (lever_error * means.force)[:, None]
    error_from_scale = errors.force_scale * moment
    return BendingCloud(
        time=means.time,
        branch=means.branch,
        cycle=test.cycle[np.searchsorted(test.shape.time, means.time)],
        force=means.force,
        arc_length=stations,
        curvature=curvature,
        curvature_error=rest.marker_noise * noise_factor * gain,
        curvature_systematic=systematic_error,
        moment=moment,
        moment_error=np.sqrt(error_from_force**2 + error_from_scale**2 + error_from_lever**2),
        moment_at_rest=moment_at_rest,
        frames_per_mean=frames_per_mean,
    )


def fit_loading_law(test: BendingTest, cloud: BendingCloud) -> MeasuredLaw:
    """Fit one law to all frames of the first loading.

    Parameters
    ----------
    test : shapes and force of the test
    cloud : moments and curvatures of the test; the noise of its curvatures limits the known range

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
    first order and added as independent errors. The standard error from an equally probable
    alternative, or from half as many intervals between knots, is 1 / sqrt(3) of the change, as for
    a rectangular distribution.
    """
    min_means = 24
    is_loading, rest = test.branch == test.first_branch, test.specimen_at_rest
    frames_per_mean = max(1, int(is_loading.sum()) // N_FIT_MEANS)
    means = test.fit_means(np.where(is_loading, test.branch, -1), frames_per_mean=frames_per_mean)
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
    moments = {"largest": data.moment.max(), "at_rest": np.abs(data.moment_at_rest).max()}
    if not moments["largest"] > moments["at_rest"]:
        raise ValueError(format_sentence("results.no_moment", **moments))
    fit, knot_error = refine_law(data)

    displacement = fit.compute_displacement(data)
    common_errors = [knot_error]
    for alternative, factor in _generate_alternatives(test, means, data):
        marker_shifts = fit.compute_displacement(alternative) - displacement
        common_errors.append(factor * fit.compute_compliance_change(marker_shifts))
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
    """Yield the data changed by each common cause, and the factor from change to standard error."""
    errors, rest, length = test.errors, test.specimen_at_rest, test.shape.length
    points, no_load = data.arc_length, np.zeros(1)

    def recompute(
        test: BendingTest = test,
        curves: Floats = means.coefficients,
        rest_curves: Floats = rest.coefficients,
        force_change: float = 0.0,
    ) -> LawData:
        return replace(
            data,
            moment=test.compute_moments(curves, means.force + force_change, points),
            moment_at_rest=test.compute_moments(rest_curves, no_load, points)[0],
        )

    # The zero of the force is wrong.
    yield recompute(force_change=errors.force_zero), 1.0
    if errors.alternative_tension is not None:
        # The string has another tension at rest.
        pull = replace(test.pull, tension_at_rest=errors.alternative_tension)
        yield recompute(replace(test, pull=pull)), RECTANGULAR_DEVIATION
    if means.finer_series is not None:
        # The fitted curves have one more coefficient.
        alternative = recompute(curves=means.finer_series, rest_curves=rest.finer_series)
        yield alternative, RECTANGULAR_DEVIATION
    if errors.end_position > 0.0:
        # The clamped end is farther from the first marker.
        first_marker = points[data.marker_points[0]]
        shifted_points = points + errors.end_position * np.minimum(points / first_marker, 1.0)
        stations = shifted_points - (shifted_points[-1] - length)
        moment = test.compute_moments(means.coefficients, means.force, stations)
        yield replace(data, arc_length=shifted_points, moment=moment), 1.0
        # The pull point is farther from the clamped end.
        tip = evaluate_curves(means.coefficients, length, np.array([length]))
        force = test.pull.compute_force(means.force, tip.x[:, 0])
        normal_force = force[:, 1:] * np.cos(tip.angle) - force[:, :1] * np.sin(tip.angle)
        yield replace(data, moment=data.moment + errors.end_position * normal_force), 1.0
    if errors.centre_offset > 0.0:
        # Marker centres are farther from the axis.
        changed_test = replace(test, centre_offset=test.centre_offset + errors.centre_offset)
        clamp_angle = data.angle_at_rest[0]
        clamp_normal = np.array([-np.sin(clamp_angle), np.cos(clamp_angle), 0.0])
        marker_shift = errors.centre_offset * clamp_normal
        curves = changed_test.fit_curves(means.markers + marker_shift).coefficients
        rest_curves = changed_test.fit_curves(rest.markers[None] + marker_shift).coefficients
        alternative = recompute(changed_test, curves, rest_curves)
        angle = evaluate_curves(rest_curves, length, points).angle[0]
        offset = changed_test.centre_offset
        yield replace(alternative, angle_at_rest=angle, centre_offset=offset), 1.0


def evaluate_law(
    knots: Floats, compliance: Floats, covariance: Floats, curvature: Floats, *, scale_error: float
) -> dict[str, tuple[Floats, Floats]]:
    """Evaluate a law at curvatures.

    Parameters
    ----------
    knots : shape (knots,), N m, moments at the knots, from 0 up
    compliance : shape (knots,), 1/(N m^2), slope of curvature against moment at the knots
    covariance : shape (knots, knots), 1/(N m^2)^2, covariance of the compliances
    curvature : shape (n,), 1/m, none negative
    scale_error : standard uncertainty of the scale of the force, as a fraction of the force

    Returns
    -------
    Values and standard errors, each of shape (n,), of ``moment`` (N m), ``secant`` and ``tangent``
    (N m^2). Beyond the largest curvature of the law, values are NaN and errors have no meaning. At
    zero curvature, the secant is NaN. If the compliance is zero, errors are not finite.

    Notes
    -----
    At a given curvature kappa = k(M), an error dk of the law changes the moment by -dk / k'(M). The
    scale of the force changes all moments in proportion.
    """
    n_fine = 4000
    basis, fine_moment = LawBasis(knots), np.linspace(0.0, knots[-1], n_fine)
    fine_curvature = basis.compute_curvatures(fine_moment) @ compliance
    largest_curvature = fine_curvature[-1] * (1.0 + 1e-12)  # despite rounding
    is_in_range = (curvature >= 0.0) & (curvature <= largest_curvature)
    moment = np.where(is_in_range, np.interp(curvature, fine_curvature, fine_moment), np.nan)
    finite_moment = np.nan_to_num(moment)
    weights = basis.compute_compliances(finite_moment)
    interval = np.clip(np.searchsorted(knots, finite_moment, side="right") - 1, 0, len(knots) - 2)
    compliance_slope = (np.diff(compliance) / np.diff(knots))[interval]

    def compute_error(gradient: Floats, error_from_scale: Floats) -> Floats:
        variance = np.maximum(np.einsum("nk,kj,nj->n", gradient, covariance, gradient), 0.0)
        return np.asarray(np.sqrt(variance + error_from_scale**2), dtype=np.float64)

    with np.errstate(divide="ignore", invalid="ignore"):
        local_compliance = weights @ compliance
        moment_gradient = -basis.compute_curvatures(finite_moment) / local_compliance[:, None]
        compliance_gradient = weights + compliance_slope[:, None] * moment_gradient
        tangent_gradient = -compliance_gradient / local_compliance[:, None] ** 2
        tangent = 1.0 / local_compliance
        moment_error = compute_error(moment_gradient, scale_error * moment)
        tangent_error = compute_error(tangent_gradient, scale_error * tangent)
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
    fit : compliances of the law, with their covariance from the scatter of the markers
    common_errors : standard errors from causes common to all frames, as changes of the compliances,
        each of shape (knots,)
    scale_error : standard uncertainty of the scale of the force, as a fraction of the force
    noise : m, standard deviation of a marker coordinate in a mean of the fit
    curvature_noise : 1/m, median standard error of the cloud's curvatures in the first loading
    n_frames : number of frames used for the fit

    Returns
    -------
    Moments and stiffnesses at 41 curvatures from zero up, denser near zero.

    Notes
    -----
    A curvature is known if it exceeds 1.96 times the noise of the curvatures of the cloud, and if
    the interval of the law excludes a moment of zero. A moment without a finite interval has the
    interval NaN. Stiffnesses are NaN at unknown curvatures.
    """
    n_rows = 41
    knots, compliance = fit.basis.knots, fit.compliance
    covariance = fit.covariance + sum(np.outer(error, error) for error in common_errors)
    largest_curvature = float(fit.basis.compute_curvatures(knots[-1:])[0] @ compliance)
    curvature = largest_curvature * (np.arange(n_rows) / (n_rows - 1)) ** 2
    quantities = evaluate_law(knots, compliance, covariance, curvature, scale_error=scale_error)
    floor = NORMAL_95 * curvature_noise
    moment, moment_error = quantities["moment"]
    is_known = (curvature > floor) & (NORMAL_95 * moment_error < moment)
    columns = dict[str, Floats]()
    for name, (values, errors) in quantities.items():
        has_interval = np.isfinite(errors) if name == "moment" else is_known
        value = values if name == "moment" else np.where(is_known, values, np.nan)
        margin = NORMAL_95 * np.where(has_interval, errors, np.nan)
        columns |= {name: value, f"{name}_lower": value - margin, f"{name}_upper": value + margin}
    unknown_curvatures, reason = curvature[1:][~is_known[1:]], None
    if n_unknown := len(unknown_curvatures):
        facts = {"unknown": n_unknown, "count": n_rows - 1, "last": unknown_curvatures.max()}
        reason = Reason.of("results.law_below_noise", **facts, floor=floor)
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
    """A fitted law, with the sensitivity of its compliances to the markers.

    Parameters
    ----------
    basis : basis functions of the law
    compliance : shape (knots,), 1/(N m^2), slope of the law at the knots, none negative
    covariance : shape (knots, knots), 1/(N m^2)^2, from the scatter of the markers about the law
    sensitivity : shape (knots, n, 2 markers), change of the compliances per metre of a marker
        coordinate
    residual : m, root mean square misfit of a marker coordinate
    n_coordinates : number of measured marker coordinates in all means
    noise_variance : m^2, variance of independent noise of the coordinates for which the compliances
        have about the same covariance
    """

    basis: LawBasis
    compliance: Floats
    covariance: Floats
    sensitivity: Floats
    residual: float
    n_coordinates: int
    noise_variance: float

    def compute_displacement(self, data: LawData) -> Floats:
        """Compute the displacement of the markers from rest by the law, m, shape (n, 2 markers)."""
        return data.compute_displacement(data.compute_rotations(self.basis) @ self.compliance)

    def compute_compliance_change(self, marker_shifts: Floats) -> Floats:
        """Compute the change of the fitted compliances with a change of the data of the fit.

        Parameters
        ----------
        marker_shifts : shape (n, 2 markers), m, change of the displacements by the same law

        Returns
        -------
        Shape (knots,), 1/(N m^2), to first order.
        """
        return np.asarray(-np.tensordot(self.sensitivity, marker_shifts, axes=2), dtype=np.float64)


def refine_law(data: LawData) -> tuple[LawFit, Floats]:
    """Fit a law with 13 knots, or with 25 knots if these fit the markers significantly better.

    Parameters
    ----------
    data : moments and markers of the loaded frames and at rest

    Returns
    -------
    fit : the law
    knot_error : shape (knots,), 1/(N m^2), fully correlated standard errors of the compliances from
        the number of knots: 1 / sqrt(3) of the change with half as many intervals between knots

    Raises
    ------
    ValueError
        As `fit_law`, for 7, 13 or 25 knots, since all three laws are fitted.

    Notes
    -----
    Thirteen knots describe a smooth law to 0.1 % of its moment. If all strands of a wire begin to
    slip at the same moment, the law has a kink. The intervals between knots are therefore halved if
    that reduces the sum of squares, for each added knot, by more than log n times the variance of
    the noise (Schwarz, Ann. Stat. 6 (1978) 461).
    """
    knot_counts = (7, 13, 25)
    largest = float(data.moment.max())
    coarse, fit, fine = (fit_law(data, choose_knots(largest, count)) for count in knot_counts)
    reduction = fine.n_coordinates * (fit.residual**2 - fine.residual**2)
    penalty_per_knot = fine.noise_variance * np.log(fine.n_coordinates)
    if reduction > penalty_per_knot * (knot_counts[2] - knot_counts[1]):
        coarse, fit = fit, fine
    # The knots of the coarse law are among those of the fine one.
    coarse_compliance = coarse.basis.compute_compliances(fit.basis.knots) @ coarse.compliance
    return fit, RECTANGULAR_DEVIATION * np.asarray(coarse_compliance - fit.compliance)


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
    The method is Gauss-Newton, and starts with the same compliance at all knots. A step to a
    negative compliance is replaced by non-negative least squares (Lawson and Hanson, Solving Least
    Squares Problems, 1974, chapter 23). Every marker coordinate has an unknown offset, and the
    frames at rest are one more row of the design. The covariance of the compliances therefore
    includes the noise of the mean at rest, which is common to all frames. It is a sandwich
    estimator with the long-run covariance of the residuals between coordinates (Newey and West,
    Econometrica 55 (1987) 703), because an error of the clamp's pivot or of the force affects all
    coordinates, and an error of a smoothed force persists for several frames.
    """
    max_steps = 12
    relative_tolerance = 1e-7
    is_measured = np.isfinite(data.displacement)
    measured_displacement = np.where(is_measured, data.displacement, 0.0)
    weight = is_measured.sum(axis=0) + data.rest_weight

    def subtract_offsets(values: Floats) -> Floats:
        """Subtract the offset of each coordinate: (n, 2 markers, k) to (n + 1, 2 markers, k)."""
        values = np.where(is_measured[..., None], values, 0.0)
        offset = values.sum(axis=0) / weight[:, None]
        centred_values = np.where(is_measured[..., None], values - offset, 0.0)
        return np.concatenate([centred_values, -np.sqrt(data.rest_weight) * offset[None]])

    rotations, ones = data.compute_rotations(basis), np.ones(len(basis.knots))
    unit_displacement = data.compute_derivatives(rotations, 0.0 * ones) @ ones
    squared_norm = float((unit_displacement**2).sum())
    if not squared_norm > 0.0:
        raise ValueError(format_sentence("results.no_change_of_moment"))
    mean_compliance = float((unit_displacement * measured_displacement).sum()) / squared_norm
    compliance: Floats = ones * abs(mean_compliance)
    for _ in range(max_steps):
        misfit = measured_displacement - data.compute_displacement(rotations @ compliance)
        residuals = subtract_offsets(misfit[..., None])
        design = subtract_offsets(data.compute_derivatives(rotations, compliance))
        rows = design.reshape(-1, len(ones))
        normal_matrix = rows.T @ rows
        right_side = rows.T @ residuals.ravel() + normal_matrix @ compliance
        solution = _solve_non_negative(normal_matrix, right_side)
        relative_change = float(np.abs(solution - compliance).max() / np.abs(solution).max())
        compliance = solution
        if relative_change < relative_tolerance:
            break
    loaded_residuals, n_coordinates = residuals[:-1, :, 0], int(is_measured.sum())
    sensitivity = np.einsum("kj,nmj->knm", _invert(normal_matrix), design)[:, :-1]
    dof = max(float(n_coordinates) - len(ones) - is_measured.shape[1], 1.0)
    noise = _estimate_long_run_covariance(loaded_residuals, is_measured) * n_coordinates / dof
    covariance = np.einsum("knm,ml,jnl->kj", sensitivity, noise, sensitivity, optimize=True)
    return LawFit(
        basis=basis,
        compliance=compliance,
        covariance=covariance,
        sensitivity=sensitivity,
        residual=float(np.sqrt((loaded_residuals**2).sum() / max(n_coordinates, 1))),
        n_coordinates=n_coordinates,
        noise_variance=float(np.trace(covariance @ normal_matrix)) / len(ones),
    )


def _solve_non_negative(normal_matrix: Floats, right_side: Floats) -> Floats:
    """Solve normal equations for compliances, none of them negative."""
    solution: Floats = _invert(normal_matrix) @ right_side
    if (solution >= 0.0).all():
        return solution
    from scipy.optimize import nnls  # a slow import, which few laws need

    scale = np.sqrt(np.diag(normal_matrix))
    triangle = np.linalg.cholesky(normal_matrix / np.outer(scale, scale))
    return nnls(triangle.T, np.linalg.solve(triangle, right_side / scale))[0] / scale


def _invert(normal_matrix: Floats) -> Floats:
    """Invert a matrix of normal equations, scaled to a unit diagonal."""
    max_condition = 1e12
    scale = np.sqrt(np.diag(normal_matrix))
    scales = np.outer(scale, scale)
    if not (scale > 0.0).all() or np.linalg.cond(normal_matrix / scales) > max_condition:
        raise ValueError(format_sentence("results.law_not_determined", knots=len(scale)))
    return np.asarray(np.linalg.inv(normal_matrix / scales) / scales, dtype=np.float64)


def _estimate_long_run_covariance(residuals: Floats, is_measured: Flags) -> Floats:
    """Estimate the long-run covariance of residuals (n, 2 markers) with Bartlett's weights."""
    n_means = len(residuals)
    max_lag = min(round(4.0 * (n_means / 100.0) ** (2.0 / 9.0)) + 1, n_means // 4)
    weights = is_measured.astype(np.float64)
    covariance = residuals.T @ residuals / np.maximum(weights.T @ weights, 1.0)
    for lag in range(1, max_lag + 1):
        pair_counts = np.maximum(weights[lag:].T @ weights[:-lag], 1.0)
        lagged = residuals[lag:].T @ residuals[:-lag] / pair_counts
        covariance += (1.0 - lag / (max_lag + 1.0)) * (lagged + lagged.T)
    return np.asarray(covariance, dtype=np.float64)


def divide_wire(marker_arc_length: Floats, length: float) -> tuple[Floats, Ints]:
    """Divide a wire into steps between points, among them the clamped end, the markers and the tip.

    Parameters
    ----------
    marker_arc_length : shape (markers,), m, arc lengths of the markers from the clamped end
    length : m, free length of the wire

    Returns
    -------
    points : shape (points,), m, arc lengths from the clamped end to the tip
    marker_points : shape (markers,), indices of the points that are markers
    """
    max_step, rounding = 0.0015, 1e-9  # m
    ends = np.concatenate([[0.0], marker_arc_length, [length]])
    ends = ends[np.concatenate([[True], np.diff(ends) > rounding])]
    step_counts = np.maximum(np.ceil(np.diff(ends) / max_step).astype(np.int64), 1)
    segments = [
        np.linspace(start, stop, step_count, endpoint=False)
        for (start, stop), step_count in zip(pairwise(ends), step_counts, strict=True)
    ]
    points = np.concatenate([*segments, ends[-1:]])
    return points, np.searchsorted(points, marker_arc_length - 0.1 * rounding).astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class LawData:
    """Moments and markers to which a law is fitted.

    Parameters
    ----------
    arc_length : shape (points,), m, points along the wire from the clamped end to the tip
    marker_points : shape (markers,), indices of the points that are markers
    moment : shape (n, points), N m, moments in n means over frames of the loading
    moment_at_rest : shape (points,), N m, moments before the loading
    angle_at_rest : shape (points,), rad, direction of the wire before the loading
    markers : shape (n, markers, 2), m, mean positions in the plane of bending, from the clamped
        end; NaN for a marker without a position, which is ignored
    markers_at_rest : shape (markers, 2), m, mean positions before the loading
    rest_weight : number of frames at rest over number of frames of a mean
    centre_offset : m, distance from the axis to the marker centres, positive towards the pull
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
        """Displacement of the markers from rest, shape (n, 2 markers), m: all x, then all y."""
        displacement = self.markers - self.markers_at_rest
        return np.concatenate([displacement[..., 0], displacement[..., 1]], axis=1)

    def compute_rotations(self, basis: LawBasis) -> Floats:
        """Compute rotations of the wire from rest for a unit compliance at each knot.

        Parameters
        ----------
        basis : basis functions of the law

        Returns
        -------
        Shape (n, points, knots), rad N m^2.
        """
        return self._integrate(basis.compute_curvature_changes(self.moment_at_rest, self.moment))

    def compute_displacement(self, rotation: Floats) -> Floats:
        """Compute the displacement of the markers from rest.

        Parameters
        ----------
        rotation : shape (n, points), rad, rotation of the wire from rest

        Returns
        -------
        Shape (n, 2 markers), m: x of all markers, then y.
        """
        angles = self.angle_at_rest + rotation, self.angle_at_rest[None]
        centres, rest_centres = (self._place_centres(np.cos(a), np.sin(a)) for a in angles)
        return centres - rest_centres

    def compute_derivatives(self, rotations: Floats, compliance: Floats) -> Floats:
        """Compute the derivatives of the displacement with respect to the compliances.

        Parameters
        ----------
        rotations : shape (n, points, knots), rad N m^2, from `compute_rotations`
        compliance : shape (knots,), 1/(N m^2)

        Returns
        -------
        Shape (n, 2 markers, knots), N m^3.
        """
        angle = (self.angle_at_rest + rotations @ compliance)[..., None]
        return self._place_centres(-np.sin(angle) * rotations, np.cos(angle) * rotations)

    def _place_centres(self, dx: Floats, dy: Floats) -> Floats:
        """Integrate tangents (dx, dy) up to the markers, and add the offset along the normals."""
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
    """Basis functions of laws whose compliance d kappa / d M is linear between knots.

    The compliance depends on the magnitude of M alone, and is constant beyond the last knot.

    Parameters
    ----------
    knots : shape (knots,), N m, moments from 0 up
    """

    knots: Floats

    def compute_compliances(self, moment: Floats) -> Floats:
        """Compute the compliance for a unit compliance at each knot, shape (*moment, knots)."""
        hats = np.eye(len(self.knots))
        return np.stack([np.interp(np.abs(moment), self.knots, hat) for hat in hats], axis=-1)

    def compute_curvatures(self, moment: Floats) -> Floats:
        """Compute the curvature for a unit compliance at each knot, N m, shape (*moment, knots).

        The curvature is an odd function of the moment.
        """
        widths, magnitude = np.diff(self.knots), np.abs(moment)
        clipped = np.clip(magnitude, 0.0, self.knots[-1])
        spans = np.clip(clipped[..., None] - self.knots[:-1], 0, widths)
        upper_weights = spans**2 / (2.0 * widths)
        curvatures = np.zeros((*np.shape(magnitude), len(self.knots)))
        curvatures[..., :-1] += spans - upper_weights
        curvatures[..., 1:] += upper_weights
        curvatures[..., -1] += np.maximum(magnitude - self.knots[-1], 0.0)
        return np.asarray(np.sign(moment)[..., None] * curvatures, dtype=np.float64)

    def compute_curvature_changes(self, start_moment: Floats, moment: Floats) -> Floats:
        """Compute curvatures less those at the start, for a unit compliance at each knot.

        Parameters
        ----------
        start_moment : shape (points,), N m, moments at the start, after a first loading from zero
        moment : shape (n, points), N m, later moments

        Returns
        -------
        Shape (n, points, knots), N m.
        """
        changes = self.compute_curvatures(moment) - self.compute_curvatures(start_moment)
        rise = moment - start_moment
        unloads = (rise * start_moment < 0.0) & (np.abs(rise) < 2.0 * np.abs(start_moment))
        changes[unloads] = 2.0 * self.compute_curvatures(0.5 * rise[unloads])
        return changes


def choose_knots(largest_moment: float, count: int) -> LawBasis:
    """Choose knots of a law at moments in proportion to the power 1.6 of their index.

    Knots are denser near zero, because every frame has cross-sections with small moments.

    Parameters
    ----------
    largest_moment : N m, moment of the last knot
    count : number of knots, at least 2

    Returns
    -------
    The basis functions with these knots.
    """
    return LawBasis(largest_moment * (np.arange(count) / (count - 1)) ** 1.6)
