"""Write a complete MJCF model of a wire for MuJoCo 4: a clamped cable of constant stiffness.

MuJoCo 4.0 removed the cable plug-in and composite bodies. A cable is a one-dimensional flex with
elasticity, which is a discrete elastic rod [1]_ (XML Reference, flex/elasticity). It has a constant
bending stiffness E I and a torsional stiffness G J, with I and J of a full circle of the radius of
the flex.

The cable bends at the vertices. Each vertex represents half an edge on both sides. The first edge
is fixed at both ends. It begins half a spacing inside the clamp, so that the free length begins at
the face of the clamp. A load P at the tip then deflects the tip of n edges by
P L^3 / 3 EI (1 - 1 / (2 n - 1)^2).

References
----------
.. [1] M. Bergou, M. Wardetzky, S. Robinson, B. Audoly, E. Grinspun, Discrete elastic rods, ACM
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
    format_percent,
    get_mass_per_length,
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
    stiffness : N m^2, bending stiffness. None for the slope of the law at zero curvature, which is
        that of a wire whose strands all stick, or the first secant of the table if strands slip
        immediately; the deck states which
    length : m, free length; None for that of the wire's cantilever
    edges : number of edges of the cable, at least 3

    Returns
    -------
    MJCF. A load on the body of the last vertex (``wire_<edges>``) settles without overshooting. The
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
    if stiffness is None and table.slips_immediately:
        stiffness = float(table.secant_stiffness[1])
        origin = "the slope of the law at zero, its first secant, as strands slip at once"
    elif stiffness is None:
        stiffness = table.stick_stiffness
        origin = "the slope of the law at zero, while all strands stick"
    length = table.spec.length if length is None else length
    require_positive("stiffness", stiffness)
    require_positive("length", length)
    require("edges", edges, f">= {min_edges}", holds=edges >= min_edges)
    mass = get_mass_per_length(table)
    first_frequency = compute_first_frequency(stiffness, mass, length)
    # With more than 40 edges, shorter steps keep the constraint on their lengths as stiff.
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
        second_moment=np.pi / 4.0 * table.layout.wire_radius**4,
        first_frequency=first_frequency,
    )
