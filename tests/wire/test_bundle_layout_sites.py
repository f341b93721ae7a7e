"""Places of equal wires."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.wire.bundle_layout import _core_of_hexagon, sites
from labpipe.wire.bundle_packing import holding_circle
from labpipe.wire.cross_section import largest_overlap


@pytest.mark.parametrize(("number", "radius"), [(1, 0.0), (7, 1.0), (19, 2.0), (37, 3.0)])
def test_hexagons_around_a_wire(number: int, radius: float) -> None:
    found = sites(number)
    assert found[0] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert np.hypot(*found.T).max() == pytest.approx(radius)


def test_every_hexagon_is_known_and_nothing_else_is_one() -> None:
    rings = np.arange(40)
    around_one = [int(each) for each in 1 + 3 * rings * (rings + 1)]
    around_three = [int(each) for each in 3 * (rings + 1) ** 2]
    known = {number for number in range(1, 4800) if _core_of_hexagon(number) is not None}
    assert known == {each for each in (*around_one, *around_three) if each < 4800}


@pytest.mark.parametrize(
    ("number", "farthest"), [(3, np.sqrt(1 / 3)), (12, np.sqrt(7 / 3)), (27, np.sqrt(19 / 3))]
)
def test_hexagons_around_a_core_of_three(number: int, farthest: float) -> None:
    found = sites(number)
    away = np.hypot(*found.T)
    assert away[:3] == pytest.approx(np.sqrt(1.0 / 3.0))
    assert away.max() == pytest.approx(farthest)
    assert found.mean(axis=0) == pytest.approx([0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("number", [2, 5, 8, 13, 19, 23, 27])
def test_wires_touch_and_do_not_overlap(number: int) -> None:
    found = sites(number)
    assert found.shape == (number, 2)
    assert largest_overlap(found, np.ones(number) / 2.0) < 1e-9
    distance = np.hypot(*(found[:, None] - found[None]).transpose(2, 0, 1))
    np.fill_diagonal(distance, np.inf)
    assert distance.min(axis=1) == pytest.approx(1.0, abs=1e-4)


def test_other_numbers_are_dense_and_repeat() -> None:
    once, again = sites(8, seed=3), sites(8, seed=3)
    assert np.array_equal(once, again)
    # The densest eight in a circle need 3.3048 radii (Pirl 1969).
    assert 3.3048 - 1e-4 < 2.0 * holding_circle(once, np.ones(8))[1] < 1.11 * 3.3048


def test_order_is_from_the_middle_outwards_then_by_angle() -> None:
    found = sites(7)
    angle = np.degrees(np.arctan2(found[1:, 1], found[1:, 0])) % 360.0
    assert angle == pytest.approx(np.arange(6) * 60.0, abs=1e-9)


def test_no_wire() -> None:
    with pytest.raises(ValueError, match=r"number=0: allowed are whole numbers >= 1"):
        sites(0)


@pytest.mark.slow
@pytest.mark.parametrize("number", [10, 22, 23, 38, 43, 45, 47, 48, 59, 61, 127, 300])
@pytest.mark.parametrize("middle", [(0.0, 0.0), (0.5, 0.0), (0.5, 3.0**-0.5 / 2.0)])
def test_a_heap_is_no_wider_than_the_lattice_around(
    number: int, middle: tuple[float, float]
) -> None:
    """The points of a lattice of triangles nearest to a point of it, or in the middle of two or
    three."""
    along, up = np.mgrid[-25:26, -25:26].reshape(2, -1)
    points = np.column_stack([along + 0.5 * up, 0.75**0.5 * up]) - middle
    nearest = points[np.argsort(np.hypot(*points.T).round(9), kind="stable")[:number]]
    ones = np.ones(number)
    assert holding_circle(sites(number), ones)[1] <= holding_circle(nearest, ones)[1] + 1e-6


def test_a_large_hexagon_is_wider_than_a_heap() -> None:
    """169 wires make a hexagon with its corners 7 diameters out; a lattice needs 7.43 for all."""
    assert holding_circle(sites(169), np.ones(169))[1] < 7.45
