"""The bend of 45 degrees as solid bricks in CalculiX (``ccx``): no beam, no rod, in space.

Bricks shear and stretch, and warp where they twist: what they find is compared with the rod that
has the torsion constant of a square, 0.1406. Eight bricks along the bend are 0.1 % from 16.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from tests.judges.judged_rods import bend_tip

LOAD = 600.0
TORSION = 0.140577
ACROSS, ALONG = 2, 8
# Corners, then edges, of a brick of 20 nodes, in half steps along its three directions.
BRICK = [
    *[(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)],
    *[(1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2)],
    *[(0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)],
]


def place(i: int, j: int, k: int) -> tuple[float, float, float]:
    """Of a node: i across, up; j across in the plane, outwards; k along the bend."""
    up, out = (0.5 * each / ACROSS - 0.5 for each in (i, j))
    angle = 0.25 * np.pi * k / (2 * ALONG)
    radius = 100.0 + out
    return radius * np.sin(angle), 100.0 - radius * np.cos(angle), up


def deck() -> str:
    """Clamped at its start, pulled up at its end evenly, in increments that ccx chooses."""
    bricks = [
        [(i + 2 * a, j + 2 * b, k + 2 * c) for i, j, k in BRICK]
        for a, b, c in product(range(ACROSS), range(ACROSS), range(ALONG))
    ]
    used = sorted({node for brick in bricks for node in brick})
    number = {node: count for count, node in enumerate(used, start=1)}
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{number[node]}, " + ", ".join(f"{x:.12g}" for x in place(*node)) for node in used]
    lines.append("*ELEMENT, TYPE=C3D20R, ELSET=BEND")
    for count, brick in enumerate(bricks, start=1):
        names = [str(number[node]) for node in brick]
        lines += [f"{count}, " + ", ".join(names[:10]) + ",", ", ".join(names[10:])]
    ends = [[number[node] for node in used if node[2] == k] for k in (0, 2 * ALONG)]
    for name, nodes in zip(("FOOT", "TIP"), ends, strict=True):
        lines.append(f"*NSET, NSET={name}")
        lines += [f"{node}," for node in nodes]
    lines += ["*BOUNDARY", "FOOT, 1, 3", "*MATERIAL, NAME=M", "*ELASTIC", "1e7, 0.0"]
    lines += ["*SOLID SECTION, ELSET=BEND, MATERIAL=M"]
    lines += ["*STEP, NLGEOM, INC=1000", "*STATIC", "0.01, 1.0, 1e-8, 0.025", "*CLOAD"]
    lines += [f"{node}, 3, {LOAD / len(ends[1]):.12g}" for node in ends[1]]
    return "\n".join([*lines, "*NODE PRINT, NSET=TIP", "U", "*END STEP", ""])


@pytest.mark.skipif(shutil.which("ccx") is None, reason="ccx is not installed")
def test_bend_of_45_degrees(tmp_path: Path) -> None:
    """Within 0.3 % of how far the tip moves; codes differ by 0.5 % on this bend."""
    (tmp_path / "bend.inp").write_text(deck())
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run(["ccx", "-i", "bend"], cwd=tmp_path, env=environment, check=True, timeout=900)
    text = (tmp_path / "bend.dat").read_text()
    last = text[text.rindex("displacements") :]
    rows = re.findall(r"^\s*\d+((?:\s+\S+){3})\s*$", last, flags=re.MULTILINE)
    moved = np.array([row.split() for row in rows], dtype=float)
    start = place(ACROSS, ACROSS, 2 * ALONG)
    found = np.array(start) + np.mean(moved, axis=0)
    rod = bend_tip(64, torsion=TORSION)
    assert np.linalg.norm(rod - found) < 0.003 * np.linalg.norm(found - start)
