"""The figures of a sheet of wires: which there are, their names, and how they are saved."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from labpipe.records.wire import WireTable
from labpipe.report.page import in_pages
from labpipe.report.saving import FigureToSave, save_pages
from labpipe.report.wire_cantilever import cantilever_figure
from labpipe.report.wire_comparison import comparison_figure
from labpipe.report.wire_look import MOST_WIRES
from labpipe.report.wire_sections import section_figure
from labpipe.report.wire_stiffness import moment_figure, stiffness_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NOT_IN_A_FILE = re.compile(r'[\\/:*?"<>|\x00-\x1f]')
_OF_ONE_WIRE: dict[str, Callable[[WireTable], Figure]] = {
    "stiffness": stiffness_figure,
    "moment": moment_figure,
    "cantilever": cantilever_figure,
}


def wire_drawings(tables: Sequence[WireTable]) -> Iterator[FigureToSave]:
    """List the figures of a sheet of wires.

    Parameters
    ----------
    tables : of the wires, in the order of the sheet

    Yields
    ------
    ``sections-1`` and ``comparison-1`` with the first dozen of wires, ``sections-2`` ...; then
    of each wire ``NAME.stiffness``, ``NAME.moment`` and ``NAME.cantilever``. There is no comparison
    with one wire alone.
    """
    for number, some in enumerate(in_pages(tables, MOST_WIRES), start=1):
        yield FigureToSave(f"sections-{number}", partial(section_figure, some))
        if len(some) > 1:
            yield FigureToSave(f"comparison-{number}", partial(comparison_figure, some))
    for table in tables:
        names = own_figures(table.name)
        for name, draw in zip(names, _OF_ONE_WIRE.values(), strict=True):
            yield FigureToSave(name, partial(draw, table))


def own_figures(name: str) -> list[str]:
    """Names of the figures of one wire alone, without endings.

    Parameters
    ----------
    name : of the wire
    """
    stem = _NOT_IN_A_FILE.sub("-", name)
    return [f"{stem}.{kind}" for kind in _OF_ONE_WIRE]


def save_wire_figures(
    tables: Sequence[WireTable], folder: Path, *, say: Callable[[str], None] = lambda _: None
) -> list[Path]:
    """Draw the figures of a sheet of wires, each as SVG and as PNG.

    Parameters
    ----------
    tables : of the wires, in the order of the sheet
    folder : made if it is not there
    say : told the name of each figure as it is drawn

    Returns
    -------
    The files, in the order of `wire_drawings`.

    Raises
    ------
    StoreError
        If a file cannot be written.

    Notes
    -----
    The same tables give the same bytes with the same version of matplotlib.
    """
    return save_pages(
        wire_drawings(tables),
        folder,
        what="figures of wires",
        again="run the model",
        say=say,
    )
