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
from xml.etree import ElementTree as Xml

import numpy as np

from labpipe.decks.deck_law import (
    facts,
    linear_range,
    mass_of,
    on_one_line,
)
from labpipe.decks.deck_losses import constant_loss, deck_losses, percent
from labpipe.records.wire import WireTable

CABLE = "wire"
"""Name of the flex; its vertices are bodies ``wire_2`` to ``wire_<edges>``."""


@dataclass(frozen=True, slots=True)
class _Cable:
    """Numbers of the model, SI.

    Parameters
    ----------
    stiffness : N m^2
    torsional_stiffness : N m^2
    length, radius : m
    mass_per_length : kg/m
    edges : number
    """

    stiffness: float
    torsional_stiffness: float
    length: float
    radius: float
    mass_per_length: float
    edges: int

    @property
    def spacing(self) -> float:
        """Return the length of an edge, m: the first one is half inside the clamp."""
        return self.length / (self.edges - 0.5)

    @property
    def first_frequency(self) -> float:
        """Return the first angular frequency of the clamped cable, rad/s."""
        first_root = 1.8751040687119611  # of cos x cosh x = -1: first mode of a cantilever
        stretch = np.sqrt(self.stiffness / self.mass_per_length)
        return float(first_root**2 * stretch / self.length**2)

    @property
    def step(self) -> float:
        """Return the time step, s."""
        # more than 40 edges need shorter steps to keep the constraint on their lengths as stiff
        return 0.05 / self.first_frequency * min(1.0, 40 / self.edges)

    @property
    def steps_to_rest(self) -> int:
        """Return the number of steps after which a load on the tip has settled."""
        settling_time = 35.0  # over 1 / (first angular frequency)
        return math.ceil(settling_time / self.first_frequency / self.step)


def mujoco_deck(
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
    (`linear_range`).
    """
    cable = _Cable(
        _slope_at_zero(table) if stiffness is None else stiffness,
        table.torsional_stiffness,
        table.spec.length if length is None else length,
        table.layout.wire_radius,
        mass_of(table),
        edges,
    )
    _require_cable(cable)
    root = Xml.Element("mujoco", model=on_one_line(table.name))
    origin = _stiffness_origin(table) if stiffness is None else "as given"
    for line in _comments(table, cable, origin):
        # two hyphens would end an XML comment
        root.append(Xml.Comment(f" {line.replace('--', '- -')} "))
    _add_cable(root, cable)
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode") + "\n"


def _require_cable(cable: _Cable) -> None:
    min_edges = 3
    for name in ("stiffness", "length"):
        value = getattr(cable, name)
        if not (np.isfinite(value) and value > 0.0):
            message = f"{name}={value!r}: must be finite and > 0"
            raise ValueError(message)
    if cable.edges < min_edges:
        message = f"edges={cable.edges}: must be >= {min_edges}"
        raise ValueError(message)


def _slope_at_zero(table: WireTable) -> float:
    """Return the bending stiffness of the law at zero, N m^2."""
    return float(table.secant_stiffness[1]) if table.slips_at_once else table.stick_stiffness


def _stiffness_origin(table: WireTable) -> str:
    """Describe the origin of the default stiffness."""
    if table.slips_at_once:
        return "the slope of the law at zero, its first secant, as strands slip at once"
    return "the slope of the law at zero, while all strands stick"


def _comments(table: WireTable, cable: _Cable, origin: str) -> tuple[str, ...]:
    close = linear_range(table, cable.stiffness)
    if close is None:
        validity = "nowhere within 5 % of the wire's law"
    else:
        validity = (
            f"within 5 % of the wire's law at curvatures from {close[0]:.4g} to {close[1]:.4g} 1/m"
        )
    loss = (
        f"This deck: error up to {percent(constant_loss(table, cable.stiffness))} of the moment "
        f"over its range, and no memory of bends."
    )
    return (
        *facts(table, on_one_line(table.name)),
        f"MuJoCo's cable is linear: bending stiffness {cable.stiffness:.6g} N m2 ({origin}), "
        f"{validity}. The model has no limit there.",
        *deck_losses(table, loss, wide=1000),
        f"Torsional stiffness {cable.torsional_stiffness:.6g} N m2, at constant "
        f"length: the cable does not stretch.",
        "young and shear are these stiffnesses over those of a full circle, not of a material.",
        f"Free length {cable.length:.6g} m, {cable.edges} edges; the first begins half an edge "
        f"inside the clamp, whose face is at x = 0.",
        f"Mass {cable.mass_per_length:.4g} kg/m of strands and insulation matters until rest only, "
        "as there is no gravity.",
        f"Damping is critical in the first mode: at rest after {cable.steps_to_rest} steps.",
        "For MuJoCo 4.0 and later: a flex as a cable, integrator discrete.",
    )


def _add_cable(root: Xml.Element, cable: _Cable) -> None:
    Xml.SubElement(
        root, "option", timestep=f"{cable.step:.6g}", integrator="discrete", gravity="0 0 0"
    )
    world = Xml.SubElement(root, "worldbody")
    places = (np.arange(cable.edges + 1) - 0.5) * cable.spacing
    flex = Xml.SubElement(
        world,
        "flexcomp",
        name=CABLE,
        type="direct",
        dim="1",
        radius=f"{cable.radius:.9g}",
        mass=f"{cable.mass_per_length * cable.spacing * (cable.edges + 1):.9g}",
        point="  ".join(f"{place:.9g} 0 0" for place in places),
        element="  ".join(f"{edge} {edge + 1}" for edge in range(cable.edges)),
    )
    _add_elasticity(flex, cable)
    sensors = Xml.SubElement(root, "sensor")
    tip = f"{CABLE}_{cable.edges}"
    Xml.SubElement(sensors, "framepos", name="tip", objtype="body", objname=tip)


def _add_elasticity(flex: Xml.Element, cable: _Cable) -> None:
    """Add stiffness, damping and clamp; edges of constant length; no contacts."""
    Xml.SubElement(
        flex,
        "edge",
        equality="true",
        solref=f"{2.0 * cable.step:.6g} 1",
        solimp="0.9999 0.9999 0.001",
    )
    Xml.SubElement(flex, "contact", contype="0", conaffinity="0", selfcollide="none")
    circle = np.pi / 4.0 * cable.radius**4
    Xml.SubElement(
        flex,
        "elasticity",
        young=f"{cable.stiffness / circle:.9g}",
        shear=f"{cable.torsional_stiffness / (2.0 * circle):.9g}",
        damping=f"{2.0 / cable.first_frequency:.6g}",
    )
    Xml.SubElement(flex, "pin", id="0 1")
