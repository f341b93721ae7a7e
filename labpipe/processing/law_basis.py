"""Monotone moment-curvature laws: odd in the moment, of a slope that is given at knots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats

_CROWDING = 1.6


@dataclass(frozen=True, slots=True, eq=False)
class LawBasis:
    """Laws whose slope d kappa / d M is linear between knots, and constant beyond the last.

    Parameters
    ----------
    knots : shape (knots,), N m, from 0 up
    """

    knots: Floats

    def slopes(self, moment: Floats) -> Floats:
        """Slope of the law per unit of compliance at each knot; shape (*moment, knots)."""
        size = np.clip(np.abs(moment), 0.0, self.knots[-1])
        place = np.clip(np.searchsorted(self.knots, size, side="right") - 1, 0, self._last)
        share = (size - self.knots[place]) / np.diff(self.knots)[place]
        slopes = np.zeros((*np.shape(size), len(self.knots)))
        np.put_along_axis(slopes, place[..., None], (1.0 - share)[..., None], axis=-1)
        np.put_along_axis(slopes, place[..., None] + 1, share[..., None], axis=-1)
        return slopes

    def values(self, moment: Floats) -> Floats:
        """Curvature per unit of compliance at each knot, odd in the moment; (*moment, knots)."""
        widths, size = np.diff(self.knots), np.abs(moment)
        inside = np.clip(np.clip(size, 0.0, self.knots[-1])[..., None] - self.knots[:-1], 0, widths)
        rising = inside**2 / (2.0 * widths)
        values = np.zeros((*np.shape(size), len(self.knots)))
        values[..., :-1] += inside - rising
        values[..., 1:] += rising
        values[..., -1] += np.maximum(size - self.knots[-1], 0.0)
        return np.asarray(np.sign(moment)[..., None] * values, dtype=np.float64)

    @property
    def _last(self) -> int:
        return len(self.knots) - 2


def law_knots(largest: float, count: int) -> LawBasis:
    """Choose knots: closer towards zero, where every frame has some of its wire.

    Parameters
    ----------
    largest : N m, the largest moment
    count : of knots, at least 2
    """
    return LawBasis(largest * (np.arange(count) / (count - 1)) ** _CROWDING)
