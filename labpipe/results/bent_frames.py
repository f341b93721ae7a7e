"""Compute curvature and bending moment along the specimen, from its shape and the tip force.

Markers give the shape and the force gives the moment; no stiffness is assumed. The frame is that of
the specimen: x along its undeformed axis from the clamped end, y in the plane of bending towards
the pull.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from labpipe.markers.curve_fits import (
    EndConditions,
    FrameFits,
    build_curve_basis,
    build_marker_design,
    compute_power_slopes,
    compute_powers,
    fit_frames,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import PointFlag, Shape


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
        shape (n, 2), N, along x and y; NaN if the tip is farther than the string is long.

        Notes
        -----
        The load cell is above the tip at rest, so the string leans towards the anchor as the tip
        moves inward: sin(beta) = (anchor - x) / string.
        """
        tension = reading + self.tension_at_rest
        lean = np.zeros_like(tip) if self.string is None else (self.anchor - tip) / self.string
        across = tension * np.sqrt(np.where(np.abs(lean) <= 1.0, 1.0 - lean**2, np.nan))
        across -= self.weight
        return np.stack([tension * lean, across], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class MeanFrames:
    """Means over consecutive frames, each of one branch.

    Parameters
    ----------
    time, force : shape (n,), s, N
    branch : shape (n,)
    markers : shape (n, markers, 3), m, from the clamped end; NaN if a marker was not measured in
        every frame of the mean
    per_mean : frames
    """

    time: Floats
    force: Floats
    branch: Ints
    markers: Floats
    per_mean: int

    def select(self, chosen: Flags) -> MeanFrames:
        """Select means by a mask of shape (n,)."""
        return MeanFrames(
            self.time[chosen],
            self.force[chosen],
            self.branch[chosen],
            self.markers[chosen],
            self.per_mean,
        )


@dataclass(frozen=True, slots=True, eq=False)
class MarkerLayout:
    """Places of the markers along the specimen, and end conditions of its curve.

    Parameters
    ----------
    arc_length : shape (markers,), m, from the clamped end
    centre_offset : m, axis to marker centre, positive towards the pull
    ends : conditions of the curve at its ends
    terms : coefficients per coordinate
    """

    arc_length: Floats
    centre_offset: float
    ends: EndConditions
    terms: int

    @property
    def length(self) -> float:
        """Return the arc length of the tip, m."""
        return self.ends.length

    def fit(self, markers: Floats, *, more: int = 0) -> FrameFits:
        """Fit the curve through markers of shape (n, markers, 3), with `more` coefficients."""
        return fit_frames(
            markers, self.arc_length, self.centre_offset, self.ends, terms=self.terms + more
        )


def find_marker_layout(shape: Shape, *, centre_offset: float, free_tip: bool) -> MarkerLayout:
    """Return the layout that a shape was fitted with.

    Parameters
    ----------
    shape : with a clamped end and fitted curves
    centre_offset : m, of its fit
    free_tip : whether its curve has no moment at the last point

    Returns
    -------
    The layout.

    Raises
    ------
    ValueError
        If no frame has a curve.
    """
    fitted_frames = np.flatnonzero(np.isfinite(shape.coefficients).all(axis=(1, 2)))
    if not len(fitted_frames):
        raise ValueError(format_sentence("results.no_fitted_frame"))
    direction = shape.coefficients[fitted_frames[0], :, 1] / shape.length
    ends = EndConditions(length=shape.length, direction=direction, free_tip=free_tip)
    places = shape.arc_length[_flag_markers(shape)]
    return MarkerLayout(places, centre_offset, ends, int(shape.coefficients.shape[2]))


def average_frames(shape: Shape, force: Floats, branch: Ints, *, per_mean: int) -> MeanFrames:
    """Average consecutive frames of a branch.

    Parameters
    ----------
    shape : with marker positions, averaged if measured in every frame of a mean
    force : shape (frames,), N; a mean with NaN is NaN
    branch : shape (frames,); frames of a negative branch are excluded
    per_mean : frames; the remainder at the end of a branch is excluded

    Returns
    -------
    The means, in order of time.
    """
    starts = _find_group_starts(branch, per_mean)
    rows = starts[:, None] + np.arange(per_mean)
    points = rows[..., None], np.flatnonzero(_flag_markers(shape))
    measured = np.isin(shape.flags[points], (PointFlag.MEASURED, PointFlag.RELABELLED))
    positions = np.where(measured[..., None], shape.positions[points], np.nan)
    return MeanFrames(
        time=shape.time[rows].mean(axis=1),
        force=force[rows].mean(axis=1),
        branch=branch[starts],
        markers=positions.mean(axis=1),
        per_mean=per_mean,
    )


def _find_group_starts(branch: Ints, per_mean: int) -> Ints:
    """Return the first frames of complete groups of frames within one branch each."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(branch)) + 1, [len(branch)]])
    groups = [
        np.arange(first, last - per_mean + 1, per_mean)
        for first, last in pairwise(edges)
        if branch[first] >= 0
    ]
    return np.concatenate(groups) if groups else np.zeros(0, dtype=np.int64)


def _flag_markers(shape: Shape) -> Flags:
    """Flag the points of a shape that are markers, not constructed: shape (points,)."""
    return np.asarray(~(shape.flags == PointFlag.CONSTRUCTED).any(axis=0), dtype=np.bool_)


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
    terms, u = coefficients.shape[2], arc_length / length
    plane = coefficients[:, :2]
    place = plane @ compute_powers(u, terms).T
    rate = plane @ compute_power_slopes(u, terms).T / length
    bend = plane @ _second_derivatives(u, terms).T / length**2
    speed = np.hypot(rate[:, 0], rate[:, 1])
    turned = rate[:, 0] * bend[:, 1] - rate[:, 1] * bend[:, 0]
    angle = np.arctan2(rate[:, 1], rate[:, 0])
    return StationCurves(place[:, 0], place[:, 1], angle, turned / speed**3)


def _second_derivatives(u: Floats, terms: int) -> Floats:
    """Return the second derivatives of the powers of u; shape (n, terms)."""
    rates = np.zeros((len(u), terms))
    rates[:, 2:] = np.arange(2, terms) * np.arange(1, terms - 1) * compute_powers(u, terms)[:, :-2]
    return rates


def compute_curvature_gain(
    layout: MarkerLayout, markers: Floats, shape: StationCurves, arc_length: Floats
) -> Floats:
    """Return the standard error of curvature per standard deviation of a marker coordinate.

    Parameters
    ----------
    layout : of the markers
    markers : shape (n, markers, 3), of the fitted curves; NaN where not in sight
    shape : the curves at the stations
    arc_length : shape (stations,), m

    Returns
    -------
    shape (n, stations), 1/m^2; NaN for too few markers.

    Notes
    -----
    With n = (-sin, cos) and t = (cos, sin): d kappa = n . d r'' - 2 kappa t . d r', where r'' and
    r' are linear in the markers by the least-squares operator of the fit.
    """
    is_visible = np.isfinite(markers).all(axis=2)
    gain = np.full(shape.angle.shape, np.nan)
    for pattern in np.unique(is_visible, axis=0):
        chosen = (is_visible == pattern).all(axis=1)
        operators = _make_operators(layout, layout.arc_length[pattern], arc_length)
        if operators is None:
            continue
        gram = np.einsum("isk,jsk->sij", operators, operators)
        angle, twice = shape.angle[chosen], 2.0 * shape.curvature[chosen]
        sine, cosine = np.sin(angle), np.cos(angle)
        weights = np.stack([-sine, cosine, -twice * cosine, -twice * sine], axis=-1)
        gain[chosen] = np.sqrt(np.einsum("nsi,sij,nsj->ns", weights, gram, weights))
    return gain


def _make_operators(layout: MarkerLayout, places: Floats, arc_length: Floats) -> Floats | None:
    """Return x'', y'', x', y' at the stations per marker coordinate: (4, stations, 2 markers)."""
    ends, terms = layout.ends, layout.terms
    basis = build_curve_basis(
        terms=terms, length=ends.length, clamped=ends.direction is not None, free_tip=ends.free_tip
    )
    if len(places) < basis.unknowns:
        return None
    solve = np.linalg.pinv(build_marker_design(basis, places, layout.centre_offset))
    u, unknowns = arc_length / ends.length, basis.unknowns
    bend = _second_derivatives(u, terms) @ basis.matrix / ends.length**2
    slope = basis.slope(arc_length)
    x, y = solve[:unknowns], solve[unknowns:]
    return np.stack([bend @ x, bend @ y, slope @ x, slope @ y])


def compute_weight_levers(coefficients: Floats, length: float, arc_length: Floats) -> Floats:
    """Return the moment of the specimen beyond stations, per weight per length, m^2.

    Parameters
    ----------
    coefficients : shape (n, 3, terms), m, power series in s / length; NaN gives NaN
    length : m
    arc_length : shape (stations,), m

    Returns
    -------
    shape (n, stations): integral of x(s') - x(s) from s to the tip.
    """
    u, terms = arc_length / length, coefficients.shape[2]
    rise = length * (1.0 - u[:, None] * compute_powers(u, terms)) / np.arange(1, terms + 1)
    along = coefficients[:, 0]
    return np.asarray(along @ rise.T - (length - arc_length) * (along @ compute_powers(u, terms).T))


def compute_moments(curves: StationCurves, tip: StationCurves, pull: Floats) -> Floats:
    """Return the bending moment at stations under a force at the tip.

    Parameters
    ----------
    curves : the curves at the stations, shape (n, stations)
    tip : the curves at the tip, shape (n, 1)
    pull : shape (n, 2), N, along x and y

    Returns
    -------
    shape (n, stations), N m: M(s) = Py (x_L - x) - Px (y_L - y), positive where it bends towards
    the pull.
    """
    return np.asarray(
        pull[:, 1:] * (tip.x - curves.x) - pull[:, :1] * (tip.y - curves.y), dtype=np.float64
    )


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


@dataclass(frozen=True, eq=False)
class BendingTest:
    """A bending test with shape and curve; arrays of shape (frames,).

    Parameters
    ----------
    shape : with clamped end and pull point, fitted in every frame
    force : N, of the curve at the frames; NaN without one
    branch, cycle : of the curve at the frames
    first : branch of the first loading
    rest : frames before the loading
    centre_offset : m, axis to marker centre
    free_tip : whether the shapes were fitted without a moment at the tip
    pull : at the tip
    errors : of force and places
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
    def layout(self) -> MarkerLayout:
        """Return the layout of the markers."""
        return find_marker_layout(
            self.shape, centre_offset=self.centre_offset, free_tip=self.free_tip
        )

    @cached_property
    def specimen_at_rest(self) -> SpecimenAtRest:
        """Return the specimen at rest.

        Raises
        ------
        ValueError
            If fewer than two frames at rest show all markers.
        """
        branch = np.where(self.rest, 0, -1)
        frames = average_frames(self.shape, np.zeros(len(branch)), branch, per_mean=1)
        is_complete = np.isfinite(frames.markers).all(axis=(1, 2))
        n_frames = int(is_complete.sum())
        if n_frames < 2:
            raise ValueError(format_sentence("results.few_frames_at_rest", count=n_frames))
        fit = self.layout.fit(frames.markers[is_complete])
        markers = frames.markers[is_complete].mean(axis=0)
        return SpecimenAtRest(
            markers=markers,
            coefficients=fit.coefficients.mean(axis=0)[None],
            finer=self.layout.fit(markers[None], more=min(fit.n_spare, 1)).coefficients,
            frames=n_frames,
            noise=fit.noise(slice(None)),
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
            If no mean has both a shape and a force.
        """
        means = average_frames(self.shape, self.force, branch, per_mean=per_mean)
        fit = self.layout.fit(means.markers)
        usable = np.isfinite(fit.coefficients).all(axis=(1, 2)) & np.isfinite(means.force)
        if not usable.any():
            raise ValueError(format_sentence("results.no_means"))
        finer = self.layout.fit(means.markers, more=1) if fit.n_spare > 0 else None
        return FittedFrames(
            means=means.select(usable),
            coefficients=fit.coefficients[usable],
            finer=None if finer is None else finer.coefficients[usable],
            tip_gain=fit.gain[usable, :2].max(axis=1),
        )

    def compute_moments(
        self, coefficients: Floats, reading: Floats, places: Floats, *, pull: TipPull | None = None
    ) -> Floats:
        """Return bending moments along fitted curves.

        Parameters
        ----------
        coefficients : shape (n, 3, terms), m
        reading : shape (n,), N, tension less that at rest
        places : shape (stations,), m
        pull : None for that of the test

        Returns
        -------
        shape (n, stations), N m.
        """
        length, pull = self.layout.length, self.pull if pull is None else pull
        tip = evaluate_curves(coefficients, length, np.array([length]))
        force = pull.compute_force(reading, tip.x[:, 0])
        moment = compute_moments(evaluate_curves(coefficients, length, places), tip, force)
        if pull.self_weight == 0.0:
            return moment
        return moment - pull.self_weight * compute_weight_levers(coefficients, length, places)


@dataclass(frozen=True, slots=True, eq=False)
class SpecimenAtRest:
    """The specimen at rest.

    Parameters
    ----------
    markers : shape (markers, 3), m, mean places
    coefficients : shape (1, 3, terms), m, of the mean curve
    finer : the same with one more coefficient, if the markers determine it
    frames : number of frames with all markers
    noise : m, standard deviation of a marker coordinate; NaN without residuals
    """

    markers: Floats
    coefficients: Floats
    finer: Floats
    frames: int
    noise: float


@dataclass(frozen=True, slots=True, eq=False)
class FittedFrames:
    """Means of frames with shape and force, and the curves through them.

    Parameters
    ----------
    means : the means
    coefficients : shape (n, 3, terms), m
    finer : shape (n, 3, terms + 1), m; None if the markers do not determine one more coefficient
    tip_gain : shape (n,), standard error of the tip per standard deviation of a marker coordinate
    """

    means: MeanFrames
    coefficients: Floats
    finer: Floats | None
    tip_gain: Floats
