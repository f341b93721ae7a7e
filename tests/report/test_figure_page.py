from __future__ import annotations

from typing import Any

import matplotlib as mpl
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from labpipe.report.figure_page import (
    STYLE_FILE,
    finish_layout,
    in_pages,
    keep_in_view,
    line_looks,
    new_page,
    panel_grid,
    panel_letter,
    put_key,
    require_room,
    say,
    side_key,
    style,
    titled_page,
)
from tests.store.builders_result import build_result

RESULT = build_result(half_cycle=0.2, cycles=1, force_rate=50.0)


def test_style_is_given_back() -> None:
    before = dict(mpl.rcParams)
    with style():
        assert mpl.rcParams["svg.hashsalt"] == "labpipe"
        assert mpl.rcParams["font.size"] == 8
    assert dict(mpl.rcParams) == before


def drawn(words: str) -> bytes:
    page = titled_page(words, "", width_mm=90, height_mm=20)
    page.set_layout_engine("none")
    pixels: Any = FigureCanvasAgg(page)
    pixels.draw()
    return bytes(pixels.buffer_rgba())


def test_letters_that_the_first_font_lacks_come_from_another() -> None:
    """Else matplotlib warns, which is an error here."""
    with mpl.rc_context(fname=str(STYLE_FILE)):
        drawn("عين")
        with pytest.raises(UserWarning, match="missing from font"):
            drawn("\U000f0000")


def test_letters_that_no_font_has_are_boxes_without_a_warning() -> None:
    with style():
        assert drawn("\U000f0000 A2") != drawn(" A2")


def test_page_has_title_footnote_and_room_for_them() -> None:
    with style():
        page = new_page(RESULT, width_mm=180, height_mm=60, has_key=True)
        axes = page.subplots()
        put_key(page, [Line2D([], [], label="cycle 1")])
        panel_letter(axes, "a", "Raw")
        finish_layout(page)
    assert page.get_size_inches() == pytest.approx([180 / 25.4, 60 / 25.4])
    texts = [text.get_text() for text in page.texts]
    assert texts[0].startswith("A2-085-1")
    assert texts[1] == "Of 3 results: 1 doubtful, 1 failed."
    assert axes.get_title(loc="left") == "(a) Raw"
    height = page.bbox.height
    drawn = axes.get_tightbbox()
    assert drawn is not None
    key_low = page.legends[0].get_window_extent().y0
    assert drawn.y1 < key_low
    assert key_low < page.texts[0].get_window_extent().y0 < height
    assert drawn.y0 > page.texts[1].get_window_extent().y1


def test_side_key_stays_above_the_panel() -> None:
    with style():
        page = new_page(RESULT, width_mm=90, height_mm=60)
        axes = page.subplots()
        side_key(axes, axes.plot([0, 1], label="raw"))
        finish_layout(page)
    legend = axes.get_legend()
    assert legend is not None
    assert legend.get_window_extent().y0 >= axes.get_window_extent().y1


def test_empty_panel_says_why() -> None:
    page = new_page(RESULT, width_mm=90, height_mm=60)
    axes = page.subplots()
    say(axes, "There is no curve to draw.")
    assert [text.get_text() for text in axes.texts] == ["There is no curve to draw."]
    assert not axes.axison


def texts(page: Figure) -> list[str]:
    return [text.get_text() for text in page.findobj(Text) if text.get_text()]


def test_names_leave_the_panel_its_room() -> None:
    """Else matplotlib warns that axes collapsed, which is an error here."""
    long = "".join(f"{number:03d}" for number in range(100))
    with style():
        page = titled_page(long, f"{long}\na note", width_mm=120, height_mm=60)
        axes = page.subplots()
        axes.set_yticks([0, 1], [long, "short"])
        finish_layout(page)
        assert axes.get_position().width > 0.2
    found = texts(page)
    assert f"{long[:20]}\u2026{long[-19:]}" in found
    assert "short" in found
    assert max(map(len, found)) == 150 + len("\na note")
    assert any(text.endswith("099\na note") for text in found)


def test_what_cannot_be_drawn_is_shown_as_such() -> None:
    with style():
        page = titled_page("A\x07\x002 \ud800", "one\nother\x1b", width_mm=90, height_mm=60)
        page.subplots().set_yticks([0], ["\x07"])
        finish_layout(page)
    assert {"A\ufffd\ufffd2 \ufffd", "one\nother\ufffd", "\ufffd"} <= set(texts(page))


def test_signs_of_mathematics_are_text() -> None:
    with style():
        drawn("$\\frac{$")
        assert drawn("$x_1$") != drawn("x_1")


@pytest.mark.parametrize(("count", "shape"), [(1, (1, 1)), (2, (1, 2)), (3, (2, 2))])
def test_spare_panels_are_empty(count: int, shape: tuple[int, int]) -> None:
    page = Figure()
    panels = panel_grid(page, count, columns=2)
    assert len(panels) == count
    spec = panels[0].get_subplotspec()
    assert spec is not None
    assert spec.get_gridspec().get_geometry() == shape
    assert [axes.axison for axes in page.axes] == [True] * count + [False] * (
        len(page.axes) - count
    )


def test_looks_of_a_page_are_all_different() -> None:
    looks = line_looks(12)
    assert len({(look.colour, str(look.dash)) for look in looks}) == 12


def test_things_on_pages() -> None:
    assert in_pages(range(25), 12) == [range(12), range(12, 24), range(24, 25)]
    assert in_pages([], 12) == []
    require_room(12, 12, "wires")
    for count in (0, 13):
        with pytest.raises(ValueError, match=f"^{count} wires: allowed are 1 to 12 on a page$"):
            require_room(count, 12, "wires")


def test_wide_intervals_are_cut_and_values_are_not() -> None:
    axes = Figure().subplots()
    axes.set_xlim(-100.0, 5.0)
    keep_in_view([1.0, float("nan"), 3.0], axes)
    assert axes.get_xlim() == (-2.0, 5.0)
    keep_in_view([1.0], axes)
    assert axes.get_xlim() == (-2.0, 5.0)
