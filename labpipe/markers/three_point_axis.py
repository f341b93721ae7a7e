"""The axis of a specimen in three-point bending: shape and curvature from points along it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from labpipe.markers.rings import (
    SIDES,
    Sections,
    compute_section_centres,
    compute_twist,
    fit_rest_axis,
)
from labpipe.records.arrays import ArrayRecord, Flags, Floats

TERMS = 3
_GRID_POINTS = 161
_MAX_SLOPE_SINE = 0.97
"""Sine of the largest slope of a shape."""


@dataclass(frozen=True, slots=True, eq=False)
class BentAxis:
    """Shapes of the axis between two supports.

    sin(slope) = tilt - sum_k c_k W_k(x), with W_k the integral of u^k from mid-span,
    u = 1 - 2 abs(x) / span between the supports and 0 beyond; y follows from the slope.

    Parameters
    ----------
    curvature : shape (frames, terms), 1/m, the c_k, k from 1
    tilt : shape (frames,), sine of the slope at mid-span
    height : shape (frames,), m, y at mid-span
    residual : shape (frames,), m, root mean square distance of the points in y
    freedom : shape (frames,), points in sight minus fitted parameters
    span : m
    """

    curvature: Floats
    tilt: Floats
    height: Floats
    residual: Floats
    freedom: Floats
    span: float

    @property
    def mid_span(self) -> Floats:
        """Return the curvature at mid-span, 1/m, shape (frames,)."""
        return np.asarray(self.curvature.sum(axis=1), dtype=np.float64)

    @property
    def noise(self) -> float:
        """Return the standard deviation of a point in y, m, over all frames."""
        valid = np.isfinite(self.residual) & (self.freedom > 0)
        freedom = self.freedom[valid]
        points = freedom + self.curvature.shape[1] + 2
        return float(np.sqrt(np.sum(self.residual[valid] ** 2 * points) / freedom.sum()))

    def sine(self, x: Floats) -> Floats:
        """Return the sine of the slope at places of shape (frames, n), m from mid-span."""
        along = _integrals(x, self.span, self.curvature.shape[1])
        sine = self.tilt[:, None] - np.einsum("fnk,fk->fn", along, self.curvature)
        return np.asarray(np.clip(sine, -_MAX_SLOPE_SINE, _MAX_SLOPE_SINE), dtype=np.float64)

    def y(self, x: Floats) -> Floats:
        """Return the height at places of shape (n,), m from mid-span, for every frame."""
        reach = float(np.abs(x).max()) + 1e-6
        grid = np.linspace(-reach, reach, _GRID_POINTS)
        sine = self.sine(np.broadcast_to(grid, (len(self.tilt), _GRID_POINTS)))
        rise = _integrate(sine / np.sqrt(1.0 - sine**2), grid)
        cell = np.clip(((x + reach) / (grid[1] - grid[0])).astype(int), 0, _GRID_POINTS - 2)
        share = (x - grid[cell]) / (grid[1] - grid[0])
        y = (1.0 - share) * rise[:, cell] + share * rise[:, cell + 1] + self.height[:, None]
        return np.asarray(y, dtype=np.float64)

    @property
    def deflection(self) -> Floats:
        """Return the deflection of mid-span relative to the supports, along the load, m."""
        ends = self.y(np.array([-0.5 * self.span, 0.5 * self.span]))
        return np.asarray(self.height - ends.mean(axis=1), dtype=np.float64)

    @property
    def support_slope(self) -> Floats:
        """Return the tangent of the slope at the supports, mean of both sides, shape (frames,)."""
        ends = np.broadcast_to([-0.5 * self.span, 0.5 * self.span], (len(self.tilt), 2))
        sine = self.sine(ends)
        tangent = sine / np.sqrt(1.0 - sine**2)
        return np.asarray(0.5 * (tangent[:, 0] - tangent[:, 1]), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class SpanShape(ArrayRecord):
    """Shapes of a specimen with sections of markers.

    Parameters
    ----------
    axis : the axis in every frame; x from mid-span
    mid_span : m, position of mid-span on the x axis of the sections
    centres : shape (frames, sections, 3), m, points on the axis, x from mid-span
    twist : shape (frames, sections), rad; NaN where unknown
    lever : shape (sections,), m, from `compute_twist`
    fewer_terms : shape (frames,), 1/m, curvature at mid-span with one term less
    side_share : relative change of the curvature with the markers on the other side
    """

    axis: BentAxis
    mid_span: float
    centres: Annotated[Floats, "frames", "sections", 3]
    twist: Annotated[Floats, "frames", "sections"]
    lever: Annotated[Floats, "sections"]
    fewer_terms: Annotated[Floats, "frames"]
    side_share: float


def fit_span(
    sections: Sections, *, span: float, radius: float, facing: str, bent_most: Flags
) -> SpanShape:
    """Fit the bent axis of a specimen on two supports to its markers, in every frame.

    Parameters
    ----------
    sections : markers and their sections
    span : m, between the supports
    radius : m, from the axis to the centre of a marker
    facing : side of the markers, one of `SIDES`
    bent_most : shape (frames,), frames in which the specimen is bent, for finding mid-span

    Returns
    -------
    The shapes. Frames with too few sections in sight are NaN.

    Raises
    ------
    ValueError
        If fewer than six sections have markers.

    Notes
    -----
    Markers are glued by hand: deviations of sections from a straight line at rest are attributed to
    the markers, not to a bend. The offset of a marker from the axis rotates with slope and twist of
    its section, so shape and offsets are computed alternately. Mid-span is the place about which
    the bent shape is symmetric, by least squares over chosen frames.
    """
    max_frames = 30
    if sections.count < TERMS + 3:
        message = (
            f"{sections.count} sections with markers: expected at least {TERMS + 3}; check "
            "markers.along, at the step's section and at the unit of the markers"
        )
        raise ValueError(message)
    _check_span(sections, span)
    bent = np.flatnonzero(bent_most)
    chosen = bent[np.linspace(0, len(bent) - 1, min(max_frames, len(bent))).astype(int)]
    few = replace(sections, markers=sections.markers[chosen])
    fits = []
    for towards in SIDES[facing]:
        axis = fit_rest_axis(sections, radius=radius, towards=towards)
        middle, misfit = _find_middle(few, axis, span, radius)
        curvature = float(np.nanmean(_fit(few, axis, middle, span, radius).axis.mid_span))
        fits.append((misfit, axis, middle, curvature))
    fits.sort(key=lambda fit: fit[0])
    _, axis, middle, curvature = fits[0]
    _check_reach(sections.x - middle, span)
    other_side = fits[-1][3] / curvature - 1.0
    return replace(_fit(sections, axis, middle, span, radius), side_share=abs(other_side))


def _check_span(sections: Sections, span: float) -> None:
    """Require enough sections within one span, at the best position of the supports."""
    x = np.sort(sections.x)
    n_inside = max(int(np.sum((x >= start) & (x <= start + span))) for start in x)
    if n_inside < TERMS + 2:
        message = (
            f"of {sections.count} sections with markers {n_inside} lie between supports "
            f"{1e3 * span:.4g} mm apart: expected at least {TERMS + 2}; check specimen.span and "
            "at the unit of the markers"
        )
        raise ValueError(message)


def _check_reach(x: Floats, span: float) -> None:
    """Require markers on both sides, far enough from mid-span."""
    # Share of half the span.
    min_reach = 0.6
    least = min_reach * 0.5 * span
    if x.min() > -least or x.max() < least:
        message = (
            f"sections with markers from {1e3 * x.min():+.4g} mm to {1e3 * x.max():+.4g} mm of "
            f"mid-span: expected some {1e3 * least:.4g} mm away on both sides, which is "
            f"{1e2 * min_reach:g} % of half the span"
        )
        raise ValueError(message)


def _find_middle(few: Sections, axis: Floats, span: float, radius: float) -> tuple[float, float]:
    """Return the place of mid-span on the x axis, m, and the misfit there."""
    # In m, of the parabolas through the misfit about each guess.
    half_widths = (5e-3, 1e-3, 2e-4)
    moved = few.markers[..., 1] - few.at_rest[:, 1]
    weight = np.clip(np.nanmean(moved, axis=0), 0.0, None) ** 4
    guess = float(np.average(few.at_rest[:, 0], weights=np.nan_to_num(weight) + 1e-30))

    def misfit(middle: float) -> float:
        bent = _fit(few, axis, middle, span, radius).axis
        return float(np.nanmean(bent.residual**2))

    lowest = misfit(guess)
    for reach in half_widths:
        guesses = np.array([guess - reach, guess, guess + reach])
        fits = np.array([misfit(guesses[0]), lowest, misfit(guesses[2])])
        bend, slope, _ = np.polyfit(guesses - guess, fits, 2)
        step = -0.5 * slope / bend if bend > 0.0 else reach * float(np.argmin(fits) - 1)
        guess += float(np.clip(step, -2.0 * reach, 2.0 * reach))
        lowest = misfit(guess)
    return guess, lowest


def _fit(sections: Sections, axis: Floats, middle: float, span: float, radius: float) -> SpanShape:
    parameters = np.array([middle, axis[0], axis[1]])
    slope = np.zeros((len(sections.markers), sections.count))
    centres, twist, lever = _locate_centres(sections, axis, slope, radius)
    bent = fit_bent_axis(centres - parameters, span=span, terms=TERMS)
    for _ in range(2):
        slope = np.arcsin(bent.sine(np.nan_to_num(centres[..., 0] - middle)))
        centres, twist, lever = _locate_centres(sections, axis, slope, radius)
        bent = fit_bent_axis(centres - parameters, span=span, terms=TERMS, start=bent)
    fewer = fit_bent_axis(centres - parameters, span=span, terms=TERMS - 1)
    return SpanShape(bent, middle, centres - parameters, twist, lever, fewer.mid_span, 0.0)


def _locate_centres(
    sections: Sections, axis: Floats, slope: Floats, radius: float
) -> tuple[Floats, Floats, Floats]:
    """Return points on the axis, twist and lever for the current slope."""
    twist, lever = compute_twist(sections, slope, radius=radius)
    return compute_section_centres(sections, axis, slope, twist), twist, lever


def fit_bent_axis(
    points: Floats, *, span: float, terms: int, start: BentAxis | None = None
) -> BentAxis:
    """Fit a bent axis to points in every frame by least squares.

    Parameters
    ----------
    points : shape (frames, n, 2 or 3), m, x from mid-span, y along the load; NaN where missing
    span : m
    terms : number of powers of u = 1 - 2 abs(x) / span in the curvature, from the first on
    start : shapes of nearly the same points, for a single step; None for straight lines

    Returns
    -------
    The shapes; NaN where fewer than terms + 3 points are in sight.

    Notes
    -----
    d(sin slope)/dx is the curvature for any slope: the sine is linear in the coefficients, y is
    not, hence Gauss-Newton (3 steps from a straight line; a fourth one changes nothing at the
    slopes of such a test). On supports that only push upwards the moment is linear in x, so the
    first power describes the elastic beam in its bent state, and higher powers the nonlinearity of
    the specimen. No moment at the supports; overhangs are straight.
    """
    size = 400
    first = np.zeros((len(points), terms + 2))
    if start is not None:
        first = np.column_stack([start.curvature, start.tilt, start.height])
    steps = 3 if start is None else 1
    first = np.nan_to_num(first)
    parts = [
        _fit_chunk(points[begin : begin + size], span, first[begin : begin + size], steps)
        for begin in range(0, len(points), size)
    ]
    curvature, tilt, height, residual, freedom = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    return BentAxis(curvature, tilt, height, residual, freedom, span)


def _fit_chunk(points: Floats, span: float, unknown: Floats, steps: int) -> tuple[Floats, ...]:
    terms = unknown.shape[1] - 2
    seen: Flags = np.asarray(np.isfinite(points[..., :2]).all(axis=2))
    enough = seen.sum(axis=1) >= terms + 3
    x: Floats = np.where(seen, points[..., 0], 0.0)
    y: Floats = np.where(seen, points[..., 1], 0.0)
    reach = float(np.abs(x).max()) + 1e-3
    grid = np.linspace(-reach, reach, _GRID_POINTS)
    along = _integrals(grid[None], span, terms)[0]
    columns = np.concatenate([-along, np.ones((_GRID_POINTS, 1))], axis=1)  # curvatures, tilt
    weight = seen.astype(np.float64)
    for _ in range(steps):
        design, model = _linearise(unknown, columns, grid, x)
        design = design * weight[:, :, None]
        normal: Floats = np.einsum("fni,fnj->fij", design, design) + 1e-30 * np.eye(terms + 2)
        right = np.einsum("fni,fn->fi", design, (y - model) * weight)
        scale = np.sqrt(np.einsum("fii->fi", normal))
        normal = normal / (scale[:, :, None] * scale[:, None, :])
        normal[~enough] = np.eye(terms + 2)
        step: Floats = np.linalg.solve(normal, (right / scale)[..., None])
        unknown = unknown + step[..., 0] / scale
    _, model = _linearise(unknown, columns, grid, x)
    squares = np.sum(((y - model) * weight) ** 2, axis=1)
    unknown[~enough] = np.nan
    count = seen.sum(axis=1)
    residual = np.where(enough, np.sqrt(squares / np.maximum(count, 1)), np.nan)
    freedom = np.where(enough, count - terms - 2.0, 0.0)
    return unknown[:, :terms], unknown[:, terms], unknown[:, -1], residual, freedom


def _linearise(unknown: Floats, columns: Floats, grid: Floats, x: Floats) -> tuple[Floats, Floats]:
    """Return derivatives of y at places of shape (frames, n) by the unknowns, and y."""
    sine = np.clip(unknown[:, :-1] @ columns.T, -_MAX_SLOPE_SINE, _MAX_SLOPE_SINE)
    flat = np.sqrt(1.0 - sine**2)
    rise = _integrate(sine / flat, grid)
    steps = _integrate((columns.T[None] / flat[:, None] ** 3), grid)
    place = (x - grid[0]) / (grid[1] - grid[0])
    cell = np.clip(place.astype(int), 0, len(grid) - 2)
    share = place - cell
    rows = np.arange(len(x))[:, None]
    y = (1.0 - share) * rise[rows, cell] + share * rise[rows, cell + 1]
    design = [
        (1.0 - share) * steps[rows, k, cell] + share * steps[rows, k, cell + 1]
        for k in range(columns.shape[1])
    ]
    return np.stack([*design, np.ones_like(x)], axis=2), y + unknown[:, -1:]


def _integrate(values: Floats, grid: Floats) -> Floats:
    """Return integrals from the middle of an even grid along the last axis (trapezoids)."""
    from scipy.integrate import cumulative_trapezoid  # slow import, not needed by tensile tests

    total = cumulative_trapezoid(values, dx=grid[1] - grid[0], initial=0)
    return np.asarray(total - total[..., [len(grid) // 2]], dtype=np.float64)


def _integrals(x: Floats, span: float, terms: int) -> Floats:
    """Return integrals of u^k from mid-span to x, k from 1, shape (*x.shape, terms)."""
    remainder = np.clip(1.0 - 2.0 * np.abs(x) / span, 0.0, None)
    powers = np.arange(2, terms + 2)
    full = 0.5 * span * (1.0 - remainder[..., None] ** powers) / powers
    return np.asarray(np.sign(x)[..., None] * full, dtype=np.float64)
