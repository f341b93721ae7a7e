"""Fit simpler laws and a material to a moment-curvature law, and compute the error of each fit.

Simulation programs offer different forms of law. The error of a form is the largest relative error
of the moment on first loading, over a range of curvatures, for the best fit. A loss card lists
these errors.

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

from labpipe.mechanics.law.sliders import SliderLaw, average_rotations, fit_directions, fit_sliders
from labpipe.records.arrays import ArrayRecord, Floats, Vector
from labpipe.records.wire import WireTable

SLIDER_COUNTS = (4, 6, 8, 12)
"""Largest number of sliders of each fit on a loss card."""
N_DIRECTIONS = 4
"""Number of directions of scalar sliders on a loss card and in decks."""


@dataclass(frozen=True, slots=True)
class DahlLaw:
    """A spring and one slider with gradual slip, after Dahl [1]_.

    The moment on first loading is M = EI kappa + M_0 (1 - exp(-kappa / tau)).

    Parameters
    ----------
    stiffness : EI, N m^2, stiffness of the spring
    moment : M_0, N m, largest moment of the slider
    decay : tau, 1/m, curvature at which the slider has 63 % of its largest moment
    error : largest error of the moment, relative to the moment to which the law was fitted

    References
    ----------
    .. [1] P. R. Dahl, A solid friction model, Aerospace Corporation, report TOR-0158(3107-18)-1
           (1968).
    """

    stiffness: float
    moment: float
    decay: float
    error: float


@dataclass(frozen=True, slots=True)
class LossCard:
    """Errors of simpler forms of a moment-curvature law.

    Parameters
    ----------
    stiffness : N m^2, constant stiffness with the smallest error
    stiffness_error : error of the moment with this stiffness
    dahl_law : Dahl law with the smallest error
    slider_errors : number of sliders and error of each fit; the number is smaller than requested if
        the law has fewer corners
    direction_errors : number of directions and error of scalar sliders, first for one node, then
        for nodes with rotated directions (`average_rotations`); see `DirectionalLaw`
    """

    stiffness: float
    stiffness_error: float
    dahl_law: DahlLaw
    slider_errors: tuple[tuple[int, float], ...]
    direction_errors: tuple[tuple[int, float], ...]


def make_loss_card(curvature: Floats, moment: Floats, slider_laws: Sequence[SliderLaw]) -> LossCard:
    """Compute the loss card of a moment-curvature law.

    Parameters
    ----------
    curvature, moment : points of the law, as for `fit_sliders`
    slider_laws : fits of sliders to the law, at least one
    """
    max_rows = 80  # number of points to which the three parameters of a Dahl law are fitted
    curvature, moment = curvature[1:], moment[1:]
    secants = moment / curvature
    min_secant, max_secant = float(secants.min()), float(secants.max())
    rows = np.unique(np.linspace(0.0, len(curvature) - 1.0, max_rows).round().astype(np.int64))
    best_law = min(slider_laws, key=lambda law: law.error)
    node_law = fit_directions(best_law, N_DIRECTIONS)
    mean_law = average_rotations(best_law, node_law)
    return LossCard(
        stiffness=2.0 * min_secant * max_secant / (min_secant + max_secant),
        stiffness_error=(max_secant - min_secant) / (max_secant + min_secant),
        dahl_law=fit_dahl(curvature[rows], moment[rows]),
        slider_errors=tuple((len(law.slider_stiffnesses), law.error) for law in slider_laws),
        direction_errors=tuple((law.n_directions, law.error) for law in (node_law, mean_law)),
    )


def fit_dahl(curvature: Floats, moment: Floats) -> DahlLaw:
    """Fit a Dahl law to a first loading; the largest relative error is minimised.

    Parameters
    ----------
    curvature : shape (n,), 1/m, positive and increasing, n >= 2
    moment : shape (n,), N m, positive

    Notes
    -----
    The two parameters of the search are the decay tau and the initial stiffness of the slider,
    M_0 / tau, relative to EI. For given values of both, the error is smallest if the largest and
    the smallest ratio of the fitted moment to the moment differ equally from one. The search uses
    grids of the logarithms of the two parameters. Each grid is narrower than the preceding grid and
    centred on the best point of that grid.
    """
    size, n_grids = 15, 24  # values of a parameter on a grid, and successive grids
    narrowing = 0.6  # ratio of the widths of successive grids
    compliance = curvature / moment
    ends = np.log([[1e-4, 1e4], [0.3 * curvature[0], 3.0 * curvature[-1]]])
    for _ in range(n_grids):
        grid = np.linspace(ends[:, 0], ends[:, 1], size)
        ratio, decay = np.exp(grid).T
        slider_part = -decay * np.expm1(-curvature[:, None] / decay) / moment[:, None]
        # Axes: curvature, pair of ratio and decay. The moment is that of a spring with EI = 1.
        moment_ratio = compliance[:, None] + np.repeat(ratio, size) * np.tile(slider_part, size)
        min_ratio, max_ratio = moment_ratio.min(axis=0), moment_ratio.max(axis=0)
        errors = (max_ratio - min_ratio) / (max_ratio + min_ratio)
        row, column = divmod(best := int(np.argmin(errors)), size)
        best_point = np.array([[grid[row, 0]], [grid[column, 1]]])
        ends = best_point + narrowing * (ends - ends.mean(axis=1, keepdims=True))
    stiffness, tau = 2.0 / (min_ratio + max_ratio)[best], decay[column]
    parameters = stiffness, stiffness * ratio[row] * tau, tau, errors[best]
    return DahlLaw(*map(float, parameters))


DEFAULT_SLIDERS = SLIDER_COUNTS[-1]
"""Default largest number of sliders; with fewer, the residual curvature errs by more than 2 %."""


@lru_cache(maxsize=4)  # tables are hashed by identity
def fit_wire_sliders(table: WireTable) -> SliderLaw:
    """Fit at most `DEFAULT_SLIDERS` sliders to the moment-curvature table of a wire.

    Parameters
    ----------
    table : table of the wire

    Raises
    ------
    ValueError
        For the reasons of `fit_sliders`.
    """
    return fit_sliders(table.curvature, table.moment, DEFAULT_SLIDERS)


@lru_cache(maxsize=4)
def make_table_card(table: WireTable) -> LossCard:
    """Compute the loss card of the moment-curvature table of a wire.

    Parameters
    ----------
    table : table of the wire

    Raises
    ------
    ValueError
        For the reasons of `fit_sliders`.
    """
    laws = [fit_sliders(table.curvature, table.moment, count) for count in SLIDER_COUNTS[:-1]]
    return make_loss_card(table.curvature, table.moment, [*laws, fit_wire_sliders(table)])


@dataclass(frozen=True, slots=True, eq=False)
class EquivalentMaterial(ArrayRecord):
    """Material of a round bar that has nearly the moments of a wire on first loading.

    Parameters
    ----------
    diameter : m, diameter of the bar
    modulus : Pa, modulus of elasticity up to the first strain
    strain : shape (n,), total strains, increasing; the last is the strain at the surface of the bar
        at the largest curvature
    stress : shape (n,), Pa, stress at each strain, not decreasing
    curvature : shape (m,), 1/m, curvatures at which the moments of bar and wire are compared
    error : shape (m,), moment of the bar minus moment of the wire, relative to that of the wire
    """

    diameter: float
    modulus: float
    strain: Vector
    stress: Vector
    curvature: Annotated[Floats, "m"]
    error: Annotated[Floats, "m"]

    @property
    def elastic_curvature(self) -> float:
        """Curvature at which the bar yields, 1/m."""
        return float(2.0 * self.strain[0] / self.diameter)

    @property
    def plastic_strain(self) -> Floats:
        """Plastic strains, strain - stress / modulus, shape (n,); the first is 0."""
        plastic_strain = self.strain - self.stress / self.modulus
        return np.asarray(plastic_strain - plastic_strain[0])


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
    curvature : shape (m,), 1/m, positive and increasing, m >= 2; the last is the largest curvature
        of the material
    moment : shape (m,), N m, moment of the wire on first loading, positive
    diameter : m, diameter of the bar
    elastic_fraction : curvature up to which the bar is elastic, relative to the largest curvature.
        The elastic stiffness of the bar is the secant stiffness of the wire at this curvature
    n_knots : number of points of the stress-strain curve, logarithmically spaced, at least 2

    Returns
    -------
    The material, with its error at every curvature. In the elastic range, a wire whose strands do
    not slip is stiffer than the bar.

    Notes
    -----
    The relative errors at the curvatures above the elastic range are minimised by least squares
    with bounded slopes of the stress-strain curve (Stark and Parker, Computational Statistics 10
    (1995) 129). Slopes are at least zero, because a softening bar is unstable, and at most 0.999 of
    the modulus. The bar rounds a kink of the law that is sharper than a round section allows
    (immediate slip). `error` includes this difference.

    The strain varies linearly over the section, with slope kappa. At strains of a few per cent the
    difference between nominal and true strain has opposite signs on the two sides of the bar and
    cancels to first order.
    """
    radius = 0.5 * diameter
    elastic_limit = elastic_fraction * float(curvature[-1])
    strain = np.geomspace(elastic_limit, float(curvature[-1]), n_knots) * radius
    elastic_moment = np.interp(elastic_limit, np.append(0.0, curvature), np.append(0.0, moment))
    modulus = float(elastic_moment) / elastic_limit / (0.25 * np.pi * radius**4)
    # Moments of bars whose stress increases only in one interval of strain, with unit slope.
    interval_moments = np.diff(_bend_bar(curvature[:, None], strain, radius), axis=1, prepend=0.0)
    columns = modulus * interval_moments / moment[:, np.newaxis]
    plastic_rows = columns[curvature > elastic_limit]
    slopes = np.append(1.0, _fit_bounded_slopes(plastic_rows[:, 1:], 1.0 - plastic_rows[:, 0]))
    stress = modulus * np.cumsum(slopes * np.diff(strain, prepend=0.0))
    return EquivalentMaterial(diameter, modulus, strain, stress, curvature, columns @ slopes - 1.0)


def _fit_bounded_slopes(columns: Floats, target: Floats) -> Floats:
    """Fit slopes from 0 to `max_slope`, relative to the modulus, by least squares."""
    max_slope = 0.999  # a slope of 1 leaves no plastic strain
    iterations_per_slope = 20  # the default of `lsq_linear`, 1, stops some searches early
    max_steps = iterations_per_slope * columns.shape[1]
    slopes = nnls(columns, target, maxiter=max_steps)[0]
    if np.any(slopes > max_slope):
        slopes = lsq_linear(columns, target, (0.0, max_slope), method="bvls", max_iter=max_steps).x
    return np.asarray(slopes)


def _bend_bar(curvature: Floats, strain: Floats, radius: float) -> Floats:
    """Return the moment of a bar of unit modulus that is perfectly plastic beyond a strain.

    c = min(strain / (kappa R), 1) is the half-height of the elastic core relative to the radius.
    The moment is (kappa R^4 / 2) (asin c - c sqrt(1 - c^2) (1 - 2 c^2)) +
    (4 / 3) strain R^3 (1 - c^2)^(3/2).
    """
    c = np.minimum(strain / (curvature * radius), 1.0)
    core_factor = np.arcsin(c) - c * np.sqrt(1.0 - c**2) * (1.0 - 2.0 * c**2)
    plastic_moment = 4.0 / 3.0 * strain * radius**3 * (1.0 - c**2) ** 1.5
    return 0.5 * curvature * radius**4 * core_factor + plastic_moment
