"""A law as curvature over moment, and on from a rest."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.loading_table import LoadingTable
from labpipe.law.plays import LinearLaw, PlayLaw, first_curvature, respond, virgin_plays
from labpipe.records.arrays import Floats

PLAYS = PlayLaw(2.0, np.array([0.5, 1.0, 3.0]), np.array([0.5, 0.25, 1.0]))
MOMENT: Floats = np.linspace(0.0, 6.0, 61)


def test_a_law_of_plays_is_met_exactly_also_beyond_its_last_corner() -> None:
    table = LoadingTable.of_plays(PLAYS)
    curvature, slope = table.bend(np.concatenate([MOMENT, -MOMENT]))
    assert curvature[:61] == pytest.approx(first_curvature(PLAYS, MOMENT), rel=1e-12)
    assert curvature[61:] == pytest.approx(-curvature[:61], rel=1e-12)
    assert slope[[1, 7, 20, 40]] == pytest.approx([0.5, 1.0, 1.25, 2.25], rel=1e-12)
    assert LoadingTable.of_plays(LinearLaw(4.0)).bend(MOMENT)[0] == pytest.approx(MOMENT / 4.0)


@pytest.mark.parametrize("rest", [-2.0, -0.3, 0.0, 1.7])
def test_on_from_a_rest_as_plays_remember_it(rest: float) -> None:
    table, still = LoadingTable.of_plays(PLAYS), np.array([rest])
    plays = respond(PLAYS, still, virgin_plays(PLAYS, 1)).plays
    for moment in np.linspace(rest, 5.0, 23):
        wanted = respond(PLAYS, np.array([moment]), plays)
        curvature, slope = table.bend_on(still, np.array([[moment]]))
        assert curvature[0] == pytest.approx(wanted.curvature, abs=1e-12)
        if abs(moment - rest) > 1e-9:
            assert slope[0] <= wanted.compliance[0] + 0.5 + 1e-12


def scaled(scale: float) -> LoadingTable:
    """A smooth law of strength `scale` with its derivative by the scale's logarithm."""
    moment: Floats = np.linspace(0.0, 8.0, 4001)
    curvature = moment + (moment / scale) ** 2
    slope = 1.0 + 2.0 * moment / scale**2
    change = (-2.0 * (moment / scale) ** 2)[None]
    return LoadingTable(moment, curvature, slope[:-1], slope[1:], change[:, :-1], change[:, 1:])


def test_derivatives_by_a_parameter_with_those_of_the_rest() -> None:
    step, moment = 1e-4, np.linspace(-1.4, 4.0, 19)[None]

    def rest(scale: float) -> Floats:
        return np.full(19, -1.5 * scale)

    def bent(scale: float) -> Floats:
        return scaled(scale).bend_on(rest(scale), moment)[0]

    wanted = (bent(np.exp(step)) - bent(np.exp(-step))) / (2.0 * step)
    found = scaled(1.0).changes_on(rest(1.0), moment, np.full((1, 19), -1.5))
    assert found[0] == pytest.approx(wanted, rel=1e-5, abs=1e-6)
