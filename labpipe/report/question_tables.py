"""Tables of the differences between groups: question by question, then whatever else differs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import nan

from labpipe.records.group import Campaign, Difference, Group
from labpipe.report.concerns import sentences
from labpipe.report.group_tables import DASH, Cell, Table
from labpipe.report.numbers import display_of, heading, shown_in, write_number
from labpipe.report.questions import (
    FEW_ROWS,
    Pair,
    plain,
    question_words,
    several_fields,
)

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
    written = write_number(found.mean, found.interval, shown.factor)
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
