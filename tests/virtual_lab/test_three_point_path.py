"""Bundles on two supports: energy, shooting by another method, truth, what instruments see."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root

from labpipe.virtual_lab import observe
from labpipe.virtual_lab.specimens import CONDUIT_TYPES
from labpipe.virtual_lab.three_point import (
    ThreePointPath,
    ThreePointTest,
    build_conduit_scenario,
    solve_three_point,
)
from tests.builders.three_point import ElasticModel

BUNDLE = CONDUIT_TYPES["CWB-1"]
BAR = ElasticModel(0.1)


def outer_work(path: ThreePointPath) -> float:
    halves = [*path.loading_shapes, *path.unloading_shapes[1:]]
    forces = [half.force for half in halves]
    return float(np.trapezoid(forces, [half.displacement for half in halves]))


def test_work_is_stored_or_dissipated_in_bending() -> None:
    """Twice the integral over half the bundle of M d(curvature)."""
    path = solve_three_point(ThreePointTest(BUNDLE, friction=0.0))
    weights = np.full(len(path.arc_length), path.arc_length[1])
    weights[[0, -1]] *= 0.5
    inner = 2.0 * sum(
        float(weights @ (0.5 * (a.moment + b.moment) * (b.curvature - a.curvature)))
        for a, b in pairwise([*path.loading_shapes, *path.unloading_shapes[1:]])
    )
    assert outer_work(path) == pytest.approx(inner, rel=1e-3)
    assert outer_work(path) > 0.05


def test_an_elastic_bar_gives_everything_back() -> None:
    path = solve_three_point(ThreePointTest(BAR, friction=0.0))
    forces = path.compute_force(np.linspace(0.0, 0.0588, 99))
    assert path.residual_displacement == pytest.approx(0.0, abs=1e-9)
    assert forces == pytest.approx(forces[::-1], abs=1e-4)
    with pytest.raises(ValueError, match=r"displacement=.*: no equilibrium beyond 0\.0"):
        solve_three_point(ThreePointTest(BAR, stroke=0.3))


def test_the_roller_leaves_a_bent_bundle() -> None:
    path = solve_three_point(ThreePointTest(BUNDLE, friction=0.2))
    assert 5e-3 < path.residual_displacement < 0.015
    progress = np.linspace(0.0588 - 0.9 * path.residual_displacement, 0.0588, 20)
    assert path.compute_force(progress) == pytest.approx(0.0, abs=1e-12)
    displacement, moment, _ = path.compute_mid_span(progress)
    assert displacement == pytest.approx(path.residual_displacement, abs=1e-12)
    assert moment == pytest.approx(0.0, abs=1e-12)
    assert path.compute_displacement(progress)[-1] == 0.0


def shoot(test: ThreePointTest, displacement: float) -> float:
    """Force of an elastic bar by shooting from mid-span: EI theta'' = - F . normal, N."""
    friction, reach = test.friction, test.roller_radius + test.outer_radius
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
    solution = root(ends, start, tol=1e-12)
    assert solution.success
    _, turn, normal, _ = solution.x
    return float(2.0 * normal * (np.cos(turn) + friction * np.sin(turn)))


@pytest.mark.parametrize(
    ("friction", "displacement"), [(0.0, 0.0294), (0.15, 0.01), (0.15, 0.0294)]
)
def test_large_deflections_agree_with_shooting(friction: float, displacement: float) -> None:
    test = ThreePointTest(BAR, friction=friction, build_up=1e-5, stroke=displacement)
    force = solve_three_point(test).loading_shapes[-1].force
    assert force == pytest.approx(shoot(test, displacement), rel=3e-4)


def test_truth_and_volts_of_a_bundle() -> None:
    default = build_conduit_scenario("CWB-1")
    cell = replace(default.load_cell, noise=0.0, gain_error=0.0)
    markers = replace(default.markers, noise=0.0, twist=0.1)
    scenario = replace(default, load_cell=cell, markers=markers, factor=1.1)
    path, plan = solve_three_point(scenario.test), scenario.plan_schedule()
    test = observe(scenario, 1)
    truth, record = test.truth, test.records["force"]
    assert truth["peak_force"] == pytest.approx(1.1 * path.loading_shapes[-1].force, rel=1e-3)
    assert truth["residual_displacement"] == path.residual_displacement
    assert truth["energy"] == pytest.approx(1.1 * outer_work(path), rel=2e-3)
    force = -0.21082 * record.signals["Model Root/Load Cell"] + 0.002846
    times = record.clock_times / (1.0 + 20e-6) + 6e-3
    expected = 1.1 * path.compute_force(plan.compute_progress(times))
    assert force == pytest.approx(expected, abs=0.21082 * 200.0 / 2**16)
    assert np.min(record.signals["Model Root/Load Cell"]) < -20.0
    assert list(record.signals) == ["Model Root/Load Cell", "Model Root/Trigger"]
