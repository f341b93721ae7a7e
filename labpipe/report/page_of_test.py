"""Render the page of a test: facts, numbers, figures, notes and exports."""

from __future__ import annotations

from labpipe.records.result import Result, Status, TestResult
from labpipe.report import wording
from labpipe.report.figure_page import encode_figure, use_style
from labpipe.report.figures import FIGURES, is_for_journal
from labpipe.report.lab_report import fill_template, make_style
from labpipe.report.table_records import DASH, Cell, Record, Table, sort_notes, tabulate
from labpipe.statistics.lots import judge_results


def render_test(result: TestResult, *, report: str = "") -> str:
    """Render the page of a test: facts, numbers, figures, notes and exports.

    Parameters
    ----------
    result : result of the test, with the names of the figures to draw
    report : identifier of the report that links to the page; empty if there is none

    Returns
    -------
    A self-contained HTML document without scripts.
    """
    exports = [(source.role, source.file, source.sha256) for source in result.inputs]
    with use_style(is_journal=is_for_journal(result)):
        figures = [
            (encode_figure(FIGURES[name](result)), f"{name} of {result.test}")
            for name in result.figures
            if name in FIGURES
        ]
    return fill_template(
        "single_test.html",
        result=result,
        report=report,
        facts=_list_facts(result),
        numbers=_make_number_table(result),
        figures=figures,
        notes=_make_note_table(result),
        exports=Table("Exports", ("Role", "File", "SHA-256"), exports),
        **make_style(" \u00b7 ".join(filter(None, [result.test, report and f"report {report}"]))),
    )


def _list_facts(result: TestResult) -> list[tuple[str, str]]:
    specimen, length = result.specimen, wording.get_scale(result.display, "displacement")
    sizes = specimen.dimensions.items()
    texts = {name: f"{length.factor * size:.4g} {length.unit}" for name, size in sizes}
    texts |= specimen.labels
    dimensions = [f"{name.replace('_', ' ')} {text}" for name, text in texts.items()]
    observations = [f"{name.replace('_', ' ')}: {text}" for name, text in specimen.observed.items()]
    verdict = judge_results(result.results)
    instruments = ", ".join(
        f"{instrument.channel} {instrument.certificate} (calibrated {instrument.calibrated},"
        f" {f'due {instrument.due}' if instrument.due else 'no due date'})"
        for instrument in result.instruments
    )
    tested = f"{result.date or 'date not stated'} by {result.operator or 'operator not stated'}"
    return [
        ("Specimen", f"{specimen.type}, spool {specimen.spool}, sample {specimen.sample}"),
        *([] if verdict is None else [("Verdict", verdict.text)]),
        *([("Observed", "; ".join(observations))] if observations else []),
        ("Dimensions", ", ".join(dimensions) or DASH),
        ("Tested", tested),
        ("Instruments", instruments or "no calibration certificate stated in the protocol"),
        ("Protocol", result.protocol),
        ("Run", f"{result.run[:16] or DASH}, labpipe {result.labpipe_version}"),
    ]


def _make_number_table(result: TestResult) -> Table:
    rows: list[Record] = []
    reason_above = ""
    for number in result.results:
        scale = wording.choose_scale(number.name, number.unit, result.display)
        value = wording.write_result(number, scale.factor)
        reason = wording.join_sentences(number.reasons)
        rows.append({
            "Number": Cell(wording.write_heading(number.name, scale), tip=number.name),
            "Value, 95 %": Cell(value, mark="?" if number.status is Status.DOUBTFUL else ""),
            "State": Cell(str(number.status), tip=", ".join(number.codes)),
            "Why": "As above." if reason and reason == reason_above else reason,
            "Largest causes of the interval": _list_largest_causes(number),
        })  # fmt: skip
        reason_above = reason
    return tabulate("Numbers of this test", rows)


def _list_largest_causes(number: Result) -> str:
    """List up to three causes of at least 1 % of the variance, with their shares."""
    n_causes, min_share = 3, 0.01
    shares = sorted(zip(number.shares, number.budget, strict=True), key=lambda pair: -pair[0])
    largest = [(share, entry) for share, entry in shares[:n_causes] if share >= min_share]
    return "; ".join(f"{entry.cause} {100 * share:.0f} %" for share, entry in largest)


def _make_note_table(result: TestResult) -> Table:
    rows: list[Record] = [
        {
            "Where": Cell(wording.replace_names(note.where), tip=note.code),
            "Kind": str(note.severity),
            "Note": wording.write_sentence(note.message),
        }
        for _, note in sort_notes(("", note) for note in result.quality)
    ]
    return tabulate("Notes", rows, ("Where", "Kind", "Note"))
