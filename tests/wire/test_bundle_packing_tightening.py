"""Wires drawn together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime, nnls

from labpipe.records.arrays import Floats
from labpipe.wire.bundle_packing import (
    LEAST_FILLED,
    Contacts,
    densest_heap,
    gradient_of_heap,
    holding_circle,
    packing_fraction,
    require_dense,
)
from labpipe.wire.cross_section import largest_overlap


def test_gradient_of_the_energy() -> None:
    rng = np.random.default_rng(3)
    centres, diameters = rng.normal(size=(7, 2)), rng.uniform(0.5, 1.5, 7)
    first, second = np.triu_indices(7, 1)
    touching = 0.5 * (diameters[first] + diameters[second])
    force = rng.uniform(0.0, 0.2, len(first))

    def energy(flat: Floats) -> float:
        at = flat.reshape(-1, 2)
        overlap = touching - np.hypot(*(at[first] - at[second]).T)
        pushed = np.sum(np.maximum(force + 10.0 * overlap, 0.0) ** 2) / 20.0
        return float(np.sum(diameters**2 @ at**2) / 14.0 + pushed)

    contacts = Contacts(first, second, touching, force)
    gradient = gradient_of_heap(centres, diameters, contacts, 10.0)
    assert gradient.ravel() == pytest.approx(approx_fprime(centres.ravel(), energy), abs=1e-4)


@pytest.mark.parametrize("number", [7, 19, 40])
def test_wires_that_are_drawn_together_are_at_rest(number: int) -> None:
    """The pull on each wire is balanced by wires that touch it to 1e-12 of a diameter."""
    rng = np.random.default_rng(number)
    diameters = rng.uniform(0.8, 1.2, number)
    centres = densest_heap([rng.normal(size=(number, 2))], diameters)
    first, second = np.triu_indices(number, 1)
    apart = centres[first] - centres[second]
    distance = np.hypot(*apart.T)
    touch = distance < 0.5 * (diameters[first] + diameters[second]) + 1e-12
    pushes = np.zeros((int(touch.sum()), number, 2))
    row, along = np.arange(len(pushes)), (apart / distance[:, None])[touch]
    pushes[row, first[touch]], pushes[row, second[touch]] = along, -along
    pull = (diameters[:, None] ** 2 * centres).ravel()
    _, left = nnls(pushes.reshape(len(pushes), -1).T, pull)
    assert left < 1e-9 * np.linalg.norm(pull)


def test_three_unequal_wires_touch_each_other() -> None:
    diameters = np.array([1.0, 2.0, 3.0])
    found = densest_heap([np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]])], diameters)
    for one, other in ((0, 1), (0, 2), (1, 2)):
        apart = np.hypot(*(found[one] - found[other]))
        assert apart == pytest.approx((diameters[one] + diameters[other]) / 2.0, rel=1e-6)
    assert np.average(found, axis=0, weights=diameters**2) == pytest.approx([0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("beside", [0, 1, 2])
def test_wires_on_one_another_part(beside: int) -> None:
    """Seven at one place, some more at another."""
    centres = np.concatenate([np.zeros((7, 2)), np.full((beside, 2), 3.0)])
    found = densest_heap([centres], np.ones(7 + beside))
    assert largest_overlap(found, np.full(7 + beside, 0.5)) < 1e-9
    assert holding_circle(found, np.ones(7 + beside))[1] < 2.0


def test_one_wire_lies_in_the_middle() -> None:
    assert densest_heap([np.array([[3.0, 4.0]])], np.ones(1)).tolist() == [[0.0, 0.0]]


def test_scale_does_not_matter() -> None:
    rng = np.random.default_rng(1)
    begin, diameters = rng.normal(size=(9, 2)), rng.uniform(0.8, 1.2, 9)
    large, scale = densest_heap([begin], diameters), 2.0**-10  # which no number is rounded by
    small = densest_heap([scale * begin], scale * diameters)
    assert scale * large == pytest.approx(small, abs=1e-12)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), number=st.integers(2, 12))
def test_no_two_overlap(seed: int, number: int) -> None:
    rng = np.random.default_rng(seed)
    diameters = rng.uniform(0.5, 1.5, number)
    found = densest_heap([rng.normal(size=(number, 2))], diameters)
    assert largest_overlap(found, diameters / 2.0) < 1e-9


@pytest.mark.parametrize(("number", "seed"), [(5, 148), (6, 122), (9, 28), (11, 60)])
def test_wires_at_rest_in_a_loose_heap_are_shaken(number: int, seed: int) -> None:
    """Without it they fill less than half of the circle around them, and are refused."""
    rng = np.random.default_rng(seed)
    diameters = rng.uniform(0.5, 1.5, number)
    found = densest_heap([rng.normal(size=(number, 2))], diameters)
    assert largest_overlap(found, diameters / 2.0) < 1e-9
    assert packing_fraction(diameters, 2.0 * holding_circle(found, diameters)[1]) > 0.55


def test_a_row_is_shaken() -> None:
    """Four in a row, which nothing pushes aside: 0.25 filled; in a rhomb they fill 0.536."""
    row = np.column_stack([np.arange(4.0), np.zeros(4)])
    found = densest_heap([row], np.ones(4))
    assert packing_fraction(np.ones(4), 2.0 * holding_circle(found, np.ones(4))[1]) > 0.53


def test_circle_around_two_unequal_wires() -> None:
    middle, radius = holding_circle(np.array([[0.0, 0.0], [3.0, 0.0]]), np.array([2.0, 4.0]))
    assert radius == pytest.approx(3.0)
    assert middle == pytest.approx([2.0, 0.0], abs=1e-6)


def test_circle_around_three_wires() -> None:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(0.75)]])
    middle, radius = holding_circle(corners, np.ones(3))
    assert radius == pytest.approx(0.5 + 1.0 / np.sqrt(3.0))
    assert middle == pytest.approx(corners.mean(axis=0), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("number", [60, 200])
@pytest.mark.parametrize("kinds", [(1.1, 1.25), (1.0, 2.0, 1.5, 3.0)])
def test_many_unequal_wires_come_together(number: int, kinds: tuple[float, ...]) -> None:
    """A search by sequential least squares let some such heaps explode and left others loose."""
    rng = np.random.default_rng(2)
    diameters = rng.permutation(np.resize(kinds, number))
    starts = [2.0 * np.sqrt(number) * rng.uniform(-1.0, 1.0, size=(number, 2)) for _ in range(2)]
    found = densest_heap(starts, diameters)
    assert largest_overlap(found, diameters / 2.0) < 1e-9
    assert packing_fraction(diameters, 2.0 * holding_circle(found, diameters)[1]) > 0.6


def test_the_narrower_of_two_heaps() -> None:
    """A row that nothing pushes aside stays a row: 4 of 16 filled; a square fills 0.69."""
    row = np.column_stack([np.arange(4.0), np.zeros(4)])
    square = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    found = densest_heap([row, square], np.ones(4))
    assert holding_circle(found, np.ones(4))[1] == pytest.approx(0.5 + np.sqrt(0.5), abs=1e-5)


def test_wires_that_do_not_come_together_are_refused() -> None:
    row = np.column_stack([np.arange(4.0), np.zeros(4)])
    with pytest.raises(
        ValueError,
        match=r"^the 4 wires did not come together: they fill 0\.25 of the smallest circle around "
        r"them, expected at least 0\.5$",
    ):
        require_dense(row, np.ones(4))
    require_dense(row[:2], np.ones(2))  # two wires fill just half
    assert LEAST_FILLED == 0.5


@pytest.mark.parametrize("place", [np.nan, np.inf])
def test_places_that_are_no_numbers(place: float) -> None:
    with pytest.raises(ValueError, match=r"^a heap of wires: allowed are finite centres and "):
        densest_heap([np.array([[0.0, 0.0], [place, 1.0]])], np.ones(2))
    with pytest.raises(ValueError, match=r"the 2 wires did not come together: they fill 0 of"):
        require_dense(np.array([[0.0, 0.0], [place, 1.0]]), np.ones(2))


def test_circle_around_many_wires_touches_some_and_leaves_out_none() -> None:
    """More wires than are looked at first, the widest of them in the middle."""
    rng = np.random.default_rng(8)
    centres, diameters = rng.normal(size=(300, 2)), rng.uniform(0.1, 0.5, 300)
    diameters[np.argmin(np.hypot(*centres.T))] = 4.0
    middle, radius = holding_circle(centres, diameters)
    reach = np.hypot(*(centres - middle).T) + diameters / 2.0
    assert reach.max() == pytest.approx(radius)
    touching = centres[reach > radius * (1.0 - 1e-6)] - middle
    assert len(touching) >= 2
    # held from all sides: no half plane has all the wires that touch
    angle = np.sort(np.arctan2(*touching.T[::-1]))
    assert np.max(np.diff(np.append(angle, angle[0] + 2.0 * np.pi))) <= np.pi + 1e-3
