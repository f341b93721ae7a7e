from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody


def tracks() -> MarkerTracks:
    positions = np.zeros((5, 2, 3))
    positions[1:3, 0, 2] = np.nan
    body = RigidBody("Clamp", np.zeros((5, 3)), np.zeros((5, 4)), np.zeros(5))
    time = np.arange(5.0)
    return MarkerTracks(time, time, 1.0, ("a", "b"), positions, (body,))


def test_frames_without_a_marker_are_counted() -> None:
    assert tracks().missing == {"a": 2, "b": 0}


def test_bodies_by_name() -> None:
    found = tracks().body("Clamp")
    assert found is not None
    assert found.name == "Clamp"
    assert tracks().body("clamp") is None


def test_clocks_by_name() -> None:
    recording = Recording("test", clocks=(Clock("a", np.arange(3.0)), Clock("b", np.arange(4.0))))
    assert len(recording.clock("b").time) == 4
    with pytest.raises(KeyError, match="c"):
        recording.clock("c")


def test_a_clock_is_in_seconds_unless_it_counts_rows() -> None:
    assert Clock("time", np.arange(3.0)).unit == "s"
    assert Clock("rows", np.arange(3.0), "1").unit == "1"
    with pytest.raises(ValueError, match=r"expected \w+ of shape \(None,\), found \(3, 1\)"):
        Clock("time", np.zeros((3, 1)))


def test_arrays_are_read_only_and_of_one_length() -> None:
    channel = Channel("In1", "Model/In1", np.zeros(3))
    assert not channel.values.flags.writeable
    with pytest.raises(ValueError, match=r"expected \w+ of shape \(5, 4\)"):
        RigidBody("Clamp", np.zeros((5, 3)), np.zeros((4, 4)), np.zeros(5))
    with pytest.raises(ValueError, match=r"expected \w+ of shape \(5, 3, 3\)"):
        MarkerTracks(np.arange(5.0), np.arange(5.0), 1.0, ("a", "b", "c"), np.zeros((5, 2, 3)))
