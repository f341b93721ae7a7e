from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from labpipe.errors import StoreError
from labpipe.report.wire_figures import (
    plot_cantilever,
    plot_parts,
    plot_shares,
    plot_stiffness,
    save_wire_figures,
    wire_drawings,
)
from tests.builders.wire_tables import wire_table


def names(count: int) -> list[str]:
    table = wire_table("A1")
    tables = [replace(table, name=f"w{number}") for number in range(count)]
    return [drawing.name for drawing in wire_drawings(tables)]


def test_names_of_figures() -> None:
    assert names(1) == ["sections-1", "w0.stiffness", "w0.moment", "w0.cantilever"]
    assert names(2)[:3] == ["sections-1", "comparison-1", "w0.stiffness"]
    assert names(13)[:4] == ["sections-1", "comparison-1", "sections-2", "w0.stiffness"]
    assert len(names(13)) == 3 + 13 * 3
    assert names(0) == []


def test_names_of_wires_stay_inside_the_folder() -> None:
    table = replace(wire_table("A1"), name="../a:b")
    assert list(wire_drawings([table]))[-1].name == "..-a-b.cantilever"


@pytest.mark.slow
def test_all_figures(tmp_path: Path) -> None:
    table = replace(wire_table("A1"), name="$A_1$ <&>")
    told: list[str] = []
    files = save_wire_figures([table], tmp_path / "figures", say=told.append)
    assert sorted(files) == sorted((tmp_path / "figures").iterdir())
    assert [path.name for path in files[:2]] == ["sections-1.svg", "$A_1$ -&-.stiffness.svg"]
    assert told == [path.stem for path in files]
    again = save_wire_figures([table], tmp_path / "again")
    for first, second in zip(files, again, strict=True):
        assert first.read_bytes() == second.read_bytes()
        assert first.stat().st_size < 300_000


def test_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("")
    with pytest.raises(
        StoreError, match=r"x: expected a folder that figures of wires can be written to, found "
    ):
        save_wire_figures([wire_table("A1")], tmp_path / "x")


def test_drawing_program_is_loaded_only_when_a_figure_is_drawn() -> None:
    code = (
        "import sys, labpipe.report.wire_figures, labpipe.report.wire_workbook; "
        "sys.exit(any(name.split('.')[0] in {'matplotlib', 'openpyxl'} for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_what_is_doubtful_is_lighter() -> None:
    """White is laid over curves beyond the range of the insulation, and over no others."""
    table = wire_table("A2")
    sure = replace(table, doubtful_curvature=float("inf"), doubtful_deflection=float("inf"))
    for draw, start in (
        (plot_stiffness, table.doubtful_curvature),
        (plot_parts, table.doubtful_curvature),
        (plot_shares, table.doubtful_curvature),
        (plot_cantilever, 1e3 * table.doubtful_deflection),
    ):
        covers = []
        for each in (table, sure):
            axes = Figure().subplots()
            draw(each, axes)
            covers.append([p for p in axes.patches if isinstance(p, Rectangle)])
        [cover] = covers[0]
        assert cover.get_x() == pytest.approx(start)
        assert cover.get_facecolor() == (1.0, 1.0, 1.0, 0.6)
        assert covers[1] == []
