"""The figures of one test by the names that protocols use, and the one function that saves."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.errors import StoreError, complaint
from labpipe.records.result import TestResult
from labpipe.report import (
    force_displacement,
    marker_quality,
    moment_curvature,
    stiffness_lines,
    timeline,
    wire_shapes,
)
from labpipe.report.page import finish_layout, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES: dict[str, Callable[[TestResult], Figure]] = {
    "force-displacement": force_displacement.draw,
    "stiffness-lines": stiffness_lines.draw,
    "wire-shapes": wire_shapes.draw,
    "moment-curvature": moment_curvature.draw,
    "timeline": timeline.draw,
    "marker-quality": marker_quality.draw,
}

PNG_DPI = 300


def save_figures(result: TestResult, folder: Path) -> list[Path]:
    """Draw the figures that the protocol asks for, each as SVG and as PNG.

    Parameters
    ----------
    result : a processed test; a figure whose data is missing is made all the same and says in a
        sentence why it is empty
    folder : made if it is not there

    Returns
    -------
    The files, in the order of the protocol.

    Raises
    ------
    ValueError
        If the protocol asks for a figure that does not exist.
    StoreError
        If a file cannot be written.

    Notes
    -----
    The same result gives the same bytes with the same version of matplotlib.
    """
    unknown = [name for name in result.figures if name not in FIGURES]
    if unknown:
        message = f"figures={unknown}: expected some of {list(FIGURES)}"
        raise ValueError(message)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ThreadPoolExecutor(max_workers=1) as packer:
            drawn = [_save(result, name, folder, packer) for name in result.figures]
            return [path for paths, packing in drawn for path in paths if packing.result() is None]
    except OSError as error:
        message = complaint(
            folder,
            "",
            expected="a folder that figures can be written to",
            found=str(error),
            remedy="Make room, or change the permissions, and process the test again.",
        )
        raise StoreError(message) from error


def _save(
    result: TestResult, name: str, folder: Path, packer: Executor
) -> tuple[list[Path], Future[None]]:
    """Draw once, lay out once, write twice: savefig would do all of it four times.

    The pixels are packed into a PNG beside the drawing of what comes next.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from PIL import Image

    svg, png = folder / f"{name}.svg", folder / f"{name}.png"
    with style():
        page = FIGURES[name](result)
        page.set_dpi(PNG_DPI)
        finish_layout(page)
        pixels: Any = FigureCanvasAgg(page)
        pixels.draw()
        image = Image.fromarray(np.array(pixels.buffer_rgba()))
        packing = packer.submit(image.save, png, dpi=(PNG_DPI, PNG_DPI), compress_level=3)
        vector: Any = FigureCanvasSVG(page)  # last: it sets the figure to 72 dots per inch
        vector.print_svg(str(svg), metadata={"Date": None})
    return [svg, png], packing
