"""The quasi-static path of a bundle on two rollers that a third one pushes down in the middle.

Half of it is solved (`virtual_lab.bent_half`), the other half being its mirror image. Where the
force comes back to nothing the upper roller leaves the bundle as it is.

Everything scales: with moments f times as large at given curvatures the forces are f times as large
and no place changes. So one solution serves all samples of a type.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.bent_half import BentHalf, HalfBundle, ThreePointTest, half_bundle
from labpipe.wire.laws import virgin_plays

_SMALLEST_STEP = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class ThreePointPath:
    """A solved test.

    Parameters
    ----------
    test : what was solved
    arc_length : shape (stations,), m, from mid-span
    loading : positions from rest to full stroke
    unloading : positions from full stroke back to rest, or to where the force is gone
    """

    test: ThreePointTest
    arc_length: Floats
    loading: tuple[BentHalf, ...]
    unloading: tuple[BentHalf, ...]

    @property
    def residual(self) -> float:
        """Displacement at which the force is gone on unloading, m; 0 where it never is."""
        return self.unloading[-1].displacement

    def displacement(self, progress: Floats) -> Floats:
        """Where the upper roller is at progress (its way down and up added), m, shape (n,)."""
        inside = np.clip(progress, 0.0, 2.0 * self.test.stroke)
        way: Floats = self.test.stroke - np.abs(self.test.stroke - inside)
        return way

    def force(self, progress: Floats) -> Floats:
        """Force at progress, N, shape (n,)."""
        return self._look_up(progress, [[half.force] for half in self._halves])[:, 0]

    def middle(self, progress: Floats) -> tuple[Floats, Floats, Floats]:
        """Way of mid-span, m, and moment and curvature there, N m, 1/m; shape (n,) each."""
        rows = [[h.displacement, h.moment[0], h.curvature[0]] for h in self._halves]
        found = self._look_up(progress, rows)
        return found[:, 0], found[:, 1], found[:, 2]

    def points(self, progress: Floats, arc_length: Floats) -> tuple[Floats, Floats, Floats]:
        """Places on the axis, and the angle of its tangent.

        Parameters
        ----------
        progress : shape (n,), m
        arc_length : shape (m,), m, from mid-span, negative to the left

        Returns
        -------
        x, y, angle, each of shape (n, m): x to the right from mid-span, y upwards from where the
        axis lay at rest, m, rad.
        """
        side, where = np.sign(arc_length), np.abs(arc_length)
        halves = np.array([np.concatenate([h.x, h.y, h.angle]) for h in self._halves])
        along = halves.reshape(len(halves), 3, -1)
        rows = CubicSpline(self.arc_length, along, axis=2)(where).reshape(len(halves), -1)
        x, y, angle = np.split(self._look_up(progress, rows), 3, axis=1)
        way, _, _ = self.middle(progress)
        return side * x, y - way[:, None], side * angle

    @property
    def _halves(self) -> tuple[BentHalf, ...]:
        return self.loading + self.unloading

    def _look_up(self, progress: Floats, rows: object) -> Floats:
        """Splines along both branches; what is left of a bundle stays as it is."""
        columns = np.asarray(rows, dtype=np.float64)
        n, stroke = len(self.loading), self.test.stroke
        down = CubicSpline([h.displacement for h in self.loading], columns[:n])
        up = CubicSpline([2.0 * stroke - h.displacement for h in self.unloading], columns[n:])
        until = 2.0 * stroke - self.residual
        is_down = (progress <= stroke)[:, None]
        found: Floats = np.where(
            is_down,
            down(np.clip(progress, 0.0, stroke)),
            up(np.clip(progress, stroke, until)),
        )
        return found


@lru_cache(maxsize=64)
def solve_three_point(test: ThreePointTest) -> ThreePointPath:
    """Solve a test; equal tests are solved once.

    Parameters
    ----------
    test : bundle and rig

    Returns
    -------
    The path.

    Raises
    ------
    ValueError
        If there is no equilibrium somewhere on it, or the bundle slides off its rollers.
    """
    half = half_bundle(test)
    rest = half.free(virgin_plays(half.law, test.n_stations))
    loading = [rest, *_branch(half, rest, test.stroke, turns=False)]
    unloading = [loading[-1], *_branch(half, loading[-1], 0.0, turns=True)]
    return ThreePointPath(test, half.arc_length, tuple(loading), tuple(unloading))


def _branch(half: HalfBundle, begin: BentHalf, goal: float, *, turns: bool) -> Iterator[BentHalf]:
    """Walk to a displacement; on the way back stop where the force is gone."""
    test, here = half.test, begin
    share = np.linspace(0.0, 1.0, test.steps_per_branch + 1)[1:] ** test.crowding
    for wanted in (begin.displacement + share * (goal - begin.displacement)).tolist():
        if turns:
            let_go = half.free(here.plays)
            if let_go.displacement >= wanted - _SMALLEST_STEP:
                yield let_go
                return
        here = _reach(half, here, wanted, begin.displacement, turns=turns)
        yield here


def _reach(
    half: HalfBundle, here: BentHalf, wanted: float, turned_at: float, *, turns: bool
) -> BentHalf:
    """Go on to a displacement, in halves where Newton's method fails."""
    while True:
        ahead = wanted
        while (found := half.settle(here, ahead, half.friction(ahead - turned_at, turns))) is None:
            ahead = 0.5 * (here.displacement + ahead)
            if abs(ahead - here.displacement) < _SMALLEST_STEP:
                message = f"displacement={wanted!r}: no equilibrium beyond {here.displacement:.6g}"
                raise ValueError(message)
        if ahead == wanted:
            return found
        here = found
