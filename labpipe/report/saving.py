"""Save figures, drawn and laid out once, as SVG, PNG and PDF, and embed them in a page."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree as ET

from labpipe.errors import StoreError, error_text
from labpipe.report.figure_page import finish_layout, style
from labpipe.report.wording import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_SVG = "http://www.w3.org/2000/svg"
_LINK = "{http://www.w3.org/1999/xlink}href"
_LONG_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_RULE = re.compile(r"([a-z-]+): *([^;{}]+)")
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_WITH_NUMBERS = {"d", "x", "y", "transform", "width", "height"}
_FAMILIES = re.compile(r"'STIXGeneral'(, ('[^']*'|[a-z-]+))*")
"""The fonts of the style; a browser replaces missing glyphs by itself."""
_FONT_SIZE = re.compile(r"([\d.]+)px")
_FONT = "STIXGeneral, 'STIX Two Text', 'Times New Roman', Times, serif"


class Inline(NamedTuple):
    """A drawing as an element of a page, with its style classes."""

    element: str
    classes: dict[str, str]


def inline_svg(drawing: bytes, *, prefix: str, title: str) -> Inline:
    """Convert a drawing by matplotlib to an element of a page.

    Parameters
    ----------
    drawing : an SVG document
    prefix : of all ids, unique on the page
    title : alternative text

    Returns
    -------
    One ``svg`` element as wide as the page allows, with coordinates to 0.01 pt, without
    metadata and unused ids. Its texts have the width of the layout with any font. Its styles are
    classes with equal names in all drawings.
    """
    ET.register_namespace("", _SVG)
    ET.register_namespace("xlink", "http://www.w3.org/1999/xlink")
    root = ET.fromstring(drawing)
    for metadata in root.findall(f"{{{_SVG}}}metadata"):
        root.remove(metadata)
    _inherit_rules(root)
    _fix_text_widths(root)
    wanted = _referenced_ids(root)
    classes: dict[str, str] = {}
    for element in root.iter():
        _shorten_element(element, wanted, prefix)
        _style_to_class(element, classes)
    _describe(root, title)
    text = ET.tostring(root, encoding="unicode", short_empty_elements=True)
    return Inline(re.sub(r">\s+<", "><", text).strip(), classes)


def _inherit_rules(root: ET.Element) -> None:
    """Convert rules for all elements to attributes, as a page allows no other rules."""
    for parent in list(root.iter()):
        for rules in parent.findall(f"{{{_SVG}}}style"):
            parent.remove(rules)
            for name, value in _RULE.findall(rules.text or ""):
                root.set(name, value)


def _fix_text_widths(root: ET.Element) -> None:
    """Fix texts to the width of the layout, as the reader's font may differ."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    with style():
        for text in root.iter(f"{{{_SVG}}}text"):
            size, label = _FONT_SIZE.search(text.get("style", "")), text.text or ""
            if size is None or len(label) < 3:
                continue
            font = FontProperties(size=float(size[1]))
            width, *_ = text_to_path.get_text_width_height_descent(label, font, ismath=False)
            text.set("textLength", f"{width:.1f}")
            text.set("lengthAdjust", "spacingAndGlyphs")


def _referenced_ids(root: ET.Element) -> set[str]:
    """Return the ids that are referenced in the drawing."""
    links = {value[1:] for element in root.iter() if (value := element.get(_LINK)) is not None}
    used = {
        reference
        for element in root.iter()
        for value in element.attrib.values()
        for reference in _REFERENCE.findall(value)
    }
    return links | used


def _shorten_element(element: ET.Element, wanted: set[str], prefix: str) -> None:
    """Drop unused ids, prefix the others, and round coordinates to 0.01 pt."""
    attributes = element.attrib
    name = attributes.pop("id", "")
    if name in wanted:
        attributes["id"] = f"{prefix}-{name}"
    if _LINK in attributes:
        attributes[_LINK] = f"#{prefix}-{attributes[_LINK][1:]}"
    for key, value in attributes.items():
        attributes[key] = _REFERENCE.sub(rf"url(#{prefix}-\1)", value)
    for key in attributes.keys() & _WITH_NUMBERS:
        attributes[key] = " ".join(_LONG_NUMBER.sub(_two_places, attributes[key]).split())
    if "d" in attributes:  # numbers after a line are ends of further lines
        attributes["d"] = re.sub(r"(?<=\d) L (?=[-\d])", " ", attributes["d"])


def _style_to_class(element: ET.Element, classes: dict[str, str]) -> None:
    """Replace the style of an element by a class named after its content."""
    look = _FAMILIES.sub(_FONT, element.attrib.pop("style", ""))
    if look:
        name = f"s{zlib.crc32(look.encode()):x}"
        classes[name] = look
        element.set("class", name)


def _two_places(match: re.Match[str]) -> str:
    return f"{float(match[0]):.2f}".rstrip("0").rstrip(".")


def _describe(root: ET.Element, title: str) -> None:
    """Set the alternative text, and leave the size to the page."""
    root.attrib.pop("height", None)
    root.attrib.pop("width", None)
    root.attrib.pop("version", None)
    root.set("role", "img")
    root.set("aria-label", title)


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
) -> list[Path]:
    """Draw figures in labpipe's style, each as SVG, and as PNG and PDF on request.

    Parameters
    ----------
    wanted : each is drawn and released before the next
    folder : made if it is not there
    say : called with the name of each figure as it is drawn
    run : key of the run of the figures, written to SVG and PNG; may be empty
    png, pdf : each as PNG or PDF, too; the SVG is identical
    dpi : of the PNG, dots per inch

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
    with writing(folder, "figures"), style():
        folder.mkdir(parents=True, exist_ok=True)
        files = []
        for figure_to_save in wanted:
            say(figure_to_save.name)
            files += save_page(
                figure_to_save, folder, run=run, dpi=dpi if png else None, is_pdf=pdf
            )
        return files


def pngs_of(wanted: Iterable[FigureToSave], folder: str) -> list[str]:
    """Return the names of the PNGs of figures, which are out of date after an earlier run.

    Parameters
    ----------
    wanted : figures, not drawn here
    folder : of the figures
    """
    return [f"{folder}/{figure_to_save.name}.png" for figure_to_save in wanted]


@contextmanager
def writing(path: Path, what: str) -> Iterator[None]:
    """Report a file or folder that cannot be written, with a remedy.

    Parameters
    ----------
    path : written inside this block
    what : name of the files

    Raises
    ------
    StoreError
        Instead of errors of the operating system.
    """
    try:
        yield
    except OSError as error:
        message = error_text(
            path,
            "",
            expected=f"room and permission to write {what}",
            found=str(error),
            remedy="Make room, change the permissions or close the open file, then repeat the"
            " command.",
        )
        raise StoreError(message) from error


def save_page(
    wanted: FigureToSave, folder: Path, *, run: str, dpi: int | None, is_pdf: bool
) -> list[Path]:
    """Draw and lay out one figure in the current style and write it in each format.

    Parameters
    ----------
    wanted : figure, with the texts of its files
    folder : existing
    run : key in the files (``dc:identifier`` of the SVG, text ``run`` of the PNG)
    dpi : of the PNG; None for no PNG
    is_pdf : write a PDF, too

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    page = wanted.draw()
    finish_layout(page)
    svg, png, pdf = (folder / f"{wanted.name}.{ending}" for ending in FORMATS)
    texts = {"Title": printable(wanted.alt), "Description": printable(wanted.caption)}
    stated = {name: text for name, text in texts.items() if text}
    vector: Any = FigureCanvasSVG(page)
    vector.print_svg(str(svg), metadata={"Date": None, "Identifier": run or None, **stated})
    files = [svg]
    if dpi is not None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        page.set_dpi(dpi)
        pixels: Any = FigureCanvasAgg(page)
        about = {"Software": None, "run": run or None}
        pixels.print_png(str(png), metadata=about, pil_kwargs={"compress_level": 3})
        files.append(png)
    if is_pdf:
        from matplotlib.backends.backend_pdf import FigureCanvasPdf

        paper: Any = FigureCanvasPdf(page)
        about = {"Title": texts["Title"], "Subject": texts["Description"]}
        paper.print_pdf(str(pdf), metadata={"CreationDate": None, **about})
        files.append(pdf)
    return files
