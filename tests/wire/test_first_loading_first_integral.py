"""The sums of the first integral against their own differences."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.wire.cantilever import StringRig
from labpipe.wire.first_loading import (
    balance_of,
    misfit,
    respond_to,
    rule_of,
    slopes,
    solve_pair,
    tension_of,
    weight_of,
)
from tests.builders.bilinear_laws import bilinear_law, law_of_plays

RULE = rule_of(law_of_plays(bilinear_law(5e-3, 1.5e-3, 0.004), 0.02, n_points=6))
RIG = StringRig(0.76, 0.026, 0.085, 0.76)
FORCE, LEAN = np.linspace(0.05, 0.4, 6), np.linspace(-0.05, 0.08, 6)
STEP = 1e-6


def arc_and_misfit(force: Floats, lean: Floats, rig: StringRig | None) -> Floats:
    balance = balance_of(RULE, force, lean)
    return np.array([balance.arc_length, misfit(balance, rig)])


@pytest.mark.parametrize("rig", [None, RIG])
def test_slopes_by_differences(rig: StringRig | None) -> None:
    (arc_force, arc_lean), (gap_force, gap_lean) = slopes(balance_of(RULE, FORCE, LEAN), rig)
    rise = FORCE * STEP
    by_force = arc_and_misfit(FORCE + rise, LEAN, rig) - arc_and_misfit(FORCE - rise, LEAN, rig)
    by_lean = arc_and_misfit(FORCE, LEAN + STEP, rig) - arc_and_misfit(FORCE, LEAN - STEP, rig)
    assert np.array([arc_force, gap_force]) == pytest.approx(by_force / (2 * rise), rel=1e-6)
    assert np.array([arc_lean, gap_lean]) == pytest.approx(by_lean / (2 * STEP), rel=1e-6)


def test_response_keeps_arc_length_and_direction() -> None:
    """A change of B alone moves P and beta so that both equations still hold."""
    at = balance_of(RULE, FORCE, LEAN)
    zero, across = np.zeros(6), np.full(6, 1e-3)
    response = respond_to(at, RIG, zero, across, zero)
    by_x = (misfit_with(at.x + 1e-7) - misfit_with(at.x - 1e-7)) / 2e-7
    share = 0.1  # of a small change: rounding must not show
    force, lean = solve_pair(slopes(at, RIG), zero, by_x * across * at.sine)
    moved = balance_of(RULE, FORCE + share * force, LEAN + share * lean)
    back = balance_of(RULE, FORCE - share * force, LEAN - share * lean)
    tension = (tension_of(moved, RIG) - tension_of(back, RIG)) / (2 * share)
    assert response.tension == pytest.approx(tension, rel=1e-5)
    deflection = (moved.y - back.y) / (2 * share) + across * at.cosine
    assert response.deflection == pytest.approx(deflection, rel=1e-5)


def misfit_with(x: Floats) -> Floats:
    slant = (RIG.anchor_x - x) / RIG.string_length
    pull = FORCE * np.cos(LEAN) + RIG.weight
    return np.asarray(FORCE * np.sin(LEAN) * np.sqrt(1 - slant**2) + pull * slant)


def test_tension_is_force_and_weight() -> None:
    at = balance_of(RULE, FORCE, np.zeros(6))
    assert tension_of(at, RIG) == pytest.approx(FORCE + RIG.weight)
    assert tension_of(at, None) == pytest.approx(FORCE)
    assert weight_of(None) == 0.0
