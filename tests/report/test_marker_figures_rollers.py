from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from labpipe.records.curve import PointFlag
from labpipe.records.result import TestResult
from labpipe.report import marker_figures
from labpipe.report.drawn_rig import Rig
from labpipe.report.figure_page import style
from labpipe.report.marker_figures import draw_wire_shapes, plot_shapes
from tests.store.builders_result import build_result

SPAN = Rig(span=0.1524, roller_radius=0.005, section_radius=0.007)


@pytest.fixture
def bent(monkeypatch: pytest.MonkeyPatch) -> TestResult:
    """A test between rollers: its axis sinks at mid-span, and is fitted."""
    result = build_result(half_cycle=4.0)
    assert result.shape is not None
    frames = len(result.shape.time)
    coefficients = np.zeros((frames, 3, 3))
    coefficients[:, 0, :2] = [-0.06, 0.12]
    coefficients[:, 1, 1] = np.linspace(0.0, 0.04, frames)
    coefficients[:, 1, 2] = -coefficients[:, 1, 1]
    shape = replace(
        result.shape,
        coefficients=coefficients,
        flags=np.full_like(result.shape.flags, PointFlag.MEASURED),
    )
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
    assert axes.get_xlim()[1] > 76.2 + 5.0
    assert axes.get_ylim()[0] < -17.0


def test_the_key_names_them(bent: TestResult) -> None:
    with style():
        page = draw_wire_shapes(bent)
    names = [text.get_text() for text in page.legends[0].get_texts()]
    assert names[-2:] == ["supports", "load, first and last"]


def test_markers_beside_the_axis_have_their_note(monkeypatch: pytest.MonkeyPatch) -> None:
    result = build_result(half_cycle=4.0)
    notes = []
    for offset in (0.0008, 0.0):
        rig = Rig(centre_offset=offset)
        monkeypatch.setattr(marker_figures, "rig_of", lambda _, rig=rig: rig)
        with style():
            page = draw_wire_shapes(result)
        notes.append(" ".join(text.get_text() for text in page.texts[1:]))
    words = "Centres of markers lie 0.8 mm beside the axis, which is the curve."
    assert [words in note for note in notes] == [True, False]
