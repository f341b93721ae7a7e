"""Slips: found, told from what looks like them, added back."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from labpipe.fits.grip_slips import _fineness, _stands_alone, add_back, find_slips, samples_before
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval, Slip, SlipDecision
from labpipe.records.estimates import Failure

D = np.linspace(0.0, 0.05, 600)
SMOOTH = 45.0 * (1.0 - np.exp(-D / 0.02)) / (1.0 - np.exp(-2.5))


def noise(seed: int = 0) -> Floats:
    return np.random.default_rng(seed).normal(0.0, 0.05, len(D))


def found(force: Floats, min_drop: float = 0.2) -> tuple[Slip, ...]:
    slips = find_slips(D, force, min_drop=min_drop, decision=SlipDecision.REPAIRED)
    assert isinstance(slips, tuple)
    return slips


def test_the_two_slips_of_the_source() -> None:
    force = SMOOTH - 0.47 * (D > 0.01875) - 0.81 * (D > 0.03085) + noise()
    one, two = found(force)
    assert one.position == pytest.approx(0.01875, abs=2 * D[1])
    assert two.position == pytest.approx(0.03085, abs=2 * D[1])
    for slip, drop in ((one, 0.47), (two, 0.81)):
        assert slip.drop_interval.lower < drop < slip.drop_interval.upper
        assert slip.position_interval.lower <= slip.position <= slip.position_interval.upper
        assert D[slip.start] <= slip.position <= D[slip.stop]
        ends = slip.position_interval.lower, slip.position_interval.upper
        assert ends == pytest.approx((D[slip.start], D[slip.stop]), abs=2 * D[1])
    repaired = add_back(force, (one, two))
    assert np.abs(repaired - SMOOTH - noise()).max() < 0.3


def test_a_fall_of_several_samples_and_missing_ones() -> None:
    fall = np.interp(np.arange(600), [300, 304], [0.0, 1.0])
    force = SMOOTH - 1.5 * fall + noise(1)
    force[100] = np.nan
    (slip,) = found(force)
    assert (slip.start, slip.stop) == (300, 304)
    assert slip.drop == pytest.approx(1.5, abs=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_no_slip(seed: int) -> None:
    kink = np.where(D < 0.02, 2000.0 * D, 40.0 + 400.0 * (D - 0.02))
    spike = np.where(np.arange(600) == 300, -8.0, 0.0)
    dip = np.where(np.arange(600) == 200, -0.8, 0.0)
    gone = np.where(D > 0.045, 0.05 * SMOOTH, SMOOTH)
    for force in (SMOOTH, kink, SMOOTH + spike, SMOOTH + dip, gone):
        assert found(force + noise(seed)) == ()


def test_small_drops_are_not_looked_at() -> None:
    assert found(SMOOTH - 0.47 * (D > 0.02) + noise(), min_drop=1.0) == ()


def test_a_force_that_never_changes() -> None:
    for force in (0.0, 3.0):
        assert found(np.full(len(D), force)) == ()


def test_too_few_samples() -> None:
    few = find_slips(D[:20], SMOOTH[:20], min_drop=0.2, decision=SlipDecision.MARKED)
    assert few == Failure("too_few_samples", "20 samples in the branch, 64 are needed")


def ledger(start: int, stop: int, drop: float) -> Slip:
    here = Interval(0.0, 1.0)
    return Slip(0.5, drop, here, here, SlipDecision.CUT, start, stop)


def test_losses_add_up_and_samples_inside_lie_on_a_line() -> None:
    force = np.array([0.0, 1.0, 0.7, 1.0, 2.0, 2.5, 3.5])
    repaired = add_back(force, (ledger(1, 3, 1.0), ledger(4, 5, 0.5)))
    assert repaired == pytest.approx([0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0])
    force[2] = np.nan
    assert np.isnan(add_back(force, (ledger(1, 3, 1.0),))[2])


def test_a_cut_curve_ends_before_its_first_slip() -> None:
    assert samples_before((ledger(4, 5, 0.5), ledger(1, 3, 1.0)), 7) == 2
    assert samples_before((), 7) == 7


@pytest.mark.parametrize("rate", [20, 50, 100, 200, 1000])
def test_what_is_found_does_not_depend_on_the_sampling_rate(rate: int) -> None:
    """Falls over 0.1 s at 5 mm/s, and at once."""
    d = np.arange(0.0, 0.05, 5e-3 / rate)
    for width in (5e-4, 1e-9):
        falls = [np.clip((d - at) / width, 0.0, 1.0) for at in (0.015, 0.0315)]
        jitter = np.random.default_rng(rate).normal(0.0, 0.05, len(d))
        force = 900.0 * d - 0.8 * falls[0] - 1.2 * falls[1] + jitter
        slips = find_slips(d, force, min_drop=0.2, decision=SlipDecision.REPAIRED)
        assert isinstance(slips, tuple)
        for slip, at, drop in zip(slips, (0.015, 0.0315), (0.8, 1.2), strict=True):
            assert slip.position == pytest.approx(at + 0.5 * width, abs=4e-4)
            assert slip.drop == pytest.approx(drop, abs=0.2)


def test_a_long_fall_is_a_yield() -> None:
    fall = np.clip((D - 0.02) / 0.003, 0.0, 1.0)
    assert found(SMOOTH - 1.5 * fall + noise()) == ()


@pytest.mark.parametrize(("rate", "memory"), [(50, 15.0), (100, 10.0), (20, 12.0)])
def test_a_clear_slip_in_slow_noise(rate: int, memory: float) -> None:
    d, factor = np.arange(0.0, 0.05, 5e-3 / rate), np.exp(-1.0 / memory)
    seen = 0
    for seed in range(10):
        kicks = np.random.default_rng(seed).normal(0.0, 0.05, len(d)) * np.sqrt(1.0 - factor**2)
        force = 900.0 * d - 0.6 * (d > 0.02) + lfilter([1.0], [1.0, -factor], kicks)
        slips = find_slips(d, force, min_drop=0.2, decision=SlipDecision.MARKED)
        assert isinstance(slips, tuple)
        seen += len(slips) == 1 and abs(slips[0].position - 0.02) < 1.1 * d[1]
    assert seen >= 9


def test_a_tear_is_no_slip() -> None:
    force = 2000.0 * D - 0.3 * 50.0 * (D > 0.025) + noise()
    assert found(force) == ()
    told = find_slips(D, force, min_drop=0.2, decision=SlipDecision.MARKED, largest_share=0.4)
    assert isinstance(told, tuple)
    assert [slip.drop for slip in told] == pytest.approx([15.0], abs=0.2)


def test_slips_of_a_force_of_millinewtons() -> None:
    force = SMOOTH - 0.81 * (D > 0.03085) + noise()
    (large,), (small,) = found(force), found(1e-3 * force, min_drop=0.2e-3)
    assert (small.start, small.stop) == (large.start, large.stop)
    assert small.drop == pytest.approx(1e-3 * large.drop)


@pytest.mark.parametrize(("travel", "longest"), [(0.02, 0.4e-3), (0.04, 0.8e-3), (0.2, 1e-3)])
def test_a_slip_is_at_most_a_fiftieth_of_the_travel_and_a_millimetre_long(
    travel: float, longest: float
) -> None:
    d = np.linspace(0.0, travel, 20_001)
    assert _fineness(d, None) == _fineness(d, longest) != _fineness(d, 1.4 * longest)


@pytest.mark.parametrize(("deviations", "stands"), [(4.5, False), (7.5, True)])
def test_a_sample_six_deviations_of_the_steps_off_stands_alone(
    deviations: float, *, stands: bool
) -> None:
    force = np.random.default_rng(5).normal(0.0, 1.0, 400)
    steps = np.diff(force)
    force[200] = deviations * 1.4826 * float(np.median(np.abs(steps - np.median(steps))))
    force[[198, 199, 201, 202]] = 0.0
    assert bool(_stands_alone(force)[200]) is stands
