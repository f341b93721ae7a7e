"""Draw figures once, lay them out once, write them as SVG, PNG and PDF, and into a page."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from labpipe.errors import StoreError, error_text
from labpipe.report.figure_page import finish_layout, style
from labpipe.report.wording import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_SVG = "http://www.w3.org/2000/svg"
_LINK = "{http://www.w3.org/1999/xlink}href"
_LONG_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_LONG_LINE = 20
_STRAIGHT = re.compile(r"M[ML\d.\s-]*z?")
_NO_TURN = re.compile(r"rotate\(-?0 [^()]*\)")
_RULE = re.compile(r"([a-z-]+): *([^;{}]+)")
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_WITH_NUMBERS = {"d", "x", "y", "transform", "width", "height"}
_FAMILIES = re.compile(r"'STIXGeneral'(, ('[^']*'|[a-z-]+))*")
"""The fonts of the style; a browser finds a letter that the first ones lack by itself."""
_SIZE = re.compile(r"([\d.]+)px")
_SHORT = 3
"""Letters from which on the width of words is held."""
_FONT = "STIXGeneral, 'STIX Two Text', 'Times New Roman', Times, serif"


class Inline(NamedTuple):
    """A drawing as an element of a page, and the classes that it is drawn with."""

    element: str
    classes: dict[str, str]


def inline_svg(drawing: bytes, *, prefix: str, title: str) -> Inline:
    """Turn a drawing by matplotlib into an element of a page.

    Parameters
    ----------
    drawing : an SVG document
    prefix : begins every id, so that no two drawings of a page share one
    title : what a person reads who cannot see it

    Returns
    -------
    One ``svg`` element: as wide as the page lets it be, coordinates to 0.01 pt, and to 0.1 pt in
    long lines, which is less than a line is thick; without metadata and without ids that nothing
    refers to. Its words are as wide as they were laid out, whatever fonts the reader has. Its looks
    are classes, as drawings share most of them;
    equal looks have equal names in all drawings.
    """
    ET.register_namespace("", _SVG)
    ET.register_namespace("xlink", "http://www.w3.org/1999/xlink")
    root = ET.fromstring(drawing)
    for metadata in root.findall(f"{{{_SVG}}}metadata"):
        root.remove(metadata)
    _inherit_rules(root)
    _hold_widths(root)
    wanted = _references(root)
    classes: dict[str, str] = {}
    for element in root.iter():
        _slim(element, wanted, prefix)
        _classify(element, classes)
    _unwrap(root)
    _name(root, title)
    text = ET.tostring(root, encoding="unicode", short_empty_elements=True)
    return Inline(re.sub(r">\s+<", "><", text).strip(), classes)


def _inherit_rules(root: ET.Element) -> None:
    """Turn rules for all elements into attributes of the drawing: a page allows no other rules."""
    for parent in list(root.iter()):
        for rules in parent.findall(f"{{{_SVG}}}style"):
            parent.remove(rules)
            for name, value in _RULE.findall(rules.text or ""):
                root.set(name, value)


def _hold_widths(root: ET.Element) -> None:
    """Give words the width that they were laid out with: a reader's font may be another one."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    with style():
        for text in root.iter(f"{{{_SVG}}}text"):
            size, words = _SIZE.search(text.get("style", "")), text.text or ""
            if size is None or len(words) < _SHORT:
                continue
            font = FontProperties(size=float(size[1]))
            width, *_ = text_to_path.get_text_width_height_descent(words, font, ismath=False)
            text.set("textLength", f"{width:.1f}")
            text.set("lengthAdjust", "spacingAndGlyphs")


def _references(root: ET.Element) -> set[str]:
    """Ids that something in the drawing refers to."""
    links = {value[1:] for each in root.iter() if (value := each.get(_LINK)) is not None}
    used = {
        found
        for each in root.iter()
        for value in each.attrib.values()
        for found in _REFERENCE.findall(value)
    }
    return links | used


def _slim(element: ET.Element, wanted: set[str], prefix: str) -> None:
    own = element.attrib
    name = own.pop("id", "")
    if name in wanted:
        own["id"] = f"{prefix}-{name}"
    if _LINK in own:
        own[_LINK] = f"#{prefix}-{own[_LINK][1:]}"
    for key, value in own.items():
        own[key] = _REFERENCE.sub(rf"url(#{prefix}-\1)", value)
    if _NO_TURN.fullmatch(own.get("transform", "")):
        del own["transform"]
    for key in own.keys() & _WITH_NUMBERS:
        own[key] = " ".join(_LONG_NUMBER.sub(_two_places, own[key]).split())
    if own.get("d", "").count("L") > _LONG_LINE and _STRAIGHT.fullmatch(own["d"]):
        strokes, closing, _ = own["d"].partition("z")
        own["d"] = "".join(map(_steps, strokes.split("M")[1:])) + closing
    elif "d" in own:  # numbers that follow a line are ends of further lines
        own["d"] = re.sub(r"(?<=\d) L (?=[-\d])", " ", own["d"])


def _classify(element: ET.Element, classes: dict[str, str]) -> None:
    """Put the look of an element under a name made of it."""
    look = _FAMILIES.sub(_FONT, element.attrib.pop("style", ""))
    if look:
        name = f"s{zlib.crc32(look.encode()):x}"
        classes[name] = look
        element.set("class", name)


def _unwrap(parent: ET.Element) -> None:
    """Take away groups that say nothing about what is in them."""
    for child in list(parent):
        _unwrap(child)
        if child.tag == f"{{{_SVG}}}g" and not child.attrib:
            at = list(parent).index(child)
            parent[at : at + 1] = list(child)


def _steps(stroke: str) -> str:
    """A line as its first point and steps of tenths of a point: half as long as all its points."""
    ends = [round(10.0 * float(number)) for number in stroke.replace("L", " ").split()]
    steps = [after - before for before, after in zip(ends, ends[2:], strict=False)]
    first, rest = (" ".join(f"{piece / 10:g}" for piece in part) for part in (ends[:2], steps))
    return f"M{first}" + (f"l{rest}".replace(" -", "-") if rest else "")


def _two_places(found: re.Match[str]) -> str:
    return f"{float(found[0]):.2f}".rstrip("0").rstrip(".")


def _name(root: ET.Element, title: str) -> None:
    """Say what it shows, and let the page decide how wide it is."""
    root.attrib.pop("height", None)
    root.attrib.pop("width", None)
    root.attrib.pop("version", None)
    root.set("role", "img")
    root.set("aria-label", title)


PNG_DPI, _REPORT_DPI = 300, 200
NOTHING_SAID: Mapping[str, str] = {}
FORMATS = ("svg", "png", "pdf")
"""In which the figures of a report can be had; SVG always."""


class FigureToSave(NamedTuple):
    """A figure before it is drawn.

    Parameters
    ----------
    name : of its files, without the ending
    draw : makes it
    caption : how to read it; the description in its files
    alt : what a person reads who cannot see it; the title in its files
    """

    name: str
    draw: Callable[[], Figure]
    caption: str = ""
    alt: str = ""


class Saving(NamedTuple):
    """Files of a figure, of which the PNG may still be on its way.

    Parameters
    ----------
    files : SVG, and PNG where one is wanted
    packing : done when the PNG is written; None without one
    """

    files: tuple[Path, ...]
    packing: Future[None] | None = None

    def whole(self) -> tuple[Path, ...]:
        """The files once they are all written; raises what went wrong with the PNG."""
        if self.packing is not None:
            self.packing.result()
        return self.files


class SavedFigure(NamedTuple):
    """A figure of a report that was drawn and saved.

    Parameters
    ----------
    files : SVG, and PNG and PDF where they were asked for
    """

    files: tuple[Path, ...]


def save_pages(
    wanted: Iterable[FigureToSave],
    folder: Path,
    *,
    what: str,
    again: str,
    say: Callable[[str], None] = lambda _: None,
    run: str = "",
    png: bool = False,
) -> list[Path]:
    """Draw figures in labpipe's style, each as SVG, and as PNG on request.

    Parameters
    ----------
    wanted : one is drawn and let go before the next
    folder : made if it is not there
    what, again : what the figures are, and how to draw them again, for a message
    say : told the name of each figure as it is drawn
    run : key of the run that the figures show, which goes into the files; empty for none
    png : each as PNG, too; the SVG is the same to the byte

    Returns
    -------
    The files, in the order of the figures.

    Raises
    ------
    StoreError
        If a file cannot be written.

    Notes
    -----
    The same figure gives the same bytes with the same version of matplotlib.
    """
    dpi = PNG_DPI if png else None
    with written_to(folder, what, again=again):
        folder.mkdir(parents=True, exist_ok=True)
        with style(), ThreadPoolExecutor(max_workers=1) as packer:
            saved = []
            for figure_to_save in wanted:
                say(figure_to_save.name)
                saved.append(
                    save_page(
                        figure_to_save.draw(), folder, figure_to_save.name, packer, dpi=dpi, run=run
                    )
                )
            return [path for each in saved for path in each.whole()]


def pngs_of(wanted: Iterable[FigureToSave], folder: str) -> list[str]:
    """Name the PNGs of figures: of an earlier run they would show other numbers than the SVGs.

    Parameters
    ----------
    wanted : figures, which are not drawn
    folder : that holds them, for the names
    """
    return [f"{folder}/{figure_to_save.name}.png" for figure_to_save in wanted]


@contextmanager
def written_to(folder: Path, what: str, *, again: str) -> Iterator[None]:
    """Say of a folder that cannot be written to what it was for, and what to do.

    Parameters
    ----------
    folder : that is written to inside this block
    what, again : what is written, and how to make it again

    Raises
    ------
    StoreError
        In place of what the operating system refuses.
    """
    try:
        yield
    except OSError as error:
        message = error_text(
            folder,
            "",
            expected=f"a folder that {what} can be written to",
            found=str(error),
            remedy=f"Make room, or change the permissions, and {again} again.",
        )
        raise StoreError(message) from error


def save_report_figures(
    wanted: Iterable[FigureToSave], folder: Path, *, formats: Collection[str] = ("svg",)
) -> list[SavedFigure]:
    """Draw the figures of a report and save each as SVG, and as PNG and PDF where asked for.

    Parameters
    ----------
    wanted : one is drawn and let go before the next
    folder : there already
    formats : some of `FORMATS`; SVG is always written

    Returns
    -------
    In the order of `wanted`.

    Raises
    ------
    OSError
        If a file cannot be written.

    Notes
    -----
    The same figure gives the same bytes with the same version of matplotlib.
    """
    with style(), ThreadPoolExecutor(max_workers=1) as packer:
        saved = [
            _save_for_report(figure_to_save, folder, packer, formats) for figure_to_save in wanted
        ]
        return [figure for figure, saving in saved if saving.whole()]


def _save_for_report(
    wanted: FigureToSave, folder: Path, packer: Executor, formats: Collection[str]
) -> tuple[SavedFigure, Saving]:
    """Draw once, lay out once, write in each format."""
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    page = wanted.draw()
    dpi = _REPORT_DPI if "png" in formats else None
    about = {"Title": printable(wanted.alt), "Description": printable(wanted.caption)}
    saving = save_page(page, folder, wanted.name, packer, dpi=dpi, about=about)
    files = list(saving.files)
    if "pdf" in formats:
        files.append(folder / f"{wanted.name}.pdf")
        paper: Any = FigureCanvasPdf(page)
        named = {"Title": about["Title"], "Subject": about["Description"]}
        paper.print_pdf(str(files[-1]), metadata={"CreationDate": None, **named})
    return SavedFigure(tuple(files)), saving


def save_page(
    page: Figure,
    folder: Path,
    name: str,
    packer: Executor,
    *,
    dpi: int | None = PNG_DPI,
    run: str = "",
    about: Mapping[str, str] = NOTHING_SAID,
) -> Saving:
    """Lay out a page inside the present style and save it under one name in both formats.

    Parameters
    ----------
    page : as it is drawn
    folder : there already
    name : of the files, without the ending
    packer : packs the pixels into a PNG beside the drawing of what comes next
    dpi : of the PNG; None for no PNG
    run : key that goes into the files (``dc:identifier`` of the SVG, text ``run`` of the PNG)
    about : what else the SVG says of itself (``Title``, ``Description``)

    Returns
    -------
    The files. The same page gives the same bytes with the same version of matplotlib.

    Raises
    ------
    OSError
        If the SVG cannot be written.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    svg, png = folder / f"{name}.svg", folder / f"{name}.png"
    finish_layout(page)
    packing = None if dpi is None else packer.submit(_pixels(page, dpi, run), png)
    vector: Any = FigureCanvasSVG(page)
    said = {"Date": None, "Identifier": run or None, **about}
    vector.print_svg(str(svg), metadata=said)
    return Saving((svg,)) if packing is None else Saving((svg, png), packing)


def _pixels(page: Figure, dpi: int, run: str) -> Callable[[Path], None]:
    """Draw a page that is laid out in pixels; what is given writes them to a file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    page.set_dpi(dpi)
    pixels: Any = FigureCanvasAgg(page)
    pixels.draw()
    image = Image.fromarray(np.array(pixels.buffer_rgba()))
    about = PngInfo()
    if run:
        about.add_text("run", run)
    return partial(image.save, dpi=(dpi, dpi), compress_level=3, pnginfo=about)
