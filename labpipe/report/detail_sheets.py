"""Sheets of a report's workbook that go into detail: tests, results, budgets, what needs a look."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TypeAlias

from labpipe.records.causes import IS_COMMON
from labpipe.records.curve import Interval
from labpipe.records.group import (
    BundlePlace,
    Campaign,
    Difference,
    Group,
    Sample,
)
from labpipe.records.quality import worded
from labpipe.records.result import Result, Status
from labpipe.report.bundle_figures import place_scales
from labpipe.report.comparisons import (
    fields_in_words,
    not_asked,
)
from labpipe.report.issue_ranking import Cause, find_causes, find_notes
from labpipe.report.page_facts import state_of
from labpipe.report.wording import (
    Scale,
    display_of,
    in_words,
    is_main,
    shown_in,
    unit_words,
)
from labpipe.report.workbook_cells import Row, Value, percent, shown, shown_with_ends
from labpipe.report.workbook_file import Sheet
from labpipe.statistics.group_budgets import SCATTER, group_budget, in_order

Column: TypeAlias = tuple[str, str]
"""Words and unit of a number."""


def headed(column: Column, part: str = "") -> str:
    """Head a column by words, a part of it, and the unit."""
    words, unit = column
    return f"{words}{part} ({unit})" if unit else f"{words}{part}"


def p_value(value: float) -> Value:
    """Show a p-value; None where it is not available."""
    return shown(value, None)


def shares_of(difference: Difference) -> tuple[Value, Value]:
    """Ends of the corrected interval as shares; none of a number that can be negative."""
    ends = difference.interval
    if ends is None or difference.share is None:
        return None, None
    return percent(ends.lower), percent(ends.upper)


def tests_sheet(campaign: Campaign) -> Sheet:
    """Lay out a row for each test, rejected ones last, and a column for each of its numbers."""
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
        *map(headed, columns),
        *("decision", "key of the run"),
    ]
    rows = [_test(group, sample, sizes, columns) for group, sample in every]
    asks = "What was measured in each test? A row for each test, a column for each number."
    last = heads[-3]
    return Sheet("tests", heads, rows, 1, asks=asks, printed=last)


def _as_column(sample: Sample, result: Result) -> Column:
    scale = shown_in(result.name, result.unit, sample.display)
    return in_words(result.name), unit_words(scale.unit)


def _test(group: str, sample: Sample, sizes: Sequence[str], columns: Sequence[Column]) -> Row:
    own = sample.specimen
    state = state_of(sample) if group else "rejected"
    results = {_as_column(sample, result): result for result in sample.results}
    lengths = (own.dimensions.get(name) for name in sizes)
    counts = (
        sum(result.status is status for result in sample.results if is_main(result.name))
        for status in (Status.DOUBTFUL, Status.FAILED)
    )
    return (
        *(sample.test, group, state, own.type, own.spool, own.sample, sample.protocol),
        *("" if sample.date is None else str(sample.date), sample.operator),
        *(None if length is None else 1e3 * length for length in lengths),
        *counts,
        *(_value(sample, results.get(column)) for column in columns),
        *(sample.decided, sample.run),
    )


def _value(sample: Sample, result: Result | None) -> Value:
    if result is None:
        return None
    return shown(
        result.value, result.interval, shown_in(result.name, result.unit, sample.display).factor
    )


def results_sheet(campaign: Campaign) -> Sheet:
    """List every result of every test with its interval, status, reason and method."""
    heads = (
        "group", "test", "number", "unit", "value", "lower", "upper", "estimate", "status",
        "reason", "result", "method",
    )  # fmt: skip
    rows = [
        _result(group, sample, result)
        for group in campaign.groups
        for sample in group.samples
        for result in sample.results
    ]
    asks = "How sure is each number of each test, how was it made, and why is it doubtful?"
    return Sheet("results", heads, rows, 2, asks=asks, printed="status")


def _result(group: Group, sample: Sample, result: Result) -> Row:
    scale = shown_in(result.name, result.unit, sample.display)
    return (
        group.name, sample.test, in_words(result.name), unit_words(scale.unit),
        *shown_with_ends(result.value, result.interval, scale.factor),
        shown(result.estimate, result.interval, scale.factor), str(result.status), result.why,
        result.name, result.how,
    )  # fmt: skip


def comparisons_sheet(campaign: Campaign) -> Sheet:
    """List the differences of groups, two by two; those that were asked for first."""
    heads = (
        "first", "second", "number", "unit", "second minus first", "lower", "upper",
        "share (%)", "corrected lower (%)", "corrected upper (%)", "corrected lower",
        "corrected upper", "verdict", "question", "differ in", "level (%)",
        "does not matter below", "different, p", "equivalent, p", "family", "in family", "why",
        "reason", "result",
    )  # fmt: skip
    displays = {group.name: display_of(group) for group in campaign.groups}
    rows = []
    asked = [difference for difference in campaign.differences if difference.family]
    for each in (*asked, *not_asked(campaign)):
        scale = shown_in(each.name, each.unit, displays.get(each.first, {}))
        rows.append(_comparison(each, scale))
    asks = "How do groups differ in each number, two by two? Pairs that were asked for come first."
    return Sheet(
        "comparisons", heads, rows, 2, asks=asks, printed="question",
        printed_rows=len(asked) or None,
    )  # fmt: skip


def _comparison(each: Difference, scale: Scale) -> Row:
    found, up = each.difference, scale.factor
    in_unit = each.interval if each.share is None else None
    corrected = shown_with_ends(found.mean, in_unit, up)[1:]
    level = None if each.interval is None else each.interval.level
    return (
        each.first, each.second, in_words(each.name), unit_words(scale.unit),
        *shown_with_ends(found.mean, found.interval, up), percent(each.share), *shares_of(each),
        *corrected, str(each.verdict), each.question, fields_in_words(each), percent(level),
        shown(each.margin, None, up), p_value(each.p), p_value(each.p_equivalent), each.family,
        each.tests or None, "; ".join(filter(None, (each.why, *each.caveats))),
        str(found.reason or ""), each.name,
    )  # fmt: skip


def budgets_sheet(campaign: Campaign) -> Sheet:
    """Lay out the shares of the causes: rows of means first, then those of tests."""
    means = [row for group in campaign.groups for row in _budgets_of_group(group)]
    tests = [row for group in campaign.groups for row in _budgets_of_tests(group)]
    of_means = {cause for _, shares in means for cause in shares}
    others = {cause for _, shares in tests for cause in shares} - of_means
    causes = [*_in_order(of_means), *_in_order(others)]
    marks = {cause: "*" for cause in causes if IS_COMMON.get(cause, False)}
    heads = (
        "group", "number", "of", "unit", "half of the 95 % interval",
        *(f"{cause}{marks.get(cause, '')} (%)" for cause in causes),
    )  # fmt: skip
    rows = [
        (*head, *(percent(shares.get(cause)) for cause in causes))
        for head, shares in (*means, *tests)
    ]
    asks = (
        "What is each 95 % interval made of? Shares of the variance, of means of the squared half"
        " width; * marks what all tests of a rig share, which no further sample makes smaller."
    )
    last = heads[len(of_means) + 4] if means else ""
    return Sheet(
        "budgets", heads, rows, 2, asks=asks, printed=last, printed_rows=len(means) or None
    )


def _in_order(causes: set[str]) -> list[str]:
    return [*([SCATTER] if SCATTER in causes else []), *in_order(causes - {SCATTER})]


_Budget: TypeAlias = tuple[Row, dict[str, float]]


def _budgets_of_group(group: Group) -> Iterator[_Budget]:
    for number in group.numbers:
        budget = group_budget(number)
        shares = budget.of_mean if budget.of_tests else {}
        if shares and number.mean is not None:
            scale = shown_in(number.name, number.unit, display_of(group))
            half = _half(number.mean.chosen.interval, scale.factor)
            words = (in_words(number.name), "mean of the group", unit_words(scale.unit))
            yield (group.name, *words, half), dict(shares)


def _budgets_of_tests(group: Group) -> Iterator[_Budget]:
    """Shares of each test of a group, below the median of all of them."""
    for number in group.numbers:
        shares = group_budget(number).of_tests
        scale = shown_in(number.name, number.unit, display_of(group))
        head = (group.name, in_words(number.name))
        if shares:
            yield (*head, "median of the tests", unit_words(scale.unit), None), dict(shares)
        for test, result in number.values.items():
            if result.largest_share is not None:
                half = _half(result.interval, scale.factor)
                rows = zip(result.budget, result.shares, strict=True)
                own = {row.cause: share for row, share in rows}
                yield (*head, test, unit_words(scale.unit), half), own


def _half(interval: Interval | None, factor: float) -> Value:
    return (
        None if interval is None else shown(0.5 * (interval.upper - interval.lower), None, factor)
    )


def places_sheet(campaign: Campaign) -> Sheet:
    """List the bending stiffness of each bundle between the bounds of its model."""
    heads = (
        "group", "test", "unit", "bending stiffness", "lower", "upper", "all slips",
        "wires slip", "nothing slips", "least of all directions", "largest of all directions",
        "share (%)", "share lower (%)", "share upper (%)", "reason",
    )  # fmt: skip
    scales = place_scales(campaign)
    rows = [_place(place, scales[place.group]) for place in campaign.places]
    asks = "Where does the bending stiffness of each bundle lie between slipping and sticking?"
    return Sheet("slipping and sticking", heads, rows, 2, asks=asks)


def _place(place: BundlePlace, scale: Scale) -> Row:
    up = scale.factor
    bounds = (shown(each, None, up) for each in (place.low, place.free, place.high))
    principal = (shown(each, None, up) for each in place.principal)
    ends = place.share_interval
    lower, upper = (None, None) if ends is None else (percent(ends.lower), percent(ends.upper))
    return (
        place.group, place.test or "mean", unit_words(scale.unit),
        *shown_with_ends(place.value, place.interval, up), *bounds, *principal,
        percent(place.share), lower, upper, worded(place.reasons),
    )  # fmt: skip


def issues_sheet(campaign: Campaign) -> Sheet:
    """List what needs a look, ranked, and the notes of which nothing follows."""
    heads = (
        "rank", "kind", "group", "test", "what", "reason", "largest effect of the cause", "code",
    )  # fmt: skip
    ranked = list(_causes(enumerate(find_causes(campaign), start=1)))
    notes = list(_causes((None, note) for note in find_notes(campaign)))
    asks = "What needs a look, the largest effect on a number first? Without a rank: notes."
    return Sheet(
        "needs a look", heads, [*ranked, *notes], 1, asks=asks, wrapped=heads[3:7],
        printed=heads[6], printed_rows=len(ranked) or None,
    )  # fmt: skip


def _causes(causes: Iterable[tuple[int | None, Cause]]) -> Iterator[Row]:
    for rank, cause in causes:
        effect = "" if cause.effect is None else cause.effect.words
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
