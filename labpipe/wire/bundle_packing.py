"""Round wires drawn together until they touch, and how full a conduit around them is.

Least is the sum of diameter^2 x squared distance from the middle, without any overlap: a bore, as
in `wire.packing`, leaves wires loose in the gaps, a pull to the middle leaves none. The start is
first let go in the soft energy of that module, eqs. (3.1)-(3.4) of the source, with the pull in
place of the bore; then the overlaps that the pull left are forbidden (sequential least squares).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize

from labpipe.law.plays import require_positive
from labpipe.records.arrays import Floats
from labpipe.wire.packing import squared_overlaps

_PULLS = (0.1, 1e-2)
"""Weights of the pull against squared overlaps, one after the other."""
_NEIGHBOURS = 1.4
"""Distance, in touching ones, up to which a pair is kept from overlapping at the end; others are
too far apart to meet."""
_APART = 1e-3
"""Of a diameter: wires that lie on one another know no way apart, so that they get one."""


def drawn_together(centres: Floats, diameters: Floats) -> Floats:
    """Draw wires together until they touch, from where they are.

    Parameters
    ----------
    centres : shape (wires, 2), m, where to start; wires may overlap
    diameters : shape (wires,), m

    Returns
    -------
    Shape (wires, 2), m: no two overlap; centroid of their areas at the origin. A dense heap near
    the start, not the densest of all.
    """
    if len(diameters) == 1:
        return np.zeros((1, 2))
    scale = float(np.mean(diameters))
    reach = diameters / scale
    found = (centres - centres.mean(axis=0)) / scale
    for pull in _PULLS:
        found = _settled(found, reach, pull)
    found = _without_overlap(found, reach)
    found = found * _spread(found, reach)
    return np.asarray(scale * (found - np.average(found, axis=0, weights=reach**2)))


def _settled(begin: Floats, diameters: Floats, pull: float) -> Floats:
    wires = np.arange(len(diameters))
    apart = _APART * np.column_stack([np.cos(wires), np.sin(wires)])
    found = minimize(
        pulled_overlap_energy,
        (begin + (apart if _is_on_one_another(begin) else 0.0)).ravel(),
        args=(diameters, pull),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": 1000},
    )
    return np.asarray(found.x).reshape(-1, 2)


def _without_overlap(begin: Floats, diameters: Floats) -> Floats:
    """Nearest least sum of diameter^2 x squared distance in which neighbours do not overlap."""
    first, second = np.triu_indices(len(diameters), 1)
    touching = 0.5 * (diameters[first] + diameters[second])
    near = np.hypot(*(begin[first] - begin[second]).T) < _NEIGHBOURS * touching
    first, second, touching = first[near], second[near], touching[near]
    weight = np.repeat(diameters**2, 2) / len(diameters)

    def gaps(flat: Floats) -> Floats:
        apart = flat.reshape(-1, 2)[first] - flat.reshape(-1, 2)[second]
        return np.asarray(np.sum(apart**2, axis=1) - touching**2)

    def gap_changes(flat: Floats) -> Floats:
        apart = 2.0 * (flat.reshape(-1, 2)[first] - flat.reshape(-1, 2)[second])
        changes = np.zeros((len(first), len(diameters), 2))
        pairs = np.arange(len(first))
        changes[pairs, first], changes[pairs, second] = apart, -apart
        return changes.reshape(len(first), -1)

    def spread(flat: Floats) -> tuple[float, Floats]:
        return float(np.sum(weight * flat**2)), 2.0 * weight * flat

    apart: Any = {"type": "ineq", "fun": gaps, "jac": gap_changes}
    found = minimize(
        spread,
        begin.ravel(),
        jac=True,
        method="SLSQP",
        constraints=apart,
        options={"ftol": 1e-12, "maxiter": 200},
    )
    return np.asarray(found.x).reshape(-1, 2)


def _is_on_one_another(centres: Floats) -> bool:
    first, second = np.triu_indices(len(centres), 1)
    return bool(np.hypot(*(centres[first] - centres[second]).T).min() == 0.0)


def pulled_overlap_energy(flat: Floats, diameters: Floats, pull: float) -> tuple[float, Floats]:
    """Energy of wires that push each other apart and are pulled to the origin, and its gradient.

    Parameters
    ----------
    flat : shape (2 n,), x and y of one wire after the other
    diameters : shape (n,), in the same unit
    pull : weight of the pull

    Returns
    -------
    Sum over pairs of squared overlaps + pull x sum of diameter^2 x squared distance from the
    origin; gradient, shape (2 n,).
    """
    centres = flat.reshape(-1, 2)
    pairs, push = squared_overlaps(centres, 0.5 * (diameters[:, None] + diameters))
    weight = pull * diameters[:, None] ** 2
    gradient = 2.0 * weight * centres + push
    return float(pairs + np.sum(weight * centres**2)), gradient.ravel()


def _spread(centres: Floats, diameters: Floats) -> float:
    """Factor on all distances that leaves no overlap, at least 1."""
    first, second = np.triu_indices(len(centres), 1)
    distance = np.hypot(*(centres[first] - centres[second]).T)
    return float(max(np.max(0.5 * (diameters[first] + diameters[second]) / distance), 1.0))


def holding_circle(centres: Floats, diameters: Floats) -> tuple[Floats, float]:
    """Find the smallest circle that holds all wires.

    Parameters
    ----------
    centres : shape (wires, 2), m
    diameters : shape (wires,), m

    Returns
    -------
    Its centre, shape (2,), m, and its radius, m.

    Notes
    -----
    The distance to the farthest wire is convex in the centre; it is brought down as a linear
    objective under one cone for each wire (sequential least squares).
    """
    radii = diameters / 2.0
    scale = float(radii.max())
    points, reach = centres / scale, radii / scale
    middle = points.mean(axis=0)
    start = np.append(middle, np.max(np.hypot(*(points - middle).T) + reach))

    def slack(at: Floats) -> Floats:
        return np.asarray(at[2] - reach - np.hypot(*(points - at[:2]).T))

    def radius_of(at: Floats) -> tuple[float, Floats]:
        return float(at[2]), np.array([0.0, 0.0, 1.0])

    held: Any = {"type": "ineq", "fun": slack}
    found = minimize(
        radius_of,
        start,
        jac=True,
        method="SLSQP",
        constraints=held,
        options={"ftol": 1e-12, "maxiter": 200},
    ).x
    radius = np.max(np.hypot(*(points - found[:2]).T) + reach)
    return np.asarray(scale * found[:2]), float(scale * radius)


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
