"""Define moment-curvature laws that compute the moment from the curvature and its history.

A spring and Coulomb sliders in parallel represent any concave first loading M(kappa). A slider is
a spring of stiffness K_j that slides when its curvature reaches kappa_j:

    M(kappa) = EI_0 kappa + sum_j K_j stop_j(kappa)      on first loading: K_j min(kappa, kappa_j)

The law is the dual of `law.plays`, where the curvature follows from the moment. After a reversal a
slider slides again after 2 kappa_j. Loops therefore follow Masing's rule and close. The history of
a slider is its rest curvature a_j, at which it has no moment.

In three dimensions curvature and moment are vectors normal to the wire, and a slider is a vector
stop: it sticks while |kappa - a_j| <= kappa_j. Otherwise a_j moves towards kappa until the distance
is kappa_j (radial return). This law is isotropic. Curvatures are in 1/m, moments in N m.

Annealed copper hardens isotropically and kinematically. The *isotropic share* m is the fraction of
the moment of the copper strands whose limit grows with the slid curvature. A growing slider
represents this fraction. The other fraction follows Masing's rule. First loading is the same for
every m, but unloading and reloading depend on m.

M is the moment of the strands on first loading, and EI is their stiffness before yield. The growing
slider has the stiffness S = m EI, the slid curvature q = kappa - M / EI, and the limit L(q) = m M,
a piecewise linear function. It sticks while |S (kappa - p)| is at most L(q). Otherwise q increases
until the moment equals the limit, and the rest curvature p moves by the same amount towards kappa.
Unlike that of real copper, the limit does not saturate. The law is valid for about three cycles.

For programs without vector sliders, scalar sliders in a few directions replace them. D directions
normal to the wire, at 180 / D degrees from each other, have the same spring and sliders, which act
on the component of the curvature in their direction. The springs are isotropic for D >= 2. The
scalar sliders are not: they slide earlier if the curvature is along a direction than if it is
between two directions. A vector slider that slides at kappa_j is replaced by a scalar slider in
each direction, with the stiffness 2 K_j / D and the moment pi K_j kappa_j / (2 D) at which it
slides. Their mean moment is K_j kappa_j once all slide, but smaller before. Several scalar sliders
are therefore fitted together to the moment of the vector sliders. The directions may be rotated
from one node of a chain to the next (`ROTATIONS`). Their errors then largely cancel, and four
nodes together are nearly isotropic.
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
    require_whole,
)
from labpipe.mechanics.law.thinning import find_hull, require_concave, thin_law
from labpipe.records.arrays import ArrayRecord, Floats

MAX_SLIDERS = 64
"""Largest number of sliders that `fit_sliders` accepts."""
SLIP_TOLERANCE = 1e-9
"""Relative excess over the slip limit up to which a slider counts as sticking in the stiffness.

A slider that has slid is at its slip limit, up to rounding error.
"""


@dataclass(frozen=True, slots=True, eq=False)
class SliderResponse:
    """Response of sliders to a curvature at each station.

    Parameters
    ----------
    moment : shape (stations,), or (stations, 2) for vectors, N m
    stiffness : shape (stations,), or (stations, 2, 2) for vectors, N m^2, derivative of the moment
        at the end of the step with respect to the curvature there (consistent tangent)
    history : shape (stations, n), or (stations, n, 2) for vectors, 1/m, history after the step. The
        first values are the rest curvatures of the sliders. The rest curvature and the slid
        curvature of each growing slider follow. A slid curvature is a scalar; among vectors, it is
        the first component, and the second is zero
    """

    moment: Floats
    stiffness: Floats
    history: Floats


@dataclass(frozen=True, eq=False)
class GrowingSlider(ArrayRecord):
    """A slider whose limit grows with the curvature that has slid.

    Parameters
    ----------
    stiffness : S, N m^2, stiffness of the slider while it sticks, positive
    slid_curvatures : q, shape (corners,), 1/m, from 0, increasing, at least two corners
    limits : L(q), shape (corners,), N m, moments at which the slider slides, positive, not
        decreasing; beyond the last corner, the limit continues with the last slope

    Raises
    ------
    ValueError
        If a parameter is outside its range.
    """

    stiffness: float
    slid_curvatures: Annotated[Floats, "corners"]
    limits: Annotated[Floats, "corners"]

    def __post_init__(self) -> None:
        ArrayRecord.__post_init__(self)
        require_positive("stiffness", self.stiffness)
        curvatures = self.slid_curvatures
        holds = len(curvatures) >= 2 and curvatures[0] == 0.0 and np.all(np.diff(curvatures) > 0.0)
        # Messages name the keys of JSON files from which a slider may be read.
        require("slid", curvatures.tolist(), "from zero and increasing", holds=bool(holds))
        holds = self.limits[0] > 0.0 and np.all(np.diff(self.limits) >= 0.0)
        require("limits", self.limits.tolist(), "positive and not decreasing", holds=bool(holds))

    @cached_property
    def _sums_and_slopes(self) -> tuple[Floats, Floats]:
        """Return g = L(q) + S q at the corners, N m, and dq/dg of each segment, 1 / (N m^2)."""
        sums = self.limits + self.stiffness * self.slid_curvatures
        return sums, np.diff(self.slid_curvatures) / np.diff(sums)

    def scale(self, factor: float) -> GrowingSlider:
        """Return the slider with stiffness and limits multiplied by a positive factor."""
        return GrowingSlider(factor * self.stiffness, self.slid_curvatures, factor * self.limits)

    def compute_limit(self, slid_curvature: Floats) -> Floats:
        """Return the limit, N m, at slid curvatures of any shape, 1/m."""
        segment = self.slid_curvatures[1:-1].searchsorted(slid_curvature, side="right")
        slopes = np.diff(self.limits) / np.diff(self.slid_curvatures)
        offset = slid_curvature - self.slid_curvatures[segment]
        return np.asarray(self.limits[segment] + slopes[segment] * offset)

    def compute_first_loading(self, curvature: Floats) -> Floats:
        """Return the moment of first loading, N m, at curvatures >= 0 of any shape, 1/m."""
        trial_moment = self.stiffness * curvature
        growth, _ = self._find_growth(trial_moment, np.zeros_like(trial_moment))
        return np.asarray(trial_moment - self.stiffness * growth)

    def slide(self, curvature: Floats, history: Floats) -> SliderResponse:
        """Compute moments, tangent stiffnesses and history after a straight step of the curvature.

        Parameters
        ----------
        curvature : shape (stations, axes), 1/m, components of the curvature after the step
        history : shape (stations, 2, axes), 1/m, before the step: rest curvature p, and slid
            curvature q as the first component of the second vector
        """
        trial_moment = self.stiffness * (curvature - history[:, 0])
        magnitude = np.sqrt(np.vecdot(trial_moment, trial_moment))
        growth, tangent = self._find_growth(magnitude, history[:, 1, 0])
        divisor = np.where(magnitude > 0.0, magnitude, 1.0)
        direction = trial_moment / divisor[:, None]
        lateral_stiffness = self.stiffness * (1.0 - self.stiffness * growth / divisor)
        stiffness = (tangent - lateral_stiffness)[:, None, None] * direction[:, :, None]
        stiffness = stiffness * direction[:, None, :]
        stiffness += lateral_stiffness[:, None, None] * np.eye(curvature.shape[1])
        new_history = history.copy()
        new_history[:, 0] += growth[:, None] * direction
        new_history[:, 1, 0] += growth
        moment = self.stiffness * (curvature - new_history[:, 0])
        return SliderResponse(moment, stiffness, new_history)

    def _find_growth(self, trial_moment: Floats, slid_curvature: Floats) -> tuple[Floats, Floats]:
        """Return the increase of q, 1/m, and the stiffness along the trial moment, N m^2.

        The new q solves g(q) = L(q) + S q = trial_moment + S slid_curvature. If this q is not
        larger than `slid_curvature`, the slider sticks. If the slider slides, its stiffness is
        S (1 - S dq/dg).
        """
        sums, slopes = self._sums_and_slopes
        new_sum = trial_moment + self.stiffness * slid_curvature
        segment = sums[1:-1].searchsorted(new_sum, side="right")
        slope = slopes[segment]
        solution = self.slid_curvatures[segment] + slope * (new_sum - sums[segment])
        growth = np.maximum(solution - slid_curvature, 0.0)
        is_sliding = growth > SLIP_TOLERANCE * self.slid_curvatures[-1]
        tangent = self.stiffness * np.where(is_sliding, 1.0 - self.stiffness * slope, 1.0)
        return growth, tangent


def make_growing_slider(curvature: Floats, moment: Floats, share: float) -> GrowingSlider:
    """Build the growing slider that represents the isotropic share of the strands' moment.

    Parameters
    ----------
    curvature : shape (n,), 1/m, on first loading, positive; the first point is elastic
    moment : shape (n,), N m, moment of the strands about their own axes
    share : isotropic share m, above 0 and at most 1

    Raises
    ------
    ValueError
        If `share` or the curve is outside its range.
    """
    require("share", share, "above 0 and at most 1", holds=0.0 < share <= 1.0)
    stiffness = float(moment[0] / curvature[0])
    slid_curvatures = np.maximum.accumulate(np.append(0.0, (curvature - moment / stiffness)[1:]))
    is_rising = np.diff(slid_curvatures, prepend=-1.0) > 1e-12 * slid_curvatures[-1]
    limits = share * np.maximum.accumulate(moment)
    return GrowingSlider(share * stiffness, slid_curvatures[is_rising], limits[is_rising])


@dataclass(frozen=True, slots=True, eq=False)
class SliderLaw(ArrayRecord):
    """A spring and sliders in parallel.

    Parameters
    ----------
    spring_stiffness : EI_0, N m^2, stiffness of the spring, which never slides; may be zero
    slider_stiffnesses : K_j, shape (sliders,), N m^2, stiffness of each slider, positive
    slip_curvatures : kappa_j, shape (sliders,), 1/m, positive and increasing
    min_curvature, max_curvature : 1/m, ends of the range in which the law was fitted; first loading
        is extrapolated beyond `max_curvature`
    error : largest error of the moment of first loading in that range, relative to the moment to
        which the law was fitted; 0 if it was not fitted
    growing_sliders : further sliders with growing limits (isotropic hardening)

    Raises
    ------
    ValueError
        If a parameter is outside its range.
    """

    spring_stiffness: float
    slider_stiffnesses: Annotated[Floats, "sliders"]
    slip_curvatures: Annotated[Floats, "sliders"]
    min_curvature: float
    max_curvature: float
    error: float = 0.0
    growing_sliders: tuple[GrowingSlider, ...] = ()

    def __post_init__(self) -> None:
        ArrayRecord.__post_init__(self)
        # Messages name the keys of JSON files from which a law may be read.
        require_not_negative("stiffness", self.spring_stiffness)
        stiffnesses = self.slider_stiffnesses
        are_valid = bool(np.all((stiffnesses > 0.0) & np.isfinite(stiffnesses)))
        require("stiffnesses", stiffnesses.tolist(), "finite and > 0", holds=are_valid)
        require_rising("slip_curvatures", self.slip_curvatures)
        low, high = self.min_curvature, self.max_curvature
        require("range", (low, high), ">= 0 and increasing", holds=0.0 <= low < high < np.inf)

    @property
    def history_size(self) -> int:
        """Number of values or vectors in the history of a station, n of `SliderResponse`."""
        return len(self.slider_stiffnesses) + 2 * len(self.growing_sliders)

    @property
    def first_stiffness(self) -> float:
        """Bending stiffness before any sliding and after each reversal, N m^2."""
        growing_stiffness = sum(slider.stiffness for slider in self.growing_sliders)
        return self.spring_stiffness + float(np.sum(self.slider_stiffnesses)) + growing_stiffness


def split_hardening(law: SliderLaw, strand_slider: GrowingSlider, share: float) -> SliderLaw:
    """Represent the isotropic share of the strands' moment in a law by a growing slider.

    Parameters
    ----------
    law : law whose spring and sliders include the moment of the strands about their own axes
    strand_slider : growing slider that represents all of that moment, as for an isotropic share of
        1
    share : isotropic share, from 0 to 1; with 0 the law is returned unchanged

    Returns
    -------
    Law with the same moments of first loading at its slip curvatures and at the end of its range. A
    spring stiffness that would become negative is 0. A slider stiffness is at least 1e-9 of the
    first stiffness.
    """
    min_relative_stiffness = 1e-9
    if share == 0.0:
        return law
    growing_slider = strand_slider.scale(share)
    corners = np.concatenate([[0.0], law.slip_curvatures, [law.max_curvature]])
    slopes = np.diff(growing_slider.compute_first_loading(corners)) / np.diff(corners)
    min_stiffness = min_relative_stiffness * law.first_stiffness
    return replace(
        law,
        spring_stiffness=max(law.spring_stiffness - float(slopes[-1]), 0.0),
        slider_stiffnesses=np.maximum(law.slider_stiffnesses + np.diff(slopes), min_stiffness),
        growing_sliders=(*law.growing_sliders, growing_slider),
    )


@dataclass(frozen=True, slots=True, eq=False)
class CurrentSliders:
    """All sliders of a law in their current state; growing sliders are the last.

    Parameters
    ----------
    stiffnesses : shape (sliders,), N m^2, stiffness of each slider
    slip_curvatures : shape (..., sliders), 1/m, distances from the rest curvatures at which the
        sliders slide
    rest_curvatures : shape (..., sliders, 2), 1/m, curvature at which each slider has no moment
    """

    stiffnesses: Floats
    slip_curvatures: Floats
    rest_curvatures: Floats


def get_current_sliders(law: SliderLaw, history: Floats) -> CurrentSliders:
    """Collect stiffnesses, current slip curvatures and rest curvatures of all sliders of a law.

    Parameters
    ----------
    law : law of every station
    history : shape (..., n, 2), 1/m, as in `SliderResponse`
    """
    n_sliders = len(law.slider_stiffnesses)
    slip_arrays = [np.broadcast_to(law.slip_curvatures, (*history.shape[:-2], n_sliders))]
    rest_indices = [*range(n_sliders), *range(n_sliders, history.shape[-2], 2)]
    for index, slider in enumerate(law.growing_sliders):
        limit = slider.compute_limit(history[..., n_sliders + 2 * index + 1, 0])
        slip_arrays.append((limit / slider.stiffness)[..., None])
    stiffnesses = np.append(law.slider_stiffnesses, [x.stiffness for x in law.growing_sliders])
    slip_curvatures = np.concatenate(slip_arrays, axis=-1)
    return CurrentSliders(stiffnesses, slip_curvatures, history[..., rest_indices, :])


def compute_first_loading(law: SliderLaw, curvature: Floats) -> Floats:
    """Return the moment of first loading, N m, in the shape of the curvature.

    Parameters
    ----------
    law : law of the wire
    curvature : any shape, 1/m, any sign
    """
    slider_curvature = np.clip(curvature[..., None], -law.slip_curvatures, law.slip_curvatures)
    slider_moment = slider_curvature @ law.slider_stiffnesses
    moment = np.asarray(law.spring_stiffness * curvature + slider_moment)
    for slider in law.growing_sliders:
        moment = moment + np.sign(curvature) * slider.compute_first_loading(np.abs(curvature))
    return moment


def make_unbent_history(law: SliderLaw, n_stations: int, *, is_vector: bool = False) -> Floats:
    """Return the history of a wire that has never been bent, 1/m, as in `SliderResponse`."""
    return np.zeros((n_stations, law.history_size, *((2,) if is_vector else ())))


def slide(law: SliderLaw, curvature: Floats, history: Floats) -> SliderResponse:
    """Compute moments, tangent stiffnesses and history after a step of curvatures in one plane.

    Parameters
    ----------
    law : law of every station
    curvature : shape (stations,), 1/m, after the step; each is reached monotonically
    history : shape (stations, n), 1/m, history before the step, as in `SliderResponse`

    Notes
    -----
    For a curvature of NaN, moment and history are NaN. A slider exactly at its slip curvature
    counts as sticking in the stiffness.
    """
    trial_curvature = curvature[:, None] - history[:, : len(law.slider_stiffnesses)]
    slider_curvature = np.clip(trial_curvature, -law.slip_curvatures, law.slip_curvatures)
    moment = law.spring_stiffness * curvature + slider_curvature @ law.slider_stiffnesses
    is_sticking = np.abs(trial_curvature) <= (1.0 + SLIP_TOLERANCE) * law.slip_curvatures
    stiffness = law.spring_stiffness + is_sticking @ law.slider_stiffnesses
    new_history = [curvature[:, None] - slider_curvature]
    for slider, slider_history in _split_history(law, history):
        response = slider.slide(curvature[:, None], slider_history[:, :, None])
        moment, stiffness = moment + response.moment[:, 0], stiffness + response.stiffness[:, 0, 0]
        new_history.append(response.history[:, :, 0])
    return SliderResponse(moment, stiffness, np.concatenate(new_history, axis=1))


def slide_vector(law: SliderLaw, curvature: Floats, history: Floats) -> SliderResponse:
    """Compute moments, tangent stiffnesses and history after a step of curvature vectors.

    Parameters
    ----------
    law : law of every station
    curvature : shape (stations, axes), 1/m, components along the axes normal to the wire; each
        vector is reached along a straight line
    history : shape (stations, n, axes), 1/m, history before the step, as in `SliderResponse`

    Notes
    -----
    The update is a radial return. A slider with b = kappa - a_j, |b| > kappa_j, has the moment
    K_j kappa_j b / |b| and d(moment) = K_j kappa_j / |b| (1 - b b^T / |b|^2) d(curvature). A slider
    that sticks has the stiffness K_j in every direction. The update is exact if the curvature
    changes along b. Other changes require small steps.
    """
    slip_curvatures = law.slip_curvatures
    trial_curvature = curvature[:, None, :] - history[:, : len(law.slider_stiffnesses)]
    magnitude = np.sqrt(np.vecdot(trial_curvature, trial_curvature))
    elastic_fraction = slip_curvatures / np.maximum(magnitude, slip_curvatures)
    slider_curvature = trial_curvature * elastic_fraction[..., None]
    moment = law.spring_stiffness * curvature + law.slider_stiffnesses @ slider_curvature
    # The unit vector b / |b| of a slider that slides; zero for a slider that sticks.
    is_sliding = magnitude > (1.0 + SLIP_TOLERANCE) * slip_curvatures
    direction = (is_sliding / slip_curvatures)[..., None] * slider_curvature
    secants = law.slider_stiffnesses * elastic_fraction
    isotropic_stiffness = law.spring_stiffness + secants.sum(axis=1)
    stiffness = isotropic_stiffness[:, None, None] * np.eye(curvature.shape[1])
    stiffness -= np.swapaxes(secants[..., None] * direction, 1, 2) @ direction
    new_history = [curvature[:, None, :] - slider_curvature]
    for slider, slider_history in _split_history(law, history):
        response = slider.slide(curvature, slider_history)
        moment, stiffness = moment + response.moment, stiffness + response.stiffness
        new_history.append(response.history)
    return SliderResponse(moment, stiffness, np.concatenate(new_history, axis=1))


def _split_history(law: SliderLaw, history: Floats) -> Iterator[tuple[GrowingSlider, Floats]]:
    """Yield each growing slider with its part of the history."""
    for index, slider in enumerate(law.growing_sliders):
        start = len(law.slider_stiffnesses) + 2 * index
        yield slider, history[:, start : start + 2]


def bend_to_moment(
    law: SliderLaw, moment: Floats, curvature: Floats, history: Floats
) -> tuple[Floats, SliderResponse]:
    """Find the curvatures at which the moments have new values.

    Parameters
    ----------
    law : law of every station
    moment : shape (stations,), N m; each is reached monotonically
    curvature : shape (stations,), 1/m, curvatures before the step
    history : shape (stations, n), 1/m, history before the step, as in `SliderResponse`

    Returns
    -------
    Curvatures, shape (stations,), 1/m, and the response of the sliders to these. For a moment of
    NaN the curvature is NaN.

    Notes
    -----
    The magnitude of the change of moment is a concave, piecewise linear function of the magnitude
    of the change of curvature. Newton's method therefore converges from below in a finite number of
    steps. The first step assumes that all sliders stick, for a change of either sign.
    """
    max_iterations = 60
    slider_curvature = curvature[:, None] - history[:, : len(law.slider_stiffnesses)]
    old_moment = law.spring_stiffness * curvature + slider_curvature @ law.slider_stiffnesses
    for slider, slider_history in _split_history(law, history):
        old_moment = old_moment + slider.stiffness * (curvature - slider_history[:, 0])
    rounding_error = 1e-13 * max(np.abs(x).max(initial=0.0) for x in (moment, old_moment))
    residual, stiffness = moment - old_moment, law.first_stiffness + np.zeros_like(moment)
    for _ in range(max_iterations):
        curvature = curvature + residual / stiffness
        response = slide(law, curvature, history)
        residual, stiffness = moment - response.moment, response.stiffness
        if np.all(np.abs(residual) <= rounding_error):
            break
    return curvature, response


def convert_to_plays(law: SliderLaw) -> PlayLaw:
    """Convert a law to plays that are valid up to the end of its range.

    Parameters
    ----------
    law : law with a slider or a spring stiffness above 0

    Notes
    -----
    Without growing sliders, both laws have the same first loading and the same loops, because both
    follow Masing's rule. Growing sliders are replaced by plays that have the same first loading at
    the corners and follow Masing's rule.
    """
    slips = law.slip_curvatures[law.slip_curvatures < law.max_curvature]
    corners = np.append(slips if len(slips) else 0.5 * law.max_curvature, law.max_curvature)
    return make_polygon_law(corners, compute_first_loading(law, corners))


def fit_sliders(curvature: Floats, moment: Floats, n_sliders: int) -> SliderLaw:
    """Fit a law of sliders to a curve of first loading; the largest relative error is minimised.

    Parameters
    ----------
    curvature : shape (n,), 1/m, from 0, increasing
    moment : shape (n,), N m, from 0, increasing, concave
    n_sliders : largest number of sliders; there are fewer if the curve has fewer corners

    Raises
    ------
    ValueError
        If `n_sliders` is outside its range, or for the reasons of `thin_law` and `require_concave`.

    Notes
    -----
    The chords between the best points of the curve (`thin_law`) are below it by at most a fraction
    e. Multiplied by 1 + e / (2 - e), they differ from it by at most e / (2 - e) on both sides. The
    slopes of the chords decrease. Each K_j is the decrease of the slope at kappa_j and therefore
    positive. A non-negative least-squares fit on a grid of kappa_j, followed by thinning, has a
    larger error.
    """
    require("n_sliders", n_sliders, f"from 1 to {MAX_SLIDERS}", holds=1 <= n_sliders <= MAX_SLIDERS)
    chords = thin_law(curvature, moment, max_points=n_sliders + 2)
    require_concave(curvature, moment, find_hull(curvature, moment))
    ratios = np.interp(curvature[1:], chords.curvature, chords.moment) / moment[1:]
    scale = 2.0 / (float(ratios.max()) + float(ratios.min()))
    slopes = scale * np.diff(chords.moment) / np.diff(chords.curvature)
    return SliderLaw(
        spring_stiffness=float(slopes[-1]),
        slider_stiffnesses=-np.diff(slopes),
        slip_curvatures=chords.curvature[1:-1],
        min_curvature=float(curvature[1]),
        max_curvature=float(curvature[-1]),
        error=float(np.max(np.abs(scale * ratios - 1.0))),
    )


def make_linear_law(stiffness: float, max_curvature: float) -> SliderLaw:
    """Build a law with constant stiffness and no sliders.

    Parameters
    ----------
    stiffness : bending stiffness, N m^2, positive
    max_curvature : end of the range of the law, 1/m
    """
    require_positive("stiffness", stiffness)
    return SliderLaw(stiffness, np.zeros(0), np.zeros(0), 0.0, max_curvature)


@dataclass(frozen=True, slots=True, eq=False)
class MixedLaw(PlayLaw):
    """Law of a wire with partly isotropic hardening that computes the curvature from the moment.

    The plays describe first loading. They define the stiffness and the range of the law.

    Parameters
    ----------
    slider_law : law with the same first loading; it computes all responses
    """

    slider_law: SliderLaw = field(kw_only=True, repr=False)

    def make_unbent_history(self, n_stations: int) -> Floats:
        """Return the history of a wire that has never been bent.

        Parameters
        ----------
        n_stations : number of stations along the wire

        Returns
        -------
        Shape (stations, 1 + n), 1/m: the curvature, then the history of the sliders, as in
        `SliderResponse`.
        """
        return np.zeros((n_stations, 1 + self.slider_law.history_size))

    def respond(self, moment: Floats, history: Floats) -> Response:
        """Compute the curvatures under new moments.

        Parameters
        ----------
        moment : shape (stations,), N m; each is reached monotonically
        history : shape (stations, 1 + n), 1/m, history after the last step, or that of
            `make_unbent_history`

        Returns
        -------
        Response with the new history, shape (stations, 1 + n), 1/m. For a moment of NaN, curvature
        and history of the station are NaN.
        """
        curvature, response = bend_to_moment(self.slider_law, moment, history[:, 0], history[:, 1:])
        new_history = np.concatenate([curvature[:, None], response.history], axis=1)
        return Response(curvature, 1.0 / response.stiffness, new_history)


def make_mixed_law(plays: PlayLaw, corners: Floats, growing_slider: GrowingSlider) -> MixedLaw:
    """Build the law of a wire whose strands harden partly isotropically.

    Parameters
    ----------
    plays : law of the wire on first loading
    corners : shape (plays + 1,), 1/m, curvatures at the half-widths and at the largest moment of
        `plays`
    growing_slider : slider that represents the isotropic share of the moment of the strands about
        their own axes
    """
    moment = np.append(plays.half_widths, plays.largest_moment)
    masing_moment = moment - growing_slider.compute_first_loading(corners)
    slopes = np.diff(masing_moment, prepend=0.0) / np.diff(corners, prepend=0.0)
    slope_drops = -np.diff(np.minimum.accumulate(slopes))
    has_slider = slope_drops > 0.0
    law = SliderLaw(
        # For a bare solid wire without kinematic hardening, all slopes are rounding errors.
        spring_stiffness=max(float(slopes.min()), 0.0),
        slider_stiffnesses=slope_drops[has_slider],
        slip_curvatures=corners[:-1][has_slider],
        min_curvature=0.0,
        max_curvature=float(corners[-1]),
        growing_sliders=(growing_slider,),
    )
    return MixedLaw(
        plays.stiffness, plays.half_widths, plays.compliances, plays.largest_moment, slider_law=law
    )


MAX_SCALAR_SLIDERS = 16
"""Default of the largest number of scalar sliders in each direction."""
ROTATIONS = (0.0, 0.5, 0.25, 0.75)
"""Rotations of successive nodes, relative to the angle between two directions."""

_N_ANGLE_STEPS = 12
"""Number of steps of a grid of angles of the curvature."""


@dataclass(frozen=True, slots=True, eq=False)
class DirectionalLaw(ArrayRecord):
    """The same spring and scalar sliders in each of a few directions normal to the wire.

    Parameters
    ----------
    n_directions : D, number of directions; the first direction is the first axis normal to the wire
    spring_stiffness : N m^2, stiffness of the spring in each direction
    slider_stiffnesses : shape (sliders,), N m^2, stiffnesses of the sliders in each direction
    slip_curvatures : shape (sliders,), 1/m, component of the curvature at which each slider slides
    error : largest error of the moment component along the curvature, on first loading in any
        direction, relative to the moment of the vector sliders
    transverse_ratio : largest moment component normal to the curvature, on first loading in
        any direction, relative to the moment of the vector sliders
    """

    n_directions: int
    spring_stiffness: float
    slider_stiffnesses: Annotated[Floats, "sliders"]
    slip_curvatures: Annotated[Floats, "sliders"]
    error: float = 0.0
    transverse_ratio: float = 0.0

    def compute_unit_vectors(self, rotation: float) -> Floats:
        """Return unit vectors of the directions, shape (directions, 2), after a rotation.

        The rotation is relative to the angle between two directions.
        """
        angle = np.pi * (np.arange(self.n_directions) + rotation) / self.n_directions
        return np.column_stack([np.cos(angle), np.sin(angle)])


@lru_cache(maxsize=16)  # laws are hashed by identity
def fit_directions(
    law: SliderLaw, n_directions: int, *, max_sliders: int = MAX_SCALAR_SLIDERS
) -> DirectionalLaw:
    """Fit scalar sliders in a few directions to the vector sliders of a law.

    Parameters
    ----------
    law : law with vector sliders
    n_directions : number of directions D, at least 2
    max_sliders : largest number of sliders in each direction

    Raises
    ------
    ValueError
        If `n_directions` is not a whole number >= 2, or `max_sliders` not one >= 1.

    Notes
    -----
    The moment component along the curvature is averaged over the orientation of the curvature and
    fitted to the moment of the vector sliders; errors are relative. The fit is by non-negative
    least squares on a grid of slip curvatures. Slip curvatures without stiffness are dropped, and
    the nearest two are merged until at most `max_sliders` remain.
    """
    n_grid_slips = 48
    # Some scalar sliders slide at a larger curvature than the vector sliders, because only a
    # component of the curvature acts on them.
    last_slip_factor = 1.6
    require_whole("n_directions", n_directions, 2)
    require_whole("max_sliders", max_sliders, 1)
    curvature, target_moment = _tabulate_first_loading(law)
    if not law.slider_stiffnesses.size:
        slips, stiffnesses = np.zeros(0), np.array([law.spring_stiffness])
    else:
        last_slip = min(last_slip_factor * law.slip_curvatures[-1], law.max_curvature)
        slips = np.geomspace(0.5 * law.slip_curvatures[0], last_slip, n_grid_slips)
        if max_sliders < MAX_SCALAR_SLIDERS:  # merging begins with a fit of more sliders
            slips = fit_directions(law, n_directions).slip_curvatures
        stiffnesses = _fit_stiffnesses(curvature, target_moment, slips, n_directions)
        while np.count_nonzero(stiffnesses[1:]) > max_sliders or not np.all(stiffnesses[1:]):
            slips = _reduce_slips(slips, stiffnesses[1:])
            stiffnesses = _fit_stiffnesses(curvature, target_moment, slips, n_directions)
    stiffnesses = 2.0 * stiffnesses / n_directions
    scalar_law = DirectionalLaw(n_directions, float(stiffnesses[0]), stiffnesses[1:], slips)
    return _set_errors(law, scalar_law)


def average_rotations(law: SliderLaw, node_law: DirectionalLaw) -> DirectionalLaw:
    """Average the laws of successive nodes with directions rotated by `ROTATIONS`.

    Parameters
    ----------
    law : law with vector sliders
    node_law : law with scalar sliders of each node

    Returns
    -------
    The mean of four nodes. It has four times the directions, each with a quarter of the stiffness.
    """
    n_nodes = len(ROTATIONS)
    mean_law = replace(
        node_law,
        n_directions=n_nodes * node_law.n_directions,
        spring_stiffness=node_law.spring_stiffness / n_nodes,
        slider_stiffnesses=node_law.slider_stiffnesses / n_nodes,
    )
    return _set_errors(law, mean_law)


@lru_cache(maxsize=4)
def _tabulate_first_loading(law: SliderLaw) -> tuple[Floats, Floats]:
    """Return 80 curvatures, 1/m, over the range of a law, and the moments of first loading, N m.

    If the range starts at 0, the curvatures are over four decades.
    """
    kappa = np.geomspace(law.min_curvature or 1e-4 * law.max_curvature, law.max_curvature, 80)
    return kappa, compute_first_loading(law, kappa)


def _set_errors(law: SliderLaw, scalar_law: DirectionalLaw) -> DirectionalLaw:
    """Return the scalar law with its errors relative to the vector sliders of `law`."""
    curvature, moment = _tabulate_first_loading(law)
    parallel_moment, transverse_moment = _compute_components(scalar_law, curvature)
    return replace(
        scalar_law,
        error=float(np.max(np.abs(parallel_moment / moment[:, None] - 1.0))),
        transverse_ratio=float(np.max(np.abs(transverse_moment / moment[:, None]))),
    )


def _fit_stiffnesses(curvature: Floats, target: Floats, slips: Floats, n_directions: int) -> Floats:
    """Fit D / 2 times the stiffnesses in each direction to target moments, N m^2.

    The shape is (1 + slips,). The spring is first.
    """
    slider_curvatures = _average_slider_curvatures(curvature, slips, n_directions)
    columns = np.column_stack([curvature, slider_curvatures]) / target[:, None]
    return np.asarray(nnls(columns, np.ones(len(curvature)))[0])


def _average_slider_curvatures(curvature: Floats, slips: Floats, n_directions: int) -> Floats:
    """Return the component of the slider curvatures along the curvature, 1/m.

    The component is 2 / D times the sum over the directions, averaged over the orientation of the
    curvature. The shape is (curvatures, slips). If c is the cosine of the angle between the
    curvature and the direction of a slider, the slider slides at curvatures above slip / c. Of the
    sliders sorted by c, the first ones stick and the others slide.
    """
    angle = np.linspace(0.0, np.pi / n_directions, _N_ANGLE_STEPS + 1)[:-1]
    cosines = np.cos(angle[:, None] - np.pi * np.arange(n_directions) / n_directions)
    cosines = np.sort(np.abs(cosines).ravel())
    n_sticking = np.searchsorted(cosines, slips / curvature[:, None])
    sticking_sum = np.append(0.0, np.cumsum(cosines**2))[n_sticking]
    sliding_sum = np.append(np.cumsum(cosines[::-1])[::-1], 0.0)[n_sticking]
    component_sum = sticking_sum * curvature[:, None] + sliding_sum * slips
    return 2.0 / n_directions / len(angle) * component_sum


def _reduce_slips(slips: Floats, stiffnesses: Floats) -> Floats:
    """Drop slip curvatures without stiffness; if all have stiffness, merge the nearest two."""
    stiff_slips = slips[stiffnesses > 0.0]
    if len(stiff_slips) < len(slips):
        return np.asarray(stiff_slips)
    row = int(np.argmin(np.diff(np.log(slips))))
    merged_slip = np.sqrt(slips[row] * slips[row + 1])
    return np.concatenate([slips[:row], [merged_slip], slips[row + 2 :]])


def _compute_components(law: DirectionalLaw, curvature: Floats) -> tuple[Floats, Floats]:
    """Return moment components parallel and normal to the curvature, N m.

    The shape is (curvatures, angles). The angles are from a direction to the middle between two
    directions. The moments at other angles follow by symmetry.
    """
    angle = np.linspace(0.0, 0.5 * np.pi / law.n_directions, _N_ANGLE_STEPS + 2)
    parallel_unit = np.column_stack([np.cos(angle), np.sin(angle)])
    normal_unit = np.column_stack([-parallel_unit[:, 1], parallel_unit[:, 0]])
    directions = law.compute_unit_vectors(0.0)
    corners = np.concatenate([[0.0], law.slip_curvatures, [2.0 * max(curvature[-1], 1.0)]])
    slider_moment = np.minimum(corners[:, None], law.slip_curvatures) @ law.slider_stiffnesses
    corner_moment = law.spring_stiffness * corners + slider_moment
    component = curvature[:, None, None] * (parallel_unit @ directions.T)
    moment = np.sign(component) * np.interp(np.abs(component), corners, corner_moment)
    vectors = moment @ directions
    return np.sum(vectors * parallel_unit, axis=2), np.sum(vectors * normal_unit, axis=2)
