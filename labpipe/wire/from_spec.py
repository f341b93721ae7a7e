"""From what a sheet says of a wire to its cross-section, materials and contacts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire import AUTO, WireSpec
from labpipe.wire.cross_section import TOLERANCE, CrossSection, Insulation, Layer, compressed
from labpipe.wire.cross_section import hexagonal as as_hexagon
from labpipe.wire.friction import Contacts, axial_strain, insulated
from labpipe.wire.laws import require_finite, require_positive
from labpipe.wire.materials import Material, RambergOsgood, StressTable
from labpipe.wire.moment_curvature import stick_stiffness
from labpipe.wire.packing import Kind, lay_out

_ROUNDING = 1e-9  # of the bore's radius: strands that touch
_ECCENTRIC = 0.02  # of the bore's radius: centroid of the strands off the axis
_YIELDS = 1.2  # times the stress of the curve: pull of strands that are taken as elastic
_HALF_TURN = np.linspace(0.0, np.pi, 180, endpoint=False)


class WireError(ValueError):
    """A wire that cannot be built or bent: the physical reason, in one sentence."""


@dataclass(frozen=True, slots=True, eq=False)
class BuiltWire:
    """A wire ready for the model.

    Parameters
    ----------
    section : strands in place
    contacts : friction and pressure
    axial_strain : of the straight wire under its tension
    notes : what had to be taken instead of what was asked for, or let pass
    """

    section: CrossSection
    contacts: Contacts
    axial_strain: float
    notes: tuple[QualityNote, ...]


def build(spec: WireSpec) -> BuiltWire:
    """Lay out the strands of a wire and give them their materials and contacts.

    Parameters
    ----------
    spec : of the wire

    Returns
    -------
    The wire, with the notes ``layout_fallback`` (not the hexagon, and why), ``layout_eccentric``
    (a packing to one side of the bore), ``overlap_tolerated`` and ``tension_yields``.

    Raises
    ------
    WireError
        If the strands do not fit the bore or each other (with the overlap), the tension strains
        them beyond their stress table, or a number is out of its range.
    """
    try:
        _require_numbers(spec)
        section, notes = _section(spec)
        rings = len(section.layers) - int(section.has_core)
        contacts = insulated(
            rings,
            strand=spec.friction_strand,
            insulation=spec.friction_insulation,
            radial_force=spec.radial_force,
        )
        strain = axial_strain(section, spec.tension)  # refuses what cannot be a tension
    except ValueError as error:
        raise WireError(str(error)) from error
    range_of(spec, strain=strain)  # refuses a tension beyond the stress table
    notes = (*notes, *_eccentric(section, spec), *_overlap(section, spec))
    return BuiltWire(section, contacts, strain, (*notes, *_yielding(spec, strain)))


def _require_numbers(spec: WireSpec) -> None:
    """Refuse what no other part of the model looks at."""
    require_positive("length", spec.length)
    require_finite("orientation", spec.orientation)
    if spec.largest_curvature is not None:
        require_positive("largest_curvature", spec.largest_curvature)


def material_of(spec: WireSpec) -> Material:
    """The strands' stress-strain curve: the table where there is one, else Ramberg-Osgood.

    Raises
    ------
    ValueError
        If the table turns back or stiffens, or a number is out of its range.
    """
    if spec.stress_table is not None:
        return StressTable(*spec.stress_table, source="stress table of the wire sheet")
    return RambergOsgood(
        spec.conductor_modulus, spec.copper_k, spec.copper_n, "numbers of the wire sheet"
    )


def layers_of(spec: WireSpec) -> tuple[Layer, ...]:
    """Layers from the axis outwards; the core, if there is one, has no lay angle.

    Raises
    ------
    ValueError
        If there is not one lay angle per ring and one strand diameter per layer.
    """
    material = material_of(spec)
    angles = [0.0] * int(spec.layer_counts[0] == 1) + list(spec.lay_angles)
    if not len(angles) == len(spec.layer_counts) == len(spec.strand_diameters):
        message = (
            f"{len(spec.layer_counts)} layers, {len(spec.strand_diameters)} strand diameters and "
            f"{len(spec.lay_angles)} lay angles: allowed are one diameter per layer and one angle "
            f"per ring"
        )
        raise ValueError(message)
    return tuple(
        Layer(count, diameter, angle, material, spec.poisson)
        for count, diameter, angle in zip(
            spec.layer_counts, spec.strand_diameters, angles, strict=True
        )
    )


def _section(spec: WireSpec) -> tuple[CrossSection, tuple[QualityNote, ...]]:
    bore = spec.wire_diameter / 2.0 - spec.insulation_thickness
    tube = Insulation(bore, spec.insulation_thickness, spec.insulation_modulus)
    layers = layers_of(spec)
    match spec.layout:
        case "compressed":
            return compressed(layers, tube, radii=spec.layer_radii), ()
        case layout if layout == AUTO:
            return _automatic(layers, tube, spec)
    return lay_out(layers, tube, kind=cast("Kind", spec.layout)), ()


def _automatic(
    layers: tuple[Layer, ...], tube: Insulation, spec: WireSpec
) -> tuple[CrossSection, tuple[QualityNote, ...]]:
    """The hexagon; else rings where they fit, or a packing of equal strands, with a note."""
    try:
        return as_hexagon(layers, tube), ()
    except ValueError as error:
        why = str(error)
    section = lay_out(layers, tube)
    message = f"the layout is {section.kind}, not a hexagon ({why})"
    return section, (QualityNote("layout_fallback", Severity.WARNING, spec.place, message),)


def _eccentric(section: CrossSection, spec: WireSpec) -> tuple[QualityNote, ...]:
    """Say by how much a packing lies to one side of the bore, and what that does."""
    bore = spec.wire_diameter / 2.0 - spec.insulation_thickness
    area = np.array([layer.area for layer in section.layers])[section.layer]
    off = float(np.hypot(section.x @ area, section.y @ area) / area.sum())
    if section.kind != "packed" or off <= _ECCENTRIC * bore:
        return ()
    stiffness = [stick_stiffness(section, orientation=turn) for turn in _HALF_TURN]
    message = (
        f"the strands lie to one side of the bore: their centroid is {off * 1e3:.3g} mm off the "
        f"axis, {100.0 * off / bore:.2g} % of the bore's radius. Bent about the axis, the stick "
        f"stiffness is {min(stiffness):.4g} to {max(stiffness):.4g} N m^2, by orientation"
    )
    return (QualityNote("layout_eccentric", Severity.WARNING, spec.place, message),)


def _overlap(section: CrossSection, spec: WireSpec) -> tuple[QualityNote, ...]:
    bore = spec.wire_diameter / 2.0 - spec.insulation_thickness
    if section.overlap <= _ROUNDING * bore:
        return ()
    message = (
        f"strands overlap each other or the bore by {section.overlap * 1e6:.3g} um, "
        f"{100.0 * section.overlap / bore:.2g} % of the bore's radius; up to "
        f"{100.0 * TOLERANCE:.1f} % is let pass"
    )
    return (QualityNote("overlap_tolerated", Severity.INFO, spec.place, message),)


def _yielding(spec: WireSpec, strain: float) -> tuple[QualityNote, ...]:
    """Say when the strands would yield under the tension, as the model leaves them elastic."""
    material = material_of(spec)
    elastic = material.modulus * strain
    carried = float(material.stress(np.array([strain]))[0])
    if elastic <= _YIELDS * carried:
        return ()
    message = (
        f"a tension of {spec.tension:.4g} N strains the elastic wire by {strain:.3g}: the strands "
        f"pull with {elastic / 1e6:.4g} MPa in the model, and their stress-strain curve carries "
        f"{carried / 1e6:.4g} MPa there"
    )
    return (QualityNote("tension_yields", Severity.WARNING, spec.place, message),)


def range_of(spec: WireSpec, *, strain: float = 0.0) -> tuple[float, tuple[QualityNote, ...]]:
    """Curvature up to which the law of a wire is told.

    Parameters
    ----------
    spec : of the wire
    strain : axial, of the straight wire under its tension

    Returns
    -------
    1/m: what was asked for, or a bending radius of five wire diameters; less, with the note
    ``range_shortened``, where a strand's rim reaches the last strain of the stress table by tension
    and bending together.

    Raises
    ------
    WireError
        If the tension alone strains the wire to the last strain of the stress table.
    """
    wanted = spec.largest_curvature or 1.0 / (5.0 * spec.wire_diameter)
    if spec.stress_table is None:
        return wanted, ()
    last = spec.stress_table[0][-1]
    if strain >= last:
        message = (
            f"a tension of {spec.tension:.4g} N strains the wire by {strain:.3g}, and the stress "
            f"table ends at a strain of {last:.4g}"
        )
        raise WireError(message)
    known = 2.0 * (last - strain) / max(spec.strand_diameters)
    if known >= wanted:
        return wanted, ()
    pulled = f", of which the tension takes {strain:.3g}" if strain else ""
    message = (
        f"tables end at {known:.4g} 1/m, not at {wanted:.4g} 1/m: there the rim of a strand of "
        f"{max(spec.strand_diameters) * 1e3:.3g} mm reaches the last strain of the stress table, "
        f"{last:.4g}{pulled}"
    )
    return known, (QualityNote("range_shortened", Severity.WARNING, spec.place, message),)
