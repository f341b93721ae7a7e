"""Tensile tests: the force at every instant, the truth, what the controller writes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from labpipe.virtual_lab import observe, simulate_test
from labpipe.virtual_lab.tensile import (
    FrameInstruments,
    GripSlip,
    TensileScenario,
    build_corrugated_tube,
    build_pet_tape,
    build_twist_tube,
)


def test_slip_goes_on_parallel_and_lower() -> None:
    tube = build_corrugated_tube("CT-10-slit-1")
    slips = (GripSlip(18.75e-3, 0.47, 0.05), GripSlip(30.85e-3, 0.81, 0.1))
    whole, slipped = tube, replace(tube, slips=slips)
    time = np.linspace(0.0, whole.loading_time, 100_001)
    lost = whole.compute_force(time) - slipped.compute_force(time)
    displacement = whole.compute_displacement(time)
    np.testing.assert_allclose(lost[displacement < 18.75e-3], 0.0, atol=1e-12)
    between = (displacement > 18.75e-3 + 0.051 * 0.423e-3) & (displacement < 30.85e-3)
    np.testing.assert_allclose(lost[between], 0.47, atol=1e-12)
    np.testing.assert_allclose(lost[displacement > 30.85e-3 + 0.101 * 0.423e-3], 1.28, atol=1e-12)


def test_failure_takes_its_time_and_leaves_fibres() -> None:
    path = build_pet_tape("1", failure_displacement=60e-3)
    first, second, third = path.compute_force(path.loading_time + np.array([-1e-9, 0.15, 2.3]))
    at_failure = path.compute_force(np.array([path.loading_time]))[0]
    assert first == pytest.approx(at_failure, rel=1e-6)
    assert second == pytest.approx(0.06 * at_failure * np.exp(-0.15 / 1.2))
    assert 0.0 < third < 0.01 * at_failure
    period = path.compute_force(path.loading_time + np.linspace(0.0, 2.3, 500))
    assert np.all(np.diff(period) < 0.0)


def test_unloading_starts_at_the_peak_with_the_first_stiffness_and_ends_slack() -> None:
    tube = build_corrugated_tube("CT-10-3")
    path = replace(tube, frame=replace(tube.frame, unloads=True))
    turn = path.loading_time + tube.frame.overrun
    time = np.linspace(turn, path.end_time, 20_001)
    force, displacement = path.compute_force(time), path.compute_displacement(time)
    assert force[0] == pytest.approx(path.compute_force(np.array([path.loading_time]))[0])
    assert displacement[-1] == pytest.approx(0.0, abs=1e-12)
    assert np.all(np.diff(force) <= 1e-12)
    slope = (force[0] - force[100]) / (displacement[0] - displacement[100])
    assert slope == pytest.approx(tube.law.stiffness_first, rel=1e-6)
    assert 5e-3 < displacement[np.argmax(force == 0.0)] < 30e-3
    assert force[-1] == 0.0


@pytest.mark.parametrize(
    ("scenario", "first", "second"),
    [
        (build_twist_tube("1a"), (2e-3, 8e-3), (10e-3, 20e-3)),
        (build_pet_tape("1"), (2e-3, 5.5e-3), (12e-3, 50e-3)),
        (build_corrugated_tube("CT-10-1"), (1e-3, 10e-3), (30e-3, 49e-3)),
    ],
    ids=lambda case: getattr(case, "name", ""),
)
def test_stiffness_and_break_point(
    scenario: TensileScenario, first: tuple[float, float], second: tuple[float, float]
) -> None:
    truth = observe(scenario, 1).truth
    lines = []
    for start, stop in (first, second):
        chosen = (truth["displacement"] > start) & (truth["displacement"] < stop)
        points = truth["displacement"][chosen], truth["force"][chosen]
        lines.append(np.polynomial.Polynomial.fit(*points, 1).convert())
    first_line, second_line = lines
    assert first_line.deriv()(0.0) == pytest.approx(truth["stiffness_first"], rel=1e-6)
    assert second_line.deriv()(0.0) == pytest.approx(truth["stiffness_second"], rel=1e-6)
    assert first_line.roots()[0] == pytest.approx(truth["foot"], abs=1e-9)
    assert (first_line - second_line).roots()[0] == pytest.approx(truth["break_point"], abs=1e-8)
    assert truth["break_point"] == pytest.approx(truth["foot"] + truth["break_point_from_foot"])
    assert first_line(truth["break_point"]) == pytest.approx(truth["break_force"], rel=1e-6)
    given_way = 1.0 / truth["specimen_stiffness_first"] + scenario.frame.compliance
    assert 1.0 / truth["stiffness_first"] == pytest.approx(given_way)


TUBE = replace(build_corrugated_tube("CT-10-slit-2"), slips=(GripSlip(18.75e-3, 0.47),))


def test_export_is_the_truth_with_small_errors(tmp_path: Path) -> None:
    folder = simulate_test(TUBE, tmp_path / "raw" / TUBE.name, 21)
    sheet = openpyxl.load_workbook(folder / "CT-10-slit-2.xlsx")["Test Data"]
    rows = list(sheet.iter_rows(min_row=6, values_only=True))
    time, force, displacement = np.array(rows, dtype=np.float64).T
    truth = observe(TUBE, 21).truth
    np.testing.assert_allclose(time, truth["time"], atol=1e-6)
    errors = 4.4482216152605 * force - truth["force"] - TUBE.instruments.tare
    assert np.std(errors) == pytest.approx(np.hypot(0.02, 0.03), rel=0.2)
    assert abs(np.mean(errors)) < 0.01
    travel = 25.4e-3 * displacement - TUBE.instruments.displacement_tare
    np.testing.assert_allclose(travel, truth["displacement"], atol=7e-6)


QUIET = FrameInstruments(rate=100.0, first_sample=0.0195)


@pytest.mark.parametrize("correlation_time", [0.02, 0.2])
def test_slow_noise_has_its_size_and_memory(correlation_time: float) -> None:
    instruments = replace(QUIET, slow_noise=0.3, correlation_time=correlation_time)
    time = np.linspace(0.0, 4000.0, 400_001)
    noise = instruments.draw_slow_noise(time, np.random.default_rng(3))
    effective = 4000.0 / (2.0 * correlation_time)  # samples as good as independent
    tolerance = 4.0 / np.sqrt(effective)
    assert np.std(noise) == pytest.approx(0.3, rel=tolerance)
    for lag in (1, 5, 20):
        correlation = np.corrcoef(noise[lag:], noise[:-lag])[0, 1]
        expected = np.exp(-0.01 * lag / correlation_time)
        assert correlation == pytest.approx(expected, abs=tolerance)


def test_a_test_without_samples_is_refused() -> None:
    with pytest.raises(ValueError, match=r"rate=100\.0: expected .*, found 2 in 0\.03 s"):
        QUIET.compute_sample_times(0.03)
