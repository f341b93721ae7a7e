"""The report of a campaign: one page, figures and a workbook, written into a folder."""

from __future__ import annotations

from pathlib import Path

from labpipe.errors import StoreError, complaint
from labpipe.records.group import Campaign
from labpipe.report.comparison_figures import figures_of_families
from labpipe.report.group_figures import save_drawings, stems
from labpipe.report.lab_page import FiguresBetween, render_page
from labpipe.report.place_figures import place_figures
from labpipe.report.saving import SavedFigure, save_report_figures
from labpipe.report.wording import printable
from labpipe.report.workbook import save_workbook

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
    try:
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
    except OSError as error:
        message = complaint(
            folder,
            "",
            expected="a folder that a report can be written to",
            found=str(error),
            remedy="Make room, or change the permissions, and make the report again.",
        )
        raise StoreError(message) from error
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
