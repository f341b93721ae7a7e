"""Tables and figures of bundles: section, bounds of bending stiffness, measured cycles."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from math import isnan, nan
from typing import TYPE_CHECKING

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.curve import Interval
from labpipe.records.group import BundlePlace, Campaign
from labpipe.records.harness_bundle import BundleModel, FrictionFit
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    GREY,
    FigureToSave,
    add_title,
    label_log_axis,
    make_page,
    read_look,
    split_pages,
)
from labpipe.report.issues import join_sentences
from labpipe.report.page_tables import Cell, Table
from labpipe.report.plot_records import split_doubtful
from labpipe.report.wire_figures import CURVATURE, LENGTH, MOMENT, STIFFNESS, set_log_axes
from labpipe.report.wording import (
    Scale,
    find_display,
    find_unit,
    write_number,
    write_with_interval,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def has_bundles(campaign: Campaign) -> bool:
    """Return whether any sample of a campaign is a harness bundle."""
    return any(
        sample.specimen.bundle is not None for group in campaign.groups for sample in group.samples
    )


def make_place_table(campaign: Campaign) -> Table | None:
    """Make the table of measured bending stiffnesses between their bounds.

    Parameters
    ----------
    campaign : with its places between the bounds

    Returns
    -------
    None without places: the report was made without a wire sheet, or no test is of a bundle.
    """
    if not campaign.places:
        return None
    scales = choose_place_units(campaign)
    rows = tuple(_row(place, scales[place.group]) for place in campaign.places)
    stiffnesses = ("Bending stiffness", "All slips", "Wires slip", "Nothing slips")
    heads = ("Test", *map(next(iter(scales.values())).label, stiffnesses), "Share of the way")
    notes = format_sentence("report.bounds_of_bundles"), format_sentence("report.share_of_the_way")
    return Table("Between slipping and sticking", heads, rows, notes)


def choose_place_units(campaign: Campaign) -> dict[str, Scale]:
    """Choose the unit of bending stiffness by group: that of its protocol, SI if they differ."""
    scales = {
        group.name: find_unit(find_display(group), "bending_stiffness") for group in campaign.groups
    }
    first = next(iter(scales.values()))
    is_one = all(scale.unit == first.unit for scale in scales.values())
    return scales if is_one else dict.fromkeys(scales, find_unit({}, "bending_stiffness"))


def _row(place: BundlePlace, scale: Scale) -> tuple[Cell, ...]:
    low, free, high, smallest, largest = (
        write_number(stiffness, None, scale.factor, digits=3).value
        for stiffness in (place.low, place.free, place.high, *place.principal)
    )
    value = nan if place.value is None else place.value
    share = write_number(100.0 * place.share, None, digits=2).value
    if place.share_interval is not None:
        share = write_with_interval(place.share, place.share_interval, 100.0)
    return (
        Cell(place.test, place.group) if place.test else Cell(f"mean of {place.group}"),
        Cell(write_with_interval(value, place.interval, scale.factor)),
        Cell(low),
        Cell(free),
        Cell(high, "" if smallest == largest else f"{smallest} to {largest}"),
        Cell(share if isnan(place.share) else f"{share} %", join_sentences(place.reasons)),
    )


MAX_ROWS = 36
"""Rows in one figure."""


def list_place_figures(campaign: Campaign) -> Iterator[FigureToSave]:
    """List the figures of measured bending stiffnesses between their bounds.

    Parameters
    ----------
    campaign : with its places between the bounds

    Yields
    ------
    Figures of up to `MAX_ROWS` rows; none without places.
    """
    scales = choose_place_units(campaign)
    parts, caption = (
        split_pages(campaign.places, MAX_ROWS),
        format_sentence("report.bundle_caption"),
    )
    for at, part in enumerate(parts, start=1):
        name = "between-slipping-and-sticking" + (f"-{at}" if len(parts) > 1 else "")
        scale = scales[part[0].group]
        groups = ", ".join(dict.fromkeys(place.group for place in part))
        alt = f"Bending stiffness between all slipping and nothing slipping: {groups}."
        yield FigureToSave(name, partial(draw_places, part, scale), caption, alt)


def draw_places(places: Sequence[BundlePlace], scale: Scale) -> Figure:
    """Draw measured bending stiffnesses, each on the bar between its bounds, on a logarithmic axis.

    Parameters
    ----------
    places : rows from the top
    scale : display unit of bending stiffness
    """
    row_mm, rest_mm, width_mm = 4.2, 16.0, 150.0
    page = make_page(height_mm=rest_mm + row_mm * len(places), width_mm=width_mm)
    axes = page.subplots()
    axes.set_xscale("log")
    axes.set_xlim(*_ends(places, scale.factor))
    for row, place in enumerate(places):
        _plot_bounds_of_row(place, row, scale.factor, axes)
        _plot_value(place, row, scale.factor, axes)
    names = [place.test or f"mean of {place.group}" for place in places]
    axes.set_yticks(range(len(places)), names)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(places) - 0.4, -0.6)
    axes.set_xlabel(scale.label("Bending stiffness"))
    label_log_axis(axes.xaxis)
    return add_title(page, "Between slipping and sticking  \u00b7  bundle model")


def _ends(places: Sequence[BundlePlace], factor: float) -> tuple[float, float]:
    """Return the ends of the axis, from all positive bounds, values and upper interval ends."""
    every = [ei for place in places for ei in (place.low, place.high, place.value or 0.0)]
    every += [place.interval.upper for place in places if place.interval is not None]
    values = [factor * ei for ei in every if ei > 0.0] or [1.0, 10.0]  # not NaN either
    return 0.7 * min(values), 1.4 * max(values)


def _plot_bounds_of_row(place: BundlePlace, row: int, factor: float, axes: Axes) -> None:
    if isnan(place.low):
        return
    ends = [factor * place.low, factor * place.high]
    axes.plot(ends, [row, row], **read_look("bounds_of_bundle"))
    axes.plot([factor * place.free], [row], **read_look("slipping_wires"))


def _plot_value(place: BundlePlace, row: int, factor: float, axes: Axes) -> None:
    """Draw the measured stiffness with its interval, and write why it has no bounds."""
    max_reason_length = 88
    look = read_look("bundle_sample" if place.test else "bundle_mean")
    if place.value is not None and place.value > 0.0:
        if place.interval is not None:
            left = axes.get_xlim()[0]
            ends = [max(factor * place.interval.lower, left), factor * place.interval.upper]
            axes.plot(ends, [row, row], color=look["color"], linewidth=1.0, zorder=2)
        axes.plot([factor * place.value], [row], **look)
    why = join_sentences(place.reasons)
    if why:
        text = why if len(why) <= max_reason_length else f"{why[:max_reason_length]}\u2026"
        axes.text(0.99, row, text, transform=axes.get_yaxis_transform(), ha="right", va="center",
                  size=6, color=GREY)  # fmt: skip


FIGURE, LOOP_FIGURE = "bundle", "bundle-loop"
"""Names of the files, without the ending."""


def draw_bundle(model: BundleModel) -> Figure:
    """Draw (a) the section of a bundle and (b) its moments against curvature.

    Parameters
    ----------
    model : of the bundle

    Returns
    -------
    A page. In (a), lines through the neutral point show the principal directions up to the edge of
    the wires; the bundle is bent along y, upwards. Both axes of (b) are logarithmic.
    """
    page = make_page(height_mm=84.0, width_mm=DOUBLE_COLUMN)
    section, moments = page.subplots(1, 2, width_ratios=(0.8, 1.0))
    _plot_section(model, section)
    _plot_bounds(model, moments)
    section.set_title("Section", loc="left")
    moments.set_title("First loading, bent along y", loc="left")
    return add_title(page, _write_title(model), _describe_bounds(model))


def _plot_section(model: BundleModel, axes: Axes) -> None:
    """Draw the wires to scale, the conduit's bore, and the principal axes."""
    margin_factor = 1.12
    from matplotlib.patches import Circle

    colours = ("#8ec3e6", "#f3d38a", "#93d5c0", "#e2b5cd")  # light: lines are over them
    layout, wires = model.layout, model.bundle.wires
    places = LENGTH.factor * np.column_stack([layout.x, layout.y])
    for place, diameter, kind in zip(places, layout.diameter, layout.kind, strict=True):
        look = {"facecolor": colours[int(kind) % len(colours)], "label": wires[int(kind)].type}
        radius = LENGTH.factor * diameter / 2.0
        axes.add_patch(Circle(tuple(place), radius, edgecolor="black", linewidth=0.5, **look))
    bore = model.bundle.conduit_bore or 0.0
    if bore:
        x, y = (LENGTH.factor * value for value in model.middle)
        radius = LENGTH.factor * bore / 2.0
        axes.add_patch(Circle((x, y), radius, **read_look("bore_of_conduit")))
    reach = LENGTH.factor * max(layout.radius, math.hypot(*model.middle) + bore / 2.0)
    _draw_axes(model, axes)
    axes.set_aspect("equal")
    axes.set_xlim(-margin_factor * reach, margin_factor * reach)
    axes.set_ylim(-margin_factor * reach, margin_factor * reach)
    axes.set(xlabel=LENGTH.label("x"), ylabel=LENGTH.label("y, direction of bending"))


def _draw_axes(model: BundleModel, axes: Axes) -> None:
    """Draw the directions of the largest and the smallest stiffness through the neutral point.

    If all directions are equally stiff, the lines are along y and x.
    """
    x, y = (LENGTH.factor * value for value in model.neutral)
    reach = 1.06 * LENGTH.factor * model.layout.radius
    angle = model.principal_angle
    stiffest, flexible = read_look("stiffest_direction"), read_look("most_flexible_direction")
    if _is_isotropic(model):
        angle = math.pi / 2.0
        stiffest["label"], flexible["label"] = "y and x: equal in all directions", ""
    for direction, look in ((angle, stiffest), (angle + math.pi / 2.0, flexible)):
        dx, dy = reach * math.cos(direction), reach * math.sin(direction)
        axes.plot([x - dx, x + dx], [y - dy, y + dy], **look)
    axes.plot([x], [y], "k+", markersize=7.0, zorder=5)


def _plot_bounds(model: BundleModel, axes: Axes) -> None:
    """Draw the moments of wires that slip and of wires that stick, on logarithmic axes."""
    use = model.curvature > 0.0
    x = CURVATURE.factor * model.curvature[use]
    slip, stick = (
        MOMENT.factor * moment[use] for moment in (model.moment_slip, model.moment_stick)
    )
    axes.fill_between(x, slip, stick, color="#dedede", linewidth=0)
    for moment, look, is_doubtful in (
        (stick, "wires_stick", model.is_doubtful_stick[use]),
        (slip, "wires_slip", model.is_doubtful[use]),
    ):
        for part, opacity in split_doubtful(~is_doubtful):
            axes.plot(x[part], moment[part], **read_look(look, alpha=opacity))
    for limit in (model.low, model.high):
        moment = MOMENT.factor * limit * model.curvature[use]
        axes.plot(x, moment, **read_look("bundle_without_yielding"))
    set_log_axes(axes, x)
    axes.set_ylabel(MOMENT.label("Bending moment"))


def _write_title(model: BundleModel) -> str:
    text = f"{model.bundle.composition}  ·  bundle model  ·  {model.layout.arrangement}"
    if model.packing_fraction is None:
        return text
    bore = LENGTH.factor * (model.bundle.conduit_bore or 0.0)
    return f"{text}  ·  packing fraction {model.packing_fraction:.2f} in {bore:.3g} {LENGTH.unit}"


def _describe_bounds(model: BundleModel) -> str:
    low, free, high, smallest, largest = (
        write_number(stiffness, None, STIFFNESS.factor, digits=4).value
        for stiffness in (model.low, model.free, model.high, *model.principal)
    )
    directions = f"{smallest} to {largest} over all directions"
    if _is_isotropic(model):
        directions = "equal in all directions"
    bounds = format_sentence(
        "report.bounds_of_bundle", low=low, free=free, high=high, directions=directions
    )
    limits = [
        note.message.replace("N mm^2", "N\u00b7mm\u00b2")
        for note in model.notes
        if note.code in ("copper_yields", "insulation_doubtful")
    ]
    return " ".join([bounds, *(f"{limit[0].upper()}{limit[1:]}." for limit in limits)])


def _is_isotropic(model: BundleModel) -> bool:
    rel_tolerance = 1e-6
    smallest, largest = model.principal
    return largest - smallest <= rel_tolerance * largest


def draw_loop(name: str, fit: FrictionFit) -> Figure:
    """Draw (a) the fitted and (b) the predicted force, each over the measured force.

    Parameters
    ----------
    name : of the test
    fit : of the friction between its wires
    """
    page = make_page(height_mm=82.0, width_mm=DOUBLE_COLUMN)
    panels = page.subplots(1, 2, sharex=True, sharey=True)
    for axes, chosen, label, colour, heading, error in (
        (panels[0], ~fit.is_held_out, "fitted (one parameter)", "C0", "Fitted", fit.error_fitted),
        (panels[1], fit.is_held_out, "predicted", "C1", "Left out", fit.error_held_out),
    ):
        deflection = LENGTH.factor * fit.loop.deflection[chosen]
        axes.plot(deflection, fit.loop.force[chosen], **read_look("measured_cycles"))
        axes.plot(deflection, fit.predicted[chosen], color=colour, linewidth=1.4, label=label)
        axes.axhline(0.0, color="#bbbbbb", linewidth=0.5, zorder=0)
        axes.set(xlabel=LENGTH.label("Deflection"), ylabel="Force at the tip (N)")
        axes.set_title(f"{heading}, error {_percent(error)} of the peak", loc="left")
    return add_title(page, f"{name}  ·  friction between the wires", _describe_friction(fit))


def _describe_friction(fit: FrictionFit) -> str:
    slide = LENGTH.factor * fit.slide_curvature * fit.loop.length**2 / 3.0
    held = write_number(fit.held, Interval(fit.held_lower, fit.held_upper), 100.0)
    return format_sentence(
        "report.friction_of_bundle",
        composite=_percent(fit.composite_share),
        kink=LENGTH.factor * fit.loop.kink[0],
        tape=f"; the tape slides beyond {slide:.3g} mm" if np.isfinite(slide) else "",
        held=held,
        work=1e3 * fit.loss,
        predicted_work=1e3 * fit.predicted_loss,
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"
