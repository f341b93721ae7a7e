"""Workbooks of reports, as a program finds them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from openpyxl import load_workbook
from openpyxl.workbook import Workbook

from labpipe.records.group import Campaign
from labpipe.report.report_workbook import save_workbook


def saved(campaign: Campaign, folder: Path) -> Workbook:
    """The workbook of a campaign, written to a folder and read."""
    save_workbook(campaign, folder / "tables.xlsx")
    return load_workbook(folder / "tables.xlsx")


def table(book: Workbook, name: str) -> list[dict[str, Any]]:
    """Rows of a sheet by its heads."""
    heads, *rows = book[name].iter_rows(values_only=True)
    return [dict(zip(map(str, heads), row, strict=True)) for row in rows]
