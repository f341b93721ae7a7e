from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from labpipe.errors import ReadError
from labpipe.readers import dspace_csv
from tests.builders.controldesk import Axis, Signal, write_csv

TIME = np.arange(50) * 0.001
FORCE = Signal("Model Root/Load Cell", "Out1", np.sin(TIME))
MOTION = Signal("Model Root/Laser", "Out1", np.cos(TIME), unit="mm")


@given(
    data=hnp.arrays(
        np.float64,
        st.tuples(st.integers(1, 30), st.integers(1, 4)),
        elements=st.one_of(st.floats(-1e9, 1e9), st.just(np.nan)),
    ),
    line_end=st.sampled_from(["\n", "\r\n"]),
)
def test_what_was_written_is_read(tmp_path_factory: Any, data: np.ndarray, line_end: str) -> None:
    file = tmp_path_factory.mktemp("csv") / "r.csv"
    time = np.arange(len(data)) * 0.5
    signals = [Signal(f"Root/{i}", "In1", column) for i, column in enumerate(data.T)]
    recording = dspace_csv.read(write_csv(file, Axis(time), signals, line_end=line_end))
    np.testing.assert_array_equal(recording.clock("HostService").time, time)
    np.testing.assert_allclose([c.values for c in recording.channels], data.T, rtol=1e-15)


def test_what_it_says_of_itself(tmp_path: Path) -> None:
    recording = dspace_csv.read(write_csv(tmp_path / "r.csv", Axis(TIME), [FORCE, MOTION]))
    assert (recording.reader, recording.program_version) == ("dspace-csv", "7.4")
    assert recording.metadata["date"] == "2026-04-03"
    assert [c.path for c in recording.channels] == [
        "Model Root/Load Cell/Out1",
        "Model Root/Laser/Out1",
    ]
    assert [c.unit_in_file for c in recording.channels] == ["", "mm"]
    assert [note.code for note in recording.notes] == ["units_not_stated", "names_not_unique"]


def test_channels_are_chosen_by_path_in_any_order(tmp_path: Path) -> None:
    file = write_csv(tmp_path / "r.csv", Axis(TIME), [MOTION, FORCE])
    (channel,) = dspace_csv.read(file, channels=["Model Root/Load Cell/Out1"]).channels
    np.testing.assert_allclose(channel.values, FORCE.values, rtol=1e-15)


def test_infinity_is_noted(tmp_path: Path) -> None:
    values = FORCE.values.copy()
    values[[3, 4]] = [np.inf, -np.inf]
    file = write_csv(tmp_path / "r.csv", Axis(TIME), [Signal("Root", "F", values)])
    (note,) = (n for n in dspace_csv.read(file).notes if n.code == "not_finite")
    assert "(2 of them infinite), the first at sample 4" in note.message


def test_a_wrong_stated_number_of_rows(tmp_path: Path) -> None:
    file = write_csv(tmp_path / "r.csv", Axis(TIME), [FORCE], stated=80)
    (note,) = (n for n in dspace_csv.read(file).notes if n.code == "rows_differ")
    assert note.message == "the header states 80 rows, the file holds 50"


def test_a_cut_in_the_header(tmp_path: Path) -> None:
    file = write_csv(tmp_path / "r.csv", Axis(TIME), [FORCE])
    content = file.read_bytes()
    file.write_bytes(content[: content.find(b"trace_values") - 4])
    with pytest.raises(ReadError, match=r"line 12: expected a line that begins with trace_values"):
        dspace_csv.read(file)
    file.write_bytes(b"descriptions,General,User,x\n" + content[content.find(b"trace_values") :])
    with pytest.raises(ReadError, match=r"lines 1 to 1: expected a row trace_names with one cell"):
        dspace_csv.read(file)


def test_a_cut_in_mid_line(tmp_path: Path) -> None:
    file = write_csv(tmp_path / "r.csv", Axis(TIME), [FORCE])
    file.write_bytes(file.read_bytes()[:-9])
    recording = dspace_csv.read(file)
    assert len(recording.clocks[0].time) == 49
    assert {"truncated", "rows_differ"} <= {note.code for note in recording.notes}


def test_a_cell_that_is_no_number(tmp_path: Path) -> None:
    file = write_csv(tmp_path / "r.csv", Axis(TIME), [FORCE])
    file.write_bytes(file.read_bytes().replace(b",0.001,", b",O.001,", 1))
    with pytest.raises(ReadError, match=r"line 14, column 'time': expected a number .* found 'O"):
        dspace_csv.read(file)
