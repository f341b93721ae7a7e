"""Format a wire with hysteresis for MuJoCo 4: a chain of hinges with elasto-plastic springs.

MuJoCo 4.0 has elastic, perfectly plastic springs. The attribute ``springyield`` of joints and
tendons is the displacement at which yielding begins. A node of the chain represents the length h of
the wire. The hinge of a node has a spring that never yields. Each slider of `law.sliders` has the
stiffness K_j and the slip curvature kappa_j. The slider is represented by a fixed tendon on the
hinge, with the stiffness K_j / h and the yield displacement h kappa_j. Hinge i is at (i + 1/2) h,
so that the error of the chain is of second order in h.

In space, a node has two hinges for bending. The tendons of its sliders act on weighted sums of the
two bending angles, in directions that are rotated from one node to the next. A third hinge is for
twist.

In the plane, a slider with isotropic hardening is an additional tendon. MuJoCo keeps the yield
displacement of this tendon constant. A program must therefore increase it at each step according to
the accumulated plastic displacement (``examples/mujoco_growing.py``).

An overshoot leaves plastic displacement in elasto-plastic springs. Loads must therefore be ramped,
and the joints are damped. The deck states the number of time steps of the ramp, and the number of
time steps after which the wire is at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from labpipe.mechanics.decks.deck_law import (
    compute_angular_frequency,
    describe_law_errors,
    fill_template,
    format_percent,
    get_mass_per_length,
)
from labpipe.mechanics.decks.lookup import describe_missing_sliders
from labpipe.mechanics.decks.unloading import make_table_strand_slider
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

N_RAMP_STEPS = 400
"""Number of time steps over which a load is ramped."""
N_SETTLING_STEPS = 600
"""Number of time steps after the ramp until the wire is at rest."""
LOAD_GEARS = {"x": "1 0 0 0 0 0", "y": "0 1 0 0 0 0", "z": "0 0 1 0 0 0"}
"""Gear of the motor of a load along an axis, keyed by the axis."""


@dataclass(frozen=True, slots=True)
class Chain:
    """Chain of hinges that represents a wire.

    Parameters
    ----------
    law : slider law of the wire
    length : length of the wire, m
    radius : outer radius of the wire, m
    mass_per_length : mass per length of the wire, kg/m
    torsional_stiffness : torsional stiffness of the wire, N m^2
    """

    law: SliderLaw
    length: float
    radius: float
    mass_per_length: float
    torsional_stiffness: float
    n_nodes: ClassVar[int] = 30

    @property
    def spacing(self) -> float:
        """Return the length of wire that a node represents, m."""
        return self.length / self.n_nodes

    @property
    def time_step(self) -> float:
        """Return the time step, s: the reciprocal of the first angular frequency before sliding."""
        stiffness = self.law.first_stiffness
        return 1.0 / compute_angular_frequency(stiffness, self.mass_per_length, self.length)

    @property
    def damping(self) -> float:
        """Return the damping coefficient of a hinge, N m s."""
        return 0.5 * self.law.first_stiffness / self.spacing * self.time_step


@dataclass(frozen=True, slots=True, eq=False)
class Hinges:
    """Hinges of each node and the tendons of its sliders.

    Parameters
    ----------
    axes : name of each hinge, its axis as text, and the stiffness of its spring for a unit length
        of wire, N m^2
    tendon_coefficients : shape (rotations, directions, bending hinges), coefficients of the bending
        angles in the displacement of a tendon; the nodes use the rotations in turn, cyclically
    stiffnesses : shape (sliders,), N m^2, stiffnesses of the sliders, equal in all directions
    slip_curvatures : shape (sliders,), 1/m, slip curvatures of the sliders, equal in all directions
    description_sentences : sentences on the sliders and on torsion for the header of a deck
    """

    axes: tuple[tuple[str, str, float], ...]
    tendon_coefficients: Floats
    stiffnesses: Floats
    slip_curvatures: Floats
    description_sentences: tuple[str, ...]


def format_plane_deck(
    table: WireTable, *, length: float | None = None, isotropic_share: float = 0.0
) -> str:
    """Return the MJCF of a clamped wire along x that bends in the x-y plane, with hysteresis.

    Parameters
    ----------
    table : table of the wire
    length : free length, m; None for the free length in the wire sheet
    isotropic_share : isotropic fraction of the hardening, from 0 (Masing's rule) to 1. If it is
        above 0, the program that runs the model must increase the yield displacements of the
        tendons ``growing_<node>`` at each step

    Returns
    -------
    MJCF. The actuator ``pull_y`` applies a force, in N, of constant direction at the tip. If the
    isotropic share is above 0, the arrays ``growing_yield`` and ``growing_slid`` tabulate the yield
    displacement as a function of the accumulated plastic displacement, both in rad. If sliders
    cannot be fitted to the law, the text states the reason and contains no model.

    Raises
    ------
    ValueError
        If `isotropic_share` is not from 0 to 1, or if sliders can be fitted and `length` or the
        mass per length is not positive and finite.
    """
    is_in_range = 0.0 <= isotropic_share <= 1.0
    require("isotropic_share", isotropic_share, "from 0 to 1", holds=is_in_range)
    return _format_chain_deck(table, build_plane_hinges, "y", length, isotropic_share)


def format_space_deck(table: WireTable, *, length: float | None = None) -> str:
    """Return the MJCF of a clamped wire along x that bends, with hysteresis, and twists in space.

    Parameters
    ----------
    table : table of the wire
    length : free length, m; None for the free length in the wire sheet

    Returns
    -------
    MJCF. The actuators ``pull_y`` and ``pull_z`` apply forces, in N, of constant direction at the
    tip. If sliders cannot be fitted to the law, the text states the reason and contains no model.

    Raises
    ------
    ValueError
        If sliders can be fitted and `length` or the mass per length is not positive and finite.
    """
    return _format_chain_deck(table, build_space_hinges, "yz", length)


def build_plane_hinges(chain: Chain) -> Hinges:
    """Build the hinges of a chain that bends in one plane."""
    law = chain.law
    slider_sentence = (
        f"{len(law.slider_stiffnesses)} sliders at each of {chain.n_nodes} nodes, in one plane: "
        f"error up to {100.0 * law.error:.2g} % of the moment."
    )
    axes, tendon_coefficients = (("z", "0 0 1", law.spring_stiffness),), np.ones((1, 1, 1))
    stiffnesses, slip_curvatures = law.slider_stiffnesses, law.slip_curvatures
    return Hinges(axes, tendon_coefficients, stiffnesses, slip_curvatures, (slider_sentence,))


def build_space_hinges(chain: Chain) -> Hinges:
    """Build the hinges of a chain that bends in every plane and twists."""
    law, spring_stiffness = chain.law, chain.law.spring_stiffness
    tendon_coefficients = np.zeros((1, 0, 2))  # a law without sliders has no tendons
    stiffnesses = slip_curvatures = np.zeros(0)
    slider_sentence = f"Bending stiffness {law.spring_stiffness:.6g} N m2, constant."
    if len(law.slider_stiffnesses):
        scalar_law = fit_directions(law, N_DIRECTIONS, max_sliders=8)
        # the sum of cos^2 over the directions is half their number
        spring_stiffness = scalar_law.spring_stiffness * N_DIRECTIONS / 2.0
        tendon_coefficients = np.array([*map(scalar_law.compute_unit_vectors, ROTATIONS)])
        stiffnesses, slip_curvatures = scalar_law.slider_stiffnesses, scalar_law.slip_curvatures
        mean_law = average_rotations(law, scalar_law)
        angles = ", ".join(f"{180.0 / N_DIRECTIONS * rotation:.4g}" for rotation in ROTATIONS)
        slider_sentence = (
            f"{len(stiffnesses)} sliders in each of {N_DIRECTIONS} directions at each of "
            f"{chain.n_nodes} nodes, rotated by {angles} deg at successive nodes. MuJoCo has no "
            f"vector sliders: in the worst bending direction, the moment of {len(ROTATIONS)} nodes "
            f"has an error of {format_percent(mean_law.error)} and a lateral part of "
            f"{format_percent(mean_law.transverse_ratio)} (a single node: "
            f"{format_percent(scalar_law.error)}, {format_percent(scalar_law.transverse_ratio)})."
        )
    torsion_sentence = f"Torsional stiffness {chain.torsional_stiffness:.6g} N m2, linear."
    axes = (
        ("z", "0 0 1", spring_stiffness),
        ("y", "0 -1 0", spring_stiffness),
        ("x", "1 0 0", chain.torsional_stiffness),
    )
    sentences = (slider_sentence, torsion_sentence)
    return Hinges(axes, tendon_coefficients, stiffnesses, slip_curvatures, sentences)


def _format_chain_deck(
    table: WireTable,
    build_hinges: Callable[[Chain], Hinges],
    load_axes: str,
    length: float | None,
    isotropic_share: float = 0.0,
) -> str:
    """Return the deck of a clamped wire, or the reason why sliders cannot be fitted to its law."""
    try:
        law = fit_wire_sliders(table)
    except ValueError as error:
        reason = describe_missing_sliders(error)
        facts = {"name": table.name, "table": table, "chain": None, "reason": reason}
        return fill_template("wire_chain.xml", **facts)
    if isotropic_share > 0.0:
        law = split_hardening(law, make_table_strand_slider(table), isotropic_share)
    length = table.spec.length if length is None else length
    require_positive("length", length)
    chain = Chain(
        law=law,
        length=length,
        radius=table.layout.wire_radius,
        mass_per_length=get_mass_per_length(table),
        torsional_stiffness=table.torsional_stiffness,
    )
    return fill_template(
        "wire_chain.xml",
        name=table.name,
        table=table,
        chain=chain,
        hinges=build_hinges(chain),
        gravity="0 0 0",
        error_sentences=describe_law_errors(table),
        n_ramp_steps=N_RAMP_STEPS,
        n_settling_steps=N_SETTLING_STEPS,
        check_load=_compute_check_load(chain.law, chain.length),
        isotropic_share=isotropic_share,
        load_gears={axis: LOAD_GEARS[axis] for axis in load_axes},
    )


@lru_cache(maxsize=4)  # laws are hashed by identity; the decks of a wire share one law
def _compute_check_load(law: SliderLaw, length: float) -> dict[str, float] | None:
    """Return a load and its tip deflections, to detect a program that ignores springyield.

    The tip deflection is the largest of 0.3 L, 0.15 L, ..., 0.3 L / 32 that is within the range of
    the law, where L is the length. Return None if even the smallest of these is beyond the range.
    """
    plays = convert_to_plays(law)
    for deflection in 0.3 * length / 2.0 ** np.arange(6.0):
        for load in compute_end_load_path(plays, length, np.array([deflection])).load.tolist():
            elastic = load * length**3 / (3.0 * law.first_stiffness)
            return {"load": load, "deflection": deflection, "elastic_deflection": elastic}
    return None
