"""Put a virtual test on disk: the vendors' exports, the test sheet, and the truth beside them.

``truth.json`` (frames and signs of `virtual_lab.scenario`, SI, marker clock; arrays at the camera
frames) is for checking; the processing never reads it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.store.replace import storing
from labpipe.virtual_lab.bundle_truth import tell_taped
from labpipe.virtual_lab.bundles import BundleModel
from labpipe.virtual_lab.cameras import Take
from labpipe.virtual_lab.control_desk import write_control_desk
from labpipe.virtual_lab.instruments import Observation
from labpipe.virtual_lab.load_cell import ForceRecord, TriggeredRecord
from labpipe.virtual_lab.mechanics import solve_path
from labpipe.virtual_lab.motive import write_motive
from labpipe.virtual_lab.scenario import MechanicalTest, VirtualWire
from labpipe.virtual_lab.sheet import FORCE_FILE, MARKER_FILE, write_sheet
from labpipe.virtual_lab.stranded import StrandedWire
from labpipe.wire.laws import MomentLaw, respond, virgin_plays

SHEET_FILE, TRUTH_FILE = "test.yaml", "truth.json"
_DIGITS = 12


def write_exports(observation: Observation, folder: Path) -> Path:
    """Write all files of a virtual test.

    Parameters
    ----------
    observation : the test
    folder : made if it is not there; files of the same names are replaced

    Returns
    -------
    The folder.

    Raises
    ------
    StoreError
        If the system refuses, such as where a file stands in place of the folder.
    """
    with storing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        _write(observation, folder)
    return folder


def _write(observation: Observation, folder: Path) -> None:
    scenario = observation.scenario
    write_recorders(
        folder,
        observation.force_record,
        observation.take,
        name=scenario.name,
        started=started_on(scenario.date),
        unit=scenario.length_unit,
        seed=observation.seed,
    )
    write_sheet_and_truth(folder, write_sheet(scenario), truth_as_json(observation))


def started_on(date: str) -> datetime:
    """When a test of a day was started: every virtual test is, at five past ten."""
    return datetime.fromisoformat(f"{date}T10:05:00")


def write_recorders(
    folder: Path,
    record: ForceRecord | TriggeredRecord,
    take: Take,
    *,
    name: str,
    started: datetime,
    unit: str,
    seed: int,
) -> None:
    """Write what the programs of force recorder and cameras export.

    Parameters
    ----------
    folder : of the test, which is there
    record, take : of force recorder and cameras
    name : of the take
    started : when both were
    unit : of the exported lengths: m, cm or mm
    seed : for the notes that the files are synthetic
    """
    saved = started + timedelta(seconds=round(float(record.clock[-1])))
    write_control_desk(folder / FORCE_FILE, record, saved=saved, seed=seed)
    write_motive(folder / MARKER_FILE, take, unit=unit, started=started, take_name=name, seed=seed)


def write_sheet_and_truth(folder: Path, sheet: str, truth: Mapping[str, object]) -> None:
    """Write the test sheet and the truth of a test.

    Parameters
    ----------
    folder : of the test, which is there
    sheet : text of ``test.yaml``
    truth : numbers, lists and text only
    """
    (folder / SHEET_FILE).write_text(sheet, encoding="utf-8")
    (folder / TRUTH_FILE).write_text(json.dumps(truth) + "\n", encoding="utf-8")


def truth_as_json(observation: Observation) -> dict[str, object]:
    """Everything true of a virtual test, as ``truth.json`` holds it.

    Parameters
    ----------
    observation : the test

    Returns
    -------
    Numbers, lists and text only.
    """
    scenario, take, truth = observation.scenario, observation.take, observation.truth
    return {
        "synthetic": True,
        "seed": observation.seed,
        "scenario": asdict(scenario),
        "clock": {"offset": scenario.clocks.offset, "drift": scenario.clocks.drift},
        "true_gain": observation.force_record.true_gain,
        "rotation_specimen_to_lab": _rounded(scenario.pose.rotation()),
        "law": asdict(scenario.mechanics.wire),
        "wire": _wire(scenario.mechanics.wire),
        "bundle": _bundle(scenario.mechanics),
        "first_loading": _first_loading(scenario.mechanics.wire.law()),
        "markers": [
            {"label": label, "arc_length": _rounded(arc_length)}
            for label, arc_length in zip(take.labels, take.arc_lengths, strict=True)
        ],
        "mishaps": [asdict(event) for event in take.log],
        "cycles": [asdict(cycle) for cycle in truth.cycles],
        "time": _rounded(truth.time),
        "travel": _rounded(truth.travel),
        "deflection": _rounded(truth.deflection),
        "force": _rounded(truth.force),
        "shapes": [
            {
                "frame": shape.frame,
                "arc_length": _rounded(shape.arc_length),
                "x": _rounded(shape.x),
                "y": _rounded(shape.y),
            }
            for shape in truth.shapes
        ],
    }


def _wire(wire: VirtualWire) -> dict[str, float] | None:
    """What a calibration looks for, where the wire is one of strands."""
    if not isinstance(wire, StrandedWire):
        return None
    return {**wire.parameters, "sample_factor": wire.factor}


def _bundle(test: MechanicalTest) -> dict[str, object] | None:
    """What is true of a bundle and of its curve, where the wire is one."""
    if not isinstance(test.wire, BundleModel):
        return None
    truth = asdict(tell_taped(solve_path(test)))
    return {"stiffnesses": dict(test.wire.stiffnesses), "factor": test.wire.factor, **truth}


def _first_loading(law: MomentLaw) -> dict[str, object]:
    """Corners of the law of first loading, from zero and straight in between, N m and 1/m."""
    moment = np.concatenate([[0.0], law.half_widths])
    curvature = respond(law, moment, virgin_plays(law, len(moment))).curvature
    return {"moment": moment.tolist(), "curvature": curvature.tolist()}


def _rounded(values: Floats | float) -> object:
    """As lists, to a millionth of a micrometre or of a micronewton."""
    return np.round(values, _DIGITS).tolist()
