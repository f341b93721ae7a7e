"""The model of a bundle: bounds of its stiffness, sticking wires, and friction between them.

Section 4.2.3 of the source: an asymmetric bundle of 10 B1 and 9 B2 wires is stiffer than a
symmetric one, since stiffness grows with the distance from the neutral plane.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import brentq

from labpipe.mechanics.law.plays import compute_first_curvature
from labpipe.mechanics.wire.bundle_layout import find_sites
from labpipe.mechanics.wire.bundle_model import (
    Friction,
    compute_axial_force,
    compute_bundle_model,
    compute_composite_degree,
    compute_friction_moment,
    compute_slipping_moment,
    compute_stick_tensor,
    compute_stretching_moment,
    find_common_curvatures,
    fit_friction,
    make_friction_law,
)
from labpipe.mechanics.wire.first_loading import compute_end_load_path
from labpipe.records.arrays import Floats
from labpipe.records.harness_bundle import Bundle, BundleLoop, BundleModel, BundleWire
from tests.approved import Approve
from tests.builders.bundles import bundle, example_wires, solid_stiffnesses, solid_wire


def codes(model: BundleModel) -> list[str]:
    return [note.code for note in model.notes]


def test_bounds_and_laws_of_a_mixed_bundle() -> None:
    wires = example_wires()
    model = compute_bundle_model(bundle(("B1", 10), ("B2", 9), arrangement="asymmetric"), wires)
    b1, b2 = wires["B1"], wires["B2"]
    assert model.low == pytest.approx(10 * b1.slip_stiffness + 9 * b2.slip_stiffness)
    assert model.free == pytest.approx(10 * b1.stick_stiffness + 9 * b2.stick_stiffness)
    assert model.axial_stiffness == pytest.approx(10 * b1.axial_stiffness + 9 * b2.axial_stiffness)
    assert model.low < model.free < model.principal[0] < model.high <= model.principal[1]
    assert model.high == model.tensor[1, 1]
    assert abs(model.principal_angle) == pytest.approx(np.pi / 2.0, abs=0.1)  # across the border
    assert np.all(model.moment_stick[1:] > model.moment_slip[1:])
    assert model.free < model.moment_stick[1] / model.curvature[1] < model.high
    assert model.packing_fraction is None
    assert codes(model) == ["range_shortened", "copper_yields", "insulation_doubtful"]
    regular = compute_bundle_model(bundle(("S", 7)), {"S": solid_wire()})
    assert regular.principal[0] == pytest.approx(regular.principal[1])
    assert regular.principal_angle == 0.0
    assert regular.neutral == pytest.approx((0.0, 0.0), abs=1e-12)


LENGTH = 0.1143


@cache
def pair() -> BundleModel:
    """Two solid wires of 1 mm over the insulation, one above the other."""
    places = ((0.0, -0.5e-3), (0.0, 0.5e-3))
    return compute_bundle_model(bundle(("S", 2), positions=places), {"S": solid_wire()})


@cache
def seven() -> BundleModel:
    return compute_bundle_model(bundle(("B1", 7)), example_wires())


def test_two_wires_by_hand() -> None:
    """Stick until 1 1/m, then half of what they held goes on, until the tape slides at 2 1/m."""
    bending, axial = solid_stiffnesses()
    curvature = np.array([0.5, 1.0, 1.5, 3.0])
    found = compute_friction_moment(curvature, pair(), [solid_wire()], Friction(0.2, 1.0, 2.0, 0.5))
    composite = 0.2 * 2.0 * axial * 0.5e-3**2
    held = composite * np.array([0.5, 1.0, 0.5 * 1.0 + 0.5 * 1.5, 0.5 * 1.0 + 0.5 * 2.0])
    assert found == pytest.approx(2.0 * bending * curvature + held, rel=1e-5)


def test_loops_follow_masing() -> None:
    model, tables = seven(), [example_wires()["B1"]]
    friction = Friction(0.13, 0.4, 5.0, 0.2)
    law = make_friction_law(model, tables, friction)
    top = compute_friction_moment(np.array([8.0]), model, tables, friction)
    loaded = law.respond(top, law.make_unbent_history(1))
    for share in (0.3, 0.9, 1.4):
        back = law.respond((1.0 - share) * top, loaded.history)
        half = compute_first_curvature(law, 0.5 * share * top)
        assert back.curvature == pytest.approx(loaded.curvature - 2.0 * half, rel=1e-9)


def test_the_share_held_is_found_again() -> None:
    """Loading of small slopes by quadrature; its unloading, left out, does not matter."""
    model, tables = seven(), [example_wires()["B1"]]
    kink, deflection = 1.8e-3, np.linspace(0.4e-3, 8e-3, 12)
    friction = Friction(0.13, 3.0 * kink / LENGTH**2, np.inf, 0.25)
    curvature, x = np.geomspace(1e-4, 40.0, 4000), np.linspace(0.0, LENGTH, 2001)
    moment = np.append(0.0, compute_friction_moment(curvature, model, tables, friction))

    def too_far(load: float, tip: float) -> float:
        bent = np.interp(load * (LENGTH - x), moment, np.append(0.0, curvature))
        return float(np.trapezoid(bent * (LENGTH - x), x)) - tip

    # a kink force that says the share exactly
    stiffness = model.free + friction.composite_share * (model.high - model.free)
    force = np.array([float(brentq(too_far, 1e-6, 2.0, args=(tip,))) for tip in deflection])
    loop = BundleLoop(
        length=LENGTH,
        deflection=np.append(deflection, deflection[-2]),
        force=np.append(force, 0.0),
        branch=np.append(np.zeros(12, dtype=np.int64), 1),
        kink=(kink, 3.0 * stiffness * kink / LENGTH**3),
        slide=np.inf,
    )
    fitted = fit_friction(model, tables, loop)
    assert fitted.composite_share == pytest.approx(0.13)
    assert fitted.held == pytest.approx(0.25, abs=0.01)
    assert fitted.error_fitted < 0.01
    assert fitted.is_held_out.tolist() == [False] * 12 + [True]
    assert fitted.error_held_out == pytest.approx(fitted.predicted[-1] / force[-1])


def test_the_interval_of_the_share_is_that_of_the_linear_model() -> None:
    """White noise: 1.96 standard errors by the slope of the forces to each side."""
    model, tables, kink = seven(), [example_wires()["B1"]], (1.8e-3, 0.30)
    up = np.linspace(0.6e-3, 12e-3, 40)
    whole = BundleLoop(
        *(LENGTH, np.append(up, 11e-3), np.ones(41), np.append(np.zeros(40, dtype=np.int64), 1)),
        kink=kink,
        slide=np.inf,
    )
    given = fit_friction(model, tables, whole)  # for what is read off the kink

    def forces(held: float) -> Floats:
        friction = Friction(given.composite_share, given.slip_curvature, np.inf, held)
        law = make_friction_law(model, tables, friction)
        return np.append(compute_end_load_path(law, LENGTH, up, n_stations=16).load, 0.0)

    noise = 5e-2 * np.random.default_rng(3).normal(size=41)
    found = fit_friction(model, tables, replace(whole, force=forces(0.3) + noise))
    slope = (forces(0.31) - forces(0.29))[:40] / 0.02
    error = 5e-2 / float(np.sqrt(slope @ slope))
    assert found.held == pytest.approx(0.3, abs=3.0 * error)
    assert found.held_upper - found.held == pytest.approx(2.0 * error, rel=0.3)
    assert found.held - found.held_lower == pytest.approx(2.0 * error, rel=0.3)
    slow = 5e-2 * np.repeat(np.random.default_rng(4).normal(size=5), 9)[:41]
    other = fit_friction(model, tables, replace(whole, force=forces(0.3) + slow))
    assert other.held_upper - other.held_lower > 1.5 * (found.held_upper - found.held_lower)


def test_a_single_wire_is_itself() -> None:
    table = example_wires()["B1"]
    model = compute_bundle_model(bundle(("B1", 1)), {"B1": table})
    assert model.high == model.free == table.stick_stiffness
    assert model.low == table.slip_stiffness
    assert model.moment_stick == pytest.approx(model.moment_slip)
    assert model.moment_slip == pytest.approx(table.moment)
    beside = compute_bundle_model(
        bundle(("B1", 2)), example_wires()
    )  # nothing is stretched in a row
    assert beside.high == pytest.approx(beside.free)
    for name in ("B1", "B2"):
        first = compute_axial_force(example_wires()[name], np.array([1e-9]))[0] / 1e-9
        assert first == pytest.approx(example_wires()[name].axial_stiffness, rel=1e-4)


def test_slipping_moments_add_up_as_far_as_the_shortest_law() -> None:
    b1, b2 = tables = tuple(example_wires().values())
    curvature = find_common_curvatures(tables)
    assert curvature[0] == 0.0
    assert curvature[-1] == min(table.curvature[-1] for table in tables)
    assert np.all(np.diff(curvature) > 0.0)
    assert np.isin(b1.curvature[b1.curvature <= curvature[-1]], curvature).all()
    second = np.interp(b1.curvature[:5], b2.curvature, b2.moment)
    moment = compute_slipping_moment(b1.curvature[:5], [b1, b2], [3, 2])
    assert moment == pytest.approx(3 * b1.moment[:5] + 2 * second)


NOTED: dict[str, Bundle] = {
    "range_shortened": bundle(("S", 2), positions=((0.0, 0.0), (0.0, 0.2))),
    "oblique_axes": bundle(("S", 3), positions=((0.0, 0.0), (1e-3, 1e-3), (2e-3, 2e-3))),
    "diameter_differs": Bundle((BundleWire("S", 7, 1.9e-3),)),
    "": Bundle((BundleWire("S", 7, 1.04e-3),)),
    "copper_yields": bundle(("B1", 19)),
    "insulation_doubtful": bundle(("B1", 1)),
}


def test_notes_of_bundles(approved: Approve) -> None:
    wires, lines = {"S": solid_wire(), **example_wires()}, []
    for code, noted in NOTED.items():
        model = compute_bundle_model(noted, wires)
        assert [*codes(model), ""][0] == code
        lines += [f"{note.code}, {note.severity}: {note.message}" for note in model.notes]
    approved(lines)


def test_numbers_that_the_notes_name() -> None:
    """Wires 200 mm apart reach a strain of 0.5 long before the end of their own law."""
    solid = {"S": solid_wire()}
    far = compute_bundle_model(NOTED["range_shortened"], solid)
    assert far.curvature[-1] == pytest.approx(2.5)
    assert compute_bundle_model(NOTED["diameter_differs"], solid).smallest_bore == pytest.approx(
        5.7e-3
    )
    table = example_wires()["B1"]
    model, radius = compute_bundle_model(bundle(("B1", 7)), {"B1": table}), table.layout.wire_radius
    assert model.doubtful_curvature == pytest.approx(0.03 / radius)
    highest = float(np.abs(model.layout.y).max()) + radius
    assert model.doubtful_curvature_stick == pytest.approx(0.03 / highest)
    assert np.array_equal(model.is_doubtful, model.curvature > 0.03 / radius)
    assert model.is_doubtful_stick.sum() > model.is_doubtful.sum() > 0
    secant = model.moment_stick[1:] / model.curvature[1:]
    yields = model.curvature[1:][secant < 0.5 * model.high][0]
    assert f"beyond {yields:.3g} 1/m" in model.notes[0].message
    full = compute_bundle_model(bundle(("S", 7), conduit_bore=3.3e-3), solid)
    assert full.packing_fraction == pytest.approx(7.0 / 3.3**2)
    oblique = compute_bundle_model(NOTED["oblique_axes"], solid)
    assert np.degrees(oblique.principal_angle) == pytest.approx(45.0)
    lost = 1.0 - 1.0 / (np.linalg.inv(oblique.tensor)[1, 1] * oblique.high)
    assert f"and {100.0 * lost:.2g} % less if" in oblique.notes[0].message


def test_shares_of_the_bounds() -> None:
    shares = [compute_composite_degree(value, 1.0, 100.0) for value in (1.0, 10.0, 100.0, -0.1)]
    assert shares == pytest.approx([0.0, 1.0 / 11.0, 1.0, -1.1 / 99.0])


def test_stretched_wires_by_hand() -> None:
    """Unequal ones share a neutral axis; of equal ones that yield it stays in the middle."""
    tables = [solid_wire(), solid_wire("H", modulus=3e11)]
    soft, hard = (table.axial_stiffness for table in tables)
    moment = compute_stretching_moment(np.array([2.0]), np.array([0.0, 4e-3]), np.arange(2), tables)
    assert moment[0] == pytest.approx(2.0 * soft * hard / (soft + hard) * 4e-3**2, rel=1e-9)
    table, y = example_wires()["B2"], np.array([-2e-3, -1e-3, 0.0, 1e-3, 2e-3])
    moment = compute_stretching_moment(np.array([0.5]), y, np.zeros(5, dtype=np.int64), [table])
    plain = 2.0 * (compute_axial_force(table, 0.5 * y[3:]) @ y[3:])
    assert moment[0] == pytest.approx(plain, rel=1e-3)


@pytest.mark.parametrize(("rings", "wires"), [(1, 7), (2, 19), (3, 37)])
def test_hexagons_in_closed_form(rings: int, wires: int) -> None:
    """Sum of squared distances of ring k: k d^2 (5 k^2 + 1), so half of their sum about an axis.

    The second ring: six corners at 2 d and six middles at sqrt(3) d, 24 + 18 = 42 = 2 x 21.
    """
    squares = sum(k * (5 * k**2 + 1) for k in range(1, rings + 1))
    model = compute_bundle_model(bundle(("S", wires)), {"S": solid_wire()})
    own, axial = solid_stiffnesses()
    assert model.high == pytest.approx(wires * own + 0.5 * squares * axial * 1e-6, rel=1e-6)
    assert model.low == pytest.approx(wires * own, rel=1e-6)


def test_against_an_integral_over_drawn_circles() -> None:
    """E y^2 summed over pixels of a drawing, about the centroid of E of the same drawing."""
    rng = np.random.default_rng(8)
    places = 1.2e-3 * find_sites(8) + rng.normal(scale=2e-5, size=(8, 2))
    moduli = np.array([1e11] * 4 + [2e11] * 4)
    radius, step = 0.4e-3, 4e-6
    edge = np.arange(-3e-3, 3e-3, step) + step / 2.0
    x, y = np.meshgrid(edge, edge)
    drawn = np.zeros_like(x)
    for place, modulus in zip(places, moduli, strict=True):
        drawn[np.hypot(x - place[0], y - place[1]) <= radius] = modulus
    drawn *= step**2
    middle = np.sum(drawn * x) / drawn.sum(), np.sum(drawn * y) / drawn.sum()
    about_x, about_y = x - middle[0], y - middle[1]
    pixels = [np.sum(drawn * a * b) for a in (about_x, about_y) for b in (about_x, about_y)]
    own, axial = moduli * np.pi * radius**4 / 4.0, moduli * np.pi * radius**2
    stuck = compute_stick_tensor(places[:, 0], places[:, 1], own, axial)
    assert stuck.tensor.ravel() == pytest.approx(np.array(pixels), rel=2e-3, abs=2e-3 * pixels[0])
    assert stuck.neutral == pytest.approx(middle, abs=2e-7)
    assert stuck.principal == pytest.approx(np.linalg.eigvalsh(stuck.tensor))
    axis = np.array([np.cos(stuck.principal_angle), np.sin(stuck.principal_angle)])
    assert axis @ stuck.tensor @ axis == pytest.approx(stuck.principal[1])
    upright = compute_stick_tensor(np.zeros(2), np.array([-1e-3, 1e-3]), own[:2], axial[:2])
    assert upright.principal_angle == pytest.approx(np.pi / 2.0)


def test_the_sources_claim_with_both_axes() -> None:
    """Documented in docs/explanations/bundle-model.md, N m^2: along x, along y."""
    for (first, second), arrangement, wanted in (
        ((10, 9), "symmetric", [1.526, 1.526]),
        ((10, 9), "asymmetric", [1.467, 1.554]),
        ((9, 10), "symmetric", [1.577, 1.577]),
        ((9, 10), "asymmetric", [1.527, 1.539]),
    ):
        mixed = bundle(("B1", first), ("B2", second), arrangement=arrangement)
        tensor = compute_bundle_model(mixed, example_wires()).tensor
        assert np.diag(tensor) == pytest.approx(wanted, abs=5e-4)
