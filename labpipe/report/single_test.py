"""The page of a single test: who, when and with what; numbers, figures, notes, exports."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import TYPE_CHECKING, Any

from labpipe.records.quality import Severity
from labpipe.records.result import Instrument, Result, Status, TestResult
from labpipe.report.figure_page import finish_layout, style
from labpipe.report.figures import FIGURES
from labpipe.report.group_tables import DASH, Cell, Table
from labpipe.report.issues import sentence, sentences
from labpipe.report.page_numbers import with_interval
from labpipe.report.page_parts import filled, quoted, style_hash, style_of
from labpipe.report.saving import Inline, inline_svg
from labpipe.report.wording import heading, shown_in, unit_words, with_names_in_words

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure

_TEMPLATE = "single_test.html"
_LARGEST_PARTS = 3


def render_test(result: TestResult, *, report: str = "") -> str:
    """Write the page of a test.

    Parameters
    ----------
    result : with its figures, as the protocol asks for them
    report : id of the report that the page stands beside; empty for none

    Returns
    -------
    An HTML document that needs no other file, no network and no script.
    """
    drawn = [_drawn(result, name) for name in result.figures if name in FIGURES]
    classes = {name: look for each in drawn for name, look in each.classes.items()}
    words = " \u00b7 ".join(filter(None, [result.test, report and f"report {report}"]))
    looks = style_of(quoted(words), _class_rules(classes))
    return filled(
        _TEMPLATE,
        result=result,
        report=report,
        style=looks,
        style_hash=style_hash(looks),
        facts=_facts(result),
        numbers=_numbers(result),
        figures=[_markup(each.element) for each in drawn],
        notes=_notes(result),
        exports=_exports(result),
    )


def _markup(element: str) -> Markup:
    """A drawing by matplotlib, in which every text is escaped."""
    from markupsafe import Markup

    return Markup(element)


def _class_rules(classes: dict[str, str]) -> str:
    return "\n".join(f".{name} {{{look}}}" for name, look in classes.items())


def _drawn(result: TestResult, name: str) -> Inline:
    """A figure as an element of the page; its words stay words."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    with style({"svg.fonttype": "none"}):
        page: Figure = FIGURES[name](result)
        finish_layout(page)
        file = BytesIO()
        canvas: Any = FigureCanvasSVG(page)
        canvas.print_svg(file, metadata={"Date": None})
    prefix = f"f{zlib.crc32(name.encode()):x}"
    return inline_svg(file.getvalue(), prefix=prefix, title=f"{name} of {result.test}")


def _facts(result: TestResult) -> list[tuple[str, str]]:
    specimen = result.specimen
    across = shown_in("", "m", result.display)
    sizes = [
        f"{name.replace('_', ' ')} {across.factor * size:.4g} {unit_words(across.unit)}"
        for name, size in specimen.dimensions.items()
    ]
    fields = [f"{name.replace('_', ' ')} {word}" for name, word in specimen.labels.items()]
    instruments = ", ".join(map(_instrument, result.instruments))
    return [
        ("Specimen", f"{specimen.type}, spool {specimen.spool}, sample {specimen.sample}"),
        ("Dimensions", ", ".join([*sizes, *fields]) or DASH),
        ("Tested", f"{result.date or 'on an unknown day'} by {result.operator or 'nobody named'}"),
        ("Instruments", instruments or "no calibration certificate stated in the protocol"),
        ("Protocol", result.protocol),
        ("Run", f"{result.run[:16] or DASH}, labpipe {result.labpipe_version}"),
    ]


def _instrument(each: Instrument) -> str:
    due = f"due {each.due}" if each.due else "no due date"
    return f"{each.channel} {each.certificate} (calibrated {each.calibrated}, {due})"


def _numbers(result: TestResult) -> Table:
    heads = ("Number", "Value, 95 %", "State", "Why", "Largest parts of the interval")
    said = ["", *(sentences(result.reasons) for result in result.results)]
    rows = tuple(
        _row(result, each, "As above." if why and why == above else why)
        for each, why, above in zip(result.results, said[1:], said, strict=False)
    )
    return Table("Numbers of this test", heads, rows)


def _row(result: TestResult, each: Result, why: str) -> tuple[Cell, ...]:
    shown = shown_in(each.name, each.unit, result.display)
    value = DASH
    if each.value is not None:
        value = with_interval(each.value, each.interval, shown.factor, apart=each.apart)
    return (
        Cell(heading(each.name, shown.unit), tip=each.name),
        Cell(value, mark="?" if each.status is Status.DOUBTFUL else ""),
        Cell(str(each.status), tip=", ".join(each.codes)),
        Cell(why),
        Cell("; ".join(_parts(each))),
    )


def _parts(result: Result) -> Iterator[str]:
    rows = sorted(zip(result.shares, result.budget, strict=True), key=lambda row: -row[0])
    for share, part in rows[:_LARGEST_PARTS]:
        if share >= 0.01:
            yield f"{part.cause} {100 * share:.0f} %"


def _notes(result: TestResult) -> Table:
    order = [Severity.ERROR, Severity.WARNING, Severity.INFO]
    notes = sorted(result.quality, key=lambda note: order.index(note.severity))
    rows = tuple(
        (
            Cell(with_names_in_words(note.where), tip=note.code),
            Cell(str(note.severity)),
            Cell(sentence(note.message)),
        )
        for note in notes
    )
    return Table("Notes", ("Where", "Kind", "Note"), rows)


def _exports(result: TestResult) -> Table:
    rows = tuple((Cell(each.role), Cell(each.file), Cell(each.sha256)) for each in result.inputs)
    return Table("Exports", ("Role", "File", "SHA-256"), rows)
