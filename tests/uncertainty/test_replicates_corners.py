"""Smooth records at turns that lie between two samples, and at breaks."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.uncertainty.replicates import smooth_curve

TIME = np.arange(600.0)


@pytest.mark.parametrize("late", [-0.9, -0.3, 0.0, 0.4, 0.8])
def test_no_piece_runs_past_a_turn(late: float) -> None:
    """Up to a stand, and down from it: the cuts are whole samples, the corners are not."""
    corners = np.array([0.0, 199.5 + late, 399.5 + late, 599.0])
    true = np.interp(TIME, corners, [0.0, 20.0, 20.0, 0.0])
    found = smooth_curve(TIME, true, [200, 400], 12)
    assert found.max() == pytest.approx(20.0, abs=5e-3)  # a twentieth of a step
    assert np.abs(found - true).max() < 0.03


def test_a_valley() -> None:
    true = np.abs(TIME - 300.7)
    assert smooth_curve(TIME, true, [300], 12).min() >= true.min() - 0.05


def test_a_break_stays() -> None:
    """The force is lost within four samples, the last ones; before them it rose by 0.1 a step."""
    time = TIME[:304]
    true = np.where(time < 300.0, 0.1 * time, 29.9 - 6.0 * (time - 299.0))
    found = smooth_curve(time, true, [300], 12, broken=300)
    assert found[299] == pytest.approx(29.9, abs=1e-6)
    assert smooth_curve(time, true - 2.0 * (time >= 300.0), [300], 12)[299] < 29.5


def test_a_jump_is_no_turn() -> None:
    true = np.where(TIME < 300.0, 0.1 * TIME, 1.0)
    found = smooth_curve(TIME, true, [300], 12)
    assert found[299:301] == pytest.approx([29.9, 1.0], abs=1e-6)
