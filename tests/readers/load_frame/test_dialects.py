"""Exports of each dialect with the same synthetic pull: read as written, or refused."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.process.reading import read_role_export
from labpipe.protocol.source import Source, assign_roles
from labpipe.readers import load_frame, read_export, recognise_export
from tests.approved import Approve
from tests.builders import load_frames as frames
from tests.builders.load_frames import EXAMPLES, FORCE, TIME, TRAVEL, N
from tests.builders.readings import Written, channel, codes, holds, refused, time
from tests.builders.small_tests import Run

Named = tuple[str, str, float]
"""A channel: name, unit in the file, factor from N or mm."""
GERMAN: tuple[Named, Named] = ("Ch 1 Kraft", "kN", 1e-3), ("Ch 1 Weg", "mm", 1)
LOAD: Named = ("Load", "N", 1)
STANDARD: tuple[Named, Named] = ("Standardkraft", "N", 1), ("Standardweg", "mm", 1)
COUNTED = frames.bluehill(
    names=("Time", "Extension", "Load", "Segment ID"),
    units=("(s)", "(mm)", "(N)", ""),
    rows=frames.pull(TIME, TRAVEL, FORCE, np.ones(N)),
)
AXIAL = frames.mts_793_english("Axial Displacement Axial Force Running Time")
UNREADABLE = frames.mts_793(first_line="MTS793|MPT|DEU|x|x|,|.|:|49|1|1|A")
UMLAUTS_LOST = frames.mts_793().replace(b"Pr\xfcfer", b"Pr\xef\xbf\xbdfer")
PULLS: dict[str, tuple[bytes, Named, Named]] = {
    "txt": (frames.mts_suite(), LOAD, ("Crosshead", "mm", 1)),
    "txt, line feeds": (
        frames.mts_suite().replace(b"\r\n", b"\n"),
        LOAD,
        ("Crosshead", "mm", 1),
    ),
    "quoted csv": (frames.mts_suite(","), LOAD, ("Crosshead", "mm", 1)),
    "underscores": (frames.underscored_suite(), ("_Load", "N", 1), ("_Crosshead", "mm", 1)),
    "italian": (frames.italian_suite(), ("Carico", "kN", 1e-3), ("Traversa", "mm", 1)),
    "793": (frames.mts_793(), *GERMAN),
    "793 split": (frames.mts_793(split_at=15), *GERMAN),
    "793 english": (
        *(frames.mts_793_english(), ("Ch 1 Force", "kN", 1e-3), ("Ch 1 Displacement", "mm", 1)),
    ),
    "793 english, axial": (AXIAL, ("Axial Force", "kN", 1e-3), ("Axial Displacement", "mm", 1)),
    "793, line 1 made unreadable": (UNREADABLE, *GERMAN),
    "793 with umlauts lost": (UMLAUTS_LOST, *GERMAN),
    **{
        f"bluehill, names in line {preamble}": (
            *(frames.bluehill(preamble=preamble), LOAD, ("Extension", "mm", 1)),
        )
        for preamble in (0, 1, 3, 11)
    },
    **{
        f"bluehill in Chinese, {encoding}": (
            (b"" if encoding == "utf-8-sig" else b"\r\n")
            + frames.bluehill(preamble=0, names=("时间", "位移", "力"), encoding=encoding),
            *(("力", "N", 1), ("位移", "mm", 1)),
        )
        for encoding in ("gbk", "utf-8", "utf-8-sig")
    },
    "bluehill, a counter without unit": (COUNTED, LOAD, ("Extension", "mm", 1)),
    "8800": (frames.instron_8800(), ("Kraft", "kN", 1e-3), ("Maschine", "mm", 1)),
    "tra, commas": (frames.zwick_tra(), *STANDARD),
    "tra, tabs": (frames.zwick_tra("\t"), *STANDARD),
    "tra, decimal comma": (frames.zwick_tra("\t", decimal=","), *STANDARD),
    "tra, semicolons and decimal comma": (frames.zwick_tra(";", decimal=","), *STANDARD),
    "xlsx": (frames.zwick_workbook(), ("Standard force", "N", 1), ("Standard travel", "mm", 1)),
    "r-controller": (frames.r_controller(), ("Force", "lbf", 1), ("Displacement", "in", 1)),
    "shimadzu": (frames.trapezium(), ("Force", "N", 1), ("Stroke", "mm", 1)),
    "dion": (frames.dion(), ("C_1_Force", "kN", 1e-3), ("C_1_Déplacement", "mm", 1)),
    "catman": (frames.catman(), ("Kraft", "N", 1), ("Weg", "mm", 1)),
    "q800": (frames.dma_q800(), ("Static Force", "N", 1), ("Displacement", "µm", 1e3)),
    "nexygen": (frames.nexygen(blanks=False), LOAD, ("Machine Extension", "mm", 1)),
}
EXTREMES: dict[str, tuple[bytes, Named, Named]] = {
    f"extremes {place}, split at {split_at}": (
        *(frames.mts_793(split_at=split_at, extremes=place), *GERMAN),
    )
    for place in ("before", "after")
    for split_at in (None, 15)
}


@pytest.fixture
def write(tmp_path: Path) -> Written:
    def written(content: bytes, name: str = "synthetic.csv") -> Path:
        file = tmp_path / name
        file.write_bytes(content)
        return file

    return written


@pytest.mark.parametrize("kind", PULLS | EXTREMES)
def test_the_pull_is_read_as_it_was_written(write: Written, kind: str) -> None:
    content, force, travel = (PULLS | EXTREMES)[kind]
    recording = read_export(write(content))
    holds(recording, force=force, travel=travel)
    assert ("summary_rows_left_out" in codes(recording)) == (kind in EXTREMES)


# dialect: program, its version, and some of what stands above the numbers
ABOUT: dict[str, tuple[str, str, Mapping[str, object]]] = {
    "mts-793": ("MTS 793 MPT", "", {"Prüfer": "synthetisch"}),
    "instron-8800": ("Instron 8800 8852TT", "", {}),
    "testxpert-tra": (
        *(
            "ZwickRoell testXpert",
            "",
            {"Épaisseur éprouvette": "1 mm", "Vorkraft": "nicht bekannt"},
        ),
    ),
    "microtest": ("Deben Microtest", "5.5.29", {"Motorspeed": ["0.1 mm/min"], "Span": "10,0"}),
    "dma-q800": ("TA Instruments DMA Q800", "21.2", {"OrgMethod": ["1: a", "2: b"]}),
}


@pytest.mark.parametrize("dialect", ABOUT)
def test_what_an_export_says_of_itself(write: Written, dialect: str) -> None:
    content = EXAMPLES[dialect][1]()
    if dialect == "dma-q800":
        text = content.decode("utf-16")
        content = re.sub("OrgMethod.*", "OrgMethod\t1: a\r\nOrgMethod\t2: b\r", text).encode(
            "utf-16"
        )
    recording = read_export(write(content))
    program, version, metadata = ABOUT[dialect]
    assert (recording.program, recording.program_version) == (program, version)
    assert {key: recording.metadata[key] for key in metadata} == metadata


def test_gaps_of_a_table(write: Written) -> None:
    """Blanks in UTF-16 with and without its mark, and the code of a missing value."""
    for mark in (False, True):
        recording = read_export(write(frames.nexygen(mark=mark)))
        load, travel = channel(recording, "Load"), channel(recording, "Machine Extension")
        np.testing.assert_allclose(time(recording), TIME)
        np.testing.assert_array_equal(np.flatnonzero(np.isnan(load.values)), [0, N - 1])
        np.testing.assert_array_equal(np.flatnonzero(np.isnan(travel.values)), [0, 1])
        np.testing.assert_allclose(load.values[1:-1], FORCE[1:-1])
    recording = read_export(write(frames.catman()))
    assert np.isnan(channel(recording, "Pyrometer").values).all()
    (note,) = (note for note in recording.notes if note.code == "missing_values")
    assert note.message.startswith("40 of 40 values are missing (blank or -1000000)")


@pytest.mark.parametrize("dialect", ["bluehill", "dion"])
def test_rows_are_counted_where_there_is_no_time(write: Written, dialect: str) -> None:
    rows = frames.pull(TRAVEL, FORCE)
    content = frames.walter_bai()
    if dialect == "bluehill":
        names, units = ("Extension", "Force"), ("(mm)", "(N)")
        content = frames.bluehill(names=names, units=units, rows=rows)
    recording = read_export(write(content))
    assert recording.clocks[0].unit == "1"
    np.testing.assert_array_equal(recording.clocks[0].time, np.arange(float(N)))
    np.testing.assert_allclose(channel(recording, "Force").values, FORCE)
    assert "no_time" in codes(recording)


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
    refused(file, "part 'C4'", "one of the 3 specimens", "Nearest: 'C1'", part="C4")


def test_nothing_but_extremes_leaves_no_samples(write: Written) -> None:
    first, head = "MTS793|MPT|DEU|1|2|,|.|:|49|1|1|A", frames.EXTREMES[:2]
    block = frames.mts_block("Datenerfassung", frames.EXTREMES, ",")
    recording = read_export(write(f"{first}\r\n\r\n{block}".encode()))
    assert (recording.clocks, recording.channels) == ((), ())
    assert codes(recording) == {"summary_rows_left_out", "no_samples"}
    summary = {"Ch 1 Kraft": [0.131, -0.0021], "Ch 1 Weg": [1.75, -0.26]}
    assert recording.metadata["summaries"] == [summary]
    # of an unloading without time, two last rows are samples
    falls: list[list[frames.Row]] = [[[2, 9]] * 3, [[1, 8], [0, 7]]]
    blocks = [frames.mts_block("", [*head, *rows], ",") for rows in falls]
    recording = read_export(write("\r\n\r\n".join([first, *blocks]).encode()))
    assert codes(recording) == {"blocks_joined", "few_samples", "no_time"}


def test_the_last_row_of_microtest_is_left_out_and_said(write: Written) -> None:
    recording = read_export(write(frames.microtest()))
    np.testing.assert_allclose(time(recording), TIME)
    np.testing.assert_allclose(channel(recording, "Force").values, FORCE)
    np.testing.assert_allclose(channel(recording, "Elongation").values, TRAVEL)
    assert "last_row_left_out" in codes(recording)
    whole = frames.microtest().replace(b"4.1,0,0,1.6,1,100", b"4.1,1,2,1.6,99,100")
    recording = read_export(write(whole))
    assert len(time(recording)) == N + 1
    assert "rows_differ" in codes(recording)


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
        parts = [channel.values for channel in recording.channels if channel.name == name]
        np.testing.assert_allclose(np.concatenate(parts), truth, rtol=1e-6)


def test_blank_rows_and_one_micro_sign(write: Written) -> None:
    """A lone byte beyond ASCII is no Chinese character; a row without any value is no sample."""
    rows = [f"{t:.3f},{s:.1f},{f:.3f}" for t, s, f in zip(TIME, TRAVEL, FORCE, strict=True)]
    lines = ["Time,Crosshead,Load", "s,\u00b5m,mN", *rows[:20], "", ",,", *rows[20:]]
    recording = read_export(write("\n".join(lines).encode("cp1252")))
    np.testing.assert_allclose(time(recording), TIME, atol=1e-3)
    assert channel(recording, "Crosshead").unit_in_file == "\u00b5m"
    assert "2 blank rows" in str(recording.notes)


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
    assert [channel.unit_in_file for channel in recording.channels] == ["lbf", "in"]
    np.testing.assert_allclose(time(recording), TIME)
    (stream,) = json.loads(run("inspect", file, "--json").out)["streams"]
    force, travel = stream["channels"]
    assert (force["unit"], travel["unit"]) == ("N", "m")
    assert force["max"] == pytest.approx(4.4482216152605 * FORCE.max())
    assert travel["last"] == pytest.approx(0.0254 * TRAVEL[-1])


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
    )
    recording = read_role_export(file, assign_roles({"frame": source})["frame"])
    np.testing.assert_allclose(time(recording), TIME)
    force, travel = recording.channels
    assert (force.name, force.unit, travel.unit) == ("force", "N", "m")
    np.testing.assert_allclose(force.values, 4.4482216152605 * FORCE)
    np.testing.assert_allclose(travel.values, 0.0254 * TRAVEL)


@pytest.mark.parametrize("mark", ["{}, {}", "{} / {}", "{},{}"])
def test_units_behind_a_comma_or_a_slash(write: Written, mark: str) -> None:
    pairs = (("Time", "s"), ("Force", "lbf"), ("Displacement", "in"))
    table: list[list[Any]] = [
        [mark.format(*pair) for pair in pairs],
        *frames.pull(TIME, FORCE, TRAVEL),
    ]
    text = frames.lines(table, ";")
    for content in (book(*table), text.encode(), f"sep=;\r\n{text}".encode()):
        recording = read_export(write(content))
        holds(recording, force=("Force", "lbf", 1.0), travel=("Displacement", "in", 1.0))


def test_q800_that_lacks_one_of_its_names(write: Written) -> None:
    content = frames.dma_q800().decode("utf-16").replace("Nsig\t3", "Nsig\t4")
    recording = read_export(write(content.encode("utf-16")))
    (note,) = (note for note in recording.notes if note.code == "columns_differ")
    assert note.message == "the header states 4 columns, the file has 3"
    assert note.severity.value == "warning"
    rows = [f"{line}\t1.5" if "." in line[:3] else line for line in content.split("\r\n")]
    refused(write("\r\n".join(rows).encode("utf-16")), "3 cells as in the header, found 4")


WORKBOOKS = {"testxpert-xlsx", "testresources", "table-workbook"}
REGROUPED = [
    *([0.0, "0.5", 1.0], [0.1, "801", 2.0], [0.2, "1,063", 3.0]),
    *([0.3, "1,110,797", 4.0], [0.4, "1,162", 5.0]),
]


@pytest.mark.parametrize("dialect", EXAMPLES)
def test_damaged_examples(write: Written, dialect: str) -> None:
    """A block of zeros, as a full disk leaves it, and times that run backwards are refused.

    A truncated last line is noted or refused, never read as a sample.
    """
    name, example = EXAMPLES[dialect]
    whole = example()
    half = len(whole) // 2 // 2 * 2
    refused(write(whole[:half] + bytes(200) + whole[half + 200 :], name))
    if dialect in WORKBOOKS:
        return
    is_wide = whole[1:2] == b"\0" or whole.startswith(b"\xff\xfe")
    encoding = "utf-16-le" if is_wide else "latin-1"
    text = whole.decode(encoding)
    rows = text.split("\n")
    at = len(rows) - 20
    rows[at], rows[at + 4] = rows[at + 4], rows[at]
    refused(write("\n".join(rows).encode(encoding), name), "expected time that increases")

    last = text.rstrip("\r\n").rfind("\n") + 1
    cut = write(text[: last + 3].encode(encoding), "cut.csv")
    count = max(len(clock.time) for clock in read_export(write(whole, name)).clocks)
    try:
        recording = read_export(cut, "load-frame")
    except ReadError:
        refused(cut)
        return
    assert max(len(clock.time) for clock in recording.clocks) <= count
    warned = [note for note in recording.notes if note.severity.value != "info"]
    assert warned, "a row with fewer cells than names is worth a warning"


def test_two_columns_of_one_name(write: Written) -> None:
    """Told apart by their paths, or refused; never one in the place of the other."""
    rows = frames.pull(TIME, TRAVEL, 2 * TRAVEL, FORCE)
    names = ("Time", "Extension", "Extension", "Load")
    content = frames.bluehill(names=names, units=("(s)", "(mm)", "(mm)", "(N)"), rows=rows)
    recording = read_export(write(content))
    paths = [channel.path for channel in recording.channels]
    assert len(set(paths)) == 3
    with pytest.raises(ReadError, match="only one channel"):
        read_export(write(content), "load-frame", channels=["Extension"])


def bluehill(at: int = 0, cell: object = None, column: int = 2) -> bytes:
    """A pull one of whose cells is changed."""
    rows = frames.pull(TIME, TRAVEL, FORCE)
    rows[at][column] = rows[at][column] if cell is None else cell
    return frames.bluehill(preamble=0, rows=rows)


def regrouped(separator: str, sign: str) -> bytes:
    """Digits are lost: 1,063 was 1.063 or 1063, and 1,110,797 was neither."""
    decimal = "," if sign == "." and separator != "," else "."
    grouped = [0.5, f"1{sign}063", f"1{sign}110{sign}797", f"1{sign}162"]
    rows = [[0.1 * i, cell, 1.0 + i] for i, cell in enumerate(grouped)]
    head = frames.lines([["Time", "Extension", "Load"], ["(s)", "(mm)", "(N)"]], separator)
    return (head + frames.lines(rows, separator, decimal=decimal)).encode()


def far_down() -> bytes:
    rows: list[list[object]] = [[0.1 * i, f"{0.001 * i:.3f}", 1.0] for i in range(3000)]
    return frames.bluehill(preamble=0, rows=[*rows, [300.0, "1,110,797", 1.0]])


def suite_with_a_comma(separator: str) -> bytes:
    rows = frames.pull(TRAVEL, FORCE, TIME)
    rows[20][1] = "12,5"
    return frames.mts_suite(separator, rows=rows)


def italian_with_a_point(row: int) -> bytes:
    rows = [[frames.number(cell, ",") for cell in cells] for cells in frames.pull(FORCE, TIME)]
    rows[row][0] = "12.5"
    content = frames.italian_suite().decode("utf-8-sig").split("Traversa")[0]
    content += "Carico ;Tempo \r\nN;sec\r\n" + frames.lines(rows, ";")
    return content.encode("utf-8-sig")


def book(*rows: list[Any]) -> bytes:
    return frames.workbook({"Sheet1": [*rows]})


UNITS = ["Time (s)", "Extension (mm)", "Load (N)"]
BAD: dict[str, bytes] = {
    "regrouped thousands": frames.bluehill(preamble=2, rows=REGROUPED),
    "regrouped far down": far_down(),
    **{
        f"regrouped by {sign}, separated by {word}": regrouped(separator, sign)
        for word, separator in (("comma", ","), ("semicolon", ";"), ("tab", "\t"))
        for sign in ",."
    },
    "regrouped.xlsx": book(UNITS, [0.1, "1,063", 1.0], [0.2, "1,110,797", 2.0]),
    "too large a number": bluehill(20, "1e999"),
    "word among numbers": bluehill(9, "overload"),
    "point among commas, near the top": italian_with_a_point(2),
    "point among commas": italian_with_a_point(30),
    "comma among points, tabs": suite_with_a_comma("\t"),
    "comma among points, semicolons": suite_with_a_comma(";"),
    "no row of units": frames.mts_suite().replace(b"mm\tN\tsec\r\n", b""),
    "unit of a length for the time": frames.mts_suite().replace(b"mm\tN\tsec", b"mm\tN\tmm"),
    "no unit of the time": frames.mts_suite().replace(b"mm\tN\tsec", b"mm\tN\t"),
    "793, decimal sign not stated": frames.mts_793(first_line="MTS793|MPT"),
    "793, no block": b"MTS793|MPT|DEU|1|2|,|.\n\nBediener Information\n",
    "no row of units, bluehill": bluehill().replace(b"(s),(mm),(N)\r\n", b""),
    "no units, testresources.xlsx": book(["Time", "Load"], *frames.pull(TIME, FORCE)),
    "no units.xlsx": book(["Time", "Load"], *frames.pull(TIME, FORCE)),
    "nothing": b"",
    "unknown dialect": frames.catman(),
    "letter.csv": b"Dear Sir,\r\nthe force was 12 N at the time, see page 3.\r\n",
    "addresses.csv": b"name,street,town\r\nsynthetic,1,nowhere\r\n",
    "no names.csv": b"1,2,3\r\n4,5,6\r\n",
    "blanks.csv": b"\r\n \r\n\r\n",
    "words.csv": "time,force\r\nnever,none\r\n".encode("utf-16"),
    "binary.csv": bytes(range(256)) * 4,
    "addresses.xlsx": frames.workbook({"Addresses": [["name", "town"], ["synthetic", "nowhere"]]}),
}
ASKED = {
    "no row of units, bluehill": ["bluehill"],
    "no units, testresources.xlsx": ["testresources"],
    "unknown dialect": ["catmann"],
}


def test_what_is_refused(tmp_path: Path, write: Written, run: Run, approved: Approve) -> None:
    """By its name or its content; a file that is no export at all by the command, too."""
    messages = []
    for name, content in BAD.items():
        file = write(content, name if name.endswith(("csv", "xlsx")) else "synthetic.csv")
        if not name.endswith(".csv") and name != "addresses.xlsx":
            messages.append(refused(file, dialect=ASKED.get(name)))
            continue
        with pytest.raises(ReadError) as refusal:
            recognise_export(file)
        messages.append(str(refusal.value))
        ran = run("inspect", file)
        assert (ran.status, "Traceback" in ran.err, ": expected " in ran.err) == (2, False, True)
    approved(f"{name}: {text}" for name, text in zip(BAD, messages, strict=True))
