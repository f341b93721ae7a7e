"""The steps of a protocol: one case each, from the words of the YAML to the pure function."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias, assert_never

import numpy as np

from labpipe.errors import ProcessingError, in_test_sheet
from labpipe.process.calibrated_signals import Prepared
from labpipe.process.motion import upright
from labpipe.process.zeros import FEWEST, LEAST, line_zero, mean_level, needed
from labpipe.protocol.schema import Protocol, Rig
from labpipe.records.arrays import Floats
from labpipe.records.causes import SPEED, TURN
from labpipe.records.declarations import (
    Decimate,
    FitShape,
    LowPass,
    RepairMarkers,
    Smooth,
    Span,
    SpecimenFrame,
    Step,
    ThreePointShape,
    TravelFromSpeed,
    Zero,
)
from labpipe.records.quality import Finding, doubtful, info_note
from labpipe.records.signals import Filter, Signal, Signals
from labpipe.signal.corners import Corner, fit_corner
from labpipe.signal.filters import (
    Butterworth,
    Smoothing,
    in_pieces,
    moving_average,
    seconds_to_window,
    window_length,
)
from labpipe.signal.reversals import fit_reversal
from labpipe.signal.turning_points import noise_level, sharpest_turn

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


def travel_from_speed(
    signals: Signals, step: TravelFromSpeed, rig: Rig
) -> tuple[Signals, list[Finding]]:
    """Carry out ``travel-from-speed``: the displacement, on the clock of the force.

    Parameters
    ----------
    signals : with the force
    step : of the protocol
    rig : its crosshead speed and stroke

    Returns
    -------
    With the channel; a note, and a doubt where the force contradicts speed and stroke.

    Raises
    ------
    ValueError
        If speed or stroke are not given, or the force shows no turn.

    Notes
    -----
    The turn is the corner of the force; loading began stroke / speed before it (the source, App.
    A.6, takes the largest force for the turn, and 58.8 s). The signal is moved by what is not
    known: turned one standard error later, or faster by the uncertainty of the speed.
    """
    if rig.crosshead_speed is None or rig.stroke is None:
        message = "expected rig.crosshead_speed and rig.stroke"
        raise ValueError(message)
    force, lasts = upright(signals.raw[step.force]), rig.stroke / rig.crosshead_speed
    corner = _turn(force, step)
    drive = Drive(corner.time - lasts, corner.time, rig.crosshead_speed)
    time = np.arange(force.time[0], force.time[-1], 1.0 / step.rate)
    travel = drive.travel(time)
    moved = {
        TURN: drive.travel(time - corner.time_error),
        SPEED: (1.0 + step.speed_uncertainty) * travel,
    }
    signal = Signal(time, travel, "m", force.clock, moved=moved)
    said = (
        f"no export measured it: {1e3 * rig.crosshead_speed:.4g} mm/s over {lasts:.4g} s up to the "
        f"force's corner at {corner.time:.3f} s (standard error {1e3 * corner.time_error:.2g} ms), "
        "and back"
    )
    known_to = 2.0 * float(np.hypot(corner.time_error, step.speed_uncertainty * lasts))
    found = [
        info_note("displacement_from_speed", step.channel, said),
        *_start(force, drive, step.channel),
        *_rest(force, drive, known_to),
    ]
    return signals.with_new(step.channel, signal), found


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


def _start(force: Signal, drive: Drive, channel: str) -> Iterator[Finding]:
    """Compare the force's take-off with the start that speed and stroke say."""
    seen, lasts = _take_off(force, drive.turn), drive.turn - drive.start
    if seen is None:
        message = "the force was not seen to rise from rest, so that nothing checks the start"
        yield info_note("start_not_seen", channel, message)
        return
    late = seen.time - drive.start
    if abs(late) <= _LATE * lasts + 3.0 * seen.time_error:
        return
    message = (
        f"the force rises for {drive.turn - seen.time:.2f} s before it turns, speed and stroke of "
        f"the rig say {lasts:.2f} s: look at rig.crosshead_speed and rig.stroke"
    )
    yield doubtful("speed_unexpected", "rig.crosshead_speed", message, "displacement", "force")


def _rest(force: Signal, drive: Drive, known_to: float) -> Iterator[Finding]:
    """Doubt a force whose record begins when the specimen was loaded: its zero is not known."""
    missed = float(force.time[0]) - drive.start
    if missed > known_to:
        message = (
            f"the record of the force begins {missed:.2f} s after the motion, known to "
            f"{known_to:.2f} s: its zero was taken under load, so that forces are too small"
        )
        yield doubtful("start_missed", "force", message, "force")


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


Stepped: TypeAlias = tuple[Prepared, list[Finding]]


class ShortStretchError(ValueError):
    """A stretch to zero on holds too few samples.

    Parameters
    ----------
    message : for people
    needed : s, how long it would have to be
    """

    def __init__(self, message: str, needed: float) -> None:
        super().__init__(message)
        self.needed = needed


def all_steps(prepared: Prepared, protocol: Protocol) -> tuple[Prepared, list[Finding]]:
    """Carry out the steps of a protocol, or say why not, with the key and what to do.

    Parameters
    ----------
    prepared : calibrated
    protocol : resolved

    Returns
    -------
    What they made of it, and what they found.

    Raises
    ------
    ProcessingError
        If the data cannot go through a step.
    """
    found: list[Finding] = []
    for step in protocol.steps:
        prepared, more = step_or_refusal(prepared, step, protocol)
        found += more
    return prepared, found


def step_or_refusal(prepared: Prepared, step: Step, protocol: Protocol) -> Stepped:
    """Carry out one step, or say why not, with its key and what to do.

    Parameters
    ----------
    prepared, step, protocol : as for `take_step`

    Raises
    ------
    ProcessingError
        If the data cannot go through the step.
    """
    try:
        return take_step(prepared, step, protocol)
    except ValueError as error:
        remedy = "Look at the exports with `labpipe inspect`, and at this step of the protocol."
        if isinstance(error, ShortStretchError):
            remedy = f"Write {in_test_sheet(f'{step.key}.over', f'{error.needed:.2g} s')}."
        message = f"{step.key} ({step.step}): {error}. {remedy}"
        raise ProcessingError(message) from error


def take_step(prepared: Prepared, step: Step, protocol: Protocol) -> Stepped:
    """Carry out one step.

    Parameters
    ----------
    prepared : by the steps before
    step : of the protocol
    protocol : for what steps share: markers, rig

    Returns
    -------
    What it made, and what it found.

    Raises
    ------
    ValueError
        If the data cannot go through the step.
    """
    match step:
        case RepairMarkers() | SpecimenFrame() | FitShape() | ThreePointShape():
            return _take_marker_step(prepared, step, protocol)
        case TravelFromSpeed():
            signals, found = travel_from_speed(prepared.signals, step, protocol.rig)
        case Zero():
            signals, found = zeroed(prepared.signals, step)
        case Smooth():
            signals, found = _smooth(prepared.signals, step, protocol)
        case LowPass():
            signals, found = _low_pass(prepared.signals, step)
        case Decimate():
            signals, found = _decimate(prepared.signals, step)
        case _ as never:
            assert_never(never)
    return replace(prepared, signals=signals), found


def _take_marker_step(
    prepared: Prepared,
    step: RepairMarkers | SpecimenFrame | FitShape | ThreePointShape,
    protocol: Protocol,
) -> Stepped:
    # A test on a load frame alone does not load what takes markers to a shape.
    from labpipe.process.camera_steps import fit_shapes, repair, turn_into_specimen

    match step:
        case RepairMarkers():
            return repair(prepared, step, protocol.markers)
        case SpecimenFrame():
            return turn_into_specimen(prepared, step, protocol.markers)
        case FitShape():
            return fit_shapes(prepared, step, protocol.markers)
        case ThreePointShape():
            from labpipe.process.span_steps import bend_between_supports

            return bend_between_supports(prepared, step, protocol)


def zeroed(signals: Signals, step: Zero) -> tuple[Signals, list[Finding]]:
    """Take the level of a signal at rest off it.

    Parameters
    ----------
    signals : by name
    step : which one, over which stretch, by a mean or the outer end of a line

    Raises
    ------
    ShortStretchError
        If the stretch holds too few samples.
    """
    name = step.channel
    signal = signals.filtered[name]
    _need_time(signal, name, "a stretch in s")
    first, last = _stretch(signal, step)
    over = max(step.over, float(signal.time[last - 1] - signal.time[first]))
    start = float(signal.time[0] if step.at == "start" else signal.time[-1] - over)
    rest = signal.values[first:last]
    known = rest[~np.isnan(rest)]
    beside = signal.values[last:] if step.at == "start" else signal.values[:first]
    if len(known) < (least := needed(beside)):
        apart = _step_of(signal)
        message = (
            f"{step.channel}: {len(known)} samples in the {over:.4g} s to zero on, {least} are "
            f"needed, and there are {1.0 / apart:.4g} per second"
        )
        raise ShortStretchError(message, (least + 0.5) * apart)
    stretch = {name: (start, start + over)}
    if step.by == "mean":
        signals = replace(signals, zeroed={**signals.zeroed, **stretch})
        level, error = mean_level(known, beside)
        how = f"the mean over {over:.4g} s"
    else:
        signals = replace(signals, lined={**signals.lined, **stretch})
        values = known if step.at == "start" else known[::-1]
        level, error, rested = line_zero(values, beside)
        lasts = over * rested / len(values)
        how = f"the outer end of a line over {over:.4g} s"
        how = f"the mean over the {lasts:.3g} s before the motion" if rested else how
    said = f"zero at {round(level, 12):.6g} {signal.unit}, {how} at the {step.at}"
    if len(known) < LEAST:
        said += f", {len(known)} samples: their noise is judged by the rest of the record"
    return signals.without_level(name, level, error), [info_note("zeroed", name, said)]


def _stretch(signal: Signal, step: Zero) -> tuple[int, int]:
    """Samples to zero on, from the first to behind the last: `FEWEST` at least.

    A stretch that suits a quick recorder holds two samples of a slow one.
    """
    time = signal.time
    if step.at == "start":
        last = int(np.searchsorted(time, time[0] + step.over, side="right"))
        return 0, min(max(last, FEWEST), len(time))
    first = int(np.searchsorted(time, time[-1] - step.over))
    return max(min(first, len(time) - FEWEST), 0), len(time)


def _need_time(signal: Signal, name: str, what: str) -> None:
    """Refuse a length in seconds where the export has rows but no time."""
    if not signal.has_time:
        message = f"{name}: {what} needs times, and the export has none"
        raise ValueError(message)


def _smooth(signals: Signals, step: Smooth, protocol: Protocol) -> tuple[Signals, list[Finding]]:
    signal = signals.filtered[step.channel]
    window = _window(step.span, signal, protocol)
    seconds = window * _step_of(signal)
    length = f" ({seconds:.4g} s)" if signal.has_time else ""
    said = f"moving average over {window} samples{length}"
    made = (Smoothing(window), 1)
    return _filtered(signals, step.channel, made), [info_note("smoothed", step.channel, said)]


def _low_pass(signals: Signals, step: LowPass) -> tuple[Signals, list[Finding]]:
    signal = signals.filtered[step.channel]
    _need_time(signal, step.channel, "a cutoff in Hz")
    rate = 1.0 / _step_of(signal)
    made = (Butterworth(step.cutoff, rate, step.order), 1)
    return _filtered(signals, step.channel, made), []


def _decimate(signals: Signals, step: Decimate) -> tuple[Signals, list[Finding]]:
    window = step.factor + 1 - step.factor % 2 if step.method == "filtered" else 1
    made = (Smoothing(window), step.factor)
    said = f"every {step.factor}th sample kept ({step.method})"
    return _filtered(signals, step.channel, made), [info_note("decimated", step.channel, said)]


def _step_of(signal: Signal) -> float:
    """Median step of the clock of a signal, s.

    Its steps are few numbers again and again, in which `labpipe.records.arrays.median` takes thirty
    times as long as numpy's.
    """
    return float(np.median(np.diff(signal.time)))


def _filtered(signals: Signals, name: str, made: Filter) -> Signals:
    """Filter a signal; once its corners are known this is done anew, piece by piece."""
    signal, (_, stride) = signals.filtered[name], made
    thinned = replace(signal, time=signal.time[::stride])
    signal = thinned.changed(lambda values: in_pieces(values, (), [made]))
    return signals.with_filtered(name, signal, made)


def _window(span: Span, signal: Signal, protocol: Protocol) -> int:
    """Samples of a span; travel and branches are turned into seconds by the rig's speed."""
    count = len(signal.values)
    if span.kind == "samples":
        return window_length(max(1.0, span.value), count)
    _need_time(signal, "smooth", f"a span of {span.kind}")
    if span.kind == "time":
        return seconds_to_window(span.value, signal.time)
    speed, stroke = protocol.rig.crosshead_speed, protocol.rig.stroke
    if speed is None or (span.kind == "branch" and stroke is None):
        message = f"span: a span of {span.kind} needs rig.crosshead_speed and rig.stroke"
        raise ValueError(message)
    travel = span.value if span.kind == "travel" else span.value * (stroke or 0.0)
    return seconds_to_window(travel / speed, signal.time)
