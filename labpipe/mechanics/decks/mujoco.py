"""Format the MJCF model of a wire for MuJoCo 4: a clamped cable of constant stiffness.

MuJoCo 4.0 removed the cable plug-in and composite bodies. A cable is a one-dimensional flex with
elasticity, which is a discrete elastic rod [1]_ (XML Reference, flex/elasticity). It has a constant
bending stiffness E I and a torsional stiffness G J, where I and J are those of a solid circular
section with the radius of the flex.

The cable bends at the vertices. Each vertex represents half an edge on each side. The first edge
is fixed at both ends. It begins half an edge length inside the clamp, so that the free length
begins at the face of the clamp. A load P at the tip deflects the tip of a cable with n edges by
P L^3 / (3 E I) (1 - 1 / (2 n - 1)^2).

References
----------
.. [1] M. Bergou, M. Wardetzky, S. Robinson, B. Audoly, E. Grinspun, Discrete elastic rods, ACM
       Transactions on Graphics 27 (2008) 63.
"""

from __future__ import annotations

import math

import numpy as np

from labpipe.mechanics.decks.deck_law import (
    compute_angular_frequency,
    describe_deck_errors,
    fill_template,
    find_linear_range,
    format_percent,
    get_mass_per_length,
)
from labpipe.mechanics.decks.unloading import make_elastic_release
from labpipe.mechanics.law.plays import require_positive, require_whole
from labpipe.records.wire import WireTable

FLEX_NAME = "wire"
"""Name of the flex. Its free vertices are the bodies ``wire_2`` to ``wire_<edges>``."""


def format_cable_deck(
    table: WireTable,
    *,
    stiffness: float | None = None,
    length: float | None = None,
    edges: int = 40,
) -> str:
    """Return the MJCF of a clamped cable of constant bending stiffness, along x, without gravity.

    Parameters
    ----------
    table : table of the wire
    stiffness : bending stiffness, N m^2; None for the slope of the law at zero curvature (Notes)
    length : free length, m; None for the free length in the wire sheet
    edges : number of edges of the cable, at least 3

    Returns
    -------
    MJCF. After a step load on the body of the last vertex (``wire_<edges>``), the cable comes to
    rest without overshoot. The first mode is critically damped, and higher modes are overdamped.

    Raises
    ------
    ValueError
        If `stiffness`, `length` or the mass per length is not positive and finite, or `edges` is
        not a whole number >= 3.

    Notes
    -----
    The slope of the law at zero curvature is that of a wire whose strands all stick. If strands
    slip immediately, the first secant of the table is used. The deck states the source of the
    stiffness, and the first range of curvature in which the moment is within 5 % of that of the
    wire (`find_linear_range`).
    """
    settling_angle = 35.0  # settling time times the first angular frequency
    source = "as given"
    if stiffness is None and table.slips_immediately:
        stiffness = float(table.secant_stiffness[1])
        source = "the slope of the law at zero, its first secant, as strands slip immediately"
    elif stiffness is None:
        stiffness = table.stick_stiffness
        source = "the slope of the law at zero, where all strands stick"
    length = table.spec.length if length is None else length
    require_positive("stiffness", stiffness)
    require_positive("length", length)
    require_whole("edges", edges, 3)
    mass_per_length = get_mass_per_length(table)
    first_angular_frequency = compute_angular_frequency(stiffness, mass_per_length, length)
    # With more than 40 edges, a shorter time step keeps the constraint on the edge lengths as stiff
    # as with 40 edges.
    time_step = 0.05 / first_angular_frequency * min(1.0, 40 / edges)
    edge_length = length / (edges - 0.5)  # half of the first edge is inside the clamp
    validity = "at no curvature within 5 % of the wire's law"
    if (linear_range := find_linear_range(table, stiffness)) is not None:
        lower, upper = linear_range
        validity = f"within 5 % of the wire's law at curvatures from {lower:.4g} to {upper:.4g} 1/m"
    relative_errors = stiffness * table.curvature[1:] / table.moment[1:] - 1.0
    percent = format_percent(float(np.max(np.abs(relative_errors))))
    error_sentence = f"This deck: error up to {percent} of the moment, no hysteresis."
    vertex_x = ((np.arange(edges + 1) - 0.5) * edge_length).tolist()
    return fill_template(
        "cable.xml",
        table=table,
        stiffness=stiffness,
        stiffness_source=source,
        validity=validity,
        error_sentences=describe_deck_errors(
            table, error_sentence, "elastic", deck_release=make_elastic_release(table)
        ),
        length=length,
        edges=edges,
        mass_per_length=mass_per_length,
        n_settling_steps=math.ceil(settling_angle / first_angular_frequency / time_step),
        time_step=time_step,
        flex_name=FLEX_NAME,
        edge_length=edge_length,
        vertex_coordinates="  ".join(f"{x:.9g} 0 0" for x in vertex_x),
        edge_vertices="  ".join(f"{edge} {edge + 1}" for edge in range(edges)),
        second_moment=np.pi / 4.0 * table.layout.wire_radius**4,
        first_angular_frequency=first_angular_frequency,
    )
