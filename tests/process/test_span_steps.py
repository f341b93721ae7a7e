"""Bent axis, camera clock, curvature and twist of a rod whose elastica is known."""

from __future__ import annotations

import re

import numpy as np
import pytest

from labpipe.records.result import Result, Status
from labpipe.results.evidence import Evidence
from tests.builders.doubts import doubted
from tests.builders.three_point import STROKE, BendingRecord, curvature_at, load_at, reduced

NAMES = ("mid_span_bending_stiffness", "mid_span_curvature", "twist")
SPAN = "span: 152.4 mm"


@pytest.fixture(scope="module")
def done() -> tuple[Evidence, dict[str, Result]]:
    return reduced(BendingRecord())


def holds(result: Result, truth: float) -> bool:
    interval = result.interval
    return interval is not None and interval.lower <= truth <= interval.upper


@pytest.mark.slow
def test_every_number_holds_its_truth(done: tuple[Evidence, dict[str, Result]]) -> None:
    _, results = done
    record = BendingRecord()

    assert {each.status for each in results.values()} == {Status.OK}
    assert holds(results["mid_span_bending_stiffness"], record.rigidity)
    assert holds(results["mid_span_curvature"], curvature_at(STROKE))
    assert holds(results["peak_force.1"], float(load_at(record, np.array([STROKE]))[0]))
    assert holds(results["twist"], abs(record.twist))
    assert holds(results["clock_offset"], 0.0)


def test_three_clocks_are_joined(done: tuple[Evidence, dict[str, Result]]) -> None:
    test, _ = done
    fit = test.clocks.others["markers"]
    shape = test.shape

    assert fit.offset == pytest.approx(3.2, abs=0.01)
    assert shape is not None
    assert test.span is not None
    assert shape.time[0] == pytest.approx(-3.2, abs=0.01)
    assert test.aligned is not None
    seen = test.aligned.series["mid_span"].values
    way = test.aligned.series["displacement"].values
    # A rod on knife edges: mid-span goes where the load goes.
    assert np.nanmax(np.abs(seen - way)) < 3e-4
    (note,) = (note for note in test.findings.notes if note.code == "camera_clock")
    assert note.message.startswith("the cameras are 3.19") or "3.20" in note.message


def test_shape_of_the_store(done: tuple[Evidence, dict[str, Result]]) -> None:
    test, _ = done
    shape = test.shape

    assert shape is not None
    assert shape.names[0] == "section 1"
    assert shape.positions.shape[1:] == (15, 3)
    assert shape.length == pytest.approx(14 * 0.0127, abs=1e-4)
    top = int(np.nanargmax(shape.positions[:, 7, 1] - shape.positions[:, 1, 1]))
    along = (shape.positions[top, :, 0] - shape.coefficients[top, 0, 0]) / shape.length
    drawn = shape.coefficients[top, 1] @ along[None, :] ** np.arange(10)[:, None]
    inside = (along > 0.0) & (along < 1.0)
    assert np.abs(drawn - shape.positions[top, :, 1])[inside].max() < 3e-4


def test_no_span() -> None:
    _, results = reduced(BendingRecord(), change=((f"  {SPAN}\n", ""),))

    for name in NAMES:
        assert results[name].status is Status.FAILED
        assert results[name].why == (
            "no_span: specimen.span, the distance of the supports, is not given: write it into the "
            "specimen of the test sheet, such as 'span: 152.4 mm'"
        )
    assert results["bending_stiffness"].why.startswith("no_span: ")
    assert results["peak_force.1"].status is Status.OK


@pytest.mark.slow
def test_a_span_of_another_rig_is_doubted_by_the_cameras() -> None:
    wrong = ((SPAN, "span: 120 mm"),)
    _, results = reduced(BendingRecord(), change=wrong)

    assert results["bending_stiffness"].status is Status.DOUBTFUL
    said = results["bending_stiffness"].why
    assert said.startswith("mid_span_differs: cameras see mid-span sink by 19.9")
    assert said.endswith(
        " mm, the displacement is 29.41 mm: look at specimen.span, at markers that are not on the "
        "specimen, at the units of both exports, at rig.crosshead_speed and rig.stroke where no "
        "frame measured it, and at how far the load was from the specimen"
    )
    assert results["peak_force.1"].status is Status.OK


@pytest.mark.slow
def test_cameras_that_began_under_load() -> None:
    _, results = reduced(BendingRecord(cameras_early=-2.0))

    assert results["twist"].status is Status.FAILED
    assert results["twist"].why.startswith("no_rest: the shape at rest was taken up to 3.9")
    assert results["twist"].why.endswith(
        " s after loading began: look at the cameras' start, and at 'over' of the step "
        "three-point-shape"
    )
    assert results["bending_stiffness"].status is Status.OK


@pytest.mark.slow
def test_a_speed_and_a_stroke_that_are_both_wrong_are_doubted_by_the_cameras() -> None:
    twice = (
        ("crosshead_speed: 0.5 mm/s", "crosshead_speed: 1 mm/s"),
        ("stroke: 29.4 mm", "stroke: 58.8 mm"),
    )
    test, _ = reduced(BendingRecord(force_late=-3.0), without=("frame",), change=twice)

    assert doubted(test)["displacement"].startswith(
        "mid_span_differs: cameras see mid-span sink by"
    )
    assert re.search(r", the displacement is 58\.(8|79) mm: ", doubted(test)["displacement"])


def test_supports_closer_than_the_markers() -> None:
    wrong = ((SPAN, "span: 15.24 mm"),)
    _, results = reduced(BendingRecord(), change=wrong)

    assert results["twist"].why == (
        "too_few_markers: of 15 sections with markers 2 lie between supports 15.24 mm apart: "
        "expected at least 5; look at specimen.span and at the unit of the markers"
    )


@pytest.mark.slow
def test_too_few_markers_for_a_twist() -> None:
    _, results = reduced(BendingRecord(angles=(float(np.radians(90.0)),)))

    assert results["twist"].why == (
        "too_few_markers: twist needs two markers at different places around the axis in one "
        "section, none of the 15 sections has them"
    )
    assert holds(results["mid_span_curvature"], curvature_at(STROKE))


@pytest.mark.slow
def test_a_window_that_is_not_reached() -> None:
    old = "mid-span, from: 1 mm, to: 10 mm"
    _, results = reduced(BendingRecord(), change=((old, "mid-span, from: 1 mm, to: 40 mm"),))

    reason = results["mid_span_bending_stiffness"].why  # by the last frame before the turn
    assert re.fullmatch(
        r"not_reached: the first loading reaches 29\.(38|39|4) mm, 40 mm is asked", reason
    )
    assert results["mid_span_curvature"].status is Status.OK


@pytest.mark.slow
def test_cameras_that_did_not_see_the_turn() -> None:
    """They ran on a clock that began when the frame was on its way back."""
    _, results = reduced(BendingRecord(cameras_early=-70.0))

    for name in NAMES:
        assert results[name].status is Status.FAILED
