"""Workbook of a report: one sheet per question."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from labpipe.records.causes import IS_COMMON
from labpipe.records.curve import Interval
from labpipe.records.group import Campaign, Difference, Group, GroupNumber, MeanInterval, Sample
from labpipe.records.quality import join_reasons
from labpipe.records.result import Result, Status
from labpipe.report.bundle_figures import place_scales
from labpipe.report.comparisons import (
    Pair,
    context_words,
    field_words,
    fields_in_words,
    multi_field_differences,
    single_field_pairs,
)
from labpipe.report.issues import Cause, find_causes, find_notes
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
    number_cell,
    percent_cell,
    save_book,
    sheet_of,
    unite_heads,
)
from labpipe.statistics.means import sort_causes, summarise_budget

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
    save_book(about, list(_sheets(campaign)), path)


def _facts(campaign: Campaign) -> Iterator[str]:
    """Yield counts, days, operators and instruments."""
    samples, rejected = samples_of(campaign), len(campaign.rejected)
    text = f"{count_of(len(samples), 'test')} in {count_of(len(campaign.groups), 'group')}"
    yield f"{text}, {count_of(rejected, 'test')} rejected." if rejected else f"{text}."
    if samples:
        yield f"Tested {days_words(samples)}; {operators_words(samples)}."
    for instrument_line in instrument_lines(samples):
        yield f"{instrument_line.name}: {instrument_line.due}."
    date = f" on {campaign.made_on}" if campaign.made_on is not None else ""
    by = f"labpipe {campaign.labpipe_version}".strip()
    yield f"Report {report_id(campaign)}, made{date} by {by}."


def _sheets(campaign: Campaign) -> Iterator[Sheet]:
    if pairs := single_field_pairs(campaign):
        yield sheet_of(
            "answers", map(_answer, pairs), frozen=1,
            question="What is the verdict of each comparison: different, equivalent, or cannot"
            " tell?",
        )  # fmt: skip
    by_protocol = sorted(campaign.groups, key=lambda group: group.protocol)
    yield sheet_of(
        "key numbers", map(_key_record, by_protocol), frozen=1,
        question="What are the key numbers of each group, with their 95 % intervals?",
    )  # fmt: skip
    yield sheet_of(
        "means", _means(campaign), frozen=2,
        question="What is the mean of each number, of all samples and of each spool?",
    )  # fmt: skip
    yield _tests_sheet(campaign)
    results = (
        {"group": group.name, "test": sample.test, **_result(sample, result)}
        for group in campaign.groups
        for sample in group.samples
        for result in sample.results
    )
    yield sheet_of(
        "results", results, frozen=2,
        question="How uncertain is each number of each test, how was it obtained, why is it"
        " doubtful?",
    )  # fmt: skip
    yield _curves_sheet(campaign, is_scaled=False)
    if any(group.band_scaled is not None for group in campaign.groups):
        yield _curves_sheet(campaign, is_scaled=True)
    single_field = [difference for difference in campaign.differences if difference.family]
    displays = {group.name: display_of(group) for group in campaign.groups}
    differences = [
        _difference(difference, displays.get(difference.first, {}))
        for difference in (*single_field, *multi_field_differences(campaign))
    ]
    yield sheet_of(
        "comparisons", differences, frozen=2,
        question="How do pairs of groups differ in each number? Pairs that differ in one field come"
        " first.",
    )  # fmt: skip
    budgets = _budgets_sheet(campaign)
    if budgets.rows:
        yield budgets
    if campaign.places:
        yield sheet_of(
            "slipping and sticking", _places(campaign), frozen=2,
            question="Where does the bending stiffness of each bundle lie between slipping and"
            " sticking?",
        )  # fmt: skip
    ranked = [*enumerate(find_causes(campaign), start=1)]
    issues = [row for rank, cause in ranked for row in _issues(rank, cause)]
    notes = [row for note in find_notes(campaign) for row in _issues(None, note)]
    yield sheet_of(
        "needs a look", [*issues, *notes], frozen=1,
        wrapped=("test", "what", "reason", "largest effect of the cause"),
        question="Which results need a check? Largest effect on a number first; notes have no"
        " rank.",
    )  # fmt: skip


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
        "why": difference.verdict_reason,
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
        ends = ends_record(None, None, name="mean")
        if number.mean is not None:
            mean = number.mean.chosen
            ends = ends_record(mean.mean, mean.interval, scale.factor, name="mean")
        name, unit = as_label(number.name), unit_words(scale.unit)
        parts = (("", "mean"), (", lower", "lower"), (", upper", "upper"))
        row |= {column_head(name, unit, part): ends[key] for part, key in parts}
    return row


def column_head(name: str, unit: str, part: str = "") -> str:
    """Write the head of a column: name, part and unit."""
    return f"{name}{part} ({unit})" if unit else f"{name}{part}"


def _means(campaign: Campaign) -> Iterator[Record]:
    """Yield the mean of each number, and those of several spools; a single one has that of all."""
    for group in campaign.groups:
        for number in group.numbers:
            mean = number.mean
            if mean is None:
                why = "; ".join(map(join_reasons, number.left_out.values()))
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
    row: Record = {
        "group": group.name, "number": as_label(number.name), "over": over,
        "unit": unit_words(scale.unit),
    }  # fmt: skip
    if mean is None:
        last: Record = {"reason": "", "result": number.name}
        return row | ends_record(None, None, name="mean") | last
    return {
        **row,
        **ends_record(mean.mean, mean.interval, scale.factor, name="mean"),
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
    question = "What was measured in each test? One row per test, one column per number."
    return sheet_of("tests", records, heads=heads, frozen=1, question=question)


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
        "decision": sample.decision,
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
        "reason": result.reason_text,
        "result": result.name,
        "method": result.full_method,
    }


_BAND_COLUMNS = {
    "mean": "mean", "lower": "lower", "upper": "upper",
    "lower, whole curve": "lower_all", "upper, whole curve": "upper_all",
}  # fmt: skip


def _curves_sheet(campaign: Campaign, *, is_scaled: bool) -> Sheet:
    """Return the sheet of the mean curves of all groups, in common units, with their charts."""
    first = next((group for group in campaign.groups if group.samples), None)
    across, up = Scale(1.0, "m"), Scale(1.0, "N")
    if first is not None:
        across, up = group_scale(first, "displacement"), group_scale(first, "force")
    up = Scale(1.0, "") if is_scaled else up
    heads = [column_head(part, up.unit) for part in _BAND_COLUMNS]
    rows: list[Record] = []
    lines: dict[str, list[Line]] = {}
    for group in campaign.groups:
        band = group.band_scaled if is_scaled else group.band
        if band is None:
            continue
        columns = {across.label("displacement"): across.factor * band.displacement}
        forces = (up.factor * getattr(band, name) for name in _BAND_COLUMNS.values())
        columns |= dict(zip(heads, forces, strict=True))
        own = array_records({"group": group.name}, columns)
        own = [row | {"n": band.n, "mean over": band.members} for row in own]
        if own:
            line = Line(group.name, (len(rows), len(rows) + len(own) - 1), 1, 2)
            lines.setdefault(group.protocol, []).append(line)
        first_row: Record = own[0] if own else {"group": group.name}
        rows += [first_row | {"reason": str(band.reason or "")}, *own[1:]]
    title, what = ("Mean force over peak force", "force over its peak")
    label = "Force / peak force"
    if not is_scaled:
        title, what, label = "Mean force", "force", up.label("Force")
    charts = [
        Chart(f"{title} on first loading ({protocol})", across.label("Displacement"), label, own)
        for protocol, own in lines.items()
    ]
    every = ["group", across.label("displacement"), *heads, "n", "mean over", "reason"]
    return sheet_of(
        "scaled curves" if is_scaled else "curves", rows, heads=every, frozen=1, charts=charts,
        question=f"What is the mean {what} of each group against displacement, on first loading?",
    )  # fmt: skip


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
        "question": difference.single_field,
        "differ in": fields_in_words(difference),
        "level (%)": percent_cell(ends, "level"),
        "irrelevant below": number_cell(difference.margin, None, scale.factor),
        "different, p": number_cell(difference.p, None),
        "equivalent, p": number_cell(difference.p_equivalent, None),
        "family": difference.family,
        "in family": difference.tests or None,
        "why": "; ".join(filter(None, (difference.verdict_reason, *difference.caveats))),
        "reason": str(shift.reason or ""),
        "result": difference.name,
    }


def _budgets_sheet(campaign: Campaign) -> Sheet:
    """Return the sheet of budgets: shares of the causes for means, and medians over tests."""
    rows = [row for group in campaign.groups for row in _budgets(group)]
    causes = sort_causes(cause for _, shares in rows for cause in shares)
    heads = {cause: f"{cause}{'*' * IS_COMMON.get(cause, False)} (%)" for cause in causes}
    records = [
        head | {heads[cause]: percent_cell(shares.get(cause)) for cause in causes}
        for head, shares in rows
    ]
    question = (
        "Which causes contribute to each 95 % interval? Shares of the variance, for means of the"
        " squared half width; * marks causes common to all tests of a rig, which more"
        " samples do not reduce."
    )
    return sheet_of("budgets", records, frozen=2, question=question)


def _budgets(group: Group) -> Iterator[tuple[Record, Mapping[str, float]]]:
    """Yield the shares for the mean of each number, and their medians over the tests."""
    for number in group.numbers:
        budget = summarise_budget(number)
        if budget.of_tests and budget.of_mean and number.mean is not None:
            interval = number.mean.chosen.interval
            yield _budget_head(group, number, "mean of the group", interval), budget.of_mean
        if budget.of_tests:
            yield _budget_head(group, number, "median of the tests", None), budget.of_tests


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
            "reason": join_reasons(place.reasons),
        }


def _issues(rank: int | None, cause: Cause) -> Sequence[Record]:
    effect = "" if cause.effect is None else cause.effect.text
    return [
        {
            "rank": rank,
            "kind": str(issue.kind),
            "group": issue.group,
            "test": issue.test or ", ".join(issue.tests),
            "what": issue.what,
            "reason": issue.reason,
            "largest effect of the cause": effect,
            "code": issue.code,
        }
        for issue in cause.issues
    ]
