from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.law.play_fits import concave_law
from labpipe.records.wire import WireSpec, WireTable
from labpipe.studies.wire_specs import read_wire_sheet
from labpipe.units import GRAVITY
from labpipe.wire.bending_law import moment_curvature
from labpipe.wire.cantilever import bend_to_deflection, held_level
from labpipe.wire.cross_section import Layer, concentric
from labpipe.wire.wire_table import (
    WireError,
    build,
    curvature_grid,
    layout_of,
    wire_table,
)
from tests.builders.wire_tables import codes, told

HEXAGONAL = {"C1": 1.46, "C2": 2.85, "C3": 5.95, "C4": 15.6, "C5": 36.4}
"""Stick stiffness, 1e-3 N m^2, of the source's Table 3.5 as hexagons (PHYSICS 4)."""
A2 = WireSpec(
    "A2", 1.6e-3, (1, 6), (0.32e-3,) * 2, (float(np.radians(12.0)),), 0.3e-3, place="line 2"
)


@pytest.fixture(scope="module")
def examples() -> dict[str, WireTable]:
    sheet = Path(__file__).resolve().parents[2] / "examples" / "wires.xlsx"
    return {spec.name: wire_table(spec) for spec in read_wire_sheet(sheet)}


def test_the_wires_of_table_3_5_from_the_example_sheet(examples: dict[str, WireTable]) -> None:
    for name, expected in HEXAGONAL.items():
        assert examples[name].layout.kind == "hexagonal"
        assert 1e3 * examples[name].stick_stiffness == pytest.approx(expected, rel=3e-3)


def test_every_example_is_told_over_its_whole_range(examples: dict[str, WireTable]) -> None:
    for name, table in examples.items():
        assert codes(table) in (["defaults_taken"], ["defaults_taken", "overlap_tolerated"]), name
        assert table.curvature[0] == table.moment[0] == 0.0
        assert table.curvature[-1] == pytest.approx(1.0 / (5.0 * table.spec.wire_diameter))
        assert np.all(np.diff(table.curvature) > 0.0)
        assert np.all(np.diff(table.moment) > 0.0)
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


def test_the_table_resolves_the_law(examples: dict[str, WireTable]) -> None:
    """Straight lines between its points are within 0.1 % of the law."""
    table = examples["C4"]
    built = build(table.spec)
    between = (table.curvature[1:-1] + table.curvature[2:]) / 2.0
    moment = moment_curvature(built.section, built.contacts, between).moment
    lines = np.interp(between, table.curvature, table.moment)
    assert lines == pytest.approx(moment, rel=1e-3)


def test_the_cantilever_is_that_of_the_law(examples: dict[str, WireTable]) -> None:
    table = examples["A2"]
    law = concave_law(table.curvature[1:], table.moment[1:])
    state = held_level(law, table.spec.length, GRAVITY * table.mass_per_length).state
    assert table.rest is not None
    assert state.force[1] == pytest.approx(table.rest.force, rel=1e-5)
    for number in (12, 24):
        deflection = float(table.tip_deflection[number])
        shape = bend_to_deflection(law, state, table.spec.length, deflection)
        state = shape.state
        force = shape.force[1] - table.rest.force
        assert force == pytest.approx(table.tip_force[number], rel=1e-4)


def test_defaults_are_said_in_one_note() -> None:
    spec = replace(A2, defaults={"length": "length 85 mm", "poisson": "poisson 0.34"})
    [note] = told(wire_table(spec))
    assert (note.code, note.severity, note.where) == ("defaults_taken", "info", "line 2")
    assert note.message == "the sheet does not say, so taken are: length 85 mm, poisson 0.34"


def test_a_mass_that_the_sheet_states_is_taken() -> None:
    table = wire_table(replace(A2, mass_per_length=8e-3))
    assert table.mass_per_length == 8e-3
    assert wire_table(replace(A2, insulation_density=0.0)).mass_per_length < 6e-3


@pytest.mark.parametrize(("length", "largest"), [(0.3, None), (0.085, 1000.0)])
def test_a_long_wire_or_a_long_law_is_told_to_the_end(length: float, largest: float | None) -> None:
    table = wire_table(replace(A2, length=length, largest_curvature=largest))
    assert not codes(table)
    assert table.tip_deflection[-1] == pytest.approx(0.8 * length, rel=1e-12)
    assert np.all(np.diff(table.tip_force) > 0.0)


def test_a_cut_where_the_tip_unloads_stays_within_the_range() -> None:
    whole = wire_table(A2)
    for largest in (50.0, 55.0, 60.0):
        table = wire_table(replace(A2, largest_curvature=largest))
        if codes(table):
            assert table.tip_deflection[-1] < whole.tip_deflection[-1]
            assert table.tip_force[-1] < whole.tip_force[-1]


def test_a_stress_table_ends_the_range() -> None:
    soft = ((0.001, 0.005, 0.01), (110e6, 130e6, 150e6))
    table = wire_table(replace(A2, stress_table=soft))
    assert codes(table)[0] == "range_shortened"
    assert table.curvature[-1] == pytest.approx(62.5)
    assert np.all(np.isfinite(table.moment))
    assert len(table.tip_force) >= 40


def test_tension_is_said_and_stiffens_slipping_strands() -> None:
    table, without = wire_table(replace(A2, tension=20.0)), wire_table(A2)
    assert codes(table) == ["tension_yields", "tension"]
    note = told(table)[-1]
    assert note.message == (
        "the law holds under a tension of 20 N, there before bending; the cantilever bends by that"
        " law, the pull of the tension on its shape left out"
    )
    assert table.moment[100] > without.moment[100]


def test_without_friction_nothing_sticks() -> None:
    table = wire_table(replace(A2, friction_strand=0.0, friction_insulation=0.0))
    assert table.slip_onsets.tolist() == [0.0]
    assert table.slip == pytest.approx(np.zeros(len(table.slip)), abs=1e-15)
    assert table.tangent_stiffness[1] == pytest.approx(table.slip_stiffness, rel=1e-2)


def test_one_strand() -> None:
    spec = replace(A2, layer_counts=(1,), strand_diameters=(0.8e-3,), lay_angles=())
    table = wire_table(spec)
    assert table.stick_stiffness == table.slip_stiffness
    assert table.highest_moment == pytest.approx(table.lowest_moment)
    turning = 110e9 / (2.0 * 1.34) * np.pi * 0.8e-3**4 / 32.0
    turning += 1e9 / (2.0 * 1.4) * np.pi / 2.0 * (0.8e-3**4 - 0.5e-3**4)
    assert table.torsional_stiffness == pytest.approx(turning)
    assert (table.stretch_twist_coupling, table.free_torsional_stiffness) == (
        0.0,
        table.torsional_stiffness,
    )


@pytest.mark.parametrize("strands", [2, 3, 4])
def test_strands_without_core(strands: int) -> None:
    table = wire_table(replace(A2, layer_counts=(strands,), strand_diameters=(0.3e-3,)))
    assert table.layout.kind == "concentric"
    assert np.all(np.diff(table.moment) > 0.0)


@pytest.mark.parametrize("friction", [0.0, 0.3, 3.0])
@pytest.mark.parametrize("angle", [1.0, 45.0, 80.0])
def test_odd_wires_are_told_or_refused_in_words(angle: float, friction: float) -> None:
    room = float(np.cos(np.radians(angle)))  # round the core, for a helix beside a helix
    spec = replace(
        A2,
        strand_diameters=(0.32e-3, 0.6 * room * 0.32e-3),
        lay_angles=(float(np.radians(angle)),),
        friction_strand=friction,
        friction_insulation=friction,
        tension=50.0,
    )
    table = wire_table(spec)
    assert np.all(np.isfinite(table.moment))
    assert np.all(table.tip_deflection <= 0.8 * spec.length)


def test_what_cannot_be_built_is_refused() -> None:
    with pytest.raises(WireError, match=r"strands overlap .* by"):
        wire_table(replace(A2, strand_diameters=(0.36e-3, 0.36e-3)))
    with pytest.raises(WireError, match=r"tension=-1.0: allowed are finite numbers >= 0"):
        wire_table(replace(A2, tension=-1.0))
    with pytest.raises(WireError, match=r"^orientation=nan: allowed are finite numbers$"):
        wire_table(replace(A2, orientation=np.nan))


@pytest.mark.parametrize("number", [0.0, -1.0, np.nan, np.inf])
def test_lengths_and_ranges_are_positive(number: float) -> None:
    said = r"=.*: allowed are finite numbers > 0$"
    with pytest.raises(WireError, match="^length" + said):
        wire_table(replace(A2, length=number))
    with pytest.raises(WireError, match="^largest_curvature" + said):
        wire_table(replace(A2, largest_curvature=number))


def test_a_law_that_softens_is_refused_with_the_curvature(monkeypatch: pytest.MonkeyPatch) -> None:
    def softening(*arguments: object, **options: object) -> object:
        curve = moment_curvature(*arguments, **options)  # type: ignore[arg-type]
        return replace(curve, insulation=curve.insulation - 1e-3 * (curve.curvature > 10.0))

    monkeypatch.setattr("labpipe.wire.wire_table.moment_curvature", softening)
    said = (
        r"the law softens: the moment falls from (\S+) N m at 9\.\d+ 1/m to (\S+) N m at 10\.\d+ "
    )
    with pytest.raises(WireError, match=said) as raised:
        wire_table(A2)
    before, behind = map(float, re.findall(r"(\S+) N m at", str(raised.value)))
    assert before - behind == pytest.approx(1e-3, rel=0.2)


def test_a_law_that_stiffens_has_no_cantilever(monkeypatch: pytest.MonkeyPatch) -> None:
    def stiffening(*arguments: object, **options: object) -> object:
        curve = moment_curvature(*arguments, **options)  # type: ignore[arg-type]
        return replace(curve, insulation=curve.insulation + 1e-2 * (curve.curvature > 10.0))

    monkeypatch.setattr("labpipe.wire.wire_table.moment_curvature", stiffening)
    table = wire_table(A2)
    assert codes(table) == ["cantilever_cut"]
    assert told(table)[0].message.startswith("no curve of the cantilever: the law stiffens at")
    assert table.tip_force.tolist() == [0.0]


def test_the_grid_gives_way_to_the_onsets() -> None:
    onsets = np.array([1e-3, 0.02])
    grid = curvature_grid(100.0, onsets)
    assert np.isin(onsets, grid).all()
    assert grid[0] == 0.0
    assert grid[-1] == 100.0
    assert len(grid) in (202, 203)
    assert np.all(np.diff(grid[1:]) > 5e-5 * grid[1:-1])


def test_a_layout_needs_a_tube() -> None:
    with pytest.raises(ValueError, match=r"the section has no insulation: allowed is one with"):
        layout_of(concentric((Layer(1, 1e-3), Layer(6, 1e-3, 0.1))))


@pytest.mark.parametrize("radial_force", [0.0, 1e-9])
def test_strands_that_nothing_presses_slip_at_once_and_that_is_said(radial_force: float) -> None:
    table = wire_table(replace(A2, radial_force=radial_force))
    [note] = told(table)
    assert (note.code, note.severity, note.where) == ("slips_at_once", "warning", "line 2")
    assert note.message == (
        f"strands slip as soon as the wire bends (radial force {radial_force:.3g} N, friction 0.21"
        f" and 0.1): the slope of the law at zero is {table.secant_stiffness[1]:.4g} N m^2, not the"
        f" stick stiffness, {table.stick_stiffness:.4g} N m^2"
    )
    assert table.slips_at_once
    assert np.all(np.diff(table.curvature) > 0.0)
    assert table.secant_stiffness[1] == pytest.approx(table.slip_stiffness, rel=1e-2)
    assert table.slip_stiffness < 0.5 * table.stick_stiffness


def test_strands_that_never_slip_within_the_range_are_not_said_to_slip() -> None:
    table = wire_table(replace(A2, radial_force=1e6))
    assert table.slip_onsets.shape == (0,)
    assert (table.slips_at_once, table.slip_onset(0)) == (False, "beyond")
    assert "slips_at_once" not in codes(table)


def test_beyond_the_insulations_straight_line_the_table_is_doubtful() -> None:
    """3 % of strain at the rim: twice that over the diameter."""
    table = wire_table(A2)
    [note] = table.notes
    assert (note.code, note.severity) == ("insulation_doubtful", "warning")
    assert note.message.startswith(
        "where the rim of the insulation is strained by more than 3 %, its straight line is not "
        "taken to hold: moments beyond are doubtful"
    )
    assert table.doubtful_curvature == pytest.approx(37.5)
    np.testing.assert_array_equal(table.is_doubtful, table.curvature > 37.5)
    share = table.insulation[50] / table.moment[50]
    assert table.insulation_share[50] == pytest.approx(share)
    shares = np.interp([1.0, 10.0, 125.0], table.curvature, table.insulation_share)
    assert shares == pytest.approx([0.50, 0.76, 0.93], abs=0.01)
    built = build(A2)
    law = concave_law(table.curvature[1:], table.moment[1:])
    rest = held_level(law, A2.length, GRAVITY * table.mass_per_length).state
    shape = bend_to_deflection(law, rest, A2.length, table.doubtful_deflection)
    assert shape.curvature[0] == pytest.approx(37.5, rel=3e-3)
    assert built.section.insulation is not None
    farther = wire_table(replace(A2, insulation_strain=0.2))
    assert not farther.notes
    assert not farther.is_doubtful.any()


SOFT = ((0.01, 0.03, 0.1, 0.3), (10e6, 18e6, 24e6, 30e6))
"""A made-up curve of soft PVC: 1 GPa at first."""


def test_a_stress_table_of_the_insulation() -> None:
    plain, soft = wire_table(A2), wire_table(replace(A2, insulation_table=SOFT))
    small = plain.curvature * 0.8e-3 < 0.01
    assert soft.insulation[small] == pytest.approx(plain.insulation[small], rel=1e-9)
    assert soft.moment[-1] < 0.5 * plain.moment[-1]
    assert not soft.is_doubtful.any()
    assert codes(soft) == []
    short = wire_table(replace(A2, insulation_table=((0.01, 0.05), (10e6, 20e6))))
    assert codes(short) == ["range_shortened", "cantilever_cut"]
    assert short.curvature[-1] == pytest.approx(62.5)
    assert "the rim of the insulation of 1.6 mm reaches" in short.notes[0].message
