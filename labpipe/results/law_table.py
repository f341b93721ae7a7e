"""The measured moment-curvature law as a table with intervals, and points of all branches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labpipe.messages import sentence
from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import NORMAL_95, Bending, BendingCloud, MeasuredLaw
from labpipe.records.quality import Reason
from labpipe.results.bent_frames import (
    BendingTest,
    FittedFrames,
    StationCurves,
    TipPull,
    curvature_gain,
    curves_at,
)
from labpipe.results.fitted_law import (
    RECTANGLE,
    LawBasis,
    LawFit,
    LawShapes,
    Line,
    Loaded,
    refine_law,
)

N_MEANS = 80
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
    cloud = bending_cloud(test)
    try:
        law = loading_law(test, cloud)
    except ValueError as error:
        return Bending(cloud, None, Reason("no_law", str(error)))
    return Bending(cloud, law)


def loading_law(test: BendingTest, cloud: BendingCloud) -> MeasuredLaw:
    """Fit one law to all frames of the first loading.

    Parameters
    ----------
    test : shapes and force
    cloud : of the test; its noise limits the range of known curvatures

    Returns
    -------
    The law, from about `N_MEANS` means over consecutive frames.

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
    frames = test.frames(branch, per_mean=max(1, count // N_MEANS))
    n_means = len(frames.means.force)
    if n_means < min_points:
        raise ValueError(sentence("results.few_means", count=n_means, needed=min_points))
    loaded = _loaded(test, frames)
    largest, at_rest = loaded.moment.max(), np.abs(loaded.moment_at_rest).max()
    if not largest > at_rest:
        raise ValueError(sentence("results.no_moment", largest=largest, at_rest=at_rest))
    fit, change_with_knots = refine_law(loaded)
    return tabulate(
        fit,
        [change_with_knots, *_Shared(test, frames, loaded, fit).changes()],
        scale_error=test.errors.force_scale,
        noise=test.specimen_at_rest.noise / np.sqrt(frames.means.per_mean),
        curvature_noise=float(np.nanmedian(cloud.noise[cloud.branch == test.first])),
        n_frames=n_means * frames.means.per_mean,
    )


def _loaded(test: BendingTest, frames: FittedFrames) -> Loaded:
    layout, rest = test.layout, test.specimen_at_rest
    line = Line.through(layout.arc_length, layout.length)
    still = curves_at(rest.coefficients, layout.length, line.arc_length)
    return Loaded(
        line=line,
        moment=test.moments(frames.coefficients, frames.means.force, line.arc_length),
        moment_at_rest=test.moments(rest.coefficients, np.zeros(1), line.arc_length)[0],
        angle_at_rest=still.angle[0],
        markers=frames.means.markers[..., :2],
        markers_at_rest=rest.markers[:, :2],
        rest_weight=rest.frames / frames.means.per_mean,
        centre_offset=layout.centre_offset,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Shared:
    """A law, with the errors common to all its frames."""

    test: BendingTest
    frames: FittedFrames
    loaded: Loaded
    fit: LawFit

    def changes(self) -> Iterator[Floats]:
        """Yield standard errors as changes of the compliances."""
        errors, frames = self.test.errors, self.frames
        before = self.movement(self.loaded)

        def change(other: Loaded, share: float = 1.0) -> Floats:
            return share * self.fit.shift(self.movement(other) - before)

        yield change(self.with_moments(reading=frames.means.force + errors.force_zero))
        if errors.other_tension_at_rest is not None:
            pull = replace(self.test.pull, tension_at_rest=errors.other_tension_at_rest)
            yield change(self.with_moments(pull=pull), RECTANGLE)
        if frames.finer is not None:
            yield change(self.with_moments(finer=True), RECTANGLE)
        if errors.offset > 0.0:
            yield change(self.longer_at_the_clamp(errors.offset))
            yield change(self.longer_at_the_tip(errors.offset))
        if errors.centre > 0.0:
            yield change(self.with_centres_farther(errors.centre))

    def movement(self, loaded: Loaded) -> Floats:
        """Return the movement of the markers by the law."""
        return LawShapes.of(loaded, self.fit.basis).movement(self.fit.compliance)

    def with_moments(
        self, *, reading: Floats | None = None, pull: TipPull | None = None, finer: bool = False
    ) -> Loaded:
        """Return the data with another force, pull at the tip, or one more coefficient."""
        test, frames, rest = self.test, self.frames, self.test.specimen_at_rest
        places, no_load = self.loaded.line.arc_length, np.zeros(1)
        reading = frames.means.force if reading is None else reading
        if finer and frames.finer is not None:
            curves, still = frames.finer, rest.finer
        else:
            curves, still = frames.coefficients, rest.coefficients
        return replace(
            self.loaded,
            moment=test.moments(curves, reading, places, pull=pull),
            moment_at_rest=test.moments(still, no_load, places, pull=pull)[0],
        )

    def longer_at_the_clamp(self, more: float) -> Loaded:
        """Return the data with the clamped end farther back."""
        line, frames = self.loaded.line, self.frames
        places = line.arc_length
        first = places[line.markers[0]]
        longer = np.where(places < first, places * (first + more) / first, places + more)
        moment = self.test.moments(frames.coefficients, frames.means.force, longer - more)
        return replace(self.loaded, line=replace(line, arc_length=longer), moment=moment)

    def longer_at_the_tip(self, more: float) -> Loaded:
        """Return the data with the pull point farther along the tangent."""
        length = self.test.layout.length
        tip = curves_at(self.frames.coefficients, length, np.array([length]))
        force = self.test.pull.force(self.frames.means.force, tip.x[:, 0])
        extra = more * (force[:, 1:] * np.cos(tip.angle) - force[:, :1] * np.sin(tip.angle))
        return replace(self.loaded, moment=self.loaded.moment + extra)

    def with_centres_farther(self, more: float) -> Loaded:
        """Return the data with marker centres farther from the axis."""
        test, rest, places = self.test, self.test.specimen_at_rest, self.loaded.line.arc_length
        layout = replace(test.layout, centre_offset=test.layout.centre_offset + more)
        along = curves_at(rest.coefficients, layout.length, np.zeros(1)).angle[0, 0]
        lift = more * np.array([-np.sin(along), np.cos(along), 0.0])
        curves, still = (
            layout.fit(markers + lift).coefficients
            for markers in (self.frames.means.markers, rest.markers[None])
        )
        return replace(
            self.loaded,
            moment=test.moments(curves, self.frames.means.force, places),
            moment_at_rest=test.moments(still, np.zeros(1), places)[0],
            angle_at_rest=curves_at(still, layout.length, places).angle[0],
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


def law_points(
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
    reached = basis.values(fine) @ compliance
    inside = (curvature >= 0.0) & (curvature <= reached[-1] * (1.0 + 1e-12))
    moment = np.where(inside, np.interp(curvature, reached, fine), np.nan)
    finite_moment = np.nan_to_num(moment)
    slopes = basis.slopes(finite_moment)
    with np.errstate(divide="ignore", invalid="ignore"):
        softness = slopes @ compliance
        by_law = -basis.values(finite_moment) / softness[:, None]
        bend = _slope_of_slope(knots, compliance, finite_moment)
        by_slope = -(slopes + bend[:, None] * by_law) / softness[:, None] ** 2
        secant, tangent = moment / curvature, 1.0 / softness
        moment_error = _error(by_law, covariance, scale_error * moment)
        return LawPoints(
            moment=moment,
            secant=secant,
            tangent=np.where(inside, tangent, np.nan),
            moment_error=moment_error,
            secant_error=moment_error / curvature,
            tangent_error=_error(by_slope, covariance, scale_error * tangent),
        )


def _slope_of_slope(knots: Floats, compliance: Floats, moment: Floats) -> Floats:
    """Return the second derivative of curvature by moment, piecewise constant."""
    place = np.clip(np.searchsorted(knots, moment, side="right") - 1, 0, len(knots) - 2)
    return np.asarray((np.diff(compliance) / np.diff(knots))[place], dtype=np.float64)


def _error(gradient: Floats, covariance: Floats, scale: Floats) -> Floats:
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
    largest = float(fit.basis.values(fit.basis.knots[-1:])[0] @ fit.compliance)
    curvature = largest * (np.arange(n_rows) / (n_rows - 1)) ** 2
    points = law_points(
        fit.basis.knots, fit.compliance, covariance, curvature, scale_error=scale_error
    )
    floor = NORMAL_95 * curvature_noise
    is_known = np.asarray(
        (curvature > floor) & (NORMAL_95 * points.moment_error < points.moment), dtype=np.bool_
    )
    return MeasuredLaw(
        curvature=curvature,
        **_with_ends(
            "moment", points.moment, points.moment_error, np.isfinite(points.moment_error)
        ),
        **_with_ends("secant", points.secant, points.secant_error, is_known),
        **_with_ends("tangent", points.tangent, points.tangent_error, is_known),
        is_known=is_known,
        reason=_unknown_reason(curvature, is_known, floor),
        floor=floor,
        scale_error=scale_error,
        residual=fit.residual,
        noise=noise,
        n_frames=n_frames,
        knots=fit.basis.knots,
        compliance=fit.compliance,
        compliance_covariance=covariance,
    )


def _with_ends(name: str, value: Floats, error: Floats, is_shown: Flags) -> dict[str, Floats]:
    """Return a column with the ends of its interval; a moment is kept without its ends."""
    half = NORMAL_95 * np.where(is_shown, error, np.nan)
    middle = value if name == "moment" else np.where(is_shown, value, np.nan)
    return {name: middle, f"{name}_lower": middle - half, f"{name}_upper": middle + half}


def _unknown_reason(curvature: Floats, is_known: Flags, floor: float) -> Reason | None:
    unknown, count = curvature[1:][~is_known[1:]], len(curvature) - 1
    if not len(unknown):
        return None
    last = unknown.max()
    return Reason.of(
        "results.law_below_noise", unknown=len(unknown), count=count, last=last, floor=floor
    )


def bending_cloud(test: BendingTest) -> BendingCloud:
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
    frames = test.frames(test.branch, per_mean=max(1, count // N_CLOUD_ROWS))
    length, rest, means = test.layout.length, test.specimen_at_rest, frames.means
    places = np.linspace(0.0, length, N_CLOUD_STATIONS)
    now = curves_at(frames.coefficients, length, places)
    curvature = now.curvature - curves_at(rest.coefficients, length, places).curvature
    moment = test.moments(frames.coefficients, means.force, places)
    at_rest = test.moments(rest.coefficients, np.zeros(1), places)[0]
    share = np.sqrt(1.0 / means.per_mean + 1.0 / rest.frames)
    gain = curvature_gain(test.layout, means.markers, now, places)
    return BendingCloud(
        time=means.time,
        branch=means.branch,
        cycle=test.cycle[np.searchsorted(test.shape.time, means.time)],
        force=means.force,
        arc_length=places,
        curvature=curvature,
        curvature_error=rest.noise * share * gain,
        curvature_systematic=_systematic(test, frames, places, curvature),
        moment=moment - at_rest,
        moment_error=_moment_errors(test, frames, now, moment - at_rest),
        moment_at_rest=at_rest,
        frames_per_mean=means.per_mean,
    )


def _systematic(
    test: BendingTest, frames: FittedFrames, places: Floats, curvature: Floats
) -> Floats:
    """Return the absolute change of the curvatures with one more coefficient."""
    if frames.finer is None:
        return np.full(curvature.shape, np.nan)
    finer = curves_at(frames.finer, test.layout.length, places).curvature
    still = curves_at(test.specimen_at_rest.finer, test.layout.length, places).curvature
    return np.asarray(np.abs(finer - still - curvature), dtype=np.float64)


def _moment_errors(
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
