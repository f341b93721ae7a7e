from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.records.curve import Interval
from labpipe.records.group import MeanInterval
from labpipe.report.wording import (
    heading,
    in_words,
    is_main,
    shown_in,
    unit_words,
    with_names_in_words,
    write_number,
)
from labpipe.results import KINDS


@pytest.mark.parametrize(
    ("value", "half", "expected"),
    [
        (52.28, 6.01, "52.3 (46.3 to 58.3)"),
        (52.28, 65.6, "52 (-13 to 118)"),
        (12345.0, 567.0, "12340 (11780 to 12910)"),
        (0.4, 0.0996, "0.40 (0.30 to 0.50)"),
        (9.96, 0.996, "10.0 (9.0 to 11.0)"),
        (
            3.0e-5,
            2.0e-6,
            "3.00 \u00d7 10\u207b\u2075 (2.80 \u00d7 10\u207b\u2075 to 3.20 \u00d7 10\u207b\u2075)",
        ),
        (2.1e9, 3.0e7, "2.100 \u00d7 10\u2079 (2.070 \u00d7 10\u2079 to 2.130 \u00d7 10\u2079)"),
    ],
)
def test_digits_are_those_that_the_interval_supports(
    value: float, half: float, expected: str
) -> None:
    assert write_number(value, Interval(value - half, value + half)).text == expected


def test_numbers_without_an_interval() -> None:
    assert write_number(1.23456, None).text == "1.235"
    assert write_number(1.23456, None, digits=3).text == "1.23"
    assert write_number(0.0, None).value == "0.0000"
    assert write_number(-0.00001, Interval(-1.0, 1.0)).value == "0.0"
    assert write_number(math.nan, None).text == "\u2013"
    assert write_number(5.0, Interval(5.0, 5.0)).text == "5.000 (5.000 to 5.000)"


@given(st.floats(-1e8, 1e8), st.floats(1e-6, 1e8))
def test_rounding_moves_no_number_by_more_than_a_tenth_of_the_half_width(
    value: float, half: float
) -> None:
    written = write_number(value, Interval(value - half, value + half))
    parts = written.value.partition(" \u00d7 10")
    power = parts[2].translate(
        str.maketrans(
            "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079", "-0123456789"
        )
    )
    shown = float(parts[0]) * 10.0 ** int(power or 0)
    assert abs(shown - value) <= 0.0500001 * half + 1e-9 * abs(value)


def test_display_units() -> None:
    display = {"displacement": "mm", "stiffness": "N/mm"}
    length, stiffness = (shown_in("", unit, display) for unit in ("m", "N/m"))
    assert (length.unit, stiffness.unit) == ("mm", "N/mm")
    assert (length.factor, stiffness.factor) == pytest.approx((1e3, 1e-3))
    assert shown_in("energy.1", "J", display) == (1.0, "J")
    assert shown_in("clock_drift", "1", display) == (1e6, "ppm")


def test_words() -> None:
    assert in_words("peak_force.1") == "Peak force, cycle 1"
    assert in_words("modulus_thin_wall") == "Modulus, thin wall"
    assert heading("stiffness_first", "N/mm") == "Stiffness, first region (N/mm)"
    assert heading("ratio", "1") == "Ratio"
    assert unit_words("N*mm^2") == "N\u00b7mm\u00b2"
    assert is_main("stiffness")
    assert not is_main("slip_drop.1")
    assert not is_main("clock_drift")


def test_results_are_worded_as_their_kinds_say() -> None:
    outputs = [each for kind in KINDS for each in kind.outputs if "{" not in each.name]

    assert len(outputs) > 25
    for each in outputs:
        assert each.label, each.name
        assert in_words(each.name) == each.label


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        ("stiffness_third / peak force", "Stiffness third / peak force"),
        ("from peak_force.2.", "from peak force, cycle 2."),
        ("results.stiffness_first.from", "results.stiffness_first.from"),
        ("raw/peak_force/energy_to_break.csv", "raw/peak_force/energy_to_break.csv"),
        ("its force_below, and slack", "its force_below, and slack"),
    ],
)
def test_names_are_worded_and_files_and_keys_are_not(sentence: str, expected: str) -> None:
    assert with_names_in_words(sentence) == expected


def mean(value: float, half: float | None) -> MeanInterval:
    interval = None if half is None else Interval(value - half, value + half)
    return MeanInterval(value, interval, 1.0, 2)


@pytest.mark.parametrize(
    ("value", "half", "expected"),
    [
        (11.468, 45.0, "11 (-34 to 56)"),
        (52.284, 6.01, "52.3 (46.3 to 58.3)"),
        (430.1, 127.0, "430 (300 to 560)"),
        (0.0004, 1.0, "0.0 (-1.0 to 1.0)"),
        (0.0, 1.0, "0.0 (-1.0 to 1.0)"),
        (1.23456, None, "1.235"),
        (math.nan, None, "\u2013"),
    ],
)
def test_a_mean_has_two_digits_of_half_its_interval(
    value: float, half: float | None, expected: str
) -> None:
    written = mean(value, half)
    assert write_number(written.mean, written.interval).text == expected


def test_angles_and_stiffnesses_take_their_display_units() -> None:
    display = {"angle": "deg", "bending_stiffness": "N*mm^2"}
    assert shown_in("twist", "rad", display).factor == pytest.approx(57.29578, rel=1e-6)
    assert shown_in("bending_stiffness", "N*m^2", display) == (1e6, "N*mm^2")


def test_an_estimate_that_stands_apart_is_written_with_the_interval() -> None:
    interval = Interval(51.68, 51.86)
    assert (
        write_number(51.881, interval, apart=51.77).text
        == "51.881 (estimate 51.770, 51.680 to 51.860)"
    )
    assert write_number(51.881, interval).text == "51.881 (51.680 to 51.860)"
