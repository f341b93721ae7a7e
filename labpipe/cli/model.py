"""``labpipe model``: compute stiffness tables and simulation decks of wires."""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict

import numpy as np

from labpipe.campaign.queries import align_columns, join_names
from labpipe.cli.terminal import shorten_path, show_completion
from labpipe.mechanics.studies.wire_models import ModelledWires, build_json, model_wires
from labpipe.mechanics.studies.wire_sheets import describe_stress_tables
from labpipe.mechanics.wire.first_loading import interpolate_end_load
from labpipe.records.quality import Severity
from labpipe.records.wire import WireTable

_TABLE_HEADINGS = (
    *("wire", "strands", "layout", "EI stick", "EI slip"),
    *("first slip", "range", "force at 0.3 L"),
)
_TABLE_UNITS = ("", "", "", "N mm^2", "N mm^2", "1/m", "1/m", "N")
_MAX_NAMES = 10
"""Largest number of wires that a line names; a note on all of more wires says so instead."""
_RELATIVE_TIP_DEFLECTION = 0.3
"""Tip deflection at which the force is printed, as a fraction of the free length."""


def run(options: argparse.Namespace) -> int:
    """Model the wires of a sheet and print the results; return 1 if a wire is refused."""
    with show_completion("wire", in_pipe=False) as (_, say):
        wires = model_wires(
            options.sheet, out=options.out, figures=not options.no_figures, png=options.png, say=say
        )
    print(json.dumps(build_json(wires)) if options.json else format_wire_models(wires))
    for reason in wires.refused.values():
        print(f"labpipe model: {reason}", file=sys.stderr)
    return 1 if wires.refused else 0


def format_wire_models(wires: ModelledWires) -> str:
    """Format the main results of modelled wires for a terminal.

    Parameters
    ----------
    wires : modelled wires of a sheet

    Returns
    -------
    The text: a table with a row per wire, each note and stress table once, wires without a model,
    wires that are no longer in the sheet, and the folder of the files.
    """
    n_text_columns = 3
    rows = [_TABLE_HEADINGS, _TABLE_UNITS, *map(_format_cells, wires.tables)]
    lines = align_columns(zip(*rows, strict=True), n_text_columns)
    wires_by_note = defaultdict[str, list[str]](list)
    for table in wires.tables:
        for note in table.notes:
            wires_by_note[f"{note.severity}: {note.message}"].append(table.name)
    notes = sorted(wires_by_note, key=lambda note: note.startswith(f"{Severity.INFO}: "))
    for table in wires.tables:
        if curves := wires.curves.get(table.name):
            wires_by_note[f"info: {describe_stress_tables(curves)}"].append(table.name)
    lines.append("")
    for text in dict.fromkeys([*notes, *wires_by_note]):
        names = wires_by_note[text]
        has_every_wire = len(names) == len(wires.tables) > _MAX_NAMES
        label = f"all {len(names)} wires" if has_every_wire else join_names(names, _MAX_NAMES)
        lines.append(f"  {text}  [{label}]")
    if wires.refused:
        lines.append(f"  not modelled: {join_names([*wires.refused], _MAX_NAMES)} (reasons below)")
    if wires.removed:
        removed_names = join_names(wires.removed, _MAX_NAMES)
        lines.append(f"  no longer in the sheet, files removed: {removed_names}")
    return "\n".join([*lines, f"results: {shorten_path(wires.folder)}"])


def _format_cells(table: WireTable) -> tuple[str, ...]:
    """Format the table row of a wire, with a dash for an end load that is not available."""
    onset = table.find_slip_onset(0)
    force = float(interpolate_end_load(table, _RELATIVE_TIP_DEFLECTION * table.spec.length))
    return (
        table.name,
        str(len(table.layout.x)),
        table.layout.kind,
        f"{1e6 * table.stick_stiffness:.5g}",
        f"{1e6 * table.slip_stiffness:.5g}",
        onset if isinstance(onset, str) else f"{onset:.3g}",
        f"{table.curvature[-1]:.4g}",
        "-" if np.isnan(force) else f"{force:.4g}",
    )
