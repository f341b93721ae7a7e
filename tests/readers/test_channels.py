from __future__ import annotations

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers.channels import (
    NoChannelError,
    channel_notes,
    find_channel,
    is_as_written,
    select_channel,
    unique_names,
)
from labpipe.records.recording import Channel, Recording

KNOWN = [
    ("Out1", '"Model Root"/"u1"/"Out1"'),
    ("In1", "Model Root/Laser Sensor\\n/laser_raw/In1"),
    ("In1", "Model Root/Load Cell/In1"),
    ("ADC", "Model Root/DS1103ADC_C18/ADC"),
]


@pytest.mark.parametrize(
    ("wanted", "index"),
    [
        ('"Model Root"/"u1"/"Out1"', 0),
        ("Model Root/u1/Out1", 0),
        ("Out1", 0),
        ("Model Root/Laser Sensor\\n/laser_raw/In1", 1),
        ("Model Root/Laser Sensor/laser_raw/In1", 1),
        ("Model Root/Laser Sensor\n/laser_raw/In1", 1),
        ('"Model Root"/"Load Cell"/"In1"', 2),
        ("ADC", 3),
    ],
)
def test_names_that_stand_for_one_channel(wanted: str, index: int) -> None:
    assert find_channel(wanted, KNOWN, "force.mat") == index


def test_a_name_that_several_channels_have() -> None:
    expected = (
        r"force\.mat, channel 'In1': expected a name that only one channel has, found 2 channels"
        r" of that name\. Give the full path, one of: 'Model Root/Laser Sensor\\n/laser_raw/In1',"
        r" 'Model Root/Load Cell/In1'\."
    )
    with pytest.raises(ReadError, match=expected):
        find_channel("In1", KNOWN, "force.mat")


def test_a_wrong_name_brings_the_nearest_first() -> None:
    expected = (
        r"channel 'Model Root/Load Cel/In1': expected one of the 4 channels of the file, found no"
        r" such channel\. Nearest: 'Model Root/Load Cell/In1', .*`labpipe inspect` lists them all"
    )
    with pytest.raises(ReadError, match=expected):
        find_channel("Model Root/Load Cel/In1", KNOWN, "force.mat")
    with pytest.raises(ReadError, match=r"The file holds no channels\.$"):
        find_channel("Out1", [], "force.mat")


@pytest.mark.parametrize(
    ("wanted", "index"),
    [
        (("ADC", "Out1"), 3),
        (("Out1", "ADC"), 0),
        (("Load", "Force", "ADC"), 3),
        (("adc", "Out1"), 0),
        (("Nothing", "Model Root/Load Cell/In1", "In1"), 2),
        (("Out1",), 0),
    ],
)
def test_of_several_names_the_first_that_is_there_counts(
    wanted: tuple[str, ...], index: int
) -> None:
    assert find_channel(wanted, KNOWN, "force.mat") == index


def test_a_name_of_several_channels_is_not_passed_over() -> None:
    with pytest.raises(ReadError, match=r"channel 'In1': expected a name that only one channel"):
        find_channel(("Load", "In1", "ADC"), KNOWN, "force.mat")


def test_none_of_several_names() -> None:
    expected = (
        r"^frame\.csv, channel 'Lod' or 'Forse': expected one of the 3 channels of the file, found"
        r" no such channel\. Nearest: 'Load', .*'Force'.*\. `labpipe inspect` lists them all\.$"
    )
    known = [(name, name) for name in ("Time", "Load", "Force")]
    with pytest.raises(ReadError, match=expected):
        find_channel(("Lod", "Forse"), known, "frame.csv")
    with pytest.raises(ReadError, match=r"channel 'A' or 'B': .*The file holds no channels\.$"):
        find_channel(("A", "B"), [], "frame.csv")


def test_the_nearest_are_listed_once_and_not_all_of_many() -> None:
    known = [(f"Load {number}", f"Load {number}") for number in range(9)]
    with pytest.raises(ReadError, match="expected one of the 9 channels") as info:
        find_channel(("Load", "Load x"), known, "frame.csv")
    nearest = str(info.value).split("Nearest: ")[1].split(". `labpipe")[0].split(", ")
    assert len(nearest) == len(set(nearest)) == 5


def test_the_channel_itself() -> None:
    channels = tuple(Channel(name, path, np.zeros(2)) for name, path in KNOWN)
    recording = Recording(reader="dspace-mat", channels=channels)
    assert select_channel(recording, "ADC", "force.mat") is channels[3]
    assert select_channel(recording, ("Load", "ADC"), "force.mat") is channels[3]


def test_many_names_are_not_all_listed() -> None:
    names = tuple(f"N{i}" for i in range(9))
    with pytest.raises(ReadError, match=r"channel 'N0' or 'N1' or .* or 'N5' or 3 more: expected"):
        find_channel(names, KNOWN, "frame.csv")


OF_FRAMES = [
    (name, name)
    for name in ("Ch 1 Kraft", "Ch 1 Kraft Sollwert", "C_1_Déplacement", "_Load", "Traverse abs.")
]


@pytest.mark.parametrize(
    ("wanted", "index"),
    [
        ("Kraft", 0),
        ("kraft sollwert", 1),
        ("Déplacement", 2),
        ("DEPLACEMENT", 2),
        ("Load", 3),
        ("Traverse_abs", 4),
        (("Force", "Load", "Kraft"), 3),
    ],
)
def test_a_name_that_a_program_puts_more_before(wanted: str | tuple[str, ...], index: int) -> None:
    assert find_channel(wanted, OF_FRAMES, "frame.csv") == index


def test_a_name_as_written_goes_before_one_that_is_nearly_so() -> None:
    known = [("_Load", "_Load"), ("Kraft", "Kraft"), ("load", "load")]
    assert find_channel(("Load", "Kraft"), known, "frame.csv") == 1
    assert find_channel("load", known, "frame.csv") == 2


def test_two_that_are_nearly_so() -> None:
    known = [("Ch 1 Force", "Ch 1 Force"), ("Ch 2 Force", "Ch 2 Force")]
    with pytest.raises(NoChannelError, match=r"found 2 channels of that name.*'Ch 1 Force', 'Ch 2"):
        find_channel(("Load", "Force"), known, "frame.csv")


@pytest.mark.parametrize("name", ["Chkraft", "C1kraft", "Kraft 1", "Last", "", "_"])
def test_other_names_are_others(name: str) -> None:
    with pytest.raises(NoChannelError, match="found no such channel"):
        find_channel("Kraft", [(name, name)], "frame.csv")


def test_whether_a_channel_is_called_as_written() -> None:
    channel = Channel("_Load", "_Load", np.zeros(3))
    assert is_as_written(("Kraft", "_Load"), channel)
    assert not is_as_written(("Kraft", "Load"), channel)


def test_names_are_made_unique() -> None:
    assert unique_names(["F", "", "F"]) == ["F [1]", "column 2", "F [2]"]


def test_notes_on_channels() -> None:
    values = {"A/F": np.arange(4.0), "B/F": np.full(4, 2.0), "C/gone": np.full(4, np.nan)}
    units = {"A/F": "N"}
    channels = [
        Channel(path[2:], path, each, clock="time", unit_in_file=units.get(path, ""))
        for path, each in values.items()
    ]
    found = {note.code: note.message for note in channel_notes(channels)}
    assert found["constant_channel"] == "1 of 3 channels never change: 'B/F'"
    assert found["units_not_stated"] == "no unit is stated for 2 of 3 channels: 'B/F', 'C/gone'"
    assert found["names_not_unique"].startswith("of 3 channels 2 are called 'F': ")
    assert channel_notes(channels[:1]) == []
