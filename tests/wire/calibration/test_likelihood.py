"""The search, its local minima, profiles of the likelihood, and quantiles of few samples."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.special import ndtr

from labpipe.mechanics.wire.calibration import local_minima
from labpipe.mechanics.wire.calibration.calibrate_wire import _find_interval_at_99, calibrate
from labpipe.mechanics.wire.calibration.identification import compute_t_quantile
from labpipe.mechanics.wire.calibration.law_components import split_law
from labpipe.mechanics.wire.calibration.local_minima import (
    LocalProfile,
    Minima,
    _find_end,
    _ProfilePath,
    _yield_starts,
    compute_differences,
    compute_tube_quantile,
    find_line_range,
    find_minima,
    follow_profiles,
    unite_intervals,
)
from labpipe.mechanics.wire.calibration.objective import (
    Fit,
    Levels,
    Problem,
    Settings,
    compute_model_forces,
    make_normal_equations,
    search,
    set_up_problem,
)
from labpipe.mechanics.wire.calibration.variances import compute_quantiles
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.wire import (
    PARAMETERS,
    CalibratedParameter,
    Calibration,
    CalibrationFailure,
    Identifiability,
    ParameterChoice,
    ScatterMixture,
)
from tests.builders.loading_tests import TRUTH, measured, wire_of

WIRE = wire_of("A2")

CURVES = measured(n=40, seed=3)

LEVELS = Levels(1.0, 0.0, 0.03)

PROBLEM = Problem(
    split_law(WIRE.section, WIRE.contacts),
    CURVES,
    np.arange(3),
    np.zeros(3),
    np.zeros(3),
    np.log(TRUTH) - 5.0,
    np.log(TRUTH) + 5.0,
    0.005,
    np.ones(3, dtype=np.bool_),
)

HELD = replace(PROBLEM, is_free=np.zeros(3, dtype=np.bool_))


def start(*factors: float) -> Floats:
    return np.append(np.log(TRUTH * factors), np.zeros(4))


def test_the_least_has_no_slope() -> None:
    fit = search(PROBLEM, LEVELS, start(2.0, 1.2, 0.8))
    assert fit.has_converged
    for step in np.vstack([1e-2 * np.eye(3, 7), -1e-2 * np.eye(3, 7)]):
        shifted = search(HELD, LEVELS, fit.unknowns + step, guess=fit.model_forces)
        assert shifted.objective > fit.objective - 1e-4
    # Nearly as good a fit elsewhere does not end the search early.
    second_fit = search(PROBLEM, LEVELS, start(1.5, 1.2, 0.8), best_objective=fit.objective - 1e-3)
    assert second_fit.objective == pytest.approx(fit.objective, abs=1e-4)
    # bounds and priors hold, and the others go on; without scatter and gain there are no factors
    lower = PROBLEM.lower + np.array([0.0, 5.0 + np.log(1.1), 0.0])
    bounded = replace(PROBLEM, lower=lower)
    fit = search(bounded, LEVELS, start(1.0, 1.2, 1.0))
    assert (fit.logs[1], fit.has_converged) == (lower[1], True)
    assert make_normal_equations(fit)[2][:3].tolist() == [True, False, True]
    believed = replace(PROBLEM, gain_uncertainty=0.0, prior_precision=np.array([0.0, 0.0, 1e8]))
    believed = replace(believed, prior_centre=np.log(TRUTH * [1.0, 1.0, 1.5]))
    fit = search(believed, Levels(1.0, 0.0, 0.0), start(1.0, 1.0, 1.0))
    assert np.exp(fit.logs[2]) == pytest.approx(1.5, rel=1e-3)
    assert not fit.unknowns[3:].any()


@pytest.mark.parametrize("best_objective", [np.inf, 0.0])
def test_a_search_that_cannot_go_on_has_not_converged(
    best_objective: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The model follows the curves nowhere but at the start."""
    monkeypatch.setattr(
        "labpipe.mechanics.wire.calibration.objective._evaluate_step", lambda *_: None
    )
    fit = search(PROBLEM, LEVELS, start(5.0, 2.0, 2.0), best_objective=best_objective)
    assert not fit.has_converged
    assert fit.unknowns.tolist() == start(5.0, 2.0, 2.0).tolist()


def test_how_far_fits_are_apart_in_standard_deviations() -> None:
    """Of the forces, of priors, of the load cell's gain and of the samples' factors."""
    problem = replace(HELD, prior_precision=np.array([4.0, 0.0, 9.0]))
    first, second = (
        search(problem, LEVELS, start(*factors)) for factors in ((1.0, 1.0, 1.0), (1.2, 0.8, 1.5))
    )

    def weighed(fit: Fit) -> Floats:
        curves = zip(problem.sample_index, fit.model_forces, CURVES, strict=True)
        gain, offsets = fit.unknowns[3], fit.unknowns[4:]
        factors = np.exp(gain + offsets)
        forces = [factors[at] * model.force / curve.noise for at, model, curve in curves]
        rest = [*(fit.logs * [2.0, 0.0, 3.0]), gain / 0.005, *(offsets / 0.03)]
        return np.concatenate([*forces, rest])

    distance = np.sum((weighed(second) - weighed(first)) ** 2)
    products = compute_differences([first, second], first)
    np.testing.assert_allclose(products, [[0.0, 0.0], [0.0, distance]], rtol=1e-9, atol=1e-9)


def test_offsets_are_shrunken_factors_of_the_samples() -> None:
    fit = search(HELD, LEVELS, start(1.0, 1.0, 1.0))
    gain, offsets = fit.unknowns[3], fit.unknowns[4:]
    for curve, model, offset in zip(CURVES, fit.model_forces, offsets, strict=True):
        direct = np.log(float(curve.force @ model.force) / float(model.force @ model.force))
        assert gain + offset == pytest.approx(direct, rel=0.05)
    # The gain and the mean offset share the mean factor as their variances.
    share = gain / 0.005**2, offsets.sum() / 0.03**2
    assert share[0] == pytest.approx(share[1], rel=1e-3)


@lru_cache
def two_valleys(prior: float | None = None) -> Calibration:
    """A campaign in which hard copper with half the insulation fits as well as the truth."""
    choice = ParameterChoice(prior or 1.0, factor=1.5, source="tensile tests of strands")
    choices = {} if prior is None else {"copper_scale": choice}
    curves = measured("A3", (0.12,), seed=1)
    calibration = calibrate(wire_of("A3"), curves, Settings(choices, gain=0.005))
    assert isinstance(calibration, Calibration)
    return calibration


def test_both_solutions_are_kept_and_said() -> None:
    calibration = two_valleys()
    best, rival = calibration.solutions
    assert best.rise == 0.0
    assert 0.0 < rival.rise < rival.limit
    low, high = sorted([best.values, rival.values], key=lambda values: float(values[2]))
    assert low[1:] == pytest.approx(TRUTH[1:], rel=0.3)
    assert high[2] > 5.0
    copper = calibration.get_parameter("copper_scale")
    assert copper.verdict is Identifiability.TWO_SOLUTIONS
    first, second = copper.intervals
    assert first.lower < TRUTH[2] < first.upper < second.lower < high[2] < second.upper
    assert [profile.deviance.min() for profile in copper.profiles] == [0.0, rival.rise]
    (note,) = (note for note in calibration.notes if note.code == "two_solutions")
    assert note.message.startswith("two solutions fit the tests: (1) ")
    assert calibration.widening == pytest.approx(1.2, abs=0.03)


@pytest.mark.parametrize("scale", [pytest.param(1.06, marks=pytest.mark.slow), 6.2])
def test_a_prior_tells_them_apart(scale: float) -> None:
    calibration = two_valleys(round(scale))
    assert len(calibration.solutions) == 1
    copper = calibration.get_parameter("copper_scale")
    assert copper.value == pytest.approx(scale, rel=0.1)
    assert len(copper.intervals) == 1
    assert copper.conflict is not None
    assert copper.conflict.source == "tensile tests of strands"
    assert not copper.conflict.contradicts


def test_a_least_that_is_found_twice_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search from a dip beside the least ends a rounding below it."""

    def lower_by_rounding(*arguments: object) -> list[Fit]:
        fit = arguments[1]
        assert isinstance(fit, Fit)
        return [replace(fit, objective=fit.objective - 1e-6)]

    monkeypatch.setattr(
        "labpipe.mechanics.wire.calibration.local_minima.find_local_minima", lower_by_rounding
    )
    assert len(find_minima(PROBLEM, np.log(TRUTH)).local_minima) == 1


FIXED = ParameterChoice(is_fixed=True)


def test_the_tube_of_a_cone_in_white_noise() -> None:
    """Curves in every direction between two, at every distance: a quarter of the plane.

    One end is that of a straight family whose other half is missing, so that only half of its
    chance counts.
    """
    assert compute_tube_quantile(0.0) == pytest.approx(1.959964, abs=1e-6)
    q = compute_tube_quantile(2.0)
    assert 2.0 * ndtr(-q) + np.exp(-0.5 * q * q) / np.pi == pytest.approx(0.05)
    noise = np.random.default_rng(5).normal(size=(50_000, 2))
    turn = np.linspace(0.0, 0.5 * np.pi, 91)
    rise = np.maximum((noise @ [np.cos(turn), np.sin(turn)]).max(axis=1), 0.0) ** 2
    for q in (1.5, 2.0):
        expected = ndtr(-q) + 0.25 * np.exp(-0.5 * q * q)
        assert np.mean(rise > q * q) == pytest.approx(expected, rel=0.04)
    arc = 2.0 * np.stack([np.sin(2.0 * turn), 1.0 - np.cos(2.0 * turn)])  # one distance for each
    bent = (2.0 * noise @ arc - np.sum(arc**2, axis=0)).max(axis=1)
    assert np.mean(bent > 4.0) < np.mean(rise > 4.0)


@pytest.mark.parametrize("samples", [2, 6])
def test_t_with_one_degree_less_than_samples(samples: int) -> None:
    """The mean factor, all parameters known: it rests on the samples' factors alone."""
    fixed = Settings(dict.fromkeys(PARAMETERS, FIXED), gain=0.9)
    fit = fit_of(fixed, samples=samples, n=60, seed=1)
    low, high = compute_quantiles(fit.lowest.mixture, np.eye(4)[[3]])
    error = np.sqrt(fit.lowest.uncertainty.covariance[3, 3])
    # The gain is not quite free, which shows in the far tail of two samples.
    close = 0.15 if samples == 2 else 0.03
    half = 0.5 * (high[0] - low[0])
    assert half / error == pytest.approx(compute_t_quantile(samples - 1.0), rel=close)


def test_starts_share_the_load_between_insulation_and_copper() -> None:
    """As if forces were proportional to both numbers: 30 and 80 % of the load by the insulation."""
    given, *others = _yield_starts(PROBLEM, np.log(TRUTH))
    assert given.tolist() == np.log(TRUTH).tolist()
    nominal = PROBLEM.law.nominal
    models = compute_model_forces(PROBLEM.law, nominal, CURVES)
    load = sum(np.abs(curve.force).sum() for curve in CURVES)
    by_tube = sum(np.abs(model.sensitivity[1]).sum() for model in models)
    by_rest = sum(np.abs(model.force).sum() for model in models) - by_tube
    for share, logs in zip((0.3, 0.8), others, strict=True):
        factors = np.exp(logs) / nominal
        assert factors * [1.0, by_tube, by_rest] == pytest.approx(
            [1.0, share * load, (1.0 - share) * load]
        )


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_profile_ends_where_its_deviance_jumps(
    sign: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From 0 to 10, at 0.7 from the minimum: no root is near, so that the far side ends it."""
    fit = search(HELD, LEVELS, start(1.0, 1.0, 1.0))
    place = float(fit.logs[1])

    def evaluate(_: _ProfilePath, near: Fit, target: float, root: float) -> tuple[float, Fit]:
        return 10.0 * (abs(target - place) > 0.7), near

    monkeypatch.setattr(_ProfilePath, "evaluate", evaluate)
    side = _find_end(_ProfilePath(fit, 1, np.zeros(1)), sign, 1.96, 0.1)
    assert not side.is_open
    assert sign * (side.end - place) == pytest.approx(0.7, abs=1e-3)


@pytest.mark.parametrize(("height", "is_open"), [(0.98, True), (1.0, False), (1.005, False)])
def test_a_profile_may_end_at_a_bound(
    height: float, monkeypatch: pytest.MonkeyPatch, *, is_open: bool
) -> None:
    fit = search(HELD, LEVELS, start(1.0, 1.0, 1.0))
    monkeypatch.setattr(_ProfilePath, "evaluate", lambda *_: (1.96 * height, fit))
    side = _find_end(_ProfilePath(fit, 1, np.zeros(1)), 1.0, 1.96, 100.0)
    assert (side.end, side.is_open) == (PROBLEM.upper[1], is_open)


def test_intervals_that_touch_or_overlap_are_one() -> None:
    none = np.zeros(0)
    ends = [(4.0, 5.0), (0.0, 2.0), (2.0, 3.0), (0.5, 1.0)]
    parts = (LocalProfile(none, none, *pair, False, False, 3.84, 3.84) for pair in ends)
    assert unite_intervals(tuple(parts)) == ((0.0, 3.0), (4.0, 5.0))


def test_two_distributions() -> None:
    """Half N(0, 1), half N(0, 9): 0.5 (1 - Phi(x)) + 0.5 (1 - Phi(x / 3)) = 0.025 at x = 4.941."""
    none, half = np.zeros((2, 4)), np.array([0.5, 0.5])
    mixture = ScatterMixture(half, np.array([1.0, 3.0]), none, np.zeros((2, 4, 4)), 1e9)
    low, high = compute_quantiles(mixture, np.zeros((1, 4)), np.ones(1))
    assert high[0] == pytest.approx(4.935, abs=0.01)
    assert low[0] == pytest.approx(-high[0], rel=1e-6)
    assert compute_quantiles(mixture, np.zeros((1, 4)))[0][0] == pytest.approx(0.0, abs=1e-200)


def test_a_profile_of_a_linear_model_is_that_of_the_quantiles() -> None:
    choices = {"radial_friction": FIXED, "copper_scale": FIXED}
    linear = fit_of(Settings(choices))
    (traced,) = follow_profiles(linear, 1)
    low, high = compute_quantiles(linear.lowest.mixture, np.eye(4)[[1]])
    best, half = float(linear.fit.logs[1]), 0.5 * float(high[0] - low[0])
    assert traced.lower == pytest.approx(best + low[0], abs=0.03 * half)
    assert traced.upper == pytest.approx(best + high[0], abs=0.03 * half)
    assert (traced.is_open_below, traced.is_open_above) == (False, False)
    lowest_row = int(np.argmin(traced.deviance))
    assert traced.deviance[lowest_row] == 0.0
    assert np.all(
        np.diff(traced.deviance) * np.sign(np.arange(len(traced.logs) - 1) - lowest_row + 0.5) > 0
    )
    ends = np.interp([traced.lower, traced.upper], traced.logs, np.sqrt(traced.deviance))
    assert ends**2 == pytest.approx([traced.threshold_below, traced.threshold_above], rel=0.04)
    assert find_line_range(linear, 2, 1.727) == (linear.fit.logs[2],) * 2  # it is held
    (profile,) = follow_profiles(fit_of(Settings(choices, scatter=0.0)), 1)
    assert profile.lower - 0.1 < np.log(1e9) < profile.upper + 0.1
    assert profile.threshold_above == pytest.approx(1.96**2, rel=0.03)


def test_a_given_scatter_is_one_distribution() -> None:
    minimum = fit_of(Settings(scatter=0.03), samples=3, n=60, seed=1).lowest
    assert minimum.mixture.chance.tolist() == [1.0]
    assert minimum.mixture.scatter == pytest.approx([0.03], rel=1e-3)
    low, high = compute_quantiles(minimum.mixture, np.eye(4)[:3])
    errors = np.sqrt(np.diag(minimum.uncertainty.covariance)[:3])
    assert 0.5 * (high - low) == pytest.approx(
        compute_t_quantile(minimum.mixture.freedom) * errors, rel=1e-3
    )


def test_along_the_line_of_the_leasts_parameters_reach_as_far_as_their_profiles() -> None:
    """The line is that profile, in strides; the insulation gives as the copper is held."""
    fit = fit_of(Settings(gain=0.005))
    (traced,), (modulus,) = follow_profiles(fit, 2), follow_profiles(fit, 1)
    assert find_line_range(fit, 2, 1.0) == pytest.approx((traced.lower, traced.upper), abs=0.01)
    assert find_line_range(fit, 1, 1.0) == pytest.approx((modulus.lower, modulus.upper), abs=0.02)
    (higher,) = follow_profiles(fit, 2, factor=1.727)
    assert find_line_range(fit, 2, 1.727) == pytest.approx((higher.lower, higher.upper), abs=0.01)
    assert higher.threshold_above == pytest.approx(1.727 * traced.threshold_above)
    assert higher.lower < traced.lower < traced.upper < higher.upper


def test_a_short_interval_of_a_long_line_is_followed_to_99_per_cent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Both ends are those of 99 %, although the line of minima determines only one of them."""
    minima = fit_of(Settings({"radial_friction": FIXED, "copper_scale": FIXED}))
    (profile,), (at_99,) = (follow_profiles(minima, 1, factor=f) for f in (1.0, 1.727))
    interval = Interval(*np.exp([profile.lower, profile.upper]))
    modulus = CalibratedParameter("insulation_modulus", "Pa", 1e9, (interval,))
    assert _find_interval_at_99(minima, 1, modulus) == (interval.lower, interval.upper)
    far = float(profile.lower + np.log(2.5))
    monkeypatch.setattr(local_minima, "find_line_range", lambda *_: (profile.lower, far))
    lower, upper = _find_interval_at_99(minima, 1, modulus)
    assert lower == pytest.approx(np.exp(at_99.lower))
    assert upper == pytest.approx(np.exp(far))


def fit_of(settings: Settings, **more: float) -> Minima:
    numbers = {"seed": 4, "n": 90, **more}
    curves = measured(**numbers)  # type: ignore[arg-type]
    setup = set_up_problem(wire_of("A2").law, curves, settings)
    assert not isinstance(setup, CalibrationFailure)
    return find_minima(*setup)


@pytest.mark.slow
def test_little_noise_widens_little() -> None:
    quiet = calibrate(wire_of("A2"), measured(seed=1, noise=1e-4), Settings(gain=0.005))
    assert isinstance(quiet, Calibration)
    assert quiet.widening < 1.05
