"""Simulation of a virtual test, in memory or on disk: exports, test sheet and truth.

The test sheet states the nominal gain of the load cell, not the true one. It overrides the shipped
protocol only where the virtual rig differs from it.

``truth.json`` holds the true values in SI, with frames, signs and clocks as in
`virtual_lab.truth`. The processing never reads it.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import date, datetime
from io import StringIO
from math import degrees
from pathlib import Path
from typing import Generic, TypeAlias, TypeVar, overload

import numpy as np
import yaml

from labpipe.mechanics.law.plays import PlayLaw
from labpipe.records.harness_bundle import NONE
from labpipe.records.recording import Recording
from labpipe.store.replace import storing
from labpipe.virtual_lab import instruments
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, solve_path
from labpipe.virtual_lab.specimens import WIRES, BundleModel, StrandedWire, lay_wires
from labpipe.virtual_lab.tensile import ExportLayout, TensilePath, TensileScenario
from labpipe.virtual_lab.three_point import ConduitScenario, solve_three_point
from labpipe.virtual_lab.truth import (
    CantileverTruth,
    ConduitTruth,
    TensileTruth,
    evaluate_cantilever,
    evaluate_conduit,
    evaluate_taped,
    evaluate_tensile,
)
from labpipe.virtual_lab.vendor_exports import (
    Run,
    write_control_desk,
    write_motive,
    write_r_controller,
    write_test_suite,
)

Scenario: TypeAlias = CantileverScenario | ConduitScenario | TensileScenario
"""A virtual test of any of the three kinds."""

RECORDER_FILES: Mapping[str, tuple[str, ...]] = {"force": ("force.mat",), "markers": ("take.csv",)}
"""Exports of force recorder and cameras, by role."""
WIRE_SHEET = "wires.csv"
_HEAD = "# A synthetic test, made by labpipe's virtual lab. Its true values are in truth.json.\n"

_WIRE_VALUES: Mapping[str, object] = {
    "sources.force.calibration.gain": "0.5 N/V",
    "sources.force.calibration.gain_uncertainty": "0.2 %",
    "rig.crosshead_speed": "1 mm/s",
    "rig.stroke": "53 mm",
    "rig.cycles": 3,
    "rig.string.length": "760 mm",
    "rig.string.counterweight": "2.7 g",
    "markers.grip_offset": "6 mm",
    "markers.pull_offset": "4 mm",
    "markers.centre_offset": "0.8 mm",
}
PROTOCOL_VALUES: Mapping[str, Mapping[str, object]] = {
    "wire-cantilever": _WIRE_VALUES,
    # A cell of 2 lb, markers 0.5 in apart on a bundle of nineteen wires of 1.1 mm.
    "taped-bundle": {
        **_WIRE_VALUES,
        "sources.force.calibration.gain": "0.89 N/V",
        "markers.pull_offset": "6.35 mm",
        "markers.centre_offset": "2.75 mm",
    },
    "conduit-bundle": {
        "sources.force.calibration.gain": "-0.21082 N/V",
        "sources.force.calibration.gain_uncertainty": "0.2 %",
        "rig.crosshead_speed": "0.5 mm/s",
        "rig.stroke": "29.4 mm",
        "specimen.section.outer_diameter": "14.1 mm",
        "markers.centre_offset": "8.55 mm",
    },
}
"""Values of the shipped protocols of bending tests, by key."""
_WIRE_COLUMNS = (
    "wire",
    "wire_diameter_mm",
    "strands",
    "strand_diameter_mm",
    "lay_angles_deg",
    "insulation_thickness_mm",
    "layout",
)


def write_sheet(scenario: Scenario, files: Mapping[str, Sequence[str]] = RECORDER_FILES) -> str:
    """Write the test sheet.

    Parameters
    ----------
    scenario : the test
    files : names of the exports, by role

    Returns
    -------
    The text of ``test.yaml``.
    """
    sheet: dict[str, object] = {
        "test": scenario.name,
        "protocol": scenario.protocol,
        "specimen": _describe_specimen(scenario),
        "date": date.fromisoformat(scenario.date),
        "operator": "virtual lab",
        "files": {
            role: names[0] if len(names) == 1 else list(names) for role, names in files.items()
        },
    }
    if overrides := _list_overrides(scenario):
        sheet["overrides"] = overrides
    return _HEAD + yaml.safe_dump(
        sheet, sort_keys=False, allow_unicode=True, default_flow_style=None, width=200
    )


def _describe_specimen(scenario: Scenario) -> dict[str, object]:
    entries: dict[str, object] = {
        "type": scenario.specimen_type,
        "spool": scenario.spool,
        "sample": scenario.sample,
    }
    match scenario:
        case TensileScenario():
            words = {"labels": dict(scenario.labels), "observed": dict(scenario.observed)}
            entries["length"] = _format_mm(scenario.length)
            return entries | {name: block for name, block in words.items() if block}
        case ConduitScenario():
            span = _format_mm(scenario.test.span)
            return entries | {"span": span, "bundle": _describe_bundle(scenario.bundle)}
        case CantileverScenario():
            test = scenario.mechanics
            entries["length"] = _format_mm(test.length)
            if test.mass_per_length:
                entries["mass_per_length"] = f"{1e3 * test.mass_per_length:.6g} g/m"
            if isinstance(test.wire, BundleModel):
                entries["bundle"] = _describe_bundle(test.wire)
            return entries


def _describe_bundle(bundle: BundleModel) -> dict[str, object]:
    """Return the block ``bundle`` of a specimen, with positions for several types of wires."""
    entries: dict[str, object] = {
        "wires": {
            name: {"number": number, "diameter": _format_mm(WIRES[name].diameter)}
            for name, number in bundle.wires
        },
        "number": bundle.number,
        "arrangement": bundle.arrangement,
    }
    if len(bundle.wires) > 1:
        layout = lay_wires(bundle)
        places = zip(layout.x, layout.y, strict=True)
        entries["positions"] = [[f"{1e3 * x:.4f} mm", f"{1e3 * y:.4f} mm"] for x, y in places]
    covers = {"tape": bundle.tape, "taping": bundle.taping, "conduit": bundle.conduit}
    entries |= {key: value for key, value in covers.items() if value != NONE}
    if bundle.conduit_bore is not None:
        entries["conduit_bore"] = _format_mm(bundle.conduit_bore)
    return entries


def _list_overrides(scenario: Scenario) -> dict[str, dict[str, object]]:
    """Return the differences from the protocol with their reasons, by key."""
    match scenario:
        case TensileScenario():
            return _list_tensile_overrides(scenario)
        case ConduitScenario():
            length, rig = scenario.test.stroke, _list_conduit_values(scenario)
        case CantileverScenario():
            length, rig = scenario.mechanics.stroke, _list_cantilever_values(scenario)
    cell = scenario.load_cell
    values = {
        "sources.force.calibration.gain": f"{cell.gain:.10g} N/V",
        "sources.force.calibration.gain_uncertainty": f"{100 * cell.gain_uncertainty:.10g} %",
        "rig.crosshead_speed": f"{1e3 * scenario.speed:.10g} mm/s",
        "rig.stroke": _format_mm(length),
        "markers.centre_offset": _format_mm(scenario.markers.centre_offset),
        **rig,
    }
    protocol_values = PROTOCOL_VALUES[scenario.protocol]
    return {
        key: {"value": values[key], "because": "the virtual rig is set so"}
        for key, protocol_value in protocol_values.items()
        if values[key] != protocol_value
    }


def _list_tensile_overrides(scenario: TensileScenario) -> dict[str, dict[str, object]]:
    """Return the differences from the protocol: uncertainty of the load cell, size of the tube."""
    sizes: dict[str, dict[str, object]] = {
        f"specimen.section.{name}": {
            "value": _format_mm(size),
            "because": "a tube of another size",
        }
        for name, size in scenario.section
    }
    # the shipped protocols of the other tensile tests state the uncertainty of both load cells
    if scenario.protocol != "stiff-bar" and scenario.instruments.gain_uncertainty == 0.0025:
        return sizes
    certificate = f"{100.0 * scenario.instruments.gain_uncertainty:.10g} %"
    key = "sources.frame.channels.force.scale_uncertainty"
    return {key: {"value": certificate, "because": "certificate of the load cell"}, **sizes}


def _list_cantilever_values(scenario: CantileverScenario) -> dict[str, object]:
    mechanics, markers = scenario.mechanics, scenario.markers
    return {
        "rig.cycles": mechanics.cycles,
        "rig.string.length": _format_mm(mechanics.string_length),
        "rig.string.counterweight": f"{1e3 * mechanics.counterweight:.10g} g",
        "markers.grip_offset": _format_mm(-markers.pivot[0]),
        "markers.pull_offset": _format_mm(markers.pull_offset),
    }


def _list_conduit_values(scenario: ConduitScenario) -> dict[str, object]:
    return {"specimen.section.outer_diameter": _format_mm(2.0 * scenario.test.outer_radius)}


def write_wire_sheet(folder: Path) -> Path:
    """Write the sheet of the virtual wires for `labpipe model` and `labpipe calibrate`.

    The sheet states dimensions and materials, but no friction, which a calibration identifies.

    Parameters
    ----------
    folder : created if it does not exist

    Returns
    -------
    The sheet, with a row for each of `virtual_lab.specimens.WIRES`.
    """
    text = StringIO()
    sheet = csv.writer(text, lineterminator="\n")
    sheet.writerow(_WIRE_COLUMNS)
    sheet.writerows(_format_wire_row(wire) for wire in WIRES.values())
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / WIRE_SHEET
    path.write_text(text.getvalue(), encoding="utf-8")
    return path


def _format_wire_row(wire: StrandedWire) -> tuple[str, ...]:
    return (
        wire.name,
        f"{1e3 * wire.diameter:.6g}",
        str(wire.n_strands),
        f"{1e3 * wire.strand:.9g}",
        ";".join(f"{degrees(angle):.6g}" for angle in wire.lay_angles),
        f"{1e3 * wire.wall:.6g}",
        "compressed" if wire.is_compressed else "hexagonal",
    )


def _format_mm(length: float) -> str:
    return f"{1e3 * length:.10g} mm"


SHEET_FILE, TRUTH_FILE = "test.yaml", "truth.json"

S = TypeVar("S", CantileverScenario, ConduitScenario)
T = TypeVar("T", CantileverTruth, ConduitTruth)


@dataclass(frozen=True, slots=True, eq=False)
class BendingObservation(Generic[S, T]):
    """A virtual bending test: records of the instruments, and true values.

    Parameters
    ----------
    scenario, seed : inputs
    force_record, take : of force recorder and cameras
    truth : true values
    frame_record : of the load frame; None in the cantilever rig, or without its export
    """

    scenario: S
    seed: int
    force_record: instruments.ForceRecord
    take: instruments.Take
    truth: T
    frame_record: instruments.FrameRecord | None = None

    @property
    def force(self) -> Recording:
        """Return the force recording as read from its export: volts, without unit."""
        return self.force_record.recording()

    @property
    def markers(self) -> Recording:
        """Return the motion-capture recording as read from its export."""
        return self.take.recording()

    @property
    def frame(self) -> Recording | None:
        """Return the recording of the load frame as read from its export, in SI, if available."""
        return None if self.frame_record is None else self.frame_record.recording()


Observation: TypeAlias = BendingObservation[CantileverScenario, CantileverTruth]
"""A virtual test in the cantilever rig."""
ConduitObservation: TypeAlias = BendingObservation[ConduitScenario, ConduitTruth]
"""A virtual test in three-point bending."""


@dataclass(frozen=True, slots=True, eq=False)
class TensileObservation:
    """A virtual tensile test: record of the load frame, and true values.

    Parameters
    ----------
    scenario, seed : inputs
    record : of the load frame
    truth : true values
    """

    scenario: TensileScenario
    seed: int
    record: instruments.FrameRecord
    truth: TensileTruth


AnyObservation: TypeAlias = Observation | ConduitObservation | TensileObservation


@overload
def observe(scenario: CantileverScenario, seed: int) -> Observation: ...
@overload
def observe(scenario: ConduitScenario, seed: int) -> ConduitObservation: ...
@overload
def observe(scenario: TensileScenario, seed: int) -> TensileObservation: ...
def observe(scenario: Scenario, seed: int) -> AnyObservation:
    """Run a virtual test without writing files.

    Parameters
    ----------
    scenario : the test
    seed : of noise, gain and mishaps; the mechanics do not depend on it

    Returns
    -------
    The observation. Tests with equal mechanics share one solution, so that only the first one takes
    seconds.

    Raises
    ------
    ValueError
        If the mechanics have no solution, or a tensile test has fewer than three samples.
    IndexError
        If a mishap names a marker that does not exist.
    """
    match scenario:
        case CantileverScenario():
            path, plan = solve_path(scenario.mechanics), instruments.plan_cantilever(scenario)
            force, marker = _spawn_generators(seed, 2)
            return BendingObservation(
                scenario,
                seed,
                instruments.record_cantilever_force(path, scenario, plan, force),
                instruments.film_cantilever(path, scenario, plan, marker),
                evaluate_cantilever(path, plan),
            )
        case ConduitScenario():
            bending_path, plan = (
                solve_three_point(scenario.test),
                instruments.plan_conduit(scenario),
            )
            force, travel, marker = _spawn_generators(seed, 3)
            has_frame = scenario.has_frame_export
            return BendingObservation(
                scenario,
                seed,
                instruments.record_conduit_force(bending_path, scenario, plan, force),
                instruments.film_conduit(bending_path, scenario, plan, marker),
                evaluate_conduit(bending_path, scenario, plan),
                instruments.record_crosshead(bending_path, scenario, plan, travel)
                if has_frame
                else None,
            )
        case TensileScenario():
            tensile_path = TensilePath(scenario)
            record = instruments.record_frame(tensile_path, np.random.default_rng(seed))
            return TensileObservation(
                scenario, seed, record, evaluate_tensile(tensile_path, record.time)
            )


def _spawn_generators(seed: int, number: int) -> list[np.random.Generator]:
    """Return an independent generator per instrument."""
    return [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(number)]


def simulate_test(scenario: Scenario, folder: Path, seed: int) -> Path:
    """Run a virtual test and write its exports, test sheet and truth.

    Parameters
    ----------
    scenario : the test
    folder : of this test; created if it does not exist; files of the same names are replaced
    seed : the same seed gives identical files

    Returns
    -------
    The folder.

    Raises
    ------
    ValueError
        If the scenario has no solution or is invalid.
    StoreError
        If the files cannot be written.
    """
    return write_exports(observe(scenario, seed), folder)


def write_exports(observation: AnyObservation, folder: Path) -> Path:
    """Write all files of a virtual test; see `simulate_test`."""
    with storing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        sheet = write_sheet(observation.scenario, _write_recordings(observation, folder))
        (folder / SHEET_FILE).write_text(sheet, encoding="utf-8")
        truth = json.dumps(truth_as_json(observation)) + "\n"
        (folder / TRUTH_FILE).write_text(truth, encoding="utf-8")
    return folder


def _write_recordings(observation: AnyObservation, folder: Path) -> Mapping[str, tuple[str, ...]]:
    """Write the exports of the programs and return the names of the files by role."""
    scenario = observation.scenario
    started = datetime.fromisoformat(f"{scenario.date}T10:05:00")
    run = Run(scenario.name, started, observation.seed)
    if isinstance(observation, TensileObservation):
        record, layout = observation.record, observation.scenario.export
        if layout.force_unit == "lbf":
            return {"frame": write_r_controller(folder, record, run)}
        return {"frame": write_test_suite(folder, record, layout, run)}
    (force,), (markers,) = RECORDER_FILES.values()
    write_control_desk(folder / force, observation.force_record, run)
    write_motive(folder / markers, observation.take, run, unit=observation.scenario.length_unit)
    if observation.frame_record is None:
        return RECORDER_FILES
    layout, test_type = ExportLayout(force_unit="N"), "three-point bending test"
    frame = write_test_suite(folder, observation.frame_record, layout, run, test_type=test_type)
    return {**RECORDER_FILES, "frame": frame}


def truth_as_json(observation: AnyObservation) -> dict[str, object]:
    """Return the truth of a virtual test as in ``truth.json``.

    Parameters
    ----------
    observation : the test

    Returns
    -------
    Numbers, lists and text only: the scenario, the fields of the test's truth, and for bending
    tests the law of the specimen, the true gain and the markers.
    """
    facts: dict[str, object] = {"synthetic": True, "seed": observation.seed}
    facts["scenario"] = asdict(observation.scenario)
    if not isinstance(observation, TensileObservation):
        facts |= _collect_bending_facts(observation)
    return facts | {key: _to_json(value) for key, value in asdict(observation.truth).items()}


def _collect_bending_facts(observation: Observation | ConduitObservation) -> dict[str, object]:
    take, scenario = observation.take, observation.scenario
    gain = observation.force_record.true_gain
    markers = [
        {"label": label, "arc_length": _to_json(arc_length)}
        for label, arc_length in zip(take.labels, take.arc_lengths, strict=True)
    ]
    if isinstance(scenario, ConduitScenario):
        stiffnesses = dict(scenario.bundle.stiffnesses)
        return {"stiffnesses": stiffnesses, "true_gain": gain, "markers": markers}
    wire = scenario.mechanics.wire
    facts: dict[str, object] = {"wire": None, "bundle": None}
    if isinstance(wire, StrandedWire):
        facts["wire"] = {**wire.parameters, "sample_factor": wire.factor}
    if isinstance(wire, BundleModel):
        truth = asdict(evaluate_taped(solve_path(scenario.mechanics)))
        facts["bundle"] = {"stiffnesses": dict(wire.stiffnesses), "factor": wire.factor, **truth}
    return {
        "clock": {"offset": scenario.clocks.offset, "drift": scenario.clocks.drift},
        "true_gain": gain,
        "rotation_specimen_to_lab": _to_json(scenario.pose.rotation()),
        "law": asdict(wire),
        **facts,
        "first_loading": _compute_first_loading(wire.law()),
        "markers": markers,
        "mishaps": [asdict(event) for event in take.log],
    }


def _compute_first_loading(law: PlayLaw) -> dict[str, object]:
    """Return the corners of the law for first loading, N m and 1/m."""
    moment = np.concatenate([[0.0], law.half_widths])
    curvature = law.respond(moment, law.make_unbent_history(len(moment))).curvature
    return {"moment": moment.tolist(), "curvature": curvature.tolist()}


def _to_json(value: object) -> object:
    """Convert arrays to lists of numbers with 12 decimals."""
    match value:
        case np.ndarray() | np.floating():
            return np.round(value, 12).tolist()
        case dict():
            return {key: _to_json(entry) for key, entry in value.items()}
        case tuple():
            return [_to_json(entry) for entry in value]
    return value
