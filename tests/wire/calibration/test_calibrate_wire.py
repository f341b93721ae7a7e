"""Calibration end to end, in memory: what it finds, what it says of itself, what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.mechanics.wire.bending_law import Contacts, make_contacts
from labpipe.mechanics.wire.calibration.calibrate_wire import calibrate
from labpipe.mechanics.wire.calibration.law_components import split_law
from labpipe.mechanics.wire.calibration.measured_curves import MeasuredCurve
from labpipe.mechanics.wire.calibration.objective import (
    SEARCH_RANGES,
    Settings,
    Wire,
    set_up_problem,
)
from labpipe.mechanics.wire.cross_section import Layer, place_rings
from labpipe.records.wire import (
    COPPER_SCALE,
    INSULATION_MODULUS,
    PARAMETERS,
    RADIAL_FRICTION,
    Calibration,
    CalibrationFailure,
    Identifiability,
    ParameterChoice,
)
from tests.approved import Approve
from tests.builders.loading_tests import TRUTH, measured, section_of, wire_of
from tests.builders.stranded_wires import tube

WIRE = wire_of("A2")

THREE = measured(lengths=(0.085, 0.12), samples=2, n=120, seed=8)

FIXED = ParameterChoice(is_fixed=True)


def calibrated(
    curves: tuple[MeasuredCurve, ...], settings: Settings | None = None, wire: Wire = WIRE
) -> Calibration:
    found = calibrate(wire, curves, settings)
    assert isinstance(found, Calibration), found
    return found


def codes(calibration: Calibration) -> list[str]:
    return [note.code for note in calibration.notes]


@pytest.fixture(scope="module")
def usual() -> Calibration:
    return calibrated(THREE, Settings(gain=0.005))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bound", "choice"),
    [
        ("lower", ParameterChoice(1.3e9, lower=1.2e9)),
        ("upper", ParameterChoice(0.7e9, upper=0.8e9)),
    ],
)
def test_a_parameter_at_its_bound(bound: str, choice: ParameterChoice) -> None:
    calibration = calibrated(THREE, Settings({"insulation_modulus": choice}, gain=0.005))
    modulus = calibration.get_parameter("insulation_modulus")
    assert modulus.at_bound == bound
    assert modulus.verdict is Identifiability.AT_BOUND
    assert "at_bound" in codes(calibration)


@pytest.mark.slow
def test_what_is_identified_is_so_at_99_per_cent() -> None:
    """An interval that noise ended just early enough is not knowledge."""
    calibration = calibrated(measured(seed=4, n=90), Settings(gain=0.005))
    copper = calibration.get_parameter("copper_scale")
    modulus = calibration.get_parameter("insulation_modulus")
    (part,) = copper.intervals
    assert 1.7 < part.upper / part.lower < 1.8
    assert copper.verdict is Identifiability.WEAKLY_IDENTIFIED
    assert ", and at 99 % between 0.66" in copper.explanation
    assert modulus.verdict is Identifiability.IDENTIFIED
    assert "99 %" not in modulus.explanation


def test_one_sample_speaks_of_itself() -> None:
    choices = {"copper_scale": FIXED}
    alone = calibrated(THREE[:1], Settings(choices, gain=0.005))
    assert "one_sample" in codes(alone)
    assert alone.levels.scatter_freedom == 0.0
    given = calibrated(THREE[:1], Settings(choices, gain=0.005, scatter=0.03))
    assert "one_sample" not in codes(given)
    assert given.levels.scatter_freedom == np.inf
    wider, narrow = (c.get_parameter("insulation_modulus").log_error for c in (given, alone))
    assert wider > narrow


@pytest.mark.slow
def test_noise_that_was_misstated(usual: Calibration) -> None:
    understated = tuple(replace(curve, noise=0.0005) for curve in THREE)
    calibration = calibrated(understated, Settings(gain=0.005))
    assert "noise_misstated" in codes(calibration)
    assert calibration.levels.noise_factor == pytest.approx(4.0, rel=0.1)
    one, two = (c.get_parameter("radial_friction").interval for c in (calibration, usual))
    assert one is not None
    assert two is not None
    assert one.upper == pytest.approx(two.upper, rel=0.02)


PARTS = split_law(WIRE.section, WIRE.contacts)

CURVES = measured(n=20)


def test_residuals_and_searches_that_are_doubted(monkeypatch: pytest.MonkeyPatch) -> None:
    curves = measured(n=200, samples=2, seed=9, correlation=0.9)
    slow = calibrated(curves, Settings({"copper_scale": FIXED}, gain=0.005))
    assert "residuals_correlated" in codes(slow)
    assert slow.levels.correlation == pytest.approx(0.9, abs=0.06)
    monkeypatch.setattr("labpipe.mechanics.wire.calibration.objective._MAX_SEARCH_STEPS", 0)
    choices = {"copper_scale": FIXED, "insulation_modulus": ParameterChoice(3e9)}
    assert "search_unsettled" in codes(calibrated(THREE[:1], Settings(choices, scatter=0.03)))


def test_a_model_that_cannot_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "labpipe.mechanics.wire.calibration.measured_curves.MAX_DEFLECTION_RATIO", 0.95
    )
    deep = replace(THREE[0], length=0.055, rig=None)
    failure = calibrate(WIRE, (deep,), Settings({"copper_scale": FIXED}))
    assert isinstance(failure, CalibrationFailure)
    assert failure.code == "model_cannot_follow"
    assert "deflection=0.05 m: the curve begins at rest and ends at 0.0385" in failure.message


STRAND = split_law(place_rings((Layer(1, 0.5e-3),)), Contacts((), ()))


def test_starts_and_priors() -> None:
    """At the wire's own numbers; without radial force at a usual one; what does not act is held."""
    smooth = make_contacts(1, strand=0.2, insulation=0.1, radial_force=0.0)
    unpressed = split_law(section_of("A2"), smooth)
    for parts, starts, free in (
        (PARTS, TRUTH, [True, True, True]),
        (unpressed, [0.05, *TRUTH[1:]], [True, True, True]),
        (STRAND, [np.nan, np.nan, 1.0], [False, False, True]),
    ):
        posed = set_up_problem(parts, CURVES, Settings(gain=0.01))
        assert not isinstance(posed, CalibrationFailure)
        problem, logs = posed
        assert problem.is_free.tolist() == free
        assert np.exp(logs)[free] == pytest.approx(np.array(starts)[free])
        assert not problem.prior_precision.any()
        assert np.exp(problem.upper[2]) == pytest.approx(SEARCH_RANGES[COPPER_SCALE][2])
        assert problem.sample_index.tolist() == [0, 1, 2]
    friction, copper = ParameterChoice(0.08, is_fixed=True), ParameterChoice(1.2, factor=1.5)
    choices = {RADIAL_FRICTION: friction, COPPER_SCALE: copper}
    posed = set_up_problem(PARTS, CURVES, Settings(choices, 0.01))
    assert not isinstance(posed, CalibrationFailure)
    problem, logs = posed
    assert problem.is_free.tolist() == [False, True, True]
    assert np.exp(logs) == pytest.approx([0.08, 1e9, 1.2])
    assert problem.lower[0] == problem.upper[0] == logs[0]
    assert problem.prior_centre[2] == logs[2]
    assert problem.prior_precision[2] == pytest.approx((1.959964 / np.log(1.5)) ** 2, rel=1e-6)


def test_what_is_refused(approved: Approve) -> None:
    failures = [
        set_up_problem(STRAND, CURVES, Settings({INSULATION_MODULUS: ParameterChoice()})),
        set_up_problem(PARTS, CURVES, Settings({COPPER_SCALE: ParameterChoice(1.0, lower=1.2)})),
        calibrate(WIRE, measured(n=2)),
        calibrate(WIRE, (THREE[1], replace(THREE[0], wire="A3"))),
        calibrate(WIRE, ()),
    ]
    assert all(isinstance(failure, CalibrationFailure) for failure in failures)
    approved(f"{failure.code}: {failure.message}" for failure in failures)  # type: ignore[union-attr]


def test_the_fit_of_usual_tests(usual: Calibration) -> None:
    assert usual.wire == "A2"
    assert (usual.n_points, usual.n_samples, len(usual.curves)) == (480, 4, 4)
    assert usual.sse == pytest.approx(sum(curve.sse for curve in usual.curves))
    assert usual.rmse == pytest.approx(np.sqrt(usual.sse / 480))
    assert usual.rmse_share == pytest.approx(usual.rmse / max(curve.peak for curve in THREE))
    assert np.diag(usual.correlations) == pytest.approx(np.ones(3))
    assert usual.levels.noise_factor == pytest.approx(1.0, abs=0.1)
    assert usual.levels.gain == 0.005
    assert usual.levels.scatter_freedom < 10.0
    assert usual.levels.noise_freedom > 400.0
    assert set(codes(usual)) <= {"not_identified"}
    for parameter, truth in zip(usual.parameters, TRUTH, strict=True):
        assert parameter.interval is not None
        assert parameter.interval.lower < parameter.value < parameter.interval.upper
        assert abs(np.log(parameter.value / truth)) < 4.0 * parameter.log_error
        assert parameter.profiles[0].deviance.min() == 0.0
    assert usual.get_parameter("insulation_modulus").verdict is Identifiability.IDENTIFIED
    friction = usual.get_parameter("radial_friction").verdict
    assert friction in {Identifiability.WEAKLY_IDENTIFIED, Identifiability.NOT_IDENTIFIED}
    assert all(usual.separability.are_identified.values())


def test_without_noise_the_truth_is_found() -> None:
    exact = measured(noise=1e-5, scatter=0.0, gain=0.0, n=60)
    quiet = calibrated(exact, Settings(scatter=0.0))
    assert np.abs(np.log(quiet.solutions[0].values / TRUTH)).max() < 0.02
    assert quiet.levels.scatter_freedom == np.inf


@pytest.mark.parametrize(("centre", "factor", "contradicts"), [(1.6, 1.05, True), (1, 1.02, False)])
def test_a_prior_that_contradicts_and_one_that_says_most(
    centre: float, factor: float, contradicts: bool
) -> None:
    choice = ParameterChoice(centre, factor=factor)
    calibration = calibrated(THREE, Settings({"copper_scale": choice}, gain=0.005))
    copper = calibration.get_parameter("copper_scale")
    assert copper.conflict is not None
    assert copper.conflict.contradicts == contradicts
    assert copper.conflict.estimate == pytest.approx(1.0, abs=0.25)
    assert (copper.verdict is Identifiability.BY_PRIOR) != contradicts
    assert ("prior_contradicts_data" in codes(calibration)) == contradicts


def test_everything_held() -> None:
    fixed = calibrated(THREE, Settings(dict.fromkeys(PARAMETERS, FIXED)))
    assert [parameter.interval for parameter in fixed.parameters] == [None] * 3
    assert {parameter.verdict for parameter in fixed.parameters} == {Identifiability.FIXED}
    assert not fixed.solutions[0].covariance.any()
    assert np.isnan(fixed.correlations).all()
    assert fixed.rmse < 0.02


def test_a_friction_that_is_not_identified_and_one_that_does_not_act() -> None:
    noisy = measured(n=30, noise=0.04, seed=4)
    calibration = calibrated(noisy, Settings({"copper_scale": FIXED}, gain=0.005))
    friction = calibration.get_parameter("radial_friction")
    assert friction.at_bound == ""
    assert friction.verdict is Identifiability.NOT_IDENTIFIED
    assert friction.is_open_below
    assert "not_identified" in codes(calibration)
    strand = Wire(place_rings((Layer(1, 0.9e-3),), tube(1.6e-3)), Contacts((), ()))
    without = calibrated(THREE[:2], Settings({"copper_scale": FIXED}, gain=0.005), strand)
    friction = without.get_parameter("radial_friction")
    assert np.isnan(friction.value)
    assert friction.explanation == "phi = F_rad (mu_s + mu_p) does not act on this wire"
