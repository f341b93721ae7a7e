"""Where the wires of a bundle lie: sites, kinds, heaps and the circle around them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from labpipe.mechanics.wire.bundle_layout import (
    WireContacts,
    _choose_start_pitches,
    _cut_lattice,
    arrange_wires,
    choose_bore,
    compute_bore,
    compute_heap_gradient,
    compute_packing_fraction,
    find_densest_heap,
    find_enclosing_circle,
    find_sites,
    fits_bore,
    require_dense,
    spread_types,
    stack_types,
)
from labpipe.mechanics.wire.cross_section import compute_largest_overlap
from labpipe.records.arrays import Ints
from labpipe.records.harness_bundle import ARRANGEMENTS
from tests.builders.bundles import bundle


@pytest.mark.parametrize("number", [2, 8, 13, 19])
def test_wires_touch_and_do_not_overlap(number: int) -> None:
    places = find_sites(number)
    assert places.shape == (number, 2)
    assert compute_largest_overlap(places, np.ones(number) / 2.0) < 1e-9
    distance = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    np.fill_diagonal(distance, np.inf)
    assert distance.min(axis=1) == pytest.approx(1.0, abs=1e-4)
    if number == 8:  # the densest eight in a circle need 3.3048 radii (Pirl 1969)
        assert 3.3047 < 2.0 * find_enclosing_circle(places, np.ones(8))[1] < 1.11 * 3.3048


def test_distances_of_the_sites_from_which_wires_are_drawn_together() -> None:
    """Equal wires of the area of these three are sqrt(2) wide."""
    diameters = np.array([1.0, 1.0, 2.0])
    assert _choose_start_pitches(diameters, 2) == pytest.approx([2.0**0.5])
    shares = np.array([0.6, 0.8, 1.0])
    assert _choose_start_pitches(diameters, 1) == pytest.approx([2.0, *(shares * 2.0**0.5)])


def test_a_shared_row_is_balanced() -> None:
    places = np.array([[-2.0, 0.0], [-1.0, 0.0], [0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    assert stack_types(places, [3, 2], [1.0, 2.0]).tolist() == [0, 1, 0, 1, 0]
    assert stack_types(places, [4, 1], [1.0, 2.0]).tolist() == [0, 0, 1, 0, 0]


@pytest.mark.parametrize("counts", [[10, 9], [8, 6, 5]])
def test_no_exchange_makes_an_even_spread_evener(counts: list[int]) -> None:
    """By the centroids and second moments of the kinds."""
    places = find_sites(19)
    x, y = places.T / np.sqrt(np.mean(np.sum(places**2, axis=1)))
    traits = np.stack([x, y, x**2 - y**2, 2.0 * x * y, x**2 + y**2 - 1.0])

    def unevenness(kind: Ints) -> float:
        sums = [traits[:, kind == k].sum(axis=1) for k in range(len(counts))]
        return float(np.sum(np.square(sums) / np.array(counts)[:, None]))

    even = spread_types(places, counts)
    assert np.array_equal(even, spread_types(places, counts))
    assert np.array_equal(even, spread_types(places + 2.0, counts))
    assert np.bincount(even).tolist() == counts
    for pair in combinations(range(19), 2):
        exchanged = even.copy()
        exchanged[list(pair)] = even[list(pair[::-1])]
        assert unevenness(exchanged) > unevenness(even) - 1e-8


DIAMETERS, STIFFNESS = (1.10e-3, 1.25e-3), (37e3, 52e3)


@pytest.mark.parametrize("number", [5, 7, 19, 72])
def test_wires_that_are_drawn_together_are_at_rest(number: int) -> None:
    """The pull on each wire is balanced by wires that touch it to 1e-12 of a diameter."""
    rng = np.random.default_rng(number)
    diameters = rng.uniform(0.8, 1.2, number)
    centres = find_densest_heap([rng.normal(size=(number, 2))], diameters)
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


def test_wires_at_one_place_do_not_push_each_other() -> None:
    contacts = WireContacts(np.array([0]), np.array([1]), np.array([1.0]), np.array([2.0]))
    gradient = compute_heap_gradient(np.full((2, 2), 0.3), np.array([1.0, 2.0]), contacts, 5.0)
    assert gradient == pytest.approx(np.array([[0.15, 0.15], [0.6, 0.6]]))


@pytest.mark.parametrize("is_arc", [False, True])
def test_circle_around_many_wires_touches_some_and_leaves_out_none(*, is_arc: bool) -> None:
    """More wires than are looked at first, the widest in the middle; an arc and one opposite."""
    rng = np.random.default_rng(8)
    centres, diameters = rng.normal(size=(300, 2)), rng.uniform(0.1, 0.5, 300)
    diameters[np.argmin(np.hypot(*centres.T))] = 4.0
    if is_arc:
        angle = np.radians(np.append(np.linspace(100.0, 260.0, 30), np.zeros(270)))
        centres = np.column_stack([np.cos(angle), np.sin(angle)])
        centres[30:, 0], centres[30, 0], diameters = 0.3, 1.2, np.full(300, 0.01)
    middle, radius = find_enclosing_circle(centres, diameters)
    reach = np.hypot(*(centres - middle).T) + diameters / 2.0
    assert reach.max() == pytest.approx(radius)
    touching = centres[reach > radius * (1.0 - 1e-6)] - middle
    assert len(touching) >= 2
    # held from all sides: no half plane has all the wires that touch
    angle = np.sort(np.arctan2(*touching.T[::-1]))
    assert np.max(np.diff(np.append(angle, angle[0] + 2.0 * np.pi))) <= np.pi + 1e-3


@pytest.mark.parametrize(
    ("number", "core", "farthest"), [(7, 1, 1.0), (37, 1, 3.0), (12, 3, (7 / 3) ** 0.5)]
)
def test_hexagons(number: int, core: int, farthest: float) -> None:
    """Around one wire or three; from the middle outwards, then by angle."""
    places = find_sites(number)
    away = np.hypot(*places.T)
    assert away[:core] == pytest.approx(0.0 if core == 1 else 3.0**-0.5, abs=1e-12)
    assert away.max() == pytest.approx(farthest, abs=1e-12)
    assert places.mean(axis=0) == pytest.approx([0.0, 0.0], abs=1e-12)
    if number == 7:
        angle = np.degrees(np.arctan2(places[1:, 1], places[1:, 0])) % 360.0
        assert angle == pytest.approx(np.arange(6) * 60.0, abs=1e-9)
    # Around the middle of three, points of the lattice stay points of the lattice.
    middle = np.array([0.5, 12.0**-0.5])
    steps = (_cut_lattice(number, middle) + middle) @ np.linalg.inv([[1.0, 0.0], [0.5, 0.75**0.5]])
    assert steps == pytest.approx(np.round(steps), abs=1e-9)


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_mixed_bundles(arrangement: str) -> None:
    """Half a micrometre makes wires unequal, too."""
    diameters = (1.10e-3, 1.1005e-3) if arrangement == "symmetric" else DIAMETERS
    mixed = bundle(("B1", 10), ("B2", 9), arrangement=arrangement)
    layout = arrange_wires(mixed, diameters, STIFFNESS)
    centres = np.column_stack([layout.x, layout.y])
    assert layout.kind.tolist() == [0] * 10 + [1] * 9
    assert layout.diameter == pytest.approx(np.repeat(diameters, [10, 9]))
    assert compute_largest_overlap(centres, layout.diameter / 2.0) < 1e-12
    centroid = np.average(centres, axis=0, weights=layout.diameter**2)
    assert centroid == pytest.approx([0.0, 0.0], abs=1e-9)
    reach = np.hypot(*centres.T) + layout.diameter / 2.0
    assert layout.radius == pytest.approx(reach.max())
    assert 2.5 * diameters[0] < layout.radius < 2.5 * diameters[1] + 1e-4
    gap = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1))
    gap -= 0.5 * (layout.diameter[:, None] + layout.diameter)
    np.fill_diagonal(gap, np.inf)
    assert gap.min(axis=1).max() < 1e-8
    if arrangement == "asymmetric":
        stiff, soft = (layout.y[layout.kind == kind].mean() for kind in (1, 0))
        assert stiff > 1e-3 > 0.0 > soft
    elif arrangement == "packed":
        assert np.array_equal(layout.x, arrange_wires(mixed, diameters, STIFFNESS).x)


def test_stated_positions_are_kept_about_their_centroid() -> None:
    stated = bundle(("B1", 2), positions=((1e-3, 0.0), (1e-3, 2e-3)))
    layout = arrange_wires(stated, DIAMETERS[:1], STIFFNESS[:1])
    assert layout.arrangement == "stated"
    assert (layout.x.tolist(), layout.y.tolist()) == ([0.0, 0.0], [-1e-3, 1e-3])
    assert layout.radius == pytest.approx(1.55e-3)
    pressed = bundle(("B1", 2), positions=((0.0, 0.0), (1.092e-3, 0.0)))  # insulation gives
    assert arrange_wires(pressed, DIAMETERS[:1], STIFFNESS[:1]).arrangement == "stated"


def test_packing_fractions_and_bores() -> None:
    seven = np.full(7, 1e-3)
    assert compute_packing_fraction(seven, 3e-3) == pytest.approx(7.0 / 9.0)
    mixed = np.array([1.1e-3] * 10 + [1.25e-3] * 9)
    assert compute_packing_fraction(mixed, compute_bore(mixed)) == pytest.approx(0.7)
    assert compute_bore(seven, 7.0 / 9.0) == pytest.approx(3e-3)
    assert choose_bore(seven, (2.9e-3, 3.2e-3, 3.6e-3), min_bore=3e-3) == 3.2e-3
    assert choose_bore(seven, (3.6e-3, 9e-3), min_bore=3e-3) == 3.6e-3
    assert choose_bore(seven, (3e-3,), min_bore=3e-3) == 3e-3
    assert fits_bore(3e-3 * (1.0 + 1e-12), 3e-3)
    assert not fits_bore(3.001e-3, 3e-3)


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 10**6), number=st.integers(1, 10))
@example(seed=148, number=5)
@example(seed=28, number=9)
def test_heaps_are_dense_without_overlap_at_any_scale(seed: int, number: int) -> None:
    """The examples come to rest in loose heaps, which are shaken."""
    rng = np.random.default_rng(seed)
    diameters = rng.uniform(0.5, 1.5, number)
    start = rng.normal(size=(number, 2))
    heap = find_densest_heap([start], diameters)
    assert compute_largest_overlap(heap, diameters / 2.0) < 1e-9
    assert np.average(heap, axis=0, weights=diameters**2) == pytest.approx([0.0, 0.0], abs=1e-9)
    if number > 3:
        assert (
            compute_packing_fraction(diameters, 2.0 * find_enclosing_circle(heap, diameters)[1])
            > 0.5
        )
    scale = 2.0**-10  # rounds no number
    small = find_densest_heap([scale * start], scale * diameters)
    assert scale * heap == pytest.approx(small, abs=1e-12)


@pytest.mark.parametrize("beside", [0, 2])
def test_wires_on_one_another_part(beside: int) -> None:
    """Seven at one place, some more at another."""
    centres = np.concatenate([np.zeros((7, 2)), np.full((beside, 2), 3.0)])
    heap = find_densest_heap([centres], np.ones(7 + beside))
    assert compute_largest_overlap(heap, np.full(7 + beside, 0.5)) < 1e-9
    assert find_enclosing_circle(heap, np.ones(7 + beside))[1] < 2.0
    require_dense(np.array([[0.0, 0.0], [1.0, 0.0]]), np.ones(2))  # two wires fill just half
