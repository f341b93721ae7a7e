from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.estimates import Estimate, Failure, return_failure
from labpipe.results.bending import fit_secant_stiffness
from labpipe.results.curves import CommonPath, find_finite_samples
from labpipe.results.cycles import (
    UnloadingEnd,
    _extrapolate_foot,
    find_unloading_end,
    integrate_energy,
)
from labpipe.results.kinds import compute_loading_sign
from tests.builders.noise_rows import KINDS, noise_rows

STIFFNESS = 20.0


SECONDS = np.arange(0.0, 4.0, 0.02)


def secant(path: Floats, force: Floats, part: slice = slice(None)) -> Estimate | Failure:
    inside = np.zeros(len(SECONDS), dtype=bool)
    inside[part] = True
    return return_failure(fit_secant_stiffness)(SECONDS, path, force, inside)


def test_stiffness_is_exact_on_a_line() -> None:
    exact = secant(1e-3 * SECONDS, 0.02 * SECONDS + 1.0)
    assert isinstance(exact, Estimate)
    assert exact.value == pytest.approx(STIFFNESS, rel=1e-12)
    assert exact.n == 200
    few = Failure("too_few_samples", "0 samples in the stretch, 8 are needed")
    assert secant(SECONDS, SECONDS, slice(0)) == few
    still = Failure("no_travel", "the displacement does not change over the stretch")
    assert secant(np.ones(200), SECONDS) == still


def test_stiffness_is_not_made_small_by_a_noisy_displacement() -> None:
    estimates = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        path = 1e-3 * SECONDS + rng.normal(0, 3e-4, 200)
        noisy = secant(path, 0.02 * SECONDS + rng.normal(0, 1e-3, 200))
        assert isinstance(noisy, Estimate)
        estimates.append((noisy.value, (noisy.value - STIFFNESS) / noisy.error))
    values, pulls = np.array(estimates).T
    assert np.mean(values) == pytest.approx(STIFFNESS, rel=5e-3)  # that of plain lines is 5 % less
    assert np.std(pulls) == pytest.approx(1.0, abs=0.12)


def test_sense_of_loading() -> None:
    nan = float("nan")
    for values in ([0.0, 50.0, 100.0, 0.0], [50.0, 75.0, 100.0, 0.0], [nan, -20.0, 15.0], [nan]):
        assert compute_loading_sign(np.array(values)) == 1.0
    assert compute_loading_sign(np.array([0.0, -50.0, -100.0])) == -1.0


def test_energy_of_many_rows_is_the_trapezoid_of_each() -> None:
    rng = np.random.default_rng(3)
    d, f = rng.normal(size=(2, 3, 40))
    expected = [float(np.trapezoid(force, path)) for path, force in zip(d, f, strict=True)]
    np.testing.assert_allclose(integrate_energy(d, f), expected, rtol=1e-12)
    exact = [float(np.trapezoid(force, d[0])) for force in f]
    np.testing.assert_allclose(integrate_energy(d[0], f), exact, rtol=1e-12)
    # 1 N over 2 mm, then 3 N over 1 mm, halfway from one to the other in between
    assert integrate_energy(
        np.array([0.0, 2e-3, 3e-3]), np.array([1.0, 1.0, 3.0])
    ) == pytest.approx(4e-3)


D = np.linspace(1e-3, 5e-3, 201)


ALL = np.arange(len(D))


def test_a_sample_moved_along_the_curve_keeps_its_place_on_it() -> None:
    moved = D + np.random.default_rng(0).normal(0.0, 2e-5, (3, len(D)))
    bent, curvature = 800.0 * D - 2e4 * D**2, 2 * 2e4
    moved_force = CommonPath.of(D, bent, ALL).move_force(800.0 * moved - 2e4 * moved**2, moved)
    second_order = 0.5 * curvature * (moved - D) ** 2
    assert np.abs(800.0 * (moved - D)).max() > 0.02
    # Slopes at the ends are read from one side: off by the curvature over half of four steps.
    one_sided = curvature * 2 * (D[1] - D[0]) * np.abs(moved - D)
    assert (np.abs(moved_force - bent) <= second_order + one_sided + 1e-12).all()


def test_where_the_frame_stands_the_slope_is_that_of_the_stretch() -> None:
    d = np.concatenate([D[:100], np.full(40, D[100]), D[100:]])
    slope = CommonPath.of(d, 500.0 * d, np.arange(len(d))).slope
    assert np.isfinite(slope).all()
    assert slope == pytest.approx(500.0)


def test_some_samples_in_another_order() -> None:
    force, d = 900.0 * D, D.copy()
    force[4] = d[9] = np.nan
    assert find_finite_samples(d, force).tolist() == np.delete(ALL, [4, 9]).tolist()
    mixed = np.random.default_rng(0).permutation(find_finite_samples(d, force))
    kinked = np.where(D < 3e-3, 900.0, 300.0) * (D - 3e-3)
    path, plain = CommonPath.of(d, kinked, mixed), CommonPath.of(D, kinked, ALL)
    assert plain.slope[[0, 90, 100, 110, 200]] == pytest.approx([900, 900, 600, 300, 300])
    assert path.slope[D[mixed] < 2.8e-3] == pytest.approx(900.0)
    assert path.displacement.tolist() == D[mixed].tolist()
    curves = kinked + np.array([[0.0], [2.0]])
    assert path.move_force(curves, D + 1e-5) == pytest.approx(
        plain.move_force(curves, D + 1e-5)[:, mixed], abs=2e-3
    )
    assert path.move_force(curves).tolist() == curves[:, mixed].tolist()


def test_the_same_displacements_change_nothing() -> None:
    path = CommonPath.of(D, 900.0 * D, ALL)
    force = np.array([900.0 * D, 5.0 + 0.0 * D])
    assert np.shares_memory(path.move_force(force), force)
    assert np.shares_memory(path.move_force(force, D), force)
    moved = path.move_force(force, D + np.where(ALL == 3, 1e-3, 0.0))
    assert (force - moved)[:, [2, 3]] == pytest.approx(np.array([[0.0, 0.9], [0.0, 0.9]]))


TIME = np.arange(0.0, 53.0, 0.02)


PATH = 0.053 - 1e-3 * TIME


LEFT = 0.012


FORCE = 24.0 * (PATH - LEFT)


LIMIT = 5e-3


WAYS = {
    "through zero": (PATH, FORCE),
    "at rest": (np.maximum(PATH, LEFT), np.maximum(FORCE, 0.0)),
    "extrapolated": (PATH, np.maximum(FORCE, 0.0)),
}


"""The three ways to end, at 12 mm: through zero, with a string that gets slack, and followed."""


def decided(path: Floats, force: Floats, like: UnloadingEnd | None = None) -> UnloadingEnd:
    ending = return_failure(find_unloading_end)(
        TIME, path, force, force_below=LIMIT, measured_end=like
    )
    assert not isinstance(ending, Failure), ending
    return ending


@pytest.mark.parametrize("way", WAYS)
def test_it_is_where_the_force_is_back_at_zero(way: str) -> None:
    """Gaps are passed over; rows are as each alone, and a foot that rises is no number."""
    path, force = WAYS[way]
    plain = decided(path, force)
    assert plain.kind == way
    assert plain.compute(path, force) == pytest.approx(LEFT, abs=1e-12)
    rng = np.random.default_rng(1)
    paths, forces = (point + rng.normal(0, 1e-5, (3, len(TIME))) for point in (path, force))
    alone = [plain.compute(d, f) for d, f in zip(paths, forces, strict=True)]
    np.testing.assert_allclose(plain.compute(paths, forces), alone, rtol=1e-12)
    holes = force.copy()
    holes[::9] = np.nan
    assert decided(path, holes).compute(path, holes) == pytest.approx(LEFT, abs=1e-9)
    if way == "through zero":  # a tenth of 53 s on each side of 41 s, 50 a second
        assert plain.n == 529
    if way == "extrapolated":  # from five limits to one, at 24 mN a second
        assert plain.limit == LIMIT
        rising = plain.compute(path, np.array([force, force[::-1]]))
        assert np.isnan(rising).tolist() == [False, True]


@pytest.mark.parametrize(
    ("way", "moved"), [("through zero", 1e-4), ("extrapolated", 1e-4), ("at rest", 0)]
)
def test_a_force_that_is_too_high_by_so_much_is_zero_so_much_later(way: str, moved: float) -> None:
    """2.4 mN over 24 N/m: 0.1 mm less; a string at rest is not asked for its force."""
    path, force = WAYS[way]
    plain = decided(path, force)
    higher = force + np.where((force > 0.0) | (way == "through zero"), 2.4e-3, 0.0)
    assert plain.compute(path, higher) - plain.compute(path, force) == pytest.approx(
        -moved, abs=1e-9
    )


def test_through_zero_by_hand() -> None:
    """A force 5 (t - t_0) + 2 (t - t_0)^2, and a displacement that is 4 mm then."""
    since = TIME - 41.013
    force = -0.05 * since + 2e-4 * since**2
    path = 0.004 - 1e-3 * since + 1e-5 * since**2
    ending = decided(path, force)
    assert ending.kind == "through zero"
    assert ending.compute(path, force) == pytest.approx(0.004, abs=1e-12)


def test_a_foot_of_few_samples_is_not_followed() -> None:
    """The force is lost between two samples: the displacement is that of the last one above."""
    force = np.where(TIME < 40.0, 1.0, 0.0)
    ending = decided(PATH, force)
    assert ending.kind == "extrapolated"
    rows = ending.compute(np.array([PATH, PATH + 0.001]), force)
    np.testing.assert_allclose(rows, [PATH[1999], PATH[1999] + 0.001], atol=1e-12)


@pytest.mark.parametrize(("rate", "zero"), [(-0.5, 8.0), (0.5, 4.0)])
def test_a_foot_that_does_not_fall_ends_at_its_last_sample(rate: float, zero: float) -> None:
    """2 N at 4 s, where the force is lost, that fall by half a newton a second, or rise."""
    time = 0.1 * np.arange(60.0)
    force = np.where(time < 4.05, 2.0 + rate * (time - 4.0), 0.0)
    ends, slopes, last = _extrapolate_foot(time, force[None], np.array([[0.9]]))
    assert (ends[0], slopes[0], last[0]) == pytest.approx((zero, min(rate, 0.0), 40))


@pytest.mark.parametrize("way", WAYS)
def test_a_curve_without_noise_ends_as_the_one_that_was_measured(way: str) -> None:
    path, force = WAYS[way]
    rng = np.random.default_rng(2)
    noisy = path + rng.normal(0, 1e-5, len(TIME)), force + rng.normal(0, 2e-3, len(TIME))
    measured = decided(*noisy)
    again = decided(path, force, like=measured)
    assert again.kind == measured.kind == way
    assert again.limit == measured.limit
    # Shown a rest that creeps by more than no noise at all, it is a rest all the same.
    creeping = path - np.where(path <= LEFT, 1e-8 * TIME, 0.0)
    assert decided(creeping, force, like=measured).kind == way


@pytest.mark.parametrize("kind", KINDS)
def test_a_foot_decided_for_each_row(kind: str) -> None:
    """Rows with gaps, one that does not come back to zero, one that never is above the limit."""
    path, force = WAYS["extrapolated"]
    force = force + noise_rows(kind, 2e-4, (40, len(TIME)), seed=1)
    path = path + noise_rows(kind, 1e-5, force.shape, seed=2)
    force[:10, 2000:2008] = np.nan
    path[:, 1900::7] = np.nan
    force[20] += 0.1
    force[21] -= 1.0
    force[22, 2045:] += 0.006
    end = decided(path[10], force[10])
    assert end.kind == "extrapolated"
    for d, f, place in zip(path[10:], force[10:], end.compute(path[10:], force[10:]), strict=True):
        alone = return_failure(find_unloading_end)(TIME, d, f, force_below=LIMIT, measured_end=end)
        if isinstance(alone, Failure):
            assert np.isnan(place)
        else:
            assert place == pytest.approx(float(alone.compute(d, f)), rel=1e-9)
    assert np.isfinite(end.compute(path[:10], force[:10])).all()


def test_a_weak_force_is_not_followed_from_far_off() -> None:
    """22 mN at the most, curved, through zero: a straight line from 5 mN would end at 20 mm."""
    beyond = PATH - LEFT
    force = 0.27 * beyond + 5.5 * beyond**2
    ending = decided(PATH, force)
    assert ending.compute(PATH, force) == pytest.approx(LEFT, abs=1e-4)


def test_a_force_that_does_not_come_back_to_zero() -> None:
    """It is not extrapolated; 4 mN are below the limit, but a fifth of what a specimen bore."""
    beyond = PATH - 0.01
    loaded = beyond > 0.012
    weak = (0.27 * beyond + 5.5 * beyond**2)[loaded]
    for part, force, message in (
        (slice(1500), FORCE[:1500], "above the limit of 0.005 N"),
        (loaded, weak, "the force ends at 0.004"),
    ):
        failure = return_failure(find_unloading_end)(
            TIME[part], PATH[part], force, force_below=LIMIT
        )
        assert isinstance(failure, Failure)
        assert failure.code == "force_not_zero"
        assert message in failure.message


def test_too_few() -> None:
    few = np.linspace(0.0, 1.0, 10)
    outcome = return_failure(find_unloading_end)(few, few, 1.0 - few, force_below=LIMIT)
    assert outcome == Failure("too_few_samples", "10 samples, 16 are needed")
    ramp, noise = np.linspace(0.0, 1.0, 40), np.tile([0.01, -0.01], 20)
    outcome = return_failure(find_unloading_end)(ramp, ramp, noise, force_below=LIMIT)
    assert outcome == Failure("too_few_samples", "40 samples, none above 0.04322 N")
    sparse = np.arange(0.0, 60.0, 1.0)
    path, fallen = 0.053 - 1e-3 * sparse, np.maximum(50.0 - sparse, 0.0)
    outcome = return_failure(find_unloading_end)(sparse, path, fallen, force_below=LIMIT)
    assert outcome == Failure("too_few_samples", "2 samples in the second before 49.000 s")


@pytest.mark.parametrize(("lasts", "way"), [(0.5, "extrapolated"), (0.8, "at rest")])
def test_a_rest_is_seen_once_the_line_were_three_limits_lower(lasts: float, way: str) -> None:
    """15 mN at 24 mN a second are 0.625 s."""
    path, force = WAYS["at rest"]
    part = lasts + 41.0 >= TIME
    assert find_unloading_end(TIME[part], path[part], force[part], force_below=LIMIT).kind == way


@pytest.mark.parametrize(("pulls", "creeps"), [(0.0, 0.0), (-0.0125, 0.0), (0.0, 2e-6)])
def test_a_string_that_pulls_or_a_specimen_that_creeps_is_not_at_rest(
    pulls: float, creeps: float
) -> None:
    """Two and a half limits below zero for some seconds; 2 um in 12 s, under 0.1 um of noise."""
    path, force = WAYS["at rest"]
    since = np.maximum(TIME - 41.0, 0.0)
    force = force + np.where((since > 4.0) & (since < 8.0), pulls, 0.0)
    noise = np.random.default_rng(4).normal(0.0, 1e-7, len(TIME))
    ending = decided(path - creeps * since / 12.0 + noise, force)
    assert ending.kind == ("at rest" if pulls == creeps == 0.0 else "extrapolated")


def test_little_noise_does_not_lower_what_passes_for_zero() -> None:
    """A record of no noise beside noisy ones: its foot ends at the protocol's limit."""
    path, force = WAYS["extrapolated"]
    force = force + noise_rows("white", 1.5e-3, (4, len(TIME)), seed=1)
    force[3] = WAYS["extrapolated"][1] + 1e-4 * (TIME - 41.5) * (TIME < 41.0)
    ending = decided(path, force[0])
    assert ending.kind == "extrapolated"
    assert ending.limit > LIMIT
    alone = decided(path, force[3])
    assert alone.kind == "extrapolated"
    assert alone.limit == LIMIT
    paths = path + 1e-3 * (TIME - 41.0) ** 2 * (TIME < 41.0) + np.zeros((4, 1))
    number = ending.compute(paths, force)[3]
    assert number == pytest.approx(float(alone.compute(paths[3], force[3])), rel=1e-9)
