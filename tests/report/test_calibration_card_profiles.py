from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labpipe.records.wire_calibration import Profile
from labpipe.report.calibration_card import plot_profile, seen, smooth
from labpipe.report.figure_page import style
from tests.report.builders_calibrations import troubled, two_solutions, usual


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style():
        yield


def panel() -> Axes:
    return Figure().subplots()


def test_profile_with_thresholds_value_and_interval() -> None:
    parameter, axes = usual().parameter("insulation_modulus"), panel()
    (profile,) = parameter.profiles
    assert parameter.interval is not None
    plot_profile(parameter, axes)
    curve, dots, below, above, value = axes.lines
    np.testing.assert_allclose(np.asarray(dots.get_xdata()), 1e-6 * profile.value)
    np.testing.assert_allclose(np.asarray(dots.get_ydata()), profile.deviance)
    assert set(np.asarray(below.get_ydata())) == {profile.threshold_below}
    assert set(np.asarray(above.get_ydata())) == {profile.threshold_above}
    assert np.asarray(value.get_xdata())[0] == pytest.approx(1e-6 * parameter.value)
    assert np.min(np.asarray(curve.get_ydata())) == pytest.approx(0.0, abs=1e-12)
    (grey,) = axes.patches
    left, right = grey.get_extents().transformed(axes.transData.inverted()).intervalx
    assert [1e6 * left, 1e6 * right] == pytest.approx(
        [parameter.interval.lower, parameter.interval.upper]
    )
    assert axes.get_xscale() == "log"
    assert axes.get_xlabel() == "Insulation modulus (MPa)"


def test_an_open_interval_reaches_to_the_end_of_the_panel() -> None:
    parameter, axes = troubled().parameter("radial_friction"), panel()
    assert parameter.is_open_below
    plot_profile(parameter, axes)
    (grey,) = axes.patches
    left = grey.get_extents().transformed(axes.transData.inverted()).x0
    assert left == pytest.approx(axes.get_xlim()[0])


def test_prior_from_its_own_centre() -> None:
    parameter, axes = troubled().parameter("copper_scale"), panel()
    plot_profile(parameter, axes)
    prior = axes.lines[-1]
    x, y = np.asarray(prior.get_data())
    assert x[np.argmin(y)] == pytest.approx(1.6, rel=2e-3)
    assert np.interp(1.6 / 1.05, x, y) == pytest.approx(1.96**2, rel=0.01)


def test_held_parameter_is_said() -> None:
    parameter, axes = troubled().parameter("insulation_modulus"), panel()
    plot_profile(parameter, axes)
    assert axes.texts[0].get_text() == "The modulus of the insulation\nwas held at 1000 MPa."
    assert seen(parameter) == (parameter.value, parameter.value)


def test_smooth_profile_passes_through_its_points() -> None:
    logs = np.array([-2.0, -1.0, 0.0, 3.0])
    profile = Profile(np.exp(logs), logs**2, 4.0, 4.0)
    values, deviance = smooth(profile)
    np.testing.assert_allclose(deviance, np.log(values) ** 2, atol=1e-12)
    assert set(np.exp(logs)) <= set(values)


def test_two_valleys_and_two_parts() -> None:
    parameter, axes = two_solutions().parameter("copper_scale"), panel()
    plot_profile(parameter, axes)
    assert len(parameter.profiles) == len(parameter.intervals) == 2
    spans = [
        patch.get_extents().transformed(axes.transData.inverted()).intervalx.tolist()
        for patch in axes.patches
    ]
    ends = [(part.lower, part.upper) for part in parameter.intervals]
    assert spans == [pytest.approx(part) for part in ends]
    marks = [line for line in axes.lines if line.get_marker() == "^"]
    least = float(parameter.profiles[1].deviance.min())
    (other,) = [line for line in marks if line.get_markerfacecolor() == "white"]
    assert np.asarray(other.get_ydata())[0] == least > 0.0
    for profile in parameter.profiles:
        values, deviance = smooth(profile)
        assert deviance.min() == pytest.approx(profile.deviance.min())
        np.testing.assert_allclose(np.interp(profile.value, values, deviance), profile.deviance)
    assert seen(parameter)[0] < parameter.intervals[0].lower
    assert seen(parameter)[1] > parameter.intervals[1].upper
