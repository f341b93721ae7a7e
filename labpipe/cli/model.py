"""``labpipe model``: stiffness tables and simulation decks of wires."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence

import numpy as np

from labpipe.cli.terminal import shorten_path, show_reading
from labpipe.mechanics.studies.wire_models import ModelledWires, as_json, model_wires
from labpipe.mechanics.studies.wire_sheets import describe_stress_tables
from labpipe.mechanics.wire.first_loading import interpolate_end_load
from labpipe.records.quality import Severity
from labpipe.records.wire import WireTable

_HEADING = (
    *("wire", "strands", "layout", "EI stick", "EI slip"),
    *("first slip", "range", "force at 0.3 L"),
)
_UNITS = ("", "", "", "N mm^2", "N mm^2", "1/m", "1/m", "N")
_TIP_DEFLECTION_SHARE = 0.3
"""Share of the free length: the tip deflection at which the force is printed."""


def run(options: argparse.Namespace) -> int:
    """Turn a sheet of wires into moment-curvature and stiffness tables."""
    with show_reading(1) as say:
        modelled = model_wires(
            options.sheet, out=options.out, figures=not options.no_figures, png=options.png, say=say
        )
    print(json.dumps(as_json(modelled)) if options.json else format_wire_models(modelled))
    for reason in modelled.refused.values():
        print(f"labpipe model: {reason}", file=sys.stderr)
    return 1 if modelled.refused else 0


def format_wire_models(modelled: ModelledWires) -> str:
    """Format the main numbers of modelled wires for a terminal.

    Parameters
    ----------
    modelled : the wires of a sheet

    Returns
    -------
    A line per wire, each note once, then the folder of the files.
    """
    rows = [_HEADING, _UNITS, *(_format_cells(table) for table in modelled.tables)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(_HEADING))]
    lines = [_format_line(row, widths) for row in rows]
    lines += ["", *_format_notes(modelled.tables), *_format_stress_tables(modelled)]
    if modelled.refused:
        names = _join_names(tuple(modelled.refused), 0)
        lines.append(f"  not modelled: {names} (reasons below)")
    if modelled.removed:
        names = _join_names(modelled.removed, 0)
        lines.append(f"  no longer in the sheet, files removed: {names}")
    lines.append(f"results: {shorten_path(modelled.folder)}")
    return "\n".join(lines)


def _format_cells(table: WireTable) -> tuple[str, ...]:
    onset = table.slip_onset(0)
    return (
        table.name,
        str(len(table.layout.x)),
        table.layout.kind,
        f"{1e6 * table.stick_stiffness:.5g}",
        f"{1e6 * table.slip_stiffness:.5g}",
        onset if isinstance(onset, str) else f"{onset:.3g}",
        f"{table.curvature[-1]:.4g}",
        _format_force(table),
    )


def _format_force(table: WireTable) -> str:
    """Return the end load at the deflection of the heading; a dash beyond the curve."""
    force = interpolate_end_load(table, _TIP_DEFLECTION_SHARE * table.spec.length)
    return "-" if np.isnan(force) else f"{force:.4g}"


def _format_line(row: Sequence[str], widths: Sequence[int]) -> str:
    text_columns = 3  # left-aligned
    cells = [
        f"{cell:<{width}}" if column < text_columns else f"{cell:>{width}}"
        for column, (cell, width) in enumerate(zip(row, widths, strict=True))
    ]
    return "  ".join(cells).rstrip()


def _format_notes(tables: Sequence[WireTable]) -> list[str]:
    """List each note once with its wires; warnings first."""
    wires: dict[tuple[Severity, str], list[str]] = {}
    for table in tables:
        for note in table.notes:
            wires.setdefault((note.severity, note.message), []).append(table.name)
    order = sorted(wires, key=lambda key: key[0] is Severity.INFO)
    return [
        f"  {severity}: {message}  [{_join_names(wires[severity, message], len(tables))}]"
        for severity, message in order
    ]


def _format_stress_tables(modelled: ModelledWires) -> list[str]:
    """List stress tables with the wires that use them."""
    wires: dict[str, list[str]] = {}
    for table in modelled.tables:
        if curves := modelled.curves.get(table.name):
            wires.setdefault(describe_stress_tables(curves), []).append(table.name)
    count = len(modelled.tables)
    return [f"  info: {tables}  [{_join_names(names, count)}]" for tables, names in wires.items()]


def _join_names(names: Sequence[str], count: int) -> str:
    """List the first wires; the workbook lists all."""
    max_names = 10
    if len(names) <= max_names:
        return ", ".join(names)
    if len(names) == count:
        return f"all {count} wires"
    return f"{', '.join(names[:max_names])} and {len(names) - max_names} more"
