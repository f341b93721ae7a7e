"""Table of a wire from its row in a sheet: law, stiffnesses, cantilever."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import cast

import numpy as np

from labpipe.mechanics.law.plays import require_finite, require_positive
from labpipe.mechanics.wire.bending_law import (
    MomentCurve,
    compute_moment_curve,
    compute_stick_stiffness,
    find_orientation_range,
)
from labpipe.mechanics.wire.cross_section import (
    MAX_OVERLAP_SHARE,
    CrossSection,
    Insulation,
    Layer,
    compute_stretch_torsion,
    place_hexagon,
    place_sectors,
)
from labpipe.mechanics.wire.first_loading import compute_cantilever
from labpipe.mechanics.wire.friction import (
    Contacts,
    compute_axial_strain,
    find_slip_onsets,
    make_contacts,
)
from labpipe.mechanics.wire.materials import Material, RambergOsgood, StressTable
from labpipe.mechanics.wire.packing import LayoutKind, find_helix_overlap, make_cross_section
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote
from labpipe.records.wire import AUTO, WireLayout, WireSpec, WireTable
from labpipe.units import GRAVITY

_MIN_POINT_SPACING = 1e-4  # of a curvature: nearer points are one


def wire_table(spec: WireSpec) -> WireTable:
    """Compute the law of a wire on first loading, and the other properties for simulation.

    Parameters
    ----------
    spec : of the wire, in SI units

    Returns
    -------
    The table. Its curvatures are zero, 200 spread evenly in the logarithm over four decades up to
    the end of the range, and those at which strands begin to slip; an onset below a millionth of
    the range is reported as zero. Notes: ``defaults_taken``, those of `build_wire`,
    ``range_shortened``, ``tension``, ``slips_at_once``, ``insulation_doubtful``,
    ``cantilever_cut``, ``weight_left_out``.

    Raises
    ------
    WireError
        If the strands do not fit (the message states the overlap), the law softens (at the stated
        curvature), the tension strains them beyond their stress table, or a number is out of range.

    Notes
    -----
    The law is that of `wire.bending_law`. The cantilever is clamped at one end, with an end
    load normal to the clamped axis; it starts from rest, level under its own weight with its
    tip held.
    """
    built = build_wire(spec)
    largest, shortened = find_range(spec, strain=built.axial_strain)
    onsets = _slip_onsets(built, spec, largest)
    curve = _curve(built, spec, make_curvature_grid(largest, onsets[onsets > 0.0]))
    limit = find_linear_range(spec)
    lowest, highest = find_orientation_range(
        built.section, built.contacts, curve, tension=spec.tension
    )
    mass, pair = mass_per_length(spec, built.section), compute_stretch_torsion(built.section)
    cantilever = compute_cantilever(spec, curve, GRAVITY * mass)
    notes = (*built.notes, *shortened, *_law_notes(spec, onsets, curve, limit), *cantilever.notes)
    return WireTable(
        name=spec.name,
        spec=spec,
        layout=make_layout(built.section),
        moment=curve.moment,
        secant_stiffness=curve.secant_stiffness,
        axial_stiffness=pair.axial,
        torsional_stiffness=pair.torsional,
        free_torsional_stiffness=pair.torsional_free,
        stretch_twist_coupling=pair.coupling,
        slip_onsets=onsets,
        lowest_moment=np.minimum(lowest, curve.moment),
        highest_moment=np.maximum(highest, curve.moment),
        tip_deflection=cantilever.deflection,
        tip_force=cantilever.force,
        mass_per_length=mass,
        rest=cantilever.rest,
        doubtful_curvature=limit,
        doubtful_deflection=cantilever.deflection_at(curve, limit),
        notes=notes,
        **{item.name: getattr(curve, item.name) for item in fields(curve)},
    )


def make_layout(section: CrossSection) -> WireLayout:
    """Return the positions of the strands of an insulated section as a record."""
    tube = section.insulation
    if tube is None:
        message = "the section has no insulation: expected a tube"
        raise ValueError(message)
    diameter = np.array([layer.diameter for layer in section.layers])[section.layer]
    outside = tube.bore_radius + tube.thickness
    return WireLayout(
        section.kind, section.x, section.y, section.layer, diameter, tube.bore_radius, outside
    )


def mass_per_length(spec: WireSpec, section: CrossSection) -> float:
    """Return the mass per length of a wire, kg/m, from its sheet or from section and densities."""
    if spec.mass_per_length is not None:
        return spec.mass_per_length
    return section.mass_per_length(spec.conductor_density, spec.insulation_density)


def make_curvature_grid(largest: float, onsets: Floats) -> Floats:
    """Return the curvatures of a table, 1/m: zero, four decades up to the largest, the slip onsets.

    Parameters
    ----------
    largest : 1/m, the last curvature
    onsets : shape (n,), 1/m, positive, distinct, below the largest; they replace even points next
        to them
    """
    grid_points = 200
    decades = 4.0  # of curvature below the largest
    even = np.geomspace(10.0**-decades, 1.0, grid_points) * largest
    even[-1] = largest
    is_near_onset = np.abs(even[:, None] - onsets) <= _MIN_POINT_SPACING * even[:, None]
    return np.concatenate([[0.0], np.union1d(even[~is_near_onset.any(axis=1)], onsets)])


def _slip_onsets(built: BuiltWire, spec: WireSpec, largest: float) -> Floats:
    """Return the distinct curvatures at which strands begin to slip; 0 for immediate slip."""
    min_onset_share = 1e-6  # of the largest curvature: strands that slip earlier never stick
    curvatures = np.sort(
        find_slip_onsets(
            built.section, built.contacts, tension=spec.tension, orientation=spec.orientation
        )
    )
    is_at_once = curvatures <= min_onset_share * largest
    later = curvatures[~is_at_once & (curvatures < largest * (1.0 - _MIN_POINT_SPACING))]
    later = later[np.diff(later, prepend=0.0) > _MIN_POINT_SPACING * later]
    return np.concatenate([np.zeros(int(is_at_once.any())), later])


def _curve(built: BuiltWire, spec: WireSpec, curvature: Floats) -> MomentCurve:
    try:
        curve = compute_moment_curve(
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
        worst = int(np.argmax(falls))
        message = (
            f"the law softens: the moment falls from {curve.moment[worst]:.6g} N m at "
            f"{curvature[worst]:.6g} 1/m to {curve.moment[worst + 1]:.6g} N m at "
            f"{curvature[worst + 1]:.6g} 1/m, so that curvature is not a function of the moment"
        )
        raise WireError(message)
    return curve


def find_linear_range(spec: WireSpec) -> float:
    """Return the curvature up to which the insulation counts as linear, 1/m.

    Infinite for a wire with a stress table of its insulation: the range of its law ends with the
    table.
    """
    if spec.insulation_table is not None:
        return float("inf")
    return 2.0 * spec.insulation_strain / spec.wire_diameter


def _law_notes(
    spec: WireSpec, onsets: Floats, curve: MomentCurve, limit: float
) -> Iterator[QualityNote]:
    if spec.tension:
        yield QualityNote.of("mechanics.wire.tension", spec.place, tension=spec.tension)
    if np.any(onsets == 0.0):
        yield QualityNote.of(
            "mechanics.wire.slips_at_once",
            spec.place,
            force=spec.radial_force,
            strand=spec.friction_strand,
            insulation=spec.friction_insulation,
            slope=curve.secant_stiffness[1],
            stick=curve.stick_stiffness,
        )
    if curve.curvature[-1] > limit:
        percent = 100.0 * spec.insulation_strain
        yield QualityNote.of("mechanics.wire.insulation_doubtful", spec.place, percent=percent)


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
    notes : replacements of what the sheet specifies, and tolerated faults
    """

    section: CrossSection
    contacts: Contacts
    axial_strain: float
    notes: tuple[QualityNote, ...]


def build_wire(spec: WireSpec) -> BuiltWire:
    """Lay out the strands of a wire and give them their materials and contacts.

    Parameters
    ----------
    spec : of the wire

    Returns
    -------
    The wire, with the notes ``layout_fallback`` (not the hexagon, and why), ``layout_eccentric``
    (a packing to one side of the bore), ``overlap_tolerated``, ``helices_overlap`` and
    ``tension_yields``.

    Raises
    ------
    WireError
        If the strands do not fit the bore or each other (with the overlap), as circles or as
        helices, the tension strains them beyond their stress table, or a number is
        out of its range.
    """
    notes = []
    if spec.defaults:
        names = ", ".join(spec.defaults.values())
        notes.append(QualityNote.of("mechanics.wire.defaults_taken", spec.place, names=names))
    try:
        require_positive("length", spec.length)
        require_finite("orientation", spec.orientation)
        if spec.largest_curvature is not None:
            require_positive("largest_curvature", spec.largest_curvature)
        section, layout_notes = _section(spec)
        notes += [*layout_notes, *_helix_notes(section, spec)]
        contacts = make_contacts(
            len(section.layers) - int(section.has_core),
            strand=spec.friction_strand,
            insulation=spec.friction_insulation,
            radial_force=spec.radial_force,
        )
        strain = compute_axial_strain(section, spec.tension)  # refuses a negative tension
    except ValueError as error:
        raise WireError(str(error)) from error
    find_range(spec, strain=strain)  # refuses a tension beyond the stress table
    notes += _section_notes(section, spec, strain)
    return BuiltWire(section, contacts, strain, tuple(notes))


def make_material(spec: WireSpec) -> Material:
    """Return the strands' stress-strain curve: the table if there is one, else Ramberg-Osgood.

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


def make_layers(spec: WireSpec) -> tuple[Layer, ...]:
    """Return the layers from the axis outwards; a core has no lay angle.

    Raises
    ------
    ValueError
        If there is not one lay angle per ring and one strand diameter per layer.
    """
    material = make_material(spec)
    angles = [0.0] * int(spec.layer_counts[0] == 1) + list(spec.lay_angles)
    if not len(angles) == len(spec.layer_counts) == len(spec.strand_diameters):
        message = (
            f"{len(spec.layer_counts)} layers, {len(spec.strand_diameters)} strand diameters and "
            f"{len(spec.lay_angles)} lay angles: expected one diameter per layer and one angle "
            f"per ring"
        )
        raise ValueError(message)
    return tuple(
        Layer(count, diameter, angle, material, spec.poisson)
        for count, diameter, angle in zip(
            spec.layer_counts, spec.strand_diameters, angles, strict=True
        )
    )


def _section(spec: WireSpec) -> tuple[CrossSection, list[QualityNote]]:
    """Lay out the strands; note where the default layout, a hexagon, does not fit."""
    bore = spec.wire_diameter / 2.0 - spec.insulation_thickness
    curve = None
    if spec.insulation_table is not None:
        curve = StressTable(*spec.insulation_table, source="insulation table of the wire sheet")
    modulus = spec.insulation_modulus if curve is None else curve.modulus
    tube = Insulation(bore, spec.insulation_thickness, modulus, spec.insulation_poisson, curve)
    layers = make_layers(spec)
    if spec.layout == "compressed":
        return place_sectors(layers, tube, radii=spec.layer_radii), []
    if spec.layout != AUTO:
        return make_cross_section(layers, tube, kind=cast("LayoutKind", spec.layout)), []
    try:
        return place_hexagon(layers, tube), []
    except ValueError as error:
        section, reason = make_cross_section(layers, tube), str(error)
    return section, [
        QualityNote.of(
            "mechanics.wire.layout_fallback", spec.place, kind=section.kind, reason=reason
        )
    ]


def _section_notes(section: CrossSection, spec: WireSpec, strain: float) -> Iterator[QualityNote]:
    """Note a packing to one side of the bore, overlaps, and strands that yield under the tension.

    The model treats the axial stiffness of strands as elastic.
    """
    max_silent_offset = 0.02  # of the bore's radius
    touch_tolerance = 1e-9  # of the bore's radius
    max_elastic_factor = 1.2  # times the stress of the curve
    bore = spec.wire_diameter / 2.0 - spec.insulation_thickness
    area = np.array([layer.area for layer in section.layers])[section.layer]
    offset = float(np.hypot(section.x @ area, section.y @ area) / area.sum())
    if section.kind == "packed" and offset > max_silent_offset * bore:
        turns = np.linspace(0.0, np.pi, 180, endpoint=False)
        stiffness = [compute_stick_stiffness(section, orientation=turn) for turn in turns]
        yield QualityNote.of(
            "mechanics.wire.layout_eccentric",
            spec.place,
            offset=1e3 * offset,
            percent=100.0 * offset / bore,
            lowest=min(stiffness),
            highest=max(stiffness),
        )
    if section.overlap > touch_tolerance * bore:
        yield QualityNote.of(
            "mechanics.wire.overlap_tolerated",
            spec.place,
            overlap=1e6 * section.overlap,
            percent=100.0 * section.overlap / bore,
            allowed=100.0 * MAX_OVERLAP_SHARE,
        )
    material = make_material(spec)
    elastic = material.modulus * strain
    carried = float(material.stress(np.array([strain]))[0])
    if elastic > max_elastic_factor * carried:
        yield QualityNote.of(
            "mechanics.wire.tension_yields",
            spec.place,
            tension=spec.tension,
            strain=strain,
            elastic=elastic / 1e6,
            carried=carried / 1e6,
        )


def _helix_notes(section: CrossSection, spec: WireSpec) -> Iterator[QualityNote]:
    """Refuse a lay so steep that the strands do not fit the bore; note a steep one.

    In the section a strand has 1 / cos(lay angle) of its area and width. Layouts of circles, as
    usual, are accurate enough for lay angles up to 20 deg.
    """
    max_silent_overlap = 0.05  # of the strands' diameter
    max_overlap = 0.1  # of the strands' diameter, and of the area
    copper = sum(layer.count * layer.area / np.cos(layer.lay_angle) for layer in section.layers)
    bore = np.pi * (spec.wire_diameter / 2.0 - spec.insulation_thickness) ** 2
    if copper > (1.0 + max_overlap) * bore:
        message = (
            f"the strands do not fit the bore: with 1 / cos(lay angle) their areas in the section "
            f"are {copper * 1e6:.4g} mm^2, and the bore has {bore * 1e6:.4g} mm^2"
        )
        raise ValueError(message)
    overlap = 0.0 if section.kind == "compressed" else find_helix_overlap(section)
    if overlap <= max_silent_overlap:
        return
    percent = 100.0 * overlap
    if overlap > max_overlap:
        raise ValueError(
            format_sentence("mechanics.wire.strands_overlap", percent=percent, allowed=max_overlap)
        )
    yield QualityNote.of("mechanics.wire.helices_overlap", spec.place, percent=percent)


def find_range(spec: WireSpec, *, strain: float = 0.0) -> tuple[float, tuple[QualityNote, ...]]:
    """Return the curvature up to which the law of a wire is tabulated.

    Parameters
    ----------
    spec : of the wire
    strain : axial, of the straight wire under its tension

    Returns
    -------
    1/m: the value of the sheet, or a bending radius of five wire diameters; less, with the note
    ``range_shortened``, where the rim of a strand, or of the insulation, reaches the last strain of
    its stress table by tension and bending together.

    Raises
    ------
    WireError
        If the tension alone strains the wire to the last strain of a stress table.
    """
    largest_curvature = spec.largest_curvature or 1.0 / (5.0 * spec.wire_diameter)
    notes: tuple[QualityNote, ...] = ()
    strand, wire = max(spec.strand_diameters), spec.wire_diameter
    for table, diameter, part in (
        (spec.stress_table, strand, f"a strand of {strand * 1e3:.3g} mm"),
        (spec.insulation_table, wire, f"the insulation of {wire * 1e3:.3g} mm"),
    ):
        if table is None:
            continue
        last = table[0][-1]
        if strain >= last:
            message = (
                f"a tension of {spec.tension:.4g} N strains the wire by {strain:.3g}, and the "
                f"stress table ends at a strain of {last:.4g}"
            )
            raise WireError(message)
        end = 2.0 * (last - strain) / diameter
        if end >= largest_curvature:
            continue
        pulled = f", of which the tension takes {strain:.3g}" if strain else ""
        note = QualityNote.of(
            "mechanics.wire.range_shortened",
            spec.place,
            end=end,
            wanted=largest_curvature,
            part=part,
            last=last,
            pulled=pulled,
        )
        largest_curvature, notes = end, (*notes, note)
    return largest_curvature, notes
