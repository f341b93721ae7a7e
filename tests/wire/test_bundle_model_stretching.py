"""Sticking wires along their axes."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.wire.bundle_model import axial_force, largest_stretch, stretching_moment
from tests.builders.bundles import example_wires, solid_wire


@pytest.mark.parametrize("name", ["B1", "B2"])
def test_the_first_slope_is_the_axial_stiffness(name: str) -> None:
    table = example_wires()[name]
    assert axial_force(table, np.array([1e-9]))[0] / 1e-9 == pytest.approx(
        table.axial_stiffness, rel=1e-4
    )


def test_copper_that_yields_pulls_less_and_less() -> None:
    table, strain = example_wires()["B1"], np.linspace(0.0, 0.01, 50)
    force = axial_force(table, strain)
    assert force[0] == 0.0
    assert np.all(np.diff(force) > 0.0)
    assert np.all(np.diff(force, n=2) < 0.0)
    assert force[-1] < 0.2 * table.axial_stiffness * 0.01


def test_how_far_a_wire_can_be_stretched() -> None:
    assert largest_stretch(example_wires()["B1"]) == np.inf
    assert largest_stretch(solid_wire()) == 0.5


def test_two_elastic_wires() -> None:
    table, curvature = solid_wire(), np.array([0.0, 1.0, 5.0])
    y, kind = np.array([-1e-3, 2e-3]), np.zeros(2, dtype=np.int64)
    found = stretching_moment(curvature, y, kind, [table])
    assert found == pytest.approx(curvature * table.axial_stiffness * 2 * 1.5e-3**2, rel=1e-9)


def test_unequal_wires_share_a_neutral_axis() -> None:
    tables = [solid_wire(), solid_wire("H", modulus=3e11)]
    y, kind = np.array([0.0, 4e-3]), np.arange(2)
    found = stretching_moment(np.array([2.0]), y, kind, tables)
    soft, hard = (table.axial_stiffness for table in tables)
    assert found[0] == pytest.approx(2.0 * soft * hard / (soft + hard) * 4e-3**2, rel=1e-9)


def test_wires_in_one_row_are_not_stretched() -> None:
    found = stretching_moment(
        np.array([0.0, 9.0]), np.zeros(3), np.zeros(3, dtype=np.int64), [solid_wire()]
    )
    assert found.tolist() == [0.0, 0.0]


def test_yielding_wires_against_a_plain_sum() -> None:
    """Symmetric about y = 0, the axis stays there, and the moment is a sum of forces."""
    table, y = example_wires()["B2"], np.array([-2e-3, -1e-3, 0.0, 1e-3, 2e-3])
    found = stretching_moment(np.array([0.5]), y, np.zeros(5, dtype=np.int64), [table])
    plain = 2.0 * (axial_force(table, 0.5 * y[3:]) @ y[3:])
    assert found[0] == pytest.approx(plain, rel=1e-3)
