"""First loading as curvature over moment, continued from a rest by Masing's rule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from labpipe.mechanics.law.plays import MomentLaw, corners_of
from labpipe.records.arrays import Floats

CurvatureAndSlope: TypeAlias = tuple[Floats, Floats]
"""Curvature, 1/m, and its slope by the moment, 1/(N m^2)."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadingTable:
    """Curvature against moment, cubic between knots (Hermite), straight beyond the last.

    Parameters
    ----------
    moment : shape (knots,), N m, from zero, increasing
    curvature : shape (knots,), 1/m
    first, last : shape (knots - 1,), 1/(N m^2), slope of the curvature at the beginning and at the
        end of each panel: a law may have corners
    first_change, last_change : shape (parameters, knots - 1), 1/m, derivative of the curvature at
        constant moment by each parameter, at the beginning and at the end of each panel
    """

    moment: Floats
    curvature: Floats
    first: Floats
    last: Floats
    first_change: Floats
    last_change: Floats

    @classmethod
    def of_plays(cls, law: MomentLaw) -> LoadingTable:
        """Return the table of a law of plays, which is linear between its corners."""
        last_step_factor = 1.0
        moment, curvature, slopes = corners_of(law)
        step = last_step_factor * (moment[-1] or law.stiffness)
        moment = np.append(moment, moment[-1] + step)
        curvature = np.append(curvature, curvature[-1] + slopes[-1] * step)
        none = np.zeros((0, len(slopes)))
        return cls(moment, curvature, slopes, slopes, none, none)

    def bend(self, moment: Floats) -> CurvatureAndSlope:
        """Bend a wire that was never bent to moments of any shape and sign, N m."""
        size = np.abs(moment)
        place = self._panel(size)
        width = (self.moment[1:] - self.moment[:-1])[place]
        u = (size - self.moment[place]) / width
        inside = np.minimum(u, 1.0)
        first, last = self.first[place], self.last[place]
        chord = (self.curvature[1:] - self.curvature[:-1])[place] / width
        quadratic, lean = first + last - 2.0 * chord, 3.0 * chord - 2.0 * first - last
        rise = ((quadratic * inside + lean) * inside + first) * inside + last * (u - inside)
        slope = (3.0 * quadratic * inside + 2.0 * lean) * inside + first
        return np.sign(moment) * (self.curvature[place] + width * rise), slope

    def bend_on(self, rest: Floats, moment: Floats) -> CurvatureAndSlope:
        """Bend from a rest that was reached by first loading.

        Parameters
        ----------
        rest : shape (stations,), N m
        moment : shape (n, stations), N m; each is reached monotonically

        Notes
        -----
        Masing's rule: after a reversal at M0 the law is doubled, kappa0 + 2 k((M - M0) / 2), until
        the wire is bent as far the other way.
        """
        curvature, slope = self.bend(moment)
        reverses = self._reverses(rest, moment)
        if reverses.any():
            half_change = 0.5 * (moment - rest)[reverses]
            bent, rise = self.bend(half_change)
            before = np.broadcast_to(self.bend(rest)[0], moment.shape)[reverses]
            curvature[reverses], slope[reverses] = before + 2.0 * bent, rise
        return curvature, slope

    def changes(self, moment: Floats) -> Floats:
        """Return the derivatives of the curvature, shape (parameters, *moment's)."""
        size = np.minimum(np.abs(moment), self.moment[-1])
        place = self._panel(size)
        u = (size - self.moment[place]) / (self.moment[1:] - self.moment[:-1])[place]
        changes = (1.0 - u) * self.first_change[:, place] + u * self.last_change[:, place]
        return np.asarray(np.sign(moment) * changes, dtype=np.float64)

    def changes_on(self, rest: Floats, moment: Floats, rest_change: Floats) -> Floats:
        """Return the derivatives of the curvature of `bend_on`, shape (parameters, n, stations).

        Parameters
        ----------
        rest, moment : as for `bend_on`
        rest_change : shape (parameters, stations), N m, derivative of the rest
        """
        changes = self.changes(moment)
        reverses = self._reverses(rest, moment)
        if reverses.any():
            half_change = 0.5 * (moment - rest)
            slack = self.bend(rest)[1] - self.bend(half_change)[1]
            back = self.changes(rest)[:, None, :] + 2.0 * self.changes(half_change)
            back = back + slack * rest_change[:, None, :]
            changes = np.where(reverses, back, changes)
        return changes

    def _panel(self, size: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
        return np.minimum(np.searchsorted(self.moment[1:], size, side="right"), len(self.first) - 1)

    @staticmethod
    def _reverses(rest: Floats, moment: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        change = moment - rest
        turned: np.ndarray[tuple[int, ...], np.dtype[np.bool_]] = (change * rest < 0.0) & (
            np.abs(change) < 2.0 * np.abs(rest)
        )
        return turned
