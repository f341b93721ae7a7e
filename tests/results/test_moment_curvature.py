"""Measured moment-curvature from recordings in memory, and what is said where there is none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.process.reading import name_channels
from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import parse_protocol
from labpipe.records.curve import Bending
from labpipe.records.result import Result, Status
from labpipe.results.evidence import Evidence
from labpipe.virtual_lab import observe
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario
from labpipe.virtual_lab.specimens import WireModel
from tests.builders.bent_tests import law_moment
from tests.builders.small_tests import small_scenario

AT_1 = "  - {result: moment-curvature, at: 1 1/m, name: bending_stiffness_at_1}"


SMALL = small_scenario()
WHOLE = replace(
    CantileverScenario(),
    clocks=replace(SMALL.clocks, rate=500.0),
    mechanics=replace(CantileverScenario().mechanics, cycles=2),
)
TAUT = replace(SMALL, mechanics=replace(SMALL.mechanics, slack=None, cycles=1))


def reduced(
    repository: Path, *changes: tuple[str, str], scenario: CantileverScenario = SMALL
) -> tuple[Evidence, dict[str, Result]]:
    text = (repository / "protocols" / "wire-cantilever.yaml").read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    plan, seen = parse_protocol(text, "p.yaml"), observe(scenario, 3)
    force = name_channels(seen.force, plan.sources["force"], Path("force.mat"))
    done = reduce_recordings({"force": force, "markers": seen.markers}, plan)
    return done.evidence, {each.name: each for each in done.results}


def notes(test: Evidence, code: str) -> list[str]:
    return [note.message for note in test.findings.notes if note.code == code]


def test_stiffnesses_of_the_law(repository: Path) -> None:
    tangent = AT_1.replace("name:", "kind: tangent, name:").replace("at_1}", "t}")
    test, results = reduced(repository, (AT_1, f"{AT_1}\n{tangent}"))
    law = SMALL.mechanics.wire.law()
    for curvature in (1.0, 3.0):
        found = results[f"bending_stiffness_at_{curvature:g}"]
        truth = float(law_moment(law, curvature)) / curvature  # type: ignore[arg-type]
        assert found.unit == "N*m^2"
        assert found.value == pytest.approx(truth, rel=0.05)
        assert found.interval is not None
        # One test alone may lie outside its 95 %; how often it does is the slow study's question.
        assert found.value == pytest.approx(truth, abs=3.0 * found.interval.standard_error)
    slope = results["bending_stiffness_t"]  # of half a minute of test, known to a tenth or so
    assert slope.interval is not None
    assert slope.value == pytest.approx(4.53e-3, abs=3.0 * slope.interval.standard_error)
    assert slope.interval.standard_error < 0.2 * 4.53e-3
    assert "tangent at 1 1/m of the monotone law" in results["bending_stiffness_t"].method
    (said,) = notes(test, "moment_curvature")
    assert said.startswith("3383 points, each a mean over 3 frames, at 17 places; law from")


def test_further_than_it_was_bent(repository: Path) -> None:
    _, results = reduced(repository, ("at: 3 1/m", "at: 40 1/m"))
    found = results["bending_stiffness_at_3"]
    assert found.status is Status.FAILED
    assert found.why.startswith("not_reached: the first loading bends the wire to 4.")
    assert found.why.endswith("1/m, 40 1/m is asked for")


def test_below_the_noise(repository: Path) -> None:
    _, results = reduced(repository, ("at: 1 1/m", "at: 0.01 1/m"))
    reason = results["bending_stiffness_at_1"].why
    assert reason.startswith("below_noise: curvatures up to 0.")
    assert reason.endswith("1/m are not distinct from their noise, 0.01 1/m is asked for")


def test_what_stopped_the_test_comes_first(repository: Path) -> None:
    _, results = reduced(repository, ("min_stroke: 5 mm", "min_stroke: 500 mm"))
    assert results["bending_stiffness_at_1"].why.startswith("no_motion: ")


def test_without_a_string_a_note_says_what_was_assumed(repository: Path) -> None:
    test, results = reduced(repository, ("  string: {length: 760 mm, counterweight: 2.7 g}\n", ""))
    assert notes(test, "force_taken_normal") == [
        "rig.string is not stated: the force is taken normal to the clamped axis, with nothing "
        "hanging at the tip"
    ]
    assert results["bending_stiffness_at_1"].value == pytest.approx(4.8e-3, rel=0.05)


def test_without_a_mass_a_note_says_that_weight_is_left_out(repository: Path) -> None:
    test, _ = reduced(repository)
    (said,) = notes(test, "weight_not_stated")
    assert said.startswith("specimen.mass_per_length is not stated: moments leave out the spec")


def near(found: Result, scenario: CantileverScenario, curvature: float, within: float) -> bool:
    """Whether an interval holds the truth, and is no wider than a share of it to each side."""
    law = scenario.mechanics.wire.law()
    true = float(law_moment(law, curvature)) / curvature  # type: ignore[arg-type]
    assert found.interval is not None
    half = 0.5 * (found.interval.upper - found.interval.lower)
    return abs((found.value or 0.0) - true) < 1.5 * half < 1.5 * within * true


SOFT = replace(
    TAUT,
    load_cell=replace(TAUT.load_cell, noise=1e-3),
    mechanics=replace(TAUT.mechanics, wire=WireModel().scaled(0.2), stroke=0.03),
)
STROKE = ("stroke: 53 mm", "stroke: 30 mm")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slack", "counterweight", "said"),
    [
        (None, 0.0027, "the string was taut at rest and carried the counterweight of 26.5 mN: "),
        (0.0012, 0.0, "the string carried nothing at rest, yet the wire did not hang: "),
    ],
)
def test_a_string_at_rest_is_told_by_the_test(
    repository: Path, slack: float | None, counterweight: float, said: str
) -> None:
    """A soft wire, which the other assumption would make a third stiffer."""
    mechanics = replace(SOFT.mechanics, slack=slack, counterweight=counterweight)
    scenario = replace(SOFT, mechanics=mechanics)
    test, results = reduced(repository, STROKE, scenario=scenario)
    (why,) = notes(test, "string_at_rest")
    assert why.startswith(said)
    for curvature, within in ((1.0, 0.06), (3.0, 0.02)):
        found = results[f"bending_stiffness_at_{curvature:g}"]
        assert near(found, scenario, curvature, within), found


def test_a_string_at_rest_can_be_stated(repository: Path) -> None:
    """What is stated is taken: here it is wrong."""
    wrong = ("counterweight: 2.7 g", "counterweight: 2.7 g, at_rest: slack")
    test, results = reduced(repository, STROKE, wrong, scenario=SOFT)
    (why,) = notes(test, "string_at_rest")
    assert why.endswith("so rig.string.at_rest states it")
    found = results["bending_stiffness_at_3"]
    assert not near(found, SOFT, 3.0, 1.0)


def test_a_wire_that_hung_was_bent_before(repository: Path) -> None:
    """Below the curvature at which it hung, its law is none of a first loading."""
    hung = replace(SOFT, mechanics=replace(SOFT.mechanics, slack=0.0012))
    test, results = reduced(repository, STROKE, scenario=hung)
    assert notes(test, "string_at_rest")[0].startswith("the string carried nothing at rest: the ")
    found = results["bending_stiffness_at_1"]
    assert found.status is Status.DOUBTFUL
    assert "bent_before: at rest the wire hung under a moment of 2.24 N mm, more than the 0.9" in (
        found.why
    )


def test_too_few_frames_have_a_cloud_but_no_law(repository: Path) -> None:
    slow = replace(SMALL, clocks=replace(SMALL.clocks, fps=6.0))
    test, results = reduced(
        repository,
        ("motion_window: 25 s", "motion_window: 3 s"),
        ("step: specimen-frame, over: 2 s", "step: specimen-frame, over: 2.4 s"),
        scenario=slow,
    )
    assert isinstance(test.bending, Bending)
    assert test.bending.law is None
    assert results["bending_stiffness_at_1"].why.startswith("no_law: frames of the first loading=")


def test_a_law_that_does_not_fit_is_doubted(repository: Path) -> None:
    test, results = reduced(repository, ("grip_offset: 6 mm", "grip_offset: 2 mm"), scenario=WHOLE)
    found = results["bending_stiffness_at_1"]
    assert found.status is Status.DOUBTFUL
    assert "law_misfit: markers lie " in found.why
    assert found.why.endswith(
        "the wire does not bend alike all along, or string and offsets are not as stated"
    )
    assert test.bending is not None
