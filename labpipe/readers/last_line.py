"""Whether the last line of a text export is whole, or stops in the middle of a number."""

from __future__ import annotations

import re
from collections.abc import Sequence

from labpipe.readers.cells import is_number, split_line
from labpipe.readers.rows import Body, chosen_cells
from labpipe.records.quality import QualityNote, Severity

_COMPARED = 200
"""Lines above the last one in which a number as short as its last one is looked for."""


def whole_lines(body: Body) -> tuple[int, list[QualityNote]]:
    """Find where the last whole line ends: one that stops in the middle is left out.

    A last line without line end is whole if it has all its cells, and its last number has as many
    decimals, or as many digits in all, as the one above it, and as long an exponent. Where zeros at
    the end of numbers are not written, it is whole if some line above has a last number with no
    more of all three. None is whole where the header promises more rows.

    Parameters
    ----------
    body : the rows

    Returns
    -------
    end : where in the data of the body
    notes : ``truncated`` if a line was left out
    """
    data, start = body.data, body.start
    end = max(data.rfind(b"\n", start) + 1, start)
    last = data[end:].decode("latin-1")
    if not last.strip("\r\0\x1a "):
        return end, []
    cells, rows = split_line(last, body.separator), data.count(b"\n", start)
    is_promised = rows + 1 >= (body.stated_rows or 0)
    if is_promised and _is_whole(cells, _last_numbers(body, end), body):
        return len(data), []
    line = body.first_line + rows
    message = f"the last line ({line}) is incomplete and was left out"
    return end, [QualityNote("truncated", Severity.WARNING, "file", message)]


def _last_numbers(body: Body, end: int) -> list[str]:
    """The last cells of the lines above the last one, the nearest first."""
    lines = body.data[body.start : end].rsplit(b"\n", _COMPARED + 1)
    near = lines[max(len(lines) - 1 - _COMPARED, 0) : -1]
    rows = (split_line(line.decode("latin-1"), body.separator) for line in reversed(near))
    return [row[-1].strip() for row in rows if row]


def _is_whole(last: Sequence[str], above: Sequence[str], body: Body) -> bool:
    if len(last) < len(body.names) or not any(cell.strip() for cell in last):
        return False
    if len(last) > len(body.names) or not above:  # it ends behind its last separator
        return True
    if not all(is_number(cell) for cell in chosen_cells(last, body.columns) if cell):
        return False
    cut = last[-1].strip()
    decimals, digits, exponent = _lengths(cut)
    its_decimals, its_digits, its_exponent = _lengths(above[0])
    by_digits = digits >= its_digits and not body.as_exported
    is_as_long = exponent >= its_exponent and (decimals >= its_decimals or by_digits)
    if is_as_long or body.as_exported:
        return is_as_long
    return cut[-1:].isdigit() and any(_is_as_short(cell, cut) for cell in above if cell)


def _is_as_short(cell: str, cut: str) -> bool:
    return all(a <= b for a, b in zip(_lengths(cell), _lengths(cut), strict=True))


def _lengths(cell: str) -> tuple[int, int, int]:
    """Number of decimals, of digits but for zeros in front, and of digits of the exponent."""
    number, _, exponent = cell.casefold().partition("e")
    parts = re.split(r"[.,]", number)
    decimals = len(parts[-1]) if len(parts) > 1 else 0
    return decimals, len(re.sub(r"\D", "", number).lstrip("0")), len(exponent.lstrip("+-"))
