"""Numbers with their intervals, names and units, in words and in cells."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.records.curve import Interval
from labpipe.records.group import MeanInterval
from labpipe.report.table_records import (
    NumberCell,
    choose_number_format,
    compute_column_place,
    format_in_column,
    make_interval_cells,
    make_number_cell,
    make_percent_cell,
)
from labpipe.report.wording import (
    Scale,
    choose_unit,
    format_heading,
    format_label,
    format_mean,
    format_number,
    format_percent,
    format_with_interval,
    is_main,
    replace_names,
    replace_unprintable,
    typeset_unit,
)
from labpipe.results import KINDS


def test_only_what_cannot_be_shown_is_replaced() -> None:
    # else all behind it reads backwards
    assert replace_unprintable("a\u202eb\u2066") == "a\ufffdb\ufffd"
    assert replace_unprintable("a\tb\n\x00\x9f\ud800\ufffe $x_1$ \U0001f600") == (
        "a\tb\n\ufffd\ufffd\ufffd\ufffd $x_1$ \U0001f600"
    )


@pytest.mark.parametrize(
    ("value", "half", "expected"),
    [
        (52.28, 6.01, "52.3 (46.3 to 58.3)"),
        (-0.00001, 1.0, "0.0 (-1.0 to 1.0)"),
        (12345.0, 567.0, "12340 (11780 to 12910)"),
        (9.96, 0.996, "10.0 (9.0 to 11.0)"),
        (5.0, 0.0, "5.000 (5.000 to 5.000)"),
        (2.1e9, 3.0e7, "2.100 \u00d7 10⁹ (2.070 \u00d7 10⁹ to 2.130 \u00d7 10⁹)"),
        (1.23456, None, "1.235"),
        (0.0, None, "0.0000"),
        (math.nan, None, "\u2013"),
    ],
)
def test_digits_of_an_interval(value: float, half: float | None, expected: str) -> None:
    interval = None if half is None else Interval(value - half, value + half)
    assert format_number(value, interval).text == expected


def test_digits_asked_for_and_an_estimate_that_stands_apart() -> None:
    assert format_number(1.23456, None, digits=3).text == "1.23"
    number = format_number(51.881, Interval(51.68, 51.86), estimate=51.77)
    assert number.text == "51.881 (estimate 51.770, 51.680 to 51.860)"
    assert [*map(format_percent, (0.0012, 0.996, 12.34))] == ["0.12 %", "100 %", "1200 %"]


@given(st.floats(-1e8, 1e8), st.floats(1e-6, 1e8))
def test_rounding_moves_no_number_by_more_than_a_tenth_of_the_half_width(
    value: float, half: float
) -> None:
    written = format_number(value, Interval(value - half, value + half))
    digits, _, power = written.value.partition(" \u00d7 10")
    power = power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
    rounded = float(digits) * 10.0 ** int(power or 0)
    # half a width of 0.995 is 1.0 to two digits: 0.05 / 0.995
    assert abs(rounded - value) <= 0.0502513 * half + 1e-9 * abs(value)


def test_words() -> None:
    assert format_label("peak_force.1") == "Peak force, cycle 1"
    assert format_heading("slip_position", Scale(1e3, "mm")).endswith(" (mm)")
    assert format_heading("ratio", Scale(1.0, "")) == "Ratio"
    assert typeset_unit("N*mm^2") == "N\u00b7mm\u00b2"
    assert format_label("proof_stress_0_2") == "Proof stress, 0.2 %"
    names = ("stiffness", "slip_drop.1", "clock_drift")
    assert [is_main(name) for name in names] == [True, False, False]


def test_results_are_worded_as_their_kinds_say() -> None:
    outputs = [output for kind in KINDS for output in kind.outputs if "{" not in output.name]
    assert len(outputs) > 25
    for output in outputs:
        assert output.label, output.name
        assert format_label(output.name) == output.label


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        ("stiffness_third / peak force", "Stiffness third / peak force"),
        ("from peak_force.2.", "from peak force, cycle 2."),
        ("results.stiffness_first.from", "results.stiffness_first.from"),
        ("its force_below, and slack", "its force_below, and slack"),
    ],
)
def test_names_are_worded_and_files_and_keys_are_not(sentence: str, expected: str) -> None:
    assert replace_names(sentence) == expected


@pytest.mark.parametrize(
    ("value", "ends", "expected"),
    [
        (0.91, (0.83, 0.99), "0.910 ± 0.080"),
        (1.26, (1.15, 1.44), "1.26 (1.15 to 1.44)"),
        (10.0, (9.0, 11.2), "10.0 (9.0 to 11.2)"),
        (10.0, (9.0, 11.05), "10.0 ± 1.1"),  # one in the last digit is no asymmetry
        (2e-6, (1e-6, 3e-6), "(2.0 ± 1.0) \u00d7 10⁻⁶"),
    ],
)
def test_half_of_the_interval_where_it_is_as_wide_to_both_sides(
    value: float, ends: tuple[float, float], expected: str
) -> None:
    interval = Interval(*ends)
    assert format_with_interval(value, interval) == expected
    assert format_mean(MeanInterval(value, interval, 1e-4, 3), 1.0) == expected


def test_two_digits_of_the_interval_are_seen_and_all_are_there() -> None:
    cells = list(make_interval_cells(0.0522841, Interval(0.046271, 0.058296), 1e3).values())
    assert [cell.number_format for cell in cells if isinstance(cell, NumberCell)] == ["0.0"] * 3
    values = [cell.value for cell in cells if isinstance(cell, NumberCell)]
    assert values == pytest.approx([52.2841, 46.271, 58.296])
    turned = list(make_interval_cells(1.0, Interval(0.9, 1.2), -1.0).values())
    assert [cell.value for cell in turned if isinstance(cell, NumberCell)] == [-1.0, -1.2, -0.9]
    assert make_number_cell(74683.0, Interval(70000.0, 79000.0)) == NumberCell(74683.0, "0")
    assert list(make_interval_cells(1.0, None).values())[1:] == [None, None]
    assert [make_number_cell(value, None) for value in (None, math.nan)] == [None, None]
    assert [make_percent_cell(value) for value in (None, math.nan)] == [None, None]
    assert make_percent_cell(0.382) == NumberCell(0.382, "0.0%")


def test_a_column_has_one_last_place_but_for_small_numbers() -> None:
    place = compute_column_place([0.0, 12.345678, 53.2, None, "x"])
    assert place == -3
    cells: tuple[float, ...] = (53.2, 0.00123456, 3)
    formats = [format_in_column(cell, place).number_format for cell in cells]
    assert formats == ["0.000", "0.00000", "0"]
    assert compute_column_place(["a", 3, None]) is None
    forms = [
        choose_number_format(*number)
        for number in ((2.345e8, 6), (3.1e-8, -9), (7e-4, -4), (0.0, -3))
    ]
    assert forms == ["0.00E+00", "0.0E+00", "0.0000", "0.000"]


def test_display_units() -> None:
    display = {
        "displacement": "mm", "stiffness": "N/mm", "angle": "deg", "bending_stiffness": "N*mm^2",
    }  # fmt: skip
    for name, unit, factor, unit_shown in (
        ("", "m", 1e3, "mm"), ("", "N/m", 1e-3, "N/mm"), ("energy.1", "J", 1.0, "J"),
        ("clock_drift", "1", 1e6, "ppm"), ("twist", "rad", 57.2957795, "deg"),
        ("bending_stiffness", "N*m^2", 1e6, "N*mm^2"),
    ):  # fmt: skip
        scale = choose_unit(name, unit, display)
        assert scale.factor == pytest.approx(factor)
        assert scale.unit == unit_shown
