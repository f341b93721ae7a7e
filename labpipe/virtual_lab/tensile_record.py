"""What the load frame's controller records: time, displacement, force, with their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.tensile_path import TensilePath
from labpipe.virtual_lab.tensile_scenario import FrameInstruments


@dataclass(frozen=True, slots=True, eq=False)
class FrameRecord:
    """Samples of the controller, all of shape (n,).

    Parameters
    ----------
    time : s, since the crosshead started
    displacement : m, with tare, noise and resolution
    force : N, with tare, gain error, noise and resolution
    """

    time: Floats
    displacement: Floats
    force: Floats


def record_frame(path: TensilePath, random: np.random.Generator) -> FrameRecord:
    """Record a virtual tensile test.

    Parameters
    ----------
    path : the test
    random : source of the noise

    Returns
    -------
    The record.
    """
    instruments = path.scenario.instruments
    time = sample_times(instruments, path.end)
    force = (1.0 + instruments.gain_error) * path.force(time) + instruments.tare
    force += instruments.white_noise * random.standard_normal(len(time))
    force += slow_noise(instruments, time, random)
    displacement = path.displacement(time) + instruments.displacement_tare
    displacement += instruments.displacement_noise * random.standard_normal(len(time))
    return FrameRecord(
        time=time,
        displacement=_resolved(displacement, instruments.displacement_step),
        force=_resolved(force, instruments.force_step),
    )


def sample_times(instruments: FrameInstruments, end: float) -> Floats:
    """Times of the samples, s: an even grid, and a last one off it, not after `end`."""
    step = 1.0 / instruments.rate
    last = instruments.last_step * step
    count = int(np.floor((end - last - instruments.first_sample) / step)) + 1
    if count < 2:
        message = f"rate={instruments.rate}: a test of {end} s would have {count + 1} samples"
        raise ValueError(message)
    grid = instruments.first_sample + step * np.arange(count)
    return np.append(grid, grid[-1] + last)


def slow_noise(instruments: FrameInstruments, time: Floats, random: np.random.Generator) -> Floats:
    """Correlated noise at given times, N.

    Parameters
    ----------
    instruments : rms and correlation time
    time : shape (n,), s, increasing, in uneven steps if need be
    random : source of the noise

    Returns
    -------
    shape (n,): a first-order autoregressive noise, whose correlation falls as
    exp(-lag / correlation time), and which is as strong at the first sample as at any other.
    """
    kept = np.exp(-np.diff(time, prepend=-np.inf) / instruments.correlation_time)
    fresh = np.sqrt(1.0 - kept**2) * random.standard_normal(len(time))
    noise = np.empty(len(time))
    level = 0.0
    for sample, (share, shock) in enumerate(zip(kept, fresh, strict=True)):
        level = share * level + shock
        noise[sample] = level
    return instruments.slow_noise * noise


def _resolved(values: Floats, step: float) -> Floats:
    if step == 0.0:
        return values
    rounded: Floats = step * np.rint(values / step)
    return rounded
