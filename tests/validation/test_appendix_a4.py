"""The source's appendix A.4 as a plain script, its faults put right: `benchmarks/plain_loop.py`.

It shares no code with labpipe, and looks the copper's secant modulus up in a table. With 40 laminae
it is within 0.07 % (a sum of midpoints under a square root), with 400 within 0.003 %.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import plain_loop
from labpipe.wire.bending_law import moment_curvature, play_law
from labpipe.wire.cross_section import hexagonal
from labpipe.wire.end_load_path import end_load_path
from labpipe.wire.packing import overlap_energy
from tests.builders.stranded_wires import WIRES, contacts_of, layers_of, tube, wire

KAPPA = np.geomspace(1e-3, 60.0, 12)


def plain_wire(name: str) -> plain_loop.PlainWire:
    wire_diameter, _, diameter = WIRES[name]
    layers = layers_of(name)
    counts, lays = [layer.count for layer in layers], [layer.lay_angle for layer in layers]
    x, y = plain_loop.hexagon(counts, diameter)
    return plain_loop.PlainWire(
        counts, [diameter] * len(layers), lays, x, y, wire_diameter, wall=0.3e-3
    )


def test_the_same_hexagon() -> None:
    section, plain = hexagonal(layers_of("C4"), tube(WIRES["C4"][0])), plain_wire("C4")
    assert section.x == pytest.approx(plain.x, abs=1e-12)
    assert section.y == pytest.approx(plain.y, abs=1e-12)


@pytest.mark.parametrize("name", sorted(WIRES))
def test_moment_of_the_sources_wires(name: str) -> None:
    found = moment_curvature(wire(name), contacts_of(wire(name)), KAPPA).moment
    assert found == pytest.approx(plain_loop.moments(plain_wire(name), KAPPA.tolist()), rel=7e-4)


def test_moment_with_many_laminae() -> None:
    found = moment_curvature(wire("A2"), contacts_of(wire("A2")), KAPPA).moment
    many = plain_loop.moments(plain_wire("A2"), KAPPA.tolist(), laminae=400)
    assert found == pytest.approx(many, rel=3e-5)


@pytest.mark.parametrize("name", ["A2", "C4"])
def test_cantilever_with_the_law_along_the_wire(name: str) -> None:
    """End loads at 10, 30 and 50 mm on 85 mm, taken back to deflections by marching steps."""
    section, contacts = wire(name), contacts_of(wire(name))
    deflections = np.array([0.010, 0.030, 0.050])
    law = play_law(section, contacts, largest_curvature=80.0)
    loads = end_load_path(law, 0.085, deflections).load
    kappa = np.append(0.0, np.geomspace(1e-3, 80.0, 2000))
    moment = moment_curvature(section, contacts, kappa).moment
    marched = [plain_loop.tip_deflection(load, 0.085, kappa, moment) for load in loads]
    assert marched == pytest.approx(deflections, rel=2e-3)


def test_energy_of_overlaps() -> None:
    flat = np.random.default_rng(2).normal(scale=4.0, size=74)
    found, _ = overlap_energy(flat, 1.0, 6.5)
    assert found == pytest.approx(plain_loop.overlap(flat, 1.0, 6.5), rel=1e-12)
