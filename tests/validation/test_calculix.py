"""An independent solution by finite elements: CalculiX CrunchiX (``ccx``), G. Dhondt, K. Wittig.

The decks of `labpipe.mechanics.decks.calculix` are run as they are; what the program prints is read
as a curve from elsewhere. Nothing in it is a beam: it solves for the displacements of solid bricks
with large rotations and a von Mises material.

Mesh: six bricks across half the section and five along are enough. With an elastic material and
loads to half the length, 10, 20 and 40 bricks along, and ten across, give loads 0.12 to 0.16 %
below the elastica, alike within 0.03 %. Through the deck, whose material may not be quite elastic,
10 along are 0.19 to 0.25 % below it and 5 along 0.17 % below to level. With the law of A2, 5, 8 and
10 along are -0.13 to +0.15 %, -0.18 to 0.00 % and -0.20 to -0.04 % from labpipe; with that of A3, 5
and 8 along are -0.12 to +0.94 % and -0.16 to +0.76 %. Most of the 2 % asked for is left for the
rounding of the law's first slope, see the head of a deck.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.mechanics.decks.calculix import format_calculix_deck
from labpipe.mechanics.law.plays import make_elastic_law
from labpipe.mechanics.law.thinning import make_concave_law
from labpipe.mechanics.wire.first_loading import compute_end_load_path
from labpipe.mechanics.wire.wire_table import tabulate_wire as table_of
from labpipe.readers.curve_files import CurveColumn, read_curve
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable
from labpipe.virtual_lab.specimens import WIRES
from tests.builders.wire_tables import spec_of, wire_table

pytestmark = pytest.mark.skipif(shutil.which("ccx") is None, reason="ccx is not installed")

N_ALONG = 5

CLOSE = 0.02


def pushed(table: WireTable, folder: Path, *, n_steps: int = 80) -> tuple[Floats, Floats]:
    """Tip deflection and end load, m and N, as the program finds them."""
    (folder / "wire.inp").write_text(
        format_calculix_deck(table, n_bricks_along=N_ALONG, n_steps=n_steps)
    )
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run(["ccx", "-i", "wire"], cwd=folder, env=environment, check=True, timeout=300)
    across, up = CurveColumn("deflection", "m"), CurveColumn("force", "N")
    return read_curve(folder / "wire.dat", across, up)


def compressed(name: str) -> WireTable:
    wire = WIRES[name]
    spec = replace(
        spec_of("A2", name),
        wire_diameter=wire.diameter,
        strand_diameters=(wire.strand, wire.strand),
        lay_angles=wire.lay_angles,
        insulation_thickness=wire.wall,
        layout="compressed",
    )
    return table_of(spec)


def test_a_linear_bar_is_the_elastica(tmp_path: Path) -> None:
    table = wire_table("A2")
    deflection, load = pushed(replace(table, moment=4e-4 * table.curvature), tmp_path, n_steps=12)
    expected = compute_end_load_path(make_elastic_law(4e-4), table.spec.length, deflection).load
    assert deflection[-1] == pytest.approx(0.6 * table.spec.length)
    assert load == pytest.approx(expected, rel=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["A1", "A2", "A3", "B1", "B2"])
def test_wires(name: str, tmp_path: Path) -> None:
    table = compressed(name) if name.startswith("B") else wire_table(name)
    deflection, load = pushed(table, tmp_path)
    assert deflection[-1] >= 0.05
    held = (deflection >= 0.005) & (deflection <= 0.05)
    assert np.count_nonzero(held) > 60
    law = make_concave_law(table.curvature[1:], table.moment[1:])
    expected = compute_end_load_path(law, table.spec.length, deflection[held]).load
    assert load[held] == pytest.approx(expected, rel=CLOSE)
