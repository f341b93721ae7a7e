"""The figures of a calibration: which there are, their names, and how they are saved."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from labpipe.report.calibration_card import calibration_card
from labpipe.report.calibration_shapes import shapes_figure
from labpipe.report.calibration_shown import CalibrationReport
from labpipe.report.calibration_third import third_figure, third_pages
from labpipe.report.calibration_validation import MOST_GROUPS, validation_figure
from labpipe.report.page import in_pages
from labpipe.report.saving import FigureToSave, save_pages


def calibration_drawings(report: CalibrationReport) -> Iterator[FigureToSave]:
    """List the figures of a calibration.

    Parameters
    ----------
    report : all that they show

    Yields
    ------
    ``calibration``, the card; ``validation-1``, ``validation-2`` ... with six wires and lengths
    each; ``third-curves``, ``third-curves-2`` ... if curves from elsewhere are compared;
    ``shapes-1`` ... for each sample whose shapes are there.
    """
    card = partial(
        calibration_card, report.calibration, report.source, predictions=report.predictions
    )
    yield FigureToSave("calibration", card)
    for number, groups in enumerate(in_pages(report.groups, MOST_GROUPS), start=1):
        yield FigureToSave(f"validation-{number}", partial(validation_figure, groups))
    for number, panels in enumerate(third_pages(report), start=1):
        name = "third-curves" if number == 1 else f"third-curves-{number}"
        yield FigureToSave(name, partial(third_figure, panels))
    for number, (name, shapes) in enumerate(report.shapes.items(), start=1):
        yield FigureToSave(f"shapes-{number}", partial(shapes_figure, name, shapes))


def save_calibration_figures(
    report: CalibrationReport, folder: Path, *, say: Callable[[str], None] = lambda _: None
) -> list[Path]:
    """Draw the figures of a calibration, each as SVG and as PNG.

    Parameters
    ----------
    report : all that they show
    folder : made if it is not there
    say : told the name of each figure as it is drawn

    Returns
    -------
    The files, in the order of `calibration_drawings`.

    Raises
    ------
    StoreError
        If a file cannot be written.

    Notes
    -----
    The same report gives the same bytes with the same version of matplotlib.
    """
    return save_pages(
        calibration_drawings(report),
        folder,
        what="figures of a calibration",
        again="calibrate",
        say=say,
    )
