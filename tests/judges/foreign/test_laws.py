"""The second simulator against closed forms, tables and the package, before it judges."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from labpipe.wire.bending_law import moment_curvature
from labpipe.wire.calibration.law_components import loading_curve, split_wire
from labpipe.wire.first_loading import force_at
from tests.coverage.wire_campaigns import rig_of, wire_of
from tests.judges.foreign.planar_rod import PlanarRod, Stops, stops_through
from tests.judges.foreign.rig import KINDS, MAKERS, wander
from tests.judges.foreign.specimens import Bending, Wire, knives
from tests.judges.foreign.wire_section import (
    BUILDS,
    MODULUS,
    Truth,
    law,
    loading,
)


@pytest.mark.parametrize(("load", "deflection"), [(1.0, 0.301721), (2.0, 0.493457)])
def test_elastica_of_a_cantilever(load: float, deflection: float) -> None:
    row, _ = Bending(Wire(1.0, 1.0, (), string=1e6, hung=0.0)).bent_by(load)
    assert row[2] == pytest.approx(deflection, abs=2e-6)


def test_rod_on_knife_edges() -> None:
    rod = knives()
    assert rod.load[50] / rod.deflection[50] == pytest.approx(48.0, rel=1e-4)
    x, y, angle = rod.axis(np.array([0.015]), 0.15, np.array([0.0, 0.05]))
    assert y[0, 0] == pytest.approx(-0.015, abs=1e-8)
    assert x[0, 0] == pytest.approx(0.0, abs=1e-8)
    assert 0.0 < angle[0, 1] < np.interp(0.1, rod.deflection, rod.slope)


@pytest.mark.parametrize("kind", [k for k in KINDS if k not in {"steps", "drift"}])
def test_noise_has_its_size(kind: str) -> None:
    made = [MAKERS[kind](4000, 0.01, np.random.default_rng(seed)) for seed in range(40)]
    assert np.sqrt(np.mean(np.square(made))) == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize(("lasts", "half"), [(6.0, 0.25), (6000.0, 0.5)])
def test_a_zero_is_as_far_off_at_its_end_as_is_stated(lasts: float, half: float) -> None:
    """From zero on; a line in a short record, a walk in a long one, each half way."""
    dt = lasts / 100.0
    made = np.array([wander(101, dt, np.random.default_rng(seed)) for seed in range(2000)])
    assert np.all(made[:, 0] == 0.0)
    assert made[:, [50, 100]].var(axis=0) == pytest.approx([half, 1.0], rel=0.08)


SPRING = Stops(1e-3, np.zeros(0), np.zeros(0))
LENGTH = 0.1


def along_circle(angle: float, length: float = LENGTH) -> np.ndarray:
    return np.array([np.sin(angle), 1.0 - np.cos(angle)]) * length / angle


def test_stops_keep_what_they_slid() -> None:
    """Bent evenly to 20 1/m and let go: the spring and the stop balance, 20 - M / (EI + K)."""
    rod = PlanarRod(LENGTH, 40, stops_through(np.array([0.0, 5.0, 50.0]), np.array([0.0, 5.0, 14])))
    for angle in np.linspace(0.2, 2.0, 10):
        rod.hold(along_circle(float(angle)), float(angle))
    assert rod.far_moment == pytest.approx(0.2 * 20.0 + 0.8 * 5.0, rel=1e-3)
    rod.curvature_after_release()
    assert rod.shape().curvature[:-1] == pytest.approx(np.full(40, 20.0 - 8.0), rel=3e-3)


def test_weight_is_carried() -> None:
    rod = PlanarRod(LENGTH, 60, SPRING, weight=2.0, has_far_clamp=False)
    rod.hold(LENGTH * np.array([0.95, -0.2]))
    assert rod.shape().start_force[1] + rod.force[1] == pytest.approx(2.0 * LENGTH)
    rod.curvature_after_release()
    fallen = solve_bvp(
        lambda s, y: np.stack([y[1], 2.0 * (LENGTH - s) * np.cos(y[0]) / 1e-3, np.sin(y[0])]),
        lambda clamp, tip: np.array([clamp[0], tip[1], clamp[2]]),
        *(np.linspace(0.0, LENGTH, 50), np.zeros((3, 50))),
        tol=1e-8,
    )
    assert -rod.shape().places[-1, 1] == pytest.approx(-fallen.y[2, -1], rel=1e-3)


TRUE = Truth()
VALUES = np.array([TRUE.friction, TRUE.modulus, TRUE.copper])


def test_limits_of_the_law() -> None:
    """Elastic and without friction at first; at last friction adds nothing to the slope."""
    build = BUILDS["A2"]
    curvature, moment = law("A2", Truth(friction=1e-9, copper=1e6))
    bore = build.diameter - 2.0 * build.wall
    tube = TRUE.modulus * np.pi / 64.0 * (build.diameter**4 - bore**4)
    lay = np.radians(12.0)
    turn = 0.5 * np.cos(lay) * (1.0 + np.cos(lay) ** 2 + np.sin(lay) ** 2 / 1.34)
    strands = MODULUS * np.pi / 64.0 * build.strand**4 * (1.0 + 6.0 * turn)
    assert moment[1:] / curvature[1:] == pytest.approx(tube + strands, rel=1e-4)
    rubbing = law("A2", Truth(copper=1e6))[1] - moment
    assert np.ptp(rubbing[-500:]) < 1e-9


@pytest.mark.parametrize("name", sorted(BUILDS))
def test_the_law_is_that_of_the_package(name: str) -> None:
    curvature, moment = law(name, TRUE)
    wire = wire_of(name)
    theirs = moment_curvature(wire.section, wire.contacts, curvature[1::40]).moment
    assert moment[1::40] == pytest.approx(theirs, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("has_weight", "close"), [(False, 1e-4), (True, 1e-3)])
def test_the_loading_is_that_of_the_package(*, has_weight: bool, close: float) -> None:
    """Root mean square over the curve, of its largest force; near rest a table is coarser."""
    made = loading("A3", 0.12, TRUE, has_weight=has_weight)
    wire = wire_of("A3")
    weight = wire.self_weight if has_weight else 0.0
    parts = split_wire(wire.section, wire.contacts)
    curve = loading_curve(parts, VALUES, 0.12, rig_of(0.12), 0.052, self_weight=weight)
    theirs, _ = force_at(curve, made.deflection)
    off = (made.force - theirs) / made.force[-1]
    assert np.max(np.abs(off)) < close
    assert np.sqrt(np.mean(off**2)) < 0.1 * close
