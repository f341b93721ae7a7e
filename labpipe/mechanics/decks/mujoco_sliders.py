"""Write a wire with hysteresis for MuJoCo 4: a chain of hinges with springs that yield.

MuJoCo 4.0 has ideal elasto-plastic springs. The attribute ``springyield`` of joints and tendons is
the displacement at which plastic displacement begins. A node of the chain represents the length h
of the wire. It has a spring that never yields and, for each slider of `law.sliders`, a fixed tendon
on its hinge with the stiffness K_j / h and the yield h kappa_j. Hinge i is at (i + 1/2) h, so that
the error of the chain is of second order in h.

In space a node has two hinges for bending. The tendons of its sliders act on weighted sums of the
two angles, in directions that are rotated from one node to the next. A third hinge is for twist.

In the plane, a slider with isotropic hardening is an additional tendon. MuJoCo keeps its yield
constant. A program must therefore increase the yield at each step according to the accumulated
plastic displacement (``examples/mujoco_growing.py``).

An overshoot leaves plastic displacement in springs that yield. Loads must therefore be ramped, and
the joints are damped. The deck states the numbers of steps of the ramp and until rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from labpipe.mechanics.decks.deck_law import (
    compute_first_frequency,
    describe_losses,
    fill_template,
    format_percent,
    get_mass_per_length,
    list_facts,
)
from labpipe.mechanics.decks.lookup import describe_missing_sliders
from labpipe.mechanics.decks.unloading import make_table_strands
from labpipe.mechanics.law.loss_card import N_DIRECTIONS, fit_wire_sliders
from labpipe.mechanics.law.plays import require, require_positive
from labpipe.mechanics.law.sliders import (
    ROTATIONS,
    SliderLaw,
    average_rotations,
    convert_to_plays,
    fit_directions,
    split_hardening,
)
from labpipe.mechanics.wire.first_loading import compute_end_load_path
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable

RAMP = 400
"""Number of time steps over which a load is ramped."""
REST = 600
"""Number of time steps until rest after the ramp."""


@dataclass(frozen=True, slots=True)
class Chain:
    """Properties of a chain.

    Parameters
    ----------
    law : law of the wire with sliders
    length : m, length of the wire
    radius : m, outer radius of the wire
    mass_per_length : kg/m
    torsional_stiffness : N m^2
    """

    law: SliderLaw
    length: float
    radius: float
    mass_per_length: float
    torsional_stiffness: float
    nodes: ClassVar[int] = 30

    @property
    def spacing(self) -> float:
        """Return the length of wire that a node represents, m."""
        return self.length / self.nodes

    @property
    def time_step(self) -> float:
        """Return the time step, s, one over the first angular frequency while sliders stick."""
        stiffness = self.law.first_stiffness
        return 1.0 / compute_first_frequency(stiffness, self.mass_per_length, self.length)

    @property
    def damping(self) -> float:
        """Return the damping of a hinge, N m s."""
        return 0.5 * self.law.first_stiffness / self.spacing * self.time_step


@dataclass(frozen=True, slots=True, eq=False)
class Hinges:
    """Hinges of a node and the springs across them.

    Parameters
    ----------
    axes : name, axis and stiffness (N m^2) of each hinge
    tendons : shape (rotations, directions, hinges), coefficient of the angle of each hinge;
        successive nodes have successive rotations, in a cycle
    stiffnesses : shape (sliders,), N m^2, stiffnesses of the sliders in each direction
    slip_curvatures : shape (sliders,), 1/m, slip curvatures of the sliders in each direction
    sentences : description for the head of a deck
    """

    axes: tuple[tuple[str, str, float], ...]
    tendons: Floats
    stiffnesses: Floats
    slip_curvatures: Floats
    sentences: tuple[str, ...]


def write_mujoco_plane_deck(
    table: WireTable, *, length: float | None = None, isotropic_share: float = 0.0
) -> str:
    """Write a clamped wire along x that bends in the x-y plane, with hysteresis.

    Parameters
    ----------
    table : table of the wire
    length : m, free length; None for that of the wire's cantilever
    isotropic_share : isotropic share of the hardening, from 0 (Masing's rule) to 1; above 0 the
        program that runs the model must increase the yield of the tendons ``growing_<node>`` at
        each step

    Returns
    -------
    MJCF. The actuator ``pull_y`` is a force at the tip, in N, of constant direction. With an
    isotropic share above 0, ``growing_yield`` has the yields over ``growing_slid``, the accumulated
    magnitude of plastic displacement, both in rad.

    Raises
    ------
    ValueError
        If a number is out of its range.

    Notes
    -----
    If sliders cannot be fitted to the law (`fit_sliders`), the text has the reason and no model.
    """
    is_in_range = 0.0 <= isotropic_share <= 1.0
    require("isotropic_share", isotropic_share, "from 0 to 1", holds=is_in_range)
    return _write_chain(table, make_plane_hinges, "y", length, isotropic_share)


def write_mujoco_space_deck(table: WireTable, *, length: float | None = None) -> str:
    """Write a clamped wire along x that bends in every plane and twists, with hysteresis.

    Parameters
    ----------
    table : table of the wire
    length : m, free length; None for that of the wire's cantilever

    Returns
    -------
    MJCF. The actuators ``pull_y`` and ``pull_z`` are forces at the tip, in N.

    Raises
    ------
    ValueError
        As `write_mujoco_plane_deck`.
    """
    return _write_chain(table, make_space_hinges, "yz", length)


def make_plane_hinges(chain: Chain) -> Hinges:
    """Build the hinges of a chain that bends in one plane."""
    law, sliders = chain.law, (chain.law.slider_stiffnesses, chain.law.slip_curvatures)
    sentence = (
        f"{len(law.slider_stiffnesses)} sliders at each of {chain.nodes} nodes, in one plane: "
        f"error up to {100.0 * law.error:.2g} % of the moment."
    )
    axes = (("z", "0 0 1", law.spring_stiffness),)
    return Hinges(axes, np.ones((1, 1, 1)), *sliders, (sentence,))


def make_space_hinges(chain: Chain) -> Hinges:
    """Build the hinges of a chain that bends in every plane and twists."""
    law = chain.law
    directions, spring_stiffness = N_DIRECTIONS, law.spring_stiffness
    tendons, sliders = np.zeros((1, 0, 2)), (np.zeros(0), np.zeros(0))
    sentence = f"Bending stiffness {law.spring_stiffness:.6g} N m2, constant."
    if len(law.slider_stiffnesses):
        scalar_law = fit_directions(law, directions, max_sliders=8)
        spring_stiffness = scalar_law.spring_stiffness * directions / 2.0
        tendons = np.array([scalar_law.compute_unit_vectors(rotation) for rotation in ROTATIONS])
        sliders = (scalar_law.slider_stiffnesses, scalar_law.slip_curvatures)
        mean_law = average_rotations(law, scalar_law)
        angles = ", ".join(f"{180.0 / directions * rotation:.4g}" for rotation in ROTATIONS)
        sentence = (
            f"{len(sliders[0])} sliders in each of {directions} directions at each of "
            f"{chain.nodes} nodes, rotated from node to node by {angles} deg. MuJoCo has no vector "
            f"sliders: in the worst direction of bending, the moment of {len(ROTATIONS)} nodes has "
            f"an error of {format_percent(mean_law.error)} and a lateral part of "
            f"{format_percent(mean_law.transverse_ratio)} (one node: "
            f"{format_percent(scalar_law.error)}, {format_percent(scalar_law.transverse_ratio)})."
        )
    twist = f"Torsional stiffness {chain.torsional_stiffness:.6g} N m2, linear."
    axes = (
        ("z", "0 0 1", spring_stiffness),
        ("y", "0 -1 0", spring_stiffness),
        ("x", "1 0 0", chain.torsional_stiffness),
    )
    return Hinges(axes, tendons, *sliders, (sentence, twist))


def _write_chain(
    table: WireTable,
    make_hinges: Callable[[Chain], Hinges],
    pull_axes: str,
    length: float | None,
    isotropic_share: float = 0.0,
) -> str:
    """Write a clamped wire, or the reason why no sliders can be fitted to its law."""
    gears = {"y": "0 1 0 0 0 0", "z": "0 0 1 0 0 0"}
    head = list_facts(table)
    try:
        law = fit_wire_sliders(table)
    except ValueError as error:
        reason = describe_missing_sliders(error)
        return fill_template(
            "wire_chain.xml", name=table.name, head=head, chain=None, reason=reason
        )
    if isotropic_share > 0.0:
        law = split_hardening(law, make_table_strands(table), isotropic_share)
    length = table.spec.length if length is None else length
    require_positive("length", length)
    radius, torsional_stiffness = table.layout.wire_radius, table.torsional_stiffness
    chain = Chain(law, length, radius, get_mass_per_length(table), torsional_stiffness)
    return fill_template(
        "wire_chain.xml",
        name=table.name,
        head=head,
        chain=chain,
        hinges=make_hinges(chain),
        gravity="0 0 0",
        losses=describe_losses(table),
        ramp=RAMP,
        rest=REST,
        check=_compute_check(chain.law, chain.length),
        isotropic_share=isotropic_share,
        pulls={axis: gears[axis] for axis in pull_axes},
    )


@lru_cache(maxsize=4)  # laws are hashed by identity
def _compute_check(law: SliderLaw, length: float) -> dict[str, float] | None:
    """Return a load and its tip deflections, to detect a program that ignores springyield.

    The deflection is the largest within the range of the law of 0.3 of the length and its halves.
    The result is None if the smallest of six is beyond the range.
    """
    deflections = 0.3 * length * 0.5 ** np.arange(5.0, -1.0, -1.0)
    path = compute_end_load_path(convert_to_plays(law), length, deflections)
    if not len(path.load):
        return None
    load, deflection = float(path.load[-1]), float(path.deflection[-1])
    elastic = load * length**3 / (3.0 * law.first_stiffness)
    return {"load": load, "deflection": deflection, "elastic_deflection": elastic}
