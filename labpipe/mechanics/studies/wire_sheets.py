"""Read wire sheets and the stress-strain tables that they name.

All cells are checked, and the message of each fault names the cell. A table may state the strain
rate and the temperature at which the curve was measured.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias, TypeVar

import numpy as np

from labpipe.errors import (
    Fault,
    ProcessingError,
    ReadError,
    UsageError,
    format_error,
    sort_by_likeness,
)
from labpipe.mechanics.law.thinning import thin_law
from labpipe.mechanics.wire.materials import RambergOsgood, StressTable
from labpipe.protocol.grammar import Block
from labpipe.protocol.wire_rows import (
    INITIAL_SLOPE_RANGES,
    Column,
    Curve,
    StressPoint,
    WireRow,
    build_wire_spec,
    convert_stress_points,
    find_heading_faults,
    normalise_heading,
)
from labpipe.readers.workbooks import (
    Cell,
    Table,
    is_workbook,
    list_sheets,
    read_csv_cells,
    read_workbook_cells,
    split_table,
)
from labpipe.records.wire import WireSpec

PROOF_STRAIN = 0.002
"""Plastic strain at the proof stress Rp0.2."""
_MPA = 1e6
"""One megapascal in Pa."""
_CONDITION_PATTERN = re.compile(r"(strain_)?rate|(?P<temperature>temp)")
"""Pattern of the beginning of a heading that probably means the column of a condition."""
PlacedFault: TypeAlias = tuple[str, Fault]
"""Place of a cell in its file, and the fault of the cell."""
_B = TypeVar("_B", bound=Block)


class FormulaRow(Block):
    """Ramberg-Osgood curve, strain = s / E + 0.002 (s / Rp0.2)^n, in the units of its columns."""

    modulus_mpa: Annotated[float, Column("MPa", 0.1, 1e6)]
    proof_stress_mpa: Annotated[float, Column("MPa", 1e-3, 1e5)]
    exponent: Annotated[float, Column("", 1.1, 100.0)]
    largest_strain: Annotated[float, Column("", 1e-4, 0.6)]


class Conditions(Block):
    """Conditions under which a stress-strain curve was measured."""

    strain_rate_per_s: Annotated[float | None, Column("1/s", 1e-9, 1e4)] = None
    temperature_c: Annotated[float | None, Column("degC", -100.0, 400.0)] = None


_POINT_COLUMNS, _PARAMETER_COLUMNS, _CONDITION_COLUMNS = (
    list(kind.list_keys()) for kind in (StressPoint, FormulaRow, Conditions)
)


@dataclass(frozen=True, slots=True)
class StressCurve:
    """Stress-strain curve of a table.

    Parameters
    ----------
    table : name of the sheet or of the CSV file
    curve : strains, and stresses, Pa, of the points
    parameters : parameters of the Ramberg-Osgood curve, in the units of the columns; None for a
        table of points
    conditions : strain rate, 1/s, and temperature, degrees Celsius, of the measurement, if stated
    """

    table: str
    curve: Curve
    parameters: FormulaRow | None
    conditions: Conditions

    @property
    def description(self) -> str:
        """Return the table, the form and the conditions of the curve in one line."""
        strains, _ = self.curve
        parameters, conditions = self.parameters, self.conditions
        form_text = f"{len(strains)} point{'s' * (len(strains) > 1)}"
        if parameters is not None:
            form_text = (
                f"Ramberg-Osgood, modulus {parameters.modulus_mpa:.6g} MPa, proof stress "
                f"{parameters.proof_stress_mpa:.6g} MPa, exponent {parameters.exponent:.6g}"
            )
        stated_values = (conditions.strain_rate_per_s, "1/s"), (conditions.temperature_c, "\u00b0C")
        texts = [f"{value:.6g} {unit}" for value, unit in stated_values if value is not None]
        suffix = f", at {' and '.join(texts)}" if texts else ", rate and temperature not stated"
        return f"'{self.table}': {form_text}, to a strain of {strains[-1]:.4g}{suffix}"

    def build_json(self) -> dict[str, object]:
        """Build the JSON entry of the table in SI units; a value that is not stated is None."""
        parameters, temperature_c = self.parameters, self.conditions.temperature_c
        return {
            "table": self.table,
            "strain": list(self.curve[0]),
            "stress": list(self.curve[1]),
            "modulus": None if parameters is None else parameters.modulus_mpa * _MPA,
            "proof_stress": None if parameters is None else parameters.proof_stress_mpa * _MPA,
            "exponent": None if parameters is None else parameters.exponent,
            "strain_rate": self.conditions.strain_rate_per_s,
            "temperature": None if temperature_c is None else temperature_c + 273.15,
        }


def describe_stress_tables(curves: Mapping[str, StressCurve]) -> str:
    """Describe the stress tables of a wire in one line.

    Parameters
    ----------
    curves : stress tables, keyed by column of the wire sheet
    """
    return "; ".join(f"{column} {curve.description}" for column, curve in curves.items())


def compute_ramberg_osgood(parameters: FormulaRow) -> Curve:
    """Compute a stress table from the parameters of a Ramberg-Osgood curve.

    Parameters
    ----------
    parameters : parameters of the curve

    Returns
    -------
    Strains up to `largest_strain`, and stresses, Pa; at most 60 points without zero. Straight lines
    between the points are below the curve by less than 0.1 % of the stress. The first slope, which
    is the modulus of the table, is less than 0.1 % below the modulus of the curve.

    Notes
    -----
    Data sheets and codes use the form strain = s / E + 0.002 (s / Rp0.2)^n of [1]_ with the offset
    of [2]_ (EN 1999-1-1, annex E). This is the curve of `wire.materials.RambergOsgood` with the
    exponent 1 / n and K = Rp0.2 / 0.002^(1 / n).

    References
    ----------
    .. [1] Ramberg, Osgood, NACA TN 902 (1943).
    .. [2] Hill, NACA TN 927 (1944).
    """
    max_points, n_dense_points = 60, 4000
    plastic_fraction = 1e-4  # fraction of the strain that is plastic at the first point after zero
    modulus = parameters.modulus_mpa * _MPA
    proof_stress = parameters.proof_stress_mpa * _MPA
    n, max_strain = parameters.exponent, parameters.largest_strain
    law = RambergOsgood(modulus, proof_stress * PROOF_STRAIN ** (-1.0 / n), 1.0 / n)
    max_stress = float(law.compute_stress(np.array([max_strain]))[0])
    ratio = plastic_fraction * proof_stress / (PROOF_STRAIN * modulus)
    first_stress = min(proof_stress * ratio ** (1.0 / (n - 1.0)), max_stress / 2.0)
    stress = np.concatenate([[0.0], np.geomspace(first_stress, max_stress, n_dense_points)])
    strain = law.compute_strain(stress)
    strain[-1] = max_strain
    points = thin_law(strain, stress, max_points=max_points + 1)
    return tuple(points.curvature[1:].tolist()), tuple(points.moment[1:].tolist())


def read_stress_table(column: str, name: Cell, path: Path) -> StressCurve:
    """Read the stress-strain curve that a cell of a wire sheet names.

    Parameters
    ----------
    column : column of the wire sheet, one of `labpipe.protocol.wire_rows.INITIAL_SLOPE_RANGES`
    name : cell with the name of another sheet of the workbook, or of a CSV file in the same folder
    path : path of the wire sheet

    Raises
    ------
    ReadError
        If the table does not exist or has faults. The message names the cell of each fault.
    """
    table, file = _find_table(column, name, path)
    names = [normalise_heading(cell.text) for cell in table.heading]
    rows = [dict(zip(names, row, strict=True)) for row in table.rows]
    raise_faults(file, _find_heading_faults(table.heading, names))
    conditions = _read_conditions(rows, file)
    if set(names) & set(_PARAMETER_COLUMNS):
        parameters = _read_parameters(rows, file)
        curve, first_cell = compute_ramberg_osgood(parameters), rows[0]["modulus_mpa"]
    else:
        parameters, curve = None, convert_stress_points(_parse_rows(StressPoint, rows, file))
        first_cell = rows[0]["stress_mpa"]
    place = f"{first_cell.place} ({column})"
    raise_faults(file, ((place, fault) for fault in _find_curve_faults(curve, column)))
    return StressCurve(name.text, curve, parameters, conditions)


def _find_curve_faults(curve: Curve, column: str) -> Iterator[Fault]:
    """Yield the fault of a curve that is invalid, or whose first slope suggests a wrong unit."""
    min_slope, max_slope = INITIAL_SLOPE_RANGES[column]
    try:
        slope = StressTable(*curve).modulus
    except ValueError as error:
        yield Fault.of("mechanics.studies.no_stress_table", error=error)
        return
    if not min_slope <= slope <= max_slope:
        low, high, value = min_slope / 1e9, max_slope / 1e9, slope / 1e9
        yield Fault.of("mechanics.studies.first_slope", min_gpa=low, max_gpa=high, slope_gpa=value)


def _find_heading_faults(heading: Sequence[Cell], names: Sequence[str]) -> Iterator[PlacedFault]:
    """Yield the faults of columns that are missing, repeated, contradictory or misspelt."""
    parameter_names = [name for name in names if name in _PARAMETER_COLUMNS]
    point_names = [name for name in names if name in _POINT_COLUMNS]
    required_columns = _PARAMETER_COLUMNS if parameter_names else _POINT_COLUMNS
    for column in required_columns:
        if column not in names:
            headings = ", ".join(repr(cell.text) for cell in heading)
            fault = Fault.of("mechanics.studies.missing_column", column=column, columns=headings)
            yield heading[0].place, fault
    if parameter_names and point_names:
        point, parameter = point_names[0], parameter_names[0]
        fault = Fault.of("mechanics.studies.points_and_numbers", point=point, number=parameter)
        yield heading[names.index(point)].place, fault
    for index, (name, cell) in enumerate(zip(names, heading, strict=True)):
        if name in (*required_columns, *_CONDITION_COLUMNS) and name in names[:index]:
            yield cell.place, Fault.of("mechanics.studies.repeated_column", column=name)
        if name not in _CONDITION_COLUMNS and (condition := _CONDITION_PATTERN.match(name)):
            column = _CONDITION_COLUMNS[1] if condition["temperature"] else _CONDITION_COLUMNS[0]
            fault = Fault.of("mechanics.studies.other_column", column=column, name=cell.text)
            yield cell.place, fault


def _read_conditions(rows: Sequence[Mapping[str, Cell]], file: Path) -> Conditions:
    """Read strain rate and temperature; all rows that state them must agree."""
    first_cells: dict[str, Cell] = {}
    for column in _CONDITION_COLUMNS:
        cells = [row[column] for row in rows if column in row and row[column].text]
        for cell in cells:
            first_cell = first_cells.setdefault(column, cell)
            if cell.text != first_cell.text:
                first, place = first_cell.text, first_cell.place
                values: dict[str, Any] = {"first": first, "place": place, "value": cell.text}
                fault = Fault.of("mechanics.studies.two_conditions", **values)
                raise_faults(file, [(f"{cell.place} ({column})", fault)])
    [conditions] = _parse_rows(Conditions, [first_cells], file)
    return conditions


def _read_parameters(rows: Sequence[Mapping[str, Cell]], file: Path) -> FormulaRow:
    """Read the parameters of a Ramberg-Osgood curve from the single row of a table."""
    if len(rows) > 1:
        fault = Fault.of("mechanics.studies.several_rows", count=len(rows))
        raise_faults(file, [(next(iter(rows[1].values())).place, fault)])
    cells = [{key: row[key] for key in _PARAMETER_COLUMNS} for row in rows]
    [parameters] = _parse_rows(FormulaRow, cells, file)
    min_strain = parameters.proof_stress_mpa / parameters.modulus_mpa + PROOF_STRAIN
    max_strain = parameters.largest_strain
    if min_strain > max_strain:
        values: dict[str, Any] = {"minimum": min_strain, "strain": max_strain}
        fault = Fault.of("mechanics.studies.proof_beyond_range", ("largest_strain",), **values)
        raise_faults(file, place_faults([fault], rows[0]))
    return parameters


def _parse_rows(block_type: type[_B], rows: Sequence[Mapping[str, Cell]], file: Path) -> list[_B]:
    """Parse rows as blocks of a type, without the columns that are not fields of the type."""
    blocks: list[_B] = []
    faults: list[PlacedFault] = []
    for row in rows:
        cells = {key: cell for key, cell in row.items() if key in block_type.model_fields}
        block, row_faults = block_type.read({key: cell.text for key, cell in cells.items()})
        faults += place_faults(row_faults, cells)
        if block is not None:
            blocks.append(block)
    raise_faults(file, faults)
    return blocks


def _find_table(column: str, name: Cell, path: Path) -> tuple[Table, Path]:
    """Find a table and its file: a sheet of the workbook, or a CSV file in the same folder."""
    row_meaning, place = "one row per point of the curve", f"{name.place} ({column})"
    if not is_workbook(path):
        if Path(name.text).name != name.text:
            fault = Fault.of("mechanics.studies.csv_elsewhere", name=name.text)
            raise_faults(path, [(place, fault)])
        file = path.with_name(name.text)
        return split_table(read_csv_cells(file), file, rows_of=row_meaning), file
    sheets = list(list_sheets(path))
    matching_sheets = [sheet for sheet in sheets if sheet.casefold() == name.text.casefold()]
    if not matching_sheets:
        similar_names = ", ".join(map(repr, sort_by_likeness(name.text, sheets)))
        fault = Fault.of("mechanics.studies.no_such_sheet", sheets=similar_names, name=name.text)
        raise_faults(path, [(place, fault)])
    sheet_name = name.text if name.text in matching_sheets else matching_sheets[0]
    sheet_place = f"sheet '{sheet_name}'"
    cells = read_workbook_cells(path, sheet_name, sheet_place)
    return split_table(cells, path, rows_of=row_meaning, place=sheet_place), path


def place_faults(faults: Iterable[Fault], row: Mapping[str, Cell]) -> Iterator[PlacedFault]:
    """Yield each fault with the place of its cell, or of the first cell if its column is missing.

    Parameters
    ----------
    faults : faults of the row; the path of a fault begins with the name of a column
    row : cells of the row, keyed by column
    """
    for fault in faults:
        first_column, first_cell = next(iter(row.items()))
        column = str(fault.path[0]) if fault.path else first_column
        yield f"{row.get(column, first_cell).place} ({column})", fault


def format_faults(path: Path, faults: Iterable[PlacedFault]) -> list[str]:
    """Return the messages of the faults of a file."""
    return [
        format_error(path, place, expected=fault.expected, found=fault.found, remedy=fault.remedy)
        for place, fault in faults
    ]


def raise_faults(path: Path, faults: Iterable[PlacedFault]) -> None:
    """Raise the faults of a file, if any.

    Raises
    ------
    ReadError
        If there is a fault. The message has a line for each fault.
    """
    if messages := format_faults(path, faults):
        raise ReadError("\n".join(messages))


@dataclass(frozen=True, slots=True)
class WireSheet:
    """A wire sheet with its stress tables.

    Parameters
    ----------
    path : path of the sheet
    specs : specifications of the wires, in the order of the rows
    curves : stress tables of each wire, keyed by name of the wire and by column of the sheet
    """

    path: Path
    specs: tuple[WireSpec, ...]
    curves: Mapping[str, Mapping[str, StressCurve]]

    def find_wire(self, name: str, place: str) -> WireSpec:
        """Find the specification of a wire by its name.

        Parameters
        ----------
        name : name of the wire
        place : file and key that name the wire, for the message

        Raises
        ------
        UsageError
            If the wire is not in the sheet.
        """
        specs = {spec.name: spec for spec in self.specs}
        if name in specs:
            return specs[name]
        names = ", ".join(sort_by_likeness(name, list(specs)))
        values = {"sheet": self.path, "names": names, "name": name}
        raise UsageError.about("mechanics.studies.no_such_wire", place, **values)


def build_wire_error(sheet: Path, spec: WireSpec, expected: str, reason: object) -> ProcessingError:
    """Build the error of a wire that cannot be modelled.

    Parameters
    ----------
    sheet : path of the wire sheet
    spec : specification of the wire
    expected : description of a wire that can be modelled
    reason : reason why this wire cannot be modelled
    """
    place = f"{spec.place}, wire {spec.name!r}"
    values = {"expected": expected, "reason": reason}
    return ProcessingError.about("mechanics.studies.no_model_of_wire", sheet, place, **values)


def read_wire_sheet(path: Path) -> WireSheet:
    """Read the wires of a sheet, which has one row per wire with its dimensions and materials.

    Parameters
    ----------
    path : path of a CSV file, or of a workbook. The sheet ``wires`` of a workbook is read; without
        it, the first visible sheet

    Raises
    ------
    ReadError
        If the file is damaged, has no wires or has faults. The message names the cell of each
        fault.
    """
    cells, sheet_place = _read_sheet_cells(path)
    table = split_table(cells, path, rows_of="one row per wire", place=sheet_place)
    heading_faults = find_heading_faults([cell.text for cell in table.heading])
    raise_faults(path, ((table.heading[index].place, fault) for index, fault in heading_faults))
    names = [normalise_heading(cell.text) for cell in table.heading]
    rows = [dict(zip(names, row, strict=True)) for row in table.rows]
    messages = format_faults(path, _find_repeated_names([row["wire"] for row in rows]))
    tables: dict[tuple[str, str], StressCurve] = {}
    wire_rows: list[WireRow] = []
    for row in rows:
        wire_row, faults = WireRow.read({name: cell.text for name, cell in row.items()})
        messages += format_faults(path, place_faults(faults, row))
        if wire_row is not None:
            wire_rows.append(wire_row)
        for column, cell in _list_table_names(row):
            try:
                if (column, cell.text) not in tables:
                    tables[column, cell.text] = read_stress_table(column, cell, path)
            except ReadError as error:
                messages.append(str(error))
    if messages:
        raise ReadError("\n".join(dict.fromkeys(messages)))
    specs, curves = [], {}
    for row, wire_row in zip(rows, wire_rows, strict=True):
        row_tables = {column: tables[column, cell.text] for column, cell in _list_table_names(row)}
        column_tables = map(row_tables.get, INITIAL_SLOPE_RANGES)
        stress_tables = (table.curve if table else None for table in column_tables)
        blank_columns = [name for name, cell in row.items() if not cell.text]
        # The place of a wire is the place of its row, without the column.
        place = re.sub(r", column \d+$", "", row["wire"].place)
        place = re.sub(r"cell [A-Z]+(\d+)$", r"row \1", place)
        specs.append(build_wire_spec(wire_row, blank_columns, place, *stress_tables))
        curves[row["wire"].text] = row_tables
    return WireSheet(path, tuple(specs), curves)


def _list_table_names(row: Mapping[str, Cell]) -> list[tuple[str, Cell]]:
    """List the columns of a row that name a stress table, with their cells."""
    return [(name, row[name]) for name in INITIAL_SLOPE_RANGES if name in row and row[name].text]


def _read_sheet_cells(path: Path) -> tuple[list[list[Cell]], str]:
    """Read the cells of the wire sheet, and its place in the file: empty for a CSV file."""
    if not is_workbook(path):
        return read_csv_cells(path), ""
    sheets = list_sheets(path)
    if not sheets:
        raise ReadError.about("mechanics.studies.no_sheets", path)
    visible_sheets = [name for name, is_visible in sheets.items() if is_visible]
    wire_sheets = [name for name in sheets if name.casefold() == "wires"]
    name = [*wire_sheets, *visible_sheets, *sheets][0]
    place = f"sheet '{name}'" if sheets[name] else f"hidden sheet '{name}'"
    return read_workbook_cells(path, name, place), place


def _find_repeated_names(names: Sequence[Cell]) -> Iterator[PlacedFault]:
    """Yield the faults of names that differ at most in case or in the encoding of accents."""
    first_cells: dict[str, Cell] = {}
    for cell in names:
        # Some file systems ignore case and the encoding of accents, and Abaqus ignores case.
        folded_text = unicodedata.normalize("NFC", cell.text).casefold()
        normalised_text = unicodedata.normalize("NFC", folded_text)
        first_cell = first_cells.setdefault(normalised_text, cell)
        if first_cell is not cell and cell.text:
            first, place = first_cell.text, first_cell.place
            values: dict[str, Any] = {"name": cell.text, "first": first, "place": place}
            yield f"{cell.place} (wire)", Fault.of("mechanics.studies.similar_names", **values)
