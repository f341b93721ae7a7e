from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Flags
from labpipe.wire.calibration.parameter_search import Levels, Point, Problem, normal_matrix, search
from labpipe.wire.calibration.wire_parts import take_apart
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


def only(number: int) -> Flags:
    return np.asarray(np.arange(3) == number)


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


def test_without_scatter_and_gain_there_are_no_factors() -> None:
    problem = replace(PROBLEM, gain=0.0)
    fit = search(problem, Levels(1.0, 0.0, 0.0), start(1.0, 1.0, 1.0), only(1))
    assert fit.point.gain == 0.0
    assert not fit.point.offsets.any()


def test_a_prior_pulls() -> None:
    centre, precision = np.log(TRUTH * [1.0, 1.0, 1.5]), np.array([0.0, 0.0, 1e8])
    problem = replace(PROBLEM, centre=centre, precision=precision)
    fit = search(problem, LEVELS, start(1.0, 1.0, 1.0), ALL)
    assert np.exp(fit.point.logs[2]) == pytest.approx(1.5, rel=1e-3)


def test_bounds_hold_and_others_go_on() -> None:
    lower = PROBLEM.lower.copy()
    lower[1] = np.log(1.1e9)
    problem = replace(PROBLEM, lower=lower)
    fit = search(problem, LEVELS, start(1.0, 1.2, 1.0), ALL)
    assert fit.point.logs[1] == lower[1]
    assert fit.settled
    _, moves = normal_matrix(problem, LEVELS, fit, ALL)
    assert moves[:3].tolist() == [True, False, True]


def test_a_start_beyond_the_model_is_refused() -> None:
    deep = replace(CURVES[0], length=0.06, rig=None)
    problem = replace(PROBLEM, curves=(deep,), sample=np.zeros(1, np.int64))
    with pytest.raises(ValueError, match="the curve ends at"):
        search(problem, LEVELS, Point(np.log(TRUTH), 0.0, np.zeros(1)), ALL)


def test_a_fit_far_above_another_is_found_roughly() -> None:
    held = np.array([True, True, False])
    far = start(0.5, 0.3, 6.0)
    best = search(PROBLEM, LEVELS, start(1.0, 1.0, 1.0), ALL).objective
    fine = search(PROBLEM, LEVELS, far, held)
    rough = search(PROBLEM, LEVELS, far, held, lowest=best)
    assert rough.steps < fine.steps
    rise = fine.objective - best
    assert rise > 10.0
    assert rough.objective - fine.objective < 5e-3 * rise


def test_a_bent_valley_is_not_crossed_to_and_fro(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole steps alone take 38 from here, and end a little higher."""
    curves = measured("A3", (0.12,), n=90, seed=1)
    wire = wire_of("A3")
    parts = take_apart(wire.section, wire.contacts)
    problem = replace(PROBLEM, parts=parts, curves=curves)
    begin, held = start(0.75, 0.9, 1.5), np.array([False, True, True])
    quick = search(problem, LEVELS, begin, held)
    monkeypatch.setattr("labpipe.wire.calibration.parameter_search._WHOLE", 0.0)
    slow = search(problem, LEVELS, begin, held)
    assert quick.settled
    assert quick.objective == pytest.approx(slow.objective, abs=0.02)
    assert 2 * quick.steps < slow.steps
