"""Whether an equilibrium is stable, and the way in which it gives way.

An equilibrium under held nodes and dead loads is stable where the second variation of the energy is
positive for all changes that keep the stretch rows. That is so where the tangent without the rows'
multipliers, stiffened along the rows by something much stiffer than the line, is positive definite,
which one banded Cholesky factorisation tells. The stiffening is 1e6 times the line's own scale, and
what gives way by less than 3e-4 of the line's own stiffness counts as neutral, so that critical
loads come out within about 1e-4. Sliders count as they slid in the step: where the
line would go on in the same sense.

Moments of constant direction have no energy (Ziegler, Principles of structural stability, 1968):
they make the tangent unsymmetric. Where its symmetric part is positive the line is stable all the
same. Where it is not, the line in honey decides: it comes back where no eigenvalue of the tangent
against the drag has a negative real part. A real one diverges: its zero, where another equilibrium
branches off, does not depend on the drag. One of a pair that is not real whirls, and does depend on
it. Flutter by inertia is not looked for. Sliding friction counts by its symmetric part.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack
from scipy.sparse.linalg import ArpackError, LinearOperator, eigs

from labpipe.records.arrays import Floats
from labpipe.rod.assembly import Assembly, Balance, Shape
from labpipe.rod.banded import FORCE, PER_ELEMENT, STRETCH, TURN, entries

_SHIFT_DRAG = 10.0
"""Drag: eigenvalues are looked for around minus this, which is nearer to the unstable ones."""


class StabilityCheck:
    """Checks of one line with given supports; what does not change is worked out once.

    Parameters
    ----------
    assembly : the line with its supports
    is_turned : whether moments of constant direction act on it
    """

    def __init__(self, assembly: Assembly, *, is_turned: bool = False) -> None:
        self._assembly, self._is_turned = assembly, is_turned
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
        down, right = (_without_forces(np.concatenate(pair)) for pair in zip(*pairs, strict=True))
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
        """Whether a line at a shape comes back from every small change, in honey."""
        neutral_share = 3e-4  # of the line's own stiffness: a softer mode counts as neutral
        if self._factors(balance, shape, neutral_share) is not None:
            return True
        return self._is_turned and self.slowest_return(balance)[0].real > -neutral_share

    def whirls(self, balance: Balance) -> bool:
        """Whether a line that is not stable turns away round and round, more than it leaves."""
        rate = self.slowest_return(balance)[0] if self._is_turned else complex(-np.inf)
        return rate.real < 0.0 and abs(rate.imag) > abs(rate.real)

    def slowest_return(self, balance: Balance) -> tuple[complex, Floats]:
        """Find how fast the change dies out that does so slowest, and that change of the unknowns.

        Parameters
        ----------
        balance : where it is

        Returns
        -------
        Rate, 1 for a line of its own stiffness against a drag of 1: of negative real part for a
        change that grows; minus infinity, with no change, where none was found.

        Notes
        -----
        Rates r solve K x = r D x with the tangent K and the drag D. Arnoldi's method finds those
        nearest to a negative number, where all that grow in earnest are nearer than any other.
        """
        n_eigenvalues = 8
        band, drag = self._assembly.band, self._assembly.drag
        own = np.flatnonzero((drag > 0.0) & ~band.fixed)
        root = np.sqrt(drag[own])
        change = np.zeros(len(drag))
        factors = band.factorise(self._held_back(balance))
        if factors is None:
            return complex(-np.inf), change

        def answer(push: Floats) -> Floats:
            right = np.zeros(len(drag))
            right[own] = root * np.ravel(push)
            found = band.solve_factored(factors, right)
            return np.full(len(own), np.nan) if found is None else root * found[own]

        inverse = LinearOperator((len(own), len(own)), matvec=answer, dtype=np.float64)
        first = np.cos(1.0 + 2.4 * np.arange(len(own)))
        try:
            found, ways = eigs(inverse, k=min(n_eigenvalues, len(own) - 2), v0=first)
        except ArpackError:
            return complex(-np.inf), change
        rates = 1.0 / found - _SHIFT_DRAG
        slowest = int(np.argmin(rates.real))
        change[own] = np.real(ways[:, slowest]) / root
        return complex(rates[slowest]), change

    def _held_back(self, balance: Balance) -> Floats:
        """Entries of the tangent with a drag of `_SHIFT_DRAG`."""
        rows, columns = self._assembly.pattern
        at, first = np.unique(np.where(rows == columns, rows, -1), return_index=True)
        values = balance.even.copy()
        values[first[1:]] += _SHIFT_DRAG * self._assembly.drag[at[1:]]
        return values

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
        iterations = 6
        random_share = 1e-3
        if self._is_turned:
            rate, change = self.slowest_return(balance)
            if rate.real < 0.0 and np.any(change):
                return change
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
            mode = pushed / size + random_share * mode
        for _ in range(iterations):
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
        support_factor = 1e6
        rounding_share = 1e-14
        assembly = self._assembly
        line = assembly.line
        n = assembly.n
        section = line.section
        pull = float(np.max(np.abs(shape.forces)))
        stiff = support_factor * max(section.law.first_stiffness / line.length**2, pull)
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
        diagonal += drag * self._drag + rounding_share * diagonal
        diagonal[self._fixed] = 1.0
        factors, failed = lapack.dpbtrf(
            flat.reshape(self.size, self._deep).T, lower=True, overwrite_ab=True
        )
        return None if failed else np.asarray(factors)


def _without_forces(places: Floats) -> Floats:
    return np.asarray(FORCE * (places // PER_ELEMENT) + places % PER_ELEMENT)
