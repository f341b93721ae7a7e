"""The cantilever of a wire's table: its rest, and where its curve ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.law.play_fits import concave_law
from labpipe.units import GRAVITY
from labpipe.wire.cantilever import bend_to_deflection, held_level
from labpipe.wire.cantilever_curve import force_at
from labpipe.wire.end_load_path import end_load_path
from labpipe.wire.wire_table import wire_table
from tests.builders.wire_tables import codes, spec_of, told

A2 = spec_of("A2", "A2")


def test_a_cantilever_that_leaves_the_range_is_cut_and_said() -> None:
    table = wire_table(replace(A2, largest_curvature=20.0))
    assert codes(table) == ["cantilever_cut"]
    assert 0.1 < table.tip_deflection[-1] / A2.length < 0.8
    assert len(table.tip_force) >= 40
    assert told(table)[0].message.endswith(
        "not 68 mm: beyond, the curvature at the clamp leaves the range of the law, 20 1/m"
    )
    law = concave_law(table.curvature[1:], table.moment[1:])
    rest = held_level(law, A2.length, GRAVITY * table.mass_per_length).state
    end = bend_to_deflection(law, rest, A2.length, float(table.tip_deflection[-1]))
    assert end.moment[0] == pytest.approx(table.moment[-1], rel=1e-3)


def test_a_wire_at_rest_is_that_of_the_textbook() -> None:
    """A stiff one, of which nothing slips: 3 w L / 8, w L^2 / 8 and w L^4 / 185 EI."""
    table = wire_table(replace(A2, length=0.03))
    weight, rest = GRAVITY * table.mass_per_length, table.rest
    assert table.mass_per_length == pytest.approx(6.856e-3, rel=1e-3)
    assert rest is not None
    assert rest.force == pytest.approx(3.0 * weight * 0.03 / 8.0, rel=1e-4)
    assert rest.moment == pytest.approx(-weight * 0.03**2 / 8.0, rel=1e-3)
    assert rest.curvature == pytest.approx(rest.moment / table.stick_stiffness, rel=1e-3)
    sag = weight * 0.03**4 / 184.6 / table.stick_stiffness
    assert rest.sag == pytest.approx(sag, rel=5e-3)


def test_a_wire_too_limp_to_lie_level_is_bent_without_its_weight() -> None:
    table = wire_table(replace(A2, length=3.0))
    [note] = told(table)
    assert (note.code, table.rest) == ("weight_left_out", None)
    assert note.message.startswith(
        "the curve of the cantilever of 3000 mm is without the wire's own weight, 201.7 mN: "
    )
    assert table.tip_deflection[-1] == pytest.approx(2.4, rel=1e-12)


@pytest.mark.parametrize("length", [0.085, 0.3, 1.0])
def test_loads_between_the_points_are_those_of_the_solver(length: float) -> None:
    """From 0.2 % of the length on; with even points a wire of 1 m was 38 % off at 5 mm."""
    table = wire_table(replace(A2, length=length))
    asked = np.array([5e-3, 10e-3, 20e-3, 30e-3, 50e-3, 0.002 * length, 0.3 * length])
    law = concave_law(table.curvature[1:], table.moment[1:])
    weight = 0.0 if table.rest is None else GRAVITY * table.mass_per_length
    for each in np.unique(asked):
        exact = end_load_path(law, length, np.array([each]), self_weight=weight).load[0]
        assert force_at(table, float(each)) == pytest.approx(exact, rel=1e-3)
