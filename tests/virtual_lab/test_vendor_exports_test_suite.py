"""The text exports have the layout that TestSuite writes, byte by byte where it matters."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.recorders import FrameRecord
from labpipe.virtual_lab.tensile_scenarios import ExportLayout
from labpipe.virtual_lab.vendor_exports import Run, write_test_suite

STARTED = datetime(2026, 3, 9, 13, 5, 7)
RUN = Run("tube-1", STARTED, seed=8)
TIME: Floats = 0.019 + 0.01 * np.arange(40, dtype=np.float64)
RECORD = FrameRecord(time=TIME, displacement=5e-3 * TIME, force=2.7 + 100.0 * TIME)
PARTS = ExportLayout(in_parts=True, part_at=0.2)


def written(folder: Path, layout: ExportLayout, record: FrameRecord = RECORD) -> tuple[str, ...]:
    return write_test_suite(folder, record, layout, RUN)


def lines(path: Path) -> list[str]:
    return path.read_bytes().decode("utf-8-sig").split("\r\n")


def numbers(path: Path) -> Floats:
    return np.array([[float(cell) for cell in row.split("\t")] for row in lines(path)[8:-1]])


def test_preamble(tmp_path: Path) -> None:
    (file,) = written(tmp_path, ExportLayout())
    assert file == "DAQ- Crosshead, … - (Timed).txt"
    content = (tmp_path / file).read_bytes()
    assert content.startswith(b"\xef\xbb\xbfFile Path: C:\\")
    assert content.count(b"\n") == content.count(b"\r\n") == 8 + len(TIME)
    path, test, run, date, *blank = lines(tmp_path / file)[:6]
    assert path.endswith(f"\\tube-1\\{file}   ")
    assert "SYNTHETIC" in path
    assert test == "Test: SYNTHETIC tensile test, labpipe virtual lab, seed 8"
    assert run == "Test Run: tube-1"
    assert date == "Date: 3/9/2026 1:05:07 PM"
    assert blank == ["", ""]


@pytest.mark.parametrize(("hour", "told"), [(0, "12:05:07 AM"), (12, "12:05:07 PM")])
def test_clock_of_twelve_hours(tmp_path: Path, hour: int, told: str) -> None:
    when = STARTED.replace(hour=hour)
    (file,) = write_test_suite(tmp_path, RECORD, ExportLayout(), replace(RUN, started=when))
    assert lines(tmp_path / file)[3].endswith(told)


@pytest.mark.parametrize("unit", ["kN", "N"])
def test_names_and_units(tmp_path: Path, unit: str) -> None:
    (file,) = written(tmp_path, ExportLayout(force_unit=unit))
    assert lines(tmp_path / file)[6:8] == ["Crosshead \tLoad \tTime ", f"mm\t{unit}\tsec"]


def test_numbers_are_single_precision_in_si(tmp_path: Path) -> None:
    (file,) = written(tmp_path, ExportLayout())
    crosshead, load, time = numbers(tmp_path / file).T
    assert lines(tmp_path / file)[8].split("\t")[2] == "0.0189999993890524"  # as in real exports
    np.testing.assert_allclose(time, TIME.astype(np.float32), rtol=1e-14)
    np.testing.assert_allclose(1e3 * load, RECORD.force.astype(np.float32), rtol=1e-14)
    single = RECORD.displacement.astype(np.float32).astype(np.float64)
    np.testing.assert_allclose(1e-3 * crosshead, single, rtol=1e-14)
    assert np.abs(time - TIME).max() > 1e-10  # not what a double would hold


def test_small_and_negative_numbers(tmp_path: Path) -> None:
    ends = np.array([0.1, 0.2])
    record = FrameRecord(ends, np.array([-1e-8, -0.0]), np.array([-1e-2, 0.0]))
    (file,) = written(tmp_path, ExportLayout(), record)
    first, second = (row.split("\t") for row in lines(tmp_path / file)[8:10])
    assert first[:2] == ["-9.99999993922529E-06", "-9.99999977648258E-06"]
    assert second[:2] == ["0", "0"]


def test_parts_are_not_numbered_in_order_of_time(tmp_path: Path) -> None:
    files = written(tmp_path, PARTS)
    stem = "DAQ- Crosshead, … - (Timed)"
    assert files == (f"{stem}.txt", f"{stem}1.txt", f"{stem}2.txt")
    later, earlier = numbers(tmp_path / files[0]), numbers(tmp_path / files[1])
    assert earlier[-1, 2] < 0.2 < later[0, 2]
    assert 0.02 < later[0, 2] - earlier[-1, 2] < 0.035
    assert len(earlier) + len(later) == len(TIME) - 2
    assert lines(tmp_path / files[1])[0].endswith("(Timed)1.txt   ")


def test_part_without_samples_is_a_mark_alone(tmp_path: Path) -> None:
    assert (tmp_path / written(tmp_path, PARTS)[2]).read_bytes() == b"\xef\xbb\xbf"


def test_part_outside_the_record(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"part_at=9\.0 s: outside the record"):
        written(tmp_path, replace(PARTS, part_at=9.0))
    assert not list(tmp_path.iterdir())


def test_unknown_unit(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="force_unit='lbf': allowed are N, kN"):
        written(tmp_path, ExportLayout(force_unit="lbf"))
