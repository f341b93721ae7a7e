"""First loading divided into panels for integrals over the moment."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labpipe.records.arrays import Floats, Ints

NODES_PER_PANEL = 3
"""Points of Gauss's rule in each panel."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadingLaw:
    """A law of first loading, divided into panels of the moment for Gauss's rule.

    Parameters
    ----------
    curvature, moment, energy : shape (edges,), 1/m, N m, N; from zero, increasing; the energy is
        the complementary one, per length
    node_weight : shape (edges - 1, nodes), N m, weights of the rule in the moment
    node_energy : same shape, N, complementary energy at the nodes
    points : indices of the edges that are points of the curve, increasing, without the first edge
    energy_change : shape (parameters, edges), N, derivative of the energy at constant moment by
        each parameter
    node_energy_change : shape (parameters, edges - 1, nodes), N, the same at the nodes
    """

    curvature: Floats
    moment: Floats
    energy: Floats
    node_weight: Floats
    node_energy: Floats
    points: Ints
    energy_change: Floats
    node_energy_change: Floats


@lru_cache(maxsize=8)
def panel_rule(nodes: int) -> tuple[Floats, Floats]:
    """Return nodes and weights of Gauss's rule on the unit interval, shape (nodes,) each."""
    roots, weights = np.polynomial.legendre.leggauss(nodes)
    return 0.5 * (roots + 1.0), 0.5 * weights
