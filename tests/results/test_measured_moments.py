from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.process.reading import convert_channels
from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import parse_protocol
from labpipe.records.curve import (
    Aligned,
    Bending,
    Branch,
    Curve,
    Direction,
    PointFlag,
    Series,
    Shape,
)
from labpipe.records.result import Result, Status
from labpipe.results.bending import MomentCurvature
from labpipe.results.kinds import ReducedTest
from labpipe.results.moment_curvature import (
    MIN_SLACK_TRAVEL,
    RestEvidence,
    _collect_slack_forces,
    collect_rest_evidence,
    decide_string_state,
    list_rest_notes,
    make_stated_state,
)
from labpipe.virtual_lab import observe
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario
from labpipe.virtual_lab.specimens import WireModel
from tests.approved import Approve
from tests.builders.bent_tests import law_moment
from tests.builders.small_tests import small_scenario
from tests.builders.tensile_tests import recordings_of

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
) -> tuple[ReducedTest, dict[str, Result]]:
    text = (repository / "protocols" / "wire-cantilever.yaml").read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    plan, seen = parse_protocol(text, "p.yaml"), recordings_of(observe(scenario, 3))
    force = convert_channels(seen["force"], plan.sources["force"], Path("force.mat"))
    done = reduce_recordings({"force": force, "markers": seen["markers"]}, plan)
    return done.reduced_test, {result.name: result for result in done.results}


def notes(test: ReducedTest, code: str) -> list[str]:
    return [note.message for note in test.findings.notes if note.code == code]


def check_weight(test: ReducedTest, result: Result) -> None:
    """1 g/m on 85 mm is 35 uN m: 1 % of 3.5 mN m; this wire has 4.8 mN m at 1 1/m."""
    (note,) = notes(test, "weight_not_stated")
    assert note.startswith("specimen.mass_per_length is not stated: moments do not include the")
    assert "weight_not_stated" not in result.codes
    assert isinstance(test.bending, Bending)
    law = test.bending.law
    assert law is not None
    for factor, misfit, codes in (
        *((0.8, 1.5e-5, []), (0.8, 2.5e-5, ["law_misfit"])),  # 20 um on top of three times noise
        (0.5, 0.0, ["weight_not_stated"]),
    ):
        soft = replace(law, moment=factor * law.moment, residual=3.0 * law.noise + misfit)
        doubts = MomentCurvature(at=1.0).list_doubts(test, test.bending, soft)
        assert [reason.code for reason in doubts] == codes


def check_noise(test: ReducedTest) -> None:
    """Noise and zero of the force act on the length; the first of the means are of hardly bent."""
    assert isinstance(test.bending, Bending)
    assert test.curve is not None
    cloud, (start, stop) = test.bending.cloud, test.signals.zero_stretches["deflection"]
    is_at_rest = (test.curve.time >= start) & (test.curve.time <= stop)
    noise = float(test.curve.force[is_at_rest].std()) / cloud.frames_per_mean**0.5
    assert noise > test.force.zero_error > 0.0
    by_hand = np.hypot(noise, test.force.zero_error) * 0.085
    assert cloud.moment_error[0, 0] == pytest.approx(by_hand, rel=0.02)


def test_stiffnesses_of_the_law(repository: Path) -> None:
    tangent = AT_1.replace("name:", "kind: tangent, name:").replace("at_1}", "t}")
    test, results = reduced(repository, (AT_1, f"{AT_1}\n{tangent}"))
    law = SMALL.mechanics.wire.build_law()
    for curvature in (1.0, 3.0):
        result = results[f"bending_stiffness_at_{curvature:g}"]
        truth = float(law_moment(law, curvature)) / curvature  # type: ignore[arg-type]
        assert result.unit == "N*m^2"
        assert result.value == pytest.approx(truth, rel=0.05)
        assert result.interval is not None
        # One test alone may lie outside its 95 %; how often it does is the slow study's question.
        assert result.value == pytest.approx(truth, abs=3.0 * result.interval.standard_error)
    slope = results["bending_stiffness_t"]  # of half a minute of test, known to a tenth or so
    assert slope.interval is not None
    assert slope.value == pytest.approx(4.53e-3, abs=3.0 * slope.interval.standard_error)
    assert slope.interval.standard_error < 0.2 * 4.53e-3
    assert "tangent at 1 1/m of the monotone law" in results["bending_stiffness_t"].method
    (note,) = notes(test, "moment_curvature")
    assert note.startswith("3383 points, each a mean over 3 frames, at 17 places; law from")
    check_weight(test, results["bending_stiffness_at_1"])
    check_noise(test)


def test_curvatures_that_are_not_in_the_test(repository: Path) -> None:
    """Further than the wire was bent, and below the noise."""
    results = reduced(repository, ("at: 3 1/m", "at: 40 1/m"), ("at: 1 1/m", "at: 0.01 1/m"))[1]
    far, near = (
        results["bending_stiffness_at_3"].reason_text,
        results["bending_stiffness_at_1"].reason_text,
    )
    assert far.startswith("not_reached: the first loading bends the wire to 4.")
    assert "1/m, 40 1/m is needed; " in far
    assert near.startswith("below_noise: curvatures up to 0.")
    assert near.endswith("1/m are not distinct from their noise, 0.01 1/m is needed")


def test_without_a_string_a_note_says_what_was_assumed(repository: Path) -> None:
    test, results = reduced(repository, ("  string: {length: 760 mm, counterweight: 2.7 g}\n", ""))
    assert len(notes(test, "force_taken_normal")) == 1
    assert results["bending_stiffness_at_1"].value == pytest.approx(4.8e-3, rel=0.05)
    # A bare string on a specimen without weight pulls by what is measured, and says nothing.
    test, results = reduced(repository, ("counterweight: 2.7 g", "counterweight: 0 g"))
    assert not notes(test, "string_at_rest")
    assert results["bending_stiffness_at_1"].value == pytest.approx(4.8e-3, rel=0.05)


def near(found: Result, scenario: CantileverScenario, curvature: float, within: float) -> bool:
    """Whether an interval holds the truth, and is no wider than a share of it to each side."""
    law = scenario.mechanics.wire.build_law()
    true = float(law_moment(law, curvature)) / curvature  # type: ignore[arg-type]
    assert found.interval is not None
    half = 0.5 * (found.interval.upper - found.interval.lower)
    return abs((found.value or 0.0) - true) < 1.5 * half < 1.5 * within * true


_WEAK = WireModel(
    stick_stiffness=1e-3,
    stick_moment=4e-4,
    slip_stiffness=1e-3,
    reference_moment=0.01,
    last_moment=0.06,
)
"""The usual wire at a fifth of its moments."""
SOFT = replace(
    TAUT,
    load_cell=replace(TAUT.load_cell, noise=1e-3),
    mechanics=replace(TAUT.mechanics, wire=_WEAK, stroke=0.03),
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
        result = results[f"bending_stiffness_at_{curvature:g}"]
        assert near(result, scenario, curvature, within), result


def test_a_wire_that_hung_was_bent_before(repository: Path) -> None:
    """Below the curvature at which it hung, its law is none of a first loading."""
    hung = replace(SOFT, mechanics=replace(SOFT.mechanics, slack=0.0012))
    test, results = reduced(repository, STROKE, scenario=hung)
    assert notes(test, "string_at_rest")[0].startswith("the string carried nothing at rest: the ")
    result = results["bending_stiffness_at_1"]
    assert result.status is Status.DOUBTFUL
    assert "bent_before: at rest the wire hung under a moment of 2.24 N mm, more than the 0.9" in (
        result.reason_text
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
    assert results["bending_stiffness_at_1"].reason_text.startswith(
        "no_law: frames of the first loading="
    )


@pytest.mark.slow
def test_a_law_that_does_not_fit_is_doubted(repository: Path) -> None:
    _, results = reduced(repository, ("grip_offset: 6 mm", "grip_offset: 2 mm"), scenario=WHOLE)
    stiffness = results["bending_stiffness_at_1"]
    assert stiffness.status is Status.DOUBTFUL
    assert "law_misfit: markers lie " in stiffness.reason_text


WEIGHT, COUNT, REST, DEEP = 0.0265, 600, 100, 0.05


TIME = np.arange(COUNT) / 10.0


def curve() -> Curve:
    """Rest, then a straight line to 50 mm at 4 N/m."""
    deflection = np.maximum(np.arange(COUNT) - REST, 0) / (COUNT - REST) * DEEP
    return Curve(
        time=TIME,
        displacement=deflection,
        force=4.0 * deflection,
        branches=(Branch(REST, COUNT, 1, Direction.LOADING, TIME[REST], TIME[-1]),),
    )


def shape(sag: float) -> Shape:
    """Clamped end and pull point alone."""
    positions = np.zeros((COUNT, 2, 3))
    positions[:, 1, 0] = 0.085
    positions[:, 1, 1] = curve().displacement - sag
    return Shape(
        time=TIME,
        positions=positions,
        names=("grip", "pull"),
        flags=np.full((COUNT, 2), PointFlag.CONSTRUCTED, dtype=np.uint8),
        arc_length=np.array([0.0, 0.085]),
        coefficients=np.zeros((COUNT, 3, 0)),
        length=0.085,
        rotation_lab_to_specimen=np.eye(3),
    )


def seen(*, ahead: float | None = None, sag: float | None = None) -> RestEvidence:
    test_curve = curve()
    aligned = None
    if ahead is not None:
        aligned = Aligned(TIME, {"travel": Series(test_curve.displacement + ahead, "m")})
    return collect_rest_evidence(
        aligned, None if sag is None else shape(sag), test_curve, test_curve.branches[0], WEIGHT
    )


def test_what_is_said_of_a_wire_before_its_first_loading(approved: Approve) -> None:
    """Its string is taut, slack, or just spans; the wire is not quite straight; nobody knows."""
    test_curve, lines = curve(), list[str]()
    weak = collect_rest_evidence(None, shape(30e-3), test_curve, test_curve.branches[0], 1.0)
    assert weak.load_deflection == pytest.approx(DEEP, rel=0.01)
    for rest in (
        *(seen(ahead=0.02e-3, sag=0.1e-3), seen(ahead=1.5e-3, sag=12e-3), seen(ahead=1.5e-3)),
        *(seen(ahead=0.0, sag=6.5e-3), seen(ahead=0.0, sag=2e-3), seen(), weak),
    ):
        numbers = (1e3 * number for number in (rest.clamp_lead, rest.sag, rest.load_deflection))
        lines.append(" ".join(f"{number:.4g}" for number in numbers) + f" mm: {rest.state}")
        is_known = not np.isnan([rest.clamp_lead, rest.sag]).all()
        lines.append(f"  known: {is_known}; {rest.bend_at_rest or 'straight'}")
        lines += [
            f"  {note.code} of {note.where}: {note.message}" for note in list_rest_notes("T1", rest)
        ]
    approved(lines)


def moved(*, tension: float, slack_for: float = 0.0) -> RestEvidence:
    """A cycle whose string goes slack for some m at its end; the zero hides a tension at rest."""
    rng = np.random.default_rng(6)
    travel = np.concatenate(
        [np.zeros(200), np.linspace(0.0, 0.02, 2000), np.linspace(0.02, 0.0, 2000)]
    )
    deflection = np.maximum(travel - slack_for, 0.0)
    deflection[:2200] = travel[:2200]
    force = np.where(deflection > 0.0, 20.0 * deflection, 0.0) - tension * (deflection <= 0.0)
    if not slack_for:
        force = 20.0 * deflection - tension * (1.0 - travel / 0.02)
    force[:2200] = 20.0 * deflection[:2200]
    time = np.arange(len(travel)) / 50.0
    branches = (
        Branch(200, 2200, 1, Direction.LOADING, time[200], time[2200]),
        Branch(2200, 4200, 1, Direction.UNLOADING, time[2200], time[-1]),
    )
    test_curve = Curve(
        time=time,
        displacement=deflection + rng.normal(0.0, 2e-5, len(time)),
        force=force + rng.normal(0.0, 5e-4, len(time)),
        branches=branches,
    )
    noisy = travel + rng.normal(0.0, 1e-5, len(time))
    return collect_rest_evidence(
        Aligned(time, {"travel": Series(noisy, "m")}), None, test_curve, branches[0], WEIGHT
    )


@pytest.mark.parametrize("tension", [0.0, 0.012, WEIGHT])
def test_a_string_that_goes_slack_later_tells_what_it_carried(tension: float) -> None:
    evidence = moved(tension=tension, slack_for=3e-3)
    assert evidence.slack_force == pytest.approx(-tension, abs=3e-4)
    assert evidence.lowest_force == pytest.approx(-tension, abs=3e-4)
    assert evidence.force_error < 2e-4
    assert (evidence.state in ("part", "taut")) is (tension > 0.0)


def test_two_quarters_of_a_millimetre_of_slack_tell() -> None:
    assert moved(tension=WEIGHT, slack_for=0.6e-3).slack_force == pytest.approx(-WEIGHT, abs=3e-4)
    assert np.isnan(moved(tension=WEIGHT, slack_for=0.3e-3).slack_force)


def test_a_string_that_stays_taut_tells_by_its_lowest_force_alone() -> None:
    evidence = moved(tension=0.02)
    assert np.isnan(evidence.slack_force)
    assert evidence.lowest_force == pytest.approx(-0.015, abs=2e-3)
    assert evidence.state == "taut"


EVIDENCE = RestEvidence(0.0, 0.0, load_deflection=5e-3, tip_load=WEIGHT, force_error=5e-5)


NAN = float("nan")


AHEAD_SAG_LOWEST_AND_SLACKENED = {
    "taut": [
        *((0.0, 0.0, -8.0, NAN), (0.0, 0.0, 0.0, NAN), (0.0, 0.0, -26.0, -26.0)),
        *((1.2, 0.0, -20.0, NAN), (0.0, 2.0, -8.0, NAN), (0.0, 2.0, -26.0, -26.0)),
    ],
    "slack": [(0.0, 5.5, 0.0, NAN), (1.2, 5.5, 0.0, NAN), (0.0, 5.0, 0.0, 0.0)],
    "off the wire": [(1.2, 0.1, 0.0, NAN), (0.0, 0.0, 0.0, 0.0)],
    "part": [(0.0, 2.5, -13.0, -13.0), (0.0, 2.5, -8.0, -8.0)],
    "unknown": [
        *((1.2, 1.5, 0.0, NAN), (0.0, 2.0, 0.0, NAN), (0.0, 5.0, -8.0, NAN)),
        *((0.0, -4.0, 0.0, NAN), (0.0, NAN, 0.0, NAN), (NAN, NAN, NAN, NAN)),
    ],
}
"""In mm and mN: the clamp had play, a wire is curled, the string just spans, part is held."""


@pytest.mark.parametrize("state", AHEAD_SAG_LOWEST_AND_SLACKENED)
def test_what_the_evidence_says(state: str) -> None:
    """The force of a slack string before its lowest force, that before the clamp, then the sag."""
    for numbers in AHEAD_SAG_LOWEST_AND_SLACKENED[state]:
        ahead, sag, lowest, slackened = (1e-3 * number for number in numbers)
        rest = replace(
            EVIDENCE, clamp_lead=ahead, sag=sag, lowest_force=lowest, slack_force=slackened
        )
        assert rest.state == state
        straight = state in ("taut", "off the wire") or bool(np.isnan(sag))
        straight |= state == "unknown" and ahead == 0.0 and sag < 4e-3
        assert (rest.bend_at_rest == "") is straight
        stiff = replace(rest, load_deflection=0.2e-3)  # hangs too little to be told by its sag
        assert np.isnan(stiff.sag_fraction)


TAUT_REST = replace(EVIDENCE, sag=1e-5, lowest_force=-0.0084, force_error=1e-4)


@pytest.mark.parametrize(
    ("ahead", "tension"), [(MIN_SLACK_TRAVEL, WEIGHT), (1.01 * MIN_SLACK_TRAVEL, 0.0)]
)
def test_where_it_is_not_known_a_clamp_that_is_ahead_tells_what_is_likelier(
    ahead: float, tension: float
) -> None:
    state = decide_string_state(replace(EVIDENCE, clamp_lead=ahead, sag=2e-3))
    assert (state.state, state.tension, state.alternative_tension) == (
        "unknown",
        tension,
        WEIGHT - tension,
    )


def test_what_is_said_of_a_string_at_rest(approved: Approve) -> None:
    """Forces in mN: at the wire's tip, of the weight that hangs, and what else it may be."""
    slack = replace(TAUT_REST, clamp_lead=1.2e-3, sag=5.5e-3, lowest_force=0.0, slack_force=-1e-5)
    unknown = replace(TAUT_REST, clamp_lead=0.0, sag=1.6e-3, lowest_force=0.0)
    strings = (
        *(
            decide_string_state(TAUT_REST),
            decide_string_state(slack),
            decide_string_state(replace(TAUT_REST, clamp_lead=1.2e-3, lowest_force=0.0)),
        ),
        *(
            decide_string_state(replace(TAUT_REST, sag=2.5e-3, slack_force=-0.013)),
            decide_string_state(unknown),
        ),
        decide_string_state(replace(unknown, clamp_lead=1e-3)),
        *(
            decide_string_state(replace(rest, tip_load=0.0309, wire_load=0.0044))
            for rest in (TAUT_REST, slack)
        ),
        *(
            make_stated_state("taut", 0.0265),
            make_stated_state("slack", 0.0265),
            make_stated_state("taut", 0.0265, 0.0044),
        ),
    )
    for string in strings:
        assert (string.note.code, string.note.where) == ("string_at_rest", "rig.string")
    approved(
        f"{string.state} {1e3 * string.tension:.4g} {1e3 * string.weight:.4g} "
        f"{string.alternative_tension and round(1e3 * string.alternative_tension, 3)} "
        f"{string.note.severity}: {string.evidence}"
        for string in strings
    )


@pytest.mark.parametrize(("share", "is_slack"), [(0.0, True), (0.2, True), (0.4, False)])
def test_a_tip_that_follows_by_a_third_of_the_way_is_pulled(
    share: float, *, is_slack: bool
) -> None:
    travel = np.concatenate([np.linspace(0.0, 0.01, 1000), np.linspace(0.01, 0.0, 1000)])
    time, force = np.arange(2000) / 50.0, np.full(2000, -0.01)
    branches = (
        Branch(0, 1000, 1, Direction.LOADING, time[0], time[999]),
        Branch(1000, 2000, 1, Direction.UNLOADING, time[1000], time[-1]),
    )
    test_curve = Curve(time, share * travel, force, branches)
    forces = _collect_slack_forces(travel, test_curve, branches[0])
    assert bool(len(forces)) is is_slack
    assert forces == pytest.approx(np.full(len(forces), -0.01))


def test_a_string_may_pull_at_the_outer_end_of_slack() -> None:
    """10.1 mm back and forth are 40 quarters of a millimetre each; it pulls in one of each way."""
    ends = (0, 2000, 4000, 6000)
    travel = np.interp(np.arange(6000), ends, [0.0, 0.0101, 0.0, 0.0101])
    time, force = np.arange(6000) / 50.0, np.where(travel > 0.00985, 1.0, -0.01)
    directions = (Direction.LOADING, Direction.UNLOADING, Direction.LOADING)
    branches = tuple(
        Branch(start, start + 2000, 1, direction, time[start], time[start + 1999])
        for start, direction in zip(ends, directions, strict=False)
    )
    forces = _collect_slack_forces(travel, Curve(time, 0.0 * travel, force, branches), branches[0])
    assert forces == pytest.approx(np.full(2 * 38, -0.01))
