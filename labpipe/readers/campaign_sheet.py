"""Reads the table of a campaign: one row per test, as people keep it in a spreadsheet.

Writes this file: a person, with a spreadsheet program (xlsx, its first sheet) or a text editor (csv
parted by comma, semicolon or tab). Every cell is text here, with its place for messages; what the
columns mean is not known here.
"""

from __future__ import annotations

from pathlib import Path

from labpipe.readers.sheet_cells import (
    Cell,
    Table,
    as_table,
    csv_cells,
    is_workbook,
    workbook_cells,
)

__all__ = ["CampaignSheet", "Cell", "read_campaign_sheet"]

CampaignSheet = Table


def read_campaign_sheet(path: Path) -> CampaignSheet:
    """Read the table of a campaign.

    Parameters
    ----------
    path : an xlsx workbook, or a csv

    Returns
    -------
    The table.

    Raises
    ------
    ReadError
        If the file is neither, is damaged, holds no row below a heading, or has cells beyond it.
    """
    cells = workbook_cells(path) if is_workbook(path) else csv_cells(path)
    return as_table(cells, path, rows_of="one row per test")
