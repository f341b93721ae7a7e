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
from pathlib import Path

from labpipe.readers.channels import ReportOptions
from labpipe.readers.load_frame.frame_recording import assemble
from labpipe.readers.load_frame.recognition import CardNames, choose_card, recognise_card
from labpipe.readers.load_frame.tables import read_sheets, read_text
from labpipe.readers.raw_files import read_content
from labpipe.readers.workbooks import forget_sheets, open_sheets
from labpipe.records.recording import Recording

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
    if card.kind == "text":
        export = read_text(read_content(path), card, path, channels if part is None else None)
    else:
        try:
            export = read_sheets(open_sheets(path), card, path)
        finally:
            forget_sheets()
    return assemble(export, card, path, channels, part)
