"""Half a bundle on its roller: against the textbook and against integration by another method."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root

from labpipe.law.plays import virgin_plays
from labpipe.virtual_lab.conduit_scenarios import ThreePointTest
from labpipe.virtual_lab.specimens import ElasticModel
from labpipe.virtual_lab.three_point_path import half_bundle, solve_three_point

BAR = ElasticModel(0.1)


def shot(test: ThreePointTest, displacement: float) -> float:
    """Force of an elastic bar by shooting from mid-span: EI theta'' = - F . normal, N."""
    friction, reach = test.friction, test.reach
    assert isinstance(test.bundle, ElasticModel)
    stiffness = test.bundle.stiffness

    def ends(unknowns: np.ndarray) -> np.ndarray:
        """What lacks at the contact for a curvature at mid-span, a turn, a force and a length."""
        bent, turn, normal, length = unknowns
        along = normal * (friction * np.cos(turn) - np.sin(turn))
        across = normal * (np.cos(turn) + friction * np.sin(turn))

        def slopes(_: float, state: np.ndarray) -> list[float]:
            _, _, angle, curvature = state
            lateral = across * np.cos(angle) - along * np.sin(angle)
            return [np.cos(angle), np.sin(angle), curvature, -lateral / stiffness]

        begin = [0.0, 0.0, 0.0, bent]
        end = solve_ivp(slopes, (0.0, length), begin, rtol=1e-10, atol=1e-13).y[:, -1]
        moment = test.outer_radius * friction * normal
        return np.array(
            [
                end[0] + reach * np.sin(turn) - 0.5 * test.span,
                end[1] + reach * (1.0 - np.cos(turn)) - displacement,
                end[2] - turn,
                end[3] - moment / stiffness,
            ]
        )

    half = 0.5 * test.span
    start = [3 * displacement / half**2, 1.5 * displacement / half, 0.0, half]
    start[2] = 3.0 * stiffness * displacement / half**3
    found = root(ends, start, tol=1e-12)
    assert found.success
    _, turn, normal, _ = found.x
    return float(2.0 * normal * (np.cos(turn) + friction * np.sin(turn)))


@pytest.mark.parametrize("friction", [0.0, 0.15])
@pytest.mark.parametrize("displacement", [0.01, 0.0294])
def test_large_deflections_agree_with_shooting(friction: float, displacement: float) -> None:
    test = ThreePointTest(BAR, friction=friction, build_up=1e-5, stroke=displacement)
    force = solve_three_point(test).loading[-1].force
    assert force == pytest.approx(shot(test, displacement), rel=3e-4)


def test_small_deflections_are_those_of_the_textbook() -> None:
    """K = 48 EI / L^3, where the rollers have not yet shortened the span."""
    test = ThreePointTest(BAR, friction=0.0, stroke=1e-5)
    last = solve_three_point(test).loading[-1]
    textbook = 48.0 * 0.1 / test.span**3
    assert last.force / last.displacement == pytest.approx(textbook, rel=3e-4)
    assert last.moment[0] == pytest.approx(0.25 * last.force * test.span, rel=1e-3)


def test_error_falls_with_the_square_of_the_step() -> None:
    exact = shot(ThreePointTest(BAR, friction=0.0), 0.0294)
    errors = [
        solve_three_point(ThreePointTest(BAR, friction=0.0, n_stations=n)).loading[-1].force / exact
        - 1.0
        for n in (25, 97)
    ]
    assert abs(errors[1]) < abs(errors[0]) / 8.0


def test_friction_turns_round_within_a_short_way() -> None:
    half = half_bundle(ThreePointTest(BAR, friction=0.2, build_up=1e-3))
    assert half.friction(0.0, turns=False) == 0.0
    assert half.friction(0.02, turns=False) == pytest.approx(0.2)
    assert half.friction(0.0, turns=True) == 0.2
    assert half.friction(-0.02, turns=True) == pytest.approx(-0.2)


def test_without_force_it_lies_as_it_was_bent() -> None:
    half = half_bundle(ThreePointTest(BAR))
    rest = half.free(virgin_plays(half.law, half.test.n_stations))
    assert (rest.displacement, rest.force) == (0.0, 0.0)
    assert rest.contact == pytest.approx(0.0762, abs=1e-12)
