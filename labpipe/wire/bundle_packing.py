"""Round wires drawn together until they touch, and how full a conduit around them is.

The heap sought has the least sum of diameter^2 x squared distance from the middle without any
overlap: a bore, as in `wire.packing`, leaves wires loose in the gaps, a pull to the middle leaves
none. Wires first relax in a soft energy, eqs. (3.1)-(3.4) of the source with the pull in place of
the bore; then contacts harden until the overlaps that the pull left are gone (method of
multipliers: Hestenes and Powell, 1969), and Newton's method brings the heap to rest. Only wires
near each other are looked at, so that cost grows with their number. The heap is the same on every
processor, to 1e-12 of a diameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import lstsq
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from labpipe.law.plays import require_positive
from labpipe.records.arrays import Floats, Ints

_STIFFNESSES = (10.0, 100.0)
"""Of a contact against a pull of 1, one after the other; low enough for a search by gradients."""
_NEIGHBOURS = 1.5
"""Distance, in touching ones, up to which a pair is looked at until the next list of pairs."""
_TRAVEL = 0.17
"""Of the least diameter: how far a wire goes along x or y on one list of pairs, so that none that
is not on the list can be met."""
_LOOSE, _FINE = 1e-3, 1e-5
"""Force left on a wire, of the pull at a mean diameter from the middle: while wires find their
places, and when they have them."""
_STEPS, _STEERING, _PATIENCE = 20000, 0.1, 5
"""Of a relaxation: at most; share of the force in the direction; steps before they grow."""
_WIDEST = 1.5
"""Of the spread of wires without any gaps: a wider start is made as small, so that all arrive."""
_HARDER, _HARDEST = 10.0, 1e3
"""Factor on the stiffness of a contact from one hardening to the next, and where it ends."""
_HARDENINGS = (4, 8, 1500)
"""At least, at most, and in between so many over the number of wires."""
_HARD = 1e-6
"""Of a mean diameter: overlap or gap of wires that push each other at which they count as hard."""
_REST, _FAR = 1e-13, 1e-2
"""Of a mean diameter: the last and the longest step of Newton's method."""
_RANK, _NEWTON_STEPS = 1e-11, 20
"""Share of the largest singular value below which a direction is free; steps at most."""
_APART = 1e-3
"""Of a diameter: wires that lie on one another know no way apart, so that they get one."""
_ALIKE = 1e-2
"""Of a radius: heaps that differ less in theirs are equally wide while wires are soft."""
_SHAKES = (0.1, 0.3, 1.0, 1.0, 1.0, 1.0)
"""Of a mean diameter: unequal wires can come to rest in a row or around a corner, where nothing
pushes them aside; a heap that fills less than `_SHAKEN` is shaken a little, then more."""
_SHAKEN = 0.55
_PAIR = 2
LEAST_FILLED = 0.5
"""Of the smallest circle around a heap: what two equal wires fill, the emptiest of all heaps that
are drawn together."""


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """Wires near each other; arrays of shape (pairs,).

    Parameters
    ----------
    first, second : indices
    touching : distance at which they touch
    force : with which they push each other where they just touch
    """

    first: Ints
    second: Ints
    touching: Floats
    force: Floats


def densest_heap(starts: Sequence[Floats], diameters: Floats) -> Floats:
    """Draw wires together from several starts, and keep the heap in the smallest circle.

    Parameters
    ----------
    starts : at least one, each of shape (wires, 2), m; wires may overlap
    diameters : shape (wires,), m

    Returns
    -------
    Shape (wires, 2), m: no two overlap; centroid of their areas at the origin. Of heaps that are
    equally wide, the first.

    Raises
    ------
    ValueError
        If a number is not finite, or the wires did not come together: they fill less than half
        of the smallest circle around them.
    """
    if not (np.all(np.isfinite(starts)) and np.all(diameters > 0.0)):
        message = "a heap of wires: allowed are finite centres and diameters > 0"
        raise ValueError(message)
    if len(diameters) == 1:
        return np.zeros((1, 2))
    scale = float(np.mean(diameters))
    reach = diameters / scale
    found = _densest([(start - start.mean(axis=0)) / scale for start in starts], reach)
    for number, shake in enumerate(_SHAKES):
        if _filled(found, reach) > _SHAKEN or len(reach) == _PAIR:
            break
        moves = shake * np.random.default_rng(number).normal(size=found.shape)
        found = _densest([found, found + moves], reach)
    require_dense(found, reach)
    return np.asarray(scale * (found - np.average(found, axis=0, weights=reach**2)))


def _densest(starts: Sequence[Floats], diameters: Floats) -> Floats:
    """The narrowest heap of those that come of some starts, hard; the first of equally wide."""
    heaps = [_soft(start, diameters) for start in starts]
    widths = np.array(
        [holding_circle(heap * _spread(heap, diameters), diameters)[1] for heap, _ in heaps]
    )
    found, contacts = heaps[int(np.argmax(widths <= (1.0 + _ALIKE) * widths.min()))]
    found = _hardened(found, diameters, contacts)
    return np.asarray(found * _spread(found, diameters))


def _filled(centres: Floats, diameters: Floats) -> float:
    """Share of the smallest circle around all wires that they fill; 0 where a place is unknown."""
    radius = holding_circle(centres, diameters)[1] if np.all(np.isfinite(centres)) else np.nan
    return packing_fraction(diameters, 2.0 * radius) if np.isfinite(radius) else 0.0


def require_dense(centres: Floats, diameters: Floats) -> None:
    """Refuse a heap whose wires did not come together.

    Parameters
    ----------
    centres : shape (wires, 2)
    diameters : shape (wires,), in the same unit

    Raises
    ------
    ValueError
        If the wires fill less than `LEAST_FILLED` of the smallest circle around them; the message
        says how much they fill.
    """
    filled = _filled(centres, diameters)
    if not filled > LEAST_FILLED * (1.0 - 1e-6):
        message = (
            f"the {len(diameters)} wires did not come together: they fill {filled:.2g} of the "
            f"smallest circle around them, expected at least {LEAST_FILLED:g}"
        )
        raise ValueError(message)


def _parted(centres: Floats) -> Floats:
    """The same, wires at one place a little apart."""
    if len(np.unique(centres, axis=0)) == len(centres):
        return centres
    turn = np.arange(len(centres), dtype=np.float64)
    return np.asarray(centres + _APART * np.column_stack([np.cos(turn), np.sin(turn)]))


def _contacts(centres: Floats, diameters: Floats, before: Contacts | None = None) -> Contacts:
    """Pairs of wires that touch, or could before the next list; forces of an earlier list stay."""
    reach = _NEIGHBOURS * float(diameters.max())
    found = cKDTree(centres).query_pairs(reach, output_type="ndarray").astype(np.int64)
    first, second = found[np.lexsort(found.T[::-1])].T
    touching = 0.5 * (diameters[first] + diameters[second])
    use = np.hypot(*(centres[first] - centres[second]).T) < _NEIGHBOURS * touching
    first, second, touching = first[use], second[use], touching[use]
    force = np.zeros(len(first))
    if before is not None:
        number = len(diameters)
        old, new = (
            number * each[0] + each[1] for each in ((before.first, before.second), (first, second))
        )
        _, at_old, at_new = np.intersect1d(old, new, assume_unique=True, return_indices=True)
        force[at_new] = before.force[at_old]
    return Contacts(first, second, touching, force)


def _soft(begin: Floats, diameters: Floats) -> tuple[Floats, Contacts]:
    """Wires that overlap a little, and their contacts."""
    centres = _parted(begin)
    wide = np.sqrt(np.sum(centres**2) / len(centres))
    wide /= 0.25 * np.sqrt(2.0 * np.sum(diameters**2))
    centres = centres / max(1.0, wide / _WIDEST)
    contacts = _contacts(centres, diameters)
    for stiffness in _STIFFNESSES:
        centres, contacts = _settled(centres, diameters, contacts, stiffness, _LOOSE)
    return centres, contacts


def _settled(
    begin: Floats, diameters: Floats, contacts: Contacts, stiffness: float, tolerance: float
) -> tuple[Floats, Contacts]:
    """Wires where the force on each is small, and their contacts there.

    Fast inertial relaxation (Bitzek et al., 2006, doi:10.1103/PhysRevLett.97.170201): wires move by
    the force on them and stop when they move against it. Only sums, products and roots, so that
    every processor takes the same way: which of many heaps comes out hangs on each rounding.
    """
    centres, listed, reach = begin, begin, _TRAVEL * float(diameters.min())
    longest = 1.0 / np.sqrt(6.0 * stiffness)
    step, steering, downhill, speed = longest, _STEERING, 0, np.zeros_like(begin)
    for _ in range(_STEPS):
        force = -gradient_of_heap(centres, diameters, contacts, stiffness)
        if np.max(np.abs(force)) < tolerance / len(diameters):
            break
        if np.sum(force * speed) > 0.0:
            downhill += 1
            if downhill > _PATIENCE:
                step, steering = min(1.1 * step, longest), 0.99 * steering
        else:
            downhill, step, steering = 0, max(0.5 * step, 0.02 * longest), _STEERING
            speed = np.zeros_like(speed)
        speed = speed + step * force
        along = np.sqrt(np.sum(speed * speed) / np.sum(force * force))
        speed = (1.0 - steering) * speed + steering * along * force
        centres = centres + step * speed
        if np.max(np.abs(centres - listed)) > reach:
            listed, contacts = centres, _contacts(centres, diameters, contacts)
    return centres, _contacts(centres, diameters, contacts)


def _hardened(begin: Floats, diameters: Floats, contacts: Contacts) -> Floats:
    """Nearest least sum of diameter^2 x squared distance in which neighbours do not overlap."""
    centres, stiffness = begin, _STIFFNESSES[-1]
    least, most, shared = _HARDENINGS
    for _ in range(max(least, min(most, shared // len(diameters)))):
        force = np.maximum(contacts.force + stiffness * _depths(centres, contacts)[0], 0.0)
        is_hard = np.max(np.abs(force - contacts.force), initial=0.0) < stiffness * _HARD
        contacts = replace(contacts, force=force)
        if is_hard:
            break
        stiffness = min(_HARDER * stiffness, _HARDEST)
        centres, contacts = _settled(centres, diameters, contacts, stiffness, _FINE)
    return _turned_back(_at_rest(centres, diameters, contacts), begin, diameters)


def _at_rest(begin: Floats, diameters: Floats, contacts: Contacts) -> Floats:
    """Solve for the rest of hard wires to rounding, by Newton's method on forces and places.

    Wires that push each other touch; pull and pushes balance. Redundant contacts (of equal wires)
    and the turn of the whole heap leave the system singular: the smallest step is taken. Where the
    steps do not shrink, the begin is returned.
    """
    centres, force, pull = begin, contacts.force, np.repeat(diameters**2 / len(diameters), 2)
    step, number = np.inf, len(diameters)
    for _ in range(_NEWTON_STEPS):
        depth, along = _depths(centres, contacts)
        on = (force > 0.0) | (depth > _REST)
        first, second, u, f = contacts.first[on], contacts.second[on], along[on], force[on]
        pushes, row = np.zeros((len(f), number, 2)), np.arange(len(f))
        pushes[row, first], pushes[row, second] = -u, u
        push = pushes.reshape(len(f), -1)
        across = np.eye(2) - u[:, :, None] * u[:, None, :]
        turn = -(f / (contacts.touching - depth)[on])[:, None, None] * across
        bend = np.zeros((number, number, 2, 2))
        for one, other, sign in ((first, first, 1), (second, second, 1), (first, second, -1)):
            np.add.at(bend, (one, other), sign * turn)
        np.add.at(bend, (second, first), -turn)
        stiff = bend.transpose(0, 2, 1, 3).reshape(2 * number, -1) + np.diag(pull)
        system = np.block([[stiff, push.T], [push, np.zeros((len(f), len(f)))]])
        unbalanced = np.concatenate([pull * centres.ravel() + push.T @ f, depth[on]])
        change = lstsq(system, -unbalanced, cond=_RANK, lapack_driver="gelsy")[0]
        last, step = step, float(np.max(np.abs(change[: 2 * number])))
        if step > max(0.5 * last, _REST) or step > _FAR:
            return begin
        centres = centres + change[: 2 * number].reshape(-1, 2)
        force = force.copy()
        force[on] = np.maximum(f + change[2 * number :], 0.0)
        if step < _REST:
            return np.asarray(centres)
    return begin


def _turned_back(centres: Floats, begin: Floats, diameters: Floats) -> Floats:
    """The heap turned as a whole to where it began: its energy does not depend on the turn."""
    x, y = centres.T
    weight = diameters**2
    angle = np.arctan2(
        weight @ (x * begin[:, 1] - y * begin[:, 0]), weight @ (x * begin[:, 0] + y * begin[:, 1])
    )
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.asarray(centres @ turn)


def gradient_of_heap(
    centres: Floats, diameters: Floats, contacts: Contacts, stiffness: float
) -> Floats:
    """Gradient of the energy of wires that push each other apart and are pulled to the origin.

    Parameters
    ----------
    centres : shape (n, 2)
    diameters : shape (n,), in the same unit
    contacts : pairs that are looked at, and their forces f
    stiffness : k of a contact

    Returns
    -------
    Shape (n, 2), of (sum of diameter^2 x squared distance from the origin) / 2 n + sum over pairs
    of max(f + k overlap, 0)^2 / 2 k.
    """
    depth, along = _depths(centres, contacts)
    force = np.maximum(contacts.force + stiffness * depth, 0.0)
    gradient: Floats = diameters[:, None] ** 2 / len(centres) * centres
    for axis in range(2):
        push = force * along[:, axis]
        gradient[:, axis] += np.bincount(contacts.second, push, len(centres))
        gradient[:, axis] -= np.bincount(contacts.first, push, len(centres))
    return gradient


def _depths(centres: Floats, contacts: Contacts) -> tuple[Floats, Floats]:
    """Overlap of each pair, negative for a gap, and the direction from second to first."""
    apart = centres[contacts.first] - centres[contacts.second]
    distance = np.sqrt(apart[:, 0] ** 2 + apart[:, 1] ** 2)
    return contacts.touching - distance, apart / np.where(distance == 0.0, 1.0, distance)[:, None]


def _spread(centres: Floats, diameters: Floats) -> float:
    """Factor on all distances that leaves no overlap, at least 1."""
    contacts = _contacts(centres, diameters)
    distance = contacts.touching - _depths(centres, contacts)[0]
    return float(np.max(contacts.touching / distance, initial=1.0))


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
    objective under one cone for each wire (sequential least squares), first for a few wires far
    out, then for those too that the circle left out.
    """
    radii = diameters / 2.0
    scale = float(radii.max())
    points, reach = centres / scale, radii / scale
    middle = points.mean(axis=0)
    chosen = np.argsort(-_extent(points, reach, middle), kind="stable")[:_FEW]
    while True:
        middle, radius = _circle(points[chosen], reach[chosen])
        extent = _extent(points, reach, middle)
        outside = np.flatnonzero(extent > radius * (1.0 + _OUTSIDE))
        if not len(np.setdiff1d(outside, chosen)):
            return np.asarray(scale * middle), float(scale * extent.max())
        chosen = np.union1d(chosen, outside)


_FEW = 24
_OUTSIDE = 1e-9


def _extent(points: Floats, reach: Floats, middle: Floats) -> Floats:
    return np.asarray(np.hypot(*(points - middle).T) + reach)


def _circle(points: Floats, reach: Floats) -> tuple[Floats, float]:
    """Middle and radius of the smallest circle around a few circles."""
    middle = points.mean(axis=0)
    start = np.append(middle, np.max(_extent(points, reach, middle)))

    def slack(at: Floats) -> Floats:
        return np.asarray(at[2] - _extent(points, reach, at[:2]))

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
    return np.asarray(found[:2]), float(np.max(_extent(points, reach, found[:2])))


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
            f"the narrowest arrangement found needs a bore of {1e3 * smallest:.4g} mm, "
            f"and the conduits have {offered or 'none'} mm"
        )
        raise ValueError(message)
    return min(fitting, key=lambda bore: (abs(packing_fraction(diameters, bore) - fraction), -bore))


def fits(smallest: float, bore: float) -> bool:
    """Tell whether a circle of wires goes into a bore, both m; alike within a millionth do."""
    return smallest <= bore * (1.0 + 1e-6)
