"""Workbook of a sheet of wires: a row per wire, and their laws."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labpipe.records.arrays import Ints
from labpipe.records.quality import Severity
from labpipe.records.wire import WireTable
from labpipe.report.plot_thinning import simplify_line
from labpipe.report.wire_sections import (
    CURVATURE,
    FORCE,
    LENGTH,
    MOMENT,
    STIFFNESS,
    is_bent,
    warnings_of,
)
from labpipe.report.wording import Scale
from labpipe.report.workbook_file import About, Chart, Line, Row, Sheet, Value, save_book
from labpipe.wire.cantilever_curve import force_at

DEFLECTIONS = (5e-3, 10e-3, 20e-3, 30e-3, 40e-3, 50e-3)
"""Tip deflections at which the end load is reported, m."""


class Column(NamedTuple):
    """A column of the summary.

    Parameters
    ----------
    heading : with the unit
    value : of a wire; None if not available
    """

    heading: str
    value: Callable[[WireTable], Value]


def _lay_angles(table: WireTable) -> str:
    return "; ".join(f"{angle:.4g}" for angle in np.degrees(table.spec.lay_angles))


def _area(table: WireTable) -> float:
    return LENGTH.factor**2 * float(np.sum(np.pi / 4.0 * table.layout.diameter**2))


def _onset(table: WireTable, which: int) -> float | str:
    """Return the first or last onset of slip within the range, or a word instead."""
    onset = table.slip_onset(which)
    return onset if isinstance(onset, str) else CURVATURE.factor * onset


def _doubtful_curvature(table: WireTable) -> float | None:
    """Return the curvature beyond the linear range of the insulation, 1/m; None if not reached."""
    return CURVATURE.factor * table.doubtful_curvature if table.is_doubtful.any() else None


def _doubtful_deflection(table: WireTable) -> float | None:
    """Return the tip deflection beyond the linear range of the insulation, mm, if reached."""
    if not len(table.tip_deflection) or table.doubtful_deflection >= table.tip_deflection[-1]:
        return None
    return LENGTH.factor * table.doubtful_deflection


def _doubtful_share(table: WireTable) -> float | None:
    """Return the insulation's share of the moment at the end of its linear range, per cent."""
    limit = table.doubtful_curvature
    if not table.is_doubtful.any():
        return None
    return 100.0 * float(np.interp(limit, table.curvature, table.insulation_share))


def _rest_value(table: WireTable, name: str, factor: float) -> float | None:
    """Return a number of the cantilever at rest; None without its weight."""
    return None if table.rest is None else factor * float(getattr(table.rest, name))


def orientation_spread(table: WireTable) -> float | None:
    """Return the largest difference of the moments of all orientations, per cent of the moment.

    Parameters
    ----------
    table : of the wire

    Returns
    -------
    None if the table has only zero curvature.
    """
    use = is_bent(table)
    if not use.any():
        return None
    spread = (table.highest_moment - table.lowest_moment)[use] / table.moment[use]
    return 100.0 * float(np.max(spread))


def shown_rows(table: WireTable, max_rows: int) -> Ints:
    """Return the rows of the law that a sheet of limited length shows.

    Parameters
    ----------
    table : of the wire
    max_rows : rows, at least 2

    Returns
    -------
    Sorted row numbers: zero curvature, and those that keep the shape of the law in logarithms
    (`simplify_line`), so that its first slips count as much as its end; all if they are few.
    """
    count = len(table.curvature)
    use = np.flatnonzero(is_bent(table) & (table.moment > 0.0))
    if count <= max_rows or not len(use):
        return np.arange(count, dtype=np.int64)
    across, up = np.log(table.curvature[use]), np.log(table.moment[use])
    rows = use[simplify_line(across, up, points=max_rows - 1, tolerance=0.0)]
    return np.union1d([0], rows).astype(np.int64)


def row_error(table: WireTable, rows: Ints) -> float:
    """Return the largest error of straight lines between rows of the law, per cent of the moment.

    Parameters
    ----------
    table : of the wire
    rows : numbers of the rows
    """
    use = is_bent(table)
    lines = np.interp(table.curvature, table.curvature[rows], table.moment[rows])
    error = np.abs(lines - table.moment)[use] / np.abs(table.moment[use])
    return 100.0 * float(np.max(error, initial=0.0))


def _force_at(table: WireTable, deflection: float) -> float | None:
    """Return the end load at a tip deflection; None beyond the curve."""
    force = FORCE.factor * force_at(table, deflection)
    return None if np.isnan(force) else force


def _force_column(deflection: float) -> Column:
    heading = f"end load at {LENGTH.factor * deflection:g} {LENGTH.unit} ({FORCE.unit})"
    return Column(heading, lambda table: _force_at(table, deflection))


SUMMARY = (
    Column("strands", lambda table: len(table.layout.layer)),
    Column("layers", lambda table: " + ".join(map(str, table.spec.layer_counts))),
    Column("lay angles (deg)", _lay_angles),
    Column("layout", lambda table: table.layout.kind),
    Column("wire diameter (mm)", lambda table: 2.0 * LENGTH.factor * table.layout.wire_radius),
    Column("bore diameter (mm)", lambda table: 2.0 * LENGTH.factor * table.layout.bore_radius),
    Column("thinnest strand (mm)", lambda table: LENGTH.factor * min(table.layout.diameter)),
    Column("thickest strand (mm)", lambda table: LENGTH.factor * max(table.layout.diameter)),
    Column("conductor area (mm²)", _area),
    Column("stick stiffness (N·mm²)", lambda table: STIFFNESS.factor * table.stick_stiffness),
    Column("slip stiffness (N·mm²)", lambda table: STIFFNESS.factor * table.slip_stiffness),
    Column("first slip (1/m)", lambda table: _onset(table, 0)),
    Column("last slip (1/m)", lambda table: _onset(table, -1)),
    Column("range, curvature (1/m)", lambda table: CURVATURE.factor * float(table.curvature[-1])),
    Column("range, bending radius (mm)", lambda table: LENGTH.factor / float(table.curvature[-1])),
    Column("doubtful beyond, curvature (1/m)", _doubtful_curvature),
    Column("insulation's share there (%)", _doubtful_share),
    Column("insulation's share at the end (%)", lambda table: 100.0 * table.insulation_share[-1]),
    Column("moment at the end (N·mm)", lambda table: MOMENT.factor * float(table.moment[-1])),
    Column(
        "secant stiffness at the end (N·mm²)",
        lambda table: STIFFNESS.factor * float(table.secant_stiffness[-1]),
    ),
    Column(
        "tangent stiffness at the end (N·mm²)",
        lambda table: STIFFNESS.factor * float(table.tangent_stiffness[-1]),
    ),
    Column("spread over orientations, largest (%)", orientation_spread),
    Column("axial stiffness, without rotation (N)", lambda table: table.axial_stiffness),
    Column(
        "torsional stiffness, fixed length (N·mm²)",
        lambda table: STIFFNESS.factor * table.torsional_stiffness,
    ),
    Column(
        "torsional stiffness, free length (N·mm²)",
        lambda table: STIFFNESS.factor * table.free_torsional_stiffness,
    ),
    Column(
        "coupling of stretch and twist (N·mm)",
        lambda table: MOMENT.factor * table.stretch_twist_coupling,
    ),
    Column("mass per length (g/m)", lambda table: 1e3 * table.mass_per_length),
    Column("sag at rest (mm)", lambda table: _rest_value(table, "sag", LENGTH.factor)),
    Column("force at the tip at rest (mN)", lambda table: _rest_value(table, "force", 1e3)),
    Column("cantilever length (mm)", lambda table: LENGTH.factor * table.spec.length),
    Column("doubtful beyond, deflection (mm)", _doubtful_deflection),
    *(_force_column(deflection) for deflection in DEFLECTIONS),
    Column("warnings", warnings_of),
    Column("defaults used", lambda table: "; ".join(table.spec.defaults.values())),
)
"""Columns of the row of a wire, after its name."""


_LAW_COLUMNS: tuple[tuple[str, str, Scale], ...] = (
    ("curvature", "curvature", CURVATURE),
    ("moment", "moment", MOMENT),
    ("of sticking strands", "stick", MOMENT),
    ("of slipping strands", "slip", MOMENT),
    ("of the strands' own bending", "bending", MOMENT),
    ("lost to yielding", "plastic", MOMENT),
    ("of the insulation", "insulation", MOMENT),
    ("secant stiffness", "secant_stiffness", STIFFNESS),
    ("tangent stiffness", "tangent_stiffness", STIFFNESS),
    ("lowest moment of all orientations", "lowest_moment", MOMENT),
    ("highest moment of all orientations", "highest_moment", MOMENT),
    ("share of the insulation", "insulation_share", Scale(100.0, "%")),
)
_ABOUT = (
    "Laws of wires on first loading, from the wire model of labpipe. Cells hold all digits of a"
    " number and show five. 1 N·mm² is 1e-6 N·m². An empty cell: not available. Every table has"
    " filters: choose a wire in the heading 'wire'.",
    "Moment = sticking strands + slipping strands + strands' own bending + lost to yielding +"
    " insulation; the loss to yielding is negative.",
    "Secant stiffness: moment / curvature. Tangent stiffness: slope of the moment. Stick stiffness:"
    " no slip, no yielding. Slip stiffness: no friction, no yielding.",
    "A law is valid up to its last row. With very many wires, the sheet 'laws' shows only some rows"
    " of each law: see the last columns of 'wires'.",
    "End load: normal to the clamped axis, at the tip of a cantilever of the wire's length,"
    " interpolated linearly; empty beyond the end of its curve.",
    "Tension and torque = [EA, C; C, GJ] times strain and twist. Axial stiffness EA: without"
    " rotation; torsional stiffness GJ at fixed length: without elongation.",
    "Doubtful: the strain at the rim of the insulation exceeds its assumed linear range. End loads"
    " and deflections are relative to rest, with the wire level and its tip held.",
    "Strands: centres in the unrotated section; layer 0 is the innermost.",
)


def save_wire_workbook(
    tables: Sequence[WireTable],
    path: Path,
    *,
    refused: Mapping[str, str] | None = None,
    stated: Mapping[str, str] | None = None,
) -> None:
    """Write the results of a sheet of wires as an xlsx file.

    Parameters
    ----------
    tables : of the wires, in the order of the sheet
    path : of the file
    refused : name of each wire without a table -> reason
    stated : name of a wire -> description of its stress tables

    Raises
    ------
    StoreError
        If the file cannot be written.

    Notes
    -----
    With many wires, the sheet of laws shows some rows of each, 12 000 together but at least
    40 of each; the summary gives their number and the error of straight lines between them.
    """
    sheets = list(_sheets(tables, refused or {}, stated or {}))
    save_book(About("Laws of wires", _ABOUT), sheets, path, again="run the model")


def _sheets(
    tables: Sequence[WireTable], refused: Mapping[str, str], stated: Mapping[str, str]
) -> Iterator[Sheet]:
    # Rows of all laws together: with more, writing takes longer than the model.
    max_law_rows = 12_000
    min_law_rows = 40  # straight lines between them are within 1 %
    max_rows = max(max_law_rows // max(len(tables), 1), min_law_rows)
    law_rows = [shown_rows(table, max_rows) for table in tables]
    laws, places = _laws_sheet(tables, law_rows)
    links = {name: f"'laws'!A{first + 2}" for name, (first, _) in places.items()}
    yield _summary_sheet(tables, refused, law_rows, stated)._replace(links=links)
    yield laws
    loads = (("tip deflection", "tip_deflection", LENGTH), ("end load", "tip_force", FORCE))
    yield _stacked_sheet(
        "cantilevers", tables, loads, lambda table: table.doubtful_deflection,
        "Which end load deflects each cantilever?",
    )  # fmt: skip
    yield _stacked_sheet(
        "onsets of slip", tables, (("strands begin to slip", "slip_onsets", CURVATURE),),
        lambda table: table.doubtful_curvature,
        "At which curvatures do strands begin to slip?",
    )  # fmt: skip
    yield _strands_sheet(tables)
    yield _notes_sheet(tables, refused)


def _summary_sheet(
    tables: Sequence[WireTable],
    refused: Mapping[str, str],
    law_rows: Sequence[Ints],
    stated: Mapping[str, str],
) -> Sheet:
    heads = (
        "wire", *(column.heading for column in SUMMARY), "rows of the law", "rows shown",
        "error between the rows shown, largest (% of moment)", "stress tables",
    )  # fmt: skip
    rows: list[Row] = [
        (name, *(None for _ in SUMMARY[:-2]), f"not modelled: {reason}", *[None] * 5)
        for name, reason in refused.items()
    ]
    for table, rows_of_law in zip(tables, law_rows, strict=True):
        about = (
            len(table.curvature),
            len(rows_of_law),
            row_error(table, rows_of_law),
            stated.get(table.name),
        )
        rows.append((table.name, *(column.value(table) for column in SUMMARY), *about))
    question = "What are stiffness, onset of slip and range of each wire?"
    return Sheet("wires", heads, rows, 1, question=question)


def _laws_sheet(
    tables: Sequence[WireTable], law_rows: Sequence[Ints]
) -> tuple[Sheet, dict[str, tuple[int, int]]]:
    """Return the sheet of the laws of all wires; first and last row of each by its name."""
    moment_column, secant_column = 2, 8  # drawn
    rows: list[Row] = []
    places: dict[str, tuple[int, int]] = {}
    for table, rows_of_law in zip(tables, law_rows, strict=True):
        columns = [
            (scale.factor * getattr(table, field)[rows_of_law]).tolist()
            for _, field, scale in _LAW_COLUMNS
        ]
        first = len(rows)
        doubt = ["yes" if is_doubtful else None for is_doubtful in table.is_doubtful[rows_of_law]]
        rows += [(table.name, *row) for row in zip(*columns, doubt, strict=True)]
        places[table.name] = first, len(rows) - 1
    heads = ("wire", *(scale.label(label) for label, _, scale in _LAW_COLUMNS), "doubtful")
    bent_only = {name: (first + 1, last) for name, (first, last) in places.items() if last > first}
    lines = {
        heads[up]: [Line(name, rows_of, 1, up) for name, rows_of in bent_only.items()]
        for up in (secant_column, moment_column)
    }
    charts = [
        Chart(
            head.partition(" (")[0].capitalize(),
            CURVATURE.label("Curvature"),
            head,
            law_lines,
            is_log=True,
        )
        for head, law_lines in lines.items()
        if law_lines
    ]
    question = "What are moment and stiffness of each wire against curvature, on first loading?"
    return Sheet("laws", heads, rows, 2, question=question, charts=charts), places


def _stacked_sheet(
    name: str,
    tables: Sequence[WireTable],
    columns: Sequence[tuple[str, str, Scale]],
    limit: Callable[[WireTable], float],
    question: str,
) -> Sheet:
    """Return a sheet of values of all wires, doubtful above a limit; a chart for two columns."""
    rows: list[Row] = []
    lines = []
    for table in tables:
        values = [(scale.factor * getattr(table, field)).tolist() for _, field, scale in columns]
        first = len(rows)
        doubt = [
            "yes" if is_doubtful else None
            for is_doubtful in getattr(table, columns[0][1]) > limit(table)
        ]
        rows += [(table.name, *row) for row in zip(*values, doubt, strict=True)]
        if len(columns) == 2 and len(rows) > first + 1:
            lines.append(Line(table.name, (first, len(rows) - 1), 1, 2))
    heads = ("wire", *(scale.label(label) for label, _, scale in columns), "doubtful")
    across, up = _capitalise(heads[1]), _capitalise(heads[len(columns)])
    charts = [Chart("", across, up, lines)] if lines else []
    return Sheet(name, heads, rows, 1, question=question, charts=charts)


def _capitalise(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}"


def _strands_sheet(tables: Sequence[WireTable]) -> Sheet:
    rows: list[Row] = []
    for table in tables:
        layout = table.layout
        sizes = [
            (LENGTH.factor * values).tolist() for values in (layout.x, layout.y, layout.diameter)
        ]
        rows += [(table.name, *row) for row in zip(layout.layer.tolist(), *sizes, strict=True)]
    heads = ("wire", "layer", *(LENGTH.label(word) for word in ("x", "y", "diameter")))
    return Sheet("strands", heads, rows, 1, question="Where are the strands in the section?")


def _notes_sheet(tables: Sequence[WireTable], refused: Mapping[str, str]) -> Sheet:
    rows: list[Row] = [
        (name, "not modelled", "", reason, "refused") for name, reason in refused.items()
    ]
    for severity in reversed(Severity):
        rows += [
            (table.name, str(note.severity), note.where, note.message, note.code)
            for table in tables
            for note in table.notes
            if note.severity is severity
        ]
    question = "What was refused or limited, and which defaults were used?"
    heads = ("wire", "kind", "where", "what", "code")
    return Sheet("notes", heads, rows, 1, question=question, wrapped=("what",))
