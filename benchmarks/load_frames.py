"""Synthetic exports of load frames as large as the bounds speak of, and what reading must cost."""

from __future__ import annotations

import shutil
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import h5py
import numpy as np

CSV_BYTES = 18_000_000
XLSX_ROWS = 60_000
_SHEET = """\
test: {name}
protocol: tensile
specimen: {{type: synthetic, spool: s1, sample: 1, length: 100 mm}}
files: {{frame: {export}}}
overrides:
  results.stiffness.from: {{value: 5 mm, because: synthetic bar}}
  results.stiffness.to: {{value: 10 mm, because: synthetic bar}}
"""
READ_CSV = "import pandas as pd, sys; pd.read_csv(sys.argv[1], skiprows=6, header=[0, 1])"
READ_XLSX = (
    "import sys; from python_calamine import load_workbook as load;"
    "load(sys.argv[1]).get_sheet_by_index(0).to_python()"
)
OPEN_ALL = (
    "import sys, h5py\n"
    "for path in sys.argv[1:]:\n"
    "    with h5py.File(path) as file:\n"
    "        [dict(result.attrs) for result in file['results'].values()]\n"
    "        [part[()] for part in file['curve'].values() if isinstance(part, h5py.Dataset)]\n"
)


def pull(rows: int) -> np.ndarray:
    """Time (s), displacement (mm) and force (N) of a bar that yields at half the way."""
    random = np.random.default_rng(1)
    time = 0.01 * np.arange(1, rows + 1)
    way = 50.0 * time / time[-1]
    force = 20.0 * np.minimum(way, 25.0) + 2.0 * np.maximum(way - 25.0, 0.0)
    return np.column_stack([way, force + 0.05 * random.standard_normal(rows), time])


def write_csv_test(folder: Path, *, size: int = CSV_BYTES) -> Path:
    """A test with a TestSuite csv of `size` bytes; gives the export."""
    folder.mkdir(parents=True)
    export = folder / "pull.csv"
    head = (
        '\ufeff"File Path: C:\\Synthetic\\pull.csv   "\r\n"Test: Synthetic"\r\n"Test Run: 1"\r\n'
        '"Date: 3/4/2026 10:05:00 AM"\r\n""\r\n""\r\n'
        '"Crosshead ","Load ","Time "\r\n"mm","N","sec"\r\n'
    )
    line = '"{:.15g}","{:.15g}","{:.15g}"\r\n'
    lines = [line.format(*row) for row in pull(size // 40)]
    n_lines = np.searchsorted(np.cumsum([len(line) for line in lines]), size)
    with export.open("w", encoding="utf-8", newline="") as file:
        file.write(head + "".join(lines[:n_lines]))
    _write_sheet(folder, export)
    return export


def write_xlsx_test(folder: Path) -> Path:
    """A test with a workbook of `XLSX_ROWS`; gives the export."""
    from openpyxl import Workbook

    folder.mkdir(parents=True)
    export = folder / "pull.xlsx"
    book = Workbook(write_only=True)
    sheet = book.create_sheet("Synthetic")
    sheet.append(["Displacement (mm)", "Force (N)", "Time (s)"])
    for row in pull(XLSX_ROWS).tolist():
        sheet.append(row)
    book.save(export)
    _write_sheet(folder, export)
    return export


def copies(result: Path, folder: Path, count: int) -> list[Path]:
    """Processed tests that differ in their names, their exports and the scale of their forces."""
    paths = [folder / f"test-{number:03d}" / result.name for number in range(count)]
    for number, path in enumerate(paths):
        path.parent.mkdir(parents=True)
        shutil.copy(result, path)
        with h5py.File(path, "r+") as file:
            file.attrs["test"] = path.parent.name
            file["raw"].visititems(partial(_rename, path.parent.name))
            file["curve/force"][...] *= 1.0 + 0.01 * number
    return paths


def _rename(test: str, _: str, item: Any) -> None:
    """Give an export another hash, so that no two tests seem to be made of the same."""
    if "sha256" in item.attrs:
        renamed = [sha256(f"{test} {attr}".encode()).hexdigest() for attr in item.attrs["sha256"]]
        item.attrs["sha256"] = renamed


def _write_sheet(folder: Path, export: Path) -> None:
    text = _SHEET.format(name=folder.name, export=export.name)
    (folder / "test.yaml").write_text(text, encoding="utf-8")
