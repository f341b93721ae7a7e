"""Figure of harness bundles between slipping and sticking: a row per sample and per group."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from math import isnan
from typing import TYPE_CHECKING, Any

from labpipe.records.group import BundlePlace, Campaign
from labpipe.report.concerns import sentences
from labpipe.report.numbers import unit_words
from labpipe.report.page import GREY, Words, keyed_page, number_log
from labpipe.report.place_tables import place_scales
from labpipe.report.saving import FigureToSave
from labpipe.report.wording import Scale

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_ROWS = 36
"""Rows of a figure, unless one group has more."""
_ROW, _REST = 4.2, 16.0
_LONGEST = 44
_BOUNDS: dict[str, Any] = {
    "color": "#d5d5d5", "linewidth": 5.0, "solid_capstyle": "butt", "zorder": 1
}  # fmt: skip
_FREE: dict[str, Any] = {
    "color": GREY, "marker": "|", "markersize": 6.0, "linestyle": "", "zorder": 2
}  # fmt: skip
_SAMPLE: dict[str, Any] = {"color": "#0072B2", "marker": "o", "markersize": 3.6}
_MEAN: dict[str, Any] = {"color": "black", "marker": "D", "markersize": 4.2}
_CAPTION = (
    "Grey: from where every wire and strand slips to where nothing slips, by the bundle model of"
    " the wire sheet, for wires alone; the tick: wires slip, the strands within them do"
    " not. Dots: samples with their 95 % intervals; diamonds: means of the groups."
    " The axis is logarithmic; an interval that reaches zero ends at its left edge."
)


def place_figures(campaign: Campaign) -> Iterator[FigureToSave]:
    """List the figures of bundles between their bounds.

    Parameters
    ----------
    campaign : its places

    Yields
    ------
    None without places; as many as are needed for `MOST_ROWS` rows each, groups kept whole.
    """
    scales = place_scales(campaign)
    parts = list(_parts(campaign.places))
    for at, part in enumerate(parts, start=1):
        name = "between-slipping-and-sticking" + (f"-{at}" if len(parts) > 1 else "")
        scale = scales[part[0].group]
        groups = ", ".join(dict.fromkeys(place.group for place in part))
        alt = f"Bending stiffness between all slipping and nothing slipping: {groups}."
        yield FigureToSave(name, partial(draw_places, part, scale), _CAPTION, alt)


def _parts(places: Sequence[BundlePlace]) -> Iterator[list[BundlePlace]]:
    groups: dict[str, list[BundlePlace]] = {}
    for place in places:
        groups.setdefault(place.group, []).append(place)
    part: list[BundlePlace] = []
    for own in groups.values():
        if part and len(part) + len(own) > MOST_ROWS:
            yield part
            part = []
        part = [*part, *own]
    if part:
        yield part


def draw_places(places: Sequence[BundlePlace], scale: Scale) -> Figure:
    """Draw bending stiffnesses on a logarithmic axis, each on the bar between its bounds.

    Parameters
    ----------
    places : rows, from the top
    scale : display unit of bending stiffness
    """
    words = Words("Between slipping and sticking  \u00b7  bundle model", keys=_place_keys())
    page = keyed_page(words, height_mm=_REST + _ROW * len(places), width_mm=150.0)
    axes = page.subplots()
    low, high = _ends(places, scale.factor)
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    for row, place in enumerate(places):
        _plot_row(place, row, scale.factor, axes)
    axes.set_yticks(range(len(places)), [_label(place) for place in places])
    axes.tick_params(axis="y", length=0, labelsize=7)
    axes.set_ylim(len(places) - 0.4, -0.6)
    axes.set_xlabel(f"Bending stiffness ({unit_words(scale.unit)})")
    number_log(axes.xaxis)
    axes.xaxis.set_major_formatter(_plain)
    return page


def _plain(value: float, _: object = None) -> str:
    """A number of an axis without a power of ten, in groups of three digits."""
    return f"{value:,.0f}".replace(",", "\u2009") if value >= 1.0 else f"{value:g}"


def _ends(places: Sequence[BundlePlace], factor: float) -> tuple[float, float]:
    """Ends of the axis: all bounds and values, and their intervals where they are above zero."""
    known = [
        factor * each
        for place in places
        for each in (place.low, place.high, place.value or 0.0, *_interval(place))
        if each > 0.0  # not NaN either
    ]
    values = known or [1.0, 10.0]
    return 0.7 * min(values), 1.4 * max(values)


def _interval(place: BundlePlace) -> tuple[float, ...]:
    return () if place.interval is None else (place.interval.upper,)


def _plot_row(place: BundlePlace, row: int, factor: float, axes: Axes) -> None:
    look = _SAMPLE if place.test else _MEAN
    if not isnan(place.low):
        axes.plot([factor * place.low, factor * place.high], [row, row], **_BOUNDS)
        axes.plot([factor * place.free], [row], **_FREE)
    left = axes.get_xlim()[0]
    if place.value is not None and place.value > 0.0:
        if place.interval is not None:
            ends = [max(factor * place.interval.lower, left), factor * place.interval.upper]
            axes.plot(ends, [row, row], color=look["color"], linewidth=1.0, zorder=2)
        axes.plot([factor * place.value], [row], linestyle="", zorder=3, **look)
    why = sentences(place.reasons)
    if why:
        shown = why if len(why) <= 2 * _LONGEST else f"{why[: 2 * _LONGEST]}\u2026"
        axes.text(0.99, row, shown, transform=axes.get_yaxis_transform(), ha="right", va="center",
                  size=6, color=GREY)  # fmt: skip


def _label(place: BundlePlace) -> str:
    words = place.test or f"mean of {place.group}"
    return words if len(words) <= _LONGEST else f"{words[: _LONGEST - 1]}\u2026"


def _place_keys() -> list[Artist]:
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], color=_BOUNDS["color"], linewidth=5.0, label="all slips to nothing slips"),
        Line2D([], [], label="wires slip, strands stick", **_FREE),
        Line2D([], [], linewidth=1.0, label="sample, 95 %", **_SAMPLE),
        Line2D([], [], linewidth=1.0, label="mean of a group, 95 %", **_MEAN),
    ]
