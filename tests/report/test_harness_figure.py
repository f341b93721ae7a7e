"""The figures of a harness: what is drawn, not how."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from labpipe.report.figure_page import finish_layout, style
from labpipe.report.harness_figure import (
    DrawnHarness,
    DrawnMark,
    DrawnShape,
    DrawnSweep,
    harness_figure,
    plot_radius,
    plot_sweep,
    plot_view,
    save_harness_figure,
    sweep_figure,
)

TURN = np.linspace(0.0, np.pi / 2.0, 11)
ARC = 0.1 * np.column_stack([np.sin(TURN), np.zeros(11), 1.0 - np.cos(TURN)])
ROUND = DrawnShape(
    9, ARC, np.full(11, 0.1), (ARC - 0.004, ARC + 0.004), (np.full(11, 0.08), np.full(11, 0.13))
)
HARNESS = DrawnHarness(
    name="corner",
    note="A note.",
    along=0.1 * TURN,
    shapes=(DrawnShape(3, ARC * [1.0, 1.0, 0.0], np.full(11, np.inf)), ROUND),
    marks=(
        DrawnMark("left", "clip", ARC[0], np.zeros((0, 3)), np.array([1.0, 0.0, 0.0])),
        DrawnMark("hand", "grip", ARC[-1], ARC[[0, -1]]),
        DrawnMark("guide", "ring", ARC[5], np.zeros((0, 3)), holds=False),
    ),
    planes=((np.array([0.0, 0.0, -0.02]), np.array([0.0, 0.0, 1.0])),),
    allowed=0.05,
)
SWEEP = DrawnSweep(
    name="corner",
    note="A note.",
    length=np.array([0.15, 0.2]),
    radius=np.array([0.03, np.nan]),
    way=np.array([0.02, np.nan]),
    radius_band=(np.array([0.025, np.nan]), np.array([0.04, np.nan])),
    shapes=(ARC, ARC[:0]),
    allowed=0.05,
    is_doubtful=np.array([False, True]),
)


def texts(page: Figure) -> str:
    """All words of a page."""
    from matplotlib.text import Text

    return " ".join(str(text.get_text()).replace("\n", " ") for text in page.findobj(Text))


def test_a_view_has_the_line_in_mm_with_its_radius() -> None:
    axes = Figure().subplots()
    line = plot_view(HARNESS, 0, 2, axes)
    assert isinstance(line, LineCollection)
    ends = np.array(line.get_segments())
    assert ends[0, 0] == pytest.approx([0.0, 0.0])
    assert ends[-1, 1] == pytest.approx([100.0, 100.0])
    assert np.asarray(line.get_array()) == pytest.approx(np.full(10, 100.0))
    (band,) = (each for each in axes.collections if isinstance(each, PolyCollection))
    corners = np.vstack([path.vertices for path in band.get_paths()])
    assert corners.min(axis=0) == pytest.approx([-4.0, -4.0])
    assert corners.max(axis=0) == pytest.approx([104.0, 104.0])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (mm)", "z (mm)")
    left, right = axes.get_xlim()
    assert left < 0.0
    assert right > 100.0


def test_from_above_a_table_is_not_drawn() -> None:
    side, top = (Figure().subplots() for _ in range(2))
    plot_view(HARNESS, 0, 2, side)
    plot_view(HARNESS, 0, 1, top)
    level = [each for each in side.lines if np.asarray(each.get_ydata()).tolist() == [-20.0, -20.0]]
    assert len(level) == 1
    assert len(top.lines) == len(side.lines) - 1


def test_the_radius_along_the_line_and_what_is_allowed() -> None:
    axes = Figure().subplots()
    plot_radius(HARNESS, axes)
    earlier, last, limit = axes.lines
    assert np.isnan(np.asarray(earlier.get_ydata(), dtype=float)).all(), "it is straight"
    assert np.asarray(last.get_ydata()) == pytest.approx(np.full(11, 100.0))
    assert np.asarray(limit.get_ydata()).tolist() == [50.0, 50.0]
    assert axes.get_ylabel() == "Bend radius (mm)"


def test_the_key_names_what_is_drawn() -> None:
    with style():
        page = harness_figure(HARNESS)
        finish_layout(page)
    said = texts(page)
    for words in (
        *("step 3", "95 % band, point by point", "clip left", "grip hand", "ring guide"),
        *("allowed bend radius", "corner  ·  shape", "A note.", "From the side", "From the top"),
    ):
        assert words in said
    plain = replace(HARNESS, shapes=(replace(ROUND, band=None),), marks=(), planes=())
    with style():
        said = texts(harness_figure(plain))
    assert "band" not in said
    assert "step" not in said


def test_a_band_without_width_is_no_area() -> None:
    axes = Figure().subplots()
    plot_view(replace(HARNESS, shapes=(replace(ROUND, band=(ARC, ARC)),)), 0, 1, axes)
    (band,) = (each for each in axes.collections if isinstance(each, PolyCollection))
    assert not band.get_paths()


def test_a_sweep_leaves_a_gap_where_a_length_failed() -> None:
    axes = Figure().subplots()
    plot_sweep(SWEEP, axes)
    way, laid, *_, limit = axes.lines
    assert np.asarray(laid.get_xdata()).tolist() == [150.0, 200.0]
    assert np.asarray(laid.get_ydata(), dtype=float)[0] == pytest.approx(30.0)
    assert np.isnan(np.asarray(laid.get_ydata(), dtype=float)[1])
    assert np.asarray(way.get_ydata(), dtype=float)[0] == pytest.approx(20.0)
    assert np.asarray(limit.get_ydata()).tolist() == [50.0, 50.0]
    with style():
        shown = texts(sweep_figure(SWEEP))
        for words in ("95 % band, length by length", "150 mm", "doubtful", "From the side"):
            assert words in shown
        without = texts(sweep_figure(replace(SWEEP, radius_band=None)))
    assert "band" not in without


@pytest.mark.slow
def test_files(tmp_path: Path) -> None:
    files = save_harness_figure(HARNESS, SWEEP, tmp_path, png=True)
    assert [path.name for path in files] == [
        *("harness.svg", "harness.png", "harness-sweep.svg", "harness-sweep.png"),
    ]
    assert [path.name for path in save_harness_figure(HARNESS, None, tmp_path)] == ["harness.svg"]


@pytest.mark.parametrize(("across", "up"), [(0, 2), (1, 2), (0, 1)])
def test_the_way_of_a_gripper_is_seen_whole(across: int, up: int) -> None:
    way = np.array([[0.1, 0.0, 0.1], [0.1, 0.09, 0.25], [0.1, 0.0, 0.1]])
    hand = DrawnMark("hand", "grip", ARC[-1], way)
    axes = Figure().subplots()
    plot_view(replace(HARNESS, marks=(hand,)), across, up, axes)
    for number, (low, high) in zip((across, up), (axes.get_xlim(), axes.get_ylim()), strict=True):
        assert low < 1e3 * way[:, number].min() <= 1e3 * way[:, number].max() < high
