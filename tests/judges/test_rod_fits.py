"""Stiffness and free curvature from how a line hangs: found again from shapes of an elastica."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from tests.builders.real_wires import hang_of
from tests.judges.hung_wires import GRAVITY, HungElastica
from tests.judges.rod_fits import Estimate, Hang, HangFit, fit_hang, hung, mean_stiffness

MASS = 0.02
STIFFNESS = 3e-4


def seen(natural: tuple[float, ...] = (), noise: float = 0.0, seed: int = 0) -> Hang:
    """Thirty points of an elastica, synthetic."""
    loop = HungElastica(1.5, MASS * GRAVITY, STIFFNESS, (-0.12, 0.01), natural, pieces=600)
    points = loop.at(np.linspace(0, 1, 30))
    return hang_of(points + noise * np.random.default_rng(seed).normal(size=points.shape), MASS)


def changed(**values: Any) -> Hang:
    hang = seen()
    names = ("points", "shares", "directions", "length", "mass_per_length")
    return Hang(**{name: values.get(name, getattr(hang, name)) for name in names})


def test_a_line_hangs_as_the_elastica() -> None:
    for natural in ((), (4.0,), (3.0, -6.0)):
        hang = seen(natural)
        assert hung(hang, STIFFNESS, natural) == pytest.approx(hang.points, abs=2e-4)


def test_stiffness_and_free_curvature_are_found_again() -> None:
    found = fit_hang(seen((4.0,)), blocks=0)
    assert found.stiffness == pytest.approx(STIFFNESS, rel=2e-3)
    assert found.natural == pytest.approx((4.0,), abs=0.02)
    assert found.distances.max() < 2e-4
    assert found.blocks == ()


def test_turned_the_other_way_round_it_is_the_same_line() -> None:
    """From the other clamp: the free curvature falls where it rose; and in another plane."""
    hang = seen((4.0,))
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    there = hang.points[::-1] @ turn.T
    back = changed(points=there, directions=-hang.directions[::-1] @ turn.T)
    found = fit_hang(back, blocks=0)
    assert found.stiffness == pytest.approx(STIFFNESS, rel=2e-3)
    assert found.natural == pytest.approx((-4.0,), abs=0.02)


@pytest.mark.slow
def test_the_mean_of_noisy_hangs_holds_the_truth() -> None:
    fits = [fit_hang(seen((4.0,), 3e-3, seed)) for seed in range(3)]
    found = mean_stiffness(fits)
    assert found.interval.lower < STIFFNESS < found.interval.upper
    assert found.half_width < 0.3 * STIFFNESS
    assert [name for name, _, _ in found.parts] == ["scatter", "model", "scale", "mass"]
    wider = mean_stiffness(fits, length_error=0.1)
    assert wider.parts[2][1] == pytest.approx(0.3 * wider.value)
    assert wider.half_width > 0.5 * wider.value


def test_interval_by_effective_degrees_of_freedom() -> None:
    """GUM G.4.1: two equal parts of 4 degrees each are one of 8; t is 2.306."""
    found = Estimate(10.0, (("one", 0.3, 4.0), ("other", 0.3, 4.0), ("none", 0.0, np.inf)))
    assert found.half_width == pytest.approx(2.306 * 0.3 * np.sqrt(2), rel=1e-3)
    known = Estimate(10.0, (("known", 0.5, np.inf),))
    assert known.interval.upper == pytest.approx(10.98, abs=1e-3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"length": 0.1}, "length=0.1: allowed is more than the clamps are apart"),
        ({"length": np.nan}, "length=nan: allowed are finite numbers > 0"),
        ({"mass_per_length": 0.0}, "mass_per_length=0.0: allowed are finite numbers > 0"),
        ({"points": np.full((30, 3), np.nan)}, "points: allowed are finite numbers"),
        ({"points": np.linspace(0, 1, 90).reshape(30, 3) / 9}, "points that are not on one line"),
        ({"shares": np.linspace(0, 0.9, 30)}, "allowed are increasing numbers from 0 to 1"),
    ],
)
def test_hangs_that_are_none(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        changed(**values)


def test_one_hang_has_no_scatter() -> None:
    nothing = np.zeros((2, 3))
    fit = HangFit(1.0, (), nothing, nothing, (1.0, 1.0))
    with pytest.raises(ValueError, match=r"1 hangs, blocks \[2\]: allowed are two or more of both"):
        mean_stiffness([fit])
    bare = HangFit(1.0, (), nothing, nothing, ())
    with pytest.raises(ValueError, match=r"2 hangs, blocks \[0\]"):
        mean_stiffness([bare, bare])


@pytest.mark.slow
def test_a_line_with_two_shapes_is_not_fitted() -> None:
    """The search saw one shape, and in the end there is another one."""
    hang = seen()
    calls = 0

    def moody(hang: Hang, stiffness: float, natural: tuple[float, ...]) -> Floats:
        nonlocal calls
        calls += 1
        return hung(hang, stiffness, natural) + (0.1 if calls > last else 0.0)

    last = 10**6
    fit_hang(hang, blocks=0, hanging=moody)
    calls, last = 0, calls - 1
    with pytest.raises(ArithmeticError, match="more than one shape between these clamps"):
        fit_hang(hang, blocks=0, hanging=moody)
