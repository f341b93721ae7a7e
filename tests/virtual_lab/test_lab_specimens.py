"""Virtual wires and bundles against the wire model, sliders, and truths known by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from labpipe.mechanics.law.plays import find_corners
from labpipe.mechanics.wire.bending_law import compute_moment_curve, compute_stick_stiffness
from labpipe.virtual_lab.cantilever_scenarios import (
    build_taped_scenario,
    evaluate_bundle,
    find_kink,
    solve_path,
)
from labpipe.virtual_lab.specimens import TAPED_TYPES, WIRES, BundleModel, StrandedWire, lay_wires
from tests.judges.reference_wires import bend_along

EVERY = pytest.mark.parametrize("wire", WIRES.values(), ids=WIRES)


@EVERY
def test_first_loading_is_that_of_the_wire_model(wire: StrandedWire) -> None:
    law = wire.build_law()
    curvature = np.geomspace(1e-3, 70.0, 200)
    moment = compute_moment_curve(wire.build_section(), wire.build_contacts(), curvature).moment
    curvatures = law.respond(moment, law.make_unbent_history(len(moment))).curvature
    assert curvatures == pytest.approx(curvature, rel=2e-3)  # a polygon between its corners
    assert law.stiffness == pytest.approx(compute_stick_stiffness(wire.build_section()), rel=1e-3)


@EVERY
def test_unloading_is_that_of_sliders_and_kinematic_plasticity(wire: StrandedWire) -> None:
    law, section, contacts = wire.build_law(), wire.build_section(), wire.build_contacts()
    loading, unloading = np.linspace(0.3, 29.0, 97), np.linspace(29.0, -5.0, 140)[1:]
    path = bend_along(section, contacts, np.concatenate([loading, unloading]))
    top, down = path[len(loading) - 1], path[len(loading) :]
    history = law.respond(np.array([top]), law.make_unbent_history(1)).history
    curvatures = law.respond(down, np.repeat(history, len(down), axis=0)).curvature
    moment = np.interp(unloading[::-1], curvatures[::-1], down[::-1])[::-1]
    assert np.max(np.abs(moment - down)) < 1e-3 * top


def test_seven_wires_by_hand() -> None:
    """Six around one at a diameter d: the sum of y^2 is 3 d^2, whatever the orientation."""
    wire = WIRES["B1"]
    copper = 7 * np.pi * wire.strand**2 / 4
    rigid = 110e9 * copper * 3 * wire.diameter**2
    wires = 7 * replace(wire, n_plays=24).build_law().stiffness
    bundle = BundleModel((("B1", 7),))
    by_hand = {
        "rigid": wires + rigid, "friction": 0.14 * rigid, "glue": 0.018 * rigid, "wires": wires,
    }  # fmt: skip
    stiffnesses = {name: bundle.stiffnesses[name] for name in by_hand}
    assert stiffnesses == pytest.approx(by_hand, rel=1e-12)
    assert bundle.radius == pytest.approx(1.5 * wire.diameter, rel=1e-12)


def test_slips_where_it_is_said_to() -> None:
    """Wires at the root mean square distance slip at the stated curvature, others in proportion."""
    bundle = BundleModel()
    distances = np.abs(lay_wires(bundle).y)
    distances = distances[distances > 1e-9]
    mean = np.sqrt(np.mean(distances**2))
    _, bent, _ = find_corners(bundle.build_law())
    for curvature in bundle.slip_curvature * mean / np.unique(distances.round(9)):
        assert np.min(np.abs(bent - curvature)) < 1e-6 * curvature
    assert bundle.glue_strain is not None
    assert np.min(np.abs(bent - bundle.glue_strain / bundle.radius)) < 1e-6


@pytest.mark.parametrize("arrangement", ["packed", "symmetric", "asymmetric"])
def test_wires_do_not_overlap_and_balance(arrangement: str) -> None:
    bundle = BundleModel((("B1", 10), ("B2", 9)), arrangement)
    layout = lay_wires(bundle)
    gaps = np.hypot(np.subtract.outer(layout.x, layout.x), np.subtract.outer(layout.y, layout.y))
    touching = 0.5 * np.add.outer(layout.diameter, layout.diameter)
    np.fill_diagonal(gaps, 1.0)
    assert np.all(gaps >= touching - 1e-9)
    assert layout.axial_stiffness @ layout.y == pytest.approx(0.0, abs=1e-9)
    assert np.sum(layout.diameter == 1.1e-3) == 10


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (BundleModel((("B1", 8),)).build_law, r"expected a number that fills shells .*, found 8"),
        (replace(WIRES["A2"], wall=0.4e-3).build_section, r"strands overlap the bore"),
        (replace(WIRES["B1"], wall=0.3e-3).build_section, r"the .* m that the strands need"),
    ],
)
def test_what_cannot_be_built(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_two_lines_are_found_where_they_join() -> None:
    """300 N/m, then 60, then 3."""
    grid = np.linspace(0.0, 0.05, 50_001)
    force = 300.0 * grid - 240.0 * np.maximum(grid - 0.002, 0.0)
    kink = find_kink(grid, force - 57.0 * np.maximum(grid - 0.035, 0.0), 0.2e-3, 5e-3)
    assert kink["displacement"] == pytest.approx(0.002, abs=1e-7)
    assert kink["force"] == pytest.approx(0.6, abs=1e-5)
    assert kink["stiffness_before"] == pytest.approx(300.0, rel=1e-4)
    assert kink["stiffness_after"] == pytest.approx(60.0, rel=1e-4)


def test_a_bundle_in_the_rig() -> None:
    bundle = TAPED_TYPES["TWB-B1-19-PVC"]
    test = build_taped_scenario("TWB-B1-19-PVC", cycles=2).mechanics
    truth = evaluate_bundle(solve_path(test))
    # A straight elastic beam: 3 EI / L^3; the counterweight's string adds next to nothing.
    linear = 3.0 * bundle.build_law().stiffness / test.length**3
    assert truth["loading"]["tangent_at_zero"] == pytest.approx(linear, rel=0.01)
    assert 1.5e-3 < truth["loading"]["kink"]["displacement"] < 2.5e-3
    plateau = truth["loading"]["plateau_displacement"]
    assert plateau is not None
    assert 0.033 < plateau < 0.037
    windowed = truth["loading"]["windowed_stiffness"]
    assert truth["bending_stiffness"] == pytest.approx(windowed * test.length**3 / 3.0)
    assert truth["loading_stiffness"][0] == pytest.approx(truth["loading"]["stiffness"], rel=1e-3)
    assert truth["hardening"][0] == 1.0
    assert (
        truth["hardening"][1] == truth["loading_stiffness"][1] / truth["loading_stiffness"][0] > 1.3
    )
