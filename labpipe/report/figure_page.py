"""Page of a figure: size, style, texts, key, looks of lines, sentence of an empty panel."""

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

import numpy as np

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
"""Height of a line of text."""
_EDGE = 0.012
"""Left edge of texts, of the width of the page."""
_DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (5, 1.5, 1.2, 1.5)))


class PageTexts(NamedTuple):
    """Title, footnote and key of a page.

    Parameters
    ----------
    title : one line
    note : footnote, broken into lines by the page
    keys : lines and signs to explain
    """

    title: str
    note: str = ""
    keys: Sequence[Artist] = ()


class Look(NamedTuple):
    """Colour and dash of the lines of a spool, a wire, a length or a group."""

    colour: str
    dash: Any


@contextmanager
def style(changes: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Draw and save in labpipe's style inside this block, without global changes.

    Parameters
    ----------
    changes : settings of matplotlib on top of the style

    Notes
    -----
    Matplotlib's warning about a glyph missing from all fonts is suppressed: the figure shows a box,
    and summary, page and workbook have the full name.
    """
    _load_matplotlib()
    import matplotlib as mpl

    settings: Any = dict(changes or {})
    with mpl.rc_context(settings, fname=str(STYLE_FILE)), warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from font", UserWarning)
        yield


@cache
def _load_matplotlib() -> None:
    """Import matplotlib and exclude its modules from garbage collection."""
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
    result : gives test, specimen and protocol for the title, doubtful results for the footnote
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
    heading: str, note: str, *, width_mm: float, height_mm: float, key_rows: int = 0
) -> Figure:
    """Make an empty figure with any title and footnote.

    Parameters
    ----------
    heading, note : title of one line; footnote of any number of lines, may be empty
    width_mm, height_mm : mm on paper
    key_rows : lines kept free below the title, for `put_key`

    Returns
    -------
    A figure without axes, laid out when it is drawn.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_mm / _MM_PER_INCH, height_mm / _MM_PER_INCH))
    line = _LINE_MM / height_mm
    figure.text(_EDGE, 1 - 0.3 * line, heading, va="top", color=GREY)
    if note:
        figure.text(_EDGE, 0.3 * line, note, va="bottom", color=GREY)
    low = line * (0.4 + 0.9 * (note.count("\n") + 1)) if note else 0.0
    high = 1 - (1.3 + 1.1 * key_rows) * line
    pad = 1.2 / _MM_PER_INCH
    figure.set_layout_engine("constrained", rect=(0.0, low, 1.0, high - low), w_pad=pad, h_pad=pad)
    return figure


def keyed_page(
    texts: PageTexts, *, height_mm: float, width_mm: float = WIDTH, columns: int = 0
) -> Figure:
    """Make an empty page with its key below the title.

    Parameters
    ----------
    texts : title, note and key
    height_mm : mm, without the lines of the key and of the footnote
    width_mm : mm on paper
    columns : of the key; as many as fit if 0
    """
    characters_per_mm = 0.7  # of the width of the page, in a footnote
    labels = [str(key.get_label()) for key in texts.keys]
    columns = columns or _key_columns(list(map(_width_mm, labels)), width_mm - 2.0)
    rows = math.ceil(len(texts.keys) / columns)
    lines = textwrap.wrap(texts.note, int(characters_per_mm * width_mm))
    page = titled_page(
        texts.title,
        "\n".join(lines),
        width_mm=width_mm,
        height_mm=height_mm + 4.6 * rows + 3.8 * len(lines),
        key_rows=rows,
    )
    if texts.keys:
        put_key(page, texts.keys, columns=columns)
    return page


def _width_mm(text: str) -> float:
    """Return the width of a text of a key on paper, mm."""
    import matplotlib as mpl
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=mpl.rcParams["legend.fontsize"])
    points, *_ = text_to_path.get_text_width_height_descent(text, font, ismath=False)
    return points / _POINTS_PER_INCH * _MM_PER_INCH


def _key_columns(lengths: Sequence[float], room: float) -> int:
    """Return the columns of a key: one line if all fits, else as the longest label allows."""
    handle_mm = 11.8  # sample of a line with its gaps
    widths = [handle_mm + length for length in lengths]
    if sum(widths) <= room:
        return max(len(widths), 1)
    max_columns = max(int(room / max(widths)), 1)
    return math.ceil(len(widths) / math.ceil(len(widths) / max_columns))


def finish_layout(page: Figure) -> None:
    """Lay out a page permanently, with shortened and printable texts.

    Parameters
    ----------
    page : its texts are measured as in SVG, so that the layout is the same for pixels
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    FigureCanvasSVG(page)
    _fit_texts(page)
    engine = page.get_layout_engine()
    if engine is not None:
        engine.execute(page)
    page.set_layout_engine("none")


def with_own_fonts(page: Figure) -> Figure:
    """Fix the fonts of a page so that it looks the same outside the current style.

    Parameters
    ----------
    page : laid out

    Returns
    -------
    The same page, with named fonts, and an image for notebooks.
    """
    import matplotlib as mpl
    from matplotlib.font_manager import fontManager
    from matplotlib.text import Text

    wanted = [*mpl.rcParams["font.serif"], *mpl.rcParams["font.sans-serif"]]
    installed = {font.name for font in fontManager.ttflist}
    fonts = [font for font in wanted if font in installed]
    for text in page.findobj(Text):
        text.set_fontfamily(fonts)
    page.set_dpi(120)
    vars(page)["_repr_png_"] = partial(_as_png, page)
    return page


def _as_png(page: Figure) -> bytes:
    image = BytesIO()
    with style():
        page.savefig(image, format="png", dpi="figure")
    return image.getvalue()


def _fit_texts(page: Figure) -> None:
    """Shorten long texts to leave room for panels; page and workbook have the full names."""
    max_tick_length, max_line_length = 40, 150
    from matplotlib.ticker import FixedLocator

    for axis in _axis_objects(page):
        if isinstance(axis.get_major_locator(), FixedLocator):
            labels = [label.get_text() for label in axis.get_ticklabels()]
            fitting = [_shorten_lines(word, max_tick_length) for word in labels]
            if fitting != labels:
                axis.set_ticks(axis.get_majorticklocs(), fitting)
    for text in _texts(page):
        fitted = _shorten_lines(text.get_text(), max_line_length)
        if fitted != text.get_text():  # setting a text repeats its layout
            text.set_text(fitted)


def _shorten_lines(text: str, max_length: int) -> str:
    return "\n".join(shortened(line, max_length) for line in printable(text).split("\n"))


def _axis_objects(page: Figure) -> Iterator[Axis]:
    for axes in page.axes:
        yield from (axes.xaxis, axes.yaxis)


def _texts(page: Figure) -> Iterator[Text]:
    """Yield all texts but those of ticks, which are made on demand."""
    from matplotlib.legend import Legend
    from matplotlib.text import Text

    yield from (axis.label for axis in _axis_objects(page))
    for holder in (page, *page.axes):
        for child in holder.get_children():
            if isinstance(child, Text):
                yield child
            elif isinstance(child, Legend):
                yield from child.get_texts()


def put_key(page: Figure, handles: Sequence[Artist], *, columns: int | None = None) -> None:
    """Draw the key of lines and signs below the title, outside the panels.

    Parameters
    ----------
    page : made with room for the lines
    handles : lines and signs
    columns : entries per line; all of them if None
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


def line_key(label: str, **look: Any) -> Artist:
    """Return an entry of a key: a line or a sign with its label."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **look)


def area_key(label: str, **look: Any) -> Artist:
    """Return an entry of a key: an area with its label."""
    from matplotlib.patches import Patch

    return Patch(label=label, **look)


def side_key(axes: Axes, handles: Sequence[Artist]) -> None:
    """Draw the key of a panel above its upper right corner."""
    axes.legend(
        handles=list(handles),
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=max(len(handles), 1),
        borderpad=0,
        borderaxespad=0.3,
    )


def panel_letter(axes: Axes, letter: str, heading: str) -> None:
    """Write ``(a) heading`` above the upper left corner of a panel."""
    axes.set_title(f"({letter}) {heading}", loc="left")


def write_reason(axes: Axes, sentence: str, line_length: int = 60) -> None:
    """Write into an empty panel why it is empty."""
    axes.set_axis_off()
    axes.text(
        0.5,
        0.5,
        textwrap.fill(sentence, line_length),
        transform=axes.transAxes,
        ha="center",
        va="center",
        color=GREY,
    )


def label_log_axis(axis: Axis) -> None:
    """Label a logarithmic axis with plain numbers: at 1, 2 and 5 for few decades, else at 1.

    Parameters
    ----------
    axis : logarithmic, with its limits set
    """
    few_decades_ratio = 500.0
    from matplotlib.ticker import LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    steps = (1.0, 2.0, 5.0) if high < few_decades_ratio * low else (1.0,)
    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def style_colours() -> list[str]:
    """Return the colours of the style."""
    import matplotlib as mpl

    colours: list[str] = mpl.rcParams["axes.prop_cycle"].by_key()["color"]
    return colours


def step_colours(count: int) -> list[str]:
    """Return colours of the style's colour map for steps in order."""
    import matplotlib as mpl
    from matplotlib.colors import to_hex

    colour_map = mpl.colormaps[mpl.rcParams["image.cmap"]]
    return [to_hex(colour_map(0.85 * place)) for place in np.linspace(0, 1, count)]


def line_looks(count: int) -> list[Look]:
    """Give each line a colour and a dash that also differ in grey."""
    colours = style_colours()
    return [
        # the dash changes where the colours repeat, so that each pair is unique
        Look(colours[number % len(colours)], dash_of(number + number // len(colours)))
        for number in range(count)
    ]


_WINDOW: dict[str, Any] = {
    "linewidth": 4.0, "alpha": 0.4, "solid_capstyle": "butt", "zorder": 2
}  # fmt: skip
_SEGMENT: dict[str, Any] = {
    "color": "black", "linewidth": 0.8, "linestyle": (0, (1, 1.6)), "zorder": 4
}  # fmt: skip


def line_looks_of_fits(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return styles of fitted lines: broad and pale over set windows, dotted for segments.

    Parameters
    ----------
    names : of the results of the lines, with repetitions
    """
    colours = style_colours()[1:]  # the first is that of curves
    names_once = dict.fromkeys(names)
    windows = [name for name in names_once if not name.startswith("segment")]
    looks: dict[str, dict[str, Any]] = dict.fromkeys(names_once, _SEGMENT)
    return looks | {
        name: {**_WINDOW, "color": colours[number % len(colours)]}
        for number, name in enumerate(windows)
    }


def dash_of(number: int) -> Any:
    """Return the dash of a line by its number, from 0; four dashes repeat."""
    return _DASHES[number % len(_DASHES)]


def panel_grid(page: Figure, count: int, *, columns: int, sharey: bool = False) -> list[Axes]:
    """Make panels row by row.

    Parameters
    ----------
    page : they are put on
    count : of panels, at least one
    columns : at most
    sharey : use one vertical axis for all
    """
    columns = min(columns, count)
    rows = math.ceil(count / columns)
    panels = page.subplots(rows, columns, squeeze=False, sharey=sharey).ravel()
    for spare in panels[count:]:
        spare.set_axis_off()
    return list(panels[:count])


def split_pages(items: Sequence[T], max_items: int) -> list[Sequence[T]]:
    """Split items into pages."""
    return [items[start : start + max_items] for start in range(0, len(items), max_items)]


def require_room(count: int, max_count: int, what: str) -> None:
    """Raise an error if a page is empty or overfull.

    Raises
    ------
    ValueError
        With the number and the allowed range.
    """
    if not 1 <= count <= max_count:
        message = f"{what}: expected 1 to {max_count} on a page, found {count}"
        raise ValueError(message)


def limit_to_values(values: Sequence[float], axes: Axes, least: float = 0.0) -> None:
    """Limit an axis so that wide intervals do not compress the values.

    Parameters
    ----------
    values : in the unit of the axis; NaN for none
    axes : with everything drawn
    least : width that stays in view, in the unit of the axis
    """
    max_interval_share = 1.5  # beside the values, of their range
    finite = [value for value in values if not math.isnan(value)]
    low, high = min(finite), max(finite)
    room = max(max_interval_share * (high - low), 0.55 * (least - (high - low)))
    if room > 0.0:
        now = axes.get_xlim()
        axes.set_xlim(max(now[0], low - room), min(now[1], high + room))
