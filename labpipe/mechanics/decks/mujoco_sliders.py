"""A wire for MuJoCo 4 with the memory of its law: a chain of hinges with springs that yield.

MuJoCo 4.0 has ideal elasto-plastic springs (``springyield`` of joints and tendons: the displacement
at which the spring's rest begins to follow). A node of the chain has a spring that never yields
and, for each slider of `law.sliders`, a fixed tendon on its hinge: stiffness K_j / h and yield
h kappa_j, h being the length of wire that the node stands for. Hinge i is at (i + 1/2) h, so that
the chain is of second order in h.

In space a node has two hinges with the tendons of `law.sliders` on sums of their angles,
in directions that are rotated from one node to the next; a third hinge twists.

A slider whose limit grows (isotropic hardening) is one more tendon, in a plane. MuJoCo keeps its
yield constant: a program must raise it at each step by the plastic displacement so far
(``examples/mujoco_growing.py``).

Springs that yield keep the effect of an overshoot. Therefore a load must be ramped and the joints
are damped; the deck states how long both take.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from xml.sax.saxutils import quoteattr

import numpy as np

from labpipe.mechanics.decks.deck_law import (
    compute_first_frequency,
    describe_losses,
    find_mass,
    format_percent,
    list_facts,
    shorten_name,
    write_xml_comment,
)
from labpipe.mechanics.decks.lookup import describe_missing_sliders
from labpipe.mechanics.decks.unloading import describe_unloading, make_table_strands
from labpipe.mechanics.law.loss_card import N_DIRECTIONS, SLIDERS, fit_wire_sliders, make_table_card
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
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable

DEFAULT_NODES = 30
RAMP = 400
"""Steps of the ramp of a load."""
REST = 600
"""Steps until a load has settled."""

_DIGITS = ".7g"
_NODE = "@"  # placeholder of the number of a node


@dataclass(frozen=True, slots=True)
class Chain:
    """Numbers of the model, SI.

    Parameters
    ----------
    law : of the wire
    length, radius : m
    mass_per_length : kg/m
    torsional_stiffness : N m^2
    nodes : number
    """

    law: SliderLaw
    length: float
    radius: float
    mass_per_length: float
    torsional_stiffness: float
    nodes: int

    @property
    def spacing(self) -> float:
        """Return the length of wire that a node stands for, m."""
        return self.length / self.nodes

    @property
    def unit_time(self) -> float:
        """Time step, s: one over the first angular frequency while nothing slides."""
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
    tendons : shape (turns, directions, hinges), share of each hinge's angle; nodes take one turn
        after another
    stiffnesses, slip_curvatures : of the sliders in each direction
    """

    axes: tuple[tuple[str, str, float], ...]
    tendons: Floats
    stiffnesses: Floats
    slip_curvatures: Floats


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
    sliders : at most
    length : free length, m; None for that of the wire's cantilever
    nodes : of the chain, at least 3
    isotropic_share : from 0 (Masing's rule) to 1; above 0 the program that runs the model must
        raise the yield of the tendons ``growing_<node>`` at each step

    Returns
    -------
    MJCF. The actuator ``pull_y`` is a force at the tip, in N, of constant direction. With an
    isotropic share ``growing_yield`` has the yields over ``growing_slid``, the sum of the plastic
    displacement so far without its sign, both in rad.

    Raises
    ------
    ValueError
        If a number is out of its range.

    Notes
    -----
    A law that cannot be fitted by sliders (`fit_sliders`) gets the reason and nothing to run.
    """
    in_range = 0.0 <= isotropic_share <= 1.0
    require("isotropic_share", isotropic_share, "from 0 to 1", holds=in_range)
    law = _law(table, sliders)
    if isinstance(law, str):
        return law
    if isotropic_share > 0.0:
        law = share_hardening(law, make_table_strands(table, sliders), isotropic_share)
    chain = _chain(table, law, length, nodes)
    chain_law = chain.law
    hinges = Hinges(
        (("z", "0 0 1", chain_law.stiffness),),
        np.ones((1, 1, 1)),
        chain_law.stiffnesses,
        chain_law.slip_curvatures,
    )
    lines: tuple[str, ...] = (
        f"{len(chain_law.stiffnesses)} sliders at each of {nodes} nodes, in one plane: error up "
        f"to {100.0 * chain_law.error:.2g} % of the moment.",
    )
    if chain_law.growing:
        lines = (
            *lines,
            format_sentence("mechanics.decks.growing_tendons", share=isotropic_share),
        )
    return _deck(table, chain, hinges, lines, pulls="y")


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
    sliders : of the law that the scalar sliders come close to
    directions : in which each node has scalar sliders
    length, nodes : as for `write_mujoco_plane_deck`

    Returns
    -------
    MJCF. The actuators ``pull_y`` and ``pull_z`` are forces at the tip, in N.

    Raises
    ------
    ValueError
        As `write_mujoco_plane_deck`.
    """
    law = _law(table, sliders)
    if isinstance(law, str):
        return law
    chain = _chain(table, law, length, nodes)
    hinges, lines = make_space_hinges(chain, directions)
    return _deck(table, chain, hinges, lines, pulls="yz")


def make_space_hinges(
    chain: Chain, directions: int = N_DIRECTIONS
) -> tuple[Hinges, tuple[str, str]]:
    """Return the hinges of a chain that bends in every plane and twists, with their comments.

    Parameters
    ----------
    chain : numbers of the model
    directions : in which each node has scalar sliders
    """
    twist = f"Torsional stiffness {chain.torsional_stiffness:.6g} N m2, linear."
    if not len(chain.law.stiffnesses):
        nothing = np.zeros(0)
        hinges = Hinges(_axes(chain, chain.law.stiffness), np.zeros((1, 0, 2)), nothing, nothing)
        return hinges, (f"Bending stiffness {chain.law.stiffness:.6g} N m2, constant.", twist)
    few = fit_directions(chain.law, directions, max_sliders=8)
    axes = _axes(chain, few.stiffness * directions / 2.0)
    tendons = np.array([few.turned_normals(share) for share in TURNS])
    hinges = Hinges(axes, tendons, few.stiffnesses, few.slip_curvatures)
    mean = turn_directions(chain.law, few)
    angles = ", ".join(f"{180.0 / directions * share:.4g}" for share in TURNS)
    lines = (
        f"{len(few.stiffnesses)} sliders in each of {directions} directions at each of "
        f"{chain.nodes} nodes, rotated from node to node by {angles} deg. MuJoCo has no vector "
        f"sliders: in the worst direction of bending, the moment of {len(TURNS)} nodes has an "
        f"error of {format_percent(mean.error)} and a lateral part of "
        f"{format_percent(mean.sideways)} (one node: {format_percent(few.error)}, "
        f"{format_percent(few.sideways)}).",
        twist,
    )
    return hinges, lines


def _axes(chain: Chain, spring: float) -> tuple[tuple[str, str, float], ...]:
    """Return the hinges of a node in space with their springs, N m^2."""
    twist = ("x", "1 0 0", chain.torsional_stiffness)
    return ("z", "0 0 1", spring), ("y", "0 -1 0", spring), twist


def _law(table: WireTable, sliders: int) -> SliderLaw | str:
    """Return the sliders of a wire, or a deck with the reason why there are none."""
    allowed = f"from 1 to {MAX_SLIDERS}"
    require("sliders", sliders, allowed, holds=1 <= sliders <= MAX_SLIDERS)
    try:
        return fit_wire_sliders(table, sliders)
    except ValueError as error:
        name = shorten_name(table.name)
        lines = "\n".join(
            map(write_xml_comment, (*list_facts(table, name), describe_missing_sliders(error)))
        )
        return f"<mujoco model={quoteattr(name)}>\n{lines}\n</mujoco>\n"


def _chain(table: WireTable, law: SliderLaw, length: float | None, nodes: int) -> Chain:
    min_nodes = 3
    length = table.spec.length if length is None else length
    require_positive("length", length)
    require("nodes", nodes, f">= {min_nodes}", holds=nodes >= min_nodes)
    return Chain(
        law,
        length,
        table.layout.wire_radius,
        find_mass(table),
        table.torsional_stiffness,
        nodes,
    )


def _deck(
    table: WireTable, chain: Chain, hinges: Hinges, lines: tuple[str, ...], *, pulls: str
) -> str:
    """Return the whole text of a clamped wire."""
    gears = {"y": "0 1 0 0 0 0", "z": "0 0 1 0 0 0"}
    motors = [
        f'    <motor name="pull_{axis}" site="tip" refsite="clamp" gear="{gears[axis]}" />'
        for axis in pulls
    ]
    sections = {
        "worldbody": ['    <site name="clamp" />', *_bodies(chain, hinges)],
        "tendon": [*write_tendons(chain, hinges), *_growing_tendons(chain)],
        "custom": _growing_numbers(chain),
        "actuator": motors,
        "sensor": ['    <framepos name="tip" objtype="site" objname="tip" />'],
    }
    return write_model(table.name, [*_comments(table, chain), *lines], chain, hinges, sections)


def _growing_tendons(chain: Chain) -> Iterator[str]:
    """Return the slider of each node whose limit grows, in the plane."""
    h = chain.spacing
    for slider in chain.law.growing:
        stiffness, first = slider.stiffness / h, slider.limits[0] / slider.stiffness * h
        for node in range(1, chain.nodes + 1):
            yield (
                f'    <fixed name="growing_{node}" stiffness="{stiffness:{_DIGITS}}" '
                f'springyield="{first:{_DIGITS}}"><joint joint="z_{node}" coef="1" /></fixed>'
            )


def _growing_numbers(chain: Chain) -> Iterator[str]:
    """Return yields over the plastic displacement so far, rad."""
    h = chain.spacing
    for slider in chain.law.growing:
        columns = {"slid": slider.slid * h, "yield": slider.limits / slider.stiffness * h}
        for name, values in columns.items():
            data = " ".join(f"{value:{_DIGITS}}" for value in values.tolist())
            yield f'    <numeric name="growing_{name}" data="{data}" />'


def write_model(
    name: str,
    comments: Iterable[str],
    chain: Chain,
    hinges: Hinges,
    sections: Mapping[str, Iterable[str]],
    *,
    gravity: str = "0 0 0",
) -> str:
    """Return the text of a model, which is not built as a tree: a chain has thousands of springs.

    Parameters
    ----------
    name, comments : of the model
    chain, hinges : of which it is made
    sections : lines by element
    gravity : m/s^2
    """
    text = [
        f"<mujoco model={quoteattr(shorten_name(name))}>",
        *map(write_xml_comment, comments),
        '  <compiler angle="radian" />',
        f'  <option timestep="{chain.unit_time:{_DIGITS}}" integrator="discrete" '
        f'gravity="{gravity}"><flag contact="disable" /></option>',
        *default_lines(chain, hinges),
    ]
    for section, lines in sections.items():
        text += [f"  <{section}>", *lines, f"  </{section}>"]
    return "\n".join([*text, "</mujoco>"]) + "\n"


def default_lines(chain: Chain, hinges: Hinges) -> Iterator[str]:
    """Return the defaults of all nodes: hinges, geometry and a class for each slider.

    Parameters
    ----------
    chain : numbers of the model
    hinges : of a node
    """
    h = chain.spacing
    yield "  <default>"
    yield f'    <joint type="hinge" damping="{chain.damping:{_DIGITS}}" />'
    yield f'    <geom type="capsule" size="{chain.radius:{_DIGITS}}" />'
    for number, (stiffness, slip) in enumerate(
        zip(hinges.stiffnesses, hinges.slip_curvatures, strict=True), start=1
    ):
        yield (
            f'    <default class="slider_{number}"><tendon stiffness="{stiffness / h:{_DIGITS}}" '
            f'springyield="{slip * h:{_DIGITS}}" /></default>'
        )
    yield "  </default>"


def _comments(table: WireTable, chain: Chain) -> tuple[str, ...]:
    return (
        *list_facts(table, shorten_name(table.name)),
        "Springs yield and keep their plastic displacement: without growing tendons unloading and "
        "cycles follow Masing's rule.",
        describe_unloading(table, "Masing"),
        describe_losses(make_table_card(table)),
        f"Ramp every load over {RAMP} steps or more and let it settle for {REST} steps: springs "
        "that yield keep the effect of an overshoot. A stepped load with a tenth of this damping "
        "leaves 5 to 17 % too much.",
        "Actuators pull_y (pull_z): force at the tip in N, of constant direction.",
        f"Free length {chain.length:.6g} m, clamped at x = 0; hinge i at (i + 1/2) "
        f"{chain.spacing:.6g} m.",
        f"Mass {chain.mass_per_length:.4g} kg/m and damping matter until rest only: there is no "
        "gravity.",
        "For MuJoCo 4.0 and later: earlier versions have no springyield and refuse this file.",
        *_check(chain.law, chain.length),
    )


@lru_cache(maxsize=4)  # a law is known by its identity
def _check(law: SliderLaw, length: float) -> tuple[str, ...]:
    """Return a load and its tip deflection, to detect an engine that ignores springyield."""
    plays, share = (
        convert_to_plays(law),
        0.3,
    )  # deflection over length, halved for a law that ends before
    max_halvings = 6
    for _ in range(max_halvings):
        path = compute_end_load_path(plays, length, np.array([share * length]))
        if len(path.load):
            load = float(path.load[0])
            stuck = load * length**3 / (3.0 * law.first_stiffness)
            return (
                f"Check: pull_y = {load:.4g} N, ramped, brings the tip to y = "
                f"{share * length:.4g} m, within 2 %. An engine that ignores springyield stops at "
                f"{stuck:.3g} m.",
            )
        share *= 0.5
    return ()


def _bodies(chain: Chain, hinges: Hinges) -> Iterator[str]:
    h, last = chain.spacing, chain.nodes
    for node in range(1, last + 1):
        place = 0.5 * h if node == 1 else h
        yield f'    <body name="node_{node}" pos="{place:{_DIGITS}} 0 0">'
        yield from write_node(chain, hinges, node)
    yield f'      <site name="tip" pos="{0.5 * h:{_DIGITS}} 0 0" />'
    yield "    " + "</body>" * last


def write_node(chain: Chain, hinges: Hinges, node: int) -> Iterator[str]:
    """Return hinges and geometry of a body; the ends of the chain are half as long.

    Parameters
    ----------
    chain : numbers of the model
    hinges : of a node
    node : number of the body; 0 is the base, which has no hinges
    """
    h = chain.spacing
    capsule_length = 0.5 * h if node in (0, chain.nodes) else h
    for name, axis, stiffness in hinges.axes if node else ():
        yield (
            f'      <joint name="{name}_{node}" axis="{axis}" '
            f'stiffness="{stiffness / h:{_DIGITS}}" />'
        )
    yield (
        f'      <geom fromto="0 0 0 {capsule_length:{_DIGITS}} 0 0" '
        f'mass="{chain.mass_per_length * capsule_length:{_DIGITS}}" />'
    )


def write_tendons(chain: Chain, hinges: Hinges) -> Iterator[str]:
    """Return the sliders of all nodes, each a tendon on the hinges of its node.

    Parameters
    ----------
    chain : numbers of the model
    hinges : of a node
    """
    classes = [f"slider_{number}" for number in range(1, len(hinges.stiffnesses) + 1)]
    blocks = [
        "\n".join(
            f'    <fixed class="{name}">{_joints(hinges, row)}</fixed>'
            for row in shares.tolist()
            for name in classes
        )
        for shares in hinges.tendons
    ]
    for node in range(1, chain.nodes + 1):
        yield blocks[(node - 1) % len(blocks)].replace(_NODE, str(node))


def _joints(hinges: Hinges, shares: Sequence[float]) -> str:
    """Return the joints of a tendon, with a placeholder for the number of the node."""
    return "".join(
        f'<joint joint="{name}_{_NODE}" coef="{share:{_DIGITS}}" />'
        for (name, _, _), share in zip(hinges.axes, shares, strict=False)
        if abs(share) > 1e-9
    )
