"""Exports of a three-point test, read back by labpipe's own readers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.readers import dspace_mat
from labpipe.readers import motive_takes as motive_csv
from labpipe.virtual_lab.conduit_scenarios import ConduitClocks, conduit_scenario
from labpipe.virtual_lab.observations import (
    ConduitObservation,
    observe,
    simulate_test,
    truth_as_json,
)

SCENARIO = replace(conduit_scenario("CWB-1"), clocks=ConduitClocks(rate=50.0, fps=10.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_test(SCENARIO, tmp_path_factory.mktemp("raw") / SCENARIO.name, seed=5)


@pytest.fixture(scope="module")
def observation() -> ConduitObservation:
    return observe(SCENARIO, 5)


def test_force_comes_back(folder: Path, observation: ConduitObservation) -> None:
    recording = dspace_mat.read(folder / "force.mat")
    volts = next(c for c in recording.channels if c.path == "Model Root/Load Cell/Out1")
    np.testing.assert_array_equal(volts.values, observation.force_record.volts)
    gain = observation.force_record.true_gain
    force = gain * (volts.values - SCENARIO.load_cell.offset)
    assert np.max(force) == pytest.approx(observation.truth.peak_force, abs=0.05)


def test_markers_come_back(folder: Path, observation: ConduitObservation) -> None:
    tracks = motive_csv.read(folder / "take.csv").markers
    assert tracks is not None
    assert tracks.bodies == ()
    assert tracks.names == observation.take.names
    np.testing.assert_allclose(tracks.positions, observation.take.positions, atol=6e-7)
    seen = observation.markers.markers
    assert seen is not None
    np.testing.assert_array_equal(tracks.positions, seen.positions)


def test_travel_comes_back(folder: Path, observation: ConduitObservation) -> None:
    (file,) = folder.glob("*Timed*.txt")
    text = file.read_text(encoding="utf-8-sig")
    assert "SYNTHETIC three-point bending test" in text
    rows = np.array([[float(n) for n in line.split("\t")] for line in text.splitlines()[8:]])
    frame = observation.frame_record
    assert frame is not None
    np.testing.assert_allclose(1e-3 * rows[:, 0], frame.displacement, atol=1e-8)
    np.testing.assert_allclose(rows[:, 2], frame.time, rtol=1e-6)
    assert observation.frame is not None
    # A last digit that depends on the processor is not recorded.
    values = observation.frame.channels[0].values
    np.testing.assert_array_equal(values, values.astype(np.float32))
    np.testing.assert_allclose(1e-3 * rows[:, 0], values, rtol=1e-14)


def test_truth_on_disk(folder: Path, observation: ConduitObservation) -> None:
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    assert truth["synthetic"] is True
    assert truth == json.loads(json.dumps(truth_as_json(observation)))
    assert truth["loading"]["kink"]["displacement"] > 0.0
    assert len(truth["markers"]) == 22


def test_without_the_frames_export(tmp_path: Path) -> None:
    scenario = replace(SCENARIO, has_frame_export=False)
    folder = simulate_test(scenario, tmp_path / "test", seed=5)
    assert sorted(file.name for file in folder.iterdir()) == [
        "force.mat",
        "take.csv",
        "test.yaml",
        "truth.json",
    ]
    assert "frame" not in (folder / "test.yaml").read_text(encoding="utf-8")
    assert observe(scenario, 5).frame is None


def test_seeds_repeat(folder: Path, tmp_path: Path) -> None:
    again = simulate_test(SCENARIO, tmp_path / SCENARIO.name, seed=5)
    for file in folder.iterdir():
        assert (again / file.name).read_bytes() == file.read_bytes()
    mine, other = (observe(SCENARIO, seed).force_record.volts for seed in (5, 6))
    assert not np.array_equal(mine, other)
