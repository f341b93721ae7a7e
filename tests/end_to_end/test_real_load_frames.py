"""Every real export of a load frame is inspected right: rows, columns, units, ends, extremes.

The numbers are those of ``real_load_frames.txt``, taken from the files themselves and checked
against the README of the real exports. None of them was taken from the output of a reader.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from labpipe.process.inspection import as_json, as_text, inspect_export
from labpipe.process.reading import read_inputs
from labpipe.protocol.load import load_test_sheet, resolve
from labpipe.readers import READERS
from tests.builders.small_tests import Run

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
REU = "mts/REU/"
TIMED = "DAQ- Crosshead, … - (Timed)"
PARTS = f"mts/MTS_data/I0-0.9-dc/Test Run 4 10-23-2023 6 43 09 PM/{TIMED}"
BOM_ONLY = f"{PARTS}2.txt"
CABLE_CYCLES = f"{REU}Hysteresis_SteelCableSD_Trial1/{TIMED}.csv"
CABLE_100 = f"{REU}SteelCableSD_100mm_Trial1/{TIMED}.csv"
MODULUS = "mts/mts793/bam_emodul_specimen.dat"
CRUSH = "mts/mts793/bam_druck_Wolf_8.2_Probe_2_specimen.dat"
COPPER = "lloyd_nexygen/tensile_22awg_copper_1_50mm.txt"
YARNS = "zwick/yarn_compressionTests.xls"
ABORTED = "zwick/Target-2.XLSX"
CATMAN = "hbm_catman/DD11_7_1.ASC"
MICROTEST = "deben/NANOCEL_KW.CHAL_450PPM_15.MTR"
Q800 = "ta_dma/BC100GLU_01.txt"


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


@cache
def inspected(path: Path) -> dict[str, Any]:
    inspection = inspect_export(path)
    assert as_text(inspection)
    facts: dict[str, Any] = json.loads(json.dumps(as_json(inspection), allow_nan=False))
    return facts


Inspect = Callable[[str], dict[str, Any]]


@pytest.fixture
def inspect(realdata: Path) -> Inspect:
    return lambda name: inspected(realdata / name)


def notes(facts: dict[str, Any]) -> dict[str, str]:
    return {note["code"]: note["message"] for note in facts["notes"]}


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
    files = chain.from_iterable((realdata / folder).rglob("*") for folder in FOLDERS)
    assert {str(p.relative_to(realdata)) for p in files if p.is_file()} == set(FACTS)


@pytest.mark.slow
@pytest.mark.parametrize("name", FACTS)
def test_recognised_as_a_load_frame_and_nothing_else(realdata: Path, name: str) -> None:
    assert [r.name for r in READERS.values() if r.recognise(realdata / name)] == ["load-frame"]


@pytest.mark.parametrize("name", FACTS)
def test_samples_and_times(inspect: Inspect, name: str) -> None:
    streams = inspect(name)["streams"]
    assert [stream["samples"] for stream in streams] == [s.samples for s in FACTS[name]]
    for stream, facts in zip(streams, FACTS[name], strict=True):
        if facts.start is not None:
            close(stream["start"], facts.start, 1.0)
            close(stream["end"], facts.end, 1.0)


@pytest.mark.parametrize("name", FACTS)
def test_no_channel_is_lost_and_none_invented(inspect: Inspect, name: str) -> None:
    for stream, facts in zip(inspect(name)["streams"], FACTS[name], strict=True):
        # The time axis may be listed beside the signals; a Microtest speed is text with a unit.
        extra = {"Motorspeed"} if name == MICROTEST else set()
        names = [each["name"] for each in stream["channels"] if each["name"] not in extra]
        assert names == [signal.name for signal in facts.signals]


@pytest.mark.parametrize("name", FACTS)
def test_numbers_and_units(inspect: Inspect, name: str) -> None:
    for stream, facts in zip(inspect(name)["streams"], FACTS[name], strict=True):
        for signal in facts.signals:
            channel = shown(stream, signal)
            if name != MICROTEST or signal.name not in UNIT_OF_THE_PROGRAM:
                assert channel["unit_in_file"] == signal.unit
            factor = factor_of(channel, signal)
            close(channel["first"], signal.first, factor)
            close(channel["last"], signal.last, factor)
            close(channel["min"], signal.least, factor)
            close(channel["max"], signal.most, factor)
            assert channel["missing"] == signal.missing


@pytest.mark.slow
@pytest.mark.parametrize("name", [CABLE_100, COPPER, YARNS])
def test_the_command_says_the_same(realdata: Path, run: Run, name: str) -> None:
    ran = run("inspect", realdata / name, "--json")
    assert ran.status == 0
    facts = json.loads(ran.out)
    assert facts["reader"] == "load-frame"
    assert facts["streams"] == inspected(realdata / name)["streams"]
    read_aloud = run("inspect", realdata / name)
    assert read_aloud.status == 0
    assert FACTS[name][0].signals[0].name in read_aloud.out


PROGRAMS = {
    "mts/FDA": "MTS",
    "mts/REU": "MTS",
    "mts/ym": "MTS",
    "mts/mts793": "793",
    "instron/matolab": "Instron",
    "instron/nosh": "Bluehill",
    "instron/bez": "Bluehill",
    "zwick": "testXpert",
    "walter": "Walter",
    "shimadzu": "Trapezium",
    "hbm": "catman",
    "deben": "Microtest",
    "ta_dma": "Q800",
    "lloyd": "Nexygen",
}


@pytest.mark.parametrize("name", [name for name in FACTS if FACTS[name]])
def test_program_is_named(inspect: Inspect, name: str) -> None:
    expected = [program for start, program in PROGRAMS.items() if name.startswith(start)]
    assert all(program.casefold() in inspect(name)["program"].casefold() for program in expected)


def test_versions_that_the_files_state(inspect: Inspect) -> None:
    assert "5.5.29" in inspect(MICROTEST)["version"]
    assert "21.2" in inspect(Q800)["version"]


def test_a_part_of_a_bom_and_nothing_else(inspect: Inspect, realdata: Path, run: Run) -> None:
    facts = inspect(BOM_ONLY)
    assert facts["reader"] == "load-frame"
    assert facts["streams"] == []
    assert [note["severity"] for note in facts["notes"]] == ["warning"]
    assert "no sample" in facts["notes"][0]["message"]
    assert run("inspect", realdata / BOM_ONLY).status == 0


def test_parts_of_one_test_sort_by_time(realdata: Path, tmp_path: Path) -> None:
    """In the order 5, 1, 4, 3 and the one without number; part 2 holds a byte order mark only."""
    files = sorted((realdata / PARTS).parent.iterdir())
    assert len(files) == 6
    names = [shutil.copyfile(file, tmp_path / file.name).name for file in files]
    sheet_path = tmp_path / "test.yaml"
    sheet_path.write_text(PARTED.format(json.dumps(names, ensure_ascii=False)), encoding="utf-8")
    sheet = load_test_sheet(sheet_path)
    recordings, inputs = read_inputs(tmp_path, sheet, resolve(sheet, sheet_path))
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
    assert any("no sample" in note.message for note in whole.notes)


STEEL = """\
version: 1
name: steel
sources:
  frame:
    reader: load-frame
    dialect: [table, bluehill]
    channels:
      force: {channel: [Force, Load]}
      displacement: {channel: [Machine Displacement, Crosshead separation]}
curve: {force: force, displacement: displacement}
branches: {channel: displacement, min_stroke: 1 mm}
results: [{result: peak-force}]
"""


@pytest.mark.parametrize(
    ("folder", "head", "force", "separator"),
    [("iso6892/46*.csv", 25, 2, "\t"), ("bam_s355/Z*.csv", 2, 2, ";")],
)
def test_public_steel_is_read_by_a_protocol(
    realdata: Path, tmp_path: Path, folder: str, head: int, force: int, separator: str
) -> None:
    """Where an export holds `nan`, other columns are read as they stand there."""
    (tmp_path / "steel.yaml").write_text(STEEL, encoding="utf-8")
    exports = sorted(realdata.glob(folder))
    assert exports
    for export in exports:
        rows = export.read_text(encoding="utf-8-sig").splitlines()[head:]
        loads = [float(row.split(separator)[force].replace(",", ".")) for row in rows]
        assert inspect_export(export).recording.reader == "load-frame"
        copy = shutil.copyfile(export, tmp_path / "a.csv")
        sheet_path = tmp_path / "test.yaml"
        text = PARTED.format(copy.name).replace("tensile", "./steel.yaml")
        sheet_path.write_text(text, encoding="utf-8")
        sheet = load_test_sheet(sheet_path)
        recordings, _ = read_inputs(tmp_path, sheet, resolve(sheet, sheet_path))
        measured = next(c for c in recordings["frame"].channels if c.name == "force")
        assert (measured.unit, len(measured.values)) == ("N", len(loads))
        assert measured.values.max() == pytest.approx(1e3 * max(loads), rel=1e-12)


def test_cycles_are_a_column(inspect: Inspect) -> None:
    (stream,) = inspect(CABLE_CYCLES)["streams"]
    cycle = stream["channels"][0]
    assert (cycle["name"], cycle["first"], cycle["last"]) == ("_Cycle", 1.0, 15.0)


@pytest.mark.parametrize(("name", "extreme"), [(MODULUS, "147.20456"), (CRUSH, "354.12192")])
def test_rows_of_extremes_are_no_samples_and_are_not_lost(
    inspect: Inspect, name: str, extreme: str
) -> None:
    facts = inspect(name)
    assert extreme in json.dumps([facts["notes"], facts["metadata"]])
    assert any("summary" in code for code in notes(facts))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (CABLE_100, "Tensile_2400N"),
        (CABLE_100, "7/3/2025 12:23:28 PM"),
        (MODULUS, "Kraftgeregelt 3,9 kN/s"),
        (CRUSH, "Wolf 8.2 Probe 2"),
        ("mts/mts793/1_3D850_s1.dat", "Pappas.tst"),
        ("instron/bezborodow_Al5005.csv", "Rectangular"),
        ("instron/nosh_3pb_Specimen_RawData_1.csv", "131.18347"),
        ("instron/matolab_instron8852_example2.csv", "AWA_3_03_Rz"),
        ("zwick/Allong 1.TRA", "43173.4"),
        ("zwick/Zugversuch_eng_ETFE-Ref+Groesseneffekt6.TRA", "nicht bekannt"),
        ("zwick/FSP_AB_1_Traction-11.XLSX", "5939.49"),
        ("shimadzu/Exemple_Shimadzu_Tract_L100_D2.csv", "C35"),
        (MICROTEST, "200N tensile"),
        (Q800, "TAxGLU"),
        (Q800, "10.1955"),
    ],
)
def test_what_the_export_says_of_itself_is_kept(inspect: Inspect, name: str, said: str) -> None:
    assert said in json.dumps(inspect(name)["metadata"], ensure_ascii=False)


def test_specimens_as_sheets_and_one_sheet_that_is_no_test(inspect: Inspect) -> None:
    facts = inspect(YARNS)
    names = [f"cotton-{i}" for i in range(1, 5)] + [f"acrylic-{i}" for i in range(1, 4)]
    assert [stream["clock"] for stream in facts["streams"]] == names
    paths = [channel["path"] for stream in facts["streams"] for channel in stream["channels"]]
    assert len(set(paths)) == 28
    assert "Yarn Diameters" in json.dumps([facts["notes"], facts["metadata"]])


def test_an_aborted_test_of_three_rows_is_told(inspect: Inspect) -> None:
    found = [note for note in inspect(ABORTED)["notes"] if note["severity"] != "info"]
    assert found, "three rows at one time are worth a warning"


def test_exports_without_time_say_so(inspect: Inspect) -> None:
    without = [name for name, streams in FACTS.items() if streams and streams[0].start is None]
    assert len(without) == 7
    for name in without:
        assert any("time" in message for message in notes(inspect(name)).values()), name


def test_the_code_of_an_unconnected_channel_is_told(inspect: Inspect) -> None:
    assert any("-1000000" in message for message in notes(inspect(CATMAN)).values())


def test_the_last_row_of_microtest_is_told(inspect: Inspect) -> None:
    """2702 rows of which the last holds zeros and the stop code; the header says 2701."""
    assert any("last" in message for message in notes(inspect(MICROTEST)).values())


@pytest.mark.parametrize(
    ("name", "longest", "usual"),
    [
        ("Allong 1.TRA", 0.63, 0.01),
        ("Zugversuch_eng_ETFE-Ref+Groesseneffekt6.TRA", 0.37, 0.02),
    ],
)
def test_testxpert_leaves_samples_out_and_loses_none(
    inspect: Inspect, name: str, longest: float, usual: float
) -> None:
    found = inspect(f"zwick/{name}")
    (stream,) = found["streams"]
    assert stream["holes"] == []
    assert stream["step_max"] == pytest.approx(longest, abs=0.011)
    assert stream["step_median"] == pytest.approx(usual)
    assert "the program samples at a rate that varies" in notes(found)["time_variable"]


@pytest.mark.parametrize(
    ("name", "step"),
    [
        ("mts/FDA/C18-L-M-RF 10-26-2022 1 03 54 PM/Collect Data - (Timed).txt", 0.0253906),
        (f"{PARTS}3.txt", 0.01),
        (CABLE_100, 0.1),
        ("mts/mts793/1_3D850_s1.dat", 0.019531),
        ("instron/nosh_3pb_Specimen_RawData_1.csv", 0.1),
        ("instron/vhb4910_0d05_2d0_gbk.csv", 0.02),
        ("instron/vhb4910_relax_5d0_utf8.csv", 0.05),
        ("zwick/FSP_AB_1_Traction-11.XLSX", 0.01),
        ("shimadzu/Exemple_Shimadzu_Tract_L100_D2.csv", 0.01),
        (CATMAN, 0.02),
        (MICROTEST, 0.1),
        (Q800, 2.0),
    ],
)
def test_steps(inspect: Inspect, name: str, step: float) -> None:
    (stream,) = inspect(name)["streams"]
    assert stream["step_median"] == pytest.approx(step, rel=3e-3)


def test_a_step_of_irregular_time_is_not_a_hole(inspect: Inspect) -> None:
    (stream,) = inspect("instron/matolab_instron8852_example2.csv")["streams"]
    assert stream["step_min"] > 0.18
    assert stream["step_max"] < 0.25
    assert stream["holes"] == []


def test_peak_of_the_large_steel_cable_is_at_its_row(realdata: Path) -> None:
    file = realdata / f"{REU}SteelCableLD_200mm_Trial3/{TIMED}.csv"
    recording = READERS["load-frame"].read(file)
    load, crosshead = (
        next(channel.values for channel in recording.channels if channel.name == name)
        for name in ("Load", "Crosshead")
    )
    assert int(load.argmax()) + 1 == 627
    assert crosshead[-1] == pytest.approx(3.1711631, rel=1e-6)


def test_two_clocks_of_a_video_extensometer(inspect: Inspect) -> None:
    (stream,) = inspect(f"mts/ym-extract/{TIMED}.txt")["streams"]
    video = shown(stream, Signal("Video Time", "sec", 0, 0, 0, 0, 0))
    assert video["first"] - stream["start"] == pytest.approx(8.088, abs=5e-4)
    assert video["last"] - stream["end"] == pytest.approx(8.044, abs=5e-4)
