"""A wire for MuJoCo 4: a clamped cable as a standalone MJCF model.

MuJoCo 4.0 removed the cable plug-in and composite bodies; a cable is a one-dimensional flex with
elasticity, a discrete elastic rod (XML Reference, flex/elasticity; Bergou et al. 2008). It has one
constant bending stiffness E I and one torsional stiffness G J, with I and J of a full circle of the
flex's radius.

The vertices carry the bending, each that of half an edge on both sides. The first edge, held at
both ends, therefore begins half a spacing inside the clamp, so that the free length is counted from
the clamp's face: a load P at the tip then deflects it by P L^3 / 3 EI (1 - 1 / (2 n - 1)^2), n
edges.

References
----------
M. Bergou, M. Wardetzky, S. Robinson, B. Audoly, E. Grinspun, Discrete elastic rods, ACM
Transactions on Graphics 27 (2008) 63.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np

from labpipe.mechanics.decks.deck_law import (
    compute_constant_loss,
    compute_first_frequency,
    describe_deck_losses,
    find_linear_range,
    find_mass,
    format_percent,
    list_facts,
    shorten_name,
    write_xml_comment,
)
from labpipe.mechanics.decks.unloading import release_without_memory
from labpipe.mechanics.law.plays import require, require_positive
from labpipe.records.wire import WireTable

CABLE = "wire"
"""Name of the flex; its vertices are bodies ``wire_2`` to ``wire_<edges>``."""


@dataclass(frozen=True, slots=True)
class _Cable:
    """Numbers of the model: stiffness, N m^2, of bending, length, m, mass, kg/m, and edges."""

    stiffness: float
    length: float
    mass_per_length: float
    edges: int

    @property
    def spacing(self) -> float:
        """Return the length of an edge, m: the first one is half inside the clamp."""
        return self.length / (self.edges - 0.5)

    @property
    def first_frequency(self) -> float:
        """First angular frequency of the clamped cable, rad/s."""
        return compute_first_frequency(self.stiffness, self.mass_per_length, self.length)

    @property
    def step(self) -> float:
        """Return the time step, s."""
        # more than 40 edges need shorter steps to keep the constraint on their lengths as stiff
        return 0.05 / self.first_frequency * min(1.0, 40 / self.edges)


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
    table : law of the wire
    stiffness : N m^2; None for the slope of the law at zero: that of a wire whose strands all
        stick, or the first secant of the table where strands slip at once. The deck states which
    length : free length, m; None for that of the wire's cantilever
    edges : of the cable, at least 3

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
    origin = "as given"
    if stiffness is None:
        stiffness, origin = _slope_at_zero(table)
    length = table.spec.length if length is None else length
    require_positive("stiffness", stiffness)
    require_positive("length", length)
    require("edges", edges, f">= {min_edges}", holds=edges >= min_edges)
    cable = _Cable(stiffness, length, find_mass(table), edges)
    comments = "\n".join(map(write_xml_comment, _comments(table, cable, origin)))
    radius = table.layout.wire_radius
    circle = np.pi / 4.0 * radius**4
    mass = cable.mass_per_length * cable.spacing * (edges + 1)
    places = ((np.arange(edges + 1) - 0.5) * cable.spacing).tolist()
    points = "  ".join(f"{place:.9g} 0 0" for place in places)
    elements = "  ".join(f"{edge} {edge + 1}" for edge in range(edges))
    return f"""\
<mujoco model={quoteattr(shorten_name(table.name))}>
{comments}
  <option timestep="{cable.step:.6g}" integrator="discrete" gravity="0 0 0" />
  <worldbody>
    <flexcomp name="{CABLE}" type="direct" dim="1" radius="{radius:.9g}" mass="{mass:.9g}" \
point="{points}" element="{elements}">
      <edge equality="true" solref="{2.0 * cable.step:.6g} 1" solimp="0.9999 0.9999 0.001" />
      <contact contype="0" conaffinity="0" selfcollide="none" />
      <elasticity young="{stiffness / circle:.9g}" \
shear="{table.torsional_stiffness / (2.0 * circle):.9g}" \
damping="{2.0 / cable.first_frequency:.6g}" />
      <pin id="0 1" />
    </flexcomp>
  </worldbody>
  <sensor>
    <framepos name="tip" objtype="body" objname="{CABLE}_{edges}" />
  </sensor>
</mujoco>
"""


def _slope_at_zero(table: WireTable) -> tuple[float, str]:
    """Return the bending stiffness of the law at zero, N m^2, and its origin."""
    if table.slips_at_once:
        origin = "the slope of the law at zero, its first secant, as strands slip at once"
        return float(table.secant_stiffness[1]), origin
    return table.stick_stiffness, "the slope of the law at zero, while all strands stick"


def _comments(table: WireTable, cable: _Cable, origin: str) -> tuple[str, ...]:
    settling_time = 35.0  # over 1 / (first angular frequency)
    steps_to_rest = math.ceil(settling_time / cable.first_frequency / cable.step)
    close = find_linear_range(table, cable.stiffness)
    if close is None:
        validity = "nowhere within 5 % of the wire's law"
    else:
        validity = (
            f"within 5 % of the wire's law at curvatures from {close[0]:.4g} to {close[1]:.4g} 1/m"
        )
    loss = (
        f"This deck: error up to {format_percent(compute_constant_loss(table, cable.stiffness))} "
        f"of the moment over its range, and no memory of bends."
    )
    return (
        *list_facts(table, shorten_name(table.name)),
        f"MuJoCo's cable is linear: bending stiffness {cable.stiffness:.6g} N m2 ({origin}), "
        f"{validity}. The model has no limit there.",
        *describe_deck_losses(table, loss, "elastic", release_without_memory(table), wide=1000),
        f"Torsional stiffness {table.torsional_stiffness:.6g} N m2, at constant "
        f"length: the cable does not stretch.",
        "young and shear are these stiffnesses over those of a full circle, not of a material.",
        f"Free length {cable.length:.6g} m, {cable.edges} edges; the first begins half an edge "
        f"inside the clamp, whose face is at x = 0.",
        f"Mass {cable.mass_per_length:.4g} kg/m of strands and insulation matters until rest only, "
        "as there is no gravity.",
        f"Damping is critical in the first mode: at rest after {steps_to_rest} steps.",
        "For MuJoCo 4.0 and later: a flex as a cable, integrator discrete.",
    )
