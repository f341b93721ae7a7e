"""Compute the table of a wire from its row in a wire sheet: law, stiffnesses and cantilever.

Other functions replace values of the sheet with calibrated values, and compute the slopes of a law
from which sliders are made.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import cast

import numpy as np

from labpipe.mechanics.law.plays import require_finite, require_positive
from labpipe.mechanics.law.sliders import SliderLaw
from labpipe.mechanics.law.thinning import find_hull
from labpipe.mechanics.wire.bending_law import (
    Contacts,
    MomentCurve,
    compute_axial_strain,
    compute_moment_curve,
    compute_orientation_range,
    compute_stick_stiffness,
    find_slip_onsets,
    make_contacts,
)
from labpipe.mechanics.wire.cross_section import (
    MAX_RELATIVE_OVERLAP,
    CrossSection,
    Insulation,
    Layer,
    LayoutKind,
    compute_helix_overlap,
    compute_stretch_torsion,
    make_cross_section,
    place_hexagon,
    place_sectors,
)
from labpipe.mechanics.wire.first_loading import bend_cantilever
from labpipe.mechanics.wire.materials import Material, RambergOsgood, StressTable
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote
from labpipe.records.wire import (
    AUTO_LAYOUT,
    COPPER_SCALE,
    INSULATION_MODULUS,
    RADIAL_FRICTION,
    WireLayout,
    WireSpec,
    WireTable,
)
from labpipe.units import GRAVITY

_MIN_POINT_SPACING = 1e-4
"""Relative difference below which two curvatures of a table are merged."""


def tabulate_wire(spec: WireSpec) -> WireTable:
    """Compute the law of first loading and the other properties of a wire for simulations.

    Parameters
    ----------
    spec : row of the wire in its sheet, in SI units

    Returns
    -------
    The table. Its curvatures are zero, 200 logarithmically spaced values over the last four decades
    of the range, and the slip onsets of the strands. An onset below a millionth of the largest
    curvature is reported as zero. The notes are those of `build_wire` and ``range_shortened``,
    ``tension``, ``slips_at_once``, ``insulation_doubtful``, ``cantilever_cut`` and
    ``weight_left_out``.

    Raises
    ------
    ValueError
        If the strands do not fit (the message states the overlap), the law softens (the message
        states the curvature), the tension strains the wire beyond a stress table, or a value is
        outside its range.

    Notes
    -----
    The law is that of `labpipe.mechanics.wire.bending_law`. The cantilever is clamped at one end,
    with an end load normal to the undeformed axis. The first point is at rest, where the end load
    holds the tip level against the weight of the wire.
    """
    wire = build_wire(spec)
    largest_curvature, range_notes = find_law_range(spec, axial_strain=wire.axial_strain)
    onsets = _find_onsets(wire, largest_curvature)
    curvature = make_curvature_grid(largest_curvature, onsets[onsets > 0.0])
    curve = _compute_rising_curve(wire, curvature)
    insulation_limit = compute_insulation_limit(spec)
    moment_range = compute_orientation_range(
        wire.section, wire.contacts, curve, tension=spec.tension
    )
    stretch_torsion = compute_stretch_torsion(wire.section)
    cantilever = bend_cantilever(spec, curve, GRAVITY * wire.mass_per_length)
    law_notes = _find_law_notes(spec, onsets, curve, insulation_limit)
    return WireTable(
        name=spec.name,
        spec=spec,
        layout=make_layout(wire.section),
        moment=curve.moment,
        secant_stiffness=curve.secant_stiffness,
        axial_stiffness=stretch_torsion.axial_stiffness,
        torsional_stiffness=stretch_torsion.torsional_stiffness,
        free_torsional_stiffness=stretch_torsion.free_torsional_stiffness,
        stretch_twist_coupling=stretch_torsion.coupling,
        slip_onsets=onsets,
        lowest_moment=np.minimum(moment_range[0], curve.moment),
        highest_moment=np.maximum(moment_range[1], curve.moment),
        tip_deflection=cantilever.deflection,
        tip_force=cantilever.load,
        mass_per_length=wire.mass_per_length,
        rest=cantilever.rest,
        doubtful_curvature=insulation_limit,
        doubtful_deflection=cantilever.find_deflection(curve, insulation_limit),
        notes=(*wire.notes, *range_notes, *law_notes, *cantilever.notes),
        **{item.name: getattr(curve, item.name) for item in fields(curve)},
    )


def make_layout(section: CrossSection) -> WireLayout:
    """Make the record of the positions of strands in an insulated cross-section."""
    tube = section.insulation
    assert tube is not None  # every wire of a sheet is insulated
    diameter = section.repeat_per_strand(layer.diameter for layer in section.layers)
    placement = section.kind, section.x, section.y, section.layer, diameter
    return WireLayout(*placement, tube.bore_radius, tube.outer_radius)


def make_curvature_grid(largest_curvature: float, onsets: Floats) -> Floats:
    """Make the curvatures of a table: zero, four decades up to the largest, and slip onsets.

    Parameters
    ----------
    largest_curvature : 1/m, last curvature of the grid
    onsets : shape (n,), 1/m, slip onsets, positive, distinct and below the largest curvature; an
        onset replaces grid points close to it
    """
    n_points = 200
    n_decades = 4.0  # range of the grid below the largest curvature
    grid = np.geomspace(10.0**-n_decades, 1.0, n_points) * largest_curvature
    grid[-1] = largest_curvature
    is_near_onset = np.abs(grid[:, None] - onsets) <= _MIN_POINT_SPACING * grid[:, None]
    return np.concatenate([[0.0], np.union1d(grid[~is_near_onset.any(axis=1)], onsets)])


def _find_onsets(wire: BuiltWire, largest_curvature: float) -> Floats:
    """Find the distinct slip onsets of the strands, 1/m; 0 for immediate slip."""
    min_relative_onset = 1e-6  # relative to the largest curvature; a smaller onset counts as 0
    options = {"tension": wire.spec.tension, "orientation": wire.spec.orientation}
    onsets = np.sort(find_slip_onsets(wire.section, wire.contacts, **options))
    is_immediate = onsets <= min_relative_onset * largest_curvature
    is_in_range = onsets < largest_curvature * (1.0 - _MIN_POINT_SPACING)
    onsets = onsets[~is_immediate & is_in_range]
    onsets = onsets[np.diff(onsets, prepend=0.0) > _MIN_POINT_SPACING * onsets]
    return np.concatenate([np.zeros(int(is_immediate.any())), onsets])


def _compute_rising_curve(wire: BuiltWire, curvature: Floats) -> MomentCurve:
    """Compute the law of first loading; raise ValueError if the law softens."""
    curve = wire.compute_curve(curvature)
    drop_rows = np.flatnonzero(np.diff(curve.moment) <= 0.0)
    if len(drop_rows):
        rows = slice(drop_rows[0], drop_rows[0] + 2)
        facts = {"curvature": curve.curvature[rows], "moment": curve.moment[rows]}
        raise ValueError(format_sentence("mechanics.wire.softens", **facts))
    return curve


def compute_insulation_limit(spec: WireSpec) -> float:
    """Compute the curvature up to which the insulation is treated as linear, 1/m.

    The curvature is infinite if the sheet has a stress table of the insulation. The range of the
    law then ends with the stress table.
    """
    if spec.insulation_table is not None:
        return float("inf")
    return 2.0 * spec.insulation_strain / spec.wire_diameter


def _find_law_notes(
    spec: WireSpec, onsets: Floats, curve: MomentCurve, insulation_limit: float
) -> Iterator[QualityNote]:
    """Yield notes on tension, immediate slip and the range in which the insulation is linear."""
    if spec.tension:
        yield QualityNote.of("mechanics.wire.tension", spec.place, tension=spec.tension)
    if np.any(onsets == 0.0):
        yield QualityNote.of(
            "mechanics.wire.slips_at_once",
            spec.place,
            radial_force=spec.radial_force,
            friction_strand=spec.friction_strand,
            friction_insulation=spec.friction_insulation,
            slope=curve.secant_stiffness[1],
            stick_stiffness=curve.stick_stiffness,
        )
    if curve.curvature[-1] > insulation_limit:
        percent = 100.0 * spec.insulation_strain
        yield QualityNote.of("mechanics.wire.insulation_doubtful", spec.place, percent=percent)


@dataclass(frozen=True, slots=True, eq=False)
class BuiltWire:
    """Cross-section of the wire in a row of a sheet, and the contacts between its strands.

    Parameters
    ----------
    spec : row of the wire in its sheet
    section : cross-section of the wire
    contacts : friction coefficients of the rings, and radial force
    axial_strain : strain of the straight wire under its tension
    notes : notes on defaults for missing entries of the row, and on the layout
    """

    spec: WireSpec
    section: CrossSection
    contacts: Contacts
    axial_strain: float
    notes: tuple[QualityNote, ...]

    def compute_curve(self, curvature: Floats) -> MomentCurve:
        """Compute the moments of first loading at curvatures, shape (n,), 1/m."""
        options = {"tension": self.spec.tension, "orientation": self.spec.orientation}
        return compute_moment_curve(self.section, self.contacts, curvature, **options)

    @property
    def mass_per_length(self) -> float:
        """Mass per length, kg/m, from the sheet, or computed if the sheet does not state it."""
        if self.spec.mass_per_length is not None:
            return self.spec.mass_per_length
        densities = self.spec.conductor_density, self.spec.insulation_density
        return self.section.compute_mass_per_length(*densities)


def build_wire(spec: WireSpec) -> BuiltWire:
    """Build the cross-section of a wire and the contacts between its strands.

    Parameters
    ----------
    spec : row of the wire in its sheet

    Returns
    -------
    The wire. Its notes can be ``defaults_taken``, ``layout_fallback`` (why the layout is not a
    hexagon), ``bore_loose``, ``layout_eccentric`` (the strands are on one side of the bore),
    ``overlap_tolerated``, ``helices_overlap`` and ``tension_yields``.

    Raises
    ------
    ValueError
        If the strands do not fit the bore or each other, as circles or as helices (the message
        states the overlap), the tension strains the wire beyond a stress table, or a value is
        outside its range.
    """
    notes = []
    if spec.defaults:
        names = ", ".join(spec.defaults.values())
        notes.append(QualityNote.of("mechanics.wire.defaults_taken", spec.place, names=names))
    require_positive("length", spec.length)
    require_finite("orientation", spec.orientation)
    if spec.largest_curvature is not None:
        require_positive("largest_curvature", spec.largest_curvature)
    section, layout_notes = _place_strands(spec)
    notes += [*layout_notes, *_find_helix_notes(section, spec)]
    contacts = make_contacts(
        len(section.layers) - int(section.has_core),
        strand=spec.friction_strand,
        insulation=spec.friction_insulation,
        radial_force=spec.radial_force,
    )
    axial_strain = compute_axial_strain(section, spec.tension)  # raises for a negative tension
    find_law_range(spec, axial_strain=axial_strain)  # raises for a tension beyond a stress table
    notes += _find_section_notes(section, spec, axial_strain)
    return BuiltWire(spec, section, contacts, axial_strain, tuple(notes))


def make_layers(spec: WireSpec) -> tuple[Layer, ...]:
    """Make the layers of strands from the axis outwards; a core has the lay angle 0.

    The stress-strain curve of the strands is the stress table of the sheet or, without a table, a
    Ramberg-Osgood curve.

    Raises
    ------
    ValueError
        If the number of lay angles differs from that of the rings, or the number of strand
        diameters from that of the layers, a slope of the stress table is larger than the first, or
        a value is outside its range.
    """
    material: Material = RambergOsgood(spec.conductor_modulus, spec.copper_k, spec.copper_n)
    if spec.stress_table is not None:
        material = StressTable(*spec.stress_table)
    angles = [0.0] * int(spec.layer_counts[0] == 1) + list(spec.lay_angles)
    counts, diameters = spec.layer_counts, spec.strand_diameters
    if not len(angles) == len(counts) == len(diameters):
        n_angles = len(spec.lay_angles)
        facts = {"layers": len(counts), "diameters": len(diameters), "angles": n_angles}
        raise ValueError(format_sentence("mechanics.wire.layers_differ", **facts))
    rows = zip(counts, diameters, angles, strict=True)
    return tuple(Layer(*row, material, spec.poisson) for row in rows)


def make_insulation(spec: WireSpec) -> Insulation:
    """Make the insulation of a wire, with the stress table of the sheet if it has one.

    Raises
    ------
    ValueError
        If a slope of the stress table is larger than the first, or a value is outside its range.
    """
    curve = None if spec.insulation_table is None else StressTable(*spec.insulation_table)
    modulus = spec.insulation_modulus if curve is None else curve.modulus
    wall, poisson = spec.insulation_thickness, spec.insulation_poisson
    return Insulation(spec.wire_diameter / 2.0 - wall, wall, modulus, poisson, curve)


def _place_strands(spec: WireSpec) -> tuple[CrossSection, list[QualityNote]]:
    """Make the cross-section, and a note if the default layout, a hexagon, does not fit."""
    tube, layers = make_insulation(spec), make_layers(spec)
    if spec.layout == "compressed":
        return place_sectors(layers, tube, radii=spec.layer_radii), []
    if spec.layout != AUTO_LAYOUT:
        return make_cross_section(layers, tube, kind=cast("LayoutKind", spec.layout)), []
    try:
        return place_hexagon(layers, tube), []
    except ValueError as error:
        section = make_cross_section(layers, tube)
        facts = {"kind": section.kind, "reason": error}
        return section, [QualityNote.of("mechanics.wire.layout_fallback", spec.place, **facts)]


def _find_section_notes(
    section: CrossSection, spec: WireSpec, axial_strain: float
) -> Iterator[QualityNote]:
    """Yield notes on a loose bore, eccentric strands, overlaps, and yielding in tension.

    Strands of the model are elastic in tension. The note on yielding compares their stress with
    that of the stress-strain curve.
    """
    min_fill = 0.4  # fraction of the area of the bore; two strands that touch the bore fill 0.5
    max_silent_offset, touch_tolerance = 0.02, 1e-9  # relative to the radius of the bore
    max_elastic_factor = 1.2  # elastic stress relative to the stress of the stress-strain curve
    bore_radius = spec.wire_diameter / 2.0 - spec.insulation_thickness
    areas = section.repeat_per_strand(layer.area for layer in section.layers)
    offset = float(np.hypot(section.x @ areas, section.y @ areas) / areas.sum())
    fill = float(areas.sum()) / (np.pi * bore_radius**2)
    if fill < min_fill:
        bore_mm = 2e3 * bore_radius
        yield QualityNote.of("mechanics.wire.bore_loose", spec.place, fill=fill, bore=bore_mm)
    if section.kind == "packed" and offset > max_silent_offset * bore_radius:
        angles = np.linspace(0.0, np.pi, 180, endpoint=False)
        stiffnesses = [compute_stick_stiffness(section, orientation=angle) for angle in angles]
        yield QualityNote.of(
            "mechanics.wire.layout_eccentric",
            spec.place,
            offset=1e3 * offset,
            percent=100.0 * offset / bore_radius,
            lowest=min(stiffnesses),
            highest=max(stiffnesses),
        )
    if section.overlap > touch_tolerance * bore_radius:
        yield QualityNote.of(
            "mechanics.wire.overlap_tolerated",
            spec.place,
            overlap=1e6 * section.overlap,
            percent=100.0 * section.overlap / bore_radius,
            allowed=100.0 * MAX_RELATIVE_OVERLAP,
        )
    material = section.layers[0].material
    elastic_stress = material.modulus * axial_strain
    stress = float(material.compute_stress(np.array([axial_strain]))[0])
    if elastic_stress > max_elastic_factor * stress:
        yield QualityNote.of(
            "mechanics.wire.tension_yields",
            spec.place,
            tension=spec.tension,
            strain=axial_strain,
            elastic_stress=elastic_stress / 1e6,
            stress=stress / 1e6,
        )


def _find_helix_notes(section: CrossSection, spec: WireSpec) -> Iterator[QualityNote]:
    """Yield a note on helical strands that overlap; raise ValueError if they do not fit.

    The cross-section of the wire cuts a strand obliquely. The area and the width of the strand in
    the section are therefore larger by the factor 1 / cos(lay angle). Layouts of circles are
    accurate enough for lay angles up to 20 deg.
    """
    max_silent_overlap = 0.05  # relative to the diameter of the strands
    max_overlap = 0.1  # relative to the diameter of the strands, and to the area of the bore
    strand_area = sum(layer.section_area for layer in section.layers)
    bore_area = np.pi * (spec.wire_diameter / 2.0 - spec.insulation_thickness) ** 2
    if strand_area > (1.0 + max_overlap) * bore_area:
        areas = {"copper": strand_area * 1e6, "bore": bore_area * 1e6}
        raise ValueError(format_sentence("mechanics.wire.copper_too_large", **areas))
    overlap = 0.0 if section.kind == "compressed" else compute_helix_overlap(section)
    if overlap <= max_silent_overlap:
        return
    percent = 100.0 * overlap
    if overlap > max_overlap:
        facts = {"percent": percent, "allowed": max_overlap}
        raise ValueError(format_sentence("mechanics.wire.strands_overlap", **facts))
    yield QualityNote.of("mechanics.wire.helices_overlap", spec.place, percent=percent)


def find_law_range(spec: WireSpec, *, axial_strain: float = 0.0) -> tuple[float, list[QualityNote]]:
    """Find the curvature up to which the law of a wire is tabulated.

    Parameters
    ----------
    spec : row of the wire in its sheet
    axial_strain : axial strain of the straight wire under its tension

    Returns
    -------
    The curvature, 1/m, and notes. The curvature is that of the sheet or, if the sheet does not
    state it, that of a bending radius of five wire diameters. It is smaller, with the note
    ``range_shortened``, if tension and bending would strain the rim of a strand or of the
    insulation beyond a stress table.

    Raises
    ------
    ValueError
        If the tension without bending strains the wire to the last strain of a stress table.
    """
    min_radius_diameters = 5.0  # wire diameters; harnesses are rarely bent to smaller radii
    largest_curvature = spec.largest_curvature or 1.0 / (min_radius_diameters * spec.wire_diameter)
    notes: list[QualityNote] = []
    strand_diameter, wire_diameter = max(spec.strand_diameters), spec.wire_diameter
    for table, diameter, body in (
        (spec.stress_table, strand_diameter, f"a strand of {strand_diameter * 1e3:.3g} mm"),
        (spec.insulation_table, wire_diameter, f"the insulation of {wire_diameter * 1e3:.3g} mm"),
    ):
        if table is None:
            continue
        last_strain = table[0][-1]
        if axial_strain >= last_strain:
            facts = {"tension": spec.tension, "strain": axial_strain, "last_strain": last_strain}
            raise ValueError(format_sentence("mechanics.wire.tension_beyond_table", **facts))
        table_end = 2.0 * (last_strain - axial_strain) / diameter
        if table_end >= largest_curvature:
            continue
        tension_text = f", of which the tension takes {axial_strain:.3g}" if axial_strain else ""
        note = QualityNote.of(
            "mechanics.wire.range_shortened",
            spec.place,
            end=table_end,
            nominal_end=largest_curvature,
            body=body,
            last_strain=last_strain,
            tension_text=tension_text,
        )
        notes.append(note)
        largest_curvature = table_end
    return largest_curvature, notes


DEFAULT_SHARE_RANGE = (0.35, 1.0)
"""Default range of the isotropic share of the hardening of annealed copper.

With a smaller share, a wire would spring back farther than standards for winding wire allow.
"""


def replace_parameters(spec: WireSpec, values: Mapping[str, float]) -> WireSpec:
    """Return the row of a wire with calibrated values in place of those of the sheet.

    Parameters
    ----------
    spec : row of the calibrated wire in its sheet, or of another wire of the same type
    values : calibrated values in SI units, keyed by the names of `PARAMETERS`. For a value that is
        missing or NaN, the value of the sheet remains. The copper scale multiplies the strength
        coefficient K

    Returns
    -------
    The changed row. The friction coefficients are not changed. The value of `RADIAL_FRICTION`
    determines the radial force.
    """
    values = {name: value for name, value in values.items() if np.isfinite(value)}
    if RADIAL_FRICTION in values:
        friction = spec.friction_strand + spec.friction_insulation
        spec = replace(spec, radial_force=values[RADIAL_FRICTION] / friction)
    modulus = values.get(INSULATION_MODULUS, spec.insulation_modulus)
    if INSULATION_MODULUS in values and spec.insulation_table is not None:
        strains, stresses = spec.insulation_table  # the stresses are proportional to the modulus
        scale = modulus / (stresses[0] / strains[0])
        scaled_table = strains, tuple(scale * stress for stress in stresses)
        spec = replace(spec, insulation_table=scaled_table)
    copper_k = spec.copper_k * values.get(COPPER_SCALE, 1.0)
    return replace(spec, insulation_modulus=modulus, copper_k=copper_k)


def compute_chord_ratio(law: SliderLaw, table: WireTable) -> float:
    """Compute the ratio of the first stiffness of a fitted law to that of its table.

    The stiffness of the table is the slope of its concave hull up to the first corner of the law.
    """
    corners = np.concatenate([[0.0], law.slip_curvatures, [law.max_curvature]])
    moment = np.interp(corners, table.curvature, table.moment)
    return law.first_stiffness / float(compute_hull_slopes(corners, moment)[0])


def compute_hull_slopes(curvature: Floats, moment: Floats) -> Floats:
    """Compute the slopes of the concave hull of a law between its corners, as in `fit_sliders`.

    Parameters
    ----------
    curvature : shape (n,), 1/m, curvatures of the corners of the law
    moment : shape (n,), N m, moments of the corners

    Returns
    -------
    Shape (n - 1,), N m^2, not increasing.
    """
    hull = find_hull(curvature, moment, min_slope_drop=0.0)
    hull_moment = np.interp(curvature, curvature[hull], moment[hull])
    return np.asarray(np.diff(hull_moment) / np.diff(curvature))
