"""A moment-curvature law as sliders, with history, for simulation programs.

Any concave first loading M(kappa) is a spring and Coulomb sliders side by side (PHYSICS 11), each a
spring of stiffness K_j that slides once it is bent by kappa_j:

    M(kappa) = EI_0 kappa + sum_j K_j stop_j(kappa)      on first loading: K_j min(kappa, kappa_j)

It is the dual of `law.plays`, where curvature follows from moment. After a reversal a slider slides
again after 2 kappa_j, so that loops follow Masing's rule and close. The history is the curvature
a_j at which each slider carries no moment.

In three dimensions curvature and moment are vectors across the wire, and a slider is a vector stop:
it sticks while |kappa - a_j| <= kappa_j, else a_j follows (radial return), isotropically.
Curvatures are in 1/m, moments in N m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from labpipe.law.play_fits import polygon_law
from labpipe.law.plays import PlayLaw, require_positive
from labpipe.law.thinning import thin
from labpipe.records.arrays import ArrayRecord, Floats, Vector

MAX_SLIDERS = 64
"""Largest number of sliders of a law."""


@dataclass(frozen=True, slots=True, eq=False)
class SliderLaw(ArrayRecord):
    """A spring and sliders side by side.

    Parameters
    ----------
    stiffness : EI_0 of the spring, which never slides, N m^2; may be zero
    stiffnesses : shape (sliders,), K_j, N m^2, positive
    slip_curvatures : shape (sliders,), kappa_j, 1/m, positive and increasing
    first, last : 1/m, between which the law was fitted; beyond the last it is linear
    error : largest distance of the first loading from the law it was fitted to, between `first`
        and `last`, as a share of the moment there; 0 where nothing was fitted

    Raises
    ------
    ValueError
        If a number is out of its range.
    """

    stiffness: float
    stiffnesses: Annotated[Floats, "sliders"]
    slip_curvatures: Annotated[Floats, "sliders"]
    first: float
    last: float
    error: float = 0.0

    def __post_init__(self) -> None:
        ArrayRecord.__post_init__(self)
        if not (np.isfinite(self.stiffness) and self.stiffness >= 0.0):
            message = f"stiffness={self.stiffness!r}: must be finite and >= 0"
            raise ValueError(message)
        if not (np.all(np.isfinite(self.stiffnesses)) and np.all(self.stiffnesses > 0.0)):
            message = f"stiffnesses={self.stiffnesses.tolist()}: must be finite and > 0"
            raise ValueError(message)
        widths = self.slip_curvatures
        if widths.size and not (widths[0] > 0.0 and np.all(np.diff(widths) > 0.0)):
            message = f"slip_curvatures={widths.tolist()}: must be positive and increasing"
            raise ValueError(message)
        _require_range(self.first, self.last)

    @property
    def first_stiffness(self) -> float:
        """Return the bending stiffness before sliding, and after every reversal, N m^2."""
        return self.stiffness + float(np.sum(self.stiffnesses))


@dataclass(frozen=True, slots=True, eq=False)
class SliderResponse:
    """Response of sliders to a curvature at each station.

    Parameters
    ----------
    moment : N m, shape (stations,), or (stations, 2) of vectors
    stiffness : d(moment) / d(curvature), N m^2, shape (stations,), or (stations, 2, 2): consistent
        with the step just made
    rests : 1/m, shape (stations, sliders), or (stations, sliders, 2): the history after the step
    """

    moment: Floats
    stiffness: Floats
    rests: Floats


def slider_moment(law: SliderLaw, curvature: Floats) -> Floats:
    """Return the moment of first loading, N m.

    Parameters
    ----------
    law : the law
    curvature : any shape, 1/m, of either sign
    """
    held = np.clip(curvature[..., None], -law.slip_curvatures, law.slip_curvatures)
    return np.asarray(law.stiffness * curvature + held @ law.stiffnesses)


def unbent_rests(law: SliderLaw, n_stations: int, *, is_vector: bool = False) -> Floats:
    """Return the history of a wire that was never bent, 1/m: shape (n_stations, sliders[, 2])."""
    return np.zeros((n_stations, len(law.stiffnesses), *((2,) if is_vector else ())))


def slide(law: SliderLaw, curvature: Floats, rests: Floats) -> SliderResponse:
    """Compute moments at new curvatures in one plane, from the history.

    Parameters
    ----------
    law : the law of every station
    curvature : shape (stations,), 1/m; each is reached monotonically
    rests : shape (stations, sliders), 1/m, before the step

    Notes
    -----
    NaN in gives NaN out. The stiffness where a slider just begins to slide is that of one at rest.
    """
    bent = curvature[:, None] - rests
    held = np.clip(bent, -law.slip_curvatures, law.slip_curvatures)
    moment = law.stiffness * curvature + held @ law.stiffnesses
    stiffness = law.stiffness + (held == bent) @ law.stiffnesses
    return SliderResponse(moment, stiffness, curvature[:, None] - held)


def slide_vector(law: SliderLaw, curvature: Floats, rests: Floats) -> SliderResponse:
    """Compute moment vectors at new curvature vectors, from the history.

    Parameters
    ----------
    law : the law of every station
    curvature : shape (stations, 2), 1/m, across the wire; each is reached along a straight line
    rests : shape (stations, sliders, 2), 1/m, before the step

    Notes
    -----
    Radial return: a slider bent by b = kappa - a, |b| > kappa_j, carries K_j kappa_j b / |b|, and
    d(moment) = K_j kappa_j / |b| (1 - b b^T / |b|^2) d(curvature). A slider that does not slide has
    K_j 1. Exact for straight paths; a curved path needs small steps.
    """
    bent = curvature[:, None, :] - rests
    size = np.sqrt(np.vecdot(bent, bent))
    is_sliding = size > law.slip_curvatures
    size = np.where(is_sliding, size, 1.0)
    shrunk = np.where(is_sliding, law.slip_curvatures / size, 1.0)
    held = bent * shrunk[..., None]
    moment = law.stiffness * curvature + law.stiffnesses @ held
    along = np.where(is_sliding, 1.0 / size, 0.0)[..., None] * bent
    weights = law.stiffnesses * shrunk
    stiffness = (law.stiffness + weights.sum(axis=1))[:, None, None] * np.eye(2)
    stiffness -= np.swapaxes(weights[..., None] * along, 1, 2) @ along
    return SliderResponse(moment, stiffness, curvature[:, None, :] - held)


def as_plays(law: SliderLaw) -> PlayLaw:
    """Return the law as plays, up to the end of its range.

    Parameters
    ----------
    law : with at least one slider, or a stiffness

    Notes
    -----
    Both have the same first loading and Masing's rule, and so the same loops.
    """
    corners = np.append(law.slip_curvatures[law.slip_curvatures < law.last], law.last)
    corners = np.append(0.5 * corners[0], corners) if len(corners) == 1 else corners
    return polygon_law(corners, slider_moment(law, corners))


def fit_sliders(
    curvature: Floats,
    moment: Floats,
    n_sliders: int,
    *,
    first: float = 0.0,
    last: float = np.inf,
    allowed: float = np.inf,
) -> SliderLaw:
    """Fit sliders to the points of a first loading, with the smallest largest error.

    Parameters
    ----------
    curvature : shape (n,), 1/m, from 0, increasing
    moment : shape (n,), N m, from 0, increasing, concave
    n_sliders : largest number; fewer where the law has fewer corners
    first, last : 1/m, range in which the error counts; by default that of the points
    allowed : largest error, as a share of the moment

    Raises
    ------
    ValueError
        If the range is empty or outside of the points; if the law softens, or stiffens by more than
        1 % of its moment (the message states the curvature); if the error is larger than allowed
        (the message states the number of sliders needed).

    Notes
    -----
    Chords between the best points of the law (`thin`) lie below it by at most e; multiplied
    by 1 + e / (2 - e) they are within e / (2 - e) of it, on both sides. Their slopes fall, so that
    the differences of the slopes are the K_j > 0 of least error; non-negative least squares on a
    grid of kappa_j, thinned out afterwards, has a larger error.
    """
    if not 1 <= n_sliders <= MAX_SLIDERS:
        message = f"n_sliders={n_sliders}: must be from 1 to {MAX_SLIDERS}"
        raise ValueError(message)
    x, y, start = within_range(curvature, moment, first, last)
    law = _fit(x, y, n_sliders, start)
    if not law.error <= allowed:
        enough = _number_needed(x, y, start, allowed)
        message = (
            f"{n_sliders} sliders have an error of {100.0 * law.error:.3g} % of the moment, "
            f"expected at most {100.0 * allowed:.3g} %: {enough}"
        )
        raise ValueError(message)
    return law


def _require_range(first: float, last: float) -> None:
    if not (0.0 <= first < last and np.isfinite(last)):
        message = f"first={first!r}, last={last!r}: expected a range of curvatures above zero"
        raise ValueError(message)


def within_range(
    curvature: Floats, moment: Floats, first: float, last: float
) -> tuple[Floats, Floats, float]:
    """Return the points of a law inside a range, with zero before them.

    Parameters
    ----------
    curvature, moment, first, last : as for `fit_sliders`

    Returns
    -------
    Curvatures, 1/m, and moments, N m: zero, the start of the range, the points inside, its end; and
    the start of the range, 1/m.

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    if len(curvature) < 2 or len(curvature) != len(moment) or curvature[0] != 0.0:
        message = (
            f"{len(curvature)} curvatures and {len(moment)} moments: expected equal numbers, "
            "from zero"
        )
        raise ValueError(message)
    end = float(min(last, curvature[-1]))
    start = float(max(first, curvature[1]))
    if np.isfinite(last) and last > curvature[-1] * (1.0 + 1e-9):
        message = f"last={last:.6g} 1/m: the law ends at {curvature[-1]:.6g} 1/m"
        raise ValueError(message)
    _require_range(start, end)
    inside = (curvature > start) & (curvature < end)
    x = np.concatenate([[0.0, start], curvature[inside], [end]])
    y = np.interp(x, curvature, moment)
    _require_concave(x, y)
    return x, y, start


def _require_concave(x: Floats, y: Floats) -> None:
    """Refuse a law that stiffens too much; `thin` refuses one that softens."""
    max_bridged = 0.01  # of the moment, between the law and its concave hull
    slopes = np.diff(y) / np.diff(x)
    if np.all(slopes > 0.0) and np.any(np.diff(slopes) > 0.0):
        hull = thin(x, y, max_points=len(x))
        excess = np.interp(x[1:], hull.curvature, hull.moment) / y[1:] - 1.0
        if np.max(excess) > max_bridged:
            worst = int(np.argmax(excess)) + 1
            message = (
                f"the law stiffens at curvature={x[worst]:.6g} 1/m: its concave hull is "
                f"{100.0 * excess[worst - 1]:.2g} % above it; expected at most "
                f"{100.0 * max_bridged:.0f} %"
            )
            raise ValueError(message)


def _fit(x: Floats, y: Floats, n_sliders: int, start: float) -> SliderLaw:
    chords = thin(x, y, max_points=n_sliders + 2)
    shares = np.interp(x[1:], chords.curvature, chords.moment) / y[1:]
    scale = 2.0 / (float(shares.max()) + float(shares.min()))
    slopes = scale * np.diff(chords.moment) / np.diff(chords.curvature)
    return SliderLaw(
        stiffness=float(slopes[-1]),
        stiffnesses=-np.diff(slopes),
        slip_curvatures=chords.curvature[1:-1],
        first=start,
        last=float(x[-1]),
        error=float(np.max(np.abs(scale * shares - 1.0))),
    )


def _number_needed(x: Floats, y: Floats, start: float, allowed: float) -> str:
    for number in range(1, MAX_SLIDERS + 1):
        if _fit(x, y, number, start).error <= allowed:
            return f"{number} are enough"
    return f"{MAX_SLIDERS} are not enough"


def linear_moment_law(stiffness: float, last: float) -> SliderLaw:
    """Return a constant stiffness as a law without sliders.

    Parameters
    ----------
    stiffness : N m^2
    last : 1/m, end of its range
    """
    require_positive("stiffness", stiffness)
    return SliderLaw(stiffness, np.zeros(0), np.zeros(0), 0.0, last)


def slip_moments(law: SliderLaw) -> Vector:
    """Return the moments at which the sliders slide, K_j kappa_j, N m."""
    return np.asarray(law.stiffnesses * law.slip_curvatures)
