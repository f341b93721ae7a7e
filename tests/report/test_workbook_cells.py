from __future__ import annotations

import math

import pytest

from labpipe.records.curve import Interval
from labpipe.report.workbook_cells import (
    Shown,
    column_place,
    form_in_column,
    number_form,
    percent,
    shown,
    shown_with_ends,
)


def test_two_digits_of_the_interval_are_seen_and_all_are_there() -> None:
    found = shown_with_ends(0.0522841, Interval(0.046271, 0.058296), 1e3)
    assert [each and each.form for each in found] == ["0.0"] * 3
    values = [each and each.value for each in found]
    assert values == [pytest.approx(each) for each in (52.2841, 46.271, 58.296)]
    alone = shown(0.0522841, None, 1e3)
    assert alone is not None
    assert alone.form == "0.00"
    assert shown(74683.0, Interval(70000.0, 79000.0)) == Shown(74683.0, "0")


def test_what_is_not_there_is_not_shown() -> None:
    assert shown(None, None) is None
    assert shown(math.nan, None) is None
    assert shown_with_ends(1.0, None)[1:] == (None, None)
    assert (percent(None), percent(math.nan)) == (None, None)
    assert percent(0.382) == Shown(0.382, "0.0%")


def test_ends_are_in_order_whatever_the_sign_of_the_unit() -> None:
    _, lower, upper = shown_with_ends(1.0, Interval(0.9, 1.2), -1.0)
    assert lower is not None
    assert upper is not None
    assert (lower.value, upper.value) == (-1.2, -0.9)


def test_numbers_far_from_one_have_a_power_of_ten() -> None:
    assert number_form(2.345e8, 6) == "0.00E+00"
    assert number_form(3.1e-8, -9) == "0.0E+00"
    assert number_form(0.0007, -4) == "0.0000"
    assert number_form(0.0, -3) == "0.000"


def test_a_column_has_one_last_place_but_for_small_numbers() -> None:
    place = column_place([0.0, 12.345678, 53.2, None, "x"])
    assert place == -3
    assert form_in_column(53.2, place) == "0.000"
    assert form_in_column(0.00123456, place) == "0.00000"
    assert form_in_column(3, place) == "0"
    assert column_place(["a", 3, None]) is None
