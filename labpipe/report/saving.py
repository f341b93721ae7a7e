"""Draw a page once, lay it out once, write it as SVG and as PNG."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from labpipe.report.page import finish_layout

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PNG_DPI = 300


class Saving(NamedTuple):
    """Files of a page, of which the PNG may still be on its way.

    Parameters
    ----------
    files : SVG and PNG
    packing : done when the PNG is written; its ``result`` raises what went wrong
    """

    files: tuple[Path, Path]
    packing: Future[None]


def save_page(draw: Callable[[], Figure], folder: Path, name: str, packer: Executor) -> Saving:
    """Draw a page inside the present style and save it under one name in both formats.

    Parameters
    ----------
    draw : makes the page
    folder : there already
    name : of the files, without the ending
    packer : packs the pixels into a PNG beside the drawing of what comes next

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

    svg, png = folder / f"{name}.svg", folder / f"{name}.png"
    page = draw()
    page.set_dpi(PNG_DPI)
    finish_layout(page)
    pixels: Any = FigureCanvasAgg(page)
    pixels.draw()
    image = Image.fromarray(np.array(pixels.buffer_rgba()))
    packing = packer.submit(image.save, png, dpi=(PNG_DPI, PNG_DPI), compress_level=3)
    vector: Any = FigureCanvasSVG(page)  # last: it sets the figure to 72 dots per inch
    vector.print_svg(str(svg), metadata={"Date": None})
    return Saving((svg, png), packing)
