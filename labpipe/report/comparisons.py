"""Comparisons of groups that differ in one field alone, and the tables of differences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import nan

from labpipe.records.curve import Interval
from labpipe.records.group import Campaign, Difference, Group
from labpipe.records.harness_bundle import NONE
from labpipe.report.issues import join_sentences
from labpipe.report.page_tables import Cell, Table
from labpipe.report.wording import (
    find_display,
    find_display_unit,
    typeset_unit,
    write_heading,
    write_number,
)
from labpipe.statistics.group_fields import (
    BORE,
    SECTION_SIZES,
    find_varying_fields,
    make_field_sort_key,
)

MAX_COMPARED_GROUPS = 6
"""Groups in one figure: more curves could not be distinguished."""

_OF_BUNDLES = (
    "type", "spool", "composition", "wire", "number", "arrangement", "tape", "taping", "conduit",
    BORE,
)  # fmt: skip
"""Fields whose values are written without their names."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two groups and their compared numbers.

    Parameters
    ----------
    first, second : in the order of the differences
    differences : at least one
    """

    first: Group
    second: Group
    differences: tuple[Difference, ...]

    @property
    def field(self) -> str:
        """Return the one field in which they differ; empty for several or none."""
        return self.differences[0].single_field


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """Groups that all differ from each other in the same single field.

    Parameters
    ----------
    field : in which they differ
    groups : two to `MAX_COMPARED_GROUPS`, in order of the field
    """

    field: str
    groups: tuple[Group, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the value of the field of each group."""
        return tuple(group.fields.get(self.field, "not stated") for group in self.groups)


def list_single_field_pairs(campaign: Campaign) -> list[Pair]:
    """List the pairs of groups that differ in one field alone, in the order of the differences."""
    groups = {group.name: group for group in campaign.groups}
    pairs = groupby(
        (difference for difference in campaign.differences if difference.family),
        key=lambda difference: (difference.first, difference.second),
    )
    return [Pair(groups[one], groups[two], tuple(differences)) for (one, two), differences in pairs]


def list_multi_field_differences(campaign: Campaign) -> list[Difference]:
    """List the differences of groups that differ in several fields at once, or in none."""
    return [difference for difference in campaign.differences if not difference.family]


def find_families(campaign: Campaign) -> list[Family]:
    """Collect groups that all differ from each other in one single field.

    Parameters
    ----------
    campaign : with its differences

    Returns
    -------
    Families in the order of the comparisons. Each pair is in at least one family; a family of
    more than `MAX_COMPARED_GROUPS` groups is split, with its first group, the reference, in each
    part.
    """
    families: list[Family] = []
    for name, pairs in groupby(list_single_field_pairs(campaign), key=lambda pair: pair.field):
        linked = {(pair.first.name, pair.second.name): pair for pair in pairs}
        groups = {one.name: one for pair in linked.values() for one in (pair.first, pair.second)}
        sorted_groups = [groups[key] for key in _sort_names(groups, name)]
        families += [
            Family(name, part)
            for clique in _cliques(sorted_groups, set(linked))
            for part in _parts(clique)
        ]
    return families


def _sort_names(groups: Mapping[str, Group], field: str) -> list[str]:
    return sorted(
        groups, key=lambda name: make_field_sort_key(field, groups[name].fields.get(field, ""))
    )


def _cliques(groups: Sequence[Group], linked: set[tuple[str, str]]) -> Iterator[list[Group]]:
    """Collect large sets of linked groups greedily, so that each linked pair is in one of them."""
    both = linked | {(two, one) for one, two in linked}
    covered: set[tuple[str, str]] = set()
    for number, first in enumerate(groups):
        for second in groups[number + 1 :]:
            if (first.name, second.name) not in both - covered:
                continue
            members = [first, second]
            for other in groups:
                if other not in members and all((other.name, one.name) in both for one in members):
                    members.append(other)
            covered |= {(one.name, two.name) for one in members for two in members}
            yield [group for group in groups if group in members]


def _parts(groups: Sequence[Group]) -> Iterator[tuple[Group, ...]]:
    first, rest = groups[0], groups[1:]
    for start in range(0, len(rest), MAX_COMPARED_GROUPS - 1):
        yield first, *rest[start : start + MAX_COMPARED_GROUPS - 1]


def name_field(field: str) -> str:
    """Name a field in words, such as ``Taping``."""
    return field.replace("_", " ").capitalize()


def describe_pair(pair: Pair) -> str:
    """Describe the comparison of a pair.

    Parameters
    ----------
    pair : that differs in one field alone

    Returns
    -------
    Such as ``Taping: half-lap against none, all else equal (19 B2, corrugated-tube)``.
    """
    before, after = pair.differences[0].fields[pair.field]
    alike = describe_equal_fields((pair.first, pair.second), pair.field)
    return f"{name_field(pair.field)}: {after} against {before}, {alike}"


def describe_equal_fields(groups: Sequence[Group], field: str) -> str:
    """Describe the common fields of groups and the fields that vary within them."""
    varying = dict.fromkeys(
        name
        for group in groups
        for name in find_varying_fields(group)
        if name != field and not (name == "type" and "composition" in _field_names(group))
    )
    context = describe_context(groups, field)
    inside = f" ({context})" if context else ""
    if not varying:
        return f"all else equal{inside}"
    names = ", ".join(name.replace("_", " ") for name in varying)
    verb = "varies" if len(varying) == 1 else "vary"
    return f"all else equal{inside} but for {names}, which {verb} within the groups"


def _field_names(group: Group) -> set[str]:
    return {name for sample in group.samples for name in sample.specimen.fields}


def describe_context(groups: Sequence[Group], field: str) -> str:
    """List the common fields of groups, such as ``19 B2, half-lap PVC, corrugated-tube``.

    Sizes of the section are left out: the type or the conduit implies them.
    """
    alike = {
        name: word
        for name, word in groups[0].fields.items()
        if name != field and all(group.fields.get(name) == word for group in groups)
    }
    others = [
        f"{name.replace('_', ' ')} {word}"
        for name, word in alike.items()
        if name not in _OF_BUNDLES and name not in SECTION_SIZES
    ]
    if "composition" not in _field_names(groups[0]):
        return ", ".join(filter(None, [alike.get("type", ""), *others]))
    stated = {name: word for name, word in alike.items() if word != NONE}
    number = f"{stated['number']} wires" if "number" in stated else ""
    wires = stated.get("composition") or stated.get("wire") or number
    is_mixed = [group for group in groups if "&" in group.fields.get("wire", "")]
    arrangements = sorted({group.fields.get("arrangement", "") for group in is_mixed})
    tape = f"{stated.get('taping', '')} {stated.get('tape', '')}".strip()
    tape = "no tape" if alike.get("taping") == NONE else tape
    parts = (wires, *arrangements, tape, stated.get("conduit", ""), *others)
    return ", ".join(filter(None, parts))


_HEADS = ("Number", "Difference (95 %, corrected)", "Irrelevant below", "Verdict")


def make_pair_table(pair: Pair) -> Table:
    """Return the table of a pair that differs in one field alone.

    Parameters
    ----------
    pair : its comparison is the title

    Returns
    -------
    A row per number; caveats against the comparison are below the table.
    """
    rows = tuple(_row(difference, find_display(pair.first)) for difference in pair.differences)
    caveats = dict.fromkeys(
        caveat for difference in pair.differences for caveat in difference.caveats
    )
    return Table(describe_pair(pair), _HEADS, rows, tuple(f"{caveat}." for caveat in caveats))


def make_answer_cells(pair: Pair) -> tuple[Cell, ...]:
    """Return comparison, verdict, difference and counts of a pair for its first main number.

    Parameters
    ----------
    pair : that differs in one field alone
    """
    difference = pair.differences[0]
    before, after = difference.fields[pair.field]
    alike = describe_context((pair.first, pair.second), pair.field)
    shift = _difference_words(difference, find_display(pair.first))
    return (
        Cell(f"{name_field(pair.field)}: {after} against {before}", alike),
        Cell(str(difference.verdict).upper(), difference.verdict_reason),
        Cell(f"{write_heading(difference.name, '1')} {shift}"),
        Cell(" v ".join(_count(group, difference.name) for group in (pair.second, pair.first))),
    )


def _count(group: Group, name: str) -> str:
    """Return the number of values of a mean."""
    mean = next((number.mean for number in group.numbers if number.name == name), None)
    return "0" if mean is None else str(mean.chosen.n)


def _difference_words(difference: Difference, display: Mapping[str, str]) -> str:
    """Write a difference and its corrected interval, or why it has none, in percent or its unit."""
    max_shown_ratio = 10.0  # +1000 %: ends beyond it are "more than"
    is_beyond = False
    if difference.share is None:
        display_unit = find_display_unit(difference.name, difference.unit, display)
        shift = difference.difference
        number = write_number(
            shift.mean, difference.interval, display_unit.factor, estimate=shift.distinct_estimate
        )
        unit = f" {typeset_unit(display_unit.unit)}".rstrip()
    else:
        ends = difference.interval
        if ends is not None and ends.upper > max_shown_ratio:
            ends = Interval(min(ends.lower, max_shown_ratio), max_shown_ratio, ends.level)
            is_beyond = True
        number, unit = write_number(difference.share, ends, 100.0), " %"
    lower, upper = (f"{_signed(end)}{unit}" if end else "" for end in (number.lower, number.upper))
    behind = join_sentences([difference.difference.reason])
    if lower:
        behind = f"({lower} to {'more than ' if is_beyond else ''}{upper})"
    return f"{_signed(number.value)}{unit} {behind}".strip()


def _signed(number: str) -> str:
    """Write a plus before a positive difference."""
    return number if number.startswith(("-", "\u2013", "0")) else f"+{number}"


def _row(difference: Difference, display: Mapping[str, str]) -> tuple[Cell, ...]:
    display_unit = find_display_unit(difference.name, difference.unit, display)
    margin = nan if difference.margin is None else difference.margin
    return (
        Cell(write_heading(difference.name, display_unit.unit)),
        Cell(_difference_words(difference, display)),
        Cell(write_number(margin, None, display_unit.factor, digits=3).value),
        Cell(str(difference.verdict)),
    )


def describe_fields(difference: Difference) -> str:
    """List the differing fields of two groups, such as ``taping: half-lap against none``."""
    return "; ".join(
        f"{name.replace('_', ' ')}: {after} against {before}"
        for name, (before, after) in difference.fields.items()
    )


def list_pair_remarks(campaign: Campaign) -> list[str]:
    """Describe the pairs that the page does not show."""
    lines = []
    if campaign.compared:
        name = campaign.compared.replace("_", " ")
        if not campaign.differences:
            lines.append(f"No two groups differ in {name} alone.")
        lines.append(
            f"Only pairs of groups that differ in {name} alone are shown (--compare"
            f" {campaign.compared}); {_count_pairs(campaign.pairs_not_shown)} left out."
        )
    multi_field = list_multi_field_differences(campaign)
    if multi_field:
        count = len({(difference.first, difference.second) for difference in multi_field})
        lines.append(
            f"{_count_pairs(count)} not judged because the groups differ in several fields at once:"
            " see the sheet 'comparisons' of tables.xlsx."
        )
    return lines


def _count_pairs(count: int) -> str:
    return f"{count} pair{'s are' if count != 1 else ' is'}"
