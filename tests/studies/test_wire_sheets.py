from __future__ import annotations

import json
import os
import re
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from openpyxl import Workbook

from labpipe.decks import deck_texts
from labpipe.errors import ProcessingError, ReadError, StoreError
from labpipe.records.wire import WireSpec, WireTable
from labpipe.studies import wire_models as modelling
from labpipe.studies.wire_models import ModelledWires, as_json, make_tables, model_wires
from labpipe.studies.wire_specs import read_wire_sheet
from labpipe.wire import wire_table as making
from tests.builders.wire_tables import wire_table
from tests.readers.load_frame.exports import changed, workbook

SHEET = Path("wires.csv")


GOOD = wire_table("A2").spec


TIGHT = replace(GOOD, name="X1", wire_diameter=1.5e-3, layout="hexagonal", place="line 7")


def test_wires_come_in_the_order_of_the_sheet() -> None:
    told: list[str] = []
    made, refused = make_tables([replace(GOOD, name="B"), GOOD], SHEET, told.append)
    assert [wire.table.name for wire in made] == told == ["B", "A2"]
    assert made[1].decks == deck_texts(made[1].table)
    assert not refused


def test_what_is_refused_is_told_with_its_row() -> None:
    made, refused = make_tables([TIGHT, GOOD], SHEET)
    assert [wire.table.name for wire in made] == ["A2"]
    assert list(refused) == ["X1"]
    assert refused["X1"].startswith(
        "wires.csv, line 7, wire 'X1': expected a wire that can be built and bent, found this: "
    )
    assert refused["X1"].endswith("Check its row against the wire.")
    assert "overlap the bore" in refused["X1"]


def test_a_deck_that_cannot_be_made_refuses_its_wire(monkeypatch: pytest.MonkeyPatch) -> None:
    def softening(spec: WireSpec) -> WireTable:
        table = making.wire_table(spec)
        return replace(table, moment=table.moment[::-1]) if spec.name == "B" else table

    monkeypatch.setattr(modelling, "wire_table", softening)
    made, refused = make_tables([replace(GOOD, name="B", place="line 3"), GOOD], SHEET)
    assert [wire.table.name for wire in made] == ["A2"]
    assert refused["B"].startswith("wires.csv, line 3, wire 'B': expected a wire that can be")
    assert (
        "found this: its deck abaqus.inp cannot be made: the law does not go from" in refused["B"]
    )


def test_two_processes_say_what_one_says() -> None:
    specs = [replace(GOOD, name=f"W{number}") for number in range(5)] + [TIGHT]
    with ProcessPoolExecutor(2) as pool:
        made, refused = make_tables(specs, SHEET, pool=pool)
    assert [wire.table.name for wire in made] == [spec.name for spec in specs[:-1]]
    assert list(refused) == ["X1"]
    assert (made[4].table.moment == making.wire_table(GOOD).moment).all()


HEADING = "wire,wire_diameter_mm,strands,strand_diameter_mm,lay_angles_deg,insulation_thickness_mm"


@pytest.fixture
def many(tmp_path: Path) -> Path:
    """A sheet that is worth two processes, beside results of it."""
    rows = [f"W{number},1.4,7,0.26,12,0.3" for number in range(26)]
    sheet = tmp_path / "many.csv"
    sheet.write_text("\n".join((HEADING, *rows)) + "\n", encoding="utf-8")
    (tmp_path / "out" / "decks").mkdir(parents=True)
    (tmp_path / "out" / "decks" / "W0.csv").write_text("earlier", encoding="utf-8")
    return sheet


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_process_that_is_killed_is_told(many: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modelling, "wire_table", lambda _: os._exit(9))
    out = many.parent / "out"
    with pytest.raises(ProcessingError) as told:
        model_wires(many, out=out, figures=False)
    assert str(told.value) == (
        f"{many}: expected processes that model its wires to the end, found that one of them was "
        f"ended from outside, as for want of memory. Close other programs, or split the sheet, and "
        f"run the model again."
    )
    assert contents(out) == {"W0.csv": b"earlier"}


def test_an_interrupt_leaves_earlier_results(many: Path) -> None:
    def say(name: str) -> None:
        if name == "W3":
            raise KeyboardInterrupt

    out = many.parent / "out"
    with pytest.raises(KeyboardInterrupt):
        model_wires(many, out=out, figures=False, say=say)
    assert contents(out) == {"W0.csv": b"earlier"}


def test_an_error_in_a_process_comes_through(many: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        message = "no room for the workbook"
        raise StoreError(message)

    monkeypatch.setattr("labpipe.report.wire_workbook._sheets", fails)
    out = many.parent / "out"
    with pytest.raises(StoreError, match=r"^no room for the workbook$"):
        model_wires(many, out=out, figures=False)
    assert contents(out) == {"W0.csv": b"earlier"}


def test_a_bug_in_a_process_shows_itself(many: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modelling, "wire_table", lambda _: [].pop())
    with pytest.raises(IndexError, match="pop from empty list"):
        model_wires(many, out=many.parent / "out", figures=False)


@pytest.mark.slow
def test_a_disk_that_refuses_is_told(many: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> list[Path]:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(modelling, "write_texts", full)
    out = many.parent / "out"
    with pytest.raises(StoreError, match=r"expected room on the disk, found a full disk\."):
        model_wires(many, out=out, figures=False)
    assert contents(out) == {"W0.csv": b"earlier"}


def test_json_is_plain_and_whole() -> None:
    table: WireTable = wire_table("A2")
    modelled = ModelledWires(SHEET, Path("out"), (table,), {"X1": "why"}, ())
    found = json.loads(json.dumps(as_json(modelled), allow_nan=False))
    assert found["sheet"] == "wires.csv"
    assert found["refused"] == {"X1": "why"}
    wire = found["wires"]["A2"]
    assert wire["moment"] == table.moment.tolist()
    assert wire["cantilever"]["force"] == table.tip_force.tolist()
    assert wire["layout"]["layer"] == [0, 1, 1, 1, 1, 1, 1]


Row = dict[str, object]


A2: Row = {
    "wire": "A2",
    "wire_diameter_mm": 1.6,
    "strands": 7,
    "strand_diameter_mm": 0.32,
    "lay_angles_deg": 12,
    "insulation_thickness_mm": 0.3,
}


def write_book(path: Path, rows: list[Row], *, first: str = "wires") -> Path:
    book = Workbook()
    page = book.active
    assert page is not None
    page.title = first
    names = list(dict.fromkeys(name for row in rows for name in row))
    page.append(names)
    for row in rows:
        page.append([row.get(name) for name in names])
    book.save(path)
    return path


@pytest.fixture
def sheet(tmp_path: Path) -> Path:
    return tmp_path / "w.xlsx"


def one(sheet: Path, **cells: object) -> WireSpec:
    [spec] = read_wire_sheet(write_book(sheet, [A2 | cells]))
    return spec


def faults(sheet: Path, *rows: Row) -> list[str]:
    write_book(sheet, list(rows))
    with pytest.raises(ReadError) as info:
        read_wire_sheet(sheet)
    return [line.removeprefix(f"{sheet}, sheet 'wires', ") for line in str(info.value).split("\n")]


def fault(sheet: Path, **cells: object) -> str:
    [message] = faults(sheet, A2 | cells)
    return message


def test_a_short_row_and_what_is_taken_besides(sheet: Path) -> None:
    spec = one(sheet)
    assert (spec.name, spec.place) == ("A2", "sheet 'wires', row 2")
    assert (spec.wire_diameter, spec.insulation_thickness) == (0.0016, 0.0003)
    assert (spec.layer_counts, spec.strand_diameters) == ((1, 6), (0.00032, 0.00032))
    assert spec.lay_angles == pytest.approx((np.radians(12.0),), rel=1e-11)
    assert spec.defaults == {
        "insulation_modulus": "insulation modulus 1000 MPa",
        "conductor_modulus": "conductor modulus 110 GPa",
        "poisson": "poisson 0.34",
        "insulation_poisson": "insulation poisson 0.4",
        "insulation_strain": "insulation strain 0.03",
        "copper_k": "copper k 530 MPa",
        "copper_n": "copper n 0.44",
        "friction_strand": "friction strand 0.21",
        "friction_insulation": "friction insulation 0.1",
        "radial_force": "radial force 0.15 N",
        "conductor_density": "conductor density 8960 kg/m^3",
        "insulation_density": "insulation density 1400 kg/m^3",
        "length": "length 85 mm",
        "tension": "tension 0 N",
        "orientation": "orientation 0 deg",
        "largest_curvature": "largest curvature at a bending radius of five wire diameters",
        "layout": "layout auto",
    }


def test_a_row_that_says_everything(sheet: Path) -> None:
    row: Row = A2 | {
        "strands": 13,
        "strand_diameter_mm": None,
        "wire_diameter_mm": 2.4,
        "layer_counts": "1;12",
        "strand_diameters_mm": "0.5;0.3",
        "conductor_area_mm2": 1.04,
        "lay_angles_deg": "-15",
        "layer_radii_mm": "0;0.4",
        "insulation_modulus_mpa": 800,
        "conductor_modulus_gpa": 70,
        "poisson": 0.33,
        "insulation_poisson": 0.45,
        "insulation_strain": 0.05,
        "copper_k_mpa": 300,
        "copper_n": 0.2,
        "friction_strand": 0.3,
        "friction_insulation": 0,
        "radial_force_n": 0.2,
        "layout": "Compressed",
        "mass_per_length_g_per_m": 10,
        "length_mm": 100,
        "tension_n": 5,
        "orientation_deg": 90,
        "largest_curvature_per_m": 60,
        "remark": "made up",
    }
    [spec] = read_wire_sheet(write_book(sheet, [row]))
    assert spec.layer_counts == (1, 12)
    assert spec.strand_diameters == (0.0005, 0.0003)
    assert spec.layer_radii == (0.0, 0.0004)
    assert spec.layout == "compressed"
    assert (spec.insulation_modulus, spec.conductor_modulus) == (8e8, 7e10)
    assert (spec.copper_k, spec.copper_n, spec.poisson) == (3e8, 0.2, 0.33)
    assert (spec.friction_strand, spec.friction_insulation, spec.radial_force) == (0.3, 0.0, 0.2)
    assert (spec.length, spec.tension, spec.largest_curvature) == (0.1, 5.0, 60.0)
    assert spec.orientation == pytest.approx(np.pi / 2.0, rel=1e-11)
    assert (spec.mass_per_length, spec.defaults) == (0.01, {})


def test_the_sheet_named_wires_is_read_or_else_the_first(sheet: Path) -> None:
    write_book(sheet, [A2], first="2026")
    assert read_wire_sheet(sheet)[0].place == "sheet '2026', row 2"
    book = Workbook()
    page = book.create_sheet("Wires")
    page.append(list(A2))
    page.append(list(A2.values()))
    book.save(sheet)
    assert read_wire_sheet(sheet)[0].place == "sheet 'Wires', row 2"


def test_a_csv(tmp_path: Path) -> None:
    path = tmp_path / "w.csv"
    cells = ["A3", "1.8", "19", "0.24", "12;-15", "0.3"]
    path.write_text("\t".join(A2) + "\n" + "\t".join(cells) + "\n", encoding="utf-8")
    [spec] = read_wire_sheet(path)
    assert spec.layer_counts == (1, 6, 12)
    assert spec.place == "line 2"


def test_strand_diameter_from_the_area(sheet: Path) -> None:
    spec = one(sheet, strand_diameter_mm=None, conductor_area_mm2=0.56)
    assert spec.strand_diameters[0] == pytest.approx(np.sqrt(4 * 0.56e-6 / np.pi / 7), rel=1e-12)
    both = one(sheet, conductor_area_mm2=0.56)
    assert both.strand_diameters == (0.00032, 0.00032)  # 0.563 mm^2: within 2 %


def test_a_single_strand_has_no_lay(sheet: Path) -> None:
    spec = one(sheet, strands=1, lay_angles_deg=None, strand_diameter_mm=0.8)
    assert (spec.layer_counts, spec.lay_angles) == ((1,), ())


def test_three_strands_without_core(sheet: Path) -> None:
    spec = one(sheet, strands=3, layer_counts="3")
    assert (spec.layer_counts, len(spec.lay_angles)) == ((3,), 1)


def test_a_stress_table_takes_the_place_of_the_copper(tmp_path: Path) -> None:
    (tmp_path / "soft.csv").write_text("strain,stress_mpa\n0.001,110\n0.1,150\n", encoding="utf-8")
    path = tmp_path / "w.csv"
    text = ",".join([*A2, "stress_table", "copper_n"])
    rows = ["A2,1.6,7,0.32,12,0.3,soft.csv,", "A4,1.6,7,0.32,12,0.3,soft.csv,"]
    path.write_text("\n".join([text, *rows]), encoding="utf-8")
    first, second = read_wire_sheet(path)
    assert first.stress_table == ((0.001, 0.1), (110e6, 150e6))
    assert second.stress_table is first.stress_table
    assert not {"conductor_modulus", "copper_k", "copper_n"} & set(first.defaults)
    path.write_text("\n".join([text, rows[0] + "0.4"]), encoding="utf-8")
    with pytest.raises(ReadError) as info:
        read_wire_sheet(path)
    assert str(info.value) == (
        f"{path}, line 2, column 7 (stress_table): expected either a stress table, whose first"
        " slope is the modulus, or the numbers, found a stress table and copper_n."
        " Empty one or the other."
    )


@pytest.mark.parametrize(
    ("cells", "place", "said"),
    [
        (
            {"strands": 8},
            "C2 (strands)",
            ["7 strands", "1 lay angle gives (1 + 6)", "found 8.", "layer_counts"],
        ),
        (
            {"strands": 19, "layer_counts": "1;6;11"},
            "C2 (strands)",
            ["18 strands", "layer counts give (1 + 6 + 11)", "found 19."],
        ),
        (
            {"lay_angles_deg": "12;-15", "layer_counts": "1;6"},
            "E2 (lay_angles_deg)",
            ["each ring of 1 + 6, 1, found 2", "the core has none"],
        ),
        ({"lay_angles_deg": 90}, "E2 (lay_angles_deg)", ["from -80 to 80 deg", "found '90'"]),
        (
            {"conductor_area_mm2": 0.58},
            "G2 (conductor_area_mm2)",
            ["0.563 mm^2", "within 2%", "found 0.58 mm^2"],
        ),
        (
            {"strand_diameters_mm": "0.3;0.3"},
            "G2 (strand_diameters_mm)",
            ["one of both", "strand_diameter_mm and strand_diameters_mm"],
        ),
        (
            {"strand_diameter_mm": None, "strand_diameters_mm": "0.3"},
            "G2 (strand_diameters_mm)",
            ["2 diameters, one per layer, found 1."],
        ),
        (
            {"strand_diameter_mm": None},
            "D2 (strand_diameter_mm)",
            ["a conductor area or a strand diameter", "blank cells", "Fill in conductor_area_mm2"],
        ),
        (
            {"insulation_thickness_mm": 0.8},
            "F2 (insulation_thickness_mm)",
            ["less than half of the wire's 1.6 mm, found 0.8 mm"],
        ),
        (
            {"strand_diameter_mm": 1.1},
            "D2 (strand_diameter_mm)",
            ["bore of 1 mm (1.6 mm less two walls of 0.3 mm), found one of 1.1 mm"],
        ),
        (
            {"strand_diameter_mm": 0.4},
            "D2 (strand_diameter_mm)",
            ["copper in a bore of 1 mm", "0.7854 mm^2, found 0.8796 mm^2"],
        ),
        (
            {"wire_diameter_mm": None},
            "B2 (wire_diameter_mm)",
            ["from 0.05 to 200 mm, found a blank cell. Fill it in."],
        ),
        ({"wire_diameter_mm": "1,6"}, "B2 (wire_diameter_mm)", ["'1,6'", "decimal point: 1.6."]),
        ({"layout": "hexagon"}, "G2 (layout)", ["'hexagon'. Did you mean 'hexagonal'?"]),
        (
            {"layer_radii_mm": "0;0.3"},
            "G2 (layer_radii_mm)",
            ["a blank cell", "layout 'auto' that sets its own", "Say compressed"],
        ),
        (
            {"layer_radii_mm": "0.3", "layout": "compressed"},
            "G2 (layer_radii_mm)",
            ["2 radii that grow, one per layer, found '0.3'"],
        ),
        (
            {"largest_curvature_per_m": 1250},
            "G2 (largest_curvature_per_m)",
            ["below 1250 1/m", "found 1250 1/m"],
        ),
        ({"wire": None}, "A2 (wire)", ["a name, found a blank cell. Name the wire."]),
    ],
)
def test_rows_that_are_refused(sheet: Path, cells: Row, place: str, said: list[str]) -> None:
    message = fault(sheet, **cells)
    assert message.startswith(f"cell {place}: expected ")
    assert [words for words in said if words not in message] == []


def test_all_faults_are_told_at_once(sheet: Path) -> None:
    rows = [A2, A2 | {"wire": "a2"}, A2 | {"wire": "A3", "strands": 8, "lay_angles_deg": "x"}]
    rows.append(A2 | {"wire": "A4", "strands": 8})
    assert [line.partition(":")[0] for line in faults(sheet, *rows)] == [
        "cell A3 (wire)",
        "cell E4 (lay_angles_deg)",
        "cell C5 (strands)",
    ]


def test_headings_are_told_before_the_rows(sheet: Path) -> None:
    row = {name.replace("diameter", "diamter"): cell for name, cell in A2.items()}
    first, second = faults(sheet, row | {"strands": "x"})
    assert first.startswith("cell B1: expected one of 'wire_diameter_mm', ")
    assert first.endswith("found 'wire_diamter_mm'. Did you mean 'wire_diameter_mm'?")
    assert second.startswith("cell D1: expected one of 'strand_diameter_mm', ")
    assert second.endswith("found 'strand_diamter_mm'. Did you mean 'strand_diameter_mm'?")


def written(tmp_path: Path, *lines: str) -> Path:
    path = tmp_path / "w.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def refused(path: Path) -> list[str]:
    with pytest.raises(ReadError) as info:
        read_wire_sheet(path)
    return [line.removeprefix(f"{path}, ") for line in str(info.value).split("\n")]


A2_LINES = (",".join(A2), ",".join(str(cell) for cell in A2.values()))


def test_a_title_above_the_heading_and_units_below_it(tmp_path: Path) -> None:
    units = "-,mm,-,mm,deg,mm"
    assert refused(written(tmp_path, "Our wires", A2_LINES[0], units, A2_LINES[1])) == [
        "line 1, column 1: expected the heading in the first row that is not blank,"
        " found 'Our wires'. Remove the lines above the heading at line 2, column 1.",
        "line 3, column 1: expected a wire, found a row of units (-, mm, -, ...)."
        " Remove it: the unit is part of a column's name.",
    ]
    assert read_wire_sheet(written(tmp_path, "sep=,", *A2_LINES))[0].place == "line 3"


def test_an_empty_csv(tmp_path: Path) -> None:
    path = written(tmp_path, "")
    assert refused(path) == [
        f"{path}: expected a file with content, found an empty file (0 bytes)."
        " Save or export it again."
    ]


def test_a_blank_cell_of_a_column_that_is_there_is_told_as_such(sheet: Path) -> None:
    long, blank = read_wire_sheet(
        write_book(sheet, [A2 | {"length_mm": 90, "layout": "packed"}, A2 | {"wire": "A3"}])
    )
    assert not {"length", "layout"} & set(long.defaults)
    assert blank.defaults["length"] == "length 85 mm (blank in this row)"
    assert blank.defaults["layout"] == "layout auto (blank in this row)"
    assert blank.defaults["tension"] == "tension 0 N"


def test_a_hidden_sheet_is_called_so_and_taken_by_its_name_only(sheet: Path) -> None:
    book = Workbook()
    page = book.active
    assert page is not None
    for name in ("old", "Wires"):
        page = book.create_sheet(name)
        page.append(list(A2))
        page.append(list(A2.values()))
    book["Wires"].sheet_state = "hidden"
    book.save(sheet)
    assert read_wire_sheet(sheet)[0].place == "hidden sheet 'Wires', row 2"
    book["Wires"].title, book["Sheet"].sheet_state = "other", "hidden"
    book.save(sheet)
    assert read_wire_sheet(sheet)[0].place == "sheet 'old', row 2"


def test_a_cell_with_an_error_is_told_with_its_sheet(sheet: Path) -> None:
    assert fault(sheet, length_mm="=80+5") == (
        "cell G2: expected a value, found a formula without a stored value."
        " Open the workbook in the spreadsheet program and save it."
    )


def test_a_sheet_without_wires(sheet: Path) -> None:
    write_book(sheet, [A2])
    book = Workbook()
    page = book.active
    assert page is not None
    page.append(list(A2))
    book.save(sheet)
    with pytest.raises(ReadError) as info:
        read_wire_sheet(sheet)
    assert str(info.value) == (
        f"{sheet}, sheet 'Sheet': expected a heading and one row per wire, found 1 rows."
        " Fill in the table."
    )


def test_a_workbook_without_sheets(tmp_path: Path) -> None:
    path = changed(
        workbook(tmp_path / "w.xlsx", {"wires": [["wire"]]}),
        lambda text: re.sub("<sheets>.*</sheets>", "<sheets/>", text),
        "xl/workbook.xml",
    )
    with pytest.raises(ReadError) as refused:
        read_wire_sheet(path)
    assert str(refused.value) == (
        f"{path}: expected a wire sheet, found a workbook without sheets. Name the wire sheet."
    )


def test_damaged_and_missing_files(sheet: Path) -> None:
    with pytest.raises(ReadError, match=r"expected a file, found none of that name"):
        read_wire_sheet(sheet)
    write_book(sheet, [A2])
    sheet.write_bytes(sheet.read_bytes()[:1500])
    with pytest.raises(ReadError, match=r"expected an xlsx workbook, found a damaged one"):
        read_wire_sheet(sheet)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.dictionaries(st.sampled_from([*A2, "layout", "layer_counts"]), st.text(max_size=6)))
def test_any_text_is_read_or_refused_in_words(tmp_path: Path, cells: dict[str, str]) -> None:
    path = tmp_path / "w.csv"
    row = {name: str(cell) for name, cell in A2.items()} | cells
    quoted = ('"' + cell.replace('"', '""') + '"' for cell in row.values())
    path.write_text(",".join(row) + "\n" + ",".join(quoted) + "\n", encoding="utf-8")
    try:
        specs = read_wire_sheet(path)
    except ReadError as error:
        message = str(error)
    else:
        message = f"{path}: read"
        assert all(spec.wire_diameter > 0.0 for spec in specs)
    assert message.startswith(str(path))


TWO, THREE = (12.0, -15.0), (12.0, -15.0, 12.0)


EXAMPLES = {  # wire and strand diameter, mm (area, mm^2, for compressed strands), lay angles, wall
    "A1": (1.4, 0.26, (12.0,), 0.3),
    "A2": (1.6, 0.32, (12.0,), 0.3),
    "A3": (1.8, 0.24, TWO, 0.3),
    "B1": (1.1, 2.0 * np.sqrt(0.35 / 7.0 / np.pi), (12.0,), 0.2),
    "B2": (1.25, 2.0 * np.sqrt(0.49 / 7.0 / np.pi), (12.0,), 0.2),
    "C1": (1.4, 0.16, TWO, 0.3),
    "C2": (1.6, 0.19, TWO, 0.3),
    "C3": (1.8, 0.23, TWO, 0.3),
    "C4": (2.1, 0.21, THREE, 0.3),
    "C5": (2.6, 0.26, THREE, 0.3),
}


def test_the_example_sheet_holds_the_wires_of_the_source(repository: Path) -> None:
    specs = read_wire_sheet(repository / "examples" / "wires.xlsx")
    assert [spec.name for spec in specs] == list(EXAMPLES)
    for spec, (outer, strand, angles, wall) in zip(specs, EXAMPLES.values(), strict=True):
        assert spec.wire_diameter == pytest.approx(outer * 1e-3, rel=1e-12)
        counts = (1, 6, 12, 18)[: len(angles) + 1]
        assert spec.layer_counts == counts
        assert spec.strand_diameters == pytest.approx([strand * 1e-3] * len(counts), rel=1e-11)
        assert np.degrees(spec.lay_angles) == pytest.approx(angles, rel=1e-10)
        assert spec.insulation_thickness == pytest.approx(wall * 1e-3, rel=1e-12)
        assert spec.layout == ("compressed" if spec.name.startswith("B") else "auto")
        others = {
            f"{what}_{which}"
            for what, which in (
                ("conductor", "density"),
                ("insulation", "density"),
                ("insulation", "poisson"),
                ("insulation", "strain"),
            )
        }
        assert set(spec.defaults) == {"tension", "orientation", "largest_curvature"} | others


def test_names_that_share_a_file_are_told_with_both_cells(sheet: Path) -> None:
    again, like = faults(sheet, A2, A2 | {"wire": "A3"}, A2, A2 | {"wire": "a3"})
    assert again.startswith("cell A4 (wire): expected each wire once, found 'A2' again, as in ")
    assert again.endswith("cell A2. Give each wire a name of its own.")
    assert like.startswith("cell A5 (wire): expected names that differ in more than the case")
    assert "found 'a3', and 'A3' in sheet 'wires', cell A3." in like
    accents = [A2 | {"wire": name} for name in ("caf\u00e9", "CAFE\u0301", "STRASSE", "straße")]
    assert [line.partition(" ")[0] for line in faults(sheet, *accents)] == ["cell", "cell"]


def with_table(path: Path, name: str, *rows: list[object]) -> Path:
    book = Workbook()
    page, table = book.active, book.create_sheet("soft")
    assert page is not None
    page.title = "wires"
    page.append([*A2, "stress_table"])
    page.append([*A2.values(), name])
    for cells in rows:
        table.append(cells)
    book.save(path)
    return path


def test_a_stress_table_of_the_workbook_in_other_letters(sheet: Path) -> None:
    rows: list[list[object]] = [["Strain", "stress_MPa", "from"], [0, 0, "us"], [0.001, 110, "us"]]
    [spec] = read_wire_sheet(with_table(sheet, "SOFT", *rows))
    assert spec.stress_table == ((0.001,), (110e6,))


@pytest.mark.parametrize(
    ("name", "rows", "said"),
    [
        ("soft", [["strain", "stress"], [0.1, 1]], "sheet 'soft', cell A1: expected a column 'str"),
        ("soft", [["strain", "stress_mpa"]], "sheet 'soft': expected a heading and one row per po"),
        (
            "sofd",
            [["strain", "stress_mpa"]],
            "sheet 'wires', cell G2 (stress_table): expected the name of a sheet ('soft', 'wires')",
        ),
        (
            "soft",
            [["strain", "stress_mpa"], [0.001, "x"], [5, None]],
            "sheet 'soft', cell B2 (stress_mpa): expected a number from 0 to 100000 MPa, found 'x'",
        ),
        (
            "soft",
            [["strain", "stress_mpa"], [0.002, 110], [0.001, 120]],
            "sheet 'soft', cell A3 (strain): expected a strain above 0.002, found 0.001. Put the",
        ),
    ],
)
def test_stress_tables_that_are_refused(
    sheet: Path, name: str, rows: list[list[object]], said: str
) -> None:
    first, *others = refused(with_table(sheet, name, *rows))
    assert first.startswith(said)
    assert [line.partition(":")[0] for line in others] in (
        [],
        ["sheet 'soft', cell A3 (strain)", "sheet 'soft', cell B3 (stress_mpa)"],
    )


def test_a_stress_table_beside_a_csv(tmp_path: Path) -> None:
    text = ",".join([*A2, "stress_table"])
    path = written(
        tmp_path,
        text,
        f"{A2_LINES[1]},../soft.csv",
        "A3" + A2_LINES[1].removeprefix("A2") + ",none.csv",
    )
    outside, missing = refused(path)
    assert outside.startswith("line 2, column 7 (stress_table): expected the name of a csv in the")
    assert missing.startswith(f"{tmp_path / 'none.csv'}: expected a file, found none of that name")


def test_a_stress_table_of_the_insulation_beside_a_csv(tmp_path: Path) -> None:
    path, text = tmp_path / "wires.csv", ",".join([*A2, "insulation_table"])
    text += f"\n{','.join(map(str, A2.values()))},pvc.csv\n"
    path.write_text(text)
    (tmp_path / "pvc.csv").write_text("strain,stress_mpa\n0.01,10\n0.1,24\n")
    [spec] = read_wire_sheet(path)
    assert spec.insulation_table == ((0.01, 0.1), (10e6, 24e6))
    assert not {"insulation_modulus", "insulation_strain"} & set(spec.defaults)
    (tmp_path / "pvc.csv").write_text("strain,stress_mpa\n0.01,10\n0.1,8\n")
    with pytest.raises(
        ReadError, match=r"pvc\.csv, line 3, column 2 \(stress_mpa\): expected a stress of 10"
    ):
        read_wire_sheet(path)
    path.write_text(text.replace("pvc.csv", "none.csv"))
    with pytest.raises(ReadError, match=r"none\.csv"):
        read_wire_sheet(path)
