"""Bending and twist of the *cells* of a line: the half elements on both sides of a node.

The cell of a free node connects the frames of its two elements. A clamp divides the cell in two;
each part connects the frame of the clamp with that of an element. psi is the rotation vector (rad)
from the frame before to the frame behind. The curvature of a cell of length h is psi / h minus its
value at rest, in the mean of both frames. PHYSICS 7 states (2 / h) Im of the quaternion, which is
equal to second order; psi gives exact circles and has no upper limit.

The moment m of a cell, in the mean frame, has the components of the sliders in bending and that of
torsion. Rotations d_a and d_b of the frames before and behind (in the body frame) change psi by A
d_b - A^T d_a with A = 1 + psi x / 2 + c psi x psi x, so that -A m and A^T m act on the frames. The
tangent is the second derivative of the energy along such rotations, which is symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.law.sliders import slide_vector
from labpipe.mechanics.rod.line import Section
from labpipe.mechanics.rod.rotations import (
    compute_tangent_factors,
    conjugate,
    cross,
    multiply,
    skew,
    to_rotation_vectors,
)
from labpipe.records.arrays import Floats

_EYE = np.eye(3)


@dataclass(frozen=True, slots=True, eq=False)
class BentCells:
    """Response of the cells to the frames on both sides.

    Parameters
    ----------
    turns : shape (cells, 3), rad, psi
    curvatures : shape (cells, 3), 1/m, less those at rest
    moments : shape (cells, 3), N m, in the mean frames
    rests : shape (cells, sliders, 2), 1/m, history after the step
    before, behind : shape (cells, 3), N m, derivative of the energy by the turns of the frames
    by_before, by_behind : shape (cells, 3, 3), N m, of `before` by its own frame, of `behind` by
        its own
    across : shape (cells, 3, 3), N m, of `behind` by the frame before
    tangents : shape (cells, 3, 3), A
    """

    turns: Floats
    curvatures: Floats
    moments: Floats
    rests: Floats
    before: Floats
    behind: Floats
    by_before: Floats
    by_behind: Floats
    across: Floats
    tangents: Floats


def bend_cells(
    section: Section,
    frames: tuple[Floats, Floats],
    lengths: Floats,
    rest_curvature: Floats,
    *,
    rests: Floats,
    torques: Floats,
    drag: tuple[float, Floats] | None = None,
) -> BentCells:
    """Compute moments and tangents of cells.

    Parameters
    ----------
    section : of the line
    frames : before and behind, each of shape (cells, 4)
    lengths : shape (cells,), m
    rest_curvature : shape (cells, 3), 1/m, curvatures at rest
    rests : shape (cells, sliders, 2), 1/m, history before the step
    torques : shape (cells,), N m, from stretch
    drag : artificial stiffness of the cells as a share of the first stiffness, and the psi at which
        it has no moment
    """
    psi = to_rotation_vectors(multiply(conjugate(frames[0]), frames[1]))
    curvatures = psi / lengths[:, None] - rest_curvature
    response = slide_vector(section.law, curvatures[:, :2], rests)
    moments = np.empty_like(psi)
    moments[:, :2] = response.moment
    moments[:, 2] = section.torsional_stiffness * curvatures[:, 2] + torques
    stiffness = np.zeros((len(psi), 3, 3))
    stiffness[:, :2, :2] = response.stiffness
    stiffness[:, 2, 2] = section.torsional_stiffness
    stiffness /= lengths[:, None, None]
    if drag is not None:
        bending = section.law.first_stiffness
        three = np.array([bending, bending, section.torsional_stiffness])
        drags = drag[0] * three / lengths[:, None]
        moments += drags * (psi - drag[1])
        stiffness += drags[:, :, None] * _EYE
    first, second = compute_tangent_factors(np.sqrt(np.vecdot(psi, psi)))
    tangents, geometric = _compute_tangents(psi, moments, first, second)
    turned = np.swapaxes(tangents, 1, 2)
    half = 0.5 * skew(moments)
    up = turned @ stiffness + geometric + half
    down = tangents @ stiffness + geometric - half
    return BentCells(
        psi,
        curvatures,
        moments,
        response.rests,
        -_multiply_vectors(tangents, moments),
        _multiply_vectors(turned, moments),
        _symmetrise(down @ turned),
        _symmetrise(up @ tangents),
        -up @ turned,
        tangents,
    )


def _multiply_vectors(matrices: Floats, vectors: Floats) -> Floats:
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])


def _symmetrise(matrices: Floats) -> Floats:
    return np.asarray(0.5 * (matrices + np.swapaxes(matrices, 1, 2)))


def _compute_tangents(
    psi: Floats, moments: Floats, first: Floats, second: Floats
) -> tuple[Floats, Floats]:
    """Return A, and the derivative by psi of c psi x (psi x m)."""
    c = first[:, None, None]
    outer = psi[:, :, None] * psi[:, None, :]
    square = np.vecdot(psi, psi)[:, None, None]
    tangents = _EYE + 0.5 * skew(psi) + c * (outer - square * _EYE)
    along = np.vecdot(psi, moments)[:, None, None]
    mixed = psi[:, :, None] * moments[:, None, :]
    twice = cross(psi, cross(psi, moments))
    geometric = c * (along * _EYE + mixed - 2.0 * np.swapaxes(mixed, 1, 2))
    geometric += (second[:, None] * twice)[:, :, None] * psi[:, None, :]
    return tangents, geometric
