"""Draw harness bundles: their section, the bounds of their bending stiffness, measured cycles."""

from __future__ import annotations

import math
from math import isnan, nan
from typing import TYPE_CHECKING

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.curve import Interval
from labpipe.records.group import BoundedStiffness, Campaign
from labpipe.records.harness_bundle import BundleModel, FrictionFit
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    add_title,
    make_page,
    read_look,
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


def make_bounds_table(campaign: Campaign) -> Table | None:
    """Make the table of measured bending stiffnesses of bundles and their bounds.

    Parameters
    ----------
    campaign : content of the report

    Returns
    -------
    The table; None if the report was made without a wire sheet, or if no test is of a bundle.
    """
    if not campaign.bounded_stiffnesses:
        return None
    scales = choose_stiffness_units(campaign)
    rows = tuple(
        _make_row(stiffness, scales[stiffness.group]) for stiffness in campaign.bounded_stiffnesses
    )
    quantities = ("Bending stiffness", "All slips", "Wires slip", "Nothing slips")
    headings = ("Test", *map(next(iter(scales.values())).label, quantities), "Share of the way")
    notes = format_sentence("report.bounds_of_bundles"), format_sentence("report.share_of_the_way")
    return Table("Between slipping and sticking", headings, rows, notes)


def choose_stiffness_units(campaign: Campaign) -> dict[str, Scale]:
    """Choose the display unit of bending stiffness for each group.

    Parameters
    ----------
    campaign : content of the report, with at least one group

    Returns
    -------
    Scale by group: the unit of its protocol, or SI for all groups if their units differ.
    """
    scales = {
        group.name: find_unit(find_display(group), "bending_stiffness") for group in campaign.groups
    }
    first = next(iter(scales.values()))
    has_common_unit = all(scale.unit == first.unit for scale in scales.values())
    return scales if has_common_unit else dict.fromkeys(scales, find_unit({}, "bending_stiffness"))


def _make_row(stiffness: BoundedStiffness, scale: Scale) -> tuple[Cell, ...]:
    all_slip, wires_slip, nothing_slips, smallest, largest = (
        write_number(bound, None, scale.factor, digits=3).value
        for bound in (stiffness.low, stiffness.free, stiffness.high, *stiffness.principal)
    )
    value = nan if stiffness.value is None else stiffness.value
    share_text = write_number(100.0 * stiffness.share, None, digits=2).value
    if stiffness.share_interval is not None:
        share_text = write_with_interval(stiffness.share, stiffness.share_interval, 100.0)
    if not isnan(stiffness.share):
        share_text += " %"
    return (
        Cell(stiffness.test, stiffness.group)
        if stiffness.test
        else Cell(f"mean of {stiffness.group}"),
        Cell(write_with_interval(value, stiffness.interval, scale.factor)),
        Cell(all_slip),
        Cell(wires_slip),
        Cell(nothing_slips, "" if smallest == largest else f"{smallest} to {largest}"),
        Cell(share_text, join_sentences(stiffness.reasons)),
    )


BUNDLE_FIGURE = "bundle"
"""File name of the figure of `draw_bundle`, without the extension."""
LOOP_FIGURE = "bundle-loop"
"""File name of the figure of `draw_loop`, without the extension."""


def draw_bundle(model: BundleModel) -> Figure:
    """Draw (a) the section of a bundle and (b) the bounds of its bending moment over curvature.

    Parameters
    ----------
    model : model of the bundle

    Returns
    -------
    A page. In (a), two lines through the neutral point show the directions of the largest and the
    smallest stiffness; the bundle is bent upwards, along y. Both axes of (b) are logarithmic.
    """
    page = make_page(height_mm=84.0, width_mm=DOUBLE_COLUMN)
    section, moments = page.subplots(1, 2, width_ratios=(0.8, 1.0))
    _plot_section(model, section)
    _plot_moment_bounds(model, moments)
    section.set_title("Section", loc="left")
    moments.set_title("First loading, bent along y", loc="left")
    return add_title(page, _write_title(model), _describe_bounds(model))


def _plot_section(model: BundleModel, axes: Axes) -> None:
    """Draw the wires and the bore of the conduit to scale, and the principal directions."""
    margin_factor = 1.12  # half-width of the panel, as a multiple of the largest radius
    from matplotlib.patches import Circle

    colours = ("#8ec3e6", "#f3d38a", "#93d5c0", "#e2b5cd")  # light, since lines are drawn over them
    layout, wires = model.layout, model.bundle.wires
    centres = LENGTH.factor * np.column_stack([layout.x, layout.y])
    for centre, diameter, kind in zip(centres, layout.diameter, layout.kind, strict=True):
        look = {"facecolor": colours[int(kind) % len(colours)], "label": wires[int(kind)].type}
        radius = LENGTH.factor * diameter / 2.0
        axes.add_patch(Circle(tuple(centre), radius, edgecolor="black", linewidth=0.5, **look))
    bore = model.bundle.conduit_bore or 0.0
    if bore:
        x, y = (LENGTH.factor * coordinate for coordinate in model.middle)
        radius = LENGTH.factor * bore / 2.0
        axes.add_patch(Circle((x, y), radius, **read_look("bore_of_conduit")))
    outer_radius = LENGTH.factor * max(layout.radius, math.hypot(*model.middle) + bore / 2.0)
    _plot_principal_directions(model, axes)
    axes.set_aspect("equal")
    axes.set_xlim(-margin_factor * outer_radius, margin_factor * outer_radius)
    axes.set_ylim(-margin_factor * outer_radius, margin_factor * outer_radius)
    axes.set(xlabel=LENGTH.label("x"), ylabel=LENGTH.label("y, direction of bending"))


def _plot_principal_directions(model: BundleModel, axes: Axes) -> None:
    """Draw the directions of the largest and the smallest stiffness through the neutral point.

    If the stiffness is equal in all directions, the lines are along y and x.
    """
    x, y = (LENGTH.factor * coordinate for coordinate in model.neutral)
    half_length = 1.06 * LENGTH.factor * model.layout.radius
    angle = model.principal_angle
    stiffest, flexible = read_look("stiffest_direction"), read_look("most_flexible_direction")
    if _is_isotropic(model):
        angle = math.pi / 2.0
        stiffest["label"], flexible["label"] = "y and x: equal in all directions", ""
    for direction, look in ((angle, stiffest), (angle + math.pi / 2.0, flexible)):
        dx, dy = half_length * math.cos(direction), half_length * math.sin(direction)
        axes.plot([x - dx, x + dx], [y - dy, y + dy], **look)
    axes.plot([x], [y], "k+", markersize=7.0, zorder=5)


def _plot_moment_bounds(model: BundleModel, axes: Axes) -> None:
    """Draw the moments of slipping and of sticking wires, on logarithmic axes."""
    is_positive = model.curvature > 0.0
    x = CURVATURE.factor * model.curvature[is_positive]
    slip, stick = (
        MOMENT.factor * moment[is_positive] for moment in (model.moment_slip, model.moment_stick)
    )
    axes.fill_between(x, slip, stick, color="#dedede", linewidth=0)
    for moment, look_name, is_doubtful in (
        (stick, "wires_stick", model.is_doubtful_stick[is_positive]),
        (slip, "wires_slip", model.is_doubtful[is_positive]),
    ):
        for is_in_part, opacity in split_doubtful(~is_doubtful):
            axes.plot(x[is_in_part], moment[is_in_part], **read_look(look_name, alpha=opacity))
    for stiffness in (model.low, model.high):
        moment = MOMENT.factor * stiffness * model.curvature[is_positive]
        axes.plot(x, moment, **read_look("bundle_without_yielding"))
    set_log_axes(axes, x)
    axes.set_ylabel(MOMENT.label("Bending moment"))


def _write_title(model: BundleModel) -> str:
    text = f"{model.bundle.composition}  ·  bundle model  ·  {model.layout.arrangement}"
    if model.packing_fraction is None:
        return text
    bore = LENGTH.factor * (model.bundle.conduit_bore or 0.0)
    return f"{text}  ·  packing fraction {model.packing_fraction:.2f} in {bore:.3g} {LENGTH.unit}"


def describe_stiffness(model: BundleModel) -> str:
    """Describe the bounds of the bending stiffness of a bundle in a sentence."""
    all_slip, wires_slip, nothing_slips, smallest, largest = (
        write_number(stiffness, None, STIFFNESS.factor, digits=4).value
        for stiffness in (model.low, model.free, model.high, *model.principal)
    )
    directions = f"{smallest} to {largest} over all directions"
    if _is_isotropic(model):
        directions = "equal in all directions"
    return format_sentence(
        "report.bounds_of_bundle",
        all_slip=all_slip,
        wires_slip=wires_slip,
        nothing_slips=nothing_slips,
        directions=directions,
    )


def _describe_bounds(model: BundleModel) -> str:
    limitations = [
        note.message.replace("N mm^2", "N\u00b7mm\u00b2")
        for note in model.notes
        if note.code in ("copper_yields", "insulation_doubtful")
    ]
    return " ".join(
        [describe_stiffness(model), *(f"{text[0].upper()}{text[1:]}." for text in limitations)]
    )


def _is_isotropic(model: BundleModel) -> bool:
    relative_tolerance = 1e-6
    smallest, largest = model.principal
    return largest - smallest <= relative_tolerance * largest


def draw_loop(name: str, fit: FrictionFit) -> Figure:
    """Draw the fitted force (a) and the predicted force (b) together with the measured force.

    Parameters
    ----------
    name : name of the test
    fit : fit of the friction between the wires
    """
    page = make_page(height_mm=82.0, width_mm=DOUBLE_COLUMN)
    panels = page.subplots(1, 2, sharex=True, sharey=True)
    for axes, is_drawn, label, colour, heading, error in (
        (panels[0], ~fit.is_held_out, "fitted (one parameter)", "C0", "Fitted", fit.error_fitted),
        (panels[1], fit.is_held_out, "predicted", "C1", "Left out", fit.error_held_out),
    ):
        deflection = LENGTH.factor * fit.loop.deflection[is_drawn]
        axes.plot(deflection, fit.loop.force[is_drawn], **read_look("measured_cycles"))
        axes.plot(deflection, fit.predicted[is_drawn], color=colour, linewidth=1.4, label=label)
        axes.axhline(0.0, color="#bbbbbb", linewidth=0.5, zorder=0)
        axes.set(xlabel=LENGTH.label("Deflection"), ylabel="Force at the tip (N)")
        axes.set_title(f"{heading}, error {_format_percent(error)} of the peak", loc="left")
    return add_title(page, f"{name}  ·  friction between the wires", describe_friction(fit))


def describe_friction(fit: FrictionFit) -> str:
    """Describe the friction between the wires of a bundle, and the errors of its prediction."""
    slide_mm = LENGTH.factor * fit.slide_curvature * fit.loop.length**2 / 3.0
    held_share = write_number(fit.held, Interval(fit.held_lower, fit.held_upper), 100.0)
    return format_sentence(
        "report.friction_of_bundle",
        composite=_format_percent(fit.composite_share),
        kink=LENGTH.factor * fit.loop.kink[0],
        tape=f"; the tape slides beyond {slide_mm:.3g} mm" if np.isfinite(slide_mm) else "",
        held=held_share,
        work=1e3 * fit.loss,
        predicted_work=1e3 * fit.predicted_loss,
        error_fitted=_format_percent(fit.error_fitted),
        error_left_out=_format_percent(fit.error_held_out),
    )


def _format_percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"
