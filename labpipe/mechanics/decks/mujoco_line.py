"""Format the line of a harness for MuJoCo 4: a chain with hysteresis, its supports and its loads.

The chain is that of `decks.mujoco_sliders`, in space and with weight. A clip, pin or grip is a
mocap body. This body is the base of the chain, or an equality connects a site of the chain to it.
The path of the body has a row with position and quaternion for the start and for each step. The
path is a ``numeric`` of the model, so that a program needs no other file. Strings are tendons of
limited length, and loads are actuators.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labpipe.mechanics.decks.deck_law import fill_template
from labpipe.mechanics.decks.mujoco_sliders import (
    LOAD_GEARS,
    N_RAMP_STEPS,
    N_SETTLING_STEPS,
    Chain,
    build_space_hinges,
)
from labpipe.mechanics.rod.boundaries import Boundary, Gravity, Held, Load, Plane, Ring, String
from labpipe.mechanics.rod.line import Line
from labpipe.mechanics.rod.rotations import conjugate, multiply, to_rotation_vectors
from labpipe.records.arrays import Floats

_LINE_TO_BODY = np.array([0.5, -0.5, -0.5, -0.5])
"""Quaternion from the axes of a line (d3 along the line) to those of a body (x along the line)."""


def format_line_deck(line: Line, boundaries: Sequence[Boundary], *, title: str) -> str:
    """Return the MJCF of a line with its supports, strings and loads.

    Parameters
    ----------
    line : line in its initial shape, in which the springs of the model have no moment
    boundaries : supports, strings, loads and gravity; a comment names the rings and planes, which
        the model omits
    title : name of the model

    Returns
    -------
    MJCF. Gravity and the anchors of strings are those of the last step. Loads are motors, whose
    forces the program sets. ``path_NAME`` of a clip, pin or grip has seven values for the start and
    for each step: position and quaternion of the mocap body ``NAME``. ``release_NAME`` is the step
    at which the program must switch off the equality of this body; 0 for never.
    """
    default_mass_per_length = 1e-3  # kg/m; MuJoCo also requires the mass of a weightless line
    min_relative_radius = 1e-6  # radius relative to the length, for a line of unknown diameter
    section = line.section
    chain = Chain(
        law=section.law,
        length=line.length,
        radius=max(0.5 * section.diameter, min_relative_radius * line.length),
        mass_per_length=section.mass_per_length or default_mass_per_length,
        torsional_stiffness=section.torsional_stiffness,
    )
    supports = [boundary for boundary in boundaries if isinstance(boundary, Held)]
    # A support that clamps the start of the line and never releases it is the base of the chain.
    start_clamps = [clamp for clamp in supports if clamp.node == 0 and clamp.frame is not None]
    base = next((clamp for clamp in start_clamps if clamp.release is None), None)
    strings = [boundary for boundary in boundaries if isinstance(boundary, String)]
    loads = [boundary for boundary in boundaries if isinstance(boundary, Load)]
    accelerations = [weight.vector[-1] for weight in boundaries if isinstance(weight, Gravity)]
    gravity = np.sum([np.zeros(3), *accelerations], axis=0)
    contacts = [boundary for boundary in boundaries if isinstance(boundary, Ring | Plane)]
    return fill_template(
        "line_chain.xml",
        name=title,
        chain=chain,
        hinges=build_space_hinges(chain),
        gravity=" ".join(f"{component:.7g}" for component in gravity.tolist()),
        n_ramp_steps=N_RAMP_STEPS,
        n_settling_steps=N_SETTLING_STEPS,
        omitted_contacts=[contact.name for contact in contacts],
        bodies=_list_bodies(line, chain, [*supports, *strings, *loads], base),
        supports=supports,
        equality_supports=[support for support in supports if support is not base],
        poses={support.name: _compute_poses(support) for support in supports},
        strings=strings,
        loads=loads,
        load_gears=LOAD_GEARS,
    )


def _compute_poses(support: Held) -> Floats:
    """Return the positions, m, and quaternions of a mocap body, shape (steps + 1, 7)."""
    n_rows = len(support.position)
    if support.frame is None:
        quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (n_rows, 1))
    else:
        quaternions = np.broadcast_to(multiply(support.frame, _LINE_TO_BODY), (n_rows, 4))
    return np.hstack([support.position, quaternions])


def _list_bodies(
    line: Line,
    chain: Chain,
    attachments: Sequence[Held | String | Load],
    base: Held | None,
) -> list[dict[str, object]]:
    """Return the nested bodies of the chain, on the base, or free in space without a base."""
    quaternions = multiply(_compute_body_frames(line, chain), _LINE_TO_BODY)
    prefix = "node"
    while any(attachment.name.startswith(f"{prefix}_") for attachment in attachments):
        prefix = f"_{prefix}"
    bodies: list[dict[str, object]] = [
        {
            "name": f"{prefix}_0" if base is None else base.name,
            "position": line.positions[0],
            "quaternion": quaternions[0],
            "tag_end": "><freejoint />" if base is None else ' mocap="true">',
        }
    ]
    for node in range(1, chain.n_nodes + 1):
        offset = 0.5 * chain.spacing if node == 1 else chain.spacing
        quaternion = multiply(conjugate(quaternions[node - 1]), quaternions[node])
        body = {"name": f"{prefix}_{node}", "position": np.array([offset, 0.0, 0.0])}
        bodies.append({**body, "quaternion": quaternion, "tag_end": ">"})
    # name of each site of a body, and distance of the site from the start of the body, m
    sites_by_body: list[list[tuple[str, float]]] = [[] for _ in bodies]
    for attachment in attachments:
        arc_length = float(line.stations[attachment.node])
        node = min(int(arc_length / chain.spacing + 0.5), chain.n_nodes)
        body_start = (node - 0.5) * chain.spacing if node else 0.0
        sites_by_body[node].append((attachment.name, arc_length - body_start))
    return [{**body, "sites": sites} for body, sites in zip(bodies, sites_by_body, strict=True)]


def _compute_body_frames(line: Line, chain: Chain) -> Floats:
    """Return the initial frames of the bodies, shape (nodes + 1, 4), at the middle of each body.

    The axis d3 of each frame is along the line.
    """
    max_straight_rotation = 1e-12  # rad
    middles = np.arange(chain.n_nodes + 1) * chain.spacing
    elements = np.searchsorted(line.stations[1:-1], middles)
    rotations = to_rotation_vectors(multiply(conjugate(line.frames[:-1]), line.frames[1:]))
    is_straight = not np.any(np.abs(rotations) > max_straight_rotation)
    return np.asarray(line.frames[np.zeros_like(elements) if is_straight else elements])
