"""Laws of plays for tests: one of two stiffnesses, energies, and panels of first loading."""

from __future__ import annotations

import numpy as np

from labpipe.mechanics.law.loading_table import NODES, LoadingLaw, panel_rule
from labpipe.mechanics.law.plays import MomentLaw, PlayLaw
from labpipe.records.arrays import Floats


def bilinear_law(stiffness: float, second_stiffness: float, break_moment: float) -> PlayLaw:
    """Two stiffnesses, N m^2, on first loading; a single play, so it unloads with the first one."""
    more = 1.0 / second_stiffness - 1.0 / stiffness
    return PlayLaw(stiffness, np.array([break_moment]), np.array([more]))


def complementary_energy(law: MomentLaw, moment: Floats) -> Floats:
    """Integral of kappa dM on first loading, per length, N, shape of `moment`."""
    beyond = np.maximum(np.abs(moment)[..., None] - law.half_widths, 0.0)
    slipped: Floats = 0.5 * beyond**2 @ law.compliances
    return 0.5 * moment**2 / law.stiffness + slipped


def law_of_plays(law: MomentLaw, largest_moment: float, *, n_points: int = 80) -> LoadingLaw:
    """A law of plays in panels: cut at its corners, and evenly in the logarithm in between."""
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
