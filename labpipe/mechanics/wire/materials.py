"""Define stress-strain curves of strands, and compute the bending moment of a strand.

A stress-strain curve has the Ramberg-Osgood form, or is piecewise linear. It is odd (equal in
tension and compression), and its initial slope is the modulus of elasticity. Strains are
dimensionless, stresses in Pa. A curve is not extrapolated beyond its last strain.

A round strand of radius a at the curvature kappa has the strain y kappa at height y. With the width
b(y) of the strand and y = a sin p, the moment of the strand about its own axis is

    m = integral of stress y b(y) dy = 4 a^3 int_0^(pi/2) stress(a kappa sin p) sin p cos^2 p dp.

The integral is computed by Gauss-Legendre quadrature over the angle p, which places most points
where the strain is largest. The moment is E (pi d^4 / 64) kappa for an elastic strand of diameter
d, and s d^3 / 6 for a perfectly plastic strand with the yield stress s. The sum over 11 laminae in
the appendix of [1]_ is 4.6 % too small.

A piecewise linear curve begins with a straight line through the origin. Its slope decreases at
corners. At a corner at the strain e, the slope decreases by the fraction c of the modulus E. Such a
corner reduces the moment by 4 E c a^4 kappa times an integral with a closed form. With
sin q = e / (a kappa), the integral is

    int_q^(pi/2) (sin p - sin q) sin p cos^2 p dp
        = (pi/2 - q) / 8 + sin(4 q) / 32 - sin q cos^3 q / 3.

The moment of such a strand is therefore exactly concave if its stress-strain curve is concave.

References
----------
.. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
       dissertation.
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
    """Ramberg-Osgood curve, strain = s / E + (s / K)^(1 / n).

    Parameters
    ----------
    modulus : E, Pa, modulus of elasticity
    strength : K, Pa, stress at a plastic strain of one
    exponent : n, hardening exponent, between 0 and 1

    Notes
    -----
    The plastic strain has Hollomon's form (Ramberg and Osgood, NACA TN 902, 1943). The stress at a
    strain e is computed by Newton's method from the smaller of E e and K e^n. Both are above the
    solution. Every iterate is also above it, because strain is a convex function of stress.
    """

    modulus: float
    strength: float
    exponent: float
    largest_strain: ClassVar[float] = np.inf

    def __post_init__(self) -> None:
        require_positive("modulus", self.modulus)
        require_positive("strength", self.strength)
        require("exponent", self.exponent, "between 0 and 1", holds=0.0 < self.exponent < 1.0)

    def compute_strain(self, stress: Floats) -> Floats:
        """Compute the strain at stresses of any shape, Pa; NaN remains NaN."""
        plastic_strain = (np.abs(stress) / self.strength) ** (1.0 / self.exponent)
        return stress / self.modulus + np.copysign(plastic_strain, stress)

    def compute_stress(self, strain: Floats) -> Floats:
        """Compute the stress at strains of any shape, Pa; NaN remains NaN."""
        max_iterations = 60
        tolerance = 1e-14  # relative change of the stress
        magnitude = np.abs(np.asarray(strain, dtype=np.float64))
        stress = np.minimum(self.modulus * magnitude, self.strength * magnitude**self.exponent)
        power = 1.0 / self.exponent
        for _ in range(max_iterations):
            plastic_compliance = (stress / self.strength) ** (power - 1.0) / self.strength
            excess_strain = stress / self.modulus + stress * plastic_compliance - magnitude
            step = excess_strain / (1.0 / self.modulus + power * plastic_compliance)
            stress = stress - step
            if not np.any(np.abs(step) > tolerance * stress):
                break
        return np.copysign(stress, strain)


@dataclass(frozen=True, slots=True)
class StressTable:
    """Piecewise linear stress-strain curve through the origin and given points.

    Parameters
    ----------
    strains : strains of the points, positive and increasing
    stresses : Pa, stresses of the points, positive and not decreasing; the first slope is the
        modulus

    Raises
    ------
    ValueError
        If strains are not positive and increasing, stresses are not positive, decrease or are not
        finite, there is no point, the numbers of strains and stresses differ, or a slope is larger
        than the first.
    """

    strains: tuple[float, ...]
    stresses: tuple[float, ...]

    def __post_init__(self) -> None:
        counts = len(self.strains), len(self.stresses)
        holds = 0 < counts[0] == counts[1]
        require("numbers of strains and stresses", counts, "equal and >= 1", holds=holds)
        strains, stresses = self._prepend_origin()
        require_rising("strains", strains[1:])
        slopes = np.diff(stresses) / np.diff(strains)
        is_valid = bool(np.all(np.isfinite(slopes)) and slopes[0] > 0.0 and np.all(slopes >= 0.0))
        require("stresses", stresses[1:].tolist(), "positive and not decreasing", holds=is_valid)
        steepest = int(np.argmax(slopes))  # index of the steepest segment
        if slopes[steepest] > slopes[0] * (1.0 + 1e-9):  # tolerance for rounding errors
            message = (
                f"slope {slopes[steepest]:.4g} Pa from strain={strains[steepest]:.4g} is above "
                f"the first, {slopes[0]:.4g} Pa: slopes must not exceed the modulus"
            )
            raise ValueError(message)

    def _prepend_origin(self) -> tuple[Floats, Floats]:
        """Return strains, and stresses in Pa, of the origin and the given points."""
        return np.array([0.0, *self.strains]), np.array([0.0, *self.stresses])

    @property
    def corners(self) -> tuple[Floats, Floats]:
        """Strains of the corners, and decreases of the slope at them relative to the modulus.

        A decrease is negative if the slope increases at the corner.
        """
        strains, stresses = self._prepend_origin()
        slopes = np.diff(stresses) / np.diff(strains)
        return strains[1:-1], -np.diff(slopes) / slopes[0]

    @property
    def modulus(self) -> float:
        """Modulus of elasticity, Pa, which is the first slope."""
        return self.stresses[0] / self.strains[0]

    @property
    def largest_strain(self) -> float:
        """Last strain of the curve."""
        return self.strains[-1]

    def compute_stress(self, strain: Floats) -> Floats:
        """Interpolate the stress, Pa; NaN beyond the last strain and for a strain of NaN."""
        stress = np.interp(np.abs(strain), *self._prepend_origin(), right=np.nan)
        return np.copysign(stress, strain)


Material: TypeAlias = RambergOsgood | StressTable
"""Stress-strain curve; hashable, because tables of its moments are cached."""

ANNEALED_COPPER = RambergOsgood(modulus=110e9, strength=530e6, exponent=0.44)
"""Annealed copper with the values of a handbook that are used in [1]_."""


_MAX_RIM_STRAIN = 1.0
"""Largest strain at the rim of a strand for which its moment is computed."""
_STRAIN_TOLERANCE = 1e-12
"""Tolerance by which a strain may exceed the last strain of a curve, relative to that strain."""


class BendingMoment(NamedTuple):
    """Bending moment of strands or of the insulation; arrays have the shape of the curvature.

    Parameters
    ----------
    moment : N m
    tangent_stiffness : N m^2, derivative of the moment with respect to curvature
    """

    moment: Floats
    tangent_stiffness: Floats


def compute_helix_factor(lay_angle: float, poisson: float) -> float:
    """Compute the bending stiffness of a helical strand relative to that of a straight strand.

    Parameters
    ----------
    lay_angle : rad, angle between the strand and the axis of the helix, any sign
    poisson : Poisson's ratio of the strand

    Notes
    -----
    The factor is (cos(a) / 2) (1 + cos^2 a + sin^2 a / (1 + nu)), where a is the lay angle and nu
    Poisson's ratio. For nu = 0.34 it is 0.9728 at 12 degrees. It follows from the strain energy,
    averaged over one lay length, of a strand that bends about its normal and binormal and twists.
    Equation (3.18) of [1]_ has sin in place of sin^2 and is therefore not even in the lay angle.
    """
    cosine, sine = np.cos(lay_angle), np.sin(lay_angle)
    return float(cosine / 2.0 * (1.0 + cosine**2 + sine**2 / (1.0 + poisson)))


def compute_elastic_ratio(material: Material, rim_strain: Floats, *, n_points: int = 64) -> Floats:
    """Compute the ratio of the moment of a round strand to that of an elastic strand.

    Parameters
    ----------
    material : stress-strain curve
    rim_strain : shape (n,), positive, strain at the rim: curvature times radius of the strand
    n_points : number of points of the quadrature over the angle p; ignored for a piecewise linear
        curve

    Returns
    -------
    Shape (n,), at most 1; NaN where the strain is NaN or beyond the last strain of the curve.

    Notes
    -----
    Equations (3.20) to (3.22) of [1]_ contain the secant modulus instead of the stress. The
    integral is the same.
    """
    if isinstance(material, StressTable):
        return _compute_table_ratio(material, rim_strain)[0]
    roots, weights = np.polynomial.legendre.leggauss(n_points)
    angle, weight = np.pi / 4.0 * (roots + 1.0), np.pi / 4.0 * weights
    sine = np.sin(angle)
    strain = rim_strain[:, None] * sine
    integral = material.compute_stress(strain) @ (weight * sine * np.cos(angle) ** 2)
    return np.asarray(16.0 / np.pi * integral / (material.modulus * rim_strain))


def _compute_table_ratio(material: StressTable, rim_strain: Floats) -> tuple[Floats, Floats]:
    """Compute moment and tangent stiffness relative to those of an elastic strand.

    The first result is that of `compute_elastic_ratio`.
    """
    min_strain = 1e-300  # prevents a division by zero
    corner_strain, slope_decrease = material.corners
    max_strain = material.largest_strain * (1.0 + _STRAIN_TOLERANCE)
    strain = np.where(rim_strain <= max_strain, rim_strain, np.nan)
    sine = np.minimum(corner_strain / np.maximum(strain, min_strain)[..., None], 1.0)
    angle = np.arcsin(sine)
    cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
    # sin(4 q) / 32 is computed from sine and cosine, which is accurate for all angles.
    tangent_integral = (np.pi / 2.0 - angle) / 8.0 + sine * cosine * (1.0 - 2.0 * sine**2) / 8.0
    moment_integral = tangent_integral - sine * cosine**3 / 3.0
    ratio = 1.0 - 16.0 / np.pi * moment_integral @ slope_decrease
    return ratio, 1.0 - 16.0 / np.pi * tangent_integral @ slope_decrease


def compute_strand_moment(material: Material, diameter: float, curvature: Floats) -> BendingMoment:
    """Compute moment and tangent stiffness of a straight round strand on first loading.

    Parameters
    ----------
    material : stress-strain curve
    diameter : m, diameter of the strand
    curvature : any shape, 1/m, any sign

    Returns
    -------
    Moment and tangent stiffness; NaN where the curvature is NaN.

    Raises
    ------
    ValueError
        If the strain at the rim exceeds the last strain of the material, or 1. The message states
        the curvature.

    Notes
    -----
    For a Ramberg-Osgood curve, `compute_elastic_ratio` is tabulated once per material at 64 strains
    per decade above 1e-6, and interpolated by a cubic spline with an error of 1e-6. For a piecewise
    linear curve the moment is exact.
    """
    stiffness = material.modulus * np.pi * diameter**4 / 64.0
    rim_strain = np.abs(np.asarray(curvature, dtype=np.float64)) * diameter / 2.0
    max_strain = min(material.largest_strain, _MAX_RIM_STRAIN)
    if np.any(rim_strain > max_strain * (1.0 + _STRAIN_TOLERANCE)):
        largest_rim_strain = np.nanmax(rim_strain)
        message = (
            f"curvature={2.0 * largest_rim_strain / diameter:.6g} 1/m strains a strand of diameter="
            f"{diameter:.4g} m by {largest_rim_strain:.4g}: the largest strain of its material is "
            f"{max_strain:.4g}, at {2.0 * max_strain / diameter:.6g} 1/m"
        )
        raise ValueError(message)
    if isinstance(material, StressTable):
        ratio, tangent_ratio = _compute_table_ratio(material, rim_strain)
    else:
        first_strain, interpolate_ratio, interpolate_slope = _tabulate_ratio(material)
        log_strain = np.log(np.maximum(rim_strain, first_strain))
        ratio = interpolate_ratio(log_strain)
        slope = np.where(rim_strain > first_strain, interpolate_slope(log_strain), 0.0)
        tangent_ratio = ratio + slope
    return BendingMoment(stiffness * ratio * curvature, stiffness * tangent_ratio)


@lru_cache(maxsize=64)
def _tabulate_ratio(
    material: RambergOsgood,
) -> tuple[float, Callable[[Floats], Floats], Callable[[Floats], Floats]]:
    """Tabulate the elastic ratio; return the first strain and two splines over log(strain).

    The splines give the ratio and the derivative of the ratio with respect to log(strain).
    """
    coarse_exponents = np.linspace(-14.0, -6.0, 97)
    fine_exponents = np.linspace(-6.0, np.log10(_MAX_RIM_STRAIN), 385)
    strain = 10.0 ** np.append(coarse_exponents[:-1], fine_exponents)
    spline = CubicSpline(np.log(strain), compute_elastic_ratio(material, strain))
    return float(strain[0]), spline, spline.derivative()
