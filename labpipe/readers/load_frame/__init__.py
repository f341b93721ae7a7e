"""Reader of load-frame exports: one reader, a dialect (a card of data) per vendor's program.

**Writes this file**: the programs of the cards in ``dialects``: MTS TestSuite and 793, Instron
Bluehill and 8800, ZwickRoell testXpert, Lloyd Nexygen, Shimadzu Trapezium, Walter+Bai Dion, HBM
catman, Deben Microtest, TA Instruments DMA Q800, TestResources; a lab adds its own.

**Recording**: the channels of one test; with several specimens, each on a clock of its own.

**Units**: `unit_in_file` as the export writes it, values in that unit; time in seconds.

**Missing data**: blank cells and the codes of the card become NaN, noted per channel.

**Clock and frame**: the column of time as written, in seconds; row numbers where there is none.

**File structure**: as the card says; see docs/how-to/new-dialect.md.

**Known versions**: as the cards say.
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
from labpipe.readers.load_frame.recognition import Named, chosen_card, recognised
from labpipe.readers.load_frame.text_layouts import Place, read_tables
from labpipe.readers.raw_files import read_content
from labpipe.readers.workbooks import forget_sheets, open_sheets
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Recording
from labpipe.units import whole_number

__all__ = ["read", "recognise"]


def recognise(path: Path) -> bool:
    """Check whether a file is a load-frame export that some card fits, by its content."""
    return recognised(path) is not None


def read(
    path: Path,
    *,
    channels: Sequence[ReportOptions] | None = None,
    dialect: Named = None,
    part: str | None = None,
) -> Recording:
    """Read a load-frame export.

    Parameters
    ----------
    path : the export
    channels : names or paths wanted, None for all
    dialect : name of the card, or cards, that it must fit; None for any
    part : specimen or sheet wanted of an export that holds several, None for all

    Returns
    -------
    The recording. A file with nothing but a byte order mark gives one without clocks and
    channels, and the note ``no_samples``.

    Raises
    ------
    ReadError
        If no card fits or another one than asked for, names, units or numbers are not where the
        card says, a cell is no number, or a wanted channel or part does not exist.
    """
    card = chosen_card(path, dialect)
    export = _tables(path, card, channels if part is None else None)
    tables = (without_codes(without_last_row(table, card), card) for table in export.tables)
    kept = choose_part(list(tables), part, path)
    notes = (*export.notes, *_counted(export, kept, card), *_generic(card))
    return assemble(replace(export, tables=kept, notes=notes), card, path, channels)


def _tables(path: Path, card: Card, channels: Sequence[ReportOptions] | None) -> Export:
    if card.kind == "text":
        return read_tables(read_content(path), Place(path, card, channels))
    try:
        return read_sheets(open_sheets(path), card, path)
    finally:
        forget_sheets()


def _counted(export: Export, tables: Sequence[Table], card: Card) -> list[QualityNote]:
    """Compare the numbers of samples and of columns that the export states with those there are."""
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


def _generic(card: Card) -> list[QualityNote]:
    if not card.fallback:
        return []
    message = "no vendor's card fits: names and units were found by their words, look at them"
    return [QualityNote("dialect_generic", Severity.INFO, "file", message)]
