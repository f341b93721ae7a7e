"""First loading of a clamped wire without weight, by its first integral (PHYSICS 5).

The force F = (Px, Py) at the tip turns the tangent t from the clamp on: with the complementary
energy W*(M), the integral of kappa dM, F.t = q(M) = W*(M0) - W*(M) + Px while no part unloads, M0
the moment at the clamp. So the shape follows from integrals over the moment from tip to clamp,

    length = integral of dM / R,    F.r = integral of q dM / R,    R = -dM/ds = sqrt(F.F - q^2),

with r the position of the tip, and M0 = F x r.
"""

from __future__ import annotations

import numpy as np

from labpipe.mechanics.law.plays import LoadingTable
from labpipe.mechanics.wire.cantilever import AtDeflection
from labpipe.records.arrays import Floats

MIN_PANELS = 40
"""Of the moment, besides those of the law: loads are within 1e-8 of the exact ones."""


def integrate(table: LoadingTable, moment: Floats, force: Floats) -> tuple[Floats, Floats]:
    """Integrate over the moments of wires from tip to clamp, by Gauss's rule.

    Parameters
    ----------
    table : law of first loading
    moment : shape (n,), N m, at the clamp, positive
    force : shape (n, 2), N, at the tip

    Returns
    -------
    Length and position x, y of the tip, m, shape (n, 3), and their derivatives by the moment, by Px
    and Py, and by each of the law's parameters, shape (n, 3, 3 + parameters).
    """
    min_square = 1e-6  # of F.F, where the wire would turn back before its tip
    roots = (0.5 - np.sqrt(1.0 / 12.0), 0.5 + np.sqrt(1.0 / 12.0))
    even = moment.max() * np.linspace(0.0, 1.0, MIN_PANELS + 1)
    edges = np.union1d(even, table.moment[table.moment < moment.max()])
    widths, last = np.diff(edges), edges[np.searchsorted(edges, moment) - 1]
    below, partial_width = np.where(edges[1:] <= last[:, None], widths, 0.0), moment - last
    weights = 0.5 * np.column_stack([below, below, partial_width, partial_width])
    whole = table.energy((edges[:-1] + np.outer(roots, widths)).ravel())
    part = table.energy((last + np.outer(roots, partial_width)).T)
    clamp, curvature = table.energy(moment), table.curve(moment)[:, 0]
    (px, py), square = force.T, np.sum(force**2, axis=1)
    energy = np.hstack([np.tile(whole[:, 0], (len(moment), 1)), part[:, :, 0]])
    q = (clamp[:, 0] + px)[:, None] - energy
    rate = np.maximum(square[:, None] - q**2, min_square * square[:, None])
    plain = weights / np.sqrt(rate)
    cube = plain / rate
    cube_q = cube * q
    length, along, i3, j3 = (np.sum(part, axis=1) for part in (plain, plain * q, cube, cube_q))

    def sum_rises(kernel: Floats, total: Floats) -> Floats:
        """Sum the changes of W*(M0) - W*(M) by the parameters."""
        inside = kernel[:, :-2] @ whole[:, 1:]
        inside += np.einsum("nk,nkp->np", kernel[:, -2:], part[:, :, 1:])
        return np.asarray((clamp[:, 1:] * total[:, None] - inside).T)

    by_length = [curvature * j3 + 1.0 / py, j3 - px * i3, -py * i3, *sum_rises(cube_q, j3)]
    by_along = [square * curvature * i3 + px / py, square * i3 - px * j3, -py * j3]
    by_along += list(square * sum_rises(cube, i3))
    tip = (moment * np.array([py, -px]) + along * force.T) / square
    by_tip = force.T[:, None] * np.array(by_along)
    by_tip[:, :3] += np.array([[py, along, moment], [-px, -moment, along]])
    by_tip[:, 1:3] -= 2.0 * tip[:, None] * force.T
    derivatives = np.array([by_length, *(by_tip / square)])
    return np.array([length, *tip]).T, np.moveaxis(derivatives, 2, 0)


def solve_weightless(
    table: LoadingTable, length: float, at: AtDeflection, start: Floats
) -> tuple[Floats, Floats] | None:
    """Find equilibria at deflections by Newton's method.

    Parameters
    ----------
    table : law of first loading
    length : m
    at : the n deflections
    start : shape (3, n), moment at the clamp, N m, x of the tip, m, and load of `at`, N

    Returns
    -------
    The same of the equilibria, and the derivatives of their loads by the deflection and by each of
    the law's parameters, shape (1 + parameters, n). None if there is no convergence.
    """
    max_iterations = 40
    tolerance = 1e-4  # last change, as a share; the next would be 1e-9
    max_change = 0.5  # of the logarithms in one step
    max_turn = 0.999  # sine of the angle by which the force turns the wire
    state, rows = np.array(start.T), np.arange(len(at.deflection))
    for _ in range(max_iterations):
        moment, x, load = state.T
        tip = np.column_stack([x, at.deflection])
        force = at.demand(tip, load, rows).force
        turning = table.energy(moment)[:, 0] + force[:, 0]
        lacking = np.maximum(turning / max_turn - np.linalg.norm(force, axis=1), 0.0)
        load += 2.0 * lacking
        demand = at.demand(tip, load, rows)
        values, changes = integrate(table, moment, demand.force)
        by_state = np.zeros((len(rows), 3, 3))  # of moment and force, by moment, x and load
        by_state[:, 0, 0] = 1.0
        by_state[:, 1:, 2] = demand.force_by_load
        if demand.force_by_tip is not None:
            by_state[:, 1:, 1] = demand.force_by_tip[:, :, 0]
        matrix = changes[:, :, :3] @ by_state
        matrix[:, 1, 1] -= 1.0
        causes = changes[:, :, 1:]
        causes[:, :, 0] = values - np.column_stack([np.full_like(x, length), tip])
        causes[:, :, 1] = 0.0, 0.0, -1.0
        if not np.isfinite(causes).all():
            return None
        steps = -np.linalg.solve(matrix, causes)
        change = steps[:, :, 0] / state
        state *= np.exp(np.clip(change, -max_change, max_change))
        if np.max(np.abs(change)) <= tolerance and not lacking.any():
            return state.T, np.asarray(steps[:, 2, 1:].T, dtype=np.float64)
    return None
