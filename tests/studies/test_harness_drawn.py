"""What the figures are given: signs where things are, shapes of the steps that were asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labpipe.studies.harness_drawn import drawn_harness, drawn_sweep
from labpipe.studies.harness_followed import FollowedHarness
from labpipe.studies.harness_study import follow_harness
from tests.builders.harness_files import STIFFNESS, arch, pushed, written


def done(folder: Path, text: str) -> FollowedHarness:
    return follow_harness(written(folder, text), out=folder / "out", figures=False)


@pytest.mark.slow
def test_signs_are_where_things_are_at_the_end(tmp_path: Path) -> None:
    text = pushed(STIFFNESS).replace(
        "steps: 10",
        "  - {kind: string, name: thread, at: 100 mm, anchor: [90 mm, 0 mm, 150 mm],\n    "
        "length: 155 mm}\n"
        "  - {kind: load, name: weight, at: 50 mm, force: [0 N, 0 N, -1 mN]}\n"
        "  - {kind: plane, name: table, point: [0 mm, 0 mm, -60 mm]}\nsteps: 10",
    )
    found = done(tmp_path, text)
    drawn = drawn_harness(found)
    marks = {mark.name: mark for mark in drawn.marks}
    assert list(marks) == ["bench", "gripper", "thread", "weight"]
    node = found.laid.nodes["gripper"]
    assert marks["gripper"].position == pytest.approx(found.path.last.positions[node])
    assert (marks["gripper"].holds, marks["bench"].holds) == (False, True)
    assert marks["gripper"].way[-1] == pytest.approx([0.06, 0.0, 0.045])
    assert not marks["bench"].way.size
    assert marks["bench"].direction == pytest.approx([1.0, 0.0, 0.0])
    assert marks["thread"].way[0] == pytest.approx(found.path.last.positions[-1])
    ((point, normal),) = drawn.planes
    assert (point[2], normal.tolist()) == (-0.06, [0.0, 0.0, 1.0])
    assert [shape.step for shape in drawn.shapes] == [8, 10]
    assert drawn.allowed == pytest.approx(0.01)
    assert "Allowed bend radius 10 mm, assumed: 5 times the outer diameter of 2 mm." in drawn.note


@pytest.mark.slow
def test_bands_and_sweeps(tmp_path: Path) -> None:
    section = STIFFNESS.replace("}", ", stiffness_uncertainty: 10 %}")
    found = done(tmp_path, arch(section, more="sweep: {length: [240 mm, 190 mm]}\n"))
    (shape,) = drawn_harness(found).shapes
    assert shape.band is not None
    low, high = shape.band
    assert np.all(low <= shape.positions)
    assert np.all(shape.positions <= high)
    assert shape.radius_band is not None
    assert np.all(shape.radius_band[0] <= shape.radius_band[1])
    sweep = drawn_sweep(found)
    assert sweep is not None
    assert sweep.length.tolist() == [0.19, 0.24]
    assert sweep.radius_band is not None
    low, high = sweep.radius_band
    assert np.all((low <= sweep.radius) & (sweep.radius <= high))
    assert len(sweep.shapes) == 2
    assert drawn_harness(found).note.startswith("brought nearer. Line of")


def test_no_sweep(tmp_path: Path) -> None:
    found = done(tmp_path, arch())
    assert drawn_sweep(found) is None
    (shape,) = drawn_harness(found).shapes
    assert (shape.band, shape.radius_band) == (None, None)
