"""Split the law of a wire into components with one parameter each, and compute loading curves.

On first loading without tension, the moment of a wire is exactly a sum of components,

    M = F m_f(kappa / F) + sum over n of l m_c(kappa / l) + E_ins m_i(kappa).

The moment of friction is homogeneous in curvature and radial force F. If the strength K of a
Ramberg-Osgood curve of exponent n is multiplied by c, the strains and stresses of the curve are
multiplied by l = c^(1 / (1 - n)). Therefore m_f, m_c and m_i are tabulated once, and other values
of the parameters require only interpolation.

The parameter of friction is phi = F (mu_s + mu_p) of the outermost ring, where mu_s is the
coefficient against strands and mu_p that against the insulation. The law of a wire with one ring
depends on F, mu_s and mu_p nearly only through phi: the dependence on mu_s sin(alpha), where alpha
is the lay angle, changes the friction angle by less than 0.1 %. For several rings, the ratios of
the coefficients are taken as constant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline

from labpipe.mechanics.law.plays import LoadingTable
from labpipe.mechanics.wire.bending_law import Contacts, compute_moment_curve, find_slip_onsets
from labpipe.mechanics.wire.cantilever import StringRig
from labpipe.mechanics.wire.cross_section import CrossSection, compute_tube_moment
from labpipe.mechanics.wire.first_loading import LoadingCurve, load_cantilever
from labpipe.mechanics.wire.materials import Material, RambergOsgood, compute_elastic_ratio
from labpipe.records.arrays import Floats
from labpipe.records.wire import COPPER_SCALE, INSULATION_MODULUS, PARAMETERS, RADIAL_FRICTION

FRICTION, INSULATION, COPPER = (
    PARAMETERS.index(name) for name in (RADIAL_FRICTION, INSULATION_MODULUS, COPPER_SCALE)
)
"""Indices of radial friction, modulus of the insulation and copper scale in `PARAMETERS`."""
_MIN_CURVATURE_GAP = 1e-6
"""Relative difference below which two curvatures are merged."""

MomentFunction: TypeAlias = Callable[[Floats], tuple[Floats, Floats]]
"""Function of curvatures, 1/m, that returns moments, N m, and tangent stiffnesses, N m^2.

All arrays have the shape (n,).
"""


@dataclass(frozen=True, slots=True, eq=False)
class LawComponent:
    """Component of the moment of a wire that depends on the value v of one parameter.

    The moment is v m(kappa), or a m(kappa / a) with a = (v / v_0)^power.

    Parameters
    ----------
    parameter_index : index of the parameter in `PARAMETERS`
    compute_unit_moment : function that returns m and its derivative
    last_curvature : 1/m, last curvature for which m is known
    limit_name : name of the material or part that limits the curvature
    power : exponent of v / v_0 in a; 0 if a does not depend on v
    reference_value : v_0, value of the parameter for which a = 1
    is_proportional : whether the moment is v m(kappa)
    corners : shape (corners,), 1/m, curvatures at which m has corners
    """

    parameter_index: int
    compute_unit_moment: MomentFunction
    last_curvature: float = np.inf
    limit_name: str = ""
    power: float = 0.0
    reference_value: float = 1.0
    is_proportional: bool = False
    corners: Floats = field(default_factory=lambda: np.zeros(0))

    def compute_scale(self, values: Floats) -> float:
        """Compute the factor a on curvatures."""
        return float((values[self.parameter_index] / self.reference_value) ** self.power)

    def compute_moment(self, values: Floats, curvature: Floats) -> tuple[Floats, Floats, Floats]:
        """Compute moment, tangent stiffness, and derivative with respect to the log parameter, N m.

        The derivative of M = a m(kappa / a) with respect to the logarithm of a is M - kappa M'.
        """
        factor = float(values[self.parameter_index]) if self.is_proportional else 1.0
        scale = self.compute_scale(values)
        moment, slope = self.compute_unit_moment(curvature / scale)
        moment, slope = factor * scale * moment, factor * slope
        derivative = moment if self.is_proportional else self.power * (moment - curvature * slope)
        return moment, slope, derivative


@dataclass(frozen=True, slots=True, eq=False)
class WireLaw:
    """Law of a wire on first loading, as the sum of components.

    Parameters
    ----------
    components : components of friction, of the insulation, and of the strands of each
        Ramberg-Osgood exponent
    nominal : shape (3,), nominal values of `PARAMETERS`; NaN for inactive parameters
    """

    components: tuple[LawComponent, ...]
    nominal: Floats

    @property
    def is_active(self) -> tuple[bool, ...]:
        """Whether each of `PARAMETERS` has an effect on the wire."""
        return tuple(np.isfinite(self.nominal).tolist())

    def find_known_range(self, values: Floats) -> tuple[float, str]:
        """Find the curvature up to which all components are known, 1/m, and describe its cause.

        Parameters
        ----------
        values : shape (3,), values of `PARAMETERS`
        """
        known_curvature, cause = np.inf, ""
        for component in self.components:
            last_curvature = component.last_curvature * component.compute_scale(values)
            if last_curvature < known_curvature:
                known_curvature, name = last_curvature, component.limit_name
                at_scale = f" at a copper scale of {values[COPPER]:.4g}" if component.power else ""
                cause = f"the {name} is known up to {last_curvature:.6g} 1/m{at_scale}"
        return known_curvature, cause

    def compute_moment(self, values: Floats, curvature: Floats) -> tuple[Floats, Floats, Floats]:
        """Compute moment, tangent stiffness, and derivatives with respect to log parameters, N m.

        The derivatives have the shape (3, n).
        """
        moment, slope = np.zeros((2, len(curvature)))
        derivatives = np.zeros((len(PARAMETERS), len(curvature)))
        for component in self.components:
            addend, addend_slope, derivative = component.compute_moment(values, curvature)
            moment, slope = moment + addend, slope + addend_slope
            derivatives[component.parameter_index] += derivative
        return moment, slope, derivatives


def split_law(section: CrossSection, contacts: Contacts, *, orientation: float = 0.0) -> WireLaw:
    """Split the law of a wire into its components, and tabulate them.

    Parameters
    ----------
    section : cross-section of the wire
    contacts : nominal radial force, and friction coefficients, whose ratios are not changed
    orientation : rad, rotation of the section relative to the neutral axis
    """
    components, nominal = [], np.full(len(PARAMETERS), np.nan)
    if contacts.friction_sum > 0.0:
        components.append(_split_friction(section, contacts, orientation))
        nominal[FRICTION] = contacts.radial_force * contacts.friction_sum
    tube = section.insulation
    if tube is not None:
        limit = tube.curve.largest_strain / tube.outer_radius if tube.curve else np.inf

        def bend_tube(curvature: Floats) -> tuple[Floats, Floats]:
            moment, slope = compute_tube_moment(tube, np.minimum(curvature, limit))
            return moment / tube.modulus, slope / tube.modulus

        component = LawComponent(INSULATION, bend_tube, limit, "insulation", is_proportional=True)
        components.append(component)
        nominal[INSULATION] = tube.modulus
    for exponent in sorted({_get_exponent(layer.material) for layer in section.layers}):
        components.append(_split_strands(section, exponent))
        if exponent > 0.0:
            nominal[COPPER] = 1.0
    return WireLaw(tuple(components), nominal)


def _split_friction(section: CrossSection, contacts: Contacts, orientation: float) -> LawComponent:
    """Tabulate the moment of the axial forces of strands for a radial force of 1 N."""
    n_knots = 24  # number of knots in addition to the slip onsets
    last_knot_factor = 4.0  # last knot relative to the last onset
    corner_tolerance = 1e-9  # smallest change of slope at a corner, relative to the first slope
    unit_contacts = replace(contacts, radial_force=1.0)
    onsets = find_slip_onsets(section, unit_contacts, orientation=orientation)
    onsets = onsets[np.isfinite(onsets)]
    knots = np.geomspace(onsets.min(), last_knot_factor * onsets.max(), n_knots)
    knots = np.union1d(onsets, knots)
    knots = knots[np.diff(knots, prepend=0.0) > _MIN_CURVATURE_GAP * knots]
    law = compute_moment_curve(section, unit_contacts, knots, orientation=orientation)
    curvature, moment = np.append(0.0, knots), np.append(0.0, law.stick + law.slip)
    slopes = np.diff(moment) / np.diff(curvature)
    slope_changes = np.abs(np.diff(slopes)) > corner_tolerance * slopes[0]
    is_corner = np.concatenate([[True], slope_changes, [False]])
    curvature, moment = curvature[is_corner], moment[is_corner]
    slopes = np.append(np.diff(moment) / np.diff(curvature), 0.0)

    def interpolate(x: Floats) -> tuple[Floats, Floats]:
        segment = np.searchsorted(curvature, x, side="right") - 1
        slope = slopes[segment]
        return moment[segment] + slope * (x - curvature[segment]), slope

    component = LawComponent(FRICTION, interpolate, power=1.0, corners=curvature[1:])
    return replace(component, reference_value=contacts.friction_sum)


def _get_exponent(material: Material) -> float:
    """Return n of a Ramberg-Osgood curve; 0 for a material without a strength K."""
    return material.exponent if isinstance(material, RambergOsgood) else 0.0


def _split_strands(section: CrossSection, exponent: float) -> LawComponent:
    """Tabulate the moment of strands of one exponent about their own axes, at copper scale 1."""
    min_strain, points_per_decade = 1e-9, 32
    max_strain = 100.0  # large, because the strains scale with the strength
    layers = [layer for layer in section.layers if _get_exponent(layer.material) == exponent]
    rim_radius = max(layer.diameter for layer in layers) / 2.0
    max_strain = min(max_strain, *(layer.material.largest_strain for layer in layers))
    n_points = round(np.log10(max_strain / min_strain) * points_per_decade)
    strain = np.geomspace(min_strain, max_strain, n_points)
    curvature = strain / rim_radius * (1.0 - 1e-12)  # strains must not exceed the last strain
    moment = np.zeros_like(curvature)
    for layer in layers:
        ratio = compute_elastic_ratio(layer.material, curvature * layer.diameter / 2.0)
        moment += layer.straight_count * layer.strand_stiffness * curvature * ratio
    power = 1.0 / (1.0 - exponent) if exponent > 0.0 else 0.0
    unit_moment = _interpolate_moment(curvature, moment)
    return LawComponent(COPPER, unit_moment, float(curvature[-1]), "material", power)


def _interpolate_moment(curvature: Floats, moment: Floats) -> MomentFunction:
    """Return a function that interpolates the secant stiffness over log curvature.

    The secant stiffness is constant below the first point and beyond the last.
    """
    spline = CubicSpline(np.log(curvature), moment / curvature)
    derivative, first, last = spline.derivative(), curvature[0], curvature[-1]

    def interpolate(x: Floats) -> tuple[Floats, Floats]:
        logarithm = np.log(np.clip(x, first, last))
        secant = spline(logarithm)
        return secant * x, secant + np.where(x > first, derivative(logarithm), 0.0)

    return interpolate


def make_loading_table(law: WireLaw, values: Floats, largest_curvature: float) -> LoadingTable:
    """Tabulate first loading for values of the parameters, with sensitivities.

    Parameters
    ----------
    law : law of the wire, split into its components
    values : shape (3,), values of `PARAMETERS`; inactive parameters are ignored
    largest_curvature : 1/m, end of the table, within the known range of the law
    """
    knots_per_interval = 4
    corner_offset = 1e-9  # relative distance from a corner at which slopes are evaluated
    edges = _find_edges(law, values, largest_curvature)
    fractions = np.arange(knots_per_interval) / knots_per_interval
    knots = (edges[:-1, None] + np.diff(edges)[:, None] * fractions).ravel()
    curvature = np.append(knots, edges[-1])
    compliances, sensitivities = [], []
    for points in (curvature[:-1] * (1.0 + corner_offset), curvature[1:] * (1.0 - corner_offset)):
        _, slope, derivative = law.compute_moment(values, points)
        compliances.append(1.0 / slope)  # discontinuous at edges, where strands begin to slip
        sensitivities.append(-derivative * compliances[-1])
    moment, _, _ = law.compute_moment(values, curvature)
    return LoadingTable(moment, curvature, *compliances, *sensitivities)


def _find_edges(law: WireLaw, values: Floats, largest_curvature: float) -> Floats:
    """Return the edges of the intervals of a table, 1/m: a graded grid, and corners of friction."""
    n_points = 44
    log_range = 8.0  # logarithm of the ratio of the last to the first curvature
    spacing_power = 1.5  # points are denser near the last curvature
    grid = largest_curvature * np.exp(-log_range * np.linspace(1.0, 0.0, n_points) ** spacing_power)
    corners = np.concatenate([part.compute_scale(values) * part.corners for part in law.components])
    corners = corners[corners < largest_curvature]
    above = grid[np.minimum(np.searchsorted(grid, corners), len(grid) - 1)]
    below = grid[np.maximum(np.searchsorted(grid, corners) - 1, 0)]
    gap = np.minimum(np.abs(above - corners), np.abs(below - corners))
    corners = corners[gap > _MIN_CURVATURE_GAP * corners]
    return np.concatenate([[0.0], np.sort(np.concatenate([grid, corners]))])


def compute_loading_curve(
    law: WireLaw,
    values: Floats,
    length: float,
    rig: StringRig | None,
    deflection: float,
    *,
    self_weight: float = 0.0,
    guess: LoadingCurve | None = None,
) -> LoadingCurve:
    """Compute the force-deflection curve of first loading up to a deflection.

    Parameters
    ----------
    law : law of the wire, split into its components
    values : shape (3,), values of `PARAMETERS`
    length : m, length of the wire
    rig : string and counterweight; None for an end load normal to the undeformed axis
    deflection : m, deflection of the tip from rest
    self_weight : N/m, weight per length of the wire
    guess : curve of the same cantilever for the same deflection with a similar law; None if there
        is none

    Raises
    ------
    ValueError
        If the stress-strain curve of a material ends before the deflection is reached, or no
        equilibrium is found.
    """
    curvature_margin = 3.0  # relative to a wire whose curvature decreases linearly to the tip
    ratio = min(deflection / length, 0.9)
    rounding_tolerance = 1e-9  # relative to the known curvature
    known_curvature, cause = law.find_known_range(values)
    last_curvature = curvature_margin * 3.0 * ratio / (1.0 - ratio**2) / length
    table = make_loading_table(law, values, min(known_curvature, last_curvature))
    curve = load_cantilever(table, length, rig, self_weight, deflection, guess=guess)
    clamp_curvature = float(curve.clamp_curvature.max())
    if clamp_curvature > known_curvature * (1.0 + rounding_tolerance):
        message = f"curvature={clamp_curvature:.6g} 1/m: {cause}"
        raise ValueError(message)
    return curve
