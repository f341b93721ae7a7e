"""Synthetic cycles of a bundle in memory: a kink, a plateau, harder afterwards."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.result import Result, Status

NOISE = 0.01
"""N"""
PEAK = 0.05
RESIDUAL = 0.012
SPEED = 1e-3
FIRST, SECOND, FLAT = 800.0, 300.0, 10.0
"""N/m of the first loading: up to the kink, beyond it, and on the plateau."""
KINK, ONSET = 0.002, 0.035
LATER = 460.0
"""N/m with which later cycles begin at the residual displacement."""


def first_loading(displacement: Floats, *, has_plateau: bool = True) -> Floats:
    """Force (N) of the first loading; the slope falls to that of the plateau over 2 mm."""
    force: Floats = np.minimum(displacement, KINK) * FIRST
    force = force + SECOND * np.maximum(displacement - KINK, 0.0)
    if not has_plateau:
        return force
    into = np.clip(displacement - ONSET + 0.001, 0.0, 0.002)
    beyond = np.maximum(displacement - ONSET - 0.001, 0.0)
    return force - (SECOND - FLAT) * (0.5 * into**2 / 0.002 + beyond)


def cycles(
    number: int = 3, *, noise: float = 0.0, has_plateau: bool = True
) -> tuple[Floats, Floats, Floats]:
    """Time (s), displacement (m) and force (N), 50 samples per second, with rests at both ends.

    Unloading is straight down to zero force at the residual displacement, where the string gets
    slack; later loadings are straight up to the peak with a bend on half of the way.
    """
    time: Floats = np.arange(0.0, 6.0 + 2.0 * number * PEAK / SPEED, 0.02)
    driven = SPEED * (time - 3.0)
    turn = np.floor(driven / PEAK)
    phase = driven - PEAK * turn
    up = np.where(turn % 2 == 0, phase, PEAK - phase)
    moving = (driven > 0.0) & (turn < 2 * number)
    path = np.where(moving, up, 0.0)
    seen = np.where(moving & (turn > 0), np.maximum(path, RESIDUAL), path)
    seen = np.where(~moving & (driven > 0.0), RESIDUAL, seen)
    top = float(first_loading(np.array([PEAK]), has_plateau=has_plateau)[0])
    middle = 0.5 * (RESIDUAL + PEAK)
    knots = [RESIDUAL, middle, PEAK]
    later = np.interp(seen, knots, [0.0, LATER * (middle - RESIDUAL), top])
    down = np.interp(seen, [RESIDUAL, PEAK], [0.0, top])
    force = np.where(turn % 2 == 0, later, down)
    force = np.where(turn <= 0, first_loading(seen, has_plateau=has_plateau), force)
    force = np.where(moving, force, 0.0)
    random = np.random.default_rng(0)
    return (
        time,
        seen + random.normal(0.0, 1e-3 * noise, len(time)),
        force + random.normal(0.0, noise, len(time)),
    )


def width(result: Result) -> float:
    """How wide an interval is."""
    assert result.interval is not None
    return result.interval.upper - result.interval.lower


def holds(result: Result, true: float, unit: str) -> None:
    assert result.status is Status.OK
    assert result.unit == unit
    assert result.value is not None
    assert result.value == pytest.approx(true, abs=width(result))
    assert result.method
