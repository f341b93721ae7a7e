"""Find the issues of a campaign, group them by cause and rank the causes by their effect.

One camera that loses markers in thirty tests is one cause with many issues. The effect of a cause
is the shift of a mean when the affected tests are left out, or the widening of the interval of a
mean because tests are missing. The effect is computed for each result of the affected groups that
the rig does not impose, and the largest is reported. Unreadable and rejected tests have fixed
effects.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf, isclose, isnan, sqrt
from typing import NamedTuple

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.curve import SlipDecision
from labpipe.records.group import Campaign, Group, GroupNumber, Sample
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Result, Status
from labpipe.report import wording
from labpipe.statistics.group_samples import PROTOCOLS_DIFFER, name_samples
from labpipe.statistics.means import compute_t_quantile


class Kind(StrEnum):
    """Kinds of issues with their headings, in the order in which `find_issues` returns them."""

    UNREADABLE = "Tests that could not be read"
    REJECTED = "Tests that were rejected"
    PROCESSING = "Tests processed differently within a group"
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
    """Issue of a test or a group that a person should check, or a note without consequences.

    Parameters
    ----------
    kind : kind of the issue
    group : affected group; empty if the issue affects a test without a group
    tests : names of the affected tests (`name_samples`), or the file of a test that is in no group;
        empty if the issue affects the whole group
    topic : labels of the affected numbers, description of a slip, or subject of a note; empty for a
        test that is in no group
    reason : sentences that give the reason with its values
    code : codes of the reasons, separated by commas, or code of the note; empty for slips, for
        outliers and for tests that are in no group
    numbers : names of the affected results; empty if any result of the tests may be affected
    """

    kind: Kind
    group: str
    tests: tuple[str, ...]
    topic: str
    reason: str
    code: str = ""
    numbers: tuple[str, ...] = ()


def find_issues(campaign: Campaign) -> tuple[Issue, ...]:
    """Find all issues of a campaign, and the notes without consequences.

    Parameters
    ----------
    campaign : content of the report

    Returns
    -------
    Issues in the order of `Kind`, then of groups. Within a group, samples left out and outliers are
    in the order of numbers, other issues in the order of samples, and notes on the group are last.
    Failed numbers of a test with the same reasons are one issue, and so are doubtful numbers and
    numbers without an interval.
    """
    reasons_by_kind = {Kind.UNREADABLE: campaign.failures, Kind.REJECTED: campaign.rejected}
    issues = [
        Issue(kind, "", (file,), "", reason=reason)
        for kind, reasons_by_file in reasons_by_kind.items()
        for file, reason in reasons_by_file.items()
    ]
    for group in campaign.groups:
        for test, sample in zip(name_samples(group.samples), group.samples, strict=True):
            issues += _list_sample_issues(group, test, sample)
        issues += _list_number_issues(group)
        if not group.samples and not group.notes:
            reason = group.band.reason or Reason("empty_group", "no sample in this group")
            sentence, code = wording.make_sentence(reason.message), reason.code
            issues.append(Issue(Kind.WARNING, group.name, (), "empty group", sentence, code=code))
        issues += _list_note_issues(group.name, (), group.notes)
    return tuple(sorted(issues, key=lambda issue: [*Kind].index(issue.kind)))


def _join_codes(reasons: Iterable[Reason]) -> str:
    """Join the codes of reasons with commas, each code once."""
    return ", ".join(dict.fromkeys(reason.code for reason in reasons))


SLIP_TREATMENTS = {
    SlipDecision.MARKED: "Marked only: the curve is unchanged.",
    SlipDecision.REPAIRED: "Repaired: the lost force is added to all later samples.",
    SlipDecision.CUT: "Cut: the curve ends before the slip.",
}
"""Sentence on the treatment of a slip, keyed by the decision on it."""


def _list_sample_issues(group: Group, test: str, sample: Sample) -> Iterator[Issue]:
    """Yield the issues of the results, slips and notes of the sample with the name `test`.

    A note is skipped if its code is that of a reason already reported for a result.
    """
    tests = (test,)
    results_by_reasons: dict[tuple[Kind, tuple[Reason, ...]], list[Result]] = {}
    for result in sample.results:
        kind = {Status.FAILED: Kind.FAILED, Status.DOUBTFUL: Kind.DOUBTFUL}.get(result.status)
        if kind is None and result.interval is None and result.reasons:
            kind = Kind.NO_INTERVAL
        if kind is not None:
            results_by_reasons.setdefault((kind, result.reasons), []).append(result)
    for (kind, reasons), results in results_by_reasons.items():
        names = tuple(result.name for result in results)
        labels = "; ".join(map(wording.format_label, names))
        reason, code = wording.join_sentences(reasons), _join_codes(reasons)
        yield Issue(kind, group.name, tests, labels, reason=reason, code=code, numbers=names)
    length, force = wording.get_scales(wording.get_display(group), "displacement", "force")
    for slip in sample.slips:
        position = wording.format_number(slip.position, slip.position_interval, length.factor)
        drop = wording.format_number(slip.drop, slip.drop_interval, force.factor)
        drop_text = f"{drop.value} {force.unit} ({drop.interval})"
        topic = f"{drop_text} lost at {position.value} {length.unit} ({position.interval})"
        yield Issue(Kind.SLIP, group.name, tests, topic, reason=SLIP_TREATMENTS[slip.decision])
    codes = {reason.code for _, reasons in results_by_reasons for reason in reasons}
    notes = [note for note in sample.quality if note.code not in codes]
    yield from _list_note_issues(group.name, tests, notes)


def _list_number_issues(group: Group) -> Iterator[Issue]:
    """Yield an issue for each outlier, and each value that a mean excludes and did not fail."""
    failed_results = {
        (test, result.name)
        for test, sample in zip(name_samples(group.samples), group.samples, strict=True)
        for result in sample.results
        if result.status is Status.FAILED
    }
    for number in group.numbers:
        label, names = wording.format_label(number.name), (number.name,)
        for test, reasons in number.exclusions.items():
            if (test, number.name) not in failed_results:
                reason, code = wording.join_sentences(reasons), _join_codes(reasons)
                yield Issue(Kind.LEFT_OUT, group.name, (test,), label, reason, code, numbers=names)
        scale = wording.choose_number_scale(group, number)
        for outlier in number.outliers:
            value_text = wording.format_number(outlier.value, None, scale.factor).value
            quantity, p_text = f"{value_text} {scale.unit}".strip(), f"(p = {outlier.p:.2g})"
            reason = f"{quantity} is an outlier by {outlier.method} {p_text}."
            tests = (outlier.sample,)
            yield Issue(Kind.OUTLIER, group.name, tests, label, reason=reason, numbers=names)


_REPEATED_NOTE_CODES = {"doubtful_in_mean", *(f"slip_{decision}" for decision in SlipDecision)}
"""Codes of notes without an issue, because slips and doubtful numbers have issues of their own."""


def _list_note_issues(
    group: str, tests: tuple[str, ...], notes: Iterable[QualityNote]
) -> Iterator[Issue]:
    """Yield one issue per combination of code and message in the notes.

    All notes which state that tests were processed differently are one issue.

    Parameters
    ----------
    group : name of the group
    tests : tuple of the name of the test with the notes; empty for notes on the group
    notes : notes; those of severity ``info`` or with a code in `_REPEATED_NOTE_CODES` are skipped
    """
    notes_by_code: dict[tuple[str, str], list[QualityNote]] = {}
    for note in notes:
        if note.severity is not Severity.INFO and note.code not in _REPEATED_NOTE_CODES:
            message = "" if note.code == PROTOCOLS_DIFFER else note.message
            notes_by_code.setdefault((note.code, message), []).append(note)
    for (code, _), members in notes_by_code.items():
        # The caller skips notes that explain a result; other warnings have no consequence.
        is_harmless = tests and members[0].severity is not Severity.ERROR
        kind = Kind.NOTE if is_harmless else Kind.WARNING
        sentences = dict.fromkeys(wording.make_sentence(note.message) for note in members)
        yield Issue(
            kind=Kind.PROCESSING if code == PROTOCOLS_DIFFER else kind,
            group=group,
            tests=tests or tuple(dict.fromkeys(test for note in members for test in note.tests)),
            topic="; ".join(wording.replace_names(note.where) for note in members),
            reason=" ".join(sentences),
            code=code,
        )


class Effect(NamedTuple):
    """Effect of a cause on the mean that it changes most.

    Parameters
    ----------
    size : shift of the mean, relative to half the width of its interval, or relative widening of
        the interval. It is infinite if no value is left, if the mean shifts and its interval has no
        width, and for unreadable tests; 10 if missing values leave one value; 5 if all averaged
        values are affected; otherwise 0 without an interval; 0 for rejected tests
    text : sentence on the effect, without a full stop
    """

    size: float
    text: str


@dataclass(frozen=True, slots=True)
class Cause:
    """Issues with a common cause.

    Parameters
    ----------
    issues : issues of one kind, at least one
    effect : largest effect on a mean; None before ranking, for notes, and if no mean is affected
    """

    issues: tuple[Issue, ...]
    effect: Effect | None = None

    @property
    def kind(self) -> Kind:
        """Kind of the issues."""
        return self.issues[0].kind

    @property
    def code(self) -> str:
        """Codes of the first issue, separated by commas; empty if this issue has none."""
        return self.issues[0].code

    @property
    def heading(self) -> str:
        """Name of the kind in one or two words."""
        names = {Kind.UNREADABLE: "Not read", Kind.PROCESSING: "Other processing"}
        names[Kind.SLIP] = "Slips"
        return names.get(self.kind, self.kind.name.capitalize().replace("_", " "))

    @property
    def subject(self) -> str:
        """Affected test or group, or the number of affected tests or groups."""
        groups = list(dict.fromkeys(issue.group for issue in self.issues))
        tests = {(issue.group, test) for issue in self.issues for test in issue.tests}
        if len(tests) == 1:
            ((group, test),) = tests
            return f"{test} ({group})" if group else test
        group_text = groups[0] if len(groups) == 1 else wording.format_count(len(groups), "group")
        if not tests:
            return group_text
        test_text = wording.format_count(len(tests), "test")
        return f"{test_text} {'of' if len(groups) == 1 else 'in'} {group_text}"

    @property
    def sentence(self) -> str:
        """First reason and the number of other reasons, or what was processed differently."""
        if self.kind is Kind.PROCESSING:
            topics = [topic for issue in self.issues for topic in issue.topic.split("; ")]
            text = ", ".join(dict.fromkeys(topics))
            return f"Processed differently from other tests of their group: {text}."
        reasons = list(dict.fromkeys(issue.reason for issue in self.issues))
        suffix = f" And {len(reasons) - 1} more." if len(reasons) > 1 else ""
        return f"{reasons[0]}{suffix}"


def find_causes(campaign: Campaign) -> tuple[list[Cause], list[Cause]]:
    """Group issues by cause and rank the causes by their largest effect on a mean.

    Parameters
    ----------
    campaign : content of the report

    Returns
    -------
    causes : causes in the order of decreasing effect; causes that affect no mean are last, and
        causes of equal effect are in the order of `Kind`
    notes : causes of the kind `Kind.NOTE`, without an effect, those with the most issues first
    """
    groups = {group.name: group for group in campaign.groups}
    causes, notes = [], []
    for cause in _group_by_cause(find_issues(campaign)):
        if cause.kind is Kind.NOTE:
            notes.append(cause)
        else:
            causes.append(replace(cause, effect=_find_effect(cause, groups)))
    causes.sort(key=lambda cause: -cause.effect.size if cause.effect else inf)
    return causes, sorted(notes, key=lambda note: len(note.issues), reverse=True)


def _group_by_cause(issues: Sequence[Issue]) -> list[Cause]:
    """Group issues of one kind that share a code, directly or through other issues.

    All slips are one cause. Any other issue without a code is a cause of its own. The order of the
    issues does not change the groups.
    """
    clusters: list[tuple[set[tuple[Kind, str]], list[int]]] = []
    for index, issue in enumerate(issues):
        code_text = "slip" if issue.kind is Kind.SLIP else issue.code
        keys, indices = {(issue.kind, code) for code in code_text.split(", ") if code}, [index]
        for cluster in [cluster for cluster in clusters if not keys.isdisjoint(cluster[0])]:
            clusters.remove(cluster)
            keys, indices = keys | cluster[0], indices + cluster[1]
        clusters.append((keys, sorted(indices)))
    clusters.sort(key=lambda cluster: cluster[1][0])
    return [Cause(tuple(issues[index] for index in indices)) for _, indices in clusters]


def _find_effect(cause: Cause, groups: Mapping[str, Group]) -> Effect | None:
    """Find the largest effect of a cause on a mean of any group; None if it affects no mean.

    Results that the rig imposes are ignored. Unreadable and rejected tests have fixed effects.
    """
    if cause.kind is Kind.UNREADABLE:
        return Effect(inf, format_sentence("report.effect_unreadable"))
    if cause.kind is Kind.REJECTED:
        return Effect(0.0, format_sentence("report.effect_rejected"))
    effects = []
    for group_name in dict.fromkeys(issue.group for issue in cause.issues):
        issues = [issue for issue in cause.issues if issue.group == group_name]
        for number in groups[group_name].numbers:
            tests = {
                test
                for issue in issues
                if not issue.numbers or number.name in issue.numbers
                for test in issue.tests
            }
            if not number.is_set_by_rig:
                effects.append(_compute_effect(groups[group_name], number, tests))
    return max(filter(None, effects), key=lambda effect: effect.size, default=None)


def _compute_effect(group: Group, number: GroupNumber, tests: set[str]) -> Effect | None:
    """Compute the effect of tests on the mean of a number; None if they do not affect the mean.

    If the mean excludes any of the tests, the effect is that of the excluded values. Otherwise, it
    is the shift of the mean when the values of the tests are left out.
    """
    single_value_size = 10.0  # `Effect.size` if one value is left, without an interval
    label, n = f"{wording.format_label(number.name)} of {group.name}", number.mean.chosen.n
    members, missing_tests = _get_members(group, number), tests & number.exclusions.keys()
    averaged_members = {members[test] for test in number.values}
    n_missing = len({members[test] for test in missing_tests} - averaged_members)
    if n_missing and not number.values:
        return Effect(inf, format_sentence("report.effect_no_value", number=label))
    if n_missing and n == 1:
        return Effect(single_value_size, format_sentence("report.effect_one_value", number=label))
    if n_missing:
        n_all = n + n_missing
        half_widths = [compute_t_quantile(count - 1) / sqrt(count) for count in (n, n_all)]
        width_ratio = half_widths[0] / half_widths[1]
        facts = {"n": n, "n_all": n_all, "number": label, "wider": width_ratio}
        return Effect(width_ratio - 1.0, format_sentence("report.effect_fewer_values", **facts))
    if missing_tests:  # other tests of their spools have values
        n_all = len(number.values) + len(missing_tests)
        facts = {"n": len(number.values), "n_all": n_all, "number": label}
        width_ratio = sqrt(n_all / len(number.values))
        return Effect(width_ratio - 1.0, format_sentence("report.effect_fewer_tests", **facts))
    included_tests = tests & number.values.keys()
    return _compute_shift(group, number, included_tests, label) if included_tests else None


def _get_members(group: Group, number: GroupNumber) -> dict[str, str]:
    """Return what the mean averages for each sample: the sample if pooled, otherwise its spool."""
    return {
        name: name if number.mean.is_pooled else sample.specimen.spool
        for name, sample in zip(name_samples(group.samples), group.samples, strict=True)
    }


def _compute_shift(group: Group, number: GroupNumber, tests: set[str], label: str) -> Effect:
    """Compute the shift of the mean of a number when the values of tests are left out.

    Parameters
    ----------
    group : group of the tests
    number : result of the group
    tests : names of the tests whose values are left out
    label : text that names the number and the group
    """
    all_values_size = 5.0  # `Effect.size` if all averaged values are affected
    members, values_by_member = _get_members(group, number), dict[str, list[float]]()
    for test, result in number.values.items():
        if test not in tests and result.value is not None:
            values_by_member.setdefault(members[test], []).append(result.value)
    if not values_by_member:
        return Effect(all_values_size, format_sentence("report.effect_all_values", number=label))
    value, half_width = number.mean.chosen.mean, number.mean.chosen.half_width
    new_value = float(np.mean([np.mean(values) for values in values_by_member.values()]))
    shift = 0.0 if isclose(new_value, value) else new_value - value
    percentage = f"{wording.format_percent(abs(shift / value))} " if value else ""
    text = f"{label} would be {percentage}{'higher' if shift > 0.0 else 'lower'}"
    text += " without this test" if len(tests) == 1 else " without these tests"
    if not half_width > 0.0 or isnan(shift):
        return Effect(inf if half_width == 0.0 and shift else 0.0, text)
    size = abs(shift) / half_width
    return Effect(size, f"{text}, {size:.2g} times half its interval")
