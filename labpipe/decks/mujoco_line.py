"""The line of a harness for MuJoCo 4: a chain with the memory of its law, and what moves it.

The chain is that of `decks.mujoco_sliders`, in space and with weight. A clip, pin or grip is a
mocap body that an equality holds a site of the chain to, or that the chain grows out of; its path,
a row of position and quaternion for each step, is a ``numeric`` of the model, so that a program
finds all in this one file. Strings are tendons that end, loads are actuators.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from labpipe.decks.deck_law import on_one_line
from labpipe.decks.mujoco_sliders import (
    NODES,
    RAMP,
    REST,
    Chain,
    Hinges,
    comment,
    default_lines,
    space_hinges,
    tendon_lines,
)
from labpipe.records.arrays import Floats
from labpipe.rod import boundaries as rod
from labpipe.rod.line import Line
from labpipe.rod.rotations import conjugate, multiply, rotation_vectors

_TO_BODY = np.array([0.5, -0.5, -0.5, -0.5])
"""Turns the axes of a frame, d3 along the line, into those of a body, x along the line."""
_DIGITS = ".7g"
_WIDEST = 100
_NO_MASS = 1e-3
"""kg/m, of a line without weight: MuJoCo moves masses."""
_STEP = 1.0  # as in `mujoco_sliders`
_TIGHT = 'solref="{:.7g} 1" solimp="0.9999 0.99999 1e-6"'


def line_deck(
    line: Line, boundaries: Sequence[rod.Boundary], *, title: str, nodes: int = NODES
) -> str:
    """Write a line with what holds, moves and pulls it.

    Parameters
    ----------
    line : at the start
    boundaries : rings and planes are left out, and named
    title : of the model
    nodes : of the chain

    Returns
    -------
    MJCF. The model begins as the line lies at the start; ``path_NAME`` of a clip, pin or grip has
    seven numbers a step, position and quaternion of its mocap body of that name, and
    ``release_NAME`` the step from which its equality is to be switched off.
    """
    section = line.section
    chain = Chain(
        *(section.law, line.length, max(0.5 * section.diameter, 1e-6 * line.length)),
        *(section.mass_per_length or _NO_MASS, section.torsional_stiffness, nodes),
    )
    hinges, words = space_hinges(chain)
    every = [boundary for boundary in boundaries if isinstance(boundary, rod.Held)]
    base = next((each for each in every if _is_base(each)), None)
    held = [each for each in every if each is not base]
    strings = [boundary for boundary in boundaries if isinstance(boundary, rod.String)]
    loads = [boundary for boundary in boundaries if isinstance(boundary, rod.Load)]
    weight = [boundary.vector[-1] for boundary in boundaries if isinstance(boundary, rod.Gravity)]
    gravity = np.sum([np.zeros(3), *weight], axis=0)
    step = _STEP * chain.unit_time
    text = [
        f"<mujoco model={quoteattr(on_one_line(title, _WIDEST))}>",
        *map(comment, (*_words(chain, boundaries), *words)),
        '  <compiler angle="radian" />',
        f'  <option timestep="{step:{_DIGITS}}" integrator="discrete" '
        f'gravity="{_numbers(gravity)}"><flag contact="disable" /></option>',
        *default_lines(chain, hinges),
        "  <custom>",
        *_paths(every),
        "  </custom>",
        "  <worldbody>",
        '    <site name="space" />',
        *_chain_bodies(line, chain, hinges, [*every, *strings, *loads], base),
        *_holders(held, strings),
        "  </worldbody>",
        "  <equality>",
        *_equalities(held, _TIGHT.format(2.0 * step)),
        "  </equality>",
        "  <tendon>",
        *tendon_lines(chain, hinges),
        *_strings(strings),
        "  </tendon>",
        "  <actuator>",
        *_loads(loads),
        "  </actuator>",
        "</mujoco>",
    ]
    return "\n".join(text) + "\n"


def _is_base(held: rod.Held) -> bool:
    """Whether it clamps the begin of the line all the way, so that the chain can grow out of it."""
    return held.node == 0 and held.frame is not None and held.release is None


def _words(chain: Chain, boundaries: Sequence[rod.Boundary]) -> Iterator[str]:
    yield "Made by labpipe. Units m, N, kg, s, rad."
    yield (
        "The model begins where the line is at rest, without weight. At each step of the harness, "
        "move the mocap bodies to the next row of path_NAME (x y z, quaternion w x y z), in "
        f"{RAMP} moves or more, and let the line settle for {REST} time steps at the end; grow "
        "gravity and loads likewise."
    )
    yield (
        "release_NAME: the step from which the equality hold_NAME is to be switched off; 0 never."
    )
    out = [
        boundary.name
        for boundary in boundaries
        if isinstance(boundary, rod.Ring | rod.Plane | rod.Moment)
    ]
    if out:
        yield f"Left out, as this chain touches nothing: {', '.join(out)}."
    yield f"Hinge i is at (i + 1/2) {chain.spacing:.6g} m."
    yield "For MuJoCo 4.0 and later: earlier versions have no springyield and refuse this file."


def _numbers(values: Floats) -> str:
    return " ".join(f"{value:{_DIGITS}}" for value in np.ravel(values).tolist())


def _name(boundary: rod.Boundary) -> str:
    """As in the file; XML has all of Unicode."""
    return boundary.name


def _poses(held: rod.Held) -> Floats:
    """Rows of position and quaternion of a mocap body, shape (steps + 1, 7)."""
    count = len(held.position)
    if held.frame is None:
        turns = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    else:
        turns = np.broadcast_to(multiply(held.frame, _TO_BODY), (count, 4))
    return np.hstack([held.position, turns])


def _paths(held: Sequence[rod.Held]) -> Iterator[str]:
    for each in held:
        path, release = quoteattr(f"path_{_name(each)}"), quoteattr(f"release_{_name(each)}")
        yield f'    <numeric name={path} data="{_numbers(_poses(each))}" />'
        yield f'    <numeric name={release} data="{each.release or 0}" />'


def _holders(held: Sequence[rod.Held], strings: Sequence[rod.String]) -> Iterator[str]:
    for each in held:
        pose = _poses(each)[0]
        name, site = quoteattr(_name(each)), quoteattr(f"hold_{_name(each)}")
        yield (
            f'    <body name={name} mocap="true" pos="{_numbers(pose[:3])}" '
            f'quat="{_numbers(pose[3:])}"><site name={site} /></body>'
        )
    for string in strings:
        site = quoteattr(f"anchor_{_name(string)}")
        yield f'    <site name={site} pos="{_numbers(string.anchor[-1])}" />'


def _equalities(held: Sequence[rod.Held], tight: str) -> Iterator[str]:
    for each in held:
        kind = "connect" if each.frame is None else "weld"
        names = [quoteattr(f"{word}_{_name(each)}") for word in ("hold", "at", "hold")]
        yield f"    <{kind} name={names[0]} site1={names[1]} site2={names[2]} {tight} />"


def _strings(strings: Sequence[rod.String]) -> Iterator[str]:
    for string in strings:
        at, anchor = quoteattr(f"at_{_name(string)}"), quoteattr(f"anchor_{_name(string)}")
        yield (
            f'    <spatial name={quoteattr(_name(string))} limited="true" '
            f'range="0 {string.length:{_DIGITS}}">'
            f"<site site={at} /><site site={anchor} /></spatial>"
        )


def _loads(loads: Sequence[rod.Load]) -> Iterator[str]:
    for load in loads:
        at = quoteattr(f"at_{_name(load)}")
        for number, axis in enumerate("xyz"):
            gear = _numbers(np.eye(6)[number])
            name = quoteattr(f"{_name(load)}_{axis}")
            yield f'    <motor name={name} site={at} refsite="space" gear="{gear}" />'


def _chain_bodies(
    line: Line,
    chain: Chain,
    hinges: Hinges,
    tied: Sequence[rod.Held | rod.String | rod.Load],
    base: rod.Held | None,
) -> Iterator[str]:
    """The chain, on its base or free in space; its first and last body are half as long."""
    h, last = chain.spacing, chain.nodes
    frames = multiply(_frames_at(line, chain), _TO_BODY)
    sites = _sites(line, chain, tied)
    own = _own_word([_name(load) for load in tied])
    name = f"{own}_0" if base is None else _name(base)
    kind = "><freejoint />" if base is None else ' mocap="true">'
    place = f'pos="{_numbers(line.positions[0])}" quat="{_numbers(frames[0])}"'
    yield f"    <body name={quoteattr(name)} {place}{kind}"
    yield from _piece(chain, 0.5 * h, sites[0])
    for node in range(1, last + 1):
        begin, reach = (0.5 * h if node == 1 else h), (0.5 * h if node == last else h)
        turn = multiply(conjugate(frames[node - 1]), frames[node])
        yield f'    <body name="{own}_{node}" pos="{begin:{_DIGITS}} 0 0" quat="{_numbers(turn)}">'
        for name, axis, stiffness in hinges.axes:
            yield (
                f'      <joint name="{name}_{node}" axis="{axis}" '
                f'stiffness="{stiffness / h:{_DIGITS}}" />'
            )
        yield from _piece(chain, reach, sites[node])
    yield "    " + "</body>" * (last + 1)


def _own_word(names: Sequence[str]) -> str:
    """How the names of the chain's own bodies begin: as none of the file's does."""
    word = "node"
    while any(name.startswith(f"{word}_") for name in names):
        word = f"_{word}"
    return word


def _piece(chain: Chain, reach: float, sites: Sequence[tuple[str, float]]) -> Iterator[str]:
    yield (
        f'      <geom fromto="0 0 0 {reach:{_DIGITS}} 0 0" '
        f'mass="{chain.mass_per_length * reach:{_DIGITS}}" />'
    )
    for name, place in sites:
        yield f'      <site name={quoteattr(f"at_{name}")} pos="{place:{_DIGITS}} 0 0" />'


def _sites(
    line: Line, chain: Chain, tied: Sequence[rod.Held | rod.String | rod.Load]
) -> list[list[tuple[str, float]]]:
    """By body, names of places on it and how far they are from its begin, m."""
    sites: list[list[tuple[str, float]]] = [[] for _ in range(chain.nodes + 1)]
    for load in tied:
        along = float(line.stations[load.node])
        body = min(int(along / chain.spacing + 0.5), chain.nodes)
        begin = (body - 0.5) * chain.spacing if body else 0.0
        sites[body].append((_name(load), along - begin))
    return sites


def _frames_at(line: Line, chain: Chain) -> Floats:
    """Frames of the bodies at the start, shape (nodes + 1, 4): those of the elements there."""
    middles = np.arange(chain.nodes + 1) * chain.spacing
    element = np.searchsorted(line.stations[1:-1], middles)
    steps = rotation_vectors(multiply(conjugate(line.frames[:-1]), line.frames[1:]))
    is_straight = not np.any(np.abs(steps) > 1e-12)
    return np.asarray(line.frames[np.zeros_like(element) if is_straight else element])
