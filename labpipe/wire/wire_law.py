"""The law of a stranded wire as plays, for the cantilever: a polygon through its first loading."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.wire.cross_section import CrossSection
from labpipe.wire.friction import Contacts, slip_onsets
from labpipe.wire.laws import PlayLaw, require_positive
from labpipe.wire.moment_curvature import moment_curvature

_DECADES = 4.0  # of curvature below the largest, over which the corners are spread
_DISTINCT = 1e-6  # of a curvature: closer corners are one
_MOST_BRIDGED = 0.01  # of the moment: more would be another law
_ROUNDING = 1e-7  # of the first slope: what differences of close corners are worth


def play_law(
    section: CrossSection,
    contacts: Contacts,
    *,
    largest_curvature: float,
    n_plays: int = 60,
    tension: float = 0.0,
    orientation: float = 0.0,
) -> PlayLaw:
    """Plays whose polygon of first loading meets the wire's law at every corner.

    Parameters
    ----------
    section, contacts, tension, orientation : as for `moment_curvature`
    largest_curvature : 1/m, where the law ends: `wire.cantilever` bends no wire beyond
    n_plays : corners, evenly spread in the logarithm of the curvature over four decades; besides
        these there is one where each strand begins to slip

    Returns
    -------
    The law, with Masing's loops: those of Coulomb sliders and hardening strands where friction is
    even on both sides, which it nearly is for small mu sin(alpha).

    Raises
    ------
    ValueError
        If the law softens, or stiffens, which plays cannot do; the message says the curvature. And
        as `moment_curvature`.

    Notes
    -----
    With 60 plays the polygon is within 0.3 % of the laws of the source's wires between its corners.
    """
    require_positive("largest_curvature", largest_curvature)
    even = np.geomspace(10.0**-_DECADES, 1.0, n_plays + 1) * largest_curvature
    onsets = slip_onsets(section, contacts, tension=tension, orientation=orientation)
    inside = onsets[(onsets > even[0]) & (onsets < even[-1])]
    knots = np.union1d(even, inside)
    knots = knots[np.diff(knots, prepend=0.0) > _DISTINCT * knots]
    moment = moment_curvature(
        section, contacts, knots, tension=tension, orientation=orientation
    ).moment
    return polygon_law(knots, moment)


def polygon_law(curvature: Floats, moment: Floats) -> PlayLaw:
    """Plays of a polygon through the origin and given points of a first loading, the last its end.

    Parameters
    ----------
    curvature : shape (n,), 1/m, positive and increasing, n >= 2
    moment : shape (n,), N m

    Raises
    ------
    ValueError
        If the moment does not grow (softens), or a later slope is above an earlier one (stiffens);
        the message says the curvature.
    """
    slopes = np.diff(moment, prepend=0.0) / np.diff(curvature, prepend=0.0)
    if not np.all(slopes > 0.0):
        at = curvature[int(np.argmin(slopes > 0.0))]
        message = f"the law softens before curvature={at:.6g} 1/m: allowed is a moment that grows"
        raise ValueError(message)
    if np.any(np.diff(slopes) > _ROUNDING * slopes[0]):
        at = curvature[int(np.argmax(np.diff(slopes))) + 1]
        message = (
            f"the law stiffens before curvature={at:.6g} 1/m: allowed is a slope that never grows"
        )
        raise ValueError(message)
    compliances = np.maximum(np.diff(1.0 / slopes), 0.0)
    return PlayLaw(float(slopes[0]), moment[:-1], compliances, float(moment[-1]))


def concave_law(curvature: Floats, moment: Floats) -> PlayLaw:
    """Plays of the lowest polygon that no given point of a first loading lies above.

    Where the law stiffens, as it can by the rounding of a table or under tension, its corners are
    left out and the polygon bridges them; elsewhere it is that of `polygon_law`.

    Parameters
    ----------
    curvature : shape (n,), 1/m, positive and increasing, n >= 2
    moment : shape (n,), N m

    Raises
    ------
    ValueError
        If the moment does not grow, or the bridges are more than 1 % of the moment above the law;
        the message says the curvature.
    """
    kept = _upper_corners(curvature, moment)
    bridged = np.interp(curvature, np.append(0.0, curvature[kept]), np.append(0.0, moment[kept]))
    above = bridged / moment - 1.0
    if np.any(above > _MOST_BRIDGED):
        at = int(np.argmax(above))
        message = (
            f"the law stiffens at curvature={curvature[at]:.6g} 1/m: a law that never does is "
            f"{100.0 * above[at]:.2g} % above it, allowed is {100.0 * _MOST_BRIDGED:.0f} %"
        )
        raise ValueError(message)
    return polygon_law(curvature[kept], moment[kept])


def _upper_corners(curvature: Floats, moment: Floats) -> list[int]:
    """Which points are corners of the upper hull with the origin (Andrew's chain, 1979)."""
    kept: list[int] = []
    x, y = [0.0], [0.0]
    for number, (k, m) in enumerate(zip(curvature.tolist(), moment.tolist(), strict=True)):
        while len(x) > 1 and (m - y[-2]) * (x[-1] - x[-2]) >= (y[-1] - y[-2]) * (k - x[-2]):
            del x[-1], y[-1], kept[-1]
        x.append(k)
        y.append(m)
        kept.append(number)
    return kept
