"""Pages of figures: their style, size, title, key and footnote, and their files."""

from __future__ import annotations

import base64
import math
import textwrap
import tomllib
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from labpipe.errors import StoreError
from labpipe.report.wording import replace_unprintable, shorten, write_footnote, write_title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    from labpipe.records.result import TestResult


T = TypeVar("T")

_STYLE, _JOURNAL = (Path(__file__).with_name(f"{name}.mplstyle") for name in ("labpipe", "journal"))
DOUBLE_COLUMN = 180.0
WIDTH = 120.0
"""Width of a page, mm: 9 pt become 6.7 pt in a column of 90 mm."""
GREY = "#666666"
_MM_PER_INCH, _POINTS_PER_INCH = 25.4, 72.0
_EDGE = 0.012
"""Left edge of texts, as a share of the width of the page."""
DASHED = (0, (4, 1.6))
_DASHES: tuple[Any, ...] = (
    "-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (5, 1.5, 1.2, 1.5)), (0, (9, 2)),
    (0, (3, 1, 1, 1, 1, 1)),
)  # fmt: skip


class Look(NamedTuple):
    """Colour and dash of the lines of a spool, a wire, a length or a group."""

    color: str
    linestyle: Any


def read_look(name: str, **more: Any) -> dict[str, Any]:
    """Read the look of a line, an area or a mark.

    Parameters
    ----------
    name : in ``looks.toml``
    more : further settings of matplotlib; they replace those of the file

    Raises
    ------
    KeyError
        If the file has no such look.
    """
    return {**_read_looks()[name], **more}


@cache
def _read_looks() -> dict[str, dict[str, Any]]:
    looks = tomllib.loads((files("labpipe.report") / "looks.toml").read_text(encoding="utf-8"))
    for look in looks.values():
        if isinstance(look.get("linestyle"), list):  # matplotlib reads dashes from tuples alone
            offset, lengths = look["linestyle"]
            look["linestyle"] = (offset, tuple(lengths))
    return looks


@contextmanager
def style(changes: Mapping[str, Any] | None = None, *, is_journal: bool = False) -> Iterator[None]:
    """Draw and save in the style of labpipe inside this block, without global changes.

    Parameters
    ----------
    changes : settings of matplotlib on top of the style
    is_journal : serif letters and colours of journals, instead of the look of the page

    Notes
    -----
    Matplotlib's warning about a letter that is missing from all fonts is suppressed: the figure
    shows a box instead; summary, page and workbook have the letter.
    """
    import matplotlib as mpl

    settings: Any = dict(changes or {})
    with mpl.rc_context(fname=str(_STYLE)), warnings.catch_warnings():
        if is_journal:
            mpl.rcParams.update(mpl.rc_params_from_file(_JOURNAL, use_default_template=False))
        mpl.rcParams.update(settings)
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from font", UserWarning)
        yield


def make_page(*, height_mm: float, width_mm: float = WIDTH) -> Figure:
    """Make an empty figure.

    Parameters
    ----------
    height_mm, width_mm : size of the panels on paper, mm; `add_title` adds room for texts

    Returns
    -------
    A figure without axes.
    """
    from matplotlib.figure import Figure

    return Figure(figsize=(width_mm / _MM_PER_INCH, height_mm / _MM_PER_INCH))


def add_title(page: Figure, title: str, note: str = "", *, columns: int = 0) -> Figure:
    """Add the title, a footnote and a key of all labelled artists to a page.

    Parameters
    ----------
    page : with everything drawn
    title : one line
    note : footnote, broken into lines here; may be empty
    columns : of the key; 0 for as many as fit

    Returns
    -------
    The same page, higher by key and footnote. Several panels with a heading have letters; panels
    with a legend of their own are not in the key.
    """
    import matplotlib as mpl

    size: float = mpl.rcParams["font.size"]
    line_mm, key_line_mm = 0.52 * size, 0.6 * size
    characters_per_mm = 0.72  # of the width of the page, in a footnote
    width, height = (side * _MM_PER_INCH for side in page.get_size_inches().tolist())
    _letter_panels(page.axes)
    keys = _labelled_artists(page.axes)
    columns = columns or _key_columns(list(map(_width_mm, keys)), width - 2.0)
    rows = math.ceil(len(keys) / columns)
    letters = int(characters_per_mm * width)
    notes = [row for line in note.split("\n") for row in textwrap.wrap(line, letters)]
    height += key_line_mm * rows + line_mm * len(notes)
    page.set_size_inches(width / _MM_PER_INCH, height / _MM_PER_INCH)
    line = line_mm / height
    page.text(_EDGE, 1 - 0.3 * line, title, va="top", color=GREY)
    if notes:
        page.text(_EDGE, 0.3 * line, "\n".join(notes), va="bottom", color=GREY)
    if keys:
        page.legend(
            list(keys.values()), list(keys), loc="upper left", ncols=columns, borderpad=0,
            borderaxespad=0, bbox_to_anchor=(_EDGE, 1 - 1.25 * line),
        )  # fmt: skip
    low = line * (0.4 + len(notes)) if notes else 0.0
    high = 1 - 1.3 * line - rows * key_line_mm / height
    pad = 1.2 / _MM_PER_INCH
    page.set_layout_engine("constrained", rect=(0.0, low, 1.0, high - low), w_pad=pad, h_pad=pad)
    return page


def make_empty_page(title: str, reason: str, note: str = "", *, width_mm: float = WIDTH) -> Figure:
    """Make a page that gives the reason why it shows nothing."""
    page = make_page(height_mm=40.0, width_mm=width_mm)
    write_reason(page.subplots(), reason)
    return add_title(page, title, note)


def make_reason_page(result: TestResult, reason: str) -> Figure:
    """Make the page of a test that gives the reason why it shows nothing."""
    title, note = write_title(result), write_footnote(result)
    return make_empty_page(title, reason, note, width_mm=DOUBLE_COLUMN)


def _labelled_artists(panels: Iterable[Axes]) -> dict[str, Any]:
    """Return the first artist of each label, in the order of drawing."""
    keys: dict[str, Any] = {}
    for axes in panels:
        if axes.get_legend() is None:
            for artist, label in zip(*axes.get_legend_handles_labels(), strict=True):
                keys.setdefault(label, artist)
    return keys


def _letter_panels(panels: Iterable[Axes]) -> None:
    named = [axes for axes in panels if axes.get_title(loc="left")]
    for letter, axes in zip("abcdefghijkl", named if len(named) > 1 else (), strict=False):
        axes.set_title(f"({letter}) {axes.get_title(loc='left')}", loc="left")


def _width_mm(text: str) -> float:
    """Return the width of a label of the key on paper, mm."""
    import matplotlib as mpl
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=mpl.rcParams["legend.fontsize"])
    points, *_ = text_to_path.get_text_width_height_descent(text, font, ismath=False)
    return points / _POINTS_PER_INCH * _MM_PER_INCH


def _key_columns(lengths: Sequence[float], room: float) -> int:
    """Return the number of columns of a key that fit beside each other into a room, mm."""
    handle_mm = 11.8  # sample of a line with its gaps
    widths = [handle_mm + length for length in lengths]
    if sum(widths) <= room:
        return max(len(widths), 1)
    max_columns = max(int(room / max(widths)), 1)
    return math.ceil(len(widths) / math.ceil(len(widths) / max_columns))


def finish_layout(page: Figure) -> None:
    """Lay out a page and fix its layout; shorten its texts and replace unprintable characters.

    Parameters
    ----------
    page : drawn; its texts are measured for SVG, so that a PNG has the same layout
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    FigureCanvasSVG(page)
    _fit_texts(page)
    engine = page.get_layout_engine()
    if engine is not None:
        engine.execute(page)
    page.set_layout_engine("none")


def fix_fonts(page: Figure) -> Figure:
    """Fix the fonts of a page so that it looks the same outside the current style.

    Parameters
    ----------
    page : laid out

    Returns
    -------
    The same page, with the names of installed fonts, and an image for notebooks.
    """
    import matplotlib as mpl
    from matplotlib.font_manager import fontManager
    from matplotlib.text import Text

    installed = {font.name for font in fontManager.ttflist}
    settings: Any = mpl.rcParams
    families = settings["font.family"]
    preferred_fonts = [font for family in families for font in settings[f"font.{family}"]]
    fonts = [font for font in preferred_fonts if font in installed]
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
    """Shorten long texts, which would leave no room for panels, and make all printable."""
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
    return "\n".join(shorten(line, max_length) for line in replace_unprintable(text).split("\n"))


def _axis_objects(page: Figure) -> Iterator[Axis]:
    for axes in page.axes:
        yield from (axes.xaxis, axes.yaxis)


def _texts(page: Figure) -> Iterator[Text]:
    """Yield all texts except tick labels, which matplotlib makes on demand."""
    from matplotlib.legend import Legend
    from matplotlib.text import Text

    yield from (axis.label for axis in _axis_objects(page))
    for holder in (page, *page.axes):
        for child in holder.get_children():
            if isinstance(child, Text):
                yield child
            elif isinstance(child, Legend):
                yield from child.get_texts()


def write_reason(axes: Axes, sentence: str, line_length: int = 60) -> None:
    """Write into an empty panel the reason why it is empty."""
    axes.set_axis_off()
    text = textwrap.fill(sentence, line_length)
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=GREY)


def add_key(axes: Axes, label: str, *, is_area: bool = False, **look: Any) -> None:
    """Add an entry to the key without drawing anything."""
    draw: Any = axes.fill if is_area else axes.plot
    draw([], [], label=label, **look)


def label_log_axis(axis: Axis) -> None:
    """Label a logarithmic axis with plain numbers.

    Parameters
    ----------
    axis : logarithmic, with its limits set; up to a ratio of 500 it has ticks at 1, 2 and 5 of
        each decade, else at 1
    """
    few_decades_ratio = 500.0
    from matplotlib.ticker import LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    steps = (1.0, 2.0, 5.0) if high < few_decades_ratio * low else (1.0,)
    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def list_style_colours() -> list[str]:
    """List the colours of the current style."""
    import matplotlib as mpl

    colours: list[str] = mpl.rcParams["axes.prop_cycle"].by_key()["color"]
    return colours


def sample_colour_map(count: int, end: float = 0.85) -> list[str]:
    """Return equally spaced colours of the colour map of the current style.

    Parameters
    ----------
    count : number of colours
    end : place of the last one, as a share of the colour map
    """
    import matplotlib as mpl
    from matplotlib.colors import to_hex

    colour_map = mpl.colormaps[mpl.rcParams["image.cmap"]]
    return [to_hex(colour_map(end * place)) for place in np.linspace(0, 1, count)]


def choose_line_looks(count: int) -> list[Look]:
    """Choose a colour and a dash for each line; no two lines have the same pair."""
    colours = list_style_colours()
    return [
        # one more step of the dash whenever the colours repeat, so that no pair repeats
        Look(colours[number % len(colours)], choose_dash(number + number // len(colours)))
        for number in range(count)
    ]


def choose_dash(number: int) -> Any:
    """Return the dash of a line by its number, from 0; the dashes repeat."""
    return _DASHES[number % len(_DASHES)]


def make_panels(page: Figure, count: int, *, columns: int, sharey: bool = False) -> list[Axes]:
    """Make panels row by row.

    Parameters
    ----------
    page : empty
    count : of panels, at least one
    columns : largest number of panels in a row
    sharey : use one vertical axis for all
    """
    columns = min(columns, count)
    rows = math.ceil(count / columns)
    panels = page.subplots(rows, columns, squeeze=False, sharey=sharey).ravel()
    for spare in panels[count:]:
        spare.set_axis_off()
    return list(panels[:count])


def split_pages(items: Sequence[T], max_items: int) -> list[Sequence[T]]:
    """Split items into pages of at most `max_items`."""
    return [items[start : start + max_items] for start in range(0, len(items), max_items)]


def require_room(count: int, max_count: int, what: str) -> None:
    """Raise an error if a page would be empty or overfull.

    Raises
    ------
    ValueError
        If `count` is not from 1 to `max_count`.
    """
    if not 1 <= count <= max_count:
        message = f"{what}: expected 1 to {max_count} on a page, found {count}"
        raise ValueError(message)


FORMATS = ("svg", "png", "pdf")
"""Formats of the figures of a report; SVG is always written."""


class FigureToSave(NamedTuple):
    """A figure before it is drawn.

    Parameters
    ----------
    name : of its files, without the ending
    draw : returns the figure
    caption : how to read it; description in its files
    alt : alternative text; title in its files
    """

    name: str
    draw: Callable[[], Figure]
    caption: str = ""
    alt: str = ""


def save_pages(
    wanted: Iterable[FigureToSave],
    folder: Path,
    *,
    say: Callable[[str], None] = lambda _: None,
    run: str = "",
    png: bool = False,
    pdf: bool = False,
    dpi: int = 300,
    is_journal: bool = False,
) -> list[Path]:
    """Draw figures in the style of labpipe and write each as SVG, on request as PNG and PDF.

    Parameters
    ----------
    wanted : each figure is drawn and released before the next
    folder : made if it does not exist
    say : called with the name of each figure before it is drawn
    run : key of the run of the figures, written to SVG and PNG; may be empty
    png, pdf : write each as PNG or PDF, too; the SVG does not depend on it
    dpi : dots per inch of the PNG
    is_journal : serif letters and colours of journals, instead of the look of the page

    Returns
    -------
    The files, in the order of the figures: SVG, PNG, PDF of each.

    Raises
    ------
    StoreError
        If a file cannot be written.

    Notes
    -----
    The same figure gives the same bytes with the same version of matplotlib.
    """
    with writing(folder, "figures"), style(is_journal=is_journal):
        folder.mkdir(parents=True, exist_ok=True)
        files = []
        for figure in wanted:
            say(figure.name)
            files += save_page(figure, folder, run=run, dpi=dpi if png else None, is_pdf=pdf)
        return files


def list_pngs(wanted: Iterable[FigureToSave], folder: str) -> list[str]:
    """List the PNG files of figures in a folder, which an earlier run may have left.

    Parameters
    ----------
    wanted : figures, not drawn here
    folder : of the figures
    """
    return [f"{folder}/{figure.name}.png" for figure in wanted]


@contextmanager
def writing(path: Path, what: str) -> Iterator[None]:
    """Turn errors of writing inside this block into one that names the file and a remedy.

    Parameters
    ----------
    path : of the file or folder that the block writes
    what : noun of the message, such as ``figures``

    Raises
    ------
    StoreError
        Instead of an `OSError`.
    """
    try:
        yield
    except OSError as error:
        raise StoreError.about("report.cannot_write", path, "", what=what, error=error) from error


def save_page(
    wanted: FigureToSave, folder: Path, *, run: str, dpi: int | None, is_pdf: bool
) -> list[Path]:
    """Draw and lay out one figure in the current style and write it in each format.

    Parameters
    ----------
    wanted : figure with its caption and alternative text
    folder : exists
    run : key in the files (``dc:identifier`` of the SVG, text ``run`` of the PNG)
    dpi : of the PNG; None for no PNG
    is_pdf : write a PDF, too

    Returns
    -------
    The files: SVG, PNG, PDF.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    page = wanted.draw()
    finish_layout(page)
    svg, png, pdf = (folder / f"{wanted.name}.{ending}" for ending in FORMATS)
    title, description = replace_unprintable(wanted.alt), replace_unprintable(wanted.caption)
    texts = {"Title": title, "Description": description, "Identifier": run}
    metadata = {"Date": None, **{name: text for name, text in texts.items() if text}}
    vector: Any = FigureCanvasSVG(page)
    vector.print_svg(str(svg), metadata=metadata)
    files = [svg]
    if dpi is not None:
        page.set_dpi(dpi)
        pixels: Any = FigureCanvasAgg(page)
        metadata = {"Software": None, "run": run or None}
        pixels.print_png(str(png), metadata=metadata, pil_kwargs={"compress_level": 3})
        files.append(png)
    if is_pdf:
        paper: Any = FigureCanvasPdf(page)
        paper.print_pdf(
            str(pdf), metadata={"CreationDate": None, "Title": title, "Subject": description}
        )
        files.append(pdf)
    return files


def encode_figure(page: Figure) -> str:
    """Lay out a figure in the current style and write it as a ``data:`` address for a page.

    Parameters
    ----------
    page : drawn

    Returns
    -------
    An SVG whose letters are lines: it looks the same in every browser.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    finish_layout(page)
    file = BytesIO()
    vector: Any = FigureCanvasSVG(page)
    vector.print_svg(file, metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(file.getvalue()).decode()}"
