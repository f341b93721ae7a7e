"""The parts of a wire's law: other parameters, forces of curves, and their derivatives."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from labpipe.mechanics.wire.bending_law import Contacts, compute_moment_curve, make_contacts
from labpipe.mechanics.wire.calibration.law_components import (
    LawComponent,
    WireLaw,
    _find_edges,
    _interpolate_moment,
    compute_loading_curve,
    make_loading_table,
    split_law,
)
from labpipe.mechanics.wire.calibration.measured_curves import compute_shared_errors
from labpipe.mechanics.wire.calibration.objective import (
    compute_model_forces,
    compute_whitened_products,
)
from labpipe.mechanics.wire.cantilever import StringRig
from labpipe.mechanics.wire.cross_section import CrossSection, Layer, place_rings, place_sectors
from labpipe.mechanics.wire.first_loading import interpolate_force
from labpipe.mechanics.wire.materials import StressTable
from labpipe.records.arrays import Floats
from tests.builders.loading_tests import (
    TRUTH,
    exact_curve,
    measured,
    rig_of,
    section_of,
    wire_of,
)
from tests.builders.stranded_wires import elastic, tube

WIRE = wire_of("A2")

PARTS = split_law(WIRE.section, WIRE.contacts)

LARGEST = 60.0


def parts_of(name: str) -> WireLaw:
    wire = wire_of(name)
    return split_law(wire.section, wire.contacts)


def test_a_corner_beside_a_knot_makes_no_knot() -> None:
    """One that is a ten-millionth off a point of the grid, on either side; any other makes one."""

    def edges(corners: Floats) -> Floats:
        part = LawComponent(0, lambda at: (at, at), corners=corners)
        return _find_edges(replace(PARTS, components=(part,)), TRUTH, LARGEST)

    grid = edges(np.zeros(0))
    beside = grid[[5, 20, 33]]
    for share in (-1e-7, 1e-7):
        assert edges(beside * (1.0 + share)).tolist() == grid.tolist()
    apart = beside * 1.001
    assert edges(apart).tolist() == sorted([*grid, *apart])


def test_the_moment_between_points_and_before_the_first() -> None:
    """A secant stiffness that is linear in the logarithm: 2 - log(kappa / 0.1)."""
    points = np.geomspace(0.1, 0.5, 6)
    moment, slope = _interpolate_moment(points, points * (2.0 - np.log(10.0 * points)))(
        np.array([0.05, 0.11, 0.2])
    )
    secant = 2.0 - np.log([1.0, 1.1, 2.0])
    assert moment == pytest.approx(secant * [0.05, 0.11, 0.2])
    assert slope == pytest.approx(secant - [0.0, 1.0, 1.0])


@pytest.mark.parametrize("name", ["A2", "C4"])
@pytest.mark.parametrize("factors", [(0.2, 1.0, 1.0), (5.0, 3.0, 0.5), (2.0, 0.3, 1.7)])
def test_the_law_at_other_parameters_is_that_of_another_wire(
    name: str, factors: tuple[float, float, float]
) -> None:
    """Scaled tables against the wire made anew with those numbers."""
    phi, modulus, scale = TRUTH * factors
    law = make_loading_table(parts_of(name), TRUTH * factors, LARGEST)
    wire = wire_of(name, phi, modulus, scale)
    expected = compute_moment_curve(wire.section, wire.contacts, law.curvature[1:])
    assert law.moment[1:] == pytest.approx(expected.moment, rel=2e-6)


@pytest.mark.parametrize(("name", "weight"), [("A2", 0.0), ("C4", 0.0), ("A2", 0.05)])
@pytest.mark.parametrize("has_string", [True, False])
def test_derivatives_by_the_logarithms(name: str, weight: float, *, has_string: bool) -> None:
    parts, deflection = parts_of(name), np.linspace(0.001, 0.04, 60)
    rig = StringRig(0.05, 0.0265, 0.085, 0.05) if has_string else None  # it leans

    def force(values: Floats) -> tuple[Floats, Floats]:
        curve = compute_loading_curve(parts, values, 0.085, rig, 0.04, self_weight=weight)
        return interpolate_force(curve, deflection)

    change = force(TRUTH)[1]
    for number in range(3):
        step = np.exp(1e-3 * np.eye(3)[number])
        expected = (force(TRUTH * step)[0] - force(TRUTH / step)[0]) / 2e-3
        assert change[number] == pytest.approx(expected, abs=7e-3 * np.abs(expected).max())


SOFT = StressTable((0.01, 0.03, 0.1, 0.3), (10e6, 18e6, 24e6, 30e6))


def test_an_insulation_with_a_stress_table_scales_by_its_modulus() -> None:
    """The law of a wire whose insulation is half as stiff throughout, and its derivatives."""
    parts, values = split_law(soft_wire(1.0), WIRE.contacts), TRUTH * (1.0, 0.5, 1.0)
    law = make_loading_table(parts, values, LARGEST)
    expected = compute_moment_curve(soft_wire(0.5), WIRE.contacts, law.curvature[1:])
    assert law.moment[1:] == pytest.approx(expected.moment, rel=5e-5)
    step, moment = 1e-4, law.moment[20:]
    ahead, behind = (
        make_loading_table(parts, values * (1.0, np.exp(change), 1.0), LARGEST).bend(moment)[0]
        for change in (step, -step)
    )
    assert law.compute_sensitivities(moment)[1] == pytest.approx((ahead - behind) / 2e-4, rel=2e-3)


@pytest.mark.parametrize("correlation", [0.0, 0.4])
def test_errors_that_points_share_make_a_covariance(correlation: float) -> None:
    """Against the inverse of the whole matrix."""
    curve = measured(samples=1, n=30)[0]
    if correlation:
        curve = replace(curve, zero_error=2e-3, offset_error=1e-3, scale_error=0.02)
    model = compute_model_forces(PARTS, TRUTH, (curve,))[0]
    shared = compute_shared_errors(curve, model.slope)
    lags = np.abs(np.subtract.outer(np.arange(30), np.arange(30)))
    weight = np.linalg.inv(0.002**2 * correlation**lags + shared.T @ shared)
    residuals = curve.force - 1.1 * model.force
    columns = np.column_stack([1.1 * model.sensitivity.T, 1.1 * model.force, residuals])
    products = compute_whitened_products(curve, columns, model.slope, correlation)
    assert products[4, 4] == pytest.approx(float(residuals @ weight @ residuals), rel=1e-6)
    by_change = 1.1 * model.sensitivity[0] @ weight
    assert products[0, 4] == pytest.approx(float(by_change @ residuals), rel=1e-6)
    assert products[3, 0] == pytest.approx(float(by_change @ (1.1 * model.force)), rel=1e-6)


def test_a_stress_table_need_reach_no_further_than_the_tests() -> None:
    """The curve of an insulation whose table ends just beyond is that of one that goes on."""

    def curve(strain: float) -> tuple[Floats, float]:
        inside = [s for s in SOFT.strains if s < strain]
        last = float(np.interp(strain, SOFT.strains, SOFT.stresses))
        table = StressTable((*inside, strain), (*SOFT.stresses[: len(inside)], last))
        section = replace(section_of("A2"), insulation=replace(tube(1.6e-3), curve=table))
        parts = split_law(section, WIRE.contacts)
        loading = compute_loading_curve(parts, TRUTH, 0.085, rig_of(0.085), 0.05, self_weight=0.05)
        bent = np.interp(0.05, loading.deflection, loading.clamp_curvature)
        return interpolate_force(loading, np.linspace(0.001, 0.05, 30))[0], float(bent)

    force, bent = curve(0.096)
    assert curve(1.1 * 0.8e-3 * bent)[0] == pytest.approx(force, rel=2e-4)
    match = r"curvature=([\d.]+) 1/m: the insulation.* is known up to ([\d.]+)"
    with pytest.raises(ValueError, match=match) as caught:
        curve(0.9 * 0.8e-3 * bent)
    asked, stated = map(float, re.findall(match, str(caught.value))[0])
    assert asked == pytest.approx(bent, rel=0.02)
    assert stated == pytest.approx(0.9 * bent, rel=1e-5)


def test_forces_and_slopes_of_curves_of_several_lengths() -> None:
    curves = measured(lengths=(0.085, 0.12), samples=2, n=40)
    mixed = (curves[3], replace(curves[0], rig=None), curves[1])
    ahead, behind = (
        [replace(curve, deflection=np.maximum(curve.deflection + step, 0.0)) for curve in mixed]
        for step in (1e-5, -1e-5)
    )
    rows = [compute_model_forces(PARTS, TRUTH, tuple(group)) for group in (mixed, ahead, behind)]
    for curve, model, below, above in zip(mixed, rows[0], rows[2], rows[1], strict=True):
        exact = exact_curve("A2", curve.length, has_string=curve.rig is not None)
        assert model.force == pytest.approx(exact(curve.deflection), abs=1e-5)
        assert model.sensitivity.shape == (3, 40)
        slope = (above.force - below.force) / 2e-5
        assert model.slope[1:] == pytest.approx(slope[1:], rel=0.02)


ROUGH, SMOOTH, LOOSE = (
    make_contacts(1, strand=strand, insulation=0.5 * strand, radial_force=force)
    for strand, force in ((0.2, 0.15), (0.0, 0.15), (0.2, 0.0))
)

CORE, RING = section_of("A2").layers

BARE = place_sectors(
    (replace(CORE, material=elastic(110e9)), replace(RING, material=elastic(110e9)))
)

TWO = place_sectors((replace(CORE, material=elastic(207e9)), RING))

SINGLE = place_rings((Layer(1, 0.5e-3),), tube(1.2e-3))


@pytest.mark.parametrize(
    ("section", "contacts", "has"),
    [
        (BARE, SMOOTH, (False, False, False)),
        (BARE, LOOSE, (True, False, False)),
        (SINGLE, Contacts((), ()), (False, True, True)),
        (TWO, SMOOTH, (False, False, True)),
        (section_of("A2"), ROUGH, (True, True, True)),
    ],
    ids=["elastic", "no radial force", "one strand", "steel and copper", "all"],
)
def test_what_a_wire_has(
    section: CrossSection, contacts: Contacts, has: tuple[bool, bool, bool]
) -> None:
    parts = split_law(section, contacts)
    assert parts.is_active == has
    assert np.isnan(parts.nominal).tolist() == [not acts for acts in has]
    if parts.nominal[0] == 0.0:
        return
    law = make_loading_table(parts, parts.nominal, LARGEST)
    expected = compute_moment_curve(section, contacts, law.curvature[1:])
    assert law.moment[1:] == pytest.approx(expected.moment, rel=2e-6)
    assert not law.start_sensitivity[~np.array(has)].any()


def test_copper_and_first_loading_end() -> None:
    """Within them the curve reaches its deflection for any law."""
    # up to strains of 100
    assert PARTS.components[-1].last_curvature == pytest.approx(100.0 / (0.5 * CORE.diameter))
    for factors in ([20.0, 0.05, 3.0], [0.01, 5.0, 0.06]):
        values = TRUTH * factors
        reached = compute_loading_curve(
            PARTS, values, 0.085, rig_of(0.085), 0.65 * 0.085
        ).deflection[-1]
        assert reached >= 0.65 * 0.085
    with pytest.raises(ValueError, match=r"1/m: .* is known up to 0\.04\d+ 1/m at a copper scale"):
        compute_loading_curve(PARTS, TRUTH * [1.0, 1.0, 1e-4], 0.085, None, 0.05)
    curve = replace(measured(samples=1, n=10)[0], length=0.06, rig=None)
    with pytest.raises(ValueError, match=r"deflection=0.05 m: .* ends at 0.04\d+ m"):
        compute_model_forces(PARTS, TRUTH, (curve,))


def soft_wire(scale: float) -> CrossSection:
    curve = replace(SOFT, stresses=tuple(scale * stress for stress in SOFT.stresses))
    insulation = replace(tube(1.6e-3, modulus=scale * 1e9), curve=curve)
    return replace(section_of("A2"), insulation=insulation)
