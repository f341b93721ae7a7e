"""A text export: its file, its card, its lines, and its decimal sign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from labpipe.errors import ReadError, complaint
from labpipe.readers.channels import Wanted
from labpipe.readers.load_frame.card import Card
from labpipe.records.quality import QualityNote, Severity


@dataclass(frozen=True, slots=True)
class Place:
    """Where a text export is read from.

    Parameters
    ----------
    path : of the file, for messages
    card : how it is read
    channels : asked for, None for all
    """

    path: Path
    card: Card
    channels: Sequence[Wanted] | None = None


def no_samples(message: str) -> QualityNote:
    """Note that an export is whole and holds no sample."""
    return QualityNote("no_samples", Severity.WARNING, "file", message)


def lines_of(text: str) -> list[str]:
    """Give the lines of a text without their ends."""
    return [line.rstrip("\r") for line in text.split("\n")]


def line_start(data: bytes, lines: int) -> int:
    """Find where the line with this number, counted from 0, begins."""
    at = 0
    for _ in range(lines):
        end = data.find(b"\n", at)
        if end < 0:
            return len(data)
        at = end + 1
    return at


def decimal_of(head: str, place: Place) -> str:
    """Find the decimal sign: that of the card, or as the export states it.

    Parameters
    ----------
    head : beginning of the export
    place : file and card

    Returns
    -------
    The sign, or ``auto``.

    Raises
    ------
    ReadError
        If the export should state it and does not.
    """
    pattern = place.card.decimal_pattern
    if pattern is None:
        return place.card.decimal
    match = pattern.search(head)
    if match is not None and match[1] in {".", ","}:
        return match[1]
    text = complaint(
        place.path,
        "line 1",
        expected="the decimal sign that this program states",
        found=f"'{head[:60].splitlines()[0] if head else ''}'",
        remedy="Export the test again, or name another dialect.",
    )
    raise ReadError(text)
