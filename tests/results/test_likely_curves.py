"""Curves that a test may have been: their noise, corners and inputs, by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.fits.failure_point import FailurePoint
from labpipe.records.arrays import Floats
from labpipe.records.causes import (
    CLOCK_DRIFT,
    CLOCK_OFFSET,
    COMPLIANCE,
    GRIP,
    PULL,
    REPAIRED_SLIPS,
    RESOLUTION,
    SCALE_OF_DISPLACEMENT,
    SCALE_OF_FORCE,
    SECTION,
    SHAPE,
    SPAN,
    STEP,
    ZERO_OF_DISPLACEMENT,
    ZERO_OF_FORCE,
)
from labpipe.records.curve import Branch, ClockFit, Interval, Slip, SlipDecision
from labpipe.records.signals import Clocks, Signals
from labpipe.results.evidence import Evidence, Setup
from labpipe.results.likely_curves import likely_curves, loading_of, traced
from labpipe.signal.filters import Butterworth, Smoothing
from labpipe.uncertainty.intervals import Measured, measure
from labpipe.uncertainty.readings import Reading, Trace
from labpipe.uncertainty.replicates import Input, Replicates
from tests.builders.reduced import DOWN, UP, recorded

RNG = np.random.default_rng


def curves(test: Evidence) -> Replicates:
    found = likely_curves(test)
    assert found is not None
    return found


def off(found: Replicates, part: slice = slice(None)) -> Floats:
    """What the replicates of the force lie above their smooth curve, shape (replicates, n)."""
    return (found.force - found.smooth.force)[:, part]


def noise(test: Evidence, part: slice = slice(None)) -> float:
    """Standard deviation that the replicates have on a sample."""
    return float(np.nanstd(off(curves(test), part), axis=0).mean())


def top(trace: Trace) -> tuple[Floats]:
    return (np.nanmax(trace.force, axis=-1),)


def end(trace: Trace) -> tuple[Floats]:
    return (trace.force[..., 1800:].mean(axis=-1),)


def largest(test: Evidence) -> Measured:
    found = measure(curves(test), lambda trace: Reading(top, len(trace.time)))
    assert isinstance(found, tuple)
    return found[0]


def inputs(test: Evidence) -> dict[str, Input]:
    return {each.cause: each for each in curves(test).inputs}


def straight(count: int = 800, rate: float = 100.0, spread: float = 1.0, seed: int = 0) -> Evidence:
    time = np.arange(count) / rate
    force = 10.0 * time + RNG(seed).normal(0.0, spread, count)
    return recorded(time, 1e-3 * time, force)


def broken(at: int, count: int) -> Evidence:
    """To 100 N, in noise of 0.1 N, then nothing."""
    time: Floats = np.arange(float(count)) * 1e-3
    force = np.where(np.arange(count) <= at, 100.0 * np.arange(count) / at, 0.0)
    force += RNG(1).normal(0.0, 0.1, count)
    test = recorded(time, 1e-3 * time, force)
    return replace(test, failure=FailurePoint(at))


def test_without_a_curve_there_is_nothing_to_draw() -> None:
    assert likely_curves(Evidence(Signals())) is None


def test_the_trace_is_the_curve() -> None:
    sizes = Setup(length=0.3, span=0.1, section={"width": 2e-3})
    test = replace(straight(), setup=sizes)
    trace = traced(test)
    assert trace.sizes == {"length": 0.3, "span": 0.1, "width": 2e-3}
    assert np.array_equal(trace.force, test.known_curve.force)
    assert trace.failed_at is None
    assert traced(broken(50, 90)).failed_at == 50


def test_the_first_loading_ends_at_the_failure() -> None:
    trace = traced(straight())
    assert loading_of(trace) == slice(0, 800)
    assert loading_of(replace(trace, failed_at=30)) == slice(0, 31)
    assert loading_of(replace(trace, branches=())) == slice(0, 0)
    back, on = Branch(0, 9, 1, DOWN, 0.0, 1.0), Branch(9, 20, 2, UP, 1.0, 2.0)
    assert loading_of(replace(trace, branches=(back, on), failed_at=25)) == slice(9, 20)


@pytest.mark.parametrize("window", [1, 5, 21])
def test_a_moving_average_leaves_its_share_of_the_noise(window: int) -> None:
    """One over the root of the window; at the end of a line through it twice as much."""
    time = np.arange(4000) / 100.0
    force = 10.0 * time + RNG(0).normal(size=4000)
    test = recorded(time, 1e-3 * time, force, filters=((Smoothing(window), 1),))
    assert noise(test, slice(50, -50)) == pytest.approx(window**-0.5, rel=0.07)
    if window > 1:
        assert noise(test, slice(-1, None)) == pytest.approx(2.0 * window**-0.5, rel=0.25)


def test_a_low_pass_and_a_force_that_ends_before_the_motion() -> None:
    """Nothing is known behind its end; 20 1/s of 100 are kept."""
    time = np.arange(2000) / 200.0
    low = ((Butterworth(20.0, 200.0, 4), 1),)
    force = 10.0 * time[:1500] + RNG(0).normal(size=1500)
    test = recorded(time, 1e-3 * time, force, force_time=time[:1500], filters=low)
    found = curves(test)
    assert np.isnan(off(found, slice(1500, None))).all()
    assert np.isnan(found.smooth.force[1500:]).all()
    assert not np.isnan(off(found, slice(1500))).any()
    assert not np.isnan(found.smooth.displacement).any()
    assert noise(test, slice(100, 1400)) == pytest.approx(0.2**0.5, rel=0.1)


def test_filters_do_not_reach_over_a_turn() -> None:
    """A triangle of 10 N and five samples at rest: its top stays."""
    time = np.arange(605) / 100.0
    force = np.concatenate([np.linspace(0, 10, 300), np.full(5, 10.0), np.linspace(10, 0, 300)])
    force += RNG(0).normal(0.0, 1e-3, 605)
    branches = (Branch(0, 300, 1, UP, 0.0, 3.0), Branch(305, 605, 1, DOWN, 3.05, 6.04))
    test = recorded(time, 1e-3 * force, force, branches=branches, filters=((Smoothing(41), 1),))
    for trace in curves(test).traces():
        assert trace.force[:, 299:306] == pytest.approx(10.0, abs=0.02)


@pytest.mark.parametrize(
    ("window", "drawn"),
    [(1, 1.0), (11, 11**-0.5), (1001, 1001**-0.5)],
    ids=["none", "1 ms", "100 ms"],
)
def test_a_fast_force_has_the_noise_that_the_curve_has(window: int, drawn: float) -> None:
    """10 000 a second, at frames 50 a second: single samples without a filter, no means."""
    time, fast = np.arange(300) / 50.0, np.arange(60_000) / 10_000.0
    force = 10.0 * fast + RNG(3).normal(size=60_000)
    test = recorded(time, 1e-3 * time, force, force_time=fast, filters=((Smoothing(window), 1),))
    found = np.std(test.known_curve.force - 10.0 * time)
    assert found == pytest.approx(drawn, rel=0.35)
    assert noise(test, slice(10, -10)) == pytest.approx(drawn, rel=0.15)


def test_gaps_of_a_fast_force_do_not_lower_it() -> None:
    """Every third sample is missing, and three frames whole."""
    time, fast = np.arange(200) / 50.0, np.arange(40_000) / 10_000.0
    force = 100.0 + 10.0 * fast + RNG(3).normal(0.0, 0.01, 40_000)
    force[::3] = np.nan
    long = ((Smoothing(2001), 1),)
    test = recorded(time, 1e-3 * time, force, force_time=fast, filters=long)
    smooth = curves(test).smooth.force
    assert smooth[1:-1] == pytest.approx(100.0 + 10.0 * time[1:-1], abs=0.01)


def test_a_thinned_displacement_is_not_filtered_again() -> None:
    fast, rng = np.arange(3000) / 100.0, RNG(0)
    path = 1e-3 * fast + 1e-5 * rng.normal(size=3000)
    force = 10.0 * fast
    thin = ((Smoothing(9), 3),)
    branches = (Branch(0, 1000, 1, UP, 0.0, 29.97),)
    test = recorded(fast, path, force, branches=branches, filters_of_displacement=thin)
    found = curves(test)
    more = found.displacement - found.smooth.displacement
    assert np.std(more[:, 20:-20]) == pytest.approx(1e-5 / 3.0, rel=0.15)


def test_a_filtered_displacement_has_its_noise_back() -> None:
    time = np.arange(3000) / 100.0
    path = 1e-3 * time + 1e-5 * RNG(0).normal(size=3000)
    test = recorded(
        time, path, 10.0 * time, filters_of_displacement=((Smoothing(25), 1),), compliance=5e-5
    )
    found = curves(test)
    assert np.std((found.displacement - found.smooth.displacement)[:, 50:-50]) == pytest.approx(
        2e-6, rel=0.1
    )
    truth = 1e-3 * time - 5e-5 * 10.0 * time
    assert found.smooth.displacement == pytest.approx(truth, abs=1e-5)


def test_a_filtered_displacement_keeps_the_level_of_the_curve() -> None:
    """Another 5 mm were taken off the curve alone."""
    time = np.arange(3000) / 100.0
    path = 1e-3 * time + 1e-5 * RNG(0).normal(size=3000)
    test = recorded(time, path, 10.0 * time, filters_of_displacement=((Smoothing(25), 1),))
    curve = test.known_curve
    moved = replace(test, curve=replace(curve, displacement=curve.displacement - 5e-3))
    found = curves(moved)
    assert found.smooth.displacement == pytest.approx(1e-3 * time - 5e-3, abs=1e-5)


def test_a_mean_lies_around_its_frame() -> None:
    """Forces of 1000 a second at frames 50 a second, each the mean of 20: half a sample is 5 mN."""
    time, fast = np.arange(200) / 50.0, np.arange(4000) / 1000.0
    test = recorded(time, 1e-3 * time, 10.0 * fast, force_time=fast, filters=((Smoothing(201), 1),))
    assert curves(test).smooth.force[1:-1] == pytest.approx(10.0 * time[1:-1], abs=1e-3)


def test_a_force_of_which_a_part_is_unknown_leaves_the_displacement_alone() -> None:
    time = np.arange(900) / 100.0
    force = np.where(time < 6.0, 10.0 * time + RNG(0).normal(size=900), np.nan)
    test = recorded(time, 1e-3 * time, force)
    found = curves(test)
    assert found.smooth.displacement == pytest.approx(1e-3 * time, abs=1e-9)
    for given in found.inputs:
        assert not np.isnan(given.moved(found.smooth, 1.0).displacement).any()


@pytest.mark.parametrize("count", [20_000, 20_001, 50_000])
def test_a_long_record_has_the_noise_of_single_samples(count: int) -> None:
    """Its largest sample is one sample, however many there are."""
    test = straight(count, 1000.0)
    found = curves(test)
    assert len(found.smooth.time) <= 20_000
    assert found.measured is not found.smooth
    assert len(found.measured.time) == count
    assert np.std(off(found)) == pytest.approx(1.0, rel=0.03)
    assert found.smooth.force == pytest.approx(10.0 * found.smooth.time, abs=0.5)
    high = top(next(iter(found.traces())))[0].mean() - found.smooth.force.max()
    assert 0.0 < high < 4.0


def test_a_long_filtered_record_is_averaged() -> None:
    time = np.arange(60_000) / 1000.0
    force = 10.0 * time + RNG(0).normal(size=60_000)
    test = recorded(time, 1e-3 * time, force, filters=((Smoothing(101), 1),))
    assert noise(test, slice(100, -100)) == pytest.approx(101**-0.5, rel=0.1)


def test_the_largest_sample_of_a_long_plateau() -> None:
    """It is four standard deviations high; 50 000 samples in blocks of three."""
    held = 0
    for seed in range(5):
        time = np.arange(50_000) / 1000.0
        way = time / time[-1]
        force = 20.0 * (1.0 - (1.0 - way) ** 4) + RNG(seed).normal(size=50_000)
        interval = largest(recorded(time, way, force)).interval
        held += interval.lower <= 20.0 <= interval.upper
    assert held >= 3


def test_hum_is_not_folded_away() -> None:
    """Two samples a swing, taken in blocks of two: every other one would stand still."""
    time = np.arange(40_000) / 1000.0
    hum = 3.0 * np.where(np.arange(40_000) % 2 == 0, 1.0, -1.0)
    test = recorded(time, time, time + hum + 0.1 * RNG(0).normal(size=40_000))
    assert noise(test) == pytest.approx(3.0, rel=0.05)


@pytest.mark.parametrize("at", [35_000, 35_001, 35_002])
def test_no_block_lies_over_a_failure(at: int) -> None:
    """Wherever it falls in a block of three: noise and force at it are those of the loading."""
    found = curves(broken(at, 50_000))
    end = found.smooth.failed_at
    assert end is not None
    assert found.smooth.force[end] == pytest.approx(100.0, abs=0.15)
    assert found.smooth.force[end + 1] == pytest.approx(0.0, abs=0.15)
    assert found.smooth.time[end] == pytest.approx(at * 1e-3, abs=3e-3)
    assert np.std(off(found, slice(end + 1))) == pytest.approx(0.1, rel=0.1)


def test_blocks_begin_anew_at_turns() -> None:
    time = np.arange(50_001) / 1000.0
    path = np.where(time < 20.0, time, 40.0 - time)
    branches = (Branch(0, 20_000, 1, UP, 0.0, 20.0), Branch(20_001, 50_001, 1, DOWN, 20.0, 50.0))
    force = 5.0 * path + 1e-3 * RNG(0).normal(size=50_001)
    found = curves(recorded(time, path, force, branches=branches))
    up, down = found.smooth.branches
    assert (up.start, down.stop) == (0, len(found.smooth.time))
    assert down.start == up.stop + 1
    assert found.smooth.force[up.stop] == pytest.approx(5.0 * 20.0, abs=1e-2)
    assert found.smooth.displacement.max() == pytest.approx(20.0, abs=1e-9)


def slip(decision: SlipDecision, start: int, drop: float, error: float = 0.5) -> Slip:
    around = Interval.normal_95(drop, error)
    return Slip(1e-3, drop, around, around, decision, start, start + 2)


def slipped(decision: SlipDecision) -> Evidence:
    """Twice 20 N are lost within two steps, at samples 200 and 500."""
    time, losses = np.arange(800) / 100.0, np.zeros(800)
    for start in (200, 500):
        losses[start + 2 :] += 20.0
        losses[start + 1] += 10.0
    force = 30.0 * time - losses + RNG(0).normal(0.0, 0.1, 800)
    slips = tuple(slip(decision, start, 20.0) for start in (200, 500))
    test = recorded(time, 1e-3 * time, force, slips=slips)
    if decision is SlipDecision.REPAIRED:
        from labpipe.fits.grip_slips import add_back

        whole = add_back(test.known_curve.force, slips)
        return replace(test, curve=replace(test.known_curve, force=whole))
    return test


def test_what_slips_lost_is_added_back() -> None:
    test = slipped(SlipDecision.REPAIRED)
    found = curves(test)
    assert found.smooth.force == pytest.approx(30.0 * found.smooth.time, abs=0.6)
    assert noise(test) == pytest.approx(0.1, rel=0.15)


def test_marked_slips_stay_and_are_no_noise() -> None:
    test = slipped(SlipDecision.MARKED)
    found = curves(test)
    assert found.smooth.force[[200, 202]] == pytest.approx([60.0, 40.6], abs=0.3)
    assert noise(test) == pytest.approx(0.1, rel=0.3)


def test_each_repaired_slip_moves_what_follows_by_its_error() -> None:
    found = curves(slipped(SlipDecision.REPAIRED))
    first, second = (each for each in found.inputs if each.cause == REPAIRED_SLIPS)
    trace = found.smooth
    for given, behind in ((first, 202), (second, 502)):
        more = given.moved(trace, 2.0).force - trace.force
        assert more[:behind] == pytest.approx(0.0)
        assert more[behind:] == pytest.approx(2.0 * 0.5)
    assert not np.array_equal(found.draws(first), found.draws(second))
    assert REPAIRED_SLIPS not in inputs(slipped(SlipDecision.MARKED))


def test_a_cut_curve_is_unknown_behind_its_end() -> None:
    test = straight()
    curve = test.known_curve
    force = np.where(np.arange(800) < 400, curve.force, np.nan)
    branches = (replace(curve.branches[0], stop=400),)
    found = curves(replace(test, curve=replace(curve, force=force, branches=branches)))
    assert np.isnan(off(found, slice(400, None))).all()
    assert np.std(off(found, slice(400))) == pytest.approx(1.0, rel=0.15)


def uncertain(name: str, scale: float, zero: float) -> Evidence:
    """800 samples, one signal of which is uncertain."""
    test = straight()
    changed = replace(test.signals.raw[name], relative_error=scale, zero_error=zero)
    return replace(test, signals=test.signals.with_new(name, changed))


def test_what_is_exact_is_no_input() -> None:
    assert set(inputs(straight())) == {STEP}


@pytest.mark.parametrize("compliance", [0.0, 4e-5])
def test_scale_and_zero_of_the_force(compliance: float) -> None:
    """With a compliance C the displacement of the specimen is less by C of the change."""
    test = uncertain("force", 0.01, 0.3)
    found = inputs(replace(test, compliance=compliance))
    trace = curves(replace(test, compliance=compliance)).smooth
    for cause, more in ((SCALE_OF_FORCE, 0.01 * trace.force), (ZERO_OF_FORCE, 0.3)):
        moved = found[cause].moved(trace, -2.0)
        assert moved.force - trace.force == pytest.approx(-2.0 * more, abs=1e-12)
        change = moved.displacement - trace.displacement
        assert change == pytest.approx(2.0 * compliance * more, abs=1e-15)


@pytest.mark.parametrize("compliance", [0.0, 4e-5])
def test_scale_and_zero_of_the_displacement(compliance: float) -> None:
    """The scale is that of what was measured, the part of the frame with it."""
    test = uncertain("displacement", 0.01, 2e-6)
    test = replace(test, compliance=compliance)
    found, trace = inputs(test), curves(test).smooth
    moved = found[SCALE_OF_DISPLACEMENT].moved(trace, 2.0).displacement
    measured = trace.displacement + compliance * trace.force
    assert moved - trace.displacement == pytest.approx(0.02 * measured, abs=1e-15)
    moved = found[ZERO_OF_DISPLACEMENT].moved(trace, -1.0).displacement
    assert moved - trace.displacement == pytest.approx(-2e-6, abs=1e-15)


@pytest.mark.parametrize(("cause", "spread"), [(PULL, 0.02), (COMPLIANCE, 1.0)])
def test_what_an_offset_changes_frame_by_frame_has_no_noise(cause: str, spread: float) -> None:
    """A tenth more of the displacement, seen in noise of 10 um: what cameras see is made smooth."""
    test = straight()
    signal, noise = test.displacement, RNG(5).normal(0.0, 1e-5, 800)
    seen = replace(signal, moved={cause: 1.1 * signal.values + noise})
    found = curves(replace(test, signals=test.signals.with_new("displacement", seen)))
    (given,) = (each for each in found.inputs if each.cause == cause)
    change = given.moved(found.smooth, 1.0).displacement - found.smooth.displacement
    left = change - 0.1 * signal.values
    assert np.std(left) == pytest.approx(spread * 1e-5, rel=0.1, abs=2e-6)


def plateau(seed: int, level: float, step: float) -> Evidence:
    """Noise of 1 N on a way up to a level, in steps of a converter."""
    time = np.arange(2000) / 100.0
    force = level * (1.0 - (1.0 - time / 20.0) ** 4) + RNG(seed).normal(size=2000)
    return recorded(time, 1e-3 * time, step * np.round(force / step))


def test_a_converter_coarser_than_the_noise_is_an_input() -> None:
    """Steps of 7 standard deviations: the level is known to half a step, a rectangle."""
    test = plateau(0, 100.0, 7.0)
    (given,) = (each for each in curves(test).inputs if each.cause == RESOLUTION)
    trace = curves(test).smooth
    assert given.law == "uniform"
    more = given.moved(trace, 1.0).force - trace.force
    assert more == pytest.approx(7.0 / 12.0**0.5)
    held = 0
    for level in (98.0, 99.0, 100.0, 101.5, 103.0, 104.0):
        found = measure(curves(plateau(1, level, 7.0)), lambda _: Reading(end, 200))
        assert isinstance(found, tuple)
        interval = found[0].interval
        held += interval.lower <= level * (1.0 - 0.1**4 / 5.0) <= interval.upper
    assert held == 6


def test_other_records_that_stand_are_not_coarse() -> None:
    """Steps as fine as the noise; a full channel; what a spreadsheet computed."""
    at = np.arange(2000) / 100.0
    for test in (
        plateau(0, 100.0, 1.0),
        recorded(at, 1e-3 * at, np.minimum(10.0 * at, 30.0)),
        recorded(at, 1e-3 * at, np.full(2000, 3.0)),
        straight(),
    ):
        assert RESOLUTION not in inputs(test)


def test_other_displacements() -> None:
    """Of an offset normal, of another shape rectangular."""
    test = straight()
    signal = test.displacement
    other = {GRIP: signal.values + 1e-6, SHAPE: 1.01 * signal.values}
    changed = replace(signal, moved=other)
    test = replace(test, signals=test.signals.with_filtered("displacement", changed))
    found, trace = inputs(test), curves(test).smooth
    assert (found[GRIP].law, found[SHAPE].law) == ("normal", "uniform")
    moved = found[GRIP].moved(trace, -3.0).displacement - trace.displacement
    assert moved == pytest.approx(-3e-6, abs=1e-15)
    moved = found[SHAPE].moved(trace, 1.0).displacement - trace.displacement
    assert moved == pytest.approx(0.01 * signal.values, abs=1e-15)


def test_other_displacements_of_a_long_record() -> None:
    test = straight(50_000, 1000.0)
    signal = test.displacement
    changed = replace(signal, moved={GRIP: 1.5 * signal.values})
    test = replace(test, signals=test.signals.with_filtered("displacement", changed))
    found = curves(test)
    moved = inputs(test)[GRIP].moved(found.smooth, 1.0)
    assert moved.displacement == pytest.approx(1.5 * found.smooth.displacement, abs=1e-9)


def test_clocks_shift_and_turn_the_force() -> None:
    """Events at 2 s and 6 s, each known to 0.02 s: the offset to 0.014 s, the drift to 0.7 %."""
    at = np.array([2.0, 6.0])
    drift = Interval.normal_95(0.0, 0.007)
    fit = ClockFit(1.0, 0.0, drift, drift, 0.0, at, at + 1.0, at * 0.0 + 0.02, "")
    time = np.arange(800) / 100.0
    force = 10.0 * time + RNG(0).normal(0.0, 0.1, 800)
    test = recorded(time, 1e-3 * time, force, force_time=time + 1.0, clocks=Clocks("one", fit))
    found, trace = inputs(test), curves(test).smooth
    inner = slice(50, -50)
    moved = found[CLOCK_OFFSET].moved(trace, 1.0).force - trace.force
    slope = np.gradient(trace.force, trace.time)
    assert moved[inner] == pytest.approx((slope * 0.02 / 2**0.5)[inner], abs=0.01)
    moved = found[CLOCK_DRIFT].moved(trace, 1.0).force - trace.force
    turned = slope * 0.007 * (trace.time - 4.0)
    assert moved[inner] == pytest.approx(turned[inner], abs=0.02)


def test_sizes() -> None:
    setup = Setup(
        length=0.3,
        span=0.1,
        section={"width": 2e-3, "thickness": 1e-3},
        uncertainties={"span": 1e-4, "width": 1e-5, "thickness": 2e-5, "area": 1.0},
    )
    test = replace(straight(), setup=setup)
    found, trace = curves(test), curves(test).smooth
    span, width, thickness, area = (each for each in found.inputs if each.cause in (SPAN, SECTION))
    assert [each.cause for each in (span, width, thickness)] == [SPAN, SECTION, SECTION]
    assert span.moved(trace, 2.0).sizes["span"] == pytest.approx(0.1002)
    assert width.moved(trace, -1.0).sizes["width"] == pytest.approx(1.99e-3)
    assert width.moved(trace, -1.0).sizes["thickness"] == 1e-3
    assert area.moved(trace, 1.0).sizes == trace.sizes
    assert not np.array_equal(found.draws(width), found.draws(thickness))


@pytest.mark.parametrize(("count", "step"), [(800, 1.0), (40_000, 0.5)])
def test_a_step_is_one_of_the_curve(count: int, step: float) -> None:
    """In blocks of two it is half of one of the grid."""
    test = straight(count)
    given, found = inputs(test)[STEP], curves(test)
    assert given.law == "step"
    assert given.moved(found.smooth, 1.0).beyond == pytest.approx(step)
    assert given.moved(found.smooth, -0.5).beyond == pytest.approx(-0.5 * step)


def test_short_branches_and_rows() -> None:
    """Five samples, and one; time counts rows."""
    time = np.arange(600.0)
    branches = (
        Branch(0, 300, 1, UP, 0.0, 299.0),
        Branch(300, 305, 1, DOWN, 300.0, 304.0),
        Branch(306, 600, 2, UP, 306.0, 599.0),
    )
    force = 0.1 * time + RNG(0).normal(size=600)
    for act in (Smoothing(11), Butterworth(0.1, 1.0, 4)):
        test = recorded(time, 1e-3 * time, force, branches=branches, filters=((act, 1),))
        found = curves(test)
        assert np.isfinite(off(found)).all()
        assert 0.1 < noise(test) < 0.7


def test_a_branch_without_force() -> None:
    time = np.arange(600) / 100.0
    branches = (Branch(0, 300, 1, UP, 0.0, 3.0), Branch(300, 600, 1, DOWN, 3.0, 6.0))
    force = np.where(time < 3.0, 10.0 * time + RNG(0).normal(size=600), np.nan)
    found = curves(recorded(time, 1e-3 * time, force, branches=branches))
    assert np.std(off(found, slice(300))) == pytest.approx(1.0, rel=0.2)
    assert np.isnan(off(found, slice(300, None))).all()
