"""What every deck says of its wire: range, units, what the law is and what it is not."""

from __future__ import annotations

import numpy as np

from labpipe import __version__
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable

COPPER_DENSITY = 8960.0
"""kg/m^3, of pure copper at 20 deg C (CRC Handbook of Chemistry and Physics)."""

UNITS = "Units: m, N, kg, s, rad; curvature and twist 1/m, moment N m, stiffness N m^2."
FIRST_LOADING = "The law is that of the first loading of a wire that was never bent before."
NO_MASS = "the sheet of wires gives no mass per length"


def facts(table: WireTable, name: str) -> tuple[str, ...]:
    """Sentences at the head of every deck.

    Parameters
    ----------
    table : law of the wire
    name : of the wire, as the deck may write it
    """
    end = float(table.curvature[-1])
    return (
        f"Wire {name}, made by labpipe {__version__}.",
        UNITS,
        f"Range: curvature from 0 to {end:.6g} 1/m (bending radius {1.0 / end:.4g} m and more).",
        "Beyond this range the deck is not valid.",
        FIRST_LOADING,
    )


def linear_range(
    table: WireTable, stiffness: float, *, tolerance: float = 0.05
) -> tuple[float, float] | None:
    """Curvatures between which a constant stiffness is as good as the wire's law.

    Parameters
    ----------
    table : law of the wire
    stiffness : N m^2, of the linear law
    tolerance : distance of the linear law from the wire's, as a share of the wire's moment

    Returns
    -------
    From and to, 1/m: the first stretch on which the two are as close as that. None if there is none
    within the table.

    Notes
    -----
    Between two points the moment is on a straight line a + b kappa, so that stiffness kappa =
    (1 -+ tolerance) (a + b kappa) is solved there.
    """
    knots = np.union1d(
        table.curvature,
        np.concatenate([_meets(table, stiffness, 1.0 + off) for off in (-tolerance, tolerance)]),
    )
    middle = 0.5 * (knots[1:] + knots[:-1])
    moment = np.interp(middle, table.curvature, table.moment)
    inside = np.abs(stiffness * middle / moment - 1.0) <= tolerance
    if not inside.any():
        return None
    first = int(np.argmax(inside))
    leaves = np.flatnonzero(~inside[first:])
    last = first + int(leaves[0]) if len(leaves) else len(inside)
    return float(knots[first]), float(knots[last])


def _meets(table: WireTable, stiffness: float, bound: float) -> Floats:
    """Curvatures, beside the points, at which the linear moment is so many times the wire's."""
    left, right = table.curvature[:-1], table.curvature[1:]
    slope = np.diff(table.moment) / np.diff(table.curvature)
    apart = stiffness - bound * slope
    start = bound * (table.moment[:-1] - slope * left)
    at = start / np.where(apart == 0.0, np.inf, apart)
    return at[(at > left) & (at < right)]


def skew_excess(table: WireTable) -> float:
    """By how much bending askew comes out too stiff where the two axes do not know of each other.

    Parameters
    ----------
    table : law of the wire

    Returns
    -------
    The largest share, over the range, by which the moment of two laws at 45 degrees is above that
    of one: sqrt(2) M(kappa / sqrt(2)) / M(kappa) - 1.
    """
    kappa = table.curvature[1:]
    part = np.interp(kappa / np.sqrt(2.0), table.curvature, table.moment)
    return float(np.max(np.sqrt(2.0) * part / table.moment[1:] - 1.0))


def solid_area(table: WireTable) -> float:
    """Area of the strands and the insulation across the wire, m^2."""
    layout = table.layout
    tube = np.pi * (layout.wire_radius**2 - layout.bore_radius**2)
    return float(np.sum(np.pi / 4.0 * layout.diameter**2) + tube)


def second_moment(table: WireTable) -> float:
    """Second moment of that area, the mean over all axes through the middle, m^4."""
    layout = table.layout
    tube = np.pi / 4.0 * (layout.wire_radius**4 - layout.bore_radius**4)
    area = np.pi / 4.0 * layout.diameter**2
    arms = 0.5 * (layout.x**2 + layout.y**2)
    return float(np.sum(np.pi / 64.0 * layout.diameter**4 + area * arms) + tube)


def copper_mass(table: WireTable) -> float:
    """Mass per length of the strands if they are of copper, without the insulation, kg/m."""
    return float(COPPER_DENSITY * np.sum(np.pi / 4.0 * table.layout.diameter**2))


def require_mass(mass_per_length: float | None) -> None:
    """Refuse a mass per length that is not a positive number.

    Raises
    ------
    ValueError
        With the value and what is allowed.
    """
    if mass_per_length is None or (np.isfinite(mass_per_length) and mass_per_length > 0.0):
        return
    message = f"mass_per_length={mass_per_length!r}: allowed are finite numbers > 0, or none"
    raise ValueError(message)
