"""The second simulator against closed forms, tables and the package, before it judges."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.mechanics.wire.bending_law import compute_moment_curve
from labpipe.mechanics.wire.calibration.law_components import compute_loading_curve, split_law
from labpipe.mechanics.wire.first_loading import interpolate_force
from tests.coverage.wire_campaigns import rig_of, wire_of
from tests.judges.foreign.rig import KINDS, MAKERS, wander
from tests.judges.foreign.specimens import Bending, Wire, knives
from tests.judges.foreign.wire_section import (
    BUILDS,
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


TRUE = Truth()
VALUES = np.array([TRUE.friction, TRUE.modulus, TRUE.copper])


@pytest.mark.parametrize("name", sorted(BUILDS))
def test_the_law_is_that_of_the_package(name: str) -> None:
    curvature, moment = law(name, TRUE)
    wire = wire_of(name)
    theirs = compute_moment_curve(wire.section, wire.contacts, curvature[1::40]).moment
    assert moment[1::40] == pytest.approx(theirs, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("has_weight", "close"), [(False, 1e-4), (True, 1e-3)])
def test_the_loading_is_that_of_the_package(*, has_weight: bool, close: float) -> None:
    """Root mean square over the curve, of its largest force; near rest a table is coarser."""
    made = loading("A3", 0.12, TRUE, has_weight=has_weight)
    wire = wire_of("A3")
    weight = wire.self_weight if has_weight else 0.0
    parts = split_law(wire.section, wire.contacts)
    curve = compute_loading_curve(parts, VALUES, 0.12, rig_of(0.12), 0.052, self_weight=weight)
    theirs, _ = interpolate_force(curve, made.deflection)
    off = (made.force - theirs) / made.force[-1]
    assert np.max(np.abs(off)) < close
    assert np.sqrt(np.mean(off**2)) < 0.1 * close
