from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers.controldesk import Export, Trace, load_export, plain
from labpipe.records.recording import Recording

TIME = np.arange(5.0)


def trace(path: str, values: np.ndarray, *, clock: int = 0, unit: str = "") -> Trace:
    return Trace(path.rsplit("/", 1)[-1], path, unit, clock, lambda: values, {})


def load(
    *traces: Trace, axes: int = 1, start: float | None = None, channels: Sequence[str] | None = None
) -> Recording:
    export = Export(
        [("", lambda: TIME)] * axes, traces, "ControlDesk version: 5.2", {}, start=start
    )
    return load_export(export, reader="dspace-mat", path=Path("force.mat"), channels=channels)


def notes(recording: Recording) -> dict[str, str]:
    return {note.code: note.message for note in recording.notes}


def test_one_signal_on_two_rasters_keeps_two_paths() -> None:
    recording = load(trace("A/In1", TIME), trace("A/In1", TIME, clock=1), axes=2)
    assert [channel.path for channel in recording.channels] == ["A/In1 [1]", "A/In1 [2]"]
    assert [channel.clock for channel in recording.channels] == ["time [1]", "time [2]"]
    assert notes(recording)["several_clocks"] == "2 time axes: time [1], time [2]"


def test_only_the_wanted_are_loaded_in_the_order_of_the_file() -> None:
    def forbidden() -> object:
        raise AssertionError

    lazy = Trace("C", "A/C", "", 1, forbidden, {})
    recording = load(
        trace("A/B", TIME), lazy, trace("A/D", TIME), axes=2, channels=["D", "A/B", "B"]
    )
    assert [channel.path for channel in recording.channels] == ["A/B", "A/D"]
    assert [clock.name for clock in recording.clocks] == ["time [1]"]
    assert recording.program_version == "5.2"


def test_numbers_that_are_none() -> None:
    values = np.array([1.0, np.inf, np.nan, 4.0, -np.inf])
    recording = load(trace("A/B", values))
    np.testing.assert_array_equal(recording.channels[0].values, [1, np.nan, np.nan, 4, np.nan])
    assert notes(recording)["not_finite"] == (
        "3 of 5 samples are no numbers (2 of them infinite), the first at sample 2"
    )
    assert np.isinf(values).sum() == 2  # the export's own array is left alone


def test_constant_channels_and_all_nan_are_legal() -> None:
    recording = load(trace("A/B", np.full(5, 2.0)), trace("A/C", np.full(5, np.nan)))
    assert notes(recording)["constant_channel"] == "1 of 2 channels never change: 'A/B'"
    assert np.isnan(recording.channels[1].values).all()


def test_a_channel_of_another_length_than_its_axis() -> None:
    expected = (
        r"force\.mat, channel 'A/B': expected 5 samples as on its time axis 'time', found 3\."
        r" Export the recording again; the file may have been edited"
    )
    with pytest.raises(ReadError, match=expected):
        load(trace("A/B", np.zeros(3)))


def test_notes_on_names_units_and_start() -> None:
    found = notes(load(trace("A\\n/In1", TIME), trace("B/In1", TIME), start=-3.5))
    assert found["names_not_unique"] == (
        "of 2 channels 2 are called 'In1': tell them apart by path"
    )
    assert found["line_break_in_path"].endswith("backslash-n: 'A\\n/In1'")
    assert found["units_not_stated"] == "the export states no units; the protocol must"
    assert found["start_differs"] == (
        "StartTimestamp says -3.5 s, the time axis begins at 0 s: kept"
    )
    quiet = notes(load(trace("A/In1", TIME, unit="V"), start=1e-8))
    assert quiet == {}


def test_what_json_cannot_hold_becomes_text() -> None:
    value = {"Max": np.array([[np.inf]]), "list": [np.float64(1.0), 2], "one": [{"a": b"x"}]}
    assert plain(value) == {"Max": "inf", "list": [1.0, 2], "one": {"a": "b'x'"}}
