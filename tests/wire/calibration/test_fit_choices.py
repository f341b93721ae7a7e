from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from labpipe.records.arrays import Flags, Floats
from labpipe.records.wire_calibration import (
    COPPER_SCALE,
    INSULATION_MODULUS,
    RADIAL_FRICTION,
    CalibrationFailure,
    ParameterChoice,
)
from labpipe.wire.calibration.fit import BOUNDS, log_error_of, pose
from labpipe.wire.calibration.parameter_search import Problem
from labpipe.wire.calibration.wire_parts import take_apart
from labpipe.wire.cross_section import Layer, concentric
from labpipe.wire.friction import Contacts, insulated
from tests.builders.loading_tests import TRUTH, measured, section_of, wire_of

Choices = Mapping[str, ParameterChoice]
WIRE = wire_of("A2")
PARTS = take_apart(WIRE.section, WIRE.contacts)
CURVES = measured(n=20)


def posed(choices: Choices) -> tuple[Problem, Floats, Flags]:
    found = pose(PARTS, CURVES, choices, 0.01)
    assert not isinstance(found, CalibrationFailure)
    return found


def refused(choices: Choices) -> CalibrationFailure:
    found = pose(PARTS, CURVES, choices, 0.01)
    assert isinstance(found, CalibrationFailure)
    return found


def test_all_are_free_and_start_from_the_wire() -> None:
    problem, logs, free = posed({})
    assert free.all()
    assert np.exp(logs) == pytest.approx(TRUTH)
    assert not problem.precision.any()
    assert np.exp(problem.upper[0]) == pytest.approx(BOUNDS[RADIAL_FRICTION][1])
    assert problem.sample.tolist() == [0, 1, 2]


def test_fixed_and_priors() -> None:
    problem, logs, free = posed(
        {
            RADIAL_FRICTION: ParameterChoice(0.08, is_fixed=True),
            COPPER_SCALE: ParameterChoice(1.2, factor=1.5),
        }
    )
    assert free.tolist() == [False, True, True]
    assert np.exp(logs) == pytest.approx([0.08, 1e9, 1.2])
    assert problem.lower[0] == problem.upper[0] == logs[0]
    assert problem.centre[2] == logs[2]
    assert problem.precision[2] == pytest.approx((1.959964 / np.log(1.5)) ** 2, rel=1e-6)
    assert log_error_of(math.e) == pytest.approx(1.0 / 1.959964, rel=1e-6)


def test_a_wire_without_radial_force_starts_all_the_same() -> None:
    contacts = insulated(1, strand=0.2, insulation=0.1, radial_force=0.0)
    found = pose(take_apart(section_of("A2"), contacts), CURVES, {}, 0.0)
    assert not isinstance(found, CalibrationFailure)
    assert np.exp(found[1][0]) == pytest.approx(0.05)


def test_what_does_not_act() -> None:
    strand = take_apart(concentric((Layer(1, 0.5e-3),)), Contacts((), ()))
    found = pose(strand, CURVES, {}, 0.0)
    assert not isinstance(found, CalibrationFailure)
    assert found[2].tolist() == [False, False, True]
    asked = pose(strand, CURVES, {INSULATION_MODULUS: ParameterChoice()}, 0.0)
    assert asked == CalibrationFailure(
        "parameter_without_effect",
        "insulation_modulus does not act on this wire: there is nothing in the tests to fit it by",
    )


def test_refused() -> None:
    assert refused({COPPER_SCALE: ParameterChoice(1.0, lower=1.2)}) == CalibrationFailure(
        "value_out_of_bounds",
        "copper_scale starts at 1, outside its bounds, 1.2 and 20: give a value between them",
    )
    few = pose(PARTS, measured(n=2), {}, 0.0)
    assert few == CalibrationFailure(
        "too_few_points",
        "6 points for 3 parameters and 3 samples; at least 7 are needed: take more points, or "
        "hold a parameter",
    )


def test_wrong_numbers() -> None:
    with pytest.raises(ValueError, match=r"'phi': allowed are radial_friction, insulation_modulus"):
        posed({"phi": ParameterChoice()})
    with pytest.raises(
        ValueError, match=r"copper_scale: value=-1.0: allowed are finite numbers > 0"
    ):
        posed({COPPER_SCALE: ParameterChoice(-1.0)})
    with pytest.raises(
        ValueError, match=r"copper_scale: factor=1.0: allowed are finite numbers > 1"
    ):
        posed({COPPER_SCALE: ParameterChoice(factor=1.0)})
    with pytest.raises(ValueError, match=r"gain=-0.1: allowed are numbers from 0 to below 1"):
        pose(PARTS, CURVES, {}, -0.1)
