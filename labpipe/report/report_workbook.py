"""Write the workbook of a campaign's report: a sheet for each question of a reader."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from labpipe.records.causes import IS_COMMON
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
from labpipe.records.result import Status
from labpipe.report import comparisons, page_tables, wording
from labpipe.report.issues import find_causes
from labpipe.report.table_records import (
    Record,
    Table,
    make_interval_cells,
    make_number_cell,
    make_percent_cell,
    make_records,
    save_tables,
    tabulate,
    tabulate_curves,
)
from labpipe.statistics.means import sort_causes, summarise_budget


def save_workbook(campaign: Campaign, path: Path) -> None:
    """Write the workbook of a report as an xlsx file.

    Parameters
    ----------
    campaign : content of the report
    path : path of the file

    Raises
    ------
    StoreError
        If the file cannot be written.

    Notes
    -----
    The workbook has at most twelve sheets after the first, whatever the number of groups.
    """
    footer = f"{campaign.title}  \u00b7  report {page_tables.compute_report_id(campaign)}"
    facts, tables = _list_facts(campaign), filter(None, _list_tables(campaign))
    save_tables(tables, path, book="report", title=campaign.title, facts=facts, footer=footer)


def _list_facts(campaign: Campaign) -> Iterator[str]:
    """Yield counts, days, operators, instruments and the identifier of the report."""
    samples, n_rejected = page_tables.list_samples(campaign), len(campaign.rejected)
    test_count = wording.format_count(len(samples), "test")
    group_count = wording.format_count(len(campaign.groups), "group")
    rejected_text = f", {wording.format_count(n_rejected, 'test')} rejected" if n_rejected else ""
    yield f"{test_count} in {group_count}{rejected_text}."
    if samples:
        yield f"Tested {page_tables.describe_testing(samples)}."
    for instrument in page_tables.list_instruments(samples):
        yield f"{instrument.name}: {instrument.calibration}."
    date_text = f" on {campaign.date}" if campaign.date is not None else ""
    program_text = f"labpipe {campaign.labpipe_version}".strip()
    yield f"Report {page_tables.compute_report_id(campaign)}, made{date_text} by {program_text}."


def _list_tables(campaign: Campaign) -> Iterator[Table | None]:
    """Yield the sheets in order; None instead of a sheet that is omitted because it has no rows."""
    pairs = comparisons.list_single_field_pairs(campaign)
    sorted_groups = sorted(campaign.groups, key=lambda group: group.protocol)
    displays = {group.name: wording.get_display(group) for group in campaign.groups}
    # differences between groups that differ in a single field come first
    differences = sorted(campaign.differences, key=lambda difference: not difference.family)
    first_displays = (displays[difference.first] for difference in differences)
    difference_records = map(_make_difference_record, differences, first_displays)
    has_scaled_bands = any(group.scaled_band is not None for group in campaign.groups)
    lot_records = (_make_lot_record(group, group.lot) for group in campaign.groups if group.lot)
    yield _tabulate_unless_empty("lots", lot_records)
    yield _tabulate_unless_empty("answers", map(_make_verdict_record, pairs))
    yield tabulate("key numbers", map(_make_key_record, sorted_groups))
    yield tabulate("means", _list_means(campaign))
    yield _tabulate_tests(campaign)
    yield tabulate("results", _list_results(campaign))
    yield _tabulate_curves(campaign, is_scaled=False)
    yield _tabulate_curves(campaign, is_scaled=True) if has_scaled_bands else None
    yield tabulate("comparisons", difference_records)
    yield _tabulate_unless_empty("budgets", _list_budgets(campaign))
    yield _tabulate_unless_empty("slipping and sticking", _list_bounds(campaign))
    yield tabulate("needs a look", _list_issues(campaign))


def _tabulate_unless_empty(title: str, records: Iterator[Record]) -> Table | None:
    """Make the sheet of records; None without records."""
    record_list = list(records)
    return tabulate(title, record_list) if record_list else None


def _make_lot_record(group: Group, lot: Lot) -> Record:
    """Make the record of the acceptance of a lot."""
    scale = page_tables.choose_lot_scale(group, lot)
    forces = {
        "limit": 1.0, "mean": lot.mean, "standard deviation": lot.deviation,
        "smallest": lot.minimum, "tolerance bound": lot.tolerance_bound,
    }  # fmt: skip
    return {
        "group": group.name,
        "answer": str(lot.answer),
        "unit": scale.unit or "of the limit",
        **{name: make_number_cell(force, None, scale.factor) for name, force in forces.items()},
        "Cpk": make_number_cell(lot.cpk),
        "n": lot.n,
        "n that would pass": lot.n_needed,
        "coverage (%)": 100.0 * lot.coverage,
        "confidence (%)": 100.0 * lot.confidence,
        "observed": page_tables.describe_observations(group.samples),
        "reason": wording.join_sentences(lot.reasons),
    }


def _make_verdict_record(pair: comparisons.Pair) -> Record:
    """Make the record of the verdict on the first number of a pair."""
    difference = pair.differences[0]
    record = _make_difference_record(difference, wording.get_display(pair.first))
    n_first, n_second = comparisons.count_values(pair)
    return {
        "comparison": comparisons.name_comparison(pair),
        "of": comparisons.describe_context((pair.first, pair.second), pair.field),
        "number": record["number"],
        "verdict": record["verdict"],
        "difference (%)": record["share (%)"],
        "corrected lower (%)": record["corrected lower (%)"],
        "corrected upper (%)": record["corrected upper (%)"],
        "difference": record["second minus first"],
        "n": n_second,
        "n against": n_first,
        "why": difference.verdict_reason,
        **{heading: record[heading] for heading in ("unit", "irrelevant below", "level (%)")},
        "first": difference.first,
        "second": difference.second,
        "caveats": "; ".join(difference.caveats),
    }


def _make_key_record(group: Group) -> Record:
    """Make the record of the first three key numbers of a group, with their intervals."""
    n_numbers = 3
    record: Record = {
        "group": group.name, "protocol": group.protocol, "samples": len(group.samples)
    }  # fmt: skip
    for number in wording.list_key_numbers(group)[:n_numbers]:
        scale = wording.choose_number_scale(group, number)
        cells = _make_mean_cells(number.mean.chosen, scale)
        for suffix, cell in zip(("", ", lower", ", upper"), cells.values(), strict=True):
            record[scale.label(f"{wording.format_label(number.name)}{suffix}")] = cell
    return record


def _make_mean_cells(mean: MeanInterval, scale: wording.Scale) -> Record:
    """Make the cells of a mean and the ends of its interval; they are empty without a mean."""
    return make_interval_cells(mean.mean, mean.interval, scale.factor, name="mean")


def _list_means(campaign: Campaign) -> Iterator[Record]:
    """Yield the mean of each number over all samples, and over each spool if there are several."""
    for group in campaign.groups:
        for number in group.numbers:
            means, spool_means = {"all": number.mean.chosen}, number.mean.spool_means
            if len(spool_means) > 1:
                means |= {f"spool {spool}": mean for spool, mean in spool_means.items()}
            for set_name, mean in means.items():
                yield _make_mean_record(group, number, set_name, mean)


def _make_mean_record(
    group: Group, number: GroupNumber, set_name: str, mean: MeanInterval
) -> Record:
    """Make the record of a mean over a set of samples: ``all``, or those of a spool.

    The mean of a spool leaves the columns on all samples empty.
    """
    scale, nested_mean = wording.choose_number_scale(group, number), number.mean
    record: Record = {
        "group": group.name, "number": wording.format_label(number.name), "over": set_name,
        "unit": scale.unit, **_make_mean_cells(mean, scale),
    }  # fmt: skip
    if not number.values:
        reason = "; ".join(map(join_reasons, number.exclusions.values()))
        return {**record, "reason": reason, "result": number.name}
    deviations = nested_mean.within_spools, nested_mean.between_spools
    cells = [make_number_cell(value, mean.interval, scale.factor) for value in deviations]
    all_samples_record: Record = {
        "mean over": "samples" if nested_mean.is_pooled else "spool means",
        "n samples": nested_mean.n_samples,
        "within spools": cells[0],
        "between spools": cells[1],
        "spools equal, p": make_number_cell(nested_mean.spool_p),
        "decision": str(nested_mean.decision),
    }
    return {
        **record,
        "standard deviation": make_number_cell(mean.deviation, mean.interval, scale.factor),
        "n": mean.n,
        "scale": "log" if mean.is_log else "linear",
        **(all_samples_record if set_name == "all" else dict.fromkeys(all_samples_record)),
        "reason": str(mean.reason or ""),
        "result": number.name,
    }


def _tabulate_tests(campaign: Campaign) -> Table:
    """Make the sheet of tests with a column per number; rejected tests are last."""
    last_headings = ("decision", "key of the run")
    records = [
        _make_test_record(group.name, sample, group.lot)
        for group in campaign.groups
        for sample in group.samples
    ]
    records += [_make_test_record("", sample, None) for sample in campaign.rejected_samples]
    all_headings = dict.fromkeys(name for record in records for name in record)
    headings = [name for name in all_headings if name not in last_headings]
    return tabulate("tests", records, [*headings, *last_headings])


def _make_test_record(group: str, sample: Sample, lot: Lot | None) -> Record:
    """Make the record of a test with its specimen, verdict and numbers."""
    specimen = sample.specimen
    main_results = [result for result in sample.results if wording.is_main(result.name)]
    observed_cells = {name.replace("_", " "): text for name, text in specimen.observed.items()}
    verdict = None if lot is None else lot.verdicts.get(sample.test)
    verdict_cells: Record = {}
    if verdict is not None:
        verdict_cells["verdict"] = str(verdict.value_answer)
        verdict_cells["verdict with interval"] = str(verdict.interval_answer)
    dimension_cells = {f"{name.replace('_', ' ')} (mm)": 1e3 * dimension
                       for name, dimension in specimen.dimensions.items()}  # fmt: skip
    number_cells: Record = {}
    for result in main_results:
        scale = wording.choose_scale(result.name, result.unit, sample.display)
        cell = make_number_cell(result.value, result.interval, scale.factor)
        number_cells[wording.format_heading(result.name, scale)] = cell
    return {
        "test": sample.test,
        "group": group,
        "state": page_tables.combine_states(sample) if group else "rejected",
        "type": specimen.type,
        "spool": specimen.spool,
        "sample": specimen.sample,
        "protocol": sample.protocol,
        "day": str(sample.date or ""),
        "operator": sample.operator,
        **verdict_cells,
        **observed_cells,
        **dimension_cells,
        "doubtful numbers": sum(result.status is Status.DOUBTFUL for result in main_results),
        "failed numbers": sum(result.status is Status.FAILED for result in main_results),
        **number_cells,
        "decision": sample.decision,
        "key of the run": sample.run,
    }


def _list_results(campaign: Campaign) -> Iterator[Record]:
    """Yield a record for each result of each test."""
    for group in campaign.groups:
        for sample in group.samples:
            for result in sample.results:
                scale = wording.choose_scale(result.name, result.unit, sample.display)
                yield {
                    "group": group.name,
                    "test": sample.test,
                    "number": wording.format_label(result.name),
                    "unit": scale.unit,
                    **make_interval_cells(result.value, result.interval, scale.factor),
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
"""Field of a band, keyed by the name of the column that shows this field."""


def _tabulate_curves(campaign: Campaign, *, is_scaled: bool) -> Table:
    """Make the sheet of the mean curves of all groups, in common units; a chart per protocol."""
    display = next((wording.get_display(group) for group in campaign.groups if group.samples), {})
    x_scale, y_scale = wording.get_scales(display, "displacement", "force")
    title = "Mean force"
    if is_scaled:
        y_scale, title = wording.Scale(1.0, ""), "Mean force over peak force"
    charts: dict[str, dict[str, list[Record]]] = {}
    for group in campaign.groups:
        band = group.scaled_band if is_scaled else group.band
        if band is not None:
            chart_title = f"{title} on first loading ({group.protocol})"
            records = _list_band_records(group.name, band, (x_scale, y_scale))
            charts.setdefault(chart_title, {})[group.name] = records
    columns = list(map(y_scale.label, _BAND_COLUMNS))
    headings = ["group", x_scale.label("displacement"), *columns, "n", "mean over", "reason"]
    name = "scaled curves" if is_scaled else "curves"
    return tabulate_curves(name, charts.items(), *headings[1:3], headings=headings)


def _list_band_records(group: str, band: Band, scales: Sequence[wording.Scale]) -> list[Record]:
    """List a record per point of a mean curve, or one record for a curve without points.

    The first record gives the reason why a band is missing; `scales` are those of displacement and
    force.
    """
    x_scale, y_scale = scales
    columns = {x_scale.label("displacement"): x_scale.factor * band.displacement}
    for name, field in _BAND_COLUMNS.items():
        columns[y_scale.label(name)] = y_scale.factor * getattr(band, field)
    records = make_records({"group": group, "n": band.n, "mean over": band.members}, columns)
    first_record, *later_records = records or [{"group": group}]
    return [first_record | {"reason": str(band.reason or "")}, *later_records]


def _make_difference_record(difference: Difference, display: Mapping[str, str]) -> Record:
    """Make the record of the difference of two groups in one number."""
    mean_difference, interval = difference.difference, difference.interval
    scale = wording.choose_scale(difference.name, difference.unit, display)
    # the corrected interval is that of the relative change if there is one
    relative_interval = None if difference.change is None else interval
    absolute_interval = interval if difference.change is None else None
    corrected = make_interval_cells(mean_difference.mean, absolute_interval, scale.factor)
    differing_fields = (
        f"{name.replace('_', ' ')}: {second} against {first}"
        for name, (first, second) in difference.fields.items()
    )
    return {
        "first": difference.first,
        "second": difference.second,
        "number": wording.format_label(difference.name),
        "unit": scale.unit,
        **make_interval_cells(
            mean_difference.mean, mean_difference.interval, scale.factor, name="second minus first"
        ),
        "share (%)": make_percent_cell(difference.change),
        "corrected lower (%)": make_percent_cell(relative_interval, "lower"),
        "corrected upper (%)": make_percent_cell(relative_interval, "upper"),
        "corrected lower": corrected["lower"],
        "corrected upper": corrected["upper"],
        "verdict": str(difference.verdict),
        "question": difference.single_field,
        "differ in": "; ".join(differing_fields),
        "level (%)": make_percent_cell(interval, "level"),
        "irrelevant below": make_number_cell(difference.margin, None, scale.factor),
        "different, p": make_number_cell(difference.p),
        "equivalent, p": make_number_cell(difference.p_equivalent),
        "family": difference.family,
        "in family": difference.n_comparisons or None,
        "why": "; ".join(filter(None, (difference.verdict_reason, *difference.caveats))),
        "reason": str(mean_difference.reason or ""),
        "result": difference.name,
    }


def _list_budgets(campaign: Campaign) -> Iterator[Record]:
    """Yield the shares of the causes in the variance of each mean, and their medians over tests."""
    rows: list[tuple[Record, Mapping[str, float]]] = []
    for group in campaign.groups:
        for number in group.numbers:
            budget, scale = summarise_budget(number), wording.choose_number_scale(group, number)
            interval = number.mean.chosen.interval
            group_half_width = None if interval is None else 0.5 * (interval.upper - interval.lower)
            averages = (
                ("mean of the group", group_half_width, budget.mean_shares),
                ("median of the tests", None, budget.test_shares),
            )
            for average, half_width, shares in averages if budget.test_shares else ():
                cells: Record = {
                    "group": group.name,
                    "number": wording.format_label(number.name),
                    "of": average,
                    "unit": scale.unit,
                    "half of the 95 % interval": make_number_cell(half_width, None, scale.factor),
                }
                if shares:
                    rows.append((cells, shares))
    causes = sort_causes(cause for _, shares in rows for cause in shares)
    headings = {cause: f"{cause}{'*' * IS_COMMON.get(cause, False)} (%)" for cause in causes}
    for cells, shares in rows:
        yield cells | {headings[cause]: make_percent_cell(shares.get(cause)) for cause in causes}


def _list_bounds(campaign: Campaign) -> Iterator[Record]:
    """Yield the bending stiffnesses of bundles with their bounds."""
    for stiffness in campaign.bounded_stiffnesses:
        scale = page_tables.choose_stiffness_scale(campaign)
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
            **{name: make_number_cell(value, None, scale.factor) for name, value in bounds.items()},
            "share (%)": make_percent_cell(stiffness.degree),
            "share lower (%)": make_percent_cell(stiffness.degree_interval, "lower"),
            "share upper (%)": make_percent_cell(stiffness.degree_interval, "upper"),
            "reason": join_reasons(stiffness.reasons),
        }


def _list_issues(campaign: Campaign) -> Iterator[Record]:
    """Yield the issues, cause by cause; notes without consequences have no rank."""
    causes, notes = find_causes(campaign)
    for rank, cause in [*enumerate(causes, start=1), *((None, note) for note in notes)]:
        for issue in cause.issues:
            yield {
                "rank": rank,
                "kind": str(issue.kind),
                "group": issue.group,
                "test": ", ".join(issue.tests),
                "what": issue.topic,
                "reason": issue.reason,
                "largest effect of the cause": "" if cause.effect is None else cause.effect.text,
                "code": issue.code,
            }
