"""Bending of the insulation: by lamina, with a stress table, and its loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.law.plays import respond, virgin_plays
from labpipe.wire.bending_law import moment_curvature, play_law
from labpipe.wire.cross_section import CrossSection, Insulation
from labpipe.wire.materials import StressTable
from labpipe.wire.strand_bending import tube_moment
from tests.builders.stranded_wires import contacts_of, wire

SOFT = StressTable((0.01, 0.03, 0.1, 0.3), (10e6, 18e6, 24e6, 30e6))
TUBE = Insulation(0.5e-3, 0.3e-3, 1e9, curve=SOFT)


def by_laminae(curvature: float) -> float:
    """Stress times lever over the ring, by its heights alone."""
    y = np.linspace(-0.8e-3, 0.8e-3, 400_001)
    outer = 2.0 * np.sqrt(np.maximum(0.8e-3**2 - y**2, 0.0))
    inner = 2.0 * np.sqrt(np.maximum(0.5e-3**2 - y**2, 0.0))
    stress = np.interp(np.abs(y) * curvature, [0.0, *SOFT.strains], [0.0, *SOFT.stresses])
    return float(np.trapezoid(np.sign(y) * stress * y * (outer - inner), y))


@pytest.mark.parametrize("curvature", [5.0, 20.0, 60.0, 125.0])
def test_a_ring_with_a_stress_table(curvature: float) -> None:
    found = tube_moment(TUBE, np.array([curvature, -curvature]))
    assert found.moment == pytest.approx([by_laminae(curvature), -by_laminae(curvature)], rel=1e-5)
    step = 1e-3 * curvature
    slope = (by_laminae(curvature + step) - by_laminae(curvature - step)) / (2.0 * step)
    assert found.tangent[0] == pytest.approx(slope, rel=1e-3)


def test_a_straight_line_at_any_strain() -> None:
    found = tube_moment(replace(TUBE, curve=None), np.array([1.0, 1e3]))
    assert found.moment == pytest.approx(TUBE.bending_stiffness * np.array([1.0, 1e3]))


def test_beyond_its_table_it_is_refused() -> None:
    with pytest.raises(ValueError, match=r"the material is known up to 0\.3, which is 375 1/m"):
        tube_moment(TUBE, np.array([400.0]))


def loop_area(section: CrossSection) -> float:
    """Area of the loop between plus and minus a moment, as a share of moment times curvature."""
    contacts = contacts_of(section)
    law = play_law(section, contacts, largest_curvature=125.0)
    top = float(moment_curvature(section, contacts, np.array([60.0])).moment[0])
    plays, loop = virgin_plays(law, 1), []
    for share in np.concatenate([np.linspace(1.0, -1.0, 400), np.linspace(-1.0, 1.0, 400)]):
        found = respond(law, np.array([share * top]), plays)
        plays = found.plays
        loop.append((share * top, float(found.curvature[0])))
    moment, curvature = np.array(loop).T
    return float(np.trapezoid(moment, curvature)) / (top * 60.0)


def test_its_loops_are_in_those_of_the_wire() -> None:
    """Kinematic memory: insulation that yields takes work in every loop, a straight line none."""
    plain = wire("A2")
    assert loop_area(replace(plain, insulation=TUBE)) > 3.0 * loop_area(plain)
