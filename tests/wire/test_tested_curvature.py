"""How far tests bent a wire."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.wire.cantilever import bend_to_travel, straight
from labpipe.wire.tested_curvature import tested_curvature as curvature_of
from tests.builders.loading_tests import DEEPEST, TRUTH, law_of, measured, rig_of, wire_of


def test_it_is_that_of_the_path_station_by_station() -> None:
    """`wire.cantilever` shares only the law with the first integral."""
    wire = wire_of("A2")
    law = law_of(wire)
    shape = bend_to_travel(law, straight(law), 0.085, rig_of(0.085), DEEPEST)
    curves = [replace(each, deflection=np.clip(each.deflection, 0.0, None)) for each in measured()]
    deepest = max(float(each.deflection.max()) for each in curves)
    found = curvature_of(wire, TRUTH, curves)
    bent = float(np.abs(shape.curvature).max()) * deepest / float(shape.y[-1])
    assert found == pytest.approx(bent, rel=0.03)
    assert curvature_of(wire, np.full(3, np.nan), curves) == pytest.approx(found, rel=1e-6)


def test_the_shortest_wire_is_bent_most() -> None:
    wire = wire_of("A2")
    short, both = measured("A2", (0.085,)), measured("A2", (0.085, 0.12))
    assert curvature_of(wire, TRUTH, both) == pytest.approx(curvature_of(wire, TRUTH, short), 0.01)


def test_it_wants_a_curve() -> None:
    with pytest.raises(ValueError, match="at least one"):
        curvature_of(wire_of("A2"), TRUTH, [])
