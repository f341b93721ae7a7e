"""Layouts of load-frame exports, each in a small synthetic file: read as it was written."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.process.reading import read_role
from labpipe.protocol.source import Source
from labpipe.readers import load_frame, read_export
from tests.builders import load_frames as frames
from tests.builders.load_frames import FORCE, TIME, TRAVEL, N
from tests.builders.readings import Written, about, channel, codes, holds, refused, time
from tests.builders.small_tests import Run

PULLS: dict[str, tuple[bytes, tuple[str, str, float], tuple[str, str, float]]] = {
    "txt": (frames.mts_suite(), ("Load", "N", 1), ("Crosshead", "mm", 1)),
    "quoted csv": (frames.mts_suite(","), ("Load", "N", 1), ("Crosshead", "mm", 1)),
    "underscores": (frames.underscored_suite(), ("_Load", "N", 1), ("_Crosshead", "mm", 1)),
    "italian": (frames.italian_suite(), ("Carico", "kN", 1e-3), ("Traversa", "mm", 1)),
    "793": (frames.mts_793(), ("Ch 1 Kraft", "kN", 1e-3), ("Ch 1 Weg", "mm", 1)),
    "793 split": (
        *(frames.mts_793(split_at=15), ("Ch 1 Kraft", "kN", 1e-3), ("Ch 1 Weg", "mm", 1)),
    ),
    "793 english": (
        *(frames.mts_793_english(), ("Ch 1 Force", "kN", 1e-3), ("Ch 1 Displacement", "mm", 1)),
    ),
    "793 english, axial": (
        frames.mts_793_english("Axial Displacement Axial Force Running Time"),
        *(("Axial Force", "kN", 1e-3), ("Axial Displacement", "mm", 1)),
    ),
    "793, line 1 made unreadable": (
        frames.mts_793(first_line="MTS793|MPT|DEU|x|x|,|.|:|49|1|1|A"),
        *(("Ch 1 Kraft", "kN", 1e-3), ("Ch 1 Weg", "mm", 1)),
    ),
    "bluehill": (frames.bluehill(), ("Load", "N", 1), ("Extension", "mm", 1)),
    "8800": (frames.instron_8800(), ("Kraft", "kN", 1e-3), ("Maschine", "mm", 1)),
    "tra, commas": (frames.zwick_tra(), ("Standardkraft", "N", 1), ("Standardweg", "mm", 1)),
    "tra, tabs": (frames.zwick_tra("\t"), ("Standardkraft", "N", 1), ("Standardweg", "mm", 1)),
    "tra, decimal comma": (
        frames.zwick_tra("\t", decimal=","),
        *(("Standardkraft", "N", 1), ("Standardweg", "mm", 1)),
    ),
    "tra, semicolons and decimal comma": (
        frames.zwick_tra(";", decimal=","),
        *(("Standardkraft", "N", 1), ("Standardweg", "mm", 1)),
    ),
    "xlsx": (frames.zwick_workbook(), ("Standard force", "N", 1), ("Standard travel", "mm", 1)),
    "r-controller": (frames.r_controller(), ("Force", "lbf", 1), ("Displacement", "in", 1)),
    "shimadzu": (frames.trapezium(), ("Force", "N", 1), ("Stroke", "mm", 1)),
    "dion": (frames.dion(), ("C_1_Force", "kN", 1e-3), ("C_1_Déplacement", "mm", 1)),
    "catman": (frames.catman(), ("Kraft", "N", 1), ("Weg", "mm", 1)),
    "q800": (frames.dma_q800(), ("Static Force", "N", 1), ("Displacement", "µm", 1e3)),
    "nexygen": (frames.nexygen(blanks=False), ("Load", "N", 1), ("Machine Extension", "mm", 1)),
}


@pytest.mark.parametrize("kind", PULLS)
def test_the_pull_is_read_as_it_was_written(write: Written, kind: str) -> None:
    content, force, travel = PULLS[kind]
    holds(read_export(write(content)), force=force, travel=travel)


@pytest.mark.parametrize("preamble", range(12))
def test_bluehill_names_at_any_line(write: Written, preamble: int) -> None:
    recording = read_export(write(frames.bluehill(preamble=preamble)))
    holds(recording, force=("Load", "N", 1), travel=("Extension", "mm", 1))
    assert about(recording).count("Synthetic") == preamble


def test_bluehill_of_two_columns_only(write: Written) -> None:
    rows = frames.pull(TRAVEL, FORCE)
    content = frames.bluehill(names=("Extension", "Load"), units=("(mm)", "(N)"), rows=rows)
    recording = read_export(write(content))
    assert [each.name for each in recording.channels] == ["Extension", "Load"]
    assert recording.clocks[0].unit == "1"
    assert "no_time" in codes(recording)


@pytest.mark.parametrize("encoding", ["gbk", "utf-8", "utf-8-sig"])
def test_bluehill_in_chinese(write: Written, encoding: str) -> None:
    content = frames.bluehill(preamble=0, names=("时间", "位移", "力"), encoding=encoding)
    blank_first = content if encoding == "utf-8-sig" else b"\r\n" + content
    recording = read_export(write(blank_first))
    holds(recording, force=("力", "N", 1), travel=("位移", "mm", 1))


def test_bluehill_cycles_with_counters_and_small_steps(write: Written) -> None:
    """Segment changes add rows a millisecond after the one before."""
    moments = np.sort(np.append(TIME, [1.001, 2.001]))
    rows: list[list[object]] = [
        [float(t), float(i // 14 + 1), 0.0, float(i), -float(i)] for i, t in enumerate(moments)
    ]
    names = ("Time", "Segment ID", "Total Cycle Count", "Extension", "Load")
    content = frames.bluehill(names=names, units=("(sec)", "", "", "(mm)", "(N)"), rows=rows)
    recording = read_export(write(content))
    np.testing.assert_allclose(time(recording), moments)
    assert [each.name for each in recording.channels] == list(names[1:])
    np.testing.assert_array_equal(channel(recording, "Load").values, -np.arange(42.0))


def test_two_specimens_side_by_side(write: Written) -> None:
    file = write(frames.trapezium((N, 25, 3)))
    recording = read_export(file)
    assert [clock.name for clock in recording.clocks] == ["C1", "C2", "C3"]
    assert [len(clock.time) for clock in recording.clocks] == [N, 25, 3]
    for i, length in enumerate((N, 25, 3), 1):
        np.testing.assert_allclose(channel(recording, f"C{i}/Force").values, i * FORCE[:length])
    assert not np.isnan(channel(recording, "C2/Stroke").values).any()
    one = read_export(file, "load-frame", part="C2")
    np.testing.assert_allclose(time(one), TIME[:25])
    np.testing.assert_allclose(channel(one, "Force").values, 2 * FORCE[:25])


def test_the_short_specimen_may_come_first(write: Written) -> None:
    recording = read_export(write(frames.trapezium((5, N))))
    assert [len(clock.time) for clock in recording.clocks] == [5, N]


@pytest.mark.parametrize("extremes", ["before", "after"])
@pytest.mark.parametrize("split_at", [None, 15])
def test_rows_of_extremes_are_no_samples(
    write: Written, extremes: str, split_at: int | None
) -> None:
    recording = read_export(write(frames.mts_793(split_at=split_at, extremes=extremes)))
    holds(recording, force=("Ch 1 Kraft", "kN", 1e-3), travel=("Ch 1 Weg", "mm", 1))
    assert "summary_rows_left_out" in codes(recording)


def test_nothing_but_extremes_leaves_no_samples(write: Written) -> None:
    block = frames.mts_block("Datenerfassung", frames.EXTREMES, ",")
    recording = read_export(write(f"MTS793|MPT|DEU|1|2|,|.|:|49|1|1|A\r\n\r\n{block}".encode()))
    assert (recording.clocks, recording.channels) == ((), ())
    assert codes(recording) == {"summary_rows_left_out", "no_samples"}
    assert "0.131" in about(recording)


def test_793_with_umlauts_lost(write: Written) -> None:
    content = frames.mts_793().replace(b"Pr\xfcfer", b"Pr\xef\xbf\xbdfer")
    recording = read_export(write(content))
    holds(recording, force=("Ch 1 Kraft", "kN", 1e-3), travel=("Ch 1 Weg", "mm", 1))


@pytest.mark.parametrize("mark", [False, True])
def test_utf_16_with_blanks(write: Written, mark: bool) -> None:
    recording = read_export(write(frames.nexygen(mark=mark)))
    load, travel = channel(recording, "Load"), channel(recording, "Machine Extension")
    np.testing.assert_allclose(time(recording), TIME)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(load.values)), [0, N - 1])
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(travel.values)), [0, 1])
    np.testing.assert_allclose(load.values[1:-1], FORCE[1:-1])


def test_the_last_row_of_microtest_is_left_out_and_said(write: Written) -> None:
    recording = read_export(write(frames.microtest()))
    np.testing.assert_allclose(time(recording), TIME)
    np.testing.assert_allclose(channel(recording, "Force").values, FORCE)
    np.testing.assert_allclose(channel(recording, "Elongation").values, TRAVEL)
    assert "last_row_left_out" in codes(recording)
    assert "10,0" in about(recording)


def test_microtest_stopped_in_mid_test_keeps_its_last_row(write: Written) -> None:
    """Only a row of zeros with the stop code is no sample."""
    content = b"\n".join(frames.microtest().split(b"\n")[:-2]) + b"\n"
    recording = read_export(write(content))
    assert len(time(recording)) == N
    assert "last_row_left_out" not in codes(recording)


ENGLISH_NAMES = {
    "Ch 1 Count Ch 1 Displacement Ch 1 Force Time": ("Ch 1 Count", "Ch 1 Displacement"),
    "Axial Count Axial Displacement Axial Force Running Time": (
        *("Axial Count", "Axial Displacement"),
    ),
}


@pytest.mark.parametrize("names", ENGLISH_NAMES)
def test_793_english_with_a_counter(write: Written, names: str) -> None:
    """Names are separated by single blanks and hold blanks; there are as many as units."""
    lines = frames.mts_793_english(names).decode().splitlines()
    at = lines.index(names)
    lines[at + 1] = f"segments        {lines[at + 1]}"
    lines[at + 2 :] = [f"{2 * i} {line}" if line else "" for i, line in enumerate(lines[at + 2 :])]
    recording = read_export(write("\r\n".join(lines).encode()))
    assert [each.name for each in recording.channels][:2] == list(ENGLISH_NAMES[names])
    np.testing.assert_allclose(time(recording), TIME)


def test_793_english_names_that_cannot_be_told_apart(write: Written) -> None:
    """Names that no list knows may be refused or told, never replaced without a word."""
    names = "Ch 1 Displacement Deflectometer Ch 1 Force Time"
    lines = frames.mts_793_english(names).decode().splitlines()
    at = lines.index(names)
    lines[at + 1] = f"mm        {lines[at + 1]}"
    lines[at + 2 :] = [f"0.5 {line}" if line else "" for line in lines[at + 2 :]]
    file = write("\r\n".join(lines).encode())
    try:
        recording = read_export(file, "load-frame")
    except ReadError:
        refused(file, "names")
        return
    found = {each.name for each in recording.channels}
    said = {note.code for note in recording.notes if note.severity.value != "info"}
    assert found == {"Ch 1 Displacement", "Deflectometer", "Ch 1 Force"} or said


def test_793_blocks_of_other_columns_are_not_joined(write: Written) -> None:
    """Column by name: a second block in another order does not swap force and travel."""
    rows = frames.pull(TIME, FORCE / 1e3, TRAVEL)
    swapped = [[t, s, f] for t, f, s in rows]
    head: list[frames.Row] = [["Laufzeit", "Ch 1 Kraft", "Ch 1 Weg"], ["s", "kN", "mm"]]
    other: list[frames.Row] = [["Laufzeit", "Ch 1 Weg", "Ch 1 Kraft"], ["s", "mm", "kN"]]
    first = frames.mts_block("Datenerfassung", [*head, *rows[:20]], ",")
    second = frames.mts_block("Datenerfassung", [*other, *swapped[20:]], ",")
    text = f"MTS793|MPT|DEU|1|2|,|.|:|49|1|1|A\r\n\r\n{first}\r\n{second}"
    recording = read_export(write(text.encode("cp1252")))
    for name, truth in (("Ch 1 Kraft", FORCE / 1e3), ("Ch 1 Weg", TRAVEL)):
        parts = [each.values for each in recording.channels if each.name == name]
        np.testing.assert_allclose(np.concatenate(parts), truth, rtol=1e-6)


def test_microtest_codes_of_direction_changes_are_samples(write: Written) -> None:
    rows = frames.microtest().decode().split("\n")
    for at, code in ((10, "3"), (15, "4"), (20, "99")):
        rows[at] = rows[at].replace(",0,100,", f",{code},100,")
    recording = read_export(write("\n".join(rows).encode()))
    assert len(time(recording)) == N
    assert {3.0, 4.0, 99.0} <= {*channel(recording, "Code").values}


def test_suite_exported_to_a_server(write: Written) -> None:
    content = frames.mts_suite().replace(b"C:\\Synthetic", b"\\\\server\\share")
    assert read_export(write(content)).program == "MTS TestSuite"


TITLES: dict[str, list[list[object]]] = {
    "round brackets": [["Time (s)", "Load (lbf)", "Position (in)"]],
    "square brackets": [["Time [s]", "Load [lbf]", "Position [in]"]],
    "row of units": [["Time", "Load", "Position"], ["s", "lbf", "in"]],
    "other words": [["Elapsed Time (sec)", "Axial Force (lbf)", "Axial Displacement (in)"]],
    "rows above": [["Specimen", "synthetic"], [], ["Time (s)", "Load (lbf)", "Position (in)"]],
}


@pytest.mark.parametrize("dialect", [None, ["testresources"]])
@pytest.mark.parametrize("kind", TITLES)
def test_a_workbook_in_pounds_and_inches(
    write: Written, run: Run, kind: str, dialect: list[str] | None
) -> None:
    """The layout of an R-Controller is not known: the header is found by its words."""
    rows = frames.pull(TIME, FORCE, TRAVEL)
    file = write(frames.workbook({"Sheet1": [*TITLES[kind], *rows]}), "synthetic.xlsx")
    recording = read_export(file, "load-frame", dialect=dialect)
    assert [each.unit_in_file for each in recording.channels] == ["lbf", "in"]
    np.testing.assert_allclose(time(recording), TIME)
    (stream,) = json.loads(run("inspect", file, "--json").out)["streams"]
    force, travel = stream["channels"]
    assert (force["unit"], travel["unit"]) == ("N", "m")
    assert force["max"] == pytest.approx(4.4482216152605 * FORCE.max())
    assert travel["last"] == pytest.approx(0.0254 * TRAVEL[-1])


def test_a_workbook_that_says_no_units_is_refused_not_assumed(write: Written) -> None:
    rows = frames.pull(TIME, FORCE, TRAVEL)
    sheet: list[frames.Row] = [["Time", "Load", "Position"], *rows]
    file = write(frames.workbook({"Sheet1": sheet}), "synthetic.xlsx")
    refused(file, "unit", dialect=["testresources"])


@pytest.mark.parametrize("dialect", [None, ["table-workbook"]])
def test_a_workbook_without_units_is_told_where_they_belong(
    write: Written, dialect: list[str] | None
) -> None:
    rows = frames.pull(TIME, FORCE, TRAVEL)
    sheet: list[frames.Row] = [["Time", "Load", "Position"], *rows]
    file = write(frames.workbook({"Sheet1": sheet}), "synthetic.xlsx")
    refused(
        *(file, "column 'Time'", "unit", "a row below the names", "in brackets", "time_unit"),
        dialect=dialect,
    )


def test_units_that_a_protocol_and_a_card_say(
    write: Written, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A workbook without units: channels take theirs from the protocol, time from a lab's card."""
    rows = frames.pull(TIME, FORCE, TRAVEL)
    sheet: list[frames.Row] = [["Time", "Load", "Position"], *rows]
    file = write(frames.workbook({"Sheet1": sheet}), "synthetic.xlsx")
    (tmp_path / "dialects").mkdir()
    text = (resources.files(load_frame) / "dialects" / "testresources.toml").read_text("utf-8")
    card = f'time_unit = "s"\n{text}'
    (tmp_path / "dialects" / "our-frame.toml").write_text(card, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    source = Source.model_validate(
        {
            "reader": "load-frame",
            "dialect": "our-frame",
            "channels": {
                "force": {"channel": ["Axial Force", "Load"], "unit": "lbf"},
                "displacement": {"channel": "Position", "unit": "in"},
            },
        }
    ).in_role("frame")
    recording = read_role(file, source)
    np.testing.assert_allclose(time(recording), TIME)
    force, travel = recording.channels
    assert (force.name, force.unit, travel.unit) == ("force", "N", "m")
    np.testing.assert_allclose(force.values, 4.4482216152605 * FORCE)
    np.testing.assert_allclose(travel.values, 0.0254 * TRAVEL)


@pytest.mark.parametrize("mark", ["{}, {}", "{} / {}", "{},{}"])
def test_units_behind_a_comma_or_a_slash(write: Written, mark: str) -> None:
    pairs = (("Time", "s"), ("Force", "lbf"), ("Displacement", "in"))
    names: frames.Row = [mark.format(*pair) for pair in pairs]
    rows = frames.pull(TIME, FORCE, TRAVEL)
    held = {"force": ("Force", "lbf", 1.0), "travel": ("Displacement", "in", 1.0)}
    book = frames.workbook({"Sheet1": [names, *rows]})
    holds(read_export(write(book, "synthetic.xlsx")), **held)
    text = frames.lines([names, *rows], ";")
    holds(read_export(write(text.encode())), **held)
    holds(read_export(write(f"sep=;\r\n{text}".encode())), **held)


def test_catman_code_for_no_sensor(write: Written) -> None:
    recording = read_export(write(frames.catman()))
    assert [each.name for each in recording.channels] == ["Kraft", "Weg", "Pyrometer"]
    assert np.isnan(channel(recording, "Pyrometer").values).all()
    assert channel(recording, "Pyrometer").unit_in_file == "°C"
    assert any("-1000000" in note.message for note in recording.notes)


@pytest.mark.parametrize("micro", ["µ", "μ", "u"])  # micro sign, Greek mu, and the makeshift
def test_micrometres(write: Written, run: Run, micro: str) -> None:
    file = write(frames.dma_q800(length_unit=f"{micro}m"))
    ran = run("inspect", file, "--json")
    (stream,) = json.loads(ran.out)["streams"]
    travel = next(each for each in stream["channels"] if each["name"] == "Displacement")
    assert (stream["start"], stream["end"]) == (pytest.approx(0.1), pytest.approx(4.0))
    assert (travel["unit"], travel["first"]) == ("m", pytest.approx(-0.25e-3))


def test_q800_that_lacks_one_of_its_names(write: Written) -> None:
    content = frames.dma_q800().decode("utf-16").replace("Nsig\t3", "Nsig\t4")
    recording = read_export(write(content.encode("utf-16")))
    (note,) = (note for note in recording.notes if note.code == "columns_differ")
    assert note.message == "the header states 4 columns, the file holds 3"
    assert note.severity.value == "warning"
    rows = [f"{line}\t1.5" if "." in line[:3] else line for line in content.split("\r\n")]
    refused(write("\r\n".join(rows).encode("utf-16")), "3 cells as in the header, found 4")


def test_index_without_time(write: Written) -> None:
    recording = read_export(write(frames.walter_bai()))
    assert recording.clocks[0].unit == "1"
    np.testing.assert_array_equal(recording.clocks[0].time, np.arange(float(N)))
    np.testing.assert_allclose(channel(recording, "Force").values, FORCE)
    assert "no_time" in codes(recording)


def test_sheets_that_are_no_test_are_left_out(write: Written) -> None:
    file = write(frames.zwick_workbook(("S1", "S2")), "synthetic.XLSX")
    recording = read_export(file)
    assert [clock.name for clock in recording.clocks] == ["S1", "S2"]
    second = read_export(file, "load-frame", part="S2")
    np.testing.assert_allclose(channel(second, "Standard force").values, 2 * FORCE)
    refused(file, "part", "'S3'", "S1", part="S3")


def test_an_aborted_test_of_three_rows(write: Written, run: Run) -> None:
    """Inspected with a warning or worse; refused or read whole for processing, never padded."""
    file = write(frames.zwick_workbook(samples=3), "aborted.XLSX")
    ran = run("inspect", file, "--json")
    assert ran.status == 0
    facts = json.loads(ran.out)
    assert [stream["samples"] for stream in facts["streams"]] == [3]
    assert any(note["severity"] != "info" for note in facts["notes"])


@pytest.mark.parametrize("mark", [b"\xef\xbb\xbf", b"\xff\xfe"])
def test_a_byte_order_mark_and_nothing_else(write: Written, run: Run, mark: bytes) -> None:
    file = write(mark, "DAQ- Crosshead, … - (Timed)2.txt")
    recording = read_export(file)
    assert (recording.clocks, recording.channels) == ((), ())
    assert codes(recording) == {"no_samples"}
    assert run("inspect", file).status == 0


def test_names_and_no_sample(write: Written) -> None:
    """A part whose acquisition started and took nothing."""
    file = write(frames.mts_suite(rows=[]))
    try:
        recording = read_export(file, "load-frame")
    except ReadError:
        refused(file, "sample")
    else:
        assert sum(len(clock.time) for clock in recording.clocks) == 0
        assert "no_samples" in codes(recording)


def test_a_counter_whose_unit_repeats_its_name(write: Written) -> None:
    recording = read_export(write(frames.underscored_suite()))
    assert channel(recording, "_Cycle").unit_in_file == ""
    assert recording.clocks[0].unit == "s"
