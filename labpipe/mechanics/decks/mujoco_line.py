"""Write the line of a harness for MuJoCo 4: a chain with hysteresis, its supports and its loads.

The chain is that of `decks.mujoco_sliders`, in space and with weight. A clip, pin or grip is a
mocap body. The chain begins at it, or an equality connects a site of the chain to it. Its path has
a row with position and quaternion for the start and for each step. The path is a ``numeric`` of the
model, so that a program needs no other file. Strings are tendons of limited length, and loads are
actuators.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labpipe.mechanics.decks.deck_law import fill_template
from labpipe.mechanics.decks.mujoco_sliders import (
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
"""Quaternion from the axes of a frame (d3 along the line) to those of a body (x along the line)."""


def write_line_deck(line: Line, boundaries: Sequence[rod.Boundary], *, title: str) -> str:
    """Write a line with its supports, strings and loads.

    Parameters
    ----------
    line : line in its initial shape, in which the springs of the model have no moment
    boundaries : supports, strings, loads and gravity; rings and planes are omitted and named in a
        comment
    title : name of the model

    Returns
    -------
    MJCF. Gravity and the anchors of strings are those of the last step; loads are motors without
    a value. ``path_NAME`` of a clip, pin or grip has seven numbers for the start and for each step:
    position and quaternion of the mocap body ``NAME``. ``release_NAME`` is the step from which its
    equality is to be switched off; 0 for never.
    """
    default_mass = 1e-3  # kg/m, for a line without weight, because MuJoCo requires a mass
    section = line.section
    chain = Chain(
        law=section.law,
        length=line.length,
        radius=max(0.5 * section.diameter, 1e-6 * line.length),
        mass_per_length=section.mass_per_length or default_mass,
        torsional_stiffness=section.torsional_stiffness,
    )
    supports = [boundary for boundary in boundaries if isinstance(boundary, rod.Held)]
    # A support that clamps the start of the line and never releases it is the base of the chain.
    starts = [held for held in supports if held.node == 0 and held.frame is not None]
    base = next((held for held in starts if held.release is None), None)
    strings = [boundary for boundary in boundaries if isinstance(boundary, rod.String)]
    loads = [boundary for boundary in boundaries if isinstance(boundary, rod.Load)]
    vectors = [boundary.vector[-1] for boundary in boundaries if isinstance(boundary, rod.Gravity)]
    gravity = np.sum([np.zeros(3), *vectors], axis=0)
    contacts = [
        boundary.name for boundary in boundaries if isinstance(boundary, rod.Ring | rod.Plane)
    ]
    return fill_template(
        "line_chain.xml",
        name=title,
        chain=chain,
        hinges=make_space_hinges(chain),
        gravity=" ".join(f"{component:.7g}" for component in gravity.tolist()),
        ramp=RAMP,
        rest=REST,
        omitted_contacts=contacts,
        bodies=_list_bodies(line, chain, [*supports, *strings, *loads], base),
        supports=supports,
        equality_supports=[support for support in supports if support is not base],
        poses={support.name: _compute_poses(support) for support in supports},
        strings=strings,
        loads=loads,
        gears={
            axis: " ".join("01"[n == number] for n in range(6)) for number, axis in enumerate("xyz")
        },
    )


def _compute_poses(support: rod.Held) -> Floats:
    """Return position and quaternion of a mocap body, shape (steps + 1, 7)."""
    count = len(support.position)
    if support.frame is None:
        quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    else:
        quaternions = np.broadcast_to(multiply(support.frame, _TO_BODY), (count, 4))
    return np.hstack([support.position, quaternions])


def _list_bodies(
    line: Line,
    chain: Chain,
    attachments: Sequence[rod.Held | rod.String | rod.Load],
    base: rod.Held | None,
) -> list[dict[str, object]]:
    """Return the nested bodies of the chain, on its base or free in space."""
    frames = multiply(_find_frames(line, chain), _TO_BODY)
    prefix = "node"
    while any(attachment.name.startswith(f"{prefix}_") for attachment in attachments):
        prefix = f"_{prefix}"
    bodies: list[dict[str, object]] = [
        {
            "name": f"{prefix}_0" if base is None else base.name,
            "position": line.positions[0],
            "quaternion": frames[0],
            "kind": "><freejoint />" if base is None else ' mocap="true">',
        }
    ]
    for node in range(1, chain.nodes + 1):
        offset = 0.5 * chain.spacing if node == 1 else chain.spacing
        quaternion = multiply(conjugate(frames[node - 1]), frames[node])
        body = {"name": f"{prefix}_{node}", "position": np.array([offset, 0.0, 0.0])}
        bodies.append({**body, "quaternion": quaternion, "kind": ">"})
    sites: list[list[tuple[str, float]]] = [[] for _ in bodies]
    for attachment in attachments:  # each body has sites at distances from its start, m
        arc_length = float(line.stations[attachment.node])
        node = min(int(arc_length / chain.spacing + 0.5), chain.nodes)
        body_start = (node - 0.5) * chain.spacing if node else 0.0
        sites[node].append((attachment.name, arc_length - body_start))
    return [{**body, "sites": body_sites} for body, body_sites in zip(bodies, sites, strict=True)]


def _find_frames(line: Line, chain: Chain) -> Floats:
    """Return initial frames of the bodies, shape (nodes + 1, 4), at the middle of each body."""
    middles = np.arange(chain.nodes + 1) * chain.spacing
    elements = np.searchsorted(line.stations[1:-1], middles)
    turns = to_rotation_vectors(multiply(conjugate(line.frames[:-1]), line.frames[1:]))
    is_straight = not np.any(np.abs(turns) > 1e-12)
    return np.asarray(line.frames[np.zeros_like(elements) if is_straight else elements])
