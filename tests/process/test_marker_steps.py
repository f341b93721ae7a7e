"""Steps on markers: of a clamped wire, and of a rod on two supports."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ProcessingError
from labpipe.process.camera_steps import run_marker_step
from labpipe.process.steps import PreparedTest, Take
from labpipe.protocol.load import load_protocol
from labpipe.protocol.schema import Markers, Protocol
from labpipe.records.causes import CENTRE, GRIP, PULL, SHAPE
from labpipe.records.declarations import FitShape, RepairMarkers, SpecimenFrame
from labpipe.records.quality import Findings
from labpipe.records.recording import MarkerTracks
from labpipe.records.result import Status
from labpipe.records.signals import Signals
from labpipe.virtual_lab import observe
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario
from labpipe.virtual_lab.lab_files import Observation
from tests.approved import Approve
from tests.builders.reasons import doubted
from tests.builders.small_tests import small_scenario
from tests.builders.tensile_tests import recordings_of
from tests.builders.three_point import STROKE, BendingRecord, curvature_at, load_at, reduced


@pytest.fixture(scope="module")
def protocol(repository: Path) -> Protocol:
    return load_protocol(repository / "protocols" / "wire-cantilever.yaml")


@pytest.fixture(scope="module")
def observation() -> Observation[CantileverScenario]:
    return observe(small_scenario(), 3)


@pytest.fixture
def tracks(observation: Observation[CantileverScenario]) -> MarkerTracks:
    take = recordings_of(observation)["markers"].markers
    assert take is not None
    return take


def steps(protocol: Protocol) -> tuple[RepairMarkers, SpecimenFrame, FitShape]:
    first, second, third = protocol.steps[:3]
    assert isinstance(first, RepairMarkers)
    assert isinstance(second, SpecimenFrame)
    assert isinstance(third, FitShape)
    return first, second, third


def words(protocol: Protocol, **changes: object) -> Markers:
    assert protocol.markers is not None
    return protocol.markers.model_copy(update=changes)


def done(
    tracks: MarkerTracks, protocol: Protocol, scale_error: float = 0.0, **changes: object
) -> tuple[PreparedTest, Findings]:
    mend, turn, fit = steps(protocol)
    settings = words(protocol, **changes)
    prepared, first = run_marker_step(
        PreparedTest(Signals(), Take(tracks, scale_uncertainty=scale_error)), mend, settings
    )
    prepared, second = run_marker_step(prepared, turn, settings)
    prepared, third = run_marker_step(prepared, fit, settings)
    return prepared, Findings((*first, *second, *third))


def test_travel_and_deflection(
    tracks: MarkerTracks, protocol: Protocol, observation: Observation[CantileverScenario]
) -> None:
    prepared, findings = done(tracks, protocol, scale_error=5e-4)
    truth = observation.truth
    for name, true in (("travel", truth["travel"]), ("deflection", truth["deflection"])):
        signal = prepared.signals.filtered[name]
        assert signal.unit == "m"
        error = signal.values - true
        assert np.sqrt(np.nanmean(error**2)) < 1e-4
        assert prepared.signals.raw[name].relative_error == 5e-4
    deflection = prepared.signals.filtered["deflection"]
    assert 0.0 < deflection.zero_error < 5e-5
    assert 0.0 < np.nanmax(np.abs(deflection.variants[SHAPE] - deflection.values)) < 1e-3
    assert {"specimen_frame", "shape_fit"} <= {note.code for note in findings.notes}
    assert not doubted(findings.entries)


def test_offsets_move_the_deflection_and_not_its_zero(
    tracks: MarkerTracks, protocol: Protocol
) -> None:
    """As a reduction of its own with a longer pull offset; the rest stays at zero."""
    prepared, _ = done(tracks, protocol, offset_uncertainty=1e-4, centre_uncertainty=5e-5)
    signal, rest = prepared.signals.raw["deflection"], prepared.take.is_at_rest
    assert rest is not None
    assert set(signal.variants) == {GRIP, PULL, CENTRE, SHAPE}
    for moved in signal.variants.values():
        assert np.nanmean(moved[rest]) == pytest.approx(0.0, abs=1e-12)
    longer, _ = done(tracks, protocol, pull_offset=words(protocol).pull_offset + 1e-4)
    np.testing.assert_allclose(
        signal.variants[PULL], longer.signals.raw["deflection"].values, atol=1e-8
    )
    exact, _ = done(tracks, protocol, offset_uncertainty=0.0, centre_uncertainty=0.0)
    assert set(exact.signals.raw["deflection"].variants) == {SHAPE}


def blank(tracks: MarkerTracks) -> MarkerTracks:
    (body,) = tracks.bodies
    lost = replace(body, position=np.full_like(body.position, np.nan))
    return replace(tracks, bodies=(lost,))


TAKES: dict[str, tuple[Callable[[MarkerTracks], MarkerTracks], dict[str, object]]] = {
    "another name of the clamp": (lambda tracks: tracks, {"clamp": "Clmp"}),
    "no rigid body": (lambda tracks: replace(tracks, bodies=()), {}),
    "a clamp that is lost": (blank, {}),
    "two markers along": (lambda tracks: tracks, {"along": ("Wire:Marker[12]",)}),
    "no markers along": (lambda tracks: tracks, {"along": ("Tube*",)}),
}


def test_takes_without_clamp_or_markers(
    tracks: MarkerTracks, protocol: Protocol, approved: Approve
) -> None:
    messages = []
    for change, keys in TAKES.values():
        with pytest.raises(ProcessingError) as refused:
            done(change(tracks), protocol, 0.0, **keys)
        messages.append(str(refused.value))
    approved(messages)


@pytest.mark.parametrize(
    ("index", "missing"),
    [(0, "a role with marker tracks"), (1, "step repair-markers"), (2, "repair")],
)
def test_a_step_names_what_it_lacks(
    tracks: MarkerTracks, protocol: Protocol, index: int, missing: str
) -> None:
    take = Take(tracks) if index else Take()
    with pytest.raises(ValueError, match=missing):
        run_marker_step(PreparedTest(Signals(), take), steps(protocol)[index], words(protocol))


@pytest.mark.parametrize(
    ("frames", "is_stale", "is_bridged"),
    [
        (slice(400, 440), True, False),
        (slice(400, 410), False, True),
        (slice(400, 460), False, False),
    ],
)
def test_a_clamp_that_is_stale_or_lost_for_some_frames(
    tracks: MarkerTracks, protocol: Protocol, frames: slice, is_stale: bool, is_bridged: bool
) -> None:
    """A stale pose is not believed; short gaps are bridged and long ones left."""
    (clamp,) = tracks.bodies
    position = clamp.position.copy()
    position[frames] = position[frames.start - 1] if is_stale else np.nan
    test, findings = done(replace(tracks, bodies=(replace(clamp, position=position),)), protocol)
    assert test.take.clamp_positions is not None
    expected = (
        clamp.position[frames] if is_bridged else np.full_like(clamp.position[frames], np.nan)
    )
    np.testing.assert_allclose(test.take.clamp_positions[frames], expected, atol=1e-4)
    why = doubted(findings.entries).get("displacement", "")
    assert why.startswith("clamp_frozen: " if is_stale else "")
    assert "40 frames" in why or not is_stale


def test_markers_of_another_body_are_left_out(tracks: MarkerTracks, protocol: Protocol) -> None:
    table = replace(tracks.bodies[0], name="Table")
    names = (*tracks.names, "Table:Marker1")
    added = np.concatenate([tracks.positions, tracks.positions[:, :1] + 0.05], axis=1)
    crowded = replace(tracks, names=names, positions=added, bodies=(*tracks.bodies, table))
    prepared, findings = done(crowded, protocol)
    assert prepared.take.repaired_tracks is not None
    assert "Table:Marker1" not in prepared.take.repaired_tracks.names
    assert "bodies_left_out" in {note.code for note in findings.notes if "Table" in note.message}


def test_a_wrong_grip_offset_shows_in_the_fit_of_a_long_stroke(protocol: Protocol) -> None:
    usual = small_scenario()
    mechanics = replace(usual.mechanics, stroke=0.04, cycles=1)
    take = recordings_of(observe(replace(usual, mechanics=mechanics), 3))["markers"].markers
    assert take is not None
    assert "displacement" not in doubted(done(take, protocol)[1].entries)
    _, findings = done(take, protocol, grip_offset=0.016)
    why = doubted(findings.entries)["displacement"]
    assert why.startswith("shape_misfit: ")
    assert "grip_offset" in why


SPAN = "span: 152.4 mm"


@pytest.mark.slow
def test_numbers_and_shape_of_a_rod_on_two_supports() -> None:
    """Three clocks are joined; a rod on knife edges sinks at mid-span as the load goes."""
    record = BendingRecord()
    test, results = reduced(record)
    assert {result.status for result in results.values()} == {Status.OK}
    for name, true in (
        ("mid_span_bending_stiffness", record.rigidity),
        ("mid_span_curvature", curvature_at(STROKE)),
        ("peak_force.1", float(load_at(record, np.array([STROKE]))[0])),
        ("twist", abs(record.twist)),
        ("clock_offset", 0.0),
    ):
        interval = results[name].interval
        assert interval is not None
        assert interval.lower <= true <= interval.upper
    assert test.clocks.other_fits["markers"].offset == pytest.approx(3.2, abs=0.01)
    assert test.aligned is not None
    camera, frame = (test.aligned.series[name].values for name in ("mid_span", "displacement"))
    assert np.nanmax(np.abs(camera - frame)) < 3e-4
    (note,) = (note for note in test.findings.notes if note.code == "camera_clock")
    assert re.search(r"cameras is 3\.2\d* s ahead", note.message)
    shape = test.shape
    assert shape is not None
    assert shape.time[0] == pytest.approx(-3.2, abs=0.01)
    assert shape.positions.shape[1:] == (15, 3)
    assert shape.length == pytest.approx(14 * 0.0127, abs=1e-4)
    top = int(np.nanargmax(shape.positions[:, 7, 1] - shape.positions[:, 1, 1]))
    along = (shape.positions[top, :, 0] - shape.coefficients[top, 0, 0]) / shape.length
    drawn = shape.coefficients[top, 1] @ along[None, :] ** np.arange(10)[:, None]
    inside = (along > 0.0) & (along < 1.0)
    assert np.abs(drawn - shape.positions[top, :, 1])[inside].max() < 3e-4


WINDOW = "mid-span, from: 1 mm, to: "
FAULTS_OF_A_SET_UP: dict[str, tuple[BendingRecord, tuple[str, str] | None, str, str]] = {
    "no span": (
        BendingRecord(),
        (f"  {SPAN}\n", ""),
        "mid_span_curvature",
        "no_span: specimen.span",
    ),
    "a span between markers": (
        BendingRecord(),
        (SPAN, "span: 15.24 mm"),
        "twist",
        "too_few_markers: of 15 sections with markers 2 lie between supports 15.24 mm apart: exp",
    ),
    "the span of another rig": (
        BendingRecord(),
        (SPAN, "span: 120 mm"),
        "bending_stiffness",
        "mid_span_differs: in the camera data mid-span moves by 19.9",
    ),
    "cameras that began under load": (
        BendingRecord(cameras_early=-2.0),
        None,
        "twist",
        "no_rest: the shape at rest was measured up to 3.9",
    ),
    "a third of the markers at rest": (
        BendingRecord(hides=17),
        None,
        "twist",
        "too_few_markers: at rest six sections of markers are visible in 0 frames, 4 are needed",
    ),
    "one row of markers": (
        BendingRecord(angles=(float(np.radians(90.0)),)),
        None,
        "twist",
        "too_few_markers: twist",
    ),
    "a window that is not reached": (
        BendingRecord(),
        (f"{WINDOW}10 mm", f"{WINDOW}40 mm"),
        "mid_span_bending_stiffness",
        "not_reached: the first loading reaches 29.",
    ),
}


@pytest.mark.parametrize(
    "name",
    [
        "no span",
        *(pytest.param(name, marks=pytest.mark.slow) for name in list(FAULTS_OF_A_SET_UP)[1:]),
    ],
)
def test_faults_of_a_set_up(name: str) -> None:
    record, change, result, reason = FAULTS_OF_A_SET_UP[name]
    _, results = reduced(record, change=(change,) if change else ())
    assert results[result].reason_text.startswith(reason)
    assert results[result].status is not Status.OK
    assert results["peak_force.1"].status is Status.OK
