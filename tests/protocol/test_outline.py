from __future__ import annotations

import pytest

from labpipe.protocol.load import parse_protocol
from tests.protocol.conftest import Told

GAIN = "gain: 0.5 N/V"
CASES = {
    "gain in another unit": (
        (GAIN, "gain: 0.5 mm/V"),
        "p.yaml, line 8, column 25 (sources.force.calibration.gain): expected a quantity with a"
        " unit such as N/V, found '0.5 mm/V'. Write it with its unit, such as '0.5 N/V'.",
    ),
    "gain without unit": (
        (GAIN, "gain: 0.5"),
        "p.yaml, line 8, column 25 (sources.force.calibration.gain): expected a quantity with a"
        " unit such as N/V, found '0.5'. Write it with its unit, such as '0.5 N/V'.",
    ),
    "gain of zero": (
        (GAIN, "gain: 0 N/V"),
        "p.yaml, line 8, column 25 (sources.force.calibration.gain): expected a gain other than"
        " zero, found '0 N/V'. Correct it.",
    ),
    "offset in another unit": (
        ("offset: 0 N", "offset: 0 V"),
        "p.yaml, line 8, column 42 (sources.force.calibration.offset): expected a quantity with a"
        " unit such as N, found '0 V'. V is a unit of voltage."
        " Write it with its unit, such as '0.5 N'.",
    ),
    "no unit of the channel": (
        ("    unit: V\n", ""),
        "p.yaml, line 5, column 5 (sources.force): expected the unit that the calibration starts"
        " from, found none. Add the key 'unit', such as V.",
    ),
    "a wrong unit without the right one": (
        (
            "    unit: V\n    calibration: {gain: 0.5 N/V, offset: 0 N, gain_uncertainty: 0.2 %}\n",
            "    wrong_unit_in_file: kN\n",
        ),
        "p.yaml, line 7, column 25 (sources.force.wrong_unit_in_file): expected the right unit"
        " beside it, found none. Add the key 'unit', such as N.",
    ),
    "unknown unit": (
        ("    unit: V\n", "    unit: Volts per N\n"),
        "p.yaml, line 7, column 11 (sources.force.unit): expected a unit such as V, found"
        " 'Volts per N'. Write the unit alone.",
    ),
    "unit of another dimension": (
        ("    calibration: {gain: 0.5 N/V, offset: 0 N, gain_uncertainty: 0.2 %}\n", ""),
        "p.yaml, line 7, column 11 (sources.force.unit): expected a unit of force such as N, found"
        " 'V'. V is a unit of voltage. Correct it, or add a 'calibration'.",
    ),
    "two ways at once": (
        ("    unit: V\n", "    unit: V\n    channels: {load: {channel: x, quantity: force}}\n"),
        "p.yaml, line 6, column 14 (sources.force.channel): expected 'channels' alone, found"
        " 'channel' beside it. Move it into 'channels'.",
    ),
    "no channel": (
        ("    channel: Model Root/Load/Out1\n", ""),
        "p.yaml, line 5, column 5 (sources.force): expected the name of a channel, found none."
        " Add the key 'channel', or 'channels' for several.",
    ),
    "markers with a channel": (
        ("    reader: motive-csv\n", "    reader: motive-csv\n    channel: x\n"),
        "p.yaml, line 11, column 14 (sources.markers.channel): expected no channels beside marker"
        " tracks, found the key 'channel'. Remove it.",
    ),
    "markers from a signal reader": (
        ("    reader: motive-csv\n", "    reader: dspace-mat\n"),
        "p.yaml, line 10, column 13 (sources.markers.reader): expected a reader of marker tracks,"
        " found 'dspace-mat'. Use one of 'motive-csv', 'motive-xlsx'.",
    ),
    "force from a marker reader": (
        ("[dspace-mat, dspace-csv]", "motive-csv"),
        "p.yaml, line 5, column 13 (sources.force.reader): expected a reader of channels, found"
        " 'motive-csv'. Use one of 'dspace-csv', 'dspace-mat', 'dspace-mf4', 'load-frame'.",
    ),
    "quantity unknown": (
        ("    unit: V\n", "    unit: V\n    quantity: forse\n"),
        "p.yaml, line 8, column 15 (sources.force.quantity): expected one of the quantities"
        " 'force', 'pressure', 'frequency', 'speed', 'moment', 'travel', ..., found 'forse'."
        " Did you mean 'force'?",
    ),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_wrong_source_is_told(case: tuple[tuple[str, str], str], told: Told) -> None:
    change, message = case

    assert message in told(change)


PEAK = "plausible_peak: {from: 20 N, to: 2 kN}"
OF_TUBE = {
    "peak without unit": (
        (PEAK, "plausible_peak: {from: 20, to: 2 kN}"),
        "p.yaml, line 9, column 62 (sources.frame.channels.force.plausible_peak.from): expected a"
        " quantity with a unit such as N, found '20'. Write it with its unit, such as '20 N'.",
    ),
    "peak of another dimension": (
        (PEAK, "plausible_peak: {from: 20 N, to: 2 mm}"),
        "p.yaml, line 9, column 72 (sources.frame.channels.force.plausible_peak.to): expected a"
        " quantity with a unit such as N, found '2 mm'. mm is a unit of length."
        " Write it with its unit, such as '20 N'.",
    ),
    "peak the wrong way round": (
        (PEAK, "plausible_peak: {from: 2 kN, to: 20 N}"),
        "p.yaml, line 9, column 55 (sources.frame.channels.force.plausible_peak): expected 'from'"
        " of at least zero, and 'to' above it, found 2000 to 20 N. Correct them.",
    ),
    "peak of one number": (
        (PEAK, "plausible_peak: {from: 20 N, to: 20 N}"),
        "p.yaml, line 9, column 55 (sources.frame.channels.force.plausible_peak): expected 'from'"
        " of at least zero, and 'to' above it, found 20 to 20 N. Correct them.",
    ),
    "peak below zero": (
        (PEAK, "plausible_peak: {from: -1 N, to: 20 N}"),
        "p.yaml, line 9, column 55 (sources.frame.channels.force.plausible_peak): expected 'from'"
        " of at least zero, and 'to' above it, found -1 to 20 N. Correct them.",
    ),
    "peak with one end": (
        (PEAK, "plausible_peak: {from: 20 N}"),
        "p.yaml, line 9, column 55 (sources.frame.channels.force.plausible_peak): expected the key"
        " 'to', found no such key. Add the key 'to'.",
    ),
    "peak beside the channels": (
        ("    channels:\n", "    plausible_peak: {from: 1 N, to: 2 N}\n    channels:\n"),
        "p.yaml, line 8, column 21 (sources.frame.plausible_peak): expected 'channels' alone, found"
        " 'plausible_peak' beside it. Move it into 'channels'.",
    ),
    "dialect for another reader": (
        ("reader: load-frame", "reader: dspace-csv"),
        "p.yaml, line 6, column 5 (sources.frame.dialect): expected this key for the reader"
        " 'load-frame' alone, found the key 'dialect'. Remove it, or name the reader 'load-frame'.",
    ),
    "part for another reader": (
        ("reader: load-frame", "reader: [dspace-csv, dspace-mat]"),
        "p.yaml, line 7, column 5 (sources.frame.part): expected this key for the reader"
        " 'load-frame' alone, found the key 'part'. Remove it, or name the reader 'load-frame'.",
    ),
    "no dialect": (
        ("dialect: [mts-testsuite, table]", "dialect: []"),
        "p.yaml, line 6, column 14 (sources.frame.dialect): expected at least one entry, found an"
        " empty list.",
    ),
    "no name of a channel": (
        ("[Load, Force]", "[]"),
        "p.yaml, line 9, column 24 (sources.frame.channels.force.channel): expected at least one"
        " entry, found an empty list.",
    ),
    "nothing as the name of a channel": (
        ("[Load, Force]", "null"),
        "p.yaml, line 9, column 24 (sources.frame.channels.force.channel): expected text, found"
        " nothing.",
    ),
    "a block as one of the names": (
        ("[Load, Force]", "[Load, {a: b}]"),
        "p.yaml, line 9, column 31 (sources.frame.channels.force.channel.1): expected text, found"
        " a block of keys.",
    ),
}


@pytest.mark.parametrize("case", OF_TUBE.values(), ids=OF_TUBE)
def test_a_wrong_source_of_a_load_frame_is_told(
    case: tuple[tuple[str, str], str], told_of_tube: Told
) -> None:
    change, message = case

    assert message in told_of_tube(change)


def test_a_peak_of_an_unknown_quantity_is_told_once(told_of_tube: Told) -> None:
    lines = told_of_tube((PEAK, "quantity: forse, plausible_peak: {from: 3, to: 2}"))

    assert [line.split(": expected")[0] for line in lines] == [
        "p.yaml, line 9, column 49 (sources.frame.channels.force.quantity)"
    ]


def test_one_of_several_readers_is_enough_for_a_dialect(tube: str) -> None:
    text = tube.replace("reader: load-frame", "reader: [dspace-csv, load-frame]")

    assert parse_protocol(text, "p.yaml").sources["frame"].dialect == ("mts-testsuite", "table")


SECOND = "  frame: {reader: dspace-mat, channels: {%s: {channel: x}}}\n"


def test_a_name_that_says_no_quantity(told: Told) -> None:
    lines = told(("  markers:\n", SECOND % "load" + "  markers:\n"))

    assert len(lines) == 1
    assert lines[0].startswith(
        "p.yaml, line 9, column 48 (sources.frame.channels.load): expected to know what the channel"
        " measures, found no 'quantity'. Add 'quantity', one of "
    )


@pytest.mark.parametrize(("name", "taken"), [("force", "the source 'force'"), ("travel", "a step")])
def test_a_name_taken_twice(name: str, taken: str, told: Told) -> None:
    lines = told(("  markers:\n", SECOND % name + "  markers:\n"))

    assert lines == [
        f"p.yaml, line 9, column 42 (sources.frame.channels.{name}): expected a name that {taken}"
        f" has not taken, found '{name}'. Rename it."
    ]
