"""Follow a line through the steps of its boundaries, from equilibrium to equilibrium.

Every step is one of Newton's method, halved where it does not arrive, turns the line too far or
ends where the line is not stable; the memory of sliders and friction moves on with every part of a
step. So a line that buckles does it where it first can, and not after a whole step of pressing it
straight. There, and where no equilibrium follows (a line that snaps or is let go), the line is let
down: through ever less of a resistance to bending and twist, always downhill in energy, as a line
that is damped in itself would go. So each piece springs back by what it carries; a resistance to
movement would bend the free end as it falls, and sliders keep that. Such steps are `snapped`, and
so are those in which something lets go. An equilibrium that is not stable is left in the direction
in which it gives way first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.rod.assembly import ArtificialDrag, Assembly, Balance, Demands, LineMemory, Shape
from labpipe.rod.boundaries import Boundary, Moment, Plane
from labpipe.rod.energies import lost_energy, stored_energy, work_done
from labpipe.rod.equilibrium import Settled, settle
from labpipe.rod.line import Line
from labpipe.rod.path import Reason, RodPath, RodState, Status
from labpipe.rod.rotations import conjugate, multiply, rotation_vectors
from labpipe.rod.schedule import Schedule
from labpipe.rod.stability import StabilityCheck
from labpipe.rod.states import merged_rests, parted_rests, state_of
from labpipe.rod.supports import supports_of
from labpipe.rod.walk_errors import broken, held_in_plane, out_of_reach, ring_left


@dataclass(frozen=True, slots=True)
class RodSettings:
    """How a line is followed.

    Parameters
    ----------
    smallest_part : of a step, to which it is halved at most
    most_turn : rad, by which two neighbouring elements may turn against each other, and twice that
        any element in space, in a part of a step
    most_stretch : strain beyond which the line counts as torn
    checks_stability : whether equilibria are checked, and left where they are not stable
    """

    smallest_part: float = 2.0**-14
    most_turn: float = 0.5
    most_stretch: float = 0.05
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
    line : the line, which has never been bent but to its curvature at rest
    boundaries : what holds, pulls and supports it
    steps : of their paths
    settings : how; the usual where not given
    start : state of the same line to start from, with its memory, in place of the line's own shape
    on_step : called after each step

    Returns
    -------
    States 0 to `steps`, or up to the step before the one that failed: `status` is then `failed`,
    and the reason says in which step and where.

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


def _apart(before: Floats, behind: Floats) -> float:
    return float(np.max(np.abs(behind - before)))


class _NoEquilibriumError(Exception):
    """No way on, and why."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(reason.sentence)
        self.reason = reason


@dataclass(frozen=True, slots=True, eq=False)
class _WalkState:
    """Where the walk is: a shape in balance under its demands, and the memory before and behind."""

    time: float
    shape: Shape
    balance: Balance
    demands: Demands
    memory: LineMemory
    earlier: LineMemory | None


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
        shape, rests, contacts = _begin(line, boundaries, start)
        self.schedule = Schedule(line, boundaries, steps, shape)
        self.force = self.schedule.force_scale()
        self.states: list[RodState] = []
        self.energies: list[tuple[float, ...]] = []
        self.reasons: list[Reason] = []
        self.snapped: list[int] = []
        self.step = 0
        self.work = self.lost = self.rubbed = self.jumped = self.lost_in_jumps = 0.0
        self.failed = False
        self.is_checked = self.settings.checks_stability
        self._gather(
            self.schedule.grips(0),
            time=-1.0,
            shape=shape,
            rests=rests,
            contacts=contacts,
            places=_start_places(self.schedule, start),
        )
        self.work = self._stored()

    # ---- grips --------------------------------------------------------------------------------

    def _gather(
        self,
        grips: tuple[int, ...],
        *,
        time: float,
        shape: Shape,
        rests: Floats,
        contacts: Floats,
        places: Floats,
    ) -> None:
        """Set the line up with the grips that hold from a time on."""
        self.grips, schedule = grips, self.schedule
        held = []
        for k in grips:
            held.append(
                (schedule.held_nodes[k], getattr(self.boundaries[k], "frame", 0) is not None)
            )
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
        memory = LineMemory(merged_rests(self.assembly.supports, rests), contacts, places)
        demands = schedule.demands(time, grips)
        balance = self.assembly.balance(shape, demands, memory)
        self.now = _WalkState(time, shape, balance, demands, memory, None)

    def _let_go(self, step: int) -> None:
        """Take the grips away that hold no more in a step: the line comes free where they held it.

        It does so at once where that is near, else it falls.
        """
        grips, now = self.schedule.grips(step), self.now
        if grips == self.grips:
            return
        self.snapped.append(step)
        free, lost = self._set_free(), self.lost
        self._gather(
            grips,
            time=now.time,
            shape=now.shape,
            rests=parted_rests(self.assembly.supports, now.memory.rests),
            contacts=now.memory.contacts,
            places=now.memory.places,
        )
        jumped, lost_in_jumps = self.jumped, self.lost_in_jumps
        settled = self._settled(now.time)
        is_lost = settled is not None and not self._is_stable(settled)
        self._arrive(now.time, settled, is_lost=is_lost)
        self.jumped = jumped + self._set_free() - free
        self.lost_in_jumps = lost_in_jumps + self.lost - lost

    # ---- steps --------------------------------------------------------------------------------

    def go_to(self, step: int) -> bool:
        """Walk to a step; false where that fails."""
        self.step = step
        try:
            grips = self.schedule.grips(step)
            is_rigid = self.assembly.is_rigid
            self._refuse(
                out_of_reach(self.schedule, grips, step) if is_rigid else None,
                held_in_plane(self.schedule, grips, step),
            )
            if step > 0:
                self._let_go(step)
            self._walk_to(float(step))
        except _NoEquilibriumError as failure:
            self.reasons.insert(0, failure.reason)
            self.failed = True
            return False
        self._keep(step)
        return True

    def _walk_to(self, goal: float) -> None:
        part = 1.0
        smallest = self.settings.smallest_part
        was_refused = False
        while self.now.time < goal:
            time = min(goal, self.now.time + part)
            settled = self._settled(time)
            is_lost = settled is not None and not self._is_stable(settled)
            was_refused, before = settled is None or is_lost, was_refused
            if was_refused and part > smallest and not (is_lost and self._is_doubtful):
                part *= 0.5
                continue
            self._arrive(time, settled, is_lost=is_lost)
            if settled is not None and (self._is_doubtful if is_lost else not before):
                part = min(1.0, 2.0 * part)

    def _arrive(self, time: float, settled: Settled | None, *, is_lost: bool) -> None:
        """Move on to what was found, and from there or from here downhill if that is no place."""
        if settled is None:
            self._let_down(time, is_unstable=False)
            return
        self._commit(time, settled)
        if is_lost:
            self._leave(time)

    def _is_stable(self, settled: Settled) -> bool:
        return not self.is_checked or self.check.is_stable(settled.balance, settled.shape)

    @property
    def _is_doubtful(self) -> bool:
        """Whether the walk goes on where it is not stable: smaller parts show nothing more."""
        return self._is_said("unstable") or self._is_said("whirls")

    def _settled(self, time: float) -> Settled | None:
        """The equilibrium at a time; None where it is not found or is too far."""
        now = self.now
        goal = self.schedule.demands(time, self.grips)
        # what slid may slide on, or stick where the walk turns back
        for earlier in (now.earlier, None) if now.earlier is not None else (None,):
            settled = settle(
                self.assembly,
                now.shape,
                now.memory,
                (now.demands, goal),
                force=self.force,
                earlier=earlier,
            )
            if settled is not None and self._is_near(settled):
                return settled
        return None

    def _is_near(self, settled: Settled) -> bool:
        now, most = self.now, self.settings.most_turn
        bent = settled.balance.cells.turns - now.balance.cells.turns
        if float(np.max(np.linalg.norm(bent, axis=1), initial=0.0)) > most:
            return False
        turned = rotation_vectors(multiply(conjugate(now.shape.frames), settled.shape.frames))
        return float(np.max(np.linalg.norm(turned, axis=1))) < 2.0 * most

    def _commit(self, time: float, settled: Settled) -> None:
        """Move on to an equilibrium, with memory and energies."""
        now = self.now
        goal = self.schedule.demands(time, self.grips)
        new = settled.balance
        self.work += work_done(
            self.assembly, (now.demands, goal), (now.shape, settled.shape), (now.balance, new)
        )
        self.lost += lost_energy(self.assembly, now.memory.rests, new.memory.rests)
        self.rubbed += sum(touch.rubbed for touch in new.touches)
        self.now = _WalkState(time, settled.shape, new, goal, new.memory, now.memory)
        most = self.settings.most_stretch
        self._refuse(
            broken(self.assembly, settled.shape, new, self.step, most_stretch=most),
            ring_left(self.schedule, new, self.step),
        )

    def _stored(self) -> float:
        return stored_energy(self.assembly, self.now.balance, self.now.shape)

    def _set_free(self) -> float:
        """What is neither stored nor lost in sliders nor rubbed off, J."""
        return self.work - self._stored() - self.lost - self.rubbed

    # ---- letting down -------------------------------------------------------------------------

    def _leave(self, time: float) -> None:
        """Leave an equilibrium that is not stable; in whirling there is none to come to."""
        if self._is_said("whirls") or self.check.whirls(self.now.balance):
            self._doubt_stability("whirls", "moments of constant direction set the line whirling")
        else:
            self._let_down(time, is_unstable=True)

    def _let_down(self, time: float, *, is_unstable: bool) -> None:
        """Let the line go downhill to a stable equilibrium at a time."""
        # of the line's length, or rad: how far a line that finds no way on is moved off
        kicks = (0.0, 1e-3, 1e-2)
        if self.step not in self.snapped:
            self.snapped.append(self.step)
        before = self.now, self.work, self.lost, self.rubbed
        free = self._set_free()
        for kick in kicks[1:] if is_unstable else kicks:
            if self._comes_to_rest(time, kick):
                self.jumped += self._set_free() - free
                self.lost_in_jumps += self.lost - before[2]
                return
            self.now, self.work, self.lost, self.rubbed = before
        if not is_unstable:
            self._give_up()
        self._doubt_stability("unstable", "no stable one was reached from it")

    def _comes_to_rest(self, time: float, kick: float) -> bool:
        """Let the line down through ever less of a resistance; false where it finds no rest."""
        first_drag = 1.0
        # 1e-8 is about 1/(4 pi)^4 of what holds a way of two turns: only a stable line stays
        last_drag = 1e-8
        max_drag = 1e5
        drag_decrease = 0.25
        drag_increase = 8.0
        rest_tolerance = 1e-6  # of the line's length
        max_steps = 400
        goal = self.schedule.demands(time, self.grips)
        shape = self._kicked(kick)
        size = first_drag
        rested: Floats | None = None
        for _ in range(max_steps):
            settled = self._dragged(shape, goal, size)
            if settled is None:
                size *= drag_increase
                if size > max_drag:
                    return False
                continue
            self._commit(time, settled)
            shape = settled.shape
            size *= drag_decrease
            if size < last_drag:
                if self._rests(time):
                    return True
                if (
                    rested is not None
                    and _apart(rested, shape.positions) < rest_tolerance * self.line.length
                ):
                    return False
                rested = shape.positions
                size *= drag_increase
        return False

    def _rests(self, time: float) -> bool:
        """Whether the line is in a stable equilibrium without drag; it is then there."""
        final = self._settled(time)
        if final is None:
            return False
        if self.is_checked and not self.check.is_stable(final.balance, final.shape):
            return False
        self._commit(time, final)
        return True

    def _dragged(self, shape: Shape, goal: Demands, size: float) -> Settled | None:
        now = self.now
        drag = ArtificialDrag(size, shape, self.assembly.turns(shape, now.demands))
        settled = settle(
            self.assembly, shape, now.memory, (now.demands, goal), force=self.force, drag=drag
        )
        if settled is None or not self._is_near(settled):
            return None
        if self.is_checked and not self.check.is_stable(settled.balance, settled.shape):
            return None
        return settled

    def _kicked(self, size: float) -> Shape:
        """The line, moved off in the way in which it resists least."""
        now = self.now
        if not size:
            return now.shape
        p = self.assembly.places
        three = np.arange(3)
        goal = self.schedule.demands(float(self.step), self.grips)
        push = np.zeros(p.total)
        push[p.positions[:, None] + three] = goal.forces
        mode = self.check.lowest_mode(now.balance, now.shape, push)
        if mode is None:
            return now.shape
        move = float(np.max(np.abs(mode[p.positions[:, None] + three]))) / self.line.length
        turn = float(np.max(np.abs(mode[p.turns[:, None] + three])))
        return self.assembly.changed(now.shape, mode * (size / max(move, turn)))

    # ---- failures -----------------------------------------------------------------------------

    def _give_up(self) -> None:
        node = int(np.argmax(np.linalg.norm(self.now.shape.forces, axis=1)))
        pull = float(np.linalg.norm(self.now.shape.forces[node]))
        sentence = (
            f"step {self.step}: no equilibrium follows, however small the step; the largest force, "
            f"{pull:.3g} N, was behind node {node}"
        )
        raise _NoEquilibriumError(Reason("no_equilibrium", sentence, self.step, node))

    def _doubt_stability(self, code: str, why: str) -> None:
        """Go on with an equilibrium that is not stable, and say so once."""
        if self._is_said(code):
            return
        push = np.zeros(self.assembly.places.total)
        mode = self.check.lowest_mode(self.now.balance, self.now.shape, push)
        node = None
        if mode is not None:
            moved = mode[self.assembly.places.positions[:, None] + np.arange(3)]
            node = int(np.argmax(np.linalg.norm(moved, axis=1)))
        sentence = (
            f"step {self.step}: the equilibrium is not stable, and {why}; it gives way most at "
            f"node {node}"
        )
        self.reasons.append(Reason(code, sentence, self.step, node))

    def _is_said(self, code: str) -> bool:
        return any(reason.code == code for reason in self.reasons)

    def _refuse(self, *reasons: Reason | None) -> None:
        """Stop at the first of reasons that there is."""
        for reason in reasons:
            if reason is not None:
                raise _NoEquilibriumError(reason)

    # ---- what is kept -------------------------------------------------------------------------

    def _keep(self, step: int) -> None:
        state = state_of(self.assembly, self.schedule, self.grips, self.now, step)
        self.states.append(state)
        stored = self._stored()
        jumps = self.jumped, self.lost_in_jumps
        self.energies.append((self.work, stored, self.lost, self.rubbed, *jumps))
        last = self.line.section.law.last
        node = int(np.argmax(state.bendings))
        if state.bendings[node] > last and not self._is_said("beyond_law"):
            sentence = (
                f"step {step}: the curvature {state.bendings[node]:.4g} 1/m at node {node} is "
                f"beyond the range of the law, which ends at {last:.4g} 1/m"
            )
            self.reasons.append(Reason("beyond_law", sentence, step, node))

    def path(self) -> RodPath:
        """What the walk leaves."""
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
    """Where the line goes through the rings, in nodes."""
    places = schedule.start_places
    if start is None or len(start.slid) != len(schedule.boundaries):
        return places
    stations = schedule.line.stations
    known = np.interp(start.slid[list(schedule.rings)], stations, np.arange(len(stations)))
    return np.where(np.isfinite(known), known, places)


def _begin(
    line: Line, boundaries: tuple[Boundary, ...], start: RodState | None
) -> tuple[Shape, Floats, Floats]:
    n, sliders = len(line.lengths), len(line.section.law.stiffnesses)
    n_planes = sum(isinstance(boundary, Plane) for boundary in boundaries)
    if start is None:
        shape = Shape(line.positions, line.frames, np.zeros(n), np.zeros((n, 3)))
        contacts = np.tile(line.positions, (n_planes, 1, 1))
        return shape, np.zeros((n + 1, 2, sliders, 2)), contacts
    if start.rests.shape != (n + 1, 2, sliders, 2):
        message = (
            f"start: a state of {start.rests.shape[0] - 1} elements and {start.rests.shape[2]} "
            f"sliders; allowed is one of this line, {n} and {sliders}"
        )
        raise ValueError(message)
    shape = Shape(start.positions, start.frames, start.stretches, start.forces)
    contacts = start.contacts
    if len(contacts) != n_planes:
        contacts = np.tile(start.positions, (n_planes, 1, 1))
    return shape, start.rests, contacts
