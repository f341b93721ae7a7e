"""Every real export is inspected right: rows, columns, units, ends, extremes, gaps.

The numbers are those of ``real_load_frames.txt`` and ``real_takes.txt``, of the README of the real
exports, and of the files themselves. None of them was taken from the output of a reader.
"""

from __future__ import annotations

import json
import shutil
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from labpipe.process.inspection import format_inspection, inspect_export, make_inspection_record
from labpipe.process.reading import read_inputs
from labpipe.protocol.load import load_test_sheet, resolve_protocol

pytestmark = pytest.mark.realdata
FOLDERS = (
    *("mts", "lloyd_nexygen", "instron", "zwick", "walter_bai"),
    *("shimadzu", "hbm_catman", "deben", "ta_dma"),
)
# What the unit in a file is worth in SI. Inspection may leave a unit of no mechanical quantity as
# it is written (unit None, numbers as in the file), but never one of those that a test is about.
SI = {
    "mm": ("m", 1e-3),
    "µm": ("m", 1e-6),
    "in": ("m", 0.0254),
    "N": ("N", 1.0),
    "kN": ("N", 1e3),
    "mN": ("N", 1e-3),
    "lbf": ("N", 4.4482216152605),
    "MPa": ("Pa", 1e6),
    "kN·mm": ("N m", 1.0),
    "Nm": ("N m", 1.0),
    "Nmm": ("N m", 1e-3),
    "V": ("V", 1.0),
    "sec": ("s", 1.0),
    "ms": ("s", 1e-3),
}
UNIT_OF_THE_PROGRAM = {"Elongation", "Force", "Position", "Samplerate"}
"""Channels of a Microtest export: it has no row of units, the program's are known."""
PARTED = """\
test: T1
protocol: tensile
specimen: {{type: doubly-compressed, spool: "1", sample: "1"}}
files: {{frame: {0}}}
"""
PARTS = "mts/MTS_data/I0-0.9-dc/Test Run 4 10-23-2023 6 43 09 PM"
MICROTEST = "deben/NANOCEL_KW.CHAL_450PPM_15.MTR"


class Signal(NamedTuple):
    """One channel as the file has it; None for a blank."""

    name: str
    unit: str
    first: float | None
    last: float | None
    least: float | None
    most: float | None
    missing: int


class Stream(NamedTuple):
    """One table of samples."""

    samples: int
    start: float | None
    end: float | None
    signals: list[Signal]


def _cell(text: str) -> float | None:
    return None if text == "-" else float(text)


def _table() -> dict[str, list[Stream]]:
    table: dict[str, list[Stream]] = {}
    streams: list[Stream] = []
    text = Path(__file__).with_name("real_load_frames.txt").read_text(encoding="utf-8")
    for line in text.splitlines():
        if line.startswith("== "):
            streams = table[line[3:]] = []
        elif line.startswith("-- "):
            samples, start, end = line[3:].split(" | ")
            streams.append(Stream(int(samples), _cell(start), _cell(end), []))
        elif line and not line.startswith("#"):
            name, unit, *numbers, missing = line.split(" | ")
            first, last, least, most = map(_cell, numbers)
            signal = Signal(name, unit.strip("-"), first, last, least, most, int(missing))
            streams[-1].signals.append(signal)
    return table


FACTS = _table()


def _lines() -> dict[str, list[tuple[str, str]]]:
    table: dict[str, list[tuple[str, str]]] = {}
    text = Path(__file__).with_name("real_takes.txt").read_text(encoding="utf-8")
    for block in text.split("\n== ")[1:]:
        name, *rows = block.splitlines()
        pairs = [row.partition(" |") for row in rows if row]
        table[name] = [(path, value.strip()) for path, _, value in pairs]
    return table


TAKES = _lines()


@cache
def inspected(path: Path) -> dict[str, Any]:
    inspection = inspect_export(path)
    assert format_inspection(inspection)
    facts: dict[str, Any] = json.loads(
        json.dumps(make_inspection_record(inspection), allow_nan=False)
    )
    return facts


def shown(stream: dict[str, Any], signal: Signal) -> dict[str, Any]:
    found = [channel for channel in stream["channels"] if channel["name"] == signal.name]
    names = [channel["name"] for channel in stream["channels"]]
    assert len(found) == 1, f"{signal.name} not once in {names}"
    return dict(found[0])


def close(found: float | None, expected: float | None, factor: float) -> None:
    """Ten digits are in the table; a smallest value near zero is no exception."""
    if expected is None:
        assert found is None
    else:
        assert found == pytest.approx(expected * factor, rel=1e-9, abs=1e-300)


def factor_of(channel: dict[str, Any], signal: Signal) -> float:
    """Factor from the file's number to the shown one; fails where the shown unit is wrong."""
    if signal.unit in SI:
        unit, factor = SI[signal.unit]
        assert channel["unit"] == unit
        return factor
    if signal.unit == "%" and channel["unit"] == "1":
        return 0.01
    if signal.unit == "d" and channel["unit"] == "s":
        return 86400.0
    assert channel["unit"] in {None, {"mm/mm": "1", "N/m": "N/m"}.get(signal.unit)}
    return 1.0


def test_no_real_export_is_forgotten(realdata: Path) -> None:
    folders = {*FOLDERS, "motive", "dspace"}
    paths = chain.from_iterable((realdata / folder).rglob("*") for folder in folders)
    files = {str(path.relative_to(realdata)) for path in paths if path.is_file()}
    assert files == {*FACTS, *TAKES, "motive/ktk_sample_OptiTrack_walking.c3d"}


def test_parts_of_one_test_sort_by_time(realdata: Path, tmp_path: Path) -> None:
    """In the order 5, 1, 4, 3 and the one without number; part 2 holds a byte order mark only."""
    files = sorted((realdata / PARTS).iterdir())
    assert len(files) == 6
    names = [shutil.copyfile(file, tmp_path / file.name).name for file in files]
    sheet_path = tmp_path / "test.yaml"
    sheet_path.write_text(PARTED.format(json.dumps(names, ensure_ascii=False)), encoding="utf-8")
    sheet = load_test_sheet(sheet_path)
    recordings, inputs = read_inputs(tmp_path, sheet, resolve_protocol(sheet, sheet_path))
    whole = recordings["frame"]
    time = whole.clocks[0].time
    assert len(inputs) == 6
    assert len(time) == 523 + 998 + 669 + 5999 + 699
    assert (time[0], time[-1]) == (pytest.approx(0.019), pytest.approx(88.971, abs=5e-4))
    # From part to part 0.02 s to 0.03 s go by; within a part the step is 0.01 s.
    steps = time[1:] - time[:-1]
    assert steps.min() > 0.0
    assert steps.max() == pytest.approx(0.033, abs=0.001)
    force = next(channel for channel in whole.channels if channel.name == "force")
    assert (force.unit, force.values[523]) == ("N", pytest.approx(6.82898899e-05))
    assert any("without samples" in note.message for note in whole.notes)


def at(facts: Any, *path: str) -> list[Any]:
    """Values at a path: one, or each where a part of it is ``*``."""
    if not path:
        return [facts]
    part, *more = path
    if part == "#":
        return [len(facts)]
    if isinstance(facts, list):
        members = facts if part == "*" else [facts[int(part)]]
        return [value for member in members for value in at(member, *more)]
    return at(facts[part], *more)


def is_right(value: object, text: str) -> bool:
    if not isinstance(value, float):
        return str(value) == text
    return abs(value - float(text)) <= 0.51 * 10.0 ** -len(text.partition(".")[2])


def holds_lines(facts: dict[str, Any], lines: list[tuple[str, str]]) -> None:
    notes = {note["code"]: note["message"] for note in facts["notes"]}
    for path, text in lines:
        if path.startswith("note "):
            assert notes[path.removeprefix("note ")].startswith(text), path
            continue
        values, wanted = at(facts, *path.split("/")), text.split(", ") if text else []
        assert len(values) == len(wanted) or (values == [""] and not wanted), (path, values)
        assert all(map(is_right, values, wanted)), (path, values, wanted)


@pytest.mark.parametrize("name", [name for name in TAKES if name not in FACTS])
def test_takes_and_recordings(realdata: Path, name: str) -> None:
    facts = inspected(realdata / name)
    holds_lines(facts, TAKES[name])
    channels = list(chain.from_iterable(stream["channels"] for stream in facts["streams"]))
    assert {channel["unit"] for channel in channels} <= {None}
    assert {channel["missing"] for channel in channels} <= {0}


def test_the_mf4_holds_the_same_samples_as_the_mat(realdata: Path) -> None:
    mat, mf4 = (inspected(realdata / f"dspace/{n}") for n in ("exp1_003.mat", "rec1_003.mf4"))
    assert mat["streams"] == mf4["streams"]
    assert mf4["metadata"]["start_time"].endswith("+04:00")


@pytest.mark.parametrize("name", FACTS)
def test_load_frames(realdata: Path, name: str) -> None:
    """Samples, times, names and numbers of all channels: none is lost and none invented."""
    facts = inspected(realdata / name)
    assert facts["reader"] == "load-frame"
    holds_lines(facts, TAKES.get(name, []))
    streams = facts["streams"]
    assert [stream["samples"] for stream in streams] == [known.samples for known in FACTS[name]]
    for stream, known in zip(streams, FACTS[name], strict=True):
        if known.start is not None:
            close(stream["start"], known.start, 1.0)
            close(stream["end"], known.end, 1.0)
        # The time axis may be listed beside the signals; a Microtest speed is text with a unit.
        extra = {"Motorspeed"} if name == MICROTEST else set()
        names = [channel["name"] for channel in stream["channels"] if channel["name"] not in extra]
        assert names == [signal.name for signal in known.signals]
        for signal in known.signals:
            channel = shown(stream, signal)
            if name != MICROTEST or signal.name not in UNIT_OF_THE_PROGRAM:
                assert channel["unit_in_file"] == signal.unit
            factor = factor_of(channel, signal)
            close(channel["first"], signal.first, factor)
            close(channel["last"], signal.last, factor)
            close(channel["min"], signal.least, factor)
            close(channel["max"], signal.most, factor)
            assert channel["missing"] == signal.missing
