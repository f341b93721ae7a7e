"""The law of a wire as a sum of scalable parts, and the loading curve that follows from it.

First loading without tension in the wire is additive,

    M = F m_f(kappa / F) + sum of l m_c(kappa / l) + E_ins I kappa,

exactly: friction is homogeneous in curvature and radial force F; a Ramberg-Osgood curve of
strength c K is that of K with strain and stress stretched by l = c^(1 / (1 - n)), n its exponent.
So m_f and m_c are tabulated once, and a new set of parameters costs a look-up.

Friction acts through phi = F (mu_s + mu_p) of the outermost ring. For a wire of one ring the law
depends on the three numbers only through phi, apart from mu_s sin(alpha), which changes the
friction angle by less than 0.1 %. For more rings their ratios are kept, and F scales.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline

from labpipe.mechanics.law.plays import LoadingTable
from labpipe.mechanics.wire.bending_law import compute_moment_curve
from labpipe.mechanics.wire.cantilever import StringRig
from labpipe.mechanics.wire.cross_section import CrossSection, Insulation, compute_tube_moment
from labpipe.mechanics.wire.first_loading import (
    LoadingCurve,
    load_cantilever,
)
from labpipe.mechanics.wire.friction import Contacts, find_slip_onsets
from labpipe.mechanics.wire.materials import (
    RambergOsgood,
    compute_elastic_share,
    compute_helix_factor,
)
from labpipe.records.arrays import Floats
from labpipe.records.wire_calibration import PARAMETERS

_TABLE_STRAINS = (1e-9, 100.0, 32)
"""Range of rim strains of the copper's table, and its knots per decade. Scaling the strength shifts
the strains."""
_LOADING_POINTS = 44  # of a loading curve
_MIN_GAP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class FrictionPart:
    """Moment of the axial forces for a radial force of 1 N: piecewise linear.

    Parameters
    ----------
    curvature : shape (knots,), 1/m per N, from 0
    moment : shape (knots,), N m per N; constant beyond the last
    coefficients : mu_s + mu_p of the outermost ring: phi for 1 N
    """

    curvature: Floats
    moment: Floats
    coefficients: float


@dataclass(frozen=True, slots=True, eq=False)
class CopperPart:
    """Own moment of the strands of one exponent at copper scale 1.

    Parameters
    ----------
    exponent : n of the Ramberg-Osgood curve; 0 for a material that has no strength to scale
    first, last : 1/m, ends of the table; below the first the strands are elastic
    table : moment / curvature against the curvature's logarithm
    """

    exponent: float
    first: float
    last: float
    table: CubicSpline

    def stretch(self, scale: float) -> float:
        """Return the factor on curvatures at a copper scale."""
        return float(scale ** (1.0 / (1.0 - self.exponent))) if self.exponent > 0.0 else 1.0


@dataclass(frozen=True, slots=True, eq=False)
class WireParts:
    """A wire ready for calibration.

    Parameters
    ----------
    friction : None without rings or friction coefficients
    copper : one part for each exponent
    inertia : m^4, of the insulation: E_ins times it is its stiffness
    tube : share of the linear moment, against the logarithm of the curvature; None for
        a linear insulation
    given : shape (3,), nominal values of `PARAMETERS`; NaN where the wire has none
    """

    friction: FrictionPart | None
    copper: tuple[CopperPart, ...]
    inertia: float
    tube: CubicSpline | None
    given: Floats

    @property
    def has(self) -> tuple[bool, bool, bool]:
        """Return whether each of `PARAMETERS` acts on the wire."""
        yields = any(part.exponent > 0.0 for part in self.copper)
        return self.friction is not None, self.inertia > 0.0, yields

    def reach(self, values: Floats) -> tuple[float, str]:
        """Return the largest curvature up to which all parts are known, 1/m, and its description.

        Parameters
        ----------
        values : shape (3,), of `PARAMETERS`
        """
        ends = [(np.inf, "")]
        if self.tube is not None:
            last = float(np.exp(self.tube.x[-1]))
            ends.append((last, f"the insulation is known up to {last:.6g} 1/m"))
        for part in self.copper:
            last = part.last * part.stretch(float(values[2]))
            scaled = f" at a copper scale of {values[2]:.4g}" if part.exponent > 0.0 else ""
            ends.append((last, f"the material is known up to {last:.6g} 1/m{scaled}"))
        return min(ends)


@dataclass(frozen=True, slots=True, eq=False)
class _Bent:
    """A part, or the whole, bent to n curvatures.

    Parameters
    ----------
    moment, slope : shape (n,), N m, N m^2
    change : shape (3, n), N m, derivatives of the moment at constant curvature by the logarithms of
        the parameters
    """

    moment: Floats
    slope: Floats
    change: Floats


Pair: TypeAlias = tuple[Floats, Floats]
"""Moment, N m, and its slope, N m^2."""


def split_wire(section: CrossSection, contacts: Contacts, *, orientation: float = 0.0) -> WireParts:
    """Tabulate the parts of a wire.

    Parameters
    ----------
    section : strands in place with their materials, and the insulation
    contacts : friction coefficients, whose ratios are kept, and the nominal radial force
    orientation : rad, of the section against the neutral axis
    """
    friction = _friction(section, contacts, orientation)
    tube = section.insulation
    phi = contacts.radial_force * friction.coefficients if friction else np.nan
    exponents = {_exponent(layer.material) for layer in section.layers}
    copper = tuple(_copper(section, exponent) for exponent in sorted(exponents))
    has_plastic = any(part.exponent > 0.0 for part in copper)
    nominal = np.array([phi, tube.modulus if tube else np.nan, 1.0 if has_plastic else np.nan])
    inertia = tube.bending_stiffness / tube.modulus if tube else 0.0
    return WireParts(friction, copper, inertia, _tube(tube), nominal)


def _friction(section: CrossSection, contacts: Contacts, orientation: float) -> FrictionPart | None:
    n_knots = 24  # between the onsets
    end_factor = 4.0  # times the last onset
    corner_tolerance = 1e-9  # of the first slope
    if not contacts.inner or contacts.inner[-1] + contacts.outer[-1] == 0.0:
        return None
    unit = replace(contacts, radial_force=1.0)
    onsets = find_slip_onsets(section, unit, orientation=orientation)
    onsets = onsets[np.isfinite(onsets)]
    even = np.geomspace(onsets.min(), end_factor * onsets.max(), n_knots)
    knots = np.union1d(onsets, even)
    knots = knots[np.diff(knots, prepend=0.0) > _MIN_GAP * knots]
    law = compute_moment_curve(section, unit, knots, orientation=orientation)
    curvature = np.concatenate([[0.0], knots])
    moment = np.concatenate([[0.0], law.stick + law.slip])
    slopes = np.diff(moment) / np.diff(curvature)
    bends = np.abs(np.diff(slopes)) > corner_tolerance * slopes[0]
    is_corner = np.concatenate([[True], bends, [False]])
    curvature, moment = curvature[is_corner], moment[is_corner]
    return FrictionPart(curvature, moment, contacts.inner[-1] + contacts.outer[-1])


def _tube(tube: Insulation | None) -> CubicSpline | None:
    """Tabulate an insulation with a stress table; its modulus scales all stresses."""
    if tube is None or tube.curve is None:
        return None
    curvature = _table_curvatures(tube.curve.largest_strain, tube.outer_radius)
    secant = compute_tube_moment(tube, curvature).moment / curvature
    return CubicSpline(np.log(curvature), secant / tube.bending_stiffness)


def _table_curvatures(largest_strain: float, rim: float) -> Floats:
    """Return the curvatures of a table, 1/m, just within the strains of a curve at a rim, m."""
    least, _, per_decade = _TABLE_STRAINS
    count = round(np.log10(largest_strain / least) * per_decade)
    return np.asarray(np.geomspace(least, largest_strain, count) / rim * (1.0 - 1e-12))


def _exponent(material: object) -> float:
    return material.exponent if isinstance(material, RambergOsgood) else 0.0


def _copper(section: CrossSection, exponent: float) -> CopperPart:
    layers = [layer for layer in section.layers if _exponent(layer.material) == exponent]
    rim = max(layer.diameter for layer in layers) / 2.0
    most = min(_TABLE_STRAINS[1], *(layer.material.largest_strain for layer in layers))
    curvature = _table_curvatures(most, rim)
    moment = np.zeros_like(curvature)
    for layer in layers:
        share = compute_elastic_share(layer.material, curvature * layer.diameter / 2.0)
        stiffness = layer.material.modulus * np.pi * layer.diameter**4 / 64.0
        lay = compute_helix_factor(layer.lay_angle, layer.poisson)
        moment += layer.count * lay * stiffness * curvature * share
    table = CubicSpline(np.log(curvature), moment / curvature)
    return CopperPart(exponent, float(curvature[0]), float(curvature[-1]), table)


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
    edges = _edges(parts, values, largest_curvature)
    shares = np.arange(knots_per_panel) / knots_per_panel
    fine = (edges[:-1, None] + np.diff(edges)[:, None] * shares).ravel()
    curvature = np.append(fine, edges[-1])
    slopes, changes = [], []
    for side in (curvature[:-1] * (1.0 + corner_offset), curvature[1:] * (1.0 - corner_offset)):
        bent = _bend(parts, values, side)
        slopes.append(1.0 / bent.slope)  # strands begin to slip at edges
        changes.append(-bent.change * slopes[-1])
    moment = _bend(parts, values, curvature).moment
    return LoadingTable(moment, curvature, *slopes, *changes)


def _require_known(parts: WireParts, values: Floats, curvature: float) -> None:
    rounding_share = 1e-9
    known_curvature, statement = parts.reach(values)
    if curvature > known_curvature * (1.0 + rounding_share):
        message = f"curvature={curvature:.6g} 1/m: {statement}"
        raise ValueError(message)


def _edges(parts: WireParts, values: Floats, largest: float) -> Floats:
    """Return the edges of the table's panels: even in the logarithm, and corners of friction."""
    log_range = 8.0  # logarithm of the last over the first curvature
    spacing_power = 1.5  # knots are denser towards the last
    even = largest * np.exp(-log_range * np.linspace(1.0, 0.0, _LOADING_POINTS) ** spacing_power)
    corners = np.zeros(0)
    if parts.friction is not None:
        force = values[0] / parts.friction.coefficients
        corners = force * parts.friction.curvature[1:]
    corners = corners[corners < largest]
    nearest = even[np.minimum(np.searchsorted(even, corners), len(even) - 1)]
    below = even[np.maximum(np.searchsorted(even, corners) - 1, 0)]
    is_apart = np.minimum(np.abs(nearest - corners), np.abs(below - corners)) > _MIN_GAP * corners
    return np.concatenate([[0.0], np.sort(np.concatenate([even, corners[is_apart]]))])


def _bend(parts: WireParts, values: Floats, curvature: Floats) -> _Bent:
    """Sum all parts.

    With the stretch a of a part, M = a m(kappa / a) changes by M - kappa M' per logarithm of a;
    that of the insulation is proportional to its modulus.
    """
    moment, slope = np.zeros((2, len(curvature)))
    change = np.zeros((len(PARAMETERS), len(curvature)))

    def add(number: int, part: Pair, stretches: float) -> None:
        nonlocal moment, slope
        moment, slope = moment + part[0], slope + part[1]
        change[number] += stretches * (part[0] - curvature * part[1])

    if parts.friction is not None:
        force = values[0] / parts.friction.coefficients
        add(0, _friction_moment(parts.friction, force, curvature), 1.0)
    if parts.inertia > 0.0:
        insulation = _insulation_moment(parts, values[1], curvature)
        add(1, insulation, 0.0)
        change[1] = insulation[0]
    for copper in parts.copper:
        stretches = 1.0 / (1.0 - copper.exponent) if copper.exponent > 0.0 else 0.0
        add(2, _copper_moment(copper, values[2], curvature), stretches)
    return _Bent(moment, slope, change)


def _insulation_moment(parts: WireParts, modulus: float, curvature: Floats) -> Pair:
    """Return moment and slope of the insulation at a modulus."""
    stiffness = modulus * parts.inertia
    if parts.tube is None:
        return stiffness * curvature, np.full_like(curvature, stiffness)
    first, last = np.exp(parts.tube.x[[0, -1]])
    level = np.log(np.clip(curvature, first, last))
    share = parts.tube(level)
    bend = np.where(curvature > first, parts.tube(level, 1), 0.0)
    return stiffness * share * curvature, stiffness * (share + bend)


def _friction_moment(part: FrictionPart, force: float, curvature: Floats) -> Pair:
    """Return moment and slope of friction at a radial force, N."""
    stretched = curvature / force
    panel = np.searchsorted(part.curvature, stretched, side="right") - 1
    slope = np.append(np.diff(part.moment) / np.diff(part.curvature), 0.0)[panel]
    return force * (part.moment[panel] + slope * (stretched - part.curvature[panel])), slope


def _copper_moment(part: CopperPart, scale: float, curvature: Floats) -> Pair:
    """Return moment and slope of the strands' own bending at a copper scale."""
    stretch = part.stretch(scale)
    level = np.log(np.maximum(curvature / stretch, part.first))
    secant = part.table(level)
    bend = np.where(curvature > part.first * stretch, part.table(level, 1), 0.0)
    return secant * curvature, secant + bend


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
    curve = load_cantilever(table, length, rig, self_weight, deflection, near=near)
    _require_known(parts, values, float(curve.clamp_curvature.max()))
    return curve
