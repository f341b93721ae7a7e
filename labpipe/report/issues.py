"""Issues to check before the numbers are used, from all results, worst first."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

from labpipe.records.curve import Slip, SlipDecision
from labpipe.records.group import Campaign, Group, GroupNumber, Sample
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Result, Status
from labpipe.report.wording import (
    as_label,
    display_of,
    replace_names,
    shown_in,
    unit_words,
    write_number,
)
from labpipe.statistics.group_notes import PROTOCOLS_DIFFER

_SLIP_LEDGER_CODES = frozenset(f"slip_{decision}" for decision in SlipDecision)
"""Notes that only repeat the slip ledger."""


class Kind(StrEnum):
    """Kinds of issues, in the order of the report."""

    UNREADABLE = "Tests that could not be read"
    REJECTED = "Tests that were rejected"
    UNLIKE = "Tests processed differently within a group"
    FAILED = "Failed: numbers that could not be computed"
    DOUBTFUL = "Doubtful: numbers to be checked"
    LEFT_OUT = "Samples that do not enter a mean"
    OUTLIER = "Marked as outliers (included in all means)"
    SLIP = "Slips in the grips"
    WARNING = "Warnings"
    NO_INTERVAL = "Numbers without an interval"
    NOTE = "Notes without consequences"


@dataclass(frozen=True, slots=True)
class Issue:
    """One issue.

    Parameters
    ----------
    kind : of issue
    group, test : affected group and test; empty if it is not a single one
    what : numbers or place, in words
    reason : sentences with values
    code : stable codes of the reasons, if any
    numbers : names of the affected results; empty for all or unknown ones
    tests : affected tests of a group, if `test` is empty
    """

    kind: Kind
    group: str
    test: str
    what: str
    reason: str
    code: str = ""
    numbers: tuple[str, ...] = ()
    tests: tuple[str, ...] = ()


def find_issues(campaign: Campaign) -> tuple[Issue, ...]:
    """Collect all doubtful, failed, excluded, marked and repaired results, and all warnings.

    Parameters
    ----------
    campaign : all of it

    Returns
    -------
    Issues in the order of `Kind`, then of groups and samples. Numbers of a test with a common
    reason are one issue.
    """
    concerns = [
        Issue(Kind.UNREADABLE, "", file, "", why) for file, why in campaign.left_out.items()
    ]
    concerns += [Issue(Kind.REJECTED, "", file, "", why) for file, why in campaign.rejected.items()]
    for group in campaign.groups:
        concerns += _group_issues(group)
    order = list(Kind)
    return tuple(sorted(concerns, key=lambda finding: order.index(finding.kind)))


def sentence(message: str) -> str:
    """Turn a message into a sentence, with names of results as in the tables.

    Examples
    --------
    >>> sentence("the branch ends at 4.2 mm")
    'The branch ends at 4.2 mm.'
    """
    text = replace_names(message)
    stop = "" if not text or text.endswith((".", "?", "!")) else "."
    return text[:1].upper() + text[1:] + stop


def sentences(reasons: Iterable[Reason | None]) -> str:
    """Join reasons as sentences; None is skipped."""
    return " ".join(dict.fromkeys(sentence(reason.message) for reason in reasons if reason))


def codes_of(reasons: Iterable[Reason]) -> str:
    """List the codes of reasons, each once."""
    return ", ".join(dict.fromkeys(reason.code for reason in reasons))


def decision_words(decision: SlipDecision) -> str:
    """Describe the treatment of a slip in a sentence."""
    return {
        SlipDecision.MARKED: "Marked only: the curve is unchanged.",
        SlipDecision.REPAIRED: "Repaired: the lost force is added to all later samples.",
        SlipDecision.CUT: "Cut: the curve ends before the slip.",
    }[decision]


def slip_words(slip: Slip, group: Group) -> str:
    """Describe the place and the lost force of a slip with intervals and display units."""
    display = display_of(group)
    across, up = shown_in("", "m", display), shown_in("", "N", display)
    at = write_number(slip.position, slip.position_interval, across.factor)
    lost = write_number(slip.drop, slip.drop_interval, up.factor)
    where = f"{at.value} {unit_words(across.unit)}"
    return f"{lost.value} {unit_words(up.unit)} ({lost.interval}) lost at {where} ({at.interval})"


def _group_issues(group: Group) -> Iterator[Issue]:
    for sample in group.samples:
        yield from _result_issues(group.name, sample)
        for slip in sample.slips:
            text = slip_words(slip, group)
            yield Issue(Kind.SLIP, group.name, sample.test, text, decision_words(slip.decision))
        codes = {reason.code for result in sample.results for reason in result.reasons}
        notes = tuple(note for note in sample.quality if note.code not in codes)
        yield from _note_issues(group.name, sample.test, notes)
    for number in group.numbers:
        yield from _number_issues(group, number)
    if not group.samples and not group.notes:
        reason = group.band.reason or Reason("empty_group", "no sample in this group")
        text = sentence(reason.message)
        yield Issue(Kind.WARNING, group.name, "", "empty group", text, reason.code)
    yield from _note_issues(group.name, "", group.notes)


def _result_issues(group: str, sample: Sample) -> Iterator[Issue]:
    results_by_reason: dict[tuple[Kind, tuple[Reason, ...]], list[Result]] = {}
    for result in sample.results:
        kind = _kind(result)
        if kind is not None:
            results_by_reason.setdefault((kind, result.reasons), []).append(result)
    for (kind, reasons), results in results_by_reason.items():
        what = "; ".join(as_label(result.name) for result in results)
        names = tuple(result.name for result in results)
        yield Issue(kind, group, sample.test, what, sentences(reasons), codes_of(reasons), names)


def _kind(result: Result) -> Kind | None:
    if result.status is Status.FAILED:
        return Kind.FAILED
    if result.status is Status.DOUBTFUL:
        return Kind.DOUBTFUL
    return Kind.NO_INTERVAL if result.interval is None and result.reasons else None


def _number_issues(group: Group, number: GroupNumber) -> Iterator[Issue]:
    failed = {
        sample.test
        for sample in group.samples
        for result in sample.results
        if result.name == number.name and result.status is Status.FAILED
    }
    name = as_label(number.name)
    for test, why in number.left_out.items():
        if test not in failed:  # failed ones have their own heading
            reason_fields = sentences(why), codes_of(why), (number.name,)
            yield Issue(Kind.LEFT_OUT, group.name, test, name, *reason_fields)
    unit = shown_in(number.name, number.unit, display_of(group))
    for outlier in number.outliers:
        value = write_number(outlier.value, None, unit.factor).value
        reason = f"{value} {unit_words(unit.unit)}".strip() + (
            f" differs from the other samples by {outlier.method} (p = {outlier.p:.2g})."
        )
        numbers = (number.name,)
        yield Issue(Kind.OUTLIER, group.name, outlier.sample, name, reason, numbers=numbers)


_REPEATED_CODE = "doubtful_in_mean"
"""Code of a group's note that repeats the reasons of its doubtful numbers."""


def _note_issues(group: str, test: str, notes: tuple[QualityNote, ...]) -> Iterator[Issue]:
    """Yield warnings of a group, and notes of a test that are not a reason of its numbers."""
    notes_by_code: dict[tuple[str, str], list[QualityNote]] = {}
    for note in notes:
        is_repeated = note.code in _SLIP_LEDGER_CODES or note.code == _REPEATED_CODE
        if note.severity is not Severity.INFO and not is_repeated:
            message = "" if note.code == PROTOCOLS_DIFFER else note.message  # one entry for a group
            notes_by_code.setdefault((note.code, message), []).append(note)
    for (code, _), same_notes in notes_by_code.items():
        is_note = test and same_notes[0].severity is not Severity.ERROR
        what = "; ".join(replace_names(note.where) for note in same_notes)
        kind = Kind.NOTE if is_note else Kind.WARNING
        yield Issue(
            Kind.UNLIKE if code == PROTOCOLS_DIFFER else kind,
            group,
            test,
            what,
            " ".join(dict.fromkeys(sentence(note.message) for note in same_notes)),
            code,
            tests=tuple(dict.fromkeys(test for note in same_notes for test in note.tests)),
        )
