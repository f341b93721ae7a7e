"""The second simulator against closed forms and tables: it is judged before it judges."""

from __future__ import annotations

import zlib

import numpy as np
import pytest

from tests.judges.foreign import definitions
from tests.judges.foreign.bends import Bending, Wire, knives, loops
from tests.judges.foreign.noise import KINDS, MAKERS, drifted, wander
from tests.judges.foreign.pulls import Loop
from tests.judges.foreign.rig import Chance


@pytest.mark.parametrize(("load", "deflection"), [(1.0, 0.301721), (2.0, 0.493457)])
def test_elastica_of_a_cantilever(load: float, deflection: float) -> None:
    row, _ = Bending(Wire(1.0, 1.0, (), string=1e6, hung=0.0)).bent_by(load)
    assert row[2] == pytest.approx(deflection, abs=2e-6)


def test_small_loops_of_a_wire_are_those_of_its_law() -> None:
    wire = Wire(0.1, 0.01, ((2e-3, 0.5),), string=1e6, hung=0.01)
    first = loops(wire, 1e-3, 1)[0]
    stiff = 3.0 * (0.01 + 2e-3 / 0.5) / 0.1**3
    assert first.force[3] / first.deflection[3] == pytest.approx(stiff, rel=0.01)


def test_rod_on_knife_edges() -> None:
    rod = knives()
    assert rod.load[50] / rod.deflection[50] == pytest.approx(48.0, rel=1e-4)
    x, y, angle = rod.axis(np.array([0.015]), 0.15, np.array([0.0, 0.05]))
    assert y[0, 0] == pytest.approx(-0.015, abs=1e-8)
    assert x[0, 0] == pytest.approx(0.0, abs=1e-8)
    assert 0.0 < angle[0, 1] < np.interp(0.1, rod.deflection, rod.slope)


def test_loop_doubles_on_reversal() -> None:
    up, down = Loop(0.0, ((1.0, 1e-3),)).strokes((0.02, 0.0))
    d = np.array([1e-3, 2e-3])
    assert up(np.array([0.02])) - down(0.02 - d) == pytest.approx(2.0 * up(d), rel=1e-6)


@pytest.mark.parametrize("kind", [k for k in KINDS if k not in {"steps", "drift"}])
def test_noise_has_its_size(kind: str) -> None:
    made = [MAKERS[kind](4000, 0.01, np.random.default_rng(seed)) for seed in range(40)]
    assert np.sqrt(np.mean(np.square(made))) == pytest.approx(1.0, abs=0.08)


def test_noise_that_remembers() -> None:
    made = MAKERS["memory"](400_000, 0.01, np.random.default_rng(1))
    assert np.mean(made[30:] * made[:-30]) == pytest.approx(np.exp(-1.0), abs=0.03)


def test_two_segments_that_meet() -> None:
    d = np.linspace(0.0, 0.02, 2001)
    f = 3.0 * d - 2.0 * np.clip(d - 0.0123, 0.0, None)
    found = definitions.two_segments(d, f, 0.002, 0.02)
    assert found == pytest.approx((3.0, 1.0, 0.0123, 0.0369), rel=1e-4)


def test_a_zero_that_drifts_ends_as_far_off_as_its_test_sheet_says() -> None:
    """Less the white noise of half the size that is there, too; a tenth of 500 records."""
    made = [MAKERS["drift"](300, 0.01, np.random.default_rng(seed)) for seed in range(500)]
    moved = [each[-30:].mean() - each[:30].mean() for each in made]
    assert np.sqrt(np.mean(np.square(moved))) == pytest.approx(drifted(), rel=0.15)
    assert 0.15 * drifted() == pytest.approx(0.242, abs=5e-4)
    chance = Chance("tensile", 0, "drift")
    assert chance.drifts == pytest.approx(np.hypot(0.0012, 0.0015 * drifted()), rel=1e-9)


@pytest.mark.parametrize(("lasts", "half"), [(6.0, 0.25), (6000.0, 0.5)])
def test_a_zero_is_as_far_off_at_its_end_as_is_stated(lasts: float, half: float) -> None:
    """From zero on; a line in a short record, a walk in a long one, each half way."""
    dt = lasts / 100.0
    made = np.array([wander(101, dt, np.random.default_rng(seed)) for seed in range(2000)])
    assert np.all(made[:, 0] == 0.0)
    assert made[:, [50, 100]].var(axis=0) == pytest.approx([half, 1.0], rel=0.08)


def test_the_wander_of_a_zero_moves_no_other_number() -> None:
    """It has chance of its own, and none where all is exact."""
    force, still = np.linspace(0.0, 50.0, 1000), np.zeros(1000)
    chance, exact = Chance("tensile", 3), Chance("tensile", 3, exact=True)
    moved = chance.noisy(force, 0.01) - force
    white = 0.0015 * 50.0 * np.random.default_rng([3, zlib.crc32(b"tensile")]).standard_normal(1000)
    far = 0.0012 * 50.0
    assert moved - white == pytest.approx(far * wander(1000, 0.01, chance.own("zero")), abs=1e-12)
    assert np.ptp(moved - white) > 0.0
    assert np.array_equal(exact.noisy(still, 0.01), still)
