"""What tests of load-frame exports ask of a recording, or of a file that is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers import read_export
from labpipe.records.arrays import Floats
from labpipe.records.recording import Channel, Recording
from tests.builders.load_frames import FORCE, TIME, TRAVEL

Written = Callable[..., Path]
"""Gives the path of a file with some content, and a name if it is to have one."""


def channel(recording: Recording, name: str) -> Channel:
    named = [channel for channel in recording.channels if name in (channel.name, channel.path)]
    assert len(named) == 1, f"{name} not once in {[channel.path for channel in recording.channels]}"
    return named[0]


def time(recording: Recording) -> Floats:
    (clock,) = recording.clocks
    assert clock.unit == "s"
    return clock.time


def holds(
    recording: Recording, *, force: tuple[str, str, float], travel: tuple[str, str, float]
) -> None:
    """The synthetic pull, force and travel as (name, unit in file, factor from N or mm)."""
    np.testing.assert_allclose(time(recording), TIME, rtol=1e-6)
    for (name, unit, factor), truth in ((force, FORCE), (travel, TRAVEL)):
        column = channel(recording, name)
        assert column.unit_in_file == unit
        np.testing.assert_allclose(column.values, factor * truth, rtol=1e-5, atol=1e-9)


def codes(recording: Recording) -> set[str]:
    return {note.code for note in recording.notes}


def refused(file: Path, *parts: str, **how: Any) -> str:
    """Refuse a file in the grammar of the house; give back the message."""
    with pytest.raises(ReadError) as caught:
        read_export(file, "load-frame", **how)
    text = str(caught.value)
    grammar = rf"{re.escape(str(file))}(, [^\n]+?)?: expected [^\n]+, found [^\n]+\. [^\n]+\."
    assert re.fullmatch(grammar, text), text
    for word in parts:
        assert word in text, text
    return text
