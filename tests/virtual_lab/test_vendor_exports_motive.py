"""The CSV export has the layout that Motive writes."""

from __future__ import annotations

import csv
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario
from labpipe.virtual_lab.observations import Observation, observe
from labpipe.virtual_lab.vendor_exports import Run, write_motive

RUN = Run("A2-085-1", datetime(2026, 3, 4, 13, 5, 0), seed=11)


def write(observation: Observation, path: Path, unit: str = "m") -> list[list[str]]:
    write_motive(path, observation.take, RUN, unit=unit)
    with path.open(newline="", encoding="ascii") as file:
        return list(csv.reader(file))


@pytest.fixture(scope="module")
def file(observation: Observation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("csv") / "take.csv"
    write(observation, path)
    return path


@pytest.fixture(scope="module")
def rows(file: Path) -> list[list[str]]:
    with file.open(newline="", encoding="ascii") as opened:
        return list(csv.reader(opened))


def test_first_line(rows: list[list[str]], observation: Observation) -> None:
    keys = dict(zip(rows[0][::2], rows[0][1::2], strict=True))
    frames = str(len(observation.take.time))
    assert keys == {
        "Format Version": "1.23",
        "Take Name": "A2-085-1",
        "Take Notes": "synthetic: made by labpipe's virtual lab with seed 11",
        "Capture Frame Rate": "50.000000",
        "Export Frame Rate": "50.000000",
        "Capture Start Time": "2026-03-04 01.05.00.000 PM",
        "Total Frames in Take": frames,
        "Total Exported Frames": frames,
        "Rotation Type": "Quaternion",
        "Length Units": "Meters",
        "Coordinate Space": "Global",
    }


def test_header_rows(file: Path, rows: list[list[str]]) -> None:
    assert file.read_bytes().split(b"\r\n")[1] == b""
    kinds, names, ids, quantities, axes = rows[2:7]
    assert [row[1] for row in rows[2:6]] == ["Type", "Name", "ID", ""]
    assert kinds[2:10] == ["Rigid Body"] * 8
    assert axes[:10] == ["Frame", "Time (Seconds)", *"XYZW", *"XYZ", ""]
    assert quantities[2:10] == [*["Rotation"] * 4, *["Position"] * 3, "Mean Marker Error"]
    assert kinds[10:26] == ["Rigid Body Marker"] * 16
    assert quantities[10:14] == [*["Position"] * 3, "Marker Quality"]
    assert set(kinds[26:]) == {"Marker"}
    assert names[10] == names[26] == "Clamp:Marker1"
    assert names[-1] == "Unlabeled 1234"
    assert ids[2] == ids[10]
    assert ids[26] != ids[10]
    assert len(ids[2]) == 32
    assert len({len(row) for row in rows[2:]}) == 1


def test_quoting_as_in_real_exports(file: Path) -> None:
    lines = file.read_text(encoding="ascii").splitlines()
    assert ',"Clamp:Marker1",' in lines[3]
    assert ",Clamp:Marker1," in lines[3]
    assert lines[4].startswith(',ID,"')


def test_numbers_six_decimals_and_blanks(rows: list[list[str]], observation: Observation) -> None:
    data, take = rows[7:], observation.take
    assert [row[0] for row in data[:3]] == ["0", "1", "2"]
    assert data[-1][0] == str(len(take.time) - 1)
    assert data[3][1] == "0.060000"
    assert not any("nan" in cell for row in data for cell in row)
    cells = np.array([[float(cell) if cell else np.nan for cell in row] for row in data])
    np.testing.assert_allclose(cells[:, 2:6], take.body.rotation, atol=5.1e-7)
    np.testing.assert_allclose(cells[:, 6:9], take.body.position, atol=5.1e-7)
    measured = cells[:, 26:].reshape(len(data), -1, 3)
    np.testing.assert_allclose(measured, take.positions, atol=5.1e-7)
    assert np.isnan(measured).any()
    assert all(len(cell.partition(".")[2]) == 6 for cell in data[0][1:] if cell)


@pytest.mark.parametrize(
    ("unit", "word", "factor"), [("mm", "Millimeters", 1000.0), ("cm", "Centimeters", 100.0)]
)
def test_other_units(
    observation: Observation, tmp_path: Path, unit: str, word: str, factor: float
) -> None:
    rows = write(observation, tmp_path / "take.csv", unit)
    assert word in rows[0]
    body = [float(cell) for cell in rows[7][6:9]]
    np.testing.assert_allclose(body, observation.take.body.position[0] * factor, atol=1e-6)
    assert float(rows[7][9]) == pytest.approx(observation.take.body.error[0] * factor, abs=1e-6)
    assert 0.9 < float(rows[7][13]) <= 1.0  # a quality has no unit


def test_120_frames_per_second(scenario: CantileverScenario, tmp_path: Path) -> None:
    fast = replace(
        scenario,
        mechanics=replace(scenario.mechanics, cycles=1, steps_per_branch=40),
        clocks=replace(scenario.clocks, fps=120.0, rate=50.0),
    )
    rows = write(observe(fast, 1), tmp_path / "take.csv")
    assert rows[0][7] == "120.000000"
    assert [row[1] for row in rows[7:10]] == ["0.000000", "0.008333", "0.016667"]


def test_unknown_unit_is_refused(observation: Observation, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="unit='inch': allowed are m, cm, mm"):
        write(observation, tmp_path / "take.csv", "inch")
    assert not (tmp_path / "take.csv").exists()
