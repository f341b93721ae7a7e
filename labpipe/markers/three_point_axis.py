"""Fit shape and curvature of a specimen in three-point bending to sections of markers."""

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
from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Flags, Floats

TERMS = 3
"""Number of powers in the curvature of a shape."""
_GRID_POINTS = 161
_MAX_SLOPE_SINE = 0.97
"""Largest sine of the slope of a shape."""


@dataclass(frozen=True, slots=True, eq=False)
class BentAxis:
    """Shapes of the bent axis on two supports, in every frame.

    sin(slope) = tilt - sum_k c_k W_k(x), where W_k is the integral of u^k from mid-span to x, and
    u = 1 - 2 abs(x) / span between the supports and 0 beyond them; y is the integral of tan(slope).

    Parameters
    ----------
    coefficients : shape (frames, terms), 1/m, coefficients c_k of the curvature, k from 1
    tilt : shape (frames,), sine of the slope at mid-span
    height : shape (frames,), m, y at mid-span
    residual : shape (frames,), m, root mean square distance of the points from the axis in y
    freedom : shape (frames,), degrees of freedom: measured points minus parameters; 0 without a fit
    span : m, distance between the supports
    """

    coefficients: Floats
    tilt: Floats
    height: Floats
    residual: Floats
    freedom: Floats
    span: float

    @property
    def mid_span_curvature(self) -> Floats:
        """Return the curvature at mid-span, 1/m, shape (frames,)."""
        return np.asarray(self.coefficients.sum(axis=1), dtype=np.float64)

    @property
    def noise(self) -> float:
        """Return the standard deviation of y of a point, m, from the residuals of all frames."""
        valid = np.isfinite(self.residual) & (self.freedom > 0)
        freedom = self.freedom[valid]
        points = freedom + self.coefficients.shape[1] + 2
        return float(np.sqrt(np.sum(self.residual[valid] ** 2 * points) / freedom.sum()))

    def sine(self, x: Floats) -> Floats:
        """Return the sine of the slope at x of shape (frames, n), m from mid-span.

        Its magnitude is limited to `_MAX_SLOPE_SINE`.
        """
        integrals = _integrate_powers(x, self.span, self.coefficients.shape[1])
        sine = self.tilt[:, None] - np.einsum("fnk,fk->fn", integrals, self.coefficients)
        return np.asarray(np.clip(sine, -_MAX_SLOPE_SINE, _MAX_SLOPE_SINE), dtype=np.float64)

    def y(self, x: Floats) -> Floats:
        """Return y, shape (frames, n), m, at x of shape (n,), m from mid-span."""
        half_range = float(np.abs(x).max()) + 1e-6
        grid = np.linspace(-half_range, half_range, _GRID_POINTS)
        sine = self.sine(np.broadcast_to(grid, (len(self.tilt), _GRID_POINTS)))
        rise = _integrate(sine / np.sqrt(1.0 - sine**2), grid)
        cell = np.clip(((x + half_range) / (grid[1] - grid[0])).astype(int), 0, _GRID_POINTS - 2)
        share = (x - grid[cell]) / (grid[1] - grid[0])
        y = (1.0 - share) * rise[:, cell] + share * rise[:, cell + 1] + self.height[:, None]
        return np.asarray(y, dtype=np.float64)

    @property
    def deflection(self) -> Floats:
        """Return the deflection of mid-span relative to the supports, shape (frames,), m."""
        ends = self.y(np.array([-0.5 * self.span, 0.5 * self.span]))
        return np.asarray(self.height - ends.mean(axis=1), dtype=np.float64)

    @property
    def support_slope(self) -> Floats:
        """Return the mean tangent of the slope at the supports, towards mid-span; (frames,)."""
        ends = np.broadcast_to([-0.5 * self.span, 0.5 * self.span], (len(self.tilt), 2))
        sine = self.sine(ends)
        tangent = sine / np.sqrt(1.0 - sine**2)
        return np.asarray(0.5 * (tangent[:, 0] - tangent[:, 1]), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class SpanShape(ArrayRecord):
    """Fitted shapes of a specimen with sections of markers.

    Parameters
    ----------
    axis : bent axis of the specimen in every frame, x from mid-span
    mid_span : m, position of mid-span on the x axis of the sections
    centres : shape (frames, sections, 3), m, points of the axis, from mid-span of the axis at rest
    twist : shape (frames, sections), rad; NaN where unknown
    lever : shape (sections,), m, lever arm of the markers for the twist, from `compute_twist`
    curvature_fewer_terms : shape (frames,), 1/m, curvature at mid-span of a fit with one term fewer
    side_change : relative change of the curvature at mid-span if the markers are assumed on the
        other side of the specimen; 0 if only one side is possible
    """

    axis: BentAxis
    mid_span: float
    centres: Annotated[Floats, "frames", "sections", 3]
    twist: Annotated[Floats, "frames", "sections"]
    lever: Annotated[Floats, "sections"]
    curvature_fewer_terms: Annotated[Floats, "frames"]
    side_change: float


def fit_span(
    sections: Sections, *, span: float, radius: float, facing: str, is_bent: Flags
) -> SpanShape:
    """Fit the bent axis of a specimen on two supports to its markers, in every frame.

    Parameters
    ----------
    sections : markers and their sections
    span : m, distance between the supports
    radius : m, distance from the axis to the centre of a marker
    facing : side of the specimen with the markers, a key of `SIDES`
    is_bent : shape (frames,), flags of frames with a bent specimen, to find mid-span

    Returns
    -------
    The shapes; NaN in frames with fewer than six measured sections.

    Raises
    ------
    ValueError
        If there are fewer than six sections, fewer than five within one span, or none beyond 60 %
        of half the span on one side.

    Notes
    -----
    At rest, deviations of the sections from a straight line are attributed to the positions of the
    markers, not to a curvature of the specimen. The offset of a marker from the axis rotates with
    slope and twist of its section, so shape and offsets are computed alternately. Mid-span is the
    position with the smallest residuals over at most 30 frames with a bent specimen.
    """
    max_frames = 30
    if sections.count < TERMS + 3:
        count, needed = sections.count, TERMS + 3
        raise ValueError(format_sentence("markers.few_sections", count=count, needed=needed))
    _check_span(sections, span)
    bent_frames = np.flatnonzero(is_bent)
    numbers = np.linspace(0, len(bent_frames) - 1, min(max_frames, len(bent_frames))).astype(int)
    sampled_frames = replace(sections, markers=sections.markers[bent_frames[numbers]])
    fits = []
    for towards in SIDES[facing]:
        axis = fit_rest_axis(sections, radius=radius, towards=towards)
        mid_span, misfit = _find_mid_span(sampled_frames, axis, span, radius)
        shapes = _fit_shapes(sampled_frames, axis, mid_span, span, radius)
        curvature = float(np.nanmean(shapes.axis.mid_span_curvature))
        fits.append((misfit, axis, mid_span, curvature))
    fits.sort(key=lambda fit: fit[0])
    _, axis, mid_span, curvature = fits[0]
    low, high = 1e3 * (sections.x.min() - mid_span), 1e3 * (sections.x.max() - mid_span)
    if low > -(reach := 0.3e3 * span) or high < reach:  # 60 % of half the span
        raise ValueError(format_sentence("markers.short_reach", low=low, high=high, reach=reach))
    side_change = abs(fits[-1][3] / curvature - 1.0)
    return replace(_fit_shapes(sections, axis, mid_span, span, radius), side_change=side_change)


def _check_span(sections: Sections, span: float) -> None:
    """Raise a ValueError if too few sections lie within one span, wherever it begins."""
    x = np.sort(sections.x)
    n_inside = max(int(np.sum((x >= start) & (x <= start + span))) for start in x)
    if n_inside < TERMS + 2:
        message = (
            f"of {sections.count} sections with markers {n_inside} lie between supports "
            f"{1e3 * span:.4g} mm apart: expected at least {TERMS + 2}; check specimen.span and "
            "the unit of the markers"
        )
        raise ValueError(message)


def _find_mid_span(
    sampled_frames: Sections, axis: Floats, span: float, radius: float
) -> tuple[float, float]:
    """Return the position of mid-span on the x axis, m, and the mean square residual there.

    The position is refined by parabolas through the mean square residual.
    """
    half_widths = (5e-3, 1e-3, 2e-4)  # of the parabolas, m
    rise = sampled_frames.markers[..., 1] - sampled_frames.at_rest[:, 1]
    weight = np.clip(np.nanmean(rise, axis=0), 0.0, None) ** 4
    guess = float(np.average(sampled_frames.at_rest[:, 0], weights=np.nan_to_num(weight) + 1e-30))

    def compute_misfit(mid_span: float) -> float:
        residual = _fit_shapes(sampled_frames, axis, mid_span, span, radius).axis.residual
        return float(np.nanmean(residual**2))

    lowest = compute_misfit(guess)
    for width in half_widths:
        guesses = np.array([guess - width, guess, guess + width])
        misfits = np.array([compute_misfit(guesses[0]), lowest, compute_misfit(guesses[2])])
        square, slope, _ = np.polyfit(guesses - guess, misfits, 2)
        step = -0.5 * slope / square if square > 0.0 else width * float(np.argmin(misfits) - 1)
        guess += float(np.clip(step, -2.0 * width, 2.0 * width))
        lowest = compute_misfit(guess)
    return guess, lowest


def _fit_shapes(
    sections: Sections, axis: Floats, mid_span: float, span: float, radius: float
) -> SpanShape:
    """Fit the shapes of all frames for a given position of mid-span and of the axis at rest."""
    origin = np.array([mid_span, axis[0], axis[1]])
    slope = np.zeros((len(sections.markers), sections.count))
    centres, twist, lever = _locate_centres(sections, axis, slope, radius)
    shapes = fit_bent_axis(centres - origin, span=span, terms=TERMS)
    for _ in range(2):
        slope = np.arcsin(shapes.sine(np.nan_to_num(centres[..., 0] - mid_span)))
        centres, twist, lever = _locate_centres(sections, axis, slope, radius)
        shapes = fit_bent_axis(centres - origin, span=span, terms=TERMS, start=shapes)
    fewer = fit_bent_axis(centres - origin, span=span, terms=TERMS - 1)
    curvature = fewer.mid_span_curvature
    return SpanShape(shapes, mid_span, centres - origin, twist, lever, curvature, 0.0)


def _locate_centres(
    sections: Sections, axis: Floats, slope: Floats, radius: float
) -> tuple[Floats, Floats, Floats]:
    """Return points of the axis, twist and lever for given slopes of the sections."""
    twist, lever = compute_twist(sections, slope, radius=radius)
    return compute_section_centres(sections, axis, slope, twist), twist, lever


def fit_bent_axis(
    points: Floats, *, span: float, terms: int, start: BentAxis | None = None
) -> BentAxis:
    """Fit the axis to points in every frame by least squares.

    Parameters
    ----------
    points : shape (frames, n, 2 or 3), m, x from mid-span, y along the load; NaN where missing
    span : m, distance between the supports
    terms : number of powers of u = 1 - 2 abs(x) / span in the curvature, from the first one
    start : shapes of similar points, from which one step is enough; None for straight lines

    Returns
    -------
    The shapes; NaN in frames with fewer than terms + 3 measured points.

    Notes
    -----
    The curvature is -d(sin slope)/dx for any slope, so the sine is linear in the coefficients. y is
    not, so Gauss-Newton is used: 3 steps from a straight line, because a fourth step changes
    nothing at the slopes of such a test. The forces of the supports are along y, so the moment is
    linear in x: the first power describes an elastic beam, and higher powers the nonlinearity of
    the specimen. There is no moment at the supports, and the overhangs are straight.
    """
    chunk_frames = 400
    initial = np.zeros((len(points), terms + 2))
    if start is not None:
        initial = np.column_stack([start.coefficients, start.tilt, start.height])
    steps = 3 if start is None else 1
    initial = np.nan_to_num(initial)
    chunks = [
        _fit_chunk(
            points[begin : begin + chunk_frames], span, initial[begin : begin + chunk_frames], steps
        )
        for begin in range(0, len(points), chunk_frames)
    ]
    coefficients, tilt, height, residual, freedom = (
        np.concatenate(column) for column in zip(*chunks, strict=True)
    )
    return BentAxis(coefficients, tilt, height, residual, freedom, span)


def _fit_chunk(points: Floats, span: float, parameters: Floats, steps: int) -> tuple[Floats, ...]:
    """Return coefficients, tilt, height, residual and degrees of freedom of consecutive frames."""
    terms = parameters.shape[1] - 2
    is_measured: Flags = np.asarray(np.isfinite(points[..., :2]).all(axis=2))
    has_enough = is_measured.sum(axis=1) >= terms + 3
    x: Floats = np.where(is_measured, points[..., 0], 0.0)
    y: Floats = np.where(is_measured, points[..., 1], 0.0)
    half_range = float(np.abs(x).max()) + 1e-3
    grid = np.linspace(-half_range, half_range, _GRID_POINTS)
    integrals = _integrate_powers(grid[None], span, terms)[0]
    # Derivatives of the sine with respect to coefficients and tilt.
    columns = np.concatenate([-integrals, np.ones((_GRID_POINTS, 1))], axis=1)
    weight = is_measured.astype(np.float64)
    for _ in range(steps):
        design, model = _linearise(parameters, columns, grid, x)
        design = design * weight[:, :, None]
        normal: Floats = np.einsum("fni,fnj->fij", design, design) + 1e-30 * np.eye(terms + 2)
        right = np.einsum("fni,fn->fi", design, (y - model) * weight)
        scale = np.sqrt(np.einsum("fii->fi", normal))
        normal = normal / (scale[:, :, None] * scale[:, None, :])
        normal[~has_enough] = np.eye(terms + 2)
        step: Floats = np.linalg.solve(normal, (right / scale)[..., None])
        parameters = parameters + step[..., 0] / scale
    _, model = _linearise(parameters, columns, grid, x)
    squares = np.sum(((y - model) * weight) ** 2, axis=1)
    parameters[~has_enough] = np.nan
    count = is_measured.sum(axis=1)
    residual = np.where(has_enough, np.sqrt(squares / np.maximum(count, 1)), np.nan)
    freedom = np.where(has_enough, count - terms - 2.0, 0.0)
    return parameters[:, :terms], parameters[:, terms], parameters[:, -1], residual, freedom


def _linearise(
    parameters: Floats, columns: Floats, grid: Floats, x: Floats
) -> tuple[Floats, Floats]:
    """Return the derivatives of y with respect to the parameters, and y, at x (frames, n)."""
    sine = np.clip(parameters[:, :-1] @ columns.T, -_MAX_SLOPE_SINE, _MAX_SLOPE_SINE)
    cosine = np.sqrt(1.0 - sine**2)
    rise = _integrate(sine / cosine, grid)
    derivatives = _integrate((columns.T[None] / cosine[:, None] ** 3), grid)
    position = (x - grid[0]) / (grid[1] - grid[0])
    cell = np.clip(position.astype(int), 0, len(grid) - 2)
    share = position - cell
    rows = np.arange(len(x))[:, None]
    y = (1.0 - share) * rise[rows, cell] + share * rise[rows, cell + 1]
    design = [
        (1.0 - share) * derivatives[rows, k, cell] + share * derivatives[rows, k, cell + 1]
        for k in range(columns.shape[1])
    ]
    return np.stack([*design, np.ones_like(x)], axis=2), y + parameters[:, -1:]


def _integrate(values: Floats, grid: Floats) -> Floats:
    """Return integrals along the last axis from the middle of a uniform grid (trapezoidal rule)."""
    from scipy.integrate import cumulative_trapezoid  # slow import, not needed by tensile tests

    total = cumulative_trapezoid(values, dx=grid[1] - grid[0], initial=0)
    return np.asarray(total - total[..., [len(grid) // 2]], dtype=np.float64)


def _integrate_powers(x: Floats, span: float, terms: int) -> Floats:
    """Return the integrals of u^k from mid-span to x, k from 1, shape (*x.shape, terms)."""
    remainder = np.clip(1.0 - 2.0 * np.abs(x) / span, 0.0, None)
    powers = np.arange(2, terms + 2)
    full = 0.5 * span * (1.0 - remainder[..., None] ** powers) / powers
    return np.asarray(np.sign(x)[..., None] * full, dtype=np.float64)
