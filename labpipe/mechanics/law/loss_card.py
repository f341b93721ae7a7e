"""Fit a law in each form that simulation programs offer, and compute the error of each form.

An error on first loading is the largest difference from the law's moment over a range of
curvatures, as a share of that moment, for the best fit of a form. A loss card lists these errors.

Programs whose beams have no moment-curvature law use a material. Plane sections of a round bar of
radius R bent by kappa have the strain y kappa at the height y (Euler-Bernoulli), and so

    M(kappa) = 4 integral from 0 to R of sigma(y kappa) y sqrt(R^2 - y^2) dy

is an integral equation of Abel's kind for sigma. It is solved for a piecewise linear
stress-strain curve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from scipy.optimize import lsq_linear, nnls

from labpipe.mechanics.law.plays import require, require_positive, require_rising
from labpipe.mechanics.law.sliders import (
    SliderLaw,
    fit_directions,
    fit_sliders,
    turn_directions,
)
from labpipe.records.arrays import ArrayRecord, Floats, Ints, Vector
from labpipe.records.wire import WireTable

SLIDER_COUNTS = (4, 6, 8, 12)
"""Largest numbers of sliders of the fits on a card."""
N_DIRECTIONS = 4
"""Number of directions of scalar sliders, on a card and in decks."""

_N_DECAYS = 60
"""Number of decays in a search."""


@dataclass(frozen=True, slots=True)
class DahlLaw:
    """A spring and one slider with gradual slip, after Dahl (1968).

    M = EI kappa + M_0 (1 - exp(-kappa / tau)) on first loading.

    Parameters
    ----------
    stiffness : EI, N m^2
    moment : M_0, N m
    decay : tau, 1/m
    error : largest error of the fit, as a share of the moment
    """

    stiffness: float
    moment: float
    decay: float
    error: float


@dataclass(frozen=True, slots=True)
class LossCard:
    """Errors of a law in each form.

    Parameters
    ----------
    first, last : 1/m, ends of the range
    stiffness : N m^2, the constant stiffness with the smallest error
    constant : error of the constant stiffness
    dahl : the best Dahl law
    sliders : number of sliders and error of each fit; fewer sliders than requested if the law
        has fewer corners
    directions : number of directions and error of scalar sliders, for one node and for nodes with
        turned directions (`turn_directions`): the largest difference of the moment along the
        curvature from that of vector sliders, as a share of the latter, over all directions
    """

    first: float
    last: float
    stiffness: float
    constant: float
    dahl: DahlLaw
    sliders: tuple[tuple[int, float], ...]
    directions: tuple[tuple[int, float], ...]


def make_loss_card(curvature: Floats, moment: Floats, laws: Sequence[SliderLaw]) -> LossCard:
    """Compute the loss card of a law from the sliders fitted to it.

    Parameters
    ----------
    curvature, moment : as for `fit_sliders`
    laws : fits of sliders to it, at least one
    """
    max_rows = 80  # enough for the three parameters of a Dahl law
    curvature, moment = curvature[1:], moment[1:]
    secant = moment / curvature
    low, high = float(secant.min()), float(secant.max())
    rows = np.unique(np.linspace(0.0, len(curvature) - 1.0, max_rows).round().astype(np.int64))
    best_law = min(laws, key=lambda law: law.error)
    scalar_law = fit_directions(best_law, N_DIRECTIONS)
    turned_law = turn_directions(best_law, scalar_law)
    return LossCard(
        first=float(curvature[0]),
        last=float(curvature[-1]),
        stiffness=2.0 * low * high / (low + high),
        constant=(high - low) / (high + low),
        dahl=fit_dahl(curvature[rows], moment[rows]),
        sliders=tuple((len(law.stiffnesses), law.error) for law in laws),
        directions=tuple((law.directions, law.error) for law in (scalar_law, turned_law)),
    )


def compute_turn_loss(curvature: Floats, moment: Floats) -> dict[str, float]:
    """Compute the errors of two forms of unloading for a wire that is bent and straightened again.

    Parameters
    ----------
    curvature : shape (n,), 1/m, from 0, increasing, n >= 2
    moment : shape (n,), N m, from 0, positive

    Returns
    -------
    ``curve``, ``isotropic`` : largest error of unloading along the loading curve, and with
        isotropic hardening, as a share of the moment at the reversal
    ``curve_at``, ``isotropic_at`` : curvatures of the reversals with these errors, 1/m

    Notes
    -----
    The wire is straightened from curvatures kappa_0 up to half of the range, so that a hardening
    law stays within the range. The reference is Masing's rule,
    M = M_0 - 2 M((kappa_0 - kappa) / 2). With isotropic hardening
    M = M_0 - S (kappa_0 - kappa), S the first slope, down to -M_0. Below -M_0 the wire yields in
    the opposite direction, along the first loading shifted by twice its plastic part
    kappa_0 - M_0 / S: M = -M(2 kappa_0 - kappa - 2 M_0 / S).
    """
    n_reversals = 40
    n_points = 41
    slope = moment[1] / curvature[1]
    first, last = min(curvature[1], 0.25 * curvature[-1]), 0.5 * curvature[-1]
    reversal = np.geomspace(first, last, n_reversals)[:, None]
    curvatures = reversal * np.linspace(0.0, 1.0, n_points)
    peak = np.interp(reversal, curvature, moment)
    masing = peak - 2.0 * np.interp(0.5 * (reversal - curvatures), curvature, moment)
    elastic = peak - slope * (reversal - curvatures)
    yielding = -np.interp(2.0 * reversal - curvatures - 2.0 * peak / slope, curvature, moment)
    isotropic = np.where(elastic >= -peak, elastic, yielding)
    forms = {"curve": np.interp(curvatures, curvature, moment), "isotropic": isotropic}
    largest_errors: dict[str, float] = {}
    for name, form_moment in forms.items():
        errors = np.max(np.abs((form_moment - masing) / peak), axis=1)
        worst = int(np.argmax(errors))
        largest_errors |= {name: float(errors[worst]), f"{name}_at": float(reversal[worst, 0])}
    return largest_errors


def fit_dahl(curvature: Floats, moment: Floats) -> DahlLaw:
    """Fit one exponential slider and a spring so that the largest relative error is smallest.

    Parameters
    ----------
    curvature : shape (n,), 1/m, positive and increasing, n >= 2
    moment : shape (n,), N m, positive

    Notes
    -----
    For each of many decays the minimax spring and slider are found by exchange of the three points
    of equal error with alternating sign (Stiefel, Numerische Mathematik 1 (1959) 1-28); the optimum
    is unique because the moment of a unit slider over that of a unit spring decreases. Fits with a
    negative spring or slider are discarded.
    """
    if len(curvature) < 3:  # the exchange requires three points
        middle = 0.5 * (curvature[0] + curvature[-1])
        moment = np.insert(moment, 1, np.interp(middle, curvature, moment))
        curvature = np.insert(curvature, 1, middle)
    coarse = _search_dahl(curvature, moment, 0.3 * curvature[0], 3.0 * curvature[-1])
    range_factor = (10.0 * curvature[-1] / curvature[0]) ** (2.0 / _N_DECAYS)
    return _search_dahl(curvature, moment, coarse.decay / range_factor, coarse.decay * range_factor)


def _search_dahl(
    curvature: Floats, moment: Floats, smallest_decay: float, largest_decay: float
) -> DahlLaw:
    """Return the best Dahl law with one of `_N_DECAYS` decays in a range, 1/m."""
    max_exchanges = 40
    tolerance = 1e-9  # of the error: absolute, and as a share of it
    decay = np.geomspace(smallest_decay, largest_decay, _N_DECAYS)
    spring = np.broadcast_to(curvature / moment, (_N_DECAYS, len(curvature)))
    slider = -np.expm1(-curvature / decay[:, None]) / moment
    points = np.tile([0, len(curvature) // 2, len(curvature) - 1], (_N_DECAYS, 1))
    for _ in range(max_exchanges):
        columns = [np.take_along_axis(column, points, axis=1) for column in (spring, slider)]
        signs = np.broadcast_to([1.0, -1.0, 1.0], points.shape)
        solution = np.linalg.solve(np.stack([*columns, signs], axis=2), np.ones((_N_DECAYS, 3, 1)))
        stiffness, slider_moment, equal_error = solution[..., 0].T
        errors = 1.0 - stiffness[:, None] * spring - slider_moment[:, None] * slider
        worst = np.argmax(np.abs(errors), axis=1)
        largest_error = np.take_along_axis(errors, worst[:, None], axis=1)[:, 0]
        is_larger = np.abs(largest_error) > np.abs(equal_error) * (1.0 + tolerance) + tolerance
        if not is_larger.any():
            break
        swapped = _exchange(
            points, worst, np.sign(largest_error), np.sign(equal_error[:, None]) * signs
        )
        points = np.where(is_larger[:, None], swapped, points)
    is_valid = (stiffness >= 0.0) & (slider_moment >= 0.0)
    error = np.where(is_valid, np.abs(largest_error), np.inf)
    best = int(np.argmin(error))
    return DahlLaw(*map(float, (stiffness[best], slider_moment[best], decay[best], error[best])))


def _exchange(points: Ints, worst: Ints, worst_sign: Floats, signs: Floats) -> Ints:
    """Exchange one of three points for the worst point, so that error signs still alternate."""
    position = np.sum(points < worst[:, None], axis=1)
    row = np.arange(len(points))
    below, above = np.maximum(position - 1, 0), np.minimum(position, 2)
    is_left = (position > 0) & (signs[row, below] == worst_sign)
    is_right = (position < 3) & (signs[row, above] == worst_sign)
    swapped = points.copy()
    swapped[row, np.where(is_left, below, above)] = worst
    shifted_up = np.column_stack([worst, points[:, :2]])
    shifted_down = np.column_stack([points[:, 1:], worst])
    shifted = np.where((position == 0)[:, None], shifted_up, shifted_down)
    return np.where((is_left | is_right)[:, None], swapped, shifted)


DEFAULT_SLIDERS = 12
"""Default number of sliders: with fewer, residual curvatures have errors of more than 2 %."""


@lru_cache(maxsize=16)  # tables are hashed by identity
def fit_wire_sliders(table: WireTable, n_sliders: int = DEFAULT_SLIDERS) -> SliderLaw:
    """Fit sliders to a wire over its whole table.

    Parameters
    ----------
    table : law of the wire
    n_sliders : largest number of sliders

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    return fit_sliders(table.curvature, table.moment, n_sliders)


@lru_cache(maxsize=4)
def make_table_card(table: WireTable) -> LossCard:
    """Compute the loss card of a wire over its table.

    Parameters
    ----------
    table : law of the wire

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    return make_loss_card(
        table.curvature, table.moment, [fit_wire_sliders(table, count) for count in SLIDER_COUNTS]
    )


@dataclass(frozen=True, slots=True, eq=False)
class EquivalentMaterial(ArrayRecord):
    """Stress against strain on first loading, of a material that hardens isotropically.

    Parameters
    ----------
    diameter : of the bar, m
    modulus : Pa, up to the first strain
    strain : shape (n,), total, increasing; the last is that of the surface at the largest curvature
    stress : shape (n,), Pa, not decreasing
    curvature : shape (m,), 1/m, at which the moment was compared with that of the wire
    error : shape (m,), moment of the bar minus that of the wire, as a share of that of the wire
    """

    diameter: float
    modulus: float
    strain: Vector
    stress: Vector
    curvature: Annotated[Floats, "m"]
    error: Annotated[Floats, "m"]

    @property
    def elastic_curvature(self) -> float:
        """Return the curvature at which the bar yields, 1/m."""
        return float(2.0 * self.strain[0] / self.diameter)

    @property
    def plastic_strain(self) -> Floats:
        """Return strain minus stress over modulus, shape (n,); the first is zero."""
        plastic = self.strain - self.stress / self.modulus
        return np.asarray(plastic - plastic[0])

    def find_valid_start(self, tolerance: float) -> float | None:
        """Return the curvature from which the error of the bar stays within a tolerance.

        Parameters
        ----------
        tolerance : share of the wire's moment

        Returns
        -------
        1/m, one of `curvature`; None if the error at the last of them is larger.
        """
        outside = np.flatnonzero(np.abs(self.error) > tolerance)
        first = int(outside[-1]) + 1 if len(outside) else 0
        return float(self.curvature[first]) if first < len(self.curvature) else None


def fit_equivalent_material(
    curvature: Floats,
    moment: Floats,
    diameter: float,
    *,
    elastic_share: float = 0.002,
    n_knots: int = 24,
) -> EquivalentMaterial:
    """Find the material of a round bar whose moment-curvature law is that of a wire.

    Parameters
    ----------
    curvature : shape (m,), 1/m, positive and increasing, m >= 2, up to the end of the range
    moment : shape (m,), N m, of the wire on first loading, positive
    diameter : of the bar, m
    elastic_share : of the largest curvature: up to this share the bar is elastic, with the secant
        stiffness of the wire there
    n_knots : points of the stress-strain curve, spread evenly in the logarithm, at least 2

    Returns
    -------
    The material, with its error at every curvature, also within the elastic range, where a wire
    whose strands do not slip is stiffer.

    Raises
    ------
    ValueError
        If a number is out of its range or NaN, or the arrays have different lengths or fewer than
        two points.

    Notes
    -----
    Least squares of the relative error at the points above the elastic range, with bounded slopes
    (Stark and Parker, Computational Statistics 10 (1995) 129): not below zero, since a bar of
    falling stress is unstable, and not above 0.999 of the modulus. A kink sharper than a round
    section allows (immediate slip) is rounded, which is included in `error`.

    Strain varies linearly over the section, with slope kappa. At strains of a few per cent the
    difference of nominal and true strain is opposite on the two sides of the bar and cancels to
    first order.
    """
    _require_input(curvature, moment, elastic_share, n_knots)
    require_positive("diameter", diameter)
    radius = 0.5 * diameter
    elastic = elastic_share * float(curvature[-1])
    strain = np.geomspace(elastic, float(curvature[-1]), n_knots) * radius
    secant = float(np.interp(elastic, np.append(0.0, curvature), np.append(0.0, moment))) / elastic
    modulus = secant / (0.25 * np.pi * radius**4)
    # moments of bars whose stress rises in one segment of strain only, with unit slope
    segments = np.diff(_bend_bar(curvature[:, None], strain, radius), axis=1, prepend=0.0)
    parts = modulus * segments / moment[:, np.newaxis]
    above = curvature > elastic
    remaining = 1.0 - parts[above, 0]
    slopes = _fit_bounded_slopes(parts[above, 1:], remaining)
    shares = np.append(1.0, slopes)
    stress = modulus * np.cumsum(shares * np.diff(strain, prepend=0.0))
    return EquivalentMaterial(diameter, modulus, strain, stress, curvature, parts @ shares - 1.0)


def _fit_bounded_slopes(parts: Floats, target: Floats) -> Floats:
    """Solve least squares with slopes from 0 to `max_slope`; NNLS suffices if none is larger."""
    max_slope = 0.999  # of the modulus: a slope equal to the modulus leaves no plastic strain
    iterations_per_slope = 20  # with the default of `lsq_linear`, one, some searches stop early
    max_iterations = iterations_per_slope * parts.shape[1]
    slopes = nnls(parts, target, maxiter=max_iterations)[0]
    if np.any(slopes > max_slope):
        bounds = (0.0, max_slope)
        slopes = lsq_linear(parts, target, bounds=bounds, method="bvls", max_iter=max_iterations).x
    return np.asarray(slopes)


def _bend_bar(curvature: Floats, strain: Floats, radius: float) -> Floats:
    """Return the moment of a bar of unit modulus that is perfectly plastic beyond a strain.

    With the half-height c = strain / (kappa R) of the elastic core, as a share of the radius:
    M = kappa R^4 / 2 (asin c - c sqrt(1 - c^2) (1 - 2 c^2)) + 4/3 strain R^3 (1 - c^2)^(3/2).
    """
    core = np.minimum(strain / (curvature * radius), 1.0)
    outside = 1.0 - core**2
    inner = np.arcsin(core) - core * np.sqrt(outside) * (1.0 - 2.0 * core**2)
    return 0.5 * curvature * radius**4 * inner + 4.0 / 3.0 * strain * radius**3 * outside**1.5


def _require_input(curvature: Floats, moment: Floats, elastic_share: float, n_knots: int) -> None:
    lengths = len(curvature), len(moment)
    require("numbers of points", lengths, "equal and >= 2", holds=1 < lengths[0] == lengths[1])
    require_rising("curvature", curvature)
    holds = bool(np.all((moment > 0.0) & np.isfinite(moment * curvature)))
    require("moment", moment.tolist(), "finite and > 0", holds=holds)
    require("elastic_share", elastic_share, "between 0 and 1", holds=0.0 < elastic_share < 1.0)
    require("n_knots", n_knots, ">= 2", holds=n_knots >= 2)
