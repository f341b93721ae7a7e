"""Recorders that were started together, and some that were not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest

from labpipe.process.clock_joining import start_together
from labpipe.process.motion import turning_points
from labpipe.protocol.schema import AlignCommonStart
from labpipe.records.curve import ClockFit
from labpipe.records.quality import Findings
from labpipe.records.signals import Signal
from labpipe.signal.turning_points import find_strokes
from tests.builders.doubts import doubted

ALIGN = AlignCommonStart.model_validate(
    {"method": "common-start", "channel": "force", "max_offset": "100 ms"}
)


def seen(
    offset: float, *, noise: float = 0.01, seed: int = 0, drift: float = 0.0
) -> tuple[Signal, Signal]:
    """Motion and force: 30 s up and down again, the force bending over as it goes."""
    random = np.random.default_rng(seed)
    frame, force = np.arange(0.0, 62.0, 0.05), np.arange(0.0, 64.0, 0.005)

    def path(time: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Signal:
        travel = 0.5e-3 * np.clip(30.0 - np.abs(time - 30.0), 0.0, None)
        return Signal(time, travel, "m", "frame")

    motion, pulled = path(frame), path((force - offset) / (1.0 + drift)).values
    way = motion.values + random.normal(0.0, 2e-6, len(frame))
    load = 4.0 * (pulled / 0.015) ** 0.7 + random.normal(0.0, noise, len(force))
    return replace(motion, values=way), Signal(force, load, "N", "force")


def fitted(motion: Signal, force: Signal) -> tuple[ClockFit, Findings]:
    strokes = find_strokes(motion.time, motion.values, min_stroke=5e-3)
    turns = turning_points(motion, strokes, window=ALIGN.motion_window)
    fit, found = start_together(force, ALIGN, motion, strokes, turns)
    return fit, Findings() + found


def test_a_sharp_corner_decides() -> None:
    fit, found = fitted(*seen(0.04, noise=1e-3))

    assert fit.offset_interval.lower < 0.04 < fit.offset_interval.upper
    assert fit.offset == pytest.approx(0.04, abs=0.01)
    assert fit.drift == pytest.approx(0.0, abs=1e-5)
    assert fit.drift_interval.standard_error == pytest.approx(1e-4 / np.sqrt(3.0), rel=0.05)
    assert [note.code for note in found.notes] == ["common_start"]
    assert not found.doubts


def test_a_constant_force_is_said_by_its_cause() -> None:
    motion, force = seen(0.0)
    _, found = fitted(motion, replace(force, values=0.0 * force.values + 0.25))
    assert str(found.blocked) == (
        "constant_channel: the force is constant at 0.25 N: is it the right channel, and is the "
        "cell connected?"
    )


def test_a_start_that_is_far_off_is_told_in_seconds() -> None:
    _, found = fitted(*seen(3.0))
    assert doubted(found.found)["clock"].startswith(
        "not_started_together: the force turns 2.99 s after the motion, known to "
    )


def test_a_reversed_bridge_turns_at_the_same_time() -> None:
    motion, force = seen(0.04, noise=1e-3)
    usual, _ = fitted(motion, force)
    other, found = fitted(motion, replace(force, values=-force.values))
    assert other.offset == pytest.approx(usual.offset, abs=1e-9)
    assert not found.doubts


def test_a_force_without_corner_leaves_the_common_start() -> None:
    motion, force = seen(0.0)
    fit, found = fitted(motion, replace(force, values=np.linspace(0.0, 1.0, len(force.time))))

    assert fit.offset == 0.0
    assert fit.offset_interval.standard_error == pytest.approx(0.1 / np.sqrt(3.0))
    (note,) = found.notes
    assert note.code == "start_unchecked"
    assert note.message == (
        "the force shows no corner at a turn of the motion: the common start, within 100 ms, is "
        "taken as it is"
    )


@pytest.mark.parametrize(("offset", "word"), [(0.8, "after"), (-0.8, "before")])
def test_not_started_together(offset: float, word: str) -> None:
    fit, found = fitted(*seen(offset, noise=1e-3))

    assert fit.offset == pytest.approx(offset, abs=0.02)
    assert set(doubted(found.found)) == {"clock", "force"}
    message = doubted(found.found)["clock"]
    assert message.startswith("not_started_together: the force turns ")
    assert f" ms {word} the motion, known to " in message
    assert message.endswith(
        ": the recorders did not start within 100 ms of each other; the difference at the turn is "
        "taken"
    )


@pytest.mark.slow
def test_the_interval_covers_over_many_tests() -> None:
    """Offsets drawn from what the trigger allows; the exact binomial test at 1 %."""
    random = np.random.default_rng(5)
    truths = random.uniform(-0.1, 0.1, 60)
    hits = 0
    for seed, truth in enumerate(truths):
        interval = fitted(*seen(float(truth), noise=0.02, seed=seed))[0].offset_interval
        hits += interval.lower <= truth <= interval.upper
    assert binomtest(hits, len(truths), 0.95).pvalue > 0.01
