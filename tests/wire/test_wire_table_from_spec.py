from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.wire import WireSpec
from labpipe.wire.bending_law import stick_stiffness
from labpipe.wire.materials import RambergOsgood, StressTable
from labpipe.wire.wire_table import WireError, build, layers_of, material_of, range_of

LAYS = (float(np.radians(12.0)), float(np.radians(-15.0)))
A2 = WireSpec("A2", 1.6e-3, (1, 6), (0.32e-3,) * 2, LAYS[:1], 0.3e-3, place="line 2")
C3 = WireSpec("C3", 1.8e-3, (1, 6, 12), (0.23e-3,) * 3, LAYS, 0.3e-3, place="line 3")
SOFT = ((0.001, 0.01), (110e6, 150e6))


def test_a_hexagon_where_it_fits() -> None:
    built = build(A2)
    assert built.section.kind == "hexagonal"
    assert built.section.insulation is not None
    assert built.section.insulation.bore_radius == pytest.approx(0.5e-3)
    assert built.contacts.inner == (0.21,)
    assert built.contacts.outer == (0.10,)
    assert built.contacts.radial_force == 0.15
    assert built.notes == ()


def test_inner_rings_touch_strands_the_outermost_the_insulation() -> None:
    contacts = build(C3).contacts
    assert contacts.inner == (0.21, 0.21)
    assert contacts.outer == (0.21, 0.10)


def test_a_packing_instead_of_the_hexagon_is_noted_with_the_reason() -> None:
    tight = replace(C3, wire_diameter=1.73e-3)
    built = build(tight)
    [note] = built.notes[:1]
    assert built.section.kind == "packed"
    assert (note.code, note.severity, note.where) == ("layout_fallback", "warning", "line 3")
    assert note.message.startswith(
        "the layout is packed, not a hexagon (the hexagonal layout does not fit: strands overlap"
        " the bore of radius 0.000565 m by 1e-05 m"
    )


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_strands_without_a_core_touch_each_other_around_the_axis(count: int) -> None:
    spec = replace(A2, layer_counts=(count,), strand_diameters=(0.3e-3,))
    built = build(spec)
    assert built.section.kind == "concentric"
    assert built.section.radius == pytest.approx(np.full(count, 0.15e-3 / np.sin(np.pi / count)))
    assert [note.code for note in built.notes] == ["layout_fallback"]


def test_a_packing_to_one_side_of_the_bore_is_said_with_what_it_does() -> None:
    spec = replace(A2, layer_counts=(3,), strand_diameters=(0.3e-3,), layout="packed")
    built = build(spec)
    [note] = built.notes
    assert (note.code, note.severity, note.where) == ("layout_eccentric", "warning", "line 2")
    off = np.hypot(built.section.x.mean(), built.section.y.mean())
    assert off > 0.02 * 0.5e-3
    turns = np.linspace(0.0, np.pi, 7)
    stiffness = [stick_stiffness(built.section, orientation=turn) for turn in turns]
    said = re.fullmatch(
        r"the strands lie to one side of the bore: their centroid is (\S+) mm off the axis, (\S+) %"
        r" of the bore's radius\. Bent about the axis, the stick stiffness is (\S+) to (\S+)"
        r" N m\^2, by orientation",
        note.message,
    )
    assert said is not None
    distance, share, least, most = map(float, said.groups())
    assert (distance, share) == pytest.approx((1e3 * off, 100.0 * off / 0.5e-3), rel=0.02)
    assert least <= min(stiffness) * 1.001
    assert most >= max(stiffness) * 0.999
    assert most > 1.2 * least


def test_a_packing_around_the_axis_is_not_eccentric() -> None:
    tight = replace(A2, wire_diameter=1.56e-3, layout="packed")
    assert "layout_eccentric" not in [note.code for note in build(tight).notes]


def test_rings_for_strands_that_differ() -> None:
    spec = replace(A2, layer_counts=(1, 9), strand_diameters=(0.4e-3, 0.2e-3))
    built = build(spec)
    assert built.section.kind == "concentric"
    assert [note.code for note in built.notes] == ["layout_fallback"]


def test_strands_that_do_not_fit_are_refused_with_the_overlap() -> None:
    with pytest.raises(WireError, match=r"strands overlap .* by \S+ m, allowed is"):
        build(replace(A2, strand_diameters=(0.36e-3, 0.36e-3)))
    with pytest.raises(WireError, match=r"the concentric layout does not fit"):
        build(replace(A2, strand_diameters=(0.36e-3, 0.36e-3), layout="concentric"))


def test_an_overlap_that_is_let_pass_is_noted() -> None:
    close = replace(C3, strand_diameters=(0.24004e-3,) * 3)
    [note] = build(close).notes
    assert (note.code, note.severity) == ("overlap_tolerated", "info")
    assert note.message == (
        "strands overlap each other or the bore by 0.1 um, 0.017 % of the bore's radius;"
        " up to 0.1 % is let pass"
    )


def test_a_lay_that_leaves_no_room_is_noted_or_refused() -> None:
    """Helices are nearer to each other than their circles in the section."""
    [note] = build(replace(A2, lay_angles=(np.radians(25.0),))).notes
    assert (note.code, note.severity) == ("helices_overlap", "warning")
    assert "overlap by 7.6 % of their diameter" in note.message
    with pytest.raises(WireError, match=r"do not fit each other: .* overlap by 26 % of their"):
        build(replace(A2, lay_angles=(np.radians(45.0),)))
    with pytest.raises(WireError, match=r"do not fit the bore: with 1 / cos\(lay angle\) their"):
        build(replace(A2, lay_angles=(np.radians(70.0),)))


def test_compressed_strands_at_given_radii() -> None:
    spec = replace(A2, layout="compressed", layer_radii=(0.0, 0.3e-3))
    assert build(spec).section.radius[1:] == pytest.approx(np.full(6, 0.3e-3))
    with pytest.raises(WireError, match=r"allowed is one for each of 2 layers"):
        build(replace(spec, layer_radii=(0.3e-3,)))


def test_materials() -> None:
    assert material_of(A2) == RambergOsgood(110e9, 530e6, 0.44, "numbers of the wire sheet")
    table = material_of(replace(A2, stress_table=SOFT))
    assert isinstance(table, StressTable)
    assert table.modulus == 110e9
    with pytest.raises(WireError, match=r"the table turns back"):
        build(replace(A2, stress_table=((0.01, 0.001), (1e6, 2e6))))


def test_layers_must_agree() -> None:
    assert [layer.lay_angle for layer in layers_of(C3)] == [0.0, *LAYS]
    strand = replace(A2, layer_counts=(3,), strand_diameters=(0.3e-3,))
    assert layers_of(strand)[0].lay_angle == LAYS[0]
    with pytest.raises(WireError, match=r"2 layers, 2 strand diameters and 2 lay angles: allowed"):
        build(replace(A2, lay_angles=LAYS))


def test_the_range_of_the_law() -> None:
    assert range_of(A2)[0] == pytest.approx(125.0)
    assert range_of(A2)[1] == ()
    assert range_of(replace(A2, largest_curvature=60.0)) == (60.0, ())
    assert range_of(replace(A2, stress_table=((0.001, 0.5), (110e6, 150e6))))[1] == ()
    largest, [note] = range_of(replace(A2, stress_table=SOFT))
    assert largest == pytest.approx(2.0 * 0.01 / 0.32e-3)
    assert (note.code, note.severity) == ("range_shortened", "warning")
    assert note.message == (
        "tables end at 62.5 1/m, not at 125 1/m: there the rim of a strand of 0.32 mm reaches the"
        " last strain of the stress table, 0.01"
    )


def test_tension_and_bending_share_the_stress_table() -> None:
    largest, [note] = range_of(replace(A2, stress_table=SOFT), strain=0.002)
    assert largest == pytest.approx(2.0 * 0.008 / 0.32e-3)
    assert note.code == "range_shortened"
    assert note.message == (
        "tables end at 50 1/m, not at 125 1/m: there the rim of a strand of 0.32 mm reaches the"
        " last strain of the stress table, 0.01, of which the tension takes 0.002"
    )


def test_a_tension_beyond_the_stress_table_is_refused() -> None:
    spec = replace(A2, stress_table=SOFT, tension=5000.0)
    with pytest.raises(WireError) as refusal:
        build(spec)
    assert str(refusal.value) == (
        "a tension of 5000 N strains the wire by 0.0837, and the stress table ends at a strain of"
        " 0.01"
    )


@pytest.mark.parametrize("table", [None, SOFT])
def test_strands_that_would_yield_under_the_tension_are_said_to(
    table: tuple[tuple[float, ...], tuple[float, ...]] | None,
) -> None:
    spec = replace(A2, stress_table=table, tension=300.0)
    built = build(spec)
    [note] = built.notes
    elastic = 110e9 * built.axial_strain
    carried = float(material_of(spec).stress(np.array([built.axial_strain]))[0])
    assert elastic > 1.2 * carried
    assert (note.code, note.severity, note.where) == ("tension_yields", "warning", "line 2")
    assert note.message == (
        f"a tension of 300 N strains the elastic wire by {built.axial_strain:.3g}: the strands pull"
        f" with {elastic / 1e6:.4g} MPa in the model, and their stress-strain curve carries"
        f" {carried / 1e6:.4g} MPa there"
    )
    assert build(replace(spec, tension=1.0)).notes == ()
