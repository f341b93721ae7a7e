"""The rod as a solver in cosseratbench, whose scenarios, references and metrics judge it.

Of its experiments, the two that ask for equilibrium without contact of rods: the cantilever and the
catenary, a cable that stretches. Buckling by twist is judged there by how fast a rod leaves its
line, which a rod without inertia cannot tell; the critical twist itself is taken from there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.rod.boundaries import Boundary, Gravity, Held, Load
from labpipe.rod.line import Line, Section
from labpipe.rod.rotations import frame_from_axes, matrices
from labpipe.rod.statics import RodSettings, follow
from tests.builders.judged_rods import section
from tests.builders.rod_references import critical_torque

pytest.importorskip("cosseratbench", reason="cosseratbench is not installed")

STEPS = 10
SOFT = RodSettings(most_stretch=0.5)
RAMP = np.linspace(0.0, 1.0, STEPS + 1)[:, None]


class LabpipeRod:
    """An adapter: the state at rest, reached in steps, as the last frames of a trajectory."""

    name = "labpipe"

    def __init__(self) -> None:
        from cosseratbench.solver import Capability

        self.capabilities = frozenset({Capability.STRETCH})

    def run(self, scenario: Any, *, n_elements: int, n_frames: int) -> Any:
        from cosseratbench.trajectory import Trajectory

        (rod,) = scenario.rods
        line = _line(rod, n_elements)
        path = follow(line, _boundaries(rod, scenario, line), steps=STEPS, settings=SOFT)
        assert path.status == "ok", path.reasons
        row = np.clip(np.arange(n_frames), 0, STEPS)
        positions = np.array([path.states[k].positions for k in row])
        directors = np.array([matrices(path.states[k].frames)[:, :, 0] for k in row])
        times = np.linspace(0.0, scenario.duration, n_frames)
        return Trajectory(times, (positions,), (directors,))


def _section(rod: Any) -> Section:
    bending = rod.material.youngs_modulus * rod.second_moment_of_area
    torsion = rod.material.shear_modulus * 2.0 * rod.second_moment_of_area
    weight = 9.81 * rod.material.density * rod.area
    return section(bending, torsion, weight=weight, stretch=rod.material.youngs_modulus * rod.area)


def _line(rod: Any, n_elements: int) -> Line:
    nodes, directors = rod.nodes(n_elements), rod.directors(n_elements)
    frames = [
        frame_from_axes(along, aside)
        for along, aside in zip(np.diff(nodes, axis=0), directors, strict=True)
    ]
    lengths = np.full(n_elements, rod.length / n_elements)
    return Line(lengths, _section(rod), nodes, np.array(frames), np.zeros((n_elements - 1, 3)))


def _boundaries(rod: Any, scenario: Any, line: Line) -> list[Boundary]:
    from cosseratbench.scenario import End, EndCondition

    found: list[Boundary] = [Gravity(RAMP * np.array(scenario.gravity))]
    for end, node in ((End.START, 0), (End.END, -1)):
        condition = rod.condition(end)
        if condition is not EndCondition.FREE:
            is_clamped = condition is EndCondition.CLAMPED
            frame: Floats | None = line.frames[node] if is_clamped else None
            found.append(Held(node, line.positions[node], frame))
    for load in rod.loads:
        node = 0 if load.at is End.START else -1
        found.append(Load(node, RAMP * np.array(load.force)))
    return found


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
