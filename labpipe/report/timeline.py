"""Force and motion against time with the turning points, and how well the clocks agree."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import ClockFit
from labpipe.records.result import TestResult
from labpipe.report.page import DOUBLE_COLUMN, GREY, new_page, say, side_key
from labpipe.report.thinning import extremes
from labpipe.report.treatment import treatment_of_force
from labpipe.report.wording import scale, why_missing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TIME_BINS = 900
_MOTIONS = {"travel": "Travel", "displacement": "Displacement"}
"""Series that show the motion, the better one first, and the word on the axis."""
_TWO_SIDED_95 = 1.96


def draw_timeline(result: TestResult) -> Figure:
    """Draw force and motion on one time axis, and the alignment residuals where there are any."""
    fit = result.aligned.clock_fit if result.aligned is not None else None
    page = new_page(result, width_mm=DOUBLE_COLUMN, height_mm=110 if fit else 80)
    ratios = [3, 3, 2] if fit else [1, 1]
    panels = page.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    plot_force(result, panels[0])
    plot_motion(result, panels[1])
    if fit is not None:
        plot_residuals(result, panels[2])
    panels[-1].set_xlabel(scale(result, "time", "s").label("Time"))
    for axes in panels:
        axes.locator_params(axis="y", nbins=5)
    page.align_ylabels(list(panels))
    return page


def plot_force(result: TestResult, axes: Axes) -> None:
    """Draw the force against time: samples as recorded in grey, the curve over them."""
    up = scale(result, "force", "N")
    aligned, curve = result.aligned, result.curve
    if aligned is not None and "force" in aligned.series:
        values = aligned.series["force"].values
        _plot_over_time(
            result,
            axes,
            aligned.time,
            values * up.factor,
            color="#9a9a9a",
            linewidth=0.6,
            label="raw",
        )
    if curve is not None:
        _plot_over_time(
            result,
            axes,
            curve.time,
            curve.force * up.factor,
            color="C0",
            linewidth=0.8,
            label=treatment_of_force(result).value,
        )
    if not axes.lines:
        say(axes, why_missing(result, "force"))
        return
    axes.set_ylabel(up.label("Force"))
    side_key(axes, axes.lines)


def plot_motion(result: TestResult, axes: Axes) -> None:
    """Draw travel, or displacement where there is no travel, with the turning points on it."""
    found = motion(result)
    if found is None:
        say(axes, why_missing(result, "motion"))
        return
    word, time, values = found
    up, along = scale(result, "displacement", "m"), scale(result, "time", "s")
    _plot_over_time(result, axes, time, values * up.factor, color="C0", label="motion")
    turns = turning_points(result)
    if len(turns):
        heights = np.interp(turns, time, values, left=np.nan, right=np.nan) * up.factor
        axes.plot(
            turns * along.factor, heights, "o", color="C1", mfc="white", label="turning point"
        )
        side_key(axes, axes.lines[-1:])
    axes.set_ylabel(up.label(word))


def motion(result: TestResult) -> tuple[str, Floats, Floats] | None:
    """Find the motion of a test: the word for it, its time in s, its values in m."""
    aligned, curve = result.aligned, result.curve
    for name, word in _MOTIONS.items():
        if aligned is not None and name in aligned.series:
            return word, aligned.time, aligned.series[name].values
    return None if curve is None else ("Displacement", curve.time, curve.displacement)


def turning_points(result: TestResult) -> Floats:
    """Times at which branches begin or end, s, each once."""
    branches = result.curve.branches if result.curve is not None else ()
    times = [time for branch in branches for time in (branch.start_time, branch.stop_time)]
    return np.unique(np.array(times, dtype=np.float64))


def plot_residuals(result: TestResult, axes: Axes) -> None:
    """Draw what the straight line between the clocks leaves over at each event.

    Parameters
    ----------
    result : its clock fit is drawn; bars are 95 % of the error of each event
    axes : to draw on; an explaining sentence if there is no clock fit
    """
    fit = result.aligned.clock_fit if result.aligned is not None else None
    if fit is None:
        say(axes, why_missing(result, "clock fit"))
        return
    along = scale(result, "time", "s").factor
    over = (fit.event_times_force - fit.to_force_time(fit.event_times_motion)) * 1e3
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.errorbar(
        fit.event_times_motion * along,
        over,
        yerr=_TWO_SIDED_95 * fit.event_errors * 1e3,
        fmt="o",
        color="C1",
        markerfacecolor="white",
        elinewidth=0.7,
        capsize=1.5,
        label="95 %",
    )
    axes.set_ylabel("Residual (ms)")
    axes.set_title(_words(fit), loc="right", size=8, color=GREY)


def _words(fit: ClockFit) -> str:
    """Offset and drift with half the width of their intervals, and the residual."""
    ends = fit.offset_interval, fit.drift_interval
    half_offset, half_drift = ((end.upper - end.lower) / 2 for end in ends)
    return (
        f"offset {fit.offset:.4f} ± {half_offset:.4f} s,  "
        f"drift {fit.drift * 1e6:.1f} ± {half_drift * 1e6:.1f} ppm,  "
        f"residual {fit.residual * 1e3:.2f} ms (rms); bars: 95 %"
    )


def _plot_over_time(
    result: TestResult, axes: Axes, time: Floats, shown: Floats, **look: Any
) -> None:
    kept = extremes(shown, bins=_TIME_BINS)
    along = scale(result, "time", "s").factor
    axes.plot(time[kept] * along, shown[kept], **look)
    axes.margins(x=0.01)
