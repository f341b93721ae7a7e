"""Bases of curves in arc length, and the curve at rest."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.markers.curve_fits import (
    coupled_design,
    curve_at_rest,
    curve_basis,
    power_slopes,
    powers,
)
from labpipe.records.arrays import Floats


def test_slopes_of_powers() -> None:
    u = np.array([0.0, 0.5, 1.0])
    np.testing.assert_array_equal(powers(u, 3), [[1, 0, 0], [1, 0.5, 0.25], [1, 1, 1]])
    np.testing.assert_array_equal(power_slopes(u, 3), [[0, 1, 0], [0, 1, 1], [0, 1, 2]])


@pytest.mark.parametrize(
    ("clamped", "free_tip", "unknowns"),
    [(True, True, 4), (True, False, 5), (False, True, 6), (False, False, 7)],
)
def test_a_basis_obeys_its_ends(clamped: bool, free_tip: bool, unknowns: int) -> None:
    basis = curve_basis(terms=7, length=0.085, clamped=clamped, free_tip=free_tip)
    assert basis.unknowns == unknowns
    start, power = np.zeros(1), np.arange(7)
    assert bool(np.allclose(basis.value(start), 0)) is clamped
    assert bool(np.allclose(basis.slope(start), 0, atol=1e-9)) is clamped
    assert bool(np.allclose((power * (power - 1.0)) @ basis.matrix, 0, atol=1e-9)) is free_tip


def test_slope_is_the_derivative_of_value() -> None:
    basis = curve_basis(terms=6, length=0.085, clamped=True, free_tip=True)
    s, step = np.linspace(0.01, 0.08, 5), 1e-6
    numeric = (basis.value(s + step) - basis.value(s - step)) / (2 * step)
    np.testing.assert_allclose(basis.slope(s), numeric, rtol=1e-6, atol=1e-6)


def test_conditions_that_leave_nothing_are_refused() -> None:
    with pytest.raises(ValueError, match=r"terms=3: expected at least 4"):
        curve_basis(terms=3, length=0.085, clamped=True, free_tip=True)


def test_the_offset_of_the_markers_couples_x_and_y() -> None:
    basis = curve_basis(terms=4, length=0.1, clamped=False, free_tip=False)
    s = np.array([0.02, 0.07])
    design = coupled_design(basis, s, 0.001)
    np.testing.assert_allclose(design[:2, :4], basis.value(s))
    np.testing.assert_allclose(design[:2, 4:], -0.001 * basis.slope(s))
    np.testing.assert_allclose(design[2:, :4], 0.001 * basis.slope(s))


def sagging(offset: float) -> tuple[Floats, Floats]:
    """Markers on an arc of 0.5 m radius that leaves the clamp at 0.1 rad."""
    s = np.linspace(0.008, 0.081, 8)
    angle = 0.1 - 2 * s
    axis = np.column_stack([np.sin(0.1) - np.sin(angle), np.cos(angle) - np.cos(0.1), 0 * s]) / 2
    normal = np.column_stack([-np.sin(angle), np.cos(angle), 0 * s])
    return s, axis + offset * normal


@pytest.mark.parametrize("offset", [0.0, 0.0008])
def test_arc_lengths_of_a_curved_wire_at_rest(offset: float) -> None:
    s, markers = sagging(offset)
    along = np.array([np.cos(0.1), np.sin(0.1), 0.0])
    across = np.array([-np.sin(0.1), np.cos(0.1), 0.0])
    markers = markers + 0.006 * along + 0.002 * across
    found = curve_at_rest(
        markers, grip_offset=0.006, pull_offset=0.004, centre_offset=offset, free_tip=False
    )
    np.testing.assert_allclose(found.arc_length, s, atol=2e-6)
    np.testing.assert_allclose(found.tangent, along, atol=1e-4)
    np.testing.assert_allclose(found.clamped_end, 0.006 * along + 0.002 * across, atol=3e-6)


def test_without_a_clamp_arc_length_starts_at_the_first_marker() -> None:
    s, markers = sagging(0.0)
    found = curve_at_rest(
        markers, grip_offset=None, pull_offset=0.0, centre_offset=0.0, free_tip=False
    )
    np.testing.assert_allclose(found.arc_length, s - s[0], atol=1e-7)
