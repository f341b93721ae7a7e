"""A law of two stiffnesses for tests."""

from __future__ import annotations

import numpy as np

from labpipe.mechanics.law.plays import PlayLaw


def bilinear_law(stiffness: float, second_stiffness: float, break_moment: float) -> PlayLaw:
    """Two stiffnesses, N m^2, on first loading; a single play, so it unloads with the first one."""
    more = 1.0 / second_stiffness - 1.0 / stiffness
    return PlayLaw(stiffness, np.array([break_moment]), np.array([more]))
