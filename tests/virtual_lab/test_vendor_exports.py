"""Exports have the layouts that ControlDesk, Motive, R-Controller and TestSuite write."""

from __future__ import annotations

import csv
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import openpyxl
import pytest
from scipy.io import loadmat, whosmat

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, solve_path
from labpipe.virtual_lab.instruments import FORCE_PATH, ExportLayout, FrameRecord
from labpipe.virtual_lab.lab_files import (
    Observation,
    Run,
    write_control_desk,
    write_frame,
    write_motive,
)

RUN = Run("A2-085-1", datetime(2026, 3, 4, 10, 5, 7), seed=11)


def test_control_desk_is_exact_and_whole_numbers_are_small(
    observation: Observation[CantileverScenario], tmp_path: Path
) -> None:
    record = observation.records["force"]
    (name,) = write_control_desk(tmp_path, record, RUN)
    file = tmp_path / name
    head = file.read_bytes()[:132]
    assert head.startswith(
        b"MATLAB 5.0 MAT-file, Platform: PCWIN, Created on: Wed Mar 04 10:08:50 2026 "
    )
    assert head[124:] == b"\x00\x01IM\x0e\x00\x00\x00"  # not compressed, as in real exports
    assert whosmat(file) == [("force", (1, 1), "struct")]
    content = loadmat(file, struct_as_record=False, squeeze_me=True)["force"]
    np.testing.assert_array_equal(content.X.Data, record.clock_times)
    signals = (record.signals[FORCE_PATH], *list(record.signals.values())[1:])
    for channel, values in zip(content.Y, signals, strict=True):
        np.testing.assert_array_equal(channel.Data, values)
    assert [channel.Data.dtype for channel in content.Y] == [np.float64, np.uint8, np.uint16]


def test_motive_has_six_decimals_and_blanks(
    observation: Observation[CantileverScenario], tmp_path: Path
) -> None:
    write_motive(tmp_path, observation.records["markers"], RUN)
    with (tmp_path / "take.csv").open(newline="", encoding="ascii") as opened:
        data, take = list(csv.reader(opened))[7:], observation.records["markers"]
    assert [row[0] for row in data] == [str(number) for number in range(len(take.time))]
    assert data[3][1] == "0.060000"
    cells = np.array([[float(cell) if cell else np.nan for cell in row] for row in data])
    np.testing.assert_allclose(cells[:, 2:6], take.bodies[0].rotation, atol=5.1e-7)
    np.testing.assert_allclose(cells[:, 6:9], take.bodies[0].position, atol=5.1e-7)
    measured = cells[:, 26:].reshape(len(data), -1, 3)
    np.testing.assert_allclose(measured, take.positions, atol=5.1e-7)
    assert np.isnan(measured).any()
    assert all(len(cell.partition(".")[2]) == 6 for cell in data[0][1:] if cell)


TIME: Floats = 0.019 + 0.01 * np.arange(40, dtype=np.float64)
RECORD = FrameRecord(TIME, displacement=5e-3 * TIME, force=2.7 + 100.0 * TIME)


def test_r_controller_in_pounds_and_inches(tmp_path: Path) -> None:
    (file,) = write_frame(tmp_path, replace(RECORD, layout=ExportLayout("lbf")), RUN)
    book = openpyxl.load_workbook(tmp_path / file)
    assert book.sheetnames == ["Test Data"]
    rows = [list(row) for row in book["Test Data"].iter_rows(values_only=True)]
    note = "SYNTHETIC: made by labpipe's virtual lab, seed 11, not a measurement"
    assert rows[:5] == [
        [note, None, None],
        ["Test", "A2-085-1", None],
        ["Date", "03/04/2026 10:05:07", None],
        [None, None, None],
        ["Time (s)", "Force (lbf)", "Displacement (in)"],
    ]
    expected = np.column_stack([TIME, RECORD.force / 4.4482216152605, RECORD.displacement / 0.0254])
    np.testing.assert_allclose(np.array(rows[5:], dtype=np.float64), expected, atol=5.1e-7)


def lines(path: Path) -> list[str]:
    return path.read_bytes().decode("utf-8-sig").split("\r\n")


def numbers(path: Path) -> Floats:
    return np.array([[float(cell) for cell in row.split("\t")] for row in lines(path)[8:-1]])


def test_test_suite_is_in_single_precision_of_si(tmp_path: Path) -> None:
    (name,) = write_frame(tmp_path, RECORD, RUN)
    assert name == "DAQ- Crosshead, … - (Timed).txt"
    content = (tmp_path / name).read_bytes()
    assert content.startswith(b"\xef\xbb\xbfFile Path: C:\\")
    assert content.count(b"\n") == content.count(b"\r\n") == 8 + len(TIME)
    path, *head = lines(tmp_path / name)[:6]
    assert path.endswith(f"\\A2-085-1\\{name}   ")
    assert "SYNTHETIC" in path
    assert head == [
        "Test: SYNTHETIC tensile test, labpipe virtual lab, seed 11", "Test Run: A2-085-1",
        "Date: 3/4/2026 10:05:07 AM", "", "",
    ]  # fmt: skip
    assert lines(tmp_path / name)[8].split("\t")[2] == "0.0189999993890524"  # as in real exports
    columns = numbers(tmp_path / name).T * np.array([[1e-3], [1e3], [1.0]])
    records = (RECORD.displacement, RECORD.force, TIME)
    for column, values in zip(columns, records, strict=True):
        single = values.astype(np.float32).astype(np.float64)
        np.testing.assert_allclose(column, single, rtol=1e-14)


def test_parts_are_not_numbered_in_order_of_time(tmp_path: Path) -> None:
    files = write_frame(tmp_path, replace(RECORD, layout=ExportLayout(part_at=0.2)), RUN)
    stem = "DAQ- Crosshead, … - (Timed)"
    assert files == (f"{stem}.txt", f"{stem}1.txt", f"{stem}2.txt")
    later, earlier = numbers(tmp_path / files[0]), numbers(tmp_path / files[1])
    assert earlier[-1, 2] < 0.2 < later[0, 2]
    assert 0.02 < later[0, 2] - earlier[-1, 2] < 0.035
    assert len(earlier) + len(later) == len(TIME) - 2
    assert lines(tmp_path / files[1])[0].endswith("(Timed)1.txt   ")


def test_volts_times_true_gain_are_the_tension_and_white_noise(
    observation: Observation[CantileverScenario],
) -> None:
    record, scenario = observation.records["force"], observation.scenario
    path, schedule = solve_path(scenario.mechanics), scenario.plan_schedule()
    tension = path.compute_tension(schedule.compute_progress(schedule.force_times))
    noise = (record.signals[FORCE_PATH] - scenario.load_cell.offset) * record.true_gain - tension
    assert np.std(noise) == pytest.approx(4e-3, rel=0.01)
    assert abs(np.mean(noise)) < 5e-5
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.01
