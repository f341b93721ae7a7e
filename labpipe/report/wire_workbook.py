"""The results of a sheet of wires as a workbook: summary, notes, and a sheet for each wire."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from labpipe.records.arrays import Ints
from labpipe.records.quality import Severity
from labpipe.records.wire import WireTable
from labpipe.report.sheets import (
    FREE,
    Sheet,
    Value,
    column,
    save_sheets,
    sheet_name,
    sheet_of_columns,
)
from labpipe.report.wire_look import CURVATURE, FORCE, LENGTH, MOMENT, STIFFNESS
from labpipe.report.wire_summary import SUMMARY, row_error, shown_rows
from labpipe.report.wording import Scale

MOST_ROWS = 12_000
"""Rows of all laws together: with more, a workbook of hundreds of wires takes longer to write than
the model to run."""
_FEWEST_ROWS = 40
"""Rows of each law that are shown at least: straight lines between them stay within 1 %."""
_READ_ME, _SUMMARY, _NOTES = "read me", "wires", "notes"
_LAW: tuple[tuple[str, str, Scale], ...] = (
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
)
_ABOUT = (
    "Laws of wires on first loading, from the wire model of labpipe. Numbers are in the units of"
    " their headings, with all digits. 1 N·mm² is 1e-6 N·m². An empty cell: no such number.",
    "Sheet 'wires': one row for each wire; its name leads to its sheet. Sheet 'notes': what was"
    " refused, limited or taken as a default.",
    "Moment = sticking strands + slipping strands + strands' own bending + lost to yielding +"
    " insulation; what yielding takes is negative.",
    "Secant stiffness is moment / curvature, tangent stiffness its slope. Stick stiffness: no"
    " strand slips or yields. Slip stiffness: no friction, and no strand yields.",
    "A law ends with its last row. Nothing is said beyond it. With very many wires, their sheets"
    " show fewer rows than the law has: see the last columns of 'wires'.",
    "End load: normal to the clamped axis, at the tip of the cantilever of the wire's length, by"
    " straight lines between the points of its curve; empty beyond its end.",
    "Torsional stiffness: of strands that do not grip each other, a lower bound.",
    "Strands: centres of the section before it is turned; layer 0 is the innermost.",
)


def save_wire_workbook(
    tables: Sequence[WireTable], path: Path, *, refused: Mapping[str, str] | None = None
) -> None:
    """Write the results of a sheet of wires as an xlsx file.

    Parameters
    ----------
    tables : of the wires, in the order of the sheet
    path : of the file
    refused : name of each wire without a table -> why

    Raises
    ------
    StoreError
        If the file cannot be written.

    Notes
    -----
    With many wires, the sheet of each shows some rows of its law, `MOST_ROWS` of all wires
    together but 40 of each at least; the summary says how many, and how far straight lines between
    them are from the whole law.
    """
    save_sheets(_sheets(tables, refused or {}), path, again="run the model", active=1)


def _sheets(tables: Sequence[WireTable], refused: Mapping[str, str]) -> Iterator[Sheet]:
    most = max(MOST_ROWS // max(len(tables), 1), _FEWEST_ROWS)
    shown = [shown_rows(table, most) for table in tables]
    names = _names(tables)
    links = {table.name: name for table, name in zip(tables, names, strict=True)}
    yield Sheet(_READ_ME, ("About",), [(line,) for line in _ABOUT])
    yield _summary(tables, refused, shown)._replace(links=links)
    yield _notes(tables, refused)
    for table, name, rows in zip(tables, names, shown, strict=True):
        yield _wire(table, name, rows)


def _names(tables: Sequence[WireTable]) -> list[str]:
    """Names of the wires' sheets, in their order."""
    names = [_READ_ME, _SUMMARY, _NOTES]
    for table in tables:
        names.append(sheet_name(table.name, names))
    return names[3:]


def _summary(
    tables: Sequence[WireTable], refused: Mapping[str, str], shown: Sequence[Ints]
) -> Sheet:
    heads = (
        "wire", *(column.heading for column in SUMMARY), "rows of the law", "rows shown",
        "error between the rows shown, largest (% of moment)",
    )  # fmt: skip
    rows: list[Sequence[Value]] = [
        (name, *(None for _ in SUMMARY[:-2]), f"not modelled: {reason}")
        for name, reason in refused.items()
    ]
    for table, kept in zip(tables, shown, strict=True):
        about = (len(table.curvature), len(kept), row_error(table, kept))
        rows.append((table.name, *(column.value(table) for column in SUMMARY), *about))
    return Sheet(_SUMMARY, heads, rows, "B2")


def _notes(tables: Sequence[WireTable], refused: Mapping[str, str]) -> Sheet:
    rows: list[Sequence[Value]] = [
        (name, "not modelled", "", reason, "refused") for name, reason in refused.items()
    ]
    for severity in reversed(Severity):
        rows += [
            (table.name, str(note.severity), note.where, note.message, note.code)
            for table in tables
            for note in table.notes
            if note.severity is severity
        ]
    return Sheet(_NOTES, ("wire", "kind", "where", "what", "code"), rows)


def _wire(table: WireTable, name: str, shown: Ints) -> Sheet:
    """The law, the cantilever, the onsets of slip and the strands beside each other."""
    layout = table.layout
    law = [column(words, scale, getattr(table, field)[shown]) for words, field, scale in _LAW]
    columns = [
        *law,
        FREE,
        column("tip deflection", LENGTH, table.tip_deflection),
        column("end load", FORCE, table.tip_force),
        FREE,
        column("strands begin to slip", CURVATURE, table.slip_onsets),
        FREE,
        ("layer of a strand", layout.layer.tolist()),
        column("its centre, x", LENGTH, layout.x),
        column("its centre, y", LENGTH, layout.y),
        column("its diameter", LENGTH, layout.diameter),
    ]
    return sheet_of_columns(name, columns)
