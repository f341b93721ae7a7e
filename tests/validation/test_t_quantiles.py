"""Two-sided 95 % quantiles of Student's t as in any printed table."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.statistics.means import mean_interval, t_quantile

TABLE = {2: 12.706, 3: 4.303, 4: 3.182, 5: 2.776, 6: 2.571, 10: 2.262, 30: 2.045}
"""By number of samples."""


@pytest.mark.parametrize("n", TABLE)
def test_quantile(n: int) -> None:
    assert t_quantile(n - 1) == pytest.approx(TABLE[n], abs=5e-4)


@pytest.mark.parametrize("n", TABLE)
def test_interval_is_made_with_it(n: int) -> None:
    values = np.arange(n, dtype=np.float64)
    found = mean_interval(values)
    assert found.interval is not None
    half = 0.5 * (found.interval.upper - found.interval.lower)
    assert half == pytest.approx(TABLE[n] * np.std(values, ddof=1) / np.sqrt(n), rel=2e-4)
