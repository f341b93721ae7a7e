"""Follow a line through the steps of its boundaries, from equilibrium to equilibrium.

Every step is solved by Newton's method, halved where it does not converge, turns the line too far
or ends where the line is unstable; the history of sliders and friction advances with every part of
a step. So a line buckles where it first can, not after a whole step of pressing it straight. There,
and where no equilibrium follows (a line that snaps or is released), the line is relaxed: through
ever smaller resistance to bending and twist, always downhill in energy, as a line with internal
damping moves. So each piece relaxes by its own moment; a resistance to motion would bend the free
end as it falls, which sliders would keep. Such steps are `snapped`, and so are those with a
release. An unstable equilibrium is left along its softest mode.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labpipe.mechanics.rod.assembly import ArtificialDrag, Assembly, Demands, LineMemory, Shape
from labpipe.mechanics.rod.banded import join_unknowns, split_unknowns
from labpipe.mechanics.rod.boundaries import Boundary, Moment, Plane
from labpipe.mechanics.rod.equilibrium import Equilibrium, find_equilibrium
from labpipe.mechanics.rod.line import Line
from labpipe.mechanics.rod.path import Reason, RodPath, RodState, Status
from labpipe.mechanics.rod.rotations import conjugate, multiply, rotation_vectors
from labpipe.mechanics.rod.schedule import Schedule
from labpipe.mechanics.rod.stability import StabilityCheck
from labpipe.mechanics.rod.states import (
    WalkState,
    lost_energy,
    merge_rests,
    split_sides,
    state_of,
    stored_energy,
    work_done,
)
from labpipe.mechanics.rod.supports import supports_of
from labpipe.mechanics.rod.walk_errors import (
    NoEquilibriumError,
    check_line,
    check_planes,
    check_reach,
    check_rings,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats


@dataclass(frozen=True, slots=True)
class RodSettings:
    """Settings of `follow`.

    Parameters
    ----------
    min_step_fraction : of a step, smallest by halving
    max_turn : rad, largest relative turn of two neighbouring elements, and half of that of any
        element in space, in a part of a step
    max_strain : strain beyond which the line counts as torn
    checks_stability : whether equilibria are checked, and left where they are not stable
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
    start: RodState | None = None,
    on_step: Callable[[], object] = lambda: None,
) -> RodPath:
    """Follow a line through the steps of its boundaries.

    Parameters
    ----------
    line : the line, never bent except to its curvature at rest
    boundaries : what holds, loads and supports it
    steps : of their paths
    settings : by default the usual ones
    start : state of the same line, with its history, in place of the line's own shape
    on_step : called after each step

    Returns
    -------
    States 0 to `steps`, or up to the step before the one that failed: `status` is then `failed`,
    and the reason states step and place.

    Raises
    ------
    ValueError
        If a node is not on the line, a path has another number of rows, or two boundaries hold one
        node at the same time.
    """
    walk = _Walk(line, tuple(boundaries), steps, settings or RodSettings(), start)
    for step in range(steps + 1):
        if not walk.go_to(step):
            break
        on_step()
    return walk.path()


class _Walk:
    def __init__(
        self,
        line: Line,
        boundaries: tuple[Boundary, ...],
        steps: int,
        settings: RodSettings,
        start: RodState | None,
    ) -> None:
        self.line, self.boundaries, self.settings = line, boundaries, settings
        shape, rests, contacts = _start_state(line, boundaries, start)
        self.schedule = Schedule(line, boundaries, steps, shape)
        self.force = self.schedule.force_scale()
        self.states: list[RodState] = []
        self.energies: list[tuple[float, ...]] = []
        self.reasons: list[Reason] = []
        self.snapped: list[int] = []
        self.step = 0
        self.work = self.lost = self.friction_loss = self.jumped = self.slider_loss_in_jumps = 0.0
        self.failed = False
        self.is_checked = self.settings.checks_stability
        memory = LineMemory(rests, contacts, _start_places(self.schedule, start))
        self._set_up(self.schedule.grips(0), -1.0, shape, memory)
        self.work = self._stored_energy()

    # ---- grips --------------------------------------------------------------------------------

    def _set_up(
        self, grips: tuple[int, ...], time: float, shape: Shape, memory: LineMemory
    ) -> None:
        """Set the line up with the grips that hold from a time on; its memory is by nodes."""
        self.grips, schedule = grips, self.schedule
        held = [(schedule.held_nodes[k], schedule.is_clamp(k)) for k in grips]
        planes = tuple(
            boundary.raised(0.5 * self.line.section.diameter)
            for boundary in self.boundaries
            if isinstance(boundary, Plane)
        )
        lengths = np.array([getattr(self.boundaries[k], "length", 0.0) for k in schedule.strings])
        self.assembly = Assembly(
            self.line,
            supports_of(self.line, tuple(held)),
            planes,
            (schedule.string_nodes, lengths),
            n_rings=len(schedule.rings),
            force=self.force,
        )
        is_turned = any(isinstance(boundary, Moment) for boundary in self.boundaries)
        self.check = StabilityCheck(self.assembly, is_turned=is_turned)
        memory = replace(memory, rests=merge_rests(self.assembly.supports, memory.rests))
        demands = schedule.demands(time, grips)
        balance = self.assembly.balance(shape, demands, memory)
        self.now = WalkState(time, shape, balance, demands, memory, None)

    def _release_grips(self, step: int) -> None:
        """Release the grips that end in a step; the line starts from where they held it.

        It moves to a near equilibrium, else it falls.
        """
        grips, now = self.schedule.grips(step), self.now
        if grips == self.grips:
            return
        self.snapped.append(step)
        free, lost = self._unaccounted_energy(), self.lost
        rests = split_sides(self.assembly.supports, now.memory.rests)
        self._set_up(grips, now.time, now.shape, replace(now.memory, rests=rests))
        jumped, slider_loss_in_jumps = self.jumped, self.slider_loss_in_jumps
        equilibrium = self._find_equilibrium(now.time)
        is_unstable = equilibrium is not None and not self._is_stable(equilibrium)
        self._move_on(now.time, equilibrium, is_unstable=is_unstable)
        self.jumped = jumped + self._unaccounted_energy() - free
        self.slider_loss_in_jumps = slider_loss_in_jumps + self.lost - lost

    # ---- steps --------------------------------------------------------------------------------

    def go_to(self, step: int) -> bool:
        """Follow the line to a step; false where that fails."""
        self.step = step
        try:
            grips = self.schedule.grips(step)
            if self.assembly.is_rigid:
                check_reach(self.schedule, grips, step)
            check_planes(self.schedule, grips, step)
            if step > 0:
                self._release_grips(step)
            self._walk_to(float(step))
        except NoEquilibriumError as failure:
            self.reasons.insert(0, failure.reason)
            self.failed = True
            return False
        self._record_state(step)
        return True

    def _walk_to(self, goal: float) -> None:
        part = 1.0
        smallest = self.settings.min_step_fraction
        was_refused = False
        while self.now.time < goal:
            time = min(goal, self.now.time + part)
            is_last = part <= smallest
            equilibrium = self._find_equilibrium(time, both=is_last or not was_refused)
            is_unstable = equilibrium is not None and not self._is_stable(equilibrium)
            was_refused, before = equilibrium is None or is_unstable, was_refused
            if was_refused and not is_last and not (is_unstable and self._accepted_unstable):
                part *= 0.5
                continue
            self._move_on(time, equilibrium, is_unstable=is_unstable)
            if equilibrium is not None and (self._accepted_unstable if is_unstable else not before):
                part = min(1.0, 2.0 * part)

    def _move_on(self, time: float, equilibrium: Equilibrium | None, *, is_unstable: bool) -> None:
        """Commit an equilibrium, and relax from it if unstable, or from here if there is none."""
        if equilibrium is None:
            self._relax(time, is_unstable=False)
            return
        self._commit(time, equilibrium)
        if is_unstable:
            self._leave_unstable(time)

    def _is_stable(self, equilibrium: Equilibrium) -> bool:
        return not self.is_checked or self.check.is_stable(equilibrium.balance, equilibrium.shape)

    @property
    def _accepted_unstable(self) -> bool:
        """Return whether an unstable equilibrium was accepted: smaller parts do not help."""
        return self._has_reason("unstable") or self._has_reason("whirls")

    def _find_equilibrium(self, time: float, *, both: bool = True) -> Equilibrium | None:
        """Find the equilibrium at a time; None where there is none near.

        Sliders may slide on, or stick after a reversal: the second guess is made if `both`.
        """
        now = self.now
        goal = self.schedule.demands(time, self.grips)
        for guess in [now.earlier or now.memory, now.memory][: 2 if both and now.earlier else 1]:
            equilibrium = find_equilibrium(
                *(self.assembly, now.shape, now.memory, (now.demands, goal)),
                force=self.force,
                guess=guess,
                known=now.balance,
            )
            if equilibrium is not None and self._is_near_enough(equilibrium):
                return equilibrium
        return None

    def _is_near_enough(self, equilibrium: Equilibrium) -> bool:
        now, largest_turn = self.now, self.settings.max_turn
        turns = equilibrium.balance.cells.turns - now.balance.cells.turns
        if float(np.max(np.linalg.norm(turns, axis=1), initial=0.0)) > largest_turn:
            return False
        turned = rotation_vectors(multiply(conjugate(now.shape.frames), equilibrium.shape.frames))
        return float(np.max(np.linalg.norm(turned, axis=1))) < 2.0 * largest_turn

    def _commit(self, time: float, equilibrium: Equilibrium) -> None:
        """Accept an equilibrium, with history and energies."""
        now = self.now
        goal = self.schedule.demands(time, self.grips)
        new = equilibrium.balance
        self.work += work_done(
            self.assembly, (now.demands, goal), (now.shape, equilibrium.shape), (now.balance, new)
        )
        self.lost += lost_energy(self.assembly, now.memory.rests, new.memory.rests)
        self.friction_loss += sum(touch.rubbed for touch in new.touches)
        self.now = WalkState(time, equilibrium.shape, new, goal, new.memory, now.memory)
        most = self.settings.max_strain
        check_line(self.assembly, equilibrium.shape, new, self.step, max_strain=most)
        check_rings(self.schedule, new, self.step)

    def _stored_energy(self) -> float:
        return stored_energy(self.assembly, self.now.balance, self.now.shape)

    def _unaccounted_energy(self) -> float:
        """Return the work that is not stored, lost in sliders or by friction, J."""
        return self.work - self._stored_energy() - self.lost - self.friction_loss

    # ---- relaxing -----------------------------------------------------------------------------

    def _leave_unstable(self, time: float) -> None:
        """Relax from an unstable equilibrium; accept it with a reason if the line whirls there."""
        if self._has_reason("whirls") or self.check.whirls(self.now.balance):
            self._doubt_stability(is_whirling=True)
        else:
            self._relax(time, is_unstable=True)

    def _relax(self, time: float, *, is_unstable: bool) -> None:
        """Relax the line to a stable equilibrium at a time."""
        # of the line's length, or rad: perturbations of a line without a near equilibrium
        kicks = (0.0, 1e-3, 1e-2)
        if self.step not in self.snapped:
            self.snapped.append(self.step)
        saved = self.now, self.work, self.lost, self.friction_loss
        free = self._unaccounted_energy()
        for kick in kicks[1:] if is_unstable else kicks:
            if self._relax_to_rest(time, kick):
                self.jumped += self._unaccounted_energy() - free
                self.slider_loss_in_jumps += self.lost - saved[2]
                return
            self.now, self.work, self.lost, self.friction_loss = saved
        if not is_unstable:
            pulls = np.linalg.norm(self.now.shape.forces, axis=1)
            node = int(np.argmax(pulls))
            reason = Reason.of(
                "mechanics.rod.no_equilibrium", step=self.step, place=node, pull=pulls[node]
            )
            raise NoEquilibriumError(reason)
        self._doubt_stability(is_whirling=False)

    def _relax_to_rest(self, time: float, kick: float) -> bool:
        """Relax the line through decreasing drag; false where it does not come to rest."""
        first_drag = 1.0
        # a mode of two turns is stiffer by (4 pi)^4, so that only a stable line stays
        last_drag = 1e-8
        max_drag = 1e5
        drag_decrease = 0.25
        drag_increase = 8.0
        rest_tolerance = 1e-6  # of the line's length
        max_steps = 400
        goal = self.schedule.demands(time, self.grips)
        shape = self._perturbed_shape(kick)
        size = first_drag
        rested: Floats | None = None
        for _ in range(max_steps):
            equilibrium = self._find_dragged(shape, goal, size)
            if equilibrium is None:
                size *= drag_increase
                if size > max_drag:
                    return False
                continue
            self._commit(time, equilibrium)
            shape = equilibrium.shape
            size *= drag_decrease
            if size < last_drag:
                if self._reach_rest(time):
                    return True
                moved = np.inf if rested is None else np.max(np.abs(shape.positions - rested))
                if moved < rest_tolerance * self.line.length:
                    return False
                rested = shape.positions
                size *= drag_increase
        return False

    def _reach_rest(self, time: float) -> bool:
        """Accept a stable equilibrium without drag; false where there is none."""
        final = self._find_equilibrium(time)
        if final is None:
            return False
        if self.is_checked and not self.check.is_stable(final.balance, final.shape):
            return False
        self._commit(time, final)
        return True

    def _find_dragged(self, shape: Shape, goal: Demands, size: float) -> Equilibrium | None:
        now = self.now
        drag = ArtificialDrag(size, shape, self.assembly.turns(shape, now.demands))
        equilibrium = find_equilibrium(
            *(self.assembly, shape, now.memory, (now.demands, goal)),
            force=self.force,
            guess=now.memory,
            drag=drag,
        )
        if equilibrium is None or not self._is_near_enough(equilibrium):
            return None
        if self.is_checked and not self.check.is_stable(equilibrium.balance, equilibrium.shape):
            return None
        return equilibrium

    def _perturbed_shape(self, size: float) -> Shape:
        """Return the shape perturbed along its softest mode."""
        now = self.now
        if not size:
            return now.shape
        goal = self.schedule.demands(float(self.step), self.grips)
        none = np.zeros((self.schedule.n, 3))
        push = join_unknowns(goal.forces, none[:, 0], none, none)
        mode = self.check.lowest_mode(now.balance, now.shape, push)
        if mode is None:
            return now.shape
        moves, _, turns, _ = split_unknowns(mode)
        largest = max(np.max(np.abs(moves)) / self.line.length, np.max(np.abs(turns)))
        return self.assembly.changed(now.shape, mode * (size / largest))

    # ---- results ------------------------------------------------------------------------------

    def _doubt_stability(self, *, is_whirling: bool) -> None:
        """Record once why an unstable equilibrium was accepted."""
        push = np.zeros(self.assembly.places.total)
        mode = self.check.lowest_mode(self.now.balance, self.now.shape, push)
        moves = split_unknowns(push if mode is None else mode)[0]
        node = int(np.argmax(np.linalg.norm(moves, axis=1)))
        reason = Reason.of(
            "mechanics.rod.whirls" if is_whirling else "mechanics.rod.unstable",
            step=self.step,
            place=node,
        )
        if not self._has_reason(reason.code):
            self.reasons.append(reason)

    def _has_reason(self, code: str) -> bool:
        return any(reason.code == code for reason in self.reasons)

    def _record_state(self, step: int) -> None:
        state = state_of(self.assembly, self.schedule, self.grips, self.now, step)
        self.states.append(state)
        stored = self._stored_energy()
        jumps = self.jumped, self.slider_loss_in_jumps
        self.energies.append((self.work, stored, self.lost, self.friction_loss, *jumps))
        last = self.line.section.law.last
        node = int(np.argmax(state.bendings))
        if state.bendings[node] > last and not self._has_reason("beyond_law"):
            bent = state.bendings[node]
            self.reasons.append(
                Reason.of(
                    "mechanics.rod.beyond_law", step=step, place=node, curvature=bent, last=last
                )
            )

    def path(self) -> RodPath:
        """Return the path."""
        columns = np.array(self.energies).reshape(-1, 6).T
        status: Status = "doubtful" if self.reasons else "ok"
        return RodPath(
            tuple(self.states),
            "failed" if self.failed else status,
            tuple(self.reasons),
            tuple(self.snapped),
            *columns,
        )


def _start_places(schedule: Schedule, start: RodState | None) -> Floats:
    """Return where the line passes through the rings, in nodes."""
    places = schedule.start_places
    if start is None or len(start.slid) != len(schedule.boundaries):
        return places
    stations = schedule.line.stations
    known_places = np.interp(start.slid[list(schedule.rings)], stations, np.arange(len(stations)))
    return np.where(np.isfinite(known_places), known_places, places)


def _start_state(
    line: Line, boundaries: tuple[Boundary, ...], start: RodState | None
) -> tuple[Shape, Floats, Floats]:
    n, sliders = len(line.lengths), line.section.law.history_size
    n_planes = sum(isinstance(boundary, Plane) for boundary in boundaries)
    if start is None:
        shape = Shape(line.positions, line.frames, np.zeros(n), np.zeros((n, 3)))
        contacts = np.tile(line.positions, (n_planes, 1, 1))
        return shape, np.zeros((n + 1, 2, sliders, 2)), contacts
    if start.rests.shape != (n + 1, 2, sliders, 2):
        nodes, _, n_sliders, _ = start.rests.shape
        message = format_sentence(
            "mechanics.rod.other_line", elements=nodes - 1, sliders=n_sliders, n=n, own=sliders
        )
        raise ValueError(message)
    shape = Shape(start.positions, start.frames, start.stretches, start.forces)
    contacts = start.contacts
    if len(contacts) != n_planes:
        contacts = np.tile(start.positions, (n_planes, 1, 1))
    return shape, start.rests, contacts
