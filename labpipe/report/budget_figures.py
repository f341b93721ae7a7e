"""Budgets of intervals: shares of the causes, a bar per number, for a test and for a group."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from labpipe.records.causes import (
    CENTRE,
    CLOCK_DRIFT,
    CLOCK_OFFSET,
    COMPLIANCE,
    DRIFT_OF_ZERO,
    FIT,
    GRIP,
    IS_COMMON,
    LENGTH,
    MARKER_SIDE,
    NOISE,
    NOISE_OF_DISPLACEMENT,
    NOISE_OF_FORCE,
    PULL,
    REPAIRED_SLIPS,
    RESOLUTION,
    SCALE_OF_DISPLACEMENT,
    SCALE_OF_FORCE,
    SECTION,
    SHAPE,
    SLACK,
    SPAN,
    SPEED,
    STEP,
    TANGENT,
    TURN,
    ZERO_OF_DISPLACEMENT,
    ZERO_OF_FORCE,
)
from labpipe.records.curve import Interval
from labpipe.records.group import Group, GroupNumber
from labpipe.records.result import Result, TestResult
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    GREY,
    PageTexts,
    area_key,
    keyed_page,
    new_page,
    panel_letter,
    write_reason,
)
from labpipe.report.group_plots import count_words
from labpipe.report.wording import (
    Scale,
    as_label,
    display_of,
    footnote,
    is_first_cycle,
    is_main,
    place_of,
    rounded,
    shown_in,
    title,
    unit_words,
    write_number,
)
from labpipe.statistics.means import SCATTER, group_budget, in_order

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ROW_MM = 6.0
"""Height of a bar with its gap."""
_FRAME_MM = 26.0
"""Height of axis and heading."""
MOST_BARS = 20
_MIN_LABELLED_SHARE = 0.10
"""Smallest share of a bar that has room for its number."""
SMALLER = "causes under 2 % in every bar"
_HATCH = "////"
COLOURS_OF_CAUSES: Mapping[str, str] = {
    SCATTER: "#4d4d4d",
    NOISE: "#8c8c8c",
    FIT: "#c9bfae",
    NOISE_OF_FORCE: "#8c8c8c",
    NOISE_OF_DISPLACEMENT: "#c4c4c4",
    SCALE_OF_FORCE: "#d55e00",
    ZERO_OF_FORCE: "#f4b183",
    DRIFT_OF_ZERO: "#ffd9c2",
    SCALE_OF_DISPLACEMENT: "#0072b2",
    ZERO_OF_DISPLACEMENT: "#8ec3e6",
    SHAPE: "#cc79a7",
    COMPLIANCE: "#009e73",
    TURN: "#93d5c0",
    SPEED: "#00674b",
    GRIP: "#f3d38a",
    PULL: "#e69f00",
    CENTRE: "#946700",
    MARKER_SIDE: "#8a4f72",
    CLOCK_OFFSET: "#6f4aa8",
    CLOCK_DRIFT: "#bba7dd",
    LENGTH: "#c49a6c",
    SPAN: "#c49a6c",
    SECTION: "#7a3b1d",
    SLACK: "#56b4e9",
    REPAIRED_SLIPS: "#b0124f",
    RESOLUTION: "#5c5c9e",
    STEP: "#f2a6bd",
    TANGENT: "#3a4a8c",
}
"""One family of colours for each instrument; a cause has the same colour in every figure."""
_OTHER = "#ededed"


class Bar(NamedTuple):
    """One number: its name, the shares of its interval by cause, and the text to its right."""

    name: str
    shares: Mapping[str, float]
    text: str = ""


def draw_budget(result: TestResult) -> Figure:
    """Draw the budgets of a test's intervals: shares of the variance, a bar per number.

    Numbers of later cycles, of single slips and of the clocks are left out.
    """
    budgeted = [result for result in result.results if result.largest_share is not None]
    numbers = [one for one in budgeted if is_main(one.name) and is_first_cycle(one.name)][
        :MOST_BARS
    ]
    if not numbers:
        page = new_page(result, width_mm=DOUBLE_COLUMN, height_mm=40)
        write_reason(page.subplots(), "No number of this test has a budget of its interval.")
        return page
    bars = [_bar(number, result.display) for number in numbers]
    cycle = "Numbers per cycle: first cycle only." if any("." in x.name for x in numbers) else ""
    note = " ".join(filter(None, (cycle, footnote(result))))
    texts = PageTexts(title(result), note, _keys(bars))
    height = _FRAME_MM + _ROW_MM * len(bars)
    page = keyed_page(texts, height_mm=height, width_mm=DOUBLE_COLUMN)
    _set_side_margins(page)
    plot_bars(bars, page.subplots())
    return page


def _set_side_margins(page: Figure) -> None:
    """Set margins on both sides: texts are wider where the font of the page is missing."""
    left_margin, right_margin = 0.06, 0.03  # shares of the width of the page
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    engine = page.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        _, low, _, height = engine.get()["rect"]
        engine.set(rect=(left_margin, low, 1.0 - left_margin - right_margin, height))


def _bar(result: Result, display: Mapping[str, str]) -> Bar:
    rows = zip(result.budget, result.shares, strict=True)
    scale = shown_in(result.name, result.unit, display)
    shares = {row.cause: share for row, share in rows}
    return Bar(_bar_name(result.name), shares, half_width(result.interval, scale))


def _bar_name(name: str) -> str:
    """Name a number without its cycle, which is the first in every bar."""
    return as_label(name.partition(".")[0])


def half_width(interval: Interval | None, scale: Scale) -> str:
    """Write half the width of an interval, such as ``-+ 0.11 mm``; empty without an interval."""
    last_plain_place = -6  # smaller numbers have a power of ten
    if interval is None:
        return ""
    half = 0.5 * abs(scale.factor) * (interval.upper - interval.lower)
    place = place_of(half, None, digits=2)
    is_plain = place >= last_plain_place
    text = rounded(half, place) if is_plain else write_number(half, None, digits=2).value
    return f"\u00b1 {text} {unit_words(scale.unit)}".strip()


def plot_bars(bars: Sequence[Bar], axes: Axes, *, of: str = "variance") -> None:
    """Draw shares side by side, a bar per number, the first on top.

    Parameters
    ----------
    bars : with shares that add to one; a bar without shares leaves its row empty
    axes : to draw on; causes that all tests of a rig share are hatched
    of : the quantity that is divided into shares
    """
    bar_height = 0.74  # share of the row
    from matplotlib.patches import Rectangle

    named = set(named_causes([bar.shares for bar in bars]))
    beside = axes.get_yaxis_transform()
    for height, bar in enumerate(bars):
        start = 0.0
        for cause, share in bar_parts(bar.shares, named).items():
            corner = 100 * start, height - bar_height / 2
            axes.add_artist(Rectangle(corner, 100 * share, bar_height, **_bar_style(cause)))
            if share >= _MIN_LABELLED_SHARE:
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


def _write_share(axes: Axes, at: float, height: float, share: float, cause: str) -> None:
    """Write a share on its colour; on hatching, on a patch of plain colour."""
    dark_below = 0.45  # brightness below which white is easier to read than black
    from matplotlib.colors import to_rgb

    ground = COLOURS_OF_CAUSES.get(cause, _OTHER)
    red, green, blue = to_rgb(ground)
    is_dark = 0.3 * red + 0.59 * green + 0.11 * blue < dark_below
    is_hatched = IS_COMMON.get(cause, False)
    label = axes.text(
        at, height, f"{100 * share:.0f}", ha="center", va="center",
        color="white" if is_dark else "black",
        bbox={"facecolor": ground, "edgecolor": "none", "pad": 1.0} if is_hatched else None,
    )  # fmt: skip
    label.set_in_layout(False)  # it lies on its bar


def bar_parts(shares: Mapping[str, float], named: set[str]) -> dict[str, float]:
    """Sort shares in the order of the key, with the sum of those not named at the end.

    Parameters
    ----------
    shares : by cause
    named : causes that have a colour of their own
    """
    ordered = {cause: shares[cause] for cause in sort_causes(shares)}
    parts = {cause: share for cause, share in ordered.items() if cause in named}
    rest = sum(share for cause, share in ordered.items() if cause not in named)
    return {**parts, **({SMALLER: rest} if rest > 0.0 else {})}


def sort_causes(causes: Iterable[str]) -> list[str]:
    """Sort causes as in the key: scatter first."""
    every = set(causes)
    return [*([SCATTER] if SCATTER in every else []), *in_order(every - {SCATTER})]


def named_causes(bars: Sequence[Mapping[str, float]]) -> list[str]:
    """List the causes whose share in at least one bar is large enough to be drawn.

    Parameters
    ----------
    bars : shares by cause
    """
    min_named_share = 0.02
    every = {cause for bar in bars for cause, share in bar.items() if share >= min_named_share}
    return sort_causes(every)


def _bar_style(cause: str) -> dict[str, Any]:
    is_common = IS_COMMON.get(cause, False)
    look = {
        "facecolor": COLOURS_OF_CAUSES.get(cause, _OTHER),
        "edgecolor": "white",
        "linewidth": 0.6,
    }
    return {**look, "hatch": _HATCH} if is_common else look


def causes_in_key(bars: Sequence[Mapping[str, float]]) -> list[str]:
    """List the causes that bars show, `SMALLER` last if any bar has a rest.

    Parameters
    ----------
    bars : shares by cause
    """
    named = named_causes(bars)
    has_rest = any(SMALLER in bar_parts(shares, set(named)) for shares in bars)
    return [*named, *([SMALLER] if has_rest else [])]


def _keys(bars: Sequence[Bar]) -> list[Artist]:
    causes = causes_in_key([bar.shares for bar in bars])
    keys = [area_key(cause, **_bar_style(cause)) for cause in causes]
    if any(IS_COMMON.get(cause, False) for cause in causes):
        hatched = {"facecolor": "#999999", "edgecolor": "white", "linewidth": 0.6, "hatch": _HATCH}
        keys.append(area_key("hatched: common to all tests", **hatched))
    return keys


def budgets_to_draw(group: Group) -> list[GroupNumber]:
    """Return the numbers of a group that have budgets: no later cycles, no slips, no clocks.

    Parameters
    ----------
    group : with or without samples
    """
    numbers = [one for one in group.numbers if is_main(one.name) and is_first_cycle(one.name)]
    return [number for number in numbers if group_budget(number).of_tests][:MOST_BARS]


def draw_group_budgets(group: Group) -> Figure:
    """Draw the budgets of the intervals of a group's tests and of its means.

    Parameters
    ----------
    group : one that has `budgets_to_draw`
    """
    numbers = budgets_to_draw(group)
    budgets = [group_budget(number) for number in numbers]
    of_tests = [
        Bar(_bar_name(number.name), budget.of_tests)
        for number, budget in zip(numbers, budgets, strict=True)
    ]
    of_means = [
        Bar(_bar_name(number.name), budget.of_mean, _half_of_mean(group, number))
        for number, budget in zip(numbers, budgets, strict=True)
    ]
    heading = f"{group.name}  \u00b7  {group.protocol}  \u00b7  {count_words(group)}"
    texts = PageTexts(heading, "", _keys([*of_tests, *of_means]))
    has_means = any(bar.shares for bar in of_means)
    rows_mm = _ROW_MM * len(numbers)
    height = _FRAME_MM + (2.0 * rows_mm + 18.0 if has_means else rows_mm + 4.0)
    page = keyed_page(texts, height_mm=height)
    _set_side_margins(page)
    panels = page.subplots(2 if has_means else 1, squeeze=False).ravel()
    plot_bars(of_tests, panels[0])
    panel_letter(panels[0], "a", "One test: median shares")
    if has_means:
        plot_bars(of_means, panels[1], of="squared half width")
        panel_letter(panels[1], "b", "Mean of the group")
    return page


def _half_of_mean(group: Group, number: GroupNumber) -> str:
    scale = shown_in(number.name, number.unit, display_of(group))
    return "" if number.mean is None else half_width(number.mean.chosen.interval, scale)
