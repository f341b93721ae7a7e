"""What a law loses in each form that a simulation program can hold: its loss card.

All errors are the largest distance from the law's moment on first loading over a range of
curvatures, as a share of that moment, each form at its best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.law.slider_directions import in_directions, turned
from labpipe.law.sliders import SliderLaw, within_range
from labpipe.records.arrays import Floats, Ints

COUNTS = (4, 6, 8, 12)
"""Sliders of which a card tells the loss."""
DIRECTIONS = 4
"""Of scalar sliders, of which a card tells the loss."""

_N_DECAYS = 60


@dataclass(frozen=True, slots=True)
class DahlLaw:
    """A spring and one slider that slides little by little, after Dahl (1968).

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
    """What a law loses in each form.

    Parameters
    ----------
    first, last : 1/m, the range
    stiffness : N m^2, the best constant one
    constant : error of the constant stiffness
    dahl : the best Dahl law
    sliders : number of sliders and error of each fit; fewer sliders than asked for where the law
        has fewer corners
    directions : number of directions of scalar sliders in three dimensions, and the largest
        difference of the moment along the curvature from that of vector sliders, in the worst
        direction: of a node alone, and of nodes whose directions are turned (`turned`)
    """

    first: float
    last: float
    stiffness: float
    constant: float
    dahl: DahlLaw
    sliders: tuple[tuple[int, float], ...]
    directions: tuple[tuple[int, float], ...]


def card_of(curvature: Floats, moment: Floats, laws: Sequence[SliderLaw]) -> LossCard:
    """Work out what a law loses, from the sliders that were fitted to it.

    Parameters
    ----------
    curvature, moment : as for `fit_sliders`
    laws : fits of it over one range, at least one
    """
    x, y, start = within_range(curvature, moment, laws[0].first, laws[0].last)
    secant = y[1:] / x[1:]
    low, high = float(secant.min()), float(secant.max())
    most = laws[int(np.argmin([law.error for law in laws]))]
    alone = in_directions(most, DIRECTIONS)
    return LossCard(
        first=start,
        last=float(x[-1]),
        stiffness=2.0 * low * high / (low + high),
        constant=(high - low) / (high + low),
        dahl=fit_dahl(*_fewer(x[1:], y[1:])),
        sliders=tuple((len(law.stiffnesses), law.error) for law in laws),
        directions=tuple((each.directions, each.error) for each in (alone, turned(most, alone))),
    )


def _fewer(curvature: Floats, moment: Floats) -> tuple[Floats, Floats]:
    """Some points of a law, its ends included: enough for a smooth curve of three numbers."""
    max_rows = 80
    if len(curvature) <= max_rows:
        return curvature, moment
    rows = np.round(np.linspace(0.0, len(curvature) - 1.0, max_rows)).astype(np.int64)
    return curvature[rows], moment[rows]


@dataclass(frozen=True, slots=True)
class TurnLoss:
    """What is off on the way back from a bend, as the largest share of the moment at the turn.

    Parameters
    ----------
    curve : of a law without memory, which goes back the way it came
    curve_at : 1/m, the turn after which that is so
    isotropic : of one that unloads with its first slope and hardens alike on both sides
    isotropic_at : 1/m
    """

    curve: float
    curve_at: float
    isotropic: float
    isotropic_at: float


def turn_loss(curvature: Floats, moment: Floats) -> TurnLoss:
    """Work out what is off where a wire is bent and straightened again.

    Parameters
    ----------
    curvature : shape (n,), 1/m, from 0, increasing, n >= 2
    moment : shape (n,), N m, from 0, positive

    Notes
    -----
    Turned at curvatures up to half of the range, so that a law that hardens stays inside of it, and
    gone back to straight; the wire follows Masing's rule, M_0 - 2 M((kappa_0 - kappa) / 2). With
    isotropic hardening M = M_0 - S (kappa_0 - kappa), S the first slope, down to -M_0; from there
    on the wire yields the other way, by as much more as the first loading is plastic:
    M = -M(2 kappa_0 - kappa - 2 M_0 / S).
    """
    n_turns = 40
    n_points = 41
    slope = moment[1] / curvature[1]
    turn = np.geomspace(min(curvature[1], 0.25 * curvature[-1]), 0.5 * curvature[-1], n_turns)
    turn = turn[:, None]
    at = turn * np.linspace(0.0, 1.0, n_points)
    top = np.interp(turn, curvature, moment)
    wanted = top - 2.0 * np.interp(0.5 * (turn - at), curvature, moment)
    straight = top - slope * (turn - at)
    yields = -np.interp(2.0 * turn - at - 2.0 * top / slope, curvature, moment)
    isotropic = np.where(straight >= -top, straight, yields)
    found: list[float] = []
    for carried in (np.interp(at, curvature, moment), isotropic):
        off = np.max(np.abs((carried - wanted) / top), axis=1)
        worst = int(np.argmax(off))
        found += [float(off[worst]), float(turn[worst, 0])]
    return TurnLoss(*found)


def fit_dahl(curvature: Floats, moment: Floats) -> DahlLaw:
    """Fit one exponential slider and a spring, with the smallest largest error.

    Parameters
    ----------
    curvature : shape (n,), 1/m, positive and increasing
    moment : shape (n,), N m, positive

    Notes
    -----
    For each of many decays the spring and the slider of the least largest error, by exchange of the
    three points at which it is the same with changing sign (Stiefel, Numerische Mathematik 1 (1959)
    1-28): the ratio of the two only falls, so that there is one such best. Springs and sliders that
    push are left out.
    """
    if len(curvature) < 3:  # two points have no third at which the error is the same
        middle = 0.5 * (curvature[0] + curvature[-1])
        moment = np.insert(moment, 1, np.interp(middle, curvature, moment))
        curvature = np.insert(curvature, 1, middle)
    coarse = _best_dahl(curvature, moment, 0.3 * curvature[0], 3.0 * curvature[-1])
    near = (10.0 * curvature[-1] / curvature[0]) ** (2.0 / _N_DECAYS)
    return _best_dahl(curvature, moment, coarse.decay / near, coarse.decay * near)


def _best_dahl(curvature: Floats, moment: Floats, least: float, largest: float) -> DahlLaw:
    max_exchanges = 40
    convergence_tolerance = 1e-9  # of the error, absolute and relative
    decay = np.geomspace(least, largest, _N_DECAYS)
    spring = np.broadcast_to(curvature / moment, (_N_DECAYS, len(curvature)))
    slider = -np.expm1(-curvature / decay[:, None]) / moment
    points = np.tile([0, len(curvature) // 2, len(curvature) - 1], (_N_DECAYS, 1))
    for _ in range(max_exchanges):
        sides = [np.take_along_axis(each, points, axis=1) for each in (spring, slider)]
        signs = np.broadcast_to([1.0, -1.0, 1.0], points.shape)
        level = np.linalg.solve(np.stack([*sides, signs], axis=2), np.ones((_N_DECAYS, 3, 1)))
        stiffness, height, even = level[..., 0].T
        off = 1.0 - stiffness[:, None] * spring - height[:, None] * slider
        worst = np.argmax(np.abs(off), axis=1)
        most = np.take_along_axis(off, worst[:, None], axis=1)[:, 0]
        moves = np.abs(most) > np.abs(even) * (1.0 + convergence_tolerance) + convergence_tolerance
        if not moves.any():
            break
        swapped = _exchanged(points, worst, np.sign(most), np.sign(even[:, None]) * signs)
        points = np.where(moves[:, None], swapped, points)
    error = np.where((stiffness >= 0.0) & (height >= 0.0), np.abs(most), np.inf)
    at = int(np.argmin(error))
    return DahlLaw(*map(float, (stiffness[at], height[at], decay[at], error[at])))


def _exchanged(points: Ints, worst: Ints, sign: Floats, signs: Floats) -> Ints:
    """Points with the worst one among them, and signs that still change from one to the next."""
    place = np.sum(points < worst[:, None], axis=1)
    row = np.arange(len(points))
    left, right = np.maximum(place - 1, 0), np.minimum(place, 2)
    is_left = (place > 0) & (signs[row, left] == sign)
    is_right = (place < 3) & (signs[row, right] == sign)
    swapped = points.copy()
    swapped[row, np.where(is_left, left, right)] = worst
    before = np.column_stack([worst, points[:, :2]])
    behind = np.column_stack([points[:, 1:], worst])
    beyond = np.where((place == 0)[:, None], before, behind)
    return np.where((is_left | is_right)[:, None], swapped, beyond)
