"""A loading curve with what was read from it: lines, break point, kink, plateau, slips, failure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from labpipe.records.curve import Direction, FittedLine
from labpipe.records.result import Result, TestResult
from labpipe.report.page import DOUBLE_COLUMN, GREY, put_key, say, titled_page
from labpipe.report.thinning import extremes
from labpipe.report.wording import Scale, footnote, scale, title, why_missing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOADING_BINS = 1500
_COLUMNS = 3
_MOST_OTHERS = 4
"""Entries of the key beside the lines: loading, as measured, break point or slip, failure."""
_PLACES = {
    "break_point": ("break point", ":"),
    "kink_displacement": ("kink", ":"),
    "plateau_displacement": ("onset of the plateau", (0, (8, 2))),
}
"""Results that are places on the axis of displacement: words for the key, and style of the line."""


def draw_stiffness_lines(result: TestResult) -> Figure:
    """Draw the first loading branch with the lines that stiffnesses were read from."""
    bundle = [
        name for name in _PLACES if name != "break_point" and _value(result, name) is not None
    ]
    rows = -(-(_MOST_OTHERS + len(bundle) + len(result.lines)) // _COLUMNS)
    page = titled_page(
        title(result),
        footnote(result),
        width_mm=DOUBLE_COLUMN,
        height_mm=92 + 4 * rows,
        key_rows=rows,
    )
    axes = page.subplots()
    branches = result.curve.branches if result.curve is not None else ()
    if not any(each.direction is Direction.LOADING for each in branches):
        say(axes, why_missing(result, "loading branch"))
        return page
    plot_branch(result, axes)
    plot_lines(result, axes)
    mark_points(result, axes)
    across, up = _scales(result)
    axes.set_xlabel(across.label("Displacement"))
    axes.set_ylabel(up.label("Force"))
    put_key(page, axes.get_legend_handles_labels()[0], columns=_COLUMNS)
    return page


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
    first = next(each for each in curve.branches if each.direction is Direction.LOADING)
    part = slice(first.start, first.stop)
    across, up = _scales(result)
    if result.aligned is not None and any(slip.decision == "repaired" for slip in result.slips):
        measured = result.aligned.series["force"].values[part]
        kept = extremes(measured, bins=_LOADING_BINS)
        x, y = curve.displacement[part][kept] * across.factor, measured[kept] * up.factor
        axes.plot(x, y, color=GREY, linestyle=(0, (4, 1.6)), linewidth=0.6, label="as measured")
    force = curve.force[part]
    kept = extremes(force, bins=_LOADING_BINS)
    x, y = curve.displacement[part][kept] * across.factor, force[kept] * up.factor
    axes.plot(x, y, linewidth=0.8, label="loading")


def plot_lines(result: TestResult, axes: Axes) -> None:
    """Draw each fitted line over its window, with its slope in the key.

    Parameters
    ----------
    result : its lines and the results of their names are drawn
    axes : to draw on
    """
    across, up = _scales(result)
    stiffness = scale(result, "stiffness", "N/m")
    for line in result.lines:
        x = np.array([line.start, line.stop])
        y = line.level + line.slope * (x - line.start)
        style = (0, (1, 1)) if line.result.startswith("segment") else "-"
        words = f"{_in_words(line)} {line.slope * stiffness.factor:.4g} {stiffness.unit}"
        axes.plot(
            x * across.factor, y * up.factor, linestyle=style, linewidth=1.8, alpha=0.8, label=words
        )


def mark_points(result: TestResult, axes: Axes) -> None:
    """Mark break point, kink, onset of a plateau, slips and failure.

    Parameters
    ----------
    result : its results and its slip ledger are drawn
    axes : to draw on
    """
    across, up = _scales(result)
    for name, (words, dashes) in _PLACES.items():
        place = _value(result, name)
        if place is not None:
            x = place * across.factor
            axes.axvline(x, color=GREY, linewidth=0.6, linestyle=dashes, label=words)
    for number, slip in enumerate(result.slips):
        axes.axvline(
            slip.position * across.factor,
            color="#b2182b",
            linewidth=0.6,
            linestyle=(0, (5, 2)),
            label=f"slip, {slip.decision}" if number == 0 else None,
        )
    at, force = _value(result, "failure_displacement"), _value(result, "failure_force")
    if at is not None and force is not None:
        axes.plot(at * across.factor, force * up.factor, "x", color="#b2182b", label="failure")


def _in_words(line: FittedLine) -> str:
    return line.result.replace("_", " ")


def _value(result: TestResult, name: str) -> float | None:
    found: list[Result] = [each for each in result.results if each.name == name]
    return found[0].value if found else None


def _scales(result: TestResult) -> tuple[Scale, Scale]:
    return scale(result, "displacement", "m"), scale(result, "force", "N")
