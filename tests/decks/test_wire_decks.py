from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.optimize import brentq

from labpipe import __version__
from labpipe.mechanics.decks import DECKS, make_deck_texts, write_decks
from labpipe.mechanics.decks.beam_sections import (
    MAX_ANSYS_POINTS,
    compute_shear_stiffness,
    format_abaqus_deck,
    format_ansys_deck,
)
from labpipe.mechanics.decks.calculix import TIP_SET, BarMesh, format_calculix_deck, mesh_half_bar
from labpipe.mechanics.decks.deck_law import (
    compute_skew_bending_error,
    find_linear_range,
    format_percent,
    make_abaqus_label,
    make_ansys_name,
    make_file_stem,
    shorten_name,
)
from labpipe.mechanics.decks.lookup import (
    LOOKUP_COLUMNS,
    format_lookup_csv,
    format_lookup_json,
    format_sliders_csv,
    format_sliders_json,
)
from labpipe.mechanics.decks.unloading import choose_bend_curvatures, make_table_strand_slider
from labpipe.mechanics.law.loss_card import (
    fit_equivalent_material,
    fit_wire_sliders,
)
from labpipe.mechanics.law.sliders import make_unbent_history, slide, split_hardening
from labpipe.mechanics.wire.bending_law import fit_play_law
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire import WireTable
from tests.approved import Approve
from tests.builders.stranded_wires import contacts_of, wire
from tests.builders.wire_tables import loss_card, wire_table


@dataclass
class Block:
    keyword: str
    parameters: dict[str, str]
    data: list[list[float]] = field(default_factory=list)


def parse_blocks(text: str) -> list[Block]:
    """Blocks of an input file, by the syntax rules of its guide."""
    blocks: list[Block] = []
    lines = [line for line in text.splitlines() if not line.startswith("**")]
    while lines:
        line = lines.pop(0)
        assert line.isascii()
        assert len(line) <= 256
        if not line.startswith("*"):
            blocks[-1].data.append([float(value) for value in line.split(",")])
            continue
        while line.rstrip().endswith(","):
            line += lines.pop(0)
        keyword, *parameters = (part.strip() for part in line.split(","))
        pairs = (part.partition("=") for part in parameters)
        blocks.append(Block(keyword, {key.strip(): value.strip() for key, _, value in pairs}))
    return blocks


def get_law(blocks: list[Block], keyword: str) -> tuple[Floats, Floats]:
    block = next(block for block in blocks if block.keyword == keyword)
    assert block.parameters == {}
    moment, curvature = np.array(block.data).T
    return curvature, moment


def head(deck: str) -> str:
    """Comments and keywords of a deck, without its version."""
    lines = re.findall(r"^(?:\*|!|#|<!--).*", deck, re.MULTILINE)
    return "\n".join(lines).replace(__version__, "VERSION")


@pytest.mark.parametrize("ending", [ending for ending in DECKS if not ending.endswith("json")])
def test_what_decks_say(ending: str, approved: Approve) -> None:
    """Of A2, then what differs of a law that stiffens, which sliders cannot have."""
    table = wire_table("A2")
    stiff = replace(table, moment=table.moment * (1.0 + (table.curvature / 50.0) ** 2))
    lines = head(DECKS[ending](table)).splitlines()
    further_lines = [line for line in head(DECKS[ending](stiff)).splitlines() if line not in lines]
    approved([*lines, "", *further_lines])


def test_a_section_of_abaqus() -> None:
    table = wire_table()
    section, axial, _, _, torque = parse_blocks(format_abaqus_deck(table))
    density = float(section.parameters.pop("DENSITY"))
    assert section.parameters == {"SECTION": "NONLINEAR GENERAL", "ELSET": "A2"}
    assert axial.parameters == torque.parameters == {"LINEAR": ""}
    (area, i11, i12, i22, torsion), direction = section.data
    assert area == pytest.approx(np.pi * table.layout.wire_radius**2, rel=1e-8)
    assert density * area == pytest.approx(table.mass_per_length, rel=1e-8)
    assert (i12, i11) == (0.0, i22)
    assert torsion == pytest.approx(2.0 * i11)
    assert direction == [0.0, 0.0, -1.0]
    assert axial.data == [[pytest.approx(table.axial_stiffness, rel=1e-8)]]
    assert torque.data == [[pytest.approx(table.torsional_stiffness, rel=1e-8)]]


@pytest.mark.parametrize("keyword", ["*M1", "*M2"])
def test_the_law_is_kept_within_what_is_stated(keyword: str) -> None:
    table = wire_table()
    text = format_abaqus_deck(table)
    curvature, moment = get_law(parse_blocks(text), keyword)
    assert (curvature[0], moment[0]) == (0.0, 0.0)
    assert curvature[-1] == pytest.approx(table.curvature[-1], rel=1e-11)
    errors = np.interp(table.curvature[1:], curvature, moment) / table.moment[1:] - 1.0
    stated = 0.01 * float(head(text).partition("up to ")[2].split()[0])
    # stated with two digits
    assert np.max(np.abs(errors)) == pytest.approx(stated, rel=0.05, abs=1e-11)
    assert np.all(np.diff(np.diff(moment) / np.diff(curvature)) < 0.0)


@pytest.mark.parametrize(
    "name", ['say "A2"', "*M1\n*STEP", "0,35 mm²", "x" * 300, "! no", "/EOF\n/EXIT", "a # b"]
)
def test_a_name_breaks_nothing(name: str, tmp_path: Path) -> None:
    plain_table, table = wire_table(), replace(wire_table(), name=name)
    blocks = [block.data for block in parse_blocks(format_abaqus_deck(table))]
    assert blocks == [block.data for block in parse_blocks(format_abaqus_deck(plain_table))]
    first, *commands = parse_ansys(format_ansys_deck(table))
    assert first[1][:3] == ["1", "GENB", "PLASTIC"]
    assert commands == parse_ansys(format_ansys_deck(plain_table))[1:]
    frame = pd.read_csv(io.StringIO(format_lookup_csv(table)), comment="#")
    assert frame.shape == (len(plain_table.curvature), len(LOOKUP_COLUMNS))
    files = write_decks({f"../../{name}": make_deck_texts(table)}, tmp_path)
    assert {path.parent for path in files} == {tmp_path / "decks"}


def parse_ansys(text: str) -> list[tuple[str, list[str]]]:
    """Commands and their fields; what follows ``!`` is a comment."""
    commands = []
    for line in text.splitlines():
        assert line.isascii()
        assert len(line) <= 80
        command = line.partition("!")[0].strip()
        if command:
            name, *fields = command.split(",")
            commands.append((name.upper(), fields))
    return commands


def read_ansys_law(text: str, component: str) -> tuple[Floats, Floats]:
    """Strain and force, with the origin that the program understands."""
    points = [[float(v) for v in fields] for name, fields in parse_ansys(text) if name == component]
    strain, force = np.array([[0.0, 0.0], *points]).T
    return strain, force


@pytest.mark.parametrize("wire", ["A2", "C5"])
def test_a_section_of_ansys(wire: str) -> None:
    """By the rules of the program, and within the error that is stated with two digits."""
    table = wire_table(wire)
    text = format_ansys_deck(table, section_number=7)
    first, *_, last = parse_ansys(text)
    assert first == ("SECTYPE", ["7", "GENB", "PLASTIC", wire])
    assert last[0] == "BSMD"
    assert float(last[1][0]) == pytest.approx(table.mass_per_length, rel=1e-8)
    stated = 0.01 * float(text.partition("up to ")[2].split()[0])
    for component in ("BSM1", "BSM2"):
        curvature, moment = read_ansys_law(text, component)
        assert 2 <= len(curvature) - 1 <= MAX_ANSYS_POINTS
        assert np.all(np.diff(curvature) > 0.0)
        assert np.all(np.diff(np.diff(moment) / np.diff(curvature)) < 0.0)
        assert curvature[-1] == pytest.approx(table.curvature[-1], rel=1e-11)
        errors = np.interp(table.curvature[1:], curvature, moment) / table.moment[1:] - 1.0
        assert np.max(np.abs(errors)) == pytest.approx(stated, rel=0.05)
    for component, stiffness, end in (
        ("BSAX", table.axial_stiffness, 0.01),
        ("BSTQ", table.torsional_stiffness, 100.0),
        ("BSS1", compute_shear_stiffness(table), 0.1),
        ("BSS2", compute_shear_stiffness(table), 0.1),
    ):
        strain, force = read_ansys_law(text, component)
        assert strain[-1] == end
        assert force[1:] == pytest.approx(stiffness * strain[1:], rel=1e-8)


def test_shear_adds_a_thousandth_to_ten_diameters() -> None:
    table = wire_table()
    length = 10.0 * table.spec.wire_diameter
    bending = length**3 / (3.0 * table.stick_stiffness)
    assert length / compute_shear_stiffness(table) == pytest.approx(1e-3 * bending)


def blocks_of(text: str) -> list[tuple[str, list[str]]]:
    """Keyword lines, each with its data lines."""
    blocks: list[tuple[str, list[str]]] = []
    for line in text.splitlines():
        assert line.isascii()
        assert len(line) <= 132
        if line.startswith("**"):
            assert not blocks
        elif line.startswith("*"):
            blocks.append((line, []))
        else:
            blocks[-1][1].append(line)
    return blocks


def numbers(lines: list[str]) -> list[list[float]]:
    return [[float(part) for part in line.split(",") if part.strip()] for line in lines]


def test_nodes_and_elements_are_numbered_without_gaps() -> None:
    blocks = dict(blocks_of(format_calculix_deck(wire_table(), n_bricks_along=3))[:6])
    nodes = numbers(blocks["*NODE, NSET=ALL"])
    assert [row[0] for row in nodes] == list(range(1, len(nodes) + 1))
    lines = blocks["*ELEMENT, TYPE=C3D20R, ELSET=WIRE"]
    rows = numbers([first + second for first, second in zip(lines[::2], lines[1::2], strict=True)])
    assert {len(row) for row in rows} == {21}
    assert [row[0] for row in rows] == list(range(1, 19))
    tip = [int(n) for row in numbers(blocks[f"*NSET, NSET={TIP_SET}"]) for n in row]
    assert {nodes[n - 1][1] for n in tip} == {0.085}
    assert {nodes[n - 1][2] for n in tip} == {0.0}


def test_the_material() -> None:
    table = wire_table("A3")
    blocks = dict(blocks_of(format_calculix_deck(table)))
    diameter = 2.0 * table.layout.wire_radius
    expected = fit_equivalent_material(table.curvature[1:], table.moment[1:], diameter)
    assert numbers(blocks["*ELASTIC"]) == [[pytest.approx(expected.modulus, rel=1e-8), 0.3]]
    stress, strain = np.array(numbers(blocks["*PLASTIC"])).T
    assert stress == pytest.approx(expected.stress, rel=1e-8)
    assert strain == pytest.approx(expected.plastic_strain, rel=1e-7)
    assert strain[0] == 0.0
    [[density]] = numbers(blocks["*DENSITY"])
    assert density * np.pi / 4.0 * diameter**2 == pytest.approx(table.mass_per_length, rel=1e-8)


def test_the_tip_goes_to_six_tenths_of_the_length_or_as_far_as_the_law() -> None:
    table = wire_table()
    step = blocks_of(format_calculix_deck(table, n_steps=40))[-5:]
    assert numbers(step[0][1]) == [[0.025, 1.0, 1e-8, 0.025]]
    assert step[1][1] == [f"{TIP_SET}, 2, 2, 0.051"]
    short = replace(table, tip_deflection=table.tip_deflection[:20], tip_force=table.tip_force[:20])
    text, reach = format_calculix_deck(short), table.tip_deflection[19]
    assert f"{TIP_SET}, 2, 2, {reach:.9g}" in text
    assert f"** Free length 0.085 m, tip deflection to {reach:.6g} m." in text


def test_a_wire_without_a_cantilever_gets_the_reason_alone() -> None:
    note = QualityNote("cantilever_cut", Severity.WARNING, "row 2", "no curve: the law stiffens")
    table = replace(wire_table(), tip_deflection=np.zeros(1), tip_force=np.zeros(1), notes=(note,))
    text = format_calculix_deck(table)
    assert all(line.startswith("**") for line in text.splitlines())
    assert text.endswith("** No model:\n** no curve: the law stiffens\n")
    silent = format_calculix_deck(replace(table, notes=()))
    assert silent.endswith("** No model:\n** the table has no cantilever\n")


def test_a_law_that_a_program_cannot_follow_has_no_model_and_a_linear_law_two_points() -> None:
    table = wire_table()
    stiff, linear = (replace(table, moment=1e-6 * table.curvature**power) for power in (2, 1))
    for ending in ("abaqus.inp", "ansys.inp", "calculix.inp"):
        assert re.fullmatch(r"((\*\*|!) .*\n)+", DECKS[ending](stiff))
    assert len(read_ansys_law(format_ansys_deck(linear), "BSM2")[0]) == 3  # with the origin


def test_numbers_out_of_range(approved: Approve) -> None:
    table = wire_table()
    calls: list[Callable[[], object]] = [
        lambda: format_ansys_deck(table, section_number=0),
        lambda: mesh_half_bar(1.5),
        lambda: make_deck_texts(replace(table, moment=table.moment[::-1])),
    ]
    messages = []
    for call in calls:
        with pytest.raises(ValueError) as refused:  # noqa: PT011
            call()
        messages.append(str(refused.value))
    approved(messages)


NATURAL = np.array(
    [
        *[(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)],
        *[(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)],
        *[(0, -1, -1), (1, 0, -1), (0, 1, -1), (-1, 0, -1)],
        *[(0, -1, 1), (1, 0, 1), (0, 1, 1), (-1, 0, 1)],
        *[(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)],
    ]
)


"""Places of the twenty nodes in a brick from -1 to 1 (CalculiX CrunchiX User's Manual)."""


def shapes(at: Floats) -> tuple[Floats, Floats]:
    """Shape functions of the twenty-node brick at a point, (20,), and their slopes, (20, 3)."""
    powers = np.array(
        [(i, j, k) for i in range(3) for j in range(3) for k in range(3) if (i, j, k).count(2) < 2]
    )

    def terms(points: Floats) -> Floats:
        values: Floats = np.prod(points[:, np.newaxis, :] ** powers, axis=2)
        return values

    to_nodes = np.linalg.inv(terms(NATURAL.astype(float)))
    step = 1e-6 * np.eye(3)
    slopes = (terms(at + step) - terms(at - step)) / 2e-6
    return (terms(at[np.newaxis]) @ to_nodes)[0], (slopes @ to_nodes).T


def integrals(mesh: BarMesh) -> Floats:
    """Volume and integral of y^2, with the eight points at which C3D20R is integrated."""
    total = np.zeros(2)
    for point in NATURAL[:8] / np.sqrt(3.0):
        values, slopes = shapes(point)
        for brick in mesh.bricks:
            corners = mesh.nodes[brick - 1]
            volume = np.linalg.det(corners.T @ slopes)
            assert volume > 0.0
            total += volume * np.array([1.0, (values @ corners)[1] ** 2])
    return total


def test_every_brick_is_right_way_round_and_the_section_is_a_half_circle() -> None:
    mesh = mesh_half_bar(2)
    volume, second = integrals(mesh)
    assert volume == pytest.approx(0.5 * np.pi, rel=1e-3)
    assert second == pytest.approx(0.5 * np.pi / 4.0, rel=2e-3)
    assert sorted(set(mesh.bricks.ravel().tolist())) == list(range(1, len(mesh.nodes) + 1))
    assert len(np.unique(mesh.nodes.round(12), axis=0)) == len(mesh.nodes)
    assert mesh.bricks.shape == (12, 20)
    sets = mesh.node_sets
    assert np.ptp(mesh.nodes[sets["CLAMP"], 0]) == 0.0
    assert mesh.nodes[sets[TIP_SET], 0] == pytest.approx(1.0)
    assert np.count_nonzero(sets[TIP_SET]) == 5
    assert (mesh.nodes[:, 2] >= -1e-12).all()
    assert mesh.nodes[sets["CUT"], 1].min() == pytest.approx(-1.0)


def test_every_deck_of_every_wire(tmp_path: Path) -> None:
    tables = [wire_table("A1"), wire_table("A2")]
    for _ in range(2):  # written again in place
        written = write_decks({table.name: make_deck_texts(table) for table in tables}, tmp_path)
        names = [path.relative_to(tmp_path).as_posix() for path in written]
        assert names == [f"decks/{wire}.{ending}" for wire in ("A1", "A2") for ending in DECKS]
        for path, make in zip(written[len(DECKS) :], DECKS.values(), strict=True):
            assert path.read_bytes() == make(tables[1]).encode()


def make_table(curvature: list[float], moment: list[float]) -> WireTable:
    points = wire_table().curvature.shape
    zeros = {
        name: np.zeros(len(curvature))
        for name in WireTable.__annotations__
        if np.shape(getattr(wire_table(), name)) == points
    }
    law = {"curvature": np.array(curvature), "moment": np.array(moment)}
    return replace(wire_table(), **zeros | law)


@pytest.mark.parametrize(
    ("curvature", "moment", "stiffness", "ends"),
    [
        # kappa = 1.05 (0.5 + 0.5 kappa)
        ([0.0, 1.0, 2.0], [0.0, 1.0, 1.5], 1.0, (0.0, 0.525 / 0.475)),
        # 0.97 kappa = 1.05 (0.5 + 0.5 kappa): it starts below the law and leaves above it
        ([0.0, 1.0, 2.0], [0.0, 1.0, 1.5], 0.97, (0.0, 0.525 / (0.97 - 0.525))),
        # 0.8 kappa = (1 -+ 0.05) (0.5 + 0.5 kappa): a softer one on a stretch
        ([0.0, 1.0, 2.0, 9.0], [0.0, 1.0, 1.5, 5.0], 0.8, (0.475 / 0.325, 0.525 / 0.275)),
        # 0.98 kappa = 0.95 (-1 + 2 kappa): it leaves below
        ([0.0, 1.0, 2.0], [0.0, 1.0, 3.0], 0.98, (0.0, 0.95 / (1.9 - 0.98))),
        ([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], 1.04, (0.0, 2.0)),
        ([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], 1.06, None),
        # 0.5 kappa = (1 -+ 0.05) (0.99 + 0.01 kappa): a stretch between two points
        ([0.0, 1.0, 9.0], [0.0, 1.0, 1.08], 0.5, (0.9405 / 0.4905, 1.0395 / 0.4895)),
    ],
)
def test_where_a_linear_law_is_off_by_the_tolerance(
    curvature: list[float],
    moment: list[float],
    stiffness: float,
    ends: tuple[float, float] | None,
) -> None:
    stretch = find_linear_range(make_table(curvature, moment), stiffness)
    assert stretch == (ends if ends is None else pytest.approx(ends, rel=1e-3))


def test_bending_askew_of_a_plateau_is_too_stiff_by_root_two() -> None:
    excess = compute_skew_bending_error(make_table([0.0, 1e-3, 10.0], [0.0, 1.0, 1.0 + 1e-9]))
    assert excess == pytest.approx(np.sqrt(2.0) - 1.0, rel=1e-6)
    linear = compute_skew_bending_error(make_table([0.0, 1.0, 2.0], [0.0, 1.0, 2.0]))
    assert linear == pytest.approx(0.0, abs=1e-12)


HARD = ["A 1", "A_1", "A/1", "a/b\\c", "..", "Käbel 0,35 mm²", "two\nlines", "*M1", "x" * 81]


@given(st.text(min_size=1, max_size=200))
@example("*M1, ELSET=x")
@example("²³")
@example("../../etc")
@example("aux.x")
@example("A2.")
@example("two\nlines\rand\x00 more")
def test_names_become_labels_of_programs_and_files(name: str) -> None:
    assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]{0,79}", make_abaqus_label(name))
    assert re.fullmatch(r"[A-Za-z][A-Za-z0-9]{0,7}", make_ansys_name(name))
    assert re.fullmatch(r"[ -~]{0,32}", shorten_name(name, 32))
    stem = make_file_stem(name)
    assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._ +-]{0,99}", stem)
    assert not stem.endswith((".", " "))
    assert not re.match(r"(con|prn|aux|nul|com1|lpt9) *(\.|$)", stem, re.IGNORECASE)
    for make in (make_abaqus_label, make_file_stem):
        assert len({make(text) for text in [*HARD, name]}) == len({*HARD, name})
        assert [make(text) for text in ("A2", "FLRY-B", "wire_7")] == ["A2", "FLRY-B", "wire_7"]
    assert re.fullmatch(r"x{71}_[0-9a-f]{8}", make_abaqus_label("x" * 81))
    assert shorten_name("Käbel 0,35 mm²", 32) == "Kabel 0,35 mm2"


def test_shares_in_words() -> None:
    shares = (1e-12, 0.00213, 0.0496, 0.83, 0.997, 19.95)
    assert [format_percent(share) for share in shares] == [
        *("0 %", "0.21 %", "5 %", "83 %", "100 %", "1995 %")
    ]


def test_the_csv_gives_the_whole_table_back_to_the_last_digit() -> None:
    table = wire_table()
    frame = pd.read_csv(io.StringIO(format_lookup_csv(table)), comment="#")
    assert list(frame.columns) == [f"{name} [{unit}]" for name, unit in LOOKUP_COLUMNS.items()]
    for name, unit in LOOKUP_COLUMNS.items():
        assert np.array_equal(frame[f"{name} [{unit}]"].to_numpy(), getattr(table, name))


def test_the_json_table() -> None:
    table = wire_table("A2")
    content = json.loads(format_lookup_json(table))
    for name in (
        *("stick_stiffness", "axial_stiffness", "torsional_stiffness", "mass_per_length"),
        *("free_torsional_stiffness", "stretch_twist_coupling"),
    ):
        assert content[name] == getattr(table, name)
    assert (content["wire"], content["length"]) == ("A2", table.spec.length)
    assert content["diameter"] == pytest.approx(table.spec.wire_diameter)
    assert content["range"] == {"curvature": [0.0, table.curvature[-1]], "beyond": "not valid"}
    assert content["curvature"] == table.curvature.tolist()
    assert content["moment"] == table.moment.tolist()
    facts = {"schema", "labpipe", "wire", "range", "law", "torsion", "units", "doubtful_beyond"}
    assert set(content["units"]) == set(content) - facts - {"loss_card"}
    card = loss_card(table.curvature, table.moment)
    losses = content["loss_card"]
    assert losses == json.loads(format_sliders_json(table))["loss_card"]
    assert losses["constant"]["error"] == card.stiffness_error
    assert losses["sliders"]["12"] == dict(card.slider_errors)[12]
    assert losses["directions"]["16"] == dict(card.direction_errors)[16] < losses["directions"]["4"]
    stiff = replace(table, moment=table.moment * (1.0 + (table.curvature / 50.0) ** 2))
    assert json.loads(format_lookup_json(stiff))["loss_card"]["reason"].startswith(
        "the law stiffens"
    )


@pytest.mark.parametrize("share", [None, 0.65])
def test_decks_state_what_they_keep_of_a_bend(share: float | None) -> None:
    """Against the law for moments as the input, and first slopes by hand."""
    table = wire_table("A2")
    table = replace(table, spec=replace(table.spec, isotropic_share=share))
    numbers = json.loads(format_lookup_json(table))["loss_card"]["unloading"]
    bends = np.array(numbers["released_from"])
    assert bends.tolist() == [5.0, 12.0, 23.5]
    assert numbers["isotropic_share"] == ([0.35, 1.0] if share is None else [share, share])
    section = wire("A2")
    moment = np.interp(bends, table.curvature, table.moment)
    columns = np.array(numbers["wire"]["kept"]).T
    shares, kept_shares = [*numbers["isotropic_share"], 0.0], [*columns, numbers["masing"]["kept"]]
    for m, kept_share in zip(shares, kept_shares, strict=True):
        law = fit_play_law(
            section, contacts_of(section), isotropic_share=m, largest_curvature=table.curvature[-1]
        )
        history = law.respond(moment, law.make_unbent_history(len(bends))).history
        released = law.respond(np.zeros(len(bends)), history).curvature
        assert kept_share == pytest.approx(released / bends, abs=0.004)
    lowest, highest = np.array(numbers["wire"]["lost"]).T
    assert np.all(numbers["masing"]["lost"] < lowest)
    assert np.all(lowest <= highest)
    elastic = 1.0 - moment / (table.moment[1] / table.curvature[1] * bends)
    assert numbers["isotropic"]["kept"] == pytest.approx(elastic)


def test_bends_that_a_table_does_not_reach() -> None:
    assert choose_bend_curvatures(wire_table("A2")).tolist() == [5.0, 12.0, 23.5]
    assert choose_bend_curvatures(make_table([0.0, 1.0, 9.0], [0.0, 1.0, 2.0])).tolist() == [5.0]
    assert choose_bend_curvatures(make_table([0.0, 1.0, 2.0], [0.0, 1.0, 2.0])).tolist() == [2.0]


def test_the_growing_slider_of_the_json() -> None:
    """By the words of its `use`: along a loop as the law, first loading as without it."""
    table = wire_table("A2")
    content = json.loads(format_sliders_json(table))
    block, slips = content["growing"], np.array(content["slip_curvatures"])
    assert (block["isotropic_share"], block["share_interval"]) == (0.675, [0.35, 1.0])
    assert set(content["units"]) >= {"slid", "limits", "spring_beside", "sliders_beside"}
    slid, limits = np.array(block["slid"]), np.array(block["limits"])
    slope = (limits[-1] - limits[-2]) / (slid[-1] - slid[-2])

    def limit(q: float) -> float:
        return float(np.interp(q, slid, limits) + slope * max(q - slid[-1], 0.0))

    p, q, stops, moments = 0.0, 0.0, np.zeros(len(slips)), []
    path = np.array([5.0, 23.5, 10.0, 1.0, -20.0, 3.0, 30.0])
    for kappa, change in zip(path, np.diff(path, prepend=0.0), strict=True):
        t = block["stiffness"] * (kappa - p)
        if abs(t) > limit(q):
            total = abs(t) + block["stiffness"] * q
            after = brentq(lambda x: limit(x) + block["stiffness"] * x - total, 0.0, 1e3)  # noqa: B023
            p, q = p + (after - q) * np.sign(t), after
        stops = np.clip(stops + change, -slips, slips)
        moment = block["spring_beside"] * kappa + stops @ np.array(block["sliders_beside"])
        moments.append(moment + block["stiffness"] * (kappa - p))
    law = split_hardening(fit_wire_sliders(table), make_table_strand_slider(table), 0.675)
    rests, expected = make_unbent_history(law, 1), []
    for kappa in path:
        step = slide(law, np.array([kappa]), rests)
        rests = step.history
        expected.append(step.moment[0])
    assert moments == pytest.approx(expected, rel=1e-9)
    assert moments[:2] == pytest.approx(
        np.interp(path[:2], table.curvature, table.moment), rel=5e-3
    )
    masing = replace(table, spec=replace(table.spec, isotropic_share=0.0))
    assert json.loads(format_sliders_json(masing))["growing"] is None


def test_rows_of_the_csv_make_the_law() -> None:
    table = wire_table("A2")
    lines = format_sliders_csv(table).splitlines()
    rows = [line for line in lines if not line.startswith("#")]
    assert rows[0] == "stiffness [N*m^2],slip_curvature [1/m],slip_moment [N*m]"
    numbers = np.array([row.split(",") for row in rows[1:]], dtype=np.float64)
    assert numbers[0, 1:].tolist() == [np.inf, np.inf]
    bent = np.array([0.5, 5.0, 50.0])
    moment = np.minimum(bent[:, None], numbers[:, 1]) @ numbers[:, 0]
    assert moment == pytest.approx(np.interp(bent, table.curvature, table.moment), rel=0.003)
    assert numbers[1:, 2] == pytest.approx(numbers[1:, 0] * numbers[1:, 1])
    assert any("Loss card" in line for line in lines)
    assert any(f"Mass {table.mass_per_length:.9g} kg/m, torsional" in line for line in lines)


def test_numbers_of_the_json() -> None:
    table = wire_table("A2")
    content, law = json.loads(format_sliders_json(table)), fit_wire_sliders(table)
    assert content["stiffnesses"] == law.slider_stiffnesses.tolist()
    assert content["slip_curvatures"] == law.slip_curvatures.tolist()
    assert content["error"] == law.error < 0.003
    assert content["doubtful_beyond"] == table.doubtful_curvature == pytest.approx(37.5)
    assert content["mass_per_length"] == table.mass_per_length
    assert content["loss_card"]["sliders"]["12"] == law.error
    dahl, bent = content["dahl"], table.curvature[1:]
    moment = dahl["stiffness"] * bent + dahl["moment"] * -np.expm1(-bent / dahl["decay"])
    error = np.max(np.abs(moment / table.moment[1:] - 1.0))
    assert error == pytest.approx(content["loss_card"]["dahl"], rel=0.05)
    assert content["scalar_sliders"]["directions"] == 4
    assert set(content["units"]) >= {"stiffness", "slip_curvatures", "slip_moments", "decay"}
