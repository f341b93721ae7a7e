"""Stability of an equilibrium, and its softest mode.

An equilibrium under held nodes and dead loads is stable if the second variation of the energy is
positive for all changes that satisfy the stretch conditions. An equivalent condition is that the
tangent without their multipliers, but with a stiff penalty on these conditions, is positive
definite, which a banded Cholesky factorisation decides. The penalty is 1e6 times the stiffness of
the whole line. Modes softer than 3e-4 of that stiffness count as neutral; the error of critical
loads is then about 1e-4. Sliders that slid in the step count as sliding on in the same direction.

Moments of constant direction have no potential (Ziegler, Principles of structural stability, 1968),
so that the tangent is unsymmetric. If its symmetric part is positive definite, the line is stable.
Otherwise overdamped motion decides: the line is stable if no eigenvalue of the tangent with respect
to the drag has a negative real part. With a real negative eigenvalue the line diverges; the load at
which it is zero, where another equilibrium branches off, does not depend on the drag. With a
complex pair the line whirls, and this depends on the drag. Flutter by inertia is not checked. Of
sliding friction, only the symmetric part counts.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack
from scipy.sparse.linalg import ArpackError, LinearOperator, eigs

from labpipe.mechanics.rod.assembly import Assembly, Balance, Shape
from labpipe.mechanics.rod.banded import FORCE, PER_ELEMENT, STRETCH, TURN, list_block_entries
from labpipe.records.arrays import Floats

_SHIFT_DRAG = 10.0
"""Eigenvalues are searched around minus this number, near the unstable ones."""


class StabilityCheck:
    """Stability checks of a line with given supports; constant parts are computed once.

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
            list_block_entries(
                assembly.places.positions[:-1], FORCE, assembly.places.positions[:-1], FORCE
            ),
            list_block_entries(
                assembly.places.positions[:-1], FORCE, assembly.places.positions[1:], 3
            ),
            list_block_entries(assembly.places.positions[1:], 3, assembly.places.positions[1:], 3),
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
        # off-diagonal entries come twice, except in the block between nodes
        count = np.ones(len(row))
        count[: len(self._kept)] = np.where(row == column, 1.0, 0.5)[: len(self._kept)]
        element_block = slice(len(self._kept), len(self._kept) + n * FORCE * FORCE)
        count[element_block] = np.where(row == column, 1.0, 0.5)[element_block]
        last = slice(len(row) - 9 * n, len(row))
        count[last] = np.where(row == column, 1.0, 0.5)[last]
        self._weights = count * scale[row] * scale[column] * ~(fixed[row] | fixed[column])
        self._scale, self._fixed = scale, fixed
        self._drag = assembly.drag[free] * scale**2
        self._mass = self._drag * (np.arange(self.size) % FORCE < STRETCH)

    def is_stable(self, balance: Balance, shape: Shape) -> bool:
        """Return whether the overdamped line returns from every small perturbation."""
        neutral_share = 3e-4  # of the line's own stiffness: a softer mode counts as neutral
        if self._factors(balance, shape, neutral_share) is not None:
            return True
        return self._is_turned and self.slowest_return(balance)[0].real > -neutral_share

    def whirls(self, balance: Balance) -> bool:
        """Return whether an unstable line whirls rather than diverges."""
        rate = self.slowest_return(balance)[0] if self._is_turned else complex(-np.inf)
        return rate.real < 0.0 and abs(rate.imag) > abs(rate.real)

    def slowest_return(self, balance: Balance) -> tuple[complex, Floats]:
        """Find the perturbation that decays most slowly or grows, and its rate of decay.

        Parameters
        ----------
        balance : of the shape

        Returns
        -------
        Rate and perturbation. The rate has a negative real part for a growing perturbation, and is
        minus infinity if none was found. It is 1 for a drag of 1 and the stiffness of the line.

        Notes
        -----
        Rates r solve K x = r D x with the tangent K and the drag D. Arnoldi's method finds those
        nearest to a negative number, where the growing ones are.
        """
        n_eigenvalues = 8
        band, drag = self._assembly.band, self._assembly.drag
        moving = np.flatnonzero((drag > 0.0) & ~band.fixed)
        root = np.sqrt(drag[moving])
        change = np.zeros(len(drag))
        factors = band.factorise(self._shifted_tangent(balance))
        if factors is None:
            return complex(-np.inf), change

        def answer(push: Floats) -> Floats:
            right = np.zeros(len(drag))
            right[moving] = root * np.ravel(push)
            eigenvalues = band.solve_factored(factors, right)
            return (
                np.full(len(moving), np.nan) if eigenvalues is None else root * eigenvalues[moving]
            )

        inverse = LinearOperator((len(moving), len(moving)), matvec=answer, dtype=np.float64)
        first = np.cos(1.0 + 2.4 * np.arange(len(moving)))
        try:
            eigenvalues, vectors = eigs(inverse, k=min(n_eigenvalues, len(moving) - 2), v0=first)
        except ArpackError:
            return complex(-np.inf), change
        rates = 1.0 / eigenvalues - _SHIFT_DRAG
        slowest = int(np.argmin(rates.real))
        change[moving] = np.real(vectors[:, slowest]) / root
        return complex(rates[slowest]), change

    def _shifted_tangent(self, balance: Balance) -> Floats:
        """Return the entries of the tangent with a drag of `_SHIFT_DRAG`."""
        rows, columns = self._assembly.pattern
        places, first = np.unique(np.where(rows == columns, rows, -1), return_index=True)
        values = balance.symmetric_values.copy()
        values[first[1:]] += _SHIFT_DRAG * self._assembly.drag[places[1:]]
        return values

    def lowest_mode(self, balance: Balance, shape: Shape, push: Floats) -> Floats | None:
        """Find the softest mode; None if none is found.

        Parameters
        ----------
        balance, shape : of the line
        push : shape (unknowns,), N and N m, load that selects among equally soft modes

        Notes
        -----
        Inverse iteration. The mass is the drag of the nodes, which excludes pure twist. A small
        asymmetric load is added to the push.
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
        random_mode = np.cos(1.0 + 2.4 * np.arange(self.size)) * is_across
        random_mode /= np.sqrt(np.sum(random_mode**2))
        pushed = push[self._free] * self._scale * ~self._fixed
        size = float(np.sqrt(np.sum(pushed**2)))
        mode = random_mode * ~self._fixed
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
                balance.symmetric_values[self._kept],
                stiffness[:, :FORCE, :FORCE].ravel(),
                stiffness[:, :FORCE, FORCE:].ravel(),
                stiffness[:, FORCE:, FORCE:].ravel(),
            ]
        )
        weighted = values * self._weights
        flat = np.bincount(self._at, weighted, minlength=self._deep * self.size)
        diagonal = flat[:: self._deep]
        diagonal += drag * self._drag + rounding_share * diagonal
        diagonal[self._fixed] = 1.0
        factors, failed = lapack.dpbtrf(
            flat.reshape(self.size, self._deep).T, lower=True, overwrite_ab=True
        )
        return None if failed else np.asarray(factors)


def _without_forces(places: Floats) -> Floats:
    return np.asarray(FORCE * (places // PER_ELEMENT) + places % PER_ELEMENT)
