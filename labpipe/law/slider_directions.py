"""Scalar sliders in a few directions in place of vector sliders, for programs without them.

D directions across the wire, at 180 / D degrees from each other, each with the same spring and
sliders on its component of the curvature. Such a spring is isotropic from D = 2 on, sliders are
not: they slide earlier along one of the directions than in between. With one slider that slides at
kappa_j, stiffness 2 K / D and moment pi K kappa_j / 2 D in each direction carry K kappa_j on
average once all slide (PHYSICS 11). Before that they carry less, so that several sliders are fitted
together to the moment of the vector sliders.

Nodes of a chain may have their directions turned from one to the next (`TURNS`): their
errors cancel, and four of them together are nearly isotropic.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated

import numpy as np
from scipy.optimize import nnls

from labpipe.law.sliders import SliderLaw, slider_moment
from labpipe.records.arrays import ArrayRecord, Floats

MAX_SLIDERS_PER_DIRECTION = 16
"""Largest number in each direction."""
TURNS = (0.0, 0.5, 0.25, 0.75)
"""Turns of successive nodes, as shares of the angle between two directions."""

_N_ANGLES = 13


@dataclass(frozen=True, slots=True, eq=False)
class DirectionalLaw(ArrayRecord):
    """The same spring and scalar sliders in each of a few directions across the wire.

    Parameters
    ----------
    directions : D; the first is the first axis across the wire
    stiffness : of the spring in each direction, N m^2
    stiffnesses : shape (sliders,), N m^2, in each direction
    slip_curvatures : shape (sliders,), 1/m, of the component in that direction
    error : largest difference of the moment along the curvature from that of the vector sliders, on
        first loading in any direction, as a share of it
    sideways : largest moment across the curvature, as a share of that along it
    """

    directions: int
    stiffness: float
    stiffnesses: Annotated[Floats, "sliders"]
    slip_curvatures: Annotated[Floats, "sliders"]
    error: float
    sideways: float

    @property
    def normals(self) -> Floats:
        """Return the directions, unit vectors, shape (directions, 2)."""
        return self.turned_normals(0.0)

    def turned_normals(self, share: float) -> Floats:
        """Return the directions, turned by a share of the angle between two of them."""
        angle = np.pi * (np.arange(self.directions) + share) / self.directions
        return np.column_stack([np.cos(angle), np.sin(angle)])


@lru_cache(maxsize=16)  # laws are hashed by identity
def in_directions(
    law: SliderLaw, directions: int, *, max_sliders: int = MAX_SLIDERS_PER_DIRECTION
) -> DirectionalLaw:
    """Fit scalar sliders in a few directions to vector sliders.

    Parameters
    ----------
    law : vector sliders
    directions : D, at least 2
    max_sliders : largest number of sliders in each direction

    Raises
    ------
    ValueError
        If there are fewer than two directions, or no slider is allowed.

    Notes
    -----
    Non-negative least squares of the moment along the curvature, relative to that of the vector
    sliders and as a mean over all directions, on a grid of slip curvatures; then the nearest
    ones are merged until few enough are left.
    """
    n_slips = 48  # slip curvatures to choose from
    last_factor = 1.6  # vector sliders slide together, scalar ones only until there
    if directions < 2:
        message = f"directions={directions}: must be >= 2"
        raise ValueError(message)
    if max_sliders < 1:
        message = f"max_sliders={max_sliders}: must be >= 1"
        raise ValueError(message)
    size = _curvatures(law)
    target = slider_moment(law, size)
    if not law.stiffnesses.size:
        slips, stiffnesses = np.zeros(0), np.array([law.stiffness])
    else:
        ends = (0.5 * law.slip_curvatures[0], min(last_factor * law.slip_curvatures[-1], law.last))
        slips = np.geomspace(*ends, n_slips)
        stiffnesses = _fit_stiffnesses(size, target, slips, directions)
        while np.count_nonzero(stiffnesses[1:]) > max_sliders or not np.all(stiffnesses[1:]):
            slips = _fewer_slips(slips, stiffnesses[1:])
            stiffnesses = _fit_stiffnesses(size, target, slips, directions)
    springs = 2.0 * stiffnesses / directions
    scalar_law = DirectionalLaw(directions, float(springs[0]), springs[1:], slips, 0.0, 0.0)
    return _with_errors(law, scalar_law)


def turned(law: SliderLaw, few: DirectionalLaw) -> DirectionalLaw:
    """Return the mean of neighbouring nodes whose directions are turned by `TURNS`.

    Parameters
    ----------
    law : vector sliders
    few : scalar sliders of each node

    Returns
    -------
    The mean of the nodes: four times the directions, each with a quarter of the stiffness.
    """
    count = len(TURNS)
    mean = replace(
        few,
        directions=count * few.directions,
        stiffness=few.stiffness / count,
        stiffnesses=few.stiffnesses / count,
    )
    return _with_errors(law, mean)


def _curvatures(law: SliderLaw) -> Floats:
    n_sizes = 80
    return np.geomspace(law.first, law.last, n_sizes)


def _with_errors(law: SliderLaw, scalar_law: DirectionalLaw) -> DirectionalLaw:
    """Return the law with its largest errors."""
    size = _curvatures(law)
    target = slider_moment(law, size)
    along, aside = _components(scalar_law, size)
    return replace(
        scalar_law,
        error=float(np.max(np.abs(along / target[:, None] - 1.0))),
        sideways=float(np.max(np.abs(aside / target[:, None]))),
    )


def _fit_stiffnesses(size: Floats, target: Floats, slips: Floats, directions: int) -> Floats:
    """Fit the stiffness of the spring, then of the sliders, as vector sliders, N m^2."""
    columns = np.column_stack([size, _mean_held(size, slips, directions)]) / target[:, None]
    return np.asarray(nnls(columns, np.ones(len(size)))[0])


def _mean_held(size: Floats, slips: Floats, directions: int) -> Floats:
    """Return the mean held curvature along the curvature, over all its directions, 1/m.

    Shape (curvatures, slips). A slider whose component of the curvature is p slides from slip / p
    on: sorted by p, those that slide are the last ones.
    """
    turn = np.linspace(0.0, np.pi / directions, _N_ANGLES)[:-1]
    parts = np.sort(
        np.abs(np.cos(turn[:, None] - np.pi * np.arange(directions) / directions)).ravel()
    )
    at_rest = np.searchsorted(parts, slips / size[:, None])
    squares = np.append(0.0, np.cumsum(parts**2))[at_rest]
    sliding = np.append(np.cumsum(parts[::-1])[::-1], 0.0)[at_rest]
    return 2.0 / directions / len(turn) * (squares * size[:, None] + sliding * slips)


def _fewer_slips(slips: Floats, stiffnesses: Floats) -> Floats:
    """Drop slip curvatures without stiffness; if there is none, merge the two nearest."""
    loaded = slips[stiffnesses > 0.0]
    if len(loaded) < len(slips):
        return np.asarray(loaded)
    near = int(np.argmin(np.diff(np.log(loaded))))
    middle = np.sqrt(loaded[near] * loaded[near + 1])
    return np.concatenate([loaded[:near], [middle], loaded[near + 2 :]])


def _components(law: DirectionalLaw, size: Floats) -> tuple[Floats, Floats]:
    """Return the moment along and across the curvature, N m, shape (curvatures, angles).

    Angles go from a direction to the middle between two; the rest follows by symmetry.
    """
    turn = np.linspace(0.0, 0.5 * np.pi / law.directions, _N_ANGLES + 1)
    towards = np.column_stack([np.cos(turn), np.sin(turn)])
    parts = towards @ law.normals.T
    corners = np.concatenate([[0.0], law.slip_curvatures, [2.0 * max(size[-1], 1.0)]])
    held = np.minimum(corners[:, None], law.slip_curvatures) @ law.stiffnesses
    bent = size[:, None, None] * parts
    moment = np.sign(bent) * np.interp(np.abs(bent), corners, law.stiffness * corners + held)
    along = np.sum((moment @ law.normals) * towards, axis=2)
    aside = np.column_stack([-towards[:, 1], towards[:, 0]])
    return along, np.sum((moment @ law.normals) * aside, axis=2)
