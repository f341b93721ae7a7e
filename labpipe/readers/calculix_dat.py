"""Reads what CalculiX prints of a tip that is pushed: deflection and force at each increment.

Writes this file: CalculiX CrunchiX (``ccx``), ending ``.dat``, asked for ``*NODE PRINT`` of ``U``
and, with ``TOTALS=ONLY``, of ``RF`` (User's Manual, ``*NODE PRINT``). The deck that `labpipe model`
writes asks for both.

Units: those of the deck, which the file does not say; decks of labpipe are in m and N.

File structure: blocks, each under a heading with the quantity, the set of nodes and the time, such
as ``displacements (vx,vy,vz) for set TIPHALF and time  0.1250000E-01``. Of displacements a line per
node, its number first; of the total force one line. The deflection is the mean of the second
component, along y; the force is the second component too. Of a set whose name ends in HALF the
force counts twice: it is of a half model.

Known versions: 2.20.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from labpipe.readers.files import unreadable
from labpipe.readers.sheet_cells import Cell

HALF = "HALF"
"""What the name of a set ends with whose force is of a half model."""

_HEADING = re.compile(r"\s*(\S.*?)\s*\((\w+,\w+,\w+)\) for set (\S+) and time\s+(\S+)\s*")
_DEFLECTION, _FORCE = "displacements", "total force"
_AGAIN = "Run ccx again; the file may have been cut off."
_NEEDED = "Print U, and RF with TOTALS=ONLY, of one set of nodes, as the deck of labpipe does."


@dataclass(frozen=True, slots=True)
class _Block:
    """What is printed below one heading; values are of the second component."""

    quantity: str
    set_name: str
    time: str
    line: int
    values: tuple[float, ...]


def is_calculix(lines: Sequence[str]) -> bool:
    """Tell whether the first line that is not blank is a heading of CalculiX.

    Parameters
    ----------
    lines : of the file
    """
    return _HEADING.fullmatch(next((line for line in lines if line.strip()), "")) is not None


def tip_rows(lines: Sequence[str], path: Path) -> list[list[Cell]]:
    """Find deflection and force of the tip.

    Parameters
    ----------
    lines : of the file
    path : named in errors

    Returns
    -------
    A row of headings with their units, and one row per increment.

    Raises
    ------
    ReadError
        If one of the two is not printed, they are not printed at the same times, more than one set
        of nodes is, or a line under a heading is not of numbers.
    """
    blocks = list(_blocks(lines, path))
    names = sorted({block.set_name for block in blocks})
    if len(names) > 1:
        raise unreadable(path, "", "one set of nodes", ", ".join(names), _NEEDED)
    deflections, forces = (
        [block for block in blocks if block.quantity == quantity]
        for quantity in (_DEFLECTION, _FORCE)
    )
    for quantity, found in ((_DEFLECTION, deflections), (_FORCE, forces)):
        if not found:
            others = ", ".join(sorted({block.quantity for block in blocks}))
            raise unreadable(path, "", f"blocks '{quantity}'", f"only {others}", _NEEDED)
    _require_pairs(path, deflections, forces)
    times = 2.0 if names[0].upper().endswith(HALF) else 1.0
    heading = [Cell(name, "line 1") for name in ("deflection / m", "force / N")]
    rows = [
        [_cell(sum(u.values) / len(u.values), u), _cell(times * f.values[0], f)]
        for u, f in zip(deflections, forces, strict=True)
    ]
    return [heading, *rows]


def _cell(value: float, block: _Block) -> Cell:
    return Cell(f"{value:.9g}", f"line {block.line}")


def _blocks(lines: Sequence[str], path: Path) -> Iterator[_Block]:
    """Blocks with at least one line of numbers each."""
    headings = [(i, match) for i, line in enumerate(lines) if (match := _HEADING.fullmatch(line))]
    ends = [*(i for i, _ in headings[1:]), len(lines)]
    for (start, match), end in zip(headings, ends, strict=True):
        quantity, _, set_name, time = match.groups()
        at_second = 2 if quantity != _FORCE else 1
        filled = [i for i in range(start + 1, end) if lines[i].strip()]
        values = tuple(
            _second_component(lines[i], at_second, f"line {i + 1}", path) for i in filled
        )
        if not values:
            expected = f"numbers under '{quantity}'"
            raise unreadable(path, f"line {start + 1}", expected, "none", _AGAIN)
        yield _Block(quantity, set_name, time, filled[0] + 1, values)


def _second_component(line: str, at: int, place: str, path: Path) -> float:
    """The second component. Others may be so small that their exponents lack the letter."""
    words = line.split()
    try:
        if len(words) == at + 2:
            return float(words[at])
    except ValueError:
        pass
    expected = f"{at + 2} numbers"
    raise unreadable(path, place, expected, repr(line.strip()[:60]), _AGAIN)


def _require_pairs(path: Path, deflections: Sequence[_Block], forces: Sequence[_Block]) -> None:
    """Refuse deflections without forces, and the other way round."""
    at, of = [block.time for block in deflections], [block.time for block in forces]
    alone = next((block for block in deflections if block.time not in of), None)
    alone = alone or next((block for block in forces if block.time not in at), None)
    if alone is not None:
        expected = f"displacements and total force at time {alone.time}"
        raise unreadable(path, f"line {alone.line}", expected, f"only {alone.quantity}", _AGAIN)
    if at != of:
        found = f"{len(at)} and {len(of)} in another order"
        raise unreadable(path, "", "displacements and total force in turn", found, _AGAIN)
