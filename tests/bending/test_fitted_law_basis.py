from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.bending.fitted_law import LawBasis, law_knots

BASIS = law_knots(0.06, 7)
amounts = st.lists(st.floats(0.0, 500.0), min_size=7, max_size=7)


@given(amounts, st.lists(st.floats(-0.08, 0.08), min_size=2, max_size=20))
def test_laws_are_odd_and_never_fall(compliance: list[float], moment: list[float]) -> None:
    at, weights = np.sort(np.array(moment)), np.array(compliance)
    curvature = BASIS.values(at) @ weights
    assert BASIS.values(-at) @ weights == pytest.approx(-curvature)
    assert (np.diff(curvature) >= -1e-9).all()


@given(amounts, st.floats(1e-4, 0.08))
def test_slopes_are_those_of_the_values(compliance: list[float], moment: float) -> None:
    weights, step = np.array(compliance), 1e-7
    ends = BASIS.values(np.array([moment - step, moment + step])) @ weights
    slope = float((ends[1] - ends[0]) / (2.0 * step))
    near = BASIS.slopes(np.array([moment - step, moment, moment + step])) @ weights
    assert near.min() - 1e-3 <= slope <= near.max() + 1e-3


def test_a_law_goes_on_straight_beyond_its_last_knot() -> None:
    basis = LawBasis(np.array([0.0, 1.0, 2.0]))
    assert basis.values(np.array([2.0, 3.0])) @ np.array([1.0, 1.0, 4.0]) == pytest.approx(
        [3.5, 7.5]
    )


def test_equal_compliances_are_a_straight_law() -> None:
    moment = np.linspace(-0.06, 0.06, 11)
    assert BASIS.values(moment) @ np.full(7, 200.0) == pytest.approx(200.0 * moment)


def test_knots_of_twice_as_many_hold_those_of_half() -> None:
    assert law_knots(0.06, 13).knots[::2] == pytest.approx(BASIS.knots)
    assert (np.diff(BASIS.knots, 2) > 0.0).all()
