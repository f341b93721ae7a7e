"""Draw uncertainty budgets: one bar per number, divided into the shares of the causes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.causes import IS_COMMON
from labpipe.records.curve import Interval
from labpipe.records.group import Group
from labpipe.records.result import TestResult
from labpipe.report import plot_records as plots
from labpipe.report import wording
from labpipe.report.figure_page import GREY, read_looks
from labpipe.report.plot_records import Axis, Label, Line, Page, Plot
from labpipe.statistics.means import sort_causes, summarise_budget

MAX_BARS = 20
"""Largest number of bars in a panel."""
SMALL_CAUSES = "causes under 2 % in every bar"
"""Name of the sum of the shares of small causes."""


class BudgetBar(NamedTuple):
    """The budget of one number, drawn as a bar.

    Parameters
    ----------
    name : text left of the bar
    shares : share of each cause in the interval; their sum is one. Empty for a row without a bar
    text : text right of the bar
    """

    name: str
    shares: Mapping[str, float]
    text: str = ""


def make_budget_page(result: TestResult) -> Page:
    """Make the page of the uncertainty budgets of a test: a bar of shares for each number.

    Parameters
    ----------
    result : result of the test. The first `MAX_BARS` numbers with a budget have a bar, except those
        of later cycles, of single slips and of the clocks

    Returns
    -------
    A page; without any bar, a page that gives the reason.
    """
    row_mm, frame_mm = 6.0, 26.0
    numbers = [
        number
        for number in result.results
        if number.largest_share is not None
        and wording.is_main(number.name)
        and wording.is_first_cycle(number.name)
    ][:MAX_BARS]
    bars = []
    for number in numbers:
        scale = wording.find_display_unit(number.name, number.unit, result.display)
        causes = [contribution.cause for contribution in number.budget]
        shares = dict(zip(causes, number.shares, strict=True))
        half_width = write_half_width(number.interval, scale)
        bars.append(BudgetBar(_write_bar_label(number.name), shares, half_width))
    panel = make_bar_plot(bars)
    if not bars:
        panel = plots.make_empty_plot(format_sentence("report.no_budget"))
    has_cycles = any("." in number.name for number in numbers)
    note = "Numbers per cycle: first cycle only." if has_cycles else ""
    height = frame_mm + row_mm * len(bars)
    return plots.make_test_page(result, "uncertainty-budget", [panel], note, height=height)


def _write_bar_label(name: str) -> str:
    """Write the label of a number without its cycle: all bars show the first cycle."""
    return wording.write_label(name.partition(".")[0])


def write_half_width(interval: Interval | None, scale: wording.Scale) -> str:
    """Write the half-width of an interval, such as ``± 0.11 mm``; empty without an interval."""
    last_plain_place = -6  # below, the number is written with a power of ten
    if interval is None:
        return ""
    half_width = 0.5 * abs(scale.factor) * (interval.upper - interval.lower)
    last_place = wording.find_last_place(half_width, None, digits=2)
    is_plain = last_place >= last_plain_place
    text = (
        wording.round_to_place(half_width, last_place)
        if is_plain
        else wording.write_number(half_width, None, digits=2).value
    )
    return f"\u00b1 {text} {wording.typeset_unit(scale.unit)}".strip()


def make_bar_plot(bars: Sequence[BudgetBar]) -> Plot:
    """Make the plot of bars, the first on top; causes that all tests of a rig share are hatched.

    Parameters
    ----------
    bars : a bar without shares leaves its row empty
    """
    sorted_shares = sort_shares([bar.shares for bar in bars])
    causes = list_drawn_causes(sorted_shares)
    lines = [_make_bar(cause, np.zeros(0), label=cause) for cause in causes]
    if any(IS_COMMON.get(cause, False) for cause in causes):
        lines.append(plots.key("common_cause", is_closed=True))
    labels = [Label("95 %", np.inf, 0.8, (6.0, 0.0), {"color": GREY})]
    for row, (bar, shares) in enumerate(zip(bars, sorted_shares, strict=True)):
        labels.append(Label(bar.text, np.inf, -row, (6.0, 0.0)))
        ends = np.cumsum([0.0, *shares.values()])
        for cause, start, stop in zip(shares, ends[:-1], ends[1:], strict=True):
            lines.append(_make_bar(cause, np.array([start, stop]), row))
            labels += _label_share(cause, start, stop, row)
    rows = Axis(low=0.5 - len(bars), high=0.5, row_names=tuple(bar.name for bar in bars))
    share = Axis("Share of the variance", wording.Scale(100.0, "%"), 0.0, 1.0)
    return Plot(share, rows, lines, labels=labels)


def _make_bar(cause: str, ends: Floats, row: int = 0, **settings: Any) -> Line:
    half_height = 0.37
    look = "common_cause" if IS_COMMON.get(cause, False) else "cause"
    colour, middle = find_cause_colour(cause), np.full(len(ends), -float(row))
    settings = {"label": "", "facecolor": colour, **settings}
    return plots.area(look, ends, middle - half_height, middle + half_height, **settings)


def _label_share(cause: str, start: float, stop: float, row: int) -> Iterator[Label]:
    """Yield the share of a cause, with a plain background if its part of the bar is hatched."""
    min_labelled_share = 0.10  # a smaller part is too narrow for its number
    max_dark_brightness = 0.45  # on a darker part, white text is easier to read than black
    if stop - start < min_labelled_share:
        return
    colour = find_cause_colour(cause)
    red, green, blue = (int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5))
    is_dark = 0.3 * red + 0.59 * green + 0.11 * blue < max_dark_brightness
    settings: dict[str, Any] = {"ha": "center", "color": "white" if is_dark else "black"}
    if IS_COMMON.get(cause, False):
        settings["bbox"] = {"facecolor": colour, "edgecolor": "none", "pad": 1.0}
    yield Label(f"{100 * (stop - start):.0f}", (start + stop) / 2, -row, settings=settings)


def find_cause_colour(cause: str) -> str:
    """Return the colour of a cause in all figures; light grey for an unknown cause."""
    colour: str = read_looks()["colours_of_causes"].get(cause, "#ededed")
    return colour


def sort_shares(bar_shares: Sequence[Mapping[str, float]]) -> list[dict[str, float]]:
    """Sort the shares of bars in the order of the key, and add up those of small causes.

    Parameters
    ----------
    bar_shares : shares of each bar, by cause

    Returns
    -------
    Sorted shares of each bar. The last one, `SMALL_CAUSES`, is the sum of the causes that have less
    than 2 % in every bar.
    """
    min_named_share = 0.02
    named_causes = {
        cause
        for shares in bar_shares
        for cause, share in shares.items()
        if share >= min_named_share
    }
    sorted_shares = []
    for shares in bar_shares:
        named = {cause: shares[cause] for cause in sort_causes(shares) if cause in named_causes}
        small = sum(share for cause, share in shares.items() if cause not in named_causes)
        sorted_shares.append({**named, **({SMALL_CAUSES: small} if small > 0.0 else {})})
    return sorted_shares


def list_drawn_causes(bar_shares: Sequence[Mapping[str, float]]) -> list[str]:
    """List the causes that bars show, `SMALL_CAUSES` last.

    Parameters
    ----------
    bar_shares : shares of each bar, from `sort_shares`
    """
    causes = {cause for shares in bar_shares for cause in shares}
    last = [SMALL_CAUSES] if SMALL_CAUSES in causes else []
    return [*sort_causes(causes - {SMALL_CAUSES}), *last]


def make_group_bars(group: Group, *, of_means: bool) -> list[BudgetBar]:
    """Make the bars of the numbers of a group.

    Parameters
    ----------
    group : group of samples; may be empty
    of_means : whether the shares are those of the means, with the half-widths of their intervals.
        Otherwise they are the medians of the shares of the tests, without half-widths

    Returns
    -------
    At most `MAX_BARS` bars, of the numbers that have a budget in a test. Numbers of later cycles,
    of single slips and of the clocks have none. A mean without an interval has a bar without
    shares.
    """
    bars = []
    for number in group.numbers:
        if not (wording.is_main(number.name) and wording.is_first_cycle(number.name)):
            continue
        budget, interval = summarise_budget(number), None
        if of_means and number.mean is not None:
            interval = number.mean.chosen.interval
        scale = wording.find_number_unit(group, number)
        if budget.of_tests:
            shares = budget.of_mean if of_means else budget.of_tests
            bars.append(
                BudgetBar(_write_bar_label(number.name), shares, write_half_width(interval, scale))
            )
    return bars[:MAX_BARS]
