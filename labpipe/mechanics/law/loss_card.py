"""Fit a law in each form that simulation programs offer, and compute the error of each form.

The error of a form on first loading is the largest difference from the moment of the law, relative
to that moment, over a range of curvatures and for the best fit. A loss card lists these errors.

Programs whose beams have no moment-curvature law use a material. A round bar of radius R with the
curvature kappa has the strain y kappa at the height y (Euler-Bernoulli). Its moment

    M(kappa) = 4 integral from 0 to R of sigma(y kappa) y sqrt(R^2 - y^2) dy

is an integral equation of Abel's type for sigma. It is solved for a piecewise linear stress-strain
curve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from scipy.optimize import lsq_linear, nnls

from labpipe.mechanics.law.sliders import SliderLaw, fit_directions, fit_sliders, turn_directions
from labpipe.records.arrays import ArrayRecord, Floats, Vector
from labpipe.records.wire import WireTable

SLIDER_COUNTS = (4, 6, 8, 12)
"""Maximum number of sliders of each fit on a card."""
N_DIRECTIONS = 4
"""Number of directions of scalar sliders, on a card and in decks."""


@dataclass(frozen=True, slots=True)
class DahlLaw:
    """A spring and one slider with gradual slip, after Dahl (1968).

    M = EI kappa + M_0 (1 - exp(-kappa / tau)) on first loading.

    Parameters
    ----------
    stiffness : EI, N m^2
    moment : M_0, N m
    decay : tau, 1/m
    error : largest error of the fit, relative to the moment
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
    stiffness : N m^2, constant stiffness with the smallest error
    constant : error of the constant stiffness
    dahl : Dahl law with the smallest error
    sliders : number of sliders and error of each fit; fewer sliders than requested if the law has
        fewer corners
    directions : number of directions and error of scalar sliders, for one node and for nodes with
        rotated directions (`turn_directions`). The error is that of `DirectionalLaw`
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
    laws : sliders fitted to the law, at least one fit
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


def fit_dahl(curvature: Floats, moment: Floats) -> DahlLaw:
    """Fit one exponential slider and a spring so that the largest relative error is smallest.

    Parameters
    ----------
    curvature : shape (n,), 1/m, positive and increasing, n >= 2
    moment : shape (n,), N m, positive

    Notes
    -----
    For fixed decay and ratio of the stiffnesses of slider and spring, the error is smallest if the
    largest and the smallest ratio to the moment differ equally from one. Decay and ratio are
    searched on grids of their logarithms. Each grid is narrower than the preceding grid and is
    centred on its best point.
    """
    n_values, n_grids = 15, 24
    narrowing = 0.6  # ratio of the widths of successive grids
    compliance = curvature / moment
    ends = np.log([[1e-4, 1e4], [0.3 * curvature[0], 3.0 * curvature[-1]]])
    for _ in range(n_grids):
        grid = np.linspace(ends[:, 0], ends[:, 1], n_values)
        ratio, decay = np.exp(grid).T
        slider = -decay[:, None] * np.expm1(-curvature / decay[:, None]) / moment
        moment_ratio = compliance + ratio[:, None, None] * slider
        lowest, highest = moment_ratio.min(axis=2), moment_ratio.max(axis=2)
        errors = (highest - lowest) / (highest + lowest)
        row, column = np.unravel_index(np.argmin(errors), errors.shape)
        best_point = np.array([[grid[row, 0]], [grid[column, 1]]])
        ends = best_point + narrowing * (ends - ends.mean(axis=1, keepdims=True))
    stiffness, tau = 2.0 / (lowest + highest)[row, column], decay[column]
    best = stiffness, stiffness * ratio[row] * tau, tau, errors[row, column]
    return DahlLaw(*map(float, best))


DEFAULT_SLIDERS = SLIDER_COUNTS[-1]
"""Default number of sliders; with fewer, residual curvatures have errors of more than 2 %."""


@lru_cache(maxsize=4)  # tables are hashed by identity
def fit_wire_sliders(table: WireTable) -> SliderLaw:
    """Fit at most `DEFAULT_SLIDERS` sliders to a wire over the range of its table.

    Parameters
    ----------
    table : table of the wire

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    return fit_sliders(table.curvature, table.moment, DEFAULT_SLIDERS)


@lru_cache(maxsize=4)
def make_table_card(table: WireTable) -> LossCard:
    """Compute the loss card of a wire over the range of its table.

    Parameters
    ----------
    table : table of the wire

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    curvature, moment = table.curvature, table.moment
    laws = [fit_sliders(curvature, moment, count) for count in SLIDER_COUNTS[:-1]]
    return make_loss_card(curvature, moment, [*laws, fit_wire_sliders(table)])


@dataclass(frozen=True, slots=True, eq=False)
class EquivalentMaterial(ArrayRecord):
    """Stress-strain curve of a material that hardens isotropically, on first loading.

    Parameters
    ----------
    diameter : m, diameter of the bar
    modulus : Pa, modulus up to the first strain
    strain : shape (n,), total strain, increasing; the last is that at the surface at the largest
        curvature
    stress : shape (n,), Pa, not decreasing
    curvature : shape (m,), 1/m, curvatures at which the moments of bar and wire are compared
    error : shape (m,), difference between the moments of bar and wire, relative to that of the wire
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
        """Return strain minus stress / modulus, the plastic strain, shape (n,); it begins at 0."""
        plastic = self.strain - self.stress / self.modulus
        return np.asarray(plastic - plastic[0])


def fit_equivalent_material(
    curvature: Floats,
    moment: Floats,
    diameter: float,
    *,
    elastic_fraction: float = 0.002,
    n_knots: int = 24,
) -> EquivalentMaterial:
    """Fit the material of a round bar to the moment-curvature law of a wire.

    Parameters
    ----------
    curvature : shape (m,), 1/m, positive and increasing, m >= 2, up to the end of the range
    moment : shape (m,), N m, moment of the wire on first loading, positive
    diameter : m, diameter of the bar
    elastic_fraction : curvature up to which the bar is elastic, relative to the largest curvature;
        its stiffness is the secant stiffness of the wire there
    n_knots : number of points of the stress-strain curve, logarithmically spaced, at least 2

    Returns
    -------
    The material, with its error at every curvature. In the elastic range, a wire whose strands do
    not slip is stiffer than the bar.

    Notes
    -----
    The relative error at the points above the elastic range is minimised by least squares with
    bounded slopes (Stark and Parker, Computational Statistics 10 (1995) 129). Slopes are not below
    zero, because a softening bar is unstable, and not above 0.999 of the modulus. A kink
    that is sharper than a round section allows (immediate slip) is rounded, which is included in
    `error`.

    The strain varies linearly over the section, with slope kappa. At strains of a few per cent the
    difference between nominal and true strain has opposite signs on the two sides of the bar and
    cancels to first order.
    """
    radius = 0.5 * diameter
    limit = elastic_fraction * float(curvature[-1])
    strain = np.geomspace(limit, float(curvature[-1]), n_knots) * radius
    secant = float(np.interp(limit, np.append(0.0, curvature), np.append(0.0, moment))) / limit
    modulus = secant / (0.25 * np.pi * radius**4)
    # Moments of bars whose stress increases in one segment of strain only, with unit slope.
    segments = np.diff(_bend_bar(curvature[:, None], strain, radius), axis=1, prepend=0.0)
    columns = modulus * segments / moment[:, np.newaxis]
    is_plastic = curvature > limit
    slopes = _fit_bounded_slopes(columns[is_plastic, 1:], 1.0 - columns[is_plastic, 0])
    slopes = np.append(1.0, slopes)
    stress = modulus * np.cumsum(slopes * np.diff(strain, prepend=0.0))
    return EquivalentMaterial(diameter, modulus, strain, stress, curvature, columns @ slopes - 1.0)


def _fit_bounded_slopes(columns: Floats, target: Floats) -> Floats:
    """Solve least squares with slopes from 0 to `max_slope`; NNLS suffices if none is larger."""
    max_slope = 0.999  # relative to the modulus; a slope of 1 leaves no plastic strain
    iterations_per_slope = 20  # the default of `lsq_linear`, 1, stops some searches early
    limit = iterations_per_slope * columns.shape[1]
    slopes = nnls(columns, target, maxiter=limit)[0]
    if np.any(slopes > max_slope):
        bounds = (0.0, max_slope)
        slopes = lsq_linear(columns, target, bounds=bounds, method="bvls", max_iter=limit).x
    return np.asarray(slopes)


def _bend_bar(curvature: Floats, strain: Floats, radius: float) -> Floats:
    """Return the moment of a bar of unit modulus that is perfectly plastic beyond a strain.

    With c = strain / (kappa R), the half-height of the elastic core relative to the radius,
    M = kappa R^4 / 2 (asin c - c sqrt(1 - c^2) (1 - 2 c^2)) + 4/3 strain R^3 (1 - c^2)^(3/2).
    """
    c = np.minimum(strain / (curvature * radius), 1.0)
    core = np.arcsin(c) - c * np.sqrt(1.0 - c**2) * (1.0 - 2.0 * c**2)
    plastic = 4.0 / 3.0 * strain * radius**3 * (1.0 - c**2) ** 1.5
    return 0.5 * curvature * radius**4 * core + plastic
