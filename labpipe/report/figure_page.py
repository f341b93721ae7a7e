"""The page a figure is drawn on: size, style, words, key, looks, the sentence of an empty one."""

from __future__ import annotations

import gc
import math
import textwrap
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from labpipe.records.result import TestResult
from labpipe.report.wording import footnote, printable, shortened, title

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.text import Text


T = TypeVar("T")

STYLE_FILE = Path(__file__).with_name("labpipe.mplstyle")
DOUBLE_COLUMN = 180.0
WIDTH = 120.0
"""mm; 9 pt on it is still 6.7 pt in a column of 90 mm."""
GREY = "#666666"
_MM_PER_INCH, _POINTS_PER_INCH = 25.4, 72.0
_LINE_MM = 4.2
_EDGE = 0.012
_LONGEST_TICK, _LONGEST_LINE = 40, 150
"""Characters of a word at an axis, and of a line anywhere on a page."""
_DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (5, 1.5, 1.2, 1.5)))
_FEW_DECADES = 500.0
_ROOM_FOR_INTERVALS = 1.5
"""Beside the values of an axis, as a share of their range."""
_NOTE_CHARACTERS = 0.7
"""Characters of a footnote for each mm of the page's width."""
_KEY_HANDLE = 11.8
"""mm of a key's line with the gaps around it."""


class PageTexts(NamedTuple):
    """Title, footnote and key of a page.

    Parameters
    ----------
    title : one line
    note : footnote, broken into lines by the page
    keys : signs to explain
    """

    title: str
    note: str = ""
    keys: Sequence[Artist] = ()


class Look(NamedTuple):
    """Colour and dash of what lines belong to: a spool, a wire, a length, a group."""

    colour: str
    dash: Any


@contextmanager
def style(changes: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Draw and save inside this block in labpipe's style; nothing global stays changed.

    Parameters
    ----------
    changes : settings of matplotlib on top of the style

    Notes
    -----
    Matplotlib's warning of a letter that no font here has is not passed on: the figure shows a box
    in its place, and the name stands whole in the summary, the page and the workbook.
    """
    _load_matplotlib()
    import matplotlib as mpl

    own: Any = dict(changes or {})
    with mpl.rc_context(own, fname=str(STYLE_FILE)), warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from font", UserWarning)
        yield


@cache
def _load_matplotlib() -> None:
    """Import what draws; its modules last, so that the collector is to pass them by."""
    was_enabled = gc.isenabled()
    gc.disable()
    import matplotlib.backends.backend_svg
    import matplotlib.figure  # noqa: F401

    gc.freeze()
    if was_enabled:
        gc.enable()


def new_page(
    result: TestResult, *, width_mm: float, height_mm: float, has_key: bool = False
) -> Figure:
    """Make an empty figure with title and footnote.

    Parameters
    ----------
    result : names the test, its specimen and protocol; its doubtful results go to the footnote
    width_mm, height_mm : mm on paper
    has_key : keep a line free below the title, for `put_key`

    Returns
    -------
    A figure without axes, laid out when it is drawn.
    """
    note = footnote(result)
    rows = 1 if has_key else 0
    return titled_page(title(result), note, width_mm=width_mm, height_mm=height_mm, key_rows=rows)


def titled_page(
    words: str, note: str, *, width_mm: float, height_mm: float, key_rows: int = 0
) -> Figure:
    """Make an empty figure with any title and footnote.

    Parameters
    ----------
    words, note : title of one line, and footnote of as many as it has; an empty one takes no room
    width_mm, height_mm : mm on paper
    key_rows : lines kept free below the title, for `put_key`

    Returns
    -------
    A figure without axes, laid out when it is drawn.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_mm / _MM_PER_INCH, height_mm / _MM_PER_INCH))
    line = _LINE_MM / height_mm
    figure.text(_EDGE, 1 - 0.3 * line, words, va="top", color=GREY)
    if note:
        figure.text(_EDGE, 0.3 * line, note, va="bottom", color=GREY)
    low = line * (0.4 + 0.9 * (note.count("\n") + 1)) if note else 0.0
    high = 1 - (1.3 + 1.1 * key_rows) * line
    pad = 1.2 / _MM_PER_INCH
    figure.set_layout_engine("constrained", rect=(0.0, low, 1.0, high - low), w_pad=pad, h_pad=pad)
    return figure


def keyed_page(
    words: PageTexts, *, height_mm: float, width_mm: float = WIDTH, columns: int = 0
) -> Figure:
    """Make an empty page with its key below the title.

    Parameters
    ----------
    words : what is around the panels
    height_mm : mm, without the lines of the key and of the footnote
    width_mm : mm on paper
    columns : of the key; as many as have room if 0
    """
    labels = [str(key.get_label()) for key in words.keys]
    columns = columns or _columns(list(map(_width_mm, labels)), width_mm - 2.0)
    rows = math.ceil(len(words.keys) / columns)
    lines = textwrap.wrap(words.note, int(_NOTE_CHARACTERS * width_mm))
    page = titled_page(
        words.title,
        "\n".join(lines),
        width_mm=width_mm,
        height_mm=height_mm + 4.6 * rows + 3.8 * len(lines),
        key_rows=rows,
    )
    if words.keys:
        put_key(page, words.keys, columns=columns)
    return page


def _width_mm(words: str) -> float:
    """Width of words of a key on paper, mm."""
    import matplotlib as mpl
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=mpl.rcParams["legend.fontsize"])
    points, *_ = text_to_path.get_text_width_height_descent(words, font, ismath=False)
    return points / _POINTS_PER_INCH * _MM_PER_INCH


def _columns(lengths: Sequence[float], room: float) -> int:
    """Columns of a key: one line if all fits, else as many as the longest words allow."""
    widths = [_KEY_HANDLE + length for length in lengths]
    if sum(widths) <= room:
        return max(len(widths), 1)
    most = max(int(room / max(widths)), 1)
    return math.ceil(len(widths) / math.ceil(len(widths) / most))


def finish_layout(page: Figure) -> None:
    """Give every panel its place now, for good; words are made such that they fit and show.

    Parameters
    ----------
    page : its words are measured as an SVG has them, so that its places do not depend on whether
        it is drawn in pixels too
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    FigureCanvasSVG(page)
    _fit_words(page)
    engine = page.get_layout_engine()
    if engine is not None:
        engine.execute(page)
    page.set_layout_engine("none")


_NOTEBOOK_DPI = 120


def with_own_fonts(page: Figure) -> Figure:
    """Give a page, inside the present style, what it needs to look the same outside of it.

    Parameters
    ----------
    page : laid out

    Returns
    -------
    The same page: its words name their fonts, and a notebook can show it.
    """
    import matplotlib as mpl
    from matplotlib.font_manager import fontManager
    from matplotlib.text import Text

    wanted = [*mpl.rcParams["font.serif"], *mpl.rcParams["font.sans-serif"]]
    installed = {font.name for font in fontManager.ttflist}
    fonts = [font for font in wanted if font in installed]
    for text in page.findobj(Text):
        text.set_fontfamily(fonts)
    page.set_dpi(_NOTEBOOK_DPI)
    vars(page)["_repr_png_"] = partial(_as_png, page)
    return page


def _as_png(page: Figure) -> bytes:
    image = BytesIO()
    with style():
        page.savefig(image, format="png", dpi="figure")
    return image.getvalue()


def _fit_words(page: Figure) -> None:
    """Leave panels room beside their words; report page and workbook have the whole names."""
    from matplotlib.ticker import FixedLocator

    for axis in _axes_lines(page):
        if isinstance(axis.get_major_locator(), FixedLocator):
            words = [label.get_text() for label in axis.get_ticklabels()]
            fitting = [_fitting(word, _LONGEST_TICK) for word in words]
            if fitting != words:
                axis.set_ticks(axis.get_majorticklocs(), fitting)
    for text in _texts(page):
        fitted = _fitting(text.get_text(), _LONGEST_LINE)
        if fitted != text.get_text():  # else it would be laid out anew
            text.set_text(fitted)


def _fitting(text: str, most: int) -> str:
    return "\n".join(shortened(line, most) for line in printable(text).split("\n"))


def _axes_lines(page: Figure) -> Iterator[Axis]:
    for axes in page.axes:
        yield from (axes.xaxis, axes.yaxis)


def _texts(page: Figure) -> Iterator[Text]:
    """All texts but those of ticks, which are made when they are asked for."""
    from matplotlib.legend import Legend
    from matplotlib.text import Text

    yield from (axis.label for axis in _axes_lines(page))
    for holder in (page, *page.axes):
        for child in holder.get_children():
            if isinstance(child, Text):
                yield child
            elif isinstance(child, Legend):
                yield from child.get_texts()


def put_key(page: Figure, handles: Sequence[Artist], *, columns: int | None = None) -> None:
    """Name lines and signs in the lines below the title, where no data can be.

    Parameters
    ----------
    page : made with room for the lines
    handles : what to name
    columns : how many stand in a line; all of them if None
    """
    line = _LINE_MM / (page.get_figheight() * _MM_PER_INCH)
    page.legend(
        handles=list(handles),
        loc="upper left",
        bbox_to_anchor=(_EDGE, 1 - 1.25 * line),
        ncols=columns or max(len(handles), 1),
        borderpad=0,
        borderaxespad=0,
    )


def line_key(words: str, **look: Any) -> Artist:
    """Sample of a line or a sign, with what it is called, for a key."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=words, **look)


def area_key(words: str, **look: Any) -> Artist:
    """Sample of an area, with what it is called, for a key."""
    from matplotlib.patches import Patch

    return Patch(label=words, **look)


def side_key(axes: Axes, handles: Sequence[Artist]) -> None:
    """Name what a panel shows on top of its right end, above the data."""
    axes.legend(
        handles=list(handles),
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=max(len(handles), 1),
        borderpad=0,
        borderaxespad=0.3,
    )


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


def number_log(axis: Axis) -> None:
    """Write plain numbers at 1, 2 and 5 of each decade where there are few decades, else at 1.

    Parameters
    ----------
    axis : a logarithmic one, with its limits set
    """
    from matplotlib.ticker import LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    steps = (1.0, 2.0, 5.0) if high < _FEW_DECADES * low else (1.0,)
    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def style_colours() -> list[str]:
    """Colours of the style, in their order."""
    import matplotlib as mpl

    own: list[str] = mpl.rcParams["axes.prop_cycle"].by_key()["color"]
    return own


def line_looks(count: int) -> list[Look]:
    """Give each of several lines a colour and a dash of its own, to be told apart in grey too."""
    own = style_colours()
    return [
        # the dash moves on where the colours begin anew, so that no pair comes twice
        Look(own[number % len(own)], dash_of(number + number // len(own)))
        for number in range(count)
    ]


_WINDOW: dict[str, Any] = {
    "linewidth": 4.0, "alpha": 0.4, "solid_capstyle": "butt", "zorder": 2
}  # fmt: skip
_SEGMENT: dict[str, Any] = {
    "color": "black", "linewidth": 0.8, "linestyle": (0, (1, 1.6)), "zorder": 4
}  # fmt: skip


def line_looks_of_fits(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Broad and pale for lines over set windows, thin and dotted upon them for fitted segments.

    Parameters
    ----------
    names : of the results that were read from the lines; one may come several times
    """
    own = style_colours()[1:]  # the first is that of curves
    known = dict.fromkeys(names)
    windows = [name for name in known if not name.startswith("segment")]
    looks: dict[str, dict[str, Any]] = dict.fromkeys(known, _SEGMENT)
    return looks | {
        name: {**_WINDOW, "color": own[number % len(own)]} for number, name in enumerate(windows)
    }


def dash_of(number: int) -> Any:
    """Dash of a line by its number, from 0; they begin anew after four."""
    return _DASHES[number % len(_DASHES)]


def panel_grid(page: Figure, count: int, *, columns: int, sharey: bool = False) -> list[Axes]:
    """Make panels row by row; places that are left over stay empty.

    Parameters
    ----------
    page : they are put on
    count : of panels, at least one
    columns : side by side at the most
    sharey : all have one height axis
    """
    columns = min(columns, count)
    rows = math.ceil(count / columns)
    panels = page.subplots(rows, columns, squeeze=False, sharey=sharey).ravel()
    for spare in panels[count:]:
        spare.set_axis_off()
    return list(panels[:count])


def in_pages(items: Sequence[T], most: int) -> list[Sequence[T]]:
    """Share things out to pages of so many."""
    return [items[start : start + most] for start in range(0, len(items), most)]


def require_room(count: int, most: int, what: str) -> None:
    """Refuse a page of nothing, and one of more than it has room for.

    Raises
    ------
    ValueError
        With the number and what is allowed.
    """
    if not 1 <= count <= most:
        message = f"{count} {what}: allowed are 1 to {most} on a page"
        raise ValueError(message)


def keep_in_view(values: Sequence[float], axes: Axes, least: float = 0.0) -> None:
    """Let the axis cut intervals that would press the values into one place.

    Parameters
    ----------
    values : in the unit of the axis; NaN for none
    axes : with all that is drawn
    least : that stays in view, in the unit of the axis
    """
    known = [value for value in values if not math.isnan(value)]
    low, high = min(known), max(known)
    room = max(_ROOM_FOR_INTERVALS * (high - low), 0.55 * (least - (high - low)))
    if room > 0.0:
        now = axes.get_xlim()
        axes.set_xlim(max(now[0], low - room), min(now[1], high + room))
