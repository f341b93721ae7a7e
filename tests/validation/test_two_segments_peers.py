"""The two-segment fit against pwlf and piecewise-regression: one optimum, three programs."""

from __future__ import annotations

import warnings

import numpy as np
import piecewise_regression
import pwlf
import pytest

from labpipe.fits.two_segments import Hinges, Segments
from labpipe.records.arrays import Floats


def curve(seed: int) -> tuple[Floats, Floats]:
    """Synthetic twist tube in mm and N."""
    rng = np.random.default_rng(seed)
    x = np.linspace(2.0, 20.0, 180)
    return x, 45.0 + np.where(x < 9.3, 5.0, 2.7) * (x - 9.3) + rng.normal(0, 0.8, len(x))


def ours(seed: int) -> tuple[Segments, float]:
    """The lines, and the sum of squares that they leave."""
    x, y = curve(seed)
    hinges = Hinges.of(x, y)
    assert isinstance(hinges, Hinges)
    found = hinges.fitted(y)
    ahead = x - found.break_point
    left = y - found.level - np.where(ahead < 0.0, found.first, found.second) * ahead
    return found, float(left @ left)


@pytest.mark.parametrize("seed", range(4))
def test_pwlf(seed: int) -> None:
    (found, squares), model = ours(seed), pwlf.PiecewiseLinFit(*curve(seed), seed=seed)
    breaks = model.fit(2)
    assert squares <= model.ssr * (1.0 + 1e-9)
    assert squares == pytest.approx(model.ssr, rel=1e-5)
    assert float(found.break_point) == pytest.approx(breaks[1], abs=1e-2)
    assert [float(found.first), float(found.second)] == pytest.approx(model.slopes, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_piecewise_regression(seed: int) -> None:
    found, squares = ours(seed)
    np.random.seed(seed)  # noqa: NPY002 (that library draws from the global generator)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = piecewise_regression.Fit(*curve(seed), n_breakpoints=1, start_values=[9.0])
    estimates = fit.get_results()
    assert squares <= estimates["rss"] * (1.0 + 1e-9)
    assert squares == pytest.approx(estimates["rss"], rel=1e-3)
    theirs = estimates["estimates"]
    assert float(found.break_point) == pytest.approx(theirs["breakpoint1"]["estimate"], abs=5e-2)
    assert float(found.first) == pytest.approx(theirs["alpha1"]["estimate"], rel=5e-3)
    assert float(found.second) == pytest.approx(theirs["alpha2"]["estimate"], rel=5e-3)
