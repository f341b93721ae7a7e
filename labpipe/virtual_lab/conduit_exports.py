"""Put a virtual conduit bundle on disk: the exports, the test sheet, and the truth beside them.

``truth.json`` (`virtual_lab.conduit_truth`, SI) is for checking; the processing never reads it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from labpipe.records.recording import Channel, Clock, Recording
from labpipe.store.replace import storing
from labpipe.virtual_lab.cameras import Take
from labpipe.virtual_lab.conduit_bundle import ConduitScenario
from labpipe.virtual_lab.conduit_record import film, plan_conduit, record_force, record_travel
from labpipe.virtual_lab.conduit_sheet import write_conduit_sheet
from labpipe.virtual_lab.conduit_truth import ConduitTruth, tell_conduit_truth
from labpipe.virtual_lab.exports import started_on, write_recorders, write_sheet_and_truth
from labpipe.virtual_lab.load_cell import TriggeredRecord
from labpipe.virtual_lab.mts_suite import write_test_suite
from labpipe.virtual_lab.sheet import FORCE_FILE, MARKER_FILE
from labpipe.virtual_lab.tensile_record import FrameRecord
from labpipe.virtual_lab.tensile_scenario import ExportLayout
from labpipe.virtual_lab.three_point import solve_three_point

_DIGITS = 12


@dataclass(frozen=True, slots=True, eq=False)
class ConduitObservation:
    """One virtual three-point test: what the instruments recorded, and what really happened.

    Parameters
    ----------
    scenario, seed : what it was made from
    force_record, take : of force recorder and cameras
    frame_record : of the load frame; None where it was not kept
    truth : what really happened
    """

    scenario: ConduitScenario
    seed: int
    force_record: TriggeredRecord
    take: Take
    frame_record: FrameRecord | None
    truth: ConduitTruth

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
        record = self.frame_record
        if record is None:
            return None
        channels = (
            Channel("Crosshead", "Crosshead", record.displacement, unit="m", unit_in_file="mm"),
            Channel("Load", "Load", record.force, unit="N", unit_in_file="N"),
        )
        return Recording("load-frame", clocks=(Clock("time", record.time),), channels=channels)


def observe_conduit(scenario: ConduitScenario, seed: int) -> ConduitObservation:
    """Run a virtual three-point test without writing files.

    Parameters
    ----------
    scenario : the test
    seed : the same seed gives the same noise and gain; everything else is in the scenario

    Returns
    -------
    The observation. Samples of one type share one solution: only the first takes a second.

    Raises
    ------
    ValueError
        If the mechanics have no solution.
    """
    path, schedule = solve_three_point(scenario.test), plan_conduit(scenario)
    seeds = np.random.SeedSequence(seed).spawn(3)
    force, travel, marker = (np.random.default_rng(each) for each in seeds)
    return ConduitObservation(
        scenario=scenario,
        seed=seed,
        force_record=record_force(path, scenario, schedule, force),
        take=film(path, scenario, schedule, marker),
        frame_record=record_travel(path, scenario, schedule, travel)
        if scenario.has_frame_export
        else None,
        truth=tell_conduit_truth(path, scenario, schedule),
    )


def simulate_conduit(scenario: ConduitScenario, folder: Path, seed: int) -> Path:
    """Run a virtual three-point test and write its exports, test sheet and truth.

    Parameters
    ----------
    scenario : the test
    folder : of this test; made if it is not there; files of the same names are replaced
    seed : the same seed gives the same files

    Returns
    -------
    The folder.

    Raises
    ------
    ValueError
        If the mechanics have no solution.
    StoreError
        If the system refuses, such as where a file stands in place of the folder.
    """
    observation = observe_conduit(scenario, seed)
    with storing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        files = _write_exports(observation, folder)
        sheet, truth = write_conduit_sheet(scenario, files), conduit_truth_as_json(observation)
        write_sheet_and_truth(folder, sheet, truth)
    return folder


def _write_exports(observation: ConduitObservation, folder: Path) -> dict[str, str]:
    """Write what the programs export; the names of the files by role."""
    scenario, seed = observation.scenario, observation.seed
    started = started_on(scenario.date)
    write_recorders(
        folder,
        observation.force_record,
        observation.take,
        name=scenario.name,
        started=started,
        unit=scenario.length_unit,
        seed=seed,
    )
    files = {"force": FORCE_FILE, "markers": MARKER_FILE}
    if observation.frame_record is None:
        return files
    (file,) = write_test_suite(
        folder,
        observation.frame_record,
        ExportLayout(force_unit="N"),
        name=scenario.name,
        started=started,
        seed=seed,
        kind="three-point bending test",
    )
    return files | {"frame": file}


def conduit_truth_as_json(observation: ConduitObservation) -> dict[str, object]:
    """Everything true of a virtual three-point test, as ``truth.json`` holds it.

    Parameters
    ----------
    observation : the test

    Returns
    -------
    Numbers, lists and text only: the fields of `ConduitTruth`, the stiffnesses of the bundle, the
    true gain, the markers, and the scenario.
    """
    truth = asdict(observation.truth)
    for name, values in truth.items():
        if isinstance(values, np.ndarray):
            truth[name] = np.round(values, _DIGITS).tolist()
    take, scenario = observation.take, observation.scenario
    return {
        "synthetic": True,
        "seed": observation.seed,
        "scenario": asdict(scenario),
        "stiffnesses": dict(scenario.bundle.stiffnesses),
        "true_gain": observation.force_record.true_gain,
        "markers": [
            {"label": label, "arc_length": round(float(where), _DIGITS)}
            for label, where in zip(take.labels, take.arc_lengths, strict=True)
        ],
        **truth,
    }
