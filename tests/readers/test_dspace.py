"""Recordings of ControlDesk: MAT, csv and MF4."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.io import loadmat, savemat
from scipy.sparse import csc_array

from labpipe.errors import ReadError
from labpipe.readers import controldesk, dspace_csv, dspace_mat, dspace_mf4, read_export
from labpipe.readers.controldesk import (
    Export,
    Trace,
    load_export,
    parse_save_date,
    resolve_date,
)
from labpipe.readers.dspace_mat import parse_mat5
from labpipe.records.recording import Recording
from tests.approved import Approve
from tests.builders.controldesk import (
    Axis,
    Signal,
    write_csv,
    write_mat_v5,
    write_mat_v73,
    write_mf4,
)
from tests.store.test_read import WAYS, move_elsewhere

TIME = np.arange(200) * 0.001


FORCE = Signal("Model Root/Load Cell", "In1", np.sin(TIME), unit="V")
LASER = Signal("Model Root/Laser Sensor\\n", "In1", np.cos(TIME))
MF4 = [
    Signal("Model Root/Load Cell", "In1", np.sin(TIME), invalid=np.isin(TIME, TIME[[1, 4]])),
    Signal("Model Root/Laser", "In1", np.cos(TIME), unit="mm"),
]
WRITERS = [write_mat_v5, write_mat_v73]


def write_csv_of_lines(path: Path, axis: Axis, signals: Sequence[Signal]) -> Path:
    return write_csv(path, axis, signals, line_end="\n")


def by_path(recording: Recording) -> dict[str, Any]:
    return {channel.path: channel for channel in recording.channels}


@pytest.mark.parametrize("write", [*WRITERS, write_csv_of_lines, write_csv])
@settings(max_examples=12)
@given(
    data=hnp.arrays(
        np.float64,
        st.tuples(st.integers(2, 30), st.integers(1, 4)),
        elements=st.one_of(st.floats(-1e9, 1e9), st.just(np.nan)),
    )
)
def test_what_was_written_is_read(tmp_path_factory: Any, write: Any, data: np.ndarray) -> None:
    time = np.arange(len(data)) * 0.5
    signals = [Signal(f"Root/{i}", "In1", column) for i, column in enumerate(data.T)]
    axes = [Axis(time)] if write in WRITERS else Axis(time)
    recording = read_export(write(tmp_path_factory.mktemp("any") / "recording.x", axes, signals))
    np.testing.assert_array_equal(recording.get_clock("HostService").time, time)
    np.testing.assert_array_equal([c.values for c in recording.channels], data.T)
    assert [c.path for c in recording.channels] == [f"Root/{i}/In1" for i in range(data.shape[1])]


def test_an_mf4_that_was_written_is_read(tmp_path: Path) -> None:
    recording = dspace_mf4.read(write_mf4(tmp_path / "r.mf4", Axis(1.25 + TIME), MF4))
    assert [(c.path, c.name, c.unit_in_file) for c in recording.channels] == [
        ("Model Root/Load Cell/In1", "In1", ""),
        ("Model Root/Laser/In1", "In1", "mm"),
    ]
    np.testing.assert_array_equal(recording.clocks[0].time, 1.25 + TIME)
    for channel, signal in zip(recording.channels, MF4, strict=True):
        expected = np.where(np.asarray(signal.invalid, dtype=bool), np.nan, signal.values)
        np.testing.assert_array_equal(channel.values, expected)
    assert (recording.program, recording.program_version) == ("ControlDesk", "7.4")
    assert recording.metadata["mdf"] == "4.10"


def edit_mf4(path: Path, **edits: Any) -> Path:
    """Write an MF4 whose channels have changed attributes: flags, sync_type or unit."""
    import asammdf

    flags = edits.pop("flags", 0)
    with asammdf.MDF(write_mf4(path, Axis(TIME), MF4)) as file:
        channels: Any = file.groups[0].channels
        master, force, laser = channels
        master.pos_invalidation_bit, master.flags = force.pos_invalidation_bit, flags
        laser.flags |= edits.pop("laser_flags", 0)
        for name, value in edits.items():
            setattr(master, name, value)
        return Path(file.save(path.with_stem("edited"), overwrite=True))


def test_times_and_channels_of_an_mf4(tmp_path: Path) -> None:
    """Invalid times end the reading; a unit is converted; a channel may be invalid as a whole."""
    invalid = "clock time: expected time that .*, found 2 time stamps are not .*, .* sample 2"
    for edits, message in (
        ({"flags": 2}, invalid),
        ({"sync_type": 2}, "expected a unit of time such as s, found 'no time'"),
        ({"unit": "deg"}, "expected a unit of time such as s, found 'deg'"),
    ):
        with pytest.raises(ReadError, match=message):
            read_export(edit_mf4(tmp_path / "a.mf4", **edits))
    recording = read_export(edit_mf4(tmp_path / "a.mf4", unit="ms", laser_flags=1))
    np.testing.assert_allclose(recording.clocks[0].time, 1e-3 * TIME)
    force, laser = recording.channels
    assert np.isnan(force.values).sum() == 2
    assert np.isnan(laser.values).all()


@pytest.mark.parametrize("write", [*WRITERS, write_csv])
def test_a_clock_in_milliseconds(tmp_path: Path, write: Any) -> None:
    axis = Axis(TIME, unit="ms")
    file = write(tmp_path / "a.x", [axis] if write in WRITERS else axis, [FORCE])
    if write is write_csv:
        file.write_bytes(re.sub(b"trace_size,.*", b"trace_size", file.read_bytes()))
    np.testing.assert_allclose(read_export(file).clocks[0].time, 1e-3 * TIME)


@pytest.mark.parametrize("write", WRITERS)
def test_what_it_says_of_itself(tmp_path: Path, write: Any) -> None:
    recording = dspace_mat.read(write(tmp_path / "other.mat", [Axis(TIME)], [FORCE, LASER]))
    assert (recording.reader, recording.program) == ("dspace-mat", "ControlDesk")
    assert recording.program_version == "7.4"
    assert recording.metadata["variable"] == "recording"
    assert recording.metadata["revision"] == "2.1"
    force = by_path(recording)["Model Root/Load Cell/In1"]
    assert (force.name, force.unit, force.unit_in_file) == ("In1", None, "V")
    about: Any = recording.metadata["channels"]
    assert about["Model Root/Laser Sensor\\n/In1"]["Min"] == "-inf"
    assert {note.code for note in recording.notes} == {
        *("names_not_unique", "units_not_stated"),
    }


@pytest.mark.parametrize("write", WRITERS)
def test_several_rasters_are_several_clocks(tmp_path: Path, write: Any) -> None:
    slow = Axis(np.array([0.5, 2.0, 9.0]), "OnChange")
    gain = Signal("Tunable Parameters", "gain", np.array([1.0, 2.0, 3.0]), axis=2)
    file = write(tmp_path / "recording.mat", [Axis(TIME), slow], [FORCE, gain])
    recording = dspace_mat.read(file)
    assert by_path(recording)["Tunable Parameters/gain"].clock == "OnChange"
    np.testing.assert_array_equal(recording.get_clock("OnChange").time, slow.time)
    alone = dspace_mat.read(file, channels=["gain"])
    assert [clock.name for clock in alone.clocks] == ["OnChange"]


def test_revision_2_0_keeps_quoted_paths_and_small_integers(tmp_path: Path) -> None:
    pulse = Signal("", '"Model Root"/"u1"/"Out1"', np.array([0, 5, 0], dtype=np.uint8))
    axis = Axis(np.array([-1.0, -0.5, 0.0]))
    recording = dspace_mat.read(
        write_mat_v5(tmp_path / "recording.mat", [axis], [pulse], revision="2.0")
    )
    (channel,) = recording.channels
    assert (channel.name, channel.path) == ("Out1", '"Model Root"/"u1"/"Out1"')
    assert channel.values.dtype == np.float64
    assert channel.values[0] - 1 == -1.0
    assert recording.clocks[0].name == "time"
    assert recording.metadata["revision"] == "2.0"
    file = write_mat_v5(tmp_path / "recording.mat", [Axis(TIME)], [FORCE], revision="2.7")
    messages = [n.message for n in dspace_mat.read(file).notes if n.code == "revision_unseen"]
    assert messages == ["file format revision 2.7: only 2.0 and 2.1 are known"]


def test_rows_of_a_csv_that_are_cut_off(tmp_path: Path) -> None:
    short = replace(FORCE, values=FORCE.values[:50])
    file = write_csv(tmp_path / "r.csv", Axis(TIME[:50]), [short], stated=80)
    messages = notes(dspace_csv.read(file))
    assert messages["rows_differ"] == "the header states 80 rows, the file has 50"
    file.write_bytes(file.read_bytes()[:-9])
    recording = dspace_csv.read(file)
    assert len(recording.clocks[0].time) == 49
    assert "truncated" in notes(recording)


FIVE = np.arange(5.0)


def trace(path: str, values: np.ndarray, *, clock: int = 0, unit: str = "") -> Trace:
    return Trace(path.rsplit("/", 1)[-1], path, unit, clock, lambda: values, {})


def load(*traces: Trace, axes: int = 1) -> Recording:
    export = Export(
        [controldesk.Axis("", "", lambda: FIVE)] * axes, traces, "ControlDesk version: 5.2", {}
    )
    return load_export(export, reader="dspace-mat", path=Path("force.mat"), channels=None)


def notes(recording: Recording) -> dict[str, str]:
    return {note.code: note.message for note in recording.notes}


def test_one_signal_on_two_rasters_keeps_two_paths() -> None:
    recording = load(trace("A/In1", FIVE), trace("A/In1", FIVE, clock=1), axes=2)
    assert [channel.path for channel in recording.channels] == ["A/In1 [1]", "A/In1 [2]"]
    assert [channel.clock for channel in recording.channels] == ["time [1]", "time [2]"]


def test_numbers_that_are_none() -> None:
    values = np.array([1.0, np.inf, np.nan, 4.0, -np.inf])
    recording = load(trace("A/B", values))
    np.testing.assert_array_equal(recording.channels[0].values, [1, np.nan, np.nan, 4, np.nan])
    assert notes(recording)["not_finite"] == (
        "3 of 5 samples are not finite numbers, the first at sample 2"
    )
    assert np.isinf(values).sum() == 2  # the export's own array is left alone


def test_notes_on_names_and_units() -> None:
    texts = notes(load(trace("A\\n/In1", FIVE), trace("B/In1", FIVE)))
    assert texts["names_not_unique"] == (
        "of 2 channels 2 are called 'In1': distinguish them by path"
    )
    assert (
        texts["units_not_stated"] == "no unit is stated for any channel; the protocol must state it"
    )
    assert notes(load(trace("A/In1", FIVE, unit="V"))) == {}


@pytest.mark.parametrize(
    ("text", "near", "iso"),
    [
        ("10/31/2015 17:42:35", date(2015, 10, 31), "2015-10-31"),
        ("4-5-2023 17:30:33", date(2023, 5, 4), "2023-05-04"),
        ("2021/01/03 15:54:55", date(2021, 1, 3), "2021-01-03"),
        ("5/1/2026 9:35:51 PM", date(2026, 5, 1), "2026-05-01"),
        ("12/01/2026 11:00:26 a. m.", date(2026, 1, 12), "2026-01-12"),
        ("12/01/2026 11:00:26 a. m.", date(2026, 6, 1), ""),
        ("12/01/2026", None, ""),
        ("yesterday", date(2026, 6, 1), ""),
        ("99/99/2026", date(2026, 6, 1), ""),
        ("1/1/99999999999999999999", date(2026, 6, 1), ""),
        (f"1/{'9' * 5000}/2026", date(2026, 6, 1), ""),
    ],
)
def test_the_day_of_saving_settles_the_order(text: str, near: date | None, iso: str) -> None:
    assert resolve_date(text, near) == iso


DAYS = {
    "Thu May 04": date(2023, 5, 4),
    "Fri May  5": date(2023, 5, 5),
    **dict.fromkeys(("Fri May 45", "Don Mai 04", f"Thu May {'9' * 5000}")),
}


def test_the_day_in_a_mat_header() -> None:
    header = "MATLAB 5.0 MAT-file, Platform: PCWIN, Created on: {} 17:31:15 2023"
    assert {day: parse_save_date(header.format(day)) for day in DAYS} == DAYS
    assert parse_save_date("") is None


def written(variables: dict[str, Any], *, compress: bool = False) -> bytes:
    stream: Any = io.BytesIO()
    savemat(stream, variables, do_compression=compress)
    content: bytes = stream.getvalue()
    return content


@given(
    array=hnp.arrays(
        st.sampled_from(["f8", "f4", "i4", "i2", "i1", "u1", "u2", "u4", "i8", "u8"]),
        st.tuples(st.integers(0, 5), st.integers(0, 5)),
        elements={"allow_nan": False},
    ),
    compress=st.booleans(),
)
def test_numbers_are_those_of_scipy(array: np.ndarray, compress: bool) -> None:
    content = written({"a": array}, compress=compress)
    numbers = parse_mat5(content)["a"]
    stream: Any = io.BytesIO(content)
    expected = loadmat(stream)["a"]
    np.testing.assert_array_equal(numbers, expected.ravel(order="F"))


@pytest.mark.parametrize("compress", [False, True])
def test_structs_struct_arrays_and_cells(compress: bool) -> None:
    pair = np.empty((1, 2), dtype=[("Name", object), ("Data", object)])
    pair[0, 0], pair[0, 1] = ("one", 1.0), ("two", np.arange(3))
    cells = np.empty((1, 2), dtype=object)
    cells[0, 0], cells[0, 1] = "text", 7.0
    variables = {"s": {"inner": {"x": 5}, "pair": pair, "cells": cells}, "t": "second"}
    mat = parse_mat5(written(variables, compress=compress))
    (outer,) = mat["s"]
    assert outer["inner"][0]["x"].tolist() == [5]
    assert [item["Name"] for item in outer["pair"]] == ["one", "two"]
    assert outer["pair"][1]["Data"].tolist() == [0, 1, 2]
    assert outer["cells"][0] == "text"
    assert mat["t"] == "second"
    mat = parse_mat5(written({"z": np.array([1j]), "s": csc_array(np.eye(3)), "a": 1.0}))
    assert (mat["z"], mat["s"], mat["a"].tolist()) == (None, None, [1.0])  # no use for them


def test_big_endian_files() -> None:
    name, values = b"a", np.array([1.5, -2.0], dtype=">f8").tobytes()
    flags = np.array([6, 8, 6, 0], dtype=">u4").tobytes()
    dims = np.array([5, 8, 1, 2], dtype=">u4").tobytes()
    label = np.array([1, 1], dtype=">u4").tobytes() + name.ljust(8, b"\0")
    data = np.array([9, 16], dtype=">u4").tobytes() + values
    body = flags + dims + label + data
    element = np.array([14, len(body)], dtype=">u4").tobytes() + body
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"
    assert parse_mat5(header + element)["a"].tolist() == [1.5, -2.0]


STRUCTS = written({"a": np.arange(100.0), "s": {"b": np.arange(3.0), "c": "text"}})
DAMAGED = [
    STRUCTS[:128] + np.array([14, 10**6], dtype="<i4").tobytes() + STRUCTS[136:],
    STRUCTS[:-4],
    STRUCTS[:136] + (99).to_bytes(4, "little") + STRUCTS[140:],
    STRUCTS[:160] + (7).to_bytes(4, "little") + STRUCTS[164:],
    written({"s": {"b": 1.0}}).replace(b"\1\0\0\0\1\0\0\0", b"\1\0\0\0\0\0\0\x40", 1),
]
"""The last one claims a thousand million structs."""


def test_damaged_mat_is_told(approved: Approve) -> None:
    messages = []
    for content in DAMAGED:
        with pytest.raises(ValueError) as refused:  # noqa: PT011  the text is approved
            parse_mat5(content)
        messages.append(refused.value)
    approved(messages)


def refusal(read: Callable[..., object], *given: object) -> str:
    with pytest.raises(ReadError) as refused:
        read(*given)
    return str(refused.value)


ONE = {"X": {"Data": TIME}, "Y": {"Data": TIME}}
STRANGE: list[dict[str, Any]] = [{"a": ONE, "b": ONE}, {"a": ONE | {"Y": {"Name": "F"}}}]
STRANGE_SIGNALS = [Signal("Root", "F", TIME, axis=3), Signal("Root", "F", np.array(["a"]))]
CSV = b"descriptions,General,User,x\n"
SPOILED: list[Callable[[bytes], bytes]] = [
    lambda content: content.replace(b"trace_units,", b"trace_units,m", 1),
    lambda content: content.replace(b"\n,0.001,", b"\n,", 1),
    lambda content: content[: content.find(b"trace_values") - 4],
    lambda content: CSV + content[content.find(b"trace_values") :],
    lambda content: content.replace(b",0.001,", b",O.001,", 1),
]
MF4_DAMAGE = [
    (b"\x18\0\0\0", b"\x18\0\0\x7f", b"##CG"),  # a record of 24 bytes, or of 2 GB
    (b"\x08\0\0\0\x40\0\0\0", b"\x08\0\0\x0f\x40\0\0\0", b"##CN"),  # a byte offset
    (b"Model Root/Laser", 16 * b"\0", b"MDF"),  # a channel without a name
    (b"MDF     ", b"MDF    \0", b""),  # no MDF file
]
"""Bytes, others in their first place, and the mark behind which they stand."""


def test_recordings_that_are_refused(
    tmp_path: Path, approved: Approve, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    """A MAT by its structs, a csv by its lines, samples elsewhere or nowhere, a damaged MF4."""
    mat, csv, mf4 = (tmp_path / f"recording.{suffix}" for suffix in ("mat", "csv", "mf4"))
    messages = []
    for variables in STRANGE:
        savemat(mat, variables)
        messages.append(refusal(dspace_mat.read, mat))
    for signal in STRANGE_SIGNALS:
        messages.append(refusal(dspace_mat.read, write_mat_v5(mat, [Axis(TIME)], [signal])))
    write_mat_v5(mat, [Axis(TIME)], [FORCE], revision="3.0")
    messages.append(refusal(dspace_mat.read, mat))
    whole = write_csv(csv, Axis(TIME), [FORCE]).read_bytes()
    for spoil in SPOILED:
        csv.write_bytes(spoil(whole))
        messages.append(refusal(dspace_csv.read, csv))
    for how in WAYS:
        with h5py.File(write_mat_v73(mat, [Axis(TIME)], [FORCE, LASER]), "r+") as opened:
            move_elsewhere(opened["recording/X"], "Data", how)
        size = str(mat.stat().st_size)
        messages.append(refusal(dspace_mat.read, mat).replace(size, "SIZE"))
    messages.append(refusal(load, trace("A/B", np.zeros(3))))
    content = write_mf4(mf4, Axis(TIME), MF4).read_bytes()
    for old, new, behind in MF4_DAMAGE:
        at = content.index(old, content.index(behind))
        mf4.write_bytes(content[:at] + new + content[at + len(old) :])
        message = refusal(dspace_mf4.read, mf4)
        assert " object at " not in message
        messages.append(message.partition(" (")[0])
    assert capfd.readouterr() == ("", "")
    monkeypatch.setitem(sys.modules, "asammdf", None)
    approved([*messages, refusal(dspace_mf4.read, mf4)])
