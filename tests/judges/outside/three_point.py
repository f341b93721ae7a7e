"""Bending stiffness from three-point files as they are, without the readers of labpipe."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from labpipe.records.arrays import Floats

WINDOWS = {"first": (1.0 / 200.0, 1.0 / 50.0), "later": (1.0 / 20.0, 1.0 / 10.0)}
"""Deflection over span."""


def stiffness(folder: Path, bent: Any) -> float:
    """Mean of the tests' slope x span^3 / 48, N mm2."""
    span = float(bent["span_mm"])
    first, last = (share * span for share in WINDOWS[bent["window"]])
    slopes = []
    for name in bent["tests"]:
        deflection, load = _columns(folder / "lloyd_nexygen" / name)
        inside = (deflection >= first) & (deflection <= last)
        slopes.append(np.polyfit(deflection[inside], load[inside], 1)[0])
    return float(np.mean(slopes)) * span**3 / 48.0


def _columns(path: Path) -> tuple[Floats, Floats]:
    """Deflection, mm, and load, N, where both stand in a row."""
    lines = path.read_bytes().decode("utf-16-le").lstrip("\ufeff").splitlines()
    names = lines[0].split("\t")
    wanted = [names.index("Machine Extension (mm)"), names.index("Load (N)")]
    rows = [line.split("\t") for line in lines[1:] if line.strip()]
    found = [[row[i] for i in wanted] for row in rows if len(row) > max(wanted)]
    values = np.array([[float(cell) for cell in row] for row in found if all(row)])
    return values[:, 0], values[:, 1]
