"""Intervals and budgets of numbers, against textbooks, plain numpy and hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.causes import (
    GRIP,
    NOISE,
    SCALE_OF_FORCE,
    SECTION,
    SLACK,
    STEP,
    ZERO_OF_DISPLACEMENT,
    ZERO_OF_FORCE,
)
from labpipe.records.estimates import Failure, UnavailableError, return_failure
from labpipe.records.quality import Reason
from labpipe.uncertainty.intervals import MeasuredNumber, measure_numbers
from labpipe.uncertainty.replicates import Choice, Extractor, Input, Trace
from tests.builders.plain_records import measured, replicates_of, trace_of

RNG = np.random.default_rng


def mean(trace: Trace) -> tuple[Floats]:
    return (trace.force.mean(axis=-1),)


def largest(trace: Trace) -> tuple[Floats]:
    return (trace.force.max(axis=-1),)


def test_the_interval_is_the_spread_turned_around() -> None:
    """Largest of 100 samples of known noise: 2.5 % of the draws lie beyond each end."""
    (number,) = measured(trace_of(RNG(0).normal(size=100)), largest)
    assert number.interval.upper == number.value  # beside the draws, and inside the interval
    above = number.value - number.interval.lower
    assert np.mean(number.deviations > above) == pytest.approx(0.025, abs=0.003)
    (number,) = measured(trace_of(RNG(0).normal(size=100)), mean)
    below, above = number.value - number.interval.upper, number.value - number.interval.lower
    assert np.mean(number.deviations < below) == pytest.approx(0.025, abs=0.003)
    assert np.mean(number.deviations > above) == pytest.approx(0.025, abs=0.003)
    assert number.estimate == pytest.approx(number.value - number.deviations.mean())
    assert number.error == pytest.approx(np.std(number.deviations))


FORCE: Floats = np.full(200, 50.0)


def gained(trace: Trace, x: float) -> Trace:
    return replace(trace, force=trace.force * (1.0 + 0.02 * x))


def raised(trace: Trace, x: float) -> Trace:
    return replace(trace, force=trace.force - 0.3 * x)


def pushed(trace: Trace, x: float) -> Trace:
    return replace(trace, displacement=trace.displacement + 1e-4 * x)


def budget(found: MeasuredNumber) -> dict[str, float]:
    return {contribution.cause: contribution.change for contribution in found.budget}


def test_gain_and_zero_by_hand() -> None:
    """2 % of 50 N, and -0.3 N: signs stay; without noise they are all there is."""
    gain, zero = Input(SCALE_OF_FORCE, gained), Input(ZERO_OF_FORCE, raised)
    (number,) = measured(trace_of(FORCE), mean, gain, zero)
    assert budget(number) == pytest.approx({SCALE_OF_FORCE: 1.0, ZERO_OF_FORCE: -0.3})
    assert [contribution.is_common for contribution in number.budget] == [True, False]
    assert number.error == pytest.approx(np.hypot(1.0, 0.3), rel=0.07)
    half = 1.96 * np.hypot(1.0, 0.3)
    assert number.interval.lower == pytest.approx(50.0 - half, abs=0.25)
    assert number.interval.upper == pytest.approx(50.0 + half, abs=0.25)
    assert number.estimate == pytest.approx(50.0, abs=0.05)


def test_the_mean_of_the_noisier_half_of_a_record_is_held() -> None:
    """Of 40 records whose second half has three times the noise."""
    held = 0
    for seed in range(40):
        record = RNG(seed).normal(size=600) * np.repeat([1.0, 3.0], 300)
        (found,) = measured(trace_of(record), lambda trace: (trace.force[..., 300:].mean(axis=-1),))
        held += found.interval.lower < 0.0 < found.interval.upper
    assert 0.9 * 40 <= held <= 40


def test_what_moves_together_cancels() -> None:
    """A ratio of two forces does not know the gain; each row has its own share of a draw."""

    def both(trace: Trace) -> tuple[Floats, ...]:
        first, second = trace.force[..., 0], 3.0 * trace.force[..., 1]
        return first, second, second / first, second - 3.0 * first

    single, triple, *cancelled = measured(trace_of(FORCE), both, Input(SCALE_OF_FORCE, gained))
    assert budget(triple)[SCALE_OF_FORCE] == pytest.approx(3.0 * budget(single)[SCALE_OF_FORCE])
    assert triple.deviations == pytest.approx(3.0 * single.deviations)
    assert [number.error for number in cancelled] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_a_rectangular_input() -> None:
    """Half width sqrt(3) u: 95 % of it lie within 0.95 sqrt(3) u.

    A step lies on one side: the truth within a step of 4 N behind 50 N, anywhere.
    """
    (found,) = measured(trace_of(FORCE), mean, Input(ZERO_OF_FORCE, raised, distribution="uniform"))
    half = 0.95 * 3.0**0.5 * 0.3
    ends = found.interval.lower, found.interval.upper
    assert ends == pytest.approx((50.0 - half, 50.0 + half), abs=0.01)
    assert budget(found) == pytest.approx({ZERO_OF_FORCE: -0.3})

    def end(trace: Trace) -> tuple[Floats]:
        return (trace.force[..., -1] + 4.0 * trace.steps_to_event,)

    later = Input(
        STEP,
        lambda trace, x: replace(trace, steps_to_event=x),
        distribution="step",
        moves_curve=False,
    )
    (found,) = measured(trace_of(FORCE), end, later)
    assert found.interval.lower == 50.0  # the value itself
    assert found.interval.upper == pytest.approx(53.9, abs=0.02)
    assert found.estimate == pytest.approx(52.0, abs=0.02)
    assert budget(found) == pytest.approx({STEP: 4.0 / 12.0**0.5})
    assert found.error == pytest.approx(4.0 / 12.0**0.5, rel=0.02)


def test_an_input_that_changes_more_upwards() -> None:
    """A zero higher by x adds 3 x, lower by x takes 1 x: the truth may lie 3 u below, 1 u above.

    Where the zero was taken u too high, the number reads T(0) and was T(-u): 1 u is too much.
    """

    def bent(trace: Trace) -> tuple[Floats]:
        way = trace.displacement[..., 0] / 1e-4
        return (np.where(way > 0.0, 3.0 * way, way),)

    still = trace_of(FORCE, np.zeros(200))
    (number,) = measured(still, bent, Input(ZERO_OF_DISPLACEMENT, pushed))
    assert number.interval.lower == pytest.approx(-1.96, abs=0.1)
    assert number.interval.upper == pytest.approx(3.0 * 1.96, abs=0.3)
    assert budget(number) == pytest.approx({ZERO_OF_DISPLACEMENT: 2.0})


def refuse(why: Failure) -> Choice:
    """Choose no samples."""

    def choose_samples(trace: Trace) -> Extractor:
        del trace
        raise UnavailableError(why)

    return choose_samples


def test_a_number_that_is_not_in_the_curve() -> None:
    why = Failure("not_reached", "the branch ends")
    drawn = replicates_of(trace_of(FORCE + RNG(0).normal(size=200)))
    assert return_failure(measure_numbers)(drawn, refuse(why)) is why

    def only_measured(trace: Trace) -> Extractor:
        return Extractor(mean, 200) if trace is drawn.measured_trace else refuse(why)(trace)

    # The smooth curve just misses a limit: what was decided on the measured one holds for it.
    outcome = return_failure(measure_numbers)(drawn, only_measured)
    assert isinstance(outcome, tuple)
    assert outcome[0].interval == measured(trace_of(drawn.measured_trace.force), mean)[0].interval
    # A shorter one needs another decision, on means of the measured samples.
    means = trace_of(drawn.smooth_trace.force[:-1])
    shorter = replace(drawn, smooth_trace=means, averaged_trace=drawn.measured_trace)
    assert len(measure_numbers(shorter, only_measured)) == 1
    outcome = return_failure(measure_numbers)(replace(shorter, averaged_trace=means), only_measured)
    assert isinstance(outcome, Failure)
    assert outcome.code == "no_replicate"
    assert why.message in outcome.message


@pytest.mark.parametrize(
    ("without", "doubtful", "fails"),
    [(20, False, False), (21, True, False), (199, True, False), (200, True, True)],
)
def test_limits_of_replicates_without_the_number(without: int, doubtful: bool, fails: bool) -> None:
    """More than 20 of 400 are doubtful, 200 are a failure."""

    def marked(trace: Trace) -> tuple[Floats]:
        return (np.where(trace.force[..., 0] > 100.0, np.nan, trace.force.mean(axis=-1)),)

    drawn = replicates_of(trace_of(FORCE + RNG(3).normal(size=200)))
    force = drawn.force.copy()
    force[:without, 0] = 1000.0
    outcome = return_failure(measure_numbers)(
        replace(drawn, force=force), lambda _: Extractor(marked, 200)
    )
    assert isinstance(outcome, Failure) == fails
    if isinstance(outcome, tuple):
        assert bool(outcome[0].doubts) == doubtful


def test_windows_are_decided_anew_where_the_curve_moves() -> None:
    """Force where the displacement passes 1 mm: moved by 0.1 mm it lies 10 samples elsewhere."""

    def at(trace: Trace) -> Extractor:
        sample = int(np.searchsorted(trace.displacement, 1.005e-3))
        if sample > 108:
            raise UnavailableError(Failure("not_reached", "too far"))
        return Extractor(lambda curve: (curve.force[..., sample],), 1)

    trace = trace_of(np.arange(200.0))
    for moves, by in ((True, -10.0), (False, 0.0)):
        grip = Input(GRIP, pushed, moves_curve=moves)
        outcome = return_failure(measure_numbers)(replicates_of(trace, grip), at)
        assert isinstance(outcome, tuple)
        # Lower by 0.1 mm it is not reached: there the samples stay as they were.
        assert budget(outcome[0]) == pytest.approx({GRIP: 0.5 * by} if moves else {})


@pytest.mark.parametrize("is_cut", [True, False])
def test_between_its_samples_a_window_ends_where_it_should(is_cut: bool) -> None:
    """Mean force up to 4.5 of 2 N a sample: 4 N by samples, 4.5 N by the line through them.

    The truth may lie from 3.75 to 4.75 N, evenly. A displacement that is off by 0.3 samples moves
    no sample across the end of the window.
    """

    def below(trace: Trace) -> Extractor:
        chosen = slice(0, int(np.sum(trace.displacement <= 4.5)))
        return Extractor(
            lambda curve: (curve.force[..., chosen].mean(axis=-1),), 5, ends_at_samples=is_cut
        )

    trace = trace_of(2.0 * np.arange(20.0), np.arange(20.0))
    off = Input(
        ZERO_OF_DISPLACEMENT,
        lambda curve, x: replace(curve, displacement=curve.displacement + 0.3 * x),
    )
    outcome = return_failure(measure_numbers)(replicates_of(trace, off), below)
    assert isinstance(outcome, tuple)
    assert outcome[0].value == 4.0
    assert outcome[0].estimate == pytest.approx(4.25 if is_cut else 4.0, abs=0.04)
    expected = {ZERO_OF_DISPLACEMENT: -0.3, STEP: 0.5 / np.sqrt(3.0)} if is_cut else {}
    assert budget(outcome[0]) == pytest.approx(expected, abs=0.04)


def slow(tau: float, count: int, seed: int = 0) -> Floats:
    kicks, factor = RNG(seed).normal(size=count), np.exp(-1.0 / tau)
    noise = np.zeros(count)
    for at in range(1, count):
        noise[at] = factor * noise[at - 1] + kicks[at]
    return 10.0 + noise


@pytest.mark.parametrize(
    ("tau", "window", "is_slow"),
    [
        (0.1, 3000, False),
        (20.0, 3000, False),
        (20.0, 55, True),
        (10.0, 90, False),
        (20.0, 1, False),
    ],
)
def test_noise_as_slow_as_the_number(tau: float, window: int, is_slow: bool) -> None:
    """Over two fifths of the window; one sample has no window."""
    (number,) = measured(trace_of(slow(tau, 3000)), mean, n=window)
    codes = [(name, reason.code) for name, reason in number.doubts]
    assert codes == ([("force", "slow_noise")] if is_slow else [])


def test_doubts_of_an_input_are_those_of_what_rests_on_it() -> None:
    """By more than half a thousandth of the number."""
    why = Reason("slow_noise", "the slack is doubtful")
    trace = trace_of(FORCE + RNG(0).normal(size=len(FORCE)))
    for by, doubts in ((1.0, [("", why)]), (1e-3, [])):

        def more(trace: Trace, x: float, by: float = by) -> Trace:
            return replace(trace, force=trace.force + by * x)

        (number,) = measured(trace, mean, Input(SLACK, more, doubts=(why,)))
        assert list(number.doubts) == doubts


@pytest.mark.parametrize("share", [0.015, 0.05])
def test_noise_as_slow_as_the_record(share: float) -> None:
    """It surely remembers a twentieth of it, the longest that is looked for; or three in five."""
    drawn = replicates_of(trace_of(slow(20.0, 3000)))
    chances = np.zeros(len(drawn.noise_models["force"].probabilities))
    chances[[0, 48]] = 1.0 - share / 0.05, share / 0.05
    noise = replace(drawn.noise_models["force"], probabilities=chances)
    assert noise.correlation_time == pytest.approx(3000 * share, rel=0.01)
    outcome = return_failure(measure_numbers)(
        replace(drawn, noise_models={"force": noise}), lambda _: Extractor(mean, 3000)
    )
    assert isinstance(outcome, tuple)
    codes = [reason.code for _, reason in outcome[0].doubts]
    assert codes == (["slow_noise"] if share == 0.05 else [])


def test_without_noise_and_inputs_there_is_no_width() -> None:
    record = RNG(0).normal(size=3000)
    for force, inputs, codes in (
        (record, (), []),
        (FORCE, (), ["no_width"]),
        (FORCE, (Input(ZERO_OF_FORCE, raised),), []),
    ):
        (number,) = measured(trace_of(force), mean, *inputs)
        assert [reason.code for _, reason in number.doubts] == codes


def test_a_value_far_outside_of_its_interval_is_doubtful() -> None:
    """A sample has lost 10 N already: at 100 N that is 10 % of the number, at 2000 N 0.5 %."""

    def one(trace: Trace) -> tuple[Floats, ...]:
        return (trace.force[..., 500],)

    def fallen(trace: Trace) -> Extractor:
        return Extractor(one, 1, lambda drawn: (drawn.force[..., 500] - 10.0,))

    for level, codes in ((100.0, ["value_outside"]), (2000.0, [])):
        record = level + 0.1 * RNG(0).normal(size=1000)
        outcome = return_failure(measure_numbers)(replicates_of(trace_of(record)), fallen)
        assert not isinstance(outcome, Failure)
        assert [reason.code for _, reason in outcome[0].doubts] == codes
        assert outcome[0].interval.lower == outcome[0].value
        assert outcome[0].estimate == pytest.approx(level + 10.0, abs=0.5)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_an_input_that_leaves_no_number_on_one_side(side: float) -> None:
    """There it counts as on the other side, and the number is doubtful."""

    def onesided(trace: Trace) -> tuple[Floats]:
        way = trace.displacement[..., 0]
        return (np.where(side * way > 0.0, np.nan, 2.0 * way / 1e-4),)

    still = trace_of(FORCE, np.zeros(200))
    (number,) = measured(still, onesided, Input(ZERO_OF_DISPLACEMENT, pushed))
    assert budget(number) == pytest.approx({ZERO_OF_DISPLACEMENT: 2.0})
    assert number.interval.upper == pytest.approx(3.92, abs=0.2)
    assert number.interval.lower == pytest.approx(-3.92, abs=0.2)
    assert [reason.code for _, reason in number.doubts] == ["not_repeatable"]


@pytest.mark.parametrize("seed", range(2))
def test_the_budget_adds_up_to_the_variance(seed: int) -> None:
    """Of inputs exactly but for their draws, of noise as it was drawn."""
    rng = RNG(seed)
    shares = rng.uniform(0.05, 1.0, 3)

    def moved(name: int) -> Input:
        def by(trace: Trace, x: float) -> Trace:
            return replace(trace, force=trace.force + shares[name] * x)

        cause = (ZERO_OF_FORCE, GRIP, SECTION)[name]
        return Input(cause, by, distribution=("normal", "uniform", "normal")[name])

    record = rng.normal(0.0, 3.0, 40) + 50.0
    (number,) = measured(trace_of(record), mean, *(moved(name) for name in range(3)))
    rows = budget(number)
    assert set(rows) == {NOISE, ZERO_OF_FORCE, GRIP, SECTION}
    assert [rows[ZERO_OF_FORCE], rows[GRIP], rows[SECTION]] == pytest.approx(shares)
    assert np.sum(np.square(list(rows.values()))) == pytest.approx(number.error**2, rel=0.2)
