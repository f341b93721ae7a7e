"""What a law loses in each form."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import minimize

from labpipe.law.loss_card import fit_dahl, turn_loss
from labpipe.law.sliders import fit_sliders, slide, virgin_rests
from tests.builders.wire_tables import loss_card, wire_table


@pytest.mark.parametrize("name", ["A2", "C5"])
def test_example_wires_over_bends_of_a_harness(name: str) -> None:
    """0.1 to 10 1/m: constant EI 53 to 78 %, Dahl 3 to 9 %, 4 sliders 1.2 %, 8 sliders 0.4 %."""
    table = wire_table(name)
    card = loss_card(table.curvature, table.moment, first=0.1, last=10.0)
    assert (card.first, card.last) == (0.1, 10.0)
    assert 0.5 < card.constant < 0.8
    assert 0.03 < card.dahl.error < 0.09
    losses = dict(card.sliders)
    assert losses[4] < 0.012
    assert losses[8] < 0.004
    assert losses[12] < losses[8] < losses[6] < losses[4]
    spread = dict(card.directions)
    assert spread[4] < 0.04
    assert spread[16] < spread[4]


def test_a_constant_stiffness_by_hand() -> None:
    """Secants from 3 to 1: 1.5 is half too low and half too high."""
    card = loss_card(np.array([0.0, 1.0, 2.0, 6.0]), np.array([0.0, 3.0, 4.0, 6.0]), counts=(2,))
    assert card.stiffness == pytest.approx(1.5)
    assert card.constant == pytest.approx(0.5)
    ((number, error),) = card.sliders
    assert number == 2
    assert error < 1e-12


def test_a_dahl_law_is_found_again() -> None:
    bent = np.geomspace(0.05, 20.0, 150)
    moment = 2e-4 * bent + 1e-3 * (1.0 - np.exp(-bent / 1.3))
    found = fit_dahl(bent, moment)
    assert found.error < 1e-3
    assert found.stiffness == pytest.approx(2e-4, rel=0.01)
    assert found.moment == pytest.approx(1e-3, rel=0.01)
    assert found.decay == pytest.approx(1.3, rel=0.05)


def test_the_best_dahl_law_against_a_search() -> None:
    table = wire_table("A3")
    use = (table.curvature >= 0.1) & (table.curvature <= 10.0)
    x, y = table.curvature[use], table.moment[use]
    found = fit_dahl(x, y)

    def largest(logs: np.ndarray) -> float:
        stiffness, height, decay = np.exp(logs)
        return float(np.max(np.abs((stiffness * x + height * -np.expm1(-x / decay)) / y - 1.0)))

    start = np.log([found.stiffness, found.moment, found.decay])
    assert largest(start) == pytest.approx(found.error)
    searched = minimize(largest, start, method="Nelder-Mead", options={"maxiter": 4000})
    assert found.error < 1.005 * searched.fun


def test_a_dahl_law_of_a_straight_line_and_of_two_points() -> None:
    bent = np.array([1.0, 2.0, 3.0, 5.0])
    straight = fit_dahl(bent, 2.0 * bent)
    assert straight.error < 1e-9
    assert straight.stiffness == pytest.approx(2.0)
    two = fit_dahl(np.array([1.0, 4.0]), np.array([3.0, 6.0]))
    assert two.error < 0.05


def test_the_way_back_step_by_step() -> None:
    """Masing's rule by the sliders, isotropic hardening by a return map in small steps."""
    table = wire_table("A2")
    x, y = table.curvature, table.moment
    law = fit_sliders(x, y, 64)
    slope = y[1] / x[1]
    plastic = x - y / slope  # of first loading, against its moment
    worst = np.zeros(2)
    for turn in np.geomspace(2.0 * x[1], 0.5 * x[-1], 16):
        way = np.linspace(turn, 0.0, 401)
        rests = slide(law, np.array([turn]), virgin_rests(law, 1)).rests
        top = float(np.interp(turn, x, y))
        carried, hardened = top, float(np.interp(turn, x, plastic))
        for before, at in pairwise(way):
            carried += slope * (at - before)
            limit = float(np.interp(hardened, plastic, y))
            if -carried > limit:
                # M = -Y(p + dp) where S dp = -M_trial - Y: by secants of the table
                grown = plastic + y / slope
                hardened = float(np.interp(hardened - carried / slope, grown, plastic))
                carried = -float(np.interp(hardened, plastic, y))
            wanted = float(slide(law, np.array([at]), rests).moment[0])
            forgets = float(np.interp(at, x, y))
            off = np.abs([forgets - wanted, carried - wanted]) / top
            worst = np.maximum(worst, off)
    found = turn_loss(x, y)
    assert found.curve == pytest.approx(worst[0], rel=0.02)
    assert found.isotropic == pytest.approx(worst[1], rel=0.02)


def test_a_straight_law_loses_nothing_on_its_way_back() -> None:
    found = turn_loss(np.array([0.0, 1.0, 4.0]), np.array([0.0, 2.0, 8.0]))
    assert found.curve < 1e-12
    assert found.isotropic < 1e-12
