from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.process.fitting_protocols import Fit, Known, all_protocols, fitting, seen_length
from labpipe.process.folder_contents import SeenExport, look_into
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody

TIME: Floats = np.linspace(0.0, 120.0, 1201)


@pytest.fixture(scope="module")
def protocols() -> list[Protocol]:
    return all_protocols()


def cell() -> SeenExport:
    """The load cell in volts, as the benches record it."""
    channel = Channel("Out1", "Model Root/Load Cell/Out1", np.sin(TIME))
    return SeenExport(
        Path("f.mat"), Recording("dspace-mat", "", "", (Clock("time", TIME),), (channel,))
    )


def take(*, body: str = "Clamp", length: float = 0.085, stroke: float = 0.053) -> SeenExport:
    """A clamp that goes down, and markers along a wire."""
    down = np.zeros((len(TIME), 3))
    down[:, 1] = -stroke * np.clip(TIME / 60.0, 0.0, 1.0)
    none = np.full((len(TIME), 4), np.nan)
    bodies = (RigidBody(body, down, none, none[:, 0]),) if body else ()
    along = length + 0.006 - 0.004
    last = down + np.array([along, 0.0, 0.0])
    tracks = MarkerTracks(TIME, TIME, 10.0, ("Wire:Marker1",), last[:, None, :], bodies)
    return SeenExport(Path("t.csv"), Recording("motive-csv", markers=tracks))


def frame(
    travel: float, speed: float, *, peak: float = 100.0, start: float = 0.0, name: str = "m.txt"
) -> SeenExport:
    """A pull on a load frame at a steady speed."""
    time = np.linspace(start, start + travel / speed, 400)
    clock = Clock("time", time)
    moved = Channel("Crosshead", "Crosshead", (time - start) * speed * 1e3, unit_in_file="mm")
    force = Channel("Load", "Load", peak * np.linspace(0.0, 1.0, 400), unit_in_file="N")
    recording = Recording("load-frame", "", "", (clock,), (moved, force), metadata={"dialect": "x"})
    return SeenExport(Path(name), recording)


def names(fits: Sequence[Fit]) -> list[str]:
    return [fit.protocol.name for fit in fits]


def test_a_wire_is_known_by_clamp_length_and_stroke(protocols: list[Protocol]) -> None:
    (fit,) = fitting([cell(), take()], protocols, Known(("A2-085-1", "A2"), 0.085))
    assert fit.protocol.name == "wire-cantilever"
    assert fit.files == {"force": ("f.mat",), "markers": ("t.csv",)}
    assert fit.faults == ()


def test_a_bundle_is_longer(protocols: list[Protocol]) -> None:
    assert names(fitting([cell(), take(length=0.1143)], protocols, Known())) == ["taped-bundle"]


def test_without_a_clamp_it_lies_on_two_supports(protocols: list[Protocol]) -> None:
    assert names(fitting([cell(), take(body="")], protocols, Known())) == ["conduit-bundle"]


def test_a_take_alone(protocols: list[Protocol]) -> None:
    assert names(fitting([take()], protocols, Known())) == ["markers-only"]


def test_what_fits_alike_is_not_chosen_from(protocols: list[Protocol]) -> None:
    exports = [cell(), take(length=0.1)]
    assert names(fitting(exports, protocols, Known(length=0.1))) == [
        "taped-bundle",
        "wire-cantilever",
    ]


@pytest.mark.parametrize(
    ("of_type", "of_campaign", "expected"),
    [
        ({}, {"wire-cantilever": 1}, "wire-cantilever"),
        ({}, {"wire-cantilever": 3, "taped-bundle": 2}, "wire-cantilever"),
        ({}, {"wire-cantilever": 2, "taped-bundle": 2}, ""),
        ({}, {"wire-cantilever": 2, "corrugated-tube": 3}, ""),
        ({}, {"wire-cantilever": 6, "": 15}, ""),
        ({}, {"corrugated-tube": 9}, ""),
        ({"taped-bundle": 1}, {"wire-cantilever": 9, "taped-bundle": 1}, "taped-bundle"),
        ({"taped-bundle": 1, "": 1}, {"wire-cantilever": 9, "taped-bundle": 1}, "wire-cantilever"),
    ],
)
def test_what_fits_alike_is_settled_by_most_of_the_others(
    protocols: list[Protocol],
    of_type: dict[str, int],
    of_campaign: dict[str, int],
    expected: str,
) -> None:
    known = Known(of_type=of_type, of_campaign=of_campaign)
    found = fitting([cell(), take(length=0.1)], protocols, known)
    assert names(found) == ([expected] if expected else ["taped-bundle", "wire-cantilever"])
    if expected:
        share = f"{(of_type or of_campaign)[expected]} of " if not of_type.get("") else "9 of 10"
        assert share in found[0].signs[-1].text


@pytest.mark.parametrize("called", ["22AWG tensile_3", "tensile-1", "A Tensile (2)"])
def test_facts_of_the_export_count_before_the_others(
    protocols: list[Protocol], called: str
) -> None:
    """A short pull among tubes that are stretched by 50 mm is none of them."""
    pull = frame(0.012, 0.1e-3)
    among = {"corrugated-tube": 20}
    undecided = names(fitting([pull], protocols, Known(of_campaign=among)))
    assert "tensile" in undecided
    assert "corrugated-tube" not in undecided
    assert names(fitting([pull], protocols, Known((called,), of_campaign=among))) == ["tensile"]


@pytest.mark.parametrize("missing", [1, 5, 399, 400])
def test_channels_that_begin_without_values(protocols: list[Protocol], missing: int) -> None:
    """As Lloyd Nexygen exports them; a warning of numpy would be an error here."""
    whole = frame(0.05, 0.423e-3)
    values = (
        np.where(np.arange(400) < missing, np.nan, x.values) for x in whole.recording.channels
    )
    channels = tuple(
        replace(x, values=v) for x, v in zip(whole.recording.channels, values, strict=True)
    )
    begun = SeenExport(whole.path, replace(whole.recording, channels=channels))
    found = names(fitting([begun], protocols, Known()))
    assert (found == ["corrugated-tube"]) is (missing <= 5)
    assert found


def test_tubes_and_tapes_by_stroke_speed_and_name(protocols: list[Protocol]) -> None:
    tube = frame(0.05, 0.423e-3)
    assert names(fitting([tube], protocols, Known())) == ["corrugated-tube"]
    tape = frame(0.04, 0.5e-3, peak=400.0)
    assert "tensile" in names(fitting([tape], protocols, Known()))  # one weak sign is too little
    assert names(fitting([tape], protocols, Known(("pet-tape-1",)))) == ["pet-tape"]


def test_what_speaks_against_a_protocol_leaves_it_out(protocols: list[Protocol]) -> None:
    found = names(fitting([frame(0.004, 0.1e-3, peak=3.0)], protocols, Known()))
    assert "tensile" in found
    assert "corrugated-tube" not in found  # its force would go to 5 N, its stroke to 50 mm


def test_parts_of_one_recording_are_of_one_role(protocols: list[Protocol]) -> None:
    parts = [frame(0.01, 1e-3, name="1.txt"), frame(0.01, 1e-3, start=11.0, name="2.txt")]
    for fit in fitting(parts, protocols, Known()):
        assert fit.files == {"frame": ("1.txt", "2.txt")}
        assert not fit.unclear


def test_several_that_are_no_parts_are_unclear(protocols: list[Protocol]) -> None:
    several = [frame(0.01, 1e-3, name="1.txt"), frame(0.01, 1e-3, name="2.txt")]
    fits = fitting(several, protocols, Known())
    assert {fit.unclear for fit in fits} == {frozenset({"frame"})}
    named = fitting(several, protocols, Known(roles={"frame": ("2.txt",)}))
    assert {fit.files["frame"] for fit in named} == {("2.txt",)}
    assert not any(fit.unclear for fit in named)


def test_a_channel_of_another_name_is_said(protocols: list[Protocol]) -> None:
    other = Channel("ADC", "Model Root/ADC", np.sin(TIME))
    recording = Recording("dspace-mat", "", "", (Clock("time", TIME),), (other,))
    wire = [each for each in protocols if each.name == "wire-cantilever"]
    (fit,) = fitting([SeenExport(Path("f.mat"), recording), take(body="Grip")], wire, Known())
    assert "Name the right one with 'sources.force.channel" in fit.faults[0]
    assert fit.faults[1] == "the take has no rigid body 'Clamp', which 'markers.clamp' names"


def test_nothing_fits_what_lacks_a_role(protocols: list[Protocol]) -> None:
    wire = [each for each in protocols if each.name == "wire-cantilever"]
    assert fitting([cell()], wire, Known()) == []
    assert fitting([cell(), take()], wire, Known(roles={"frame": ("m.txt",)})) == []


def test_the_length_that_markers_show(protocols: list[Protocol]) -> None:
    (wire,) = (each for each in protocols if each.name == "wire-cantilever")
    tracks = take(length=0.1).recording.markers
    assert tracks is not None
    assert seen_length(wire, tracks) == pytest.approx(0.1, abs=1e-9)
    assert (
        seen_length(wire, MarkerTracks(TIME, TIME, 10.0, (), np.zeros((len(TIME), 0, 3)))) is None
    )


def test_real_parts_of_a_load_frame(protocols: list[Protocol], realdata: Path) -> None:
    folder = next((realdata / "mts" / "MTS_data").glob("*/Test Run 4*"))
    fits = fitting(look_into(folder).exports, protocols, Known())
    assert {len(fit.files["frame"]) for fit in fits} == {6}  # one of them is empty
