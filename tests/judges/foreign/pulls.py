"""Things that a load frame pulls or presses: force as a plain function of displacement, SI."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.judges.foreign.bends import knives

Array = NDArray[np.float64]
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
