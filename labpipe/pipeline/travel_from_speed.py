"""A displacement from crosshead speed and time, for a test whose frame exported none."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labpipe.pipeline.bench import Bench, Signal
from labpipe.protocol.schema import Rig
from labpipe.records.arrays import Floats
from labpipe.records.quality import Severity
from labpipe.records.step_settings import TravelFromSpeed
from labpipe.signal.corners import Corner, fit_corner
from labpipe.signal.filters import moving_average, seconds_to_window
from labpipe.signal.reversals import fit_reversal
from labpipe.signal.turning_points import goes_down, noise_level, sharpest_turn

_WORST = 0.5
"""s; a turn known no better than this makes no displacement."""
_REST = 1.0
"""s before the take-off of the force that must have been recorded, and s that are smoothed over."""
_LATE = 0.02
"""Share of the time of loading by which the force may rise early or late."""


@dataclass(frozen=True, slots=True)
class Drive:
    """Up at constant speed and down again.

    Parameters
    ----------
    start, turn : s
    speed : m/s
    """

    start: float
    turn: float
    speed: float

    def travel(self, time: Floats) -> Floats:
        """Displacement at some times, m; 0 before the start and once it is back."""
        lasts = self.turn - self.start
        up = np.clip(time - self.start, 0.0, lasts)
        down = np.clip(time - self.turn, 0.0, lasts)
        return np.asarray(self.speed * (up - down), dtype=np.float64)


def travel_from_speed(bench: Bench, step: TravelFromSpeed, rig: Rig) -> None:
    """Carry out ``travel-from-speed``: the displacement, on the clock of the force.

    Parameters
    ----------
    bench : gets the channel, a note, and a doubt where the force contradicts speed and stroke
    step : of the protocol
    rig : its crosshead speed and stroke

    Raises
    ------
    ValueError
        If speed or stroke are not given, or the force shows no turn.

    Notes
    -----
    The turn is the corner of the force; loading began stroke / speed before it (the source, App.
    A.6, takes the largest force for the turn, and 58.8 s). What is not known is in the signal's
    alternative: turned one standard error later, and faster by the uncertainty of the speed.
    """
    if rig.crosshead_speed is None or rig.stroke is None:
        message = "expected rig.crosshead_speed and rig.stroke"
        raise ValueError(message)
    force, lasts = bench.raw[step.force], rig.stroke / rig.crosshead_speed
    if goes_down(force.values):  # a reversed bridge turns when any other does
        force = replace(force, values=-force.values)
    corner = _turn(force, step)
    drive = Drive(corner.time - lasts, corner.time, rig.crosshead_speed)
    time = np.arange(force.time[0], force.time[-1], 1.0 / step.rate)
    # What another assumption changes is divided by sqrt(3) later; a standard error must not be.
    late = time - np.sqrt(3.0) * corner.time_error
    other = (1.0 + np.sqrt(3.0) * step.speed_uncertainty) * drive.travel(late)
    signal = Signal(time, drive.travel(time), "m", force.clock, alternative=other)
    bench.raw[step.channel] = bench.signals[step.channel] = signal
    said = (
        f"no export measured it: {1e3 * rig.crosshead_speed:.4g} mm/s over {lasts:.4g} s up to the "
        f"force's corner at {corner.time:.3f} s (standard error {1e3 * corner.time_error:.2g} ms), "
        "and back"
    )
    bench.note("displacement_from_speed", Severity.INFO, step.channel, said)
    _check_start(bench, force, drive, step.channel)
    _check_rest(
        bench, force, drive, 2.0 * np.hypot(corner.time_error, step.speed_uncertainty * lasts)
    )


def _turn(force: Signal, step: TravelFromSpeed) -> Corner:
    if not force.has_time:
        message = f"{step.force}: a speed needs times, and the export has none"
        raise ValueError(message)
    near = sharpest_turn(force.time, force.values, width=step.window)
    found = None
    if near is not None:
        part = slice(*np.searchsorted(force.time, [near - step.window, near + step.window]))
        inside = force.time[part], force.values[part]
        found = fit_reversal(*inside, near=near, window=step.window)
    if found is None or not found.corner.time_error < _WORST:
        message = (
            f"{step.force}: expected a corner where it turns from rising to falling, which says "
            "when the frame turned, found none: look whether it is the right channel, and whether "
            "the unloading was recorded"
        )
        raise ValueError(message)
    return found.corner


def _check_start(bench: Bench, force: Signal, drive: Drive, channel: str) -> None:
    """Hold the force's take-off against the start that speed and stroke say."""
    seen, lasts = _take_off(force, drive.turn), drive.turn - drive.start
    if seen is None:
        message = "the force was not seen to rise from rest, so that nothing checks the start"
        bench.note("start_not_seen", Severity.INFO, channel, message)
        return
    late = seen.time - drive.start
    if abs(late) <= _LATE * lasts + 3.0 * seen.time_error:
        return
    message = (
        f"the force rises for {drive.turn - seen.time:.2f} s before it turns, speed and stroke of "
        f"the rig say {lasts:.2f} s: look at rig.crosshead_speed and rig.stroke"
    )
    for quantity in ("displacement", "force"):
        bench.doubt(quantity, "speed_unexpected", message, where="rig.crosshead_speed")


def _check_rest(bench: Bench, force: Signal, drive: Drive, known_to: float) -> None:
    """Doubt a force whose record begins when the specimen was loaded: nobody knows its zero."""
    missed = float(force.time[0]) - drive.start
    if missed <= known_to:
        return
    message = (
        f"the record of the force begins {missed:.2f} s after the motion, known to {known_to:.2f} s"
        ": its zero was taken under load, so that forces are too small"
    )
    bench.doubt("force", "start_missed", message, where="force")


def _take_off(force: Signal, turn: float) -> Corner | None:
    """Corner at which the force leaves its level at rest."""
    window = max(1, seconds_to_window(_REST, force.time))
    smooth = moving_average(force.values, window=min(window, len(force.time) | 1))
    rest = force.time <= force.time[0] + _REST
    level = float(np.nanmean(force.values[rest]))
    noise = noise_level(force.values) / np.sqrt(window) + 1e-9 * float(np.ptp(smooth))
    rising = (smooth - level > 5.0 * noise) & (force.time < turn)
    # The last time that it was at rest, so that one stray sample does not count.
    still = np.flatnonzero(~rising & (force.time < turn))
    if not len(still) or force.time[still[-1]] - force.time[0] < _REST:
        return None
    near = float(force.time[still[-1]])
    return fit_corner(force.time, force.values, near=near, window=3.0 * _REST, degree=1)
