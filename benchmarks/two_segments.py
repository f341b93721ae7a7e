"""The two-segment fit, intervals included, against pwlf and piecewise-regression in one run."""

from __future__ import annotations

import statistics
import time
import warnings
from collections.abc import Callable

import numpy as np
import piecewise_regression
import pwlf

from labpipe.fitting.segments import fit_two_segments

RUNS = 5


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def ratios(count: int = 1000) -> dict[str, float]:
    """How many times longer each of the others takes, median of runs in turn."""
    rng = np.random.default_rng(0)
    x = np.linspace(2.0, 20.0, count)
    y = 45.0 + np.where(x < 9.3, 5.0, 2.7) * (x - 9.3) + rng.normal(0, 0.8, count)
    others: dict[str, Callable[[], object]] = {
        "pwlf, fit": lambda: pwlf.PiecewiseLinFit(x, y).fit(2),
        "pwlf, fitfast": lambda: pwlf.PiecewiseLinFit(x, y).fitfast(2),
        "piecewise-regression": lambda: piecewise_regression.Fit(
            x, y, n_breakpoints=1, start_values=[9.0]
        ),
    }
    fit_two_segments(x, y)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return {
            name: statistics.median(
                seconds(other) / seconds(lambda: fit_two_segments(x, y)) for _ in range(RUNS)
            )
            for name, other in others.items()
        }


def main() -> None:
    for name, ratio in ratios().items():
        print(f"{name + ' / two-segment fit':<44}{ratio:>8.2f}   (at least 20)", flush=True)


if __name__ == "__main__":
    main()
