"""Make the figures of harnesses and their bundles: lines, bend radii, sections and moments."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import Interval
from labpipe.records.harness_bundle import BundleModel, FrictionFit
from labpipe.report import plot_records as plots
from labpipe.report import wording
from labpipe.report.figure_page import DASHED, sample_colour_map
from labpipe.report.plot_records import Axis, Line, Page, Plot, make_line
from labpipe.report.wire_report import MOMENT_SCALE, STIFFNESS_SCALE, make_curvature_axis
from labpipe.report.wording import FORCE_SCALE, LENGTH_SCALE, format_number, join_sentences

SWEEP_FIGURE = "harness-sweep"
"""Name of the figure of the lengths of a harness and of its files, without extension."""

_BOUNDARY_KINDS = ("clip", "pin", "grip", "ring", "string", "load")
"""Kinds of boundaries, in the order of the legend."""
_VIEWS = {"side": (0, 2), "end": (1, 2), "top": (0, 1)}
"""Indices of the coordinates that point to the right and upwards in each view."""


@dataclass(frozen=True, slots=True, eq=False)
class DrawnShape:
    """Shape of the line of a harness at one step.

    Parameters
    ----------
    step : number of the step
    positions : shape (n + 1, 3), positions of the nodes, m
    radius : shape (n + 1,), bend radius, m; infinite where the line is straight
    band : lower and upper ends of the positions, shape (n + 1, 3) each, m; None without a band
    radius_band : lower and upper ends of the radius, shape (n + 1,) each, m; None without a band
    """

    step: int
    positions: Floats
    radius: Floats
    band: tuple[Floats, Floats] | None = None
    radius_band: tuple[Floats, Floats] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DrawnBoundary:
    """Boundary that holds or pulls the line of a harness.

    Parameters
    ----------
    name, kind : name and kind of the boundary; the kind is one of `_BOUNDARY_KINDS`
    position : shape (3,), position at the last step, m
    path : shape (k, 3), positions of a grip at each step or ends of a string, m; empty for other
        kinds
    direction : shape (3,), unit vector of the line or of the axis of a ring; None without a
        direction
    is_holding : whether the boundary holds the line at the last step
    """

    name: str
    kind: str
    position: Floats
    path: Floats
    direction: Floats | None = None
    is_holding: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class DrawnHarness:
    """Data that the figure of a harness shows.

    Parameters
    ----------
    name : name of the harness, for the title
    note : footnote
    arc_length : shape (n + 1,), distance of the nodes from the start along the line, m
    shapes : shape at each step; the last is drawn with its band and colours, others as thin lines
    boundaries : clips, grips and other boundaries of the line
    planes : a point (m) and the unit normal of each plane that the line may touch
    allowed_radius : smallest allowed bend radius, m
    """

    name: str
    note: str
    arc_length: Floats
    shapes: tuple[DrawnShape, ...]
    boundaries: tuple[DrawnBoundary, ...]
    planes: tuple[tuple[Floats, Floats], ...]
    allowed_radius: float


def list_harness_figures(harness: DrawnHarness, sweep: DrawnSweep | None) -> list[Page]:
    """List the figures of a harness: its shape, and the comparison of its lengths.

    Parameters
    ----------
    harness : data that the figure of the harness shows
    sweep : results for several lengths; None without a sweep
    """
    return [make_harness_page(harness), *([] if sweep is None else [make_sweep_page(sweep)])]


def make_harness_page(harness: DrawnHarness) -> Page:
    """Make the page of the line of a harness from three sides, and of its bend radius.

    Parameters
    ----------
    harness : data that the figure shows
    """
    max_radius_ratio = 40.0  # larger radii, relative to the allowed radius, have one colour
    low, high = harness.allowed_radius, max_radius_ratio * harness.allowed_radius
    colour_axis = Axis("Bend radius", LENGTH_SCALE, low, high, is_log=True)
    panels = [*(make_view_plot(harness, view) for view in _VIEWS), _make_radius_plot(harness)]
    title, widths = f"{harness.name}  ·  shape", (1.35, 1.0)
    return Page(
        "harness", title, panels, harness.note, height=118.0, widths=widths, colour_axis=colour_axis
    )


def make_view_plot(harness: DrawnHarness, view: str) -> Plot:
    """Make the panel of the line of a harness, its planes and its boundaries from one side.

    Parameters
    ----------
    harness : data that the figure shows
    view : ``side``, ``end`` or ``top``

    Returns
    -------
    A plot in which the line of the last step is coloured by its bend radius.
    """
    axes = list(_VIEWS[view])
    *earlier_shapes, last_shape = harness.shapes
    positions = np.vstack([shape.positions for shape in harness.shapes])
    extent = float(np.max(np.ptp(positions, axis=0)))
    lines = list(_make_plane_lines(harness, extent, axes))
    step_label = f"step {', '.join(str(shape.step) for shape in earlier_shapes)}"
    for shape in earlier_shapes:
        lines.append(make_line("earlier_step", *shape.positions[:, axes].T, label=step_label))
    if last_shape.band is not None:
        lines.append(_make_band(*(edge[:, axes] for edge in last_shape.band)))
    harness_line = make_line("harness_line", *last_shape.positions[:, axes].T)
    lines.append(replace(harness_line, values=last_shape.radius))
    lines += _make_boundary_lines(harness, extent, axes)
    boundary_points = [np.vstack([item.position, item.path]) for item in harness.boundaries]
    all_points = np.vstack([positions, *boundary_points])[:, axes]
    names = ["xyz"[axis] for axis in axes]
    x, y = plots.make_axes_to_scale(names, LENGTH_SCALE, all_points, min_aspect=0.24)
    return Plot(x, y, lines, f"From the {view}", is_to_scale=True)


def _make_band(lower: Floats, upper: Floats) -> Line:
    """Make the area of a band between neighbouring nodes, with gaps where the band has no area.

    Parameters
    ----------
    lower, upper : shape (n + 1, 2), ends of the positions of the nodes in the view, m
    """
    from scipy.spatial import ConvexHull, QhullError

    gap, edges = np.full((1, 2), np.nan), (lower, upper)
    outlines = [gap]
    corners = [np.stack([x[:, 0], y[:, 1]], axis=1) for x in edges for y in edges]
    for node in range(len(lower) - 1):
        points = np.vstack([corner[node : node + 2] for corner in corners])
        try:
            outlines += [points[ConvexHull(points).vertices], gap]
        except QhullError:
            continue
    return make_line("harness_band", *np.vstack(outlines).T, is_closed=True)


def _make_plane_lines(harness: DrawnHarness, extent: float, axes: list[int]) -> Iterator[Line]:
    """Yield the lines of the planes that are seen from the side, not of those that face the reader.

    Parameters
    ----------
    harness : data that the figure shows
    extent : largest extent of the line of the harness along an axis, m
    axes : indices of the coordinates in the view
    """
    min_projected_length = 0.5  # of the unit normal in the view
    for plane in harness.planes:
        point, normal = (vector[axes] for vector in plane)
        projected_length = np.hypot(*normal)
        if projected_length >= min_projected_length:
            half_line = 10.0 * extent / projected_length * np.array([-normal[1], normal[0]])
            yield make_line("plane", *np.stack([point - half_line, point + half_line]).T)


def _make_boundary_lines(harness: DrawnHarness, extent: float, axes: list[int]) -> Iterator[Line]:
    """Yield marks, paths and directions of the boundaries; see `_make_plane_lines`."""
    for boundary in sorted(harness.boundaries, key=lambda item: _BOUNDARY_KINDS.index(item.kind)):
        kind, position = boundary.kind, boundary.position[axes]
        names = [item.name for item in harness.boundaries if item.kind == kind]
        colour = "black" if boundary.is_holding else "#bbbbbb"
        yield make_line(f"mark_{kind}", *position, color=colour, label=f"{kind} {', '.join(names)}")
        if len(boundary.path):
            path_label = "path of a grip" if kind == "grip" and len(boundary.path) > 1 else ""
            yield make_line("path_of_mark", *boundary.path[:, axes].T, label=path_label)
        if boundary.direction is not None:
            half_line = 0.06 * extent * boundary.direction[axes]
            ends = np.stack([position - half_line, position + half_line])
            yield make_line("direction_of_mark", *ends.T, color=colour)


def _make_radius_plot(harness: DrawnHarness) -> Plot:
    """Make the panel of the bend radius along the line, and of the allowed radius."""
    x, allowed_radius = harness.arc_length, harness.allowed_radius
    *earlier_shapes, last_shape = harness.shapes
    lines = [make_line("earlier_step", x, _mask_straight(shape.radius)) for shape in earlier_shapes]
    if last_shape.radius_band is not None:
        edges = map(_mask_straight, last_shape.radius_band)
        lines.append(plots.make_area("harness_band", x, *edges))
    lines.append(make_line("last_step", x, _mask_straight(last_shape.radius)))
    lines.append(plots.make_horizontal_line("allowed_radius", allowed_radius))
    radii = np.array([np.min(shape.radius, initial=np.inf) for shape in harness.shapes])
    low = 0.7 * min(allowed_radius, float(radii.min()))
    high = max([100.0 * allowed_radius, *(3.0 * radii[np.isfinite(radii)])])
    x_axis = Axis("From the start", LENGTH_SCALE, float(x[0]), float(x[-1]))
    y_axis = Axis("Bend radius", LENGTH_SCALE, low, high, is_log=True)
    return Plot(x_axis, y_axis, lines, "Along the line")


def _mask_straight(radius: Floats) -> Floats:
    """Return radii with NaN where the line is straight."""
    return np.asarray(np.where(np.isfinite(radius), radius, np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class DrawnSweep:
    """Results for several lengths of the line of one harness.

    Parameters
    ----------
    name : name of the harness, for the title
    note : footnote
    length : shape (k,), lengths of the line, m
    radius : shape (k,), smallest bend radius at the last step, m; NaN if not available
    radius_over_steps : shape (k,), smallest bend radius over all steps, m
    radius_band : lower and upper ends of `radius`, shape (k,) each, m; None without a band
    shapes : positions of the nodes at the last step for each length, shape (n + 1, 3), m; empty if
        no line was found
    allowed_radius : smallest allowed bend radius, m
    is_doubtful : shape (k,), whether the results for each length are doubtful
    """

    name: str
    note: str
    length: Floats
    radius: Floats
    radius_over_steps: Floats
    radius_band: tuple[Floats, Floats] | None
    shapes: tuple[Floats, ...]
    allowed_radius: float
    is_doubtful: Flags


def make_sweep_page(sweep: DrawnSweep) -> Page:
    """Make the page of (a) the lines of several lengths and (b) their smallest bend radius.

    Parameters
    ----------
    sweep : results for several lengths of one harness
    """
    drawn_shapes = [positions for positions in sweep.shapes if len(positions)]
    _, depth, height = np.ptp(np.vstack(drawn_shapes or [np.zeros((1, 3))]), axis=0)
    view = "top" if depth > height else "side"
    axes, lines = list(_VIEWS[view]), []
    colours = sample_colour_map(len(sweep.shapes))
    for positions, length, colour, is_doubtful in zip(
        sweep.shapes, sweep.length, colours, sweep.is_doubtful, strict=True
    ):
        if len(positions):
            label = f"{LENGTH_SCALE.factor * length:.6g} {LENGTH_SCALE.unit}"
            style: dict[str, Any] = {"color": colour, "linestyle": DASHED if is_doubtful else "-"}
            lines.append(make_line("line_of_length", *positions[:, axes].T, label=label, **style))
    x, y = (Axis("xyz"[axis], LENGTH_SCALE) for axis in axes)
    reason = "No line was found for any length."
    shape_plot = Plot(x, y, lines, f"From the {view}, by length", reason=reason, is_to_scale=True)
    title = f"{sweep.name}  ·  length against bend radius"
    panels = [shape_plot, _make_sweep_plot(sweep)]
    return Page(SWEEP_FIGURE, title, panels, sweep.note, height=76.0, widths=(1.2, 1.0))


def _make_sweep_plot(sweep: DrawnSweep) -> Plot:
    """Make the panel of the smallest bend radius against the length."""
    length, is_doubtful, lines = sweep.length, sweep.is_doubtful, []
    for label, radii, look in (
        ("during installation", sweep.radius_over_steps, "earlier_step"),
        ("installed", sweep.radius, "last_step"),
    ):
        settings: dict[str, Any] = {"marker": "o", "markersize": 3.0}
        y = _mask_straight(radii)
        lines.append(make_line(look, length, y, label=label, **settings))
        if is_doubtful.any():
            settings |= {"linestyle": "", "markerfacecolor": "white", "label": "doubtful"}
            lines.append(make_line(look, length[is_doubtful], y[is_doubtful], **settings))
    lines.append(plots.make_horizontal_line("allowed_radius", sweep.allowed_radius))
    if sweep.radius_band is not None:
        edges = map(_mask_straight, sweep.radius_band)
        lines.append(plots.make_area("harness_band", length, *edges))
    x_axis = Axis("Length of the line", LENGTH_SCALE)
    y_axis = Axis("Smallest bend radius", LENGTH_SCALE, low=0.0)
    return Plot(x_axis, y_axis, lines, "Smallest bend radius")


BUNDLE_FIGURE, LOOP_FIGURE = "bundle", "bundle-loop"
"""Names of the figures of bundles and their files, without extension."""


def make_bundle_page(model: BundleModel) -> Page:
    """Make the page of (a) the section of a bundle, (b) the bounds of its moment over curvature.

    Parameters
    ----------
    model : model of the bundle

    Returns
    -------
    A page. In (a), two lines through the neutral point show the directions of bending with the
    largest and the smallest stiffness. In (b), the bundle is bent along y, and both axes are
    logarithmic.
    """
    panels = [_make_section_plot(model), _make_moment_plot(model)]
    title = f"{model.bundle.composition}  ·  bundle model  ·  {model.layout.arrangement}"
    if model.packing_fraction is not None:
        bore = LENGTH_SCALE.factor * (model.bundle.conduit_bore or 0.0)
        title += f"  ·  packing fraction {model.packing_fraction:.2f}"
        title += f" in {bore:.3g} {LENGTH_SCALE.unit}"
    limiting_codes = ("copper_yields", "insulation_doubtful")
    limit_text = join_sentences(note for note in model.notes if note.code in limiting_codes)
    note = f"{describe_stiffness(model)} {limit_text.replace('N mm^2', STIFFNESS_SCALE.unit)}"
    return Page(BUNDLE_FIGURE, title, panels, note.strip(), height=84.0, widths=(0.8, 1.0))


def _make_section_plot(model: BundleModel) -> Plot:
    """Make the panel of the wires, the bore of the conduit and the principal directions.

    If the stiffness is equal in all directions, y and x are drawn as the principal directions.
    """
    margin_factor = 1.12  # half-width of the panel, as a multiple of the largest radius
    colours = ("#8ec3e6", "#f3d38a", "#93d5c0", "#e2b5cd")  # light, since lines are drawn over them
    layout, bore, angle = model.layout, model.bundle.conduit_bore or 0.0, model.principal_angle
    lines = []
    for kind, wire in enumerate(model.bundle.wires):
        rows = layout.kind == kind
        x, y, radius = layout.x[rows], layout.y[rows], layout.diameter[rows] / 2.0
        style = {"facecolor": colours[kind % len(colours)], "label": wire.type}
        lines.append(plots.make_circles("wire_of_bundle", x, y, radius, **style))
    if bore:
        lines.append(plots.make_circles("bore_of_conduit", *model.middle, bore / 2.0))
    looks: dict[str, dict[str, Any]] = {"stiffest_direction": {}, "most_flexible_direction": {}}
    if _is_isotropic(model):
        label, angle = "y and x: equal in all directions", math.pi / 2.0
        looks = {"stiffest_direction": {"label": label}, "most_flexible_direction": {"label": ""}}
    for look, settings in looks.items():
        half_line = 1.06 * layout.radius * np.array([[math.cos(angle)], [math.sin(angle)]])
        x, y = np.array(model.neutral)[:, None] + half_line * np.array([-1.0, 1.0])
        lines.append(make_line(look, x, y, **settings))
        angle += math.pi / 2.0
    lines.append(make_line("neutral_point", *model.neutral))
    half_width = margin_factor * max(layout.radius, math.hypot(*model.middle) + bore / 2.0)
    x_axis = Axis("x", LENGTH_SCALE, -half_width, half_width)
    y_axis = Axis("y, direction of bending", LENGTH_SCALE, -half_width, half_width)
    return Plot(x_axis, y_axis, lines, "Section", is_to_scale=True)


def _make_moment_plot(model: BundleModel) -> Plot:
    """Make the panel of the moments of slipping and of sticking wires, on logarithmic axes."""
    is_bent = model.curvature > 0.0
    curves = (model.curvature, model.moment_slip, model.moment_stick)
    x, slip_moment, stick_moment = (values[is_bent] for values in curves)
    lines = [plots.make_area("between_bounds", x, slip_moment, stick_moment)]
    for moment, look, is_doubtful in (
        (stick_moment, "wires_stick", model.is_doubtful_stick[is_bent]),
        (slip_moment, "wires_slip", model.is_doubtful[is_bent]),
    ):
        for rows, opacity in plots.split_doubtful(~is_doubtful):
            lines.append(make_line(look, x[rows], moment[rows], alpha=opacity))
    for stiffness in (model.low, model.high):
        lines.append(make_line("bundle_without_yielding", x, stiffness * x))
    y_axis = Axis("Bending moment", MOMENT_SCALE, is_log=True)
    return Plot(make_curvature_axis(x), y_axis, lines, "First loading, bent along y")


def describe_stiffness(model: BundleModel) -> str:
    """Describe the bounds of the bending stiffness of a bundle in a sentence."""
    all_slip, wires_slip, nothing_slips, smallest, largest = (
        format_number(stiffness, None, STIFFNESS_SCALE.factor, digits=4).value
        for stiffness in (model.low, model.free, model.high, *model.principal)
    )
    directions = f"{smallest} to {largest} over all directions"
    if _is_isotropic(model):
        directions = "equal in all directions"
    facts = {"all_slip": all_slip, "wires_slip": wires_slip, "nothing_slips": nothing_slips}
    return format_sentence("report.bounds_of_bundle", directions=directions, **facts)


def _is_isotropic(model: BundleModel) -> bool:
    """Return whether the bending stiffness of a bundle is equal in all directions."""
    relative_tolerance = 1e-6
    smallest, largest = model.principal
    return largest - smallest <= relative_tolerance * largest


def make_loop_page(name: str, fit: FrictionFit) -> Page:
    """Make the page of the measured force with (a) the fitted force, (b) the predicted force.

    Parameters
    ----------
    name : name of the test
    fit : fit of the friction between the wires
    """
    x, y = Axis("Deflection", LENGTH_SCALE), Axis("Force at the tip", FORCE_SCALE)
    panels = []
    for rows, label, colour, heading, error in (
        (~fit.is_held_out, "fitted (one parameter)", "C0", "Fitted", fit.error_fitted),
        (fit.is_held_out, "predicted", "C1", "Left out", fit.error_held_out),
    ):
        deflection, model_force = fit.loop.deflection[rows], fit.predicted[rows]
        lines = [
            make_line("measured_cycles", deflection, fit.loop.force[rows]),
            make_line("modelled_cycles", deflection, model_force, color=colour, label=label),
            plots.make_horizontal_line("zero", 0.0),
        ]
        error_text = f"error {wording.format_percent(error)} of the peak"
        panels.append(Plot(x, y, lines, f"{heading}, {error_text}"))
    title = f"{name}  ·  friction between the wires"
    return Page(LOOP_FIGURE, title, panels, describe_friction(fit), height=82.0, shared_axes="xy")


def describe_friction(fit: FrictionFit) -> str:
    """Describe the friction between the wires of a bundle, and the errors of its prediction."""
    # deflection of a cantilever at which the curvature of its clamped end makes the tape slide
    slide_mm = LENGTH_SCALE.factor * fit.slide_curvature * fit.loop.length**2 / 3.0
    return format_sentence(
        "report.friction_of_bundle",
        composite=wording.format_percent(fit.composite_share),
        kink=LENGTH_SCALE.factor * fit.loop.kink[0],
        tape=f"; the tape slides beyond {slide_mm:.3g} mm" if np.isfinite(slide_mm) else "",
        held=format_number(fit.held, Interval(fit.held_lower, fit.held_upper), 100.0),
        work=1e3 * fit.loss,
        predicted_work=1e3 * fit.predicted_loss,
        error_fitted=wording.format_percent(fit.error_fitted),
        error_left_out=wording.format_percent(fit.error_held_out),
    )
