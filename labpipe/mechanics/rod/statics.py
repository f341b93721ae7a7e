"""Solve the quasi-static path of a line: its equilibria at the steps of its boundaries.

Every step is solved by Newton's method. A step is divided in two if the method does not converge,
if the line turns too far, or if the new equilibrium is unstable. The history of sliders and
friction advances with every part of a step. Therefore a line buckles as soon as its straight
equilibrium is unstable, and not after a whole step.

If an equilibrium is unstable, or if there is none nearby because the line snaps or is released,
the line is *relaxed*. It is then solved with an artificial resistance to bending and twist, which
decreases to zero while the energy decreases, as in the motion of a line with internal damping. Each
cell relaxes by its own moment. A resistance to motion would instead bend the free end of a falling
line, and the sliders would retain that bend. From an unstable equilibrium the line moves along its
softest mode. Steps with relaxation, and steps with a release, are listed as `snapped`.
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
from labpipe.mechanics.rod.path import RodPath, RodState, Status
from labpipe.mechanics.rod.rotations import conjugate, multiply, to_rotation_vectors
from labpipe.mechanics.rod.schedule import Schedule
from labpipe.mechanics.rod.states import (
    NoEquilibriumError,
    SolverState,
    build_state,
    check_line,
    check_planes,
    check_reach,
    check_rings,
    compute_lost_energy,
    merge_rests,
    split_sides,
)
from labpipe.mechanics.rod.supports import split_supports
from labpipe.records.quality import Reason


@dataclass(frozen=True, slots=True)
class RodSettings:
    """Settings of `follow`.

    Parameters
    ----------
    min_step_fraction : smallest part of a step
    max_turn : rad, largest change of the angle between neighbouring elements in a part of a step;
        an element may turn by twice this angle in space
    max_strain : strain beyond which the line counts as torn
    checks_stability : whether the stability of equilibria is checked
    """

    min_step_fraction: float = 2.0**-14
    max_turn: float = 0.5
    max_strain: float = 0.05
    checks_stability: bool = True


def follow(
    line: Line,
    boundaries: Sequence[Boundary],
    *,
    steps: int,
    settings: RodSettings | None = None,
    on_step: Callable[[], object] = lambda: None,
) -> RodPath:
    """Solve the equilibria of a line at the steps of its boundaries.

    Parameters
    ----------
    line : in the shape to start from, without history
    boundaries : grips, loads and supports of the line
    steps : number of steps of their paths
    settings : `RodSettings` with its defaults if None
    on_step : called after each step

    Returns
    -------
    The states 0 to `steps`. If a step fails, `status` is `failed`, the states end before it, and
    the first reason states step and place.

    Raises
    ------
    ValueError
        If a node is not on the line, a path has a wrong number of rows, two boundaries hold a node
        at the same time, or a line with a ring has a single element.
    """
    solver = _PathSolver(line, tuple(boundaries), steps, settings or RodSettings())
    for step in range(steps + 1):
        if not solver.solve_step(step):
            break
        on_step()
    return solver.path()


class _PathSolver:
    def __init__(
        self, line: Line, boundaries: tuple[Boundary, ...], steps: int, settings: RodSettings
    ) -> None:
        self.line, self.boundaries, self.settings = line, boundaries, settings
        n = len(line.lengths)
        shape = Shape(line.positions, line.frames, np.zeros(n), np.zeros((n, 3)))
        self.schedule = Schedule(line, boundaries, steps, shape)
        self.force = self.schedule.estimate_force()
        self.states: list[RodState] = []
        self.losses: list[tuple[float, float]] = []
        self.reasons: list[Reason] = []
        self.snapped: list[int] = []
        self.step = 0
        self.lost = self.lost_in_jumps = 0.0
        self.failed = False
        rests = np.zeros((n + 1, 2, line.section.law.history_size, 2))
        contacts = np.tile(line.positions, (len(self.schedule.planes), 1, 1))
        history = LineHistory(rests, contacts, self.schedule.start_places)
        self._set_up(self.schedule.list_grips(0), -1.0, shape, history)

    # ---- grips --------------------------------------------------------------------------------

    def _set_up(
        self, grips: tuple[int, ...], time: float, shape: Shape, history: LineHistory
    ) -> None:
        """Assemble the line with the grips of a time; `history.rests` is by nodes."""
        self.grips, schedule = grips, self.schedule
        held_grips = [(schedule.held_nodes[k], schedule.held[k].frame is not None) for k in grips]
        radius = 0.5 * self.line.section.diameter
        planes = tuple(plane.shift(radius) for plane in schedule.planes.values())
        lengths = np.array([string.length for string in schedule.strings.values()])
        self.assembly = Assembly(
            self.line,
            split_supports(self.line, tuple(held_grips)),
            planes,
            (schedule.string_nodes, lengths),
            n_rings=len(schedule.rings),
            force=self.force,
        )
        self.check = StabilityCheck(self.assembly)
        history = replace(history, rests=merge_rests(self.assembly.supports, history.rests))
        imposed = schedule.compute_imposed(time, grips)
        balance = self.assembly.compute_balance(shape, imposed, history)
        self.now = SolverState(time, shape, balance, imposed, history, None)

    def _release_grips(self, step: int) -> None:
        """Release the grips that end in a step.

        The line moves to an equilibrium nearby, or is relaxed if there is none.
        """
        grips, now = self.schedule.list_grips(step), self.now
        if grips == self.grips:
            return
        self.snapped.append(step)
        lost, lost_in_jumps = self.lost, self.lost_in_jumps
        rests = split_sides(self.assembly.supports, now.history.rests)
        self._set_up(grips, now.time, now.shape, replace(now.history, rests=rests))
        equilibrium = self._find_equilibrium(now.time)
        is_unstable = equilibrium is not None and not self._is_stable(equilibrium)
        self._move_on(now.time, equilibrium, is_unstable=is_unstable)
        self.lost_in_jumps = lost_in_jumps + self.lost - lost

    # ---- steps --------------------------------------------------------------------------------

    def solve_step(self, step: int) -> bool:
        """Solve a step and record its state; return whether that succeeds."""
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
            self.failed = True
            return False
        self._record_state(step)
        return True

    def _advance_to(self, goal: float) -> None:
        part = 1.0
        min_part = self.settings.min_step_fraction
        was_refused = False
        while self.now.time < goal:
            time = min(goal, self.now.time + part)
            is_last = part <= min_part
            equilibrium = self._find_equilibrium(time, tries_sticking=is_last or not was_refused)
            is_unstable = equilibrium is not None and not self._is_stable(equilibrium)
            was_refused, was_refused_before = equilibrium is None or is_unstable, was_refused
            if was_refused and not is_last and not (is_unstable and self._accepted_unstable):
                part *= 0.5
                continue
            self._move_on(time, equilibrium, is_unstable=is_unstable)
            if equilibrium is not None and (
                self._accepted_unstable if is_unstable else not was_refused_before
            ):
                part = min(1.0, 2.0 * part)

    def _move_on(self, time: float, equilibrium: Equilibrium | None, *, is_unstable: bool) -> None:
        """Accept an equilibrium; relax if it is unstable or if there is none."""
        if equilibrium is None:
            self._relax(time, is_unstable=False)
            return
        self._commit(time, equilibrium)
        if is_unstable:
            self._relax(time, is_unstable=True)

    def _is_stable(self, equilibrium: Equilibrium) -> bool:
        return not self.settings.checks_stability or self.check.is_stable(
            equilibrium.balance, equilibrium.shape
        )

    @property
    def _accepted_unstable(self) -> bool:
        """Return whether an unstable equilibrium was accepted; smaller parts do not help then."""
        return self._has_reason("unstable")

    def _find_equilibrium(self, time: float, *, tries_sticking: bool = True) -> Equilibrium | None:
        """Find the equilibrium at a time; None if there is none nearby.

        Newton's method starts with sliders that continue to slide; if `tries_sticking`, it is
        tried again with sliders that stick after a reversal.
        """
        now = self.now
        target = self.schedule.compute_imposed(time, self.grips)
        balance, guess = now.balance, now.earlier or now.history
        while True:
            equilibrium = find_equilibrium(
                *(self.assembly, now.shape, now.history, (now.imposed, target)),
                force=self.force,
                guess=guess,
                known_balance=balance,
            )
            if equilibrium is not None and self._is_near_enough(equilibrium):
                return equilibrium
            if guess is now.history or not tries_sticking:
                return None
            guess = now.history
            balance = self.assembly.compute_balance(now.shape, now.imposed, guess)
            if np.array_equal(balance.values, now.balance.values):
                return None  # no slider continues to slide

    def _is_near_enough(self, equilibrium: Equilibrium) -> bool:
        now, largest_turn = self.now, self.settings.max_turn
        turns = equilibrium.balance.cells.turns - now.balance.cells.turns
        if float(np.max(np.linalg.norm(turns, axis=1), initial=0.0)) > largest_turn:
            return False
        turned = to_rotation_vectors(
            multiply(conjugate(now.shape.frames), equilibrium.shape.frames)
        )
        return float(np.max(np.linalg.norm(turned, axis=1))) < 2.0 * largest_turn

    def _commit(self, time: float, equilibrium: Equilibrium) -> None:
        """Take an equilibrium as the present state, and add to the energy lost."""
        now, new, target = self.now, equilibrium.balance, equilibrium.imposed
        self.lost += compute_lost_energy(self.assembly, now.history.rests, new.history.rests)
        self.now = SolverState(time, equilibrium.shape, new, target, new.history, now.history)
        max_strain = self.settings.max_strain
        check_line(self.assembly, equilibrium.shape, new, self.step, max_strain=max_strain)
        check_rings(self.schedule, new, self.step)

    # ---- relaxing -----------------------------------------------------------------------------

    def _relax(self, time: float, *, is_unstable: bool) -> None:
        """Relax the line to a stable equilibrium at a time."""
        # perturbations of a line without an equilibrium nearby, of the line's length, or rad
        perturbations = (0.0, 1e-3, 1e-2)
        if self.step not in self.snapped:
            self.snapped.append(self.step)
        saved = self.now, self.lost
        for perturbation in perturbations[1:] if is_unstable else perturbations:
            if self._relax_to_rest(time, perturbation):
                self.lost_in_jumps += self.lost - saved[1]
                return
            self.now, self.lost = saved
        if not is_unstable:
            pulls = np.linalg.norm(self.now.shape.forces, axis=1)
            node = int(np.argmax(pulls))
            place = self.line.describe_place(node)
            raise NoEquilibriumError.of(
                "mechanics.rod.no_equilibrium", step=self.step, place=place, pull=pulls[node]
            )
        if not self._has_reason("unstable"):
            push = np.zeros(self.assembly.indices.total)
            mode = self.check.find_softest_mode(self.now.balance, self.now.shape, push)
            moves = split_unknowns(push if mode is None else mode)[0]
            place = self.line.describe_place(int(np.argmax(np.linalg.norm(moves, axis=1))))
            self.reasons.append(Reason.of("mechanics.rod.unstable", step=self.step, place=place))

    def _relax_to_rest(self, time: float, perturbation: float) -> bool:
        """Relax the line with decreasing drag; return whether it comes to rest."""
        first_drag = 1.0
        # a mode of two turns is stiffer by (4 pi)^4, so that only a stable line stays at rest
        last_drag = 1e-8
        max_drag = 1e5
        rest_drag = 1e-3  # below it, the line is tried without drag
        drag_decrease, decrease_after_failure = 0.25, 0.5
        drag_increase = 4.0
        rest_tolerance = 1e-6  # of the line's length
        max_steps = 400
        target = self.schedule.compute_imposed(time, self.grips)
        shape = self._perturbed_shape(perturbation)
        size, decrease = first_drag, drag_decrease
        previous_positions = np.full_like(shape.positions, np.inf)
        for _ in range(max_steps):
            equilibrium = self._find_dragged_equilibrium(shape, target, size)
            if equilibrium is None:
                size *= drag_increase
                decrease = decrease_after_failure
                if size > max_drag:
                    return False
                continue
            self._commit(time, equilibrium)
            shape = equilibrium.shape
            size *= decrease
            decrease = drag_decrease
            if size < rest_drag and self._reach_rest(time):
                return True
            if size < last_drag:
                displacement = np.max(np.abs(shape.positions - previous_positions))
                if displacement < rest_tolerance * self.line.length:
                    return False
                previous_positions = shape.positions
                size *= drag_increase
        return False

    def _reach_rest(self, time: float) -> bool:
        """Accept a stable equilibrium without drag; return whether there is one."""
        final = self._find_equilibrium(time)
        if final is None or not self._is_stable(final):
            return False
        self._commit(time, final)
        return True

    def _find_dragged_equilibrium(
        self, shape: Shape, goal: ImposedValues, size: float
    ) -> Equilibrium | None:
        now = self.now
        drag = ArtificialDrag(size, shape, self.assembly.compute_turns(shape, now.imposed))
        equilibrium = find_equilibrium(
            *(self.assembly, shape, now.history, (now.imposed, goal)),
            force=self.force,
            guess=now.history,
            drag=drag,
        )
        if equilibrium is None or not self._is_near_enough(equilibrium):
            return None
        return equilibrium if self._is_stable(equilibrium) else None

    def _perturbed_shape(self, size: float) -> Shape:
        """Return the shape, perturbed along its softest mode; size relative to length, or rad."""
        now = self.now
        if not size:
            return now.shape
        target = self.schedule.compute_imposed(float(self.step), self.grips)
        zeros = np.zeros((self.schedule.n, 3))
        push = join_unknowns(target.forces, zeros[:, 0], zeros, zeros)
        mode = self.check.find_softest_mode(now.balance, now.shape, push)
        if mode is None:
            return now.shape
        moves, _, turns, _ = split_unknowns(mode)
        largest = max(np.max(np.abs(moves)) / self.line.length, np.max(np.abs(turns)))
        return self.assembly.apply_change(now.shape, mode * (size / largest))

    # ---- results ------------------------------------------------------------------------------

    def _has_reason(self, code: str) -> bool:
        return any(reason.code == code for reason in self.reasons)

    def _record_state(self, step: int) -> None:
        state = build_state(self.assembly, self.schedule, self.grips, self.now, step)
        self.states.append(state)
        self.losses.append((self.lost, self.lost_in_jumps))
        bendings, max_curvature = state.bendings, self.line.section.law.last
        node = int(np.argmax(bendings))
        if bendings[node] > max_curvature and not self._has_reason("beyond_law"):
            self.reasons.append(
                Reason.of(
                    "mechanics.rod.beyond_law",
                    step=step,
                    place=self.line.describe_place(node),
                    curvature=bendings[node],
                    last=max_curvature,
                )
            )

    def path(self) -> RodPath:
        """Return the path."""
        columns = np.array(self.losses).reshape(-1, 2).T
        status: Status = "doubtful" if self.reasons else "ok"
        return RodPath(
            self.line,
            self.boundaries,
            tuple(self.states),
            "failed" if self.failed else status,
            tuple(self.reasons),
            tuple(self.snapped),
            *columns,
        )
