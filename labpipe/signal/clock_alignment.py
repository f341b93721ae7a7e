"""Fit the offset and the drift between two clocks to common events or to a repeated motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import chdtri

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import ClockFit, Interval
from labpipe.records.estimates import Estimate, Failure
from labpipe.signal.filters import compute_moving_average, convert_seconds_to_window
from labpipe.signal.turning_points import Stroke, find_strokes
from labpipe.uncertainty.autocorrelation import estimate_long_run_variance

_MIN_BINS = 50
"""Smallest number of bins of a cycle to which a lag is fitted."""


def find_rough_peaks(time: Floats, values: Floats, *, smoothing: float, fall: float) -> Floats:
    """Find the times of the upper turning points of a signal, to within about `smoothing`.

    Parameters
    ----------
    time, values : shape (n,), times (s) and values (any unit) of the signal
    smoothing : duration of the moving average that is applied first, s
    fall : smallest decrease of the signal after a turn, as a fraction of the range of the signal

    Returns
    -------
    Shape (peaks,), times, s; empty for a constant signal.

    Notes
    -----
    On a plateau before a decrease, the largest sample may be anywhere. The turning point is
    therefore the time at which the slope changes most, where 2 y(t) - y(t - h) - y(t + h) is
    largest. The distance h is twice `smoothing`, but at most a quarter of the shorter stroke.
    """
    stride = max(1, convert_seconds_to_window(smoothing, time) // 10)
    window = max(1, 2 * (convert_seconds_to_window(smoothing, time) // stride // 2) + 1)
    count = len(values) // stride * stride
    average = np.nanmean if np.isnan(values).any() else np.mean  # nanmean copies the values
    levels = average(values[:count].reshape(-1, stride), axis=1) if count else values
    smooth = compute_moving_average(levels, window=min(window, len(levels) - 1 + len(levels) % 2))
    full_range = float(np.nanmax(smooth) - np.nanmin(smooth)) if len(smooth) else 0.0
    if not full_range > 0:
        return np.empty(0)
    level_times = time[:count].reshape(-1, stride).mean(axis=1)
    strokes = find_strokes(level_times, smooth, min_stroke=fall * full_range)
    peak_times = [
        level_times[_find_sharpest_turn(smooth, first, second, 2 * window)]
        for first, second in pairwise(strokes)
        if first.sign > 0 > second.sign
    ]
    return np.array(peak_times, dtype=np.float64)


def _find_sharpest_turn(values: Floats, rise: Stroke, descent: Stroke, reach: int) -> int:
    """Find the sample at which a rise turns into a descent, by the slopes over `reach` samples."""
    reach = min(reach, (rise.stop - rise.start) // 4, (descent.stop - descent.start) // 4)
    start, stop = rise.start + reach, descent.stop - reach
    if reach < 1 or stop <= start:
        return rise.stop
    middle = values[start:stop]
    slope_drops = 2.0 * middle - values[start - reach : stop - reach]
    slope_drops -= values[start + reach : stop + reach]
    return start + int(np.nanargmax(slope_drops)) if np.isfinite(slope_drops).any() else rise.stop


def match_peaks(motion_times: Floats, force_times: Floats) -> tuple[Ints, bool]:
    """Pair the peaks of two records of the same test.

    Parameters
    ----------
    motion_times, force_times : shapes (p,) and (q,), s, increasing times of the peaks of the motion
        and of the force, each on its own clock

    Returns
    -------
    pairs : shape (k, 2), indices in `motion_times` and in `force_times`; empty if one record has no
        peak
    is_ambiguous : whether another pairing fits as well

    Notes
    -----
    Both records contain the same peaks in the same order, except for peaks before the start of one
    of the records. The shift with the most pairs is chosen, and of several such shifts the one with
    the most constant time difference. The choice is ambiguous if several shifts are equal in both
    respects. The shift with the smallest time difference is then chosen, since both records usually
    start together.
    """
    if min(len(motion_times), len(force_times)) == 0:
        return np.empty((0, 2), dtype=np.int64), False
    candidates = []
    for shift in range(-len(motion_times) + 1, len(force_times)):
        motion_peaks = np.arange(max(0, -shift), min(len(motion_times), len(force_times) - shift))
        differences = force_times[motion_peaks + shift] - motion_times[motion_peaks]
        spread = round(float(np.ptp(differences)), 1)  # s; finer spreads are errors of the peaks
        distance = abs(float(np.median(differences)))
        candidates.append((-len(motion_peaks), spread, distance, shift, motion_peaks))
    candidates.sort(key=lambda candidate: candidate[:4])
    best_candidate, *other_candidates = candidates
    is_ambiguous = any(candidate[:2] == best_candidate[:2] for candidate in other_candidates)
    *_, shift, motion_peaks = best_candidate
    return np.column_stack([motion_peaks, motion_peaks + shift]), is_ambiguous


@dataclass(frozen=True, slots=True)
class CycleLag:
    """Lag after which a cycle of the test repeats, on both clocks.

    Parameters
    ----------
    motion_lag, force_lag : lag on the clock of the motion and on the clock of the force, s
    error : standard error of the difference of the two lags, s
    zero_drift_error : error of the difference from a drift of the zero of the force, s, which
        widens the intervals but has no effect on the weights
    """

    motion_lag: float
    force_lag: float
    error: float
    zero_drift_error: float = 0.0


def fit_clocks(
    motion: Floats, force: Floats, errors: Floats, *, method: str, cycle_lag: CycleLag | None = None
) -> ClockFit:
    """Fit force time = offset + (1 + drift) x motion time to events on both clocks.

    Parameters
    ----------
    motion, force : shape (events,), s, times of the events on the clocks of motion and force; at
        least one event
    errors : shape (events,), s, standard error of the time difference of each event, positive
    method : description of the search for events
    cycle_lag : lag of a repeated cycle, which determines the drift but not the offset; None without
        such a lag

    Returns
    -------
    The fit. With one event and no lag, the drift is zero and its interval is NaN.

    Raises
    ------
    ValueError
        If there is no event, or an error is not positive.

    Notes
    -----
    The fit is by weighted least squares with known errors, and 95 % intervals are those of the
    normal distribution. If the events scatter more than their errors allow (chi-square above its
    99 % quantile), the intervals are widened by the square root of chi-square divided by its
    degrees of freedom.
    """
    if len(motion) == 0 or not (errors > 0).all():
        raise ValueError(format_sentence("signal.no_events", count=len(motion)))
    centre = float(np.average(motion, weights=errors**-2.0))
    design = np.column_stack([np.ones_like(motion), motion - centre])
    differences, difference_errors = force - motion, errors
    if cycle_lag is not None:
        design = np.vstack([design, [0.0, cycle_lag.motion_lag]])
        differences = np.append(differences, cycle_lag.force_lag - cycle_lag.motion_lag)
        difference_errors = np.append(difference_errors, cycle_lag.error)
    is_single = len(differences) == 1
    design = design[:, : 1 if is_single else 2]
    solution, covariance = solve_weighted(design, differences, difference_errors)
    residuals = (differences - design @ solution) / difference_errors
    # Derivatives of the solution with respect to the last difference, which is that of the lags.
    sensitivity = covariance @ design[-1] / difference_errors[-1] ** 2
    freedom = len(differences) - design.shape[1]
    covariance = covariance * _compute_variance_factor(residuals, freedom=freedom)
    if cycle_lag is not None:
        zero_drift_errors = cycle_lag.zero_drift_error * sensitivity
        covariance += zero_drift_errors[:, None] * zero_drift_errors
    offset_weights = np.array([1.0, -centre])[: len(solution)]
    offset_variance = offset_weights @ covariance @ offset_weights
    offset = float(offset_weights @ solution), float(np.sqrt(offset_variance))
    drift = (0.0, np.nan) if is_single else (float(solution[1]), float(np.sqrt(covariance[1, 1])))
    return make_clock_fit(offset, drift, np.stack([motion, force, errors]), method)


def solve_weighted(design: Floats, values: Floats, errors: Floats) -> tuple[Floats, Floats]:
    """Solve linear equations by weighted least squares.

    Parameters
    ----------
    design : shape (equations, unknowns), coefficients of the unknowns
    values, errors : shape (equations,), right-hand sides and their standard errors

    Returns
    -------
    The unknowns, shape (unknowns,), and their covariance, which follows from the errors alone.
    """
    weighted_design = design / errors[:, None]
    covariance = np.asarray(np.linalg.inv(weighted_design.T @ weighted_design), dtype=np.float64)
    return covariance @ weighted_design.T @ (values / errors), covariance


def make_clock_fit(
    offset: tuple[float, float], drift: tuple[float, float], events: Floats, method: str
) -> ClockFit:
    """Make the relation of two clocks with normal 95 % intervals.

    Parameters
    ----------
    offset, drift : value and standard error of the offset, s, and of the dimensionless drift
    events : shape (3, events), s, times on both clocks, and standard errors of their differences
    method : description of the search for events
    """
    motion, force, errors = events
    residuals = force - offset[0] - (1.0 + drift[0]) * motion
    return ClockFit(
        offset=offset[0],
        drift=drift[0],
        offset_interval=Interval.make_normal(*offset),
        drift_interval=Interval.make_normal(*drift),
        residual=float(np.sqrt(np.mean(residuals**2))),
        event_times_motion=motion,
        event_times_force=force,
        event_errors=errors,
        method=method,
    )


def _compute_variance_factor(residuals: Floats, *, freedom: int) -> float:
    """Compute the factor on the variance, which is 1 unless events scatter more than expected.

    The residuals are divided by their standard errors.
    """
    max_chance = 0.01  # probability that events scatter by more without any further error
    chi_square = float(residuals @ residuals)
    is_exceeded = freedom > 0 and chi_square > chdtri(freedom, max_chance)
    return chi_square / freedom if is_exceeded else 1.0


def fit_lag(
    time: Floats,
    values: Floats,
    cycle: tuple[float, float, float],
    *,
    guess: float,
    hysteresis: bool,
) -> Estimate | Failure:
    """Fit the time after which a cycle of a signal repeats.

    Parameters
    ----------
    time, values : shape (n,), increasing times (s) and values (any unit) of the signal
    cycle : times of the beginning, the peak and the end of the earlier cycle, s
    guess : first guess of the lag, accurate to a second, s
    hysteresis : whether the signal is a force with a hysteresis loop that may have shifted along
        the displacement between the two cycles; False for a motion

    Returns
    -------
    The lag, s, or the failure ``too_few_samples``.

    Notes
    -----
    The model is y(t + lag) - y(t) = tau y'(t) + a + b y(t) + c y'(t) sign(turn - t), where tau is
    the error of the lag, a is a shift and b a change of scale of the later cycle, and c is a shift
    of the loop along the displacement, which has opposite signs in loading and unloading. The slope
    y' is that of the mean of both cycles. The model is fitted by least squares to at most 2000
    bins, and the fit is repeated until tau is below 1 % of its standard error, up to five times.

    The standard error follows from the long-run variance of the residuals, so that a cycle that
    repeats poorly has little weight. Noise increases y' and attenuates tau. Therefore tau and its
    error are divided by the fraction of the sum of squares of y' that is not noise (Fuller,
    Measurement Error Models, 1987, sec. 1.2).
    """
    max_bins, max_fits = 2000, 5
    start, turn, stop = cycle
    n_samples = int(np.searchsorted(time, stop) - np.searchsorted(time, start))
    count, where = max(0, min(max_bins, n_samples // 2)), "in the cycle"
    if count < _MIN_BINS:
        return Failure.of("signal.too_few_bins", count=count, where=where, needed=_MIN_BINS)
    edges = np.linspace(start, stop, count + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])
    earlier_means = _compute_bin_means(time, values, edges)
    lag = Estimate(guess, np.nan, 0)
    for _ in range(max_fits):
        means = earlier_means, _compute_bin_means(time, values, edges + lag.value)
        correction = _compute_lag_correction(middles, *means, turn, hysteresis=hysteresis)
        if isinstance(correction, Failure):
            return correction
        lag = replace(correction, value=lag.value + correction.value)
        if abs(correction.value) < 0.01 * correction.error:
            break
    return lag


def _compute_lag_correction(
    time: Floats, earlier_means: Floats, later_means: Floats, turn: float, *, hysteresis: bool
) -> Estimate | Failure:
    """Compute the correction of the lag, s, that aligns the later cycle with the earlier cycle."""
    mean = 0.5 * (earlier_means + later_means)
    slope = np.gradient(mean, time)
    is_used = ~np.isnan(slope) & (np.abs(time - turn) > 2.0 * (time[1] - time[0]))
    count = int(is_used.sum())
    if count < _MIN_BINS:
        where = "in both cycles"
        return Failure.of("signal.too_few_bins", count=count, where=where, needed=_MIN_BINS)
    columns = [slope, np.ones_like(mean), mean]
    if hysteresis:
        columns.append(slope * np.sign(turn - time))
    design = np.column_stack(columns)[is_used]
    difference = (later_means - earlier_means)[is_used]
    solution = np.linalg.lstsq(design, difference, rcond=None)[0]
    residuals = difference - design @ solution
    variance = estimate_long_run_variance(residuals, n_parameters=len(columns))
    covariance = np.linalg.pinv(design.T @ design)
    # A lag that is too large by tau gives y(t + lag) - y(t) = tau y'(t), so that the correction is
    # -tau. The residuals are differences of two cycles. Their variance is four times that of the
    # noise of the mean cycle. The slope, a central difference over two steps h, has 1 / (2 h^2) of
    # the variance of this noise.
    slope_noise = float(residuals @ residuals) / (8.0 * float(time[1] - time[0]) ** 2)
    reliability = max(0.1, 1.0 - slope_noise * float(covariance[0, 0]))
    error = float(np.sqrt(variance * covariance[0, 0])) / reliability
    return Estimate(-float(solution[0]) / reliability, error, count)


def _compute_bin_means(time: Floats, values: Floats, edges: Floats) -> Floats:
    """Compute the mean of the samples in each bin; NaN for an empty bin."""
    ends = np.searchsorted(time, edges)
    starts, stops = ends[:-1], ends[1:]
    filled_bins = np.flatnonzero(stops > starts)
    means: Floats = np.full(len(starts), np.nan)
    if len(filled_bins) == 0:
        return means
    rows = slice(int(starts[filled_bins[0]]), int(stops[filled_bins[-1]]))
    sums = np.add.reduceat(values[rows], starts[filled_bins] - rows.start)
    means[filled_bins] = sums / (stops - starts)[filled_bins]
    # The samples of a bin may be off its middle. The mean is therefore extrapolated to the middle.
    offset = np.zeros(len(starts))
    offset[filled_bins] = 0.5 * (time[starts[filled_bins]] + time[stops[filled_bins] - 1])
    offset[filled_bins] -= 0.5 * (edges[1:] + edges[:-1])[filled_bins]
    middle_means: Floats = means - offset * np.gradient(means, edges[1] - edges[0])
    return middle_means
