"""What needs a look, as a lab head reads it: a line per cause, largest effect on a number first.

One camera that loses markers in thirty tests is one cause, not two hundred entries. How much it
matters is said by the number that it moves most: where its mean would be without the tests that the
cause touches.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import inf, isnan, sqrt

import numpy as np

from labpipe.records.group import Campaign, Group, GroupNumber
from labpipe.report.issues import Issue, Kind, find_issues
from labpipe.report.wording import count_of, in_words
from labpipe.statistics.means import t_quantile

_ALL, _NO_INTERVAL = 5.0, 10.0
"""Effects, in half intervals, of what touches all values of a number, and of what leaves one."""


@dataclass(frozen=True, slots=True)
class Effect:
    """What a cause does to the number that it moves most.

    Parameters
    ----------
    size : in half widths of the interval of that number; infinite where nothing is left of it
    words : a clause
    """

    size: float
    words: str


@dataclass(frozen=True, slots=True)
class Cause:
    """One line of what needs a look.

    Parameters
    ----------
    kind : what is wrong
    code : of the first; empty where there is none
    concerns : all that share the cause, at least one
    effect : None where it is not known
    """

    kind: Kind
    code: str
    concerns: tuple[Issue, ...]
    effect: Effect | None

    @property
    def subject(self) -> str:
        """Which test or group, or how many."""
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
        """The reason; of several the first one, and how many more there are."""
        if self.kind is Kind.UNLIKE:
            places = dict.fromkeys(
                place for concern in self.concerns for place in concern.what.split("; ")
            )
            return f"Processed otherwise than the other tests of their group: {', '.join(places)}."
        reasons = list(dict.fromkeys(concern.reason for concern in self.concerns))
        more = f" And {len(reasons) - 1} more." if len(reasons) > 1 else ""
        return f"{reasons[0]}{more}"


def find_causes(campaign: Campaign) -> list[Cause]:
    """Put together what has one cause, and rank it by its effect on a number.

    Parameters
    ----------
    campaign : all of it

    Returns
    -------
    Largest effect first, those of unknown effect last, and in the order of `Kind` among equals.
    Notes of which nothing follows are not among them (`find_notes`).
    """
    concerns = [concern for concern in find_issues(campaign) if concern.kind is not Kind.NOTE]
    groups = {group.name: group for group in campaign.groups}
    causes = [
        Cause(own[0].kind, own[0].code, tuple(own), _effect(own, groups))
        for own in _together(concerns)
    ]
    return sorted(
        causes, key=lambda cause: -inf if cause.effect is None else cause.effect.size, reverse=True
    )


def find_notes(campaign: Campaign) -> list[Cause]:
    """Put together the notes of which nothing follows, those of most tests first.

    Parameters
    ----------
    campaign : all of it
    """
    notes = [concern for concern in find_issues(campaign) if concern.kind is Kind.NOTE]
    causes = [Cause(own[0].kind, own[0].code, tuple(own), None) for own in _together(notes)]
    return sorted(causes, key=lambda cause: len(cause.concerns), reverse=True)


def _together(concerns: Iterable[Issue]) -> list[list[Issue]]:
    """Concerns of one kind that share a code; without a code, slips together and all else alone."""
    found: list[tuple[Kind, set[str], list[Issue]]] = []
    for concern in concerns:
        codes = (
            {Kind.SLIP}
            if concern.kind is Kind.SLIP
            else set(filter(None, concern.code.split(", ")))
        )
        for kind, known, own in found:
            if kind is concern.kind and codes & known:
                known.update(codes)
                own.append(concern)
                break
        else:
            found.append((concern.kind, set(codes), [concern]))
    return [own for _, _, own in found]


def _effect(concerns: Sequence[Issue], groups: dict[str, Group]) -> Effect | None:
    if concerns[0].kind is Kind.UNREADABLE:
        return Effect(inf, "the test is missing from all numbers")
    if concerns[0].kind is Kind.REJECTED:
        return Effect(0.0, "in no mean, as was decided")
    effects = [
        effect
        for name, own in _by_group(concerns).items()
        if name in groups
        for effect in _in_group(groups[name], own)
    ]
    return max(effects, key=lambda effect: effect.size, default=None)


def _by_group(concerns: Iterable[Issue]) -> dict[str, list[Issue]]:
    found: dict[str, list[Issue]] = {}
    for concern in concerns:
        found.setdefault(concern.group, []).append(concern)
    return found


def _in_group(group: Group, concerns: Sequence[Issue]) -> Iterator[Effect]:
    """Effects on the numbers of a group, each of all tests that the cause touches."""
    for number in group.numbers:
        tests = {
            test
            for concern in concerns
            if not concern.numbers or number.name in concern.numbers
            for test in (concern.test, *concern.tests)
            if test
        }
        if tests and not number.is_set_by_rig:
            effect = _lost(group, number, tests) or _moved(group, number, tests)
            if effect is not None:
                yield effect


def _lost(group: Group, number: GroupNumber, tests: set[str]) -> Effect | None:
    """What a number loses by tests that do not enter its mean."""
    lost = len(tests & number.left_out.keys())
    if not lost:
        return None
    name = f"{in_words(number.name)} of {group.name}"
    if number.mean is None:
        return Effect(inf, f"no value of {name}")
    n = number.mean.chosen.n
    if n == 1:
        return Effect(_NO_INTERVAL, f"{name} over one value, without an interval")
    wider = _width(n) / _width(n + lost)
    said = f"{name} over {n} of {n + lost} values, its interval about {wider:.1f} times as wide"
    return Effect(wider - 1.0, said)


def _width(n: int) -> float:
    return t_quantile(n - 1) / sqrt(n)


def _moved(group: Group, number: GroupNumber, tests: set[str]) -> Effect | None:
    """How far a mean would move without the tests."""
    touched = tests & number.values.keys()
    mean = number.mean
    if not touched or mean is None:
        return None
    name = f"{in_words(number.name)} of {group.name}"
    spools = {sample.test: sample.specimen.spool for sample in group.samples}
    kept: dict[str, list[float]] = {}
    for test, result in number.values.items():
        if test not in touched and result.value is not None:
            kept.setdefault("" if mean.is_pooled else spools.get(test, ""), []).append(result.value)
    if not kept:
        return Effect(_ALL, f"all values of {name}")
    before, half = mean.chosen.mean, mean.chosen.half
    moved = float(np.mean([np.mean(own) for own in kept.values()])) - before
    without = f"without {'it' if len(touched) == 1 else 'them'}, {name} would be"
    share = f"{100.0 * abs(moved / before):.2g} %" if before else "otherwise"
    way = "higher" if moved > 0.0 else "lower"
    size = abs(moved) / half if half > 0.0 else 0.0
    if isnan(half) or isnan(size):
        return Effect(0.0, f"{without} {share} {way}")
    return Effect(size, f"{without} {share} {way}, {size:.2g} of half its interval")
