"""Report of a campaign: a page, a workbook and, on request, figures, written to a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from labpipe.records.group import Campaign, Group
from labpipe.records.quality import Severity
from labpipe.report.bundle_figures import has_bundles, place_figures, place_table
from labpipe.report.comparison_figures import figures_of_families
from labpipe.report.comparisons import remarks_on_pairs
from labpipe.report.group_figures import group_drawings, stems
from labpipe.report.group_panels import group_panels
from labpipe.report.group_tables import (
    cause_lines,
    method_tables,
    note_table,
    slip_table,
    spool_mean_table,
)
from labpipe.report.issues import find_causes, sentences
from labpipe.report.page_comparisons import questions
from labpipe.report.page_facts import (
    PageTests,
    days_words,
    instrument_lines,
    operators_words,
    report_id,
    roles_words,
    samples_of,
)
from labpipe.report.page_groups import (
    about_group,
    budget_causes,
    budget_drawing,
    number_table,
    samples_tables,
)
from labpipe.report.page_parts import (
    css_string,
    fill_template,
    page_data,
    page_script,
    page_style,
    style_hash,
    style_of,
)
from labpipe.report.page_tests import export_table, test_rows
from labpipe.report.report_workbook import save_workbook
from labpipe.report.saving import save_pages, written_to
from labpipe.report.summary_page import (
    KeyBlock,
    answers,
    count_words,
    fold,
    key_blocks,
    open_decisions,
)
from labpipe.report.wording import printable, replace_names

_TEMPLATE = "lab_report.html"
_NO_INSTRUMENTS = "no calibration certificate stated in the protocols"


@dataclass(frozen=True, slots=True)
class Letterhead:
    """Sender and customer of a report; all of it may be empty.

    Parameters
    ----------
    facts : names and values, such as laboratory, customer, order
    logo : picture as a ``data:`` address
    """

    facts: tuple[tuple[str, str], ...] = ()
    logo: str = ""


PLAIN = Letterhead()


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
    names = stems(group.name for group in campaign.groups)
    report, script = report_id(campaign), page_script()
    style = style_of(css_string(f"{campaign.title}  \u00b7  report {report}"), page_style())
    return fill_template(
        _TEMPLATE,
        campaign=campaign,
        report=report,
        style=style,
        style_hash=style_hash(style),
        script=script,
        script_hash=style_hash(script),
        page_data=page_data(campaign, report=report),
        pages=has_test_pages,
        logo=letterhead.logo,
        **_first_screen(campaign, names, letterhead),
        **_other_sections(campaign, names),
    )


def _first_screen(
    campaign: Campaign, names: Sequence[str], letterhead: Letterhead
) -> dict[str, Any]:
    """Return the contents of page one."""
    tests, causes = PageTests(campaign, names), find_causes(campaign)
    open_ones = open_decisions(causes, tests)
    answer_rows, blocks = answers(campaign), key_blocks(campaign, names)
    folds = fold(len(answer_rows), blocks, len(open_ones))
    samples = samples_of(campaign)
    recorded = roles_words(samples)
    return {
        "counts": count_words(campaign, open_ones),
        "facts": _facts(campaign, letterhead),
        "instruments": instrument_lines(samples),
        "no_instruments": f"{recorded}; {_NO_INSTRUMENTS}" if recorded else _NO_INSTRUMENTS,
        "answers": answer_rows,
        "blocks": _limit_rows(blocks, folds.groups),
        "open_ones": open_ones,
        "folds": folds,
        "causes": cause_lines(causes),
    }


def _facts(campaign: Campaign, letterhead: Letterhead) -> list[tuple[str, str]]:
    samples = samples_of(campaign)
    made_on = str(campaign.made_on) if campaign.made_on else ""
    by = f"labpipe {campaign.labpipe_version}".strip()
    return [
        *letterhead.facts,
        ("Tested", f"{days_words(samples)} by {operators_words(samples)}"),
        ("Report", ", ".join(filter(None, [report_id(campaign), made_on, by]))),
        ("Protocols", _protocols(campaign)),
    ]


def _protocols(campaign: Campaign) -> str:
    return ", ".join(sorted({group.protocol for group in campaign.groups})) or "none"


def _limit_rows(blocks: Sequence[KeyBlock], max_rows: int) -> list[tuple[KeyBlock, int]]:
    """Limit the number of groups of each block that are shown at first."""
    blocks_with_counts = []
    for block in blocks:
        count = min(len(block.rows), max(max_rows, 0))
        blocks_with_counts.append((block, count))
        max_rows -= count
    return blocks_with_counts


def _other_sections(campaign: Campaign, names: Sequence[str]) -> dict[str, Any]:
    """Return the contents below page one."""
    tests = PageTests(campaign, names)
    groups = list(zip(campaign.groups, names, strict=True))
    by_stem = {stem: group.name for group, stem in groups}
    return {
        "groups": [_group(group, stem, tests) for group, stem in groups],
        "has_bundles": has_bundles(campaign),
        "places": place_table(campaign),
        "questions": questions(campaign, {group.name: stem for group, stem in groups}),
        "remarks_on_pairs": remarks_on_pairs(campaign),
        "notes": note_table(campaign),
        "rows": test_rows(campaign, tests, by_stem),
        "methods": method_tables(campaign),
        "protocols": _protocols(campaign),
        "exports": export_table(tests),
    }


def _group(group: Group, stem: str, tests: PageTests) -> dict[str, Any]:
    spools = {sample.specimen.spool for sample in group.samples}
    return {
        "name": group.name,
        "stem": stem,
        "about": about_group(group) if group.samples else "",
        "is_empty": not group.samples,
        "why_empty": sentences([group.band.reason]) or "The group has no samples.",
        "rejected": tests.rejected(stem),
        "plots": group_panels(group, stem, tests),
        "numbers": number_table(group),
        "budget": budget_drawing(group),
        "causes": budget_causes(group),
        "samples": samples_tables(group, tests),
        "slips": slip_table(group),
        "spools": spool_mean_table(group) if len(spools) > 1 else None,
        "remarks": _remarks(group),
    }


def _remarks(group: Group) -> list[str]:
    """Return the notes of the group without consequences."""
    return [
        replace_names(f"{note.where}: {note.message}")
        for note in group.notes
        if note.severity is Severity.INFO
    ]


PAGE_FILE = "report.html"
TABLES_FILE = "tables.xlsx"
FIGURES_FOLDER = "figures"


@dataclass(frozen=True, slots=True)
class Extras:
    """Optional parts of a report.

    Parameters
    ----------
    letterhead : of the page
    formats : of the figures as files: ``svg``, ``png``, ``pdf``; none for no files
    test_pages : by address below the report, the page of each test
    """

    letterhead: Letterhead = PLAIN
    formats: tuple[str, ...] = ()
    test_pages: Mapping[str, str] = field(default_factory=dict)


NOTHING_MORE = Extras()


def write_report(campaign: Campaign, folder: Path, extras: Extras = NOTHING_MORE) -> list[Path]:
    """Write the report of a campaign.

    Parameters
    ----------
    campaign : groups with their statistics; groups may be empty
    folder : made if it is not there; files of other names stay
    extras : letterhead, figures as files, pages of single tests

    Returns
    -------
    The page, the workbook, then the pages of tests and the figures.

    Raises
    ------
    StoreError
        If a file cannot be written.
    """
    with written_to(folder, "a report", again="make the report"):
        folder.mkdir(parents=True, exist_ok=True)
        page, tables = folder / PAGE_FILE, folder / TABLES_FILE
        text = render_page(
            campaign, letterhead=extras.letterhead, has_test_pages=bool(extras.test_pages)
        )
        page.write_text(printable(text), encoding="utf-8")
        save_workbook(campaign, tables)
        single = [_save_page(folder / name, text) for name, text in extras.test_pages.items()]
        figures = _save_figures(campaign, folder / FIGURES_FOLDER, extras.formats)
    return [page, tables, *single, *figures]


def _save_page(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(printable(text), encoding="utf-8")
    return path


def _save_figures(campaign: Campaign, folder: Path, formats: Sequence[str]) -> list[Path]:
    """Draw the figures of each group and those that compare groups, for papers and slides."""
    report_dpi = 200
    if not formats:
        return []
    names = stems(group.name for group in campaign.groups)
    wanted = [
        drawing._replace(name=f"{stem}-{drawing.name}")
        for group, stem in zip(campaign.groups, names, strict=True)
        for drawing in group_drawings(group)
    ]
    wanted += [figure for _, figure in figures_of_families(campaign)]
    wanted += place_figures(campaign)
    return save_pages(
        wanted,
        folder,
        what="figures",
        again="make the report",
        png="png" in formats,
        pdf="pdf" in formats,
        dpi=report_dpi,
    )
