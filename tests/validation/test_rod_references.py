"""The references that rods are judged by, against numbers that others printed."""

from __future__ import annotations

import numpy as np
import pytest

from tests.judges.rod_references import (
    Kirchhoff,
    bend_of_45_degrees,
    buckled_column,
    critical_moment_of_joints,
    critical_torque,
    heavy_cantilever,
    shaft_frequencies,
)


def test_a_light_cantilever_sags_by_an_eighth() -> None:
    """w L^4 / (8 EI), its slope w L^3 / (6 EI)."""
    drop, shortening, angle = heavy_cantilever(0.01)
    assert (drop, angle) == pytest.approx((0.01 / 8.0, 0.01 / 6.0), rel=1e-4)
    assert shortening == pytest.approx(0.01**2 / 112.0, rel=1e-3)  # half the mean of slope^2


def test_a_very_heavy_cantilever_hangs_down() -> None:
    """Below the clamp it bends as if its weight hung far away: lambda (2 - sqrt(2)) is missing."""
    drop, _, angle = heavy_cantilever(50.0)
    assert angle == pytest.approx(np.pi / 2.0, abs=0.05)
    assert 1.0 - drop == pytest.approx((2.0 - 2.0**0.5) / 50.0**0.5, rel=0.15)


@pytest.mark.parametrize(
    ("degrees", "load", "height", "offset"),
    [
        (20, 1.015, 0.970, 0.220),
        (40, 1.063, 0.881, 0.422),
        (60, 1.152, 0.741, 0.593),
        (80, 1.293, 0.560, 0.719),
        (100, 1.518, 0.349, 0.792),
        (120, 1.884, 0.123, 0.803),
        (140, 2.541, -0.107, 0.750),
        (160, 4.029, -0.340, 0.625),
        (176, 9.116, -0.577, 0.421),
    ],
)
def test_columns_of_timoshenko_and_gere(
    degrees: float, load: float, height: float, offset: float
) -> None:
    """Theory of elastic stability, 2nd edition, table 2-4."""
    assert buckled_column(np.radians(degrees)) == pytest.approx((load, height, offset), abs=2e-3)


def test_torque_that_buckles_a_clamped_rod() -> None:
    """Greenhill (1883): 8.9868 without tension; pulled hard, M^2 = 4 B T."""
    assert critical_torque() == pytest.approx(8.98682, abs=1e-5)
    assert critical_torque(1e4) == pytest.approx(2.0 * 100.0, rel=2e-3)


def test_moment_that_buckles_a_rod_on_universal_joints() -> None:
    """Greenhill (1883); with tension, M^2 = (2 pi)^2 + 4 T."""
    assert critical_moment_of_joints() == pytest.approx(2.0 * np.pi, abs=1e-9)
    assert critical_moment_of_joints(20.0) == pytest.approx(np.sqrt(4.0 * np.pi**2 + 80.0))


def test_a_shaft_on_universal_joints_diverges_and_does_not_flutter() -> None:
    """Its frequencies stay real, though nothing says they must, and the first comes to zero."""
    assert shaft_frequencies(0.0)[0].real == pytest.approx(np.pi**4)
    for moment in np.linspace(0.0, 2.0 * np.pi - 1e-3, 8):
        lowest = shaft_frequencies(float(moment))[:4]
        assert np.min(lowest.real) > 0.0
        assert np.max(np.abs(lowest.imag)) < 1e-4
    assert abs(shaft_frequencies(2.0 * np.pi)[0]) < 1e-3
    assert shaft_frequencies(6.4)[0].real < -4.0


def test_a_shaft_with_a_free_end_flutters_under_any_moment() -> None:
    """Nicolai's paradox (1928): no moment of constant direction is too small, without damping."""
    assert shaft_frequencies(0.0, is_free=True)[0] == pytest.approx(1.8751041**4)
    assert abs(shaft_frequencies(0.1, is_free=True)[0].imag) > 0.3


@pytest.mark.parametrize(
    ("load", "tip"), [(300.0, (58.84, 22.33, 40.08)), (600.0, (47.23, 15.79, 53.37))]
)
def test_bend_of_45_degrees(load: float, tip: tuple[float, float, float]) -> None:
    """Simo and Vu-Quoc (1986), with shear and stretch; codes differ by 0.5 %."""
    assert bend_of_45_degrees(load) == pytest.approx(tip, rel=0.008)


def test_a_rod_in_a_plane_is_the_elastica() -> None:
    """PHYSICS 5: alpha = 2."""
    places, _, moments = Kirchhoff((1.0, 1.0, 0.3), 1.0).under(np.array([2.0, 0.0, 0.0]))
    assert places[-1] == pytest.approx((0.493457, 0.0, 1.0 - 0.160642), abs=1e-6)
    assert moments[0] == pytest.approx((0.0, 2.0 * (1.0 - 0.160642), 0.0), abs=1e-5)


def test_a_rod_held_where_it_is_keeps_its_force() -> None:
    """With the far end clamped in the place and frame it has, its clamp carries the load."""
    rod = Kirchhoff((1.0, 1.0, 0.7), 1.0, natural=(0.3, 0.2, 0.5))
    force, weight = np.array([1.0, 0.5, 0.1]), np.array([0.0, 0.0, -1.0])
    free = rod.under(force, weight)
    held = rod.to(free[0][-1], free[1][-1], weight, start=free)
    assert held[3] == pytest.approx(force, abs=1e-5)
    assert held[0] == pytest.approx(free[0], abs=1e-7)
