"""Levels against the closed form of the balanced one-way layout."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.mechanics.wire.calibration.law_components import split_wire
from labpipe.mechanics.wire.calibration.measured_curves import MeasuredCurve
from labpipe.mechanics.wire.calibration.objective import (
    Fit,
    ModelForce,
    Point,
    Problem,
)
from labpipe.mechanics.wire.calibration.variances import (
    compute_quantile,
    estimate_correlation,
    estimate_levels,
    estimate_uncertainty,
)
from labpipe.records.arrays import Floats
from tests.builders.loading_tests import TRUTH, memory_noise, wire_of

WIRE = wire_of("A2")

PARTS = split_wire(WIRE.section, WIRE.contacts)

NONE = np.zeros(3, dtype=np.bool_)

SAMPLES, POINTS = 5, 30


def layout(seed: int, gain: float = 0.0) -> tuple[Problem, Fit, Floats]:
    """Samples with one factor each on a model that is 1 everywhere; noise of variance 1."""
    generator = np.random.default_rng(seed)
    values = 3.0 * generator.normal(size=(SAMPLES, 1)) + generator.normal(size=(SAMPLES, POINTS))
    curve = MeasuredCurve("A2", "t", "s", 1.0, np.zeros(POINTS), np.zeros(POINTS), 1.0)
    zero = np.zeros(3)
    problem = Problem(PARTS, (curve,) * SAMPLES, np.arange(SAMPLES), zero, zero, zero, zero, gain)
    grams = np.zeros((SAMPLES, 5, 5))
    grams[:, 3, 3], grams[:, 4, 4] = POINTS, (values**2).sum(axis=1)
    grams[:, 3, 4] = grams[:, 4, 3] = values.sum(axis=1)
    point = Point(np.log(TRUTH), 0.0, np.zeros(SAMPLES))
    return problem, Fit(point, 0.0, grams, [], 0, settled=True), values


def test_levels_are_those_of_the_analysis_of_variance() -> None:
    problem, fit, values = layout(1)
    found = estimate_levels(problem, fit, NONE, 0.0, None)
    within = float(values.var(axis=1, ddof=1).mean())
    between = float(values.mean(axis=1).var(ddof=1))
    assert found.noise == pytest.approx(within, rel=1e-3)
    assert found.scatter**2 == pytest.approx(between - within / POINTS, rel=2e-3)
    given = estimate_levels(problem, fit, NONE, 0.0, 3.0)
    assert given.scatter == 3.0
    assert given.noise == pytest.approx(within, rel=0.1)
    assert [compute_quantile(freedom) for freedom in (2.0, np.inf, 0.1)] == pytest.approx(
        [4.303, 1.960, 12.706], abs=1e-3
    )


def test_freedom_is_that_of_the_samples() -> None:
    """Variances are known as by the mean squares within and between of a balanced layout.

    They are independent, with k (n - 1) and k - 1 degrees of freedom (Searle, Casella and
    McCulloch, Variance Components, 1992, sec. 3.5).
    """
    problem, fit, values = layout(2, gain=1e3)
    levels = estimate_levels(problem, fit, NONE, 0.0, None)
    known = estimate_uncertainty(problem, fit, NONE, levels, is_scatter_known=False)
    mean = np.array([0.0, 0.0, 0.0, 1.0])
    spread = float(values.mean(axis=1).var(ddof=1))
    assert mean @ known.covariance @ mean == pytest.approx(spread / SAMPLES, rel=2e-3)
    assert known.freedom(mean) == pytest.approx(SAMPLES - 1, rel=0.02)
    assert known.freedom(np.array([1.0, 0.0, 0.0, 0.0])) == np.inf
    noise, samples = levels.noise, levels.scatter**2
    within, between = 2.0 / (SAMPLES * (POINTS - 1)), 2.0 / (SAMPLES - 1)
    both = noise**2 * within + (noise + POINTS * samples) ** 2 * between
    wanted = [
        [within, -noise * within / (POINTS * samples)],
        [-noise * within / (POINTS * samples), both / (POINTS * samples) ** 2],
    ]
    assert known.level_covariance == pytest.approx(np.array(wanted), rel=5e-3)
    given = estimate_uncertainty(problem, fit, NONE, levels, is_scatter_known=True)
    assert given.freedom(mean) > 1e3
    # The variance of the noise is known as from all points, less one for the gain (chi-square).
    from_all = 2.0 / (SAMPLES * POINTS - 1)
    assert given.level_covariance == pytest.approx(np.diag([from_all, 0.0]))


def test_offsets_that_the_fit_took_out_are_put_back() -> None:
    problem, fit, values = layout(4)
    plain = estimate_levels(problem, fit, NONE, 0.0, None)
    means = values.mean(axis=1)
    left = values - means[:, None]
    grams = fit.grams.copy()
    grams[:, 3, 4] = grams[:, 4, 3] = left.sum(axis=1)
    grams[:, 4, 4] = (left**2).sum(axis=1)
    shifted = Fit(Point(np.log(TRUTH), 0.0, means), 0.0, grams, [], 0, settled=True)
    found = estimate_levels(problem, shifted, NONE, 0.0, None)
    assert found.scatter == pytest.approx(plain.scatter, rel=1e-6)


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_correlation_of_neighbours(correlation: float) -> None:
    noise = memory_noise(np.random.default_rng(0), 20_000, correlation)
    curve = MeasuredCurve("A2", "t", "s", 1.0, np.zeros(20_000), 1.2 + 0.1 * noise, 0.1)
    model = ModelForce(np.ones(20_000), np.zeros((3, 20_000)), np.zeros(20_000))
    found = estimate_correlation((curve,), [model], np.array([1.2]))
    assert found == pytest.approx(correlation, abs=0.02)
    shared = estimate_correlation((curve,), [model], np.array([1.1]))  # points share an error
    known = estimate_correlation((replace(curve, zero_error=0.1),), [model], np.array([1.1]))
    assert shared == pytest.approx(0.5 + 0.5 * correlation, abs=0.02)
    if correlation == 0.0:
        assert known == pytest.approx(0.0, abs=0.02)
    exact = replace(model, force=curve.force)
    assert estimate_correlation((curve,), [exact], np.ones(1)) == 0.0


def test_one_sample_has_no_scatter() -> None:
    problem, fit, _ = layout(5)
    alone = replace(problem, curves=problem.curves[:1], sample=np.zeros(1, np.int64))
    one = replace(fit, point=replace(fit.point, offsets=np.zeros(1)), grams=fit.grams[:1])
    levels = estimate_levels(alone, one, NONE, 0.0, None)
    assert levels.scatter == 0.0
    known = estimate_uncertainty(alone, one, NONE, levels, is_scatter_known=False)
    assert known.level_covariance[1, 1] == 0.0
