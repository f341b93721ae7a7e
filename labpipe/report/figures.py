"""The figures of one test by the names that protocols use, and saving them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from labpipe.records.result import TestResult
from labpipe.report import (
    force_displacement,
    marker_quality,
    moment_curvature,
    stiffness_lines,
    timeline,
    wire_shapes,
)
from labpipe.report.saving import FigureToSave, save_pages

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


def save_figures(result: TestResult, folder: Path, *, png: bool = False) -> list[Path]:
    """Draw the figures that the protocol asks for as SVG.

    Parameters
    ----------
    result : a processed test; a figure whose data is missing is made all the same and says in a
        sentence why it is empty
    folder : made if it is not there
    png : each as PNG, too

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
    pages = [FigureToSave(name, partial(FIGURES[name], result)) for name in result.figures]
    again = "process the test"
    return save_pages(pages, folder, what="figures", again=again, run=result.run, png=png)
