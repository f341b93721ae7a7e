"""Stiffnesses of pulls whose numbers are known, and what is made of them."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.causes import SCALE_OF_FORCE
from labpipe.records.result import Status
from labpipe.records.signals import Signals
from labpipe.results.reduced_test import ReducedTest
from labpipe.results.stiffness import Hardening, LoadingStiffness
from tests.builders.pulls import (
    BREAK,
    LINE,
    MARKED,
    SECTION,
    broken,
    holds,
    pull,
    pulled,
    reduction,
    slipped,
)


def bilinear() -> tuple[Floats, Floats]:
    """5 N/mm up to 8 mm, 2 N/mm beyond, up to 20 mm."""
    travel, force = pull()
    return travel, force - 3e3 * np.maximum(travel - 0.008, 0.0)


def test_line() -> None:
    done = reduction(*pull(), results=[LINE])
    results = {result.name: result for result in done.results}
    holds(results["stiffness"], 5000.0, "N/m")
    assert results["stiffness"].method == (
        "straight line from 2 mm to 10 mm of the first loading, interval for correlated noise"
    )
    (line,) = done.lines
    assert (line.result, line.slope) == ("stiffness", results["stiffness"].value)
    assert line.start == pytest.approx(0.002)
    assert line.stop == pytest.approx(0.010)
    assert line.level == pytest.approx(10.0, abs=0.02)


def test_stiffness_over_peak_force_forgets_the_scale() -> None:
    travel, force = bilinear()
    torn = broken(travel, force, at=0.018)
    asked = [LINE.replace("10 mm", "7 mm"), "normalised-stiffness, of: stiffness"]
    test, results = pulled(travel, torn, curve=BREAK, results=asked, scale="5 %")
    (scale,) = (row for row in results["stiffness"].budget if row.cause == SCALE_OF_FORCE)
    assert scale.change == pytest.approx(250.0, rel=0.005)
    assert scale.is_common
    assert test.stiffnesses["stiffness"].estimate.error == pytest.approx(250.0, rel=0.1)
    ratio = results["stiffness_per_peak_force"]
    assert (ratio.unit, ratio.status) == ("1/m", Status.OK)
    assert ratio.value == pytest.approx(5000.0 / 60.0, rel=2e-3)
    assert ratio.interval is not None
    assert ratio.value is not None
    assert ratio.interval.standard_error < 0.002 * ratio.value


def test_stiffness_over_a_force_that_may_not_be_the_peak() -> None:
    """The specimen outlasted the record."""
    asked = [LINE, "normalised-stiffness, of: stiffness"]
    _, results = pulled(*pull(), curve=BREAK, results=asked)
    found = results["stiffness_per_peak_force"]
    assert found.status is Status.DOUBTFUL
    assert found.why.startswith("partial_cycle: the record ends at 99.9")
    assert results["stiffness"].status is Status.OK


def test_modulus() -> None:
    areas = {
        **{"stated": 5e-6, "rectangle": 2e-5, "thin-wall": np.pi * 0.0095 * 0.0005},
        "annulus": 0.25 * np.pi * (0.01**2 - 0.008**2),
    }
    asked = [f"modulus, name: {area[:4]}, of: stiffness, area: {area}" for area in areas]
    _, results = pulled(*pull(), results=[LINE, *asked], specimen=SECTION)
    for area, size in areas.items():
        holds(results[area[:4]], 5000.0 * 0.1 / size, "Pa")
        assert results[area[:4]].method == f"stiffness x specimen.length / area ({area})"


@pytest.mark.parametrize(
    ("stiffer", "more", "is_doubtful"),
    [(1.0, "", False), (100.0, "", True), (100.0, "compliance: {value: 0 um/N}", False)],
)
def test_the_machine_may_be_in_a_modulus(stiffer: float, more: str, is_doubtful: bool) -> None:
    """Of 5 N/mm, 0.1 um/N of frame and grips take 0.05 %; of 500 N/mm 5 %."""
    travel, force = pull()
    asked = [LINE, "modulus, of: stiffness, area: stated"]
    _, results = pulled(travel, stiffer * force, curve=more, results=asked, specimen=SECTION)
    codes = {reason.code for reason in results["modulus"].reasons}
    assert codes == ({"machine_compliance"} if is_doubtful else set())


def test_no_modulus_without_sizes() -> None:
    inside_out = "{length: 1 m, section: {outer_diameter: 8 mm, inner_diameter: 9 mm}}"
    for specimen, area, why in (
        ("{section: {area: 5 mm**2}}", "stated", "no_length: specimen.length, the gauge length, "),
        ("{length: 1 m}", "rectangle", "no_area: specimen.section.width and specimen.section.thic"),
        (inside_out, "annulus", "no_area: the annulus area comes out as -"),
    ):
        asked = [LINE, f"modulus, of: stiffness, area: {area}"]
        _, results = pulled(*pull(), results=asked, specimen=specimen)
        assert results["modulus"].why.startswith(why)
        assert results["stiffness"].status is Status.OK


def test_a_window_that_is_not_in_the_record() -> None:
    """Behind its end, so that nothing follows from the stiffness, and before its first sample."""
    asked = [
        *(LINE.replace("10 mm", "30 mm"), "normalised-stiffness, of: stiffness"),
        "modulus, of: stiffness, area: stated",
    ]
    _, results = pulled(*pull(), results=asked, specimen=SECTION)
    why = results["stiffness"].why
    assert why.startswith("not_reached: the branch reaches 19.98 mm, 30 mm is needed; ")
    assert "'results.stiffness.to: {value: 19.9 mm" in why
    for name in ("stiffness_per_peak_force", "modulus"):
        assert results[name].why.startswith("no_stiffness: stiffness ")
    travel, force = pull()
    why = pulled(travel + 0.004, force, results=[LINE])[1]["stiffness"].why
    assert why.startswith("not_reached: the branch begins at 4 mm, 2 mm is needed; ")
    assert "'results.stiffness.from: {value: 4 mm" in why


def test_marked_slip_in_a_window() -> None:
    travel, force = pull()
    lower = slipped(travel, force, (0.006, 3.0))
    asked = [
        LINE,
        "stiffness, name: behind, from: 12 mm, to: 18 mm",
        "modulus, of: stiffness, area: stated",
        "modulus, name: modulus_behind, of: behind, area: stated",
        "normalised-stiffness, of: stiffness",
    ]
    torn = broken(travel, lower, at=0.019)
    curve = f"{BREAK}, {MARKED}"
    _, results = pulled(travel, torn, curve=curve, results=asked, specimen=SECTION)
    for name in ("stiffness", "modulus", "stiffness_per_peak_force"):
        assert results[name].status is Status.DOUBTFUL, name
        assert results[name].why.startswith("slip_in_window: slipped in the grips at 6"), name
        assert results[name].why.endswith("and the curve stays as measured"), name
    for name in ("behind", "modulus_behind"):
        assert results[name].status is Status.OK, name


def test_stiffness_over_the_largest_peak_of_all_cycles() -> None:
    """A way up to 10 mm, back, and up to 20 mm, where it tears."""
    travel, _ = pull(length=0.01)
    path = np.concatenate([travel, travel[-2:0:-1], pull()[0]])
    noise = np.random.default_rng(1).normal(0, 0.02, len(path))
    load = broken(path, 5e3 * path + noise, at=0.016)
    asked = ["stiffness, from: 2 mm, to: 8 mm", "normalised-stiffness, of: stiffness"]
    _, results = pulled(path, load, curve=BREAK, results=asked)
    found = results["stiffness_per_peak_force"]
    assert found.value == pytest.approx(5000.0 / 80.0, rel=5e-3)
    assert found.status is Status.OK


def test_a_force_that_falls_where_the_frame_pulls_and_none_at_all() -> None:
    travel, force = pull()
    result = pulled(travel, 200.0 - force, results=[LINE])[1]["stiffness"]
    assert result.value == pytest.approx(-5000.0, rel=1e-3)
    assert result.why == "negative_slope: the force falls where the frame pulls"
    asked = [LINE, "normalised-stiffness, of: stiffness"]
    results = pulled(travel, force - 5e3 * travel, results=asked)[1]
    assert results["stiffness_per_peak_force"].why.startswith("no_peak_force: a peak of ")


def test_stretches_are_named_in_millimetres() -> None:
    assert LoadingStiffness(over=0.005).method == (
        "line over 5 mm from where the force takes up, time as instrument"
    )
    found = Hardening(over=0.005).compute(ReducedTest(Signals()))
    assert [number.method for number in found.numbers] == [
        "slope over 5 mm from the take-up / that of cycle 1, scale cancelled"
    ]


def test_compliance_of_a_stiff_bar() -> None:
    travel, force = pull()
    _, results = pulled(travel, force, results=["compliance, from: 10 N, to: 80 N"], scale="1 %")
    found = results["compliance"]
    holds(found, 1.0 / 5000.0, "m/N")
    shares = {contribution.cause: contribution.change for contribution in found.budget}
    assert abs(shares[SCALE_OF_FORCE]) == pytest.approx(0.01 / 5000.0, rel=1e-3)
