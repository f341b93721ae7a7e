from __future__ import annotations

import pytest

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
    worded,
    worth_knowing,
)


def test_notes_are_values() -> None:
    note = QualityNote("time_holes", Severity.WARNING, "force", "2 holes")
    assert note == QualityNote("time_holes", Severity("warning"), "force", "2 holes")
    assert len({note, QualityNote("time_holes", Severity.WARNING, "force", "2 holes")}) == 1
    assert f"{note.severity}" == "warning"


def test_reasons_in_words() -> None:
    assert worded([]) == ""
    assert (
        worded([Reason("drift", "it drifts"), Reason("gap", "4 s")]) == "drift: it drifts; gap: 4 s"
    )


def test_what_kinds_of_findings_there_are() -> None:
    said = ("code", "force", "message")
    for found, severity, blocks in (
        (worth_knowing(*said), Severity.INFO, False),
        (warning(*said), Severity.WARNING, False),
        (not_available(*said), Severity.ERROR, False),
        (blocking(*said), Severity.ERROR, True),
    ):
        assert found.note == QualityNote("code", severity, "force", "message")
        assert found.code == "code"
        assert found.doubts == ()
        assert found.blocks is blocks


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
    assert [each.during for each in found.doubts] == during
    assert {(each.quantity, each.clock) for each in found.doubts} == {("force", "recorder")}


def test_notes_and_doubts_count_once() -> None:
    each = doubtful("a", "c", "b", "force")
    other = doubtful("a", "c", "b", "clock")
    found = Findings((each, each)) + iter((other,))
    assert len(found.found) == 3
    assert found.notes == (each.note,)
    assert [doubt.quantity for doubt in found.doubts] == ["force", "clock"]


def test_findings_stay_in_order_and_as_they_were() -> None:
    first = Findings((warning("a", "", ""),))
    both = first + iter([warning("b", "", "")])
    assert [each.code for each in both.notes] == ["a", "b"]
    assert [each.code for each in first.notes] == ["a"]


def test_what_another_finding_explains_better_is_left_out() -> None:
    found = Findings((warning("a", "", ""), warning("b", "", ""), warning("a", "", "again")))
    assert [each.code for each in found.without("a").found] == ["b"]


def test_the_first_that_blocks_counts() -> None:
    assert Findings((not_available("x", "", ""),)).blocked is None
    found = Findings((warning("b", "", ""), blocking("c", "align", "three")))
    assert (found + iter([blocking("d", "align", "four")])).blocked == Reason("c", "three")
