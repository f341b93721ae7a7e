"""Study ``labpipe calibrate``: fits a wire model to cantilever tests, and predicts other tests."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labpipe.errors import ProcessingError, UsageError, sort_by_likeness
from labpipe.mechanics.decks import write_decks
from labpipe.mechanics.law.plays import PlayLaw
from labpipe.mechanics.studies.calibration_file import Calibrated, build_json
from labpipe.mechanics.studies.first_loadings import (
    FirstLoading,
    note_sheet_weight,
    read_first_loadings,
    set_self_weight,
)
from labpipe.mechanics.studies.model_comparisons import (
    compare_external_curves,
    compare_shapes,
    compare_tests,
    note_insulations,
    note_misfits,
    read_external_curves,
)
from labpipe.mechanics.studies.study_files import write_study
from labpipe.mechanics.studies.wire_sheets import build_wire_error, read_wire_sheet
from labpipe.mechanics.wire.bending_law import LOOP_RANGE, fit_play_law
from labpipe.mechanics.wire.calibration.calibrate_wire import (
    Settings,
    Wire,
    calibrate,
    find_tested_curvature,
)
from labpipe.mechanics.wire.calibration.hardening import calibrate_share
from labpipe.mechanics.wire.wire_table import (
    build_wire,
    find_insulation_limit,
    find_law_range,
    set_parameters,
    tabulate_wire,
)
from labpipe.messages import format_sentence
from labpipe.process.output_paths import find_results, find_shared_folder, refuse_duplicates
from labpipe.protocol.load import load_calibration_plan
from labpipe.protocol.sheet_grammar import CalibrationPlan
from labpipe.records.quality import QualityNote
from labpipe.records.wire import (
    PARAMETERS,
    Calibration,
    CalibrationFailure,
    IsotropicShare,
    ParameterChoice,
    WireSpec,
)
from labpipe.report.calibration_figures import list_calibration_figures
from labpipe.report.calibration_summary import CalibrationReport, save_calibration_workbook
from labpipe.units import GRAVITY

MODEL_FILE = "calibration.json"
WORKBOOK_FILE = "calibration.xlsx"


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
    """Calibrate one wire on its tests and predict the tests of other wires.

    Parameters
    ----------
    targets : result.h5 files, or folders that contain such files
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
    curves = read_external_curves(settings, plan, sheet)
    files = find_results(targets)
    loadings, left_out = read_first_loadings(
        files, points=settings.points, up_to=settings.up_to, say=say
    )
    if not loadings:
        raise ProcessingError("\n".join(left_out.values()))
    refuse_duplicates([(loading.curve.test, loading.file) for loading in loadings], "name")
    loadings, copies = drop_copies(loadings)
    name = choose_wire(loadings, settings, plan)
    for loading in loadings:
        sheet.find_wire(loading.curve.wire, f"test {loading.curve.test}, specimen.type")
    tested = {loading.curve.wire for loading in loadings}
    wires_needed = sorted(tested | {curve.wire for curve in curves})
    wires_by_name = {wire: build_sheet_wire(specs[wire], wires) for wire in wires_needed}
    as_read = [loading for loading in loadings if loading.curve.wire == name]
    weight_notes = [*note_sheet_weight(as_read, wires_by_name[name].self_weight)]
    loadings = [
        set_self_weight(loading, wires_by_name[loading.curve.wire].self_weight)
        for loading in loadings
    ]
    calibrating = [loading for loading in loadings if loading.curve.wire == name]
    measured = [loading.curve for loading in calibrating]
    say("calibration")
    tables = [curve.table for curve in sheet.curves[name].values()]
    calibration = _calibrate(wires_by_name[name], calibrating, settings, tables)
    share = _calibrate_share(specs[name], calibration, calibrating)
    groups = compare_tests(calibration, wires_by_name, loadings)
    notes = [
        *calibration.notes,
        *_list_share_notes(specs[name], share),
        *weight_notes,
        *note_insulations(calibration, wires_by_name, specs, loadings),
        *note_misfits(groups),
    ]
    calibration = replace(calibration, isotropic_share=share, notes=tuple(notes))
    calibrated = Calibrated(
        folder=find_shared_folder(files) / "calibration" if out is None else out,
        calibration=calibration,
        groups=groups,
        left_out=left_out | copies,
        files=(),
        comparisons=compare_external_curves(
            curves, calibration, wires_by_name, groups, calibrating + loadings
        ),
        tested_curvature=find_tested_curvature(
            wires_by_name[name], calibration.solutions[0].values, measured
        ),
        stress_tables=sheet.curves[name],
    )
    if figures:
        wire = build_sheet_wire(apply_calibration(specs[name], calibration), wires)
        max_deflection = float(np.max(measured[0].deflection))
        shapes = compare_shapes(
            calibrating[0].file, wire, measured[0].length, measured[0].rig, max_deflection
        )
        calibrated = replace(calibrated, shapes={measured[0].test: shapes} if shapes else {})
    laws = [tabulate_wire(apply_calibration(specs[wire], calibration)) for wire in sorted(tested)]
    report = CalibrationReport(calibration, groups, calibrated.shapes, calibrated.comparisons)

    def write_others(stage: Path) -> list[Path]:
        save_calibration_workbook(report, stage / WORKBOOK_FILE)
        return [stage / WORKBOOK_FILE, *write_decks(laws, stage)]

    say("tables and decks")
    files_written = write_study(
        calibrated.folder,
        {MODEL_FILE: json.dumps(build_json(calibrated), allow_nan=False)},
        [*list_calibration_figures(report)] if figures else (),
        write_others=write_others,
        say=say,
        png=png,
    )
    return replace(calibrated, files=files_written)


DEFAULT_SHEETS = ("wires.xlsx", "wires.csv")
"""Names of the wire sheet in the working folder."""


def find_wire_sheet() -> Path:
    """Return the wire sheet of the working folder.

    Raises
    ------
    UsageError
        If there is none.
    """
    for name in DEFAULT_SHEETS:
        if Path(name).is_file():
            return Path(name)
    raise UsageError.about(
        "mechanics.studies.no_wire_sheet", "--wire", names=" or ".join(DEFAULT_SHEETS)
    )


def choose_wire(
    loadings: Sequence[FirstLoading], settings: CalibrationPlan, plan: Path | None
) -> str:
    """Return the wire of the plan, or the only one with tests.

    Parameters
    ----------
    loadings : of all tests
    settings : the plan
    plan : file of the plan, for messages

    Raises
    ------
    UsageError
        If the wire of the plan has no tests, or it names none and several have tests.
    """
    tested = sorted({loading.curve.wire for loading in loadings})
    wire = tested[0] if settings.wire is None and len(tested) == 1 else settings.wire
    if wire in tested:
        return str(wire)
    if wire is None:
        raise UsageError.about(
            "mechanics.studies.several_wires",
            plan or "tests",
            count=len(tested),
            wires=", ".join(tested),
        )
    raise UsageError.about(
        "mechanics.studies.untested_wire",
        plan or "plan",
        "wire",
        wire=wire,
        tested=", ".join(sort_by_likeness(wire, tested)),
    )


def drop_copies(loadings: Sequence[FirstLoading]) -> tuple[list[FirstLoading], dict[str, str]]:
    """Drop copies of first loadings, which would count as further tests.

    Parameters
    ----------
    loadings : of all tests

    Returns
    -------
    The loadings without copies, and by file the reason why a copy was left out.
    """
    first_by_curve: dict[tuple[bytes, bytes], FirstLoading] = {}
    left_out: dict[str, str] = {}
    for loading in loadings:
        original = first_by_curve.setdefault(
            (loading.curve.deflection.tobytes(), loading.curve.force.tobytes()), loading
        )
        if original is not loading:
            error = UsageError.about("mechanics.studies.copy", loading.file, original=original.file)
            left_out[str(loading.file)] = str(error)
    return list(first_by_curve.values()), left_out


def build_sheet_wire(spec: WireSpec, wires: Path) -> Wire:
    """Build a wire of the sheet.

    Parameters
    ----------
    spec : of the wire
    wires : the sheet, for messages

    Raises
    ------
    ProcessingError
        If its strands do not fit.
    """
    try:
        wire = build_wire(spec)
    except ValueError as error:
        raise build_wire_error(wires, spec, "a wire that can be built", error) from error
    weight = GRAVITY * wire.mass_per_length
    linear_range = find_insulation_limit(spec)
    return Wire(wire.section, wire.contacts, spec.orientation, weight, linear_range)


def apply_calibration(spec: WireSpec, calibration: Calibration) -> WireSpec:
    """Return a wire with the parameters of a calibration instead of those of its sheet.

    Parameters
    ----------
    spec : of the calibrated wire, or of another of the same make
    calibration : a parameter without effect is left unchanged

    Returns
    -------
    The wire; its radial force is set together with its friction coefficients.
    """
    values = {parameter.name: parameter.value for parameter in calibration.parameters}
    return set_parameters(spec, values)


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
        changed_spec = set_parameters(spec, {name: math.exp(value) for name, value in logs.items()})
        built = build_wire(changed_spec)
        return fit_play_law(
            built.section,
            built.contacts,
            isotropic_share=share,
            largest_curvature=find_law_range(changed_spec)[0],
            tension=changed_spec.tension,
            orientation=changed_spec.orientation,
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
        table_end = 2.0 * spec.stress_table[0][-1] / max(spec.strand_diameters)
        max_curvature = find_law_range(spec)[0]
        if table_end < LOOP_RANGE * max_curvature:
            yield QualityNote.of("mechanics.studies.strands_end", spec.name, last=table_end)


def _build_choices(plan: CalibrationPlan) -> dict[str, ParameterChoice]:
    """Return the choices of the plan; a parameter without one is free if it has an effect."""
    choices = {}
    for name in plan.parameters.model_fields_set:
        setting = getattr(plan.parameters, name)
        choices[name] = ParameterChoice(
            value=setting.value,
            is_fixed=setting.enters == "fixed",
            factor=setting.factor,
            source=setting.because,
        )
    return choices
