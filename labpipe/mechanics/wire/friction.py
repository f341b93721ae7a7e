"""Axial forces of the strands of a bent wire, limited by friction.

Stick (3.7): T = E A kappa r sin(theta) cos^2(alpha), beside the strand's share F0 of the wire's own
tension. Slip (3.14), with k = mu_inner |sin alpha| and c = (mu_outer + mu_inner) H:

    S = (c + k F0) theta_e expm1(k theta_e) / (k theta_e),   theta_e = arcsin(sin theta),

which is the integral of dF = c d(theta) + k F d(theta) from the neutral axis, where F = F0. The
force is the smaller of the two by absolute value, with the sign of T (3.16). The dissertation uses
theta raw, so that strands with the same sine get different friction; and the smaller of the two
with their signs, which is never friction on the side in compression.

Pressure on a strand of layer q, per radian of its lay (3.11), never negative:

    H = F_rad N_Q / N_q + sum over outer layers k of (F0 + F)_k |sin alpha_k| N_k / N_q

with the force F_k that the outer layer has at the same angle theta. The dissertation's shares N_k /
N_q hold for layers of equal lay length. With `Contacts.lay_lengths` they are multiplied by the
ratio of the lay lengths, r_q tan alpha_k / (r_k tan alpha_q), which equilibrium asks for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.law.plays import require_not_negative
from labpipe.mechanics.wire.cross_section import CrossSection, Layer
from labpipe.records.arrays import Flags, Floats

_SLIP_GUESSES = 1e-9 * 4.0 ** np.arange(61)[:, None]  # 1/m
_BRACKET_SHARES = np.arange(129)[:, None] / 128.0


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
        values = [*self.inner, *self.outer, self.radial_force]
        if len(self.inner) != len(self.outer):
            message = (
                f"{len(self.inner)} inner and {len(self.outer)} outer coefficients: expected one "
                f"of both for each ring"
            )
            raise ValueError(message)
        if not all(np.isfinite(value) and value >= 0.0 for value in values):
            message = (
                f"inner={self.inner}, outer={self.outer}, radial_force={self.radial_force}: "
                f"must be finite and >= 0"
            )
            raise ValueError(message)


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
    """One ring, with the demand on its strands and their friction limit at each angle needed.

    Forces are evaluated at the angles of its own strands and, since they press on the rings
    inside, at those of all inner strands: at the first `end` angles, its own being the last.

    Parameters
    ----------
    start, end : which strands are its own, counted over all rings from the innermost
    demand : shape (end,), |T| / kappa, N m
    per_pressure : shape (end,), |S| / H, positive
    per_tension : shape (end,), |S| where H = 0, N
    tension : F0 of a strand, N
    base : the insulation's part of H, N
    shares : H of this ring for each N of axial force in each ring, by number; 0 for inner ones
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


@dataclass(frozen=True, slots=True, eq=False)
class AxialForces:
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
    N / (sum of E A cos^3(alpha) + E A of the insulation).

    Raises
    ------
    ValueError
        If the tension is negative: compressed strands separate.
    """
    require_not_negative("tension", tension)
    strands = sum(
        layer.count * layer.material.modulus * layer.area * np.cos(layer.lay_angle) ** 3
        for layer in section.layers
    )
    tube = section.insulation.axial_stiffness if section.insulation else 0.0
    return float(tension / (strands + tube))


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
    """Compute what does not depend on the curvature.

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
    their own radius; where a ring presses on an inner one, at its root-mean-square radius.
    """
    first = int(section.has_core)
    layers = section.layers[first:]
    if len(contacts.inner) != len(layers):
        message = f"{len(contacts.inner)} coefficients: the wire has {len(layers)} rings"
        raise ValueError(message)
    is_ring = section.layer >= first
    radius, index = section.radius[is_ring], section.layer[is_ring] - first
    means = [float(np.sqrt(np.mean(radius[index == q] ** 2))) for q in range(len(layers))]
    strain = compute_axial_strain(section, tension)
    shares = _shares(layers, means, uses_lay_lengths=contacts.lay_lengths)
    rings = []
    for q in range(len(layers)):
        own_radius = np.where(index == q, radius, means[q])
        ring = _ring(
            *(layers, sine, q, own_radius), contacts=contacts, strain=strain, shares=shares[q]
        )
        rings.append(ring)
    cosine = np.cos([layer.lay_angle for layer in layers])
    lever = radius * sine * cosine[index] if layers else radius
    return Bundle(tuple(rings), np.sign(sine), lever)


def _ring(
    layers: tuple[Layer, ...],
    sine: Floats,
    q: int,
    radius: Floats,
    *,
    contacts: Contacts,
    strain: float,
    shares: tuple[float, ...],
) -> Ring:
    """Return a ring of the wire, which its tension strains; radius and sine of all strands, m."""
    layer, inner = layers[q], contacts.inner[q]
    end = sum(layer.count for layer in layers[: q + 1])
    rigidity = layer.material.modulus * layer.area * np.cos(layer.lay_angle) ** 2
    k = inner * abs(np.sin(layer.lay_angle))
    friction_reach = np.abs(compute_friction_angle(k, np.arcsin(sine[:end])))
    return Ring(
        end - layer.count,
        end,
        rigidity * radius[:end] * np.abs(sine[:end]),
        (inner + contacts.outer[q]) * friction_reach,
        k * rigidity * strain * friction_reach,
        rigidity * strain,
        contacts.radial_force * layers[-1].count / layer.count,
        shares,
    )


def compute_friction_angle(k: float, angle: Floats) -> Floats:
    """Return expm1(k angle) / k, rad: the angle weighted by friction of the strand's tension."""
    return np.expm1(k * angle) / k if k > 0.0 else angle


def _shares(
    layers: tuple[Layer, ...], radii: list[float], *, uses_lay_lengths: bool
) -> list[tuple[float, ...]]:
    """Return the pressure H on each ring (outer index) per N of force in each outer ring."""
    sine = [abs(np.sin(layer.lay_angle)) for layer in layers]
    lay = [
        np.tan(abs(layer.lay_angle)) / radius for layer, radius in zip(layers, radii, strict=True)
    ]

    def share(q: int, k: int) -> float:
        if k <= q:
            return 0.0
        plain = sine[k] * layers[k].count / layers[q].count
        return float(plain * lay[k] / lay[q]) if uses_lay_lengths else float(plain)

    return [tuple(share(q, k) for k in range(len(layers))) for q in range(len(layers))]


def compute_axial_forces(bundle: Bundle, curvature: Floats) -> AxialForces:
    """Compute the axial forces of all strands on first loading, from the outermost ring inwards.

    Parameters
    ----------
    bundle : see `arrange_rings`
    curvature : shape (curvatures, 1), or (n, strands) with its own for each strand; 1/m, not
        negative; for bending the other way turn the section by half a turn

    Returns
    -------
    Forces, slopes and which strands stick. NaN in gives NaN out.
    """
    n_strands = len(bundle.sign)
    shape = (len(curvature), n_strands)
    force, slope, stuck = np.empty(shape), np.empty(shape), np.empty(shape, dtype=np.bool_)
    outer: list[Floats] = []
    rises: list[Floats] = []
    for q in reversed(range(len(bundle.rings))):
        ring, sign = bundle.rings[q], bundle.sign[: bundle.rings[q].end]
        pressure = compute_ring_pressure(bundle, q, outer)
        outer_rises = enumerate(rises, start=q + 1)
        slopes = [ring.shares[k] * rise[:, : ring.end] for k, rise in outer_rises]
        pressure_slope = np.where(pressure > 0.0, np.sum(slopes, axis=0), 0.0)  # 0: lifted off
        demand = curvature[:, : ring.end] * ring.demand
        hold = pressure * ring.per_pressure + ring.per_tension
        sticks = demand < hold
        present = np.where(sticks, demand, hold) * sign
        rise = np.where(sticks, ring.demand, pressure_slope * ring.per_pressure) * sign
        columns = slice(ring.start, ring.end)
        force[:, columns], slope[:, columns] = present[:, columns], rise[:, columns]
        stuck[:, columns] = sticks[:, columns]
        outer.insert(0, present)
        rises.insert(0, rise)
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
    Within a ring the strands near the neutral axis slip first
    when friction is even (theta_e / sin theta grows with theta), not those farthest from it, as
    stated in 3.2.1 of the dissertation.
    """
    min_sine = 1e-9
    rounds = 8  # each to a 128th: to rounding
    sine = compute_sines(section, orientation)
    near_sine = np.where(sine == 0.0, min_sine, sine)
    bundle = arrange_rings(section, contacts, near_sine, tension=tension)

    guesses = np.broadcast_to(_SLIP_GUESSES, (len(_SLIP_GUESSES), len(near_sine)))
    slips = ~compute_axial_forces(bundle, guesses).stuck
    never, first = ~slips.any(axis=0), slips.argmax(axis=0)
    upper = _SLIP_GUESSES[first, 0]
    lower = np.where(first == 0, 0.0, _SLIP_GUESSES[first - 1, 0])
    for _ in range(rounds):
        curvatures = lower + (upper - lower) * _BRACKET_SHARES
        slips = ~compute_axial_forces(bundle, curvatures[1:-1]).stuck
        first = np.where(slips.any(axis=0), slips.argmax(axis=0) + 1, len(_BRACKET_SHARES) - 1)
        strand = np.arange(len(near_sine))
        lower, upper = curvatures[first - 1, strand], curvatures[first, strand]
    return np.where(never, np.inf, lower)
