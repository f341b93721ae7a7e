"""Names in a wire sheet: there, fit for the name of a file, and each of them once."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence

from labpipe.readers.sheet_cells import Cell
from labpipe.readers.wire_columns import NAME, Faults

_NOT_IN_NAMES = re.compile(r'[\\/:*?"<>|\x00-\x1f]|^[. ]|[. ]$')
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", flags=re.IGNORECASE)
_LONGEST_NAME = 100


def check_names(cells: Sequence[Cell], faults: Faults) -> None:
    """Tell names that are missing, cannot be the name of a file, or come again.

    Parameters
    ----------
    cells : one for each row, with their places
    faults : where to tell them
    """
    seen: dict[str, Cell] = {}
    for cell in cells:
        place, name = f"{cell.place} ({NAME})", cell.text
        if not name:
            faults.add(place, expected="a name", found="a blank cell", remedy="Name the wire.")
        elif _NOT_IN_NAMES.search(name) or _RESERVED.fullmatch(name) or len(name) > _LONGEST_NAME:
            expected = "a name that a file can have"
            remedy = (
                'Leave out \\ / : * ? " < > |, and dots at either end; use 100 letters at most.'
            )
            found = f"{name[:20]!r}... of {len(name)} letters"
            found = found if len(name) > _LONGEST_NAME else repr(name)
            faults.add(place, expected=expected, found=found, remedy=remedy)
        elif _as_file(name) in seen:
            expected, found = _name_again(cell, seen[_as_file(name)])
            remedy = "Give each wire a name of its own."
            faults.add(place, expected=expected, found=found, remedy=remedy)
        seen.setdefault(_as_file(name), cell)


def _as_file(name: str) -> str:
    """What is left of a name where letters' case, and how an accent is written, do not count.

    So it is with files on some systems, and with the case of Abaqus's labels.
    """
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def _name_again(cell: Cell, first: Cell) -> tuple[str, str]:
    """What was expected and found where a name comes again, the first place named."""
    if cell.text == first.text:
        return "each wire once", f"{cell.text!r} again, as in {first.place}"
    expected = "names that differ in more than the case of letters, which files and labels ignore"
    return expected, f"{cell.text!r}, and {first.text!r} in {first.place}"
