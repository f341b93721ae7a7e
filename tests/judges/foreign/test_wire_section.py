"""The second wire against closed forms, and against the package, with which it shares no code."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.wire.bending_law import moment_curvature
from labpipe.wire.calibration.wire_parts import loading_curve, take_apart
from labpipe.wire.first_loading import force_at
from tests.coverage.wire_campaigns import rig_of, wire_of
from tests.judges.foreign.wire_section import (
    BUILDS,
    MODULUS,
    PVC,
    Build,
    Truth,
    law,
    loading,
    weight_of,
)

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


def test_weight_of_a_wire_without_lay() -> None:
    build = Build(1, 1e-3, 2e-3, 0.5e-3, ())
    area = 0.25 * np.pi * 1e-6
    assert weight_of(build) == pytest.approx(9.80665 * area * (8960.0 + 3.0 * PVC))


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
    parts = take_apart(wire.section, wire.contacts)
    curve = loading_curve(parts, VALUES, 0.12, rig_of(0.12), 0.052, self_weight=weight)
    theirs, _ = force_at(curve, made.deflection)
    off = (made.force - theirs) / made.force[-1]
    assert np.max(np.abs(off)) < close
    assert np.sqrt(np.mean(off**2)) < 0.1 * close


@pytest.mark.slow
def test_weight_changes_the_first_millimetre_most() -> None:
    heavy, light = (loading("A3", 0.12, TRUE, has_weight=has) for has in (True, False))
    first, last = (
        np.interp(at, heavy.deflection, heavy.force) / np.interp(at, light.deflection, light.force)
        for at in (0.001, 0.05)
    )
    assert first == pytest.approx(1.08, abs=0.01)
    assert last == pytest.approx(1.006, abs=0.003)
