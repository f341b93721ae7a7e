"""Find slips in the grips, and measure and subtract the slack before the specimen is taut."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, ClassVar

import numpy as np
import scipy

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, Samples, average_between, convert_to_slice, median
from labpipe.records.causes import SCALE_OF_DISPLACEMENT, SLACK
from labpipe.records.curve import Interval, Slip, SlipDecision
from labpipe.records.declarations import Needs, Output
from labpipe.records.estimates import Estimate, Failure, UnavailableError, return_failure
from labpipe.records.quality import Reason
from labpipe.results import curves
from labpipe.results.kinds import Kind, MeasuredItem, ReducedTest, compute_scale_error
from labpipe.uncertainty.autocorrelation import (
    build_polynomial_basis,
    cut_smooth_stretches,
    fit_linear,
)
from labpipe.uncertainty.intervals import MeasuredNumber, SmoothNumbers, measure_numbers
from labpipe.uncertainty.replicates import Choice, Extractor, Input, Replicates, Trace, restrict

MAD_FACTOR = 1.4826
"""Ratio of the standard deviation of normal noise to its median absolute deviation."""
MAD_FREEDOM_RATIO = 0.37
"""Ratio of the degrees of freedom of a median absolute deviation to those of a variance."""
_MIN_SIDE_SAMPLES = 8
"""Smallest number of samples on each side of a drop."""
_STRETCH_SAMPLES = 100
"""Number of samples of the stretches from which the noise is estimated."""


@dataclass(frozen=True, slots=True)
class LoadDrop:
    """A sudden loss of force.

    Parameters
    ----------
    start, stop : last sample before the loss and first sample after it
    middle : middle of the most probable drop, in samples; the mean of drops that fit equally well
    drop, drop_interval : N, loss of force and its 95 % interval
    earliest_start, latest_stop : earliest start and latest stop, in samples, of the possible drops
        (see `fit_load_drop`) with integer starts and lengths
    keeps_slope : whether the slope after the drop is at least 0.3 of that before it, within two
        standard errors
    """

    start: int
    stop: int
    middle: float
    drop: float
    drop_interval: Interval
    earliest_start: int
    latest_stop: int
    keeps_slope: bool


@dataclass(frozen=True, slots=True, eq=False)
class BlockCurve:
    """A loading curve that is searched for drops: samples, or means over blocks of samples.

    Parameters
    ----------
    d, f : shape (n,), m and N, displacement and force, evenly spaced, without NaN
    longest_drop : number of samples of the longest drop
    block_margin : 1 for means, because a drop may lie inside a block; 0 for samples
    """

    d: Floats
    f: Floats
    longest_drop: int
    block_margin: int

    def add_back(self, drops: Sequence[LoadDrop]) -> BlockCurve:
        """Add drops back to the curve, interpolated between their start and stop."""
        return replace(self, f=curves.add_slips_back(self.f, drops))


def fit_load_drop(curve: BlockCurve, sample: int) -> LoadDrop | None:
    """Fit a sudden loss of force near a sample.

    Parameters
    ----------
    curve : the curve, with all other drops added back
    sample : index of a sample near the drop

    Returns
    -------
    The drop; None if noise explains it, if it is longer than the longest drop of the curve, if it
    is too close to an end of the window, or if the force rises throughout.

    Notes
    -----
    The model is a polynomial with a step over a window around the sample. On each side, the window
    has 25 samples more than the longest drop, and the polynomial has degree three. If that fit
    finds no drop, 15 samples and degree two are tried, then 10 samples and degree one. In a longer
    window, the step has less noise but is biased by changes of the curvature, by up to 4 % of the
    deviation (the trade-off is that of jumps in regressions: Hahn, Todd and van der Klaauw,
    Econometrica 69 (2001) 201). The force is assumed to fall linearly.
    Starts are tried every quarter sample; lengths every quarter sample up to two samples and every
    whole sample beyond. All pairs of start and length are tried in first-order autoregressive
    noise, whose correlation is estimated from the whole curve. A pair is a possible drop if its
    whitened sum of squares exceeds the smallest one by at most 3.84 variances. Each sample inside
    any possible drop has its own level. The loss is the step by generalised least squares, with its
    interval (`fit_linear`). The other parts of the curve add information on the noise.

    A drop must pass a one-sided t-test of the sums of squares in the window. The false-alarm rate
    of 1e-3 for a whole curve is divided by the number of samples and lengths.
    """
    # Number of samples beyond the longest drop on each side, and degree of the polynomial, so that
    # the misfit of the polynomial is below the noise. The longest window is tried first.
    windows = ((25, 3), (15, 2), (10, 1))
    correlation = _estimate_correlation(curve.f)
    for side_samples, degree in windows:
        reach = curve.longest_drop + side_samples
        start, stop = max(0, sample - reach), min(len(curve.f), sample + reach + 1)
        if sample - start >= _MIN_SIDE_SAMPLES and stop - sample > _MIN_SIDE_SAMPLES:
            drop = _Window(curve, start, stop, degree, correlation).fit_drop(sample)
            if drop is not None:
                return drop
    return None


@dataclass(frozen=True, slots=True)
class _Window:
    """Samples of a curve around a drop.

    Parameters
    ----------
    curve : the curve
    start, stop : first sample, and the one after the last
    degree : degree of the polynomial through the samples
    correlation : lag-one correlation of the noise
    """

    curve: BlockCurve
    start: int
    stop: int
    degree: int
    correlation: float

    def fit_drop(self, sample: int) -> LoadDrop | None:
        """Fit a polynomial and a drop with every pair of start and length near a sample."""
        # Largest excess of the sum of squares of a possible drop over the smallest one, variances:
        # the 95 % quantile of chi-squared with one degree of freedom.
        max_excess_variances = 3.84
        start_step = 0.25  # samples
        curve, longest = self.curve, self.curve.longest_drop
        first, last = max(self.start + 4, sample - longest), min(self.stop - 5, sample + longest)
        lengths = np.append(np.arange(start_step, 2.0, start_step), np.arange(2.0, longest + 2.0))
        starts = np.arange(first, last, start_step)
        drops = np.array(np.meshgrid(starts, lengths)).reshape(2, -1).T
        drops = drops[drops.sum(axis=1) <= self.stop - 5]
        costs, no_drop_cost = self._compute_costs(drops)
        min_cost, dof = float(costs.min()), max(self.stop - self.start - self.degree - 4, 1)
        variance = min_cost / dof
        # All drops between the same two samples have the same cost.
        best_drop = drops[costs <= min_cost + 1e-9 * variance].mean(axis=0)
        # A drop is rejected if it is longer than the longest drop, or fits no better than no drop.
        if best_drop[1] > longest or no_drop_cost <= min_cost:
            return None
        t = float(np.sqrt((no_drop_cost - min_cost) / variance)) if variance > 0.0 else np.inf
        false_alarm_rate = 1e-3 / (len(curve.f) * (longest + 1))
        if not scipy.special.stdtr(dof, -t) <= false_alarm_rate:
            return None
        is_whole, excess = np.all(drops % 1.0 == 0.0, axis=1), max_excess_variances * variance
        whole_drops = drops[is_whole & (costs <= costs[is_whole].min() + excess)]
        return self._measure_drop(best_drop, drops[costs <= min_cost + excess], whole_drops)

    def _compute_costs(self, drops: Floats) -> tuple[Floats, float]:
        """Compute whitened sums of squares of linear drops, and the sum without a drop."""
        rows, curve = np.arange(self.start, self.stop), self.curve
        ramps = np.clip((rows[:, None] - drops[:, 0]) / drops[:, 1], 0.0, 1.0)
        powers, f = np.column_stack(_make_powers(curve.d[rows], self.degree)), curve.f[rows]
        base, ramps, target = (
            values[1:] - self.correlation * values[:-1] for values in (powers, ramps, f - f[0])
        )
        base = np.linalg.qr(base)[0]
        ramps, target = ramps - base @ (base.T @ ramps), target - base @ (base.T @ target)
        norms, cost = np.maximum(np.sum(ramps**2, axis=0), 1e-12), float(target @ target)
        return np.maximum(cost - np.minimum(target @ ramps, 0.0) ** 2 / norms, 0.0), cost

    def _measure_drop(self, drop: Floats, drops: Floats, whole_drops: Floats) -> LoadDrop | None:
        """Measure the most probable drop; its interval allows for all possible drops.

        A drop is a row of start and length, in samples; `whole_drops` have integer starts and
        lengths.
        """
        min_slope_ratio = 0.3
        curve, window = self.curve, slice(self.start, self.stop)
        start, stop = int(np.floor(drop[0])), int(np.ceil(drop.sum()))
        first = int(np.floor(drops[:, 0].min())) + 1 - curve.block_margin
        last = int(np.ceil(drops.sum(axis=1).max())) + curve.block_margin
        if min(first - 1 - self.start, self.stop - last) < 4:
            return None
        rows, f = np.arange(self.start, self.stop), curve.f[window]
        is_after = (rows >= stop).astype(np.float64)
        powers = _make_powers(curve.d[window], self.degree)
        # A sample that may be inside the drop has its own level; else the loss would be too small.
        inside_levels = np.eye(len(rows))[:, first - self.start : last - self.start]
        design = np.column_stack([is_after, *powers, inside_levels])
        cut = partial(cut_smooth_stretches, width=_STRETCH_SAMPLES)
        stretches = [*cut(curve.f[: self.start]), *cut(curve.f[self.stop :])]
        loss = fit_linear(design, f, is_weighted=True, other_stretches=stretches).make_estimate(0)
        steps = np.diff(curve.f[max(first - 1, self.start) : last + 1])
        # If the force rises throughout, only its slope changes, and there is no drop.
        is_lost = loss.interval is not None and loss.interval.upper < 0.0
        if loss.interval is None or not is_lost or float(steps.min(initial=0.0)) >= 0.0:
            return None
        lines = np.column_stack([*powers[:2], is_after, powers[1] * is_after, inside_levels])
        line_fit = fit_linear(lines, f)
        slope, change = line_fit.coefficients[[1, 3]].tolist()
        error = float(np.sqrt(line_fit.covariance[3, 3]))
        return LoadDrop(
            start=start,
            stop=stop,
            middle=float(drop[0] + 0.5 * drop[1]),
            drop=-loss.value,
            drop_interval=Interval(-loss.interval.upper, -loss.interval.lower),
            earliest_start=int(whole_drops[:, 0].min()),
            latest_stop=int(whole_drops.sum(axis=1).max()),
            keeps_slope=slope + change + 2.0 * error >= min_slope_ratio * slope,
        )


def _make_powers(x: Floats, degree: int) -> list[Floats]:
    """Compute powers from 0 to a degree of values that are centred and scaled to a range of 1."""
    scaled = (x - x.mean()) / (float(np.ptp(x)) or 1.0)
    return [scaled**power for power in range(degree + 1)]


def _estimate_correlation(f: Floats) -> float:
    """Estimate the lag-one correlation of the noise.

    The estimate follows from the median correlation of the residuals of stretches about a cubic.
    """
    width = min(_STRETCH_SAMPLES, len(f))
    basis = build_polynomial_basis(width, 4)
    starts = range(0, len(f) - width + 1, max(width // 4, 1))
    stretches = np.array([f[start : start + width] for start in starts])
    residuals = stretches - (stretches @ basis) @ basis.T
    squares = np.maximum(np.sum(residuals**2, axis=1), np.finfo(float).tiny)
    products = np.sum(residuals[:, 1:] * residuals[:, :-1], axis=1)
    noise_correlations, residual_correlations = _tabulate_correlations(width)
    return float(
        np.interp(np.median(products / squares), residual_correlations, noise_correlations)
    )


@cache
def _tabulate_correlations(width: int) -> tuple[Floats, Floats]:
    """Tabulate lag-one correlations of the noise, and of its residuals about a cubic.

    Residuals of a fit are less correlated than the noise (Kendall, Biometrika 41 (1954)).
    """
    noise_correlations = np.array([*np.linspace(0.0, 0.9, 10), 0.94, 0.97, 0.985])
    basis = build_polynomial_basis(width, 4)
    lags = np.abs(np.subtract.outer(np.arange(width), np.arange(width)))
    residual_correlations = []
    for noise_correlation in noise_correlations:
        noise_covariance = noise_correlation**lags
        cross_covariance = noise_covariance - basis @ (basis.T @ noise_covariance)
        covariance = cross_covariance - (cross_covariance @ basis) @ basis.T
        residual_correlations.append(np.trace(covariance, offset=1) / np.trace(covariance))
    return noise_correlations, np.array(residual_correlations)


_MIN_SEARCHED_SAMPLES = 64
"""Number of samples of the shortest branch that is searched for slips."""


@return_failure
def find_slips(
    displacement: Floats, force: Floats, *, min_drop: float, decision: SlipDecision
) -> tuple[Slip, ...]:
    """Find sudden losses of force after which the slope of the force is about the same.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; one loading branch at constant speed, up to the failure;
        evenly sampled; NaN are ignored
    min_drop : N, smallest loss that is not ignored
    decision : decision about the slips, for the ledger

    Returns
    -------
    The slips in order, with indices of samples of the arguments; or a failure ``too_few_samples``
    (fewer than 64).

    Notes
    -----
    The longest slip is 2 % of the travel, but at most 1 mm and at least two samples. A slower drop
    is a yield. If the longest slip has 16 samples or more, samples are averaged in blocks, 8 to 12
    for this slip, so that the result does not depend on the sampling rate. `start` and `stop` are
    the samples around these means. Differences of the means of adjacent windows of 3 to 48 samples,
    less their running median, show sudden drops but not slopes, kinks and yields. The differences
    of each window length are divided by their robust standard deviation (1.4826 MAD), valid for
    noise of any correlation, and compared with Student's t for its degrees of freedom.

    The most distinct drop is measured (`fit_load_drop`) and added back before the next search, so
    that it is neither found again nor hides its neighbours. At the end, each drop is measured with
    all others added back, and a drop that is no longer distinct is discarded. The loss of a slip is
    at least `min_drop` and at most a fifth of the force before it. The slope after the slip must
    not be below 0.3 of the slope before it by more than two standard errors. The force must again
    reach at least half of its largest value before the slip.

    The 95 % interval of the loss holds in noise that is white, slow or both. The interval of the
    position is the middle 95 % of the displacements from the earliest start to the latest stop of
    all possible drops, extended to the position if that is outside. Its coverage exceeds 95 % for a
    drop that takes time, because it is at least as wide as the samples around the drop.
    """
    finite_samples = curves.find_finite_samples(displacement, force)
    curves.require_samples(len(finite_samples), _MIN_SEARCHED_SAMPLES, " in the branch")
    # A larger drop is a failure. Grips slide in small steps, but a torn strand loses its part of
    # the section. Adding this loss back would overestimate the strength.
    max_drop_fraction, min_recovered_fraction = 0.2, 0.5  # of the force before the drop
    width, longest_blocks = _choose_block_width(displacement[finite_samples])
    # The last block includes the remainder.
    starts = np.arange(0, len(finite_samples) - width + 1, width)
    d, f = (average_between(values[finite_samples], starts) for values in (displacement, force))
    curve = BlockCurve(d, f, longest_blocks, int(width > 1))
    slips = list[Slip]()
    for drop in _find_drops(curve, min_drop):
        max_drop = max_drop_fraction * median(f[max(drop.start - 4, 0) : drop.start + 1])
        needed_force = min_recovered_fraction * f[: drop.start + 1].max()
        has_recovered = drop.keeps_slope and f[drop.stop :].max() >= needed_force
        if not (min_drop <= drop.drop <= max_drop and has_recovered):
            continue
        ends = float(d[drop.earliest_start]), float(d[drop.latest_stop])
        middle, half_range = 0.5 * sum(ends), 0.475 * (ends[1] - ends[0])
        position = float(np.interp(drop.middle, np.arange(len(d)), d))
        interval = Interval(min(middle - half_range, position), max(middle + half_range, position))
        start, stop = finite_samples[[drop.start * width + width - 1, drop.stop * width]].tolist()
        slips.append(Slip(position, drop.drop, interval, drop.drop_interval, decision, start, stop))
    return tuple(slips)


def _choose_block_width(d: Floats) -> tuple[int, int]:
    """Choose the number of samples of a block, and the number of blocks of the longest slip."""
    min_slip_blocks, max_slip_fraction, max_slip_length = 8, 0.02, 1e-3  # of the travel; m
    travel = float(np.ptp(d))
    slip_length = min(max_slip_fraction * travel, max_slip_length)
    slip_samples = slip_length / (travel / (len(d) - 1)) if travel > 0.0 else 0.0
    width = int(np.clip(slip_samples // min_slip_blocks, 1, len(d) // _MIN_SEARCHED_SAMPLES))
    return width, int(np.clip(np.ceil(slip_samples / width), 2, 2 * min_slip_blocks))


def _find_drops(curve: BlockCurve, min_drop: float) -> list[LoadDrop]:
    """Find the sudden drops that are distinct with all other drops added back, in order.

    The most distinct drop is found first, and added back before the next search.
    """
    drops, repaired_curve = list[LoadDrop](), curve
    is_searched = np.ones(len(curve.f), dtype=np.bool_)
    while True:
        distinctness = np.where(is_searched, _compute_distinctness(repaired_curve.f, min_drop), 0.0)
        sample = int(np.argmax(distinctness))
        if distinctness[sample] <= 1.0:
            break
        drop = fit_load_drop(repaired_curve, sample)
        if drop is None or not is_searched[drop.start : drop.stop].any():
            is_searched[max(sample - _MIN_SIDE_SAMPLES, 0) : sample + _MIN_SIDE_SAMPLES + 1] = False
            continue
        drops.append(drop)
        repaired_curve = repaired_curve.add_back([drop])
        is_searched[max(min(sample, drop.start) - 1, 0) : max(sample, drop.stop) + 1] = False
    if len(drops) > 1:
        single_drop_curves = [curve.add_back([x for x in drops if x is not drop]) for drop in drops]
        refits = map(fit_load_drop, single_drop_curves, [drop.start for drop in drops])
        drops = [drop for drop in refits if drop is not None]
    return sorted(drops, key=lambda drop: drop.start)


def _compute_distinctness(f: Floats, min_drop: float) -> Floats:
    """Compute the distinctness of a drop after each sample; that of a candidate is above 1."""
    widths = (3, 6, 12, 24, 48)  # samples of a window
    false_alarm_rate = 1e-5  # probability of a candidate at one sample by noise alone
    distinctness = np.zeros(len(f))
    if not np.ptp(f) > 0.0:
        return distinctness
    from scipy.ndimage import median_filter

    sums = np.concatenate([[0.0], np.cumsum(f - f.mean())])
    for width in (x for x in widths if 8 * x <= len(f)):
        # Decrease of the mean force from the window before a sample to the window after it, less
        # its running median.
        ends = np.arange(width, len(f) - width + 1)
        fall = (2.0 * sums[ends] - sums[ends - width] - sums[ends + width]) / width
        loss = np.zeros(len(f))
        loss[ends - 1] = fall - median_filter(fall, 8 * width + 1, mode="nearest")
        spread = max(MAD_FACTOR * median(np.abs(loss)), 1e-9 * float(np.ptp(f)))
        # Adjacent windows share samples, which reduces the degrees of freedom.
        dof = int(MAD_FREEDOM_RATIO * len(f) / width)
        ratio = loss / (spread * scipy.special.stdtrit(dof, 1.0 - false_alarm_rate))
        distinctness = np.maximum(distinctness, np.where(loss >= 0.5 * min_drop, ratio, 0.0))
    distinctness[:_MIN_SIDE_SAMPLES], distinctness[len(f) - _MIN_SIDE_SAMPLES :] = 0.0, 0.0
    return distinctness


def list_slack_doubts(measured_slack: MeasuredNumber) -> tuple[Reason, ...]:
    """List doubts about displacements that are measured from a doubtful slack."""
    return tuple(
        Reason(reason.code, format_sentence("results.doubtful_slack", why=reason.message))
        for _, reason in measured_slack.doubts
    )


class SlipResults(Kind):
    """``slip_position.<n>`` (m) and ``slip_drop.<n>`` (N) of each slip, if there are any."""

    result: ClassVar = "slips"
    outputs: ClassVar = (
        Output("slip_position", "m", "Position of slip", ("displacement",), first=1),
        Output("slip_drop", "N", "Force lost in slip", ("force",), first=1),
    )
    needs: ClassVar = Needs(branches=True, correction="slips")

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Yield the position and the loss of force of each slip of the ledger."""
        slack_error, doubts = 0.0, tuple[Reason, ...]()
        if isinstance(test.slack, MeasuredNumber):
            slack_error, doubts = test.slack.error, list_slack_doubts(test.slack)
        for index, slip in enumerate(test.slips, start=1):
            time, interval = test.required_curve.time, slip.position_interval
            position = Estimate(slip.position, interval.standard_error, 1, interval)
            drop = Estimate(slip.drop, slip.drop_interval.standard_error, 1, slip.drop_interval)
            scale_error = test.displacement.relative_error * abs(position.value)
            errors = {SLACK: slack_error, SCALE_OF_DISPLACEMENT: scale_error}
            method = f"step in a polynomial around a sudden fall of the force; {slip.decision}"
            period = float(time[slip.start]), float(time[slip.stop])
            context: dict[str, Any] = {"method": method, "period": period, "suffix": f".{index}"}
            yield self.make_result(test, position, errors, doubts=doubts, **context)
            scale_errors = compute_scale_error(test, drop)
            yield self.make_result(test, drop, scale_errors, output=1, **context)


def find_linear_region(
    displacement: Floats, force: Floats, *, start_fraction: float, stop_fraction: float
) -> Samples:
    """Find the samples of the linear region for toe compensation.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; the loading branch in order of time, force zeroed;
        NaN are ignored
    start_fraction, stop_fraction : fractions of the largest force between which the region lies

    Returns
    -------
    The samples. The slack is the displacement at which the line through them meets zero force
    (`labpipe.results.curves.compute_zero_crossing`).

    Raises
    ------
    UnavailableError
        ``too_few_samples`` (fewer than 8 in the region), ``not_rising`` if the force does not rise
        in the region, ``not_reached`` if the branch begins above `start_fraction`.

    Notes
    -----
    This is the toe compensation of ASTM D638, annex A1 (also D882): the tangent to the linear
    region is extrapolated to zero force, the corrected zero of displacement. Each end of the region
    is halfway between the first sample above its fraction and the last sample below it before the
    peak, so that single noisy samples do not determine the region.

    Examples
    --------
    >>> d = np.linspace(0.0, 0.02, 401)
    >>> force = 5000.0 * np.maximum(d - 0.002, 0.0)
    >>> region = find_linear_region(d, force, start_fraction=0.1, stop_fraction=0.3)
    >>> round(1e3 * float(curves.compute_zero_crossing(d[region], force[region])), 9)
    2.0
    """
    min_region_samples = 8
    finite_samples = curves.find_finite_samples(displacement, force)
    d, f = displacement[finite_samples], force[finite_samples]
    curves.require_samples(len(d), min_region_samples, "")
    peak = int(np.argmax(f))
    limits = start_fraction * float(f[peak]), stop_fraction * float(f[peak])
    first, last = (_find_crossing(f[: peak + 1], limit) for limit in limits)
    if peak == 0:
        raise UnavailableError.of("results.not_rising")
    if first == 0:
        facts = {"begin": f[0], "share": start_fraction, "largest": f[peak]}
        raise UnavailableError.of("results.begins_above", **facts)
    curves.require_samples(max(last - first, 0), min_region_samples, " in the linear region")
    region = slice(first, last)
    if np.isnan(curves.compute_zero_crossing(d[region], f[region])):
        raise UnavailableError.of("results.not_rising")
    return convert_to_slice(finite_samples[region])


def _find_crossing(force: Floats, limit: float) -> int:
    """Find the sample at which a rising force crosses a limit; 0 if it does not cross it."""
    is_above = force >= limit
    if is_above.all() or not is_above.any():
        return 0
    return (int(np.argmax(is_above)) + int(np.flatnonzero(~is_above)[-1]) + 1) // 2


def choose_slack_samples(trace: Trace, *, start_fraction: float, stop_fraction: float) -> Extractor:
    """Choose the samples for the displacement at which the linear region meets zero force.

    Parameters
    ----------
    trace : one curve
    start_fraction, stop_fraction : ends of the linear region, as fractions of the largest force

    Returns
    -------
    The function that computes the slack, m, with the number of samples.

    Raises
    ------
    UnavailableError
        As `find_linear_region`.
    """
    stretch = curves.select_first_loading(trace)
    region = find_linear_region(
        trace.displacement[stretch],
        trace.force[stretch],
        start_fraction=start_fraction,
        stop_fraction=stop_fraction,
    )
    samples = np.arange(stretch.start, stretch.stop)[region]
    slack = restrict(curves.compute_zero_crossing, convert_to_slice(samples))
    return Extractor(slack, len(samples), ends_at_samples=True)


def subtract_slack(replicates: Replicates, choose: Choice, slack: MeasuredNumber) -> Replicates:
    """Subtract the measured slack from all curves, and add its noise as an input.

    Parameters
    ----------
    replicates : replicates of a curve whose slack can be measured
    choose : function that chooses the samples of the slack
    slack : slack of the measured curve, m

    Returns
    -------
    The curves without slack. The effect of noise on the slack, if there is any, is one more input,
    with the same draws as the curves. Doubts about the slack become doubts about that input. The
    effect of another input on the slack is subtracted from its effect on the displacement, so that
    an error of the zero of the displacement cancels.
    """
    deviations = measure_numbers(replace(replicates, inputs=()), choose)[0].deviations
    deviations = np.where(np.isnan(deviations), np.nanmean(deviations), deviations)
    error = float(np.std(deviations))
    smooth_trace = replicates.smooth_trace
    inputs = tuple(_subtract_slack_effect(x, smooth_trace, choose) for x in replicates.inputs)
    corrected = replace(replicates, inputs=inputs)
    if not error:
        return corrected.shift_displacement(-slack.value)
    shift = partial(curves.shift_displacement_by, change=-error)
    doubts = list_slack_doubts(slack)
    slack_input = Input(SLACK, shift, drawn_errors=deviations / error, doubts=doubts)
    return corrected.shift_displacement(-slack.value, slack_input)


def _subtract_slack_effect(quantity: Input, smooth: Trace, choose: Choice) -> Input:
    """Subtract the effect of an input on the slack from its effect on the displacement.

    If the smooth curve has no slack, the input is returned unchanged.
    """
    extractor = return_failure(choose)(smooth)
    if isinstance(extractor, Failure):
        return quantity
    smooth_slack = SmoothNumbers.of(choose, smooth, extractor)
    lower, upper = (float(smooth_slack.compute_change(quantity, x)[0]) for x in (-1.0, 1.0))

    def perturb(trace: Trace, n_units: float) -> Trace:
        change = lower if n_units <= 0.0 else -upper
        return curves.shift_displacement_by(quantity.perturb(trace, n_units), n_units, change)

    return replace(quantity, perturb=perturb)


class SlackResult(Kind):
    """``slack`` (m): displacement at which the specimen becomes taut."""

    result: ClassVar = "slack"
    outputs: ClassVar = (Output("slack", "m", "Slack", ("displacement",), can_be_negative=True),)
    needs: ClassVar = Needs(branches=True, correction="slack")
    method: ClassVar = "toe compensation, ASTM D638 annex A1"

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Yield the displacement at which the line of the linear region meets zero force."""
        slack, period = return_failure(test.require)(test.slack), test.find_loading_period()
        yield self.make_result(test, slack, period=period)
