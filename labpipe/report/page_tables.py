"""Tables of the page of a report: of each group, of all tests, of issues and of methods."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from typing import Any
from urllib.parse import quote

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.causes import IS_COMMON
from labpipe.records.group import Campaign, Group, GroupNumber, Sample
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status
from labpipe.report.budget_figures import (
    find_cause_colour,
    list_drawn_causes,
    make_group_bars,
    sort_shares,
)
from labpipe.report.figure_page import split_pages
from labpipe.report.issues import Cause, describe_decision, find_notes, join_sentences
from labpipe.report.page_facts import (
    PageTest,
    PageTests,
    describe_days,
    describe_operators,
    make_key,
)
from labpipe.report.plot_records import MeanStrip, clip_range, make_mean_strip
from labpipe.report.wording import (
    describe_counts,
    find_display,
    find_display_unit,
    find_number_unit,
    find_units,
    is_main,
    replace_names,
    write_count,
    write_heading,
    write_label,
    write_mean,
    write_number,
    write_with_interval,
)

DASH = "\u2013"


@dataclass(frozen=True, slots=True)
class Cell:
    """Contents of a cell.

    Parameters
    ----------
    text : in the first line
    small : in the second line, in smaller letters
    mark : after the text: ``?`` for doubtful, ``!`` for an outlier
    tip : sentence or code that the page shows on hover
    sort : value by which the column is sorted, SI; None to sort by the text
    drawing : replaces the text
    link : address of the text on the page
    """

    text: str
    small: str = ""
    mark: str = ""
    tip: str = ""
    sort: float | None = None
    drawing: MeanStrip | None = None
    link: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """A table of the page; the first cell of a row is its heading.

    Parameters
    ----------
    caption : above the table
    heads : headings, one per column
    rows : as many cells as headings
    notes : sentences below the table
    """

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()


MAX_SAMPLE_COLUMNS = 4
"""Samples with a column in the table of numbers; a larger group has tables of samples, too."""


def describe_group(group: Group) -> str:
    """Describe a group: counts of samples and spools, protocol, days and operators."""
    tested = f"tested {describe_days(group.samples)} by {describe_operators(group.samples)}"
    return f"{describe_counts(group)}, protocol {group.protocol}, {tested}."


def make_number_table(group: Group) -> Table:
    """Make the table of a group: a row per number with its mean, and the samples if they are few.

    Parameters
    ----------
    group : with or without samples
    """
    n_drawn = 8  # rows with a drawing
    columns = group.samples if len(group.samples) <= MAX_SAMPLE_COLUMNS else ()
    heads = ("Number", "Plot", "Mean, 95 %", "n", "s", *(column.test for column in columns))
    rows = tuple(
        _number_row(group, number, columns, is_drawn=row < n_drawn)
        for row, number in enumerate(group.numbers)
    )
    return Table("", heads, rows, tuple(_table_notes(group)))


def _number_row(
    group: Group, number: GroupNumber, columns: Sequence[Sample], *, is_drawn: bool
) -> tuple[Cell, ...]:
    unit = find_number_unit(group, number)
    head = Cell(write_heading(number.name, unit.unit), tip=number.name)
    samples = [_sample_cell(number, column, unit.factor) for column in columns]
    mean = number.mean
    if mean is None:
        missing = Cell(DASH, tip="no sample has this number")
        return head, Cell(""), missing, Cell("0"), Cell(DASH), *samples
    count = f"{mean.chosen.n}"
    if not mean.is_pooled:
        count = write_count(mean.chosen.n, "spool")
    elif mean.chosen.n != len(group.samples):
        count = f"{mean.chosen.n} of {len(group.samples)}"
    return (
        head,
        Cell("", drawing=_number_strip(number) if is_drawn else None),
        Cell(write_mean(mean.chosen, unit.factor)),
        Cell(count, tip=str(mean.decision) if len(mean.spool_means) > 1 else ""),
        Cell(write_number(mean.chosen.deviation, None, unit.factor, digits=2).value),
        *samples,
    )


def _number_strip(number: GroupNumber) -> MeanStrip:
    """Draw samples, mean and interval of a number on their own scale."""
    max_dots, max_reach = 12, 1.5  # reach of intervals beside the values, of their range
    values = [value.value for value in number.values.values() if value.value is not None]
    chosen = None if number.mean is None else number.mean.chosen
    interval = None if chosen is None else chosen.interval
    mean = nan if chosen is None else chosen.mean
    ends = () if interval is None else (interval.lower, interval.upper)
    dots = values if len(values) <= max_dots else ()
    return make_mean_strip(clip_range([*values, mean], ends, max_reach), interval, mean, dots)


def _sample_cell(number: GroupNumber, sample: Sample, factor: float) -> Cell:
    named = (result for result in sample.results if result.name == number.name)
    result = number.values.get(sample.test) or next(named, None)
    marked = any(outlier.sample == sample.test for outlier in number.outliers)
    return make_result_cell(result, factor, is_outlier=marked)


def make_result_cell(result: Result | None, factor: float, *, is_outlier: bool = False) -> Cell:
    """Make the cell of a test's number: ``?`` marks a doubtful one, ``!`` an outlier.

    Parameters
    ----------
    result : None if the protocol of the test does not name it
    factor : from SI to the display unit
    is_outlier : among the samples of its group
    """
    if result is None:
        return Cell(DASH, tip="not requested")
    if result.value is None:
        return Cell(DASH)
    mark = ("?" if result.status is Status.DOUBTFUL else "") + ("!" if is_outlier else "")
    text = write_with_interval(
        result.value, result.interval, factor, estimate=result.distinct_estimate
    )
    return Cell(text, mark=mark)


def _table_notes(group: Group) -> Iterator[str]:
    """Yield the notes on signs and averages of the table."""
    if any(not number.mean.is_pooled for number in group.numbers if number.mean):
        yield format_sentence("report.n_in_spools")
    names = [write_label(number.name).lower() for number in group.numbers if number.is_set_by_rig]
    if names:
        yield format_sentence("report.set_by_rig", numbers="; ".join(names))
    spools = {sample.specimen.spool for sample in group.samples}
    if len(spools) == 1 and len(group.samples) > 1:
        yield format_sentence("report.one_spool")
    yield from _interval_notes(group)
    yield from _reason_notes(group)


def _interval_notes(group: Group) -> Iterator[str]:
    """Yield the reasons of missing and of very wide intervals of means."""
    min_tests = 2
    reasons: dict[Reason, list[str]] = {}
    for member in group.numbers:
        if member.mean is not None and member.mean.chosen.reason:
            reasons.setdefault(member.mean.chosen.reason, []).append(write_label(member.name))
    for why, names in reasons.items():
        numbers = "all numbers" if len(names) == len(group.numbers) else "; ".join(names)
        yield format_sentence("report.no_mean_interval", why=join_sentences([why]), numbers=numbers)
    means = [number.mean for number in group.numbers if number.mean is not None]
    if any(not mean.is_pooled and mean.chosen.n == min_tests for mean in means):
        yield format_sentence("report.two_spool_means")


def _reason_notes(group: Group) -> Iterator[str]:
    """Yield the reasons of doubtful (?), missing and outlying (!) numbers with their tests."""
    names = {number.name for number in group.numbers}
    tests_by_reason: dict[str, dict[str, None]] = {}
    for sample in group.samples:
        for result in sample.results:
            if result.name in names and result.status is not Status.OK:
                sign = DASH if result.status is Status.FAILED else "?"
                reason = f"{sign} {join_sentences(result.reasons)}"
                tests_by_reason.setdefault(reason, {})[sample.test] = None
    for reason, tests in tests_by_reason.items():
        yield f"{reason} ({', '.join(tests)})"
    outliers: dict[str, list[str]] = {}
    for number in group.numbers:
        for outlier in number.outliers:
            outliers.setdefault(outlier.sample, []).append(write_label(number.name).lower())
    for test, numbers in outliers.items():
        yield format_sentence("report.outlier_in_mean", test=test, numbers="; ".join(numbers))


def make_sample_tables(group: Group, tests: PageTests) -> list[Table]:
    """Make tables with a row per sample and eight numbers each.

    Parameters
    ----------
    group : with or without samples
    tests : all of the page

    Returns
    -------
    No tables if `make_number_table` shows the samples.
    """
    numbers_per_table = 8
    if len(group.samples) <= MAX_SAMPLE_COLUMNS:
        return []
    numbers = [number for number in group.numbers if is_main(number.name)]
    parts = split_pages(numbers, numbers_per_table)
    return [_samples_table(group, part, tests, at > 0) for at, part in enumerate(parts)]


def _samples_table(
    group: Group, numbers: Sequence[GroupNumber], tests: PageTests, is_more: bool
) -> Table:
    scales = [find_number_unit(group, number) for number in numbers]
    heads = [
        write_heading(number.name, unit.unit) for number, unit in zip(numbers, scales, strict=True)
    ]
    rows = []
    for sample in group.samples:
        link = f"#t{tests.number[make_key(sample)]}"
        named = [Cell(sample.test, link=link), Cell(sample.specimen.spool)]
        values = [
            _sample_cell(number, sample, unit.factor)
            for number, unit in zip(numbers, scales, strict=True)
        ]
        rows.append((*([Cell(sample.test)] if is_more else named), *values))
    caption = f"{group.name}: every sample{', continued' if is_more else ''}"
    return Table(caption, ("Test", *([] if is_more else ["Spool"]), *heads), tuple(rows))


def make_budget_bars(group: Group) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Make the bars of budgets: of the first means, or else of the medians over the tests.

    Parameters
    ----------
    group : with or without samples

    Returns
    -------
    Up to five bars with ``name``, ``text`` and ``parts``; and the parts of the key, each cause
    once.
    """
    n_bars = 5
    means = [bar for bar in make_group_bars(group, of_means=True) if bar.shares]
    tests = [bar._replace(text="one test") for bar in make_group_bars(group, of_means=False)]
    chosen = (means or tests)[:n_bars]
    bar_shares = sort_shares([bar.shares for bar in chosen])
    bars = []
    for bar, shares in zip(chosen, bar_shares, strict=True):
        starts = np.cumsum([0.0, *shares.values()]).tolist()
        drawn = [
            _cause_look(cause) | {"share": share, "start": start}
            for (cause, share), start in zip(shares.items(), starts, strict=False)
        ]
        bars.append({"name": bar.name, "text": bar.text, "parts": drawn})
    return bars, list(map(_cause_look, list_drawn_causes(bar_shares)))


def _cause_look(cause: str) -> dict[str, Any]:
    colour = find_cause_colour(cause)
    return {"cause": cause, "colour": colour, "is_common": IS_COMMON.get(cause, False)}


def make_spool_table(group: Group) -> Table:
    """Make the table of the spool means and of the decisions how to average them."""
    spools = tuple(dict.fromkeys(sample.specimen.spool for sample in group.samples))
    rows, above = [], ""
    for number in group.numbers:
        if number.mean is None:
            continue
        unit = find_number_unit(group, number)
        cells = [Cell(write_heading(number.name, unit.unit))]
        for spool in spools:
            mean = number.mean.spool_means.get(spool)
            text, small = DASH, "no number"
            if mean is not None:
                text, small = write_mean(mean, unit.factor), f"n = {mean.n}"
            cells.append(Cell(text, small))
        decision = str(number.mean.decision)
        done, because = number.mean.decision.action, "; ".join(number.mean.decision.grounds)
        cells.append(Cell("as above") if decision == above else Cell(done, because))
        rows.append(tuple(cells))
        above = decision
    heads = ("Number", *(f"Spool {spool}" for spool in spools), "Decision")
    return Table(f"{group.name}: spool means and their averaging", heads, tuple(rows))


def make_slip_table(group: Group) -> Table | None:
    """Make the table of the slips of a group; None without slips."""
    x_unit, y_unit = find_units(find_display(group), "displacement", "force")
    rows = tuple(
        (
            Cell(sample.test),
            Cell(write_with_interval(slip.position, slip.position_interval, x_unit.factor)),
            Cell(write_with_interval(slip.drop, slip.drop_interval, y_unit.factor)),
            Cell(describe_decision(slip.decision)),
        )
        for sample in group.samples
        for slip in sample.slips
    )
    heads = ("Sample", x_unit.label("Displacement"), y_unit.label("Force lost"), "Treatment")
    return Table(f"{group.name}: slips in the grips", heads, rows) if rows else None


def make_cause_table(cause: Cause) -> Table:
    """Make the table of a cause: a row per issue."""
    rows = tuple(
        (
            Cell(issue.test or ", ".join(issue.tests) or "the whole group", issue.group),
            Cell(issue.what or DASH),
            Cell(issue.reason, tip=issue.code),
        )
        for issue in cause.issues
    )
    return Table(f"{cause.kind} ({len(cause.issues)})", ("Test", "What", "Why"), rows)


def make_note_table(campaign: Campaign) -> Table | None:
    """Make the table of notes without consequences, a row per kind; None without notes."""
    rows = tuple(
        (
            Cell(note.issues[0].reason, tip=note.code),
            Cell(str(len(note.issues))),
            Cell(note.subject),
        )
        for note in find_notes(campaign)
    )
    heads = ("Note (first of its kind)", "Number", "Where")
    return Table("Notes without consequences", heads, rows) if rows else None


def make_method_tables(campaign: Campaign) -> list[Table]:
    """Make a table per protocol of the methods of each number and its interval."""
    methods: dict[str, dict[str, dict[str, None]]] = {}
    for group in campaign.groups:
        numbers = methods.setdefault(group.protocol, {}) if group.samples else {}
        for sample in group.samples:
            for result in sample.results:
                numbers.setdefault(result.name, {})[result.method] = None
    return [
        Table(
            f"Protocol {protocol}: method of each number",
            ("Number", "Method"),
            tuple(
                (
                    Cell(write_label(name), tip=name),
                    Cell(
                        replace_names("; ".join(filter(None, method)))
                        or "No sample has this number."
                    ),
                )
                for name, method in numbers.items()
            ),
        )
        for protocol, numbers in methods.items()
    ]


def make_test_rows(campaign: Campaign, tests: PageTests, stems: Mapping[str, str]) -> list[Any]:
    """Make the rows of the table of tests.

    Parameters
    ----------
    campaign : with its groups
    tests : of the page
    stems : names of groups by their stems

    Returns
    -------
    For each ``test``: its ``group``, the cell ``first`` of its first main number, the decision
    (``decided``: ``accept``, ``reject`` or empty; its ``words``), the file ``page`` and its
    ``address``, and ``why`` the test is doubtful, failed or rejected.
    """
    mains = {
        stem: next((number.name for number in group.numbers if is_main(number.name)), "")
        for stem, group in zip(stems, campaign.groups, strict=False)
    }
    return [
        {
            "test": test,
            "group": stems.get(test.stem, ""),
            "first": _first_number_cell(test, mains.get(test.stem, "")),
            "decided": "reject" if test.why else "accept" if test.sample.decision else "",
            "words": test.why or test.sample.decision,
            "page": (page := name_page_file(test.sample.label or test.sample.test)),
            "address": quote(page, errors="replace"),
            "why": describe_problems(test),
        }
        for test in tests.every
    ]


def name_page_file(label: str) -> str:
    """Name the file of the page of a test, below the folder of the report.

    Parameters
    ----------
    label : of the test, with ``/`` between folders

    Examples
    --------
    >>> name_page_file("wires/A2-085-1")
    'tests/wires__A2-085-1.html'
    """
    return f"tests/{label.replace('/', '__')}.html"


def _first_number_cell(test: PageTest, main: str) -> Cell:
    """Make the cell of the first main number of a test, with the name and the unit below it."""
    result = next((result for result in test.sample.results if result.name == main), None)
    if result is None:
        return Cell(DASH)
    unit = find_display_unit(main, result.unit, test.sample.display)
    cell = make_result_cell(result, unit.factor)
    return Cell(cell.text, write_heading(main, unit.unit), cell.mark, cell.tip, result.value)


def describe_problems(test: PageTest) -> str:
    """Join the reasons of the doubtful and failed results of a test, or of its rejection.

    Parameters
    ----------
    test : of the page
    """
    if test.why:
        return f"Rejected: {test.why}"
    doubtful = [result for result in test.sample.results if result.status is not Status.OK]
    return join_sentences(reason for result in doubtful for reason in result.reasons)


def make_source_table(tests: PageTests) -> Table:
    """Make the table of the recorded files of each test with their SHA-256.

    Parameters
    ----------
    tests : of the page
    """
    rows = []
    for test in tests.every:
        sources = [f"{source.file}: {source.sha256}" for source in test.sample.inputs]
        rows.append((Cell(test.sample.test), Cell("; ".join(sources) or DASH)))
    return Table("Sources of the numbers", ("Test", "Recorded files with SHA-256"), tuple(rows))
