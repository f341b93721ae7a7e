from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe.process.inspection import format_inspection, inspect_export, make_inspection_record
from tests.approved import Approve
from tests.builders.controldesk import Axis, Signal, write_mat_v5
from tests.builders.motive import Layout, marker, rigid_body, write_table

TIME = np.delete(np.arange(500) * 0.001, [200, 201, 202])


FORCE = np.linspace(-2.0, 3.0, len(TIME))


def facts(path: Path) -> dict[str, Any]:
    record = make_inspection_record(inspect_export(path))
    parsed: dict[str, Any] = json.loads(json.dumps(record, allow_nan=False))
    assert parsed == record  # nothing that JSON would change on its way
    return parsed


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    force = FORCE.copy()
    force[[0, 7]] = np.nan
    signals = [
        Signal("Model Root/Load Cell", "Out1", force),
        Signal("Model Root/Laser", "Out1", 2.0 * FORCE, unit="mm"),
        Signal("Model Root/Clock", "Out1", FORCE, unit="blinks"),
    ]
    return write_mat_v5(tmp_path / "recording.mat", [Axis(TIME)], signals)


@pytest.fixture
def take(tmp_path: Path) -> Path:
    frames = 50
    track = np.random.default_rng(1).normal(size=(frames, 3)).round(6)
    tip, clamp = track.copy(), track.copy()
    tip[[3, 4, 9]] = np.nan
    clamp[20:40] = clamp[20]
    columns = [
        *rigid_body("Clamp", clamp, np.ones((frames, 4)), error=np.ones(frames)),
        *marker("Tip", tip),
    ]
    return write_table(tmp_path / "synthetic.csv", columns, frames, Layout())


def test_a_time_axis_that_runs_backwards_can_be_inspected(tmp_path: Path) -> None:
    time = np.array([0.0, 1.0, 0.5, 2.0])
    signal = Signal("Root", "F", np.full(4, np.nan))
    record = facts(write_mat_v5(tmp_path / "recording.mat", [Axis(time)], [signal]))
    assert "error" in {note["severity"] for note in record["notes"]}
    (channel,) = record["streams"][0]["channels"]
    assert (channel["min"], channel["max"], channel["missing"]) == (None, None, 4)


def test_pages(recording: Path, take: Path, tmp_path: Path, approved: Approve) -> None:
    empty = write_table(tmp_path / "empty.csv", [], 4, Layout())
    pages = [format_inspection(inspect_export(path)) for path in (recording, take, empty)]
    pages += [json.dumps(facts(path), indent=1) for path in (recording, take)]
    pages = [re.sub(r"Created on: [^\"]*", "Created on: TODAY", page) for page in pages]
    approved(page.replace(f"{tmp_path}{os.sep}", "") for page in pages)
