"""Results, their estimates, findings and causes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.causes import make_contribution
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate, add_errors
from labpipe.records.harness_bundle import Bundle, BundleWire
from labpipe.records.quality import (
    Doubt,
    Finding,
    Findings,
    QualityNote,
    Reason,
    Severity,
    make_stretch_finding,
)
from labpipe.records.result import Contribution, Result, Specimen, Status


@pytest.mark.parametrize(
    ("value", "status", "reasons", "message"),
    [
        (None, Status.OK, [Reason("gap", "x")], "a result is failed exactly when it has no"),
        (None, Status.DOUBTFUL, [Reason("gap", "x")], "a result is failed exactly when it has no"),
        (1.0, Status.FAILED, [Reason("gap", "x")], "a result is failed exactly when it has no"),
        (None, Status.FAILED, [], "a failed result must have a reason"),
        (1.0, Status.DOUBTFUL, [], "a doubtful result must have a reason"),
    ],
)
def test_results_that_contradict_themselves(
    value: float | None, status: Status, reasons: list[Reason], message: str
) -> None:
    with pytest.raises(ValueError, match=f"energy.1: {message}"):
        Result("energy.1", value, "J", status=status, reasons=tuple(reasons))


def test_shares_of_the_variance() -> None:
    budget = (Contribution("noise", 1.0), Contribution("scale of the force", -2.0, is_common=True))
    result = Result("energy.1", 1.0, "J", budget=(*budget, Contribution("slack", 2.0)))
    assert result.fractions == pytest.approx((1 / 9, 4 / 9, 4 / 9))
    assert result.largest_cause == ("scale of the force", result.fractions[1])
    without_variance = Result("energy.1", 1.0, "J", budget=(Contribution("noise", 0.0),))
    assert (without_variance.fractions, without_variance.largest_cause) == ((0.0,), None)
    assert Result("energy.1", 1.0, "J").largest_cause is None


@pytest.mark.parametrize(
    ("estimate", "is_apart"),
    [(None, False), (8.9, True), (9.1, False), (10.9, False), (11.1, True)],
)
def test_an_estimate_apart_from_its_value(estimate: float | None, is_apart: bool) -> None:
    interval = Interval(7.0, 11.0)
    result = Result("energy.1", 10.0, "J", interval, estimate=estimate)
    assert result.distinct_estimate == (estimate if is_apart else None)
    assert replace(result, interval=None).distinct_estimate is None


@pytest.mark.parametrize(
    ("given", "lower", "upper"),
    [
        (Interval(0.9, 1.4), 1.0 - np.hypot(0.1, 0.1959964), 1.0 + np.hypot(0.4, 0.1959964)),
        (Interval(0.7, 0.9), 0.8 - np.hypot(0.1, 0.1959964), 0.8 + np.hypot(0.1, 0.1959964)),
    ],
    ids=["lopsided", "without its value: about its middle"],
)
def test_an_uncertain_input_widens(given: Interval, lower: float, upper: float) -> None:
    assert add_errors(Estimate(1.0, 3.0, 9), 4.0) == Estimate(1.0, 5.0, 9)
    estimate = Estimate(1.0, 0.1, 9, given)
    assert add_errors(estimate) == estimate
    wide = add_errors(estimate, 0.1).interval
    assert wide is not None
    assert (wide.lower, wide.upper) == pytest.approx((lower, upper), rel=1e-6)


def test_a_doubt_of_several_quantities_is_one_note() -> None:
    name, quantities = "process.alignment_one_event", ("force", "clock")
    finding = Finding.of(name, "align", *quantities, period=(1.0, 2.0), clock="force")
    assert finding.note == QualityNote.of(name, "align")
    reason = Reason("alignment_one_event", finding.note.message)
    assert finding.doubts == tuple(
        Doubt(quantity, reason, (1.0, 2.0), "force") for quantity in quantities
    )


@pytest.mark.parametrize(("count", "period"), [(0, [None]), (2, [(0, 1), (4, 5)]), (3, [(0, 8)])])
def test_doubts_of_stretches(count: int, period: list[tuple[float, float] | None]) -> None:
    """Of all of it, of each, and of one long stretch where there are too many."""
    stretches = ((0.0, 1.0), (4.0, 5.0), (7.0, 8.0))[:count]
    note = QualityNote("gap", Severity.INFO, "force", "missing", stretches)
    finding = make_stretch_finding("force", note, "recorder", max_stretches=2)
    assert finding.note.severity is Severity.WARNING
    assert [doubt.period for doubt in finding.doubts] == period
    assert {(doubt.quantity, doubt.clock) for doubt in finding.doubts} == {("force", "recorder")}


def note(code: str, message: str = "") -> QualityNote:
    return QualityNote(code, Severity.ERROR, "align", message)


def test_findings_that_are_left_out_and_the_first_that_blocks() -> None:
    """Notes and doubts count once."""
    of_force, of_clock = (
        Finding(note("a"), (Doubt(quantity, Reason("a", "")),)) for quantity in ("force", "clock")
    )
    all_findings = Findings((of_force, of_force)) + iter((of_clock,))
    assert (len(all_findings.entries), all_findings.notes) == (3, (of_force.note,))
    assert [doubt.quantity for doubt in all_findings.doubts] == ["force", "clock"]
    assert Findings((Finding(note("x")),)).blocking_reason is None
    several = Findings((Finding(note("a")), Finding(note("b")), Finding(note("a", "again"))))
    assert [finding.code for finding in several.remove_code("a").entries] == ["b"]
    findings = Findings((Finding(note("b")), Finding(note("c", "three"), is_blocking=True)))
    findings += iter([Finding(note("x"), is_blocking=True)])
    assert findings.blocking_reason == Reason("c", "three")


def test_what_tests_of_a_rig_share() -> None:
    causes = ("noise", "scale of the force", "compliance of the frame", "pull offset", "span")
    common = [make_contribution(cause, -0.2).is_common for cause in (*causes, "grip offset")]
    assert common == [False, True, True, False, True, True]
    assert make_contribution("span", -0.2) == Contribution("span", -0.2, is_common=True)
    with pytest.raises(KeyError):
        make_contribution("the moon", 0.1)


MIXED = Bundle(
    (BundleWire("B1", 10), BundleWire("B2", 9)), "asymmetric", tape="PVC", taping="half-lap"
)


def test_fields_of_a_specimen() -> None:
    assert Specimen("A2", "s1", "1").fields == {"type": "A2", "spool": "s1"}
    taped = Specimen("TWB", "s1", "1", bundle=MIXED, labels={"tape": "PVC 3", "cured": "24 h"})
    bundle = {"number": "19", "composition": "10 B1 + 9 B2", "arrangement": "asymmetric"}
    tape = {"tape": "PVC 3", "taping": "half-lap", "conduit": "none", "cured": "24 h"}
    assert taped.fields == {"type": "TWB", "spool": "s1", "wire": "B1 & B2"} | bundle | tape
