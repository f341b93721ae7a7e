"""Choose a few points of a concave law so that linear interpolation has the smallest error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.law.plays import PlayLaw, make_polygon_law, require, require_rising
from labpipe.records.arrays import ArrayRecord, Floats, Ints, Vector


@dataclass(frozen=True, slots=True, eq=False)
class ThinnedLaw(ArrayRecord):
    """Points chosen from a moment-curvature law, with decreasing slopes between them.

    Parameters
    ----------
    curvature : shape (points,), 1/m, from 0 to the end of the range
    moment : shape (points,), N m
    error : largest difference between the polygon through these points and the moments of the law,
        relative to these moments
    """

    curvature: Vector
    moment: Vector
    error: float


def thin_law(curvature: Floats, moment: Floats, *, max_points: int) -> ThinnedLaw:
    """Choose the points of a law with the smallest interpolation error, including both ends.

    Parameters
    ----------
    curvature : shape (n,), 1/m, from 0, increasing, n >= 2
    moment : shape (n,), N m, from 0, increasing
    max_points : largest number of points, at least 2

    Returns
    -------
    The points. Each slope is smaller than the preceding slope by at least a millionth, as required
    by programs that use the first slope as the elastic stiffness.

    Raises
    ------
    ValueError
        If `curvature` and `moment` differ in length or have fewer than two points, `max_points` is
        not a whole number >= 2, a moment is not finite, the first point is not (0, 0), the
        curvature does not increase, or the moment does not increase (the message states the
        curvature).

    Notes
    -----
    Between neighbouring points of the law, the relative error is a quotient of two linear
    functions. It is therefore largest at a point of the law.

    The chosen points are corners of the concave hull (Andrew's monotone chain [2]_). On a concave
    polygon the error of a chord increases with the distance of its two corners. A greedy choice
    within a tolerance therefore needs the fewest points [1]_. The tolerance is found by bisection.
    When few choices remain, each search requires an error slightly smaller than the smallest so
    far. For a concave law no other choice has a smaller error. The error includes the difference
    between law and hull.

    References
    ----------
    .. [1] H. Imai and M. Iri, Computational-geometric methods for polygonal approximations of a
           curve, Computer Vision, Graphics, and Image Processing 36 (1986) 31-41.
    .. [2] A. M. Andrew, Another efficient algorithm for convex hulls in two dimensions, Information
           Processing Letters 9 (1979) 216-219.
    """
    _require_law(curvature, moment, max_points)
    corners = find_hull(curvature, moment)
    x, y = curvature[corners], moment[corners]
    choice = np.arange(len(x)) if len(x) <= max_points else _choose_corners(x, y, max_points)
    x, y = x[choice], y[choice]
    return ThinnedLaw(x, y, _compute_error(x, y, curvature, moment))


def _require_law(curvature: Floats, moment: Floats, max_points: int) -> None:
    """Raise ValueError if an argument of `thin_law` is outside its range."""
    holds = isinstance(max_points, int) and max_points >= 2
    require("max_points", max_points, "a whole number >= 2", holds=holds)
    lengths = len(curvature), len(moment)
    require("numbers of points", lengths, "equal and >= 2", holds=1 < lengths[0] == lengths[1])
    holds = bool(curvature[0] == moment[0] == 0.0 and np.isfinite(moment).all())
    first_point = float(curvature[0]), float(moment[0])
    require("first point", first_point, "(0, 0), and all moments finite", holds=holds)
    require_rising("curvature", curvature[1:])
    if np.any(np.diff(moment) <= 0.0):
        kappa = curvature[int(np.argmax(np.diff(moment) <= 0.0)) + 1]
        message = f"the law softens before curvature={kappa:.6g} 1/m: the moment must increase"
        raise ValueError(message)


def find_hull(curvature: Floats, moment: Floats, *, min_slope_drop: float = 1e-6) -> Ints:
    """Return the indices of the corners of the concave hull of a law, including both ends.

    Parameters
    ----------
    curvature, moment : as for `thin_law`
    min_slope_drop : smallest relative decrease of the slope at a corner
    """
    slopes = np.diff(moment) / np.diff(curvature)
    if np.all(slopes[1:] < slopes[:-1] * (1.0 - min_slope_drop)):
        return np.arange(len(moment))
    x, y = curvature.tolist(), moment.tolist()  # indexing a list is faster than indexing an array
    corners: list[int] = [0]
    for point in range(1, len(x)):
        while len(corners) > 1:
            start, corner = corners[-2], corners[-1]
            slope_in = (y[corner] - y[start]) / (x[corner] - x[start])
            slope_out = (y[point] - y[corner]) / (x[point] - x[corner])
            if slope_out < slope_in * (1.0 - min_slope_drop):
                break
            corners.pop()
        corners.append(point)
    return np.array(corners, dtype=np.int64)


def require_concave(curvature: Floats, moment: Floats, hull: Ints) -> None:
    """Raise ValueError if a law is too far below its concave hull.

    Parameters
    ----------
    curvature, moment : as for `thin_law`
    hull : indices of the corners of the hull, from `find_hull`

    Raises
    ------
    ValueError
        If the hull is more than 1 % of the moment above the law. The message states the curvature.
    """
    max_excess = 0.01  # relative to the moment of the law
    hull_moment = np.interp(curvature[1:], curvature[hull], moment[hull])
    excess = hull_moment / moment[1:] - 1.0
    if np.any(excess > max_excess):
        row = int(np.argmax(excess))
        message = (
            f"the law stiffens at curvature={curvature[row + 1]:.6g} 1/m: its concave hull is "
            f"{100.0 * excess[row]:.2g} % above it; expected at most {100.0 * max_excess:.0f} %"
        )
        raise ValueError(message)


def make_concave_law(curvature: Floats, moment: Floats) -> PlayLaw:
    """Build the law whose first loading is the concave hull of given points.

    The points may stiffen because of rounding in a table, or under tension. The hull replaces such
    points. The result is otherwise that of `make_polygon_law`.

    Parameters
    ----------
    curvature : shape (n,), 1/m, positive and increasing, n >= 1
    moment : shape (n,), N m

    Raises
    ------
    ValueError
        If the hull does not increase, or for the reasons of `require_concave`.
    """
    x, y = np.append(0.0, curvature), np.append(0.0, moment)
    hull = find_hull(x, y, min_slope_drop=0.0)
    require_concave(x, y, hull)
    return make_polygon_law(x[hull][1:], y[hull][1:])


def _choose_corners(x: Floats, y: Floats, max_points: int) -> Ints:
    """Return the indices of at most `max_points` corners with the smallest error.

    The smallest error is between `low`, an error that needs more points, and `high`, the error of
    `best`.
    """
    end_width = 1e-6  # relative width of the interval at which the search ends
    bisection_width = 0.02  # relative width of the interval at which the bisection ends
    best = np.array([0, len(x) - 1])
    low, high = 0.0, _compute_error(x[best], y[best], x, y)
    x_list, y_list = x.tolist(), y.tolist()
    while high - low > end_width * high:
        # The first tolerance assumes that errors decrease with the square of the number of chords.
        tolerance = float(np.sqrt(low * high) or high * ((len(best) - 1) / (max_points - 0.5)) ** 2)
        if high - low < bisection_width * high:  # few better choices remain, often none
            tolerance = (1.0 - 0.9 * end_width) * high
        choice = _skip_corners(x_list, y_list, tolerance, max_points)
        if len(choice) > max_points:
            low = tolerance
        else:
            best = np.array(choice)
            high = min(tolerance, _compute_error(x[best], y[best], x, y))
    return best


def _skip_corners(x: list[float], y: list[float], tolerance: float, max_points: int) -> list[int]:
    """Choose the fewest corners with errors within a relative tolerance.

    The choice stops at one more than `max_points`.
    """
    choice, min_slope, factor = [0], -np.inf, 1.0 - tolerance
    start_x, start_y = previous_x, previous_y = x[0], y[0]
    for point, (curvature, moment) in enumerate(zip(x[1:], y[1:], strict=True)):
        # A chord is below the skipped corners. Each of these gives a lower limit of its slope.
        if moment - start_y < min_slope * (curvature - start_x):
            choice.append(point)
            if len(choice) == max_points:
                break
            start_x, start_y, min_slope = previous_x, previous_y, -np.inf
        slope = (factor * moment - start_y) / (curvature - start_x)
        min_slope = slope if slope > min_slope else min_slope  # faster than `max`
        previous_x, previous_y = curvature, moment
    return [*choice, len(x) - 1]


def _compute_error(x: Floats, y: Floats, curvature: Floats, moment: Floats) -> float:
    """Return the largest relative error of the polygon through (x, y) at the points of a law."""
    polygon_moment = np.interp(curvature[1:], x, y)
    return float(np.max(np.abs(polygon_moment / moment[1:] - 1.0)))
