"""Steps on markers: of a clamped wire, and of a rod on two supports."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ProcessingError
from labpipe.process.calibrated_signals import Prepared, Take
from labpipe.process.camera_steps import fit_shapes, repair, turn_into_specimen
from labpipe.protocol.load import load_protocol
from labpipe.protocol.schema import Markers, Protocol
from labpipe.records.causes import CENTRE, GRIP, PULL, SHAPE
from labpipe.records.declarations import FitShape, RepairMarkers, SpecimenFrame
from labpipe.records.quality import Findings
from labpipe.records.recording import MarkerTracks
from labpipe.records.result import Result, Status
from labpipe.records.signals import Signals
from labpipe.results.reduced_test import ReducedTest
from labpipe.virtual_lab import Observation, observe
from tests.builders.reasons import doubted
from tests.builders.small_tests import small_scenario
from tests.builders.three_point import STROKE, BendingRecord, curvature_at, load_at, reduced


@pytest.fixture(scope="module")
def protocol(repository: Path) -> Protocol:
    return load_protocol(repository / "protocols" / "wire-cantilever.yaml")


@pytest.fixture(scope="module")
def observation() -> Observation:
    return observe(small_scenario(), 3)


@pytest.fixture
def tracks(observation: Observation) -> MarkerTracks:
    found = observation.markers.markers
    assert found is not None
    return found


def steps(protocol: Protocol) -> tuple[RepairMarkers, SpecimenFrame, FitShape]:
    first, second, third = protocol.steps[:3]
    assert isinstance(first, RepairMarkers)
    assert isinstance(second, SpecimenFrame)
    assert isinstance(third, FitShape)
    return first, second, third


def words(protocol: Protocol, **changes: object) -> Markers:
    assert protocol.markers is not None
    return protocol.markers.model_copy(update=changes)


def taken(tracks: MarkerTracks | None) -> Prepared:
    return Prepared(Signals(), Take(tracks))


def done(tracks: MarkerTracks, protocol: Protocol, **changes: object) -> tuple[Prepared, Findings]:
    mend, turn, fit = steps(protocol)
    said = words(protocol, **changes)
    made, first = repair(taken(tracks), mend, said)
    made, second = turn_into_specimen(made, turn, said)
    made, third = fit_shapes(made, fit, said)
    return made, Findings((*first, *second, *third))


def test_travel_and_deflection(
    tracks: MarkerTracks, protocol: Protocol, observation: Observation
) -> None:
    made, found = done(tracks, protocol)
    truth = observation.truth
    for name, true in (("travel", truth.travel), ("deflection", truth.deflection)):
        signal = made.signals.filtered[name]
        assert signal.unit == "m"
        error = signal.values - true
        assert np.sqrt(np.nanmean(error**2)) < 1e-4
    deflection = made.signals.filtered["deflection"]
    assert 0.0 < deflection.zero_error < 5e-5
    assert 0.0 < np.nanmax(np.abs(deflection.moved[SHAPE] - deflection.values)) < 1e-3
    assert {"specimen_frame", "shape_fit"} <= {note.code for note in found.notes}
    assert not doubted(found.found)


def test_offsets_move_the_deflection_and_not_its_zero(
    tracks: MarkerTracks, protocol: Protocol
) -> None:
    """As a reduction of its own with a longer pull offset; the rest stays at zero."""
    made, _ = done(tracks, protocol, offset_uncertainty=1e-4, centre_uncertainty=5e-5)
    signal, rest = made.signals.raw["deflection"], made.take.rest
    assert rest is not None
    assert set(signal.moved) == {GRIP, PULL, CENTRE, SHAPE}
    for moved in signal.moved.values():
        assert np.nanmean(moved[rest]) == pytest.approx(0.0, abs=1e-12)
    longer, _ = done(tracks, protocol, pull_offset=words(protocol).pull_offset + 1e-4)
    np.testing.assert_allclose(
        signal.moved[PULL], longer.signals.raw["deflection"].values, atol=1e-8
    )
    exact, _ = done(tracks, protocol, offset_uncertainty=0.0, centre_uncertainty=0.0)
    assert set(exact.signals.raw["deflection"].moved) == {SHAPE}


def test_one_term_more_is_half_the_width_of_a_rectangle(
    tracks: MarkerTracks, protocol: Protocol
) -> None:
    mend, turn, fit = steps(protocol)
    made, _ = repair(taken(tracks), mend, protocol.markers)
    made, _ = turn_into_specimen(made, turn, protocol.markers)
    one, more = (
        fit_shapes(made, replace(fit, terms=terms), protocol.markers)[0].signals.raw["deflection"]
        for terms in (7, 8)
    )
    change = np.sqrt(3.0) * (one.moved[SHAPE] - one.values)
    np.testing.assert_allclose(change, more.values - one.values, atol=1e-12)


def test_what_cameras_see_has_their_scale(tracks: MarkerTracks, protocol: Protocol) -> None:
    mend, turn, fit = steps(protocol)
    made = replace(taken(tracks), take=Take(tracks, scale_error=5e-4))
    made, _ = repair(made, mend, protocol.markers)
    made, _ = turn_into_specimen(made, turn, protocol.markers)
    made, _ = fit_shapes(made, fit, protocol.markers)
    for name in ("travel", "deflection"):
        assert made.signals.raw[name].relative_error == 5e-4


def refused(tracks: MarkerTracks | None, protocol: Protocol, **changes: object) -> None:
    mend, _, _ = steps(protocol)
    repair(taken(tracks), mend, words(protocol, **changes))


def test_clamp_that_is_not_there(tracks: MarkerTracks, protocol: Protocol) -> None:
    said = r"markers, rigid bodies: expected the clamp 'Clmp', found 'Clamp'. Name the body of"
    with pytest.raises(ProcessingError, match=said):
        refused(tracks, protocol, clamp="Clmp")
    bodiless = replace(tracks, bodies=())
    with pytest.raises(ProcessingError, match=r"found no rigid body in the take"):
        refused(bodiless, protocol)


def test_clamp_that_was_never_seen(tracks: MarkerTracks, protocol: Protocol) -> None:
    (body,) = tracks.bodies
    blank = replace(body, position=np.full_like(body.position, np.nan))
    said = r"rigid body 'Clamp': expected positions, found blanks in every frame. Solve the body"
    with pytest.raises(ProcessingError, match=said):
        refused(replace(tracks, bodies=(blank,)), protocol)


def test_too_few_markers(tracks: MarkerTracks, protocol: Protocol) -> None:
    said = r"expected at least 3 markers along the specimen, found 2: Wire:Marker1, Wire:Marker2"
    with pytest.raises(ProcessingError, match=said):
        refused(tracks, protocol, along=("Wire:Marker[12]",))
    with pytest.raises(ProcessingError, match=r"found 0: none"):
        refused(tracks, protocol, along=("Tube*",))


def test_markers_off_their_plane_leave_the_deflection_in_doubt(
    tracks: MarkerTracks, protocol: Protocol
) -> None:
    mend, turn, _ = steps(protocol)
    made, _ = repair(taken(tracks), mend, protocol.markers)
    strict = replace(turn, max_out_of_plane=1e-7)
    _, found = turn_into_specimen(made, strict, protocol.markers)
    assert doubted(found)["displacement"].startswith("out_of_plane: ")


def with_clamp(tracks: MarkerTracks, frames: slice, *, stale: bool) -> MarkerTracks:
    """The same take with the clamp blank, or held at its last pose, for some frames."""
    clamp = tracks.bodies[0]
    position = clamp.position.copy()
    position[frames] = position[frames.start - 1] if stale else np.nan
    return replace(tracks, bodies=(replace(clamp, position=position), *tracks.bodies[1:]))


def test_a_stale_pose_of_the_clamp_is_not_believed(
    tracks: MarkerTracks, protocol: Protocol
) -> None:
    made, found = done(with_clamp(tracks, slice(400, 440), stale=True), protocol)
    assert doubted(found.found)["displacement"].startswith(
        "clamp_frozen: Clamp holds its last pose in 40"
    )
    assert made.take.clamp is not None
    assert np.isnan(made.take.clamp[400:440]).all()


def test_short_gaps_of_the_clamp_are_bridged_and_long_ones_left(
    tracks: MarkerTracks, protocol: Protocol
) -> None:
    clamp = tracks.bodies[0].position
    made, found = done(with_clamp(tracks, slice(400, 410), stale=False), protocol)
    assert made.take.clamp is not None
    np.testing.assert_allclose(made.take.clamp[400:410], clamp[400:410], atol=1e-4)
    assert "Clamp is lost in 10 frames, 10 of them bridged by straight lines" in str(found.notes)
    made, _ = done(with_clamp(tracks, slice(400, 460), stale=False), protocol)
    assert made.take.clamp is not None
    assert np.isnan(made.take.clamp[400:460]).all()


def test_markers_of_another_body_are_left_out(tracks: MarkerTracks, protocol: Protocol) -> None:
    table = replace(tracks.bodies[0], name="Table")
    names = (*tracks.names, "Table:Marker1")
    added = np.concatenate([tracks.positions, tracks.positions[:, :1] + 0.05], axis=1)
    crowded = replace(tracks, names=names, positions=added, bodies=(*tracks.bodies, table))
    made, said = done(crowded, protocol)
    assert made.take.repaired is not None
    assert "Table:Marker1" not in made.take.repaired.names
    assert "markers of Table are not the specimen's: name them to use them" in str(said.notes)


def test_a_wrong_grip_offset_shows_in_the_fit_of_a_long_stroke(protocol: Protocol) -> None:
    usual = small_scenario()
    mechanics = replace(usual.mechanics, stroke=0.04, cycles=1)
    found = observe(replace(usual, mechanics=mechanics), 3).markers.markers
    assert found is not None
    assert "displacement" not in doubted(done(found, protocol)[1].found)
    _, said = done(found, protocol, grip_offset=0.016)
    why = doubted(said.found)["displacement"]
    assert why.startswith("shape_misfit: markers lie ")
    assert "look at grip_offset, centre_offset and terms" in why


NAMES = ("mid_span_bending_stiffness", "mid_span_curvature", "twist")


SPAN = "span: 152.4 mm"


@pytest.fixture(scope="module")
def bent() -> tuple[ReducedTest, dict[str, Result]]:
    return reduced(BendingRecord())


def holds(result: Result, truth: float) -> bool:
    interval = result.interval
    return interval is not None and interval.lower <= truth <= interval.upper


@pytest.mark.slow
def test_every_number_holds_its_truth(bent: tuple[ReducedTest, dict[str, Result]]) -> None:
    _, results = bent
    record = BendingRecord()

    assert {result.status for result in results.values()} == {Status.OK}
    assert holds(results["mid_span_bending_stiffness"], record.rigidity)
    assert holds(results["mid_span_curvature"], curvature_at(STROKE))
    assert holds(results["peak_force.1"], float(load_at(record, np.array([STROKE]))[0]))
    assert holds(results["twist"], abs(record.twist))
    assert holds(results["clock_offset"], 0.0)


def test_three_clocks_are_joined(bent: tuple[ReducedTest, dict[str, Result]]) -> None:
    test, _ = bent
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


def test_shape_of_the_store(bent: tuple[ReducedTest, dict[str, Result]]) -> None:
    test, _ = bent
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
