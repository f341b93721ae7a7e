"""Forces of many curves as they would be, had all gone along the displacements of one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats, Ints

_SHARE = 50
"""Of the samples, how far before and behind a sample its slope is read."""


@dataclass(frozen=True, slots=True, eq=False)
class OnePath:
    """The displacements that something was decided on, and how steep the curve is there.

    Parameters
    ----------
    displacement : shape (n,), m
    slope : shape (n,), N/m
    """

    displacement: Floats
    slope: Floats

    @classmethod
    def of(cls, displacement: Floats, force: Floats) -> OnePath:
        """Slopes of a curve, from a fiftieth of its samples before to as many behind each.

        Parameters
        ----------
        displacement, force : shape (n,), m, N; a stretch of a loading branch in order of time, the
            last displacement above the first, without NaN

        Notes
        -----
        Where the displacement does not grow over so many samples, the slope is that from the first
        to the last sample of the stretch.
        """
        last = len(displacement) - 1
        each, reach = np.arange(last + 1), max(1, last // _SHARE)
        low, high = np.maximum(each - reach, 0), np.minimum(each + reach, last)
        way, rise = displacement[high] - displacement[low], force[high] - force[low]
        overall = (force[-1] - force[0]) / (displacement[-1] - displacement[0])
        grows = way > 0.0
        slope = np.where(grows, rise / np.where(grows, way, 1.0), overall)
        return cls(displacement, slope)

    def take(self, samples: Ints) -> OnePath:
        """The same of some samples, in their order."""
        return OnePath(self.displacement[samples], self.slope[samples])

    def force(self, force: Floats, displacement: Floats) -> Floats:
        """Forces at the displacements that were decided on.

        Parameters
        ----------
        force, displacement : shape (..., n), N, m, of curves with these samples

        Returns
        -------
        f - (df/dd) (d - d_0), shape (..., n), N: to first order, what a curve shows whose samples
        came to lie at other displacements. Where cameras see the displacement, it has noise of its
        own, and so each replicate has displacements of its own; a function that is linear in the
        force over one set of displacements takes all of them then. Second-order is left out: that
        noise of the displacement makes a least-squares slope smaller, by its variance over that of
        the displacements.
        """
        moved = displacement - self.displacement
        return force - self.slope * moved if moved.any() else force
