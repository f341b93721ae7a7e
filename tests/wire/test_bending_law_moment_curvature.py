from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.wire.bending_law import (
    _different_turns,
    moment_curvature,
    orientation_range,
    slip_stiffness,
    stick_stiffness,
)
from labpipe.wire.cross_section import CrossSection, Layer, concentric, hexagonal, lay_up
from labpipe.wire.friction import insulated
from labpipe.wire.materials import ANNEALED_COPPER, Elastic, ElasticPerfectlyPlastic, StressTable
from labpipe.wire.packing import packed
from tests.builders.stranded_wires import cardinal, contacts_of, layers_of, tube, wire

KAPPA = np.linspace(0.0, 35.0, 700)
ELASTIC = Elastic(110e9)


@pytest.mark.parametrize("name", ["A2", "A3", "C4"])
def test_the_parts_make_the_moment(name: str) -> None:
    section = wire(name)
    found = moment_curvature(section, contacts_of(section), KAPPA)
    parts = found.stick + found.slip + found.bending + found.plastic + found.insulation
    assert found.moment == pytest.approx(parts)
    assert np.all(found.plastic <= 1e-18)
    assert found.stick[0] == found.slip[0] == 0.0
    assert found.stick[-1] == pytest.approx(0.0)
    assert found.slip[-1] > 0.0
    assert np.all(np.diff(found.moment) > 0.0)


@pytest.mark.parametrize("name", ["A2", "A3", "C4"])
def test_stiffnesses(name: str) -> None:
    section = wire(name)
    found = moment_curvature(section, contacts_of(section), KAPPA)
    assert found.secant_stiffness[1:] == pytest.approx(found.moment[1:] / KAPPA[1:])
    assert found.secant_stiffness[0] == found.tangent_stiffness[0]
    assert found.tangent_stiffness[0] == pytest.approx(found.stick_stiffness)
    fine = np.linspace(2.0, 35.0, 20001)
    smooth = moment_curvature(section, contacts_of(section), fine)
    slope = np.gradient(smooth.moment, fine)
    assert smooth.tangent_stiffness[5:-5] == pytest.approx(slope[5:-5], rel=1e-4)


@pytest.mark.parametrize("name", ["A2", "A3", "C4"])
@pytest.mark.parametrize("orientation", [0.0, 0.3])
def test_limits_of_the_radial_force(name: str, orientation: float) -> None:
    section = wire(name, ELASTIC)
    stiff = moment_curvature(section, contacts_of(section, 1e9), KAPPA, orientation=orientation)
    assert stiff.moment == pytest.approx(stick_stiffness(section) * KAPPA)
    loose = insulated(len(section.layers) - 1, strand=0.0, insulation=0.0, radial_force=0.0)
    free = moment_curvature(section, loose, KAPPA, orientation=orientation)
    assert free.moment == pytest.approx(slip_stiffness(section) * KAPPA, abs=1e-15)
    none = moment_curvature(section, contacts_of(section, 0.0), KAPPA, orientation=orientation)
    assert none.moment == pytest.approx(slip_stiffness(section) * KAPPA, abs=1e-15)


def test_plateau_of_strands_that_yield_perfectly() -> None:
    diameter, stress = 0.3e-3, 60e6
    single = concentric((Layer(1, diameter, 0.0, ElasticPerfectlyPlastic(110e9, stress)),))
    found = moment_curvature(single, contacts_of(single), np.array([3000.0]))
    assert found.moment[0] == pytest.approx(stress * diameter**3 / 6.0, rel=1e-5)


@given(st.floats(0.1, 10.0), st.floats(0.05, 30.0))
def test_scaling(factor: float, curvature: float) -> None:
    """Modulus: everything but friction. Length by c at curvature / c: elastic moments by c^3."""
    section = wire("A3", ELASTIC)
    scaled = wire("A3", Elastic(110e9 * factor))
    bare, bare_scaled = replace(section, insulation=None), replace(scaled, insulation=None)
    contacts = contacts_of(section)
    stronger = contacts_of(section, 0.15 * factor)
    kappa = np.array([curvature])
    once = moment_curvature(bare, contacts, kappa).moment
    assert moment_curvature(bare_scaled, stronger, kappa).moment == pytest.approx(factor * once)
    layers = tuple(replace(lay, diameter=factor * lay.diameter) for lay in section.layers)
    large = CrossSection("own", layers, factor * section.x, factor * section.y, section.layer)
    assert stick_stiffness(large) == pytest.approx(factor**4 * stick_stiffness(bare))
    assert slip_stiffness(large) == pytest.approx(factor**4 * slip_stiffness(bare))
    forces = contacts_of(section, 0.15 * factor**2)
    bent = moment_curvature(large, forces, kappa / factor).moment
    assert bent == pytest.approx(factor**3 * once)


@pytest.mark.parametrize("name", ["A2", "A3", "C4"])
def test_the_signs_of_all_lay_angles_do_not_matter(name: str) -> None:
    contacts = contacts_of(wire(name))
    once = moment_curvature(wire(name), contacts, KAPPA, orientation=0.2).moment
    mirrored = moment_curvature(wire(name, mirrored=True), contacts, KAPPA, orientation=0.2).moment
    assert mirrored == pytest.approx(once, rel=1e-14)


@pytest.mark.parametrize("name", ["A2", "A3", "C4"])
def test_mirrored_sections_bend_alike(name: str) -> None:
    rng = np.random.default_rng(7)
    section = wire(name)
    # Not symmetric itself, so that the mirror says something.
    shaken = replace(
        section,
        x=section.x + rng.normal(scale=1e-5, size=section.x.shape),
        y=section.y + rng.normal(scale=1e-5, size=section.x.shape),
    )
    contacts = contacts_of(section)
    once = moment_curvature(shaken, contacts, KAPPA).moment
    sideways = moment_curvature(replace(shaken, x=-shaken.x), contacts, KAPPA).moment
    assert sideways == pytest.approx(once, rel=1e-9)
    upside_down = moment_curvature(replace(shaken, y=-shaken.y), contacts, -KAPPA).moment
    assert upside_down == pytest.approx(-once, rel=1e-9)
    assert abs(moment_curvature(shaken, contacts, -KAPPA).moment + once).max() > 1e-9


def test_stick_stiffness_does_not_depend_on_the_orientation() -> None:
    for name in ("A2", "A3", "C4"):
        section = wire(name)
        for turn in (0.0, 0.1, 0.5):
            found = moment_curvature(
                section, contacts_of(section, 1e6), np.array([1e-6]), orientation=turn
            )
            assert found.tangent_stiffness[0] == pytest.approx(stick_stiffness(section), rel=1e-6)


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.0, np.pi / 2.0])
def test_stick_stiffness_is_the_slope_at_zero_for_any_layout(turn: float) -> None:
    two = concentric((Layer(2, 0.3e-3, 0.2),), tube(1.8e-3))
    packing = packed(layers_of("C1"), tube(1.5e-3), seed=2)
    for section in (two, packing, wire("A3")):
        contacts = insulated(
            len(section.layers) - int(section.has_core),
            strand=0.21,
            insulation=0.1,
            radial_force=0.15,
        )
        found = moment_curvature(section, contacts, np.zeros(1), orientation=turn)
        assert found.stick_stiffness == pytest.approx(found.tangent_stiffness[0], rel=1e-9)
        assert found.stick_stiffness == stick_stiffness(section, orientation=turn)
    across = stick_stiffness(two, orientation=np.pi / 2.0)
    assert across > 1.2 * stick_stiffness(two)


def test_an_infinite_curvature_is_refused() -> None:
    section = wire("A2", ELASTIC)
    with pytest.raises(ValueError, match=r"^curvature\[1\] is infinite: allowed are finite ones$"):
        moment_curvature(section, contacts_of(section), np.array([1.0, -np.inf]))


def test_orientation_matters_in_slip() -> None:
    """About 15 % of the friction moment of seven strands (PHYSICS 4)."""
    section = wire("A2")
    contacts = contacts_of(section)
    kappa = np.array([5.0])
    low, high = orientation_range(section, contacts, moment_curvature(section, contacts, kappa))
    slip = moment_curvature(section, contacts, kappa).slip
    assert 0.12 < float((high - low)[0] / slip[0]) < 0.18
    assert low[0] <= moment_curvature(section, contacts, kappa).moment[0] <= high[0]


def test_each_curvature_stands_alone() -> None:
    section = wire("A3")
    rng = np.random.default_rng(1)
    mixed = rng.permutation(np.concatenate([KAPPA, -KAPPA, [np.nan]]))
    once = moment_curvature(section, contacts_of(section), mixed)
    alone = moment_curvature(section, contacts_of(section), KAPPA).moment
    order = np.searchsorted(KAPPA, np.abs(mixed[~np.isnan(mixed)]))
    known = once.moment[~np.isnan(mixed)]
    assert known == pytest.approx(np.sign(mixed[~np.isnan(mixed)]) * alone[order], rel=1e-9)
    for part in (once.stick, once.slip, once.moment, once.tangent_stiffness, once.secant_stiffness):
        assert np.isnan(part[np.isnan(mixed)]).all()


def test_more_of_anything_is_stiffer() -> None:
    section = wire("A3")
    moments = [
        moment_curvature(section, contacts_of(section, force), KAPPA[1:]).moment
        for force in (0.0, 0.05, 0.15, 0.6)
    ]
    for less, more in pairwise(moments):
        assert np.all(more >= less)


def test_axial_tension_holds_the_strands() -> None:
    section, kappa = cardinal(), np.array([0.1])
    contacts = insulated(4, strand=0.5, insulation=0.0, radial_force=0.0)
    slack, taut = (
        moment_curvature(section, contacts, kappa, tension=pull).moment[0] for pull in (0.0, 40e3)
    )
    assert slack == pytest.approx(slip_stiffness(section) * 0.1, rel=1e-6)
    assert taut > 1.5 * slack


def test_a_curvature_beyond_the_material_is_refused() -> None:
    table = StressTable((1e-3, 5e-3), (60e6, 90e6))
    section = wire("A2", table)
    with pytest.raises(ValueError, match=r"known up to 0.005, which is 31.25 1/m"):
        moment_curvature(section, contacts_of(section), KAPPA)
    assert ANNEALED_COPPER.largest_strain == np.inf


@pytest.mark.parametrize("name", ["A2", "C4"])
def test_the_range_over_orientations_leaves_out_no_turn(name: str) -> None:
    section, contacts = wire(name), contacts_of(wire(name))
    kappa = np.array([-5.0, 0.05, 5.0, 40.0])
    low, high = orientation_range(section, contacts, moment_curvature(section, contacts, kappa))
    turns = 2.0 * np.pi * np.arange(24) / 24
    moments = [moment_curvature(section, contacts, kappa, orientation=t).moment for t in turns]
    assert low == pytest.approx(np.min(moments, axis=0), rel=1e-9)
    assert high == pytest.approx(np.max(moments, axis=0), rel=1e-9)


def test_the_range_over_orientations_of_strands_without_order() -> None:
    section = wire("A2")
    rng = np.random.default_rng(3)
    away = rng.normal(scale=1e-5, size=(2, 7)) * (section.radius > 0.0)
    loose = replace(section, x=section.x + away[0], y=section.y + away[1])
    kappa = np.array([0.05, 5.0])
    curve = moment_curvature(loose, contacts_of(loose), kappa)
    low, high = orientation_range(loose, contacts_of(loose), curve, n_orientations=7)
    moments = [
        moment_curvature(loose, contacts_of(loose), kappa, orientation=turn).moment
        for turn in 2.0 * np.pi * np.arange(7) / 7
    ]
    assert low == pytest.approx(np.min(moments, axis=0), rel=1e-12)
    assert high == pytest.approx(np.max(moments, axis=0), rel=1e-12)


@pytest.mark.parametrize("strand", [0.32e-3, 0.02e-3])
@pytest.mark.parametrize(("number", "angles"), [(7, (12.0,)), (19, (12.0, -15.0))])
def test_turns_that_swap_strands_are_alike_however_thin_they_are(
    strand: float, number: int, angles: tuple[float, ...]
) -> None:
    """A hexagon repeats after 60 degrees, and its mirror image bends alike: 0, 15 and 30 differ."""
    layers = lay_up(number, strand, [float(np.radians(each)) for each in angles], ANNEALED_COPPER)
    turns = _different_turns(hexagonal(layers), 24)
    folded = np.degrees(turns) % 60.0
    assert np.minimum(folded, 60.0 - folded) == pytest.approx([0.0, 15.0, 30.0], abs=1e-9)
