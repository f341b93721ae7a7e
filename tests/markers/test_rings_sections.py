from __future__ import annotations

import numpy as np
import pytest

from labpipe.markers.rings import axis_at_rest, find_sections, section_twist
from labpipe.records.arrays import Flags
from labpipe.records.recording import MarkerTracks
from tests.builders.three_point import RADIUS, STROKE, BendingRecord, tracks

STILL = (0.0, 0.0, 1e-9)


def take(**more: object) -> tuple[MarkerTracks, Flags]:
    record = BendingRecord(noise=STILL, **more)  # type: ignore[arg-type]
    made = tracks(record, np.random.default_rng(0))
    return made, np.asarray(made.time < 2.0)


def test_frame_and_sections() -> None:
    made, rest = take()
    found = find_sections(made.positions, rest=rest, apart=0.004)

    assert found.count == 15
    assert np.allclose(np.diff(found.x), 0.0127, atol=1e-6)
    assert np.linalg.det(found.rotation_lab_to_specimen) == pytest.approx(1.0)
    lab_down = np.array([0.0, -1.0, 0.0])  # mid-span goes down in the frame of the cameras
    assert found.rotation_lab_to_specimen[1] @ lab_down == pytest.approx(1.0, abs=1e-4)
    assert np.nanmax(found.markers[..., 1]) > 0.9 * STROKE


def test_markers_that_are_not_seen_at_rest_are_left_out() -> None:
    made, rest = take()
    positions = made.positions.copy()
    positions[rest, 4] = np.nan

    found = find_sections(positions, rest=rest, apart=0.004)

    assert 4 not in found.columns
    assert len(found.columns) == 29


def test_too_few_markers_and_markers_that_stand_still() -> None:
    made, rest = take()
    with pytest.raises(ValueError, match="2 markers seen at rest: expected at least 3"):
        find_sections(made.positions[:, :2], rest=rest, apart=0.004)
    with pytest.raises(ValueError, match="the markers do not move: expected a specimen that is"):
        find_sections(np.repeat(made.positions[:1], 80, axis=0), rest=rest[:80], apart=0.004)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_axis_lies_a_radius_from_every_marker(sign: float) -> None:
    made, rest = take()
    found = find_sections(made.positions, rest=rest, apart=0.004)

    axis = axis_at_rest(found, radius=RADIUS, towards=(0.0, sign))

    far = np.linalg.norm(found.at_rest[:, 1:] - axis, axis=1)
    assert np.allclose(far, RADIUS, atol=1e-6)
    assert -sign * axis[1] > 0.0


def test_one_row_leaves_the_axis_where_it_is_said_to_be() -> None:
    made, rest = take(angles=(np.radians(90.0),))
    found = find_sections(made.positions, rest=rest, apart=0.004)

    axis = axis_at_rest(found, radius=RADIUS, towards=(1.0, 0.0))

    assert axis == pytest.approx([-RADIUS, 0.0], abs=1e-6)


def test_twist_of_a_section_and_none_of_one_row() -> None:
    made, rest = take(twist=0.08)
    found = find_sections(made.positions, rest=rest, apart=0.004)
    twist, lever = section_twist(found, np.zeros((len(rest), 15)), radius=RADIUS)
    assert np.nanmax(np.abs(twist[:, 7])) == pytest.approx(0.08, abs=1e-3)
    assert np.allclose(lever, RADIUS * np.sin(np.radians(35.0)) * np.sqrt(2.0), rtol=1e-3)

    made, rest = take(angles=(np.radians(90.0),))
    found = find_sections(made.positions, rest=rest, apart=0.004)
    twist, lever = section_twist(found, np.zeros((len(rest), 15)), radius=RADIUS)
    assert np.isnan(twist).all()
    assert not lever.any()
