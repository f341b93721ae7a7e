"""Data of the figures of a harness."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.report.harness_figure import DrawnHarness, DrawnMark, DrawnShape, DrawnSweep
from labpipe.rod import boundaries as rod
from labpipe.rod.bands import StateBands
from labpipe.rod.line import Line
from labpipe.rod.path import RodState
from labpipe.rod.rotations import matrices
from labpipe.studies.harness_numbers import curvature_of, radius_of
from labpipe.studies.harness_responses import RADIUS
from labpipe.studies.harness_solution import FAILED, FollowedHarness, SweepRun


def drawn_harness(solution: FollowedHarness) -> DrawnHarness:
    """Return the data of the figure of a harness.

    Parameters
    ----------
    solution : of a harness
    """
    line, states = solution.prepared.line, solution.path.states
    bands = solution.bands_by_step
    shapes = tuple(_shape(step, states[step], line, bands.get(step)) for step in solution.steps)
    planes = [
        boundary for boundary in solution.prepared.boundaries if isinstance(boundary, rod.Plane)
    ]
    return DrawnHarness(
        name=solution.file.stem,
        note=_caption(solution),
        along=line.stations,
        shapes=shapes,
        marks=_marks(solution),
        planes=tuple((plane.point, plane.normal) for plane in planes),
        allowed=solution.limit.radius,
    )


def _shape(step: int, state: RodState, line: Line, bands: StateBands | None) -> DrawnShape:
    shape = DrawnShape(step, state.positions, radius_of(curvature_of(state, line)))
    if bands is None:
        return shape
    places, bent = bands.positions, bands.curvature
    return replace(
        shape,
        band=(places.lower, places.upper),
        radius_band=(radius_of(bent.upper), radius_of(bent.lower)),
    )


def _caption(solution: FollowedHarness) -> str:
    limit = f"Allowed bend radius {1e3 * solution.limit.radius:.3g} mm, {solution.limit.source}."
    about = solution.harness.about.strip()
    sentences = [about if about[-1] in ".?!" else f"{about}."] if about else []
    line = f"Line of {solution.material.name}, {len(solution.prepared.line.lengths)} elements."
    doubts = [f"Doubtful: {solution.reasons[0].message}."] if solution.reasons else []
    return " ".join([*sentences, line, limit, *doubts])


def _marks(solution: FollowedHarness) -> tuple[DrawnMark, ...]:
    """Return the symbols of clips, grips and other boundaries at the last step."""
    marks = []
    last, steps = solution.path.last, solution.harness.steps
    pairs = zip(solution.harness.boundaries, solution.prepared.boundaries, strict=False)
    for stated, boundary in pairs:  # the weight, which comes last, has no symbol
        path, direction, holds = np.zeros((0, 3)), None, True
        match boundary:
            case rod.Held():
                holds = boundary.release is None or boundary.release > steps
                removed = boundary.position[: boundary.release]
                place: Floats = last.positions[boundary.node] if not holds else removed[-1]
                if stated.kind == "grip":  # the path of a clip is of no interest
                    path = removed
                if boundary.frame is not None and holds:
                    direction = matrices(boundary.frame[-1])[:, 2]
            case rod.Ring():
                place, direction = boundary.position[-1], boundary.direction
            case rod.String():
                place, path = boundary.anchor[-1], last.positions[[boundary.node]]
                path = np.vstack([path, boundary.anchor[-1:]])
            case rod.Load():
                place = last.positions[boundary.node]
            case _:
                continue
        marks.append(DrawnMark(stated.name, stated.kind, place, path, direction, holds))
    return tuple(marks)


def drawn_sweep(solution: FollowedHarness) -> DrawnSweep | None:
    """Return the data of the figure of a sweep; None without one.

    Parameters
    ----------
    solution : of a harness
    """
    if not solution.sweep:
        return None
    sweep = sorted(solution.sweep, key=lambda run: run.length)
    return DrawnSweep(
        name=solution.file.stem,
        note=_caption(solution),
        length=np.array([run.length for run in sweep]),
        radius=np.array([run.bend.radius for run in sweep]),
        way=np.array([run.bend_on_path.radius for run in sweep]),
        radius_band=_radius_band(sweep),
        shapes=tuple(
            np.empty((0, 3)) if run.path.status == FAILED else run.path.last.positions
            for run in sweep
        ),
        allowed=solution.limit.radius,
        is_doubtful=np.array([run.status == "doubtful" for run in sweep]),
    )


def _radius_band(sweep: Sequence[SweepRun]) -> tuple[Floats, Floats] | None:
    """Return the bands of the smallest bend radius by length; None where no length has one."""
    intervals = [None if run.bands is None else run.bands.intervals[RADIUS] for run in sweep]
    if not any(intervals):
        return None
    lower = [math.nan if interval is None else interval.lower for interval in intervals]
    upper = [math.nan if interval is None else interval.upper for interval in intervals]
    return np.array(lower), np.array(upper)
