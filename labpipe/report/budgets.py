"""Make the bars of uncertainty budgets: the shares of causes in the variance of numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.causes import IS_COMMON
from labpipe.records.curve import Interval
from labpipe.records.group import GroupNumber
from labpipe.records.result import Result
from labpipe.report import plot_records as plots
from labpipe.report import wording
from labpipe.report.figure_page import GREY, read_looks
from labpipe.report.plot_records import Axis, Label, Plot
from labpipe.statistics.means import sort_causes

MAX_BARS = 20
"""Largest number of bars in a panel."""
SMALL_CAUSES = "causes under 2 % in every bar"
"""Name of the sum of the shares of small causes in a bar."""


class BudgetBar(NamedTuple):
    """The uncertainty budget of one number, which is drawn as a bar.

    Parameters
    ----------
    name : label of the number, to the left of the bar
    shares : share of the variance that each cause contributes, keyed by cause; the sum is one. A
        row without a bar has no shares
    text : text to the right of the bar
    """

    name: str
    shares: Mapping[str, float]
    text: str = ""


def has_budget_bar(name: str) -> bool:
    """Return whether a result describes the specimen, in the first cycle or in no cycle."""
    return wording.is_main(name) and wording.is_first_cycle(name)


def make_budget_bar(
    number: Result | GroupNumber,
    shares: Mapping[str, float],
    interval: Interval | None,
    display: Mapping[str, str],
) -> BudgetBar:
    """Make the bar of a number. The text of the bar is half the width of the interval.

    Parameters
    ----------
    number : number of a test or of a group. Its label omits the cycle, because all bars show the
        first cycle
    shares : share of the variance that each cause contributes, keyed by cause
    interval : interval of the number, SI; None without an interval
    display : display unit of each quantity, keyed by quantity
    """
    bar_text, scale = "", wording.choose_scale(number.name, number.unit, display)
    if interval is not None:
        half_width = 0.5 * abs(scale.factor) * (interval.upper - interval.lower)
        half_width_text = wording.format_number(half_width, None, digits=2).value
        bar_text = f"\u00b1 {half_width_text} {scale.unit}".strip()
    return BudgetBar(wording.format_label(number.name.partition(".")[0]), shares, bar_text)


def make_budget_plot(bars: Sequence[BudgetBar]) -> Plot:
    """Make the plot of bars; the first is on top, and causes common to all tests are hatched.

    Parameters
    ----------
    bars : budgets of the numbers; a bar without shares leaves its row empty
    """
    sorted_shares = sort_shares([bar.shares for bar in bars])
    causes = list_drawn_causes(sorted_shares)
    segments: dict[str, list[tuple[float, float, int]]] = {cause: [] for cause in causes}
    labels = [Label("95 %", np.inf, 0.8, (6.0, 0.0), {"color": GREY})]
    for row, (bar, shares) in enumerate(zip(bars, sorted_shares, strict=True)):
        labels.append(Label(bar.text, np.inf, -row, (6.0, 0.0)))
        ends = np.cumsum([0.0, *shares.values()])
        for cause, start, stop in zip(shares, ends[:-1], ends[1:], strict=True):
            segments[cause].append((start, stop, row))
            labels += _make_share_label(cause, start, stop, row)
    lines = []
    for cause in causes:
        look = "common_cause" if IS_COMMON.get(cause, False) else "cause"
        settings = {"label": cause, "facecolor": get_cause_colour(cause)}
        left, right, rows = np.array(segments[cause]).T
        lines.append(plots.make_bars(look, left, right, rows, height=0.74, **settings))
    if any(IS_COMMON.get(cause, False) for cause in causes):
        lines.append(plots.make_legend_line("common_cause", is_closed=True))
    row_axis = Axis(low=0.5 - len(bars), high=0.5, row_names=tuple(bar.name for bar in bars))
    share_axis = Axis("Share of the variance", wording.Scale(100.0, "%"), 0.0, 1.0)
    reason = format_sentence("report.no_budget")
    return Plot(share_axis, row_axis, lines, labels=labels, reason=reason)


def _make_share_label(cause: str, start: float, stop: float, row: int) -> Iterator[Label]:
    """Yield the label of a segment of a bar, its share in per cent, if the segment is wide enough.

    On a hatched segment, the label has a plain background.
    """
    min_labelled_share = 0.10  # a smaller segment is too narrow for its number
    max_dark_brightness = 0.45  # on a darker segment, white text is easier to read than black
    if stop - start < min_labelled_share:
        return
    colour = get_cause_colour(cause)
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    is_dark = 0.3 * red + 0.59 * green + 0.11 * blue < 255 * max_dark_brightness
    settings: dict[str, Any] = {"ha": "center", "color": "white" if is_dark else "black"}
    if IS_COMMON.get(cause, False):
        settings["bbox"] = {"facecolor": colour, "edgecolor": "none", "pad": 1.0}
    yield Label(f"{100 * (stop - start):.0f}", (start + stop) / 2, -row, settings=settings)


def get_cause_colour(cause: str) -> str:
    """Get the colour of a cause in all figures; light grey for an unknown cause."""
    colour: str = read_looks()["colours_of_causes"].get(cause, "#ededed")
    return colour


def sort_shares(bar_shares: Sequence[Mapping[str, float]]) -> list[dict[str, float]]:
    """Sort the shares of bars in the order of the legend, and add up the shares of small causes.

    Parameters
    ----------
    bar_shares : shares of each bar, keyed by cause

    Returns
    -------
    Sorted shares of each bar, keyed by cause. The last share, that of `SMALL_CAUSES`, is the sum of
    the causes that have less than 2 % in every bar; it is omitted if it is zero.
    """
    min_share = 0.02
    items = (item for shares in bar_shares for item in shares.items())
    large_causes = {cause for cause, share in items if share >= min_share}
    all_sorted_shares = []
    for shares in bar_shares:
        sorted_shares = {cause: shares[cause] for cause in sort_causes(large_causes & set(shares))}
        small_share = sum(share for cause, share in shares.items() if cause not in large_causes)
        if small_share > 0.0:
            sorted_shares[SMALL_CAUSES] = small_share
        all_sorted_shares.append(sorted_shares)
    return all_sorted_shares


def list_drawn_causes(bar_shares: Sequence[Mapping[str, float]]) -> list[str]:
    """List the causes in the bars, in the order of the legend; `SMALL_CAUSES` is last.

    Parameters
    ----------
    bar_shares : shares of each bar, from `sort_shares`
    """
    causes = {cause for shares in bar_shares for cause in shares}
    small_causes = [SMALL_CAUSES] if SMALL_CAUSES in causes else []
    return [*sort_causes(causes - {SMALL_CAUSES}), *small_causes]
