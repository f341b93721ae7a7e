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
from labpipe.uncertainty.replicates import Choice, CurveCache, Extractor, Input, Replicates, Trace

_QUANTILES_95 = (0.025, 0.975)
_SAMPLING = Input(STEP, lambda trace, _: trace, distribution="uniform", stream="between samples")
"""Input for the effect of finite sampling.

The effect is computed on a curve that may be smoother or rougher than the true curve. The true
effect is therefore assumed to be from -1/2 to 3/2 of the computed effect.
"""
_CORNERS = replace(_SAMPLING, stream="corners between samples")
"""Input whose sign decides which replicates have corners between samples."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredNumber:
    """A number with its uncertainty.

    Parameters
    ----------
    value : the number of the measured curve
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

        A value that is the largest of many noisy samples, or the last sample before a break, may
        otherwise be outside.
        """
        lower, upper = np.nanquantile(self.deviations, _QUANTILES_95).tolist()
        return Interval(self.value - max(upper, 0.0), self.value - min(lower, 0.0))


def measure_numbers(replicates: Replicates, choose: Choice) -> tuple[MeasuredNumber, ...]:
    """Measure numbers of a curve with their uncertainty.

    Parameters
    ----------
    replicates : the curve and its replicates
    choose : function that chooses the samples of the numbers on a curve

    Returns
    -------
    The measured numbers, in the order of the extractor that `choose` returns.

    Raises
    ------
    UnavailableError
        If the measured curve, or at least half of the replicates, lack a number.
    """
    # Noise below this fraction of the number causes no doubt.
    negligible_fraction = 5e-4
    # Noise below this fraction of the standard uncertainty causes no doubt either, because noise
    # that is twice as large would widen the interval by less than a fifth.
    small_error_fraction = 0.38
    # Fractions of replicates without a number. Above the first one, the interval is doubtful. From
    # the second one on, the number is unavailable.
    max_missing_without_doubt, max_missing = 0.05, 0.5
    extractor = choose(replicates.measured_trace)
    values = extractor.values or _compute_numbers(extractor, replicates.measured_trace).tolist()
    smooth_extractor = _choose_samples(replicates, choose, extractor)
    smooth = SmoothNumbers.of(choose, replicates.smooth_trace, smooth_extractor, replicates.cache)
    noisy_numbers = [*map(smooth_extractor.compute_replicates, replicates.iterate_traces())]
    noise_effects = np.concatenate(noisy_numbers, axis=1) - smooth.numbers[:, None]
    corrections, sampling_spreads = _draw_sampling_corrections(replicates, extractor, smooth)
    deviations = noise_effects - corrections
    contributions, doubts = [(STEP, sampling_spreads)], list[tuple[str, Reason]]()
    input_doubts = list[tuple[Floats, Reason]]()
    for quantity in replicates.inputs:
        changes = np.array([smooth.compute_change(quantity, x) for x in (-1.0, 1.0)])
        if np.isnan(changes).any():  # replace a missing change by the opposite of the other one
            changes = np.where(np.isnan(changes), -changes[::-1], changes)
            doubts.append(("", Reason.of("uncertainty.no_number", cause=quantity.cause)))
        lower, upper = changes  # of the numbers, with the input changed by minus and plus one unit
        z = replicates.draw_errors(quantity)
        deviations = deviations + np.where(z > 0.0, np.outer(-lower, z), np.outer(upper, z))
        mean_changes = 0.5 * (upper - lower) * quantity.standard_deviation
        contributions.append((quantity.cause, mean_changes))
        input_doubts += [(np.abs(mean_changes), reason) for reason in quantity.doubts]
    missing_fraction = float(np.isnan(deviations).any(axis=0).mean())
    not_repeatable = Reason.of("uncertainty.not_repeatable", missing=missing_fraction)
    if missing_fraction >= max_missing:
        raise UnavailableError(not_repeatable)
    if missing_fraction > max_missing_without_doubt:
        doubts.append(("", not_repeatable))
    noise_doubts = tuple(_list_slow_noise_doubts(replicates, smooth_extractor.n))
    noise_spreads = np.nanstd(noise_effects, axis=1)
    negligible_changes = negligible_fraction * np.abs(values)
    small_errors = small_error_fraction * np.nanstd(deviations, axis=1)
    is_relevant = noise_spreads > np.maximum(negligible_changes, small_errors)
    return tuple(
        MeasuredNumber(
            value,
            deviations[row],
            _make_budget([(NOISE, noise_spreads), *contributions], row),
            extractor.n,
            (
                *doubts,
                *_list_interval_doubts(value, deviations[row]),
                *(noise_doubts if is_relevant[row] else ()),
                *(("", why) for x, why in input_doubts if x[row] > negligible_changes[row]),
            ),
        )
        for row, value in enumerate(values)
    )


def _draw_sampling_corrections(
    replicates: Replicates, extractor: Extractor, smooth: SmoothNumbers
) -> tuple[Floats, Floats]:
    """Draw corrections of the numbers for finite sampling.

    Returns
    -------
    corrections : shape (numbers, replicates), in the unit of each number
    spreads : shape (numbers,), standard deviations of the corrections, with the sign of the
        computed correction
    """
    measured = replicates.measured_trace
    sampled = smooth
    if extractor.depends_on_corners and len(measured.time) == len(replicates.smooth_trace.time):
        sampled = SmoothNumbers.of(smooth.choose, measured, extractor)
    correction = sampled.fine_numbers - sampled.numbers
    if extractor.sampling_correction is not None:
        correction = np.array(extractor.sampling_correction)
    standard_deviation = 1.0 / np.sqrt(3.0)  # of a uniform distribution from -1/2 to 3/2
    factors = 0.5 + standard_deviation * replicates.draw_errors(_SAMPLING)
    corrections, spreads = np.outer(correction, factors), standard_deviation * correction
    longest_branch = max((branch.stop - branch.start for branch in measured.branches), default=0)
    ignores_sampling = extractor.sampling_correction is None and not extractor.ends_at_samples
    if longest_branch > SHORT_RECORD_SAMPLES or extractor.depends_on_corners or ignores_sampling:
        return corrections, spreads
    # A short record does not show whether the curve is smooth. One half of the replicates therefore
    # has a corner in each step that allows one.
    corner_changes = smooth.compute_corner_change()
    smooth_corrections = corrections if extractor.sampling_correction is None else 0.0
    has_corners = replicates.draw_errors(_CORNERS) > 0.0
    corrections = np.where(has_corners, smooth_corrections + corner_changes[:, None], corrections)
    standard_deviations = np.copysign(corrections.std(axis=1), spreads)
    return corrections, np.where(corner_changes == 0.0, spreads, standard_deviations)


def _choose_samples(replicates: Replicates, choose: Choice, extractor: Extractor) -> Extractor:
    """Choose the samples on the smooth curve or, if that fails, on the measured or averaged one."""
    smooth_extractor = return_failure(choose)(replicates.smooth_trace)
    if isinstance(smooth_extractor, Extractor):
        return smooth_extractor
    if len(replicates.smooth_trace.time) == len(replicates.measured_trace.time):
        return extractor
    block_extractor = return_failure(choose)(replicates.averaged_trace)
    if isinstance(block_extractor, Failure):
        raise UnavailableError.of("uncertainty.no_replicate", why=smooth_extractor.message)
    return block_extractor


def _list_interval_doubts(value: float, deviations: Floats) -> Iterator[tuple[str, Reason]]:
    """Yield a doubt about an interval without width, or about one that is widened to the value.

    Small widenings cause no doubt. The largest of many noisy samples lies outside by a fraction of
    the noise, and the estimate is corrected for that.
    """
    rounding_fraction, max_widening_fraction = 1e-12, 0.01  # of the value
    if not np.nanmax(deviations) - np.nanmin(deviations) > rounding_fraction * abs(value):
        yield "", Reason.of("uncertainty.no_width")
        return
    lower, upper = np.nanquantile(deviations, _QUANTILES_95).tolist()
    if max(lower, -upper) > max_widening_fraction * abs(value):
        yield "", Reason.of("uncertainty.value_outside")


def _list_slow_noise_doubts(replicates: Replicates, n_samples: int) -> Iterator[tuple[str, Reason]]:
    """Yield doubts about the interval of a number of `n_samples` samples because of slow noise."""
    # Largest correlation times without a doubt, as fractions of the samples of a number and of the
    # record.
    max_window_fraction, max_record_fraction = 0.4, 0.04
    # Correlation time, samples, up to which no record is doubtful.
    max_harmless_time = 1.0
    # A shorter record does not show whether its noise is slow.
    min_record_samples = 100
    for name, noise in replicates.noise_models.items():
        time, record_samples = noise.correlation_time, noise.n_samples
        if record_samples < min_record_samples or time <= max_harmless_time:
            continue
        if time > record_samples * max_record_fraction:  # one sentence for all numbers of a test
            facts = {"name": name, "slowness": time, "count": record_samples}
            yield name, Reason.of("uncertainty.slow_noise", **facts)
        elif n_samples > 1 and time > n_samples * max_window_fraction:
            yield name, Reason.of("uncertainty.slow_in_number", name=name, slowness=time)


@dataclass(frozen=True, slots=True, eq=False)
class SmoothNumbers:
    """Numbers of a curve without noise, on its samples and on finer ones.

    A window begins and ends at samples. With a few hundred samples, a number jumps if an input
    moves a sample across an end of its window, and the part of the window beyond the last sample is
    missing. Finer samples of the same curve reduce both errors.

    Parameters
    ----------
    choose : function that chooses the samples of the numbers on a curve
    trace, extractor, numbers : the curve, the functions of its chosen samples, and its numbers
    fine_trace, fine_extractor, fine_numbers : the same for the finer curve
    cache : cache of changed and finer curves
    """

    choose: Choice
    trace: Trace
    extractor: Extractor
    numbers: Floats
    fine_trace: Trace
    fine_extractor: Extractor
    fine_numbers: Floats
    cache: CurveCache

    @classmethod
    def of(
        cls, choose: Choice, trace: Trace, extractor: Extractor, cache: CurveCache | None = None
    ) -> SmoothNumbers:
        """Compute the numbers on the curve and, if windows end at samples, on finer samples."""
        # The finer curve has at most about 16 000 samples and 16 parts per step.
        parts = int(np.clip(16_000 // len(trace.time), 1, 16))
        original = trace, extractor, _compute_numbers(extractor, trace)
        smooth = cls(choose, *original, *original, {} if cache is None else cache)
        fine_trace = smooth._make_curve(None, 0.0, parts if extractor.ends_at_samples else 1)
        fine_extractor = return_failure(choose)(fine_trace)
        if isinstance(fine_extractor, Failure):
            return smooth
        fine = fine_trace, fine_extractor, _compute_numbers(fine_extractor, fine_trace)
        return cls(choose, *original, *fine, smooth.cache)

    def compute_corner_change(self) -> Floats:
        """Compute the change of the numbers if each sampling step that allows a corner has one.

        The change is zero if the numbers cannot be computed on the curve with or without corners.
        """
        parts_per_step = 8
        numbers = list[Floats]()
        for has_corners in (False, True):
            fine_trace = self.trace.refine(parts_per_step, has_corners=has_corners)
            extractor = return_failure(self.choose)(fine_trace)
            if isinstance(extractor, Failure):
                return np.zeros(len(self.numbers))
            numbers.append(_compute_numbers(extractor, fine_trace))
        return numbers[1] - numbers[0]

    def compute_change(self, quantity: Input, n_units: float) -> Floats:
        """Compute the change of the numbers with an input.

        Parameters
        ----------
        quantity : the input
        n_units : change of the input, in units of `Input.perturb`

        Returns
        -------
        Shape (numbers,). If the input moves the curve, windows are chosen again.
        """
        if not quantity.moves_curve:
            changed_trace = self._make_curve(quantity, n_units, 1)
            return _compute_numbers(self.extractor, changed_trace) - self.numbers
        parts = (len(self.fine_trace.time) - 1) // max(len(self.trace.time) - 1, 1)
        changed_trace = self._make_curve(quantity, n_units, parts)
        outcome = return_failure(self.choose)(changed_trace)
        extractor = self.fine_extractor if isinstance(outcome, Failure) else outcome
        return _compute_numbers(extractor, changed_trace) - self.fine_numbers

    def _make_curve(self, quantity: Input | None, n_units: float, parts: int) -> Trace:
        """Make the curve with a changed input and divided steps, or take it from the cache."""
        key = quantity, n_units, parts
        if key not in self.cache:
            if parts > 1:
                self.cache[key] = self._make_curve(quantity, n_units, 1).refine(parts)
            else:
                self.cache[key] = quantity.perturb(self.trace, n_units) if quantity else self.trace
        return self.cache[key]


def _compute_numbers(extractor: Extractor, trace: Trace) -> Floats:
    return np.array([float(number) for number in extractor.compute_numbers(trace)])


def _make_budget(contributions: list[tuple[str, Floats]], row: int) -> tuple[Contribution, ...]:
    """Make the budget of one number from the changes of all numbers by each cause.

    The contributions of several inputs with the same cause are added in quadrature, without a sign.
    """
    changes: dict[str, float] = {}
    for cause, changes_by_cause in contributions:
        change = float(changes_by_cause[row])
        changes[cause] = hypot(changes[cause], change) if changes.get(cause) else change
    min_change = 1e-9 * max(map(abs, changes.values()))  # smaller changes are rounding
    return tuple(make_contribution(*x) for x in changes.items() if abs(x[1]) > min_change)
