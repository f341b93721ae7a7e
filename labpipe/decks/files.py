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
    (folder / FOLDER).mkdir(exist_ok=True)
    written = []
    for table in tables:
        paths = deck_paths(table.name, folder)
        for path, text_of in zip(paths, DECKS.values(), strict=True):
            path.write_text(text_of(table), encoding="utf-8", newline="\n")
        written += paths
    return written


def deck_paths(name: str, folder: Path) -> list[Path]:
    """Files of the decks of a wire, in the order of `DECKS`.

    Parameters
    ----------
    name : of the wire
    folder : of the results
    """
    return [folder / FOLDER / f"{file_stem(name)}.{ending}" for ending in DECKS]
