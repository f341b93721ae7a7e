from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats, Samples
from labpipe.records.estimates import Failure, return_failure
from labpipe.results.curves import compute_zero_crossing
from labpipe.results.slack_and_slips import find_linear_region
from labpipe.results.stiffness import ForceOnset, find_force_onset
from labpipe.uncertainty.autocorrelation import scale_limit_by_noise
from tests.builders.noise_rows import KINDS, noise_rows

D = np.concatenate([np.full(100, 0.002), np.linspace(0.002, 0.012, 500)])


"""A string gets taut first, then pulls."""


F: Floats = 500.0 * (D - 0.002)


def test_where_the_force_takes_up_without_noise() -> None:
    """With missing samples, from just above zero, and from the other side of it."""
    holes = F.copy()
    holes[::7] = np.nan
    path = np.linspace(-0.003, 0.01, 400)
    passing = 500.0 * (path - 0.001) + 0.001 * np.sin(np.arange(400.0))
    for d, f, place, off in (
        (D, holes, 0.002, 1e-6),
        (D[103:], F[103:], 0.002, 1e-6),
        (path, passing, 0.001, 1e-5),
    ):
        taut = find_force_onset(d, f)
        onset_place, sample = taut.find_start(d, f)
        assert onset_place == pytest.approx(place, abs=off)
        assert f[sample] > 0.0
    assert find_force_onset(D[103:], F[103:]).find_start(D[103:], F[103:])[1] == 0


def test_says_why_not() -> None:
    assert return_failure(find_force_onset)(D[:10], F[:10]) == Failure(
        "too_few_samples", "10 samples, 16 are needed"
    )
    noise = np.random.default_rng(0).normal(0.0, 0.004, len(D))
    flat = return_failure(find_force_onset)(D, noise)
    assert isinstance(flat, Failure)
    assert flat.code == "no_force"
    assert flat.message.startswith("the force reaches 0.01")
    loaded = return_failure(find_force_onset)(D, F + 3.0 + noise)
    assert isinstance(loaded, Failure)
    assert loaded.code == "not_unloaded"
    assert loaded.message.startswith("the branch begins at 3.")


def test_take_up_of_many_rows() -> None:
    """0.5 N less over 500 N/m: 1 mm later."""
    onset = find_force_onset(D, F)
    rows, _ = onset.find_start(D, np.array([F, F - 0.5]))
    np.testing.assert_allclose(rows, [0.002, 0.003], atol=1e-12)
    moved, _ = onset.find_start(D + np.array([[0.0], [0.004]]), F)
    np.testing.assert_allclose(moved, [0.002, 0.006], atol=1e-12)


def test_take_up_without_a_line_is_at_the_first_sample() -> None:
    path, force = np.full(40, 0.001), np.where(np.arange(40) < 30, 0.0, 5.0)
    onset = find_force_onset(path, force)
    assert np.isnan(onset.extrapolate_to_zero(path, force)[0])
    assert onset.find_start(path + np.array([[0.0], [1.0]]), force)[0].tolist() == [0.001, 1.001]


def test_take_up_of_a_curve_without_noise() -> None:
    """What passes for zero on the curve that was measured passes for it here too."""
    measured = find_force_onset(D, F + np.random.default_rng(1).normal(0.0, 0.004, len(D)))
    assert measured.limit == pytest.approx(4 * 0.004, rel=0.2)
    again = find_force_onset(D, F, limit=measured.limit)
    sample = int(again.find_start(D, F)[1])
    assert F[sample - 1] <= measured.limit < F[sample]


@pytest.mark.parametrize(("limit", "kind"), [(0.08, KINDS[0]), (0.01, KINDS[-1])])
@pytest.mark.parametrize("gaps", [slice(0), slice(None, None, 7)])
def test_take_up_decided_for_each_row(kind: str, limit: float, gaps: slice) -> None:
    """Rows with gaps, rows that begin under load, and one that never takes up.

    The foot has some thirty samples, or the least that it may have.
    """
    force = F + noise_rows(kind, 0.25 * limit, (60, len(D)), seed=1)
    force[20:30, :100] += 3.0
    force[30] = limit * (0.6 - np.linspace(0.0, 0.1, len(D)))
    path = D + noise_rows(kind, 1e-5, force.shape, seed=2)
    force[:, 250:260] = np.nan
    path[:, gaps] = np.nan
    onset = find_force_onset(path[0], force[0], limit=limit)
    places, samples = onset.find_start(path, force)
    limits = scale_limit_by_noise(limit, force[:, onset.samples])
    for d, f, own, place, sample in zip(path, force, limits, places, samples, strict=True):
        alone = return_failure(find_force_onset)(d, f, limit=float(own))
        if isinstance(alone, ForceOnset):
            own_place, own_sample = alone.find_start(d, f)
            assert sample == own_sample
            assert place == pytest.approx(float(own_place), rel=1e-9)
    assert np.isfinite(places).all()


def test_how_far_a_line_is_followed_back() -> None:
    """0.1 mm before the first sample, or 1 mm, of a branch of 10 mm."""
    near, far = (
        find_force_onset(D[100:], F[100:] + 0.05),
        return_failure(find_force_onset)(D[100:], F[100:] + 0.5),
    )
    assert near.find_start(D[100:], F[100:] + 0.05)[0] == pytest.approx(0.0019)
    assert isinstance(far, Failure)
    assert far.code == "not_unloaded"


D_TOE = np.linspace(0.0, 0.02, 401)


F_TOE = 5000.0 * np.maximum(D_TOE - 0.002, 0.0)


def region_of(d: Floats, f: Floats, start: float = 0.1, stop: float = 0.3) -> Samples | Failure:
    return return_failure(find_linear_region)(d, f, start_fraction=start, stop_fraction=stop)


def test_says_why_not_of_toe() -> None:
    few = region_of(D_TOE[:5], F_TOE[:5])
    assert few == Failure("too_few_samples", "5 samples, 8 are needed")
    late = region_of(D_TOE[150:], F_TOE[150:])
    assert late == Failure("not_reached", "the branch begins at 27.5 N, above 10% of 90 N")
    coarse = region_of(D_TOE[::40], F_TOE[::40])
    assert coarse == Failure("too_few_samples", "2 samples in the linear region, 8 are needed")
    newtons = np.arange(41.0)  # from 4 N to less than 12 N
    assert region_of(newtons, newtons) == slice(4, 12)
    assert region_of(newtons[:8], newtons[:8]) == coarse


def test_the_line_goes_through_the_samples_between_the_shares() -> None:
    """90 N at the most, 0.25 N a sample from 40 on: 9.09 N lie behind 76, 27.09 N behind 148."""
    whole = slice(77, 149)
    assert region_of(D_TOE, F_TOE, 0.101, 0.301) == whole
    assert compute_zero_crossing(D_TOE[whole], F_TOE[whole]) == pytest.approx(0.002, rel=1e-9)
    holes = F_TOE.copy()
    holes[100] = np.nan
    region = region_of(D_TOE, holes, 0.101, 0.301)
    assert isinstance(region, np.ndarray)
    assert region.tolist() == [index for index in range(77, 149) if index != 100]
    flat = np.repeat([0.0, 1.0, 2.0], [10, 20, 10])
    assert region_of(np.zeros(40), flat, stop=0.9) == Failure(
        "not_rising", "the force does not rise in the linear region"
    )
