from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest, chi2

from labpipe.fits.plateau import Tangents
from labpipe.records.arrays import Floats
from labpipe.records.estimates import Failure

D = np.linspace(0.0, 0.05, 1500)


OVER = 5e-3


SCALE = 0.012


SOFT: Floats = 10.0 * (1.0 - np.exp(-D / SCALE))


"""Initial slope 10 / SCALE; the tangent is a tenth of it at SCALE ln 10."""


INITIAL = 10.0 / SCALE


ONSET = SCALE * np.log(10.0)


def tangents_of(force: Floats) -> Tangents:
    found = Tangents.of(D, force, over=OVER)
    assert isinstance(found, Tangents)
    return found


def onset(force: Floats, initial: float = INITIAL, below: float = 0.1) -> tuple[float, float]:
    place, level = tangents_of(force).onset(force, np.array(initial), slope_below=below)
    return float(place), float(level)


def test_smooth_curve_without_noise() -> None:
    place, level = onset(SOFT)
    assert place == pytest.approx(ONSET, abs=1e-4)
    assert level == pytest.approx(9.0, abs=0.02)
    tangents = tangents_of(SOFT)
    slope = float(tangents.slope_at_end(SOFT))
    assert slope / INITIAL == pytest.approx(np.exp(-0.0475 / SCALE), rel=0.02)
    start, stop = tangents.ends
    assert start == pytest.approx(0.045, abs=4e-5)
    assert stop == 0.05
    assert tangents.level_at(start, SOFT) == pytest.approx(np.interp(start, D, SOFT), abs=0.02)
    assert len(tangents.last) == np.count_nonzero(start <= D)


def test_samples_on_the_ends_of_a_stretch_do_not_depend_on_rounding() -> None:
    """Speed by time at even rates: every 25 th sample lies on an end, within its last bits."""
    even = np.arange(1001) * 5e-5
    last_bits = 2e-16 * np.random.default_rng(2).choice([-1.0, 1.0], len(even))
    force = 10.0 * (1.0 - np.exp(-even / SCALE))
    found = []
    for off in (0.0, 1.0, -1.0):
        path: Floats = even * (1.0 + off * last_bits)
        tangents = Tangents.of(path, force, over=OVER)
        assert isinstance(tangents, Tangents)
        place, level = tangents.onset(force, np.array(INITIAL), slope_below=0.1)
        found.append([float(tangents.slope_at_end(force)), float(place), float(level)])
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-10)


def test_a_kink_is_near_and_late() -> None:
    force = np.where(D < 0.03, 400.0 * D - 5000.0 * D**2, 7.5 + 8.0 * (D - 0.03))
    place, _ = onset(force, 400.0)
    assert 0.03 < place < 0.03 + 0.5 * OVER


def test_force_at_a_corner_is_not_cut_off() -> None:
    """A parabola over the whole stretch would lie below the corner."""
    force = np.where(D < 0.03, 4.5 + 100.0 * (D - 0.03), 4.5 - 10.0 * (D - 0.03))
    at, level = onset(force, 450.0)
    stretch = np.abs(D - at) <= 0.5 * OVER
    whole = float(np.polynomial.Polynomial.fit(D[stretch], force[stretch], 2)(at))
    cut = float(np.interp(at, D, force)) - whole
    assert cut > 0.01
    assert level - whole > 0.3 * cut
    change = tangents_of(force).corners(force, at, 45.0)
    assert change[1] == pytest.approx(level - whole, rel=0.02)


def test_flat_from_the_last_time_on() -> None:
    """A flat stretch halfway is no plateau, if the curve gets steep again."""
    force = np.interp(D, [0.0, 0.01, 0.02, 0.03, 0.05], [0.0, 4.0, 4.1, 8.0, 8.1])
    place, _ = onset(force, 400.0)
    assert place == pytest.approx(0.03, abs=0.5 * OVER)


def test_no_onset_in_a_curve_that_is_nowhere_steep() -> None:
    assert np.isnan(onset(10.0 * D)).all()


D_REPLICATES = np.linspace(0.0, 0.05, 1001)


SOFT_REPLICATES: Floats = 10.0 * (1.0 - np.exp(-D_REPLICATES / SCALE))


"""The tangent is a tenth of the initial slope at SCALE ln 10, where the force is 9 N."""


def tangents_of_of_replicates(d: Floats, f: Floats, over: float = OVER) -> Tangents:
    found = Tangents.of(d, f, over=over)
    assert isinstance(found, Tangents)
    return found


def noise(seed: int, *shape: int, deviation: float = 0.02) -> Floats:
    return np.random.default_rng(seed).normal(0.0, deviation, shape)


def parabola(d: Floats, f: Floats, at: float, over: float) -> tuple[float, float]:
    """Slope and level at a place of the parabola over a stretch around it."""
    begin, end = (d > each - 1e-9 * over for each in (at - 0.5 * over, at + 0.5 * over))
    inside = slice(int(np.argmax(begin)), int(np.argmax(end)) + 1)
    fit = np.polyfit(d[inside] - at, f[inside], 2)
    return float(fit[1]), float(fit[2])


def onset_of(d: Floats, f: Floats, slope: float) -> tuple[float, float]:
    """The same by walking back, one tangent at a time."""
    places = np.arange(d[-1] - 0.5 * OVER, 0.5 * OVER, -OVER / 8)
    slopes = [parabola(d, f, place, OVER)[0] for place in places]
    number = next(number for number, each in enumerate(slopes) if each >= slope)
    at = float(np.interp(slope, slopes[number - 1 : number + 1], places[number - 1 : number + 1]))
    return at, parabola(d, f, at, 0.5 * OVER)[1]


def test_end_slope_and_its_line() -> None:
    curves = SOFT_REPLICATES + noise(1, 2, 3, len(D_REPLICATES))
    tangents = tangents_of_of_replicates(D_REPLICATES, SOFT_REPLICATES)
    found = tangents.slope_at_end(curves)
    assert found.shape == (2, 3)
    for place in np.ndindex(2, 3):
        slope, level = parabola(D_REPLICATES, curves[place], 0.0475, OVER)
        assert float(found[place]) == pytest.approx(slope, rel=1e-9)
        assert tangents.level_at(0.0475, curves[place]) == pytest.approx(level, rel=1e-12)
        begin = tangents.level_at(0.045, curves[place])
        assert begin == pytest.approx(level - 0.0025 * slope, rel=1e-12)
    assert tangents.slope_at_end(SOFT_REPLICATES).shape == ()


def test_onset_as_one_curve_at_a_time() -> None:
    curves = SOFT_REPLICATES + noise(2, 2, 3, len(D_REPLICATES))
    initial = INITIAL * (1.0 + noise(3, 2, 3))
    place, force = tangents_of_of_replicates(D_REPLICATES, SOFT_REPLICATES).onset(
        curves, initial, slope_below=0.1
    )
    assert place.shape == force.shape == (2, 3)
    for each in np.ndindex(2, 3):
        at, level = onset_of(D_REPLICATES, curves[each], 0.1 * float(initial[each]))
        assert float(place[each]) == pytest.approx(at, rel=1e-9)
        assert float(force[each]) == pytest.approx(level, rel=1e-9)


def test_a_curve_without_onset_among_many() -> None:
    """Nowhere so steep: no number. Steep at its end: the place of the last tangent."""
    curves = np.stack([SOFT_REPLICATES, 20.0 * D_REPLICATES, 500.0 * D_REPLICATES])
    place, force = tangents_of_of_replicates(D_REPLICATES, SOFT_REPLICATES).onset(
        curves, np.full(3, INITIAL), slope_below=0.1
    )
    assert np.isnan(place).tolist() == np.isnan(force).tolist() == [False, True, False]
    assert place[2] == pytest.approx(0.0475)
    assert force[2] == pytest.approx(500.0 * 0.0475)


def test_unknown_samples_and_displacements_of_their_own() -> None:
    holes = SOFT_REPLICATES.copy()
    holes[[0, 400, 950]] = np.nan
    known = ~np.isnan(holes)
    curves = SOFT_REPLICATES + noise(4, 3, len(D_REPLICATES))
    initial = np.full(3, INITIAL)
    plain = tangents_of_of_replicates(D_REPLICATES[known], SOFT_REPLICATES[known])
    found = tangents_of_of_replicates(D_REPLICATES, holes)
    assert found.slope_at_end(curves) == pytest.approx(plain.slope_at_end(curves[:, known]))
    for one, other in zip(
        found.onset(curves, initial, slope_below=0.1),
        plain.onset(curves[:, known], initial, slope_below=0.1),
        strict=True,
    ):
        assert one == pytest.approx(other)
    off = noise(5, 3, len(D_REPLICATES), deviation=2e-5)
    seen = np.broadcast_to(SOFT_REPLICATES, off.shape)
    place, force = plain.onset(
        seen[:, known], initial, (D_REPLICATES + off)[:, known], slope_below=0.1
    )
    moved = SOFT_REPLICATES - INITIAL * np.exp(-D_REPLICATES / SCALE) * off
    same = plain.onset(moved[:, known], initial, slope_below=0.1)
    assert np.ptp(place) > 1e-5
    assert place == pytest.approx(same[0], abs=2e-6)
    assert force == pytest.approx(same[1], abs=2e-5)
    ends = plain.slope_at_end(seen[:, known], (D_REPLICATES + off)[:, known])
    assert ends == pytest.approx(plain.slope_at_end(moved[:, known]), abs=0.01)


def test_back_and_forth_and_waits() -> None:
    """Samples count from when a place is first reached, and waits do no harm."""
    d = np.concatenate([D_REPLICATES[:500], np.full(50, D_REPLICATES[499]), D_REPLICATES[480:]])
    f = np.interp(d, D_REPLICATES, SOFT_REPLICATES)
    place, force = tangents_of_of_replicates(d, f).onset(f, np.array(INITIAL), slope_below=0.1)
    assert float(place) == pytest.approx(SCALE * np.log(10.0), abs=1e-4)
    assert float(force) == pytest.approx(9.0, abs=0.01)


def test_tangents_end_where_there_is_none() -> None:
    gap = (D_REPLICATES > 0.012) & (D_REPLICATES < 0.019)
    tangents = tangents_of_of_replicates(D_REPLICATES[~gap], SOFT_REPLICATES[~gap])
    assert tangents.places[-1] > 0.019
    place, _ = tangents.onset(SOFT_REPLICATES[~gap], np.array(INITIAL), slope_below=0.1)
    assert float(place) == pytest.approx(SCALE * np.log(10.0), abs=1e-4)


def test_says_why_not() -> None:
    short = Tangents.of(D_REPLICATES[:200], SOFT_REPLICATES[:200], over=OVER)
    assert short == Failure("not_reached", "the branch is 9.95 mm long, twice 5 mm is needed")
    none = Tangents.of(D_REPLICATES, np.full(len(D_REPLICATES), np.nan), over=OVER)
    assert isinstance(none, Failure)
    assert none.code == "not_reached"
    sparse = Tangents.of(D_REPLICATES[::50], SOFT_REPLICATES[::50], over=OVER)
    assert sparse == Failure("too_few_samples", "3 samples in the stretch, 8 are needed")
    jump = np.concatenate([np.linspace(0.0, 0.04, 100), np.linspace(0.0499, 0.05, 100)])
    stuck = Tangents.of(jump, jump, over=OVER)
    assert stuck == Failure("no_travel", "the displacement jumps over the stretch")
    for at in (0.0451, 0.0453, 0.0457, 0.0459, 0.0463):
        two = np.concatenate([np.linspace(0.0, 0.0449, 100), np.repeat([at, 0.05], 10)])
        assert Tangents.of(two, two, over=OVER) == stuck


def test_no_force_where_half_the_stretch_is_too_short() -> None:
    """Eleven samples in a stretch are enough, six in its half are not."""
    place, force = tangents_of_of_replicates(D_REPLICATES[::10], SOFT_REPLICATES[::10]).onset(
        SOFT_REPLICATES[::10], np.array(INITIAL), slope_below=0.1
    )
    assert float(place) == pytest.approx(SCALE * np.log(10.0), abs=1e-4)
    assert np.isnan(force)


def test_what_a_corner_hides() -> None:
    """Two lines that meet: the tangent smears their corner, the parabola cuts it."""
    force = np.where(D_REPLICATES < 0.03, 300.0, 10.0) * (D_REPLICATES - 0.03) + 9.0
    tangents = tangents_of_of_replicates(D_REPLICATES, force)
    at, level = tangents.onset(force, np.array(300.0), slope_below=0.1)
    place, cut, beyond = tangents.corners(force, float(at), 30.0)
    assert beyond == pytest.approx(10.0)
    assert 0.0 < float(at) - 0.03 < 0.5 * OVER
    # Half the length smears half as far, and cuts half as much.
    assert place == pytest.approx(0.5 * (0.03 - float(at)), rel=0.1)
    assert cut == pytest.approx(
        parabola(D_REPLICATES, force, float(at), 0.5 * OVER)[1]
        - parabola(D_REPLICATES, force, float(at), OVER)[1],
        rel=1e-6,
    )
    assert abs(cut) > 0.005
    assert float(level) == pytest.approx(
        float(np.interp(at, D_REPLICATES, force)), abs=2.0 * abs(float(cut))
    )
    smooth = tangents_of_of_replicates(D_REPLICATES, SOFT_REPLICATES).corners(
        SOFT_REPLICATES, SCALE * np.log(10.0), 0.1 * INITIAL
    )
    assert abs(smooth[0]) < 2e-4


def test_replicates_scatter_as_curves_do() -> None:
    seeds = 200
    tangents = tangents_of_of_replicates(D_REPLICATES, SOFT_REPLICATES)
    initial = INITIAL * (1.0 + noise(10, seeds, deviation=0.01))
    plain = np.array(
        [
            onset_of(
                D_REPLICATES, SOFT_REPLICATES + noise(seed, len(D_REPLICATES)), 0.1 * initial[seed]
            )
            for seed in range(seeds)
        ]
    )
    drawn = tangents.onset(
        SOFT_REPLICATES + noise(999, 2000, len(D_REPLICATES)),
        INITIAL * (1.0 + noise(11, 2000, deviation=0.01)),
        slope_below=0.1,
    )
    for number in range(2):
        ratio = seeds * float(plain[:, number].std(ddof=1) / drawn[number].std()) ** 2
        assert chi2.ppf(0.001, seeds) < ratio < chi2.ppf(0.999, seeds)
    # By hand: the slope of a line has the deviation of the noise over the root of sum l^2.
    inside = D_REPLICATES >= 0.045
    lever = D_REPLICATES[inside] - D_REPLICATES[inside].mean()
    by_hand = 0.02 / np.sqrt(lever @ lever)
    assert float(
        tangents.slope_at_end(SOFT_REPLICATES + noise(998, 2000, len(D_REPLICATES))).std()
    ) == pytest.approx(by_hand, rel=0.05)


@pytest.mark.slow
def test_intervals_from_replicates_cover() -> None:
    """Curves of noise, replicates about the curve without it; deltas as the engine takes them."""
    seeds, hits = 200, np.zeros(3, dtype=int)
    tangents = tangents_of_of_replicates(D_REPLICATES, SOFT_REPLICATES)
    base = (
        *tangents.onset(SOFT_REPLICATES, np.array(INITIAL), slope_below=0.1),
        tangents.slope_at_end(SOFT_REPLICATES),
    )
    truth = (*base[:2], base[2] / INITIAL)
    for seed in range(seeds):
        value = INITIAL * (1.0 + float(noise(seed + 7000, deviation=0.01)))
        f = SOFT_REPLICATES + noise(seed, len(D_REPLICATES))
        found = tangents.onset(f, np.array(value), slope_below=0.1)
        numbers = (*found, tangents.slope_at_end(f) / value)
        initial = INITIAL * (1.0 + noise(seed + 9000, 200, deviation=0.01))
        curves = SOFT_REPLICATES + noise(seed + 5000, 200, len(D_REPLICATES))
        drawn = tangents.onset(curves, initial, slope_below=0.1)
        shares = tangents.slope_at_end(curves) / initial
        for number, share in enumerate((*drawn, shares)):
            low, high = np.quantile(share - truth[number], [0.025, 0.975])
            hits[number] += float(numbers[number]) - high <= truth[number]
            hits[number] -= float(numbers[number]) - low < truth[number]
    for count in hits.tolist():
        assert binomtest(count, seeds, 0.95).pvalue > 0.003
