"""Draw uncertainty budgets: one bar per number, divided into the shares of the causes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from labpipe.messages import format_sentence
from labpipe.records.causes import IS_COMMON
from labpipe.records.curve import Interval
from labpipe.records.group import Group
from labpipe.records.result import TestResult
from labpipe.report import figure_page, wording
from labpipe.statistics.means import sort_causes, summarise_budget

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ROW_HEIGHT_MM = 6.0
"""Height of the row of one bar, with the gap below it."""
_FRAME_HEIGHT_MM = 26.0
"""Height of the axis and the heading of a panel."""
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


def draw_budget(result: TestResult) -> Figure:
    """Draw the uncertainty budgets of a test: shares of the variance, one bar per number.

    Parameters
    ----------
    result : result of the test. The first `MAX_BARS` numbers with a budget have a bar, except those
        of later cycles, of single slips and of the clocks

    Returns
    -------
    A page; without any bar, a page that gives the reason.
    """
    numbers = [
        number
        for number in result.results
        if number.largest_share is not None
        and wording.is_main(number.name)
        and wording.is_first_cycle(number.name)
    ][:MAX_BARS]
    if not numbers:
        return figure_page.make_reason_page(result, format_sentence("report.no_budget"))
    page = figure_page.make_page(
        height_mm=_FRAME_HEIGHT_MM + _ROW_HEIGHT_MM * len(numbers),
        width_mm=figure_page.DOUBLE_COLUMN,
    )
    bars = []
    for number in numbers:
        scale = wording.find_display_unit(number.name, number.unit, result.display)
        causes = [contribution.cause for contribution in number.budget]
        shares = dict(zip(causes, number.shares, strict=True))
        bars.append(
            BudgetBar(
                _write_bar_label(number.name), shares, write_half_width(number.interval, scale)
            )
        )
    plot_bars(bars, page.subplots())
    has_cycles = any("." in number.name for number in numbers)
    cycle = "Numbers per cycle: first cycle only." if has_cycles else ""
    note = " ".join(filter(None, (cycle, wording.write_footnote(result))))
    return _set_side_margins(figure_page.add_title(page, wording.write_title(result), note))


def _set_side_margins(page: Figure) -> Figure:
    """Widen the side margins, since texts may be wider in another font; return the page."""
    left_margin, right_margin = 0.06, 0.03  # as shares of the width of the page
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    engine = page.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        _, bottom, _, height = engine.get()["rect"]
        engine.set(rect=(left_margin, bottom, 1.0 - left_margin - right_margin, height))
    return page


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


def plot_bars(bars: Sequence[BudgetBar], axes: Axes) -> None:
    """Draw bars, the first on top; hatch the causes that all tests of a rig share.

    Parameters
    ----------
    bars : a bar without shares leaves its row empty
    axes : to draw on
    """
    min_labelled_share = 0.10  # a smaller part is too narrow for its number
    bar_height = 0.74  # as a share of the height of its row
    from matplotlib.patches import Rectangle

    sorted_shares = sort_shares([bar.shares for bar in bars])
    for cause in list_drawn_causes(sorted_shares):
        figure_page.add_key(axes, cause, is_area=True, **_make_bar_style(cause))
    if any(IS_COMMON.get(cause, False) for cause in list_drawn_causes(sorted_shares)):
        figure_page.add_key(axes, "hatched: common to all tests", is_area=True, **_HATCHED_STYLE)
    outside_axes = axes.get_yaxis_transform()
    for row, (bar, shares) in enumerate(zip(bars, sorted_shares, strict=True)):
        start = 0.0
        for cause, share in shares.items():
            corner = 100 * start, row - bar_height / 2
            axes.add_artist(Rectangle(corner, 100 * share, bar_height, **_make_bar_style(cause)))
            if share >= min_labelled_share:
                _write_share(axes, 100 * (start + share / 2), row, share, cause)
            start += share
        axes.text(1.01, row, bar.text, transform=outside_axes, va="center")
        axes.text(-0.01, row, bar.name, transform=outside_axes, va="center", ha="right")
    if any(bar.text for bar in bars):
        axes.text(1.01, -0.8, "95 %", transform=outside_axes, color=figure_page.GREY, va="center")
    axes.set_yticks([])
    axes.set_ylim(len(bars) - 0.5, -0.5)
    axes.set_xlim(0.0, 100.0)
    axes.spines["left"].set_visible(False)
    axes.set_xlabel("Share of the variance (%)")


def _write_share(axes: Axes, x: float, y: float, share: float, cause: str) -> None:
    """Write a share on its part of the bar, with a plain background if the part is hatched."""
    max_dark_brightness = 0.45  # on a darker part, white text is easier to read than black
    from matplotlib.colors import to_rgb

    colour = find_cause_colour(cause)
    red, green, blue = to_rgb(colour)
    is_dark = 0.3 * red + 0.59 * green + 0.11 * blue < max_dark_brightness
    is_hatched = IS_COMMON.get(cause, False)
    label = axes.text(
        x, y, f"{100 * share:.0f}", ha="center", va="center",
        color="white" if is_dark else "black",
        bbox={"facecolor": colour, "edgecolor": "none", "pad": 1.0} if is_hatched else None,
    )  # fmt: skip
    label.set_in_layout(False)  # it lies on its bar and needs no space of its own


def find_cause_colour(cause: str) -> str:
    """Return the colour of a cause in all figures; light grey for an unknown cause."""
    colour: str = figure_page.read_look("colours_of_causes").get(cause, "#ededed")
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


_HATCHED_STYLE: dict[str, Any] = {
    "facecolor": "#999999", "edgecolor": "white", "linewidth": 0.6, "hatch": "////"
}  # fmt: skip


def _make_bar_style(cause: str) -> dict[str, Any]:
    hatch = _HATCHED_STYLE["hatch"] if IS_COMMON.get(cause, False) else None
    return {**_HATCHED_STYLE, "facecolor": find_cause_colour(cause), "hatch": hatch}


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
