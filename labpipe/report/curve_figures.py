"""Curve of a test: force against displacement, and with its fitted lines."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Curve, Direction, FittedLine
from labpipe.records.result import Result, TestResult
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    GREY,
    WIDTH,
    PageTexts,
    keyed_page,
    line_key,
    line_looks_of_fits,
    new_page,
    panel_letter,
    put_key,
    write_reason,
)
from labpipe.report.plot_thinning import extremes
from labpipe.report.wording import (
    Scale,
    as_label,
    footnote,
    scale,
    title,
    unit_words,
    why_missing,
    write_number,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Treatment(Enum):
    """Treatment of the samples in the curve; the value is its name in a figure."""

    NONE = "not filtered"
    CORRECTED = "corrected, not filtered"
    FILTERED = "filtered"


def treatment_of_force(result: TestResult) -> Treatment:
    """Return the treatment of the force of a test.

    Parameters
    ----------
    result : its curve is compared with its aligned series ``force``

    Returns
    -------
    `FILTERED` also if there is no aligned series to compare with.

    Notes
    -----
    A correction (a repaired slip, a bridged outlier) shifts intervals or a few samples: the median
    change of the correction from sample to sample is zero. A filter changes every sample by a
    different amount.
    """
    return _series_treatment(
        result, "force", result.curve.force if result.curve is not None else None
    )


def treatment(result: TestResult) -> Treatment:
    """Return the treatment of force and displacement of a test.

    Parameters
    ----------
    result : its curve is compared with its aligned series

    Returns
    -------
    The stronger of both. Compliance of frame and grips is subtracted from the displacement sample
    by sample; with that (note ``compliance_removed``) the displacement counts as corrected.
    """
    force = treatment_of_force(result)
    curve = result.curve
    travel = _series_treatment(
        result, "displacement", curve.displacement if curve is not None else None
    )
    if any(note.code == "compliance_removed" for note in result.quality):
        travel = Treatment.CORRECTED
    return max(force, travel, key=list(Treatment).index)


def _series_treatment(result: TestResult, name: str, after: Floats | None) -> Treatment:
    rounding_share = 1e-9  # of the range of the signal
    series = result.aligned.series if result.aligned is not None else {}
    if after is None or name not in series or len(series[name].values) != len(after):
        return Treatment.FILTERED
    change = after - series[name].values
    change = change[~np.isnan(change)]
    if not len(change):
        return Treatment.FILTERED
    least = rounding_share * float(np.nanmax(after) - np.nanmin(after))
    if np.abs(change).max() <= least:
        return Treatment.NONE
    steps = np.abs(np.diff(change))
    return Treatment.CORRECTED if np.median(steps) <= least else Treatment.FILTERED


MAX_CYCLE_COLOURS = 6
"""Cycles in a legend; more cycles get a colour bar."""

_CURVE_BINS = 4000
"""Bins to which a curve without branches is thinned."""
_STYLES: dict[Direction, Literal["-"] | tuple[float, tuple[float, float]]] = {
    Direction.LOADING: "-",
    Direction.UNLOADING: (0, (4, 1.6)),
}


def draw_force_displacement(result: TestResult) -> Figure:
    """Draw (a) the calibrated samples as recorded and (b) the curve, in one panel if equal."""
    done = treatment(result)
    if done is Treatment.NONE:
        page = new_page(result, width_mm=WIDTH, height_mm=82, has_key=True)
        panels = [page.subplots()]
        panels[0].set_title(f"As recorded, {done.value}", loc="left")
    else:
        page = new_page(result, width_mm=DOUBLE_COLUMN, height_mm=82, has_key=True)
        panels = list(page.subplots(1, 2, sharex=True, sharey=True))
        plot_raw(result, panels[0])
        panel_letter(panels[0], "a", "As recorded")
        panel_letter(panels[1], "b", done.value.capitalize())
    plot_filtered(result, panels[-1])
    if len(panels) > 1:
        panels[-1].set_ylabel("")
    if result.curve is not None and result.curve.branches:
        _draw_key(page, panels, result.curve)
    return page


def plot_raw(result: TestResult, axes: Axes) -> None:
    """Draw the unfiltered force against the unfiltered displacement, unloading dashed.

    Parameters
    ----------
    result : its aligned series ``force`` and ``displacement`` are drawn, coloured by cycle between
        the turning points of the curve, or in one colour without a curve
    axes : to draw on; an explaining sentence if there are no such series
    """
    series = result.aligned.series if result.aligned is not None else {}
    if result.aligned is None or not {"force", "displacement"} <= set(series):
        write_reason(axes, why_missing(result, "unfiltered force and displacement"))
        return
    pair = series["displacement"].values, series["force"].values
    branches = result.curve.branches if result.curve is not None else ()
    if not branches:
        _plot_thinned(result, axes, *pair, bins=_CURVE_BINS, color=GREY, linewidth=0.5)
    for branch, colour in zip(branches, _branch_colours(branches), strict=True):
        ends = np.searchsorted(result.aligned.time, [branch.start_time, branch.stop_time])
        part = slice(ends[0], ends[1] + 1)
        look: dict[str, Any] = {"color": colour, "linestyle": _STYLES[branch.direction]}
        _plot_thinned(result, axes, pair[0][part], pair[1][part], linewidth=0.5, **look)
    _label_axes(result, axes)


def plot_filtered(result: TestResult, axes: Axes) -> None:
    """Draw the curve: loading solid, unloading dashed, the peak of each cycle marked.

    Parameters
    ----------
    result : its curve is drawn
    axes : to draw on; an explaining sentence if there is no curve
    """
    curve = result.curve
    if curve is None:
        write_reason(axes, why_missing(result, "curve"))
        return
    if not curve.branches:
        _plot_thinned(result, axes, curve.displacement, curve.force, bins=_CURVE_BINS, color=GREY)
    for branch, colour in zip(curve.branches, _branch_colours(curve.branches), strict=True):
        # one sample more: the lines of two branches meet
        part = slice(branch.start, branch.stop + 1)
        pair = curve.displacement[part], curve.force[part]
        _plot_thinned(result, axes, *pair, color=colour, linestyle=_STYLES[branch.direction])
    _mark_peaks(result, axes, curve)
    _label_axes(result, axes)


def _plot_thinned(
    result: TestResult, axes: Axes, x: Floats, y: Floats, *, bins: int = 350, **look: Any
) -> None:
    rows = extremes(y, bins=bins)
    across, up = _scales(result)
    axes.plot(x[rows] * across.factor, y[rows] * up.factor, **look)


def _label_axes(result: TestResult, axes: Axes) -> None:
    across, up = _scales(result)
    axes.set_xlabel(across.label("Displacement"))
    axes.set_ylabel(up.label("Force"))
    axes.locator_params(axis="x", nbins=7)


def _mark_peaks(result: TestResult, axes: Axes, curve: Curve) -> None:
    """Mark the highest force of each cycle with an open triangle."""
    across, up = _scales(result)
    colours = cycle_colours(int(curve.cycle.max(initial=0)))
    for number, colour in enumerate(colours, start=1):
        inside = np.flatnonzero((curve.cycle == number) & ~np.isnan(curve.force))
        if len(inside):
            top = inside[np.argmax(curve.force[inside])]
            x, y = curve.displacement[top] * across.factor, curve.force[top] * up.factor
            axes.plot(x, y, "v", color=colour, markerfacecolor="white", label=f"peak {number}")


def cycle_colours(count: int) -> list[str]:
    """Return the colour of each cycle: of the style for a few, of a colour map for many."""
    import matplotlib as mpl
    from matplotlib.colors import to_hex

    if count <= MAX_CYCLE_COLOURS:
        colours = mpl.rcParams["axes.prop_cycle"].by_key()["color"]
        return [to_hex(colours[number % len(colours)]) for number in range(count)]
    colour_map = mpl.colormaps[mpl.rcParams["image.cmap"]]
    return [to_hex(colour_map(0.92 * place)) for place in np.linspace(0, 1, count)]


def _branch_colours(branches: tuple[Branch, ...]) -> list[str]:
    colours = cycle_colours(max((branch.cycle for branch in branches), default=0))
    return [colours[branch.cycle - 1] for branch in branches]


def _draw_key(page: Figure, panels: list[Axes], curve: Curve) -> None:
    """Draw the key of cycles, directions and peaks above the panels."""
    count = max(branch.cycle for branch in curve.branches)
    few = count <= MAX_CYCLE_COLOURS
    cycles = [
        line_key(f"cycle {number}", color=colour)
        for number, colour in enumerate(cycle_colours(count) if count > 1 and few else (), start=1)
    ]
    colour = GREY if count > 1 else cycle_colours(1)[0]
    ways = {branch.direction for branch in curve.branches}
    others = [
        line_key(str(direction), color=colour, linestyle=look)
        for direction, look in _STYLES.items()
        if direction in ways and (count > 1 or len(ways) > 1)
    ]
    peak = line_key("peak", color=colour, marker="v", markerfacecolor="white", linestyle="")
    handles = [*cycles, *others, peak]
    put_key(page, handles)
    if not few:
        _colour_bar(page, panels, count)


def _colour_bar(page: Figure, panels: list[Axes], count: int) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    colours = ListedColormap(cycle_colours(count))
    key = ScalarMappable(Normalize(0.5, count + 0.5), colours)
    bar = page.colorbar(key, ax=panels, pad=0.01, aspect=30, label="Cycle")
    ticks = np.unique(np.linspace(1, count, min(count, 6)).round())
    bar.set_ticks([float(tick) for tick in ticks])
    bar.outline.set_linewidth(0.4)


_PLACE_LINES: dict[str, tuple[str, Any]] = {
    "break_point": ("break point", ":"),
    "kink_displacement": ("kink", ":"),
    "plateau_displacement": ("onset of plateau", (0, (8, 2))),
}
"""Results that are displacements: label in the key and style of the line."""


def draw_stiffness_lines(result: TestResult) -> Figure:
    """Draw the first loading branch with the lines fitted for stiffness."""
    branches = result.curve.branches if result.curve is not None else ()
    if not any(branch.direction is Direction.LOADING for branch in branches):
        page = new_page(result, width_mm=DOUBLE_COLUMN, height_mm=60)
        write_reason(page.subplots(), why_missing(result, "loading branch"))
        return page
    keys = [*_branch_keys(result), *_line_keys(result), *_point_keys(result)]
    texts = PageTexts(title(result), footnote(result), keys)
    page = keyed_page(texts, height_mm=92, width_mm=DOUBLE_COLUMN)
    axes = page.subplots()
    plot_branch(result, axes)
    plot_lines(result, axes)
    mark_points(result, axes)
    _label_axes(result, axes)
    return page


_LOADING: dict[str, Any] = {"color": "C0", "linewidth": 0.9}
_AS_MEASURED: dict[str, Any] = {"color": GREY, "linestyle": (0, (4, 1.6)), "linewidth": 0.6}


def plot_branch(result: TestResult, axes: Axes) -> None:
    """Draw the first loading branch, and the measured one if slips were repaired.

    Parameters
    ----------
    result : a test with a curve
    axes : to draw on
    """
    loading_bins = 1500
    curve = result.curve
    if curve is None:
        return
    first = next(branch for branch in curve.branches if branch.direction is Direction.LOADING)
    part = slice(first.start, first.stop)
    across, up = _scales(result)
    if result.aligned is not None and _is_repaired(result):
        measured = result.aligned.series["force"].values[part]
        rows = extremes(measured, bins=loading_bins)
        x, y = curve.displacement[part][rows] * across.factor, measured[rows] * up.factor
        axes.plot(x, y, **_AS_MEASURED)
    force = curve.force[part]
    rows = extremes(force, bins=loading_bins)
    x, y = curve.displacement[part][rows] * across.factor, force[rows] * up.factor
    axes.plot(x, y, **_LOADING)


def _is_repaired(result: TestResult) -> bool:
    return any(slip.decision == "repaired" for slip in result.slips)


def _branch_keys(result: TestResult) -> list[Artist]:
    measured = [line_key("as measured", **_AS_MEASURED)] if _is_repaired(result) else []
    return [line_key("loading", **_LOADING), *measured]


def plot_lines(result: TestResult, axes: Axes) -> None:
    """Draw each fitted line over its window.

    Parameters
    ----------
    result : its lines are drawn
    axes : to draw on
    """
    across, up = _scales(result)
    looks = line_looks_of_fits(line.result for line in result.lines)
    for line in result.lines:
        x = np.array([line.start, line.stop])
        y = line.level + line.slope * (x - line.start)
        axes.plot(x * across.factor, y * up.factor, **looks[line.result])


def _line_keys(result: TestResult) -> list[Artist]:
    looks = line_looks_of_fits(line.result for line in result.lines)
    return [line_key(_slope_words(result, line), **looks[line.result]) for line in result.lines]


def _slope_words(result: TestResult, line: FittedLine) -> str:
    """Write the name and the slope of a line, with the interval of the result, if any."""
    stiffness = scale(result, "stiffness", "N/m")
    fitted = next((result for result in result.results if result.name == line.result), None)
    is_it = fitted is not None and fitted.unit == "N/m" and fitted.value is not None
    value, ends = (fitted.value, fitted.interval) if fitted is not None and is_it else (None, None)
    slope = line.slope if value is None else value
    number = write_number(slope, ends, stiffness.factor).text
    return f"{as_label(line.result)}: {number} {unit_words(stiffness.unit)}"


def mark_points(result: TestResult, axes: Axes) -> None:
    """Mark break point, kink, onset of a plateau, slips and failure.

    Parameters
    ----------
    result : its results and its slip ledger are drawn
    axes : to draw on
    """
    across, up = _scales(result)
    for name, (_, dashes) in _PLACE_LINES.items():
        place = _value(result, name)
        if place is not None:
            axes.axvline(place * across.factor, **_place_style(dashes))
    for slip in result.slips:
        axes.axvline(slip.position * across.factor, **_SLIP)
    displacement, force = _value(result, "failure_displacement"), _value(result, "failure_force")
    if displacement is not None and force is not None:
        axes.plot(displacement * across.factor, force * up.factor, **_FAILURE)


_SLIP: dict[str, Any] = {"color": "#b2182b", "linewidth": 0.6, "linestyle": (0, (5, 2))}
_FAILURE: dict[str, Any] = {"color": "#b2182b", "marker": "x", "linestyle": ""}


def _place_style(dashes: Any) -> dict[str, Any]:
    return {"color": GREY, "linewidth": 0.6, "linestyle": dashes}


def _point_keys(result: TestResult) -> list[Artist]:
    places = [
        line_key(label, **_place_style(dashes))
        for name, (label, dashes) in _PLACE_LINES.items()
        if _value(result, name) is not None
    ]
    slips = [line_key(f"slip, {slip.decision}", **_SLIP) for slip in result.slips[:1]]
    failed = [line_key("failure", **_FAILURE)] if _value(result, "failure_force") else []
    return [*places, *slips, *failed]


def _value(result: TestResult, name: str) -> float | None:
    matches: list[Result] = [result for result in result.results if result.name == name]
    return matches[0].value if matches else None


def _scales(result: TestResult) -> tuple[Scale, Scale]:
    return scale(result, "displacement", "m"), scale(result, "force", "N")
