"""The second rod in space: in one plane beside links with angles, in space beside the package."""

from __future__ import annotations

import numpy as np
import pytest

from tests.judges.foreign.planar_rod import PlanarRod, Stops
from tests.line_coverage.drawn_lines import FIRST_SEED, KINDS, draw
from tests.line_coverage.predicted_lines import nominal_torsion
from tests.line_coverage.second_truths import second_truth, table
from tests.line_coverage.space_rod import SpaceRod, turned
from tests.line_coverage.true_lines import true_line

LENGTH = 0.2
LAW = Stops(2e-4, np.array([3e-4, 2e-4]), np.array([1.0, 4.0]))
HALF = 0.5**0.5
ALONG_X = np.array([HALF, 0.0, HALF, 0.0])
"""Turns z into x: d1 down, d2 along y."""


def rod() -> SpaceRod:
    weight = np.array([0.0, 0.0, -0.05])
    return SpaceRod(LENGTH, LAW, 3e-4, weight=weight, natural=np.zeros(2), frame=ALONG_X)


def test_in_a_plane_it_does_what_links_with_angles_do() -> None:
    flat = PlanarRod(LENGTH, 80, LAW, weight=0.05, has_far_clamp=False)
    space = rod()
    for force in (0.0, -0.01, -0.02, -0.01, 0.0):
        flat.load(np.array([0.0, force]))
        space.load(np.array([0.0, 0.0, force]))
    links, line = flat.shape(), space.shape()
    assert line.places[-1, [0, 2]] == pytest.approx(links.places[-1], abs=1e-4 * LENGTH)
    assert np.abs(line.places[:, 1]).max() < 1e-12
    assert line.places[-1, 2] < -0.1 * LENGTH  # most of it is what the stops keep
    assert line.start_moment[1] == pytest.approx(links.start_moment, rel=1e-3)
    assert line.start_force == pytest.approx([0.0, 0.0, 0.05 * LENGTH])


def test_what_holds_its_end_may_let_go() -> None:
    space = rod()
    space.load(np.array([0.0, -0.01, -0.01]))
    place, frame = space.length * space.state[:3, -1], space.state[3:7, -1]
    held = space.shape()
    space.hold(place, frame)
    assert space.shape().places == pytest.approx(held.places, abs=1e-5 * LENGTH)
    assert space.force * space.unit / LENGTH**2 == pytest.approx(
        [0.0, -0.01, -0.01], abs=1e-3 * space.unit / LENGTH**2
    )
    space.let_go()
    free = space.shape()
    assert free.start_force == pytest.approx([0.0, 0.0, 0.05 * LENGTH], abs=1e-9)
    assert -0.5 < free.places[-1, 1] / held.places[-1, 1] < 0.9


def test_vectors_turn_with_their_frames() -> None:
    assert turned(ALONG_X, np.array([0.0, 0.0, 1.0])) == pytest.approx([1.0, 0.0, 0.0])
    assert turned(ALONG_X, np.array([0.0, 1.0, 0.0])) == pytest.approx([0.0, 1.0, 0.0])


@pytest.mark.slow
def test_both_truths_of_a_line_in_space_agree() -> None:
    kind = next(kind for kind in KINDS if kind.name == "space push")
    drawn = draw(kind, FIRST_SEED)
    torsion = nominal_torsion(drawn.wire)
    one, other = true_line(kind, drawn, torsion), second_truth(kind, drawn, torsion)
    assert one.held == pytest.approx(other.held, abs=1e-4 * drawn.length)
    assert one.back == pytest.approx(other.back, abs=1e-4 * drawn.length)
    assert one.moment[1:] == pytest.approx(other.moment[1:], rel=1e-3)
    assert one.bend_radius == pytest.approx(other.bend_radius, rel=5e-3)


def test_truths_are_put_beside_each_other_by_the_width_of_a_band() -> None:
    row = {"name": "shape", "truth": 1.0, "lower": 0.5, "upper": 2.5}
    line = {"about": {"wire": "A1"}, "rows": [row]}
    lines = {"space bow": {41000: line, 41001: {**line, "rows": []}, 41002: line}}
    numbers = {("space bow", seed): {"shape": 1.02} for seed in (41000, 41001)}
    assert table(lines, {**numbers, ("space bow", 41002): {}}).splitlines()[2:] == [
        "| space bow 41000 | A1 | 1.00 % |",
        "| space bow 41002 | A1 | not followed |",
    ]


@pytest.mark.slow
def test_a_line_that_it_cannot_follow_is_said() -> None:
    with pytest.raises(RuntimeError, match=r"singular Jacobian|mesh nodes"):
        rod().hold(np.array([3.0 * LENGTH, 0.0, 0.0]), ALONG_X)
