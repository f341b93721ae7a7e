"""Stress-strain curves of strands: Ramberg-Osgood, or a table of straight lines.

Every curve is odd (the same in tension and compression) and starts with its modulus.
Strains are dimensionless, stresses in Pa. A curve is not extrapolated beyond its last strain.

Bending of a single strand about its own axis. A round strand of radius a at curvature kappa has the
strain y kappa at height y. With y = a sin p,

    m = integral of stress y b(y) dy = 4 a^3 int_0^(pi/2) stress(a kappa sin p) sin p cos^2 p dp,

computed by Gauss's rule over the angle p, so that the laminae are thinnest where the strain is
largest. Limits: E pi d^4 / 64 kappa when elastic, yield stress d^3 / 6 when the whole strand has
yielded. The sum of 11 laminae in the dissertation's appendix, up to and with the rim, is 4.6 % low.

A piecewise linear curve is a sum of corners, and the loss of moment by a corner at the strain e has
a closed form: with sin q = e / (a kappa),

    int_q^(pi/2) (sin p - sin q) sin p cos^2 p dp
        = (pi/2 - q) / 8 + sin(4 q) / 32 - sin q cos^3 q / 3.

Therefore the law of such a strand is concave if its curve is, without ripple.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline

from labpipe.mechanics.law.plays import require, require_positive, require_rising
from labpipe.records.arrays import Floats


@dataclass(frozen=True, slots=True)
class RambergOsgood:
    """Strain = s / E + (s / K)^(1 / n).

    Parameters
    ----------
    modulus : E, Pa
    strength : K, Pa, stress at a plastic strain of one
    exponent : n, between 0 and 1

    Notes
    -----
    Ramberg and Osgood (1943), in Hollomon's form of the plastic part. The stress at a strain is
    found by Newton's method from the smaller of E e and K e^n, both of which are too large at the
    strain e: strain is convex in stress, so that every step stays above the root.
    """

    modulus: float
    strength: float
    exponent: float
    largest_strain: ClassVar[float] = np.inf

    def __post_init__(self) -> None:
        require_positive("modulus", self.modulus)
        require_positive("strength", self.strength)
        require("exponent", self.exponent, "between 0 and 1", holds=0.0 < self.exponent < 1.0)

    def strain(self, stress: Floats) -> Floats:
        """Return the strain at stresses of any shape; odd, NaN stays NaN."""
        plastic = (np.abs(stress) / self.strength) ** (1.0 / self.exponent)
        return stress / self.modulus + np.copysign(plastic, stress)

    def stress(self, strain: Floats) -> Floats:
        """Return the stress at strains of any shape, Pa, to rounding; NaN stays NaN."""
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
    """Straight lines between points, from zero on; elastic for one point.

    Parameters
    ----------
    strains : increasing, positive; zero strain at zero stress is implied
    stresses : Pa, positive and not decreasing; the first slope is the modulus

    Raises
    ------
    ValueError
        If a point is out of order or not finite, the numbers of points differ, or a slope is larger
        than the first.
    """

    strains: tuple[float, ...]
    stresses: tuple[float, ...]

    def __post_init__(self) -> None:
        lengths = len(self.strains), len(self.stresses)
        require("numbers of points", lengths, "equal and >= 1", holds=0 < lengths[0] == lengths[1])
        strains, stresses = self._from_zero()
        require_rising("strains", strains[1:])
        slopes = np.diff(stresses) / np.diff(strains)
        rises = bool(np.all(np.isfinite(slopes)) and slopes[0] > 0.0 and np.all(slopes >= 0.0))
        require("stresses", stresses[1:].tolist(), "positive and not decreasing", holds=rises)
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
        """Return all strains but the last, and the losses of slope there over the modulus.

        A loss is negative if the table becomes steeper there.
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
        """Interpolate the stress, Pa; NaN beyond the last strain and for a strain of NaN."""
        lines = np.interp(np.abs(strain), *self._from_zero(), right=np.nan)
        return np.copysign(lines, strain)


Material: TypeAlias = RambergOsgood | StressTable
"""A stress-strain curve; hashable, so that results can be cached."""

ANNEALED_COPPER = RambergOsgood(110e9, 530e6, 0.44)
"""Copper of the dissertation's wires, from a handbook."""


LAMINAE = 64
"""Number of points of Gauss's rule over the angle."""
_LAST_STRAIN_POWER = 0.0
"""Power of ten of the largest strain of a rim."""
_STRAIN_TOLERANCE = 1e-12  # of the last strain of a curve


class StrandMoment(NamedTuple):
    """Moment of one straight strand about its own axis.

    Parameters
    ----------
    moment : shape of the curvature, N m
    tangent : same shape, N m^2, slope of the moment
    """

    moment: Floats
    tangent: Floats


def compute_helix_factor(lay_angle: float, poisson: float) -> float:
    """Return the bending stiffness of a helical strand as a share of that of a straight one.

    Parameters
    ----------
    lay_angle : rad, either sign
    poisson : Poisson's ratio of the strand

    Returns
    -------
    cos(a) / 2 (1 + cos^2 a + sin^2 a / (1 + nu)): 0.9728 at 12 degrees for nu = 0.34.

    Notes
    -----
    Eq. (3.18) of the dissertation prints sin for sin^2, which is not even in the lay angle. The
    energy is averaged over one turn: the strand bends about its normal and binormal and twists.
    """
    cosine, sine = np.cos(lay_angle), np.sin(lay_angle)
    return float(cosine / 2.0 * (1.0 + cosine**2 + sine**2 / (1.0 + poisson)))


def compute_elastic_share(
    material: Material, rim_strain: Floats, *, laminae: int = LAMINAE
) -> Floats:
    """Return the moment of a round strand over its elastic moment.

    Parameters
    ----------
    material : stress-strain curve
    rim_strain : shape (n,), positive, curvature times strand radius
    laminae : number of points of Gauss's rule over the angle p; ignored for a piecewise linear
        curve

    Returns
    -------
    shape (n,), at most 1; NaN where the strain is NaN or beyond the last strain of the curve.

    Notes
    -----
    Eqs. (3.20)-(3.22) of the dissertation with the secant modulus; the integral is the same with
    stress.
    """
    if isinstance(material, StressTable):
        return _compute_polygon_share(material, rim_strain)[0]
    roots, weights = np.polynomial.legendre.leggauss(laminae)
    angle, weight = np.pi / 4.0 * (roots + 1.0), np.pi / 4.0 * weights
    sine = np.sin(angle)
    strain = rim_strain[:, None] * sine
    integral = material.stress(strain) @ (weight * sine * np.cos(angle) ** 2)
    return np.asarray(16.0 / np.pi * integral / (material.modulus * rim_strain))


def _compute_polygon_share(material: StressTable, rim_strain: Floats) -> tuple[Floats, Floats]:
    """Return the exact elastic share of a piecewise linear curve, and slope of share x strain."""
    min_strain = 1e-300  # avoids division by zero
    corner, loss = material.corners
    strain = np.where(
        rim_strain <= material.largest_strain * (1.0 + _STRAIN_TOLERANCE), rim_strain, np.nan
    )
    sine = np.minimum(corner / np.maximum(strain, min_strain)[..., None], 1.0)
    angle = np.arcsin(sine)
    cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
    # sin(4 q) / 32 written out, for small angles and large
    slope = (np.pi / 2.0 - angle) / 8.0 + sine * cosine * (1.0 - 2.0 * sine**2) / 8.0
    loss_share = slope - sine * cosine**3 / 3.0
    return 1.0 - 16.0 / np.pi * loss_share @ loss, 1.0 - 16.0 / np.pi * slope @ loss


def compute_strand_moment(material: Material, diameter: float, curvature: Floats) -> StrandMoment:
    """Return the bending moment of a straight round strand, and its slope, on first loading.

    Parameters
    ----------
    material : stress-strain curve
    diameter : m
    curvature : any shape, 1/m, either sign

    Returns
    -------
    Moment and tangent stiffness; NaN where the curvature is NaN.

    Raises
    ------
    ValueError
        If the strain at the rim exceeds the last strain of the material, or 1; the message states
        the curvature.

    Notes
    -----
    For a smooth curve `compute_elastic_share` is tabulated once per material, at 64 strains to the
    decade above 1e-6, and interpolated by a cubic spline with an error of 1e-6. For a curve of
    straight lines the moment is exact.
    """
    stiffness = material.modulus * np.pi * diameter**4 / 64.0
    rim = np.abs(np.asarray(curvature, dtype=np.float64)) * diameter / 2.0
    _require_known(material, diameter, rim)
    if isinstance(material, StressTable):
        part, tangent = _compute_polygon_share(material, rim)
    else:
        first, share, slope = _tabulate_share(material)
        level = np.log(np.maximum(rim, first))
        part = share(level)
        tangent = part + np.where(rim > first, slope(level), 0.0)
    return StrandMoment(stiffness * part * curvature, stiffness * tangent)


def _require_known(material: Material, diameter: float, rim: Floats) -> None:
    last = min(material.largest_strain, 10.0**_LAST_STRAIN_POWER)
    if np.any(rim > last * (1.0 + _STRAIN_TOLERANCE)):
        message = (
            f"curvature={2.0 * np.nanmax(rim) / diameter:.6g} 1/m strains a strand of diameter="
            f"{diameter:.4g} m by {np.nanmax(rim):.4g}: the material is known up to {last:.4g}, "
            f"which is {2.0 * last / diameter:.6g} 1/m"
        )
        raise ValueError(message)


@lru_cache(maxsize=64)
def _tabulate_share(
    material: RambergOsgood,
) -> tuple[float, Callable[[Floats], Floats], Callable[[Floats], Floats]]:
    """Return the first strain, and splines of elastic share and slope against log strain."""
    elastic, plastic = np.linspace(-14.0, -6.0, 97), np.linspace(-6.0, _LAST_STRAIN_POWER, 385)
    strain = 10.0 ** np.append(elastic[:-1], plastic)
    spline = CubicSpline(np.log(strain), compute_elastic_share(material, strain))
    return float(strain[0]), spline, spline.derivative()
