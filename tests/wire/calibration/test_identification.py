"""What a calibration identifies: verdicts, their words, combinations of numbers, and priors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labpipe.mechanics.wire.calibration.identification import (
    compare_with_prior,
    describe_parameter,
    find_separability,
    find_verdict,
    format_value,
)
from labpipe.records.curve import Interval
from labpipe.records.wire import CalibratedParameter, Identifiability, PriorConflict
from tests.approved import Approve

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
    verdict=Identifiability.IDENTIFIED,
    explanation="",
)


@pytest.mark.parametrize(
    ("span", "more", "expected"),
    [
        (1.9, {}, Identifiability.IDENTIFIED),
        (2.1, {}, Identifiability.WEAKLY_IDENTIFIED),
        (101.0, {}, Identifiability.NOT_IDENTIFIED),
        (1.9, {"is_open_below": True}, Identifiability.NOT_IDENTIFIED),
        (1.9, {"is_open_above": True}, Identifiability.NOT_IDENTIFIED),
        (1.9, {"prior_error": 0.11}, Identifiability.BY_PRIOR),
        (1.9, {"prior_error": 0.12}, Identifiability.IDENTIFIED),
        (1.9, {"at_bound": "lower", "is_open_below": True}, Identifiability.AT_BOUND),
        (1.9, {"prior_error": 0.11, "contradicts": True}, Identifiability.AGAINST_PRIOR),
        (1.9, {"contradicts": True, "is_open_above": True}, Identifiability.AGAINST_PRIOR),
        (1.9, {"contradicts": True, "at_bound": "upper"}, Identifiability.AT_BOUND),
        (1.9, {"others": ((1.95e9, 0.1),)}, Identifiability.IDENTIFIED),
        (2.1, {"others": ((2.3e9, 0.1),)}, Identifiability.TWO_SOLUTIONS),
        (1.9, {"others": ((4e9, 0.1),)}, Identifiability.TWO_SOLUTIONS),
        (1.9, {"ends": (1e9, 4e9)}, Identifiability.WEAKLY_IDENTIFIED),
        (101.0, {"others": ((200e9, 0.1),)}, Identifiability.NOT_IDENTIFIED),
    ],
)
def test_verdicts(span: float, more: dict[str, Any], expected: Identifiability) -> None:
    given = dict(more)
    others, ends = given.pop("others", ()), given.pop("ends", None)
    error, contradicts = given.pop("prior_error", None), given.pop("contradicts", False)
    if error or contradicts:
        factor = float(np.exp(1.959964 * (error or np.inf)))
        given["conflict"] = replace(CONFLICT, factor=factor, contradicts=contradicts)
    parameter = replace(KNOWN, intervals=(Interval(1e9, span * 1e9),), log_error=0.1, **given)
    assert find_verdict(parameter, others, ends) is expected


CONFLICT = PriorConflict(1.5, 1.1, 1.0, 3.0, 1e6, contradicts=False, message="")


def test_separability() -> None:
    names = ("a", "radial_friction", "c")
    only_together = np.array([[5.0, 5.0, 0.0], [0.0, 0.0, 9.0]] * 2)
    for matrix, are_identified in (
        (np.diag([10.0, 4.0, 2.0]), [True, True, True]),
        (only_together, [False, False, True]),
        (np.diag([10.0, 0.0, 9.0]), [True, False, True]),
    ):
        result = find_separability(names, matrix, "three")
        assert result.singular_values == pytest.approx(np.linalg.svd(matrix)[1], abs=1e-9)
        assert result.are_identified == dict(zip(names, are_identified, strict=True))


def test_words(approved: Approve) -> None:
    parts = (Interval(0.9e9, 1.1e9), Interval(2e9, 3e9))
    changes: list[dict[str, Any]] = [
        {},
        {"is_open_below": True, "verdict": Identifiability.NOT_IDENTIFIED},
        {"is_open_above": True},
        {"is_open_below": True, "is_open_above": True, "verdict": Identifiability.NOT_IDENTIFIED},
        {"intervals": (), "source": "data sheet"},
        {"intervals": parts, "verdict": Identifiability.TWO_SOLUTIONS},
        {"intervals": parts, "is_open_below": True, "is_open_above": True},
        {"at_bound": "lower", "value": 0.9e9},
        {"at_bound": "upper", "value": 1.1e9},
        {"verdict": Identifiability.AGAINST_PRIOR},
    ]
    lines = [describe_parameter(replace(KNOWN, **change)) for change in changes]
    parameter = replace(KNOWN, verdict=Identifiability.TWO_SOLUTIONS)
    lines.append(describe_parameter(parameter, [(4e8, 0.08)]))
    names = ("a", "b", "radial_friction")
    for matrix in (np.diag([10.0, 4.0, 2.0]), np.diag([9.0, 4.0, 0.0]), np.ones((3, 3))):
        lines.append(
            find_separability(names, matrix, "three").explanation.partition(" (singular")[0]
        )
    for name, values in (
        ("radial_friction", (0.0465123, 1e-5, 100.0)),
        ("insulation_modulus", (9.571e8, 1e11)),
        ("copper_scale", (0.99924,)),
    ):
        lines += [format_value(name, value) for value in values]
    approved(lines)


def test_priors_are_weighed(approved: Approve) -> None:
    conflicts = [
        compare_with_prior("copper_scale", CONFLICT),
        compare_with_prior("copper_scale", replace(CONFLICT, freedom=2.0)),
        compare_with_prior("insulation_modulus", replace(CONFLICT, centre=1e9, estimate=1.2e9)),
    ]
    assert [conflict.contradicts for conflict in conflicts] == [True, False, True]
    approved(conflict.message for conflict in conflicts)
