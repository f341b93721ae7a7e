from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.wire.calibration.measured_curves import shared_errors
from labpipe.wire.calibration.wire_parts import gram, loading_curve, model_forces, take_apart
from tests.builders.loading_tests import TRUTH, exact_curve, measured, rig_of, wire_of

WIRE = wire_of("A2")
PARTS = take_apart(WIRE.section, WIRE.contacts)


def test_forces_of_curves_of_several_lengths() -> None:
    curves = measured(lengths=(0.085, 0.12), samples=2, n=40)
    mixed = (curves[3], replace(curves[0], rig=None), curves[1])
    forces = model_forces(PARTS, TRUTH, mixed)
    for curve, model in zip(mixed, forces, strict=True):
        exact = exact_curve("A2", curve.length, has_string=curve.rig is not None)
        assert model.force == pytest.approx(exact(curve.deflection), abs=1e-5)
        assert model.change.shape == (3, 40)


@pytest.mark.parametrize("values", [TRUTH * [20.0, 0.05, 3.0], TRUTH * [0.01, 5.0, 0.06]])
def test_the_curve_reaches_the_deflection_for_any_law(values: np.ndarray) -> None:
    curve = loading_curve(PARTS, values, 0.085, rig_of(0.085), 0.65 * 0.085)
    assert curve.deflection[-1] >= 0.65 * 0.085


def test_beyond_first_loading() -> None:
    curve = replace(measured(samples=1, n=10)[0], length=0.06, rig=None)
    with pytest.raises(ValueError, match=r"deflection=0.05 m: the curve ends at 0.04\d+ m"):
        model_forces(PARTS, TRUTH, (curve,))


def test_gram_is_of_weighted_columns() -> None:
    curve = measured(samples=1, n=30)[0]
    model = model_forces(PARTS, TRUTH, (curve,))[0]
    products = gram(curve, model, 1.1, 0.0)
    left = (curve.force - 1.1 * model.force) / 0.002
    assert products[4, 4] == pytest.approx(float(left @ left))
    assert products[3, 0] == pytest.approx(1.21 * float(model.force @ model.change[0]) / 0.002**2)


def test_errors_that_points_share_make_a_covariance() -> None:
    """Against the inverse of the whole matrix."""
    curve = replace(
        measured(samples=1, n=30)[0], zero_error=2e-3, place_error=1e-3, scale_error=0.02
    )
    model = model_forces(PARTS, TRUTH, (curve,))[0]
    shared = shared_errors(curve, model.slope)
    lags = np.abs(np.subtract.outer(np.arange(30), np.arange(30)))
    weight = np.linalg.inv(0.002**2 * 0.4**lags + shared.T @ shared)
    left = curve.force - 1.1 * model.force
    products = gram(curve, model, 1.1, 0.4)
    assert products[4, 4] == pytest.approx(float(left @ weight @ left), rel=1e-6)
    assert products[0, 4] == pytest.approx(float(1.1 * model.change[0] @ weight @ left), rel=1e-6)


def test_the_slope_is_that_of_the_curve() -> None:
    curve, step = measured(samples=1, n=30)[0], 1e-5
    ahead = replace(curve, deflection=curve.deflection + step)
    behind = replace(curve, deflection=curve.deflection - step)
    model, more, less = (model_forces(PARTS, TRUTH, (each,))[0] for each in (curve, ahead, behind))
    wanted = (more.force - less.force) / (2.0 * step)
    assert model.slope[1:] == pytest.approx(wanted[1:], rel=0.02)


def test_copper_is_elastic_where_its_table_begins() -> None:
    """Half of moment times curvature is stored; the moment is that of the strands' EI."""
    for part in PARTS.copper:
        stiffness, energy = part.table(np.log(part.first))
        assert energy == pytest.approx(0.5 * stiffness, rel=1e-6)
