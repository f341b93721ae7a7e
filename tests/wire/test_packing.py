from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from labpipe.records.arrays import Floats
from labpipe.wire.cross_section import Layer, lay_up, strand_diameter
from labpipe.wire.materials import ANNEALED_COPPER
from labpipe.wire.packing import Kind, lay_out, overlap_energy, packed
from tests.builders.stranded_wires import WIRES, layers_of, tube


def test_gradient_of_the_energy() -> None:
    rng = np.random.default_rng(3)
    flat = rng.normal(size=14)
    energy, gradient = overlap_energy(flat, 1.0, 2.0)

    def value(at: Floats) -> float:
        return overlap_energy(at, 1.0, 2.0)[0]

    numeric = approx_fprime(flat, value, 1e-7)
    assert gradient == pytest.approx(numeric, abs=1e-4)
    assert energy > 0.0


def test_energy_of_two_strands_counts_the_pair_from_both_sides() -> None:
    energy, gradient = overlap_energy(np.array([0.0, 0.0, 1.5, 0.0]), 1.0, 9.0)
    assert energy == pytest.approx(2.0 * 0.5**2)
    assert gradient == pytest.approx([2.0, 0.0, -2.0, 0.0])


def test_seven_strands_in_a_tight_bore_become_the_hexagon() -> None:
    section = packed(layers_of("A2"), tube(0.96e-3 + 0.6e-3))
    assert section.radius[0] == pytest.approx(0.0, abs=1e-6)
    assert section.radius[1:] == pytest.approx(0.32e-3, rel=2e-3)
    assert section.angle[1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("name", ["A1", "A3", "C4"])
def test_packings_fit_and_repeat(name: str) -> None:
    once, again = (packed(layers_of(name), tube(WIRES[name][0]), seed=5) for _ in range(2))
    assert once.x == pytest.approx(again.x, abs=0.0)
    assert once.overlap <= 1e-3 * (WIRES[name][0] / 2.0 - 0.3e-3)
    assert np.all(np.diff(np.sort(once.radius)) >= 0.0)
    rings = np.split(once.radius, np.cumsum([layer.count for layer in once.layers])[:-1])
    for inner, outer in pairwise(rings):
        assert inner.max() <= outer.min()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_single_strand_lies_on_the_axis_of_a_wide_bore(seed: int) -> None:
    section = packed((Layer(1, 0.3e-3),), tube(1.6e-3), seed=seed)
    assert (section.x.tolist(), section.y.tolist()) == ([0.0], [0.0])
    assert section.kind == "packed"


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_core_of_a_packing_lies_on_the_axis(seed: int) -> None:
    section = packed(layers_of("A2"), tube(1.9e-3), seed=seed)
    assert section.has_core
    assert (section.x[0], section.y[0]) == (0.0, 0.0)
    assert section.radius[1:].min() >= 0.32e-3 * (1.0 - 1e-6)


def test_a_bore_too_small_for_any_packing() -> None:
    with pytest.raises(ValueError, match="the packed layout does not fit: strands overlap"):
        packed(layers_of("A2"), tube(1.4e-3))


def test_the_layout_that_is_chosen() -> None:
    assert lay_out(layers_of("A2"), tube(1.6e-3)).kind == "hexagonal"
    assert lay_out((Layer(5, 0.3e-3, 0.2),), tube(1.6e-3)).kind == "concentric"
    crowded = (Layer(1, 0.2e-3), Layer(7, 0.2e-3, 0.2))  # seven do not fit around one
    assert lay_out(crowded, tube(1.6e-3)).kind == "packed"
    mixed = (Layer(1, 0.35e-3), Layer(6, 0.3e-3, 0.2))
    assert lay_out(mixed, tube(1.6e-3)).kind == "concentric"
    with pytest.raises(ValueError, match="only equal strands are packed"):
        packed(mixed, tube(1.6e-3))
    pressed = lay_up(7, strand_diameter(0.35e-6, 7), [0.2], ANNEALED_COPPER)
    kinds: tuple[Kind, ...] = ("hexagonal", "concentric", "packed")
    for kind in kinds:
        assert lay_out(layers_of("A2"), tube(1.6e-3), kind=kind).kind == kind
    assert lay_out(pressed, tube(1.1e-3, 0.2e-3), kind="compressed").kind == "compressed"


def test_the_seed_decides_on_the_packing() -> None:
    plain, zero, one = (
        packed(layers_of("A3"), tube(WIRES["A3"][0]), **kwargs).x
        for kwargs in ({}, {"seed": 0}, {"seed": 1})
    )
    assert plain.tolist() == zero.tolist()
    assert plain.tolist() != one.tolist()
