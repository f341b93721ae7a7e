"""Simulate the records of the force recorder and the load frame, and plan their schedule."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.virtual_lab.cantilever_path import MechanicalPath
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, LoadCell
from labpipe.virtual_lab.conduit_scenarios import ConduitScenario
from labpipe.virtual_lab.tensile_path import TensilePath
from labpipe.virtual_lab.tensile_scenarios import FrameInstruments
from labpipe.virtual_lab.three_point_path import ThreePointPath

FORCE_PATH = "Model Root/Load Cell"
DIRECTION_PATH, FREQUENCY_PATH = "Model Root/Motor/Direction", "Model Root/Motor/Frequency"
TRIGGER_PATH = "Model Root/Trigger"
PORT = "Out1"


@dataclass(frozen=True, slots=True, eq=False)
class Schedule:
    """The motion of clamp or crosshead and the two recordings around it, in true time.

    Parameters
    ----------
    corner_times : shape (n,), s, at which the motion starts or stops
    progress : shape (n,), m, cumulative travel at those times; up and down both increase it
    turning_times : shape (2 cycles + 1,), s: start, first top, first return, ... last return; with
        a dwell, the beginning of the dwell
    end : s, of all records
    frame_clock : shape (frames,), s, the cameras' own time axis
    frame_times : shape (frames,), s, the same instants in true time
    force_clock : shape (samples,), s, the force recorder's own time axis
    force_times : shape (samples,), s, the same instants in true time
    """

    corner_times: Floats
    progress: Floats
    turning_times: Floats
    end: float
    frame_clock: Floats
    frame_times: Floats
    force_clock: Floats
    force_times: Floats

    def progress_at(self, times: Floats) -> Floats:
        """Return the travel, m, at true times, s; constant before and after the motion."""
        return np.interp(times, self.corner_times, self.progress)


def plan_cantilever(scenario: CantileverScenario) -> Schedule:
    """Plan motion and recordings with enough rest at both ends of both records.

    Parameters
    ----------
    scenario : speed, dwell, rest, clocks and stroke are used

    Returns
    -------
    The schedule. Both records begin at zero on their own clock; that of the cameras is true time.
    """
    clocks, stroke = scenario.clocks, scenario.mechanics.stroke
    force_begins = -clocks.offset / (1.0 + clocks.drift)
    start = max(0.0, force_begins) + scenario.rest
    stroke_numbers = np.arange(2 * scenario.mechanics.cycles + 1)
    stroke_time = stroke / scenario.speed
    arrivals = (
        start + stroke_numbers * stroke_time + np.maximum(stroke_numbers - 1, 0) * scenario.dwell
    )
    departures = arrivals + scenario.dwell * (
        (stroke_numbers > 0) & (stroke_numbers < stroke_numbers[-1])
    )
    end = float(arrivals[-1] + scenario.rest)
    frame_times = np.arange(int(np.ceil(end * clocks.fps)) + 1) / clocks.fps
    step = clocks.step_ratio / clocks.rate
    samples = int(np.ceil((end - force_begins) * (1.0 + clocks.drift) / step)) + 1
    force_clock: Floats = step * np.arange(samples, dtype=np.float64)
    return Schedule(
        corner_times=np.ravel(np.column_stack([arrivals, departures])),
        progress=np.repeat(stroke_numbers * stroke, 2),
        turning_times=arrivals,
        end=end,
        frame_clock=frame_times,
        frame_times=frame_times,
        force_clock=force_clock,
        force_times=(force_clock - clocks.offset) / (1.0 + clocks.drift),
    )


def plan_conduit(scenario: ConduitScenario) -> Schedule:
    """Plan a three-point test: rest, down, up without dwell, rest.

    Parameters
    ----------
    scenario : speed, rest, clocks and stroke are used

    Returns
    -------
    The schedule; true time begins when the load frame starts.
    """
    clocks, stroke = scenario.clocks, scenario.test.stroke
    stroke_time = stroke / scenario.speed
    top = scenario.rest + stroke_time
    stop = top + stroke_time
    end = stop + scenario.rest
    frames = int((end + clocks.camera_lead) * clocks.fps)
    frame_clock: Floats = np.arange(frames, dtype=np.float64) / clocks.fps
    samples = int((end - clocks.trigger_lag) * clocks.rate)
    force_clock: Floats = np.arange(samples, dtype=np.float64) / clocks.rate
    return Schedule(
        corner_times=np.array([scenario.rest, stop]),
        progress=np.array([0.0, 2.0 * stroke]),
        turning_times=np.array([scenario.rest, top, stop]),
        end=end,
        frame_clock=frame_clock,
        frame_times=frame_clock - clocks.camera_lead,
        force_clock=force_clock,
        force_times=clocks.trigger_lag + force_clock / (1.0 + clocks.recorder_drift),
    )


@dataclass(frozen=True, slots=True, eq=False)
class ForceRecord:
    """Samples of the force recorder.

    Parameters
    ----------
    clock : shape (samples,), s, the recorder's time axis
    signals : by path, shape (samples,): volts of the load cell, V; of a cantilever test, 1 while
        the clamp goes down, else 0, and the frequency of the motor's pulses, Hz; of a three-point
        test the trigger that started the recorder, 1 throughout
    true_gain : N/V, of the load cell
    """

    clock: Floats
    signals: Mapping[str, Floats]
    true_gain: float

    @property
    def volts(self) -> Floats:
        """Return the output of the load cell, V, shape (samples,)."""
        return self.signals[FORCE_PATH]

    def recording(self) -> Recording:
        """Return the record as read from its export, without unit."""
        channels = tuple(
            Channel(name=PORT, path=f"{path}/{PORT}", values=column, clock="HostService")
            for path, column in self.signals.items()
        )
        clock = Clock("HostService", self.clock)
        return Recording(reader="dspace-mat", clocks=(clock,), channels=channels)


def record_cantilever_force(
    path: MechanicalPath,
    scenario: CantileverScenario,
    schedule: Schedule,
    random: np.random.Generator,
) -> ForceRecord:
    """Simulate the force recorder of a cantilever test, which measures the tension of the string.

    Parameters
    ----------
    path : the solved test
    scenario : load cell and motor
    schedule : of the motion and the recordings
    random : source of the true gain and of the noise

    Returns
    -------
    The record.
    """
    pulses_per_metre = 8e6
    progress = schedule.progress_at(schedule.force_times)
    volts, gain = _measure(path.tension(progress), scenario.load_cell, random)
    moving = np.diff(progress, append=progress[-1]) > 0.0
    down = moving & (np.floor_divide(progress, scenario.mechanics.stroke) % 2 == 0)
    pulses = np.where(moving, round(pulses_per_metre * scenario.speed, 6), 0.0)
    signals = {FORCE_PATH: volts, DIRECTION_PATH: down.astype(np.float64), FREQUENCY_PATH: pulses}
    return ForceRecord(schedule.force_clock, signals, gain)


def record_conduit_force(
    path: ThreePointPath, scenario: ConduitScenario, schedule: Schedule, random: np.random.Generator
) -> ForceRecord:
    """Simulate the force recorder of a three-point test; see `record_cantilever_force`."""
    force = scenario.factor * path.force(schedule.progress_at(schedule.force_times))
    volts, gain = _measure(force, scenario.load_cell, random)
    signals = {FORCE_PATH: volts, TRIGGER_PATH: np.ones(len(volts))}
    return ForceRecord(schedule.force_clock, signals, gain)


def _measure(force: Floats, cell: LoadCell, random: np.random.Generator) -> tuple[Floats, float]:
    """Return the volts of a load cell, quantised and saturated, and its true gain, N/V."""
    drawn = cell.gain_uncertainty * random.standard_normal()
    gain = float(cell.gain * (1.0 + (drawn if cell.gain_error is None else cell.gain_error)))
    sensed = force + cell.noise * random.standard_normal(len(force))
    step = 2.0 * cell.full_scale / 2**cell.bits
    lowest, highest = -(2 ** (cell.bits - 1)), 2 ** (cell.bits - 1) - 1
    counts: Floats = np.clip(np.rint((sensed / gain + cell.offset) / step), lowest, highest)
    return counts * step, gain


@dataclass(frozen=True, slots=True, eq=False)
class FrameRecord:
    """Samples of the load frame's controller, all of shape (n,).

    Parameters
    ----------
    time : s, since the load frame started
    displacement : m, with tare, noise and resolution
    force : N, with tare, gain error, noise and resolution
    """

    time: Floats
    displacement: Floats
    force: Floats

    def recording(self) -> Recording:
        """Return the record as read from its export, in SI."""
        travel, force = single(self.displacement), single(self.force)
        channels = (
            Channel("Crosshead", "Crosshead", travel, unit="m", unit_in_file="mm"),
            Channel("Load", "Load", force, unit="N", unit_in_file="N"),
        )
        return Recording("load-frame", clocks=(Clock("time", self.time),), channels=channels)


def single(values: Floats) -> Floats:
    """Round values to 32 bits, as a controller stores them, without negative zeros.

    Parameters
    ----------
    values : any shape, in SI
    """
    return values.astype(np.float32).astype(np.float64) + 0.0


def record_crosshead(
    path: ThreePointPath, scenario: ConduitScenario, schedule: Schedule, random: np.random.Generator
) -> FrameRecord:
    """Simulate the load frame of a three-point test, with a coarse force.

    Parameters
    ----------
    path, scenario, schedule : as for `record_conduit_force`
    random : source of the noise

    Returns
    -------
    The record; its first sample is half a sampling interval after the start.
    """
    step = 1.0 / scenario.clocks.frame_rate
    time: Floats = np.arange(0.5 * step, schedule.end, step)
    progress = schedule.progress_at(time)
    frame, noise = scenario.frame, random.standard_normal((2, len(time)))
    force = scenario.factor * path.force(progress)
    return FrameRecord(
        time=time,
        displacement=path.displacement(progress) + frame.displacement_noise * noise[0],
        force=force + frame.force_tare + frame.force_noise * noise[1],
    )


def record_frame(path: TensilePath, random: np.random.Generator) -> FrameRecord:
    """Simulate the load frame of a tensile test.

    Parameters
    ----------
    path : the test
    random : source of the noise

    Returns
    -------
    The record.

    Raises
    ------
    ValueError
        If the test has fewer than three samples.
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
        displacement=_quantise(displacement, instruments.displacement_step),
        force=_quantise(force, instruments.force_step),
    )


def sample_times(instruments: FrameInstruments, end: float) -> Floats:
    """Return the sample times, s: an even grid and one last sample off it, none after `end`."""
    step = 1.0 / instruments.rate
    last = instruments.last_step * step
    count = int(np.floor((end - last - instruments.first_sample) / step)) + 1
    if count < 2:
        message = (
            f"rate={instruments.rate}: expected at least 3 samples, found {count + 1} in {end} s"
        )
        raise ValueError(message)
    grid = instruments.first_sample + step * np.arange(count)
    return np.append(grid, grid[-1] + last)


def slow_noise(instruments: FrameInstruments, time: Floats, random: np.random.Generator) -> Floats:
    """Return correlated noise at given times, N.

    Parameters
    ----------
    instruments : rms and correlation time
    time : shape (n,), s, increasing, not necessarily even
    random : source of the noise

    Returns
    -------
    shape (n,): stationary first-order autoregressive noise with the correlation
    exp(-lag / correlation time).
    """
    correlation = np.exp(-np.diff(time, prepend=-np.inf) / instruments.correlation_time)
    shocks = np.sqrt(1.0 - correlation**2) * random.standard_normal(len(time))
    noise = np.empty(len(time))
    level = 0.0
    for sample, (share, shock) in enumerate(zip(correlation, shocks, strict=True)):
        level = share * level + shock
        noise[sample] = level
    return instruments.slow_noise * noise


def _quantise(values: Floats, step: float) -> Floats:
    if step == 0.0:
        return values
    rounded: Floats = step * np.rint(values / step)
    return rounded
