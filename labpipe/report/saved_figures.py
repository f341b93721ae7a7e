"""Figures of a report: drawn once, saved as SVG, PNG and PDF, and put into the page."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from labpipe.report.inline_svg import Inline, inline_svg
from labpipe.report.page import style
from labpipe.report.saving import save_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PNG_DPI = 200


class FigureToSave(NamedTuple):
    """A figure before it is drawn.

    Parameters
    ----------
    name : of its files, without the ending
    draw : makes it
    caption : how to read it
    alt : what a person who cannot see it is told
    """

    name: str
    draw: Callable[[], Figure]
    caption: str
    alt: str


@dataclass(frozen=True, slots=True)
class SavedFigure:
    """A figure that was drawn and saved.

    Parameters
    ----------
    drawing : as an element of a page
    caption : how to read it
    files : SVG, PNG and PDF
    """

    drawing: Inline
    caption: str
    files: tuple[Path, ...]


def save_figures(wanted: Iterable[FigureToSave], folder: Path) -> list[SavedFigure]:
    """Draw figures and save each as SVG, PNG and PDF.

    Parameters
    ----------
    wanted : one is drawn and let go before the next
    folder : there already

    Returns
    -------
    In the order of `wanted`.

    Raises
    ------
    OSError
        If a file cannot be written.

    Notes
    -----
    The same figure gives the same bytes with the same version of matplotlib.
    """
    look = {"svg.fonttype": "none"}
    with style(look), ThreadPoolExecutor(max_workers=1) as packer:
        saved = [_save(each, folder, packer) for each in wanted]
        return [figure for figure, packing in saved if packing.result() is None]


def _save(wanted: FigureToSave, folder: Path, packer: Executor) -> tuple[SavedFigure, Future[None]]:
    """Draw once, lay out once, write three times."""
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    page = wanted.draw()
    (svg, png), packing = save_page(page, folder, wanted.name, packer, dpi=_PNG_DPI)
    pdf = folder / f"{wanted.name}.pdf"
    paper: Any = FigureCanvasPdf(page)
    paper.print_pdf(str(pdf), metadata={"CreationDate": None})
    # A number in place of the name: it stands at every mark of a drawing.
    prefix = f"f{zlib.crc32(wanted.name.encode()):x}"
    element = inline_svg(svg.read_bytes(), prefix=prefix, title=wanted.alt)
    return SavedFigure(element, wanted.caption, (svg, png, pdf)), packing
