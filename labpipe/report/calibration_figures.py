"""The figures of a calibration: shapes of a bent wire, which figures there are, and saving them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.report.calibration_agreement import (
    MAX_PANELS,
    external_figure,
    external_pages,
    validation_figure,
)
from labpipe.report.calibration_card import calibration_card
from labpipe.report.calibration_summary import (
    DEFLECTION,
    MODEL,
    BentShape,
    CalibrationReport,
    length_words,
)
from labpipe.report.figure_page import (
    WIDTH,
    PageTexts,
    keyed_page,
    line_key,
    split_pages,
    write_reason,
)
from labpipe.report.saving import FigureToSave, save_pages

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MARKERS: dict[str, Any] = {
    "color": "black", "linestyle": "", "marker": "o", "markersize": 3.2, "zorder": 4
}  # fmt: skip
_FIT: dict[str, Any] = {
    "color": "black", "linewidth": 0.9, "linestyle": (0, (4, 1.6)), "zorder": 3
}  # fmt: skip
_MODEL: dict[str, Any] = {"color": MODEL, "linewidth": 1.3, "zorder": 2}
_NOTE = "Markers are on the surface of the wire; the curves are its axis."


def shapes_figure(name: str, shapes: Sequence[BentShape]) -> Figure:
    """Draw the shapes of a sample at several deflections on axes of one scale.

    Parameters
    ----------
    name : of what was bent, such as ``A2, 85 mm``
    shapes : one for each deflection; without any, the page says so
    """
    frame_mm = 14.0  # numbers and labels of the panel
    min_aspect, max_aspect = 0.35, 1.1
    title = f"{name}  \u00b7  shapes at {len(shapes)} deflections of the tip"
    if not shapes:
        page = keyed_page(PageTexts(title), height_mm=40.0)
        write_reason(page.subplots(), "There is no shape to draw.")
        return page
    low, high = _bounds(shapes)
    across, up = (high - low).tolist()
    share = min(max(up / across, min_aspect), max_aspect)
    page = keyed_page(
        PageTexts(title, _NOTE, _keys(shapes)), height_mm=frame_mm + (WIDTH - frame_mm) * share
    )
    plot_shapes(shapes, page.subplots())
    return page


def plot_shapes(shapes: Sequence[BentShape], axes: Axes) -> None:
    """Draw shapes: markers as dots, fitted curves dashed, the model solid.

    Parameters
    ----------
    shapes : each is named by its deflection beside its end
    axes : to draw on, with equal scales
    """
    for shape in shapes:
        for points, look in ((shape.model, _MODEL), (shape.fit, _FIT), (shape.markers, _MARKERS)):
            x, y = DEFLECTION.factor * points.T
            axes.plot(x, y, **look)
        _label_end(shape, axes)
    low, high = _bounds(shapes)
    axes.set_aspect("equal", adjustable="box", anchor="W")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_xlabel(DEFLECTION.label("Along the undeformed wire, x"))
    axes.set_ylabel(DEFLECTION.label("Towards the pull, y"))


def _label_end(shape: BentShape, axes: Axes) -> None:
    """Write the deflection beside the end furthest from the clamp."""
    ends = [line[-1] for line in map(_finite_rows, _lines(shape)) if len(line)]
    if not ends:
        return
    at = DEFLECTION.factor * np.max(ends, axis=0)
    axes.annotate(
        length_words(shape.deflection), (float(at[0]), float(at[1])), (5, 0),
        textcoords="offset points", va="center",
    )  # fmt: skip


def _bounds(shapes: Sequence[BentShape]) -> tuple[Floats, Floats]:
    """Return the corners of everything drawn with a margin, in the display unit."""
    margin = 0.06
    points = np.concatenate([_finite_rows(line) for shape in shapes for line in _lines(shape)])
    points = DEFLECTION.factor * np.concatenate([points, np.zeros((1, 2))])
    low, high = points.min(axis=0), points.max(axis=0)
    room = margin * max(float(np.max(high - low)), 1.0)
    return low - room, high + np.array([2.5 * room, room])


def _lines(shape: BentShape) -> tuple[Floats, Floats, Floats]:
    return shape.model, shape.fit, shape.markers


def _finite_rows(points: Floats) -> Floats:
    rows: Floats = points[np.isfinite(points).all(axis=1)]
    return rows


def _keys(shapes: Sequence[BentShape]) -> list[Artist]:
    keys: list[Artist] = [line_key("markers", **_MARKERS)]
    if any(len(shape.fit) for shape in shapes):
        keys.append(line_key("fitted curve", **_FIT))
    if any(len(shape.model) for shape in shapes):
        keys.append(line_key("model", **_MODEL))
    return keys


def calibration_drawings(report: CalibrationReport) -> Iterator[FigureToSave]:
    """List the figures of a calibration.

    Parameters
    ----------
    report : all that they show

    Yields
    ------
    ``calibration``, the card; ``validation-1``, ``validation-2`` ... with six wires and lengths
    each; ``external-curves``, ``external-curves-2`` ... if curves from elsewhere are compared;
    ``shapes-1`` ... for each sample whose shapes are there.
    """
    card = partial(calibration_card, report.calibration, predictions=report.predictions)
    yield FigureToSave("calibration", card)
    for number, groups in enumerate(split_pages(report.groups, MAX_PANELS), start=1):
        yield FigureToSave(f"validation-{number}", partial(validation_figure, groups))
    for number, panels in enumerate(external_pages(report), start=1):
        name = "external-curves" if number == 1 else f"external-curves-{number}"
        yield FigureToSave(name, partial(external_figure, panels))
    for number, (name, shapes) in enumerate(report.shapes.items(), start=1):
        yield FigureToSave(f"shapes-{number}", partial(shapes_figure, name, shapes))


def save_calibration_figures(
    report: CalibrationReport,
    folder: Path,
    *,
    say: Callable[[str], None] = lambda _: None,
    png: bool = False,
) -> list[Path]:
    """Draw the figures of a calibration, each as SVG.

    Parameters
    ----------
    report : all that they show
    folder : made if it is not there
    say : called with the name of each figure as it is drawn
    png : each as PNG, too

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
        png=png,
    )
