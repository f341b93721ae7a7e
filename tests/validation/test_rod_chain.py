"""The chain of the source's figure B.3, by equilibrium, by formulas, and by the source's own step.

One half: the middle, where it is held, is a plane of symmetry.
"""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from tests.judges.lifted_chains import LiftedChain, lifted_half


def shape_of(chain: LiftedChain, elements: int) -> Floats:
    arc = 0.5 * chain.length * np.arange(elements + 1) / elements
    return np.stack(chain.half_shape(arc), axis=1)


@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_with_friction_it_pulls_by_what_still_lies(friction: float) -> None:
    """Horizontal force = friction times the weight that still lies."""
    chain = LiftedChain(friction=friction)
    path = lifted_half(chain, 40, 1e-5)
    assert path.status == "ok", path.reasons
    places = path.last.positions
    assert places[:, [0, 2]] == pytest.approx(shape_of(chain, 40), abs=3e-3)
    assert path.last.forces[0, 0] == pytest.approx(chain.pull, rel=2e-3)
    assert np.max(np.abs(path.last.stretches)) < 1e-6
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert lengths == pytest.approx(0.5 * chain.length / 40, rel=1e-6)


@pytest.mark.slow
def test_without_friction_it_hangs_straight() -> None:
    """But for a bend of the length (EI / w)^(1/3), 5 mm, where it leaves the table."""
    chain = LiftedChain(friction=0.0)
    path = lifted_half(chain, 80, 1e-7)
    assert path.status == "ok", path.reasons
    assert abs(path.last.forces[0, 0]) < 1e-6
    assert path.last.positions[:, [0, 2]] == pytest.approx(shape_of(chain, 80), abs=0.006)
