"""Peaks where the frame stops or turns at full speed."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.pipeline.sharp_turns import find_sharp_end
from labpipe.records.arrays import Floats
from tests.builders.pulls import pulled

STEP = 2e-5
PEAKS = ["peak-force", "peak-displacement"]


def ramp(*, top: float, stands: int, comes_back: bool, seed: int = 0) -> tuple[Floats, Floats]:
    """Displacement and force (5 N/mm) of a stroke to a top between two samples."""
    up = np.arange(0.0, top, STEP)
    down = np.arange(2.0 * top - up[-1] - STEP, 0.0, -STEP) if comes_back else np.zeros(0)
    travel = np.concatenate([up, np.full(stands, top), down])
    random = np.random.default_rng(seed)
    noisy = travel + random.normal(0.0, 5e-7, len(travel))
    return noisy, 5e3 * travel + random.normal(0.0, 0.02, len(travel))


@pytest.mark.parametrize("downwards", [False, True])
@pytest.mark.parametrize(
    ("stands", "comes_back"), [(0, True), (3, True), (12, True), (12, False), (400, False)]
)
@pytest.mark.parametrize("top", [0.0100037, 0.0100137])
def test_tops(top: float, stands: int, comes_back: bool, downwards: bool) -> None:
    travel, force = ramp(top=top, stands=stands, comes_back=comes_back)
    sense = -1.0 if downwards else 1.0
    _, results = pulled(sense * travel, sense * force, results=PEAKS)
    place, peak = results["peak_displacement.1"], results["peak_force.1"]
    assert place.value == pytest.approx(sense * top, abs=3e-6)
    assert peak.value == pytest.approx(sense * 5e3 * top, abs=0.12)
    assert place.interval is not None
    assert peak.interval is not None
    assert place.interval.lower < sense * top < place.interval.upper or stands == 3
    assert peak.interval.lower - 0.05 < sense * 5e3 * top < peak.interval.upper + 0.05


def test_a_record_that_ends_at_the_top() -> None:
    """No sample behind the top: the frame went on by up to half a step."""
    travel, _ = ramp(top=0.01001, stands=0, comes_back=False)
    end = find_sharp_end(travel, length=len(travel))
    assert end is not None
    assert end.sample == len(travel) - 1
    assert end.step == pytest.approx(0.5 * STEP, rel=0.05)
    assert end.top.value == pytest.approx(travel[-1] + 0.25 * STEP, abs=1e-7)
    assert end.top.error > 0.25 * STEP / np.sqrt(3.0)


def test_a_curve_that_was_cut_off_went_on() -> None:
    travel, _ = ramp(top=0.02, stands=0, comes_back=False)
    end = find_sharp_end(travel, length=500)
    assert end is not None
    assert end.top.value == pytest.approx(499 * STEP, abs=2e-6)
    assert end.step == 0.0


def test_a_smooth_turn_is_left_to_the_parabola() -> None:
    time = np.linspace(0.0, np.pi, 800)
    travel = 0.01 * np.sin(time)
    assert find_sharp_end(travel, length=400) is None
    _, results = pulled(travel, 5e3 * travel, results=PEAKS)
    assert results["peak_displacement.1"].value == pytest.approx(0.01, rel=1e-3)
    assert results["peak_force.1"].value == pytest.approx(50.0, rel=1e-3)


def test_noise_of_more_than_a_step_is_left_to_the_parabola() -> None:
    travel, _ = ramp(top=0.01, stands=0, comes_back=False)
    noisy = travel + np.random.default_rng(0).normal(0.0, STEP, len(travel))
    assert find_sharp_end(noisy, length=len(travel)) is None


def test_gaps_and_short_branches() -> None:
    travel, _ = ramp(top=0.01, stands=12, comes_back=False)
    assert find_sharp_end(travel, length=20) is None
    travel[100] = np.nan
    assert find_sharp_end(travel, length=len(travel)) is None
