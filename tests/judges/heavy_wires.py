"""A heavy wire by collocation on the law of its section: shares no code with the wire's solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from scipy.integrate import solve_bvp

from labpipe.records.arrays import Floats

Law: TypeAlias = Callable[[Floats], Floats]
"""Curvature, 1/m, of first loading at moments, N m, odd."""


STICK, SOFTENING, YIELD = 1.2e-3, 4000.0, 2e-4
"""N m^2, 1/(N m^2), N m: of `yielding`."""


def yielding(moment: Floats) -> Floats:
    """A law that softens from the start, without a corner."""
    size = np.abs(moment) / YIELD
    return np.asarray(
        moment / STICK + np.sign(moment) * SOFTENING * YIELD * (size - np.log1p(size))
    )


@dataclass(frozen=True)
class HeavyWire:
    """A wire of some law, length (m) and weight (N/m); the string's length (m), None for none."""

    law: Law
    length: float
    self_weight: float
    string: float | None = None
    counterweight: float = 0.0

    def rest(self) -> Any:
        """Held level at its tip: states theta, M, x, y over s, and the pull."""
        return self._solve(lambda _, moment: self.law(moment), 0.0, None)

    def loaded(self, rest: Any, deflection: float, guess: Any = None) -> Any:
        """From rest to a deflection that grows; every place turned back by Masing's rule."""
        return self._solve(
            lambda s, moment: self._from(rest.sol(s)[1], moment), deflection, guess or rest
        )

    def pull(self, found: Any) -> float:
        """Tension of the string, or the end load, N."""
        return float(found.p[0])

    def _from(self, before: Floats, moment: Floats) -> Floats:
        back = self.law(before) + 2.0 * self.law((moment - before) / 2.0)
        is_back = (before * (moment - before) < 0.0) & (np.abs(moment) < np.abs(before))
        return np.where(is_back, back, self.law(moment))

    def _solve(self, curvature: Callable[[Floats, Floats], Floats], tip: float, guess: Any) -> Any:
        def pulls(x_tip: float, tension: float) -> tuple[float, float]:
            if self.string is None:
                return 0.0, tension
            lean = (self.length - x_tip) / self.string
            return tension * lean, tension * np.sqrt(1.0 - lean**2) - self.counterweight

        def slopes(s: Floats, state: Floats, parameters: Floats) -> Floats:
            theta, moment = state[0], state[1]
            along, across = pulls(parameters[1], parameters[0])
            shear = across - self.self_weight * (self.length - s)
            bent = along * np.sin(theta) - shear * np.cos(theta)
            return np.array([curvature(s, moment), bent, np.cos(theta), np.sin(theta)])

        def ends(first: Floats, last: Floats, parameters: Floats) -> Floats:
            at_clamp = [first[0], first[2], first[3]]
            return np.array([*at_clamp, last[1], last[3] - tip, last[2] - parameters[1]])

        mesh = np.linspace(0.0, self.length, 401) if guess is None else guess.x
        start = np.zeros((4, 401)) if guess is None else guess.y
        if guess is None:
            start[2] = mesh
        parameters = [self.counterweight, self.length] if guess is None else guess.p
        found = solve_bvp(slopes, ends, mesh, start, p=parameters, tol=1e-5, max_nodes=20_000)
        if not found.success:
            raise ValueError(found.message)
        return found
