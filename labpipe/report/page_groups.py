"""Section of a group: description, numbers with every sample, budgets of intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite, nan
from typing import TYPE_CHECKING

from labpipe.records.causes import IS_COMMON
from labpipe.records.group import Group, GroupNumber, Sample
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status
from labpipe.report.budget_figures import COLOURS_OF_CAUSES, bar_parts, causes_in_key, named_causes
from labpipe.report.figure_page import split_pages
from labpipe.report.group_plots import count_words
from labpipe.report.group_tables import DASH, Cell, Table
from labpipe.report.issues import sentences
from labpipe.report.page_facts import PageTests, days_words, key_of, operators_words
from labpipe.report.page_plots import mean_strip
from labpipe.report.wording import (
    as_label,
    count_of,
    display_of,
    heading,
    is_first_cycle,
    is_main,
    mean_with_interval,
    shown_in,
    unit_words,
    with_interval,
    write_number,
)
from labpipe.statistics.means import group_budget

if TYPE_CHECKING:
    from markupsafe import Markup

MAX_SAMPLE_COLUMNS = 4
"""Samples as columns of the table of numbers; larger groups have tables with a row per sample."""


def about_group(group: Group) -> str:
    """Describe a group: counts of samples and spools, protocol, days, operators."""
    tested = f"tested {days_words(group.samples)} by {operators_words(group.samples)}"
    return f"{count_words(group)}, protocol {group.protocol}, {tested}."


def number_table(group: Group) -> Table:
    """Return the table of a group: a row per number with mean, interval and few samples.

    Parameters
    ----------
    group : with samples
    """
    columns = group.samples if len(group.samples) <= MAX_SAMPLE_COLUMNS else ()
    heads = ("Number", "Plot", "Mean, 95 %", "n", "s", *(column.test for column in columns))
    rows = tuple(
        _number_row(group, number, columns, is_drawn=row < 8)
        for row, number in enumerate(group.numbers)
    )
    return Table("", heads, rows, tuple(_table_notes(group)))


def _number_row(
    group: Group, number: GroupNumber, columns: Sequence[Sample], *, is_drawn: bool
) -> tuple[Cell, ...]:
    unit = shown_in(number.name, number.unit, display_of(group))
    head = Cell(heading(number.name, unit.unit), tip=number.name)
    samples = [_sample_cell(number, column, unit.factor) for column in columns]
    if number.mean is None:
        return (
            head,
            Cell(""),
            Cell(DASH, tip="no sample has this number"),
            Cell("0"),
            Cell(DASH),
            *samples,
        )
    chosen = number.mean.chosen
    deviation = write_number(chosen.deviation, None, unit.factor, digits=2).value
    return (
        head,
        Cell("", drawing=number_strip(number) if is_drawn else None),
        Cell(mean_with_interval(chosen, unit.factor)),
        Cell(_count_text(number, len(group.samples)), tip=_decision_text(number)),
        Cell(deviation),
        *samples,
    )


def _count_text(number: GroupNumber, samples: int) -> str:
    """Write the count of the mean: samples or spool means."""
    mean = number.mean
    if mean is None:
        return "0"
    if not mean.is_pooled:
        return count_of(mean.chosen.n, "spool")
    return f"{mean.chosen.n}" if mean.chosen.n == samples else f"{mean.chosen.n} of {samples}"


def _decision_text(number: GroupNumber) -> str:
    """Return the decision how samples of several spools were averaged."""
    mean = number.mean
    return str(mean.decision) if mean is not None and len(mean.spool_means) > 1 else ""


def number_strip(number: GroupNumber) -> Markup:
    """Draw samples, mean and interval of a number on their own scale."""
    values = [value.value for value in number.values.values() if value.value is not None]
    chosen = None if number.mean is None else number.mean.chosen
    interval = None if chosen is None else chosen.interval
    mean = nan if chosen is None else chosen.mean
    low, high = min([*values, mean]), max([*values, mean])
    reach = 1.5 * (high - low)
    if interval is not None and isfinite(interval.lower + interval.upper):
        low = max(min(low, interval.lower), low - reach) if reach else interval.lower
        high = min(max(high, interval.upper), high + reach) if reach else interval.upper
    return mean_strip((low, high), interval, mean, values if len(values) <= 12 else ())


def _sample_cell(number: GroupNumber, sample: Sample, factor: float) -> Cell:
    result = number.values.get(sample.test) or _result(sample, number.name)
    marked = any(outlier.sample == sample.test for outlier in number.outliers)
    return result_cell(result, factor, is_outlier=marked)


def _result(sample: Sample, name: str) -> Result | None:
    return next((result for result in sample.results if result.name == name), None)


def result_cell(result: Result | None, factor: float, *, is_outlier: bool = False) -> Cell:
    """Return the cell of a test's number: ``?`` marks a doubtful one, ``!`` an outlier.

    Parameters
    ----------
    result : None if it was not requested
    factor : from SI to the unit that is shown
    is_outlier : marked as outlier
    """
    if result is None:
        return Cell(DASH, tip="not requested")
    if result.value is None:
        return Cell(DASH)
    mark = ("?" if result.status is Status.DOUBTFUL else "") + ("!" if is_outlier else "")
    text = with_interval(result.value, result.interval, factor, apart=result.apart)
    return Cell(text, mark=mark)


def _table_notes(group: Group) -> Iterator[str]:
    """Yield the notes on signs and averages of the table."""
    if any(not number.mean.is_pooled for number in group.numbers if number.mean):
        yield "n in spools: the mean is over spool means, each counted once."
    if any(number.is_set_by_rig for number in group.numbers):
        names = [as_label(number.name).lower() for number in group.numbers if number.is_set_by_rig]
        yield f"Set by the rig, not tested for outliers: {'; '.join(names)}."
    spools = {sample.specimen.spool for sample in group.samples}
    if len(spools) == 1 and len(group.samples) > 1:
        yield "One spool: differences between spools are unknown; intervals hold for this spool."
    yield from _interval_notes(group)
    yield from _reason_notes(group)


def _interval_notes(group: Group) -> Iterator[str]:
    """Yield the reasons of missing and of very wide intervals of means."""
    min_tests = 2
    reasons: dict[Reason, list[str]] = {}
    for member in group.numbers:
        if member.mean is not None and member.mean.chosen.reason:
            reasons.setdefault(member.mean.chosen.reason, []).append(as_label(member.name))
    for why, names in reasons.items():
        of = "all numbers" if len(names) == len(group.numbers) else "; ".join(names)
        yield f"No interval of the mean: {sentences([why])} ({of})"
    means = [number.mean for number in group.numbers if number.mean is not None]
    if any(not mean.is_pooled and mean.chosen.n == min_tests for mean in means):
        yield (
            "Intervals over two spool means are wide because two values leave one degree of"
            " freedom, where Student's t is 12.7. More samples of these spools hardly help; a"
            " third spool reduces t to 4.3, a fourth to 3.2."
        )


def _reason_notes(group: Group) -> Iterator[str]:
    """Yield the reasons of doubtful (?), missing and outlying (!) numbers with their tests."""
    names = {number.name for number in group.numbers}
    named: dict[str, dict[str, None]] = {}
    for sample in group.samples:
        for result in sample.results:
            if result.name in names and result.status is not Status.OK:
                sign = DASH if result.status is Status.FAILED else "?"
                reason = f"{sign} {sentences(result.reasons)}"
                named.setdefault(reason, {})[sample.test] = None
    for reason, tests in named.items():
        yield f"{reason} ({', '.join(tests)})"
    outliers: dict[str, list[str]] = {}
    for number in group.numbers:
        for outlier in number.outliers:
            outliers.setdefault(outlier.sample, []).append(as_label(number.name).lower())
    for test, numbers in outliers.items():
        yield f"! {test} is an outlier in {'; '.join(numbers)}. It is included in all means."


def samples_tables(group: Group, tests: PageTests) -> list[Table]:
    """Return tables with a row per sample for groups with many samples.

    Parameters
    ----------
    group : any
    tests : all of the page
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
    display = display_of(group)
    scales = [shown_in(number.name, number.unit, display) for number in numbers]
    heads = [heading(number.name, unit.unit) for number, unit in zip(numbers, scales, strict=True)]
    rows = tuple(
        (
            *_name_cells(sample, tests, is_more=is_more),
            *(
                _sample_cell(number, sample, unit.factor)
                for number, unit in zip(numbers, scales, strict=True)
            ),
        )
        for sample in group.samples
    )
    caption = f"{group.name}: every sample{', continued' if is_more else ''}"
    return Table(caption, ("Test", *([] if is_more else ["Spool"]), *heads), rows)


def _name_cells(sample: Sample, tests: PageTests, *, is_more: bool) -> tuple[Cell, ...]:
    """Return the cells with the name of a test and, in the first table, link and spool."""
    if is_more:
        return (Cell(sample.test),)
    link = f"#t{tests.number[key_of(sample)]}"
    return Cell(sample.test, link=link), Cell(sample.specimen.spool)


def budget_drawing(group: Group) -> Markup | None:
    """Draw the budgets of the intervals of the means: a bar per number, a colour per cause.

    Parameters
    ----------
    group : for a single sample, the budgets of its numbers are drawn

    Returns
    -------
    None if no number has a budget.
    """
    bar_height = 20
    text_widths = ((0, 202), (1, 118))  # smallest room for name and half width beside a bar
    letter_width = 6.6
    from markupsafe import Markup, escape

    bars = _budget_bars(group)
    if not bars:
        return None
    named = named_causes([shares for _, _, shares in bars])
    left, right = (
        max(room, letter_width * max(len(bar[which]) for bar in bars) + 6)
        for which, room in text_widths
    )
    whole = f"{_BAR_LEFT - left:.0f} 0 {left + _BAR_WIDTH + right:.0f} {len(bars) * bar_height + 4}"
    parts = [
        f'<svg class="budget" role="img" viewBox="{whole}"'
        f' aria-label="Shares of the causes of the intervals of {escape(group.name)}.">'
    ]
    for row, (name, half, shares) in enumerate(bars):
        parts.append(f'<g transform="translate(0 {row * bar_height})">')
        parts.append(f'<text class="end" x="196" y="14">{escape(name)}</text>')
        parts += _bar(bar_parts(shares, set(named)))
        parts.append(f'<text x="612" y="14">{escape(half)}</text></g>')
    return Markup("".join([*parts, "</svg>"]))


_BAR_LEFT, _BAR_WIDTH = 202, 404


def _bar(shares: Mapping[str, float]) -> Iterator[str]:
    min_labelled_share, min_drawn_share = 0.08, 0.004
    start = 0.0
    for cause, share in shares.items():
        x, width = _BAR_LEFT + _BAR_WIDTH * start, f"{_BAR_WIDTH * share:.1f}"
        colour = COLOURS_OF_CAUSES.get(cause, "#ededed")
        hatch = ' class="shared"' if IS_COMMON.get(cause, False) else ""
        if share >= min_drawn_share:
            yield f'<rect{hatch} x="{x:.0f}" y="2" width="{width}" height="16" fill="{colour}"/>'
        if share >= min_labelled_share:
            middle = x + _BAR_WIDTH * share / 2
            yield f'<text class="share" x="{middle:.0f}" y="14">{100 * share:.0f}</text>'
        start += share


def budget_causes(group: Group) -> list[tuple[str, str, bool]]:
    """List the causes in the drawing of the budget: name, colour, common to all tests."""
    causes = causes_in_key([shares for _, _, shares in _budget_bars(group)])
    return [(cause, COLOURS_OF_CAUSES.get(cause, "#ededed"), IS_COMMON.get(cause, False))
            for cause in causes]  # fmt: skip


def _budget_bars(group: Group) -> list[tuple[str, str, Mapping[str, float]]]:
    """Return name, half width and shares of the first numbers with budgets."""
    display, bars = display_of(group), []
    for number in group.numbers:
        if not (is_main(number.name) and is_first_cycle(number.name)):
            continue
        budget = group_budget(number)
        shares = budget.of_mean or budget.of_tests
        if shares and number.mean is not None:
            unit = shown_in(number.name, number.unit, display)
            half = write_number(number.mean.chosen.half, None, unit.factor, digits=2).value
            width_text = f"\u00b1 {half} {unit_words(unit.unit)}" if budget.of_mean else "one test"
            bars.append((as_label(number.name.partition(".")[0]), width_text, shares))
    return bars[:5]
