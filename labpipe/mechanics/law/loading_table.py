"""First loading as curvature over moment, continued from a rest by Masing's rule."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from scipy.interpolate import PPoly

from labpipe.mechanics.law.plays import PlayLaw, find_corners
from labpipe.records.arrays import Floats

CurvatureAndSlope: TypeAlias = tuple[Floats, Floats]
"""Curvature, 1/m, and its slope by the moment, 1/(N m^2)."""


@dataclass(frozen=True, eq=False)
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
    def of_plays(cls, law: PlayLaw) -> LoadingTable:
        """Return the table of a law of plays, which is linear between its corners."""
        last_step_factor = 1.0
        moment, curvature, slopes = find_corners(law)
        step = last_step_factor * (moment[-1] or law.stiffness)
        moment = np.append(moment, moment[-1] + step)
        curvature = np.append(curvature, curvature[-1] + slopes[-1] * step)
        none = np.zeros((0, len(slopes)))
        return cls(moment, curvature, slopes, slopes, none, none)

    @cached_property
    def curve(self) -> PPoly:
        """Return the curvature, and its derivatives by the parameters, over the moment's size."""
        width = np.diff(self.moment)
        chord = np.diff(self.curvature) / width
        cubic = (self.first + self.last - 2.0 * chord) / width**2
        square = (3.0 * chord - 2.0 * self.first - self.last) / width
        panels = np.zeros((4, len(width) + 1, 1 + len(self.first_change)))
        panels[:, :-1, 0] = cubic, square, self.first, self.curvature[:-1]
        panels[2:, -1, 0] = self.last[-1], self.curvature[-1]  # beyond the last knot
        panels[2, :-1, 1:] = ((self.last_change - self.first_change) / width).T
        panels[3, :-1, 1:] = self.first_change.T
        panels[3, -1, 1:] = self.last_change[:, -1]
        return PPoly(panels, np.append(self.moment, 2.0 * self.moment[-1]))

    @cached_property
    def energy(self) -> PPoly:
        """Return the integral of `curve`: the complementary energy per length, N."""
        return self.curve.antiderivative()

    def bend(self, moment: Floats) -> CurvatureAndSlope:
        """Bend a wire that was never bent to moments of any shape and sign, N m."""
        size = np.abs(moment)
        return np.sign(moment) * self.curve(size)[..., 0], self.curve(size, 1)[..., 0]

    def changes(self, moment: Floats) -> Floats:
        """Return the derivatives of the curvature, shape (parameters, *moment's)."""
        changes = np.moveaxis(self.curve(np.abs(moment))[..., 1:], -1, 0)
        return np.asarray(np.sign(moment) * changes, dtype=np.float64)

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
            half_curvature_change, rise = self.bend(half_change)
            before = np.broadcast_to(self.bend(rest)[0], moment.shape)[reverses]
            curvature[reverses], slope[reverses] = before + 2.0 * half_curvature_change, rise
        return curvature, slope

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

    @staticmethod
    def _reverses(rest: Floats, moment: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        change = moment - rest
        turned: np.ndarray[tuple[int, ...], np.dtype[np.bool_]] = (change * rest < 0.0) & (
            np.abs(change) < 2.0 * np.abs(rest)
        )
        return turned
