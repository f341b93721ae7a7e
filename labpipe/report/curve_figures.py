"""A test's curve: force against displacement, and with its fitted lines."""

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
    say,
)
from labpipe.report.plot_thinning import extremes
from labpipe.report.wording import (
    Scale,
    footnote,
    in_words,
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


_EXACT = 1e-9
"""Share of a signal's range that is rounding."""


class Treatment(Enum):
    """How the curve differs from the samples; the value is what a figure calls it."""

    NONE = "not filtered"
    CORRECTED = "corrected, not filtered"
    FILTERED = "filtered"


def treatment_of_force(result: TestResult) -> Treatment:
    """Tell what was done to the force of a test.

    Parameters
    ----------
    result : its curve is compared with its aligned series ``force``

    Returns
    -------
    Filtered too where there is nothing to compare with: then nothing says that it was not.

    Notes
    -----
    A correction (a slip added back, a stray sample bridged) moves whole stretches or a few samples:
    from sample to sample the median change of what was added is zero. A filter changes every
    sample by an amount of its own.
    """
    return _of(result, "force", result.curve.force if result.curve is not None else None)


def treatment(result: TestResult) -> Treatment:
    """Tell what was done to force and displacement of a test.

    Parameters
    ----------
    result : its curve is compared with its aligned series

    Returns
    -------
    The greater of both. What frame and grips give is taken off the displacement sample by sample;
    where that was done (note ``compliance_removed``), the displacement counts as corrected.
    """
    force = treatment_of_force(result)
    curve = result.curve
    travel = _of(result, "displacement", curve.displacement if curve is not None else None)
    if any(note.code == "compliance_removed" for note in result.quality):
        travel = Treatment.CORRECTED
    return max(force, travel, key=list(Treatment).index)


def _of(result: TestResult, name: str, after: Floats | None) -> Treatment:
    series = result.aligned.series if result.aligned is not None else {}
    if after is None or name not in series or len(series[name].values) != len(after):
        return Treatment.FILTERED
    change = after - series[name].values
    change = change[~np.isnan(change)]
    if not len(change):
        return Treatment.FILTERED
    least = _EXACT * float(np.nanmax(after) - np.nanmin(after))
    if np.abs(change).max() <= least:
        return Treatment.NONE
    steps = np.abs(np.diff(change))
    return Treatment.CORRECTED if np.median(steps) <= least else Treatment.FILTERED


MOST_COLOURS = 6
"""Cycles that a legend tells apart; more of them get a colour bar."""

_BRANCH_BINS = 350
_BINS_WHOLE = 4000
"""Stretches that a branch is thinned to, and a curve that was not split into branches."""
_STYLES: dict[Direction, Literal["-"] | tuple[float, tuple[float, float]]] = {
    Direction.LOADING: "-",
    Direction.UNLOADING: (0, (4, 1.6)),
}


def draw_force_displacement(result: TestResult) -> Figure:
    """Draw (a) the calibrated samples as recorded and (b) the curve that numbers come from.

    Where nothing was done to the samples, there is one panel.
    """
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
        _explain(page, panels, result.curve)
    return page


def plot_raw(result: TestResult, axes: Axes) -> None:
    """Draw the unfiltered force against the unfiltered displacement, unloading dashed.

    Parameters
    ----------
    result : its aligned series ``force`` and ``displacement`` are drawn; the turning points of the
        curve say which sample belongs to which cycle, without a curve all are one colour
    axes : to draw on; an explaining sentence if there are no such series
    """
    series = result.aligned.series if result.aligned is not None else {}
    if result.aligned is None or not {"force", "displacement"} <= set(series):
        say(axes, why_missing(result, "unfiltered force and displacement"))
        return
    pair = series["displacement"].values, series["force"].values
    branches = result.curve.branches if result.curve is not None else ()
    if not branches:
        _plot_thinned(result, axes, *pair, bins=_BINS_WHOLE, color=GREY, linewidth=0.5)
    for branch, colour in zip(branches, _branch_colours(branches), strict=True):
        ends = np.searchsorted(result.aligned.time, [branch.start_time, branch.stop_time])
        part = slice(ends[0], ends[1] + 1)
        look: dict[str, Any] = {"color": colour, "linestyle": _STYLES[branch.direction]}
        _plot_thinned(result, axes, pair[0][part], pair[1][part], linewidth=0.5, **look)
    _label(result, axes)


def plot_filtered(result: TestResult, axes: Axes) -> None:
    """Draw the curve: loading solid, unloading dashed, the peak of each cycle marked.

    Parameters
    ----------
    result : its curve is drawn
    axes : to draw on; an explaining sentence if there is no curve
    """
    curve = result.curve
    if curve is None:
        say(axes, why_missing(result, "curve"))
        return
    if not curve.branches:
        _plot_thinned(result, axes, curve.displacement, curve.force, bins=_BINS_WHOLE, color=GREY)
    for branch, colour in zip(curve.branches, _branch_colours(curve.branches), strict=True):
        # one sample more: the line of a branch reaches the line of the next
        part = slice(branch.start, branch.stop + 1)
        pair = curve.displacement[part], curve.force[part]
        _plot_thinned(result, axes, *pair, color=colour, linestyle=_STYLES[branch.direction])
    _mark_peaks(result, axes, curve)
    _label(result, axes)


def _plot_thinned(
    result: TestResult, axes: Axes, x: Floats, y: Floats, *, bins: int = _BRANCH_BINS, **look: Any
) -> None:
    kept = extremes(y, bins=bins)
    across, up = _scales(result)
    axes.plot(x[kept] * across.factor, y[kept] * up.factor, **look)


def _label(result: TestResult, axes: Axes) -> None:
    across, up = _scales(result)
    axes.set_xlabel(across.label("Displacement"))
    axes.set_ylabel(up.label("Force"))
    axes.locator_params(axis="x", nbins=7)


def _mark_peaks(result: TestResult, axes: Axes, curve: Curve) -> None:
    """Put an open triangle on the highest force of each cycle."""
    across, up = _scales(result)
    colours = cycle_colours(int(curve.cycle.max(initial=0)))
    for number, colour in enumerate(colours, start=1):
        inside = np.flatnonzero((curve.cycle == number) & ~np.isnan(curve.force))
        if len(inside):
            top = inside[np.argmax(curve.force[inside])]
            x, y = curve.displacement[top] * across.factor, curve.force[top] * up.factor
            axes.plot(x, y, "v", color=colour, markerfacecolor="white", label=f"peak {number}")


def cycle_colours(count: int) -> list[str]:
    """Colour of each cycle: the style's own for a few, a colour map for many."""
    import matplotlib as mpl
    from matplotlib.colors import to_hex

    if count <= MOST_COLOURS:
        own = mpl.rcParams["axes.prop_cycle"].by_key()["color"]
        return [to_hex(own[number % len(own)]) for number in range(count)]
    colour_map = mpl.colormaps[mpl.rcParams["image.cmap"]]
    return [to_hex(colour_map(0.92 * place)) for place in np.linspace(0, 1, count)]


def _branch_colours(branches: tuple[Branch, ...]) -> list[str]:
    colours = cycle_colours(max((branch.cycle for branch in branches), default=0))
    return [colours[branch.cycle - 1] for branch in branches]


def _explain(page: Figure, panels: list[Axes], curve: Curve) -> None:
    """Name cycles, directions and peaks above the panels, where no data can be."""
    count = max(branch.cycle for branch in curve.branches)
    few = count <= MOST_COLOURS
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


_LOADING_BINS = 1500
_RED = "#b2182b"
_PLACES: dict[str, tuple[str, Any]] = {
    "break_point": ("break point", ":"),
    "kink_displacement": ("kink", ":"),
    "plateau_displacement": ("onset of the plateau", (0, (8, 2))),
}
"""Results that are places on the axis of displacement: words for the key, and style of the line."""


def draw_stiffness_lines(result: TestResult) -> Figure:
    """Draw the first loading branch with the lines that stiffnesses were read from."""
    branches = result.curve.branches if result.curve is not None else ()
    if not any(branch.direction is Direction.LOADING for branch in branches):
        page = new_page(result, width_mm=DOUBLE_COLUMN, height_mm=60)
        say(page.subplots(), why_missing(result, "loading branch"))
        return page
    keys = [*_branch_keys(result), *_line_keys(result), *_point_keys(result)]
    words = PageTexts(title(result), footnote(result), keys)
    page = keyed_page(words, height_mm=92, width_mm=DOUBLE_COLUMN)
    axes = page.subplots()
    plot_branch(result, axes)
    plot_lines(result, axes)
    mark_points(result, axes)
    _label(result, axes)
    return page


_LOADING: dict[str, Any] = {"color": "C0", "linewidth": 0.9}
_AS_MEASURED: dict[str, Any] = {"color": GREY, "linestyle": (0, (4, 1.6)), "linewidth": 0.6}


def plot_branch(result: TestResult, axes: Axes) -> None:
    """Draw the first loading branch, and as it was measured where slips were repaired.

    Parameters
    ----------
    result : a test with a curve
    axes : to draw on
    """
    curve = result.curve
    if curve is None:
        return
    first = next(branch for branch in curve.branches if branch.direction is Direction.LOADING)
    part = slice(first.start, first.stop)
    across, up = _scales(result)
    if result.aligned is not None and _is_repaired(result):
        measured = result.aligned.series["force"].values[part]
        kept = extremes(measured, bins=_LOADING_BINS)
        x, y = curve.displacement[part][kept] * across.factor, measured[kept] * up.factor
        axes.plot(x, y, **_AS_MEASURED)
    force = curve.force[part]
    kept = extremes(force, bins=_LOADING_BINS)
    x, y = curve.displacement[part][kept] * across.factor, force[kept] * up.factor
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
    """Name of a line and its slope, with the interval of the result of that name, if any."""
    stiffness = scale(result, "stiffness", "N/m")
    found = next((result for result in result.results if result.name == line.result), None)
    is_it = found is not None and found.unit == "N/m" and found.value is not None
    value, ends = (found.value, found.interval) if found is not None and is_it else (None, None)
    slope = line.slope if value is None else value
    words = write_number(slope, ends, stiffness.factor).text
    return f"{in_words(line.result)}: {words} {unit_words(stiffness.unit)}"


def mark_points(result: TestResult, axes: Axes) -> None:
    """Mark break point, kink, onset of a plateau, slips and failure.

    Parameters
    ----------
    result : its results and its slip ledger are drawn
    axes : to draw on
    """
    across, up = _scales(result)
    for name, (_, dashes) in _PLACES.items():
        place = _value(result, name)
        if place is not None:
            axes.axvline(place * across.factor, **_place_look(dashes))
    for slip in result.slips:
        axes.axvline(slip.position * across.factor, **_SLIP)
    at, force = _value(result, "failure_displacement"), _value(result, "failure_force")
    if at is not None and force is not None:
        axes.plot(at * across.factor, force * up.factor, **_FAILURE)


_SLIP: dict[str, Any] = {"color": _RED, "linewidth": 0.6, "linestyle": (0, (5, 2))}
_FAILURE: dict[str, Any] = {"color": _RED, "marker": "x", "linestyle": ""}


def _place_look(dashes: Any) -> dict[str, Any]:
    return {"color": GREY, "linewidth": 0.6, "linestyle": dashes}


def _point_keys(result: TestResult) -> list[Artist]:
    places = [
        line_key(words, **_place_look(dashes))
        for name, (words, dashes) in _PLACES.items()
        if _value(result, name) is not None
    ]
    slips = [line_key(f"slip, {slip.decision}", **_SLIP) for slip in result.slips[:1]]
    failed = [line_key("failure", **_FAILURE)] if _value(result, "failure_force") else []
    return [*places, *slips, *failed]


def _value(result: TestResult, name: str) -> float | None:
    found: list[Result] = [result for result in result.results if result.name == name]
    return found[0].value if found else None


def _scales(result: TestResult) -> tuple[Scale, Scale]:
    return scale(result, "displacement", "m"), scale(result, "force", "N")
