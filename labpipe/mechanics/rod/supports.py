"""Compute the cells and element directions of a line with held and clamped nodes.

The direction of an element is its d3. Beside a clamp it is the normalised mean of this d3 and that
of the clamp, with the weight `END_SHARE` of the clamp.

Bending and twist act in the *cells* of a line, the half elements on both sides of a node. The cell
of a free node connects the frames of its two elements. A clamp divides the cell in two half cells.
Each connects the frame of the clamp with that of an element.

The rotation vector psi (rad) is that from the frame before to the frame after a cell. The curvature
of a cell of length h is psi / h minus its value at rest, in the mean of both frames. The form
(2 / h) Im of the quaternion is equal to second order, but psi gives exact circles.

The moment m of a cell, in the mean frame, has the bending components of the sliders and the torque.
Turns d_a and d_b of the frames before and after (rotation vectors in the body frame) change psi by
A d_b - A^T d_a with A = 1 + psi x / 2 + c psi x psi x. Therefore -A m and A^T m act on the frames.
The tangent is the second derivative of the energy with respect to such turns, which is symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from labpipe.mechanics.law.sliders import slide_vector
from labpipe.mechanics.rod.line import Line, Section
from labpipe.mechanics.rod.rotations import (
    compute_tangent_factors,
    conjugate,
    cross,
    from_rotation_vectors,
    multiply,
    skew,
    to_matrices,
    to_rotation_vectors,
)
from labpipe.records.arrays import Floats, Ints

Grip: TypeAlias = tuple[int, bool]
"""Node that is held, and whether its frame is held as well."""

_Cell: TypeAlias = tuple[int, int, int, tuple[float, float], float]
"""Elements or clamps before and after a cell, its node, weights of both sides, and length, m."""

END_SHARE = 1.0 / 6.0
"""Weight of the clamp in the direction of an adjacent element; the rest is that of its own frame.

The half cell at a clamp has the moment of the node instead of that at its middle, which makes the
line too soft. If the direction of the clamp (rotated by the curvature at rest) contributes to that
of the element, the moment is that of a point farther from the clamp. A weight of one sixth removes
the second-order errors of angle and deflection for small bending, and reduces them to less than a
third for large bending.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Supports:
    """Cells and held nodes of a line.

    Parameters
    ----------
    n_nodes : number of nodes of the line
    held : shape (grips,), nodes with a prescribed position
    clamps : shape (clamps,), indices in `held` of nodes with a prescribed frame
    before, after : shape (cells,), element before and after each cell; -1 - k for clamp k
    nodes : shape (cells,), node of each cell
    sides : shape (cells, 2), weights of the two sides of the node in the cell; (1, 0) or (0, 1) at
        a clamp
    lengths : shape (cells,), m, lengths of the cells
    rest_curvature : shape (cells, 3), 1/m, curvatures of the cells at rest
    ends : shape (clamped elements,), elements beside a clamp
    own_weights : shape (clamped elements,), weight of the element's frame in its direction
    clamp_pairs : shape (pairs, 2), row in `ends` and index of the clamp of each contribution
    rest_turns : shape (pairs, 4), quaternions of the rotation at rest from clamp to element
    """

    n_nodes: int
    held: Ints
    clamps: Ints
    before: Ints
    after: Ints
    nodes: Ints
    sides: Floats
    lengths: Floats
    rest_curvature: Floats
    ends: Ints
    own_weights: Floats
    clamp_pairs: Ints
    rest_turns: Floats


def split_supports(line: Line, grips: tuple[Grip, ...]) -> Supports:
    """Divide the cells of a line at its clamps.

    Parameters
    ----------
    line : line with its elements
    grips : held nodes, counted from 0, each at most once, and whether they are clamped
    """
    held_nodes = np.array([node for node, _ in grips], dtype=np.int64)
    clamps = np.array([k for k, (_, is_clamp) in enumerate(grips) if is_clamp], dtype=np.int64)
    clamp_at = {int(held_nodes[k]): number for number, k in enumerate(clamps)}
    rows = [row for node in range(len(line.positions)) for row in _list_cells(line, node, clamp_at)]
    before, after, nodes, sides, lengths = zip(*rows, strict=True) if rows else ((),) * 5
    node_numbers = np.array(nodes, dtype=np.int64)
    rest_curvature = line.rest_curvature_at_nodes
    clamp_pairs, turns = [], []
    for node, number in clamp_at.items():
        for element, sign in ((node - 1, -0.5), (node, 0.5)):
            if 0 <= element < len(line.lengths):
                clamp_pairs.append((element, number))
                turns.append(sign * line.lengths[element] * rest_curvature[node])
    pairs = np.array(clamp_pairs, dtype=np.int64).reshape(-1, 2)
    ends, row = np.unique(pairs[:, 0], return_inverse=True)
    return Supports(
        n_nodes=len(line.positions),
        held=held_nodes,
        clamps=clamps,
        before=np.array(before, dtype=np.int64),
        after=np.array(after, dtype=np.int64),
        nodes=node_numbers,
        sides=np.array(sides, dtype=np.float64).reshape(-1, 2),
        lengths=np.array(lengths, dtype=np.float64),
        rest_curvature=rest_curvature[node_numbers],
        ends=ends,
        own_weights=np.asarray(
            1.0 - END_SHARE * np.bincount(row, minlength=len(ends)), dtype=np.float64
        ),
        clamp_pairs=np.stack([row, pairs[:, 1]], axis=1),
        rest_turns=from_rotation_vectors(np.array(turns).reshape(-1, 3)),
    )


def _list_cells(line: Line, node: int, clamp_at: dict[int, int]) -> list[_Cell]:
    """Return the cells of a node: elements or clamps on both sides, node, weights, length."""
    n = len(line.lengths)
    half_before = 0.5 * float(line.lengths[node - 1]) if node > 0 else 0.0
    half_after = 0.5 * float(line.lengths[node]) if node < n else 0.0
    if node in clamp_at:
        clamp = -1 - clamp_at[node]
        cells: list[_Cell] = [
            (node - 1, clamp, node, (1.0, 0.0), half_before),
            (clamp, node, node, (0.0, 1.0), half_after),
        ]
        return [cell for cell in cells if cell[4] > 0.0]
    if not 0 < node < n:
        return []
    length = half_before + half_after
    return [(node - 1, node, node, (half_before / length, half_after / length), length)]


_EYE = np.eye(3)


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Directions of n elements; g is the force of an element times its length, N m.

    Parameters
    ----------
    along : shape (n, 3), unit vectors
    by_turn : shape (n, 3, 3), derivative of `along` with respect to a turn of the frame, in the
        body frame
    moments : shape (n, 3), N m, derivative of -g . along with respect to the turn
    stiffness : shape (n, 3, 3), N m, second derivative of -g . along with respect to turns,
        symmetric
    by_clamp : shape (clamped elements, 3, 3), derivative of `along` with respect to the sum of the
        directions contributed by clamps
    clamp_moments : shape (pairs, 3), N m, in space axes, derivative of -g . along with respect to
        the turn of the clamp, for each pair of element and clamp
    """

    along: Floats
    by_turn: Floats
    moments: Floats
    stiffness: Floats
    by_clamp: Floats
    clamp_moments: Floats


def compute_directions(
    supports: Supports, frames: Floats, clamp_pairs: Floats, moments: Floats
) -> Directions:
    """Compute the directions of the elements.

    Parameters
    ----------
    supports : supports of the line, which state the elements beside a clamp
    frames : shape (n, 3, 3), rotation matrices of the elements
    clamp_pairs : shape (pairs, 3), contributions of clamps, see `compute_clamp_directions`
    moments : g, shape (n, 3), N m, force of each element times its length
    """
    along = frames[:, :, 2].copy()
    by_turn = np.zeros_like(frames)
    by_turn[:, :, 0], by_turn[:, :, 1] = -frames[:, :, 1], frames[:, :, 0]
    stiffness = _differentiate_twice(np.vecmat(moments, frames))
    by_clamp = np.zeros((len(supports.ends), 3, 3))
    clamp_moments = np.zeros_like(clamp_pairs)
    if len(supports.ends):
        ends, own_weight = supports.ends, supports.own_weights[:, None, None]
        row = supports.clamp_pairs[:, 0]
        mean = own_weight[:, 0] * along[ends]
        np.add.at(mean, row, clamp_pairs)
        size = np.sqrt(np.vecdot(mean, mean))[:, None]
        along[ends] = mean / size
        projection = (_EYE - along[ends, :, None] * along[ends, None, :]) / size[:, :, None]
        g = moments[ends]
        p = np.matvec(projection, g)
        second = along[ends, :, None] * p[:, None, :]
        second = second + np.swapaxes(second, 1, 2)
        second += np.vecdot(g, along[ends])[:, None, None] * projection
        second /= size[:, :, None]
        mean_by_turn = own_weight * by_turn[ends]
        stiffness[ends] = own_weight * _differentiate_twice(np.vecmat(p, frames[ends]))
        stiffness[ends] += np.swapaxes(mean_by_turn, 1, 2) @ second @ mean_by_turn
        by_turn[ends] = projection @ mean_by_turn
        by_clamp = projection
        clamp_moments = -cross(clamp_pairs, p[row])
    turn_moments = -np.vecmat(moments, by_turn)
    return Directions(along, by_turn, turn_moments, stiffness, by_clamp, clamp_moments)


def _differentiate_twice(g: Floats) -> Floats:
    """Return the second derivative of -g . d3 with respect to turns; g is in the body frame."""
    derivative = g[:, 2, None, None] * _EYE
    derivative[:, :, 2] -= 0.5 * g
    derivative[:, 2, :] -= 0.5 * g
    return np.asarray(derivative)


def compute_clamp_directions(supports: Supports, clamps: Floats) -> Floats:
    """Compute the contributions of clamps to the directions of adjacent elements, (pairs, 3).

    Parameters
    ----------
    supports : supports of the line, which state the elements beside a clamp
    clamps : shape (clamps, 4), unit quaternions of the clamps
    """
    frames = multiply(clamps[supports.clamp_pairs[:, 1]], supports.rest_turns)
    return np.asarray(END_SHARE * to_matrices(frames)[:, :, 2])


@dataclass(frozen=True, slots=True, eq=False)
class BentCells:
    """Response of the cells to the frames on both sides.

    Parameters
    ----------
    turns : shape (cells, 3), rad, rotation vectors psi
    curvatures : shape (cells, 3), 1/m, curvatures minus those at rest
    moments : shape (cells, 3), N m, moments in the mean frames
    rests : shape (cells, sliders, 2), 1/m, rest curvatures of the sliders after the step
    before, after : shape (cells, 3), N m, derivatives of the energy with respect to the turns of
        the frames before and after the cell
    by_before : shape (cells, 3, 3), N m, derivative of `before` with respect to the turn before
    by_after : shape (cells, 3, 3), N m, derivative of `after` with respect to the turn after
    coupling : shape (cells, 3, 3), N m, derivative of `after` with respect to the turn before
    tangents : shape (cells, 3, 3), matrices A
    """

    turns: Floats
    curvatures: Floats
    moments: Floats
    rests: Floats
    before: Floats
    after: Floats
    by_before: Floats
    by_after: Floats
    coupling: Floats
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
    section : section of the line
    frames : unit quaternions before and after the cells, shape (cells, 4) each
    lengths : shape (cells,), m, lengths of the cells
    rest_curvature : shape (cells, 3), 1/m, curvatures at rest
    rests : shape (cells, sliders, 2), 1/m, rest curvatures of the sliders before the step
    torques : shape (cells,), N m, torques due to stretch
    drag : artificial stiffness of the cells relative to their initial stiffness, and psi at which
        it has no moment, shape (cells, 3); None without drag
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
        section_stiffness = np.array([bending, bending, section.torsional_stiffness])
        drag_stiffness = drag[0] * section_stiffness / lengths[:, None]
        moments += drag_stiffness * (psi - drag[1])
        stiffness += drag_stiffness[:, :, None] * _EYE
    c, c_slope = compute_tangent_factors(np.sqrt(np.vecdot(psi, psi)))
    tangents, geometric = _compute_tangents(psi, moments, c, c_slope)
    transposed = np.swapaxes(tangents, 1, 2)
    half = 0.5 * skew(moments)
    by_psi = np.concatenate([tangents, transposed], axis=1)  # for the frames before and after
    derivatives = by_psi @ stiffness + np.concatenate([geometric - half, geometric + half], axis=1)
    derivatives = derivatives @ np.swapaxes(by_psi, 1, 2)
    return BentCells(
        psi,
        curvatures,
        moments,
        response.rests,
        -np.matvec(tangents, moments),
        np.matvec(transposed, moments),
        _symmetrise(derivatives[:, :3, :3]),
        _symmetrise(derivatives[:, 3:, 3:]),
        -derivatives[:, 3:, :3],
        tangents,
    )


def _symmetrise(matrices: Floats) -> Floats:
    return np.asarray(0.5 * (matrices + np.swapaxes(matrices, 1, 2)))


def _compute_tangents(
    psi: Floats, moments: Floats, c: Floats, c_slope: Floats
) -> tuple[Floats, Floats]:
    """Return A, and the derivative of c psi x (psi x m) with respect to psi."""
    c = c[:, None, None]
    outer = psi[:, :, None] * psi[:, None, :]
    square, product = np.vecdot(psi, psi)[:, None], np.vecdot(psi, moments)[:, None]
    tangents = _EYE + 0.5 * skew(psi) + c * (outer - square[:, None] * _EYE)
    mixed = psi[:, :, None] * moments[:, None, :]
    double_cross = product * psi - square * moments  # psi x (psi x m)
    geometric = c * (product[:, None] * _EYE + mixed - 2.0 * np.swapaxes(mixed, 1, 2))
    geometric += (c_slope[:, None] * double_cross)[:, :, None] * psi[:, None, :]
    return tangents, geometric
