"""Numbers that are read from the shape of a specimen; the bending law is in `moment_curvature`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Direction, PointFlag, Shape
from labpipe.records.estimates import Estimate, Failure
from labpipe.records.signals import Signals
from labpipe.results.evidence import Evidence
from labpipe.results.kinds import Found
from labpipe.results.shapes import TipTravel, _at_turn, _Frames

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


def wandering(seed: int) -> Floats:
    """Noise of 1 whose power falls as 1 over the frequency, 1800 frames."""
    waves = np.fft.rfft(np.random.default_rng(seed).normal(size=7200))
    waves[1:] /= np.sqrt(np.arange(1.0, len(waves)))
    waves[0] = 0.0
    found = np.fft.irfft(waves, 7200)[:1800]
    return np.asarray(found / found.std(), dtype=np.float64)


@pytest.mark.slow
def test_noise_at_the_turn_is_judged_by_all_that_is_seen_alike() -> None:
    """The standard error of six that wander is never below the scatter of 60 values by a tenth.

    It is up to 1.7 times as large: pieces make the noise look steeper than it is. Those that are
    seen alike may have noise of another size. Alone, some have half of their scatter.
    """
    time: Floats = np.arange(1800.0) / 25.0
    way = np.interp(time, [0.0, 4.0, 36.0, 68.0, 72.0], [0.0, 0.0, 10.0, 0.0, 0.0])
    loading = Branch(100, 900, 1, Direction.LOADING, 4.0, 36.0)
    frames = _Frames(time, time < 4.0, loading, (100, 900, 1700), b"seed")
    off, errors, together = list[float](), list[float](), list[float]()
    for seed in range(0, 60, 6):
        rows = [way + wandering(each) for each in range(seed, seed + 6)]
        others = [5.0 * row for row in rows[1:]]
        found = _at_turn(rows[0], frames, "twist", others)
        assert isinstance(found, Estimate)
        together.append(found.error)
    for seed in range(60):
        alone = _at_turn(way + wandering(seed), frames, "twist")
        assert isinstance(alone, Estimate)
        off.append(alone.value - 10.0)
        errors.append(alone.error)
    assert 0.9 * np.std(off) < min(together)
    assert max(together) < 1.7 * np.std(off)
    assert min(errors) < 0.5 * np.std(off)
