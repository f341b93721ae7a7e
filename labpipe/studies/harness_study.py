"""Harness files from YAML to results: solution, tables, figures."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from labpipe import __version__
from labpipe.decks.mujoco_line import line_deck
from labpipe.protocol.load import load_harness
from labpipe.records.result import Status
from labpipe.report.harness_figure import FIGURE, SWEEP_FIGURE, harness_drawings
from labpipe.report.saving import save_pages
from labpipe.store.replace import locked, replacing, replacing_together, storing
from labpipe.store.summaries import FAILURE_FILE, SUMMARY_FILE, finite_or_none, result_entry
from labpipe.studies.harness_figure_data import drawn_harness, drawn_sweep
from labpipe.studies.harness_responses import RADIUS, heights_of
from labpipe.studies.harness_section import input_file, material_of
from labpipe.studies.harness_solution import (
    FAILED,
    FollowedHarness,
    SweepRun,
    solve_harness,
    solve_sweep_length,
)
from labpipe.studies.harness_tables import Bands, forces_csv, shape_csv, shape_vtk

SHAPE_FILE, FORCES_FILE, SWEEP_FILE = "shape.csv", "forces.csv", "sweep.csv"
VTK_FILE, DECK_FILE = "shape.vtk", "line.mujoco.xml"
FIGURES_FOLDER = "figures"
SCHEMA = 1


@dataclass(frozen=True, slots=True)
class Watcher:
    """Callbacks for progress.

    Parameters
    ----------
    begin : called with the number of lines and of the steps of each
    line : called with the name of each line before it is solved
    step : called after each step
    """

    begin: Callable[[int, int], object] = lambda _lines, _steps: None
    line: Callable[[str], object] = lambda _: None
    step: Callable[[], object] = lambda: None


def follow_harness(
    file: Path,
    *,
    wires: Path | None = None,
    out: Path | None = None,
    figures: bool = True,
    png: bool = False,
    watcher: Watcher | None = None,
) -> FollowedHarness:
    """Solve the line of a harness and write the results.

    Parameters
    ----------
    file : harness YAML
    wires : wire sheet instead of that in the file
    out : folder of the results; None for ``processed/harness/<name of the file>`` in the working
        folder
    figures : whether to draw
    png : figures as PNG, too; without it those of an earlier run are removed
    watcher : of the progress

    Returns
    -------
    The harness with its numbers and files. If the line cannot be solved to the last step, only
    ``failure.json`` is written; earlier results are then unchanged.

    Raises
    ------
    LabpipeError
        If the file or one that it names has faults; earlier results are then unchanged.
    """
    harness = load_harness(file)
    material = material_of(harness, file, wires)
    folder = Path("processed/harness") / file.stem if out is None else out
    lengths = harness.sweep.length if harness.sweep else ()
    watcher = watcher or Watcher()
    others = [length for length in lengths if length != harness.line.length]
    watcher.begin(len(others) + 1, harness.steps + 1)
    watcher.line("as stated")
    solution = solve_harness(harness, file, material, folder, watcher.step)
    if solution.status is Status.FAILED:
        _write_failure(solution)
        return solution
    sweep = []
    for length in lengths:
        if length in others:
            watcher.line(f"length {1e3 * length:.6g} mm")
        sweep.append(solve_sweep_length(solution, length, watcher.step))
    return _write(replace(solution, sweep=tuple(sweep)), figures=figures, png=png)


def _write_failure(solution: FollowedHarness) -> None:
    """Write the reason beside earlier results, which are unchanged."""
    first, states = solution.reasons[0], solution.path.states
    reached = states[-1].positions if states else solution.prepared.line.positions
    content = {
        **_json_head(solution),
        "code": first.code,
        "reason": first.message,
        "reasons": [asdict(reason) for reason in solution.reasons],
        "reached": {"step": len(states) - 1, "positions": reached.tolist()},
    }
    text = json.dumps(content, indent=1, ensure_ascii=False)
    with locked(solution.folder), replacing(solution.folder / FAILURE_FILE) as temporary:
        temporary.write_text(f"{text}\n", encoding="utf-8", newline="\n")


def _write(solution: FollowedHarness, *, figures: bool, png: bool) -> FollowedHarness:
    folder, rod_path, prepared = solution.folder, solution.path, solution.prepared
    title = f"{solution.file.stem}, {solution.material.name}, labpipe {__version__}"
    texts = {
        SHAPE_FILE: shape_csv(rod_path, prepared.line, solution.steps, _shape_bands(solution)),
        FORCES_FILE: forces_csv(rod_path, prepared, _force_bands(solution)),
        VTK_FILE: shape_vtk(rod_path, prepared.line, solution.steps, title),
        DECK_FILE: line_deck(prepared.line, prepared.boundaries, title=title),
        SUMMARY_FILE: json.dumps(as_json(solution), indent=1, ensure_ascii=False) + "\n",
    }
    if solution.sweep:
        texts[SWEEP_FILE] = _sweep_csv(solution.sweep)
    names = (FIGURE, SWEEP_FIGURE) if figures else ()
    owned = [SWEEP_FILE, FAILURE_FILE, *(f"{FIGURES_FOLDER}/{name}.png" for name in names)]
    owned += [f"{FIGURES_FOLDER}/{SWEEP_FIGURE}.svg"] if figures else []
    with locked(folder), replacing_together(folder, owned=owned) as stage:
        with storing(folder):
            for name, text in texts.items():
                (stage / name).write_text(text, encoding="utf-8", newline="\n")
        written = [stage / name for name in texts]
        if figures:
            drawn = drawn_harness(solution)
            into = stage / FIGURES_FOLDER
            written += save_pages(harness_drawings(drawn, drawn_sweep(solution)), into, png=png)
        files = tuple(folder / path.relative_to(stage) for path in written)
    return replace(solution, files=files)


def _shape_bands(solution: FollowedHarness) -> Bands:
    return {
        step: (
            np.column_stack([state.positions.lower, state.curvature.lower]),
            np.column_stack([state.positions.upper, state.curvature.upper]),
        )
        for step, state in solution.bands_by_step.items()
    }


def _force_bands(solution: FollowedHarness) -> Bands:
    return {
        step: (state.reaction_forces.lower, state.reaction_forces.upper)
        for step, state in solution.bands_by_step.items()
    }


def _sweep_csv(sweep: Sequence[SweepRun]) -> str:
    ends = "smallest_bend_radius [m],lower [m],upper [m],place [m]"
    after = "smallest_bend_radius_on_the_way [m],step,lowest_point [m]"
    lines = [f"length [m],{ends},{after},status,code,reason"]
    for run in sweep:
        reason = run.reasons[0] if run.reasons else None
        numbers = [""] * 7
        if run.path.status != FAILED:
            lowest = float(heights_of(run.path.last.positions, run.prepared).min())
            bend, bend_on_path = run.bend, run.bend_on_path
            low, high = _band_ends(run).values()
            values = (
                bend.radius,
                low,
                high,
                bend.place,
                bend_on_path.radius,
                bend_on_path.step,
                lowest,
            )
            numbers = ["" if value is None else f"{value:.9g}" for value in values]
        why = ["", ""] if reason is None else [reason.code, f'"{reason.message}"']
        lines.append(",".join([f"{run.length:.9g}", *numbers, run.status, *why]))
    return "\n".join(lines) + "\n"


def _json_head(solution: FollowedHarness) -> dict[str, object]:
    files = (input_file("harness", solution.file), *solution.material.files)
    fingerprints = "".join([__version__, *(file.sha256 for file in files)])
    return {
        "schema": SCHEMA,
        "harness": solution.file.stem,
        "about": solution.harness.about,
        "labpipe": __version__,
        "run": hashlib.sha256(fingerprints.encode()).hexdigest(),
        "inputs": [{"role": file.role, "file": file.file, "sha256": file.sha256} for file in files],
        "status": str(solution.status),
    }


def as_json(solution: FollowedHarness) -> dict[str, object]:
    """Return the content of ``summary.json``: SI numbers; None for one that is not available.

    Parameters
    ----------
    solution : of a harness
    """
    section, line = solution.prepared.line.section, solution.prepared.line
    bend, limit = solution.sharpest, solution.limit
    return {
        **_json_head(solution),
        "reasons": [asdict(reason) for reason in solution.reasons],
        "line": {
            "of": solution.material.name,
            "length": line.length,
            "elements": len(line.lengths),
            "diameter": section.diameter,
            "mass_per_length": section.mass_per_length,
            "first_bending_stiffness": section.law.first_stiffness,
            "sliders": len(section.law.stiffnesses),
            "torsional_stiffness": section.torsional_stiffness,
            "axial_stiffness": finite_or_none(section.axial_stiffness),
            "backed_curvature": solution.material.limit,
            "backed_by": solution.material.limit_source,
        },
        "bend_radius": {
            "allowed": limit.radius,
            "allowed_from": limit.source,
            "assumed": limit.is_assumed,
            "smallest": finite_or_none(bend.radius),
            "step": bend.step,
            "place": bend.place,
            "kept": bend.radius >= limit.radius,
            "doubtful": solution.is_bend_doubtful,
        },
        "results": [result_entry(result) for result in solution.results],
        "sweep": [
            {
                "length": run.length,
                "status": run.status,
                "smallest_bend_radius": finite_or_none(run.bend.radius),
                **_band_ends(run),
                "smallest_bend_radius_on_the_way": finite_or_none(run.bend_on_path.radius),
            }
            for run in solution.sweep
        ],
        "bands": _bands_json(solution),
        "quality": [
            {"code": note.code, "severity": str(note.severity), "message": note.message}
            for note in solution.material.notes
        ],
        "units": dict(_UNITS),
    }


def _band_ends(run: SweepRun) -> dict[str, float | None]:
    """Return the ends of the band of the smallest bend radius; None without one."""
    if run.bands is None:
        return {"lower": None, "upper": None}
    interval = run.bands.intervals[RADIUS]
    return {"lower": finite_or_none(interval.lower), "upper": finite_or_none(interval.upper)}


def _bands_json(solution: FollowedHarness) -> dict[str, object]:
    """Return the kind of the bands and the share of each cause, or why there are none."""
    if solution.bands is None:
        reason = "the uncertainty of the law is unknown: name a calibration or an uncertainty"
        return {"kind": None, "reason": reason}
    shares = solution.bands.line.states[-1].shares
    return {
        "kind": "pointwise 95 %",
        "shares": {name: dict(share) for name, share in shares.items()},
    }


_UNITS: Mapping[str, str] = {
    "length": "m",
    "diameter": "m",
    "place": "m",
    "bend_radius": "m",
    "curvature": "1/m",
    "mass_per_length": "kg/m",
    "stiffness": "N*m^2",
    "axial_stiffness": "N",
}
