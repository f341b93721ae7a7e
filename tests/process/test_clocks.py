"""Where a motion turns, and how clocks are joined there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from labpipe.process.motion import (
    Motion,
    Turn,
    check_turns,
    find_motion_turns,
    fit_common_start,
    fit_turning_points,
    make_stated_fit,
)
from labpipe.protocol.schema import AlignCommonStart, AlignStated, AlignTurningPoints
from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import ClockFit
from labpipe.records.quality import Findings
from labpipe.records.signals import Signal
from labpipe.signal.clock_alignment import CycleLag
from labpipe.signal.turning_points import find_strokes
from tests.approved import Approve
from tests.builders.reasons import doubted

Array = NDArray[np.float64]


_SLIDERS = ((0.1e-3, 0.10), (0.3e-3, 0.06), (1.0e-3, 0.05), (3.0e-3, 0.04))
"""Reach, m, and force, as a share of the peak of the spring, of each slider."""


@dataclass(frozen=True)
class Dwelling:
    """One test.

    Parameters
    ----------
    dwell : s, at every turn
    relaxes : share of the force at the top that is lost in the first second of waiting there
    offset, drift : of the clock of the force
    peak : N, of the spring
    cycles, stroke, speed, rest : 1, m, m/s, s
    fps, rate : Hz
    motion_noise, force_noise : m, N
    seed : of the noise
    """

    dwell: float
    relaxes: float = 0.0
    offset: float = 1.3
    drift: float = 40e-6
    peak: float = 0.8
    cycles: int = 3
    stroke: float = 0.025
    speed: float = 1e-3
    rest: float = 6.0
    fps: float = 50.0
    rate: float = 500.0
    motion_noise: float = 1e-5
    force_noise: float = 2e-3
    seed: int = 0

    @property
    def corners(self) -> Array:
        """Marker times at which the clamp starts and stops, s, shape (strokes, 2)."""
        lasts = self.stroke / self.speed
        begin = self.rest + max(0.0, -self.offset)
        starts = begin + np.arange(2 * self.cycles) * (lasts + self.dwell)
        return np.stack([starts, starts + lasts], axis=1)

    @property
    def stops(self) -> float:
        """Marker time at which both recorders stop, s."""
        return float(self.corners[-1, 1]) + self.rest

    def travel(self, time: Array) -> Array:
        """Place of the clamp, m, at marker times."""
        ups = np.tile([0.0, self.stroke, self.stroke, 0.0], self.cycles)
        return np.asarray(np.interp(time, self.corners.ravel(), ups), dtype=np.float64)

    def force(self, time: Array) -> Array:
        """Force, N, at marker times."""
        place = self.travel(time)
        pull = self.peak * np.tanh(place / self.stroke) / np.tanh(1.0)
        for reach, share in _SLIDERS:
            pull = pull + self._slider(time, place, reach, share * self.peak)
        return np.asarray(np.maximum(pull - self._lost(time), -0.01), dtype=np.float64)

    def _slider(self, time: Array, place: Array, reach: float, most: float) -> Array:
        force, held, turned = np.zeros(len(time)), 0.0, 0.0
        edges = [*self.corners[:, 0].tolist(), np.inf]
        for number, (start, stop) in enumerate(pairwise(edges)):
            period = (time >= start) & (time < stop)
            moved = place[period] - turned
            force[period] = np.clip(held + most / reach * moved, -most, most)
            turned = self.stroke if number % 2 == 0 else 0.0
            way = self.stroke if number % 2 == 0 else -self.stroke
            held = float(np.clip(held + most / reach * way, -most, most))
        return force

    def _lost(self, time: Array) -> Array:
        """Force lost by waiting at the top: fast at first, and slowly won back afterwards."""
        lost = np.zeros(len(time))
        for arrival, departure in zip(self.corners[::2, 1], self.corners[1::2, 0], strict=True):
            waited = np.clip(time - arrival, 0.0, departure - arrival)
            since = np.maximum(time - departure, 0.0)
            lost += np.log1p(waited / 0.1) / np.log1p(10.0) * np.exp(-since / 15.0)
        return self.relaxes * self.peak * lost

    def seen_by_cameras(self) -> tuple[Array, Array]:
        """Marker times, s, and travel with its noise, m."""
        time = np.arange(0.0, self.stops, 1.0 / self.fps)
        noise = np.random.default_rng([self.seed, 1]).normal(0.0, self.motion_noise, len(time))
        return time, self.travel(time) + noise

    def seen_by_load_cell(self) -> tuple[Array, Array]:
        """Times of the recorder, s, and force with its noise, N."""
        lasts = self.offset + (1.0 + self.drift) * self.stops
        time = np.arange(0.0, lasts, 1.0 / self.rate)
        noise = np.random.default_rng([self.seed, 2]).normal(0.0, self.force_noise, len(time))
        return time, self.force((time - self.offset) / (1.0 + self.drift)) + noise


TIME: Floats = np.arange(0.0, 50.0, 0.02)


def travel(*corners: tuple[float, float], seed: int = 1, noise: float = 1e-5) -> Floats:
    """A motion through (time s, position mm) corners."""
    times, places = zip(*corners, strict=True)
    scatter = np.random.default_rng(seed).normal(0, noise, len(TIME))
    motion: Floats = 1e-3 * np.interp(TIME, times, places) + scatter
    return motion


SHARP = travel((0, 0), (5, 0), (25, 20), (45, 0), (50, 0))


def moved(signal: Signal, window: float, min_stroke: float = 5e-3) -> Motion:
    strokes = find_strokes(signal.time, signal.values, min_stroke=min_stroke)
    motion = Motion(signal, strokes=strokes)
    return replace(motion, turns=find_motion_turns(motion, window=window))


def turns_of(motion: Floats, time: Floats = TIME) -> tuple[Findings, tuple[Turn, ...]]:
    turned = moved(Signal(time, motion, "m", "markers"), 25.0)
    return Findings() + check_turns(turned), turned.turns


def test_turns_in_corners() -> None:
    notes, turns = turns_of(travel((0, 0), (5, 0), (15, 10), (25, 0), (35, 10), (45, 0), (50, 0)))
    assert [turn.stroke_index for turn in turns] == [0, 1, 2]
    for turn in turns:
        assert turn.middle_time == pytest.approx(15.0 + 10.0 * turn.stroke_index, abs=5e-3)
        assert turn.arrival is turn.departure
        assert turn.dwell == 0.0
    assert not notes.doubts


@pytest.mark.slow
@pytest.mark.parametrize("dwell", [0.1, 0.2, 0.5, 1.0, 2.0, 5.0])
def test_waits_have_two_corners(dwell: float) -> None:
    """Also those that no stroke shows; arrival and departure hold within their errors."""
    pulls = []
    for seed in range(10):
        test = Dwelling(dwell, seed=seed)
        time, motion = test.seen_by_cameras()
        _, turns = turns_of(motion, time)
        assert [turn.stroke_index for turn in turns] == list(range(5))
        for turn, true in zip(
            turns, np.column_stack([test.corners[:-1, 1], test.corners[1:, 0]]), strict=True
        ):
            assert turn.middle_time == pytest.approx(float(true.mean()), abs=0.02)
            assert turn.arrival is not turn.departure
            corners = [(x.time, x.time_error) for x in (turn.arrival, turn.departure)]
            pulls += [(at - real) / error for (at, error), real in zip(corners, true, strict=True)]
    assert np.mean(np.abs(pulls) < 1.96) > 0.85


def test_no_wait_is_made_of_noise() -> None:
    for seed in range(6):
        notes, turns = turns_of(SHARP + np.random.default_rng(seed).normal(0, 2e-5, len(TIME)))
        assert [turn.dwell for turn in turns] == [0.0]
        assert not notes.doubts


def rounded(slows_for: float) -> Floats:
    """A machine that comes to a stop evenly and goes back as evenly: no corner, and no wait."""
    fine = np.arange(0.0, 50.0, 1e-3)
    corners = [5, 5, 25 - slows_for / 2, 25 + slows_for / 2, 45, 45]
    path = 1e-6 * np.interp(TIME, fine, np.cumsum(np.interp(fine, corners, [0, 1, 1, -1, -1, 0])))
    return np.asarray(path + np.random.default_rng(0).normal(0.0, 1e-5, len(TIME)))


MOTIONS = {
    "a turn that was not seen": np.where((TIME > 24.5) & (TIME < 25.5), np.nan, SHARP),
    "a machine that slows down": rounded(0.5),
    "one that slows down for longer": rounded(1.2),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_motions_that_are_doubted(name: str, approved: Approve) -> None:
    findings, _ = turns_of(MOTIONS[name])
    approved(f"{key}: {why}" for key, why in doubted(findings.entries).items())


OFFSET, DRIFT = 1.25, 80e-6


ALIGN = AlignTurningPoints.model_validate(
    {
        "method": "turning-points",
        "channel": "force",
        "motion_window": "8 s",
        "force_window": "1 s",
        "max_residual": "5 ms",
        "max_drift": "500 ppm",
    }
)


def triangle(time: Floats, cycles: int) -> Floats:
    """10 s up, 10 s down, from 5 s on; 0 before and after."""
    phase = (time - 5.0) % 20.0
    moving = (time > 5.0) & (time < 5.0 + 20.0 * cycles)
    return np.where(moving, np.minimum(phase, 20.0 - phase) / 10.0, 0.0)


@dataclass(frozen=True)
class Seen:
    """One test by two recorders: the motion in m, the force in N on a clock of its own."""

    travel: Signal
    force: Signal

    def with_force(self, part: slice | Flags = slice(None), values: Floats | None = None) -> Seen:
        """Some of the samples of the force, or other values."""
        force_values = self.force.values if values is None else values
        return replace(
            self, force=replace(self.force, time=self.force.time[part], values=force_values[part])
        )


@dataclass(frozen=True)
class Joined:
    """The clocks of a test, and what was found on the way."""

    fit: ClockFit | None
    findings: Findings

    @property
    def doubted(self) -> dict[str, str]:
        return doubted(self.findings.entries)


def seen(cycles: int, *, drift: float = DRIFT, noise: float = 1e-4) -> Seen:
    random = np.random.default_rng(cycles)
    motion_time = np.arange(0.0, 12.0 + 20.0 * cycles, 0.02)
    force_time = np.arange(0.0, 12.0 + 20.0 * cycles, 0.002)
    marker_time = (force_time - OFFSET) / (1.0 + drift)
    travel = 0.05 * triangle(motion_time, cycles)
    force = triangle(marker_time, cycles) ** 0.8
    travel = travel + random.normal(0, 1e-5, len(travel))
    force = force + random.normal(0, noise, len(force))
    return Seen(
        Signal(motion_time, travel, "m", "markers"), Signal(force_time, force, "N", "force")
    )


def aligned(made: Seen, align: AlignTurningPoints = ALIGN, *, window: float = 8.0) -> Joined:
    fit, findings = fit_turning_points(made.force, align, moved(made.travel, window, 0.01))
    return Joined(fit, Findings() + findings)


@pytest.mark.parametrize("cycles", [2, 3, 5])
def test_offset_and_drift(cycles: int) -> None:
    """A residual that noise explains is within any limit."""
    match = aligned(seen(cycles), ALIGN.model_copy(update={"max_residual": 1e-9}))
    assert match.fit is not None
    assert match.fit.offset == pytest.approx(OFFSET, abs=3e-3)
    assert match.fit.drift == pytest.approx(DRIFT, abs=6e-5)
    assert len(match.fit.event_times_motion) == cycles
    assert ("repeated cycle" in match.fit.method) == (cycles > 2)
    assert not match.doubted


def lost() -> Seen:
    """The recorder of the force lost 60 ms between the first turn and the second."""
    record = seen(3)
    late = 0.06 * (record.force.time > OFFSET + 25.0)
    return replace(record, force=replace(record.force, time=record.force.time - late))


SEEN = {
    "as it should be": seen(3),
    "a drift that is too large": seen(3, drift=2e-3),
    "a residual that is too large": lost(),
    "one event": seen(1),
    "a constant force": seen(2).with_force(values=np.full(len(seen(2).force.time), 0.25)),
    "a force that saw no peak": seen(2).with_force(slice(0, 1000)),
    "a force that was started late": seen(3).with_force(seen(3).force.time > 20.0),
}


@pytest.mark.parametrize("name", SEEN)
def test_what_is_doubted(name: str, approved: Approve) -> None:
    joined = aligned(SEEN[name])
    blocked = joined.findings.blocking_reason
    approved(
        [*(f"{key}: {why}" for key, why in joined.doubted.items()), *([blocked] if blocked else [])]
    )
    assert (joined.fit is None) == (blocked is not None)


@pytest.mark.parametrize(("lag", "is_used"), [(20.0, True), (20.2, False)])
def test_cycles_that_are_not_alike_are_joined_by_their_turns_alone(
    monkeypatch: pytest.MonkeyPatch, lag: float, is_used: bool
) -> None:
    repeat = CycleLag(20.0, lag * (1.0 + DRIFT), 1e-3)
    monkeypatch.setattr("labpipe.process.motion._measure_cycle_lag", lambda *_: repeat)
    match = aligned(seen(3), window=ALIGN.motion_window)
    assert match.fit is not None
    assert ("repeated" in match.fit.method) is is_used
    assert match.fit.offset == pytest.approx(OFFSET, abs=5e-3)
    messages = [note.message for note in match.findings.notes if note.code == "cycles_not_alike"]
    assert len(messages) == (not is_used)
    if messages:
        assert messages[0].startswith("the last cycle of the force is 20.202 s later than the")


def joined(test: Dwelling, *, hidden: int | None = None) -> Joined:
    """Both records of a test, their clocks joined; one turn of the motion hidden."""
    time, travel = test.seen_by_cameras()
    if hidden is not None:
        turn = test.corners[hidden, 1] + 0.5 * test.dwell
        travel[np.abs(time - turn) < 0.5 * test.dwell + 0.6] = np.nan
    motion = moved(Signal(time, travel, "m", "markers"), 25.0)
    force = Signal(*test.seen_by_load_cell(), "N", "force")
    align = ALIGN.model_copy(update={"max_residual": 10e-3})
    fit, findings = fit_turning_points(force, align, motion)
    return Joined(fit, Findings() + findings + check_turns(motion))


def dwelling(dwell: float, relaxes: float, seed: int) -> Dwelling:
    rng = np.random.default_rng([round(100 * dwell), seed])
    offset, drift = float(rng.uniform(-8.0, 8.0)), float(rng.uniform(-8e-5, 8e-5))
    return Dwelling(dwell, relaxes=relaxes, offset=offset, drift=drift, seed=seed)


@pytest.mark.slow
@pytest.mark.parametrize("relaxes", [0.0, 0.04])
@pytest.mark.parametrize("dwell", [0.0, 0.2, 0.5, 1.0, 2.0, 5.0])
def test_offsets_hold_however_long_a_machine_waits(dwell: float, relaxes: float) -> None:
    held = 0
    for seed in range(40):
        test = dwelling(dwell, relaxes, seed)
        fit = joined(test).fit
        assert fit is not None
        held += fit.offset_interval.lower <= test.offset <= fit.offset_interval.upper
    assert held >= 34  # of 40 intervals of 95 %, as in 999 studies of 1000


@pytest.mark.parametrize("hidden", [0, 2])
def test_a_turn_that_was_not_seen_shifts_no_cycle(hidden: int) -> None:
    """Peaks are paired before those are left out whose turn the cameras missed."""
    test = Dwelling(1.0, offset=-7.3, stroke=0.012, speed=4e-3, rest=9.0)
    fit = joined(test, hidden=hidden).fit
    assert fit is not None
    assert fit.offset == pytest.approx(test.offset, abs=0.01)
    assert len(fit.event_times_motion) == 2


@pytest.mark.parametrize(("first", "last", "is_ambiguous"), [(1, 2, True), (0, 3, False)])
def test_records_that_lack_different_cycles_are_not_matched_in_silence(
    first: int, last: int, is_ambiguous: bool
) -> None:
    """The cameras began after the first peak, the force stopped before the last: two peaks each."""
    test = Dwelling(0.0, offset=2.0, seed=4)
    time, travel = test.seen_by_cameras()
    clock, force = test.seen_by_load_cell()
    begin = float(test.corners[2 * first - 1, 0]) + 8.0 if first else 0.0
    end = float(test.corners[2 * last - 1, 0]) + 8.0 if last < 3 else float(clock[-1])
    recorded = time >= begin
    match = aligned(
        Seen(
            Signal(time[recorded], travel[recorded], "m", "markers"),
            Signal(clock[clock <= end], force[clock <= end], "N", "force"),
        )
    )
    assert ("alignment_ambiguous" in str(match.doubted)) is is_ambiguous
    if is_ambiguous:
        remedy = "if the offset is known, state it: 'align: {value: {method: stated"
        assert remedy in match.doubted["clock"]


TOGETHER = AlignCommonStart.model_validate(
    {"method": "common-start", "channel": "force", "max_offset": "100 ms"}
)


def recorded_together(
    offset: float, *, noise: float = 0.01, seed: int = 0, drift: float = 0.0
) -> tuple[Signal, Signal]:
    """Motion and force: 30 s up and down again, the force bending over as it goes."""
    random = np.random.default_rng(seed)
    frame, force = np.arange(0.0, 62.0, 0.05), np.arange(0.0, 64.0, 0.005)

    def path(time: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Signal:
        travel = 0.5e-3 * np.clip(30.0 - np.abs(time - 30.0), 0.0, None)
        return Signal(time, travel, "m", "frame")

    motion, pulled = path(frame), path((force - offset) / (1.0 + drift)).values
    way = motion.values + random.normal(0.0, 2e-6, len(frame))
    load = 4.0 * (pulled / 0.015) ** 0.7 + random.normal(0.0, noise, len(force))
    return replace(motion, values=way), Signal(force, load, "N", "force")


def fitted(motion: Signal, force: Signal) -> tuple[ClockFit, Findings]:
    fit, findings = fit_common_start(force, TOGETHER, moved(motion, TOGETHER.motion_window))
    return fit, Findings() + findings


@pytest.mark.parametrize("offset", [0.04, 0.8, -0.8, None])
def test_recorders_that_start_together(offset: float | None, approved: Approve) -> None:
    """Within 100 ms a sharp corner decides; beyond them it is doubted; without one it is left."""
    motion, force = recorded_together(offset or 0.0, noise=1e-3)
    if offset is None:
        force = replace(force, values=np.linspace(0.0, 1.0, len(force.time)))
    fit, findings = fitted(motion, force)
    assert fit.offset_interval.lower <= (offset or 0.0) <= fit.offset_interval.upper
    assert fit.drift == pytest.approx(0.0, abs=1e-5)
    assert fit.drift_interval.standard_error == pytest.approx(1e-4 / np.sqrt(3.0), rel=0.05)
    notes = [f"{note.severity.value} {note.code}: {note.message}" for note in findings.notes]
    known = f"{fit.offset:.4f} s, known to {fit.offset_interval.standard_error:.4f} s"
    approved([known, *notes, " ".join(sorted(doubted(findings.entries)))])


TEST = Dwelling(1.0, offset=-3.2)


def make_stated_state(offset: str, **more: str) -> AlignStated:
    return AlignStated.model_validate(
        {"method": "stated", "offset": offset, "because": "LED in frame 512", **more}
    )


def taken(
    align: AlignStated, *, test: Dwelling = TEST, sign: float = 1.0
) -> tuple[Findings, ClockFit]:
    motion = Signal(*test.seen_by_cameras(), "m", "markers")
    time, force = test.seen_by_load_cell()
    turned = moved(motion, align.motion_window)
    fit, findings = make_stated_fit(Signal(time, sign * force, "N", "force"), align, turned)
    return Findings() + findings, fit


def test_clocks_that_are_stated(approved: Approve) -> None:
    """Without an uncertainty they are known to a sample, of 50 a second."""
    for more in ({"drift": "40 ppm", "uncertainty": "0.03 s"}, {}):
        findings, fit = taken(make_stated_state("-3.2 s", **more))
        error = 0.03 if more else 0.02
        assert (fit.offset, fit.drift) == (-3.2, 40e-6 if more else 0.0)
        assert fit.offset_interval.standard_error == pytest.approx(error)
        assert fit.to_force_time(100.0) == pytest.approx(96.804 if more else 96.8)
        assert fit.event_errors.tolist() == pytest.approx([error])
        assert fit.method == "stated: LED in frame 512"
        assert not doubted(findings.entries)
    assert fit.drift_interval.standard_error == pytest.approx(1e-4 / np.sqrt(3.0))
    approved(
        f"{note.severity.value} {note.code} of {note.where}: {note.message}"
        for note in findings.notes
    )


@pytest.mark.parametrize(
    ("offset", "uncertainty", "is_wrong"),
    [
        ("-3.2 s", "20 ms", False),
        ("-4.0 s", "20 ms", False),
        ("3.2 s", "20 ms", True),
        ("-53 s", "20 ms", True),
        ("-6 s", "2 s", False),
    ],
)
def test_a_statement_that_the_force_contradicts(
    offset: str, uncertainty: str, is_wrong: bool
) -> None:
    """A wrong sign is found, a statement that is known no better is not."""
    for sign in (1.0, -1.0):
        findings, _ = taken(make_stated_state(offset, uncertainty=uncertainty), sign=sign)
        assert set(doubted(findings.entries)) == ({"clock", "force"} if is_wrong else set())
        assert ("clocks_stated_wrong: " in str(doubted(findings.entries))) is is_wrong
    never_peaks, _ = taken(make_stated_state(offset, uncertainty=uncertainty), sign=0.0)
    assert not doubted(never_peaks.entries)
