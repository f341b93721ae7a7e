from __future__ import annotations

from dataclasses import replace

from labpipe.report.calibration_shown import HEADS, parameter_row, sentences
from tests.report.builders_calibrations import (
    one_sample,
    troubled,
    two_solutions,
    usual,
)


def test_rows_of_parameters() -> None:
    for parameter in usual().parameters:
        assert len(parameter_row(parameter)) == len(HEADS)
    name, value, interval, unit, verdict = parameter_row(usual().parameter("insulation_modulus"))
    assert (name, unit, verdict) == ("Modulus of the insulation", "MPa", "identified")
    assert 900.0 < float(value) < 1100.0
    assert " to " in interval


def test_open_intervals() -> None:
    friction = troubled().parameter("radial_friction")
    assert parameter_row(friction)[2].startswith("below 2")
    assert parameter_row(friction)[3] == "mN"
    above = replace(friction, is_open_below=False, is_open_above=True)
    assert parameter_row(above)[2].startswith("above ")
    both = replace(friction, is_open_above=True)
    assert parameter_row(both)[2] == "open on both sides"
    small = replace(friction, value=1.04e-5)
    assert parameter_row(small)[1] == "0.010"


def test_held_parameter_has_no_interval() -> None:
    row = parameter_row(troubled().parameter("insulation_modulus"))
    assert row == ("Modulus of the insulation", "1000", "\u2013", "MPa", "fixed")


def test_what_is_said_of_a_usual_calibration() -> None:
    said = "\n".join(sentences(usual()))
    calibration = usual()
    assert f"RMSE {1e3 * calibration.rmse:.3g} mN" in said
    assert "over 360 points of 4 curves of 4 samples." in said
    assert "the gain of the load cell is uncertain by 0.5 %" in said
    assert (
        "\n\u03bc_s, \u03bc_p and F_rad are not identified, they cannot be told apart: 1 of 3 "
        "combinations is known" in said
    )


def test_conflict_of_a_prior_is_said_once() -> None:
    said = "\n".join(sentences(troubled()))
    assert said.count("contradicts the tests") == 1
    assert "The modulus of the insulation was held at 1000 MPa." in said


def test_notes() -> None:
    said = sentences(one_sample())
    assert "How samples scatter is not known" in "\n".join(said)
    assert any(line.startswith("Note: One sample: how samples scatter") for line in said)


def test_two_solutions_are_said_with_both() -> None:
    found = two_solutions()
    row = parameter_row(found.parameter("copper_scale"))
    first, second = row[2].split(" or ")
    assert " to " in first
    assert " to " in second
    assert row[4] == "two solutions"
    (said,) = [each for each in sentences(found) if "solutions fit" in each]
    assert said.count("RMSE 2.11 mN") == 2
    assert "has two solutions: it lies between" in " ".join(sentences(found))
