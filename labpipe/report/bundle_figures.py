"""Draw harness bundles: their section, the bounds of their bending stiffness, measured cycles."""

from __future__ import annotations

import math
from math import isnan, nan
from typing import Any

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.curve import Interval
from labpipe.records.group import BoundedStiffness, Campaign
from labpipe.records.harness_bundle import BundleModel, FrictionFit
from labpipe.report import plot_records as plots
from labpipe.report.issues import join_sentences
from labpipe.report.page_tables import Cell, Table
from labpipe.report.plot_records import Axis, Page, Plot, line
from labpipe.report.wire_figures import FORCE, LENGTH, MOMENT, STIFFNESS, make_curvature_axis
from labpipe.report.wording import (
    Scale,
    find_display,
    find_unit,
    write_number,
    write_with_interval,
)


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
"""File name of the figure of `make_bundle_page`, without the extension."""
LOOP_FIGURE = "bundle-loop"
"""File name of the figure of `make_loop_page`, without the extension."""


def make_bundle_page(model: BundleModel) -> Page:
    """Make the page of (a) the section of a bundle, (b) the bounds of its moment over curvature.

    Parameters
    ----------
    model : model of the bundle

    Returns
    -------
    A page. In (a), two lines through the neutral point show the directions of the largest and the
    smallest stiffness; the bundle is bent upwards, along y. Both axes of (b) are logarithmic.
    """
    panels = [_make_section_plot(model), _make_moment_plot(model)]
    title = f"{model.bundle.composition}  ·  bundle model  ·  {model.layout.arrangement}"
    if model.packing_fraction is not None:
        bore = LENGTH.factor * (model.bundle.conduit_bore or 0.0)
        title += f"  ·  packing fraction {model.packing_fraction:.2f} in {bore:.3g} {LENGTH.unit}"
    limitations = [
        note.message.replace("N mm^2", STIFFNESS.unit)
        for note in model.notes
        if note.code in ("copper_yields", "insulation_doubtful")
    ]
    sentences = [describe_stiffness(model), *(f"{t[0].upper()}{t[1:]}." for t in limitations)]
    return Page(BUNDLE_FIGURE, title, panels, " ".join(sentences), 84.0, widths=(0.8, 1.0))


def _make_section_plot(model: BundleModel) -> Plot:
    """Make the panel of the wires and the bore of the conduit, and the principal directions.

    If the stiffness is equal in all directions, the lines are along y and x.
    """
    margin_factor = 1.12  # half-width of the panel, as a multiple of the largest radius
    colours = ("#8ec3e6", "#f3d38a", "#93d5c0", "#e2b5cd")  # light, since lines are drawn over them
    layout, bore, angle = model.layout, model.bundle.conduit_bore or 0.0, model.principal_angle
    lines = []
    for kind in range(len(model.bundle.wires)):
        rows = layout.kind == kind
        look = {"facecolor": colours[kind % len(colours)], "label": model.bundle.wires[kind].type}
        radius = layout.diameter[rows] / 2.0
        lines.append(
            plots.circles("wire_of_bundle", layout.x[rows], layout.y[rows], radius, **look)
        )
    if bore:
        lines.append(plots.circles("bore_of_conduit", *model.middle, bore / 2.0))
    looks: dict[str, dict[str, Any]] = {"stiffest_direction": {}, "most_flexible_direction": {}}
    if _is_isotropic(model):
        label, angle = "y and x: equal in all directions", math.pi / 2.0
        looks = {"stiffest_direction": {"label": label}, "most_flexible_direction": {"label": ""}}
    for look_name, settings in looks.items():
        reach = 1.06 * layout.radius * np.array([[math.cos(angle)], [math.sin(angle)]])
        x, y = np.array(model.neutral)[:, None] + reach * np.array([-1.0, 1.0])
        lines.append(line(look_name, x, y, **settings))
        angle += math.pi / 2.0
    lines.append(line("neutral_point", *model.neutral))
    edge = margin_factor * max(layout.radius, math.hypot(*model.middle) + bore / 2.0)
    x_axis, y_axis = (Axis(name, LENGTH, -edge, edge) for name in ("x", "y, direction of bending"))
    return Plot(x_axis, y_axis, lines, "Section", is_to_scale=True)


def _make_moment_plot(model: BundleModel) -> Plot:
    """Make the panel of the moments of slipping and of sticking wires, on logarithmic axes."""
    use = model.curvature > 0.0
    x, slip, stick = (
        values[use] for values in (model.curvature, model.moment_slip, model.moment_stick)
    )
    lines = [plots.area("between_bounds", x, slip, stick)]
    for moment, look, is_doubtful in (
        (stick, "wires_stick", model.is_doubtful_stick[use]),
        (slip, "wires_slip", model.is_doubtful[use]),
    ):
        for part, opacity in plots.split_doubtful(~is_doubtful):
            lines.append(line(look, x[part], moment[part], alpha=opacity))
    for stiffness in (model.low, model.high):
        lines.append(line("bundle_without_yielding", x, stiffness * x))
    y = Axis("Bending moment", MOMENT, is_log=True)
    return Plot(make_curvature_axis(x), y, lines, "First loading, bent along y")


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


def _is_isotropic(model: BundleModel) -> bool:
    relative_tolerance = 1e-6
    smallest, largest = model.principal
    return largest - smallest <= relative_tolerance * largest


def make_loop_page(name: str, fit: FrictionFit) -> Page:
    """Make the page of the fitted force (a) and the predicted force (b), with the measured force.

    Parameters
    ----------
    name : name of the test
    fit : fit of the friction between the wires
    """
    x, y = Axis("Deflection", LENGTH), Axis("Force at the tip", FORCE)
    panels = []
    for rows, label, colour, heading, error in (
        (~fit.is_held_out, "fitted (one parameter)", "C0", "Fitted", fit.error_fitted),
        (fit.is_held_out, "predicted", "C1", "Left out", fit.error_held_out),
    ):
        deflection = fit.loop.deflection[rows]
        lines = [
            line("measured_cycles", deflection, fit.loop.force[rows]),
            line("modelled_cycles", deflection, fit.predicted[rows], color=colour, label=label),
            plots.level("zero", 0.0),
        ]
        panels.append(Plot(x, y, lines, f"{heading}, error {_format_percent(error)} of the peak"))
    title = f"{name}  ·  friction between the wires"
    return Page(LOOP_FIGURE, title, panels, describe_friction(fit), 82.0, shared="xy")


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
