"""Run ``labpipe harness``: solve a harness file, and write its shape, forces, deck and figures."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from labpipe import __version__
from labpipe.mechanics.decks.mujoco_line import format_line_deck
from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.bands import StateBands
from labpipe.mechanics.rod.line import Line
from labpipe.mechanics.rod.path import RodPath, RodState
from labpipe.mechanics.rod.rotations import to_matrices
from labpipe.mechanics.studies.harness_line import describe_file, read_material
from labpipe.mechanics.studies.harness_numbers import (
    PATH_RADIUS,
    RADIUS,
    compute_curvature,
    compute_heights,
    compute_radius,
    compute_residual_curvature,
)
from labpipe.mechanics.studies.harness_solution import (
    HarnessSolution,
    Progress,
    solve_harness,
    solve_sweep,
)
from labpipe.mechanics.studies.study_files import FIGURES_FOLDER, write_study
from labpipe.messages import format_sentence
from labpipe.protocol.load import load_harness
from labpipe.records.arrays import Floats, Ints
from labpipe.records.quality import Reason
from labpipe.records.result import Status
from labpipe.report.harness_figures import (
    SWEEP_FIGURE,
    DrawnBoundary,
    DrawnHarness,
    DrawnShape,
    DrawnSweep,
    list_harness_figures,
)
from labpipe.store.replace import lock, replace_file
from labpipe.store.summaries import (
    FAILURE_FILE,
    SUMMARY_FILE,
    build_result_entry,
    select_json,
    to_json,
)

SHAPE_FILE, FORCES_FILE, SWEEP_FILE = "shape.csv", "forces.csv", "sweep.csv"
VTK_FILE, DECK_FILE = "shape.vtk", "line.mujoco.xml"
HARNESS_SCHEMA = 1
"""Version of the format of ``summary.json`` and ``failure.json``."""


def follow_harness(
    file: Path,
    *,
    wires: Path | None = None,
    out: Path | None = None,
    figures: bool = True,
    png: bool = False,
    progress: Progress | None = None,
) -> HarnessSolution:
    """Solve the line of a harness and write the results.

    Parameters
    ----------
    file : path of the harness file
    wires : path of a wire sheet to use instead of the one that the file names; None to use that one
    out : folder of the results; None for ``processed/harness/<name of the file>`` in the working
        folder
    figures : whether figures are drawn
    png : whether figures are also written as PNG; otherwise PNG files of an earlier run are removed
    progress : functions that report progress; None to report nothing

    Returns
    -------
    The solution of the harness, with its files. If the line cannot be solved to the last step, only
    ``failure.json`` is written, and earlier results are kept.

    Raises
    ------
    LabpipeError
        If the harness file, or a file that it names, has faults. Earlier results are then kept.
    """
    harness = load_harness(file)
    material = read_material(harness, file, wires)
    folder = Path("processed/harness") / file.stem if out is None else out
    lengths = harness.sweep.length if harness.sweep else ()
    progress = progress or Progress()
    progress.begin(len({harness.line.length, *lengths}), harness.steps + 1)
    progress.begin_line("as stated")
    solution = solve_harness(harness, file, material, folder, progress.end_step)
    if solution.status is Status.FAILED:
        _write_failure(solution)
        return solution
    solution = replace(solution, sweep=solve_sweep(solution, lengths, progress))
    return _write_solution(solution, figures=figures, png=png)


def _write_failure(solution: HarnessSolution) -> None:
    """Write ``failure.json``, and keep the results of earlier runs."""
    states = solution.path.states
    last_positions = states[-1].positions if states else solution.path.line.positions
    content = {
        **_build_header(solution),
        **select_json(solution.reasons[0], "code", reason="message"),
        **select_json(solution, "reasons"),
        "reached": {"step": len(states) - 1, "positions": to_json(last_positions)},
    }
    with lock(solution.folder), replace_file(solution.folder / FAILURE_FILE) as temporary:
        temporary.write_text(_format_json(content), encoding="utf-8", newline="\n")


def _format_json(content: Mapping[str, object]) -> str:
    """Return content as the text of a JSON file."""
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def _write_solution(solution: HarnessSolution, *, figures: bool, png: bool) -> HarnessSolution:
    """Write the files of a solution, and return the solution with their paths."""
    path, bands = solution.path, solution.bands_by_step
    title = f"{solution.file.stem}, {solution.material.name}, labpipe {__version__}"
    texts = {
        SHAPE_FILE: format_shape(path, solution.steps, bands),
        FORCES_FILE: format_forces(path, bands),
        VTK_FILE: format_vtk(path, solution.steps, title),
        DECK_FILE: format_line_deck(path.line, path.boundaries, title=title),
        SUMMARY_FILE: _format_json(build_json(solution)),
    }
    if solution.sweep:
        texts[SWEEP_FILE] = _format_csv(list(map(_build_sweep_row, solution.sweep)))
    earlier_files, pages = [SWEEP_FILE, FAILURE_FILE], []
    if figures:
        earlier_files += [f"{FIGURES_FOLDER}/{SWEEP_FIGURE}.{ending}" for ending in ("svg", "png")]
        pages = list_harness_figures(build_drawn_harness(solution), build_drawn_sweep(solution))
    files = write_study(solution.folder, texts, pages, earlier_files=earlier_files, png=png)
    return replace(solution, files=files)


_LENGTH, _RADIUS, _PATH_RADIUS = "length [m]", f"{RADIUS} [m]", f"{PATH_RADIUS} [m]"
"""Names of columns of ``sweep.csv``."""


def _build_sweep_row(solution: HarnessSolution) -> dict[str, object]:
    """Build the row of ``sweep.csv`` for the solution of one length."""
    lowest_point = math.nan
    if solution.status is not Status.FAILED:
        lowest_point = float(compute_heights(solution.path.last.positions, solution.path).min())
    radius_interval = solution.intervals.get(RADIUS)
    path_bend, final_bend = solution.sharpest_bend, solution.final_sharpest_bend
    reason = solution.reasons[0] if solution.reasons else Reason("", "")
    return {
        _LENGTH: solution.harness.line.length,
        _RADIUS: final_bend.radius,
        "lower [m]": radius_interval.lower if radius_interval else math.nan,
        "upper [m]": radius_interval.upper if radius_interval else math.nan,
        "place [m]": final_bend.arc_length,
        _PATH_RADIUS: path_bend.radius,
        "step": "" if solution.status is Status.FAILED else str(path_bend.step),
        "lowest_point [m]": lowest_point,
        "status": str(solution.status),
        "code": reason.code,
        "reason": reason.message,
    }


def _build_header(solution: HarnessSolution) -> dict[str, object]:
    """Build the first entries of ``summary.json`` and ``failure.json``."""
    files = (describe_file("harness", solution.file), *solution.material.files)
    run_text = "".join([__version__, *(file.sha256 for file in files)])
    return {
        "schema": HARNESS_SCHEMA,
        "harness": solution.file.stem,
        "about": solution.harness.about,
        "labpipe": __version__,
        "run": hashlib.sha256(run_text.encode()).hexdigest(),
        "inputs": [select_json(file, "role", "file", "sha256") for file in files],
        "status": str(solution.status),
    }


def build_json(solution: HarnessSolution) -> dict[str, object]:
    """Build the content of ``summary.json`` in SI units, with None for a missing value.

    Parameters
    ----------
    solution : solution of the harness
    """
    line, material, bands = solution.path.line, solution.material, solution.bands
    section, bend, limit = line.section, solution.sharpest_bend, solution.limit
    section_fields = ("diameter", "mass_per_length", "torsional_stiffness", "axial_stiffness")
    sweep_names = (_LENGTH, "status", _RADIUS, "lower [m]", "upper [m]", _PATH_RADIUS)
    limit_json = select_json(limit, allowed="radius", allowed_from="source", assumed="is_assumed")
    return {
        **_build_header(solution),
        **select_json(solution, "reasons"),
        "line": {
            "of": material.name,
            "length": line.length,
            "elements": len(line.lengths),
            **select_json(section, *section_fields),
            "first_bending_stiffness": section.law.first_stiffness,
            "sliders": len(section.law.slider_stiffnesses),
            **select_json(material, backed_curvature="curvature_limit", backed_by="limit_source"),
        },
        "bend_radius": {
            **limit_json,
            **select_json(bend, "step", place="arc_length", smallest="radius"),
            "kept": bend.radius >= limit.radius,
            "doubtful": solution.is_bend_doubtful,
        },
        "results": [build_result_entry(result) for result in solution.results],
        "sweep": [
            {name.removesuffix(" [m]"): to_json(row[name]) for name in sweep_names}
            for row in map(_build_sweep_row, solution.sweep)
        ],
        # The key "shares" holds the fraction of the variance of the bands from each cause.
        "bands": {"kind": None, "reason": format_sentence("mechanics.studies.no_bands")}
        if bands is None
        else {"kind": "pointwise 95 %"}
        | select_json(bands.line.states[-1], shares="variance_fractions"),
        "quality": [select_json(note, "code", "severity", "message") for note in material.notes],
        "units": _UNITS_BY_NAME,
    }


_UNITS_BY_NAME: Mapping[str, str] = {
    "length": "m",
    "diameter": "m",
    "place": "m",
    "bend_radius": "m",
    "curvature": "1/m",
    "mass_per_length": "kg/m",
    "stiffness": "N*m^2",
    "axial_stiffness": "N",
}
"""SI units of the quantities in ``summary.json``, except for those of the results."""


def _format_csv(table: pd.DataFrame | list[dict[str, object]]) -> str:
    """Format a table as CSV with nine digits; NaN is an empty cell, and infinity is ``inf``."""
    return pd.DataFrame(table).to_csv(index=False, float_format="%.9g", lineterminator="\n")


_POSITION_COLUMNS = ("x [m]", "y [m]", "z [m]")
"""Names of the columns of ``shape.csv`` with the positions of the nodes."""


def compute_columns(state: RodState, line: Line) -> dict[str, Floats]:
    """Compute the columns of ``shape.csv`` for a state, each of shape (n + 1,).

    Parameters
    ----------
    state : state of the line
    line : line of the state

    Notes
    -----
    The tension at a node is the mean of the tensions of the adjacent elements. The torque and the
    bending moment at a node are the values of larger magnitude of the two sides.
    """
    curvature = compute_curvature(state)
    tangents = to_matrices(state.frames)[:, :, 2]
    tension = np.vecdot(state.forces, tangents)
    tangents_before = np.vstack([tangents[:1], tangents])  # of the element before each node
    tangents_after = np.vstack([tangents, tangents[-1:]])
    torque = np.vecdot(state.moments, np.stack([tangents_before, tangents_after], axis=1))
    bending_moment = np.sqrt(np.maximum(np.sum(state.moments**2, axis=2) - torque**2, 0.0))
    return {
        "along [m]": line.stations,
        **dict(zip(_POSITION_COLUMNS, state.positions.T, strict=True)),
        "curvature [1/m]": curvature,
        "bend_radius [m]": compute_radius(curvature),
        "kept_curvature [1/m]": compute_residual_curvature(state, line.section.law),
        "tension [N]": 0.5 * (np.append(tension[:1], tension) + np.append(tension, tension[-1:])),
        "bending_moment [N*m]": bending_moment.max(axis=1),
        "torque [N*m]": np.where(np.abs(torque[:, 0]) > np.abs(torque[:, 1]), *torque.T),
    }


def format_shape(path: RodPath, steps: Sequence[int], bands: Mapping[int, StateBands]) -> str:
    """Return the text of ``shape.csv``, a table of the nodes in some steps.

    Parameters
    ----------
    path : path of the line
    steps : numbers of the steps, in the order of the table
    bands : bands of the shape, keyed by step; the cells of steps without bands are empty
    """
    tables = []
    for step in steps:
        columns: dict[str, object] = {"step": step, "node": np.arange(len(path.line.stations))}
        columns |= compute_columns(path.states[step], path.line)
        if band := bands.get(step):
            lower, upper = band.positions.lower, band.positions.upper
            columns |= _build_band_columns(_POSITION_COLUMNS, lower, upper)
            lower, upper = band.curvature.lower[:, None], band.curvature.upper[:, None]
            columns |= _build_band_columns(["curvature [1/m]"], lower, upper)
        tables.append(pd.DataFrame(columns))
    return _format_csv(pd.concat(tables))


def _build_band_columns(names: Sequence[str], lower: Floats, upper: Floats) -> dict[str, Floats]:
    """Build the columns of a band: the lower and the upper end of each quantity.

    Parameters
    ----------
    names : names of the columns of the quantities, which have a unit, such as ``x [m]``
    lower, upper : shape (..., n_names), ends of the band, in the units of the columns
    """
    return {
        name.replace(" ", f"_{end} "): column
        for name, *columns in zip(names, lower.T, upper.T, strict=True)
        for end, column in zip(("lower", "upper"), columns, strict=True)
    }


def format_forces(path: RodPath, bands: Mapping[int, StateBands]) -> str:
    """Return the text of ``forces.csv``: forces and moments of boundaries on the line in each step.

    Parameters
    ----------
    path : path of the line
    bands : bands of the shape and forces, keyed by step; the cells of steps without bands are empty

    Notes
    -----
    The weight has no rows. In each step, the weight is minus the sum of all forces.
    """
    force_names, moment_names = ["fx [N]", "fy [N]", "fz [N]"], ["mx [N*m]", "my [N*m]", "mz [N*m]"]
    rows = []
    for step, state in enumerate(path.states):
        for index, boundary in enumerate(path.boundaries):
            if isinstance(boundary, rod.Gravity):
                continue
            force, moment = state.reaction_forces[index], state.reaction_moments[index]
            kind = type(boundary).__name__.lower()
            row: dict[str, object] = {"step": step, "boundary": boundary.name, "kind": kind}
            row |= {"force [N]": np.linalg.norm(force), "moment [N*m]": np.linalg.norm(moment)}
            row |= zip([*force_names, *moment_names], [*force, *moment], strict=True)
            if step in bands:
                band = bands[step].reaction_forces
                row |= _build_band_columns(force_names, band.lower[index], band.upper[index])
            rows.append(row)
    return _format_csv(rows)


def format_vtk(path: RodPath, steps: Sequence[int], title: str) -> str:
    """Return the shapes in some steps as legacy VTK text, for ParaView, PyVista or meshio.

    Parameters
    ----------
    path : path of the line
    steps : numbers of the steps; the shape in each step becomes a polyline
    title : title, without line breaks, which is cut after 255 characters; characters that are not
        ASCII become ``?``

    Notes
    -----
    The infinite bend radius of a straight line is written as 0, because not all readers of legacy
    VTK accept an infinity.
    """
    states = [path.states[step] for step in steps]
    n_nodes = len(path.line.stations)
    points = np.vstack([state.positions for state in states])
    point_indices = np.arange(len(points)).reshape(len(states), n_nodes).tolist()
    lines = [
        "# vtk DataFile Version 3.0",
        title.encode("ascii", "replace").decode()[:255],
        "ASCII",
        "DATASET POLYDATA",
        f"POINTS {len(points)} double",
        *(" ".join(f"{value:.9g}" for value in row) for row in points.tolist()),
        f"LINES {len(states)} {len(states) * (n_nodes + 1)}",
        *(" ".join(map(str, [n_nodes, *indices])) for indices in point_indices),
        f"CELL_DATA {len(states)}",
        *_format_scalars("step", np.array(steps)),
        f"POINT_DATA {len(points)}",
    ]
    columns = pd.concat([pd.DataFrame(compute_columns(state, path.line)) for state in states])
    for name in columns.columns.drop([*_POSITION_COLUMNS]):
        lines += _format_scalars(name.split()[0], columns[name].to_numpy())
    return "\n".join(lines) + "\n"


def _format_scalars(name: str, values: Floats | Ints) -> list[str]:
    """Return the lines of point or cell data of VTK; values that are not finite become 0."""
    finite_values = np.where(np.isfinite(values), values, 0.0)
    rows = [f"{value:.9g}" for value in finite_values.tolist()]
    return [f"SCALARS {name} double 1", "LOOKUP_TABLE default", *rows]


def build_drawn_harness(solution: HarnessSolution) -> DrawnHarness:
    """Build the data for the figure of a harness.

    Parameters
    ----------
    solution : solution of the harness
    """
    path, bands = solution.path, solution.bands_by_step
    planes = [boundary for boundary in path.boundaries if isinstance(boundary, rod.Plane)]
    return DrawnHarness(
        name=solution.file.stem,
        note=_format_caption(solution),
        arc_length=path.line.stations,
        shapes=tuple(
            _build_drawn_shape(step, path.states[step], bands.get(step)) for step in solution.steps
        ),
        boundaries=tuple(_build_drawn_boundaries(solution)),
        planes=tuple((plane.point, plane.normal) for plane in planes),
        allowed_radius=solution.limit.radius,
    )


def _build_drawn_shape(step: int, state: RodState, bands: StateBands | None) -> DrawnShape:
    """Build the data for the figure of the shape in a step, with bands if there are any."""
    shape = DrawnShape(step, state.positions, compute_radius(compute_curvature(state)))
    if bands is None:
        return shape
    positions, curvature = bands.positions, bands.curvature
    return replace(
        shape,
        band=(positions.lower, positions.upper),
        radius_band=(compute_radius(curvature.upper), compute_radius(curvature.lower)),
    )


def _format_caption(solution: HarnessSolution) -> str:
    """Return the footnote of the figures of a harness."""
    limit, about, line = solution.limit, solution.harness.about.strip(), solution.path.line
    sentences = [about if about[-1] in ".?!" else f"{about}."] if about else []
    sentences.append(f"Line of {solution.material.name}, {len(line.lengths)} elements.")
    sentences.append(f"Allowed bend radius {1e3 * limit.radius:.3g} mm, {limit.source}.")
    sentences += [f"Doubtful: {reason.message}." for reason in solution.reasons[:1]]
    return " ".join(sentences)


def _build_drawn_boundaries(solution: HarnessSolution) -> Iterator[DrawnBoundary]:
    """Yield the symbols of the boundaries at the last step; planes and weight have no symbol."""
    last_state, steps = solution.path.last, solution.harness.steps
    # The path has the boundaries of the file in the same order. The weight may follow.
    pairs = zip(solution.harness.boundaries, solution.path.boundaries, strict=False)
    for file_boundary, boundary in pairs:
        path, direction, is_holding = np.zeros((0, 3)), None, True
        match boundary:
            case rod.Held():
                is_holding = boundary.release is None or boundary.release > steps
                held_path = boundary.position[: boundary.release]
                released_position: Floats = last_state.positions[boundary.node]
                position = held_path[-1] if is_holding else released_position
                if file_boundary.kind == "grip":  # the path of a clip is not drawn
                    path = held_path
                if boundary.frame is not None and is_holding:
                    direction = to_matrices(boundary.frame[-1])[:, 2]
            case rod.Ring():
                position, direction = boundary.position[-1], boundary.direction
            case rod.String():
                position = boundary.anchor[-1]
                path = np.stack([last_state.positions[boundary.node], position])
            case rod.Load():
                position = last_state.positions[boundary.node]
            case _:
                continue
        name, kind = file_boundary.name, file_boundary.kind
        yield DrawnBoundary(name, kind, position, path, direction, is_holding)


def build_drawn_sweep(solution: HarnessSolution) -> DrawnSweep | None:
    """Build the data for the figure of a sweep; None without a sweep.

    Parameters
    ----------
    solution : solution of the harness
    """
    if not solution.sweep:
        return None
    solutions = sorted(solution.sweep, key=lambda item: item.harness.line.length)
    table = pd.DataFrame(map(_build_sweep_row, solutions))
    lower, upper = table["lower [m]"].to_numpy(), table["upper [m]"].to_numpy()
    return DrawnSweep(
        name=solution.file.stem,
        note=_format_caption(solution),
        length=table[_LENGTH].to_numpy(),
        radius=table[_RADIUS].to_numpy(),
        radius_over_steps=table[_PATH_RADIUS].to_numpy(),
        radius_band=None if np.isnan(lower).all() else (lower, upper),
        shapes=tuple(
            np.empty((0, 3)) if item.status is Status.FAILED else item.path.last.positions
            for item in solutions
        ),
        allowed_radius=solution.limit.radius,
        is_doubtful=table["status"].to_numpy() == str(Status.DOUBTFUL),
    )
