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
    Lot,
    MeanInterval,
    Sample,
)
from labpipe.records.quality import join_reasons
from labpipe.records.result import Result, Status
from labpipe.report.bundle_figures import choose_stiffness_units
from labpipe.report.comparisons import (
    describe_fields,
    list_multi_field_differences,
)
from labpipe.report.issues import Cause, Issue, find_causes, find_notes
from labpipe.report.lot_tables import make_lot_record, make_verdict_cells
from labpipe.report.page_facts import (
    compute_report_id,
    describe_days,
    describe_operators,
    find_state,
    list_instruments,
    list_samples,
)
from labpipe.report.wording import (
    Scale,
    find_display,
    find_display_unit,
    find_number_unit,
    find_units,
    is_main,
    typeset_unit,
    write_count,
    write_label,
)
from labpipe.report.workbook_file import (
    About,
    Chart,
    Line,
    Record,
    Sheet,
    how_to_read,
    make_interval_cells,
    make_number_cell,
    make_percent_cell,
    make_records,
    make_sheet,
    save_book,
    stack_blocks,
    unite_heads,
)
from labpipe.statistics.means import sort_causes, summarise_budget

BOOK = "report"
"""Name of the workbook in ``workbooks.toml``."""


def save_workbook(campaign: Campaign, path: Path) -> None:
    """Write the workbook of a report as an xlsx file.

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
    At most twelve sheets after the first, for any number of groups.
    """
    footer = f"{campaign.title}  \u00b7  report {compute_report_id(campaign)}"
    about = About(campaign.title, (*_facts(campaign), *how_to_read(BOOK)), footer)
    save_book(about, list(_sheets(campaign)), path)


def _facts(campaign: Campaign) -> Iterator[str]:
    """Yield counts, days, operators and instruments."""
    samples, rejected = list_samples(campaign), len(campaign.rejected)
    text = f"{write_count(len(samples), 'test')} in {write_count(len(campaign.groups), 'group')}"
    yield f"{text}, {write_count(rejected, 'test')} rejected." if rejected else f"{text}."
    if samples:
        yield f"Tested {describe_days(samples)}; {describe_operators(samples)}."
    for instrument in list_instruments(samples):
        yield f"{instrument.name}: {instrument.due}."
    date = f" on {campaign.made_on}" if campaign.made_on is not None else ""
    by = f"labpipe {campaign.labpipe_version}".strip()
    yield f"Report {compute_report_id(campaign)}, made{date} by {by}."


def _sheets(campaign: Campaign) -> Iterator[Sheet]:
    lots = [make_lot_record(group, group.lot) for group in campaign.groups if group.lot]
    if lots:
        yield make_sheet(BOOK, "lots", lots)
    yield make_sheet(BOOK, "means", _means(campaign))
    yield _tests_sheet(campaign)
    results = (
        {"group": group.name, "test": sample.test, **_result(sample, result)}
        for group in campaign.groups
        for sample in group.samples
        for result in sample.results
    )
    yield make_sheet(BOOK, "results", results)
    yield _curves_sheet(campaign, is_scaled=False)
    if any(group.band_scaled is not None for group in campaign.groups):
        yield _curves_sheet(campaign, is_scaled=True)
    single_field = [difference for difference in campaign.differences if difference.family]
    displays = {group.name: find_display(group) for group in campaign.groups}
    differences = [
        _difference(difference, displays.get(difference.first, {}))
        for difference in (*single_field, *list_multi_field_differences(campaign))
    ]
    yield make_sheet(BOOK, "comparisons", differences)
    if budgets := _budgets(campaign):
        yield make_sheet(BOOK, "budgets", budgets)
    if campaign.bounded_stiffnesses:
        yield make_sheet(BOOK, "slipping and sticking", _record_bounds(campaign))
    ranked = [(rank, cause) for rank, cause in enumerate(find_causes(campaign), start=1)]
    causes = [*ranked, *((None, note) for note in find_notes(campaign))]
    issues = (_issue(rank, cause, issue) for rank, cause in causes for issue in cause.issues)
    yield make_sheet(BOOK, "needs a look", issues)


def _mean_cells(mean: MeanInterval | None, scale: Scale) -> Record:
    """Make the cells of a mean and the ends of its interval; they are empty without a mean."""
    if mean is None:
        return make_interval_cells(None, None, name="mean")
    return make_interval_cells(mean.mean, mean.interval, scale.factor, name="mean")


def write_column_heading(name: str, unit: str, part: str = "") -> str:
    """Write the heading of a column: name, part and unit."""
    return f"{name}{part} ({unit})" if unit else f"{name}{part}"


def _means(campaign: Campaign) -> Iterator[Record]:
    """Yield the mean of each number over all samples, and over each spool if there are several."""
    for group in campaign.groups:
        for number in group.numbers:
            mean = number.mean
            if mean is None:
                why = "; ".join(map(join_reasons, number.left_out.values()))
                yield _mean_record(group, number, None, "all") | {"reason": why}
                continue
            scale = find_number_unit(group, number)
            within, between = (
                make_number_cell(spread, mean.chosen.interval, scale.factor)
                for spread in (mean.within, mean.between_spools)
            )
            yield _mean_record(group, number, mean.chosen, "all") | {
                "mean over": "samples" if mean.is_pooled else "spool means",
                "n samples": mean.over_samples.n,
                "within spools": within,
                "between spools": between,
                "spools equal, p": make_number_cell(mean.spool_p, None),
                "decision": str(mean.decision),
            }
            for spool, of_spool in mean.spool_means.items() if len(mean.spool_means) > 1 else ():
                yield _mean_record(group, number, of_spool, f"spool {spool}")


def _mean_record(group: Group, number: GroupNumber, mean: MeanInterval | None, over: str) -> Record:
    scale = find_number_unit(group, number)
    head: Record = {
        "group": group.name, "number": write_label(number.name), "over": over,
        "unit": typeset_unit(scale.unit), **_mean_cells(mean, scale),
    }  # fmt: skip
    if mean is None:
        return {**head, "reason": "", "result": number.name}
    return {
        **head,
        "standard deviation": make_number_cell(mean.deviation, mean.interval, scale.factor),
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
    """Make the sheet of tests with a column per number; rejected tests are last."""
    last = ("decision", "key of the run")
    every = [(group.name, sample) for group in campaign.groups for sample in group.samples]
    every += [("", sample) for sample in campaign.rejected_samples]
    lots = {group.name: group.lot for group in campaign.groups}
    records = [_test(group, sample, lots.get(group)) for group, sample in every]
    heads = [*(head for head in unite_heads(records) if head not in last), *last]
    return make_sheet(BOOK, "tests", records, heads=heads)


def _test(group: str, sample: Sample, lot: Lot | None) -> Record:
    specimen = sample.specimen
    main = [result for result in sample.results if is_main(result.name)]
    numbers: Record = {}
    for result in main:
        scale = find_display_unit(result.name, result.unit, sample.display)
        head = write_column_heading(write_label(result.name), typeset_unit(scale.unit))
        numbers[head] = make_number_cell(result.value, result.interval, scale.factor)
    sizes = {f"{name.replace('_', ' ')} (mm)": 1e3 * size
             for name, size in specimen.dimensions.items()}  # fmt: skip
    return {
        "test": sample.test,
        "group": group,
        "state": find_state(sample) if group else "rejected",
        "type": specimen.type,
        "spool": specimen.spool,
        "sample": specimen.sample,
        "protocol": sample.protocol,
        "day": "" if sample.date is None else str(sample.date),
        "operator": sample.operator,
        **make_verdict_cells(sample, lot),
        **sizes,
        "doubtful numbers": sum(result.status is Status.DOUBTFUL for result in main),
        "failed numbers": sum(result.status is Status.FAILED for result in main),
        **numbers,
        "decision": sample.decision,
        "key of the run": sample.run,
    }


def _result(sample: Sample, result: Result) -> Record:
    scale = find_display_unit(result.name, result.unit, sample.display)
    return {
        "number": write_label(result.name),
        "unit": typeset_unit(scale.unit),
        **make_interval_cells(result.value, result.interval, scale.factor, name="value"),
        "estimate": make_number_cell(result.estimate, result.interval, scale.factor),
        "status": str(result.status),
        "reason": result.reason_text,
        "result": result.name,
        "method": result.full_method,
    }


_BAND_COLUMNS = {
    "mean": "mean", "lower": "lower", "upper": "upper",
    "lower, whole curve": "lower_all", "upper, whole curve": "upper_all",
}  # fmt: skip
"""Field of a band by the name of its column."""


def _curves_sheet(campaign: Campaign, *, is_scaled: bool) -> Sheet:
    """Make the sheet of the mean curves of all groups in common units, a chart per protocol."""
    first = next((group for group in campaign.groups if group.samples), None)
    x_unit, y_unit = Scale(1.0, "m"), Scale(1.0, "N")
    if first is not None:
        x_unit, y_unit = find_units(find_display(first), "displacement", "force")
    y_unit = Scale(1.0, "") if is_scaled else y_unit
    bands = {group: group.band_scaled if is_scaled else group.band for group in campaign.groups}
    blocks = {
        group.name: _band_records(group.name, band, x_unit, y_unit)
        for group, band in bands.items()
        if band is not None
    }
    rows, ends = stack_blocks(blocks)
    lines: dict[str, list[Line]] = {}
    for group, band in bands.items():
        if band is not None and len(band.displacement):
            lines.setdefault(group.protocol, []).append(Line(group.name, ends[group.name], 1, 2))
    title, label = ("Mean force", y_unit.label("Force"))
    if is_scaled:
        title, label = ("Mean force over peak force", "Force / peak force")
    charts = [
        Chart(f"{title} on first loading ({protocol})", x_unit.label("Displacement"), label, own)
        for protocol, own in lines.items()
    ]
    columns = [write_column_heading(part, y_unit.unit) for part in _BAND_COLUMNS]
    heads = ["group", x_unit.label("displacement"), *columns, "n", "mean over", "reason"]
    name = "scaled curves" if is_scaled else "curves"
    return make_sheet(BOOK, name, rows, heads=heads, charts=charts)


def _band_records(group: str, band: Band, x_unit: Scale, y_unit: Scale) -> list[Record]:
    """Make a record per point of a mean curve, at least one; the first holds the reason."""
    columns = {x_unit.label("displacement"): x_unit.factor * band.displacement}
    for part, field in _BAND_COLUMNS.items():
        columns[write_column_heading(part, y_unit.unit)] = y_unit.factor * getattr(band, field)
    points = make_records({"group": group, "n": band.n, "mean over": band.members}, columns)
    first, *others = points or [{"group": group}]
    return [first | {"reason": str(band.reason or "")}, *others]


def _difference(difference: Difference, display: Mapping[str, str]) -> Record:
    """Make the record of the difference of two groups in one number."""
    shift, ends = difference.difference, difference.interval
    scale = find_display_unit(difference.name, difference.unit, display)
    in_unit, of_share = (ends, None) if difference.share is None else (None, ends)
    corrected = make_interval_cells(shift.mean, in_unit, scale.factor)
    return {
        "first": difference.first,
        "second": difference.second,
        "number": write_label(difference.name),
        "unit": typeset_unit(scale.unit),
        **make_interval_cells(shift.mean, shift.interval, scale.factor, name="second minus first"),
        "share (%)": make_percent_cell(difference.share),
        "corrected lower (%)": make_percent_cell(of_share, "lower"),
        "corrected upper (%)": make_percent_cell(of_share, "upper"),
        "corrected lower": corrected["lower"],
        "corrected upper": corrected["upper"],
        "verdict": str(difference.verdict),
        "question": difference.single_field,
        "differ in": describe_fields(difference),
        "level (%)": make_percent_cell(ends, "level"),
        "irrelevant below": make_number_cell(difference.margin, None, scale.factor),
        "different, p": make_number_cell(difference.p, None),
        "equivalent, p": make_number_cell(difference.p_equivalent, None),
        "family": difference.family,
        "in family": difference.tests or None,
        "why": "; ".join(filter(None, (difference.verdict_reason, *difference.caveats))),
        "reason": str(shift.reason or ""),
        "result": difference.name,
    }


def _budgets(campaign: Campaign) -> list[Record]:
    """Make the records of the shares of causes: of each mean, and their medians over the tests."""
    rows: list[tuple[Record, Mapping[str, float]]] = []
    for group in campaign.groups:
        for number in group.numbers:
            budget = summarise_budget(number)
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
        head | {heads[cause]: make_percent_cell(shares.get(cause)) for cause in causes}
        for head, shares in rows
    ]


def _budget_head(group: Group, number: GroupNumber, of: str, interval: Interval | None) -> Record:
    scale = find_number_unit(group, number)
    half = None if interval is None else 0.5 * (interval.upper - interval.lower)
    return {
        "group": group.name,
        "number": write_label(number.name),
        "of": of,
        "unit": typeset_unit(scale.unit),
        "half of the 95 % interval": make_number_cell(half, None, scale.factor),
    }


def _record_bounds(campaign: Campaign) -> Iterator[Record]:
    """Yield the rows of bending stiffnesses of bundles with their bounds."""
    scales = choose_stiffness_units(campaign)
    for stiffness in campaign.bounded_stiffnesses:
        scale, ends = scales[stiffness.group], stiffness.share_interval
        bounds = {
            "all slips": stiffness.low,
            "wires slip": stiffness.free,
            "nothing slips": stiffness.high,
            "smallest of all directions": stiffness.principal[0],
            "largest of all directions": stiffness.principal[1],
        }
        yield {
            "group": stiffness.group,
            "test": stiffness.test or "mean",
            "unit": scale.unit,
            **make_interval_cells(
                stiffness.value, stiffness.interval, scale.factor, name="bending stiffness"
            ),
            **{head: make_number_cell(value, None, scale.factor) for head, value in bounds.items()},
            "share (%)": make_percent_cell(stiffness.share),
            "share lower (%)": make_percent_cell(ends, "lower"),
            "share upper (%)": make_percent_cell(ends, "upper"),
            "reason": join_reasons(stiffness.reasons),
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
