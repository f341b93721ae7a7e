"""Plateau and bending stiffness of loadings whose numbers are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.errors import ProtocolError
from labpipe.process.story import ReductionOfTest
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats
from labpipe.records.causes import SHAPE, TANGENT
from labpipe.records.result import Result, Status
from labpipe.results.beam import Plateau, _Corner
from labpipe.results.curve_replicates import replicate_curves
from labpipe.results.kinds import to_result
from labpipe.results.reduced_test import ReducedTest
from labpipe.results.two_lines import Kink
from tests.builders.bundle_loops import (
    FIRST,
    FLAT,
    NOISE,
    ONSET,
    SECOND,
    cycles,
    first_loading,
    holds,
    width,
)
from tests.builders.pulls import pull, pulled
from tests.builders.reasons import doubted
from tests.builders.reduced import reduced, reduction
from tests.builders.three_point import CONDUIT, BendingRecord
from tests.builders.three_point import reduced as reduced_bending

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
PLATEAU = "plateau, slope_below: 10 %, of: stiffness, over: 2 mm"


def asked(
    loop: tuple[Floats, Floats, Floats], more: str = LENGTH + ASKED
) -> tuple[ReducedTest, dict[str, Result]]:
    return reduced(*loop, more=more)


@pytest.fixture(scope="module")
def done() -> ReductionOfTest:
    return reduction(*cycles(noise=NOISE), more=LENGTH + ASKED)


@pytest.fixture(scope="module")
def usual(done: ReductionOfTest) -> tuple[ReducedTest, dict[str, Result]]:
    return done.evidence, {result.name: result for result in done.results}


def test_plateau(done: ReductionOfTest, usual: tuple[ReducedTest, dict[str, Result]]) -> None:
    test, results = usual
    below = 0.2 * FIRST
    onset = ONSET - 0.001 + 0.002 * (SECOND - below) / (SECOND - FLAT)
    holds(results["end_slope"], FLAT / FIRST, "1")
    holds(results["plateau_displacement"], onset, "m")
    force = first_loading(np.array([onset]))[0]
    holds(results["plateau_force"], float(force), "N")
    assert "no_plateau" not in {note.code for note in test.findings.notes}
    assert [line.result for line in done.lines] == ["before_kink", "behind_kink", "slope_at_end"]
    assert done.lines[2].slope == pytest.approx(FLAT, abs=1.0)


def cornered(over: str, seed: int = 0, noise: float = 0.0) -> dict[str, Result]:
    """5 N/mm up to a corner at 12 mm, 0.1 N/mm behind it; the tangent falls below a fifth there."""
    travel, force = pull(seed=seed)
    flat = force - 4900.0 * np.maximum(travel - 0.012, 0.0)
    flat = flat + noise * np.random.default_rng(seed).normal(size=len(flat))
    line = "stiffness, from: 1 mm, to: 3 mm"
    tangents = f"plateau, slope_below: 20 %, of: stiffness, over: {over}"
    return pulled(travel, flat, results=[line, tangents])[1]


@pytest.mark.parametrize("over", ["1 mm", "2 mm", "5 mm"])
def test_a_corner_that_tangents_smear_is_in_the_interval(over: str) -> None:
    results = cornered(over)
    for name, true in (("plateau_displacement", 0.012), ("plateau_force", 60.0)):
        found = results[name]
        assert found.interval is not None
        assert found.estimate is not None
        assert found.value is not None
        assert found.interval.lower < true < found.interval.upper
        assert max(found.budget, key=lambda contribution: abs(contribution.change)).cause == TANGENT
        if name == "plateau_displacement":
            assert found.value - true > 3.0 * abs(found.estimate - true)  # a quarter is left


def test_what_is_left_of_a_corner_when_noise_is_taken_off() -> None:
    """5 mm seen, 3 mm of noise and 1 mm more on average; 2 N seen, all of which is noise."""
    noise = np.array([[1e-3 + 3e-3, 1e-3 - 3e-3], [-4.0, 4.0]])
    found = _Corner.of(np.array([6e-3, 2.0]), np.array([1e-3, 0.5]), noise)
    assert found.size == pytest.approx([4e-3, 0.0])  # 5^2 - 3^2 = 4^2
    assert found.share == pytest.approx([0.8, 0.0])
    drawn = found.in_noise(np.array([[1e-3 + 4e-3], [7.0]]))
    assert drawn[:, 0] == pytest.approx([0.5 * 0.8 * 3e-3, 0.0])
    nothing = _Corner.of(np.zeros(2), np.zeros(2), np.zeros((2, 5)))
    assert nothing.size == pytest.approx([0.0, 0.0])


@pytest.mark.slow
def test_noise_in_a_corner_is_in_the_interval() -> None:
    """Tangents of half the length have three times the noise, and half of it is in the estimate."""
    off, stated = list[float](), list[float]()
    for seed in range(12):
        found = cornered("1 mm", seed, noise=0.03)["plateau_displacement"]
        assert found.estimate is not None
        assert found.interval is not None
        off.append(found.estimate - 0.012)
        stated.append(found.interval.upper - found.interval.lower)
    assert np.std(off) < 1.4 * np.median(stated) / 3.92
    assert np.mean(np.abs(off) < 0.5 * np.array(stated)) > 0.8


def test_the_doubt_about_a_corner_by_hand() -> None:
    """Lines over half the tangent leave half the smear: up to three times what they change."""
    travel, force = pull()
    flat = force - 4900.0 * np.maximum(travel - 0.012, 0.0)
    places = np.arange(0.0113, 0.0133, 1e-5)

    def onset(over: float) -> float:
        slopes = []
        for at in places:
            near = np.abs(travel - at) <= 0.5 * over
            slopes.append(np.polyfit(travel[near] - at, flat[near], 2)[1])
        return float(places[np.flatnonzero(np.array(slopes) >= 1000.0)[-1]])

    change = onset(0.001) - onset(0.002)
    by_hand = abs(change) * 3.0 / np.sqrt(12.0)  # a rectangle on one side
    (found,) = (
        contribution.change
        for contribution in cornered("2 mm")["plateau_displacement"].budget
        if contribution.cause == TANGENT
    )
    assert abs(found) == pytest.approx(by_hand, rel=0.06)

    results = cornered("2 mm")
    at = results["plateau_displacement"].value
    assert at is not None
    short, whole = (
        float(np.polynomial.Polynomial.fit(travel[near], flat[near], 2)(at))
        for near in (np.abs(travel - at) <= 0.5e-3, np.abs(travel - at) <= 1e-3)
    )
    by_hand = 2.0 * (short - whole) - 3.0 * abs(change) * 100.0  # 0.1 N/mm behind the corner
    (found,) = (
        contribution.change
        for contribution in results["plateau_force"].budget
        if contribution.cause == TANGENT
    )
    assert found == pytest.approx(by_hand / np.sqrt(12.0), rel=0.06)


def test_no_plateau_where_the_end_is_not_surely_flat() -> None:
    """A slope at the end of 9.9 % that is known to a hundredth of itself, and one of 9 %."""
    travel, force = pull()
    for share, is_there in ((0.099, False), (0.09, True)):
        flat = force - (1.0 - share) * 5e3 * np.maximum(travel - 0.008, 0.0)
        line = "stiffness, from: 1 mm, to: 3 mm"
        results = pulled(travel, flat, results=[line, PLATEAU])[1]
        value, interval = results["end_slope"].value, results["end_slope"].interval
        assert value is not None
        assert interval is not None
        assert value < 0.1
        assert (interval.upper < 0.1) == is_there
        assert ("plateau_displacement" in results) == is_there


def test_no_plateau_where_tangents_are_nowhere_steep() -> None:
    """Steep over a tenth of a tangent alone."""
    travel, force = pull()
    flat = force - 5e3 * np.maximum(travel - 2e-4, 0.0)
    asked = ["stiffness, from: 0 mm, to: 0.18 mm", PLATEAU.replace("10 %", "25 %")]
    test, results = pulled(travel, flat, results=asked)
    assert "plateau_displacement" not in results
    assert "no_plateau" in [note.code for note in test.findings.notes]


def test_no_share_of_a_slope_that_falls() -> None:
    travel, force = pull()
    asked = ["stiffness, from: 1 mm, to: 3 mm", PLATEAU]
    falls = force - 5.5e3 * np.minimum(travel, 0.004)
    found = pulled(travel, falls, results=asked)[1]["end_slope"]
    assert "no_stiffness: the slope at the start is -5" in found.why


@pytest.mark.slow
@pytest.mark.parametrize("shaken", [0.0, 5e-5])
def test_width_of_an_onset_as_the_scatter_over_records(shaken: float) -> None:
    """50 um of noise of the displacement count for 40 mN at the onset, 20 mN are in the force."""
    found = []
    for seed in range(30):
        travel, noisy = pull(seed=seed)
        force = noisy - 5e3 * travel + 40.0 * (1.0 - np.exp(-travel / 0.005))
        asked = ["stiffness, from: 0.3 mm, to: 1.3 mm", PLATEAU.replace("2 mm", "0.5 mm")]
        seen = travel + np.random.default_rng(seed + 1000).normal(0.0, shaken, len(travel))
        found.append(pulled(seen, force, results=asked)[1])
    for name in ("end_slope", "plateau_displacement", "plateau_force"):
        values = [finding[name].value for finding in found]
        spread = float(np.std([value for value in values if value is not None], ddof=1))
        noise = [
            change.change
            for finding in found
            for change in finding[name].budget
            if change.cause == "noise"
        ]
        assert 0.8 < float(np.median(noise)) / spread < 1.8


def test_no_plateau_is_a_finding_and_no_failure() -> None:
    test, results = asked(cycles(noise=NOISE, has_plateau=False))
    holds(results["end_slope"], SECOND / FIRST, "1")
    assert "plateau_displacement" not in results
    assert "plateau_force" not in results
    (said,) = [note for note in test.findings.notes if note.code == "no_plateau"]
    assert said.severity == "info"
    assert said.message.startswith("the slope over the last 5 mm is 37.")
    assert "% of initial_stiffness (3" in said.message
    assert "not surely below 20 %: no plateau up to 49.9" in said.message
    assert said.message.endswith(" mm")


def test_bending_stiffness(usual: tuple[ReducedTest, dict[str, Result]]) -> None:
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
    [("cantilever", "no_length: "), ("three-point", "no_span: ")],
)
def test_a_length_that_is_missing(support: str, reason: str) -> None:
    text = ASKED.replace("support: cantilever", f"support: {support}")
    _, results = asked(cycles(noise=NOISE), text)
    assert results["bending_stiffness"].status is Status.FAILED
    assert results["bending_stiffness"].why.startswith(reason)


def test_window_outside_the_loading() -> None:
    text = ASKED.replace("to: 5 mm", "to: 70 mm").replace(
        "from: 0.2 mm, to: 1.8", "from: 55 mm, to: 60"
    )
    _, results = asked(cycles(noise=NOISE), LENGTH + text)
    for name in ("kink_displacement", "kink_force"):
        assert results[name].why.startswith("not_reached: the branch reaches 49.9")
    assert results["initial_stiffness"].why.startswith("not_reached: ")
    assert results["end_slope"].why.startswith("no_stiffness: initial_stiffness ")
    assert results["bending_stiffness"].why.startswith("no_stiffness: ")


def test_nothing_moves() -> None:
    time, path, force = cycles(noise=NOISE)
    _, results = asked((time, 0.01 * path, force))
    assert {result.status for result in results.values()} == {Status.FAILED}
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
    said = "gap: force and displacement are known up to 37 mm of the first loading alone"
    assert said in results["end_slope"].why
    assert results["end_slope"].status is Status.DOUBTFUL


def test_a_reversed_bridge_is_doubted_in_every_result() -> None:
    time, path, force = cycles(noise=NOISE)
    test, results = asked((time, path, -force))
    assert doubted(test)["force"].startswith("force_reversed: the force goes to -1")
    assert results["initial_stiffness"].status is Status.DOUBTFUL
    assert results["kink_displacement"].status is Status.FAILED


@pytest.mark.slow
def test_another_shape_widens_places() -> None:
    """The same deflection by a shape with a term more, 1 % longer."""
    test, before = asked(cycles(noise=NOISE))
    moved = {SHAPE: 1.01 * test.displacement.values}
    signal = replace(test.displacement, moved=moved)
    test = replace(test, signals=test.signals.with_filtered("displacement", signal))
    test = replace(test, replicates=replicate_curves(test))
    for entry in (Kink(start=2e-4, stop=5e-3), Plateau(slope_below=0.2)):
        numbers = entry.compute(test).numbers
        after = {number.name: number for number in (to_result(test, number) for number in numbers)}
        (name,) = (each for each in after if each.endswith("_displacement"))
        assert after[name].value == before[name].value
        assert width(after[name]) > width(before[name])


OLD = "corrections: [large-deflection, roller-radius], roller: {diameter: 10 mm}"
WINDOW = ("initial-stiffness, from: 0.2 mm, to: 5 mm", "initial-stiffness, from: 2 mm, to: 15 mm")


def stiffness(corrections: str) -> Result:
    change = (WINDOW, (OLD, corrections))
    return reduced_bending(BendingRecord(), without=("markers",), change=change)[1][
        "bending_stiffness"
    ]


def test_large_deflection_gives_the_true_value_back() -> None:
    plain, exact = stiffness("corrections: []"), stiffness("corrections: [large-deflection]")

    assert plain.value is not None
    assert exact.value is not None
    assert plain.value < 0.95 * 0.02
    assert exact.value == pytest.approx(0.02, rel=0.01)
    assert exact.interval is not None
    assert exact.interval.lower < 0.02 < exact.interval.upper
    assert exact.remark.startswith("corrected as an elastic beam: large-deflection +")
    assert exact.how.endswith(f"; {exact.remark}")


def test_the_size_of_each_correction_is_said() -> None:
    more = "corrections: [large-deflection, roller-radius, roller-friction]"
    found = stiffness(f"{more}, roller: {{diameter: 10 mm, friction: 0.2}}")

    _, _, said = found.remark.partition("corrected as an elastic beam: ")
    names = [part.split()[0] for part in said.split(", ")]
    assert names == ["large-deflection", "roller-radius", "roller-friction"]
    sizes = [float(part.split()[1]) for part in said.split(", ")]
    assert sizes[0] > 0.0 > sizes[1]
    assert sizes[2] < 0.0


@pytest.mark.parametrize(
    ("corrections", "told"),
    [
        (
            "corrections: [roller-radius], roller: {diameter: 10 mm}",
            "expected 'large-deflection' beside 'roller-radius', found none. Add "
            "'large-deflection' to the corrections.",
        ),
        (
            "corrections: [large-deflection, roller-friction], roller: {diameter: 10 mm}",
            "expected 'roller.friction' for 'roller-friction', found none. Add "
            "'roller: {friction: ...}'.",
        ),
        (
            "support: cantilever, corrections: [large-deflection]",
            "expected corrections for 'three-point' alone, found 'cantilever'. Remove them.",
        ),
    ],
)
def test_corrections_without_what_they_need(corrections: str, told: str) -> None:
    text = CONDUIT.read_text(encoding="utf-8")
    if "cantilever" in corrections:
        text = text.replace("support: three-point,", "")
    with pytest.raises(ProtocolError) as info:
        parse_protocol(text.replace(OLD, corrections), "p.yaml")
    assert told in str(info.value)
