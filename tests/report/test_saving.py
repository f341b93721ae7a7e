"""Figures as files and as parts of a page."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import get_args
from xml.etree import ElementTree as ET

import pytest
from matplotlib.figure import Figure

from labpipe.errors import StoreError
from labpipe.protocol.schema import FigureName
from labpipe.records.group import Campaign
from labpipe.report.calibration_figures import calibration_drawings
from labpipe.report.calibration_workbook import save_calibration_workbook
from labpipe.report.figure_page import new_page, titled
from labpipe.report.figures import FIGURES, save_figures
from labpipe.report.lab_report import write_report
from labpipe.report.saving import (
    FigureToSave,
    inline_svg,
    save_pages,
)
from labpipe.report.wire_figures import wire_drawings
from labpipe.report.wire_workbook import save_wire_workbook
from tests.approved import Approve
from tests.builders.wire_tables import wire_table
from tests.report.builders_calibrations import report
from tests.store.builders_result import build_result

RESULT = build_result(half_cycle=1.0)


def page() -> Figure:
    figure = new_page(width_mm=25.4, height_mm=25.4)
    figure.subplots().plot([0.0, 1.0])
    return titled(figure, "title")


def test_files_of_figures_and_what_they_say(tmp_path: Path) -> None:
    """The SVG does not depend on the PNG; letters are lines, so that no font changes them."""
    wanted = [FigureToSave("a", page, "How to\x07 read it.", "One & two")]
    both = save_pages(wanted, tmp_path / "both", png=True)
    (alone,) = save_pages(wanted, tmp_path / "alone")
    assert [path.name for path in both] == ["a.svg", "a.png"]
    assert alone.read_bytes() == both[0].read_bytes()
    assert list((tmp_path / "alone").iterdir()) == [alone]
    drawn = alone.read_text(encoding="utf-8")
    assert "<dc:title>One &amp; two</dc:title>" in drawn
    assert "<dc:description>How to\ufffd read it.</dc:description>" in drawn
    assert "<text" not in drawn


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


def inline(drawing: bytes = DRAWING, prefix: str = "a2", title: str = "") -> str:
    return inline_svg(drawing, prefix=prefix, title=title).element


def test_an_inline_drawing_is_small_and_named_and_its_ids_are_its_own() -> None:
    element = inline(title='Force <of> "A2"')
    attributes = {"role": "img", "aria-label": 'Force <of> "A2"', "viewBox": "0 0 100 50"}
    assert attributes.items() <= ET.fromstring(element).attrib.items()
    assert not re.findall(r"made today|<\?xml|style=|figure_1|<svg[^>]* width", element)
    for part in ('d="M 1.23 2 3 4 5 -6.5"', "a &lt; b", 'id="a2-mark"', 'href="#a2-mark"',
                 'clip-path="url(#a2-clip)"'):  # fmt: skip
        assert part in element


@pytest.mark.slow
@pytest.mark.parametrize("name", ["$\\frac{$ <b>&\U0001f600", "A\x07\n\ud8002", "x" * 300])
def test_any_name_is_drawn(tmp_path: Path, name: str) -> None:
    specimen = replace(RESULT.specimen, type=name, spool=name, sample=name)
    notes = tuple(replace(note, where=name, message=name) for note in RESULT.quality)
    odd = replace(RESULT, test=name, specimen=specimen, quality=notes, figures=tuple(FIGURES))
    for drawn in save_figures(odd, tmp_path):
        ET.fromstring(drawn.read_bytes())


SAVE: dict[str, Callable[[Path], object]] = {
    "figures": lambda path: save_figures(build_result(half_cycle=0.2, cycles=1), path),
    "wire figures": lambda path: save_pages(wire_drawings([wire_table("A1")]), path),
    "calibration figures": lambda path: save_pages(calibration_drawings(report()), path),
    "report": lambda path: write_report(Campaign("Synthetic", ()), path),
    "calibration": lambda path: save_calibration_workbook(report(), path / "a.xlsx"),
    "wires": lambda path: save_wire_workbook([wire_table("A1")], path / "a.xlsx"),
}


def test_what_cannot_be_written(tmp_path: Path, approved: Approve) -> None:
    (tmp_path / "x").write_text("")
    messages = []
    for name, save in SAVE.items():
        with pytest.raises(StoreError) as refusal:
            save(tmp_path / "x")
        messages.append(f"{name}: {re.sub(r'.Errno.*?: ', '', str(refusal.value))}")
    assert set(FIGURES) == set(get_args(FigureName))
    with pytest.raises(ValueError, match=r"^figures: expected names of .*, found \['pie'\]$"):
        save_figures(replace(RESULT, figures=("pie", "timeline")), tmp_path)
    (tmp_path / "a.png").mkdir()
    with pytest.raises(StoreError, match="Is a directory"):
        save_pages([FigureToSave("a", page)], tmp_path, png=True)
    assert {path.name for path in tmp_path.iterdir()} == {"x", "a.png", "a.svg"}
    approved(messages)
