"""The rod as a solver in cosseratbench, whose scenarios, references and metrics judge it.

Of its experiments, the two that ask for equilibrium without contact of rods: the cantilever and the
catenary, a cable that stretches. Buckling by twist is judged there by how fast a rod leaves its
line, which a rod without inertia cannot tell; the critical twist itself is taken from there.
"""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.cosserat_suite import STEPS, LabpipeRod
from tests.judges.rod_references import critical_torque

pytest.importorskip("cosseratbench", reason="cosseratbench is not installed")


def metrics(experiment: Any, n_elements: int, **changes: float) -> dict[str, float]:
    """What the suite says of the rod."""
    scenario = experiment.scenario_for(**changes)
    trajectory = LabpipeRod().run(scenario, n_elements=n_elements, n_frames=STEPS + 3)
    return {name: metric(scenario, trajectory) for name, metric in experiment.metrics.items()}


def test_it_takes_the_adapter() -> None:
    from cosseratbench.solver import Solver

    assert isinstance(LabpipeRod(), Solver)


def test_cantilever() -> None:
    """Against Euler and Bernoulli, whose own error is 0.03 % at this deflection."""
    from cosseratbench.experiments.cantilever import cantilever

    found = metrics(cantilever, 20)
    assert found["tip_deflection_error"] < 1e-3
    assert found["settling_residual"] == 0.0


@pytest.mark.parametrize(
    ("youngs_modulus", "span", "shape", "sag"),
    [
        (1e5, 0.6, 8e-4, 3e-3),
        (1e5, 0.8, 8e-4, 3e-3),
        (1e5, 0.95, 8e-4, 3e-3),
        (1e6, 0.8, 8e-4, 3e-3),
        (1e6, 0.95, 8e-4, 3e-3),
        (1e7, 0.8, 3e-3, 3e-3),
        (1e7, 0.95, 3e-3, 2e-2),
    ],
)
def test_catenary(youngs_modulus: float, span: float, shape: float, sag: float) -> None:
    """Against the elastic catenary, which does not bend: the stiffer the cable, the less true."""
    from cosseratbench.experiments.catenary import catenary

    found = metrics(catenary, 50, youngs_modulus=youngs_modulus, span=span)
    assert found["shape_error"] < shape
    assert found["sag_error"] < sag
    assert found["settling_residual"] == 0.0


@pytest.mark.parametrize("tension", [1.0, 10.0, 30.0])
def test_critical_torque_is_that_of_the_suite(tension: float) -> None:
    from cosseratbench.experiments.twist import critical_moment

    assert critical_torque(tension) == pytest.approx(critical_moment(tension), rel=1e-9)
