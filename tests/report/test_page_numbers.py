from __future__ import annotations

import pytest

from labpipe.records.curve import Interval
from labpipe.records.group import MeanInterval
from labpipe.report.page_numbers import mean_with_interval, with_interval


@pytest.mark.parametrize(
    ("value", "ends", "said"),
    [
        (0.91, (0.83, 0.99), "0.910 ± 0.080"),
        (1234.0, (802.0, 1666.0), "1230 ± 430"),
        (1.26, (1.15, 1.44), "1.26 (1.15 to 1.44)"),
        (10.0, (9.0, 11.05), "10.0 ± 1.1"),  # one in the last digit is no asymmetry
        (-3.0, (-3.2, -2.8), "-3.00 ± 0.20"),
        (5e8, (4e8, 6e8), "(5.0 ± 1.0) \u00d7 10⁸"),
        (2e-6, (1e-6, 3e-6), "(2.0 ± 1.0) \u00d7 10⁻⁶"),
    ],
)
def test_half_of_the_interval_where_it_is_as_wide_to_both_sides(
    value: float, ends: tuple[float, float], said: str
) -> None:
    assert with_interval(value, Interval(*ends)) == said


def test_without_an_interval_the_value_stands_alone() -> None:
    assert with_interval(1.23456, None) == "1.235"
    assert with_interval(float("nan"), None) == "\u2013"


def test_an_estimate_that_stands_apart_is_said() -> None:
    words = with_interval(1.0, Interval(0.8, 0.9), apart=0.85)
    assert words == "1.000 (estimate 0.850, 0.800 to 0.900)"


def test_means_have_the_digits_of_their_interval() -> None:
    mean = MeanInterval(0.0123456, Interval(0.0121456, 0.0125456), 1e-4, 3)
    assert mean_with_interval(mean, 1e3) == "12.35 ± 0.20"
