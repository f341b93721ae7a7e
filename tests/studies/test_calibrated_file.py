"""Reading back what a calibration wrote."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ProcessingError
from labpipe.records.wire_calibration import PARAMETERS, Calibration
from labpipe.studies.calibrated_file import read_calibrated
from labpipe.studies.calibration_study import Calibrated, as_json
from labpipe.wire.calibration.calibrate_wire import Settings, calibrate
from tests.builders.loading_tests import measured, wire_of


@pytest.fixture(scope="module")
def made() -> Calibration:
    found = calibrate(wire_of("A3"), measured("A3", (0.12,), seed=1), Settings(gain=0.005))
    assert isinstance(found, Calibration)
    return found


@pytest.fixture
def file(made: Calibration, tmp_path: Path) -> Path:
    done = Calibrated(Path("out"), made, (), {}, (), tested_curvature=21.5)
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(as_json(done), allow_nan=False), encoding="utf-8")
    return path


def test_what_was_written_is_read(made: Calibration, file: Path) -> None:
    found = read_calibrated(file)
    assert (found.wire, found.widening, found.tested_curvature) == ("A3", made.widening, 21.5)
    assert len(found.solutions) == len(made.solutions)
    for read, had in zip(found.solutions, made.solutions, strict=True):
        assert np.array_equal(read.values, had.values)
        assert np.array_equal(read.covariance, had.covariance)
        assert (read.rise, read.limit, read.is_allowed) == (had.rise, had.limit, had.is_allowed)
        for name in ("chance", "scatter", "shift", "covariance"):
            assert np.array_equal(getattr(read.mixture, name), getattr(had.mixture, name))
        assert read.mixture.freedom == had.mixture.freedom
    assert found.values() == dict(zip(PARAMETERS, made.solutions[0].values, strict=True))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "JSONDecodeError"),
        ('{"solutions": []}', "no solution"),
        ('{"wire": "A2", "solutions": [{"rise": 0.0}]}', "mixture"),
    ],
)
def test_another_file_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ProcessingError, match=said):
        read_calibrated(path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ProcessingError, match="No such file"):
        read_calibrated(tmp_path / "calibration.json")
