"""Wires of a sticking bundle along their axes: force against strain, copper that yields included.

At the distance y from the neutral axis a wire that sticks is strained by kappa y: at 2 mm and half
a 1/m by a tenth of a per cent, where annealed copper has long begun to yield. The neutral axis then
moves to where the forces of all wires balance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.wire import WireTable
from labpipe.wire.from_spec import build

_POINTS = 600
_DECADES = 9.0
"""Below the largest strain: the first point lies where copper is still elastic."""
_HALVINGS = 60


def axial_force(table: WireTable, strain: Floats) -> Floats:
    """Force along a wire that is stretched and does not turn about its axis, N.

    Parameters
    ----------
    table : of the wire
    strain : shape (n,), along the wire, not negative; up to `largest_stretch`

    Notes
    -----
    sum of A cos(alpha) sigma(strain cos^2(alpha)) over the strands + E A strain of the insulation:
    a helical strand is strained by cos^2(alpha) of the wire's strain and pulls with cos(alpha) of
    its force (Costello, *Theory of Wire Rope*, 1997). Its slope at zero is the axial stiffness of
    the table.
    """
    section = build(table.spec).section
    tube = section.insulation.axial_stiffness if section.insulation else 0.0
    force = tube * strain
    for layer in section.layers:
        cosine = np.cos(layer.lay_angle)
        stress = layer.material.stress(strain * cosine**2)
        force = force + layer.count * layer.area * cosine * stress
    return np.asarray(force)


def largest_stretch(table: WireTable) -> float:
    """Strain of a wire up to which the stress of all its strands is known; may be infinite."""
    layers = build(table.spec).section.layers
    known = [layer.material.largest_strain / np.cos(layer.lay_angle) ** 2 for layer in layers]
    return float(min(known))


def stretching_moment(
    curvature: Floats, y: Floats, kind: Ints, tables: Sequence[WireTable]
) -> Floats:
    """Moment that the stretching and shortening of sticking wires takes, N m.

    Parameters
    ----------
    curvature : shape (n,), 1/m, not negative
    y : shape (wires,), m
    kind : shape (wires,), index into the tables
    tables : of the kinds of wire

    Returns
    -------
    Shape (n,): sum of N y, with N the force at the strain kappa (y - y0), alike in tension and in
    compression, and y0 where the sum of N is zero. Its slope at zero is sum of EA (y - y0)^2.
    """
    reach = float(np.ptp(y)) * float(np.max(curvature, initial=0.0))
    if reach == 0.0:
        return np.zeros(len(curvature))
    strain = np.append(0.0, np.geomspace(10.0**-_DECADES, 1.0, _POINTS) * reach)
    laws = [axial_force(table, strain) for table in tables]

    def forces(neutral: Floats) -> Floats:
        stretch = curvature[:, None] * (y - neutral[:, None])
        force = np.empty_like(stretch)
        for number, law in enumerate(laws):
            own = stretch[:, kind == number]
            force[:, kind == number] = np.sign(own) * np.interp(np.abs(own), strain, law)
        return force

    low, high = (np.full(len(curvature), edge) for edge in (y.min(), y.max()))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        pulls = forces(middle).sum(axis=1) > 0.0  # too much is stretched: the axis lies higher
        low, high = np.where(pulls, middle, low), np.where(pulls, high, middle)
    return np.asarray(forces(0.5 * (low + high)) @ y)
