from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from labpipe.records.curve import PointFlag
from labpipe.records.result import TestResult
from labpipe.report.marker_figures import (
    FLAG_COLOURS,
    draw_marker_quality,
    plot_flags,
    plot_tracking,
)
from tests.store.builders_result import build_result


@pytest.fixture(scope="module")
def result() -> TestResult:
    return build_result(half_cycle=4.0)


def test_rows_are_the_markers_and_spans_their_flags(result: TestResult) -> None:
    axes = Figure().subplots()
    plot_flags(result, axes)
    assert result.shape is not None
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names == [f"wire:Marker{number}" for number in range(1, 9)]
    flags = result.shape.flags[:, 5]  # Marker5: missing for a while
    black = FLAG_COLOURS[PointFlag.MISSING]
    found = [
        path.get_extents()
        for spans in axes.collections
        if len(spans.get_facecolor()) and to_hex(np.asarray(spans.get_facecolor())[0]) == black
        for path in spans.get_paths()
    ]
    assert len(found) == 1
    times = result.shape.time[flags == PointFlag.MISSING]
    # a column is 1/900 of the time drawn
    assert found[0].x0 == pytest.approx(times[0], abs=0.07)
    assert found[0].x1 == pytest.approx(times[-1], abs=0.07)
    assert found[0].y0 == pytest.approx(4 - 0.36)


def test_key_names_only_what_is_there(result: TestResult) -> None:
    assert result.shape is not None
    flags = np.full_like(result.shape.flags, PointFlag.MEASURED)
    for shape, names in (
        (result.shape, ["measured", "relabelled", "filled", "missing"]),
        (replace(result.shape, flags=flags), ["measured"]),
    ):
        axes = Figure().subplots()
        plot_flags(replace(result, shape=shape), axes)
        legend = axes.get_legend()
        assert legend is not None
        assert [text.get_text() for text in legend.get_texts()] == names


def test_tracking_shows_bodies_that_have_an_error(result: TestResult) -> None:
    axes = Figure().subplots()
    plot_tracking(result, axes)
    assert [line.get_label() for line in axes.lines] == ["Clamp"]
    assert axes.get_ylabel() == "Body error (mm)"
    markers = result.recordings["markers"].markers
    assert markers is not None
    top = markers.bodies[0].error.max() * 1e3
    assert np.asarray(axes.lines[0].get_ydata()).max() == pytest.approx(top)


def test_tracking_without_bodies_counts_visible_markers(result: TestResult) -> None:
    take = result.recordings["markers"]
    assert take.markers is not None
    bare = replace(take, markers=replace(take.markers, bodies=()))
    axes = Figure().subplots()
    plot_tracking(replace(result, recordings={"markers": bare}), axes)
    assert axes.get_ylabel() == "Visible markers"
    values = np.asarray(axes.lines[0].get_ydata())
    assert (values.min(), values.max()) == (7, 8)


def test_missing_stages_are_said(result: TestResult) -> None:
    page = draw_marker_quality(replace(result, shape=None, recordings={}))
    assert [axes.texts[0].get_text() for axes in page.axes] == [
        "There is no shape to draw.",
        "There is no take to draw.",
    ]
