"""Truths of curves that are known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.virtual_lab.bundles import TAPED_TYPES
from labpipe.virtual_lab.cantilever_path import solve_path
from labpipe.virtual_lab.cantilever_scenarios import taped_scenario
from labpipe.virtual_lab.curve_truth import evaluate_loading, evaluate_taped, find_kink, line_slope

GRID = np.linspace(0.0, 0.05, 50_001)


def three_lines(kink: float = 0.002, plateau: float = 0.035) -> np.ndarray:
    """300 N/m, then 60, then 3."""
    force = 300.0 * GRID - 240.0 * np.maximum(GRID - kink, 0.0)
    return np.asarray(force - 57.0 * np.maximum(GRID - plateau, 0.0))


def test_two_lines_are_found_where_they_join() -> None:
    kink = find_kink(GRID, three_lines(), 0.2e-3, 5e-3)
    assert kink.displacement == pytest.approx(0.002, abs=1e-7)
    assert kink.force == pytest.approx(0.6, abs=1e-5)
    assert kink.stiffness_before == pytest.approx(300.0, rel=1e-4)
    assert kink.stiffness_after == pytest.approx(60.0, rel=1e-4)


def test_the_break_is_the_best_of_all() -> None:
    """Of a curve without a corner: no break near it fits better by plain least squares."""
    force = 2.0 * np.tanh(GRID / 0.002)
    grid = np.linspace(0.2e-3, 5e-3, 800)
    wanted = np.interp(grid, GRID, force)

    def misfit(at: float) -> float:
        basis = np.column_stack([np.ones_like(grid), grid, np.maximum(grid - at, 0.0)])
        return float(np.linalg.lstsq(basis, wanted, rcond=None)[1][0])

    found = find_kink(GRID, force, 0.2e-3, 5e-3).displacement
    others = [misfit(found + step) for step in (-1e-4, -1e-5, 1e-5, 1e-4)]
    assert misfit(found) < min(others)


def test_numbers_of_a_loading() -> None:
    truth = evaluate_loading(GRID, three_lines())
    assert truth.tangent_at_zero == pytest.approx(300.0)
    assert truth.secant_stiffness == pytest.approx((0.6 + 0.003 * 60.0) / 0.005)
    assert truth.end_tangent == pytest.approx(3.0)
    assert truth.end_slope == pytest.approx(3.0 / truth.windowed_stiffness)
    assert truth.plateau_displacement == pytest.approx(0.035, abs=0.5e-3)
    line = np.polyfit(GRID[:5001], three_lines()[:5001], 1)[0]
    assert truth.stiffness == pytest.approx(line, rel=1e-3)
    assert line_slope(GRID, 7.0 * GRID, 0.001, 0.002) == pytest.approx(7.0)


def test_no_plateau_where_the_curve_goes_on() -> None:
    truth = evaluate_loading(GRID, three_lines(plateau=1.0))
    assert truth.plateau_displacement is None
    assert truth.plateau_force is None
    assert truth.end_slope > 0.3


def test_scaled_truths_are_truths_of_scaled_curves() -> None:
    scaled = evaluate_loading(GRID, three_lines()).scaled(1.3)
    other = evaluate_loading(GRID, 1.3 * three_lines())
    assert scaled.kink.force == pytest.approx(other.kink.force, rel=1e-9)
    assert scaled.plateau_displacement == pytest.approx(other.plateau_displacement, rel=1e-9)
    assert scaled.plateau_force == pytest.approx(other.plateau_force, rel=1e-9)
    assert scaled.end_slope == pytest.approx(other.end_slope, rel=1e-9)
    assert scaled.windowed_stiffness == pytest.approx(other.windowed_stiffness, rel=1e-9)
    assert evaluate_loading(GRID, three_lines(plateau=1.0)).scaled(1.3).plateau_force is None


def test_a_bundle_in_the_rig() -> None:
    bundle = TAPED_TYPES["TWB-B1-19-PVC"]
    test = taped_scenario("TWB-B1-19-PVC", cycles=2).mechanics
    truth = evaluate_taped(solve_path(test))
    # A straight elastic beam: 3 EI / L^3; the counterweight's string adds next to nothing.
    linear = 3.0 * bundle.law().stiffness / test.length**3
    assert truth.loading.tangent_at_zero == pytest.approx(linear, rel=0.01)
    assert 1.5e-3 < truth.loading.kink.displacement < 2.5e-3
    plateau = truth.loading.plateau_displacement
    assert plateau is not None
    assert 0.033 < plateau < 0.037
    windowed = truth.loading.windowed_stiffness
    assert truth.bending_stiffness == pytest.approx(windowed * test.length**3 / 3.0)
    assert truth.loading_stiffness[0] == pytest.approx(truth.loading.stiffness, rel=1e-3)
    assert truth.hardening[0] == 1.0
    assert truth.hardening[1] > 1.3
