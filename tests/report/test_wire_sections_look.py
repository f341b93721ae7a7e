from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.lines import Line2D

from labpipe.report.figure_page import Words, keyed_page, style
from labpipe.report.wire_sections import (
    bent,
    short_name,
    strand_words,
    warnings_of,
    wire_title,
)
from tests.builders.wire_tables import wire_table
from tests.report.builders_wires import CUT, DEFAULTS_TAKEN, troubled


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style():
        yield


def test_strands_in_words() -> None:
    table = wire_table("A3")
    assert strand_words(table) == "19 \u00d7 0.24 mm"
    mixed = replace(
        table.spec, layer_counts=(1, 6, 12), strand_diameters=(0.3e-3, 0.25e-3, 0.25e-3)
    )
    assert strand_words(replace(table, spec=mixed)) == "1 \u00d7 0.3 + 18 \u00d7 0.25 mm"


def test_title_says_that_it_is_a_model() -> None:
    assert wire_title(wire_table("A3")) == (
        "A3  ·  wire model  ·  19 \u00d7 0.24 mm, hexagonal  ·  wire 1.8 mm"
    )


def test_long_names_are_cut_in_titles() -> None:
    table = replace(wire_table("A1"), name="a long  name " + "x" * 40)
    assert short_name(table) == "a long name xxxxxxxxxxx…"
    assert len(short_name(table)) == 24


def test_warnings_without_what_is_only_worth_knowing() -> None:
    assert warnings_of(troubled()) == CUT.message
    assert warnings_of(wire_table("A3")).startswith("Where the rim of the insulation is")
    assert warnings_of(wire_table("A3")).endswith("a stress table of the insulation says more.")
    assert warnings_of(replace(wire_table("A3"), notes=(DEFAULTS_TAKEN,))) == ""


def test_zero_curvature_has_no_place_on_a_logarithmic_axis() -> None:
    used = bent(wire_table("A1"))
    assert not used[0]
    assert used[1:].all()


@pytest.mark.parametrize(
    ("count", "words", "columns"), [(3, 5, 3), (6, 18, 3), (6, 24, 2), (12, 26, 2)]
)
def test_key_has_as_many_columns_as_there_is_room_for(count: int, words: int, columns: int) -> None:
    keys = [Line2D([], [], label="x" * words) for _ in range(count)]
    with style():
        page = keyed_page(Words("title", "note", keys), height_mm=50.0)
        canvas: Any = FigureCanvasAgg(page)
        canvas.draw()
        places = [text.get_window_extent() for text in page.legends[0].get_texts()]
    assert len({round(each.x0) for each in places}) == columns
    assert max(each.x1 for each in places) < page.bbox.x1
    assert [text.get_text() for text in page.texts] == ["title", "note"]
