from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.wire.calibration.fit import Wire
from labpipe.wire.materials import Elastic
from tests.builders.bilinear_laws import law_of_plays
from tests.builders.loading_tests import measured, wire_of
from tests.judges.source_method import calibrate_as_source, source_forces

WIRE = wire_of("A2")
CURVES = measured(samples=1, scatter=0.0, gain=0.0, noise=1e-4, n=60, has_string=False)
NUMBERS = np.array([0.21, 0.10, 0.15])


def elastic_wire() -> Wire:
    layers = tuple(replace(layer, material=Elastic(110e9)) for layer in WIRE.section.layers)
    return Wire(replace(WIRE.section, layers=layers), WIRE.contacts)


@pytest.mark.parametrize(("shape", "close"), [("elastica", 2e-3), ("series", 0.03)])
def test_right_for_a_wire_of_one_stiffness(shape: str, close: float) -> None:
    """Without friction and yield nothing is wrong but the series."""
    from labpipe.law.plays import LinearLaw
    from labpipe.wire.bending_law import slip_stiffness
    from labpipe.wire.first_loading import force_at, load_cantilever

    wire = elastic_wire()
    stiffness = slip_stiffness(wire.section)
    law = law_of_plays(LinearLaw(stiffness), 0.06, n_points=300)
    exact, _ = force_at(load_cantilever(law, 0.085, has_memory=False), CURVES[0].deflection)
    found = source_forces(wire, CURVES, np.array([0.0, 0.0, 0.0]), shape)
    assert found[1:] == pytest.approx(exact[1:], rel=close)
    if shape == "series":
        assert found[-1] / exact[-1] == pytest.approx(1.02, abs=0.005)


def test_only_phi_is_found() -> None:
    found = calibrate_as_source(WIRE, CURVES, start=(0.2, 0.2, 0.2))
    other = calibrate_as_source(WIRE, CURVES, start=(0.15, 0.3, 0.1))
    assert found.radial_friction == pytest.approx(other.radial_friction, rel=0.01)
    assert abs(found.strand_friction - other.strand_friction) > 0.02
    assert found.singular_values[1] < 1e-4 * found.singular_values[0]


def test_more_points_of_the_same_say_the_same() -> None:
    """The search must not walk on along the floor of its valley because there are more points."""
    found, many = (calibrate_as_source(WIRE, CURVES * count) for count in (1, 12))
    assert many.converged
    assert many.radial_friction == pytest.approx(found.radial_friction, rel=1e-3)
    assert many.strand_friction == pytest.approx(found.strand_friction, rel=1e-2)
