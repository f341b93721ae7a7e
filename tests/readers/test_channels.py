from __future__ import annotations

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers.channels import find_channel, select_channel
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


def test_the_channel_itself() -> None:
    channels = tuple(Channel(name, path, np.zeros(2)) for name, path in KNOWN)
    recording = Recording(reader="dspace-mat", channels=channels)
    assert select_channel(recording, "ADC", "force.mat") is channels[3]
