"""The cards there are: those that come with labpipe, and a lab's own."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path

from labpipe.readers.files import reading, unreadable
from labpipe.readers.load_frame.card import Card, parse_card

LAB_FOLDER = "dialects"
"""Where a lab keeps its own cards, in the working folder beside ``protocols``."""


@cache
def shipped_cards(kind: str | None = None) -> Mapping[str, Card]:
    """Load the cards that come with labpipe, by name.

    Parameters
    ----------
    kind : of the exports, ``text`` or ``workbook``; None for all
    """
    return {
        name: parse_card(text, name=name, source=f"{name}.toml")
        for name, text in _shipped_texts().items()
        if kind is None or tomllib.loads(text).get("kind", "text") == kind
    }


def shipped_names() -> tuple[str, ...]:
    """Names of the cards that come with labpipe, in order."""
    return tuple(_shipped_texts())


@cache
def _shipped_texts() -> Mapping[str, str]:
    folder = resources.files("labpipe.readers.load_frame") / "dialects"
    texts = {
        file.name.removesuffix(".toml"): file.read_text(encoding="utf-8")
        for file in folder.iterdir()
        if file.name.endswith(".toml")
    }
    return dict(sorted(texts.items()))


def lab_cards(folder: Path | None = None) -> Mapping[str, Card]:
    """Load a lab's own cards, by name.

    Parameters
    ----------
    folder : where they lie; ``dialects`` in the working folder if None

    Raises
    ------
    ReadError
        If a card is wrong, or has the name of one that comes with labpipe.
    """
    own = Path(LAB_FOLDER) if folder is None else folder
    files = sorted(own.glob("*.toml")) if own.is_dir() else []
    return {file.stem: _lab_card(file) for file in files}


def _lab_card(file: Path) -> Card:
    if file.stem in shipped_names():
        raise unreadable(
            file,
            "",
            "a name of its own",
            f"'{file.stem}', which is a card of labpipe",
            "Rename the file, and name the new dialect in the protocol.",
        )
    with reading(file, "a card in UTF-8", remedy="Save it as UTF-8."):
        text = file.read_text(encoding="utf-8")
    return parse_card(text, name=file.stem, source=file)
