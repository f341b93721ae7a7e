"""The chain of the source's figure B.3, held in its middle and lifted from a table, by formulas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.law.sliders import linear_moment_law
from labpipe.records.arrays import Floats
from labpipe.rod.boundaries import Boundary, Gravity, Held, Plane
from labpipe.rod.line import Line, Section
from labpipe.rod.path import RodPath
from labpipe.rod.statics import follow
from tests.builders.rods import straight_line
from tests.judges.judged_rods import section


@dataclass(frozen=True)
class LiftedChain:
    """A chain on a table with friction, its middle lifted, slowly.

    Parameters
    ----------
    length, height : m, of the whole chain, and by which the middle is lifted
    friction : coefficient
    weight : N/m
    """

    length: float = 1.0
    height: float = 0.25
    friction: float = 0.5
    weight: float = 1.0

    @property
    def lying(self) -> float:
        """Length that still lies on the table on one side, m.

        What hangs is a catenary that leaves the table level, of parameter a = H / w = friction
        times what lies; its length s and height h have s^2 = h^2 + 2 a h.
        """
        half, most = 0.5 * self.length, 0.5 * self.length + self.friction * self.height
        return float(most - np.sqrt(most**2 - (half**2 - self.height**2)))

    @property
    def pull(self) -> float:
        """Horizontal force, the same in all that hangs, N: friction of what lies."""
        return self.friction * self.weight * self.lying

    def half_shape(self, arc: Floats) -> tuple[Floats, Floats]:
        """Distance from the middle and height, m, at arc lengths from the middle."""
        hanging = 0.5 * self.length - self.lying
        above = np.clip(hanging - arc, 0.0, None)
        if self.friction == 0.0:
            return np.clip(arc - hanging, 0.0, None), above
        a = self.friction * self.lying
        across = a * (np.arcsinh(hanging / a) - np.arcsinh(above / a))
        return across + np.clip(arc - hanging, 0.0, None), np.hypot(a, above) - a

    def line(self, elements: int, *, stiffness: float) -> Line:
        """The chain on the table along x, its middle at the origin; an even number of elements."""
        section = Section(
            linear_moment_law(stiffness, 1e4), stiffness, mass_per_length=self.weight / 9.81
        )
        return straight_line(self.length, elements, section, start=(-0.5 * self.length, 0.0, 0.0))

    def lift(self, elements: int, steps: int, *, rest: int = 0) -> list[Boundary]:
        """Boundaries, the middle lifted in so many steps, gently at both ends."""
        share = np.append(np.linspace(0.0, 1.0, steps + 1), np.ones(rest))
        path = np.zeros((len(share), 3))
        path[:, 2] = self.height * share**2 * (3.0 - 2.0 * share)
        table = Plane(np.zeros(3), friction=self.friction)
        return [Held(elements // 2, path), Gravity(), table]


def lifted_half(chain: LiftedChain, elements: int, soft: float, *, steps: int = 20) -> RodPath:
    """Half of it, held where its middle is: links that resist bending by EI = GJ = soft, N m^2."""
    line = straight_line(0.5 * chain.length, elements, section(soft, soft, weight=chain.weight))
    way = np.zeros((steps + 1, 3))
    way[:, 2] = np.linspace(0.0, chain.height, steps + 1)
    table = Plane(np.zeros(3), friction=chain.friction)
    return follow(line, [Held(0, way), Gravity(), table], steps=steps)
