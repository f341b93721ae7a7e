"""The workbook of a report: one sheet for each question that the tests of a campaign answer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import count as numbers_from
from pathlib import Path
from typing import TypeAlias

from labpipe.records.group import (
    Band,
    Campaign,
    Group,
    GroupNumber,
    MeanInterval,
)
from labpipe.records.quality import worded
from labpipe.report.comparisons import (
    Pair,
    answering_pairs,
    context_words,
    field_words,
)
from labpipe.report.detail_sheets import (
    Column,
    budgets_sheet,
    comparisons_sheet,
    headed,
    issues_sheet,
    p_value,
    places_sheet,
    results_sheet,
    shares_of,
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
    count_of,
    display_of,
    in_words,
    shown_in,
    unit_words,
)
from labpipe.report.workbook_cells import Row, Shown, Value, percent, shown, shown_with_ends
from labpipe.report.workbook_file import About, Chart, Line, Sheet, save_book

_KEY_NUMBERS = 3
"""Numbers of a group that are its key numbers."""
_ABOUT = (
    "Cells hold all digits of a number and show two digits of its interval. Lower and upper are the"
    " ends of 95 % intervals. An empty cell: there is no such number. Every table has filters.",
    "Of a sample, the interval says how well this one sample was measured. Of a mean, it is based"
    " on Student's t with n - 1 degrees of freedom, with what all tests of a rig share, and holds"
    " the mean of all such specimens. On the scale 'log' its ends are mean / exp(h / mean) and"
    " mean x exp(h / mean), on 'linear' mean - h and mean + h; without what tests share, h ="
    " T.INV.2T(0.05;n-1) x standard deviation / SQRT(n).",
    "Mean over: samples, or spool means where samples of one spool are too much alike.",
    "Curves: lower and upper hold the mean at one displacement, 'whole curve' the whole mean curve."
    " Only displacements at which every sample has data.",
    "Comparisons: 'lower' and 'upper' are Welch's 95 % interval of one difference alone, p-values"
    " are those of one alone, too; 'corrected' ends are of the share (38 % for 1.38 times as much),"
    " or without one of the difference, at the level that Holm's correction for the family leaves."
    " Without a family nobody asked.",
    "Outliers are marked in 'needs a look'; none was removed. A status 'doubtful' is in the means,"
    " 'failed' is not.",
    "On paper: rows of means go to paper, those of single tests of 'budgets' do not, and of curves"
    " the charts do.",
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
    At the most eleven sheets behind the first, however many groups there are.
    """
    footer = f"{campaign.title}  \u00b7  report {report_id(campaign)}"
    about = About(campaign.title, (*_facts(campaign), *_ABOUT), footer)
    save_book(about, list(_sheets(campaign)), path, again="make the report")


def _facts(campaign: Campaign) -> Iterator[str]:
    """Who tested what, when and with what."""
    samples = samples_of(campaign)
    tests = count_of(len(samples), "test")
    rejected = len(campaign.rejected)
    left = f", {count_of(rejected, 'test')} rejected" if rejected else ""
    yield f"{tests} in {count_of(len(campaign.groups), 'group')}{left}."
    if samples:
        yield f"Tested {days_words(samples)}; {operators_words(samples)}."
    for instrument_line in instrument_lines(samples):
        yield f"{instrument_line.name}: {instrument_line.due}."
    made = f" on {campaign.made_on}" if campaign.made_on is not None else ""
    by = f"labpipe {campaign.labpipe_version}".strip()
    yield f"Report {report_id(campaign)}, made{made} by {by}."


def _sheets(campaign: Campaign) -> Iterator[Sheet]:
    if pairs := answering_pairs(campaign):
        yield _answers(pairs)
    yield _key_numbers(campaign)
    yield _means(campaign)
    yield tests_sheet(campaign)
    yield results_sheet(campaign)
    yield _curves(campaign, is_scaled=False)
    if any(group.band_scaled is not None for group in campaign.groups):
        yield _curves(campaign, is_scaled=True)
    yield comparisons_sheet(campaign)
    budgets = budgets_sheet(campaign)
    if budgets.rows:
        yield budgets
    if campaign.places:
        yield places_sheet(campaign)
    yield issues_sheet(campaign)


def _answers(pairs: Sequence[Pair]) -> Sheet:
    heads = (
        "question", "of", "number", "answer", "difference (%)", "corrected lower (%)",
        "corrected upper (%)", "difference", "unit", "does not matter below", "n", "n against",
        "why", "level (%)", "first", "second", "what speaks against it",
    )  # fmt: skip
    asks = "What came of the questions: different, equivalent, or cannot tell?"
    rows = [_answer(pair) for pair in pairs]
    return Sheet("answers", heads, rows, 1, asks=asks, printed="why")


def _answer(pair: Pair) -> Row:
    asked = pair.differences[0]
    before, after = asked.fields[pair.field]
    scale = shown_in(asked.name, asked.unit, display_of(pair.first))
    lower, upper = shares_of(asked)
    counts = asked.contrast.counts if asked.contrast is not None else (None, None)
    return (
        f"{field_words(pair.field)}: {after} against {before}",
        context_words((pair.first, pair.second), pair.field), in_words(asked.name),
        str(asked.verdict), percent(asked.share), lower, upper,
        shown(asked.difference.mean, asked.difference.interval, scale.factor),
        unit_words(scale.unit), shown(asked.margin, None, scale.factor), *reversed(counts),
        asked.why, None if asked.interval is None else percent(asked.interval.level),
        asked.first, asked.second, "; ".join(asked.caveats),
    )  # fmt: skip


def _key_numbers(campaign: Campaign) -> Sheet:
    """Lay out a row for each group, those of one protocol together, with charts.

    The last columns hold the lengths of the error bars, which a chart takes from cells.
    """
    groups = sorted(campaign.groups, key=lambda group: group.protocol)
    found = [_keys(group) for group in groups]
    columns = list(dict.fromkeys(column for own in found for column in own))
    heads = ["group", "protocol", "samples"]
    for column in columns:
        heads += [headed(column, part) for part in ("", ", lower", ", upper")]
    last = heads[-1]
    heads += [headed(column, part) for column in columns for part in (", down", ", up")]
    rows: list[Row] = []
    for group, own in zip(groups, found, strict=True):
        ends = [own.get(column, (None, None, None)) for column in columns]
        bars = [cell for end in ends for cell in _whiskers(end)]
        head = (group.name, group.protocol, len(group.samples))
        rows.append((*head, *(cell for end in ends for cell in end), *bars))
    charts = [_key_chart(found, columns, at) for at in range(len(columns))]
    asks = "What are the key numbers of each group, with their 95 % intervals?"
    drawn = [chart for chart in charts if chart is not None]
    return Sheet("key numbers", heads, rows, 1, asks=asks, charts=drawn, printed=last)


_Ends: TypeAlias = tuple[Shown | None, Shown | None, Shown | None]
"""Mean, lower, upper."""


def _keys(group: Group) -> dict[Column, _Ends]:
    """First numbers of the specimen, of the first cycle where there are several."""
    own = [
        number
        for number in group.numbers
        if not number.is_set_by_rig and number.name.partition(".")[2] in {"", "1"}
    ]
    return dict(_key(group, each) for each in own[:_KEY_NUMBERS])


def _key(group: Group, number: GroupNumber) -> tuple[Column, _Ends]:
    scale = shown_in(number.name, number.unit, display_of(group))
    column = in_words(number.name), unit_words(scale.unit)
    if number.mean is None:
        return column, (None, None, None)
    chosen = number.mean.chosen
    return column, shown_with_ends(chosen.mean, chosen.interval, scale.factor)


def _whiskers(ends: _Ends) -> tuple[Value, Value]:
    """Length of the error bars of a chart, down and up."""
    mean, lower, upper = ends
    if mean is None or lower is None or upper is None:
        return None, None
    down, up = mean.value - lower.value, upper.value - mean.value
    return Shown(down, mean.form), Shown(up, mean.form)


def _key_chart(
    found: Sequence[dict[Column, _Ends]], columns: Sequence[Column], at: int
) -> Chart | None:
    """Bars of a number over the groups that have it; None for one group, and for negative means."""
    column = columns[at]
    means = {
        row: mean.value
        for row, own in enumerate(found)
        if (mean := own.get(column, (None,))[0]) is not None
    }
    if len(means) < 2 or min(means.values()) < 0.0:
        return None
    up, down = 3 + 3 * at, 3 + 3 * len(columns) + 2 * at
    line = Line(column[0], (min(means), max(means)), 0, up, down, down + 1)
    return Chart(f"{column[0]}, mean and 95 % interval", "", headed(column), [line], "bars")


def _means(campaign: Campaign) -> Sheet:
    heads = (
        "group", "number", "over", "unit", "mean", "lower", "upper", "standard deviation", "n",
        "scale", "mean over", "n samples", "within spools", "between spools", "spools alike, p",
        "decision", "reason", "result",
    )  # fmt: skip
    rows = [
        row
        for group in campaign.groups
        for number in group.numbers
        for row in (_mean(group, number), *_spools(group, number))
    ]
    asks = "What is the mean of each number, over all samples and over those of each spool?"
    return Sheet("means", heads, rows, 2, asks=asks, printed="n samples")


def _mean(group: Group, number: GroupNumber) -> Row:
    scale = shown_in(number.name, number.unit, display_of(group))
    head = (group.name, in_words(number.name), "all", unit_words(scale.unit))
    mean = number.mean
    if mean is None:
        why = "; ".join(map(worded, number.left_out.values()))
        return (*head, *[None] * 11, "", why, number.name)
    spread = partial(shown, interval=mean.chosen.interval, factor=scale.factor)
    return (
        *head, *_numbers(mean.chosen, scale), "log" if mean.chosen.is_log else "linear",
        "samples" if mean.is_pooled else "spool means", mean.over_samples.n, spread(mean.within),
        spread(mean.between), p_value(mean.spool_p), str(mean.decision),
        str(mean.chosen.reason or ""), number.name,
    )  # fmt: skip


def _spools(group: Group, number: GroupNumber) -> Iterator[Row]:
    """Means of several spools; that of a single one is the mean of all."""
    if number.mean is None or len(number.mean.spool_means) < 2:
        return
    scale = shown_in(number.name, number.unit, display_of(group))
    for spool, mean in number.mean.spool_means.items():
        head = (group.name, in_words(number.name), f"spool {spool}", unit_words(scale.unit))
        why = str(mean.reason or "")
        nothing = [None] * 5
        on = "log" if mean.is_log else "linear"
        yield (*head, *_numbers(mean, scale), on, *nothing, "", why, number.name)


def _numbers(mean: MeanInterval, scale: Scale) -> tuple[Value, ...]:
    """Mean, ends, standard deviation and count."""
    spread = shown(mean.deviation, mean.interval, scale.factor)
    return (*shown_with_ends(mean.mean, mean.interval, scale.factor), spread, mean.n)


def _curves(campaign: Campaign, *, is_scaled: bool) -> Sheet:
    """Lay out the mean curves of all groups below each other, in one unit for all."""
    first = next((group for group in campaign.groups if group.samples), None)
    metre, newton = Scale(1.0, "m"), Scale(1.0, "N")
    across = metre if first is None else group_scale(first, "displacement")
    up = newton if first is None else group_scale(first, "force")
    up = Scale(1.0, "1") if is_scaled else up
    unit = unit_words(up.unit)
    parts = ("mean", "lower", "upper", "lower, whole curve", "upper, whole curve")
    heads = (
        "group", across.label("displacement"), *(headed((part, unit)) for part in parts), "n",
        "mean over", "reason",
    )  # fmt: skip
    rows: list[Row] = []
    places: dict[str, tuple[int, int]] = {}
    for group in campaign.groups:
        band = group.band_scaled if is_scaled else group.band
        if band is None:
            continue
        own = list(_curve(group, band, across, up))
        if len(band.displacement):
            places[group.name] = (len(rows), len(rows) + len(own) - 1)
        rows += own
    charts = list(_curve_charts(campaign, places, heads, is_scaled=is_scaled))
    name = "scaled curves" if is_scaled else "curves"
    what = "force over its peak" if is_scaled else "force"
    asks = f"What is the mean {what} of each group against displacement, on first loading?"
    return Sheet(name, heads, rows, 1, asks=asks, charts=charts)


def _curve(group: Group, band: Band, across: Scale, up: Scale) -> Iterator[Row]:
    why = str(band.reason or "")
    if not len(band.displacement):
        yield (group.name, *[None] * 8, why)
        return
    names = ("mean", "lower", "upper", "lower_all", "upper_all")
    columns = [(up.factor * getattr(band, name)).tolist() for name in names]
    x = (across.factor * band.displacement).tolist()
    for number, values in zip(numbers_from(), zip(x, *columns, strict=True), strict=False):
        yield (group.name, *values, band.n, band.over, "" if number else why)


def _curve_charts(
    campaign: Campaign,
    places: dict[str, tuple[int, int]],
    heads: Sequence[str],
    *,
    is_scaled: bool,
) -> Iterator[Chart]:
    """Draw the groups of each protocol together."""
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
