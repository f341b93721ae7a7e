"""The two-segment fit against pwlf and piecewise-regression in one run, like against like.

`piecewise-regression` gives intervals, and so does `pwlf.fit` with the standard errors of its
linearised model: compared with them are the fit and that of 400 replicates of the curve, from whose
spread our intervals come. `pwlf.fit` without intervals, and `fitfast`, which starts from random
breaks and may end in a local optimum, are compared with the fit alone.
"""

from __future__ import annotations

import statistics
import time
import warnings
from collections.abc import Callable

import numpy as np
import piecewise_regression
import pwlf

from labpipe.results.kinks_and_plateaus import Hinges, Segments

COUNT = 2000
RUNS = 5
Work = Callable[[], object]


def seconds(work: Work) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def ratio(theirs: Work, ours: Work) -> float:
    """How many times longer theirs takes, median of runs in turn.

    Ours is over in milliseconds: the median of 20 calls stands for one.
    """
    ours()
    pairs = [
        (seconds(theirs), statistics.median(seconds(ours) for _ in range(20))) for _ in range(RUNS)
    ]
    return statistics.median(one / other for one, other in pairs)


def comparisons() -> list[tuple[str, Work, Work]]:
    rng = np.random.default_rng(0)
    x = np.linspace(2.0, 20.0, COUNT)
    y = 45.0 + np.where(x < 9.3, 5.0, 2.7) * (x - 9.3) + rng.normal(0, 0.8, COUNT)

    def pwlf_with_errors() -> object:
        model = pwlf.PiecewiseLinFit(x, y)
        model.fit(2)
        return model.standard_errors(method="non-linear", step_size=1e-4)

    def ours() -> tuple[Hinges, Segments]:
        hinges = Hinges.of(x, y)
        return hinges, hinges.fit(y)

    def with_intervals() -> Segments:
        hinges, _ = ours()
        return hinges.fit(y + rng.normal(0, 0.8, (400, COUNT)))

    def fit() -> object:
        return pwlf.PiecewiseLinFit(x, y).fit(2)

    def fit_fast() -> object:
        return pwlf.PiecewiseLinFit(x, y).fitfast(2)

    def muggeo() -> object:
        return piecewise_regression.Fit(x, y, n_breakpoints=1, start_values=[9.0])

    return [
        ("piecewise-regression / with intervals", muggeo, with_intervals),
        ("pwlf.fit + standard_errors / with intervals", pwlf_with_errors, with_intervals),
        ("pwlf.fit, no intervals / the fit", fit, ours),
        ("pwlf.fitfast / the fit", fit_fast, ours),
    ]


def main() -> None:
    print(f"two segments through {COUNT} samples", flush=True)
    for name, theirs, ours in comparisons():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            speed_ratio = ratio(theirs, ours)
        floor = "" if "standard_errors" in name else "   (at least 20)"
        print(f"  {name:<46}{speed_ratio:>7.1f}{floor}", flush=True)


if __name__ == "__main__":
    main()
