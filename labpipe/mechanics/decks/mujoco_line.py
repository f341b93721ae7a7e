"""The line of a harness for MuJoCo 4: a chain with hysteresis, and its boundaries.

The chain is that of `decks.mujoco_sliders`, in space and with weight. A clip, pin or grip is a
mocap body that an equality holds a site of the chain to, or that the chain begins at; its path, a
row of position and quaternion for each step, is a ``numeric`` of the model, so that a program needs
no other file. Strings are tendons of limited length, loads are actuators.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from labpipe.mechanics.decks.mujoco_sliders import (
    DEFAULT_NODES,
    RAMP,
    REST,
    Chain,
    Hinges,
    make_space_hinges,
    write_model,
    write_node,
    write_tendons,
)
from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.line import Line
from labpipe.mechanics.rod.rotations import conjugate, multiply, to_rotation_vectors
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats

_TO_BODY = np.array([0.5, -0.5, -0.5, -0.5])
"""Rotation from the axes of a frame, d3 along the line, to those of a body, x along the line."""
_DIGITS = ".7g"


def write_line_deck(
    line: Line, boundaries: Sequence[rod.Boundary], *, title: str, nodes: int = DEFAULT_NODES
) -> str:
    """Write a line with all that holds, moves and loads it.

    Parameters
    ----------
    line : at the start
    boundaries : rings and planes are left out and named in a comment
    title : of the model
    nodes : of the chain

    Returns
    -------
    MJCF. The model begins as the line lies at the start; ``path_NAME`` of a clip, pin or grip has
    seven numbers a step, position and quaternion of its mocap body of that name, and
    ``release_NAME`` the step from which its equality is to be switched off.
    """
    default_mass = 1e-3  # kg/m, of a line without weight: MuJoCo needs a mass
    section = line.section
    chain = Chain(
        *(section.law, line.length, max(0.5 * section.diameter, 1e-6 * line.length)),
        *(section.mass_per_length or default_mass, section.torsional_stiffness, nodes),
    )
    hinges, sentences = make_space_hinges(chain)
    every = [boundary for boundary in boundaries if isinstance(boundary, rod.Held)]
    base = next((boundary for boundary in every if _is_base(boundary)), None)
    other_boundaries = [boundary for boundary in every if boundary is not base]
    strings = [boundary for boundary in boundaries if isinstance(boundary, rod.String)]
    loads = [boundary for boundary in boundaries if isinstance(boundary, rod.Load)]
    weight = [boundary.vector[-1] for boundary in boundaries if isinstance(boundary, rod.Gravity)]
    gravity = np.sum([np.zeros(3), *weight], axis=0)
    sections = {
        "custom": _paths(every),
        "worldbody": [
            '    <site name="space" />',
            *_chain_bodies(line, chain, hinges, [*every, *strings, *loads], base),
            *_mocap_bodies(other_boundaries, strings),
        ],
        "equality": _equalities(other_boundaries, 2.0 * chain.unit_time),
        "tendon": [*write_tendons(chain, hinges), *_strings(strings)],
        "actuator": _loads(loads),
    }
    comments = (*_comments(chain, boundaries), *sentences)
    return write_model(title, comments, chain, hinges, sections, gravity=_joined(gravity))


def _is_base(held: rod.Held) -> bool:
    """Return whether it clamps the start of the line for good, where the chain can begin."""
    return held.node == 0 and held.frame is not None and held.release is None


def _comments(chain: Chain, boundaries: Sequence[rod.Boundary]) -> Iterator[str]:
    yield "Made by labpipe. Units m, N, kg, s, rad."
    yield (
        "The model begins with the line at rest, without weight. At each step of the harness, move "
        "the mocap bodies to the next row of path_NAME (x y z, quaternion w x y z) in "
        f"{RAMP} moves or more, then let the line settle for {REST} time steps; ramp gravity and "
        "loads likewise."
    )
    yield ("release_NAME: the step at which to switch off the equality hold_NAME; 0 for never.")
    out = [boundary.name for boundary in boundaries if isinstance(boundary, rod.Ring | rod.Plane)]
    if out:
        yield f"Left out, as the chain has no contacts: {', '.join(out)}."
    if chain.law.growing:
        yield format_sentence("mechanics.decks.line_by_masing")
    yield f"Hinge i is at (i + 1/2) {chain.spacing:.6g} m."
    yield "For MuJoCo 4.0 and later: earlier versions have no springyield and refuse this file."


def _joined(values: Floats) -> str:
    return " ".join(f"{value:{_DIGITS}}" for value in np.ravel(values).tolist())


def _poses(held: rod.Held) -> Floats:
    """Return position and quaternion of a mocap body, shape (steps + 1, 7)."""
    count = len(held.position)
    if held.frame is None:
        turns = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    else:
        turns = np.broadcast_to(multiply(held.frame, _TO_BODY), (count, 4))
    return np.hstack([held.position, turns])


def _paths(held: Sequence[rod.Held]) -> Iterator[str]:
    for boundary in held:
        path, release = (
            quoteattr(f"path_{boundary.name}"),
            quoteattr(f"release_{boundary.name}"),
        )
        yield f'    <numeric name={path} data="{_joined(_poses(boundary))}" />'
        yield f'    <numeric name={release} data="{boundary.release or 0}" />'


def _mocap_bodies(held: Sequence[rod.Held], strings: Sequence[rod.String]) -> Iterator[str]:
    for boundary in held:
        pose = _poses(boundary)[0]
        name, site = quoteattr(boundary.name), quoteattr(f"hold_{boundary.name}")
        yield (
            f'    <body name={name} mocap="true" pos="{_joined(pose[:3])}" '
            f'quat="{_joined(pose[3:])}"><site name={site} /></body>'
        )
    for string in strings:
        site = quoteattr(f"anchor_{string.name}")
        yield f'    <site name={site} pos="{_joined(string.anchor[-1])}" />'


def _equalities(held: Sequence[rod.Held], time: float) -> Iterator[str]:
    """Return constraints without compliance, of a time constant in s."""
    stiff = f'solref="{time:{_DIGITS}} 1" solimp="0.9999 0.99999 1e-6"'
    for boundary in held:
        constraint = "connect" if boundary.frame is None else "weld"
        names = [quoteattr(f"{word}_{boundary.name}") for word in ("hold", "at", "hold")]
        yield f"    <{constraint} name={names[0]} site1={names[1]} site2={names[2]} {stiff} />"


def _strings(strings: Sequence[rod.String]) -> Iterator[str]:
    for string in strings:
        node_name, anchor = quoteattr(f"at_{string.name}"), quoteattr(f"anchor_{string.name}")
        yield (
            f'    <spatial name={quoteattr(string.name)} limited="true" '
            f'range="0 {string.length:{_DIGITS}}">'
            f"<site site={node_name} /><site site={anchor} /></spatial>"
        )


def _loads(loads: Sequence[rod.Load]) -> Iterator[str]:
    for load in loads:
        node_name = quoteattr(f"at_{load.name}")
        for number, axis in enumerate("xyz"):
            gear = _joined(np.eye(6)[number])
            name = quoteattr(f"{load.name}_{axis}")
            yield f'    <motor name={name} site={node_name} refsite="space" gear="{gear}" />'


def _chain_bodies(
    line: Line,
    chain: Chain,
    hinges: Hinges,
    tied: Sequence[rod.Held | rod.String | rod.Load],
    base: rod.Held | None,
) -> Iterator[str]:
    """Return the chain, on its base or free in space."""
    h, last = chain.spacing, chain.nodes
    frames = multiply(_frames_at(line, chain), _TO_BODY)
    sites = _sites(line, chain, tied)
    prefix = _unused_prefix([load.name for load in tied])
    name = f"{prefix}_0" if base is None else base.name
    base_attributes = "><freejoint />" if base is None else ' mocap="true">'
    place = f'pos="{_joined(line.positions[0])}" quat="{_joined(frames[0])}"'
    yield f"    <body name={quoteattr(name)} {place}{base_attributes}"
    for node in range(last + 1):
        if node:
            turn = multiply(conjugate(frames[node - 1]), frames[node])
            begin = 0.5 * h if node == 1 else h
            place = f'pos="{begin:{_DIGITS}} 0 0" quat="{_joined(turn)}"'
            yield f'    <body name="{prefix}_{node}" {place}>'
        yield from write_node(chain, hinges, node)
        for name, along in sites[node]:
            yield f'      <site name={quoteattr(f"at_{name}")} pos="{along:{_DIGITS}} 0 0" />'
    yield "    " + "</body>" * (last + 1)


def _unused_prefix(names: Sequence[str]) -> str:
    """Return a prefix for the bodies of the chain that no name of the file begins with."""
    prefix = "node"
    while any(name.startswith(f"{prefix}_") for name in names):
        prefix = f"_{prefix}"
    return prefix


def _sites(
    line: Line, chain: Chain, tied: Sequence[rod.Held | rod.String | rod.Load]
) -> list[list[tuple[str, float]]]:
    """Return by body the names of places on it and their distances from its start, m."""
    sites: list[list[tuple[str, float]]] = [[] for _ in range(chain.nodes + 1)]
    for load in tied:
        along = float(line.stations[load.node])
        body = min(int(along / chain.spacing + 0.5), chain.nodes)
        begin = (body - 0.5) * chain.spacing if body else 0.0
        sites[body].append((load.name, along - begin))
    return sites


def _frames_at(line: Line, chain: Chain) -> Floats:
    """Return the frames of the bodies at the start, (nodes + 1, 4): those of the elements there."""
    middles = np.arange(chain.nodes + 1) * chain.spacing
    element = np.searchsorted(line.stations[1:-1], middles)
    steps = to_rotation_vectors(multiply(conjugate(line.frames[:-1]), line.frames[1:]))
    is_straight = not np.any(np.abs(steps) > 1e-12)
    return np.asarray(line.frames[np.zeros_like(element) if is_straight else element])
