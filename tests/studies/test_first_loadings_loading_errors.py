"""Errors that the points of a first loading share: zeros, clock, scale."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.protocol.load import load_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.curve import Aligned, Branch, ClockFit, Curve, Direction, Interval
from labpipe.records.quality import Reason
from labpipe.records.result import Contribution, Result, Specimen, Status, TestResult
from labpipe.studies.first_loadings import (
    force_zero_error,
    place_error,
    scale_errors,
    zero_error,
)

REST, LOADING, RATE = 4000, 1000, 20.0
NOISE, BLUR = 1e-3, 4e-5
SPEED = 0.05 / (LOADING / RATE)
FIRST = Branch(REST, REST + LOADING, 1, Direction.LOADING, REST / RATE, (REST + LOADING) / RATE)
PEAK = Result("peak_displacement.1", 0.05, "m", interval=Interval.normal_95(0.05, 1e-5))


def curve() -> Curve:
    """Rest of 200 s, with noise, and a loading at even speed."""
    random = np.random.default_rng(1)
    count = REST + LOADING
    displacement = np.concatenate([np.zeros(REST), SPEED * np.arange(LOADING) / RATE])
    displacement[:REST] += BLUR * random.standard_normal(REST)
    return Curve(
        time=np.arange(count) / RATE,
        displacement=displacement,
        force=NOISE * random.standard_normal(count),
        branch=np.repeat([-1, 0], [REST, LOADING]),
        cycle=np.repeat([0, 1], [REST, LOADING]),
        branches=(FIRST,),
    )


def result(aligned: Aligned | None = None, results: tuple[Result, ...] = (PEAK,)) -> TestResult:
    return TestResult(
        test="T1",
        specimen=Specimen("A2", "A2-s1", "1"),
        protocol="wire-cantilever",
        protocol_yaml="",
        test_yaml="",
        labpipe_version="0",
        inputs=(),
        recordings={},
        aligned=aligned,
        curve=curve(),
        shape=None,
        results=results,
        quality=(),
    )


def joined(error: float) -> Aligned:
    """Two clocks whose offset is known to `error`, s."""
    fit = ClockFit(
        offset=1.0,
        drift=0.0,
        offset_interval=Interval.normal_95(1.0, error),
        drift_interval=Interval.normal_95(0.0, 1e-5),
        residual=0.0,
        event_times_motion=np.array([60.0]),
        event_times_force=np.array([61.0]),
        event_errors=np.array([error]),
        method="turning points",
    )
    return Aligned(curve().time, {}, fit)


@pytest.fixture(scope="module")
def protocol(repository: Path) -> Protocol:
    return load_protocol(repository / "protocols" / "wire-cantilever.yaml")


def test_zero_of_white_noise_is_that_of_the_mean_over_the_part() -> None:
    values = NOISE * np.random.default_rng(2).standard_normal(20_000)
    time = np.arange(20_000) / 100.0
    assert zero_error(time, values, None) == pytest.approx(NOISE / np.sqrt(20_000), rel=0.25)
    assert zero_error(time, values, 2.0) == pytest.approx(NOISE / np.sqrt(200), rel=0.25)
    assert zero_error(time, values, 1e3) == zero_error(time, values, None)


def test_missing_values_at_rest_count_as_absent() -> None:
    values = NOISE * np.random.default_rng(2).standard_normal(400)
    values[::2] = np.nan
    time = np.arange(400) / 100.0
    known = np.sqrt(np.nanvar(values) / 200)
    assert zero_error(time, values, None) == pytest.approx(known, rel=0.4)


def test_without_a_rest_nothing_is_known_of_a_zero(protocol: Protocol) -> None:
    assert zero_error(np.zeros(0), np.zeros(0), 2.0) == 0.0
    assert zero_error(np.arange(3.0), np.full(3, np.nan), 2.0) == 0.0
    at_once = replace(FIRST, start=0)
    assert force_zero_error(protocol, curve(), at_once) == 0.0


def test_the_protocol_says_over_which_stretch_zeros_are_taken(protocol: Protocol) -> None:
    found = force_zero_error(protocol, curve(), FIRST)
    assert found == pytest.approx(NOISE / np.sqrt(2.0 * RATE), rel=0.3)
    without = protocol.model_copy(update={"steps": (), "curve": None})
    over_all = force_zero_error(without, curve(), FIRST)
    assert over_all == pytest.approx(found * np.sqrt(2.0 / (REST / RATE)), rel=0.01)


def test_a_clock_that_is_off_moves_the_deflection(protocol: Protocol) -> None:
    alone = place_error(result(), protocol, curve(), FIRST)
    assert alone == pytest.approx(BLUR / np.sqrt(2.0 * RATE), rel=0.3)
    both = place_error(result(joined(0.02)), protocol, curve(), FIRST)
    assert both == pytest.approx(np.hypot(alone, 0.02 * SPEED), rel=1e-3)
    assert place_error(result(joined(np.nan)), protocol, curve(), FIRST) == alone


def test_a_loading_of_one_point_has_no_speed(protocol: Protocol) -> None:
    short = replace(FIRST, stop=FIRST.start + 1)
    alone = place_error(result(), protocol, curve(), FIRST)
    assert place_error(result(joined(0.02)), protocol, curve(), short) == alone


def test_the_scale_is_what_the_budget_of_the_peak_says_of_it() -> None:
    """Of 50 mm: shape 3 um and cameras 4 um are alike, offsets of 6 and -8 um are the test's."""
    rows = {
        "noise": 9e-5,
        "zero of the displacement": 2e-5,
        "shape of the wire": 3e-6,
        "scale of the displacement": -4e-6,
        "pull offset": 6e-6,
        "centre offset": -8e-6,
    }
    known = replace(PEAK, budget=tuple(Contribution(*row) for row in rows.items()))
    assert scale_errors(result(results=(known,))) == pytest.approx((1e-4, 2e-4))


def test_without_a_budget_all_of_the_interval_counts() -> None:
    assert scale_errors(result()) == pytest.approx((2e-4, 0.0))
    assert scale_errors(result(results=())) == (0.0, 0.0)
    failed = Result(
        PEAK.name, None, "m", status=Status.FAILED, reasons=(Reason("no_cycle", "none"),)
    )
    assert scale_errors(result(results=(failed,))) == (0.0, 0.0)
    assert scale_errors(result(results=(replace(PEAK, interval=None),))) == (0.0, 0.0)
