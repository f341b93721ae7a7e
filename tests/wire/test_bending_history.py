from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.records.arrays import Floats
from labpipe.wire.bending_history import (
    _turn,
    bend_along,
    hysteresis_loop,
    residual_curvature,
)
from labpipe.wire.cross_section import Layer, concentric
from labpipe.wire.friction import insulated
from labpipe.wire.materials import Elastic, ElasticPerfectlyPlastic
from labpipe.wire.moment_curvature import moment_curvature, slip_stiffness, stick_stiffness
from labpipe.wire.strand_bending import LAMINAE
from tests.builders.stranded_wires import cardinal, contacts_of, wire

NAMES = ["A2", "A3", "C4"]
KAPPA = np.linspace(0.0, 35.0, 300)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_first_loading_is_the_monotonic_law(name: str, sign: float) -> None:
    section = wire(name)
    contacts = contacts_of(section)
    for path in (sign * KAPPA, sign * np.geomspace(1e-3, 35.0, 200)):
        found = bend_along(section, contacts, path, orientation=0.1)
        law = moment_curvature(section, contacts, path, orientation=0.1)
        assert found.moment == pytest.approx(law.moment, rel=1e-12, abs=1e-18)
        assert found.own == pytest.approx(law.bending + law.plastic, rel=1e-12)


def test_first_loading_under_tension() -> None:
    contacts = insulated(4, strand=0.7, insulation=0.0, radial_force=0.0)
    path = np.linspace(0.0, 0.5, 200)
    found = bend_along(cardinal(), contacts, path, tension=40e3).moment
    law = moment_curvature(cardinal(), contacts, path, tension=40e3).moment
    assert found == pytest.approx(law, rel=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_unloading_starts_stiff_and_leaves_curvature(name: str) -> None:
    section = wire(name)
    contacts = contacts_of(section)
    path = np.concatenate([KAPPA, [35.0 - 1e-3], KAPPA[::-1]])
    found = bend_along(section, contacts, path)
    drop = (found.moment[299] - found.moment[300]) / 1e-3
    # Copper yields from the very first strain on, also after a turn.
    assert drop == pytest.approx(stick_stiffness(section), rel=0.01)
    assert 0.0 < residual_curvature(found) < 35.0


@pytest.mark.parametrize("name", NAMES)
def test_the_loop_closes_and_loses_energy(name: str) -> None:
    section = wire(name)
    loop = hysteresis_loop(section, contacts_of(section), 20.0)
    assert len(loop.curvature) == 401
    assert loop.moment[0] == pytest.approx(loop.moment[-1], rel=1e-9)
    assert loop.moment[200] == pytest.approx(-loop.moment[0], rel=1e-3)
    assert loop.dissipated > 0.0


def test_masing_loop_of_one_ring_without_pull_in_the_friction() -> None:
    """Even friction: the descending branch is the first loading at twice its size."""
    section = wire("A2")
    layers = tuple(
        replace(layer, lay_angle=1e-9 * bool(layer.lay_angle)) for layer in section.layers
    )
    straight = replace(section, layers=layers)
    contacts = contacts_of(section)
    down = np.linspace(20.0, -20.0, 200)
    found = bend_along(straight, contacts, np.concatenate([[20.0], down])).moment[1:]
    first = moment_curvature(straight, contacts, (20.0 - down) / 2.0).moment
    peak = moment_curvature(straight, contacts, np.array([20.0])).moment
    assert found == pytest.approx(peak - 2.0 * first, rel=1e-6, abs=1e-9)


def test_without_friction_or_yield_nothing_is_left() -> None:
    section = wire("A3", Elastic(110e9))
    loose = insulated(2, strand=0.0, insulation=0.0, radial_force=0.0)
    path = np.concatenate([KAPPA, KAPPA[::-1], -KAPPA])
    found = bend_along(section, loose, path)
    assert found.moment == pytest.approx(slip_stiffness(section) * path, abs=1e-12)


def test_perfectly_plastic_strand_comes_back_with_the_known_residue() -> None:
    """Unloading is elastic: what stays is the peak less M / EI."""
    diameter, stress = 0.3e-3, 60e6
    single = concentric((Layer(1, diameter, 0.0, ElasticPerfectlyPlastic(110e9, stress)),))
    path = np.concatenate([np.linspace(0.0, 50.0, 200), np.linspace(50.0, 0.0, 400)])
    found = bend_along(single, contacts_of(single), path)
    springback = found.moment[199] / (110e9 * np.pi * diameter**4 / 64.0)
    assert residual_curvature(found) == pytest.approx(50.0 - springback, rel=1e-3)


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
    strand = Layer(1, 2.0, 0.0, ElasticPerfectlyPlastic(1.0, 1e-2))
    path = 1e-3 * np.array(turns)
    found = bend_along(concentric((strand,)), contacts_of(concentric((strand,))), path).moment
    # The spline meets a sharp yield to 1e-4 of the plateau, once for each turn remembered.
    within = 1e-4 * 4e-2 / 3.0 * (2 * len(turns) + 1)
    assert found == pytest.approx(laminae(path, 1e-2, 1.0), abs=within)


def test_residue_of_a_path_that_does_not_come_back() -> None:
    section = wire("A2")
    assert np.isnan(residual_curvature(bend_along(section, contacts_of(section), KAPPA)))


def test_gaps_are_refused() -> None:
    section = wire("A2")
    for gap in (np.nan, np.inf):
        said = rf"curvature\[1\]={gap}: allowed is a path of finite numbers without gaps"
        with pytest.raises(ValueError, match=said):
            bend_along(section, contacts_of(section), np.array([1.0, gap]))


@pytest.mark.parametrize("scale", [1e-170, 5e-324])
def test_turns_of_the_smallest_steps_are_seen(scale: float) -> None:
    """The product of two such steps is zero."""
    turns: list[float] = []
    for present, target in pairwise((scale * np.array([0.0, 4.0, 1.0, 3.0])).tolist()):
        _turn(turns, present, target)
    assert turns == [4.0 * scale, 1.0 * scale]
    _turn(turns, 3.0 * scale, 5.0 * scale)
    assert not turns
