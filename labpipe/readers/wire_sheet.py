"""Reads a wire sheet: one row per wire, its dimensions and materials, as people keep it.

Writes this file: a person, with a spreadsheet program (xlsx: the sheet named ``wires``, else the
first) or a text editor (csv). All that is wrong with a sheet is told at once, each fault with its
cell.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias

from labpipe.errors import ReadError, complaint
from labpipe.readers.sheet_cells import (
    Cell,
    as_table,
    csv_cells,
    hidden_sheets,
    is_workbook,
    sheet_names,
    workbook_cells,
)
from labpipe.readers.wire_columns import (
    COLUMNS,
    LAYOUT,
    LIKE,
    NAME,
    STRESS_TABLE,
    Faults,
    allowed_in,
    check_first_row,
    check_heading,
    column_name,
    default_words,
    numbers_in,
)
from labpipe.readers.wire_names import check_names
from labpipe.readers.wire_stress import read_stress_table
from labpipe.records.wire import LAYOUTS, WireSpec

WIRES_SHEET = "wires"
AREAS_AGREE = 0.02
"""Share by which a conductor area may differ from that of the strands' diameters."""
_TOUCHING = 1e-3  # of the bore: less is rounding of the sheet
_WITH_DEFAULT = (
    *("insulation_modulus", "conductor_modulus", "poisson", "copper_k", "copper_n"),
    *("friction_strand", "friction_insulation", "radial_force", "length", "tension"),
    *("orientation", "largest_curvature"),
)
_OF_THE_CURVE = ("conductor_modulus", "copper_k", "copper_n")
_UNIT = {column.field: column for column in COLUMNS}


def read_wire_sheet(path: Path) -> tuple[WireSpec, ...]:
    """Read the wires of a sheet.

    Parameters
    ----------
    path : an xlsx workbook, or a csv

    Returns
    -------
    The wires, in the order of the rows.

    Raises
    ------
    ReadError
        If the file is damaged or holds no wires, or anything in it is wrong: all faults are in one
        message, each with its cell.
    """
    cells, where = _cells(path)
    faults = Faults(path)
    check_first_row(cells, faults)
    if faults.told:
        raise ReadError("\n".join(faults.told))
    table = as_table(cells, path, rows_of="one row per wire", place=where)
    check_heading(table.heading, faults)
    if faults.told:
        raise ReadError("\n".join(faults.told))
    names = [column_name(cell) for cell in table.heading]
    rows = [dict(zip(names, row, strict=True)) for row in table.rows]
    check_names([row[NAME] for row in rows], faults)
    curves: dict[str, _Curve] = {}
    specs = [_wire(_Row(row, faults, curves)) for row in rows]
    if faults.told:
        raise ReadError("\n".join(faults.told))
    return tuple(spec for spec in specs if spec is not None)


def _cells(path: Path) -> tuple[list[list[Cell]], str]:
    """Cells of the sheet, and its place in the file: empty for a csv."""
    if path.is_file() and path.stat().st_size == 0:
        found, remedy = "an empty file (0 bytes)", "Fill in the sheet and save it."
        raise ReadError(complaint(path, "", expected="a wire sheet", found=found, remedy=remedy))
    if not is_workbook(path):
        return csv_cells(path), ""
    known, hidden = sheet_names(path), hidden_sheets(path)
    if not known:
        found, remedy = "a workbook without sheets", "Name the wire sheet."
        raise ReadError(complaint(path, "", expected="a wire sheet", found=found, remedy=remedy))
    shown = [each for each in known if each not in hidden]
    name = next((each for each in known if each.casefold() == WIRES_SHEET), (shown or known)[0])
    where = f"hidden sheet '{name}'" if name in hidden else f"sheet '{name}'"
    cells = [
        [replace(cell, place=f"{where}, {cell.place}") for cell in row]
        for row in workbook_cells(path, name)
    ]
    return cells, where


_Curve: TypeAlias = tuple[tuple[float, ...], tuple[float, ...]] | None


@dataclass(frozen=True, slots=True)
class _Row:
    """One row: its cells by column, where to tell faults, the stress tables read so far."""

    cells: Mapping[str, Cell]
    faults: Faults
    curves: dict[str, _Curve]

    def place(self, column: str) -> str:
        cell = self.cells.get(column)
        return f"{cell.place} ({column})" if cell else self.cells[NAME].place

    def tell(self, column: str, *, expected: str, found: str, remedy: str) -> None:
        self.faults.add(self.place(column), expected=expected, found=found, remedy=remedy)

    def text(self, column: str) -> str:
        return self.cells[column].text if column in self.cells else ""


def _wire(row: _Row) -> WireSpec | None:
    """One wire; none where anything is wrong."""
    told = row.faults.told
    before = len(told)
    values = _numbers(row)
    values[LAYOUT] = _layout(row)
    values["stress_table"] = _stress_table(row, values)
    if len(told) == before:
        _add_layers(row, values)
    if len(told) == before:
        _check_room(row, values)
    return _spec(row, values) if len(told) == before else None


def _numbers(row: _Row) -> dict[str, Any]:
    """Numbers of a row by field, in SI; without those that are blank or wrong."""
    values: dict[str, Any] = {}
    for column in COLUMNS:
        text = row.text(column.name)
        if not text and column.is_needed:
            expected, remedy = allowed_in(column), "Fill it in."
            row.tell(column.name, expected=expected, found="a blank cell", remedy=remedy)
        if text:
            found = numbers_in(row.cells[column.name], column, row.faults)
            if found is not None:
                values[column.field] = found if column.is_list else found[0]
    return values


def _layout(row: _Row) -> str | None:
    """Layout asked for, none if blank."""
    text = row.text(LAYOUT).casefold()
    if text and text not in LAYOUTS:
        near = difflib.get_close_matches(text, LAYOUTS, n=1, cutoff=LIKE)
        expected = f"one of {', '.join(repr(each) for each in LAYOUTS)}"
        remedy = f"Did you mean {near[0]!r}?" if near else "Correct the cell, or empty it."
        row.tell(LAYOUT, expected=expected, found=repr(row.text(LAYOUT)), remedy=remedy)
    return text or None


def _stress_table(row: _Row, values: Mapping[str, Any]) -> _Curve:
    """The stress table that a row names, none if blank or wrong."""
    if not row.text(STRESS_TABLE):
        return None
    given = [_UNIT[name].name for name in _OF_THE_CURVE if name in values]
    if given:
        expected = "either a stress table, whose first slope is the modulus, or the numbers"
        remedy = "Empty one or the other."
        found = f"a stress table and {', '.join(given)}"
        row.tell(STRESS_TABLE, expected=expected, found=found, remedy=remedy)
    cell = row.cells[STRESS_TABLE]
    if cell.text not in row.curves:
        row.curves[cell.text] = read_stress_table(cell, row.place(STRESS_TABLE), row.faults)
    return row.curves[cell.text]


def _add_layers(row: _Row, values: dict[str, Any]) -> None:
    """Work out counts and diameters of the layers, in place; tell what does not agree."""
    angles = values.setdefault("lay_angles", ())
    counts = [int(count) for count in values.get("layer_counts", ())]
    column = "layer_counts" if counts else "lay_angles_deg"
    counts = counts or [1, *(6 * ring for ring in range(1, len(angles) + 1))]
    values["layer_counts"] = tuple(counts)
    strands, shown = int(values["strands"]), " + ".join(map(str, counts))
    if sum(counts) != strands:
        expected = f"{sum(counts)} strands as {_of_layers(column, len(angles))} give ({shown})"
        remedy = "Correct the number of strands or the layers, or fill in layer_counts."
        row.tell("strands", expected=expected, found=str(strands), remedy=remedy)
        return
    rings = len(counts) - int(counts[0] == 1)
    if len(angles) != rings:
        expected = f"one lay angle for each ring of {shown}, {rings}"
        remedy = "Give one angle per ring; the core has none."
        row.tell("lay_angles_deg", expected=expected, found=str(len(angles)), remedy=remedy)
    _add_diameters(row, values)
    _check_radii(row, values)


def _of_layers(column: str, n_angles: int) -> str:
    if column == "layer_counts":
        return "the layer counts"
    return f"{n_angles} lay angles" if n_angles != 1 else "1 lay angle"


def _add_diameters(row: _Row, values: dict[str, Any]) -> None:
    """Diameters of the strands of each layer, from what the sheet gives of three columns."""
    counts, area = values["layer_counts"], values.pop("conductor_area", None)
    one, each = values.pop("strand_diameter", None), values.get("strand_diameters")
    if one is not None and each is not None:
        expected, remedy = "one of both", "Empty one of the cells."
        found = "strand_diameter_mm and strand_diameters_mm"
        row.tell("strand_diameters_mm", expected=expected, found=found, remedy=remedy)
        return
    if each is not None and len(each) != len(counts):
        expected, remedy = f"{len(counts)} diameters, one per layer", "Correct the list."
        row.tell("strand_diameters_mm", expected=expected, found=str(len(each)), remedy=remedy)
        return
    if one is None and each is None:
        if area is None:
            expected = "a conductor area or a strand diameter"
            remedy = "Fill in conductor_area_mm2 or strand_diameter_mm."
            row.tell(_size_column(row), expected=expected, found="blank cells", remedy=remedy)
            return
        one = math.sqrt(4.0 * area / (math.pi * sum(counts)))
    values["strand_diameters"] = each or (one,) * len(counts)
    if area is not None:
        _check_area(row, values, area)


def _size_column(row: _Row) -> str:
    names = ("strand_diameter_mm", "strand_diameters_mm", "conductor_area_mm2")
    return next(name for name in names if name in row.cells)


def _copper(values: Mapping[str, Any]) -> float:
    """Area of all strands, m^2."""
    pairs = zip(values["layer_counts"], values["strand_diameters"], strict=True)
    return float(sum(count * math.pi * diameter**2 / 4.0 for count, diameter in pairs))


def _check_area(row: _Row, values: Mapping[str, Any], area: float) -> None:
    strands = _copper(values)
    if abs(area / strands - 1.0) > AREAS_AGREE:
        expected = f"the {strands * 1e6:.4g} mm^2 of the strands within {AREAS_AGREE:.0%}"
        remedy = "Correct the area or the strand diameter, or empty one of them."
        found = f"{area * 1e6:.4g} mm^2"
        row.tell("conductor_area_mm2", expected=expected, found=found, remedy=remedy)


def _check_radii(row: _Row, values: Mapping[str, Any]) -> None:
    radii, layers = values.get("layer_radii"), len(values["layer_counts"])
    if radii is None:
        return
    if values[LAYOUT] != "compressed":
        expected, remedy = "a blank cell", "Say compressed as the layout, or empty the cell."
        found = f"radii, for the layout {values[LAYOUT] or 'auto'!r} that sets its own"
        row.tell("layer_radii_mm", expected=expected, found=found, remedy=remedy)
    elif len(radii) != layers or any(a >= b for a, b in pairwise(radii)):
        expected = f"{layers} radii that grow, one per layer"
        found, remedy = repr(row.text("layer_radii_mm")), "Correct the list."
        row.tell("layer_radii_mm", expected=expected, found=found, remedy=remedy)


def _check_room(row: _Row, values: Mapping[str, Any]) -> None:
    """Tell strands that cannot be in the bore, and a bend tighter than the wire."""
    outer, wall = values["wire_diameter"], values["insulation_thickness"]
    bore = outer - 2.0 * wall
    if bore <= 0.0:
        expected = f"a wall less than half of the wire's {outer * 1e3:.4g} mm"
        found, remedy = f"{wall * 1e3:.4g} mm", "Correct the wall or the wire's diameter."
        row.tell("insulation_thickness_mm", expected=expected, found=found, remedy=remedy)
        return
    thickest, copper = max(values["strand_diameters"]), _copper(values)
    room = f"{bore * 1e3:.4g} mm ({outer * 1e3:.4g} mm less two walls of {wall * 1e3:.4g} mm)"
    remedy = "Correct the wire's diameter, its wall or the strands."
    if thickest > bore * (1.0 + _TOUCHING):
        expected, found = f"strands in a bore of {room}", f"one of {thickest * 1e3:.4g} mm"
        row.tell(_size_column(row), expected=expected, found=found, remedy=remedy)
    elif copper > math.pi / 4.0 * (bore * (1.0 + _TOUCHING)) ** 2:
        expected = f"copper in a bore of {room}, {math.pi / 4.0 * bore**2 * 1e6:.4g} mm^2"
        found = f"{copper * 1e6:.4g} mm^2"
        row.tell(_size_column(row), expected=expected, found=found, remedy=remedy)
    _check_bend(row, values)


def _check_bend(row: _Row, values: Mapping[str, Any]) -> None:
    largest, outer = values.get("largest_curvature"), values["wire_diameter"]
    if largest is not None and largest >= 2.0 / outer:
        expected = (
            f"a curvature below {2.0 / outer:.4g} 1/m, where the bending radius is the wire's"
        )
        found, remedy = f"{largest:.4g} 1/m", "Give a smaller one."
        row.tell("largest_curvature_per_m", expected=expected, found=found, remedy=remedy)


def _blank_words(row: _Row, spec_field: str) -> str:
    """Say that a value is taken though its column is there: perhaps a slip, unlike one left out."""
    column = LAYOUT if spec_field == LAYOUT else _UNIT[spec_field].name
    return " (blank in this row)" if column in row.cells else ""


def _spec(row: _Row, values: dict[str, Any]) -> WireSpec:
    """The record of a row without faults, with words for what it leaves open."""
    given = {key: value for key, value in values.items() if value is not None and key != "strands"}
    silent = [name for name in _WITH_DEFAULT if name not in given]
    if "stress_table" in given:
        silent = [name for name in silent if name not in _OF_THE_CURVE]
    open_fields = [name for name in (*silent, LAYOUT) if name not in given]
    defaults = {name: default_words(name) + _blank_words(row, name) for name in open_fields}
    place = re.sub(r"(cell [A-Z]+|, column \d+)", "", row.cells[NAME].place)
    place = re.sub(r", (\d+)$", r", row \1", place)
    return WireSpec(name=row.text(NAME), **given, defaults=defaults, place=place)
