"""Run a virtual test of any kind, in memory or onto disk: exports, test sheet, and the truth.

``truth.json`` (SI; frames, signs and clocks as `virtual_lab.truth` says) is for checking; the
processing never reads it.
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
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, MechanicalTest, VirtualWire
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
from labpipe.virtual_lab.tensile_scenarios import ExportLayout, Program, TensileScenario
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
    write_motive,
    write_r_controller,
    write_test_suite,
)

SHEET_FILE, TRUTH_FILE = "test.yaml", "truth.json"
_DIGITS = 12

S = TypeVar("S", CantileverScenario, ConduitScenario)
T = TypeVar("T", CantileverTruth, ConduitTruth)


@dataclass(frozen=True, slots=True, eq=False)
class BendingObservation(Generic[S, T]):
    """One virtual bending test: what the instruments recorded, and what really happened.

    Parameters
    ----------
    scenario, seed : what it was made from
    force_record, take : of force recorder and cameras
    truth : what really happened
    frame_record : of the load frame, in three-point bending; None where it was not kept
    """

    scenario: S
    seed: int
    force_record: ForceRecord
    take: Take
    truth: T
    frame_record: FrameRecord | None = None

    @property
    def force(self) -> Recording:
        """The force recording as a reader would give it: volts, no unit known."""
        return self.force_record.recording()

    @property
    def markers(self) -> Recording:
        """The motion-capture recording as a reader would give it."""
        return self.take.recording()

    @property
    def frame(self) -> Recording | None:
        """The load frame's recording as a reader would give it, in SI; None without one."""
        return None if self.frame_record is None else self.frame_record.recording()


Observation: TypeAlias = BendingObservation[CantileverScenario, CantileverTruth]
"""A virtual test in the cantilever rig."""
ConduitObservation: TypeAlias = BendingObservation[ConduitScenario, ConduitTruth]
"""A virtual test in three-point bending."""


@dataclass(frozen=True, slots=True, eq=False)
class TensileObservation:
    """One virtual tensile test: what the load frame recorded, and what really happened.

    Parameters
    ----------
    scenario, seed : what it was made from
    record : what the export is written from
    truth : what really happened
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
    seed : the same seed gives the same noise, gain and mishaps; mechanics do not depend on it

    Returns
    -------
    The observation. Tests that share their mechanics share one solution, so that only the first
    takes seconds.

    Raises
    ------
    ValueError
        If the mechanics have no solution, a mishap names no marker, or a tensile test is over
        before two samples have been taken.
    """
    match scenario:
        case CantileverScenario():
            return _observe_cantilever(scenario, seed)
        case ConduitScenario():
            return _observe_conduit(scenario, seed)
        case TensileScenario():
            path = TensilePath(scenario)
            record = record_frame(path, np.random.default_rng(seed))
            return TensileObservation(scenario, seed, record, evaluate_tensile(path, record.time))


def _observe_cantilever(scenario: CantileverScenario, seed: int) -> Observation:
    path, schedule = solve_path(scenario.mechanics), plan_cantilever(scenario)
    force, marker = _generators(seed, 2)
    return BendingObservation(
        scenario=scenario,
        seed=seed,
        force_record=record_cantilever_force(path, scenario, schedule, force),
        take=film_cantilever(path, scenario, schedule, marker),
        truth=evaluate_cantilever(path, schedule),
    )


def _observe_conduit(scenario: ConduitScenario, seed: int) -> ConduitObservation:
    path, schedule = solve_three_point(scenario.test), plan_conduit(scenario)
    force, travel, marker = _generators(seed, 3)
    is_kept = scenario.has_frame_export
    return BendingObservation(
        scenario=scenario,
        seed=seed,
        force_record=record_conduit_force(path, scenario, schedule, force),
        take=film_conduit(path, scenario, schedule, marker),
        truth=evaluate_conduit(path, scenario, schedule),
        frame_record=record_crosshead(path, scenario, schedule, travel) if is_kept else None,
    )


def _generators(seed: int, number: int) -> list[np.random.Generator]:
    """One for each instrument."""
    return [np.random.default_rng(each) for each in np.random.SeedSequence(seed).spawn(number)]


def simulate_test(scenario: Scenario, folder: Path, seed: int) -> Path:
    """Run a virtual test and write its exports, test sheet and truth.

    Parameters
    ----------
    scenario : the test
    folder : of this test; made if it is not there; files of the same names are replaced
    seed : the same seed gives the same files, byte by byte

    Returns
    -------
    The folder.

    Raises
    ------
    ValueError
        If the scenario has no solution or asks for what is not allowed.
    StoreError
        If the system refuses, such as where a file stands in place of the folder.
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
    """Write what the programs export; the names of the files by role."""
    scenario = observation.scenario
    started = datetime.fromisoformat(f"{scenario.date}T10:05:00")
    run = Run(scenario.name, started, observation.seed)
    if isinstance(observation, TensileObservation):
        return {"frame": _write_frame(observation, folder, run)}
    (force,), (markers,) = RECORDER_FILES.values()
    write_control_desk(folder / force, observation.force_record, run)
    write_motive(folder / markers, observation.take, run, unit=observation.scenario.length_unit)
    record = observation.frame_record
    if record is None:
        return RECORDER_FILES
    layout, kind = ExportLayout(force_unit="N"), "three-point bending test"
    frame = write_test_suite(folder, record, layout, run, kind=kind)
    return {**RECORDER_FILES, "frame": frame}


def _write_frame(observation: TensileObservation, folder: Path, run: Run) -> tuple[str, ...]:
    layout = observation.scenario.export
    if layout.program is Program.TEST_SUITE:
        return write_test_suite(folder, observation.record, layout, run)
    file = f"{run.name}.xlsx"
    write_r_controller(folder / file, observation.record, run)
    return (file,)


def truth_as_json(observation: AnyObservation) -> dict[str, object]:
    """Everything true of a virtual test, as ``truth.json`` holds it.

    Parameters
    ----------
    observation : the test

    Returns
    -------
    Numbers, lists and text only: the scenario, the fields of the test's truth, and of bending tests
    the law of the specimen, the true gain and the markers.
    """
    facts: dict[str, object] = {"synthetic": True, "seed": observation.seed}
    facts["scenario"] = asdict(observation.scenario)
    if not isinstance(observation, TensileObservation):
        facts |= _bending_facts(observation)
    return facts | {key: _plain(value) for key, value in asdict(observation.truth).items()}


def _bending_facts(observation: Observation | ConduitObservation) -> dict[str, object]:
    take, scenario = observation.take, observation.scenario
    gain = observation.force_record.true_gain
    markers = [
        {"label": label, "arc_length": _plain(arc_length)}
        for label, arc_length in zip(take.labels, take.arc_lengths, strict=True)
    ]
    if isinstance(scenario, ConduitScenario):
        stiffnesses = dict(scenario.bundle.stiffnesses)
        return {"stiffnesses": stiffnesses, "true_gain": gain, "markers": markers}
    wire = scenario.mechanics.wire
    return {
        "clock": {"offset": scenario.clocks.offset, "drift": scenario.clocks.drift},
        "true_gain": gain,
        "rotation_specimen_to_lab": _plain(scenario.pose.rotation()),
        "law": asdict(wire),
        "wire": _wire_facts(wire),
        "bundle": _bundle_facts(scenario.mechanics),
        "first_loading": _first_loading(wire.law()),
        "markers": markers,
        "mishaps": [asdict(event) for event in take.log],
    }


def _wire_facts(wire: VirtualWire) -> dict[str, float] | None:
    """What a calibration looks for, where the wire is one of strands."""
    if not isinstance(wire, StrandedWire):
        return None
    return {**wire.parameters, "sample_factor": wire.factor}


def _bundle_facts(test: MechanicalTest) -> dict[str, object] | None:
    """What is true of a bundle and of its curve, where the wire is one."""
    if not isinstance(test.wire, BundleModel):
        return None
    truth = asdict(evaluate_taped(solve_path(test)))
    return {"stiffnesses": dict(test.wire.stiffnesses), "factor": test.wire.factor, **truth}


def _first_loading(law: MomentLaw) -> dict[str, object]:
    """Corners of the law of first loading, from zero and straight in between, N m and 1/m."""
    moment = np.concatenate([[0.0], law.half_widths])
    curvature = respond(law, moment, unbent_plays(law, len(moment))).curvature
    return {"moment": moment.tolist(), "curvature": curvature.tolist()}


def _plain(value: object) -> object:
    """Arrays as lists, to a millionth of a micrometre or of a micronewton."""
    match value:
        case np.ndarray() | np.floating():
            return np.round(value, _DIGITS).tolist()
        case dict():
            return {key: _plain(each) for key, each in value.items()}
        case tuple():
            return [_plain(each) for each in value]
    return value
