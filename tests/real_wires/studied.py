"""All that is computed of a real wire."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labpipe.records.arrays import Floats
from tests.builders.hung_wires import GRAVITY, HungElastica
from tests.builders.real_wires import (
    LENGTH,
    HangFit,
    Interval,
    RealWire,
    fit_hang,
    scatter_of,
    snap_line,
    stiffness_of,
    torsion_of,
)
from tests.builders.twisted_loops import TwistedLoop

_PIECES = 90
"""Of the loop that is drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """A wire, its photographs and what they give.

    Parameters
    ----------
    wire : what is known of it
    hangs : shape (hangs, points, 2), m
    fits : with one term of free curvature
    straight, more : the same without free curvature, and with two terms of it
    stiffness, torsion : bending stiffness, and torsional stiffness as a share of it
    snapping : points of the last stable loop, shape (points, 3), m
    """

    wire: RealWire
    hangs: Floats
    fits: list[HangFit]
    straight: list[HangFit]
    more: list[HangFit]
    stiffness: Interval
    torsion: Interval
    snapping: Floats

    @property
    def slope(self) -> Interval:
        """Free curvature at the end less that in the middle, 1/m."""
        return scatter_of(np.array([each.natural[0] for each in self.fits]))


def study(wire: RealWire, folder: Path) -> Study:
    """Compute all of a wire."""
    hangs = wire.hangs(folder)
    fits = [fit_hang(wire, each, 1, has_blocks=True) for each in hangs]
    straight = [fit_hang(wire, each, 0) for each in hangs]
    more = [fit_hang(wire, each, 2) for each in hangs]
    stiffness = stiffness_of(wire, hangs, fits)
    middle = hangs.mean(axis=0)
    torsion = torsion_of(wire, snap_line(wire, middle, stiffness.value), stiffness)
    chord = (float(middle[-1, 0]), float(middle[-1, 1]))
    hung = HungElastica(LENGTH, wire.mass * GRAVITY, stiffness.value, chord, pieces=_PIECES)
    _, snapping = TwistedLoop(hung, torsion.value * stiffness.value).snap()
    return Study(wire, hangs, fits, straight, more, stiffness, torsion, snapping)
