"""The page a figure is drawn on: size, style, title, footnote, and the sentence of an empty one."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from labpipe.records.result import TestResult
from labpipe.report.wording import footnote, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLE_FILE = Path(__file__).with_name("labpipe.mplstyle")
SINGLE_COLUMN = 90.0
DOUBLE_COLUMN = 180.0
GREY = "#666666"
_MM_PER_INCH = 25.4


@contextmanager
def style() -> Iterator[None]:
    """Draw and save inside this block in labpipe's style; nothing global stays changed."""
    import matplotlib as mpl

    with mpl.rc_context(fname=str(STYLE_FILE)):
        yield


def new_page(result: TestResult, *, width_mm: float, height_mm: float) -> Figure:
    """Make an empty figure with title and footnote.

    Parameters
    ----------
    result : names the test, its specimen and protocol; its doubtful results go to the footnote
    width_mm, height_mm : mm on paper

    Returns
    -------
    A figure without axes, laid out when it is drawn.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_mm / _MM_PER_INCH, height_mm / _MM_PER_INCH))
    line = 4.2 / height_mm
    figure.text(0.012, 1 - 0.35 * line, title(result), va="top", size=8, color=GREY)
    note = footnote(result)
    if note:
        figure.text(0.012, 0.3 * line, note, va="bottom", size=7, color=GREY)
    low = line if note else 0.0
    pad = 1.2 / _MM_PER_INCH
    figure.set_layout_engine(
        "constrained", rect=(0.0, low, 1.0, 1 - 1.3 * line - low), w_pad=pad, h_pad=pad
    )
    return figure


def panel_letter(axes: Axes, letter: str, words: str) -> None:
    """Head a panel with ``(a) words`` at its upper left."""
    axes.set_title(f"({letter}) {words}", loc="left")


def say(axes: Axes, sentence: str) -> None:
    """Leave a panel empty but for a sentence that says why."""
    axes.set_axis_off()
    axes.text(
        0.5,
        0.5,
        textwrap.fill(sentence, 60),
        transform=axes.transAxes,
        ha="center",
        va="center",
        color=GREY,
    )
