"""Newton's method for the equilibrium of a line whose boundaries have moved."""

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
from labpipe.mechanics.rod.banded import join_unknowns, split_unknowns
from labpipe.mechanics.rod.rotations import (
    conjugate,
    from_rotation_vectors,
    multiply,
    to_rotation_vectors,
    unit,
)


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
    guess: LineMemory,
    known_balance: Balance | None = None,
    drag: ArtificialDrag | None = None,
) -> Equilibrium | None:
    """Find the equilibrium after the boundaries have moved, starting from the previous one.

    Parameters
    ----------
    assembly : the line with its supports
    shape, memory : present shape and history
    demands : present and new ones
    force : N, magnitude of the forces on the whole line
    guess : history for the first iteration, either the present one or that before the last step.
        Both give equal forces; with the latter, sliders that slid continue to slide, which is the
        better guess if the motion continues
    known_balance : balance of the present shape, if it is known
    drag : artificial drag, if any

    Returns
    -------
    The equilibrium; None if Newton's method does not converge to one near by.
    """
    max_iterations = 20
    max_idle_iterations = 4  # Newton's method may cycle between corners of the law
    min_step_share = 0.1  # of a step; a direction that must be shortened further is useless
    now, target = demands
    nodes = assembly.supports.held
    # held nodes and clamps move with the first step, or the share of it that is taken
    present_demands = replace(target, held=now.held, clamps=now.clamps)
    balance = (
        _update_balance(known_balance, now, target, guess)
        if known_balance and drag is None
        else None
    )
    if balance is None:
        balance = assembly.balance(shape, present_demands, guess, drag)
    least_turn, idle = math.inf, 0
    for iteration in range(1, max_iterations + 1):
        held_shift = target.held - shape.positions[nodes]
        clamps = to_rotation_vectors(multiply(conjugate(present_demands.clamps), target.clamps))
        right = assembly.right_side(balance, shape, present_demands, held_shift, clamps)
        change = assembly.band.solve(balance.values, right)
        if change is None:
            return None
        moves, _, turns, _ = split_unknowns(change)
        turn, move = float(np.max(np.abs(turns))), float(np.max(np.abs(moves)))
        least_turn, idle = (turn, 0) if turn < least_turn else (least_turn, idle + 1)
        share = _limit_step(turn, move / assembly.line.length)
        if share < min_step_share or idle == max_idle_iterations:
            return None
        shape = assembly.changed(shape, share * change)
        if share == 1.0:
            present_demands = target
        else:
            turned = multiply(present_demands.clamps, from_rotation_vectors(share * clamps))
            present_demands = replace(present_demands, clamps=unit(turned))
        balance = assembly.balance(shape, present_demands, memory, drag)
        relative_change = max(turn, move / assembly.line.length)
        if share == 1.0 and _is_balanced(assembly, balance, shape, relative_change, force):
            return Equilibrium(shape, balance, iteration)
    return None


def _update_balance(
    known_balance: Balance, now: Demands, goal: Demands, guess: LineMemory
) -> Balance | None:
    """Return a balance with the forces of new demands; None if it does not apply to them."""
    memory, drag = known_balance.inputs
    demand_pairs = ((now.anchors, goal.anchors), (now.rings, goal.rings))
    if (
        memory is not guess
        or drag is not None
        or not all(np.array_equal(*pair) for pair in demand_pairs)
    ):
        return None
    none = np.zeros((len(now.forces) - 1, 3))
    added = join_unknowns(now.forces - goal.forces, none[:, 0], none, none)
    return replace(known_balance, residual=known_balance.residual + added)


def _limit_step(turn: float, move: float) -> float:
    """Return the share of a step by which no part of the line turns or moves too far."""
    max_turn = 0.7  # rad, of an element in one iteration
    max_move = 0.35  # of the line's length, of a node in one iteration
    return 1.0 / max(1.0, turn / max_turn, move / max_move)


def _is_balanced(
    assembly: Assembly, balance: Balance, shape: Shape, relative_change: float, force: float
) -> bool:
    """Return whether a shape is in balance; `moved` is the size of the last step, relative."""
    balance_tolerance = 1e-10  # of force, moment and length of the whole line
    # of the length, or rad: ends the search where rounding limits the balance
    step_tolerance = 1e-11
    rounded_balance = 1e-5
    # of the forces on the line: the shape of a tauter line is mostly rounding
    max_pull_factor = 1e4
    length = assembly.line.length
    pull = float(np.max(np.abs(shape.forces)))
    if assembly.is_rigid and pull > max_pull_factor * force:
        return False
    force = max(force, pull)
    residual = np.abs(balance.residual)
    residual[assembly.band.fixed] = 0.0
    nodes, stretches, turns, gaps = (float(np.max(part)) for part in split_unknowns(residual))
    moments = max(turns, stretches) / (force * length)
    error = max(max(nodes - assembly.rounding, 0.0) / force, moments, gaps / length)
    return error < balance_tolerance or (
        relative_change < step_tolerance and error < rounded_balance
    )
