"""Solve the quasi-static path of a line: its equilibrium at each step of its boundaries.

Every step is solved by Newton's method. A step is divided in two if the method does not converge,
if an element rotates too far, or if the new equilibrium is unstable. The history of sliders and
friction advances with every fraction of a step. Therefore a line buckles as soon as its straight
equilibrium is unstable, and not after a whole step.

If an equilibrium is unstable, or if there is none nearby because the line snaps or is released,
the line is *relaxed*. The line is then solved with an artificial drag against bending and twist,
which decreases to zero while the energy decreases, as in the motion of a line with internal
damping. The drag acts in each cell. A drag against motion would instead bend the free end of a
falling line, and the sliders would retain that bend. From an unstable equilibrium, the line moves
along its softest mode. Steps with relaxation, and steps with a release, are listed as `jump_steps`.
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
    """Solver of the equilibria of a line, with the present equilibrium and the results so far."""

    def __init__(
        self, line: Line, boundaries: tuple[Boundary, ...], n_steps: int, settings: RodSettings
    ) -> None:
        self.line, self.boundaries, self.settings = line, boundaries, settings
        n = len(line.lengths)
        shape = Shape(line.positions, line.frames, np.zeros(n), np.zeros((n, 3)))
        self.schedule = Schedule(line, boundaries, n_steps, shape)
        self.states: list[RodState] = []
        self.energies: list[tuple[float, float]] = []
        self.reasons: list[Reason] = []
        self.jump_steps: list[int] = []
        self.step = 0
        self.lost_energy = self.jump_energy = 0.0
        self.has_failed = False
        slider_rests = np.zeros((n + 1, 2, line.section.law.history_size, 2))
        contact_points = np.tile(line.positions, (len(self.schedule.planes), 1, 1))
        history = LineHistory(slider_rests, contact_points, self.schedule.ring_parameters)
        self._assemble(self.schedule.list_grips(0), -1.0, shape, history)

    def _assemble(
        self, grips: tuple[int, ...], time: float, shape: Shape, history: LineHistory
    ) -> None:
        """Assemble the line with its grips at a time.

        The history at this time has `slider_rests` of shape (nodes, 2, sliders, 2).
        """
        self.grips, schedule = grips, self.schedule
        nodes = [(schedule.held_nodes[k], schedule.grips[k].frame is not None) for k in grips]
        radius = 0.5 * self.line.section.diameter
        planes = tuple(plane.shift(radius) for plane in schedule.planes.values())
        lengths = np.array([string.length for string in schedule.strings.values()])
        self.assembly = Assembly(
            self.line,
            split_cells_at_clamps(self.line, tuple(nodes)),
            planes,
            (schedule.string_nodes, lengths),
            n_rings=len(schedule.rings),
            force=schedule.estimate_force(),
        )
        self.stability_check = StabilityCheck(self.assembly)
        # Without a clamp, both sides of a node form one cell. The rest curvatures of the cell are
        # the weighted mean of both sides, which keeps every slider within its limit.
        supports = self.assembly.supports
        side_rests = history.slider_rests[supports.nodes]
        rests = np.einsum("cs,csjx->cjx", supports.side_weights, side_rests)
        history = replace(history, slider_rests=rests)
        imposed = schedule.compute_imposed_values(time, grips)
        balance = self.assembly.compute_balance(shape, imposed, history)
        self.equilibrium = Equilibrium(shape, balance, imposed, history, previous_history=history)

    def _release_grips(self, step: int) -> None:
        """Remove the grips that release the line in a step.

        The line moves to an equilibrium nearby, or is relaxed if there is none.
        """
        grips, start = self.schedule.list_grips(step), self.equilibrium
        if grips == self.grips:
            return
        self.jump_steps.append(step)
        lost_energy, jump_energy = self.lost_energy, self.jump_energy
        rests = split_sides(self.assembly.supports, start.history.slider_rests)
        time = start.imposed.time
        self._assemble(grips, time, start.shape, replace(start.history, slider_rests=rests))
        equilibrium = self._find_equilibrium(time)
        is_unstable = equilibrium is not None and not self._is_stable(equilibrium)
        self._accept(time, equilibrium, is_unstable=is_unstable)
        self.jump_energy = jump_energy + self.lost_energy - lost_energy

    def solve_step(self, step: int) -> bool:
        """Solve a step and record its state; return False if no equilibrium is found."""
        self.step = step
        try:
            grips = self.schedule.list_grips(step)
            if self.assembly.is_rigid:
                check_reach(self.schedule, grips, step)
            check_planes(self.schedule, grips, step)
            if step > 0:
                self._release_grips(step)
            self._advance_to(float(step))
        except NoEquilibriumError as error:
            self.reasons.insert(0, error.reason)
            self.has_failed = True
            return False
        self._record_state(step)
        return True

    def _advance_to(self, end_time: float) -> None:
        """Advance to a time, counted in steps, by fractions of steps that are halved or doubled."""
        min_fraction = 2.0**-12  # of a step
        fraction, is_rejected = 1.0, False
        while self.equilibrium.imposed.time < end_time:
            time = min(end_time, self.equilibrium.imposed.time + fraction)
            is_smallest = fraction <= min_fraction
            tries_sticking = is_smallest or not is_rejected
            equilibrium = self._find_equilibrium(time, tries_sticking=tries_sticking)
            is_unstable = equilibrium is not None and not self._is_stable(equilibrium)
            # After an unstable equilibrium was accepted, smaller fractions fail as well.
            accepts_unstable = self._has_reason("unstable")
            is_rejected, was_rejected = equilibrium is None or is_unstable, is_rejected
            if is_rejected and not is_smallest and not (is_unstable and accepts_unstable):
                fraction *= 0.5
                continue
            self._accept(time, equilibrium, is_unstable=is_unstable)
            may_grow = self._has_reason("unstable") if is_unstable else not was_rejected
            if equilibrium is not None and may_grow:
                fraction = min(1.0, 2.0 * fraction)

    def _accept(self, time: float, equilibrium: Equilibrium | None, *, is_unstable: bool) -> None:
        """Accept an equilibrium; relax the line if it is unstable or if there is none."""
        if equilibrium is not None:
            self._set_equilibrium(equilibrium)
        if equilibrium is None or is_unstable:
            self._relax(time, is_unstable=is_unstable)

    def _is_stable(self, equilibrium: Equilibrium) -> bool:
        """Return whether an equilibrium is stable; True if stability is not checked."""
        return not self.settings.checks_stability or self.stability_check.is_stable(
            equilibrium.balance, equilibrium.shape
        )

    def _find_equilibrium(self, time: float, *, tries_sticking: bool = True) -> Equilibrium | None:
        """Find the equilibrium at a time; None if there is none nearby.

        Newton's method starts with sliders that continue to slide. If `tries_sticking`, it is
        repeated with sliders that stick after a reversal.
        """
        start, target = self.equilibrium, self.schedule.compute_imposed_values(time, self.grips)
        for guess in (start.previous_history, start.history):
            equilibrium = find_equilibrium(self.assembly, start, target, guess=guess)
            if equilibrium is not None and self._is_near(equilibrium):
                return equilibrium
            if guess is start.history or not tries_sticking:
                return None
            balance = self.assembly.compute_balance(start.shape, start.imposed, start.history)
            if np.array_equal(balance.tangent_values, start.balance.tangent_values):
                return None  # no slider continues to slide
            start = replace(start, balance=balance)
        return None

    def _is_near(self, equilibrium: Equilibrium) -> bool:
        """Return whether all turns since the present equilibrium are within their limits."""
        start, max_turn = self.equilibrium, self.settings.max_turn
        previous_turns = start.balance.cells.rotation_vectors
        cell_turns = equilibrium.balance.cells.rotation_vectors - previous_turns
        if float(np.max(np.linalg.norm(cell_turns, axis=1), initial=0.0)) > max_turn:
            return False
        rotations = multiply(conjugate(start.shape.frames), equilibrium.shape.frames)
        turns = np.linalg.norm(to_rotation_vectors(rotations), axis=1)
        return float(np.max(turns)) < 2.0 * max_turn

    def _set_equilibrium(self, equilibrium: Equilibrium) -> None:
        """Make an equilibrium the present one, add the lost energy, and check the line."""
        self.equilibrium, balance = equilibrium, equilibrium.balance
        rests = equilibrium.previous_history.slider_rests, equilibrium.history.slider_rests
        self.lost_energy += compute_lost_energy(self.assembly, *rests)
        max_strain = self.settings.max_strain
        check_line(self.assembly, equilibrium.shape, balance, self.step, max_strain=max_strain)
        check_rings(self.schedule, balance, self.step)

    def _relax(self, time: float, *, is_unstable: bool) -> None:
        """Relax the line to a stable equilibrium at a time.

        If there is none, an unstable equilibrium is kept, with a reason.
        """
        perturbations = (0.0, 1e-3, 1e-2)  # relative to the length of the line, or rad
        if self.step not in self.jump_steps:
            self.jump_steps.append(self.step)
        start, start_lost_energy = self.equilibrium, self.lost_energy
        for perturbation in perturbations[1:] if is_unstable else perturbations:
            if self._relax_to_rest(time, perturbation):
                self.jump_energy += self.lost_energy - start_lost_energy
                return
            self.equilibrium, self.lost_energy = start, start_lost_energy
        if not is_unstable:
            forces = np.linalg.norm(start.shape.forces, axis=1)
            element = int(np.argmax(forces))
            place = self.line.describe_position(element)
            raise NoEquilibriumError.of(
                "mechanics.rod.no_equilibrium", step=self.step, place=place, pull=forces[element]
            )
        if not self._has_reason("unstable"):
            load = np.zeros(self.assembly.indices.n_unknowns)
            mode = self.stability_check.find_softest_mode(start.balance, start.shape, load)
            displacements = split_unknowns(load if mode is None else mode)[0]
            softest_node = int(np.argmax(np.linalg.norm(displacements, axis=1)))
            place = self.line.describe_position(softest_node)
            self.reasons.append(Reason.of("mechanics.rod.unstable", step=self.step, place=place))

    def _relax_to_rest(self, time: float, perturbation: float) -> bool:
        """Relax the line with decreasing drag; return whether it comes to rest."""
        first_drag = 1.0  # all drags are relative to the stiffness of the cells
        # A mode of two waves is stiffer by (4 pi)^4, so that only a stable line stays at rest.
        min_drag = 1e-8
        max_drag = 1e5
        rest_drag = 1e-3  # below this drag, an equilibrium without drag is sought
        usual_factor, factor_after_failure = 0.25, 0.5
        increase_factor = 4.0
        rest_tolerance = 1e-6  # relative to the length of the line
        max_iterations = 400
        target = self.schedule.compute_imposed_values(time, self.grips)
        shape = self._perturb_shape(perturbation)
        drag, decrease_factor = first_drag, usual_factor
        previous_positions = np.full_like(shape.positions, np.inf)
        for _ in range(max_iterations):
            equilibrium = self._find_dragged_equilibrium(shape, target, drag)
            if equilibrium is None:
                drag *= increase_factor
                decrease_factor = factor_after_failure
                if drag > max_drag:
                    return False
                continue
            self._set_equilibrium(equilibrium)
            shape = equilibrium.shape
            drag *= decrease_factor
            decrease_factor = usual_factor
            if drag < rest_drag and self._reach_rest(time):
                return True
            if drag < min_drag:
                displacement = np.max(np.abs(shape.positions - previous_positions))
                if displacement < rest_tolerance * self.line.length:
                    return False
                previous_positions = shape.positions
                drag *= increase_factor
        return False

    def _reach_rest(self, time: float) -> bool:
        """Accept a stable equilibrium without drag; return whether there is one."""
        equilibrium = self._find_equilibrium(time)
        if equilibrium is None or not self._is_stable(equilibrium):
            return False
        self._set_equilibrium(equilibrium)
        return True

    def _find_dragged_equilibrium(
        self, shape: Shape, target: ImposedValues, drag_ratio: float
    ) -> Equilibrium | None:
        """Find a stable equilibrium with drag near a shape; None if there is none."""
        start = replace(self.equilibrium, shape=shape)
        frames = self.assembly.select_frames(shape, start.imposed)
        drag = ArtificialDrag(drag_ratio, shape, compute_turns(frames))
        equilibrium = find_equilibrium(self.assembly, start, target, guess=start.history, drag=drag)
        if equilibrium is None or not self._is_near(equilibrium):
            return None
        return equilibrium if self._is_stable(equilibrium) else None

    def _perturb_shape(self, perturbation: float) -> Shape:
        """Perturb the present shape along its softest mode.

        The perturbation is the largest displacement, relative to the length of the line, or the
        largest turn, rad.
        """
        balance, shape = self.equilibrium.balance, self.equilibrium.shape
        if not perturbation:
            return shape
        target = self.schedule.compute_imposed_values(float(self.step), self.grips)
        zeros = np.zeros((self.schedule.n, 3))
        load = join_unknowns(target.forces, zeros[:, 0], zeros, zeros)
        mode = self.stability_check.find_softest_mode(balance, shape, load)
        if mode is None:
            return shape
        displacements, _, turns, _ = split_unknowns(mode)
        mode_size = max(np.max(np.abs(displacements)) / self.line.length, np.max(np.abs(turns)))
        return self.assembly.apply_change(shape, mode * (perturbation / mode_size))

    def _has_reason(self, code: str) -> bool:
        """Return whether a reason with a code has been added."""
        return any(reason.code == code for reason in self.reasons)

    def _record_state(self, step: int) -> None:
        """Record the state of a step; add a reason when the law is first exceeded."""
        state = build_state(self.assembly, self.schedule, self.grips, self.equilibrium, step)
        self.states.append(state)
        self.energies.append((self.lost_energy, self.jump_energy))
        curvatures, max_curvature = state.bending_curvatures, self.line.section.law.max_curvature
        node = int(np.argmax(curvatures))
        if curvatures[node] > max_curvature and not self._has_reason("beyond_law"):
            self.reasons.append(
                Reason.of(
                    "mechanics.rod.beyond_law",
                    step=step,
                    place=self.line.describe_position(node),
                    curvature=curvatures[node],
                    last=max_curvature,
                )
            )

    def build_path(self) -> RodPath:
        """Build the path of the states so far."""
        lost_energy, jump_energy = np.array(self.energies).reshape(-1, 2).T
        status = Status.DOUBTFUL if self.reasons else Status.OK
        return RodPath(
            line=self.line,
            boundaries=self.boundaries,
            states=tuple(self.states),
            status=Status.FAILED if self.has_failed else status,
            reasons=tuple(self.reasons),
            jump_steps=tuple(self.jump_steps),
            lost_energy=lost_energy,
            jump_energy=jump_energy,
        )
