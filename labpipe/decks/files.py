"""The files of the decks: the one place here that writes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from labpipe.decks.abaqus import abaqus_deck
from labpipe.decks.ansys import ansys_deck
from labpipe.decks.lookup import lookup_csv, lookup_json
from labpipe.decks.mujoco import mujoco_deck
from labpipe.decks.names import file_stem
from labpipe.records.wire import WireTable

FOLDER = "decks"
"""Where the decks go, below the folder of results."""

DECKS: Mapping[str, Callable[[WireTable], str]] = {
    "csv": lookup_csv,
    "json": lookup_json,
    "abaqus.inp": abaqus_deck,
    "ansys.inp": ansys_deck,
    "mujoco.xml": mujoco_deck,
}
"""Ending of the file, and what writes its text."""


def write_decks(tables: Iterable[WireTable], folder: Path) -> list[Path]:
    """Write every deck of every wire to ``decks/<wire>.<ending>``.

    Parameters
    ----------
    tables : laws of the wires
    folder : of the results, which must be there

    Returns
    -------
    The files, wire by wire.

    Raises
    ------
    ValueError
        If a law cannot be put into a deck (see `thin`).
    """
    into = folder / FOLDER
    into.mkdir(exist_ok=True)
    written = []
    for table in tables:
        for ending, text_of in DECKS.items():
            path = into / f"{file_stem(table.name)}.{ending}"
            path.write_text(text_of(table), encoding="utf-8", newline="\n")
            written.append(path)
    return written
