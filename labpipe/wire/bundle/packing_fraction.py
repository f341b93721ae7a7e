"""How full a conduit is, and which one to choose (section 4.3.2 of the source: about 0.7)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.wire.laws import require_positive

WANTED = 0.7
"""Packing fraction that the source chooses conduits for."""


def packing_fraction(diameters: Floats, bore: float) -> float:
    """Area of some wires over the area of a bore, a pure number.

    Parameters
    ----------
    diameters : shape (wires,), m, over the insulation
    bore : m, inner diameter of the conduit
    """
    require_positive("bore", bore)
    return float(np.sum(diameters**2) / bore**2)


def bore_for(diameters: Floats, fraction: float = WANTED) -> float:
    """Inner diameter of the conduit that some wires fill by a wanted share, m.

    Parameters
    ----------
    diameters : shape (wires,), m
    fraction : wanted packing fraction
    """
    require_positive("fraction", fraction)
    return float(np.sqrt(np.sum(diameters**2) / fraction))


def choose_bore(
    diameters: Floats, bores: Sequence[float], *, smallest: float, fraction: float = WANTED
) -> float:
    """Choose among conduits the one whose packing fraction is nearest to the wanted one.

    Parameters
    ----------
    diameters : shape (wires,), m
    bores : m, inner diameters of the conduits that there are
    smallest : m, diameter of the circle that holds the wires; narrower conduits are left out
    fraction : wanted packing fraction

    Returns
    -------
    m, one of `bores`; of two that are equally near, the wider.

    Raises
    ------
    ValueError
        If the wires fit none of them.
    """
    fitting = [bore for bore in bores if fits(smallest, bore)]
    if not fitting:
        offered = ", ".join(f"{1e3 * bore:.4g}" for bore in bores)
        message = (
            f"the wires need a bore of {1e3 * smallest:.4g} mm, "
            f"and the conduits have {offered or 'none'} mm"
        )
        raise ValueError(message)
    return min(fitting, key=lambda bore: (abs(packing_fraction(diameters, bore) - fraction), -bore))


def fits(smallest: float, bore: float) -> bool:
    """Tell whether a circle of wires goes into a bore, both m; alike within a millionth do."""
    return smallest <= bore * (1.0 + 1e-6)
