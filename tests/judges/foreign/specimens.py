"""What is bent and pulled, and what is true of it: laws, curves without noise, definitions on them.

Peak: the largest force. Stiffness: the least-squares line over its window. Energy: trapezoids.
Two segments: the best pair of joined lines of all. Failure: the last point before the loss.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

Array = NDArray[np.float64]
Row = tuple[float, float, float, Array]
"""Travel, force, deflection, curvature."""
GRAVITY = 9.80665
POINTS = 22


@dataclass(frozen=True)
class Wire:
    """A clamped wire and what pulls it.

    Parameters
    ----------
    length : m, clamped end to string
    rigidity : N m^2, the part of the stiffness that never slips
    parts : (Z in N m, k in 1/m) of what slips
    string, hung : m, kg at the tip
    """

    length: float
    rigidity: float
    parts: tuple[tuple[float, float], ...]
    string: float = 0.76
    hung: float = 2.7e-3

    def first_moment(self, curvature: Array | float) -> Array:
        """Moment of a first loading, N m."""
        slipped = [z * -np.expm1(-np.asarray(curvature) / k) for z, k in self.parts]
        return np.asarray(self.rigidity * np.asarray(curvature) + sum(slipped), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Branch:
    """One stroke of the clamp: everything against the travel of the clamp, m.

    `travel` rises along the arrays; `curvature` has shape (steps, points along the wire).
    """

    travel: Array
    force: Array
    deflection: Array
    curvature: Array

    def at(self, travel: Array) -> tuple[Array, Array]:
        """Force, N, and deflection, m."""
        both = np.column_stack([self.force, self.deflection])
        found = PchipInterpolator(self.travel, both, extrapolate=False)(self._inside(travel))
        return found[:, 0], found[:, 1]

    def bends(self, travel: Array) -> Array:
        """Curvature, 1/m, shape (times, points)."""
        found = PchipInterpolator(self.travel, self.curvature)(self._inside(travel))
        return np.asarray(found, dtype=np.float64)

    def _inside(self, travel: Array) -> Array:
        return np.clip(travel, self.travel[0], self.travel[-1])


class Along:
    """Integrals and values along a length, from values at Chebyshev points."""

    def __init__(self, length: float) -> None:
        self.length = length
        places = -np.cos(np.pi * np.arange(POINTS) / (POINTS - 1))
        self._inverse = np.linalg.inv(chebyshev.chebvander(places, POINTS - 1))
        self._sums = chebyshev.chebint(np.eye(POINTS), lbnd=-1, scl=0.5 * length)
        self.integral = self.integrals_to(0.5 * length * (places + 1.0))

    def integrals_to(self, places: Array) -> Array:
        """Matrix that takes values at the points to integrals from 0 to the places, m."""
        t = 2.0 * places / self.length - 1.0
        made = chebyshev.chebvander(t, POINTS) @ self._sums @ self._inverse
        return np.asarray(made, dtype=np.float64)

    def shapes(self, curvature: Array, places: Array) -> tuple[Array, Array, Array]:
        """Angle, x and y at some places, each (times, places)."""
        inside = np.clip(places, 0.0, self.length)
        all_of_it = self.integrals_to(inside)
        angle = curvature @ self.integral.T
        return (
            curvature @ all_of_it.T,
            np.cos(angle) @ all_of_it.T,
            np.sin(angle) @ all_of_it.T,
        )


class Bending:
    """Drives the clamp of a wire to and fro; keeps what the wire remembers."""

    def __init__(self, wire: Wire) -> None:
        self.wire, self.along = wire, Along(wire.length)
        self.weight = wire.hung * GRAVITY
        self.curvature = np.zeros(POINTS)
        self.slipped = np.zeros((len(wire.parts), POINTS))
        self.place = 0.0
        self.row: Row = (0.0, 0.0, 0.0, self.curvature)

    def law(self, curvature: Array) -> tuple[Array, Array, Array]:
        """Moment, its slope, and the parts that slip, from the state before."""
        sense = np.sign(curvature - self.curvature)
        moment = self.wire.rigidity * curvature
        steep = np.full(POINTS, self.wire.rigidity)
        parts = np.empty_like(self.slipped)
        for j, (limit, k) in enumerate(self.wire.parts):
            fade = np.exp(-np.abs(curvature - self.curvature) / k)
            parts[j] = sense * limit + (self.slipped[j] - sense * limit) * fade
            moment = moment + parts[j]
            steep = steep + (limit - sense * parts[j]) / k
        return moment, steep, parts

    def bent_by(self, force: float) -> tuple[Row, Array]:
        """Travel, force, deflection and curvature in balance with a recorded force; the parts."""
        whole, length = self.along.integral, self.wire.length
        curvature = self.curvature.copy()
        tension = force + self.weight
        for _ in range(100):
            angle = whole @ curvature
            x, y = whole @ np.cos(angle), whole @ np.sin(angle)
            lean = (length - x[-1]) / self.wire.string
            up = tension * np.sqrt(1.0 - lean**2) - self.weight
            asked = up * (x[-1] - x) - tension * lean * (y[-1] - y)
            moment, steep, parts = self.law(curvature)
            step = (asked - moment) / steep
            curvature = curvature + step
            if np.abs(step).max() < 1e-9:
                break
        else:
            message = f"the wire finds no balance at {force} N"
            raise RuntimeError(message)
        dropped = self.wire.string * (1.0 - np.sqrt(1.0 - lean**2))
        return (float(y[-1] - dropped), force, float(y[-1]), curvature), parts

    def stroke(self, end: float, steps: int = 60) -> Branch:
        """Drive the clamp to a travel; when it comes back, the string may go slack on the way."""
        sense = 1.0 if end > self.place else -1.0
        rows = [self.row] if self.row[0] == self.place else [(self.place, *self.row[1:]), self.row]
        stretch, force_per_travel = 1e-5, self._steepness()
        while sense * (end - self.row[0]) > 1e-10:
            stretch = min(1.25 * stretch, abs(end - self.place) / steps)
            ahead = sense * min(stretch, abs(end - self.row[0]))
            before = self.row
            self._load(max(before[1] + force_per_travel * ahead, -self.weight), end, sense)
            rows.append(self.row)
            if self.row[1] <= -self.weight:
                break
            force_per_travel = (self.row[1] - before[1]) / (self.row[0] - before[0])
        if self.row[0] != end:
            rows.append((end, *self.row[1:]))
        self.place = end
        order = slice(None) if sense > 0 else slice(None, None, -1)
        travel, force, deflection, curvature = (np.array(c)[order] for c in zip(*rows, strict=True))
        return Branch(travel, force, deflection, curvature)

    def _steepness(self) -> float:
        stuck = self.wire.rigidity + sum(limit / k for limit, k in self.wire.parts)
        return 3.0 * stuck / self.wire.length**3

    def _load(self, force: float, end: float, sense: float) -> None:
        """Go to a force, or to the end of the stroke if that comes first."""
        row, parts = self.bent_by(force)
        if sense * (row[0] - end) > 0.0:
            force = brentq(lambda f: self.bent_by(f)[0][0] - end, self.row[1], force, xtol=1e-12)
            row, parts = self.bent_by(force)
            row = (end, *row[1:])
        self.row, self.curvature, self.slipped = row, row[3], parts


@lru_cache(maxsize=16)
def loops(wire: Wire, stroke: float, cycles: int) -> tuple[Branch, ...]:
    """All strokes of a test, there and back in turn."""
    bending = Bending(wire)
    return tuple(bending.stroke(stroke * ((i + 1) % 2)) for i in range(2 * cycles))


@dataclass(frozen=True, eq=False)
class Knives:
    """A uniform rod between knife edges, which push normal to it; per span 1 and EI 1.

    Parameters
    ----------
    deflection, load, curvature, slope : of mid-span over span, load, at mid-span, at the edges
    until : arc length from edge to mid-span on the one curve that serves all deflections
    curve : angle, x, y along that curve, which starts at the edge
    """

    deflection: Array
    load: Array
    curvature: Array
    slope: Array
    until: Array
    curve: PchipInterpolator

    def axis(self, deflection: Array, span: float, along: Array) -> tuple[Array, Array, Array]:
        """x, y and angle at arc lengths from mid-span, (times, places); y is zero at the edges.

        The ends beyond the edges are straight.
        """
        d = np.clip(np.abs(deflection) / span, self.deflection[1], None)
        until = np.interp(d, self.deflection, self.until)[:, None]
        slope, half = self._level(self.curve(until))[::2]
        scale = 0.5 * span / half
        from_edge = until - np.abs(along)[None, :] / scale
        state = self.curve(np.clip(from_edge, 0.0, None))
        state[..., 1] += np.clip(from_edge, None, 0.0)
        angle, x, y = state[..., 0], *self._turned(state, slope)
        side = np.sign(along)[None, :]
        return side * (0.5 * span - scale * x), scale * y, side * (slope - angle)

    def _level(self, end: Array) -> tuple[Array, Array, Array]:
        x, y = self._turned(end, end[..., 0])
        return end[..., 0], y, x

    @staticmethod
    def _turned(state: Array, by: Array) -> tuple[Array, Array]:
        x, y = state[..., 1], state[..., 2]
        return x * np.cos(by) + y * np.sin(by), y * np.cos(by) - x * np.sin(by)


@lru_cache(maxsize=1)
def knives() -> Knives:
    """The curve psi'' = cos psi from an edge on, turned at every slope that an edge can have."""
    s = np.linspace(0.0, 1.25, 2001)

    def path(_: float, state: Array) -> list[float]:
        angle, x = float(state[0]), float(state[1])
        return [x, float(np.cos(angle)), float(np.sin(angle))]

    found = solve_ivp(path, (0.0, s[-1]), [0.0, 0.0, 0.0], t_eval=s, rtol=1e-10, atol=1e-13).y
    angle, x, y = found
    twice = 2.0 * (x * np.cos(angle) + y * np.sin(angle))
    sag = (x * np.sin(angle) - y * np.cos(angle)) / np.where(twice > 0.0, twice, 1.0)
    load, bend = 2.0 * np.cos(angle) * twice**2, x * twice
    return Knives(sag, load, bend, angle, s, PchipInterpolator(s, found.T))


Law = Callable[[Array], Array]


@dataclass(frozen=True)
class Specimen:
    """What a frame pulls.

    Parameters
    ----------
    law : force, N, at a displacement, m; both zero at first
    ends : m, where it breaks or the frame stops
    breaks : whether it breaks there
    torn : share of the force that stays behind a break
    """

    law: Law
    ends: float
    breaks: bool = True
    torn: float = 0.01

    def force(self, d: Array) -> Array:
        """Force, N, also behind the end."""
        held = self.law(np.minimum(d, self.ends))
        if not self.breaks:
            return held
        return np.where(d <= self.ends, held, self.torn * held)

    def whole(self, points: int = 40001) -> tuple[Array, Array]:
        """The curve without noise, up to the end."""
        d = np.linspace(0.0, self.ends, points)
        return d, self.law(d)


def softly(x: Array, width: float) -> Array:
    """Zero below 0 and x above, rounded over a width."""
    return np.asarray(width * np.logaddexp(0.0, x / width), dtype=np.float64)


def two_regions(first: float, second: float, at: float, width: float) -> Law:
    """Slopes of a first and a second region, N/m, that change at a place."""

    def law(d: Array) -> Array:
        turned = softly(d - at, width) - softly(np.array(-at), width)
        return np.asarray(first * d + (second - first) * turned, dtype=np.float64)

    return law


def behind(law: Law, slack: float, width: float) -> Law:
    """A specimen that hangs loose at first."""

    def loose(d: Array) -> Array:
        return law(softly(d - slack, width) - softly(np.array(-slack), width))

    return loose


def drops(law: Law, slips: tuple[tuple[float, float], ...]) -> Law:
    """Grips that let go: from a place on the force is lower by so much."""

    def lower(d: Array) -> Array:
        return np.asarray(law(d) - sum(drop * (d > at) for at, drop in slips), dtype=np.float64)

    return lower


def ductile(top: float, necks: float, ends: float, *, stretch: float = 0.3e-3) -> Specimen:
    """A metal wire: bends off early, hardens, and necks smoothly to four fifths of its force."""

    def law(d: Array) -> Array:
        rise = top * (0.8 * -np.expm1(-d / stretch) + 0.25 * d / ends)
        neck = np.clip(d - necks, 0.0, None) / (ends - necks)
        return np.asarray(rise * (1.0 - 0.24 * neck**2), dtype=np.float64)

    return Specimen(behind(law, 0.15e-3, 0.03e-3), ends)


def brittle(stiffness: float, ends: float) -> Specimen:
    """Nearly straight up to a sudden break."""

    def law(d: Array) -> Array:
        return np.asarray(stiffness * d * (1.0 - 0.04 * d / ends), dtype=np.float64)

    return Specimen(behind(law, 0.12e-3, 0.03e-3), ends, torn=0.0)


def yarn(stiffness: float, first: float, apart: float) -> Specimen:
    """Five fibres break one after another, 12 % of the yarn each; at 40 % the rest lets go."""
    places = first + apart * np.arange(5.0)

    def law(d: Array) -> Array:
        carried = 1.0 - 0.12 * (d[:, None] > places[None, :]).sum(axis=1)
        return np.asarray(stiffness * d * carried, dtype=np.float64)

    return Specimen(behind(law, 0.1e-3, 0.03e-3), float(places[-1] + apart), torn=0.0)


def tearing(first: float, second: float, at: float, ends: float) -> Specimen:
    """A woven tube: two straight regions, then threads give way and it tears."""
    regions = two_regions(first, second, at, 0.35e-3)

    def law(d: Array) -> Array:
        worn = np.clip((d - 0.86 * ends) / (0.14 * ends), 0.0, None)
        return np.asarray(regions(d) * (1.0 - 0.1 * worn**2), dtype=np.float64)

    return Specimen(law, ends, torn=0.02)


def rubbery(stiffness: float, ends: float) -> Specimen:
    """A corrugated tube: softer as it stretches; the frame stops before it breaks."""

    def law(d: Array) -> Array:
        return np.asarray(stiffness * d / (1.0 + 4.0 * d), dtype=np.float64)

    return Specimen(law, ends, breaks=False)


def bar(compliance: float, top: float) -> Specimen:
    """A stiff bar in grips that settle: travel = C F + 8 um (1 - exp(-F / 12 N))."""
    force = np.linspace(0.0, 1.05 * top, 4001)
    travel = compliance * force + 8e-6 * -np.expm1(-force / 12.0)

    def law(d: Array) -> Array:
        return np.interp(d, travel, force)

    return Specimen(law, float(np.interp(top, force, travel)), breaks=False)


def bent_rod(rigidity: float, span: float, yields: float, ends: float) -> Specimen:
    """A rod on knife edges: elastic, then with two fifths of its slope."""
    rod = knives()

    def elastic(d: Array) -> Array:
        load = np.interp(d / span, rod.deflection, rod.load)
        return np.asarray(rigidity / span**2 * load, dtype=np.float64)

    def law(d: Array) -> Array:
        beyond = softly(d - yields, 0.02 * yields)
        lost = 0.6 * (elastic(yields + beyond) - elastic(np.array(yields)))
        return np.asarray(elastic(d) - lost, dtype=np.float64)

    return Specimen(law, ends, breaks=False)


@dataclass(frozen=True)
class Loop:
    """A spring beside parts that slip: dz = (Z - z sign) |dd| / k along each stroke.

    Parameters
    ----------
    stiffness : N/m, that never slips
    parts : (Z in N, k in m)
    """

    stiffness: float
    parts: tuple[tuple[float, float], ...]

    def strokes(self, turns: tuple[float, ...]) -> list[Law]:
        """Force along each stroke between turning points, from rest at 0."""
        state, last, laws = [0.0] * len(self.parts), 0.0, []
        for turn in turns:
            laws.append(self._stroke(tuple(state), last, np.sign(turn - last)))
            state = [float(z) for z in self._slipped(state, last, turn)]
            last = turn
        return laws

    def _slipped(
        self, state: list[float] | tuple[float, ...], last: float, d: float
    ) -> list[float]:
        sense = np.sign(d - last)
        fades = [np.exp(-abs(d - last) / k) for _, k in self.parts]
        return [
            sense * limit + (z - sense * limit) * fade
            for (limit, _), z, fade in zip(self.parts, state, fades, strict=True)
        ]

    def _stroke(self, state: tuple[float, ...], last: float, sense: float) -> Law:
        def law(d: Array) -> Array:
            force = self.stiffness * d
            for (limit, k), z in zip(self.parts, state, strict=True):
                force = force + sense * limit + (z - sense * limit) * np.exp(-np.abs(d - last) / k)
            return np.asarray(force, dtype=np.float64)

        return law


def slope(d: Array, f: Array) -> float:
    """Least-squares slope of f over d."""
    lever = d - d.mean()
    return float(lever @ f / (lever @ lever))


def window_slope(d: Array, f: Array, start: float, end: float) -> float:
    """Slope over a window of d."""
    inside = (d >= start) & (d <= end)
    return slope(d[inside], f[inside])


def work(d: Array, f: Array) -> float:
    """Integral of f over d."""
    return float(np.trapezoid(f, d))


def crossing(d: Array, f: Array, level: float) -> float:
    """The d at which f first goes through a level."""
    above = f >= level
    i = int(np.flatnonzero(above[1:] != above[:-1])[0])
    share = (level - f[i]) / (f[i + 1] - f[i])
    return float(d[i] + share * (d[i + 1] - d[i]))


def slack(d: Array, f: Array, low: float = 0.1, high: float = 0.3) -> float:
    """Where the line between two shares of the largest force meets zero."""
    top = int(np.argmax(f))
    peak = float(f[top])
    start, end = crossing(d[: top + 1], f[: top + 1], low * peak), 0.0
    end = crossing(d[: top + 1], f[: top + 1], high * peak)
    inside = (d >= start) & (d <= end)
    steep = slope(d[inside], f[inside])
    return float(d[inside].mean() - f[inside].mean() / steep)


def two_segments(d: Array, f: Array, start: float, end: float) -> tuple[float, float, float, float]:
    """First slope, second slope, break point and the force there, over a window."""
    inside = (d >= start) & (d <= end)
    x, y = d[inside], f[inside]
    keep = np.linspace(0, len(x) - 1, min(len(x), 4000)).astype(int)
    x, y = x[keep], y[keep]

    def fit(place: float) -> tuple[float, Array]:
        design = np.column_stack([np.ones_like(x), x, np.clip(x - place, 0.0, None)])
        found, *_ = np.linalg.lstsq(design, y, rcond=None)
        return float(np.sum((y - design @ found) ** 2)), found

    low, high = start + 0.05 * (end - start), end - 0.05 * (end - start)
    for _ in range(4):
        places = np.linspace(low, high, 25)
        best = int(np.argmin([fit(place)[0] for place in places]))
        low, high = places[max(best - 1, 0)], places[min(best + 1, 24)]
    place = float(places[best])
    level, first, more = fit(place)[1]
    return float(first), float(first + more), place, float(level + first * place)


def onset(d: Array, f: Array, level: float) -> tuple[float, float] | None:
    """Place and force from which on the tangent stays below a level, to the end; None if never."""
    tangent = np.gradient(f, d)
    steep = np.flatnonzero(tangent >= level)
    if not len(steep) or steep[-1] >= len(d) - 2:
        return None
    return float(d[steep[-1]]), float(f[steep[-1]])
