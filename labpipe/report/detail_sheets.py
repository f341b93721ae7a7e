"""Detailed sheets of a report's workbook: tests, results, comparisons, budgets, issues."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TypeAlias

from labpipe.records.causes import IS_COMMON
from labpipe.records.curve import Interval
from labpipe.records.group import BundlePlace, Campaign, Difference, Group, Sample
from labpipe.records.quality import worded
from labpipe.records.result import Result, Status
from labpipe.report.budget_figures import sort_causes
from labpipe.report.bundle_figures import place_scales
from labpipe.report.comparisons import fields_in_words, multi_field_differences
from labpipe.report.issues import Cause, find_causes, find_notes
from labpipe.report.page_facts import state_of
from labpipe.report.wording import Scale, as_label, display_of, is_main, shown_in, unit_words
from labpipe.report.workbook_file import (
    Row,
    Sheet,
    Value,
    interval_cells,
    number_cell,
    percent_cell,
)
from labpipe.statistics.means import group_budget

Column: TypeAlias = tuple[str, str]
"""Name and unit of a number."""


def column_head(column: Column, part: str = "") -> str:
    """Write the head of a column: name, part and unit."""
    name, unit = column
    return f"{name}{part} ({unit})" if unit else f"{name}{part}"


def p_value(value: float) -> Value:
    """Return the cell of a p-value; None if it is not available."""
    return number_cell(value, None)


def interval_shares(difference: Difference) -> tuple[Value, Value]:
    """Return the ends of the corrected interval as shares; None for signed numbers."""
    ends = difference.interval
    if ends is None or difference.share is None:
        return None, None
    return percent_cell(ends.lower), percent_cell(ends.upper)


def tests_sheet(campaign: Campaign) -> Sheet:
    """Return the sheet of tests, rejected ones last, with a column per number."""
    every = [(group.name, sample) for group in campaign.groups for sample in group.samples]
    every += [("", sample) for sample in campaign.rejected_samples]
    columns = list(
        dict.fromkeys(
            _as_column(sample, result)
            for _, sample in every
            for result in sample.results
            if is_main(result.name)
        )
    )
    sizes = list(dict.fromkeys(name for _, sample in every for name in sample.specimen.dimensions))
    heads = [
        *("test", "group", "state", "type", "spool", "sample", "protocol", "day", "operator"),
        *(f"{name.replace('_', ' ')} (mm)" for name in sizes),
        *("doubtful numbers", "failed numbers"),
        *map(column_head, columns),
        *("decision", "key of the run"),
    ]
    rows = [_test_row(group, sample, sizes, columns) for group, sample in every]
    question = "What was measured in each test? One row per test, one column per number."
    last = heads[-3]
    return Sheet("tests", heads, rows, 1, question=question, printed=last)


def _as_column(sample: Sample, result: Result) -> Column:
    scale = shown_in(result.name, result.unit, sample.display)
    return as_label(result.name), unit_words(scale.unit)


def _test_row(group: str, sample: Sample, sizes: Sequence[str], columns: Sequence[Column]) -> Row:
    specimen = sample.specimen
    state = state_of(sample) if group else "rejected"
    results = {_as_column(sample, result): result for result in sample.results}
    lengths = (specimen.dimensions.get(name) for name in sizes)
    counts = (
        sum(result.status is status for result in sample.results if is_main(result.name))
        for status in (Status.DOUBTFUL, Status.FAILED)
    )
    return (
        *(
            sample.test,
            group,
            state,
            specimen.type,
            specimen.spool,
            specimen.sample,
            sample.protocol,
        ),
        *("" if sample.date is None else str(sample.date), sample.operator),
        *(None if length is None else 1e3 * length for length in lengths),
        *counts,
        *(_value(sample, results.get(column)) for column in columns),
        *(sample.decided, sample.run),
    )


def _value(sample: Sample, result: Result | None) -> Value:
    if result is None:
        return None
    return number_cell(
        result.value, result.interval, shown_in(result.name, result.unit, sample.display).factor
    )


def results_sheet(campaign: Campaign) -> Sheet:
    """List every result of every test with its interval, status, reason and method."""
    heads = (
        "group", "test", "number", "unit", "value", "lower", "upper", "estimate", "status",
        "reason", "result", "method",
    )  # fmt: skip
    rows = [
        _result_row(group, sample, result)
        for group in campaign.groups
        for sample in group.samples
        for result in sample.results
    ]
    question = "How uncertain is each number of each test, how was it obtained, why is it doubtful?"
    return Sheet("results", heads, rows, 2, question=question, printed="status")


def _result_row(group: Group, sample: Sample, result: Result) -> Row:
    scale = shown_in(result.name, result.unit, sample.display)
    return (
        group.name, sample.test, as_label(result.name), unit_words(scale.unit),
        *interval_cells(result.value, result.interval, scale.factor),
        number_cell(result.estimate, result.interval, scale.factor), str(result.status), result.why,
        result.name, result.how,
    )  # fmt: skip


def comparisons_sheet(campaign: Campaign) -> Sheet:
    """List the differences of pairs of groups, those in one field alone first."""
    heads = (
        "first", "second", "number", "unit", "second minus first", "lower", "upper",
        "share (%)", "corrected lower (%)", "corrected upper (%)", "corrected lower",
        "corrected upper", "verdict", "question", "differ in", "level (%)",
        "irrelevant below", "different, p", "equivalent, p", "family", "in family", "why",
        "reason", "result",
    )  # fmt: skip
    displays = {group.name: display_of(group) for group in campaign.groups}
    rows = []
    single_field = [difference for difference in campaign.differences if difference.family]
    for difference in (*single_field, *multi_field_differences(campaign)):
        scale = shown_in(difference.name, difference.unit, displays.get(difference.first, {}))
        rows.append(_comparison_row(difference, scale))
    question = (
        "How do pairs of groups differ in each number? Pairs that differ in one field come first."
    )
    return Sheet(
        "comparisons", heads, rows, 2, question=question, printed="question",
        printed_rows=len(single_field) or None,
    )  # fmt: skip


def _comparison_row(difference: Difference, scale: Scale) -> Row:
    shift, up = difference.difference, scale.factor
    in_unit = difference.interval if difference.share is None else None
    corrected = interval_cells(shift.mean, in_unit, up)[1:]
    level = None if difference.interval is None else difference.interval.level
    return (
        difference.first, difference.second, as_label(difference.name), unit_words(scale.unit),
        *interval_cells(shift.mean, shift.interval, up), percent_cell(difference.share),
        *interval_shares(difference), *corrected, str(difference.verdict), difference.question,
        fields_in_words(difference), percent_cell(level), number_cell(difference.margin, None, up),
        p_value(difference.p), p_value(difference.p_equivalent), difference.family,
        difference.tests or None, "; ".join(filter(None, (difference.why, *difference.caveats))),
        str(shift.reason or ""), difference.name,
    )  # fmt: skip


def budgets_sheet(campaign: Campaign) -> Sheet:
    """Return the sheet of budgets: shares of the causes for means, then for tests."""
    means = [row for group in campaign.groups for row in _budgets_of_group(group)]
    tests = [row for group in campaign.groups for row in _budgets_of_tests(group)]
    of_means = {cause for _, shares in means for cause in shares}
    others = {cause for _, shares in tests for cause in shares} - of_means
    causes = [*sort_causes(of_means), *sort_causes(others)]
    marks = {cause: "*" for cause in causes if IS_COMMON.get(cause, False)}
    heads = (
        "group", "number", "of", "unit", "half of the 95 % interval",
        *(f"{cause}{marks.get(cause, '')} (%)" for cause in causes),
    )  # fmt: skip
    rows = [
        (*head, *(percent_cell(shares.get(cause)) for cause in causes))
        for head, shares in (*means, *tests)
    ]
    question = (
        "Which causes contribute to each 95 % interval? Shares of the variance, for means of the"
        " squared half width; * marks causes common to all tests of a rig, which more"
        " samples do not reduce."
    )
    last = heads[len(of_means) + 4] if means else ""
    return Sheet(
        "budgets", heads, rows, 2, question=question, printed=last, printed_rows=len(means) or None
    )


_Budget: TypeAlias = tuple[Row, dict[str, float]]


def _budgets_of_group(group: Group) -> Iterator[_Budget]:
    for number in group.numbers:
        budget = group_budget(number)
        shares = budget.of_mean if budget.of_tests else {}
        if shares and number.mean is not None:
            scale = shown_in(number.name, number.unit, display_of(group))
            half = _half(number.mean.chosen.interval, scale.factor)
            labels = (as_label(number.name), "mean of the group", unit_words(scale.unit))
            yield (group.name, *labels, half), dict(shares)


def _budgets_of_tests(group: Group) -> Iterator[_Budget]:
    """Yield the median shares of the tests of a group, then the shares of each test."""
    for number in group.numbers:
        shares = group_budget(number).of_tests
        scale = shown_in(number.name, number.unit, display_of(group))
        head = (group.name, as_label(number.name))
        if shares:
            yield (*head, "median of the tests", unit_words(scale.unit), None), dict(shares)
        for test, result in number.values.items():
            if result.largest_share is not None:
                half = _half(result.interval, scale.factor)
                rows = zip(result.budget, result.shares, strict=True)
                test_shares = {row.cause: share for row, share in rows}
                yield (*head, test, unit_words(scale.unit), half), test_shares


def _half(interval: Interval | None, factor: float) -> Value:
    return (
        None
        if interval is None
        else number_cell(0.5 * (interval.upper - interval.lower), None, factor)
    )


def places_sheet(campaign: Campaign) -> Sheet:
    """List the bending stiffness of each bundle between the bounds of its model."""
    heads = (
        "group", "test", "unit", "bending stiffness", "lower", "upper", "all slips",
        "wires slip", "nothing slips", "smallest of all directions", "largest of all directions",
        "share (%)", "share lower (%)", "share upper (%)", "reason",
    )  # fmt: skip
    scales = place_scales(campaign)
    rows = [_place_row(place, scales[place.group]) for place in campaign.places]
    question = "Where does the bending stiffness of each bundle lie between slipping and sticking?"
    return Sheet("slipping and sticking", heads, rows, 2, question=question)


def _place_row(place: BundlePlace, scale: Scale) -> Row:
    up = scale.factor
    bounds = (number_cell(value, None, up) for value in (place.low, place.free, place.high))
    principal = (number_cell(value, None, up) for value in place.principal)
    ends = place.share_interval
    lower, upper = (
        (None, None) if ends is None else (percent_cell(ends.lower), percent_cell(ends.upper))
    )
    return (
        place.group, place.test or "mean", unit_words(scale.unit),
        *interval_cells(place.value, place.interval, up), *bounds, *principal,
        percent_cell(place.share), lower, upper, worded(place.reasons),
    )  # fmt: skip


def issues_sheet(campaign: Campaign) -> Sheet:
    """List the issues, ranked, and the notes without consequences."""
    heads = (
        "rank", "kind", "group", "test", "what", "reason", "largest effect of the cause", "code",
    )  # fmt: skip
    ranked = list(_cause_rows(enumerate(find_causes(campaign), start=1)))
    notes = list(_cause_rows((None, note) for note in find_notes(campaign)))
    question = "Which results need a check? Largest effect on a number first; notes have no rank."
    return Sheet(
        "needs a look", heads, [*ranked, *notes], 1, question=question, wrapped=heads[3:7],
        printed=heads[6], printed_rows=len(ranked) or None,
    )  # fmt: skip


def _cause_rows(causes: Iterable[tuple[int | None, Cause]]) -> Iterator[Row]:
    for rank, cause in causes:
        effect = "" if cause.effect is None else cause.effect.text
        for concern in cause.concerns:
            tests = concern.test or ", ".join(concern.tests)
            yield (
                rank,
                str(concern.kind),
                concern.group,
                tests,
                concern.what,
                concern.reason,
                effect,
                concern.code,
            )
