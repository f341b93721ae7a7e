"""The rod against closed forms and boundary value problems that share no code with it.

Errors fall with the square of the elements' length; the page `docs/explanations/rod.md` shows them
to 80 elements. What a rod does with sliders is judged in `tests/rod`.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.builders.judged_rods import (
    bend_error,
    buckled_column_error,
    catenary_error,
    heavy_cantilever_error,
    posed_rod_error,
)


def quarter(error: float) -> object:
    """What is left of an error of second order when elements are half as long."""
    return pytest.approx(0.25 * error, rel=0.25)


def size(error: object) -> float:
    return float(np.linalg.norm(np.asarray(error)))


@pytest.mark.parametrize(
    ("weight", "bound"), [(0.1, 1e-6), (1.0, 2e-5), (10.0, 4e-4), (50.0, 1e-3)]
)
def test_cantilever_under_its_weight(weight: float, bound: float) -> None:
    """PHYSICS 7: w L^3 / EI from 0.1 to 50."""
    coarse, fine = (size(heavy_cantilever_error(elements, weight)) for elements in (20, 40))
    assert coarse < bound
    assert fine < 0.32 * coarse


@pytest.mark.parametrize("degrees", [20.0, 60.0, 120.0, 176.0])
def test_column_after_buckling(degrees: float) -> None:
    """Found from the straight column, which stands on its own up to the critical load."""
    error = buckled_column_error(40, degrees)
    assert size(error) < 1e-3
    assert size(buckled_column_error(80, degrees)) < 0.3 * size(error)


def test_bend_of_45_degrees() -> None:
    """Bathe and Bolourchi (1979): within 0.02 % of 100 with 16 elements, of second order."""
    coarse, fine = size(bend_error(16)), size(bend_error(32))
    assert coarse < 0.03
    assert fine == quarter(coarse)


def test_catenary() -> None:
    """A rod of next to no stiffness between two pins: its sag, of its length."""
    coarse, fine = catenary_error(20), catenary_error(40)
    assert 0.0 < fine < 1e-4
    assert fine == pytest.approx(0.25 * coarse, rel=0.05)


def test_rod_posed_in_space() -> None:
    """Clamped at both ends, twisted and under its weight: shape and the far clamp's force."""
    (coarse, pulls), (fine, pull) = posed_rod_error(20), posed_rod_error(40)
    assert fine < 2e-4
    assert pull < 2e-3
    assert fine == quarter(coarse)
    assert pull == quarter(pulls)
