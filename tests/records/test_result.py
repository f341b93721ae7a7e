"""Results, their estimates, findings and causes."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.causes import contribution
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate, widened
from labpipe.records.harness_bundle import Bundle, BundleWire
from labpipe.records.quality import (
    Doubt,
    Findings,
    QualityNote,
    Reason,
    Severity,
    blocking,
    doubtful,
    doubtful_stretches,
    not_available,
    warning,
)
from labpipe.records.result import Contribution, Result, Specimen, Status


@pytest.mark.parametrize(
    ("value", "status"), [(None, Status.OK), (None, Status.DOUBTFUL), (1.0, Status.FAILED)]
)
def test_failed_exactly_without_a_value(value: float | None, status: Status) -> None:
    with pytest.raises(ValueError, match=r"energy.1: a result is failed exactly when it has no"):
        Result("energy.1", value, "J", status=status, reasons=(Reason("gap", "x"),))


@pytest.mark.parametrize(("value", "status"), [(None, Status.FAILED), (1.0, Status.DOUBTFUL)])
def test_must_say_why(value: float | None, status: Status) -> None:
    with pytest.raises(ValueError, match=f"energy.1: a {status} result must say why"):
        Result("energy.1", value, "J", status=status)
    assert (
        Result("energy.1", value, "J", status=status, reasons=(Reason("gap", "x"),)).why == "gap: x"
    )


def test_shares_of_the_variance() -> None:
    budget = (Contribution("noise", 1.0), Contribution("scale of the force", -2.0, is_common=True))
    found = Result("energy.1", 1.0, "J", budget=(*budget, Contribution("slack", 2.0)))
    assert found.shares == pytest.approx((1 / 9, 4 / 9, 4 / 9))
    assert found.largest_share == ("scale of the force", found.shares[1])
    still = Result("energy.1", 1.0, "J", budget=(Contribution("noise", 0.0),))
    assert (still.shares, still.largest_share) == ((0.0,), None)
    assert Result("energy.1", 1.0, "J").largest_share is None


@pytest.mark.parametrize(
    ("estimate", "is_apart"),
    [(None, False), (8.9, True), (9.1, False), (10.9, False), (11.1, True)],
)
def test_an_estimate_apart_from_its_value(estimate: float | None, is_apart: bool) -> None:
    interval = Interval(7.0, 11.0)
    found = Result("energy.1", 10.0, "J", interval, estimate=estimate)
    assert found.apart == (estimate if is_apart else None)


def test_an_estimate_without_an_interval_says_nothing() -> None:
    assert Result("energy.1", 10.0, "J", estimate=3.0).apart is None


LOPSIDED = Estimate(1.0, 0.1, 9, Interval(0.9, 1.4))


def test_an_uncertain_input_widens() -> None:
    assert widened(Estimate(1.0, 3.0, 9), 4.0) == Estimate(1.0, 5.0, 9)
    found = widened(LOPSIDED, 0.1)
    assert found.interval is not None
    assert 1.0 - found.interval.lower == pytest.approx(np.hypot(0.1, 0.196), rel=1e-3)
    assert found.interval.upper - 1.0 == pytest.approx(np.hypot(0.4, 0.196), rel=1e-3)
    assert widened(LOPSIDED) == LOPSIDED


def test_an_interval_beside_its_value_widens_about_its_middle() -> None:
    """Half width 0.1 about 0.8; 0.196 on top in quadrature."""
    off = Estimate(1.0, 0.05, 9, Interval(0.7, 0.9))
    found = widened(off, 0.1).interval
    assert found is not None
    half = np.hypot(0.1, 0.1959964)
    assert (found.lower, found.upper) == pytest.approx((0.8 - half, 0.8 + half), rel=1e-6)


def test_a_doubt_of_several_quantities_is_one_note() -> None:
    found = doubtful("a", "align", "b", "force", "clock", during=(1.0, 2.0), clock="force")
    assert found.note == QualityNote("a", Severity.WARNING, "align", "b")
    reason = Reason("a", "b")
    assert found.doubts == tuple(
        Doubt(each, reason, (1.0, 2.0), "force") for each in ("force", "clock")
    )


@pytest.mark.parametrize(
    ("stretches", "during"),
    [
        ((), [None]),
        (((0.0, 1.0), (4.0, 5.0)), [(0.0, 1.0), (4.0, 5.0)]),
        (((0.0, 1.0), (4.0, 5.0), (7.0, 8.0)), [(0.0, 8.0)]),
    ],
    ids=["all of it", "each", "too many are one"],
)
def test_doubts_of_stretches(
    stretches: tuple[tuple[float, float], ...], during: list[tuple[float, float] | None]
) -> None:
    note = QualityNote("gap", Severity.INFO, "force", "missing", stretches)
    found = doubtful_stretches("force", note, "recorder", most=2)
    assert found.note.severity is Severity.WARNING
    assert [doubt.during for doubt in found.doubts] == during
    assert {(doubt.quantity, doubt.clock) for doubt in found.doubts} == {("force", "recorder")}


def test_notes_and_doubts_count_once() -> None:
    each = doubtful("a", "c", "b", "force")
    other = doubtful("a", "c", "b", "clock")
    found = Findings((each, each)) + iter((other,))
    assert len(found.found) == 3
    assert found.notes == (each.note,)
    assert [doubt.quantity for doubt in found.doubts] == ["force", "clock"]


def test_what_another_finding_explains_better_is_left_out() -> None:
    found = Findings((warning("a", "", ""), warning("b", "", ""), warning("a", "", "again")))
    assert [finding.code for finding in found.without("a").found] == ["b"]


def test_the_first_that_blocks_counts() -> None:
    assert Findings((not_available("x", "", ""),)).blocked is None
    found = Findings((warning("b", "", ""), blocking("c", "align", "three")))
    assert (found + iter([blocking("d", "align", "four")])).blocked == Reason("c", "three")


@pytest.mark.parametrize(
    ("cause", "is_common"),
    [
        ("noise", False),
        ("scale of the force", True),
        ("compliance of the frame", True),
        ("pull offset", False),
        ("grip offset", True),
        ("span", True),
    ],
)
def test_what_tests_of_a_rig_share(cause: str, is_common: bool) -> None:
    assert contribution(cause, -0.2) == Contribution(cause, -0.2, is_common)


def test_a_cause_that_nobody_has_placed() -> None:
    with pytest.raises(KeyError):
        contribution("the moon", 0.1)


MIXED = Bundle(
    (BundleWire("B1", 10), BundleWire("B2", 9)), "asymmetric", tape="PVC", taping="half-lap"
)


def test_words_of_a_bundle() -> None:
    assert (MIXED.number, MIXED.composition) == (19, "10 B1 + 9 B2")
    assert MIXED.fields == {
        "wire": "B1 & B2",
        "number": "19",
        "composition": "10 B1 + 9 B2",
        "arrangement": "asymmetric",
        "tape": "PVC",
        "taping": "half-lap",
        "conduit": "none",
    }


def test_fields_of_a_specimen() -> None:
    plain = Specimen("A2", "s1", "1")
    assert plain.fields == {"type": "A2", "spool": "s1"}
    taped = Specimen("TWB", "s1", "1", bundle=MIXED, labels={"tape": "PVC 3", "cured": "24 h"})
    assert (taped.fields["tape"], taped.fields["cured"]) == ("PVC 3", "24 h")
    assert taped.fields["wire"] == "B1 & B2"
