"""Multiply and convert arrays of unit quaternions (w, x, y, z) and rotation vectors.

A frame is a unit quaternion that rotates vectors from the material to space. Its third axis d3 is
the direction of the line. A rotation vector psi (rad) is a rotation by |psi| about psi.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats

_LEFT_INDICES = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])
_LEFT_SIGNS = np.array([[1, -1, -1, -1], [1, 1, -1, 1], [1, 1, 1, -1], [1, -1, 1, 1]], float)
"""Indices and signs of the components of the left factor, for each component of a product."""
_NEXT_AXIS, _LAST_AXIS = np.array([1, 2, 0]), np.array([2, 0, 1])
"""For each axis, the second and the third axis in cyclic order."""
_PAIRS_1 = np.array([[2, 1, 1], [1, 1, 2], [1, 2, 1]]), np.array([[2, 2, 3], [2, 1, 3], [3, 3, 1]])
_PAIRS_2 = np.array([[3, 0, 0], [0, 3, 0], [0, 0, 2]]), np.array([[3, 3, 2], [3, 3, 1], [2, 1, 2]])
_FACTORS_1 = np.array([[-2.0, 2.0, 2.0], [2.0, -2.0, 2.0], [2.0, 2.0, -2.0]])
_FACTORS_2 = np.array([[-2.0, -2.0, 2.0], [2.0, -2.0, -2.0], [-2.0, 2.0, -2.0]])
"""Each entry of a rotation matrix has two products of two components: their indices and factors."""
_IDENTITY = np.eye(3)
_CONJUGATE_SIGNS = np.array([1.0, -1.0, -1.0, -1.0])
_MIN_SIZE = 1e-150
"""Smallest divisor, which avoids a division by zero."""


def multiply(left: Floats, right: Floats) -> Floats:
    """Multiply quaternions, shape (..., 4); the product rotates by `right`, then by `left`."""
    left_matrices = left.take(_LEFT_INDICES, axis=-1) * _LEFT_SIGNS
    return np.asarray(np.vecdot(left_matrices, right[..., None, :]))


def conjugate(frames: Floats) -> Floats:
    """Return the quaternions of the inverse rotations, shape (..., 4)."""
    return np.asarray(frames * _CONJUGATE_SIGNS)


def cross(u: Floats, v: Floats) -> Floats:
    """Compute the vector product, shape (..., 3), several times faster than `numpy.cross`."""
    positive_terms = u.take(_NEXT_AXIS, axis=-1) * v.take(_LAST_AXIS, axis=-1)
    return np.asarray(positive_terms - u.take(_LAST_AXIS, axis=-1) * v.take(_NEXT_AXIS, axis=-1))


def skew(vectors: Floats) -> Floats:
    """Return matrices of the vector product, skew(u) @ v = u x v, shape (..., 3, 3)."""
    matrices = np.zeros((*vectors.shape, 3))
    matrices[..., 0, 1], matrices[..., 0, 2] = -vectors[..., 2], vectors[..., 1]
    matrices[..., 1, 0], matrices[..., 1, 2] = vectors[..., 2], -vectors[..., 0]
    matrices[..., 2, 0], matrices[..., 2, 1] = -vectors[..., 1], vectors[..., 0]
    return matrices


def from_rotation_vectors(vectors: Floats) -> Floats:
    """Return quaternions, shape (..., 4), of rotation vectors, rad, shape (..., 3)."""
    half_angle = 0.5 * np.sqrt(np.vecdot(vectors, vectors))
    frames = np.empty((*vectors.shape[:-1], 4))
    frames[..., 0] = np.cos(half_angle)
    divisor = np.maximum(half_angle, _MIN_SIZE)
    frames[..., 1:] = (0.5 * np.sin(divisor) / divisor)[..., None] * vectors
    return frames


def to_rotation_vectors(frames: Floats) -> Floats:
    """Return rotation vectors of quaternions, rad, of magnitude up to pi, shape (..., 3)."""
    real, imaginary = frames[..., 0], frames[..., 1:]
    norm = np.maximum(np.sqrt(np.vecdot(imaginary, imaginary)), _MIN_SIZE)
    scale = np.copysign(2.0, real) * np.arctan2(norm, np.abs(real)) / norm
    return np.asarray(scale[..., None] * imaginary)


def to_matrices(frames: Floats) -> Floats:
    """Return rotation matrices, shape (..., 3, 3); the columns are d1, d2, d3."""
    first_products, second_products = (
        frames.take(first, axis=-1) * frames.take(second, axis=-1) * factor
        for (first, second), factor in ((_PAIRS_1, _FACTORS_1), (_PAIRS_2, _FACTORS_2))
    )
    return np.asarray(_IDENTITY + first_products + second_products)


def normalise(vectors: Floats) -> Floats:
    """Normalise vectors or quaternions along the last axis to length one."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def build_frame(direction: Floats, up: Floats) -> Floats:
    """Build the frame with d3 along a direction and d1 as near to `up` as possible, shape (4,).

    Parameters
    ----------
    direction, up : shape (3,), vectors of any length, not parallel

    Raises
    ------
    ValueError
        If a vector is zero or both are parallel.
    """
    min_angle = 1e-9  # between vectors that are not parallel, rad
    d3 = np.asarray(direction, dtype=np.float64)
    normal = cross(d3, np.asarray(up, dtype=np.float64))
    if not np.linalg.norm(normal) > min_angle * np.linalg.norm(d3) * np.linalg.norm(up):
        vectors = [np.asarray(vector).tolist() for vector in (direction, up)]
        raise ValueError(
            format_sentence("mechanics.rod.parallel", direction=vectors[0], up=vectors[1])
        )
    d3, d2 = normalise(d3), normalise(normal)
    rotation = Rotation.from_matrix(np.stack([cross(d2, d3), d2, d3], axis=1))
    return np.asarray(rotation.as_quat(canonical=True, scalar_first=True))


def compute_shortest_rotations(start: Floats, end: Floats) -> Floats:
    """Compute the quaternions of the smallest rotations between unit vectors, shape (..., 4).

    The rotation between opposite vectors is about an arbitrary axis normal to them.
    """
    rotations = np.empty((*start.shape[:-1], 4))
    rotations[..., 0] = 1.0 + np.vecdot(start, end)
    rotations[..., 1:] = cross(start, end)
    max_sum = 1e-12  # 1 + cosine of the angle between vectors that count as opposite
    is_opposite = rotations[..., 0] < max_sum
    if np.any(is_opposite):
        axes = _IDENTITY[np.argmin(np.abs(start[is_opposite]), axis=-1)]
        rotations[is_opposite, 0] = 0.0
        rotations[is_opposite, 1:] = cross(start[is_opposite], axes)
    return normalise(rotations)


def compute_tangent_factors(angles: Floats) -> tuple[Floats, Floats]:
    """Compute the coefficient c(theta) of the inverse tangent map, and c'(theta) / theta.

    Parameters
    ----------
    angles : angles theta, any shape, rad, below 2 pi

    Notes
    -----
    A small rotation d in the body frame changes a rotation vector psi of magnitude theta by
    d + psi x d / 2 + c psi x (psi x d), with c = (1 - (theta / 2) cot(theta / 2)) / theta^2.
    """
    max_series_angle = 0.3  # rad; for smaller angles the series are more accurate
    x = angles**2
    c_series = 1 / 12 + x * (1 / 720 + x * (1 / 30240 + x * (1 / 1209600 + x / 47900160)))
    slope_series = 1 / 360 + x * (1 / 7560 + x * (1 / 201600 + x / 5987520))
    is_small = angles < max_series_angle
    if is_small.all():
        return c_series, slope_series
    theta = np.where(is_small, 1.0, angles)
    half_angle = 0.5 * theta
    cotangent = np.cos(half_angle) / np.sin(half_angle)
    c = (1.0 - half_angle * cotangent) / theta**2
    slope = (0.5 * (half_angle / np.sin(half_angle) ** 2 - cotangent) - 2.0 * theta * c) / theta**3
    return np.where(is_small, c_series, c), np.where(is_small, slope_series, slope)
