"""Write a wire for MuJoCo 4 as a clamped cable with one bending stiffness: a complete MJCF model.

MuJoCo 4.0 removed the cable plug-in and composite bodies; a cable is a one-dimensional flex with
elasticity, a discrete elastic rod (XML Reference, flex/elasticity; Bergou et al. 2008). It has one
constant bending stiffness E I and one torsional stiffness G J, with I and J of a full circle of the
flex's radius.

Bending occurs at the vertices; each represents half an edge on both sides. The first edge is fixed
at both ends. It begins half a spacing inside the clamp, so that the free length begins at the face
of the clamp: a load P at the tip then deflects the tip by P L^3 / 3 EI (1 - 1 / (2 n - 1)^2) with n
edges.

References
----------
M. Bergou, M. Wardetzky, S. Robinson, B. Audoly, E. Grinspun, Discrete elastic rods, ACM
Transactions on Graphics 27 (2008) 63.
"""

from __future__ import annotations

import math

import numpy as np

from labpipe.mechanics.decks.deck_law import (
    compute_constant_loss,
    compute_first_frequency,
    describe_deck_losses,
    fill_template,
    find_linear_range,
    find_mass,
    format_percent,
    list_facts,
)
from labpipe.mechanics.decks.unloading import make_zero_release
from labpipe.mechanics.law.plays import require, require_positive
from labpipe.records.wire import WireTable

CABLE = "wire"
"""Name of the flex; its vertices are bodies ``wire_2`` to ``wire_<edges>``."""


def write_mujoco_deck(
    table: WireTable,
    *,
    stiffness: float | None = None,
    length: float | None = None,
    edges: int = 40,
) -> str:
    """Write a clamped cable of constant bending stiffness, along x, without gravity.

    Parameters
    ----------
    table : table of the wire
    stiffness : N m^2; None for the slope of the law at zero: that of a wire whose strands all
        stick, or the first secant of the table where strands slip at once. The deck states which
    length : free length, m; None for that of the wire's cantilever
    edges : number of edges of the cable, at least 3

    Returns
    -------
    MJCF. A load on the body of the last vertex (``wire_<edges>``) settles without overshooting: the
    damping is critical in the first mode and higher in the others.

    Raises
    ------
    ValueError
        If a number is not positive and finite, or there are fewer than three edges.

    Notes
    -----
    The deck states at which curvatures the constant stiffness is within 5 % of the wire's law
    (`find_linear_range`).
    """
    min_edges = 3
    settling_time = 35.0  # times the first angular frequency
    origin = "as given"
    if stiffness is None:
        stiffness, origin = _find_slope_at_zero(table)
    length = table.spec.length if length is None else length
    require_positive("stiffness", stiffness)
    require_positive("length", length)
    require("edges", edges, f">= {min_edges}", holds=edges >= min_edges)
    mass = find_mass(table)
    first_frequency = compute_first_frequency(stiffness, mass, length)
    # more than 40 edges need shorter steps to keep the constraint on their lengths as stiff
    step = 0.05 / first_frequency * min(1.0, 40 / edges)
    spacing = length / (edges - 0.5)  # the first edge is half inside the clamp
    validity = "nowhere within 5 % of the wire's law"
    if (linear_range := find_linear_range(table, stiffness)) is not None:
        start, stop = linear_range
        validity = f"within 5 % of the wire's law at curvatures from {start:.4g} to {stop:.4g} 1/m"
    error = format_percent(compute_constant_loss(table, stiffness))
    deck_loss = (
        f"This deck: error up to {error} of the moment over its range, and no memory of bends."
    )
    vertex_x = ((np.arange(edges + 1) - 0.5) * spacing).tolist()
    return fill_template(
        "cable.xml",
        table=table,
        head=list_facts(table),
        stiffness=stiffness,
        origin=origin,
        validity=validity,
        losses=describe_deck_losses(
            table, deck_loss, "elastic", make_zero_release(table), line_width=1000
        ),
        length=length,
        edges=edges,
        mass=mass,
        steps_to_rest=math.ceil(settling_time / first_frequency / step),
        step=step,
        cable=CABLE,
        spacing=spacing,
        points="  ".join(f"{x:.9g} 0 0" for x in vertex_x),
        elements="  ".join(f"{edge} {edge + 1}" for edge in range(edges)),
        circle=np.pi / 4.0 * table.layout.wire_radius**4,
        first_frequency=first_frequency,
    )


def _find_slope_at_zero(table: WireTable) -> tuple[float, str]:
    """Return the bending stiffness of the law at zero, N m^2, and its origin."""
    if table.slips_at_once:
        origin = "the slope of the law at zero, its first secant, as strands slip at once"
        return float(table.secant_stiffness[1]), origin
    return table.stick_stiffness, "the slope of the law at zero, while all strands stick"
