"""Stress-strain curves of strands: Ramberg-Osgood, a table, elastic-perfectly-plastic, elastic.

Every curve is odd (PHYSICS 4: the same in tension and compression), starts with its modulus and
states its source. Strains are dimensionless, stresses in Pa. A curve is not extrapolated beyond
its last strain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from labpipe.law.plays import require_positive
from labpipe.records.arrays import Floats


class Material(Protocol):
    """A stress-strain curve; hashable, so that results can be cached."""

    @property
    def modulus(self) -> float:
        """Return the slope at zero strain, Pa."""

    @property
    def largest_strain(self) -> float:
        """Return the strain up to which the curve is known."""

    @property
    def source(self) -> str:
        """Return where the numbers come from."""

    def stress(self, strain: Floats) -> Floats:
        """Return the stress of the first loading at strains of any shape, Pa."""

    def __hash__(self) -> int:
        """Return the hash, which is the same for equal curves."""


@dataclass(frozen=True, slots=True)
class Elastic:
    """Hooke's law without limit.

    Parameters
    ----------
    modulus : Pa
    source : where the number comes from
    """

    modulus: float
    source: str = ""

    def __post_init__(self) -> None:
        require_positive("modulus", self.modulus)

    @property
    def largest_strain(self) -> float:
        """Return infinity."""
        return np.inf

    def stress(self, strain: Floats) -> Floats:
        """Return E times strain, Pa; NaN stays NaN."""
        return self.modulus * strain


@dataclass(frozen=True, slots=True)
class ElasticPerfectlyPlastic:
    """Hooke's law up to the yield stress, constant beyond.

    Parameters
    ----------
    modulus, yield_stress : Pa
    source : where the numbers come from
    """

    modulus: float
    yield_stress: float
    source: str = ""

    def __post_init__(self) -> None:
        require_positive("modulus", self.modulus)
        require_positive("yield_stress", self.yield_stress)

    @property
    def largest_strain(self) -> float:
        """Return infinity."""
        return np.inf

    def stress(self, strain: Floats) -> Floats:
        """Return E times strain, limited to the yield stress, Pa; NaN stays NaN."""
        return np.clip(self.modulus * strain, -self.yield_stress, self.yield_stress)

    @property
    def corners(self) -> tuple[Floats, Floats]:
        """Return the yield strain and the loss of slope there, as a share of the modulus."""
        return np.array([self.yield_stress / self.modulus]), np.ones(1)


@dataclass(frozen=True, slots=True)
class RambergOsgood:
    """Strain = s / E + (s / K)^(1 / n).

    Parameters
    ----------
    modulus : E, Pa
    strength : K, Pa, stress at a plastic strain of one
    exponent : n, between 0 and 1
    source : where the numbers come from

    Notes
    -----
    Ramberg and Osgood (1943), in Hollomon's form of the plastic part. The stress at a strain is
    found by Newton's method from the smaller of E e and K e^n, both of which are too large: strain
    is convex in stress, so that every step stays above the root.
    """

    modulus: float
    strength: float
    exponent: float
    source: str = ""

    def __post_init__(self) -> None:
        require_positive("modulus", self.modulus)
        require_positive("strength", self.strength)
        if not 0.0 < self.exponent < 1.0:
            message = f"exponent={self.exponent!r}: must be between 0 and 1"
            raise ValueError(message)

    @property
    def largest_strain(self) -> float:
        """Return infinity."""
        return np.inf

    def strain(self, stress: Floats) -> Floats:
        """Return the strain at stresses of any shape; odd, NaN stays NaN."""
        plastic = (np.abs(stress) / self.strength) ** (1.0 / self.exponent)
        return stress / self.modulus + np.copysign(plastic, stress)

    def stress(self, strain: Floats) -> Floats:
        """Return the stress to rounding, Pa; NaN stays NaN."""
        newton_steps = 60
        size = np.abs(np.asarray(strain, dtype=np.float64))
        stress = np.minimum(self.modulus * size, self.strength * size**self.exponent)
        power = 1.0 / self.exponent
        for _ in range(newton_steps):
            flow = (stress / self.strength) ** (power - 1.0) / self.strength
            excess = stress / self.modulus + stress * flow - size
            step = excess / (1.0 / self.modulus + power * flow)
            stress = stress - step
            if not np.any(np.abs(step) > 1e-14 * stress):
                break
        return np.copysign(stress, strain)


@dataclass(frozen=True, slots=True)
class StressTable:
    """Straight lines between measured points, from zero on.

    Parameters
    ----------
    strains : increasing, positive; zero strain at zero stress is implied
    stresses : Pa, positive and never falling; the first slope is the modulus
    source : where the numbers come from

    Raises
    ------
    ValueError
        If a point is out of order, or a later slope is above the first.
    """

    strains: tuple[float, ...]
    stresses: tuple[float, ...]
    source: str = ""

    def __post_init__(self) -> None:
        if len(self.strains) != len(self.stresses) or not self.strains:
            message = (
                f"{len(self.strains)} strains and {len(self.stresses)} stresses: expected equal "
                f"numbers of both, at least one"
            )
            raise ValueError(message)
        strains, stresses = self._from_zero()
        slopes = np.diff(stresses) / np.diff(strains)
        rises = np.all(np.isfinite(slopes)) and np.all(np.diff(strains) > 0.0)
        if not (rises and slopes[0] > 0.0 and np.all(slopes >= 0.0)):
            message = "the table turns back: strains must increase and stresses must not decrease"
            raise ValueError(message)
        if np.any(slopes > slopes[0] * (1.0 + 1e-9)):
            steep = int(np.argmax(slopes))
            message = (
                f"slope {slopes[steep]:.4g} Pa from strain={strains[steep]:.4g} is above the "
                f"first, {slopes[0]:.4g} Pa: slopes must not exceed the modulus"
            )
            raise ValueError(message)

    def _from_zero(self) -> tuple[Floats, Floats]:
        return np.array([0.0, *self.strains]), np.array([0.0, *self.stresses])

    @property
    def corners(self) -> tuple[Floats, Floats]:
        """Return the strains but the last, and the loss of slope there in shares of the modulus.

        A loss is negative where the table grows steeper again.
        """
        strains, stresses = self._from_zero()
        slopes = np.diff(stresses) / np.diff(strains)
        return strains[1:-1], -np.diff(slopes) / slopes[0]

    @property
    def modulus(self) -> float:
        """Return the first slope, Pa."""
        return self.stresses[0] / self.strains[0]

    @property
    def largest_strain(self) -> float:
        """Return the last strain of the table."""
        return self.strains[-1]

    def stress(self, strain: Floats) -> Floats:
        """Interpolate the stress, Pa; NaN beyond the last strain, and where the strain is NaN."""
        lines = np.interp(np.abs(strain), *self._from_zero(), right=np.nan)
        return np.copysign(lines, strain)


ANNEALED_COPPER = RambergOsgood(110e9, 530e6, 0.44, "annealed copper, handbook value")
"""Copper of the dissertation's wires."""
