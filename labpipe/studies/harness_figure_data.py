"""What the figures of a harness show of it."""

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


def drawn_harness(found: FollowedHarness) -> DrawnHarness:
    """What the figure of a harness shows.

    Parameters
    ----------
    found : a harness that was followed
    """
    line, states = found.laid.line, found.path.states
    bands = {} if found.bands is None else {state.step: state for state in found.bands.line.states}
    shapes = tuple(_shape(step, states[step], line, bands.get(step)) for step in found.steps)
    planes = [boundary for boundary in found.laid.boundaries if isinstance(boundary, rod.Plane)]
    return DrawnHarness(
        name=found.file.stem,
        note=_words(found),
        along=line.stations,
        shapes=shapes,
        marks=_marks(found),
        planes=tuple((plane.point, plane.normal) for plane in planes),
        allowed=found.limit.radius,
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


def _words(found: FollowedHarness) -> str:
    limit = f"Allowed bend radius {1e3 * found.limit.radius:.3g} mm, {found.limit.words}."
    said = found.harness.about.strip()
    about = [said if said[-1] in ".?!" else f"{said}."] if said else []
    made = f"Line of {found.material.name}, {len(found.laid.line.lengths)} elements."
    doubts = [f"Doubtful: {found.reasons[0].message}."] if found.reasons else []
    return " ".join([*about, made, limit, *doubts])


def _marks(found: FollowedHarness) -> tuple[DrawnMark, ...]:
    """Clips, grips and what else is drawn as a sign, where they are at the last step."""
    marks = []
    last, steps = found.path.last, found.harness.steps
    pairs = zip(found.harness.boundaries, found.laid.boundaries, strict=False)
    for each, boundary in pairs:  # the weight, which comes last, has no sign
        way, direction, holds = np.zeros((0, 3)), None, True
        match boundary:
            case rod.Held():
                holds = boundary.release is None or boundary.release > steps
                gone = boundary.position[: boundary.release]
                place: Floats = last.positions[boundary.node] if not holds else gone[-1]
                if each.kind == "grip":  # how a clip is brought to its place says nothing of it
                    way = gone
                if boundary.frame is not None and holds:
                    direction = matrices(boundary.frame[-1])[:, 2]
            case rod.Ring():
                place, direction = boundary.position[-1], boundary.direction
            case rod.String():
                place, way = boundary.anchor[-1], last.positions[[boundary.node]]
                way = np.vstack([way, boundary.anchor[-1:]])
            case rod.Load():
                place = last.positions[boundary.node]
            case _:
                continue
        marks.append(DrawnMark(each.name, each.kind, place, way, direction, holds))
    return tuple(marks)


def drawn_sweep(found: FollowedHarness) -> DrawnSweep | None:
    """What the figure of a sweep shows; None without one.

    Parameters
    ----------
    found : a harness that was followed
    """
    if not found.sweep:
        return None
    sweep = sorted(found.sweep, key=lambda run: run.length)
    return DrawnSweep(
        name=found.file.stem,
        note=_words(found),
        length=np.array([run.length for run in sweep]),
        radius=np.array([run.bend.radius for run in sweep]),
        way=np.array([run.way.radius for run in sweep]),
        radius_band=_radius_band(sweep),
        shapes=tuple(
            np.empty((0, 3)) if run.path.status == FAILED else run.path.last.positions
            for run in sweep
        ),
        allowed=found.limit.radius,
        is_doubtful=np.array([run.status == "doubtful" for run in sweep]),
    )


def _radius_band(sweep: Sequence[SweepRun]) -> tuple[Floats, Floats] | None:
    """Ends of the smallest bend radius, length by length; None where no length has any."""
    found = [None if run.bands is None else run.bands.intervals[RADIUS] for run in sweep]
    if not any(found):
        return None
    lower = [math.nan if finding is None else finding.lower for finding in found]
    upper = [math.nan if finding is None else finding.upper for finding in found]
    return np.array(lower), np.array(upper)
