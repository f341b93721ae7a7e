"""Compute the cells and element directions of a line with held and clamped nodes.

The direction of an element is its d3. Beside a clamp it is the normalised mean of this d3 and that
of the clamp, with the weight `END_SHARE` of the clamp.

Bending and twist act in the *cells* of a line: the half elements on both sides of a node.

The cell of a free node connects the frames of its two elements. A clamp divides the cell in two;
each part connects the frame of the clamp with that of an element. psi is the rotation vector (rad)
from the frame before to the frame after. The curvature of a cell of length h is psi / h minus its
value at rest, in the mean of both frames. The form (2 / h) Im of the quaternion is equal to second
order; psi gives exact circles.

The moment m of a cell, in the mean frame, has the components of the sliders in bending and that of
torsion. Rotations d_a and d_b of the frames before and after (in the body frame) change psi by A
d_b - A^T d_a with A = 1 + psi x / 2 + c psi x psi x, so that -A m and A^T m act on the frames. The
tangent is the second derivative of the energy along such rotations, which is symmetric.
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

END_SHARE = 1.0 / 6.0
"""Weight of the clamp in the direction of an adjacent element; the rest is that of its own frame.

The half cell at a clamp has the moment of the node instead of that at its middle, which makes the
line too soft. If the direction of the element is in part that of the clamp (rotated by the
curvature at rest), the moment is that of a point farther from the clamp. A weight of one sixth
removes the second-order errors of angle and deflection for small bending, and reduces them to less
than a third for large bending.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Supports:
    """Cells and held nodes of a line.

    Parameters
    ----------
    n_nodes : number of nodes of the line
    held : shape (grips,), nodes with a prescribed position
    clamps : shape (clamps,), indices in `held` of those with a prescribed frame
    before, after : shape (cells,), element on that side; -1 - k for clamp k
    nodes : shape (cells,), node of each cell
    sides : shape (cells, 2), weights of the two sides of the node in the cell; (1, 0) or (0, 1) at
        a clamp
    lengths : shape (cells,), m
    rest_curvature : shape (cells, 3), 1/m
    ends : shape (clamped elements,), elements beside a clamp
    own_weights : shape (clamped elements,), weight of their own frame in the direction
    clamp_pairs : shape (pairs, 2), row in `ends` and clamp of each contribution
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
    line : the line
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
        mark = -1 - clamp_at[node]
        cells: list[_Cell] = [
            (node - 1, mark, node, (1.0, 0.0), half_before),
            (mark, node, node, (0.0, 1.0), half_after),
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
    along : shape (n, 3), unit
    by_turn : shape (n, 3, 3), derivative of `along` by a turn of the frame in the body frame
    pull : shape (n, 3), N m, derivative of -g . along by the turn
    stiff : shape (n, 3, 3), N m, second derivative of -g . along by turns, symmetric
    by_clamp : shape (clamped elements, 3, 3), derivative of `along` by the sum of the directions
        contributed by clamps
    clamp_moments : shape (pairs, 3), N m, in space, derivative of -g . along by the turns of the
        clamps, pair by pair
    """

    along: Floats
    by_turn: Floats
    pull: Floats
    stiff: Floats
    by_clamp: Floats
    clamp_moments: Floats


def compute_directions(
    supports: Supports, frames: Floats, clamp_pairs: Floats, pulls: Floats
) -> Directions:
    """Compute the directions of the elements.

    Parameters
    ----------
    supports : with the elements beside a clamp
    frames : shape (n, 3, 3), matrices of the elements
    clamp_pairs : shape (pairs, 3), contributions of clamps, see `compute_clamp_directions`
    pulls : shape (n, 3), N m, g
    """
    along = frames[:, :, 2].copy()
    by_turn = np.zeros_like(frames)
    by_turn[:, :, 0], by_turn[:, :, 1] = -frames[:, :, 1], frames[:, :, 0]
    stiff = _differentiate_twice(np.vecmat(pulls, frames))
    by_clamp = np.zeros((len(supports.ends), 3, 3))
    clamp_moments = np.zeros_like(clamp_pairs)
    if len(supports.ends):
        ends, own_share = supports.ends, supports.own_weights[:, None, None]
        row = supports.clamp_pairs[:, 0]
        mixed = own_share[:, 0] * along[ends]
        np.add.at(mixed, row, clamp_pairs)
        size = np.sqrt(np.vecdot(mixed, mixed))[:, None]
        along[ends] = mixed / size
        flat = (_EYE - along[ends, :, None] * along[ends, None, :]) / size[:, :, None]
        g = pulls[ends]
        p = np.matvec(flat, g)
        second = along[ends, :, None] * p[:, None, :]
        second = second + np.swapaxes(second, 1, 2)
        second += np.vecdot(g, along[ends])[:, None, None] * flat
        second /= size[:, :, None]
        turn = own_share * by_turn[ends]
        stiff[ends] = own_share * _differentiate_twice(np.vecmat(p, frames[ends]))
        stiff[ends] += np.swapaxes(turn, 1, 2) @ second @ turn
        by_turn[ends] = flat @ turn
        by_clamp = flat
        clamp_moments = -cross(clamp_pairs, p[row])
    pull = -np.vecmat(pulls, by_turn)
    return Directions(along, by_turn, pull, stiff, by_clamp, clamp_moments)


def _differentiate_twice(g: Floats) -> Floats:
    """Return the second derivative of -g . d3 by turns of the frame; g is in the frame."""
    out = g[:, 2, None, None] * _EYE
    out[:, :, 2] -= 0.5 * g
    out[:, 2, :] -= 0.5 * g
    return np.asarray(out)


def compute_clamp_directions(supports: Supports, clamps: Floats) -> Floats:
    """Compute the contributions of clamps to the directions of adjacent elements, (pairs, 3).

    Parameters
    ----------
    supports : with those elements
    clamps : shape (clamps, 4), frames
    """
    turned = multiply(clamps[supports.clamp_pairs[:, 1]], supports.rest_turns)
    return np.asarray(END_SHARE * to_matrices(turned)[:, :, 2])


@dataclass(frozen=True, slots=True, eq=False)
class BentCells:
    """Response of the cells to the frames on both sides.

    Parameters
    ----------
    turns : shape (cells, 3), rad, psi
    curvatures : shape (cells, 3), 1/m, minus those at rest
    moments : shape (cells, 3), N m, in the mean frames
    rests : shape (cells, sliders, 2), 1/m, history after the step
    before, after : shape (cells, 3), N m, derivative of the energy by the turns of the frames
    by_before, by_after : shape (cells, 3, 3), N m, of `before` by its own frame, of `after` by
        its own
    across : shape (cells, 3, 3), N m, of `after` by the frame before
    tangents : shape (cells, 3, 3), A
    """

    turns: Floats
    curvatures: Floats
    moments: Floats
    rests: Floats
    before: Floats
    after: Floats
    by_before: Floats
    by_after: Floats
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
    frames : before and after, each of shape (cells, 4)
    lengths : shape (cells,), m
    rest_curvature : shape (cells, 3), 1/m, curvatures at rest
    rests : shape (cells, sliders, 2), 1/m, history before the step
    torques : shape (cells,), N m, from stretch
    drag : artificial stiffness of the cells as a share of the first stiffness, and the psi at which
        it has no moment; None without
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
    turns = np.concatenate([tangents, turned], axis=1)  # of the frames before and after
    force = turns @ stiffness + np.concatenate([geometric - half, geometric + half], axis=1)
    derivatives = force @ np.swapaxes(turns, 1, 2)
    return BentCells(
        psi,
        curvatures,
        moments,
        response.rests,
        -np.matvec(tangents, moments),
        np.matvec(turned, moments),
        _symmetrise(derivatives[:, :3, :3]),
        _symmetrise(derivatives[:, 3:, 3:]),
        -derivatives[:, 3:, :3],
        tangents,
    )


def _symmetrise(matrices: Floats) -> Floats:
    return np.asarray(0.5 * (matrices + np.swapaxes(matrices, 1, 2)))


def _compute_tangents(
    psi: Floats, moments: Floats, first: Floats, second: Floats
) -> tuple[Floats, Floats]:
    """Return A, and the derivative by psi of c psi x (psi x m)."""
    c = first[:, None, None]
    outer = psi[:, :, None] * psi[:, None, :]
    square, along = np.vecdot(psi, psi)[:, None], np.vecdot(psi, moments)[:, None]
    tangents = _EYE + 0.5 * skew(psi) + c * (outer - square[:, None] * _EYE)
    mixed = psi[:, :, None] * moments[:, None, :]
    twice = along * psi - square * moments  # psi x (psi x m)
    geometric = c * (along[:, None] * _EYE + mixed - 2.0 * np.swapaxes(mixed, 1, 2))
    geometric += (second[:, None] * twice)[:, :, None] * psi[:, None, :]
    return tangents, geometric
