"""Page of a single test: facts, numbers, figures, notes, recorded files."""

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
    """Write the page of a test.

    Parameters
    ----------
    result : of the test; figures that its protocol names are drawn
    report : id of the report that links to the page; may be empty

    Returns
    -------
    An HTML document that needs no other file, no network and no script.
    """
    inputs = tuple(
        (Cell(source.role), Cell(source.file), Cell(source.sha256)) for source in result.inputs
    )
    names = [name for name in result.figures if name in FIGURES]
    with style(is_journal=is_for_journal(result)):
        figures = [
            (encode_figure(FIGURES[name](result)), f"{name} of {result.test}") for name in names
        ]
    footer = " \u00b7 ".join(filter(None, [result.test, report and f"report {report}"]))
    looks = make_style(write_css_string(footer), "")
    return fill_template(
        "single_test.html",
        result=result,
        report=report,
        style=looks,
        style_hash=compute_style_hash(looks),
        facts=_facts(result),
        numbers=_numbers(result),
        figures=figures,
        notes=_notes(result),
        exports=Table("Exports", ("Role", "File", "SHA-256"), inputs),
    )


def _facts(result: TestResult) -> list[tuple[str, str]]:
    specimen = result.specimen
    x_unit = find_unit(result.display, "displacement")
    sizes = [
        f"{name.replace('_', ' ')} {x_unit.factor * size:.4g} {x_unit.unit}"
        for name, size in specimen.dimensions.items()
    ]
    fields = [f"{name.replace('_', ' ')} {word}" for name, word in specimen.labels.items()]
    answers = [f"{name.replace('_', ' ')}: {text}" for name, text in specimen.observed.items()]
    share = find_result(result.results, PEAK_OVER_LIMIT)
    verdict = []
    if share is not None:
        verdict = [("Verdict", "; ".join([judge_sample(share).text, *answers]))]
    instruments = ", ".join(
        f"{instrument.channel} {instrument.certificate} (calibrated {instrument.calibrated},"
        f" {f'due {instrument.due}' if instrument.due else 'no due date'})"
        for instrument in result.instruments
    )
    return [
        ("Specimen", f"{specimen.type}, spool {specimen.spool}, sample {specimen.sample}"),
        *verdict,
        ("Dimensions", ", ".join([*sizes, *fields]) or DASH),
        (
            "Tested",
            f"{result.date or 'on an unknown day'} by {result.operator or 'an unnamed operator'}",
        ),
        ("Instruments", instruments or "no calibration certificate stated in the protocol"),
        ("Protocol", result.protocol),
        ("Run", f"{result.run[:16] or DASH}, labpipe {result.labpipe_version}"),
    ]


def _numbers(result: TestResult) -> Table:
    heads = ("Number", "Value, 95 %", "State", "Why", "Largest causes of the interval")
    reasons = ["", *(join_sentences(result.reasons) for result in result.results)]
    rows = tuple(
        _number_row(result, row_result, "As above." if why and why == above else why)
        for row_result, why, above in zip(result.results, reasons[1:], reasons, strict=False)
    )
    return Table("Numbers of this test", heads, rows)


def _number_row(result: TestResult, number: Result, why: str) -> tuple[Cell, ...]:
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
        Cell(why),
        Cell("; ".join(_largest_parts(number))),
    )


def _largest_parts(result: Result) -> Iterator[str]:
    n_largest = 3
    rows = sorted(zip(result.shares, result.budget, strict=True), key=lambda row: -row[0])
    for share, part in rows[:n_largest]:
        if share >= 0.01:
            yield f"{part.cause} {100 * share:.0f} %"


def _notes(result: TestResult) -> Table:
    order = [Severity.ERROR, Severity.WARNING, Severity.INFO]
    notes = sorted(result.quality, key=lambda note: order.index(note.severity))
    rows = tuple(
        (
            Cell(replace_names(note.where), tip=note.code),
            Cell(str(note.severity)),
            Cell(write_sentence(note.message)),
        )
        for note in notes
    )
    return Table("Notes", ("Where", "Kind", "Note"), rows)
