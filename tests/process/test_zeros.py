"""Zeros from the rest that there is, records that begin under load, zeros that change."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from labpipe.process.motion import Motion
from labpipe.process.reading import convert_channels
from labpipe.process.steps import (
    average_level,
    compute_min_zero_samples,
    estimate_level_before_motion,
    fit_end_level,
    rezero_at_rest,
)
from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, ClockFit, Direction, Interval
from labpipe.records.result import Result, Status
from labpipe.records.signals import Clocks, Signal, Signals
from labpipe.results.kinds import ReducedTest
from labpipe.virtual_lab import observe
from tests.builders.small_tests import small_scenario
from tests.builders.tensile_tests import recordings_of

TIME: Floats = np.arange(0.0, 50.0, 0.02)


BRANCHES = (
    Branch(50, 1250, 1, Direction.LOADING, 1.0, 25.0),
    Branch(1250, 2450, 1, Direction.UNLOADING, 25.0, 49.0),
)


NOWHERE = Interval(float("nan"), float("nan"))


MOTION = Motion(Signal(TIME, 0.0 * TIME, "m", "frame"), BRANCHES, Clocks("frame"))


def zeroed(stretch: tuple[float, float], clock: str = "frame") -> Signals:
    """A signal that stands at a level for a second, and was zeroed over two by mistake."""
    rise = np.interp(TIME, [1.0, 25.0, 49.0], [0.0, 24.0, 0.0])
    scatter = np.random.default_rng(5).normal(0.0, 1e-3, len(TIME))
    signal = Signal(TIME, 0.7 + rise + scatter, "N", clock)
    signals = Signals().add_signal("displacement", Signal(TIME, 1e-3 * rise, "m", "frame"))
    signals = signals.add_signal("force", signal)
    signals = signals.replace_filtered("force", replace(signal, values=signal.values + 0.01))
    return replace(signals, zero_stretches={"force": stretch})


def test_a_stretch_that_reaches_into_the_motion_is_cut() -> None:
    signals, findings = rezero_at_rest(zeroed((0.0, 2.0)), MOTION)
    assert signals.zero_stretches["force"] == (0.0, 1.0)
    force = signals.raw["force"]
    assert abs(float(force.values[TIME <= 1.0].mean())) < 1e-12
    assert force.zero_error == pytest.approx(1e-3 / np.sqrt(51), rel=0.8)
    apart = signals.filtered["force"].values - force.values
    np.testing.assert_allclose(apart, 0.01, atol=1e-12)
    (note,) = (finding.note for finding in findings)
    assert (note.code, note.where, note.severity.value) == ("short_rest", "force", "info")
    assert note.message == (
        "the machine rests for 1.00 s, less than the 2 s of the zero: the zero is the mean over "
        "these 1.00 s"
    )


def test_on_the_clock_of_the_signal() -> None:
    fit = ClockFit(0.5, 0.0, NOWHERE, NOWHERE, 0.0, TIME, TIME, TIME, "")
    motion = replace(MOTION, clocks=Clocks("frame", fit))
    signals, _ = rezero_at_rest(zeroed((0.0, 2.0), "force"), motion)
    assert signals.zero_stretches["force"] == (0.0, 1.5)


@pytest.mark.parametrize(
    "stretch", [(0.0, 0.9), (0.9, 2.0), (2.0, 4.0)], ids=["at rest", "too short", "in motion"]
)
def test_what_stays(stretch: tuple[float, float]) -> None:
    """At rest all of it, or with less than eight samples at rest: then the zero is doubted."""
    prepared = zeroed(stretch)
    for branches in (BRANCHES, ()):
        signals, findings = rezero_at_rest(prepared, replace(MOTION, branches=branches))
        assert signals is prepared
        assert not findings


def test_levels_hold_in_their_errors() -> None:
    """Twenty samples of noise that remembers: the record beside says how far."""
    pulls = []
    for seed in range(100):
        white = np.random.default_rng(seed).normal(0.0, 1.0, 620)
        noise = np.convolve(white, np.ones(5) / 5.0, "valid")
        mean, mean_error = average_level(noise[:20], noise[20:])
        end, end_error = fit_end_level(noise[:20], noise[20:])
        pulls.append((mean / mean_error, end / end_error))
    held = np.mean(np.abs(pulls) <= 1.96, axis=0)
    assert (held >= 0.93).all(), held
    assert (np.std(pulls, axis=0) > 0.4).all()


def reduced_wire(repository: Path, *, rest: float) -> tuple[ReducedTest, dict[str, Result]]:
    usual = small_scenario(cycles=3)
    scenario = replace(
        usual,
        rest=rest,
        clocks=replace(usual.clocks, offset=0.0),
        load_cell=replace(usual.load_cell, noise=5e-4),
    )
    text = (repository / "protocols" / "wire-cantilever.yaml").read_text(encoding="utf-8")
    text = text.replace("crosshead_speed: 1 mm/s", "crosshead_speed: 4 mm/s")
    plan, seen = parse_protocol(text, "p.yaml"), recordings_of(observe(scenario, 4))
    force = convert_channels(seen["force"], plan.sources["force"], Path("force.mat"))
    reduced = reduce_recordings({"force": force, "markers": seen["markers"]}, plan)
    return reduced.reduced_test, {result.name: result for result in reduced.results}


@pytest.mark.slow
def test_short_rests_leave_results_as_good(repository: Path) -> None:
    """Of cameras and of the force recorder, each shorter than the 2 s asked for; 20 ms are none."""
    _, whole = reduced_wire(repository, rest=2.5)
    test, short = reduced_wire(repository, rest=0.6)
    assert [n.where for n in test.findings.notes if n.code == "short_rest"] == ["markers", "force"]
    for name in ("peak_force.1", "peak_displacement.1", "bending_stiffness_at_3"):
        (result, usual) = short[name], whole[name]
        assert result.status is usual.status is Status.OK, result.reason_text
        assert result.value == pytest.approx(usual.value, rel=0.02)
    test, results = reduced_wire(repository, rest=0.02)
    assert ("force", "zero_not_at_rest") in {
        (doubt.quantity, doubt.reason.code) for doubt in test.findings.doubts
    }
    assert results["peak_force.1"].status is Status.DOUBTFUL


def test_a_short_record_says_nothing_of_its_noise() -> None:
    assert (compute_min_zero_samples(TIME[:24]), compute_min_zero_samples(TIME[:25])) == (8, 3)


@pytest.mark.parametrize("rest", [0, 2, 5, 20, 100, 199])
@pytest.mark.parametrize("beside", [0, 400])
def test_a_line_over_rest_and_motion(rest: int, beside: int) -> None:
    """What the outer end of one line says is off by up to a quarter of the way."""
    number: Floats = np.arange(200.0 + beside)
    noise = np.random.default_rng(8).normal(0.0, 1e-3, len(number))
    values: Floats = 0.7 + 0.01 * np.clip(number - rest, 0.0, None) + noise
    level, error, rested = estimate_level_before_motion(values[:200], values[200:])
    assert rested == (pytest.approx(rest, abs=2) if rest >= 20 and rest < 199 else rested)
    assert abs(level - 0.7) < 4.0 * error
    assert error < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.0, 0.5])
def test_zeros_of_few_samples_hold_in_a_short_record(memory: float) -> None:
    """Of 300 records of 60 samples, as a quick pull at 10 Hz leaves them."""
    held = 0
    for seed in range(300):
        white = np.random.default_rng(seed).normal(0.0, np.sqrt(1.0 - memory**2), 160)
        noise = lfilter([1.0], [1.0, -memory], white)[100:]
        rising = noise + 0.5 * np.arange(60.0)
        level, error = fit_end_level(rising[:3], rising[3:])
        held += abs(level) <= 1.96 * error
    assert 273 <= held <= 297  # 91 of 100
