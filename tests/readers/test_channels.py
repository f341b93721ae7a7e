"""Names of channels, and what is noted of times."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.readers.channels import (
    NoChannelError,
    find_channel,
)
from labpipe.readers.recording_checks import find_holes, make_clock_notes
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Clock
from tests.approved import Approve

KNOWN = [
    ("Out1", '"Model Root"/"u1"/"Out1"'),
    ("In1", "Model Root/Laser Sensor\\n/laser_raw/In1"),
    ("In1", "Model Root/Load Cell/In1"),
    ("ADC", "Model Root/DS1103ADC_C18/ADC"),
]


OF_FRAMES = [
    (name, name)
    for name in ("Ch 1 Kraft", "Ch 1 Kraft Sollwert", "C_1_Déplacement", "_Load", "Traverse abs.")
]


def test_names_that_are_refused(approved: Approve) -> None:
    """Of several channels, wrong ones with the nearest first, of none, nearly of two."""
    messages = []
    for name, channels in (
        ("In1", KNOWN),
        ("Model Root/Load Cel/In1", KNOWN),
        ("Out1", []),
        (("Load", "Force"), [("Ch 1 Force", "Ch 1 Force"), ("Ch 2 Force", "Ch 2 Force")]),
    ):
        with pytest.raises(NoChannelError) as refused:
            find_channel(name, channels, "force.mat")
        messages.append(refused.value)
    approved(messages)


@pytest.mark.parametrize(
    ("wanted", "channels", "index"),
    [
        ('"Model Root"/"u1"/"Out1"', KNOWN, 0),
        ("Model Root/u1/Out1", KNOWN, 0),
        ("Out1", KNOWN, 0),
        ("Model Root/Laser Sensor\\n/laser_raw/In1", KNOWN, 1),
        ("Model Root/Laser Sensor/laser_raw/In1", KNOWN, 1),
        ("Model Root/Laser Sensor\n/laser_raw/In1", KNOWN, 1),
        ('"Model Root"/"Load Cell"/"In1"', KNOWN, 2),
        ("ADC", KNOWN, 3),
        ("Kraft", OF_FRAMES, 0),
        ("kraft sollwert", OF_FRAMES, 1),
        ("Déplacement", OF_FRAMES, 2),
        ("DEPLACEMENT", OF_FRAMES, 2),
        ("Load", OF_FRAMES, 3),
        ("Traverse_abs", OF_FRAMES, 4),
        (("Force", "Load", "Kraft"), OF_FRAMES, 3),
    ],
)
def test_names_that_stand_for_one_channel(
    wanted: str | tuple[str, ...], channels: list[tuple[str, str]], index: int
) -> None:
    """By a path or the last part of it; frames put more before a name."""
    assert find_channel(wanted, channels, "force.mat") == index


@pytest.mark.parametrize("name", ["Chkraft", "C1kraft", "Kraft 1", "Last", "", "_"])
def test_other_names_are_others(name: str) -> None:
    with pytest.raises(NoChannelError, match="found no such channel"):
        find_channel("Kraft", [(name, name)], "frame.csv")


@given(lost=st.lists(st.integers(2, 90), unique=True, max_size=8), step=st.floats(1e-4, 1.0))
def test_lost_samples_are_holes(lost: list[int], step: float) -> None:
    numbers = np.delete(np.arange(100.0), lost)
    holes = find_holes(numbers * step)
    edges = [int(n) for n, m in pairwise(numbers) if m - n > 1]
    assert [hole.time for hole in holes] == pytest.approx([n * step for n in edges])
    assert sum(round(hole.duration / step) - 1 for hole in holes) == len(lost)


def late(at: int, by: float) -> Floats:
    time: Floats = np.arange(100.0)
    time[at] += by
    return time


REDUCED: Floats = np.concatenate([np.arange(100) * 0.01, 1.0 + np.arange(20) * 0.25])
"""Ten milliseconds, then a quarter of a second, as a program that changes its rate writes."""
MANY: Floats = np.arange(10000.0)
ON_CHANGE = np.array([0.0, 1.0, 2.0, 9.0, 10.0])
CLOCKS: dict[str, tuple[Clock, bool]] = {
    "a late sample": (Clock("time", late(50, 0.6)), False),
    "lost samples": (Clock("time", np.delete(np.arange(100) * 0.001, [40, 41, 42])), False),
    "long steps": (Clock("time", ON_CHANGE), False),
    "written on change": (Clock("OnChange", ON_CHANGE), False),
    "a rate that varies, not stated": (Clock("time", REDUCED), False),
    "a rate that varies": (Clock("time", REDUCED), True),
    "a rate that might vary": (Clock("time", REDUCED[:100]), True),
    "repeated": (Clock("time", np.array([0.0, 1.0, 1.0, 2.0, 3.0])), False),
    "all the same": (Clock("time", np.zeros(5)), False),
    "before zero": (Clock("time", np.array([-1.0, 0.0, 1.0])), False),
    "empty": (Clock("time", np.empty(0)), False),
    "one sample": (Clock("time", np.zeros(1)), False),
    "frames": (Clock("time", MANY / 120.0), False),
    "backwards": (Clock("time", np.array([0.0, 1.0, 2.0, 3.0, 0.5, 5.0, 6.0])), False),
    "no number": (Clock("time", np.array([0.0, 1.0, np.nan])), False),
}
"""A clock, and whether its program varies the rate."""


def test_what_is_noted_of_a_clock(approved: Approve) -> None:
    assert find_holes(late(50, 0.6)) == ()
    approved(
        f"{what}: {note.severity} {note.code} {note.message}"
        for what, (clock, is_variable) in CLOCKS.items()
        for note in [*make_clock_notes(clock, is_variable=is_variable)] or [NOTHING]
    )


NOTHING = QualityNote("none", Severity.INFO, "time", "")
