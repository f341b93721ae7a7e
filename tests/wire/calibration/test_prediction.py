from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.wire_calibration import Calibration, NoiseLevels
from labpipe.wire.calibration.calibrate_wire import Settings, calibrate
from labpipe.wire.calibration.prediction import predict
from tests.builders.loading_tests import exact_curve, measured, rig_of, wire_of

D = np.linspace(0.0, 0.05, 21)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    found = calibrate(wire_of("A2"), measured(n=90, seed=5), Settings(gain=0.005))
    assert isinstance(found, Calibration)
    return found


def test_another_wire_and_length(calibration: Calibration) -> None:
    found = predict(calibration, wire_of("A3"), 0.12, D, rig=rig_of(0.12), noise=0.002)
    exact = exact_curve("A3", 0.12)(D)
    assert np.all((found.lower_mean <= exact) & (exact <= found.upper_mean))
    assert np.all(found.lower <= found.lower_mean)
    assert np.all(found.upper_mean <= found.upper)
    assert found.notes == ()


def test_what_widens_a_band(calibration: Calibration) -> None:
    def half(**more: float) -> float:
        found = predict(calibration, wire_of("A2"), 0.085, D, rig=rig_of(0.085), **more)  # type: ignore[arg-type]
        return float(found.upper[-1] - found.force[-1])

    assert half(noise=0.01) > half(noise=0.002) > half() > half(n_samples=9)
    assert half(other_gain=0.05) > half(other_gain=0.0)


def test_nominal_numbers_where_the_calibration_has_none(calibration: Calibration) -> None:
    bare = replace(calibration.solutions[0], values=np.full(3, np.nan))
    found = predict(replace(calibration, solutions=(bare,)), wire_of("A2"), 0.085, D)
    exact = exact_curve("A2", 0.085, has_string=False)(D)
    assert found.force == pytest.approx(exact, abs=1e-5)


def test_bands_of_two_solutions(calibration: Calibration) -> None:
    """The second as far as its own likelihood allows; the curve is that of the first."""
    first = calibration.solutions[0]
    one = predict(calibration, wire_of("A2"), 0.085, D)
    alone = predict(replace(calibration, solutions=(first,)), wire_of("A2"), 0.085, D)
    stiff = replace(first, values=np.array([1.0, 1.3, 1.0]) * first.values)
    same = replace(calibration, solutions=(stiff,))
    of_stiff = predict(same, wire_of("A2"), 0.085, D)
    both = replace(calibration, solutions=(first, stiff))
    equal = predict(both, wire_of("A2"), 0.085, D)
    assert equal.force == pytest.approx(alone.force)
    assert equal.lower_mean == pytest.approx(alone.lower_mean)
    assert equal.upper_mean == pytest.approx(of_stiff.upper_mean)
    assert equal.upper == pytest.approx(of_stiff.upper)
    assert "two_solutions" in [note.code for note in equal.notes]
    worse = replace(stiff, rise=0.75 * first.limit)
    less = predict(replace(calibration, solutions=(first, worse)), wire_of("A2"), 0.085, D)
    half = 0.5 * (of_stiff.upper_mean - of_stiff.force)
    assert less.upper_mean[1:] == pytest.approx((of_stiff.force + half)[1:])
    outside = replace(stiff, rise=1.1 * first.limit)
    left = predict(replace(calibration, solutions=(first, outside)), wire_of("A2"), 0.085, D)
    assert left.upper == pytest.approx(one.upper)


def test_what_the_bands_leave_out_is_said(calibration: Calibration) -> None:
    levels = NoiseLevels(1.0, 0.0, 0.0, 0.005, 0.0, 100.0)
    first = replace(calibration.parameters[0], is_open_below=True, words="phi is open")
    doubtful = replace(calibration, levels=levels, parameters=(first, *calibration.parameters[1:]))
    notes = predict(doubtful, wire_of("A2"), 0.085, D).notes
    assert [note.code for note in notes] == ["one_sample", "not_identified"]
    assert notes[0].message == (
        "the scatter of samples is not known from one sample: the bands leave it out"
    )
    assert notes[1].message == "phi is open; the bands take its error for that of a normal one"


def test_beyond_first_loading(calibration: Calibration) -> None:
    with pytest.raises(ValueError, match=r"deflection=0.05 m: the curve ends at 0.04"):
        predict(calibration, wire_of("A2"), 0.06, D)
