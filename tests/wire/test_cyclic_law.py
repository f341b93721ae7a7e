"""Wire A2 of 85 mm, pulled by 50 mm and back twice; winding wires as in measurements.md."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from labpipe.mechanics.law.plays import PlayLaw
from labpipe.mechanics.wire.bending_law import compute_moment_curve, fit_play_law
from labpipe.mechanics.wire.cantilever import bend_to_deflection, bend_under_force, make_straight
from labpipe.mechanics.wire.cross_section import Layer, place_rings
from labpipe.mechanics.wire.materials import ANNEALED_COPPER, RambergOsgood
from tests.builders.stranded_wires import contacts_of, wire

LENGTH, PULL = 0.085, 0.05


class Loop(NamedTuple):
    """Residual deflection, mm; energies of both cycles, mJ; largest forces of both, N."""

    residual: float
    energies: tuple[float, float]
    forces: tuple[float, float]


def law_of_a2(share: float) -> PlayLaw:
    section = wire("A2")
    return fit_play_law(
        section, contacts_of(section), isotropic_share=share, largest_curvature=120.0
    )


def pulled_twice(law: PlayLaw) -> Loop:
    state, start, residuals, energies, forces = make_straight(law), 0.0, [], [], []
    for _ in range(2):
        path, load = [start], [0.0]
        for deflection in np.linspace(start, PULL, 25)[1:]:
            shape = bend_to_deflection(law, state, LENGTH, deflection)
            state = shape.state
            path.append(deflection)
            load.append(float(shape.force[1]))
        forces.append(load[-1])
        for share in np.linspace(1.0, 0.0, 25)[1:]:
            force = share * forces[-1]
            shape = bend_under_force(law, state, LENGTH, np.array([0.0, force]))
            start = float(shape.y[-1])
            state = replace(shape.state, travel=start)
            path.append(start)
            load.append(force)
        residuals.append(1e3 * start)
        energies.append(1e3 * float(np.trapezoid(load, path)))
    return Loop(residuals[0], (energies[0], energies[1]), (forces[0], forces[1]))


@pytest.mark.parametrize(
    ("share", "residual", "energies", "ratio"),
    [
        (0.0, 5.05, (0.615, 0.418), 1.000),
        (0.35, 8.46, (0.852, 0.638), 1.023),
        (0.65, 11.50, (1.040, 0.757), 1.040),
        (1.0, 15.18, (1.240, 0.818), 1.053),
    ],
)
def test_residual_energy_and_second_peak(
    share: float, residual: float, energies: tuple[float, float], ratio: float
) -> None:
    loop = pulled_twice(law_of_a2(share))
    assert loop.forces[0] == pytest.approx(0.1312, abs=1e-4)
    assert loop.residual == pytest.approx(residual, rel=0.01)
    assert loop.energies[0] == pytest.approx(energies[0], rel=0.015)
    assert loop.energies[1] == pytest.approx(energies[1], rel=0.03)  # one slider, not laminae
    assert loop.forces[1] / loop.forces[0] == pytest.approx(ratio, abs=0.002)


@pytest.mark.parametrize(
    ("share", "kept"),
    [
        (0.0, (0.142, 0.104, 0.079, 0.064)),
        (0.35, (0.239, 0.176, 0.133, 0.107)),
        (1.0, (0.420, 0.322, 0.239, 0.191)),
    ],
)
def test_curvature_kept_after_a_bend(share: float, kept: tuple[float, ...]) -> None:
    """Released to zero moment in one step, without a path."""
    law, bent = law_of_a2(share), np.array([5.0, 12.0, 23.5, 37.5])
    section = wire("A2")
    moment = compute_moment_curve(section, contacts_of(section), bent).moment
    history = law.respond(moment, law.make_unbent_history(len(bent))).history
    after = law.respond(np.zeros(len(bent)), history).curvature
    assert after / bent == pytest.approx(kept, abs=0.011)


ANOTHER_COPPER = RambergOsgood(110e9, 455e6, 0.343)
"""A firmer copper, of another handbook."""
WINDING_WIRES = {
    (0.274, 12.5): ((161, 116), (42, 42), (33, 37), (19, 25)),
    (0.315, 19.0): ((163, 119), (46, 49), (37, 43), (22, 30)),
    (0.508, 25.0): ((161, 117), (43, 44), (34, 39), (20, 26)),
    (0.813, 50.0): ((163, 120), (47, 49), (37, 44), (22, 30)),
    (1.219, 50.0): ((160, 114), (41, 40), (31, 35), (18, 23)),
}
"""Diameters of wire and mandrel, mm: springback, degrees of a turn, by fibres, for four shares."""


@pytest.mark.parametrize("wire_and_mandrel", WINDING_WIRES)
@pytest.mark.parametrize(
    ("place", "share", "tolerance"), [(0, 0.0, 1.5), (1, 0.35, 6.0), (2, 0.45, 1.5), (3, 1.0, 1.0)]
)
def test_springback_of_bare_winding_wires(
    wire_and_mandrel: tuple[float, float], place: int, share: float, tolerance: float
) -> None:
    """One growing slider yields at once where fibres yield one by one: most at 0.35."""
    diameter, mandrel = wire_and_mandrel
    bent = np.array([2e3 / (diameter + mandrel)])
    expected = WINDING_WIRES[wire_and_mandrel][place]
    for copper, springback in zip((ANNEALED_COPPER, ANOTHER_COPPER), expected, strict=True):
        section = place_rings((Layer(1, 1e-3 * diameter, 0.0, copper),))
        law = fit_play_law(
            section,
            contacts_of(section),
            isotropic_share=share,
            largest_curvature=1.5 * float(bent[0]),
        )
        moment = compute_moment_curve(section, contacts_of(section), bent).moment
        history = law.respond(moment, law.make_unbent_history(1)).history
        after = law.respond(np.zeros(1), history).curvature
        assert 360.0 * (1.0 - float((after / bent)[0])) == pytest.approx(springback, abs=tolerance)
