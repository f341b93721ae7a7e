"""A slider whose limit grows: isotropic hardening of copper (PHYSICS 13).

Annealed copper hardens isotropically and kinematically. A share m of the moment of its strands, the
*isotropic share*, has a limit that grows with the curvature that has slid; the other share follows
Masing's rule. First loading is the same for every m, only what follows a reversal changes.

With the moment M of the strands at a curvature of first loading, the slider has the stiffness
S = m EI of the strands, the curvature q = kappa - M / EI that has slid, and the limit L(q) = m M, a
polygon. It sticks while |S (kappa - p)| is at most L(q); else its rest p follows the curvature by
as much as q grows. In three dimensions kappa and p are vectors across the wire (radial return).

The limit does not saturate as that of real copper does: the law holds for about three cycles.
Curvatures are in 1/m, moments in N m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from labpipe.mechanics.law.plays import require, require_positive
from labpipe.records.arrays import ArrayRecord, Floats


@dataclass(frozen=True, slots=True, eq=False)
class GrowingStep:
    """A growing slider after a step.

    Parameters
    ----------
    moment : shape (stations,), or (stations, 2) of vectors, N m
    stiffness : shape (stations,), or (stations, 2, 2), N m^2, derivative of the moment by the
        curvature, consistent with the step
    rest : shape of the moment, 1/m: p
    slid : shape (stations,), 1/m: q
    """

    moment: Floats
    stiffness: Floats
    rest: Floats
    slid: Floats


@dataclass(frozen=True, slots=True, eq=False)
class GrowingSlider(ArrayRecord):
    """A slider whose limit grows with the curvature that has slid.

    Parameters
    ----------
    stiffness : S while it sticks, N m^2
    slid : shape (corners,), q, 1/m, from 0, increasing
    limits : shape (corners,), L(q), N m, positive, not decreasing; the last slope continues

    Raises
    ------
    ValueError
        If a number is out of its range.
    """

    stiffness: float
    slid: Annotated[Floats, "corners"]
    limits: Annotated[Floats, "corners"]

    def __post_init__(self) -> None:
        ArrayRecord.__post_init__(self)
        require_positive("stiffness", self.stiffness)
        rises = len(self.slid) >= 2 and self.slid[0] == 0.0 and np.all(np.diff(self.slid) > 0.0)
        require("slid", self.slid.tolist(), "from zero and increasing", holds=bool(rises))
        grows = self.limits[0] > 0.0 and bool(np.all(np.diff(self.limits) >= 0.0))
        require("limits", self.limits.tolist(), "positive and not decreasing", holds=grows)

    def scaled(self, factor: float) -> GrowingSlider:
        """Return the slider with moments multiplied by a positive factor."""
        return GrowingSlider(factor * self.stiffness, self.slid, factor * self.limits)

    def limit_after(self, slid: Floats) -> Floats:
        """Return the limit after a curvature has slid, N m.

        Parameters
        ----------
        slid : any shape, 1/m, not negative
        """
        return _interpolate(self.slid, self.limits, slid)[0]

    def first_loading(self, curvature: Floats) -> Floats:
        """Return the moment of first loading, N m.

        Parameters
        ----------
        curvature : any shape, 1/m, not negative
        """
        moment = self.stiffness * curvature
        sums = self.limits + self.stiffness * self.slid
        slid = np.maximum(_interpolate(sums, self.slid, moment)[0], 0.0)
        return np.asarray(moment - self.stiffness * slid)

    def slide(self, curvature: Floats, rest: Floats, slid: Floats) -> GrowingStep:
        """Compute the step to new curvatures in one plane.

        Parameters
        ----------
        curvature, rest, slid : shape (stations,), 1/m: kappa, p and q
        """
        trial = self.stiffness * (curvature - rest)
        grown, tangent = self._grow(np.abs(trial), slid)
        rest = rest + np.copysign(grown, trial)
        return GrowingStep(self.stiffness * (curvature - rest), tangent, rest, slid + grown)

    def slide_vector(self, curvature: Floats, rest: Floats, slid: Floats) -> GrowingStep:
        """Compute the step to new curvature vectors, each along a straight line.

        Parameters
        ----------
        curvature, rest : shape (stations, 2), 1/m: kappa and p
        slid : shape (stations,), 1/m: q
        """
        trial = self.stiffness * (curvature - rest)
        size = np.sqrt(np.vecdot(trial, trial))
        grown, tangent = self._grow(size, slid)
        safe = np.where(size > 0.0, size, 1.0)
        along = trial / safe[:, None]
        across = self.stiffness * (1.0 - self.stiffness * grown / safe)
        derivative = across[:, None, None] * np.eye(2)
        derivative += (tangent - across)[:, None, None] * along[:, :, None] * along[:, None, :]
        rest = rest + grown[:, None] * along
        return GrowingStep(self.stiffness * (curvature - rest), derivative, rest, slid + grown)

    def _grow(self, size: Floats, slid: Floats) -> tuple[Floats, Floats]:
        """Return how far q grows under a trial moment, and the stiffness along it."""
        limit, _ = _interpolate(self.slid, self.limits, slid)
        sums = self.limits + self.stiffness * self.slid
        after, slope = _interpolate(sums, self.slid, size + self.stiffness * slid)
        is_sliding = size > limit
        # With L = g - S q, dM = S (1 - S dq/dg) d(kappa).
        tangent = self.stiffness * np.where(is_sliding, 1.0 - self.stiffness * slope, 1.0)
        return np.where(is_sliding, after - slid, 0.0), tangent


def grow_from(curvature: Floats, moment: Floats, share: float) -> GrowingSlider:
    """Make the growing slider of the isotropic share of the strands' first loading.

    Parameters
    ----------
    curvature, moment : shape (n,), 1/m and N m, positive, of the strands about their own axes
    share : m, above 0 and at most 1

    Raises
    ------
    ValueError
        If the share or the curve is out of its range.
    """
    require("share", share, "above 0 and at most 1", holds=0.0 < share <= 1.0)
    stiffness = float(moment[0] / curvature[0])
    slid = np.maximum.accumulate(np.append(0.0, (curvature - moment / stiffness)[1:]))
    rises = np.diff(slid, prepend=-1.0) > 1e-12 * slid[-1]
    limits = share * np.maximum.accumulate(moment)
    return GrowingSlider(share * stiffness, slid[rises], limits[rises])


def _interpolate(x: Floats, y: Floats, at: Floats) -> tuple[Floats, Floats]:
    """Return values and slopes of a polygon, which continues with its last slope."""
    part = np.minimum(np.maximum(x.searchsorted(at, side="right") - 1, 0), len(x) - 2)
    first, slope = x[part], (y[part + 1] - y[part]) / (x[part + 1] - x[part])
    return y[part] + slope * (at - first), slope
