"""Bounds of a bundle's bending stiffness: wires that slip on each other, wires that stick.

Wires that slip bend each about its own axis. Wires that stick are one beam: plane sections stay
plane, and a wire at the distance y from the neutral axis is also strained along its axis, by
kappa y (parallel axis theorem).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable

_ROUND = 1e-6
"""Principal stiffnesses nearer than this share are equal; an axis nearer than this to y, rad, is
y."""


@dataclass(frozen=True, slots=True, eq=False)
class Sticking:
    """Bending stiffness of a bundle in which nothing slips.

    Parameters
    ----------
    tensor : shape (2, 2), N m^2; the xx part resists bending along x, the yy part along y
    neutral : m, (x, y) where the neutral axes cross: the centroid of the axial stiffnesses
    principal : N m^2, least and largest of all directions
    angle : rad, in (-pi/2, pi/2], from the x axis to the direction of the largest; 0 where all
        directions are equal
    """

    tensor: Floats
    neutral: tuple[float, float]
    principal: tuple[float, float]
    angle: float


def sticking(x: Floats, y: Floats, bending_stiffness: Floats, axial_stiffness: Floats) -> Sticking:
    """Work out the bending stiffness of wires that stick to each other, in all directions.

    Parameters
    ----------
    x, y : shape (wires,), m, centres
    bending_stiffness : shape (wires,), N m^2, of each wire alone, alike in all directions
    axial_stiffness : shape (wires,), N, of each wire alone

    Notes
    -----
    With r = (x, y) from the centroid of the axial stiffnesses, K = sum EI 1 + sum EA r r^T: the
    parallel axis theorem, as in any book on the strength of materials (Timoshenko, *Strength of
    Materials I*, 1955, appendix A). Bending along the unit vector n takes n^T K n per curvature if
    the bundle is kept in its plane, and 1 / (n^T K^-1 n) if it may move aside: less, unless n is
    principal.
    """
    centres = np.column_stack([x, y])
    neutral = np.average(centres, axis=0, weights=axial_stiffness)
    about = centres - neutral
    tensor = np.eye(2) * bending_stiffness.sum() + (axial_stiffness[:, None] * about).T @ about
    (least, largest), axes = np.linalg.eigh(tensor)
    angle = 0.0 if largest - least <= _ROUND * largest else _half_turn(axes[:, 1])
    where = (float(neutral[0]), float(neutral[1]))
    return Sticking(tensor, where, (float(least), float(largest)), angle)


def _half_turn(axis: Floats) -> float:
    """Angle of an axis, which has no head, in (-pi/2, pi/2]."""
    angle = float(np.arctan2(axis[1], axis[0]))
    if angle > np.pi / 2.0 + _ROUND:
        return angle - np.pi
    return angle + np.pi if angle <= -np.pi / 2.0 + _ROUND else angle


def common_curvature(tables: Sequence[WireTable]) -> Floats:
    """Curvatures at which all laws are known, 1/m: those of all tables, up to the shortest range.

    Parameters
    ----------
    tables : at least one
    """
    end = min(float(table.curvature[-1]) for table in tables)
    every = np.unique(np.concatenate([table.curvature for table in tables]))
    return np.asarray(every[every <= end])


def slipping_moment(
    curvature: Floats, tables: Sequence[WireTable], counts: Sequence[int]
) -> Floats:
    """Moment of wires that slip on each other without friction: the sum of their laws, N m.

    Parameters
    ----------
    curvature : shape (n,), 1/m, within the range of every law
    tables, counts : kinds of wire, and how many of each

    Notes
    -----
    Between the points of a table the law is taken as straight.
    """
    laws = [np.interp(curvature, table.curvature, table.moment) for table in tables]
    return np.asarray(np.array(counts, dtype=np.float64) @ np.array(laws))


def share_of_bounds(value: float, low: float, high: float) -> float:
    """Tell where a stiffness lies between the bounds of the model: 0 at the lower, 1 at the upper.

    Parameters
    ----------
    value : N m^2
    low, high : N m^2, 0 < low < high; taken as exact

    Returns
    -------
    The share; below 0 or above 1 where the value lies outside the bounds.

    Raises
    ------
    ValueError
        If the bounds are not 0 < low < high.

    Notes
    -----
    (value - low) / (high - low), which is what layered beams call the degree of composite action
    (their theory: Newmark, Siess and Viest, Proc. Soc. Exp. Stress Anal. 9 (1951) 75).
    """
    if not 0.0 < low < high:
        message = f"low={low:.6g}, high={high:.6g} N m^2: allowed are bounds with 0 < low < high"
        raise ValueError(message)
    return (value - low) / (high - low)
