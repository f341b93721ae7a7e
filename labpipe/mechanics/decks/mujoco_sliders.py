"""Write a wire with hysteresis for MuJoCo 4: a chain of hinges with springs that yield.

MuJoCo 4.0 has ideal elasto-plastic springs: ``springyield`` of joints and tendons is the
displacement from which plastic displacement begins. A node of the chain has a spring that never
yields and, for each slider of `law.sliders`, a fixed tendon on its hinge: stiffness K_j / h and
yield h kappa_j, with the length h of wire that the node represents. Hinge i is at (i + 1/2) h, so
that the error of the chain is of second order in h.

In space a node has two hinges. The tendons of its sliders act on sums of the two angles, in
directions that are rotated from one node to the next. A third hinge represents twist.

In the plane, a slider with isotropic hardening is an additional tendon. MuJoCo keeps its yield
constant: a program must raise the yield at each step according to the accumulated plastic
displacement (``examples/mujoco_growing.py``).

An overshoot leaves plastic displacement in springs that yield. Therefore loads must be ramped and
the joints are damped; the deck states the number of steps of the ramp and until rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labpipe.mechanics.decks.deck_law import (
    compute_first_frequency,
    describe_masing_losses,
    fill_template,
    find_mass,
    format_percent,
    list_facts,
)
from labpipe.mechanics.decks.lookup import describe_missing_sliders
from labpipe.mechanics.decks.unloading import make_table_strands
from labpipe.mechanics.law.loss_card import N_DIRECTIONS, SLIDERS, fit_wire_sliders
from labpipe.mechanics.law.plays import require, require_positive
from labpipe.mechanics.law.sliders import (
    MAX_SLIDERS,
    TURNS,
    SliderLaw,
    convert_to_plays,
    fit_directions,
    share_hardening,
    turn_directions,
)
from labpipe.mechanics.wire.first_loading import compute_end_load_path
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable

DEFAULT_NODES = 30
"""Number of nodes of a chain."""
RAMP = 400
"""Number of steps over which a load is ramped."""
REST = 600
"""Number of steps until rest after the ramp."""


@dataclass(frozen=True, slots=True)
class Chain:
    """Properties of a chain, SI.

    Parameters
    ----------
    law : sliders of the wire
    length, radius : m
    mass_per_length : kg/m
    torsional_stiffness : N m^2
    nodes : number of nodes
    """

    law: SliderLaw
    length: float
    radius: float
    mass_per_length: float
    torsional_stiffness: float
    nodes: int

    @property
    def spacing(self) -> float:
        """Return the length of wire that a node represents, m."""
        return self.length / self.nodes

    @property
    def unit_time(self) -> float:
        """Return the time step, s: one over the first angular frequency while no slider slides."""
        stiffness = self.law.first_stiffness
        return 1.0 / compute_first_frequency(stiffness, self.mass_per_length, self.length)

    @property
    def damping(self) -> float:
        """Return the damping of a hinge, N m s."""
        return 0.5 * self.law.first_stiffness / self.spacing * self.unit_time


@dataclass(frozen=True, slots=True, eq=False)
class Hinges:
    """Hinges of a node and the springs across them.

    Parameters
    ----------
    axes : name, axis and stiffness (N m^2) of each hinge
    tendons : shape (rotations, directions, hinges), coefficient of each hinge's angle; successive
        nodes have successive rotations, in a cycle
    stiffnesses, slip_curvatures : of the sliders in each direction
    sentences : description for the head of a deck
    """

    axes: tuple[tuple[str, str, float], ...]
    tendons: Floats
    stiffnesses: Floats
    slip_curvatures: Floats
    sentences: tuple[str, ...]


def write_mujoco_plane_deck(
    table: WireTable,
    *,
    sliders: int = SLIDERS,
    length: float | None = None,
    nodes: int = DEFAULT_NODES,
    isotropic_share: float = 0.0,
) -> str:
    """Write a clamped wire along x that bends in the x-y plane, with hysteresis.

    Parameters
    ----------
    table : law of the wire
    sliders : largest number
    length : free length, m; None for that of the wire's cantilever
    nodes : number of nodes of the chain, at least 3
    isotropic_share : from 0 (Masing's rule) to 1; above 0 the program that runs the model must
        raise the yield of the tendons ``growing_<node>`` at each step

    Returns
    -------
    MJCF. The actuator ``pull_y`` is a force at the tip, in N, of constant direction. With an
    isotropic share ``growing_yield`` has the yields over ``growing_slid``, the accumulated size
    of plastic displacement, both in rad.

    Raises
    ------
    ValueError
        If a number is out of its range.

    Notes
    -----
    If sliders cannot be fitted to the law (`fit_sliders`), the text has the reason and no model.
    """
    in_range = 0.0 <= isotropic_share <= 1.0
    require("isotropic_share", isotropic_share, "from 0 to 1", holds=in_range)
    law = _fit_law(table, sliders)
    if isinstance(law, str):
        return law
    if isotropic_share > 0.0:
        law = share_hardening(law, make_table_strands(table, sliders), isotropic_share)
    chain = _make_chain(table, law, length, nodes)
    sentence = (
        f"{len(law.stiffnesses)} sliders at each of {nodes} nodes, in one plane: error up "
        f"to {100.0 * law.error:.2g} % of the moment."
    )
    axes = (("z", "0 0 1", law.stiffness),)
    hinges = Hinges(axes, np.ones((1, 1, 1)), law.stiffnesses, law.slip_curvatures, (sentence,))
    return _write_chain(table, chain, hinges, "y", isotropic_share)


def write_mujoco_space_deck(
    table: WireTable,
    *,
    sliders: int = SLIDERS,
    directions: int = N_DIRECTIONS,
    length: float | None = None,
    nodes: int = DEFAULT_NODES,
) -> str:
    """Write a clamped wire along x that bends in every plane and twists, with hysteresis.

    Parameters
    ----------
    table : law of the wire
    sliders : largest number of sliders of the law to which the scalar sliders are fitted
    directions : number of directions in which each node has scalar sliders
    length, nodes : as for `write_mujoco_plane_deck`

    Returns
    -------
    MJCF. The actuators ``pull_y`` and ``pull_z`` are forces at the tip, in N.

    Raises
    ------
    ValueError
        As `write_mujoco_plane_deck`.
    """
    law = _fit_law(table, sliders)
    if isinstance(law, str):
        return law
    chain = _make_chain(table, law, length, nodes)
    return _write_chain(table, chain, make_space_hinges(chain, directions), "yz")


def make_space_hinges(chain: Chain, directions: int = N_DIRECTIONS) -> Hinges:
    """Return the hinges of a chain that bends in every plane and twists.

    Parameters
    ----------
    chain : its properties
    directions : number of directions in which each node has scalar sliders
    """
    law = chain.law
    spring_stiffness, tendons, sliders = (
        law.stiffness,
        np.zeros((1, 0, 2)),
        (np.zeros(0), np.zeros(0)),
    )
    sentence = f"Bending stiffness {law.stiffness:.6g} N m2, constant."
    if len(law.stiffnesses):
        scalar_law = fit_directions(law, directions, max_sliders=8)
        spring_stiffness = scalar_law.stiffness * directions / 2.0
        tendons = np.array([scalar_law.turned_normals(rotation) for rotation in TURNS])
        sliders = (scalar_law.stiffnesses, scalar_law.slip_curvatures)
        cycle_error = turn_directions(law, scalar_law)
        angles = ", ".join(f"{180.0 / directions * rotation:.4g}" for rotation in TURNS)
        sentence = (
            f"{len(scalar_law.stiffnesses)} sliders in each of {directions} directions at each of "
            f"{chain.nodes} nodes, rotated from node to node by {angles} deg. MuJoCo has no vector "
            f"sliders: in the worst direction of bending, the moment of {len(TURNS)} nodes has an "
            f"error of {format_percent(cycle_error.error)} and a lateral part of "
            f"{format_percent(cycle_error.sideways)} (one node: "
            f"{format_percent(scalar_law.error)}, {format_percent(scalar_law.sideways)})."
        )
    twist = f"Torsional stiffness {chain.torsional_stiffness:.6g} N m2, linear."
    axes = (
        ("z", "0 0 1", spring_stiffness),
        ("y", "0 -1 0", spring_stiffness),
        ("x", "1 0 0", chain.torsional_stiffness),
    )
    return Hinges(axes, tendons, *sliders, (sentence, twist))


def _fit_law(table: WireTable, sliders: int) -> SliderLaw | str:
    """Return the sliders of a wire, or a deck with the reason why they cannot be fitted."""
    allowed = f"from 1 to {MAX_SLIDERS}"
    require("sliders", sliders, allowed, holds=1 <= sliders <= MAX_SLIDERS)
    try:
        return fit_wire_sliders(table, sliders)
    except ValueError as error:
        reason = describe_missing_sliders(error)
        facts = {"name": table.name, "head": list_facts(table)}
        return fill_template("wire_chain.xml", chain=None, reason=reason, **facts)


def _make_chain(table: WireTable, law: SliderLaw, length: float | None, nodes: int) -> Chain:
    min_nodes = 3
    length = table.spec.length if length is None else length
    require_positive("length", length)
    require("nodes", nodes, f">= {min_nodes}", holds=nodes >= min_nodes)
    radius, torsional_stiffness = table.layout.wire_radius, table.torsional_stiffness
    return Chain(law, length, radius, find_mass(table), torsional_stiffness, nodes)


def _write_chain(
    table: WireTable, chain: Chain, hinges: Hinges, pull_axes: str, isotropic_share: float = 0.0
) -> str:
    """Return the whole text of a clamped wire."""
    gears = {"y": "0 1 0 0 0 0", "z": "0 0 1 0 0 0"}
    return fill_template(
        "wire_chain.xml",
        name=table.name,
        head=list_facts(table),
        chain=chain,
        hinges=hinges,
        gravity="0 0 0",
        losses=describe_masing_losses(table),
        ramp=RAMP,
        rest=REST,
        check=_compute_check(chain.law, chain.length),
        isotropic_share=isotropic_share,
        pulls={axis: gears[axis] for axis in pull_axes},
    )


@lru_cache(maxsize=4)  # laws are hashed by identity
def _compute_check(law: SliderLaw, length: float) -> dict[str, float] | None:
    """Return a load and its tip deflection, to detect an engine that ignores springyield."""
    max_halvings = 6  # of the deflection, while it is beyond the range of the law
    plays = convert_to_plays(law)
    for halvings in range(max_halvings):
        deflection = 0.3 * 0.5**halvings * length
        path = compute_end_load_path(plays, length, np.array([deflection]))
        if len(path.load):
            load = float(path.load[0])
            elastic = load * length**3 / (3.0 * law.first_stiffness)
            return {"load": load, "deflection": deflection, "elastic_deflection": elastic}
    return None
