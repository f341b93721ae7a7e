"""Friction between the bounds of a bundle."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from labpipe.law.plays import first_curvature, respond, virgin_plays
from labpipe.records.arrays import Floats
from labpipe.records.harness_bundle import BundleLoop, BundleModel
from labpipe.wire.bundle_friction import Friction, fit_friction, friction_law, friction_moment
from labpipe.wire.bundle_model import bundle_model
from labpipe.wire.end_load_path import end_load_path
from labpipe.wire.wire_table import wire_table
from tests.builders.bundles import bundle, example_wires, solid_stiffnesses, solid_wire

LENGTH = 0.1143


@cache
def pair() -> BundleModel:
    """Two solid wires of 1 mm over the insulation, one above the other."""
    places = ((0.0, -0.5e-3), (0.0, 0.5e-3))
    return bundle_model(bundle(("S", 2), positions=places), {"S": solid_wire()})


@cache
def seven() -> BundleModel:
    return bundle_model(bundle(("B1", 7)), example_wires())


def test_two_wires_by_hand() -> None:
    """Stick until 1 1/m, then half of what they held goes on, until the tape slides at 2 1/m."""
    bending, axial = solid_stiffnesses()
    curvature = np.array([0.5, 1.0, 1.5, 3.0])
    found = friction_moment(curvature, pair(), [solid_wire()], Friction(0.2, 1.0, 2.0, 0.5))
    composite = 0.2 * 2.0 * axial * 0.5e-3**2
    held = composite * np.array([0.5, 1.0, 0.5 * 1.0 + 0.5 * 1.5, 0.5 * 1.0 + 0.5 * 2.0])
    assert found == pytest.approx(2.0 * bending * curvature + held, rel=1e-5)


@settings(max_examples=20, deadline=None)
@given(
    share=st.floats(0.0, 1.0),
    slip=st.floats(1e-2, 10.0),
    slide=st.floats(1e-2, 50.0),
    held=st.floats(0.0, 1.0),
)
def test_between_the_bounds(share: float, slip: float, slide: float, held: float) -> None:
    model, tables = seven(), [example_wires()["B1"]]
    found = friction_moment(model.curvature, model, tables, Friction(share, slip, slide, held))
    upper = model.moment_slip + (model.high - model.free) * model.curvature
    rounding = 1e-9 * upper
    assert np.all(found >= model.moment_slip - rounding)
    assert np.all(found <= upper + rounding)


def test_the_bounds_are_limits() -> None:
    model, tables = seven(), [example_wires()["B1"]]
    none = friction_moment(model.curvature, model, tables, Friction(0.0, 1.0, 1.0, 0.0))
    assert none == pytest.approx(model.moment_slip)
    whole = friction_moment(model.curvature, model, tables, Friction(1.0, 1.0, np.inf, 1.0))
    stuck = (model.high - model.free) * model.curvature
    assert whole == pytest.approx(model.moment_slip + stuck)


def test_loops_follow_masing() -> None:
    model, tables = seven(), [example_wires()["B1"]]
    friction = Friction(0.13, 0.4, 5.0, 0.2)
    law = friction_law(model, tables, friction)
    top = friction_moment(np.array([8.0]), model, tables, friction)
    loaded = respond(law, top, virgin_plays(law, 1))
    for share in (0.3, 0.9, 1.4):
        back = respond(law, (1.0 - share) * top, loaded.plays)
        half = first_curvature(law, 0.5 * share * top)
        assert back.curvature == pytest.approx(loaded.curvature - 2.0 * half, rel=1e-9)


def small_loading(model: BundleModel, friction: Friction, load: float) -> float:
    """Tip deflection of a cantilever at small slopes, by quadrature of the curvature."""
    tables = [example_wires()["B1"]]
    curvature = np.geomspace(1e-4, 40.0, 4000)
    moment = friction_moment(curvature, model, tables, friction)
    x = np.linspace(0.0, LENGTH, 2001)
    bent: Floats = np.interp(load * (LENGTH - x), np.append(0.0, moment), np.append(0.0, curvature))
    return float(np.trapezoid(bent * (LENGTH - x), x))


def test_the_share_held_is_found_again() -> None:
    """Loading of small slopes by quadrature; its unloading, left out, does not matter."""
    model, tables = seven(), [example_wires()["B1"]]
    kink, deflection = 1.8e-3, np.linspace(0.4e-3, 8e-3, 12)
    friction = Friction(0.13, 3.0 * kink / LENGTH**2, np.inf, 0.25)

    def load_at(tip: float) -> float:
        return float(brentq(lambda load: small_loading(model, friction, load) - tip, 1e-6, 2.0))

    # a kink force that says the share exactly
    stiffness = model.free + friction.composite_share * (model.high - model.free)
    force = np.array([load_at(tip) for tip in deflection])
    loop = BundleLoop(
        length=LENGTH,
        deflection=np.append(deflection, deflection[-2]),
        force=np.append(force, 0.0),
        branch=np.append(np.zeros(12, dtype=np.int64), 1),
        kink=(kink, 3.0 * stiffness * kink / LENGTH**3),
        slide=np.inf,
    )
    found = fit_friction(model, tables, loop)
    assert found.composite_share == pytest.approx(0.13)
    assert found.held == pytest.approx(0.25, abs=0.01)
    assert found.error_fitted < 0.01
    assert found.is_held_out.tolist() == [False] * 12 + [True]
    assert found.error_held_out == pytest.approx(found.predicted[-1] / force[-1])


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
        law = friction_law(model, tables, friction)
        return np.append(end_load_path(law, LENGTH, up, n_stations=16).load, 0.0)

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


def loop(branch: list[int], kink: tuple[float, float]) -> BundleLoop:
    deflection = np.array([1e-3, 5e-3, 3e-3, 1e-3])[: len(branch)]
    return BundleLoop(LENGTH, deflection, 50.0 * deflection, np.array(branch), kink, np.inf)


def test_a_bundle_that_is_softer_than_its_wires() -> None:
    with pytest.raises(
        ValueError,
        match=r"^up to the kink the bundle has a bending stiffness of 4978 N mm\^2, its wires that "
        r"slip have 7413 N mm\^2: there is no friction to fit$",
    ):
        fit_friction(seven(), [example_wires()["B1"]], loop([0, 0, 1, 1], (1e-3, 0.01)))


def test_a_bundle_that_was_not_let_go() -> None:
    with pytest.raises(
        ValueError,
        match=r"^the bundle was bent and not let go: a loop needs loading and unloading$",
    ):
        fit_friction(seven(), [example_wires()["B1"]], loop([0, 0], (1e-3, 0.1)))


def test_a_single_wire_has_no_friction() -> None:
    single = bundle_model(bundle(("B1", 1)), example_wires())
    with pytest.raises(ValueError, match=r"^no wire lies off the neutral axis: friction between"):
        friction_moment(np.ones(1), single, [example_wires()["B1"]], Friction(0.1, 1.0, 1.0, 0.0))


def test_bent_beyond_the_laws() -> None:
    short = replace(solid_wire().spec, largest_curvature=0.5)
    table = wire_table(short)
    places = ((0.0, -0.5e-3), (0.0, 0.5e-3))
    model = bundle_model(bundle(("S", 2), positions=places), {"S": table})
    with pytest.raises(ValueError, match=r"bent further than the laws of its wires go$"):
        fit_friction(model, [table], loop([0, 0, 1, 1], (1e-3, 0.02)))


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ((1.1, 1.0, 1.0, 0.0), r"^composite_share=1\.1: allowed are numbers from 0 to 1$"),
        ((0.1, 1.0, 1.0, -0.1), r"^held=-0\.1: allowed are numbers from 0 to 1$"),
        ((0.1, 0.0, 1.0, 0.0), r"^slip_curvature=0\.0: allowed are numbers > 0$"),
        ((0.1, 1.0, np.nan, 0.0), r"^slide_curvature=nan: allowed are numbers > 0$"),
    ],
)
def test_numbers_out_of_range(numbers: tuple[float, float, float, float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Friction(*numbers)
