"""Study of ``labpipe model``: moment-curvature laws, decks and figures of the wires of a sheet."""

from __future__ import annotations

import gc
import json
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from labpipe import __version__
from labpipe.errors import ProcessingError, UsageError
from labpipe.mechanics.decks import list_deck_paths, make_deck_texts, write_texts
from labpipe.mechanics.studies.study_files import FIGURES_FOLDER, write_study
from labpipe.mechanics.studies.wire_sheets import (
    StatedCurve,
    build_wire_error,
    describe_stress_tables,
    read_wire_sheet,
)
from labpipe.mechanics.wire.wire_table import tabulate_wire
from labpipe.records.wire import WireSpec, WireTable
from labpipe.report.wire_report import list_figure_names, list_wire_figures, save_wire_workbook
from labpipe.store.summaries import select_json

WORKBOOK_FILE = "wires.xlsx"
MODEL_FILE = "model.json"
SCHEMA = 1
"""Version of the format of ``model.json``."""

_MIN_PARALLEL_WIRES = 24
"""Number of wires above which two worker processes are faster than one process."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelledWires:
    """The modelled wires of a sheet.

    Parameters
    ----------
    sheet, folder : path of the wire sheet, and folder of the results
    tables : tables of the wires that could be modelled, in the order of the sheet
    refused : reason why a wire could not be modelled, keyed by its name
    files : paths of the files that were written
    removed : names of wires of an earlier run that are no longer in the sheet; their files were
        removed
    curves : stress tables of each wire, keyed by its name and then by column of the sheet
    """

    sheet: Path
    folder: Path
    tables: tuple[WireTable, ...]
    refused: Mapping[str, str]
    files: tuple[Path, ...]
    removed: tuple[str, ...] = ()
    curves: Mapping[str, Mapping[str, StatedCurve]] = field(default_factory=dict)


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
    sheet : path of the sheet, a workbook or a CSV file with one row for each wire
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
        If the sheet has faults (all are reported at once), no wire can be modelled, or the results
        cannot be written; earlier results are then unchanged.
    """
    folder = Path("processed") / sheet.stem if out is None else out
    for file in (folder / WORKBOOK_FILE, folder / MODEL_FILE):
        if file.resolve() == sheet.resolve():
            raise UsageError.about("mechanics.studies.sheet_in_results", sheet, file=file)
    wire_sheet = read_wire_sheet(sheet)
    with _open_pool(len(wire_sheet.specs), sheet) as pool:
        wires, refused = make_tables(wire_sheet.specs, sheet, say, pool)
        if not wires:
            raise ProcessingError("\n".join(refused.values()))
        tables = tuple(wire.table for wire in wires)
        removed = _find_removed_wires(folder, [spec.name for spec in wire_sheet.specs])
        modelled = ModelledWires(sheet, folder, tables, refused, (), removed, wire_sheet.curves)
        say("tables and decks")
        descriptions = {
            name: describe_stress_tables(curves) for name, curves in wire_sheet.curves.items()
        }

        def write_others(folder: Path) -> list[Path]:
            """Write the decks and the workbook; a pool writes the workbook at the same time."""
            workbook = folder / WORKBOOK_FILE
            save = partial(
                save_wire_workbook, tables, workbook, refusals=refused, stress_tables=descriptions
            )
            future = pool.submit(save) if pool else None
            decks = write_texts({wire.table.name: wire.decks for wire in wires}, folder)
            save() if future is None else future.result()
            return [workbook, *decks]

        files = write_study(
            folder,
            {MODEL_FILE: json.dumps(build_json(modelled))},
            [*list_wire_figures(tables)] if figures else (),
            earlier_files=_list_wire_files((*refused, *removed)),
            write_others=write_others,
            say=say,
            png=png,
        )
    return replace(modelled, files=files)


@dataclass(frozen=True, slots=True, eq=False)
class ModelledWire:
    """A wire that could be modelled.

    Parameters
    ----------
    table : moment-curvature law of the wire
    decks : texts for simulation programs, from `labpipe.mechanics.decks.make_deck_texts`
    """

    table: WireTable
    decks: tuple[str, ...]


def make_tables(
    specs: Sequence[WireSpec],
    sheet: Path,
    say: Callable[[str], None] = lambda _: None,
    pool: Executor | None = None,
) -> tuple[tuple[ModelledWire, ...], dict[str, str]]:
    """Model wires and make the texts of their decks.

    Parameters
    ----------
    specs : specifications of the wires
    sheet : path of the wire sheet, for messages
    say : function that is called with the name of each wire
    pool : pool of worker processes; None to model the wires in this process

    Returns
    -------
    modelled_wires : wires that could be modelled, in the order of `specs`
    refused : reason why a wire could not be modelled, keyed by its name
    """
    modelled_wires: list[ModelledWire] = []
    refused: dict[str, str] = {}
    outcomes = pool.map(_model_wire, specs, chunksize=4) if pool else map(_model_wire, specs)
    for spec, outcome in zip(specs, outcomes, strict=True):
        say(spec.name)
        if isinstance(outcome, ModelledWire):
            modelled_wires.append(outcome)
        else:
            error = build_wire_error(sheet, spec, "a wire that can be built and bent", outcome)
            refused[spec.name] = str(error)
    return tuple(modelled_wires), refused


@contextmanager
def _open_pool(n_wires: int, sheet: Path) -> Iterator[Executor | None]:
    """Start two worker processes for a sheet of many wires; yield None for a short sheet."""
    if n_wires <= _MIN_PARALLEL_WIRES:
        yield None
        return
    pool = ProcessPoolExecutor(2, initializer=_init_worker)
    try:
        yield pool
    except BrokenProcessPool as error:
        raise ProcessingError.about("mechanics.studies.process_killed", sheet) from error
    finally:
        pool.shutdown(cancel_futures=True)


def _init_worker() -> None:
    """Leave interrupts to the parent process, and speed up memory management.

    The model of a wire has no reference cycles, so garbage collection is not needed. Once a large
    block has been freed, the C library keeps freed blocks up to that size; otherwise it would
    return memory to the system about twenty times for each wire.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.disable()
    bytearray(30_000_000)


def _model_wire(spec: WireSpec) -> ModelledWire | str:
    """Model a wire and make its decks, or return the reason why it cannot be modelled."""
    try:
        table = tabulate_wire(spec)
        return ModelledWire(table, make_deck_texts(table))
    except ValueError as error:
        return str(error)


def _find_removed_wires(folder: Path, names: Sequence[str]) -> tuple[str, ...]:
    """Find the wires of an earlier run in a folder that are not among given names."""
    try:
        earlier_wires = json.loads((folder / MODEL_FILE).read_text(encoding="utf-8"))["wires"]
        return tuple(name for name in earlier_wires if name not in names)
    except (OSError, ValueError, KeyError, TypeError):
        return ()  # there is no file, or it is not one of labpipe


def _list_wire_files(names: Iterable[str]) -> list[str]:
    """List the paths of all files of some wires, relative to the folder of the results."""
    files: list[str] = []
    for name in names:
        files += [path.as_posix() for path in list_deck_paths(name, Path())]
        stems = [f"{FIGURES_FOLDER}/{stem}" for stem in list_figure_names(name)]
        files += [f"{stem}{ending}" for stem in stems for ending in (".svg", ".png")]
    return files


def build_json(modelled: ModelledWires) -> dict[str, object]:
    """Build the content of ``labpipe model --json``: lists and numbers in SI units.

    Parameters
    ----------
    modelled : modelled wires of a sheet
    """
    return {
        "schema": SCHEMA,
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


def _build_wire_json(table: WireTable, curves: Mapping[str, StatedCurve]) -> dict[str, object]:
    """Build the entry of a wire; `curves` are its stress tables, keyed by column of the sheet."""
    names = "tip_deflection", "doubtful_deflection", "rest"
    cantilever = select_json(table, *names, force="tip_force")
    return {
        **select_json(table, *_TABLE_FIELDS),
        "doubtful_curvature": table.doubtful_curvature if table.is_doubtful.any() else None,
        "cantilever": {"length": table.spec.length, **cantilever},
        "stress_tables": {column: curve.build_json() for column, curve in curves.items()},
    }
