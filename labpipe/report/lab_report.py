"""The report of a campaign: one page, figures and a workbook, written into a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labpipe.records.group import Campaign, Group
from labpipe.records.quality import Severity
from labpipe.report.bundle_figures import has_bundles, place_figures, place_table
from labpipe.report.concerns import sentences
from labpipe.report.group_figures import save_drawings, stems
from labpipe.report.group_plots import count_words
from labpipe.report.group_tables import (
    cause_lines,
    key_number_tables,
    means_of,
    method_tables,
    note_table,
    sample_tables,
    slip_table,
    spool_means,
    table_of_tests,
)
from labpipe.report.question_figures import figures_of_families
from labpipe.report.questions import (
    answer_table,
    answering_pairs,
    field_words,
    question_table,
    remarks_on_pairs,
)
from labpipe.report.ranked_causes import find_causes
from labpipe.report.report_workbook import save_workbook
from labpipe.report.saving import SavedFigure, save_report_figures, written_to
from labpipe.report.wording import count_of, printable, with_names_in_words

if TYPE_CHECKING:
    from markupsafe import Markup


_TEMPLATE = "lab_report.html"


@dataclass(frozen=True, slots=True)
class FiguresBetween:
    """Figures over several groups.

    Parameters
    ----------
    questions : by the field that the groups differ in
    places : of bundles between slipping and sticking
    """

    questions: Mapping[str, Sequence[SavedFigure]] = field(default_factory=dict)
    places: Sequence[SavedFigure] = ()

    @property
    def every(self) -> list[SavedFigure]:
        """All of them, in the order of the page."""
        return [*self.places, *(each for own in self.questions.values() for each in own)]


def render_page(
    campaign: Campaign,
    stems: Sequence[str],
    figures: Sequence[Sequence[SavedFigure]],
    between: FiguresBetween | None = None,
) -> str:
    """Write the page of a campaign.

    Parameters
    ----------
    campaign : all that is shown
    stems : one per group: its name in links
    figures : of each group
    between : over several groups

    Returns
    -------
    An HTML document that needs no other file, no network and no script. Every text of the campaign
    is escaped.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    between = between or FiguresBetween()
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    groups = [_group(*each) for each in zip(campaign.groups, stems, figures, strict=True)]
    return environment.get_template(_TEMPLATE).render(
        campaign=campaign,
        summary=_summary(campaign),
        causes=cause_lines(find_causes(campaign)),
        notes=note_table(campaign),
        groups=groups,
        answers=answer_table(campaign),
        key_numbers=key_number_tables(campaign),
        questions=_questions(campaign, between.questions),
        remarks_on_pairs=remarks_on_pairs(campaign),
        has_bundles=has_bundles(campaign),
        places=place_table(campaign),
        place_figures=_inline(between.places),
        protocols=", ".join(sorted({group.protocol for group in campaign.groups})) or "none",
        methods=method_tables(campaign),
        tests=table_of_tests(campaign),
        classes=_classes([*figures, between.every]),
    )


def _classes(figures: Sequence[Sequence[SavedFigure]]) -> Markup:
    """The looks of all drawings, each once; made by matplotlib, none of it said by a person."""
    from markupsafe import Markup

    every = {
        name: look
        for group in figures
        for each in group
        for name, look in each.drawing.classes.items()
    }
    return Markup("\n".join(f".{name} {{{look}}}" for name, look in every.items()))


def _summary(campaign: Campaign) -> str:
    """What was tested, in one sentence."""
    samples = [sample for group in campaign.groups for sample in group.samples]
    spools = {(sample.specimen.type, sample.specimen.spool) for sample in samples}
    protocols = sorted({group.protocol for group in campaign.groups})
    words = (
        f"{count_of(len(samples), 'sample')} from {count_of(len(spools), 'spool')} in"
        f" {count_of(len(campaign.groups), 'group')}, tested by"
        f" {', '.join(protocols) or 'no protocol'}."
    )
    if campaign.left_out:
        words += f" {count_of(len(campaign.left_out), 'test')} could not be read."
    if campaign.rejected:
        were = "was" if len(campaign.rejected) == 1 else "were"
        words += f" {count_of(len(campaign.rejected), 'test')} {were} rejected."
    return words


def _group(group: Group, stem: str, figures: Sequence[SavedFigure]) -> dict[str, Any]:
    return {
        "name": group.name,
        "stem": stem,
        "about": count_words(group),
        "protocol": group.protocol,
        "is_empty": not group.samples,
        "why_empty": sentences([group.band.reason]) or "The group has no sample.",
        "means": means_of(group),
        "spools": spool_means(group),
        "samples": sample_tables(group),
        "slips": slip_table(group),
        "figures": _inline(figures),
        "remarks": _remarks(group),
    }


def _inline(figures: Sequence[SavedFigure]) -> list[dict[str, Any]]:
    """Drawings made by matplotlib, with every text escaped: not text to be shown."""
    from markupsafe import Markup

    return [{"svg": Markup(each.drawing.element), "caption": each.caption} for each in figures]


def _questions(
    campaign: Campaign, figures: Mapping[str, Sequence[SavedFigure]]
) -> list[dict[str, Any]]:
    """What groups that differ in one field tell of it, field by field."""
    pairs = groupby(answering_pairs(campaign), key=lambda pair: pair.field)
    return [
        {
            "name": field_words(name),
            "figures": _inline(figures.get(name, ())),
            "tables": [question_table(pair) for pair in own],
        }
        for name, own in pairs
    ]


def _remarks(group: Group) -> list[str]:
    """Notes that change nothing; those of several samples that say the same stand once."""
    said: dict[str, list[str]] = {}
    notes = [(sample.test, note) for sample in group.samples for note in sample.quality]
    for test, note in (*notes, *(("", note) for note in group.notes)):
        if note.severity is Severity.INFO:
            words = with_names_in_words(f"{note.where}: {note.message}")
            said.setdefault(words, []).append(test)
    return [f"{', '.join(filter(None, tests))} \u00b7 {words}" for words, tests in said.items()]


PAGE_FILE = "report.html"
TABLES_FILE = "tables.xlsx"
FIGURES_FOLDER = "figures"


def write_report(campaign: Campaign, folder: Path) -> list[Path]:
    """Write the report of a campaign.

    Parameters
    ----------
    campaign : groups with their statistics; groups may be empty
    folder : made if it is not there; files of other names stay

    Returns
    -------
    The page, the workbook, then as SVG, PNG and PDF the figures of each group, and those that
    compare groups.

    Raises
    ------
    StoreError
        If a file cannot be written.
    """
    figures = folder / FIGURES_FOLDER
    names = stems(group.name for group in campaign.groups)
    with written_to(folder, "a report", again="make the report"):
        figures.mkdir(parents=True, exist_ok=True)
        drawn = [
            save_drawings(group, figures, stem=name)
            for group, name in zip(campaign.groups, names, strict=True)
        ]
        page, tables = folder / PAGE_FILE, folder / TABLES_FILE
        between = _between(campaign, figures)
        text = printable(render_page(campaign, names, drawn, between))
        page.write_text(text, encoding="utf-8")
        save_workbook(campaign, tables)
    every = [*(figure for each in drawn for figure in each), *between.every]
    return [page, tables, *(file for figure in every for file in figure.files)]


def _between(campaign: Campaign, folder: Path) -> FiguresBetween:
    """Draw what compares groups."""
    questions: dict[str, list[SavedFigure]] = {}
    wanted = list(figures_of_families(campaign))
    saved = save_report_figures([figure for _, figure in wanted], folder)
    for (name, _), figure in zip(wanted, saved, strict=True):
        questions.setdefault(name, []).append(figure)
    return FiguresBetween(questions, save_report_figures(place_figures(campaign), folder))
