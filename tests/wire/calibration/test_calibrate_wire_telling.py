"""What a calibration says of itself: verdicts, notes, parameters that are not there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.wire_calibration import (
    PARAMETERS,
    Calibration,
    CalibrationFailure,
    Identified,
    ParameterChoice,
)
from labpipe.wire.calibration.calibrate_wire import tell
from labpipe.wire.calibration.fit import Settings, Wire, find
from labpipe.wire.calibration.measured_curves import MeasuredCurve
from labpipe.wire.cross_section import Layer, concentric
from labpipe.wire.friction import Contacts
from tests.builders.loading_tests import measured, wire_of
from tests.builders.stranded_wires import tube

WIRE = wire_of("A2")
THREE = measured(lengths=(0.085, 0.12), samples=2, n=120, seed=8)
FIXED = ParameterChoice(is_fixed=True)


def calibrated(
    curves: tuple[MeasuredCurve, ...], settings: Settings, wire: Wire = WIRE
) -> Calibration:
    found = find(wire, curves, settings)
    assert not isinstance(found, CalibrationFailure), found
    return tell(found)


def codes(calibration: Calibration) -> list[str]:
    return [note.code for note in calibration.notes]


@pytest.mark.slow
def test_a_parameter_at_its_bound() -> None:
    choice = ParameterChoice(1.3e9, lower=1.2e9)
    found = calibrated(THREE, Settings({"insulation_modulus": choice}, gain=0.005))
    modulus = found.parameter("insulation_modulus")
    assert modulus.at_bound == "lower"
    assert modulus.verdict is Identified.AT_BOUND
    note = next(note for note in found.notes if note.code == "at_bound")
    assert "ended at the lower bound of its search, 1200 MPa" in note.message
    upper = ParameterChoice(0.7e9, upper=0.8e9)
    below = calibrated(THREE, Settings({"insulation_modulus": upper}, gain=0.005))
    assert below.parameter("insulation_modulus").at_bound == "upper"


def test_what_is_identified_is_so_at_99_per_cent() -> None:
    """An interval that noise ended just early enough is not knowledge."""
    found = calibrated(measured(seed=4, n=90), Settings(gain=0.005))
    copper, modulus = found.parameter("copper_scale"), found.parameter("insulation_modulus")
    (part,) = copper.intervals
    assert 1.7 < part.upper / part.lower < 1.8
    assert copper.verdict is Identified.WEAKLY
    assert ", and at 99 % between 0.66" in copper.words
    assert modulus.verdict is Identified.WELL
    assert "99 %" not in modulus.words


def test_one_sample_speaks_of_itself() -> None:
    found = calibrated(THREE[:1], Settings(gain=0.005))
    assert "one_sample" in codes(found)
    assert found.levels.scatter_freedom == 0.0
    given = calibrated(THREE[:1], Settings(gain=0.005, scatter=0.03))
    assert "one_sample" not in codes(given)
    assert given.levels.scatter_freedom == np.inf
    wider, narrow = (c.parameter("insulation_modulus").log_error for c in (given, found))
    assert wider > narrow


@pytest.mark.slow
def test_noise_that_was_misstated() -> None:
    understated = tuple(replace(curve, noise=0.0005) for curve in THREE)
    found = calibrated(understated, Settings(gain=0.005))
    note = next(note for note in found.notes if note.code == "noise_misstated")
    assert found.levels.noise_factor == pytest.approx(4.0, rel=0.1)
    told = f"the residuals scatter {found.levels.noise_factor:.3g} times as much as the stated"
    assert note.message == f"{told} noise; the intervals go by the residuals"
    usual = calibrated(THREE, Settings(gain=0.005))
    one, two = (c.parameter("radial_friction").interval for c in (found, usual))
    assert one is not None
    assert two is not None
    assert one.upper == pytest.approx(two.upper, rel=0.02)


def test_slow_residuals_are_said() -> None:
    slow = measured(n=200, seed=9, correlation=0.9)
    found = calibrated(slow, Settings(gain=0.005))
    note = next(note for note in found.notes if note.code == "residuals_correlated")
    assert note.message.startswith("neighbouring residuals are alike (correlation 0.")
    assert found.levels.correlation == pytest.approx(0.9, abs=0.06)


def test_a_search_that_does_not_rest_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    from labpipe.wire.calibration import parameter_search as search

    monkeypatch.setattr(search, "_MOST_STEPS", 1)
    choices = {"copper_scale": FIXED, "insulation_modulus": ParameterChoice(3e9)}
    found = calibrated(THREE[:1], Settings(choices, scatter=0.03))
    assert "search_unsettled" in codes(found)


def test_a_wire_without_friction() -> None:
    strand = Wire(concentric((Layer(1, 0.9e-3),), tube(1.6e-3)), Contacts((), ()))
    found = calibrated(THREE, Settings(gain=0.005), strand)
    friction = found.parameter("radial_friction")
    assert np.isnan(friction.value)
    assert friction.words == "phi = F_rad (mu_s + mu_p) does not act on this wire"
    assert found.friction_separability is None
    assert found.separability.names == PARAMETERS[1:]


def test_not_identified_is_noted() -> None:
    noisy = measured(n=60, noise=0.04, seed=4)
    found = calibrated(noisy, Settings({"copper_scale": FIXED}, gain=0.005))
    friction = found.parameter("radial_friction")
    assert friction.at_bound == ""
    assert friction.verdict is Identified.NOT
    assert friction.is_open_below
    assert "not_identified" in codes(found)
