"""Compute the moment-curvature law of a stranded wire with friction.

The model follows chapter 3 of [1]_; numbers in parentheses are equations of [1]_. A ring is a
layer of strands around the core. theta is the angle of a strand from the neutral axis, alpha the
lay angle.

A strand has the axial force F0 from the tension of the wire, and bending adds a force. While the
strand sticks, the added force is T = E A kappa r sin(theta) cos^2(alpha) (3.7). While it slips, the
added force is S (3.14). With k = mu_inner |sin alpha| and c = (mu_outer + mu_inner) H,

    S = (c + k F0) theta_e expm1(k theta_e) / (k theta_e),   theta_e = arcsin(sin theta).

S is the integral of dF = c d(theta) + k F d(theta) from the neutral axis, where F = F0. The added
force has the smaller of the two absolute values and the sign of T (3.16). There are two differences
from the dissertation. It uses theta instead of theta_e, so that strands with the same sine have
different friction. It takes the smaller signed force, which in compression is never the friction.

The pressure H on a strand of ring q, per radian of its lay, is never negative (3.11):

    H = F_rad N_Q / N_q + sum over outer rings k of (F0 + F)_k |sin alpha_k| N_k / N_q

F_k is the added force of ring k at the same angle theta, N_k is the number of strands of ring k, Q
is the outermost ring, and F_rad is the radial force of the insulation. The factors N_k / N_q of
[1]_ hold for rings of equal lay length. With `Contacts.has_lay_lengths` they are multiplied by the
ratio of the lay lengths of the rings, r_q tan alpha_k / (r_k tan alpha_q), as equilibrium requires.

The moment is that of (3.17), with the factor cos(alpha) that only the appendix of [1]_ has:

    M = sum F r sin(theta) cos(alpha) + sum h m(kappa) + M_ins(kappa).

h is the helix factor and m the moment of a strand about its own axis (`wire.materials`). The moment
of the insulation, M_ins, is EI_ins kappa unless its material has a stress-strain curve. The strands
are elastic under axial forces, as in [1]_.

On paths that unload, friction and insulation follow Masing's rule. The isotropic part of the moment
of the strands about their own axes has a limit that grows as the strands yield. The larger this
part, the less the wire springs back. First loading does not depend on it.

References
----------
.. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
       dissertation.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
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
from labpipe.mechanics.law.sliders import GrowingSlider, make_growing_slider, make_mixed_law
from labpipe.mechanics.wire.cross_section import (
    CrossSection,
    Layer,
    compute_stretch_torsion,
    compute_tube_moment,
)
from labpipe.mechanics.wire.materials import BendingMoment, Material, compute_strand_moment
from labpipe.records.arrays import ArrayRecord, Flags, Floats, Vector


@dataclass(frozen=True, slots=True)
class Contacts:
    """Friction coefficients of the rings, and radial force of the insulation.

    Parameters
    ----------
    inner_friction : mu_inner, friction coefficient of each ring against the next inner layer, from
        the innermost ring
    outer_friction : mu_outer, friction coefficient of each ring against the next outer ring; for
        the outermost ring, against the insulation
    radial_force : F_rad of the insulation, N per radian of lay and strand of the outermost ring
    has_lay_lengths : whether the pressure on inner rings depends on the lay length of each ring;
        otherwise all rings are taken to have the same lay length
    """

    inner_friction: tuple[float, ...]
    outer_friction: tuple[float, ...]
    radial_force: float = 0.0
    has_lay_lengths: bool = False

    def __post_init__(self) -> None:
        coefficients = self.inner_friction, self.outer_friction
        holds = len(self.inner_friction) == len(self.outer_friction)
        require("friction", coefficients, "of equal length, one for each ring", holds=holds)
        for coefficient in (*self.inner_friction, *self.outer_friction):
            require_not_negative("friction coefficient", coefficient)
        require_not_negative("radial_force", self.radial_force)

    @property
    def friction_sum(self) -> float:
        """Sum mu_inner + mu_outer of the outermost ring; 0 without rings."""
        return sum((*self.inner_friction[-1:], *self.outer_friction[-1:]))


def make_contacts(
    n_rings: int, *, strand: float, insulation: float, radial_force: float
) -> Contacts:
    """Make the contacts of an insulated wire.

    Parameters
    ----------
    n_rings : number of rings; 0 for a single strand, which has no contacts
    strand : mu_s, friction coefficient between strands
    insulation : mu_p, friction coefficient between strands and insulation
    radial_force : F_rad, N per radian of lay and strand of the outermost ring
    """
    outer = (*[strand] * (n_rings - 1), insulation)[:n_rings]
    return Contacts((strand,) * n_rings, outer, radial_force)


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """Properties of a ring that determine its axial forces, at each angle.

    A ring presses on inner rings. Its forces are therefore evaluated at the angles of its own
    strands and of all inner strands. These are `end_index` angles; those from `start_index` on
    belong to the ring.

    Parameters
    ----------
    start_index, end_index : range of the strands of the ring, counted over all rings from the
        innermost
    stick_stiffness : shape (end_index,), |T| / kappa, N m
    slip_per_pressure : shape (end_index,), |S| / H without tension, not negative
    tension_slip_force : shape (end_index,), |S| without pressure, N
    tension : F0, tension of a strand, N
    insulation_pressure : part of H that the insulation exerts, N
    pressure_factors : H on this ring per axial force of a strand of each ring, from the innermost
        ring; 0 for the ring itself and for inner rings
    """

    start_index: int
    end_index: int
    stick_stiffness: Floats
    slip_per_pressure: Floats
    tension_slip_force: Floats
    tension: float
    insulation_pressure: float
    pressure_factors: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class RingModel:
    """Rings of a wire; the core has no axial force from bending and is left out.

    Parameters
    ----------
    rings : rings from the innermost
    sign : shape (strands,), sign of the axial force from bending; 0 on the neutral axis
    lever_arm : shape (strands,), m, r sin(theta) cos(alpha), lever arm of the axial force
    """

    rings: tuple[Ring, ...]
    sign: Floats
    lever_arm: Floats


class AxialForces(NamedTuple):
    """Axial forces of strands from bending, without the tension of the wire.

    Parameters
    ----------
    force : shape (curvatures, strands), N, positive in tension
    slope : shape (curvatures, strands), N m, derivative of the force with respect to curvature
    is_sticking : shape (curvatures, strands), whether each strand sticks
    """

    force: Floats
    slope: Floats
    is_sticking: Flags


def compute_axial_strain(section: CrossSection, tension: float) -> float:
    """Compute the axial strain of a straight elastic wire that does not rotate about its axis.

    Parameters
    ----------
    section : cross-section of the wire
    tension : N, tension of the wire

    Returns
    -------
    tension / (sum of E A cos^3(alpha) over the strands + E A of the insulation).

    Raises
    ------
    ValueError
        If the tension is negative. The model does not hold for compressed strands, which separate.
    """
    require_not_negative("tension", tension)
    return tension / compute_stretch_torsion(section).axial_stiffness


def compute_sines(section: CrossSection, orientation: float | Floats) -> Floats:
    """Compute the sine of each strand's angle from the neutral axis, without the core.

    Parameters
    ----------
    section : cross-section of the wire
    orientation : rad, rotation of the section relative to the neutral axis; one value, or a column
        of shape (n, 1)

    Returns
    -------
    Shape (strands,), or (n, strands) for a column of orientations.
    """
    min_sine = 1e-12  # smaller sines are rounding errors of strands on the neutral axis
    is_in_ring = section.layer >= int(section.has_core)
    sine = np.sin(section.angle[is_in_ring] + orientation)
    return np.where(np.abs(sine) < min_sine, 0.0, sine)


def make_ring_model(
    section: CrossSection, contacts: Contacts, sine: Floats, *, tension: float = 0.0
) -> RingModel:
    """Compute the properties of all rings that do not depend on the curvature.

    Parameters
    ----------
    section : cross-section of the wire
    contacts : friction coefficients of the rings of the section, and radial force
    sine : shape (strands,), sines of the angles of the strands, from `compute_sines`
    tension : N, tension of the wire

    Raises
    ------
    ValueError
        If the number of friction coefficients is not the number of rings, or the tension is
        negative.

    Notes
    -----
    Strands of a ring may differ in radius (hexagon, packing). The force of a strand is computed at
    its own radius. The force with which a ring presses on an inner ring is computed at the
    root-mean-square radius of the ring.
    """
    n_cores = int(section.has_core)
    layers = section.layers[n_cores:]
    n_coefficients, expected = len(contacts.inner_friction), f"{len(layers)}, the number of rings"
    require("number of coefficients", n_coefficients, expected, holds=n_coefficients == len(layers))
    is_in_ring = section.layer >= n_cores
    radius, ring_index = section.radius[is_in_ring], section.layer[is_in_ring] - n_cores
    rms_radii = [float(np.sqrt(np.mean(radius[ring_index == q] ** 2))) for q in range(len(layers))]
    lay_angles = np.array([layer.lay_angle for layer in layers])
    counts = np.array([layer.count for layer in layers])
    radial_forces = np.abs(np.sin(lay_angles)) * counts  # of each ring, per axial force of a strand
    if contacts.has_lay_lengths:
        radial_forces *= np.tan(np.abs(lay_angles)) / np.array(rms_radii)
    strain, rings = compute_axial_strain(section, tension), []
    for q, layer in enumerate(layers):
        end_index, inner_friction = int(counts[: q + 1].sum()), contacts.inner_friction[q]
        rigidity = layer.material.modulus * layer.area * np.cos(layer.lay_angle) ** 2
        radii = np.where(ring_index == q, radius, rms_radii[q])[:end_index]
        k = inner_friction * abs(np.sin(layer.lay_angle))
        friction_angle = np.abs(compute_friction_angle(k, np.arcsin(sine[:end_index])))
        lay_rate = np.tan(abs(layer.lay_angle)) / rms_radii[q] if contacts.has_lay_lengths else 1.0
        is_outer_ring = np.arange(len(layers)) > q
        pressure_factors = np.where(is_outer_ring, radial_forces, 0.0) / (layer.count * lay_rate)
        ring = Ring(
            start_index=end_index - layer.count,
            end_index=end_index,
            stick_stiffness=rigidity * radii * np.abs(sine[:end_index]),
            slip_per_pressure=(inner_friction + contacts.outer_friction[q]) * friction_angle,
            tension_slip_force=k * rigidity * strain * friction_angle,
            tension=rigidity * strain,
            insulation_pressure=contacts.radial_force * layers[-1].count / layer.count,
            pressure_factors=tuple(pressure_factors.tolist()),
        )
        rings.append(ring)
    lever_arm = radius * sine * np.cos(lay_angles)[ring_index] if layers else radius
    return RingModel(tuple(rings), np.sign(sine), lever_arm)


def compute_friction_angle(k: float, angle: Floats) -> Floats:
    """Compute expm1(k angle) / k, the factor on c + k F0 in the slip force S, rad.

    Parameters
    ----------
    k : friction coefficient times |sin(lay angle)|
    angle : any shape, rad
    """
    return np.expm1(k * angle) / k if k > 0.0 else angle


def compute_axial_forces(model: RingModel, curvature: Floats) -> AxialForces:
    """Compute the axial forces of all strands on first loading, from the outermost ring inwards.

    Parameters
    ----------
    model : rings of the wire
    curvature : 1/m, without NaN, not negative; shape (n, 1), or (n, strands) if the strands have
        different curvatures. Bending in the opposite direction requires a section that is rotated
        by half a turn
    """
    shape = (len(curvature), len(model.sign))
    force, slope, is_sticking = np.empty(shape), np.empty(shape), np.empty(shape, dtype=np.bool_)
    outer_forces: list[Floats] = []
    outer_slopes: list[Floats] = []
    for q in reversed(range(len(model.rings))):
        ring, sign = model.rings[q], model.sign[: model.rings[q].end_index]
        pressure = compute_ring_pressure(model, q, outer_forces)
        pairs = zip(ring.pressure_factors[q + 1 :], outer_slopes, strict=True)
        slope_terms = [factor * outer_slope[:, : ring.end_index] for factor, outer_slope in pairs]
        # Without contact the pressure is constant at 0.
        pressure_slope = np.where(pressure > 0.0, np.sum(slope_terms, axis=0), 0.0)
        stick_force = curvature[:, : ring.end_index] * ring.stick_stiffness
        slip_force = pressure * ring.slip_per_pressure + ring.tension_slip_force
        slip_slope = pressure_slope * ring.slip_per_pressure
        ring_sticks = stick_force < slip_force
        ring_force = np.where(ring_sticks, stick_force, slip_force) * sign
        ring_slope = np.where(ring_sticks, ring.stick_stiffness, slip_slope) * sign
        columns = slice(ring.start_index, ring.end_index)
        force[:, columns], slope[:, columns] = ring_force[:, columns], ring_slope[:, columns]
        is_sticking[:, columns] = ring_sticks[:, columns]
        outer_forces.insert(0, ring_force)
        outer_slopes.insert(0, ring_slope)
    return AxialForces(force, slope, is_sticking)


def compute_ring_pressure(model: RingModel, q: int, outer_forces: list[Floats]) -> Floats:
    """Compute the pressure H on each strand of a ring, N per radian of lay, at each angle.

    Parameters
    ----------
    model : rings of the wire
    q : index of the ring
    outer_forces : N, axial forces from bending in each outer ring, from the next ring outwards;
        shape (n, `end_index` of that ring)

    Returns
    -------
    Shape (n, `end_index` of the ring), or (1, 1) for the outermost ring; not negative.
    """
    ring = model.rings[q]
    pressure = np.full((1, 1), ring.insulation_pressure)
    for outer_index, force in enumerate(outer_forces, start=q + 1):
        axial_force = model.rings[outer_index].tension + force[:, : ring.end_index]
        pressure = pressure + ring.pressure_factors[outer_index] * axial_force
    return np.asarray(np.maximum(pressure, 0.0))


def find_slip_onsets(
    section: CrossSection, contacts: Contacts, *, tension: float = 0.0, orientation: float = 0.0
) -> Floats:
    """Find the curvature at which each strand outside the core first slips, 1/m.

    Parameters
    ----------
    section : cross-section of the wire
    contacts : friction coefficients of the rings, and radial force
    tension : N, tension of the wire
    orientation : rad, rotation of the section relative to the neutral axis

    Returns
    -------
    Shape (strands,), in the order of the section without the core; infinite for a strand that never
    slips. The value of a strand on the neutral axis is the limit for strands next to the axis.

    Notes
    -----
    Within a ring with uniform friction the strands near the neutral axis slip first, because
    theta_e / sin theta grows with theta. Section 3.2.1 of [1]_ states that the strands farthest
    from the axis slip first.
    """
    min_sine = 1e-9  # sine that replaces 0 for a strand on the neutral axis
    n_refinements = 8  # each divides a bracket by 128, down to the size of rounding errors
    sine = compute_sines(section, orientation)
    nonzero_sine = np.where(sine == 0.0, min_sine, sine)
    model = make_ring_model(section, contacts, nonzero_sine, tension=tension)
    strand = np.arange(len(nonzero_sine))
    first_grid = np.concatenate([[0.0], 1e-9 * 4.0 ** np.arange(61)])  # 1/m
    curvatures = np.broadcast_to(first_grid[:, None], (len(first_grid), len(strand)))
    never_slips = np.zeros(len(strand), dtype=np.bool_)
    for refinement in range(n_refinements + 1):
        is_slipping = ~compute_axial_forces(model, curvatures[1:]).is_sticking
        is_slipping[-1] |= refinement > 0  # the upper end of a bracket slips
        never_slips |= ~is_slipping.any(axis=0)
        first_slipping = is_slipping.argmax(axis=0)
        lower, upper = curvatures[first_slipping, strand], curvatures[first_slipping + 1, strand]
        curvatures = lower + (upper - lower) * np.arange(129)[:, None] / 128.0
    return np.where(never_slips, np.inf, lower)


@dataclass(frozen=True, slots=True, eq=False)
class MomentCurve(ArrayRecord):
    """Moment of a wire and its components at curvatures of first loading; arrays of shape (n,).

    The moment is stick + slip + bending + plastic + insulation.

    Parameters
    ----------
    curvature : 1/m
    stick : N m, moment of the axial forces of strands that stick
    slip : N m, moment of the axial forces of strands that slip
    bending : N m, moment of elastic strands about their own axes
    plastic : N m, change of that moment because strands yield, of the opposite sign
    insulation : N m, moment of the insulation
    tangent_stiffness : N m^2, derivative of the moment with respect to curvature
    stick_stiffness : N m^2, derivative of the moment at zero curvature, where nothing slips or
        yields
    slip_stiffness : N m^2, bending stiffness of frictionless, elastic strands with the insulation
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
        """Sum of all components, N m."""
        strand_bending = self.bending + self.plastic
        return np.asarray(self.stick + self.slip + strand_bending + self.insulation)

    @property
    def secant_stiffness(self) -> Floats:
        """M / kappa, N m^2; at zero curvature the tangent stiffness.

        Equation (3.23) of [1]_ mixes the secant and the tangent stiffness; it is not implemented.
        """
        is_zero = self.curvature == 0.0
        ratio = self.moment / np.where(is_zero, 1.0, self.curvature)
        return np.where(is_zero, self.tangent_stiffness, ratio)


def compute_stick_stiffness(section: CrossSection, *, orientation: float = 0.0) -> float:
    """Compute the bending stiffness while nothing slips or yields, N m^2.

    Parameters
    ----------
    section : cross-section of the wire
    orientation : rad, rotation of the section relative to the neutral axis

    Notes
    -----
    This is the derivative of the moment at zero curvature: slip stiffness + sum E A r^2
    sin^2(theta) cos^3(alpha). With at least three evenly spaced strands in every ring the stiffness
    does not depend on the orientation. With two strands in a ring it varies by a fifth, and in a
    packing by a few per cent.
    """
    is_in_ring = section.layer >= int(section.has_core)
    height = section.radius[is_in_ring] * compute_sines(section, orientation)
    rigidity = section.repeat_per_strand(
        layer.material.modulus * layer.area * np.cos(layer.lay_angle) ** 3
        for layer in section.layers
    )
    return compute_slip_stiffness(section) + float(rigidity[is_in_ring] @ height**2)


def compute_slip_stiffness(section: CrossSection) -> float:
    """Compute the bending stiffness of frictionless, elastic strands with the insulation, N m^2.

    Notes
    -----
    The stiffness is the sum of E pi d^4 / 64 times the helix factor over the strands, plus
    E_ins pi / 64 (d_w^4 - (d_w - 2 t)^4).
    """
    strand_stiffness = sum(
        layer.straight_count * layer.strand_stiffness for layer in section.layers
    )
    tube_stiffness = section.insulation.bending_stiffness if section.insulation else 0.0
    return float(strand_stiffness + tube_stiffness)


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
    section : cross-section of the wire
    contacts : friction coefficients of the rings, and radial force
    curvature : shape (n,), 1/m, any order and sign; each is reached monotonically from zero
    tension : N, tension of the wire before bending
    orientation : rad, rotation of the section relative to the neutral axis; at 0 a strand of the
        first ring is on that axis

    Returns
    -------
    The moment curve; NaN where the curvature is NaN.

    Raises
    ------
    ValueError
        If a curvature is infinite, if a strand or the insulation is bent beyond the range of its
        material's curve, if the contacts do not match the rings, or if the tension is negative.
    """
    curvatures = np.asarray(curvature, dtype=np.float64)
    infinite = curvatures[np.isinf(curvatures)].tolist()
    require("curvature", infinite, "finite or NaN", holds=not infinite)
    stick, slip, ring_slope = _sum_ring_moments(section, contacts, curvatures, tension, orientation)
    strand_sum = sum_strand_moments(section.layers, curvatures)
    slip_stiffness = strand_stiffness = compute_slip_stiffness(section)
    insulation, insulation_slope = np.zeros((2, len(curvatures)))
    if section.insulation:
        insulation, insulation_slope = compute_tube_moment(section.insulation, curvatures)
        strand_stiffness -= section.insulation.bending_stiffness
    return MomentCurve(
        curvature=curvatures,
        stick=stick,
        slip=slip,
        bending=strand_stiffness * curvatures,
        plastic=strand_sum.moment - strand_stiffness * curvatures,
        insulation=insulation,
        tangent_stiffness=ring_slope + strand_sum.tangent_stiffness + insulation_slope,
        stick_stiffness=compute_stick_stiffness(section, orientation=orientation),
        slip_stiffness=slip_stiffness,
    )


def _sum_ring_moments(
    section: CrossSection, contacts: Contacts, curvature: Floats, tension: float, orientation: float
) -> tuple[Floats, Floats, Floats]:
    """Compute the moments of the axial forces on first loading.

    Returns
    -------
    Moments of sticking strands and of slipping strands, N m, and the tangent stiffness of both,
    N m^2; shape (n,) each, NaN where the curvature is NaN.
    """
    stick, slip, slope = np.full((3, len(curvature)), np.nan)
    for has_sign, rotation, sign in ((curvature >= 0.0, 0.0, 1.0), (curvature < 0.0, np.pi, -1.0)):
        if has_sign.any():
            sine = compute_sines(section, orientation + rotation)
            model = make_ring_model(section, contacts, sine, tension=tension)
            axial = compute_axial_forces(model, np.abs(curvature[has_sign, None]))
            stick_force = np.where(axial.is_sticking, axial.force, 0.0)
            slip_force = np.where(axial.is_sticking, 0.0, axial.force)
            stick[has_sign] = sign * stick_force @ model.lever_arm
            slip[has_sign] = sign * slip_force @ model.lever_arm
            slope[has_sign] = axial.slope @ model.lever_arm
    return stick, slip, slope


def sum_strand_moments(layers: Sequence[Layer], curvature: Floats) -> BendingMoment:
    """Sum the moments and tangent stiffnesses of all strands about their own axes.

    Parameters
    ----------
    layers : layers of strands
    curvature : shape (n,), 1/m
    """
    moment, tangent_stiffness = np.zeros((2, len(curvature)))
    counts: dict[tuple[Material, float], float] = defaultdict(float)
    for layer in layers:
        counts[layer.material, layer.diameter] += layer.straight_count
    for (material, diameter), count in counts.items():
        strand = compute_strand_moment(material, diameter, curvature)
        moment += count * strand.moment
        tangent_stiffness += count * strand.tangent_stiffness
    return BendingMoment(moment, tangent_stiffness)


def compute_orientation_range(
    section: CrossSection,
    contacts: Contacts,
    curve: MomentCurve,
    *,
    tension: float = 0.0,
    n_orientations: int = 24,
) -> tuple[Floats, Floats]:
    """Compute the range of the moment over a full turn of the section.

    Parameters
    ----------
    section, contacts, tension : cross-section, contacts and tension of the wire, as for
        `compute_moment_curve`
    curve : moment curve of the wire, at any orientation
    n_orientations : number of evenly spaced orientations over the full turn

    Returns
    -------
    Smallest and largest moment at each curvature, N m, shape (n,) each.
    """
    ring_counts = [layer.count for layer in section.layers if layer.count > 1]
    n_symmetries = math.gcd(*ring_counts) if ring_counts and section.kind != "packed" else 1
    orientations = 2.0 * np.pi * np.arange(n_orientations) / n_orientations
    orientations = np.unique(np.round(orientations % (2.0 * np.pi / n_symmetries), 12))
    moment_without_axial_forces = curve.bending + curve.plastic + curve.insulation
    moments = []
    for orientation in orientations.tolist():
        stick, slip, _ = _sum_ring_moments(section, contacts, curve.curvature, tension, orientation)
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
    """Fit plays to the law of a wire; first loading is exact at every corner of the plays.

    Parameters
    ----------
    section, contacts, tension, orientation : cross-section, contacts, tension and orientation of
        the wire, as for `compute_moment_curve`
    largest_curvature : 1/m, end of the range of the law; `wire.cantilever` raises an error for a
        larger curvature
    isotropic_share : fraction of the hardening of the strands that is isotropic, from 0 (Masing's
        rule) to 1; it has an effect only on paths that unload
    n_plays : number of plays, with corners evenly spaced in the logarithm of the curvature over
        four decades; each slip onset of a strand adds one

    Returns
    -------
    The law. For an isotropic share of 0, its loops follow Masing's rule. The rule is exact for
    Coulomb sliders and strands with kinematic hardening if friction is equal in both directions of
    slip, which is nearly true for a small mu sin(alpha).

    Raises
    ------
    ValueError
        If the moment decreases or the tangent stiffness increases with curvature, which plays
        cannot represent (the message states the curvature), if the isotropic share is not between
        0 and 1, or for the reasons of `compute_moment_curve`.

    Notes
    -----
    For the wires of [1]_, the polygon with 60 plays differs from the law by at most 0.3 %.

    Strands in loops go beyond the range of first loading. For an isotropic share above 0, their
    moment is therefore computed up to eight times the range, or up to the end of the curve of their
    material. It is linear at larger curvatures.
    """
    n_decades = 4.0  # range of the corners below the largest curvature
    min_spacing = 1e-6  # relative spacing of corners; closer corners are merged
    require_positive("largest_curvature", largest_curvature)
    grid = np.geomspace(10.0**-n_decades, 1.0, n_plays + 1) * largest_curvature
    onsets = find_slip_onsets(section, contacts, tension=tension, orientation=orientation)
    onsets_in_range = onsets[(onsets > grid[0]) & (onsets < grid[-1])]
    corners = np.union1d(grid, onsets_in_range)
    corners = corners[np.diff(corners, prepend=0.0) > min_spacing * corners]
    moment = compute_moment_curve(
        section, contacts, corners, tension=tension, orientation=orientation
    ).moment
    plays = make_polygon_law(corners, moment)
    return harden_plays(plays, section.layers, isotropic_share)


LOOP_CURVATURE_FACTOR = 8.0
"""Largest curvature at which strand moments are computed for loops, relative to that of the law."""


def harden_plays(
    plays: PlayLaw, layers: Sequence[Layer], isotropic_share: float, *, factor: float = 1.0
) -> PlayLaw:
    """Make a law with partly isotropic hardening of the strands from a law of plays.

    Parameters
    ----------
    plays : law of the wire with the same first loading, and loops that follow Masing's rule
    layers : layers of strands
    isotropic_share : fraction of the hardening that is isotropic, from 0 to 1; with 0 the law is
        returned unchanged
    factor : factor on the moments of the strands about their own axes, also contained in `plays`

    Raises
    ------
    ValueError
        If the isotropic share is outside its range.
    """
    if isotropic_share == 0.0:
        return plays
    corners = compute_first_curvature(plays, np.append(plays.half_widths, plays.largest_moment))
    slider = make_strand_slider(layers, corners, factor=factor, isotropic_share=isotropic_share)
    return make_mixed_law(plays, corners, slider)


def make_strand_slider(
    layers: Sequence[Layer], corners: Floats, *, factor: float = 1.0, isotropic_share: float = 1.0
) -> GrowingSlider:
    """Make the growing slider that represents the moment of strands about their own axes.

    Parameters
    ----------
    layers : layers of strands
    corners : shape (n,), 1/m, positive and increasing, over the range of a law. Further corners are
        added up to eight times the range, or up to the curvature at which the curve of a material
        ends
    factor : factor on the moments of the strands
    isotropic_share : fraction of the hardening that is isotropic, above 0 and at most 1

    Raises
    ------
    ValueError
        If the isotropic share is outside its range.
    """
    max_curvature = min(2.0 * layer.material.largest_strain / layer.diameter for layer in layers)
    last_corner = min(LOOP_CURVATURE_FACTOR * corners[-1], (1.0 - 1e-9) * max_curvature)
    if last_corner > corners[-1]:
        corners = np.append(corners, np.geomspace(corners[-1], last_corner, 41)[1:])
    moment = factor * sum_strand_moments(layers, corners).moment
    return make_growing_slider(corners, moment, isotropic_share)
