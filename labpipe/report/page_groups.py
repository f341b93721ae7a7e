"""The section of a group: what it is, its numbers with every sample, what its intervals are of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite, nan
from typing import TYPE_CHECKING

from labpipe.records.causes import IS_COMMON
from labpipe.records.group import Group, GroupNumber, Sample
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status
from labpipe.report.budget_figures import COLOURS_OF_CAUSES, SMALLER, named_causes, parts_of
from labpipe.report.group_plots import count_words
from labpipe.report.group_tables import DASH, Cell, Table
from labpipe.report.issues import sentences
from labpipe.report.page_facts import PageTests, days_words, key_of, operators_words
from labpipe.report.page_numbers import mean_with_interval, with_interval
from labpipe.report.page_plots import strip
from labpipe.report.wording import (
    count_of,
    display_of,
    heading,
    in_words,
    is_main,
    shown_in,
    unit_words,
    write_number,
)
from labpipe.statistics.group_budgets import group_budget

if TYPE_CHECKING:
    from markupsafe import Markup

MOST_COLUMNS = 4
"""Samples that stand as columns of the table of numbers; of larger groups they have rows."""
_NUMBERS_PER_TABLE = 8
_MOST_BARS, _MOST_STRIPS, _MOST_DOTS = 5, 8, 12


def about_group(group: Group) -> str:
    """Say how many samples of how many spools, by which protocol, when and by whom."""
    tested = f"tested {days_words(group.samples)} by {operators_words(group.samples)}"
    return f"{count_words(group)}, protocol {group.protocol}, {tested}."


def number_table(group: Group) -> Table:
    """Make the table of a group: a row per number, its mean and interval, few samples beside it.

    Parameters
    ----------
    group : with samples
    """
    columns = group.samples if len(group.samples) <= MOST_COLUMNS else ()
    heads = ("Number", "Drawn", "Mean, 95 %", "n", "s", *(column.test for column in columns))
    rows = tuple(
        _number_row(group, number, columns, is_drawn=row < _MOST_STRIPS)
        for row, number in enumerate(group.numbers)
    )
    return Table("", heads, rows, tuple(_notes(group)))


def _number_row(
    group: Group, number: GroupNumber, columns: Sequence[Sample], *, is_drawn: bool
) -> tuple[Cell, ...]:
    shown = shown_in(number.name, number.unit, display_of(group))
    head = Cell(heading(number.name, shown.unit), tip=number.name)
    samples = [_sample_cell(number, column, shown.factor) for column in columns]
    if number.mean is None:
        return head, Cell(""), Cell(DASH, tip="no sample has it"), Cell("0"), Cell(DASH), *samples
    chosen = number.mean.chosen
    deviation = write_number(chosen.deviation, None, shown.factor, digits=2).value
    return (
        head,
        Cell("", drawing=number_strip(number) if is_drawn else None),
        Cell(mean_with_interval(chosen, shown.factor)),
        Cell(_over(number, len(group.samples)), tip=_decision(number)),
        Cell(deviation),
        *samples,
    )


def _over(number: GroupNumber, samples: int) -> str:
    """What the mean is over: samples, or spool means."""
    mean = number.mean
    if mean is None:
        return "0"
    if not mean.is_pooled:
        return count_of(mean.chosen.n, "spool")
    return f"{mean.chosen.n}" if mean.chosen.n == samples else f"{mean.chosen.n} of {samples}"


def _decision(number: GroupNumber) -> str:
    """How samples of several spools were averaged, and why."""
    mean = number.mean
    return str(mean.decision) if mean is not None and len(mean.spool_means) > 1 else ""


def number_strip(number: GroupNumber) -> Markup:
    """Draw samples, mean and interval of a number side by side, on a scale of their own."""
    values = [value.value for value in number.values.values() if value.value is not None]
    chosen = None if number.mean is None else number.mean.chosen
    interval = None if chosen is None else chosen.interval
    mean = nan if chosen is None else chosen.mean
    low, high = min([*values, mean]), max([*values, mean])
    reach = 1.5 * (high - low)
    if interval is not None and isfinite(interval.lower + interval.upper):
        low = max(min(low, interval.lower), low - reach) if reach else interval.lower
        high = min(max(high, interval.upper), high + reach) if reach else interval.upper
    return strip((low, high), interval, mean, values if len(values) <= _MOST_DOTS else ())


def _sample_cell(number: GroupNumber, sample: Sample, factor: float) -> Cell:
    result = number.values.get(sample.test) or _result(sample, number.name)
    marked = any(outlier.sample == sample.test for outlier in number.outliers)
    return result_cell(result, factor, is_outlier=marked)


def _result(sample: Sample, name: str) -> Result | None:
    return next((result for result in sample.results if result.name == name), None)


def result_cell(result: Result | None, factor: float, *, is_outlier: bool = False) -> Cell:
    """Write the number of one test: ``?`` behind a doubtful one, ``!`` behind an outlier.

    Parameters
    ----------
    result : None where it was not asked for
    factor : from SI to the unit that is shown
    is_outlier : marked as one
    """
    if result is None:
        return Cell(DASH, tip="not asked for")
    if result.value is None:
        return Cell(DASH)
    mark = ("?" if result.status is Status.DOUBTFUL else "") + ("!" if is_outlier else "")
    words = with_interval(result.value, result.interval, factor, apart=result.apart)
    return Cell(words, mark=mark)


def _notes(group: Group) -> Iterator[str]:
    """What a sign in the table means, where there is one; what was averaged."""
    if any(not number.mean.is_pooled for number in group.numbers if number.mean):
        yield "n in spools: the mean is over the means of the spools, each of which counts once."
    if any(number.is_set_by_rig for number in group.numbers):
        names = [in_words(number.name).lower() for number in group.numbers if number.is_set_by_rig]
        yield f"Set by the rig, not tested for outliers: {'; '.join(names)}."
    spools = {sample.specimen.spool for sample in group.samples}
    if len(spools) == 1 and len(group.samples) > 1:
        yield "One spool: how spools differ is not known; the intervals hold for this spool."
    yield from _no_intervals(group)
    yield from _why_not(group)


def _no_intervals(group: Group) -> Iterator[str]:
    """Why means have no interval, numbers that share a reason together; why some are so wide."""
    reasons: dict[Reason, list[str]] = {}
    for member in group.numbers:
        if member.mean is not None and member.mean.chosen.reason:
            reasons.setdefault(member.mean.chosen.reason, []).append(in_words(member.name))
    for why, names in reasons.items():
        of = "all numbers" if len(names) == len(group.numbers) else "; ".join(names)
        yield f"No interval of the mean: {sentences([why])} ({of})"
    if any(not number.mean.is_pooled and number.mean.chosen.n == _TWO for number in group.numbers
           if number.mean is not None):  # fmt: skip
        yield (
            "Intervals over two spool means are wide because two values leave one degree of"
            " freedom, where Student's t is 12.7. More samples of these spools would hardly help;"
            " a third spool brings t down to 4.3, a fourth to 3.2."
        )


_TWO = 2


def _why_not(group: Group) -> Iterator[str]:
    """Why numbers are doubtful (?) or missing, and of which tests; one line for each reason."""
    names = {number.name for number in group.numbers}
    said: dict[str, dict[str, None]] = {}
    for sample in group.samples:
        for result in sample.results:
            if result.name in names and result.status is not Status.OK:
                sign = DASH if result.status is Status.FAILED else "?"
                said.setdefault(f"{sign} {sentences(result.reasons)}", {})[sample.test] = None
    for words, tests in said.items():
        yield f"{words} ({', '.join(tests)})"
    outliers: dict[str, list[str]] = {}
    for number in group.numbers:
        for outlier in number.outliers:
            outliers.setdefault(outlier.sample, []).append(in_words(number.name).lower())
    for test, numbers in outliers.items():
        yield f"! {test} stands apart in {'; '.join(numbers)}. It stays in every mean."


def samples_tables(group: Group, tests: PageTests) -> list[Table]:
    """Make tables with a row per sample, for groups whose samples are no columns.

    Parameters
    ----------
    group : any
    tests : all of the page
    """
    if len(group.samples) <= MOST_COLUMNS:
        return []
    own = [number for number in group.numbers if is_main(number.name)]
    parts = [own[at : at + _NUMBERS_PER_TABLE] for at in range(0, len(own), _NUMBERS_PER_TABLE)]
    return [_samples_table(group, part, tests, at > 0) for at, part in enumerate(parts)]


def _samples_table(
    group: Group, numbers: Sequence[GroupNumber], tests: PageTests, is_more: bool
) -> Table:
    display = display_of(group)
    scales = [shown_in(number.name, number.unit, display) for number in numbers]
    heads = [
        heading(number.name, shown.unit) for number, shown in zip(numbers, scales, strict=True)
    ]
    rows = tuple(
        (
            *_names(sample, tests, is_more=is_more),
            *(
                _sample_cell(number, sample, shown.factor)
                for number, shown in zip(numbers, scales, strict=True)
            ),
        )
        for sample in group.samples
    )
    caption = f"{group.name}: every sample{', continued' if is_more else ''}"
    return Table(caption, ("Test", *([] if is_more else ["Spool"]), *heads), rows)


def _names(sample: Sample, tests: PageTests, *, is_more: bool) -> tuple[Cell, ...]:
    """Name of a test; in the first table its spool, too, and a link to where it is decided on."""
    if is_more:
        return (Cell(sample.test),)
    link = f"#t{tests.number[key_of(sample)]}"
    return Cell(sample.test, link=link), Cell(sample.specimen.spool)


def budget_drawing(group: Group) -> Markup | None:
    """Draw what the intervals of the means are made of: a bar per number, a colour per cause.

    Parameters
    ----------
    group : of one sample, the budgets of its numbers are drawn

    Returns
    -------
    None where no number says what its interval is made of.
    """
    from markupsafe import Markup, escape

    bars = _budgets(group)
    if not bars:
        return None
    named = named_causes([shares for _, _, shares in bars])
    left, right = (
        max(room, _LETTER * max(len(bar[which]) for bar in bars) + 6) for which, room in _ROOMS
    )
    whole = f"{_BAR_LEFT - left:.0f} 0 {left + _BAR_WIDTH + right:.0f} {len(bars) * _BAR + 4}"
    parts = [
        f'<svg class="budget" role="img" viewBox="{whole}"'
        f' aria-label="Shares of the causes of the intervals of {escape(group.name)}.">'
    ]
    for row, (name, half, shares) in enumerate(bars):
        parts.append(f'<g transform="translate(0 {row * _BAR})">')
        parts.append(f'<text class="end" x="196" y="14">{escape(name)}</text>')
        parts += _bar(parts_of(shares, set(named)))
        parts.append(f'<text x="612" y="14">{escape(half)}</text></g>')
    return Markup("".join([*parts, "</svg>"]))


_BAR = 20
_BAR_LEFT, _BAR_WIDTH = 202, 404
_ROOMS, _LETTER = ((0, 202), (1, 118)), 6.6
"""Least room for name and half width beside a bar; for a letter."""
_LEAST_WRITTEN, _LEAST_DRAWN = 0.08, 0.004


def _bar(shares: Mapping[str, float]) -> Iterator[str]:
    start = 0.0
    for cause, share in shares.items():
        x, width = _BAR_LEFT + _BAR_WIDTH * start, f"{_BAR_WIDTH * share:.1f}"
        colour = COLOURS_OF_CAUSES.get(cause, "#ededed")
        hatch = ' class="shared"' if IS_COMMON.get(cause, False) else ""
        if share >= _LEAST_DRAWN:
            yield f'<rect{hatch} x="{x:.0f}" y="2" width="{width}" height="16" fill="{colour}"/>'
        if share >= _LEAST_WRITTEN:
            middle = x + _BAR_WIDTH * share / 2
            yield f'<text class="share" x="{middle:.0f}" y="14">{100 * share:.0f}</text>'
        start += share


def budget_causes(group: Group) -> list[tuple[str, str, bool]]:
    """List the causes in the drawing of the budget: cause, colour, whether all tests share it."""
    bars = _budgets(group)
    named = named_causes([shares for _, _, shares in bars])
    rest = any(SMALLER in parts_of(shares, set(named)) for _, _, shares in bars)
    every = [*named, *([SMALLER] if rest else [])]
    return [(each, COLOURS_OF_CAUSES.get(each, "#ededed"), IS_COMMON.get(each, False))
            for each in every]  # fmt: skip


def _budgets(group: Group) -> list[tuple[str, str, Mapping[str, float]]]:
    """Name, half width and shares of the first numbers that say what they are made of."""
    display, bars = display_of(group), []
    for number in group.numbers:
        if not is_main(number.name) or number.name.partition(".")[2] not in {"", "1"}:
            continue
        budget = group_budget(number)
        shares = budget.of_mean or budget.of_tests
        if shares and number.mean is not None:
            shown = shown_in(number.name, number.unit, display)
            half = write_number(number.mean.chosen.half, None, shown.factor, digits=2).value
            words = f"\u00b1 {half} {unit_words(shown.unit)}" if budget.of_mean else "one test"
            bars.append((in_words(number.name.partition(".")[0]), words, shares))
    return bars[:_MOST_BARS]
