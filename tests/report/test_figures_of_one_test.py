"""Curves, fitted lines, clocks and moments of one test: what is drawn, and what is said."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from labpipe.records.arrays import Floats
from labpipe.records.curve import Aligned, Bending, FittedLine, Interval, Slip, SlipDecision
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Result, TestResult
from labpipe.report.bending_figure import draw_moment_curvature, plot_cloud
from labpipe.report.curve_figures import (
    Treatment,
    draw_force_displacement,
    draw_stiffness_lines,
    treatment,
    treatment_of_force,
)
from labpipe.report.figure_page import style
from labpipe.report.timeline_figure import draw_timeline, plot_residuals
from tests.approved import Approve
from tests.builders.measured_bending import some_bending, some_cloud, some_law
from tests.report.figure_words import all_words
from tests.store.builders_result import DRIFT, OFFSET, build_result


@pytest.fixture(scope="module")
def result() -> TestResult:
    return build_result(half_cycle=4.0)


LINE = FittedLine("stiffness_first", slope=2000.0, level=1.0, start=0.002, stop=0.008)
SLIP = Slip(
    position=0.004,
    drop=0.5,
    position_interval=Interval(0.0039, 0.0041),
    drop_interval=Interval(0.4, 0.6),
    decision=SlipDecision.REPAIRED,
    start=10,
    stop=11,
)


@pytest.fixture(scope="module")
def fitted() -> TestResult:
    known = build_result(half_cycle=4.0)
    found = (
        Result("break_point", 0.006, "m", Interval(0.005, 0.007)),
        Result("failure_displacement", 0.009, "m", Interval(0.0089, 0.0091)),
        Result("failure_force", 12.0, "N", Interval(11.0, 13.0)),
    )
    display = {**known.display, "stiffness": "N/mm"}
    return replace(known, lines=(LINE,), slips=(SLIP,), results=found, display=display)


@pytest.fixture(scope="module")
def bent() -> TestResult:
    known = build_result(cycles=1, half_cycle=4.0, force_rate=50.0)
    display = {**known.display, "moment": "N*mm", "bending_stiffness": "N*mm^2"}
    return replace(known, bending=some_bending(), display=display)


def test_residuals_are_what_the_line_leaves_over(result: TestResult) -> None:
    axes = Figure().subplots()
    plot_residuals(result, axes)
    assert result.aligned is not None
    fit = result.aligned.clock_fit
    assert fit is not None
    expected = (fit.event_times_force - OFFSET - (1 + DRIFT) * fit.event_times_motion) * 1e3
    bars: Any = axes.containers[0]
    drawn = np.asarray(bars.lines[0].get_ydata(), dtype=np.float64)
    np.testing.assert_allclose(drawn, expected, atol=1e-9)
    lengths = [float(np.ptp(path.vertices[:, 1])) for path in bars.lines[2][0].get_paths()]
    np.testing.assert_allclose(lengths, 2 * 1.96 * fit.event_errors * 1e3)


def test_points_begin_where_the_law_was_at_rest(bent: TestResult) -> None:
    axes = Figure().subplots()
    plot_cloud(bent, axes)
    _unloading, loading, law = axes.lines
    cloud = some_cloud()
    rows = cloud.branch == 0
    y = 1e3 * (cloud.moment[rows] + cloud.moment_at_rest).ravel()
    np.testing.assert_allclose(np.asarray(loading.get_ydata()), y)
    at_rest = np.interp(2e-3, some_law().moment, some_law().curvature)
    x = cloud.curvature[rows] - at_rest * np.array([1.0, 0.5, 0.0])
    assert np.asarray(loading.get_xdata())[0] == pytest.approx(x[0, 0])
    np.testing.assert_allclose(np.asarray(law.get_ydata()), 1e3 * some_law().moment)


FILTERED = build_result(half_cycle=0.5, cycles=1, force_rate=50.0)
PLATEAU = Result("plateau_displacement", 0.007, "m", Interval(0.006, 0.008))
KINK = Result("kink_displacement", 0.002, "m", Interval(0.0019, 0.0021))


def treated(change_force: Floats | float = 0.0, change_travel: Floats | float = 0.0) -> TestResult:
    """A test whose curve is what was aligned, plus a change."""
    assert FILTERED.curve is not None
    assert FILTERED.aligned is not None
    series = FILTERED.aligned.series
    force = series["force"].values + change_force
    travel = series["displacement"].values + change_travel
    return replace(FILTERED, curve=replace(FILTERED.curve, force=force, displacement=travel))


def test_what_was_done_to_the_curve() -> None:
    none, corrected, filtered = Treatment.NONE, Treatment.CORRECTED, Treatment.FILTERED
    plain = treated()
    assert plain.curve is not None
    force = plain.curve.force
    at = np.arange(len(force))
    repaired = np.where(at > 40, 0.3, 0.0) + np.where(at == 20, 5.0, 0.0)
    cut = np.where(at > at[-11], np.nan, 0.0)
    note = QualityNote("compliance_removed", Severity.INFO, "displacement", "Taken off.")
    softer = treated(change_travel=-1e-4 * force)
    smoothed = treated(1e-4 * force * plain.curve.time, -1e-4 * force)
    for test, expected in (
        (FILTERED, filtered), (plain, none), (treated(change_travel=-1e-3), corrected),
        (softer, filtered), (replace(softer, quality=(note,)), corrected),
        (replace(smoothed, quality=(note,)), filtered),
        (replace(plain, aligned=None), filtered), (replace(plain, curve=None), filtered),
    ):  # fmt: skip
        assert treatment(test) is expected
    for test, expected in (
        (FILTERED, filtered), (treated(cut), none), (treated(repaired), corrected),
        (treated(np.nan), filtered),
    ):  # fmt: skip
        assert treatment_of_force(test) is expected


def test_words(result: TestResult, fitted: TestResult, bent: TestResult, approved: Approve) -> None:
    plain = treated()
    assert result.curve is not None
    assert result.aligned is not None
    fit = result.aligned.clock_fit
    assert fit is not None
    two = replace(
        fit,
        drift=-fit.drift,
        event_times_motion=fit.event_times_motion[:2],
        event_times_force=fit.event_times_force[:2],
        event_errors=fit.event_errors[:2],
    )
    whole, pulled, once = (
        replace(result, curve=replace(result.curve, branches=result.curve.branches[:count]))
        for count in (0, 1, 2)
    )
    aligned = [replace(result.aligned, clock_fit=clocks) for clocks in (two, None)]
    kinked = replace(fitted, results=(KINK,), slips=(), lines=())
    bare = replace(result, curve=None, aligned=Aligned(np.empty(0), {}))
    marked = replace(fitted, slips=(replace(SLIP, decision=SlipDecision.MARKED),))
    slope = Result("stiffness_first", 2000.0, "N/m", Interval(1950.0, 2060.0))
    lawless = Bending(some_cloud(), None, Reason("no_law", "expected at least 24"))
    with style():
        pages = {
            "few cycles": draw_force_displacement(result),
            "many cycles": draw_force_displacement(build_result(half_cycle=1.0, cycles=35)),
            "loading alone": draw_force_displacement(pulled),
            "one cycle": draw_force_displacement(once),
            "not filtered": draw_force_displacement(plain),
            "corrected": draw_force_displacement(treated(change_travel=-1e-3)),
            "no branches": draw_force_displacement(whole),
            "no curve": draw_force_displacement(bare),
            "fitted lines": draw_stiffness_lines(fitted),
            "a slope": draw_stiffness_lines(replace(fitted, results=(*fitted.results, slope))),
            "slip not repaired": draw_stiffness_lines(marked),
            "plateau": draw_stiffness_lines(replace(kinked, results=(KINK, PLATEAU))),
            "a kink": draw_stiffness_lines(kinked),
            "no branch": draw_stiffness_lines(replace(fitted, curve=None)),
            "timeline": draw_timeline(result),
            "two events": draw_timeline(replace(result, aligned=aligned[0])),
            "one clock": draw_timeline(replace(result, aligned=aligned[1])),
            "no motion": draw_timeline(bare),
            "moments": draw_moment_curvature(bent),
            "no law": draw_moment_curvature(replace(bent, bending=lawless)),
            "no moments": draw_moment_curvature(replace(bent, bending=None)),
        }
    approved(all_words(pages))
