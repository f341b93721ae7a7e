"""Draw pages once, lay them out once, write them as SVG and as PNG."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from labpipe.errors import StoreError, complaint
from labpipe.report.page import finish_layout, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PNG_DPI = 300


class PageToDraw(NamedTuple):
    """A page before it is drawn.

    Parameters
    ----------
    name : of its files, without the ending
    draw : makes it
    """

    name: str
    draw: Callable[[], Figure]


def save_pages(
    pages: Iterable[PageToDraw],
    folder: Path,
    *,
    what: str,
    again: str,
    say: Callable[[str], None] = lambda _: None,
    run: str = "",
) -> list[Path]:
    """Draw pages in labpipe's style, each as SVG and as PNG.

    Parameters
    ----------
    pages : one is drawn and let go before the next
    folder : made if it is not there
    what, again : what the pages are, and how to draw them again, for a message
    say : told the name of each page as it is drawn
    run : key of the run that the pages show, which goes into both files; empty for none

    Returns
    -------
    The files, in the order of the pages.

    Raises
    ------
    StoreError
        If a file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with style(), ThreadPoolExecutor(max_workers=1) as packer:
            saved = []
            for page in pages:
                say(page.name)
                saved.append(save_page(page.draw(), folder, page.name, packer, run=run))
            return [path for each in saved if each.packing.result() is None for path in each.files]
    except OSError as error:
        message = complaint(
            folder,
            "",
            expected=f"a folder that {what} can be written to",
            found=str(error),
            remedy=f"Make room, or change the permissions, and {again} again.",
        )
        raise StoreError(message) from error


class Saving(NamedTuple):
    """Files of a page, of which the PNG may still be on its way.

    Parameters
    ----------
    files : SVG and PNG
    packing : done when the PNG is written; its ``result`` raises what went wrong
    """

    files: tuple[Path, Path]
    packing: Future[None]


def save_page(
    page: Figure, folder: Path, name: str, packer: Executor, *, dpi: int = PNG_DPI, run: str = ""
) -> Saving:
    """Lay out a page inside the present style and save it under one name in both formats.

    Parameters
    ----------
    page : as it is drawn
    folder : there already
    name : of the files, without the ending
    packer : packs the pixels into a PNG beside the drawing of what comes next
    dpi : of the PNG
    run : key that goes into both files (``dc:identifier`` of the SVG, text ``run`` of the PNG)

    Returns
    -------
    The files. The same page gives the same bytes with the same version of matplotlib.

    Raises
    ------
    OSError
        If the SVG cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    svg, png = folder / f"{name}.svg", folder / f"{name}.png"
    page.set_dpi(dpi)
    finish_layout(page)
    pixels: Any = FigureCanvasAgg(page)
    pixels.draw()
    image = Image.fromarray(np.array(pixels.buffer_rgba()))
    about = PngInfo()
    if run:
        about.add_text("run", run)
    packing = packer.submit(image.save, png, dpi=(dpi, dpi), compress_level=3, pnginfo=about)
    vector: Any = FigureCanvasSVG(page)  # last: it sets the figure to 72 dots per inch
    vector.print_svg(str(svg), metadata={"Date": None, "Identifier": run or None})
    return Saving((svg, png), packing)
