from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.estimates import Failure, return_failure
from labpipe.results.kinks_and_plateaus import Plateau, Tangents
from labpipe.uncertainty.replicates import Extractor, Trace
from tests.builders.plain_records import replicates_of, trace_of

OVER = 5e-3


SCALE = 0.012


D = np.linspace(0.0, 0.05, 1001)


SOFT: Floats = 10.0 * (1.0 - np.exp(-D / SCALE))


INITIAL = 10.0 / SCALE
"""The tangent is a tenth of it at SCALE ln 10, where the force is 9 N."""


ONSET = SCALE * np.log(10.0)


def tangents_of(d: Floats, f: Floats) -> Tangents:
    return Tangents.of(d, f, length=OVER)


def onset(force: Floats, initial: float = INITIAL, below: float = 0.1) -> tuple[float, float]:
    place, level = tangents_of(D, force).find_onset(force, np.array(initial), slope_below=below)
    return float(place), float(level)


FORTH = np.concatenate([D[:500], np.full(50, D[499]), D[480:]])
GAP = D[(D <= 0.012) | (D >= 0.019)]
STEPS = np.interp(D, [0.0, 0.01, 0.02, 0.03, 0.05], [0.0, 4.0, 4.1, 8.0, 8.1])
CURVES: dict[str, tuple[Floats, Floats, float, float, float]] = {
    "smooth": (D, SOFT, INITIAL, ONSET, 9.0),
    "back and forth, and a wait": (FORTH, np.interp(FORTH, D, SOFT), INITIAL, ONSET, 9.0),
    "a gap of more than a stretch": (GAP, np.interp(GAP, D, SOFT), INITIAL, ONSET, 9.0),
    # 385 N/m (1/2 - 3 t/4 + t^3/4) + 5 N/m are 40 N/m at t = 0.63 of half a tangent
    "flat, steep again, and flat": (D, STEPS, 400.0, 0.0316, 8.01),
    "six samples in half a stretch": (D[::10], SOFT[::10], INITIAL, ONSET, np.nan),
}


@pytest.mark.parametrize("name", CURVES)
def test_where_the_tangent_is_a_tenth(name: str) -> None:
    path, force, initial, expected_place, expected_force = CURVES[name]
    tangents = tangents_of(path, force)
    place, level = tangents.find_onset(force, np.array(initial), slope_below=0.1)
    assert float(place) == pytest.approx(expected_place, abs=1e-4)
    assert float(level) == pytest.approx(expected_force, abs=0.02, nan_ok=True)


def test_slope_at_the_end_and_its_line() -> None:
    tangents, curves = tangents_of(D, SOFT), np.stack([SOFT, SOFT + noise(1, len(D))])
    assert float(tangents.compute_end_slope(SOFT)) / INITIAL == pytest.approx(
        np.exp(-0.0475 / SCALE), rel=0.02
    )
    assert tangents.ends == pytest.approx((0.045, 0.05), abs=4e-5)
    assert len(tangents.end_samples) == np.count_nonzero(tangents.ends[0] <= D)
    for curve, end_slope in zip(curves, tangents.compute_end_slope(curves), strict=True):
        slope, level = parabola(D, curve, 0.0475, OVER)
        assert float(end_slope) == pytest.approx(slope, rel=1e-9)
        for at in (0.045, 0.0475):
            line = level + (at - 0.0475) * slope
            assert tangents.compute_end_force(at, curve) == pytest.approx(line, rel=1e-12)


def test_samples_on_the_ends_of_a_stretch_do_not_depend_on_rounding() -> None:
    """Speed by time at even rates: every 25 th sample lies on an end, within its last bits."""
    even = np.arange(1001) * 5e-5
    last_bits = 2e-16 * np.random.default_rng(2).choice([-1.0, 1.0], len(even))
    force = 10.0 * (1.0 - np.exp(-even / SCALE))
    numbers = []
    for off in (0.0, 1.0, -1.0):
        path: Floats = even * (1.0 + off * last_bits)
        tangents = Tangents.of(path, force, length=OVER)
        place, level = tangents.find_onset(force, np.array(INITIAL), slope_below=0.1)
        numbers.append([float(tangents.compute_end_slope(force)), float(place), float(level)])
    np.testing.assert_allclose(numbers[1:], [numbers[0]] * 2, rtol=1e-10)


def test_force_at_a_corner_is_not_cut_off() -> None:
    """A parabola over the whole stretch would lie below the corner."""
    force = np.where(D < 0.03, 4.5 + 100.0 * (D - 0.03), 4.5 - 10.0 * (D - 0.03))
    at, level = onset(force, 450.0)
    stretch = np.abs(D - at) <= 0.5 * OVER
    whole = float(np.polynomial.Polynomial.fit(D[stretch], force[stretch], 2)(at))
    cut = float(np.interp(at, D, force)) - whole
    assert cut > 0.01
    assert level - whole > 0.3 * cut
    change = tangents_of(D, force).measure_corner_changes(force, at, 45.0)
    assert change[1] == pytest.approx(level - whole, rel=0.02)


def noise(seed: int, *shape: int, deviation: float = 0.02) -> Floats:
    return np.random.default_rng(seed).normal(0.0, deviation, shape)


def parabola(d: Floats, f: Floats, at: float, over: float) -> tuple[float, float]:
    """Slope and level at a place of the parabola over a stretch around it."""
    begin, end = (d > edge - 1e-9 * over for edge in (at - 0.5 * over, at + 0.5 * over))
    inside = slice(int(np.argmax(begin)), int(np.argmax(end)) + 1)
    fit = np.polyfit(d[inside] - at, f[inside], 2)
    return float(fit[1]), float(fit[2])


def onset_of(d: Floats, f: Floats, slope: float) -> tuple[float, float]:
    """The same by walking back, one tangent at a time."""
    places = np.arange(d[-1] - 0.5 * OVER, 0.5 * OVER, -OVER / 8)
    slopes = [parabola(d, f, place, OVER)[0] for place in places]
    number = next(number for number, slope_there in enumerate(slopes) if slope_there >= slope)
    at = float(np.interp(slope, slopes[number - 1 : number + 1], places[number - 1 : number + 1]))
    return at, parabola(d, f, at, 0.5 * OVER)[1]


def test_onset_as_one_curve_at_a_time() -> None:
    curves = SOFT + noise(2, 2, 3, len(D))
    initial = INITIAL * (1.0 + noise(3, 2, 3))
    place, force = tangents_of(D, SOFT).find_onset(curves, initial, slope_below=0.1)
    assert place.shape == force.shape == (2, 3)
    for index in np.ndindex(2, 3):
        at, level = onset_of(D, curves[index], 0.1 * float(initial[index]))
        assert float(place[index]) == pytest.approx(at, rel=1e-9)
        assert float(force[index]) == pytest.approx(level, rel=1e-9)


def test_a_curve_without_onset_among_many() -> None:
    """Nowhere so steep: no number. Steep at its end: the place of the last tangent."""
    curves = np.stack([SOFT, 20.0 * D, 500.0 * D])
    place, force = tangents_of(D, SOFT).find_onset(curves, np.full(3, INITIAL), slope_below=0.1)
    assert np.isnan(place).tolist() == np.isnan(force).tolist() == [False, True, False]
    assert place[2] == pytest.approx(0.0475)
    assert force[2] == pytest.approx(500.0 * 0.0475)


def test_unknown_samples_and_displacements_of_their_own() -> None:
    holes = SOFT.copy()
    holes[[0, 400, 950]] = np.nan
    valid = ~np.isnan(holes)
    curves = SOFT + noise(4, 3, len(D))
    initial = np.full(3, INITIAL)
    plain = tangents_of(D[valid], SOFT[valid])
    tangents = tangents_of(D, holes)
    slopes = plain.compute_end_slope(curves[:, valid])
    assert tangents.compute_end_slope(curves) == pytest.approx(slopes)
    onset = plain.find_onset(curves[:, valid], initial, slope_below=0.1)
    same_onset = np.array(tangents.find_onset(curves, initial, slope_below=0.1))
    assert same_onset == pytest.approx(np.array(onset))
    off = noise(5, 3, len(D), deviation=2e-5)
    rows = np.broadcast_to(SOFT, off.shape)
    place, force = plain.find_onset(rows[:, valid], initial, (D + off)[:, valid], slope_below=0.1)
    moved = SOFT - INITIAL * np.exp(-D / SCALE) * off
    same = plain.find_onset(moved[:, valid], initial, slope_below=0.1)
    assert np.ptp(place) > 1e-5
    assert place == pytest.approx(same[0], abs=2e-6)
    assert force == pytest.approx(same[1], abs=2e-5)
    ends = plain.compute_end_slope(rows[:, valid], (D + off)[:, valid])
    assert ends == pytest.approx(plain.compute_end_slope(moved[:, valid]), abs=0.01)


def test_says_why_not() -> None:
    short = return_failure(Tangents.of)(D[:200], SOFT[:200], length=OVER)
    assert short == Failure("not_reached", "the branch is 9.95 mm long, twice 5 mm is needed")
    none = return_failure(Tangents.of)(D, np.full(len(D), np.nan), length=OVER)
    assert isinstance(none, Failure)
    assert none.code == "not_reached"
    sparse = return_failure(Tangents.of)(D[::50], SOFT[::50], length=OVER)
    assert sparse == Failure("too_few_samples", "3 samples in the stretch, 8 are needed")
    jump = np.concatenate([np.linspace(0.0, 0.04, 100), np.linspace(0.0499, 0.05, 100)])
    stuck = return_failure(Tangents.of)(jump, jump, length=OVER)
    assert stuck == Failure("no_travel", "the displacement jumps over the stretch")
    for at in (0.0451, 0.0453, 0.0457, 0.0459, 0.0463):
        two = np.concatenate([np.linspace(0.0, 0.0449, 100), np.repeat([at, 0.05], 10)])
        assert return_failure(Tangents.of)(two, two, length=OVER) == stuck


def test_what_a_corner_hides() -> None:
    """Two lines that meet: the tangent smears their corner, the parabola cuts it."""
    force = np.where(D < 0.03, 300.0, 10.0) * (D - 0.03) + 9.0
    tangents = tangents_of(D, force)
    at, level = tangents.find_onset(force, np.array(300.0), slope_below=0.1)
    place, cut, beyond = tangents.measure_corner_changes(force, float(at), 30.0)
    assert beyond == pytest.approx(10.0)
    assert 0.0 < float(at) - 0.03 < 0.5 * OVER
    # Half the length smears half as far, and cuts half as much.
    assert place == pytest.approx(0.5 * (0.03 - float(at)), rel=0.1)
    assert cut == pytest.approx(
        parabola(D, force, float(at), 0.5 * OVER)[1] - parabola(D, force, float(at), OVER)[1],
        rel=1e-6,
    )
    assert abs(cut) > 0.005
    assert float(level) == pytest.approx(float(np.interp(at, D, force)), abs=2.0 * abs(float(cut)))
    smooth = tangents_of(D, SOFT).measure_corner_changes(SOFT, SCALE * np.log(10.0), 0.1 * INITIAL)
    assert abs(smooth[0]) < 2e-4


def test_short_tangents_begin_at_the_first_sample_at_the_earliest() -> None:
    """Of a parabola, whose tangents have its slope whatever their length."""
    force, first = 400.0 * D - 3000.0 * D**2, 0.5 * OVER
    tangents = tangents_of(D, force)
    for at, change in ((0.75 * first, -0.25 * first), (0.25 * first, 0.0)):
        slope = 400.0 - 6000.0 * at
        assert tangents.measure_corner_changes(force, first, slope)[0] == pytest.approx(change)


def test_a_smooth_curve_that_does_not_rise_hides_no_noise_of_a_corner() -> None:
    drawn, plateau = replicates_of(trace_of(SOFT, D)), Plateau(slope_below=0.1)

    def initial(trace: Trace) -> Extractor:
        slope = np.array(INITIAL if trace is drawn.measured_trace else 0.0)
        return Extractor(lambda _: (slope,), 9)

    flat = Failure("no_stiffness", "the slope at the start is 0 N/m")
    assert return_failure(plateau._choose_tangents)(drawn.smooth_trace, initial) == flat
    corner = plateau._estimate_corner(drawn, initial)
    assert np.any(corner.error != 0.0)
    assert not corner.compute_noise_effect(np.ones((2, 5))).any()
