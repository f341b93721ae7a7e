from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.wire_calibration import CalibrationFailure, ParameterChoice
from labpipe.wire.calibration.fit import Found, Settings, find
from labpipe.wire.calibration.profile_likelihood import _root, reach, traces
from labpipe.wire.calibration.scatter_mixture import quantiles
from tests.builders.loading_tests import measured, wire_of

FIXED = ParameterChoice(is_fixed=True)


def found_of(settings: Settings, **more: float) -> Found:
    found = find(wire_of("A2"), measured(seed=4, n=90, **more), settings)  # type: ignore[arg-type]
    assert not isinstance(found, CalibrationFailure)
    return found


def test_the_quantiles_where_the_model_is_linear() -> None:
    choices = {"radial_friction": FIXED, "copper_scale": FIXED}
    found = found_of(Settings(choices))
    (traced,) = traces(found, 1)
    low, high = quantiles(found.mixture, np.eye(4)[[1]])
    best, half = float(found.fit.point.logs[1]), 0.5 * float(high[0] - low[0])
    assert traced.lower == pytest.approx(best + low[0], abs=0.03 * half)
    assert traced.upper == pytest.approx(best + high[0], abs=0.03 * half)
    assert not traced.is_open_below
    assert not traced.is_open_above


def test_the_deviance_rises_on_both_sides() -> None:
    (traced,) = traces(found_of(Settings(gain=0.005)), 0)
    best = int(np.argmin(traced.deviance))
    assert traced.deviance[best] == 0.0
    assert np.all(np.diff(traced.deviance[: best + 1]) < 0.0)
    assert np.all(np.diff(traced.deviance[best:]) > 0.0)
    ends = np.interp([traced.lower, traced.upper], traced.logs, np.sqrt(traced.deviance))
    assert ends**2 == pytest.approx([traced.threshold_below, traced.threshold_above], rel=0.04)


def test_along_the_line_of_the_leasts_the_copper_reaches_as_far_as_its_profile() -> None:
    """The line is that profile, in strides."""
    found = found_of(Settings(gain=0.005))
    (traced,) = traces(found, 2)
    assert reach(found, 2, 1.0) == pytest.approx((traced.lower, traced.upper), abs=0.01)
    (higher,) = traces(found, 2, unlikely=1.727)
    assert reach(found, 2, 1.727) == pytest.approx((higher.lower, higher.upper), abs=0.01)
    assert higher.threshold_above == pytest.approx(1.727 * traced.threshold_above)
    assert higher.lower < traced.lower < traced.upper < higher.upper
    low, high = reach(found, 1, 1.0)  # the insulation gives as the copper is held
    (modulus,) = traces(found, 1)
    assert low == pytest.approx(modulus.lower, abs=0.02)
    assert high == pytest.approx(modulus.upper, abs=0.02)


def test_one_that_is_held_has_no_line() -> None:
    found = found_of(Settings({"copper_scale": FIXED}))
    assert reach(found, 1, 1.727) == (found.fit.point.logs[1],) * 2


def test_open_where_the_objective_levels_out() -> None:
    """Twenty times the noise: friction may as well be nothing."""
    noisy = found_of(Settings(gain=0.005), noise=0.04)
    (traced,) = traces(noisy, 0)
    assert traced.is_open_below
    assert traced.lower == noisy.problem.lower[0]
    assert traced.deviance[0] < traced.threshold_below


def test_a_walk_that_is_cut_short_ends_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    from labpipe.wire.calibration import profile_likelihood as profiles

    found = found_of(Settings(gain=0.005))
    (whole,) = traces(found, 0)
    monkeypatch.setattr(profiles, "_MOST_LOOKS", 1)
    (short,) = traces(found, 0)
    assert short.lower <= whole.lower + 0.01
    assert short.upper >= whole.upper - 0.01


def test_one_parameter_and_nothing_else() -> None:
    choices = {"radial_friction": FIXED, "copper_scale": FIXED}
    (traced,) = traces(found_of(Settings(choices, scatter=0.0)), 1)
    assert traced.lower < np.log(1e9) + 0.1
    assert traced.upper > np.log(1e9) - 0.1
    assert traced.threshold_above == pytest.approx(1.96**2, rel=0.03)


@pytest.mark.parametrize(
    ("quantile", "error", "root"), [(3.6, 1.5, 2.4), (0.1, 1.0, 1.96), (7.0, 0.0, 1.96)]
)
def test_how_high_the_objective_is_followed(quantile: float, error: float, root: float) -> None:
    """Quantile in standard errors, never less than the normal one."""
    assert _root(quantile, error) == root


def test_where_no_look_is_close_enough_the_end_is_taken_a_little_too_far_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = found_of(Settings({"radial_friction": FIXED, "copper_scale": FIXED}))
    (usual,) = traces(found, 1)
    monkeypatch.setattr("labpipe.wire.calibration.profile_likelihood._CLOSE", 0.0)
    (finest,) = traces(found, 1)
    half = 0.5 * (usual.upper - usual.lower)
    assert finest.upper == pytest.approx(usual.upper, abs=0.03 * half)
    assert finest.lower == pytest.approx(usual.lower, abs=0.03 * half)
