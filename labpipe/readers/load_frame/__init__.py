"""Reader of load-frame exports: one reader, and a card of data per vendor's program.

**Writes this file**: the programs of the cards in ``dialects``: MTS TestSuite and 793, Instron
Bluehill and 8800, ZwickRoell testXpert, Lloyd Nexygen, Shimadzu Trapezium, Walter+Bai Dion, HBM
catman, Deben Microtest, TA Instruments DMA Q800, TestResources; a lab adds its own.

**Recording**: the channels of one test; with several specimens, each on its own clock.

**Units**: `unit_in_file` as in the export, values in that unit; time in seconds.

**Missing data**: blank cells and the codes of the card become NaN, noted per channel.

**Clock and frame**: the time column as written, in seconds; row numbers if there is none.

**File structure**: as in the card; see docs/how-to/new-dialect.md.

**Known versions**: as in the cards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from labpipe.readers.channels import ReportOptions
from labpipe.readers.load_frame.cards import Card
from labpipe.readers.load_frame.frame_recording import (
    Export,
    Table,
    assemble,
    choose_part,
    without_codes,
    without_last_row,
)
from labpipe.readers.load_frame.frame_workbook import read_sheets
from labpipe.readers.load_frame.recognition import CardNames, choose_card, recognise_card
from labpipe.readers.load_frame.text_layouts import Place, read_tables
from labpipe.readers.raw_files import read_content
from labpipe.readers.workbooks import forget_sheets, open_sheets
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Recording
from labpipe.units import whole_number

__all__ = ["read", "recognise"]


def recognise(path: Path) -> bool:
    """Return whether the content of a file fits a card of a load frame."""
    return recognise_card(path) is not None


def read(
    path: Path,
    *,
    channels: Sequence[ReportOptions] | None = None,
    dialect: CardNames = None,
    part: str | None = None,
) -> Recording:
    """Read a load-frame export.

    Parameters
    ----------
    path : the export
    channels : names or paths wanted, None for all
    dialect : name of the card, or cards, that must fit; None for any
    part : wanted specimen or sheet of an export with several, None for all

    Returns
    -------
    The recording. A file with only a byte order mark gives a recording without clocks and
    channels, and the note ``no_samples``.

    Raises
    ------
    ReadError
        If no allowed card fits, names, units or numbers are not where the card states, a cell is
        not a number, or a wanted channel or part does not exist.
    """
    card = choose_card(path, dialect)
    export = _read_export(path, card, channels if part is None else None)
    tables = (without_codes(without_last_row(table, card), card) for table in export.tables)
    kept = choose_part(list(tables), part, path)
    notes = (*export.notes, *_count_notes(export, kept, card), *_generic_note(card))
    return assemble(replace(export, tables=kept, notes=notes), card, path, channels)


def _read_export(path: Path, card: Card, channels: Sequence[ReportOptions] | None) -> Export:
    if card.kind == "text":
        return read_tables(read_content(path), Place(path, card, channels))
    try:
        return read_sheets(open_sheets(path), card, path)
    finally:
        forget_sheets()


def _count_notes(export: Export, tables: Sequence[Table], card: Card) -> list[QualityNote]:
    """Compare the stated numbers of samples and of columns with the actual ones."""
    if len(export.tables) != 1 or not tables:
        return []
    rows = max((len(values) for values in tables[0].columns.values()), default=0)
    counts = (
        ("rows", card.stated_rows, rows),
        ("columns", card.stated_columns, len(tables[0].names)),
    )
    notes = []
    for what, key, count in counts:
        stated = whole_number(str(export.about.get(key, ""))) if key else None
        if stated not in {None, count}:
            message = f"the header states {stated} {what}, the file holds {count}"
            notes.append(QualityNote(f"{what}_differ", Severity.WARNING, "file", message))
    return notes


def _generic_note(card: Card) -> list[QualityNote]:
    if not card.fallback:
        return []
    message = "no vendor's card fits: names and units were detected by their text, check them"
    return [QualityNote("dialect_generic", Severity.INFO, "file", message)]
