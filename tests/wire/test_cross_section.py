"""Sections of strands: hexagons, rings, compressed strands and packings."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from benchmarks import plain_loop
from labpipe.mechanics.wire.cross_section import (
    Insulation,
    Layer,
    LayoutKind,
    compute_largest_overlap,
    compute_overlap_energy,
    compute_strand_diameter,
    lay_up,
    make_cross_section,
    pack_strands,
    place_hexagon,
    place_rings,
    place_sectors,
)
from labpipe.mechanics.wire.materials import ANNEALED_COPPER
from tests.builders.stranded_wires import WIRES, cardinal, layers_of, tube, wire


@pytest.mark.parametrize("name", sorted(WIRES))
def test_the_sources_wires_fit_as_hexagons(name: str) -> None:
    section = wire(name)
    strands, diameter = WIRES[name][1:]
    assert len(section.x) == strands
    apart = np.hypot(*(np.subtract.outer(part, part) for part in (section.x, section.y)))
    assert apart[np.triu_indices(strands, 1)].min() == pytest.approx(diameter)
    assert section.angle[1] == 0.0
    assert section.overlap == pytest.approx(0.0, abs=1e-15)


def test_compressed_strands() -> None:
    """B wires: with 0.3 mm of wall the copper would not fit, with 0.2 mm it does."""
    layers = lay_up(7, compute_strand_diameter(0.35e-6, 7), [np.radians(12.0)], ANNEALED_COPPER)
    section = place_sectors(layers, tube(1.1e-3, 0.2e-3))
    edge = np.sqrt(np.array([0.05e-6, 0.35e-6]) / np.pi)
    ring = 2 / 3 * (edge[1] ** 3 - edge[0] ** 3) / (edge[1] ** 2 - edge[0] ** 2) * 3 / np.pi
    assert section.radius[0] == 0.0
    assert section.radius[1:] == pytest.approx(ring)
    given = place_sectors(layers, tube(1.1e-3, 0.2e-3), radii=[0.0, 0.22e-3])
    assert given.radius[1:] == pytest.approx(0.22e-3)


def test_insulation_stiffness() -> None:
    found = Insulation(0.5e-3, 0.3e-3, 1e9)
    assert found.bending_stiffness == pytest.approx(np.pi / 64.0 * 1e9 * (1.6e-3**4 - 1e-12))
    assert found.axial_stiffness == pytest.approx(np.pi / 4.0 * 1e9 * (1.6e-3**2 - 1e-6))


@pytest.mark.parametrize("name", ["A1", "C4"])
def test_packings_fit_and_repeat(name: str) -> None:
    layers, insulation = layers_of(name), tube(WIRES[name][0])
    once, again, other = (
        pack_strands(layers, insulation, **seed) for seed in ({}, {"seed": 0}, {"seed": 1})
    )
    assert once.x.tolist() == again.x.tolist()
    assert once.x.tolist() != other.x.tolist()
    assert once.overlap <= 1e-3 * (WIRES[name][0] / 2.0 - 0.3e-3)
    rings = np.split(once.radius, np.cumsum([layer.count for layer in once.layers])[:-1])
    for inner, outer in pairwise(rings):
        assert inner.max() <= outer.min()


def test_a_packing_has_its_core_on_the_axis_and_is_a_hexagon_in_a_tight_bore() -> None:
    tight = pack_strands(layers_of("A2"), tube(0.96e-3 + 0.6e-3))
    assert tight.radius[0] == pytest.approx(0.0, abs=1e-6)
    assert tight.radius[1:] == pytest.approx(0.32e-3, rel=2e-3)
    assert tight.angle[1] == pytest.approx(0.0, abs=1e-12)
    wide = pack_strands(layers_of("A2"), tube(1.9e-3), seed=0)
    assert wide.has_core
    assert (wide.x[0], wide.y[0]) == (0.0, 0.0)
    assert wide.radius[1:].min() >= 0.32e-3 * (1.0 - 1e-6)
    single = pack_strands((Layer(1, 0.3e-3),), tube(1.6e-3), seed=1)
    assert (single.x.tolist(), single.y.tolist()) == ([0.0], [0.0])


PRESSED = lay_up(7, compute_strand_diameter(0.35e-6, 7), [0.2], ANNEALED_COPPER)


@pytest.mark.parametrize(
    ("layers", "insulation", "asked", "kind"),
    [
        (layers_of("A2"), tube(1.6e-3), None, "hexagonal"),
        ((Layer(5, 0.3e-3, 0.2),), tube(1.6e-3), None, "concentric"),
        ((Layer(1, 0.2e-3), Layer(7, 0.2e-3, 0.2)), tube(1.6e-3), None, "packed"),  # 7 around 1
        ((Layer(1, 0.35e-3), Layer(6, 0.3e-3, 0.2)), tube(1.6e-3), None, "concentric"),
        (layers_of("A2"), tube(1.6e-3), "concentric", "concentric"),
        (layers_of("A2"), tube(1.6e-3), "packed", "packed"),
        (PRESSED, tube(1.1e-3, 0.2e-3), "compressed", "compressed"),
    ],
)
def test_the_layout_that_is_chosen(
    layers: tuple[Layer, ...], insulation: Insulation, asked: LayoutKind | None, kind: str
) -> None:
    assert make_cross_section(layers, insulation, kind=asked).kind == kind


def test_overlaps() -> None:
    """A3's hexagon from its area is 0.16 micrometres too big for the bore, which is tolerated."""
    centres = np.array([[0.0, 0.0], [1.5, 0.0], [9.0, 0.0]])
    assert compute_largest_overlap(centres, np.ones(3)) == pytest.approx(0.5)
    assert compute_largest_overlap(centres[:1], np.ones(1)) == 0.0
    energy, gradient = compute_overlap_energy(centres[:2].ravel(), 1.0, 9.0)
    assert energy == pytest.approx(2.0 * 0.5**2)  # the pair counts from both sides
    assert gradient == pytest.approx([2.0, 0.0, -2.0, 0.0])
    flat = np.random.default_rng(2).normal(scale=4.0, size=74)
    energy, _ = compute_overlap_energy(flat, 1.0, 6.5)
    assert energy == pytest.approx(plain_loop.overlap(flat, 1.0, 6.5), rel=1e-12)
    layers = lay_up(19, compute_strand_diameter(0.86e-6, 19), [0.2, -0.26], ANNEALED_COPPER)
    assert place_hexagon(layers, tube(1.8e-3)).overlap == pytest.approx(0.16e-6, abs=0.01e-6)


def test_concentric_rings() -> None:
    section = place_rings(layers_of("C4"), tube(WIRES["C4"][0]))
    assert np.unique(section.radius.round(9)) == pytest.approx([0.0, 0.21e-3, 0.42e-3, 0.63e-3])
    radii = np.unique(cardinal().radius.round(6))
    assert radii == pytest.approx([0.0, 3.34e-3, 6.67e-3, 9.99e-3, 13.31e-3])
    coreless = place_rings((Layer(3, 1e-3, 0.2),))
    assert not coreless.has_core
    assert coreless.radius == pytest.approx(1e-3 / np.sqrt(3.0))
