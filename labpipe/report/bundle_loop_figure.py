"""A bundle's cycles, measured, fitted and predicted."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Flags
from labpipe.records.curve import Interval
from labpipe.records.harness_bundle import FrictionFit
from labpipe.report.figure_page import DOUBLE_COLUMN, PageTexts, keyed_page, line_key, panel_letter
from labpipe.report.saving import FigureToSave, save_pages
from labpipe.report.wire_sections import LENGTH
from labpipe.report.wording import write_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURE = "bundle-loop"
"""Name of the files, without the ending."""

_MEASURED: dict[str, Any] = {
    "color": "black", "marker": "o", "markersize": 2.2, "linewidth": 0.5
}  # fmt: skip
_FITTED: dict[str, Any] = {"color": "#0072B2", "linewidth": 1.4}
_PREDICTED: dict[str, Any] = {"color": "#D55E00", "linewidth": 1.4}


def save_loop_figure(name: str, fit: FrictionFit, folder: Path, *, png: bool = False) -> list[Path]:
    """Draw the cycles of a bundle as SVG.

    Parameters
    ----------
    name : of the test
    fit : of its friction
    folder : made if it is not there
    png : as PNG, too

    Raises
    ------
    StoreError
        If a file cannot be written.
    """
    page = FigureToSave(FIGURE, partial(loop_figure, name, fit))
    return save_pages([page], folder, what="the figure", again="model the bundle", png=png)


def loop_figure(name: str, fit: FrictionFit) -> Figure:
    """Draw (a) the fitted and (b) the predicted force, each over the measured force.

    Parameters
    ----------
    name : of the test
    fit : of its friction
    """
    keys = [
        line_key("measured", **_MEASURED),
        line_key("fitted (one parameter)", **_FITTED),
        line_key("predicted", **_PREDICTED),
    ]
    texts = PageTexts(f"{name}  ·  friction between the wires", _note(fit), keys)
    page = keyed_page(texts, height_mm=82.0, width_mm=DOUBLE_COLUMN)
    fitted, predicted = page.subplots(1, 2, sharex=True, sharey=True)
    plot_loop(fit, ~fit.is_held_out, _FITTED, fitted)
    plot_loop(fit, fit.is_held_out, _PREDICTED, predicted)
    panel_letter(fitted, "a", f"Fitted, error {_percent(fit.error_fitted)} of the peak")
    panel_letter(predicted, "b", f"Left out, error {_percent(fit.error_held_out)} of the peak")
    return page


def plot_loop(fit: FrictionFit, chosen: Flags, look: dict[str, Any], axes: Axes) -> None:
    """Draw points of a loop and the forces of the model there.

    Parameters
    ----------
    fit : of the friction
    chosen : shape (n,), points of the loop
    look : of the model's line
    axes : to draw on
    """
    deflection = LENGTH.factor * fit.loop.deflection[chosen]
    axes.plot(deflection, fit.loop.force[chosen], **_MEASURED)
    axes.plot(deflection, fit.predicted[chosen], **look)
    axes.axhline(0.0, color="#bbbbbb", linewidth=0.5, zorder=0)
    axes.set_xlabel(LENGTH.label("Deflection"))
    axes.set_ylabel("Force at the tip (N)")


def _note(fit: FrictionFit) -> str:
    slide = LENGTH.factor * fit.slide_curvature * fit.loop.length**2 / 3.0
    tape = f"; the tape slides beyond {slide:.3g} mm" if np.isfinite(slide) else ""
    held = write_number(fit.held, Interval(fit.held_lower, fit.held_upper), 100.0)
    return (
        f"From the first loading: {_percent(fit.composite_share)} of the wires' axial stiffness "
        f"acts up to the kink at {LENGTH.factor * fit.loop.kink[0]:.3g} mm{tape}. "
        f"Fitted to panel a alone: {held.value} % of that acts after the kink "
        f"(95 %: {held.lower} % to {held.upper} %). "
        f"Work over the cycles of panel b: {1e3 * fit.loss:.3g} mJ measured, "
        f"{1e3 * fit.predicted_loss:.3g} mJ predicted. Error: root mean square."
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"
