"""How the groups of a report differ, pair by pair; pairs that answer a question come first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from labpipe.pipeline.settings import Settings, settings_by_test, unlike_words
from labpipe.protocol.rig import Groups
from labpipe.records.group import Difference, Group
from labpipe.statistics.group_fields import differing_fields, in_order
from labpipe.statistics.groups import compare_groups

_ORDER = ("wire", "number", "composition", "arrangement", "taping", "tape", "conduit")
"""Questions in the order of a report; any others follow."""


@dataclass(frozen=True, slots=True)
class Differences:
    """Differences that a report shows.

    Parameters
    ----------
    shown : pair by pair
    pairs_not_shown : of groups, that differ otherwise than was asked for
    """

    shown: tuple[Difference, ...]
    pairs_not_shown: int = 0


def find_differences(
    groups: Sequence[Group],
    wishes: Mapping[str, Groups],
    settings: Mapping[str, Settings],
    *,
    by: Sequence[str],
    alone: str = "",
) -> Differences:
    """Compare groups of one protocol in the numbers that the protocol calls main.

    Parameters
    ----------
    groups : of the report
    wishes : what each protocol says of groups
    settings : by file, what its test was processed with
    by : fields that the groups were made by
    alone : show only pairs that differ in this field and no other; empty for all

    Returns
    -------
    First the pairs that differ in one field, question by question. In those the group that has
    less of it is the first: none before half-lap, 7 before 12.
    """
    pairs = [
        found
        for one, other in combinations(groups, 2)
        if one.protocol == other.protocol
        and (found := _compared(one, other, wishes[one.protocol], settings, by))
    ]
    shown = [pair for pair in pairs if not alone or list(pair[0].fields) == [alone]]
    flat = [each for pair in sorted(shown, key=_question_first) for each in pair]
    return Differences(tuple(flat), len(pairs) - len(shown))


def _question_first(pair: Sequence[Difference]) -> tuple[int, str]:
    question = pair[0].question
    if not question:
        return len(_ORDER) + 1, ""
    return (_ORDER.index(question), "") if question in _ORDER else (len(_ORDER), question)


def _compared(
    one: Group,
    other: Group,
    said: Groups,
    settings: Mapping[str, Settings],
    by: Sequence[str],
) -> list[Difference]:
    """Differences of a pair, with what they answer and what speaks against comparing it."""
    fields = differing_fields(one, other, by)
    if len(fields) == 1 and _is_backwards(fields):
        one, other = other, one
        fields = {name: (after, before) for name, (before, after) in fields.items()}
    unlike = unlike_words(settings_by_test((*one.samples, *other.samples), settings))
    compared = compare_groups(one, other, names=said.main, margin=said.margin)
    return [replace(each, caveats=(*each.caveats, *unlike), fields=fields) for each in compared]


def _is_backwards(fields: Mapping[str, tuple[str, str]]) -> bool:
    ((name, (before, after)),) = fields.items()
    return name != "type" and in_order(name, after) < in_order(name, before)
