"""The grammar of a wire sheet: a row per wire, a column per dimension, its unit in its name."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BeforeValidator, model_validator
from pydantic_core import CoreSchema, core_schema

from labpipe.errors import Fault
from labpipe.protocol.grammar import Block
from labpipe.protocol.values import NUMBER, WINDOWS_DEVICE_NAME, suggest_number
from labpipe.protocol.yaml_text import FaultsError, Values, build_choice_fault, refused
from labpipe.records.wire import WireSpec

Numbers = tuple[float, ...]
Curve = tuple[Numbers, Numbers]
"""Strains and stresses, Pa."""
_UNITS = {
    "mm": ("_mm", 1e-3),
    "mm^2": ("_mm2", 1e-6),
    "deg": ("_deg", math.pi / 180.0),
    "MPa": ("_mpa", 1e6),
    "GPa": ("_gpa", 1e9),
    "N": ("_n", 1.0),
    "1/m": ("_per_m", 1.0),
    "g/m": ("_g_per_m", 1e-3),
    "kg/m^3": ("_kg_per_m3", 1.0),
    "": ("", 1.0),
}
"""How the name of a column ends, and the factor to SI, by the unit."""
_NOT_IN_NAMES = re.compile(r'[\\/:*?"<>|\x00-\x1f]|^[. ]|[. ]$')


@dataclass(frozen=True, slots=True)
class Column:
    """Annotation of a number whose unit is part of the column's name, or of several by ``;``.

    Parameters
    ----------
    unit : as shown to people; empty for a pure number
    minimum, maximum : in that unit; they are wider than any wire needs: outside is only a wrong
        unit or a slip of the hand, and no number inside is too large to work with
    several : whether a cell holds a list
    is_integer : whether only whole numbers are allowed
    period : after which numbers mean the same again, such as 360 deg
    """

    unit: str
    minimum: float
    maximum: float
    several: bool = False
    is_integer: bool = False
    period: float = math.inf

    @property
    def factor(self) -> float:
        """Return the factor from the unit to SI."""
        return _UNITS[self.unit][1]

    @property
    def allowed(self) -> str:
        """Return what a cell may hold, such as ``a number from 0.05 to 200 mm``."""
        noun = f"{'whole ' * self.is_integer}number"
        noun, parted = (f"{noun}s", ", separated by ';'") if self.several else (f"a {noun}", "")
        return (
            f"{noun} from {self.minimum:.10g} to {self.maximum:.10g} {self.unit}".rstrip() + parted
        )

    def parse(self, text: object) -> float | Numbers:
        """Read the number, or the numbers, of a cell; they stay in the unit of the column.

        Raises
        ------
        FaultsError
            If one of them is no number with a decimal point, or out of range.
        """
        cell = str(text)
        if not cell:
            raise FaultsError(Fault.of("protocol.blank_number", allowed=self.allowed))
        parts = [part.strip() for part in cell.split(";")] if self.several else [cell]
        numbers = tuple(self._number(part, cell) for part in parts)
        return numbers if self.several else numbers[0]

    def _number(self, part: str, cell: str) -> float:
        fits = re.fullmatch(NUMBER, part) and self.minimum <= float(part) <= self.maximum
        if not fits or (self.is_integer and float(part) % 1.0):
            remedy = suggest_number(part) or "Correct the cell; is the unit right?"
            if self.several and "," in part and ";" not in cell:
                remedy = f"Separate numbers by ';': {part.replace(',', ';')}."
            raise refused("protocol.no_number", found=cell, allowed=self.allowed, remedy=remedy)
        value = math.fmod(float(part), self.period)
        return int(value) if self.is_integer else value

    def to_si(self, value: float) -> float:
        """Turn a number of the column into SI; twelve digits, so that 1.4 mm is 0.0014 m."""
        return value if self.is_integer else float(f"{value * self.factor:.12g}")

    def __get_pydantic_core_schema__(self, _source: object, _handler: object) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.parse)


def _name(value: object) -> str:
    """Take a name that a file can have, too."""
    max_length = 100
    name = str(value)
    if not name:
        raise FaultsError(Fault.of("protocol.blank_name"))
    if _NOT_IN_NAMES.search(name) or WINDOWS_DEVICE_NAME.fullmatch(name) or len(name) > max_length:
        raise refused("protocol.no_wire_name", found=value, most=max_length)
    return name


class WireRow(Block):
    """A wire as people describe it; numbers in the units of the columns."""

    wire: Annotated[str, BeforeValidator(_name)]
    wire_diameter_mm: Annotated[float, Column("mm", 0.05, 200.0)]
    strands: Annotated[int, Column("", 1, 2000, is_integer=True)]
    insulation_thickness_mm: Annotated[float, Column("mm", 0.001, 100.0)]
    lay_angles_deg: Annotated[Numbers, Column("deg", -80.0, 80.0, several=True)] = ()
    conductor_area_mm2: Annotated[float | None, Column("mm^2", 1e-5, 4e4)] = None
    strand_diameter_mm: Annotated[float | None, Column("mm", 0.005, 50.0)] = None
    strand_diameters_mm: Annotated[Numbers, Column("mm", 0.005, 50.0, several=True)] = ()
    layer_counts: Annotated[
        tuple[int, ...], Column("", 1, 2000, several=True, is_integer=True)
    ] = ()
    layer_radii_mm: Annotated[Numbers, Column("mm", 0.0, 100.0, several=True)] = ()
    insulation_modulus_mpa: Annotated[float | None, Column("MPa", 0.1, 1e7)] = None
    conductor_modulus_gpa: Annotated[float | None, Column("GPa", 0.1, 1000.0)] = None
    poisson: Annotated[float | None, Column("", -0.99, 0.5)] = None
    insulation_poisson: Annotated[float | None, Column("", -0.99, 0.5)] = None
    insulation_strain: Annotated[float | None, Column("", 1e-4, 1.0)] = None
    copper_k_mpa: Annotated[float | None, Column("MPa", 1.0, 1e4)] = None
    copper_n: Annotated[float | None, Column("", 0.01, 0.99)] = None
    friction_strand: Annotated[float | None, Column("", 0.0, 10.0)] = None
    friction_insulation: Annotated[float | None, Column("", 0.0, 10.0)] = None
    radial_force_n: Annotated[float | None, Column("N", 0.0, 1e6)] = None
    mass_per_length_g_per_m: Annotated[float | None, Column("g/m", 1e-3, 1e5)] = None
    conductor_density_kg_per_m3: Annotated[float | None, Column("kg/m^3", 100.0, 3e4)] = None
    insulation_density_kg_per_m3: Annotated[float | None, Column("kg/m^3", 10.0, 2e4)] = None
    length_mm: Annotated[float | None, Column("mm", 1.0, 1e5)] = None
    tension_n: Annotated[float | None, Column("N", 0.0, 1e7)] = None
    orientation_deg: Annotated[float | None, Column("deg", -3600.0, 3600.0, period=360.0)] = None
    largest_curvature_per_m: Annotated[float | None, Column("1/m", 0.001, 1e5)] = None
    layout: Annotated[
        Literal["auto", "hexagonal", "concentric", "packed", "compressed"],
        BeforeValidator(lambda text: str(text).casefold()),
    ] = "auto"
    stress_table: str = ""
    insulation_table: str = ""
    remark: str = ""

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Refuse stress tables together with the numbers that they replace."""
        for table, numbers in _NUMBERS_OF.items():
            stated = [name for name in numbers if data.get(name)]
            if data.get(table) and stated:
                yield Fault.of("protocol.table_and_numbers", (table,), found=", ".join(stated))

    @model_validator(mode="before")
    @classmethod
    def _without_blanks(cls, data: Mapping[str, str]) -> dict[str, str]:
        """Take a blank cell for a column that is not there, unless it is needed."""
        return {key: text for key, text in data.items() if text or key in NEEDED}

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if faults := [*_layer_faults(self)] or [*_room_faults(self)] or [*_mass_faults(self)]:
            raise FaultsError(*faults)
        return self

    @property
    def has_mass(self) -> bool:
        """Return whether the sheet says what the wire weighs."""
        return self.mass_per_length_g_per_m is not None

    @property
    def counts(self) -> tuple[int, ...]:
        """Return the strands of each layer, the core included."""
        rings = range(1, len(self.lay_angles_deg) + 1)
        return self.layer_counts or (1, *(6 * ring for ring in rings))

    @property
    def diameters(self) -> Numbers:
        """Return the strand diameter of each layer, mm."""
        if self.strand_diameters_mm:
            return self.strand_diameters_mm
        area = self.conductor_area_mm2 or 0.0
        one = self.strand_diameter_mm or math.sqrt(4.0 * area / (math.pi * sum(self.counts)))
        return (one,) * len(self.counts)

    @property
    def copper(self) -> float:
        """Return the area of all strands, mm^2."""
        pairs = zip(self.counts, self.diameters, strict=True)
        return float(sum(count * math.pi * diameter**2 / 4.0 for count, diameter in pairs))


COLUMNS: Final[Mapping[str, Column]] = {
    name: column
    for name, field in WireRow.model_fields.items()
    for column in field.metadata
    if isinstance(column, Column)
}
"""The columns of numbers."""
NEEDED: Final = tuple(n for n, field in WireRow.model_fields.items() if field.is_required())
"""Columns in which no cell may be blank."""
SIZES: Final = ("strand_diameter_mm", "strand_diameters_mm", "conductor_area_mm2")
"""Columns of which every sheet has at least one."""
_OF_THE_CURVE = ("conductor_modulus_gpa", "copper_k_mpa", "copper_n")
_OF_THE_WALL = ("insulation_modulus_mpa", "insulation_strain")
_NUMBERS_OF = {"stress_table": _OF_THE_CURVE, "insulation_table": _OF_THE_WALL}
"""Columns that each stress table replaces."""
_DENSITIES = ("conductor_density_kg_per_m3", "insulation_density_kg_per_m3")
_ALWAYS_THERE = (*NEEDED, "lay_angles_deg")
MAX_AREA_DEVIATION = 0.02
"""Share by which a conductor area may differ from that of the strands' diameters."""
BORE_ROUNDING = 1e-3
"""Share of the bore."""
MAX_MASS_RATIO = 4.0 / 3.0
"""Ratio by which a mass may differ from that of strands and wall: fillers, tin, a gap."""


def _layer_faults(row: WireRow) -> Iterator[Fault]:
    """Find what does not agree among strands, layers and angles."""
    counts = row.counts
    total, rings = sum(counts), len(counts) - int(counts[0] == 1)
    parts = " + ".join(map(str, counts))
    if total != row.strands:
        by = "layer counts" if row.layer_counts else "lay angles"
        yield Fault.of("protocol.strands", ("strands",), row=row, total=total, by=by, parts=parts)
        return
    if (angles := len(row.lay_angles_deg)) != rings:
        path = ("lay_angles_deg",)
        yield Fault.of("protocol.lay_angles", path, parts=parts, rings=rings, found=angles)
    yield from _size_faults(row)
    radii = row.layer_radii_mm
    if radii and row.layout != "compressed":
        yield Fault.of("protocol.radii_of_layout", ("layer_radii_mm",), row=row)
    elif radii and (len(radii) != len(counts) or any(a >= b for a, b in pairwise(radii))):
        found = ";".join(f"{radius:g}" for radius in radii)
        yield Fault.of("protocol.radii", ("layer_radii_mm",), layers=len(counts), found=found)


def _size_faults(row: WireRow) -> Iterator[Fault]:
    """Find diameters and an area of the strands that do not agree."""
    one, several, area = row.strand_diameter_mm, row.strand_diameters_mm, row.conductor_area_mm2
    layers = len(row.counts)
    if one and several:
        yield Fault.of("protocol.two_diameters", ("strand_diameters_mm",))
    elif several and len(several) != layers:
        path = ("strand_diameters_mm",)
        yield Fault.of("protocol.diameters", path, layers=layers, found=len(several))
    elif not (one or several or area):
        yield Fault.of("protocol.no_size", ("strand_diameter_mm",))
    elif area and abs(area / row.copper - 1.0) > MAX_AREA_DEVIATION:
        yield Fault.of("protocol.area", ("conductor_area_mm2",), row=row, most=MAX_AREA_DEVIATION)


def _room_faults(row: WireRow) -> Iterator[Fault]:
    """Find strands that cannot be in the bore, and a bend tighter than the wire."""
    bore = row.wire_diameter_mm - 2.0 * row.insulation_thickness_mm
    if bore <= 0.0:
        yield Fault.of("protocol.no_bore", ("insulation_thickness_mm",), row=row)
        return
    size = next(name for name in SIZES if getattr(row, name))
    widest, tightest = bore * (1.0 + BORE_ROUNDING), 2e3 / row.wire_diameter_mm
    if max(row.diameters) > widest:
        thickest = max(row.diameters)
        yield Fault.of("protocol.thick_strand", (size,), row=row, bore=bore, found=thickest)
    elif row.copper > math.pi / 4.0 * widest**2:
        space = math.pi / 4.0 * bore**2
        yield Fault.of("protocol.much_copper", (size,), row=row, bore=bore, space=space)
    largest = row.largest_curvature_per_m
    if largest is not None and largest >= tightest:
        path = ("largest_curvature_per_m",)
        yield Fault.of("protocol.tight_bend", path, tightest=tightest, found=largest)


def _mass_faults(row: WireRow) -> Iterator[Fault]:
    """Find a mass that cannot be that of the strands and the wall."""
    stated = row.mass_per_length_g_per_m
    if stated is None:
        return
    angles = (0.0,) * int(row.counts[0] == 1) + row.lay_angles_deg
    layers = zip(row.counts, row.diameters, angles, strict=True)
    strands = sum(n * d**2 / math.cos(math.radians(angle)) for n, d, angle in layers)
    outer, bore = row.wire_diameter_mm, row.wire_diameter_mm - 2.0 * row.insulation_thickness_mm
    conductor = _density(row.conductor_density_kg_per_m3, "conductor_density")
    insulation = _density(row.insulation_density_kg_per_m3, "insulation_density")
    mass = 1e-3 * math.pi / 4.0 * (conductor * strands + insulation * (outer**2 - bore**2))
    if not 1.0 / MAX_MASS_RATIO <= stated / mass <= MAX_MASS_RATIO:
        path = ("mass_per_length_g_per_m",)
        densities = {"conductor": conductor, "insulation": insulation}
        yield Fault.of("protocol.mass", path, row=row, mass=mass, densities=densities)


def _density(stated: float | None, field: str) -> float:
    return _SPEC_DEFAULTS[field] if stated is None else stated


def build_wire_spec(
    row: WireRow,
    blank: Collection[str],
    place: str,
    curve: Curve | None,
    insulation: Curve | None = None,
) -> WireSpec:
    """Make the record of a row, with words for what it leaves open.

    Parameters
    ----------
    row : of the sheet
    blank : columns that are there and blank in this row: perhaps a slip, unlike one left out
    place : of the row, such as ``sheet 'wires', row 4``
    curve, insulation : the stress tables that the row names

    Returns
    -------
    The wire in SI.
    """
    values: dict[str, Any] = {"layer_counts": row.counts, "stress_table": curve}
    values["insulation_table"] = insulation
    values["strand_diameters"] = tuple(map(COLUMNS["strand_diameter_mm"].to_si, row.diameters))
    for name, column in COLUMNS.items():
        value = getattr(row, name)
        if isinstance(value, float) and name not in SIZES:
            values[get_spec_field(name)] = column.to_si(value)
    for name in ("lay_angles_deg", *(["layer_radii_mm"] if row.layer_radii_mm else [])):
        values[get_spec_field(name)] = tuple(map(COLUMNS[name].to_si, getattr(row, name)))
    if "layout" in row.model_fields_set:
        values["layout"] = row.layout
    needless = {*(_OF_THE_CURVE if curve else ()), *(_OF_THE_WALL if insulation else ())}
    needless |= {*(_DENSITIES if row.has_mass else ())}
    defaults = {
        get_spec_field(name): describe_default(name) + " (blank in this row)" * (name in blank)
        for name in WireRow.model_fields
        if name not in needless
        and get_spec_field(name) not in values
        and (get_spec_field(name) in _SPEC_DEFAULTS or name == "largest_curvature_per_m")
    }
    return WireSpec(name=row.wire, **values, defaults=defaults, place=place)


_SPEC_DEFAULTS: Final[Mapping[str, Any]] = {
    spec_field.name: spec_field.default
    for spec_field in fields(WireSpec)
    if isinstance(spec_field.default, str | float)
}


def get_spec_field(name: str) -> str:
    """Return the field of `WireSpec` that a column fills: its name without the unit."""
    return name.removesuffix(_UNITS[COLUMNS[name].unit][0]) if name in COLUMNS else name


def describe_default(name: str) -> str:
    """Return the value used if a column is blank, such as ``tension 0 N``.

    Parameters
    ----------
    name : of a column whose field of `WireSpec` has a default
    """
    field = get_spec_field(name)
    if field == "largest_curvature":
        return "largest curvature at a bending radius of five wire diameters"
    value, column = _SPEC_DEFAULTS[field], COLUMNS.get(name)
    value_text = f"{value}" if column is None else f"{value / column.factor:.6g} {column.unit}"
    return f"{field.replace('_', ' ')} {value_text}".rstrip()


def normalise_heading(heading: str) -> str:
    """Return the column name of a heading: in small letters, blanks as underscores."""
    return re.sub(r"[\s-]+", "_", heading.casefold())


def find_heading_faults(headings: Sequence[str]) -> Iterator[tuple[int, Fault]]:
    """Find unknown, repeated and missing columns of a wire sheet.

    Parameters
    ----------
    headings : of its columns

    Yields
    ------
    The number of the column, counted from 0, and what is wrong with it.
    """
    names = [normalise_heading(heading) for heading in headings]
    intended = set(names)
    for number, name in enumerate(names):
        if name not in WireRow.model_fields:
            meant = next((x for x in COLUMNS if _is_in_another_unit(name, x)), "")
            intended |= {meant, *difflib.get_close_matches(name, WireRow.model_fields, n=1)}
            fault = build_choice_fault(
                (), headings[number], WireRow.model_fields, "one of the columns"
            )
            remedy = f"Give it in {COLUMNS[meant].unit} as {meant!r}." if meant else fault.remedy
            yield number, replace(fault, remedy=remedy)
        elif name in names[:number]:
            yield number, Fault.of("protocol.column_again", column=name)
    for name in _ALWAYS_THERE:
        if name not in intended:
            yield 0, Fault.of("protocol.no_column", column=name)
    if not intended & set(SIZES):
        yield 0, Fault.of("protocol.no_column", column="' or '".join(SIZES))


def _is_in_another_unit(name: str, column: str) -> bool:
    """Recognise wire_diameter_in, or wire_diameter alone, for wire_diameter_mm."""
    stem = get_spec_field(column)
    rest = name.removeprefix(stem)
    return stem != column and rest != name and bool(re.fullmatch(r"(_per)?(_[a-z0-9]{1,8})?", rest))


FIRST_SLOPES = {"stress_table": (1e9, 1e12), "insulation_table": (1e5, 1e10)}
"""Slopes (Pa) between which the first one is, of strands and insulation by the column that names
the table: a wrong unit of strain or stress is outside."""


class StressPoint(Block):
    """One point of a measured stress-strain curve."""

    strain: Annotated[float, Column("", 0.0, 0.6)]
    stress_mpa: Annotated[float, Column("MPa", 0.0, 1e5)]


def find_curve_fault(points: Sequence[StressPoint], column: str) -> tuple[int, Fault] | None:
    """Find the first point that makes no curve: strains grow, stresses never fall, nor stiffen.

    Parameters
    ----------
    points : in the order of the table; one at zero may come first
    column : of the wire sheet that names the table

    Returns
    -------
    Number of the point, counted from 0, and what is wrong with it.
    """
    last, first_slope = (0.0, 0.0), 0.0
    for number, point in enumerate(points):
        here = (point.strain, point.stress_mpa)
        if number == 0 and not any(here):
            continue
        if wrong := _step_fault(last, here, first_slope):
            return number, wrong
        first_slope = first_slope or (here[1] - last[1]) / (here[0] - last[0])
        last = here
    low, high = FIRST_SLOPES[column]
    if not first_slope:
        return 0, Fault.of("protocol.no_curve")
    if low <= first_slope * 1e6 <= high:
        return None
    first = next(number for number, point in enumerate(points) if point.strain)
    return first, Fault.of(
        "protocol.first_slope", low=low / 1e9, high=high / 1e9, found=first_slope / 1e3
    )


def _step_fault(
    last: tuple[float, float], here: tuple[float, float], first_slope: float
) -> Fault | None:
    """What is wrong with a point behind another one, both of strain and stress in MPa."""
    rounding = 1e-6  # of the first slope
    step, rise = here[0] - last[0], here[1] - last[1]
    if step <= 0.0:
        return Fault.of("protocol.strain_falls", last=last[0], found=here[0])
    if rise < 0.0 or not (rise or first_slope):
        return Fault.of("protocol.stress_falls", last=last[1], found=here[1])
    if first_slope and rise / step > first_slope * (1.0 + rounding):
        found = rise / step / 1e3
        return Fault.of("protocol.curve_stiffens", first=first_slope / 1e3, found=found)
    return None


def convert_points(points: Sequence[StressPoint]) -> Curve:
    """Strains and stresses (Pa) beyond zero."""
    stress = StressPoint.model_fields["stress_mpa"].metadata[0].to_si
    beyond = [point for point in points if point.strain > 0.0]
    return tuple(point.strain for point in beyond), tuple(
        stress(point.stress_mpa) for point in beyond
    )
