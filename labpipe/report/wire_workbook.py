"""Write the workbook of a wire sheet: a row per wire, then laws, end loads and notes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from labpipe.mechanics.wire.first_loading import interpolate_end_load
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.wire import WireTable
from labpipe.report import table_records
from labpipe.report.plot_records import simplify_line
from labpipe.report.table_records import Record, Table, save_tables, tabulate, tabulate_curves
from labpipe.report.wire_figures import (
    CURVATURE,
    FORCE,
    LENGTH_SCALE,
    MOMENT,
    STIFFNESS_SCALE,
    is_curved,
    join_warnings,
)
from labpipe.report.wording import Scale

REPORTED_DEFLECTIONS = (5e-3, 10e-3, 20e-3, 30e-3, 40e-3, 50e-3)
"""Deflections of the tip, m, at which the summary gives the end load."""


def compute_orientation_spread(table: WireTable) -> float | None:
    """Compute the largest difference of the moment between orientations of a wire.

    Parameters
    ----------
    table : law of the wire

    Returns
    -------
    In per cent of the moment at the same curvature; None if the table has only zero curvature.
    """
    rows = is_curved(table)
    if not rows.any():
        return None
    spread = (table.highest_moment - table.lowest_moment)[rows] / table.moment[rows]
    return 100.0 * float(np.max(spread))


def choose_law_rows(table: WireTable, max_rows: int) -> Ints:
    """Choose the rows of the law of a wire that the sheet of laws shows.

    Parameters
    ----------
    table : law of the wire
    max_rows : largest number of rows, at least 2

    Returns
    -------
    Sorted row numbers: all rows if they are few enough or no moment is positive; else the first
    row, of zero curvature, and those that keep the shape of the law in logarithms
    (`simplify_line`), so that the first slips count as much as the end of the law.
    """
    count = len(table.curvature)
    usable_rows = np.flatnonzero(is_curved(table) & (table.moment > 0.0))
    if count <= max_rows or not len(usable_rows):
        return np.arange(count, dtype=np.int64)
    x, y = np.log(table.curvature[usable_rows]), np.log(table.moment[usable_rows])
    rows = usable_rows[simplify_line(x, y, max_points=max_rows - 1, tolerance=0.0)]
    return np.union1d([0], rows).astype(np.int64)


def compute_row_error(table: WireTable, rows: Ints) -> float:
    """Compute the largest error of linear interpolation between rows of a law.

    Parameters
    ----------
    table : law of the wire
    rows : their numbers

    Returns
    -------
    In per cent of the moment at the same curvature.
    """
    is_bent = is_curved(table)
    interpolated = np.interp(table.curvature, table.curvature[rows], table.moment[rows])
    error = np.abs(interpolated - table.moment)[is_bent] / np.abs(table.moment[is_bent])
    return 100.0 * float(np.max(error, initial=0.0))


def make_summary_record(table: WireTable) -> Record:
    """Make the cells of a wire in the summary, after its name; a missing number is None."""
    spec, layout, curvature = table.spec, table.layout, float(table.curvature[-1])
    area = LENGTH_SCALE.factor**2 * float(np.sum(np.pi / 4.0 * layout.diameter**2))
    factor = STIFFNESS_SCALE.factor
    spread = compute_orientation_spread(table)
    limit = table.doubtful_curvature if table.is_doubtful.any() else None
    share = None if limit is None else np.interp(limit, table.curvature, table.insulation_share)
    rest, deflection = table.rest, table.tip_deflection
    end_loads = FORCE.factor * interpolate_end_load(table, np.array(REPORTED_DEFLECTIONS))
    has_doubtful = len(deflection) > 0 and table.doubtful_deflection < deflection[-1]
    return {
        "strands": len(layout.layer),
        "layers": " + ".join(map(str, spec.layer_counts)),
        "lay angles (deg)": "; ".join(f"{angle:.4g}" for angle in np.degrees(spec.lay_angles)),
        "layout": layout.kind,
        "wire diameter (mm)": 2.0 * LENGTH_SCALE.factor * layout.wire_radius,
        "bore diameter (mm)": 2.0 * LENGTH_SCALE.factor * layout.bore_radius,
        "thinnest strand (mm)": LENGTH_SCALE.factor * min(layout.diameter),
        "thickest strand (mm)": LENGTH_SCALE.factor * max(layout.diameter),
        "conductor area (mm²)": area,
        "stick stiffness (N·mm²)": factor * table.stick_stiffness,
        "slip stiffness (N·mm²)": factor * table.slip_stiffness,
        "first slip (1/m)": table.slip_onset(0),
        "last slip (1/m)": table.slip_onset(-1),
        "range, curvature (1/m)": curvature,
        "range, bending radius (mm)": LENGTH_SCALE.factor / curvature,
        "doubtful beyond, curvature (1/m)": limit,
        "insulation's share there (%)": None if share is None else 100.0 * float(share),
        "insulation's share at the end (%)": 100.0 * float(table.insulation_share[-1]),
        "moment at the end (N·mm)": MOMENT.factor * float(table.moment[-1]),
        "secant stiffness at the end (N·mm²)": factor * float(table.secant_stiffness[-1]),
        "tangent stiffness at the end (N·mm²)": factor * float(table.tangent_stiffness[-1]),
        "spread over orientations, largest (%)": spread,
        "axial stiffness, without rotation (N)": table.axial_stiffness,
        "torsional stiffness, fixed length (N·mm²)": factor * table.torsional_stiffness,
        "torsional stiffness, free length (N·mm²)": factor * table.free_torsional_stiffness,
        "coupling of stretch and twist (N·mm)": MOMENT.factor * table.stretch_twist_coupling,
        "mass per length (g/m)": 1e3 * table.mass_per_length,
        "sag at rest (mm)": None if rest is None else LENGTH_SCALE.factor * rest.sag,
        "force at the tip at rest (mN)": None if rest is None else 1e3 * rest.force,
        "cantilever length (mm)": LENGTH_SCALE.factor * spec.length,
        "doubtful beyond, deflection (mm)": (
            LENGTH_SCALE.factor * table.doubtful_deflection if has_doubtful else None
        ),
        **{
            f"end load at {LENGTH_SCALE.factor * tip:g} {LENGTH_SCALE.unit} ({FORCE.unit})": load
            for tip, load in zip(REPORTED_DEFLECTIONS, end_loads.tolist(), strict=True)
        },
        "warnings": join_warnings(table),
        "defaults used": "; ".join(spec.defaults.values()),
    }


_LAW_COLUMNS: tuple[tuple[str, str, Scale], ...] = (
    ("curvature", "curvature", CURVATURE),
    ("moment", "moment", MOMENT),
    ("of sticking strands", "stick", MOMENT),
    ("of slipping strands", "slip", MOMENT),
    ("of the strands' own bending", "bending", MOMENT),
    ("lost to yielding", "plastic", MOMENT),
    ("of the insulation", "insulation", MOMENT),
    ("secant stiffness", "secant_stiffness", STIFFNESS_SCALE),
    ("tangent stiffness", "tangent_stiffness", STIFFNESS_SCALE),
    ("lowest moment of all orientations", "lowest_moment", MOMENT),
    ("highest moment of all orientations", "highest_moment", MOMENT),
    ("share of the insulation", "insulation_share", Scale(100.0, "%")),
)


def save_wire_workbook(
    tables: Sequence[WireTable],
    path: Path,
    *,
    refused: Mapping[str, str] | None = None,
    stated: Mapping[str, str] | None = None,
) -> None:
    """Write the workbook of a wire sheet as an xlsx file.

    Parameters
    ----------
    tables : of the wires, in the order of the wire sheet
    path : of the file
    refused : reason by the name of each wire without a table
    stated : description of its stress tables by the name of a wire

    Raises
    ------
    StoreError
        If the file cannot be written.

    Notes
    -----
    With many wires, the sheet of laws shows a part of the rows of each law: 12 000 rows in total,
    but at least 40 of each law. The summary gives the number of rows shown and the error of linear
    interpolation between them.
    """
    sheets = _list_tables(tables, refused or {}, stated or {})
    save_tables(sheets, path, book="wires", title="Laws of wires")


def _list_tables(
    tables: Sequence[WireTable], refused: Mapping[str, str], stated: Mapping[str, str]
) -> Iterator[Table]:
    max_law_rows = 12_000  # of all wires; writing more rows takes longer than the computation
    min_law_rows = 40  # of a wire, for an error of linear interpolation below 1 %
    max_rows = max(max_law_rows // max(len(tables), 1), min_law_rows)
    law_rows = [choose_law_rows(table, max_rows) for table in tables]
    laws = _tabulate_laws(tables, law_rows)
    wires = [row[0] for row in laws.rows]
    records: list[Record] = [
        {"wire": name, "warnings": f"not modelled: {reason}"} for name, reason in refused.items()
    ]
    for table, rows in zip(tables, law_rows, strict=True):
        link = f"'laws'!A{wires.index(table.name) + 2}"
        records.append({
            "wire": table_records.Cell(table.name, link=link),
            **make_summary_record(table),
            "rows of the law": len(table.curvature),
            "rows shown": len(rows),
            "error between the rows shown, largest (% of moment)": compute_row_error(table, rows),
            "stress tables": stated.get(table.name),
        })  # fmt: skip
    heads = dict.fromkeys(head for record in reversed(records) for head in record)
    yield tabulate("wires", records, heads)
    yield laws
    yield _tabulate_cantilevers(tables)
    yield tabulate("notes", _list_notes(tables, refused))


def _tabulate_laws(tables: Sequence[WireTable], law_rows: Sequence[Ints]) -> Table:
    """Make the sheet of the laws of all wires; its charts omit the point at zero curvature."""
    blocks = {}
    for table, rows in zip(tables, law_rows, strict=True):
        columns = {
            scale.label(label): scale.factor * getattr(table, field)[rows]
            for label, field, scale in _LAW_COLUMNS
        }
        blocks[table.name] = _mark_doubtful(table, columns, table.is_doubtful[rows])
    names = [scale.label(label) for label, _, scale in _LAW_COLUMNS]
    charted_columns = (
        CURVATURE.label("curvature"),
        STIFFNESS_SCALE.label("secant stiffness"),
        names[1],
    )
    heads = ["wire", *names, "doubtful"]
    return tabulate_curves(
        "laws", [("", blocks)], *charted_columns, heads=heads, start=1, is_log=True
    )


def _tabulate_cantilevers(tables: Sequence[WireTable]) -> Table:
    """Make the sheet of end loads against deflection, with a chart."""
    heads, blocks = (LENGTH_SCALE.label("tip deflection"), FORCE.label("end load")), {}
    for table in tables:
        x, y = LENGTH_SCALE.factor * table.tip_deflection, FORCE.factor * table.tip_force
        is_doubtful = table.tip_deflection > table.doubtful_deflection
        columns = dict(zip(heads, (x, y), strict=True))
        blocks[table.name] = _mark_doubtful(table, columns, is_doubtful)
    return tabulate_curves("cantilevers", [("", blocks)], *heads)


def _mark_doubtful(
    table: WireTable, columns: Mapping[str, Floats], is_doubtful: Flags
) -> list[Record]:
    """Make the records of a wire, and mark the doubtful ones."""
    records = table_records.make_records({"wire": table.name}, columns)
    return [
        record | {"doubtful": "yes" if doubt else None}
        for record, doubt in zip(records, is_doubtful.tolist(), strict=True)
    ]


def _list_notes(tables: Sequence[WireTable], refused: Mapping[str, str]) -> list[Record]:
    records: list[Record] = [
        {"wire": name, "kind": "not modelled", "where": "", "what": reason, "code": "refused"}
        for name, reason in refused.items()
    ]
    notes = ((table.name, note) for table in tables for note in table.notes)
    return records + table_records.make_note_records("wire", notes)
