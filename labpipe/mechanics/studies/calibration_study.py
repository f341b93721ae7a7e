"""Calibration of a wire model by processed cantilever tests, with its predictions."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from labpipe.errors import ProcessingError
from labpipe.mechanics.decks import write_decks
from labpipe.mechanics.law.plays import PlayLaw
from labpipe.mechanics.studies.calibration_file import build_calibration_json, build_comparison_json
from labpipe.mechanics.studies.external_curves import compare_external_curves, read_external_curves
from labpipe.mechanics.studies.first_loadings import (
    FirstLoading,
    note_sheet_weight,
    read_first_loadings,
    set_self_weight,
)
from labpipe.mechanics.studies.validation import (
    build_sheet_wire,
    choose_wire,
    compare_shapes,
    compare_tests,
    drop_copies,
    find_wire_sheet,
    note_insulations,
    note_misfits,
    require_wires,
)
from labpipe.mechanics.studies.wire_sheets import StatedCurve, read_wire_sheet
from labpipe.mechanics.wire.calibration.calibrate_wire import Settings, Wire, calibrate
from labpipe.mechanics.wire.calibration.hardening import calibrate_share
from labpipe.mechanics.wire.calibration.prediction import find_tested_curvature
from labpipe.mechanics.wire.cyclic_law import LOOP_RANGE, cyclic_law
from labpipe.mechanics.wire.law_family import apply_values
from labpipe.mechanics.wire.wire_table import build_wire, find_range, wire_table
from labpipe.messages import format_sentence
from labpipe.process.output_paths import find_results, refuse_duplicates, shared_folder
from labpipe.protocol.load import load_calibration_plan
from labpipe.protocol.sheet_grammar import CalibrationPlan
from labpipe.records.quality import QualityNote
from labpipe.records.wire import WireSpec
from labpipe.records.wire_calibration import (
    PARAMETERS,
    Calibration,
    CalibrationFailure,
    ExternalCurveComparison,
    IsotropicShare,
    ParameterChoice,
)
from labpipe.report.calibration_figures import list_calibration_figures
from labpipe.report.calibration_summary import BentShape, CalibrationReport, ValidationGroup
from labpipe.report.calibration_workbook import save_calibration_workbook
from labpipe.report.figure_page import list_pngs, save_pages
from labpipe.store.replace import locked, replacing_together

MODEL_FILE = "calibration.json"
WORKBOOK_FILE = "calibration.xlsx"
FIGURES_FOLDER = "figures"


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """A calibration with its comparisons.

    Parameters
    ----------
    folder : of the results
    calibration : of the wire that was calibrated
    groups : samples of one wire and length each, those of the calibrated wire first
    left_out : by file, why a test was not used
    files : all that were written
    comparisons : external curves, compared with tests and model
    tested_curvature : 1/m, largest in the tests of the calibrated wire
    shapes : of one sample of the calibrated wire and of the model, by test
    stress_tables : of the calibrated wire in the sheet, by column
    """

    folder: Path
    calibration: Calibration
    groups: tuple[ValidationGroup, ...]
    left_out: Mapping[str, str]
    files: tuple[Path, ...]
    comparisons: tuple[ExternalCurveComparison, ...] = ()
    tested_curvature: float = math.nan
    shapes: Mapping[str, tuple[BentShape, ...]] = field(default_factory=dict)
    stress_tables: Mapping[str, StatedCurve] = field(default_factory=dict)


def calibrate_tests(
    targets: Sequence[Path],
    *,
    wires: Path | None = None,
    plan: Path | None = None,
    out: Path | None = None,
    figures: bool = True,
    png: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> Calibrated:
    """Calibrate one wire by its tests and predict the tests of other wires.

    Parameters
    ----------
    targets : result.h5 files, or folders that hold some
    wires : the wire sheet that has the specimen types as its wires; None for ``wires.xlsx`` or
        ``wires.csv`` in the working folder
    plan : calibration YAML; None for all parameters free
    out : folder of the results; None for ``calibration`` in the common folder of all tests
    figures : whether to draw
    png : figures as PNG, too; without it those of an earlier run are removed
    say : called with the name of each test as it is read, then with each stage

    Returns
    -------
    The calibration and its files.

    Raises
    ------
    LabpipeError
        If a file has faults, no test can be used, two have the same name, the wire to calibrate is
        ambiguous, or the calibration fails; earlier results are then unchanged.
    """
    settings = load_calibration_plan(plan) if plan is not None else CalibrationPlan(version=1)
    wires = find_wire_sheet() if wires is None else wires
    sheet = read_wire_sheet(wires)
    specs = {spec.name: spec for spec in sheet.specs}
    curves = read_external_curves(settings, plan, specs, wires)
    files = find_results(targets)
    loadings, left_out = read_first_loadings(
        files, points=settings.points, up_to=settings.up_to, say=say
    )
    if not loadings:
        raise ProcessingError("\n".join(left_out.values()))
    refuse_duplicates([(loading.curve.test, loading.file) for loading in loadings], "name")
    loadings, copies = drop_copies(loadings)
    name = choose_wire(loadings, settings, plan)
    require_wires(loadings, specs, wires)
    tested = {loading.curve.wire for loading in loadings}
    wires_needed = sorted(tested | {curve.wire for curve in curves})
    built = {wire: build_sheet_wire(specs[wire], wires) for wire in wires_needed}
    unweighted = [loading for loading in loadings if loading.curve.wire == name]
    weight = note_sheet_weight(unweighted, built[name].self_weight)
    loadings = [
        set_self_weight(loading, built[loading.curve.wire].self_weight) for loading in loadings
    ]
    calibrating = [loading for loading in loadings if loading.curve.wire == name]
    say("calibration")
    tables = [curve.table for curve in sheet.curves[name].values()]
    calibration = _calibrate(built[name], calibrating, settings, tables)
    share = _calibrate_share(specs[name], calibration, calibrating)
    share_notes = tuple(_list_share_notes(specs[name], share))
    calibration = replace(calibration, share=share, notes=(*calibration.notes, *share_notes))
    measured = [loading.curve for loading in calibrating]
    tested_curvature = find_tested_curvature(built[name], calibration.solutions[0].values, measured)
    notes = (weight, *note_insulations(calibration, built, specs, loadings))
    groups = compare_tests(calibration, built, loadings)
    notes = (*notes, *note_misfits(groups))
    calibration = replace(calibration, notes=(*calibration.notes, *filter(None, notes)))
    done = Calibrated(
        folder=shared_folder(files) / "calibration" if out is None else out,
        calibration=calibration,
        groups=groups,
        left_out=left_out | copies,
        files=(),
        comparisons=compare_external_curves(
            curves, calibration, built, groups, calibrating + loadings
        ),
        tested_curvature=tested_curvature,
        stress_tables=sheet.curves[name],
    )
    if figures:
        wire = build_sheet_wire(apply_calibration(specs[name], calibration), wires)
        done = replace(done, shapes=_compare_shapes(calibrating[0], wire))
    calibrated = [apply_calibration(specs[test], calibration) for test in sorted(tested)]
    return replace(done, files=_write(done, calibrated, say, figures=figures, png=png))


def apply_calibration(spec: WireSpec, calibration: Calibration) -> WireSpec:
    """Return a wire with the parameters of a calibration instead of those of its sheet.

    Parameters
    ----------
    spec : of the calibrated wire, or of another of the same make
    calibration : a parameter without effect is left unchanged

    Returns
    -------
    The wire; its radial force belongs to its friction coefficients.
    """
    return apply_values(
        spec, {parameter.name: parameter.value for parameter in calibration.parameters}
    )


def _calibrate(
    wire: Wire, loadings: Sequence[FirstLoading], plan: CalibrationPlan, tables: Sequence[str]
) -> Calibration:
    settings = Settings(
        choices=_build_choices(plan),
        gain=max(loading.gain for loading in loadings),
        scatter=plan.scatter,
    )
    outcome = calibrate(wire, [loading.curve for loading in loadings], settings)
    if isinstance(outcome, CalibrationFailure):
        message = format_sentence(
            "mechanics.studies.calibration_failed",
            wire=loadings[0].curve.wire,
            code=outcome.code,
            reason=outcome.message,
        )
        if tables and outcome.code == "model_cannot_follow":
            named = ", ".join(tables)
            message += " " + format_sentence("mechanics.studies.short_stress_table", tables=named)
        raise ProcessingError(message)
    notes = (*outcome.notes, *(note for loading in loadings for note in loading.notes))
    return replace(outcome, notes=notes)


def _calibrate_share(
    spec: WireSpec, calibration: Calibration, loadings: Sequence[FirstLoading]
) -> IsotropicShare | None:
    """Calibrate the isotropic share with the law of the best solution."""
    solution = calibration.solutions[0]
    acting = np.flatnonzero(np.isfinite(solution.values))
    names = [PARAMETERS[number] for number in acting]
    best = dict(zip(names, np.log(solution.values[acting]), strict=True))

    def law_at(changes: Mapping[str, float], share: float) -> PlayLaw:
        logs = {name: best[name] + changes.get(name, 0.0) for name in names}
        own = apply_values(spec, {name: math.exp(value) for name, value in logs.items()})
        built = build_wire(own)
        return cyclic_law(
            built.section,
            built.contacts,
            isotropic_share=share,
            largest_curvature=find_range(own)[0],
            tension=own.tension,
            orientation=own.orientation,
        )

    return calibrate_share(
        [loading.cycles for loading in loadings if loading.cycles is not None],
        law_at,
        names,
        solution.covariance[np.ix_(acting, acting)],
        calibration.levels.scatter,
    )


def _list_share_notes(spec: WireSpec, share: IsotropicShare | None) -> Iterator[QualityNote]:
    """Yield notes on a share that is not calibrated, and on a stress table that ends early."""
    if share is None:
        yield QualityNote.of("mechanics.studies.share_not_calibrated", spec.name)
    elif share.is_creep:
        yield QualityNote.of("mechanics.studies.share_by_creep", spec.name)
    if spec.stress_table is not None:
        last = 2.0 * spec.stress_table[0][-1] / max(spec.strand_diameters)
        reached = find_range(spec)[0]
        if last < LOOP_RANGE * reached:
            yield QualityNote.of("mechanics.studies.strands_end", spec.name, last=last)


def _compare_shapes(loading: FirstLoading, wire: Wire) -> dict[str, tuple[BentShape, ...]]:
    """Return the shapes of the first test of the calibrated wire."""
    curve = loading.curve
    deepest = float(np.max(curve.deflection))
    shapes = compare_shapes(loading.file, wire, curve.length, curve.rig, deepest)
    return {curve.test: shapes} if shapes else {}


def _build_choices(plan: CalibrationPlan) -> dict[str, ParameterChoice]:
    """Return the choices of the plan; a parameter without one is free if it has an effect."""
    settings = {
        name: getattr(plan.parameters, name)
        for name in PARAMETERS
        if name in plan.parameters.model_fields_set
    }
    return {
        name: ParameterChoice(
            value=setting.value,
            is_fixed=setting.enters == "fixed",
            factor=setting.factor,
            source=setting.because,
        )
        for name, setting in settings.items()
    }


def _write(
    done: Calibrated,
    calibrated: Sequence[WireSpec],
    say: Callable[[str], None],
    *,
    figures: bool,
    png: bool,
) -> tuple[Path, ...]:
    """Write all files of a calibration together."""
    folder = done.folder
    report = CalibrationReport(done.calibration, done.groups, done.shapes, done.comparisons)
    owned = list_pngs(list_calibration_figures(report), FIGURES_FOLDER) if figures else []
    with locked(folder), replacing_together(folder, owned=owned) as stage:
        say("tables and decks")
        model, workbook = stage / MODEL_FILE, stage / WORKBOOK_FILE
        model.write_text(json.dumps(as_json(done), allow_nan=False), encoding="utf-8")
        save_calibration_workbook(report, workbook)
        written = [model, workbook]
        written += write_decks([wire_table(spec) for spec in calibrated], stage)
        if figures:
            drawings = list_calibration_figures(report)
            written += save_pages(drawings, stage / FIGURES_FOLDER, say=say, png=png)
        return tuple(folder / path.relative_to(stage) for path in written)


def as_json(done: Calibrated) -> dict[str, object]:
    """Return the content of ``labpipe calibrate --json``: lists and numbers in SI units.

    Parameters
    ----------
    done : the calibration
    """
    content = build_calibration_json(
        *(done.calibration, done.groups, done.left_out), done.tested_curvature
    )
    stated = {column: curve.as_json() for column, curve in done.stress_tables.items()}
    compared = [build_comparison_json(comparison) for comparison in done.comparisons]
    return content | {"comparisons": compared, "stress_tables": stated}
