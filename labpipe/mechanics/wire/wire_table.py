"""Compute the table of a wire from its row in a sheet: law, stiffnesses and cantilever.

Further functions replace values of the sheet by calibrated ones, and prepare the sliders that
represent the bending of the strands.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import cast

import numpy as np

from labpipe.mechanics.law.plays import require_finite, require_positive
from labpipe.mechanics.law.sliders import GrowingSlider, SliderLaw, make_growing_slider
from labpipe.mechanics.law.thinning import find_hull
from labpipe.mechanics.wire.bending_law import (
    Contacts,
    MomentCurve,
    compute_axial_strain,
    compute_moment_curve,
    compute_stick_stiffness,
    continue_strands,
    find_orientation_range,
    find_slip_onsets,
    make_contacts,
)
from labpipe.mechanics.wire.cross_section import (
    MAX_RELATIVE_OVERLAP,
    CrossSection,
    Insulation,
    Layer,
    LayoutKind,
    compute_stretch_torsion,
    find_helix_overlap,
    make_cross_section,
    place_hexagon,
    place_sectors,
)
from labpipe.mechanics.wire.first_loading import compute_cantilever
from labpipe.mechanics.wire.materials import Material, RambergOsgood, StressTable
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote
from labpipe.records.wire import (
    AUTO,
    COPPER_SCALE,
    INSULATION_MODULUS,
    RADIAL_FRICTION,
    WireLayout,
    WireSpec,
    WireTable,
)
from labpipe.units import GRAVITY

_MIN_POINT_SPACING = 1e-4  # of a curvature: points that are closer are merged


def tabulate_wire(spec: WireSpec) -> WireTable:
    """Compute the law of a wire on first loading, and its other properties for simulation.

    Parameters
    ----------
    spec : row of the wire in its sheet, in SI units

    Returns
    -------
    The table. Its curvatures are zero, 200 spread evenly in the logarithm over four decades up to
    the end of the range, and those at which strands begin to slip; an onset below a millionth of
    the range is reported as zero. Notes: those of `build_wire`, ``range_shortened``, ``tension``,
    ``slips_at_once``, ``insulation_doubtful``, ``cantilever_cut``, ``weight_left_out``.

    Raises
    ------
    ValueError
        If the strands do not fit (the message states the overlap), the law softens (at the stated
        curvature), the tension strains them beyond their stress table, or a number is out of range.

    Notes
    -----
    The law is that of `wire.bending_law`. The cantilever is clamped at one end, with an end
    load normal to the clamped axis. The first point is at rest: the end load then holds the tip
    level against the weight of the wire.
    """
    built = build_wire(spec)
    largest, range_notes = find_law_range(spec, strain=built.axial_strain)
    onsets = _find_onsets(built, largest)
    curve = _compute_rising_curve(built, make_curvature_grid(largest, onsets[onsets > 0.0]))
    limit = find_insulation_limit(spec)
    lowest, highest = find_orientation_range(
        built.section, built.contacts, curve, tension=spec.tension
    )
    stretch_torsion = compute_stretch_torsion(built.section)
    cantilever = compute_cantilever(spec, curve, GRAVITY * built.mass_per_length)
    notes = (*built.notes, *range_notes, *_note_law(spec, onsets, curve, limit), *cantilever.notes)
    return WireTable(
        name=spec.name,
        spec=spec,
        layout=make_layout(built.section),
        moment=curve.moment,
        secant_stiffness=curve.secant_stiffness,
        axial_stiffness=stretch_torsion.axial,
        torsional_stiffness=stretch_torsion.torsional,
        free_torsional_stiffness=stretch_torsion.torsional_free,
        stretch_twist_coupling=stretch_torsion.coupling,
        slip_onsets=onsets,
        lowest_moment=np.minimum(lowest, curve.moment),
        highest_moment=np.maximum(highest, curve.moment),
        tip_deflection=cantilever.deflection,
        tip_force=cantilever.force,
        mass_per_length=built.mass_per_length,
        rest=cantilever.rest,
        doubtful_curvature=limit,
        doubtful_deflection=cantilever.find_deflection(curve, limit),
        notes=notes,
        **{item.name: getattr(curve, item.name) for item in fields(curve)},
    )


def make_layout(section: CrossSection) -> WireLayout:
    """Return the positions of the strands of an insulated section as a record."""
    tube = section.insulation
    assert tube is not None  # wires of a sheet have one
    diameter = section.per_strand(layer.diameter for layer in section.layers)
    strands = section.kind, section.x, section.y, section.layer, diameter
    return WireLayout(*strands, tube.bore_radius, tube.outer_radius)


def make_curvature_grid(largest: float, onsets: Floats) -> Floats:
    """Return the curvatures of a table, 1/m: zero, four decades up to the largest, the slip onsets.

    Parameters
    ----------
    largest : 1/m, the last curvature
    onsets : shape (n,), 1/m, positive, distinct, below the largest; they replace points of the grid
        that are close to them
    """
    grid_points = 200
    decades = 4.0  # of curvature below the largest
    grid = np.geomspace(10.0**-decades, 1.0, grid_points) * largest
    grid[-1] = largest
    is_near_onset = np.abs(grid[:, None] - onsets) <= _MIN_POINT_SPACING * grid[:, None]
    return np.concatenate([[0.0], np.union1d(grid[~is_near_onset.any(axis=1)], onsets)])


def _find_onsets(built: BuiltWire, largest: float) -> Floats:
    """Return the distinct curvatures at which strands begin to slip; 0 for immediate slip."""
    min_onset_share = 1e-6  # of the largest curvature: strands that slip earlier never stick
    wire, spec = (built.section, built.contacts), built.spec
    curvatures = np.sort(
        find_slip_onsets(*wire, tension=spec.tension, orientation=spec.orientation)
    )
    is_immediate = curvatures <= min_onset_share * largest
    later = curvatures[~is_immediate & (curvatures < largest * (1.0 - _MIN_POINT_SPACING))]
    later = later[np.diff(later, prepend=0.0) > _MIN_POINT_SPACING * later]
    return np.concatenate([np.zeros(int(is_immediate.any())), later])


def _compute_rising_curve(built: BuiltWire, curvature: Floats) -> MomentCurve:
    """Compute the law of first loading; refuse one that softens."""
    curve = built.compute_curve(curvature)
    falls = np.flatnonzero(np.diff(curve.moment) <= 0.0)
    if len(falls):
        (first, last), (high, low) = (
            values[falls[0] : falls[0] + 2] for values in (curve.curvature, curve.moment)
        )
        raise ValueError(
            format_sentence("mechanics.wire.softens", first=first, last=last, high=high, low=low)
        )
    return curve


def find_insulation_limit(spec: WireSpec) -> float:
    """Return the curvature up to which the insulation counts as linear, 1/m.

    Infinite for a wire with a stress table of its insulation: the range of its law ends with the
    table.
    """
    if spec.insulation_table is not None:
        return float("inf")
    return 2.0 * spec.insulation_strain / spec.wire_diameter


def _note_law(
    spec: WireSpec, onsets: Floats, curve: MomentCurve, limit: float
) -> Iterator[QualityNote]:
    """Note a tension, immediate slip, and curvatures at which the insulation may be nonlinear."""
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


@dataclass(frozen=True, slots=True, eq=False)
class BuiltWire:
    """A wire with its strands placed, and with the contacts between them.

    Parameters
    ----------
    spec : row of the wire in its sheet
    section : strands in place
    contacts : friction coefficients and radial force
    axial_strain : of the straight wire under its tension
    notes : what replaces entries of the sheet, and tolerated faults
    """

    spec: WireSpec
    section: CrossSection
    contacts: Contacts
    axial_strain: float
    notes: tuple[QualityNote, ...]

    def compute_curve(self, curvature: Floats) -> MomentCurve:
        """Compute the moments of first loading at curvatures; see `compute_moment_curve`."""
        tension, orientation = self.spec.tension, self.spec.orientation
        wire = self.section, self.contacts
        return compute_moment_curve(*wire, curvature, tension=tension, orientation=orientation)

    @property
    def mass_per_length(self) -> float:
        """Return the mass per length of the sheet, kg/m, or else that of section and densities."""
        if self.spec.mass_per_length is not None:
            return self.spec.mass_per_length
        densities = self.spec.conductor_density, self.spec.insulation_density
        return self.section.mass_per_length(*densities)


def build_wire(spec: WireSpec) -> BuiltWire:
    """Lay out the strands of a wire and give them their materials and contacts.

    Parameters
    ----------
    spec : row of the wire in its sheet

    Returns
    -------
    The wire, with the notes ``defaults_taken``, ``layout_fallback`` (why the layout is not a
    hexagon), ``layout_eccentric`` (the strands are at one side of the bore), ``overlap_tolerated``,
    ``helices_overlap`` and ``tension_yields``.

    Raises
    ------
    ValueError
        If the strands do not fit the bore or each other, as circles or as helices (the message
        states the overlap), the tension strains them beyond their stress table, or a number is out
        of its range.
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
    notes += [*layout_notes, *_note_helices(section, spec)]
    contacts = make_contacts(
        len(section.layers) - int(section.has_core),
        strand=spec.friction_strand,
        insulation=spec.friction_insulation,
        radial_force=spec.radial_force,
    )
    strain = compute_axial_strain(section, spec.tension)  # refuses a negative tension
    find_law_range(spec, strain=strain)  # refuses a tension beyond the stress table
    notes += _note_section(section, spec, strain)
    return BuiltWire(spec, section, contacts, strain, tuple(notes))


def make_layers(spec: WireSpec) -> tuple[Layer, ...]:
    """Return the layers from the axis outwards; a core has no lay angle.

    The stress-strain curve of the strands is the table if there is one, else Ramberg-Osgood.

    Raises
    ------
    ValueError
        If there is not one lay angle per ring and one strand diameter per layer, the table turns
        back or stiffens, or a number is out of its range.
    """
    material: Material = RambergOsgood(spec.conductor_modulus, spec.copper_k, spec.copper_n)
    if spec.stress_table is not None:
        material = StressTable(*spec.stress_table)
    angles = [0.0] * int(spec.layer_counts[0] == 1) + list(spec.lay_angles)
    counts, diameters = spec.layer_counts, spec.strand_diameters
    if not len(angles) == len(counts) == len(diameters):
        raise ValueError(
            format_sentence(
                "mechanics.wire.layers_differ",
                layers=len(counts),
                diameters=len(diameters),
                angles=len(spec.lay_angles),
            )
        )
    return tuple(
        Layer(count, diameter, angle, material, spec.poisson)
        for count, diameter, angle in zip(counts, diameters, angles, strict=True)
    )


def _place_strands(spec: WireSpec) -> tuple[CrossSection, list[QualityNote]]:
    """Lay out the strands; note if the default layout, a hexagon, does not fit."""
    bore, wall = spec.wire_diameter / 2.0 - spec.insulation_thickness, spec.insulation_thickness
    curve, modulus = None, spec.insulation_modulus
    if spec.insulation_table is not None:
        curve = StressTable(*spec.insulation_table)
        modulus = curve.modulus
    tube = Insulation(bore, wall, modulus, spec.insulation_poisson, curve)
    layers = make_layers(spec)
    if spec.layout == "compressed":
        return place_sectors(layers, tube, radii=spec.layer_radii), []
    if spec.layout != AUTO:
        return make_cross_section(layers, tube, kind=cast("LayoutKind", spec.layout)), []
    try:
        return place_hexagon(layers, tube), []
    except ValueError as error:
        section = make_cross_section(layers, tube)
        note = QualityNote.of(
            "mechanics.wire.layout_fallback", spec.place, kind=section.kind, reason=error
        )
    return section, [note]


def _note_section(section: CrossSection, spec: WireSpec, strain: float) -> Iterator[QualityNote]:
    """Note a loose bore, strands at one side of it, overlaps, and strands that yield in tension.

    The model treats the axial stiffness of strands as elastic.
    """
    min_fill = 0.4  # of the bore's area; two strands that touch it fill a half
    max_silent_offset = 0.02  # of the bore's radius
    touch_tolerance = 1e-9  # of the bore's radius
    max_elastic_factor = 1.2  # times the stress of the curve
    bore = spec.wire_diameter / 2.0 - spec.insulation_thickness
    area = section.per_strand(layer.area for layer in section.layers)
    offset = float(np.hypot(section.x @ area, section.y @ area) / area.sum())
    if (fill := float(area.sum()) / (np.pi * bore**2)) < min_fill:
        yield QualityNote.of("mechanics.wire.bore_loose", spec.place, fill=fill, bore=2e3 * bore)
    if section.kind == "packed" and offset > max_silent_offset * bore:
        angles = np.linspace(0.0, np.pi, 180, endpoint=False)
        stiffness = [compute_stick_stiffness(section, orientation=angle) for angle in angles]
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
            allowed=100.0 * MAX_RELATIVE_OVERLAP,
        )
    material = section.layers[0].material
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


def _note_helices(section: CrossSection, spec: WireSpec) -> Iterator[QualityNote]:
    """Note helices that overlap by their lay angle; refuse those that do not fit the bore.

    The section cuts a strand obliquely, which multiplies its area and its width by
    1 / cos(lay angle). Layouts of circles are accurate enough for lay angles up to 20 deg.
    """
    max_silent_overlap = 0.05  # of the strands' diameter
    max_overlap = 0.1  # of the strands' diameter, and of the area
    copper = sum(layer.count * layer.area / np.cos(layer.lay_angle) for layer in section.layers)
    bore = np.pi * (spec.wire_diameter / 2.0 - spec.insulation_thickness) ** 2
    if copper > (1.0 + max_overlap) * bore:
        raise ValueError(
            format_sentence("mechanics.wire.copper_too_large", copper=copper * 1e6, bore=bore * 1e6)
        )
    overlap = 0.0 if section.kind == "compressed" else find_helix_overlap(section)
    if overlap <= max_silent_overlap:
        return
    percent = 100.0 * overlap
    if overlap > max_overlap:
        raise ValueError(
            format_sentence("mechanics.wire.strands_overlap", percent=percent, allowed=max_overlap)
        )
    yield QualityNote.of("mechanics.wire.helices_overlap", spec.place, percent=percent)


def find_law_range(spec: WireSpec, *, strain: float = 0.0) -> tuple[float, tuple[QualityNote, ...]]:
    """Return the curvature up to which the law of a wire is tabulated.

    Parameters
    ----------
    spec : row of the wire in its sheet
    strain : axial, of the straight wire under its tension

    Returns
    -------
    The curvature, 1/m, and notes. It is that of the sheet, or that of a bending radius of five wire
    diameters. It is smaller, with the note ``range_shortened``, if tension and bending strain the
    rim of a strand, or of the insulation, to the last strain of its stress table before.

    Raises
    ------
    ValueError
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
            raise ValueError(
                format_sentence(
                    "mechanics.wire.tension_beyond_table",
                    tension=spec.tension,
                    strain=strain,
                    last=last,
                )
            )
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


DEFAULT_SHARE_RANGE = (0.35, 1.0)
"""Range of the isotropic share of the hardening of annealed copper, if the sheet does not state it.
With less than 0.35, a wire would spring back farther than standards of winding wire allow."""


def set_parameters(spec: WireSpec, values: Mapping[str, float]) -> WireSpec:
    """Return a wire with values of `PARAMETERS` in place of those of its sheet.

    Parameters
    ----------
    spec : of the calibrated wire, or another of the same type
    values : by name of `PARAMETERS`, SI units; where one is missing or NaN, the sheet's value
        remains. The copper scale is a factor on the strength of the sheet

    Returns
    -------
    The wire. Its friction coefficients are those of the sheet; the value of `RADIAL_FRICTION`
    sets its radial force.
    """
    finite_values = {name: value for name, value in values.items() if np.isfinite(value)}
    friction = spec.friction_strand + spec.friction_insulation
    modulus, table = finite_values.get(INSULATION_MODULUS), spec.insulation_table
    if modulus is not None and table is not None:  # its curve scales with its modulus
        strains, stresses = table
        scale = modulus / (stresses[0] / strains[0])
        spec = replace(
            spec, insulation_table=(strains, tuple(scale * stress for stress in stresses))
        )
    return replace(
        spec,
        radial_force=finite_values[RADIAL_FRICTION] / friction
        if RADIAL_FRICTION in finite_values
        else spec.radial_force,
        insulation_modulus=finite_values.get(INSULATION_MODULUS, spec.insulation_modulus),
        copper_k=spec.copper_k * finite_values.get(COPPER_SCALE, 1.0),
    )


def make_strand_slider(section: CrossSection, law: SliderLaw, factor: float = 1.0) -> GrowingSlider:
    """Make the growing slider of fully isotropic strands that bend about their own axes.

    Parameters
    ----------
    section : with the materials of its strands
    law : of the wire; the slider has its corners
    factor : on the moments of the strands, as from `find_chord_factor`
    """
    corners = np.append(law.slip_curvatures, law.last)
    curvature, moment = continue_strands(section, corners)
    return make_growing_slider(curvature, factor * moment, 1.0)


def find_chord_factor(law: SliderLaw, table: WireTable) -> float:
    """Return the ratio of the first slope of a fitted law to the first chord of its table."""
    corners = np.concatenate([[0.0], law.slip_curvatures, [law.last]])
    moment = np.interp(corners, table.curvature, table.moment)
    return law.first_stiffness / float(compute_falling_slopes(corners, moment)[0])


def compute_falling_slopes(curvature: Floats, moment: Floats) -> Floats:
    """Return the slopes of the chords between corners, made non-increasing.

    Where the law stiffens, the slopes are those of its concave hull, as in `fit_sliders`.
    """
    hull = find_hull(curvature, moment, min_slope_drop=0.0)
    bridged = np.interp(curvature, curvature[hull], moment[hull])
    return np.asarray(np.diff(bridged) / np.diff(curvature))
