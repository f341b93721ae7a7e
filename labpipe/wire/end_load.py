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

from labpipe.law.plays import MomentLaw, corners_of, first_curvature, require_positive
from labpipe.records.arrays import Floats, Ints

_FARTHEST = 0.9  # of the length: beyond, the wire hardly moves and the tip is upright
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
_NODES, _WEIGHTS = (_NODES + 1.0) / 2.0, _WEIGHTS / 2.0
_N_NODES = len(_NODES)
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
    clamp_moment : N m
    level : artanh of the tip's sine
    length : m
    polygon : the law
    """

    deflection: Floats
    clamp_moment: Floats
    level: Floats
    length: float
    polygon: Polygon

    @property
    def load(self) -> Floats:
        """End load, N."""
        return _at_clamp(self.polygon, self.clamp_moment)[1] / np.tanh(self.level)

    def tail(self, rows: slice = slice(None)) -> Floats:
        """How far from the tip the moment is that of each corner but the first, m.

        Parameters
        ----------
        rows : which of the deflections

        Returns
        -------
        Shape (rows, corners - 1); the length where a corner is not reached.
        """
        return _tail(self.polygon, self.clamp_moment[rows], self.level[rows], self.length)[0]

    def moment_at(self, row: int, from_tip: Floats) -> Floats:
        """Moment at distances from the tip (m), N m, straight between corners: a first guess."""
        moment = np.minimum(self.polygon.moment, self.clamp_moment[row])
        tail = self.tail(slice(row, row + 1 or None))[0]
        return np.asarray(np.interp(from_tip, np.append(0.0, tail), moment))


@dataclass(frozen=True, slots=True, eq=False)
class _Integrals:
    """Over the wire: of 1/q, S/q, 1/q^3 and S/q^3."""

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
    ladder, tail = _ladder(law, length, min(float(deflections[-1]), _FARTHEST * length))
    last = min(ladder.deflection[_memory_limit(law, ladder, tail)], deflections[-1])
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
    states, _ = _at_moments(polygon, length, np.array([clamp_moment]))
    return float(states.deflection[0])


def _ladder(law: MomentLaw, length: float, farthest: float) -> tuple[EndLoads, Floats]:
    """States at rising clamp moments, and tails, the last at or beyond a deflection: first guesses.

    On a polygon of few corners; but the first corner of the law is one, for `_memory_limit`.
    """
    base = _moment_of(law, 3.0 * farthest / length**2)
    for _ in range(_MOST_RAISES):
        rungs = base * _LADDER
        few = np.union1d(law.half_widths[:1], rungs[-1] * _GRADED)
        found, tail = _at_moments(_through(law, few[few <= rungs[-1]]), length, rungs)
        if found.deflection[-1] >= farthest:
            break
        base = float(rungs[-1])
    kept = slice(int(np.argmax(found.deflection >= farthest)) + 1)
    rows = found.deflection[kept], found.clamp_moment[kept], found.level[kept]
    return EndLoads(*rows, length, found.polygon), tail[kept]


def _moment_of(law: MomentLaw, curvature: float) -> float:
    """Moment of first loading at a curvature, N m."""
    corner, reached, slopes = corners_of(law)
    last = int(np.searchsorted(reached, curvature, side="right")) - 1
    return float(corner[last] + (curvature - reached[last]) / slopes[last])


def _memory_limit(law: MomentLaw, ladder: EndLoads, tail: Floats) -> int:
    """Number of the last rung before any part that has passed the first corner unloads."""
    last = len(tail) - 1
    if not len(law.half_widths):
        return last
    edge = ladder.polygon.moment[1:]
    bent = (edge >= law.half_widths[0]) & (edge < ladder.clamp_moment[:-1, None])
    falls = ((np.diff(tail, axis=0) > _GROWN * ladder.length) & bent).any(axis=1)
    return max(int(np.argmax(falls)) - 1, 0) if falls.any() else last


def _tip_gap(level: Floats) -> Floats:
    """One less the tip's sine, tanh(level), without rounding: 1e-10 where the tip is upright."""
    return 2.0 / (np.exp(2.0 * level) + 1.0)


def _workspace(polygon: Polygon, clamp: Floats) -> Floats:
    """Room for what is summed: taken again at every step, new memory costs more than the sums."""
    return np.empty((3, len(clamp), _N_NODES * (len(polygon.compliance) + 1)))


def _integrate(
    polygon: Polygon, clamp: Floats, compliance: Floats, gap: Floats, room: Floats
) -> _Integrals:
    """Quadrature for states of clamp moments `clamp`, `compliance` = 1 / P, and 1 - tip's sine."""
    nodes = _at_nodes(polygon, clamp, compliance, gap, room)
    fall, per_length, cubed = nodes.fall, nodes.per_length, nodes.square  # in place from here
    length = per_length @ nodes.weight
    cubed *= per_length
    # sech^2 u, which the nodes do not follow: in this panel the sine is that of the tip
    cubed[:, :_N_NODES] = (nodes.first_cubed / _N_NODES)[:, None]
    cubed_sum = cubed @ nodes.weight
    per_length *= fall
    cubed *= fall
    return _Integrals(
        length,
        length - per_length @ nodes.weight,
        cubed_sum,
        cubed_sum - cubed @ nodes.weight,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Nodes:
    """The integrand at Gauss's nodes of the first panel, of the whole ones, and of the clamp's.

    Parameters
    ----------
    fall : shape (rows, nodes), 1 - S; 1 beyond the clamp
    square : 1 / q^2
    per_length : 1 / q, in the first panel and the clamp's times what a node counts for, N m;
        zero beyond the clamp
    weight : shape (nodes,), N m, what the other nodes count for; 1 in those two panels
    first_cubed : shape (rows,), integral of 1 / q^3 over the first panel
    last : shape (rows,), panel in which the clamp is
    """

    fall: Floats
    square: Floats
    per_length: Floats
    weight: Floats
    first_cubed: Floats
    last: Ints


def _at_nodes(
    polygon: Polygon, clamp: Floats, compliance: Floats, gap: Floats, room: Floats
) -> _Nodes:
    """Work out what is summed over the nodes."""
    fall, square, per_length = room
    last = np.searchsorted(polygon.moment[1:-1], clamp, side="right")
    width = np.diff(polygon.moment)[1:]
    energy, share = _nodes_of(polygon, np.arange(1, len(width) + 1), width)
    np.matmul(np.stack([compliance, gap], axis=1), _with_ends(energy, 0.0), out=fall)
    in_last, last_share = _nodes_of(polygon, last, clamp - polygon.moment[last])
    stretch = np.sqrt(polygon.compliance[0] / 2.0 * compliance / gap)
    reach = np.arcsinh(stretch * np.minimum(clamp, polygon.moment[1]))
    u = reach[:, None] * _NODES
    fall[:, :_N_NODES] = gap[:, None] * np.cosh(u) ** 2
    fall[:, -_N_NODES:] = in_last.T * compliance[:, None] + gap[:, None]
    np.minimum(fall, 1.0, out=fall)
    np.subtract(2.0, fall, out=square)
    square *= fall
    np.reciprocal(square, out=square)
    np.sqrt(square, out=per_length)
    per_length[:, :_N_NODES] *= _WEIGHTS * reach[:, None] * np.cosh(u) / stretch[:, None]
    per_length[:, -_N_NODES:] *= last_share.T * (last > 0)[:, None]
    _panels_of(per_length).swapaxes(1, 2)[np.arange(1, len(width) + 1) >= last[:, None]] = 0.0
    weight = _with_ends(share, 1.0)[0]
    first_cubed = np.tanh(reach) / stretch * (gap * (2.0 - gap)) ** -1.5
    return _Nodes(fall, square, per_length, weight, first_cubed, last)


def _with_ends(whole: Floats, value: float) -> Floats:
    """Values at the nodes of the whole panels, with one value in the two others; and ones."""
    ends = np.ones((2, whole.size + 2 * _N_NODES))
    ends[0, :_N_NODES] = ends[0, -_N_NODES:] = value
    ends[0, _N_NODES:-_N_NODES] = whole.ravel()
    return ends


def _panels_of(values: Floats) -> Floats:
    """The whole panels of values at the nodes, shape (rows, nodes of a panel, panels)."""
    whole: Floats = values[:, _N_NODES:-_N_NODES]
    return whole.reshape(len(values), _N_NODES, -1)


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


def _at_moments(polygon: Polygon, length: float, clamp: Floats) -> tuple[EndLoads, Floats]:
    """States of given clamp moments and their tails: Newton for `level`, nearly linear."""
    _, energy = _at_clamp(polygon, clamp)
    level = np.minimum(energy / clamp * length, _STEEPEST - _LARGEST_STEP)
    room = _workspace(polygon, clamp)
    for _ in range(_MOST_NEWTON):
        gap = _tip_gap(level)
        sine = np.tanh(level)
        found = _integrate(polygon, clamp, sine / energy, gap, room)
        missing = length - sine / energy * found.length
        step = missing * energy / (gap * (2.0 - gap) * found.cubed)
        before = level
        level = _within(level, np.clip(step, -_LARGEST_STEP, _LARGEST_STEP))
        if np.all(np.abs(level - before) < _SETTLED * level):
            break
    tail, deflection = _tail(polygon, clamp, level, length)
    return EndLoads(deflection, clamp, level, length, polygon), tail


def _within(level: Floats, step: Floats) -> Floats:
    """A level after a step, positive and at most `_STEEPEST`."""
    return np.clip(level + step, level / 4.0, _STEEPEST)


def _at_deflections(ladder: EndLoads, law: MomentLaw, length: float, wanted: Floats) -> EndLoads:
    """States of given deflections: Newton for clamp moment and tip's sine, from the ladder."""
    clamp, level = _first_guess(ladder, wanted)
    polygon = polygon_of(law, float(ladder.clamp_moment[-1]))
    room = _workspace(polygon, clamp)
    for _ in range(_MOST_NEWTON):
        step = _newton_step(polygon, (np.exp(clamp), level), length, wanted, room)
        before = level
        clamp, level = clamp + step[0], _within(level, step[1])
        if np.all(np.abs([step[0], level - before]) < _SETTLED * np.minimum(level, 1.0)):
            break
    return EndLoads(wanted, np.exp(clamp), level, length, polygon)


def _first_guess(ladder: EndLoads, wanted: Floats) -> tuple[Floats, Floats]:
    """Logarithm of the clamp's moment, and `level`, at deflections between those of a ladder."""
    at, rungs = np.log(wanted), np.log(ladder.deflection)
    below = np.minimum(at - rungs[0], 0.0)  # under the lowest, all in proportion
    clamp, level = (
        np.interp(at, rungs, np.log(known)) + below for known in (ladder.clamp_moment, ladder.level)
    )
    return clamp, np.exp(level)


def _newton_step(
    polygon: Polygon, state: tuple[Floats, Floats], length: float, wanted: Floats, room: Floats
) -> Floats:
    """Change of the logarithm of the clamp's moment, and of `level`, shape (2, n)."""
    clamp, level = state
    curvature, energy = _at_clamp(polygon, clamp)
    gap = _tip_gap(level)
    c = np.tanh(level) / energy  # 1 / P
    found = _integrate(polygon, clamp, c, gap, room)
    per_clamp = c * curvature
    c_by_clamp, c_by_level = -per_clamp / energy * clamp, gap * (2.0 - gap) / energy
    rise_by_c = found.rise + found.cubed_rise
    length_by_clamp = c * clamp * (1.0 + per_clamp * found.cubed_rise) + c_by_clamp * found.cubed
    rise_by_clamp = c * clamp * per_clamp * found.cubed + c_by_clamp * rise_by_c
    length_by_level, rise_by_level = found.cubed * c_by_level, rise_by_c * c_by_level
    no_length, no_rise = length - c * found.length, wanted - c * found.rise
    step = np.array(
        [
            rise_by_level * no_length - length_by_level * no_rise,
            length_by_clamp * no_rise - rise_by_clamp * no_length,
        ]
    ) / (length_by_clamp * rise_by_level - length_by_level * rise_by_clamp)
    return np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)


def _tail(polygon: Polygon, clamp: Floats, level: Floats, length: float) -> tuple[Floats, Floats]:
    """How far from the tip the moment is that of each corner but the first, and the deflection.

    What is left of the length at the steepest is upright.
    """
    compliance = np.tanh(level) / _at_clamp(polygon, clamp)[1]
    room = _workspace(polygon, clamp)
    nodes = _at_nodes(polygon, clamp, compliance, _tip_gap(level), room)
    per_length = nodes.per_length * nodes.weight
    first, end = per_length[:, :_N_NODES].sum(axis=1), per_length[:, -_N_NODES:].sum(axis=1)
    panels = np.column_stack([first, _panels_of(per_length).sum(axis=1)])
    panels[np.arange(len(clamp)), nodes.last] += end
    tail = compliance[:, None] * np.cumsum(panels, axis=1)
    rise = compliance * np.sum(per_length * (1.0 - nodes.fall), axis=1)
    upright = np.where(level >= _STEEPEST, np.maximum(length - tail[:, -1], 0.0), 0.0)
    return tail + upright[:, None], rise + upright
