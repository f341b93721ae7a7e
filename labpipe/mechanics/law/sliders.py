"""A moment-curvature law as sliders, with history, for simulation programs.

Any concave first loading M(kappa) is a spring and Coulomb sliders side by side, each a
spring of stiffness K_j that slides once it is bent by kappa_j:

    M(kappa) = EI_0 kappa + sum_j K_j stop_j(kappa)      on first loading: K_j min(kappa, kappa_j)

It is the dual of `law.plays`, where curvature follows from moment. After a reversal a slider slides
again after 2 kappa_j, so that loops follow Masing's rule and close. The history of a slider is the
curvature a_j at which it carries no moment.

In three dimensions curvature and moment are vectors across the wire, and a slider is a vector stop:
it sticks while |kappa - a_j| <= kappa_j, else a_j follows (radial return), isotropically.
Curvatures are in 1/m, moments in N m.

A growing slider has a limit that grows: isotropic hardening of copper
(docs/explanations/measurements.md).

Annealed copper hardens isotropically and kinematically. A share m of the moment of its strands, the
*isotropic share*, has a limit that grows with the curvature that has slid; the other share follows
Masing's rule. First loading is the same for every m; unloading and reloading depend on m.

With the moment M of the strands at a curvature of first loading, the slider has the stiffness
S = m EI of the strands, the curvature q = kappa - M / EI that has slid, and the limit L(q) = m M, a
polygon. It sticks while |S (kappa - p)| is at most L(q); else its rest p follows the curvature by
as much as q grows. Unlike that of real copper the limit does not saturate: the law is valid for
about three cycles.

Scalar sliders in a few directions replace vector sliders for programs without them.

D directions across the wire, at 180 / D degrees from each other, each have the same spring and
sliders on their component of the curvature. Such springs are isotropic from D = 2 on, sliders are
not: they slide earlier along a direction than between two. For one slider that slides at
kappa_j, stiffness 2 K / D and moment pi K kappa_j / 2 D in each direction carry K kappa_j on
average once all slide. Before that they carry less, so that several sliders are fitted
together to the moment of the vector sliders. The directions may be turned from one node of a chain
to the next (`TURNS`): the errors cancel, and four nodes together are nearly isotropic.
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
from labpipe.mechanics.law.thinning import find_hull, require_concave, thin
from labpipe.records.arrays import ArrayRecord, Floats, Vector

_EYE = np.eye(2)
MAX_SLIDERS = 64
"""Largest number of sliders of a law."""


@dataclass(frozen=True, slots=True, eq=False)
class SliderResponse:
    """Response of sliders to a curvature at each station.

    Parameters
    ----------
    moment : N m, shape (stations,), or (stations, 2) of vectors
    stiffness : d(moment) / d(curvature), N m^2, shape (stations,), or (stations, 2, 2): consistent
        with the step just made
    rests : 1/m, shape (stations, n), or (stations, n, 2): the history after the step. First the
        rest curvature of each slider; then, for each growing slider, its rest curvature and the
        curvature that has slid, which is a scalar (in the first component of a vector)
    """

    moment: Floats
    stiffness: Floats
    rests: Floats


@dataclass(frozen=True, eq=False)
class GrowingSlider(ArrayRecord):
    """A slider whose limit grows with the curvature that has slid.

    Parameters
    ----------
    stiffness : S while it sticks, N m^2
    slid : shape (corners,), q, 1/m, from 0, increasing, at least two
    limits : shape (corners,), L(q), N m, positive, not decreasing; the last slope continues

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
        rises = len(self.slid) >= 2 and self.slid[0] == 0.0 and np.all(np.diff(self.slid) > 0.0)
        require("slid", self.slid.tolist(), "from zero and increasing", holds=bool(rises))
        grows = self.limits[0] > 0.0 and bool(np.all(np.diff(self.limits) >= 0.0))
        require("limits", self.limits.tolist(), "positive and not decreasing", holds=grows)

    @cached_property
    def _growth(self) -> tuple[Floats, Floats]:
        """Return L(q) + S q at the corners, N m, and the slopes of q over it, 1/(N m^2)."""
        sums = self.limits + self.stiffness * self.slid
        return sums, np.diff(self.slid) / np.diff(sums)

    def scaled(self, factor: float) -> GrowingSlider:
        """Return the slider with moments multiplied by a positive factor."""
        return GrowingSlider(factor * self.stiffness, self.slid, factor * self.limits)

    def limit_after(self, slid: Floats) -> Floats:
        """Return the limit after a curvature of any shape has slid, N m."""
        part = self.slid[1:-1].searchsorted(slid, side="right")
        slopes = np.diff(self.limits) / np.diff(self.slid)
        return np.asarray(self.limits[part] + slopes[part] * (slid - self.slid[part]))

    def first_loading(self, curvature: Floats) -> Floats:
        """Return the moment of first loading at curvatures of any shape, not negative, N m."""
        moment = self.stiffness * curvature
        grown, _ = self._grow(moment, np.zeros_like(moment))
        return np.asarray(moment - self.stiffness * grown)

    def slide(self, curvature: Floats, history: Floats) -> SliderResponse:
        """Compute the moments after a step to new curvatures in one plane.

        Parameters
        ----------
        curvature : shape (stations,), 1/m
        history : shape (stations, 2), 1/m: p and q
        """
        rest, slid = history.T
        trial = self.stiffness * (curvature - rest)
        grown, tangent = self._grow(np.abs(trial), slid)
        rest = rest + np.copysign(grown, trial)
        history = np.stack([rest, slid + grown], axis=1)
        return SliderResponse(self.stiffness * (curvature - rest), tangent, history)

    def slide_vector(self, curvature: Floats, history: Floats) -> SliderResponse:
        """Compute the moments after a step to new curvature vectors, each along a straight line.

        Parameters
        ----------
        curvature : shape (stations, 2), 1/m
        history : shape (stations, 2, 2), 1/m: p, and q as the first component
        """
        rest, slid = history[:, 0], history[:, 1, 0]
        trial = self.stiffness * (curvature - rest)
        size = np.sqrt(np.vecdot(trial, trial))
        grown, tangent = self._grow(size, slid)
        safe = np.where(size > 0.0, size, 1.0)
        along = trial / safe[:, None]
        across = self.stiffness * (1.0 - self.stiffness * grown / safe)
        derivative = across[:, None, None] * _EYE
        derivative += (tangent - across)[:, None, None] * along[:, :, None] * along[:, None, :]
        rest, new_history = rest + grown[:, None] * along, np.zeros_like(history)
        new_history[:, 0], new_history[:, 1, 0] = rest, slid + grown
        return SliderResponse(self.stiffness * (curvature - rest), derivative, new_history)

    def _grow(self, size: Floats, slid: Floats) -> tuple[Floats, Floats]:
        """Return the growth of q under a trial moment, 1/m, and the stiffness along it, N m^2.

        The new q solves L(q) + S q = size + S slid; if it is not larger than `slid`, the slider
        sticks. With g = L(q) + S q, dM = S (1 - S dq/dg) d(kappa).
        """
        sums, slopes = self._growth
        total = size + self.stiffness * slid
        part = sums[1:-1].searchsorted(total, side="right")
        slope = slopes[part]
        grown = np.maximum(self.slid[part] + slope * (total - sums[part]) - slid, 0.0)
        tangent = self.stiffness * np.where(grown > 0.0, 1.0 - self.stiffness * slope, 1.0)
        return grown, tangent


def make_growing_slider(curvature: Floats, moment: Floats, share: float) -> GrowingSlider:
    """Make the growing slider of the isotropic share of the strands' first loading.

    Parameters
    ----------
    curvature, moment : shape (n,), 1/m and N m, positive, of the strands about their own axes;
        the first point is elastic
    share : isotropic share m, above 0 and at most 1

    Raises
    ------
    ValueError
        If the share or the curve is out of its range.
    """
    require("share", share, "above 0 and at most 1", holds=0.0 < share <= 1.0)
    stiffness = float(moment[0] / curvature[0])
    slid = np.maximum.accumulate(np.append(0.0, (curvature - moment / stiffness)[1:]))
    rises = np.diff(slid, prepend=-1.0) > 1e-12 * slid[-1]
    limits = share * np.maximum.accumulate(moment)
    return GrowingSlider(share * stiffness, slid[rises], limits[rises])


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
    growing : further sliders with limits that grow (isotropic hardening)

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
        spans = 0.0 <= self.first < self.last < np.inf
        require("range", (self.first, self.last), ">= 0 and increasing", holds=spans)

    @property
    def history_size(self) -> int:
        """Return the number n of values of the history at a station, see `SliderResponse`."""
        return len(self.stiffnesses) + 2 * len(self.growing)

    @property
    def first_stiffness(self) -> float:
        """Return the bending stiffness before sliding, and after every reversal, N m^2."""
        growing = sum(slider.stiffness for slider in self.growing)
        return self.stiffness + float(np.sum(self.stiffnesses)) + growing


def share_hardening(law: SliderLaw, strands: GrowingSlider, share: float) -> SliderLaw:
    """Replace a share of the strands' hardening in a law by a growing slider.

    Parameters
    ----------
    law : law with sliders that contain the strands' own bending
    strands : growing slider of their whole bending
    share : isotropic share, from 0 to 1; with 0 the law is returned as it is

    Returns
    -------
    A law with the same moments of first loading at its slip curvatures and at the end of its range,
    unless a stiffness would become negative: it is then zero, or nearly zero for a slider.
    """
    min_slider_share = 1e-9  # of the first stiffness: sliders have a positive stiffness
    if share == 0.0:
        return law
    growing = strands.scaled(share)
    corners = np.concatenate([[0.0], law.slip_curvatures, [law.last]])
    slopes = np.diff(growing.first_loading(corners)) / np.diff(corners)
    return replace(
        law,
        stiffness=max(law.stiffness - float(slopes[-1]), 0.0),
        stiffnesses=np.maximum(
            law.stiffnesses + np.diff(slopes), min_slider_share * law.first_stiffness
        ),
        growing=(*law.growing, growing),
    )


@dataclass(frozen=True, slots=True, eq=False)
class PresentSliders:
    """All sliders of a law with their present limits, constant ones and growing ones.

    Parameters
    ----------
    stiffnesses : shape (sliders,), N m^2, the growing ones last
    slip_curvatures : shape (..., sliders), 1/m
    rests : shape (..., sliders, 2), 1/m
    """

    stiffnesses: Floats
    slip_curvatures: Floats
    rests: Floats


def present_sliders(law: SliderLaw, rests: Floats) -> PresentSliders:
    """Return the sliders of a law with their present limits.

    Parameters
    ----------
    law : law of every station
    rests : shape (..., n, 2), 1/m: the history, see `SliderResponse`
    """
    count = len(law.stiffnesses)
    slips = [np.broadcast_to(law.slip_curvatures, (*rests.shape[:-2], count))]
    rest_indices = [*range(count), *range(count, rests.shape[-2], 2)]
    for number, slider in enumerate(law.growing):
        limit = slider.limit_after(rests[..., count + 2 * number + 1, 0])
        slips.append((limit / slider.stiffness)[..., None])
    stiffnesses = np.append(law.stiffnesses, [slider.stiffness for slider in law.growing])
    return PresentSliders(stiffnesses, np.concatenate(slips, axis=-1), rests[..., rest_indices, :])


def compute_slider_moment(law: SliderLaw, curvature: Floats) -> Floats:
    """Return the moment of first loading, N m.

    Parameters
    ----------
    law : sliders of the wire
    curvature : any shape, 1/m, of either sign
    """
    slider_curvature = np.clip(curvature[..., None], -law.slip_curvatures, law.slip_curvatures)
    moment = np.asarray(law.stiffness * curvature + slider_curvature @ law.stiffnesses)
    for slider in law.growing:
        moment = moment + np.sign(curvature) * slider.first_loading(np.abs(curvature))
    return moment


def make_unbent_rests(law: SliderLaw, n_stations: int, *, is_vector: bool = False) -> Floats:
    """Return the history of a wire that was never bent, 1/m, see `SliderResponse`."""
    return np.zeros((n_stations, law.history_size, *((2,) if is_vector else ())))


def slide(law: SliderLaw, curvature: Floats, rests: Floats) -> SliderResponse:
    """Compute moments at new curvatures in one plane, from the history.

    Parameters
    ----------
    law : the law of every station
    curvature : shape (stations,), 1/m; each is reached monotonically
    rests : shape (stations, n), 1/m, before the step; see `SliderResponse`

    Notes
    -----
    A curvature of NaN gives a moment and a history of NaN. Where a slider just begins to slide, the
    stiffness is that of a slider that sticks.
    """
    count = len(law.stiffnesses)
    trial_curvature = curvature[:, None] - rests[:, :count]
    slider_curvature = np.clip(trial_curvature, -law.slip_curvatures, law.slip_curvatures)
    moment = law.stiffness * curvature + slider_curvature @ law.stiffnesses
    stiffness = law.stiffness + (slider_curvature == trial_curvature) @ law.stiffnesses
    response = SliderResponse(moment, stiffness, curvature[:, None] - slider_curvature)
    growing = [slider.slide(curvature, history) for slider, history in _growing_parts(law, rests)]
    return _add_responses(response, growing)


def _growing_parts(law: SliderLaw, rests: Floats) -> Iterator[tuple[GrowingSlider, Floats]]:
    """Yield each growing slider with its part of the history."""
    for start, slider in zip(
        range(len(law.stiffnesses), law.history_size, 2), law.growing, strict=True
    ):
        yield slider, rests[:, start : start + 2]


def _add_responses(response: SliderResponse, growing: list[SliderResponse]) -> SliderResponse:
    """Add the responses of growing sliders to that of the sliders with constant limits."""
    if not growing:
        return response
    moment, stiffness = response.moment, response.stiffness
    for addend in growing:
        moment, stiffness = moment + addend.moment, stiffness + addend.stiffness
    rests = [response.rests, *(addend.rests for addend in growing)]
    return SliderResponse(moment, stiffness, np.concatenate(rests, axis=1))


def bend_to_moment(
    law: SliderLaw, moment: Floats, curvature: Floats, rests: Floats
) -> tuple[Floats, SliderResponse]:
    """Find the curvatures at which the moments have new values, from the history.

    Parameters
    ----------
    law : the law of every station
    moment : shape (stations,), N m; each is reached monotonically
    curvature, rests : present curvatures and history, as for `slide`

    Returns
    -------
    Curvatures, 1/m, and the response there. A moment of NaN gives a curvature of NaN.

    Notes
    -----
    The size of the change of moment is a concave, piecewise linear function of that of curvature:
    Newton's method converges from below in a finite number of steps. It begins with the stiffness
    of sliders that all stick, for a change of either sign.
    """
    max_iterations = 60
    count = len(law.stiffnesses)
    present = law.stiffness * curvature + (curvature[:, None] - rests[:, :count]) @ law.stiffnesses
    for slider, history in _growing_parts(law, rests):
        present = present + slider.stiffness * (curvature - history[:, 0])
    rounding = 1e-13 * max(np.abs(moment).max(initial=0.0), np.abs(present).max(initial=0.0))
    missing_moment, stiffness = moment - present, law.first_stiffness + np.zeros_like(moment)
    for _ in range(max_iterations):
        curvature = curvature + missing_moment / stiffness
        response = slide(law, curvature, rests)
        missing_moment, stiffness = moment - response.moment, response.stiffness
        if np.all(np.abs(missing_moment) <= rounding):
            break
    return curvature, response


def slide_vector(law: SliderLaw, curvature: Floats, rests: Floats) -> SliderResponse:
    """Compute moment vectors at new curvature vectors, from the history.

    Parameters
    ----------
    law : the law of every station
    curvature : shape (stations, 2), 1/m, across the wire; each is reached along a straight line
    rests : shape (stations, n, 2), 1/m, before the step; see `SliderResponse`

    Notes
    -----
    Radial return: a slider bent by b = kappa - a, |b| > kappa_j, carries K_j kappa_j b / |b|, and
    d(moment) = K_j kappa_j / |b| (1 - b b^T / |b|^2) d(curvature). A slider that sticks has the
    stiffness K_j in every direction. Exact for a straight path; a curved path needs small steps.
    """
    count, slips = len(law.stiffnesses), law.slip_curvatures
    trial_curvature = curvature[:, None, :] - rests[:, :count]
    size = np.sqrt(np.vecdot(trial_curvature, trial_curvature))
    shrunk = slips / np.maximum(size, slips)
    slider_curvature = trial_curvature * shrunk[..., None]
    moment = law.stiffness * curvature + law.stiffnesses @ slider_curvature
    along = ((size > slips) / slips)[..., None] * slider_curvature
    weights = law.stiffnesses * shrunk
    stiffness = (law.stiffness + weights.sum(axis=1))[:, None, None] * _EYE
    stiffness -= np.swapaxes(weights[..., None] * along, 1, 2) @ along
    response = SliderResponse(moment, stiffness, curvature[:, None, :] - slider_curvature)
    growing = [
        slider.slide_vector(curvature, history) for slider, history in _growing_parts(law, rests)
    ]
    return _add_responses(response, growing)


def convert_to_plays(law: SliderLaw) -> PlayLaw:
    """Return the law as plays, up to the end of its range.

    Parameters
    ----------
    law : law with at least one slider, or a stiffness

    Notes
    -----
    Both have the same first loading and follow Masing's rule, so that their loops are the same. Of
    growing sliders, the plays have the first loading at the corners only.
    """
    corners = np.append(law.slip_curvatures[law.slip_curvatures < law.last], law.last)
    corners = np.append(0.5 * corners[0], corners) if len(corners) == 1 else corners
    return make_polygon_law(corners, compute_slider_moment(law, corners))


def fit_sliders(curvature: Floats, moment: Floats, n_sliders: int) -> SliderLaw:
    """Fit sliders to the points of a first loading, with the smallest largest error.

    Parameters
    ----------
    curvature : shape (n,), 1/m, from 0, increasing
    moment : shape (n,), N m, from 0, increasing, concave
    n_sliders : largest number; fewer if the law has fewer corners

    Raises
    ------
    ValueError
        As `thin` and `require_concave`; if `n_sliders` is out of its range.

    Notes
    -----
    Chords between the best points of the law (`thin`) lie below it by at most a share e; multiplied
    by 1 + e / (2 - e) they are within e / (2 - e) of it, on both sides. Their slopes fall, so that
    the differences of the slopes are the K_j > 0 of least error; non-negative least squares on a
    grid of kappa_j, thinned out afterwards, have a larger error.
    """
    is_allowed = 1 <= n_sliders <= MAX_SLIDERS
    require("n_sliders", n_sliders, f"from 1 to {MAX_SLIDERS}", holds=is_allowed)
    chords = thin(curvature, moment, max_points=n_sliders + 2)
    require_concave(curvature, moment, find_hull(curvature, moment))
    shares = np.interp(curvature[1:], chords.curvature, chords.moment) / moment[1:]
    scale = 2.0 / (float(shares.max()) + float(shares.min()))
    slopes = scale * np.diff(chords.moment) / np.diff(chords.curvature)
    return SliderLaw(
        stiffness=float(slopes[-1]),
        stiffnesses=-np.diff(slopes),
        slip_curvatures=chords.curvature[1:-1],
        first=float(curvature[1]),
        last=float(curvature[-1]),
        error=float(np.max(np.abs(scale * shares - 1.0))),
    )


def make_linear_law(stiffness: float, last: float) -> SliderLaw:
    """Return a constant stiffness as a law without sliders.

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

    Its plays are those of first loading; they define the stiffness and the range.

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
        Shape (stations, 1 + n): the curvature, then the history of the sliders, see
        `SliderResponse`.
        """
        slider_history = make_unbent_rests(self.sliders, n_stations)
        return np.concatenate([np.zeros((n_stations, 1)), slider_history], axis=1)

    def respond(self, moment: Floats, history: Floats) -> Response:
        """Compute the curvatures under new moments.

        Parameters
        ----------
        moment : shape (stations,), N m; each is reached monotonically
        history : shape (stations, 1 + n), 1/m, from the last step or `make_unbent_history`

        Returns
        -------
        The response; its `plays` are the new history, shape (stations, 1 + n), 1/m. A moment of NaN
        gives a curvature and a history of NaN at its station.
        """
        curvature, response = bend_to_moment(self.sliders, moment, history[:, 0], history[:, 1:])
        new_history = np.concatenate([curvature[:, None], response.rests], axis=1)
        return Response(curvature, 1.0 / response.stiffness, new_history)


def make_mixed_law(
    plays: PlayLaw, curvature: Floats, strand_moment: Floats, isotropic_share: float
) -> MixedLaw:
    """Make the law of a wire whose strands harden partly isotropically.

    Parameters
    ----------
    plays : law of the wire on first loading
    curvature : shape (n,), 1/m, positive and increasing: first the curvatures at the half-widths
        of `plays` and at its largest moment, then larger ones that the strands reach in loops
    strand_moment : shape (n,), N m, moment of the strands about their own axes
    isotropic_share : share of that moment that hardens isotropically, above 0 and at most 1

    Raises
    ------
    ValueError
        If the share is outside its range.
    """
    moment = np.append(plays.half_widths, plays.largest_moment)
    corners = curvature[: len(moment)]
    growing_slider = make_growing_slider(curvature, strand_moment, isotropic_share)
    masing_moment = moment - growing_slider.first_loading(corners)
    slopes = np.diff(masing_moment, prepend=0.0) / np.diff(corners, prepend=0.0)
    slope_drops = -np.diff(np.minimum.accumulate(slopes))
    has_slider = slope_drops > 0.0
    sliders = SliderLaw(
        max(float(slopes.min()), 0.0),  # for a bare solid wire the slopes are rounding only
        slope_drops[has_slider],
        corners[:-1][has_slider],
        0.0,
        float(corners[-1]),
        growing=(growing_slider,),
    )
    return MixedLaw(
        *(plays.stiffness, plays.half_widths, plays.compliances, plays.largest_moment),
        sliders=sliders,
    )


MAX_SCALAR_SLIDERS = 16
"""Largest number of scalar sliders in each direction."""
TURNS = (0.0, 0.5, 0.25, 0.75)
"""Turns of successive nodes, as shares of the angle between two directions."""

_N_ANGLES = 13


@dataclass(frozen=True, slots=True, eq=False)
class DirectionalLaw(ArrayRecord):
    """The same spring and scalar sliders in each of a few directions across the wire.

    Parameters
    ----------
    directions : D, number of directions; the first is the first axis across the wire
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
def fit_directions(
    law: SliderLaw, directions: int, *, max_sliders: int = MAX_SCALAR_SLIDERS
) -> DirectionalLaw:
    """Fit scalar sliders in a few directions to vector sliders.

    Parameters
    ----------
    law : vector sliders
    directions : number of directions D, at least 2
    max_sliders : largest number of sliders in each direction

    Raises
    ------
    ValueError
        If there are fewer than two directions, or no slider is allowed.

    Notes
    -----
    Non-negative least squares of the moment along the curvature, relative to that of the vector
    sliders and as a mean over all directions, on a grid of slip curvatures; then the two
    nearest slip curvatures are merged until at most `max_sliders` remain.
    """
    n_slips = 48  # slip curvatures to choose from
    # times the last slip curvature: scalar sliders slide later than vector sliders
    last_factor = 1.6
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
    """Average the laws of successive nodes with directions turned by `TURNS`.

    Parameters
    ----------
    law : vector sliders
    node_law : scalar sliders of each node

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


@lru_cache(maxsize=16)
def _space_curvatures(law: SliderLaw) -> Floats:
    n_sizes = 80
    return np.geomspace(law.first or 1e-4 * law.last, law.last, n_sizes)  # from 0: four decades


def _set_errors(law: SliderLaw, scalar_law: DirectionalLaw) -> DirectionalLaw:
    """Return the scalar law with its errors computed against the vector sliders."""
    curvature = _space_curvatures(law)
    target = compute_slider_moment(law, curvature)
    along, across = _compute_components(scalar_law, curvature)
    return replace(
        scalar_law,
        error=float(np.max(np.abs(along / target[:, None] - 1.0))),
        sideways=float(np.max(np.abs(across / target[:, None]))),
    )


def _fit_stiffnesses(size: Floats, target: Floats, slips: Floats, directions: int) -> Floats:
    """Fit stiffnesses of vector sliders, N m^2, the spring first; shape (1 + slips,)."""
    columns = np.column_stack([size, _average_sliders(size, slips, directions)]) / target[:, None]
    return np.asarray(nnls(columns, np.ones(len(size)))[0])


def _average_sliders(size: Floats, slips: Floats, directions: int) -> Floats:
    """Return the mean slider curvature along the curvature, over all its directions, 1/m.

    Shape (curvatures, slips). A slider with a share p of the curvature along its direction slides
    from a curvature of slip / p on: sorted by p, the last sliders slide.
    """
    turn = np.linspace(0.0, np.pi / directions, _N_ANGLES)[:-1]
    parts = np.sort(
        np.abs(np.cos(turn[:, None] - np.pi * np.arange(directions) / directions)).ravel()
    )
    at_rest = np.searchsorted(parts, slips / size[:, None])
    squares = np.append(0.0, np.cumsum(parts**2))[at_rest]
    sliding = np.append(np.cumsum(parts[::-1])[::-1], 0.0)[at_rest]
    return 2.0 / directions / len(turn) * (squares * size[:, None] + sliding * slips)


def _reduce_slips(slips: Floats, stiffnesses: Floats) -> Floats:
    """Drop slip curvatures without stiffness; if all have one, merge the two nearest."""
    loaded = slips[stiffnesses > 0.0]
    if len(loaded) < len(slips):
        return np.asarray(loaded)
    closest = int(np.argmin(np.diff(np.log(loaded))))
    middle = np.sqrt(loaded[closest] * loaded[closest + 1])
    return np.concatenate([loaded[:closest], [middle], loaded[closest + 2 :]])


def _compute_components(law: DirectionalLaw, size: Floats) -> tuple[Floats, Floats]:
    """Return the moment along and across the curvature, N m, shape (curvatures, angles).

    Angles go from a direction to the middle between two; others follow by symmetry.
    """
    turn = np.linspace(0.0, 0.5 * np.pi / law.directions, _N_ANGLES + 1)
    unit = np.column_stack([np.cos(turn), np.sin(turn)])
    parts = unit @ law.normals.T
    corners = np.concatenate([[0.0], law.slip_curvatures, [2.0 * max(size[-1], 1.0)]])
    slider_moment = np.minimum(corners[:, None], law.slip_curvatures) @ law.stiffnesses
    component = size[:, None, None] * parts
    moment = np.sign(component) * np.interp(
        np.abs(component), corners, law.stiffness * corners + slider_moment
    )
    along = np.sum((moment @ law.normals) * unit, axis=2)
    across = np.column_stack([-unit[:, 1], unit[:, 0]])
    return along, np.sum((moment @ law.normals) * across, axis=2)
