"""The rod against closed forms, printed numbers, boundary value problems and cosseratbench.

Errors fall with the square of the elements' length. Twist that buckles: Greenhill (1883), Michell
(1889) and Ziegler (1968). cosseratbench judges the experiments that ask for equilibrium without
contact of rods. What a rod does with sliders is judged in `tests/rod`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from benchmarks.cosserat_suite import STEPS, LabpipeRod
from tests.judges.judged_rods import (
    LiftedChain,
    arch_path,
    bend_error,
    buckled_column_error,
    heavy_cantilever_error,
    lifted_half,
    posed_rod_error,
    pressed_column_path,
    torque_that_buckles,
)
from tests.judges.rod_references import (
    Kirchhoff,
    bend_of_45_degrees,
    buckled_column,
    critical_torque,
    heavy_cantilever,
    pressed_column,
)


def quarter(error: float) -> object:
    """What is left of an error of second order when elements are half as long."""
    return pytest.approx(0.25 * error, rel=0.25)


def size(error: object) -> float:
    return float(np.linalg.norm(np.asarray(error)))


PLANE = Kirchhoff((1.0, 1.0, 0.3), 1.0)


@pytest.mark.parametrize(
    ("reference", "printed"),
    [
        # w L^4 / (8 EI), half the mean of the slope's square, w L^3 / (6 EI)
        (lambda: heavy_cantilever(0.01), pytest.approx((1 / 800, 1e-4 / 112, 1 / 600), rel=1e-3)),
        # Greenhill (1883)
        (critical_torque, pytest.approx(8.98682, abs=1e-5)),
        # Simo and Vu-Quoc (1986), with shear and stretch; codes differ by 0.5 %
        (lambda: bend_of_45_degrees(600.0), pytest.approx((47.23, 15.79, 53.37), rel=0.008)),
        # the elastica, alpha = 2
        (
            lambda: PLANE.under(np.array([2.0, 0.0, 0.0]))[0][-1],
            pytest.approx((0.493457, 0.0, 1.0 - 0.160642), abs=1e-6),
        ),
        # Timoshenko and Gere, Theory of elastic stability, 2nd edition, table 2-4
        (lambda: buckled_column(np.radians(20)), pytest.approx((1.015, 0.970, 0.220), abs=2e-3)),
        (lambda: buckled_column(np.radians(176)), pytest.approx((9.116, -0.577, 0.421), abs=2e-3)),
    ],
)
def test_references_are_as_printed(reference: Callable[[], object], printed: object) -> None:
    assert reference() == printed


@pytest.mark.parametrize(
    ("weight", "bound"), [(0.1, 1e-6), (1.0, 2e-5), (10.0, 4e-4), (50.0, 1e-3)]
)
def test_cantilever_under_its_weight(weight: float, bound: float) -> None:
    """Loads w L^3 / EI from 0.1 to 50."""
    coarse, fine = (size(heavy_cantilever_error(elements, weight)) for elements in (20, 40))
    assert coarse < bound
    assert fine < 0.32 * coarse


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [20.0, 60.0, 120.0, 176.0])
def test_column_after_buckling(degrees: float) -> None:
    """Found from the straight column, which stands on its own up to the critical load."""
    error = buckled_column_error(40, degrees)
    assert size(error) < 1e-3
    assert size(buckled_column_error(80, degrees)) < 0.3 * size(error)


@pytest.mark.parametrize("steps", [2, 32])
def test_column_pressed_along_itself(steps: int) -> None:
    """It buckles at the first chance however coarse the steps."""
    expected_force, _ = pressed_column(0.2)
    errors = []
    for elements in (20, 40):
        path = pressed_column_path(elements, steps)
        assert path.status == "ok"
        force = np.linalg.norm(path.last.reaction_forces[1])
        errors.append(abs(float(force) / expected_force - 1.0))
    assert errors[1] < 3e-3
    assert errors[1] == quarter(errors[0])


@pytest.mark.slow
def test_an_arch_snaps_through_at_its_largest_load() -> None:
    """However small the steps."""
    ways = np.linspace(0.0, 0.14, 281)
    held = arch_path(ways=ways)
    assert held.jump_steps == ()
    force = np.array([state.reaction_forces[2, 2] for state in held.states])
    force *= np.sign(force[-1])
    top = int(np.argmax(force[:140]))
    most = force[top]
    for loads in (
        np.linspace(0.0, 1.2, 97) * most,
        np.concatenate([[0.0, 0.5], np.linspace(0.998, 1.001, 61)]) * most,
        np.concatenate([[0.0, 0.9], np.linspace(0.99999, 1.0001, 61)]) * most,
    ):
        path = arch_path(loads)
        assert path.status == "ok"
        (step,) = path.jump_steps
        assert loads[step - 1] < 1.0002 * most
        assert loads[step] > 0.9998 * most
        down = path.states[0].positions[8, 2] - path.last.positions[8, 2]
        assert np.interp(down, ways, force) == pytest.approx(loads[-1], rel=0.01)


def test_bend_of_45_degrees() -> None:
    """Bathe and Bolourchi (1979): within 0.02 % of 100 with 16 elements, of second order."""
    coarse, fine = size(bend_error(16)), size(bend_error(32))
    assert coarse < 0.03
    assert fine == quarter(coarse)


@pytest.mark.slow
def test_rod_posed_in_space() -> None:
    """Clamped at both ends, twisted and under its weight: shape and the far clamp's force."""
    (coarse, pulls), (fine, pull) = posed_rod_error(20), posed_rod_error(40)
    assert fine < 2e-4
    assert pull < 2e-3
    assert fine == quarter(coarse)
    assert pull == quarter(pulls)


def test_torque_that_buckles_a_clamped_rod() -> None:
    """M L / B = 8.9868; both ends held, the rod free to stretch by next to nothing."""
    assert torque_that_buckles(20) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_with_friction_it_pulls_by_what_still_lies(friction: float) -> None:
    """Horizontal force = friction times the weight that still lies."""
    chain = LiftedChain(friction=friction)
    path = lifted_half(chain, 40, 1e-5)
    assert path.status == "ok", path.reasons
    places = path.last.positions
    shape = np.stack(chain.half_shape(0.5 * chain.length * np.arange(41) / 40), axis=1)
    assert places[:, [0, 2]] == pytest.approx(shape, abs=3e-3)
    assert path.last.forces[0, 0] == pytest.approx(chain.pull, rel=2e-3)
    assert np.max(np.abs(path.last.stretches)) < 1e-6
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert lengths == pytest.approx(0.5 * chain.length / 40, rel=1e-6)


def metrics(experiment: Any, n_elements: int, **changes: float) -> dict[str, float]:
    """What the suite says of the rod."""
    scenario = experiment.scenario_for(**changes)
    trajectory = LabpipeRod().run(scenario, n_elements=n_elements, n_frames=STEPS + 3)
    return {name: metric(scenario, trajectory) for name, metric in experiment.metrics.items()}


def test_experiments_of_the_suite() -> None:
    """Euler and Bernoulli, 0.03 % off at this deflection; the elastic catenary does not bend."""
    from cosseratbench.experiments.cantilever import cantilever
    from cosseratbench.experiments.catenary import catenary
    from cosseratbench.experiments.twist import critical_moment

    bent = metrics(cantilever, 20)
    assert bent["tip_deflection_error"] < 1e-3
    assert bent["settling_residual"] == 0.0
    for modulus, span in ((1e5, 0.6), (1e6, 0.95)):
        hung = metrics(catenary, 50, youngs_modulus=modulus, span=span)
        assert hung["shape_error"] < 8e-4
        assert hung["sag_error"] < 3e-3
        assert hung["settling_residual"] == 0.0
    assert critical_torque(30.0) == pytest.approx(critical_moment(30.0), rel=1e-9)
