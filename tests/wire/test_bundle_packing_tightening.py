"""Wires drawn together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime

from labpipe.records.arrays import Floats
from labpipe.wire.bundle_packing import (
    drawn_together,
    holding_circle,
    pulled_overlap_energy,
)
from labpipe.wire.cross_section import largest_overlap


def test_gradient_of_the_energy() -> None:
    rng = np.random.default_rng(3)
    flat, diameters = rng.normal(size=14), rng.uniform(0.5, 1.5, 7)
    energy, gradient = pulled_overlap_energy(flat, diameters, 0.1)

    def value(at: Floats) -> float:
        return pulled_overlap_energy(at, diameters, 0.1)[0]

    assert gradient == pytest.approx(approx_fprime(flat, value, 1e-7), abs=1e-4)
    assert energy > 0.0


def test_energy_of_two_wires_by_hand() -> None:
    """1 m and 3 m wide, 1.5 m apart: they touch at 2 m. The larger one is 1.5 m off the origin."""
    flat, diameters = np.array([0.0, 0.0, 1.5, 0.0]), np.array([1.0, 3.0])
    energy, _ = pulled_overlap_energy(flat, diameters, 0.1)
    assert energy == pytest.approx(0.5**2 + 0.1 * 3.0**2 * 1.5**2)


def test_three_unequal_wires_touch_each_other() -> None:
    diameters = np.array([1.0, 2.0, 3.0])
    found = drawn_together(np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]]), diameters)
    for one, other in ((0, 1), (0, 2), (1, 2)):
        apart = np.hypot(*(found[one] - found[other]))
        assert apart == pytest.approx((diameters[one] + diameters[other]) / 2.0, rel=1e-6)
    assert np.average(found, axis=0, weights=diameters**2) == pytest.approx([0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("beside", [0, 1, 2])
def test_wires_on_one_another_part(beside: int) -> None:
    """Seven at one place, some more at another."""
    centres = np.concatenate([np.zeros((7, 2)), np.full((beside, 2), 3.0)])
    found = drawn_together(centres, np.ones(7 + beside))
    assert largest_overlap(found, np.full(7 + beside, 0.5)) < 1e-9
    assert holding_circle(found, np.ones(7 + beside))[1] < 2.0


def test_one_wire_lies_in_the_middle() -> None:
    assert drawn_together(np.array([[3.0, 4.0]]), np.ones(1)).tolist() == [[0.0, 0.0]]


def test_scale_does_not_matter() -> None:
    rng = np.random.default_rng(1)
    begin, diameters = rng.normal(size=(9, 2)), rng.uniform(0.8, 1.2, 9)
    large = drawn_together(begin, diameters)
    assert 1e-3 * large == pytest.approx(drawn_together(1e-3 * begin, 1e-3 * diameters), abs=1e-9)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), number=st.integers(2, 12))
def test_no_two_overlap(seed: int, number: int) -> None:
    rng = np.random.default_rng(seed)
    diameters = rng.uniform(0.5, 1.5, number)
    found = drawn_together(rng.normal(size=(number, 2)), diameters)
    assert largest_overlap(found, diameters / 2.0) < 1e-9


def test_circle_around_two_unequal_wires() -> None:
    middle, radius = holding_circle(np.array([[0.0, 0.0], [3.0, 0.0]]), np.array([2.0, 4.0]))
    assert radius == pytest.approx(3.0)
    assert middle == pytest.approx([2.0, 0.0], abs=1e-6)


def test_circle_around_three_wires() -> None:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(0.75)]])
    middle, radius = holding_circle(corners, np.ones(3))
    assert radius == pytest.approx(0.5 + 1.0 / np.sqrt(3.0))
    assert middle == pytest.approx(corners.mean(axis=0), abs=1e-6)
