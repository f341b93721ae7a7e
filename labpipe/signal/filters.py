"""Smoothing and thinning of signals that are sampled in time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from labpipe.records.arrays import Floats


def window_length(span: float, count: int) -> int:
    """Turn the span of MATLAB's ``smooth`` into an odd number of samples.

    Parameters
    ----------
    span : below 1 a fraction of `count`, else a number of samples
    count : number of samples in the signal

    Returns
    -------
    The window: at least 1, at most `count`, odd.

    Raises
    ------
    ValueError
        If `span` is not positive, or `count` is below 1.

    Notes
    -----
    A fraction means ceil(span x count) samples; other spans are rounded down; an even window loses
    one sample (documentation of MATLAB's Curve Fitting Toolbox, ``smooth``).

    Examples
    --------
    >>> window_length(0.05, 2650), window_length(6, 100), window_length(500, 12)
    (133, 5, 11)
    """
    if not span > 0 or count < 1:
        message = f"span={span}, count={count}: expected a positive span and at least one sample"
        raise ValueError(message)
    samples = math.ceil(span * count) if span < 1 else math.floor(span)
    samples = max(1, min(samples, count))
    return samples - 1 + samples % 2


def moving_average(values: Floats, *, window: int) -> Floats:
    """Centred moving average whose window shrinks symmetrically near the ends.

    Parameters
    ----------
    values : shape (n,)
    window : odd number of samples, 1 <= window <= n

    Returns
    -------
    Shape (n,). A new array; no shift in time.

    Raises
    ------
    ValueError
        If `window` is even or not between 1 and n.

    Notes
    -----
    The result of MATLAB's ``smooth(y, span, 'moving')``: sample i is the mean over
    i - h ... i + h with h = min((window - 1) / 2, i, n - 1 - i). One cumulative sum, so O(n)
    whatever the window. NaN: a window averages what is there; a window without data is NaN.
    The first and last (window - 1) / 2 samples are averaged over less than the full window.

    Examples
    --------
    >>> moving_average(np.array([3.0, 8, 2, 1, 5, 5]), window=5).round(4).tolist()
    [3.0, 4.3333, 3.8, 4.2, 3.6667, 5.0]
    """
    count = len(values)
    if window % 2 == 0 or not 1 <= window <= max(count, 1):
        message = f"window={window}: expected an odd number of samples from 1 to {count}"
        raise ValueError(message)
    if window == 1:
        return values.copy()
    sums = _window_sums(np.cumsum(values), window)
    if np.isfinite(sums[-1]) and np.isfinite(sums[len(sums) // 2]):
        return _divided(sums, window)
    there = ~np.isnan(values)
    sums = _window_sums(np.cumsum(np.where(there, values, 0.0)), window)
    counts = _window_sums(np.cumsum(there.astype(np.float64)), window)
    mean: Floats = np.full(count, np.nan)
    np.divide(sums, counts, out=mean, where=counts > 0.5)
    return mean


def _window_sums(total: Floats, window: int) -> Floats:
    """Sum over windows that shrink at the ends, from a cumulative sum."""
    half, count = window // 2, len(total)
    sums = np.empty(count)
    middle = sums[half : count - half]
    middle[0] = total[window - 1]
    np.subtract(total[window:], total[: count - window], out=middle[1:])
    sums[:half] = total[: 2 * half : 2]
    before = total[count - 2 * half + 2 * np.arange(half)]
    sums[count - half :] = total[-1] - before
    return sums


def _divided(sums: Floats, window: int) -> Floats:
    """Means from sums over shrinking windows, in place."""
    half, count = window // 2, len(sums)
    odd = np.arange(1.0, 2 * half, 2)
    sums[half : count - half] *= 1.0 / window
    sums[:half] /= odd
    sums[count - half :] /= odd[::-1]
    return sums


def smoothed(values: Floats, *, window: int) -> Floats:
    """Moving average that follows the signal to its ends.

    Parameters
    ----------
    values : shape (n,)
    window : odd number of samples; cut to n

    Returns
    -------
    Shape (n,). A new array; no shift in time.

    Notes
    -----
    Inside the mean over the window; in the first and last half window the straight line by least
    squares through the outermost window: the filter of Savitzky and Golay, Anal. Chem. 36 (1964)
    1627, of degree one, which a spreadsheet has as AVERAGE and FORECAST. So a signal that ends in
    a corner keeps its height, without the noise of its last sample; the line stays within what
    was measured there, so that a smooth top is not overshot. NaN are left out; where a
    window holds less than two samples, the line is what `moving_average` gives.
    """
    window = min(window, len(values) - 1 + len(values) % 2)
    if window < 3:
        return values.copy()
    mean = moving_average(values, window=window)
    half, number = window // 2, np.arange(window) - 0.5 * (window - 1)
    for part, end in ((slice(window), slice(half)), (slice(-window, None), slice(-half, None))):
        known = ~np.isnan(values[part])
        if known.sum() > 1:
            seen = values[part][known]
            slope, level = np.polyfit(number[known], seen, 1)
            line = np.clip(level + slope * number[end], seen.min(), seen.max())
            mean[end] = np.where(np.isnan(mean[end]), np.nan, line)
    return mean


Filter = tuple[Callable[[Floats], Floats], int]
"""What a filter does to evenly spaced samples, and every how many-th of them it keeps."""


def in_pieces(values: Floats, cuts: Sequence[int], filters: Sequence[Filter]) -> Floats:
    """Filter a signal piece by piece, so that no filter reaches across a corner or a loss.

    Parameters
    ----------
    values : shape (n,)
    cuts : numbers of the samples at which a new piece begins
    filters : one after the other

    Returns
    -------
    Shape (m,), fewer than n where a filter thins.
    """
    ends = sorted({0, len(values), *(cut for cut in cuts if 0 < cut < len(values))})
    for act, stride in filters:
        values = np.concatenate([act(values[low:high]) for low, high in pairwise(ends)])[::stride]
        ends = sorted({-(-end // stride) for end in ends})
    return values


def power_passed(act: Callable[[Floats], Floats], count: int) -> float:
    """Share of the power of white noise that a filter lets through.

    Parameters
    ----------
    act : linear, on evenly spaced samples
    count : samples of the signal

    Returns
    -------
    Sum of the squares of its response to a single sample in the middle of `count`.
    """
    pulse = np.zeros(count)
    pulse[count // 2] = 1.0
    answer = act(pulse)
    return float(answer @ answer)


def low_pass(values: Floats, *, cutoff: float, rate: float, order: int) -> Floats:
    """Zero-phase Butterworth low-pass, run forwards and backwards.

    Parameters
    ----------
    values : shape (n,)
    cutoff : 1/s, where the amplitude has fallen to one half (both runs together)
    rate : samples per second
    order : order of one run

    Returns
    -------
    Shape (n,). No shift in time.

    Raises
    ------
    ValueError
        If the cut-off is not between zero and half the rate, the signal is too short, or it
        holds NaN.

    Notes
    -----
    The ends are padded by odd reflection; within about rate / cutoff samples of an end the result
    depends on that padding.
    """
    from scipy.signal import butter, sosfiltfilt  # half a second that most tests need not wait

    if not 0 < cutoff < rate / 2:
        message = f"cutoff={cutoff}: expected a frequency between 0 and {rate / 2} 1/s"
        raise ValueError(message)
    if np.isnan(values).any():
        message = "expected a signal without gaps, found NaN"
        raise ValueError(message)
    sections = butter(order, cutoff, fs=rate, output="sos")
    pad = min(int(3 * rate / cutoff), len(values) - 1)
    filtered: Floats = sosfiltfilt(sections, values, padlen=pad)
    return filtered


def seconds_to_window(span: float, time: Floats) -> int:
    """Odd number of samples that covers `span` seconds of a clock, at the median step.

    Parameters
    ----------
    span : s
    time : shape (n,), s

    Returns
    -------
    The window, from 1 to n.

    Examples
    --------
    >>> seconds_to_window(0.1, np.arange(0.0, 1.0, 0.02))
    5
    """
    if len(time) < 2:
        return 1
    step = float(np.median(np.diff(time[: min(len(time), 100_000)])))
    return window_length(max(1.0, round(span / step, 6)), len(time))
