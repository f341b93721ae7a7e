"""Numbers with their intervals, names and units, in words and in cells."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.records.curve import Interval
from labpipe.records.group import MeanInterval
from labpipe.records.quality import QualityNote, Severity
from labpipe.report.page_numbers import mean_with_interval, with_interval
from labpipe.report.wording import (
    heading,
    in_words,
    is_main,
    printable,
    shortened,
    shown_in,
    unit_words,
    why_missing,
    with_names_in_words,
    write_number,
)
from labpipe.report.workbook_cells import (
    Shown,
    column_place,
    form_in_column,
    number_form,
    percent,
    shown,
    shown_with_ends,
)
from labpipe.results import KINDS
from tests.store.builders_result import build_result

RESULT = build_result(half_cycle=0.2, cycles=1, force_rate=50.0)


def test_reason_is_the_first_error() -> None:
    note = QualityNote("no_overlap", Severity.ERROR, "force", "The clocks do not overlap.")
    failed = replace(RESULT, quality=(*RESULT.quality, note))
    expected = "There is no curve to draw. The clocks do not overlap."
    assert why_missing(failed, "curve") == expected
    assert why_missing(RESULT, "curve") == "There is no curve to draw."


@pytest.mark.parametrize("most", [3, 4, 9, 10])
def test_shortened_names_have_their_ends(most: int) -> None:
    assert shortened("0123456789", 10) == "0123456789"
    short = shortened("0123456789abc", most)
    assert len(short) == most
    assert (short[0], short[-1]) == ("0", "c")


def test_only_what_cannot_be_shown_is_replaced() -> None:
    assert printable("a\u202eb\u2066") == "a\ufffdb\ufffd"  # else all behind it reads backwards
    assert printable("a\tb\n\x00\x9f\ud800\ufffe $x_1$ \U0001f600") == (
        "a\tb\n\ufffd\ufffd\ufffd\ufffd $x_1$ \U0001f600"
    )


@pytest.mark.parametrize(
    ("value", "half", "expected"),
    [
        (52.28, 6.01, "52.3 (46.3 to 58.3)"),
        (52.28, 65.6, "52 (-13 to 118)"),
        (430.1, 127.0, "430 (300 to 560)"),
        (0.0004, 1.0, "0.0 (-1.0 to 1.0)"),
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
    outputs = [output for kind in KINDS for output in kind.outputs if "{" not in output.name]

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


def test_an_estimate_that_stands_apart_is_written_with_the_interval() -> None:
    interval = Interval(51.68, 51.86)
    assert (
        write_number(51.881, interval, apart=51.77).text
        == "51.881 (estimate 51.770, 51.680 to 51.860)"
    )
    assert write_number(51.881, interval).text == "51.881 (51.680 to 51.860)"


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


def test_means_have_the_digits_of_their_interval() -> None:
    mean = MeanInterval(0.0123456, Interval(0.0121456, 0.0125456), 1e-4, 3)
    assert mean_with_interval(mean, 1e3) == "12.35 ± 0.20"


def test_two_digits_of_the_interval_are_seen_and_all_are_there() -> None:
    found = shown_with_ends(0.0522841, Interval(0.046271, 0.058296), 1e3)
    assert [finding and finding.form for finding in found] == ["0.0"] * 3
    values = [finding and finding.value for finding in found]
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


def test_display_units() -> None:
    display = {
        "displacement": "mm", "stiffness": "N/mm", "angle": "deg", "bending_stiffness": "N*mm^2",
    }  # fmt: skip
    for name, unit, factor, shown_unit in (
        ("", "m", 1e3, "mm"), ("", "N/m", 1e-3, "N/mm"), ("energy.1", "J", 1.0, "J"),
        ("clock_drift", "1", 1e6, "ppm"), ("twist", "rad", 57.2957795, "deg"),
        ("bending_stiffness", "N*m^2", 1e6, "N*mm^2"),
    ):  # fmt: skip
        shown = shown_in(name, unit, display)
        assert shown.factor == pytest.approx(factor)
        assert shown.unit == shown_unit
