"""Draw pages of plots with matplotlib in the style of labpipe, and write their files."""

from __future__ import annotations

import base64
import math
import textwrap
import tomllib
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from labpipe.errors import StoreError
from labpipe.report.plot_records import Axis, Label, Line, Page, Plot, split_at_gaps
from labpipe.report.wording import replace_unprintable, shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis as DrawnAxis
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import LayoutEngine

T = TypeVar("T")

GREY = "#666666"
"""Colour of titles, footnotes and reasons."""
N_COLOURS = 8
"""Number of colours for spools, groups and wires."""
_MM_PER_INCH, _POINTS_PER_INCH = 25.4, 72.0
_LEFT_EDGE = 0.012
"""Left edge of title, footnote and legend, as a fraction of the width of the page."""
DASHED = (0, (4, 1.6))
"""Dash of lines for unloading and for doubtful results."""
_DASHES: tuple[Any, ...] = (
    "-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (5, 1.5, 1.2, 1.5)), (0, (9, 2)),
    (0, (3, 1, 1, 1, 1, 1)),
)  # fmt: skip


def choose_dash(index: int) -> Any:
    """Choose the dash of a line by its index, from 0; the dashes repeat."""
    return _DASHES[index % len(_DASHES)]


def choose_line_look(index: int) -> dict[str, Any]:
    """Choose colour and dash of a line by its index, from 0; the first 16 lines all differ."""
    # the dashes are shifted by one whenever the colours repeat
    dash = choose_dash(index + index // N_COLOURS)
    return {"color": f"C{index % N_COLOURS}", "linestyle": dash}


def sample_colour_map(count: int, last_position: float = 0.85) -> list[str]:
    """Return equally spaced colours of the colour map viridis.

    Parameters
    ----------
    count : number of colours
    last_position : position of the last colour, as a fraction of the colour map
    """
    import matplotlib as mpl
    from matplotlib.colors import to_hex

    positions = last_position * np.linspace(0, 1, count)
    return [to_hex(mpl.colormaps["viridis"](position)) for position in positions]


@cache
def read_looks() -> dict[str, dict[str, Any]]:
    """Read the looks of lines, areas and marks from ``looks.toml``."""
    looks = tomllib.loads((files("labpipe.report") / "looks.toml").read_text(encoding="utf-8"))
    for look in looks.values():
        if isinstance(look.get("linestyle"), list):  # matplotlib reads dashes only from tuples
            offset, lengths = look["linestyle"]
            look["linestyle"] = (offset, tuple(lengths))
    return looks


def _read_settings(look: str) -> dict[str, Any]:
    """Read the settings of a look, or of a look and a colour number, such as ``curve c2``."""
    look_name, _, colour_class = look.partition(" ")
    settings = dict(read_looks()[look_name])
    settings.pop("group_label", None)
    if colour_class:
        colour_number = int(colour_class[1:])
        settings["color"] = f"C{colour_number}"
        if look_name in {"curve", "mean"}:
            settings["linestyle"] = choose_dash(colour_number)
    return settings if "facecolor" in settings else {"color": "black", **settings}


@contextmanager
def use_style(*, is_journal: bool = False) -> Iterator[None]:
    """Apply the style of labpipe inside a block; global settings are restored after it.

    Parameters
    ----------
    is_journal : whether letters have serifs and colours are those of journals

    Notes
    -----
    Matplotlib's warning about a character that is missing from all fonts is suppressed. The figure
    shows a box instead of the character; summary, page and workbook show the character.
    """
    import matplotlib as mpl
    from matplotlib.font_manager import fontManager

    settings: Any = mpl.rcParams
    folder = Path(__file__).parent
    journal_file = folder / "journal.mplstyle"
    with mpl.rc_context(fname=str(folder / "labpipe.mplstyle")), warnings.catch_warnings():
        if is_journal:
            settings.update(mpl.rc_params_from_file(journal_file, use_default_template=False))
        installed_fonts = set(fontManager.get_font_names())
        fonts = (font for family in settings["font.family"] for font in settings[f"font.{family}"])
        settings["font.family"] = [font for font in fonts if font in installed_fonts]
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from font", UserWarning)
        yield


def draw_page(page: Page) -> Figure:
    """Draw a page in the current style.

    Parameters
    ----------
    page : page of 1 to 12 plots

    Returns
    -------
    The figure, laid out for SVG. If several plots have a heading, their headings begin with the
    letters of the panels.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=(page.width / _MM_PER_INCH, page.height / _MM_PER_INCH))
    letters = "abcdefghijkl"[: len(page.plots)]
    columns = min(page.columns, len(letters))
    row_starts = range(0, len(letters), columns)
    layout_rows = [letters[start : start + columns].ljust(columns, ".") for start in row_starts]
    panels = figure.subplot_mosaic(
        page.layout or ";".join(layout_rows),
        sharex="x" in page.shared_axes, sharey="y" in page.shared_axes,
        width_ratios=page.widths or None, height_ratios=page.heights or None,
    )  # fmt: skip
    has_letters = sum(bool(plot.heading) for plot in page.plots) > 1
    for letter, plot in zip(letters, page.plots, strict=True):
        draw_plot(plot, panels[letter], page.colour_axis)
        prefix = f"({letter}) " if has_letters and plot.heading else ""
        panels[letter].set_title(prefix + plot.heading, loc="left", linespacing=1.25)
    if page.colour_axis is not None:
        right_panel = panels[letters[columns - 1]]
        colour_bar = figure.colorbar(_make_colour_mapping(page.colour_axis), ax=[right_panel])
        colour_bar.set_label(page.colour_axis.label)
        _set_ticks(colour_bar.ax.yaxis, page.colour_axis)
    for axes in panels.values() if page.shared_axes else ():
        axes.label_outer()
    figure.align_ylabels()
    layout = _add_texts(figure, page)
    FigureCanvasSVG(figure)  # texts are measured for SVG, so that a PNG has the same layout
    _fit_texts(figure)
    layout.execute(figure)
    for letter, plot in zip(letters, page.plots, strict=True):
        if plot.is_to_scale:
            panels[letter].set_aspect("equal", adjustable="datalim")
    if any(plot.is_to_scale for plot in page.plots):
        layout.execute(figure)  # with equal scales, the limits are extended to fill the panels
    return figure


def _fit_texts(figure: Figure) -> None:
    """Replace unprintable characters and shorten the lines of all texts."""
    max_line_length = 150  # characters
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        lines = replace_unprintable(text.get_text()).split("\n")
        fitted = "\n".join(shorten(line, max_line_length) for line in lines)
        if fitted != text.get_text():  # setting a text repeats its layout
            text.set_text(fitted)


def draw_plot(plot: Plot, axes: Axes, colour_axis: Axis | None = None) -> None:
    """Draw the lines of a plot, its axes and its labels, and add its legend entries.

    Parameters
    ----------
    plot : panel of a page
    axes : axes of matplotlib on which the plot is drawn
    colour_axis : axis of the values that the colours of lines represent; None without such lines
    """
    if plot.reason and not plot.lines:
        axes.set_axis_off()
        text = textwrap.fill(plot.reason, 60 if axes.get_position().width > 0.3 else 30)
        axes.annotate(text, (0.5, 0.5), xycoords="axes fraction", ha="center", va="center", c=GREY)
        return
    for axis_name, axis in (("x", plot.x), ("y", plot.y)):
        scale = "log" if axis.is_log else "linear"
        axes.set(**{f"{axis_name}label": axis.label, f"{axis_name}scale": scale})
    for line in plot.lines:
        _draw_line(line, plot, axes, colour_axis)
    for entry in plot.legend:
        settings = {**_read_settings(entry.look), "label": shorten(entry.label, 100)}
        (axes.fill if entry.look.startswith("band") else axes.plot)([], [], **settings)
    axes.autoscale_view()
    for axis, drawn_axis in ((plot.x, axes.xaxis), (plot.y, axes.yaxis)):
        low, high = (None if math.isnan(limit) else limit for limit in axis.ends)
        set_limits = axes.set_xlim if drawn_axis is axes.xaxis else axes.set_ylim
        set_limits(low, high, auto=True)  # equal axis scales may extend the limits
        _set_ticks(drawn_axis, axis)
    axes.spines[:].set_zorder(10)  # no area covers the frame
    if not plot.has_frame:
        axes.set_axis_off()
    for label in plot.labels:
        _draw_label(label, plot, axes)


def _draw_line(line: Line, plot: Plot, axes: Axes, colour_axis: Axis | None) -> None:
    """Draw a line or an area; one with infinite coordinates extends across the panel."""
    from matplotlib.collections import LineCollection, PolyCollection

    settings = {"label": "", **_read_settings(line.look), **line.settings}
    x, y = plot.x.scale.factor * line.x, plot.y.scale.factor * line.y
    is_full_width, is_full_height = (bool(np.isinf(values).any()) for values in (x, y))
    if line.values is not None and colour_axis is not None:
        points = np.column_stack([x, y])
        segments = np.stack([points[:-1], points[1:]], axis=1)
        settings.pop("color")  # it would replace the colours of the values
        coloured_line = LineCollection(list(segments), capstyle="round", **settings)
        mapping = _make_colour_mapping(colour_axis)
        coloured_line.set(cmap=mapping.cmap, norm=mapping.norm)
        values = np.minimum(line.values[:-1], line.values[1:])
        coloured_line.set_array(colour_axis.scale.factor * values)
        axes.add_collection(coloured_line)
    elif line.is_closed and is_full_height:
        axes.axvspan(x[0], x[1], **settings)
    elif line.is_closed:
        axes.add_collection(PolyCollection(split_at_gaps(x, y), **settings))
    elif is_full_width:
        axes.axhline(y[0], **settings)
    elif is_full_height:
        axes.axvline(x[0], **settings)
    else:
        axes.plot(x, y, **settings)


def _make_colour_mapping(axis: Axis) -> Any:
    """Make the mapping of values to colours; values below the low end of the axis are red."""
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    colour_map = mpl.colormaps["viridis"].with_extremes(under="#d62728")
    return ScalarMappable(LogNorm(*axis.ends), colour_map)


def _draw_label(label: Label, plot: Plot, axes: Axes) -> None:
    """Draw a label; an infinite coordinate is the lower or the upper end of the axis."""
    coordinates = [(label.x, plot.x.scale.factor), (label.y, plot.y.scale.factor)]
    x, y = (
        float(value > 0) if math.isinf(value) else factor * value for value, factor in coordinates
    )
    frames = ["axes fraction" if math.isinf(value) else "data" for value, _ in coordinates]
    settings = {"va": "center", "zorder": 6, "annotation_clip": False, **label.settings}
    text, (x_frame, y_frame) = label.text, frames
    axes.annotate(text, (x, y), label.offset, (x_frame, y_frame), "offset points", **settings)


def _set_ticks(drawn_axis: DrawnAxis, axis: Axis) -> None:
    """Set the ticks of an axis: the names of its rows, or round numbers."""
    max_steps = 4 if axis.is_log else 7  # logarithmic steps are narrow at the high end
    # largest ratios of the ends of a logarithmic axis for linear ticks, and for ticks at 1, 2 and 5
    max_linear_ratio, max_dense_ratio = 6.0, 500.0
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator

    low, high = drawn_axis.get_view_interval()
    if axis.row_names:
        names = [shorten(name, 40) for name in axis.row_names]
        drawn_axis.set_ticks(range(0, -len(names), -1), names)
        drawn_axis.set_tick_params(length=0)
    elif not axis.is_log:
        drawn_axis.set_major_locator(MaxNLocator(max_steps, steps=[1, 2, 2.5, 5, 10]))
    else:
        drawn_axis.set_major_formatter("{x:g}")
        drawn_axis.set_minor_formatter(NullFormatter())
        if high < max_linear_ratio * low:
            drawn_axis.set_major_locator(MaxNLocator(max_steps))
            drawn_axis.set_minor_locator(NullLocator())
        else:
            steps = (1.0, 2.0, 5.0) if high < max_dense_ratio * low else (1.0,)
            drawn_axis.set_major_locator(LogLocator(subs=steps))


def _add_texts(figure: Figure, page: Page) -> LayoutEngine:
    """Add title, footnote and a legend of all labelled artists.

    The figure becomes higher by the heights of the footnote and the legend.

    Returns
    -------
    The layout of the panels between title, legend and footnote. It is not set as the layout of the
    figure, because matplotlib would then draw the figure twice whenever it is saved.
    """
    import matplotlib as mpl
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    size: float = mpl.rcParams["font.size"]
    line_mm, legend_line_mm = 0.52 * size, 0.6 * size
    characters_per_mm = 0.72  # in a line of the footnote
    artists: dict[str, Any] = {}
    for axes in figure.axes:
        for artist, label in zip(*axes.get_legend_handles_labels(), strict=True):
            artists.setdefault(label, artist)
    n_columns = page.legend_columns or _count_legend_columns(list(artists), page.width - 2.0)
    n_rows = math.ceil(len(artists) / n_columns)
    max_length = int(characters_per_mm * page.width)
    notes = [line for text in page.note.split("\n") for line in textwrap.wrap(text, max_length)]
    height = page.height + legend_line_mm * n_rows + line_mm * len(notes)
    figure.set_size_inches(page.width / _MM_PER_INCH, height / _MM_PER_INCH)
    line_height = line_mm / height
    figure.text(_LEFT_EDGE, 1 - 0.3 * line_height, page.title, va="top", color=GREY)
    if notes:
        figure.text(_LEFT_EDGE, 0.3 * line_height, "\n".join(notes), va="bottom", color=GREY)
    if artists:
        figure.legend(
            list(artists.values()), list(artists), loc="upper left", ncols=n_columns, borderpad=0,
            borderaxespad=0, bbox_to_anchor=(_LEFT_EDGE, 1 - 1.25 * line_height),
        )  # fmt: skip
    bottom = line_height * (0.4 + len(notes)) if notes else 0.0
    top = 1 - 1.3 * line_height - n_rows * legend_line_mm / height
    pad = 1.2 / _MM_PER_INCH
    rect = (0.0, bottom, 1.0, top - bottom)
    return ConstrainedLayoutEngine(rect=rect, w_pad=pad, h_pad=pad)


def _count_legend_columns(labels: Sequence[str], width_mm: float) -> int:
    """Count the columns of a legend that fit into a width, mm."""
    handle_mm = 11.8  # width of the line before the text of an entry, and of the gaps beside it
    import matplotlib as mpl
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=mpl.rcParams["legend.fontsize"])
    text_sizes = (text_to_path.get_text_width_height_descent(text, font, False) for text in labels)
    widths_mm = [handle_mm + width / _POINTS_PER_INCH * _MM_PER_INCH for width, *_ in text_sizes]
    if sum(widths_mm) <= width_mm:
        return max(len(widths_mm), 1)
    max_columns = max(int(width_mm / max(widths_mm)), 1)
    n_rows = math.ceil(len(widths_mm) / max_columns)
    return math.ceil(len(widths_mm) / n_rows)


def draw_for_notebook(page: Page) -> Figure:
    """Draw a page for a notebook in the current style, which the notebook does not change.

    Parameters
    ----------
    page : page of 1 to 12 plots

    Returns
    -------
    The figure. It names only installed fonts and provides an image for notebooks.
    """
    figure = draw_page(page)
    figure.set_dpi(120)
    vars(figure)["_repr_png_"] = partial(_encode_png, figure)
    return figure


def _encode_png(figure: Figure) -> bytes:
    """Encode a figure as PNG in the style of labpipe."""
    image = BytesIO()
    with use_style():
        figure.savefig(image, format="png", dpi="figure")
    return image.getvalue()


def split_pages(items: Sequence[T], max_items: int) -> list[Sequence[T]]:
    """Split items into runs of at most `max_items`, one run per page."""
    return [items[start : start + max_items] for start in range(0, len(items), max_items)]


FORMATS = ("svg", "png", "pdf")
"""Formats of the figures of a report; SVG is written with each of the others."""


def save_pages(
    pages: Iterable[Page],
    folder: Path,
    *,
    say: Callable[[str], None] = lambda _: None,
    run: str = "",
    png: bool = False,
    pdf: bool = False,
    dpi: int = 300,
    is_journal: bool = False,
) -> list[Path]:
    """Draw figures in the style of labpipe and write each as SVG, and on request as PNG or PDF.

    Parameters
    ----------
    pages : figures; each is drawn and released before the next
    folder : folder of the files; it is created if it does not exist
    say : function that is called with the name of each figure before it is drawn
    run : key of the run that made the results, which is written to SVG and PNG; may be empty
    png, pdf : whether each figure is also written as PNG or PDF; the SVG does not depend on them
    dpi : dots per inch of the PNG
    is_journal : whether letters have serifs and colours are those of journals

    Returns
    -------
    Paths of the files in the order of the figures; for each figure SVG, then PNG, then PDF.

    Raises
    ------
    StoreError
        If a file cannot be written.

    Notes
    -----
    The same figure gives the same bytes with the same version of matplotlib.
    """
    with convert_write_errors(folder, "figures"), use_style(is_journal=is_journal):
        folder.mkdir(parents=True, exist_ok=True)
        files = []
        for page in pages:
            say(page.name)
            files += _save_page(page, folder, run=run, dpi=dpi if png else None, is_pdf=pdf)
        return files


@contextmanager
def convert_write_errors(path: Path, noun: str) -> Iterator[None]:
    """Convert errors of writing inside a block to a `StoreError` with the file and a remedy.

    Parameters
    ----------
    path : path of the file or folder that the block writes
    noun : name of the content in the message of the error, such as ``figures``

    Raises
    ------
    StoreError
        Instead of an `OSError`.
    """
    try:
        yield
    except OSError as error:
        raise StoreError.about("report.cannot_write", path, "", what=noun, error=error) from error


def _save_page(page: Page, folder: Path, *, run: str, dpi: int | None, is_pdf: bool) -> list[Path]:
    """Draw a page in the current style, write it in each format and return the paths."""
    figure = draw_page(page)
    title, description = replace_unprintable(page.alt), replace_unprintable(page.caption)
    texts = {"Title": title, "Description": description, "Identifier": run}
    svg_metadata = {"Date": None, **{name: text for name, text in texts.items() if text}}
    settings_by_format: dict[str, dict[str, Any]] = {"svg": {"metadata": svg_metadata}}
    if dpi is not None:
        settings_by_format["png"] = {"dpi": dpi, "pil_kwargs": {"compress_level": 3}}
        settings_by_format["png"]["metadata"] = {"Software": None, "run": run or None}
    if is_pdf:
        pdf_metadata = {"CreationDate": None, "Title": title, "Subject": description}
        settings_by_format["pdf"] = {"metadata": pdf_metadata}
    paths = [folder / f"{page.name}.{extension}" for extension in settings_by_format]
    for path, settings in zip(paths, settings_by_format.values(), strict=True):
        figure.savefig(path, **settings)
    return paths


def encode_figure(page: Page) -> str:
    """Draw a page in the current style and encode it as a ``data:`` address for an HTML page.

    Parameters
    ----------
    page : page of a test

    Returns
    -------
    Address with an SVG. Its characters are drawn as outlines, so that it looks the same in every
    browser.
    """
    image = BytesIO()
    draw_page(page).savefig(image, format="svg", metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(image.getvalue()).decode()}"
