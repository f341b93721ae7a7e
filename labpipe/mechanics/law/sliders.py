"""Define moment-curvature laws that compute the moment from the curvature and its history.

Any concave first loading M(kappa) is that of a spring and Coulomb sliders in parallel. A slider is
a spring of stiffness K_j that slides when its curvature reaches kappa_j:

    M(kappa) = EI_0 kappa + sum_j K_j stop_j(kappa)      on first loading: K_j min(kappa, kappa_j)

The law is the dual of `law.plays`, where the curvature follows from the moment. After a reversal a
slider slides again after 2 kappa_j, so that loops follow Masing's rule and close. The history of a
slider is its rest curvature a_j, at which it has no moment.

In three dimensions curvature and moment are vectors normal to the wire, and a slider is a vector
stop. It sticks while |kappa - a_j| <= kappa_j, else a_j follows (radial return), isotropically.
Curvatures are in 1/m, moments in N m.

Annealed copper hardens isotropically and kinematically. A fraction m of the moment of its strands,
the *isotropic share*, has a limit that grows with the curvature that has slid. It is represented by
a growing slider. The other fraction follows Masing's rule. First loading is the same for every m,
but unloading and reloading depend on m.

M is the moment of the strands at a curvature of first loading. The growing slider has the stiffness
S = m EI of the strands, the slid curvature q = kappa - M / EI, and the limit L(q) = m M, a polygon.
It sticks while |S (kappa - p)| is at most L(q). Otherwise its rest curvature p follows the
curvature by as much as q grows. Unlike that of real copper, the limit does not saturate; the law is
valid for about three cycles.

For programs without vector sliders, scalar sliders in a few directions replace them. D directions
normal to the wire, at 180 / D degrees from each other, have the same spring and sliders, which act
on the component of the curvature in their direction. The springs are isotropic for D >= 2. Sliders
are not isotropic, because they slide earlier along a direction than between two directions. For one
slider that slides at kappa_j, a stiffness of 2 K / D and a moment of pi K kappa_j / 2 D in each
direction give the mean moment K kappa_j once all slide. Before that the moment is smaller, so that
several sliders are fitted together to the moment of the vector sliders. The directions may be
rotated from one node of a chain to the next (`TURNS`). The errors then cancel, and four nodes
together are nearly isotropic.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Annotated

import numpy as np
from scipy.optimize import nnls

from labpipe.mechanics.law.plays import (
    PlayLaw,
    Response,
    make_polygon_law,
    require,
    require_not_negative,
    require_positive,
    require_rising,
)
from labpipe.mechanics.law.thinning import find_hull, require_concave, thin_law
from labpipe.records.arrays import ArrayRecord, Floats, Vector

MAX_SLIDERS = 64
"""Largest number of sliders of a law."""


@dataclass(frozen=True, slots=True, eq=False)
class SliderResponse:
    """Response of sliders to a curvature at each station.

    Parameters
    ----------
    moment : shape (stations,), or (stations, 2) for vectors, N m
    stiffness : shape (stations,), or (stations, 2, 2) for vectors, N m^2, derivative of the moment
        with respect to curvature, consistent with the step
    rests : shape (stations, n), or (stations, n, 2) for vectors, 1/m, history after the step. First
        the rest curvature of each slider; then, for each growing slider, its rest curvature and its
        slid curvature, which is a scalar (in the first component of a vector)
    """

    moment: Floats
    stiffness: Floats
    rests: Floats


@dataclass(frozen=True, eq=False)
class GrowingSlider(ArrayRecord):
    """A slider whose limit grows with the curvature that has slid.

    Parameters
    ----------
    stiffness : S, N m^2, stiffness while it sticks
    slid : q, shape (corners,), 1/m, slid curvature, from 0, increasing, at least two corners
    limits : L(q), shape (corners,), N m, positive, not decreasing; the last slope continues

    Raises
    ------
    ValueError
        If a number is out of its range.
    """

    stiffness: float
    slid: Annotated[Floats, "corners"]
    limits: Annotated[Floats, "corners"]

    def __post_init__(self) -> None:
        ArrayRecord.__post_init__(self)
        require_positive("stiffness", self.stiffness)
        holds = len(self.slid) >= 2 and self.slid[0] == 0.0 and np.all(np.diff(self.slid) > 0.0)
        require("slid", self.slid.tolist(), "from zero and increasing", holds=bool(holds))
        holds = self.limits[0] > 0.0 and bool(np.all(np.diff(self.limits) >= 0.0))
        require("limits", self.limits.tolist(), "positive and not decreasing", holds=holds)

    @cached_property
    def _growth(self) -> tuple[Floats, Floats]:
        """Return L(q) + S q at the corners, N m, and the derivative of q with respect to it."""
        sums = self.limits + self.stiffness * self.slid
        return sums, np.diff(self.slid) / np.diff(sums)

    def scale(self, factor: float) -> GrowingSlider:
        """Return the slider with moments multiplied by a positive factor."""
        return GrowingSlider(factor * self.stiffness, self.slid, factor * self.limits)

    def compute_limit(self, slid: Floats) -> Floats:
        """Return the limit for slid curvatures of any shape, N m."""
        panel = self.slid[1:-1].searchsorted(slid, side="right")
        slopes = np.diff(self.limits) / np.diff(self.slid)
        return np.asarray(self.limits[panel] + slopes[panel] * (slid - self.slid[panel]))

    def compute_first_loading(self, curvature: Floats) -> Floats:
        """Return the moment of first loading at curvatures of any shape, not negative, N m."""
        moment = self.stiffness * curvature
        growth, _ = self._grow(moment, np.zeros_like(moment))
        return np.asarray(moment - self.stiffness * growth)

    def slide(self, curvature: Floats, history: Floats) -> SliderResponse:
        """Compute the moments after a step to new curvatures, each along a straight line.

        Parameters
        ----------
        curvature : shape (stations, axes), 1/m, components of the curvature
        history : shape (stations, 2, axes), 1/m, rest curvature p, and slid curvature q in the
            first component
        """
        rest, slid = history[:, 0], history[:, 1, 0]
        trial = self.stiffness * (curvature - rest)
        size = np.sqrt(np.vecdot(trial, trial))
        growth, tangent = self._grow(size, slid)
        divisor = np.where(size > 0.0, size, 1.0)
        direction = trial / divisor[:, None]
        lateral = self.stiffness * (1.0 - self.stiffness * growth / divisor)
        stiffness = (tangent - lateral)[:, None, None] * direction[:, :, None]
        stiffness = stiffness * direction[:, None, :]
        stiffness += lateral[:, None, None] * np.eye(curvature.shape[1])
        rest, new_history = rest + growth[:, None] * direction, np.zeros_like(history)
        new_history[:, 0], new_history[:, 1, 0] = rest, slid + growth
        return SliderResponse(self.stiffness * (curvature - rest), stiffness, new_history)

    def _grow(self, moment: Floats, slid: Floats) -> tuple[Floats, Floats]:
        """Return the growth of q under a trial moment, 1/m, and the stiffness along it, N m^2.

        The new q solves L(q) + S q = moment + S slid. If it is not larger than `slid`, the slider
        sticks. With g = L(q) + S q, dM = S (1 - S dq/dg) d(kappa).
        """
        sums, slopes = self._growth
        total = moment + self.stiffness * slid
        panel = sums[1:-1].searchsorted(total, side="right")
        slope = slopes[panel]
        growth = np.maximum(self.slid[panel] + slope * (total - sums[panel]) - slid, 0.0)
        tangent = self.stiffness * np.where(growth > 0.0, 1.0 - self.stiffness * slope, 1.0)
        return growth, tangent


def make_growing_slider(curvature: Floats, moment: Floats, share: float) -> GrowingSlider:
    """Build the growing slider of the isotropic share of the strands' first loading.

    Parameters
    ----------
    curvature : shape (n,), 1/m, positive; the first point is elastic
    moment : shape (n,), N m, moment of the strands about their own axes
    share : isotropic share m, above 0 and at most 1

    Raises
    ------
    ValueError
        If the share or the curve is out of its range.
    """
    require("share", share, "above 0 and at most 1", holds=0.0 < share <= 1.0)
    stiffness = float(moment[0] / curvature[0])
    slid = np.maximum.accumulate(np.append(0.0, (curvature - moment / stiffness)[1:]))
    is_rising = np.diff(slid, prepend=-1.0) > 1e-12 * slid[-1]
    limits = share * np.maximum.accumulate(moment)
    return GrowingSlider(share * stiffness, slid[is_rising], limits[is_rising])


@dataclass(frozen=True, slots=True, eq=False)
class SliderLaw(ArrayRecord):
    """A spring and sliders in parallel.

    Parameters
    ----------
    stiffness : EI_0, N m^2, stiffness of the spring, which never slides; may be zero
    stiffnesses : K_j, shape (sliders,), N m^2, positive
    slip_curvatures : kappa_j, shape (sliders,), 1/m, positive and increasing
    first, last : 1/m, ends of the range to which the law was fitted; it is linear beyond the last
    error : largest difference of the first loading from the law to which it was fitted, between
        `first` and `last`, relative to the moment; 0 if nothing was fitted
    growing : further sliders with growing limits (isotropic hardening)

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
    growing: tuple[GrowingSlider, ...] = ()

    def __post_init__(self) -> None:
        ArrayRecord.__post_init__(self)
        require_not_negative("stiffness", self.stiffness)
        are_valid = bool(np.all((self.stiffnesses > 0.0) & np.isfinite(self.stiffnesses)))
        require("stiffnesses", self.stiffnesses.tolist(), "finite and > 0", holds=are_valid)
        require_rising("slip_curvatures", self.slip_curvatures)
        holds = 0.0 <= self.first < self.last < np.inf
        require("range", (self.first, self.last), ">= 0 and increasing", holds=holds)

    @property
    def history_size(self) -> int:
        """Return the number of values of the history at a station, n of `SliderResponse`."""
        return len(self.stiffnesses) + 2 * len(self.growing)

    @property
    def first_stiffness(self) -> float:
        """Return the bending stiffness before sliding, and after every reversal, N m^2."""
        growing = sum(slider.stiffness for slider in self.growing)
        return self.stiffness + float(np.sum(self.stiffnesses)) + growing


def share_hardening(law: SliderLaw, strands: GrowingSlider, share: float) -> SliderLaw:
    """Replace a fraction of the strands' hardening in a law by a growing slider.

    Parameters
    ----------
    law : law with sliders that contain the bending of the strands about their own axes
    strands : growing slider of that bending for an isotropic share of 1
    share : isotropic share, from 0 to 1; with 0 the law is returned unchanged

    Returns
    -------
    A law with the same moments of first loading at its slip curvatures and at the end of its range.
    A stiffness that would become negative is zero, or nearly zero for a slider.
    """
    min_relative_stiffness = 1e-9  # of a slider, relative to the first stiffness
    if share == 0.0:
        return law
    growing = strands.scale(share)
    corners = np.concatenate([[0.0], law.slip_curvatures, [law.last]])
    slopes = np.diff(growing.compute_first_loading(corners)) / np.diff(corners)
    return replace(
        law,
        stiffness=max(law.stiffness - float(slopes[-1]), 0.0),
        stiffnesses=np.maximum(
            law.stiffnesses + np.diff(slopes), min_relative_stiffness * law.first_stiffness
        ),
        growing=(*law.growing, growing),
    )


@dataclass(frozen=True, slots=True, eq=False)
class CurrentSliders:
    """All sliders of a law with their current limits; growing sliders are the last.

    Parameters
    ----------
    stiffnesses : shape (sliders,), N m^2
    slip_curvatures : shape (..., sliders), 1/m
    rests : shape (..., sliders, 2), 1/m, rest curvatures
    """

    stiffnesses: Floats
    slip_curvatures: Floats
    rests: Floats


def find_current_sliders(law: SliderLaw, rests: Floats) -> CurrentSliders:
    """Find the current limits of the sliders of a law.

    Parameters
    ----------
    law : law of every station
    rests : shape (..., n, 2), 1/m, history, as in `SliderResponse`
    """
    count = len(law.stiffnesses)
    slips = [np.broadcast_to(law.slip_curvatures, (*rests.shape[:-2], count))]
    rest_indices = [*range(count), *range(count, rests.shape[-2], 2)]
    for index, slider in enumerate(law.growing):
        limit = slider.compute_limit(rests[..., count + 2 * index + 1, 0])
        slips.append((limit / slider.stiffness)[..., None])
    stiffnesses = np.append(law.stiffnesses, [slider.stiffness for slider in law.growing])
    return CurrentSliders(stiffnesses, np.concatenate(slips, axis=-1), rests[..., rest_indices, :])


def compute_slider_moment(law: SliderLaw, curvature: Floats) -> Floats:
    """Return the moment of first loading, N m.

    Parameters
    ----------
    law : law of the wire
    curvature : any shape, 1/m, any sign
    """
    slider_curvature = np.clip(curvature[..., None], -law.slip_curvatures, law.slip_curvatures)
    moment = np.asarray(law.stiffness * curvature + slider_curvature @ law.stiffnesses)
    for slider in law.growing:
        moment = moment + np.sign(curvature) * slider.compute_first_loading(np.abs(curvature))
    return moment


def make_unbent_rests(law: SliderLaw, n_stations: int, *, is_vector: bool = False) -> Floats:
    """Return the history of a wire that was never bent, 1/m, as in `SliderResponse`."""
    return np.zeros((n_stations, law.history_size, *((2,) if is_vector else ())))


def slide(law: SliderLaw, curvature: Floats, rests: Floats) -> SliderResponse:
    """Compute moments at new curvatures in one plane, from the history.

    Parameters
    ----------
    law : law of every station
    curvature : shape (stations,), 1/m; each is reached monotonically
    rests : shape (stations, n), 1/m, history before the step, as in `SliderResponse`

    Notes
    -----
    For a curvature of NaN, moment and history are NaN. If a slider just begins to slide, the
    stiffness is that of a slider that sticks.
    """
    trial_curvature = curvature[:, None] - rests[:, : len(law.stiffnesses)]
    slider_curvature = np.clip(trial_curvature, -law.slip_curvatures, law.slip_curvatures)
    moment = law.stiffness * curvature + slider_curvature @ law.stiffnesses
    stiffness = law.stiffness + (slider_curvature == trial_curvature) @ law.stiffnesses
    new_rests = [curvature[:, None] - slider_curvature]
    for slider, history in _split_history(law, rests):
        response = slider.slide(curvature[:, None], history[:, :, None])
        moment, stiffness = moment + response.moment[:, 0], stiffness + response.stiffness[:, 0, 0]
        new_rests.append(response.rests[:, :, 0])
    return SliderResponse(moment, stiffness, np.concatenate(new_rests, axis=1))


def slide_vector(law: SliderLaw, curvature: Floats, rests: Floats) -> SliderResponse:
    """Compute moment vectors at new curvature vectors, from the history.

    Parameters
    ----------
    law : law of every station
    curvature : shape (stations, axes), 1/m, components along the axes normal to the wire; each
        vector is reached along a straight line
    rests : shape (stations, n, axes), 1/m, history before the step, as in `SliderResponse`

    Notes
    -----
    The update is a radial return. A slider with b = kappa - a, |b| > kappa_j, has the moment
    K_j kappa_j b / |b| and d(moment) = K_j kappa_j / |b| (1 - b b^T / |b|^2) d(curvature). A slider
    that sticks has the stiffness K_j in every direction. The update is exact for a straight path; a
    curved path requires small steps.
    """
    count, slips = len(law.stiffnesses), law.slip_curvatures
    trial_curvature = curvature[:, None, :] - rests[:, :count]
    size = np.sqrt(np.vecdot(trial_curvature, trial_curvature))
    elastic_fraction = slips / np.maximum(size, slips)
    slider_curvature = trial_curvature * elastic_fraction[..., None]
    moment = law.stiffness * curvature + law.stiffnesses @ slider_curvature
    direction = ((size > slips) / slips)[..., None] * slider_curvature  # zero while it sticks
    weights = law.stiffnesses * elastic_fraction
    stiffness = (law.stiffness + weights.sum(axis=1))[:, None, None] * np.eye(curvature.shape[1])
    stiffness -= np.swapaxes(weights[..., None] * direction, 1, 2) @ direction
    new_rests = [curvature[:, None, :] - slider_curvature]
    for slider, history in _split_history(law, rests):
        response = slider.slide(curvature, history)
        moment, stiffness = moment + response.moment, stiffness + response.stiffness
        new_rests.append(response.rests)
    return SliderResponse(moment, stiffness, np.concatenate(new_rests, axis=1))


def _split_history(law: SliderLaw, rests: Floats) -> Iterator[tuple[GrowingSlider, Floats]]:
    """Yield each growing slider with its history."""
    for start, slider in zip(
        range(len(law.stiffnesses), law.history_size, 2), law.growing, strict=True
    ):
        yield slider, rests[:, start : start + 2]


def bend_to_moment(
    law: SliderLaw, moment: Floats, curvature: Floats, rests: Floats
) -> tuple[Floats, SliderResponse]:
    """Find the curvatures at which the moments have new values, from the history.

    Parameters
    ----------
    law : law of every station
    moment : shape (stations,), N m; each is reached monotonically
    curvature : shape (stations,), 1/m, curvatures before the step
    rests : shape (stations, n), 1/m, history before the step

    Returns
    -------
    Curvatures, 1/m, and the response there. For a moment of NaN the curvature is NaN.

    Notes
    -----
    The magnitude of the change of moment is a concave, piecewise linear function of that of the
    curvature. Newton's method therefore converges from below in a finite number of steps. It begins
    with the stiffness of sliders that all stick, for a change of any sign.
    """
    max_iterations = 60
    count = len(law.stiffnesses)
    start = law.stiffness * curvature + (curvature[:, None] - rests[:, :count]) @ law.stiffnesses
    for slider, history in _split_history(law, rests):
        start = start + slider.stiffness * (curvature - history[:, 0])
    rounding = 1e-13 * max(np.abs(moment).max(initial=0.0), np.abs(start).max(initial=0.0))
    residual, stiffness = moment - start, law.first_stiffness + np.zeros_like(moment)
    for _ in range(max_iterations):
        curvature = curvature + residual / stiffness
        response = slide(law, curvature, rests)
        residual, stiffness = moment - response.moment, response.stiffness
        if np.all(np.abs(residual) <= rounding):
            break
    return curvature, response


def convert_to_plays(law: SliderLaw) -> PlayLaw:
    """Convert a law to plays, up to the end of its range.

    Parameters
    ----------
    law : law with at least one slider, or a stiffness

    Notes
    -----
    Both have the same first loading and follow Masing's rule, so that their loops are the same. The
    plays have the first loading of growing sliders at the corners only.
    """
    corners = np.append(law.slip_curvatures[law.slip_curvatures < law.last], law.last)
    corners = np.append(0.5 * corners[0], corners) if len(corners) == 1 else corners
    return make_polygon_law(corners, compute_slider_moment(law, corners))


def fit_sliders(curvature: Floats, moment: Floats, n_sliders: int) -> SliderLaw:
    """Fit sliders to the points of a first loading so that the largest error is smallest.

    Parameters
    ----------
    curvature : shape (n,), 1/m, from 0, increasing
    moment : shape (n,), N m, from 0, increasing, concave
    n_sliders : largest number of sliders; there are fewer if the law has fewer corners

    Raises
    ------
    ValueError
        As `thin_law` and `require_concave`. If `n_sliders` is out of its range.

    Notes
    -----
    Chords between the best points of the law (`thin_law`) lie below it by at most a fraction e. If
    they are multiplied by 1 + e / (2 - e), they are within e / (2 - e) of the law, on both sides.
    Their slopes decrease, so that the differences of the slopes are the K_j > 0 with the smallest
    error.
    Non-negative least squares on a grid of kappa_j, thinned afterwards, have a larger error.
    """
    is_allowed = 1 <= n_sliders <= MAX_SLIDERS
    require("n_sliders", n_sliders, f"from 1 to {MAX_SLIDERS}", holds=is_allowed)
    chords = thin_law(curvature, moment, max_points=n_sliders + 2)
    require_concave(curvature, moment, find_hull(curvature, moment))
    ratios = np.interp(curvature[1:], chords.curvature, chords.moment) / moment[1:]
    scale = 2.0 / (float(ratios.max()) + float(ratios.min()))
    slopes = scale * np.diff(chords.moment) / np.diff(chords.curvature)
    return SliderLaw(
        stiffness=float(slopes[-1]),
        stiffnesses=-np.diff(slopes),
        slip_curvatures=chords.curvature[1:-1],
        first=float(curvature[1]),
        last=float(curvature[-1]),
        error=float(np.max(np.abs(scale * ratios - 1.0))),
    )


def make_linear_law(stiffness: float, last: float) -> SliderLaw:
    """Build a law of constant stiffness, without sliders.

    Parameters
    ----------
    stiffness : N m^2
    last : 1/m, end of the range
    """
    require_positive("stiffness", stiffness)
    return SliderLaw(stiffness, np.zeros(0), np.zeros(0), 0.0, last)


def compute_slip_moments(law: SliderLaw) -> Vector:
    """Return the moments at which the sliders slide, K_j kappa_j, N m."""
    return np.asarray(law.stiffnesses * law.slip_curvatures)


@dataclass(frozen=True, slots=True, eq=False)
class MixedLaw(PlayLaw):
    """A law of a wire with partly isotropic hardening, which computes curvature from moment.

    Its plays are those of first loading. They define the stiffness and the range.

    Parameters
    ----------
    sliders : law with the same first loading, which computes all responses
    """

    sliders: SliderLaw = field(kw_only=True, repr=False)

    def make_unbent_history(self, n_stations: int) -> Floats:
        """Return the history of a wire that was never bent, 1/m.

        Parameters
        ----------
        n_stations : number of stations along the wire

        Returns
        -------
        Shape (stations, 1 + n), curvature and history of the sliders, as in `SliderResponse`.
        """
        slider_history = make_unbent_rests(self.sliders, n_stations)
        return np.concatenate([np.zeros((n_stations, 1)), slider_history], axis=1)

    def respond(self, moment: Floats, history: Floats) -> Response:
        """Compute the curvatures under new moments.

        Parameters
        ----------
        moment : shape (stations,), N m; each is reached monotonically
        history : shape (stations, 1 + n), 1/m, history after the last step, or that of
            `make_unbent_history`

        Returns
        -------
        The response; its `plays` are the new history, shape (stations, 1 + n), 1/m. For a moment of
        NaN, curvature and history of the station are NaN.
        """
        curvature, response = bend_to_moment(self.sliders, moment, history[:, 0], history[:, 1:])
        new_history = np.concatenate([curvature[:, None], response.rests], axis=1)
        return Response(curvature, 1.0 / response.stiffness, new_history)


def make_mixed_law(plays: PlayLaw, corners: Floats, growing_slider: GrowingSlider) -> MixedLaw:
    """Build the law of a wire whose strands harden partly isotropically.

    Parameters
    ----------
    plays : law of the wire on first loading
    corners : shape (plays + 1,), 1/m, curvatures at the half-widths of `plays` and at its largest
        moment
    growing_slider : part of the moment of the strands about their own axes that hardens
        isotropically
    """
    moment = np.append(plays.half_widths, plays.largest_moment)
    masing_moment = moment - growing_slider.compute_first_loading(corners)
    slopes = np.diff(masing_moment, prepend=0.0) / np.diff(corners, prepend=0.0)
    slope_drops = -np.diff(np.minimum.accumulate(slopes))
    has_slider = slope_drops > 0.0
    sliders = SliderLaw(
        max(float(slopes.min()), 0.0),  # for a bare solid wire the slopes are only rounding
        slope_drops[has_slider],
        corners[:-1][has_slider],
        0.0,
        float(corners[-1]),
        growing=(growing_slider,),
    )
    numbers = plays.stiffness, plays.half_widths, plays.compliances, plays.largest_moment
    return MixedLaw(*numbers, sliders=sliders)


MAX_SCALAR_SLIDERS = 16
"""Largest number of scalar sliders in each direction."""
TURNS = (0.0, 0.5, 0.25, 0.75)
"""Rotations of successive nodes, relative to the angle between two directions."""

_N_ANGLES = 13
"""Number of angles of the curvature between two directions at which moments are compared."""


@dataclass(frozen=True, slots=True, eq=False)
class DirectionalLaw(ArrayRecord):
    """The same spring and scalar sliders in each of a few directions normal to the wire.

    Parameters
    ----------
    directions : D, number of directions; the first direction is the first axis normal to the wire
    stiffness : N m^2, stiffness of the spring in each direction
    stiffnesses : shape (sliders,), N m^2, stiffnesses of the sliders in each direction
    slip_curvatures : shape (sliders,), 1/m, component of the curvature at which each slider slides
    error : largest difference between the moments along the curvature of scalar and vector sliders,
        on first loading in any direction, relative to that of the vector sliders
    sideways : largest moment normal to the curvature, relative to that along it
    """

    directions: int
    stiffness: float
    stiffnesses: Annotated[Floats, "sliders"]
    slip_curvatures: Annotated[Floats, "sliders"]
    error: float
    sideways: float

    @property
    def normals(self) -> Floats:
        """Return unit vectors of the directions, shape (directions, 2)."""
        return self.compute_normals(0.0)

    def compute_normals(self, turn: float) -> Floats:
        """Return unit vectors of the directions, rotated by a fraction of their angle."""
        angle = np.pi * (np.arange(self.directions) + turn) / self.directions
        return np.column_stack([np.cos(angle), np.sin(angle)])


@lru_cache(maxsize=16)  # laws are hashed by identity
def fit_directions(
    law: SliderLaw, directions: int, *, max_sliders: int = MAX_SCALAR_SLIDERS
) -> DirectionalLaw:
    """Fit scalar sliders in a few directions to vector sliders.

    Parameters
    ----------
    law : law with vector sliders
    directions : number of directions D, at least 2
    max_sliders : largest number of sliders in each direction

    Raises
    ------
    ValueError
        If there are fewer than two directions, or no slider is allowed.

    Notes
    -----
    The moment along the curvature, as a mean over all directions, is fitted relative to that of the
    vector sliders. The fit is by non-negative least squares on a grid of slip curvatures. The two
    nearest slip curvatures are then merged until at most `max_sliders` remain.
    """
    n_slips = 48  # number of slip curvatures of the grid
    last_factor = 1.6  # times the last slip curvature, because scalar sliders slide later
    require("directions", directions, ">= 2", holds=directions >= 2)
    require("max_sliders", max_sliders, ">= 1", holds=max_sliders >= 1)
    size = _space_curvatures(law)
    target = compute_slider_moment(law, size)
    if not law.stiffnesses.size:
        slips, stiffnesses = np.zeros(0), np.array([law.stiffness])
    else:
        ends = (0.5 * law.slip_curvatures[0], min(last_factor * law.slip_curvatures[-1], law.last))
        slips = np.geomspace(*ends, n_slips)
        if max_sliders < MAX_SCALAR_SLIDERS:  # start from the fit of more sliders
            slips = fit_directions(law, directions).slip_curvatures
        stiffnesses = _fit_stiffnesses(size, target, slips, directions)
        while np.count_nonzero(stiffnesses[1:]) > max_sliders or not np.all(stiffnesses[1:]):
            slips = _reduce_slips(slips, stiffnesses[1:])
            stiffnesses = _fit_stiffnesses(size, target, slips, directions)
    springs = 2.0 * stiffnesses / directions
    scalar_law = DirectionalLaw(directions, float(springs[0]), springs[1:], slips, 0.0, 0.0)
    return _set_errors(law, scalar_law)


def turn_directions(law: SliderLaw, node_law: DirectionalLaw) -> DirectionalLaw:
    """Average the laws of successive nodes with directions rotated by `TURNS`.

    Parameters
    ----------
    law : law with vector sliders
    node_law : law of each node with scalar sliders

    Returns
    -------
    The mean of four nodes: four times the directions, each with a quarter of the stiffness.
    """
    count = len(TURNS)
    mean = replace(
        node_law,
        directions=count * node_law.directions,
        stiffness=node_law.stiffness / count,
        stiffnesses=node_law.stiffnesses / count,
    )
    return _set_errors(law, mean)


def _space_curvatures(law: SliderLaw) -> Floats:
    """Return curvatures over the range of a law, 1/m; four decades if the range starts at 0."""
    n_curvatures = 80
    return np.geomspace(law.first or 1e-4 * law.last, law.last, n_curvatures)


def _set_errors(law: SliderLaw, scalar_law: DirectionalLaw) -> DirectionalLaw:
    """Return the scalar law with its errors computed against the vector sliders."""
    curvature = _space_curvatures(law)
    target = compute_slider_moment(law, curvature)
    along, normal = _compute_components(scalar_law, curvature)
    return replace(
        scalar_law,
        error=float(np.max(np.abs(along / target[:, None] - 1.0))),
        sideways=float(np.max(np.abs(normal / target[:, None]))),
    )


def _fit_stiffnesses(size: Floats, target: Floats, slips: Floats, directions: int) -> Floats:
    """Fit stiffnesses of vector sliders, N m^2, the spring first; shape (1 + slips,)."""
    columns = np.column_stack([size, _average_sliders(size, slips, directions)]) / target[:, None]
    return np.asarray(nnls(columns, np.ones(len(size)))[0])


def _average_sliders(size: Floats, slips: Floats, directions: int) -> Floats:
    """Return the mean slider curvature along the curvature, over all its directions, 1/m.

    The shape is (curvatures, slips). A slider whose direction has the cosine p with the curvature
    slides from a curvature of slip / p on. If the sliders are sorted by p, the last ones slide.
    """
    angle = np.linspace(0.0, np.pi / directions, _N_ANGLES)[:-1]
    cosines = np.cos(angle[:, None] - np.pi * np.arange(directions) / directions)
    cosines = np.sort(np.abs(cosines).ravel())
    n_sticking = np.searchsorted(cosines, slips / size[:, None])
    sticking = np.append(0.0, np.cumsum(cosines**2))[n_sticking]
    sliding = np.append(np.cumsum(cosines[::-1])[::-1], 0.0)[n_sticking]
    return 2.0 / directions / len(angle) * (sticking * size[:, None] + sliding * slips)


def _reduce_slips(slips: Floats, stiffnesses: Floats) -> Floats:
    """Drop slip curvatures without stiffness; if there are none, merge the two nearest."""
    stiff_slips = slips[stiffnesses > 0.0]
    if len(stiff_slips) < len(slips):
        return np.asarray(stiff_slips)
    closest = int(np.argmin(np.diff(np.log(slips))))
    middle = np.sqrt(slips[closest] * slips[closest + 1])
    return np.concatenate([slips[:closest], [middle], slips[closest + 2 :]])


def _compute_components(law: DirectionalLaw, size: Floats) -> tuple[Floats, Floats]:
    """Return the moments along and normal to the curvature, N m, shape (curvatures, angles).

    The angles are from a direction to the middle between two directions; others follow by symmetry.
    """
    angle = np.linspace(0.0, 0.5 * np.pi / law.directions, _N_ANGLES + 1)
    unit = np.column_stack([np.cos(angle), np.sin(angle)])
    normal = np.column_stack([-unit[:, 1], unit[:, 0]])
    corners = np.concatenate([[0.0], law.slip_curvatures, [2.0 * max(size[-1], 1.0)]])
    corner_moment = np.minimum(corners[:, None], law.slip_curvatures) @ law.stiffnesses
    corner_moment = law.stiffness * corners + corner_moment
    component = size[:, None, None] * (unit @ law.normals.T)
    moment = np.sign(component) * np.interp(np.abs(component), corners, corner_moment)
    vectors = moment @ law.normals
    return np.sum(vectors * unit, axis=2), np.sum(vectors * normal, axis=2)
