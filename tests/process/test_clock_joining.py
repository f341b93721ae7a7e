"""Joining two clocks on triangles: a motion in m, a force in N on a clock of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from labpipe.process.clock_joining import align_clocks
from labpipe.process.motion import check_turns, turning_points
from labpipe.protocol.schema import AlignTurningPoints
from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import ClockFit
from labpipe.records.quality import Findings, Reason
from labpipe.records.signals import Signal
from labpipe.signal.clock_alignment import Repeat
from labpipe.signal.turning_points import Stroke, find_strokes
from tests.builders.doubts import doubted
from tests.builders.dwelling_tests import Dwelling

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
        known = self.force.values if values is None else values
        return replace(
            self, force=replace(self.force, time=self.force.time[part], values=known[part])
        )

    @property
    def strokes(self) -> tuple[Stroke, ...]:
        return find_strokes(self.travel.time, self.travel.values, min_stroke=0.01)


@dataclass(frozen=True)
class Joined:
    """The clocks of a test, and what was found on the way."""

    fit: ClockFit | None
    findings: Findings

    @property
    def doubted(self) -> dict[str, str]:
        return doubted(self.findings.found)


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
    turns = turning_points(made.travel, made.strokes, window=window)
    fit, found = align_clocks(made.force, align, made.travel, made.strokes, turns)
    return Joined(fit, Findings() + found)


@pytest.mark.parametrize("cycles", [2, 3, 5])
def test_offset_and_drift(cycles: int) -> None:
    found = aligned(seen(cycles))
    assert found.fit is not None
    assert found.fit.offset == pytest.approx(OFFSET, abs=3e-3)
    assert found.fit.drift == pytest.approx(DRIFT, abs=6e-5)
    assert len(found.fit.event_times_motion) == cycles
    assert ("repeated cycle" in found.fit.method) == (cycles > 2)
    assert not found.doubted


def test_drift_that_is_too_large() -> None:
    found = aligned(seen(3, drift=2e-3))
    assert found.doubted["clock"].startswith("alignment_drift: the clocks drift by ")
    assert found.doubted["clock"].endswith("the protocol allows 500 ppm")


def test_drift_that_noise_explains_is_not_doubted() -> None:
    found = aligned(seen(2, noise=0.05))
    assert found.fit is not None
    assert "alignment_drift" not in str(found.doubted)


def test_residual_that_is_too_large() -> None:
    """The recorder of the force lost 60 ms between the first turn and the second."""
    made = seen(3)
    lost = 0.06 * (made.force.time > OFFSET + 25.0)
    found = aligned(replace(made, force=replace(made.force, time=made.force.time - lost)))
    assert found.doubted["clock"].startswith("alignment_residual: the clocks agree to ")


def test_residual_that_noise_explains_is_not_doubted() -> None:
    """Below a limit of nothing at all, but no more than the turns leave open."""
    found = aligned(seen(3), ALIGN.model_copy(update={"max_residual": 1e-9}))
    assert found.fit is not None
    assert found.fit.residual > 1e-6
    assert not found.doubted


def test_one_event() -> None:
    found = aligned(seen(1))
    assert found.fit is not None
    assert found.fit.drift == 0.0
    assert found.doubted["clock"].startswith("alignment_one_event: ")


def test_constant_force() -> None:
    made = seen(2)
    found = aligned(made.with_force(values=np.full(len(made.force.time), 0.25)))
    assert found.fit is None
    assert found.findings.blocked == Reason("constant_channel", "the force is constant at 0.25 N")


def test_force_that_saw_no_peak() -> None:
    found = aligned(seen(2).with_force(slice(0, 1000)))
    assert found.fit is None
    assert found.findings.blocked is not None
    assert found.findings.blocked.code == "no_common_peak"


def test_force_that_saw_only_the_last_cycles() -> None:
    """The recorder was started late: pairs that fit equally well are reported as ambiguous."""
    made = seen(3)
    found = aligned(made.with_force(np.asarray(made.force.time > 20.0)))
    assert found.fit is not None
    assert found.doubted["clock"].startswith("alignment_ambiguous: another pairing")


@pytest.mark.parametrize(("lag", "is_used"), [(20.0, True), (20.2, False)])
def test_cycles_that_are_not_alike_are_joined_by_their_turns_alone(
    monkeypatch: pytest.MonkeyPatch, lag: float, is_used: bool
) -> None:
    monkeypatch.setattr(
        "labpipe.process.clock_joining._repeat", lambda *_: Repeat(20.0, lag * (1.0 + DRIFT), 1e-3)
    )
    found = aligned(seen(3), window=ALIGN.motion_window)
    assert found.fit is not None
    assert ("repeated" in found.fit.method) is is_used
    assert found.fit.offset == pytest.approx(OFFSET, abs=5e-3)
    said = [note.message for note in found.findings.notes if note.code == "cycles_not_alike"]
    assert len(said) == (not is_used)
    if said:
        assert said[0].startswith("the force of the last cycle lies 20.202 s behind that of the")
        assert said[0].endswith("not alike, and the turning points alone join the clocks")


def joined(test: Dwelling, *, hidden: int | None = None) -> Joined:
    """Both records of a test, their clocks joined; one turn of the motion hidden."""
    time, travel = test.seen_by_cameras()
    if hidden is not None:
        turn = test.corners[hidden, 1] + 0.5 * test.dwell
        travel[np.abs(time - turn) < 0.5 * test.dwell + 0.6] = np.nan
    motion = Signal(time, travel, "m", "markers")
    force = Signal(*test.seen_by_load_cell(), "N", "force")
    strokes = find_strokes(motion.time, motion.values, min_stroke=5e-3)
    turns = turning_points(motion, strokes, window=25.0)
    align = ALIGN.model_copy(update={"max_residual": 10e-3})
    fit, found = align_clocks(force, align, motion, strokes, turns)
    return Joined(fit, Findings() + found + check_turns(motion, strokes, turns))


def dwelling(dwell: float, relaxes: float, seed: int) -> Dwelling:
    rng = np.random.default_rng([round(100 * dwell), seed])
    offset, drift = float(rng.uniform(-8.0, 8.0)), float(rng.uniform(-8e-5, 8e-5))
    return Dwelling(dwell, relaxes=relaxes, offset=offset, drift=drift, seed=seed)


@pytest.mark.slow
@pytest.mark.parametrize("relaxes", [0.0, 0.04])
@pytest.mark.parametrize("dwell", [0.0, 0.2, 0.5, 1.0, 2.0, 5.0])
def test_a_machine_that_waits_at_its_turns(dwell: float, relaxes: float) -> None:
    """Whatever the offset, whether the force relaxes or not: one event for each peak."""
    for seed in range(2):
        test = dwelling(dwell, relaxes, seed)
        made = joined(test)
        fit = made.fit
        assert fit is not None
        off, error = fit.offset - test.offset, fit.offset_interval.standard_error
        assert abs(off) < 3.5 * error < 0.03
        assert len(fit.event_times_motion) == 3
        assert not made.doubted
        if relaxes == 0.0 or dwell == 0.0:
            assert "repeated cycle" in fit.method
        elif dwell >= 1.0:
            assert "repeated cycle" not in fit.method


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


@pytest.mark.parametrize("hidden", [0, 2, 4])
def test_a_turn_that_was_not_seen_shifts_no_cycle(hidden: int) -> None:
    """Peaks are paired before those are left out whose turn the cameras missed."""
    test = Dwelling(1.0, offset=-7.3, stroke=0.012, speed=4e-3, rest=9.0)
    fit = joined(test, hidden=hidden).fit
    assert fit is not None
    assert fit.offset == pytest.approx(test.offset, abs=0.01)
    assert len(fit.event_times_motion) == 2


def test_a_wait_that_relaxes_faster_than_it_unloads() -> None:
    """Both corners of the force have one time: the steep one is not taken for the other."""
    test = Dwelling(0.5, relaxes=0.1, offset=4.2, seed=3)
    fit = joined(test).fit
    assert fit is not None
    assert fit.offset == pytest.approx(test.offset, abs=0.012)


@pytest.mark.parametrize(("first", "last", "said"), [(1, 2, True), (0, 3, False)])
def test_records_that_lack_different_cycles_are_not_matched_in_silence(
    first: int, last: int, said: bool
) -> None:
    """The cameras began after the first peak, the force stopped before the last: two peaks each."""
    test = Dwelling(0.0, offset=2.0, seed=4)
    time, travel = test.seen_by_cameras()
    clock, force = test.seen_by_load_cell()
    begin = float(test.corners[2 * first - 1, 0]) + 8.0 if first else 0.0
    end = float(test.corners[2 * last - 1, 0]) + 8.0 if last < 3 else float(clock[-1])
    kept = time >= begin
    found = aligned(
        Seen(
            Signal(time[kept], travel[kept], "m", "markers"),
            Signal(clock[clock <= end], force[clock <= end], "N", "force"),
        )
    )
    assert ("alignment_ambiguous" in str(found.doubted)) is said
    if said:
        known = "if you know the offset, state it: 'align: {value: {method: stated"
        assert known in found.doubted["clock"]
