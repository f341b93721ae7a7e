"""Steps of a protocol on a bench with one channel."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from labpipe.pipeline.bench import Bench, Signal
from labpipe.pipeline.marker_steps import MarkerBench
from labpipe.pipeline.steps import take_step
from labpipe.processing.filtering import decimate, low_pass, moving_average
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats

TIME: Floats = np.arange(2000, dtype=np.float64) * 0.01
VALUES: Floats = 0.3 + np.sin(TIME) + np.random.default_rng(1).normal(0, 0.01, len(TIME))


def protocol(step: str, rig: str = "{crosshead_speed: 2 mm/s, stroke: 10 mm}") -> Protocol:
    return parse_protocol(
        "version: 1\nname: p\n"
        "sources: {force: {reader: dspace-mat, channels: "
        "{force: {channel: A, unit: N}, displacement: {channel: B, unit: mm}}}}\n"
        f"rig: {rig}\nsteps:\n  - {step}\n"
        "curve: {force: force, displacement: displacement}\n"
        "branches: {channel: displacement, min_stroke: 1 mm}\n",
        "p.yaml",
    )


def after(step: str, values: Floats = VALUES, **more: Any) -> Bench:
    made = protocol(step, **more)
    bench = Bench()
    bench.raw["force"] = bench.signals["force"] = Signal(TIME, values, "N", "force")
    take_step(bench, MarkerBench(), made.steps[0], made)
    return bench


def test_zero_at_the_start() -> None:
    bench = after("{step: zero, channel: force, over: 1.995 s}")
    level = VALUES[TIME < 1.995].mean()
    np.testing.assert_allclose(bench.signals["force"].values, VALUES - level, atol=1e-12)
    np.testing.assert_allclose(bench.raw["force"].values, VALUES - level, atol=1e-12)
    assert bench.notes[0].message == f"zero at {level:.6g} N, the mean over 1.995 s at the start"


def test_zero_at_the_end() -> None:
    bench = after("{step: zero, channel: force, over: 0.995 s, at: end}")
    rest = TIME[-1] - 0.995 < TIME
    assert abs(bench.raw["force"].values[rest].mean()) < 1e-12


def test_error_of_the_zero_holds() -> None:
    pulls = []
    for seed in range(200):
        noise = np.random.default_rng(seed).normal(0, 0.01, len(TIME))
        signal = after("{step: zero, channel: force, over: 2 s}", noise).raw["force"]
        shift = (noise - signal.values)[0]
        pulls.append(shift / signal.zero_error)
    assert np.std(pulls) == pytest.approx(1.0, abs=0.15)


def test_zero_needs_samples() -> None:
    with pytest.raises(ValueError, match=r"force: 5 samples in the 0.045 s to zero on, not 8"):
        after("{step: zero, channel: force, over: 45 ms}")


@pytest.mark.parametrize(
    ("span", "window"),
    [("1 s", 99), ("2 mm", 99), ("10 %", 49), ("21 samples", 21), ("20 samples", 19)],
)
def test_smooth(span: str, window: int) -> None:
    """Of a motion at 2 mm/s over 10 mm: 2 mm are a second, a branch is five."""
    bench = after(f"{{step: smooth, channel: force, method: moving-average, span: {span}}}")
    np.testing.assert_allclose(
        bench.signals["force"].values, moving_average(VALUES, window=window), atol=1e-12
    )
    np.testing.assert_array_equal(bench.raw["force"].values, VALUES)
    assert f"moving average over {window} samples" in bench.notes[0].message


def test_low_pass() -> None:
    bench = after("{step: low-pass, channel: force, cutoff: 5 Hz, order: 2}")
    expected = low_pass(VALUES, cutoff=5.0, rate=100.0, order=2)
    np.testing.assert_allclose(bench.signals["force"].values, expected, atol=1e-9)


@pytest.mark.parametrize("method", ["filtered", "stride"])
def test_decimate(method: str) -> None:
    bench = after(f"{{step: decimate, channel: force, factor: 4, method: {method}}}")
    signal = bench.signals["force"]
    expected = decimate(VALUES, factor=4, filtered=method == "filtered")
    np.testing.assert_allclose(signal.values, expected)
    np.testing.assert_array_equal(signal.time, TIME[::4])
    assert bench.notes[0].message == f"every 4th sample kept ({method})"
