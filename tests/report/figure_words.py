"""Words of figures and tables, as a reader sees them, for texts that are approved."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend

from labpipe.report.figure_page import draw_page, use_style
from labpipe.report.plot_records import Page
from labpipe.report.table_records import Cell, Table, Value

MAX_LINES = 12
NUMBER = re.compile(r"\d[\d.]* × 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+|\d+\.\d+|[\d.]+(?= %)|\d{2,}")  # noqa: RUF001


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _of_axes(axes: Axes) -> Iterator[str]:
    """Headings, names of both axes, what stands in the panel, and its key."""
    yield from (axes.get_title(place) for place in ("left", "center", "right"))
    if axes.get_xlabel() or axes.get_ylabel():
        yield f"{axes.get_xlabel()} | {axes.get_ylabel()}"
    yield from (text.get_text() for text in axes.texts)
    for legend in axes.get_children():
        if isinstance(legend, Legend):
            yield from (text.get_text() for text in legend.get_texts())


def _ends(values: object) -> str:
    """Least and largest of what is finite, to three digits."""
    numbers = np.asarray(values, dtype=np.float64)
    finite = numbers[np.isfinite(numbers)]
    if not finite.size:
        return "nothing"
    low, high = float(finite.min()), float(finite.max())
    zero = max(1e-9, 1e-6 * max(abs(low), abs(high)))
    return " to ".join(f"{0.0 if abs(end) <= zero else end:.3g}" for end in (low, high))


def _drawn(axes: Axes) -> Iterator[str]:
    """How many lines and areas there are, and how far the first dozen lines reach; no keys."""
    lines = [line for line in axes.lines if np.size(line.get_xdata())]
    areas = len(axes.collections) + len(axes.patches)
    if lines or areas:
        yield f"  {len(lines)} lines, {areas} areas"
    for line in lines[:MAX_LINES]:
        x, y = line.get_data()
        yield f"  {np.size(y)} points: {_ends(x)} | {_ends(y)}"


def figure_words(page: Figure) -> Iterator[str]:
    """Title, notes, keys, then each panel with what is drawn in it; a line each."""
    yield from (_one_line(text.get_text()) for text in page.texts if text.get_text())
    for legend in page.legends:
        yield "key: " + "; ".join(_one_line(text.get_text()) for text in legend.get_texts())
    for axes in page.axes:
        shown = [_one_line(text) for text in _of_axes(axes)]
        if any(shown):
            yield "panel: " + "; ".join(filter(None, shown))
            yield from _drawn(axes)


def all_words(pages: Mapping[str, Page]) -> Iterator[str]:
    """Words of named figures."""
    for name, page in pages.items():
        yield f"[{name}]"
        with use_style():
            yield from figure_words(draw_page(page))


def without_digits(text: str) -> str:
    """Words in which numbers that a solver found are left out."""
    return NUMBER.sub("#", text)


def cell_text(value: Value) -> str:
    """First line of a cell."""
    return value.text if isinstance(value, Cell) else str(value)


def _cell_words(cell: Value) -> str:
    if not isinstance(cell, Cell):
        return cell_text(cell)
    return " ".join(filter(None, (cell.text, cell.mark, cell.subtext and f"({cell.subtext})")))


def table_words(table: Table) -> Iterator[str]:
    """Caption, heads, rows and notes of a table; a line each."""
    yield f"[{table.title}]"
    yield " | ".join(table.headings)
    yield from (" | ".join(map(_cell_words, row)) for row in table.rows)
    yield from (f"note: {note}" for note in table.notes)
