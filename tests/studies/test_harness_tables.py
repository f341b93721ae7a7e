"""Shape and forces as CSV and VTK."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from io import StringIO

import numpy as np
import pytest

from labpipe.protocol.load import load_harness
from labpipe.records.arrays import Floats
from labpipe.rod.path import RodPath
from labpipe.rod.statics import follow
from labpipe.studies.harness_line import Laid, laid
from labpipe.studies.harness_section import material_of
from labpipe.studies.harness_tables import forces_csv, shape_columns, shape_csv, shape_vtk
from tests.builders.harness_files import arch, written

STEPS = (4, 8)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[RodPath, Laid]:
    file = written(tmp_path_factory.mktemp("harness"), arch().replace("left", """'le"ft, one'"""))
    harness = load_harness(file)
    ready = laid(harness, material_of(harness, file).sections[0]({}), {})
    return follow(ready.line, ready.boundaries, steps=harness.steps), ready


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(StringIO(text)))


def column(table: list[dict[str, str]], name: str) -> Floats:
    return np.array([float(row[name]) for row in table])


def test_the_shape_has_a_row_for_each_node(made: tuple[RodPath, Laid]) -> None:
    path, ready = made
    table = rows(shape_csv(path, ready.line, STEPS, {}))
    assert [int(row["step"]) for row in table] == [4] * 17 + [8] * 17
    last = table[17:]
    places = np.column_stack([column(last, f"{axis} [m]") for axis in "xyz"])
    assert places == pytest.approx(path.last.positions, rel=1e-8, abs=1e-12)
    radius = column(last, "bend_radius [m]")
    assert radius == pytest.approx(1.0 / column(last, "curvature [1/m]"), rel=1e-8)
    assert list(last[0])[:3] == ["step", "node", "along [m]"]


def test_moments_and_tension_are_those_of_the_forces(made: tuple[RodPath, Laid]) -> None:
    """EI times the curvature is the bending moment; the pull of the clip is that in the line."""
    path, ready = made
    columns = shape_columns(path.last, ready.line)
    stiffness = ready.line.section.law.stiffness
    inner = slice(1, -1)
    assert columns["bending_moment [N*m]"][inner] == pytest.approx(
        stiffness * columns["curvature [1/m]"][inner], rel=0.01
    )
    pull = -path.last.reaction_forces[0]
    assert columns["tension [N]"][0] == pytest.approx(float(pull[0]), rel=0.05)
    assert columns["torque [N*m]"] == pytest.approx(np.zeros(17), abs=1e-9)


def test_bands_stand_beside_what_they_are_of(made: tuple[RodPath, Laid]) -> None:
    path, ready = made
    band = np.full((17, 4), 1.0), np.full((17, 4), 2.0)
    table = rows(shape_csv(path, ready.line, STEPS, {8: band}))
    assert {table[0]["z_lower [m]"], table[0]["curvature_upper [1/m]"]} == {""}
    assert [float(table[17][f"{name}_upper [m]"]) for name in "xyz"] == [2.0, 2.0, 2.0]
    assert float(table[33]["curvature_lower [1/m]"]) == 1.0


def test_forces_of_every_step_in_balance(made: tuple[RodPath, Laid]) -> None:
    path, ready = made
    table = rows(forces_csv(path, ready, {}))
    assert len(table) == 9 * 2
    last = table[-2:]
    assert [row["boundary"] for row in last] == ['le"ft, one', "right"]
    carried = [float(np.sum(column(last, f"f{axis} [N]"))) for axis in "xyz"]
    assert carried == pytest.approx([0.0, 0.0, 0.007 * 0.2 * 9.80665], abs=1e-6), "the weight"
    sizes = np.linalg.norm([[float(last[0][f"f{axis} [N]"]) for axis in "xyz"]])
    assert float(last[0]["force [N]"]) == pytest.approx(float(sizes))
    bands: Mapping[int, tuple[Floats, Floats]] = {8: (np.full((3, 3), -9.0), np.full((3, 3), 9.0))}
    with_bands = rows(forces_csv(path, ready, bands))
    assert (with_bands[-1]["fz_upper [N]"], with_bands[0]["fz_upper [N]"]) == ("9", "")


def test_the_vtk_is_a_line_for_each_step(made: tuple[RodPath, Laid]) -> None:
    path, ready = made
    lines = shape_vtk(path, ready.line, STEPS, "a line, 2 µm").splitlines()
    assert lines[:4] == [
        "# vtk DataFile Version 3.0", "a line, 2 ?m", "ASCII", "DATASET POLYDATA",
    ]  # fmt: skip
    assert lines[4] == "POINTS 34 double"
    points = np.array([list(map(float, line.split())) for line in lines[5:39]])
    assert points[17:] == pytest.approx(path.last.positions, rel=1e-8, abs=1e-12)
    assert lines[39] == "LINES 2 36"
    assert lines[41].split() == ["17", *map(str, range(17, 34))]
    assert lines[42:47] == [
        "CELL_DATA 2", "SCALARS step double 1", "LOOKUP_TABLE default", "4", "8",
    ]  # fmt: skip
    assert lines[47] == "POINT_DATA 34"
    at = lines.index("SCALARS curvature double 1") + 2
    curvature = shape_columns(path.last, ready.line)["curvature [1/m]"]
    assert list(map(float, lines[at + 17 : at + 34])) == pytest.approx(curvature.tolist(), rel=1e-8)
    assert not any(word in line for line in lines[48:] for word in ("inf", "nan"))
