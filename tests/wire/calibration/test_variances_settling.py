from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.wire_calibration import CalibrationFailure
from labpipe.wire.calibration.fit import pose
from labpipe.wire.calibration.parameter_search import Problem
from labpipe.wire.calibration.variances import settle
from labpipe.wire.calibration.wire_parts import take_apart
from tests.builders.loading_tests import TRUTH, measured, wire_of

ALL = np.ones(3, dtype=np.bool_)


def problem_of(n: int = 60, **more: float) -> Problem:
    wire = wire_of("A2")
    curves = measured(seed=2, n=n, noise=0.0005, **more)  # type: ignore[arg-type]
    posed = pose(take_apart(wire.section, wire.contacts), curves, {}, 0.005)
    assert not isinstance(posed, CalibrationFailure)
    return posed[0]


def test_the_same_answer_from_any_start() -> None:
    """Twenty starts, two decades wide in each parameter."""
    problem = problem_of()
    generator = np.random.default_rng(7)
    starts = [generator.uniform(-np.log(10.0), np.log(10.0), 3) for _ in range(20)]
    found = [settle(problem, np.log(TRUTH) + start, ALL, scatter=None) for start in starts]
    logs = np.array([fit.point.logs for fit, _ in found])
    # Far below the standard errors, which are about 0.2, 0.02 and 0.05.
    assert np.ptp(logs, axis=0) == pytest.approx(np.zeros(3), abs=5e-3)
    assert np.ptp([fit.objective for fit, _ in found]) < 1e-2
    assert all(fit.settled for fit, _ in found)


def test_levels_are_found() -> None:
    problem = problem_of(n=1200, correlation=0.6)
    fit, levels = settle(problem, np.log(TRUTH), ALL, scatter=None)
    # Standard errors: sqrt((1 - 0.6^2) / 3600) = 0.013 and sqrt(2 / 3600) = 0.024.
    assert levels.correlation == pytest.approx(0.6, abs=0.05)
    assert levels.noise == pytest.approx(1.0, abs=0.1)
    assert 0.01 < levels.scatter < 0.08
    assert fit.settled


def test_a_given_scatter_of_zero_leaves_no_offsets() -> None:
    fit, levels = settle(problem_of(scatter=0.0), np.log(TRUTH), ALL, scatter=0.0)
    assert levels.scatter == 0.0
    assert not fit.point.offsets.any()


def test_levels_that_do_not_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    from labpipe.wire.calibration import variances as settling

    monkeypatch.setattr(settling, "_ROUNDS", 1)
    fit, levels = settle(problem_of(), np.log(TRUTH), ALL, scatter=None)
    assert fit.settled
    assert levels.scatter > 0.0
