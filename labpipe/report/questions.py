"""Questions that groups answer which differ in one field alone, and the tables of differences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from math import nan

from labpipe.records.group import Campaign, Difference, Group
from labpipe.records.harness_bundle import NONE
from labpipe.report.concerns import sentences
from labpipe.report.group_tables import DASH, Cell, Table
from labpipe.report.wording import display_of, heading, shown_in, write_number
from labpipe.statistics.group_fields import BORE, in_order, varying_fields

MOST_TOGETHER = 6
"""Groups that are compared in one figure: more curves could not be told apart."""
FEW_ROWS = 10
"""Rows of pairs that differ in several fields, up to which the page shows them."""

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
        (each for each in campaign.differences if each.question),
        key=lambda each: (each.first, each.second),
    )
    return [Pair(groups[one], groups[two], tuple(each)) for (one, two), each in pairs]


def several_fields(campaign: Campaign) -> list[Difference]:
    """List the differences of bundles and the like that differ in several fields at once."""
    return [each for each in campaign.differences if len(each.fields) > 1 and not _is_plain(each)]


def plain(campaign: Campaign) -> list[Difference]:
    """List the differences of specimens of two types, and of groups that no sheet tells apart."""
    return [each for each in campaign.differences if _is_plain(each)]


def _is_plain(difference: Difference) -> bool:
    return not difference.fields or "type" in difference.fields


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
    found: list[Family] = []
    for name, pairs in groupby(answering_pairs(campaign), key=lambda pair: pair.field):
        linked = {(pair.first.name, pair.second.name): pair for pair in pairs}
        groups = {each.name: each for pair in linked.values() for each in (pair.first, pair.second)}
        whole = [groups[each] for each in _by_word(groups, name)]
        found += [
            Family(name, part) for clique in _cliques(whole, set(linked)) for part in _parts(clique)
        ]
    return found


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
    """List what groups have alike, such as ``19 B2, half-lap PVC, corrugated-tube``."""
    first = groups[0].fields
    alike = {
        name: word
        for name, word in first.items()
        if name != field and all(group.fields.get(name) == word for group in groups)
    }
    own = [
        f"{name.replace('_', ' ')} {word}"
        for name, word in alike.items()
        if name not in _OF_BUNDLES
    ]
    if "composition" not in _said(groups[0]):
        return ", ".join(filter(None, [alike.get("type", ""), *own]))
    return ", ".join(filter(None, [*_made_of(alike), _taped(alike), _in_conduit(alike), *own]))


def _made_of(alike: Mapping[str, str]) -> list[str]:
    """Wires, and of several kinds how they are spread."""
    wires = [alike["composition"]] if "composition" in alike else []
    if not wires and "wire" in alike:
        wires = [alike["wire"]]
    if not wires and "number" in alike:
        wires = [f"{alike['number']} wires"]
    is_mixed = "&" in alike.get("wire", "")
    return [*wires, alike.get("arrangement", "") if is_mixed else ""]


def _taped(alike: Mapping[str, str]) -> str:
    if alike.get("taping") == NONE:
        return "no tape"
    words = (alike.get(name, "") for name in ("taping", "tape"))
    return " ".join(word for word in words if word not in {"", NONE})


def _in_conduit(alike: Mapping[str, str]) -> str:
    word = alike.get("conduit", "")
    return "" if word == NONE else word


_HEADS = ("Number", "Difference", "95 % interval", "Does not matter below", "In words")


def question_table(pair: Pair) -> Table:
    """Make the table of a pair that differs in one field alone.

    Parameters
    ----------
    pair : its field heads the table as a question

    Returns
    -------
    A row per number, with the difference as a share of the first mean below it. What is said
    against the comparison of every number, stands once, below the table.
    """
    caveats = [each.caveats for each in pair.differences]
    shared = [each for each in caveats[0] if all(each in own for own in caveats)]
    rows = [
        _row(_without(each, shared), display_of(pair.first), _share_of(each, pair.first))
        for each in pair.differences
    ]
    notes = [f"Every number: {'; '.join(shared)}."] if shared else []
    return Table(question_words(pair), _HEADS, tuple(rows), tuple(notes))


def _without(difference: Difference, caveats: Sequence[str]) -> Difference:
    kept = tuple(each for each in difference.caveats if each not in caveats)
    return replace(difference, caveats=kept)


def _share_of(difference: Difference, first: Group) -> str:
    """A difference in percent of the mean that it is counted from."""
    number = next((each for each in first.numbers if each.name == difference.name), None)
    mean = number.mean.chosen.mean if number is not None and number.mean is not None else nan
    found = difference.difference
    if not abs(mean) > 0.0:
        return ""
    return f"{write_number(100.0 * found.mean / abs(mean), None, digits=2).value} %"


def difference_table(campaign: Campaign) -> Table | None:
    """Make the table of differences between types, and of few that differ in several fields.

    Parameters
    ----------
    campaign : its groups give the display units

    Returns
    -------
    None where there are no such differences; where those in several fields are many, without them.
    """
    displays = {group.name: display_of(group) for group in campaign.groups}
    several = several_fields(campaign)
    shown = [*plain(campaign), *(several if len(several) <= FEW_ROWS else [])]
    rows = [_row(each, displays.get(each.first, {}), between(each)) for each in shown]
    title = "Differences between groups" if not several else _title(shown, several)
    return Table(title, _HEADS, tuple(rows)) if rows else None


def _title(shown: Sequence[Difference], several: Sequence[Difference]) -> str:
    if len(shown) == len(several):
        return "Groups that differ in several fields at once"
    return "Differences between other groups"


def between(difference: Difference) -> str:
    """Name the groups of a difference, and the fields where they are several."""
    words = f"{difference.second} minus {difference.first}"
    if len(difference.fields) < 2 or "type" in difference.fields:
        return words
    return f"{words}: {fields_in_words(difference)}"


def fields_in_words(difference: Difference) -> str:
    """List the fields that two groups differ in, such as ``taping: half-lap against none``."""
    return "; ".join(
        f"{name.replace('_', ' ')}: {after} against {before}"
        for name, (before, after) in difference.fields.items()
    )


def _row(difference: Difference, display: Mapping[str, str], below: str) -> tuple[Cell, ...]:
    shown = shown_in(difference.name, difference.unit, display)
    found = difference.difference
    written = write_number(found.mean, found.interval, shown.factor, apart=found.apart)
    none = sentences([found.reason]) or DASH
    margin = nan if difference.margin is None else difference.margin
    matters = write_number(margin, None, shown.factor, digits=3).value
    return (
        Cell(heading(difference.name, shown.unit), below),
        Cell(written.value),
        Cell(written.interval or none),
        Cell(matters),
        Cell(difference.words),
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
    several = several_fields(campaign)
    if len(several) > FEW_ROWS:
        count = len({(each.first, each.second) for each in several})
        said.append(
            f"{_pairs(count)} not shown, as the groups differ in several fields at once, which"
            " answers no question: see the sheet 'comparisons' of tables.xlsx."
        )
    return said


def _pairs(count: int) -> str:
    return f"{count} pair{'s are' if count != 1 else ' is'}"
