"""The figures of a calibration: which there are, their names, and how they are saved."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from labpipe.errors import StoreError, complaint
from labpipe.report.calibration_card import calibration_card
from labpipe.report.calibration_shapes import shapes_figure
from labpipe.report.calibration_shown import CalibrationReport
from labpipe.report.calibration_validation import validation_figure, validation_pages
from labpipe.report.page import style
from labpipe.report.saving import save_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class CalibrationDrawing(NamedTuple):
    """A figure before it is drawn.

    Parameters
    ----------
    name : of its files, without the ending
    draw : makes it
    """

    name: str
    draw: Callable[[], Figure]


def calibration_drawings(report: CalibrationReport) -> Iterator[CalibrationDrawing]:
    """List the figures of a calibration.

    Parameters
    ----------
    report : all that they show

    Yields
    ------
    ``calibration``, the card; ``validation-1``, ``validation-2`` ... with six wires and lengths
    each; ``shapes-1`` ... for each sample whose shapes are there.
    """
    card = partial(
        calibration_card, report.calibration, report.source, predictions=report.predictions
    )
    yield CalibrationDrawing("calibration", card)
    for number, groups in enumerate(validation_pages(report.groups), start=1):
        yield CalibrationDrawing(f"validation-{number}", partial(validation_figure, groups))
    for number, (name, shapes) in enumerate(report.shapes.items(), start=1):
        yield CalibrationDrawing(f"shapes-{number}", partial(shapes_figure, name, shapes))


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
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return _save(report, folder, say)
    except OSError as error:
        message = complaint(
            folder,
            "",
            expected="a folder that figures of a calibration can be written to",
            found=str(error),
            remedy="Make room, or change the permissions, and calibrate again.",
        )
        raise StoreError(message) from error


def _save(report: CalibrationReport, folder: Path, say: Callable[[str], None]) -> list[Path]:
    # names of wires and of tests are text, whatever signs of mathematics they hold
    with style({"text.parse_math": False}), ThreadPoolExecutor(max_workers=1) as packer:
        saved = []
        for drawing in calibration_drawings(report):
            say(drawing.name)
            saved.append(save_page(drawing.draw, folder, drawing.name, packer))
        return [path for each in saved if each.packing.result() is None for path in each.files]
