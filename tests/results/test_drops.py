from __future__ import annotations

from typing import Final

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binomtest

from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval, Slip, SlipDecision
from labpipe.records.estimates import Failure
from labpipe.results.curves import add_slips_back
from labpipe.results.failures import (
    LossOfForce,
    find_loss_start,
    find_slow_loss,
    measure_earlier_loss,
)
from labpipe.results.slack_and_slips import (
    BlockCurve,
    LoadDrop,
    _choose_block_width,
    _estimate_correlation,
    _Window,
    find_slips,
    fit_load_drop,
)

RULE: Final = LossOfForce(force_below=0.5, loss=0.1, within=0.05)


SPEED = 1e-3


D = np.linspace(0.0, 0.03, 301)


TIME = D / SPEED


F = np.where(D <= 0.02, 5000.0 * D, 3.0)


@pytest.mark.parametrize(("low", "is_lost"), [(45.0, True), (46.0, False)])
def test_a_loss_of_just_the_share_is_one(low: float, *, is_lost: bool) -> None:
    """A sample a second, 5 N slower each, and 10 % of 100 N on the way below half of it."""
    force = np.array([0.0, 50.0, 100.0, *np.arange(95.0, 54.0, -5.0), low, 42.0, 41.0])
    start = find_loss_start(np.arange(float(len(force))), force, RULE)
    assert start == 11 if is_lost else isinstance(start, Failure)


def broken(rate: float, *, takes: float = 0.004, neck: float = 0.0) -> tuple[Floats, Floats]:
    """Up to 100 N in 20 s, a smooth fall to 100 N - neck in 2 s, then lost in a few ms."""
    time = np.arange(0.0, 25.0, 1.0 / rate)
    rising = np.minimum(5.0 * time, 100.0)
    necked = neck * np.clip((time - 20.0) / 2.0, 0.0, 1.0) ** 2
    share = np.clip(1.0 - (time - 22.0) / takes, 0.0, 1.0)
    return time, (rising - necked) * share + 1.0 * (1.0 - share)


@pytest.mark.parametrize("rate", [10.0, 100.0, 10_000.0])
@pytest.mark.parametrize("neck", [0.0, 40.0])
def test_a_break_is_found_at_any_rate_behind_the_necking(rate: float, neck: float) -> None:
    time, force = broken(rate, neck=neck)
    sample = find_loss_start(time, force, RULE)
    assert isinstance(sample, int)
    assert 22.0 - 0.1 <= time[sample] <= 22.0 + 0.004
    assert force[sample] == pytest.approx(100.0 - neck, rel=0.05)


def test_why_there_is_no_break() -> None:
    """A force that relaxes, a yarn that breaks fibre by fibre, one that holds, and a way back."""
    time = np.arange(0.0, 40.0, 0.01)
    relaxed = np.where(time < 10.0, 10.0 * time, 100.0 * np.exp(-(time - 10.0) / 10.0))
    steps = np.maximum(100.0 - 5.0 * np.floor(np.arange(200) / 10.0), 0.0)
    back = np.concatenate([F[:200], F[:200][::-1]])
    why = [
        *(
            find_loss_start(time, relaxed, RULE),
            find_loss_start(0.1 * np.arange(200.0), steps, RULE),
        ),
        find_loss_start(TIME[:200], F[:200], RULE),
        find_loss_start(0.1 * np.arange(400.0), back, RULE, np.arange(400) >= 200),
    ]
    messages = ("slowly", "slowly", "the force ends at 99.5 N, 100% of its peak 99.5 N; below 50%")
    for failure, message in zip(why, (*messages, "while the displacement decreases"), strict=True):
        assert isinstance(failure, Failure)
        assert failure.code == "no_break"
        assert message in failure.message


def test_a_slow_loss_needs_a_motion_that_goes_on() -> None:
    """100 N from sample 200 on, then 1 N less each sample: half of it in sample 250.

    It tears; it relaxes; the frame goes back; the record ends too soon.
    """
    at = np.arange(400.0)
    force = np.maximum(np.where(at < 200.0, 0.5 * at, 300.0 - at), 0.0)
    motions = (at, np.minimum(at, 200.0), 200.0 - np.abs(at - 200.0), at[:240])
    losses = [find_slow_loss(motion, force[: len(motion)], RULE) for motion in motions]
    assert losses == [250, None, None, None]


def test_no_tension() -> None:
    for force, largest in ((-F, "0"), (-1.0 - F, "-1"), (0.0 * F, "0")):
        failure = find_loss_start(TIME, force, RULE)
        assert failure == Failure.of("results.no_tension", largest=float(largest))


@pytest.mark.parametrize(
    ("lost", "comes_back_to", "share"), [(30.0, 65.0, 0.0), (30.0, 40.0, 1 / 3), (5.0, 50.0, 0.0)]
)
def test_what_was_lost_before(lost: float, comes_back_to: float, share: float) -> None:
    """60 N are carried, then some are lost at once; only what never comes back counts."""
    parts = [np.linspace(0.0, 60.0, 121), np.linspace(60.0 - lost, comes_back_to, 80)]
    force = np.concatenate(parts).astype(np.float64)
    loss = measure_earlier_loss(0.1 * np.arange(float(len(force))), force, RULE)
    assert loss == pytest.approx(share)
    force[::9] = np.nan
    assert measure_earlier_loss(0.1 * np.arange(float(len(force))), force, RULE) == pytest.approx(
        share, abs=0.01
    )


D_SLIPS = np.linspace(0.0, 0.05, 600)


SMOOTH = 45.0 * (1.0 - np.exp(-D_SLIPS / 0.02)) / (1.0 - np.exp(-2.5))


def noise(seed: int = 0) -> Floats:
    return np.random.default_rng(seed).normal(0.0, 0.05, len(D_SLIPS))


def found(force: Floats, min_drop: float = 0.2) -> tuple[Slip, ...]:
    slips = find_slips(D_SLIPS, force, min_drop=min_drop, decision=SlipDecision.REPAIRED)
    assert isinstance(slips, tuple)
    return slips


def test_the_two_slips_of_the_source() -> None:
    force = SMOOTH - 0.47 * (D_SLIPS > 0.01875) - 0.81 * (D_SLIPS > 0.03085) + noise()
    first, second = found(force)
    assert first.position == pytest.approx(0.01875, abs=2 * D_SLIPS[1])
    assert second.position == pytest.approx(0.03085, abs=2 * D_SLIPS[1])
    for slip, drop in ((first, 0.47), (second, 0.81)):
        assert slip.drop_interval.lower < drop < slip.drop_interval.upper
        assert slip.position_interval.lower <= slip.position <= slip.position_interval.upper
        assert D_SLIPS[slip.start] <= slip.position <= D_SLIPS[slip.stop]
        ends = slip.position_interval.lower, slip.position_interval.upper
        assert ends == pytest.approx((D_SLIPS[slip.start], D_SLIPS[slip.stop]), abs=2 * D_SLIPS[1])
    repaired = add_slips_back(force, (first, second))
    assert np.abs(repaired - SMOOTH - noise()).max() < 0.3


def test_a_fall_of_several_samples_and_missing_ones() -> None:
    fall = np.interp(np.arange(600), [300, 304], [0.0, 1.0])
    force = SMOOTH - 1.5 * fall + noise(1)
    force[100] = np.nan
    (slip,) = found(force)
    assert (slip.start, slip.stop) == (300, 304)
    assert slip.drop == pytest.approx(1.5, abs=0.1)


def test_a_clear_slip_in_slow_noise() -> None:
    """Of twelve deviations of noise that remembers ten samples: nine times in ten, to a sample."""
    hits = 0
    for seed in range(10):
        kicks = noise(seed) * np.sqrt(1.0 - np.exp(-0.2))
        slow = lfilter([1.0], [1.0, -np.exp(-0.1)], kicks)
        slips = found(900.0 * D_SLIPS - 0.6 * (D_SLIPS > 0.02) + slow)
        hits += len(slips) == 1 and abs(slips[0].position - 0.02) < 1.1 * D_SLIPS[1]
    assert hits >= 9


@pytest.mark.parametrize("seed", range(3))
def test_what_is_no_slip(seed: int) -> None:
    kink = np.where(D_SLIPS < 0.02, 2000.0 * D_SLIPS, 40.0 + 400.0 * (D_SLIPS - 0.02))
    spike = np.where(np.arange(600) == 300, -8.0, 0.0)
    dip = np.where(np.arange(600) == 200, -0.8, 0.0)
    lost = np.where(D_SLIPS > 0.045, 0.05 * SMOOTH, SMOOTH)
    yields = SMOOTH - 1.5 * np.clip((D_SLIPS - 0.02) / 0.003, 0.0, 1.0)
    for force in (SMOOTH, kink, SMOOTH + spike, SMOOTH + dip, lost, yields):
        assert found(force + noise(seed)) == ()
    assert found(SMOOTH - 0.47 * (D_SLIPS > 0.02) + noise(seed), min_drop=1.0) == ()
    for level in (0.0, 3.0):
        assert found(np.full(600, level)) == ()
    few = find_slips(D_SLIPS[:20], SMOOTH[:20], min_drop=0.2, decision=SlipDecision.MARKED)
    assert few == Failure("too_few_samples", "20 samples in the branch, 64 are needed")


def ledger(start: int, stop: int, drop: float) -> Slip:
    interval = Interval(0.0, 1.0)
    return Slip(0.5, drop, interval, interval, SlipDecision.CUT, start, stop)


def test_losses_add_up_and_samples_inside_lie_on_a_line() -> None:
    force = np.array([0.0, 1.0, 0.7, 1.0, 2.0, 2.5, 3.5])
    repaired = add_slips_back(force, (ledger(1, 3, 1.0), ledger(4, 5, 0.5)))
    assert repaired == pytest.approx([0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0])
    force[2] = np.nan
    assert np.isnan(add_slips_back(force, (ledger(1, 3, 1.0),))[2])


@pytest.mark.parametrize("rate", [20, 100, 1000])
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


def test_a_tear_is_no_slip() -> None:
    force = 2000.0 * D_SLIPS - 0.3 * 50.0 * (D_SLIPS > 0.025) + noise()
    assert found(force) == ()
    # Nor is it one where the force goes on at less than three tenths of its slope.
    for share, count in ((0.2, 0), (0.4, 1)):
        since = np.maximum(D_SLIPS - 0.025, 0.0)
        force = 2000.0 * (D_SLIPS - (1.0 - share) * since) - 2.0 * (since > 0.0) + noise()
        assert len(found(force)) == count


@pytest.mark.parametrize(("travel", "longest"), [(0.02, 0.4e-3), (0.04, 0.8e-3), (0.2, 1e-3)])
def test_a_slip_is_at_most_a_fiftieth_of_the_travel_and_a_millimetre_long(
    travel: float, longest: float
) -> None:
    d = np.linspace(0.0, travel, 20_001)
    width, blocks = _choose_block_width(d)
    assert width * blocks * d[1] == pytest.approx(longest, rel=0.15)


COUNT, STEP = 400, 1e-4


NUMBER = np.arange(COUNT, dtype=np.float64)


def noise_of_drops(seed: int, memory: float, deviation: float = 0.04) -> Floats:
    factor = np.exp(-1.0 / memory) if memory > 0.0 else 0.0
    kicks = np.random.default_rng(seed).normal(size=COUNT + 100) * np.sqrt(1.0 - factor**2)
    slow = np.asarray(lfilter([1.0], [1.0, -factor], kicks)[100:], dtype=np.float64)
    return deviation * slow


def pull(begin: float, length: float, drop: float, extra: Floats) -> BlockCurve:
    lost = drop * np.clip((NUMBER - begin) / length, 0.0, 1.0)
    return BlockCurve(STEP * NUMBER, 0.1 * NUMBER - lost + extra, longest_drop=10, block_margin=0)


@pytest.mark.slow
@pytest.mark.parametrize("length", [0.01, 1.0, 2.5])
@pytest.mark.parametrize("memory", [0.0, 6.0])
def test_the_drop_covers(length: float, memory: float) -> None:
    """Slow and white noise_of_drops, and falls that begin anywhere between two samples."""
    hits = 0
    for seed in range(120):
        begin = 200.0 + float(np.random.default_rng(seed).uniform())
        mixed = noise_of_drops(seed, memory, 0.03) + noise_of_drops(seed + 1000, 0.0, 0.02)
        drop = fit_load_drop(pull(begin, length, 0.65, mixed), 202)
        assert isinstance(drop, LoadDrop)
        hits += drop.drop_interval.lower <= 0.65 <= drop.drop_interval.upper
    assert binomtest(hits, 120, 0.95).pvalue > 0.01 / 6, hits


def test_the_noise_of_one_window_is_hardly_correlated() -> None:
    assert 0.0 <= _estimate_correlation(noise()[:100]) < 0.3


@pytest.mark.parametrize(("place", "is_told"), [(7, False), (8, True), (391, True), (392, False)])
def test_a_fall_needs_eight_samples_on_each_side(place: int, *, is_told: bool) -> None:
    fallen = pull(place + 0.25, 0.5, 3.0, noise_of_drops(3, 0.0, 0.005))
    assert (fit_load_drop(fallen, place) is not None) is is_told


def test_start_and_stop_are_the_samples_around_the_fall() -> None:
    drop = fit_load_drop(pull(200.25, 2.5, 2.0, noise_of_drops(3, 0.0, 0.005)), 205)
    assert drop is not None
    assert (drop.start, drop.stop) == (200, 203)
    assert drop.earliest_start <= drop.start + 1
    assert drop.latest_stop >= drop.stop - 1
    for begin in range(100, 300, 10):
        drop = fit_load_drop(pull(begin, 1.0, 10.0, 0.0 * NUMBER), begin)  # only rounding
        assert drop is not None
        assert drop.start == begin
        assert drop.drop == pytest.approx(10.0)


def test_a_shorter_window_is_looked_at_where_a_longer_one_shows_no_drop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """25, 15 and 10 samples beyond the longest drop, of ten, with polynomials that bend less."""
    looked_at = []

    def find_none(window: _Window, place: int) -> None:
        looked_at.append((place - window.start, window.stop - 1 - place, window.degree))

    monkeypatch.setattr(_Window, "fit_drop", find_none)
    assert fit_load_drop(pull(200.0, 1.0, 1.0, 0.0 * NUMBER), 200) is None
    assert looked_at == [(35, 35, 3), (25, 25, 2), (20, 20, 1)]


def test_what_is_no_fall() -> None:
    """Noise of either kind at its deepest place; a long fall; no room on a side; a coarse step.

    Around the place of the coarse converter nothing moves at all, elsewhere steps of twelve.
    """
    for memory in (0.0, 3.0, 10.0):
        for seed in range(8):
            extra = noise_of_drops(seed, memory)
            place = int(np.argmin(np.diff(extra)[30:-30])) + 30
            assert fit_load_drop(pull(0.0, 1.0, 0.0, extra), place) is None
    assert fit_load_drop(pull(195.0, 16.0, 1.5, noise_of_drops(1, 0.0)), 200) is None
    whole = pull(3.0, 0.5, 1.0, noise_of_drops(1, 0.0))
    assert fit_load_drop(whole, 3) is fit_load_drop(whole, COUNT - 3) is None
    force = 1.2 * np.round(0.1 * NUMBER / 1.2)
    force[150:260] = force[150]
    curve = BlockCurve(STEP * NUMBER, force, longest_drop=10, block_margin=0)
    assert fit_load_drop(curve, 205) is None
