"""Render HTML pages from templates, with styles, content security policy and logo."""

from __future__ import annotations

import base64
import hashlib
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any

from markupsafe import Markup

from labpipe.errors import UsageError
from labpipe.records.quality import Severity
from labpipe.records.result import Result, Status, TestResult
from labpipe.report import wording
from labpipe.report.figure_page import encode_figure, use_style
from labpipe.report.figures import FIGURES, is_for_journal
from labpipe.report.issues import join_sentences, write_sentence
from labpipe.report.table_records import DASH, Cell, Record, Table, tabulate
from labpipe.statistics.lots import judge_results


def fill_template(template: str, **values: Any) -> str:
    """Fill the template of a page; all texts except `Markup` are escaped.

    Parameters
    ----------
    template : name of the file, or the text of a template, which contains a brace
    values : values of all variables of the template
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    is_text = "{" in template
    page = environment.from_string(template) if is_text else environment.get_template(template)
    return page.render(**values)


def read_part(name: str) -> str:
    """Read a style or a script of pages."""
    return (files("labpipe.report") / name).read_text(encoding="utf-8")


def make_style(footer: str, extra_rules: str = "") -> dict[str, Markup]:
    """Make the style sheet of a page, and its SHA-256 for the security policy.

    Parameters
    ----------
    footer : text at the foot of each printed sheet
    extra_rules : rules of this page only

    Returns
    -------
    ``style`` and ``style_hash`` for the template of the page.
    """
    rules = read_part("page_looks.css").replace("var(--footer)", write_css_string(footer))
    rules += extra_rules
    return {"style": Markup(rules), "style_hash": compute_hash(rules)}


def compute_hash(text: str) -> Markup:
    """Compute the SHA-256 of a style or a script for the security policy of the page.

    Parameters
    ----------
    text : text of the style or the script, as it is in the page
    """
    digest = hashlib.sha256(wording.replace_unprintable(text).encode()).digest()
    return Markup(f"'sha256-{base64.b64encode(digest).decode()}'")


def write_css_string(text: str) -> str:
    """Write a text as an escaped string of a style sheet.

    Parameters
    ----------
    text : any text; ASCII letters and digits are kept, all other characters are escaped
    """
    escaped = (
        letter if letter.isascii() and letter.isalnum() else f"\\{ord(letter):x} "
        for letter in wording.replace_unprintable(text)
    )
    return f'"{"".join(escaped)}"'


def allow_own_server(page: str) -> str:
    """Allow a page to connect to the server that sent it.

    Parameters
    ----------
    page : HTML page of a report, whose policy forbids connections

    Returns
    -------
    The page with a policy that allows connections to its own server. A page without a policy is
    unchanged; its script saves decisions as a file.
    """
    head, policy, remainder = page.partition("connect-src 'none'")
    return page if "<body" in head or not policy else f"{head}connect-src 'self'{remainder}"


def read_logo(path: Path) -> str:
    """Read the logo of a report.

    Parameters
    ----------
    path : path of a PNG or JPEG file

    Returns
    -------
    The picture as a ``data:`` address.

    Raises
    ------
    UsageError
        If the file cannot be read, has another format, is damaged or larger than 200 kB.
    """
    from PIL import Image, UnidentifiedImageError

    max_kilobytes = 200
    size = path.stat().st_size if path.is_file() else None
    fault = "no file" if size is None else f"{size} bytes"
    try:
        if size is not None and size <= 1000 * max_kilobytes:
            content = path.read_bytes()
            picture = Image.open(BytesIO(content), formats=("PNG", "JPEG"))
            picture.load()
            kind = str(picture.format).lower()
            return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
    except UnidentifiedImageError:
        fault = "a file of another format"
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        fault = f"a file that cannot be read ({error})"
    raise UsageError.about("report.logo", path, "", kilobytes=max_kilobytes, fault=fault)


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
    specimen, length = result.specimen, wording.find_unit(result.display, "displacement")
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
        scale = wording.find_scale(number.name, number.unit, result.display)
        value = wording.write_result(number, scale.factor)
        reason = join_sentences(number.reasons)
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
    worst_first = list(reversed(Severity))
    rows: list[Record] = [
        {
            "Where": Cell(wording.replace_names(note.where), tip=note.code),
            "Kind": str(note.severity),
            "Note": write_sentence(note.message),
        }
        for note in sorted(result.quality, key=lambda note: worst_first.index(note.severity))
    ]
    return tabulate("Notes", rows, ("Where", "Kind", "Note"))
