"""Value, estimate, 95 % interval and budget of a number, from replicates of the curve.

The recipe of JCGM 101:2008 (GUM supplement 1). With T the number of a curve,

delta_r = T(smooth + noise_r, filtered) - T(smooth) + sum over inputs i of what a draw z_ir changes,

and the interval is [value - 97.5 % quantile of delta, value - 2.5 % quantile], with the value: what
the number of the measured curve may be off, turned around. It holds the bias of T in noise, too:
the largest of many noisy samples lies above the largest value there was. `estimate` is the value
less the mean of delta.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import hypot

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.causes import NOISE, STEP, contribution
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate, Failure
from labpipe.records.quality import Reason
from labpipe.records.result import Contribution
from labpipe.uncertainty.extractors import Decide, Reading, Trace
from labpipe.uncertainty.replicates import Input, Replicates

_LOW, _HIGH = 0.025, 0.975
_LOST, _NONE = 0.05, 0.5
"""Shares of the replicates without a number: doubtful from the one on, failed from the other."""
_DUST = 1e-9
"""Share of the largest row of a budget by which arithmetic moves what cancels."""
_TOLD = 100
"""Samples of the shortest record that tells slow noise from none: of a shorter one every number
would be doubtful, or none."""
_FINE, _FINEST = 16_000, 16
"""Samples of a curve that windows are decided anew on, about, and steps of a sample at most: ends
of windows that jump from sample to sample make what an input changes too large or too small."""
_FAR = 0.01
"""Share of a number by which it lies outside of its interval where noise alone is no excuse."""
_BETWEEN = Input(STEP, lambda trace, _: trace, law="uniform", stream="between samples")
"""What finer samples change is known from a curve that is rounder, or rougher, than the true one:
the truth lies anywhere from half of it the other way to half as much again."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A number with all that is known of its doubt.

    Parameters
    ----------
    value : the plain number of the measured curve
    off : shape (replicates,), in its unit: what the number of each replicate is off; NaN where a
        replicate has none
    budget : what the doubt is made of
    n : samples that it rests on
    doubts : why the interval may not be trusted, with the quantity whose noise it is
    """

    value: float
    off: Floats
    budget: tuple[Contribution, ...]
    n: int
    doubts: tuple[tuple[str, Reason], ...] = ()

    @property
    def estimate(self) -> float:
        """The value without what noise adds to it on average."""
        return self.value - float(np.nanmean(self.off))

    @property
    def error(self) -> float:
        """Standard uncertainty of the estimate."""
        return float(np.nanstd(self.off))

    @property
    def as_estimate(self) -> Estimate:
        """The value with its standard uncertainty and its interval."""
        return Estimate(self.value, self.error, self.n, self.interval)

    @property
    def interval(self) -> Interval:
        """95 % interval, which holds the value.

        The largest of many noisy samples, and the last one before a break, lie beside it.
        """
        low, high = np.nanquantile(self.off, (_LOW, _HIGH)).tolist()
        return Interval(self.value - max(high, 0.0), self.value - min(low, 0.0))


def measure(
    replicates: Replicates, decide: Decide, values: Sequence[float] | None = None
) -> tuple[Measured, ...] | Failure:
    """Measure numbers of a curve.

    Parameters
    ----------
    replicates : of the curve
    decide : from where the numbers are read
    values : the plain numbers where they are read from more samples than the curve has

    Returns
    -------
    Of each number of the reading; a failure where the measured curve does not have them, or half of
    the replicates do not.
    """
    # Noise below this share of the number raises no doubt,
    slight_share = 5e-4
    # nor below this share of its standard uncertainty: twice that noise would widen the interval by
    # less than a fifth.
    small_uncertainty_share = 0.38
    reading = decide(replicates.measured)
    if isinstance(reading, Failure):
        return reading
    if values is None:
        values = [float(number) for number in reading.numbers(replicates.measured)]
    plain = _on_smooth(replicates, decide, reading)
    if isinstance(plain, Failure):
        return plain
    smooth = SmoothNumbers.of(decide, replicates.smooth, plain)
    base = _of(plain, replicates.smooth)
    drawn = [np.asarray(plain.drawn(trace)) for trace in replicates.traces()]
    noise = np.concatenate(drawn, axis=1) - base[:, None]
    between, share = _between_samples(replicates, reading, smooth), 1.0 / np.sqrt(3.0)
    off = noise - np.outer(between, 0.5 + share * replicates.draws(_BETWEEN))
    parts, doubts = [(STEP, share * between)], list[tuple[str, Reason]]()
    handed = list[tuple[Floats, Reason]]()
    for quantity in replicates.inputs:
        low, high = (smooth.changed(quantity, x) for x in (-1.0, 1.0))
        if np.isnan(low + high).any():
            low, high = _mirrored(low, high)
            message = f"there is none with {quantity.cause} one standard uncertainty off"
            doubts.append(("", Reason("not_repeatable", message)))
        z = replicates.draws(quantity)
        off = off + np.where(z > 0.0, np.outer(-low, z), np.outer(high, z))
        parts.append((quantity.cause, 0.5 * (high - low) * quantity.deviation))
        handed += [(np.abs(parts[-1][1]), reason) for reason in quantity.doubts]
    lost = float(np.isnan(off).any(axis=0).mean())
    if lost >= _NONE:
        return Failure("not_repeatable", f"{lost:.0%} of curves with such noise have none")
    if lost > _LOST:
        message = f"{lost:.0%} of curves with such noise have no such number"
        doubts.append(("", Reason("not_repeatable", message)))
    about_noise = tuple(_doubts(replicates, plain.n))
    spread, slight = np.nanstd(noise, axis=1), slight_share * np.abs(values)
    matters = spread > np.maximum(slight, small_uncertainty_share * np.nanstd(off, axis=1))
    return tuple(
        Measured(
            value,
            off[row],
            _budget(float(spread[row]), parts, row),
            reading.n,
            (
                *doubts,
                *_unfit(value, off[row]),
                *(about_noise if matters[row] else ()),
                *(("", reason) for by, reason in handed if by[row] > slight[row]),
            ),
        )
        for row, value in enumerate(values)
    )


def _between_samples(replicates: Replicates, reading: Reading, smooth: SmoothNumbers) -> Floats:
    """What numbers would be more of if samples lay without end, by the curve that shows it best."""
    if reading.between is not None:
        return np.array(reading.between)
    measured = replicates.measured
    if not reading.feels_corners or len(measured.time) != len(replicates.smooth.time):
        return smooth.between_samples()
    return SmoothNumbers.of(smooth.decide, measured, reading).between_samples()


def _on_smooth(replicates: Replicates, decide: Decide, reading: Reading) -> Reading | Failure:
    """Decide on the smooth curve; where it just misses a limit, by the samples of the measured."""
    plain = decide(replicates.smooth)
    if isinstance(plain, Reading):
        return plain
    if len(replicates.smooth.time) == len(replicates.measured.time):
        return reading
    return Failure("no_replicate", f"not in the curve without its noise: {plain.message}")


def _unfit(value: float, off: Floats) -> Iterator[tuple[str, Reason]]:
    """Doubt an interval without width, and a value that lies far outside of its interval.

    The largest of many noisy samples lies outside of it, too, by a part of the noise; that is why
    there is an estimate, and no reason for doubt.
    """
    if not np.nanmax(off) > np.nanmin(off):
        message = "neither noise nor an uncertain input is known, so its interval has no width"
        yield "", Reason("no_width", message)
        return
    low, high = np.nanquantile(off, (_LOW, _HIGH)).tolist()
    if max(low, -high) > _FAR * abs(value):
        message = (
            "the value lies outside of what curves with such noise give: the curve is not smooth"
            " where it was read; rather take the estimate"
        )
        yield "", Reason("value_outside", message)


def _doubts(replicates: Replicates, count: int) -> Iterator[tuple[str, Reason]]:
    """Why an interval over so many samples may be too narrow."""
    # Largest correlation time, as a share of the samples of a number,
    max_window_share = 0.4
    # as a share of the samples of the record,
    max_record_share = 0.04
    # and in samples, below which no short record is doubtful.
    harmless_samples = 1.0
    for name, noise in replicates.noises.items():
        # One sentence for all numbers of a test, whose samples stand beside them.
        memory, is_long = noise.memory, noise.count >= _TOLD
        if is_long and memory > max(noise.count * max_record_share, harmless_samples):
            message = (
                f"the noise of the {name} is as slow as what is measured: it remembers "
                f"{memory:.3g} of the {noise.count} samples of the record"
            )
            yield name, Reason("slow_noise", message)
        elif is_long and count > 1 and memory > max(count * max_window_share, harmless_samples):
            message = (
                f"the noise of the {name} is as slow as what is measured: it remembers "
                f"{memory:.3g} samples, more than two fifths of those that the number is read from"
            )
            yield name, Reason("slow_noise", message)


@dataclass(frozen=True, slots=True, eq=False)
class SmoothNumbers:
    """Numbers of a curve without noise, and what is known of it between its samples.

    Windows end at samples. A curve of a few hundred samples has numbers that jump as an input moves
    a sample across the end of its window, and numbers that are off by what lies between the last
    sample and that end. On finer samples of the same curve neither is seen.

    Parameters
    ----------
    decide : from where the numbers are read
    trace, reading : the curve, and what is decided on it
    fine, fine_reading : the same of the curve with samples in between
    """

    decide: Decide
    trace: Trace
    reading: Reading
    fine: Trace
    fine_reading: Reading

    @classmethod
    def of(cls, decide: Decide, trace: Trace, reading: Reading) -> SmoothNumbers:
        """Decide anew on finer samples where these alone cut its windows, and there is a number."""
        times = int(np.clip(_FINE // len(trace.time), 1, _FINEST)) if reading.is_cut else 1
        fine = trace.finer(times)
        fine_reading = decide(fine)
        if isinstance(fine_reading, Failure):
            return cls(decide, trace, reading, trace, reading)
        return cls(decide, trace, reading, fine, fine_reading)

    def between_samples(self) -> Floats:
        """What the numbers of the curve would be more of if samples lay without end."""
        return _of(self.fine_reading, self.fine) - _of(self.reading, self.trace)

    def changed(self, quantity: Input, by: float) -> Floats:
        """What an input changes the numbers by.

        Parameters
        ----------
        quantity : the input
        by : standard uncertainties that it is higher by

        Returns
        -------
        Of each number; where the input moves the curve, windows are decided anew.
        """
        moved = quantity.moved(self.trace, by)
        if not quantity.moves_curve:
            return _of(self.reading, moved) - _of(self.reading, self.trace)
        moved = moved.finer((len(self.fine.time) - 1) // max(len(self.trace.time) - 1, 1))
        outcome = self.decide(moved)
        reading = self.fine_reading if isinstance(outcome, Failure) else outcome
        return _of(reading, moved) - _of(self.fine_reading, self.fine)


def _of(reading: Reading, trace: Trace) -> Floats:
    return np.array([float(number) for number in reading.numbers(trace)])


def _mirrored(low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Changes on both sides, the other side mirrored where one has none."""
    return np.where(np.isnan(low), -high, low), np.where(np.isnan(high), -low, high)


def _budget(noise: float, parts: list[tuple[str, Floats]], row: int) -> tuple[Contribution, ...]:
    """Rows of causes, but for those that cancel; a cause of several inputs has no sign."""
    changes: dict[str, float] = {NOISE: noise}
    for cause, change in parts:
        before, by = changes.get(cause, 0.0), float(change[row])
        changes[cause] = hypot(before, by) if before else by
    least = _DUST * max(map(abs, changes.values()))
    return tuple(contribution(cause, by) for cause, by in changes.items() if abs(by) > least)
