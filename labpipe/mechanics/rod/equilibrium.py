"""Find the equilibrium of a line whose boundaries have moved, and check its stability.

An equilibrium under held nodes and dead loads is stable if the second variation of the energy is
positive for all changes that satisfy the stretch conditions. Equivalently, the tangent without
their multipliers, but with a stiff penalty on these conditions, is positive definite. This is
decided by a banded Cholesky factorisation. The penalty is 1e6 times EI / L^2 or the largest force
in the line. Modes are stable down to a stiffness of -3e-4 times `Assembly.drag`, so that the error
of critical loads is about 1e-4. Sliders that slid in the step are assumed to continue in the same
direction. The increase of friction with pressure, which has no potential, is left out.
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
    """An equilibrium of a line at a time.

    Parameters
    ----------
    shape : shape of the line
    balance : residual and tangent
    imposed : positions and forces imposed by the boundaries
    history : history at this time
    previous_history : history at the previous equilibrium; `history` at the start and after a
        release
    """

    shape: Shape
    balance: Balance
    imposed: ImposedValues
    history: LineHistory
    previous_history: LineHistory


def find_equilibrium(
    assembly: Assembly,
    start: Equilibrium,
    target: ImposedValues,
    *,
    guess: LineHistory,
    drag: ArtificialDrag | None = None,
) -> Equilibrium | None:
    """Find the equilibrium after the boundaries have moved, starting from the previous one.

    Parameters
    ----------
    assembly : line with its supports
    start : equilibrium before the boundaries have moved; with drag, it may have a perturbed shape
    target : imposed values after the motion
    guess : history for the first iteration, one of both histories of `start`, which give equal
        forces. With the previous one, sliders that slid continue to slide, which is the better
        guess if the motion continues
    drag : artificial drag; None without drag

    Returns
    -------
    The equilibrium; None if Newton's method does not converge to an equilibrium nearby.
    """
    max_iterations = 10
    max_idle_iterations = 2  # without progress; Newton's method may cycle at corners of the law
    progress = 0.8  # ratio of an iteration's turn to the smallest turn before
    min_fraction = 0.1  # of an iteration step; shorter steps do not converge
    shape, nodes = start.shape, assembly.supports.held_nodes
    # Held nodes and clamps move with the first iteration step, or the fraction of it that is taken.
    before = start.imposed
    current = replace(target, held_positions=before.held_positions, clamps=before.clamps)
    balance = _update_balance(start, target, guess)
    if balance is None or drag is not None:
        balance = assembly.compute_balance(shape, current, guess, drag)
    smallest_turn, idle_iterations = math.inf, 0
    for _ in range(max_iterations):
        held_moves = target.held_positions - shape.positions[nodes]
        clamp_turns = np.zeros((len(target.clamps), 3))
        if current is not target:
            clamp_turns = to_rotation_vectors(multiply(conjugate(current.clamps), target.clamps))
        right = assembly.compute_right_side(balance, shape, current, held_moves, clamp_turns)
        change = assembly.band.solve(balance.values, right)
        if change is None:
            return None
        moves, _, turns, _ = split_unknowns(change)
        turn, move = float(np.max(np.abs(turns))), float(np.max(np.abs(moves)))
        smallest_turn, idle_iterations = (
            (turn, 0) if turn < progress * smallest_turn else (smallest_turn, idle_iterations + 1)
        )
        fraction = _limit_step(turn, move / assembly.line.length)
        if fraction < min_fraction or idle_iterations == max_idle_iterations:
            return None
        shape = assembly.apply_change(shape, fraction * change)
        if fraction == 1.0:
            current = target
        else:
            clamps = multiply(current.clamps, from_rotation_vectors(fraction * clamp_turns))
            current = replace(current, clamps=unit(clamps))
        balance = assembly.compute_balance(shape, current, start.history, drag)
        relative_change = max(turn, move / assembly.line.length)
        if fraction == 1.0 and _is_balanced(assembly, balance, shape, relative_change):
            return Equilibrium(shape, balance, target, balance.history, start.history)
    return None


def _update_balance(
    start: Equilibrium, target: ImposedValues, guess: LineHistory
) -> Balance | None:
    """Return a balance updated with new imposed forces; None if other imposed values changed."""
    balance, imposed = start.balance, start.imposed
    history, drag = balance.inputs
    pairs = ((imposed.anchors, target.anchors), (imposed.rings, target.rings))
    has_moved = not all(np.array_equal(*pair) for pair in pairs)
    if history is not guess or drag is not None or has_moved:
        return None
    zeros = np.zeros((len(target.forces) - 1, 3))
    change = join_unknowns(imposed.forces - target.forces, zeros[:, 0], zeros, zeros)
    return replace(balance, residual=balance.residual + change)


def _limit_step(turn: float, relative_move: float) -> float:
    """Return the largest fraction of a step in which no element turns or moves too far."""
    max_turn = 0.7  # rad, of an element in one iteration
    max_move = 0.35  # of a node in one iteration, relative to the length of the line
    return 1.0 / max(1.0, turn / max_turn, relative_move / max_move)


def _is_balanced(
    assembly: Assembly, balance: Balance, shape: Shape, relative_change: float
) -> bool:
    """Return whether a shape is in balance, given the relative change of the last iteration."""
    # Relative to force, moment and length of the whole line. With 1e-7 a taut clamped line has a
    # spurious tension.
    balance_tolerance = 1e-10
    # Relative to the length, or rad. It ends the search if rounding limits the balance.
    step_tolerance = 1e-11
    rounded_balance = 1e-5
    # Relative to the forces on the line. The shape of a tauter line is mostly rounding.
    max_relative_tension = 1e4
    length = assembly.line.length
    tension = float(np.max(np.abs(shape.forces)))
    if assembly.is_rigid and tension > max_relative_tension * assembly.force:
        return False
    force = max(assembly.force, tension)
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
    assembly : line with its supports
    """

    def __init__(self, assembly: Assembly) -> None:
        self._assembly = assembly
        n, band = assembly.n, assembly.band
        rows, columns = assembly.pattern
        is_force = np.arange(assembly.indices.total) % PER_ELEMENT >= FORCE
        self._selected_entries = np.flatnonzero(~(is_force[rows] | is_force[columns]))
        first, second = assembly.indices.positions[:-1], assembly.indices.positions[1:]
        entries = [
            (rows[self._selected_entries], columns[self._selected_entries]),
            list_block_entries(first, FORCE, first, FORCE),
            list_block_entries(first, FORCE, second, 3),
            list_block_entries(second, 3, second, 3),
        ]
        rows, columns = (
            FORCE * (unknowns // PER_ELEMENT) + unknowns % PER_ELEMENT  # without the forces
            for unknowns in (np.concatenate(group) for group in zip(*entries, strict=True))
        )
        row, column = np.maximum(rows, columns), np.minimum(rows, columns)
        self.size = FORCE * n + 3
        self._depth = int(np.max(row - column)) + 1
        self._entries = self._depth * column + (row - column)
        self._unknowns = np.flatnonzero(~is_force)
        fixed, scale = band.fixed[~is_force], band.scale[~is_force]
        # Off-diagonal entries occur twice, except in the block between nodes.
        weights = np.where(row == column, 1.0, 0.5)
        weights[len(self._selected_entries) + n * FORCE * FORCE : len(row) - 9 * n] = 1.0
        self._weights = weights * scale[row] * scale[column] * ~(fixed[row] | fixed[column])
        self._scale, self._fixed = scale, fixed
        self._drag = assembly.drag[~is_force] * scale**2
        self._mass = self._drag * (np.arange(self.size) % FORCE < STRETCH)

    def is_stable(self, balance: Balance, shape: Shape) -> bool:
        """Return whether the overdamped line returns from every small perturbation."""
        neutral_drag = 3e-4  # relative to the unit drag; softer modes count as neutral
        return self._factorise(balance, shape, neutral_drag) is not None

    def find_softest_mode(self, balance: Balance, shape: Shape, load: Floats) -> Floats | None:
        """Find the softest mode; None if there is none.

        Parameters
        ----------
        balance : balance of the line
        shape : shape of the line
        load : shape (unknowns,), N and N m, load that selects among equally soft modes

        Notes
        -----
        The mode is found by inverse iteration. The mass is the drag of the nodes, which excludes
        pure twist. A small asymmetric load is added.
        """
        iterations = 6
        asymmetry = 1e-3  # relative size of the asymmetric load
        drag = 1e-3
        factors = self._factorise(balance, shape, drag)
        while factors is None and drag < 1e9:
            drag *= 4.0
            factors = self._factorise(balance, shape, drag)
        if factors is None:
            return None
        number = np.arange(self.size)
        is_bending = np.isin(number % FORCE, (TURN, TURN + 1))
        asymmetric_load = np.cos(1.0 + 2.4 * number) * is_bending
        asymmetric_load /= np.sqrt(np.sum(asymmetric_load**2))
        scaled_load = load[self._unknowns] * self._scale * ~self._fixed
        size = float(np.sqrt(np.sum(scaled_load**2)))
        mode = asymmetric_load * ~self._fixed
        if size > 0.0:
            mode = scaled_load / size + asymmetry * mode
        for _ in range(iterations):
            mode, _ = lapack.dpbtrs(factors, mode, lower=True)
            mode = self._mass * mode
            size = float(np.sqrt(np.sum(mode**2)))
            if size == 0.0:
                return None
            mode /= size
        mode, _ = lapack.dpbtrs(factors, mode, lower=True)
        change = np.zeros(self._assembly.indices.total)
        change[self._unknowns] = mode * self._scale
        return change

    def _factorise(self, balance: Balance, shape: Shape, drag: float) -> Floats | None:
        """Return Cholesky factors of the tangent with a drag; None if not positive definite."""
        penalty_factor = 1e6
        rounding = 1e-14
        line = self._assembly.line
        tension = float(np.max(np.abs(shape.forces)))
        critical_force = line.section.law.first_stiffness / line.length**2
        penalty = penalty_factor * max(critical_force, tension)
        lengths = line.lengths * (1.0 + shape.stretches)
        stretch_gradient = np.zeros((len(lengths), 3, FORCE + 3))
        stretch_gradient[:, :, :3] = -np.eye(3)
        stretch_gradient[:, :, 3] = -line.lengths[:, None] * balance.directions.unit_vectors
        stretch_gradient[:, :, 4:7] = -lengths[:, None, None] * balance.directions.turn_derivatives
        stretch_gradient[:, :, 7:] = np.eye(3)
        stiffness = np.swapaxes(stretch_gradient, 1, 2) @ stretch_gradient
        stiffness *= (penalty / line.lengths)[:, None, None]
        values = np.concatenate(
            [
                balance.symmetric_values[self._selected_entries],
                stiffness[:, :FORCE, :FORCE].ravel(),
                stiffness[:, :FORCE, FORCE:].ravel(),
                stiffness[:, FORCE:, FORCE:].ravel(),
            ]
        )
        weighted = values * self._weights
        band = np.bincount(self._entries, weighted, minlength=self._depth * self.size)
        diagonal = band[:: self._depth]
        diagonal += drag * self._drag + rounding * diagonal
        diagonal[self._fixed] = 1.0
        factors, has_failed = lapack.dpbtrf(
            band.reshape(self.size, self._depth).T, lower=True, overwrite_ab=True
        )
        return None if has_failed else np.asarray(factors)
