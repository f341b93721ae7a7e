"""Write the report of a campaign to a folder (page, workbook, figures), and the page of a test."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from io import BytesIO
from math import nan
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup

from labpipe.errors import UsageError
from labpipe.records.group import Campaign, Group, GroupNumber, MeanInterval
from labpipe.records.result import Result, Status, TestResult
from labpipe.report import comparisons, page_tables, wording
from labpipe.report import plot_records as plots
from labpipe.report.figure_page import convert_write_errors, encode_figure, save_pages, use_style
from labpipe.report.figures import FIGURES, is_for_journal
from labpipe.report.group_plots import list_group_figures, make_group_plots
from labpipe.report.issues import Cause, Kind, find_causes
from labpipe.report.page_tables import GroupView, PageTest, compute_report_id, list_samples
from labpipe.report.report_workbook import save_workbook
from labpipe.report.table_records import DASH, Cell, Record, Table, sort_notes, tabulate
from labpipe.statistics.lots import judge_results

PAGE_FILE, TABLES_FILE, FIGURES_FOLDER = "report.html", "tables.xlsx", "figures"
"""Names of the page, the workbook and the folder of figures in the folder of a report."""
SCRIPTS = ("page_tables.js", "page_plots.js", "page_decisions.js")
"""Files of the script of the page, in the order in which they are joined."""


def write_report(
    campaign: Campaign,
    folder: Path,
    *,
    letterhead: Mapping[str, str] | None = None,
    logo: str = "",
    formats: Sequence[str] = (),
    test_pages: Mapping[str, str] | None = None,
    is_journal: bool = False,
) -> list[Path]:
    """Write the report of a campaign.

    Parameters
    ----------
    campaign : groups with their statistics; groups may be empty
    folder : folder of the report; it is created if it does not exist, and other files in it are
        kept
    letterhead, logo : see `render_page`
    formats : file formats of the figures: ``svg``, ``png`` and ``pdf``; SVG is written with any
        other format. Empty for no figures
    test_pages : HTML page of each test, keyed by its address relative to the folder
    is_journal : whether the figures have the style of a journal

    Returns
    -------
    Paths of the files: page, workbook, pages of tests, figures.

    Raises
    ------
    StoreError
        If a file cannot be written.
    """
    page = render_page(campaign, letterhead, logo, has_test_pages=bool(test_pages))
    pages, figures = {PAGE_FILE: page, **(test_pages or {})}, list[Path]()
    with convert_write_errors(folder, "a report"):
        for name, text in pages.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(wording.replace_unprintable(text), encoding="utf-8")
        save_workbook(campaign, folder / TABLES_FILE)
        if formats:
            figures = save_pages(
                _list_figures(campaign), folder / FIGURES_FOLDER, png="png" in formats,
                pdf="pdf" in formats, dpi=200, is_journal=is_journal,
            )  # fmt: skip
    page_file, *test_page_files = (folder / name for name in pages)
    return [page_file, folder / TABLES_FILE, *test_page_files, *figures]


def _list_figures(campaign: Campaign) -> Iterator[plots.Page]:
    """Yield the figures of each group, and those of comparisons."""
    stems = page_tables.make_stems(group.name for group in campaign.groups)
    for group, stem in zip(campaign.groups, stems, strict=True):
        for figure in list_group_figures(group):
            yield replace(figure, name=f"{stem}-{figure.name}")
    yield from comparisons.list_family_figures(campaign)


def render_page(
    campaign: Campaign,
    letterhead: Mapping[str, str] | None = None,
    logo: str = "",
    *,
    has_test_pages: bool = False,
) -> str:
    """Render the page of a campaign.

    Parameters
    ----------
    campaign : content of the report
    letterhead : texts of the letterhead, keyed by name, such as laboratory, customer and order
    logo : picture as a ``data:`` address; may be empty
    has_test_pages : whether the page has links to a page of each test

    Returns
    -------
    An HTML document that needs no other file and no network. It can be read and printed without its
    script. All texts of the campaign are escaped.
    """
    max_comparisons, max_decisions, min_groups = 8, 4, 3
    n_screen_lines, lines_per_decision = 26, 2  # on a screen of 900 pixels, below the letterhead
    groups, tests = page_tables.arrange_tests(campaign)
    causes, notes = find_causes(campaign)
    field_comparisons = comparisons.list_field_comparisons(campaign)
    open_decisions = find_open_decisions(causes, tests)
    n_comparisons = min(len(field_comparisons), max_comparisons)
    n_decisions = min(len(open_decisions), max_decisions)
    max_group_rows = max(
        n_screen_lines - n_comparisons - lines_per_decision * n_decisions, min_groups
    )
    report_id, script = compute_report_id(campaign), read_page_script()
    samples = list_samples(campaign)
    protocols = ", ".join(sorted({group.protocol for group in campaign.groups})) or "none"
    origin = [report_id, str(campaign.date or ""), f"labpipe {campaign.labpipe_version}".strip()]
    facts = [
        *(letterhead or {}).items(),
        ("Tested", page_tables.describe_testing(samples)),
        ("Report", ", ".join(filter(None, origin))),
        ("Protocols", protocols),
    ]
    footer = f"{campaign.title}  \u00b7  report {report_id}"
    return fill_template(
        "lab_report.html",
        campaign=campaign,
        report=report_id,
        script=script,
        script_hash=compute_hash(script),
        page_data=format_page_data(campaign, report_id=report_id),
        **make_style(footer, read_asset("page_controls.css")),
        pages=has_test_pages,
        logo=logo,
        facts=facts,
        protocols=protocols,
        counts=describe_campaign(campaign, open_decisions),
        samples=samples,
        groups=groups,
        stems={view.group.name: view.stem for view in groups},
        tests=tests,
        field_comparisons=field_comparisons,
        blocks=_list_key_blocks(groups, max_group_rows),
        open_decisions=open_decisions,
        n_shown={"comparisons": n_comparisons, "decisions": n_decisions},
        causes=causes,
        notes=notes,
        tables=page_tables,
        comparisons=comparisons,
        wording=wording,
        make_group_plots=make_group_plots,
    )


def _list_key_blocks(groups: Sequence[GroupView], max_rows: int) -> list[dict[str, Any]]:
    """List blocks of groups with the same headings of their first numbers.

    Returns
    -------
    For each block, ``headings``, the headings of the numbers; ``rows`` from `_list_key_rows`; and
    ``n_shown``, the number of rows that the page shows outside its folded section. All blocks
    together show about `max_rows` lines, including the headings.
    """
    views_by_headings: dict[tuple[tuple[str, str], ...], list[GroupView]] = {}
    for protocol in dict.fromkeys(view.group.protocol for view in groups):
        views = [view for view in groups if view.group.protocol == protocol]
        views_by_headings.setdefault(_list_key_headings(views), []).extend(views)
    blocks = []
    for headings, views in views_by_headings.items():
        names, n_shown = [name for name, _ in headings], min(len(views), max(max_rows, 0))
        block = {"headings": [text for _, text in headings], "n_shown": n_shown}
        blocks.append(block | {"rows": _list_key_rows(views, names)})
        max_rows -= n_shown + 1  # one more for the headings
    return blocks


def _list_key_headings(groups: Sequence[GroupView]) -> tuple[tuple[str, str], ...]:
    """List the names and headings of the first three numbers of groups of one protocol."""
    n_numbers = 3
    headings: dict[str, str] = {}
    for view in groups:
        for number in wording.list_key_numbers(view.group):
            scale = wording.choose_number_scale(view.group, number)
            headings.setdefault(number.name, wording.format_heading(number.name, scale))
    return tuple(headings.items())[:n_numbers]


def _list_key_rows(groups: Sequence[GroupView], names: Sequence[str]) -> list[dict[str, Any]]:
    """List the rows of groups of one block, with the numbers of the given names.

    Returns
    -------
    For each group, the ``view``; the ``strip`` of the first number, or None for a single group; the
    ``cells`` of the first numbers; and the path of the mean curve, ``spark``. All strips have one
    scale.
    """
    numbers = [_find_averaged_number(view.group, next(iter(names), "")) for view in groups]
    means, intervals = [], []
    for number in numbers:
        means.append(nan if number is None else number.mean.chosen.mean)
        intervals.append(None if number is None else _choose_interval_source(number).interval)
    interval_ends = [end for item in filter(None, intervals) for end in (item.lower, item.upper)]
    strip_ends = plots.clip_range(means, interval_ends, max_extension=1.0)
    rows = []
    for view, mean, interval in zip(groups, means, intervals, strict=True):
        mean_strip = plots.make_mean_strip(strip_ends, interval, mean)
        rows.append({
            "view": view,
            "strip": mean_strip if len(groups) > 1 else None,
            "cells": [_make_key_cell(view.group, name) for name in names],
            "spark": _format_mean_curve(view),
        })  # fmt: skip
    return rows


def _find_averaged_number(group: Group, name: str) -> GroupNumber | None:
    """Find a number of a group by its name; None if no sample has a value."""
    number = group.find_number(name)
    return number if number is not None and number.values else None


def _choose_interval_source(number: GroupNumber) -> MeanInterval | Result:
    """Choose the mean, or the result of the only test if the mean has no interval."""
    mean = number.mean.chosen
    is_one_test = mean.interval is None and len(number.values) == 1
    return next(iter(number.values.values())) if is_one_test else mean


def _make_key_cell(group: Group, name: str) -> Cell:
    """Make the cell of the mean of a number with its interval."""
    number = _find_averaged_number(group, name)
    if number is None:
        return Cell(DASH, tooltip="no sample has this number")
    mean, source = number.mean.chosen, _choose_interval_source(number)
    scale = wording.choose_number_scale(group, number)
    tooltip = "" if source is mean else "one test: uncertainty of its measurement"
    if (estimate := source.distinct_estimate) is not None:
        texts = wording.format_number(mean.mean, source.interval, scale.factor, estimate=estimate)
        tooltip += f"{'; ' * bool(tooltip)}interval of the estimate {texts.estimate}"
    text = wording.format_with_interval(mean.mean, source.interval, scale.factor)
    return Cell(text, tooltip=tooltip)


def _format_mean_curve(view: GroupView) -> str:
    """Format the mean curve of a group, or its first curve if there is no mean, as a sparkline."""
    band = view.group.band
    x, y = band.displacement, band.mean
    if band.n < 2 or not len(x):
        curve = next((test.first_loading for test in view.tests if test.first_loading), None)
        if curve is None:
            return ""
        x, y = curve.displacement, curve.force
    rows = plots.find_shape_samples(x, y, max_points=24, tolerance=0.01)
    return plots.format_sparkline(x[rows], y[rows])


class OpenDecision(NamedTuple):
    """Cause that requires a decision, and the tests of this cause without a decision."""

    cause: Cause
    tests: tuple[PageTest, ...]


def find_open_decisions(causes: Iterable[Cause], tests: Iterable[PageTest]) -> list[OpenDecision]:
    """Find the causes that require a decision: failed, doubtful or marked as outliers.

    Parameters
    ----------
    causes : causes in the order of their ranks
    tests : tests of the page

    Returns
    -------
    The causes in the same order, each with at least one test that has no decision.
    """
    included = (test for test in tests if test.state != page_tables.REJECTED_STATE)
    decisions, tests_by_name = [], {test.sample.test: test for test in included}
    for cause in causes:
        names = dict.fromkeys(name for issue in cause.issues for name in issue.tests)
        affected_tests = filter(None, map(tests_by_name.get, names))
        open_tests = tuple(test for test in affected_tests if not test.sample.decision)
        if open_tests and cause.kind in (Kind.FAILED, Kind.DOUBTFUL, Kind.OUTLIER):
            decisions.append(OpenDecision(cause, open_tests))
    return decisions


def describe_campaign(campaign: Campaign, open_decisions: Sequence[OpenDecision]) -> str:
    """Count the tests and open decisions, such as ``24 tests · 1 rejected · 2 to decide``."""
    n_undecided = len({test.row_index for decision in open_decisions for test in decision.tests})
    counts = [
        wording.format_count(len(list_samples(campaign)), "test"),
        f"{len(campaign.rejected)} rejected",
        *([f"{len(campaign.failures)} not read"] if campaign.failures else []),
        f"{n_undecided} to decide",
    ]
    return " \u00b7 ".join(counts)


def read_page_script() -> Markup:
    """Read the script of a page for its ``script`` element.

    The script sorts and filters tables, zooms figures and stores decisions. It defines no global
    names and connects only to a server of ``labpipe serve`` that sent the page.
    """
    scripts = "\n".join(map(read_asset, SCRIPTS))
    return Markup(f'"use strict";\n(() => {{\n{scripts}}})();\n')


def format_page_data(campaign: Campaign, *, report_id: str) -> Markup:
    """Format the data for the script, which a ``script`` element of the page contains as JSON.

    Parameters
    ----------
    campaign : content of the report, with the current entries of its ``decisions.json``
    report_id : identifier of the report

    Returns
    -------
    JSON in which no text can end the element.
    """
    data = {
        "schema": 1,
        "campaign": campaign.name,
        "report": report_id,
        "labpipe": campaign.labpipe_version,
        "decisions": [dict(decision) for decision in campaign.decisions],
    }
    # json.dumps escapes all characters beyond ASCII, among them lone surrogates in names
    text = json.dumps(data, separators=(",", ":")).replace("&", r"\u0026")
    return Markup(text.replace("<", r"\u003c").replace(">", r"\u003e"))


def fill_template(template: str, **values: Any) -> str:
    """Fill the template of a page; all texts except `Markup` are escaped.

    Parameters
    ----------
    template : name of the file, or the text of a template, which contains a brace
    values : values of all variables of the template
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    loader = FileSystemLoader(Path(__file__).parent)
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    is_text = "{" in template
    page = environment.from_string(template) if is_text else environment.get_template(template)
    return page.render(**values)


def read_asset(name: str) -> str:
    """Read a file of the styles or the scripts of pages by its name."""
    return (files("labpipe.report") / name).read_text(encoding="utf-8")


def make_style(footer: str, extra_rules: str = "") -> dict[str, Markup]:
    """Make the style sheet of a page, and its SHA-256 for the security policy.

    Parameters
    ----------
    footer : text at the bottom of each printed sheet
    extra_rules : rules of this page only

    Returns
    -------
    ``style`` and ``style_hash`` for the template of the page.
    """
    escaped_footer = "".join(
        letter if letter.isascii() and letter.isalnum() else f"\\{ord(letter):x} "
        for letter in wording.replace_unprintable(footer)
    )
    rules = read_asset("page.css").replace("var(--footer)", f'"{escaped_footer}"')
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
    start, policy, remainder = page.partition("connect-src 'none'")
    return page if "<body" in start or not policy else f"{start}connect-src 'self'{remainder}"


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
    byte_count = path.stat().st_size if path.is_file() else None
    fault = "no file" if byte_count is None else f"{byte_count} bytes"
    try:
        if byte_count is not None and byte_count <= 1000 * max_kilobytes:
            content = path.read_bytes()
            picture = Image.open(BytesIO(content), formats=("PNG", "JPEG"))
            picture.load()
            image_type = str(picture.format).lower()
            return f"data:image/{image_type};base64,{base64.b64encode(content).decode()}"
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
    """List the facts at the head of the page of a test: pairs of a name and a text."""
    specimen, scale = result.specimen, wording.get_scale(result.display, "displacement")
    lengths = specimen.dimensions.items()
    texts = {name: f"{scale.factor * length:.4g} {scale.unit}" for name, length in lengths}
    texts |= specimen.labels
    dimensions = [f"{name.replace('_', ' ')} {text}" for name, text in texts.items()]
    observations = [f"{name.replace('_', ' ')}: {text}" for name, text in specimen.observed.items()]
    verdict = judge_results(result.results)
    instruments = ", ".join(
        f"{instrument.channel} {instrument.certificate} (calibrated {instrument.calibrated},"
        f" {f'due {instrument.due}' if instrument.due else 'no due date'})"
        for instrument in result.instruments
    )
    testing = f"{result.date or 'date not stated'} by {result.operator or 'operator not stated'}"
    return [
        ("Specimen", f"{specimen.type}, spool {specimen.spool}, sample {specimen.sample}"),
        *([] if verdict is None else [("Verdict", verdict.text)]),
        *([("Observed", "; ".join(observations))] if observations else []),
        ("Dimensions", ", ".join(dimensions) or DASH),
        ("Tested", testing),
        ("Instruments", instruments or "no calibration certificate stated in the protocol"),
        ("Protocol", result.protocol),
        ("Run", f"{result.run[:16] or DASH}, labpipe {result.labpipe_version}"),
    ]


def _make_number_table(result: TestResult) -> Table:
    """Make the table of the results of a test."""
    rows: list[Record] = []
    reason_above = ""
    for entry in result.results:
        scale = wording.choose_scale(entry.name, entry.unit, result.display)
        value_text = wording.format_result(entry, scale.factor)
        reason = wording.join_sentences(entry.reasons)
        rows.append({
            "Number": Cell(wording.format_heading(entry.name, scale), tooltip=entry.name),
            "Value, 95 %": Cell(value_text, mark="?" if entry.status is Status.DOUBTFUL else ""),
            "State": Cell(str(entry.status), tooltip=", ".join(entry.codes)),
            "Why": "As above." if reason and reason == reason_above else reason,
            "Largest causes of the interval": _describe_largest_causes(entry),
        })  # fmt: skip
        reason_above = reason
    return tabulate("Numbers of this test", rows)


def _describe_largest_causes(result: Result) -> str:
    """List up to three causes of at least 1 % of the variance of a result, with their shares."""
    max_causes, min_share = 3, 0.01
    pairs = sorted(zip(result.fractions, result.budget, strict=True), key=lambda pair: -pair[0])
    largest = [(share, cause) for share, cause in pairs[:max_causes] if share >= min_share]
    return "; ".join(f"{cause.cause} {100 * share:.0f} %" for share, cause in largest)


def _make_note_table(result: TestResult) -> Table:
    """Make the table of the notes on a test, the most severe first."""
    rows: list[Record] = [
        {
            "Where": Cell(wording.replace_names(note.where), tooltip=note.code),
            "Kind": str(note.severity),
            "Note": wording.make_sentence(note.message),
        }
        for _, note in sort_notes(("", note) for note in result.quality)
    ]
    return tabulate("Notes", rows, ("Where", "Kind", "Note"))
