"""Small synthetic exports in the layouts of load-frame programs, with known content.

Every one holds the same pull, `TIME`, `TRAVEL` and `FORCE`, and says where its layout has room for
a word that it is synthetic. Nothing in them was measured.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from itertools import chain, zip_longest
from typing import Literal

import numpy as np

from labpipe.records.arrays import Floats

N = 40
TIME: Floats = np.round(0.1 * np.arange(1.0, N + 1.0), 3)
"""Starts at 0.1 s, as exports of load frames do."""
TRAVEL: Floats = np.round(0.05 * np.arange(float(N)) - 0.25, 4)
"""mm"""
FORCE: Floats = np.round(120.0 * np.sin(np.arange(float(N)) / 14.0) - 1.5, 4)
"""N"""

Row = Sequence[object]


def number(value: object, decimal: str = ".") -> str:
    """One cell; numbers with the decimal sign asked for."""
    return str(value).replace(".", decimal) if isinstance(value, float) else str(value)


def lines(rows: Iterable[Row], separator: str, *, decimal: str = ".", quoted: bool = False) -> str:
    """Rows as text, ended by CRLF."""
    stream = io.StringIO()
    quoting: Literal[0, 1] = csv.QUOTE_ALL if quoted else csv.QUOTE_MINIMAL
    writer = csv.writer(stream, delimiter=separator, quoting=quoting, lineterminator="\r\n")
    writer.writerows([number(cell, decimal) for cell in row] for row in rows)
    return stream.getvalue()


def pull(*columns: Floats) -> list[list[object]]:
    """Rows of the given columns as plain numbers."""
    return [[float(cell) for cell in row] for row in zip(*columns, strict=True)]


def mts_suite(separator: str = "\t", *, rows: list[list[object]] | None = None) -> bytes:
    """TestSuite, as txt (tabs) or csv (every cell quoted)."""
    head = (
        "File Path: C:\\Synthetic\\Run 1\\DAQ- Crosshead, … - (Timed).txt   ",
        *("Test: Synthetic pull", "Test Run: Run 1", "Date: 7/3/2025 12:23:28 PM", "", ""),
    )
    quoted = separator == ","
    preamble = "".join(f'"{line}"\r\n' if quoted else f"{line}\r\n" for line in head)
    table = [["Crosshead ", "Load ", "Time "], ["mm", "N", "sec"]]
    body = pull(TRAVEL, FORCE, TIME) if rows is None else rows
    return (preamble + lines([*table, *body], separator, quoted=quoted)).encode("utf-8-sig")


def underscored_suite() -> bytes:
    """TestSuite that puts an underscore before names; the unit of its counter repeats the name."""
    names = [f"_{name}" for name in ("Cycle ", "Crosshead ", "Load ", "Time ")]
    counts = np.repeat(np.arange(1.0, 5.0), N // 4)
    text = mts_suite(rows=pull(counts, TRAVEL, FORCE, TIME)).decode("utf-8-sig")
    text = text.replace("Crosshead \tLoad \tTime ", "\t".join(names), 1)
    return text.replace("mm\tN\tsec", "_Cycle\tmm\tN\tsec", 1).encode("utf-8-sig")


def italian_suite() -> bytes:
    """TestSuite on an Italian computer: semicolons, decimal commas, words in Italian."""
    head = (
        "Percorso file: C:\\Sintetico\\Prova 1\\DAQ-Tempo; … - (Temporizzato).txt   \r\n"
        "Test: Trazione sintetica\r\nEsecuzione test: Prova 1\r\n"
        "Data: 28/07/2025 13:32:19\r\n\r\n\r\n"
    )
    table: list[Row] = [["Traversa ", "Carico ", "Tempo "], ["mm", "kN", "sec"]]
    body = pull(TRAVEL, FORCE / 1e3, TIME)
    return (head + lines([*table, *body], ";", decimal=",")).encode("utf-8-sig")


def mts_block(title: str, table: Sequence[Row], decimal: str) -> str:
    """One block of MTS 793 with its title line."""
    return f"{title}\t\t\tZeit:\t4,1\ts\t01.09.2014 13:30:25\r\n" + lines(
        table, "\t", decimal=decimal
    )


EXTREMES: list[Row] = [["Ch 1 Kraft", "Ch 1 Weg"], ["kN", "mm"], [0.131, 1.75], [-0.0021, -0.26]]
"""Two rows, largest and smallest, with more than the samples hold."""


def mts_793(*, split_at: int | None = None, extremes: str = "", first_line: str = "") -> bytes:
    """MPT on a German computer, cp1252; `extremes` come ``before`` or ``after`` the samples."""
    head: list[Row] = [["Laufzeit", "Ch 1 Kraft", "Ch 1 Weg"], ["s", "kN", "mm"]]
    rows = pull(TIME, np.round(FORCE / 1e3, 7), TRAVEL)
    cuts = [rows] if split_at is None else [rows[:split_at], rows[split_at:]]
    blocks = [mts_block("Datenerfassung", [*head, *cut], ",") for cut in cuts]
    summary = mts_block("Datenerfassung", EXTREMES, ",")
    if extremes == "before":
        blocks.insert(0, summary)
    elif extremes == "after":
        blocks.append(summary)
    form = (
        "Bediener Information\t\t\tZeit:\t0,1\ts\t01.09.2014 13:25:39\r\nPrüfer :\tsynthetisch\r\n"
    )
    first = first_line or "MTS793|MPT|DEU|1|2|,|.|:|49|1|1|A"
    text = "\r\n\r\n".join([first, form + "Bediener Information Ende", *blocks])
    return text.encode("cp1252", errors="replace")


def mts_793_english(names: str = "Ch 1 Displacement Ch 1 Force Time") -> bytes:
    """BTW in English: single blanks between the columns and inside the names."""
    head = (
        "MTS793|BTW|ENG|1|0|.|/|:|44|1|1|A\r\n\r\n"
        "Data Header:                    Time:     4.1 Sec       28/01/2022 11:15:59\r\n"
        "Data Acquisition: Timed\r\nStation Name: synthetic.cfg\r\n"
        "Test File Name: synthetic.tst\r\n"
    )
    body = lines(pull(TRAVEL, FORCE / 1e3, TIME), " ")
    return (head + f"{names}\r\nmm        kN        Sec\r\n{body}\r\n").encode("cp1252")


def bluehill(
    *,
    preamble: int = 3,
    names: Row = ("Time", "Extension", "Load"),
    units: Row = ("(s)", "(mm)", "(N)"),
    encoding: str = "ascii",
    rows: list[list[object]] | None = None,
) -> bytes:
    """Raw data with `preamble` lines before a blank one (none at all for 0)."""
    head = "".join(f'Specimen properties : Synthetic {i},"{i}.5",mm\r\n' for i in range(preamble))
    table = lines([names, units], ",")
    body = pull(TIME, TRAVEL, FORCE) if rows is None else rows
    samples = lines(body, ",", quoted=True)
    return (head + ("\r\n" if preamble else "") + table + samples).encode(encoding)


def instron_8800() -> bytes:
    """Controller with a second amplifier: a line of values, then names with units, tabs."""
    names: Row = ["Maschine [mm]", "Kraft [kN]", "Zeit [s]", "MX840A_0_CH 5 [°C]", "Kanal 10"]
    rows = [
        [f"{cell:.5E}" for cell in (s, f / 1e3, t, 0.0, 0.0)]
        for s, f, t in zip(TRAVEL, FORCE, TIME, strict=True)
    ]
    head = "Probe;synthetic;INSTRON 8852TT;0;0;PMD;0\n"
    return (head + lines([names, *rows], "\t").replace("\r", "")).encode()


def zwick_tra(separator: str = ",", *, decimal: str = ".") -> bytes:
    """Parameters, names, units, samples; texts quoted, numbers bare."""
    head = (
        f'"Épaisseur éprouvette"{separator}1{separator}"mm"\n'
        f'"Opérateur"{separator}"synthetic"\n"Vorkraft"{separator}"nicht bekannt"\n'
        f'"Datum"{separator}"20.02.2008"\n'
    )
    titles = [["Prüfzeit", "Standardweg", "Standardkraft"], ["s", "mm", "N"]]
    table = lines(titles, separator, quoted=True)
    body = lines(pull(TIME, TRAVEL, FORCE), separator, decimal=decimal)
    return (head + (table + body).replace("\r", "")).encode("cp1252")


def workbook(sheets: dict[str, Sequence[Row]]) -> bytes:
    import openpyxl

    book = openpyxl.Workbook()
    book.remove(book.worksheets[0])
    for title, rows in sheets.items():
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(list(row))
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def zwick_workbook() -> bytes:
    """Parameters, results and one sheet of values."""
    titles = [["S1"] * 3, ["Test time", "Standard force", "Standard travel"], ["s", "N", "mm"]]
    series = [[None, "Specimen designation", "Fmax"], [None, None, "N"]]
    return workbook(
        {
            "Parameters": [["Test standard", "synthetic"]],
            "Results series": [*series, [None, "S1", float(FORCE.max())]],
            "Values S1": [*titles, *pull(TIME, FORCE, TRAVEL)],
        }
    )


def r_controller() -> bytes:
    """A workbook as described (no real one is known): s, lbf, in."""
    titles: list[Row] = [["TestResources R-Controller", "synthetic"], []]
    names: Row = ["Time (s)", "Force (lbf)", "Displacement (in)"]
    return workbook({"Data": [*titles, names, *pull(TIME, FORCE, TRAVEL)]})


def nexygen(*, mark: bool = False, blanks: bool = True) -> bytes:
    """UTF-16, with or without a byte order mark; first and last cells blank as on export.

    The last line has no line end; every number has the same count of decimals.
    """
    names: Row = ["Time (s)", "Load (N)", "Machine Extension (mm)"]
    rows: list[list[str]] = [[f"{cell:.4f}" for cell in row] for row in pull(TIME, FORCE, TRAVEL)]
    if blanks:
        rows[0][1] = rows[0][2] = rows[1][2] = rows[-1][1] = ""
    text = lines([names, *rows], "\t").removesuffix("\r\n")
    return (b"\xff\xfe" if mark else b"") + text.encode("utf-16-le")


def trapezium(lengths: Sequence[int] = (N,)) -> bytes:
    """Specimens side by side, three columns each; short ones are padded with blanks."""
    groups: list[list[Row]] = []
    for i, length in enumerate(lengths, 1):
        titles: list[Row] = [[f"C{i}", "", ""], ["Temps", "Force", "Stroke"], ["sec", "N", "mm"]]
        groups.append([*titles, *pull(TIME[:length], i * FORCE[:length], TRAVEL[:length])])
    rows = zip_longest(*groups, fillvalue=["", "", ""])
    return lines(map(list, map(chain.from_iterable, rows)), ",", quoted=True).encode("latin-1")


def dion() -> bytes:
    """Walter+Bai: counter in tens, semicolons with decimal points, units in brackets or none."""
    names: Row = ["S/No", "C_1_Temps[s]", "C_1_Force[kN]", "C_1_Cycles[]", "C_1_Déplacement[mm]"]
    counter = 1.0 + 10.0 * np.arange(float(N))
    rows = pull(counter, TIME, np.round(FORCE / 1e3, 7), np.zeros(N), TRAVEL)
    return lines([names, *rows], ";").encode()


def walter_bai() -> bytes:
    """Walter+Bai without time: an index, blanks in the brackets of units, Latin-1."""
    names: Row = ["Index", "Déplacement [ mm ]", "Force [ N ]"]
    rows = [[str(i), *row] for i, row in enumerate(pull(TRAVEL, FORCE))]
    return lines([names, *rows], ",").encode("latin-1")


def catman() -> bytes:
    """A tab after each row but not after the names; a code for a channel without a sensor."""
    names: Row = ["Zeit  1 - Standardmessrate [s]", "Kraft [N]", "Weg [mm]", "Pyrometer [°C]"]
    rows: list[Row] = [[*row, "-1000000", ""] for row in pull(TIME, FORCE, TRAVEL)]
    return lines([names, *rows], "\t").encode("latin-1")


def microtest() -> bytes:
    """Decimal commas above, points below, no leading zero; the last row holds zeros."""
    head = [
        *("File : C:\\SYNTHETIC.MTR saved 2005-01-02 at 06:59:10", "Span : 10,0"),
        *(f"Number of points : {N}", "Ver5.5.29", "", "Test duration : 3,99999999999s"),
    ]
    names = ["Point", "Elongation", "Force", "Position", "Code", "Samplerate", "Motorspeed"]
    rows: list[Row] = [
        [f"{t:g}".removeprefix("0"), s, f, s, 0 if i else 2, 100]
        for i, (t, s, f) in enumerate(pull(TIME, TRAVEL, FORCE))
    ]
    quoted = lines([*([line] for line in head), names], ",", quoted=True)
    body = lines([*rows, ["4.1", 0, 0, 1.6, 1, 100]], ",")
    return (quoted + body.replace("\r\n", ',"0.1 mm/min"\r\n')).replace("\r", "").encode("ascii")


def dma_q800() -> bytes:
    """Time in minutes, displacement in micrometres, names as lines Sig1 to Sig3, UTF-16."""
    head = (
        "CLOSED\r\nVersion\t2.0\r\nInstrument\tDMA Q800 V21.2 Build 73\r\nSample\tsynthetic\r\n"
        "Size\t10.0\t5.0\t0.05\tmm\r\nNsig\t3\r\nSig1\tTime (min)\r\n"
        "Sig2\tDisplacement (µm)\r\nSig3\tStatic Force (N)\r\n"
        "OrgMethod\t1: Ramp force 1.0000 N/min to 18.0000 N\r\nStartOfData\r\n"
    )
    body = lines(pull(TIME / 60.0, 1e3 * TRAVEL, FORCE), "\t")
    return (head + body).encode("utf-16")


TABLE: list[Row] = [["Time (s)", "Force (N)", "Displacement (mm)"], *pull(TIME, FORCE, TRAVEL)]


def table(separator: str = ",") -> bytes:
    """A table of no known program."""
    return lines(TABLE, separator).encode()


def table_workbook() -> bytes:
    """A sheet of no known program."""
    return workbook({"Tabelle1": TABLE})


EXAMPLES: dict[str, tuple[str, Callable[[], bytes]]] = {
    "mts-testsuite": ("synthetic.txt", mts_suite),
    "mts-793": ("synthetic.dat", mts_793),
    "bluehill": ("synthetic.csv", bluehill),
    "instron-8800": ("synthetic.csv", instron_8800),
    "testxpert-tra": ("synthetic.TRA", zwick_tra),
    "testxpert-xlsx": ("synthetic.XLSX", zwick_workbook),
    "testresources": ("synthetic.xlsx", r_controller),
    "nexygen": ("synthetic.txt", nexygen),
    "trapezium": ("synthetic.csv", trapezium),
    "dion": ("synthetic.csv", dion),
    "catman": ("synthetic.ASC", catman),
    "microtest": ("synthetic.MTR", microtest),
    "dma-q800": ("synthetic.txt", dma_q800),
    "table": ("synthetic.csv", table),
    "table-workbook": ("synthetic.xlsx", table_workbook),
}
"""Dialect: name of a file and its content."""
