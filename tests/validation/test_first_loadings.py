"""First loadings in memory: true by an independent way, noise as stated, scaling exact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from benchmarks.first_loadings import Loading, observe_loading
from labpipe.units import GRAVITY
from labpipe.virtual_lab.cantilever_path import solve_path
from labpipe.virtual_lab.cantilever_scenarios import (
    CantileverScenario,
    LoadCell,
    wire_scenario,
)
from labpipe.virtual_lab.specimens import WIRES
from labpipe.wire.cantilever import StringRig
from labpipe.wire.first_loading import load_cantilever
from tests.builders.bilinear_laws import law_of_plays

pytestmark = pytest.mark.slow

WEIGHT = 0.0027 * GRAVITY


def scenario(name: str = "A3", factor: float = 1.0) -> CantileverScenario:
    return replace(
        CantileverScenario(),
        mechanics=wire_scenario(WIRES[name].scaled(factor), 0.085).mechanics,
        load_cell=LoadCell(gain_error=0.01, noise=1e-3),
    )


@pytest.fixture(scope="module")
def loading() -> Loading:
    return observe_loading(scenario(), 3, n_points=4000)


@pytest.mark.parametrize("name", ["A3", "B1"])
def test_the_true_curve_is_that_of_the_first_integral(name: str) -> None:
    """One goes station by station with a history, the other all at once without any."""
    test = scenario(name)
    found = observe_loading(replace(test, mechanics=replace(test.mechanics, weighs=False)), 1)
    law = replace(WIRES[name], n_plays=240).law()
    largest = 1.2 * 0.085 * float(found.true_force[-1])
    rig = StringRig(0.76, WEIGHT, 0.085, 0.76)
    curve = load_cantilever(law_of_plays(law, largest, n_points=160), 0.085, rig)
    wanted = CubicSpline(curve.deflection, curve.force)(found.true_deflection)
    assert found.true_force == pytest.approx(wanted, rel=2e-4, abs=2e-5)


@pytest.mark.parametrize(("weighs", "accuracy"), [(False, 1e-7), (True, 1e-6)])
def test_a_sample_is_interpolated_exactly(*, weighs: bool, accuracy: float) -> None:
    """With weight less so: where the strands already slip at rest changes with the factor."""
    made = scenario(factor=1.1)
    test = replace(made.mechanics, weighs=weighs)
    found = observe_loading(replace(made, mechanics=test), 1)
    path = solve_path(replace(test, cycles=1))
    force = path.tension(found.travel) - path.rest.tension
    assert found.true_force == pytest.approx(force, abs=accuracy)
    assert found.true_deflection == pytest.approx(path.deflection(found.travel), abs=1e-9)


def test_noise_and_gain(loading: Loading) -> None:
    noise = loading.force * 1.01 - loading.true_force
    assert np.std(noise) == pytest.approx(1e-3, rel=0.05)
    assert abs(np.mean(noise)) < 6e-5
    assert np.std(loading.deflection - loading.true_deflection) == pytest.approx(3e-5, rel=0.05)
    assert loading.travel[-1] == 0.053
    quiet = observe_loading(scenario(), 3, noise=0.0)
    assert quiet.force == pytest.approx(quiet.true_force / 1.01)


def test_seeds(loading: Loading) -> None:
    again = observe_loading(scenario(), 3, n_points=4000)
    np.testing.assert_array_equal(again.force, loading.force)
    assert not np.array_equal(observe_loading(scenario(), 4, n_points=4000).force, loading.force)


def test_a_gain_of_its_own_is_drawn() -> None:
    usual = scenario()
    drawn = replace(usual, load_cell=LoadCell(gain_uncertainty=0.1, noise=0.0))
    ratios = []
    for seed in range(60):
        found = observe_loading(drawn, seed, n_points=3)
        ratios.append(found.true_force[-1] / found.force[-1] - 1.0)
    assert np.std(ratios) == pytest.approx(0.1, rel=0.3)


def test_what_does_not_scale_is_refused() -> None:
    usual = scenario()
    with pytest.raises(ValueError, match=r"wire=WireModel, slack=0.0015: allowed are a Stranded"):
        observe_loading(CantileverScenario(), 1)
    slack = replace(usual, mechanics=replace(usual.mechanics, slack=0.001))
    with pytest.raises(
        ValueError, match=r"slack=0.001: allowed are a StrandedWire or a BundleModel, and None"
    ):
        observe_loading(slack, 1)
    with pytest.raises(ValueError, match=r"factor=1.3: allowed are numbers from 0.8 to 1.25"):
        observe_loading(scenario(factor=1.3), 1)
