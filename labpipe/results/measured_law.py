"""Fit the moment-curvature law to the shapes of a first loading, and tabulate it.

The shapes that follow from a law are compared with the markers. Nothing is differentiated, so that
curvatures are much more accurate than those of single frames.

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

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import NORMAL_95, Bending, BendingCloud, MeasuredLaw
from labpipe.records.quality import Reason
from labpipe.results.bent_frames import (
    BendingTest,
    FittedFrames,
    StationCurves,
    TipPull,
    compute_curvature_gain,
    evaluate_curves,
)

N_FIT_MEANS = 80
"""Means over consecutive frames for the fit of the first loading."""
N_CLOUD_ROWS = 50
"""Rows of the cloud in the first loading."""
N_CLOUD_STATIONS = 17
"""Places along the specimen."""


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
        If fewer than two frames at rest show all markers, or no mean has shape and force.
    """
    cloud = measure_cloud(test)
    try:
        law = fit_loading_law(test, cloud)
    except ValueError as error:
        return Bending(cloud, None, Reason("no_law", str(error)))
    return Bending(cloud, law)


def fit_loading_law(test: BendingTest, cloud: BendingCloud) -> MeasuredLaw:
    """Fit one law to all frames of the first loading.

    Parameters
    ----------
    test : shapes and force
    cloud : of the test; its noise limits the range of known curvatures

    Returns
    -------
    The law, from about `N_FIT_MEANS` means over consecutive frames.

    Raises
    ------
    ValueError
        If the first loading has too few means, or they do not determine the law.

    Notes
    -----
    Moments are those of the fitted shapes. Changes of the compliances from causes common to all
    frames (zero of the force, a tension at rest removed by the zero, ends of the specimen, moments
    of shapes with one more coefficient) are computed to first order and added as independent
    errors; an equally probable alternative counts as a rectangle, 1 / sqrt(3) of the change. So
    does a law with half as many knots.
    """
    min_points = 24
    count = int((test.branch == test.first).sum())
    branch = np.where(test.branch == test.first, test.branch, -1)
    frames = test.fit_means(branch, per_mean=max(1, count // N_FIT_MEANS))
    n_means = len(frames.means.force)
    if n_means < min_points:
        raise ValueError(format_sentence("results.few_means", count=n_means, needed=min_points))
    loaded = _collect_law_data(test, frames)
    largest, at_rest = loaded.moment.max(), np.abs(loaded.moment_at_rest).max()
    if not largest > at_rest:
        raise ValueError(format_sentence("results.no_moment", largest=largest, at_rest=at_rest))
    fit, change_with_knots = refine_law(loaded)
    return tabulate(
        fit,
        [change_with_knots, *_CommonErrors(test, frames, loaded, fit).list_changes()],
        scale_error=test.errors.force_scale,
        noise=test.specimen_at_rest.noise / np.sqrt(frames.means.per_mean),
        curvature_noise=float(np.nanmedian(cloud.noise[cloud.branch == test.first])),
        n_frames=n_means * frames.means.per_mean,
    )


def _collect_law_data(test: BendingTest, frames: FittedFrames) -> LawData:
    layout, at_rest = test.layout, test.specimen_at_rest
    line = Line.through(layout.arc_length, layout.length)
    still = evaluate_curves(at_rest.coefficients, layout.length, line.arc_length)
    return LawData(
        line=line,
        moment=test.compute_moments(frames.coefficients, frames.means.force, line.arc_length),
        moment_at_rest=test.compute_moments(at_rest.coefficients, np.zeros(1), line.arc_length)[0],
        angle_at_rest=still.angle[0],
        markers=frames.means.markers[..., :2],
        markers_at_rest=at_rest.markers[:, :2],
        rest_weight=at_rest.frames / frames.means.per_mean,
        centre_offset=layout.centre_offset,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _CommonErrors:
    """A law, with the errors common to all its frames."""

    test: BendingTest
    frames: FittedFrames
    loaded: LawData
    fit: LawFit

    def list_changes(self) -> Iterator[Floats]:
        """Yield standard errors as changes of the compliances."""
        errors, frames = self.test.errors, self.frames
        before = self.compute_movement(self.loaded)

        def change(other: LawData, share: float = 1.0) -> Floats:
            return share * self.fit.shift(self.compute_movement(other) - before)

        yield change(self.recompute_moments(reading=frames.means.force + errors.force_zero))
        if errors.other_tension_at_rest is not None:
            pull = replace(self.test.pull, tension_at_rest=errors.other_tension_at_rest)
            yield change(self.recompute_moments(pull=pull), RECTANGULAR_DEVIATION)
        if frames.finer is not None:
            yield change(self.recompute_moments(finer=True), RECTANGULAR_DEVIATION)
        if errors.offset > 0.0:
            yield change(self.lengthen_at_clamp(errors.offset))
            yield change(self.lengthen_at_tip(errors.offset))
        if errors.centre > 0.0:
            yield change(self.move_centres(errors.centre))

    def compute_movement(self, loaded: LawData) -> Floats:
        """Return the movement of the markers by the law."""
        return LawShapes.of(loaded, self.fit.basis).compute_movement(self.fit.compliance)

    def recompute_moments(
        self, *, reading: Floats | None = None, pull: TipPull | None = None, finer: bool = False
    ) -> LawData:
        """Return the data with another force, pull at the tip, or one more coefficient."""
        test, frames, at_rest = self.test, self.frames, self.test.specimen_at_rest
        places, no_load = self.loaded.line.arc_length, np.zeros(1)
        reading = frames.means.force if reading is None else reading
        if finer and frames.finer is not None:
            curves, still = frames.finer, at_rest.finer
        else:
            curves, still = frames.coefficients, at_rest.coefficients
        return replace(
            self.loaded,
            moment=test.compute_moments(curves, reading, places, pull=pull),
            moment_at_rest=test.compute_moments(still, no_load, places, pull=pull)[0],
        )

    def lengthen_at_clamp(self, more: float) -> LawData:
        """Return the data with the clamped end farther back."""
        line, frames = self.loaded.line, self.frames
        places = line.arc_length
        first = places[line.markers[0]]
        longer = np.where(places < first, places * (first + more) / first, places + more)
        moment = self.test.compute_moments(frames.coefficients, frames.means.force, longer - more)
        return replace(self.loaded, line=replace(line, arc_length=longer), moment=moment)

    def lengthen_at_tip(self, more: float) -> LawData:
        """Return the data with the pull point farther along the tangent."""
        length = self.test.layout.length
        tip = evaluate_curves(self.frames.coefficients, length, np.array([length]))
        force = self.test.pull.compute_force(self.frames.means.force, tip.x[:, 0])
        extra = more * (force[:, 1:] * np.cos(tip.angle) - force[:, :1] * np.sin(tip.angle))
        return replace(self.loaded, moment=self.loaded.moment + extra)

    def move_centres(self, more: float) -> LawData:
        """Return the data with marker centres farther from the axis."""
        test, at_rest, places = self.test, self.test.specimen_at_rest, self.loaded.line.arc_length
        layout = replace(test.layout, centre_offset=test.layout.centre_offset + more)
        along = evaluate_curves(at_rest.coefficients, layout.length, np.zeros(1)).angle[0, 0]
        lift = more * np.array([-np.sin(along), np.cos(along), 0.0])
        curves, still = (
            layout.fit(markers + lift).coefficients
            for markers in (self.frames.means.markers, at_rest.markers[None])
        )
        return replace(
            self.loaded,
            moment=test.compute_moments(curves, self.frames.means.force, places),
            moment_at_rest=test.compute_moments(still, np.zeros(1), places)[0],
            angle_at_rest=evaluate_curves(still, layout.length, places).angle[0],
            centre_offset=layout.centre_offset,
        )


@dataclass(frozen=True, slots=True, eq=False)
class LawPoints:
    """A law at curvatures; arrays of shape (n,).

    Parameters
    ----------
    moment, secant, tangent : N m, N m^2, N m^2; NaN beyond the largest curvature measured
    moment_error, secant_error, tangent_error : standard errors
    """

    moment: Floats
    secant: Floats
    tangent: Floats
    moment_error: Floats
    secant_error: Floats
    tangent_error: Floats


def evaluate_law(
    knots: Floats, compliance: Floats, covariance: Floats, curvature: Floats, *, scale_error: float
) -> LawPoints:
    """Evaluate a law at curvatures.

    Parameters
    ----------
    knots, compliance, covariance : of a `MeasuredLaw`
    curvature : shape (n,), 1/m, none negative
    scale_error : standard uncertainty of the scale of the force, as a share

    Returns
    -------
    Moments and stiffnesses, without extrapolation. For zero compliance, errors are infinite.

    Notes
    -----
    At a given curvature kappa = k(M) an error dk of the law moves the moment by -dk / k'(M); the
    scale of the force changes all moments in proportion.
    """
    n_fine = 4000
    basis = LawBasis(knots)
    fine = np.linspace(0.0, knots[-1], n_fine)
    reached = basis.compute_values(fine) @ compliance
    inside = (curvature >= 0.0) & (curvature <= reached[-1] * (1.0 + 1e-12))
    moment = np.where(inside, np.interp(curvature, reached, fine), np.nan)
    finite_moment = np.nan_to_num(moment)
    slopes = basis.compute_slopes(finite_moment)
    with np.errstate(divide="ignore", invalid="ignore"):
        softness = slopes @ compliance
        by_law = -basis.compute_values(finite_moment) / softness[:, None]
        bend = _second_derivative(knots, compliance, finite_moment)
        by_slope = -(slopes + bend[:, None] * by_law) / softness[:, None] ** 2
        secant, tangent = moment / curvature, 1.0 / softness
        moment_error = _propagate(by_law, covariance, scale_error * moment)
        return LawPoints(
            moment=moment,
            secant=secant,
            tangent=np.where(inside, tangent, np.nan),
            moment_error=moment_error,
            secant_error=moment_error / curvature,
            tangent_error=_propagate(by_slope, covariance, scale_error * tangent),
        )


def _second_derivative(knots: Floats, compliance: Floats, moment: Floats) -> Floats:
    """Return the second derivative of curvature by moment, piecewise constant."""
    place = np.clip(np.searchsorted(knots, moment, side="right") - 1, 0, len(knots) - 2)
    return np.asarray((np.diff(compliance) / np.diff(knots))[place], dtype=np.float64)


def _propagate(gradient: Floats, covariance: Floats, scale: Floats) -> Floats:
    squares = np.einsum("nk,kj,nj->n", gradient, covariance, gradient)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0) + scale**2), dtype=np.float64)


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
    curvature_noise : 1/m, standard error of the cloud's curvatures
    n_frames : number of frames used

    Returns
    -------
    The law.

    Notes
    -----
    A curvature is known if it is above 1.96 times the noise of the curvatures of the cloud, and if
    the interval of the law excludes a moment of zero.
    """
    n_rows = 41
    covariance = fit.covariance + sum(np.outer(change, change) for change in common)
    largest = float(fit.basis.compute_values(fit.basis.knots[-1:])[0] @ fit.compliance)
    curvature = largest * (np.arange(n_rows) / (n_rows - 1)) ** 2
    points = evaluate_law(
        fit.basis.knots, fit.compliance, covariance, curvature, scale_error=scale_error
    )
    floor = NORMAL_95 * curvature_noise
    is_known = np.asarray(
        (curvature > floor) & (NORMAL_95 * points.moment_error < points.moment), dtype=np.bool_
    )
    return MeasuredLaw(
        curvature=curvature,
        **_make_columns(
            "moment", points.moment, points.moment_error, np.isfinite(points.moment_error)
        ),
        **_make_columns("secant", points.secant, points.secant_error, is_known),
        **_make_columns("tangent", points.tangent, points.tangent_error, is_known),
        is_known=is_known,
        reason=_explain_unknown(curvature, is_known, floor),
        floor=floor,
        scale_error=scale_error,
        residual=fit.residual,
        noise=noise,
        n_frames=n_frames,
        knots=fit.basis.knots,
        compliance=fit.compliance,
        compliance_covariance=covariance,
    )


def _make_columns(name: str, value: Floats, error: Floats, is_shown: Flags) -> dict[str, Floats]:
    """Return a column with the ends of its interval; a moment is kept without its ends."""
    half = NORMAL_95 * np.where(is_shown, error, np.nan)
    middle = value if name == "moment" else np.where(is_shown, value, np.nan)
    return {name: middle, f"{name}_lower": middle - half, f"{name}_upper": middle + half}


def _explain_unknown(curvature: Floats, is_known: Flags, floor: float) -> Reason | None:
    unknown, count = curvature[1:][~is_known[1:]], len(curvature) - 1
    if not len(unknown):
        return None
    last = unknown.max()
    return Reason.of(
        "results.law_below_noise", unknown=len(unknown), count=count, last=last, floor=floor
    )


def measure_cloud(test: BendingTest) -> BendingCloud:
    """Compute curvature and moment, less those at rest.

    Parameters
    ----------
    test : shapes and force

    Returns
    -------
    One row per mean over consecutive frames of a branch: about `N_CLOUD_ROWS` in the first loading,
    over as many frames in the other branches. A mean without shape or force is left out.

    Raises
    ------
    ValueError
        If fewer than two frames at rest show all markers, or no mean has shape and force.

    Notes
    -----
    M(s) = Py (x_L - x(s)) - Px (y_L - y(s)), the force of `TipPull` at the tip (x_L, y_L). Errors
    of the curvature from the noise of the markers take it to be independent from frame to frame.
    """
    count = int((test.branch == test.first).sum())
    frames = test.fit_means(test.branch, per_mean=max(1, count // N_CLOUD_ROWS))
    length, rest, means = test.layout.length, test.specimen_at_rest, frames.means
    places = np.linspace(0.0, length, N_CLOUD_STATIONS)
    now = evaluate_curves(frames.coefficients, length, places)
    curvature = now.curvature - evaluate_curves(rest.coefficients, length, places).curvature
    moment = test.compute_moments(frames.coefficients, means.force, places)
    at_rest = test.compute_moments(rest.coefficients, np.zeros(1), places)[0]
    share = np.sqrt(1.0 / means.per_mean + 1.0 / rest.frames)
    gain = compute_curvature_gain(test.layout, means.markers, now, places)
    return BendingCloud(
        time=means.time,
        branch=means.branch,
        cycle=test.cycle[np.searchsorted(test.shape.time, means.time)],
        force=means.force,
        arc_length=places,
        curvature=curvature,
        curvature_error=rest.noise * share * gain,
        curvature_systematic=_change_with_one_more_coefficient(test, frames, places, curvature),
        moment=moment - at_rest,
        moment_error=_compute_moment_errors(test, frames, now, moment - at_rest),
        moment_at_rest=at_rest,
        frames_per_mean=means.per_mean,
    )


def _change_with_one_more_coefficient(
    test: BendingTest, frames: FittedFrames, places: Floats, curvature: Floats
) -> Floats:
    """Return the absolute change of the curvatures with one more coefficient."""
    if frames.finer is None:
        return np.full(curvature.shape, np.nan)
    finer = evaluate_curves(frames.finer, test.layout.length, places).curvature
    still = evaluate_curves(test.specimen_at_rest.finer, test.layout.length, places).curvature
    return np.asarray(np.abs(finer - still - curvature), dtype=np.float64)


def _compute_moment_errors(
    test: BendingTest, frames: FittedFrames, now: StationCurves, moment: Floats
) -> Floats:
    """Return standard errors of moments, shape (n, stations), N m."""
    errors, means = test.errors, frames.means
    lever = now.x[:, -1:] - now.x
    push = np.hypot(errors.force_zero, errors.force_noise / np.sqrt(means.per_mean))
    noise = test.specimen_at_rest.noise * frames.tip_gain / np.sqrt(means.per_mean)
    # With markers farther from the axis, the lever is shorter by the angle of the tip.
    centre = errors.centre * np.sin(now.angle[:, -1])
    place = np.hypot(np.hypot(errors.offset, centre), noise) * means.force
    squares = (push * lever) ** 2 + (errors.force_scale * moment) ** 2 + place[:, None] ** 2
    return np.asarray(np.sqrt(squares), dtype=np.float64)


RECTANGULAR_DEVIATION = 1.0 / np.sqrt(3.0)
"""Standard deviation of a rectangular distribution of half-width one."""


@dataclass(frozen=True, slots=True, eq=False)
class LawFit:
    """A law, and its dependence on the markers.

    Parameters
    ----------
    basis : of the law
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
    """Fit a law with as many knots as the markers determine.

    Parameters
    ----------
    loaded : moments, markers and rest

    Returns
    -------
    The law, and the standard error of its compliances from the number of knots, fully correlated:
    shape (knots,), the change with half as many knots.

    Raises
    ------
    ValueError
        As `fit_law`.

    Notes
    -----
    Thirteen knots describe a smooth law to 0.1 % of its moment. A wire whose strands all slip at
    once has a law with a kink: the number is doubled if that reduces the sum of squares by more
    than log n times the variance of the noise for each added knot (Schwarz, Ann. Stat. 6 (1978)
    461).
    """
    # Each level has all the knots of the one before.
    level_knots = (7, 13, 25)
    largest = float(loaded.moment.max())
    coarse, fit, fine = (fit_law(loaded, choose_knots(largest, count)) for count in level_knots)
    better = fine.n * (fit.residual**2 - fine.residual**2)
    if better > fine.variance * np.log(fine.n) * (level_knots[2] - level_knots[1]):
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
    Gauss-Newton; the inner step is non-negative least squares (Lawson and Hanson, Solving Least
    Squares Problems, 1974, chapter 23) if the unconstrained one is negative. Every marker
    coordinate has its own offset, known from the frames at rest: so the noise of the mean at rest,
    common to all frames, is in the covariance. That is a sandwich estimator with the long-run
    covariance of the residuals between coordinates (Newey and West, Econometrica 55 (1987) 703):
    the pivot of the clamp and the force move all of them, and a smoothed force for several frames.
    """
    max_rounds = 12
    convergence_share = 1e-7
    is_measured = np.isfinite(loaded.moved)
    measured = np.where(is_measured, loaded.moved, 0.0)
    shapes = LawShapes.of(loaded, basis)
    compliance = _estimate_uniform_compliance(shapes, measured)
    for _ in range(max_rounds):
        moved, design = shapes.predict(compliance)
        residuals = _subtract_offsets(
            np.where(is_measured, measured - moved, 0.0)[..., None], is_measured, loaded.rest_weight
        )
        design = _subtract_offsets(
            np.where(is_measured[..., None], design, 0.0), is_measured, loaded.rest_weight
        )
        flat, residual = design.reshape(-1, design.shape[2]), residuals.ravel()
        normal = flat.T @ flat
        better = _solve(normal, flat.T @ residual + normal @ compliance)
        change = float(np.abs(better - compliance).max() / np.abs(better).max())
        compliance = better
        if change < convergence_share:
            break
    spread = _inverse(normal)
    pushes = np.einsum("kj,nmj->knm", spread, design)
    covariance = _estimate_covariance(pushes[:, :-1], residuals[:-1, :, 0], is_measured)
    return LawFit(
        basis=basis,
        compliance=compliance,
        covariance=covariance,
        sensitivity=pushes[:, :-1],
        residual=float(np.sqrt((residuals[:-1] ** 2).sum() / max(int(is_measured.sum()), 1))),
        n=int(is_measured.sum()),
        variance=float(np.trace(covariance @ normal)) / len(compliance),
    )


def _estimate_uniform_compliance(shapes: LawShapes, measured: Floats) -> Floats:
    """Return one compliance for all knots with about the observed movement of the markers."""
    unit_compliance = np.ones(shapes.turns.shape[2])
    moved = shapes.predict(0.0 * unit_compliance)[1] @ unit_compliance
    scale = float((moved**2).sum())
    if not scale > 0.0:
        raise ValueError(format_sentence("results.no_change_of_moment"))
    return np.asarray(
        unit_compliance * abs(float((moved * measured).sum())) / scale, dtype=np.float64
    )


def _subtract_offsets(values: Floats, seen: Flags, rest_weight: float) -> Floats:
    """Subtract the offset of each marker coordinate; an additional last row is the rest.

    Values and result of shape (n, 2 markers, k) and (n + 1, 2 markers, k).
    """
    offset = values.sum(axis=0) / (seen.sum(axis=0) + rest_weight)[:, None]
    centred = np.where(seen[..., None], values - offset, 0.0)
    return np.concatenate([centred, -np.sqrt(rest_weight) * offset[None]])


def _solve(normal: Floats, right: Floats) -> Floats:
    """Solve for compliances, none of them negative."""
    scale = np.sqrt(np.diag(normal))
    inverse = _inverse(normal)
    plain: Floats = inverse @ right
    if (plain >= 0.0).all():
        return plain
    from scipy.optimize import nnls  # slow import, not for all tests

    triangle = np.linalg.cholesky(normal / np.outer(scale, scale))
    return nnls(triangle.T, np.linalg.solve(triangle, right / scale))[0] / scale


def _inverse(normal: Floats) -> Floats:
    max_condition = 1e12
    scale = np.sqrt(np.diag(normal))
    if not (scale > 0.0).all() or np.linalg.cond(normal / np.outer(scale, scale)) > max_condition:
        raise ValueError(format_sentence("results.law_not_determined", knots=len(scale)))
    inverse = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.asarray(inverse, dtype=np.float64)


def _estimate_covariance(pushes: Floats, residuals: Floats, seen: Flags) -> Floats:
    """Return the covariance of the compliances from residuals of shape (n, 2 markers)."""
    freedom = max(float(seen.sum()) - len(pushes) - seen.shape[1], 1.0)
    covariance = _estimate_long_run_covariance(residuals, seen) * float(seen.sum()) / freedom
    middle = np.einsum("knm,ml,jnl->kj", pushes, covariance, pushes, optimize=True)
    return np.asarray(middle, dtype=np.float64)


def _estimate_long_run_covariance(residuals: Floats, seen: Flags) -> Floats:
    """Return the long-run covariance between columns of residuals, with Bartlett's weights."""
    count = len(residuals)
    lags = min(round(4.0 * (count / 100.0) ** (2.0 / 9.0)) + 1, count // 4)
    weights = seen.astype(np.float64)
    total = residuals.T @ residuals / np.maximum(weights.T @ weights, 1.0)
    for lag in range(1, lags + 1):
        together = np.maximum(weights[lag:].T @ weights[:-lag], 1.0)
        later = residuals[lag:].T @ residuals[:-lag] / together
        total += (1.0 - lag / (lags + 1.0)) * (later + later.T)
    return np.asarray(total, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """Points along the wire for the integration of its shape.

    Parameters
    ----------
    arc_length : shape (points,), m, from the clamped end to the tip
    markers : shape (markers,), which of them are markers
    """

    arc_length: Floats
    markers: Ints

    @classmethod
    def through(cls, places: Floats, length: float) -> Line:
        """Divide a wire finely, with points at the markers and at the tip."""
        max_step = 0.0015  # m
        ends = np.concatenate([[0.0], places, [length]])
        ends = ends[np.concatenate([[True], np.diff(ends) > 1e-9])]
        counts = np.maximum(np.ceil(np.diff(ends) / max_step).astype(np.int64), 1)
        parts = [
            np.linspace(first, last, count, endpoint=False)
            for first, last, count in zip(ends[:-1], ends[1:], counts, strict=True)
        ]
        points = np.concatenate([*parts, ends[-1:]])
        return cls(points, np.searchsorted(points, places - 1e-10).astype(np.int64))

    def integrate(self, values: Floats) -> Floats:
        """Integrate values (n, points, ...) from the clamped end by trapezoids."""
        steps = np.diff(self.arc_length).reshape(-1, *(1,) * (values.ndim - 2))
        integral = np.zeros_like(values)
        np.cumsum(steps * (values[:, 1:] + values[:, :-1]) / 2.0, axis=1, out=integral[:, 1:])
        return integral


@dataclass(frozen=True, slots=True, eq=False)
class LawData:
    """Data for the fit of a law.

    Parameters
    ----------
    line : points along the wire
    moment : shape (n, points), N m, of the loaded frames
    moment_at_rest : shape (points,), N m
    angle_at_rest : shape (points,), rad
    markers : shape (n, markers, 2), m, in the plane of bending, from the clamped end; NaN are
        ignored
    markers_at_rest : shape (markers, 2), m
    rest_weight : frames of the rest over frames of a mean
    centre_offset : m, axis to marker centre
    """

    line: Line
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
        moved = self.markers - self.markers_at_rest
        return np.concatenate([moved[..., 0], moved[..., 1]], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class LawShapes:
    """Shapes for laws of one basis, with all that is independent of the compliances.

    Parameters
    ----------
    loaded : moments and rest
    turns : shape (n, points, knots), rad, of the wire from rest, per unit of compliance
    still : shape (1, 2 markers), m, marker centres at rest: x of all, then y
    """

    loaded: LawData
    turns: Floats
    still: Floats

    @classmethod
    def of(cls, loaded: LawData, basis: LawBasis) -> LawShapes:
        """Prepare the laws of a basis."""
        turns = loaded.line.integrate(basis.compute_changes(loaded.moment_at_rest, loaded.moment))
        begin = loaded.angle_at_rest[None]
        return cls(loaded, turns, _compute_centres(loaded, np.sin(begin), np.cos(begin)))

    def compute_movement(self, compliance: Floats) -> Floats:
        """Return the movement of the markers from rest for a law, shape (n, 2 markers), m."""
        return _compute_centres(self.loaded, *self._directions(compliance)) - self.still

    def predict(self, compliance: Floats) -> tuple[Floats, Floats]:
        """Return the movement of the markers from rest for a law, and its derivatives.

        Parameters
        ----------
        compliance : shape (knots,), 1/(N m^2)

        Returns
        -------
        Movement, shape (n, 2 markers), m, and its derivatives, shape (n, 2 markers, knots).
        """
        line, height, turns = self.loaded.line, self.loaded.centre_offset, self.turns
        sine, cosine = self._directions(compliance)
        moved = _compute_centres(self.loaded, sine, cosine) - self.still
        along = -line.integrate(sine[..., None] * turns)
        across = line.integrate(cosine[..., None] * turns)
        markers = line.markers
        along = along[:, markers] - height * cosine[:, markers, None] * turns[:, markers]
        across = across[:, markers] - height * sine[:, markers, None] * turns[:, markers]
        return moved, np.concatenate([along, across], axis=1)

    def _directions(self, compliance: Floats) -> tuple[Floats, Floats]:
        """Return sine and cosine of the angle of the wire, shape (n, points) each."""
        angle = self.loaded.angle_at_rest + self.turns @ compliance
        return np.sin(angle), np.cos(angle)


def _compute_centres(loaded: LawData, sine: Floats, cosine: Floats) -> Floats:
    """Return the marker centres, shape (n, 2 markers): x of all, then y."""
    line, height = loaded.line, loaded.centre_offset
    markers = line.markers
    x = line.integrate(cosine)[:, markers] - height * sine[:, markers]
    y = line.integrate(sine)[:, markers] + height * cosine[:, markers]
    return np.concatenate([x, y], axis=1)


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
        size = np.clip(np.abs(moment), 0.0, self.knots[-1])
        place = np.searchsorted(self.knots, size, side="right") - 1
        place = np.clip(place, 0, len(self.knots) - 2)
        share = (size - self.knots[place]) / np.diff(self.knots)[place]
        slopes = np.zeros((*np.shape(size), len(self.knots)))
        np.put_along_axis(slopes, place[..., None], (1.0 - share)[..., None], axis=-1)
        np.put_along_axis(slopes, place[..., None] + 1, share[..., None], axis=-1)
        return slopes

    def compute_values(self, moment: Floats) -> Floats:
        """Return the curvature per unit of compliance at each knot, odd; (*moment, knots)."""
        widths, size = np.diff(self.knots), np.abs(moment)
        inside = np.clip(np.clip(size, 0.0, self.knots[-1])[..., None] - self.knots[:-1], 0, widths)
        rising = inside**2 / (2.0 * widths)
        values = np.zeros((*np.shape(size), len(self.knots)))
        values[..., :-1] += inside - rising
        values[..., 1:] += rising
        values[..., -1] += np.maximum(size - self.knots[-1], 0.0)
        return np.asarray(np.sign(moment)[..., None] * values, dtype=np.float64)

    def compute_changes(self, rest: Floats, moment: Floats) -> Floats:
        """Return the change of curvature from a rest after first loading, per unit of compliance.

        Parameters
        ----------
        rest : shape (points,), N m
        moment : shape (n, points), N m

        Returns
        -------
        shape (n, points, knots).
        """
        plain = self.compute_values(moment) - self.compute_values(rest)
        moment_change = moment - rest
        turned = (moment_change * rest < 0.0) & (np.abs(moment_change) < 2.0 * np.abs(rest))
        plain[turned] = 2.0 * self.compute_values(0.5 * moment_change[turned])
        return plain


def choose_knots(largest: float, count: int) -> LawBasis:
    """Choose knots, denser near zero, where every frame has a part of its wire.

    Parameters
    ----------
    largest : N m, the largest moment
    count : of knots, at least 2
    """
    return LawBasis(largest * (np.arange(count) / (count - 1)) ** 1.6)
