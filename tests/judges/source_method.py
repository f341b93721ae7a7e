"""The source's own calibration, to show what it makes of tests (3.27): a comparison, not advice.

Three numbers, mu_s, mu_p and F_rad, are tuned by a quasi-Newton search on the sum of squares, from
(0.2, 0.2, 0.2); copper and insulation are held at handbook values. The wire has one stiffness from
end to end, the secant one at the clamp, and the string pulls along the normal of the clamped axis.
With one stiffness the shape is that of the elastica, a function of deflection / length alone, so

    F(d) = M(kappa_0) / x,    kappa_0 = alpha x / L^2,

with alpha = P L^2 / EI and x of the elastica at d / L. Loads come out too small (PHYSICS 5), and
friction, which is all that may give, too large. The source's series for the slope of the wire,
whose last coefficient is 51/280 where it should be 5/16, makes loads 2 % larger at the end, and
with it friction less wrong for a wrong reason; it is the default here, since it is what the source
does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize

from labpipe.law.loading_panels import panel_rule
from labpipe.law.plays import LinearLaw
from labpipe.records.arrays import Floats
from labpipe.wire.bending_law import moment_curvature
from labpipe.wire.calibration.fit import Wire
from labpipe.wire.calibration.measured_curves import MeasuredCurve, curve_errors
from labpipe.wire.first_loading import load_cantilever
from labpipe.wire.friction import insulated
from tests.builders.bilinear_laws import law_of_plays

START = (0.2, 0.2, 0.2)
"""mu_s, mu_p, F_rad (N) that the source begins with."""
_NODES, _STEEPEST_SINE = 40, 0.999
_PULL = 8.0  # moment over EI / L at the clamp up to which the elastica is tabulated
_STEEPNESS = 1e-6  # largest slope at rest of the sum of squares over that of the forces
_STEP = 1e-3


@dataclass(frozen=True)
class SourceCalibration:
    """Where the search ended.

    Parameters
    ----------
    strand_friction, radial_friction : mu_s, and phi = F_rad (mu_s + mu_p), N, which is all that the
        tests could say
    converged : whether the search says that it did
    singular_values : shape (3,), of the forces' derivatives by the logarithms, over the RMSE
    rmse : N
    """

    strand_friction: float
    radial_friction: float
    converged: bool
    singular_values: Floats
    rmse: float


def calibrate_as_source(
    wire: Wire,
    curves: Sequence[MeasuredCurve],
    *,
    start: tuple[float, float, float] = START,
    shape: str = "series",
) -> SourceCalibration:
    """Calibrate three friction numbers with one stiffness for the whole wire.

    Parameters
    ----------
    wire : its friction coefficients and radial force are not looked at
    curves : first loadings, all of one wire; neither noise nor samples are told apart
    start : mu_s, mu_p and F_rad (N)
    shape : ``series``, the source's, or ``elastica``, the exact one for one stiffness

    Notes
    -----
    BFGS, as in the source, without bounds: a negative number is taken by its size, since friction
    has no sign. Only phi = F_rad (mu_s + mu_p) moves the forces, so the three depend on the start.
    The sum of squares is taken over that of the forces, so that where the search rests does not
    depend on how many points there are: with more of them it would not rest on the floor of the
    valley, but walk along it to a mu_s of 30 for three parts in a thousand of the misfit.
    """
    force = np.concatenate([curve.force for curve in curves])
    size = float(force @ force)

    def misfit(numbers: Floats) -> float:
        left = source_forces(wire, curves, numbers, shape) - force
        return float(left @ left) / size

    found = minimize(misfit, np.array(start), method="BFGS", options={"gtol": _STEEPNESS})
    strand, insulation, radial = (float(value) for value in np.abs(found.x))
    errors = curve_errors(force, source_forces(wire, curves, found.x, shape))
    return SourceCalibration(
        strand_friction=strand,
        radial_friction=radial * (strand + insulation),
        converged=bool(found.success),
        singular_values=_singular_values(wire, curves, np.abs(found.x), shape, errors.rmse),
        rmse=errors.rmse,
    )


def source_forces(
    wire: Wire, curves: Sequence[MeasuredCurve], numbers: Floats, shape: str
) -> Floats:
    """Forces of the source's model at all points of the curves, N.

    Parameters
    ----------
    wire : copper and insulation
    curves : for their deflections and lengths
    numbers : shape (3,), mu_s, mu_p, F_rad (N), taken by their size
    shape : ``series`` or ``elastica``

    Returns
    -------
    Shape (points,), curve after curve.
    """
    n_rings = len(wire.section.layers) - int(wire.section.has_core)
    strand, insulation, radial = (float(value) for value in np.abs(numbers))
    contacts = insulated(n_rings, strand=strand, insulation=insulation, radial_force=radial)
    table = _series() if shape == "series" else _elastica()
    share = np.concatenate([curve.deflection / curve.length for curve in curves])
    length = np.concatenate([np.full(len(curve.deflection), curve.length) for curve in curves])
    bend, reach = table(np.abs(share)).T
    curvature = np.sign(share) * bend / length
    law = moment_curvature(wire.section, contacts, curvature, orientation=wire.orientation)
    return np.asarray(law.moment / (reach * length))


@lru_cache(maxsize=1)
def _elastica() -> CubicSpline:
    """Curvature at the clamp times length, and x / length, against deflection / length."""
    law = law_of_plays(LinearLaw(1.0), _PULL, n_points=300)
    curve = load_cantilever(law, 1.0, has_memory=False)
    return CubicSpline(curve.deflection, np.column_stack([curve.clamp_curvature, curve.x]))


@lru_cache(maxsize=1)
def _series() -> CubicSpline:
    """The same by the source's series: sin(theta) = U (2 t - t^2) at the share t of the projection.

    Its slope dy/dx = u + u^3 / 2 + 3 u^5 / 8 + 51 u^7 / 280 breaks off tan(theta).
    """
    places, weights = panel_rule(_NODES)
    sine = np.linspace(0.0, _STEEPEST_SINE, 300)[:, None]
    u = sine * (2.0 * places - places**2)
    slope = u + u**3 / 2.0 + 3.0 * u**5 / 8.0 + 51.0 * u**7 / 280.0
    reach = 1.0 / (np.sqrt(1.0 + slope**2) @ weights)
    bend = 2.0 * sine[:, 0] / reach
    return CubicSpline(reach * (slope @ weights), np.column_stack([bend, reach]))


def _singular_values(
    wire: Wire, curves: Sequence[MeasuredCurve], numbers: Floats, shape: str, noise: float
) -> Floats:
    """Of the forces' derivatives by the logarithms of the three, over the noise."""
    columns = []
    for number in range(3):
        up, down = numbers.copy(), numbers.copy()
        up[number] *= 1.0 + _STEP
        down[number] *= 1.0 - _STEP
        rise = source_forces(wire, curves, up, shape) - source_forces(wire, curves, down, shape)
        columns.append(rise / (2.0 * _STEP * noise))
    return np.asarray(np.linalg.svd(np.column_stack(columns), compute_uv=False))
