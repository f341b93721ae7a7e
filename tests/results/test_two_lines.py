"""Break points and kinks of loadings whose corner is known, and when there is none."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.process.story import Reduced
from labpipe.records.arrays import Floats
from labpipe.records.result import Result, Status
from tests.builders.bundle_loops import FIRST, KINK, NOISE, SECOND, cycles, width
from tests.builders.bundle_loops import holds as holds_in_bundles
from tests.builders.pulls import MARKED, STEP, holds, pull, pulled, reduction, slipped
from tests.builders.reduced import reduction as reduced_bundle

TWO = "two-segments, from: 1 mm, to: 18 mm"
NAMES = ("segment_stiffness_first", "segment_stiffness_second", "break_point")


def bilinear(seed: int = 0) -> tuple[Floats, Floats]:
    """5 N/mm up to 8 mm, 2 N/mm beyond, up to 20 mm."""
    travel, force = pull(seed=seed)
    return travel, force - 3e3 * np.maximum(travel - 0.008, 0.0)


def test_two_segments() -> None:
    done = reduction(*bilinear(), results=[TWO])
    results = {each.name: each for each in done.results}
    holds(results["segment_stiffness_first"], 5000.0, "N/m")
    holds(results["segment_stiffness_second"], 2000.0, "N/m")
    holds(results["break_point"], 0.008, "m")
    first, second = done.lines
    assert (first.result, second.result) == NAMES[:2]
    assert first.stop == second.start == results["break_point"].value
    assert first.level + first.slope * (first.stop - first.start) == pytest.approx(second.level)


def test_the_value_is_that_of_brute_force() -> None:
    travel, force = bilinear()
    _, results = pulled(travel, force, results=[TWO])
    inside = (travel >= 1e-3) & (travel <= 18e-3)
    d, f = travel[inside], force[inside]

    def lines(at: float) -> tuple[float, Floats]:
        columns = [np.ones_like(d), np.minimum(d - at, 0.0), np.maximum(d - at, 0.0)]
        found, squares, *_ = np.linalg.lstsq(np.column_stack(columns), f, rcond=None)
        return float(squares[0]), found

    at = results["break_point"].value
    assert at is not None
    least, (_, first, second) = lines(at)
    near = at + np.concatenate([-np.geomspace(1e-8, 1e-4, 40), np.geomspace(1e-8, 1e-4, 40)])
    assert min(lines(other)[0] for other in near) >= least
    assert results["segment_stiffness_first"].value == pytest.approx(first, rel=1e-9)
    assert results["segment_stiffness_second"].value == pytest.approx(second, rel=1e-9)


def test_budget() -> None:
    """A slope is in proportion to the scale of the force, a place is not."""
    _, results = pulled(*bilinear(), results=[TWO], scale="1 %")
    first, _, place = (results[name] for name in NAMES)
    changes = {each.cause: each.change for each in first.budget}
    assert changes["scale of the force"] == pytest.approx(50.0, rel=5e-3)
    assert width(first) == pytest.approx(2.0 * 1.96 * np.hypot(50.0, changes["noise"]), rel=0.15)
    scale = [abs(each.change) for each in place.budget if each.cause == "scale of the force"]
    assert max(scale, default=0.0) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("shaken", [0.0, 1e-5])
def test_width_of_the_break_as_the_scatter_over_records(shaken: float) -> None:
    """10 um of noise of the displacement count for 50 mN: twice the noise of the force."""
    found = []
    for seed in range(40):
        travel, force = bilinear(seed)
        seen = travel + np.random.default_rng(seed + 1000).normal(0.0, shaken, len(travel))
        found.append(pulled(seen, force, results=[TWO])[1]["break_point"])
    values = [each.value for each in found if each.value is not None]
    spread = float(np.std(values, ddof=1))
    typical = float(np.median([width(each) for each in found]))
    assert 0.8 < typical / (2.0 * 1.96 * spread) < 1.8


def test_no_bend() -> None:
    _, results = pulled(*pull(), results=[TWO])
    for name in NAMES:
        assert results[name].why.startswith("no_bend: ")


def test_a_break_that_is_hardly_known() -> None:
    """5 against 4.996 N/mm in noise of 20 mN: a bend, but anywhere in a quarter of the window."""
    travel, force = pull(seed=2)
    bent = force - 4.0 * np.maximum(travel - 0.009, 0.0)
    _, results = pulled(travel, bent, results=[TWO])
    found = results["break_point"]
    assert found.status is Status.DOUBTFUL
    assert found.why.startswith("wide_break: the break lies within ")
    assert "wide_break" not in results["segment_stiffness_first"].why


def test_a_window_that_is_not_reached() -> None:
    _, results = pulled(*pull(), results=["two-segments, from: 1 mm, to: 30 mm"])
    assert results["break_point"].why.startswith("not_reached: ")


def test_slopes_are_stiffnesses_for_what_follows() -> None:
    asked = [TWO, "modulus, of: segment_stiffness_second, area: stated"]
    section = "{length: 100 mm, section: {area: 5 mm**2}}"
    test, results = pulled(*bilinear(), results=asked, specimen=section)
    holds(results["modulus"], 2000.0 * 0.1 / 5e-6, "Pa")
    slope = results["segment_stiffness_second"]
    assert width(results["modulus"]) == pytest.approx(width(slope) * 0.1 / 5e-6, rel=1e-6)
    at = results["break_point"].value
    assert test.stiffnesses["segment_stiffness_first"].window == pytest.approx(
        (0.001, at), abs=STEP
    )
    assert test.stiffnesses["segment_stiffness_second"].window == pytest.approx(
        (at, 0.018), abs=STEP
    )


def test_a_marked_slip_bends_both() -> None:
    travel, force = bilinear()
    torn = slipped(travel, force, (0.012, 2.0))
    _, results = pulled(travel, torn, curve=MARKED, results=[TWO])
    for name in NAMES:
        assert results[name].why.startswith("slip_in_window: ")


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, 0.75])
def test_a_kink_does_not_depend_on_where_samples_lie(phase: float) -> None:
    """A gradual bend, sampled every 50 um: two lines meet up to 20 um off as samples move.

    With 20 000 samples they meet at 2.0488 mm, by numpy and all breaks tried. Nothing is uncertain
    here, so that all of the interval stands for what lies between samples.
    """
    travel: Floats = 50e-6 * (np.arange(160.0) + phase)
    force: Floats = 8.0 * (1.0 - np.exp(-travel / 2e-3))
    _, results = pulled(travel, force, results=["kink, from: 0.2 mm, to: 5 mm"])
    found = results["kink_displacement"]
    assert found.interval is not None
    assert found.value is not None
    assert found.interval.lower <= 2.0488e-3 <= found.interval.upper
    assert found.interval.lower <= found.value <= found.interval.upper


@pytest.fixture(scope="module")
def bundle() -> Reduced:
    more = "specimen: {length: 100 mm}\nresults:\n  - {result: kink, from: 0.2 mm, to: 5 mm}\n"
    return reduced_bundle(*cycles(noise=NOISE), more=more)


@pytest.fixture(scope="module")
def kink(bundle: Reduced) -> dict[str, Result]:
    return {each.name: each for each in bundle.results}


def test_kink(bundle: Reduced, kink: dict[str, Result]) -> None:
    holds_in_bundles(kink["kink_displacement"], KINK, "m")
    holds_in_bundles(kink["kink_force"], FIRST * KINK, "N")
    assert width(kink["kink_displacement"]) < 2e-4
    before, behind = bundle.lines[:2]
    assert (before.result, behind.result) == ("before_kink", "behind_kink")
    assert before.slope == pytest.approx(FIRST, rel=0.02)
    assert behind.slope == pytest.approx(SECOND, rel=0.02)
    assert before.stop == behind.start == kink["kink_displacement"].value
    assert before.level + before.slope * (before.stop - before.start) == pytest.approx(behind.level)


def test_scale_of_the_force_is_in_the_force_of_the_kink_alone(kink: dict[str, Result]) -> None:
    """The bundle's load cell is known to 1 %."""
    assert width(kink["kink_force"]) > 2 * 1.96 * 0.01 * FIRST * KINK
    scale = [
        abs(each.change)
        for each in kink["kink_displacement"].budget
        if each.cause == "scale of the force"
    ]
    assert max(scale, default=0.0) < 1e-9


@pytest.mark.parametrize(
    ("change", "code"), [(0.0, "no_kink: one straight"), (2e3, "no_kink: the slope rises")]
)
def test_no_kink(change: float, code: str) -> None:
    travel, force = pull()
    bent = force + change * np.maximum(travel - 0.008, 0.0)
    _, results = pulled(travel, bent, results=["kink, from: 1 mm, to: 18 mm"])
    for name in ("kink_displacement", "kink_force"):
        assert results[name].why.startswith(code)
