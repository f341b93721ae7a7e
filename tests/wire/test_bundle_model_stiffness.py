"""Bounds of a bundle's stiffness, and where a number lies between them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.wire.bundle_model import (
    common_curvature,
    share_of_bounds,
    slipping_moment,
    sticking,
)
from tests.builders.bundles import example_wires


def test_two_wires_above_each_other() -> None:
    stuck = sticking(np.zeros(2), np.array([-1e-3, 1e-3]), np.full(2, 2e-3), np.full(2, 5e4))
    assert stuck.tensor == pytest.approx(np.diag([4e-3, 4e-3 + 2 * 5e4 * 1e-6]))
    assert stuck.principal == pytest.approx((4e-3, 0.104))
    assert stuck.angle == pytest.approx(np.pi / 2.0)
    assert stuck.neutral == (0.0, 0.0)


def test_the_neutral_axis_is_nearer_to_the_stiffer_wire() -> None:
    stuck = sticking(np.zeros(2), np.array([0.0, 4e-3]), np.zeros(2), np.array([1e4, 3e4]))
    assert stuck.neutral == pytest.approx((0.0, 3e-3))
    assert stuck.tensor[1, 1] == pytest.approx(1e4 * 9e-6 + 3e4 * 1e-6)


@given(turn=st.floats(-1.5, 1.5))
def test_a_turned_bundle_has_turned_axes(turn: float) -> None:
    along = np.array([-1e-3, 0.0, 1e-3])
    stuck = sticking(along * np.cos(turn), along * np.sin(turn), np.full(3, 1e-3), np.full(3, 1e4))
    assert stuck.angle == pytest.approx(turn, abs=1e-9)
    assert stuck.principal == pytest.approx((3e-3, 0.023))
    axis = np.array([np.cos(turn), np.sin(turn)])
    assert axis @ stuck.tensor @ axis == pytest.approx(0.023)


def test_equal_directions_have_the_angle_zero() -> None:
    turns = np.arange(3) * 2.0 * np.pi / 3.0
    stuck = sticking(np.cos(turns), np.sin(turns), np.ones(3), np.ones(3))
    assert stuck.angle == 0.0


@given(
    seed=st.integers(0, 10**6),
    number=st.integers(1, 20),
    scale=st.floats(0.1, 10.0),
)
def test_properties_of_the_tensor(seed: int, number: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(2, number))
    bending, axial = rng.uniform(0.1, 1.0, (2, number))
    stuck = sticking(x, y, bending, axial)
    assert stuck.tensor == pytest.approx(stuck.tensor.T)
    assert stuck.principal[0] >= bending.sum() * (1.0 - 1e-12)  # sticking never softens
    order = rng.permutation(number)
    other = sticking(x[order], y[order], bending[order], axial[order])
    assert other.tensor == pytest.approx(stuck.tensor)
    # all lengths times c: EA grows with c^2, EI with c^4
    grown = sticking(scale * x, scale * y, scale**4 * bending, scale**2 * axial)
    assert grown.tensor == pytest.approx(scale**4 * stuck.tensor, rel=1e-9)
    moved = sticking(x + 3.0, y - 2.0, bending, axial)
    assert moved.tensor == pytest.approx(stuck.tensor, rel=1e-9, abs=1e-9)


def test_common_curvatures_end_with_the_shortest_law() -> None:
    tables = tuple(example_wires().values())
    found = common_curvature(tables)
    assert found[0] == 0.0
    assert found[-1] == min(table.curvature[-1] for table in tables)
    assert np.all(np.diff(found) > 0.0)
    first = tables[0].curvature[tables[0].curvature <= found[-1]]
    assert np.isin(first, found).all()


def test_slipping_moments_add_up() -> None:
    b1, b2 = example_wires().values()
    found = slipping_moment(b1.curvature[:5], [b1, b2], [3, 2])
    second = np.interp(b1.curvature[:5], b2.curvature, b2.moment)
    assert found == pytest.approx(3 * b1.moment[:5] + 2 * second)


@pytest.mark.parametrize(
    ("value", "share"),
    [(1.0, 0.0), (10.0, 1.0 / 11.0), (100.0, 1.0), (1000.0, 999.0 / 99.0), (-0.1, -1.1 / 99.0)],
)
def test_shares(value: float, share: float) -> None:
    assert share_of_bounds(value, 1.0, 100.0) == pytest.approx(share)


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (2.0, 2.0, r"^low=2, high=2 N m\^2: allowed are bounds with 0 < low < high$"),
        (0.0, 2.0, r"^low=0, high=2 N m\^2"),
    ],
)
def test_shares_that_mean_nothing(low: float, high: float, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        share_of_bounds(1.0, low, high)
