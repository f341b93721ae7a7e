"""Axial forces of the strands of a bent wire: what bending asks for, what friction can hold.

Stick (3.7): T = E A kappa r sin(theta) cos^2(alpha), beside the strand's share F0 of the wire's own
tension. Slip (3.14), with k = mu_inner |sin alpha| and c = (mu_outer + mu_inner) H:

    S = (c + k F0) theta_e expm1(k theta_e) / (k theta_e),   theta_e = arcsin(sin theta),

which is the integral of dF = c d(theta) + k F d(theta) from the neutral axis, where F = F0. The
force is the smaller of the two by absolute value, with the sign of T (3.16). The source uses theta
raw, so that strands with the same sine get different friction; and the smaller of the two with
their signs, which is never friction on the side in compression.

Pressure on a strand of layer q, per radian of its lay (3.11), never negative:

    H = F_rad N_Q / N_q + sum over outer layers k of (F0 + F)_k |sin alpha_k| N_k / N_q

with the force F_k that the outer layer has at the same angle theta. The source's shares N_k / N_q
hold for layers of equal lay length. With `Contacts.lay_lengths` they are multiplied by the ratio
of the lay lengths, r_q tan alpha_k / (r_k tan alpha_q), which equilibrium asks for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.wire.cross_section import CrossSection, Layer

_ON_AXIS = 1e-12  # sine of a strand on the neutral axis, but for rounding
_NEAR_AXIS = 1e-9
_GUESSES = 1e-9 * 4.0 ** np.arange(61)[:, None]  # of the curvature of first slip, 1/m
_SHARES = np.arange(129)[:, None] / 128.0
_ROUNDS = 8  # each to a 128th: to rounding


@dataclass(frozen=True, slots=True)
class Contacts:
    """Friction and pressure between the layers.

    Parameters
    ----------
    inner : friction coefficient of each ring with what lies inside it, first ring first
    outer : of each ring with what lies outside it; for the outermost ring, the insulation
    radial_force : F_rad of the insulation, N per radian of lay and strand of the outermost ring
    lay_lengths : whether pressure is handed inwards by the rings' own lay lengths; else as if they
        were equal, as the source does
    """

    inner: tuple[float, ...]
    outer: tuple[float, ...]
    radial_force: float = 0.0
    lay_lengths: bool = False

    def __post_init__(self) -> None:
        values = [*self.inner, *self.outer, self.radial_force]
        if len(self.inner) != len(self.outer):
            message = (
                f"{len(self.inner)} inner and {len(self.outer)} outer coefficients: allowed is one "
                f"of both for each ring"
            )
            raise ValueError(message)
        if not all(np.isfinite(value) and value >= 0.0 for value in values):
            message = (
                f"inner={self.inner}, outer={self.outer}, radial_force={self.radial_force}: "
                f"allowed are finite numbers >= 0"
            )
            raise ValueError(message)


def insulated(n_rings: int, *, strand: float, insulation: float, radial_force: float) -> Contacts:
    """Contacts of an insulated wire: mu_s between strands, mu_p with the insulation.

    A single strand has no rings, and none of both.
    """
    outer = (*[strand] * (n_rings - 1), insulation)[:n_rings]
    return Contacts((strand,) * n_rings, outer, radial_force)


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """One ring, with what its strands are asked for and can hold at the angles that matter.

    Its forces are wanted at the angles of its own strands and, since they press on the rings
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
    lever : shape (strands,), r sin(theta) cos(alpha), m: what the axial force turns with
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


def axial_strain(section: CrossSection, tension: float) -> float:
    """Strain of a straight wire under tension, elastic and not turning about its axis.

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
        If the tension is negative: strands under pressure part from each other.
    """
    if not (np.isfinite(tension) and tension >= 0.0):
        message = f"tension={tension!r}: allowed are finite numbers >= 0"
        raise ValueError(message)
    strands = sum(
        layer.count * layer.material.modulus * layer.area * np.cos(layer.lay_angle) ** 3
        for layer in section.layers
    )
    tube = section.insulation.axial_stiffness if section.insulation else 0.0
    return float(tension / (strands + tube))


def sines(section: CrossSection, orientation: float | Floats) -> Floats:
    """Sine of the angle of each strand outside the core from the neutral axis, shape (strands,).

    Of several orientations, a column of them, one row each.
    """
    first = int(section.has_core)
    sine = np.sin(section.angle[section.layer >= first] + orientation)
    return np.where(np.abs(sine) < _ON_AXIS, 0.0, sine)


def arrange(
    section: CrossSection, contacts: Contacts, sine: Floats, *, tension: float = 0.0
) -> Bundle:
    """Make ready what does not depend on the curvature.

    Parameters
    ----------
    section : strands in place
    contacts : of each ring of the section
    sine : shape (strands,), see `sines`
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
    strain = axial_strain(section, tension)
    shares = _shares(layers, means, uses_lay_lengths=contacts.lay_lengths)
    reach = _Reach(layers, sine, contacts, strain)
    rings = [
        _ring(reach, q, np.where(index == q, radius, means[q]), shares[q])
        for q in range(len(layers))
    ]
    cosine = np.cos([layer.lay_angle for layer in layers])
    lever = radius * sine * cosine[index] if layers else radius
    return Bundle(tuple(rings), np.sign(sine), lever)


@dataclass(frozen=True, slots=True, eq=False)
class _Reach:
    """What all rings are made of: see `arrange`; `strain` is that of the wire's own tension."""

    layers: tuple[Layer, ...]
    sine: Floats
    contacts: Contacts
    strain: float


def _ring(of: _Reach, q: int, radius: Floats, shares: tuple[float, ...]) -> Ring:
    layers, sine, contacts = of.layers, of.sine, of.contacts
    end = sum(layer.count for layer in layers[: q + 1])
    layer, inner = layers[q], contacts.inner[q]
    rigidity = layer.material.modulus * layer.area * np.cos(layer.lay_angle) ** 2
    k = inner * abs(np.sin(layer.lay_angle))
    reach = np.abs(friction_angle(k, np.arcsin(sine[:end])))
    return Ring(
        end - layer.count,
        end,
        rigidity * radius[:end] * np.abs(sine[:end]),
        (inner + contacts.outer[q]) * reach,
        k * rigidity * of.strain * reach,
        rigidity * of.strain,
        contacts.radial_force * layers[-1].count / layer.count,
        shares,
    )


def friction_angle(k: float, angle: Floats) -> Floats:
    """expm1(k angle) / k, rad: the angle from the neutral axis, stretched by the strand's pull."""
    return np.expm1(k * angle) / k if k > 0.0 else angle


def _shares(
    layers: tuple[Layer, ...], radii: list[float], *, uses_lay_lengths: bool
) -> list[tuple[float, ...]]:
    """Pressure H on each ring (outer index) for each N of force in each ring outside it."""
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


def axial_forces(bundle: Bundle, curvature: Floats) -> AxialForces:
    """Axial forces of all strands on first loading, rings from the outermost inwards.

    Parameters
    ----------
    bundle : rings made ready
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
        pressure = ring_pressure(bundle, q, outer)
        pressure_slope = _pressure_slope(bundle, q, pressure, rises)
        demand = curvature[:, : ring.end] * ring.demand
        hold = pressure * ring.per_pressure + ring.per_tension
        sticks = demand < hold
        present = np.where(sticks, demand, hold) * sign
        rise = np.where(sticks, ring.demand, pressure_slope * ring.per_pressure) * sign
        own = slice(ring.start, ring.end)
        force[:, own], slope[:, own], stuck[:, own] = present[:, own], rise[:, own], sticks[:, own]
        outer.insert(0, present)
        rises.insert(0, rise)
    return AxialForces(force, slope, stuck)


def ring_pressure(bundle: Bundle, q: int, outer: list[Floats]) -> Floats:
    """Pressure H on a ring at each of its angles, N per radian of lay, never negative.

    Parameters
    ----------
    bundle : rings made ready
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


def _pressure_slope(bundle: Bundle, q: int, pressure: Floats, rises: list[Floats]) -> Floats:
    """Slope of H with the curvature, from those of the forces outside; zero where they lift off."""
    ring = bundle.rings[q]
    slope = np.zeros((1, 1))
    for k, rise in enumerate(rises, start=q + 1):
        slope = slope + ring.shares[k] * rise[:, : ring.end]
    return np.where(pressure > 0.0, slope, 0.0)


def slip_onsets(
    section: CrossSection, contacts: Contacts, *, tension: float = 0.0, orientation: float = 0.0
) -> Floats:
    """Curvature at which each strand outside the core first slips, 1/m, shape (strands,).

    Parameters
    ----------
    section, contacts, tension : the wire
    orientation : rad, by which the section is turned against the neutral axis

    Returns
    -------
    In the order of the section's strands without the core. A strand on the neutral axis has no
    force to lose: it is given the limit for strands next to it. Infinite where a strand never
    slips.

    Notes
    -----
    Found to rounding, by narrowing down. Within a ring the strands near the neutral axis slip first
    when friction is even (theta_e / sin theta grows with theta), not those farthest from it, as a
    sentence of the source's 3.2.1 has it.
    """
    sine = sines(section, orientation)
    near = np.where(sine == 0.0, _NEAR_AXIS, sine)
    bundle = arrange(section, contacts, near, tension=tension)

    slips = ~_stuck(bundle, np.broadcast_to(_GUESSES, (len(_GUESSES), len(near))))
    never, first = ~slips.any(axis=0), slips.argmax(axis=0)
    upper = _GUESSES[first, 0]
    lower = np.where(first == 0, 0.0, _GUESSES[first - 1, 0])
    for _ in range(_ROUNDS):
        rungs = lower + (upper - lower) * _SHARES  # of a ladder, so many at once
        slips = ~_stuck(bundle, rungs[1:-1])
        first = np.where(slips.any(axis=0), slips.argmax(axis=0) + 1, len(_SHARES) - 1)
        strand = np.arange(len(near))
        lower, upper = rungs[first - 1, strand], rungs[first, strand]
    return np.where(never, np.inf, lower)


def _stuck(bundle: Bundle, curvature: Floats) -> Flags:
    stuck: Flags = axial_forces(bundle, curvature).stuck
    return stuck
