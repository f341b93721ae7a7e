"""Figures of one test by their names in protocols."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from labpipe.records.result import TestResult
from labpipe.report.bending_figure import draw_moment_curvature
from labpipe.report.budget_figures import draw_budget
from labpipe.report.curve_figures import draw_force_displacement, draw_stiffness_lines
from labpipe.report.figure_page import finish_layout, style, with_own_fonts
from labpipe.report.marker_figures import draw_marker_quality, draw_wire_shapes
from labpipe.report.saving import FigureToSave, save_pages
from labpipe.report.timeline_figure import draw_timeline

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Figure  # noqa: PLC0414 - the API imports it from here

FIGURES: dict[str, Callable[[TestResult], Figure]] = {
    "force-displacement": draw_force_displacement,
    "stiffness-lines": draw_stiffness_lines,
    "wire-shapes": draw_wire_shapes,
    "moment-curvature": draw_moment_curvature,
    "timeline": draw_timeline,
    "marker-quality": draw_marker_quality,
    "uncertainty-budget": draw_budget,
}


def save_figures(result: TestResult, folder: Path, *, png: bool = False) -> list[Path]:
    """Draw the figures that the protocol asks for as SVG.

    Parameters
    ----------
    result : a processed test; a figure without data says why it is empty
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
        message = f"figures: expected names of {list(FIGURES)}, found {unknown}"
        raise ValueError(message)
    pages = [FigureToSave(name, partial(FIGURES[name], result)) for name in result.figures]
    again = "process the test"
    return save_pages(pages, folder, what="figures", again=again, run=result.run, png=png)


def draw_figure(result: TestResult, name: str) -> Figure:
    """Draw one figure for a notebook or a script.

    Parameters
    ----------
    result : a processed test
    name : one of `FIGURES`

    Returns
    -------
    The figure, laid out in labpipe's style, which it keeps wherever it is drawn.
    """
    with style():
        page = FIGURES[name](result)
        finish_layout(page)
        return with_own_fonts(page)
