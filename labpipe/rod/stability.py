"""Whether an equilibrium is stable, and the way in which it gives way.

An equilibrium under held nodes and dead loads is stable where the second variation of the energy is
positive for all changes that keep the stretch rows. That is so where the tangent without the rows'
multipliers, stiffened along the rows by something much stiffer than the line, is positive definite,
which one banded Cholesky factorisation tells. The stiffening is 1e6 times the line's own scale, and
what gives way by less than 3e-4 of the line's own stiffness counts as neutral, so that critical
loads come out within about 1e-4. Sliders count as they slid in the step: where the
line would go on in the same sense.

Follower parts, as moments of constant direction on frames and sliding friction, count by their
symmetric part.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from labpipe.records.arrays import Floats
from labpipe.rod.assembly import Assembly, Balance, Shape
from labpipe.rod.banded import FORCE, PER_ELEMENT, STRETCH, TURN, entries

_STIFFER = 1e6
_NEUTRAL = 3e-4
"""Of a line's own stiffness: a mode this soft counts as neutral, not as unstable."""
_ROUNDING = 1e-14
_ITERATIONS = 6
_OF_ANYTHING = 1e-3


class StabilityCheck:
    """Checks of one line with given supports; what does not change is worked out once."""

    def __init__(self, assembly: Assembly) -> None:
        self._assembly = assembly
        n, band = assembly.n, assembly.band
        rows, columns = assembly.pattern
        is_force = np.arange(assembly.places.total) % PER_ELEMENT >= FORCE
        self._kept = np.flatnonzero(~(is_force[rows] | is_force[columns]))
        pairs = [
            *((rows[self._kept], columns[self._kept]),),
            entries(assembly.places.positions[:-1], FORCE, assembly.places.positions[:-1], FORCE),
            entries(assembly.places.positions[:-1], FORCE, assembly.places.positions[1:], 3),
            entries(assembly.places.positions[1:], 3, assembly.places.positions[1:], 3),
        ]
        down, right = (_without_forces(np.concatenate(each)) for each in zip(*pairs, strict=True))
        row, column = np.maximum(down, right), np.minimum(down, right)
        self.size = FORCE * n + 3
        self._deep = int(np.max(row - column)) + 1
        self._at = self._deep * column + (row - column)
        free = ~is_force
        self._free = np.flatnonzero(free)
        fixed = band.fixed[free]
        scale = band.scale[free]
        # an entry off the diagonal comes as (i, j) and as (j, i), but for the block between nodes
        count = np.ones(len(row))
        count[: len(self._kept)] = np.where(row == column, 1.0, 0.5)[: len(self._kept)]
        own = slice(len(self._kept), len(self._kept) + n * FORCE * FORCE)
        count[own] = np.where(row == column, 1.0, 0.5)[own]
        last = slice(len(row) - 9 * n, len(row))
        count[last] = np.where(row == column, 1.0, 0.5)[last]
        self._weights = count * scale[row] * scale[column] * ~(fixed[row] | fixed[column])
        self._scale, self._fixed = scale, fixed
        self._drag = assembly.drag[free] * scale**2
        self._mass = self._drag * (np.arange(self.size) % FORCE < STRETCH)

    def is_stable(self, balance: Balance, shape: Shape) -> bool:
        """Whether the tangent of a balance at a shape is positive along what may change."""
        return self._factors(balance, shape, _NEUTRAL) is not None

    def lowest_mode(self, balance: Balance, shape: Shape, push: Floats) -> Floats | None:
        """The change of the unknowns in which the line resists least; None where none is found.

        Parameters
        ----------
        balance, shape : where it is
        push : shape (unknowns,), N and N m: of ways in which it resists alike, the one to this side

        Notes
        -----
        Inverse iteration with the nodes' share of the drag as the mass: a way without movement, as
        a mere twist, is none. Moments in the frames of the elements that are no symmetry of
        anything are added to the push, a little of them.
        """
        drag = 1e-3
        factors = self._factors(balance, shape, drag)
        while factors is None and drag < 1e9:
            drag *= 4.0
            factors = self._factors(balance, shape, drag)
        if factors is None:
            return None
        is_across = (np.arange(self.size) % FORCE >= TURN) & (
            np.arange(self.size) % FORCE < TURN + 2
        )
        some = np.cos(1.0 + 2.4 * np.arange(self.size)) * is_across
        some /= np.sqrt(np.sum(some**2))
        pushed = push[self._free] * self._scale * ~self._fixed
        size = float(np.sqrt(np.sum(pushed**2)))
        mode = some * ~self._fixed
        if size > 0.0:
            mode = pushed / size + _OF_ANYTHING * mode
        for _ in range(_ITERATIONS):
            mode, _ = lapack.dpbtrs(factors, mode, lower=True)
            mode = self._mass * mode
            size = float(np.sqrt(np.sum(mode**2)))
            if size == 0.0:
                return None
            mode /= size
        mode, _ = lapack.dpbtrs(factors, mode, lower=True)
        change = np.zeros(self._assembly.places.total)
        change[self._free] = mode * self._scale
        return change

    def _factors(self, balance: Balance, shape: Shape, drag: float) -> Floats | None:
        assembly = self._assembly
        line = assembly.line
        n = assembly.n
        section = line.section
        pull = float(np.max(np.abs(shape.forces)))
        stiff = _STIFFER * max(section.law.first_stiffness / line.length**2, pull)
        lengths = line.lengths * (1.0 + shape.stretches)
        row = np.zeros((n, 3, FORCE + 3))
        row[:, :, :3] = -np.eye(3)
        row[:, :, 3] = -line.lengths[:, None] * balance.directions.along
        row[:, :, 4:7] = -lengths[:, None, None] * balance.directions.by_turn
        row[:, :, 7:] = np.eye(3)
        stiffness = np.swapaxes(row, 1, 2) @ row * (stiff / line.lengths)[:, None, None]
        values = np.concatenate(
            [
                balance.even[self._kept],
                stiffness[:, :FORCE, :FORCE].ravel(),
                stiffness[:, :FORCE, FORCE:].ravel(),
                stiffness[:, FORCE:, FORCE:].ravel(),
            ]
        )
        weighed = values * self._weights
        flat = np.bincount(self._at, weighed, minlength=self._deep * self.size)
        diagonal = flat[:: self._deep]
        diagonal += drag * self._drag + _ROUNDING * diagonal
        diagonal[self._fixed] = 1.0
        factors, failed = lapack.dpbtrf(
            flat.reshape(self.size, self._deep).T, lower=True, overwrite_ab=True
        )
        return None if failed else np.asarray(factors)


def _without_forces(places: Floats) -> Floats:
    return np.asarray(FORCE * (places // PER_ELEMENT) + places % PER_ELEMENT)
