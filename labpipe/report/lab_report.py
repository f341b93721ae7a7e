"""Report of a campaign: write its page, its workbook and, on request, figures to a folder."""

from __future__ import annotations

import base64
import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from io import BytesIO
from itertools import groupby
from math import isfinite
from pathlib import Path
from typing import Any, Final, NamedTuple

from markupsafe import Markup

from labpipe.errors import UsageError
from labpipe.records.group import Campaign, Group, GroupNumber, MeanInterval, Verdict
from labpipe.records.quality import Severity
from labpipe.records.result import Result
from labpipe.report.bundle_figures import has_bundles, make_bounds_table
from labpipe.report.comparisons import (
    Pair,
    describe_context,
    find_families,
    list_pair_remarks,
    list_single_field_pairs,
    make_answer_cells,
    make_pair_table,
    name_field,
)
from labpipe.report.figure_page import save_pages, writing
from labpipe.report.group_figures import list_family_figures, list_group_figures, make_family_plots
from labpipe.report.group_plots import find_first_loading, make_group_plots
from labpipe.report.issues import Cause, Kind, find_causes, join_sentences
from labpipe.report.lot_tables import make_lot_table, make_verdict_table
from labpipe.report.page_facts import (
    PageTest,
    PageTests,
    compute_report_id,
    describe_days,
    describe_operators,
    list_instruments,
    list_samples,
    make_stems,
    name_roles,
)
from labpipe.report.page_tables import (
    DASH,
    Cell,
    Table,
    describe_group,
    make_budget_bars,
    make_cause_table,
    make_method_tables,
    make_note_table,
    make_number_table,
    make_sample_tables,
    make_slip_table,
    make_source_table,
    make_spool_table,
    make_test_rows,
)
from labpipe.report.plot_records import (
    MeanStrip,
    clip_range,
    make_mean_strip,
    simplify_line,
    write_sparkline,
)
from labpipe.report.report_workbook import save_workbook
from labpipe.report.wording import (
    find_number_unit,
    is_first_cycle,
    replace_names,
    replace_unprintable,
    typeset_unit,
    write_count,
    write_heading,
    write_label,
    write_mean,
    write_with_interval,
)
from labpipe.statistics.group_fields import make_field_sort_key

_NO_INSTRUMENTS = "no calibration certificate stated in the protocols"
_ANSWER_HEADS = ("Comparison", "Verdict", "Difference (95 %, corrected)", "n")


@dataclass(frozen=True, slots=True)
class Letterhead:
    """Sender and customer of a report.

    Parameters
    ----------
    facts : names and values, such as laboratory, customer and order; may be empty
    logo : picture as a ``data:`` address; may be empty
    """

    facts: tuple[tuple[str, str], ...] = ()
    logo: str = ""


PLAIN = Letterhead()
_MAX_LOGO_BYTES = 200_000


def read_logo(path: Path) -> str:
    """Read the logo of a report.

    Parameters
    ----------
    path : a PNG or a JPEG

    Returns
    -------
    The picture as a ``data:`` address.

    Raises
    ------
    UsageError
        If the file cannot be read, has another format, is damaged or larger than 200 kB.
    """
    from PIL import Image, UnidentifiedImageError

    size = path.stat().st_size if path.is_file() else None
    fault = "no file" if size is None else f"{size} bytes"
    try:
        if size is not None and size <= _MAX_LOGO_BYTES:
            content = path.read_bytes()
            picture = Image.open(BytesIO(content), formats=("PNG", "JPEG"))
            picture.load()
            kind = str(picture.format).lower()
            return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
    except UnidentifiedImageError:
        fault = "a file of another format"
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        fault = f"a file that cannot be read ({error})"
    kilobytes = _MAX_LOGO_BYTES // 1000
    raise UsageError.about("report.logo", path, "", kilobytes=kilobytes, fault=fault)


def render_page(
    campaign: Campaign, *, letterhead: Letterhead = PLAIN, has_test_pages: bool = False
) -> str:
    """Write the page of a campaign.

    Parameters
    ----------
    campaign : to report
    letterhead : sender and customer
    has_test_pages : link to a page per test

    Returns
    -------
    An HTML document that needs no other file and no network, and can be read and printed without
    its script. All texts of the campaign are escaped.
    """
    names = make_stems(group.name for group in campaign.groups)
    tests = PageTests(campaign, names)
    report, script = compute_report_id(campaign), read_page_script()
    style = make_style(write_css_string(f"{campaign.title}  \u00b7  report {report}"), _text(STYLE))
    return fill_template(
        "lab_report.html",
        campaign=campaign,
        report=report,
        style=style,
        style_hash=compute_style_hash(style),
        script=script,
        script_hash=compute_style_hash(script),
        page_data=write_page_data(campaign, report=report),
        pages=has_test_pages,
        logo=letterhead.logo,
        **_first_screen(campaign, names, tests, letterhead),
        **_other_sections(campaign, names, tests),
    )


def _first_screen(
    campaign: Campaign, names: Sequence[str], tests: PageTests, letterhead: Letterhead
) -> dict[str, Any]:
    """Return the contents of the first screen: answers, then numbers, then open decisions."""
    max_answers, max_decisions, min_groups = 8, 4, 3
    screen_lines, lines_per_decision = 26, 2  # of a screen of 900 pixels, below the letterhead
    causes = find_causes(campaign)
    open_ones, answer_rows = find_open_decisions(causes, tests), make_answers(campaign)
    folds = {
        "answers": min(len(answer_rows), max_answers),
        "decisions": min(len(open_ones), max_decisions),
    }
    room = screen_lines - folds["answers"] - lines_per_decision * folds["decisions"]
    samples = list_samples(campaign)
    recorded = name_roles(samples)
    return {
        "counts": describe_campaign(campaign, open_ones),
        "facts": _facts(campaign, letterhead),
        "instruments": list_instruments(samples),
        "no_instruments": f"{recorded}; {_NO_INSTRUMENTS}" if recorded else _NO_INSTRUMENTS,
        "lots": make_lot_table(campaign, names),
        "answers": answer_rows,
        "blocks": _limit_rows(make_key_blocks(campaign, names), max(room, min_groups)),
        "open_ones": open_ones,
        "folds": folds,
        "causes": [(cause, make_cause_table(cause)) for cause in causes],
    }


def _facts(campaign: Campaign, letterhead: Letterhead) -> list[tuple[str, str]]:
    samples = list_samples(campaign)
    made_on = str(campaign.made_on) if campaign.made_on else ""
    by = f"labpipe {campaign.labpipe_version}".strip()
    return [
        *letterhead.facts,
        ("Tested", f"{describe_days(samples)} by {describe_operators(samples)}"),
        ("Report", ", ".join(filter(None, [compute_report_id(campaign), made_on, by]))),
        ("Protocols", _protocols(campaign)),
    ]


def _protocols(campaign: Campaign) -> str:
    return ", ".join(sorted({group.protocol for group in campaign.groups})) or "none"


def make_answers(campaign: Campaign) -> list[dict[str, Any]]:
    """Make an answer for each field in which pairs of groups differ.

    Parameters
    ----------
    campaign : with its differences; the first number of each pair counts

    Returns
    -------
    For each ``field``: its ``question``, its ``verdict`` (for several pairs how many have each
    verdict), the ``difference`` and the ``counts`` of the pair that differs most, and the table of
    its ``pairs``.
    """
    return [
        _answer(field, list(pairs))
        for field, pairs in groupby(list_single_field_pairs(campaign), key=lambda pair: pair.field)
    ]


def _answer(field: str, pairs: Sequence[Pair]) -> dict[str, Any]:
    rows = tuple(make_answer_cells(pair) for pair in pairs)
    largest = max(range(len(pairs)), key=lambda at: _rank_of_pair(pairs[at]))
    question, verdict = rows[0][0].text, rows[0][1].text
    if len(pairs) > 1:
        values = {value for pair in pairs for value in pair.differences[0].fields[field]}
        ordered = sorted(values, key=lambda value: make_field_sort_key(field, value))
        question = f"{name_field(field)}: {', '.join(ordered)}"
        counts = Counter(pair.differences[0].verdict for pair in pairs)
        verdict = ", ".join(f"{str(kind).upper()} {counts[kind]}" for kind in Verdict
                            if counts[kind])  # fmt: skip
    of_several = f", largest of {len(pairs)} pairs" if len(pairs) > 1 else ""
    return {
        "field": field,
        "question": question,
        "verdict": verdict,
        "difference": rows[largest][2].text + of_several,
        "counts": rows[largest][3].text,
        "pairs": Table("", _ANSWER_HEADS, rows),
    }


def _rank_of_pair(pair: Pair) -> tuple[bool, float]:
    """Return a rank that is higher for different groups, then for a larger difference."""
    difference = pair.differences[0]
    size = difference.share if difference.share is not None else difference.difference.mean
    return difference.verdict is Verdict.DIFFERENT, abs(size) if isfinite(size) else 0.0


class KeyRow(NamedTuple):
    """A group on the first screen.

    Parameters
    ----------
    name, stem : of the group, and of its links
    n : number of samples
    strip : drawing of the first number with its interval; None without a mean
    cells : of its first numbers
    spark : its curve as a path; empty without a curve
    """

    name: str
    stem: str
    n: int
    strip: MeanStrip | None
    cells: tuple[Cell, ...]
    spark: str


class KeyBlock(NamedTuple):
    """Groups that share the headings of a table.

    Parameters
    ----------
    heads : of their numbers; empty if each cell names its number
    rows : one per group
    """

    heads: tuple[str, ...]
    rows: Sequence[KeyRow]


def make_key_blocks(campaign: Campaign, stems: Sequence[str]) -> list[KeyBlock]:
    """Make the key numbers of each group.

    Parameters
    ----------
    campaign : with the main numbers of the protocol first in each group
    stems : of its groups

    Returns
    -------
    A block for groups with the same numbers, and a last one for groups that share them with none.
    """
    by_protocol: dict[str, list[tuple[Group, str]]] = {}
    for group, stem in zip(campaign.groups, stems, strict=True):
        by_protocol.setdefault(group.protocol, []).append((group, stem))
    by_heads: dict[tuple[tuple[str, str], ...], list[tuple[Group, str]]] = {}
    for groups in by_protocol.values():
        by_heads.setdefault(_key_heads(groups), []).extend(groups)
    blocks: list[KeyBlock] = []
    single: list[KeyRow] = []
    for heads, groups in by_heads.items():
        if len(groups) > 1 or len(by_heads) == 1:
            texts = tuple(text for _, text in heads)
            blocks.append(KeyBlock(texts, _key_rows(groups, dict(heads))))
        else:
            single += _key_rows(groups, dict(heads), has_heads=False)
    return [*blocks, *([KeyBlock((), single)] if single else [])]


def _key_heads(groups: Sequence[tuple[Group, str]]) -> tuple[tuple[str, str], ...]:
    """Return names and headings of the first numbers of groups of one protocol."""
    n_numbers = 3
    heads: dict[str, str] = {}
    for group, _ in groups:
        for number in group.numbers:
            if is_first_cycle(number.name) and not number.is_set_by_rig:
                unit = find_number_unit(group, number).unit
                heads.setdefault(number.name, write_heading(number.name, unit))
    return tuple(heads.items())[:n_numbers]


def _key_rows(
    groups: Sequence[tuple[Group, str]], heads: Mapping[str, str], *, has_heads: bool = True
) -> list[KeyRow]:
    first = next(iter(heads), "")
    found = [_find_mean(group, first) for group, _ in groups]
    means = [mean for _, mean in filter(None, found)]
    intervals = [mean.interval for mean in means if mean.interval is not None]
    ends = [end for interval in intervals for end in (interval.lower, interval.upper)]
    strip_ends = clip_range([mean.mean for mean in means], ends, 1.0)
    rows = []
    for (group, stem), number_and_mean in zip(groups, found, strict=True):
        strip = None
        if has_heads and number_and_mean is not None:
            interval = _find_interval(*number_and_mean)[0].interval
            strip = make_mean_strip(strip_ends, interval, number_and_mean[1].mean)
        cells = tuple(_key_cell(group, name, has_label=not has_heads) for name in heads)
        rows.append(KeyRow(group.name, stem, len(group.samples), strip, cells, _spark(group)))
    return rows


def _find_mean(group: Group, name: str) -> tuple[GroupNumber, MeanInterval] | None:
    """Find a number of a group and its mean; None without a mean."""
    for number in group.numbers:
        if number.name == name and number.mean is not None:
            return number, number.mean.chosen
    return None


def _key_cell(group: Group, name: str, *, has_label: bool) -> Cell:
    found = _find_mean(group, name)
    if found is None:
        return Cell(DASH, tip="no sample has this number")
    number, mean = found
    scale = find_number_unit(group, number)
    source, tip = _find_interval(number, mean)
    if source.distinct_estimate is not None:
        estimate = write_mean(mean, scale.factor).partition("(")[2].partition(",")[0]
        tip = f"interval of the {estimate}"
    text = write_with_interval(mean.mean, source.interval, scale.factor)
    if not has_label:
        return Cell(text, tip=tip)
    return Cell(f"{text} {typeset_unit(scale.unit)}".strip(), small=write_label(name), tip=tip)


def _find_interval(number: GroupNumber, mean: MeanInterval) -> tuple[MeanInterval | Result, str]:
    """Return the mean, or the single test of a mean without interval, and a note on the latter."""
    if mean.interval is None and len(number.values) == 1:
        return next(iter(number.values.values())), "one test: uncertainty of its measurement"
    return mean, ""


def _spark(group: Group) -> str:
    """Write the mean curve of a group, or its first curve without a mean, as a sparkline."""
    x, y = group.band.displacement, group.band.mean
    if group.band.n < 2 or not len(x):
        curves = (find_first_loading(sample) for sample in group.samples)
        first = next((curve for curve in curves if curve is not None), None)
        if first is None:
            return ""
        x, y = first.displacement, first.force
    rows = simplify_line(x, y, max_points=24, tolerance=0.01)
    return write_sparkline(x[rows], y[rows])


def _limit_rows(blocks: Iterable[KeyBlock], max_rows: int) -> list[tuple[KeyBlock, int]]:
    """Return each block with the number of its groups that the page shows before it is unfolded."""
    limited = []
    for block in blocks:
        count = min(len(block.rows), max(max_rows, 0))
        limited.append((block, count))
        max_rows -= count + 1
    return limited


class OpenDecision(NamedTuple):
    """A cause that requires a decision, and its tests without one."""

    cause: Cause
    tests: tuple[PageTest, ...]


def find_open_decisions(causes: Iterable[Cause], tests: PageTests) -> list[OpenDecision]:
    """Find the causes that require a decision: failed, doubtful or marked as outliers.

    Parameters
    ----------
    causes : ranked
    tests : of the page

    Returns
    -------
    Causes of which a test has no decision yet, in their order.
    """
    decisions = []
    for cause in causes:
        affected = (tests.by_name.get(issue.test) for issue in cause.issues)
        open_tests = (test for test in affected if test is not None and not test.sample.decision)
        undecided = tuple(dict.fromkeys(open_tests))
        if undecided and cause.kind in (Kind.FAILED, Kind.DOUBTFUL, Kind.OUTLIER):
            decisions.append(OpenDecision(cause, undecided))
    return decisions


def describe_campaign(campaign: Campaign, open_ones: Sequence[OpenDecision]) -> str:
    """Count tests and open decisions, such as ``24 tests · 1 rejected · 2 to decide``."""
    undecided = len({test.number for decision in open_ones for test in decision.tests})
    parts = [
        write_count(len(list_samples(campaign)), "test"),
        f"{len(campaign.rejected)} rejected",
        *([f"{len(campaign.left_out)} not read"] if campaign.left_out else []),
        f"{undecided} to decide",
    ]
    return " \u00b7 ".join(parts)


def _other_sections(campaign: Campaign, names: Sequence[str], tests: PageTests) -> dict[str, Any]:
    """Return the contents below the first screen."""
    groups = list(zip(campaign.groups, names, strict=True))
    by_stem = {stem: group.name for group, stem in groups}
    return {
        "groups": [_group(group, stem, tests) for group, stem in groups],
        "has_bundles": has_bundles(campaign),
        "bounds_table": make_bounds_table(campaign),
        "questions": list(_questions(campaign, {group.name: stem for group, stem in groups})),
        "remarks_on_pairs": list_pair_remarks(campaign),
        "notes": make_note_table(campaign),
        "rows": make_test_rows(campaign, tests, by_stem),
        "methods": make_method_tables(campaign),
        "protocols": _protocols(campaign),
        "exports": make_source_table(tests),
    }


def _group(group: Group, stem: str, tests: PageTests) -> dict[str, Any]:
    spools = {sample.specimen.spool for sample in group.samples}
    budget, causes = make_budget_bars(group)
    return {
        "name": group.name,
        "stem": stem,
        "about": describe_group(group) if group.samples else "",
        "is_empty": not group.samples,
        "why_empty": join_sentences([group.band.reason]) or "The group has no samples.",
        "rejected": tests.rejected(stem),
        "plots": make_group_plots(group, stem, tests),
        "numbers": make_number_table(group),
        "verdicts": make_verdict_table(group),
        "budget": budget,
        "causes": causes,
        "samples": make_sample_tables(group, tests),
        "slips": make_slip_table(group),
        "spools": make_spool_table(group) if len(spools) > 1 else None,
        "remarks": [
            replace_names(f"{note.where}: {note.message}")
            for note in group.notes
            if note.severity is Severity.INFO
        ],
    }


def _questions(campaign: Campaign, stems: Mapping[str, str]) -> Iterator[dict[str, Any]]:
    """Yield the comparisons of groups that differ in one field, field by field."""
    drawn: dict[str, list[tuple[str, Any]]] = {}
    for family in find_families(campaign):
        heading = describe_context(family.groups, family.field)
        drawn.setdefault(family.field, []).append((heading, make_family_plots(family, stems)))
    for name, pairs in groupby(list_single_field_pairs(campaign), key=lambda pair: pair.field):
        of_field = list(pairs)
        tables = [make_pair_table(pair) for pair in of_field]
        answers = tuple(map(make_answer_cells, of_field))
        yield {
            "field": name,
            "name": name_field(name),
            "answers": Table(f"Verdicts: {name_field(name)}", _ANSWER_HEADS, answers),
            "comparisons": drawn.get(name, []),
            "tables": [replace(table, notes=()) for table in tables],
            "notes": list(dict.fromkeys(note for table in tables for note in table.notes)),
        }


SCRIPTS: Final = ("page_tables.js", "page_plots.js", "page_decisions.js")
STYLE: Final = "page_answers.css"
LOOKS: Final = "page_looks.css"
_SCHEMA: Final = 1
_NO_NETWORK: Final = "connect-src 'none'"
_OWN_SERVER: Final = "connect-src 'self'"


def read_page_script() -> Markup:
    """Read the script of a page for its ``script`` element.

    The script sorts and filters tables, zooms figures and stores decisions. It defines no global
    names and uses no network.
    """
    parts = "\n".join(_text(name) for name in SCRIPTS)
    return Markup(f'"use strict";\n(() => {{\n{parts}}})();\n')


def write_page_data(campaign: Campaign, *, report: str) -> Markup:
    """Write the data of the script for a ``script`` element of type ``application/json``.

    Parameters
    ----------
    campaign : with the current entries of its ``decisions.json``
    report : id of the report

    Returns
    -------
    JSON in which no text can end the element.
    """
    data = {
        "schema": _SCHEMA,
        "campaign": campaign.name,
        "report": report,
        "labpipe": campaign.labpipe_version,
        "decisions": [dict(decision) for decision in campaign.decisions],
    }
    # Escaped to ASCII: a name may contain a lone surrogate.
    text = json.dumps(data, separators=(",", ":")).replace("&", r"\u0026")
    return Markup(text.replace("<", r"\u003c").replace(">", r"\u003e"))


def fill_template(template: str, **values: Any) -> str:
    """Fill the template of a page; all texts are escaped.

    Parameters
    ----------
    template : name of the file, or the text of a template
    values : of all names in the template
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


def make_style(footer: str, more: str) -> Markup:
    """Make the style sheet of a page.

    Parameters
    ----------
    footer : of each printed sheet, from `write_css_string`
    more : rules of this page alone
    """
    return Markup(f"{_text(LOOKS).replace('var(--footer)', footer)}{more}")


def compute_style_hash(text: str) -> Markup:
    """Compute the SHA-256 of a style or a script for the security policy of the page.

    Parameters
    ----------
    text : of the style or the script, as in the page
    """
    digest = hashlib.sha256(replace_unprintable(text).encode()).digest()
    return Markup(f"'sha256-{base64.b64encode(digest).decode()}'")


def write_css_string(text: str) -> str:
    """Write a text as an escaped string of a style sheet.

    Parameters
    ----------
    text : letters and digits are kept, all other characters escaped
    """
    plain = (
        letter if letter.isascii() and letter.isalnum() else f"\\{ord(letter):x} "
        for letter in replace_unprintable(text)
    )
    return f'"{"".join(plain)}"'


def allow_own_server(page: str) -> str:
    """Allow a page to connect to the server that it comes from.

    Parameters
    ----------
    page : of a report, whose policy forbids connections

    Returns
    -------
    The page with a policy that allows connections to its own server. A page without a policy is
    unchanged; it saves decisions as a file.
    """
    head, policy, rest = page.partition(_NO_NETWORK)
    return page if "<body" in head or not policy else f"{head}{_OWN_SERVER}{rest}"


def _text(name: str) -> str:
    return (files("labpipe.report") / name).read_text(encoding="utf-8")


PAGE_FILE = "report.html"
TABLES_FILE = "tables.xlsx"
FIGURES_FOLDER = "figures"


@dataclass(frozen=True, slots=True)
class Extras:
    """Optional parts of a report.

    Parameters
    ----------
    letterhead : of the page
    formats : of figures as files: ``svg``, ``png``, ``pdf``; empty for no files
    test_pages : page of each test by its address below the folder of the report
    is_journal : draw the figures in the style of a journal
    """

    letterhead: Letterhead = PLAIN
    formats: tuple[str, ...] = ()
    test_pages: Mapping[str, str] = field(default_factory=dict)
    is_journal: bool = False


NOTHING_MORE = Extras()


def write_report(campaign: Campaign, folder: Path, extras: Extras = NOTHING_MORE) -> list[Path]:
    """Write the report of a campaign.

    Parameters
    ----------
    campaign : groups with their statistics; groups may be empty
    folder : made if it does not exist; files of other names stay
    extras : letterhead, figures as files, pages of single tests

    Returns
    -------
    The files: page, workbook, pages of tests, figures.

    Raises
    ------
    StoreError
        If a file cannot be written.
    """
    page = render_page(
        campaign, letterhead=extras.letterhead, has_test_pages=bool(extras.test_pages)
    )
    tables, pages = folder / TABLES_FILE, {PAGE_FILE: page, **extras.test_pages}
    with writing(folder, "a report"):
        for name, text in pages.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(replace_unprintable(text), encoding="utf-8")
        save_workbook(campaign, tables)
        figures = _save_figures(campaign, folder / FIGURES_FOLDER, extras)
    return [folder / PAGE_FILE, tables, *(folder / name for name in extras.test_pages), *figures]


def _save_figures(campaign: Campaign, folder: Path, extras: Extras) -> list[Path]:
    """Write the figures of each group, and of comparisons, each at least as SVG."""
    if not extras.formats:
        return []
    names = make_stems(group.name for group in campaign.groups)
    figures_to_save = [
        drawing._replace(name=f"{stem}-{drawing.name}")
        for group, stem in zip(campaign.groups, names, strict=True)
        for drawing in list_group_figures(group)
    ]
    figures_to_save += list_family_figures(campaign)
    return save_pages(
        figures_to_save,
        folder,
        png="png" in extras.formats,
        pdf="pdf" in extras.formats,
        dpi=200,
        is_journal=extras.is_journal,
    )
