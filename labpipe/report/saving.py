"""Save figures, drawn and laid out once, as SVG, PNG and PDF, and embed them in a page."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from labpipe.errors import StoreError
from labpipe.report.figure_page import finish_layout, style
from labpipe.report.wording import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("svg", "png", "pdf")
"""Formats of the figures of a report; SVG is always written."""


class FigureToSave(NamedTuple):
    """A figure before it is drawn.

    Parameters
    ----------
    name : of its files, without the ending
    draw : returns the figure
    caption : how to read it; description in its files
    alt : alternative text; title in its files
    """

    name: str
    draw: Callable[[], Figure]
    caption: str = ""
    alt: str = ""


def save_pages(
    wanted: Iterable[FigureToSave],
    folder: Path,
    *,
    say: Callable[[str], None] = lambda _: None,
    run: str = "",
    png: bool = False,
    pdf: bool = False,
    dpi: int = 300,
    is_journal: bool = False,
) -> list[Path]:
    """Draw figures in labpipe's style, each as SVG, and as PNG and PDF on request.

    Parameters
    ----------
    wanted : each is drawn and released before the next
    folder : made if it is not there
    say : called with the name of each figure as it is drawn
    run : key of the run of the figures, written to SVG and PNG; may be empty
    png, pdf : each as PNG or PDF, too; the SVG is identical
    dpi : of the PNG, dots per inch
    is_journal : serif letters and the colours of journals, instead of the look of the page

    Returns
    -------
    The files, in the order of the figures: SVG, PNG, PDF of each.

    Raises
    ------
    StoreError
        If a file cannot be written.

    Notes
    -----
    The same figure gives the same bytes with the same version of matplotlib.
    """
    with writing(folder, "figures"), style(is_journal=is_journal):
        folder.mkdir(parents=True, exist_ok=True)
        files = []
        for figure in wanted:
            say(figure.name)
            files += save_page(figure, folder, run=run, dpi=dpi if png else None, is_pdf=pdf)
        return files


def pngs_of(wanted: Iterable[FigureToSave], folder: str) -> list[str]:
    """Return the names of the PNGs of figures, which are out of date after an earlier run.

    Parameters
    ----------
    wanted : figures, not drawn here
    folder : of the figures
    """
    return [f"{folder}/{figure.name}.png" for figure in wanted]


@contextmanager
def writing(path: Path, what: str) -> Iterator[None]:
    """Report a file or folder that cannot be written, with a remedy.

    Parameters
    ----------
    path : written inside this block
    what : name of the files

    Raises
    ------
    StoreError
        Instead of errors of the operating system.
    """
    try:
        yield
    except OSError as error:
        raise StoreError.about("report.cannot_write", path, "", what=what, error=error) from error


def save_page(
    wanted: FigureToSave, folder: Path, *, run: str, dpi: int | None, is_pdf: bool
) -> list[Path]:
    """Draw and lay out one figure in the current style and write it in each format.

    Parameters
    ----------
    wanted : figure, with the texts of its files
    folder : existing
    run : key in the files (``dc:identifier`` of the SVG, text ``run`` of the PNG)
    dpi : of the PNG; None for no PNG
    is_pdf : write a PDF, too

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    page = wanted.draw()
    finish_layout(page)
    svg, png, pdf = (folder / f"{wanted.name}.{ending}" for ending in FORMATS)
    title, description = printable(wanted.alt), printable(wanted.caption)
    stated = {"Title": title, "Description": description, "Identifier": run}
    told = {name: text for name, text in stated.items() if text}
    vector: Any = FigureCanvasSVG(page)
    vector.print_svg(str(svg), metadata={"Date": None, **told})
    files = [svg]
    if dpi is not None:
        page.set_dpi(dpi)
        pixels: Any = FigureCanvasAgg(page)
        about = {"Software": None, "run": run or None}
        pixels.print_png(str(png), metadata=about, pil_kwargs={"compress_level": 3})
        files.append(png)
    if is_pdf:
        paper: Any = FigureCanvasPdf(page)
        paper.print_pdf(
            str(pdf), metadata={"CreationDate": None, "Title": title, "Subject": description}
        )
        files.append(pdf)
    return files


def as_address(page: Figure) -> str:
    """Lay out a figure in the current style and write it as a ``data:`` address for a page.

    Parameters
    ----------
    page : drawn

    Returns
    -------
    An SVG whose letters are lines: it looks the same in every browser.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    finish_layout(page)
    file = BytesIO()
    vector: Any = FigureCanvasSVG(page)
    vector.print_svg(file, metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(file.getvalue()).decode()}"
