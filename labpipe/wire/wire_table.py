"""All that the model says of one wire: its law as a table, stiffnesses, the cantilever's curve."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire import WireLayout, WireSpec, WireTable
from labpipe.wire.cross_section import CrossSection
from labpipe.wire.end_load import deflection_at
from labpipe.wire.end_load_path import end_load_path
from labpipe.wire.friction import slip_onsets
from labpipe.wire.from_spec import BuiltWire, WireError, build, range_of
from labpipe.wire.moment_curvature import MomentCurve, moment_curvature, orientation_range
from labpipe.wire.wire_law import concave_law

GRID_POINTS = 200
_DECADES = 4.0  # of curvature below the largest
_DISTINCT = 1e-4  # of a curvature: nearer points are one
_AT_ONCE = 1e-6  # of the largest curvature: strands that slip before stick to nothing
DEFLECTIONS = 49
"""Points of the cantilever's curve, zero included."""
FARTHEST = 0.8
"""Tip deflection at its end, as a share of the length."""


def wire_table(spec: WireSpec) -> WireTable:
    """Work out the law of a wire on first loading, and what else simulation wants.

    Parameters
    ----------
    spec : of the wire, in SI units

    Returns
    -------
    The table. Its curvatures are zero, 200 spread evenly in the logarithm over four decades up to
    the end of the range, and those at which strands begin to slip; an onset below a millionth of
    the range is told as zero. Notes: ``defaults_taken``, those of `build`, ``range_shortened``,
    ``tension``, ``slips_at_once``, ``cantilever_cut``.

    Raises
    ------
    WireError
        If the strands do not fit (with the overlap), the law softens (with the curvature), the
        tension strains them beyond their stress table, or a number is out of its range.

    Notes
    -----
    The law is that of `wire.moment_curvature`. The cantilever is clamped at one end, with an end
    load normal to the clamped axis, and starts straight.
    """
    built = build(spec)
    largest, shortened = range_of(spec, strain=built.axial_strain)
    onsets = _onsets(built, spec, largest)
    curve = _curve(built, spec, curvature_grid(largest, onsets[onsets > 0.0]))
    lowest, highest = orientation_range(
        built.section, built.contacts, curve.curvature, tension=spec.tension
    )
    deflection, force, cut = _cantilever(spec, curve)
    return WireTable(
        name=spec.name,
        spec=spec,
        layout=layout_of(built.section),
        curvature=curve.curvature,
        moment=curve.moment,
        stick=curve.stick,
        slip=curve.slip,
        bending=curve.bending,
        plastic=curve.plastic,
        insulation=curve.insulation,
        tangent_stiffness=curve.tangent_stiffness,
        secant_stiffness=curve.secant_stiffness,
        stick_stiffness=curve.stick_stiffness,
        slip_stiffness=curve.slip_stiffness,
        axial_stiffness=axial_stiffness(built.section),
        torsional_stiffness=torsional_stiffness(built.section),
        slip_onsets=onsets,
        lowest_moment=np.minimum(lowest, curve.moment),
        highest_moment=np.maximum(highest, curve.moment),
        tip_deflection=deflection,
        tip_force=force,
        notes=(
            *(*_defaults(spec), *built.notes, *shortened, *_tension(spec)),
            *(*_slips_at_once(spec, onsets, curve), *cut),
        ),
    )


def layout_of(section: CrossSection) -> WireLayout:
    """Where the strands of a section with insulation lie, as a record."""
    tube = section.insulation
    if tube is None:
        message = "the section has no insulation: allowed is one with a tube"
        raise ValueError(message)
    diameter = np.array([layer.diameter for layer in section.layers])[section.layer]
    outside = tube.bore_radius + tube.thickness
    return WireLayout(
        section.kind, section.x, section.y, section.layer, diameter, tube.bore_radius, outside
    )


def axial_stiffness(section: CrossSection) -> float:
    """Axial stiffness of a wire that does not turn about its axis, N.

    Notes
    -----
    sum of E A cos^3(alpha) + E A of the insulation: a helical strand strained along the wire by e
    is strained by e cos^2(alpha), pulls with cos(alpha) of its force, and keeps its radius
    (Costello, *Theory of Wire Rope*, 1997). Strands that bed down make a real wire softer.
    """
    strands = sum(
        layer.count * layer.material.modulus * layer.area * np.cos(layer.lay_angle) ** 3
        for layer in section.layers
    )
    tube = section.insulation.axial_stiffness if section.insulation else 0.0
    return float(strands + tube)


def torsional_stiffness(section: CrossSection) -> float:
    """Torsional stiffness of elastic strands that do not grip each other, N m^2 / rad.

    Notes
    -----
    sum of E I cos(alpha) (cos^2(alpha) / (1 + nu) + sin^2(alpha)), I = pi d^4 / 64: a turn of the
    wire about its axis twists a strand by its part along the strand (G J = E I / (1 + nu)) and
    bends it by the part across (Love's thin rod; the energy argument of the helix factor, eq.
    (3.18) of the source). A lower bound: strands that grip each other are stiffer, and the
    insulation, whose shear modulus no sheet tells, is left out.
    """
    return float(
        sum(
            layer.count
            * layer.material.modulus
            * (np.pi * layer.diameter**4 / 64.0)
            * np.cos(layer.lay_angle)
            * (np.cos(layer.lay_angle) ** 2 / (1.0 + layer.poisson) + np.sin(layer.lay_angle) ** 2)
            for layer in section.layers
        )
    )


def curvature_grid(largest: float, onsets: Floats) -> Floats:
    """Curvatures of a table, 1/m: zero, four decades up to the largest, and the slip onsets.

    Parameters
    ----------
    largest : 1/m, the last curvature
    onsets : shape (n,), 1/m, positive, distinct, below the largest; even points next to one give
        way to it
    """
    even = np.geomspace(10.0**-_DECADES, 1.0, GRID_POINTS) * largest
    even[-1] = largest
    near = np.abs(even[:, None] - onsets) <= _DISTINCT * even[:, None]
    return np.concatenate([[0.0], np.union1d(even[~near.any(axis=1)], onsets)])


def _onsets(built: BuiltWire, spec: WireSpec, largest: float) -> Floats:
    """Curvatures at which strands begin to slip within the range, each once; 0 for at once."""
    found = np.sort(
        slip_onsets(
            built.section, built.contacts, tension=spec.tension, orientation=spec.orientation
        )
    )
    is_at_once = found <= _AT_ONCE * largest
    later = found[~is_at_once & (found < largest * (1.0 - _DISTINCT))]
    later = later[np.diff(later, prepend=0.0) > _DISTINCT * later]
    return np.concatenate([np.zeros(int(is_at_once.any())), later])


def _curve(built: BuiltWire, spec: WireSpec, curvature: Floats) -> MomentCurve:
    try:
        curve = moment_curvature(
            built.section,
            built.contacts,
            curvature,
            tension=spec.tension,
            orientation=spec.orientation,
        )
    except ValueError as error:
        raise WireError(str(error)) from error
    falls = np.diff(curve.moment) <= 0.0
    if falls.any():
        at = int(np.argmax(falls))
        message = (
            f"the law softens: the moment falls from {curve.moment[at]:.6g} N m at "
            f"{curvature[at]:.6g} 1/m to {curve.moment[at + 1]:.6g} N m at "
            f"{curvature[at + 1]:.6g} 1/m, so that a moment has more than one curvature"
        )
        raise WireError(message)
    return curve


def _cantilever(
    spec: WireSpec, curve: MomentCurve
) -> tuple[Floats, Floats, tuple[QualityNote, ...]]:
    """Deflections and end loads of the cantilever, and why they end early where they do."""
    try:
        law = concave_law(curve.curvature[1:], curve.moment[1:])
    except ValueError as error:
        message = f"no curve of the cantilever: {error}"
        note = QualityNote("cantilever_cut", Severity.WARNING, spec.place, message)
        return np.zeros(1), np.zeros(1), (note,)
    last = float(curve.moment[-1])
    wanted = FARTHEST * spec.length
    end = min(wanted, deflection_at(law, spec.length, last))
    deflection = np.linspace(0.0, end, DEFLECTIONS)
    path = end_load_path(law, spec.length, deflection[1:])
    deflection, force = deflection[: len(path.load) + 1], np.append(0.0, path.load)
    if deflection[-1] == wanted:
        return deflection, force, ()
    message = (
        f"the cantilever of {spec.length * 1e3:.4g} mm is told up to a tip deflection of "
        f"{deflection[-1] * 1e3:.4g} mm, not {wanted * 1e3:.4g} mm: beyond, the curvature at the "
        f"clamp leaves the range of the law, {curve.curvature[-1]:.4g} 1/m"
    )
    return (
        deflection,
        force,
        (QualityNote("cantilever_cut", Severity.WARNING, spec.place, message),),
    )


def _defaults(spec: WireSpec) -> tuple[QualityNote, ...]:
    if not spec.defaults:
        return ()
    message = f"the sheet does not say, so taken are: {', '.join(spec.defaults.values())}"
    return (QualityNote("defaults_taken", Severity.INFO, spec.place, message),)


def _tension(spec: WireSpec) -> tuple[QualityNote, ...]:
    if not spec.tension:
        return ()
    message = (
        f"the law holds under a tension of {spec.tension:.4g} N, there before bending; the "
        f"cantilever bends by that law, the pull of the tension on its shape left out"
    )
    return (QualityNote("tension", Severity.INFO, spec.place, message),)


def _slips_at_once(spec: WireSpec, onsets: Floats, curve: MomentCurve) -> tuple[QualityNote, ...]:
    if not np.any(onsets == 0.0):
        return ()
    slope = float(curve.secant_stiffness[1])
    message = (
        f"strands slip as soon as the wire bends (radial force {spec.radial_force:.3g} N, friction "
        f"{spec.friction_strand:.3g} and {spec.friction_insulation:.3g}): the slope of the law at "
        f"zero is {slope:.4g} N m^2, not the stick stiffness, {curve.stick_stiffness:.4g} N m^2"
    )
    return (QualityNote("slips_at_once", Severity.WARNING, spec.place, message),)
