"""Write the law of a wire as input files of simulation programs ("decks").

Each deck that contains a law states the range of curvature in which the law is valid.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from labpipe.mechanics.decks.beam_sections import format_abaqus_deck, format_ansys_deck
from labpipe.mechanics.decks.calculix import format_calculix_deck
from labpipe.mechanics.decks.deck_law import make_file_stem
from labpipe.mechanics.decks.lookup import (
    format_lookup_csv,
    format_lookup_json,
    format_sliders_csv,
    format_sliders_json,
)
from labpipe.mechanics.decks.mujoco import format_cable_deck
from labpipe.mechanics.decks.mujoco_sliders import format_plane_deck, format_space_deck
from labpipe.records.wire import WireTable

FOLDER = "decks"
"""Folder of the decks, below that of the results."""

DECKS: Mapping[str, Callable[[WireTable], str]] = {
    "csv": format_lookup_csv,
    "json": format_lookup_json,
    "abaqus.inp": format_abaqus_deck,
    "ansys.inp": format_ansys_deck,
    "calculix.inp": format_calculix_deck,
    "mujoco.xml": format_cable_deck,
    "mujoco-plane.xml": format_plane_deck,
    "mujoco-space.xml": format_space_deck,
    "sliders.csv": format_sliders_csv,
    "sliders.json": format_sliders_json,
}
"""Functions that return the text of a deck, keyed by the ending of the deck's file name."""


def make_deck_texts(table: WireTable) -> tuple[str, ...]:
    """Return the texts of the decks of a wire, in the order of `DECKS`.

    Parameters
    ----------
    table : table of the wire

    Raises
    ------
    ValueError
        If a deck cannot represent the law, or the mass per length is not positive. The message
        names the deck.
    """
    texts = []
    for ending, format_deck in DECKS.items():
        try:
            texts.append(format_deck(table))
        except ValueError as error:
            message = f"its deck {ending} cannot be made: {error}"
            raise ValueError(message) from error
    return tuple(texts)


def write_decks(texts_by_wire: Mapping[str, Sequence[str]], folder: Path) -> list[Path]:
    """Write every deck of every wire to ``decks/<stem>.<ending>``.

    Parameters
    ----------
    texts_by_wire : texts from `make_deck_texts`, keyed by the name of the wire
    folder : folder of the results, which must exist

    Returns
    -------
    Paths of the files, wire by wire. `make_file_stem` makes the stems.
    """
    (folder / FOLDER).mkdir(exist_ok=True)
    written_paths = []
    for name, deck_texts in texts_by_wire.items():
        paths = list_deck_paths(name, folder)
        for path, text in zip(paths, deck_texts, strict=True):
            path.write_text(text, encoding="utf-8", newline="\n")
        written_paths += paths
    return written_paths


def list_deck_paths(name: str, folder: Path) -> list[Path]:
    """Return the paths of the decks of a wire, in the order of `DECKS`.

    Parameters
    ----------
    name : name of the wire
    folder : folder of the results
    """
    return [folder / FOLDER / f"{make_file_stem(name)}.{ending}" for ending in DECKS]
