"""The report of a campaign: one page, figures and a workbook, written into a folder."""

from __future__ import annotations

from pathlib import Path

from labpipe.errors import StoreError, complaint
from labpipe.records.group import Campaign
from labpipe.report.group_figures import save_drawings, stems
from labpipe.report.lab_page import render_page
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
    The page, the workbook, then the figures of each group as SVG, PNG and PDF.

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
        page.write_text(render_page(campaign, names, drawn), encoding="utf-8")
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
    return [page, tables, *(file for each in drawn for figure in each for file in figure.files)]
