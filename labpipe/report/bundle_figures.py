"""Bundles: section, bounds of bending, samples between slipping and sticking, measured cycles."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Flags
from labpipe.records.curve import Interval
from labpipe.records.group import BundlePlace, Campaign
from labpipe.records.harness_bundle import BundleModel, FrictionFit
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    GREY,
    PageTexts,
    area_key,
    keyed_page,
    label_log_axis,
    line_key,
    panel_letter,
    style_colours,
)
from labpipe.report.group_tables import DASH, Cell, Table
from labpipe.report.issues import sentences
from labpipe.report.plot_thinning import split_doubtful
from labpipe.report.saving import FigureToSave, save_pages
from labpipe.report.wire_sections import CURVATURE, LENGTH, MOMENT, STIFFNESS
from labpipe.report.wording import Scale, display_of, shown_in, unit_words, write_number

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


UNIT = "N*m^2"
_NOTES = (
    "All slips: every wire slips on its neighbours, and every strand on the other strands. Wires"
    " slip: the wires slip, their strands stick. Nothing slips: the section stays plane, bent in"
    " the plane of the test; the line below gives the smallest and largest stiffness over all"
    " directions. All bounds are computed from the wire sheet, for the wires alone: tape, conduit"
    " and friction contribute to the measured number only.",
    "Share of the way: 0 % where all slips, 100 % where nothing slips. Its interval is that of the"
    " measured number; errors of the wire sheet are not included.",
)


def has_bundles(campaign: Campaign) -> bool:
    """Return whether any sample of a campaign is a harness bundle."""
    return any(
        sample.specimen.bundle is not None for group in campaign.groups for sample in group.samples
    )


def place_table(campaign: Campaign) -> Table | None:
    """Return the table of bending stiffnesses between their bounds; None without a wire sheet.

    Parameters
    ----------
    campaign : its places
    """
    if not campaign.places:
        return None
    scales = place_scales(campaign)
    rows = tuple(_row(place, scales[place.group]) for place in campaign.places)
    unit = unit_words(next(iter(scales.values())).unit)
    heads = (
        "Test", f"Bending stiffness ({unit})", f"All slips ({unit})", f"Wires slip ({unit})",
        f"Nothing slips ({unit})", "Share of the way",
    )  # fmt: skip
    return Table("Between slipping and sticking", heads, rows, _NOTES)


def place_scales(campaign: Campaign) -> dict[str, Scale]:
    """Return the unit of bending stiffness by group: one for all if their protocols differ."""
    scales = {group.name: shown_in("", UNIT, display_of(group)) for group in campaign.groups}
    first = next(iter(scales.values()))
    is_one = all(scale.unit == first.unit for scale in scales.values())
    return scales if is_one else dict.fromkeys(scales, shown_in("", UNIT, {}))


def _row(place: BundlePlace, scale: Scale) -> tuple[Cell, ...]:
    head = Cell(place.test, place.group) if place.test else Cell(f"mean of {place.group}")
    value = place.value if place.value is not None else float("nan")
    written = write_number(value, place.interval, scale.factor)
    why = sentences(place.reasons)
    if isnan(place.low):
        none = Cell(DASH)
        return head, Cell(written.value, written.interval), none, none, none, Cell(DASH, why)
    low, free, high, least, largest = (
        write_number(stiffness, None, scale.factor, digits=3).value
        for stiffness in (place.low, place.free, place.high, *place.principal)
    )
    share = write_number(100.0 * place.share, None, digits=2)
    if place.share_interval is not None:
        share = write_number(place.share, place.share_interval, 100.0)
    text = share.value if isnan(place.share) else f"{share.value} %"
    return (
        head,
        Cell(written.value, written.interval),
        Cell(low),
        Cell(free),
        Cell(high, "" if least == largest else f"{least} to {largest}"),
        Cell(text, why or (f"{share.interval} %" if share.interval else "")),
    )


MAX_ROWS = 36
"""Rows of a figure, unless one group has more."""
_BOUNDS: dict[str, Any] = {
    "color": "#d5d5d5", "linewidth": 5.0, "solid_capstyle": "butt", "zorder": 1
}  # fmt: skip
_FREE: dict[str, Any] = {
    "color": GREY, "marker": "|", "markersize": 6.0, "linestyle": "", "zorder": 2
}  # fmt: skip
_SAMPLE: dict[str, Any] = {"color": "#0072B2", "marker": "o", "markersize": 3.6}
_MEAN: dict[str, Any] = {"color": "black", "marker": "D", "markersize": 4.2}
_CAPTION = (
    "Grey bar: from every wire and strand slipping to nothing slipping, computed by the bundle"
    " model from the wire sheet, for the wires alone; tick: wires slip, their strands stick. Dots:"
    " samples with their 95 % intervals; diamonds: means of the groups. The axis is logarithmic;"
    " an interval that reaches zero ends at its left edge."
)


def place_figures(campaign: Campaign) -> Iterator[FigureToSave]:
    """List the figures of bundles between their bounds.

    Parameters
    ----------
    campaign : its places

    Yields
    ------
    No figure without places; otherwise figures of up to `MAX_ROWS` rows, groups kept whole.
    """
    scales = place_scales(campaign)
    parts = list(_parts(campaign.places))
    for number, part in enumerate(parts, start=1):
        name = "between-slipping-and-sticking" + (f"-{number}" if len(parts) > 1 else "")
        scale = scales[part[0].group]
        groups = ", ".join(dict.fromkeys(place.group for place in part))
        alt = f"Bending stiffness between all slipping and nothing slipping: {groups}."
        yield FigureToSave(name, partial(draw_places, part, scale), _CAPTION, alt)


def _parts(places: Sequence[BundlePlace]) -> Iterator[list[BundlePlace]]:
    groups: dict[str, list[BundlePlace]] = {}
    for place in places:
        groups.setdefault(place.group, []).append(place)
    part: list[BundlePlace] = []
    for group_places in groups.values():
        if part and len(part) + len(group_places) > MAX_ROWS:
            yield part
            part = []
        part = [*part, *group_places]
    if part:
        yield part


def draw_places(places: Sequence[BundlePlace], scale: Scale) -> Figure:
    """Draw bending stiffnesses on a logarithmic axis, each on the bar between its bounds.

    Parameters
    ----------
    places : rows, from the top
    scale : display unit of bending stiffness
    """
    row_mm, rest_mm = 4.2, 16.0
    texts = PageTexts("Between slipping and sticking  \u00b7  bundle model", keys=_place_keys())
    page = keyed_page(texts, height_mm=rest_mm + row_mm * len(places), width_mm=150.0)
    axes = page.subplots()
    low, high = _ends(places, scale.factor)
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    for row, place in enumerate(places):
        _plot_row(place, row, scale.factor, axes)
    axes.set_yticks(
        range(len(places)), [place.test or f"mean of {place.group}" for place in places]
    )
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(places) - 0.4, -0.6)
    axes.set_xlabel(f"Bending stiffness ({unit_words(scale.unit)})")
    label_log_axis(axes.xaxis)
    axes.xaxis.set_major_formatter(_plain)
    return page


def _plain(value: float, _: object = None) -> str:
    """Write a number of an axis without a power of ten, in groups of three digits."""
    return f"{value:,.0f}".replace(",", "\u2009") if value >= 1.0 else f"{value:g}"


def _ends(places: Sequence[BundlePlace], factor: float) -> tuple[float, float]:
    """Return the ends of the axis for all positive bounds, values and ends of intervals."""
    every = [ei for place in places for ei in (place.low, place.high, place.value or 0.0)]
    every += [place.interval.upper for place in places if place.interval is not None]
    values = [factor * ei for ei in every if ei > 0.0] or [1.0, 10.0]  # not NaN either
    return 0.7 * min(values), 1.4 * max(values)


def _plot_row(place: BundlePlace, row: int, factor: float, axes: Axes) -> None:
    max_reason_length = 88
    look = _SAMPLE if place.test else _MEAN
    if not isnan(place.low):
        axes.plot([factor * place.low, factor * place.high], [row, row], **_BOUNDS)
        axes.plot([factor * place.free], [row], **_FREE)
    left_edge = axes.get_xlim()[0]
    if place.value is not None and place.value > 0.0:
        if place.interval is not None:
            ends = [max(factor * place.interval.lower, left_edge), factor * place.interval.upper]
            axes.plot(ends, [row, row], color=look["color"], linewidth=1.0, zorder=2)
        axes.plot([factor * place.value], [row], linestyle="", zorder=3, **look)
    why = sentences(place.reasons)
    if why:
        text = why if len(why) <= max_reason_length else f"{why[:max_reason_length]}\u2026"
        axes.text(0.99, row, text, transform=axes.get_yaxis_transform(), ha="right", va="center",
                  size=6, color=GREY)  # fmt: skip


def _place_keys() -> list[Artist]:
    return [
        line_key("all slips to nothing slips", color=_BOUNDS["color"], linewidth=5.0),
        line_key("wires slip, strands stick", **_FREE),
        line_key("sample, 95 %", linewidth=1.0, **_SAMPLE),
        line_key("mean of a group, 95 %", linewidth=1.0, **_MEAN),
    ]


FIGURE = "bundle"
"""Name of the files, without the ending."""

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


def save_bundle_figure(model: BundleModel, folder: Path, *, png: bool = False) -> list[Path]:
    """Draw a bundle as SVG.

    Parameters
    ----------
    model : of the bundle
    folder : made if it is not there
    png : as PNG, too

    Raises
    ------
    StoreError
        If a file cannot be written.
    """
    page = FigureToSave(FIGURE, partial(bundle_figure, model))
    return save_pages([page], folder, what="the figure", again="model the bundle", png=png)


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
    texts = PageTexts(_title(model), _note(model), _bundle_keys(model))
    page = keyed_page(texts, height_mm=84.0, width_mm=DOUBLE_COLUMN)
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
    margin_factor = 1.12
    from matplotlib.patches import Circle

    layout, colours = model.layout, _colours()
    places = LENGTH.factor * np.column_stack([layout.x, layout.y])
    for place, diameter, wire_type in zip(places, layout.diameter, layout.kind, strict=True):
        radius, colour = LENGTH.factor * diameter / 2.0, colours[int(wire_type) % len(colours)]
        axes.add_patch(Circle((place[0], place[1]), radius, facecolor=colour, **_OUTLINE))
    bore = model.bundle.conduit_bore or 0.0
    if bore:
        x, y = (LENGTH.factor * value for value in model.middle)
        axes.add_patch(Circle((x, y), LENGTH.factor * bore / 2.0, **_BORE))
    reach = LENGTH.factor * max(layout.radius, math.hypot(*model.middle) + bore / 2.0)
    _draw_axes(model, axes)
    axes.set_aspect("equal")
    axes.set_xlim(-margin_factor * reach, margin_factor * reach)
    axes.set_ylim(-margin_factor * reach, margin_factor * reach)
    axes.set_xlabel(LENGTH.label("x"))
    axes.set_ylabel(LENGTH.label("y, direction of bending"))


def _draw_axes(model: BundleModel, axes: Axes) -> None:
    """Draw the directions of the largest and the smallest stiffness through the neutral point."""
    x, y = (LENGTH.factor * value for value in model.neutral)
    reach = 1.06 * LENGTH.factor * model.layout.radius
    angle = math.pi / 2.0 if _is_isotropic(model) else model.principal_angle
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
    for moment, look, doubtful in (
        (slip, _SLIP, model.is_doubtful[use]),
        (stick, _STICK, model.is_doubtful_stick[use]),
    ):
        for part, fade in split_doubtful(~doubtful):
            axes.plot(across[part], moment[part], **look, alpha=fade)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(across[0], across[-1])
    axes.set_xlabel(CURVATURE.label("Curvature"))
    axes.set_ylabel(MOMENT.label("Bending moment"))
    for axis in (axes.xaxis, axes.yaxis):
        label_log_axis(axis)


def _bundle_keys(model: BundleModel) -> list[Artist]:
    colours = _colours()
    keys: list[Artist] = [
        area_key(wire.type, facecolor=colours[number % len(colours)], **_OUTLINE)
        for number, wire in enumerate(model.bundle.wires)
    ]
    if model.bundle.conduit_bore is not None:
        bore = {name: _BORE[name] for name in ("linewidth", "linestyle")}
        keys.append(line_key("bore of the conduit", color="black", **bore))
    if _is_isotropic(model):
        keys.append(line_key("y and x: equal in all directions", **_STIFFEST))
    else:
        keys.append(line_key("stiffest direction", **_STIFFEST))
        keys.append(line_key("most flexible direction", **_SOFTEST))
    return [
        *keys,
        line_key("wires stick", **_STICK),
        line_key("wires slip", **_SLIP),
        line_key("without yielding of copper", **_ELASTIC),
    ]


def _title(model: BundleModel) -> str:
    text = f"{model.bundle.composition}  ·  bundle model  ·  {model.layout.arrangement}"
    if model.packing_fraction is None:
        return text
    bore = LENGTH.factor * (model.bundle.conduit_bore or 0.0)
    return f"{text}  ·  packing fraction {model.packing_fraction:.2f} in {bore:.3g} {LENGTH.unit}"


def _note(model: BundleModel) -> str:
    least, largest = model.principal
    directions = (
        "equal in all directions"
        if _is_isotropic(model)
        else f"{_digits(least)} to {_digits(largest)} over all directions"
    )
    bounds = (
        f"EI in {STIFFNESS.unit}: {_digits(model.low)} with wires and strands slipping, "
        f"{_digits(model.free)} with wires slipping, {_digits(model.high)} with nothing slipping "
        f"({directions})."
    )
    limits = [
        note.message.replace("N mm^2", "N\u00b7mm\u00b2")
        for note in model.notes
        if note.code in ("copper_yields", "insulation_doubtful")
    ]
    return " ".join([bounds, *(f"{limit[0].upper()}{limit[1:]}." for limit in limits)])


def _digits(stiffness: float) -> str:
    return write_number(stiffness, None, STIFFNESS.factor, digits=4).value


def _is_isotropic(model: BundleModel) -> bool:
    rel_tolerance = 1e-6
    least, largest = model.principal
    return largest - least <= rel_tolerance * largest


def _colours() -> list[str]:
    colours = style_colours()
    # light colours first: lines are drawn over them
    return colours[-1:] + colours[-2:-1] + colours[2:4]


LOOP_FIGURE = "bundle-loop"
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
    page = FigureToSave(LOOP_FIGURE, partial(loop_figure, name, fit))
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
    texts = PageTexts(f"{name}  ·  friction between the wires", _loop_note(fit), keys)
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


def _loop_note(fit: FrictionFit) -> str:
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
