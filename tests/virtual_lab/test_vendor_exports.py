"""Exports have the layouts that ControlDesk, Motive, R-Controller and TestSuite write."""

from __future__ import annotations

import csv
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
from scipy.io import loadmat, whosmat

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.cantilever_path import solve_path
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, LoadCell
from labpipe.virtual_lab.observations import Observation, observe
from labpipe.virtual_lab.recorders import (
    DIRECTION_PATH,
    FREQUENCY_PATH,
    FrameRecord,
    plan_cantilever,
)
from labpipe.virtual_lab.tensile_scenarios import ExportLayout
from labpipe.virtual_lab.vendor_exports import (
    Run,
    write_control_desk,
    write_motive,
    write_r_controller,
    write_test_suite,
)

RUN = Run("A2-085-1", datetime(2026, 3, 4, 10, 5, 0), seed=11)


@pytest.fixture(scope="module")
def file(observation: Observation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mat") / "force.mat"
    write_control_desk(path, observation.force_record, RUN)
    return path


@pytest.fixture(scope="module")
def content(file: Path) -> Any:
    return loadmat(file, struct_as_record=False, squeeze_me=True)["force"]


def test_header_and_container(file: Path) -> None:
    head = file.read_bytes()[:132]
    assert head.startswith(
        b"MATLAB 5.0 MAT-file, Platform: PCWIN, Created on: Wed Mar 04 10:08:43 2026 "
    )
    assert head[124:128] == b"\x00\x01IM"
    assert head[128:132] == b"\x0e\x00\x00\x00"  # not compressed, as in real exports
    assert whosmat(file) == [("force", (1, 1), "struct")]


def test_numbers_are_exact_and_whole_ones_small(content: Any, observation: Observation) -> None:
    record = observation.force_record
    np.testing.assert_array_equal(content.X.Data, record.clock)
    np.testing.assert_array_equal(content.Y[0].Data, record.volts)
    np.testing.assert_array_equal(content.Y[1].Data, record.signals[DIRECTION_PATH])
    np.testing.assert_array_equal(content.Y[2].Data, record.signals[FREQUENCY_PATH])
    kinds = [channel.Data.dtype for channel in content.Y]
    assert kinds == [np.float64, np.uint8, np.uint16]


TAKE_RUN = Run("A2-085-1", datetime(2026, 3, 4, 13, 5, 0), seed=11)


def write(observation: Observation, path: Path, unit: str = "m") -> list[list[str]]:
    write_motive(path, observation.take, TAKE_RUN, unit=unit)
    with path.open(newline="", encoding="ascii") as take_file:
        return list(csv.reader(take_file))


@pytest.fixture(scope="module")
def take_file(observation: Observation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("csv") / "take.csv"
    write(observation, path)
    return path


@pytest.fixture(scope="module")
def rows(take_file: Path) -> list[list[str]]:
    with take_file.open(newline="", encoding="ascii") as opened:
        return list(csv.reader(opened))


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


STARTED = datetime(2026, 3, 9, 10, 5)
BOOK_RUN = Run("CT-10-1", STARTED, seed=9)
TIME: Floats = 0.087 + 0.05 * np.arange(30, dtype=np.float64)
RECORD = FrameRecord(time=TIME, displacement=25.4e-3 * TIME, force=4.4482216152605 * (TIME - 0.2))


@pytest.fixture(scope="module")
def book_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("book") / "CT-10-1.xlsx"
    write_r_controller(path, RECORD, BOOK_RUN)
    return path


def test_rows(book_file: Path) -> None:
    book = openpyxl.load_workbook(book_file)
    assert book.sheetnames == ["Test Data"]
    rows = [list(row) for row in book["Test Data"].iter_rows(values_only=True)]
    note = "SYNTHETIC: made by labpipe's virtual lab, seed 9, not a measurement"
    assert rows[0] == [note, None, None]
    assert rows[1:4] == [
        ["Test", "CT-10-1", None],
        ["Date", "03/09/2026 10:05:00", None],
        [None, None, None],
    ]
    assert rows[4] == ["Time (s)", "Force (lbf)", "Displacement (in)"]
    table = np.array(rows[5:], dtype=np.float64)
    np.testing.assert_allclose(table, np.column_stack([TIME, TIME - 0.2, TIME]), atol=5.1e-7)


SUITE_STARTED = datetime(2026, 3, 9, 13, 5, 7)
SUITE_RUN = Run("tube-1", SUITE_STARTED, seed=8)
SUITE_TIME: Floats = 0.019 + 0.01 * np.arange(40, dtype=np.float64)
SUITE_RECORD = FrameRecord(
    time=SUITE_TIME,
    displacement=5e-3 * SUITE_TIME,
    force=2.7 + 100.0 * SUITE_TIME,
)
PARTS = ExportLayout(in_parts=True, part_at=0.2)


def written(
    folder: Path, layout: ExportLayout, record: FrameRecord = SUITE_RECORD
) -> tuple[str, ...]:
    return write_test_suite(folder, record, layout, SUITE_RUN)


def lines(path: Path) -> list[str]:
    return path.read_bytes().decode("utf-8-sig").split("\r\n")


def numbers(path: Path) -> Floats:
    return np.array([[float(cell) for cell in row.split("\t")] for row in lines(path)[8:-1]])


def test_preamble(tmp_path: Path) -> None:
    (file,) = written(tmp_path, ExportLayout())
    assert file == "DAQ- Crosshead, … - (Timed).txt"
    content = (tmp_path / file).read_bytes()
    assert content.startswith(b"\xef\xbb\xbfFile Path: C:\\")
    assert content.count(b"\n") == content.count(b"\r\n") == 8 + len(SUITE_TIME)
    path, test, run, date, *blank = lines(tmp_path / file)[:6]
    assert path.endswith(f"\\tube-1\\{file}   ")
    assert "SYNTHETIC" in path
    assert test == "Test: SYNTHETIC tensile test, labpipe virtual lab, seed 8"
    assert run == "Test Run: tube-1"
    assert date == "Date: 3/9/2026 1:05:07 PM"
    assert blank == ["", ""]


def test_numbers_are_single_precision_in_si(tmp_path: Path) -> None:
    (file,) = written(tmp_path, ExportLayout())
    crosshead, load, time = numbers(tmp_path / file).T
    assert lines(tmp_path / file)[8].split("\t")[2] == "0.0189999993890524"  # as in real exports
    np.testing.assert_allclose(time, SUITE_TIME.astype(np.float32), rtol=1e-14)
    np.testing.assert_allclose(1e3 * load, SUITE_RECORD.force.astype(np.float32), rtol=1e-14)
    single = SUITE_RECORD.displacement.astype(np.float32).astype(np.float64)
    np.testing.assert_allclose(1e-3 * crosshead, single, rtol=1e-14)
    assert np.abs(time - SUITE_TIME).max() > 1e-10  # not what a double would hold


def test_parts_are_not_numbered_in_order_of_time(tmp_path: Path) -> None:
    files = written(tmp_path, PARTS)
    stem = "DAQ- Crosshead, … - (Timed)"
    assert files == (f"{stem}.txt", f"{stem}1.txt", f"{stem}2.txt")
    later, earlier = numbers(tmp_path / files[0]), numbers(tmp_path / files[1])
    assert earlier[-1, 2] < 0.2 < later[0, 2]
    assert 0.02 < later[0, 2] - earlier[-1, 2] < 0.035
    assert len(earlier) + len(later) == len(SUITE_TIME) - 2
    assert lines(tmp_path / files[1])[0].endswith("(Timed)1.txt   ")


def test_volts_times_true_gain_are_the_tension_and_white_noise(observation: Observation) -> None:
    record, scenario = observation.force_record, observation.scenario
    path, schedule = solve_path(scenario.mechanics), plan_cantilever(scenario)
    tension = path.tension(schedule.progress_at(schedule.force_times))
    noise = (record.volts - scenario.load_cell.offset) * record.true_gain - tension
    assert np.std(noise) == pytest.approx(4e-3, rel=0.01)
    assert abs(np.mean(noise)) < 5e-5
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.01


def test_converter_saturates() -> None:
    scenario = _quick(replace(CantileverScenario(), load_cell=LoadCell(gain=0.05)))
    assert observe(scenario, 1).force_record.volts.max() == 10.0 - 20.0 / 2**16


def _quick(scenario: CantileverScenario) -> CantileverScenario:
    return replace(
        scenario,
        mechanics=replace(scenario.mechanics, cycles=1, steps_per_branch=40),
        clocks=replace(scenario.clocks, rate=50.0),
    )
