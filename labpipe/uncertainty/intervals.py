"""Value, estimate, 95 % interval and budget of a number, from replicates of the curve.

The method of JCGM 101:2008 (GUM supplement 1). With T the number of a curve,

delta_r = T(smooth + noise_r, filtered) - T(smooth) + sum over inputs i of the change by a draw
z_ir,

and the interval is [value - 97.5 % quantile of delta, value - 2.5 % quantile], widened to contain
the value. It includes the bias of T from noise: the largest of many noisy samples is above the
largest true value. `estimate` is the value minus the mean of delta.
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
"""The effect of finer samples is computed on a curve that may be smoother or rougher than the true
one: the true effect is assumed to be from -1/2 to 3/2 of it."""
_CORNERS = replace(_SAMPLING, stream="corners between samples")


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A number with its uncertainty.

    Parameters
    ----------
    value : number of the measured curve
    deviations : shape (replicates,), error of the number of each replicate, in its unit; NaN where
        a replicate has none
    budget : contributions to the uncertainty
    n : number of samples used
    doubts : reasons why the interval may be wrong, each with the quantity whose noise causes it, or
        an empty text
    """

    value: float
    deviations: Floats
    budget: tuple[Contribution, ...]
    n: int
    doubts: tuple[tuple[str, Reason], ...] = ()

    @property
    def estimate(self) -> float:
        """Return the value less the mean effect of noise."""
        return self.value - float(np.nanmean(self.deviations))

    @property
    def error(self) -> float:
        """Return the standard uncertainty of the estimate."""
        return float(np.nanstd(self.deviations))

    @property
    def interval(self) -> Interval:
        """Return the 95 % interval, widened to contain the value.

        Otherwise the largest of many noisy samples, or the last one before a break, may be outside.
        """
        low, high = np.nanquantile(self.deviations, _QUANTILES_95).tolist()
        return Interval(self.value - max(high, 0.0), self.value - min(low, 0.0))


def measure_numbers(replicates: Replicates, decide: Decide) -> tuple[Measured, ...]:
    """Measure numbers of a curve with their uncertainty.

    Parameters
    ----------
    replicates : of the curve
    decide : chooses the samples of the numbers

    Returns
    -------
    One for each number of the reading.

    Raises
    ------
    UnavailableError
        If the measured curve, or half of the replicates, do not have them.
    """
    # Noise below this share of the number raises no doubt.
    slight_share = 5e-4
    # Nor does noise below this share of the standard uncertainty: twice that noise would widen the
    # interval by less than a fifth.
    small_uncertainty_share = 0.38
    reading = decide(replicates.measured)
    values = reading.values or _compute_numbers(reading, replicates.measured).tolist()
    smooth_reading = _decide_on_smooth(replicates, decide, reading)
    smooth = SmoothNumbers.of(decide, replicates.smooth, smooth_reading, replicates.curves)
    noisy = [smooth_reading.replicate_numbers(trace) for trace in replicates.iterate_traces()]
    noise = np.concatenate(noisy, axis=1) - smooth.numbers[:, None]
    sampling_errors, sampling_spread = _draw_sampling_errors(replicates, reading, smooth)
    deviations = noise - sampling_errors
    parts, doubts = [(STEP, sampling_spread)], list[tuple[str, Reason]]()
    input_doubts = list[tuple[Floats, Reason]]()
    for quantity in replicates.inputs:
        low, high = (smooth.compute_change(quantity, x) for x in (-1.0, 1.0))
        if np.isnan(low + high).any():  # a missing change is the opposite of the other one
            low, high = np.where(np.isnan(low), -high, low), np.where(np.isnan(high), -low, high)
            doubts.append(("", Reason.of("uncertainty.no_number", cause=quantity.cause)))
        z = replicates.draw_input(quantity)
        deviations = deviations + np.where(z > 0.0, np.outer(-low, z), np.outer(high, z))
        parts.append((quantity.cause, 0.5 * (high - low) * quantity.standard_deviation))
        input_doubts += [(np.abs(parts[-1][1]), reason) for reason in quantity.doubts]
    missing_share = float(np.isnan(deviations).any(axis=0).mean())
    not_repeatable = Reason.of("uncertainty.not_repeatable", missing=missing_share)
    if missing_share >= 0.5:
        raise UnavailableError(not_repeatable)
    if missing_share > 0.05:
        doubts.append(("", not_repeatable))
    noise_doubts = tuple(_list_slow_noise_doubts(replicates, smooth_reading.n))
    spread, negligible = np.nanstd(noise, axis=1), slight_share * np.abs(values)
    small = small_uncertainty_share * np.nanstd(deviations, axis=1)
    is_relevant = spread > np.maximum(negligible, small)
    return tuple(
        Measured(
            value,
            deviations[row],
            _make_budget(float(spread[row]), parts, row),
            reading.n,
            (
                *doubts,
                *_list_interval_doubts(value, deviations[row]),
                *(noise_doubts if is_relevant[row] else ()),
                *(("", reason) for by, reason in input_doubts if by[row] > negligible[row]),
            ),
        )
        for row, value in enumerate(values)
    )


def _draw_sampling_errors(
    replicates: Replicates, reading: Reading, smooth: SmoothNumbers
) -> tuple[Floats, Floats]:
    """Draw the correction of numbers to infinitely fine samples.

    Returns
    -------
    Shape (numbers, replicates), and the standard deviation of each number.
    """
    measured = replicates.measured
    if reading.sampling_correction is not None:
        correction = np.array(reading.sampling_correction)
    elif not reading.depends_on_corners or len(measured.time) != len(replicates.smooth.time):
        correction = smooth.compute_sampling_change()
    else:
        correction = SmoothNumbers.of(smooth.decide, measured, reading).compute_sampling_change()
    scale = 1.0 / np.sqrt(3.0)
    errors = np.outer(correction, 0.5 + scale * replicates.draw_input(_SAMPLING))
    spread = scale * correction
    longest_branch = max((branch.stop - branch.start for branch in measured.branches), default=0)
    is_sampled = reading.ends_at_samples or reading.sampling_correction is not None
    if longest_branch > SHORT_RECORD_SAMPLES or reading.depends_on_corners or not is_sampled:
        return errors, spread
    # A short record does not show whether the curve is smooth: one half of the replicates has a
    # corner wherever the steps allow one.
    corners, has_corners = smooth.compute_corner_change(), replicates.draw_input(_CORNERS) > 0.0
    interpolated = errors if reading.sampling_correction is None else np.zeros_like(errors)
    errors = np.where(has_corners, interpolated + corners[:, None], errors)
    return errors, np.where(corners == 0.0, spread, np.copysign(errors.std(axis=1), spread))


def _decide_on_smooth(replicates: Replicates, decide: Decide, reading: Reading) -> Reading:
    """Choose the samples on the smooth curve; if that fails, on the measured one."""
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
    """Yield doubts about an interval without width, or far from its value.

    The largest of many noisy samples is outside by only a part of the noise, for which the estimate
    is corrected.
    """
    # A width of a few roundings of the value counts as none.
    if not np.nanmax(deviations) - np.nanmin(deviations) > 1e-12 * abs(value):
        yield "", Reason.of("uncertainty.no_width")
        return
    low, high = np.nanquantile(deviations, _QUANTILES_95).tolist()
    if max(low, -high) > 0.01 * abs(value):
        yield "", Reason.of("uncertainty.value_outside")


def _list_slow_noise_doubts(replicates: Replicates, count: int) -> Iterator[tuple[str, Reason]]:
    """Yield reasons why the interval of a number of `count` samples may be too narrow."""
    # Largest correlation times, as shares of the samples of a number and of the record.
    max_window_share, max_record_share = 0.4, 0.04
    # Correlation time up to which no record is doubtful.
    harmless_samples = 1.0
    # A shorter record does not show whether its noise is slow.
    min_record_samples = 100
    for name, noise in replicates.noises.items():
        slowness, total = noise.correlation_time, noise.count
        if total < min_record_samples or slowness <= harmless_samples:
            continue
        if slowness > total * max_record_share:  # one sentence for all numbers of a test
            reason = Reason.of("uncertainty.slow_noise", name=name, slowness=slowness, count=total)
            yield name, reason
        elif count > 1 and slowness > count * max_window_share:
            yield name, Reason.of("uncertainty.slow_in_number", name=name, slowness=slowness)


@dataclass(frozen=True, slots=True, eq=False)
class SmoothNumbers:
    """Numbers of a curve without noise, on its samples and on finer ones.

    Windows end at samples. With a few hundred samples, a number jumps if an input moves a sample
    across the end of its window, and the part between the last sample and that end is missing.
    Finer samples of the same curve avoid both.

    Parameters
    ----------
    decide : chooses the samples of the numbers
    trace, reading, numbers : the curve, its reading, and its numbers
    fine, fine_reading, fine_numbers : the same for the finer curve
    curves : cache, by input, its change, and parts per sampling step
    """

    decide: Decide
    trace: Trace
    reading: Reading
    numbers: Floats
    fine: Trace
    fine_reading: Reading
    fine_numbers: Floats
    curves: CurveCache

    @classmethod
    def of(
        cls, decide: Decide, trace: Trace, reading: Reading, curves: CurveCache | None = None
    ) -> SmoothNumbers:
        """Choose the samples again on finer samples, if windows end at samples."""
        parts = int(np.clip(16_000 // len(trace.time), 1, 16)) if reading.ends_at_samples else 1
        original = trace, reading, _compute_numbers(reading, trace)
        smooth = cls(decide, *original, *original, {} if curves is None else curves)
        fine = smooth._make_curve(None, 0.0, parts)
        fine_reading = return_failure(decide)(fine)
        if isinstance(fine_reading, Failure):
            return smooth
        numbers = _compute_numbers(fine_reading, fine)
        return replace(smooth, fine=fine, fine_reading=fine_reading, fine_numbers=numbers)

    def compute_sampling_change(self) -> Floats:
        """Return the change of the numbers with finer samples."""
        return self.fine_numbers - self.numbers

    def compute_corner_change(self) -> Floats:
        """Return the change of the numbers by corners between samples, where steps allow them."""
        parts_per_step = 8
        changes = list[Floats]()
        for has_corners in (False, True):
            fine = self.trace.refine(parts_per_step, has_corners=has_corners)
            reading = return_failure(self.decide)(fine)
            if isinstance(reading, Failure):
                return np.zeros(len(self.numbers))
            changes.append(_compute_numbers(reading, fine))
        return changes[1] - changes[0]

    def compute_change(self, quantity: Input, by: float) -> Floats:
        """Return the change of the numbers with an input.

        Parameters
        ----------
        quantity : the input
        by : change of the input, in the unit of `Input.perturb`

        Returns
        -------
        One per number; if the input moves the curve, windows are chosen again.
        """
        if not quantity.moves_curve:
            return _compute_numbers(self.reading, self._make_curve(quantity, by, 1)) - self.numbers
        parts = (len(self.fine.time) - 1) // max(len(self.trace.time) - 1, 1)
        changed_curve = self._make_curve(quantity, by, parts)
        outcome = return_failure(self.decide)(changed_curve)
        reading = self.fine_reading if isinstance(outcome, Failure) else outcome
        return _compute_numbers(reading, changed_curve) - self.fine_numbers

    def _make_curve(self, quantity: Input | None, by: float, parts: int) -> Trace:
        """Return the curve with an input changed, on finer samples; all numbers share it."""
        key = quantity, by, parts
        if key not in self.curves:
            if parts > 1:
                curve = self._make_curve(quantity, by, 1).refine(parts)
            else:
                curve = quantity.perturb(self.trace, by) if quantity else self.trace
            self.curves[key] = curve
        return self.curves[key]


def _compute_numbers(reading: Reading, trace: Trace) -> Floats:
    return np.array([float(number) for number in reading.numbers(trace)])


def _make_budget(
    noise: float, parts: list[tuple[str, Floats]], row: int
) -> tuple[Contribution, ...]:
    """Return the contribution of each cause that does not cancel; unsigned for several inputs."""
    changes: dict[str, float] = {NOISE: noise}
    for cause, change in parts:
        previous, size = changes.get(cause, 0.0), float(change[row])
        changes[cause] = hypot(previous, size) if previous else size
    smallest = 1e-9 * max(map(abs, changes.values()))
    return tuple(make_contribution(*x) for x in changes.items() if abs(x[1]) > smallest)
