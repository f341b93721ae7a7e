"""Zero drift: a random walk by its first modes."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Floats

MODES = 3
"""They contain 93 % of the variance of a random walk."""


def drift_modes(times: Floats, by: float) -> list[Floats]:
    """Return the modes of a zero drift, each for its own standard normal draw.

    The modes of a Wiener process on [0, 1] are sqrt(2) sin((k - 1/2) pi t) / ((k - 1/2) pi)
    (Karhunen-Loeve; M. Loeve, Probability Theory II, 4th ed., 1978). They are scaled so that the
    variance at the end is the stated one.

    Parameters
    ----------
    times : shape (n,), s, time from where the zero was taken; at least one is not zero
    by : standard uncertainty of the zero at the largest time, in any unit

    Returns
    -------
    `MODES` of shape (n,), in the unit of `by`; none for a zero without drift.
    """
    if not by:
        return []
    places = np.pi * (np.arange(MODES) + 0.5)
    scale = by / float(np.sqrt(np.sum(places**-2.0)))
    return [np.sin(place * times / times.max()) * scale / place for place in places.tolist()]
