"""The results of a sheet of wires as a workbook: a row for each, and their laws."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labpipe.records.arrays import Ints
from labpipe.records.quality import Severity
from labpipe.records.wire import WireTable
from labpipe.report.plot_thinning import bends
from labpipe.report.wire_sections import (
    CURVATURE,
    FORCE,
    LENGTH,
    MOMENT,
    STIFFNESS,
    bent,
    warnings_of,
)
from labpipe.report.wording import Scale
from labpipe.report.workbook_cells import Row, Value
from labpipe.report.workbook_file import About, Chart, Line, Sheet, save_book
from labpipe.wire.cantilever_curve import force_at

DEFLECTIONS = (5e-3, 10e-3, 20e-3, 30e-3, 40e-3, 50e-3)
"""Tip deflections at which the end load is reported, m."""
_AREA = LENGTH.factor**2


class Column(NamedTuple):
    """A column of the summary.

    Parameters
    ----------
    heading : with the unit
    value : of a wire; None where there is no such number
    """

    heading: str
    value: Callable[[WireTable], Value]


def _of_layers(table: WireTable, sign: str) -> str:
    return f" {sign} ".join(str(count) for count in table.spec.layer_counts)


def _lay_angles(table: WireTable) -> str:
    return "; ".join(f"{angle:.4g}" for angle in np.degrees(table.spec.lay_angles))


def _area(table: WireTable) -> float:
    return _AREA * float(np.sum(np.pi / 4.0 * table.layout.diameter**2))


def _onset(table: WireTable, which: int) -> float | str:
    """First or last onset of slip within the range, or the word for it."""
    onset = table.slip_onset(which)
    return onset if isinstance(onset, str) else CURVATURE.factor * onset


def _doubtful_from(table: WireTable) -> float | None:
    """Curvature beyond which the insulation is taken too far, 1/m; None where it is not."""
    return CURVATURE.factor * table.doubtful_curvature if table.is_doubtful.any() else None


def _deflects_from(table: WireTable) -> float | None:
    """Tip deflection beyond which it is, mm; None where the curve of the cantilever ends before."""
    if not len(table.tip_deflection) or table.doubtful_deflection >= table.tip_deflection[-1]:
        return None
    return LENGTH.factor * table.doubtful_deflection


def _share_at(table: WireTable) -> float | None:
    """Share of the moment that the insulation carries at that curvature, in per cent."""
    limit = table.doubtful_curvature
    if not table.is_doubtful.any():
        return None
    return 100.0 * float(np.interp(limit, table.curvature, table.insulation_share))


def _rest(table: WireTable, name: str, factor: float) -> float | None:
    """A number of the cantilever at rest; None where its weight is left out."""
    return None if table.rest is None else factor * float(getattr(table.rest, name))


def orientation_spread(table: WireTable) -> float | None:
    """Largest difference of the moments of all orientations, in per cent of the moment.

    Parameters
    ----------
    table : of the wire

    Returns
    -------
    None where the table has no curvature but zero.
    """
    use = bent(table)
    if not use.any():
        return None
    apart = (table.highest_moment - table.lowest_moment)[use] / table.moment[use]
    return 100.0 * float(np.max(apart))


def shown_rows(table: WireTable, most: int) -> Ints:
    """Number the rows of the law that a sheet of limited length shows.

    Parameters
    ----------
    table : of the wire
    most : rows, at least 2

    Returns
    -------
    Sorted row numbers: zero curvature, and of the others those that keep the shape of the law in
    logarithms, so that its first slips count as much as its end; all if there are not more.

    Notes
    -----
    See `labpipe.report.plot_thinning.bends`.
    """
    count = len(table.curvature)
    use = np.flatnonzero(bent(table) & (table.moment > 0.0))
    if count <= most or not len(use):
        return np.arange(count, dtype=np.int64)
    across, up = np.log(table.curvature[use]), np.log(table.moment[use])
    kept = use[bends(across, up, points=most - 1, tolerance=0.0)]
    return np.union1d([0], kept).astype(np.int64)


def row_error(table: WireTable, rows: Ints) -> float:
    """Largest error of straight lines between some rows of the law, in per cent of the moment.

    Parameters
    ----------
    table : of the wire
    rows : numbers of the rows
    """
    use = bent(table)
    lines = np.interp(table.curvature, table.curvature[rows], table.moment[rows])
    apart = np.abs(lines - table.moment)[use] / np.abs(table.moment[use])
    return 100.0 * float(np.max(apart, initial=0.0))


def _force_at(table: WireTable, deflection: float) -> float | None:
    """End load at a tip deflection; None where the curve does not reach it."""
    force = FORCE.factor * force_at(table, deflection)
    return None if np.isnan(force) else force


def _force_column(deflection: float) -> Column:
    heading = f"end load at {LENGTH.factor * deflection:g} {LENGTH.unit} ({FORCE.unit})"
    return Column(heading, lambda table: _force_at(table, deflection))


SUMMARY = (
    Column("strands", lambda table: len(table.layout.layer)),
    Column("layers", lambda table: _of_layers(table, "+")),
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
    Column("doubtful beyond, curvature (1/m)", _doubtful_from),
    Column("insulation's share there (%)", _share_at),
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
    Column("axial stiffness, not turning (N)", lambda table: table.axial_stiffness),
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
    Column("sag at rest (mm)", lambda table: _rest(table, "sag", LENGTH.factor)),
    Column("force that holds the tip at rest (mN)", lambda table: _rest(table, "force", 1e3)),
    Column("cantilever length (mm)", lambda table: LENGTH.factor * table.spec.length),
    Column("doubtful beyond, deflection (mm)", _deflects_from),
    *(_force_column(deflection) for deflection in DEFLECTIONS),
    Column("warnings", warnings_of),
    Column("defaults taken", lambda table: "; ".join(table.spec.defaults.values())),
)
"""What stands in the row of a wire, behind its name."""


MOST_ROWS = 12_000
"""Rows of all laws together: with more, a workbook of hundreds of wires takes longer to write than
the model to run."""
_FEWEST_ROWS = 40
"""Rows of each law that are shown at least: straight lines between them stay within 1 %."""
_LAWS = "laws"
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
    ("share of the insulation", "insulation_share", Scale(100.0, "%")),
)
_ABOUT = (
    "Laws of wires on first loading, from the wire model of labpipe. Cells hold all digits of a"
    " number and show five. 1 N·mm² is 1e-6 N·m². An empty cell: no such number. Every table has"
    " filters: choose a wire in the heading 'wire'.",
    "Moment = sticking strands + slipping strands + strands' own bending + lost to yielding +"
    " insulation; what yielding takes is negative.",
    "Secant stiffness is moment / curvature, tangent stiffness its slope. Stick stiffness: no"
    " strand slips or yields. Slip stiffness: no friction, and no strand yields.",
    "A law ends with its last row. Nothing is said beyond it. With very many wires, the sheet"
    " 'laws' shows fewer rows than a law has: see the last columns of 'wires'.",
    "End load: normal to the clamped axis, at the tip of the cantilever of the wire's length, by"
    " straight lines between the points of its curve; empty beyond its end.",
    "Pull and torque = [EA, C; C, GJ] times strain and twist. Axial stiffness EA: of a wire that"
    " does not turn; torsional stiffness GJ of fixed length: of one that does not lengthen.",
    "Doubtful: the rim of the insulation is strained beyond what its straight line is taken to hold"
    " for. End loads and deflections count from rest, where the wire lies level, its tip held.",
    "Strands: centres of the section before it is turned; layer 0 is the innermost.",
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
    refused : name of each wire without a table -> why
    stated : name of a wire -> words for the stress tables that its row names

    Raises
    ------
    StoreError
        If the file cannot be written.

    Notes
    -----
    With many wires, the sheet of laws shows some rows of each, `MOST_ROWS` of all wires
    together but 40 of each at least; the summary says how many, and how far straight lines between
    them are from the whole law.
    """
    sheets = list(_sheets(tables, refused or {}, stated or {}))
    save_book(About("Laws of wires", _ABOUT), sheets, path, again="run the model")


def _sheets(
    tables: Sequence[WireTable], refused: Mapping[str, str], stated: Mapping[str, str]
) -> Iterator[Sheet]:
    most = max(MOST_ROWS // max(len(tables), 1), _FEWEST_ROWS)
    shown = [shown_rows(table, most) for table in tables]
    laws, places = _laws(tables, shown)
    links = {name: f"'{_LAWS}'!A{first + 2}" for name, (first, _) in places.items()}
    yield _summary(tables, refused, shown, stated)._replace(links=links)
    yield laws
    loads = (("tip deflection", "tip_deflection", LENGTH), ("end load", "tip_force", FORCE))
    yield _below(
        "cantilevers", tables, loads, lambda table: table.doubtful_deflection,
        "How hard does the end of each cantilever have to be pulled?",
    )  # fmt: skip
    yield _below(
        "onsets of slip", tables, (("strands begin to slip", "slip_onsets", CURVATURE),),
        lambda table: table.doubtful_curvature,
        "At which curvatures do strands begin to slip?",
    )  # fmt: skip
    yield _strands(tables)
    yield _notes(tables, refused)


def _summary(
    tables: Sequence[WireTable],
    refused: Mapping[str, str],
    shown: Sequence[Ints],
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
    for table, kept in zip(tables, shown, strict=True):
        about = (len(table.curvature), len(kept), row_error(table, kept), stated.get(table.name))
        rows.append((table.name, *(column.value(table) for column in SUMMARY), *about))
    asks = "How stiff is each wire, when does it begin to slip, and how far does its law go?"
    return Sheet("wires", heads, rows, 1, asks=asks)


def _laws(
    tables: Sequence[WireTable], shown: Sequence[Ints]
) -> tuple[Sheet, dict[str, tuple[int, int]]]:
    """Laws of all wires below each other; first and last row of each by its name."""
    rows: list[Row] = []
    places: dict[str, tuple[int, int]] = {}
    for table, kept in zip(tables, shown, strict=True):
        columns = [
            (scale.factor * getattr(table, field)[kept]).tolist() for _, field, scale in _LAW
        ]
        first = len(rows)
        doubt = ["yes" if each else None for each in table.is_doubtful[kept]]
        rows += [(table.name, *row) for row in zip(*columns, doubt, strict=True)]
        places[table.name] = first, len(rows) - 1
    heads = ("wire", *(scale.label(words) for words, _, scale in _LAW), "doubtful")
    bent_only = {name: (first + 1, last) for name, (first, last) in places.items() if last > first}
    lines = {
        heads[up]: [Line(name, rows_of, 1, up) for name, rows_of in bent_only.items()]
        for up in (_SECANT, _MOMENT)
    }
    charts = [
        Chart(
            head.partition(" (")[0].capitalize(),
            CURVATURE.label("Curvature"),
            head,
            own,
            is_log=True,
        )
        for head, own in lines.items()
        if own
    ]
    asks = "What are moment and stiffness of each wire against curvature, on first loading?"
    return Sheet(_LAWS, heads, rows, 2, asks=asks, charts=charts), places


_MOMENT, _SECANT = 2, 8
"""Columns of the laws that are drawn."""


def _below(
    name: str,
    tables: Sequence[WireTable],
    columns: Sequence[tuple[str, str, Scale]],
    limit: Callable[[WireTable], float],
    asks: str,
) -> Sheet:
    """Values of all wires below each other, doubtful above a limit; drawn if there are two."""
    rows: list[Row] = []
    lines = []
    for table in tables:
        values = [(scale.factor * getattr(table, field)).tolist() for _, field, scale in columns]
        first = len(rows)
        doubt = ["yes" if each else None for each in getattr(table, columns[0][1]) > limit(table)]
        rows += [(table.name, *row) for row in zip(*values, doubt, strict=True)]
        if len(columns) == _DRAWN and len(rows) > first + 1:
            lines.append(Line(table.name, (first, len(rows) - 1), 1, 2))
    heads = ("wire", *(scale.label(words) for words, _, scale in columns), "doubtful")
    across, up = _capital(heads[1]), _capital(heads[len(columns)])
    charts = [Chart("", across, up, lines)] if lines else []
    return Sheet(name, heads, rows, 1, asks=asks, charts=charts)


_DRAWN = 2


def _capital(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}"


def _strands(tables: Sequence[WireTable]) -> Sheet:
    rows: list[Row] = []
    for table in tables:
        own = table.layout
        sizes = [(LENGTH.factor * each).tolist() for each in (own.x, own.y, own.diameter)]
        rows += [(table.name, *row) for row in zip(own.layer.tolist(), *sizes, strict=True)]
    heads = ("wire", "layer", *(LENGTH.label(word) for word in ("x", "y", "diameter")))
    return Sheet("strands", heads, rows, 1, asks="Where do the strands lie in the section?")


def _notes(tables: Sequence[WireTable], refused: Mapping[str, str]) -> Sheet:
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
    asks = "What was refused, limited or taken as a default?"
    heads = ("wire", "kind", "where", "what", "code")
    return Sheet("notes", heads, rows, 1, asks=asks, wrapped=("what",))
