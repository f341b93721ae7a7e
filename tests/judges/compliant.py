"""The step of the source's appendix B, (B.1)-(B.2): a rod of compliant constraints.

The source follows a harness through changed boundaries by steps

    [ M   -J^T   ] [ dx      ]       [ 0            ]
    [ J    alpha ] [ dlambda ]  =  - [ C + alpha l  ]                                  (B.1)

which is the position-based rod of Deul, Kugelstadt, Weiler and Bender (Direct position-based
solver for stiff rods, 2018; Macklin, Mueller and Chentanez: XPBD, 2016). Where the source's text
and its equations differ, they are read so (PHYSICS 7):

- an element is a stiff body with centre x_i and frame q_i; p_i is the arm from its centre to the
  joint with the next. The first row of (B.2), (p_i + x_i) - (x_(i+1) - p_(i+1)), is the gap there:
  it keeps the length of the rod, not that of an element, which cannot change.
- the second row, 2 / l Im(conj(q_i) q_(i+1)) less its value at rest, is the Darboux vector, bending
  and twist. It has nothing to do with unit quaternions: these stay so, for they are turned by
  rotation vectors.
- lambda = -C / alpha, and alpha, the inverse of the stiffness, is divided by the square of the
  step's time. "Constraints" on the right is C + alpha lambda, from lambda = 0 at each step.
- M holds masses and moments of inertia; x starts where velocity and weight alone would take it.

The right side of the first row is zero in the source: how J turns within the step is left out. That
is no loss where the rod is at rest, since weight moves elements without turning them; it asks for
short steps where it moves. Weight that waits, motion that dies out by damping: the answer is
that of `rod.statics`, with which it shares no code, and takes a hundred times as long. It is here
for comparison. Bending is linear, without memory.

A plane with friction is not in the source's equations, only in its figure B.3, a chain lifted from
a table. Nodes that touch get a row each: no gap, and no slip while friction holds it; else friction
is a known force against the slip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.sparse import diags_array
from scipy.sparse.linalg import splu

from labpipe.records.arrays import ArrayRecord, Floats
from labpipe.rod.boundaries import Boundary, Gravity, Held, Load, Plane
from labpipe.rod.line import Line
from tests.judges.compliant_rows import (
    Body,
    Contact,
    Rod,
    darboux,
    ends,
    held,
    impulse,
    joints,
    place_at,
    stacked,
    touching,
    turn_between,
    turned,
)

_APART = 1e-9
"""Of a node's mobility: keeps rows apart that say the same, as along a straight line that is held
at both ends. It slows the iterations, and moves nothing."""


@dataclass(frozen=True, slots=True)
class CompliantSettings:
    """How the step is made.

    Parameters
    ----------
    step_time : s
    substeps : of that time, to each step of the boundaries
    damping : 1/s, share of the velocity that is lost per time
    iterations : of (B.1) within a substep; with one alone, friction trembles
    is_chain : leave the Darboux rows out, as the source did for its figure B.3: neither bending nor
        twist meets any resistance
    """

    step_time: float = 2e-3
    substeps: int = 10
    damping: float = 5.0
    iterations: int = 2
    is_chain: bool = False

    def __post_init__(self) -> None:
        if not (np.isfinite(self.step_time) and self.step_time > 0.0):
            message = f"step_time={self.step_time!r}: allowed are finite numbers > 0"
            raise ValueError(message)
        if not (np.isfinite(self.damping) and self.damping >= 0.0):
            message = f"damping={self.damping!r}: allowed are finite numbers >= 0"
            raise ValueError(message)
        for name in ("substeps", "iterations"):
            if getattr(self, name) < 1:
                message = f"{name}={getattr(self, name)!r}: allowed are numbers >= 1"
                raise ValueError(message)


@dataclass(frozen=True, slots=True, eq=False)
class CompliantPath(ArrayRecord):
    """Shapes after each step of the boundaries.

    Parameters
    ----------
    positions : m, shape (states, nodes, 3); a joint's is the mean of the two ends that meet there
    frames : unit quaternions (w, x, y, z), shape (states, elements, 4)
    forces : N, shape (states, joints, 3), in space, with which an element pulls the one before it
    stretch : shape (states,), length of the rod over its length at rest, less 1
    speed : m/s, shape (states,), of the fastest element: how far from rest the state is
    """

    positions: Annotated[Floats, "states", "nodes", 3]
    frames: Annotated[Floats, "states", "elements", 4]
    forces: Annotated[Floats, "states", "joints", 3]
    stretch: Annotated[Floats, "states"]
    speed: Annotated[Floats, "states"]


def compliant_path(
    line: Line,
    boundaries: Sequence[Boundary],
    *,
    steps: int,
    settings: CompliantSettings | None = None,
) -> CompliantPath:
    """Follow a line through its boundaries by the source's step.

    Parameters
    ----------
    line : with a mass per length, and a bending law without sliders
    boundaries : nodes held or clamped, loads, weight, at most one plane
    steps : of the boundaries' paths
    settings : of the step

    Returns
    -------
    steps + 1 states, the first before anything moved.

    Raises
    ------
    ValueError
        If the line has no mass, or a law with sliders; if a boundary is of another kind.
    """
    walk = _walk_of(line, boundaries, settings or CompliantSettings())
    rod, substeps = walk.rod, walk.settings.substeps
    body, contact = _at_rest(line), walk.contact
    states = [_seen(rod, body, np.zeros((rod.count - 1, 3)))]
    for step in range(1, steps + 1):
        for part in range(1, substeps + 1):
            when = step - 1 + part / substeps
            body, contact, pulls = _advance(walk, body, contact, when)
        states.append(_seen(rod, body, pulls))
    return CompliantPath(*(np.array(each) for each in zip(*states, strict=True)))


@dataclass(frozen=True, slots=True, eq=False)
class _Walk:
    """What is given, boundaries by kind; nodes that are held do not touch the plane."""

    rod: Rod
    settings: CompliantSettings
    held: tuple[Held, ...]
    loads: tuple[Load, ...]
    weights: tuple[Gravity, ...]
    contact: Contact | None


def _rod_of(line: Line, boundaries: Sequence[Boundary], settings: CompliantSettings) -> Rod:
    section, lengths = line.section, np.asarray(line.lengths)
    if not section.mass_per_length > 0.0:
        message = f"mass_per_length={section.mass_per_length!r}: allowed are numbers > 0"
        raise ValueError(message)
    if len(section.law.stiffnesses):
        message = f"a law with {len(section.law.stiffnesses)} sliders: allowed is one without"
        raise ValueError(message)
    stiffness = np.array([section.law.stiffness] * 2 + [section.torsional_stiffness])
    spacing = 0.5 * (lengths[1:] + lengths[:-1])
    time = settings.step_time
    clamps = [each for each in boundaries if isinstance(each, Held) and each.frame is not None]
    clamped = np.array([each.node % (len(lengths) + 1) for each in clamps], dtype=np.int64)
    mass = section.mass_per_length * lengths
    return Rod(
        half=0.5 * lengths,
        mass=mass,
        inertia=mass * lengths**2 / 12.0,
        spacing=spacing,
        rest=_imaginary(line.natural, spacing),
        stretching=float(np.mean(spacing)) / (section.axial_stiffness * time**2),
        bending=None if settings.is_chain else 1.0 / (stiffness * time**2),
        clamped=clamped,
    )


def _imaginary(curvature: Floats, spacing: Floats) -> Floats:
    """2 / l Im(q) of turns whose rotation vectors are the curvature times l."""
    half = 0.5 * np.linalg.norm(curvature, axis=1) * spacing
    return np.asarray(np.sinc(half / np.pi)[:, None] * curvature)


def _walk_of(line: Line, boundaries: Sequence[Boundary], settings: CompliantSettings) -> _Walk:
    for each in boundaries:
        lets_go = isinstance(each, Held) and each.release is not None
        if lets_go or not isinstance(each, Held | Load | Gravity | Plane):
            message = (
                f"a {type(each).__name__}{' that lets go' if lets_go else ''}: allowed are nodes "
                "held for good, loads, weight and a plane"
            )
            raise ValueError(message)
    radius = 0.5 * line.section.diameter
    planes = [each.raised(radius) for each in boundaries if isinstance(each, Plane)]
    if len(planes) > 1:
        message = f"{len(planes)} planes: allowed is one"
        raise ValueError(message)
    rod = _rod_of(line, boundaries, settings)
    grips = tuple(each for each in boundaries if isinstance(each, Held))
    free = np.setdiff1d(np.arange(rod.count + 1), [each.node % (rod.count + 1) for each in grips])
    return _Walk(
        rod=rod,
        settings=settings,
        held=grips,
        loads=tuple(each for each in boundaries if isinstance(each, Load)),
        weights=tuple(each for each in boundaries if isinstance(each, Gravity)),
        contact=Contact(planes[0], free, np.zeros((len(free), 3))) if planes else None,
    )


def _at_rest(line: Line) -> Body:
    still = np.zeros((len(line.lengths), 3))
    centres = 0.5 * (line.positions[1:] + line.positions[:-1])
    return Body(centres, np.array(line.frames), still, still)


def _advance(
    walk: _Walk, body: Body, contact: Contact | None, when: float
) -> tuple[Body, Contact | None, Floats]:
    """One substep, and what the joints pull with, N."""
    rod, time = walk.rod, walk.settings.step_time
    kept = np.exp(-walk.settings.damping * time)
    fall = time * kept * body.velocity
    for each in walk.weights:
        fall = fall + time**2 * place_at(each.vector, when)
    moved = _moved(body, np.hstack([fall, time * kept * body.spin]))
    mobility = 1.0 / np.column_stack([rod.mass] * 3 + [rod.inertia] * 3).ravel()
    push = _loads(walk, moved, when)
    applied = np.zeros(0) if contact is None else np.zeros_like(contact.held)
    multipliers = np.zeros(0)
    for _ in range(walk.settings.iterations):
        rows = [joints(rod, moved), *darboux(rod, moved)]
        rows += [row for each in walk.held for row in held(rod, moved, each, when)]
        own = stacked(rows)
        multipliers = multipliers if len(multipliers) else np.zeros_like(own.gap)
        gap = own.gap + own.compliance * multipliers
        if contact is not None:
            touched, contact, at = touching(rod, body, moved, contact)
            change = (contact.held - applied) @ contact.axes
            push = push + impulse(rod, moved, contact.nodes, change)
            own, gap = stacked([own, touched]), np.concatenate([gap, touched.gap])
        jacobian = own.jacobian(rod.count)
        weighted = jacobian @ diags_array(mobility)
        matrix = weighted @ jacobian.T + diags_array(own.compliance + _APART / np.min(rod.mass))
        found = splu(matrix.tocsc()).solve(-gap - weighted @ push)
        moved = _moved(moved, (mobility * (jacobian.T @ found + push)).reshape(-1, 6))
        push = np.zeros_like(push)
        multipliers = multipliers + found[: len(multipliers)]
        if contact is not None:
            applied = contact.held.copy()
            applied[at, 0] += found[len(multipliers) :]
            contact = replace(contact, held=applied)
    ended = replace(
        moved,
        velocity=(moved.centres - body.centres) / time,
        spin=turn_between(body.frames, moved.frames) / time,
    )
    pulls = multipliers[: 3 * (rod.count - 1)].reshape(-1, 3) / time**2
    return ended, contact, pulls


def _moved(body: Body, by: Floats) -> Body:
    """Elements after displacements and rotation vectors, shape (n, 6)."""
    return replace(body, centres=body.centres + by[:, :3], frames=turned(body.frames, by[:, 3:]))


def _loads(walk: _Walk, body: Body, when: float) -> Floats:
    """What loads do in a step, kg m and kg m^2, shape (6 n,)."""
    rod, time = walk.rod, walk.settings.step_time
    whole = np.zeros(6 * rod.count)
    for each in walk.loads:
        force = place_at(each.force, when)
        whole += impulse(rod, body, np.array([each.node % (rod.count + 1)]), time**2 * force[None])
    return whole


def _seen(rod: Rod, body: Body, pulls: Floats) -> tuple[Floats, Floats, Floats, float, float]:
    """One state of the path."""
    near, far = ends(rod, body)
    nodes = np.vstack([near[:1], 0.5 * (near[1:] + far[:-1]), far[-1:]])
    length = np.sum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))
    stretch = float(length / (2.0 * np.sum(rod.half)) - 1.0)
    return nodes, body.frames, pulls, stretch, float(np.max(np.linalg.norm(body.velocity, axis=1)))
