"""From a sheet of wires to their laws: tables, simulation decks, figures, a workbook."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from labpipe import __version__
from labpipe.decks import deck_paths, write_decks
from labpipe.errors import ProcessingError, complaint
from labpipe.readers.wire_sheet import read_wire_sheet
from labpipe.records.wire import WireSpec, WireTable
from labpipe.report.wire_figures import own_figures, save_wire_figures
from labpipe.report.wire_workbook import save_wire_workbook
from labpipe.store.lock import locked
from labpipe.store.replace import replacing_together
from labpipe.wire.wire_table import wire_table

WORKBOOK_FILE = "wires.xlsx"
MODEL_FILE = "model.json"
FIGURES_FOLDER = "figures"
SCHEMA = 1

_WORTH_SHARING = 24
"""Wires beyond which a second process starts sooner than one alone is done."""


@dataclass(frozen=True, slots=True, eq=False)
class Modelled:
    """What became of the wires of a sheet.

    Parameters
    ----------
    sheet, folder : what was read, where the files are
    tables : of the wires that could be modelled, in the order of the sheet
    refused : name -> why, of those that could not
    files : all that were written, the workbook first
    """

    sheet: Path
    folder: Path
    tables: tuple[WireTable, ...]
    refused: Mapping[str, str]
    files: tuple[Path, ...]


def model_wires(
    sheet: Path,
    *,
    out: Path | None = None,
    figures: bool = True,
    say: Callable[[str], None] = lambda _: None,
) -> Modelled:
    """Model every wire of a sheet and write what was found.

    Parameters
    ----------
    sheet : xlsx or csv, one row per wire
    out : folder of the results; None for ``processed/<name of the sheet>`` in the working folder
    figures : whether to draw; those drawn before stay otherwise
    say : told the name of each wire as it is done, then each stage

    Returns
    -------
    Tables, refusals and files. The files of a wire that is refused now are taken away.

    Raises
    ------
    LabpipeError
        If the sheet has faults (all are told at once), no wire can be modelled, or the results
        cannot be written; earlier results are then as they were.
    """
    specs = read_wire_sheet(sheet)
    tables, refused = make_tables(specs, sheet, say)
    if not tables:
        raise ProcessingError("\n".join(refused.values()))
    folder = Path("processed") / sheet.stem if out is None else out
    modelled = Modelled(sheet, folder, tables, refused, ())
    with locked(folder), replacing_together(folder) as stage:
        written = _write(modelled, stage, say, figures=figures)
        files = tuple(folder / path.relative_to(stage) for path in written)
    _forget(folder, refused)
    return Modelled(sheet, folder, tables, refused, files)


def make_tables(
    specs: Sequence[WireSpec], sheet: Path, say: Callable[[str], None] = lambda _: None
) -> tuple[tuple[WireTable, ...], dict[str, str]]:
    """Model wires, many of them in two processes.

    Parameters
    ----------
    specs : rows of the sheet
    sheet : where they come from, for messages
    say : told the name of each wire as it is done

    Returns
    -------
    The tables in the order of the sheet, and by name why a wire could not be modelled.
    """
    tables: list[WireTable] = []
    refused: dict[str, str] = {}
    with _mapping(len(specs)) as mapped:
        for spec, outcome in zip(specs, mapped(_outcome, specs), strict=True):
            say(spec.name)
            if isinstance(outcome, WireTable):
                tables.append(outcome)
            else:
                refused[spec.name] = complaint(
                    sheet,
                    f"{spec.place}, wire '{spec.name}'",
                    expected="a wire that can be built and bent",
                    found=f"this: {outcome}",
                    remedy="Check its row against the wire.",
                )
    return tuple(tables), refused


_Outcome = WireTable | str


@contextmanager
def _mapping(
    count: int,
) -> Iterator[Callable[[Callable[[WireSpec], _Outcome], Sequence[WireSpec]], Iterator[_Outcome]]]:
    """``map`` in this process for a few wires, in two for many."""
    if count <= _WORTH_SHARING:
        yield map
        return
    with ProcessPoolExecutor(2) as pool:
        yield lambda work, specs: pool.map(work, specs, chunksize=4)


def _outcome(spec: WireSpec) -> _Outcome:
    """The table of a wire, or why there is none."""
    try:
        return wire_table(spec)
    except ValueError as error:
        return str(error)


def _write(
    modelled: Modelled, stage: Path, say: Callable[[str], None], *, figures: bool
) -> list[Path]:
    say("tables and decks")
    workbook, model = stage / WORKBOOK_FILE, stage / MODEL_FILE
    save_wire_workbook(modelled.tables, workbook, refused=modelled.refused)
    model.write_text(json.dumps(as_json(modelled)), encoding="utf-8")
    written = [workbook, model, *write_decks(modelled.tables, stage)]
    if figures:
        written += save_wire_figures(modelled.tables, stage / FIGURES_FOLDER, say=say)
    return written


def _forget(folder: Path, refused: Iterable[str]) -> None:
    """Take away the files of wires that are refused now: they would speak for another row."""
    for name in refused:
        drawn = [f"{stem}{ending}" for stem in own_figures(name) for ending in (".svg", ".png")]
        figures = [folder / FIGURES_FOLDER / file for file in drawn]
        for path in (*deck_paths(name, folder), *figures):
            path.unlink(missing_ok=True)


def as_json(modelled: Modelled) -> dict[str, object]:
    """What ``labpipe model --json`` prints: lists and plain numbers in SI units.

    Parameters
    ----------
    modelled : wires of a sheet
    """
    return {
        "schema": SCHEMA,
        "labpipe": __version__,
        "sheet": modelled.sheet.name,
        "wires": {table.name: _wire(table) for table in modelled.tables},
        "refused": dict(modelled.refused),
    }


_ARRAYS = (
    *("curvature", "moment", "secant_stiffness", "tangent_stiffness"),
    *("stick", "slip", "bending", "plastic", "insulation"),
    *("lowest_moment", "highest_moment", "slip_onsets"),
)


def _wire(table: WireTable) -> dict[str, object]:
    layout = table.layout
    return {
        "stick_stiffness": table.stick_stiffness,
        "slip_stiffness": table.slip_stiffness,
        "axial_stiffness": table.axial_stiffness,
        "torsional_stiffness": table.torsional_stiffness,
        **{name: getattr(table, name).tolist() for name in _ARRAYS},
        "cantilever": {
            "length": table.spec.length,
            "tip_deflection": table.tip_deflection.tolist(),
            "force": table.tip_force.tolist(),
        },
        "layout": {
            "kind": layout.kind,
            "x": layout.x.tolist(),
            "y": layout.y.tolist(),
            "layer": [int(number) for number in layout.layer],
            "diameter": layout.diameter.tolist(),
            "bore_radius": layout.bore_radius,
            "wire_radius": layout.wire_radius,
        },
        "notes": [asdict(note) for note in table.notes],
    }
