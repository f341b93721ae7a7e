"""Find the equilibrium of a line whose boundaries have moved, and check its stability.

An equilibrium under held nodes and dead loads is stable if the second variation of the energy is
positive for all changes that satisfy the stretch conditions. Equivalently, the tangent without
the multipliers, but with a stiff penalty on these conditions, is positive definite. This is decided
by a banded Cholesky factorisation. The penalty is 1e6 times the larger of EI / L^2 and the largest
force in the line. Modes are stable down to a stiffness of -3e-4 times `Assembly.unit_drag`, so that
the error of critical loads is about 1e-4. Sliders that slid in the step are assumed to continue in
the same direction. The increase of friction with pressure, which has no potential, is neglected.
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
    FORCES,
    PER_ELEMENT,
    STRETCH,
    TURNS,
    join_unknowns,
    list_block_entries,
    split_unknowns,
)
from labpipe.mechanics.rod.rotations import (
    conjugate,
    from_rotation_vectors,
    multiply,
    normalise,
    to_rotation_vectors,
)
from labpipe.records.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Equilibrium:
    """Equilibrium of a line at a time.

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
    guess : history for the first iteration, one of the two histories of `start`, which give equal
        forces. With the previous history, sliders that slid continue to slide, which is the better
        guess if the motion continues
    drag : artificial drag; None without drag

    Returns
    -------
    The equilibrium; None if Newton's method does not converge to an equilibrium nearby.
    """
    max_iterations = 10
    max_idle_iterations = 4  # without progress; Newton's method may cycle at corners of the law
    progress_ratio = 0.8  # largest turn of an iteration with progress / smallest turn before
    max_turn = 0.7  # rad, of an element in one iteration
    max_move = 0.35  # of a node in one iteration, relative to the length of the line
    min_fraction = 0.1  # of an iteration step; shorter steps do not converge
    shape, held_nodes = start.shape, assembly.supports.held_nodes
    # Held nodes and clamps move with the first iteration step, or the fraction of it that is taken.
    origin = start.imposed
    imposed = replace(
        target, held_positions=origin.held_positions, clamp_frames=origin.clamp_frames
    )
    balance = _update_balance(start, target, guess)
    if balance is None or drag is not None:
        balance = assembly.compute_balance(shape, imposed, guess, drag)
    smallest_turn, n_idle_iterations = math.inf, 0
    for _ in range(max_iterations):
        held_moves = target.held_positions - shape.positions[held_nodes]
        clamp_turns = np.zeros((len(target.clamp_frames), 3))
        if imposed is not target:
            rotations = multiply(conjugate(imposed.clamp_frames), target.clamp_frames)
            clamp_turns = to_rotation_vectors(rotations)
        right_side = assembly.compute_right_side(balance, shape, imposed, held_moves, clamp_turns)
        change = assembly.matrix.solve(balance.tangent_values, right_side)
        if change is None:
            return None
        moves, _, turns, _ = split_unknowns(change)
        turn = float(np.max(np.abs(turns)))
        relative_move = float(np.max(np.abs(moves))) / assembly.line.length
        has_progress = turn < progress_ratio * smallest_turn
        smallest_turn = turn if has_progress else smallest_turn
        n_idle_iterations = 0 if has_progress else n_idle_iterations + 1
        fraction = 1.0 / max(1.0, turn / max_turn, relative_move / max_move)
        if fraction < min_fraction or n_idle_iterations == max_idle_iterations:
            return None
        shape = assembly.apply_change(shape, fraction * change)
        if fraction == 1.0:
            imposed = target
        else:
            frames = multiply(imposed.clamp_frames, from_rotation_vectors(fraction * clamp_turns))
            imposed = replace(imposed, clamp_frames=normalise(frames))
        balance = assembly.compute_balance(shape, imposed, start.history, drag)
        relative_change = max(turn, relative_move)
        if fraction == 1.0 and _is_balanced(assembly, balance, shape, relative_change):
            history, previous_history = balance.history, start.history
            return Equilibrium(shape, balance, target, history, previous_history=previous_history)
    return None


def _update_balance(
    start: Equilibrium, target: ImposedValues, guess: LineHistory
) -> Balance | None:
    """Update the balance of `start` with the forces of `target`; None if more has changed."""
    balance, imposed = start.balance, start.imposed
    history, drag = balance.inputs
    pairs = ((imposed.anchors, target.anchors), (imposed.rings, target.rings))
    has_moved = not all(np.array_equal(*pair) for pair in pairs)
    if history is not guess or drag is not None or has_moved:
        return None
    zeros = np.zeros((len(target.forces) - 1, 3))
    change = join_unknowns(imposed.forces - target.forces, zeros[:, 0], zeros, zeros)
    return replace(balance, residual=balance.residual + change)


def _is_balanced(
    assembly: Assembly, balance: Balance, shape: Shape, relative_change: float
) -> bool:
    """Return whether a shape is in balance, given the relative change of the last iteration."""
    # Residuals are relative to force, moment and length of the whole line. With a tolerance of
    # 1e-7, a taut clamped line has a spurious tension.
    balance_tolerance = 1e-10
    # If rounding limits the balance, the search ends after a small change, in lengths or rad.
    step_tolerance, rounding_tolerance = 1e-11, 1e-5
    # The tension is relative to the forces on the line. With a larger tension, the shape is
    # mostly rounding error.
    max_relative_tension = 1e4
    length = assembly.line.length
    tension = float(np.max(np.abs(shape.forces)))
    if assembly.is_rigid and tension > max_relative_tension * assembly.force:
        return False
    force = max(assembly.force, tension)
    residual = np.abs(balance.residual)
    residual[assembly.matrix.is_fixed] = 0.0
    positions, stretches, turns, forces = split_unknowns(residual)
    force_error = max(float(np.max(positions)) - assembly.rounding, 0.0) / force
    moment_error = max(float(np.max(turns)), float(np.max(stretches))) / (force * length)
    error = max(force_error, moment_error, float(np.max(forces)) / length)
    is_limited = relative_change < step_tolerance and error < rounding_tolerance
    return error < balance_tolerance or is_limited


class StabilityCheck:
    """Check of the stability of a line with its supports; constant parts are computed once.

    Parameters
    ----------
    assembly : line with its supports
    """

    def __init__(self, assembly: Assembly) -> None:
        self._assembly = assembly
        n, matrix = assembly.n, assembly.matrix
        rows, columns = assembly.pattern
        is_force = np.arange(assembly.indices.n_unknowns) % PER_ELEMENT >= FORCES
        self._selected_entries = np.flatnonzero(~(is_force[rows] | is_force[columns]))
        # The stretch condition of an element has ten unknowns: those of the element without its
        # force, and the position of the next node. They are successive if forces are left out.
        numbers, first_numbers = np.cumsum(~is_force) - 1, FORCES * np.arange(n)
        block_rows, block_columns = list_block_entries(first_numbers, 10, first_numbers, 10)
        rows = np.append(numbers[rows[self._selected_entries]], block_rows)
        columns = np.append(numbers[columns[self._selected_entries]], block_columns)
        # All entries are moved to the lower triangle.
        rows, columns = np.maximum(rows, columns), np.minimum(rows, columns)
        self.size = FORCES * n + 3
        self._depth = int(np.max(rows - columns)) + 1
        self._entries = self._depth * columns + (rows - columns)
        self._unknowns = np.flatnonzero(~is_force)
        is_fixed, scale = matrix.is_fixed[~is_force], matrix.scale[~is_force]
        weights = np.where(rows == columns, 1.0, 0.5)  # off-diagonal entries occur twice
        is_removed = is_fixed[rows] | is_fixed[columns]
        self._weights = weights * scale[rows] * scale[columns] * ~is_removed
        self._scale, self._is_fixed = scale, is_fixed
        self._drag = assembly.unit_drag[~is_force] * scale**2
        self._mass = self._drag * (np.arange(self.size) % FORCES < STRETCH)

    def is_stable(self, balance: Balance, shape: Shape) -> bool:
        """Return whether the line with drag returns from every small perturbation."""
        neutral_drag = 3e-4  # relative to the unit drag; a mode that this drag holds is neutral
        return self._factorise(balance, shape, neutral_drag) is not None

    def find_softest_mode(self, balance: Balance, shape: Shape, load: Floats) -> Floats | None:
        """Find the softest mode, as a change of all unknowns, shape (unknowns,); None if not found.

        Parameters
        ----------
        balance : balance of the line
        shape : shape of the line
        load : shape (unknowns,), N and N m, load that selects among equally soft modes

        Notes
        -----
        The mode is found by inverse iteration. The mass is the drag of the nodes, which excludes
        pure twist. The iteration starts with the load and a small asymmetric load.
        """
        n_iterations = 6
        asymmetry = 1e-3  # relative size of the asymmetric load
        drag, max_drag = 1e-3, 1e9  # relative to the unit drag
        factors = self._factorise(balance, shape, drag)
        while factors is None and drag < max_drag:
            drag *= 4.0
            factors = self._factorise(balance, shape, drag)
        if factors is None:
            return None
        indices = np.arange(self.size)
        is_bending = np.isin(indices % FORCES, (TURNS, TURNS + 1))
        asymmetric_load = np.cos(1.0 + 2.4 * indices) * is_bending
        asymmetric_load /= np.sqrt(np.sum(asymmetric_load**2))
        scaled_load = load[self._unknowns] * self._scale * ~self._is_fixed
        norm = float(np.sqrt(np.sum(scaled_load**2)))
        mode = asymmetric_load * ~self._is_fixed
        if norm > 0.0:
            mode = scaled_load / norm + asymmetry * mode
        for _ in range(n_iterations):
            mode, _ = lapack.dpbtrs(factors, mode, lower=True)
            mode = self._mass * mode
            norm = float(np.sqrt(np.sum(mode**2)))
            if norm == 0.0:
                return None
            mode /= norm
        mode, _ = lapack.dpbtrs(factors, mode, lower=True)
        change = np.zeros(self._assembly.indices.n_unknowns)
        change[self._unknowns] = mode * self._scale
        return change

    def _factorise(self, balance: Balance, shape: Shape, drag: float) -> Floats | None:
        """Factorise the tangent with a relative drag; return None if not positive definite."""
        penalty_factor = 1e6
        rounding = 1e-14  # relative to the diagonal
        line = self._assembly.line
        tension = float(np.max(np.abs(shape.forces)))
        critical_force = line.section.law.first_stiffness / line.length**2
        penalty = penalty_factor * max(critical_force, tension)
        lengths = line.lengths * (1.0 + shape.stretches)
        stretch_gradient = np.zeros((len(lengths), 3, FORCES + 3))
        stretch_gradient[:, :, :3] = -np.eye(3)
        stretch_gradient[:, :, 3] = -line.lengths[:, None] * balance.directions.unit_vectors
        stretch_gradient[:, :, 4:7] = -lengths[:, None, None] * balance.directions.turn_derivatives
        stretch_gradient[:, :, 7:] = np.eye(3)
        stiffness = np.swapaxes(stretch_gradient, 1, 2) @ stretch_gradient
        stiffness *= (penalty / line.lengths)[:, None, None]
        values = np.append(balance.symmetric_values[self._selected_entries], stiffness)
        weighted_values = values * self._weights
        sums = np.bincount(self._entries, weighted_values, minlength=self._depth * self.size)
        diagonal = sums[:: self._depth]
        diagonal += drag * self._drag + rounding * diagonal
        diagonal[self._is_fixed] = 1.0
        band = sums.reshape(self.size, self._depth).T
        factors, has_failed = lapack.dpbtrf(band, lower=True, overwrite_ab=True)
        return None if has_failed else np.asarray(factors)
