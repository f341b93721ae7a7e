"""The line of a harness for MuJoCo 4: a chain with hysteresis, and its boundaries.

The chain is that of `decks.mujoco_sliders`, in space and with weight. A clip, pin or grip is a
mocap body that an equality holds a site of the chain to, or that the chain begins at; its path, a
row of position and quaternion for each step, is a ``numeric`` of the model, so that a program needs
no other file. Strings are tendons of limited length, loads are actuators.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labpipe.mechanics.decks.deck_law import fill_template
from labpipe.mechanics.decks.mujoco_sliders import (
    DEFAULT_NODES,
    RAMP,
    REST,
    Chain,
    make_space_hinges,
)
from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.line import Line
from labpipe.mechanics.rod.rotations import conjugate, multiply, to_rotation_vectors
from labpipe.records.arrays import Floats

_TO_BODY = np.array([0.5, -0.5, -0.5, -0.5])
"""Rotation from the axes of a frame, d3 along the line, to those of a body, x along the line."""


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
        law=section.law,
        length=line.length,
        radius=max(0.5 * section.diameter, 1e-6 * line.length),
        mass_per_length=section.mass_per_length or default_mass,
        torsional_stiffness=section.torsional_stiffness,
        nodes=nodes,
    )
    every = [boundary for boundary in boundaries if isinstance(boundary, rod.Held)]
    base = next((held for held in every if _is_base(held)), None)
    strings = [boundary for boundary in boundaries if isinstance(boundary, rod.String)]
    loads = [boundary for boundary in boundaries if isinstance(boundary, rod.Load)]
    weight = [boundary.vector[-1] for boundary in boundaries if isinstance(boundary, rod.Gravity)]
    gravity = np.sum([np.zeros(3), *weight], axis=0)
    contacts = [b.name for b in boundaries if isinstance(b, rod.Ring | rod.Plane)]
    return fill_template(
        "line_chain.xml",
        name=title,
        chain=chain,
        hinges=make_space_hinges(chain),
        gravity=" ".join(f"{component:.7g}" for component in gravity.tolist()),
        ramp=RAMP,
        rest=REST,
        left_out=contacts,
        bodies=_list_bodies(line, chain, [*every, *strings, *loads], base),
        every=every,
        others=[held for held in every if held is not base],
        poses={held.name: _compute_poses(held) for held in every},
        strings=strings,
        loads=loads,
        gears={
            axis: " ".join("01"[n == number] for n in range(6)) for number, axis in enumerate("xyz")
        },
    )


def _is_base(held: rod.Held) -> bool:
    """Return whether it clamps the start of the line for good, where the chain can begin."""
    return held.node == 0 and held.frame is not None and held.release is None


def _compute_poses(held: rod.Held) -> Floats:
    """Return position and quaternion of a mocap body, shape (steps + 1, 7)."""
    count = len(held.position)
    if held.frame is None:
        turns = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    else:
        turns = np.broadcast_to(multiply(held.frame, _TO_BODY), (count, 4))
    return np.hstack([held.position, turns])


def _list_bodies(
    line: Line,
    chain: Chain,
    tied: Sequence[rod.Held | rod.String | rod.Load],
    base: rod.Held | None,
) -> list[dict[str, object]]:
    """Return the bodies of the chain, on its base or free in space, each in the one before."""
    frames = multiply(_find_frames(line, chain), _TO_BODY)
    prefix = _find_unused_prefix([tie.name for tie in tied])
    bodies: list[dict[str, object]] = [
        {
            "name": f"{prefix}_0" if base is None else base.name,
            "position": line.positions[0],
            "turn": frames[0],
            "kind": "><freejoint />" if base is None else ' mocap="true">',
        }
    ]
    for node in range(1, chain.nodes + 1):
        begin = 0.5 * chain.spacing if node == 1 else chain.spacing
        turn = multiply(conjugate(frames[node - 1]), frames[node])
        body = {"name": f"{prefix}_{node}", "position": np.array([begin, 0.0, 0.0])}
        bodies.append({**body, "turn": turn, "kind": ">"})
    sites: list[list[tuple[str, float]]] = [[] for _ in bodies]
    for tie in tied:  # places on a body, and their distances from its start, m
        along = float(line.stations[tie.node])
        node = min(int(along / chain.spacing + 0.5), chain.nodes)
        begin = (node - 0.5) * chain.spacing if node else 0.0
        sites[node].append((tie.name, along - begin))
    return [{**body, "sites": places} for body, places in zip(bodies, sites, strict=True)]


def _find_unused_prefix(names: Sequence[str]) -> str:
    """Return a prefix for the bodies of the chain that no name of the file begins with."""
    prefix = "node"
    while any(name.startswith(f"{prefix}_") for name in names):
        prefix = f"_{prefix}"
    return prefix


def _find_frames(line: Line, chain: Chain) -> Floats:
    """Return the frames of the bodies at the start, (nodes + 1, 4): those of the elements there."""
    middles = np.arange(chain.nodes + 1) * chain.spacing
    element = np.searchsorted(line.stations[1:-1], middles)
    steps = to_rotation_vectors(multiply(conjugate(line.frames[:-1]), line.frames[1:]))
    is_straight = not np.any(np.abs(steps) > 1e-12)
    return np.asarray(line.frames[np.zeros_like(element) if is_straight else element])
