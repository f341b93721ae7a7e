"""Smoothing and thinning of signals that are sampled in time."""

from __future__ import annotations

import math

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
    from scipy.signal import butter, sosfiltfilt

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


def decimate(values: Floats, *, factor: int, filtered: bool) -> Floats:
    """Keep every `factor`-th sample.

    Parameters
    ----------
    values : shape (n,)
    factor : at least 1
    filtered : average over `factor` samples around each kept one first (zero phase); if False,
        take the samples as they are, as the source's scripts do

    Returns
    -------
    Shape (ceil(n / factor),). Sample 0 is kept, so no shift in time.

    Raises
    ------
    ValueError
        If `factor` is below 1.

    Notes
    -----
    Bare decimation folds noise from above the new half rate into the signal; it is there for
    comparison. NaN: as in `moving_average`, or kept as it stands.
    """
    if factor < 1:
        message = f"factor={factor}: expected at least 1"
        raise ValueError(message)
    if filtered and factor > 1:
        window = min(factor + 1 - factor % 2, len(values) - 1 + len(values) % 2)
        values = moving_average(values, window=window)
    return values[::factor].copy()


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
