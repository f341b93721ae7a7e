"""Pages of figures, and the points, lines and rigs that are drawn on them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from labpipe.records.arrays import Floats
from labpipe.report.figure_page import (
    STYLE_FILE,
    finish_layout,
    limit_to_values,
    new_page,
    panel_letter,
    put_key,
    require_room,
    split_pages,
    style,
    titled_page,
)
from labpipe.report.plot_thinning import extremes, simplify_line, worst
from labpipe.report.rig_drawing import Rig, rig_of
from tests.store.builders_result import build_result

RESULT = build_result(half_cycle=0.2, cycles=1, force_rate=50.0)


def test_style_is_given_back() -> None:
    before = dict(mpl.rcParams)
    with style():
        assert mpl.rcParams["svg.hashsalt"] == "labpipe"
        assert mpl.rcParams["font.size"] == 8
    assert dict(mpl.rcParams) == before


def drawn(heading: str) -> bytes:
    page = titled_page(heading, "", width_mm=90, height_mm=20)
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
    box = axes.get_tightbbox()
    assert box is not None
    note, key, title = (
        part.get_window_extent() for part in (page.texts[1], page.legends[0], page.texts[0])
    )
    assert note.y1 < box.y0 < box.y1 < key.y0 < title.y0 < page.bbox.height


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
    shown = texts(page)
    assert {f"{long[:20]}\u2026{long[-19:]}", "short"} <= set(shown)
    assert max(map(len, shown)) == 150 + len("\na note")
    assert any(text.endswith("099\na note") for text in shown)


def test_what_cannot_be_drawn_is_shown_as_such() -> None:
    with style():
        page = titled_page("A\x07\x002 \ud800", "one\nother\x1b", width_mm=90, height_mm=60)
        page.subplots().set_yticks([0], ["\x07"])
        finish_layout(page)
    assert {"A\ufffd\ufffd2 \ufffd", "one\nother\ufffd", "\ufffd"} <= set(texts(page))


def test_things_on_pages() -> None:
    assert split_pages(range(25), 12) == [range(12), range(12, 24), range(24, 25)]
    assert split_pages([], 12) == []
    require_room(12, 12, "wires")
    for count in (0, 13):
        with pytest.raises(ValueError, match=f"^wires: expected 1 to 12 on a page, found {count}$"):
            require_room(count, 12, "wires")


def test_wide_intervals_are_cut_and_values_are_not() -> None:
    axes = Figure().subplots()
    axes.set_xlim(-100.0, 5.0)
    limit_to_values([1.0, float("nan"), 3.0], axes)
    assert axes.get_xlim() == (-2.0, 5.0)
    limit_to_values([1.0], axes)
    assert axes.get_xlim() == (-2.0, 5.0)


@given(
    hnp.arrays(np.float64, st.integers(0, 400), elements=st.floats(-5, 5) | st.just(np.nan)),
    st.integers(1, 20),
)
def test_thinned_line_is_as_wide_and_as_broken_as_the_samples(values: Floats, bins: int) -> None:
    kept = extremes(values, bins=bins)
    assert (np.diff(kept) > 0).all()
    if len(values):
        assert kept[0] == 0
        assert kept[-1] == len(values) - 1
    if np.isfinite(values).any():
        assert np.nanmin(values[kept]) == np.nanmin(values)
        assert np.nanmax(values[kept]) == np.nanmax(values)
    assert np.isnan(values[kept]).any() == np.isnan(values).any()
    assert len(kept) <= max(4 * bins, 3 * bins + 2)


def test_worst_flag_of_a_stretch_wins() -> None:
    flags = np.ones((1000, 2), dtype=np.uint8)
    flags[503, 1] = 0
    flags[504, 1] = 2
    rank = np.array([2, 0, 1], dtype=np.uint8)
    thin = worst(flags, rank, bins=10)
    assert thin[:, 0].tolist() == [1] * 10
    assert thin[:, 1].tolist() == [1] * 5 + [0] + [1] * 4
    np.testing.assert_array_equal(worst(flags[:7], rank, bins=10), flags[:7])
    assert worst(flags[:0], rank, bins=10).shape == (0, 2)


def test_a_corner_stays_a_corner_and_a_step_a_step() -> None:
    x = np.linspace(0.0, 50.0, 2001)
    force = np.minimum(5.0 * x, 30.0 + 2.0 * x) - np.where(x > 30.0, 4.0, 0.0)
    kept = simplify_line(x, force, points=60)
    assert len(kept) < 10
    assert 10.0 in x[kept]
    assert {30.0, 30.025} <= set(x[kept].round(3).tolist())
    drawn = np.interp(x, x[kept], force[kept])
    assert np.abs(drawn - force).max() <= 0.002 * np.ptp(force)


def test_gaps_standstill_and_noise_in_bends() -> None:
    force = np.arange(100.0)
    force[40:45] = np.nan
    assert simplify_line(np.arange(100.0), force, points=10).tolist() == [0, 39, 40, 45, 99]
    up = np.concatenate([np.zeros(50), np.linspace(0.0, 1.0, 50), np.zeros(50)])
    assert {50, 99, 100} <= set(simplify_line(np.zeros(150), up, points=20).tolist())
    assert simplify_line(np.zeros(3), np.full(3, np.nan), points=5).tolist() == [0]
    assert simplify_line(np.zeros(0), np.zeros(0), points=5).tolist() == []
    noise = np.random.default_rng(1).normal(size=3000)
    kept = simplify_line(np.arange(3000.0), noise, points=50)
    assert len(kept) == 50
    assert {int(noise.argmax()), int(noise.argmin()), 0, 2999} <= set(kept.tolist())
    with pytest.raises(ValueError, match="bins: expected at least 1, found 0"):
        extremes(np.zeros(3), bins=0)


def with_protocol(text: str) -> Rig:
    return rig_of(replace(build_result(cycles=1, half_cycle=1.0), protocol_yaml=text))


def test_rollers_and_span_of_a_conduit(repository: Path) -> None:
    text = (repository / "protocols" / "conduit-bundle.yaml").read_text(encoding="utf-8")
    section = "section: {outer_diameter: 14.1 mm}"
    rig = with_protocol(text.replace(section, f"{section}\n  span: 152.4 mm"))
    assert rig == pytest.approx(Rig(0.1524, 0.005, 0.00705, 0.00855))
    assert rig.reach == pytest.approx(0.01205)


@pytest.mark.parametrize("text", ["", "version: 0\nname: of an earlier grammar\n"])
def test_without_a_sound_protocol_nothing_is_known(text: str) -> None:
    assert with_protocol(text) == Rig()
