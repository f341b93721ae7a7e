"""The figure of a bundle: its section with the principal axes, and the bounds of its bending."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.bundle import BundleModel
from labpipe.report.numbers import write_number
from labpipe.report.page import (
    DOUBLE_COLUMN,
    GREY,
    Words,
    keyed_page,
    number_log,
    panel_letter,
    style_colours,
)
from labpipe.report.saving import FigureToSave, save_pages
from labpipe.report.wire_look import CURVATURE, LENGTH, MOMENT, STIFFNESS

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURE = "bundle"
"""Name of the files, without the ending."""

_HEIGHT = 84.0
_MARGIN = 1.12
_OUTLINE: dict[str, Any] = {"edgecolor": "black", "linewidth": 0.5}
_BORE: dict[str, Any] = {
    "fill": False, "edgecolor": "black", "linewidth": 0.6, "linestyle": (0, (4, 2))
}  # fmt: skip
_STIFFEST: dict[str, Any] = {"color": "black", "linewidth": 1.2}
_SOFTEST: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (5, 1.5))}
_CENTRE: dict[str, Any] = {
    "color": "black", "marker": "+", "markersize": 7.0, "linestyle": "", "zorder": 5
}  # fmt: skip
_SLIP: dict[str, Any] = {"color": "#0072B2", "linewidth": 1.4}
_STICK: dict[str, Any] = {"color": "#D55E00", "linewidth": 1.4}
_BETWEEN: dict[str, Any] = {"color": "#dedede", "linewidth": 0}
_ELASTIC: dict[str, Any] = {"color": GREY, "linewidth": 0.8, "linestyle": (0, (1, 1.4))}
_ALIKE = 1e-6


def save_bundle_figure(model: BundleModel, folder: Path) -> list[Path]:
    """Draw a bundle, as SVG and as PNG.

    Parameters
    ----------
    model : of the bundle
    folder : made if it is not there

    Raises
    ------
    StoreError
        If a file cannot be written.
    """
    page = FigureToSave(FIGURE, partial(bundle_figure, model))
    return save_pages([page], folder, what="the figure", again="model the bundle")


def bundle_figure(model: BundleModel) -> Figure:
    """Draw (a) the section of a bundle and (b) its moments against curvature.

    Parameters
    ----------
    model : of the bundle

    Returns
    -------
    A page. The arms of the principal axes end at the edge of the wires; bending is along y,
    upwards. Both axes of the moments are logarithmic.
    """
    words = Words(_title(model), _note(model), _bundle_keys(model))
    page = keyed_page(words, height_mm=_HEIGHT, width_mm=DOUBLE_COLUMN)
    section, moments = page.subplots(1, 2, width_ratios=(0.8, 1.0))
    plot_bundle_section(model, section)
    plot_bounds(model, moments)
    panel_letter(section, "a", "Section")
    panel_letter(moments, "b", "First loading, bent along y")
    return page


def plot_bundle_section(model: BundleModel, axes: Axes) -> None:
    """Draw the wires to scale, the conduit's bore, and the principal axes.

    Parameters
    ----------
    model : of the bundle; where all directions are equally stiff, the axes drawn are y and x
    axes : to draw on
    """
    from matplotlib.patches import Circle

    layout, colours = model.layout, _colours()
    places = LENGTH.factor * np.column_stack([layout.x, layout.y])
    for place, diameter, kind in zip(places, layout.diameter, layout.kind, strict=True):
        radius, colour = LENGTH.factor * diameter / 2.0, colours[int(kind) % len(colours)]
        axes.add_patch(Circle((place[0], place[1]), radius, facecolor=colour, **_OUTLINE))
    bore = model.bundle.conduit_bore or 0.0
    if bore:
        x, y = (LENGTH.factor * value for value in model.middle)
        axes.add_patch(Circle((x, y), LENGTH.factor * bore / 2.0, **_BORE))
    reach = LENGTH.factor * max(layout.radius, math.hypot(*model.middle) + bore / 2.0)
    _draw_axes(model, axes)
    axes.set_aspect("equal")
    axes.set_xlim(-_MARGIN * reach, _MARGIN * reach)
    axes.set_ylim(-_MARGIN * reach, _MARGIN * reach)
    axes.set_xlabel(LENGTH.label("x"))
    axes.set_ylabel(LENGTH.label("y, direction of bending"))


def _draw_axes(model: BundleModel, axes: Axes) -> None:
    """Directions of the largest and the least stiffness through the neutral point."""
    x, y = (LENGTH.factor * value for value in model.neutral)
    reach = 1.06 * LENGTH.factor * model.layout.radius
    angle = math.pi / 2.0 if _is_alike(model) else model.principal_angle
    for turn, look in ((angle, _STIFFEST), (angle + math.pi / 2.0, _SOFTEST)):
        across, up = reach * math.cos(turn), reach * math.sin(turn)
        axes.plot([x - across, x + across], [y - up, y + up], **look)
    axes.plot([x], [y], **_CENTRE)


def plot_bounds(model: BundleModel, axes: Axes) -> None:
    """Draw the moments of wires that slip and of wires that stick.

    Parameters
    ----------
    model : of the bundle; the point at zero curvature has no place on a logarithmic axis
    axes : to draw on
    """
    use = model.curvature > 0.0
    across = CURVATURE.factor * model.curvature[use]
    slip, stick = (
        MOMENT.factor * moment[use] for moment in (model.moment_slip, model.moment_stick)
    )
    axes.fill_between(across, slip, stick, **_BETWEEN)
    for limit in (model.low, model.high):
        axes.plot(across, MOMENT.factor * limit * model.curvature[use], **_ELASTIC)
    axes.plot(across, slip, **_SLIP)
    axes.plot(across, stick, **_STICK)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(across[0], across[-1])
    axes.set_xlabel(CURVATURE.label("Curvature"))
    axes.set_ylabel(MOMENT.label("Bending moment"))
    for axis in (axes.xaxis, axes.yaxis):
        number_log(axis)


def _bundle_keys(model: BundleModel) -> list[Artist]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    colours = _colours()
    keys: list[Artist] = [
        Patch(label=wire.type, facecolor=colours[kind % len(colours)], **_OUTLINE)
        for kind, wire in enumerate(model.bundle.wires)
    ]
    if model.bundle.conduit_bore is not None:
        bore = {name: _BORE[name] for name in ("linewidth", "linestyle")}
        keys.append(Line2D([], [], label="bore of the conduit", color="black", **bore))
    if _is_alike(model):
        keys.append(Line2D([], [], label="y and x: all directions are alike", **_STIFFEST))
    else:
        keys.append(Line2D([], [], label="stiffest direction", **_STIFFEST))
        keys.append(Line2D([], [], label="least stiff direction", **_SOFTEST))
    return [
        *keys,
        Line2D([], [], label="wires stick", **_STICK),
        Line2D([], [], label="wires slip", **_SLIP),
        Line2D([], [], label="if no copper yielded", **_ELASTIC),
    ]


def _title(model: BundleModel) -> str:
    said = f"{model.bundle.composition}  ·  bundle model  ·  {model.layout.arrangement}"
    if model.packing_fraction is None:
        return said
    bore = LENGTH.factor * (model.bundle.conduit_bore or 0.0)
    return f"{said}  ·  packing fraction {model.packing_fraction:.2f} in {bore:.3g} {LENGTH.unit}"


def _note(model: BundleModel) -> str:
    least, largest = model.principal
    directions = (
        "alike in all directions"
        if _is_alike(model)
        else f"{_digits(least)} to {_digits(largest)} over all directions"
    )
    said = (
        f"EI in {STIFFNESS.unit}: {_digits(model.low)} with wires and strands slipping, "
        f"{_digits(model.free)} with wires slipping, {_digits(model.high)} with nothing slipping "
        f"({directions})."
    )
    limits = [
        note.message.replace("N mm^2", "N\u00b7mm\u00b2")
        for note in model.notes
        if note.code == "copper_yields"
    ]
    return " ".join([said, *(f"{limit[0].upper()}{limit[1:]}." for limit in limits)])


def _digits(stiffness: float) -> str:
    return write_number(stiffness, None, STIFFNESS.factor, digits=4).value


def _is_alike(model: BundleModel) -> bool:
    least, largest = model.principal
    return largest - least <= _ALIKE * largest


def _colours() -> list[str]:
    own = style_colours()
    return own[-1:] + own[-2:-1] + own[2:4]  # light ones first, so that lines are seen on them
