"""Stiffness and free curvature from how a line hangs: found again from shapes of an elastica."""

from __future__ import annotations

import numpy as np
import pytest

from tests.builders.real_wires import hang_of
from tests.judges.hung_wires import GRAVITY, HungElastica
from tests.judges.rod_fits import Estimate, Hang, fit_hang

MASS = 0.02
STIFFNESS = 3e-4


def seen(natural: tuple[float, ...] = (), noise: float = 0.0, seed: int = 0) -> Hang:
    """Thirty points of an elastica, synthetic."""
    loop = HungElastica(1.5, MASS * GRAVITY, STIFFNESS, (-0.12, 0.01), natural, pieces=600)
    points = loop.at(np.linspace(0, 1, 30))
    return hang_of(points + noise * np.random.default_rng(seed).normal(size=points.shape), MASS)


def test_stiffness_and_free_curvature_are_found_again() -> None:
    found = fit_hang(seen((4.0,)), blocks=0)
    assert found.stiffness == pytest.approx(STIFFNESS, rel=2e-3)
    assert found.natural == pytest.approx((4.0,), abs=0.02)
    assert found.distances.max() < 2e-4
    assert found.blocks == ()


def test_interval_by_effective_degrees_of_freedom() -> None:
    """GUM G.4.1: two equal parts of 4 degrees each are one of 8; t is 2.306."""
    found = Estimate(10.0, (("one", 0.3, 4.0), ("other", 0.3, 4.0), ("none", 0.0, np.inf)))
    assert found.half_width == pytest.approx(2.306 * 0.3 * np.sqrt(2), rel=1e-3)
    known = Estimate(10.0, (("known", 0.5, np.inf),))
    assert known.interval.upper == pytest.approx(10.98, abs=1e-3)
