"""Bands of a harness, where the answer to its one cause is known."""

from __future__ import annotations

from pathlib import Path

import pytest
from scipy.stats import rice

from labpipe.protocol.load import load_harness
from labpipe.rod.statics import follow
from labpipe.studies.harness_bands import HarnessBands, harness_bands
from labpipe.studies.harness_line import Inputs, laid
from labpipe.studies.harness_section import material_of
from tests.builders.harness_files import STIFFNESS, arch, written

TEN_PERCENT = STIFFNESS.replace("}", ", stiffness_uncertainty: 10 %}")
NO_WEIGHT = "gravity: [0 m/s^2, 0 m/s^2, 0 m/s^2]\n"


def bands(
    folder: Path, section: str, more: str = "", *, text: str = ""
) -> tuple[HarnessBands | None, int]:
    file = written(folder, text or arch(section, more=more))
    harness = load_harness(file)
    material = material_of(harness, file)
    count = 0

    def follow_line(number: int, inputs: Inputs):  # type: ignore[no-untyped-def]
        nonlocal count
        count += 1
        ready = laid(harness, material.sections[number](inputs), inputs)
        return follow(ready.line, ready.boundaries, steps=harness.steps), ready

    return harness_bands(follow_line, material, (4, 8)), count


@pytest.mark.slow
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


@pytest.mark.slow
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


BARE = """\
version: 1
line:
  length: 300 mm
  elements: 12
  section: {bending_stiffness: 12000 N*mm^2, torsional_stiffness: 8000 N*mm^2,
    largest_curvature: 200 1/m, diameter: 5.8 mm, mass_per_length: 55 g/m}
  spool: {curvature: 0.02 1/m, spread: 1 1/m}
boundaries:
  - {kind: clip, name: left, at: start, position: [0 mm, 0 mm, 0 mm], direction: [1, 0, 0]}
"""
"""A line that is nearly straight, as it comes from its spool."""
SWUNG = """\
  - kind: grip
    name: right
    at: end
    holds: position
    path:
      - {step: 4, position: [285 mm, 0 mm, 60 mm]}
      - {step: 8, position: [290 mm, 0 mm, 0 mm]}
"""
"""A grip that lets a bow swing out of its plane."""


def test_a_curl_in_two_directions_has_the_band_of_its_size(tmp_path: Path) -> None:
    """Without weight the curvature is |(k + a, b)|, a and b normal: Rice's distribution."""
    found, _ = bands(tmp_path, "", text=f"{BARE}steps: 8\n{NO_WEIGHT}")
    assert found is not None
    low, high = (float(rice.ppf(share, 0.02)) for share in (0.025, 0.975))
    for name in ("smallest_bend_radius", "smallest_bend_radius_on_the_way"):
        interval = found.intervals[name]
        assert 1.0 / interval.lower == pytest.approx(high, rel=0.03)
        assert 1.0 / interval.upper == pytest.approx(min(low, 0.02), rel=0.05)
    assert found.intervals["lowest_point"].upper <= 0.0, "its begin is held there"
    assert found.doubt is None


@pytest.mark.slow
def test_causes_that_do_not_add_up_are_said(tmp_path: Path) -> None:
    found, count = bands(tmp_path, "", text=f"{BARE}{SWUNG}steps: 8\n")
    assert found is not None
    assert count == 5 + 6, "six draws are solved whole"
    assert found.doubt is not None
    assert found.doubt.code == "causes_do_not_add"
    last, way = (
        found.intervals[name]
        for name in ("smallest_bend_radius", "smallest_bend_radius_on_the_way")
    )
    assert way.lower <= last.lower
    assert way.upper <= last.upper


def test_nothing_believed_no_bands(tmp_path: Path) -> None:
    assert bands(tmp_path, STIFFNESS) == (None, 0)
