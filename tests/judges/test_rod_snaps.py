"""Turn of a clamp at which a hung line snaps over, against a loop of directions."""

from __future__ import annotations

import numpy as np
import pytest

from tests.builders.real_wires import hang_of, snap_by_loop
from tests.judges.hung_wires import GRAVITY, HungElastica
from tests.judges.rod_fits import Estimate, Hang
from tests.judges.rod_snaps import fit_torsion, snap_turn

MASS = 0.02
STIFFNESS = 6e-4
ELEMENTS = 40


@pytest.fixture(scope="module")
def hang() -> Hang:
    """Synthetic."""
    loop = HungElastica(1.5, MASS * GRAVITY, STIFFNESS, (-0.12, 0.0))
    return hang_of(loop.at(np.linspace(0, 1, 31)), MASS)


@pytest.mark.slow
def test_it_snaps_as_the_loop_of_directions(hang: Hang) -> None:
    by_rod = snap_turn(hang, STIFFNESS, 1.2 * STIFFNESS)
    assert by_rod == pytest.approx(snap_by_loop(hang, STIFFNESS, 1.2), rel=5e-3)


@pytest.mark.slow
def test_the_ratio_is_found_again(hang: Hang) -> None:
    turn = snap_turn(hang, STIFFNESS, 1.2 * STIFFNESS, elements=ELEMENTS)
    stiffness = Estimate(STIFFNESS, (("scatter", 0.05 * STIFFNESS, 4.0), ("scale", 1.0, np.inf)))
    turns = turn * np.array([0.98, 1.0, 1.02])
    found = fit_torsion(hang, turns, stiffness, elements=ELEMENTS)
    assert found.value == pytest.approx(1.2, rel=0.01)
    parts = {name: (size, freedom) for name, size, freedom in found.parts}
    assert set(parts) == {"turns", "scatter"}
    # the turn falls a little slower than the ratio grows
    assert 1.0 < parts["turns"][0] / found.value / (0.02 / np.sqrt(3)) < 1.8
    assert parts["scatter"][0] < 0.02


def test_what_does_not_snap(hang: Hang) -> None:
    with pytest.raises(ArithmeticError, match="does not snap over up to 60 degrees"):
        snap_turn(hang, STIFFNESS, STIFFNESS, most=np.radians(60.0), elements=ELEMENTS)


@pytest.mark.parametrize("turns", [(8.0,), (8.0, -1.0), (8.0, np.nan)])
def test_turns_that_are_none(hang: Hang, turns: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="allowed are two finite numbers > 0, or more"):
        fit_torsion(hang, turns, Estimate(STIFFNESS, ()))
