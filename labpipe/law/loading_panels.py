"""A law of first loading, cut into panels for integrals over the moment."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labpipe.law.plays import MomentLaw, complementary_energy
from labpipe.records.arrays import Floats, Ints

NODES = 3
"""Points of Gauss's rule in each panel."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadingLaw:
    """A law of first loading, cut into panels of the moment for Gauss's rule.

    Parameters
    ----------
    curvature, moment, energy : shape (edges,), 1/m, N m, N; from zero, increasing; the energy is
        the complementary one, per length
    node_weight : shape (edges - 1, nodes), N m, weights of the rule in the moment
    node_energy : same shape, N, complementary energy at the nodes
    points : edges at which points of the curve are wanted, increasing, without the first edge
    energy_change : shape (parameters, edges), N, derivative of the energy at constant moment by
        each of some parameters
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
    """Places and weights of Gauss's rule on the unit interval, shape (nodes,) each."""
    roots, weights = np.polynomial.legendre.leggauss(nodes)
    return 0.5 * (roots + 1.0), 0.5 * weights


def law_of_plays(law: MomentLaw, largest_moment: float, *, n_points: int = 80) -> LoadingLaw:
    """Cut a law of plays into panels: at its corners, and evenly in the logarithm in between.

    Parameters
    ----------
    law : the law; its history is a straight wire
    largest_moment : N m, at the clamp
    n_points : of the curve, spread over four decades of the clamp's moment
    """
    even = largest_moment * np.geomspace(1e-4, 1.0, n_points)
    corners = law.half_widths[law.half_widths < largest_moment]
    edges = np.concatenate([[0.0], np.union1d(even, corners)])
    places, weights = panel_rule(NODES)
    width = np.diff(edges)[:, None]
    nodes = edges[:-1, None] + width * places
    slipped = np.maximum(edges[:, None] - law.half_widths, 0.0) @ law.compliances
    return LoadingLaw(
        edges / law.stiffness + slipped,
        edges,
        complementary_energy(law, edges),
        width * weights,
        complementary_energy(law, nodes),
        np.searchsorted(edges, even),
        np.zeros((0, *edges.shape)),
        np.zeros((0, *nodes.shape)),
    )
