"""Run the notebooks of the documentation, and keep their output."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "notebooks"
_LONGEST_CELL = 300
"""Seconds."""


def executed(path: Path) -> Any:
    """Run a notebook from its first cell on.

    Parameters
    ----------
    path : the notebook; its file stays as it is

    Returns
    -------
    The notebook with new output, without times.

    Raises
    ------
    nbclient.exceptions.CellExecutionError
        If a cell raises.
    """
    from nbclient import NotebookClient

    notebook = _nbformat().reads(path.read_text(encoding="utf-8"), as_version=4)
    client = NotebookClient(notebook, timeout=_LONGEST_CELL, record_timing=False)
    client.execute()
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            output.get("metadata", {}).clear()
    return notebook


def _nbformat() -> Any:
    """The package, whose functions say no types."""
    return import_module("nbformat")


def keep(path: Path) -> None:
    """Run a notebook and keep what it says now."""
    path.write_text(_nbformat().writes(executed(path)) + "\n", encoding="utf-8")
