"""Loss card: errors of a law in each form that simulation programs offer.

All errors are the largest distance from the law's moment on first loading over a range of
curvatures, as a share of that moment, for the best fit of each form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labpipe.mechanics.law.sliders import (
    SliderLaw,
    cut_to_range,
    fit_directions,
    fit_sliders,
    turn_directions,
)
from labpipe.records.arrays import Floats, Ints
from labpipe.records.wire import WireTable

SLIDER_COUNTS = (4, 6, 8, 12)
"""Numbers of sliders on a card."""
N_DIRECTIONS = 4
"""Directions of scalar sliders, on a card and in decks."""

_N_DECAYS = 60


@dataclass(frozen=True, slots=True)
class DahlLaw:
    """A spring and one slider with gradual slip, after Dahl (1968).

    M = EI kappa + M_0 (1 - exp(-kappa / tau)) on first loading.

    Parameters
    ----------
    stiffness : EI, N m^2
    moment : M_0, N m
    decay : tau, 1/m
    error : of the fit, as a share of the moment
    """

    stiffness: float
    moment: float
    decay: float
    error: float


@dataclass(frozen=True, slots=True)
class LossCard:
    """Errors of a law in each form.

    Parameters
    ----------
    first, last : 1/m, the range
    stiffness : N m^2, the best constant one
    constant : error of the constant stiffness
    dahl : the best Dahl law
    sliders : number of sliders and error of each fit; fewer sliders than requested if the law
        has fewer corners
    directions : number of directions of scalar sliders in three dimensions, and the largest
        difference of the moment along the curvature from that of vector sliders, in the worst
        direction: for one node, and for nodes with turned directions (`turn_directions`)
    """

    first: float
    last: float
    stiffness: float
    constant: float
    dahl: DahlLaw
    sliders: tuple[tuple[int, float], ...]
    directions: tuple[tuple[int, float], ...]


def make_loss_card(curvature: Floats, moment: Floats, laws: Sequence[SliderLaw]) -> LossCard:
    """Compute the loss card of a law from the sliders fitted to it.

    Parameters
    ----------
    curvature, moment : as for `fit_sliders`
    laws : fits of it over one range, at least one
    """
    x, y, start = cut_to_range(curvature, moment, laws[0].first, laws[0].last)
    secant = y[1:] / x[1:]
    low, high = float(secant.min()), float(secant.max())
    best_law = laws[int(np.argmin([law.error for law in laws]))]
    scalar_law = fit_directions(best_law, N_DIRECTIONS)
    return LossCard(
        first=start,
        last=float(x[-1]),
        stiffness=2.0 * low * high / (low + high),
        constant=(high - low) / (high + low),
        dahl=fit_dahl(*_thinned_rows(x[1:], y[1:])),
        sliders=tuple((len(law.stiffnesses), law.error) for law in laws),
        directions=tuple(
            (directional.directions, directional.error)
            for directional in (scalar_law, turn_directions(best_law, scalar_law))
        ),
    )


def _thinned_rows(curvature: Floats, moment: Floats) -> tuple[Floats, Floats]:
    """Thin out the points of a law, keeping its ends: enough for three parameters."""
    max_rows = 80
    if len(curvature) <= max_rows:
        return curvature, moment
    rows = np.round(np.linspace(0.0, len(curvature) - 1.0, max_rows)).astype(np.int64)
    return curvature[rows], moment[rows]


@dataclass(frozen=True, slots=True)
class TurnLoss:
    """Largest error of unbending, as a share of the moment at the turn.

    Parameters
    ----------
    curve : of a law without memory
    curve_at : 1/m, curvature of the turn
    isotropic : of isotropic hardening
    isotropic_at : 1/m
    """

    curve: float
    curve_at: float
    isotropic: float
    isotropic_at: float


def compute_turn_loss(curvature: Floats, moment: Floats) -> TurnLoss:
    """Compute the errors for a wire that is bent and straightened again.

    Parameters
    ----------
    curvature : shape (n,), 1/m, from 0, increasing, n >= 2
    moment : shape (n,), N m, from 0, positive

    Notes
    -----
    The wire is turned at curvatures up to half of the range, so that a hardening law stays within
    it, and straightened; it follows Masing's rule, M_0 - 2 M((kappa_0 - kappa) / 2). With isotropic
    hardening M = M_0 - S (kappa_0 - kappa), S the first slope, down to -M_0; beyond it yields the
    other way, shifted by the plastic part of the first loading: M = -M(2 kappa_0 - kappa - 2 M_0 /
    S).
    """
    n_turns = 40
    n_points = 41
    slope = moment[1] / curvature[1]
    turn = np.geomspace(min(curvature[1], 0.25 * curvature[-1]), 0.5 * curvature[-1], n_turns)
    turn = turn[:, None]
    curvatures = turn * np.linspace(0.0, 1.0, n_points)
    top = np.interp(turn, curvature, moment)
    masing = top - 2.0 * np.interp(0.5 * (turn - curvatures), curvature, moment)
    straight = top - slope * (turn - curvatures)
    yields = -np.interp(2.0 * turn - curvatures - 2.0 * top / slope, curvature, moment)
    isotropic = np.where(straight >= -top, straight, yields)
    largest: list[float] = []
    for carried in (np.interp(curvatures, curvature, moment), isotropic):
        errors = np.max(np.abs((carried - masing) / top), axis=1)
        worst_turn = int(np.argmax(errors))
        largest += [float(errors[worst_turn]), float(turn[worst_turn, 0])]
    return TurnLoss(*largest)


def fit_dahl(curvature: Floats, moment: Floats) -> DahlLaw:
    """Fit one exponential slider and a spring, with the smallest largest error.

    Parameters
    ----------
    curvature : shape (n,), 1/m, positive and increasing
    moment : shape (n,), N m, positive

    Notes
    -----
    For each of many decays the minimax spring and slider are found by exchange of the three points
    of equal error with alternating sign (Stiefel, Numerische Mathematik 1 (1959) 1-28); the optimum
    is unique because the ratio of the two functions falls. Negative springs and sliders are left
    out.
    """
    if len(curvature) < 3:  # the exchange needs three points
        middle = 0.5 * (curvature[0] + curvature[-1])
        moment = np.insert(moment, 1, np.interp(middle, curvature, moment))
        curvature = np.insert(curvature, 1, middle)
    coarse = _best_dahl(curvature, moment, 0.3 * curvature[0], 3.0 * curvature[-1])
    range_factor = (10.0 * curvature[-1] / curvature[0]) ** (2.0 / _N_DECAYS)
    return _best_dahl(curvature, moment, coarse.decay / range_factor, coarse.decay * range_factor)


def _best_dahl(curvature: Floats, moment: Floats, least: float, largest: float) -> DahlLaw:
    max_exchanges = 40
    tolerance = 1e-9  # of the error, absolute and relative
    decay = np.geomspace(least, largest, _N_DECAYS)
    spring = np.broadcast_to(curvature / moment, (_N_DECAYS, len(curvature)))
    slider = -np.expm1(-curvature / decay[:, None]) / moment
    points = np.tile([0, len(curvature) // 2, len(curvature) - 1], (_N_DECAYS, 1))
    for _ in range(max_exchanges):
        sides = [np.take_along_axis(column, points, axis=1) for column in (spring, slider)]
        signs = np.broadcast_to([1.0, -1.0, 1.0], points.shape)
        level = np.linalg.solve(np.stack([*sides, signs], axis=2), np.ones((_N_DECAYS, 3, 1)))
        stiffness, height, even = level[..., 0].T
        errors = 1.0 - stiffness[:, None] * spring - height[:, None] * slider
        worst = np.argmax(np.abs(errors), axis=1)
        largest_error = np.take_along_axis(errors, worst[:, None], axis=1)[:, 0]
        is_moving = np.abs(largest_error) > np.abs(even) * (1.0 + tolerance) + tolerance
        if not is_moving.any():
            break
        swapped = _exchange(points, worst, np.sign(largest_error), np.sign(even[:, None]) * signs)
        points = np.where(is_moving[:, None], swapped, points)
    error = np.where((stiffness >= 0.0) & (height >= 0.0), np.abs(largest_error), np.inf)
    best = int(np.argmin(error))
    return DahlLaw(*map(float, (stiffness[best], height[best], decay[best], error[best])))


def _exchange(points: Ints, worst: Ints, sign: Floats, signs: Floats) -> Ints:
    """Exchange the worst point in, keeping alternating signs."""
    place = np.sum(points < worst[:, None], axis=1)
    row = np.arange(len(points))
    below, above = np.maximum(place - 1, 0), np.minimum(place, 2)
    is_left = (place > 0) & (signs[row, below] == sign)
    is_right = (place < 3) & (signs[row, above] == sign)
    swapped = points.copy()
    swapped[row, np.where(is_left, below, above)] = worst
    before = np.column_stack([worst, points[:, :2]])
    behind = np.column_stack([points[:, 1:], worst])
    beyond = np.where((place == 0)[:, None], before, behind)
    return np.where((is_left | is_right)[:, None], swapped, beyond)


SLIDERS = 12
"""With fewer, the error of the residual curvature after unloading exceeds 2 %."""


def fit_wire_sliders(table: WireTable, sliders: int = SLIDERS) -> SliderLaw:
    """Fit sliders to a wire over its whole table.

    Parameters
    ----------
    table : law of the wire
    sliders : at most

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    return _fitted(table, sliders)


@lru_cache(maxsize=16)  # tables are hashed by identity
def _fitted(table: WireTable, sliders: int) -> SliderLaw:
    return fit_sliders(table.curvature, table.moment, sliders)


@lru_cache(maxsize=4)
def make_table_card(table: WireTable) -> LossCard:
    """Compute the loss card of a wire over its table.

    Parameters
    ----------
    table : law of the wire

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    return make_loss_card(
        table.curvature, table.moment, [fit_wire_sliders(table, most) for most in SLIDER_COUNTS]
    )
