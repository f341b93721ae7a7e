"""The largest force in noise on the clock of the force, against plain numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, ClockFit, Direction, Interval
from labpipe.records.signals import Clocks, Signal, Signals
from labpipe.results.evidence import Evidence
from labpipe.results.force_samples import ForceSamples, Top, _frames_of, cuts_of
from labpipe.signal.filters import Smoothing
from labpipe.uncertainty.readings import Trace

RNG = np.random.default_rng
FRAME, SINGLE, TURN = 0.04, 0.01, 10.015
"""s: four samples of the force a frame; where the motion turns."""
NOISE = 0.5
"""N, of single samples: white."""
BEFORE, BEHIND = 3.0, -20.0
"""N/s, slopes on both sides of the turn."""
WINDOW = 15


def force_at(time: Floats) -> Floats:
    """A corner of 100 N."""
    return 100.0 + np.where(time < TURN, BEFORE, BEHIND) * (time - TURN)


def evidence(force: Floats, *, rate: float = SINGLE, filters: bool = True) -> Evidence:
    """A force on its own clock, that of the curve but for its name."""
    time = rate * np.arange(float(len(force)))
    signal = Signal(time, force, "N", "recorder")
    act = {"force": ((Smoothing(WINDOW), 1),)} if filters else {}
    signals = Signals(raw={"force": signal}, filtered={"force": signal}, filters=act)
    same, at = Interval(0.0, 0.0), np.array([TURN])
    joined = ClockFit(0.0, 0.0, same, same, 0.0, at, at, 0.01 * at, "by turns")
    return Evidence(signals, Clocks("cameras", joined), unfiltered=signal)


def curve() -> Trace:
    """The corner without noise, a frame each 0.04 s, up and down."""
    time = FRAME * np.arange(501.0) + 1.5 * SINGLE
    turn = int(np.searchsorted(time, TURN))
    up = Branch(0, turn, 1, Direction.LOADING, float(time[0]), float(time[turn]))
    down = Branch(turn, 501, 1, Direction.UNLOADING, float(time[turn]), float(time[-1]))
    return Trace(time, time, force_at(time), (up, down))


def plainly_smoothed(rows: Floats) -> Floats:
    """Means of 15 samples, at both ends the straight line through the outermost 15."""
    half, count = WINDOW // 2, rows.shape[1]
    found = np.array([np.convolve(row, np.ones(WINDOW) / WINDOW, "same") for row in rows])
    number = np.arange(WINDOW)
    for row, made in zip(rows, found, strict=True):
        for part, end in (
            (slice(WINDOW), slice(half)),
            (slice(count - WINDOW, None), slice(-half, None)),
        ):
            line = np.polyval(np.polyfit(number, row[part], 1), number)
            made[end] = np.clip(line[end], row[part].min(), row[part].max())
    return found


def top_of(samples: ForceSamples | None, trace: Trace, sense: float = 1.0) -> Top:
    """The only cycle."""
    assert samples is not None
    found = samples.of_cycle(trace, slice(0, 501), sense)
    assert found is not None
    return found


def test_the_largest_of_all_samples_in_noise() -> None:
    """Mean and spread as those of the noise itself, filtered on either side of the corner."""
    time = SINGLE * np.arange(float(2000))
    noisy = force_at(time) + NOISE * RNG(0).normal(size=2000)
    trace = curve()
    samples = ForceSamples.of(evidence(noisy), trace)
    assert samples is not None
    of_frames = 0.5 * NOISE * RNG(1).normal(size=(4000, 501))
    raised = top_of(samples, trace).raised(of_frames)
    assert raised is not None

    near = slice(900, 1100)
    rows = force_at(time)[near] + NOISE * RNG(2).normal(size=(4000, 200))
    (cut,) = set(samples.cuts) - {0, 2000, int(np.searchsorted(time, trace.time[-1], "right")), 2}
    parts = [plainly_smoothed(each) for each in (rows[:, : cut - 900], rows[:, cut - 900 :])]
    by_hand = np.hstack(parts).max(axis=1) - samples.smooth.max()
    assert np.mean(raised) == pytest.approx(np.mean(by_hand), abs=0.12 * float(np.std(by_hand)))
    assert np.std(raised) == pytest.approx(np.std(by_hand), rel=0.06)


def test_a_push_is_as_large_as_a_pull() -> None:
    time = SINGLE * np.arange(float(2000))
    noisy = force_at(time) + NOISE * RNG(0).normal(size=2000)
    pull = top_of(ForceSamples.of(evidence(noisy), curve()), curve())
    trace = replace(curve(), force=-curve().force)
    push = top_of(ForceSamples.of(evidence(-noisy), trace), trace, -1.0)
    noise = 0.5 * NOISE * RNG(1).normal(size=(50, 501))
    found = [pull.raised(noise), push.raised(-noise)]
    assert found[0] is not None
    assert found[1] is not None
    # Other stretches of the record go with them, so they are alike on average.
    assert np.mean(found[0]) == pytest.approx(np.mean(found[1]), abs=0.4 * float(np.std(found[0])))


def test_without_noise_nothing_is_raised() -> None:
    """But for what the filter takes off a corner: nothing, as it ends there."""
    samples = ForceSamples.of(evidence(force_at(SINGLE * np.arange(float(2000)))), curve())
    assert samples is not None
    raised = top_of(samples, curve()).raised(np.zeros((3, 501)))
    assert raised == pytest.approx(np.zeros(3), abs=0.02)
    assert samples.smooth.max() == pytest.approx(100.0, abs=BEFORE * FRAME)


@pytest.mark.parametrize(("rate", "filters"), [(0.03, True), (SINGLE, False)])
def test_where_the_curve_has_as_many(rate: float, filters: bool) -> None:
    """Hardly more samples than frames, or none that is filtered."""
    force = force_at(rate * np.arange(np.round(20.0 / rate)))
    assert ForceSamples.of(evidence(force, rate=rate, filters=filters), curve()) is None


def test_a_plateau_that_is_too_long_is_left_to_the_curve() -> None:
    time = 5e-4 * np.arange(40_000.0)
    noisy = 100.0 + NOISE * RNG(0).normal(size=len(time))
    trace = replace(curve(), force=np.full(501, 100.0))
    samples = ForceSamples.of(evidence(noisy, rate=5e-4), trace)
    assert top_of(samples, trace).raised(np.zeros((2, 501))) is None


def test_a_cycle_with_a_gap_is_left_to_the_curve() -> None:
    trace = curve()
    samples = ForceSamples.of(evidence(force_at(SINGLE * np.arange(float(2000)))), trace)
    assert samples is not None
    trace.force[100] = np.nan
    assert samples.of_cycle(trace, slice(0, 501), 1.0) is None
    assert samples.of_cycle(trace, slice(101, 501), 1.0) is not None


def test_each_sample_belongs_to_the_frame_that_is_nearest() -> None:
    """At a border between two frames to the earlier one."""
    time = np.array([-1.0, 0.0, 0.4, 0.5, 0.6, 1.5, 2.4, 2.6, 9.0])
    found = _frames_of(time, np.array([0.0, 1.0, 2.0, 3.0]))
    assert found.tolist() == [0, 0, 0, 0, 1, 1, 2, 3, 3]


def test_pieces_begin_behind_the_time_of_a_turn() -> None:
    """A clock that is 1 s ahead: at 10.0 s of the curve it says 11.0 s, its sample 1100."""
    same, at = Interval(1.0, 1.0), np.array([TURN])
    joined = ClockFit(1.0, 0.0, same, same, 0.0, at, at + 1.0, 0.01 * at, "by turns")
    signal = Signal(SINGLE * np.arange(float(2000)), np.zeros(2000), "N", "recorder")
    assert cuts_of(Clocks("cameras", joined), [10.004, 12.0], signal) == [1101, 1301]
