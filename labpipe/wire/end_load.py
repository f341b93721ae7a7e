"""The cantilever under an end load on first loading: the first integral, by quadrature (PHYSICS 5).

While no part of the wire unloads, the law M(kappa) is one function along it, and with the
complementary energy W*(M) the end load P normal to the clamped axis has the first integral

    W*(M) + P sin(theta) = W*(M0),   M0 the moment at the clamp,

so that with S = (W*(M0) - W*(M)) / P = sin(theta) and q = sqrt(1 - S^2) = cos(theta)

    length = 1/P int_0^M0 dM / q,   deflection = 1/P int_0^M0 S dM / q.

For plays the law is a polygon, W* is a parabola between its corners, and Gauss's rule from corner
to corner is good to 1e-8. Towards the tip of a far bent wire 1 / q grows as 1 / M: there, where the
law is still straight, the variable is u with M ~ sinh u, in which it levels out. Nothing is
marched: all deflections are solved at once.

Beyond a deflection of about 0.7 of the length the lever of the parts near the tip shrinks faster
than the load grows: their moment falls, and what they remember matters (0.3 % of the load at 0.8).
There this ends; `wire.end_load_path` goes on station by station.

`wire.first_loading` has the same integral at given clamp moments, with a string and derivatives by
a law's parameters; it finds neither wanted deflections nor a far bent, upright wire, as this does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from labpipe.law.plays import MomentLaw, corners_of, first_curvature, require_positive
from labpipe.records.arrays import Floats, Ints

_FARTHEST = 0.9  # of the length: beyond, the wire hardly moves and the tip is upright
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
_NODES, _WEIGHTS = (_NODES + 1.0) / 2.0, _WEIGHTS / 2.0
_GRADED = np.concatenate([np.geomspace(1e-3, 0.08, 12), (np.arange(7, 25) / 24.0) ** 2])
"""Panels besides the corners, as shares of the largest moment: fine where theta levels out."""
_LADDER = np.concatenate([np.geomspace(1e-6, 0.1, 14), np.geomspace(0.2, 5.0, 82)])
"""Clamp moments of first guesses, in that of a constant stiffness; steps of 4 % at the end."""
_MOST_RAISES, _MOST_NEWTON = 40, 30
_STEEPEST = 12.0  # artanh of the tip's sine: then it is upright to ten digits
_SETTLED = 1e-6  # of moment and artanh, the last step: one more changes 1e-13; Gauss's rule 1e-9
_LARGEST_STEP = 1.0
_GROWN = 1e-9  # of the length: less is rounding


@dataclass(frozen=True, slots=True, eq=False)
class Polygon:
    """A law of first loading between corners, from zero; arrays of shape (corners,).

    Parameters
    ----------
    moment : N m, from 0, increasing
    curvature : 1/m
    energy : complementary energy W*, N
    compliance : shape (corners - 1,), 1/(N m^2), d(curvature) / d(moment) between corners; the
        first of them is a thousandth of the last moment, or less
    """

    moment: Floats
    curvature: Floats
    energy: Floats
    compliance: Floats


@dataclass(frozen=True, slots=True, eq=False)
class EndLoads:
    """A cantilever at several deflections of its first loading; arrays of shape (n,).

    Parameters
    ----------
    deflection : m, of the tip
    load : N
    clamp_moment : N m
    tail : shape (n, corners - 1), m, how far from the tip the moment is that of each corner of
        `polygon` but the first; the length where it is not reached
    polygon : the law
    """

    deflection: Floats
    load: Floats
    clamp_moment: Floats
    tail: Floats
    polygon: Polygon

    def moment_at(self, row: int, from_tip: Floats) -> Floats:
        """Moment at distances from the tip (m), N m, straight between corners: a first guess."""
        moment = np.minimum(self.polygon.moment, self.clamp_moment[row])
        return np.asarray(np.interp(from_tip, np.append(0.0, self.tail[row]), moment))


@dataclass(frozen=True, slots=True, eq=False)
class _Integrals:
    """Over the wire: of 1/q up to each corner, of S/q, 1/q^3 and S/q^3."""

    length: Floats
    rise: Floats
    cubed: Floats
    cubed_rise: Floats


def polygon_of(law: MomentLaw, top: float) -> Polygon:
    """First loading of a law up to a moment, with panels fine enough for the quadrature.

    Parameters
    ----------
    law : a spring and plays
    top : N m, the last corner
    """
    widths = law.half_widths
    return _through(law, np.union1d(widths[widths < top], top * _GRADED))


def _through(law: MomentLaw, corners: Floats) -> Polygon:
    """Polygon through points of a first loading at some moments; W* is that of the polygon."""
    moment = np.append(0.0, corners)
    step = np.diff(moment)
    curvature = first_curvature(law, moment)
    energy = np.append(0.0, np.cumsum((curvature[1:] + curvature[:-1]) / 2.0 * step))
    return Polygon(moment, curvature, energy, np.diff(curvature) / step)


def end_loads(law: MomentLaw, length: float, deflections: Floats) -> EndLoads:
    """Bend a straight wire to each of many deflections, as far as no part of it unloads.

    Parameters
    ----------
    law : of the wire
    length : m
    deflections : shape (m,), m, positive and increasing

    Returns
    -------
    For the first n <= m deflections, those up to which nothing unloads, and one row more: the last
    state of which that is known, for the path to go on from.

    Notes
    -----
    A part unloads where its moment falls; only what lies beyond the law's first corner remembers
    it. Whether it does is looked at on steps of 4 % of the clamp's moment.
    """
    ladder = _ladder(law, length, min(float(deflections[-1]), _FARTHEST * length))
    last = min(ladder.deflection[_memory_limit(law, ladder, length)], deflections[-1])
    wanted = np.append(deflections[deflections <= last], last)
    return _at_deflections(ladder, law, length, wanted)


def deflection_at(law: MomentLaw, length: float, clamp_moment: float) -> float:
    """Deflection at which the clamp has a moment, m, if no part of the wire unloads on the way.

    Parameters
    ----------
    law : of the wire
    length : m
    clamp_moment : N m, positive

    Raises
    ------
    ValueError
        If a number is not finite and positive.

    Notes
    -----
    For a large moment and length the end of the wire is upright, and the deflection approaches the
    length: 1 - 2 (sqrt 2 - 1) EI / (M0 L) of it for a constant stiffness.
    """
    require_positive("length", length)
    require_positive("clamp_moment", clamp_moment)
    polygon = polygon_of(law, clamp_moment)
    return float(_at_moments(polygon, length, np.array([clamp_moment])).deflection[0])


def _ladder(law: MomentLaw, length: float, farthest: float) -> EndLoads:
    """States at rising clamp moments, the last one at or beyond a deflection: first guesses.

    On a polygon of few corners; but the first corner of the law is one, for `_memory_limit`.
    """
    base = _moment_of(law, 3.0 * farthest / length**2)
    for _ in range(_MOST_RAISES):
        rungs = base * _LADDER
        few = np.union1d(law.half_widths[:1], rungs[-1] * _GRADED)
        found = _at_moments(_through(law, few[few <= rungs[-1]]), length, rungs)
        if found.deflection[-1] >= farthest:
            break
        base = float(rungs[-1])
    return _rows(found, int(np.argmax(found.deflection >= farthest)) + 1)


def _rows(states: EndLoads, count: int) -> EndLoads:
    """The first of some states."""
    return EndLoads(
        states.deflection[:count],
        states.load[:count],
        states.clamp_moment[:count],
        states.tail[:count],
        states.polygon,
    )


def _moment_of(law: MomentLaw, curvature: float) -> float:
    """Moment of first loading at a curvature, N m."""
    corner, reached, slopes = corners_of(law)
    last = int(np.searchsorted(reached, curvature, side="right")) - 1
    return float(corner[last] + (curvature - reached[last]) / slopes[last])


def _memory_limit(law: MomentLaw, ladder: EndLoads, length: float) -> int:
    """Number of the last rung before any part that has passed the first corner unloads."""
    last = len(ladder.load) - 1
    if not len(law.half_widths):
        return last
    edge = ladder.polygon.moment[1:]
    bent = (edge >= law.half_widths[0]) & (edge < ladder.clamp_moment[:-1, None])
    falls = ((np.diff(ladder.tail, axis=0) > _GROWN * length) & bent).any(axis=1)
    return max(int(np.argmax(falls)) - 1, 0) if falls.any() else last


def _tip_gap(level: Floats) -> Floats:
    """One less the tip's sine, tanh(level), without rounding: 1e-10 where the tip is upright."""
    return 2.0 / (np.exp(2.0 * level) + 1.0)


def _integrate(polygon: Polygon, clamp: Floats, compliance: Floats, gap: Floats) -> _Integrals:
    """Quadrature for states of clamp moments `clamp`, `compliance` = 1 / P, and 1 - tip's sine."""
    rows, whole = np.arange(len(clamp)), np.arange(len(polygon.compliance))
    last = np.searchsorted(polygon.moment[1:-1], clamp, side="right")
    energy, share = _nodes_of(polygon, whole, np.diff(polygon.moment))
    fall = energy[:, None] * compliance[:, None]  # nodes first: sums over them are of whole rows
    share = share[:, None] * (whole < last[:, None])
    energy, share[:, rows, last] = _nodes_of(polygon, last, clamp - polygon.moment[last])
    fall[:, rows, last] = energy * compliance
    stretch = np.sqrt(polygon.compliance[0] / 2.0 * compliance / gap)
    reach = np.arcsinh(stretch * np.minimum(clamp, polygon.moment[1]))
    u = _NODES[:, None] * reach
    fall[:, :, 0] = gap * np.sinh(u) ** 2
    share[:, :, 0] = _WEIGHTS[:, None] * reach * np.cosh(u) / stretch
    fall += gap[:, None]  # now 1 - S
    np.minimum(fall, 1.0, out=fall)  # it is more beyond the clamp, where nothing is summed
    square = 2.0 - fall  # in place from here: new memory costs more than the sums
    square *= fall
    np.reciprocal(square, out=square)
    per_length = np.sqrt(square)
    per_length *= share
    cubed = np.multiply(per_length, square, out=square)
    # sech^2 u, which the nodes do not follow: in this panel the sine is that of the tip
    cubed[:, :, 0] = np.tanh(reach) / stretch * (gap * (2.0 - gap)) ** -1.5 / len(_NODES)
    length = np.cumsum(per_length.sum(axis=0), axis=1)
    cubed_sum = cubed.sum(axis=(0, 2))
    return _Integrals(
        length,
        length[:, -1] - np.einsum("kij,kij->i", per_length, fall),
        cubed_sum,
        cubed_sum - np.einsum("kij,kij->i", cubed, fall),
    )


def _nodes_of(polygon: Polygon, panel: Ints, width: Floats) -> tuple[Floats, Floats]:
    """W* at Gauss's nodes of some panels, begun at their lower ends, and the nodes' shares."""
    way = _NODES[:, None] * width
    energy = (polygon.compliance[panel] / 2.0 * way + polygon.curvature[panel]) * way
    return energy + polygon.energy[panel], _WEIGHTS[:, None] * width


def _at_clamp(polygon: Polygon, moment: Floats) -> tuple[Floats, Floats]:
    """Curvature and complementary energy at moments."""
    panel = np.searchsorted(polygon.moment[1:-1], moment, side="right")
    way = moment - polygon.moment[panel]
    slope, curvature = polygon.compliance[panel], polygon.curvature[panel]
    return curvature + slope * way, polygon.energy[panel] + way * (curvature + slope * way / 2.0)


def _at_moments(polygon: Polygon, length: float, clamp: Floats) -> EndLoads:
    """States of given clamp moments: Newton for the artanh of the tip's sine, nearly linear."""
    curvature, energy = _at_clamp(polygon, clamp)
    level = np.minimum(curvature * length / 2.0, 2.0)
    for _ in range(_MOST_NEWTON):
        gap = _tip_gap(level)
        sine = np.tanh(level)
        found = _integrate(polygon, clamp, sine / energy, gap)
        missing = length - sine / energy * found.length[:, -1]
        step = missing * energy / (gap * (2.0 - gap) * found.cubed)
        before = level
        level = _within(level, np.clip(step, -_LARGEST_STEP, _LARGEST_STEP))
        if np.all(np.abs(level - before) < _SETTLED * level):
            break
    return _states(polygon, clamp, level, length)


def _within(level: Floats, step: Floats) -> Floats:
    """A level after a step, positive and at most `_STEEPEST`."""
    return np.clip(level + step, level / 4.0, _STEEPEST)


def _at_deflections(ladder: EndLoads, law: MomentLaw, length: float, wanted: Floats) -> EndLoads:
    """States of given deflections: Newton for clamp moment and tip's sine, from the ladder."""
    clamp, level = _first_guess(ladder, wanted)
    polygon = polygon_of(law, float(ladder.clamp_moment[-1]))
    for _ in range(_MOST_NEWTON):
        step = _newton_step(polygon, np.exp(clamp), level, length, wanted)
        before = level
        clamp, level = clamp + step[0], _within(level, step[1])
        if np.all(np.abs([step[0], level - before]) < _SETTLED * np.minimum(level, 1.0)):
            break
    return _states(polygon, np.exp(clamp), level, length)


def _first_guess(ladder: EndLoads, wanted: Floats) -> Floats:
    """Logarithm of the clamp's moment, and `level`, at deflections between those of a ladder."""
    _, energy = _at_clamp(ladder.polygon, ladder.clamp_moment)
    rungs = np.log([ladder.deflection, ladder.clamp_moment, np.arctanh(energy / ladder.load)])
    between = CubicSpline(rungs[0], rungs[1:], axis=1)
    below = np.minimum(np.log(wanted) - rungs[0, 0], 0.0)  # under the lowest, all in proportion
    clamp, level = between(np.log(wanted) - below) + below
    return np.array([clamp, np.exp(level)])


def _newton_step(
    polygon: Polygon, clamp: Floats, level: Floats, length: float, wanted: Floats
) -> Floats:
    """Change of the logarithm of the clamp's moment, and of `level`, shape (2, n)."""
    curvature, energy = _at_clamp(polygon, clamp)
    gap = _tip_gap(level)
    c = np.tanh(level) / energy  # 1 / P
    found = _integrate(polygon, clamp, c, gap)
    per_clamp = c * curvature
    c_by_clamp, c_by_level = -per_clamp / energy * clamp, gap * (2.0 - gap) / energy
    rise_by_c = found.rise + found.cubed_rise
    length_by_clamp = c * clamp * (1.0 + per_clamp * found.cubed_rise) + c_by_clamp * found.cubed
    rise_by_clamp = c * clamp * per_clamp * found.cubed + c_by_clamp * rise_by_c
    jacobian = np.array(
        [
            [length_by_clamp, found.cubed * c_by_level],
            [rise_by_clamp, rise_by_c * c_by_level],
        ]
    )
    missing = np.array([length - c * found.length[:, -1], wanted - c * found.rise])
    step = np.linalg.solve(np.moveaxis(jacobian, 2, 0), missing.T[..., None])[..., 0].T
    return np.asarray(np.clip(step, -_LARGEST_STEP, _LARGEST_STEP))


def _states(polygon: Polygon, clamp: Floats, level: Floats, length: float) -> EndLoads:
    """States of clamp moments and levels; what is left of the length at the steepest is upright."""
    _, energy = _at_clamp(polygon, clamp)
    compliance = np.tanh(level) / energy
    found = _integrate(polygon, clamp, compliance, _tip_gap(level))
    tail = compliance[:, None] * found.length
    upright = np.where(level >= _STEEPEST, np.maximum(length - tail[:, -1], 0.0), 0.0)
    return EndLoads(
        compliance * found.rise + upright,
        1.0 / compliance,
        clamp,
        tail + upright[:, None],
        polygon,
    )
