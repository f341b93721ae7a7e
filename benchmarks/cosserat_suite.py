"""The rod of labpipe as a solver of cosseratbench, a suite that judges rods.

An adapter for what the suite asks of equilibrium: rods held at their ends, under weight and loads.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from labpipe.mechanics.law.sliders import make_linear_law
from labpipe.mechanics.rod.boundaries import Boundary, Gravity, Held, Load
from labpipe.mechanics.rod.line import Line, Section
from labpipe.mechanics.rod.rotations import build_frame, to_matrices
from labpipe.mechanics.rod.statics import RodSettings, follow
from labpipe.records.arrays import Floats

STEPS = 10
SOFT = RodSettings(max_strain=0.5)
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
        directors = np.array([to_matrices(path.states[k].frames)[:, :, 0] for k in row])
        times = np.linspace(0.0, scenario.duration, n_frames)
        return Trajectory(times, (positions,), (directors,))


def _section(rod: Any) -> Section:
    bending = rod.material.youngs_modulus * rod.second_moment_of_area
    torsion = rod.material.shear_modulus * 2.0 * rod.second_moment_of_area
    return Section(
        make_linear_law(bending, 1e6),
        torsion,
        axial_stiffness=rod.material.youngs_modulus * rod.area,
        mass_per_length=rod.material.density * rod.area,
    )


def _line(rod: Any, n_elements: int) -> Line:
    nodes, directors = rod.nodes(n_elements), rod.directors(n_elements)
    frames = [
        build_frame(along, aside)
        for along, aside in zip(np.diff(nodes, axis=0), directors, strict=True)
    ]
    lengths = np.full(n_elements, rod.length / n_elements)
    return Line(lengths, _section(rod), nodes, np.array(frames), np.zeros((n_elements - 1, 3)))


def _boundaries(rod: Any, scenario: Any, line: Line) -> list[Boundary]:
    from cosseratbench.scenario import End, EndCondition

    boundaries: list[Boundary] = [Gravity(RAMP * np.array(scenario.gravity))]
    for end, node in ((End.START, 0), (End.END, -1)):
        condition = rod.condition(end)
        if condition is not EndCondition.FREE:
            is_clamped = condition is EndCondition.CLAMPED
            frame: Floats | None = line.frames[node] if is_clamped else None
            boundaries.append(Held(node, line.positions[node], frame))
    for load in rod.loads:
        node = 0 if load.at is End.START else -1
        boundaries.append(Load(node, RAMP * np.array(load.force)))
    return boundaries
