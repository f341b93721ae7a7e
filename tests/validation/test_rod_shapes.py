"""The rod against closed forms, printed numbers, boundary value problems and cosseratbench.

Errors fall with the square of the elements' length. Twist that buckles: Greenhill (1883), Michell
(1889) and Ziegler (1968). cosseratbench judges the experiments that ask for equilibrium without
contact of rods. What a rod does with sliders is judged in `tests/rod`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.cosserat_suite import STEPS, LabpipeRod
from labpipe.records.arrays import Floats
from tests.judges.judged_rods import (
    LiftedChain,
    arch_path,
    bend_error,
    buckled_column_error,
    heavy_cantilever_error,
    lifted_half,
    moment_that_buckles,
    posed_rod_error,
    pressed_column_path,
    torque_that_buckles,
)
from tests.judges.rod_references import (
    Kirchhoff,
    bend_of_45_degrees,
    buckled_column,
    critical_moment_of_joints,
    critical_torque,
    heavy_cantilever,
    pressed_column,
)


def quarter(error: float) -> object:
    """What is left of an error of second order when elements are half as long."""
    return pytest.approx(0.25 * error, rel=0.25)


def size(error: object) -> float:
    return float(np.linalg.norm(np.asarray(error)))


@pytest.mark.parametrize(
    ("weight", "bound"), [(0.1, 1e-6), (1.0, 2e-5), (10.0, 4e-4), (50.0, 1e-3)]
)
def test_cantilever_under_its_weight(weight: float, bound: float) -> None:
    """PHYSICS 7: w L^3 / EI from 0.1 to 50."""
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
    """It buckles at the first chance however coarse the steps, and loses nothing."""
    wanted = np.array(pressed_column(0.2))
    errors = []
    for elements in (20, 40):
        path = pressed_column_path(elements, steps)
        assert path.status == "ok"
        force = np.linalg.norm(path.last.reaction_forces[1])
        errors.append(np.abs(np.array([force, path.stored[-1]]) / wanted - 1.0))
        assert abs(path.jumped[-1]) < 1e-4 * path.stored[-1]
        assert path.work[-1] == pytest.approx(path.stored[-1], rel=2e-3)
    assert np.max(errors[1]) < 3e-3
    assert np.max(errors[1]) == quarter(float(np.max(errors[0])))


@pytest.mark.slow
def test_an_arch_snaps_through_at_its_largest_load() -> None:
    """However small the steps; what is set free is the area above the curve of a held arch."""
    ways = np.linspace(0.0, 0.14, 281)
    held = arch_path(ways=ways)
    assert held.snapped == ()
    force = np.array([state.reaction_forces[2, 2] for state in held.states])
    force *= np.sign(force[-1])
    top = int(np.argmax(force[:140]))
    most = force[top]
    behind = top + int(np.flatnonzero(force[top + 5 :] > most)[0]) + 5
    above = most - force[top : behind + 1]
    area = np.sum(0.5 * (above[1:] + above[:-1])) * ways[1]
    for loads in (
        np.linspace(0.0, 1.2, 97) * most,
        np.concatenate([[0.0, 0.5], np.linspace(0.998, 1.001, 61)]) * most,
        np.concatenate([[0.0, 0.9], np.linspace(0.99999, 1.0001, 61)]) * most,
    ):
        path = arch_path(loads)
        assert path.status == "ok"
        (step,) = path.snapped
        assert loads[step - 1] < 1.0002 * most
        assert loads[step] > 0.9998 * most
        assert path.jumped[-1] == pytest.approx(area, rel=0.01)
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


@pytest.mark.parametrize("torsion", [0.5, 2.0, 10.0])
def test_moment_that_buckles_a_rod_on_universal_joints(torsion: float) -> None:
    """M L / B = 2 pi whatever the torsional stiffness, of second order in its difference to B."""
    errors = [moment_that_buckles(elements, torsion=torsion) - 1.0 for elements in (20, 40, 80)]
    assert abs(errors[2]) < 1e-3
    assert errors[1] == pytest.approx(0.25 * errors[0], rel=0.06)
    assert errors[2] == pytest.approx(0.25 * errors[1], rel=0.06)


def test_tension_holds_a_rod_on_universal_joints() -> None:
    """M^2 = 4 pi^2 + 4 T, in units of B and L."""
    assert moment_that_buckles(40, tension=20.0) == pytest.approx(1.0, abs=2e-3)


def shape_of(chain: LiftedChain, elements: int) -> Floats:
    arc = 0.5 * chain.length * np.arange(elements + 1) / elements
    return np.stack(chain.half_shape(arc), axis=1)


@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_with_friction_it_pulls_by_what_still_lies(friction: float) -> None:
    """Horizontal force = friction times the weight that still lies."""
    chain = LiftedChain(friction=friction)
    path = lifted_half(chain, 40, 1e-5)
    assert path.status == "ok", path.reasons
    places = path.last.positions
    assert places[:, [0, 2]] == pytest.approx(shape_of(chain, 40), abs=3e-3)
    assert path.last.forces[0, 0] == pytest.approx(chain.pull, rel=2e-3)
    assert np.max(np.abs(path.last.stretches)) < 1e-6
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert lengths == pytest.approx(0.5 * chain.length / 40, rel=1e-6)


def metrics(experiment: Any, n_elements: int, **changes: float) -> dict[str, float]:
    """What the suite says of the rod."""
    scenario = experiment.scenario_for(**changes)
    trajectory = LabpipeRod().run(scenario, n_elements=n_elements, n_frames=STEPS + 3)
    return {name: metric(scenario, trajectory) for name, metric in experiment.metrics.items()}


def test_cantilever_of_the_suite() -> None:
    """Against Euler and Bernoulli, whose own error is 0.03 % at this deflection."""
    from cosseratbench.experiments.cantilever import cantilever

    found = metrics(cantilever, 20)
    assert found["tip_deflection_error"] < 1e-3
    assert found["settling_residual"] == 0.0


@pytest.mark.parametrize("tension", [1.0, 30.0])
def test_critical_torque_is_that_of_the_suite(tension: float) -> None:
    from cosseratbench.experiments.twist import critical_moment

    assert critical_torque(tension) == pytest.approx(critical_moment(tension), rel=1e-9)


@pytest.mark.parametrize(("modulus", "span", "bound"), [(1e5, 0.6, 8e-4), (1e6, 0.95, 8e-4)])
def test_cable_of_the_suite(modulus: float, span: float, bound: float) -> None:
    """Against the elastic catenary, which does not bend: the stiffer the cable, the less true."""
    from cosseratbench.experiments.catenary import catenary

    found = metrics(catenary, 50, youngs_modulus=modulus, span=span)
    assert found["shape_error"] < bound
    assert found["sag_error"] < 3e-3
    assert found["settling_residual"] == 0.0


def test_a_light_cantilever_sags_by_an_eighth() -> None:
    """w L^4 / (8 EI), its slope w L^3 / (6 EI)."""
    drop, shortening, angle = heavy_cantilever(0.01)
    assert (drop, angle) == pytest.approx((0.01 / 8.0, 0.01 / 6.0), rel=1e-4)
    assert shortening == pytest.approx(0.01**2 / 112.0, rel=1e-3)  # half the mean of slope^2


def test_torque_that_buckles_a_rod_in_theory() -> None:
    """Greenhill (1883): 8.9868 without tension; pulled hard, M^2 = 4 B T."""
    assert critical_torque() == pytest.approx(8.98682, abs=1e-5)
    assert critical_torque(1e4) == pytest.approx(2.0 * 100.0, rel=2e-3)


def test_moment_that_buckles_a_rod_on_joints_in_theory() -> None:
    """Greenhill (1883); with tension, M^2 = (2 pi)^2 + 4 T."""
    assert critical_moment_of_joints() == pytest.approx(2.0 * np.pi, abs=1e-9)
    assert critical_moment_of_joints(20.0) == pytest.approx(np.sqrt(4.0 * np.pi**2 + 80.0))


@pytest.mark.parametrize(
    ("load", "tip"), [(300.0, (58.84, 22.33, 40.08)), (600.0, (47.23, 15.79, 53.37))]
)
def test_bend_of_45_degrees_in_theory(load: float, tip: tuple[float, float, float]) -> None:
    """Simo and Vu-Quoc (1986), with shear and stretch; codes differ by 0.5 %."""
    assert bend_of_45_degrees(load) == pytest.approx(tip, rel=0.008)


def test_a_rod_in_a_plane_is_the_elastica() -> None:
    """PHYSICS 5: alpha = 2."""
    places, _, moments = Kirchhoff((1.0, 1.0, 0.3), 1.0).under(np.array([2.0, 0.0, 0.0]))
    assert places[-1] == pytest.approx((0.493457, 0.0, 1.0 - 0.160642), abs=1e-6)
    assert moments[0] == pytest.approx((0.0, 2.0 * (1.0 - 0.160642), 0.0), abs=1e-5)


@pytest.mark.parametrize(
    ("degrees", "load", "height", "offset"),
    [(20, 1.015, 0.970, 0.220), (100, 1.518, 0.349, 0.792), (176, 9.116, -0.577, 0.421)],
)
def test_columns_of_timoshenko_and_gere(
    degrees: float, load: float, height: float, offset: float
) -> None:
    """Theory of elastic stability, 2nd edition, table 2-4."""
    assert buckled_column(np.radians(degrees)) == pytest.approx((load, height, offset), abs=2e-3)
