"""What a lab head should look at before the numbers: collected from everywhere, worst first."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

from labpipe.records.curve import Slip, SlipDecision
from labpipe.records.group import Campaign, Group, GroupNumber, Sample
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Result, Status
from labpipe.report.wording import (
    display_of,
    in_words,
    shown_in,
    unit_words,
    with_names_in_words,
    write_number,
)
from labpipe.statistics.group_notes import PROTOCOLS_DIFFER

_IN_LEDGER = frozenset(f"slip_{decision}" for decision in SlipDecision)
"""Notes that only repeat what the slip ledger says."""


class Kind(StrEnum):
    """Kinds of concern, in the order of the report."""

    UNREADABLE = "Tests that could not be read"
    REJECTED = "Tests that were rejected"
    UNLIKE = "Tests that were not processed alike"
    FAILED = "Failed: numbers that could not be computed"
    DOUBTFUL = "Doubtful: numbers to be checked"
    LEFT_OUT = "Samples that do not enter a mean"
    OUTLIER = "Marked as outliers (they stay in every mean)"
    SLIP = "Slips in the grips"
    WARNING = "Warnings"
    NO_INTERVAL = "Numbers without an interval"
    NOTE = "Notes of which nothing follows"


@dataclass(frozen=True, slots=True)
class Issue:
    """One thing to look at.

    Parameters
    ----------
    kind : which table it stands in
    group, test : whom it concerns; empty where it is no single one
    what : numbers or place, in words
    reason : sentences with the numbers
    code : stable codes of the reasons, empty where they have none
    numbers : names of the results that it touches; none where it touches all or nobody knows
    tests : tests of a group that it speaks of, where `test` is no single one
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
    """Collect what is doubtful, failed, left out, marked, repaired or warned of.

    Parameters
    ----------
    campaign : all of it

    Returns
    -------
    In the order of `Kind`, and within a kind in the order of groups and samples. Numbers of a test
    that share a reason stand together.
    """
    concerns = [
        Issue(Kind.UNREADABLE, "", file, "", why) for file, why in campaign.left_out.items()
    ]
    concerns += [Issue(Kind.REJECTED, "", file, "", why) for file, why in campaign.rejected.items()]
    for group in campaign.groups:
        concerns += _of_group(group)
    order = list(Kind)
    return tuple(sorted(concerns, key=lambda finding: order.index(finding.kind)))


def sentence(message: str) -> str:
    """Make a sentence of a message; names of results in it are worded as in the tables.

    Examples
    --------
    >>> sentence("the branch ends at 4.2 mm")
    'The branch ends at 4.2 mm.'
    """
    words = with_names_in_words(message)
    stop = "" if not words or words.endswith((".", "?", "!")) else "."
    return words[:1].upper() + words[1:] + stop


def sentences(reasons: Iterable[Reason | None]) -> str:
    """Say reasons in sentences; None counts as no reason."""
    return " ".join(dict.fromkeys(sentence(reason.message) for reason in reasons if reason))


def codes_of(reasons: Iterable[Reason]) -> str:
    """List the codes of reasons, each once."""
    return ", ".join(dict.fromkeys(reason.code for reason in reasons))


def decision_words(decision: SlipDecision) -> str:
    """What was done about a slip, as a sentence."""
    return {
        SlipDecision.MARKED: "Marked only: the curve is as measured.",
        SlipDecision.REPAIRED: "Repaired: the force lost is added back to all that follows.",
        SlipDecision.CUT: "Cut: the curve ends before the slip.",
    }[decision]


def slip_words(slip: Slip, group: Group) -> str:
    """Where a slip is and what force it lost, with intervals and display units."""
    display = display_of(group)
    across, up = shown_in("", "m", display), shown_in("", "N", display)
    at = write_number(slip.position, slip.position_interval, across.factor)
    lost = write_number(slip.drop, slip.drop_interval, up.factor)
    where = f"{at.value} {unit_words(across.unit)}"
    return f"{lost.value} {unit_words(up.unit)} ({lost.interval}) lost at {where} ({at.interval})"


def _of_group(group: Group) -> Iterator[Issue]:
    for sample in group.samples:
        yield from _of_results(group.name, sample)
        for slip in sample.slips:
            words = slip_words(slip, group)
            yield Issue(Kind.SLIP, group.name, sample.test, words, decision_words(slip.decision))
        codes = {reason.code for result in sample.results for reason in result.reasons}
        notes = tuple(note for note in sample.quality if note.code not in codes)
        yield from _of_notes(group.name, sample.test, notes)
    for number in group.numbers:
        yield from _of_number(group, number)
    if not group.samples and not group.notes:
        reason = group.band.reason or Reason("empty_group", "no sample in this group")
        words = sentence(reason.message)
        yield Issue(Kind.WARNING, group.name, "", "empty group", words, reason.code)
    yield from _of_notes(group.name, "", group.notes)


def _of_results(group: str, sample: Sample) -> Iterator[Issue]:
    together: dict[tuple[Kind, tuple[Reason, ...]], list[Result]] = {}
    for result in sample.results:
        kind = _kind(result)
        if kind is not None:
            together.setdefault((kind, result.reasons), []).append(result)
    for (kind, reasons), results in together.items():
        what = "; ".join(in_words(result.name) for result in results)
        names = tuple(result.name for result in results)
        yield Issue(kind, group, sample.test, what, sentences(reasons), codes_of(reasons), names)


def _kind(result: Result) -> Kind | None:
    if result.status is Status.FAILED:
        return Kind.FAILED
    if result.status is Status.DOUBTFUL:
        return Kind.DOUBTFUL
    return Kind.NO_INTERVAL if result.interval is None and result.reasons else None


def _of_number(group: Group, number: GroupNumber) -> Iterator[Issue]:
    failed = {
        sample.test
        for sample in group.samples
        for result in sample.results
        if result.name == number.name and result.status is Status.FAILED
    }
    name = in_words(number.name)
    for test, why in number.left_out.items():
        if test not in failed:  # those stand under their own heading
            said = sentences(why), codes_of(why), (number.name,)
            yield Issue(Kind.LEFT_OUT, group.name, test, name, *said)
    shown = shown_in(number.name, number.unit, display_of(group))
    for outlier in number.outliers:
        value = write_number(outlier.value, None, shown.factor).value
        reason = f"{value} {unit_words(shown.unit)}".strip() + (
            f" stands apart from the other samples by {outlier.method} (p = {outlier.p:.2g})."
        )
        numbers = (number.name,)
        yield Issue(Kind.OUTLIER, group.name, outlier.sample, name, reason, numbers=numbers)


_SAID_BY_NUMBERS = "doubtful_in_mean"
"""Note of a group that repeats what its doubtful numbers say."""


def _of_notes(group: str, test: str, notes: tuple[QualityNote, ...]) -> Iterator[Issue]:
    """Warnings of a group, and notes of a test that no number of it gives as a reason."""
    together: dict[tuple[str, str], list[QualityNote]] = {}
    for note in notes:
        is_said = note.code in _IN_LEDGER or note.code == _SAID_BY_NUMBERS
        if note.severity is not Severity.INFO and not is_said:
            message = "" if note.code == PROTOCOLS_DIFFER else note.message  # one entry for a group
            together.setdefault((note.code, message), []).append(note)
    for (code, _), own in together.items():
        is_note = test and own[0].severity is not Severity.ERROR
        what = "; ".join(with_names_in_words(each.where) for each in own)
        kind = Kind.NOTE if is_note else Kind.WARNING
        yield Issue(
            Kind.UNLIKE if code == PROTOCOLS_DIFFER else kind,
            group,
            test,
            what,
            " ".join(dict.fromkeys(sentence(note.message) for note in own)),
            code,
            tests=tuple(dict.fromkeys(test for note in own for test in note.tests)),
        )
