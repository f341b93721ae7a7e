"""What bent wires keep: fibres against the package, limits of standards against both rules."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from labpipe.wire.materials import ANNEALED_COPPER, RambergOsgood
from labpipe.wire.strand_bending import strand_moment
from labpipe.wire.wire_table import wire_table
from tests.builders.wire_tables import spec_of
from tests.judges.outside.page import PAGE, SPRINGBACK
from tests.judges.outside.springback import (
    FIRMER,
    WIRES,
    isotropic,
    kept,
    kept_of_a2,
    kinematic,
    left_of_a2,
    springback,
    tables,
)

COPPERS = (ANNEALED_COPPER, FIRMER)


@pytest.mark.parametrize("copper", COPPERS)
def test_masings_rule_of_fibres_is_that_of_the_whole_bar(copper: RambergOsgood) -> None:
    """A load follows twice the first loading at half the way, whatever it is summed up of."""

    def first(curvature: float) -> float:
        return float(strand_moment(copper, 0.32e-3, np.array([curvature])).moment[0])

    half = float(brentq(lambda curvature: first(curvature) - first(23.5) / 2.0, 0.0, 23.5))
    found = kept(kinematic, copper, 0.32e-3, 23.5)
    assert found == pytest.approx(1.0 - 2.0 * half / 23.5, abs=1e-4)


def test_an_elastic_release_by_hand() -> None:
    """Copper that does not yield backwards goes back by its moment over its stiffness."""
    stiffness = 110e9 * np.pi / 64.0 * 0.813e-3**4
    curvature = 2e3 / 50.813
    moment = strand_moment(ANNEALED_COPPER, 0.813e-3, np.array([curvature])).moment[0]
    by_hand = 360.0 * float(moment) / stiffness / curvature
    assert springback(isotropic, ANNEALED_COPPER, 0.813) == pytest.approx(by_hand, rel=1e-3)


@pytest.mark.parametrize("diameter", WIRES)
@pytest.mark.parametrize("copper", COPPERS)
def test_the_rule_of_the_wire_model_springs_back_too_far(
    copper: RambergOsgood, diameter: float
) -> None:
    most = WIRES[diameter][1]
    assert springback(kinematic, copper, diameter) > 1.8 * most
    assert springback(isotropic, copper, diameter) < 0.7 * most


def test_the_package_keeps_of_a2_what_the_fibres_say() -> None:
    """Friction, which the fibres leave out, keeps a little more."""
    table = wire_table(spec_of("A2", "A2"))
    moment = float(np.interp(23.5, table.curvature, table.moment))
    half = float(np.interp(moment / 2.0, table.moment, table.curvature))
    own = 1.0 - 2.0 * half / 23.5
    assert 0.0 < own - kept_of_a2(kinematic, 1e9, 23.5) < 0.012
    assert left_of_a2() == pytest.approx(5.0e-3, abs=0.1e-3)


def test_the_page_has_the_tables() -> None:
    text = PAGE.read_text(encoding="utf-8")
    begin, end = SPRINGBACK
    assert text.partition(begin)[2].partition(end)[0].strip() == tables()
