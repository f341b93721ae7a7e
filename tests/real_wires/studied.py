"""All that is computed of a real wire."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labpipe.records.arrays import Floats
from tests.builders.real_wires import RealWire, by_elastica, mean_hang
from tests.judges.rod_fits import Estimate, Hang, HangFit, fit_hang, fit_torsion, mean_of, snap_turn


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """A wire, its photographs and what they give.

    Parameters
    ----------
    wire : what is known of it
    hangs : as photographed
    fits : of the rod, with one term of free curvature
    straight : the same without free curvature
    more : with two terms of it, of an elastica that cannot leave its plane
    by_elastica : with one term, of the elastica that shares nothing with the rod
    stiffness : of bending, N m^2
    torsion, torsion_straight : torsional stiffness as a share of it, with the slope of the free
        curvature, and of a wire that is straight when it is free
    snapping : points of the last stable loop, straight when free, shape (points, 3), m
    """

    wire: RealWire
    hangs: list[Hang]
    fits: list[HangFit]
    straight: list[HangFit]
    more: list[HangFit]
    by_elastica: list[HangFit]
    stiffness: Estimate
    torsion: Estimate
    torsion_straight: Estimate
    snapping: Floats

    @property
    def stiffnesses(self) -> tuple[float, float]:
        """Of bending and torsion, N m^2."""
        return self.stiffness.value, self.torsion.value * self.stiffness.value

    @property
    def slope(self) -> Estimate:
        """Free curvature at the end less that in the middle, 1/m."""
        return mean_of([each.natural[0] for each in self.fits])


def study(wire: RealWire, folder: Path) -> Study:
    """Compute all of a wire."""
    hangs = wire.hangs(folder)
    fits = [fit_hang(each) for each in hangs]
    stiffness, middle = wire.stiffness_of(hangs, fits), mean_hang(hangs)
    turns = np.radians(wire.snaps)
    slope = mean_of([each.natural[0] for each in fits])
    straight = fit_torsion(middle, turns, stiffness)
    _, snapping = snap_turn(middle, stiffness.value, straight.value * stiffness.value)
    return Study(
        wire,
        hangs,
        fits,
        straight=[fit_hang(each, terms=0, blocks=0) for each in hangs],
        more=[fit_hang(each, terms=2, blocks=0, hanging=by_elastica) for each in hangs],
        by_elastica=[fit_hang(each, blocks=0, hanging=by_elastica) for each in hangs],
        stiffness=stiffness,
        torsion=fit_torsion(middle, turns, stiffness, [slope]),
        torsion_straight=straight,
        snapping=snapping,
    )
