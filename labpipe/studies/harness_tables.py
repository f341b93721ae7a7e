"""Shape and forces of a solved harness as text: CSV for spreadsheets, VTK for viewers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.rod import boundaries as rod
from labpipe.rod.line import Line
from labpipe.rod.path import RodPath, RodState
from labpipe.rod.rotations import matrices
from labpipe.studies.harness_line import PreparedLine
from labpipe.studies.harness_numbers import curvature_of, radius_of
from labpipe.studies.residual_curvature import residual_curvature

BANDED = ("x [m]", "y [m]", "z [m]", "curvature [1/m]")
"""Columns of the shape that have bands where there are any."""
Bands = Mapping[int, tuple[Floats, Floats]]
"""By step: lower and upper ends; of the columns `BANDED` shape (n + 1, 4) each."""
_AXES = "xyz"


def shape_columns(state: RodState, line: Line) -> dict[str, Floats]:
    """Return the columns of all nodes of a state; each of shape (n + 1,).

    Parameters
    ----------
    state : of the line
    line : in this state

    Notes
    -----
    Tension and torque are those of elements, at a node the mean of both sides.
    """
    curvature = curvature_of(state, line)
    axes = matrices(state.frames)[:, :, 2]
    tension = np.einsum("nk,nk->n", state.forces, axes)
    before, behind = np.insert(tension, 0, tension[0]), np.append(tension, tension[-1])
    moments = state.moments
    both = np.concatenate([axes[:1], axes]), np.concatenate([axes, axes[-1:]])
    torque = np.einsum("nsk,nsk->ns", moments, np.stack(both, axis=1))
    bending = np.sqrt(np.maximum(np.sum(moments**2, axis=2) - torque**2, 0.0))
    places = {f"{axis} [m]": state.positions[:, k] for k, axis in enumerate(_AXES)}
    return {
        "along [m]": line.stations,
        **places,
        "curvature [1/m]": curvature,
        "bend_radius [m]": radius_of(curvature),
        "kept_curvature [1/m]": residual_curvature(state, line.section.law),
        "tension [N]": 0.5 * (before + behind),
        "bending_moment [N*m]": bending.max(axis=1),
        "torque [N*m]": np.where(np.abs(torque[:, 0]) > np.abs(torque[:, 1]), *torque.T),
    }


def shape_csv(path: RodPath, line: Line, steps: Sequence[int], bands: Bands) -> str:
    """Write the nodes of some steps.

    Parameters
    ----------
    path : of the line
    line : of the path
    steps : one after the other
    bands : of some steps; others have empty cells
    """
    names = [f"{name.split()[0]}_{end} {name.split()[1]}" for name in BANDED for end in _ENDS]
    head = ["step", "node", *shape_columns(path.states[steps[0]], line)]
    lines = [",".join([*head, *(names if bands else [])])]
    for step in steps:
        columns = [*shape_columns(path.states[step], line).values()]
        if bands:
            columns += _band_ends(bands.get(step), len(line.stations))
        rows = zip(*(column.tolist() for column in columns), strict=True)
        lines += [",".join([str(step), str(n), *map(_cell, row)]) for n, row in enumerate(rows)]
    return "\n".join(lines) + "\n"


_ENDS = ("lower", "upper")


def _band_ends(band: tuple[Floats, Floats] | None, nodes: int) -> list[Floats]:
    """Return the columns of a band, lower and upper in turn; NaN without one."""
    if band is None:
        return [np.full(nodes, np.nan)] * (2 * len(BANDED))
    return [end[:, column] for column in range(len(BANDED)) for end in band]


def _cell(value: float) -> str:
    """Format a number with nine digits; empty for NaN, ``inf`` for a straight line."""
    return "" if math.isnan(value) else f"{value:.9g}"


def forces_csv(path: RodPath, prepared: PreparedLine, bands: Bands) -> str:
    """Write forces and moments of each boundary on the line in every step.

    Parameters
    ----------
    path : of the line
    prepared : line and boundaries
    bands : by step, lower and upper ends of the forces, shape (boundaries, 3) each; other steps
        have empty cells

    Notes
    -----
    The weight is left out: in each step it is minus the sum of the others.
    """
    names = [
        f"{boundary}{axis} [{unit}]"
        for boundary, unit in (("f", "N"), ("m", "N*m"))
        for axis in _AXES
    ]
    ends = [f"f{axis}_{end} [N]" for axis in _AXES for end in _ENDS] if bands else []
    head = ["step", "boundary", "kind", "force [N]", "moment [N*m]", *names, *ends]
    lines = [",".join(head)]
    holding = [
        (number, boundary)
        for number, boundary in enumerate(prepared.boundaries)
        if not isinstance(boundary, rod.Gravity)
    ]
    for step, state in enumerate(path.states):
        for number, boundary in holding:
            force, moment = state.reaction_forces[number], state.reaction_moments[number]
            sizes = [float(np.linalg.norm(force)), float(np.linalg.norm(moment))]
            cells = [*sizes, *force.tolist(), *moment.tolist()]
            if bands:
                low, high = bands.get(step, (np.full((number + 1, 3), np.nan),) * 2)
                cells += [float(end[number, axis]) for axis in range(3) for end in (low, high)]
            labels = [str(step), _quoted(boundary.name), type(boundary).__name__.lower()]
            lines.append(",".join([*labels, *map(_cell, cells)]))
    return "\n".join(lines) + "\n"


def _quoted(name: str) -> str:
    """Quote a name for a cell of a CSV, if necessary."""
    return '"' + name.replace('"', '""') + '"' if set(name) & set('",\n') else name


def shape_vtk(path: RodPath, line: Line, steps: Sequence[int], title: str) -> str:
    """Write the shapes of some steps for ParaView, PyVista or meshio: legacy VTK, polygonal lines.

    Parameters
    ----------
    path : of the line
    line : of the path
    steps : one line for each
    title : of one line

    Notes
    -----
    Infinite bend radii of a straight line are written as 0: legacy VTK has no infinity that all
    readers accept.
    """
    states = [path.states[step] for step in steps]
    count = len(line.stations)
    points = np.vstack([state.positions for state in states])
    nodes_of_lines = np.arange(len(points)).reshape(len(states), count).tolist()
    return (
        "\n".join(
            [
                "# vtk DataFile Version 3.0",
                title.encode("ascii", "replace").decode()[:255],
                "ASCII",
                "DATASET POLYDATA",
                f"POINTS {len(points)} double",
                *(" ".join(f"{value:.9g}" for value in row) for row in points.tolist()),
                f"LINES {len(states)} {len(states) * (count + 1)}",
                *(" ".join(map(str, [count, *nodes])) for nodes in nodes_of_lines),
                f"CELL_DATA {len(states)}",
                *_scalars("step", [float(step) for step in steps]),
                f"POINT_DATA {len(points)}",
                *_point_data([shape_columns(state, line) for state in states]),
            ]
        )
        + "\n"
    )


def _point_data(columns: Sequence[Mapping[str, Floats]]) -> Iterator[str]:
    for name in columns[0]:
        if name[:2] in ("x ", "y ", "z "):
            continue
        values = np.concatenate([column[name] for column in columns])
        yield from _scalars(name.split()[0], np.where(np.isfinite(values), values, 0.0).tolist())


def _scalars(name: str, values: Iterable[float]) -> Iterator[str]:
    yield f"SCALARS {name} double 1"
    yield "LOOKUP_TABLE default"
    yield from (f"{value:.9g}" for value in values)
