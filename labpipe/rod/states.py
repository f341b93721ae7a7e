"""Conversion between the cells of the solver and the nodes of a state."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.rod.assembly import Assembly, Balance, Demands, Shape
from labpipe.rod.boundaries import Load
from labpipe.rod.path import RodState
from labpipe.rod.rotations import matrices
from labpipe.rod.schedule import Schedule
from labpipe.rod.supports import END_SHARE, Supports


class BalancedShape(Protocol):
    """A shape in balance under demands."""

    @property
    def shape(self) -> Shape:
        """Return the shape of the line."""

    @property
    def balance(self) -> Balance:
        """Return its balance."""

    @property
    def demands(self) -> Demands:
        """Return its demands."""


def merge_rests(supports: Supports, rests: Floats) -> Floats:
    """Return the rests of cells, shape (cells, sliders, 2), from those before and behind the nodes.

    Without a clamp both sides form one cell with the mean of their rests, which is admissible.
    """
    return np.asarray(np.einsum("cs,csjx->cjx", supports.sides, rests[supports.nodes]))


def split_rests(supports: Supports, rests: Floats) -> Floats:
    """Return the rests before and behind the nodes, shape (n + 1, 2, sliders, 2), from cells."""
    return _at_sides(supports, rests)


def _at_sides(supports: Supports, values: Floats) -> Floats:
    out = np.zeros((supports.n_nodes, 2, *values.shape[1:]))
    for side in (0, 1):
        is_held = supports.sides[:, side] > 0.0
        out[supports.nodes[is_held], side] = values[is_held]
    return out


def state_of(
    assembly: Assembly, schedule: Schedule, grips: tuple[int, ...], now: BalancedShape, step: int
) -> RodState:
    """Return the state of a step, with all forces and moments in space."""
    supports, cells = assembly.supports, now.balance.cells
    n_nodes = assembly.n + 1
    forces, clamp_moments = assembly.reactions(now.balance, now.demands)
    moments = _at_sides(supports, _moments_in_space(assembly, now))
    reaction_forces, reaction_moments = np.zeros((2, len(schedule.boundaries), 3))
    reaction_forces[list(grips)] = forces
    for k, load in enumerate(schedule.boundaries):
        if isinstance(load, Load):
            reaction_forces[k] = load.force[min(step, len(load.force) - 1)]
    clamped = [grips[int(row)] for row in supports.clamps]
    reaction_moments[clamped] = clamp_moments
    for k, touch in zip(schedule.planes, now.balance.touches, strict=True):
        reaction_forces[k] = touch.forces.sum(axis=0)
    reaction_forces[list(schedule.strings)] = now.balance.tensions
    slid = np.full(len(schedule.boundaries), np.nan)
    stations = assembly.line.stations
    for k, thread in zip(schedule.rings, now.balance.threads, strict=True):
        reaction_forces[k] = thread.force
        slid[k] = np.interp(thread.place, np.arange(n_nodes), stations)
    touched = np.array([touch.forces for touch in now.balance.touches]).reshape(-1, n_nodes, 3)
    return RodState(
        positions=now.shape.positions,
        frames=now.shape.frames,
        stretches=now.shape.stretches,
        forces=now.shape.forces,
        moments=moments,
        curvatures=_at_sides(supports, cells.curvatures),
        node_curvatures=_at_sides(supports, _to_clamps(supports, cells.curvatures)),
        rests=_at_sides(supports, now.balance.memory.rests),
        reaction_forces=reaction_forces,
        reaction_moments=reaction_moments,
        contacts=now.balance.memory.contacts,
        contact_forces=touched,
        slid=slid,
    )


def _to_clamps(supports: Supports, curvatures: Floats) -> Floats:
    """Return the curvatures of the cells, shape (cells, 3), extrapolated to clamps.

    Along the straight line to the next cell: a half cell bends as the line does at a share
    `END_SHARE` of its element.
    """
    clamps, lengths = curvatures.copy(), supports.lengths
    for end, side in ((supports.behind, -1), (supports.before, 1)):
        nodes = np.flatnonzero(end < 0)
        nodes = nodes[(nodes + side >= 0) & (nodes + side < len(end))]
        place = END_SHARE * 2.0 * lengths[nodes]
        share = place / (lengths[nodes] + 0.5 * lengths[nodes + side] - place)
        clamps[nodes] += share[:, None] * (curvatures[nodes] - curvatures[nodes + side])
    return clamps


def _moments_in_space(assembly: Assembly, now: BalancedShape) -> Floats:
    """Return the moments of the cells, by the part behind on the part before, N m, (cells, 3).

    At a clamp it is the moment at the node, which exceeds that of the half cell.
    """
    supports, cells = assembly.supports, now.balance.cells
    frames = np.concatenate([now.shape.frames, now.demands.clamps[::-1]])
    turned = matrices(frames[supports.behind])
    moments = np.einsum("nxy,ny->nx", turned, cells.behind)
    for (row, clamp), lent in zip(supports.lent, now.balance.directions.lent_moments, strict=True):
        element, mark = supports.ends[row], -1 - clamp
        moments[(supports.before == mark) & (supports.behind == element)] -= lent
        moments[(supports.behind == mark) & (supports.before == element)] += lent
    return np.asarray(moments)
