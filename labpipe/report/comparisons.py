"""Questions that groups answer which differ in one field alone, and the tables of differences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import nan

from labpipe.records.curve import Interval
from labpipe.records.group import Campaign, Difference, Group
from labpipe.records.harness_bundle import NONE
from labpipe.report.group_tables import Cell, Table
from labpipe.report.issues import sentences
from labpipe.report.wording import (
    Written,
    display_of,
    heading,
    shown_in,
    unit_words,
    write_number,
)
from labpipe.statistics.group_fields import BORE, OF_SECTION, in_order, varying_fields

MOST_TOGETHER = 6
"""Groups that are compared in one figure: more curves could not be told apart."""
_MOST_SHARE = 10.0
"""End of an interval beyond which it says nothing of interest: +1000 %."""

_OF_BUNDLES = (
    "type", "spool", "composition", "wire", "number", "arrangement", "tape", "taping", "conduit",
    BORE,
)  # fmt: skip
"""Fields whose words have a place of their own; any other stands with its name."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two groups and all that was compared of them.

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
        """The one field that they differ in; empty for several or none."""
        return self.differences[0].question


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """Groups of which any two differ in one field alone, and in the same.

    Parameters
    ----------
    field : that they differ in
    groups : two at least, `MOST_TOGETHER` at the most, in order of the field
    """

    field: str
    groups: tuple[Group, ...]

    @property
    def words(self) -> tuple[str, ...]:
        """Word of the field, group by group."""
        return tuple(group.fields.get(self.field, "not said") for group in self.groups)


def answering_pairs(campaign: Campaign) -> list[Pair]:
    """List the pairs of groups that differ in one field alone, in the order of the differences."""
    groups = {group.name: group for group in campaign.groups}
    pairs = groupby(
        (difference for difference in campaign.differences if difference.family),
        key=lambda difference: (difference.first, difference.second),
    )
    return [Pair(groups[one], groups[two], tuple(each)) for (one, two), each in pairs]


def not_asked(campaign: Campaign) -> list[Difference]:
    """List the differences of groups that differ in several fields at once, or in none."""
    return [difference for difference in campaign.differences if not difference.family]


def families(campaign: Campaign) -> list[Family]:
    """Put groups together of which any two differ in one field alone.

    Parameters
    ----------
    campaign : with its differences

    Returns
    -------
    In the order of the questions. Each pair is in one family at least; a family of more than
    `MOST_TOGETHER` groups is cut, and the first group, to which the others are compared, stands in
    each part.
    """
    families: list[Family] = []
    for name, pairs in groupby(answering_pairs(campaign), key=lambda pair: pair.field):
        linked = {(pair.first.name, pair.second.name): pair for pair in pairs}
        groups = {each.name: each for pair in linked.values() for each in (pair.first, pair.second)}
        whole = [groups[key] for key in _by_word(groups, name)]
        families += [
            Family(name, part) for clique in _cliques(whole, set(linked)) for part in _parts(clique)
        ]
    return families


def _by_word(groups: Mapping[str, Group], field: str) -> list[str]:
    return sorted(groups, key=lambda name: in_order(field, groups[name].fields.get(field, "")))


def _cliques(groups: Sequence[Group], linked: set[tuple[str, str]]) -> Iterator[list[Group]]:
    """Largest sets, greedily: every pair that is linked is in one of them."""
    both = linked | {(two, one) for one, two in linked}
    covered: set[tuple[str, str]] = set()
    for at, first in enumerate(groups):
        for second in groups[at + 1 :]:
            if (first.name, second.name) not in both - covered:
                continue
            members = [first, second]
            for other in groups:
                if other not in members and all((other.name, own.name) in both for own in members):
                    members.append(other)
            covered |= {(one.name, two.name) for one in members for two in members}
            yield [group for group in groups if group in members]


def _parts(groups: Sequence[Group]) -> Iterator[tuple[Group, ...]]:
    first, rest = groups[0], groups[1:]
    for start in range(0, len(rest), MOST_TOGETHER - 1):
        yield first, *rest[start : start + MOST_TOGETHER - 1]


def field_words(field: str) -> str:
    """Name of a field in words, such as ``Taping``."""
    return field.replace("_", " ").capitalize()


def question_words(pair: Pair) -> str:
    """Word the question that a pair answers.

    Parameters
    ----------
    pair : that differs in one field alone

    Returns
    -------
    Such as ``Taping: half-lap against none, all else equal (19 B2, corrugated-tube)``.
    """
    before, after = pair.differences[0].fields[pair.field]
    groups = (pair.first, pair.second)
    return f"{field_words(pair.field)}: {after} against {before}, {equal_words(groups, pair.field)}"


def equal_words(groups: Sequence[Group], field: str) -> str:
    """Say what groups have alike beside a field, and what varies within them."""
    varying = dict.fromkeys(
        name
        for group in groups
        for name in varying_fields(group)
        if name != field and not (name == "type" and "composition" in _said(group))
    )
    words = context_words(groups, field)
    inside = f" ({words})" if words else ""
    if not varying:
        return f"all else equal{inside}"
    names = ", ".join(name.replace("_", " ") for name in varying)
    verb = "varies" if len(varying) == 1 else "vary"
    return f"all else equal{inside} but for {names}, which {verb} within the groups"


def _said(group: Group) -> set[str]:
    return {name for sample in group.samples for name in sample.specimen.fields}


def context_words(groups: Sequence[Group], field: str) -> str:
    """List what groups have alike, such as ``19 B2, half-lap PVC, corrugated-tube``.

    Sizes of the section are left out: they come with the type, or with the conduit.
    """
    first = groups[0].fields
    alike = {
        name: word
        for name, word in first.items()
        if name != field and all(group.fields.get(name) == word for group in groups)
    }
    own = [
        f"{name.replace('_', ' ')} {word}"
        for name, word in alike.items()
        if name not in _OF_BUNDLES and name not in OF_SECTION
    ]
    if "composition" not in _said(groups[0]):
        return ", ".join(filter(None, [alike.get("type", ""), *own]))
    spread = {group.fields.get("arrangement", "") for group in groups if _is_mixed(group)}
    parts = [*_made_of(alike), *sorted(spread), _taped(alike), _in_conduit(alike), *own]
    return ", ".join(filter(None, parts))


def _is_mixed(group: Group) -> bool:
    return "&" in group.fields.get("wire", "")


def _made_of(alike: Mapping[str, str]) -> list[str]:
    """Wires, or how many there are."""
    wires = [alike["composition"]] if "composition" in alike else []
    if not wires and "wire" in alike:
        wires = [alike["wire"]]
    if not wires and "number" in alike:
        wires = [f"{alike['number']} wires"]
    return wires


def _taped(alike: Mapping[str, str]) -> str:
    if alike.get("taping") == NONE:
        return "no tape"
    words = (alike.get(name, "") for name in ("taping", "tape"))
    return " ".join(word for word in words if word not in {"", NONE})


def _in_conduit(alike: Mapping[str, str]) -> str:
    word = alike.get("conduit", "")
    return "" if word == NONE else word


_HEADS = ("Number", "Difference (95 %, corrected)", "Does not matter below", "Verdict")


def question_table(pair: Pair) -> Table:
    """Make the table of a pair that differs in one field alone.

    Parameters
    ----------
    pair : its field heads the table as a question

    Returns
    -------
    A row per number. What speaks against comparing stands once, below the table.
    """
    rows = tuple(_row(difference, display_of(pair.first)) for difference in pair.differences)
    caveats = dict.fromkeys(
        caveat for difference in pair.differences for caveat in difference.caveats
    )
    return Table(question_words(pair), _HEADS, rows, tuple(f"{caveat}." for caveat in caveats))


def answer_cells(pair: Pair) -> tuple[Cell, ...]:
    """Say what a pair answers by its first main number: question, verdict, difference, counts.

    Parameters
    ----------
    pair : that differs in one field alone
    """
    asked = pair.differences[0]
    before, after = asked.fields[pair.field]
    alike = context_words((pair.first, pair.second), pair.field)
    written = _written(asked, display_of(pair.first))
    ends = f"({written.interval})" if written.interval else sentences([asked.difference.reason])
    return (
        Cell(f"{field_words(pair.field)}: {after} against {before}", alike),
        Cell(str(asked.verdict).upper(), asked.why),
        Cell(f"{heading(asked.name, '1')} {written.value} {ends}".strip()),
        Cell(" v ".join(str(_count(each, asked.name)) for each in (pair.second, pair.first))),
    )


def _count(group: Group, name: str) -> int:
    """How many values are behind the mean of a number."""
    mean = next((number.mean for number in group.numbers if number.name == name), None)
    return 0 if mean is None else mean.chosen.n


def _written(difference: Difference, display: Mapping[str, str]) -> Written:
    """A difference and its corrected interval: in percent, or in its unit."""
    is_beyond = False
    if difference.share is None:
        shown = shown_in(difference.name, difference.unit, display)
        found = difference.difference
        given = write_number(found.mean, difference.interval, shown.factor, apart=found.apart)
        unit = f" {unit_words(shown.unit)}".rstrip()
    else:
        ends = difference.interval
        if ends is not None and ends.upper > _MOST_SHARE:
            ends = Interval(min(ends.lower, _MOST_SHARE), _MOST_SHARE, ends.level)
            is_beyond = True
        given, unit = write_number(difference.share, ends, 100.0), " %"
    lower, upper = (f"{_signed(end)}{unit}" if end else "" for end in (given.lower, given.upper))
    upper = f"more than {upper}" if is_beyond else upper
    return Written(f"{_signed(given.value)}{unit}", lower, upper)


def _signed(number: str) -> str:
    """Write a plus where a difference is up."""
    return number if number.startswith(("-", "\u2013", "0")) else f"+{number}"


def _row(difference: Difference, display: Mapping[str, str]) -> tuple[Cell, ...]:
    shown = shown_in(difference.name, difference.unit, display)
    written = _written(difference, display)
    ends = (
        f"({written.interval})" if written.interval else sentences([difference.difference.reason])
    )
    margin = nan if difference.margin is None else difference.margin
    matters = write_number(margin, None, shown.factor, digits=3).value
    return (
        Cell(heading(difference.name, shown.unit)),
        Cell(f"{written.value} {ends}".strip()),
        Cell(matters),
        Cell(str(difference.verdict)),
    )


def fields_in_words(difference: Difference) -> str:
    """List the fields that two groups differ in, such as ``taping: half-lap against none``."""
    return "; ".join(
        f"{name.replace('_', ' ')}: {after} against {before}"
        for name, (before, after) in difference.fields.items()
    )


def remarks_on_pairs(campaign: Campaign) -> list[str]:
    """Say which pairs the page does not show, and where they are."""
    said = []
    if campaign.compared:
        name = campaign.compared.replace("_", " ")
        if not campaign.differences:
            said.append(f"No two groups differ in {name} alone.")
        said.append(
            f"Only pairs of groups that differ in {name} alone are shown (--compare"
            f" {campaign.compared}); {_pairs(campaign.pairs_not_shown)} left out."
        )
    several = not_asked(campaign)
    if several:
        count = len({(each.first, each.second) for each in several})
        said.append(
            f"{_pairs(count)} not judged, as the groups differ in several fields at once, which"
            " answers no question: see the sheet 'comparisons' of tables.xlsx."
        )
    return said


def _pairs(count: int) -> str:
    return f"{count} pair{'s are' if count != 1 else ' is'}"
