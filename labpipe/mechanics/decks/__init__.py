"""Write input files of simulation programs ("decks") for the law of a wire.

Each deck with a law states the range of curvature in which it is valid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from labpipe.mechanics.decks.beam_sections import write_abaqus_deck, write_ansys_deck
from labpipe.mechanics.decks.calculix import write_calculix_deck
from labpipe.mechanics.decks.deck_law import make_file_stem
from labpipe.mechanics.decks.lookup import (
    write_lookup_csv,
    write_lookup_json,
    write_sliders_csv,
    write_sliders_json,
)
from labpipe.mechanics.decks.mujoco import write_mujoco_deck
from labpipe.mechanics.decks.mujoco_sliders import write_mujoco_plane_deck, write_mujoco_space_deck
from labpipe.records.wire import WireTable

FOLDER = "decks"
"""Folder of the decks, below that of the results."""

DECKS: Mapping[str, Callable[[WireTable], str]] = {
    "csv": write_lookup_csv,
    "json": write_lookup_json,
    "abaqus.inp": write_abaqus_deck,
    "ansys.inp": write_ansys_deck,
    "calculix.inp": write_calculix_deck,
    "mujoco.xml": write_mujoco_deck,
    "mujoco-plane.xml": write_mujoco_plane_deck,
    "mujoco-space.xml": write_mujoco_space_deck,
    "sliders.csv": write_sliders_csv,
    "sliders.json": write_sliders_json,
}
"""Function that returns the text of a deck, keyed by the ending of its file."""


def make_deck_texts(table: WireTable) -> tuple[str, ...]:
    """Return the texts of the decks of a wire, in the order of `DECKS`.

    Parameters
    ----------
    table : table of the wire

    Raises
    ------
    ValueError
        If a deck cannot be made from the law (as for `thin_law`) or the mass; the message names the
        deck.
    """
    texts = []
    for ending, write in DECKS.items():
        try:
            texts.append(write(table))
        except ValueError as error:
            message = f"its deck {ending} cannot be made: {error}"
            raise ValueError(message) from error
    return tuple(texts)


def write_decks(tables: Iterable[WireTable], folder: Path) -> list[Path]:
    """Write every deck of every wire to ``decks/<stem>.<ending>``; `make_file_stem` makes the stem.

    Parameters
    ----------
    tables : tables of the wires
    folder : folder of the results, which must exist

    Returns
    -------
    The files, wire by wire.

    Raises
    ------
    ValueError
        As `make_deck_texts`.
    """
    return write_texts({table.name: make_deck_texts(table) for table in tables}, folder)


def write_texts(texts: Mapping[str, Sequence[str]], folder: Path) -> list[Path]:
    """Write texts of decks to their files.

    Parameters
    ----------
    texts : texts of `make_deck_texts`, keyed by the name of the wire
    folder : folder of the results, which must exist

    Returns
    -------
    The files, wire by wire.
    """
    (folder / FOLDER).mkdir(exist_ok=True)
    written = []
    for name, deck_texts in texts.items():
        paths = list_deck_paths(name, folder)
        for path, text in zip(paths, deck_texts, strict=True):
            path.write_text(text, encoding="utf-8", newline="\n")
        written += paths
    return written


def list_deck_paths(name: str, folder: Path) -> list[Path]:
    """Return the files of the decks of a wire, in the order of `DECKS`.

    Parameters
    ----------
    name : name of the wire
    folder : folder of the results
    """
    return [folder / FOLDER / f"{make_file_stem(name)}.{ending}" for ending in DECKS]
