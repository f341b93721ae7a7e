from __future__ import annotations

import numpy as np
import pytest

from labpipe.bending.fitted_law import LawShapes, Line, Loaded, law_knots
from labpipe.records.arrays import Floats

LENGTH = 0.1
PLACES: Floats = np.array([0.02, 0.05, 0.1])


def loaded(moment: float, *, height: float = 0.0) -> Loaded:
    line = Line.through(PLACES, LENGTH)
    points = len(line.arc_length)
    return Loaded(
        line=line,
        moment=np.full((1, points), moment),
        moment_at_rest=np.zeros(points),
        angle_at_rest=np.zeros(points),
        markers=np.full((1, 3, 2), np.nan),
        markers_at_rest=np.zeros((3, 2)),
        rest_weight=1.0,
        centre_offset=height,
    )


def test_points_fall_on_markers_and_tip() -> None:
    line = Line.through(PLACES, LENGTH)
    assert line.arc_length[line.markers] == pytest.approx(PLACES)
    assert (line.arc_length[0], line.arc_length[-1]) == (0.0, LENGTH)
    assert np.diff(line.arc_length).max() <= 0.0015 + 1e-12


@pytest.mark.parametrize("height", [0.0, 0.0008])
def test_a_constant_moment_bends_into_a_circle(height: float) -> None:
    compliance, moment = 200.0, 0.05
    basis = law_knots(0.06, 5)
    shapes = LawShapes.of(loaded(moment, height=height), basis)
    moved = shapes.movement(np.full(5, compliance))
    curvature = compliance * moment
    turn, radius = curvature * PLACES, 1.0 / curvature - height
    x = radius * np.sin(turn) - PLACES
    y = 1.0 / curvature - radius * np.cos(turn) - height
    assert moved[0] == pytest.approx(np.concatenate([x, y]), abs=2e-6)


def test_derivatives_are_those_of_the_movement() -> None:
    basis, compliance = law_knots(0.06, 5), np.array([180.0, 200.0, 240.0, 300.0, 280.0])
    shapes = LawShapes.of(loaded(0.05, height=0.0008), basis)
    moved, slopes = shapes.predict(compliance)
    assert moved.tolist() == shapes.movement(compliance).tolist()
    for knot in range(5):
        step = np.zeros(5)
        step[knot] = 1e-3
        more, less = (shapes.movement(compliance + sign * step) for sign in (1.0, -1.0))
        assert slopes[..., knot] == pytest.approx((more - less) / 2e-3, abs=1e-9)
