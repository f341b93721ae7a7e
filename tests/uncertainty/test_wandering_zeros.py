"""Modes of a zero that wanders, against a random walk."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.uncertainty.wandering_zeros import wanders

TIME = np.linspace(0.0, 50.0, 501)


def test_the_variance_is_that_of_a_walk() -> None:
    """As stated at the end, and within a tenth of a walk from a quarter of the record on."""
    waves = np.array(wanders(TIME, 0.3))
    spread = np.sqrt(np.sum(waves**2, axis=0))
    assert spread[-1] == pytest.approx(0.3, rel=1e-12)
    assert spread[0] == 0.0
    assert spread[125:] == pytest.approx(0.3 * np.sqrt(TIME[125:] / 50.0), rel=0.1)


def test_modes_do_not_overlap() -> None:
    products = np.array([np.trapezoid(x * y, TIME) for x, y in zip(*overlaps(), strict=True)])
    assert np.abs(products).max() < 1e-6


def overlaps() -> tuple[list[np.ndarray], list[np.ndarray]]:
    one, two, three = wanders(TIME, 1.0)
    return [one, one, two], [two, three, three]


def test_a_zero_that_stands_still_has_none() -> None:
    assert wanders(TIME, 0.0) == []
