"""The tables of a whole campaign: concerns, methods, the tests."""

from __future__ import annotations

from collections.abc import Sequence

from labpipe.records.group import Campaign, Sample
from labpipe.report.concerns import Concern, Kind, find_concerns
from labpipe.report.group_tables import DASH, Cell, Table
from labpipe.report.numbers import (
    display_of,
    in_words,
    shown_in,
    unit_words,
    with_names_in_words,
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
