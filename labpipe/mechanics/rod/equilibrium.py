"""Equilibrium of a line under new demands, by Newton's method."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from labpipe.mechanics.rod.assembly import (
    ArtificialDrag,
    Assembly,
    Balance,
    Demands,
    LineMemory,
    Shape,
)
from labpipe.mechanics.rod.rotations import (
    conjugate,
    from_rotation_vectors,
    multiply,
    rotation_vectors,
    unit,
)
from labpipe.records.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Equilibrium:
    """An equilibrium: its shape, balance and number of iterations."""

    shape: Shape
    balance: Balance
    iterations: int


def find_equilibrium(
    assembly: Assembly,
    shape: Shape,
    memory: LineMemory,
    demands: tuple[Demands, Demands],
    *,
    force: float,
    earlier: LineMemory | None = None,
    drag: ArtificialDrag | None = None,
) -> Equilibrium | None:
    """Find the next equilibrium from one.

    Parameters
    ----------
    assembly : the line with its supports
    shape, memory : present shape and history
    demands : present and new ones
    force : N, size of the forces on the whole line
    earlier : history before the last step: equal forces, but sliders that slid slide on, which is
        the better guess where the motion continues
    drag : artificial drag

    Returns
    -------
    The equilibrium; None where Newton's method does not find a near one.
    """
    max_iterations = 20
    max_idle_iterations = 4  # between corners of the law Newton's method may circle for ever
    min_step_share = 0.1  # of a step; a direction that is cut further says nothing
    now, goal = demands
    nodes = assembly.supports.held
    # held nodes and clamps move with the first step, or the share of it that is taken
    present_demands = replace(goal, held=now.held, clamps=now.clamps)
    balance = assembly.balance(shape, present_demands, memory if earlier is None else earlier, drag)
    least_turn, idle = math.inf, 0
    for iteration in range(1, max_iterations + 1):
        held = goal.held - shape.positions[nodes]
        clamps = rotation_vectors(multiply(conjugate(present_demands.clamps), goal.clamps))
        right = assembly.right_side(balance, shape, present_demands, held, clamps)
        change = assembly.band.solve(balance.values, right)
        if change is None:
            return None
        turn = _largest_turn(assembly, change)
        least_turn, idle = (turn, 0) if turn < least_turn else (least_turn, idle + 1)
        share = _step_share(assembly, change, turn)
        if share < min_step_share or idle == max_idle_iterations:
            return None
        shape = assembly.changed(shape, share * change)
        present_demands = goal if share == 1.0 else _turn_clamps(present_demands, share * clamps)
        balance = assembly.balance(shape, present_demands, memory, drag)
        if share == 1.0 and _is_close(assembly, balance, shape, change, force):
            return Equilibrium(shape, balance, iteration)
    return None


def _turn_clamps(demands: Demands, clamps: Floats) -> Demands:
    return replace(demands, clamps=unit(multiply(demands.clamps, from_rotation_vectors(clamps))))


def _largest_turn(assembly: Assembly, change: Floats) -> float:
    return float(np.max(np.abs(change[assembly.places.turns[:, None] + np.arange(3)])))


def _step_share(assembly: Assembly, change: Floats, turn: float) -> float:
    """Return the share of a step that turns and moves no part of the line too far."""
    max_turn = 0.7  # rad, of an element in one iteration
    max_move = 0.35  # of the line's length, of a node in one iteration
    p = assembly.places
    move = float(np.max(np.abs(change[p.positions[:, None] + np.arange(3)])))
    return 1.0 / max(1.0, turn / max_turn, move / (max_move * assembly.line.length))


def _is_close(
    assembly: Assembly, balance: Balance, shape: Shape, change: Floats, force: float
) -> bool:
    balance_tolerance = 1e-10  # of force, moment and length of the whole line
    # of the length, or rad: ends the search where rounding limits the balance
    step_tolerance = 1e-11
    rounded_balance = 1e-5
    # of the forces on the line: the shape of a tauter line is mostly rounding
    max_pull_factor = 1e4
    p = assembly.places
    three = np.arange(3)
    length = assembly.line.length
    residual = np.where(assembly.band.fixed, 0.0, balance.residual)
    pull = float(np.max(np.abs(shape.forces)))
    if assembly.is_rigid and pull > max_pull_factor * force:
        return False
    force = max(force, pull)
    unbalanced = float(np.max(np.abs(residual[p.positions[:, None] + three])))
    error = max(
        max(unbalanced - assembly.rounding, 0.0) / force,
        float(np.max(np.abs(residual[p.turns[:, None] + three]))) / (force * length),
        float(np.max(np.abs(residual[p.stretches]))) / (force * length),
        float(np.max(np.abs(residual[p.forces[:, None] + three]))) / length,
    )
    if error < balance_tolerance:
        return True
    moved = max(
        _largest_turn(assembly, change),
        float(np.max(np.abs(change[p.positions[:, None] + three]))) / length,
    )
    return moved < step_tolerance and error < rounded_balance
