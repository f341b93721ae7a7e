"""Solve the quasi-static path of a line: its equilibrium at each step of its boundaries.

Every step is solved by Newton's method. A step is divided in two if the method does not converge,
if an element rotates too far, or if the new equilibrium is unstable. The history of sliders and
friction advances with every part of a step. Therefore a line buckles as soon as its straight
equilibrium is unstable, and not after a whole step.

If an equilibrium is unstable, or if there is none nearby because the line snaps or is released,
the line is *relaxed*. It is then solved with an artificial resistance to bending and twist, which
decreases to zero while the energy decreases, as in the motion of a line with internal damping. The
resistance acts at each joint of two elements. A resistance to motion would instead bend the free
end of a falling line, and the sliders would retain that bend. From an unstable equilibrium the line
moves along its softest mode. Steps with relaxation, and steps with a release, are listed as
`jump_steps`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labpipe.mechanics.rod.assembly import (
    ArtificialDrag,
    Assembly,
    ImposedValues,
    LineHistory,
    Shape,
)
from labpipe.mechanics.rod.banded import join_unknowns, split_unknowns
from labpipe.mechanics.rod.boundaries import Boundary
from labpipe.mechanics.rod.equilibrium import Equilibrium, StabilityCheck, find_equilibrium
from labpipe.mechanics.rod.line import Line
from labpipe.mechanics.rod.path import (
    NoEquilibriumError,
    RodPath,
    RodState,
    build_state,
    check_line,
    check_planes,
    check_reach,
    check_rings,
    compute_lost_energy,
    merge_rests,
    split_sides,
)
from labpipe.mechanics.rod.rotations import conjugate, multiply, to_rotation_vectors
from labpipe.mechanics.rod.schedule import Schedule
from labpipe.mechanics.rod.supports import compute_turns, split_cells_at_clamps
from labpipe.records.quality import Reason
from labpipe.records.result import Status


@dataclass(frozen=True, slots=True)
class RodSettings:
    """Settings of `follow`.

    Parameters
    ----------
    max_turn : rad, largest change of the angle between neighbouring elements in a fraction of a
        step; an element may rotate by twice this angle in space
    max_strain : strain beyond which the line counts as torn
    checks_stability : whether the stability of equilibria is checked
    """

    max_turn: float = 0.5
    max_strain: float = 0.05
    checks_stability: bool = True


def follow(
    line: Line,
    boundaries: Sequence[Boundary],
    *,
    steps: int,
    settings: RodSettings = RodSettings(),
    on_step: Callable[[], object] = lambda: None,
) -> RodPath:
    """Solve the equilibria of a line at the steps of its boundaries.

    Parameters
    ----------
    line : line in its initial shape, without history
    boundaries : grips, loads and supports of the line
    steps : number of steps of the paths of the boundaries
    settings : settings of the solver
    on_step : function that is called after each step

    Returns
    -------
    The states of steps 0 to `steps`. If a step fails, `status` is `failed`, the states end before
    it, and the first reason states the step and the position on the line.

    Raises
    ------
    ValueError
        If a node is not on the line, a path has a wrong number of rows, two boundaries hold a node
        at the same time, or a line with a ring has a single element.
    """
    solver = _PathSolver(line, tuple(boundaries), steps, settings)
    for step in range(steps + 1):
        if not solver.solve_step(step):
            break
        on_step()
    return solver.build_path()


class _PathSolver:
    """Solver of the equilibria of a line, with the current state and the results so far."""

    def __init__(
        self, line: Line, boundaries: tuple[Boundary, ...], steps: int, settings: RodSettings
    ) -> None:
        self.line, self.boundaries, self.settings = line, boundaries, settings
        n = len(line.lengths)
        shape = Shape(line.positions, line.frames, np.zeros(n), np.zeros((n, 3)))
        self.schedule = Schedule(line, boundaries, steps, shape)
        self.states: list[RodState] = []
        self.losses: list[tuple[float, float]] = []
        self.reasons: list[Reason] = []
        self.jump_steps: list[int] = []
        self.step = 0
        self.lost_energy = self.jump_energy = 0.0
        self.has_failed = False
        rests = np.zeros((n + 1, 2, line.section.law.history_size, 2))
        contacts = np.tile(line.positions, (len(self.schedule.planes), 1, 1))
        history = LineHistory(rests, contacts, self.schedule.ring_parameters)
        self._assemble(self.schedule.list_grips(0), -1.0, shape, history)

    # ---- grips --------------------------------------------------------------------------------

    def _assemble(
        self, grips: tuple[int, ...], time: float, shape: Shape, history: LineHistory
    ) -> None:
        """Assemble the line with its grips; `history.rests` is of shape (nodes, 2, sliders, 2)."""
        self.grips, schedule = grips, self.schedule
        node_clamps = [(schedule.held_nodes[k], schedule.held[k].frame is not None) for k in grips]
        radius = 0.5 * self.line.section.diameter
        planes = tuple(plane.shift(radius) for plane in schedule.planes.values())
        lengths = np.array([string.length for string in schedule.strings.values()])
        self.assembly = Assembly(
            self.line,
            split_cells_at_clamps(self.line, tuple(node_clamps)),
            planes,
            (schedule.string_nodes, lengths),
            n_rings=len(schedule.rings),
            force=schedule.estimate_force(),
        )
        self.check = StabilityCheck(self.assembly)
        history = replace(history, rests=merge_rests(self.assembly.supports, history.rests))
        imposed = schedule.compute_imposed(time, grips)
        balance = self.assembly.compute_balance(shape, imposed, history)
        self.current = Equilibrium(shape, balance, imposed, history, history)

    def _release_grips(self, step: int) -> None:
        """Release the grips that end in a step.

        The line moves to an equilibrium nearby, or is relaxed if there is none.
        """
        grips, current = self.schedule.list_grips(step), self.current
        if grips == self.grips:
            return
        self.jump_steps.append(step)
        lost_energy, jump_energy = self.lost_energy, self.jump_energy
        rests = split_sides(self.assembly.supports, current.history.rests)
        time = current.imposed.time
        self._assemble(grips, time, current.shape, replace(current.history, rests=rests))
        equilibrium = self._find_equilibrium(time)
        is_unstable = equilibrium is not None and not self._is_stable(equilibrium)
        self._accept(time, equilibrium, is_unstable=is_unstable)
        self.jump_energy = jump_energy + self.lost_energy - lost_energy

    # ---- steps --------------------------------------------------------------------------------

    def solve_step(self, step: int) -> bool:
        """Solve a step and record its state; return whether the step has an equilibrium."""
        self.step = step
        try:
            grips = self.schedule.list_grips(step)
            if self.assembly.is_rigid:
                check_reach(self.schedule, grips, step)
            check_planes(self.schedule, grips, step)
            if step > 0:
                self._release_grips(step)
            self._advance_to(float(step))
        except NoEquilibriumError as failure:
            self.reasons.insert(0, failure.reason)
            self.has_failed = True
            return False
        self._record_state(step)
        return True

    def _advance_to(self, end: float) -> None:
        """Advance to a time, counted in steps, by fractions of steps that are halved or doubled."""
        min_fraction = 2.0**-12  # of a step
        fraction, is_rejected = 1.0, False
        while self.current.imposed.time < end:
            time = min(end, self.current.imposed.time + fraction)
            is_smallest = fraction <= min_fraction
            tries_sticking = is_smallest or not is_rejected
            equilibrium = self._find_equilibrium(time, tries_sticking=tries_sticking)
            is_unstable = equilibrium is not None and not self._is_stable(equilibrium)
            is_rejected, was_rejected_before = equilibrium is None or is_unstable, is_rejected
            if is_rejected and not is_smallest and not (is_unstable and self._accepted_unstable):
                fraction *= 0.5
                continue
            self._accept(time, equilibrium, is_unstable=is_unstable)
            may_grow = self._accepted_unstable if is_unstable else not was_rejected_before
            if equilibrium is not None and may_grow:
                fraction = min(1.0, 2.0 * fraction)

    def _accept(self, time: float, equilibrium: Equilibrium | None, *, is_unstable: bool) -> None:
        """Accept an equilibrium; relax if it is unstable or if there is none."""
        if equilibrium is None:
            self._relax(time, is_unstable=False)
            return
        self._commit(equilibrium)
        if is_unstable:
            self._relax(time, is_unstable=True)

    def _is_stable(self, equilibrium: Equilibrium) -> bool:
        return not self.settings.checks_stability or self.check.is_stable(
            equilibrium.balance, equilibrium.shape
        )

    @property
    def _accepted_unstable(self) -> bool:
        """Return whether an unstable equilibrium was accepted; smaller fractions then fail."""
        return self._has_reason("unstable")

    def _find_equilibrium(self, time: float, *, tries_sticking: bool = True) -> Equilibrium | None:
        """Find the equilibrium at a time; None if there is none nearby.

        Newton's method starts with sliders that continue to slide. If `tries_sticking`, it is
        repeated with sliders that stick after a reversal.
        """
        start, target = self.current, self.schedule.compute_imposed(time, self.grips)
        for guess in (start.previous_history, start.history):
            equilibrium = find_equilibrium(self.assembly, start, target, guess=guess)
            if equilibrium is not None and self._is_near(equilibrium):
                return equilibrium
            if guess is start.history or not tries_sticking:
                return None
            balance = self.assembly.compute_balance(start.shape, start.imposed, start.history)
            if np.array_equal(balance.values, start.balance.values):
                return None  # no slider continues to slide
            start = replace(start, balance=balance)
        return None

    def _is_near(self, equilibrium: Equilibrium) -> bool:
        """Return whether the line turns by less than the largest allowed angles."""
        start, max_turn = self.current, self.settings.max_turn
        previous_turns = start.balance.cells.rotation_vectors
        cell_turns = equilibrium.balance.cells.rotation_vectors - previous_turns
        if float(np.max(np.linalg.norm(cell_turns, axis=1), initial=0.0)) > max_turn:
            return False
        rotations = multiply(conjugate(start.shape.frames), equilibrium.shape.frames)
        turns = np.linalg.norm(to_rotation_vectors(rotations), axis=1)
        return float(np.max(turns)) < 2.0 * max_turn

    def _commit(self, equilibrium: Equilibrium) -> None:
        """Make an equilibrium the current state, and add the energy that is lost."""
        self.current, balance = equilibrium, equilibrium.balance
        rests = equilibrium.previous_history.rests, equilibrium.history.rests
        self.lost_energy += compute_lost_energy(self.assembly, *rests)
        max_strain = self.settings.max_strain
        check_line(self.assembly, equilibrium.shape, balance, self.step, max_strain=max_strain)
        check_rings(self.schedule, balance, self.step)

    # ---- relaxing -----------------------------------------------------------------------------

    def _relax(self, time: float, *, is_unstable: bool) -> None:
        """Relax the line to a stable equilibrium at a time."""
        perturbations = (0.0, 1e-3, 1e-2)  # relative to the length of the line, or rad
        if self.step not in self.jump_steps:
            self.jump_steps.append(self.step)
        saved = self.current, self.lost_energy
        for perturbation in perturbations[1:] if is_unstable else perturbations:
            if self._relax_to_rest(time, perturbation):
                self.jump_energy += self.lost_energy - saved[1]
                return
            self.current, self.lost_energy = saved
        if not is_unstable:
            forces = np.linalg.norm(self.current.shape.forces, axis=1)
            node = int(np.argmax(forces))
            place = self.line.describe_place(node)
            raise NoEquilibriumError.of(
                "mechanics.rod.no_equilibrium", step=self.step, place=place, pull=forces[node]
            )
        if not self._has_reason("unstable"):
            load = np.zeros(self.assembly.indices.total)
            mode = self.check.find_softest_mode(self.current.balance, self.current.shape, load)
            displacements = split_unknowns(load if mode is None else mode)[0]
            place = self.line.describe_place(int(np.argmax(np.linalg.norm(displacements, axis=1))))
            self.reasons.append(Reason.of("mechanics.rod.unstable", step=self.step, place=place))

    def _relax_to_rest(self, time: float, perturbation: float) -> bool:
        """Relax the line with decreasing drag; return whether it comes to rest."""
        first_drag = 1.0
        # A mode of two waves is stiffer by (4 pi)^4, so that only a stable line stays at rest.
        last_drag = 1e-8
        max_drag = 1e5
        rest_drag = 1e-3  # below it, an equilibrium without drag is sought
        drag_decrease, decrease_after_failure = 0.25, 0.5
        drag_increase = 4.0
        rest_tolerance = 1e-6  # relative to the length of the line
        max_steps = 400
        target = self.schedule.compute_imposed(time, self.grips)
        shape = self._perturb_shape(perturbation)
        drag, decrease = first_drag, drag_decrease
        previous_positions = np.full_like(shape.positions, np.inf)
        for _ in range(max_steps):
            equilibrium = self._find_dragged_equilibrium(shape, target, drag)
            if equilibrium is None:
                drag *= drag_increase
                decrease = decrease_after_failure
                if drag > max_drag:
                    return False
                continue
            self._commit(equilibrium)
            shape = equilibrium.shape
            drag *= decrease
            decrease = drag_decrease
            if drag < rest_drag and self._reach_rest(time):
                return True
            if drag < last_drag:
                displacement = np.max(np.abs(shape.positions - previous_positions))
                if displacement < rest_tolerance * self.line.length:
                    return False
                previous_positions = shape.positions
                drag *= drag_increase
        return False

    def _reach_rest(self, time: float) -> bool:
        """Accept a stable equilibrium without drag; return whether there is one."""
        equilibrium = self._find_equilibrium(time)
        if equilibrium is None or not self._is_stable(equilibrium):
            return False
        self._commit(equilibrium)
        return True

    def _find_dragged_equilibrium(
        self, shape: Shape, target: ImposedValues, size: float
    ) -> Equilibrium | None:
        """Find a stable equilibrium near a shape with a given drag; None if there is none."""
        start = replace(self.current, shape=shape)
        frames = self.assembly.select_frames(shape, start.imposed)
        drag = ArtificialDrag(size, shape, compute_turns(frames))
        equilibrium = find_equilibrium(self.assembly, start, target, guess=start.history, drag=drag)
        if equilibrium is None or not self._is_near(equilibrium):
            return None
        return equilibrium if self._is_stable(equilibrium) else None

    def _perturb_shape(self, size: float) -> Shape:
        """Return the current shape, perturbed along its softest mode.

        The size is relative to the length of the line, or in rad.
        """
        current = self.current
        if not size:
            return current.shape
        target = self.schedule.compute_imposed(float(self.step), self.grips)
        zeros = np.zeros((self.schedule.n, 3))
        load = join_unknowns(target.forces, zeros[:, 0], zeros, zeros)
        mode = self.check.find_softest_mode(current.balance, current.shape, load)
        if mode is None:
            return current.shape
        displacements, _, turns, _ = split_unknowns(mode)
        largest = max(np.max(np.abs(displacements)) / self.line.length, np.max(np.abs(turns)))
        return self.assembly.apply_change(current.shape, mode * (size / largest))

    # ---- results ------------------------------------------------------------------------------

    def _has_reason(self, code: str) -> bool:
        return any(reason.code == code for reason in self.reasons)

    def _record_state(self, step: int) -> None:
        """Record the state of a step; add a reason if the line is bent beyond its law."""
        state = build_state(self.assembly, self.schedule, self.grips, self.current, step)
        self.states.append(state)
        self.losses.append((self.lost_energy, self.jump_energy))
        curvatures, max_curvature = state.bending_curvatures, self.line.section.law.max_curvature
        node = int(np.argmax(curvatures))
        if curvatures[node] > max_curvature and not self._has_reason("beyond_law"):
            self.reasons.append(
                Reason.of(
                    "mechanics.rod.beyond_law",
                    step=step,
                    place=self.line.describe_place(node),
                    curvature=curvatures[node],
                    last=max_curvature,
                )
            )

    def build_path(self) -> RodPath:
        """Build the path of the states so far."""
        losses = np.array(self.losses).reshape(-1, 2).T
        status = Status.DOUBTFUL if self.reasons else Status.OK
        return RodPath(
            self.line,
            self.boundaries,
            tuple(self.states),
            Status.FAILED if self.has_failed else status,
            tuple(self.reasons),
            tuple(self.jump_steps),
            *losses,
        )
