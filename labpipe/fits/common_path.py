"""Forces of many curves as they would be, had all gone along the displacements of one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats, Ints


@dataclass(frozen=True, slots=True, eq=False)
class CommonPath:
    """The samples that something was decided on, and how steep the curve is there.

    Parameters
    ----------
    samples : shape (k,), which of a curve; None for all as they are
    displacement : shape (k,), m
    slope : shape (k,), N/m
    """

    samples: Ints | None
    displacement: Floats
    slope: Floats

    @classmethod
    def of(cls, displacement: Floats, force: Floats, samples: Ints) -> CommonPath:
        """Slopes of a curve, from a fiftieth of its samples before to as many behind each.

        Parameters
        ----------
        displacement, force : shape (n,), m, N; a stretch of a loading branch in order of time
        samples : shape (k,), those that both are known of, in any order

        Notes
        -----
        Where the displacement does not grow over so many samples, the slope is that from the first
        to the last sample of the stretch.
        """
        # The slope at a sample is taken over one fiftieth of the samples on each side.
        slope_divisor = 50
        in_time = np.argsort(samples)
        d, f = displacement[samples[in_time]], force[samples[in_time]]
        last = len(d) - 1
        rows, reach = np.arange(last + 1), max(1, last // slope_divisor)
        low, high = np.maximum(rows - reach, 0), np.minimum(rows + reach, last)
        way, rise, whole = d[high] - d[low], f[high] - f[low], d[-1] - d[0]
        overall = (f[-1] - f[0]) / whole if whole > 0.0 else 0.0
        slope = np.empty(last + 1)
        slope[in_time] = np.where(way > 0.0, rise / np.where(way > 0.0, way, 1.0), overall)
        is_all = np.array_equal(samples, np.arange(len(force)))
        return cls(None if is_all else samples, displacement[samples], slope)

    def force(self, force: Floats, displacement: Floats | None = None) -> Floats:
        """Forces at the displacements that were decided on.

        Parameters
        ----------
        force : shape (..., n), N, of curves with the samples of the one that was decided on
        displacement : shape (..., n), m; None for the one that was decided on

        Returns
        -------
        f - (df/dd) (d - d_0), shape (..., k), N: to first order, what a curve shows whose samples
        came to lie at other displacements. Where cameras see the displacement, it has noise of its
        own, and so each replicate has displacements of its own; a function that is linear in the
        force over one set of displacements takes all of them then. Second order is left out: that
        noise of the displacement makes a least-squares slope smaller, by its variance over that of
        the displacements.
        """
        on_path = self._taken(force)
        if displacement is None:
            return on_path
        moved = self._taken(displacement) - self.displacement
        return on_path - self.slope * moved if moved.any() else on_path

    def _taken(self, values: Floats) -> Floats:
        if self.samples is None:
            return values
        taken: Floats = np.take(values, self.samples, axis=-1)
        return taken


def known_samples(displacement: Floats, force: Floats) -> Ints:
    """Samples with both quantities, in order of time.

    Parameters
    ----------
    displacement, force : shape (n,), NaN where not known
    """
    return np.flatnonzero(~np.isnan(displacement) & ~np.isnan(force))
