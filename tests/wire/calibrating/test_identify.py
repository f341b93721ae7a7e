from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.calibration import CalibratedParameter, Identified, PriorConflict
from labpipe.records.curve import Interval
from labpipe.wire.calibrating.identify import (
    FRICTION_NAMES,
    friction_jacobian,
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
    interval=Interval(0.9e9, 1.1e9),
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
    ],
)
def test_verdicts(span: float, more: dict[str, bool], expected: Identified) -> None:
    usual = {"at_bound": False, "is_open": False, "log_error": 0.1, "prior_error": np.inf}
    assert verdict_of(span, **{**usual, **more}) is expected  # type: ignore[arg-type]


def test_words() -> None:
    name = "the modulus of the insulation"
    assert words_of(KNOWN) == f"{name} is identified: it lies between 9e+08 and 1.1e+09 Pa (95 %)"
    open_below = replace(KNOWN, is_open_below=True, verdict=Identified.NOT)
    assert words_of(open_below) == (
        f"{name} is not identified: it lies below 1.1e+09 Pa; the tests do not bound it from "
        f"below (95 %)"
    )
    assert "lies above 9e+08 Pa; the tests do not" in words_of(replace(KNOWN, is_open_above=True))
    both = replace(open_below, is_open_above=True)
    assert "may lie anywhere between the bounds, 9e+08 and 1.1e+09 Pa" in words_of(both)
    held = replace(KNOWN, interval=None)
    assert words_of(held) == f"{name} was held at 1e+09 Pa"
    bound = replace(KNOWN, at_bound="lower", value=0.9e9)
    assert words_of(bound) == (
        f"{name} ended at the lower bound of its search, 9e+08 Pa: the tests ask for a value "
        f"below it, or do not determine it; inside the bounds it reaches to 1.1e+09 Pa (95 %)"
    )
    above = words_of(replace(KNOWN, at_bound="upper", value=1.1e9))
    assert "ask for a value above it" in above


def test_separable_numbers() -> None:
    found = separability(("a", "b"), np.diag([10.0, 4.0]), "two")
    assert found.singular_values == pytest.approx([10.0, 4.0])
    assert found.are_identified == {"a": True, "b": True}
    assert found.words == (
        "singular values of two: 10, 4; all 2 combinations are known to within a factor of e or "
        "better"
    )


def test_numbers_that_only_act_together() -> None:
    found = separability(("a", "b", "c"), np.array([[5.0, 5.0, 0.0], [0.0, 0.0, 9.0]] * 2), "three")
    assert found.are_identified == {"a": False, "b": False, "c": True}
    assert found.words.endswith(
        "1 of 3 combinations are not identified, so a and b cannot be told apart"
    )


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


def test_priors_are_weighed() -> None:
    far = PriorConflict(1.5, 1.1, 1.0, 3.0, 1e6, contradicts=False, message="")
    found = weigh_prior("copper_scale", far)
    assert found.contradicts
    assert found.message == (
        "the prior of the strength of the copper, 1.5 within a factor of 1.1, contradicts the "
        "tests, which by themselves say 1: 3.00 standard deviations of both together, 1.96 at 95 %"
    )
    few = weigh_prior("copper_scale", replace(far, freedom=2.0))
    assert not few.contradicts
    assert "agrees with" in few.message
