"""Compute the cells and element directions of a line with held and clamped nodes.

The direction of an element is the director d3 of its frame, which points along the line. Beside a
clamp, the direction is the normalised mean of this director and the director of the clamp, which
has the weight `CLAMP_WEIGHT`.

Bending and twist act in the *cells* of a line. A cell is the half elements on both sides of a node.
The cell of a free node connects the frames of its two elements. A clamp divides the cell into two
half cells. Each half cell connects the frame of the clamp with that of an element.

The rotation vector psi (rad) rotates the frame before a cell to the frame after it. The elastic
curvature of a cell of length h is psi / h minus the curvature at rest, expressed in the mean of
both frames. The curvature (2 / h) Im q of the quaternion q of the rotation is equal to second
order, but only psi / h is exact for circles.

The moment m of a cell, in the mean frame, has the two bending components of the slider law and the
torque. [psi]x is the matrix of the cross product with psi, and c is the coefficient of
`compute_tangent_factors`. Small rotations d_a and d_b of the frames before and after, each in its
body frame, change psi by A d_b - A^T d_a with the tangent map A = 1 + [psi]x / 2 + c [psi]x [psi]x.
The derivatives of the energy with respect to d_a and d_b are therefore -A m and A^T m. The tangent
stiffness is the second derivative of the energy with respect to them, which is symmetric.
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
"""Held node, and whether it is a clamp, which also holds the frame."""

_Cell: TypeAlias = tuple[tuple[int, int], int, tuple[float, float], float]
"""Frames before and after a cell, its node, weights of the sides, and length (m)."""

CLAMP_WEIGHT = 1.0 / 6.0
"""Weight of a clamp in the direction of an adjacent element; the element has the remaining weight.

The half cell at a clamp has the moment at the node instead of that at its middle. This makes the
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
    held_nodes : shape (grips,), nodes with a prescribed position
    clamps : shape (clamps,), indices in `held_nodes` of nodes with a prescribed frame
    sides : shape (cells, 2), frames before and after each cell: an element, or n + k for clamp k of
        a line of n elements
    nodes : shape (cells,), node of each cell
    side_weights : shape (cells, 2), fractions of the cell before and after its node; (1, 0) or
        (0, 1) at a clamp
    lengths : shape (cells,), m, lengths of the cells
    rest_curvature : shape (cells, 3), 1/m, curvatures of the cells at rest
    own_weights : shape (n,), weight of the frame of each element in its direction
    clamp_pairs : shape (pairs, 2), index of an element, and index of an adjacent clamp
    rest_turns : shape (pairs, 4), quaternions of the rotation at rest from the clamp to the middle
        of the element
    """

    n_nodes: int
    held_nodes: Ints
    clamps: Ints
    sides: Ints
    nodes: Ints
    side_weights: Floats
    lengths: Floats
    rest_curvature: Floats
    own_weights: Floats
    clamp_pairs: Ints
    rest_turns: Floats

    def sum_at_frames(self, values: Floats) -> Floats:
        """Sum values of both sides of the cells at the frames of these sides.

        Parameters
        ----------
        values : shape (cells, 2, ...), values of any quantity

        Returns
        -------
        Shape (n + clamps, ...).
        """
        sums = np.zeros((len(self.own_weights) + len(self.clamps), *values.shape[2:]))
        for side in (0, 1):  # a frame is at most once on a side
            sums[self.sides[:, side]] += values[:, side]
        return sums


def split_cells_at_clamps(line: Line, grips: tuple[Grip, ...]) -> Supports:
    """Build the cells of a line, divided at its clamps, and list its held nodes.

    Parameters
    ----------
    line : line with its elements
    grips : held nodes, counted from 0, each at most once, and whether they are clamped
    """
    n_nodes = len(line.positions)
    held_nodes = np.array([node for node, _ in grips], dtype=np.int64)
    clamps = np.array([k for k, (_, is_clamp) in enumerate(grips) if is_clamp], dtype=np.int64)
    clamps_by_node = {int(held_nodes[k]): clamp for clamp, k in enumerate(clamps)}
    cells = [cell for node in range(n_nodes) for cell in _list_cells(line, node, clamps_by_node)]
    sides, nodes, weights, lengths = zip(*cells, strict=True) if cells else ((),) * 4
    cell_nodes = np.array(nodes, dtype=np.int64)
    rest_curvature = line.rest_curvature_at_nodes
    own_weights = np.ones(len(line.lengths))
    clamp_pairs, rest_vectors = [], []
    for node, clamp in clamps_by_node.items():
        for element, relative_distance in ((node - 1, -0.5), (node, 0.5)):
            if 0 <= element < len(line.lengths):
                own_weights[element] -= CLAMP_WEIGHT
                clamp_pairs.append((element, clamp))
                distance = relative_distance * line.lengths[element]  # from clamp to middle, m
                rest_vectors.append(distance * rest_curvature[node])
    return Supports(
        n_nodes=n_nodes,
        held_nodes=held_nodes,
        clamps=clamps,
        sides=np.array(sides, dtype=np.int64).reshape(-1, 2),
        nodes=cell_nodes,
        side_weights=np.array(weights, dtype=np.float64).reshape(-1, 2),
        lengths=np.array(lengths, dtype=np.float64),
        rest_curvature=rest_curvature[cell_nodes],
        own_weights=own_weights,
        clamp_pairs=np.array(clamp_pairs, dtype=np.int64).reshape(-1, 2),
        rest_turns=from_rotation_vectors(np.array(rest_vectors).reshape(-1, 3)),
    )


def _list_cells(line: Line, node: int, clamps_by_node: dict[int, int]) -> list[_Cell]:
    """List the cells of a node: one at a free node or an end clamp, two at an inner clamp.

    A free end has no cell.
    """
    n = len(line.lengths)
    length_before = 0.5 * float(line.lengths[node - 1]) if node > 0 else 0.0
    length_after = 0.5 * float(line.lengths[node]) if node < n else 0.0
    if node in clamps_by_node:
        clamp = n + clamps_by_node[node]
        cells: list[_Cell] = [
            ((node - 1, clamp), node, (1.0, 0.0), length_before),
            ((clamp, node), node, (0.0, 1.0), length_after),
        ]
        return [cell for cell in cells if cell[-1] > 0.0]  # no element before or after an end
    if not 0 < node < n:
        return []
    length = length_before + length_after
    weights = (length_before / length, length_after / length)
    return [((node - 1, node), node, weights, length)]


_IDENTITY = np.eye(3)


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Directions u of n elements, and derivatives of -g . u.

    The vector g is the force of an element times its length, N m. A turn is a small rotation of a
    frame.

    Parameters
    ----------
    unit_vectors : shape (n, 3), unit vectors u
    turn_derivatives : shape (n, 3, 3), derivatives of u with respect to the turn of the element, in
        its body frame
    moments : shape (n, 3), N m, derivatives of -g . u with respect to the turn of the element
    stiffness : shape (n, 3, 3), N m, second derivatives of -g . u with respect to the turn of the
        element, symmetric
    clamp_derivatives : shape (n, 3, 3), derivatives of u with respect to the sum of the
        contributions of clamps
    clamp_moments : shape (pairs, 3), N m, in space axes, derivatives of -g . u with respect to the
        turn of the clamp, for each pair of an element and a clamp
    """

    unit_vectors: Floats
    turn_derivatives: Floats
    moments: Floats
    stiffness: Floats
    clamp_derivatives: Floats
    clamp_moments: Floats


def compute_directions(
    supports: Supports, frames: Floats, clamp_directions: Floats, scaled_forces: Floats
) -> Directions:
    """Compute the directions of the elements, and their derivatives.

    Parameters
    ----------
    supports : supports of the line, which state the elements beside a clamp
    frames : shape (n, 3, 3), rotation matrices of the elements
    clamp_directions : shape (pairs, 3), contributions of clamps, see `compute_clamp_directions`
    scaled_forces : shape (n, 3), N m, vectors g, force of each element times its length
    """
    elements, own_weights = supports.clamp_pairs[:, 0], supports.own_weights
    mean_director = own_weights[:, None] * frames[:, :, 2]
    np.add.at(mean_director, elements, clamp_directions)
    norm = np.sqrt(np.vecdot(mean_director, mean_director))[:, None]
    u = mean_director / norm
    mean_derivatives = np.zeros_like(frames)
    mean_derivatives[:, :, 0] = -own_weights[:, None] * frames[:, :, 1]
    mean_derivatives[:, :, 1] = own_weights[:, None] * frames[:, :, 0]
    # The derivatives with respect to the mean director are those of -g . mean / |mean|.
    projection = (_IDENTITY - u[:, :, None] * u[:, None, :]) / norm[:, :, None]
    lateral_forces = np.matvec(projection, scaled_forces)
    outer = u[:, :, None] * lateral_forces[:, None, :]
    mean_stiffness = outer + outer.mT
    mean_stiffness += np.vecdot(scaled_forces, u)[:, None, None] * projection
    mean_stiffness /= norm[:, :, None]
    stiffness = own_weights[:, None, None] * _differentiate_twice(np.vecmat(lateral_forces, frames))
    stiffness += mean_derivatives.mT @ mean_stiffness @ mean_derivatives
    turn_derivatives = projection @ mean_derivatives
    moments = -np.vecmat(scaled_forces, turn_derivatives)
    clamp_moments = -cross(clamp_directions, lateral_forces[elements])
    clamp_terms = {"clamp_derivatives": projection, "clamp_moments": clamp_moments}
    return Directions(u, turn_derivatives, moments, stiffness, **clamp_terms)


def _differentiate_twice(g: Floats) -> Floats:
    """Compute the second derivative of -g . d3 with respect to a turn, with g in the body frame."""
    derivative = g[:, 2, None, None] * _IDENTITY
    derivative[:, :, 2] -= 0.5 * g
    derivative[:, 2, :] -= 0.5 * g
    return np.asarray(derivative)


def compute_clamp_directions(supports: Supports, clamps: Floats) -> Floats:
    """Compute the weighted contributions of clamps to the directions of elements, (pairs, 3).

    Parameters
    ----------
    supports : supports of the line, which state the elements beside a clamp
    clamps : shape (clamps, 4), unit quaternions of the clamps
    """
    frames = multiply(clamps[supports.clamp_pairs[:, 1]], supports.rest_turns)
    return np.asarray(CLAMP_WEIGHT * to_matrices(frames)[:, :, 2])


@dataclass(frozen=True, slots=True, eq=False)
class BentCells:
    """Moments of the cells, and derivatives of their energy with respect to turns of both frames.

    Parameters
    ----------
    rotation_vectors : shape (cells, 3), rad, rotation vectors psi
    curvatures : shape (cells, 3), 1/m, curvatures minus those at rest
    slider_rests : shape (cells, sliders, 2), 1/m, rest curvatures of the sliders after the step
    turn_maps : shape (cells, 6, 3), matrices -A and A^T
    gradients : shape (cells, 6), N m, derivatives of the energy with respect to the turns d_a and
        d_b of the frames before and after the cells
    stiffnesses : shape (cells, 6, 6), N m, second derivatives with respect to these turns
    """

    rotation_vectors: Floats
    curvatures: Floats
    slider_rests: Floats
    turn_maps: Floats
    gradients: Floats
    stiffnesses: Floats


def bend_cells(
    section: Section,
    frames: Floats,
    lengths: Floats,
    rest_curvature: Floats,
    *,
    slider_rests: Floats,
    torques: Floats,
    artificial_stiffness: tuple[float, Floats] | None = None,
) -> BentCells:
    """Compute the moments and the tangents of bent and twisted cells.

    Parameters
    ----------
    section : section of the line
    frames : shape (cells, 2, 4), unit quaternions of the frames before and after the cells
    lengths : shape (cells,), m, lengths of the cells
    rest_curvature : shape (cells, 3), 1/m, curvatures at rest
    slider_rests : shape (cells, sliders, 2), 1/m, rest curvatures of the sliders before the step
    torques : shape (cells,), N m, torques due to stretch
    artificial_stiffness : artificial stiffness relative to the initial stiffness of a cell, and
        rotation vectors psi at which it causes no moment, shape (cells, 3), rad; None for no
        artificial stiffness
    """
    psi = compute_turns(frames)
    curvatures = psi / lengths[:, None] - rest_curvature
    response = slide_vector(section.law, curvatures[:, :2], slider_rests)
    moments = np.empty_like(psi)
    moments[:, :2] = response.moment
    moments[:, 2] = section.torsional_stiffness * curvatures[:, 2] + torques
    stiffness = np.zeros((len(psi), 3, 3))
    stiffness[:, :2, :2] = response.stiffness
    stiffness[:, 2, 2] = section.torsional_stiffness
    stiffness /= lengths[:, None, None]
    if artificial_stiffness is not None:
        factor, relaxed_psi = artificial_stiffness
        ei, gj = section.law.first_stiffness, section.torsional_stiffness
        section_stiffness = np.array([ei, ei, gj])
        added_stiffness = factor * section_stiffness / lengths[:, None]
        moments += added_stiffness * (psi - relaxed_psi)
        stiffness += added_stiffness[:, :, None] * _IDENTITY
    maps, map_derivatives = _compute_tangent_maps(psi, moments)
    half_skew = 0.5 * skew(moments)
    # The gradient is -A m and A^T m. Its derivatives with respect to psi follow from both factors.
    turn_maps = np.concatenate([-maps, maps.mT], axis=1)
    derivatives = np.concatenate([half_skew - map_derivatives, half_skew + map_derivatives], axis=1)
    derivatives += turn_maps @ stiffness
    stiffnesses = derivatives @ turn_maps.mT
    return BentCells(
        rotation_vectors=psi,
        curvatures=curvatures,
        slider_rests=response.history,
        turn_maps=turn_maps,
        gradients=np.matvec(turn_maps, moments),
        stiffnesses=0.5 * (stiffnesses + stiffnesses.mT),
    )


def compute_turns(frames: Floats) -> Floats:
    """Compute the rotation vectors from the frame before to the frame after each cell, (cells, 3).

    Parameters
    ----------
    frames : shape (cells, 2, 4), unit quaternions of the frames before and after the cells
    """
    return to_rotation_vectors(multiply(conjugate(frames[:, 0]), frames[:, 1]))


def _compute_tangent_maps(psi: Floats, moments: Floats) -> tuple[Floats, Floats]:
    """Compute the tangent maps A, and the derivatives of c psi x (psi x m) with respect to psi."""
    factors, c_slope_over_angle = compute_tangent_factors(np.sqrt(np.vecdot(psi, psi)))
    c = factors[:, None, None]
    outer = psi[:, :, None] * psi[:, None, :]
    squared_angle, dot_product = np.vecdot(psi, psi)[:, None], np.vecdot(psi, moments)[:, None]
    tangent_maps = _IDENTITY + 0.5 * skew(psi) + c * (outer - squared_angle[:, None] * _IDENTITY)
    outer_moments = psi[:, :, None] * moments[:, None, :]
    double_cross = dot_product * psi - squared_angle * moments  # psi x (psi x m)
    derivatives = c * (dot_product[:, None] * _IDENTITY + outer_moments - 2.0 * outer_moments.mT)
    derivatives += (c_slope_over_angle[:, None] * double_cross)[:, :, None] * psi[:, None, :]
    return tangent_maps, derivatives
