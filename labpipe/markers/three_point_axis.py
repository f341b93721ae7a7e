"""Assign markers on a specimen in three-point bending to sections, and fit its shape and twist."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Flags, Floats, Ints

MARKER_DIRECTIONS = {
    "load": ((1.0, 0.0),),
    "away": ((-1.0, 0.0),),
    "side": ((0.0, 1.0), (0.0, -1.0)),
}
"""Possible directions (y, z) from the axis to the markers, keyed by the side of the markers."""
N_TERMS = 3
"""Number of powers in the curvature of a shape."""
_GRID_POINTS = 161
"""Number of points of the grid on which shapes are integrated."""
_MAX_SLOPE_SINE = 0.97
"""Limit of the sine of the slope of a shape, to which larger values are clipped."""


@dataclass(frozen=True, slots=True, eq=False)
class Sections(ArrayRecord):
    """Markers in the frame of the specimen, and the section of each marker.

    In this frame, x is along the specimen at rest, y along the motion, and z out of the plane of
    bending. The origin is the mean position of the markers at rest.

    Parameters
    ----------
    markers : shape (frames, markers, 3), m, positions; NaN where missing
    rest_xyz : shape (markers, 3), m, mean positions of the markers over the frames at rest
    section_index : shape (markers,), index of the section of each marker, counted along x from 0
    marker_columns : shape (markers,), indices of the markers among all recorded markers
    rotation_lab_to_specimen : shape (3, 3), rotation from the frame of the cameras to this frame
    """

    markers: Annotated[Floats, "frames", "markers", 3]
    rest_xyz: Annotated[Floats, "markers", 3]
    section_index: Annotated[Ints, "markers"]
    marker_columns: Annotated[Ints, "markers"]
    rotation_lab_to_specimen: Annotated[Floats, 3, 3]

    @property
    def n_sections(self) -> int:
        """Number of sections."""
        return int(self.section_index.max(initial=-1)) + 1

    @property
    def x(self) -> Floats:
        """Mean x of the markers of each section at rest, shape (sections,), m."""
        x, index = self.rest_xyz[:, 0], self.section_index
        return np.array([x[index == section].mean() for section in range(self.n_sections)])


def find_sections(markers_lab: Floats, is_at_rest: Flags, *, min_distance: float) -> Sections:
    """Find the coordinate frame and the sections of a specimen on two supports.

    Parameters
    ----------
    markers_lab : shape (frames, markers, 3), m, in the frame of the cameras; NaN where missing
    is_at_rest : shape (frames,), flags of frames in which the specimen is straight and at rest
    min_distance : smallest distance between two sections along x, m; closer markers share a section

    Returns
    -------
    The sections, without markers that are visible in fewer than three frames at rest.

    Raises
    ------
    ValueError
        If fewer than three markers are visible at rest, or no section moves by more than 1 um.

    Notes
    -----
    At rest, the markers spread most along x. y is perpendicular to x, along the path of the mean
    position of the markers in the section that moves farthest. A rotation about the axis hardly
    changes this mean.
    """
    min_frames_at_rest = 3
    n_frames = np.isfinite(markers_lab[is_at_rest]).all(axis=2).sum(axis=0)
    is_measured = n_frames >= min_frames_at_rest
    markers = markers_lab[:, is_measured]
    if markers.shape[1] < 3:
        raise ValueError(format_sentence("markers.few_section_markers", count=markers.shape[1]))
    rest_xyz = np.nanmean(markers[is_at_rest], axis=0)
    centre = rest_xyz.mean(axis=0)
    x = np.linalg.svd(rest_xyz - centre, full_matrices=False)[2][0]
    rest_x = (rest_xyz - centre) @ x
    section_index: Ints = np.empty(len(rest_x), dtype=np.int64)
    order = np.argsort(rest_x)
    section_index[order] = np.append(0, np.cumsum(np.diff(rest_x[order]) > min_distance))
    y = _find_motion_direction(markers - rest_xyz, section_index, x)
    rotation = np.stack([x, y, np.cross(x, y)])
    return Sections(
        markers=(markers - centre) @ rotation.T,
        rest_xyz=(rest_xyz - centre) @ rotation.T,
        section_index=section_index,
        marker_columns=np.flatnonzero(is_measured),
        rotation_lab_to_specimen=rotation,
    )


def _find_motion_direction(motion: Floats, section_index: Ints, x: Floats) -> Floats:
    """Find the direction of motion, perpendicular to x, of the section with the largest motion."""
    min_motion = 1e-6  # m; a smaller motion is below the resolution of the cameras
    transverse_motion = motion - (motion @ x)[..., None] * x
    sections = [section_index == index for index in range(section_index.max() + 1)]
    paths = np.stack([transverse_motion[:, in_section].mean(axis=1) for in_section in sections])
    max_distances = np.nanmax(np.nan_to_num(np.linalg.norm(paths, axis=2)), axis=1)
    path = paths[int(np.argmax(max_distances))]
    path = path[np.isfinite(path).all(axis=1)]
    if not max_distances.max() > min_motion or not len(path):
        raise ValueError(format_sentence("markers.not_bent"))
    direction = np.linalg.svd(path, full_matrices=False)[2][0]  # a unit vector perpendicular to x
    sign = np.sign(float(path[np.argmax(np.abs(path @ direction))] @ direction))
    return np.asarray(sign * direction, dtype=np.float64)


def fit_rest_axis(sections: Sections, *, radius: float, direction: tuple[float, float]) -> Floats:
    """Fit y and z of the axis at rest, from which all markers have the distance `radius`.

    Parameters
    ----------
    sections : sections of the specimen
    radius : distance from the axis to the centre of a marker, m
    direction : approximate direction (y, z) from the axis to the markers, a unit vector

    Returns
    -------
    Shape (2,), m, y and z of the axis.

    Notes
    -----
    The sum of squares of (distance from the axis - radius) is minimised by the Gauss-Newton method
    with steps of minimum norm. Markers in one row do not determine the direction from the axis,
    which is then `direction`. For a radius of zero, the axis is the mean of the markers.
    """
    max_steps, min_singular_ratio = 20, 0.05  # smaller singular values are those of a row
    points = sections.rest_xyz[:, 1:]
    axis = points.mean(axis=0) - radius * np.asarray(direction)
    for _ in range(max_steps if radius > 0.0 else 0):
        offsets = points - axis
        distances = np.linalg.norm(offsets, axis=1)
        jacobian, misfit = -offsets / distances[:, None], radius - distances
        axis = axis + np.linalg.lstsq(jacobian, misfit, rcond=min_singular_ratio)[0]
    return np.asarray(axis, dtype=np.float64)


def compute_twist(sections: Sections, slope: Floats, *, radius: float) -> tuple[Floats, Floats]:
    """Compute the twist of every section about the axis, relative to rest.

    Parameters
    ----------
    sections : sections of the specimen
    slope : shape (frames, sections), rad, angle of the axis in the plane of bending
    radius : distance from the axis to the centre of a marker, m

    Returns
    -------
    twist : shape (frames, sections), rad, from y towards z; NaN where a marker of the section is
        missing, or where `lever_arm` is 0
    lever_arm : shape (sections,), m, lever arm of the markers: noise of standard deviation s in a
        position causes a standard deviation s / lever_arm of the twist. The lever arm is 0 for a
        section with one marker, or with markers too close together to determine the twist

    Notes
    -----
    The twist is the least-squares rotation of the markers of a section from rest about their mean,
    in the plane normal to the axis. The position of the axis has no effect on it. Let the complex
    numbers a and b be the positions in this plane, relative to their mean, at rest and in a frame.
    The twist is the angle of sum(conj(a) b), the two-dimensional solution of Kabsch.
    """
    min_spread = 0.3 * max(radius, 1e-9)  # m; closer markers do not determine the twist
    twist = np.full((len(sections.markers), sections.n_sections), np.nan)
    lever_arm = np.zeros(sections.n_sections)
    for index in range(sections.n_sections):
        in_section = sections.section_index == index
        rest_position = sections.rest_xyz[in_section, 1] + 1j * sections.rest_xyz[in_section, 2]
        rest_position = rest_position - rest_position.mean()
        spread = float(np.sqrt(np.sum(np.abs(rest_position) ** 2)))
        if in_section.sum() < 2 or spread < min_spread:
            continue
        lever_arm[index] = spread
        x, y, z = np.moveaxis(sections.markers[:, in_section], 2, 0)
        angle = slope[:, index, None]
        position = np.cos(angle) * y - np.sin(angle) * x + 1j * z
        position = position - position.mean(axis=1, keepdims=True)
        twist[:, index] = np.angle(np.sum(np.conj(rest_position) * position, axis=1))
    return twist, lever_arm


def compute_section_centres(
    sections: Sections, axis: Floats, slope: Floats, twist: Floats
) -> Floats:
    """Compute the point of the axis at every section.

    Parameters
    ----------
    sections : sections of the specimen
    axis : shape (2,), m, y and z of the axis at rest
    slope : shape (frames, sections), rad, angle of the axis in the plane of bending
    twist : shape (frames, sections), rad, from y towards z; NaN is interpolated between sections,
        or replaced by 0 if no twist of the frame is known

    Returns
    -------
    Shape (frames, sections, 3), m; NaN where no marker of a section is in sight.

    Notes
    -----
    A marker is rigidly joined to a section, which rotates by `twist` about the axis and by `slope`
    in the plane of bending. The rotated offset from the axis is subtracted from the position of
    each marker, and the results of a section are averaged.
    """
    x, filled_twist = sections.x, _fill_twist(twist)
    centres = np.full((*slope.shape, 3), np.nan)
    for index in range(sections.n_sections):
        in_section = sections.section_index == index
        offset_x, offset_y, offset_z = (sections.rest_xyz[in_section] - [x[index], *axis]).T
        offset_yz = (offset_y + 1j * offset_z) * np.exp(1j * filled_twist[:, index, None])
        offset_xy = (offset_x + 1j * offset_yz.real) * np.exp(1j * slope[:, index, None])
        offset = np.stack([offset_xy.real, offset_xy.imag, offset_yz.imag], axis=2)
        points = sections.markers[:, in_section] - offset
        is_measured = np.isfinite(points).all(axis=2, keepdims=True)
        total, count = np.where(is_measured, points, 0.0).sum(axis=1), is_measured.sum(axis=1)
        centres[:, index] = np.where(count > 0, total, np.nan) / np.maximum(count, 1)
    return centres


def _fill_twist(twist: Floats) -> Floats:
    """Interpolate missing twists between sections; set all to 0 in a frame without a twist."""
    has_twist, indices = np.isfinite(twist), np.arange(twist.shape[1])
    filled_twist = np.where(has_twist.any(axis=1, keepdims=True), twist, 0.0)
    for frame in np.flatnonzero(np.isnan(filled_twist).any(axis=1)):
        is_known = has_twist[frame]
        filled_twist[frame] = np.interp(indices, indices[is_known], twist[frame, is_known])
    return filled_twist


@dataclass(frozen=True, slots=True, eq=False)
class BentAxis:
    """Shapes of the bent axis on two supports, in every frame.

    The curvature is sum_k c_k u^k with u = 1 - 2 abs(x) / span between the supports and 0 beyond
    them. With the integral W_k of u^k from mid-span to x, sin(slope) = tilt - sum_k c_k W_k(x), and
    y is the integral of tan(slope).

    Parameters
    ----------
    coefficients : shape (frames, terms), 1/m, coefficients c_k of the curvature, k from 1
    tilt : shape (frames,), sine of the slope at mid-span
    height : shape (frames,), m, y of mid-span
    residual : shape (frames,), m, root mean square distance of the points from the axis along y
    freedom : shape (frames,), degrees of freedom: measured points minus parameters; 0 without a fit
    span : distance between the supports, m
    """

    coefficients: Floats
    tilt: Floats
    height: Floats
    residual: Floats
    freedom: Floats
    span: float

    @property
    def mid_span_curvature(self) -> Floats:
        """Curvature at mid-span, shape (frames,), 1/m."""
        return np.asarray(self.coefficients.sum(axis=1), dtype=np.float64)

    @property
    def noise(self) -> float:
        """Standard deviation of the noise of y of a point, m, from the residuals of all frames."""
        is_valid = np.isfinite(self.residual) & (self.freedom > 0)
        freedom = self.freedom[is_valid]
        n_points = freedom + self.coefficients.shape[1] + 2
        return float(np.sqrt(np.sum(self.residual[is_valid] ** 2 * n_points) / freedom.sum()))

    def compute_slope_sine(self, x: Floats) -> Floats:
        """Compute the sine of the slope, clipped to `_MAX_SLOPE_SINE`, shape (frames, n).

        Parameters
        ----------
        x : shape (frames, n), m, positions from mid-span
        """
        integrals = _integrate_powers(x, self.span, self.coefficients.shape[1])
        sine = self.tilt[:, None] - np.einsum("fnk,fk->fn", integrals, self.coefficients)
        return np.asarray(np.clip(sine, -_MAX_SLOPE_SINE, _MAX_SLOPE_SINE), dtype=np.float64)

    def compute_y(self, x: Floats) -> Floats:
        """Compute y, shape (frames, n), m, at positions x from mid-span, shape (n,), m."""
        grid = _make_grid(x, margin=1e-6)
        sine = self.compute_slope_sine(np.broadcast_to(grid, (len(self.tilt), len(grid))))
        rise = _integrate(sine / np.sqrt(1.0 - sine**2), grid)
        frame_x = np.broadcast_to(x, (len(rise), len(x)))
        return _interpolate(rise, grid, frame_x) + self.height[:, None]

    @property
    def deflection(self) -> Floats:
        """Deflection of mid-span relative to the supports, shape (frames,), m."""
        support_y = self.compute_y(np.array([-0.5 * self.span, 0.5 * self.span]))
        return np.asarray(self.height - support_y.mean(axis=1), dtype=np.float64)

    @property
    def mean_support_gradient(self) -> Floats:
        """Mean gradient of y towards mid-span at both supports, shape (frames,)."""
        support_x = np.broadcast_to([-0.5 * self.span, 0.5 * self.span], (len(self.tilt), 2))
        sine = self.compute_slope_sine(support_x)
        gradient = sine / np.sqrt(1.0 - sine**2)
        return np.asarray(0.5 * (gradient[:, 0] - gradient[:, 1]), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class SpanShape(ArrayRecord):
    """Fitted shapes of a specimen with sections of markers, in every frame.

    Parameters
    ----------
    axis : bent axis of the specimen, with x from mid-span
    mid_span : x of mid-span in the frame of `Sections`, m
    centres : shape (frames, sections, 3), m, points of the axis relative to mid-span of the axis at
        rest
    twist : shape (frames, sections), rad, rotation about the axis; NaN where unknown
    lever_arm : shape (sections,), m, lever arm of the markers for the twist, from `compute_twist`
    curvature_fewer_terms : shape (frames,), 1/m, curvature at mid-span of a fit with one term less
    side_change : magnitude of the relative change of the curvature at mid-span if the markers are
        assumed to be on the other side of the specimen; 0 if only one side is possible
    """

    axis: BentAxis
    mid_span: float
    centres: Annotated[Floats, "frames", "sections", 3]
    twist: Annotated[Floats, "frames", "sections"]
    lever_arm: Annotated[Floats, "sections"]
    curvature_fewer_terms: Annotated[Floats, "frames"]
    side_change: float = 0.0


def fit_specimen_shape(
    sections: Sections, *, span: float, radius: float, side: str, is_bent: Flags
) -> SpanShape:
    """Fit the bent axis of a specimen on two supports to its markers, in every frame.

    Parameters
    ----------
    sections : markers and their sections
    span : distance between the supports, m
    radius : distance from the axis to the centre of a marker, m
    side : side of the specimen with the markers, a key of `MARKER_DIRECTIONS`
    is_bent : shape (frames,), flags of frames in which the specimen is bent, to find mid-span

    Returns
    -------
    The shapes; NaN in frames with fewer than six measured sections.

    Raises
    ------
    ValueError
        If there are fewer than six sections, fewer than five within one span, or none at 60 % of
        half the span or farther on one side of mid-span.

    Notes
    -----
    At rest, deviations of the sections from a straight line are attributed to the positions of the
    markers, not to a curvature of the specimen. The offset of a marker from the axis rotates with
    the slope and the twist of the section, so shapes and offsets are computed alternately. Mid-span
    is the position with the smallest residuals over at most 30 frames with a bent specimen.
    """
    # The outer sections must be at least 0.6 half spans away from mid-span.
    max_frames, min_reach = 30, 0.6
    if (count := sections.n_sections) < (needed := N_TERMS + 3):
        raise ValueError(format_sentence("markers.few_sections", count=count, needed=needed))
    x = np.sort(sections.x)
    n_inside = max(int(np.sum((x >= start) & (x <= start + span))) for start in x)
    if n_inside < (needed := N_TERMS + 2):
        facts = {"count": count, "inside": n_inside, "span": 1e3 * span}
        raise ValueError(format_sentence("markers.few_inside", needed=needed, **facts))
    bent_markers = sections.markers[is_bent]
    n_sampled = min(max_frames, len(bent_markers))
    sampled_frames = np.linspace(0, len(bent_markers) - 1, n_sampled).astype(int)
    sample = replace(sections, markers=bent_markers[sampled_frames])
    fits = []
    for direction in MARKER_DIRECTIONS[side]:
        axis = fit_rest_axis(sections, radius=radius, direction=direction)
        mid_span, misfit = _fit_mid_span(sample, axis, span, radius)
        shapes = _fit_shapes(sample, axis, mid_span, span, radius)
        curvature = float(np.nanmean(shapes.axis.mid_span_curvature))
        fits.append((misfit, curvature, axis, mid_span))
    fits.sort(key=lambda fit: fit[0])
    (_, curvature, axis, mid_span), (_, other_curvature, *_) = fits[0], fits[-1]
    first_mm, last_mm = 1e3 * (x[[0, -1]] - mid_span)
    reach = 1e3 * min_reach * 0.5 * span  # mm
    if first_mm > -reach or last_mm < reach:
        facts = {"low": first_mm, "high": last_mm, "reach": reach}
        raise ValueError(format_sentence("markers.short_reach", **facts))
    side_change = abs(other_curvature / curvature - 1.0)
    return replace(_fit_shapes(sections, axis, mid_span, span, radius), side_change=side_change)


def _fit_mid_span(
    sample: Sections, axis: Floats, span: float, radius: float
) -> tuple[float, float]:
    """Fit x of mid-span, m, to a sample of frames; return it and the mean square residual, m^2.

    The first guess is the mean position of the markers, weighted by a power of their rise. It is
    refined by the minima of parabolas through mean square residuals.
    """
    half_widths = (5e-3, 1e-3, 2e-4)  # half widths of the parabolas, m
    rise = sample.markers[..., 1] - sample.rest_xyz[:, 1]
    weight = np.clip(np.nanmean(rise, axis=0), 0.0, None) ** 4
    guess = float(np.average(sample.rest_xyz[:, 0], weights=np.nan_to_num(weight) + 1e-30))

    def compute_misfit(mid_span: float) -> float:
        """Compute the mean square residual of the shapes for a position of mid-span, m^2."""
        residual = _fit_shapes(sample, axis, mid_span, span, radius).axis.residual
        return float(np.nanmean(residual**2))

    misfit = compute_misfit(guess)
    for width in half_widths:
        guesses = np.array([guess - width, guess, guess + width])
        misfits = np.array([compute_misfit(guesses[0]), misfit, compute_misfit(guesses[2])])
        a, b, _ = np.polyfit(guesses - guess, misfits, 2)
        step = -0.5 * b / a if a > 0.0 else width * float(np.argmin(misfits) - 1)
        guess += float(np.clip(step, -2.0 * width, 2.0 * width))
        misfit = compute_misfit(guess)
    return guess, misfit


def _fit_shapes(
    sections: Sections, axis: Floats, mid_span: float, span: float, radius: float
) -> SpanShape:
    """Fit the shapes of all frames for a given position of mid-span and of the axis at rest."""
    n_iterations = 3  # of shapes and offsets
    origin = np.array([mid_span, axis[0], axis[1]])
    slope, bent_axis = np.zeros((len(sections.markers), sections.n_sections)), None
    for _ in range(n_iterations):
        twist, lever_arm = compute_twist(sections, slope, radius=radius)
        centres = compute_section_centres(sections, axis, slope, twist) - origin
        bent_axis = fit_bent_axis(centres, span=span, terms=N_TERMS, start=bent_axis)
        slope = np.arcsin(bent_axis.compute_slope_sine(np.nan_to_num(centres[..., 0])))
    assert bent_axis is not None
    curvature = fit_bent_axis(centres, span=span, terms=N_TERMS - 1).mid_span_curvature
    return SpanShape(
        bent_axis, mid_span, centres, twist, lever_arm=lever_arm, curvature_fewer_terms=curvature
    )


def fit_bent_axis(
    points: Floats, *, span: float, terms: int, start: BentAxis | None = None
) -> BentAxis:
    """Fit the axis to points in every frame by least squares.

    Parameters
    ----------
    points : shape (frames, n, 2 or 3), m, x from mid-span, y along the load; NaN where missing
    span : distance between the supports, m
    terms : number of powers of u = 1 - 2 abs(x) / span in the curvature, beginning with u^1
    start : axis fitted to similar points, from which one step is enough; None for straight lines

    Returns
    -------
    The axis in every frame; NaN in frames with fewer than terms + 3 measured points.

    Notes
    -----
    The curvature is -d(sin slope)/dx for any slope, so the sine is linear in the coefficients. y is
    not linear, so the Gauss-Newton method is used, with 3 steps from a straight line. A fourth step
    changes nothing at the slopes in a bending test. The forces of the supports are along y, so the
    moment is linear in x. The first power describes an elastic beam, and higher powers describe the
    nonlinearity of the specimen. The moment is zero at the supports, and the overhangs are
    straight.
    """
    chunk_frames = 400  # frames that are fitted together, to limit the memory
    parameters, n_steps = np.zeros((len(points), terms + 2)), 3
    if start is not None:
        parameters, n_steps = np.column_stack([start.coefficients, start.tilt, start.height]), 1
    parameters = np.nan_to_num(parameters)
    chunks = [
        _fit_chunk(points[i : i + chunk_frames], span, parameters[i : i + chunk_frames], n_steps)
        for i in range(0, len(points), chunk_frames)
    ]
    coefficients, tilt, height, residual, freedom = (
        np.concatenate(arrays) for arrays in zip(*chunks, strict=True)
    )
    return BentAxis(coefficients, tilt, height, residual, freedom=freedom, span=span)


def _fit_chunk(points: Floats, span: float, parameters: Floats, n_steps: int) -> tuple[Floats, ...]:
    """Fit consecutive frames; return coefficients, tilt, height, residual, degrees of freedom."""
    terms = parameters.shape[1] - 2
    is_measured: Flags = np.asarray(np.isfinite(points[..., :2]).all(axis=2))
    has_enough = is_measured.sum(axis=1) >= terms + 3
    x: Floats = np.where(is_measured, points[..., 0], 0.0)
    y: Floats = np.where(is_measured, points[..., 1], 0.0)
    grid = _make_grid(x, margin=1e-3)
    # Derivatives of the sine with respect to coefficients and tilt.
    sine_design = np.column_stack([-_integrate_powers(grid, span, terms), np.ones(len(grid))])
    weight = is_measured.astype(np.float64)
    for _ in range(n_steps):
        design, model_y = _linearise(parameters, sine_design, grid, x)
        design = design * weight[:, :, None]
        normal: Floats = np.einsum("fni,fnj->fij", design, design) + 1e-30 * np.eye(terms + 2)
        right_side = np.einsum("fni,fn->fi", design, (y - model_y) * weight)
        scale = np.sqrt(np.einsum("fii->fi", normal))
        normal = normal / (scale[:, :, None] * scale[:, None, :])
        normal[~has_enough] = np.eye(terms + 2)
        step: Floats = np.linalg.solve(normal, (right_side / scale)[..., None])
        parameters = parameters + step[..., 0] / scale
    _, model_y = _linearise(parameters, sine_design, grid, x)
    squares = np.sum(((y - model_y) * weight) ** 2, axis=1)
    parameters[~has_enough] = np.nan
    n_points = is_measured.sum(axis=1)
    residual = np.where(has_enough, np.sqrt(squares / np.maximum(n_points, 1)), np.nan)
    freedom = np.where(has_enough, n_points - terms - 2.0, 0.0)
    return parameters[:, :terms], parameters[:, terms], parameters[:, -1], residual, freedom


def _linearise(
    parameters: Floats, sine_design: Floats, grid: Floats, x: Floats
) -> tuple[Floats, Floats]:
    """Compute the derivatives of y with respect to the parameters, and y, at x (frames, n).

    The sine of the slope on the grid is `sine_design` times the parameters without the height.
    """
    sine = np.clip(parameters[:, :-1] @ sine_design.T, -_MAX_SLOPE_SINE, _MAX_SLOPE_SINE)
    cosine = np.sqrt(1.0 - sine**2)
    rise = _integrate(sine / cosine, grid)
    derivatives = _integrate(sine_design.T[None] / cosine[:, None] ** 3, grid)
    design = [_interpolate(derivatives[:, k], grid, x) for k in range(sine_design.shape[1])]
    y = _interpolate(rise, grid, x) + parameters[:, -1:]
    return np.stack([*design, np.ones_like(x)], axis=2), y


def _make_grid(x: Floats, margin: float) -> Floats:
    """Make a uniform grid, symmetric about 0, that extends beyond all x by a margin, m."""
    half_range = float(np.abs(x).max()) + margin
    return np.linspace(-half_range, half_range, _GRID_POINTS)


def _interpolate(values: Floats, grid: Floats, x: Floats) -> Floats:
    """Interpolate values (frames, grid points) at x (frames, n) linearly; shape (frames, n)."""
    position = (x - grid[0]) / (grid[1] - grid[0])
    cell = np.clip(position.astype(int), 0, len(grid) - 2)
    weight, rows = position - cell, np.arange(len(x))[:, None]
    return np.asarray((1.0 - weight) * values[rows, cell] + weight * values[rows, cell + 1])


def _integrate(values: Floats, grid: Floats) -> Floats:
    """Integrate along the last axis by the trapezoidal rule, from the middle of a uniform grid."""
    from scipy.integrate import cumulative_trapezoid  # slow import, not needed by tensile tests

    integral = cumulative_trapezoid(values, dx=grid[1] - grid[0], initial=0)
    return np.asarray(integral - integral[..., [len(grid) // 2]], dtype=np.float64)


def _integrate_powers(x: Floats, span: float, terms: int) -> Floats:
    """Integrate u^k from mid-span to x for k from 1 to `terms`, shape (*x.shape, terms)."""
    u = np.clip(1.0 - 2.0 * np.abs(x) / span, 0.0, None)
    powers = np.arange(2, terms + 2)
    integrals = 0.5 * span * (1.0 - u[..., None] ** powers) / powers
    return np.asarray(np.sign(x)[..., None] * integrals, dtype=np.float64)
