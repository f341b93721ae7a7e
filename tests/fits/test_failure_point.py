"""Where the force is lost for good, by the field's rule, and the energy up to there."""

from __future__ import annotations

from typing import Final

import numpy as np
import pytest

from labpipe.fits.failure_point import (
    LossOfForce,
    final_loss,
    lost_earlier,
)
from labpipe.records.arrays import Floats
from labpipe.records.estimates import Failure

RULE: Final = LossOfForce(force_below=0.5, loss=0.1, within=0.05)
SPEED = 1e-3
D = np.linspace(0.0, 0.03, 301)
TIME = D / SPEED
F = np.where(D <= 0.02, 5000.0 * D, 3.0)


def test_the_sample_before_the_loss() -> None:
    assert final_loss(TIME, F, RULE) == 200


@pytest.mark.parametrize(("low", "is_lost"), [(45.0, True), (46.0, False)])
def test_a_loss_of_just_the_share_is_one(low: float, *, is_lost: bool) -> None:
    """A sample a second, 5 N slower each, and 10 % of 100 N on the way below half of it."""
    force = np.array([0.0, 50.0, 100.0, *np.arange(95.0, 54.0, -5.0), low, 42.0, 41.0])
    found = final_loss(np.arange(float(len(force))), force, RULE)
    assert found == 11 if is_lost else isinstance(found, Failure)


def test_missing_samples_are_left_out() -> None:
    force = F.copy()
    force[50], force[198] = np.nan, np.nan
    assert final_loss(TIME, force, RULE) == 200


def broken(rate: float, *, takes: float = 0.004, neck: float = 0.0) -> tuple[Floats, Floats]:
    """Up to 100 N in 20 s, a smooth fall to 100 N - neck in 2 s, then lost in a few ms."""
    time = np.arange(0.0, 25.0, 1.0 / rate)
    rising = np.minimum(5.0 * time, 100.0)
    necked = neck * np.clip((time - 20.0) / 2.0, 0.0, 1.0) ** 2
    left = np.clip(1.0 - (time - 22.0) / takes, 0.0, 1.0)
    return time, (rising - necked) * left + 1.0 * (1.0 - left)


@pytest.mark.parametrize("rate", [10.0, 50.0, 100.0, 1000.0, 10_000.0])
@pytest.mark.parametrize("neck", [0.0, 10.0, 40.0])
def test_a_break_is_found_at_any_rate_behind_the_necking(rate: float, neck: float) -> None:
    time, force = broken(rate, neck=neck)
    sample = final_loss(time, force, RULE)
    assert isinstance(sample, int)
    assert 22.0 - 0.1 <= time[sample] <= 22.0 + 0.004
    assert force[sample] == pytest.approx(100.0 - neck, rel=0.05)


def test_a_slow_fall_is_no_break() -> None:
    time = np.arange(0.0, 40.0, 0.01)
    relaxed = np.where(time < 10.0, 10.0 * time, 100.0 * np.exp(-(time - 10.0) / 10.0))
    found = final_loss(time, relaxed, RULE)
    assert isinstance(found, Failure)
    assert found.code == "no_break"
    assert "slowly" in found.message


def test_a_yarn_that_breaks_fibre_by_fibre_has_no_single_break() -> None:
    steps = 100.0 - 5.0 * np.floor(np.arange(200) / 10.0)
    found = final_loss(0.1 * np.arange(200.0), np.maximum(steps, 0.0), RULE)
    assert isinstance(found, Failure)
    assert found.code == "no_break"


def test_rows_without_time_lose_their_force_in_one_step() -> None:
    rows = np.arange(301.0)
    assert final_loss(rows, F, RULE) == 200


def test_says_why_not() -> None:
    held = final_loss(TIME[:200], F[:200], RULE)
    assert held == Failure(
        "no_break", "the force ends at 99.5 N, 100% of its peak 99.5 N; below 50% counts as lost"
    )


def test_a_force_that_goes_down_as_the_frame_goes_back_is_not_lost() -> None:
    force = np.concatenate([F[:200], F[:200][::-1]])
    time = 0.1 * np.arange(400.0)
    found = final_loss(time, force, RULE, np.arange(400) >= 200)
    assert found == Failure("no_break", "the force goes down while the displacement goes back")


@pytest.mark.parametrize(("force", "most"), [(-F, "0"), (-1.0 - F, "-1"), (0.0 * F, "0")])
def test_no_tension(force: Floats, most: str) -> None:
    assert final_loss(TIME, force, RULE) == Failure(
        "no_tension", f"the force is nowhere above zero, at most {most} N"
    )


@pytest.mark.parametrize(
    ("lost", "comes_back_to", "share"), [(30.0, 65.0, 0.0), (30.0, 40.0, 1 / 3), (5.0, 50.0, 0.0)]
)
def test_what_was_lost_before(lost: float, comes_back_to: float, share: float) -> None:
    """60 N are carried, then some are lost at once; only what never comes back counts."""
    parts = [np.linspace(0.0, 60.0, 121), np.linspace(60.0 - lost, comes_back_to, 80)]
    force = np.concatenate(parts).astype(np.float64)
    found = lost_earlier(0.1 * np.arange(float(len(force))), force, RULE)
    assert found == pytest.approx(share)
    force[::9] = np.nan
    assert lost_earlier(0.1 * np.arange(float(len(force))), force, RULE) == pytest.approx(
        share, abs=0.01
    )
