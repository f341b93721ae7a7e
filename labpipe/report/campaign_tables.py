"""The tables of a whole campaign: concerns, differences between groups, methods, the tests."""

from __future__ import annotations

import math
from collections.abc import Sequence

from labpipe.records.group import Campaign, Sample
from labpipe.report.concerns import Concern, Kind, find_concerns, split_reason
from labpipe.report.group_tables import DASH, Cell, Table
from labpipe.report.numbers import (
    display_of,
    heading,
    in_words,
    shown_in,
    unit_words,
    with_names_in_words,
    write_number,
)

_NO_METHOD = "No sample has this number."


def concern_tables(campaign: Campaign) -> list[Table]:
    """Make a table for each kind of concern that there is, worst first."""
    concerns = find_concerns(campaign)
    tables = []
    for kind in Kind:
        own = [each for each in concerns if each.kind is kind]
        if own:
            rows = tuple(_concern_row(each) for each in own)
            tables.append(Table(f"{kind} ({len(own)})", ("Test", "What", "Why"), rows))
    return tables


def _concern_row(concern: Concern) -> tuple[Cell, ...]:
    test = Cell(concern.test or "the whole group", concern.group)
    return test, Cell(concern.what or DASH), Cell(concern.reason, concern.code)


def difference_table(campaign: Campaign) -> Table | None:
    """Make the table of differences between groups; None where there are none."""
    displays = {group.name: display_of(group) for group in campaign.groups}
    rows = []
    for each in campaign.differences:
        shown = shown_in(each.name, each.unit, displays.get(each.first, {}))
        found = each.difference
        written = write_number(found.mean, found.interval, shown.factor)
        none = split_reason(found.reason)[1] or DASH
        margin = math.nan if each.margin is None else each.margin
        matters = write_number(margin, None, shown.factor, digits=3).value
        rows.append(
            (
                Cell(heading(each.name, shown.unit), f"{each.second} minus {each.first}"),
                Cell(written.value),
                Cell(written.interval or none),
                Cell(matters),
                Cell(each.verdict),
            )
        )
    heads = ("Number", "Difference", "95 % interval", "Does not matter below", "In words")
    return Table("Differences between groups", heads, tuple(rows)) if rows else None


def method_tables(campaign: Campaign) -> list[Table]:
    """Make a table per protocol that says how each number and its interval were made."""
    samples: dict[str, list[Sample]] = {}
    for group in campaign.groups:
        samples.setdefault(group.protocol, []).extend(group.samples)
    return [_method_table(protocol, own) for protocol, own in samples.items() if own]


def _method_table(protocol: str, samples: Sequence[Sample]) -> Table:
    methods: dict[str, dict[str, None]] = {}
    for sample in samples:
        for result in sample.results:
            known = methods.setdefault(result.name, {})
            if result.method:
                known[result.method] = None
    rows = tuple(
        (Cell(in_words(name), name), Cell(with_names_in_words("; ".join(each)) or _NO_METHOD))
        for name, each in methods.items()
    )
    return Table(f"Protocol {protocol}: how each number was made", ("Number", "Method"), rows)


def table_of_tests(campaign: Campaign) -> Table:
    """Make the list of tests: what was tested, by which protocol, where the result is."""
    rows = []
    for group in campaign.groups:
        across = shown_in("", "m", display_of(group))
        for sample in group.samples:
            sizes = ", ".join(
                f"{name.replace('_', ' ')} {across.factor * size:.4g} {unit_words(across.unit)}"
                for name, size in sample.specimen.dimensions.items()
            )
            specimen = sample.specimen
            rows.append(
                (
                    Cell(sample.test),
                    Cell(specimen.type, f"spool {specimen.spool}, sample {specimen.sample}"),
                    Cell(sizes or DASH),
                    Cell(sample.protocol),
                    Cell(sample.source or DASH),
                )
            )
    heads = ("Test", "Specimen", "Dimensions", "Protocol", "Read from")
    return Table("Tests in this report", heads, tuple(rows))
