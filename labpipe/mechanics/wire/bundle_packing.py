"""Densest packing of round wires, and how full a conduit around them is.

The heap sought has the least sum of diameter^2 x squared distance from the middle without any
overlap: a bore, as in `wire.packing`, leaves loose wires in the gaps, a pull to the middle does
not. Wires first relax in a soft energy, eqs. (3.1)-(3.4) of the dissertation with the pull in place
of the bore; then contacts harden until the overlaps that the pull left are gone (method of
multipliers: Hestenes and Powell, 1969), and Newton's method brings the heap to rest. Only
pairs of near wires are evaluated, so that cost grows linearly. The heap is the same on every
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

from labpipe.mechanics.law.plays import require_positive
from labpipe.records.arrays import Floats, Ints

_CONTACT_STIFFNESSES = (10.0, 100.0)
"""Successive stiffnesses of a contact for a pull of 1; low enough for a gradient method."""


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """Wires near each other; arrays of shape (pairs,).

    Parameters
    ----------
    first, second : indices
    touching : distance at which they touch
    force : of the contact at zero overlap
    """

    first: Ints
    second: Ints
    touching: Floats
    force: Floats


def find_densest_heap(starts: Sequence[Floats], diameters: Floats) -> Floats:
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
    # mean diameters; unequal wires can come to rest in a row or around a corner
    shakes = (0.1, 0.3, 1.0, 1.0, 1.0, 1.0)
    max_shaken_share = 0.55  # heaps that fill less are shaken
    pair = 2
    if not (np.all(np.isfinite(starts)) and np.all(diameters > 0.0)):
        message = "a heap of wires: expected finite centres and diameters > 0"
        raise ValueError(message)
    if len(diameters) == 1:
        return np.zeros((1, 2))
    scale = float(np.mean(diameters))
    scaled_diameters = diameters / scale
    heap = _narrowest_heap(
        [(start - start.mean(axis=0)) / scale for start in starts], scaled_diameters
    )
    for number, shake in enumerate(shakes):
        if (
            _filled_share(heap, scaled_diameters) > max_shaken_share
            or len(scaled_diameters) == pair
        ):
            break
        moves = shake * np.random.default_rng(number).normal(size=heap.shape)
        heap = _narrowest_heap([heap, heap + moves], scaled_diameters)
    require_dense(heap, scaled_diameters)
    return np.asarray(scale * (heap - np.average(heap, axis=0, weights=scaled_diameters**2)))


def _narrowest_heap(starts: Sequence[Floats], diameters: Floats) -> Floats:
    """Return the narrowest hard heap from some starts; the first of equally wide ones."""
    width_tolerance = 1e-2  # relative, while wires are soft
    heaps = [_relax_soft(start, diameters) for start in starts]
    widths = np.array(
        [
            find_holding_circle(heap * _scale_apart(heap, diameters), diameters)[1]
            for heap, _ in heaps
        ]
    )
    heap, contacts = heaps[int(np.argmax(widths <= (1.0 + width_tolerance) * widths.min()))]
    heap = _harden(heap, diameters, contacts)
    return np.asarray(heap * _scale_apart(heap, diameters))


def _filled_share(centres: Floats, diameters: Floats) -> float:
    """Return the filled share of the smallest circle around all wires; 0 for unknown positions."""
    radius = find_holding_circle(centres, diameters)[1] if np.all(np.isfinite(centres)) else np.nan
    return compute_packing_fraction(diameters, 2.0 * radius) if np.isfinite(radius) else 0.0


def require_dense(centres: Floats, diameters: Floats) -> None:
    """Refuse a heap whose wires did not come together.

    Parameters
    ----------
    centres : shape (wires, 2)
    diameters : shape (wires,), in the same unit

    Raises
    ------
    ValueError
        If the wires fill less than half of the smallest circle around them; the
        message states the filled share.
    """
    # Of the smallest circle around a heap; two equal wires, the emptiest heap, fill as much.
    min_filled_share = 0.5
    filled = _filled_share(centres, diameters)
    if not filled > min_filled_share * (1.0 - 1e-6):
        message = (
            f"the {len(diameters)} wires did not come together: they fill {filled:.2g} of the "
            f"smallest circle around them, expected at least {min_filled_share:g}"
        )
        raise ValueError(message)


def _separate_coincident(centres: Floats) -> Floats:
    """Separate wires at the same position."""
    gap_diameters = 1e-3  # gives coincident wires a direction in which to move apart
    if len(np.unique(centres, axis=0)) == len(centres):
        return centres
    turn = np.arange(len(centres), dtype=np.float64)
    return np.asarray(centres + gap_diameters * np.column_stack([np.cos(turn), np.sin(turn)]))


def _contacts(centres: Floats, diameters: Floats, before: Contacts | None = None) -> Contacts:
    """List pairs that touch, or could before the next list; keep the forces of an earlier list."""
    neighbour_factor = 1.5  # distance of listed pairs, in touching distances
    max_distance = neighbour_factor * float(diameters.max())
    pairs = cKDTree(centres).query_pairs(max_distance, output_type="ndarray").astype(np.int64)
    first, second = pairs[np.lexsort(pairs.T[::-1])].T
    touching = 0.5 * (diameters[first] + diameters[second])
    is_near = np.hypot(*(centres[first] - centres[second]).T) < neighbour_factor * touching
    first, second, touching = first[is_near], second[is_near], touching[is_near]
    force = np.zeros(len(first))
    if before is not None:
        number = len(diameters)
        old, new = (
            number * pair[0] + pair[1] for pair in ((before.first, before.second), (first, second))
        )
        _, at_old, at_new = np.intersect1d(old, new, assume_unique=True, return_indices=True)
        force[at_new] = before.force[at_old]
    return Contacts(first, second, touching, force)


def _relax_soft(begin: Floats, diameters: Floats) -> tuple[Floats, Contacts]:
    """Return centres of wires that overlap a little, and their contacts."""
    force_tolerance = 1e-3  # of the pull at a mean diameter
    max_start_spread = 1.5  # per spread of wires without gaps
    centres = _separate_coincident(begin)
    spread = np.sqrt(np.sum(centres**2) / len(centres))
    spread /= 0.25 * np.sqrt(2.0 * np.sum(diameters**2))
    centres = centres / max(1.0, spread / max_start_spread)
    contacts = _contacts(centres, diameters)
    for stiffness in _CONTACT_STIFFNESSES:
        centres, contacts = _relax(centres, diameters, contacts, stiffness, force_tolerance)
    return centres, contacts


def _relax(
    begin: Floats, diameters: Floats, contacts: Contacts, stiffness: float, tolerance: float
) -> tuple[Floats, Contacts]:
    """Move wires until the force on each is small; return centres and contacts.

    Fast inertial relaxation (Bitzek et al., 2006, doi:10.1103/PhysRevLett.97.170201): wires move by
    the force on them and stop when they move against it. Only sums, products and roots are used,
    so that every processor takes the same path: rounding decides which of many heaps results.
    """
    list_travel = 0.17  # in least diameters, along x or y: beyond it, unlisted wires could touch
    max_steps = 20000
    steering_start = 0.1  # share of the force in the direction
    patience = 5  # downhill steps before the step grows
    centres, listed, max_travel = begin, begin, list_travel * float(diameters.min())
    longest = 1.0 / np.sqrt(6.0 * stiffness)
    step, steering, downhill, speed = longest, steering_start, 0, np.zeros_like(begin)
    for _ in range(max_steps):
        force = -compute_heap_gradient(centres, diameters, contacts, stiffness)
        if np.max(np.abs(force)) < tolerance / len(diameters):
            break
        if np.sum(force * speed) > 0.0:
            downhill += 1
            if downhill > patience:
                step, steering = min(1.1 * step, longest), 0.99 * steering
        else:
            downhill, step, steering = 0, max(0.5 * step, 0.02 * longest), steering_start
            speed = np.zeros_like(speed)
        speed = speed + step * force
        along = np.sqrt(np.sum(speed * speed) / np.sum(force * force))
        speed = (1.0 - steering) * speed + steering * along * force
        centres = centres + step * speed
        if np.max(np.abs(centres - listed)) > max_travel:
            listed, contacts = centres, _contacts(centres, diameters, contacts)
    return centres, _contacts(centres, diameters, contacts)


def _harden(begin: Floats, diameters: Floats, contacts: Contacts) -> Floats:
    """Return the nearest local minimum of the pull in which neighbours do not overlap."""
    force_tolerance = 1e-5  # of the pull at a mean diameter
    stiffness_growth = 10.0
    max_stiffness = 1e3
    hardening_limits = (4, 8, 1500)  # at least, at most, and over the number of wires in between
    tolerance = 1e-6  # mean diameters, of wires that push each other
    centres, stiffness = begin, _CONTACT_STIFFNESSES[-1]
    lowest, highest, shared = hardening_limits
    for _ in range(max(lowest, min(highest, shared // len(diameters)))):
        force = np.maximum(contacts.force + stiffness * _overlaps(centres, contacts)[0], 0.0)
        is_hard = np.max(np.abs(force - contacts.force), initial=0.0) < stiffness * tolerance
        contacts = replace(contacts, force=force)
        if is_hard:
            break
        stiffness = min(stiffness_growth * stiffness, max_stiffness)
        centres, contacts = _relax(centres, diameters, contacts, stiffness, force_tolerance)
    return _turn_back(_solve_rest(centres, diameters, contacts), begin, diameters)


def _solve_rest(begin: Floats, diameters: Floats, contacts: Contacts) -> Floats:
    """Solve for the equilibrium of hard wires by Newton's method on forces and positions.

    Wires that push each other touch; pull and pushes balance. Redundant contacts (of equal wires)
    and the turn of the whole heap leave the system singular: the smallest step is taken. The
    start is returned where the steps do not shrink.
    """
    rest_tolerance = 1e-13  # mean diameters
    max_step = 1e-2  # mean diameters
    rank_tolerance = 1e-11  # of the largest singular value
    newton_steps = 20
    centres, force, pull = begin, contacts.force, np.repeat(diameters**2 / len(diameters), 2)
    step, number = np.inf, len(diameters)
    for _ in range(newton_steps):
        depth, along = _overlaps(centres, contacts)
        on = (force > 0.0) | (depth > rest_tolerance)
        first, second, u, f = (contacts.first[on], contacts.second[on], along[on], force[on])
        pushes, row = np.zeros((len(f), number, 2)), np.arange(len(f))
        pushes[row, first], pushes[row, second] = -u, u
        push = pushes.reshape(len(f), -1)
        across = np.eye(2) - u[:, :, None] * u[:, None, :]
        turn = -(f / (contacts.touching - depth)[on])[:, None, None] * across
        bend = np.zeros((number, number, 2, 2))
        for wire, other, sign in ((first, first, 1), (second, second, 1), (first, second, -1)):
            np.add.at(bend, (wire, other), sign * turn)
        np.add.at(bend, (second, first), -turn)
        stiff = bend.transpose(0, 2, 1, 3).reshape(2 * number, -1) + np.diag(pull)
        system = np.block([[stiff, push.T], [push, np.zeros((len(f), len(f)))]])
        unbalanced = np.concatenate([pull * centres.ravel() + push.T @ f, depth[on]])
        solution = lstsq(system, -unbalanced, cond=rank_tolerance, lapack_driver="gelsy")[0]
        last, step = step, float(np.max(np.abs(solution[: 2 * number])))
        if step > max(0.5 * last, rest_tolerance) or step > max_step:
            return begin
        centres = centres + solution[: 2 * number].reshape(-1, 2)
        force = force.copy()
        force[on] = np.maximum(f + solution[2 * number :], 0.0)
        if step < rest_tolerance:
            return np.asarray(centres)
    return begin


def _turn_back(centres: Floats, begin: Floats, diameters: Floats) -> Floats:
    """Turn the heap as a whole back to its start; its energy does not depend on the turn."""
    x, y = centres.T
    weight = diameters**2
    angle = np.arctan2(
        weight @ (x * begin[:, 1] - y * begin[:, 0]), weight @ (x * begin[:, 0] + y * begin[:, 1])
    )
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.asarray(centres @ turn)


def compute_heap_gradient(
    centres: Floats, diameters: Floats, contacts: Contacts, stiffness: float
) -> Floats:
    """Return the energy gradient of wires that repel each other and are pulled to the origin.

    Parameters
    ----------
    centres : shape (n, 2)
    diameters : shape (n,), in the same unit
    contacts : pairs, and their forces f
    stiffness : k of a contact

    Returns
    -------
    Shape (n, 2), of (sum of diameter^2 x squared distance from the origin) / 2 n + sum over pairs
    of max(f + k overlap, 0)^2 / 2 k.
    """
    depth, along = _overlaps(centres, contacts)
    force = np.maximum(contacts.force + stiffness * depth, 0.0)
    gradient: Floats = diameters[:, None] ** 2 / len(centres) * centres
    for axis in range(2):
        push = force * along[:, axis]
        gradient[:, axis] += np.bincount(contacts.second, push, len(centres))
        gradient[:, axis] -= np.bincount(contacts.first, push, len(centres))
    return gradient


def _overlaps(centres: Floats, contacts: Contacts) -> tuple[Floats, Floats]:
    """Return the overlap of each pair (negative for a gap) and its direction, second to first."""
    offsets = centres[contacts.first] - centres[contacts.second]
    distance = np.sqrt(offsets[:, 0] ** 2 + offsets[:, 1] ** 2)
    return contacts.touching - distance, offsets / np.where(distance == 0.0, 1.0, distance)[:, None]


def _scale_apart(centres: Floats, diameters: Floats) -> float:
    """Return the factor on all distances that removes overlaps, at least 1."""
    contacts = _contacts(centres, diameters)
    distance = contacts.touching - _overlaps(centres, contacts)[0]
    return float(np.max(contacts.touching / distance, initial=1.0))


def find_holding_circle(centres: Floats, diameters: Floats) -> tuple[Floats, float]:
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
    The distance to the farthest wire is convex in the centre; it is minimised
    under one cone constraint per wire (sequential least squares), first for a few outer wires, then
    also for those outside the circle.
    """
    n_first_wires = 24
    outside_tolerance = 1e-9
    radii = diameters / 2.0
    scale = float(radii.max())
    points, scaled_radii = centres / scale, radii / scale
    middle = points.mean(axis=0)
    chosen = np.argsort(-_extents(points, scaled_radii, middle), kind="stable")[:n_first_wires]
    while True:
        middle, radius = _smallest_circle(points[chosen], scaled_radii[chosen])
        extent = _extents(points, scaled_radii, middle)
        outside = np.flatnonzero(extent > radius * (1.0 + outside_tolerance))
        if not len(np.setdiff1d(outside, chosen)):
            return np.asarray(scale * middle), float(scale * extent.max())
        chosen = np.union1d(chosen, outside)


def _extents(points: Floats, reach: Floats, middle: Floats) -> Floats:
    return np.asarray(np.hypot(*(points - middle).T) + reach)


def _smallest_circle(points: Floats, reach: Floats) -> tuple[Floats, float]:
    """Return middle and radius of the smallest circle around a few circles."""
    middle = points.mean(axis=0)
    start = np.append(middle, np.max(_extents(points, reach, middle)))

    def slack(circle: Floats) -> Floats:
        return np.asarray(circle[2] - _extents(points, reach, circle[:2]))

    def radius_of(circle: Floats) -> tuple[float, Floats]:
        return float(circle[2]), np.array([0.0, 0.0, 1.0])

    constraint: Any = {"type": "ineq", "fun": slack}
    solution = minimize(
        radius_of,
        start,
        jac=True,
        method="SLSQP",
        constraints=constraint,
        options={"ftol": 1e-12, "maxiter": 200},
    ).x
    return np.asarray(solution[:2]), float(np.max(_extents(points, reach, solution[:2])))


WANTED_FRACTION = 0.7
"""Packing fraction for which the dissertation chooses conduits."""


def compute_packing_fraction(diameters: Floats, bore: float) -> float:
    """Return the area of the wires over that of the bore.

    Parameters
    ----------
    diameters : shape (wires,), m, over the insulation
    bore : m, inner diameter of the conduit
    """
    require_positive("bore", bore)
    return float(np.sum(diameters**2) / bore**2)


def compute_bore(diameters: Floats, fraction: float = WANTED_FRACTION) -> float:
    """Return the bore that the wires fill by a wanted share, m.

    Parameters
    ----------
    diameters : shape (wires,), m
    fraction : wanted packing fraction
    """
    require_positive("fraction", fraction)
    return float(np.sqrt(np.sum(diameters**2) / fraction))


def choose_bore(
    diameters: Floats, bores: Sequence[float], *, smallest: float, fraction: float = WANTED_FRACTION
) -> float:
    """Choose among conduits the one whose packing fraction is nearest to the wanted one.

    Parameters
    ----------
    diameters : shape (wires,), m
    bores : m, inner diameters of the available conduits
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
    fitting = [bore for bore in bores if fits_bore(smallest, bore)]
    if not fitting:
        offered = ", ".join(f"{1e3 * bore:.4g}" for bore in bores)
        message = (
            f"the narrowest arrangement found needs a bore of {1e3 * smallest:.4g} mm, "
            f"and the conduits have {offered or 'none'} mm"
        )
        raise ValueError(message)
    return min(
        fitting, key=lambda bore: (abs(compute_packing_fraction(diameters, bore) - fraction), -bore)
    )


def fits_bore(smallest: float, bore: float) -> bool:
    """Return whether a circle of wires fits a bore, both m, within a tolerance of one millionth."""
    return smallest <= bore * (1.0 + 1e-6)
