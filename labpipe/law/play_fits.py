"""Plays fitted to first loading: to points, a smooth curve, or two stiffnesses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from labpipe.law.plays import PlayLaw, require_positive
from labpipe.records.arrays import Floats


def polygon_law(curvature: Floats, moment: Floats) -> PlayLaw:
    """Return the plays of a polygon through the origin and points of a first loading.

    Parameters
    ----------
    curvature : shape (n,), 1/m, positive and increasing, n >= 2
    moment : shape (n,), N m

    Raises
    ------
    ValueError
        If the moment does not grow (softens), or a later slope is above an earlier one (stiffens);
        the message states the curvature.
    """
    rounding_share = 1e-7  # of the first slope, from differences of close corners
    slopes = np.diff(moment, prepend=0.0) / np.diff(curvature, prepend=0.0)
    if not np.all(slopes > 0.0):
        fault = curvature[int(np.argmin(slopes > 0.0))]
        message = f"the law softens before curvature={fault:.6g} 1/m: the moment must increase"
        raise ValueError(message)
    if np.any(np.diff(slopes) > rounding_share * slopes[0]):
        fault = curvature[int(np.argmax(np.diff(slopes))) + 1]
        message = f"the law stiffens before curvature={fault:.6g} 1/m: the slope must not increase"
        raise ValueError(message)
    compliances = np.maximum(np.diff(1.0 / slopes), 0.0)
    return PlayLaw(float(slopes[0]), moment[:-1], compliances, float(moment[-1]))


def concave_law(curvature: Floats, moment: Floats) -> PlayLaw:
    """Return the plays of the concave hull of points of a first loading.

    Where the law stiffens, as it can by rounding of a table or under tension, the hull bridges its
    corners; elsewhere it is that of `polygon_law`.

    Parameters
    ----------
    curvature : shape (n,), 1/m, positive and increasing, n >= 2
    moment : shape (n,), N m

    Raises
    ------
    ValueError
        If the moment does not grow, or the hull is more than 1 % of the moment above the law;
        the message states the curvature.
    """
    max_bridged_share = 0.01  # of the moment: more would be another law
    hull = _upper_corners(curvature, moment)
    bridged = np.interp(curvature, np.append(0.0, curvature[hull]), np.append(0.0, moment[hull]))
    excess = bridged / moment - 1.0
    if np.any(excess > max_bridged_share):
        worst = int(np.argmax(excess))
        message = (
            f"the law stiffens at curvature={curvature[worst]:.6g} 1/m: its concave hull is "
            f"{100.0 * excess[worst]:.2g} % above it; expected at most "
            f"{100.0 * max_bridged_share:.0f} %"
        )
        raise ValueError(message)
    return polygon_law(curvature[hull], moment[hull])


def _upper_corners(curvature: Floats, moment: Floats) -> list[int]:
    """Return the corners of the upper hull with the origin (Andrew's chain, 1979)."""
    corners: list[int] = []
    x, y = [0.0], [0.0]
    for number, (k, m) in enumerate(zip(curvature.tolist(), moment.tolist(), strict=True)):
        while len(x) > 1 and (m - y[-2]) * (x[-1] - x[-2]) >= (y[-1] - y[-2]) * (k - x[-2]):
            del x[-1], y[-1], corners[-1]
        x.append(k)
        y.append(m)
        corners.append(number)
    return corners


def fit_plays(
    curvature: Callable[[Floats], Floats],
    *,
    stiffness: float,
    first_moment: float,
    last_moment: float,
    n_plays: int,
) -> PlayLaw:
    """Fit plays to a smooth law so that the polygon meets it at every corner.

    Parameters
    ----------
    curvature : first-loading curvature, 1/m, as a function of moments, N m
    stiffness : EI0 of the elastic start and of unloading, N m^2
    first_moment, last_moment : N m, where the first play moves and where the fit ends; the corners
        lie between them, denser near the first; beyond the last the law is linear
    n_plays : number of plays, 30 to 60 for a law without visible corners

    Returns
    -------
    The law. Up to `first_moment` it has `stiffness`, independent of `curvature`.

    Raises
    ------
    ValueError
        If a number is out of its range, or `curvature` softens (stops growing with the moment) or
        stiffens (its slope falls), which plays cannot.
    """
    require_positive("first_moment", first_moment)
    if not (last_moment > first_moment and n_plays >= 1):
        message = (
            f"last_moment={last_moment!r}, n_plays={n_plays!r}: must be > "
            f"first_moment={first_moment!r} and >= 1"
        )
        raise ValueError(message)
    share = np.linspace(0.0, 1.0, n_plays + 1) ** 2
    knots = first_moment + share * (last_moment - first_moment)
    values = np.concatenate([[first_moment / stiffness], curvature(knots[1:])])
    slopes = np.diff(values) / np.diff(knots)
    steps = np.diff(np.concatenate([[1.0 / stiffness], slopes]))
    if not np.all(np.isfinite(slopes)) or np.any(slopes <= 0.0):
        message = "curvature softens: expected a law whose curvature grows with the moment"
        raise ValueError(message)
    if np.any(steps < -1e-9 * slopes):
        message = (
            f"curvature stiffens at moment={knots[int(np.argmin(steps))]:.4g}: expected a law "
            f"whose slope d(curvature)/d(moment) never falls, from 1/stiffness on"
        )
        raise ValueError(message)
    return PlayLaw(stiffness, knots[:-1], np.maximum(steps, 0.0))


def stick_slip_law(
    *,
    stick_stiffness: float,
    stick_moment: float,
    slip_stiffness: float,
    reference_moment: float,
    hardening: float,
    last_moment: float,
    n_plays: int = 40,
) -> PlayLaw:
    """Return plays for stick, then a power law of slip and yield (Ramberg-Osgood beyond).

    kappa = M / EI0 + (M0 / EI1) (max(M - Ms, 0) / M0)^(1 / n), cut into plays.

    Parameters
    ----------
    stick_stiffness : EI0, N m^2
    stick_moment : Ms, N m, up to which everything sticks
    slip_stiffness : EI1, N m^2: secant stiffness of the power law alone at Ms + `reference_moment`
    reference_moment : M0, N m
    hardening : n between 0 (perfectly plastic) and 1 (two straight lines)
    last_moment : N m, end of the fit
    n_plays : number of plays

    Returns
    -------
    The law.

    Raises
    ------
    ValueError
        If a number is out of its range.
    """
    for name, value in (("slip_stiffness", slip_stiffness), ("reference_moment", reference_moment)):
        require_positive(name, value)
    if not 0.0 < hardening < 1.0:
        message = f"hardening={hardening!r}: must be between 0 and 1"
        raise ValueError(message)

    def curvature(moment: Floats) -> Floats:
        beyond = np.maximum(moment - stick_moment, 0.0) / reference_moment
        flow: Floats = reference_moment / slip_stiffness * beyond ** (1.0 / hardening)
        return moment / stick_stiffness + flow

    return fit_plays(
        curvature,
        stiffness=stick_stiffness,
        first_moment=stick_moment,
        last_moment=last_moment,
        n_plays=n_plays,
    )
