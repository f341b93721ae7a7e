"""Beliefs: what calibrations and stated deviations say of the inputs of a line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import stdtrit

from labpipe.records.wire_calibration import Calibration
from labpipe.rod.beliefs import Belief, calibrated_beliefs, joined, known
from labpipe.wire.calibration.calibrate_wire import Settings, calibrate
from labpipe.wire.calibration.scatter_mixture import quantiles
from labpipe.wire.law_family import LAW_FACTOR
from tests.builders.loading_tests import measured, wire_of

MANY = 32_768


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    found = calibrate(wire_of("A3"), measured("A3", (0.12,), seed=1), Settings(gain=0.005))
    assert isinstance(found, Calibration)
    return found


def drawn(belief: Belief, direction: dict[str, float]) -> np.ndarray:
    weights = np.array([direction.get(name, 0.0) for name in belief.names])
    return np.asarray(belief.amounts @ belief.steps.T @ weights)


def test_there_is_one_for_each_solution_of_the_set(calibration: Calibration) -> None:
    beliefs = calibrated_beliefs(calibration.solutions, calibration.widening, specimen=LAW_FACTOR)
    assert len(beliefs) == 2
    for belief, solution in zip(beliefs, calibration.solutions, strict=True):
        assert belief.inputs()["copper_scale"] == pytest.approx(np.log(solution.values[2]))
        assert belief.inputs()[LAW_FACTOR] == 0.0
    far = replace(calibration.solutions[1], rise=2.0 * calibration.solutions[1].limit)
    assert len(calibrated_beliefs([calibration.solutions[0], far])) == 1


@pytest.mark.parametrize("one_more", [0.0, 1.0])
def test_draws_have_the_quantiles_of_the_mixture(calibration: Calibration, one_more: float) -> None:
    solution = calibration.solutions[0]
    belief = calibrated_beliefs([replace(solution, rise=0.0)], specimen=LAW_FACTOR, draws=MANY)[0]
    for weights in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.2, 0.5, 0.3)):
        direction = dict(zip(belief.names, weights, strict=False)) | {LAW_FACTOR: one_more}
        found = np.quantile(drawn(belief, direction), [0.025, 0.975])
        whole = np.array([[*weights, 0.0]])
        want = np.ravel(quantiles(solution.mixture, whole, np.array([one_more])))
        assert found == pytest.approx(want, rel=0.02)


def test_as_many_draws_as_usual_say_where_a_band_ends(calibration: Calibration) -> None:
    """By chance alone widths would differ by 2 % here and there."""
    widths = []
    for seed in range(16):
        belief = calibrated_beliefs(calibration.solutions, specimen=LAW_FACTOR, seed=seed)[0]
        moved = drawn(belief, {"copper_scale": 0.3, LAW_FACTOR: 1.0})
        widths.append(np.ptp(np.quantile(moved, [0.025, 0.975])))
    assert np.std(widths) < 0.012 * np.mean(widths)


def test_a_less_likely_solution_is_narrower(calibration: Calibration) -> None:
    solution = calibration.solutions[0]
    half = replace(solution, rise=0.75 * solution.limit)
    one, other = calibrated_beliefs([replace(solution, rise=0.0), half])
    ratio = np.std(other.amounts @ other.steps.T, axis=0) / np.std(
        one.amounts @ one.steps.T, axis=0
    )
    assert ratio == pytest.approx([0.5, 0.5, 0.5], rel=0.2)
    assert LAW_FACTOR not in one.names


def test_what_is_fixed_does_not_move(calibration: Calibration) -> None:
    solution = calibration.solutions[0]
    mixture = solution.mixture
    shift, covariance = mixture.shift.copy(), mixture.covariance.copy()
    shift[:, 0], covariance[:, 0, :], covariance[:, :, 0] = 0.0, 0.0, 0.0
    fixed = replace(solution, mixture=replace(mixture, shift=shift, covariance=covariance))
    belief = calibrated_beliefs([fixed])[0]
    assert len(belief.causes) == 2
    assert np.ptp(drawn(belief, {"radial_friction": 1.0})) < 1e-9


def test_a_stated_deviation_is_drawn_from_students_t() -> None:
    for freedom, quantile in ((np.inf, 1.96), (4.0, float(stdtrit(4.0, 0.975)))):
        belief = known("mass_factor", 0.02, freedom=freedom, draws=MANY)
        assert belief.inputs(np.ones(1)) == {"mass_factor": 0.02}
        assert np.quantile(drawn(belief, {"mass_factor": 1.0}), 0.975) == pytest.approx(
            0.02 * quantile, rel=1e-3
        )


def test_an_impossible_deviation_is_refused() -> None:
    with pytest.raises(ValueError, match=r"length_factor: deviation=0\.0"):
        known("length_factor", 0.0)


def test_causes_of_one_input_add() -> None:
    both = joined(
        [known("law_factor", 0.03, cause="specimen"), known("law_factor", 0.04, cause="spool")]
    )
    assert both.names == ("law_factor",)
    assert both.causes == ("specimen", "spool")
    assert np.std(drawn(both, {"law_factor": 1.0})) == pytest.approx(0.05, rel=0.05)
    specimen, spool = both.amounts.T
    assert abs(float(np.mean(specimen * spool))) < 0.05
