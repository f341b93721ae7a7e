"""Drawings made fit to stand inside an HTML page: small, with names of their own, with a title."""

from __future__ import annotations

import re
import zlib
from typing import NamedTuple
from xml.etree import ElementTree as ET

_SVG = "http://www.w3.org/2000/svg"
_LINK = "{http://www.w3.org/1999/xlink}href"
_LONG_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_LONG_LINE = 20
_STRAIGHT = re.compile(r"M[ML\d.\s-]*z?")
_NO_TURN = re.compile(r"rotate\(-?0 [^()]*\)")
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_WITH_NUMBERS = {"d", "x", "y", "transform", "width", "height"}
_FAMILIES = re.compile(r"'STIXGeneral'(, ('[^']*'|[a-z-]+))*")
"""The fonts of the style; a browser finds a letter that the first ones lack by itself."""
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
    title : what a person who cannot see it is told

    Returns
    -------
    One ``svg`` element: as wide as the page lets it be, coordinates to 0.01 pt, and to 0.1 pt in
    long lines, which is less than a line is thick; without metadata and without ids that nothing
    refers to. Its looks are classes, as drawings share most of them;
    equal looks have equal names in all drawings.
    """
    ET.register_namespace("", _SVG)
    ET.register_namespace("xlink", "http://www.w3.org/1999/xlink")
    root = ET.fromstring(drawing)
    for metadata in root.findall(f"{{{_SVG}}}metadata"):
        root.remove(metadata)
    wanted = _references(root)
    classes: dict[str, str] = {}
    for element in root.iter():
        _slim(element, wanted, prefix)
        _classify(element, classes)
    _unwrap(root)
    _name(root, title)
    text = ET.tostring(root, encoding="unicode", short_empty_elements=True)
    return Inline(re.sub(r">\s+<", "><", text).strip(), classes)


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
    first, rest = (" ".join(f"{each / 10:g}" for each in part) for part in (ends[:2], steps))
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
