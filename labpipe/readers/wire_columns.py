"""The columns of a wire sheet: names, units, what is allowed, what a blank means."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import MISSING, dataclass, field, fields
from itertools import chain
from pathlib import Path

from labpipe.errors import complaint, nearest
from labpipe.readers.sheet_cells import Cell
from labpipe.records.wire import WireSpec


@dataclass(frozen=True, slots=True)
class Rule:
    """What numbers a column allows.

    Parameters
    ----------
    words : such as ``a number > 0``
    allows : whether a number, in the unit of the column, is allowed
    """

    words: str
    allows: Callable[[float], bool]


POSITIVE = Rule("a number > 0", lambda value: value > 0.0)
NOT_NEGATIVE = Rule("a number >= 0", lambda value: value >= 0.0)
ANY = Rule("a number", lambda _: True)
WHOLE = Rule("a whole number >= 1", lambda value: value >= 1.0 and value == int(value))
SHARE = Rule("a number between 0 and 1", lambda value: 0.0 < value < 1.0)
POISSON = Rule("a number above -1, up to 0.5", lambda value: -1.0 < value <= 0.5)
LAY = Rule("angles between -90 and 90 deg", lambda value: abs(value) < 90.0)


@dataclass(frozen=True, slots=True)
class Column:
    """One column of numbers.

    Parameters
    ----------
    name : in the heading
    field : of `WireSpec`, where it goes there as it is
    unit : as shown to people; empty for a pure number
    factor : from the unit to SI
    rule : what is allowed
    is_list : whether a cell holds several, parted by semicolons
    is_needed : whether no cell may be blank
    period : after which numbers mean the same again, such as 360 deg
    """

    name: str
    field: str
    unit: str
    factor: float
    rule: Rule
    is_list: bool = False
    is_needed: bool = False
    period: float = math.inf


_DEGREE = math.pi / 180.0

COLUMNS = (
    Column("wire_diameter_mm", "wire_diameter", "mm", 1e-3, POSITIVE, is_needed=True),
    Column("strands", "strands", "", 1.0, WHOLE, is_needed=True),
    Column("conductor_area_mm2", "conductor_area", "mm^2", 1e-6, POSITIVE),
    Column("strand_diameter_mm", "strand_diameter", "mm", 1e-3, POSITIVE),
    Column("strand_diameters_mm", "strand_diameters", "mm", 1e-3, POSITIVE, is_list=True),
    Column("layer_counts", "layer_counts", "", 1.0, WHOLE, is_list=True),
    Column("lay_angles_deg", "lay_angles", "deg", _DEGREE, LAY, is_list=True),
    Column("layer_radii_mm", "layer_radii", "mm", 1e-3, NOT_NEGATIVE, is_list=True),
    Column("insulation_thickness_mm", "insulation_thickness", "mm", 1e-3, POSITIVE, is_needed=True),
    Column("insulation_modulus_mpa", "insulation_modulus", "MPa", 1e6, POSITIVE),
    Column("conductor_modulus_gpa", "conductor_modulus", "GPa", 1e9, POSITIVE),
    Column("poisson", "poisson", "", 1.0, POISSON),
    Column("copper_k_mpa", "copper_k", "MPa", 1e6, POSITIVE),
    Column("copper_n", "copper_n", "", 1.0, SHARE),
    Column("friction_strand", "friction_strand", "", 1.0, NOT_NEGATIVE),
    Column("friction_insulation", "friction_insulation", "", 1.0, NOT_NEGATIVE),
    Column("radial_force_n", "radial_force", "N", 1.0, NOT_NEGATIVE),
    Column("length_mm", "length", "mm", 1e-3, POSITIVE),
    Column("tension_n", "tension", "N", 1.0, NOT_NEGATIVE),
    Column("orientation_deg", "orientation", "deg", _DEGREE, ANY, period=360.0),
    Column("largest_curvature_per_m", "largest_curvature", "1/m", 1.0, POSITIVE),
)
"""Columns of numbers."""

LIMITS = {
    "wire_diameter_mm": (0.05, 200.0),
    "strands": (1.0, 2000.0),
    "conductor_area_mm2": (1e-05, 40000.0),
    "strand_diameter_mm": (0.005, 50.0),
    "strand_diameters_mm": (0.005, 50.0),
    "layer_counts": (1.0, 2000.0),
    "lay_angles_deg": (-80.0, 80.0),
    "layer_radii_mm": (0.0, 100.0),
    "insulation_thickness_mm": (0.001, 100.0),
    "insulation_modulus_mpa": (0.1, 10000000.0),
    "conductor_modulus_gpa": (0.1, 1000.0),
    "poisson": (-0.5, 0.5),
    "copper_k_mpa": (1.0, 10000.0),
    "copper_n": (0.01, 0.99),
    "friction_strand": (0.0, 10.0),
    "friction_insulation": (0.0, 10.0),
    "radial_force_n": (0.0, 1000000.0),
    "length_mm": (1.0, 100000.0),
    "tension_n": (0.0, 10000000.0),
    "orientation_deg": (-3600.0, 3600.0),
    "largest_curvature_per_m": (0.001, 100000.0),
}
"""Smallest and largest number of each column, in its unit.

They are wider than any wire needs: outside is only a wrong unit or a slip of the hand, and no
number inside is too large to work with.
"""

NAME, LAYOUT, STRESS_TABLE, REMARK = "wire", "layout", "stress_table", "remark"
KNOWN = (NAME, *(column.name for column in COLUMNS), LAYOUT, STRESS_TABLE, REMARK)
"""All columns of a wire sheet."""
NEEDED = (NAME, *(column.name for column in COLUMNS if column.is_needed), "lay_angles_deg")
"""Columns that every sheet has."""
SIZES = ("conductor_area_mm2", "strand_diameter_mm", "strand_diameters_mm")
"""Columns of which every sheet has at least one."""

_UNIT_WORDS = {column.unit.casefold() for column in COLUMNS if column.unit}
_UNIT_WORDS |= {"mm2", "mm\u00b2", "\u00b0", "-", "m^-1", "n/mm2", "n/mm^2", "n/mm\u00b2"}
LIKE = 0.6
"""Likeness (of difflib, 0 to 1) from which a name is told as the one that may be meant."""

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+")
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
_BY_NAME = {column.name: column for column in COLUMNS}


@dataclass(slots=True)
class Faults:
    """What is wrong with a sheet, gathered while it is read.

    Parameters
    ----------
    path : of the sheet
    told : the messages so far
    """

    path: Path
    told: list[str] = field(default_factory=list)

    def add(self, place: str, *, expected: str, found: str, remedy: str) -> None:
        """Word one more fault."""
        text = complaint(self.path, place, expected=expected, found=found, remedy=remedy)
        self.told.append(text)


def column_name(cell: Cell) -> str:
    """Name of the column that a heading means: in small letters, blanks as underscores."""
    return re.sub(r"[\s-]+", "_", cell.text.casefold())


def check_heading(heading: Sequence[Cell], faults: Faults) -> None:
    """Tell unknown, repeated and missing columns.

    Parameters
    ----------
    heading : cells of the heading
    faults : where to tell them
    """
    names = [column_name(cell) for cell in heading]
    meant = set()
    for number, (name, cell) in enumerate(zip(names, heading, strict=True)):
        if name not in KNOWN:
            meant.add(_unknown(name, cell, faults))
        elif name in names[:number]:
            found, remedy = f"{name!r} again", "Remove or rename one of them."
            faults.add(cell.place, expected="each column once", found=found, remedy=remedy)
    for name in NEEDED:
        if name not in {*names, *meant}:
            expected = f"a column {name!r}"
            faults.add(heading[0].place, expected=expected, found="none", remedy="Add it.")
    if not {*names, *meant} & set(SIZES):
        expected = f"a column {SIZES[0]!r}, {SIZES[1]!r} or {SIZES[2]!r}"
        faults.add(heading[0].place, expected=expected, found="none of them", remedy="Add one.")


def check_first_row(cells: Sequence[Sequence[Cell]], faults: Faults) -> None:
    """Tell a title or a comment above the heading, and a row of units below it.

    Parameters
    ----------
    cells : of the whole sheet
    faults : where to tell them
    """
    filled = [row for row in cells if any(cell.text for cell in row)]
    known = [sum(column_name(cell) in KNOWN for cell in row) for row in filled]
    heading = next((number for number, count in enumerate(known) if count > 1), None)
    if heading is None:
        return
    if known[0] == 0:
        title = next(cell for cell in filled[0] if cell.text)
        expected, found = "the heading in the first row that is not blank", repr(title.text)
        remedy = f"Remove the lines above the heading at {filled[heading][0].place}."
        faults.add(title.place, expected=expected, found=found, remedy=remedy)
    below = [cell for cell in chain(*filled[heading + 1 : heading + 2]) if cell.text]
    units = [cell for cell in below if cell.text.casefold().strip("[]() ") in _UNIT_WORDS]
    if len(units) > 1 and len(units) >= len(below) - 1:
        found = f"a row of units ({', '.join(cell.text for cell in units[:3])}, ...)"
        remedy = "Remove it: the unit is part of a column's name."
        faults.add(units[0].place, expected="a wire", found=found, remedy=remedy)


def _unknown(name: str, cell: Cell, faults: Faults) -> str:
    """Tell an unknown column; give back the one that was meant, empty if none is like it."""
    near = difflib.get_close_matches(name, KNOWN, n=3, cutoff=LIKE)
    same = list(_other_units(name))
    if not (same or near):
        expected = f"a column of a wire sheet, such as {', '.join(map(repr, NEEDED))}"
        remedy = "Correct its name, or remove the column."
        faults.add(cell.place, expected=expected, found=repr(cell.text), remedy=remedy)
        return ""
    meant = same[0] if same else near[0]
    near = nearest(name, list(KNOWN), most=3)
    listed = [meant, *(word for word in near if word != meant)][:3]
    remedy = f"Did you mean {meant!r}?"
    if same and _BY_NAME[meant].unit:
        remedy = f"Give it in {_BY_NAME[meant].unit} as {meant!r}."
    expected = f"one of {', '.join(repr(word) for word in listed)}, ..."
    faults.add(cell.place, expected=expected, found=repr(cell.text), remedy=remedy)
    return meant


def _other_units(name: str) -> Iterator[str]:
    """Columns of the same thing in another unit, such as wire_diameter_mm for wire_diameter_in."""
    for column in COLUMNS:
        stem = re.sub(r"_(mm2?|[mg]pa|n|deg|per_m)$", "", column.name) if column.unit else None
        if (
            stem
            and name.startswith(stem)
            and re.fullmatch(r"(_per)?(_[a-z0-9]{1,8})?", name[len(stem) :])
        ):
            yield column.name


def numbers_in(cell: Cell, column: Column, faults: Faults) -> tuple[float, ...] | None:
    """Read the number, or the numbers, of a cell into SI.

    Parameters
    ----------
    cell : not blank
    column : what it stands in
    faults : where to tell what is wrong

    Returns
    -------
    The numbers, one unless the column holds lists; none if anything is wrong.
    """
    place = f"{cell.place} ({column.name})"
    parts = [part.strip() for part in cell.text.split(";")] if column.is_list else [cell.text]
    for part in parts:
        wrong = _comma_in(part, cell, column) or _not_allowed(part, cell, column)
        if wrong:
            expected, found, remedy = wrong
            faults.add(place, expected=expected, found=found, remedy=remedy)
            return None
    return tuple(in_si(math.fmod(float(part), column.period), column) for part in parts)


def _comma_in(part: str, cell: Cell, column: Column) -> tuple[str, str, str] | None:
    """What is expected, found and to be done where a number holds a comma."""
    if column.is_list and ";" not in cell.text and "," in part:
        return allowed_in(column), repr(cell.text), _list_remedy(part)
    if _THOUSANDS.fullmatch(part):
        whole, point = part.replace(",", ""), part.replace(",", ".")
        readings = f"{whole} or {point}" if part.count(",") == 1 else whole
        return "a number with a point", f"the comma of {part!r}", f"Write {readings}, as meant."
    if _DECIMAL_COMMA.fullmatch(part):
        found, remedy = f"the decimal comma of {part!r}", f"Write {part.replace(',', '.')}."
        return "a number with a point", found, remedy
    return None


def _list_remedy(part: str) -> str:
    """What to do with a comma in a list that has no semicolon: two numbers, or a decimal comma."""
    listed = ";".join(each.strip() for each in part.split(","))
    if _DECIMAL_COMMA.fullmatch(part):
        return f"Part numbers by ';': write {listed} for two, {part.replace(',', '.')} for one."
    return f"Part them by ';': {listed}."


def _not_allowed(part: str, cell: Cell, column: Column) -> tuple[str, str, str] | None:
    """What is expected, found and to be done where a number is none, or is not allowed."""
    if not _allowed(part, column):
        return allowed_in(column), repr(cell.text), "Correct the cell."
    low, high = LIMITS.get(column.name, (-math.inf, math.inf))
    if not low <= float(part) <= high:
        expected = f"{low:.10g} to {high:.10g} {column.unit}".rstrip()
        return expected, repr(cell.text), "Is the unit right?"
    return None


def _allowed(part: str, column: Column) -> bool:
    if not _NUMBER.fullmatch(part):
        return False
    value = float(part)
    return math.isfinite(value) and column.rule.allows(value)


def allowed_in(column: Column) -> str:
    """Say what a cell of a column may hold, such as ``a number > 0 in mm``."""
    unit = f" in {column.unit}" if column.unit and column.unit not in column.rule.words else ""
    parted = ", parted by ';'" if column.is_list else ""
    words = column.rule.words
    if column.is_list and words.startswith("a "):
        words = words.removeprefix("a ").replace("number", "numbers")
    return f"{words}{unit}{parted}"


def in_si(value: float, column: Column) -> float:
    """Turn a number of a column into SI; twelve digits, so that 1.4 mm is 0.0014 m."""
    return float(f"{value * column.factor:.12g}")


def default_words(spec_field: str) -> str:
    """Say the value that is taken where a column is blank, with its unit.

    Parameters
    ----------
    spec_field : of `WireSpec`, one with a default

    Returns
    -------
    Such as ``insulation modulus 1000 MPa``.
    """
    plain = spec_field.replace("_", " ")
    if spec_field == "largest_curvature":
        return "largest curvature at a bending radius of five wire diameters"
    value = next(each.default for each in fields(WireSpec) if each.name == spec_field)
    if value is MISSING:
        message = f"{spec_field}: allowed are fields with a default"
        raise ValueError(message)
    column = next((each for each in COLUMNS if each.field == spec_field), None)
    if column is None:
        return f"{plain} {value}"
    return f"{plain} {float(value) / column.factor:.6g} {column.unit}".rstrip()
