"""Define the rows of wire sheets and stress tables: columns with ranges, and checks of each row.

Each row of a wire sheet describes a wire. The name of a column of numbers ends in its unit.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, model_validator
from pydantic_core import CoreSchema, core_schema

from labpipe.errors import Fault
from labpipe.protocol.grammar import NUMBER_PATTERN, WINDOWS_DEVICE_NAME, Block, suggest_number
from labpipe.protocol.yaml_text import FaultsError, build_choice_fault, build_refusal
from labpipe.records.wire import WireSpec

Numbers = tuple[float, ...]
Curve = tuple[Numbers, Numbers]
"""Strains and stresses (Pa) of a stress-strain curve."""
_COLUMN_UNITS = {
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
"""Suffix of the column name and factor to SI, keyed by unit."""
_FORBIDDEN_IN_NAME = re.compile(r'[\\/:*?"<>|\x00-\x1f]|^[. ]|[. ]$')
"""Part of a wire's name that is not allowed in names of files."""


@dataclass(frozen=True, slots=True)
class Column:
    """Annotation of a column of numbers, or of lists of numbers separated by ``;``.

    Parameters
    ----------
    unit : unit in messages; empty for a pure number
    minimum, maximum : valid range in `unit`; only a wrong unit or a typing error is outside
    is_list : whether a cell has a list of numbers
    is_integer : whether only whole numbers are valid
    period : period of an angle, such as 360, in `unit`; whole periods are removed from a value
    """

    unit: str
    minimum: float
    maximum: float
    is_list: bool = False
    is_integer: bool = False
    period: float = math.inf

    @property
    def factor(self) -> float:
        """Return the factor from the unit to SI."""
        return _COLUMN_UNITS[self.unit][1]

    @property
    def valid_content(self) -> str:
        """Return the valid content of a cell, such as ``a number from 0.05 to 200 mm``."""
        noun = "whole number" if self.is_integer else "number"
        noun = f"{noun}s" if self.is_list else f"a {noun}"
        text = f"{noun} from {self.minimum:.10g} to {self.maximum:.10g} {self.unit}".rstrip()
        return f"{text}, separated by ';'" if self.is_list else text

    def parse(self, content: object) -> float | Numbers:
        """Parse the number or list of a cell; values stay in the unit of the column.

        Parameters
        ----------
        content : content of the cell

        Raises
        ------
        FaultsError
            If the cell is blank, or has anything but valid numbers.
        """
        cell = str(content)
        if not cell:
            raise FaultsError(Fault.of("protocol.blank_number", allowed=self.valid_content))
        texts = [text.strip() for text in cell.split(";")] if self.is_list else [cell]
        numbers = tuple(self._parse_number(text, cell) for text in texts)
        return numbers if self.is_list else numbers[0]

    def _parse_number(self, text: str, cell: str) -> float:
        """Parse one number of a cell; `cell` is its whole text, for messages."""
        is_valid = (
            re.fullmatch(NUMBER_PATTERN, text) and self.minimum <= float(text) <= self.maximum
        )
        if not is_valid or (self.is_integer and float(text) % 1.0):
            remedy = suggest_number(text) or "Correct the cell; is the unit right?"
            if self.is_list and "," in text and ";" not in cell:
                remedy = f"Separate numbers by ';': {text.replace(',', ';')}."
            content = self.valid_content
            raise build_refusal("protocol.no_number", found=cell, allowed=content, remedy=remedy)
        value = math.fmod(float(text), self.period)
        return int(value) if self.is_integer else value

    def convert_to_si(self, value: Any) -> Any:
        """Convert a number or a list to SI, to 12 digits, so that 1.4 mm is exactly 0.0014 m."""
        if isinstance(value, tuple):
            return tuple(map(self.convert_to_si, value))
        return value if self.is_integer else float(f"{value * self.factor:.12g}")

    def __get_pydantic_core_schema__(self, _source: object, _handler: object) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.parse)


def _parse_name(value: object) -> str:
    """Parse the name of a wire; it must be a valid part of a file name."""
    name, max_length = str(value), 100
    if not name:
        raise FaultsError(Fault.of("protocol.blank_name"))
    is_forbidden = _FORBIDDEN_IN_NAME.search(name) or WINDOWS_DEVICE_NAME.fullmatch(name)
    if is_forbidden or len(name) > max_length:
        raise build_refusal("protocol.no_wire_name", found=value, limit=max_length)
    return name


class WireRow(Block):
    """Row of a wire sheet; numbers are in the units of the columns."""

    wire: Annotated[str, BeforeValidator(_parse_name)]
    wire_diameter_mm: Annotated[float, Column("mm", 0.05, 200.0)]
    strands: Annotated[int, Column("", 1, 2000, is_integer=True)]
    insulation_thickness_mm: Annotated[float, Column("mm", 0.001, 100.0)]
    lay_angles_deg: Annotated[Numbers, Column("deg", -80.0, 80.0, is_list=True)] = ()
    conductor_area_mm2: Annotated[float | None, Column("mm^2", 1e-5, 4e4)] = None
    strand_diameter_mm: Annotated[float | None, Column("mm", 0.005, 50.0)] = None
    strand_diameters_mm: Annotated[Numbers, Column("mm", 0.005, 50.0, is_list=True)] = ()
    layer_counts: Annotated[
        tuple[int, ...], Column("", 1, 2000, is_list=True, is_integer=True)
    ] = ()
    layer_radii_mm: Annotated[Numbers, Column("mm", 0.0, 100.0, is_list=True)] = ()
    insulation_modulus_mpa: Annotated[float | None, Column("MPa", 0.1, 1e7)] = None
    conductor_modulus_gpa: Annotated[float | None, Column("GPa", 0.1, 1000.0)] = None
    poisson: Annotated[float | None, Column("", -0.99, 0.5)] = None
    insulation_poisson: Annotated[float | None, Column("", -0.99, 0.5)] = None
    insulation_strain: Annotated[float | None, Column("", 1e-4, 1.0)] = None
    copper_k_mpa: Annotated[float | None, Column("MPa", 1.0, 1e4)] = None
    copper_n: Annotated[float | None, Column("", 0.01, 0.99)] = None
    isotropic_share: Annotated[float | None, Column("", 0.0, 1.0)] = None
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

    def find_key_faults(self) -> Iterator[Fault]:
        """Find stress tables together with the numbers that they replace."""
        for table, columns in _REPLACED_COLUMNS.items():
            filled_columns = ", ".join(name for name in columns if name in self.model_fields_set)
            if getattr(self, table) and filled_columns:
                yield Fault.of("protocol.table_and_numbers", (table,), found=filled_columns)

    def find_value_faults(self) -> list[Fault]:
        """Find contradictions between cells; each check requires that the previous ones passed."""
        for check in (_find_layer_faults, _find_bore_faults, _find_mass_faults):
            if faults := [*check(self)]:
                return faults
        return []

    @model_validator(mode="before")
    @classmethod
    def _remove_blanks(cls, data: Mapping[str, str]) -> dict[str, str]:
        """Remove blank cells, so that defaults apply; blank cells of required columns remain."""
        return {name: text for name, text in data.items() if text or name in REQUIRED_CELLS}

    @property
    def bore(self) -> float:
        """Return the inner diameter of the insulation, mm."""
        return self.wire_diameter_mm - 2.0 * self.insulation_thickness_mm

    @property
    def strands_per_layer(self) -> tuple[int, ...]:
        """Return the number of strands of each layer, the core first; 1, 6, 12 ... by default."""
        return self.layer_counts or (1, *range(6, 6 * len(self.lay_angles_deg) + 1, 6))

    @property
    def strand_diameters(self) -> Numbers:
        """Return the strand diameter of each layer, mm; by default it follows from the area."""
        if self.strand_diameters_mm:
            return self.strand_diameters_mm
        strand_area = (self.conductor_area_mm2 or 0.0) / sum(self.strands_per_layer)
        diameter = self.strand_diameter_mm or math.sqrt(4.0 * strand_area / math.pi)
        return (diameter,) * len(self.strands_per_layer)

    @property
    def copper_area(self) -> float:
        """Return the cross-sectional area of all strands, mm^2."""
        layers = zip(self.strands_per_layer, self.strand_diameters, strict=True)
        return float(sum(count * math.pi * diameter**2 / 4.0 for count, diameter in layers))


WIRE_COLUMNS: Final[Mapping[str, Column]] = {
    name: column
    for name, field in WireRow.model_fields.items()
    for column in field.metadata
    if isinstance(column, Column)
}
"""Annotation of each column of numbers, keyed by the name of the column."""
REQUIRED_CELLS: Final = tuple(x for x, field in WireRow.model_fields.items() if field.is_required())
"""Names of the columns in which no cell may be blank."""
STRAND_SIZE_COLUMNS: Final = ("strand_diameter_mm", "strand_diameters_mm", "conductor_area_mm2")
"""Names of the columns for the size of the strands; every sheet has at least one of them."""
_REPLACED_COLUMNS = {
    "stress_table": ("conductor_modulus_gpa", "copper_k_mpa", "copper_n"),
    "insulation_table": ("insulation_modulus_mpa", "insulation_strain"),
}
"""Names of the columns that a stress table replaces, keyed by the column that names the table."""
_DENSITY_COLUMNS = ("conductor_density_kg_per_m3", "insulation_density_kg_per_m3")
_REQUIRED_COLUMNS = (*REQUIRED_CELLS, "lay_angles_deg")
MAX_AREA_DEVIATION = 0.02
"""Largest relative deviation of the conductor area from that of the strand diameters."""
MAX_MASS_RATIO = 4.0 / 3.0
"""Largest ratio between the stated mass and that of strands and insulation, either way; fillers,
tin and gaps explain smaller ones."""


def _find_layer_faults(row: WireRow) -> Iterator[Fault]:
    """Find contradictions between strands, layers, lay angles, radii and sizes."""
    counts, radii = row.strands_per_layer, row.layer_radii_mm
    n_strands, n_layers, terms = sum(counts), len(counts), " + ".join(map(str, counts))
    if n_strands != row.strands:
        source, path = "layer counts" if row.layer_counts else "lay angles", ("strands",)
        yield Fault.of("protocol.strands", path, row=row, total=n_strands, by=source, parts=terms)
        return
    # A core of one strand has no lay angle; all other layers are rings.
    n_rings, n_angles = n_layers - int(counts[0] == 1), len(row.lay_angles_deg)
    if n_angles != n_rings:
        path = ("lay_angles_deg",)
        yield Fault.of("protocol.lay_angles", path, parts=terms, rings=n_rings, found=n_angles)
    are_increasing = all(inner < outer for inner, outer in pairwise(radii))
    if radii and row.layout != "compressed":
        yield Fault.of("protocol.radii_of_layout", ("layer_radii_mm",), row=row)
    elif radii and not (len(radii) == n_layers and are_increasing):
        radius_texts = ";".join(f"{radius:g}" for radius in radii)
        yield Fault.of("protocol.radii", ("layer_radii_mm",), layers=n_layers, found=radius_texts)
    yield from _find_size_faults(row)


def _find_size_faults(row: WireRow) -> Iterator[Fault]:
    """Find missing and contradictory diameters and areas of the strands."""
    diameter, diameters, area = (getattr(row, name) for name in STRAND_SIZE_COLUMNS)
    path, n_layers = ("strand_diameters_mm",), len(row.strands_per_layer)
    if diameter and diameters:
        yield Fault.of("protocol.two_diameters", path)
    elif diameters and len(diameters) != n_layers:
        yield Fault.of("protocol.strand_diameters", path, layers=n_layers, found=len(diameters))
    elif not (diameter or diameters or area):
        yield Fault.of("protocol.no_size", ("strand_diameter_mm",))
    elif area and abs(area / row.copper_area - 1.0) > MAX_AREA_DEVIATION:
        yield Fault.of(
            "protocol.area", ("conductor_area_mm2",), row=row, tolerance=MAX_AREA_DEVIATION
        )


def _find_bore_faults(row: WireRow) -> Iterator[Fault]:
    """Find insulation that leaves no bore, and bend radii that do not exceed the wire's radius."""
    if row.bore <= 0.0:
        yield Fault.of("protocol.no_bore", ("insulation_thickness_mm",), row=row)
    # The curvature, 1/m, at which the bend radius equals the radius of the wire.
    max_curvature, curvature = 2e3 / row.wire_diameter_mm, row.largest_curvature_per_m
    if curvature is not None and curvature >= max_curvature:
        path = ("largest_curvature_per_m",)
        yield Fault.of("protocol.tight_bend", path, tightest=max_curvature, found=curvature)


def _find_mass_faults(row: WireRow) -> Iterator[Fault]:
    """Find a mass per length that differs too much from that of strands and insulation."""
    angles = (0.0,) * int(row.strands_per_layer[0] == 1) + row.lay_angles_deg
    layers = zip(row.strands_per_layer, row.strand_diameters, angles, strict=True)
    # Squares of diameters, mm^2: the areas in the cross-section, times 4 / pi.
    squares = {
        "conductor": sum(n * d**2 / math.cos(math.radians(angle)) for n, d, angle in layers),
        "insulation": row.wire_diameter_mm**2 - row.bore**2,
    }
    densities = {
        name: getattr(row, f"{name}_density_kg_per_m3") or _SPEC_DEFAULTS[f"{name}_density"]
        for name in squares
    }
    expected_mass = 1e-3 * math.pi / 4.0 * sum(densities[name] * squares[name] for name in squares)
    stated_mass = row.mass_per_length_g_per_m or expected_mass
    if not 1.0 / MAX_MASS_RATIO <= stated_mass / expected_mass <= MAX_MASS_RATIO:
        path = ("mass_per_length_g_per_m",)
        yield Fault.of("protocol.mass", path, row=row, mass=expected_mass, densities=densities)


def build_wire_spec(
    row: WireRow,
    blank_columns: Collection[str],
    place: str,
    conductor_curve: Curve | None,
    insulation_curve: Curve | None = None,
) -> WireSpec:
    """Convert a row of a wire sheet to a record in SI.

    Parameters
    ----------
    row : row of the wire sheet
    blank_columns : names of the columns whose cell in this row is blank
    place : place of the row in messages, such as ``sheet 'wires', row 4``
    conductor_curve, insulation_curve : stress-strain curves of the tables that the row names; None
        if it names none

    Returns
    -------
    The specification of the wire. Its `defaults` describe each default value, and mention blank
    cells, because these may be an oversight.
    """
    cells = {name: getattr(row, name) for name in WIRE_COLUMNS.keys() & row.model_fields_set}
    cells |= {"lay_angles_deg": row.lay_angles_deg}
    values = {
        get_spec_field(name): WIRE_COLUMNS[name].convert_to_si(value)
        for name, value in cells.items()
        if name not in ("strands", *STRAND_SIZE_COLUMNS)
    }
    values |= {
        "layer_counts": row.strands_per_layer,
        "strand_diameters": WIRE_COLUMNS["strand_diameters_mm"].convert_to_si(row.strand_diameters),
        "stress_table": conductor_curve,
        "insulation_table": insulation_curve,
    }
    if "layout" in row.model_fields_set:
        values["layout"] = row.layout
    replaced_columns = {
        *(_REPLACED_COLUMNS["stress_table"] if conductor_curve else ()),
        *(_REPLACED_COLUMNS["insulation_table"] if insulation_curve else ()),
        *(_DENSITY_COLUMNS if row.mass_per_length_g_per_m is not None else ()),
    }
    fields_by_column = {name: get_spec_field(name) for name in WireRow.model_fields}
    defaults = {
        field: f"{describe_default(name)}{' (blank in this row)' if name in blank_columns else ''}"
        for name, field in fields_by_column.items()
        if name not in replaced_columns
        and field not in values
        and (field in _SPEC_DEFAULTS or field == "largest_curvature")
    }
    return WireSpec(name=row.wire, **values, defaults=defaults, place=place)


_SPEC_DEFAULTS: Final[Mapping[str, Any]] = {
    spec_field.name: spec_field.default
    for spec_field in fields(WireSpec)
    if isinstance(spec_field.default, str | float)
}
"""Default of each field of `WireSpec` that has one, in SI."""


def get_spec_field(name: str) -> str:
    """Return the field of `WireSpec` for a column: the column name without the unit."""
    unit = WIRE_COLUMNS[name].unit if name in WIRE_COLUMNS else ""
    return name.removesuffix(_COLUMN_UNITS[unit][0])


def describe_default(name: str) -> str:
    """Describe the default of a column, such as ``tension 0 N``.

    Parameters
    ----------
    name : name of a column with a default
    """
    field = get_spec_field(name)
    if field == "largest_curvature":
        return "largest curvature at a bending radius of five wire diameters"
    value, column = _SPEC_DEFAULTS[field], WIRE_COLUMNS.get(name)
    value_text = f"{value}" if column is None else f"{value / column.factor:.6g} {column.unit}"
    return f"{field.replace('_', ' ')} {value_text}".rstrip()


def normalise_heading(heading: str) -> str:
    """Convert a heading to a column name: lower case, underscores for blanks and hyphens."""
    return re.sub(r"[\s-]+", "_", heading.casefold())


def find_heading_faults(headings: Sequence[str]) -> Iterator[tuple[int, Fault]]:
    """Find unknown, repeated and missing columns of a wire sheet.

    Parameters
    ----------
    headings : headings of the sheet

    Yields
    ------
    Index of the column (0 for a missing one) and the fault.
    """
    names, columns = list(map(normalise_heading, headings)), WireRow.model_fields
    # Name of the column that is most similar to each heading; empty if none is similar.
    close_names = [next(iter(difflib.get_close_matches(name, columns, n=1)), "") for name in names]
    for index, (name, close_name) in enumerate(zip(names, close_names, strict=True)):
        if name not in columns:
            fault = build_choice_fault((), headings[index], columns, "one of the columns")
            unit = WIRE_COLUMNS[close_name].unit if close_name in WIRE_COLUMNS else ""
            remedy = f"{fault.remedy} Its values are in {unit}." if unit else fault.remedy
            yield index, replace(fault, remedy=remedy)
        elif name in names[:index]:
            yield index, Fault.of("protocol.column_again", column=name)
    for name in _REQUIRED_COLUMNS:
        if name not in close_names:
            yield 0, Fault.of("protocol.no_column", column=name)
    if not {*close_names} & {*STRAND_SIZE_COLUMNS}:
        yield 0, Fault.of("protocol.no_column", column="' or '".join(STRAND_SIZE_COLUMNS))


INITIAL_SLOPE_RANGES = {"stress_table": (1e9, 1e12), "insulation_table": (1e5, 1e10)}
"""Valid initial slopes of a stress-strain curve (Pa), by the column that names its table; a slope
outside its range is due to a wrong unit."""


class StressPoint(Block):
    """Point of a measured stress-strain curve."""

    strain: Annotated[float, Column("", 0.0, 0.6)]
    stress_mpa: Annotated[float, Column("MPa", 0.0, 1e5)]


def convert_stress_points(points: Sequence[StressPoint]) -> Curve:
    """Convert the points of a stress table to SI, without a first point at zero.

    Parameters
    ----------
    points : points in the order of strain

    Returns
    -------
    Strains and stresses (Pa).
    """
    is_at_zero = not (points[0].strain or points[0].stress_mpa)
    loaded_points = points[1:] if is_at_zero else points
    stresses = tuple(float(f"{point.stress_mpa * 1e6:.12g}") for point in loaded_points)
    return tuple(point.strain for point in loaded_points), stresses
