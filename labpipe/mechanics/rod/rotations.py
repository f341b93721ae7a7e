"""Algebra of unit quaternions (w, x, y, z) and rotation vectors, on whole arrays.

A frame is a unit quaternion that rotates vectors from the material to space; its third axis d3 is
the direction of the line. A rotation vector psi (rad) is a rotation by |psi| about psi.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats

_FACTOR = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])
_SIGN = np.array([[1, -1, -1, -1], [1, 1, -1, 1], [1, 1, 1, -1], [1, -1, 1, 1]], dtype=np.float64)
"""Indices and signs of the left factor for each component of a product."""
_NEXT, _AFTER_NEXT = np.array([1, 2, 0]), np.array([2, 0, 1])
_FIRST = np.array([[2, 1, 1], [1, 1, 2], [1, 2, 1]]), np.array([[2, 2, 3], [2, 1, 3], [3, 3, 1]])
_SECOND = np.array([[3, 0, 0], [0, 3, 0], [0, 0, 2]]), np.array([[3, 3, 2], [3, 3, 1], [2, 1, 2]])
_OF_FIRST = np.array([[-2.0, 2.0, 2.0], [2.0, -2.0, 2.0], [2.0, 2.0, -2.0]])
_OF_SECOND = np.array([[-2.0, -2.0, 2.0], [2.0, -2.0, -2.0], [-2.0, 2.0, -2.0]])
"""Components in the two products of each entry of a rotation matrix, and factors of the products"""
_EYE = np.eye(3)
_INVERSE = np.array([1.0, -1.0, -1.0, -1.0])


def multiply(left: Floats, right: Floats) -> Floats:
    """Multiply quaternions, shape (..., 4): rotation by `right`, then by `left`."""
    return np.asarray(np.vecdot(left.take(_FACTOR, axis=-1) * _SIGN, right[..., None, :]))


def conjugate(frames: Floats) -> Floats:
    """Invert rotations, shape (..., 4)."""
    return np.asarray(frames * _INVERSE)


def cross(u: Floats, v: Floats) -> Floats:
    """Compute the vector product, shape (..., 3), several times faster than `numpy.cross`."""
    positive_terms = u.take(_NEXT, axis=-1) * v.take(_AFTER_NEXT, axis=-1)
    return np.asarray(positive_terms - u.take(_AFTER_NEXT, axis=-1) * v.take(_NEXT, axis=-1))


def skew(vectors: Floats) -> Floats:
    """Return matrices of the vector product: skew(u) @ v = u x v, shape (..., 3, 3)."""
    out = np.zeros((*vectors.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -vectors[..., 2], vectors[..., 1]
    out[..., 1, 0], out[..., 1, 2] = vectors[..., 2], -vectors[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -vectors[..., 1], vectors[..., 0]
    return out


def from_rotation_vectors(vectors: Floats) -> Floats:
    """Return quaternions of rotation vectors, rad, shape (..., 3)."""
    half = 0.5 * np.sqrt(np.vecdot(vectors, vectors))
    out = np.empty((*vectors.shape[:-1], 4))
    out[..., 0] = np.cos(half)
    size = np.maximum(half, 1e-150)
    out[..., 1:] = (0.5 * np.sin(size) / size)[..., None] * vectors
    return out


def to_rotation_vectors(frames: Floats) -> Floats:
    """Return rotation vectors of quaternions, rad, of magnitude up to pi, shape (..., 3)."""
    real, imaginary = frames[..., 0], frames[..., 1:]
    size = np.maximum(np.sqrt(np.vecdot(imaginary, imaginary)), 1e-150)
    scale = np.copysign(2.0, real) * np.arctan2(size, np.abs(real)) / size
    return np.asarray(scale[..., None] * imaginary)


def to_matrices(frames: Floats) -> Floats:
    """Return rotation matrices, shape (..., 3, 3); the columns are d1, d2, d3."""
    first_products, second_products = (
        frames.take(first, axis=-1) * frames.take(second, axis=-1) * factor
        for (first, second), factor in ((_FIRST, _OF_FIRST), (_SECOND, _OF_SECOND))
    )
    return np.asarray(_EYE + first_products + second_products)


def unit(vectors: Floats) -> Floats:
    """Normalise vectors or quaternions along the last axis."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def build_frame(direction: Floats, up: Floats) -> Floats:
    """Build the frame with d3 along a direction and d1 as near to `up` as possible, shape (4,).

    Parameters
    ----------
    direction, up : shape (3,), of any length, not parallel

    Raises
    ------
    ValueError
        If one is zero or both are parallel.
    """
    d3 = np.asarray(direction, dtype=np.float64)
    across = cross(d3, np.asarray(up, dtype=np.float64))
    if not np.linalg.norm(across) > 1e-9 * np.linalg.norm(d3) * np.linalg.norm(up):
        vectors = [np.asarray(vector).tolist() for vector in (direction, up)]
        raise ValueError(
            format_sentence("mechanics.rod.parallel", direction=vectors[0], up=vectors[1])
        )
    d3, d2 = unit(d3), unit(across)
    rotation = Rotation.from_matrix(np.stack([cross(d2, d3), d2, d3], axis=1))
    return np.asarray(rotation.as_quat(canonical=True, scalar_first=True))


def find_shortest_turns(start: Floats, end: Floats) -> Floats:
    """Find the quaternions of the smallest rotations between unit vectors, shape (..., 4).

    Opposite vectors are rotated about an arbitrary axis normal to them.
    """
    out = np.empty((*start.shape[:-1], 4))
    out[..., 0] = 1.0 + np.vecdot(start, end)
    out[..., 1:] = cross(start, end)
    opposite = out[..., 0] < 1e-12
    if np.any(opposite):
        axes = np.eye(3)[np.argmin(np.abs(start[opposite]), axis=-1)]
        out[opposite, 0] = 0.0
        out[opposite, 1:] = cross(start[opposite], axes)
    return unit(out)


def compute_tangent_factors(angles: Floats) -> tuple[Floats, Floats]:
    """Compute the coefficient c(theta) of the inverse tangent map, and c'(theta) / theta.

    Parameters
    ----------
    angles : rad, below 2 pi

    Notes
    -----
    A small turn d in the body frame changes a rotation vector psi of magnitude theta by
    (1 + psi x / 2 + c psi x psi x) d, c = (1 - (theta / 2) cot(theta / 2)) / theta^2.
    """
    series_below = 0.3  # rad; below it the series are more accurate than the closed forms
    x = angles**2
    series = 1 / 12 + x * (1 / 720 + x * (1 / 30240 + x * (1 / 1209600 + x / 47900160)))
    slopes = 1 / 360 + x * (1 / 7560 + x * (1 / 201600 + x / 5987520))
    small = angles < series_below
    if small.all():
        return series, slopes
    size = np.where(small, 1.0, angles)
    half = 0.5 * size
    cotangent = np.cos(half) / np.sin(half)
    first = (1.0 - half * cotangent) / size**2
    second = (0.5 * (half / np.sin(half) ** 2 - cotangent) - 2.0 * size * first) / size**3
    return np.where(small, series, first), np.where(small, slopes, second)
