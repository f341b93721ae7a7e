"""A virtual test on disk: all four files, the truth complete, the same again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import StoreError
from labpipe.virtual_lab.observations import Observation, write_exports


@pytest.fixture(scope="module")
def folder(observation: Observation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_exports(observation, tmp_path_factory.mktemp("raw") / "A2-085-1")


def test_files(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    assert names == {"force.mat", "take.csv", "test.yaml", "truth.json"}


def test_truth(folder: Path, observation: Observation) -> None:
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    assert truth["synthetic"] is True
    assert truth["seed"] == 11
    assert truth["clock"] == {"offset": 1.37, "drift": 40e-6}
    assert truth["true_gain"] == observation.force_record.true_gain
    for name in ("time", "travel", "deflection", "force"):
        wanted = getattr(observation.truth, name)
        np.testing.assert_allclose(truth[name], wanted, rtol=0, atol=1e-11)
    turn = np.array(truth["rotation_specimen_to_lab"])
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-10)
    assert [cycle["cycle"] for cycle in truth["cycles"]] == [1, 2]
    assert truth["cycles"][0]["peak_force"] == observation.truth.cycles[0].peak_force
    assert {event["kind"] for event in truth["mishaps"]} == {"gap", "switch", "unlabelled"}
    assert [marker["label"] for marker in truth["markers"]] == list(observation.take.labels)
    assert truth["law"]["stick_stiffness"] == 5e-3
    assert truth["wire"] is None
    law = truth["first_loading"]
    assert (law["moment"][0], law["curvature"][0]) == (0.0, 0.0)
    assert np.interp(1e-3, law["moment"], law["curvature"]) == pytest.approx(1e-3 / 5e-3)
    assert len(truth["shapes"][0]["x"]) == 41


def test_again_is_the_same_to_the_byte(
    folder: Path, observation: Observation, tmp_path: Path
) -> None:
    again = write_exports(observation, tmp_path / "again")
    for path in folder.iterdir():
        assert (again / path.name).read_bytes() == path.read_bytes()


def test_a_file_in_place_of_the_folder(observation: Observation, tmp_path: Path) -> None:
    (tmp_path / "raw").write_text("mine")
    for folder in (tmp_path / "raw", tmp_path / "raw" / "A2-085-1"):
        with pytest.raises(StoreError, match=r"a folder to write in, found a file in its place"):
            write_exports(observation, folder)
