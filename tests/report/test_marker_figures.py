"""Markers: quality, shapes of the specimen, rollers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from labpipe.records.curve import PointFlag
from labpipe.records.result import TestResult
from labpipe.report import marker_figures
from labpipe.report.figure_page import style
from labpipe.report.marker_figures import (
    FLAG_COLOURS,
    choose_frames,
    draw_marker_quality,
    draw_wire_shapes,
    plot_flags,
    plot_shapes,
)
from labpipe.report.rig_drawing import Rig
from tests.approved import Approve
from tests.report.figure_words import all_words
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
    (missing,) = (
        path.get_extents()
        for spans in axes.collections
        if len(spans.get_facecolor()) and to_hex(np.asarray(spans.get_facecolor())[0]) == black
        for path in spans.get_paths()
    )
    times = result.shape.time[flags == PointFlag.MISSING]
    # a column is 1/900 of the time drawn
    assert [missing.x0, missing.x1] == pytest.approx([times[0], times[-1]], abs=0.07)
    assert missing.y0 == pytest.approx(4 - 0.36)


SPAN = Rig(span=0.1524, roller_radius=0.005, section_radius=0.007)


@pytest.fixture
def bent(result: TestResult, monkeypatch: pytest.MonkeyPatch) -> TestResult:
    """A test between rollers: its axis sinks at mid-span, and is fitted."""
    assert result.shape is not None
    frames = len(result.shape.time)
    coefficients = np.zeros((frames, 3, 3))
    coefficients[:, 0, :2] = [-0.06, 0.12]
    coefficients[:, 1, 1] = np.linspace(0.0, 0.04, frames)
    coefficients[:, 1, 2] = -coefficients[:, 1, 1]
    flags = np.full_like(result.shape.flags, PointFlag.MEASURED)
    shape = replace(result.shape, coefficients=coefficients, flags=flags)
    monkeypatch.setattr(marker_figures, "rig_of", lambda _: SPAN)
    return replace(result, shape=shape)


def test_rollers_touch_the_specimen_from_both_sides(bent: TestResult) -> None:
    axes = Figure().subplots()
    plot_shapes(bent, axes)
    rollers = [patch for patch in axes.patches if isinstance(patch, Circle)]
    left, right, first, _last = (roller.center for roller in rollers)
    assert left == pytest.approx((-76.2, 12.0))
    assert right == pytest.approx((76.2, 12.0))
    assert first == pytest.approx((0.0, -12.0), abs=1.5)  # it has moved a little
    assert [roller.radius for roller in rollers] == pytest.approx([5.0] * 4)


def test_steps_are_equal_round_and_of_the_first_loading(result: TestResult) -> None:
    assert result.shape is not None
    assert result.curve is not None
    steps = choose_frames(result, result.shape)
    np.testing.assert_allclose(steps.levels, np.arange(6) * 0.01, atol=1e-12)
    reached = result.curve.displacement[steps.frames]
    # the first frame at or beyond the level: within one frame of travel, 0.05 m / 4 s / 50 Hz
    assert (reached >= steps.levels - 1e-12).all()
    assert (reached - steps.levels < 2.6e-4).all()
    assert result.shape.time[steps.frames].max() <= result.curve.branches[0].stop_time
    assert steps.word == "tip deflection"


def test_words(result: TestResult, approved: Approve) -> None:
    assert result.shape is not None
    measured = np.full_like(result.shape.flags, PointFlag.MEASURED)
    take = result.recordings["markers"]
    assert take.markers is not None
    bodiless = replace(take, markers=replace(take.markers, bodies=()))
    nowhere = replace(
        result.shape,
        positions=np.full_like(result.shape.positions, np.nan),
        flags=np.zeros_like(result.shape.flags),
        coefficients=np.empty((len(result.shape.time), 3, 0)),
    )
    all_seen = replace(result, shape=replace(result.shape, flags=measured))
    with style():
        pages = {
            "quality": draw_marker_quality(result),
            "all seen": draw_marker_quality(all_seen),
            "no bodies": draw_marker_quality(replace(result, recordings={"markers": bodiless})),
            "shapes": draw_wire_shapes(result),
            "no take": draw_marker_quality(replace(result, shape=None, recordings={})),
            "free take": draw_wire_shapes(replace(result, curve=None)),
            "nothing seen": draw_wire_shapes(replace(result, shape=nowhere, curve=None)),
            "no shape": draw_wire_shapes(replace(result, shape=None)),
        }
    approved(all_words(pages))


def test_words_on_the_rig(
    result: TestResult, bent: TestResult, monkeypatch: pytest.MonkeyPatch, approved: Approve
) -> None:
    with style():
        pages = {"between rollers": draw_wire_shapes(bent)}
    for offset in (0.0008, 0.0):
        rig = Rig(centre_offset=offset)
        monkeypatch.setattr(marker_figures, "rig_of", lambda _, rig=rig: rig)
        with style():
            pages[f"markers {offset} m beside the axis"] = draw_wire_shapes(result)
    approved(all_words(pages))
