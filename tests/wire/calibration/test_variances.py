"""Levels against the closed form of the balanced one-way layout."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.mechanics.wire.calibration.identification import compute_t_quantile
from labpipe.mechanics.wire.calibration.law_components import split_law
from labpipe.mechanics.wire.calibration.measured_curves import MeasuredCurve
from labpipe.mechanics.wire.calibration.objective import (
    Fit,
    Levels,
    ModelForce,
    Problem,
)
from labpipe.mechanics.wire.calibration.variances import (
    estimate_correlation,
    estimate_levels,
    estimate_uncertainty,
)
from labpipe.records.arrays import Floats
from tests.builders.loading_tests import TRUTH, memory_noise, wire_of

WIRE = wire_of("A2")

PARTS = split_law(WIRE.section, WIRE.contacts)

NONE = np.zeros(3, dtype=np.bool_)

SAMPLES, POINTS = 5, 30


UNKNOWN = Levels(1.0, 0.0, 1.0)


def layout(seed: int, gain: float = 0.0) -> tuple[Fit, Floats]:
    """Samples with one factor each on a model that is 1 everywhere; noise of variance 1."""
    generator = np.random.default_rng(seed)
    values = 3.0 * generator.normal(size=(SAMPLES, 1)) + generator.normal(size=(SAMPLES, POINTS))
    curve = MeasuredCurve("A2", "t", "s", 1.0, np.zeros(POINTS), np.zeros(POINTS), 1.0)
    zero = np.zeros(3)
    curves, sample = (curve,) * SAMPLES, np.arange(SAMPLES)
    problem = Problem(PARTS, curves, sample, zero, zero, zero, zero, gain, NONE)
    grams = np.zeros((SAMPLES, 5, 5))
    grams[:, 3, 3], grams[:, 4, 4] = POINTS, (values**2).sum(axis=1)
    grams[:, 3, 4] = grams[:, 4, 3] = values.sum(axis=1)
    unknowns = np.append(np.log(TRUTH), np.zeros(1 + SAMPLES))
    return Fit(problem, UNKNOWN, unknowns, 0.0, grams, []), values


def given(fit: Fit, scatter: float) -> Fit:
    return replace(fit, problem=replace(fit.problem, scatter=scatter))


def test_levels_are_those_of_the_analysis_of_variance() -> None:
    fit, values = layout(1)
    levels = estimate_levels(fit, 0.0)
    within = float(values.var(axis=1, ddof=1).mean())
    between = float(values.mean(axis=1).var(ddof=1))
    assert levels.noise == pytest.approx(within, rel=1e-3)
    assert levels.scatter**2 == pytest.approx(between - within / POINTS, rel=2e-3)
    stated = estimate_levels(given(fit, 3.0), 0.0)
    assert stated.scatter == 3.0
    assert stated.noise == pytest.approx(within, rel=0.1)
    assert [compute_t_quantile(freedom) for freedom in (2.0, np.inf, 0.1)] == pytest.approx(
        [4.303, 1.960, 12.706], abs=1e-3
    )


def test_freedom_is_that_of_the_samples() -> None:
    """Variances are known as by the mean squares within and between of a balanced layout.

    They are independent, with k (n - 1) and k - 1 degrees of freedom (Searle, Casella and
    McCulloch, Variance Components, 1992, sec. 3.5).
    """
    fit, values = layout(2, gain=1e3)
    levels = estimate_levels(fit, 0.0)
    fit = replace(fit, levels=levels)
    uncertainty = estimate_uncertainty(fit)
    mean = np.array([0.0, 0.0, 0.0, 1.0])
    spread = float(values.mean(axis=1).var(ddof=1))
    assert mean @ uncertainty.covariance @ mean == pytest.approx(spread / SAMPLES, rel=2e-3)
    assert uncertainty.compute_freedom(mean) == pytest.approx(SAMPLES - 1, rel=0.02)
    assert uncertainty.compute_freedom(np.array([1.0, 0.0, 0.0, 0.0])) == np.inf
    noise, samples = levels.noise, levels.scatter**2
    within, between = 2.0 / (SAMPLES * (POINTS - 1)), 2.0 / (SAMPLES - 1)
    total = noise**2 * within + (noise + POINTS * samples) ** 2 * between
    expected = [
        [within, -noise * within / (POINTS * samples)],
        [-noise * within / (POINTS * samples), total / (POINTS * samples) ** 2],
    ]
    assert uncertainty.level_covariance == pytest.approx(np.array(expected), rel=5e-3)
    stated = estimate_uncertainty(given(fit, levels.scatter))
    assert stated.compute_freedom(mean) > 1e3
    # The variance of the noise is known as from all points, less one for the gain (chi-square).
    from_all = 2.0 / (SAMPLES * POINTS - 1)
    assert stated.level_covariance == pytest.approx(np.diag([from_all, 0.0]))


def test_offsets_that_the_fit_took_out_are_put_back() -> None:
    fit, values = layout(4)
    levels = estimate_levels(fit, 0.0)
    means = values.mean(axis=1)
    deviations = values - means[:, None]
    grams = fit.grams.copy()
    grams[:, 3, 4] = grams[:, 4, 3] = deviations.sum(axis=1)
    grams[:, 4, 4] = (deviations**2).sum(axis=1)
    shifted = replace(fit, unknowns=np.append(fit.unknowns[:4], means), grams=grams)
    shifted_levels = estimate_levels(shifted, 0.0)
    assert shifted_levels.scatter == pytest.approx(levels.scatter, rel=1e-6)


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_correlation_of_neighbours(correlation: float) -> None:
    noise = memory_noise(np.random.default_rng(0), 20_000, correlation)
    curve = MeasuredCurve("A2", "t", "s", 1.0, np.zeros(20_000), 1.2 + 0.1 * noise, 0.1)
    model = ModelForce(np.ones(20_000), np.zeros((3, 20_000)), np.zeros(20_000))

    def estimate(curve: MeasuredCurve, model: ModelForce, factor: float) -> float:
        fit, _ = layout(1)
        problem = replace(fit.problem, curves=(curve,), sample_index=np.zeros(1, np.int64))
        unknowns = np.append(fit.unknowns[:4], np.log(factor))
        fit = replace(fit, problem=problem, unknowns=unknowns, model_forces=[model])
        return estimate_correlation(fit)

    assert estimate(curve, model, 1.2) == pytest.approx(correlation, abs=0.02)
    level = replace(curve, force=np.full(20_000, 1.2))
    assert estimate(level, model, 1.1) == 0.98  # the largest that is assumed
    shared = estimate(curve, model, 1.1)  # points share an error
    removed = estimate(replace(curve, zero_error=0.1), model, 1.1)
    assert shared == pytest.approx(0.5 + 0.5 * correlation, abs=0.02)
    if correlation == 0.0:
        assert removed == pytest.approx(0.0, abs=0.02)
    exact = replace(model, force=curve.force)
    assert estimate(curve, exact, 1.0) == 0.0


def test_one_sample_has_no_scatter() -> None:
    fit, _ = layout(5)
    curves, index = fit.problem.curves[:1], np.zeros(1, np.int64)
    problem = replace(fit.problem, curves=curves, sample_index=index)
    one_sample = replace(fit, problem=problem, unknowns=fit.unknowns[:5], grams=fit.grams[:1])
    levels = estimate_levels(one_sample, 0.0)
    assert levels.scatter == 0.0
    uncertainty = estimate_uncertainty(replace(one_sample, levels=levels))
    assert uncertainty.level_covariance[1, 1] == 0.0
