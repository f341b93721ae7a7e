"""The search, its local minima, profiles of the likelihood, and quantiles of few samples."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.special import ndtr

from labpipe.records.wire_calibration import (
    Calibration,
    CalibrationFailure,
    Identifiability,
    ParameterChoice,
    ScatterMixture,
)
from labpipe.wire.calibration.calibrate_wire import calibrate
from labpipe.wire.calibration.fit import CalibrationFit, Settings, find, pose
from labpipe.wire.calibration.law_components import take_apart
from labpipe.wire.calibration.local_minima import settle
from labpipe.wire.calibration.nonlinearity import tube_quantile
from labpipe.wire.calibration.parameter_search import (
    Fit,
    Levels,
    Point,
    Problem,
    normal_matrix,
    search,
)
from labpipe.wire.calibration.profile_likelihood import reach, traces
from labpipe.wire.calibration.scatter_mixture import quantiles
from labpipe.wire.calibration.variances import quantile
from tests.builders.loading_tests import TRUTH, measured, wire_of

WIRE = wire_of("A2")


CURVES = measured(n=40, seed=3)


ALL = np.ones(3, dtype=np.bool_)


LEVELS = Levels(1.0, 0.0, 0.03)


PROBLEM = Problem(
    take_apart(WIRE.section, WIRE.contacts),
    CURVES,
    np.arange(3),
    np.zeros(3),
    np.zeros(3),
    np.log(TRUTH) - 5.0,
    np.log(TRUTH) + 5.0,
    0.005,
)


def start(*factors: float) -> Point:
    return Point(np.log(TRUTH * factors), 0.0, np.zeros(3))


def test_the_least_has_no_slope() -> None:
    fit = search(PROBLEM, LEVELS, start(2.0, 1.2, 0.8), ALL)
    assert fit.settled
    for number in range(3):
        for step in (1e-2, -1e-2):
            logs = fit.point.logs + step * np.eye(3)[number]
            beside = search(PROBLEM, LEVELS, replace(fit.point, logs=logs), np.zeros(3, np.bool_))
            assert beside.objective > fit.objective - 1e-4


def test_offsets_are_shrunken_factors_of_the_samples() -> None:
    none = np.zeros(3, dtype=np.bool_)
    fit = search(PROBLEM, LEVELS, start(1.0, 1.0, 1.0), none)
    for sample, curve in enumerate(CURVES):
        model, left = fit.models[sample].force, np.asarray(curve.force)
        direct = np.log(float(left @ model) / float(model @ model))
        assert fit.point.gain + fit.point.offsets[sample] == pytest.approx(direct, rel=0.05)
    # The gain and the mean offset share the mean factor as their variances.
    share = fit.point.gain / 0.005**2, fit.point.offsets.sum() / 0.03**2
    assert share[0] == pytest.approx(share[1], rel=1e-3)


def problem_of(n: int = 60, **more: float) -> Problem:
    wire = wire_of("A2")
    curves = measured(seed=2, n=n, noise=0.0005, **more)  # type: ignore[arg-type]
    posed = pose(take_apart(wire.section, wire.contacts), curves, {}, 0.005)
    assert not isinstance(posed, CalibrationFailure)
    return posed[0]


@pytest.mark.slow
def test_the_same_answer_from_any_start() -> None:
    """Twenty starts, two decades wide in each parameter."""
    problem = problem_of()
    generator = np.random.default_rng(7)
    starts = [generator.uniform(-np.log(10.0), np.log(10.0), 3) for _ in range(20)]
    settled = (settle(problem, np.log(TRUTH) + start, ALL, scatter=None) for start in starts)
    found = [each.fits[0] for each in settled]
    logs = np.array([fit.point.logs for fit in found])
    # Far below the standard errors, which are about 0.2, 0.02 and 0.05.
    assert np.ptp(logs, axis=0) == pytest.approx(np.zeros(3), abs=5e-3)
    assert np.ptp([fit.objective for fit in found]) < 1e-2
    assert all(fit.settled for fit in found)


def test_levels_are_found() -> None:
    problem = problem_of(n=1200, correlation=0.6)
    settled = settle(problem, np.log(TRUTH), ALL, scatter=None)
    fit, levels = settled.fits[0], settled.levels
    # Standard errors: sqrt((1 - 0.6^2) / 3600) = 0.013 and sqrt(2 / 3600) = 0.024.
    assert levels.correlation == pytest.approx(0.6, abs=0.05)
    assert levels.noise == pytest.approx(1.0, abs=0.1)
    assert 0.01 < levels.scatter < 0.08
    assert fit.settled


@lru_cache
def two_valleys() -> Calibration:
    """A campaign in which hard copper with half the insulation fits as well as the truth."""
    found = calibrate(wire_of("A3"), measured("A3", (0.12,), seed=1), Settings(gain=0.005))
    assert isinstance(found, Calibration)
    return found


def test_both_solutions_are_kept_and_said() -> None:
    found = two_valleys()
    best, other = found.solutions
    assert best.rise == 0.0
    assert 0.0 < other.rise < other.limit
    low, high = sorted([best, other], key=lambda each: float(each.values[2]))
    assert low.values[1:] == pytest.approx(TRUTH[1:], rel=0.3)
    assert high.values[2] > 5.0
    copper = found.parameter("copper_scale")
    assert copper.verdict is Identifiability.TWO
    first, second = copper.intervals
    assert first.lower < TRUTH[2] < first.upper < second.lower < high.values[2] < second.upper
    assert [profile.deviance.min() for profile in copper.profiles] == [0.0, other.rise]
    assert "two_solutions" in [note.code for note in found.notes]


@pytest.mark.parametrize(("scale", "best"), [(1.0, 1.06), (6.0, 6.2)])
def test_a_prior_tells_them_apart(scale: float, best: float) -> None:
    prior = ParameterChoice(scale, factor=1.5, source="tensile tests of strands")
    curves = measured("A3", (0.12,), seed=1)
    found = calibrate(wire_of("A3"), curves, Settings({"copper_scale": prior}, gain=0.005))
    assert isinstance(found, Calibration)
    assert len(found.solutions) == 1
    copper = found.parameter("copper_scale")
    assert copper.value == pytest.approx(best, rel=0.1)
    assert len(copper.intervals) == 1
    assert copper.conflict is not None
    assert copper.conflict.source == "tensile tests of strands"
    assert not copper.conflict.contradicts


def test_a_least_that_is_found_twice_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search from a dip beside the least ends a rounding below it."""

    def lower_by_rounding(*given: object) -> list[Fit]:
        fit = given[3]
        assert isinstance(fit, Fit)
        return [replace(fit, objective=fit.objective - 1e-6)]

    monkeypatch.setattr(
        "labpipe.wire.calibration.local_minima.find_local_minima", lower_by_rounding
    )
    fits = settle(problem_of(), np.log(TRUTH), ALL, scatter=None).fits
    assert len(fits) == 1


FIXED = ParameterChoice(is_fixed=True)


def found_of(settings: Settings, **more: float) -> CalibrationFit:
    found = find(wire_of("A2"), measured(seed=4, n=90, **more), settings)  # type: ignore[arg-type]
    assert not isinstance(found, CalibrationFailure)
    return found


def test_along_the_line_of_the_leasts_the_copper_reaches_as_far_as_its_profile() -> None:
    """The line is that profile, in strides."""
    found = found_of(Settings(gain=0.005))
    (traced,) = traces(found, 2)
    assert reach(found, 2, 1.0) == pytest.approx((traced.lower, traced.upper), abs=0.01)
    (higher,) = traces(found, 2, unlikely=1.727)
    assert reach(found, 2, 1.727) == pytest.approx((higher.lower, higher.upper), abs=0.01)
    assert higher.threshold_above == pytest.approx(1.727 * traced.threshold_above)
    assert higher.lower < traced.lower < traced.upper < higher.upper
    low, high = reach(found, 1, 1.0)  # the insulation gives as the copper is held
    (modulus,) = traces(found, 1)
    assert low == pytest.approx(modulus.lower, abs=0.02)
    assert high == pytest.approx(modulus.upper, abs=0.02)


def test_open_where_the_objective_levels_out() -> None:
    """Twenty times the noise: friction may as well be nothing."""
    noisy = found_of(Settings(gain=0.005), noise=0.04)
    (traced,) = traces(noisy, 0)
    assert traced.is_open_below
    assert traced.lower == noisy.problem.lower[0]
    assert traced.deviance[0] < traced.threshold_below


def test_a_straight_family_has_the_normal_quantile() -> None:
    assert tube_quantile(0.0) == pytest.approx(1.959964, abs=1e-6)
    q = tube_quantile(2.0)
    assert 2.0 * ndtr(-q) + np.exp(-0.5 * q * q) / np.pi == pytest.approx(0.05)


def test_the_tube_of_a_cone_in_white_noise() -> None:
    """Curves in every direction between two, at every distance: a quarter of the plane.

    One end is that of a straight family whose other half is missing, so that only half of its
    chance counts.
    """
    noise = np.random.default_rng(5).normal(size=(200_000, 2))
    turn = np.linspace(0.0, 0.5 * np.pi, 91)
    directions = np.stack([np.cos(turn), np.sin(turn)])
    rise = np.maximum((noise @ directions).max(axis=1), 0.0) ** 2
    for q in (1.5, 2.0, 2.5):
        expected = ndtr(-q) + 0.25 * np.exp(-0.5 * q * q)
        assert np.mean(rise > q * q) == pytest.approx(expected, rel=0.04)
    arc = 2.0 * np.stack([np.sin(2.0 * turn), 1.0 - np.cos(2.0 * turn)])  # one distance for each
    bent = (2.0 * noise @ arc - np.sum(arc**2, axis=0)).max(axis=1)
    assert np.mean(bent > 4.0) < np.mean(rise > 4.0)


@pytest.mark.slow
def test_two_valleys_widen_and_a_prior_does_not() -> None:
    curves = measured("A3", (0.12,), seed=1)
    found = calibrate(wire_of("A3"), curves, Settings(gain=0.005))
    assert isinstance(found, Calibration)
    assert found.widening == pytest.approx(1.2, abs=0.03)
    quiet = calibrate(wire_of("A2"), measured(seed=1, noise=1e-4), Settings(gain=0.005))
    assert isinstance(quiet, Calibration)
    assert quiet.widening < 1.05


MEAN = np.eye(4)[[3]]


def samples_of(samples: int, settings: Settings, seed: int = 1) -> CalibrationFit:
    found = find(wire_of("A2"), measured(samples=samples, n=60, seed=seed), settings)
    assert not isinstance(found, CalibrationFailure)
    return found


@pytest.mark.parametrize("samples", [2, 3, 6])
def test_t_with_one_degree_less_than_samples(samples: int) -> None:
    """The mean factor, all parameters known: it rests on the samples' factors alone."""
    names = ("radial_friction", "insulation_modulus", "copper_scale")
    found = samples_of(samples, Settings(dict.fromkeys(names, FIXED), gain=0.9))
    low, high = quantiles(found.mixture, MEAN)
    error = np.sqrt(found.spread.covariance[3, 3])
    # The gain is not quite free, which shows in the far tail of two samples.
    close = 0.15 if samples == 2 else 0.03
    half = 0.5 * (high[0] - low[0])
    assert half / error == pytest.approx(quantile(samples - 1.0), rel=close)


def test_two_distributions() -> None:
    mixture = ScatterMixture(
        np.array([0.5, 0.5]),
        np.array([1.0, 3.0]),
        np.zeros((2, 4)),
        np.zeros((2, 4, 4)),
        1e9,
    )
    low, high = quantiles(mixture, np.zeros((1, 4)), np.ones(1))
    # Half N(0, 1), half N(0, 9): 0.5 (1 - Phi(x)) + 0.5 (1 - Phi(x / 3)) = 0.025 at x = 4.941.
    assert high[0] == pytest.approx(4.935, abs=0.01)
    assert low[0] == pytest.approx(-high[0], rel=1e-6)
    nothing = quantiles(mixture, np.zeros((1, 4)))
    assert nothing[0][0] == pytest.approx(0.0, abs=1e-200)


def test_priors_hold_and_without_scatter_and_gain_there_are_no_factors() -> None:
    centre, precision = np.log(TRUTH * [1.0, 1.0, 1.5]), np.array([0.0, 0.0, 1e8])
    problem = replace(PROBLEM, centre=centre, precision=precision, gain=0.0)
    fit = search(problem, Levels(1.0, 0.0, 0.0), start(1.0, 1.0, 1.0), ALL)
    assert np.exp(fit.point.logs[2]) == pytest.approx(1.5, rel=1e-3)
    assert fit.point.gain == 0.0
    assert not fit.point.offsets.any()
    settled = settle(problem_of(scatter=0.0), np.log(TRUTH), ALL, scatter=0.0)
    assert settled.levels.scatter == 0.0
    assert not settled.fits[0].point.offsets.any()


def test_a_bent_valley_is_crossed_in_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole steps alone take 38 from here; a fit far above another is found roughly."""
    wire = wire_of("A3")
    parts = take_apart(wire.section, wire.contacts)
    problem = replace(PROBLEM, parts=parts, curves=measured("A3", (0.12,), n=90, seed=1))
    begin, held = start(0.75, 0.9, 1.5), np.array([False, True, True])
    quick = search(problem, LEVELS, begin, held)
    monkeypatch.setattr("labpipe.wire.calibration.parameter_search._WHOLE", 0.0)
    slow = search(problem, LEVELS, begin, held)
    assert quick.settled
    assert quick.objective == pytest.approx(slow.objective, abs=0.02)
    assert 2 * quick.steps < slow.steps
    rough = search(problem, LEVELS, begin, held, lowest=quick.objective - 1e3)
    assert rough.steps < slow.steps


def test_a_profile_of_a_linear_model_is_that_of_the_quantiles() -> None:
    linear = found_of(Settings({"radial_friction": FIXED, "copper_scale": FIXED}))
    (traced,) = traces(linear, 1)
    low, high = quantiles(linear.mixture, np.eye(4)[[1]])
    best, half = float(linear.fit.point.logs[1]), 0.5 * float(high[0] - low[0])
    assert traced.lower == pytest.approx(best + low[0], abs=0.03 * half)
    assert traced.upper == pytest.approx(best + high[0], abs=0.03 * half)
    assert (traced.is_open_below, traced.is_open_above) == (False, False)
    at = int(np.argmin(traced.deviance))
    assert traced.deviance[at] == 0.0
    assert np.all(np.diff(traced.deviance[: at + 1]) < 0.0)
    assert np.all(np.diff(traced.deviance[at:]) > 0.0)
    ends = np.interp([traced.lower, traced.upper], traced.logs, np.sqrt(traced.deviance))
    assert ends**2 == pytest.approx([traced.threshold_below, traced.threshold_above], rel=0.04)
    assert reach(linear, 2, 1.727) == (linear.fit.point.logs[2],) * 2  # it is held
    settings = Settings({"radial_friction": FIXED, "copper_scale": FIXED}, scatter=0.0)
    (alone,) = traces(found_of(settings), 1)
    assert alone.lower - 0.1 < np.log(1e9) < alone.upper + 0.1
    assert alone.threshold_above == pytest.approx(1.96**2, rel=0.03)


def test_a_given_scatter_is_one_distribution() -> None:
    given = samples_of(3, Settings(scatter=0.03))
    assert given.mixture.chance.tolist() == [1.0]
    assert given.mixture.scatter == pytest.approx([0.03], rel=1e-3)
    low, high = quantiles(given.mixture, np.eye(4)[:3])
    errors = np.sqrt(np.diag(given.spread.covariance)[:3])
    assert 0.5 * (high - low) == pytest.approx(quantile(given.mixture.freedom) * errors, rel=1e-3)


def test_bounds_hold_and_others_go_on() -> None:
    lower = PROBLEM.lower + np.array([0.0, 5.0 + np.log(1.1), 0.0])
    problem = replace(PROBLEM, lower=lower)
    fit = search(problem, LEVELS, start(1.0, 1.2, 1.0), ALL)
    assert fit.point.logs[1] == lower[1]
    assert fit.settled
    assert normal_matrix(problem, LEVELS, fit, ALL)[1][:3].tolist() == [True, False, True]
