"""Render the HTML page of a single test: facts, numbers, figures, notes and exports."""

from __future__ import annotations

from collections.abc import Iterator

from labpipe.records.quality import Severity
from labpipe.records.result import Result, Status, TestResult
from labpipe.report.figure_page import encode_figure, style
from labpipe.report.figures import FIGURES, is_for_journal
from labpipe.report.issues import join_sentences, write_sentence
from labpipe.report.lab_report import (
    compute_style_hash,
    fill_template,
    make_style,
    write_css_string,
)
from labpipe.report.page_tables import DASH, Cell, Table
from labpipe.report.wording import (
    find_display_unit,
    find_unit,
    replace_names,
    write_heading,
    write_with_interval,
)
from labpipe.statistics.lots import PEAK_OVER_LIMIT, find_result, judge_sample


def render_test(result: TestResult, *, report: str = "") -> str:
    """Render the page of a test.

    Parameters
    ----------
    result : result of the test, with the names of the figures to draw
    report : identifier of the report that links to the page; empty if there is none

    Returns
    -------
    A self-contained HTML document without scripts.
    """
    export_rows = tuple(
        (Cell(source.role), Cell(source.file), Cell(source.sha256)) for source in result.inputs
    )
    figure_names = [name for name in result.figures if name in FIGURES]
    with style(is_journal=is_for_journal(result)):
        figures = [
            (encode_figure(FIGURES[name](result)), f"{name} of {result.test}")
            for name in figure_names
        ]
    footer = " \u00b7 ".join(filter(None, [result.test, report and f"report {report}"]))
    css = make_style(write_css_string(footer), "")
    return fill_template(
        "single_test.html",
        result=result,
        report=report,
        style=css,
        style_hash=compute_style_hash(css),
        facts=_list_facts(result),
        numbers=_make_number_table(result),
        figures=figures,
        notes=_make_note_table(result),
        exports=Table("Exports", ("Role", "File", "SHA-256"), export_rows),
    )


def _list_facts(result: TestResult) -> list[tuple[str, str]]:
    specimen = result.specimen
    length_scale = find_unit(result.display, "displacement")
    dimensions = [
        f"{name.replace('_', ' ')} {length_scale.factor * size:.4g} {length_scale.unit}"
        for name, size in specimen.dimensions.items()
    ]
    labels = [f"{name.replace('_', ' ')} {label}" for name, label in specimen.labels.items()]
    observations = [f"{name.replace('_', ' ')}: {text}" for name, text in specimen.observed.items()]
    peak_over_limit = find_result(result.results, PEAK_OVER_LIMIT)
    verdict = []
    if peak_over_limit is not None:
        verdict = [("Verdict", "; ".join([judge_sample(peak_over_limit).text, *observations]))]
    instruments = ", ".join(
        f"{instrument.channel} {instrument.certificate} (calibrated {instrument.calibrated},"
        f" {f'due {instrument.due}' if instrument.due else 'no due date'})"
        for instrument in result.instruments
    )
    return [
        ("Specimen", f"{specimen.type}, spool {specimen.spool}, sample {specimen.sample}"),
        *verdict,
        ("Dimensions", ", ".join([*dimensions, *labels]) or DASH),
        (
            "Tested",
            f"{result.date or 'on an unknown day'} by {result.operator or 'an unnamed operator'}",
        ),
        ("Instruments", instruments or "no calibration certificate stated in the protocol"),
        ("Protocol", result.protocol),
        ("Run", f"{result.run[:16] or DASH}, labpipe {result.labpipe_version}"),
    ]


def _make_number_table(result: TestResult) -> Table:
    headings = ("Number", "Value, 95 %", "State", "Why", "Largest causes of the interval")
    rows = []
    reason_above = ""
    for number in result.results:
        reason = join_sentences(number.reasons)
        is_repeated = bool(reason) and reason == reason_above
        rows.append(_make_number_row(result, number, "As above." if is_repeated else reason))
        reason_above = reason
    return Table("Numbers of this test", headings, tuple(rows))


def _make_number_row(result: TestResult, number: Result, reason: str) -> tuple[Cell, ...]:
    unit = find_display_unit(number.name, number.unit, result.display)
    value = DASH
    if number.value is not None:
        value = write_with_interval(
            number.value, number.interval, unit.factor, estimate=number.distinct_estimate
        )
    return (
        Cell(write_heading(number.name, unit.unit), tip=number.name),
        Cell(value, mark="?" if number.status is Status.DOUBTFUL else ""),
        Cell(str(number.status), tip=", ".join(number.codes)),
        Cell(reason),
        Cell("; ".join(_list_largest_causes(number))),
    )


def _list_largest_causes(number: Result) -> Iterator[str]:
    n_largest, min_share = 3, 0.01
    shares = sorted(zip(number.shares, number.budget, strict=True), key=lambda pair: -pair[0])
    for share, contribution in shares[:n_largest]:
        if share >= min_share:
            yield f"{contribution.cause} {100 * share:.0f} %"


def _make_note_table(result: TestResult) -> Table:
    severities = [Severity.ERROR, Severity.WARNING, Severity.INFO]
    notes = sorted(result.quality, key=lambda note: severities.index(note.severity))
    rows = tuple(
        (
            Cell(replace_names(note.where), tip=note.code),
            Cell(str(note.severity)),
            Cell(write_sentence(note.message)),
        )
        for note in notes
    )
    return Table("Notes", ("Where", "Kind", "Note"), rows)
