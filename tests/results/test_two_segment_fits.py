from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.estimates import Failure, return_failure
from labpipe.results.kinks_and_plateaus import (
    Hinges,
    Segments,
    find_break_doubts,
    find_contact_doubts,
    require_bend,
    require_kink,
)
from labpipe.uncertainty.intervals import MeasuredNumber

D = np.linspace(0.002, 0.02, 181)
F = 45.0 + np.where(D < 0.0093, 5000.0, 2700.0) * (D - 0.0093)


def test_says_why_not() -> None:
    assert return_failure(Hinges.of)(D[:15], F[:15]) == Failure(
        "too_few_samples", "15 samples in the stretch, 16 are needed"
    )
    back = return_failure(Hinges.of)(D[::-1], F[::-1])
    assert back == Failure("not_increasing", "the displacement goes from 0.02 m to 0.002 m")


def hinges_of(d: Floats, f: Floats) -> Hinges:
    return Hinges.of(d, f)


def noise(seed: int, *shape: int, deviation: float = 0.5) -> Floats:
    return np.random.default_rng(seed).normal(0.0, deviation, shape)


def lines_at(at: float, d: Floats, f: Floats) -> Floats:
    """Level, first and second slope of the lines with that break."""
    columns = [np.ones_like(d), np.minimum(d - at, 0.0), np.maximum(d - at, 0.0)]
    coefficients: Floats = np.linalg.lstsq(np.column_stack(columns), f, rcond=None)[0]
    return coefficients


def left_by(at: float, d: Floats, f: Floats) -> Floats:
    level, first, second = lines_at(at, d, f)
    residual: Floats = f - level - np.where(d < at, first, second) * (d - at)
    return residual


def best_of(d: Floats, f: Floats) -> float:
    """Of crossings of separate lines in every gap, and breaks at samples (Hudson 1966)."""
    tried = list(d[3:-3])
    for gap in range(4, len(d) - 3):
        before, behind = (
            np.polyfit(d[part], f[part], 1) for part in (slice(gap), slice(gap, None))
        )
        tried.append(np.clip((behind[1] - before[1]) / (before[0] - behind[0]), d[gap - 1], d[gap]))
    return float(min(tried, key=lambda at: float(np.sum(left_by(at, d, f) ** 2))))


@pytest.mark.parametrize("count", [16, 33, 64, 181])
@pytest.mark.parametrize("deviation", [0.0, 0.5])
def test_of_the_curve_decided_on_it_is_the_exact_optimum(count: int, deviation: float) -> None:
    d = np.linspace(0.002, 0.02, count)
    f = 45.0 + np.where(d < 0.0093, 5000.0, 2700.0) * (d - 0.0093)
    f += noise(3, count, deviation=deviation)
    best, fit = best_of(d, f), hinges_of(d, f).fit(f)
    assert fit.break_point.shape == ()
    assert float(fit.break_point) == pytest.approx(best, rel=1e-9)
    level, first, second = lines_at(best, d, f)
    assert float(fit.first_slope) == pytest.approx(first, rel=1e-9)
    assert float(fit.second_slope) == pytest.approx(second, rel=1e-9)
    assert float(fit.break_force) == pytest.approx(level, rel=1e-9)


@pytest.mark.parametrize("at", [3, 16])
def test_a_break_may_be_the_fourth_sample_from_an_end(at: int) -> None:
    """Of 20 samples, in noise, so that separate lines seldom cross in the gap beside it."""
    d = np.arange(20.0)
    bests = []
    for seed in range(20):
        f = 10.0 * np.minimum(d - d[at], 0.0) - 10.0 * np.maximum(d - d[at], 0.0)
        f += noise(seed, 20, deviation=3.0)
        bests.append(best_of(d, f))
        assert float(hinges_of(d, f).fit(f).break_point) == pytest.approx(bests[-1], rel=1e-9)
    assert bests.count(d[at]) > 2


def test_replicates_are_the_optimum_of_brute_force() -> None:
    curves = F + noise(5, 2, 3, len(D))
    fit = hinges_of(D, F).fit(curves)
    assert fit.break_point.shape == (2, 3)
    scatter = float(fit.break_point.std())
    for place in np.ndindex(2, 3):
        tried = np.linspace(0.0085, 0.0101, 201)
        squares = [float(np.sum(left_by(at, D, curves[place]) ** 2)) for at in tried]
        best = tried[int(np.argmin(squares))]
        assert float(fit.break_point[place]) == pytest.approx(best, abs=0.2 * scatter)
        level, first, second = lines_at(float(fit.break_point[place]), D, curves[place])
        assert float(fit.break_force[place]) == pytest.approx(level, rel=1e-9)
        assert float(fit.first_slope[place]) == pytest.approx(first, rel=1e-9)
        assert float(fit.second_slope[place]) == pytest.approx(second, rel=1e-9)


def test_steps_and_waits_in_the_displacement() -> None:
    """Places between which there is no sample, and many samples between two."""
    d = np.repeat(np.linspace(0.002, 0.02, 25), 8)
    d[96:104] = d[95]
    f = 45.0 + np.where(d < 0.0093, 5000.0, 2700.0) * (d - 0.0093)
    fit = hinges_of(d, f).fit(f + noise(1, 20, len(d)))
    for at, first in zip(fit.break_point, fit.first_slope, strict=True):
        assert abs(float(at) - 0.0093) < 1e-3
        assert abs(float(first) - 5000.0) < 200.0


def test_order_and_unknown_samples() -> None:
    mixed = np.random.default_rng(0).permutation(len(D))
    mixed = mixed[np.argsort(D[mixed] + noise(1, len(D), deviation=2e-4))]  # as cameras see it
    curves = F + noise(2, 6, len(D))
    holes = curves.copy()
    holes[:, 50] = np.nan
    hole = F.copy()
    hole[50] = np.nan
    plain = hinges_of(np.delete(D, 50), np.delete(F, 50)).fit(np.delete(curves, 50, axis=1))
    for fit in (
        hinges_of(D, hole).fit(holes),
        hinges_of(D[mixed], hole[mixed]).fit(holes[:, mixed]),
    ):
        for name in ("break_point", "first_slope", "second_slope", "break_force"):
            assert getattr(fit, name) == pytest.approx(getattr(plain, name), rel=1e-9)
    curves[2, 7] = np.nan
    fit = hinges_of(D, F).fit(curves)
    assert np.isnan(fit.first_slope).tolist() == [False, False, True, False, False, False]


def test_displacements_of_their_own_are_noise_of_the_force() -> None:
    """A displacement that is off by e is a force that is off by the slope times e."""
    off = noise(4, 50, len(D), deviation=2e-5)
    hinges, at = hinges_of(D, F), np.abs(D - 0.0093) > 5e-4
    slope = np.where(D < 0.0093, 5000.0, 2700.0)
    fit = hinges.fit(np.broadcast_to(F, off.shape), D + off * at)
    same = hinges.fit(F - slope * off * at)
    assert fit.break_point == pytest.approx(same.break_point, abs=1e-9)
    assert fit.first_slope == pytest.approx(same.first_slope, rel=1e-6)
    spread = float(fit.first_slope.std())
    truly = [np.polyfit((D + e)[at & (D < 0.0093)], F[at & (D < 0.0093)], 1)[0] for e in off * at]
    assert spread == pytest.approx(np.std(truly), rel=0.3)


def test_samples_beyond_the_places() -> None:
    for count, beyond in ((16, 4), (31, 4), (48, 6), (64, 8), (400, 8)):
        d = np.arange(float(count))
        hinges = hinges_of(d, np.minimum(d, 0.5 * count))
        ends = hinges.convert_to_displacement(hinges.candidates[[0, -1]])
        assert ends == pytest.approx([d[beyond - 1], d[-beyond]])


def segments(at: ArrayLike, first: ArrayLike, second: ArrayLike) -> Segments:
    return Segments(*(np.asarray(column, dtype=np.float64) for column in (at, first, second, 45.0)))


def numbers_of(found: Segments, drawn: Segments) -> tuple[MeasuredNumber, ...]:
    """Numbers of a curve, and their replicates about them."""
    pairs = zip(found, drawn, strict=True)
    return tuple(MeasuredNumber(float(x), np.asarray(drawn - x), (), 1) for x, drawn in pairs)


def bend_of(found: Segments, drawn: Segments, hinges: Hinges) -> Failure | None:
    return return_failure(require_bend)(numbers_of(found, drawn), hinges)


def kink_of(found: Segments, drawn: Segments, hinges: Hinges) -> Failure | None:
    return return_failure(require_kink)(numbers_of(found, drawn), hinges)


def test_slopes_that_change_together_are_sure_to_differ() -> None:
    """Both are known to 1000 N/m, their difference to 10 N/m."""
    common, own = noise(1, 200, deviation=1000.0), noise(2, 200, deviation=10.0)
    drawn = segments(np.full(200, 0.0093), 5000.0 + common, 2700.0 + common + own)
    assert bend_of(segments(0.0093, 5000.0, 2700.0), drawn, hinges_of(D, F)) is None


def test_four_standard_errors_of_the_bend_by_hand() -> None:
    """Bends of -61, -62, ... -139 N/m: 2.5 % bend by less than 62.95 N/m, the middle one by 100."""
    second = 1000.0 - np.arange(61.0, 140.0)
    hinges = hinges_of(D, F)
    drawn = segments(np.full(79, 0.0093), np.full(79, 1000.0), second)
    four = 4.0 * 37.05 / 1.959964
    assert bend_of(segments(0.0093, 1000.0, 999.0 - four), drawn, hinges) is None
    failure = bend_of(segments(0.0093, 1000.0, 1000.5 - four), drawn, hinges)
    assert failure == Failure(
        "no_bend",
        "slopes 1000 and 924.886 N/m differ by 75.1 N/m, 4.0 standard errors of 18.9 N/m are "
        "needed",
    )
    first = np.append(np.full(79, 1000.0), np.nan)
    with_hole = segments(np.append(np.full(79, 0.0093), np.nan), first, np.append(second, np.nan))
    assert bend_of(segments(0.0093, 1000.0, 1000.5 - four), with_hole, hinges) == failure


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_replicates_that_bend_far_more_do_not_hide_a_bend(sense: float) -> None:
    """Those that bend less, or the other way, do."""
    bends = sense * (100.0 + np.linspace(-10.0, 10.0, 100))
    bends[::5] *= 30.0
    first, plain = np.full(100, 1000.0), segments(0.0093, 1000.0, 1000.0 + 100.0 * sense)
    drawn = segments(np.full(100, 0.0093), first, first + bends)
    assert bend_of(plain, drawn, hinges_of(D, F)) is None
    bends[::5] *= -1.0
    drawn = segments(np.full(100, 0.0093), first, first + bends)
    assert bend_of(plain, drawn, hinges_of(D, F)) is not None


def test_a_break_that_may_be_an_end() -> None:
    """One replicate in forty within two places of an end: the interval has no end there."""
    hinges, plain = hinges_of(D, F), segments(0.011, 5000.0, 2700.0)
    step = (D[-8] - D[7]) / 299
    first = 5000.0 + np.arange(41) % 2
    why = Failure("no_bend", "the break may be at an end of the stretch, 0.002 to 0.02 m")

    def bend(place: float, count: int) -> Failure | None:
        at = np.full(count, 0.011)
        at[3] = place
        return bend_of(plain, segments(at, first[:count], np.full(count, 2700.0)), hinges)

    for end, inwards in ((D[7], step), (D[-8], -step)):
        assert bend(end + 2.1 * inwards, 40) is None
        assert bend(end + 1.9 * inwards, 40) == why
        assert bend(end + 1.9 * inwards, 41) is None


def test_an_interval_of_the_break_that_ends_at_an_end() -> None:
    """A break near 17 mm, of which replicates say that it may be off by -2.4 mm now and then."""
    hinges, slopes = (hinges_of(D, F), (5000.0 + np.arange(40) % 2, np.full(40, 2700.0)))
    at = np.full(40, 0.0093)
    at[3] -= 2.4e-3
    for place, is_none in ((0.0166, False), (0.0172, True)):
        drawn = segments(at - 0.0093 + place, *slopes)
        failure = bend_of(segments(place, 5000.0, 2700.0), drawn, hinges)
        assert (failure is not None) == is_none
        assert failure is None or "may be at an end" in failure.message


def test_kinks() -> None:
    noisy = noise(0, len(D), deviation=0.02)
    hinges = hinges_of(D, 5000.0 * D + noisy)
    steady = segments(np.full(3, 0.0093), [900.0, 901.0, 902.0], [350.0, 350.0, 350.0])
    assert kink_of(segments(0.0093, 900.0, 350.0), steady, hinges) is None
    rises = kink_of(segments(0.0093, 350.0, 900.0), steady, hinges)
    assert rises == Failure("no_kink", "the slope rises from 350 to 900 N/m at 9.3 mm")
    # The first twentieth of 2 to 20 mm ends at 2.9 mm, the last begins at 19.1 mm.
    for at, is_at_end in ((2.89e-3, True), (2.91e-3, False), (19.09e-3, False), (19.11e-3, True)):
        drawn = segments(np.full(3, at), [900.0, 901.0, 902.0], [350.0, 350.0, 350.0])
        failure = kink_of(segments(at, 900.0, 350.0), drawn, hinges)
        assert (failure is not None) == is_at_end
        assert failure is None or failure.code == "kink_at_end"
    straight = kink_of(segments(0.0093, 900.0, 899.0), steady, hinges)
    assert straight is not None
    assert straight.code == "no_kink"
    deviation = float(np.std(noisy - np.polyval(np.polyfit(D, noisy, 1), D), ddof=2))
    for fact in (f"{deviation:.3g} N", "2 to 20 mm", "slopes 900 and 899 N/m differ by 1 N/m"):
        assert fact in straight.message


def test_a_break_within_a_quarter_of_the_stretch() -> None:
    hinges = hinges_of(D, F)
    assert find_break_doubts(Interval(0.008, 0.0124), hinges) == ()
    (doubt,) = find_break_doubts(Interval(0.008, 0.0126), hinges)
    assert doubt == Failure(
        "wide_break",
        "the break lies within 4.6 mm, more than a quarter of the stretch from 2 to 20 mm",
    )


@pytest.mark.parametrize(
    ("at", "first", "second", "is_doubtful"),
    [
        (0.0093, 5000.0, 2700.0, False),
        (0.0093, 7500.0, 2700.0, True),  # zero force at 3.3 mm: the line begins at -9.8 N
        (0.0010, 5.0, 2700.0, False),  # a plateau at 45 N
    ],
)
def test_a_specimen_that_is_not_loaded_where_the_stretch_begins(
    at: float, first: float, second: float, is_doubtful: bool
) -> None:
    found = segments(at, first, second)
    doubts = find_contact_doubts(numbers_of(found, found), hinges_of(D, F))
    assert [doubt.code for doubt in doubts] == ["late_contact"] * is_doubtful


def test_a_specimen_that_is_touched_within_the_stretch() -> None:
    force = 2700.0 * np.maximum(D - 0.0093, 0.0)
    hinges = hinges_of(D, force)
    found = hinges.fit(force)
    (doubt,) = find_contact_doubts(numbers_of(found, found), hinges)
    assert "not yet loaded at 2 mm" in doubt.message


def test_a_straight_line_does_not_bend() -> None:
    for seed in range(12):
        slope = -300.0 if seed % 2 else 5000.0
        f = slope * D + noise(seed, len(D))
        hinges = hinges_of(D, f)
        line: Floats = np.polynomial.Polynomial.fit(D, f, 5)(D)
        drawn = hinges_of(D, line).fit(line + noise(seed + 5000, 400, len(D)))
        failure = bend_of(hinges.fit(f), drawn, hinges)
        assert failure is not None, seed
