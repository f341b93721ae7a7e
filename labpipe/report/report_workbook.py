"""Workbook of a report: one sheet per question."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import count as numbers_from
from pathlib import Path
from typing import TypeAlias

from labpipe.records.group import Band, Campaign, Group, GroupNumber, MeanInterval
from labpipe.records.quality import worded
from labpipe.report.comparisons import Pair, context_words, field_words, single_field_pairs
from labpipe.report.detail_sheets import (
    Column,
    budgets_sheet,
    column_head,
    comparisons_sheet,
    interval_shares,
    issues_sheet,
    p_value,
    places_sheet,
    results_sheet,
    tests_sheet,
)
from labpipe.report.group_plots import group_scale
from labpipe.report.page_facts import (
    days_words,
    instrument_lines,
    operators_words,
    report_id,
    samples_of,
)
from labpipe.report.wording import (
    Scale,
    as_label,
    count_of,
    display_of,
    is_first_cycle,
    shown_in,
    unit_words,
)
from labpipe.report.workbook_file import (
    About,
    Chart,
    Line,
    NumberCell,
    Row,
    Sheet,
    Value,
    interval_cells,
    number_cell,
    percent_cell,
    save_book,
)

_ABOUT = (
    "Cells hold all digits of a number and show two digits of its interval. Lower and upper are the"
    " ends of 95 % intervals. An empty cell: not available. Every table has filters.",
    "The interval of a sample is the uncertainty of its measurement. The interval of a mean is for"
    " the mean of all such specimens, by Student's t with n - 1 degrees of freedom, including the"
    " causes common to all tests of a rig. On the scale 'log' its ends are mean / exp(h / mean) and"
    " mean x exp(h / mean), on 'linear' mean - h and mean + h; without common causes, h ="
    " T.INV.2T(0.05;n-1) x standard deviation / SQRT(n).",
    "Mean over: samples, or spool means if the samples of a spool are too similar.",
    "Curves: lower and upper are the pointwise band of the mean, 'whole curve' the band of the"
    " whole mean curve, at displacements at which every sample has data.",
    "Comparisons: 'lower' and 'upper' are Welch's 95 % interval of a single difference, p-values"
    " are for a single difference, too; 'corrected' ends are of the share (38 % for a ratio of"
    " 1.38), or else of the difference, at the level of Holm's correction for the family. A pair"
    " without a family differs in several fields.",
    "Outliers are marked in 'needs a look' and included in all means. Means include numbers with"
    " the status 'doubtful', but not 'failed'.",
    "Print: rows of means, without the rows of single tests of 'budgets'; of curves the charts.",
)


def save_workbook(campaign: Campaign, path: Path) -> None:
    """Write the tables of a report as an xlsx file.

    Parameters
    ----------
    campaign : all of it
    path : of the file

    Raises
    ------
    StoreError
        If it cannot be written.

    Notes
    -----
    At most eleven sheets after the first, for any number of groups.
    """
    footer = f"{campaign.title}  \u00b7  report {report_id(campaign)}"
    about = About(campaign.title, (*_facts(campaign), *_ABOUT), footer)
    save_book(about, list(_sheets(campaign)), path, again="make the report")


def _facts(campaign: Campaign) -> Iterator[str]:
    """Yield counts, days, operators and instruments."""
    samples = samples_of(campaign)
    tests = count_of(len(samples), "test")
    rejected = len(campaign.rejected)
    rejected_text = f", {count_of(rejected, 'test')} rejected" if rejected else ""
    yield f"{tests} in {count_of(len(campaign.groups), 'group')}{rejected_text}."
    if samples:
        yield f"Tested {days_words(samples)}; {operators_words(samples)}."
    for instrument_line in instrument_lines(samples):
        yield f"{instrument_line.name}: {instrument_line.due}."
    date = f" on {campaign.made_on}" if campaign.made_on is not None else ""
    by = f"labpipe {campaign.labpipe_version}".strip()
    yield f"Report {report_id(campaign)}, made{date} by {by}."


def _sheets(campaign: Campaign) -> Iterator[Sheet]:
    if pairs := single_field_pairs(campaign):
        yield _answers_sheet(pairs)
    yield _key_numbers_sheet(campaign)
    yield _means_sheet(campaign)
    yield tests_sheet(campaign)
    yield results_sheet(campaign)
    yield _curves_sheet(campaign, is_scaled=False)
    if any(group.band_scaled is not None for group in campaign.groups):
        yield _curves_sheet(campaign, is_scaled=True)
    yield comparisons_sheet(campaign)
    budgets = budgets_sheet(campaign)
    if budgets.rows:
        yield budgets
    if campaign.places:
        yield places_sheet(campaign)
    yield issues_sheet(campaign)


def _answers_sheet(pairs: Sequence[Pair]) -> Sheet:
    heads = (
        "comparison", "of", "number", "verdict", "difference (%)", "corrected lower (%)",
        "corrected upper (%)", "difference", "unit", "irrelevant below", "n", "n against",
        "why", "level (%)", "first", "second", "caveats",
    )  # fmt: skip
    question = "What is the verdict of each comparison: different, equivalent, or cannot tell?"
    rows = [_answer_row(pair) for pair in pairs]
    return Sheet("answers", heads, rows, 1, question=question, printed="why")


def _answer_row(pair: Pair) -> Row:
    difference = pair.differences[0]
    before, after = difference.fields[pair.field]
    scale = shown_in(difference.name, difference.unit, display_of(pair.first))
    lower, upper = interval_shares(difference)
    counts = difference.contrast.counts if difference.contrast is not None else (None, None)
    return (
        f"{field_words(pair.field)}: {after} against {before}",
        context_words((pair.first, pair.second), pair.field), as_label(difference.name),
        str(difference.verdict), percent_cell(difference.share), lower, upper,
        number_cell(difference.difference.mean, difference.difference.interval, scale.factor),
        unit_words(scale.unit), number_cell(difference.margin, None, scale.factor),
        *reversed(counts), difference.why,
        None if difference.interval is None else percent_cell(difference.interval.level),
        difference.first, difference.second, "; ".join(difference.caveats),
    )  # fmt: skip


def _key_numbers_sheet(campaign: Campaign) -> Sheet:
    """Return the sheet of key numbers, a row per group, sorted by protocol, with charts.

    The last columns hold the lengths of the error bars of the charts.
    """
    groups = sorted(campaign.groups, key=lambda group: group.protocol)
    keys_of_groups = [_key_numbers_of(group) for group in groups]
    columns = list(dict.fromkeys(column for group_keys in keys_of_groups for column in group_keys))
    heads = ["group", "protocol", "samples"]
    for column in columns:
        heads += [column_head(column, part) for part in ("", ", lower", ", upper")]
    last = heads[-1]
    heads += [column_head(column, part) for column in columns for part in (", down", ", up")]
    rows: list[Row] = []
    for group, group_keys in zip(groups, keys_of_groups, strict=True):
        ends = [group_keys.get(column, (None, None, None)) for column in columns]
        bars = [cell for end in ends for cell in _bar_lengths(end)]
        head = (group.name, group.protocol, len(group.samples))
        rows.append((*head, *(cell for end in ends for cell in end), *bars))
    charts = [_key_chart(keys_of_groups, columns, number) for number in range(len(columns))]
    question = "What are the key numbers of each group, with their 95 % intervals?"
    drawn = [chart for chart in charts if chart is not None]
    return Sheet("key numbers", heads, rows, 1, question=question, charts=drawn, printed=last)


_Ends: TypeAlias = tuple[NumberCell | None, NumberCell | None, NumberCell | None]
"""Mean, lower, upper."""


def _key_numbers_of(group: Group) -> dict[Column, _Ends]:
    """Return the first numbers of the specimen and of its first cycle."""
    numbers = [
        number
        for number in group.numbers
        if not number.is_set_by_rig and is_first_cycle(number.name)
    ]
    return dict(_key_number(group, number) for number in numbers[:3])


def _key_number(group: Group, number: GroupNumber) -> tuple[Column, _Ends]:
    scale = shown_in(number.name, number.unit, display_of(group))
    column = as_label(number.name), unit_words(scale.unit)
    if number.mean is None:
        return column, (None, None, None)
    chosen = number.mean.chosen
    return column, interval_cells(chosen.mean, chosen.interval, scale.factor)


def _bar_lengths(ends: _Ends) -> tuple[Value, Value]:
    """Return the lengths of the error bars of a chart, down and up."""
    mean, lower, upper = ends
    if mean is None or lower is None or upper is None:
        return None, None
    down, up = mean.value - lower.value, upper.value - mean.value
    return NumberCell(down, mean.form), NumberCell(up, mean.form)


def _key_chart(
    keys_of_groups: Sequence[dict[Column, _Ends]], columns: Sequence[Column], number: int
) -> Chart | None:
    """Return the bar chart of a number; None for a single group or negative means."""
    column = columns[number]
    means = {
        row: mean.value
        for row, group_keys in enumerate(keys_of_groups)
        if (mean := group_keys.get(column, (None,))[0]) is not None
    }
    if len(means) < 2 or min(means.values()) < 0.0:
        return None
    up, down = 3 + 3 * number, 3 + 3 * len(columns) + 2 * number
    line = Line(column[0], (min(means), max(means)), 0, up, down, down + 1)
    return Chart(f"{column[0]}, mean and 95 % interval", "", column_head(column), [line], "bars")


def _means_sheet(campaign: Campaign) -> Sheet:
    heads = (
        "group", "number", "over", "unit", "mean", "lower", "upper", "standard deviation", "n",
        "scale", "mean over", "n samples", "within spools", "between spools", "spools equal, p",
        "decision", "reason", "result",
    )  # fmt: skip
    rows = [
        row
        for group in campaign.groups
        for number in group.numbers
        for row in (_mean_row(group, number), *_spool_rows(group, number))
    ]
    question = "What is the mean of each number, of all samples and of each spool?"
    return Sheet("means", heads, rows, 2, question=question, printed="n samples")


def _mean_row(group: Group, number: GroupNumber) -> Row:
    scale = shown_in(number.name, number.unit, display_of(group))
    head = (group.name, as_label(number.name), "all", unit_words(scale.unit))
    mean = number.mean
    if mean is None:
        why = "; ".join(map(worded, number.left_out.values()))
        return (*head, *[None] * 11, "", why, number.name)
    spread = partial(number_cell, interval=mean.chosen.interval, factor=scale.factor)
    return (
        *head, *_mean_cells(mean.chosen, scale), "log" if mean.chosen.is_log else "linear",
        "samples" if mean.is_pooled else "spool means", mean.over_samples.n, spread(mean.within),
        spread(mean.between_spools), p_value(mean.spool_p), str(mean.decision),
        str(mean.chosen.reason or ""), number.name,
    )  # fmt: skip


def _spool_rows(group: Group, number: GroupNumber) -> Iterator[Row]:
    """Yield the means of several spools; for a single one it is the mean of all."""
    if number.mean is None or len(number.mean.spool_means) < 2:
        return
    scale = shown_in(number.name, number.unit, display_of(group))
    for spool, mean in number.mean.spool_means.items():
        head = (group.name, as_label(number.name), f"spool {spool}", unit_words(scale.unit))
        why = str(mean.reason or "")
        nothing = [None] * 5
        on = "log" if mean.is_log else "linear"
        yield (*head, *_mean_cells(mean, scale), on, *nothing, "", why, number.name)


def _mean_cells(mean: MeanInterval, scale: Scale) -> tuple[Value, ...]:
    """Return mean, ends, standard deviation and count."""
    spread = number_cell(mean.deviation, mean.interval, scale.factor)
    return (*interval_cells(mean.mean, mean.interval, scale.factor), spread, mean.n)


def _curves_sheet(campaign: Campaign, *, is_scaled: bool) -> Sheet:
    """Return the sheet of the mean curves of all groups, in common units."""
    first = next((group for group in campaign.groups if group.samples), None)
    metre, newton = Scale(1.0, "m"), Scale(1.0, "N")
    across = metre if first is None else group_scale(first, "displacement")
    up = newton if first is None else group_scale(first, "force")
    up = Scale(1.0, "1") if is_scaled else up
    unit = unit_words(up.unit)
    parts = ("mean", "lower", "upper", "lower, whole curve", "upper, whole curve")
    heads = (
        "group", across.label("displacement"), *(column_head((part, unit)) for part in parts), "n",
        "mean over", "reason",
    )  # fmt: skip
    rows: list[Row] = []
    places: dict[str, tuple[int, int]] = {}
    for group in campaign.groups:
        band = group.band_scaled if is_scaled else group.band
        if band is None:
            continue
        group_rows = list(_curve_rows(group, band, across, up))
        if len(band.displacement):
            places[group.name] = (len(rows), len(rows) + len(group_rows) - 1)
        rows += group_rows
    charts = list(_curve_charts(campaign, places, heads, is_scaled=is_scaled))
    name = "scaled curves" if is_scaled else "curves"
    what = "force over its peak" if is_scaled else "force"
    question = f"What is the mean {what} of each group against displacement, on first loading?"
    return Sheet(name, heads, rows, 1, question=question, charts=charts)


def _curve_rows(group: Group, band: Band, across: Scale, up: Scale) -> Iterator[Row]:
    why = str(band.reason or "")
    if not len(band.displacement):
        yield (group.name, *[None] * 8, why)
        return
    names = ("mean", "lower", "upper", "lower_all", "upper_all")
    columns = [(up.factor * getattr(band, name)).tolist() for name in names]
    x = (across.factor * band.displacement).tolist()
    for number, values in zip(numbers_from(), zip(x, *columns, strict=True), strict=False):
        yield (group.name, *values, band.n, band.members, "" if number else why)


def _curve_charts(
    campaign: Campaign, places: dict[str, tuple[int, int]], heads: Sequence[str], *, is_scaled: bool
) -> Iterator[Chart]:
    """Yield a chart for the groups of each protocol."""
    what = "Mean force over peak force" if is_scaled else "Mean force"
    up = "Force / peak force" if is_scaled else heads[2].replace("mean", "Force")
    for protocol in dict.fromkeys(group.protocol for group in campaign.groups):
        lines = [
            Line(group.name, places[group.name], 1, 2)
            for group in campaign.groups
            if group.protocol == protocol and group.name in places
        ]
        if lines:
            title = f"{what} on first loading ({protocol})"
            yield Chart(title, heads[1].replace("d", "D", 1), up, lines)
