"""What is asked of a calibration: the grammar, and what is wrong with it in words."""

from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.load import load_calibration_plan


def plan_of(folder: Path, text: str) -> Path:
    path = folder / "calibration.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def told(folder: Path, text: str) -> str:
    path = plan_of(folder, text)
    with pytest.raises(ProtocolError) as caught:
        load_calibration_plan(path)
    return str(caught.value).replace(str(path), "plan")


def test_the_example_of_the_project(repository: Path) -> None:
    plan = load_calibration_plan(repository / "examples" / "calibration.yaml")
    assert (plan.wire, plan.points) == ("A2", 272)
    assert plan.parameters.radial_friction.enters == "free"


def test_what_is_not_said_is_free(tmp_path: Path) -> None:
    plan = load_calibration_plan(plan_of(tmp_path, "version: 1\n"))
    assert plan.wire is None
    assert plan.scatter is None
    assert {plan.parameters.copper_scale.enters, plan.parameters.insulation_modulus.enters} == {
        "free"
    }


def test_values_are_si(tmp_path: Path) -> None:
    text = (
        "version: 1\nscatter: 3 %\nup_to: 40 mm\nparameters:\n"
        "  radial_friction: {enters: fixed, value: 46.5 mN, because: handbook}\n"
        "  insulation_modulus: {enters: prior, value: 1 GPa, factor: 1.5, because: data sheet}\n"
    )
    plan = load_calibration_plan(plan_of(tmp_path, text))
    assert plan.scatter == pytest.approx(0.03)
    assert plan.up_to == pytest.approx(0.04)
    assert plan.parameters.radial_friction.value == pytest.approx(0.0465)
    assert plan.parameters.insulation_modulus.value == pytest.approx(1e9)
    assert plan.parameters.insulation_modulus.factor == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ("{enters: prior, factor: 1.5, because: x}", "expected a value of what is prior"),
        ("{enters: fixed, because: x}", "expected a value of what is fixed"),
        ("{enters: fixed, value: 1 GPa}", "expected a source of what is fixed"),
        ("{enters: prior, value: 1 GPa, because: x}", "expected the width of a prior"),
        ("{factor: 1.5}", "expected no factor, found one without a prior"),
        ("{enters: guessed}", "found 'guessed'"),
        ("{value: 1000}", "found '1000'"),
        ("{enters: prior, value: 1 GPa, factor: 0.5, because: x}", "found '0.5'"),
    ],
)
def test_a_parameter_that_cannot_be(tmp_path: Path, block: str, said: str) -> None:
    message = told(tmp_path, f"version: 1\nparameters:\n  insulation_modulus: {block}\n")
    assert message.startswith("plan, line 3")
    assert said in message


def test_unknown_keys_come_with_the_nearest(tmp_path: Path) -> None:
    message = told(tmp_path, "version: 1\nparameters:\n  copper_scal: {enters: free}\n")
    assert "copper_scale" in message


def test_a_newer_version_is_refused(tmp_path: Path) -> None:
    assert "version 1" in told(tmp_path, "version: 2\n")


def test_a_scatter_that_forgot_its_percent(tmp_path: Path) -> None:
    said = told(tmp_path, "version: 1\nscatter: 3\n")
    assert "(also in % or ppm) from 0 % up, at most 50 %, found '3'." in said
