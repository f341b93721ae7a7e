"""The cantilever under an end load on first loading, by quadrature of a first integral (PHYSICS 5).

While no part of the wire unloads, the law M(kappa) is one function along it, and with the
complementary energy W*(M) the end load P normal to the clamped axis has the first integral

    W*(M) + P sin(theta) = W*(M0),   M0 the moment at the clamp,

so that with S = (W*(M0) - W*(M)) / P = sin(theta) and q = sqrt(1 - S^2) = cos(theta)

    length = 1/P int_0^M0 dM / q,   deflection = 1/P int_0^M0 S dM / q.

For plays the law is a polygon, W* is a parabola between its corners, and Gauss's rule from corner
to corner is accurate to 1e-8. Towards the tip of a far bent wire 1 / q grows as 1 / M: there, where
the law is still linear, the variable is u with M ~ sinh u, in which it levels out. All deflections
are solved at once.

Beyond a deflection of about 0.7 of the length the lever of the parts near the tip shrinks faster
than the load grows: their moment falls, and their history matters (0.3 % of the load at 0.8).
There this ends; `wire.end_load_path` continues station by station.

`wire.first_loading` has the same integral at given clamp moments, with a string and derivatives by
a law's parameters, but neither given deflections nor a far bent, upright wire.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.law.plays import MomentLaw, corners_of, first_curvature, require_positive
from labpipe.records.arrays import Floats, Ints

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
_NODES, _WEIGHTS = (_NODES + 1.0) / 2.0, _WEIGHTS / 2.0
_N_NODES = len(_NODES)
_GRADED = np.concatenate([np.geomspace(1e-3, 0.08, 12), (np.arange(7, 25) / 24.0) ** 2])
"""Panels besides the corners, as shares of the largest moment: fine where theta levels out."""
_LADDER = np.concatenate([np.geomspace(1e-6, 0.1, 14), np.geomspace(0.2, 5.0, 82)])
"""Clamp moments of first guesses, of that for a constant stiffness; steps of 4 % at the end."""
_NEWTON_STEPS = 30
_MAX_LEVEL = 12.0
"""Artanh of the tip's sine, for which the tip is upright to ten digits."""
_LAST_LEVEL_STEP = 1e-6
"""Of moment and level; one more step changes 1e-13, and Gauss's rule is accurate to 1e-9."""
_MAX_LEVEL_STEP = 1.0


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
        """Return the end load, N."""
        return _at_clamp(self.polygon, self.clamp_moment)[1] / np.tanh(self.level)

    def tail(self, rows: slice = slice(None)) -> Floats:
        """Return the distance from the tip to the moment of each corner but the first, m.

        Parameters
        ----------
        rows : which of the deflections

        Returns
        -------
        Shape (rows, corners - 1); the length where a corner is not reached.
        """
        return _tail(self.polygon, self.clamp_moment[rows], self.level[rows], self.length)[0]

    def moment_at(self, row: int, from_tip: Floats) -> Floats:
        """Return moments at distances from the tip (m), N m, linear between corners."""
        moment = np.minimum(self.polygon.moment, self.clamp_moment[row])
        tail = self.tail(slice(row, row + 1 or None))[0]
        return np.asarray(np.interp(from_tip, np.append(0.0, tail), moment))


@dataclass(frozen=True, slots=True, eq=False)
class _Integrals:
    """Integrals over the wire of 1/q, S/q, 1/q^3 and S/q^3."""

    length: Floats
    rise: Floats
    cubed: Floats
    cubed_rise: Floats


def polygon_of(law: MomentLaw, top: float) -> Polygon:
    """Return first loading up to a moment, with panels fine enough for the quadrature.

    Parameters
    ----------
    law : a spring and plays
    top : N m, the last corner
    """
    widths = law.half_widths
    return _polygon(law, np.union1d(widths[widths < top], top * _GRADED))


def _polygon(law: MomentLaw, corners: Floats) -> Polygon:
    """Return the polygon of a first loading through some moments, and its W*."""
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
    The first n <= m deflections, up to which nothing unloads, and one row more: the last such
    state, from which the path continues.

    Notes
    -----
    A part unloads where its moment falls, which matters only beyond the law's first corner. This is
    checked in steps of 4 % of the clamp's moment.
    """
    max_deflection_share = 0.9  # of the length: beyond, the tip is upright and hardly moves
    ladder, tail = _ladder(law, length, min(float(deflections[-1]), max_deflection_share * length))
    last = min(ladder.deflection[_last_loading_rung(law, ladder, tail)], deflections[-1])
    wanted = np.append(deflections[deflections <= last], last)
    return _at_deflections(ladder, law, length, wanted)


def deflection_at(law: MomentLaw, length: float, clamp_moment: float) -> float:
    """Return the deflection for a clamp moment, m, if no part of the wire unloads on the way.

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
    """Return states at rising clamp moments and their tails, up to a deflection: first guesses.

    The polygon has few corners, with the first of the law for `_last_loading_rung`.
    """
    max_raises = 40
    base = _first_moment(law, 3.0 * farthest / length**2)
    for _ in range(max_raises):
        rungs = base * _LADDER
        corners = np.union1d(law.half_widths[:1], rungs[-1] * _GRADED)
        states, tail = _at_moments(_polygon(law, corners[corners <= rungs[-1]]), length, rungs)
        if states.deflection[-1] >= farthest:
            break
        base = float(rungs[-1])
    used = slice(int(np.argmax(states.deflection >= farthest)) + 1)
    rows = states.deflection[used], states.clamp_moment[used], states.level[used]
    return EndLoads(*rows, length, states.polygon), tail[used]


def _first_moment(law: MomentLaw, curvature: float) -> float:
    """Return the moment of first loading at a curvature, N m."""
    corner, reached, slopes = corners_of(law)
    last = int(np.searchsorted(reached, curvature, side="right")) - 1
    return float(corner[last] + (curvature - reached[last]) / slopes[last])


def _last_loading_rung(law: MomentLaw, ladder: EndLoads, tail: Floats) -> int:
    """Return the last rung before any part beyond the first corner unloads."""
    rounding_share = 1e-9  # of the length
    last = len(tail) - 1
    if not len(law.half_widths):
        return last
    edge = ladder.polygon.moment[1:]
    is_bent = (edge >= law.half_widths[0]) & (edge < ladder.clamp_moment[:-1, None])
    falls = ((np.diff(tail, axis=0) > rounding_share * ladder.length) & is_bent).any(axis=1)
    return max(int(np.argmax(falls)) - 1, 0) if falls.any() else last


def _tip_gap(level: Floats) -> Floats:
    """Return 1 - tanh(level), with the tip's sine tanh(level), without cancellation."""
    return 2.0 / (np.exp(2.0 * level) + 1.0)


def _workspace(polygon: Polygon, clamp: Floats) -> Floats:
    """Allocate the summands once: allocating at every step costs more than the sums."""
    return np.empty((3, len(clamp), _N_NODES * (len(polygon.compliance) + 1)))


def _integrate(
    polygon: Polygon, clamp: Floats, compliance: Floats, gap: Floats, room: Floats
) -> _Integrals:
    """Integrate for clamp moments `clamp`, `compliance` = 1 / P, `gap` = 1 - tip's sine."""
    nodes = _at_nodes(polygon, clamp, compliance, gap, room)
    fall, per_length, cubed = nodes.fall, nodes.per_length, nodes.square  # in place from here
    length = per_length @ nodes.weight
    cubed *= per_length
    # sech^2 u is integrated in closed form: in this panel the sine is that of the tip
    cubed[:, :_N_NODES] = (nodes.first_cubed / _N_NODES)[:, None]
    cubed_sum = cubed @ nodes.weight
    per_length *= fall
    cubed *= fall
    return _Integrals(
        length, length - per_length @ nodes.weight, cubed_sum, cubed_sum - cubed @ nodes.weight
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Nodes:
    """The integrand at Gauss's nodes of the first panel, of the whole ones, and of the clamp's.

    Parameters
    ----------
    fall : shape (rows, nodes), 1 - S; 1 beyond the clamp
    square : 1 / q^2
    per_length : 1 / q, in the first panel and the clamp's times the weight of the node, N m; zero
        beyond the clamp
    weight : shape (nodes,), N m, of the other nodes; 1 in those two panels
    first_cubed : shape (rows,), integral of 1 / q^3 over the first panel
    last : shape (rows,), panel of the clamp
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
    """Compute the summands at the nodes."""
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


def _with_ends(inner: Floats, value: float) -> Floats:
    """Return values at the nodes of the whole panels, one value in the two others; and ones."""
    ends = np.ones((2, inner.size + 2 * _N_NODES))
    ends[0, :_N_NODES] = ends[0, -_N_NODES:] = value
    ends[0, _N_NODES:-_N_NODES] = inner.ravel()
    return ends


def _panels_of(values: Floats) -> Floats:
    """Return the whole panels of values at the nodes, shape (rows, nodes of a panel, panels)."""
    inner: Floats = values[:, _N_NODES:-_N_NODES]
    return inner.reshape(len(values), _N_NODES, -1)


def _nodes_of(polygon: Polygon, panel: Ints, width: Floats) -> tuple[Floats, Floats]:
    """Return W* at Gauss's nodes of some panels, from their lower ends, and the nodes' weights."""
    distance = _NODES[:, None] * width
    energy = (polygon.compliance[panel] / 2.0 * distance + polygon.curvature[panel]) * distance
    return energy + polygon.energy[panel], _WEIGHTS[:, None] * width


def _at_clamp(polygon: Polygon, moment: Floats) -> tuple[Floats, Floats]:
    """Return curvature and complementary energy at moments."""
    panel = np.searchsorted(polygon.moment[1:-1], moment, side="right")
    change = moment - polygon.moment[panel]
    slope, curvature = polygon.compliance[panel], polygon.curvature[panel]
    return curvature + slope * change, polygon.energy[panel] + change * (
        curvature + slope * change / 2.0
    )


def _at_moments(polygon: Polygon, length: float, clamp: Floats) -> tuple[EndLoads, Floats]:
    """Solve for `level` at given clamp moments; return the states and their tails."""
    _, energy = _at_clamp(polygon, clamp)
    level = np.minimum(energy / clamp * length, _MAX_LEVEL - _MAX_LEVEL_STEP)
    room = _workspace(polygon, clamp)
    for _ in range(_NEWTON_STEPS):
        gap = _tip_gap(level)
        sine = np.tanh(level)
        sums = _integrate(polygon, clamp, sine / energy, gap, room)
        missing = length - sine / energy * sums.length
        step = missing * energy / (gap * (2.0 - gap) * sums.cubed)
        before = level
        level = _bounded_level(level, np.clip(step, -_MAX_LEVEL_STEP, _MAX_LEVEL_STEP))
        if np.all(np.abs(level - before) < _LAST_LEVEL_STEP * level):
            break
    tail, deflection = _tail(polygon, clamp, level, length)
    return EndLoads(deflection, clamp, level, length, polygon), tail


def _bounded_level(level: Floats, step: Floats) -> Floats:
    """Return the level after a step, positive and at most `_MAX_LEVEL`."""
    return np.clip(level + step, level / 4.0, _MAX_LEVEL)


def _at_deflections(ladder: EndLoads, law: MomentLaw, length: float, wanted: Floats) -> EndLoads:
    """Solve for clamp moment and level at given deflections, starting from the ladder."""
    clamp, level = _first_guess(ladder, wanted)
    polygon = polygon_of(law, float(ladder.clamp_moment[-1]))
    room = _workspace(polygon, clamp)
    for _ in range(_NEWTON_STEPS):
        step = _newton_step(polygon, (np.exp(clamp), level), length, wanted, room)
        before = level
        clamp, level = clamp + step[0], _bounded_level(level, step[1])
        if np.all(np.abs([step[0], level - before]) < _LAST_LEVEL_STEP * np.minimum(level, 1.0)):
            break
    return EndLoads(wanted, np.exp(clamp), level, length, polygon)


def _first_guess(ladder: EndLoads, wanted: Floats) -> tuple[Floats, Floats]:
    """Interpolate the logarithm of the clamp's moment, and `level`, in a ladder."""
    log_deflection, rungs = np.log(wanted), np.log(ladder.deflection)
    below = np.minimum(log_deflection - rungs[0], 0.0)  # proportional below the lowest
    clamp, level = (
        np.interp(log_deflection, rungs, np.log(values)) + below
        for values in (ladder.clamp_moment, ladder.level)
    )
    return clamp, np.exp(level)


def _newton_step(
    polygon: Polygon, state: tuple[Floats, Floats], length: float, wanted: Floats, room: Floats
) -> Floats:
    """Return the steps of the logarithm of the clamp's moment and of `level`, shape (2, n)."""
    clamp, level = state
    curvature, energy = _at_clamp(polygon, clamp)
    gap = _tip_gap(level)
    c = np.tanh(level) / energy  # 1 / P
    sums = _integrate(polygon, clamp, c, gap, room)
    per_clamp = c * curvature
    c_by_clamp, c_by_level = -per_clamp / energy * clamp, gap * (2.0 - gap) / energy
    rise_by_c = sums.rise + sums.cubed_rise
    length_by_clamp = c * clamp * (1.0 + per_clamp * sums.cubed_rise) + c_by_clamp * sums.cubed
    rise_by_clamp = c * clamp * per_clamp * sums.cubed + c_by_clamp * rise_by_c
    length_by_level, rise_by_level = sums.cubed * c_by_level, rise_by_c * c_by_level
    no_length, no_rise = length - c * sums.length, wanted - c * sums.rise
    step = np.array(
        [
            rise_by_level * no_length - length_by_level * no_rise,
            length_by_clamp * no_rise - rise_by_clamp * no_length,
        ]
    ) / (length_by_clamp * rise_by_level - length_by_level * rise_by_clamp)
    return np.clip(step, -_MAX_LEVEL_STEP, _MAX_LEVEL_STEP)


def _tail(polygon: Polygon, clamp: Floats, level: Floats, length: float) -> tuple[Floats, Floats]:
    """Return the tail of `EndLoads`, and the deflection.

    The remaining length of an upright tip is added to both.
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
    upright = np.where(level >= _MAX_LEVEL, np.maximum(length - tail[:, -1], 0.0), 0.0)
    return tail + upright[:, None], rise + upright
