"""Truths of a three-point test, against its path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.virtual_lab.conduit_scenarios import conduit_scenario
from labpipe.virtual_lab.recorders import plan_conduit
from labpipe.virtual_lab.three_point_path import solve_three_point
from labpipe.virtual_lab.truth import ConduitTruth, evaluate_conduit

SCENARIO = replace(conduit_scenario("CWB-1"), factor=1.1)


@pytest.fixture(scope="module")
def truth() -> ConduitTruth:
    path = solve_three_point(SCENARIO.test)
    return evaluate_conduit(path, SCENARIO, plan_conduit(SCENARIO))


def test_stiffness_at_first_is_that_of_the_law(truth: ConduitTruth) -> None:
    assert truth.initial_bending_stiffness == pytest.approx(SCENARIO.bundle.law().stiffness)
    uncorrected = truth.loading.tangent_at_zero * SCENARIO.test.span**3 / 48.0
    assert uncorrected == pytest.approx(truth.initial_bending_stiffness, rel=0.05)
    windowed = truth.loading.windowed_stiffness * SCENARIO.test.span**3 / 48.0
    assert truth.bending_stiffness == pytest.approx(windowed)


def test_kink_and_plateau(truth: ConduitTruth) -> None:
    assert 0.5e-3 < truth.loading.kink.displacement < 2e-3
    assert truth.loading.end_slope < 0.1
    assert truth.loading.plateau_displacement is not None
    assert truth.loading.plateau_displacement < truth.peak_displacement


def test_peak_energy_and_what_is_left(truth: ConduitTruth) -> None:
    path = solve_three_point(SCENARIO.test)
    assert truth.peak_force == pytest.approx(1.1 * path.loading[-1].force, rel=1e-3)
    assert truth.residual_displacement == path.residual
    halves = [*path.loading, *path.unloading[1:]]
    work = np.trapezoid([h.force for h in halves], [h.displacement for h in halves])
    assert truth.energy == pytest.approx(1.1 * work, rel=2e-3)


def test_mid_span(truth: ConduitTruth) -> None:
    """Moment over curvature is that of the law; the rig's own moment is near it at first."""
    middle = truth.middle
    law = SCENARIO.bundle.law()
    corners = np.searchsorted(law.half_widths, middle.moment)
    assert corners > 0
    assert middle.bending_stiffness < truth.initial_bending_stiffness
    assert middle.bending_stiffness_of_force == pytest.approx(middle.bending_stiffness, rel=0.03)
    assert middle.moment > middle.moment_of_force
    assert np.max(truth.curvature) == pytest.approx(middle.curvature, rel=1e-2)
    assert np.max(truth.moment) == pytest.approx(middle.moment, rel=1e-2)
    assert np.max(truth.twist) == pytest.approx(SCENARIO.markers.twist, rel=1e-2)


def test_clocks(truth: ConduitTruth) -> None:
    assert truth.clocks["force_offset"] == pytest.approx(-6e-3, rel=1e-3)
    top = truth.time[np.argmax(truth.displacement)] - truth.clocks["marker_offset"]
    assert top == pytest.approx(truth.top_time, abs=0.2)
