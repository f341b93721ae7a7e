"""Workbook of a campaign's report: one sheet per question."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from labpipe.records.causes import IS_COMMON
from labpipe.records.curve import Interval
from labpipe.records.group import (
    Band,
    Campaign,
    Difference,
    Group,
    GroupNumber,
    MeanInterval,
    Sample,
)
from labpipe.records.quality import worded
from labpipe.records.result import Result, Status
from labpipe.report.budget_figures import sort_causes
from labpipe.report.bundle_figures import place_scales
from labpipe.report.comparisons import (
    Pair,
    context_words,
    field_words,
    fields_in_words,
    multi_field_differences,
    single_field_pairs,
)
from labpipe.report.issues import Cause, Issue, find_causes, find_notes
from labpipe.report.page_facts import (
    days_words,
    instrument_lines,
    operators_words,
    report_id,
    samples_of,
    state_of,
)
from labpipe.report.wording import (
    Scale,
    as_label,
    count_of,
    display_of,
    group_scale,
    is_main,
    key_numbers,
    shown_in,
    unit_words,
)
from labpipe.report.workbook_file import (
    About,
    Chart,
    Line,
    Record,
    Sheet,
    array_records,
    ends_record,
    how_to_read,
    number_cell,
    percent_cell,
    save_book,
    sheet_of,
    stack_blocks,
    unite_heads,
)
from labpipe.statistics.means import group_budget

BOOK = "report"
"""Name of the workbook in ``workbooks.toml``."""


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
    about = About(campaign.title, (*_facts(campaign), *how_to_read(BOOK)), footer)
    save_book(about, list(_sheets(campaign)), path)


def _facts(campaign: Campaign) -> Iterator[str]:
    """Yield counts, days, operators and instruments."""
    samples, rejected = samples_of(campaign), len(campaign.rejected)
    text = f"{count_of(len(samples), 'test')} in {count_of(len(campaign.groups), 'group')}"
    yield f"{text}, {count_of(rejected, 'test')} rejected." if rejected else f"{text}."
    if samples:
        yield f"Tested {days_words(samples)}; {operators_words(samples)}."
    for instrument in instrument_lines(samples):
        yield f"{instrument.name}: {instrument.due}."
    date = f" on {campaign.made_on}" if campaign.made_on is not None else ""
    by = f"labpipe {campaign.labpipe_version}".strip()
    yield f"Report {report_id(campaign)}, made{date} by {by}."


def _sheets(campaign: Campaign) -> Iterator[Sheet]:
    if pairs := single_field_pairs(campaign):
        yield sheet_of(BOOK, "answers", map(_answer, pairs))
    by_protocol = sorted(campaign.groups, key=lambda group: group.protocol)
    yield sheet_of(BOOK, "key numbers", map(_key_record, by_protocol))
    yield sheet_of(BOOK, "means", _means(campaign))
    yield _tests_sheet(campaign)
    results = (
        {"group": group.name, "test": sample.test, **_result(sample, result)}
        for group in campaign.groups
        for sample in group.samples
        for result in sample.results
    )
    yield sheet_of(BOOK, "results", results)
    yield _curves_sheet(campaign, is_scaled=False)
    if any(group.band_scaled is not None for group in campaign.groups):
        yield _curves_sheet(campaign, is_scaled=True)
    single_field = [difference for difference in campaign.differences if difference.family]
    displays = {group.name: display_of(group) for group in campaign.groups}
    differences = [
        _difference(difference, displays.get(difference.first, {}))
        for difference in (*single_field, *multi_field_differences(campaign))
    ]
    yield sheet_of(BOOK, "comparisons", differences)
    if budgets := _budgets(campaign):
        yield sheet_of(BOOK, "budgets", budgets)
    if campaign.places:
        yield sheet_of(BOOK, "slipping and sticking", _places(campaign))
    ranked = [(rank, cause) for rank, cause in enumerate(find_causes(campaign), start=1)]
    causes = [*ranked, *((None, note) for note in find_notes(campaign))]
    issues = (_issue(rank, cause, issue) for rank, cause in causes for issue in cause.issues)
    yield sheet_of(BOOK, "needs a look", issues)


def _answer(pair: Pair) -> Record:
    """Return the verdict on the first main number of a pair."""
    difference = pair.differences[0]
    before, after = difference.fields[pair.field]
    counts = difference.contrast.counts if difference.contrast is not None else (None, None)
    record = _difference(difference, display_of(pair.first))
    return {
        "comparison": f"{field_words(pair.field)}: {after} against {before}",
        "of": context_words((pair.first, pair.second), pair.field),
        "number": record["number"],
        "verdict": record["verdict"],
        "difference (%)": record["share (%)"],
        "corrected lower (%)": record["corrected lower (%)"],
        "corrected upper (%)": record["corrected upper (%)"],
        "difference": record["second minus first"],
        "n": counts[1],
        "n against": counts[0],
        "why": difference.why,
        **{head: record[head] for head in ("unit", "irrelevant below", "level (%)")},
        "first": difference.first,
        "second": difference.second,
        "caveats": "; ".join(difference.caveats),
    }


def _key_record(group: Group) -> Record:
    """Return the first numbers of the specimen and of its first cycle, a row per group."""
    row: Record = {
        "group": group.name, "protocol": group.protocol, "samples": len(group.samples)
    }  # fmt: skip
    for number in key_numbers(group)[:3]:
        scale = shown_in(number.name, number.unit, display_of(group))
        cells = _mean_cells(None if number.mean is None else number.mean.chosen, scale)
        name, unit = as_label(number.name), unit_words(scale.unit)
        parts = zip(("", ", lower", ", upper"), cells.values(), strict=True)
        row |= {column_head(name, unit, part): cell for part, cell in parts}
    return row


def _mean_cells(mean: MeanInterval | None, scale: Scale) -> Record:
    """Return a mean and the ends of its interval; empty cells without a mean."""
    if mean is None:
        return ends_record(None, None, name="mean")
    return ends_record(mean.mean, mean.interval, scale.factor, name="mean")


def column_head(name: str, unit: str, part: str = "") -> str:
    """Write the heading of a column: name, part and unit."""
    return f"{name}{part} ({unit})" if unit else f"{name}{part}"


def _means(campaign: Campaign) -> Iterator[Record]:
    """Yield the mean of each number over all samples, and over each spool if there are several."""
    for group in campaign.groups:
        for number in group.numbers:
            mean = number.mean
            if mean is None:
                why = "; ".join(map(worded, number.left_out.values()))
                yield _mean_record(group, number, None, "all") | {"reason": why}
                continue
            scale = shown_in(number.name, number.unit, display_of(group))
            within, between = (
                number_cell(spread, mean.chosen.interval, scale.factor)
                for spread in (mean.within, mean.between_spools)
            )
            yield _mean_record(group, number, mean.chosen, "all") | {
                "mean over": "samples" if mean.is_pooled else "spool means",
                "n samples": mean.over_samples.n,
                "within spools": within,
                "between spools": between,
                "spools equal, p": number_cell(mean.spool_p, None),
                "decision": str(mean.decision),
            }
            for spool, of_spool in mean.spool_means.items() if len(mean.spool_means) > 1 else ():
                yield _mean_record(group, number, of_spool, f"spool {spool}")


def _mean_record(group: Group, number: GroupNumber, mean: MeanInterval | None, over: str) -> Record:
    scale = shown_in(number.name, number.unit, display_of(group))
    head: Record = {
        "group": group.name, "number": as_label(number.name), "over": over,
        "unit": unit_words(scale.unit), **_mean_cells(mean, scale),
    }  # fmt: skip
    if mean is None:
        return {**head, "reason": "", "result": number.name}
    return {
        **head,
        "standard deviation": number_cell(mean.deviation, mean.interval, scale.factor),
        "n": mean.n,
        "scale": "log" if mean.is_log else "linear",
        **dict.fromkeys(_OF_ALL_SAMPLES),
        "reason": str(mean.reason or ""),
        "result": number.name,
    }


_OF_ALL_SAMPLES: tuple[str, ...] = (
    "mean over", "n samples", "within spools", "between spools", "spools equal, p", "decision"
)  # fmt: skip
"""Columns that the means of single spools leave empty."""


def _tests_sheet(campaign: Campaign) -> Sheet:
    """Return the sheet of tests, rejected ones last, with a column per number."""
    last = ("decision", "key of the run")
    every = [(group.name, sample) for group in campaign.groups for sample in group.samples]
    every += [("", sample) for sample in campaign.rejected_samples]
    records = [_test(group, sample) for group, sample in every]
    heads = [*(head for head in unite_heads(records) if head not in last), *last]
    return sheet_of(BOOK, "tests", records, heads=heads)


def _test(group: str, sample: Sample) -> Record:
    specimen = sample.specimen
    main = [result for result in sample.results if is_main(result.name)]
    numbers: Record = {}
    for result in main:
        scale = shown_in(result.name, result.unit, sample.display)
        head = column_head(as_label(result.name), unit_words(scale.unit))
        numbers[head] = number_cell(result.value, result.interval, scale.factor)
    sizes = {f"{name.replace('_', ' ')} (mm)": 1e3 * size
             for name, size in specimen.dimensions.items()}  # fmt: skip
    return {
        "test": sample.test,
        "group": group,
        "state": state_of(sample) if group else "rejected",
        "type": specimen.type,
        "spool": specimen.spool,
        "sample": specimen.sample,
        "protocol": sample.protocol,
        "day": "" if sample.date is None else str(sample.date),
        "operator": sample.operator,
        **sizes,
        "doubtful numbers": sum(result.status is Status.DOUBTFUL for result in main),
        "failed numbers": sum(result.status is Status.FAILED for result in main),
        **numbers,
        "decision": sample.decided,
        "key of the run": sample.run,
    }


def _result(sample: Sample, result: Result) -> Record:
    scale = shown_in(result.name, result.unit, sample.display)
    return {
        "number": as_label(result.name),
        "unit": unit_words(scale.unit),
        **ends_record(result.value, result.interval, scale.factor, name="value"),
        "estimate": number_cell(result.estimate, result.interval, scale.factor),
        "status": str(result.status),
        "reason": result.why,
        "result": result.name,
        "method": result.how,
    }


_BAND_COLUMNS = {
    "mean": "mean", "lower": "lower", "upper": "upper",
    "lower, whole curve": "lower_all", "upper, whole curve": "upper_all",
}  # fmt: skip
"""Field of a band by the name of its column."""


def _curves_sheet(campaign: Campaign, *, is_scaled: bool) -> Sheet:
    """Return the sheet of the mean curves of all groups in common units, a chart per protocol."""
    first = next((group for group in campaign.groups if group.samples), None)
    across, up = Scale(1.0, "m"), Scale(1.0, "N")
    if first is not None:
        across, up = group_scale(first, "displacement"), group_scale(first, "force")
    up = Scale(1.0, "") if is_scaled else up
    bands = {group: group.band_scaled if is_scaled else group.band for group in campaign.groups}
    blocks = {
        group.name: _band_records(group.name, band, across, up)
        for group, band in bands.items()
        if band is not None
    }
    rows, ends = stack_blocks(blocks)
    lines: dict[str, list[Line]] = {}
    for group, band in bands.items():
        if band is not None and len(band.displacement):
            lines.setdefault(group.protocol, []).append(Line(group.name, ends[group.name], 1, 2))
    title, label = ("Mean force", up.label("Force"))
    if is_scaled:
        title, label = ("Mean force over peak force", "Force / peak force")
    charts = [
        Chart(f"{title} on first loading ({protocol})", across.label("Displacement"), label, own)
        for protocol, own in lines.items()
    ]
    columns = [column_head(part, up.unit) for part in _BAND_COLUMNS]
    heads = ["group", across.label("displacement"), *columns, "n", "mean over", "reason"]
    name = "scaled curves" if is_scaled else "curves"
    return sheet_of(BOOK, name, rows, heads=heads, charts=charts)


def _band_records(group: str, band: Band, across: Scale, up: Scale) -> list[Record]:
    """Return a record per point of a mean curve; the first, or the only one, has the reason."""
    columns = {across.label("displacement"): across.factor * band.displacement}
    for part, field in _BAND_COLUMNS.items():
        columns[column_head(part, up.unit)] = up.factor * getattr(band, field)
    points = array_records({"group": group, "n": band.n, "mean over": band.members}, columns)
    first, *others = points or [{"group": group}]
    return [first | {"reason": str(band.reason or "")}, *others]


def _difference(difference: Difference, display: Mapping[str, str]) -> Record:
    """Return the difference of two groups in one number."""
    shift, ends = difference.difference, difference.interval
    scale = shown_in(difference.name, difference.unit, display)
    in_unit, of_share = (ends, None) if difference.share is None else (None, ends)
    corrected = ends_record(shift.mean, in_unit, scale.factor)
    return {
        "first": difference.first,
        "second": difference.second,
        "number": as_label(difference.name),
        "unit": unit_words(scale.unit),
        **ends_record(shift.mean, shift.interval, scale.factor, name="second minus first"),
        "share (%)": percent_cell(difference.share),
        "corrected lower (%)": percent_cell(of_share, "lower"),
        "corrected upper (%)": percent_cell(of_share, "upper"),
        "corrected lower": corrected["lower"],
        "corrected upper": corrected["upper"],
        "verdict": str(difference.verdict),
        "question": difference.question,
        "differ in": fields_in_words(difference),
        "level (%)": percent_cell(ends, "level"),
        "irrelevant below": number_cell(difference.margin, None, scale.factor),
        "different, p": number_cell(difference.p, None),
        "equivalent, p": number_cell(difference.p_equivalent, None),
        "family": difference.family,
        "in family": difference.tests or None,
        "why": "; ".join(filter(None, (difference.why, *difference.caveats))),
        "reason": str(shift.reason or ""),
        "result": difference.name,
    }


def _budgets(campaign: Campaign) -> list[Record]:
    """Return the shares of the causes for the mean of each number, and their medians over tests."""
    rows: list[tuple[Record, Mapping[str, float]]] = []
    for group in campaign.groups:
        for number in group.numbers:
            budget = group_budget(number)
            if budget.of_tests and budget.of_mean and number.mean is not None:
                interval = number.mean.chosen.interval
                head = _budget_head(group, number, "mean of the group", interval)
                rows.append((head, budget.of_mean))
            if budget.of_tests:
                head = _budget_head(group, number, "median of the tests", None)
                rows.append((head, budget.of_tests))
    causes = sort_causes(cause for _, shares in rows for cause in shares)
    heads = {cause: f"{cause}{'*' * IS_COMMON.get(cause, False)} (%)" for cause in causes}
    return [
        head | {heads[cause]: percent_cell(shares.get(cause)) for cause in causes}
        for head, shares in rows
    ]


def _budget_head(group: Group, number: GroupNumber, of: str, interval: Interval | None) -> Record:
    scale = shown_in(number.name, number.unit, display_of(group))
    half = None if interval is None else 0.5 * (interval.upper - interval.lower)
    return {
        "group": group.name,
        "number": as_label(number.name),
        "of": of,
        "unit": unit_words(scale.unit),
        "half of the 95 % interval": number_cell(half, None, scale.factor),
    }


def _places(campaign: Campaign) -> Iterator[Record]:
    """Yield the bending stiffness of each bundle between the bounds of its model."""
    scales = place_scales(campaign)
    for place in campaign.places:
        scale, ends = scales[place.group], place.share_interval
        bounds = {
            "all slips": place.low,
            "wires slip": place.free,
            "nothing slips": place.high,
            "smallest of all directions": place.principal[0],
            "largest of all directions": place.principal[1],
        }
        yield {
            "group": place.group,
            "test": place.test or "mean",
            "unit": unit_words(scale.unit),
            **ends_record(place.value, place.interval, scale.factor, name="bending stiffness"),
            **{head: number_cell(value, None, scale.factor) for head, value in bounds.items()},
            "share (%)": percent_cell(place.share),
            "share lower (%)": percent_cell(ends, "lower"),
            "share upper (%)": percent_cell(ends, "upper"),
            "reason": worded(place.reasons),
        }


def _issue(rank: int | None, cause: Cause, issue: Issue) -> Record:
    return {
        "rank": rank,
        "kind": str(issue.kind),
        "group": issue.group,
        "test": issue.test or ", ".join(issue.tests),
        "what": issue.what,
        "reason": issue.reason,
        "largest effect of the cause": "" if cause.effect is None else cause.effect.text,
        "code": issue.code,
    }
