"""Ranked issues: a line per cause, largest effect on a number first.

One camera that loses markers in thirty tests is one cause, not two hundred entries. Its effect is
that on the number that changes most: the shift of its mean without the affected tests.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import inf, isnan, sqrt

import numpy as np

from labpipe.records.group import Campaign, Group, GroupNumber
from labpipe.report.issues import Issue, Kind, find_issues
from labpipe.report.wording import as_label, count_of
from labpipe.statistics.means import t_quantile

_ALL_VALUES_EFFECT = 5.0
"""Effect, in half intervals, of a cause that affects all values of a number."""
_NO_INTERVAL_EFFECT = 10.0
"""Effect, in half intervals, of a cause that leaves one value, without an interval."""


@dataclass(frozen=True, slots=True)
class Effect:
    """Effect of a cause on the number that it changes most.

    Parameters
    ----------
    size : in half widths of the interval of that number; infinite if no value is left
    text : a clause
    """

    size: float
    text: str


@dataclass(frozen=True, slots=True)
class Cause:
    """Issues with one cause.

    Parameters
    ----------
    kind : what is wrong
    code : of the first issue, may be empty
    concerns : issues with this cause, at least one
    effect : None if unknown
    """

    kind: Kind
    code: str
    concerns: tuple[Issue, ...]
    effect: Effect | None

    @property
    def subject(self) -> str:
        """Test or group, or their number."""
        groups = list(dict.fromkeys(concern.group for concern in self.concerns))
        tests = dict.fromkeys(
            (concern.group, test)
            for concern in self.concerns
            for test in (concern.test, *concern.tests)
            if test
        )
        if len(tests) == 1:
            ((group, test),) = tests
            return f"{test} ({group})" if group else test
        where = groups[0] if len(groups) == 1 else count_of(len(groups), "group")
        if not tests:
            return where
        return f"{count_of(len(tests), 'test')} {'of' if len(groups) == 1 else 'in'} {where}"

    @property
    def sentence(self) -> str:
        """The first reason, and the number of further ones."""
        if self.kind is Kind.UNLIKE:
            places = dict.fromkeys(
                place for concern in self.concerns for place in concern.what.split("; ")
            )
            return f"Processed differently from other tests of their group: {', '.join(places)}."
        reasons = list(dict.fromkeys(concern.reason for concern in self.concerns))
        more = f" And {len(reasons) - 1} more." if len(reasons) > 1 else ""
        return f"{reasons[0]}{more}"


def find_causes(campaign: Campaign) -> list[Cause]:
    """Group issues by cause and rank them by their effect on a number.

    Parameters
    ----------
    campaign : all of it

    Returns
    -------
    Causes by decreasing effect, those of unknown effect last, equal ones in the order of `Kind`.
    Notes without consequences are not included (`find_notes`).
    """
    concerns = [concern for concern in find_issues(campaign) if concern.kind is not Kind.NOTE]
    groups = {group.name: group for group in campaign.groups}
    causes = [
        Cause(related[0].kind, related[0].code, tuple(related), _effect(related, groups))
        for related in _cluster_concerns(concerns)
    ]
    return sorted(
        causes, key=lambda cause: -inf if cause.effect is None else cause.effect.size, reverse=True
    )


def find_notes(campaign: Campaign) -> list[Cause]:
    """Group the notes without consequences, those of most tests first.

    Parameters
    ----------
    campaign : all of it
    """
    notes = [concern for concern in find_issues(campaign) if concern.kind is Kind.NOTE]
    causes = [
        Cause(same[0].kind, same[0].code, tuple(same), None) for same in _cluster_concerns(notes)
    ]
    return sorted(causes, key=lambda cause: len(cause.concerns), reverse=True)


def _cluster_concerns(concerns: Iterable[Issue]) -> list[list[Issue]]:
    """Cluster concerns of one kind that share a code; slips share one cluster."""
    clusters: list[tuple[Kind, set[str], list[Issue]]] = []
    for concern in concerns:
        codes = (
            {Kind.SLIP}
            if concern.kind is Kind.SLIP
            else set(filter(None, concern.code.split(", ")))
        )
        for kind, cluster_codes, related in clusters:
            if kind is concern.kind and codes & cluster_codes:
                cluster_codes.update(codes)
                related.append(concern)
                break
        else:
            clusters.append((concern.kind, set(codes), [concern]))
    return [related for _, _, related in clusters]


def _effect(concerns: Sequence[Issue], groups: dict[str, Group]) -> Effect | None:
    if concerns[0].kind is Kind.UNREADABLE:
        return Effect(inf, "the test is missing from all numbers")
    if concerns[0].kind is Kind.REJECTED:
        return Effect(0.0, "not in any mean, by decision")
    effects = [
        effect
        for name, group_concerns in _by_group(concerns).items()
        if name in groups
        for effect in _group_effects(groups[name], group_concerns)
    ]
    return max(effects, key=lambda effect: effect.size, default=None)


def _by_group(concerns: Iterable[Issue]) -> dict[str, list[Issue]]:
    concerns_by_group: dict[str, list[Issue]] = {}
    for concern in concerns:
        concerns_by_group.setdefault(concern.group, []).append(concern)
    return concerns_by_group


def _group_effects(group: Group, concerns: Sequence[Issue]) -> Iterator[Effect]:
    """Yield the effects of all affected tests on the numbers of a group."""
    for number in group.numbers:
        tests = {
            test
            for concern in concerns
            if not concern.numbers or number.name in concern.numbers
            for test in (concern.test, *concern.tests)
            if test
        }
        if tests and not number.is_set_by_rig:
            effect = _excluded_effect(group, number, tests) or _shift_effect(group, number, tests)
            if effect is not None:
                yield effect


def _excluded_effect(group: Group, number: GroupNumber, tests: set[str]) -> Effect | None:
    """Return the effect of tests that do not enter the mean of a number."""
    lost = len(tests & number.left_out.keys())
    if not lost:
        return None
    name = f"{as_label(number.name)} of {group.name}"
    if number.mean is None:
        return Effect(inf, f"no value of {name}")
    n = number.mean.chosen.n
    if n == 1:
        return Effect(_NO_INTERVAL_EFFECT, f"one value of {name}, without an interval")
    wider = _relative_width(n) / _relative_width(n + lost)
    text = f"mean of {n} of {n + lost} values of {name}, interval about {wider:.1f} times as wide"
    return Effect(wider - 1.0, text)


def _relative_width(n: int) -> float:
    return t_quantile(n - 1) / sqrt(n)


def _shift_effect(group: Group, number: GroupNumber, tests: set[str]) -> Effect | None:
    """Return the shift of a mean without the tests."""
    touched = tests & number.values.keys()
    mean = number.mean
    if not touched or mean is None:
        return None
    name = f"{as_label(number.name)} of {group.name}"
    spools = {sample.test: sample.specimen.spool for sample in group.samples}
    remaining: dict[str, list[float]] = {}
    for test, result in number.values.items():
        if test not in touched and result.value is not None:
            spool = "" if mean.is_pooled else spools.get(test, "")
            remaining.setdefault(spool, []).append(result.value)
    if not remaining:
        return Effect(_ALL_VALUES_EFFECT, f"all values of {name}")
    before, half = mean.chosen.mean, mean.chosen.half
    moved = float(np.mean([np.mean(values) for values in remaining.values()])) - before
    without = f"without {'it' if len(touched) == 1 else 'them'}, {name} would be"
    share = f"{100.0 * abs(moved / before):.2g} % " if before else ""
    way = "higher" if moved > 0.0 else "lower"
    size = abs(moved) / half if half > 0.0 else 0.0
    if isnan(half) or isnan(size):
        return Effect(0.0, f"{without} {share}{way}")
    return Effect(size, f"{without} {share}{way}, {size:.2g} times half its interval")
