"""Student, Biometrika 6 (1908) 1: extra hours of sleep under two drugs, ten patients each.

Interval of Welch as R prints it for its data set ``sleep`` (``t.test``), and the equivalence test
within 0.5 h as the TOSTER package prints it in its introduction (``t_TOST``).
"""

from __future__ import annotations

import pytest

from labpipe.statistics.means import mean_interval
from labpipe.statistics.two_groups import contrast_of, difference_of_means, equivalence_p

FIRST = mean_interval([0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0])
SECOND = mean_interval([1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4])


def test_difference() -> None:
    found = difference_of_means(FIRST, SECOND)
    assert found.mean == pytest.approx(1.58)
    assert found.interval is not None
    assert found.interval.lower == pytest.approx(-0.2054832, abs=5e-8)
    assert found.interval.upper == pytest.approx(3.3654832, abs=5e-8)


def test_equivalence() -> None:
    contrast = contrast_of(FIRST, SECOND, 0.5 / FIRST.mean)
    assert contrast is not None
    assert equivalence_p(contrast) == pytest.approx(0.89, abs=0.005)
