from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.wire.calibration.measured_curves import shared_errors
from labpipe.wire.calibration.wire_parts import (
    WireParts,
    gram,
    loading_curve,
    model_forces,
    take_apart,
)
from labpipe.wire.first_loading import force_at
from labpipe.wire.materials import StressTable
from tests.builders.loading_tests import TRUTH, exact_curve, measured, rig_of, section_of, wire_of
from tests.builders.stranded_wires import tube

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


def soft_until(strain: float) -> WireParts:
    """A2 with an insulation whose stress table ends at a strain of its rim."""
    strains = np.array([0.01, 0.02, 0.03, 0.1, 0.3])
    stresses = np.array([10e6, 14e6, 18e6, 24e6, 30e6])
    inside = strains < strain
    table = StressTable(
        (*strains[inside], strain),
        (*stresses[inside], float(np.interp(strain, strains, stresses))),
    )
    section = replace(section_of("A2"), insulation=replace(tube(1.6e-3), curve=table))
    return take_apart(section, WIRE.contacts)


def hard_until(strain: float) -> WireParts:
    """A2 with strands of one ring and a stress table of the copper that ends at a strain."""
    strains = np.array([1e-3, 0.01, 0.02])
    stresses = np.array([110e6, 200e6, 230e6])
    inside = strains < strain
    table = StressTable(
        (*strains[inside], strain),
        (*stresses[inside], float(np.interp(strain, strains, stresses))),
    )
    section = section_of("A2")
    layers = tuple(replace(layer, material=table) for layer in section.layers)
    return take_apart(replace(section, layers=layers), WIRE.contacts)


@pytest.mark.parametrize(("parts_until", "radius"), [(soft_until, 0.8e-3), (hard_until, None)])
@pytest.mark.parametrize("weight", [0.0, 0.05])
def test_a_stress_table_need_reach_no_further_than_the_tests(
    parts_until: Callable[[float], WireParts], radius: float | None, weight: float
) -> None:
    """The curve of a table that ends just beyond is that of one that goes on."""
    rim = radius or max(layer.diameter for layer in section_of("A2").layers) / 2.0

    def curve(parts: WireParts) -> tuple[Floats, float]:
        loading = loading_curve(parts, TRUTH, 0.085, rig_of(0.085), 0.05, self_weight=weight)
        at = np.linspace(0.001, 0.05, 30)
        bent = np.interp(0.05, loading.deflection, loading.clamp_curvature)
        return force_at(loading, at)[0], float(bent)

    far, bent = curve(parts_until(12.0 * rim * 10.0))
    near, _ = curve(parts_until(1.1 * rim * bent))
    assert near == pytest.approx(far, rel=2e-4)
    known = 0.9 * rim * bent
    match = r"curvature=([\d.]+) 1/m: the (insulation|material).* is known up to ([\d.]+)"
    with pytest.raises(ValueError, match=match) as caught:
        curve(parts_until(known))
    found = re.search(match, str(caught.value))
    assert found is not None
    assert float(found[1]) == pytest.approx(bent, rel=0.02)
    assert float(found[3]) == pytest.approx(known / rim, rel=1e-5)


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
