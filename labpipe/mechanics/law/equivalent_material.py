"""Equivalent material of a solid round bar that bends as a wire does.

Programs whose beams have no moment-curvature law use a material. Plane sections of a round
bar of radius R bent by kappa are strained by y kappa (Euler-Bernoulli), and so

    M(kappa) = 4 integral from 0 to R of sigma(y kappa) y sqrt(R^2 - y^2) dy

is an integral equation of Abel's kind for sigma. It is solved for a piecewise linear curve.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.optimize import lsq_linear, nnls

from labpipe.mechanics.law.plays import require, require_positive, require_rising
from labpipe.records.arrays import ArrayRecord, Floats, Vector

N_KNOTS = 24
"""Points of the stress-strain curve."""
ELASTIC_SHARE = 0.002
"""End of the elastic range, as a share of the largest curvature."""


@dataclass(frozen=True, slots=True, eq=False)
class EquivalentMaterial(ArrayRecord):
    """Stress against strain on first loading, of a material that hardens isotropically.

    Parameters
    ----------
    diameter : of the bar, m
    modulus : Pa, up to the first strain
    strain : shape (n,), total, increasing; the last belongs to the largest curvature
    stress : shape (n,), Pa, never falling
    curvature : shape (m,), 1/m, where the law was compared with the wire's
    error : shape (m,), distance of the bar's moment from the wire's, as a share of the wire's
    """

    diameter: float
    modulus: float
    strain: Vector
    stress: Vector
    curvature: Annotated[Floats, "m"]
    error: Annotated[Floats, "m"]

    @property
    def elastic_curvature(self) -> float:
        """Return the curvature at which the bar yields, 1/m."""
        return float(2.0 * self.strain[0] / self.diameter)

    @property
    def plastic_strain(self) -> Floats:
        """Return strain less stress over modulus, shape (n,); the first is zero."""
        plastic = self.strain - self.stress / self.modulus
        return np.asarray(plastic - plastic[0])

    def holds_from(self, tolerance: float) -> float | None:
        """Return the curvature from which the bar's law stays within a share of the wire's.

        Parameters
        ----------
        tolerance : share of the wire's moment

        Returns
        -------
        1/m, one of `curvature`; None if the error is larger at the last of them.
        """
        outside = np.flatnonzero(np.abs(self.error) > tolerance)
        first = int(outside[-1]) + 1 if len(outside) else 0
        return float(self.curvature[first]) if first < len(self.curvature) else None


def fit_equivalent_material(
    curvature: Floats,
    moment: Floats,
    diameter: float,
    *,
    elastic_share: float = ELASTIC_SHARE,
    n_knots: int = N_KNOTS,
) -> EquivalentMaterial:
    """Find the material of a round bar whose moment-curvature law is that of a wire.

    Parameters
    ----------
    curvature : shape (m,), 1/m, positive and increasing; the end is that of the range
    moment : shape (m,), N m, of the wire on first loading, positive
    diameter : of the bar, m
    elastic_share : of the largest curvature: up to there the bar is elastic, with the wire's
        secant stiffness at that curvature
    n_knots : points of the stress-strain curve, spread evenly in the logarithm

    Returns
    -------
    The material, with the distance of its law from the wire's at every given curvature, those
    within the elastic range included: below it a wire that sticks is stiffer.

    Raises
    ------
    ValueError
        If a number is out of its range, fewer than two points are given, or a value is NaN.

    Notes
    -----
    Least squares of the relative error at the points above the elastic range, by bounded slopes
    (Stark and Parker, Computational Statistics 10 (1995) 129): none below zero, since a bar of
    falling stress is unstable, and none above the modulus. A kink sharper than a round section
    allows (immediate slip) is rounded, which is included in `error`.

    Strains are those of a straight line of slope kappa over the section. At strains of a few per
    cent the difference of nominal and true strain is opposite on the two sides of the bar and
    cancels to first order.
    """
    _require_input(curvature, moment, elastic_share, n_knots)
    require_positive("diameter", diameter)
    radius = 0.5 * diameter
    elastic = elastic_share * float(curvature[-1])
    strain = np.geomspace(elastic, float(curvature[-1]), n_knots) * radius
    secant = float(np.interp(elastic, np.append(0.0, curvature), np.append(0.0, moment))) / elastic
    modulus = secant / (0.25 * np.pi * radius**4)
    # moments of bars with unit slope in one segment of strain only
    segments = np.diff(_plastic_moment(curvature[:, None], strain, radius), axis=1, prepend=0.0)
    parts = modulus * segments / moment[:, np.newaxis]
    above = curvature > elastic
    remaining = 1.0 - parts[above, 0]
    slopes = _bounded_slopes(parts[above, 1:], remaining)
    shares = np.append(1.0, slopes)
    stress = modulus * np.cumsum(shares * np.diff(strain, prepend=0.0))
    return EquivalentMaterial(diameter, modulus, strain, stress, curvature, parts @ shares - 1.0)


def _bounded_slopes(parts: Floats, target: Floats) -> Floats:
    """Solve least squares with bounded slopes; by NNLS where that meets the upper bound."""
    max_slope = 0.999  # of the modulus: as steep as it, a curve has no plastic strain
    rounds_per_slope = 20  # with the default of one some searches stop early
    max_iterations = rounds_per_slope * parts.shape[1]
    slopes = nnls(parts, target, maxiter=max_iterations)[0]
    if np.any(slopes > max_slope):
        bounds = (0.0, max_slope)
        slopes = lsq_linear(parts, target, bounds=bounds, method="bvls", max_iter=max_iterations).x
    return np.asarray(slopes)


def _plastic_moment(curvature: Floats, strain: Floats, radius: float) -> Floats:
    """Return the moment of a bar of unit modulus, perfectly plastic from a strain on.

    With c = strain / (kappa R) the half-height of the elastic core, as a share of the radius:
    M = kappa R^4 / 2 (asin c - c sqrt(1 - c^2) (1 - 2 c^2)) + 4/3 strain R^3 (1 - c^2)^(3/2).
    """
    core = np.minimum(strain / (curvature * radius), 1.0)
    outside = 1.0 - core**2
    inner = np.arcsin(core) - core * np.sqrt(outside) * (1.0 - 2.0 * core**2)
    return 0.5 * curvature * radius**4 * inner + 4.0 / 3.0 * strain * radius**3 * outside**1.5


def _require_input(curvature: Floats, moment: Floats, elastic_share: float, n_knots: int) -> None:
    lengths = len(curvature), len(moment)
    require("numbers of points", lengths, "equal and >= 2", holds=1 < lengths[0] == lengths[1])
    require_rising("curvature", curvature)
    holds = bool(np.all((moment > 0.0) & np.isfinite(moment * curvature)))
    require("moment", moment.tolist(), "finite and > 0", holds=holds)
    require("elastic_share", elastic_share, "between 0 and 1", holds=0.0 < elastic_share < 1.0)
    require("n_knots", n_knots, ">= 2", holds=n_knots >= 2)
