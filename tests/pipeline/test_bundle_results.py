"""Results of bundles on cycles whose numbers are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.pipeline.bench import Bench
from labpipe.pipeline.bundle_results import kink_results, plateau_results
from labpipe.protocol.results import Plateau
from labpipe.records.arrays import Floats
from labpipe.records.result import Result, Status
from tests.builders.bundle_loops import (
    FIRST,
    FLAT,
    KINK,
    LATER,
    ONSET,
    SECOND,
    cycles,
    first_loading,
)
from tests.builders.doubts import doubted
from tests.builders.reduced import reduced

ASKED = """\
results:
  - {result: initial-stiffness, from: 0.2 mm, to: 1.8 mm}
  - {result: kink, from: 0.2 mm, to: 5 mm}
  - {result: plateau, slope_below: 20 %}
  - {result: loading-stiffness, over: 5 mm}
  - {result: hardening, over: 5 mm}
  - result: bending-stiffness
    of: initial_stiffness
    support: cantilever
    length_uncertainty: 1 mm
"""
LENGTH = "specimen: {length: 100 mm}\n"
NOISE = 0.01


def asked(
    loop: tuple[Floats, Floats, Floats], more: str = LENGTH + ASKED
) -> tuple[Bench, dict[str, Result]]:
    return reduced(*loop, more=more)


def width(found: Result) -> float:
    assert found.interval is not None
    return found.interval.upper - found.interval.lower


def holds(found: Result, true: float, unit: str) -> None:
    assert found.status is Status.OK
    assert found.unit == unit
    assert found.value is not None
    assert found.value == pytest.approx(true, abs=width(found))
    assert found.method


@pytest.fixture(scope="module")
def usual() -> tuple[Bench, dict[str, Result]]:
    return asked(cycles(noise=NOISE))


def test_kink(usual: tuple[Bench, dict[str, Result]]) -> None:
    bench, results = usual
    holds(results["kink_displacement"], KINK, "m")
    holds(results["kink_force"], FIRST * KINK, "N")
    assert width(results["kink_displacement"]) < 2e-4
    before, behind = bench.lines[:2]
    assert (before.result, behind.result) == ("before_kink", "behind_kink")
    assert before.slope == pytest.approx(FIRST, rel=0.02)
    assert behind.slope == pytest.approx(SECOND, rel=0.02)
    assert before.stop == behind.start == results["kink_displacement"].value
    assert before.level + before.slope * (before.stop - before.start) == pytest.approx(behind.level)


def test_scale_of_the_force_is_in_the_force_of_the_kink_alone(
    usual: tuple[Bench, dict[str, Result]],
) -> None:
    """1 % of 1.6 N, 95 %."""
    _, results = usual
    assert width(results["kink_force"]) > 2 * 1.96 * 0.01 * FIRST * KINK


def test_plateau(usual: tuple[Bench, dict[str, Result]]) -> None:
    bench, results = usual
    below = 0.2 * FIRST
    onset = ONSET - 0.001 + 0.002 * (SECOND - below) / (SECOND - FLAT)
    holds(results["end_slope"], FLAT / FIRST, "1")
    holds(results["plateau_displacement"], onset, "m")
    force = first_loading(np.array([onset]))[0]
    holds(results["plateau_force"], float(force), "N")
    assert "no_plateau" not in {note.code for note in bench.notes}
    assert [line.result for line in bench.lines] == ["before_kink", "behind_kink", "slope_at_end"]
    assert bench.lines[2].slope == pytest.approx(FLAT, abs=1.0)


def test_no_plateau_is_a_finding_and_no_failure() -> None:
    bench, results = asked(cycles(noise=NOISE, has_plateau=False))
    holds(results["end_slope"], SECOND / FIRST, "1")
    assert "plateau_displacement" not in results
    assert "plateau_force" not in results
    (said,) = [note for note in bench.notes if note.code == "no_plateau"]
    assert said.severity == "info"
    assert said.message.startswith("the slope over the last 5 mm is 37.")
    assert "% of initial_stiffness (3" in said.message
    assert "not surely below 20 %: no plateau up to 49.9" in said.message
    assert said.message.endswith(" mm")


def test_stiffness_of_each_cycle_and_hardening(usual: tuple[Bench, dict[str, Result]]) -> None:
    _, results = usual
    path = np.linspace(0.0, 0.005, 251)
    lever = path - path.mean()
    first = float(lever @ first_loading(path) / (lever @ path))
    for number, true in ((1, first), (2, LATER), (3, LATER)):
        holds(results[f"loading_stiffness.{number}"], true, "N/m")
    for number in (2, 3):
        holds(results[f"hardening.{number}"], LATER / first, "1")
    assert width(results["loading_stiffness.2"]) > 0.039 * LATER  # 1 % of the gain, 95 %
    assert "hardening.1" not in results


def test_a_gain_cancels_in_hardening(usual: tuple[Bench, dict[str, Result]]) -> None:
    time, path, force = cycles(noise=NOISE)
    _, stronger = asked((time, path, 1.05 * force))
    _, results = usual
    for name, factor in (("loading_stiffness.2", 1.05), ("hardening.2", 1.0)):
        value = results[name].value
        assert value is not None
        assert stronger[name].value == pytest.approx(factor * value, rel=1e-9)
        assert width(stronger[name]) == pytest.approx(factor * width(results[name]), rel=1e-6)


def test_one_cycle_has_no_hardening() -> None:
    _, results = asked(cycles(1, noise=NOISE))
    assert "loading_stiffness.1" in results
    assert not [name for name in results if name.startswith("hardening")]


def test_bending_stiffness(usual: tuple[Bench, dict[str, Result]]) -> None:
    """The length is uncertain by 1 %, which counts three times."""
    _, results = usual
    found = results["bending_stiffness"]
    holds(found, FIRST * 0.1**3 / 3.0, "N*m^2")
    assert found.value is not None
    assert width(found) > 2 * 1.96 * 0.03 * found.value
    assert found.method == "initial_stiffness x L^3 / 3, L = specimen.length"


def test_three_point_takes_the_span() -> None:
    text = ASKED.replace("support: cantilever", "support: three-point")
    _, results = asked(cycles(noise=NOISE), "specimen: {span: 100 mm}\n" + text)
    holds(results["bending_stiffness"], FIRST * 0.1**3 / 48.0, "N*m^2")
    assert results["bending_stiffness"].method.endswith("x L^3 / 48, L = specimen.span")


@pytest.mark.parametrize(
    ("support", "reason"),
    [
        (
            "cantilever",
            "no_length: nobody says specimen.length: write it into the test sheet, such as "
            "'length: 114.3 mm'",
        ),
        (
            "three-point",
            "no_span: nobody says specimen.span: write it into the test sheet, such as "
            "'span: 152.4 mm'",
        ),
    ],
)
def test_a_length_that_nobody_says(support: str, reason: str) -> None:
    text = ASKED.replace("support: cantilever", f"support: {support}")
    _, results = asked(cycles(noise=NOISE), text)
    assert results["bending_stiffness"].status is Status.FAILED
    assert results["bending_stiffness"].why == reason


def test_window_outside_the_loading() -> None:
    text = ASKED.replace("to: 5 mm", "to: 70 mm").replace(
        "from: 0.2 mm, to: 1.8", "from: 55 mm, to: 60"
    )
    _, results = asked(cycles(noise=NOISE), LENGTH + text)
    for name in ("kink_displacement", "kink_force"):
        assert results[name].why.startswith("not_reached: the branch reaches 49.9")
    assert results["initial_stiffness"].why.startswith("not_reached: ")
    assert results["end_slope"].why == "no_stiffness: initial_stiffness could not be had"
    assert results["bending_stiffness"].why.startswith("no_stiffness: ")


def test_nothing_moves() -> None:
    time, path, force = cycles(noise=NOISE)
    _, results = asked((time, 0.01 * path, force))
    assert {each.status for each in results.values()} == {Status.FAILED}
    assert "hardening.2" in results


def test_the_slope_at_the_end_of_a_record_that_breaks_off() -> None:
    time, path, force = cycles(noise=NOISE)
    part = time < 23.0
    _, results = asked((time[part], path[part], force[part]))
    assert results["end_slope"].why.startswith("partial_cycle: the record ends at 22.98")
    assert results["end_slope"].why.endswith(", while still loading")
    assert results["initial_stiffness"].status is Status.OK


def test_the_slope_at_the_end_without_its_force() -> None:
    time, path, force = cycles(noise=NOISE)
    _, results = asked((time, path, np.where((time > 40.0) & (time < 60.0), np.nan, force)))
    assert "gap: force and displacement are known up to " in results["end_slope"].why
    assert results["end_slope"].status is Status.DOUBTFUL


def test_a_reversed_bridge_is_doubted_in_every_result() -> None:
    time, path, force = cycles(noise=NOISE)
    bench, results = asked((time, path, -force))
    assert doubted(bench)["force"].startswith("force_reversed: the force goes to -1")
    assert results["initial_stiffness"].status is Status.DOUBTFUL
    assert results["kink_displacement"].status is Status.FAILED


def test_force_that_is_not_taken_off_between_cycles() -> None:
    time, path, force = cycles(noise=NOISE)
    _, results = asked((time, path, np.where(time > 60.0, force + 2.0, force)))
    assert results["loading_stiffness.2"].why.startswith("not_unloaded: the branch begins at 1.99")
    assert results["hardening.2"].why.startswith("not_unloaded: ")
    assert results["loading_stiffness.1"].status is Status.OK


def test_no_hardening_without_a_first_cycle() -> None:
    time, path, force = cycles(noise=NOISE)
    force = np.where(time < 50.0, np.random.default_rng(1).normal(0.0, NOISE, len(time)), force)
    _, results = asked((time, path, force))
    assert results["hardening.2"].why.startswith("no_stiffness: ")


def test_another_shape_widens_places() -> None:
    """The same deflection by a shape with a term more, 1 % longer."""
    bench, before = asked(cycles(noise=NOISE))
    signal = bench.signals["displacement"]
    bench.signals["displacement"] = replace(signal, alternative=1.01 * signal.values)
    after = {each.name: each for each in kink_results(bench, low=2e-4, high=5e-3)}
    entry = Plateau(slope_below=0.2)
    after |= {each.name: each for each in plateau_results(bench, entry)}
    for name in ("kink_displacement", "plateau_displacement"):
        assert after[name].value == before[name].value
        assert width(after[name]) > width(before[name])
