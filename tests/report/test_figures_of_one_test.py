"""Curves, fitted lines, clocks and moments of one test: what is drawn, and what is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.records.curve import (
    Aligned,
    Bending,
    FittedLine,
    Interval,
    PointFlag,
    Slip,
    SlipDecision,
)
from labpipe.records.quality import Reason
from labpipe.records.result import Result, TestResult
from labpipe.report.figures import (
    choose_shape_frames,
    make_flag_plot,
    make_force_displacement_page,
    make_marker_quality_page,
    make_moment_curvature_page,
    make_stiffness_lines_page,
    make_stress_strain_page,
    make_timeline_page,
    make_wire_shapes_page,
)
from labpipe.report.plot_records import Axis
from tests.approved import Approve
from tests.builders.measured_bending import some_bending, some_cloud
from tests.report.figure_words import all_words
from tests.store.builders_result import build_result


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
    result = build_result(half_cycle=4.0)
    results = (
        Result("break_point", 0.006, "m", Interval(0.005, 0.007)),
        Result("failure_displacement", 0.009, "m", Interval(0.0089, 0.0091)),
        Result("failure_force", 12.0, "N", Interval(11.0, 13.0)),
    )
    display = {**result.display, "stiffness": "N/mm"}
    return replace(result, lines=(LINE,), slips=(SLIP,), results=results, display=display)


@pytest.fixture(scope="module")
def bent() -> TestResult:
    result = build_result(cycles=1, half_cycle=4.0, force_rate=50.0)
    display = {**result.display, "moment": "N*mm", "bending_stiffness": "N*mm^2"}
    return replace(result, bending=some_bending(), display=display)


FILTERED = build_result(half_cycle=0.5, cycles=1, force_rate=50.0)
PLATEAU = Result("plateau_displacement", 0.007, "m", Interval(0.006, 0.008))
KINK = Result("kink_displacement", 0.002, "m", Interval(0.0019, 0.0021))


def shifted(change: float = 0.0) -> TestResult:
    """A test whose curve is what was aligned, with a displacement that was shifted."""
    assert FILTERED.curve is not None
    assert FILTERED.aligned is not None
    series = FILTERED.aligned.series
    force, travel = series["force"].values, series["displacement"].values + change
    return replace(FILTERED, curve=replace(FILTERED.curve, force=force, displacement=travel))


def test_words(result: TestResult, fitted: TestResult, bent: TestResult, approved: Approve) -> None:
    assert result.curve is not None
    assert result.aligned is not None
    fit = result.aligned.clock_fit
    assert fit is not None
    two_events = replace(
        fit,
        drift=-fit.drift,
        event_times_motion=fit.event_times_motion[:2],
        event_times_force=fit.event_times_force[:2],
        event_errors=fit.event_errors[:2],
    )
    without_branches, pulled, once = (
        replace(result, curve=replace(result.curve, branches=result.curve.branches[:count]))
        for count in (0, 1, 2)
    )
    aligned = [replace(result.aligned, clock_fit=clocks) for clocks in (two_events, None)]
    kinked = replace(fitted, results=(KINK,), slips=(), lines=())
    bare = replace(result, curve=None, aligned=Aligned(np.empty(0), {}))
    marked = replace(fitted, slips=(replace(SLIP, decision=SlipDecision.MARKED),))
    slope = Result("stiffness_first", 2000.0, "N/m", Interval(1950.0, 2060.0))
    lawless = Bending(some_cloud(), None, Reason("no_law", "expected at least 24"))
    pages = {
        "few cycles": make_force_displacement_page(result),
        "many cycles": make_force_displacement_page(build_result(half_cycle=1.0, cycles=35)),
        "loading alone": make_force_displacement_page(pulled),
        "one cycle": make_force_displacement_page(once),
        "not filtered": make_force_displacement_page(shifted()),
        "corrected": make_force_displacement_page(shifted(-1e-3)),
        "no branches": make_force_displacement_page(without_branches),
        "no curve": make_force_displacement_page(bare),
        "fitted lines": make_stiffness_lines_page(fitted),
        "a slope": make_stiffness_lines_page(replace(fitted, results=(*fitted.results, slope))),
        "slip not repaired": make_stiffness_lines_page(marked),
        "plateau": make_stiffness_lines_page(replace(kinked, results=(KINK, PLATEAU))),
        "a kink": make_stiffness_lines_page(kinked),
        "no branch": make_stiffness_lines_page(replace(fitted, curve=None)),
        "timeline": make_timeline_page(result),
        "two events": make_timeline_page(replace(result, aligned=aligned[0])),
        "one clock": make_timeline_page(replace(result, aligned=aligned[1])),
        "no motion": make_timeline_page(bare),
        "moments": make_moment_curvature_page(bent),
        "no law": make_moment_curvature_page(replace(bent, bending=lawless)),
        "no moments": make_moment_curvature_page(replace(bent, bending=None)),
    }
    approved(all_words(pages))


MODULUS, AREA, GAUGE = 200e9, 20e-6, 25e-3
YIELD, HARDENING = 400e6, 1e9


@pytest.fixture(scope="module")
def pulled(result: TestResult, repository: Path) -> TestResult:
    """A bilinear pull to 10 % with 0.1 mm of toe, by the shipped protocol."""
    assert result.curve is not None
    branch = result.curve.branches[0]
    strain = np.linspace(0.0, 0.1, len(result.curve.force) - branch.start)
    stress = np.minimum(MODULUS * strain, YIELD + HARDENING * (strain - YIELD / MODULUS))
    zeros = np.zeros(branch.start)
    curve = replace(
        result.curve,
        displacement=np.concatenate([zeros, GAUGE * strain + 1e-4]),
        force=np.concatenate([zeros, AREA * stress]),
        branches=(replace(branch, stop=len(result.curve.force)),),
    )
    slope, level = MODULUS * AREA / GAUGE, 0.5 * AREA * YIELD
    start = 1e-4 + level / slope
    proofs = {
        f"proof_stress_{offset}": (YIELD + HARDENING * plastic) / (1.0 - HARDENING / MODULUS)
        for offset, plastic in (("0_2", 0.002 - YIELD / MODULUS), ("1", 0.01 - YIELD / MODULUS))
    }
    values = {"elastic_modulus": MODULUS, "tensile_strength": float(stress[-1]), **proofs}
    results = [Result(name, value, "Pa", Interval(0.9 * value, 1.1 * value))
               for name, value in values.items()]  # fmt: skip
    results.append(Result("elongation_at_maximum_force", 0.1, "1", Interval(0.09, 0.11)))
    results.append(Result("elongation_at_break", 0.1, "1", Interval(0.09, 0.11)))
    protocol = (repository / "protocols" / "iso-6892.yaml").read_text(encoding="utf-8")
    sizes = "{gauge_length: 25 mm, section: {area: 20 mm^2}}"
    return replace(
        result,
        curve=curve,
        lines=(FittedLine("elastic_modulus", slope, level, start, start + 1e-4),),
        results=tuple(results),
        display={"pressure": "MPa", "strain": "%"},
        protocol_yaml=f"{protocol}\nspecimen: {sizes}\n",
    )


def test_stress_over_strain_with_its_numbers(pulled: TestResult, approved: Approve) -> None:
    """Strain is counted from the toe; each number is on the curve or on its offset line."""
    whole, beginning = make_stress_strain_page(pulled).plots
    curve, *numbers, elongation = whole.lines
    stress = np.interp([0.001, 0.05], curve.x, curve.y)
    np.testing.assert_allclose(stress, [MODULUS * 1e-3, YIELD + HARDENING * 0.048], rtol=1e-3)
    points = {line.settings["label"].split()[0]: (line.x[0], line.y[0]) for line in numbers}
    for symbol, offset in (("Rp0.2", 0.002), ("Rp1", 0.01)):
        strain, height = points[symbol]
        assert height == pytest.approx(MODULUS * (strain - offset))
        assert height == pytest.approx(YIELD + HARDENING * (strain - YIELD / MODULUS))
    assert points["Rm"] == points["At"] == pytest.approx((0.1, YIELD + HARDENING * 0.098))
    assert elongation.x[0] == 0.1
    (window,) = (line for line in beginning.lines if line.look == "fit_window")
    np.testing.assert_allclose(window.y, MODULUS * window.x)
    assert window.x[0] == pytest.approx(0.5 * YIELD / MODULUS)
    no_line = replace(pulled, lines=())
    no_area = replace(pulled, protocol_yaml=pulled.protocol_yaml.replace("area: 20 mm^2", ""))
    pages = {"tension": pulled, "no elastic line": no_line, "no area": no_area}
    approved(all_words({name: make_stress_strain_page(test) for name, test in pages.items()}))


def test_rows_are_the_markers_and_spans_their_flags(result: TestResult) -> None:
    plot = make_flag_plot(result, Axis())
    assert result.shape is not None
    assert plot.y.row_names == tuple(f"wire:Marker{number}" for number in range(1, 9))
    flags = result.shape.flags[:, 5]  # Marker5: missing for a while
    (missing,) = (line for line in plot.lines if line.settings["label"] == "missing")
    times = result.shape.time[flags == PointFlag.MISSING]
    # a column is 1/900 of the time drawn
    ends = [np.nanmin(missing.x), np.nanmax(missing.x)]
    assert ends == pytest.approx([times[0], times[-1]], abs=0.07)
    assert np.nanmin(missing.y) == pytest.approx(-4 - 0.36)


def test_steps_are_equal_round_and_of_the_first_loading(result: TestResult) -> None:
    assert result.shape is not None
    assert result.curve is not None
    drawn = choose_shape_frames(result, result.shape)
    np.testing.assert_allclose(drawn.deflections, np.arange(6) * 0.01, atol=1e-12)
    reached = result.curve.displacement[drawn.frames]
    # the first frame at or beyond the level: within one frame of travel, 0.05 m / 4 s / 50 Hz
    assert (reached >= drawn.deflections - 1e-12).all()
    assert (reached - drawn.deflections < 2.6e-4).all()
    assert result.shape.time[drawn.frames].max() <= result.curve.branches[0].stop_time
    assert drawn.deflection_name == "tip deflection"


def test_words_of_markers(result: TestResult, approved: Approve) -> None:
    assert result.shape is not None
    measured = np.full_like(result.shape.flags, PointFlag.MEASURED)
    take = result.recordings["markers"]
    assert take.markers is not None
    bodiless = replace(take, markers=replace(take.markers, bodies=()))
    nowhere = replace(
        result.shape,
        positions=np.full_like(result.shape.positions, np.nan),
        flags=np.zeros_like(result.shape.flags),
        coefficients=np.empty((len(result.shape.time), 3, 0)),
    )
    all_seen = replace(result, shape=replace(result.shape, flags=measured))
    pages = {
        "quality": make_marker_quality_page(result),
        "all seen": make_marker_quality_page(all_seen),
        "no bodies": make_marker_quality_page(replace(result, recordings={"markers": bodiless})),
        "shapes": make_wire_shapes_page(result),
        "no take": make_marker_quality_page(replace(result, shape=None, recordings={})),
        "free take": make_wire_shapes_page(replace(result, curve=None)),
        "nothing seen": make_wire_shapes_page(replace(result, shape=nowhere, curve=None)),
        "no shape": make_wire_shapes_page(replace(result, shape=None)),
    }
    approved(all_words(pages))
