"""A test against time: force, motion, and how the two clocks were joined."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import ClockFit, Interval
from labpipe.records.result import TestResult
from labpipe.report.curve_figures import Treatment, treatment_of_force
from labpipe.report.figure_page import DOUBLE_COLUMN, GREY, new_page, say, side_key
from labpipe.report.plot_thinning import extremes
from labpipe.report.wording import count_of, place_of, rounded, scale, why_missing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TIME_BINS = 900
_MOTIONS = {"travel": "Travel", "displacement": "Displacement"}
"""Series that show the motion, the better one first, and the word on the axis."""
_AS_RECORDED: dict[str, Any] = {"color": "#9a9a9a", "linewidth": 0.6}
_CURVE: dict[str, Any] = {"color": "C0", "linewidth": 0.8}
_TWO_SIDED_95 = 1.96
_UNKNOWNS = 2
"""Of a straight line between two clocks: offset and drift."""


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
    """Draw the force against time: as recorded in grey, and over it the curve if it differs."""
    up = scale(result, "force", "N")
    aligned, curve = result.aligned, result.curve
    done = treatment_of_force(result)
    is_untouched = curve is not None and done is Treatment.NONE
    if aligned is not None and "force" in aligned.series and not is_untouched:
        shown = up.factor * aligned.series["force"].values
        _plot_over_time(result, axes, aligned.time, shown, label="as recorded", **_AS_RECORDED)
    if curve is not None:
        words = "as recorded" if is_untouched else done.value
        _plot_over_time(result, axes, curve.time, up.factor * curve.force, label=words, **_CURVE)
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
    axes.set_title(_words(fit), loc="right", color=GREY)


def _words(fit: ClockFit) -> str:
    """Offset and drift with half the width of their intervals, and what is left over, if any."""
    events = len(fit.event_times_motion)
    left = f"residual {1e3 * fit.residual:.2g} ms (rms of {events})"
    if events <= _UNKNOWNS:
        left = f"{count_of(events, 'event')} for two unknowns: nothing is left over"
    offset = _with_half(fit.offset, fit.offset_interval, 1.0)
    drift = _with_half(fit.drift, fit.drift_interval, 1e6)
    return f"offset {offset} s,  drift {drift} ppm,  {left};  bars: 95 % of each event"


def _with_half(value: float, interval: Interval, factor: float) -> str:
    """A number and half the width of its interval, to the second digit of that half."""
    place = place_of(value, interval, factor)
    half = 0.5 * (interval.upper - interval.lower)
    return f"{rounded(factor * value, place)} ± {rounded(factor * half, place)}".replace(
        "-", "\u2212"
    )


def _plot_over_time(
    result: TestResult, axes: Axes, time: Floats, shown: Floats, **look: Any
) -> None:
    kept = extremes(shown, bins=_TIME_BINS)
    along = scale(result, "time", "s").factor
    axes.plot(time[kept] * along, shown[kept], **look)
    axes.margins(x=0.01)
