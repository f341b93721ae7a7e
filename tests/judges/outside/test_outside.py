"""Measurements of others against the models, strict both ways, and the cards they stand on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.judges.outside.cards import (
    NUMBERS,
    Number,
    interval,
    stiffness,
)

AREA = np.pi * 2.1e-3**2 / 4.0


@pytest.mark.parametrize("number", NUMBERS, ids=lambda number: number.name)
def test_inside_or_said_why_not(number: Number) -> None:
    low, high = number.interval
    where = f"{number.value:.5g} {number.unit}, model {low:.5g} to {high:.5g}"
    if number.is_inside:
        assert not number.miss, f"{where}: inside, and yet the card says why it is outside"
    else:
        assert number.miss.endswith("."), f"{where}: outside, and the card does not say why"


def test_the_axial_stiffness_of_seven_wires_by_hand() -> None:
    """E A (1 + 6 cos^3), with the lay length 12 times the outer diameter of the strand."""
    rings = [
        {"count": 1, "diameter_mm": 2.1, "material": "x"},
        {"count": 6, "diameter_mm": 2.1, "material": "x", "lay": "lay_outer"},
    ]
    low, high = interval("axial", {"rings": rings, "modulus_x_gpa": 70.0, "lay_outer": 12.0}, {})
    cosine = 1.0 / np.hypot(1.0, 2.0 * np.pi * 2.1 / (12.0 * 6.3))
    assert low == high == pytest.approx(70e9 * AREA * (1.0 + 6.0 * cosine**3), rel=1e-12)


def test_the_line_through_published_points() -> None:
    found = [number for number in NUMBERS if number.points]
    assert found
    for finding in found:
        slope = np.polyfit(finding.points["strain"], finding.points["force_mn"], 1)[0]
        assert finding.value == pytest.approx(slope, rel=1e-3)


@pytest.mark.realdata
@pytest.mark.parametrize("number", [number for number in NUMBERS if number.bent])
def test_three_point_stiffness_is_that_of_the_files(number: Number, realdata: Path) -> None:
    assert stiffness(realdata, number.bent) == pytest.approx(number.value, rel=1e-3)
