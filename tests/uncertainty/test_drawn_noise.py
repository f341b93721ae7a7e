"""Noise that is estimated from a record and drawn again, against noise made by plain numpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import linalg, signal

from labpipe.records.arrays import Flags, Floats
from labpipe.uncertainty.noise_model import (
    NoiseModel,
    _compute_whitened_squares,
    _list_processes,
    cut_into_polynomials,
    estimate_noise,
)
from labpipe.uncertainty.replicates import fit_smooth_curve

RNG = np.random.default_rng


def autoregressive(factor: float, shape: Sequence[int], seed: int) -> Floats:
    """Rows of x_i = factor x_(i-1) + kick_i, of variance 1 from the first sample on."""
    kicks = RNG(seed).normal(size=tuple(shape))
    kicks[..., 1:] *= np.sqrt(1.0 - factor**2)
    noise: Floats = signal.lfilter([1.0], [1.0, -factor], kicks, axis=-1)
    return noise


def judged(values: Floats, *more: Floats) -> NoiseModel:
    """Of records whose smooth curve is zero."""
    branches = [values, *more]
    return estimate_noise(branches, [np.zeros(len(branch)) for branch in branches])


def known(variance: float, longest: int) -> NoiseModel:
    """White noise of a variance that is known for sure."""
    chances = np.zeros(1 + 9 * 24)
    chances[0] = 1.0
    freedom, none = 10**9, np.zeros(0)
    squares = np.full(len(chances), variance * freedom)
    return NoiseModel(chances, squares, freedom, longest, longest, none, none)


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
    processes = _list_processes(noise.longest_branch, noise.n_samples)
    steep = processes.flicker_exponent[: len(noise.probabilities)]
    depends_on_history = np.where(steep > 0.0, 0.0, noise.probabilities)
    assert depends_on_history.sum() > (5.0 / 6.0 if factor < 0.98 else 1.0 / 3.0)
    drawn = replace(noise, probabilities=depends_on_history / depends_on_history.sum()).draw(
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
    assert noise.dof == 18
    drawn = noise.draw(20, 20_000, RNG(2))
    inner = np.log(np.mean(drawn**2, axis=1))
    sampling = np.log(np.mean(RNG(3).normal(size=(20_000, 20)) ** 2, axis=1))
    sure = np.log(18.0 / RNG(4).chisquare(18, 20_000))
    assert np.std(inner) > 0.95 * np.hypot(np.std(sampling), np.std(sure))
    assert np.std(inner) < 1.5 * np.hypot(np.std(sampling), np.std(sure))


def test_processes_by_their_formulas() -> None:
    """White; autoregressive of 24 times, mirrored, bare and on seven floors; flicker of 5 powers.

    Of 2000 samples a branch and 8000 in all, at a few angles.
    """
    processes, angle = _list_processes(2000, 8000), np.array([0.0, 1e-3, 0.1, 2.0])
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
    assert processes.compute_spectra(angle) == pytest.approx(spectra, rel=1e-9)
    prior = (times / 0.4) ** -0.4
    of_flicker = np.tile(np.array(crossings) / np.pi, 5)
    weights = [np.ones(1), prior, prior / 2.0, np.tile(prior / 14.0, 7), of_flicker]
    assert processes.prior == pytest.approx(np.concatenate(weights))
    # Of a short record up to twice the briefest memory at least.
    assert np.unique(_list_processes(8, 8).correlation_time)[[1, -1]] == pytest.approx([0.4, 0.8])


def cosines(count: int, terms: int) -> Floats:
    """Rows of unit length: the slowest half waves over a number of samples."""
    waves = np.cos(np.pi / count * np.outer(np.arange(terms), np.arange(count) + 0.5))
    return np.asarray(waves / np.linalg.norm(waves, axis=1)[:, None], dtype=np.float64)


def judged_by_contrasts(
    parts: Sequence[tuple[Floats, int]], noise: NoiseModel, is_possible: Flags
) -> tuple[Floats, Floats, int]:
    """Chances, squares and freedom by dense matrices, of 48 half waves of each part.

    A part has its values and the number of powers that are its curve. Contrasts that no curve
    reaches are normal, of the covariance that a process gives them.
    """
    processes = _list_processes(noise.longest_branch, noise.n_samples)
    logs, squares, freedom = np.log(processes.prior), 0.0 * processes.prior, 0
    for values, powers in parts:
        waves = cosines(len(values), 48)
        curves = waves @ np.vander(np.linspace(-1.0, 1.0, len(values)), powers)
        contrasts = linalg.null_space(curves.T)
        power = processes.compute_spectra(np.pi * np.arange(48) / len(values))
        covariance = (contrasts.T * power[:, None]) @ contrasts
        data = contrasts.T @ waves @ values
        logs -= 0.5 * np.linalg.slogdet(covariance)[1]
        squares += np.linalg.solve(covariance, data[:, None])[..., 0] @ data
        freedom += len(data)
    logs = np.where(is_possible, logs - 0.5 * freedom * np.log(squares), -np.inf)
    chances = np.exp(logs - logs.max())
    chances[chances < 1e-4 * chances.max()] = 0.0
    return chances / chances.sum(), squares, freedom


@pytest.mark.parametrize("at_rest", [True, False])
def test_a_record_is_judged_as_by_dense_matrices(*, at_rest: bool) -> None:
    """Two branches in pieces of a twelfth of the longer one, without a tenth of each rest.

    Without rests, flicker noise counts only where the pieces see it cross white noise, or where it
    is white in them; nor where it is as steep as noise that remembers.
    """
    long, short, rest1, rest2 = (
        autoregressive(0.8, (count,), seed)
        for seed, count in enumerate((2000, 1000, 300, 400), start=30)
    )
    rest2 += 0.1 * np.linspace(-1.0, 2.0, 400) ** 2
    rests = [[rest1], [rest2]] if at_rest else []
    noise = estimate_noise([long, short], [0.0 * long, 0.0 * short], *rests)
    pieces = [*long[:1992].reshape(12, 166), *short[:996].reshape(6, 166)]
    parts = [
        *((piece, 6) for piece in pieces),
        *[(rest1[:270], 1), (rest2[40:], 3)][: 2 * at_rest],
    ]
    processes = _list_processes(2000, 3000)
    steep, crossing = processes.flicker_exponent, processes.crossing_frequency
    is_crossed = (crossing > np.pi * 12 / 166) & (crossing < np.pi * 48 / 166) | (crossing == np.pi)
    is_possible = at_rest | (steep == 0.0) | (is_crossed & (steep < 1.3))
    chances, squares, freedom = judged_by_contrasts(parts, noise, is_possible)
    assert noise.dof == freedom
    np.testing.assert_allclose(noise.squares, squares, rtol=1e-9)
    np.testing.assert_allclose(noise.probabilities, chances, rtol=1e-7)
    # Faster waves have the power of the record, in bands of 16 of the longer branch.
    power = (cosines(2000, 2000) @ long) ** 2 + np.repeat(cosines(1000, 1000) @ short, 2) ** 2 / 2.0
    edges = np.arange(256, 1984, 16)
    bands = np.add.reduceat(power, edges) / np.diff(np.append(edges, 2000))
    np.testing.assert_allclose(noise.band_frequencies, np.pi * edges / 2000.0)
    np.testing.assert_allclose(noise.band_power, bands * 2.0 / 3.0, rtol=1e-9)


def test_whitened_squares_are_what_weighted_least_squares_leave() -> None:
    waves, columns = RNG(1).normal(size=(3, 20)), RNG(2).normal(size=(20, 4))
    spectrum = RNG(3).uniform(0.1, 3.0, 20)
    weight = spectrum[:, None] ** -0.5
    rss = np.linalg.lstsq(weight * columns, weight * waves.T)[1]
    np.testing.assert_allclose(_compute_whitened_squares(spectrum, waves, columns), rss, rtol=1e-9)


def test_correlation_times_are_those_of_the_spectra() -> None:
    """Half the power at no frequency over the mean power; one half if mirrored or flickering."""
    processes = _list_processes(2000, 8000)
    angle: Floats = np.pi * (np.arange(5000.0) + 0.5) / 5000.0
    means = np.where(
        (processes.is_reciprocal == 1.0) | (processes.flicker_exponent > 0.0),
        1.0,
        processes.compute_spectra(angle).mean(axis=1),
    )
    none = np.zeros(0)
    times = [
        NoiseModel(chances, chances, 1, 2000, 8000, none, none).correlation_time
        for chances in np.eye(len(means))
    ]
    np.testing.assert_allclose(times, 0.5 / means, rtol=1e-9)


def test_a_piece_with_a_step_or_with_more_noise_is_left_out() -> None:
    """Of 1.8 times the deviation: 3.2 times the variance, which white noise has by no chance."""
    values = RNG(13).normal(size=3000)
    steps = np.where(np.arange(3000) < 1100, 0.0, 40.0)
    stepped = estimate_noise([values + steps], [steps])
    louder = values.copy()
    louder[1000:1250] *= 1.8
    for noise in (stepped, judged(louder)):
        assert noise.dof == 11 * (48 - 6)
    assert np.var(stepped.draw(3000, 200, RNG(0))) == pytest.approx(1.0, rel=0.1)


def test_of_uneven_noise_the_noisier_half_counts() -> None:
    """Variances 1 and 9, one half of the record each."""
    for seed in range(3):
        record = np.r_[RNG(seed).normal(size=2000), 3.0 * RNG(seed + 10).normal(size=2000)]
        drawn = judged(record[:2000], record[2000:]).draw(2000, 100, RNG(2))
        assert 5.0 <= np.var(drawn) <= 9.5


def test_no_noise() -> None:
    """Less than five samples, or what a spreadsheet computed; eight samples have some."""
    four, cubic = np.array([1.0, 5.0, 2.0, 8.0]), 1e5 + np.linspace(0.0, 10.0, 500) ** 3
    for values in (np.zeros(0), four, np.full(500, 7.0), np.full(500, np.nan), cubic):
        noise = judged(values)
        assert not noise.squares.any()
        assert not noise.draw(max(len(values), 1), 3, RNG(0)).any()
    eight = judged(np.array([1.0, 5.0, 2.0, 8.0, 1.0, 0.0, 3.0, 4.0]))
    assert (bool(eight.squares.any()), eight.dof) == (True, 6)


RESTS = slice(0, 200), slice(2800, 3000)


def wander(rows: Floats, *, at_rest: bool) -> float:
    """Standard deviation of what draws wander from the first rest to the last one, on average."""
    scatters = []
    for row in rows:
        branches = [row[200 + 650 * at : 850 + 650 * at] for at in range(4)]
        rests = [[row[rest]] if at_rest else [] for rest in RESTS]
        noise = estimate_noise(branches, [0.0 * branch for branch in branches], *rests)
        drawn = noise.draw(3000, 400, RNG(8))
        scatters.append(np.std(drawn[:, RESTS[1]].mean(axis=1) - drawn[:, RESTS[0]].mean(axis=1)))
    return float(np.mean(scatters))


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
    smooth = fit_smooth_curve(at, values, [], 12)
    noise = estimate_noise([values], [smooth])
    assert noise.draw(len(at), 50, RNG(0)).std() == pytest.approx(2.0, rel=0.1)


def test_noise_of_a_short_record_is_what_polynomials_leave() -> None:
    """Median over 60 records of 15 samples with a knee; few free samples leave it open."""
    spreads = []
    for seed in range(60):
        values = np.minimum(np.linspace(0.0, 1.0, 15), 0.5) + 0.002 * RNG(seed).normal(size=15)
        pieces = cut_into_polynomials(values)
        assert (pieces[0].start, pieces[-1].stop) == (0, 15)
        assert all(one.stop == other.start for one, other in pairwise(pieces))
        noise = estimate_noise([values], [values])
        spreads.append(noise.draw(15, 50, RNG(0)).std())
    assert 0.75 < np.median(spreads) / 0.002 < 1.6


def test_pieces_of_a_short_record_do_not_follow_slow_noise() -> None:
    """A line in noise that is correlated over three samples, by its median over 40 records."""
    lengths, times = list[int](), list[float]()
    for seed in range(40):
        kicks, noise = RNG(seed).normal(size=60), np.zeros(60)
        for at in range(1, 60):
            noise[at] = np.exp(-1.0 / 3.0) * noise[at - 1] + kicks[at]
        values = 10.0 * np.arange(60.0) + noise
        lengths.append(len(cut_into_polynomials(values)))
        times.append(estimate_noise([values], [values]).correlation_time)
    assert np.mean(lengths) < 2.0
    assert 1.7 < np.median(times) < 4.0
