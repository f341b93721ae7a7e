"""Lines before they are laid."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.sliders import SliderLaw, linear_moment_law
from labpipe.records.arrays import Floats
from labpipe.rod.line import Line, Section, line_along
from labpipe.rod.rotations import conjugate, matrices, multiply, rotation_vectors
from tests.builders.rods import linear_section, sliding_section, straight_line

SECTION = linear_section()


def arc(n: int, radius: float = 0.1, angle: float = 1.5) -> Floats:
    t = np.linspace(0.0, angle, n + 1)
    return np.stack([radius * np.sin(t), radius * (1.0 - np.cos(t)), 0.0 * t], axis=1)


def test_a_straight_line() -> None:
    line = straight_line(2.0, 4, SECTION, start=(1.0, 0.0, 0.0), direction=(0.0, 3.0, 0.0))
    np.testing.assert_allclose(line.positions[-1], [1.0, 2.0, 0.0])
    assert line.length == pytest.approx(2.0)
    assert line.stations == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0])
    axes = matrices(line.frames)
    np.testing.assert_allclose(axes[:, :, 2], np.tile([0.0, 1.0, 0.0], (4, 1)), atol=1e-15)
    np.testing.assert_allclose(axes[:, :, 0], np.tile([0.0, 0.0, 1.0], (4, 1)), atol=1e-15)


def test_a_line_along_points_is_not_twisted() -> None:
    t = np.linspace(0.0, 6.0, 61)
    helix = np.stack([np.cos(t), np.sin(t), 0.3 * t], axis=1)
    line = line_along(helix, SECTION, is_formed=True)
    np.testing.assert_allclose(line.natural[:, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(
        np.linalg.norm(line.natural, axis=1), 1.0 / (1.0 + 0.3**2), rtol=1e-3
    )
    steps = np.diff(helix, axis=0)
    np.testing.assert_allclose(
        matrices(line.frames)[:, :, 2], steps / np.linalg.norm(steps, axis=1)[:, None], atol=1e-14
    )
    assert not np.any(line_along(helix, SECTION).natural)


def test_a_line_knows_its_frames_at_the_nodes() -> None:
    """Of an arc: its tangents, at the ends as well."""
    line = line_along(arc(15), SECTION, is_formed=True)
    angles = 0.1 * np.arange(16)
    for node in range(16):
        direction = matrices(line.frame_at(node))[:, 2]
        np.testing.assert_allclose(
            direction, [np.cos(angles[node]), np.sin(angles[node]), 0.0], atol=1e-12
        )
    np.testing.assert_array_equal(line.frame_at(-1), line.frame_at(15))


def test_frames_at_the_nodes_share_a_turn_by_the_lengths() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.5, 0.0]])
    line = line_along(points, SECTION)
    whole = rotation_vectors(multiply(conjugate(line.frames[0]), line.frames[1]))
    part = rotation_vectors(multiply(conjugate(line.frames[0]), line.frame_at(1)))
    share = line.lengths[0] / line.lengths.sum()
    np.testing.assert_allclose(part, share * whole, atol=1e-14)


def test_sections_that_do_not_resist_are_refused() -> None:
    nothing = SliderLaw(0.0, np.zeros(0), np.zeros(0), 0.0, 1.0)
    with pytest.raises(ValueError, match="neither a stiffness nor sliders"):
        Section(nothing, 1e-3)
    law = linear_moment_law(1e-3, 10.0)
    with pytest.raises(ValueError, match=r"torsional_stiffness=0.0: .* > 0"):
        Section(law, 0.0)
    with pytest.raises(ValueError, match=r"axial_stiffness=-1\.0"):
        Section(law, 1e-3, axial_stiffness=-1.0)
    with pytest.raises(ValueError, match=r"coupling=1.0: .*sqrt"):
        Section(law, 1e-3, axial_stiffness=100.0, coupling=1.0)
    with pytest.raises(ValueError, match=r"mass_per_length=nan: .* >= 0"):
        Section(law, 1e-3, mass_per_length=np.nan)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"lengths": np.array([0.1, 0.0])}, "lengths"),
        ({"natural": np.zeros((2, 3))}, "2 curvatures at rest"),
        ({"positions": np.full((3, 3), np.nan)}, "positions: allowed are finite"),
        ({"frames": 2.0 * np.ones((2, 4))}, "frames: allowed are quaternions"),
    ],
)
def test_lines_that_are_none_are_refused(change: dict[str, Floats], said: str) -> None:
    plain = straight_line(0.2, 2, sliding_section())
    parts = {
        "lengths": plain.lengths,
        "positions": plain.positions,
        "frames": plain.frames,
        "natural": plain.natural,
    } | change
    with pytest.raises(ValueError, match=said):
        Line(section=plain.section, **parts)


def test_points_on_one_another_are_refused() -> None:
    with pytest.raises(ValueError, match="positions 1 and 2: allowed are points apart"):
        line_along(np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0]]), SECTION)
    with pytest.raises(ValueError, match=r"positions of shape \(1, 3\)"):
        line_along(np.zeros((1, 3)), SECTION)
