"""Find the issues of a campaign, group them by cause and rank the causes by their effect.

One camera that loses markers in thirty tests is one cause with many issues. Its effect is that on
the number that changes most: the shift of its mean without the affected tests.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import inf, isnan, sqrt

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.curve import Slip, SlipDecision
from labpipe.records.group import Campaign, Group, GroupNumber, Sample
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Result, Status
from labpipe.report.wording import (
    find_display,
    find_number_unit,
    find_units,
    replace_names,
    typeset_unit,
    write_count,
    write_label,
    write_number,
)
from labpipe.statistics.group_notes import PROTOCOLS_DIFFER
from labpipe.statistics.means import compute_t_quantile

_SLIP_LEDGER_CODES = frozenset(f"slip_{decision}" for decision in SlipDecision)
"""Codes of notes that repeat the slips of a test."""


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
    """Something to check before the numbers of a test or of a group are used.

    Parameters
    ----------
    kind : of issue
    group, test : affected group and test; each is empty if the issue affects several
    what : labels of the affected numbers, or the place of the issue
    reason : sentences with values
    code : codes of the reasons, separated by commas; may be empty
    numbers : names of the affected results; empty if all are affected, or it is unknown which
    tests : affected tests of the group, if `test` is empty
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
    """Find all issues of a campaign, and the notes without consequences.

    Parameters
    ----------
    campaign : all of it

    Returns
    -------
    Issues in the order of `Kind`, then of groups and samples. Numbers of a test that share their
    reasons are one issue.
    """
    issues = [Issue(Kind.UNREADABLE, "", file, "", why) for file, why in campaign.left_out.items()]
    issues += [Issue(Kind.REJECTED, "", file, "", why) for file, why in campaign.rejected.items()]
    for group in campaign.groups:
        issues += _group_issues(group)
    order = list(Kind)
    return tuple(sorted(issues, key=lambda issue: order.index(issue.kind)))


def write_sentence(message: str) -> str:
    """Turn a message into a sentence, with the labels of results in place of their names.

    Examples
    --------
    >>> write_sentence("the branch ends at 4.2 mm")
    'The branch ends at 4.2 mm.'
    """
    text = replace_names(message)
    stop = "" if not text or text.endswith((".", "?", "!")) else "."
    return text[:1].upper() + text[1:] + stop


def join_sentences(reasons: Iterable[Reason | None]) -> str:
    """Join the sentences of reasons, each once; None is skipped."""
    return " ".join(dict.fromkeys(write_sentence(reason.message) for reason in reasons if reason))


def join_codes(reasons: Iterable[Reason]) -> str:
    """Join the codes of reasons, each once."""
    return ", ".join(dict.fromkeys(reason.code for reason in reasons))


def describe_decision(decision: SlipDecision) -> str:
    """Describe the treatment of a slip in one sentence."""
    return {
        SlipDecision.MARKED: "Marked only: the curve is unchanged.",
        SlipDecision.REPAIRED: "Repaired: the lost force is added to all later samples.",
        SlipDecision.CUT: "Cut: the curve ends before the slip.",
    }[decision]


def describe_slip(slip: Slip, group: Group) -> str:
    """Describe the place and the lost force of a slip with intervals and display units."""
    x_unit, y_unit = find_units(find_display(group), "displacement", "force")
    position = write_number(slip.position, slip.position_interval, x_unit.factor)
    lost = write_number(slip.drop, slip.drop_interval, y_unit.factor)
    loss = f"{lost.value} {y_unit.unit} ({lost.interval})"
    return f"{loss} lost at {position.value} {x_unit.unit} ({position.interval})"


def _group_issues(group: Group) -> Iterator[Issue]:
    for sample in group.samples:
        yield from _result_issues(group.name, sample)
        for slip in sample.slips:
            text = describe_slip(slip, group)
            yield Issue(Kind.SLIP, group.name, sample.test, text, describe_decision(slip.decision))
        codes = {reason.code for result in sample.results for reason in result.reasons}
        notes = tuple(note for note in sample.quality if note.code not in codes)
        yield from _note_issues(group.name, sample.test, notes)
    for number in group.numbers:
        yield from _number_issues(group, number)
    if not group.samples and not group.notes:
        reason = group.band.reason or Reason("empty_group", "no sample in this group")
        text = write_sentence(reason.message)
        yield Issue(Kind.WARNING, group.name, "", "empty group", text, reason.code)
    yield from _note_issues(group.name, "", group.notes)


def _result_issues(group: str, sample: Sample) -> Iterator[Issue]:
    results_by_reason: dict[tuple[Kind, tuple[Reason, ...]], list[Result]] = {}
    for result in sample.results:
        issue_kind = _kind(result)
        if issue_kind is not None:
            results_by_reason.setdefault((issue_kind, result.reasons), []).append(result)
    for (issue_kind, reasons), results in results_by_reason.items():
        what = "; ".join(write_label(result.name) for result in results)
        names = tuple(result.name for result in results)
        yield Issue(
            issue_kind,
            group,
            sample.test,
            what,
            join_sentences(reasons),
            join_codes(reasons),
            names,
        )


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
    name = write_label(number.name)
    for test, why in number.left_out.items():
        if test not in failed:  # a failed number has an issue of its own
            reason, codes = join_sentences(why), join_codes(why)
            yield Issue(Kind.LEFT_OUT, group.name, test, name, reason, codes, (number.name,))
    unit = find_number_unit(group, number)
    for outlier in number.outliers:
        value = write_number(outlier.value, None, unit.factor).value
        reason = f"{value} {typeset_unit(unit.unit)}".strip() + (
            f" differs from the other samples by {outlier.method} (p = {outlier.p:.2g})."
        )
        numbers = (number.name,)
        yield Issue(Kind.OUTLIER, group.name, outlier.sample, name, reason, numbers=numbers)


_REPEATED_CODE = "doubtful_in_mean"
"""Code of the note of a group that repeats the reasons of its doubtful numbers."""


def _note_issues(group: str, test: str, notes: tuple[QualityNote, ...]) -> Iterator[Issue]:
    """Yield warnings of a group, and notes of a test that are not a reason of its numbers."""
    notes_by_code: dict[tuple[str, str], list[QualityNote]] = {}
    for note in notes:
        is_repeated = note.code in _SLIP_LEDGER_CODES or note.code == _REPEATED_CODE
        if note.severity is not Severity.INFO and not is_repeated:
            # all differences between the protocols of a group are one issue
            message = "" if note.code == PROTOCOLS_DIFFER else note.message
            notes_by_code.setdefault((note.code, message), []).append(note)
    for (code, _), same_notes in notes_by_code.items():
        is_note = test and same_notes[0].severity is not Severity.ERROR
        what = "; ".join(replace_names(note.where) for note in same_notes)
        issue_kind = Kind.NOTE if is_note else Kind.WARNING
        yield Issue(
            Kind.UNLIKE if code == PROTOCOLS_DIFFER else issue_kind,
            group,
            test,
            what,
            " ".join(dict.fromkeys(write_sentence(note.message) for note in same_notes)),
            code,
            tests=tuple(dict.fromkeys(test for note in same_notes for test in note.tests)),
        )


_HEADINGS = {Kind.UNREADABLE: "Not read", Kind.UNLIKE: "Other processing", Kind.SLIP: "Slips"}
"""Headings of kinds whose names are not headings."""


@dataclass(frozen=True, slots=True)
class Effect:
    """Effect of a cause on the number that it changes most.

    Parameters
    ----------
    size : in half widths of the interval of the number; infinite if no value remains
    text : describes the effect, without a full stop
    """

    size: float
    text: str


@dataclass(frozen=True, slots=True)
class Cause:
    """Issues with a common cause.

    Parameters
    ----------
    kind : of the issues
    code : of the first issue; may be empty
    issues : at least one
    effect : None if it is unknown
    """

    kind: Kind
    code: str
    issues: tuple[Issue, ...]
    effect: Effect | None

    @property
    def heading(self) -> str:
        """Return the kind in one or two words."""
        return _HEADINGS.get(self.kind, self.kind.name.capitalize().replace("_", " "))

    @property
    def subject(self) -> str:
        """Return the affected test or group, or the number of tests or groups."""
        groups = list(dict.fromkeys(issue.group for issue in self.issues))
        tests = dict.fromkeys(
            (issue.group, test)
            for issue in self.issues
            for test in (issue.test, *issue.tests)
            if test
        )
        if len(tests) == 1:
            ((group, test),) = tests
            return f"{test} ({group})" if group else test
        where = groups[0] if len(groups) == 1 else write_count(len(groups), "group")
        if not tests:
            return where
        return f"{write_count(len(tests), 'test')} {'of' if len(groups) == 1 else 'in'} {where}"

    @property
    def sentence(self) -> str:
        """Return the first reason, and how many more there are."""
        if self.kind is Kind.UNLIKE:
            places = dict.fromkeys(
                place for issue in self.issues for place in issue.what.split("; ")
            )
            return f"Processed differently from other tests of their group: {', '.join(places)}."
        reasons = list(dict.fromkeys(issue.reason for issue in self.issues))
        more = f" And {len(reasons) - 1} more." if len(reasons) > 1 else ""
        return f"{reasons[0]}{more}"


def find_causes(campaign: Campaign) -> list[Cause]:
    """Group issues by cause and rank them by their effect on a number.

    Parameters
    ----------
    campaign : all of it

    Returns
    -------
    Causes by decreasing effect, those of unknown effect last; causes of equal effect in the order
    of `Kind`. Notes without consequences are not included (`find_notes`).
    """
    issues = [issue for issue in find_issues(campaign) if issue.kind is not Kind.NOTE]
    groups = {group.name: group for group in campaign.groups}
    causes = [
        Cause(related[0].kind, related[0].code, tuple(related), _effect(related, groups))
        for related in _cluster_issues(issues)
    ]
    return sorted(
        causes, key=lambda cause: -inf if cause.effect is None else cause.effect.size, reverse=True
    )


def find_notes(campaign: Campaign) -> list[Cause]:
    """Group the notes without consequences by code, the most frequent first.

    Parameters
    ----------
    campaign : all of it
    """
    notes = [issue for issue in find_issues(campaign) if issue.kind is Kind.NOTE]
    causes = [
        Cause(same[0].kind, same[0].code, tuple(same), None) for same in _cluster_issues(notes)
    ]
    return sorted(causes, key=lambda cause: len(cause.issues), reverse=True)


def _cluster_issues(issues: Iterable[Issue]) -> list[list[Issue]]:
    """Cluster issues of one kind that share a code; slips share one cluster."""
    clusters: list[tuple[Kind, set[str], list[Issue]]] = []
    for issue in issues:
        codes = (
            {Kind.SLIP} if issue.kind is Kind.SLIP else set(filter(None, issue.code.split(", ")))
        )
        for issue_kind, cluster_codes, related in clusters:
            if issue_kind is issue.kind and codes & cluster_codes:
                cluster_codes.update(codes)
                related.append(issue)
                break
        else:
            clusters.append((issue.kind, set(codes), [issue]))
    return [related for _, _, related in clusters]


def _effect(issues: Sequence[Issue], groups: dict[str, Group]) -> Effect | None:
    if issues[0].kind is Kind.UNREADABLE:
        return Effect(inf, format_sentence("report.effect_unreadable"))
    if issues[0].kind is Kind.REJECTED:
        return Effect(0.0, format_sentence("report.effect_rejected"))
    issues_by_group: dict[str, list[Issue]] = {}
    for issue in issues:
        issues_by_group.setdefault(issue.group, []).append(issue)
    effects = [
        effect
        for name, group_issues in issues_by_group.items()
        if name in groups
        for effect in _group_effects(groups[name], group_issues)
    ]
    return max(effects, key=lambda effect: effect.size, default=None)


def _group_effects(group: Group, issues: Sequence[Issue]) -> Iterator[Effect]:
    """Yield the effect of the affected tests on each number of a group."""
    for number in group.numbers:
        tests = {
            test
            for issue in issues
            if not issue.numbers or number.name in issue.numbers
            for test in (issue.test, *issue.tests)
            if test
        }
        if tests and not number.is_set_by_rig:
            effect = _excluded_effect(group, number, tests) or _shift_effect(group, number, tests)
            if effect is not None:
                yield effect


def _excluded_effect(group: Group, number: GroupNumber, tests: set[str]) -> Effect | None:
    """Return the effect of tests that do not enter the mean of a number."""
    no_interval_effect = 10.0  # half widths, of a cause that leaves one value, without an interval
    lost = len(tests & number.left_out.keys())
    if not lost:
        return None
    name = f"{write_label(number.name)} of {group.name}"
    if number.mean is None:
        return Effect(inf, format_sentence("report.effect_no_value", number=name))
    n = number.mean.chosen.n
    if n == 1:
        text = format_sentence("report.effect_one_value", number=name)
        return Effect(no_interval_effect, text)
    wider = _relative_width(n) / _relative_width(n + lost)
    text = format_sentence(
        "report.effect_fewer_values", n=n, n_all=n + lost, number=name, wider=wider
    )
    return Effect(wider - 1.0, text)


def _relative_width(n: int) -> float:
    return compute_t_quantile(n - 1) / sqrt(n)


def _shift_effect(group: Group, number: GroupNumber, tests: set[str]) -> Effect | None:
    """Return the effect of tests on a mean that includes them: its shift without them."""
    all_values_effect = 5.0  # half widths, of a cause that affects all values of a number
    touched = tests & number.values.keys()
    mean = number.mean
    if not touched or mean is None:
        return None
    name = f"{write_label(number.name)} of {group.name}"
    spools = {sample.test: sample.specimen.spool for sample in group.samples}
    remaining: dict[str, list[float]] = {}
    for test, result in number.values.items():
        if test not in touched and result.value is not None:
            spool = "" if mean.is_pooled else spools.get(test, "")
            remaining.setdefault(spool, []).append(result.value)
    if not remaining:
        text = format_sentence("report.effect_all_values", number=name)
        return Effect(all_values_effect, text)
    before, half = mean.chosen.mean, mean.chosen.half_width
    moved = float(np.mean([np.mean(values) for values in remaining.values()])) - before
    without = f"without {'it' if len(touched) == 1 else 'them'}, {name} would be"
    share = f"{100.0 * abs(moved / before):.2g} % " if before else ""
    direction = "higher" if moved > 0.0 else "lower"
    size = abs(moved) / half if half > 0.0 else 0.0
    if isnan(half) or isnan(size):
        return Effect(0.0, f"{without} {share}{direction}")
    return Effect(size, f"{without} {share}{direction}, {size:.2g} times half its interval")
