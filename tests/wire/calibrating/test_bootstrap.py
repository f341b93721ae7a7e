from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.calibration import (
    BootstrapCheck,
    Calibration,
    CalibrationFailure,
    ParameterChoice,
)
from labpipe.wire.calibrating.bootstrap import check_by_bootstrap
from labpipe.wire.calibration import Settings, calibrate
from tests.builders.loading_tests import measured, wire_of

WIRE = wire_of("A2")
SETTINGS = Settings({"insulation_modulus": ParameterChoice(factor=1.3)}, gain=0.005)


@pytest.mark.parametrize(
    ("draws", "close"), [(30, 0.8), pytest.param(400, 0.25, marks=pytest.mark.slow)]
)
def test_the_bootstrap_agrees_with_the_profile(draws: int, close: float) -> None:
    """Ends of both intervals, over the half width of the profile; fewer draws, rougher ends."""
    curves = measured(n=60, seed=6, noise=0.0005)
    checks = check_by_bootstrap(WIRE, curves, SETTINGS, draws=draws, seed=1)
    calibration = calibrate(WIRE, curves, SETTINGS)
    assert isinstance(calibration, Calibration)
    assert not isinstance(checks, CalibrationFailure)
    assert len(checks) == 3
    for check in checks:
        profile = calibration.parameter(check.name).interval
        assert profile is not None
        assert check.interval is not None
        half = 0.5 * np.log(profile.upper / profile.lower)
        assert np.log(check.interval.upper / profile.upper) == pytest.approx(0.0, abs=close * half)
        assert np.log(check.interval.lower / profile.lower) == pytest.approx(0.0, abs=close * half)
        assert check.covered > 0.95 - 3.5 * np.sqrt(0.95 * 0.05 / draws)
        assert (check.draws, check.failed) == (draws, 0)


def test_the_same_seed_gives_the_same_draws() -> None:
    curves = measured(n=30, seed=6)
    one, two = (check_by_bootstrap(WIRE, curves, SETTINGS, draws=3, seed=1) for _ in range(2))
    assert one == two


def test_a_failure_is_handed_on() -> None:
    assert isinstance(check_by_bootstrap(WIRE, [], SETTINGS), CalibrationFailure)


def test_too_few_draws_that_can_be_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    from labpipe.wire.calibrating import bootstrap

    def refuse(*_: object, **__: object) -> None:
        message = "beyond"
        raise ValueError(message)

    monkeypatch.setattr(bootstrap, "search", refuse)
    checks = check_by_bootstrap(WIRE, measured(n=30, seed=6), SETTINGS, draws=2)
    assert not isinstance(checks, CalibrationFailure)
    assert all(check.interval is None and check.failed == 2 for check in checks)
    assert isinstance(checks[0], BootstrapCheck)
