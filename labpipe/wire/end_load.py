"""The cantilever under an end load on first loading: the first integral, by quadrature (PHYSICS 5).

While no part of the wire unloads, the law M(kappa) is one function along it, and with the
complementary energy W*(M) the end load P normal to the clamped axis has the first integral

    W*(M) + P sin(theta) = W*(M0),   M0 the moment at the clamp,

so that with S = (W*(M0) - W*(M)) / P = sin(theta) and q = sqrt(1 - S^2) = cos(theta)

    length = 1/P int_0^M0 dM / q,   deflection = 1/P int_0^M0 S dM / q.

For plays the law is a polygon, W* is a parabola between its corners, and Gauss's rule from corner
to corner is good to 1e-8. Nothing is marched: all deflections are solved at once.

Beyond a deflection of about 0.7 of the length the lever of the parts near the tip shrinks faster
than the load grows: their moment falls, and what they remember matters (0.3 % of the load at 0.8).
There this ends; `wire.cantilever` goes on station by station.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from labpipe.records.arrays import Floats
from labpipe.wire.laws import MomentLaw

_FARTHEST = 0.9  # of the length: beyond, the wire hardly moves and the tip is upright
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
_NODES, _WEIGHTS = (_NODES + 1.0) / 2.0, _WEIGHTS / 2.0
_GRADED = (np.arange(1, 25) / 24.0) ** 2  # panels besides the corners, fine where theta levels out
_LADDER = np.concatenate([np.geomspace(1e-6, 1e-2, 9), np.linspace(0.03, 1.0, 40)])
_RAISE, _MOST_RAISES, _MOST_NEWTON = 1.2, 40, 30
_STEEPEST = 12.0  # artanh of the tip's sine: beyond, the tip is upright to ten digits
_SETTLED = 1e-6  # of moment and artanh: after such a step of Newton they are good to 1e-12
_LARGEST_STEP = 1.0
_UPRIGHT = 1e-20  # of the squared cosine, which rounding could make negative
_GROWN = 1e-9  # of the length: less is rounding


@dataclass(frozen=True, slots=True, eq=False)
class Polygon:
    """A law of first loading between corners, from zero; arrays of shape (corners,).

    Parameters
    ----------
    moment : N m, from 0, increasing
    curvature : 1/m
    energy : complementary energy W*, N
    compliance : shape (corners - 1,), 1/(N m^2), d(curvature) / d(moment) between corners
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
    """Over the wire: of 1/q up to each corner, of S/q, 1/q^3 and S/q^3; and the clamp's values."""

    length: Floats
    rise: Floats
    cubed: Floats
    cubed_rise: Floats
    curvature: Floats
    energy: Floats


def polygon_of(law: MomentLaw, top: float) -> Polygon:
    """First loading of a law up to a moment, with panels fine enough for the quadrature.

    Parameters
    ----------
    law : a spring and plays
    top : N m, the last corner
    """
    widths = law.half_widths
    moment = np.union1d(np.append(0.0, widths[widths < top]), top * _GRADED)
    giving = np.append(0.0, np.cumsum(law.compliances))
    slope = 1.0 / law.stiffness + giving[np.searchsorted(widths, moment[:-1], side="right")]
    step = np.diff(moment)
    curvature = np.append(0.0, np.cumsum(slope * step))
    energy = np.append(0.0, np.cumsum((curvature[:-1] + slope * step / 2.0) * step))
    return Polygon(moment, curvature, energy, slope)


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
    it. Whether it does is looked at on 40 even steps of the clamp's moment.
    """
    ladder = _ladder(law, length, min(float(deflections[-1]), _FARTHEST * length))
    last = min(ladder.deflection[_memory_limit(law, ladder, length)], deflections[-1])
    wanted = np.append(deflections[deflections <= last], last)
    return _at_deflections(ladder, length, wanted)


def deflection_at(law: MomentLaw, length: float, clamp_moment: float) -> float:
    """Deflection at which the clamp has a moment, m, if no part of the wire unloads on the way.

    Parameters
    ----------
    law : of the wire
    length : m
    clamp_moment : N m, positive
    """
    polygon = polygon_of(law, clamp_moment)
    return float(_at_moments(polygon, length, np.array([clamp_moment])).deflection[0])


def _ladder(law: MomentLaw, length: float, farthest: float) -> EndLoads:
    """States at rising clamp moments, the last one at or beyond a deflection."""
    top = _moment_of(law, 3.0 * farthest / length**2)
    for _ in range(_MOST_RAISES):
        if deflection_at(law, length, top) >= farthest:
            break
        top *= _RAISE
    return _at_moments(polygon_of(law, top), length, top * _LADDER)


def _moment_of(law: MomentLaw, curvature: float) -> float:
    """Moment of first loading at a curvature, N m."""
    corners = np.append(0.0, law.half_widths)
    slopes = 1.0 / law.stiffness + np.append(0.0, np.cumsum(law.compliances))
    reached = np.append(0.0, np.cumsum(slopes[:-1] * np.diff(corners)))
    last = int(np.searchsorted(reached, curvature, side="right")) - 1
    return float(corners[last] + (curvature - reached[last]) / slopes[last])


def _memory_limit(law: MomentLaw, ladder: EndLoads, length: float) -> int:
    """Number of the last rung before any part that has passed the first corner unloads."""
    if not len(law.half_widths):
        return len(_LADDER) - 1
    edge = ladder.polygon.moment[1:]
    bent = (edge >= law.half_widths[0]) & (edge < ladder.clamp_moment[:-1, None])
    falls = ((np.diff(ladder.tail, axis=0) > _GROWN * length) & bent).any(axis=1)
    return max(int(np.argmax(falls)) - 1, 0) if falls.any() else len(_LADDER) - 1


def _integrate(polygon: Polygon, clamp: Floats, compliance: Floats) -> _Integrals:
    """Quadrature for states of clamp moments `clamp` and `compliance` = 1 / P, shape (n,) both."""
    width = np.clip(clamp[:, None] - polygon.moment[:-1], 0.0, np.diff(polygon.moment))
    way = _NODES[:, None, None] * width  # nodes first: sums over them are of whole rows
    inside = (polygon.compliance / 2.0 * way + polygon.curvature[:-1]) * way + polygon.energy[:-1]
    own_curvature, own_energy = _at_clamp(polygon, clamp)
    sine = (own_energy[:, None] - inside) * compliance[:, None]
    square = 1.0 / np.maximum((1.0 - sine) * (1.0 + sine), _UPRIGHT)
    per_length = _WEIGHTS[:, None, None] * width * np.sqrt(square)
    cubed = per_length * square
    return _Integrals(
        np.cumsum(per_length.sum(axis=0), axis=1),
        np.einsum("kij,kij->i", per_length, sine),
        cubed.sum(axis=(0, 2)),
        np.einsum("kij,kij->i", cubed, sine),
        own_curvature,
        own_energy,
    )


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
        sine = np.tanh(level)
        found = _integrate(polygon, clamp, sine / energy)
        gap = length - sine / energy * found.length[:, -1]
        step = gap * energy / ((1.0 - sine**2) * found.cubed)
        step = np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
        level = np.clip(level + step, level / 4.0, _STEEPEST)
        if np.all(np.abs(step) < _SETTLED * level):
            break
    return _states(polygon, clamp, np.tanh(level) / energy)


def _at_deflections(ladder: EndLoads, length: float, wanted: Floats) -> EndLoads:
    """States of given deflections: Newton for clamp moment and tip's sine, from the ladder."""
    polygon = ladder.polygon
    _, energy = _at_clamp(polygon, ladder.clamp_moment)
    rungs = np.log([ladder.deflection, ladder.clamp_moment, np.arctanh(energy / ladder.load)])
    between = CubicSpline(rungs[0], rungs[1:], axis=1)
    below = np.minimum(np.log(wanted) - rungs[0, 0], 0.0)  # under the lowest, all in proportion
    clamp, level = between(np.log(wanted) - below) + below
    level = np.exp(level)
    for _ in range(_MOST_NEWTON):
        step = _newton_step(polygon, np.exp(clamp), level, length, wanted)
        clamp, level = clamp + step[0], np.clip(level + step[1], level / 4.0, _STEEPEST)
        if np.all(np.abs(step) < _SETTLED * np.minimum(level, 1.0)):
            break
    _, energy = _at_clamp(polygon, np.exp(clamp))
    return _states(polygon, np.exp(clamp), np.tanh(level) / energy)


def _newton_step(
    polygon: Polygon, clamp: Floats, level: Floats, length: float, wanted: Floats
) -> Floats:
    """Change of the logarithm of the clamp's moment, and of `level`, shape (2, n)."""
    sine = np.tanh(level)
    _, energy = _at_clamp(polygon, clamp)
    c = sine / energy  # 1 / P
    found = _integrate(polygon, clamp, c)
    per_clamp = c * found.curvature
    c_by_clamp, c_by_level = -per_clamp / energy * clamp, (1.0 - sine**2) / energy
    rise_by_c = found.rise + found.cubed_rise
    length_by_clamp = c * clamp * (1.0 + per_clamp * found.cubed_rise) + c_by_clamp * found.cubed
    rise_by_clamp = c * clamp * per_clamp * found.cubed + c_by_clamp * rise_by_c
    jacobian = np.array(
        [
            [length_by_clamp, found.cubed * c_by_level],
            [rise_by_clamp, rise_by_c * c_by_level],
        ]
    )
    gap = np.array([length - c * found.length[:, -1], wanted - c * found.rise])
    step = np.linalg.solve(np.moveaxis(jacobian, 2, 0), gap.T[..., None])[..., 0].T
    return np.asarray(np.clip(step, -_LARGEST_STEP, _LARGEST_STEP))


def _states(polygon: Polygon, clamp: Floats, compliance: Floats) -> EndLoads:
    found = _integrate(polygon, clamp, compliance)
    return EndLoads(
        compliance * found.rise,
        1.0 / compliance,
        clamp,
        compliance[:, None] * found.length,
        polygon,
    )
