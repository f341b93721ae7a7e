"""Numbers of the page: value and half interval, with the digits of the interval."""

from __future__ import annotations

from math import isfinite

from labpipe.records.curve import Interval
from labpipe.records.group import MeanInterval
from labpipe.report.wording import write_number


def with_interval(
    value: float, interval: Interval | None, factor: float = 1.0, *, apart: float | None = None
) -> str:
    """Write a number with its interval in one line.

    Parameters
    ----------
    value, interval : in SI
    factor : from SI to the unit that is shown
    apart : estimate that differs from the value, if any

    Returns
    -------
    ``value ± half`` for a symmetric interval, else ``value (lower to upper)``; without an interval
    the value alone.

    Examples
    --------
    >>> with_interval(0.052284, Interval(0.046271, 0.058296), 1e3)
    '52.3 ± 6.0'
    >>> with_interval(1.26, Interval(1.15, 1.44))
    '1.26 (1.15 to 1.44)'
    """
    max_uneven_share = 0.1  # difference of both sides of a symmetric interval, of half its width
    written = write_number(value, interval, factor, apart=apart)
    if interval is None or not written.lower:
        return written.value
    up, down = interval.upper - value, value - interval.lower
    half = max(up, down)
    if apart is not None or not isfinite(half) or abs(up - down) > max_uneven_share * half:
        return f"{written.value} ({written.interval})"
    number, times, power = written.value.partition(" \u00d7 ")
    size = float(f"1e{power[2:].translate(_PLAIN_DIGITS)}") if times else 1.0
    decimals = len(number.partition(".")[2])
    two_digits = float(f"{abs(factor) * half / size:.1e}")
    text = f"{number} \u00b1 {two_digits:.{decimals}f}"
    return f"({text}){times}{power}" if times else text


_PLAIN_DIGITS = str.maketrans("\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079",
                       "-0123456789")  # fmt: skip


def mean_with_interval(mean: MeanInterval, factor: float = 1.0) -> str:
    """Write a mean with its interval, as `with_interval`.

    Parameters
    ----------
    mean : in SI
    factor : from SI to the unit that is shown
    """
    return with_interval(mean.mean, mean.interval, factor, apart=mean.apart)
