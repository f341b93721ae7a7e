"""Compute the value, estimate, 95 % interval and budget of results from replicates of a curve.

The method is that of JCGM 101:2008 (GUM supplement 1). With T a result of a curve, the error of
replicate r is

delta_r = T(smooth + noise_r, filtered) - T(smooth) - c_r - sum over inputs i of T_i(-z_ir),

where z_ir is the error that is drawn for input i, T_i(x) is the change of T if input i changes by
x, and c_r is the drawn correction for finite sampling. The 95 % interval is [value - 97.5 %
quantile of delta, value - 2.5 % quantile], widened to contain the value. It accounts for the bias
of T from noise: the largest of many noisy samples is above the largest true value. The estimate is
the value minus the mean of delta.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.causes import NOISE, STEP, make_contribution
from labpipe.records.curve import Interval
from labpipe.records.estimates import Failure, UnavailableError, return_failure
from labpipe.records.quality import Reason
from labpipe.records.result import Contribution
from labpipe.uncertainty.noise_model import SHORT_RECORD_SAMPLES
from labpipe.uncertainty.replicates import CurveCache, Decide, Input, Reading, Replicates, Trace

_QUANTILES_95 = (0.025, 0.975)
_SAMPLING = Input(STEP, lambda trace, _: trace, distribution="uniform", stream="between samples")
"""Input for the effect of finer samples. It is computed on a curve that may be smoother or rougher
than the true curve: the true effect is assumed to be from -1/2 to 3/2 of the computed effect."""
_CORNERS = replace(_SAMPLING, stream="corners between samples")


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A number with its uncertainty.

    Parameters
    ----------
    value : number of the measured curve
    deviations : shape (replicates,), error of the number of each replicate, in the unit of the
        number; NaN for a replicate without the number
    budget : contributions to the uncertainty
    n : number of samples used
    doubts : reasons why the interval may be wrong, each with the name of the signal whose noise is
        the cause, or an empty text
    """

    value: float
    deviations: Floats
    budget: tuple[Contribution, ...]
    n: int
    doubts: tuple[tuple[str, Reason], ...] = ()

    @property
    def estimate(self) -> float:
        """Value minus the mean deviation, which is the bias from noise."""
        return self.value - float(np.nanmean(self.deviations))

    @property
    def error(self) -> float:
        """Standard uncertainty of the estimate."""
        return float(np.nanstd(self.deviations))

    @property
    def interval(self) -> Interval:
        """95 % interval, widened to contain the value.

        Otherwise the largest of many noisy samples, or the last sample before a break, may be
        outside.
        """
        low, high = np.nanquantile(self.deviations, _QUANTILES_95).tolist()
        return Interval(self.value - max(high, 0.0), self.value - min(low, 0.0))


def measure_numbers(replicates: Replicates, decide: Decide) -> tuple[Measured, ...]:
    """Measure numbers of a curve with their uncertainty.

    Parameters
    ----------
    replicates : the curve and its replicates
    decide : function that chooses the samples of the numbers on a curve

    Returns
    -------
    One measured number for each number that `decide` chooses.

    Raises
    ------
    UnavailableError
        If the measured curve, or half of the replicates, lack a number.
    """
    # Noise below this fraction of the number causes no doubt.
    negligible_fraction = 5e-4
    # Noise below this fraction of the standard uncertainty causes no doubt either: noise twice as
    # large would widen the interval by less than a fifth.
    small_error_fraction = 0.38
    # Fractions of replicates without a number: above the first one the interval is doubtful, from
    # the second one the number is unavailable.
    max_missing_without_doubt, max_missing = 0.05, 0.5
    reading = decide(replicates.measured)
    values = reading.values or _compute_numbers(reading, replicates.measured).tolist()
    smooth_reading = _read_smooth_curve(replicates, decide, reading)
    smooth = SmoothNumbers.of(decide, replicates.smooth, smooth_reading, replicates.curves)
    noisy = [smooth_reading.replicate_numbers(trace) for trace in replicates.iterate_traces()]
    noise = np.concatenate(noisy, axis=1) - smooth.numbers[:, None]
    corrections, sampling_spread = _draw_sampling_corrections(replicates, reading, smooth)
    deviations = noise - corrections
    contributions, doubts = [(STEP, sampling_spread)], list[tuple[str, Reason]]()
    input_doubts = list[tuple[Floats, Reason]]()
    for quantity in replicates.inputs:
        changes = np.array([smooth.compute_change(quantity, x) for x in (-1.0, 1.0)])
        if np.isnan(changes).any():  # replace a missing change by the opposite of the other one
            changes = np.where(np.isnan(changes), -changes[::-1], changes)
            doubts.append(("", Reason.of("uncertainty.no_number", cause=quantity.cause)))
        at_minus, at_plus = changes  # of the input by one standard deviation
        z = replicates.draw_input(quantity)
        deviations = deviations + np.where(z > 0.0, np.outer(-at_minus, z), np.outer(at_plus, z))
        change = 0.5 * (at_plus - at_minus) * quantity.standard_deviation
        contributions.append((quantity.cause, change))
        input_doubts += [(np.abs(change), reason) for reason in quantity.doubts]
    missing_fraction = float(np.isnan(deviations).any(axis=0).mean())
    not_repeatable = Reason.of("uncertainty.not_repeatable", missing=missing_fraction)
    if missing_fraction >= max_missing:
        raise UnavailableError(not_repeatable)
    if missing_fraction > max_missing_without_doubt:
        doubts.append(("", not_repeatable))
    noise_doubts = tuple(_list_slow_noise_doubts(replicates, smooth_reading.n))
    spread, negligible = np.nanstd(noise, axis=1), negligible_fraction * np.abs(values)
    small_errors = small_error_fraction * np.nanstd(deviations, axis=1)
    is_relevant = spread > np.maximum(negligible, small_errors)
    return tuple(
        Measured(
            value,
            deviations[row],
            _make_budget(float(spread[row]), contributions, row),
            reading.n,
            (
                *doubts,
                *_list_interval_doubts(value, deviations[row]),
                *(noise_doubts if is_relevant[row] else ()),
                *(("", reason) for size, reason in input_doubts if size[row] > negligible[row]),
            ),
        )
        for row, value in enumerate(values)
    )


def _draw_sampling_corrections(
    replicates: Replicates, reading: Reading, smooth: SmoothNumbers
) -> tuple[Floats, Floats]:
    """Draw corrections of the numbers for finite sampling.

    Returns
    -------
    shifts : shape (numbers, replicates), the corrections, in the unit of each number
    spreads : shape (numbers,), their standard deviations, signed like the correction
    """
    measured = replicates.measured
    if reading.sampling_correction is not None:
        correction = np.array(reading.sampling_correction)
    else:
        if reading.depends_on_corners and len(measured.time) == len(replicates.smooth.time):
            sampled = SmoothNumbers.of(smooth.decide, measured, reading)
        else:
            sampled = smooth
        correction = sampled.fine_numbers - sampled.numbers
    deviation = 1.0 / np.sqrt(3.0)  # of a uniform distribution from -1/2 to 3/2, about 1/2
    shifts = np.outer(correction, 0.5 + deviation * replicates.draw_input(_SAMPLING))
    spreads = deviation * correction
    longest_branch = max((branch.stop - branch.start for branch in measured.branches), default=0)
    ignores_sampling = reading.sampling_correction is None and not reading.ends_at_samples
    if longest_branch > SHORT_RECORD_SAMPLES or reading.depends_on_corners or ignores_sampling:
        return shifts, spreads
    # A short record does not show whether the curve is smooth: one half of the replicates has a
    # corner in each step that allows one.
    corners, has_corners = smooth.compute_corner_change(), replicates.draw_input(_CORNERS) > 0.0
    smooth_shifts = shifts if reading.sampling_correction is None else 0.0
    shifts = np.where(has_corners, smooth_shifts + corners[:, None], shifts)
    return shifts, np.where(corners == 0.0, spreads, np.copysign(shifts.std(axis=1), spreads))


def _read_smooth_curve(replicates: Replicates, decide: Decide, reading: Reading) -> Reading:
    """Choose the samples on the smooth curve; if that fails, on the measured or averaged curve."""
    smooth_reading = return_failure(decide)(replicates.smooth)
    if isinstance(smooth_reading, Reading):
        return smooth_reading
    if len(replicates.smooth.time) == len(replicates.measured.time):
        return reading
    block_reading = return_failure(decide)(replicates.averaged)
    if isinstance(block_reading, Failure):
        raise UnavailableError.of("uncertainty.no_replicate", why=smooth_reading.message)
    return block_reading


def _list_interval_doubts(value: float, deviations: Floats) -> Iterator[tuple[str, Reason]]:
    """Yield doubts about an interval without width, or one that had to be widened to its value.

    The largest of many noisy samples is outside by only a fraction of the noise, for which the
    estimate is corrected.
    """
    rounding_fraction, max_widening = 1e-12, 0.01  # fractions of the value
    if not np.nanmax(deviations) - np.nanmin(deviations) > rounding_fraction * abs(value):
        yield "", Reason.of("uncertainty.no_width")
        return
    low, high = np.nanquantile(deviations, _QUANTILES_95).tolist()
    if max(low, -high) > max_widening * abs(value):
        yield "", Reason.of("uncertainty.value_outside")


def _list_slow_noise_doubts(replicates: Replicates, count: int) -> Iterator[tuple[str, Reason]]:
    """Yield reasons why the interval of a number of `count` samples may be too narrow."""
    # Largest correlation times, as fractions of the samples of a number and of the record.
    max_window_fraction, max_record_fraction = 0.4, 0.04
    # Correlation time, samples, up to which no record is doubtful.
    max_harmless_time = 1.0
    # A shorter record does not show whether its noise is slow.
    min_record_samples = 100
    for name, noise in replicates.noises.items():
        time, total = noise.correlation_time, noise.count
        if total < min_record_samples or time <= max_harmless_time:
            continue
        if time > total * max_record_fraction:  # one sentence for all numbers of a test
            yield name, Reason.of("uncertainty.slow_noise", name=name, slowness=time, count=total)
        elif count > 1 and time > count * max_window_fraction:
            yield name, Reason.of("uncertainty.slow_in_number", name=name, slowness=time)


@dataclass(frozen=True, slots=True, eq=False)
class SmoothNumbers:
    """Numbers of a curve without noise, on its samples and on finer ones.

    Windows end at samples. With a few hundred samples, a number jumps if an input moves a sample
    across the end of its window, and the part between the last sample and that end is missing.
    Finer samples of the same curve avoid both.

    Parameters
    ----------
    decide : function that chooses the samples of the numbers on a curve
    trace, reading, numbers : the curve, its chosen samples, and its numbers
    fine_trace, fine_reading, fine_numbers : the same for the finer curve
    curves : cache of changed and finer curves
    """

    decide: Decide
    trace: Trace
    reading: Reading
    numbers: Floats
    fine_trace: Trace
    fine_reading: Reading
    fine_numbers: Floats
    curves: CurveCache

    @classmethod
    def of(
        cls, decide: Decide, trace: Trace, reading: Reading, curves: CurveCache | None = None
    ) -> SmoothNumbers:
        """Compute the numbers on the curve and, if windows end at samples, on finer samples."""
        # The finer curve has at most about 16 000 samples and 16 parts per step.
        parts = int(np.clip(16_000 // len(trace.time), 1, 16))
        original = trace, reading, _compute_numbers(reading, trace)
        smooth = cls(decide, *original, *original, {} if curves is None else curves)
        fine_trace = smooth._make_curve(None, 0.0, parts if reading.ends_at_samples else 1)
        fine_reading = return_failure(decide)(fine_trace)
        if isinstance(fine_reading, Failure):
            return smooth
        fine = fine_trace, fine_reading, _compute_numbers(fine_reading, fine_trace)
        return cls(decide, *original, *fine, smooth.curves)

    def compute_corner_change(self) -> Floats:
        """Compute the change of the numbers by corners in all sampling steps that allow them."""
        parts_per_step = 8
        numbers = list[Floats]()
        for has_corners in (False, True):
            fine_trace = self.trace.refine(parts_per_step, has_corners=has_corners)
            reading = return_failure(self.decide)(fine_trace)
            if isinstance(reading, Failure):
                return np.zeros(len(self.numbers))
            numbers.append(_compute_numbers(reading, fine_trace))
        return numbers[1] - numbers[0]

    def compute_change(self, quantity: Input, shift: float) -> Floats:
        """Compute the change of the numbers with an input.

        Parameters
        ----------
        quantity : the input
        shift : change of the input, in the unit of `Input.perturb`

        Returns
        -------
        Shape (numbers,). If the input moves the curve, windows are chosen again.
        """
        if not quantity.moves_curve:
            changed = self._make_curve(quantity, shift, 1)
            return _compute_numbers(self.reading, changed) - self.numbers
        parts = (len(self.fine_trace.time) - 1) // max(len(self.trace.time) - 1, 1)
        changed = self._make_curve(quantity, shift, parts)
        outcome = return_failure(self.decide)(changed)
        reading = self.fine_reading if isinstance(outcome, Failure) else outcome
        return _compute_numbers(reading, changed) - self.fine_numbers

    def _make_curve(self, quantity: Input | None, shift: float, parts: int) -> Trace:
        """Make the curve with an input changed, on finer samples, or take it from the cache."""
        key = quantity, shift, parts
        if key not in self.curves:
            if parts > 1:
                curve = self._make_curve(quantity, shift, 1).refine(parts)
            else:
                curve = quantity.perturb(self.trace, shift) if quantity else self.trace
            self.curves[key] = curve
        return self.curves[key]


def _compute_numbers(reading: Reading, trace: Trace) -> Floats:
    return np.array([float(number) for number in reading.numbers(trace)])


def _make_budget(
    noise: float, contributions: list[tuple[str, Floats]], row: int
) -> tuple[Contribution, ...]:
    """Make the budget of a number from the noise and the change by each input.

    The contributions of several inputs with the same cause are added in quadrature, without a sign.
    """
    changes: dict[str, float] = {NOISE: noise}
    for cause, numbers in contributions:
        earlier, change = changes.get(cause, 0.0), float(numbers[row])
        changes[cause] = hypot(earlier, change) if earlier else change
    # Smaller changes are rounding.
    min_change = 1e-9 * max(map(abs, changes.values()))
    return tuple(make_contribution(*x) for x in changes.items() if abs(x[1]) > min_change)
