"""``labpipe calibrate`` on tests that it cannot take, or not all of: messages, no traceback."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.cli import main
from labpipe.records.result import TestResult
from labpipe.store.read import read_result
from labpipe.store.write import write_result
from labpipe.virtual_lab.tensile_scenarios import corrugated_tube
from tests.builders.small_tests import Ran, Run, state
from tests.builders.tensile_tests import make_tensile
from tests.builders.wire_lab import processed_rest, processed_wires

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Processed tests of A2 and B1; not to be changed."""
    return processed_wires(tmp_path_factory.mktemp("wires"))


@pytest.fixture
def calibrate(repository: Path, tmp_path: Path, run: Run) -> Callable[..., Ran]:
    """Calibrate tests, by a plan where one is given."""

    def calibrated(*tests: Path, plan: str = "") -> Ran:
        sheet = ("--wire", repository / "examples" / "wires.xlsx", "--no-figures")
        asked: tuple[str | Path, ...] = ("--out", tmp_path / "out")
        if plan:
            (tmp_path / "plan.yaml").write_text(f"version: 1\n{plan}", encoding="utf-8")
            asked = (*asked, "--plan", tmp_path / "plan.yaml")
        done = run("calibrate", *tests, *sheet, *asked)
        assert "Traceback" not in done.err
        return done

    return calibrated


def changed(test: Path, folder: Path, change: Callable[[TestResult], TestResult]) -> Path:
    """Another result file, of a processed test to which something was done."""
    file = folder / test.name / "result.h5"
    file.parent.mkdir(parents=True)
    write_result(change(read_result(test / "result.h5")), file)
    return file.parent


def blocked(result: TestResult) -> TestResult:
    return replace(result, curve=None, aligned=None, shape=None, bending=None)


def test_all_tests_were_blocked(
    campaign: Path, tmp_path: Path, calibrate: Callable[..., Ran]
) -> None:
    earlier = tmp_path / "out" / "calibration.json"
    earlier.parent.mkdir()
    earlier.write_text("{}", encoding="utf-8")
    before = state(earlier.parent)
    tests = [changed(campaign / f"A2-085-{number}", tmp_path, blocked) for number in (1, 2)]
    done = calibrate(*tests)
    assert done.status == 2
    for test in tests:
        assert f"{test / 'result.h5'}: it has no curve: look at its summary" in done.err
    assert state(earlier.parent) == before


def test_one_test_alone(campaign: Path, calibrate: Callable[..., Ran]) -> None:
    done = calibrate(campaign / "A2-085-1")
    assert done.status == 0
    assert "A2: " in done.out.splitlines()[0]
    assert " points of 1 sample, rms" in done.out.splitlines()[0]
    assert (
        "warning: A2: one sample: how samples scatter is not known, so the intervals speak of this "
        "sample, not of the wire" in done.out
    )


def test_a_test_that_is_no_cantilever(
    campaign: Path, tmp_path: Path, calibrate: Callable[..., Ran]
) -> None:
    lab = make_tensile(tmp_path / "pulled", corrugated_tube("CT-10-3"), 1)
    assert main(["process", str(lab.raw), "--no-figures"]) == 0
    (pulled,) = (lab.home / "processed").rglob("result.h5")
    told = (
        f"{pulled}: it is no cantilever test: its protocol, corrugated-tube, has neither a string "
        "(rig.string) nor a shape (step fit-shape)"
    )
    alone = calibrate(pulled)
    assert alone.status == 2
    assert alone.err.strip() == f"labpipe calibrate: {told}"
    beside = calibrate(pulled, campaign / "A2-085-1")
    assert beside.status == 2
    assert f"labpipe calibrate: left out: {told}" in beside.err
    assert beside.out.startswith("A2: ")


def test_a_free_length_that_nobody_gave(
    campaign: Path, tmp_path: Path, calibrate: Callable[..., Ran]
) -> None:
    def without(result: TestResult) -> TestResult:
        text = result.protocol_yaml
        bare = re.sub(r"specimen:\n(  .*\n)+", "specimen: {}\n", text)
        assert bare != text
        nothing = replace(result.specimen, dimensions={})
        return replace(result, specimen=nothing, protocol_yaml=bare)

    done = calibrate(changed(campaign / "A2-085-1", tmp_path, without))
    assert done.status == 2
    assert "the free length is not known: give it in the test sheet (specimen.length)" in done.err


@pytest.mark.parametrize(
    ("slack", "told"),
    [
        (1.5e-3, "its string was slack at rest: the clamp travels 1.5"),
        (0.0, "its wire hung at rest: the tip stood 13."),
    ],
)
def test_a_wire_that_hung_at_rest(
    slack: float, told: str, tmp_path: Path, campaign: Path, calibrate: Callable[..., Ran]
) -> None:
    """What such a test would make of the wire stands in docs/explanations/calibration.md."""
    hung = processed_rest(tmp_path / "hung", slack)
    alone = calibrate(hung)
    assert alone.status == 2
    assert told in alone.err
    assert "a first loading begins with a straight wire that the string holds" in alone.err
    beside = calibrate(campaign / "A2-085-1", campaign / "A2-085-2", hung)
    assert beside.status == 2
    assert "points of 2 samples" in beside.out
    assert f"left out: {hung / 'result.h5'}: {told}" in beside.err
    found = json.loads((tmp_path / "out" / "calibration.json").read_text("utf-8"))
    assert told in found["left_out"][str(hung / "result.h5")]


def test_a_parameter_that_nothing_is_left_for(
    campaign: Path, calibrate: Callable[..., Ran]
) -> None:
    """Copper a hundred times too strong leaves nothing for the insulation."""
    plan = "parameters:\n  copper_scale: {enters: fixed, value: 100, because: a slip of the pen}\n"
    done = calibrate(campaign / "A2-085-1", plan=plan)
    assert done.status == 0
    lines = done.out.splitlines()
    (row,) = [line for line in lines if line.startswith("? insulation_modulus")]
    assert row.endswith("not identified")
    (said,) = [line for line in lines if "the modulus of the insulation is not identified" in line]
    assert "the tests do not bound it from below" in said
    assert any("the residuals scatter 6" in line for line in lines)


def test_a_value_outside_the_bounds(campaign: Path, calibrate: Callable[..., Ran]) -> None:
    """The cause, and what to look at."""
    plan = "parameters:\n  copper_scale: {enters: prior, value: 100, factor: 2, because: a slip}\n"
    done = calibrate(campaign / "A2-085-1", plan=plan)
    assert done.status == 2
    assert (
        "the calibration of A2 failed (value_out_of_bounds): copper_scale starts at 100, outside "
        "its bounds, 0.05 and 20" in done.err
    )


@pytest.mark.parametrize(("value", "side"), [("3000 MPa", "below"), ("300 MPa", "above")])
def test_a_prior_that_contradicts_the_tests(
    value: str, side: str, campaign: Path, calibrate: Callable[..., Ran]
) -> None:
    plan = (
        "wire: A2\nparameters:\n"
        f"  insulation_modulus: {{enters: prior, value: {value}, factor: 1.2, because: a sheet}}\n"
    )
    done = calibrate(campaign, plan=plan)
    assert done.status == 0
    assert "known from its prior" not in done.out
    (row,) = [line for line in done.out.splitlines() if line.startswith("? insulation_modulus")]
    assert row.endswith("contradicts its prior")
    (said,) = [line for line in done.out.splitlines() if "contradicts the tests" in line]
    assert f"the prior of the modulus of the insulation, {value} within a factor of 1.2" in said
    assert "contradicts the tests, which by themselves say " in said
    assert f"standard errors of both together {side} the prior" in said


def test_friction_numbers_are_said_not_to_be_known_apart(
    campaign: Path, tmp_path: Path, calibrate: Callable[..., Ran]
) -> None:
    """On the terminal and in the file; the card says it in the same words."""
    told = (
        "mu_s, mu_p and F_rad are not identified, they cannot be told apart: 1 of 3 combinations "
        "is known (singular values of mu_s, mu_p and F_rad: "
    )
    done = calibrate(campaign, plan="wire: A2\n")
    assert told in done.out
    found = json.loads((tmp_path / "out" / "calibration.json").read_text("utf-8"))
    assert found["friction_separability"]["words"].startswith(told)
    assert set(found["friction_separability"]["identified"].values()) == {False}


def test_two_tests_of_one_name(
    campaign: Path, tmp_path: Path, calibrate: Callable[..., Ran]
) -> None:
    again = changed(campaign / "A2-085-1", tmp_path, lambda result: result)
    done = calibrate(campaign / "A2-085-1", campaign / "A2-085-2", again)
    assert (done.status, done.out) == (2, "")
    assert (
        f"{again / 'result.h5'}: expected one test for each name, found a second for 'A2-085-1'. "
        f"{campaign / 'A2-085-1' / 'result.h5'} is the first" in done.err
    )
    assert not (tmp_path / "out").exists()


def test_half_of_a_test_that_was_killed(
    campaign: Path, tmp_path: Path, calibrate: Callable[..., Ran]
) -> None:
    test = changed(campaign / "A2-085-1", tmp_path, lambda result: result)
    half = test / ".labpipe.new" / "result.h5"
    half.parent.mkdir()
    half.write_bytes((test / "result.h5").read_bytes()[:1000])
    done = calibrate(test)
    assert (done.status, done.err) == (0, "")
    assert " points of 1 sample, rms" in done.out
