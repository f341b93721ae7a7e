"""Displacement left at zero force: after slack, beyond zero, and where zero is not reached."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.residual_displacement import (
    AtRest,
    FollowedToZero,
    ThroughZero,
    Unloaded,
    unloaded,
)
from labpipe.records.arrays import Floats
from labpipe.records.estimates import Failure
from tests.builders.noise_rows import KINDS, Number, noise_rows, spreads

TIME = np.arange(0.0, 53.0, 0.02)
PATH = 0.053 - 1e-3 * TIME
LEFT = 0.012
FORCE = 24.0 * (PATH - LEFT)
LIMIT = 5e-3
WAYS = {
    ThroughZero: (PATH, FORCE),
    AtRest: (np.maximum(PATH, LEFT), np.maximum(FORCE, 0.0)),
    FollowedToZero: (PATH, np.maximum(FORCE, 0.0)),
}
"""The three ways to end, at 12 mm: through zero, with a string that gets slack, and followed."""


def decided(path: Floats, force: Floats, like: Unloaded | None = None) -> Unloaded:
    found = unloaded(TIME, path, force, force_below=LIMIT, like=like)
    assert not isinstance(found, Failure), found
    return found


@pytest.mark.parametrize("way", WAYS)
def test_it_is_where_the_force_is_back_at_zero(way: type[Unloaded]) -> None:
    path, force = WAYS[way]
    found = decided(path, force)
    assert isinstance(found, way)
    assert found.of(path, force) == pytest.approx(LEFT, abs=1e-12)


@pytest.mark.parametrize("way", WAYS)
def test_rows_are_as_each_alone(way: type[Unloaded]) -> None:
    path, force = WAYS[way]
    rng = np.random.default_rng(1)
    paths, forces = (each + rng.normal(0, 1e-5, (3, len(TIME))) for each in (path, force))
    found = decided(path, force)
    alone = [found.of(d, f) for d, f in zip(paths, forces, strict=True)]
    np.testing.assert_allclose(found.of(paths, forces), alone, rtol=1e-12)


@pytest.mark.parametrize(
    ("way", "moved"), [(ThroughZero, 1e-4), (FollowedToZero, 1e-4), (AtRest, 0)]
)
def test_a_force_that_is_too_high_by_so_much_is_zero_so_much_later(
    way: type[Unloaded], moved: float
) -> None:
    """2.4 mN over 24 N/m: 0.1 mm less; a string at rest is not asked for its force."""
    path, force = WAYS[way]
    found = decided(path, force)
    higher = force + np.where(force > 0.0, 2.4e-3, 0.0)
    if way is ThroughZero:
        higher = force + 2.4e-3
    assert found.of(path, higher) - found.of(path, force) == pytest.approx(-moved, abs=1e-9)


def test_through_zero_by_hand() -> None:
    """A force 5 (t - t_0) + 2 (t - t_0)^2, and a displacement that is 4 mm then."""
    after = TIME - 41.013
    force = -0.05 * after + 2e-4 * after**2
    path = 0.004 - 1e-3 * after + 1e-5 * after**2
    found = decided(path, force)
    assert isinstance(found, ThroughZero)
    assert found.of(path, force) == pytest.approx(0.004, abs=1e-12)


def test_a_foot_that_no_longer_falls_is_no_number() -> None:
    path, force = WAYS[FollowedToZero]
    found = decided(path, force)
    rows = found.of(path, np.array([force, force[::-1]]))
    assert np.isnan(rows).tolist() == [False, True]


def test_a_foot_of_few_samples_is_not_followed() -> None:
    """The force is lost between two samples: the displacement is that of the last one above."""
    force = np.where(TIME < 40.0, 1.0, 0.0)
    found = decided(PATH, force)
    assert isinstance(found, FollowedToZero)
    assert not found.is_line
    rows = found.of(np.array([PATH, PATH + 0.001]), force)
    np.testing.assert_allclose(rows, [PATH[1999], PATH[1999] + 0.001], atol=1e-12)


def test_gaps_are_passed_over() -> None:
    for path, force in WAYS.values():
        holes = force.copy()
        holes[::9] = np.nan
        assert decided(path, holes).of(path, holes) == pytest.approx(LEFT, abs=1e-9)


@pytest.mark.parametrize("way", WAYS)
def test_a_curve_without_noise_ends_as_the_one_that_was_measured(way: type[Unloaded]) -> None:
    path, force = WAYS[way]
    rng = np.random.default_rng(2)
    noisy = path + rng.normal(0, 1e-5, len(TIME)), force + rng.normal(0, 2e-3, len(TIME))
    measured = decided(*noisy)
    again = decided(path, force, like=measured)
    assert type(again) is type(measured) is way
    assert again.limit == measured.limit
    # Shown a rest that creeps by more than no noise at all, it is a rest all the same.
    creeping = path - np.where(path <= LEFT, 1e-8 * TIME, 0.0)
    assert type(decided(creeping, force, like=measured)) is way


@pytest.mark.parametrize("kind", KINDS)
def test_a_foot_decided_for_each_row(kind: str) -> None:
    """Rows with gaps, one that does not come back to zero, one that never is above the limit."""
    path, force = WAYS[FollowedToZero]
    force = force + noise_rows(kind, 2e-4, (40, len(TIME)), seed=1)
    path = path + noise_rows(kind, 1e-5, force.shape, seed=2)
    force[:10, 2000:2008] = np.nan
    path[:, 1900::7] = np.nan
    force[20] += 0.1
    force[21] -= 1.0
    force[22, 2045:] += 0.006
    found = decided(path[10], force[10])
    assert isinstance(found, FollowedToZero)
    for d, f, each in zip(path[10:], force[10:], found.of_each(path[10:], force[10:]), strict=True):
        alone = unloaded(TIME, d, f, force_below=LIMIT, like=found)
        if isinstance(alone, Failure):
            assert np.isnan(each)
        else:
            assert each == pytest.approx(float(alone.of(d, f)), rel=1e-9)
    assert np.isfinite(found.of_each(path[:10], force[:10])).all()


@pytest.mark.parametrize(("kind", "deviation"), [("white", 4e-3), ("remembering", 1e-3)])
def test_a_foot_that_ends_in_noise_is_off_as_tests_are(kind: str, deviation: float) -> None:
    """The last sample beyond the limit is the one that noise lifted."""
    path, force = WAYS[FollowedToZero]
    shape = (200, len(TIME))
    tests = []
    paths = path + noise_rows(kind, 1e-5, shape, seed=1)
    forces = force + noise_rows(kind, deviation, shape, seed=2)
    for d, f in zip(paths, forces, strict=True):
        found = decided(d, f)
        assert isinstance(found, FollowedToZero)
        tests.append(float(found.of(d, f)))
    smooth = decided(path, force, like=found)
    assert isinstance(smooth, FollowedToZero)
    off = smooth.of_each(
        path + noise_rows(kind, 1e-5, shape, seed=3),
        force + noise_rows(kind, deviation, shape, seed=4),
    ) - float(smooth.of(path, force))
    # Quantiles, as a sample of the rest that noise lifts beyond the limit leads far astray.
    low, middle, high = np.quantile(np.array(tests) - LEFT, (0.1, 0.5, 0.9))
    below, centre, above = np.quantile(off, (0.1, 0.5, 0.9))
    assert above - below == pytest.approx(high - low, rel=0.25)
    assert centre == pytest.approx(middle, abs=0.15 * float(high - low))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("way", WAYS)
def test_replicates_scatter_as_tests_do(way: type[Unloaded], kind: str) -> None:
    path, force = WAYS[way]
    shape = (200, len(TIME))
    paths = path + noise_rows(kind, 1e-5, shape, seed=1)
    forces = force + noise_rows(kind, 2e-4, shape, seed=2)

    def decide(d: Floats, f: Floats) -> Number:
        found = decided(d, f)
        assert isinstance(found, way)
        return found.of

    tests, replicates = spreads(decide, paths, forces)
    assert replicates == pytest.approx(tests, rel=0.2)


def test_a_weak_force_is_not_followed_from_far_off() -> None:
    """22 mN at the most, curved, through zero: a straight line from 5 mN would end at 20 mm."""
    beyond = PATH - LEFT
    force = 0.27 * beyond + 5.5 * beyond**2
    found = decided(PATH, force)
    assert found.of(PATH, force) == pytest.approx(LEFT, abs=1e-4)


def test_a_string_that_is_slack_only_for_a_moment() -> None:
    """A quick test: half a second of slack after a fall at 4 mm/s."""
    time = np.arange(0.0, 3.0, 0.02)
    path = np.maximum(0.0107 - 4e-3 * time, 0.0007)
    force = 20.0 * (path - 0.0007)
    found = unloaded(time, path, force, force_below=LIMIT)
    assert isinstance(found, AtRest)
    assert found.of(path, force) == pytest.approx(0.0007, abs=1e-5)
    brief = time < 2.7
    found = unloaded(time[brief], path[brief], force[brief], force_below=LIMIT)
    assert isinstance(found, FollowedToZero)
    assert found.of(path[brief], force[brief]) == pytest.approx(0.0007, abs=5e-5)


def test_it_is_not_extrapolated() -> None:
    found = unloaded(TIME[:1500], PATH[:1500], FORCE[:1500], force_below=LIMIT)
    assert isinstance(found, Failure)
    assert found.code == "force_not_zero"
    assert "above the limit of 0.005 N" in found.message


def test_a_weak_force_that_does_not_come_back_is_no_zero() -> None:
    """4 mN are below the limit of the protocol, but a fifth of what the specimen bore."""
    beyond = PATH - 0.01
    kept = beyond > 0.012
    force = (0.27 * beyond + 5.5 * beyond**2)[kept]
    found = unloaded(TIME[kept], PATH[kept], force, force_below=LIMIT)
    assert isinstance(found, Failure)
    assert found.code == "force_not_zero"
    assert found.message.startswith("the force ends at 0.004")


def test_too_few() -> None:
    few = np.linspace(0.0, 1.0, 10)
    found = unloaded(few, few, 1.0 - few, force_below=LIMIT)
    assert found == Failure("too_few_samples", "10 samples, 16 are needed")
    many, noise = np.linspace(0.0, 1.0, 40), np.tile([0.01, -0.01], 20)
    found = unloaded(many, many, noise, force_below=LIMIT)
    assert found == Failure("too_few_samples", "40 samples, none above 0.04322 N")
    sparse = np.arange(0.0, 60.0, 1.0)
    path, fallen = 0.053 - 1e-3 * sparse, np.maximum(50.0 - sparse, 0.0)
    found = unloaded(sparse, path, fallen, force_below=LIMIT)
    assert found == Failure("too_few_samples", "2 samples in the 1 s to 49.000 s")


def test_how_far_around_zero_force_is_looked_at() -> None:
    """A tenth of 53 s on each side of 41 s, 50 samples a second."""
    found = decided(*WAYS[ThroughZero])
    assert isinstance(found, ThroughZero)
    assert found.n == 529
    assert found.time[-1] == pytest.approx(5.3, abs=0.02)


def test_the_foot_is_from_five_limits_to_one() -> None:
    """From 25 mN to 5 mN at 24 mN a second."""
    found = decided(*WAYS[FollowedToZero])
    assert isinstance(found, FollowedToZero)
    assert found.limit == found.least == LIMIT
    assert -found.foot_time[0] == pytest.approx(20.0 / 24.0, abs=0.03)
    assert found.foot_time[-1] == 0.0


@pytest.mark.parametrize(("lasts", "way"), [(0.5, FollowedToZero), (0.8, AtRest)])
def test_a_rest_is_seen_once_the_line_were_three_limits_lower(
    lasts: float, way: type[Unloaded]
) -> None:
    """15 mN at 24 mN a second are 0.625 s."""
    path, force = WAYS[AtRest]
    part = lasts + 41.0 >= TIME
    assert isinstance(unloaded(TIME[part], path[part], force[part], force_below=LIMIT), way)


@pytest.mark.parametrize(("pulls", "creeps"), [(0.0, 0.0), (-0.0125, 0.0), (0.0, 2e-6)])
def test_a_string_that_pulls_or_a_specimen_that_creeps_is_not_at_rest(
    pulls: float, creeps: float
) -> None:
    """Two and a half limits below zero for some seconds; 2 um in 12 s, under 0.1 um of noise."""
    path, force = WAYS[AtRest]
    after = np.maximum(TIME - 41.0, 0.0)
    force = force + np.where((after > 4.0) & (after < 8.0), pulls, 0.0)
    noise = np.random.default_rng(4).normal(0.0, 1e-7, len(TIME))
    found = decided(path - creeps * after / 12.0 + noise, force)
    assert isinstance(found, AtRest if pulls == creeps == 0.0 else FollowedToZero)


def test_little_noise_does_not_lower_what_passes_for_zero() -> None:
    """A record of no noise beside noisy ones: its foot ends at the protocol's limit."""
    path, force = WAYS[FollowedToZero]
    force = force + noise_rows("white", 1.5e-3, (4, len(TIME)), seed=1)
    force[3] = WAYS[FollowedToZero][1] + 1e-4 * (TIME - 41.5) * (TIME < 41.0)
    found = decided(path, force[0])
    assert isinstance(found, FollowedToZero)
    assert found.limit > found.least == LIMIT
    alone = decided(path, force[3])
    assert isinstance(alone, FollowedToZero)
    assert alone.limit == LIMIT
    paths = path + 1e-3 * (TIME - 41.0) ** 2 * (TIME < 41.0) + np.zeros((4, 1))
    each = found.of_each(paths, force)[3]
    assert each == pytest.approx(float(alone.of(paths[3], force[3])), rel=1e-9)
