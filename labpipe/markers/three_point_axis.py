"""The axis of a specimen in three-point bending, from points along it: shape and curvature."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from labpipe.markers.rings import SIDES, Sections, axis_at_rest, section_centres, section_twist
from labpipe.records.arrays import ArrayRecord, Flags, Floats

TERMS = 3
_GRID = 161
_CHUNK = 400
_STEEPEST = 0.97
"""Sine of the steepest slope that a shape can have."""
_NEWTON, _ROUNDS = 3, 3
"""Gauss-Newton steps from a straight line; rounds of shape and distances, one more step in each."""
_REACH = 0.6
"""Share of half the span that markers must cover on both sides of mid-span."""
_LOOKED_AT = 30
_CENTRE = (5e-3, 1e-3, 2e-4)
"""Frames by which mid-span is found; m on each side of a guess, for parabolas of the misfit."""


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
    freedom : shape (frames,), points seen less what was fitted
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
        """Curvature at mid-span, 1/m, shape (frames,)."""
        return np.asarray(self.curvature.sum(axis=1), dtype=np.float64)

    @property
    def noise(self) -> float:
        """Standard deviation of a point in y, m, over all frames."""
        known = np.isfinite(self.residual) & (self.freedom > 0)
        freedom = self.freedom[known]
        points = freedom + self.curvature.shape[1] + 2
        return float(np.sqrt(np.sum(self.residual[known] ** 2 * points) / freedom.sum()))

    def sine(self, x: Floats) -> Floats:
        """Sine of the slope at places of shape (frames, n), m from mid-span."""
        along = _integrals(x, self.span, self.curvature.shape[1])
        sine = self.tilt[:, None] - np.einsum("fnk,fk->fn", along, self.curvature)
        return np.asarray(np.clip(sine, -_STEEPEST, _STEEPEST), dtype=np.float64)

    def y(self, x: Floats) -> Floats:
        """Height at places of shape (n,), m from mid-span, for every frame."""
        reach = float(np.abs(x).max()) + 1e-6
        grid = np.linspace(-reach, reach, _GRID)
        sine = self.sine(np.broadcast_to(grid, (len(self.tilt), _GRID)))
        rise = _summed(sine / np.sqrt(1.0 - sine**2), grid)
        left = np.clip(((x + reach) / (grid[1] - grid[0])).astype(int), 0, _GRID - 2)
        share = (x - grid[left]) / (grid[1] - grid[0])
        y = (1.0 - share) * rise[:, left] + share * rise[:, left + 1] + self.height[:, None]
        return np.asarray(y, dtype=np.float64)

    @property
    def deflection(self) -> Floats:
        """How far mid-span is below the supports, in the direction of the load, m."""
        ends = self.y(np.array([-0.5 * self.span, 0.5 * self.span]))
        return np.asarray(self.height - ends.mean(axis=1), dtype=np.float64)

    @property
    def support_slope(self) -> Floats:
        """Tangent of the slope at the supports, mean of both sides, shape (frames,)."""
        ends = np.broadcast_to([-0.5 * self.span, 0.5 * self.span], (len(self.tilt), 2))
        sine = self.sine(ends)
        tangent = sine / np.sqrt(1.0 - sine**2)
        return np.asarray(0.5 * (tangent[:, 0] - tangent[:, 1]), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class SpanShape(ArrayRecord):
    """Shapes of a specimen with sections of markers.

    Parameters
    ----------
    bent : the axis in every frame; x counts from mid-span
    mid_span : m, where mid-span lies on the x axis of the sections
    centres : shape (frames, sections, 3), m, points on the axis, x from mid-span
    twist : shape (frames, sections), rad; NaN where it is not known
    lever : shape (sections,), m, as `section_twist` gives it
    fewer_terms : shape (frames,), 1/m, curvature at mid-span with one term less
    side_share : by which share the curvature would be another with the markers on the other side
    """

    bent: BentAxis
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
    facing : where the markers are, one of `SIDES`
    bent_most : shape (frames,), frames in which the specimen is bent; mid-span is found in some

    Returns
    -------
    The shapes. Frames with too few sections in sight are NaN.

    Raises
    ------
    ValueError
        If fewer than six sections carry markers.

    Notes
    -----
    Markers are glued by hand: what a section lies off a straight line at rest is taken for its
    marker's, not for a bend. A marker's distance from the axis turns with the slope and the twist
    of its section, so shape and distances are found in turns. Mid-span is the place about which the
    bent shape is symmetric: least squares over some frames.
    """
    if sections.count < TERMS + 3:
        message = (
            f"{sections.count} sections with markers: expected at least {TERMS + 3}; look at "
            "markers.along, at the step's section and at the unit of the markers"
        )
        raise ValueError(message)
    _check_span(sections, span)
    bent = np.flatnonzero(bent_most)
    some = bent[np.linspace(0, len(bent) - 1, min(_LOOKED_AT, len(bent))).astype(int)]
    few = replace(sections, markers=sections.markers[some])
    tried = []
    for towards in SIDES[facing]:
        axis = axis_at_rest(sections, radius=radius, towards=towards)
        middle, misfit = _find_middle(few, axis, span, radius)
        seen = float(np.nanmean(_fit(few, axis, middle, span, radius).bent.mid_span))
        tried.append((misfit, axis, middle, seen))
    tried.sort(key=lambda each: each[0])
    _, axis, middle, seen = tried[0]
    _check_reach(sections.x - middle, span)
    other_side = tried[-1][3] / seen - 1.0
    return replace(_fit(sections, axis, middle, span, radius), side_share=abs(other_side))


def _check_span(sections: Sections, span: float) -> None:
    """The supports must have enough sections between them, wherever they stand."""
    x = np.sort(sections.x)
    between = max(int(np.sum((x >= left) & (x <= left + span))) for left in x)
    if between < TERMS + 2:
        message = (
            f"of {sections.count} sections with markers {between} lie between supports "
            f"{1e3 * span:.4g} mm apart: expected at least {TERMS + 2}; look at specimen.span and "
            "at the unit of the markers"
        )
        raise ValueError(message)


def _check_reach(x: Floats, span: float) -> None:
    """What lies far from all markers is not seen, and mid-span only by both sides of it."""
    least = _REACH * 0.5 * span
    if x.min() > -least or x.max() < least:
        message = (
            f"sections with markers from {1e3 * x.min():+.4g} mm to {1e3 * x.max():+.4g} mm of "
            f"mid-span: expected some {1e3 * least:.4g} mm away on both sides, which is "
            f"{1e2 * _REACH:g} % of half the span"
        )
        raise ValueError(message)


def _find_middle(few: Sections, axis: Floats, span: float, radius: float) -> tuple[float, float]:
    """Place of mid-span on the x axis, m, and the misfit there."""
    moved = few.markers[..., 1] - few.at_rest[:, 1]
    weight = np.clip(np.nanmean(moved, axis=0), 0.0, None) ** 4
    guess = float(np.average(few.at_rest[:, 0], weights=np.nan_to_num(weight) + 1e-30))

    def misfit(middle: float) -> float:
        bent = _fit(few, axis, middle, span, radius).bent
        return float(np.nanmean(bent.residual**2))

    lowest = misfit(guess)
    for reach in _CENTRE:
        around = np.array([guess - reach, guess, guess + reach])
        fits = np.array([misfit(around[0]), lowest, misfit(around[2])])
        bend, slope, _ = np.polyfit(around - guess, fits, 2)
        step = -0.5 * slope / bend if bend > 0.0 else reach * float(np.argmin(fits) - 1)
        guess += float(np.clip(step, -2.0 * reach, 2.0 * reach))
        lowest = misfit(guess)
    return guess, lowest


def _fit(sections: Sections, axis: Floats, middle: float, span: float, radius: float) -> SpanShape:
    here = np.array([middle, axis[0], axis[1]])
    slope = np.zeros((len(sections.markers), sections.count))
    centres, twist, lever = _placed(sections, axis, slope, radius)
    bent = fit_bent_axis(centres - here, span=span, terms=TERMS)
    for _ in range(_ROUNDS - 1):
        slope = np.arcsin(bent.sine(np.nan_to_num(centres[..., 0] - middle)))
        centres, twist, lever = _placed(sections, axis, slope, radius)
        bent = fit_bent_axis(centres - here, span=span, terms=TERMS, start=bent)
    fewer = fit_bent_axis(centres - here, span=span, terms=TERMS - 1)
    return SpanShape(bent, middle, centres - here, twist, lever, fewer.mid_span, 0.0)


def _placed(
    sections: Sections, axis: Floats, slope: Floats, radius: float
) -> tuple[Floats, Floats, Floats]:
    """Points on the axis, twist and its lever, with the slope that is known so far."""
    twist, lever = section_twist(sections, slope, radius=radius)
    return section_centres(sections, axis, slope, twist), twist, lever


def fit_bent_axis(
    points: Floats, *, span: float, terms: int, start: BentAxis | None = None
) -> BentAxis:
    """Least squares of a bent axis through points in every frame.

    Parameters
    ----------
    points : shape (frames, n, 2 or 3), m, x from mid-span, y where the load goes; NaN where missing
    span : m
    terms : powers of u = 1 - 2 abs(x) / span that the curvature is made of, from the first on
    start : shapes of nearly the same points, from which one step is enough; None for straight lines

    Returns
    -------
    The shapes; NaN where fewer than terms + 3 points are seen.

    Notes
    -----
    Seen along x, d(sin slope)/dx is the curvature, whatever the slope: the sine is linear in the
    coefficients, y is not, hence Gauss-Newton (3 steps from a straight line; the fourth changes
    nothing at the slopes of such a test). On supports that only push upwards the moment is linear
    in x, so the first power alone is the elastic beam in its bent state, and higher powers are what
    the law of the specimen adds. No moment at the supports; overhangs are straight.
    """
    first = np.zeros((len(points), terms + 2))
    if start is not None:
        first = np.column_stack([start.curvature, start.tilt, start.height])
    steps = _NEWTON if start is None else 1
    parts = [
        _fit_some(points[at : at + _CHUNK], span, np.nan_to_num(first[at : at + _CHUNK]), steps)
        for at in range(0, len(points), _CHUNK)
    ]
    curvature, tilt, height, residual, freedom = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    return BentAxis(curvature, tilt, height, residual, freedom, span)


def _fit_some(points: Floats, span: float, unknown: Floats, steps: int) -> tuple[Floats, ...]:
    terms = unknown.shape[1] - 2
    seen: Flags = np.asarray(np.isfinite(points[..., :2]).all(axis=2))
    enough = seen.sum(axis=1) >= terms + 3
    x: Floats = np.where(seen, points[..., 0], 0.0)
    y: Floats = np.where(seen, points[..., 1], 0.0)
    reach = float(np.abs(x).max()) + 1e-3
    grid = np.linspace(-reach, reach, _GRID)
    along = _integrals(grid[None], span, terms)[0]
    columns = np.concatenate([-along, np.ones((_GRID, 1))], axis=1)  # curvatures, tilt
    weight = seen.astype(np.float64)
    for _ in range(steps):
        design, model = _linearised(unknown, columns, grid, x)
        design = design * weight[:, :, None]
        normal: Floats = np.einsum("fni,fnj->fij", design, design) + 1e-30 * np.eye(terms + 2)
        right = np.einsum("fni,fn->fi", design, (y - model) * weight)
        scale = np.sqrt(np.einsum("fii->fi", normal))
        normal = normal / (scale[:, :, None] * scale[:, None, :])
        normal[~enough] = np.eye(terms + 2)
        step: Floats = np.linalg.solve(normal, (right / scale)[..., None])
        unknown = unknown + step[..., 0] / scale
    _, model = _linearised(unknown, columns, grid, x)
    squares = np.sum(((y - model) * weight) ** 2, axis=1)
    unknown[~enough] = np.nan
    count = seen.sum(axis=1)
    residual = np.where(enough, np.sqrt(squares / np.maximum(count, 1)), np.nan)
    freedom = np.where(enough, count - terms - 2.0, 0.0)
    return unknown[:, :terms], unknown[:, terms], unknown[:, -1], residual, freedom


def _linearised(unknown: Floats, columns: Floats, grid: Floats, x: Floats) -> tuple[Floats, Floats]:
    """Derivatives of y at places of shape (frames, n) by the unknowns, and y itself."""
    sine = np.clip(unknown[:, :-1] @ columns.T, -_STEEPEST, _STEEPEST)
    flat = np.sqrt(1.0 - sine**2)
    rise = _summed(sine / flat, grid)
    steps = _summed((columns.T[None] / flat[:, None] ** 3), grid)
    place = (x - grid[0]) / (grid[1] - grid[0])
    left = np.clip(place.astype(int), 0, len(grid) - 2)
    share = place - left
    rows = np.arange(len(x))[:, None]
    y = (1.0 - share) * rise[rows, left] + share * rise[rows, left + 1]
    design = [
        (1.0 - share) * steps[rows, k, left] + share * steps[rows, k, left + 1]
        for k in range(columns.shape[1])
    ]
    return np.stack([*design, np.ones_like(x)], axis=2), y + unknown[:, -1:]


def _summed(values: Floats, grid: Floats) -> Floats:
    """Integral from the middle of an even grid along the last axis, trapezoids."""
    from scipy.integrate import cumulative_trapezoid  # pulls need not wait for it

    total = cumulative_trapezoid(values, dx=grid[1] - grid[0], initial=0)
    return np.asarray(total - total[..., [len(grid) // 2]], dtype=np.float64)


def _integrals(x: Floats, span: float, terms: int) -> Floats:
    """Integrals of u^k from mid-span to x, k from 1, shape (*x.shape, terms)."""
    left = np.clip(1.0 - 2.0 * np.abs(x) / span, 0.0, None)
    powers = np.arange(2, terms + 2)
    whole = 0.5 * span * (1.0 - left[..., None] ** powers) / powers
    return np.asarray(np.sign(x)[..., None] * whole, dtype=np.float64)
