from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.process.reading import name_channels
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
from labpipe.records.quality import Severity
from labpipe.records.result import Result, Specimen, Status, TestResult
from labpipe.results.moment_curvature import (
    SLACK,
    AtRest,
    _while_slack,
    at_rest,
    held,
    notes_of,
    stated,
)
from labpipe.results.reduced_test import ReducedTest
from labpipe.results.shapes import MomentCurvature, _not_weighed
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
) -> tuple[ReducedTest, dict[str, Result]]:
    text = (repository / "protocols" / "wire-cantilever.yaml").read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    plan, seen = parse_protocol(text, "p.yaml"), observe(scenario, 3)
    force = name_channels(seen.force, plan.sources["force"], Path("force.mat"))
    done = reduce_recordings({"force": force, "markers": seen.markers}, plan)
    return done.evidence, {result.name: result for result in done.results}


def notes(test: ReducedTest, code: str) -> list[str]:
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
    test, results = reduced(repository)
    (said,) = notes(test, "weight_not_stated")
    # 1 g/m on 85 mm is 35 uN m: 1 % of 3.5 mN m; this wire has 4.8 mN m at 1 1/m.
    assert "weight_not_stated" not in results["bending_stiffness_at_1"].codes
    assert isinstance(test.bending, Bending)
    law = test.bending.law
    assert law is not None
    for factor, codes in ((0.8, []), (0.5, ["weight_not_stated"])):
        soft = replace(law, moment=factor * law.moment)
        doubts = _not_weighed(test, soft, MomentCurvature(at=1.0))
        assert [reason.code for reason in doubts] == codes
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


WEIGHT, COUNT, REST, DEEP = 0.0265, 600, 100, 0.05


TIME = np.arange(COUNT) / 10.0


def curve() -> Curve:
    """Rest, then a straight line to 50 mm at 4 N/m."""
    deflection = np.maximum(np.arange(COUNT) - REST, 0) / (COUNT - REST) * DEEP
    branch = np.repeat([-1, 0], [REST, COUNT - REST])
    return Curve(
        time=TIME,
        displacement=deflection,
        force=4.0 * deflection,
        branch=branch,
        cycle=branch + 1,
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


def seen(*, ahead: float | None = None, sag: float | None = None) -> AtRest:
    one = curve()
    aligned = None
    if ahead is not None:
        aligned = Aligned(TIME, {"travel": Series(one.displacement + ahead, "m")})
    result = TestResult(
        test="T1",
        specimen=Specimen("A2", "A2-s1", "3"),
        protocol="wire-cantilever",
        protocol_yaml="",
        test_yaml="",
        labpipe_version="0",
        inputs=(),
        recordings={},
        aligned=aligned,
        curve=one,
        shape=None if sag is None else shape(sag),
        results=(),
        quality=(),
    )
    return at_rest(result.aligned, result.shape, one, one.branches[0], WEIGHT)


def test_a_taut_string_and_a_straight_wire() -> None:
    found = seen(ahead=0.02e-3, sag=0.1e-3)
    assert found.ahead == pytest.approx(0.02e-3)
    assert found.sag == pytest.approx(0.1e-3)
    assert found.reach == pytest.approx(WEIGHT / 4.0, rel=0.1)
    assert found.state == "taut"
    assert found.why_not_straight == ""
    assert list(notes_of("T1", found)) == []


def test_a_slack_string() -> None:
    found = seen(ahead=1.5e-3, sag=12e-3)
    assert found.why_not_straight == (
        "its string was slack at rest: the clamp travels 1.5 mm before the tip follows, and until "
        "then the wire hung under the counterweight of 26.5 mN, its tip 12 mm below; a first "
        "loading begins with a straight wire that the string holds"
    )
    assert "26.5 mN; a first loading" in seen(ahead=1.5e-3).why_not_straight


def test_a_string_that_just_spans_to_a_hanging_wire() -> None:
    """The clamp is not ahead of the tip, and the wire has been bent all the same."""
    found = seen(ahead=0.0, sag=6.5e-3)
    assert found.why_not_straight == (
        "its wire hung at rest: the tip stood 6.5 mm below the axis of the clamp, where the "
        "counterweight of 26.5 mN bends the wire by about 6.7 mm; a first loading begins with a "
        "straight wire that the string holds"
    )


def test_a_wire_that_is_not_quite_straight_is_told() -> None:
    found = seen(ahead=0.0, sag=2e-3)
    assert found.why_not_straight == ""
    (note,) = notes_of("T1", found)
    assert (note.code, note.where) == ("wire_not_straight", "T1")
    assert note.message == (
        "at rest the tip stood 2 mm below the axis of the clamp: the wire is taken as straight, "
        "and its string as carrying all of the counterweight"
    )


def test_a_test_that_knows_nothing_of_it() -> None:
    found = seen()
    assert not found.is_known
    assert found.why_not_straight == ""
    (note,) = notes_of("T1", found)
    assert note.code == "rest_unknown"
    assert note.message.endswith("held the wire straight at rest; it is taken to have done so")


def test_a_force_that_never_reaches_the_counterweight() -> None:
    one = curve()
    weak = at_rest(None, shape(30e-3), one, one.branches[0], weight=1.0)
    assert weak.reach == pytest.approx(DEEP, rel=0.01)
    assert weak.why_not_straight.startswith("its wire hung at rest: the tip stood 30 mm below")


def moved(*, tension: float, slack_for: float = 0.0) -> AtRest:
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
    branch = np.repeat([-1, 0, 1], [200, 2000, 2000])
    one = Curve(
        time=time,
        displacement=deflection + rng.normal(0.0, 2e-5, len(time)),
        force=force + rng.normal(0.0, 5e-4, len(time)),
        branch=branch,
        cycle=np.where(branch < 0, 0, 1),
        branches=branches,
    )
    noisy = travel + rng.normal(0.0, 1e-5, len(time))
    return at_rest(Aligned(time, {"travel": Series(noisy, "m")}), None, one, branches[0], WEIGHT)


@pytest.mark.parametrize("tension", [0.0, 0.012, WEIGHT])
def test_a_string_that_goes_slack_later_tells_what_it_carried(tension: float) -> None:
    found = moved(tension=tension, slack_for=3e-3)
    assert found.carries == pytest.approx(tension, abs=3e-4)
    assert found.lowest == pytest.approx(-tension, abs=3e-4)
    assert found.error < 2e-4
    assert found.was_pulled is (tension > 0.0)


@pytest.mark.parametrize(("slack_for", "is_told"), [(0.6e-3, True), (0.3e-3, False)])
def test_two_quarters_of_a_millimetre_of_slack_tell(slack_for: float, *, is_told: bool) -> None:
    found = moved(tension=WEIGHT, slack_for=slack_for)
    if is_told:
        assert found.slackened == pytest.approx(-WEIGHT, abs=3e-4)
    else:
        assert np.isnan(found.slackened)


def test_a_string_that_stays_taut_tells_by_its_lowest_force_alone() -> None:
    found = moved(tension=0.02)
    assert np.isnan(found.slackened)
    assert found.lowest == pytest.approx(-0.015, abs=2e-3)
    assert found.was_pulled


EVIDENCE = AtRest(ahead=0.0, sag=0.0, reach=5e-3, weight=WEIGHT, lowest=-1e-4, error=5e-5)


NAN = float("nan")


@pytest.mark.parametrize(
    ("ahead", "sag", "lowest", "slackened", "state"),
    [
        (0.0, 0.0, -0.008, NAN, "taut"),
        (0.0, 0.0, 0.0, NAN, "taut"),
        (0.0, 5.5e-3, 0.0, NAN, "slack"),  # it just spans
        (1.2e-3, 5.5e-3, 0.0, NAN, "slack"),
        (1.2e-3, 0.1e-3, 0.0, NAN, "off the wire"),
        (1.2e-3, 1.5e-3, 0.0, NAN, "unknown"),
        (1.2e-3, 0.0, -0.02, NAN, "taut"),  # the clamp had play
        (0.0, 2e-3, 0.0, NAN, "unknown"),  # a curled wire, or half of its weight held
        (0.0, 2e-3, -0.008, NAN, "taut"),  # a curled wire
        (0.0, 5e-3, -0.008, NAN, "unknown"),
        (0.0, -4e-3, 0.0, NAN, "unknown"),
        (0.0, 0.0, -0.026, -0.026, "taut"),
        (0.0, 2e-3, -0.026, -0.026, "taut"),
        (0.0, 2.5e-3, -0.013, -0.013, "part"),
        (0.0, 5e-3, 0.0, 0.0, "slack"),
        (0.0, 0.0, 0.0, 0.0, "off the wire"),
        (0.0, NAN, 0.0, NAN, "unknown"),
        (NAN, NAN, NAN, NAN, "unknown"),
    ],
)
def test_what_the_evidence_says(
    ahead: float, sag: float, lowest: float, slackened: float, state: str
) -> None:
    """The force of a slack string before its lowest force, that before the clamp, then the sag."""
    found = replace(EVIDENCE, ahead=ahead, sag=sag, lowest=lowest, slackened=slackened)
    assert found.state == state
    assert (found.why_not_straight == "") is (
        state in ("taut", "off the wire")
        or (state == "unknown" and ahead == 0.0 and sag < 4e-3)
        or bool(np.isnan(sag))
    )


def test_a_stiff_wire_hangs_too_little_to_be_told_by_its_sag() -> None:
    stiff = replace(EVIDENCE, reach=0.2e-3, sag=0.2e-3)
    assert np.isnan(stiff.share)
    assert stiff.state == "unknown"
    assert replace(stiff, lowest=-0.01).state == "taut"


TAUT_REST = AtRest(ahead=0.0, sag=1e-5, reach=5e-3, weight=0.0265, lowest=-0.0084, error=1e-4)


@pytest.mark.parametrize(("ahead", "tension"), [(SLACK, WEIGHT), (1.01 * SLACK, 0.0)])
def test_where_it_is_not_known_a_clamp_that_is_ahead_tells_what_is_likelier(
    ahead: float, tension: float
) -> None:
    found = held(replace(EVIDENCE, ahead=ahead, sag=2e-3))
    assert (found.state, found.tension, found.other) == ("unknown", tension, WEIGHT - tension)


def test_a_taut_string_carries_the_counterweight() -> None:
    found = held(TAUT_REST)
    assert (found.state, found.tension, found.weight, found.other) == ("taut", 0.0265, 0.0265, None)
    note = found.note
    assert (note.code, note.severity, note.where) == (
        "string_at_rest",
        Severity.INFO,
        "rig.string",
    )
    assert note.message == (
        "the string was taut at rest and carried the counterweight of 26.5 mN: its tip stood 0.01 "
        "mm below the axis of the clamp, where the counterweight bends it by 5 mm; the clamp is 0 "
        "mm ahead of it when the string pulls; the lowest force is -8.4 mN against that at rest"
    )


def test_a_slack_string_leaves_it_to_the_wire() -> None:
    found = held(replace(TAUT_REST, ahead=1.2e-3, sag=5.5e-3, lowest=0.0, slackened=-1e-5))
    assert (found.state, found.tension, found.weight, found.other) == ("slack", 0.0, 0.0265, None)
    assert found.why.startswith(
        "the string carried nothing at rest: the wire hung under the counterweight of 26.5 mN: "
    )
    assert found.why.endswith("later the string goes slack at -0.01 mN against the force at rest")


def test_a_counterweight_that_does_not_pull_at_the_wire() -> None:
    found = held(replace(TAUT_REST, ahead=1.2e-3, lowest=0.0))
    assert (found.state, found.tension, found.weight, found.other) == ("off the wire", 0, 0, None)
    assert "yet the wire did not hang: the counterweight is taken not to pull at it" in found.why


def test_a_part_of_it_is_taken_as_measured() -> None:
    found = held(replace(TAUT_REST, sag=2.5e-3, slackened=-0.013))
    assert (found.state, found.tension, found.weight) == ("part", 0.013, 0.0265)
    assert found.other == pytest.approx(0.013 - 1e-4 * 3**0.5)
    assert found.why.startswith("the string carried 13 mN of the counterweight of 26.5 mN at rest:")


@pytest.mark.parametrize(("ahead", "taken", "other"), [(0.0, 0.0265, 0.0), (1e-3, 0.0, 0.0265)])
def test_what_the_test_does_not_tell_is_in_the_intervals(
    ahead: float, taken: float, other: float
) -> None:
    found = held(replace(TAUT_REST, ahead=ahead, sag=1.6e-3, lowest=0.0))
    assert (found.state, found.tension, found.other) == ("unknown", taken, other)
    assert found.note.severity is Severity.WARNING
    assert found.why.startswith("it is not known whether the string carried the counterweight of ")
    assert found.why.endswith(
        ". If you know, write 'rig.string.at_rest: {value: taut, because: ...}' under 'overrides' "
        "in test.yaml, or slack"
    )


def test_it_can_be_stated() -> None:
    assert stated("taut", 0.0265).tension == 0.0265
    found = stated("slack", 0.0265)
    assert (found.tension, found.weight, found.other) == (0.0, 0.0265, None)
    assert found.why == (
        "the string was slack at rest and carried nothing: so rig.string.at_rest states it"
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
    number = np.repeat([0, 1], 1000)
    one = Curve(time, share * travel, force, number, np.ones(2000, int), branches)
    found = _while_slack(travel, one, branches[0])
    assert bool(len(found)) is is_slack
    assert found == pytest.approx(np.full(len(found), -0.01))


def test_the_load_at_the_tip_holds_some_of_the_wire() -> None:
    """A taut string carried what a prop carries; a slack one left the wire to hang."""
    own = replace(TAUT_REST, weight=0.0309, own=0.0044)
    found = held(own)
    assert (found.state, found.tension) == ("taut", 0.0309)
    assert found.weight == pytest.approx(0.0265)
    assert found.why.startswith(
        "the string was taut at rest and carried the load at its tip of 30.9 mN (counterweight "
        "26.5 mN, 3/8 of the wire's weight): its tip stood 0.01 mm below the axis of the clamp, "
        "where that load bends it by 5 mm"
    )
    slack = held(replace(own, ahead=1.2e-3, sag=5.5e-3, lowest=0.0, slackened=-1e-5))
    assert (slack.state, slack.tension) == ("slack", 0.0)
    assert slack.weight == pytest.approx(0.0265)


def test_a_taut_string_that_is_stated_carries_both() -> None:
    found = stated("taut", 0.0265, 0.0044)
    assert (found.tension, found.weight) == pytest.approx((0.0309, 0.0265))
    assert "carried the counterweight and 3/8 of the wire's weight" in found.why
