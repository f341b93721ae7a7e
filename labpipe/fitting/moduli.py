"""Moduli and stiffnesses that do not depend on the size of the sample; the area has a name."""

from __future__ import annotations

import numpy as np

from labpipe.fitting.estimates import Estimate, scaled


def rectangle_area(width: float, thickness: float) -> float:
    """Area of a rectangle, m^2: width x thickness, both in m."""
    return width * thickness


def annulus_area(outer_diameter: float, inner_diameter: float) -> float:
    """Area of a ring, m^2: pi (OD^2 - ID^2) / 4, diameters in m."""
    return 0.25 * float(np.pi) * (outer_diameter**2 - inner_diameter**2)


def thin_wall_area(outer_diameter: float, wall: float) -> float:
    """Area of a tube of stated wall, m^2: pi (OD - t) t, both in m.

    For a corrugated tube, whose outer and inner diameter hold the height of the folds, this is
    another area than `annulus_area`: a modulus has to say which one it refers to.
    """
    return float(np.pi) * (outer_diameter - wall) * wall


def modulus(
    stiffness: Estimate,
    *,
    gauge_length: float,
    area: float,
    length_uncertainty: float = 0.0,
    area_uncertainty: float = 0.0,
) -> Estimate:
    """Modulus of a bar: stiffness x gauge length / area.

    Parameters
    ----------
    stiffness : N/m
    gauge_length : m
    area : m^2, such as `annulus_area` gives
    length_uncertainty, area_uncertainty : standard uncertainties as shares of the values

    Returns
    -------
    Pa; relative variances of independent factors are added (GUM, JCGM 100:2008, eq. 12).

    Examples
    --------
    >>> area = rectangle_area(0.01879, 0.28e-3)
    >>> tape = modulus(Estimate(70e3, 700.0, 200), gauge_length=0.3, area=area)
    >>> round(tape.value / 1e9, 3), round(tape.error / tape.value, 4)
    (3.991, 0.01)
    """
    factor = gauge_length / area
    others = abs(stiffness.value) * float(np.hypot(length_uncertainty, area_uncertainty))
    return scaled(stiffness, factor, more=others)


def stiffness_per_peak_force(stiffness: Estimate, peak_force: Estimate) -> Estimate:
    """Stiffness over the largest force of the same sample, 1/m.

    Parameters
    ----------
    stiffness : N/m
    peak_force : N, positive

    Returns
    -------
    1/m. The errors of both are taken for independent, which noise is: the peak lies outside the
    window of the line. A gain error of the load cell cancels and must not be in either.

    Examples
    --------
    >>> found = stiffness_per_peak_force(Estimate(5000.0, 25.0, 300), Estimate(100.0, 0.5, 40))
    >>> found.value, round(found.error, 6)
    (50.0, 0.353553)
    """
    share = peak_force.error / peak_force.value
    return scaled(stiffness, 1.0 / peak_force.value, more=abs(stiffness.value) * share)
