"""Directions of the elements of a line, and the effect of their forces on their frames.

An element points along its d3. Beside a clamp its direction is the normalised mean of d3 and the
clamp's, weighted by `supports.END_SHARE`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.rod.rotations import cross, matrices, multiply
from labpipe.rod.supports import END_SHARE, Supports

_EYE = np.eye(3)


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Directions of n elements with forces g (N m: their force times their length).

    Parameters
    ----------
    along : shape (n, 3), unit
    by_turn : shape (n, 3, 3), its derivative by a turn of the frame in the body frame
    pull : shape (n, 3), N m, derivative of -g . along by the turn
    stiff : shape (n, 3, 3), N m, its second derivative along turns, symmetric
    by_clamp : shape (clamped elements, 3, 3), derivative of `along` by the sum of the directions
        contributed by clamps
    lent_moments : shape (pairs, 3), N m, in space, derivative of -g . along by the turns of the
        clamps, pair by pair
    """

    along: Floats
    by_turn: Floats
    pull: Floats
    stiff: Floats
    by_clamp: Floats
    lent_moments: Floats


def directions_of(supports: Supports, frames: Floats, lent: Floats, pulls: Floats) -> Directions:
    """Compute the directions of the elements.

    Parameters
    ----------
    supports : which elements are beside a clamp
    frames : shape (n, 3, 3), matrices of the elements
    lent : shape (pairs, 3), contributions of clamps, see `clamp_directions`
    pulls : shape (n, 3), N m, g
    """
    along = frames[:, :, 2].copy()
    by_turn = np.zeros_like(frames)
    by_turn[:, :, 0], by_turn[:, :, 1] = -frames[:, :, 1], frames[:, :, 0]
    stiff = _bend(np.vecmat(pulls, frames))
    by_clamp = np.zeros((len(supports.ends), 3, 3))
    lent_moments = np.zeros_like(lent)
    if len(supports.ends):
        ends, own_share = supports.ends, supports.own[:, None, None]
        row = supports.lent[:, 0]
        mixed = own_share[:, 0] * along[ends]
        np.add.at(mixed, row, lent)
        size = np.linalg.norm(mixed, axis=1)[:, None]
        along[ends] = mixed / size
        flat = (_EYE - along[ends, :, None] * along[ends, None, :]) / size[:, :, None]
        g = pulls[ends]
        p = np.matvec(flat, g)
        second = along[ends, :, None] * p[:, None, :]
        second = second + np.swapaxes(second, 1, 2)
        second += np.vecdot(g, along[ends])[:, None, None] * flat
        second /= size[:, :, None]
        turn = own_share * by_turn[ends]
        stiff[ends] = own_share * _bend(np.vecmat(p, frames[ends]))
        stiff[ends] += np.swapaxes(turn, 1, 2) @ second @ turn
        by_turn[ends] = flat @ turn
        by_clamp = flat
        lent_moments = -cross(lent, p[row])
    pull = -np.vecmat(pulls, by_turn)
    return Directions(along, by_turn, pull, stiff, by_clamp, lent_moments)


def _bend(g: Floats) -> Floats:
    """Return the second derivative of -g . d3 along turns of the frame, g in the frame."""
    out = g[:, 2, None, None] * _EYE
    out[:, :, 2] -= 0.5 * g
    out[:, 2, :] -= 0.5 * g
    return np.asarray(out)


def clamp_directions(supports: Supports, clamps: Floats) -> Floats:
    """Return the contributions of clamps to the directions of adjacent elements, shape (pairs, 3).

    Parameters
    ----------
    supports : with those elements
    clamps : shape (clamps, 4), frames
    """
    turned = multiply(clamps[supports.lent[:, 1]], supports.carried)
    return np.asarray(END_SHARE * matrices(turned)[:, :, 2])
