"""Masing (1926), and what friction and hardening may not do: wires bent there and back.

After a turn a body of many sliders follows its first loading at twice the size; loops close and
repeat; and no path from rest gives back more work than was put in, for what is not lost is stored.
Wires and paths are drawn by hypothesis. Paths are walked in steps small enough for the work to be
summed by trapezoids.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.records.arrays import Floats
from labpipe.wire.bending_law import moment_curvature
from labpipe.wire.cross_section import CrossSection, Layer, concentric
from labpipe.wire.friction import Contacts
from labpipe.wire.materials import ElasticPerfectlyPlastic
from labpipe.wire.strand_bending import LAMINAE
from tests.builders.stranded_wires import contacts_of as usual_contacts
from tests.builders.stranded_wires import wire
from tests.judges.reference_wires import bend_along

NAMES = st.sampled_from(["A1", "A2", "A3", "C4"])
TURNS = st.lists(st.floats(-30.0, 30.0), min_size=1, max_size=5)
FRICTION = st.floats(0.0, 0.8)
PRESS = st.floats(0.0, 3.0)


def contacts_of(section: CrossSection, friction: float, press: float) -> Contacts:
    rings = len(section.layers) - 1
    return Contacts((friction,) * rings, (friction,) * (rings - 1) + (friction / 2.0,), press)


def walk(turns: list[float], steps: int = 40) -> Floats:
    """From zero to each turn in even steps."""
    legs = [np.linspace(a, b, steps + 1)[1:] for a, b in pairwise([0.0, *turns])]
    return np.concatenate(legs)


@given(NAMES, FRICTION, PRESS, st.floats(0.1, 40.0), st.floats(0.0, 6.3))
def test_first_loading_is_the_monotonic_law(
    name: str, friction: float, press: float, peak: float, turn: float
) -> None:
    section = wire(name)
    contacts = contacts_of(section, friction, press)
    for way in (peak * np.linspace(0.05, 1.0, 20), -peak * np.linspace(0.05, 1.0, 20)):
        found = bend_along(section, contacts, way, orientation=turn)
        law = moment_curvature(section, contacts, way, orientation=turn).moment
        assert found == pytest.approx(law, rel=1e-9)


def without_lay(name: str) -> CrossSection:
    """Friction is then even on both sides, and rings do not press on each other."""
    section = wire(name)
    layers = tuple(
        replace(layer, lay_angle=1e-9 * bool(layer.lay_angle)) for layer in section.layers
    )
    return replace(section, layers=layers)


@given(NAMES, FRICTION, PRESS, st.floats(0.5, 30.0), st.floats(-1.0, 0.9))
def test_branches_are_the_first_loading_at_twice_its_size(
    name: str, friction: float, press: float, peak: float, share: float
) -> None:
    """Down from a peak, and up again from any lower turn."""
    section = without_lay(name)
    contacts = contacts_of(section, friction, press)
    down = np.linspace(peak, share * peak, 9)
    up = np.linspace(share * peak, peak, 9)
    moment = bend_along(section, contacts, np.concatenate([down, up[1:]]))
    half = moment_curvature(section, contacts, (peak - down) / 2.0).moment
    size = abs(moment[0])
    assert moment[:9] == pytest.approx(moment[0] - 2.0 * half, abs=1e-9 * size)
    assert moment[8:] == pytest.approx(moment[8] + 2.0 * half, abs=1e-9 * size)
    assert moment[-1] == pytest.approx(moment[0], rel=1e-9)


def laminae(path: Floats, strength: float, modulus: float) -> Floats:
    """Moments of a round strand, radius 1, of elastic-perfectly-plastic laminae, stepped each."""
    roots, weights = np.polynomial.legendre.leggauss(LAMINAE)
    angle = np.pi / 4.0 * (roots + 1.0)
    height = np.sin(angle)
    weight = np.pi * weights * height * np.cos(angle) ** 2
    stress, before, moments = np.zeros(LAMINAE), 0.0, []
    for kappa in path.tolist():
        stress = np.clip(stress + modulus * height * (kappa - before), -strength, strength)
        before = kappa
        moments.append(float(stress @ weight))
    return np.array(moments)


@given(st.lists(st.floats(-40.0, 40.0), min_size=1, max_size=12))
def test_memory_against_laminae_stepped_one_by_one(turns: list[float]) -> None:
    """Any path, with its inner loops: kinematic laminae, each with a history of its own."""
    strand = concentric((Layer(1, 2.0, 0.0, ElasticPerfectlyPlastic(1.0, 1e-2)),))
    path = 1e-3 * np.array(turns)
    found = bend_along(strand, usual_contacts(strand), path)
    # The spline meets a sharp yield to 1e-4 of the plateau, once for each turn remembered.
    within = 1e-4 * 4e-2 / 3.0 * (2 * len(turns) + 1)
    assert found == pytest.approx(laminae(path, 1e-2, 1.0), abs=within)
