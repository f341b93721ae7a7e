"""What a walk leaves."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.rod.boundaries import Gravity
from labpipe.rod.statics import follow
from tests.builders.rods import LENGTH, linear_section, space_case, straight_line, walked


def test_a_path_ends_with_its_last_state() -> None:
    path = walked(*space_case(steps=2), 2)
    assert path.last is path.states[-1]
    assert len(path.work) == len(path.states) == 3


@pytest.mark.slow
def test_a_walk_without_a_state_has_no_last_one() -> None:
    """A line that nothing holds falls."""
    line = straight_line(LENGTH, 5, linear_section(mass=0.1))
    path = follow(line, [Gravity()], steps=1)
    assert path.status == "failed"
    with pytest.raises(ValueError, match="no state was reached: step 0: no equilibrium follows"):
        _ = path.last


def test_bendings_are_the_larger_of_both_sides_without_the_twist() -> None:
    state = walked(*space_case(steps=2), 2).last
    across = np.hypot(state.node_curvatures[..., 0], state.node_curvatures[..., 1])
    np.testing.assert_allclose(state.bendings, across.max(axis=1))
    assert state.bendings.shape == (13,)
