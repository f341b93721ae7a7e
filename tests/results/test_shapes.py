"""Numbers that are read from the shape of a specimen; the bending law is in `moment_curvature`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.curve import PointFlag, Shape
from labpipe.records.estimates import Estimate, Failure
from labpipe.records.signals import Signals
from labpipe.results.evidence import Evidence
from labpipe.results.kinds import Found
from labpipe.results.shapes import TipTravel

FRAMES = 100


def shape(positions: np.ndarray) -> Shape:
    """Clamped end and tip alone."""
    count = len(positions)
    return Shape(
        time=np.arange(count) / 50.0,
        positions=positions,
        names=("grip", "pull"),
        flags=np.full((count, 2), PointFlag.CONSTRUCTED, dtype=np.uint8),
        arc_length=np.array([0.0, 0.085]),
        coefficients=np.zeros((count, 3, 0)),
        length=0.085,
        rotation_lab_to_specimen=np.eye(3),
    )


def swung() -> Shape:
    """Straight down by 30 mm and half of the way back, with 10 um of noise."""
    positions = np.zeros((FRAMES, 2, 3))
    positions[:, 1, 1] = np.interp(np.arange(FRAMES), [0, 10, 60, 99], [0.0, 0.0, 0.03, 0.015])
    return shape(positions + np.random.default_rng(4).normal(0.0, 1e-5, positions.shape))


def travel(seen: Shape | None) -> Found:
    (number,) = TipTravel().compute(Evidence(Signals(), shape=seen)).numbers
    return number.outcome


def test_travel_of_the_tip() -> None:
    seen = swung()
    found = travel(seen)
    assert isinstance(found, Estimate)
    tip = seen.positions[:, -1]
    away = np.linalg.norm(tip - np.nanmean(tip[:5], axis=0), axis=1)
    assert found.value == pytest.approx(np.nanmax(away), abs=1e-12)
    assert found.value == pytest.approx(0.03, abs=5e-5)
    assert 1e-6 < found.error < 5e-5


def test_a_tip_that_was_hardly_seen() -> None:
    seen = swung()
    few = np.full_like(seen.positions, np.nan)
    few[:4] = seen.positions[:4]
    found = travel(replace(seen, positions=few))
    assert found == Failure("too_few_samples", "the tip is seen in 4 frames")


def test_travel_without_a_shape() -> None:
    assert travel(None) == Failure("no_shape", "the protocol fits no shape")
