"""The law of a wire as a sum of scalable parts, and the loading curve that follows from it.

First loading without tension in the wire is additive,

    M = F m_f(kappa / F) + sum of l m_c(kappa / l) + E_ins m_i(kappa),

exactly: friction is homogeneous in curvature and radial force F; a Ramberg-Osgood curve of
strength c K is that of K with strain and stress stretched by l = c^(1 / (1 - n)), n its exponent.
So m_f, m_c and m_i are tabulated once, and a new set of parameters costs a look-up.

Friction acts through phi = F (mu_s + mu_p) of the outermost ring. For a wire of one ring the law
depends on the three numbers only through phi, apart from mu_s sin(alpha), which changes the
friction angle by less than 0.1 %. For more rings their ratios are kept, and F scales.
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
from labpipe.mechanics.wire.materials import RambergOsgood, compute_elastic_share
from labpipe.records.arrays import Floats
from labpipe.records.wire_calibration import (
    COPPER_SCALE,
    INSULATION_MODULUS,
    PARAMETERS,
    RADIAL_FRICTION,
)

_FRICTION, _INSULATION, _COPPER = (
    PARAMETERS.index(name) for name in (RADIAL_FRICTION, INSULATION_MODULUS, COPPER_SCALE)
)
_MIN_GAP = 1e-6  # relative; nearer curvatures are one

Table: TypeAlias = Callable[[Floats], tuple[Floats, Floats]]
"""Moment, N m, and its slope, N m^2, at curvatures of shape (n,), 1/m."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A part of the moment of a wire, m at a value of 1: v m(kappa), or a m(kappa / a).

    Parameters
    ----------
    parameter : number of the parameter that scales it
    table : m
    last : 1/m, end of the table
    name : of what is known up to there
    power : of the parameter in a; 0 for a part that does not scale, or is proportional
    unit : value of the parameter for which a = 1
    is_proportional : whether the moment is v m(kappa)
    corners : 1/m, where m has corners
    """

    parameter: int
    table: Table
    last: float = np.inf
    name: str = ""
    power: float = 0.0
    unit: float = 1.0
    is_proportional: bool = False
    corners: Floats = field(default_factory=lambda: np.zeros(0))

    def stretch(self, values: Floats) -> float:
        """Return the factor a on curvatures."""
        return float((values[self.parameter] / self.unit) ** self.power)

    def bend(self, values: Floats, curvature: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the moment, its slope, and its derivative by the parameter's logarithm, N m.

        M = a m(kappa / a) changes by M - kappa M' per logarithm of a.
        """
        factor = float(values[self.parameter]) if self.is_proportional else 1.0
        stretch = self.stretch(values)
        moment, slope = self.table(curvature / stretch)
        moment, slope = factor * stretch * moment, factor * slope
        change = moment if self.is_proportional else self.power * (moment - curvature * slope)
        return moment, slope, change


@dataclass(frozen=True, slots=True, eq=False)
class WireParts:
    """A wire ready for calibration.

    Parameters
    ----------
    parts : of friction, insulation, and strands of each exponent
    given : shape (3,), nominal values of `PARAMETERS`; NaN for those that do not act on the wire
    """

    parts: tuple[Part, ...]
    given: Floats

    @property
    def has(self) -> tuple[bool, ...]:
        """Return whether each of `PARAMETERS` acts on the wire."""
        return tuple(np.isfinite(self.given).tolist())

    def reach(self, values: Floats) -> tuple[float, str]:
        """Return the largest curvature up to which all parts are known, 1/m, and its description.

        Parameters
        ----------
        values : shape (3,), of `PARAMETERS`
        """
        end, statement = np.inf, ""
        for part in self.parts:
            last = part.last * part.stretch(values) if np.isfinite(part.last) else np.inf
            if last < end:
                scaled = f" at a copper scale of {values[_COPPER]:.4g}" if part.power else ""
                end, statement = last, f"the {part.name} is known up to {last:.6g} 1/m{scaled}"
        return end, statement

    def bend(self, values: Floats, curvature: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the moment, its slope, and its derivatives by logarithms, shape (3, n), N m."""
        moment, slope = np.zeros((2, len(curvature)))
        changes = np.zeros((len(PARAMETERS), len(curvature)))
        for part in self.parts:
            own_moment, own_slope, change = part.bend(values, curvature)
            moment, slope = moment + own_moment, slope + own_slope
            changes[part.parameter] += change
        return moment, slope, changes


def split_wire(section: CrossSection, contacts: Contacts, *, orientation: float = 0.0) -> WireParts:
    """Tabulate the parts of a wire.

    Parameters
    ----------
    section : strands in place with their materials, and the insulation
    contacts : friction coefficients, whose ratios are kept, and the nominal radial force
    orientation : rad, of the section against the neutral axis
    """
    parts, given = [], np.full(len(PARAMETERS), np.nan)
    coefficients = contacts.inner[-1] + contacts.outer[-1] if contacts.inner else 0.0
    if coefficients > 0.0:
        parts.append(_split_friction(section, contacts, orientation))
        given[_FRICTION] = contacts.radial_force * coefficients
    tube = section.insulation
    if tube is not None:
        last, inertia = np.inf, tube.bending_stiffness / tube.modulus

        def bend_tube(curvature: Floats) -> tuple[Floats, Floats]:
            return inertia * curvature, np.full_like(curvature, inertia)

        table: Table = bend_tube
        if tube.curve is not None:
            curvature = _space_curvatures(tube.curve.largest_strain, tube.outer_radius)
            moment = compute_tube_moment(tube, curvature).moment / tube.modulus
            table, last = _tabulate(curvature, moment), float(curvature[-1])
        insulation = Part(_INSULATION, table, last, "insulation", is_proportional=True)
        parts.append(insulation)
        given[_INSULATION] = tube.modulus
    for exponent in sorted({_find_exponent(layer.material) for layer in section.layers}):
        parts.append(_split_strands(section, exponent))
        if exponent > 0.0:
            given[_COPPER] = 1.0
    return WireParts(tuple(parts), given)


def _split_friction(section: CrossSection, contacts: Contacts, orientation: float) -> Part:
    """Tabulate the moment of the axial forces for a radial force of 1 N: piecewise linear."""
    n_knots = 24  # between the onsets
    end_factor = 4.0  # times the last onset
    corner_tolerance = 1e-9  # of the first slope
    unit = replace(contacts, radial_force=1.0)
    onsets = find_slip_onsets(section, unit, orientation=orientation)
    onsets = onsets[np.isfinite(onsets)]
    even = np.geomspace(onsets.min(), end_factor * onsets.max(), n_knots)
    knots = np.union1d(onsets, even)
    knots = knots[np.diff(knots, prepend=0.0) > _MIN_GAP * knots]
    law = compute_moment_curve(section, unit, knots, orientation=orientation)
    curvature, moment = np.append(0.0, knots), np.append(0.0, law.stick + law.slip)
    slopes = np.diff(moment) / np.diff(curvature)
    bends = np.abs(np.diff(slopes)) > corner_tolerance * slopes[0]
    is_corner = np.concatenate([[True], bends, [False]])
    curvature, moment = curvature[is_corner], moment[is_corner]
    slopes = np.append(np.diff(moment) / np.diff(curvature), 0.0)

    def table(at: Floats) -> tuple[Floats, Floats]:
        panel = np.searchsorted(curvature, at, side="right") - 1
        slope = slopes[panel]
        return moment[panel] + slope * (at - curvature[panel]), slope

    unit_value = contacts.inner[-1] + contacts.outer[-1]
    return Part(_FRICTION, table, power=1.0, unit=unit_value, corners=curvature[1:])


def _find_exponent(material: object) -> float:
    """Return n of a Ramberg-Osgood curve; 0 for a material that has no strength to scale."""
    return material.exponent if isinstance(material, RambergOsgood) else 0.0


def _split_strands(section: CrossSection, exponent: float) -> Part:
    """Tabulate the own moment of the strands of one exponent at a copper scale of 1."""
    largest_strain = 100.0  # scaling the strength shifts the strains
    layers = [layer for layer in section.layers if _find_exponent(layer.material) == exponent]
    rim = max(layer.diameter for layer in layers) / 2.0
    end = min(largest_strain, *(layer.material.largest_strain for layer in layers))
    curvature = _space_curvatures(end, rim)
    moment = np.zeros_like(curvature)
    for layer in layers:
        share = compute_elastic_share(layer.material, curvature * layer.diameter / 2.0)
        stiffness = layer.material.modulus * np.pi * layer.diameter**4 / 64.0
        moment += layer.straight_count * stiffness * curvature * share
    power = 1.0 / (1.0 - exponent) if exponent > 0.0 else 0.0
    table = _tabulate(curvature, moment)
    return Part(_COPPER, table, float(curvature[-1]), "material", power)


def _space_curvatures(largest_strain: float, rim: float) -> Floats:
    """Return the curvatures of a table, 1/m, just within the strains of a curve at a rim, m."""
    least_strain, per_decade = 1e-9, 32
    count = round(np.log10(largest_strain / least_strain) * per_decade)
    strains = np.geomspace(least_strain, largest_strain, count)
    return np.asarray(strains / rim * (1.0 - 1e-12))


def _tabulate(curvature: Floats, moment: Floats) -> Table:
    """Interpolate moment over curvature by its logarithm; below the first the part is linear."""
    secant = CubicSpline(np.log(curvature), moment / curvature)
    rise, first, last = secant.derivative(), curvature[0], curvature[-1]

    def table(at: Floats) -> tuple[Floats, Floats]:
        level = np.log(np.clip(at, first, last))
        share = secant(level)
        return share * at, share + np.where(at > first, rise(level), 0.0)

    return table


def make_loading_table(parts: WireParts, values: Floats, largest_curvature: float) -> LoadingTable:
    """Return the law of first loading at given parameters, with derivatives by their logarithms.

    Parameters
    ----------
    parts : the wire
    values : shape (3,), of `PARAMETERS`; those that do not act are ignored
    largest_curvature : 1/m, end of the table

    Raises
    ------
    ValueError
        If a strand or the insulation is bent beyond the known part of its material's curve.
    """
    knots_per_panel = 4
    corner_offset = 1e-9  # relative distance of a knot from its corner
    _require_known(parts, values, largest_curvature)
    edges = _find_edges(parts, values, largest_curvature)
    shares = np.arange(knots_per_panel) / knots_per_panel
    fine = (edges[:-1, None] + np.diff(edges)[:, None] * shares).ravel()
    curvature = np.append(fine, edges[-1])
    slopes, changes = [], []
    for side in (curvature[:-1] * (1.0 + corner_offset), curvature[1:] * (1.0 - corner_offset)):
        _, slope, change = parts.bend(values, side)
        slopes.append(1.0 / slope)  # strands begin to slip at edges
        changes.append(-change * slopes[-1])
    return LoadingTable(parts.bend(values, curvature)[0], curvature, *slopes, *changes)


def _require_known(parts: WireParts, values: Floats, curvature: float) -> None:
    rounding_share = 1e-9
    known_curvature, statement = parts.reach(values)
    if curvature > known_curvature * (1.0 + rounding_share):
        message = f"curvature={curvature:.6g} 1/m: {statement}"
        raise ValueError(message)


def _find_edges(parts: WireParts, values: Floats, largest: float) -> Floats:
    """Return the edges of the table's panels: even in the logarithm, and corners of friction."""
    n_points = 44
    log_range = 8.0  # logarithm of the last over the first curvature
    spacing_power = 1.5  # knots are denser towards the last
    even = largest * np.exp(-log_range * np.linspace(1.0, 0.0, n_points) ** spacing_power)
    corners = np.concatenate([part.stretch(values) * part.corners for part in parts.parts])
    corners = corners[corners < largest]
    nearest = even[np.minimum(np.searchsorted(even, corners), len(even) - 1)]
    below = even[np.maximum(np.searchsorted(even, corners) - 1, 0)]
    is_apart = np.minimum(np.abs(nearest - corners), np.abs(below - corners)) > _MIN_GAP * corners
    return np.concatenate([[0.0], np.sort(np.concatenate([even, corners[is_apart]]))])


def compute_loading_curve(
    parts: WireParts,
    values: Floats,
    length: float,
    rig: StringRig | None,
    deflection: float,
    *,
    self_weight: float = 0.0,
    near: LoadingCurve | None = None,
) -> LoadingCurve:
    """Compute a loading curve that reaches a deflection.

    Parameters
    ----------
    parts : the wire
    values : shape (3,), of its parameters
    length, deflection : m
    rig : as for `load_cantilever`
    self_weight : N/m, of the wire; the deflection is then from rest
    near : as for `load_cantilever`

    Raises
    ------
    ValueError
        If a material's curve ends before.
    """
    curvature_margin = 3.0  # over a wire whose curvature falls linearly to its tip
    share = min(deflection / length, 0.9)
    known_curvature, _ = parts.reach(values)
    end = min(known_curvature, curvature_margin * 3.0 * share / (1.0 - share**2) / length)
    table = make_loading_table(parts, values, end)
    curve = load_cantilever(table, length, rig, self_weight, deflection, similar=near)
    _require_known(parts, values, float(curve.clamp_curvature.max()))
    return curve
