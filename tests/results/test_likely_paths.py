from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.causes import (
    CLOCK_DRIFT,
    CLOCK_OFFSET,
    COMPLIANCE,
    DRIFT_OF_ZERO,
    GRIP,
    PULL,
    REPAIRED_SLIPS,
    RESOLUTION_OF_DISPLACEMENT,
    RESOLUTION_OF_FORCE,
    SCALE_OF_DISPLACEMENT,
    SCALE_OF_FORCE,
    SECTION,
    SHAPE,
    SPAN,
    STEP,
    ZERO_OF_DISPLACEMENT,
    ZERO_OF_FORCE,
)
from labpipe.records.curve import Branch, ClockFit, Direction, Interval, Slip, SlipDecision
from labpipe.records.signals import Clocks, Signal, Signals
from labpipe.results.curves import (
    SampleNoise,
    _filter_records,
    _find_zero_time,
    add_slips_back,
    find_piece_starts,
    make_trace,
    replicate_curves,
    select_first_loading,
)
from labpipe.results.kinds import FailurePoint, ReducedTest, Setup
from labpipe.signal.filters import Butterworth, Smoothing
from labpipe.uncertainty.intervals import measure_numbers
from labpipe.uncertainty.replicates import Extractor, Input, Replicates, Trace
from tests.builders.plain_records import Numbers
from tests.builders.reduced import DOWN, UP, recorded

RNG = np.random.default_rng


def curves(test: ReducedTest) -> Replicates:
    replicates = replicate_curves(test)
    assert replicates is not None
    return replicates


def off(found: Replicates, part: slice = slice(None)) -> Floats:
    """What the replicates of the force lie above their smooth curve, shape (replicates, n)."""
    return (found.force - found.smooth_trace.force)[:, part]


def noise(test: ReducedTest, part: slice = slice(None)) -> float:
    """Standard deviation that the replicates have on a sample."""
    return float(np.nanstd(off(curves(test), part), axis=0).mean())


def top(trace: Trace) -> tuple[Floats]:
    return (np.nanmax(trace.force, axis=-1),)


def end(trace: Trace) -> tuple[Floats]:
    return (trace.force[..., 1800:].mean(axis=-1),)


def inputs(test: ReducedTest) -> dict[str, Input]:
    return {curve.cause: curve for curve in curves(test).inputs}


def straight(
    count: int = 800, rate: float = 100.0, spread: float = 1.0, seed: int = 0
) -> ReducedTest:
    time = np.arange(count) / rate
    force = 10.0 * time + RNG(seed).normal(0.0, spread, count)
    return recorded(time, 1e-3 * time, force)


def broken(at: int, count: int) -> ReducedTest:
    """To 100 N, in noise of 0.1 N, then nothing."""
    time: Floats = np.arange(float(count)) * 1e-3
    force = np.where(np.arange(count) <= at, 100.0 * np.arange(count) / at, 0.0)
    force += RNG(1).normal(0.0, 0.1, count)
    test = recorded(time, 1e-3 * time, force)
    return replace(test, failure=FailurePoint(at))


def test_the_first_loading_ends_at_the_failure() -> None:
    trace = make_trace(straight())
    assert select_first_loading(trace) == slice(0, 800)
    assert select_first_loading(replace(trace, failed_at=30)) == slice(0, 31)
    assert select_first_loading(replace(trace, branches=())) == slice(0, 0)
    back, on = Branch(0, 9, 1, DOWN, 0.0, 1.0), Branch(9, 20, 2, UP, 1.0, 2.0)
    assert select_first_loading(replace(trace, branches=(back, on), failed_at=25)) == slice(9, 20)


@pytest.mark.parametrize("window", [1, 21])
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
    replicates = curves(test)
    assert np.isnan(off(replicates, slice(1500, None))).all()
    assert np.isnan(replicates.smooth_trace.force[1500:]).all()
    assert not np.isnan(off(replicates, slice(1500))).any()
    assert not np.isnan(replicates.smooth_trace.displacement).any()
    assert noise(test, slice(100, 1400)) == pytest.approx(0.2**0.5, rel=0.1)


def test_filters_do_not_reach_over_a_turn() -> None:
    """A triangle of 10 N and five samples at rest: its top stays."""
    time = np.arange(605) / 100.0
    force = np.concatenate([np.linspace(0, 10, 300), np.full(5, 10.0), np.linspace(10, 0, 300)])
    force += RNG(0).normal(0.0, 1e-3, 605)
    branches = (Branch(0, 300, 1, UP, 0.0, 3.0), Branch(305, 605, 1, DOWN, 3.05, 6.04))
    test = recorded(time, 1e-3 * force, force, branches=branches, filters=((Smoothing(41), 1),))
    for trace in curves(test).iterate_traces():
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
    deviation = np.std(test.required_curve.force - 10.0 * time)
    assert deviation == pytest.approx(drawn, rel=0.35)
    assert noise(test, slice(10, -10)) == pytest.approx(drawn, rel=0.15)


def test_a_filtered_displacement_has_its_noise_back_and_the_level_of_the_curve() -> None:
    """Another 5 mm were taken off the curve alone."""
    time = np.arange(3000) / 100.0
    path = 1e-3 * time + 1e-5 * RNG(0).normal(size=3000)
    filters = ((Smoothing(25), 1),)
    test = recorded(time, path, 10.0 * time, filters_of_displacement=filters, compliance=5e-5)
    curve = test.required_curve
    moved = replace(test, curve=replace(curve, displacement=curve.displacement - 5e-3))
    drawn = curves(moved)
    noise_of_path = (drawn.displacement - drawn.smooth_trace.displacement)[:, 50:-50]
    assert np.std(noise_of_path) == pytest.approx(2e-6, rel=0.1)
    truth = 1e-3 * time - 5e-5 * 10.0 * time - 5e-3
    assert drawn.smooth_trace.displacement == pytest.approx(truth, abs=1e-5)


def test_a_mean_lies_around_its_frame() -> None:
    """Forces of 1000 a second at frames 50 a second, each the mean of 20: half a sample is 5 mN."""
    time, fast = np.arange(200) / 50.0, np.arange(4000) / 1000.0
    test = recorded(time, 1e-3 * time, 10.0 * fast, force_time=fast, filters=((Smoothing(201), 1),))
    assert curves(test).smooth_trace.force[1:-1] == pytest.approx(10.0 * time[1:-1], abs=1e-3)


def test_a_force_of_which_a_part_is_unknown_leaves_the_displacement_alone() -> None:
    time = np.arange(900) / 100.0
    force = np.where(time < 6.0, 10.0 * time + RNG(0).normal(size=900), np.nan)
    test = recorded(time, 1e-3 * time, force)
    replicates = curves(test)
    assert replicates.smooth_trace.displacement == pytest.approx(1e-3 * time, abs=1e-9)
    for quantity in replicates.inputs:
        assert not np.isnan(quantity.perturb(replicates.smooth_trace, 1.0).displacement).any()


def test_a_long_record_has_the_noise_of_its_means_and_peaks_that_of_single_samples() -> None:
    """Blocks of three samples of 1 N."""
    test = straight(18_000, 1000.0)
    replicates = curves(test)
    trace = replicates.smooth_trace
    assert (len(trace.time), len(replicates.measured_trace.time)) == (6000, 18_000)
    assert np.std(off(replicates)) == pytest.approx(3**-0.5, rel=0.03)
    assert trace.force == pytest.approx(10.0 * trace.time, abs=0.5)
    samples = SampleNoise.select(test, trace, "force", slice(0, 6000), 5999)
    assert samples is not None
    assert np.std(samples.deviations) == pytest.approx((2 / 3) ** 0.5, rel=0.03)


def test_blocks_begin_anew_at_turns() -> None:
    time = np.arange(50_001) / 1000.0
    path = np.where(time < 20.0, time, 40.0 - time)
    branches = (Branch(0, 20_000, 1, UP, 0.0, 20.0), Branch(20_001, 50_001, 1, DOWN, 20.0, 50.0))
    force = 5.0 * path + 1e-3 * RNG(0).normal(size=50_001)
    replicates = curves(recorded(time, path, force, branches=branches))
    up, down = replicates.smooth_trace.branches
    assert (up.start, down.stop) == (0, len(replicates.smooth_trace.time))
    assert down.start == up.stop + 1
    assert replicates.smooth_trace.force[up.stop] == pytest.approx(5.0 * 20.0, abs=1e-2)
    assert replicates.smooth_trace.displacement.max() == pytest.approx(20.0, abs=1e-9)


def slipped(decision: SlipDecision) -> ReducedTest:
    """Twice 20 N are lost within two steps, at samples 200 and 500."""
    time, losses = np.arange(800) / 100.0, np.zeros(800)
    for start in (200, 500):
        losses[start + 2 :] += 20.0
        losses[start + 1] += 10.0
    force = 30.0 * time - losses + RNG(0).normal(0.0, 0.1, 800)
    drop = Interval.make_normal(20.0, 0.5)
    slips = tuple(Slip(1e-3, 20.0, drop, drop, decision, start, start + 2) for start in (200, 500))
    test = recorded(time, 1e-3 * time, force, slips=slips)
    if decision is SlipDecision.REPAIRED:
        whole = add_slips_back(test.required_curve.force, slips)
        return replace(test, curve=replace(test.required_curve, force=whole))
    return test


def test_what_slips_lost_is_added_back_where_they_are_repaired() -> None:
    """Marked ones stay; neither is noise."""
    repaired, marked = map(slipped, (SlipDecision.REPAIRED, SlipDecision.MARKED))
    smooth = curves(repaired).smooth_trace
    assert smooth.force == pytest.approx(30.0 * smooth.time, abs=0.6)
    assert noise(repaired) == pytest.approx(0.1, rel=0.15)
    assert curves(marked).smooth_trace.force[[200, 202]] == pytest.approx([60.0, 40.6], abs=0.3)
    assert noise(marked) == pytest.approx(0.1, rel=0.3)
    assert REPAIRED_SLIPS not in inputs(marked)


def test_each_repaired_slip_moves_what_follows_by_its_error() -> None:
    replicates = curves(slipped(SlipDecision.REPAIRED))
    first, second = (finding for finding in replicates.inputs if finding.cause == REPAIRED_SLIPS)
    trace = replicates.smooth_trace
    for quantity, start in ((first, 202), (second, 502)):
        more = quantity.perturb(trace, 2.0).force - trace.force
        assert more[:start] == pytest.approx(0.0)
        assert more[start:] == pytest.approx(2.0 * 0.5)
    assert not np.array_equal(replicates.draw_errors(first), replicates.draw_errors(second))


def uncertain(name: str, scale: float, zero: float) -> ReducedTest:
    """800 samples, one signal of which is uncertain."""
    test = straight()
    changed = replace(test.signals.raw[name], relative_error=scale, zero_error=zero)
    return replace(test, signals=test.signals.add_signal(name, changed))


@pytest.mark.parametrize("compliance", [0.0, 4e-5])
def test_scale_and_zero_of_the_force(compliance: float) -> None:
    """With a compliance C the displacement of the specimen is less by C of the change."""
    test = uncertain("force", 0.01, 0.3)
    by_cause = inputs(replace(test, compliance=compliance))
    trace = curves(replace(test, compliance=compliance)).smooth_trace
    for cause, more in ((SCALE_OF_FORCE, 0.01 * trace.force), (ZERO_OF_FORCE, 0.3)):
        moved = by_cause[cause].perturb(trace, -2.0)
        assert moved.force - trace.force == pytest.approx(-2.0 * more, abs=1e-12)
        change = moved.displacement - trace.displacement
        assert change == pytest.approx(2.0 * compliance * more, abs=1e-15)


@pytest.mark.parametrize("compliance", [0.0, 4e-5])
def test_scale_and_zero_of_the_displacement(compliance: float) -> None:
    """The scale is that of what was measured, the part of the frame with it."""
    test = uncertain("displacement", 0.01, 2e-6)
    test = replace(test, compliance=compliance)
    by_cause, trace = inputs(test), curves(test).smooth_trace
    moved = by_cause[SCALE_OF_DISPLACEMENT].perturb(trace, 2.0).displacement
    measured = trace.displacement + compliance * trace.force
    assert moved - trace.displacement == pytest.approx(0.02 * measured, abs=1e-15)
    moved = by_cause[ZERO_OF_DISPLACEMENT].perturb(trace, -1.0).displacement
    assert moved - trace.displacement == pytest.approx(-2e-6, abs=1e-15)


@pytest.mark.parametrize(("cause", "spread"), [(PULL, 0.02), (COMPLIANCE, 1.0)])
def test_what_an_offset_changes_frame_by_frame_has_no_noise(cause: str, spread: float) -> None:
    """A tenth more of the displacement, seen in noise of 10 um: what cameras see is made smooth."""
    test = straight()
    signal, noise = test.displacement, RNG(5).normal(0.0, 1e-5, 800)
    path = replace(signal, variants={cause: 1.1 * signal.values + noise})
    replicates = curves(replace(test, signals=test.signals.add_signal("displacement", path)))
    (quantity,), trace = [x for x in replicates.inputs if x.cause == cause], replicates.smooth_trace
    change = quantity.perturb(trace, 1.0).displacement - trace.displacement
    change -= 0.1 * signal.values
    assert np.std(change) == pytest.approx(spread * 1e-5, rel=0.1, abs=2e-6)


def plateau(seed: int, level: float, step: float) -> ReducedTest:
    """Noise of 1 N on a way up to a level, in steps of a converter."""
    time = np.arange(2000) / 100.0
    force = level * (1.0 - (1.0 - time / 20.0) ** 4) + RNG(seed).normal(size=2000)
    return recorded(time, 1e-3 * time, step * np.round(force / step))


def test_a_converter_coarser_than_the_noise_is_an_input() -> None:
    """Steps of 7 standard deviations: the level is known to half a step, a rectangle."""
    test = plateau(0, 100.0, 7.0)
    (quantity,) = (curve for curve in curves(test).inputs if curve.cause == RESOLUTION_OF_FORCE)
    trace = curves(test).smooth_trace
    assert quantity.distribution == "uniform"
    more = quantity.perturb(trace, 1.0).force - trace.force
    assert more == pytest.approx(7.0 / 12.0**0.5)
    for level in (98.0, 101.5, 104.0):
        numbers = measure_numbers(curves(plateau(1, level, 7.0)), lambda _: Extractor(end, 200))
        assert isinstance(numbers, tuple)
        interval = numbers[0].interval
        assert interval.lower <= level * (1.0 - 0.1**4 / 5.0) <= interval.upper


def test_the_steps_of_a_displacement_held_at_a_lower_rate_are_an_input() -> None:
    """Held over 20 samples, it lags by up to one step of 20 um: a rectangle about half a step."""
    time = np.arange(2000) / 100.0
    held = (np.arange(2000) // 20 * 20).astype(np.float64) * 1e-6
    test = recorded(time, held, 1e5 * 1e-6 * np.arange(2000) + RNG(2).normal(size=2000))
    by_cause, trace = inputs(test), curves(test).smooth_trace
    resolution = by_cause[RESOLUTION_OF_DISPLACEMENT]
    assert resolution.distribution == "uniform"
    moved = resolution.perturb(trace, 1.0).displacement - trace.displacement
    assert moved == pytest.approx(20e-6 / 12.0**0.5)
    assert RESOLUTION_OF_FORCE not in by_cause


@pytest.mark.parametrize(("count", "rate"), [(800, 100.0), (21_000, 1000.0)])
def test_other_displacements(count: int, rate: float) -> None:
    """Of an offset normal, of another shape rectangular; of a long record averaged, too."""
    test = straight(count, rate)
    signal = test.displacement
    changed = replace(signal, variants={GRIP: signal.values + 1e-6, SHAPE: 1.01 * signal.values})
    test = replace(test, signals=test.signals.replace_filtered("displacement", changed))
    by_cause, trace = inputs(test), curves(test).smooth_trace
    assert (by_cause[GRIP].distribution, by_cause[SHAPE].distribution) == ("normal", "uniform")
    moved = by_cause[GRIP].perturb(trace, -3.0).displacement - trace.displacement
    assert moved == pytest.approx(-3e-6, abs=1e-12)
    moved = by_cause[SHAPE].perturb(trace, 1.0).displacement
    assert moved == pytest.approx(1.01 * trace.displacement, abs=1e-9)


def test_clocks_shift_and_turn_the_force() -> None:
    """Events at 2 s and 6 s, each known to 0.02 s: the offset to 0.014 s, the drift to 0.7 %."""
    at = np.array([2.0, 6.0])
    drift = Interval.make_normal(0.0, 0.007)
    fit = ClockFit(1.0, 0.0, drift, drift, 0.0, at, at + 1.0, at * 0.0 + 0.02, "")
    time = np.arange(800) / 100.0
    force = 10.0 * time + RNG(0).normal(0.0, 0.1, 800)
    test = recorded(time, 1e-3 * time, force, force_time=time + 1.0, clocks=Clocks("one", fit))
    by_cause, trace = inputs(test), curves(test).smooth_trace
    inner = slice(50, -50)
    moved = by_cause[CLOCK_OFFSET].perturb(trace, 1.0).force - trace.force
    slope = np.gradient(trace.force, trace.time)
    assert moved[inner] == pytest.approx((slope * 0.02 / 2**0.5)[inner], abs=0.01)
    moved = by_cause[CLOCK_DRIFT].perturb(trace, 1.0).force - trace.force
    turned = slope * 0.007 * (trace.time - 4.0)
    assert moved[inner] == pytest.approx(turned[inner], abs=0.02)


def test_sizes() -> None:
    setup = Setup(
        sizes={"length": 0.3, "span": 0.1, "width": 2e-3, "thickness": 1e-3},
        uncertainties={"span": 1e-4, "width": 1e-5, "thickness": 2e-5, "area": 1.0},
    )
    test = replace(straight(), setup=setup)
    replicates, trace = curves(test), curves(test).smooth_trace
    span, width, thickness, area = (
        finding for finding in replicates.inputs if finding.cause in (SPAN, SECTION)
    )
    assert [quantity.cause for quantity in (span, width, thickness)] == [SPAN, SECTION, SECTION]
    assert span.perturb(trace, 2.0).sizes["span"] == pytest.approx(0.1002)
    assert width.perturb(trace, -1.0).sizes["width"] == pytest.approx(1.99e-3)
    assert width.perturb(trace, -1.0).sizes["thickness"] == 1e-3
    assert area.perturb(trace, 1.0).sizes == trace.sizes
    assert not np.array_equal(replicates.draw_errors(width), replicates.draw_errors(thickness))


@pytest.mark.parametrize(("count", "step"), [(800, 1.0), (18_000, 1 / 3)])
def test_a_step_is_one_of_the_curve(count: int, step: float) -> None:
    """In blocks of three it is a third of one of the grid."""
    test = straight(count)
    quantity, drawn = inputs(test)[STEP], curves(test)
    assert quantity.distribution == "step"
    ends = [quantity.perturb(drawn.smooth_trace, x).steps_to_event for x in (1.0, -0.5)]
    assert ends == pytest.approx([step, -0.5 * step], rel=1e-3)


def test_a_branch_without_force() -> None:
    time = np.arange(600) / 100.0
    branches = (Branch(0, 300, 1, UP, 0.0, 3.0), Branch(300, 600, 1, DOWN, 3.0, 6.0))
    force = np.where(time < 3.0, 10.0 * time + RNG(0).normal(size=600), np.nan)
    replicates = curves(recorded(time, 1e-3 * time, force, branches=branches))
    assert np.std(off(replicates, slice(300))) == pytest.approx(1.0, rel=0.2)
    assert np.isnan(off(replicates, slice(300, None))).all()


SHARE, PEAK, WAY, COUNT = 0.01, 80.0, 8e-3, 2001


PLACES = np.pi * np.array([0.5, 1.5, 2.5])


"""Of the first three modes of a random walk."""


SCALE = SHARE * PEAK / np.sqrt(np.sum(PLACES**-2.0))


def straight_of_drift(share: float = SHARE, spread: float = 0.0) -> ReducedTest:
    """80 N along 8 mm in 20 s, from its zero on."""
    tau = np.linspace(0.0, 1.0, COUNT)
    force = PEAK * tau + np.random.default_rng(0).normal(0.0, spread, COUNT)
    return drifting(recorded(20.0 * tau, WAY * tau, force), share)


def drifting(test: ReducedTest, share: float) -> ReducedTest:
    raw = replace(test.signals.raw["force"], zero_drift=share)
    return replace(test, signals=test.signals.add_signal("force", raw))


def modes(test: ReducedTest) -> list[Input]:
    return [curve for curve in curves(test).inputs if curve.cause == DRIFT_OF_ZERO]


def drift_of(test: ReducedTest, numbers: Numbers) -> float:
    outcome = measure_numbers(curves(test), lambda trace: Extractor(numbers, len(trace.time)))
    assert isinstance(outcome, tuple)
    (number,) = outcome
    return next(abs(row.change) for row in number.budget if row.cause == DRIFT_OF_ZERO)


def top_of_drift(trace: Trace) -> tuple[Floats]:
    return (trace.force.max(axis=-1),)


def first(trace: Trace) -> tuple[Floats]:
    return (trace.force[..., 0],)


def last(trace: Trace) -> tuple[Floats]:
    return (trace.force[..., -1],)


def mean(trace: Trace) -> tuple[Floats]:
    return (trace.force.mean(axis=-1),)


def slope(trace: Trace) -> tuple[Floats]:
    lever = trace.displacement - trace.displacement.mean(axis=-1, keepdims=True)
    return (np.sum(lever * trace.force, axis=-1) / np.sum(lever**2, axis=-1),)


LEVER = np.array([1.0, -1.0, 1.0]) / PLACES**3 - 0.5 / PLACES**2


@pytest.mark.parametrize(
    ("numbers", "share", "of_a_walk"),
    [
        (last, SHARE * PEAK, 1.0),
        (mean, SCALE * np.sqrt(np.sum(PLACES**-4.0)), 1.0 / 3.0),
        (slope, SCALE / WAY * np.sqrt(np.sum((12.0 * LEVER) ** 2)), 1.2 / WAY**2),
    ],
)
def test_what_a_drift_does_to_a_number(numbers: Numbers, share: float, of_a_walk: float) -> None:
    """What is stated at the end of the record, and of a whole walk so much of its variance.

    The mean of sin(p t) / p is 1 / p^2; a slope is 12 times the mean of (t - 1/2) sin(p t) / p.
    """
    assert drift_of(straight_of_drift(), numbers) == pytest.approx(share, rel=1e-3)
    assert share == pytest.approx(SHARE * PEAK * np.sqrt(of_a_walk), rel=0.05)


@pytest.mark.parametrize(
    ("taken", "stretch", "place", "drifts"),
    [
        ("zero_stretches", (19.0, 21.0), -1, first),
        ("moving_zero_stretches", (19.0, 20.0), -1, first),
        ("moving_zero_stretches", (0.0, 4.0), 0, top_of_drift),
    ],
)
def test_it_is_counted_from_where_the_zero_was_taken(
    taken: str, stretch: tuple[float, float], place: int, drifts: Numbers
) -> None:
    """The mean of a rest, or the outer end of a line, at the end of the record or its start."""
    test = straight_of_drift()
    signals = replace(test.signals, **{taken: {"force": stretch}})  # type: ignore[arg-type]
    zeroed = replace(test, signals=signals)
    assert drift_of(zeroed, drifts) == pytest.approx(SHARE * PEAK, rel=1e-9)
    trace = curves(zeroed).smooth_trace
    forces = [quantity.perturb(trace, 1.0).force[place] for quantity in modes(zeroed)]
    assert forces == pytest.approx([trace.force[place]] * 3, abs=1e-9)


@pytest.mark.parametrize(
    ("line", "zero"), [((1.0, 19.005), 19.005), ((0.995, 19.0), 0.995), ((1.0, 18.0), 1.0)]
)
def test_the_outer_end_of_a_line_is_the_one_nearer_to_an_end(
    line: tuple[float, float], zero: float
) -> None:
    test = straight_of_drift()
    signals = replace(test.signals, moving_zero_stretches={"force": line})
    assert _find_zero_time(replace(test, signals=signals)) == zero


def test_a_filter_leaves_records_without_samples_alone() -> None:
    blank: Floats = np.full((2, 9), np.nan)
    assert np.isnan(_filter_records(blank, filters=((Smoothing(3), 1),), cuts=[4])).all()


def test_a_zero_from_a_rest_on_the_clock_of_the_force() -> None:
    """Taken around 2 s of the motion: 3 s of a clock that is 1 s ahead."""
    test, sure = straight_of_drift(), Interval(0.0, 0.0)
    events, errors = np.array([0.0, 10.0]), np.full(2, 1e-3)
    fit = ClockFit(1.0, 0.0, sure, sure, 0.0, events, events + 1.0, errors, "by hand")
    raw = replace(test.signals.raw["force"], clock="force", time=test.required_curve.time + 1.0)
    signals = replace(test.signals.add_signal("force", raw), zero_stretches={"force": (2.5, 3.5)})
    test = replace(test, signals=signals, clocks=Clocks("one", fit), unfiltered_force=raw)
    trace = curves(test).smooth_trace
    for quantity in modes(test):
        assert quantity.perturb(trace, 1.0).force[200] == pytest.approx(trace.force[200], abs=1e-9)
    total = np.sum([(g.perturb(trace, 1.0).force - trace.force) ** 2 for g in modes(test)], axis=0)
    assert np.sqrt(total[-1]) == pytest.approx(SHARE * float(trace.force.max()), rel=1e-3)


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


def evidence(force: Floats, *, rate: float = SINGLE, filters: bool = True) -> ReducedTest:
    """A force on its own clock, that of the curve but for its name."""
    time = rate * np.arange(float(len(force)))
    signal = Signal(time, force, "N", "recorder")
    act = {"force": ((Smoothing(WINDOW), 1),)} if filters else {}
    signals = Signals(raw={"force": signal}, filtered={"force": signal}, filters=act)
    same, at = Interval(0.0, 0.0), np.array([TURN])
    joined = ClockFit(0.0, 0.0, same, same, 0.0, at, at, 0.01 * at, "by turns")
    return ReducedTest(signals, Clocks("cameras", joined), unfiltered_force=signal)


def curve() -> Trace:
    """The corner without noise, a frame each 0.04 s, up and down."""
    time = FRAME * np.arange(501.0) + 1.5 * SINGLE
    turn = int(np.searchsorted(time, TURN))
    up = Branch(0, turn, 1, Direction.LOADING, float(time[0]), float(time[turn]))
    down = Branch(turn, 501, 1, Direction.UNLOADING, float(time[turn]), float(time[-1]))
    return Trace(time, time, force_at(time), (up, down))


def test_the_largest_of_all_samples_in_noise() -> None:
    """Mean and spread as those of 1000 records with such noise; blocks of three samples of 1 N."""
    test = straight(18_000, 1000.0)
    trace = curves(test).smooth_trace
    samples = SampleNoise.select(test, trace, "force", slice(0, 6000), 5999)
    assert samples is not None
    rows = RNG(2).normal(size=(1000, 3000))
    noise = np.zeros((1000, 6000))
    noise[:, -1000:] = rows.reshape(1000, -1, 3).mean(axis=2)
    for sense in (1.0, -1.0):
        falling = replace(samples, smooth_values=sense * samples.smooth_values)
        raised = sense * falling.draw_peak_effect(noise, sense)
        by_hand = (
            samples.smooth_values[-3000:] + sense * rows[:, -len(samples.smooth_values) :]
        ).max(axis=1)
        by_hand -= samples.smooth_values.max()
        # Deviations of one record: 5 % of the mean.
        assert np.mean(raised) == pytest.approx(np.mean(by_hand), rel=0.05)
        assert np.std(raised) == pytest.approx(np.std(by_hand), rel=0.08)


def test_without_noise_nothing_is_raised() -> None:
    samples = around_turn(force_at(SINGLE * np.arange(2000.0)))
    assert samples is not None
    assert samples.draw_peak_effect(np.zeros((3, 501)), 1.0) == pytest.approx(np.zeros(3), abs=1e-9)
    assert samples.smooth_values.max() == pytest.approx(100.0, abs=BEFORE * FRAME)
    assert samples.draw_deviations((2, 3)) == pytest.approx(np.zeros((2, 3)), abs=1e-9)


def test_a_filter_as_long_as_half_of_the_samples_sees_all_of_its_reach() -> None:
    """The peak of one among 21 samples is raised by a mean of 11 neighbours, any of eleven."""
    peak, single = 10.0 * np.eye(1, 21, 10)[0], RNG(0).normal(size=21)
    filters = ((Smoothing(11), 1),)
    samples = SampleNoise(peak, 1e-3 * single, single, filters, (), None, RNG(1))
    means = np.convolve(single, np.full(11, 1 / 11), "valid")
    raised = samples.draw_peak_effect(np.zeros((50, 1)), 1.0)
    assert np.abs(raised[:, None] - means).min(axis=1) == pytest.approx(np.zeros(50), abs=1e-12)


def test_samples_of_an_unfiltered_force_have_all_noise_themselves() -> None:
    """A frame has one of its samples, not their mean, so that noise of frames is not added."""
    noisy = force_at(SINGLE * np.arange(2000.0)) + NOISE * RNG(0).normal(size=2000)
    samples = around_turn(noisy, filters=False)
    assert samples is not None
    assert np.std(samples.deviations) == pytest.approx(NOISE, rel=0.05)
    raised = samples.draw_peak_effect(1e3 * np.ones((400, 501)), 1.0)
    assert 0.5 * NOISE < raised.mean() < 4.0 * NOISE


def test_single_samples_deviate_from_their_block() -> None:
    noisy = force_at(SINGLE * np.arange(2000.0)) + NOISE * RNG(0).normal(size=2000)
    samples = around_turn(noisy)
    assert samples is not None
    assert np.std(samples.draw_deviations((4000,))) == pytest.approx(0.75**0.5 * NOISE, rel=0.06)


@pytest.mark.parametrize("failed_at", [None, 500])
def test_a_sample_far_off_is_left_out_only_if_the_specimen_broke(failed_at: int | None) -> None:
    """A hundred times the noise off a hundred samples before the turn."""
    noisy = force_at(SINGLE * np.arange(2000.0)) + NOISE * RNG(0).normal(size=2000)
    noisy[round(TURN / SINGLE) - 100] += 100.0 * NOISE
    trace = replace(curve(), failed_at=failed_at)
    turn = trace.branches[0].stop
    samples = SampleNoise.select(evidence(noisy), trace, "force", slice(0, 501), turn)
    assert samples is not None
    is_kept = bool(np.abs(samples.deviations).max() > 50.0 * NOISE)
    assert is_kept is (failed_at is None)


def test_a_curve_with_all_samples_needs_no_more_of_them() -> None:
    force = force_at(0.03 * np.arange(667.0))
    assert around_turn(force, rate=0.03) is None
    gap = np.where(np.abs(np.arange(2000) - 1000) < 995, np.nan, 1.0)
    assert around_turn(gap) is None


def around_turn(force: Floats, **options: Any) -> SampleNoise | None:
    trace = curve()
    return SampleNoise.select(
        evidence(force, **options), trace, "force", slice(0, 501), trace.branches[0].stop
    )


def test_pieces_begin_behind_the_time_of_a_turn() -> None:
    """A clock that is 1 s ahead: at 10.0 s of the curve it says 11.0 s, its sample 1100."""
    same, at = Interval(1.0, 1.0), np.array([TURN])
    joined = ClockFit(1.0, 0.0, same, same, 0.0, at, at + 1.0, 0.01 * at, "by turns")
    signal = Signal(SINGLE * np.arange(float(2000)), np.zeros(2000), "N", "recorder")
    assert find_piece_starts(Clocks("cameras", joined), [10.004, 12.0], signal) == [1101, 1301]
