"""Compute the moment-curvature law of a stranded wire with friction.

Axial forces of the strands. Stick (3.7): T = E A kappa r sin(theta) cos^2(alpha), beside the
strand's share F0 of the wire's own tension. Slip (3.14), with k = mu_inner |sin alpha| and
c = (mu_outer + mu_inner) H:

    S = (c + k F0) theta_e expm1(k theta_e) / (k theta_e),   theta_e = arcsin(sin theta),

which is the integral of dF = c d(theta) + k F d(theta) from the neutral axis, where F = F0. The
force has the smaller of the two absolute values and the sign of T (3.16). The dissertation uses
theta itself, so that strands with the same sine have different friction, and the smaller signed
force, which on the side in compression is never friction.

Pressure on a strand of layer q, per radian of its lay (3.11), never negative:

    H = F_rad N_Q / N_q + sum over outer layers k of (F0 + F)_k |sin alpha_k| N_k / N_q

with the force F_k that the outer layer has at the same angle theta. The dissertation's shares N_k /
N_q hold for layers of equal lay length. With `Contacts.lay_lengths` they are multiplied by the
ratio of the lay lengths, r_q tan alpha_k / (r_k tan alpha_q), which equilibrium asks for.

The moment is that of eq. (3.17), with the cos(alpha) of its appendix for the axial forces:

    M = sum F r sin(theta) cos(alpha) + sum h m(kappa) + M_ins(kappa),

with the helix factors h, the moments m of the strands about their own axes, of `wire.materials`,
and the moment M_ins of the insulation, EI_ins kappa unless its material has a curve. The axial
stiffness of the strands stays elastic, as in the dissertation.

On paths that unload, friction and insulation follow Masing's rule. Of the moment of the strands
about their own axes, the isotropic share has a limit that grows as they yield, so that
the wire springs back less; first loading is the same for every share.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from labpipe.mechanics.law.plays import (
    PlayLaw,
    compute_first_curvature,
    make_polygon_law,
    require,
    require_not_negative,
    require_positive,
)
from labpipe.mechanics.law.sliders import MixedLaw, make_mixed_law
from labpipe.mechanics.wire.cross_section import (
    CrossSection,
    compute_stretch_torsion,
    compute_tube_moment,
)
from labpipe.mechanics.wire.materials import Material, compute_strand_moment
from labpipe.records.arrays import ArrayRecord, Flags, Floats, Vector


@dataclass(frozen=True, slots=True)
class Contacts:
    """Friction and pressure between the layers.

    Parameters
    ----------
    inner : friction coefficient of each ring with what lies inside it, first ring first
    outer : of each ring with what lies outside it; for the outermost ring, the insulation
    radial_force : F_rad of the insulation, N per radian of lay and strand of the outermost ring
    lay_lengths : whether the pressure on inner rings accounts for the rings' own lay lengths; the
        dissertation assumes equal ones
    """

    inner: tuple[float, ...]
    outer: tuple[float, ...]
    radial_force: float = 0.0
    lay_lengths: bool = False

    def __post_init__(self) -> None:
        coefficients = self.inner, self.outer
        holds = len(self.inner) == len(self.outer)
        require("inner and outer", coefficients, "of equal length, one for each ring", holds=holds)
        for coefficient in (*self.inner, *self.outer):
            require_not_negative("friction coefficient", coefficient)
        require_not_negative("radial_force", self.radial_force)


def make_contacts(
    n_rings: int, *, strand: float, insulation: float, radial_force: float
) -> Contacts:
    """Return the contacts of an insulated wire: mu_s between strands, mu_p with the insulation.

    A single strand has no rings and no contacts.
    """
    outer = (*[strand] * (n_rings - 1), insulation)[:n_rings]
    return Contacts((strand,) * n_rings, outer, radial_force)


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """A ring, with the demand on its strands and their friction limit at each angle.

    Forces are evaluated at the angles of the ring's strands and, since they press on inner rings,
    at the angles of all inner strands: the first `end` angles, of which the last are the ring's.

    Parameters
    ----------
    start, end : range of the ring's strands, counted over all rings from the innermost
    demand : shape (end,), |T| / kappa, N m
    per_pressure : shape (end,), |S| / H without tension, not negative
    per_tension : shape (end,), |S| where H = 0, N
    tension : F0 of a strand, N
    base : the insulation's part of H, N
    shares : H of this ring for each N of axial force in each ring, by number; 0 for the ring itself
        and inner ones
    """

    start: int
    end: int
    demand: Floats
    per_pressure: Floats
    per_tension: Floats
    tension: float
    base: float
    shares: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """The rings of a wire; the core has no axial force from bending and is left out.

    Parameters
    ----------
    rings : from the innermost
    sign : shape (strands,), 1 on the side in tension, -1 in compression, 0 on the neutral axis
    lever : shape (strands,), r sin(theta) cos(alpha), m, of the axial force
    """

    rings: tuple[Ring, ...]
    sign: Floats
    lever: Floats


class AxialForces(NamedTuple):
    """Axial forces from bending, without the wire's own tension.

    Parameters
    ----------
    force : shape (curvatures, strands), N, positive in tension
    slope : same shape, N m, d(force) / d(curvature)
    stuck : same shape, whether the strand still sticks
    """

    force: Floats
    slope: Floats
    stuck: Flags


def compute_axial_strain(section: CrossSection, tension: float) -> float:
    """Return the axial strain of a straight elastic wire that does not turn about its axis.

    Parameters
    ----------
    section : strands in place
    tension : N

    Returns
    -------
    tension / (sum of E A cos^3(alpha) + E A of the insulation).

    Raises
    ------
    ValueError
        If the tension is negative: compressed strands separate.
    """
    require_not_negative("tension", tension)
    return tension / compute_stretch_torsion(section).axial


def compute_sines(section: CrossSection, orientation: float | Floats) -> Floats:
    """Return the sine of each strand's angle from the neutral axis, without the core.

    Shape (strands,); for a column of orientations one row each.
    """
    min_sine = 1e-12  # a strand on the neutral axis has a smaller one by rounding
    first = int(section.has_core)
    sine = np.sin(section.angle[section.layer >= first] + orientation)
    return np.where(np.abs(sine) < min_sine, 0.0, sine)


def arrange_rings(
    section: CrossSection, contacts: Contacts, sine: Floats, *, tension: float = 0.0
) -> Bundle:
    """Compute demand and friction limit of each ring, which do not depend on the curvature.

    Parameters
    ----------
    section : strands in place
    contacts : of each ring of the section
    sine : shape (strands,), see `compute_sines`
    tension : of the whole wire, N

    Raises
    ------
    ValueError
        If there is not one coefficient for each ring, or tension is negative.

    Notes
    -----
    Strands of a ring may differ in radius (a hexagon, a packing). Their own demand is taken at
    their own radius; where a ring presses on an inner ring, at its root-mean-square radius.
    """
    first = int(section.has_core)
    layers = section.layers[first:]
    number, wanted = len(contacts.inner), f"{len(layers)}, the number of rings"
    require("number of coefficients", number, wanted, holds=number == len(layers))
    is_ring = section.layer >= first
    radius, index = section.radius[is_ring], section.layer[is_ring] - first
    mean_radii = [float(np.sqrt(np.mean(radius[index == q] ** 2))) for q in range(len(layers))]
    lays = np.array([layer.lay_angle for layer in layers])
    counts = np.array([layer.count for layer in layers])
    pressure_factors = np.abs(np.sin(lays)) * counts
    if contacts.lay_lengths:
        pressure_factors *= np.tan(np.abs(lays)) / np.array(mean_radii)
    strain, rings = compute_axial_strain(section, tension), []
    for q, layer in enumerate(layers):
        end, inner = int(counts[: q + 1].sum()), contacts.inner[q]
        rigidity = layer.material.modulus * layer.area * np.cos(layer.lay_angle) ** 2
        own_radius = np.where(index == q, radius, mean_radii[q])[:end]
        k = inner * abs(np.sin(layer.lay_angle))
        friction_angle = np.abs(compute_friction_angle(k, np.arcsin(sine[:end])))
        lay = np.tan(abs(layer.lay_angle)) / mean_radii[q] if contacts.lay_lengths else 1.0
        shares = np.where(np.arange(len(layers)) > q, pressure_factors, 0.0) / (layer.count * lay)
        ring = Ring(
            start=end - layer.count,
            end=end,
            demand=rigidity * own_radius * np.abs(sine[:end]),
            per_pressure=(inner + contacts.outer[q]) * friction_angle,
            per_tension=k * rigidity * strain * friction_angle,
            tension=rigidity * strain,
            base=contacts.radial_force * layers[-1].count / layer.count,
            shares=tuple(shares.tolist()),
        )
        rings.append(ring)
    lever = radius * sine * np.cos(lays)[index] if layers else radius
    return Bundle(tuple(rings), np.sign(sine), lever)


def compute_friction_angle(k: float, angle: Floats) -> Floats:
    """Return expm1(k angle) / k, rad: the angle weighted by friction of the strand's tension."""
    return np.expm1(k * angle) / k if k > 0.0 else angle


def compute_axial_forces(bundle: Bundle, curvature: Floats) -> AxialForces:
    """Compute the axial forces of all strands on first loading, from the outermost ring inwards.

    Parameters
    ----------
    bundle : see `arrange_rings`
    curvature : shape (n, 1), or (n, strands) with its own for each strand; 1/m, without NaN, not
        negative; for bending the other way turn the section by half a turn

    Returns
    -------
    Forces, slopes and which strands stick.
    """
    n_strands = len(bundle.sign)
    shape = (len(curvature), n_strands)
    force, slope, stuck = np.empty(shape), np.empty(shape), np.empty(shape, dtype=np.bool_)
    outer: list[Floats] = []
    ring_slopes: list[Floats] = []
    for q in reversed(range(len(bundle.rings))):
        ring, sign = bundle.rings[q], bundle.sign[: bundle.rings[q].end]
        pressure = compute_ring_pressure(bundle, q, outer)
        outer_rises = enumerate(ring_slopes, start=q + 1)
        slopes = [ring.shares[k] * ring_slope[:, : ring.end] for k, ring_slope in outer_rises]
        pressure_slope = np.where(pressure > 0.0, np.sum(slopes, axis=0), 0.0)  # 0: no contact
        demand = curvature[:, : ring.end] * ring.demand
        friction_limit = pressure * ring.per_pressure + ring.per_tension
        sticks = demand < friction_limit
        ring_force = np.where(sticks, demand, friction_limit) * sign
        ring_slope = np.where(sticks, ring.demand, pressure_slope * ring.per_pressure) * sign
        columns = slice(ring.start, ring.end)
        force[:, columns], slope[:, columns] = ring_force[:, columns], ring_slope[:, columns]
        stuck[:, columns] = sticks[:, columns]
        outer.insert(0, ring_force)
        ring_slopes.insert(0, ring_slope)
    return AxialForces(force, slope, stuck)


def compute_ring_pressure(bundle: Bundle, q: int, outer: list[Floats]) -> Floats:
    """Return the pressure H on a ring at each of its angles, N per radian of lay, not negative.

    Parameters
    ----------
    bundle : see `arrange_rings`
    q : number of the ring
    outer : forces from bending of each ring outside it, next first, N, shape (n, ring.end) each,
        at least as many columns as the ring `q` has angles

    Returns
    -------
    shape (n, ring.end), or (1, 1) for the outermost ring.
    """
    ring = bundle.rings[q]
    pressure = np.full((1, 1), ring.base)
    for k, force in enumerate(outer, start=q + 1):
        pressure = pressure + ring.shares[k] * (bundle.rings[k].tension + force[:, : ring.end])
    return np.asarray(np.maximum(pressure, 0.0))


def find_slip_onsets(
    section: CrossSection, contacts: Contacts, *, tension: float = 0.0, orientation: float = 0.0
) -> Floats:
    """Return the curvature at which each strand outside the core first slips, 1/m.

    Parameters
    ----------
    section, contacts, tension : the wire
    orientation : rad, by which the section is turned against the neutral axis

    Returns
    -------
    Shape (strands,), in the order of the section without the core. A strand on the neutral axis
    gets the limit of strands next to it. Infinite where a strand never slips.

    Notes
    -----
    Within a ring with even friction the strands near the neutral axis slip first, because
    theta_e / sin theta grows with theta. Section 3.2.1 of the dissertation states that those
    farthest from the axis do.
    """
    min_sine = 1e-9
    rounds = 8  # each reduces the bracket to a 128th, down to rounding
    sine = compute_sines(section, orientation)
    nonzero_sine = np.where(sine == 0.0, min_sine, sine)
    bundle = arrange_rings(section, contacts, nonzero_sine, tension=tension)
    strand = np.arange(len(nonzero_sine))
    guesses = np.concatenate([[0.0], 1e-9 * 4.0 ** np.arange(61)])  # 1/m
    curvatures = np.broadcast_to(guesses[:, None], (len(guesses), len(strand)))
    never = np.zeros(len(strand), dtype=np.bool_)
    for number in range(rounds + 1):
        is_slipping = ~compute_axial_forces(bundle, curvatures[1:]).stuck
        is_slipping[-1] |= number > 0  # the upper end of a bracket slips
        never |= ~is_slipping.any(axis=0)
        first_slipping = is_slipping.argmax(axis=0)
        lower, upper = curvatures[first_slipping, strand], curvatures[first_slipping + 1, strand]
        curvatures = lower + (upper - lower) * np.arange(129)[:, None] / 128.0
    return np.where(never, np.inf, lower)


@dataclass(frozen=True, slots=True, eq=False)
class MomentCurve(ArrayRecord):
    """A wire's moment against curvature, and its parts; arrays of shape (n,).

    The moment is stick + slip + bending + plastic + insulation.

    Parameters
    ----------
    curvature : 1/m
    stick : N m, of the axial forces of strands that stick
    slip : N m, of the axial forces of strands that slip
    bending : N m, of the strands about their own axes, if they stayed elastic
    plastic : N m, loss by yielding, of the opposite sign to `bending`
    insulation : N m
    tangent_stiffness : dM / d(kappa), N m^2
    stick_stiffness : N m^2, when nothing slips or yields: the slope at zero curvature
    slip_stiffness : N m^2, of frictionless, elastic strands with the insulation
    """

    curvature: Vector
    stick: Vector
    slip: Vector
    bending: Vector
    plastic: Vector
    insulation: Vector
    tangent_stiffness: Vector
    stick_stiffness: float
    slip_stiffness: float

    @property
    def moment(self) -> Floats:
        """Return the sum of all parts, N m."""
        strand_bending = self.bending + self.plastic
        return np.asarray(self.stick + self.slip + strand_bending + self.insulation)

    @property
    def secant_stiffness(self) -> Floats:
        """Return M / kappa, N m^2; at zero curvature the tangent stiffness.

        Eq. (3.23) of the dissertation mixes the secant and the tangent stiffness; it is not
        implemented.
        """
        is_zero = self.curvature == 0.0
        ratio = self.moment / np.where(is_zero, 1.0, self.curvature)
        return np.where(is_zero, self.tangent_stiffness, ratio)


def compute_stick_stiffness(section: CrossSection, *, orientation: float = 0.0) -> float:
    """Return the bending stiffness while nothing slips or yields, N m^2.

    Parameters
    ----------
    section : strands in place
    orientation : rad, as for `compute_moment_curve`

    Notes
    -----
    The slope of `compute_moment_curve` at zero curvature:
    slip stiffness + sum E A r^2 sin^2(theta) cos^3(alpha). With at least three evenly spread
    strands in every ring it does not depend on the orientation; with two strands it varies by a
    fifth, and in a packing by a few per cent.
    """
    is_ring = section.layer >= int(section.has_core)
    height = section.radius[is_ring] * compute_sines(section, orientation)
    rigidity = section.per_strand(
        layer.material.modulus * layer.area * np.cos(layer.lay_angle) ** 3
        for layer in section.layers
    )
    return compute_slip_stiffness(section) + float(rigidity[is_ring] @ height**2)


def compute_slip_stiffness(section: CrossSection) -> float:
    """Return the bending stiffness of frictionless, elastic strands with the insulation, N m^2.

    Notes
    -----
    sum of E pi d^4 / 64 times the helix factor + E_ins pi / 64 (d_w^4 - (d_w - 2 t)^4).
    """
    strands = sum(
        layer.straight_count * layer.material.modulus * np.pi * layer.diameter**4 / 64.0
        for layer in section.layers
    )
    tube = section.insulation.bending_stiffness if section.insulation else 0.0
    return float(strands + tube)


def compute_moment_curve(
    section: CrossSection,
    contacts: Contacts,
    curvature: Floats,
    *,
    tension: float = 0.0,
    orientation: float = 0.0,
) -> MomentCurve:
    """Compute the moment of first loading at each curvature.

    Parameters
    ----------
    section : strands in place, with their materials
    contacts : friction and pressure
    curvature : shape (n,), 1/m, any order and sign; each is reached monotonically from zero
    tension : of the whole wire, N, present before bending
    orientation : rad, angle of the section from the neutral axis; at 0 a strand of the first ring
        lies on that axis

    Returns
    -------
    The law, its parts and stiffnesses; NaN where the curvature is NaN.

    Raises
    ------
    ValueError
        If a curvature is infinite, if a strand or the insulation is bent beyond the known part of
        its material's curve, if the contacts do not match the rings, or if tension is negative.
    """
    curvatures = np.asarray(curvature, dtype=np.float64)
    infinite = curvatures[np.isinf(curvatures)].tolist()
    require("curvature", infinite, "finite or NaN", holds=not infinite)
    stick, slip, axial_slope = _split_axial(section, contacts, curvatures, tension, orientation)
    elastic_stiffness, strand_moment_sum, bending_slope = sum_strand_moments(section, curvatures)
    zeros = np.zeros_like(curvatures)
    tube = compute_tube_moment(section.insulation, curvatures) if section.insulation else None
    return MomentCurve(
        curvature=curvatures,
        stick=stick,
        slip=slip,
        bending=elastic_stiffness * curvatures,
        plastic=strand_moment_sum - elastic_stiffness * curvatures,
        insulation=zeros if tube is None else tube.moment,
        tangent_stiffness=axial_slope + bending_slope + (zeros if tube is None else tube.tangent),
        stick_stiffness=compute_stick_stiffness(section, orientation=orientation),
        slip_stiffness=compute_slip_stiffness(section),
    )


def _split_axial(
    section: CrossSection, contacts: Contacts, curvature: Floats, tension: float, orientation: float
) -> tuple[Floats, Floats, Floats]:
    """Return moments of sticking and slipping strands, N m, and the slope of their sum, N m^2."""
    stick, slip, slope = np.full((3, len(curvature)), np.nan)
    for side, turn, sign in ((curvature >= 0.0, 0.0, 1.0), (curvature < 0.0, np.pi, -1.0)):
        if side.any():
            sine = compute_sines(section, orientation + turn)
            bundle = arrange_rings(section, contacts, sine, tension=tension)
            axial = compute_axial_forces(bundle, np.abs(curvature[side, None]))
            stick[side] = sign * np.where(axial.stuck, axial.force, 0.0) @ bundle.lever
            slip[side] = sign * np.where(axial.stuck, 0.0, axial.force) @ bundle.lever
            slope[side] = axial.slope @ bundle.lever
    return stick, slip, slope


def sum_strand_moments(section: CrossSection, curvature: Floats) -> tuple[float, Floats, Floats]:
    """Sum elastic stiffnesses, moments and slopes of the strands about their own axes.

    Parameters
    ----------
    section : with the materials of its strands
    curvature : shape (n,), 1/m

    Returns
    -------
    Elastic stiffness, N m^2; moments, N m, and their slopes, N m^2, shape (n,).
    """
    tube = section.insulation.bending_stiffness if section.insulation else 0.0
    moment, slope = np.zeros((2, len(curvature)))
    counts: dict[tuple[Material, float], float] = defaultdict(float)
    for layer in section.layers:
        counts[layer.material, layer.diameter] += layer.straight_count
    for (material, diameter), weight in counts.items():
        straight = compute_strand_moment(material, diameter, curvature)
        moment += weight * straight.moment
        slope += weight * straight.tangent
    return compute_slip_stiffness(section) - tube, moment, slope


def find_orientation_range(
    section: CrossSection,
    contacts: Contacts,
    curve: MomentCurve,
    *,
    tension: float = 0.0,
    n_orientations: int = 24,
) -> tuple[Floats, Floats]:
    """Return the smallest and largest moment over a full turn of the section, N m, shape (n,) each.

    Parameters
    ----------
    section, contacts, tension : as for `compute_moment_curve`
    curve : the law at any orientation
    n_orientations : evenly spread over the full turn, the first at 0
    """
    rings = [layer.count for layer in section.layers if layer.count > 1]
    symmetry = math.gcd(*rings) if rings and section.kind != "packed" else 1
    turns = 2.0 * np.pi * np.arange(n_orientations) / n_orientations
    turns = np.unique(np.round(turns % (2.0 * np.pi / symmetry), 12))
    moment_without_axial_forces = curve.bending + curve.plastic + curve.insulation
    moments = []
    for turn in turns.tolist():
        stick, slip, _ = _split_axial(section, contacts, curve.curvature, tension, turn)
        moments.append(stick + slip + moment_without_axial_forces)
    return np.min(moments, axis=0), np.max(moments, axis=0)


def fit_play_law(
    section: CrossSection,
    contacts: Contacts,
    *,
    largest_curvature: float,
    isotropic_share: float = 0.0,
    n_plays: int = 60,
    tension: float = 0.0,
    orientation: float = 0.0,
) -> PlayLaw:
    """Fit plays whose polygon of first loading meets the wire's law at every corner.

    Parameters
    ----------
    section, contacts, tension, orientation : as for `compute_moment_curve`
    largest_curvature : 1/m, end of the range of the law; `wire.cantilever` raises beyond it
    isotropic_share : of the hardening of the strands on paths that unload, from 0 (Masing's rule)
        to 1; no unit
    n_plays : corners, evenly spread in the logarithm of the curvature over four decades; each slip
        onset of a strand adds one

    Returns
    -------
    The law. Its loops follow Masing's rule, which is exact for Coulomb sliders and hardening
    strands if friction is equal in both directions of slip; for small mu sin(alpha) it nearly is.

    Raises
    ------
    ValueError
        If the moment falls, or its slope rises, with curvature, which plays cannot represent; the
        message states the curvature. If the share is not between 0 and 1; also as
        `compute_moment_curve`.

    Notes
    -----
    For the wires of the dissertation, the polygon with 60 plays differs from the law by at most
    0.3 %.

    Loops slide farther than the range. For a share above 0, the strands' curve is continued to
    eight times the range, or as far as their material is known, and straight from there.
    """
    decades = 4.0  # of curvature below the largest
    min_spacing = 1e-6  # relative; closer corners are merged
    require_positive("largest_curvature", largest_curvature)
    grid = np.geomspace(10.0**-decades, 1.0, n_plays + 1) * largest_curvature
    onsets = find_slip_onsets(section, contacts, tension=tension, orientation=orientation)
    onsets_in_range = onsets[(onsets > grid[0]) & (onsets < grid[-1])]
    knots = np.union1d(grid, onsets_in_range)
    knots = knots[np.diff(knots, prepend=0.0) > min_spacing * knots]
    moment = compute_moment_curve(
        section, contacts, knots, tension=tension, orientation=orientation
    ).moment
    plays = make_polygon_law(knots, moment)
    return plays if isotropic_share == 0.0 else harden(plays, section, isotropic_share)


LOOP_RANGE = 8.0
"""End of the strands' curve in loops, as a multiple of the range of the law."""


def harden(
    plays: PlayLaw, section: CrossSection, isotropic_share: float, *, factor: float = 1.0
) -> MixedLaw:
    """Make the law with partly isotropic hardening of the strands from a law of first loading.

    Parameters
    ----------
    plays : of the section
    section : with the materials of its strands
    isotropic_share : above 0 and at most 1
    factor : on the moments of the strands; the same as in `plays`
    """
    curvature = compute_first_curvature(plays, np.append(plays.half_widths, plays.largest_moment))
    continued_curvature, strands = continue_strands(section, curvature)
    return make_mixed_law(plays, continued_curvature, factor * strands, isotropic_share)


def continue_strands(section: CrossSection, curvature: Floats) -> tuple[Floats, Floats]:
    """Compute the moments of the strands about their own axes, in a range and beyond it for loops.

    Parameters
    ----------
    section : with the materials of its strands
    curvature : shape (n,), 1/m, positive, increasing: of the range

    Returns
    -------
    Curvatures, 1/m: those given, then more up to eight times the range, or to the first end
    of a material's curve if that is nearer; and moments, N m.
    """
    known_curvature = min(
        2.0 * layer.material.largest_strain / layer.diameter for layer in section.layers
    )
    last_curvature = min(LOOP_RANGE * curvature[-1], (1.0 - 1e-9) * known_curvature)
    if last_curvature > curvature[-1]:
        curvature = np.append(curvature, np.geomspace(curvature[-1], last_curvature, 41)[1:])
    return curvature, sum_strand_moments(section, curvature)[1]
