"""What the force recorder writes: tension in volts, and the motor's signals, on its own clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.virtual_lab.mechanics import MechanicalPath
from labpipe.virtual_lab.scenario import CantileverScenario, LoadCell
from labpipe.virtual_lab.schedule import Schedule

FORCE_PATH = "Model Root/Load Cell"
MOTOR_PATHS = ("Model Root/Motor/Direction", "Model Root/Motor/Frequency")
TRIGGER_PATH = "Model Root/Trigger"
PORT = "Out1"
_PULSES_PER_METRE = 8e6  # the source drives its motor with 8000 Hz for 1 mm/s


@dataclass(frozen=True, slots=True, eq=False)
class ForceRecord:
    """Samples of the force recorder.

    Parameters
    ----------
    clock : shape (samples,), s, the recorder's time axis
    volts : shape (samples,), V
    direction : shape (samples,), 1 while the clamp goes down, else 0
    frequency : shape (samples,), Hz, of the motor's pulses
    true_gain : N/V, what the load cell really does
    """

    clock: Floats
    volts: Floats
    direction: Floats
    frequency: Floats
    true_gain: float

    @property
    def signals(self) -> Mapping[str, Floats]:
        """What is recorded, by path."""
        values = (self.volts, self.direction, self.frequency)
        return dict(zip((FORCE_PATH, *MOTOR_PATHS), values, strict=True))

    def recording(self) -> Recording:
        """The record as a reader of the export would give it: no unit is known."""
        return _recording(self.clock, self.signals)


@dataclass(frozen=True, slots=True, eq=False)
class TriggeredRecord:
    """Samples of a force recorder that the program of a load frame starts.

    Parameters
    ----------
    clock : shape (samples,), s, the recorder's time axis
    volts : shape (samples,), V
    trigger : shape (samples,), the signal that started it: 1 throughout
    true_gain : N/V, what the load cell really does
    """

    clock: Floats
    volts: Floats
    trigger: Floats
    true_gain: float

    @property
    def signals(self) -> Mapping[str, Floats]:
        """What is recorded, by path."""
        return {FORCE_PATH: self.volts, TRIGGER_PATH: self.trigger}

    def recording(self) -> Recording:
        """The record as a reader of the export would give it: no unit is known."""
        return _recording(self.clock, self.signals)


def _recording(clock: Floats, signals: Mapping[str, Floats]) -> Recording:
    channels = tuple(
        Channel(name=PORT, path=f"{path}/{PORT}", values=column, clock="HostService")
        for path, column in signals.items()
    )
    return Recording(reader="dspace-mat", clocks=(Clock("HostService", clock),), channels=channels)


def record_force(
    path: MechanicalPath,
    scenario: CantileverScenario,
    schedule: Schedule,
    random: np.random.Generator,
) -> ForceRecord:
    """Measure the string's tension.

    Parameters
    ----------
    path : the solved test
    scenario : load cell and motor
    schedule : when what happens
    random : source of the true gain and of the noise

    Returns
    -------
    The record.
    """
    cell = scenario.load_cell
    drawn = cell.gain_uncertainty * random.standard_normal()
    gain = cell.gain * (1.0 + (drawn if cell.gain_error is None else cell.gain_error))
    progress = schedule.progress_at(schedule.force_times)
    sensed = path.tension(progress)
    sensed += cell.noise * random.standard_normal(len(sensed))
    moving = np.diff(progress, append=progress[-1]) > 0.0
    down = moving & (np.floor_divide(progress, scenario.mechanics.stroke) % 2 == 0)
    return ForceRecord(
        clock=schedule.force_clock,
        volts=convert(sensed / gain + cell.offset, cell),
        direction=down.astype(np.float64),
        frequency=np.where(moving, round(_PULSES_PER_METRE * scenario.speed, 6), 0.0),
        true_gain=float(gain),
    )


def convert(volts: Floats, cell: LoadCell) -> Floats:
    """Quantise to the converter's steps, and saturate at its ends."""
    step = 2.0 * cell.full_scale / 2**cell.bits
    lowest, highest = -(2 ** (cell.bits - 1)), 2 ** (cell.bits - 1) - 1
    counts: Floats = np.clip(np.rint(volts / step), lowest, highest)
    volts_out: Floats = counts * step
    return volts_out
