"""A test against time: force, motion, and the residuals of clock alignment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import ClockFit, Interval
from labpipe.records.result import TestResult
from labpipe.report.curve_figures import Treatment, treatment_of_force
from labpipe.report.figure_page import DOUBLE_COLUMN, GREY, new_page, side_key, write_reason
from labpipe.report.plot_thinning import extremes
from labpipe.report.wording import count_of, place_of, rounded, scale, why_missing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOTIONS = {"travel": "Travel", "displacement": "Displacement"}
"""Series of the motion, the better one first, and the label of the axis."""
_AS_RECORDED: dict[str, Any] = {"color": "#9a9a9a", "linewidth": 0.6}
_CURVE: dict[str, Any] = {"color": "C0", "linewidth": 0.8}


def draw_timeline(result: TestResult) -> Figure:
    """Draw force and motion on one time axis, and the residuals of clock alignment, if any."""
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
    """Draw the force against time: as recorded in grey, and the curve over it if it differs."""
    up = scale(result, "force", "N")
    aligned, curve = result.aligned, result.curve
    done = treatment_of_force(result)
    is_untouched = curve is not None and done is Treatment.NONE
    if aligned is not None and "force" in aligned.series and not is_untouched:
        force = up.factor * aligned.series["force"].values
        _plot_over_time(result, axes, aligned.time, force, label="as recorded", **_AS_RECORDED)
    if curve is not None:
        label = "as recorded" if is_untouched else done.value
        _plot_over_time(result, axes, curve.time, up.factor * curve.force, label=label, **_CURVE)
    if not axes.lines:
        write_reason(axes, why_missing(result, "force"))
        return
    axes.set_ylabel(up.label("Force"))
    side_key(axes, axes.lines)


def plot_motion(result: TestResult, axes: Axes) -> None:
    """Draw travel, or else displacement, with the turning points."""
    moved = motion_of(result)
    if moved is None:
        write_reason(axes, why_missing(result, "motion"))
        return
    word, time, values = moved
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


def motion_of(result: TestResult) -> tuple[str, Floats, Floats] | None:
    """Return the motion of a test: its label, its time in s, its values in m."""
    aligned, curve = result.aligned, result.curve
    for name, word in _MOTIONS.items():
        if aligned is not None and name in aligned.series:
            return word, aligned.time, aligned.series[name].values
    return None if curve is None else ("Displacement", curve.time, curve.displacement)


def turning_points(result: TestResult) -> Floats:
    """Return the unique times at which branches begin or end, s."""
    branches = result.curve.branches if result.curve is not None else ()
    times = [time for branch in branches for time in (branch.start_time, branch.stop_time)]
    return np.unique(np.array(times, dtype=np.float64))


def plot_residuals(result: TestResult, axes: Axes) -> None:
    """Draw the residuals of the clock fit at each event.

    Parameters
    ----------
    result : its clock fit is drawn; bars are 95 % of the error of each event
    axes : to draw on; an explaining sentence if there is no clock fit
    """
    normal_quantile = 1.96
    fit = result.aligned.clock_fit if result.aligned is not None else None
    if fit is None:
        write_reason(axes, why_missing(result, "clock fit"))
        return
    along = scale(result, "time", "s").factor
    residuals = (fit.event_times_force - fit.to_force_time(fit.event_times_motion)) * 1e3
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.errorbar(
        fit.event_times_motion * along,
        residuals,
        yerr=normal_quantile * fit.event_errors * 1e3,
        fmt="o",
        color="C1",
        markerfacecolor="white",
        elinewidth=0.7,
        capsize=1.5,
        label="95 %",
    )
    axes.set_ylabel("Residual (ms)")
    axes.set_title(_fit_text(fit), loc="right", color=GREY)


def _fit_text(fit: ClockFit) -> str:
    """Write offset and drift with half the width of their intervals, and the residual, if any."""
    clock_parameters = 2  # offset and drift
    events = len(fit.event_times_motion)
    residual_text = f"residual {1e3 * fit.residual:.2g} ms (rms of {events})"
    if events <= clock_parameters:
        residual_text = f"{count_of(events, 'event')} for two unknowns: no residual"
    offset = _with_half(fit.offset, fit.offset_interval, 1.0)
    drift = _with_half(fit.drift, fit.drift_interval, 1e6)
    return f"offset {offset} s,  drift {drift} ppm,  {residual_text};  bars: 95 % of each event"


def _with_half(value: float, interval: Interval, factor: float) -> str:
    """Write a number and half the width of its interval, to the second digit of that half."""
    place = place_of(value, interval, factor)
    half = 0.5 * (interval.upper - interval.lower)
    return f"{rounded(factor * value, place)} ± {rounded(factor * half, place)}".replace(
        "-", "\u2212"
    )


def _plot_over_time(
    result: TestResult, axes: Axes, time: Floats, values: Floats, **look: Any
) -> None:
    rows = extremes(values, bins=900)
    along = scale(result, "time", "s").factor
    axes.plot(time[rows] * along, values[rows], **look)
    axes.margins(x=0.01)
