from __future__ import annotations

import pytest

from labpipe.protocol.load import dump_protocol, parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import MARKER_READERS, READERS
from labpipe.protocol.values import si_unit_like


def _protocol(sources: str) -> Protocol:
    return parse_protocol(f"version: 1\nname: p\nsources: {sources}\n", "p.yaml")


def test_the_short_way_names_the_channel_like_the_role() -> None:
    short = _protocol("{force: {reader: dspace-mat, channel: a, unit: mN}}").channels["force"]
    long = _protocol(
        "{force: {reader: dspace-mat, channels: {force: {channel: a, unit: mN}}}}"
    ).channels["force"]

    for channel in (short, long):
        assert (channel.channel, channel.target_unit, channel.channel_unit) == (("a",), "N", "N")
        assert (channel.gain, channel.offset, channel.gain_uncertainty) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("unit", ["V", "mV"])
def test_a_gain_is_si_per_si_whatever_the_unit_of_the_channel(unit: str) -> None:
    channel = _protocol(
        f"{{force: {{reader: dspace-mat, channel: a, unit: {unit},"
        " calibration: {gain: -210.82 mN/V, offset: 2.846 mN, gain_uncertainty: 1 %}}}"
    ).channels["force"]

    assert channel.channel_unit == "V"
    assert (channel.gain, channel.offset) == (-0.21082, 0.002846)
    assert channel.gain_uncertainty == 0.01


def test_a_quantity_that_is_said_goes_before_the_name() -> None:
    channel = _protocol(
        "{frame: {reader: dspace-mat, channels: {laser: {channel: a, quantity: displacement,"
        " unit: V, calibration: {gain: 25 mm/V}}}}}"
    ).channels["laser"]

    assert (channel.target_unit, channel.gain, channel.offset) == ("m", 0.025, 0.0)


def test_a_channel_whose_unit_the_export_must_say() -> None:
    channel = _protocol("{force: {reader: dspace-mf4, channel: a}}").channels["force"]

    assert channel.channel_unit is None


def test_marker_tracks_are_no_channels() -> None:
    source = _protocol("{markers: {reader: [motive-csv, motive-xlsx]}}").sources["markers"]

    assert source.reader == ("motive-csv", "motive-xlsx")
    assert source.all_channels == {}


def test_a_source_of_a_load_frame(tube: str) -> None:
    source = parse_protocol(tube, "p.yaml").sources["frame"]

    assert (source.dialect, source.part) == (("mts-testsuite", "table"), "Specimen 1")
    force, displacement = source.all_channels["force"], source.all_channels["displacement"]
    assert (force.channel, displacement.channel) == (("Load", "Force"), ("Crosshead",))
    assert (force.peak_range, displacement.peak_range) == ((20.0, 2000.0), None)
    assert (force.channel_unit, displacement.channel_unit) == (None, "m")


def test_a_peak_in_the_short_way() -> None:
    channel = _protocol(
        "{force: {reader: dspace-mat, channel: [a, b], unit: mV, scale_uncertainty: 0.4 %,"
        " calibration: {gain: 1 N/V, gain_uncertainty: 0.3 %},"
        " plausible_peak: {from: 500 mN, to: 2 kN}}}"
    ).channels["force"]

    assert channel.channel == ("a", "b")
    assert channel.peak_range == (0.5, 2000.0)
    assert channel.gain_uncertainty == pytest.approx(0.005, rel=1e-12)


@pytest.mark.parametrize("name", ["Load", "[Load]", '"Load"'])
def test_one_name_is_written_as_one_name(tube: str, name: str) -> None:
    protocol = parse_protocol(tube.replace("[Load, Force]", name), "p.yaml")

    assert protocol.channels["force"].channel == ("Load",)
    assert "channel: Load\n" in dump_protocol(protocol)


def test_the_si_unit_of_a_dimension() -> None:
    assert si_unit_like("mV") == "V"
    assert si_unit_like("fortnight") is None
    assert set(READERS) > MARKER_READERS
