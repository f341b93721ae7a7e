"""Newton's method for the equilibrium of a line whose boundaries have moved, and its stability.

An equilibrium under held nodes and dead loads is stable if the second variation of the energy is
positive for all changes that satisfy the stretch conditions. An equivalent condition is that the
tangent without their multipliers, but with a stiff penalty on these conditions, is positive
definite, which a banded Cholesky factorisation decides. The penalty is 1e6 times EI / L^2 or the
largest force in the line. Modes are stable down to a stiffness of -3e-4 of `Assembly.drag`, which
makes the error of critical loads about 1e-4. Sliders that slid in the step are assumed to continue
in the same direction. The increase of friction with pressure, which has no potential, is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack

from labpipe.mechanics.rod.assembly import (
    ArtificialDrag,
    Assembly,
    Balance,
    ImposedValues,
    LineHistory,
    Shape,
)
from labpipe.mechanics.rod.banded import (
    FORCE,
    PER_ELEMENT,
    STRETCH,
    TURN,
    join_unknowns,
    list_block_entries,
    split_unknowns,
)
from labpipe.mechanics.rod.rotations import (
    conjugate,
    from_rotation_vectors,
    multiply,
    to_rotation_vectors,
    unit,
)
from labpipe.records.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Equilibrium:
    """An equilibrium: its shape, balance and imposed values."""

    shape: Shape
    balance: Balance
    imposed: ImposedValues


def find_equilibrium(
    assembly: Assembly,
    shape: Shape,
    history: LineHistory,
    imposed: tuple[ImposedValues, ImposedValues],
    *,
    force: float,
    guess: LineHistory,
    known_balance: Balance | None = None,
    drag: ArtificialDrag | None = None,
) -> Equilibrium | None:
    """Find the equilibrium after the boundaries have moved, starting from the previous one.

    Parameters
    ----------
    assembly : the line with its supports
    shape, history : present shape and history
    imposed : present and new values
    force : N, magnitude of the forces on the whole line
    guess : history for the first iteration, either the present one or that before the last step.
        Both give equal forces; with the latter, sliders that slid continue to slide, which is the
        better guess if the motion continues
    known_balance : balance of the present shape; None if it is not known
    drag : artificial drag; None without

    Returns
    -------
    The equilibrium; None if Newton's method does not converge to one nearby.
    """
    max_iterations = 10
    max_idle_iterations = 3  # without progress; Newton's method may cycle at corners of the law
    progress = 0.8  # largest ratio of an iteration's turn to the smallest before, with progress
    min_step_share = 0.1  # of an iteration step; shorter steps do not converge
    present, target = imposed
    nodes = assembly.supports.held
    # held nodes and clamps move with the first step, or the share of it that is taken
    present_imposed = replace(target, held=present.held, clamps=present.clamps)
    balance = known_balance and _update_balance(known_balance, present, target, guess)
    if balance is None:
        balance = assembly.compute_balance(shape, present_imposed, guess, drag)
    smallest_turn, idle_iterations = math.inf, 0
    for _ in range(max_iterations):
        held_shift = target.held - shape.positions[nodes]
        clamps = np.zeros((len(target.clamps), 3))
        if present_imposed is not target:
            clamps = to_rotation_vectors(multiply(conjugate(present_imposed.clamps), target.clamps))
        right = assembly.compute_right_side(balance, shape, present_imposed, held_shift, clamps)
        change = assembly.band.solve(balance.values, right)
        if change is None:
            return None
        moves, _, turns, _ = split_unknowns(change)
        turn, move = float(np.max(np.abs(turns))), float(np.max(np.abs(moves)))
        smallest_turn, idle_iterations = (
            (turn, 0) if turn < progress * smallest_turn else (smallest_turn, idle_iterations + 1)
        )
        share = _limit_step(turn, move / assembly.line.length)
        if share < min_step_share or idle_iterations == max_idle_iterations:
            return None
        shape = assembly.apply_change(shape, share * change)
        if share == 1.0:
            present_imposed = target
        else:
            turned = multiply(present_imposed.clamps, from_rotation_vectors(share * clamps))
            present_imposed = replace(present_imposed, clamps=unit(turned))
        balance = assembly.compute_balance(shape, present_imposed, history, drag)
        relative_change = max(turn, move / assembly.line.length)
        if share == 1.0 and _is_balanced(assembly, balance, shape, relative_change, force):
            return Equilibrium(shape, balance, target)
    return None


def _update_balance(
    known_balance: Balance, present: ImposedValues, goal: ImposedValues, guess: LineHistory
) -> Balance | None:
    """Return a balance updated with new imposed forces; None if other imposed values changed."""
    history, drag = known_balance.inputs
    imposed_pairs = ((present.anchors, goal.anchors), (present.rings, goal.rings))
    if (
        history is not guess
        or drag is not None
        or not all(np.array_equal(*pair) for pair in imposed_pairs)
    ):
        return None
    zeros = np.zeros((len(present.forces) - 1, 3))
    added = join_unknowns(present.forces - goal.forces, zeros[:, 0], zeros, zeros)
    return replace(known_balance, residual=known_balance.residual + added)


def _limit_step(turn: float, move: float) -> float:
    """Return the largest share of a step for which no part of the line turns or moves too far."""
    max_turn = 0.7  # rad, of an element in one iteration
    max_move = 0.35  # of the line's length, of a node in one iteration
    return 1.0 / max(1.0, turn / max_turn, move / max_move)


def _is_balanced(
    assembly: Assembly, balance: Balance, shape: Shape, relative_change: float, force: float
) -> bool:
    """Return whether a shape is in balance, given the relative change of the last iteration."""
    # of force, moment and length of the whole line; with 1e-7 a taut clamped line pulls itself
    balance_tolerance = 1e-10
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
    nodes, stretches, turns, gaps = (float(np.max(values)) for values in split_unknowns(residual))
    moments = max(turns, stretches) / (force * length)
    error = max(max(nodes - assembly.rounding, 0.0) / force, moments, gaps / length)
    return error < balance_tolerance or (
        relative_change < step_tolerance and error < rounded_balance
    )


class StabilityCheck:
    """Stability checks of a line with given supports; constant parts are computed once.

    Parameters
    ----------
    assembly : the line with its supports
    """

    def __init__(self, assembly: Assembly) -> None:
        self._assembly = assembly
        n, band = assembly.n, assembly.band
        rows, columns = assembly.pattern
        is_force = np.arange(assembly.indices.total) % PER_ELEMENT >= FORCE
        self._kept = np.flatnonzero(~(is_force[rows] | is_force[columns]))
        first, second = assembly.indices.positions[:-1], assembly.indices.positions[1:]
        pairs = [
            (rows[self._kept], columns[self._kept]),
            list_block_entries(first, FORCE, first, FORCE),
            list_block_entries(first, FORCE, second, 3),
            list_block_entries(second, 3, second, 3),
        ]
        down, right = (
            FORCE * (unknowns // PER_ELEMENT) + unknowns % PER_ELEMENT  # without the forces
            for unknowns in (np.concatenate(pair) for pair in zip(*pairs, strict=True))
        )
        row, column = np.maximum(down, right), np.minimum(down, right)
        self.size = FORCE * n + 3
        self._depth = int(np.max(row - column)) + 1
        self._entries = self._depth * column + (row - column)
        free = ~is_force
        self._free = np.flatnonzero(free)
        fixed = band.fixed[free]
        scale = band.scale[free]
        # off-diagonal entries come twice, except in the block between nodes
        count = np.where(row == column, 1.0, 0.5)
        count[len(self._kept) + n * FORCE * FORCE : len(row) - 9 * n] = 1.0
        self._weights = count * scale[row] * scale[column] * ~(fixed[row] | fixed[column])
        self._scale, self._fixed = scale, fixed
        self._drag = assembly.drag[free] * scale**2
        self._mass = self._drag * (np.arange(self.size) % FORCE < STRETCH)

    def is_stable(self, balance: Balance, shape: Shape) -> bool:
        """Return whether the overdamped line returns from every small perturbation."""
        neutral_share = 3e-4  # of the drag of the line: softer modes count as neutral
        return self._factorise(balance, shape, neutral_share) is not None

    def find_softest_mode(self, balance: Balance, shape: Shape, push: Floats) -> Floats | None:
        """Find the softest mode; None if there is none.

        Parameters
        ----------
        balance, shape : of the line
        push : shape (unknowns,), N and N m, load that selects among equally soft modes

        Notes
        -----
        Inverse iteration. The mass is the drag of the nodes, which excludes pure twist. A small
        asymmetric load is added to the push.
        """
        iterations = 6
        asymmetric_share = 1e-3
        drag = 1e-3
        factors = self._factorise(balance, shape, drag)
        while factors is None and drag < 1e9:
            drag *= 4.0
            factors = self._factorise(balance, shape, drag)
        if factors is None:
            return None
        number = np.arange(self.size)
        is_across = np.isin(number % FORCE, (TURN, TURN + 1))
        asymmetric_mode = np.cos(1.0 + 2.4 * number) * is_across
        asymmetric_mode /= np.sqrt(np.sum(asymmetric_mode**2))
        pushed = push[self._free] * self._scale * ~self._fixed
        size = float(np.sqrt(np.sum(pushed**2)))
        mode = asymmetric_mode * ~self._fixed
        if size > 0.0:
            mode = pushed / size + asymmetric_share * mode
        for _ in range(iterations):
            mode, _ = lapack.dpbtrs(factors, mode, lower=True)
            mode = self._mass * mode
            size = float(np.sqrt(np.sum(mode**2)))
            if size == 0.0:
                return None
            mode /= size
        mode, _ = lapack.dpbtrs(factors, mode, lower=True)
        change = np.zeros(self._assembly.indices.total)
        change[self._free] = mode * self._scale
        return change

    def _factorise(self, balance: Balance, shape: Shape, drag: float) -> Floats | None:
        """Return Cholesky factors of the tangent with a drag; None if not positive definite."""
        penalty_factor = 1e6
        rounding_share = 1e-14
        assembly = self._assembly
        line = assembly.line
        n = assembly.n
        section = line.section
        pull = float(np.max(np.abs(shape.forces)))
        penalty = penalty_factor * max(section.law.first_stiffness / line.length**2, pull)
        lengths = line.lengths * (1.0 + shape.stretches)
        row = np.zeros((n, 3, FORCE + 3))
        row[:, :, :3] = -np.eye(3)
        row[:, :, 3] = -line.lengths[:, None] * balance.directions.along
        row[:, :, 4:7] = -lengths[:, None, None] * balance.directions.by_turn
        row[:, :, 7:] = np.eye(3)
        stiffness = np.swapaxes(row, 1, 2) @ row * (penalty / line.lengths)[:, None, None]
        values = np.concatenate(
            [
                balance.symmetric_values[self._kept],
                stiffness[:, :FORCE, :FORCE].ravel(),
                stiffness[:, :FORCE, FORCE:].ravel(),
                stiffness[:, FORCE:, FORCE:].ravel(),
            ]
        )
        weighted = values * self._weights
        flat = np.bincount(self._entries, weighted, minlength=self._depth * self.size)
        diagonal = flat[:: self._depth]
        diagonal += drag * self._drag + rounding_share * diagonal
        diagonal[self._fixed] = 1.0
        factors, failed = lapack.dpbtrf(
            flat.reshape(self.size, self._depth).T, lower=True, overwrite_ab=True
        )
        return None if failed else np.asarray(factors)
