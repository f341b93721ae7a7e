"""Filter evenly sampled signals by moving averages and Butterworth low-pass filters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, compute_median_step, divide
from labpipe.records.signals import Filter


def compute_window(span: float, count: int) -> int:
    """Convert the span of MATLAB's ``smooth`` to a window, an odd number of samples.

    Parameters
    ----------
    span : fraction of `count` if below 1, otherwise a number of samples
    count : number of samples of the signal

    Returns
    -------
    The window, an odd number of samples from 1 to `count`.

    Raises
    ------
    ValueError
        If `span` is not positive, or `count` is below 1.

    Notes
    -----
    A fraction is converted to ceil(span x count) samples; other spans are rounded down. An even
    window is shortened by one sample (documentation of MATLAB's Curve Fitting Toolbox, ``smooth``).

    Examples
    --------
    >>> compute_window(0.05, 2650), compute_window(6, 100), compute_window(500, 12)
    (133, 5, 11)
    """
    if not span > 0 or count < 1:
        raise ValueError(format_sentence("signal.no_span", span=span, count=count))
    n_samples = math.ceil(span * count) if span < 1 else math.floor(span)
    n_samples = max(1, min(n_samples, count))
    return n_samples - 1 + n_samples % 2


def compute_moving_average(values: Floats, *, window: int, has_ends: bool = True) -> Floats:
    """Compute a centred moving average with a window that becomes shorter towards both ends.

    Parameters
    ----------
    values : shape (..., n), samples, which are averaged along the last axis
    window : odd number of samples, 1 <= window <= n
    has_ends : whether the first and last half window are computed; if False, they have no meaning

    Returns
    -------
    Shape (..., n), averages in a new array, without a shift in time.

    Raises
    ------
    ValueError
        If `window` is even or not between 1 and n.

    Notes
    -----
    The result is that of MATLAB's ``smooth(y, span, 'moving')``. Sample i is the mean over
    i - h ... i + h with h = min((window - 1) / 2, i, n - 1 - i). The means are computed from
    cumulative sums, so that the computing time hardly depends on the window. NaN are ignored; the
    mean of a window without data is NaN.

    Examples
    --------
    >>> compute_moving_average(np.array([3.0, 8, 2, 1, 5, 5]), window=5).round(4).tolist()
    [3.0, 4.3333, 3.8, 4.2, 3.6667, 5.0]
    """
    count = values.shape[-1]
    if window % 2 == 0 or not 1 <= window <= max(count, 1):
        raise ValueError(format_sentence("signal.bad_window", window=window, count=count))
    if window == 1:
        return values.copy()
    sums = _compute_window_sums(values, window, has_ends=has_ends)
    if np.isfinite(sums.sum()):
        reach, lengths = window // 2, np.arange(1.0, window - 1, 2)
        sums[..., :reach] /= lengths
        sums[..., reach : count - reach] /= window
        sums[..., count - reach :] /= lengths[::-1]
        return sums
    is_valid = ~np.isnan(values)
    sums = _compute_window_sums(np.where(is_valid, values, 0.0), window)
    counts = _compute_window_sums(is_valid.astype(np.float64), window)
    return divide(sums, counts)


def _compute_window_sums(values: Floats, window: int, *, has_ends: bool = True) -> Floats:
    """Compute sums over windows that become shorter towards both ends.

    If `has_ends` is False, the sums of the first and the last half window are 0.
    """
    block_size = 1 << 16  # number of samples whose cumulative sum stays in the cache
    reach, count = window // 2, values.shape[-1]
    sums = np.zeros_like(values)
    for first in range(reach, count - reach, block_size):
        stop = min(first + block_size, count - reach)
        cumulative = np.cumsum(values[..., first - reach : stop + reach], axis=-1)
        sums[..., first] = cumulative[..., window - 1]
        sums[..., first + 1 : stop] = cumulative[..., window:] - cumulative[..., :-window]
    if not has_ends:
        return sums
    sums[..., :reach] = np.cumsum(values[..., : 2 * reach], axis=-1)[..., ::2]
    cumulative = np.cumsum(values[..., count - 2 * reach :], axis=-1)
    sums[..., count - reach :] = cumulative[..., -1:] - cumulative[..., ::2]
    return sums


@dataclass(frozen=True, slots=True)
class Smoothing:
    """Moving average with straight lines at the ends.

    Parameters
    ----------
    window : odd number of samples, limited to the length of the signal; a window below 3 does not
        change the signal

    Notes
    -----
    This is the filter of degree one of Savitzky and Golay, Anal. Chem. 36 (1964) 1627. A sample is
    replaced by the mean over the window. The first and the last half window are replaced by the
    least-squares line through the outermost window. A spreadsheet computes the filter with AVERAGE
    and FORECAST. The line preserves the height of a corner at the end and averages the noise. The
    line is clipped to the range of the values in the outermost window, so that it does not
    overshoot a rounded peak. NaN are ignored. If the outermost window contains fewer than two
    samples, the means of `compute_moving_average` replace the line.
    """

    window: int

    def __call__(self, values: Floats) -> Floats:
        """Smooth along the last axis, without a time shift; return a new array of equal shape."""
        count = values.shape[-1]
        window = min(self.window, count - 1 + count % 2)
        if window < 3:
            return values.copy()
        # Lines replace the first and the last half window.
        smooth, reach = compute_moving_average(values, window=window, has_ends=False), window // 2
        indices = np.arange(float(window))
        ends = ((slice(window), slice(reach)), (slice(-window, None), slice(-reach, None)))
        for outer_window, end in ends:
            rows = values[..., outer_window].reshape(-1, window)
            is_valid = ~np.isnan(rows)
            if is_valid.all():
                line = _fit_line(rows, indices, indices[end])
                smooth[..., end] = line.reshape(smooth[..., end].shape)
                continue
            means = smooth[..., end].reshape(-1, reach)
            is_same = (is_valid == is_valid[:1]).all()
            patterns = is_valid[:1] if is_same else np.unique(is_valid, axis=0)
            for pattern in patterns[patterns.sum(axis=1) > 1]:
                matches = (is_valid == pattern).all(axis=1)
                line = _fit_line(rows[matches][:, pattern], indices[pattern], indices[end])
                means[matches] = np.where(np.isnan(means[matches]), np.nan, line)
            smooth[..., end] = means.reshape(smooth[..., end].shape)
        return smooth

    def scale_step(self, ratio: float) -> Smoothing:
        """Return the filter of about equal duration for a sampling step `ratio` times as large."""
        return Smoothing(2 * round(0.5 * (self.window / ratio - 1.0)) + 1)


def _fit_line(rows: Floats, indices: Floats, end_indices: Floats) -> Floats:
    """Fit a line to each row, and evaluate it at the end indices, shape (rows, end indices).

    The line is clipped to the range of the values of the row.
    """
    centre = indices.mean()
    offsets = indices - centre
    slopes, levels = rows @ offsets / (offsets @ offsets), rows.mean(axis=1)
    line = levels[:, np.newaxis] + slopes[:, np.newaxis] * (end_indices - centre)
    clipped: Floats = line.clip(rows.min(axis=1)[:, np.newaxis], rows.max(axis=1)[:, np.newaxis])
    return clipped


def filter_pieces(values: Floats, cuts: Sequence[int], filters: Sequence[Filter]) -> Floats:
    """Filter the pieces of a signal separately, so that corners between them are not smoothed.

    Parameters
    ----------
    values : shape (..., n), samples of a signal, in any unit
    cuts : indices of the samples at which a new piece begins
    filters : functions in the order of application, each with a stride: of the output of the
        function, every stride-th sample is kept

    Returns
    -------
    Shape (..., m), filtered samples, with m < n if a stride is above one.
    """
    count = values.shape[-1]
    bounds = sorted({0, count, *(cut for cut in cuts if 0 < cut < count)})
    for function, stride in filters:
        filtered = np.empty_like(values)
        for start, stop in pairwise(bounds):
            filtered[..., start:stop] = function(values[..., start:stop])
        values = filtered[..., ::stride]
        bounds = sorted({-(-bound // stride) for bound in bounds})
    return values


@dataclass(frozen=True, slots=True)
class Butterworth:
    """Zero-phase Butterworth low-pass filter, applied forwards and backwards.

    Parameters
    ----------
    cutoff : frequency at which both passes together halve the amplitude, 1/s
    rate : sampling rate, 1/s
    order : order of one pass

    Notes
    -----
    The signal is padded at both ends by odd reflection. Within about rate / cutoff samples of an
    end, the result depends on the padding.
    """

    cutoff: float
    rate: float
    order: int

    def __call__(self, values: Floats) -> Floats:
        """Filter along the last axis, without a time shift; return a new array of equal shape.

        Raises
        ------
        ValueError
            If the cut-off is not between zero and half the rate, or the signal contains NaN.
        """
        from scipy.signal import butter, sosfiltfilt  # slow import, needed by few tests

        if not 0 < self.cutoff < self.rate / 2:
            cutoff, highest = self.cutoff, self.rate / 2
            raise ValueError(format_sentence("signal.bad_cutoff", cutoff=cutoff, highest=highest))
        if np.isnan(values).any():
            raise ValueError(format_sentence("signal.has_gaps"))
        sections = butter(self.order, self.cutoff, fs=self.rate, output="sos")
        n_padding = min(int(3 * self.rate / self.cutoff), values.shape[-1] - 1)
        filtered: Floats = sosfiltfilt(sections, values, padlen=n_padding)
        return filtered

    def scale_step(self, ratio: float) -> Butterworth | Smoothing:
        """Return the same filter for a sampling step `ratio` times as large.

        If the cut-off is at least half the new sampling rate, a filter without effect is returned.
        """
        rate = self.rate / ratio
        if self.cutoff >= rate / 2:
            return Smoothing(1)
        return Butterworth(self.cutoff, rate, self.order)


def convert_seconds_to_window(span: float, time: Floats) -> int:
    """Convert a duration to a window, an odd number of samples, by the median step of a clock.

    Parameters
    ----------
    span : duration of the window, s
    time : shape (n,), s, times of the samples

    Returns
    -------
    The window, an odd number of samples from 1 to n.

    Examples
    --------
    >>> convert_seconds_to_window(0.1, np.arange(0.0, 1.0, 0.02))
    5
    """
    if len(time) < 2:
        return 1
    return compute_window(max(1.0, round(span / compute_median_step(time), 6)), len(time))
