from __future__ import annotations

import re
from xml.etree import ElementTree as ET

import numpy as np

from labpipe.report.saving import inline_svg

DRAWING = b"""<?xml version="1.0"?>
<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"
 width="100pt" height="50pt" viewBox="0 0 100 50" version="1.1">
 <metadata><x>made today</x></metadata>
 <defs><style type="text/css">*{stroke-linejoin: round; stroke-linecap: butt}</style></defs>
 <defs><path id="mark" d="M 0 1.23456 L -2.5 3" style="stroke: #000"/></defs>
 <g id="figure_1"><g id="axes_1">
  <path d="M 1.23456 2
L 3 4
L 5.00001 -6.5
" clip-path="url(#clip)" style="fill: none; stroke: #0072b2"/>
  <use xlink:href="#mark" x="10.98765" y="2" style="stroke: #000"/>
  <text style="font: 9px 'STIXGeneral', serif, 'DejaVu Sans'; fill: #000">a &lt; b</text>
 </g></g>
 <defs><clipPath id="clip"><rect x="0" y="0" width="9.87654" height="1"/></clipPath></defs>
</svg>"""


def test_small_and_named() -> None:
    inline = inline_svg(DRAWING, prefix="a2", title='Force <of> "A2"')
    root = ET.fromstring(inline.element)
    assert root.get("role") == "img"
    assert root.get("aria-label") == 'Force <of> "A2"'
    assert root.get("viewBox") == "0 0 100 50"
    assert root.get("width") is None
    for gone in ("made today", "<?xml", "style=", "figure_1", "<g"):
        assert gone not in inline.element
    assert 'd="M 1.23 2 3 4 5 -6.5"' in inline.element
    assert "a &lt; b" in inline.element


def test_rules_for_all_become_attributes_as_a_page_allows_no_others() -> None:
    inline = inline_svg(DRAWING, prefix="a", title="")
    root = ET.fromstring(inline.element)
    assert "<style" not in inline.element
    assert (root.get("stroke-linejoin"), root.get("stroke-linecap")) == ("round", "butt")


def test_words_keep_the_width_that_they_were_laid_out_with() -> None:
    """By the metrics of the font itself, in 1/1000 of its size: STIX has an 'a' of 444."""
    words = DRAWING.replace(b"a &lt; b", b"aaaa").replace(b"9px", b"10px")
    element = inline_svg(words, prefix="a", title="").element
    assert 'textLength="17.8"' in element
    assert 'lengthAdjust="spacingAndGlyphs"' in element
    assert (
        "textLength"
        not in inline_svg(DRAWING.replace(b"a &lt; b", b"10"), prefix="a", title="").element
    )


def test_ids_belong_to_the_drawing_and_references_follow() -> None:
    one, other = (inline_svg(DRAWING, prefix=name, title="").element for name in ("one", "other"))
    assert 'id="one-mark"' in one
    assert 'href="#one-mark"' in one
    assert 'clip-path="url(#one-clip)"' in one
    assert "one-" not in other


def test_equal_looks_share_a_class() -> None:
    inline = inline_svg(DRAWING, prefix="one", title="")
    assert sorted(inline.classes.values()) == [
        "fill: none; stroke: #0072b2",
        "font: 9px STIXGeneral, 'STIX Two Text', 'Times New Roman', Times, serif; fill: #000",
        "stroke: #000",
    ]
    assert inline.classes == inline_svg(DRAWING, prefix="other", title="").classes


def test_long_lines_are_steps_that_do_not_add_up_to_an_error() -> None:
    x, y = np.linspace(0.0, 100.0, 300), np.random.default_rng(1).uniform(0.0, 50.0, 300)
    points = " L ".join(f"{a:.6f} {b:.6f}" for a, b in zip(x, y, strict=True))
    drawing = f'<svg xmlns="http://www.w3.org/2000/svg"><path d="M {points} M 1.26 2 L 3 4"/></svg>'
    element = inline_svg(drawing.encode(), prefix="a", title="t").element
    path = re.search(r' d="M(.*?)"', element)
    assert path is not None
    line, other = path[1].split("M")
    first, steps = (re.findall(r"-?[\d.]+", part) for part in line.split("l"))
    found = np.cumsum(np.array([*first, *steps], dtype=float).reshape(-1, 2), axis=0)
    np.testing.assert_allclose(found, np.column_stack([x, y]), atol=0.0551)  # to 0.01, then to 0.1
    assert other == "1.3 2l1.7 2"


def test_an_area_is_as_short_as_a_line_and_stays_closed() -> None:
    points = " L ".join(f"{n}.04 {n % 3}.04" for n in range(30))
    drawing = f'<svg xmlns="http://www.w3.org/2000/svg"><path d="M {points} z"/></svg>'.encode()
    element = inline_svg(drawing, prefix="p", title="t").element
    path = element.partition(' d="')[2].partition('"')[0]
    assert path.startswith("M0 0l1 1 1 1")
    assert path.endswith("z")
    assert path.count("z") == 1


def test_a_turn_by_nothing_is_not_said() -> None:
    text = '<text transform="rotate({} 12.3 4.5)">a</text>'
    drawing = (
        f'<svg xmlns="http://www.w3.org/2000/svg">{text.format("-0")}{text.format("-90")}</svg>'
    )
    element = inline_svg(drawing.encode(), prefix="p", title="t").element
    assert element.count("rotate") == 1
    assert "rotate(-90 12.3 4.5)" in element
