"""The isotropic share from what cycles leave: A2, truths of three shares, creep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from labpipe.mechanics.law.plays import PlayLaw
from labpipe.mechanics.wire.bending_law import fit_play_law
from labpipe.mechanics.wire.calibration import hardening
from labpipe.mechanics.wire.calibration.hardening import (
    COMPUTED_SHARES,
    CYCLE_MEASURES,
    ENERGY,
    RATIO,
    RESIDUAL,
    CycledTest,
    _unload_to_zero,
    calibrate_share,
    compute_cycles,
)
from labpipe.mechanics.wire.cantilever import StringRig, WireState, deflect, make_straight
from labpipe.records.arrays import Floats
from labpipe.records.wire import COPPER_SCALE, INSULATION_MODULUS, IsotropicShare
from labpipe.virtual_lab.specimens import WIRES

LENGTH, PEAK = 0.085, 0.05
NAMES = (INSULATION_MODULUS, COPPER_SCALE)
ERRORS = {RESIDUAL: 0.02, ENERGY: 0.02, RATIO: 0.005}
"""Relative standard errors of one test."""
SCATTER = 0.03
COVARIANCE = np.diag([0.1, 0.05]) ** 2


def law_at(changes: Mapping[str, float], share: float) -> PlayLaw:
    wire = WIRES["A2"]
    scaled = replace(
        wire,
        insulation_modulus=wire.insulation_modulus * np.exp(changes.get(INSULATION_MODULUS, 0.0)),
        copper_scale=wire.copper_scale * np.exp(changes.get(COPPER_SCALE, 0.0)),
    )
    section, contacts = scaled.build_section(), scaled.build_contacts()
    return fit_play_law(section, contacts, isotropic_share=share, largest_curvature=120.0)


@pytest.mark.parametrize(
    ("share", "residual", "energy", "ratio"),
    [
        (0.0, 5.05, 0.615, 1.000),
        (0.35, 8.46, 0.852, 1.023),
        (0.65, 11.50, 1.040, 1.040),
        (1.0, 15.18, 1.240, 1.053),
    ],
)
def test_cycles_of_a2(share: float, residual: float, energy: float, ratio: float) -> None:
    numbers = compute_cycles(law_at({}, share), LENGTH, PEAK)
    assert 1e3 * numbers[RESIDUAL] == pytest.approx(residual, rel=0.01)
    assert 1e3 * numbers[ENERGY] == pytest.approx(energy, rel=0.015)
    assert numbers[RATIO] == pytest.approx(ratio, abs=0.002)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_unloading_ends_without_a_force_and_makes_small_steps(share: float) -> None:
    """A line through two points on either side of zero finds it at once, as the law is smooth."""
    law = law_at({}, share)
    state = deflect(law, make_straight(law, 40), LENGTH, PEAK)
    path, end = _unload_to_zero(law, state, LENGTH, 0.0)
    deflections, forces = np.array(path).T
    assert (path[0], path[-1]) == ((PEAK, state.load), (end.travel, end.load))
    assert abs(end.load) <= 1e-5 * state.load
    assert np.all(forces[:-1] > forces[1:])
    assert np.all(np.diff(deflections) >= -PEAK / 8.0 * (1.0 + 1e-9))
    assert len(path) <= 14


def test_a_step_beyond_zero_is_made_again_to_the_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """A force that falls ever faster, to zero at 20 mm: 10 mN (1 - exp(-(d - 20 mm) / 10 mm))."""

    def unloaded(_: PlayLaw, state: WireState, length: float, deflection: float) -> WireState:
        load = -0.01 * np.expm1(-(deflection - 0.02) / 0.01)
        return replace(state, travel=deflection, load=float(load))

    monkeypatch.setattr(hardening, "deflect", unloaded)
    law = law_at({}, 0.0)
    path, end = _unload_to_zero(law, unloaded(law, make_straight(law, 40), 0.0, PEAK), LENGTH, 0.0)
    assert end.travel == pytest.approx(0.02, abs=2e-7)
    assert end.load >= -1e-5 * path[0][1]
    assert len(path) <= 14


def test_on_a_string_the_counterweight_bends_the_wire_back() -> None:
    rig = StringRig(0.76, 0.0027 * 9.80665, LENGTH, 0.76)
    free, held = (compute_cycles(law_at({}, 0.65), LENGTH, PEAK, rig=rig) for rig in (None, rig))
    assert held[RESIDUAL] == pytest.approx(free[RESIDUAL], rel=0.01)
    assert held[ENERGY] > 1.05 * free[ENERGY]
    assert held[RATIO] > free[RATIO] + 0.01


@pytest.mark.parametrize("rig", [None, StringRig(0.76, 0.0265, LENGTH, 0.76)])
def test_the_weight_of_a_short_wire_hardly_matters_as_the_force_is_zeroed(
    rig: StringRig | None,
) -> None:
    """A2 weighs 0.067 N/m and hangs 0.2 mm: forces are above that which holds it at rest."""
    law = law_at({}, 0.65)
    heavy = compute_cycles(law, LENGTH, PEAK, rig=rig, self_weight=0.067)
    assert heavy == pytest.approx(compute_cycles(law, LENGTH, PEAK, rig=rig), rel=2e-3)


_COMPUTE = hardening._compute_measures


@cache
def computed() -> tuple[Floats, Floats]:
    return _COMPUTE(CycledTest("", LENGTH, PEAK, {}), law_at, NAMES)


@pytest.fixture
def computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hardening, "_compute_measures", lambda *_: computed())


def measured(
    share: float, random: np.random.Generator, creep: float = 0.0
) -> Mapping[str, tuple[float, float]]:
    """A sample of a wire whose parameters are off by their covariance."""
    curves, changes = computed()
    log_changes = random.multivariate_normal(np.zeros(2), COVARIANCE)
    numbers = {}
    for number, name in enumerate(CYCLE_MEASURES):
        exact = np.polyval(np.polyfit(COMPUTED_SHARES, curves[:, number], 3), share)
        truth = float(exact + changes[:, number] @ log_changes)
        truth *= 1.0 + creep * (-0.1 if name == RATIO else 1.0)
        sample_error = 0.0 if name == RATIO else random.normal(0.0, SCATTER)
        value = truth * np.exp(sample_error) * (1.0 + random.normal(0.0, ERRORS[name]))
        numbers[name] = value, truth * ERRORS[name]
    return numbers


def calibrated(numbers: list[Mapping[str, tuple[float, float]]]) -> IsotropicShare | None:
    tests = [CycledTest(str(n), LENGTH, PEAK, measures) for n, measures in enumerate(numbers)]
    return calibrate_share(tests, law_at, NAMES, COVARIANCE, SCATTER)


@pytest.mark.usefixtures("computed_once")
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_intervals_hold_the_true_share(share: float) -> None:
    """One test of one sample: 200 wires, seed fixed before the first run."""
    random = np.random.default_rng(20261126)
    fits = [calibrated([measured(share, random)]) for _ in range(200)]
    values = [fit.value for fit in fits if fit is not None]
    covers = [fit.interval.lower <= share <= fit.interval.upper for fit in fits if fit is not None]
    assert np.mean(covers) >= 0.93
    assert np.std(values) <= 0.10
    assert np.mean([fit.is_creep for fit in fits if fit is not None]) <= 0.02


@pytest.mark.usefixtures("computed_once")
def test_creep_is_refused() -> None:
    random = np.random.default_rng(1)
    outcome = calibrated([measured(0.5, random, creep=0.3) for _ in range(3)])
    assert outcome is not None
    assert outcome.is_creep
    assert outcome.intervals[RESIDUAL].lower > outcome.intervals[RATIO].upper


@pytest.mark.usefixtures("computed_once")
def test_one_cycle_only_gives_a_wider_interval() -> None:
    random = np.random.default_rng(2)
    numbers = measured(0.5, random)
    by_all = calibrated([numbers])
    by_residual = calibrated([{RESIDUAL: numbers[RESIDUAL]}])
    assert by_all is not None
    assert by_residual is not None
    widths = [outcome.interval.upper - outcome.interval.lower for outcome in (by_all, by_residual)]
    assert widths[0] < widths[1]
    assert set(by_residual.intervals) == {RESIDUAL}
    assert calibrated([{}]) is None
