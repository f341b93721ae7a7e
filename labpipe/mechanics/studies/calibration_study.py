"""Run ``labpipe calibrate``: fit a wire model to cantilever tests, and predict other tests."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labpipe.errors import ProcessingError, UsageError, sort_by_likeness
from labpipe.mechanics.decks import make_deck_texts, write_decks
from labpipe.mechanics.law.plays import PlayLaw
from labpipe.mechanics.studies.calibration_file import CalibrationStudy, build_json
from labpipe.mechanics.studies.first_loadings import (
    FirstLoading,
    make_sheet_weight_notes,
    read_first_loadings,
    set_self_weight,
)
from labpipe.mechanics.studies.model_comparisons import (
    compare_external_curves,
    compare_shapes,
    compare_tests,
    make_insulation_notes,
    make_misfit_notes,
    read_external_curves,
)
from labpipe.mechanics.studies.study_files import write_study
from labpipe.mechanics.studies.wire_sheets import build_wire_error, read_wire_sheet
from labpipe.mechanics.wire.bending_law import LOOP_CURVATURE_FACTOR, fit_play_law
from labpipe.mechanics.wire.calibration.calibrate_wire import (
    Settings,
    Wire,
    calibrate,
    find_tested_curvature,
)
from labpipe.mechanics.wire.calibration.hardening import calibrate_share
from labpipe.mechanics.wire.wire_table import (
    build_wire,
    compute_insulation_limit,
    find_law_range,
    replace_parameters,
    tabulate_wire,
)
from labpipe.messages import format_sentence
from labpipe.process.output_paths import find_results, find_shared_folder, refuse_duplicates
from labpipe.protocol.load import load_calibration_plan
from labpipe.protocol.model_files import CalibrationPlan
from labpipe.records.quality import QualityNote
from labpipe.records.wire import (
    PARAMETERS,
    Calibration,
    CalibrationFailure,
    IsotropicShare,
    ParameterChoice,
    WireSpec,
)
from labpipe.report import calibration_report as reports
from labpipe.units import GRAVITY

CALIBRATION_FILE = "calibration.json"
CALIBRATION_WORKBOOK = "calibration.xlsx"


def calibrate_tests(
    targets: Sequence[Path],
    *,
    wires: Path | None = None,
    plan: Path | None = None,
    out: Path | None = None,
    figures: bool = True,
    png: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> CalibrationStudy:
    """Calibrate one wire on its tests and predict the tests of other wires.

    Parameters
    ----------
    targets : result.h5 files, or folders that contain such files
    wires : path of the wire sheet, which has a wire for each specimen type; None for ``wires.xlsx``
        or ``wires.csv`` in the working folder
    plan : path of the calibration YAML; None to fit all parameters
    out : folder of the results; None for ``calibration`` in the common folder of all tests
    figures : whether figures are drawn
    png : whether figures are also written as PNG; otherwise PNG files of an earlier run are removed
    say : function that is called with the name of each test before it is read, then with each stage

    Returns
    -------
    The calibration with its comparisons and files.

    Raises
    ------
    LabpipeError
        If a file has faults, no test can be used, two tests have the same name, the wire to
        calibrate is ambiguous, or the calibration fails. Earlier results are then unchanged.
    """
    plan_content = load_calibration_plan(plan) if plan is not None else CalibrationPlan(version=1)
    wires = find_wire_sheet() if wires is None else wires
    sheet = read_wire_sheet(wires)
    specs = {spec.name: spec for spec in sheet.specs}
    external_curves = read_external_curves(plan_content, plan, sheet)
    files = find_results(targets)
    loadings, reasons_by_file = read_first_loadings(
        files, min_points=plan_content.points, max_deflection=plan_content.up_to, report_name=say
    )
    if not loadings:
        raise ProcessingError("\n".join(reasons_by_file.values()))
    refuse_duplicates([(loading.curve.test, loading.file) for loading in loadings], "name")
    loadings, copy_reasons = drop_copies(loadings)
    wire_name = choose_wire(loadings, plan_content, plan)
    for loading in loadings:
        sheet.find_wire(loading.curve.wire, f"test {loading.curve.test}, specimen.type")
    tested_wires = sorted({loading.curve.wire for loading in loadings})
    needed_wires = sorted({*tested_wires, *(curve.wire for curve in external_curves)})
    models = {wire: build_sheet_wire(specs[wire], wires) for wire in needed_wires}
    weight_notes = [*make_sheet_weight_notes(loadings, wire_name, models[wire_name].self_weight)]
    loadings = [
        set_self_weight(loading, models[loading.curve.wire].self_weight) for loading in loadings
    ]
    loadings_of_wire = [loading for loading in loadings if loading.curve.wire == wire_name]
    measured_curves = [loading.curve for loading in loadings_of_wire]
    say("calibration")
    table_names = [curve.table for curve in sheet.curves[wire_name].values()]
    calibration = _calibrate(models[wire_name], loadings_of_wire, plan_content, table_names)
    isotropic_share = _calibrate_share(specs[wire_name], calibration, loadings_of_wire)
    groups = compare_tests(calibration, models, loadings)
    notes = [
        *calibration.notes,
        *_make_share_notes(specs[wire_name], isotropic_share),
        *weight_notes,
        *make_insulation_notes(calibration, models, specs, loadings),
        *make_misfit_notes(groups),
    ]
    calibration = replace(calibration, isotropic_share=isotropic_share, notes=tuple(notes))
    study = CalibrationStudy(
        folder=find_shared_folder(files) / "calibration" if out is None else out,
        calibration=calibration,
        groups=groups,
        left_out=reasons_by_file | copy_reasons,
        files=(),
        comparisons=tuple(
            compare_external_curves(
                external_curves, calibration, models, groups, loadings_of_wire + loadings
            )
        ),
        tested_curvature=find_tested_curvature(
            models[wire_name], calibration.solutions[0].values, measured_curves
        ),
        stress_tables=sheet.curves[wire_name],
    )
    if figures:
        model = build_sheet_wire(apply_calibration(specs[wire_name], calibration), wires)
        curve, file = measured_curves[0], loadings_of_wire[0].file
        shapes = compare_shapes(file, model, curve.length, curve.rig, float(curve.deflection.max()))
        study = replace(study, shapes={curve.test: shapes} if shapes else {})
    tables = [tabulate_wire(apply_calibration(specs[wire], calibration)) for wire in tested_wires]
    report = reports.CalibrationReport(calibration, groups, study.shapes, study.comparisons)

    def write_others(folder: Path) -> list[Path]:
        """Write the workbook and the decks into a folder."""
        reports.save_calibration_workbook(report, folder / CALIBRATION_WORKBOOK)
        texts_by_wire = {table.name: make_deck_texts(table) for table in tables}
        return [folder / CALIBRATION_WORKBOOK, *write_decks(texts_by_wire, folder)]

    say("tables and decks")
    written_files = write_study(
        study.folder,
        {CALIBRATION_FILE: json.dumps(build_json(study), allow_nan=False)},
        [*reports.list_calibration_figures(report)] if figures else (),
        write_others=write_others,
        say=say,
        png=png,
    )
    return replace(study, files=written_files)


DEFAULT_SHEETS = ("wires.xlsx", "wires.csv")
"""Names of the wire sheet in the working folder; the first file that exists is used."""


def find_wire_sheet() -> Path:
    """Find the wire sheet in the working folder.

    Raises
    ------
    UsageError
        If there is no wire sheet.
    """
    for name in DEFAULT_SHEETS:
        if Path(name).is_file():
            return Path(name)
    names = " or ".join(DEFAULT_SHEETS)
    raise UsageError.about("mechanics.studies.no_wire_sheet", "--wire", names=names)


def choose_wire(
    loadings: Sequence[FirstLoading], plan: CalibrationPlan, plan_path: Path | None
) -> str:
    """Choose the wire to calibrate: the wire of the plan, or the only wire that has tests.

    Parameters
    ----------
    loadings : first loadings of all tests
    plan : plan of the calibration
    plan_path : path of the plan, for messages; None without a plan

    Returns
    -------
    Name of the wire.

    Raises
    ------
    UsageError
        If the wire of the plan has no tests, or the plan names no wire and several wires have
        tests.
    """
    tested_wires = sorted({loading.curve.wire for loading in loadings})
    wire = plan.wire
    if wire is None and len(tested_wires) > 1:
        values = {"count": len(tested_wires), "wires": ", ".join(tested_wires)}
        raise UsageError.about("mechanics.studies.several_wires", plan_path or "tests", **values)
    if wire is not None and wire not in tested_wires:
        names, place = ", ".join(sort_by_likeness(wire, tested_wires)), plan_path or "plan"
        values = {"wire": wire, "tested": names}
        raise UsageError.about("mechanics.studies.untested_wire", place, "wire", **values)
    return wire or tested_wires[0]


def drop_copies(loadings: Sequence[FirstLoading]) -> tuple[list[FirstLoading], dict[str, str]]:
    """Drop copies of first loadings, which would count as further tests.

    Parameters
    ----------
    loadings : first loadings of all tests

    Returns
    -------
    originals : the first loadings without copies
    reasons_by_file : reason why a copy is not used, keyed by the path of its file
    """
    originals: dict[tuple[bytes, bytes], FirstLoading] = {}
    reasons_by_file: dict[str, str] = {}
    for loading in loadings:
        content = loading.curve.deflection.tobytes(), loading.curve.force.tobytes()
        original = originals.setdefault(content, loading)
        if original is not loading:
            error = UsageError.about("mechanics.studies.copy", loading.file, original=original.file)
            reasons_by_file[str(loading.file)] = str(error)
    return list(originals.values()), reasons_by_file


def build_sheet_wire(spec: WireSpec, wires: Path) -> Wire:
    """Build the model of a wire in a wire sheet.

    Parameters
    ----------
    spec : specification of the wire in the sheet
    wires : path of the sheet, for messages

    Raises
    ------
    ProcessingError
        If the wire cannot be built, for example because its strands do not fit.
    """
    try:
        wire = build_wire(spec)
    except ValueError as error:
        raise build_wire_error(wires, spec, "a wire that can be built", error) from error
    self_weight = GRAVITY * wire.mass_per_length
    linear_range = compute_insulation_limit(spec)
    return Wire(wire.section, wire.contacts, spec.orientation, self_weight, linear_range)


def apply_calibration(spec: WireSpec, calibration: Calibration) -> WireSpec:
    """Replace parameters of a wire with the calibrated parameters.

    Parameters
    ----------
    spec : specification of the calibrated wire, or of another wire of the same make
    calibration : calibration; parameters that have no effect on the tests remain unchanged

    Returns
    -------
    Specification with the parameters. The radial force is set together with the friction
    coefficients.
    """
    values = {parameter.name: parameter.value for parameter in calibration.parameters}
    return replace_parameters(spec, values)


def _calibrate(
    wire: Wire, loadings: Sequence[FirstLoading], plan: CalibrationPlan, table_names: Sequence[str]
) -> Calibration:
    """Calibrate a wire on its first loadings.

    Parameters
    ----------
    wire : model of the wire
    loadings : first loadings of the wire
    plan : plan of the calibration
    table_names : names of the stress tables of the wire, for the message if the model cannot follow
        the tests

    Raises
    ------
    ProcessingError
        If the calibration fails.
    """
    choices = {name: getattr(plan.parameters, name) for name in plan.parameters.model_fields_set}
    settings = Settings(
        choices={
            name: ParameterChoice(
                value=choice.value,
                is_fixed=choice.enters == "fixed",
                factor=choice.factor,
                source=choice.because,
            )
            for name, choice in choices.items()
        },
        gain=max(loading.gain_uncertainty for loading in loadings),
        scatter=plan.scatter,
    )
    outcome = calibrate(wire, [loading.curve for loading in loadings], settings)
    if isinstance(outcome, CalibrationFailure):
        values = {"wire": loadings[0].curve.wire, "code": outcome.code, "reason": outcome.message}
        message = format_sentence("mechanics.studies.calibration_failed", **values)
        if table_names and outcome.code == "model_cannot_follow":
            names = ", ".join(table_names)
            message += " " + format_sentence("mechanics.studies.short_stress_table", tables=names)
        raise ProcessingError(message)
    notes = (*outcome.notes, *(note for loading in loadings for note in loading.notes))
    return replace(outcome, notes=notes)


def _calibrate_share(
    spec: WireSpec, calibration: Calibration, loadings: Sequence[FirstLoading]
) -> IsotropicShare | None:
    """Calibrate the isotropic share of the hardening with the law of the best solution.

    Return None if no test contributes to the share.
    """
    solution = calibration.solutions[0]
    indices = np.flatnonzero(np.isfinite(solution.values))  # of parameters that have an effect
    names = [PARAMETERS[index] for index in indices]
    values = dict(zip(names, solution.values[indices], strict=True))

    def make_law(log_changes: Mapping[str, float], isotropic_share: float) -> PlayLaw:
        """Make the law for changes of the logarithms of the parameters."""
        changed_values = {
            name: value * math.exp(log_changes.get(name, 0.0)) for name, value in values.items()
        }
        changed_spec = replace_parameters(spec, changed_values)
        wire = build_wire(changed_spec)
        return fit_play_law(
            wire.section,
            wire.contacts,
            isotropic_share=isotropic_share,
            largest_curvature=find_law_range(changed_spec)[0],
            tension=changed_spec.tension,
            orientation=changed_spec.orientation,
        )

    return calibrate_share(
        [loading.cycles for loading in loadings if loading.cycles is not None],
        make_law,
        names,
        solution.covariance[np.ix_(indices, indices)],
        calibration.levels.scatter,
    )


def _make_share_notes(
    spec: WireSpec, isotropic_share: IsotropicShare | None
) -> Iterator[QualityNote]:
    """Yield notes on a missing or doubtful isotropic share, and on a too short stress table."""
    if isotropic_share is None:
        yield QualityNote.of("mechanics.studies.share_not_calibrated", spec.name)
    elif isotropic_share.is_creep:
        yield QualityNote.of("mechanics.studies.share_by_creep", spec.name)
    if spec.stress_table is not None:
        # The curvature, 1/m, at which the strain of the strands reaches the end of the table.
        table_end = 2.0 * spec.stress_table[0][-1] / max(spec.strand_diameters)
        max_curvature = find_law_range(spec)[0]
        if table_end < LOOP_CURVATURE_FACTOR * max_curvature:
            yield QualityNote.of("mechanics.studies.strands_end", spec.name, table_end=table_end)
