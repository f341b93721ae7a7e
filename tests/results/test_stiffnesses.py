from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Direction
from labpipe.records.estimates import Failure, return_failure
from labpipe.results.bending import (
    Rollers,
    compute_beam_factor,
    compute_roller_load,
    compute_stiffness_ratio,
)
from labpipe.results.curves import compute_polynomial_weights, compute_slope, compute_zero_crossing
from labpipe.results.stiffness import (
    LineStiffness,
    LoadingSlope,
    WindowSlope,
    choose_loading_window,
    choose_turn_samples,
    choose_unloading_window,
    choose_window,
    find_compliance_window,
    find_force_onset,
)
from labpipe.uncertainty.replicates import Trace
from tests.builders.noise_rows import noise_rows

TIME = np.arange(0.0, 40.0, 0.05)


UP = 1e-3 * TIME


"""1 mm/s up to 40 mm."""


def windowed(path: Floats, force: Floats, low: float, high: float) -> WindowSlope:
    return choose_window(TIME, path, force, path, start=low, stop=high)


def test_slope_is_exact_on_a_line() -> None:
    force = 20.0 * UP + 1.0
    stiffness = windowed(UP, force, 0.004 - 1e-9, 0.009 + 1e-9)
    assert stiffness.compute_slope(UP, force) == pytest.approx(20.0, rel=1e-12)
    assert stiffness.window_samples == slice(80, 181)  # 4.00 to 9.00 mm in steps of 0.05 mm


def test_slope_is_that_of_the_definition() -> None:
    """On a parabola, k between a and b is 2 c times their middle: here 2 x 300 x 6.5 mm."""
    force = 300.0 * UP**2
    stiffness = windowed(UP, force, 0.004 - 1e-9, 0.009 + 1e-9)
    assert stiffness.compute_slope(UP, force) == pytest.approx(3.9, rel=1e-9)
    # and one that lies 10 mm later, 2 x 300 x 10 mm more
    assert stiffness.compute_slope(UP, force, 0.01) == pytest.approx(9.9, rel=1e-9)
    rows = stiffness.compute_slope(UP, force, np.array([0.0, 0.01, 0.02]))
    np.testing.assert_allclose(rows, [3.9, 9.9, 15.9], rtol=1e-9)


def test_rows_are_as_each_alone() -> None:
    rng = np.random.default_rng(1)
    path = UP + rng.normal(0, 1e-4, (3, len(UP)))
    force = 20.0 * UP + rng.normal(0, 1e-2, (3, len(UP)))
    path[:, 200:203] = np.nan
    stiffness, later = windowed(path[0], force[0], 0.008, 0.02), np.array([0.0, 1e-3, -2e-3])
    alone = list(map(stiffness.compute_slope, path, force, later))
    np.testing.assert_allclose(stiffness.compute_slope(path, force, later), alone, rtol=1e-12)
    assert np.isfinite(alone).all()


def test_a_noisy_displacement_does_not_make_the_slope_small() -> None:
    """3 mm of noise over 10 mm would take half of the slope by least squares."""
    noisy = UP + np.random.default_rng(2).normal(0.0, 3e-3, (400, len(UP)))
    force = np.broadcast_to(20.0 * UP, noisy.shape)
    slopes = windowed(UP, 20.0 * UP, 0.01, 0.02).compute_slope(noisy, force)
    assert np.median(slopes) == pytest.approx(20.0, rel=0.03)


def test_the_window_ends_where_it_is_first_left() -> None:
    """Up to 10 mm, back, and up again: the second way up has another stiffness."""
    path = np.concatenate([UP[:200], UP[:200][::-1], UP[:400]])
    time = np.arange(0.0, 0.05 * len(path), 0.05)
    force = np.concatenate([20.0 * UP[:200], np.zeros(200), 50.0 * UP[:400]])
    stiffness = choose_window(time, path, force, path, start=0.002, stop=0.008)
    assert stiffness.compute_slope(path, force) == pytest.approx(20.0, rel=1e-9)


def test_too_few_samples_for_a_row_are_no_number() -> None:
    stiffness = windowed(UP, UP, 0.005, 0.02)
    assert np.isnan(stiffness.compute_slope(UP, UP, np.array([0.03496, 1.0]))).all()
    assert np.isfinite(stiffness.compute_slope(UP, UP, 0.03))


def test_slope_says_why_not() -> None:
    outcome = return_failure(choose_window)(TIME, UP, UP, UP, start=0.005, stop=0.05)
    message = "the branch reaches 0.03995 m, 0.05 m is needed"
    assert outcome == Failure("not_reached", message)
    few = return_failure(choose_window)(TIME, UP, UP, UP, start=0.00501, stop=0.0053)
    assert few == Failure("too_few_samples", "5 samples in the stretch, 8 are needed")
    still = return_failure(choose_window)(TIME, np.ones_like(UP), UP, UP, start=0.005, stop=0.009)
    assert still == Failure("no_travel", "the displacement does not change over the stretch")
    blank = return_failure(choose_window)(
        TIME, np.full_like(UP, np.nan), UP, np.full_like(UP, np.nan), start=0, stop=1
    )
    assert isinstance(blank, Failure)
    assert blank.code == "not_reached"


def test_value_at_a_turn_is_that_of_the_parabola() -> None:
    """Of 800 samples the first 50; time counts from the turn, in mid-step."""
    values = 3.0 + 0.5 * (TIME - 0.03) - 2.0 * (TIME - 0.03) ** 2
    part = Branch(0, len(TIME), 1, Direction.UNLOADING, 0.03, float(TIME[-1]))
    turn = choose_turn_samples(Trace(TIME, values, values), part)
    assert turn(values) == pytest.approx(3.0, abs=1e-12)
    np.testing.assert_allclose(turn(np.array([values, 2.0 * values])), [3.0, 6.0])
    values[5] = np.nan
    assert choose_turn_samples(Trace(TIME, values, values), part)(values) == pytest.approx(3.0)


BRANCH = Branch(0, len(TIME), 1, Direction.UNLOADING, 0.0, float(TIME[-1]))


def unloading(sense: float) -> tuple[Callable[[Floats, Floats], Floats], Floats, Floats]:
    """Back from 50 mm, under 300 (d - 10 mm)^2; read from 1 to 10 mm off the turn."""
    path, force = sense * (0.05 - UP), sense * 300.0 * (0.05 - UP - 0.01) ** 2
    slope, _ = choose_unloading_window(Trace(TIME, path, force), BRANCH, length=0.01, sense=sense)
    return slope, path, force


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_unloading_is_read_behind_its_turn(sense: float) -> None:
    """In the middle 5.5 mm off the turn: 2 x 300 x 34.5 mm."""
    slope, path, force = unloading(sense)
    assert slope(path, force) == pytest.approx(20.7, rel=1e-3)


def test_a_row_that_is_higher_throughout_is_read_from_the_same_samples() -> None:
    compute, path, force = unloading(1.0)
    rows = path + np.array([[0.0], [0.003], [-0.02]])
    np.testing.assert_allclose(compute(rows, force), compute(path, force), rtol=1e-9)
    begun = choose_loading_window(TIME, UP, taking_up(UP), length=0.005)
    rows = UP + np.array([[0.0], [0.003], [-0.02]])
    expected = begun.compute_slope(UP, taking_up(UP))
    np.testing.assert_allclose(begun.compute_slope(rows, taking_up(UP)), expected, rtol=1e-9)


def taking_up(path: Floats) -> Floats:
    """Slack up to 5 mm, then 20 N/m that grow by 0.8 N/m each mm."""
    beyond = np.maximum(path - 0.005, 0.0)
    return 20.0 * beyond + 400.0 * beyond**2


def test_loading_is_read_behind_the_take_up() -> None:
    """Of 20 x + 400 x^2 over 5 mm: 20 + 800 x 2.5 mm.

    80 mN less begin at 3.72 mm, where 20 x + 400 x^2 is 80 mN: 800 x 3.72 mm more N/m.
    """
    slope = choose_loading_window(TIME, UP, taking_up(UP), length=0.005)
    assert slope.onset.find_start(UP, taking_up(UP))[0] == pytest.approx(0.005, abs=2e-4)
    plain, lower = slope.compute_slope(UP, taking_up(UP) - np.array([[0.0], [0.08]]))
    assert plain == pytest.approx(22.0, rel=5e-3)
    assert lower - plain == pytest.approx(2.978, rel=0.01)
    assert isinstance(return_failure(choose_loading_window)(TIME, UP, -UP, length=0.005), Failure)
    # Samples are those of the branch, of which the first ones may be unknown.
    late = taking_up(UP) + noise_rows("white", 1e-3, (1, len(UP)), seed=1)
    late[:, :30] = np.nan
    taut = find_force_onset(UP, late[0])
    first = int(taut.find_start(UP, late[0])[1])
    assert late[0, first - 1] <= taut.limit < late[0, first]


def test_loading_of_replicates_is_off_as_tests_are() -> None:
    """They scatter as much, and are off as much on average, for what noise hides of the foot."""
    time, over, kind = np.arange(0.0, 20.0, 0.01), 0.005, "remembering"
    up, shape = 1e-3 * time, (200, len(time))
    force = 40.0 * np.minimum(np.maximum(up - 0.005, 0.0), 0.002) + taking_up(up)
    path = up + noise_rows(kind, 2e-5, shape, seed=1)
    forces = force + noise_rows(kind, 2e-3, shape, seed=2)
    alone = [
        choose_loading_window(time, d, f, length=over) for d, f in zip(path, forces, strict=True)
    ]
    fits = zip(alone, path, forces, strict=True)
    tests = [float(fit.compute_slope(d, f)) for fit, d, f in fits]
    measured = alone[-1]
    smooth = choose_loading_window(time, up, force, length=over, limit=measured.onset.limit)
    drawn = (
        noise_rows(kind, deviation, shape, seed=seed) for deviation, seed in ((2e-5, 3), (2e-3, 4))
    )
    rows = smooth.compute_slope(up + next(drawn), force + next(drawn), has_noise=True)
    off = rows - float(smooth.compute_slope(up, force))
    x = np.linspace(0.0, over, 5001)
    lever = x - x.mean()
    true = lever @ (40.0 * np.minimum(x, 0.002) + 20.0 * x + 400.0 * x**2) / (lever @ x)
    assert np.std(off) == pytest.approx(np.std(tests), rel=0.25)
    assert np.mean(off) == pytest.approx(np.mean(tests) - true, abs=0.35 * float(np.std(tests)))


def test_samples_at_rest_in_the_window_are_counted() -> None:
    """100 of 200 samples wait where the force takes up; without them two in a hundred are there."""
    path = np.concatenate(
        [np.zeros(100), np.linspace(0.0, 0.005, 100, endpoint=False), [0.006] * 9]
    )
    time = np.arange(0.0, float(len(path)))
    for first, share in ((0, 0.51), (100, 0.02)):
        part = slice(first, None)
        taken = path[part]
        slope = choose_window(time[part], taken, taken, taken, start=0.0, stop=0.00495)
        taut = find_force_onset(UP, taking_up(UP))
        loading_slope = LoadingSlope(taut, first, slope, 0.0)
        assert loading_slope.start_sample_fraction == pytest.approx(share, abs=0.03)


def test_between_samples_the_window_begins_with_the_motion() -> None:
    """Six samples at rest under 2 mN, which are beyond the noise, lie in the window by samples.

    The line through the foot is zero 53 um before the motion, a sample at this speed. From there
    over 5 mm the force rises by 52.66 N/m: 60 - 2 x 1500 x 2.447e-3, in the middle.
    """
    way = 1e-3 * np.maximum(np.arange(400.0) * 0.05 - 0.301, 0.0)
    force = 60.0 * way - 1.5e3 * way**2
    force += np.where(way > 0.0, 0.0, 2e-3) * (np.arange(400) > 0)
    time = 0.05 * np.arange(400.0)
    window = choose_loading_window(time, way, force, length=0.005)
    assert window.first_taut_sample == 1
    assert float(window.compute_slope(way, force)) > 52.8
    at = np.arange(16 * 399 + 1) / 16.0
    fine = [np.interp(at, np.arange(400), values) for values in (time, way, force)]
    between = choose_loading_window(*fine, length=0.005, limit=window.onset.limit, parts=16)
    assert between.first_taut_sample / 16 == pytest.approx(6.02 - 1.06, abs=0.1)
    assert float(between.compute_slope(fine[1], fine[2])) == pytest.approx(52.66, abs=0.06)


def test_textbook() -> None:
    """A beam of known EI: K = 3 EI / L^3 of a cantilever, 48 EI / L^3 in three-point bending."""
    for support, divisor in (("cantilever", 3.0), ("three-point", 48.0)):
        stiffness = divisor * 0.12 / 0.1143**3
        assert stiffness * compute_beam_factor(0.1143, support) == pytest.approx(0.12, rel=1e-12)


@pytest.mark.parametrize(
    ("rollers", "low", "high", "ratio"),
    [
        (Rollers(0.1), 0.0, 1e-5, 0.999994),  # as a straight beam
        (Rollers(0.1, 0.005, 0.2), 0.0, 1e-5, 1.000861),
        (Rollers(0.1524), 2e-3, 0.02, 0.833545),  # on knife edges it slides through
        (Rollers(0.1524, 0.012), 2e-3, 0.02, 0.970514),  # rollers shorten the span
        (Rollers(0.1524, 0.012, 0.2), 2e-3, 0.02, 1.040978),  # and friction holds it
    ],
)
def test_stiffness_beside_that_of_a_straight_beam(
    rollers: Rollers, low: float, high: float, ratio: float
) -> None:
    assert return_failure(compute_stiffness_ratio)(rollers, start=low, stop=high) == pytest.approx(
        ratio, abs=1e-6
    )


def test_the_load_on_knife_edges_has_a_largest_value() -> None:
    """Beyond it the beam slips through between the supports under a dead load."""
    deflection, load = compute_roller_load(Rollers(1.0))
    top = int(np.argmax(load))
    assert deflection[top] == pytest.approx(0.238, abs=2e-3)
    assert load[top] == pytest.approx(6.672, abs=2e-3)
    assert (np.diff(deflection) > 0.0).all()


def test_what_is_beyond_an_elastic_beam() -> None:
    """Where it slips through, and a stretch in which geometry decides."""
    for low, high, messages in (
        (0.0, 0.2, ["slips through at 61.76 mm, and the window of the stiffness ends at 200 mm"]),
        (0.01, 0.03, ["from 10 mm to 30 mm the load on an elastic beam rises 0.2", "at least 0.5"]),
    ):
        failure = return_failure(compute_stiffness_ratio)(Rollers(0.1), start=low, stop=high)
        assert isinstance(failure, Failure)
        assert failure.code == "beyond_elastica"
        assert all(message in failure.message for message in messages)


F = np.linspace(0.0, 1000.0, 201)


D = 1e-4 * (1.0 - np.exp(-F / 30.0)) + 2e-7 * F


def test_says_why_not() -> None:
    for d, f, stop, code, message in (
        (D, F, 2000.0, "not_reached", "the force reaches 1000 N, the window ends at 2000 N"),
        (D[:0], F[:0], 900.0, "not_reached", "the force reaches 0 N, the window ends at 900 N"),
        (D[::50], F[::50], 900.0, "too_few_samples", "3 samples in the stretch, 5 are needed"),
    ):
        assert return_failure(find_compliance_window)(d, f, start=300.0, stop=stop) == Failure(
            code, message
        )
    for force in (np.full(201, 900.0), np.repeat([0.0, 950.0], [100, 101])):
        still = return_failure(find_compliance_window)(D, force, start=300.0, stop=900.0)
        assert isinstance(still, Failure)
        assert still.code == "too_few_samples"


def test_a_window_reaches_at_most_two_percent_before_the_first_sample() -> None:
    window = LineStiffness(start=0.002, stop=0.012)

    def loading(first: float) -> Trace:
        d = np.arange(first, 0.02, 1e-3)
        return Trace(d, d, d, (Branch(0, len(d), 1, Direction.LOADING, d[0], d[-1]),))

    assert window.select_samples(loading(0.00219)) == slice(0, 10)
    assert return_failure(window.select_samples)(loading(0.00221)) == Failure(
        "not_reached", "the branch begins at 2.21 mm, 2 mm is needed"
    )


def test_compliance_of_many_rows() -> None:
    """Steps of 5 N: 300 N are in sample 60, 900 N in 180; missing samples are left out."""
    window = return_failure(find_compliance_window)(D, F, start=300.0, stop=900.0)
    assert window == slice(60, 181)
    straight = 2e-7 * F
    rows = compute_slope(F[window], np.array([straight, 3.0 * straight + 1e-4])[:, window])
    np.testing.assert_allclose(rows, [2e-7, 6e-7])
    holes = D.copy()
    holes[100] = np.nan
    window = return_failure(find_compliance_window)(holes, F, start=300.0, stop=900.0)
    assert isinstance(window, np.ndarray)
    assert window.tolist() == [index for index in range(60, 181) if index != 100]


def test_every_row_has_its_own_line() -> None:
    """No travel and no rise are no number."""
    x = np.array([[0.0, 1.0, 2.0], [0.0, 2.0, 4.0]])
    y = np.array([[1.0, 2.0, 6.0], [1.0, 2.0, 6.0]])
    np.testing.assert_allclose(compute_slope(x, y), [2.5, 1.25])
    np.testing.assert_allclose(compute_slope(x, y[0]), [2.5, 1.25])
    np.testing.assert_allclose(compute_slope(x[0], y[np.newaxis]), [[2.5, 2.5]])
    # means 1 and 3 of x and y: 1 - 3 / 2.5, and 2 - 3 / 1.25
    np.testing.assert_allclose(compute_zero_crossing(x, y), [-0.2, -0.4])
    still, falls = np.array([[1.0, 1.0, 1.0], [0.0, 1.0, 2.0]]), np.array([3.0, 2.0, 1.0])
    np.testing.assert_array_equal(compute_slope(still, falls), [np.nan, -1.0])
    assert np.isnan(compute_zero_crossing(still, falls)).all()


def test_weights_give_the_polynomial_of_numpy() -> None:
    rng = np.random.default_rng(0)
    x, rows = np.sort(rng.uniform(-0.3, 1.1, 40)), rng.normal(size=(3, 40))
    for degree in range(4):
        expected = np.polynomial.polynomial.polyfit(x, rows.T, degree)
        weights = compute_polynomial_weights(x, degree=degree)
        np.testing.assert_allclose(weights @ rows.T, expected, rtol=1e-9)
