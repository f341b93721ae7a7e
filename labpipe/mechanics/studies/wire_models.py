"""Run ``labpipe model``: write laws, decks and figures of the wires of a sheet."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from labpipe import __version__
from labpipe.errors import ProcessingError, UsageError
from labpipe.mechanics.decks import list_deck_paths, make_deck_texts, write_decks
from labpipe.mechanics.studies.study_files import FIGURES_FOLDER, write_study
from labpipe.mechanics.studies.wire_sheets import (
    StressCurve,
    build_wire_error,
    describe_stress_tables,
    read_wire_sheet,
)
from labpipe.mechanics.wire.wire_table import tabulate_wire
from labpipe.records.wire import WireSpec, WireTable
from labpipe.report.wire_report import list_figure_names, list_wire_figures, save_wire_workbook
from labpipe.store.summaries import select_json

MODEL_WORKBOOK = "wires.xlsx"
MODEL_FILE = "model.json"
MODEL_SCHEMA = 1
"""Version of the format of ``model.json``."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelledWires:
    """Modelled wires of a sheet.

    Parameters
    ----------
    sheet : path of the wire sheet
    folder : folder of the results
    tables : tables of the wires that could be modelled, in the order of the sheet
    refused : reason why a wire could not be modelled, keyed by its name
    files : paths of the files that were written
    removed : names of wires of an earlier run that are no longer in the sheet, and whose files were
        removed
    curves : stress tables, keyed by name of the wire and then by column of the sheet
    """

    sheet: Path
    folder: Path
    tables: tuple[WireTable, ...]
    refused: Mapping[str, str]
    files: tuple[Path, ...]
    removed: tuple[str, ...] = ()
    curves: Mapping[str, Mapping[str, StressCurve]] = field(default_factory=dict)


def model_wires(
    sheet: Path,
    *,
    out: Path | None = None,
    figures: bool = True,
    png: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> ModelledWires:
    """Model every wire of a sheet and write the results.

    Parameters
    ----------
    sheet : path of the wire sheet, a workbook or a CSV file with one row for each wire
    out : folder of the results; None for ``processed/<name of the sheet>`` in the working folder
    figures : whether figures are drawn; otherwise figures of an earlier run are kept
    png : whether figures are also written as PNG; otherwise PNG files of an earlier run are removed
    say : function that is called with the name of each modelled wire, then with each stage

    Returns
    -------
    The modelled wires and their files. Files of an earlier run are removed if their wires are
    refused or no longer in the sheet.

    Raises
    ------
    LabpipeError
        If the sheet has faults (the message lists all of them), no wire can be modelled, or the
        results cannot be written. Earlier results are then unchanged.
    """
    folder = Path("processed") / sheet.stem if out is None else out
    for file in (folder / MODEL_WORKBOOK, folder / MODEL_FILE):
        if file.resolve() == sheet.resolve():
            raise UsageError.about("mechanics.studies.sheet_in_results", sheet, file=file)
    wire_sheet = read_wire_sheet(sheet)
    modelled_wires, refusals = tabulate_wires(wire_sheet.specs, sheet, say)
    if not modelled_wires:
        raise ProcessingError("\n".join(refusals.values()))
    tables = tuple(table for table, _ in modelled_wires)
    removed_wires = _find_removed_wires(folder, [spec.name for spec in wire_sheet.specs])
    modelled = ModelledWires(sheet, folder, tables, refusals, (), removed_wires, wire_sheet.curves)
    say("tables and decks")
    descriptions = {name: describe_stress_tables(item) for name, item in wire_sheet.curves.items()}

    def write_others(folder: Path) -> list[Path]:
        """Write the workbook and the decks into a folder, and return their paths."""
        texts_by_wire = {table.name: texts for table, texts in modelled_wires}
        deck_paths, workbook_path = write_decks(texts_by_wire, folder), folder / MODEL_WORKBOOK
        save_wire_workbook(tables, workbook_path, refusals=refusals, stress_tables=descriptions)
        return [workbook_path, *deck_paths]

    files = write_study(
        folder,
        {MODEL_FILE: json.dumps(build_json(modelled))},
        [*list_wire_figures(tables)] if figures else (),
        earlier_files=_list_wire_files((*refusals, *removed_wires)),
        write_others=write_others,
        say=say,
        png=png,
    )
    return replace(modelled, files=files)


def tabulate_wires(
    specs: Sequence[WireSpec], sheet: Path, say: Callable[[str], None] = lambda _: None
) -> tuple[list[tuple[WireTable, tuple[str, ...]]], dict[str, str]]:
    """Tabulate the laws of wires, and make the texts of their decks.

    Parameters
    ----------
    specs : specifications of the wires
    sheet : path of the wire sheet, for messages
    say : function that is called with the name of each wire

    Returns
    -------
    modelled_wires : for each wire that could be modelled, in the order of `specs`, its law, and the
        texts of its decks from `labpipe.mechanics.decks.make_deck_texts`
    refusals : reason why a wire could not be modelled, keyed by its name
    """
    modelled_wires, refusals = [], {}
    for spec in specs:
        say(spec.name)
        try:
            table = tabulate_wire(spec)
            modelled_wires.append((table, make_deck_texts(table)))
        except ValueError as reason:
            error = build_wire_error(sheet, spec, "a wire that can be built and bent", reason)
            refusals[spec.name] = str(error)
    return modelled_wires, refusals


def _find_removed_wires(folder: Path, names: Sequence[str]) -> tuple[str, ...]:
    """Find the wires that an earlier run modelled in a folder and that are not among `names`."""
    try:
        earlier_wires = json.loads((folder / MODEL_FILE).read_text(encoding="utf-8"))["wires"]
        return tuple(name for name in earlier_wires if name not in names)
    except (OSError, ValueError, KeyError, TypeError):
        return ()  # there is no file, or labpipe did not write it


def _list_wire_files(names: Iterable[str]) -> list[str]:
    """List the paths of all files of given wires, relative to the folder of the results."""
    files: list[str] = []
    for name in names:
        files += [path.as_posix() for path in list_deck_paths(name, Path())]
        stems = [f"{FIGURES_FOLDER}/{stem}" for stem in list_figure_names(name)]
        files += [f"{stem}{ending}" for stem in stems for ending in (".svg", ".png")]
    return files


def build_json(modelled: ModelledWires) -> dict[str, object]:
    """Build the content of ``model.json``, with values in SI units.

    Parameters
    ----------
    modelled : modelled wires of a sheet
    """
    return {
        "schema": MODEL_SCHEMA,
        "labpipe": __version__,
        "sheet": modelled.sheet.name,
        "wires": {
            table.name: _build_wire_json(table, modelled.curves.get(table.name, {}))
            for table in modelled.tables
        },
        "refused": dict(modelled.refused),
    }


_TABLE_FIELDS = (
    *("stick_stiffness", "slip_stiffness", "axial_stiffness", "torsional_stiffness"),
    *("free_torsional_stiffness", "stretch_twist_coupling", "mass_per_length"),
    *("curvature", "moment", "secant_stiffness", "tangent_stiffness"),
    *("stick", "slip", "bending", "plastic", "insulation", "insulation_share"),
    *("lowest_moment", "highest_moment", "slip_onsets", "layout", "notes"),
)
"""Fields of `WireTable` in ``model.json``."""


def _build_wire_json(table: WireTable, curves: Mapping[str, StressCurve]) -> dict[str, object]:
    """Build the entry of a wire; `curves` are its stress tables, keyed by column of the sheet."""
    names = "tip_deflection", "doubtful_deflection", "rest"
    cantilever = select_json(table, *names, force="tip_force")
    return {
        **select_json(table, *_TABLE_FIELDS),
        "doubtful_curvature": table.doubtful_curvature if table.is_doubtful.any() else None,
        "cantilever": {"length": table.spec.length, **cantilever},
        "stress_tables": {column: curve.build_json() for column, curve in curves.items()},
    }
