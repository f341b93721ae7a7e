"""Make the tables of the HTML page of a report, and list its tests, days and instruments."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import isfinite, isnan, nan
from typing import Any, NamedTuple
from urllib.parse import quote

from labpipe.messages import format_sentence
from labpipe.records.causes import IS_COMMON
from labpipe.records.group import Campaign, Group, GroupNumber, Lot, Sample, SampleCurve
from labpipe.records.quality import Reason, Severity
from labpipe.records.result import Instrument, Result, Status, find_result
from labpipe.report import budgets, wording
from labpipe.report.figure_page import N_COLOURS, split_pages
from labpipe.report.issues import SLIP_TREATMENTS, Cause
from labpipe.report.plot_records import MeanStrip, clip_range, make_mean_strip
from labpipe.report.table_records import DASH, Cell, Record, Table, tabulate
from labpipe.statistics.group_samples import NOT_STATED, SPOOL, list_fields
from labpipe.statistics.lots import FORCE_LIMIT, format_percent
from labpipe.statistics.means import summarise_budget

REJECTED_STATE = "rejected"
"""State of a test that a person has rejected."""


class PageTest(NamedTuple):
    """Test on the page of a report, or in a figure of its group.

    Parameters
    ----------
    row_index : row of the test in the table of tests, from 0; None in a figure
    sample : specimen and results of the test
    state : ``ok``, ``doubtful``, ``failed`` or ``rejected``; empty in a figure
    group : group of the test; None in a figure, or for a rejected test that matches no group
    stem : stem of the file names of the group; empty without a group
    colour : class of the colour of its lines, such as ``c2``; empty for a rejected test
    rejection : reason, person and day of a rejection; empty for other tests
    """

    row_index: int | None
    sample: Sample
    state: str
    group: Group | None = None
    stem: str = ""
    colour: str = ""
    rejection: str = ""

    @property
    def first_loading(self) -> SampleCurve | None:
        """First loading curve that has points; None if there is none."""
        return next((curve for curve in self.sample.loading if len(curve.displacement)), None)

    def find_value(self, name: str) -> float | None:
        """Find the value of a result; None if there is none."""
        result = find_result(self.sample.results, name)
        return None if result is None else result.value


class GroupView(NamedTuple):
    """Group on the page of a report, or in a figure.

    Parameters
    ----------
    group : group of samples; may be empty
    stem : stem of the file names of the group, as in its links; empty in a figure
    tests : tests of the samples
    rejected : rejected tests that match the group
    """

    group: Group
    stem: str
    tests: Sequence[PageTest]
    rejected: Sequence[PageTest] = ()

    @property
    def is_detailed(self) -> bool:
        """Whether each sample is distinguished in the plots of the group."""
        max_detailed_samples = 6
        return len(self.tests) <= max_detailed_samples

    def get_scale(self, quantity: str) -> wording.Scale:
        """Get the display unit of a quantity in the group."""
        return wording.get_scale(wording.get_display(self.group), quantity)


def make_figure_view(group: Group) -> GroupView:
    """Make the view of a group for a figure, with a colour per spool.

    If the tests are few and all of one spool, there is a colour per test.

    Parameters
    ----------
    group : group of samples; may be empty
    """
    view = GroupView(group, "", [PageTest(None, sample, "") for sample in group.samples])
    spools = [sample.specimen.spool for sample in group.samples]
    has_test_colours = len(set(spools)) == 1 and view.is_detailed
    keys = range(len(spools)) if has_test_colours else spools
    colours = {key: f"c{index % N_COLOURS}" for index, key in enumerate(dict.fromkeys(keys))}
    pairs = zip(view.tests, keys, strict=True)
    return view._replace(tests=[test._replace(colour=colours[key]) for test, key in pairs])


def arrange_tests(campaign: Campaign) -> tuple[list[GroupView], list[PageTest]]:
    """Arrange the tests of a report in groups, and in the rows of the table of tests.

    Parameters
    ----------
    campaign : content of the report

    Returns
    -------
    The groups, and all tests in the order of their rows; rejected tests are last.
    """
    stems = make_stems(group.name for group in campaign.groups)
    stems_by_group = dict(zip((group.name for group in campaign.groups), stems, strict=True))
    tests: list[PageTest] = []
    for group, stem in zip(campaign.groups, stems, strict=True):
        for test in make_figure_view(group).tests:
            state = combine_states(test.sample)
            tests.append(test._replace(row_index=len(tests), state=state, group=group, stem=stem))
    for sample in campaign.rejected_samples:
        matching_group = find_group_of_rejected(sample, campaign)
        rejection = campaign.rejected.get(sample.source, sample.decision)
        stem = "" if matching_group is None else stems_by_group[matching_group.name]
        test = PageTest(len(tests), sample, REJECTED_STATE, group=matching_group, stem=stem)
        tests.append(test._replace(rejection=rejection))
    groups = []
    for group, stem in zip(campaign.groups, stems, strict=True):
        group_tests = [test for test in tests if test.stem == stem]
        included = [test for test in group_tests if test.state != REJECTED_STATE]
        rejected = [test for test in group_tests if test.state == REJECTED_STATE]
        groups.append(GroupView(group, stem, included, rejected))
    return groups, tests


def make_stems(names: Iterable[str]) -> list[str]:
    """Convert names of groups to stems of file names: ASCII, lower case, unique.

    Examples
    --------
    >>> make_stems(["A2, wire cantilever", "A2-wire-cantilever", "°"])
    ['a2-wire-cantilever', 'a2-wire-cantilever-2', 'group']
    """
    stems: list[str] = []
    for name in names:
        ascii_name = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60] or "group"
        stem, count = ascii_name, 1
        while stem in stems:
            count += 1
            stem = f"{ascii_name}-{count}"
        stems.append(stem)
    return stems


def find_group_of_rejected(sample: Sample, campaign: Campaign) -> Group | None:
    """Find the group to which a rejected test would belong.

    Parameters
    ----------
    sample : specimen and results of the rejected test
    campaign : groups of the report, and names of the fields by which tests are grouped

    Returns
    -------
    The group; None if there is none. Test and group have the same protocol, and the same values of
    the fields by which tests are grouped, except the spool. If several groups qualify, the one with
    the most fields in common is returned.
    """
    fields, compared_names = list_fields(sample.specimen), {*campaign.grouping_fields} - {SPOOL}
    matches = [
        group
        for group in campaign.groups
        if group.protocol == sample.protocol
        and all(fields.get(name) == group.fields.get(name) for name in compared_names)
    ]
    return max(matches, key=lambda group: len(fields.items() & group.fields.items()), default=None)


def combine_states(sample: Sample) -> str:
    """Return the worst state among the results of a test, such as ``doubtful``."""
    statuses = {result.status for result in sample.results}
    worst_first = (Status.FAILED, Status.DOUBTFUL)
    return next((str(status) for status in worst_first if status in statuses), str(Status.OK))


def compute_report_id(campaign: Campaign) -> str:
    """Compute the identifier of a report, which has ten hexadecimal digits.

    Parameters
    ----------
    campaign : content of the report; the same title, groups, runs of tests, rejections and version
        of labpipe give the same identifier
    """
    digest = hashlib.sha256()
    for group in campaign.groups:
        for sample in group.samples:
            digest.update(f"{group.name}\n{sample.test}\n{sample.run}\n".encode(errors="replace"))
    for rejection in campaign.rejected.items():
        digest.update("\n".join(rejection).encode(errors="replace"))
    digest.update(f"{campaign.title}\n{campaign.labpipe_version}".encode(errors="replace"))
    return digest.hexdigest()[:10]


def list_samples(campaign: Campaign) -> list[Sample]:
    """List the samples of all groups."""
    return [sample for group in campaign.groups for sample in group.samples]


def describe_testing(samples: Sequence[Sample]) -> str:
    """Describe when and by whom tests were made, such as ``2026-03-02 to 2026-03-06 by AB``.

    The text also counts the tests of unknown day and the tests without operator.
    """
    dates = sorted(sample.date for sample in samples if sample.date is not None)
    n_undated = len(samples) - len(dates)
    period = "on an unknown day (no sheet states one)"
    if dates:
        period = " to ".join(dict.fromkeys(map(str, (dates[0], dates[-1]))))
        period += f", {wording.format_count(n_undated, 'test')} of unknown day" if n_undated else ""
    operators = Counter(sample.operator for sample in samples)
    n_unattributed = operators.pop("", 0)
    names = ", ".join(operators) or "operator not stated"
    if operators and n_unattributed:
        names += f" ({wording.format_count(n_unattributed, 'test')} without operator)"
    return f"{period} by {names}"


class InstrumentLine(NamedTuple):
    """Line of a report on an instrument.

    Parameters
    ----------
    name : channel of the instrument and certificate of its calibration
    calibration : text on the due date of the calibration, and on the tests made after this date
    is_overdue : whether any test was made after the due date
    """

    name: str
    calibration: str
    is_overdue: bool


def list_instruments(samples: Sequence[Sample]) -> list[InstrumentLine]:
    """List the instruments of tests, each certificate once.

    Parameters
    ----------
    samples : all samples of the report
    """
    tests_by_instrument: dict[Instrument, list[Sample]] = {}
    for sample in samples:
        for instrument in sample.instruments:
            tests_by_instrument.setdefault(instrument, []).append(sample)
    lines = []
    for instrument, tests in tests_by_instrument.items():
        due = instrument.due
        n_overdue = sum(bool(due and test.date and test.date > due) for test in tests)
        text = "no due date stated" if due is None else f"calibration due {due}"
        if n_overdue:
            text = f"calibration OVERDUE since {due} in {wording.format_count(n_overdue, 'test')}"
        name = f"{instrument.channel} {instrument.certificate}"
        lines.append(InstrumentLine(name, text, n_overdue > 0))
    return lines


def name_roles(samples: Iterable[Sample]) -> str:
    """Join the roles of the recorded files of tests, each once, such as ``frame, camera``."""
    return ", ".join(dict.fromkeys(source.role for sample in samples for source in sample.inputs))


MAX_SAMPLE_COLUMNS = 4
"""Largest number of samples in a group whose table of numbers has a column for each sample.

A larger group has tables of samples (`make_sample_tables`) instead.
"""


def describe_group(group: Group) -> str:
    """Describe samples, protocol, days and operators of a group; empty without samples."""
    counts, testing = wording.describe_counts(group), describe_testing(group.samples)
    text = f"{counts}, protocol {group.protocol}, tested {testing}."
    return text if group.samples else ""


def list_remarks(group: Group) -> list[str]:
    """List the notes of a group that have no consequences for its numbers."""
    notes = [note for note in group.notes if note.severity is Severity.INFO]
    return [wording.replace_names(f"{note.where}: {note.message}") for note in notes]


def make_number_table(group: Group) -> Table:
    """Make the table of a group: a row per number with its mean, and a column per sample.

    The table of a group of more than `MAX_SAMPLE_COLUMNS` samples has no columns of samples.

    Parameters
    ----------
    group : group of tests, with or without samples
    """
    max_plots = 8  # later rows have no plot, which keeps the table short
    samples = group.samples if len(group.samples) <= MAX_SAMPLE_COLUMNS else ()
    rows = []
    for index, number in enumerate(group.numbers):
        scale = wording.choose_number_scale(group, number)
        rows.append([
            Cell(wording.format_heading(number.name, scale), tooltip=number.name),
            Cell("", drawing=_make_strip(number) if index < max_plots and number.values else None),
            *_make_mean_cells(group, number, scale.factor),
            *(_make_sample_cell(number, sample, scale.factor) for sample in samples),
        ])  # fmt: skip
    headings = ["Number", "Plot", "Mean, 95 %", "n", "s", *(sample.test for sample in samples)]
    return Table("", headings, rows, tuple(_list_table_notes(group)))


def _make_mean_cells(group: Group, number: GroupNumber, factor: float) -> tuple[Cell, Cell, Cell]:
    """Make the cells of the mean, its count and the standard deviation of a number."""
    mean = number.mean
    if not number.values:
        return Cell(DASH, tooltip="no sample has this number"), Cell("0"), Cell(DASH)
    count_text = f"{mean.chosen.n}"
    if not mean.is_pooled:
        count_text = wording.format_count(mean.chosen.n, "spool")
    elif mean.chosen.n != len(group.samples):
        count_text = f"{mean.chosen.n} of {len(group.samples)}"
    return (
        Cell(wording.format_mean(mean.chosen, factor)),
        Cell(count_text, tooltip=str(mean.decision) if len(mean.spool_means) > 1 else ""),
        Cell(wording.format_number(mean.chosen.deviation, None, factor, digits=2).value),
    )


def _make_strip(number: GroupNumber) -> MeanStrip:
    """Make the drawing of samples, mean and interval of a number on a scale of its own."""
    max_dots = 12  # more dots would overlap
    max_extension = 1.5  # of the scale beyond the values at each end, as a fraction of their range
    values = [result.value for result in number.values.values() if result.value is not None]
    interval, mean = number.mean.chosen.interval, number.mean.chosen.mean
    interval_ends = () if interval is None else (interval.lower, interval.upper)
    dots = values if len(values) <= max_dots else ()
    scale_ends = clip_range([*values, mean], interval_ends, max_extension)
    return make_mean_strip(scale_ends, interval, mean, dots)


def _make_sample_cell(number: GroupNumber, sample: Sample, factor: float) -> Cell:
    """Make the cell of a number of a sample, which may be doubtful, failed or an outlier."""
    result = number.values.get(sample.test) or find_result(sample.results, number.name)
    is_outlier = any(outlier.sample == sample.test for outlier in number.outliers)
    return make_result_cell(result, factor, is_outlier=is_outlier)


def make_result_cell(result: Result | None, factor: float, *, is_outlier: bool = False) -> Cell:
    """Make the cell of a result of a test: ``?`` marks a doubtful result, ``!`` an outlier.

    Parameters
    ----------
    result : result of the test; None if the protocol of the test does not request it
    factor : factor from SI to the display unit
    is_outlier : whether the result is an outlier among the samples of its group
    """
    if result is None or result.value is None:
        return Cell(DASH, tooltip="" if result else "not requested")
    mark = ("?" if result.status is Status.DOUBTFUL else "") + ("!" if is_outlier else "")
    return Cell(wording.format_result(result, factor), mark=mark)


def _list_table_notes(group: Group) -> Iterator[str]:
    """Yield the notes on the counts, the intervals and the marks of the table of a group."""
    averaged_numbers = [number for number in group.numbers if number.values]
    if any(not number.mean.is_pooled for number in averaged_numbers):
        yield format_sentence("report.n_in_spools")
    rig_names = [number.name for number in group.numbers if number.is_set_by_rig]
    rig_labels = [wording.format_label(name).lower() for name in rig_names]
    if rig_labels:
        yield format_sentence("report.set_by_rig", numbers="; ".join(rig_labels))
    if len({sample.specimen.spool for sample in group.samples}) == 1 < len(group.samples):
        yield format_sentence("report.one_spool")
    labels_by_reason: dict[Reason, list[str]] = {}
    for number in averaged_numbers:
        if reason := number.mean.chosen.reason:
            labels_by_reason.setdefault(reason, []).append(wording.format_label(number.name))
    for reason, labels in labels_by_reason.items():
        numbers = "all numbers" if len(labels) == len(group.numbers) else "; ".join(labels)
        why = wording.join_sentences([reason])
        yield format_sentence("report.no_mean_interval", why=why, numbers=numbers)
    if any(not number.mean.is_pooled and number.mean.chosen.n == 2 for number in averaged_numbers):
        yield format_sentence("report.two_spool_means")
    yield from _list_mark_notes(group)


def _list_mark_notes(group: Group) -> Iterator[str]:
    """Yield the reasons why numbers are doubtful, missing or outliers, with their tests."""
    names = {number.name for number in group.numbers}
    tests_by_reason: dict[str, dict[str, None]] = {}
    for sample in group.samples:
        for result in sample.results:
            if result.name in names and result.status is not Status.OK:
                mark = DASH if result.status is Status.FAILED else "?"
                reason = f"{mark} {wording.join_sentences(result.reasons)}"
                tests_by_reason.setdefault(reason, {})[sample.test] = None
    for reason, tests in tests_by_reason.items():
        yield f"{reason} ({', '.join(tests)})"
    labels_by_test: dict[str, list[str]] = {}
    for number in group.numbers:
        label = wording.format_label(number.name).lower()
        for outlier in number.outliers:
            labels_by_test.setdefault(outlier.sample, []).append(label)
    for test, labels in labels_by_test.items():
        yield format_sentence("report.outlier_in_mean", test=test, numbers="; ".join(labels))


def make_sample_tables(view: GroupView) -> list[Table]:
    """Make tables with a row per sample and up to eight numbers each.

    Parameters
    ----------
    view : group of tests, with or without samples

    Returns
    -------
    The tables; none if `make_number_table` shows the samples.
    """
    max_numbers_per_table, tables, group = 8, list[Table](), view.group
    if len(group.samples) <= MAX_SAMPLE_COLUMNS:
        return tables
    main_numbers = [number for number in group.numbers if wording.is_main(number.name)]
    for numbers in split_pages(main_numbers, max_numbers_per_table):
        rows = []
        for test in view.tests:
            sample = test.sample
            row: Record = {"Test": sample.test}
            if not tables:
                link = f"#t{test.row_index}"
                row = {"Test": Cell(sample.test, link=link), "Spool": sample.specimen.spool}
            for number in numbers:
                scale = wording.choose_number_scale(group, number)
                heading = wording.format_heading(number.name, scale)
                row[heading] = _make_sample_cell(number, sample, scale.factor)
            rows.append(row)
        title = f"{group.name}: every sample{', continued' if tables else ''}"
        tables.append(tabulate(title, rows))
    return tables


def make_budget_bars(group: Group) -> tuple[list[budgets.BudgetBar], Mapping[str, Any]]:
    """Make the bars of the uncertainty budgets of a group.

    Parameters
    ----------
    group : group of tests, with or without samples

    Returns
    -------
    bars : up to five bars, of the first means with a budget. If no mean has a budget, the bars are
        those of the single tests
    cause_looks : ``colour`` and ``is_common`` of each cause in the bars, keyed by the cause
    """
    max_bars, display = 5, wording.get_display(group)
    numbers = [number for number in group.numbers if budgets.has_budget_bar(number.name)]
    all_budgets = ((number, summarise_budget(number)) for number in numbers)
    number_budgets = [(number, budget) for number, budget in all_budgets if budget.test_shares]
    bars = [
        budgets.make_budget_bar(number, budget.mean_shares, number.mean.chosen.interval, display)
        for number, budget in number_budgets
        if budget.mean_shares
    ]
    if not bars:
        n_tests = max((len(number.values) for number in group.numbers), default=0)
        text = "one test" if n_tests == 1 else f"{n_tests} tests"
        bars = [
            budgets.make_budget_bar(number, budget.test_shares, None, display)._replace(text=text)
            for number, budget in number_budgets
        ]
    bars = bars[:max_bars]
    sorted_shares = budgets.sort_shares([bar.shares for bar in bars])
    cause_looks = {
        cause: {"colour": budgets.get_cause_colour(cause), "is_common": IS_COMMON.get(cause)}
        for cause in budgets.list_drawn_causes(sorted_shares)
    }
    pairs = zip(bars, sorted_shares, strict=True)
    return [bar._replace(shares=shares) for bar, shares in pairs], cause_looks


def make_spool_table(group: Group) -> Table | None:
    """Make the table of the spool means and the method of averaging; None with one spool."""
    spools = list(dict.fromkeys(sample.specimen.spool for sample in group.samples))
    rows, decision_above = [], ""
    for number in group.numbers:
        if not number.values:
            continue
        scale, decision = wording.choose_number_scale(group, number), number.mean.decision
        row: Record = {"Number": wording.format_heading(number.name, scale)}
        for spool in spools:
            mean = number.mean.spool_means.get(spool)
            row[f"Spool {spool}"] = Cell(DASH, "no number")
            if mean is not None:
                mean_text = wording.format_mean(mean, scale.factor)
                row[f"Spool {spool}"] = Cell(mean_text, f"n = {mean.n}")
        row["Decision"] = Cell(decision.action, "; ".join(decision.grounds))
        if str(decision) == decision_above:
            row["Decision"] = "as above"
        rows.append(row)
        decision_above = str(decision)
    title = f"{group.name}: spool means and their averaging"
    headings = ["Number", *(f"Spool {spool}" for spool in spools), "Decision"]
    return tabulate(title, rows, headings) if len(spools) > 1 else None


def make_slip_table(group: Group) -> Table | None:
    """Make the table of the slips of a group; None without slips."""
    length, force = wording.get_scales(wording.get_display(group), "displacement", "force")
    format_value, rows = wording.format_with_interval, list[Record]()
    for sample in group.samples:
        for slip in sample.slips:
            position = format_value(slip.position, slip.position_interval, length.factor)
            drop = format_value(slip.drop, slip.drop_interval, force.factor)
            rows.append({
                "Sample": sample.test,
                length.label("Displacement"): position,
                force.label("Force lost"): drop,
                "Treatment": SLIP_TREATMENTS[slip.decision],
            })  # fmt: skip
    return tabulate(f"{group.name}: slips in the grips", rows) if rows else None


def choose_lot_scale(group: Group, lot: Lot) -> wording.Scale:
    """Choose the display scale of the ratio of a force to the limit of a lot.

    The scale converts the ratio to a force. If the samples have several limits, the ratio is shown.
    """
    if lot.limit is None:
        return wording.Scale(1.0, "")
    force = wording.choose_scale("", "N", wording.get_display(group))
    return force._replace(factor=force.factor * lot.limit)


def describe_observations(samples: Sequence[Sample]) -> str:
    """List the observations on the test sheets with their counts, such as ``slip 3, break 1``.

    Parameters
    ----------
    samples : samples of one group
    """
    observations = [sample.specimen.observed for sample in samples]
    names = dict.fromkeys(name for observed in observations for name in observed)
    counts = Counter(observed.get(name, NOT_STATED) for name in names for observed in observations)
    return ", ".join(f"{value} {count}" for value, count in counts.most_common())


def make_lot_table(groups: Iterable[GroupView]) -> Table | None:
    """Make the table of the lots and their acceptance; None if no protocol states a limit.

    Parameters
    ----------
    groups : groups of the report
    """
    rows, rules = list[Record](), set[str]()
    for view in groups:
        group, lot = view.group, view.group.lot
        if lot is None:
            continue
        scale = choose_lot_scale(group, lot)
        limit, bound, smallest = (
            f"{wording.format_number(ratio, None, scale.factor).value} {scale.unit}".strip()
            if isfinite(ratio)
            else DASH
            for ratio in (1.0, lot.tolerance_bound, lot.minimum)
        )
        no_common_limit = Cell(DASH, tooltip="the samples have several limits")
        rows.append({
            "Lot": Cell(group.name, link=f"#group-{view.stem}"),
            "Answer": str(lot.answer).upper(),
            "Why": wording.join_sentences(lot.reasons),
            "Limit": no_common_limit if lot.limit is None else limit,
            "Bound": bound,
            "Smallest": smallest,
            "Cpk": f"{lot.cpk:.2f}" if isfinite(lot.cpk) else DASH,
            "n": str(lot.n),
            "Separation": describe_observations(group.samples) or DASH,
        })  # fmt: skip
        coverage, confidence = map(format_percent, (lot.coverage, lot.confidence))
        rules.add(f"{coverage} of the lot with {confidence} confidence")
    note = format_sentence("report.lots", rules=" or ".join(sorted(rules)))
    return tabulate("Lots against their smallest force", rows, notes=(note,)) if rows else None


def make_verdict_table(group: Group) -> Table | None:
    """Make the table of the verdict on each sample; None if the protocol states no limit.

    Parameters
    ----------
    group : group of tests with its lot
    """
    if group.lot is None:
        return None
    force = wording.choose_scale("", "N", wording.get_display(group))
    observations = [sample.specimen.observed for sample in group.samples]
    observed_names = dict.fromkeys(name for observed in observations for name in observed)
    rows = []
    for sample in group.samples:
        verdict = group.lot.verdicts.get(sample.test)
        row: Record = {
            "Test": sample.test,
            "Verdict": DASH if verdict is None else str(verdict.value_answer),
            "With its interval": DASH if verdict is None else str(verdict.interval_answer),
        }
        for name in ("peak_force.1", FORCE_LIMIT):
            result = find_result(sample.results, name)
            row[wording.format_heading(name, force)] = make_result_cell(result, force.factor)
        for name in observed_names:
            heading = name.replace("_", " ").capitalize()
            row[heading] = sample.specimen.observed.get(name, NOT_STATED)
        rows.append(row)
    return tabulate(f"{group.name}: verdict on each sample", rows)


def choose_stiffness_scale(campaign: Campaign) -> wording.Scale:
    """Choose the display scale of bending stiffness, that of the first group for all groups."""
    return wording.get_scale(wording.get_display(campaign.groups[0]), "bending_stiffness")


def make_bounds_table(campaign: Campaign) -> Table | None:
    """Make the table of the measured bending stiffnesses of bundles and of their bounds.

    Parameters
    ----------
    campaign : content of the report

    Returns
    -------
    The table; None if the report was made without a wire sheet, or if no test is of a bundle.
    """
    if not campaign.bounded_stiffnesses:
        return None
    scale, rows = choose_stiffness_scale(campaign), list[Record]()
    for stiffness in campaign.bounded_stiffnesses:
        all_slip, wires_slip, nothing_slips, smallest, largest = (
            wording.format_number(bound, None, scale.factor, digits=3).value
            for bound in (stiffness.low, stiffness.free, stiffness.high, *stiffness.principal)
        )
        value = nan if stiffness.value is None else stiffness.value
        degree, interval = stiffness.degree, stiffness.degree_interval
        degree_text = wording.format_number(100.0 * degree, None, digits=2).value
        if interval is not None:
            degree_text = wording.format_with_interval(degree, interval, 100.0)
        degree_text += "" if isnan(degree) else " %"
        directions = "" if smallest == largest else f"{smallest} to {largest}"
        test = Cell(stiffness.test, stiffness.group)
        rows.append({
            "Test": test if stiffness.test else f"mean of {stiffness.group}",
            scale.label("Bending stiffness"): wording.format_with_interval(
                value, stiffness.interval, scale.factor
            ),
            scale.label("All slips"): all_slip,
            scale.label("Wires slip"): wires_slip,
            scale.label("Nothing slips"): Cell(nothing_slips, directions),
            "Share of the range": Cell(degree_text, wording.join_sentences(stiffness.reasons)),
        })  # fmt: skip
    notes = format_sentence("report.bounds_of_bundles"), format_sentence("report.share_of_range")
    return tabulate("Between slipping and sticking", rows, notes=notes)


def make_cause_table(cause: Cause) -> Table:
    """Make the table of the issues of a cause, a row per issue."""
    rows: list[Record] = [
        {
            "Test": Cell(", ".join(issue.tests) or "the whole group", issue.group),
            "What": issue.topic or DASH,
            "Why": Cell(issue.reason, tooltip=issue.code),
        }
        for issue in cause.issues
    ]
    return tabulate(f"{cause.kind} ({len(cause.issues)})", rows)


def make_note_table(causes: Iterable[Cause]) -> Table | None:
    """Make the table of the notes without consequences, a row per cause; None without causes."""
    rows: list[Record] = [
        {
            "Note (first of its kind)": Cell(cause.issues[0].reason, tooltip=cause.code),
            "Number": str(len(cause.issues)),
            "Where": cause.subject,
        }
        for cause in causes
    ]
    return tabulate("Notes without consequences", rows) if rows else None


def make_method_tables(campaign: Campaign) -> list[Table]:
    """Make a table per protocol of the methods of each number and its interval."""
    methods_by_protocol: dict[str, dict[str, dict[str, None]]] = {}
    for group in campaign.groups:
        for result in (result for sample in group.samples for result in sample.results):
            methods_by_number = methods_by_protocol.setdefault(group.protocol, {})
            methods_by_number.setdefault(result.name, {})[result.method] = None
    tables = []
    for protocol, methods_by_number in methods_by_protocol.items():
        rows = []
        for name, methods in methods_by_number.items():
            method = wording.replace_names("; ".join(filter(None, methods)))
            row: Record = {"Number": Cell(wording.format_label(name), tooltip=name)}
            rows.append(row | {"Method": method or "No sample has this number."})
        title = f"Protocol {protocol}: method of each number"
        tables.append(tabulate(title, rows, ("Number", "Method")))
    return tables


def make_test_rows(tests: Iterable[PageTest]) -> list[dict[str, Any]]:
    """Make the rows of the table of tests.

    Parameters
    ----------
    tests : tests of the page

    Returns
    -------
    A dictionary per row: the ``test``; the ``first_cell``, with the first main number; the
    ``decision`` (``accept``, ``reject`` or empty) and its ``grounds``; the file of the ``page`` and
    its ``address``; and the ``reason`` why the test is doubtful, failed or rejected.
    """
    rows = []
    for test in tests:
        page = name_page_file(test.sample.label or test.sample.test)
        numbers = () if test.group is None else test.group.numbers
        bad_results = [entry for entry in test.sample.results if entry.status is not Status.OK]
        reasons = (reason for result in bad_results for reason in result.reasons)
        rejection = f"Rejected: {test.rejection}" if test.rejection else ""
        rows.append({
            "test": test,
            "first_cell": _make_first_number_cell(test.sample, numbers),
            "decision": "reject" if test.rejection else "accept" if test.sample.decision else "",
            "grounds": test.rejection or test.sample.decision,
            "page": page,
            "address": quote(page, errors="replace"),
            "reason": rejection or wording.join_sentences(reasons),
        })  # fmt: skip
    return rows


def name_page_file(label: str) -> str:
    """Return the path of the page of a test, relative to the folder of the report.

    Parameters
    ----------
    label : label of the test, with ``/`` between folders

    Examples
    --------
    >>> name_page_file("wires/A2-085-1")
    'tests/wires__A2-085-1.html'
    """
    return f"tests/{label.replace('/', '__')}.html"


def _make_first_number_cell(sample: Sample, numbers: Sequence[GroupNumber]) -> Cell:
    """Make the cell of the first main number of a test, with the name and the unit below it."""
    name = next((number.name for number in numbers if wording.is_main(number.name)), "")
    result = find_result(sample.results, name)
    if result is None:
        return Cell(DASH)
    scale = wording.choose_scale(name, result.unit, sample.display)
    cell = make_result_cell(result, scale.factor)
    return cell._replace(subtext=wording.format_heading(name, scale), sort_value=result.value)


def make_source_table(tests: Iterable[PageTest]) -> Table:
    """Make the table of the recorded files of each test with their SHA-256.

    Parameters
    ----------
    tests : tests of the page
    """
    rows = []
    for test in tests:
        files = [f"{source.file}: {source.sha256}" for source in test.sample.inputs]
        rows.append((test.sample.test, "; ".join(files) or DASH))
    return Table("Sources of the numbers", ("Test", "Recorded files with SHA-256"), rows)
