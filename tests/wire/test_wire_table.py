"""Tables of wires: what a specification builds, law, cantilever, notes, and other numbers."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe.mechanics.law.loss_card import fit_wire_sliders
from labpipe.mechanics.law.sliders import compute_first_loading
from labpipe.mechanics.law.thinning import make_concave_law
from labpipe.mechanics.studies.harness_line import (
    LOG_MASS_FACTOR,
    LOG_MOMENT_FACTOR,
    LOG_TORSION_FACTOR,
    make_section_function,
)
from labpipe.mechanics.studies.wire_sheets import read_wire_sheet
from labpipe.mechanics.wire.bending_law import (
    Contacts,
    compute_moment_curve,
    compute_stick_stiffness,
)
from labpipe.mechanics.wire.cantilever import bend_to_deflection
from labpipe.mechanics.wire.first_loading import compute_end_load_path, interpolate_end_load
from labpipe.mechanics.wire.materials import RambergOsgood, StressTable
from labpipe.mechanics.wire.wire_table import (
    build_wire,
    find_law_range,
    make_curvature_grid,
    make_layers,
    replace_parameters,
    tabulate_wire,
)
from labpipe.records.wire import (
    COPPER_SCALE,
    INSULATION_MODULUS,
    RADIAL_FRICTION,
    WireSpec,
    WireTable,
)
from labpipe.units import GRAVITY
from tests.approved import Approve
from tests.builders.cantilevers import hold_level
from tests.builders.wire_tables import codes, spec_of, told
from tests.builders.wire_tables import wire_table as table_of

A2 = WireSpec(
    "A2", 1.6e-3, (1, 6), (0.32e-3,) * 2, (float(np.radians(12.0)),), 0.3e-3, place="line 2"
)

LEVEL = spec_of("A2", "A2")

LAYS = (float(np.radians(12.0)), float(np.radians(-15.0)))

C3 = WireSpec("C3", 1.8e-3, (1, 6, 12), (0.23e-3,) * 3, LAYS, 0.3e-3, place="line 3")

TABLE = ((0.001, 0.01), (110e6, 150e6))

HEXAGONAL = {"C1": 1.46, "C2": 2.85, "C3": 5.95, "C4": 15.6, "C5": 36.4}

"""Stick stiffness, 1e-3 N m^2, of the source's Table 3.5 as hexagons."""


@pytest.fixture(scope="module")
def examples() -> dict[str, WireTable]:
    sheet = Path(__file__).resolve().parents[2] / "examples" / "wires.xlsx"
    return {spec.name: tabulate_wire(spec) for spec in read_wire_sheet(sheet).specs}


def test_every_example_has_a_table_over_its_whole_range(examples: dict[str, WireTable]) -> None:
    for name, expected in HEXAGONAL.items():
        assert examples[name].layout.kind == "hexagonal"
        assert 1e3 * examples[name].stick_stiffness == pytest.approx(expected, rel=3e-3)
    for name, table in examples.items():
        assert codes(table) in (["defaults_taken"], ["defaults_taken", "overlap_tolerated"]), name
        assert table.curvature[0] == table.moment[0] == 0.0
        assert table.curvature[-1] == pytest.approx(1.0 / (5.0 * table.spec.wire_diameter))
        assert np.all(np.diff([table.curvature, table.moment]) > 0.0)
        assert np.isin(table.slip_onsets, table.curvature).all()
        parts = table.stick + table.slip + table.bending + table.plastic + table.insulation
        assert parts == pytest.approx(table.moment, rel=1e-12, abs=1e-18)
        assert np.all(table.lowest_moment <= table.moment)
        assert np.all(table.moment <= table.highest_moment)
        assert table.secant_stiffness[0] == table.tangent_stiffness[0]
        assert table.tangent_stiffness[0] == pytest.approx(table.stick_stiffness, rel=1e-6)
        assert len(table.tip_force) >= 40
        assert table.tip_deflection[-1] == pytest.approx(0.8 * table.spec.length)
        assert np.all(np.diff(table.tip_force) > 0.0)
    # straight lines between the points of a table are within 0.1 % of the law
    table = examples["C4"]
    built = build_wire(table.spec)
    between = (table.curvature[1:-1] + table.curvature[2:]) / 2.0
    moment = compute_moment_curve(built.section, built.contacts, between).moment
    assert np.interp(between, table.curvature, table.moment) == pytest.approx(moment, rel=1e-3)


def test_the_grid_gives_way_to_the_onsets() -> None:
    onsets = np.array([1e-3, 0.02])
    grid = make_curvature_grid(100.0, onsets)
    assert np.isin(onsets, grid).all()
    assert grid[0] == 0.0
    assert grid[-1] == 100.0
    assert len(grid) in (202, 203)
    assert np.all(np.diff(grid[1:]) > 5e-5 * grid[1:-1])


SOFT = ((0.01, 0.03, 0.1, 0.3), (10e6, 18e6, 24e6, 30e6))

"""A made-up curve of soft PVC: 1 GPa at first."""


@pytest.mark.parametrize("length", [0.085, 1.0])
def test_loads_between_the_points_are_those_of_the_solver(length: float) -> None:
    """From 0.2 % of the length on; with even points a wire of 1 m was 38 % off at 5 mm."""
    table = tabulate_wire(replace(LEVEL, length=length))
    law = make_concave_law(table.curvature[1:], table.moment[1:])
    weight = 0.0 if table.rest is None else GRAVITY * table.mass_per_length
    for deflection in (0.002 * length, 5e-3, 10e-3, 0.3 * length):
        path = compute_end_load_path(law, length, np.array([deflection]), self_weight=weight)
        assert interpolate_end_load(table, deflection) == pytest.approx(path.load[0], rel=1e-3)


NAMES = ("A2", "C5")


@pytest.mark.parametrize("name", NAMES)
def test_its_own_numbers_give_the_law_it_was_made_from(name: str) -> None:
    table = table_of(name)
    own, base = make_section_function(table.spec, {})({}), fit_wire_sliders(table)
    assert own.law.spring_stiffness == pytest.approx(base.spring_stiffness, rel=1e-9)
    assert own.law.slider_stiffnesses == pytest.approx(base.slider_stiffnesses, rel=1e-6)
    numbers = (own.torsional_stiffness, own.axial_stiffness, own.coupling, own.mass_per_length)
    assert numbers == (
        table.torsional_stiffness,
        table.axial_stiffness,
        table.stretch_twist_coupling,
        table.mass_per_length,
    )


@pytest.mark.parametrize(
    "values", [{INSULATION_MODULUS: 0.6e9}, {COPPER_SCALE: 1.3}, {RADIAL_FRICTION: 0.09}]
)
@pytest.mark.parametrize("name", NAMES)
def test_other_numbers_give_the_law_of_their_wire(name: str, values: dict[str, float]) -> None:
    """From 1 1/m on: below, strands begin to slip, and a moment lost there has no weight."""
    own, changes = table_of(name), {key: float(np.log(value)) for key, value in values.items()}
    law = make_section_function(own.spec, {})(changes).law
    assert law.slip_curvatures == pytest.approx(fit_wire_sliders(own).slip_curvatures, rel=0.0)
    table = tabulate_wire(replace_parameters(own.spec, values))
    inside = table.curvature > 1.0
    moment = compute_first_loading(law, table.curvature[inside])
    assert np.max(np.abs(moment / table.moment[inside] - 1.0)) < 0.015


def test_contacts_materials_and_layers() -> None:
    """Inner rings touch strands, the outermost the insulation."""
    insulation = build_wire(A2).section.insulation
    assert insulation is not None
    assert insulation.bore_radius == pytest.approx(0.5e-3)
    assert build_wire(A2).contacts == Contacts((0.21,), (0.10,), 0.15)
    assert build_wire(C3).contacts == Contacts((0.21, 0.21), (0.21, 0.10), 0.15)
    copper = RambergOsgood(110e9, 530e6, 0.44)
    assert make_layers(A2)[0].material == copper
    table = make_layers(replace(A2, stress_table=TABLE))[0].material
    assert isinstance(table, StressTable)
    assert table.modulus == 110e9
    assert [layer.lay_angle for layer in make_layers(C3)] == [0.0, *LAYS]
    strand = replace(A2, layer_counts=(3,), strand_diameters=(0.3e-3,))
    assert make_layers(strand)[0].lay_angle == LAYS[0]
    assert tabulate_wire(A2).mass_per_length == pytest.approx(6.856e-3, rel=1e-3)
    assert tabulate_wire(replace(A2, mass_per_length=8e-3)).mass_per_length == 8e-3


NOTED: dict[str, tuple[WireSpec, list[str]]] = {
    "defaults": (replace(A2, defaults={"length": "length 85 mm"}), ["defaults_taken"]),
    "too tight": (replace(C3, wire_diameter=1.73e-3), ["layout_fallback"]),
    "close": (replace(C3, strand_diameters=(0.24004e-3,) * 3), ["overlap_tolerated"]),
    "helices": (replace(A2, lay_angles=(np.radians(25.0),)), ["helices_overlap"]),
    "tension": (replace(A2, tension=20.0), ["tension_yields", "tension"]),
    "stress table": (
        replace(A2, stress_table=TABLE, tension=300.0),
        ["tension_yields", "range_shortened", "tension", "cantilever_cut"],
    ),
    "insulation's table": (
        replace(A2, insulation_table=((0.01, 0.05), (10e6, 20e6))),
        ["range_shortened", "cantilever_cut"],
    ),
    "no force": (replace(A2, radial_force=0.0), ["slips_at_once"]),
    "never slips": (replace(A2, radial_force=1e6), []),
    "short law": (replace(LEVEL, largest_curvature=20.0), ["cantilever_cut"]),
    "limp": (replace(LEVEL, length=3.0), ["weight_left_out"]),
}


def test_notes_of_wires(approved: Approve) -> None:
    lines = []
    for name, (spec, expected) in NOTED.items():
        table = tabulate_wire(spec)
        assert codes(table) == expected, name
        notes = told(table) or table.notes
        lines += [f"{name}: {n.code}, {n.severity}, {n.where}: {n.message}" for n in notes]
        assert np.all(np.isfinite(table.moment))
        assert np.all(np.diff(table.curvature) > 0.0)
    approved(lines)


def test_the_range_of_the_law() -> None:
    assert find_law_range(A2)[0] == pytest.approx(125.0)
    assert find_law_range(A2)[1] == []
    assert find_law_range(replace(A2, largest_curvature=60.0)) == (60.0, [])
    assert find_law_range(replace(A2, stress_table=((0.001, 0.5), (110e6, 150e6))))[1] == []
    soft = replace(A2, stress_table=TABLE)
    assert find_law_range(soft)[0] == pytest.approx(2.0 * 0.01 / 0.32e-3)
    assert find_law_range(soft, axial_strain=0.002)[0] == pytest.approx(2.0 * 0.008 / 0.32e-3)
    table = tabulate_wire(NOTED["insulation's table"][0])
    assert table.curvature[-1] == pytest.approx(62.5)


def test_numbers_that_the_notes_name() -> None:
    spec = replace(A2, layer_counts=(3,), strand_diameters=(0.3e-3,), layout="packed")
    built = build_wire(spec)
    assert [note.code for note in built.notes] == ["bore_loose", "layout_eccentric"]
    off = np.hypot(built.section.x.mean(), built.section.y.mean())
    turns = np.linspace(0.0, np.pi, 7)
    stiffness = [compute_stick_stiffness(built.section, orientation=turn) for turn in turns]
    pattern = r"is (\S+) mm from the axis, (\S+) %.*: (\S+) to (\S+) N"
    numbers = re.findall(pattern, built.notes[1].message)[0]
    distance, share, least, most = map(float, numbers)
    assert (distance, share) == pytest.approx((1e3 * off, 100.0 * off / 0.5e-3), rel=0.02)
    assert least <= min(stiffness) * 1.001
    assert most >= max(stiffness) * 0.999
    assert most > 1.2 * least
    around = build_wire(replace(A2, wire_diameter=1.56e-3, layout="packed"))
    assert "layout_eccentric" not in [note.code for note in around.notes]
    assert build_wire(replace(NOTED["stress table"][0], tension=1.0)).notes == ()
    assert tabulate_wire(replace(A2, tension=20.0)).moment[100] > tabulate_wire(A2).moment[100]


@pytest.mark.parametrize(("force", "sticks"), [(0.0, False), (1e-9, False), (1e6, True)])
def test_strands_slip_at_once_or_not_within_the_range(force: float, sticks: bool) -> None:
    table = tabulate_wire(replace(A2, radial_force=force))
    assert table.slips_immediately != sticks
    assert ("slips_at_once" in codes(table)) != sticks
    stiffness = table.stick_stiffness if sticks else table.slip_stiffness
    assert table.secant_stiffness[1] == pytest.approx(stiffness, rel=1e-2)
    if sticks:
        assert table.slip_onsets.shape == (0,)
        assert table.find_slip_onset(0) == "beyond"


def test_a_law_that_softens_or_stiffens(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first is refused with the curvature, the second has no cantilever."""

    def changed(rise: float) -> Callable[..., object]:
        def curve_of(*arguments: Any, **options: Any) -> object:
            curve = compute_moment_curve(*arguments, **options)
            return replace(curve, insulation=curve.insulation + rise * (curve.curvature > 10.0))

        return curve_of

    monkeypatch.setattr("labpipe.mechanics.wire.wire_table.compute_moment_curve", changed(-1e-3))
    message = (
        r"the law softens: the moment falls from (\S+) N m at 9\.\d+ 1/m to (\S+) N m at 10\.\d+ "
    )
    with pytest.raises(ValueError, match=message):
        tabulate_wire(A2)
    monkeypatch.setattr("labpipe.mechanics.wire.wire_table.compute_moment_curve", changed(1e-2))
    table = tabulate_wire(A2)
    assert codes(table) == ["cantilever_cut"]
    assert told(table)[0].message.startswith("no curve of the cantilever: the law stiffens at")
    assert table.tip_force.tolist() == [0.0]


def test_beyond_the_insulations_straight_line_the_table_is_doubtful() -> None:
    """3 % of strain at the rim: twice that over the diameter."""
    table = tabulate_wire(A2)
    assert codes(table) == []
    assert [note.code for note in table.notes] == ["insulation_doubtful"]
    assert table.doubtful_curvature == pytest.approx(37.5)
    np.testing.assert_array_equal(table.is_doubtful, table.curvature > 37.5)
    shares = np.interp([1.0, 10.0, 125.0], table.curvature, table.insulation_share)
    assert shares == pytest.approx([0.50, 0.76, 0.93], abs=0.01)
    law = make_concave_law(table.curvature[1:], table.moment[1:])
    rest = hold_level(law, A2.length, GRAVITY * table.mass_per_length).state
    shape = bend_to_deflection(law, rest, A2.length, table.doubtful_deflection)
    assert shape.curvature[0] == pytest.approx(37.5, rel=3e-3)
    assert not tabulate_wire(replace(A2, insulation_strain=0.2)).notes
    soft = tabulate_wire(replace(A2, insulation_table=SOFT))
    small = table.curvature * 0.8e-3 < 0.01
    assert soft.insulation[small] == pytest.approx(table.insulation[small], rel=1e-9)
    assert soft.moment[-1] < 0.5 * table.moment[-1]
    assert not soft.is_doubtful.any()


def test_factors_multiply_moment_torsion_mass_and_tables() -> None:
    build_section = make_section_function(table_of("A2").spec, {})
    plain = build_section({})
    made = build_section({LOG_MOMENT_FACTOR: 0.1, LOG_TORSION_FACTOR: -0.2, LOG_MASS_FACTOR: 0.05})
    assert made.law.slider_stiffnesses == pytest.approx(np.exp(0.1) * plain.law.slider_stiffnesses)
    assert made.law.spring_stiffness == pytest.approx(np.exp(0.1) * plain.law.spring_stiffness)
    assert made.torsional_stiffness == pytest.approx(np.exp(-0.2) * plain.torsional_stiffness)
    assert made.mass_per_length == pytest.approx(np.exp(0.05) * plain.mass_per_length)
    spec = replace(table_of("A2").spec, insulation_table=((0.01, 0.1), (10e6, 50e6)))
    grown = replace_parameters(spec, {INSULATION_MODULUS: 2e9}).insulation_table
    assert np.array(grown) == pytest.approx(np.array([[0.01, 0.1], [20e6, 100e6]]))
    assert replace_parameters(spec, {RADIAL_FRICTION: np.nan}) == spec


def test_one_strand_and_a_wire_at_rest() -> None:
    """Closed forms; at rest 3 w L / 8, w L^2 / 8 and w L^4 / 185 EI of one that does not slip."""
    spec = replace(A2, layer_counts=(1,), strand_diameters=(0.8e-3,), lay_angles=())
    table = tabulate_wire(spec)
    assert table.stick_stiffness == table.slip_stiffness
    assert table.highest_moment == pytest.approx(table.lowest_moment)
    turning = 110e9 / (2.0 * 1.34) * np.pi * 0.8e-3**4 / 32.0
    turning += 1e9 / (2.0 * 1.4) * np.pi / 2.0 * (0.8e-3**4 - 0.5e-3**4)
    assert table.torsional_stiffness == table.free_torsional_stiffness == pytest.approx(turning)
    assert table.stretch_twist_coupling == 0.0
    table = tabulate_wire(replace(LEVEL, length=0.03))
    weight, rest = GRAVITY * table.mass_per_length, table.rest
    assert rest is not None
    assert rest.force == pytest.approx(3.0 * weight * 0.03 / 8.0, rel=1e-4)
    assert rest.moment == pytest.approx(-weight * 0.03**2 / 8.0, rel=1e-3)
    assert rest.curvature == pytest.approx(rest.moment / table.stick_stiffness, rel=1e-3)
    sag = weight * 0.03**4 / 184.6 / table.stick_stiffness
    assert rest.sag == pytest.approx(sag, rel=5e-3)


def test_the_cantilever_ends_where_the_law_does_or_at_its_length() -> None:
    short = tabulate_wire(replace(LEVEL, largest_curvature=20.0))
    assert 0.1 < short.tip_deflection[-1] / LEVEL.length < 0.8
    law = make_concave_law(short.curvature[1:], short.moment[1:])
    rest = hold_level(law, LEVEL.length, GRAVITY * short.mass_per_length).state
    end = bend_to_deflection(law, rest, LEVEL.length, float(short.tip_deflection[-1]))
    assert end.moment[0] == pytest.approx(short.moment[-1], rel=1e-3)
    cases = (A2, 0.3, None), (A2, 0.085, 1000.0), (A2, 3.0, None), (C3, 0.5, None)
    for wire, length, largest in cases:
        table = tabulate_wire(replace(wire, length=length, largest_curvature=largest))
        assert codes(table) == (["weight_left_out"] if length == 3.0 else [])
        assert (table.rest is None) == (length == 3.0)
        assert table.tip_deflection[-1] == pytest.approx(0.8 * length, rel=1e-12)
        assert np.all(np.diff(table.tip_force) > 0.0)
