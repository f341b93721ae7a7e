"""Run a virtual test of any kind, in memory or on disk: exports, test sheet and truth.

``truth.json`` (SI; frames, signs and clocks of `virtual_lab.truth`) is for checking; the processing
never reads it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Generic, TypeAlias, TypeVar, overload

import numpy as np

from labpipe.law.plays import MomentLaw, respond, unbent_plays
from labpipe.records.recording import Recording
from labpipe.store.replace import storing
from labpipe.virtual_lab.bundles import BundleModel
from labpipe.virtual_lab.cameras import Take, film_cantilever, film_conduit
from labpipe.virtual_lab.cantilever_path import solve_path
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario
from labpipe.virtual_lab.conduit_scenarios import ConduitScenario
from labpipe.virtual_lab.curve_truth import evaluate_taped
from labpipe.virtual_lab.recorders import (
    ForceRecord,
    FrameRecord,
    plan_cantilever,
    plan_conduit,
    record_cantilever_force,
    record_conduit_force,
    record_crosshead,
    record_frame,
)
from labpipe.virtual_lab.sheet_texts import RECORDER_FILES, Scenario, write_sheet
from labpipe.virtual_lab.specimens import StrandedWire
from labpipe.virtual_lab.tensile_path import TensilePath
from labpipe.virtual_lab.tensile_scenarios import ExportLayout, TensileScenario
from labpipe.virtual_lab.three_point_path import solve_three_point
from labpipe.virtual_lab.truth import (
    CantileverTruth,
    ConduitTruth,
    TensileTruth,
    evaluate_cantilever,
    evaluate_conduit,
    evaluate_tensile,
)
from labpipe.virtual_lab.vendor_exports import (
    Run,
    write_control_desk,
    write_frame,
    write_motive,
)

SHEET_FILE, TRUTH_FILE = "test.yaml", "truth.json"

S = TypeVar("S", CantileverScenario, ConduitScenario)
T = TypeVar("T", CantileverTruth, ConduitTruth)


@dataclass(frozen=True, slots=True, eq=False)
class BendingObservation(Generic[S, T]):
    """One virtual bending test: records of the instruments, and the truth.

    Parameters
    ----------
    scenario, seed : inputs
    force_record, take : of force recorder and cameras
    truth : true values
    frame_record : of the load frame, in three-point bending, if available
    """

    scenario: S
    seed: int
    force_record: ForceRecord
    take: Take
    truth: T
    frame_record: FrameRecord | None = None

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
    """One virtual tensile test: record of the load frame, and the truth.

    Parameters
    ----------
    scenario, seed : inputs
    record : source of the export
    truth : true values
    """

    scenario: TensileScenario
    seed: int
    record: FrameRecord
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
    The observation. Tests with equal mechanics share one solution: only the first takes seconds.

    Raises
    ------
    ValueError
        If the mechanics have no solution, a mishap names no marker, or a tensile test ends before
        its second sample.
    """
    match scenario:
        case CantileverScenario():
            wire, plan = solve_path(scenario.mechanics), plan_cantilever(scenario)
            force, marker = _generators(seed, 2)
            return BendingObservation(
                scenario,
                seed,
                record_cantilever_force(wire, scenario, plan, force),
                film_cantilever(wire, scenario, plan, marker),
                evaluate_cantilever(wire, plan),
            )
        case ConduitScenario():
            bundle, plan = solve_three_point(scenario.test), plan_conduit(scenario)
            force, travel, marker = _generators(seed, 3)
            is_kept = scenario.has_frame_export
            return BendingObservation(
                scenario,
                seed,
                record_conduit_force(bundle, scenario, plan, force),
                film_conduit(bundle, scenario, plan, marker),
                evaluate_conduit(bundle, scenario, plan),
                record_crosshead(bundle, scenario, plan, travel) if is_kept else None,
            )
        case TensileScenario():
            path = TensilePath(scenario)
            record = record_frame(path, np.random.default_rng(seed))
            return TensileObservation(scenario, seed, record, evaluate_tensile(path, record.time))


def _generators(seed: int, number: int) -> list[np.random.Generator]:
    """Return an independent generator per instrument."""
    return [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(number)]


def simulate_test(scenario: Scenario, folder: Path, seed: int) -> Path:
    """Run a virtual test and write its exports, test sheet and truth.

    Parameters
    ----------
    scenario : the test
    folder : of this test; made if needed; files of the same names are replaced
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
        return {"frame": write_frame(folder, observation.record, observation.scenario.export, run)}
    (force,), (markers,) = RECORDER_FILES.values()
    write_control_desk(folder / force, observation.force_record, run)
    write_motive(folder / markers, observation.take, run, unit=observation.scenario.length_unit)
    if observation.frame_record is None:
        return RECORDER_FILES
    layout, test_type = ExportLayout(force_unit="N"), "three-point bending test"
    frame = write_frame(folder, observation.frame_record, layout, run, test_type=test_type)
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
        facts |= _bending_facts(observation)
    return facts | {key: _to_json(value) for key, value in asdict(observation.truth).items()}


def _bending_facts(observation: Observation | ConduitObservation) -> dict[str, object]:
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
        "first_loading": _first_loading(wire.law()),
        "markers": markers,
        "mishaps": [asdict(event) for event in take.log],
    }


def _first_loading(law: MomentLaw) -> dict[str, object]:
    """Return the corners of the law of first loading from zero, N m and 1/m."""
    moment = np.concatenate([[0.0], law.half_widths])
    curvature = respond(law, moment, unbent_plays(law, len(moment))).curvature
    return {"moment": moment.tolist(), "curvature": curvature.tolist()}


def _to_json(value: object) -> object:
    """Convert arrays to lists with 12 decimals."""
    match value:
        case np.ndarray() | np.floating():
            return np.round(value, 12).tolist()
        case dict():
            return {key: _to_json(entry) for key, entry in value.items()}
        case tuple():
            return [_to_json(entry) for entry in value]
    return value
