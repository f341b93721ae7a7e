"""Figures of budgets: the share of each cause in an interval, a bar per number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from labpipe.messages import format_sentence
from labpipe.records import causes as cause_names
from labpipe.records.curve import Interval
from labpipe.records.group import Group
from labpipe.records.result import TestResult
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    GREY,
    add_key,
    add_title,
    make_page,
    make_reason_page,
    read_look,
)
from labpipe.report.wording import (
    Scale,
    find_display_unit,
    find_last_place,
    find_number_unit,
    is_first_cycle,
    is_main,
    round_to_place,
    typeset_unit,
    write_footnote,
    write_group_title,
    write_label,
    write_number,
    write_title,
)
from labpipe.statistics.means import sort_causes, summarise_budget

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ROW_MM = 6.0
"""Height of a bar with its gap."""
_FRAME_MM = 26.0
"""Height of axis and heading."""
MAX_BARS = 20
SMALLER = "causes under 2 % in every bar"


class Bar(NamedTuple):
    """Bar of one number.

    Parameters
    ----------
    name : left of the bar
    shares : of the interval by cause; their sum is one
    text : right of the bar
    """

    name: str
    shares: Mapping[str, float]
    text: str = ""


def draw_budget(result: TestResult) -> Figure:
    """Draw the budgets of the intervals of a test: shares of the variance, a bar per number.

    Numbers of later cycles, of single slips and of the clocks have no bar.
    """
    numbers = [
        number
        for number in result.results
        if number.largest_share is not None and is_main(number.name) and is_first_cycle(number.name)
    ][:MAX_BARS]
    if not numbers:
        return make_reason_page(result, format_sentence("report.no_budget"))
    page = make_page(height_mm=_FRAME_MM + _ROW_MM * len(numbers), width_mm=DOUBLE_COLUMN)
    bars = []
    for number in numbers:
        scale = find_display_unit(number.name, number.unit, result.display)
        causes = [contribution.cause for contribution in number.budget]
        shares = dict(zip(causes, number.shares, strict=True))
        bars.append(Bar(_bar_name(number.name), shares, write_half_width(number.interval, scale)))
    plot_bars(bars, page.subplots())
    has_cycles = any("." in number.name for number in numbers)
    cycle = "Numbers per cycle: first cycle only." if has_cycles else ""
    note = " ".join(filter(None, (cycle, write_footnote(result))))
    return _with_side_margins(add_title(page, write_title(result), note))


def _with_side_margins(page: Figure) -> Figure:
    """Set margins on both sides for texts that another font makes wider."""
    left_margin, right_margin = 0.06, 0.03  # shares of the width of the page
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    engine = page.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        _, low, _, height = engine.get()["rect"]
        engine.set(rect=(left_margin, low, 1.0 - left_margin - right_margin, height))
    return page


def _bar_name(name: str) -> str:
    """Write the label of a number without its cycle, which is the first in every bar."""
    return write_label(name.partition(".")[0])


def write_half_width(interval: Interval | None, scale: Scale) -> str:
    """Write half the width of an interval, such as ``± 0.11 mm``; empty without an interval."""
    last_plain_place = -6  # smaller numbers have a power of ten
    if interval is None:
        return ""
    half = 0.5 * abs(scale.factor) * (interval.upper - interval.lower)
    place = find_last_place(half, None, digits=2)
    is_plain = place >= last_plain_place
    text = round_to_place(half, place) if is_plain else write_number(half, None, digits=2).value
    return f"\u00b1 {text} {typeset_unit(scale.unit)}".strip()


def plot_bars(bars: Sequence[Bar], axes: Axes, *, of: str = "variance") -> None:
    """Draw bars of shares, the first on top.

    Parameters
    ----------
    bars : a bar without shares leaves its row empty
    axes : to draw on; causes that all tests of a rig share are hatched
    of : name of the quantity of which the shares are
    """
    min_labelled_share = 0.10  # smallest share of a bar that has room for its number
    bar_height = 0.74  # share of the row
    from matplotlib.patches import Rectangle

    parts = sort_shares([bar.shares for bar in bars])
    for cause in list_shown_causes(parts):
        add_key(axes, cause, is_area=True, **_bar_style(cause))
    if any(cause_names.IS_COMMON.get(cause, False) for cause in list_shown_causes(parts)):
        add_key(axes, "hatched: common to all tests", is_area=True, **_HATCHED)
    beside = axes.get_yaxis_transform()
    for height, (bar, shares) in enumerate(zip(bars, parts, strict=True)):
        start = 0.0
        for cause, share in shares.items():
            corner = 100 * start, height - bar_height / 2
            axes.add_artist(Rectangle(corner, 100 * share, bar_height, **_bar_style(cause)))
            if share >= min_labelled_share:
                _write_share(axes, 100 * (start + share / 2), height, share, cause)
            start += share
        axes.text(1.01, height, bar.text, transform=beside, va="center")
        axes.text(-0.01, height, bar.name, transform=beside, va="center", ha="right")
    if any(bar.text for bar in bars):
        axes.text(1.01, -0.8, "95 %", transform=beside, color=GREY, va="center")
    axes.set_yticks([])
    axes.set_ylim(len(bars) - 0.5, -0.5)
    axes.set_xlim(0.0, 100.0)
    axes.spines["left"].set_visible(False)
    axes.set_xlabel(f"Share of the {of} (%)")


def _write_share(axes: Axes, middle: float, height: float, share: float, cause: str) -> None:
    """Write a share on its part of the bar; on a hatched part, over a patch of plain colour."""
    dark_below = 0.45  # brightness below which white is easier to read than black
    from matplotlib.colors import to_rgb

    ground = find_cause_colour(cause)
    red, green, blue = to_rgb(ground)
    is_dark = 0.3 * red + 0.59 * green + 0.11 * blue < dark_below
    is_hatched = cause_names.IS_COMMON.get(cause, False)
    label = axes.text(
        middle, height, f"{100 * share:.0f}", ha="center", va="center",
        color="white" if is_dark else "black",
        bbox={"facecolor": ground, "edgecolor": "none", "pad": 1.0} if is_hatched else None,
    )  # fmt: skip
    label.set_in_layout(False)  # it lies on its bar


def find_cause_colour(cause: str) -> str:
    """Return the colour of a cause: the same in every figure, light grey for an unknown one."""
    colour: str = read_look("colours_of_causes").get(cause, "#ededed")
    return colour


def sort_shares(bars: Sequence[Mapping[str, float]]) -> list[dict[str, float]]:
    """Sort the shares of bars as in the key, and add up those of small causes at the end.

    Parameters
    ----------
    bars : shares by cause

    Returns
    -------
    Shares of each bar; causes under 2 % in every bar are added up as `SMALLER`.
    """
    min_named_share = 0.02
    named = {cause for bar in bars for cause, share in bar.items() if share >= min_named_share}
    parts = []
    for shares in bars:
        drawn = {cause: shares[cause] for cause in sort_causes(shares) if cause in named}
        rest = sum(share for cause, share in shares.items() if cause not in named)
        parts.append({**drawn, **({SMALLER: rest} if rest > 0.0 else {})})
    return parts


def list_shown_causes(parts: Sequence[Mapping[str, float]]) -> list[str]:
    """List the causes that bars show, `SMALLER` last.

    Parameters
    ----------
    parts : as `sort_shares` returns them
    """
    every = {cause for shares in parts for cause in shares}
    return [*sort_causes(every - {SMALLER}), *([SMALLER] if SMALLER in every else [])]


_HATCHED: dict[str, Any] = {
    "facecolor": "#999999", "edgecolor": "white", "linewidth": 0.6, "hatch": "////"
}  # fmt: skip


def _bar_style(cause: str) -> dict[str, Any]:
    hatch = _HATCHED["hatch"] if cause_names.IS_COMMON.get(cause, False) else None
    return {**_HATCHED, "facecolor": find_cause_colour(cause), "hatch": hatch}


def make_group_bars(group: Group, *, of_means: bool) -> list[Bar]:
    """Make the bars of a group; later cycles, slips and clocks have none.

    Parameters
    ----------
    group : with or without samples
    of_means : shares in the intervals of means, with half their widths; else the medians of the
        shares over the tests
    """
    bars = []
    for number in group.numbers:
        if not (is_main(number.name) and is_first_cycle(number.name)):
            continue
        budget, interval = summarise_budget(number), None
        if of_means and number.mean is not None:
            interval = number.mean.chosen.interval
        scale = find_number_unit(group, number)
        if budget.of_tests:
            shares = budget.of_mean if of_means else budget.of_tests
            bars.append(Bar(_bar_name(number.name), shares, write_half_width(interval, scale)))
    return bars[:MAX_BARS]


def draw_group_budgets(group: Group) -> Figure:
    """Draw the budgets of the intervals of a group's tests and of its means.

    Parameters
    ----------
    group : with a bar by `make_group_bars`
    """
    drawn = {"One test: median shares": (make_group_bars(group, of_means=False), "variance")}
    means = make_group_bars(group, of_means=True)
    if any(bar.shares for bar in means):
        drawn["Mean of the group"] = (means, "squared half width")
    page = make_page(height_mm=len(drawn) * (_FRAME_MM - 4.0 + _ROW_MM * len(means)))
    panels = page.subplots(len(drawn), squeeze=False).ravel()
    for axes, (heading, (bars, of)) in zip(panels, drawn.items(), strict=True):
        plot_bars(bars, axes, of=of)
        axes.set_title(heading, loc="left")
    return _with_side_margins(add_title(page, write_group_title(group)))
