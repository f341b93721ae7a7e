from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.curve import Interval
from labpipe.records.wire_calibration import CalibratedParameter, Identified, PriorConflict
from labpipe.wire.calibration.fit import (
    FRICTION_NAMES,
    friction_jacobian,
    in_display_unit,
    separability,
    verdict_of,
    weigh_prior,
    words_of,
)
from tests.builders.loading_tests import TRUTH, measured, wire_of

KNOWN = CalibratedParameter(
    name="insulation_modulus",
    unit="Pa",
    value=1e9,
    intervals=(Interval(0.9e9, 1.1e9),),
    log_error=0.05,
    freedom=20.0,
    is_open_below=False,
    is_open_above=False,
    at_bound="",
    verdict=Identified.WELL,
    words="",
)


@pytest.mark.parametrize(
    ("span", "more", "expected"),
    [
        (1.9, {}, Identified.WELL),
        (2.1, {}, Identified.WEAKLY),
        (101.0, {}, Identified.NOT),
        (1.9, {"is_open": True}, Identified.NOT),
        (1.9, {"prior_error": 0.11}, Identified.BY_PRIOR),
        (1.9, {"prior_error": 0.12}, Identified.WELL),
        (1.9, {"at_bound": True, "is_open": True}, Identified.AT_BOUND),
        (1.9, {"prior_error": 0.11, "contradicts": True}, Identified.AGAINST_PRIOR),
        (1.9, {"contradicts": True, "is_open": True}, Identified.AGAINST_PRIOR),
        (1.9, {"contradicts": True, "at_bound": True}, Identified.AT_BOUND),
        (1.9, {"is_apart": True}, Identified.WELL),
        (2.1, {"is_apart": True}, Identified.TWO),
        (1.9, {"is_apart": True, "span_with_others": 4.0}, Identified.TWO),
        (101.0, {"is_apart": True}, Identified.NOT),
    ],
)
def test_verdicts(span: float, more: dict[str, bool], expected: Identified) -> None:
    usual = {"at_bound": False, "is_open": False, "log_error": 0.1, "prior_error": np.inf}
    assert verdict_of(span, **{**usual, **more}) is expected  # type: ignore[arg-type]


def test_words() -> None:
    name = "the modulus of the insulation"
    assert words_of(KNOWN) == f"{name} is identified: it lies between 900 and 1100 MPa (95 %)"
    open_below = replace(KNOWN, is_open_below=True, verdict=Identified.NOT)
    assert words_of(open_below) == (
        f"{name} is not identified: it lies below 1100 MPa; the tests do not bound it from "
        f"below (95 %)"
    )
    assert "lies above 900 MPa; the tests do not" in words_of(replace(KNOWN, is_open_above=True))
    both = replace(open_below, is_open_above=True)
    assert "may lie anywhere between the bounds, 900 and 1100 MPa" in words_of(both)
    held = replace(KNOWN, intervals=(), source="data sheet")
    assert words_of(held) == f"{name} was held at 1000 MPa (data sheet)"
    parts = (Interval(0.9e9, 1.1e9), Interval(2e9, 3e9))
    two = replace(KNOWN, intervals=parts, verdict=Identified.TWO)
    assert words_of(two) == (
        f"{name} has two solutions: it lies between 900 and 1100 MPa or between 2000 and 3000 MPa "
        "(95 %)"
    )
    assert (
        "lies below 1100 MPa or above 2000 MPa; the tests do not bound it from below or from "
        in (words_of(replace(two, is_open_below=True, is_open_above=True)))
    )
    near = words_of(replace(KNOWN, verdict=Identified.TWO), [(4e8, 0.08)])
    assert near.endswith("MPa (95 %), or near 400 MPa, by a solution that is 0.08 times as likely")
    bound = replace(KNOWN, at_bound="lower", value=0.9e9)
    assert words_of(bound) == (
        f"{name} is doubtful: it ended at the lower bound of its search, 900 MPa; the tests ask "
        f"for a value below it, or do not determine it; inside the bounds it reaches to 1100 MPa "
        f"(95 %)"
    )
    above = words_of(replace(KNOWN, at_bound="upper", value=1.1e9))
    assert "ask for a value above it" in above
    torn = words_of(replace(KNOWN, verdict=Identified.AGAINST_PRIOR))
    assert torn == (
        f"{name} is doubtful, for prior and tests contradict each other: it lies between 900 and "
        "1100 MPa (95 %)"
    )


@pytest.mark.parametrize(
    ("name", "value", "written"),
    [
        ("radial_friction", 0.0465123, "46.51 mN"),
        ("radial_friction", 1e-5, "0.01 mN"),
        ("radial_friction", 100.0, "100000 mN"),
        ("insulation_modulus", 9.571e8, "957.1 MPa"),
        ("insulation_modulus", 1e11, "100000 MPa"),
        ("copper_scale", 0.99924, "0.9992"),
    ],
)
def test_values_have_no_powers_of_ten(name: str, value: float, written: str) -> None:
    assert in_display_unit(name, value) == written


def test_separable_numbers() -> None:
    found = separability(("a", "b"), np.diag([10.0, 4.0]), "two")
    assert found.singular_values == pytest.approx([10.0, 4.0])
    assert found.are_identified == {"a": True, "b": True}
    assert found.words == (
        "two can be told apart: 2 of 2 combinations are known (singular values of two: 10, 4; "
        "below 1 is unknown to within a factor of e)"
    )


def test_numbers_that_only_act_together() -> None:
    found = separability(("a", "b", "c"), np.array([[5.0, 5.0, 0.0], [0.0, 0.0, 9.0]] * 2), "three")
    assert found.are_identified == {"a": False, "b": False, "c": True}
    assert found.words.startswith(
        "a and b are not identified, they cannot be told apart: 2 of 3 combinations are known "
        "(singular values of three: "
    )


def test_a_number_that_nothing_says_anything_of() -> None:
    found = separability(("a", "radial_force"), np.diag([10.0, 0.0]), "two")
    assert found.words.startswith("F_rad is not identified: 1 of 2 combinations is known (")


@pytest.mark.parametrize("name", ["A2", "A3"])
def test_friction_numbers_act_as_one(name: str) -> None:
    wire, curves = wire_of(name), measured(name, (0.1,), samples=1, n=60)
    jacobian = friction_jacobian(
        wire.section, wire.contacts, TRUTH, curves, orientation=0.0, correlation=0.0
    )
    found = separability(FRICTION_NAMES, jacobian, "mu_s, mu_p and F_rad")
    assert found.singular_values[0] > 3.0
    assert not any(found.are_identified.values())
    if name == "A2":
        assert found.singular_values[1] < 1e-3
        weights = found.combinations[0] / found.combinations[0][2]
        assert weights == pytest.approx([0.21 / 0.31, 0.10 / 0.31, 1.0], abs=2e-3)
        assert found.words.startswith(
            "mu_s, mu_p and F_rad are not identified, they cannot be told apart: "
            "1 of 3 combinations is known (singular values of mu_s, mu_p and F_rad: "
        )


def test_a_corner_of_the_curve_does_not_tell_friction_numbers_apart() -> None:
    """With weight, curves have corners where strands begin to slip: all steps cross the same."""
    wire, (curve,) = wire_of("A2"), measured("A2", (0.12,), samples=1, n=1000)
    heavy, at_corner = replace(curve, self_weight=0.03), TRUTH * np.array([1.003, 1.0, 1.0])
    jacobian = friction_jacobian(
        wire.section, wire.contacts, at_corner, (heavy,), orientation=0.0, correlation=0.0
    )
    found = separability(FRICTION_NAMES, jacobian, "mu_s, mu_p and F_rad")
    assert found.singular_values[1] < 1e-3 * found.singular_values[0]


def test_priors_are_weighed() -> None:
    far = PriorConflict(1.5, 1.1, 1.0, 3.0, 1e6, contradicts=False, message="")
    found = weigh_prior("copper_scale", far)
    assert found.contradicts
    assert found.message == (
        "the prior of the strength of the copper, 1.5 within a factor of 1.1, contradicts the "
        "tests, which by themselves say 1: 3.00 standard errors of both together below the prior, "
        "1.96 would be a contradiction at 95 %; the other values are drawn along with it"
    )
    few = weigh_prior("copper_scale", replace(far, freedom=2.0))
    assert not few.contradicts
    assert "agrees with" in few.message
    assert few.message.endswith("4.30 would be a contradiction at 95 %")
    over = weigh_prior("insulation_modulus", replace(far, centre=1e9, alone=1.2e9))
    assert "1000 MPa within a factor of 1.1, contradicts" in over.message
    assert "say 1200 MPa: 3.00 standard errors of both together above the prior" in over.message
