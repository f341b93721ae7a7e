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
from labpipe.readers.time_axes import clock_notes, find_holes
from labpipe.records.arrays import Floats
from labpipe.records.quality import Severity
from labpipe.records.recording import Clock
from tests.approved import Approve

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


NEARLY = [("Ch 1 Force", "Ch 1 Force"), ("Ch 2 Force", "Ch 2 Force")]


def test_names_that_are_refused(approved: Approve) -> None:
    """Of several channels, wrong ones with the nearest first, of none, nearly of two."""
    messages = []
    for wanted, channels in (
        ("In1", KNOWN),
        ("Model Root/Load Cel/In1", KNOWN),
        ("Out1", []),
        (("Load", "Force"), NEARLY),
    ):
        with pytest.raises(NoChannelError) as refused:
            find_channel(wanted, channels, "force.mat")
        messages.append(refused.value)
    approved(messages)


@pytest.mark.parametrize("name", ["Chkraft", "C1kraft", "Kraft 1", "Last", "", "_"])
def test_other_names_are_others(name: str) -> None:
    with pytest.raises(NoChannelError, match="found no such channel"):
        find_channel("Kraft", [(name, name)], "frame.csv")


def codes(time: np.ndarray, name: str = "time", *, is_variable: bool = False) -> dict[str, str]:
    notes = clock_notes(Clock(name, time), is_variable=is_variable)
    return {note.code: note.message for note in notes}


@given(lost=st.lists(st.integers(2, 90), unique=True, max_size=8), step=st.floats(1e-4, 1.0))
def test_lost_samples_are_holes(lost: list[int], step: float) -> None:
    numbers = np.delete(np.arange(100.0), lost)
    holes = find_holes(numbers * step)
    edges = [int(n) for n, m in pairwise(numbers) if m - n > 1]
    assert [hole.at for hole in holes] == pytest.approx([n * step for n in edges])
    assert sum(round(hole.length / step) - 1 for hole in holes) == len(lost)


def test_a_late_sample_is_jitter_and_not_a_hole() -> None:
    time = np.arange(100.0)
    time[50] += 0.6
    assert find_holes(time) == ()
    assert codes(time)["time_jitter"] == "steps from 400 ms to 1.6 s around 1 s without loss"


def test_a_hole_is_told_with_its_losses() -> None:
    time = np.delete(np.arange(100) * 0.001, [40, 41, 42])
    assert codes(time)["time_holes"] == (
        "1 holes of 4 ms to 4 ms, about 3 samples lost, first at 0.039 s"
    )


def test_long_steps_mean_nothing_where_samples_are_written_on_change() -> None:
    time = np.array([0.0, 1.0, 2.0, 9.0, 10.0])
    assert "time_holes" in codes(time)
    assert codes(time, "OnChange") == {}


REDUCED = np.concatenate([np.arange(100) * 0.01, 1.0 + np.arange(20) * 0.25])
"""Ten milliseconds, then a quarter of a second, as a program that changes its rate writes."""


def test_a_rate_that_varies_loses_nothing_where_the_program_varies_it() -> None:
    assert codes(REDUCED, is_variable=True) == {
        "time_variable": (
            "steps from 10 ms to 250 ms around 10 ms; the program samples at a variable rate"
        )
    }
    assert codes(np.arange(100) * 0.01, is_variable=True) == {}


def test_so_many_long_steps_that_they_need_not_be_losses() -> None:
    (note,) = clock_notes(Clock("time", REDUCED))
    assert note.severity is Severity.WARNING
    assert note.message == (
        "steps from 10 ms to 250 ms around 10 ms; 19 of 119 are long: the rate varies, or samples"
        " were lost"
    )


NOTED: list[tuple[Floats, dict[str, str]]] = [
    (
        np.array([0.0, 1.0, 1.0, 2.0, 3.0]),
        {"time_repeats": "1 time stamps repeat the one before, first at sample 3 (1 s)"},
    ),
    (np.zeros(5), {"time_repeats": "4 time stamps repeat the one before, first at sample 2 (0 s)"}),
    (np.array([-1.0, 0.0, 1.0]), {"time_start_not_zero": "time starts at -1 s, not at 0"}),
    (np.empty(0), {"clock_empty": "it has no samples"}),
    (np.zeros(1), {}),
    (np.arange(10000) / 120.0, {}),
    (
        np.array([0.0, 1.0, 2.0, 3.0, 0.5, 5.0, 6.0]),
        {
            "time_not_increasing": (
                "time runs backwards 1 times, first at sample 5: 0.5 s after 3 s"
            )
        },
    ),
    (
        np.array([0.0, 1.0, np.nan]),
        {"time_not_finite": "1 time stamps are not numbers, the first at sample 3"},
    ),
]


@pytest.mark.parametrize(("time", "expected"), NOTED)
def test_what_is_noted_of_a_clock(time: Floats, expected: dict[str, str]) -> None:
    messages = codes(time)
    assert {code: messages.get(code) for code in expected} == expected
    assert bool(messages) == bool(expected)
    for note in clock_notes(Clock("time", time)):
        assert (note.severity is Severity.ERROR) == (
            note.code in ("time_not_increasing", "time_not_finite")
        )


def test_a_step_that_is_not_the_nominal_one() -> None:
    message = codes(np.arange(10000) * 0.99985e-3)["step_not_nominal"]
    assert message.startswith("mean step 0.99985 ms where 1 ms is nominal")
    assert message.endswith("wrong by 0.0015 s at the end")
