"""A wire for MuJoCo 4 with the memory of its law: a chain of hinges with springs that yield.

MuJoCo 4.0 has ideal elasto-plastic springs (``springyield`` of joints and tendons: the displacement
at which the spring's rest begins to follow). A node of the chain has a spring that never yields
and, for each slider of `law.sliders`, a fixed tendon on its hinge: stiffness K_j / h and yield
h kappa_j, h being the length of wire that the node stands for. Hinge i is at (i + 1/2) h, so that
the chain is of second order in h.

In space a node has two hinges, and the tendons of `law.slider_directions` on sums of their angles,
in directions that are turned from one node to the next; a third hinge twists.

Springs that yield keep what a load leaves, overshoot included. So a load must be ramped, and the
joints are damped; the deck says how long both take.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from xml.sax.saxutils import quoteattr

import numpy as np

from labpipe.decks.deck_law import facts, mass_of, on_one_line
from labpipe.decks.deck_losses import loss_words
from labpipe.decks.slider_table import no_sliders
from labpipe.law.plays import is_within
from labpipe.law.slider_directions import TURNS, in_directions, turned
from labpipe.law.sliders import MOST_SLIDERS, SliderLaw, as_plays
from labpipe.law.table_sliders import SLIDERS, sliders_of, table_card
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable
from labpipe.wire.end_load import end_loads

DIRECTIONS = 4
"""Of scalar sliders in space; not turned from node to node they bend C4 up to 0.9 mm sideways."""
MOST_IN_DIRECTION = 8
NODES = 30
FEWEST_NODES = 3
RAMP = 400
"""Steps over which a load is to grow."""
REST = 600
"""Steps until it has settled."""

_FIRST_ROOT = 1.8751040687119611  # of cos x cosh x = -1: first mode of a cantilever
_STEP = 1.0  # of the time 1 / (first angular frequency): springs and dampers are implicit
_DAMPING = 0.5  # of a node's first stiffness times that time
_WIDEST_NAME = 100
_DIGITS = ".7g"
_CHECKED, _HALVED = 0.3, 6
"""Of the length, where the tip is in the check; how often that is halved for a law that ends."""
_NO_SHARE = 1e-9  # of an angle
_NODE = "@"  # stands for the number of a node


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
        """Length of wire that a node stands for, m."""
        return self.length / self.nodes

    @property
    def unit_time(self) -> float:
        """One over the first angular frequency while nothing slides, s."""
        stretch = np.sqrt(self.law.first_stiffness / self.mass_per_length)
        return float(self.length**2 / (_FIRST_ROOT**2 * stretch))

    @property
    def damping(self) -> float:
        """Of a hinge, N m s."""
        return _DAMPING * self.law.first_stiffness / self.spacing * self.unit_time


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


def mujoco_plane_deck(
    table: WireTable, *, sliders: int = SLIDERS, length: float | None = None, nodes: int = NODES
) -> str:
    """Write a clamped wire along x that bends in the plane of x and y, with its loops.

    Parameters
    ----------
    table : law of the wire
    sliders : at most
    length : free length, m; None for that of the wire's cantilever
    nodes : of the chain, at least 3

    Returns
    -------
    MJCF. The actuator ``pull_y`` is a force at the tip, in N, whose direction does not turn.

    Raises
    ------
    ValueError
        If a number is out of its range.

    Notes
    -----
    A law that sliders cannot have (`fit_sliders`) gets the reason and nothing to run.
    """
    made = _law(table, sliders)
    if isinstance(made, str):
        return made
    chain = _chain(table, made, length, nodes)
    law = chain.law
    hinges = Hinges(
        (("z", "0 0 1", law.stiffness),), np.ones((1, 1, 1)), law.stiffnesses, law.slip_curvatures
    )
    lines = (
        f"{len(law.stiffnesses)} sliders at each of {nodes} nodes, in one plane: within "
        f"{100.0 * law.error:.2g} % of the wire's moment.",
    )
    return _deck(table, chain, hinges, lines, pulls="y")


def mujoco_space_deck(
    table: WireTable,
    *,
    sliders: int = SLIDERS,
    directions: int = DIRECTIONS,
    length: float | None = None,
    nodes: int = NODES,
) -> str:
    """Write a clamped wire along x that bends in every plane and twists, with its loops.

    Parameters
    ----------
    table : law of the wire
    sliders : of the law that the scalar sliders come close to
    directions : in which each node has scalar sliders
    length, nodes : as for `mujoco_plane_deck`

    Returns
    -------
    MJCF. The actuators ``pull_y`` and ``pull_z`` are forces at the tip, in N.

    Raises
    ------
    ValueError
        As `mujoco_plane_deck`.
    """
    made = _law(table, sliders)
    if isinstance(made, str):
        return made
    chain = _chain(table, made, length, nodes)
    hinges, lines = space_hinges(chain, directions)
    return _deck(table, chain, hinges, lines, pulls="yz")


def space_hinges(chain: Chain, directions: int = DIRECTIONS) -> tuple[Hinges, tuple[str, str]]:
    """Hinges of a chain that bends in every plane and twists, and what a deck says of them.

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
    few = in_directions(chain.law, directions, most=MOST_IN_DIRECTION)
    axes = _axes(chain, few.stiffness * directions / 2.0)
    tendons = np.array([few.turned_normals(share) for share in TURNS])
    hinges = Hinges(axes, tendons, few.stiffnesses, few.slip_curvatures)
    mean = turned(chain.law, few)
    angles = ", ".join(f"{180.0 / directions * share:.4g}" for share in TURNS)
    lines = (
        f"{len(few.stiffnesses)} sliders in each of {directions} directions at each of "
        f"{chain.nodes} nodes, turned from node to node by {angles} deg. MuJoCo has no vector "
        f"sliders: bent in the worst direction, the moment of {len(TURNS)} nodes together is "
        f"{_percent(mean.error)} off, and {_percent(mean.sideways)} of it points sideways (of one "
        "alone: "
        f"{_percent(few.error)}, {_percent(few.sideways)}).",
        twist,
    )
    return hinges, lines


def _axes(chain: Chain, spring: float) -> tuple[tuple[str, str, float], ...]:
    """Hinges of a node in space with their springs, N m^2."""
    twist = ("x", "1 0 0", chain.torsional_stiffness)
    return ("z", "0 0 1", spring), ("y", "0 -1 0", spring), twist


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def _law(table: WireTable, sliders: int) -> SliderLaw | str:
    """Sliders of a wire, or a deck that says why there are none."""
    if not 1 <= sliders <= MOST_SLIDERS:
        message = f"sliders={sliders}: allowed are numbers from 1 to {MOST_SLIDERS}"
        raise ValueError(message)
    try:
        return sliders_of(table, sliders)
    except ValueError as error:
        name = on_one_line(table.name, _WIDEST_NAME)
        lines = "\n".join(map(comment, (*facts(table, name), no_sliders(error))))
        return f"<mujoco model={quoteattr(name)}>\n{lines}\n</mujoco>\n"


def comment(line: str) -> str:
    """A line of text in XML, in which two hyphens would end a comment.

    Parameters
    ----------
    line : text
    """
    return f"  <!-- {line.replace('--', '- -')} -->"


def _chain(table: WireTable, law: SliderLaw, length: float | None, nodes: int) -> Chain:
    length = table.spec.length if length is None else length
    if not (np.isfinite(length) and length > 0.0):
        message = f"length={length!r}: allowed are finite numbers > 0"
        raise ValueError(message)
    if nodes < FEWEST_NODES:
        message = f"nodes={nodes}: allowed are numbers >= {FEWEST_NODES}"
        raise ValueError(message)
    return Chain(
        law,
        length,
        table.layout.wire_radius,
        mass_of(table),
        table.torsional_stiffness,
        nodes,
    )


def _deck(
    table: WireTable, chain: Chain, hinges: Hinges, lines: tuple[str, ...], *, pulls: str
) -> str:
    """The whole text; written line by line, as a chain has thousands of springs."""
    comments = [*_comments(table, chain), *lines]
    gears = {"y": "0 1 0 0 0 0", "z": "0 0 1 0 0 0"}
    model = quoteattr(on_one_line(table.name, _WIDEST_NAME))
    text = [
        f"<mujoco model={model}>",
        *map(comment, comments),
        '  <compiler angle="radian" />',
        f'  <option timestep="{_STEP * chain.unit_time:{_DIGITS}}" integrator="discrete" '
        'gravity="0 0 0"><flag contact="disable" /></option>',
        *default_lines(chain, hinges),
        "  <worldbody>",
        '    <site name="clamp" />',
        *_bodies(chain, hinges),
        "  </worldbody>",
        "  <tendon>",
        *tendon_lines(chain, hinges),
        "  </tendon>",
        "  <actuator>",
        *(
            f'    <motor name="pull_{axis}" site="tip" refsite="clamp" gear="{gears[axis]}" />'
            for axis in pulls
        ),
        "  </actuator>",
        '  <sensor><framepos name="tip" objtype="site" objname="tip" /></sensor>',
        "</mujoco>",
    ]
    return "\n".join(text) + "\n"


def default_lines(chain: Chain, hinges: Hinges) -> Iterator[str]:
    """What all nodes have alike: hinges, wire, and a class for each slider.

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
        *facts(table, on_one_line(table.name, _WIDEST_NAME)),
        "Unloading and cycles follow by Masing's rule: springs that yield, and keep what a load "
        "leaves.",
        loss_words(table_card(table)),
        f"Ramp every load, over {RAMP} steps or more, and give it {REST} steps to settle: springs "
        "that yield keep what a load overshoots. With a tenth of the damping here a load that "
        "jumps leaves 5 to 17 % too much.",
        "actuators pull_y (pull_z): force at the tip in N, in a direction that does not turn.",
        f"Free length {chain.length:.6g} m, clamped at x = 0; hinge i at (i + 1/2) "
        f"{chain.spacing:.6g} m.",
        f"Mass {chain.mass_per_length:.4g} kg/m, for the way to rest only: there is no gravity. So "
        "is the damping.",
        "For MuJoCo 4.0 and later: earlier versions have no springyield and refuse this file.",
        *_check(chain.law, chain.length),
    )


@lru_cache(maxsize=4)  # a law is known by its identity
def _check(law: SliderLaw, length: float) -> tuple[str, ...]:
    """A load and where it brings the tip: an engine that skips what it does not know shows here."""
    plays, share = as_plays(law), _CHECKED
    for _ in range(_HALVED):
        bent = end_loads(plays, length, np.array([share * length]))
        if is_within(plays, float(bent.clamp_moment[0])):
            load = float(bent.load[0])
            stuck = load * length**3 / (3.0 * law.first_stiffness)
            return (
                f"Check: pull_y = {load:.4g} N, ramped, brings the tip to y = "
                f"{share * length:.4g} m, within 2 %. An engine that leaves springyield out stops "
                f"at {stuck:.3g} m.",
            )
        share *= 0.5
    return ()


def _bodies(chain: Chain, hinges: Hinges) -> Iterator[str]:
    h, last = chain.spacing, chain.nodes
    for node in range(1, last + 1):
        place = 0.5 * h if node == 1 else h
        reach = 0.5 * h if node == last else h
        yield f'    <body name="node_{node}" pos="{place:{_DIGITS}} 0 0">'
        for name, axis, stiffness in hinges.axes:
            yield (
                f'      <joint name="{name}_{node}" axis="{axis}" '
                f'stiffness="{stiffness / h:{_DIGITS}}" />'
            )
        yield (
            f'      <geom fromto="0 0 0 {reach:{_DIGITS}} 0 0" '
            f'mass="{chain.mass_per_length * reach:{_DIGITS}}" />'
        )
    yield f'      <site name="tip" pos="{0.5 * h:{_DIGITS}} 0 0" />'
    yield "    " + "</body>" * last


def tendon_lines(chain: Chain, hinges: Hinges) -> Iterator[str]:
    """Sliders of all nodes, each a tendon on the node's hinges.

    Parameters
    ----------
    chain : numbers of the model
    hinges : of a node
    """
    classes = [f"slider_{number}" for number in range(1, len(hinges.stiffnesses) + 1)]
    blocks = [
        "\n".join(
            f'    <fixed class="{each}">{_joints(hinges, row)}</fixed>'
            for row in shares.tolist()
            for each in classes
        )
        for shares in hinges.tendons
    ]
    for node in range(1, chain.nodes + 1):
        yield blocks[(node - 1) % len(blocks)].replace(_NODE, str(node))


def _joints(hinges: Hinges, shares: Sequence[float]) -> str:
    """Joints of a tendon, of a node that is still to be numbered."""
    return "".join(
        f'<joint joint="{name}_{_NODE}" coef="{share:{_DIGITS}}" />'
        for (name, _, _), share in zip(hinges.axes, shares, strict=False)
        if abs(share) > _NO_SHARE
    )
