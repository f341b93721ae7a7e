"""Straight lines against the certified values of the NIST Statistical Reference Datasets.

Norris (calibration of ozone monitors, lower level of difficulty) and NoInt1, NoInt2 (lines through
the origin, average level): certified parameters, their standard deviations and the residual
standard deviation, https://www.itl.nist.gov/div898/strd/lls/lls.shtml
"""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.least_squares import slope_of_line, zero_of_line
from labpipe.uncertainty.linear_fits import fit_linear

NORRIS = """
0.1 0.2 338.8 337.4 118.1 118.2 888.0 884.6 9.2 10.1 228.1 226.5 668.5 666.3 998.5 996.3
449.1 448.6 778.9 777.0 559.2 558.2 0.3 0.4 0.1 0.6 778.1 775.5 668.8 666.9 339.3 338.0
448.9 447.5 10.8 11.6 557.7 556.0 228.3 228.1 998.0 995.8 888.8 887.6 119.6 120.2 0.3 0.3
0.6 0.3 557.6 556.8 339.3 339.1 888.0 887.2 998.5 999.0 778.9 779.0 10.2 11.1 117.6 118.3
228.9 229.2 668.4 669.1 449.2 448.9 0.2 0.5
"""
"""Pairs y x."""


def test_norris() -> None:
    y, x = np.array(NORRIS.split(), dtype=np.float64).reshape(-1, 2).T
    assert slope_of_line(x, y) == pytest.approx(1.00211681802045, rel=1e-13)
    assert zero_of_line(x, y) == pytest.approx(0.262323073774029 / 1.00211681802045, rel=1e-10)
    slopes = slope_of_line(np.array([x, x[::-1]]), np.array([y, 3.0 * y[::-1]]))
    assert slopes == pytest.approx(np.array([1.0, 3.0]) * 1.00211681802045, rel=1e-13)
    fit = fit_linear(np.column_stack([np.ones_like(x), x]), y)
    assert fit.n == 36
    assert fit.coefficients == pytest.approx([-0.262323073774029, 1.00211681802045], rel=1e-11)
    assert fit.classical_errors == pytest.approx(
        [0.232818234301152, 0.429796848199937e-3], rel=1e-11
    )
    assert fit.residual_deviation == pytest.approx(0.884796396144373, rel=1e-11)


@pytest.mark.parametrize(
    ("x", "y", "slope", "error", "deviation"),
    [
        (range(60, 71), range(130, 141), 2.07438016528926, 0.165289256198347e-1, 3.56753034006338),
        ((4, 5, 6), (3, 4, 4), 0.727272727272727, 0.420827318078432e-1, 0.369274472937998),
    ],
    ids=["NoInt1", "NoInt2"],
)
def test_lines_through_the_origin(
    x: range, y: range, slope: float, error: float, deviation: float
) -> None:
    # NoInt2 has three samples; its rows twice give the same slope and a known other deviation.
    times = 1 if len(x) > 6 else 2
    design = np.tile(np.array(x, dtype=np.float64), times)[:, None]
    fit = fit_linear(design, np.tile(np.array(y, dtype=np.float64), times))
    share = np.sqrt(times * (len(x) - 1) / (times * len(x) - 1))
    assert fit.coefficients[0] == pytest.approx(slope, rel=1e-12)
    assert fit.residual_deviation == pytest.approx(share * deviation, rel=1e-12)
    assert fit.classical_errors[0] == pytest.approx(share / np.sqrt(times) * error, rel=1e-12)
