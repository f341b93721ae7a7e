"""Bending stiffness from the stiffness of a beam in a test."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

from labpipe.fitting.estimates import Estimate, scaled

DIVISORS: Final = MappingProxyType({"cantilever": 3.0, "three-point": 48.0})
"""By support: end load on a cantilever of a length, load in the middle of a span."""


def beam_stiffness(
    stiffness: Estimate, *, length: float, length_error: float, support: str
) -> Estimate:
    """Bending stiffness EI of a straight uniform beam from force over deflection.

    Parameters
    ----------
    stiffness : N/m, at small deflections
    length : m, free length of a cantilever, or span between two supports
    length_error : m, standard uncertainty of it
    support : one of `DIVISORS`

    Returns
    -------
    N m^2.

    Raises
    ------
    ValueError
        For another support, or a length that is not above zero.

    Notes
    -----
    EI = K L^3 / 3 and EI = K L^3 / 48: Euler-Bernoulli beam, slopes small, no shear (Young and
    Budynas, Roark's Formulas for Stress and Strain, 7th ed. 2002, table 8.1, cases 1a and 1e). A
    relative error of the length counts three times.

    Examples
    --------
    >>> found = beam_stiffness(
    ...     Estimate(480.0, 0.0, 9), length=0.1, length_error=0.001, support="three-point"
    ... )
    >>> round(found.value, 9), round(found.error, 9)
    (0.01, 0.0003)
    """
    if support not in DIVISORS:
        message = f"expected a support out of {', '.join(DIVISORS)}, found {support!r}"
        raise ValueError(message)
    if not length > 0.0:
        message = f"expected a length above 0, found length={length}"
        raise ValueError(message)
    more = 3.0 * length_error / length * abs(stiffness.value)
    return scaled(stiffness, length**3 / DIVISORS[support], more=more)
