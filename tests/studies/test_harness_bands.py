"""Bands of a harness, where the answer to its one cause is known."""

from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.protocol.harness_loading import load_harness
from labpipe.rod.statics import follow
from labpipe.studies.harness_bands import HarnessBands, harness_bands
from labpipe.studies.harness_line import Inputs, laid
from labpipe.studies.harness_section import material_of
from tests.builders.harness_files import STIFFNESS, arch, written

TEN_PERCENT = STIFFNESS.replace("}", ", stiffness_uncertainty: 10 %}")
NO_WEIGHT = "gravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n"


def bands(folder: Path, section: str, more: str = "") -> tuple[HarnessBands | None, int]:
    file = written(folder, arch(section, more=more))
    harness = load_harness(file)
    material = material_of(harness, file)
    count = 0

    def follow_line(number: int, inputs: Inputs):  # type: ignore[no-untyped-def]
        nonlocal count
        count += 1
        ready = laid(harness, material.sections[number](inputs), inputs)
        return follow(ready.line, ready.boundaries, steps=harness.steps), ready

    return harness_bands(follow_line, material, (4, 8)), count


def test_without_weight_forces_go_with_the_stiffness_and_shapes_do_not(tmp_path: Path) -> None:
    """A line of one stiffness between clips: forces are 10 % off, the shape next to nothing.

    What is left is the twist of an arch that leaves its plane: it goes by EI / GJ.
    """
    found, count = bands(tmp_path, TEN_PERCENT, NO_WEIGHT)
    assert found is not None
    assert count == 3, "at its best and to both sides, each once"
    assert [each.step for each in found.line.states] == [4, 8]
    radius = found.intervals["smallest_bend_radius"]
    assert radius.upper == pytest.approx(radius.lower, rel=0.01)
    force = found.intervals["force.left"]
    assert force.upper / force.lower == pytest.approx(1.22 / 0.82, rel=0.03)
    assert force.lower > 0.0
    places = found.line.states[1].positions
    assert places.upper == pytest.approx(places.lower, abs=5e-4)


def test_numbers_lie_in_their_own_intervals(tmp_path: Path) -> None:
    found, _ = bands(tmp_path, TEN_PERCENT)
    assert found is not None
    assert set(found.intervals) >= {
        *("smallest_bend_radius", "smallest_bend_radius_on_the_way", "lowest_point"),
        *("force.left", "moment.right", "kept_curvature"),
    }
    way = found.intervals["smallest_bend_radius_on_the_way"]
    assert 0.0 < way.lower <= way.upper
    lowest = found.intervals["lowest_point"]
    assert lowest.lower < lowest.upper


def test_nothing_believed_no_bands(tmp_path: Path) -> None:
    assert bands(tmp_path, STIFFNESS) == (None, 0)
