"""Compute the moment-curvature law of a stranded wire and fit plays to it (PHYSICS 4).

Eq. (3.17) of the dissertation, with the cos(alpha) of its appendix in the moment of the axial
forces:

    M = sum F r sin(theta) cos(alpha) + sum h m(kappa) + EI_ins kappa,

The axial forces F are those of `wire.friction`, the strands' own moments m those of
`wire.materials`. The strands' axial stiffness stays elastic, as in the dissertation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.law.plays import PlayLaw, make_polygon_law, require_positive
from labpipe.mechanics.wire.cross_section import CrossSection, compute_tube_moment
from labpipe.mechanics.wire.friction import (
    Bundle,
    Contacts,
    arrange_rings,
    compute_axial_forces,
    compute_sines,
    find_slip_onsets,
)
from labpipe.mechanics.wire.materials import compute_helix_factor, compute_strand_moment
from labpipe.records.arrays import ArrayRecord, Floats, Vector


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
    slip_stiffness : N m^2, of frictionless, elastic strands
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
    sine = compute_sines(section, orientation)
    return compute_slip_stiffness(section) + float(
        _axial_rigidity(section) @ (find_section_arms(section) * sine) ** 2
    )


def find_section_arms(section: CrossSection) -> Floats:
    """Return the distance of the strands outside the core from the axis, shape (strands,), m."""
    return section.radius[section.layer >= int(section.has_core)]


def _axial_rigidity(section: CrossSection) -> Floats:
    """Return E A cos^3(alpha) of each strand outside the core, N."""
    first = int(section.has_core)
    values = [
        layer.material.modulus * layer.area * np.cos(layer.lay_angle) ** 3
        for layer in section.layers[first:]
    ]
    return np.repeat(values, [layer.count for layer in section.layers[first:]])


def compute_slip_stiffness(section: CrossSection) -> float:
    """Return the bending stiffness of frictionless, elastic strands with the insulation, N m^2.

    Notes
    -----
    sum of E pi d^4 / 64 times the helix factor + E_ins pi / 64 (d_w^4 - (d_w - 2 t)^4).
    """
    strands = sum(
        layer.count
        * compute_helix_factor(layer.lay_angle, layer.poisson)
        * layer.material.modulus
        * np.pi
        * layer.diameter**4
        / 64.0
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
    if np.isinf(curvatures).any():
        message = f"curvature[{int(np.isinf(curvatures).argmax())}] is infinite: must be finite"
        raise ValueError(message)
    stick, slip, axial_slope = _axial_parts(section, contacts, curvatures, tension, orientation)
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


def _axial_parts(
    section: CrossSection, contacts: Contacts, curvature: Floats, tension: float, orientation: float
) -> tuple[Floats, Floats, Floats]:
    """Return moments of sticking and slipping strands, N m, and the slope of their sum, N m^2."""
    stick, slip, slope = np.full((3, len(curvature)), np.nan)
    for side, turn, sign in ((curvature >= 0.0, 0.0, 1.0), (curvature < 0.0, np.pi, -1.0)):
        if side.any():
            sine = compute_sines(section, orientation + turn)
            bundle = arrange_rings(section, contacts, sine, tension=tension)
            parts = _axial_moments(bundle, np.abs(curvature[side]))
            stick[side], slip[side], slope[side] = sign * parts[0], sign * parts[1], parts[2]
    return stick, slip, slope


def _axial_moments(bundle: Bundle, curvature: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the parts of `_axial_parts` for bending one way."""
    chunk = 512  # curvatures at a time, so that the working arrays stay in the cache
    stick, total, slope = np.empty((3, len(curvature)))
    for start in range(0, len(curvature), chunk):
        part = slice(start, start + chunk)
        axial = compute_axial_forces(bundle, curvature[part, None])
        total[part] = axial.force @ bundle.lever
        stick[part] = np.where(axial.stuck, axial.force, 0.0) @ bundle.lever
        slope[part] = axial.slope @ bundle.lever
    return stick, total - stick, slope


def sum_strand_moments(section: CrossSection, curvature: Floats) -> tuple[float, Floats, Floats]:
    """Sum the moments of the strands about their own axes.

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
    strand_types = {(layer.material, layer.diameter) for layer in section.layers}
    for material, diameter in strand_types:
        straight = compute_strand_moment(material, diameter, curvature)
        weight = sum(
            layer.count * compute_helix_factor(layer.lay_angle, layer.poisson)
            for layer in section.layers
            if (layer.material, layer.diameter) == (material, diameter)
        )
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
    strand_bending = curve.bending + curve.plastic
    moments = []
    for turn in _distinct_turns(section, n_orientations):
        stick, slip, _ = _axial_parts(section, contacts, curve.curvature, tension, turn)
        moments.append(stick + slip + strand_bending + curve.insulation)
    return np.min(moments, axis=0), np.max(moments, axis=0)


def _distinct_turns(section: CrossSection, count: int) -> list[float]:
    """Return orientations, rad, without those that only swap equal strands."""
    turns = 2.0 * np.pi * np.arange(count) / count
    layer = section.layer[section.layer >= int(section.has_core)]
    arms = find_section_arms(section) / (float(section.radius.max()) or 1.0)
    groups = np.unique(np.array([layer, arms.round(9)]), axis=1, return_inverse=True)[1]

    # Heights lie in [-1, 1]; an offset of 4 per group keeps the groups apart when sorted.
    heights = 4.0 * groups.ravel() + (arms * compute_sines(section, turns[:, None])).round(9)
    sorted_heights = np.sort(heights, axis=1)
    # Reversed, so that the smallest of equal turns is kept.
    distinct = {
        row.tobytes(): turn for row, turn in zip(sorted_heights[::-1], turns[::-1], strict=True)
    }
    return sorted(map(float, distinct.values()))


def fit_play_law(
    section: CrossSection,
    contacts: Contacts,
    *,
    largest_curvature: float,
    n_plays: int = 60,
    tension: float = 0.0,
    orientation: float = 0.0,
) -> PlayLaw:
    """Fit plays whose polygon of first loading meets the wire's law at every corner.

    Parameters
    ----------
    section, contacts, tension, orientation : as for `compute_moment_curve`
    largest_curvature : 1/m, end of the range of the law; `wire.cantilever` raises beyond it
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
        message states the curvature. Also as `compute_moment_curve`.

    Notes
    -----
    For the wires of the dissertation, the polygon with 60 plays differs from the law by at most
    0.3 %.
    """
    decades = 4.0  # of curvature below the largest
    min_spacing = 1e-6  # relative; closer corners are one
    require_positive("largest_curvature", largest_curvature)
    even = np.geomspace(10.0**-decades, 1.0, n_plays + 1) * largest_curvature
    onsets = find_slip_onsets(section, contacts, tension=tension, orientation=orientation)
    inside = onsets[(onsets > even[0]) & (onsets < even[-1])]
    knots = np.union1d(even, inside)
    knots = knots[np.diff(knots, prepend=0.0) > min_spacing * knots]
    moment = compute_moment_curve(
        section, contacts, knots, tension=tension, orientation=orientation
    ).moment
    return make_polygon_law(knots, moment)
