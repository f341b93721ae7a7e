from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from openpyxl import load_workbook

from labpipe.errors import ReadError, StoreError
from labpipe.mechanics.decks import make_deck_texts
from labpipe.mechanics.studies import wire_models as modelling
from labpipe.mechanics.studies.wire_models import model_wires, tabulate_wires
from labpipe.mechanics.studies.wire_sheets import read_wire_sheet
from labpipe.mechanics.wire import wire_table as making
from labpipe.records.wire import WireSpec, WireTable
from tests.approved import Approve
from tests.builders.wire_tables import wire_table
from tests.readers.load_frame.exports import changed, workbook

SHEET = Path("wires.csv")
GOOD = wire_table("A2").spec
HEADING = "wire,wire_diameter_mm,strands,strand_diameter_mm,lay_angles_deg,insulation_thickness_mm"
Row = dict[str, object]
A2: Row = dict(zip(HEADING.split(","), ("A2", 1.6, 7, 0.32, 12, 0.3), strict=True))
ANOTHER = A2 | {"wire": "A3"}


def test_wires_that_cannot_be_modelled_are_refused(
    monkeypatch: pytest.MonkeyPatch, approved: Approve
) -> None:
    """X1 has no room for its strands; the law of B softens, so that it has no deck."""

    def softening(spec: WireSpec) -> WireTable:
        table = making.tabulate_wire(spec)
        return replace(table, moment=table.moment[::-1]) if spec.name == "B" else table

    monkeypatch.setattr(modelling, "tabulate_wire", softening)
    tight = replace(GOOD, name="X1", wire_diameter=1.5e-3, layout="hexagonal", place="line 7")
    soft = replace(GOOD, name="B", place="line 3")
    specs = [replace(GOOD, name="C"), tight, soft, GOOD, replace(GOOD, name="D")]
    names: list[str] = []
    modelled, refused = tabulate_wires(specs, SHEET, names.append)
    assert names == ["C", "X1", "B", "A2", "D"]
    assert [table.name for table, _ in modelled] == ["C", "A2", "D"]
    assert modelled[1][1] == make_deck_texts(modelled[1][0])
    approved(refused.values())


@pytest.fixture
def many(tmp_path: Path) -> Path:
    """A sheet beside earlier results of it."""
    sheet = write_csv(tmp_path, HEADING, "W0,1.4,7,0.26,12,0.3", "W1,1.4,7,0.26,12,0.3")
    (tmp_path / "out" / "decks").mkdir(parents=True)
    (tmp_path / "out" / "decks" / "W0.csv").write_text("earlier", encoding="utf-8")
    return sheet


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def fail(error: BaseException) -> Callable[..., object]:
    def failing(*_: object, **__: object) -> object:
        raise error

    return failing


@pytest.mark.parametrize(
    ("name", "failing", "error", "message"),
    [
        ("write_decks", fail(KeyboardInterrupt()), KeyboardInterrupt, "^$"),
        ("write_decks", fail(OSError(28, "No space left on device")),
         StoreError, "expected room on the disk, found a full disk, or"),
    ],
    ids=["interrupt", "full disk"],
)  # fmt: skip
def test_a_model_that_fails_leaves_earlier_results(
    many: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    failing: Callable[..., object],
    error: type[BaseException],
    message: str,
) -> None:
    monkeypatch.setattr(f"labpipe.mechanics.studies.wire_models.{name}", failing)
    out = many.parent / "out"
    with pytest.raises(error, match=message):
        model_wires(many, out=out, figures=False)
    assert contents(out) == {"W0.csv": b"earlier"}


def write_csv(folder: Path, *lines: str) -> Path:
    path = folder / "w.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def write_book(path: Path, *rows: Row) -> Path:
    names = list(dict.fromkeys(name for row in rows for name in row))
    return workbook(path, {"wires": [names, *([row.get(name) for name in names] for row in rows)]})


@pytest.fixture
def sheet(tmp_path: Path) -> Path:
    return tmp_path / "w.xlsx"


def refusal(path: Path) -> str:
    with pytest.raises(ReadError) as refused:
        read_wire_sheet(path)
    return str(refused.value)


EVERYTHING: Row = {
    "wire": "A5",
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
    "isotropic_share": 0.5,
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


def test_rows_as_they_are_read(sheet: Path, approved: Approve) -> None:
    """A short row; what differs in one that says everything, and in others."""
    from_area: Row = {"strand_diameter_mm": None, "conductor_area_mm2": 0.56}
    [first] = read_wire_sheet(write_book(sheet, A2)).specs
    others = [
        *read_wire_sheet(write_book(sheet, A2 | EVERYTHING)).specs,
        *read_wire_sheet(write_book(sheet, A2 | from_area)).specs,
        *read_wire_sheet(write_book(sheet, A2 | {"strands": 3, "layer_counts": "3"})).specs,
        *read_wire_sheet(
            write_book(sheet, A2 | {"length_mm": 90, "layout": "packed"}, ANOTHER)
        ).specs,
    ]
    usual = asdict(first)
    lines = [f"{name}: {value}" for name, value in usual.items()]
    for spec in others:
        differing = {name: value for name, value in asdict(spec).items() if value != usual[name]}
        lines.append(f"{spec.name}: {differing}")
    approved(lines)
    assert others[1].strand_diameters[0] == pytest.approx(np.sqrt(4 * 0.56e-6 / np.pi / 7))
    [both] = read_wire_sheet(write_book(sheet, A2 | {"conductor_area_mm2": 0.56})).specs
    assert both.strand_diameters == (0.00032, 0.00032)  # 0.563 mm^2: within 2 %
    solid: Row = {"strands": 1, "lay_angles_deg": None, "strand_diameter_mm": 0.8}
    [one] = read_wire_sheet(write_book(sheet, A2 | solid)).specs
    assert (one.layer_counts, one.lay_angles) == ((1,), ())


def test_the_example_sheet_holds_the_wires_of_the_source(
    repository: Path, approved: Approve
) -> None:
    def line(spec: WireSpec) -> str:
        strand, angles = spec.strand_diameters[-1], np.degrees(spec.lay_angles).round(9).tolist()
        assert set(spec.strand_diameters) == {strand}
        sizes = f"{1e3 * spec.wire_diameter:.10g} mm, {spec.layer_counts} of {1e3 * strand:.10g} mm"
        wall = f"wall {1e3 * spec.insulation_thickness:.10g} mm"
        return f"{spec.name}: {sizes}, {angles}, {wall}, {spec.layout}, {', '.join(spec.defaults)}"

    approved(line(spec) for spec in read_wire_sheet(repository / "examples" / "wires.xlsx").specs)


def test_the_sheet_that_is_read(sheet: Path) -> None:
    """The one named wires, also if it is hidden, or else the first that is not."""
    for titles, hidden, place in (
        (("2026",), "", "sheet '2026', row 2"),
        (("old", "Wires"), "", "sheet 'Wires', row 2"),
        (("old", "Wires"), "Wires", "hidden sheet 'Wires', row 2"),
        (("old", "other"), "old", "sheet 'other', row 2"),
    ):
        workbook(sheet, {title: [list(A2), list(A2.values())] for title in titles})
        if hidden:
            book = load_workbook(sheet)
            book[hidden].sheet_state = "hidden"
            book.save(sheet)
        assert read_wire_sheet(sheet).specs[0].place == place


def test_a_csv_of_other_programs(tmp_path: Path) -> None:
    tabbed = HEADING.replace(",", "\t"), "A3\t1.8\t19\t0.24\t12;-15\t0.3"
    [spec] = read_wire_sheet(write_csv(tmp_path, *tabbed)).specs
    assert (spec.layer_counts, spec.place) == ((1, 6, 12), "line 2")
    lines = "sep=,", HEADING, ",".join(map(str, A2.values()))
    assert read_wire_sheet(write_csv(tmp_path, *lines)).specs[0].place == "line 3"


REFUSED_CELLS: list[Row] = [
    {"strands": 8},
    {"strands": 19, "layer_counts": "1;6;11"},
    {"lay_angles_deg": "12;-15", "layer_counts": "1;6"},
    {"lay_angles_deg": 90},
    {"conductor_area_mm2": 0.58},
    {"strand_diameters_mm": "0.3;0.3"},
    {"strand_diameter_mm": None, "strand_diameters_mm": "0.3"},
    {"strand_diameter_mm": None},
    {"insulation_thickness_mm": 0.8},
    {"wire_diameter_mm": None},
    {"wire_diameter_mm": "1,6"},
    {"layout": "hexagon"},
    {"layer_radii_mm": "0;0.3"},
    {"layer_radii_mm": "0.3", "layout": "compressed"},
    {"largest_curvature_per_m": 1250},
    {"length_mm": "=80+5"},
    {"wire": None},
]


def test_rows_that_are_refused(sheet: Path, approved: Approve) -> None:
    approved(refusal(write_book(sheet, A2 | cells)) for cells in REFUSED_CELLS)


def test_all_faults_are_told_at_once(sheet: Path, approved: Approve) -> None:
    """Of headings before those of rows; names that differ in case or accents share a file."""
    more: Row = {"strands": 8, "lay_angles_deg": "x"}
    misspelt = {name.replace("diameter", "diamter"): cell for name, cell in A2.items()}
    accents = [A2 | {"wire": name} for name in ("café", "CAFE\u0301", "STRASSE", "straße")]
    sheets = (
        [A2, A2 | {"wire": "a2"}, ANOTHER | more, A2 | {"wire": "A4", "strands": 8}],
        [misspelt | {"strands": "x"}],
        [A2, ANOTHER, A2, A2 | {"wire": "a3"}],
        accents,
    )
    approved(refusal(write_book(sheet, *rows)) for rows in sheets)


def test_files_that_are_refused(tmp_path: Path, sheet: Path, approved: Approve) -> None:
    messages = [refusal(sheet)]
    write_book(sheet, A2)
    sheet.write_bytes(sheet.read_bytes()[:1500])
    messages.append(refusal(sheet).partition("damaged")[0])
    messages.append(refusal(workbook(sheet, {"Sheet": [list(A2)]})))
    without = changed(
        workbook(tmp_path / "w.xlsx", {"wires": [["wire"]]}),
        lambda text: re.sub("<sheets>.*</sheets>", "<sheets/>", text),
        "xl/workbook.xml",
    )
    messages.append(refusal(without))
    messages.append(refusal(write_csv(tmp_path, "")))
    row = ",".join(map(str, A2.values()))
    messages.append(refusal(write_csv(tmp_path, "Our wires", HEADING, row)))
    messages.append(refusal(write_csv(tmp_path, HEADING, "-,mm,-,mm,deg,mm", row)))
    approved(messages)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.dictionaries(st.sampled_from([*A2, "layout", "layer_counts"]), st.text(max_size=6)))
def test_any_text_is_read_or_refused_in_words(tmp_path: Path, cells: dict[str, str]) -> None:
    row = {name: str(cell) for name, cell in A2.items()} | cells
    quoted = ('"' + cell.replace('"', '""') + '"' for cell in row.values())
    path = write_csv(tmp_path, ",".join(row), ",".join(quoted), "")
    try:
        specs = read_wire_sheet(path).specs
    except ReadError as error:
        message = str(error)
    else:
        message = f"{path}: read"
        assert all(spec.wire_diameter > 0.0 for spec in specs)
    assert message.startswith(str(path))
