"""What ``labpipe calibrate`` says of curves from elsewhere."""

from __future__ import annotations

from labpipe.cli.calibrate import comparison_lines
from tests.builders.external_curves import external_comparison, unmodelled, untested


def test_a_line_for_each_curve_and_what_it_is_compared_with() -> None:
    blank, heading, tests, model, alone, *notes = comparison_lines(
        [external_comparison(), untested()]
    )
    assert not blank
    words = [" ".join(line.split()) for line in (heading, tests, model)]
    assert words == [
        "external curve compared with points rms mN of peak in band",
        "finite elements tests of A2, 85 mm 5 1 1 % 100 %",
        "finite elements model of A2, 85 mm 5 3 3.1 % 100 %",
    ]
    assert alone.split()[:3] == ["paper", "model", "of"]
    assert notes == [
        "  info: finite elements: 1 of 6 points left out, outside of 0 to 50 mm, the range of the "
        "tests",
        "  info: paper: no test of B2 at 100 mm",
    ]


def test_what_was_not_compared_has_no_numbers() -> None:
    lines = comparison_lines([unmodelled()])
    assert lines[3].split()[-4:] == ["0", "-", "-", "-"]


def test_a_long_name_is_cut() -> None:
    lines = comparison_lines([external_comparison("n" * 40)])
    assert lines[2].startswith(f"  {'n' * 27}…  tests of A2, 85 mm")


def test_nothing_without_any() -> None:
    assert comparison_lines([]) == []
