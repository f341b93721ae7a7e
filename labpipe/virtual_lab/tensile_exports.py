"""Put a virtual tensile test on disk: the export, the test sheet, and the truth beside them.

``truth.json`` (SI, see `virtual_lab.tensile_truth`) is for checking; the processing never reads it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from labpipe.store.replace import storing
from labpipe.virtual_lab.exports import started_on, write_sheet_and_truth
from labpipe.virtual_lab.mts_suite import write_test_suite
from labpipe.virtual_lab.r_controller import write_r_controller
from labpipe.virtual_lab.tensile_path import TensilePath
from labpipe.virtual_lab.tensile_record import FrameRecord, record_frame
from labpipe.virtual_lab.tensile_scenario import Program, TensileScenario
from labpipe.virtual_lab.tensile_sheet import write_tensile_sheet
from labpipe.virtual_lab.tensile_truth import TensileTruth, tell_tensile_truth

_DIGITS = 12


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


def observe_tensile(scenario: TensileScenario, seed: int) -> TensileObservation:
    """Run a virtual tensile test without writing files.

    Parameters
    ----------
    scenario : the test
    seed : the same seed gives the same noise; everything else is in the scenario

    Returns
    -------
    The observation.

    Raises
    ------
    ValueError
        If the test is over before two samples have been taken.
    """
    path = TensilePath(scenario)
    record = record_frame(path, np.random.default_rng(seed))
    return TensileObservation(scenario, seed, record, tell_tensile_truth(path, record.time))


def simulate_tensile(scenario: TensileScenario, folder: Path, seed: int) -> Path:
    """Run a virtual tensile test and write its export, test sheet and truth.

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
        If the scenario asks for what is not allowed.
    StoreError
        If the system refuses, such as where a file stands in place of the folder.
    """
    observation = observe_tensile(scenario, seed)
    with storing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        files = _write_export(observation, folder)
        sheet, truth = write_tensile_sheet(scenario, files), tensile_truth_as_json(observation)
        write_sheet_and_truth(folder, sheet, truth)
    return folder


def _write_export(observation: TensileObservation, folder: Path) -> tuple[str, ...]:
    scenario, record, seed = observation.scenario, observation.record, observation.seed
    started = started_on(scenario.date)
    if scenario.export.program is Program.R_CONTROLLER:
        file = f"{scenario.name}.xlsx"
        write_r_controller(folder / file, record, name=scenario.name, started=started, seed=seed)
        return (file,)
    return write_test_suite(
        folder, record, scenario.export, name=scenario.name, started=started, seed=seed
    )


def tensile_truth_as_json(observation: TensileObservation) -> dict[str, object]:
    """Everything true of a virtual tensile test, as ``truth.json`` holds it.

    Parameters
    ----------
    observation : the test

    Returns
    -------
    Numbers, lists and text only: the fields of `TensileTruth`, and the scenario.
    """
    truth = asdict(observation.truth)
    for name in ("time", "displacement", "force"):
        truth[name] = np.round(truth[name], _DIGITS).tolist()
    return {
        "synthetic": True,
        "seed": observation.seed,
        "scenario": asdict(observation.scenario),
        **truth,
    }
