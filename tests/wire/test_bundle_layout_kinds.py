"""Kinds of wires on the sites of a bundle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labpipe.records.arrays import Floats, Ints
from labpipe.wire.bundle_layout import (
    _best_exchange,
    _neighbours,
    _traits,
    by_chance,
    evenly,
    on_one_side,
    sites,
)


@settings(max_examples=20, deadline=None)
@given(
    counts=st.lists(st.integers(0, 6), min_size=1, max_size=3).filter(lambda each: sum(each) > 1)
)
def test_every_spread_has_the_counts(counts: list[int]) -> None:
    places = np.random.default_rng(0).normal(size=(sum(counts), 2))
    chance = by_chance(counts, np.random.default_rng(1))
    for kind in (chance, evenly(places, counts), on_one_side(places, counts, [1.0] * len(counts))):
        assert np.bincount(kind, minlength=len(counts)).tolist() == counts


def test_the_stiffest_lies_on_top() -> None:
    places = sites(19)
    kind = on_one_side(places, [10, 9], [1.0, 2.0])
    assert places[kind == 1, 1].min() >= places[kind == 0, 1].max() - 1e-9
    assert places[kind == 1].mean(axis=0)[1] > 0.5
    assert places[kind == 1].sum(axis=0)[0] == pytest.approx(0.0, abs=1e-9)
    turned = on_one_side(places, [10, 9], [2.0, 1.0])
    assert places[turned == 0, 1].min() >= places[turned == 1, 1].max() - 1e-9


def test_a_shared_row_is_balanced() -> None:
    places = np.array([[-2.0, 0.0], [-1.0, 0.0], [0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    assert on_one_side(places, [3, 2], [1.0, 2.0]).tolist() == [0, 1, 0, 1, 0]
    assert on_one_side(places, [4, 1], [1.0, 2.0]).tolist() == [0, 0, 1, 0, 0]


def unevenness(places: Floats, kind: Ints) -> float:
    """How far the centroids and second moments of the kinds are from those of all wires."""
    x, y = (places - places.mean(axis=0)).T
    size = np.mean(x**2 + y**2)
    traits = [x / size**0.5, y / size**0.5, (x**2 - y**2) / size, 2.0 * x * y / size]
    traits.append((x**2 + y**2) / size - 1.0)
    sums = [[each[kind == k].sum() for each in traits] for k in range(kind.max() + 1)]
    return float(np.sum(np.square(sums) / np.bincount(kind)[:, None]))


def test_even_spread_is_evener_than_chance_and_repeats() -> None:
    places = sites(19)
    even = evenly(places, [10, 9], seed=2)
    assert np.array_equal(even, evenly(places, [10, 9], seed=2))
    rng = np.random.default_rng(5)
    chances = [unevenness(places, by_chance([10, 9], rng)) for _ in range(200)]
    assert unevenness(places, even) < min(chances)


def test_six_of_seven_around_the_core_cannot_be_even() -> None:
    """A lone wire of its kind goes where it tilts the bundle least: into the middle."""
    kind = evenly(sites(7), [6, 1])
    assert kind.tolist() == [1, 0, 0, 0, 0, 0, 0]


@pytest.mark.parametrize("counts", [[6, 5], [4, 4, 3]])
def test_the_best_exchange_is_the_best_of_all(counts: list[int]) -> None:
    """Against all exchanges; of equal ones that with fewer neighbours alike."""
    places = sites(11)
    traits, near = _traits(places), _neighbours(places)
    kind = by_chance(counts, np.random.default_rng(4))

    def merit(one: int, other: int) -> tuple[float, float]:
        changed = kind.copy()
        changed[[one, other]] = kind[[other, one]]
        alike = near * (changed[:, None] == changed)
        return round(unevenness(places, changed), 7), float(alike.sum())

    every = [(i, j) for i in range(11) for j in range(i) if kind[i] != kind[j]]
    assert merit(*_best_exchange(kind, traits, near)) == min(merit(*pair) for pair in every)
