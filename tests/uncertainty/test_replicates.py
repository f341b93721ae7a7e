"""Smooth records and curves drawn around them, by polynomials, plain numpy and hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Direction
from labpipe.uncertainty.noise_model import compute_drift_modes
from labpipe.uncertainty.replicates import (
    N_REPLICATES,
    Distribution,
    Extractor,
    Input,
    Trace,
    combine_numbers,
    draw_replicates,
    fit_smooth_curve,
)
from tests.builders.noise_rows import flicker
from tests.builders.plain_records import replicates_of, trace_of

RNG = np.random.default_rng
TIME: Floats = 0.01 * np.arange(1000.0)


def cubic(at: Floats) -> Floats:
    return 2.0 + 3.0 * at - 0.5 * at**2 + 0.04 * at**3


def test_a_cubic_is_its_own_smooth_curve() -> None:
    assert fit_smooth_curve(TIME, cubic(TIME), [], 12) == pytest.approx(cubic(TIME), abs=1e-9)
    uneven = np.sort(RNG(0).uniform(0.0, 10.0, 400))
    assert fit_smooth_curve(uneven, cubic(uneven), [], 12) == pytest.approx(cubic(uneven), abs=1e-9)


@pytest.mark.parametrize(
    ("count", "parts", "columns"), [(160, 12, 15), (160, 40, 23), (3000, 12, 15)]
)
def test_freedom_of_the_spline(count: int, parts: int, columns: int) -> None:
    """A projection on p columns leaves p / n of the variance; an interval has 8 samples or more."""
    time: Floats = 1000.0 + np.arange(float(count))
    rows = RNG(1).normal(size=(200, count))
    curves = np.array([fit_smooth_curve(time, row, [], parts) for row in rows])
    assert np.sum(curves**2) / 200 == pytest.approx(columns, rel=0.06)


def test_a_short_piece_is_a_line() -> None:
    """By hand: (0, 1), (1, 3), (2, 2) have the line 1.5 + 0.5 t."""
    time = np.array([0.0, 1.0, 2.0])
    assert fit_smooth_curve(time, np.array([1.0, 3.0, 2.0]), [], 12) == pytest.approx(
        [1.5, 2.0, 2.5]
    )
    two = np.array([4.0, 9.0])
    assert np.array_equal(fit_smooth_curve(time[:2], two, [], 12), two)
    rest = np.array([1.0, -4.0, 6.0, -4.0, 2.0])
    curve = fit_smooth_curve(TIME[:5], rest, [], 12, branches=[])
    assert curve == pytest.approx(np.full(5, 0.2))  # the mean: no cubic follows them
    values = RNG(0).normal(size=15)
    line = np.polyval(np.polyfit(TIME[:15], values, 1), TIME[:15])
    assert fit_smooth_curve(TIME[:15], values, [], 12) == pytest.approx(line)


def unmoved(trace: Trace, x: float) -> Trace:
    del x
    return trace


@pytest.mark.parametrize(
    ("law", "low", "high"),
    [("normal", -9.0, 9.0), ("uniform", -1.7321, 1.7321), ("step", -1.0, 0.0)],
)
def test_draws_of_an_input(law: Distribution, low: float, high: float) -> None:
    """Few of a normal one are beyond 1.96, none of a rectangle."""
    zero = Input("zero of the force", unmoved, distribution=law)
    drawn = replicates_of(trace_of(TIME)).draw_errors(zero)
    mean, deviation = (-0.5, 12.0**-0.5) if law == "step" else (0.0, 1.0)
    assert drawn.shape == (N_REPLICATES,)
    assert low <= drawn.min() < drawn.max() <= high
    assert (np.mean(drawn), zero.standard_deviation) == pytest.approx((mean, deviation), abs=0.01)
    assert np.std(drawn) == pytest.approx(deviation, rel=0.02)
    share = np.mean(np.abs(drawn - mean) > 1.96 * deviation)
    assert share == pytest.approx(0.05 if law == "normal" else 0.0, abs=0.004)


def test_replicates_scatter_about_the_smooth_curve() -> None:
    force, way = cubic(TIME) + RNG(1).normal(0.0, 0.3, 1000), TIME + RNG(2).normal(0.0, 0.02, 1000)
    curves = replicates_of(trace_of(force, way))
    assert curves.force.shape == curves.displacement.shape == (N_REPLICATES, 1000)
    for drawn, smooth, truth, spread in (
        (curves.force, curves.smooth_trace.force, cubic(TIME), 0.3),
        (curves.displacement, curves.smooth_trace.displacement, TIME, 0.02),
    ):
        assert np.std(smooth - truth) < 0.25 * spread
        assert np.mean(drawn, axis=0) == pytest.approx(smooth, abs=0.35 * spread)
        assert np.std(drawn - smooth) == pytest.approx(spread, rel=0.08)
    noise = (curves.force - curves.smooth_trace.force)[:, 500]
    assert abs(np.mean(noise * (curves.displacement - TIME)[:, 500])) < 0.2 * 0.3 * 0.02
    assert np.array_equal(curves.measured_trace.force, force)


@pytest.mark.parametrize(("cuts", "swings"), [([6], 1.0), ([6, 12], 1.0), ([600], 20.0)])
def test_noise_of_a_specimen_that_broke(cuts: list[int], swings: float) -> None:
    """Six samples say nothing, nor do twice six; what follows them does.

    Else what is left of a specimen is not its noise: it swings 20 times as far.
    """
    force, end = RNG(0).normal(size=1000), cuts[-1]
    force[:end] += np.arange(float(end))
    force[end:] *= swings
    curves = replicates_of(trace_of(force, failed_at=end - 1), cuts=cuts)
    off = (curves.force - curves.smooth_trace.force)[:, : end if swings > 1.0 else None]
    assert np.std(off) == pytest.approx(1.0, rel=0.15)


def test_a_rest_without_a_course_is_its_mean() -> None:
    """Behind 5 s of motion 5 s of rest; one that creeps by ten times its noise is followed."""
    branches = (Branch(0, 500, 1, Direction.LOADING, 0.0, 5.0),)
    way, later = np.minimum(TIME, 5.0), np.maximum(TIME - 5.0, 0.0)
    values = way + RNG(4).normal(0.0, 0.01, 1000)
    curve = fit_smooth_curve(TIME, values, [500], 12, branches=branches)
    assert curve[502:] == pytest.approx(np.full(498, values[500:].mean()), abs=1e-12)
    creeping = values - 0.1 * (1.0 - np.exp(-later))
    curve = fit_smooth_curve(TIME, creeping, [500], 12, branches=branches)
    truth = 5.0 - 0.1 * (1.0 - np.exp(-later[502:]))
    assert curve[502:] == pytest.approx(truth, abs=8e-3)
    # Where the whole record moves it has its spline.
    curve = fit_smooth_curve(TIME, values, [500], 12)
    assert np.ptp(curve[502:]) > 1e-3


SAMPLES = np.arange(600.0)


@pytest.mark.parametrize("late", [-0.9, 0.0, 0.4])
def test_no_piece_runs_past_a_turn(late: float) -> None:
    """Up to a stand, and down from it: the cuts are whole samples, the corners are not."""
    corners = np.array([0.0, 199.5 + late, 399.5 + late, 599.0])
    true = np.interp(SAMPLES, corners, [0.0, 20.0, 20.0, 0.0])
    curve = fit_smooth_curve(SAMPLES, true, [200, 400], 12)
    assert curve.max() == pytest.approx(20.0, abs=5e-3)  # a twentieth of a step
    assert np.abs(curve - true).max() < 0.03


def test_a_break_stays() -> None:
    """The force is lost within four samples, the last ones; before them it rose by 0.1 a step."""
    time = SAMPLES[:304]
    true = np.where(time < 300.0, 0.1 * time, 29.9 - 6.0 * (time - 299.0))
    curve = fit_smooth_curve(time, true, [300], 12, jump=300)
    assert curve[299] == pytest.approx(29.9, abs=1e-6)
    assert fit_smooth_curve(time, true - 2.0 * (time >= 300.0), [300], 12)[299] < 29.5


def test_a_jump_is_no_turn() -> None:
    true = np.where(SAMPLES < 300.0, 0.1 * SAMPLES, 1.0)
    curve = fit_smooth_curve(SAMPLES, true, [300], 12)
    assert curve[299:301] == pytest.approx([29.9, 1.0], abs=1e-6)


CUTS = (200, 1500, 2800)
RECORD = 3000


def branch(start: int, stop: int, direction: Direction) -> Branch:
    return Branch(start, stop, 1, direction, float(start), float(stop))


def test_rests_of_a_cyclic_test_are_looked_at() -> None:
    """To and fro once between two rests; and the same record as one single loading.

    Of 48 half waves of each rest a mean is taken off before the motion, a parabola behind it.
    """
    time = np.arange(RECORD, dtype=np.float64)
    way = np.interp(time, [0.0, *CUTS, RECORD - 1.0], [0.0, 0.0, 1.0, 0.0, 0.0])
    cycle = (branch(200, 1500, Direction.LOADING), branch(1500, 2800, Direction.UNLOADING))
    force = way + 1e-3 * np.random.default_rng(2).normal(size=RECORD)
    freedom = list[int]()
    for branches in (cycle[:1], cycle):
        trace = Trace(time, way + 0.01 * flicker((1, RECORD), 1)[0], force, branches)
        draw = draw_replicates(trace, trace, CUTS, (lambda x: x, lambda x: x), (), seed=b"one")
        freedom.append(draw.noise_models["displacement"].dof)
    assert freedom[1] - freedom[0] == 2 * 48 - 1 - 3
    ends = [draw.displacement[:, part].mean(axis=1) for part in (slice(0, 200), slice(2800, None))]
    assert float(np.std(ends[1] - ends[0])) > 4e-3


RECORD_TIME = np.linspace(0.0, 50.0, 501)


def test_the_variance_is_that_of_a_walk() -> None:
    """As stated at the end, and within a tenth of a walk from a quarter of the record on."""
    assert compute_drift_modes(RECORD_TIME, 0.0) == []
    waves = np.array(compute_drift_modes(RECORD_TIME, 0.3))
    spread = np.sqrt(np.sum(waves**2, axis=0))
    assert spread[-1] == pytest.approx(0.3, rel=1e-12)
    assert spread[0] == 0.0
    assert spread[125:] == pytest.approx(0.3 * np.sqrt(RECORD_TIME[125:] / 50.0), rel=0.1)


TRACE = trace_of(np.array([1.0, 2.0, 6.0]), np.array([0.0, 1.0, 2.0]), sizes={"length": 4.0})


def largest(trace: Trace) -> Extractor:
    del trace
    return Extractor(lambda curve: (curve.force.max(axis=-1), curve.force.min(axis=-1)), 3)


def reach(trace: Trace) -> Extractor:
    del trace
    return Extractor(lambda curve: (curve.displacement.max(axis=-1),), 2)


def shared(trace: Trace, force: Floats, way: Floats) -> Floats:
    return force / way * trace.sizes["length"]


def test_a_finer_curve_is_the_same_curve() -> None:
    way = np.array([0.0, np.nan, 2.0, 4.0])
    trace = replace(trace_of(np.array([1.0, 2.0, 6.0, 0.0]), way), failed_at=2)
    first, second = trace.branches[0], trace.branches[0]
    branches = replace(first, start=0, stop=3), replace(second, start=2, stop=4)
    finer = replace(trace, branches=branches).refine(2)
    assert finer.force.tolist() == [1.0, 1.5, 2.0, 4.0, 6.0, 3.0, 0.0]
    assert finer.time == pytest.approx(0.005 * np.arange(7))
    assert np.isnan(finer.displacement[1:4]).all()
    assert finer.displacement[[0, 4, 5, 6]].tolist() == [0.0, 2.0, 3.0, 4.0]
    assert [(branch.start, branch.stop) for branch in finer.branches] == [(0, 5), (4, 7)]
    assert finer.failed_at == 4
    assert (trace.parts_per_step, finer.parts_per_step, finer.refine(3).parts_per_step) == (1, 2, 6)


def test_a_finer_curve_has_corners_where_neighbouring_steps_meet() -> None:
    """A knee at 2.25 samples, either way up; a gap, and a step that is not between its neighbours,
    are divided evenly."""
    fine = np.arange(0.0, 6.125, 0.25)
    for sign in (1.0, -1.0):
        knee = sign * np.minimum(4.0 * fine, 9.0 + 0.5 * (fine - 2.25))
        trace = trace_of(knee[::4], 1e-3 * fine[::4])
        finer = trace.refine(4, has_corners=True)
        assert finer.force == pytest.approx(knee)
        assert finer.displacement == pytest.approx(1e-3 * fine)
    uneven = np.array([0.0, 1.0, 4.0, 5.0, np.nan, 7.0, 9.0])
    trace = trace_of(uneven, np.arange(7.0))
    assert np.array_equal(
        trace.refine(2, has_corners=True).force, trace.refine(2).force, equal_nan=True
    )


def test_a_number_is_made_of_the_first_of_each_part() -> None:
    extractor = combine_numbers(shared, largest, reach)(TRACE)
    assert isinstance(extractor, Extractor)
    assert (extractor.n, float(extractor.compute_numbers(TRACE)[0])) == (3, 6.0 / 2.0 * 4.0)

    force = np.array([[1.0, 2.0, 3.0], [2.0, 8.0, 4.0]])
    way = np.array([[0.0, 1.0, 2.0], [0.0, 1.0, 4.0]])
    rows = Trace(TRACE.time, way, force, sizes=TRACE.sizes)
    assert extractor.compute_numbers(rows)[0].tolist() == [6.0, 8.0]


def test_in_noise_each_part_is_read_as_in_noise() -> None:
    """What moves the samples that are read, where that is said; else the numbers themselves."""

    def moved(trace: Trace) -> Extractor:
        del trace
        return Extractor(
            lambda curve: (curve.force.max(axis=-1),), 3, lambda curve: (curve.force[..., 0],)
        )

    assert moved(TRACE).compute_replicates(TRACE)[0] == 1.0
    assert largest(TRACE).compute_replicates(TRACE)[0] == 6.0
    extractor = combine_numbers(shared, moved, reach)(TRACE)
    assert isinstance(extractor, Extractor)
    assert extractor.compute_numbers(TRACE)[0] == 12.0
    assert extractor.compute_replicates(TRACE)[0] == 2.0


def test_draws_that_are_given_and_displacements_from_elsewhere() -> None:
    curves = replicates_of(trace_of(cubic(TIME) + RNG(1).normal(size=1000)))
    slack = Input("slack", unmoved)
    draws = curves.draw_errors(slack)
    assert np.array_equal(draws, curves.draw_errors(slack))
    other = curves.draw_errors(replace(slack, cause="scale of the force"))
    assert abs(np.corrcoef(draws, other)[0, 1]) < 0.2
    same = curves.draw_errors(replace(slack, cause="section", stream="slack"))
    assert np.array_equal(same, draws)
    stated = np.arange(float(N_REPLICATES))
    assert curves.draw_errors(replace(slack, drawn_errors=stated)) is stated
    moved = curves.shift_displacement(-2e-3, slack)
    smooth_traces = curves.smooth_trace, moved.smooth_trace
    for curve, shifted in ((curves.measured_trace, moved.measured_trace), smooth_traces):
        assert shifted.displacement == pytest.approx(curve.displacement - 2e-3, abs=1e-15)
        assert np.array_equal(shifted.force, curve.force)
    assert (curves.inputs, moved.inputs, moved.seed) == ((), (slack,), curves.seed)
