from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from labpipe.records.wire_calibration import (
    Calibration,
    CalibrationFailure,
    Identified,
    ParameterChoice,
)
from labpipe.wire.calibration.calibrate_wire import Settings, calibrate
from labpipe.wire.calibration.fit import pose
from labpipe.wire.calibration.parameter_search import Fit, Problem
from labpipe.wire.calibration.valleys import settle
from labpipe.wire.calibration.wire_parts import take_apart
from tests.builders.loading_tests import TRUTH, measured, wire_of

ALL = np.ones(3, dtype=np.bool_)


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


def test_a_given_scatter_of_zero_leaves_no_offsets() -> None:
    settled = settle(problem_of(scatter=0.0), np.log(TRUTH), ALL, scatter=0.0)
    fit, levels = settled.fits[0], settled.levels
    assert levels.scatter == 0.0
    assert not fit.point.offsets.any()


def test_levels_that_do_not_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    from labpipe.wire.calibration import valleys as settling

    monkeypatch.setattr(settling, "_ROUNDS", 1)
    settled = settle(problem_of(), np.log(TRUTH), ALL, scatter=None)
    fit, levels = settled.fits[0], settled.levels
    assert fit.settled
    assert levels.scatter > 0.0


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
    assert copper.verdict is Identified.TWO
    first, second = copper.intervals
    assert first.lower < TRUTH[2] < first.upper < second.lower < high.values[2] < second.upper
    assert [profile.deviance.min() for profile in copper.profiles] == [0.0, other.rise]
    (said,) = [note.message for note in found.notes if note.code == "two_solutions"]
    for solution in found.solutions:
        assert f"the strength of the copper {solution.values[2]:.4g}" in said


def test_nothing_lies_between_the_solutions_that_fits() -> None:
    """A plain scan: copper held, all else fitted from many starts."""
    found = two_valleys()
    low, high = (part for part in found.parameter("copper_scale").intervals)
    middle = float(np.sqrt(low.upper * high.lower))
    held = Settings({"copper_scale": ParameterChoice(middle, is_fixed=True)}, gain=0.005)
    between = calibrate(wire_of("A3"), measured("A3", (0.12,), seed=1), held)
    assert isinstance(between, Calibration)
    assert between.rmse > found.rmse


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
    assert "within a factor of 1.5 (tensile tests of strands), agrees" in copper.conflict.message


@pytest.mark.slow
def test_a_start_in_the_other_valley_finds_both() -> None:
    start = {"copper_scale": ParameterChoice(7.0), "insulation_modulus": ParameterChoice(5e8)}
    found = calibrate(wire_of("A3"), measured("A3", (0.12,), seed=1), Settings(start, gain=0.005))
    assert isinstance(found, Calibration)
    for one, usual in zip(found.solutions, two_valleys().solutions, strict=True):
        assert one.values == pytest.approx(usual.values, rel=2e-3)
        assert one.rise == pytest.approx(usual.rise, abs=0.02)


def test_a_least_that_is_found_twice_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search from a dip beside the least ends a rounding below it."""

    def lower_by_rounding(*given: object) -> list[Fit]:
        fit = given[3]
        assert isinstance(fit, Fit)
        return [replace(fit, objective=fit.objective - 1e-6)]

    monkeypatch.setattr("labpipe.wire.calibration.valleys.leasts", lower_by_rounding)
    fits = settle(problem_of(), np.log(TRUTH), ALL, scatter=None).fits
    assert len(fits) == 1
