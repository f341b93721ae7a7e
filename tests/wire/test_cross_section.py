from __future__ import annotations

import numpy as np
import pytest

from labpipe.wire.cross_section import (
    CrossSection,
    Insulation,
    Layer,
    compressed,
    concentric,
    hexagonal,
    largest_overlap,
    lay_up,
    strand_diameter,
)
from labpipe.wire.materials import ANNEALED_COPPER
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


def test_a_bore_that_is_a_little_small_is_let_pass() -> None:
    """A3's hexagon from its area is 0.16 micrometres too big for the bore."""
    layers = lay_up(19, strand_diameter(0.86e-6, 19), [0.2, -0.26], ANNEALED_COPPER)
    section = hexagonal(layers, tube(1.8e-3))
    assert section.overlap == pytest.approx(0.16e-6, abs=0.01e-6)


def test_an_infeasible_bore_states_the_overlap() -> None:
    said = (
        r"the hexagonal layout does not fit: strands overlap the bore of radius 0.0004 m by "
        r"8e-05 m, allowed is 4e-07 m"
    )
    with pytest.raises(ValueError, match=said):
        hexagonal(layers_of("A2"), tube(1.4e-3))


def test_concentric_rings_and_layers_of_different_strands() -> None:
    section = concentric(layers_of("C4"), tube(WIRES["C4"][0]))
    assert np.unique(section.radius.round(9)) == pytest.approx([0.0, 0.21e-3, 0.42e-3, 0.63e-3])
    radii = np.unique(cardinal().radius.round(6))
    assert radii == pytest.approx([0.0, 3.34e-3, 6.67e-3, 9.99e-3, 13.31e-3])


def test_rings_without_a_core_touch_each_other() -> None:
    section = concentric((Layer(3, 1e-3, 0.2),))
    assert not section.has_core
    assert section.radius == pytest.approx(1e-3 / np.sqrt(3.0))
    with pytest.raises(ValueError, match="strands overlap each other by"):
        concentric((Layer(1, 1e-3), Layer(7, 1e-3, 0.2)))


def test_compressed_strands() -> None:
    """B wires: with 0.3 mm of wall the copper would not fit, with 0.2 mm it does."""
    layers = lay_up(7, strand_diameter(0.35e-6, 7), [np.radians(12.0)], ANNEALED_COPPER)
    section = compressed(layers, tube(1.1e-3, 0.2e-3))
    edge = np.sqrt(np.array([0.05e-6, 0.35e-6]) / np.pi)
    ring = 2 / 3 * (edge[1] ** 3 - edge[0] ** 3) / (edge[1] ** 2 - edge[0] ** 2) * 3 / np.pi
    assert section.radius[0] == 0.0
    assert section.radius[1:] == pytest.approx(ring)
    said = r"bore_radius=0.00025 m is 8.38e-05 m less than the 0.000333779 m that the strands need"
    with pytest.raises(ValueError, match=said):
        compressed(layers, tube(1.1e-3))
    given = compressed(layers, tube(1.1e-3, 0.2e-3), radii=[0.0, 0.22e-3])
    assert given.radius[1:] == pytest.approx(0.22e-3)
    with pytest.raises(ValueError, match=r"radii=\[0.1\]: allowed is one for each of 2 layers"):
        compressed(layers, radii=[0.1])


def test_equal_area_sectors_keep_the_area() -> None:
    """Sectors of a disc: area moments about the axis add up to no more than the disc's."""
    layers = lay_up(19, 1e-3, [0.2, -0.2], ANNEALED_COPPER)
    section = compressed(layers)
    disc = np.pi / 4.0 * (19 * 1e-6 / 4.0) ** 2
    assert 0.85 * disc < np.sum(np.pi / 4e6 * section.y**2) < disc


def test_insulation_stiffness() -> None:
    found = Insulation(0.5e-3, 0.3e-3, 1e9)
    assert found.bending_stiffness == pytest.approx(np.pi / 64.0 * 1e9 * (1.6e-3**4 - 1e-12))
    assert found.axial_stiffness == pytest.approx(np.pi / 4.0 * 1e9 * (1.6e-3**2 - 1e-6))


def test_counts_that_do_not_match() -> None:
    with pytest.raises(ValueError, match=r"n_strands=20: 2 lay angles allow 19 \(1 \+ 6 \+ 12\)"):
        lay_up(20, 1e-3, [0.2, -0.2], ANNEALED_COPPER)
    with pytest.raises(ValueError, match=r"counts=\[1, 5\]: a hexagon has 1, 6, 12, 18"):
        hexagonal((Layer(1, 1e-3), Layer(5, 1e-3, 0.2)))
    with pytest.raises(ValueError, match=r"diameters=\[0.001, 0.002\]: the strands of a hexagon"):
        hexagonal((Layer(1, 1e-3), Layer(6, 2e-3, 0.2)))
    with pytest.raises(ValueError, match=r"strands in the order of the layers"):
        CrossSection("own", (Layer(1, 1e-3),), np.zeros(1), np.zeros(1), np.ones(1, dtype=int))


def test_bad_layers() -> None:
    with pytest.raises(ValueError, match=r"lay_angle=90 deg: allowed are angles between -90"):
        Layer(6, 1e-3, np.pi / 2.0)
    with pytest.raises(ValueError, match=r"count=0: allowed are whole numbers >= 1"):
        Layer(0, 1e-3)
    with pytest.raises(ValueError, match=r"poisson=0.6: allowed are numbers above -1, up to 0.5"):
        Layer(1, 1e-3, poisson=0.6)
    with pytest.raises(ValueError, match=r"poisson=-1.0: allowed are numbers above -1, up to 0.5"):
        Layer(1, 1e-3, poisson=-1.0)
    with pytest.raises(ValueError, match=r"diameter=nan: allowed are finite numbers > 0"):
        Layer(1, np.nan)


def test_overlap_of_circles() -> None:
    centres = np.array([[0.0, 0.0], [1.5, 0.0], [9.0, 0.0]])
    assert largest_overlap(centres, np.ones(3)) == pytest.approx(0.5)
    assert largest_overlap(centres[:1], np.ones(1)) == 0.0
