"""Figures as files and as parts of a page."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from labpipe.errors import StoreError
from labpipe.protocol import schema
from labpipe.records.group import Campaign
from labpipe.report.calibration_report import list_calibration_figures, save_calibration_workbook
from labpipe.report.figure_page import encode_figure, save_pages, use_style
from labpipe.report.figures import FIGURES, is_for_journal, save_figures
from labpipe.report.lab_report import write_report
from labpipe.report.plot_records import Axis, Page, Plot, make_line
from labpipe.report.wire_report import list_wire_figures, save_wire_workbook
from tests.approved import Approve
from tests.builders.wire_tables import wire_table
from tests.report.builders_calibrations import report
from tests.store.builders_result import build_result

RESULT = build_result(half_cycle=1.0)


LINE = Plot(Axis(), Axis(), [make_line("motion", [0.0, 1.0], [0.0, 1.0])])
PAGE = Page("a", "title", [LINE], height=25.4, width=25.4)


def test_files_of_figures_and_what_they_say(tmp_path: Path) -> None:
    """The SVG does not depend on the PNG; letters are lines, so that no font changes them."""
    pages = [replace(PAGE, caption="How to\x07 read it.", alt="One & two")]
    files = save_pages(pages, tmp_path / "both", png=True)
    (svg_file,) = save_pages(pages, tmp_path / "alone")
    assert [path.name for path in files] == ["a.svg", "a.png"]
    assert svg_file.read_bytes() == files[0].read_bytes()
    assert list((tmp_path / "alone").iterdir()) == [svg_file]
    drawn = svg_file.read_text(encoding="utf-8")
    assert "<dc:title>One &amp; two</dc:title>" in drawn
    assert "<dc:description>How to\ufffd read it.</dc:description>" in drawn
    assert "<text" not in drawn


def test_a_figure_for_a_journal_has_serif_letters(tmp_path: Path) -> None:
    """As the protocol asks; all others are drawn with the letters of the page."""
    text = "report: {style: journal}"
    assert not is_for_journal(RESULT)
    assert not is_for_journal(replace(RESULT, protocol_yaml=text))  # of no grammar
    pages = [PAGE]
    (plain,) = save_pages(pages, tmp_path / "page")
    (serif,) = save_pages(pages, tmp_path / "journal", is_journal=True)
    assert "DejaVuSans" in plain.read_text("utf-8")
    assert "STIXGeneral" in serif.read_text("utf-8")


def test_a_figure_is_its_own_address() -> None:
    with use_style():
        head, _, data = encode_figure(PAGE).partition(",")
    assert head == "data:image/svg+xml;base64"
    assert ET.fromstring(base64.b64decode(data)).tag.endswith("svg")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["$\\frac{$ <b>&\U0001f600", "A\x07\n\ud8002", "x" * 300])
def test_any_name_is_drawn(tmp_path: Path, name: str) -> None:
    specimen = replace(RESULT.specimen, type=name, spool=name, sample=name)
    notes = tuple(replace(note, where=name, message=name) for note in RESULT.quality)
    unusual = replace(RESULT, test=name, specimen=specimen, quality=notes, figures=tuple(FIGURES))
    for drawn in save_figures(unusual, tmp_path):
        ET.fromstring(drawn.read_bytes())


SAVE: dict[str, Callable[[Path], object]] = {
    "figures": lambda path: save_figures(build_result(half_cycle=0.2, cycles=1), path),
    "wire figures": lambda path: save_pages(list_wire_figures([wire_table("A1")]), path),
    "calibration figures": lambda path: save_pages(list_calibration_figures(report()), path),
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
    assert set(FIGURES) == set(schema.FIGURE_NEEDS)
    with pytest.raises(ValueError, match=r"^figures: expected names of .*, found \['pie'\]$"):
        save_figures(replace(RESULT, figures=("pie", "timeline")), tmp_path)
    (tmp_path / "a.png").mkdir()
    with pytest.raises(StoreError, match="Is a directory"):
        save_pages([PAGE], tmp_path, png=True)
    assert {path.name for path in tmp_path.iterdir()} == {"x", "a.png", "a.svg"}
    approved(messages)
