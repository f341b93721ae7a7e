"""Noise that is judged by a record and drawn anew, against noise made by plain numpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import signal

from labpipe.records.arrays import Floats
from labpipe.uncertainty.noise_model import Noise, _processes, estimate_noise
from labpipe.uncertainty.polynomial_pieces import polynomial_pieces
from labpipe.uncertainty.replicates import smooth_curve

RNG = np.random.default_rng


def autoregressive(factor: float, shape: Sequence[int], seed: int) -> Floats:
    """Rows of x_i = factor x_(i-1) + kick_i, of variance 1 from the first sample on."""
    kicks = RNG(seed).normal(size=tuple(shape))
    kicks[..., 1:] *= np.sqrt(1.0 - factor**2)
    found: Floats = signal.lfilter([1.0], [1.0, -factor], kicks, axis=-1)
    return found


def judged(values: Floats, *more: Floats) -> Noise:
    """Of records whose smooth curve is zero."""
    branches = [values, *more]
    return estimate_noise(branches, [np.zeros(len(branch)) for branch in branches])


def known(variance: float, longest: int) -> Noise:
    """White noise of a variance that is known for sure."""
    chances = np.zeros(1 + 9 * 24)
    chances[0] = 1.0
    freedom, none = 10**9, np.zeros(0)
    squares = np.full(len(chances), variance * freedom)
    return Noise(chances, squares, freedom, longest, longest, none, none)


def test_white_noise_has_its_variance_everywhere() -> None:
    """At its ends, too; an even and an odd number of samples."""
    for count in (8, 9, 1000):
        drawn = known(4.0, count).draw(count, 200_000 // count, RNG(0))
        assert drawn.shape == (200_000 // count, count)
        assert np.var(drawn) == pytest.approx(4.0, rel=0.015)
        assert np.mean(drawn) == pytest.approx(0.0, abs=0.03)
    drawn = known(4.0, 20).draw(20, 40_000, RNG(0))
    assert np.var(drawn, axis=0)[[0, 1, 10, 18, 19]] == pytest.approx([4.0] * 5, rel=0.03)
    neighbours = np.mean(drawn[:, 1:] * drawn[:, :-1])
    assert neighbours == pytest.approx(0.0, abs=0.03)


@pytest.mark.parametrize("factor", [0.5, 0.9, 0.98])
def test_remembering_noise_has_its_autocovariance(factor: float) -> None:
    """In a long record a memory of ten samples is seen by its own power only.

    A memory of fifty is as likely flicker noise: waves of a piece, but for its six slowest, leave
    that open.
    """
    noise = judged(autoregressive(factor, (20_000,), 2))
    steep = _processes(noise.longest, noise.count).steep[: len(noise.chances)]
    depends_on_history = np.where(steep > 0.0, 0.0, noise.chances)
    assert depends_on_history.sum() > (5.0 / 6.0 if factor < 0.98 else 1.0 / 3.0)
    drawn = replace(noise, chances=depends_on_history / depends_on_history.sum()).draw(
        20_000, 400, RNG(1)
    )
    for at in (slice(0, 200), slice(10_000, 10_200), slice(-200, None)):
        part = drawn[:, at]
        for lag in (0, 1, 5, 20):
            product = np.mean(part[:, : 200 - lag] * part[:, lag:])
            assert product == pytest.approx(factor**lag, abs=0.15)


def test_one_short_record_leaves_its_variance_open() -> None:
    """Means of squares of draws scatter by an inverse chi-square of 20 samples less a line."""
    record = RNG(11).normal(size=20)
    noise = judged(record)
    assert noise.freedom == 18
    drawn = noise.draw(20, 20_000, RNG(2))
    inner = np.log(np.mean(drawn**2, axis=1))
    sampling = np.log(np.mean(RNG(3).normal(size=(20_000, 20)) ** 2, axis=1))
    sure = np.log(18.0 / RNG(4).chisquare(18, 20_000))
    assert np.std(inner) > 0.95 * np.hypot(np.std(sampling), np.std(sure))
    assert np.std(inner) < 1.5 * np.hypot(np.std(sampling), np.std(sure))


def test_the_chances_follow_the_record() -> None:
    white = [judged(RNG(seed).normal(size=3000)).correlation_time for seed in range(10)]
    assert np.median(white) < 2.0
    for tau in (3.0, 10.0, 40.0):
        records = autoregressive(np.exp(-1.0 / tau), (8, 6000), 4)
        found = [judged(record).correlation_time for record in records]
        assert np.median(found) == pytest.approx(tau, rel=0.35)
    assert judged(RNG(0).normal(size=3000)).chances.sum() == pytest.approx(1.0)


def test_processes_by_their_formulas() -> None:
    """White; autoregressive of 24 times, mirrored, bare and on seven floors; flicker of 5 powers.

    Of 2000 samples a branch and 8000 in all, at a few angles.
    """
    found, angle = _processes(2000, 8000), np.array([0.0, 1e-3, 0.1, 2.0])
    times = np.geomspace(0.4, 100.0, 24)
    a = np.exp(-1.0 / times)[:, None]
    bare = (1.0 - a) ** 2 / (1.0 - 2.0 * a * np.cos(angle) + a**2)
    floors = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
    lowest, flicker = np.pi / 16_000.0, list[Floats]()
    crossings = (np.pi, 2.0, 0.8, 0.3, 0.12, 0.05)
    for steep in (0.6, 0.8, 1.0, 1.2, 1.5):
        for crossing in crossings:
            white = (lowest / crossing) ** steep
            rising = (1.0 + (angle / lowest) ** 2) ** (-0.5 * steep)
            flicker.append(white + (1.0 - white) * rising)
    on_floors = [fl + (1.0 - fl) * bare for fl in floors]
    white_alone = np.ones((1, 4))
    spectra = np.concatenate([white_alone, 1.0 / bare, bare, *on_floors, np.array(flicker)])
    assert found.spectra(angle) == pytest.approx(spectra, rel=1e-9)
    prior = (times / 0.4) ** -0.4
    of_flicker = np.tile(np.array(crossings) / np.pi, 5)
    weights = [np.ones(1), prior, prior / 2.0, np.tile(prior / 14.0, 7), of_flicker]
    assert found.prior == pytest.approx(np.concatenate(weights))
    # Of a short record up to twice the briefest memory at least.
    assert np.unique(_processes(8, 8).time)[[1, -1]] == pytest.approx([0.4, 0.8])


def test_a_piece_with_a_step_or_with_more_noise_is_left_out() -> None:
    """Of 1.8 times the deviation: 3.2 times the variance, which white noise has by no chance."""
    values = RNG(13).normal(size=3000)
    steps = np.where(np.arange(3000) < 1100, 0.0, 40.0)
    stepped = estimate_noise([values + steps], [steps])
    louder = values.copy()
    louder[1000:1250] *= 1.8
    for noise in (stepped, judged(louder)):
        assert noise.freedom == 11 * (48 - 6)
    assert np.var(stepped.draw(3000, 200, RNG(0))) == pytest.approx(1.0, rel=0.1)


def test_all_branches_are_judged() -> None:
    """Pieces of 50 of a branch of 200 and one of 120: four and two."""
    noise = judged(RNG(0).normal(size=200), RNG(1).normal(size=120))
    assert (noise.freedom, noise.longest, noise.count) == (6 * (48 - 6), 200, 320)


def test_of_uneven_noise_the_noisier_half_counts() -> None:
    """Variances 1 and 9, one half of the record each."""
    for seed in range(3):
        record = np.r_[RNG(seed).normal(size=2000), 3.0 * RNG(seed + 10).normal(size=2000)]
        drawn = judged(record[:2000], record[2000:]).draw(2000, 100, RNG(2))
        assert 5.0 <= np.var(drawn) <= 9.5


def test_no_noise() -> None:
    """Less than five samples, or what a spreadsheet computed; eight samples have some."""
    four, cubic = np.array([1.0, 5.0, 2.0, 8.0]), 1e5 + np.linspace(0.0, 1.0, 500) ** 3
    for values in (np.zeros(0), four, np.full(500, 7.0), np.full(500, np.nan), cubic):
        noise = judged(values)
        assert noise.is_zero
        assert not noise.draw(max(len(values), 1), 3, RNG(0)).any()
    eight = judged(np.array([1.0, 5.0, 2.0, 8.0, 1.0, 0.0, 3.0, 4.0]))
    assert (eight.is_zero, eight.freedom) == (False, 6)


def flicker(shape: tuple[int, int], seed: int) -> Floats:
    """Rows of noise whose power falls as 1 over the frequency, of variance 1."""
    rows, count = shape
    waves = np.fft.rfft(RNG(seed).normal(size=(rows, 4 * count)))
    waves[:, 1:] /= np.sqrt(np.arange(1.0, waves.shape[1]))
    waves[:, 0] = 0.0
    found = np.fft.irfft(waves, 4 * count)[:, :count]
    return np.asarray(found / found.std(), dtype=np.float64)


RESTS = slice(0, 200), slice(2800, 3000)


def wander(rows: Floats, *, at_rest: bool) -> float:
    """Standard deviation of what draws wander from the first rest to the last one, on average."""
    found = []
    for row in rows:
        branches = [row[200 + 650 * at : 850 + 650 * at] for at in range(4)]
        rests = [[row[rest]] if at_rest else [] for rest in RESTS]
        noise = estimate_noise(branches, [0.0 * branch for branch in branches], *rests)
        drawn = noise.draw(3000, 400, RNG(8))
        found.append(np.std(drawn[:, RESTS[1]].mean(axis=1) - drawn[:, RESTS[0]].mean(axis=1)))
    return float(np.mean(found))


def test_rests_tell_flicker_noise() -> None:
    """Pieces of a second guess what the record does in a minute; rests of four seconds know.

    Beneath white noise, pieces do not even guess.
    """
    rows = flicker((60, 3000), 11)
    truth = np.std(rows[:, RESTS[1]].mean(axis=1) - rows[:, RESTS[0]].mean(axis=1))
    hidden = rows[:4] + 3.0 * RNG(12).normal(size=(4, 3000))
    assert wander(hidden, at_rest=False) < 0.5 * truth
    assert 0.7 * truth < wander(rows[:4], at_rest=True) < 1.4 * truth


def test_a_force_that_relaxes_behind_the_motion_is_no_noise() -> None:
    """By a tenth of the noise's range and ten times it; and a motion that began a little early."""
    rows = RNG(12).normal(size=(4, 3000))
    plain, later = wander(rows, at_rest=True), np.arange(200)
    for size in (0.5, 20.0):
        relaxing = rows.copy()
        relaxing[:, RESTS[1]] += size * np.exp(-later / 80.0)
        assert wander(relaxing, at_rest=True) < 1.5 * plain
    early = rows.copy()
    early[:, 185:200] += 0.5 * np.arange(15.0)
    assert wander(early, at_rest=True) < 1.2 * plain


def test_a_corner_of_a_long_record_is_no_fast_noise() -> None:
    """A steep elastic line into a plateau, as of steel: noise of 2 beside a corner of 50 000."""
    at = np.linspace(0.0, 1.0, 12_000)
    curve = 5e4 * np.minimum(at / 0.05, 1.0)
    values = curve + RNG(4).normal(0.0, 2.0, len(at))
    smooth = smooth_curve(at, values, [], 12)
    noise = estimate_noise([values], [smooth])
    assert noise.draw(len(at), 50, RNG(0)).std() == pytest.approx(2.0, rel=0.1)


SHORT = [
    ("knee", 15, 1.6),
    *(
        pytest.param(shape, count, most, marks=pytest.mark.slow)
        for shape, count, most in (
            *(("line", 10, 1.35), ("line", 150, 1.35), ("knee", 10, 4.0), ("knee", 50, 1.35)),
            *(("bent", 10, 4.0), ("bent", 20, 1.6), ("bent", 30, 1.35), ("bent", 90, 1.35)),
        )
    ),
]


@pytest.mark.parametrize(("shape", "count", "most"), SHORT)
def test_noise_of_a_short_record_is_what_polynomials_leave(
    shape: str, count: int, most: float
) -> None:
    """Median over 60 records; few free samples leave the variance open, ten a bend as well."""
    at = np.linspace(0.0, 1.0, count)
    curves = {"line": at, "knee": np.minimum(at, 0.5), "bent": 1.0 - np.exp(-2.0 * at)}
    spreads = []
    for seed in range(60):
        values = curves[shape] + 0.002 * RNG(seed).normal(size=count)
        pieces = polynomial_pieces(values)
        assert (pieces[0].start, pieces[-1].stop) == (0, count)
        assert all(one.stop == other.start for one, other in pairwise(pieces))
        noise = estimate_noise([values], [values])
        spreads.append(noise.draw(count, 50, RNG(0)).std())
    assert 0.75 < np.median(spreads) / 0.002 < most


def test_pieces_of_a_short_record_do_not_follow_slow_noise() -> None:
    """A line in noise that is correlated over three samples, by its median over 40 records."""
    lengths, times = list[int](), list[float]()
    for seed in range(40):
        kicks, noise = RNG(seed).normal(size=60), np.zeros(60)
        for at in range(1, 60):
            noise[at] = np.exp(-1.0 / 3.0) * noise[at - 1] + kicks[at]
        values = 10.0 * np.arange(60.0) + noise
        lengths.append(len(polynomial_pieces(values)))
        times.append(estimate_noise([values], [values]).correlation_time)
    assert np.mean(lengths) < 2.0
    assert 1.7 < np.median(times) < 4.0
