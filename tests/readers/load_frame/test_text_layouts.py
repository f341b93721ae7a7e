"""Text exports of load frames, by dialect."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers import load_frame
from labpipe.records.recording import Recording
from tests.readers.load_frame.exports import (
    MTS_HEAD,
    ROWS,
    bluehill,
    lines,
    mts,
    written,
)

TIME, TRAVEL, FORCE = (list(column) for column in zip(*ROWS, strict=True))


def holds(recording: Recording, *named: tuple[str, str, list[float]]) -> None:
    """Check names, units and values of all channels on one clock."""
    assert [(c.name, c.unit_in_file) for c in recording.channels] == [n[:2] for n in named]
    for channel, (_, _, values) in zip(recording.channels, named, strict=True):
        np.testing.assert_allclose(channel.values, values, rtol=1e-15)


def codes(recording: Recording) -> set[str]:
    return {note.code for note in recording.notes} - {"few_samples", "time_start_not_zero"}


@pytest.mark.parametrize(
    ("head", "body"),
    [
        (MTS_HEAD + "Time \tCrosshead \tLoad \nsec\tmm\tN\n", lines(ROWS, "\t")),
        (
            "".join(f'"{line}"\n' for line in MTS_HEAD.splitlines())
            + '"Time ","Crosshead ","Load "\n"sec","mm","N"\n',
            "".join(",".join(f'"{cell}"' for cell in row) + "\n" for row in ROWS),
        ),
        (
            "Percorso file: C:\\prova\\DAQ-Tempo; … - (Temporizzato).csv\nProva: sintetica\n"
            "Esecuzione: 1\nData: 03/07/2025 12:23:28\n\n\nTempo ;Crosshead ;Load \nsec;mm;N\n",
            lines(ROWS, ";", comma=True),
        ),
    ],
    ids=["txt", "csv", "Italian"],
)
@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_testsuite(tmp_path: Path, head: str, body: str, ends: str) -> None:
    text = (head + body).replace("\n", ends)
    recording = load_frame.read(written(tmp_path / "a.dat", text, "utf-8-sig"))
    holds(recording, ("Crosshead", "mm", TRAVEL), ("Load", "N", FORCE))
    assert recording.metadata["dialect"] == "mts-testsuite"
    np.testing.assert_array_equal(recording.clock("time").time, TIME)
    assert not codes(recording)


def test_specimens_side_by_side(tmp_path: Path) -> None:
    """Blank padding of the shorter one is no missing value; the file is Latin-1."""
    rows = [[*a, *b] for a, b in zip(ROWS, [*ROWS[:2], ("",) * 3, ("",) * 3], strict=True)]
    quoted = "".join(",".join(f'"{cell}"' if cell != "" else "" for cell in r) + "\n" for r in rows)
    head = '"C35",,,"C36é",,\n' + ",".join(['"Temps","Déplacement","Force"'] * 2) + "\n"
    text = head + ",".join(['"sec","mm","N"'] * 2) + "\n" + quoted
    file = written(tmp_path / "a.csv", text, "latin-1")
    recording = load_frame.read(file)
    assert [(clock.name, len(clock.time)) for clock in recording.clocks] == [
        ("C35", 4),
        ("C36é", 2),
    ]
    assert [channel.path for channel in recording.channels] == [
        "C35/Déplacement",
        "C35/Force",
        "C36é/Déplacement",
        "C36é/Force",
    ]
    assert codes(recording) == {"names_not_unique"}
    one = load_frame.read(file, part="C36é", channels=["Force"])
    holds(one, ("Force", "N", FORCE[:2]))
    assert one.clocks[0].name == "time"
    expected = r"part 'C37': expected one of the 2 specimens .* found no such part\. Nearest: 'C3"
    with pytest.raises(ReadError, match=expected):
        load_frame.read(file, part="C37")


@pytest.mark.parametrize("count", [0, 1, 3, 11])
def test_bluehill_finds_its_header_anywhere(tmp_path: Path, count: int) -> None:
    above = "".join(f'Specimen properties : Width {i},"{i}.5",mm\n' for i in range(count))
    recording = load_frame.read(bluehill(tmp_path / "a.csv", above=above + "\n" * (count > 0)))
    holds(recording, ("Extension", "mm", TRAVEL), ("Load", "N", FORCE))
    assert recording.metadata["dialect"] == "bluehill"


def test_bluehill_cyclic(tmp_path: Path) -> None:
    """Counters without unit; steps of a millisecond where segments change."""
    time = [0.0, 0.05, 0.1, 0.101, 0.15, 0.2]
    body = "".join(f'"{t}","{-t}","{-2 * t}","{i // 3}","1"\n' for i, t in enumerate(time))
    head = "Specimen properties : Label,a\n\n\nTime,Extension,Load,Segment ID,Total Cycle Count\n"
    text = head + "(s),(mm),(N),,\n" + body
    recording = load_frame.read(written(tmp_path / "a.csv", text))
    assert [(c.name, c.unit_in_file) for c in recording.channels] == [
        ("Extension", "mm"),
        ("Load", "N"),
        ("Segment ID", ""),
        ("Total Cycle Count", ""),
    ]
    np.testing.assert_array_equal(recording.clocks[0].time, time)
    assert codes(recording) == {"time_jitter", "constant_channel", "units_not_stated"}


@pytest.mark.parametrize(
    ("separator", "body", "line", "found"),
    [
        (",", '0.1,"0,935",2.5\n0.2,"1,063",3.5\n0.3,"1,110,797",4.5\n', 3, "'0,935'"),
        (",", '0.1,935,2.5\n0.2,"1,063",3.5\n0.3,"1,110,797",4.5\n', 4, "'1,063'"),
        (";", "0,1;0,935;2,5\n0,2;1,063;3,5\n0,3;1,110,797;4,5\n", 5, "'1,110,797'"),
        ("\t", "0,1\t1.063\t2,5\n0,2\t1.110.797\t3,5\n", 3, "'1.063'"),
    ],
)
def test_regrouped_thousands_are_refused(
    tmp_path: Path, separator: str, body: str, line: int, found: str
) -> None:
    head = "Time,Extension,Load\n(s),(mm),(N)\n".replace(",", separator)
    expected = (
        rf"a\.csv, line {line}, column 'Extension': expected a number with a decimal \w+, found"
        rf" {found}.*A spreadsheet took the decimal sign for a sign between thousands and the dig"
    )
    with pytest.raises(ReadError, match=expected):
        load_frame.read(written(tmp_path / "a.csv", head + body))


def test_chinese_names(tmp_path: Path) -> None:
    for encoding in ("gbk", "utf-8"):
        text = "\r\n时间,位移,力\r\n(s),(mm),(N)\r\n" + lines(ROWS)
        recording = load_frame.read(written(tmp_path / "a.csv", text, encoding))
        holds(recording, ("位移", "mm", TRAVEL), ("力", "N", FORCE))


@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_nexygen(tmp_path: Path, mark: str) -> None:
    text = (
        "Time (s)\tLoad (N)\tMachine Extension (mm)\r\n0.0\t\t\r\n0.5\t1.5\t\r\n1.0\t2.5\t0.5\r\n"
    )
    recording = load_frame.read(written(tmp_path / "a.txt", mark + text, "utf-16-le"))
    holds(
        recording,
        ("Load", "N", [np.nan, 1.5, 2.5]),
        ("Machine Extension", "mm", [np.nan, np.nan, 0.5]),
    )
    missing = [note.message for note in recording.notes if note.code == "missing_values"]
    assert missing[0] == "1 of 3 values are missing, the first in row 1"


def test_without_time_rows_are_counted(tmp_path: Path) -> None:
    text = "Load (N)\tMachine Extension (mm)\r\n" + "".join(f"{i}\t{2 * i}\r\n" for i in range(12))
    recording = load_frame.read(written(tmp_path / "a.txt", text.rstrip(), "utf-16"))
    (clock,) = recording.clocks
    assert (clock.unit, clock.time.tolist()) == ("1", list(range(12)))
    assert codes(recording) == {"no_time"}


@pytest.mark.parametrize("separator", [",", "\t"])
def test_testxpert_text(tmp_path: Path, separator: str) -> None:
    head = [
        ('"Messlänge"', 25, '"mm"'),
        ('"Bruch"', '"nicht bekannt"'),
        ('"Datum"', '"20.02.2008"', '""'),
        ('"Prüfzeit"', '"Standardweg"', '"Standardkraft"'),
        ('"s"', '"mm"', '"N"'),
    ]
    text = lines([*head, *ROWS, ("0.5", "5e-005", "-1.5")], separator)
    recording = load_frame.read(written(tmp_path / "a.TRA", text, "cp1252"))
    holds(recording, ("Standardweg", "mm", [*TRAVEL, 5e-5]), ("Standardkraft", "N", [*FORCE, -1.5]))
    assert recording.metadata["Messlänge"] == "25 mm"
    assert recording.metadata["Bruch"] == "nicht bekannt"


def test_8800(tmp_path: Path) -> None:
    head = "Probe;A_1;INSTRON 8852TT;1605F\nMaschine [mm]\tT [°C]\tZeit [s]\tKanal 10\n"
    body = "0.0\t1.5E-01\t0.0\t0\n1.0\t2.5E-01\t0.2\t0\n"
    recording = load_frame.read(written(tmp_path / "a.csv", head + body))
    holds(
        recording,
        ("Maschine", "mm", [0.0, 1.0]),
        ("T", "°C", [0.15, 0.25]),
        ("Kanal 10", "", [0.0, 0.0]),
    )
    assert recording.program == "Instron 8800 8852TT"


@pytest.mark.parametrize(
    ("text", "encoding", "names", "unit"),
    [
        ("S/No;C_1_Temps[s];C_1_Déform1[mm];C_1_X[]\n1;0.1;0.2;3\n11;0.2;0.3;4\n", "utf-8",
         ["S/No", "C_1_Déform1", "C_1_X"], "s"),
        ("Index,Déplacement [ mm ],Force [ N ]\n0,1.5,9573.6\n1,1.6,9573.7\n", "latin-1",
         ["Index", "Déplacement", "Force"], "1"),
    ],
)  # fmt: skip
def test_dion(tmp_path: Path, text: str, encoding: str, names: list[str], unit: str) -> None:
    recording = load_frame.read(written(tmp_path / "a.csv", text, encoding))
    assert [channel.name for channel in recording.channels] == names
    assert recording.channels[1].unit_in_file == "mm"
    assert recording.clocks[0].unit == unit


def test_catman(tmp_path: Path) -> None:
    text = "Zeit  1 - Standardmessrate [s]\tKraft [N]\tDrehwinkel [V]\r\n"
    text += "0\t1.5\t-1000000\t\r\n0.02\t-1000000\t-1000000\t\r\n0.04\t2.5\t-1000000\t"
    recording = load_frame.read(written(tmp_path / "a.ASC", text, "latin-1"))
    holds(
        recording,
        ("Kraft", "N", [1.5, np.nan, 2.5]),
        ("Drehwinkel", "V", [np.nan, np.nan, np.nan]),
    )
    (first, _) = (note for note in recording.notes if note.code == "missing_values")
    assert first.message == "1 of 3 values are missing (blank or -1000000), the first in row 2"


@pytest.mark.parametrize(("last", "rows"), [("4.5,0,0,.6,1,100", 4), ("4.5,1,2,.6,99,100", 5)])
def test_microtest(tmp_path: Path, last: str, rows: int) -> None:
    head = '"Sample : A"\n"Max travel : 1,400mm"\n""\n"Number of points : 4"\n"Ver5.5.29"\n'
    head += '"Point","Elongation","Force","Position","Code","Samplerate","Motorspeed"\n'
    body = [".5,.1,.2,.6,2,100", "1.5,.2,.3,.6,3,100", "2.5,.3,.4,.6,4,100", "3.5,.3,.4,.6,0,100"]
    text = head + "".join(f'{row},"0.1 mm/min"\n' for row in [*body, last])
    recording = load_frame.read(written(tmp_path / "a.MTR", text))
    assert len(recording.clocks[0].time) == rows
    assert [c.unit_in_file for c in recording.channels] == ["mm", "N", "mm", "", "ms"]
    assert ("last_row_left_out" in codes(recording)) == (rows == 4)
    assert ("rows_differ" in codes(recording)) == (rows == 5)
    assert recording.metadata["Motorspeed"] == ["0.1 mm/min"]
    assert recording.metadata["Max travel"] == "1,400mm"
    assert recording.program_version == "5.5.29"


def test_dma(tmp_path: Path) -> None:
    text = "CLOSED\r\nInstrument\tDMA Q800 V21.2 Build 73\r\nNsig\t2\r\nSig1\tTime (min)\r\n"
    text += "Sig2\tDisplacement (µm)\r\nTime\t15:01:57\r\nOrgMethod\t1: a\r\nOrgMethod\t2: b\r\n"
    text += "StartOfData\r\n.5\t-5.5E-3\r\n1.5\t.25\r\n"
    recording = load_frame.read(written(tmp_path / "a.txt", text, "utf-16"))
    holds(recording, ("Displacement", "µm", [-5.5e-3, 0.25]))
    np.testing.assert_allclose(recording.clocks[0].time, [30.0, 90.0])
    assert recording.program_version == "21.2"
    assert recording.metadata["OrgMethod"] == ["1: a", "2: b"]


@pytest.mark.parametrize(
    ("units", "said"),
    [
        (
            "",
            r"line 7: expected a row of units above the numbers, found 'Time, Crosshead, Load'\. ",
        ),
        ("mm\tmm\tN\n", r"column 'Time': expected a unit of time such as s, found 'mm'\. Look at"),
        ("\tmm\tN\n", r"column 'Time': expected a unit of time such as s, found none\. Write i"),
    ],
)
def test_units_that_are_missing_or_wrong(tmp_path: Path, units: str, said: str) -> None:
    file = written(
        tmp_path / "a.txt", MTS_HEAD + "Time\tCrosshead\tLoad\n" + units + lines(ROWS, "\t")
    )
    with pytest.raises(ReadError, match=said):
        load_frame.read(file)


BLOCK = "Datenerfassung\t\t\tZeit:\t1,5\ts\t28.01.2015 10:35:28\n"


COLUMNS = "Laufzeit\tCh 1 Weg\tCh 1 Kraft\ns\tmm\tkN\n"


@pytest.mark.parametrize(
    "line", ["MTS793|MPT|DEU|1|2|,|.|:|49|1|1|A", "MTS793|MPT|DEU|x|x|,|.|:|49|1|1|A"]
)
@pytest.mark.parametrize("encoding", ["cp1252", "utf-8"])
def test_blocks_of_793(tmp_path: Path, line: str, encoding: str) -> None:
    """Two blocks of samples are one recording; a summary between them is none."""
    mark = "ü" if encoding == "cp1252" else "\ufffd"
    form = f"Bediener Information\nPr{mark}fer:\tKh\nBediener Information Ende\n"
    first, second = lines(ROWS[:2], "\t", comma=True), lines(ROWS[2:], "\t", comma=True)
    summary = BLOCK + "Ch 1 Kraft\tCh 1 Weg\nkN\tmm\n99,5\t0\n-1\t2\n"
    parts = [line, form, BLOCK + COLUMNS + first, summary, BLOCK + COLUMNS + second]
    recording = load_frame.read(written(tmp_path / "a.dat", "\n\n".join(parts), encoding))
    holds(recording, ("Ch 1 Weg", "mm", TRAVEL), ("Ch 1 Kraft", "kN", FORCE))
    assert recording.program == "MTS 793 MPT"
    assert codes(recording) == {"summary_rows_left_out", "blocks_joined"}
    assert recording.metadata["summaries"] == [{"Ch 1 Kraft": [99.5, -1.0], "Ch 1 Weg": [0.0, 2.0]}]
    assert recording.metadata[f"Pr{mark}fer"] == "Kh"


def test_names_and_columns_parted_by_blanks(tmp_path: Path) -> None:
    names = "Ch 1 Displacement Ch 1 Force Time"
    block = f"Data Acquisition: Timed\nStation Name: a\n{names}\nmm        kN        Sec\n"
    body = lines([(travel, force, time) for time, travel, force in ROWS], " ")
    text = f"MTS793|BTW|ENG|1|0|.|/|:|44|1|1|A\n\nData Header:   Time: 1 Sec\n{block}{body}\n"
    recording = load_frame.read(written(tmp_path / "a.dat", text.replace("\n", "\r\n")))
    assert [channel.name for channel in recording.channels] == ["Ch 1 Displacement", "Ch 1 Force"]
    assert recording.metadata["Station Name"] == "a"


EXTREMES = "Ch 1 Kraft\tCh 1 Weg\nkN\tmm\n99,5\t2\n-1\t0\n"


def test_nothing_but_extremes(tmp_path: Path) -> None:
    text = f"MTS793|MPT|DEU|1|2|,|.\n\n{BLOCK}{EXTREMES}"
    recording = load_frame.read(written(tmp_path / "a.dat", text))
    assert (recording.clocks, recording.channels) == ((), ())
    assert codes(recording) == {"summary_rows_left_out", "no_samples"}
    assert recording.metadata["summaries"] == [{"Ch 1 Kraft": [99.5, -1.0], "Ch 1 Weg": [2.0, 0.0]}]
    (note,) = (note for note in recording.notes if note.code == "no_samples")
    assert note.message == "all rows are a summary: the test took no samples"


def test_only_wanted_channels(tmp_path: Path) -> None:
    file = mts(tmp_path / "a.txt")
    holds(load_frame.read(file, channels=[("Kraft", "Load")]), ("Load", "N", FORCE))
    with pytest.raises(ReadError, match=r"channel 'Loda': expected one of the 2 channels .*'Load'"):
        load_frame.read(file, channels=["Loda"])


def test_a_decimal_sign_that_is_not_stated(tmp_path: Path) -> None:
    file = written(tmp_path / "a.dat", f"MTS793|MPT\n\n{BLOCK}{COLUMNS}{lines(ROWS)}")
    expected = r"a\.dat, line 1: expected the decimal sign that this program states, found 'MTS793"
    with pytest.raises(ReadError, match=expected):
        load_frame.read(file)


def test_blocks_without_samples(tmp_path: Path) -> None:
    file = written(tmp_path / "a.dat", "MTS793|MPT|DEU|1|2|,|.\n\nBediener Information\n")
    with pytest.raises(ReadError, match=r"lines 1 to 4: expected a block of names, units and num"):
        load_frame.read(file)
