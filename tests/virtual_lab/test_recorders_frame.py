"""What the controller adds to the truth: noise of the stated size and memory, tare, gain, grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.virtual_lab.recorders import record_frame, sample_times, slow_noise
from labpipe.virtual_lab.tensile_path import TensilePath
from labpipe.virtual_lab.tensile_scenarios import FrameInstruments, corrugated_tube, twist_tube

QUIET = FrameInstruments(rate=100.0, first_sample=0.0195)


def test_first_sample_after_zero_and_last_one_off_the_grid() -> None:
    time = sample_times(QUIET, 5.0)
    steps = np.diff(time)
    assert time[0] == 0.0195
    np.testing.assert_allclose(steps[:-1], 0.01, rtol=1e-9)
    assert steps[-1] == pytest.approx(0.0063)
    assert 5.0 - 0.01 < time[-1] <= 5.0


def test_too_short() -> None:
    with pytest.raises(ValueError, match=r"rate=100\.0: a test of 0\.03 s would have 2 samples"):
        sample_times(QUIET, 0.03)


@pytest.mark.parametrize("correlation_time", [0.02, 0.2])
def test_slow_noise_has_its_size_and_memory(correlation_time: float) -> None:
    instruments = replace(QUIET, slow_noise=0.3, correlation_time=correlation_time)
    time = np.linspace(0.0, 4000.0, 400_001)
    noise = slow_noise(instruments, time, np.random.default_rng(3))
    effective = 4000.0 / (2.0 * correlation_time)  # samples as good as independent
    tolerance = 4.0 / np.sqrt(effective)
    assert np.std(noise) == pytest.approx(0.3, rel=tolerance)
    for lag in (1, 5, 20):
        correlation = np.corrcoef(noise[lag:], noise[:-lag])[0, 1]
        wanted = np.exp(-0.01 * lag / correlation_time)
        assert correlation == pytest.approx(wanted, abs=tolerance)


def test_slow_noise_is_as_strong_at_the_first_sample() -> None:
    instruments = replace(QUIET, slow_noise=0.3, correlation_time=10.0)
    random = np.random.default_rng(4)
    first = [slow_noise(instruments, np.array([0.0, 0.01]), random)[0] for _ in range(4000)]
    assert np.std(first) == pytest.approx(0.3, rel=0.05)


def test_noise_of_a_record() -> None:
    usual = corrugated_tube("CT-10-1")
    noisy = replace(
        usual, instruments=replace(usual.instruments, tare=0.0, white_noise=0.2, slow_noise=0.0)
    )
    path = TensilePath(noisy)
    record = record_frame(path, np.random.default_rng(5))
    error = record.force - path.force(record.time)
    assert np.std(error) == pytest.approx(0.2, rel=0.06)
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 4.0 / np.sqrt(len(error))


def test_tare_and_gain() -> None:
    usual = twist_tube("1a", gain_error=0.004)
    quiet = replace(usual.instruments, white_noise=0.0, slow_noise=0.0, displacement_noise=0.0)
    path = TensilePath(replace(usual, instruments=quiet))
    record = record_frame(path, np.random.default_rng(6))
    np.testing.assert_allclose(record.force, 1.004 * path.force(record.time) + 2.7, rtol=1e-12)
    np.testing.assert_allclose(record.displacement, path.displacement(record.time) + 12e-6)


def test_resolution() -> None:
    path = TensilePath(corrugated_tube("CT-10-1"))
    record = record_frame(path, np.random.default_rng(7))
    counts = record.displacement / 2.54e-6
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    steps = record.force / 4.4482216152605e-3
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
