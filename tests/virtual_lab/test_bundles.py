"""The law of a bundle: by hand for seven wires, between its bounds, in order of slip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.law.plays import corners_of, first_curvature
from labpipe.virtual_lab.bundles import BundleModel, lay_wires
from labpipe.virtual_lab.specimens import WIRES

SEVEN = BundleModel((("B1", 7),))
NINETEEN = BundleModel()


def tangent_at(bundle: BundleModel, curvature: float) -> float:
    """Slope of the first loading just above a curvature, N m^2."""
    _, bent, slopes = corners_of(bundle.law())
    return float(1.0 / slopes[np.searchsorted(bent, curvature, side="right") - 1])


def test_seven_wires_by_hand() -> None:
    """Six around one at a diameter d: the sum of y^2 is 3 d^2, whatever the orientation."""
    wire = WIRES["B1"]
    copper = 7 * np.pi * wire.strand**2 / 4
    rigid = 110e9 * copper * 3 * wire.diameter**2
    own = 7 * replace(wire, n_plays=24).law().stiffness
    found = SEVEN.stiffnesses
    assert found["rigid"] - found["wires"] == pytest.approx(rigid, rel=1e-12)
    assert found["friction"] == pytest.approx(0.14 * rigid, rel=1e-12)
    assert found["glue"] == pytest.approx(0.018 * rigid, rel=1e-12)
    assert found["wires"] == pytest.approx(own, rel=1e-12)
    assert SEVEN.radius == pytest.approx(1.5 * wire.diameter, rel=1e-12)


@pytest.mark.parametrize("number", [7, 12, 19])
def test_starts_with_the_sum_of_its_parts_and_ends_with_its_wires(number: int) -> None:
    bundle = BundleModel((("B2", number),))
    parts = bundle.stiffnesses
    law = bundle.law()
    assert law.stiffness == pytest.approx(parts["initial"], rel=1e-6)
    assert parts["wires"] < parts["initial"] < parts["rigid"]
    wire = replace(WIRES["B2"], n_plays=24).law()
    slopes = corners_of(wire)[2]
    assert tangent_at(bundle, 70.0) == pytest.approx(number / slopes[-1], rel=1e-3)


def test_slips_where_it_is_said_to() -> None:
    """Wires at the root mean square distance slip at the stated curvature, others in proportion."""
    y = np.unique(np.round(np.abs(lay_wires(NINETEEN).y), 9))[1:]
    all_of_them = np.abs(lay_wires(NINETEEN).y)
    mean = np.sqrt(np.mean(all_of_them[all_of_them > 1e-9] ** 2))
    _, bent, _ = corners_of(NINETEEN.law())
    for curvature in NINETEEN.slip_curvature * mean / y:
        assert np.min(np.abs(bent - curvature)) < 1e-6 * curvature
    glue = NINETEEN.glue_strain
    assert glue is not None
    assert np.min(np.abs(bent - glue / NINETEEN.radius)) < 1e-6


def test_glue_that_holds_leaves_no_corner() -> None:
    pet = replace(NINETEEN, glue_strain=None)
    kept = tangent_at(pet, 20.0) - tangent_at(NINETEEN, 20.0)
    assert kept == pytest.approx(NINETEEN.stiffnesses["glue"], rel=1e-3)
    assert pet.held(100.0) == 1.0


def test_samples_scale_all_moments() -> None:
    moment = np.array([0.01, 0.05, 0.2])
    scaled = first_curvature(NINETEEN.scaled(1.1).law(), 1.1 * moment)
    assert scaled == pytest.approx(first_curvature(NINETEEN.law(), moment), rel=1e-12)


def test_locks_after_the_first_cycle_and_lets_go_where_the_tape_slides() -> None:
    first, second = NINETEEN.law(), NINETEEN.law(2)
    assert second.stiffness == first.stiffness
    assert second.half_widths == pytest.approx(1.05 * first.half_widths, rel=1e-12)
    limit = 0.028 / NINETEEN.radius
    assert NINETEEN.held(limit) == 1.0
    assert NINETEEN.held(2.0 * limit) == pytest.approx(0.92, rel=1e-12)
    assert NINETEEN.held(100.0 * limit) == 0.5


@pytest.mark.parametrize("arrangement", ["packed", "symmetric", "asymmetric"])
def test_wires_do_not_overlap_and_balance(arrangement: str) -> None:
    bundle = BundleModel((("B1", 10), ("B2", 9)), arrangement)
    layout = lay_wires(bundle)
    gaps = np.hypot(np.subtract.outer(layout.x, layout.x), np.subtract.outer(layout.y, layout.y))
    touching = 0.5 * np.add.outer(layout.diameter, layout.diameter)
    np.fill_diagonal(gaps, 1.0)
    assert np.all(gaps >= touching - 1e-9)
    assert layout.axial @ layout.y == pytest.approx(0.0, abs=1e-9)
    assert np.sum(layout.diameter == 1.1e-3) == 10


def test_kinds_lie_on_one_side_or_all_around() -> None:
    """Centres of both kinds: far apart only where they are asked to be."""
    apart = {}
    for arrangement in ("symmetric", "asymmetric"):
        layout = lay_wires(BundleModel((("B1", 10), ("B2", 9)), arrangement))
        apart[arrangement] = np.mean(layout.y[10:]) - np.mean(layout.y[:10])
    assert apart["asymmetric"] > 2e-3
    assert abs(apart["symmetric"]) < 0.5e-3


@pytest.mark.parametrize(
    ("bundle", "message"),
    [
        (BundleModel((("Z9", 7),)), r"allowed are one or two kinds of A1, A2, A3, B1, B2"),
        (BundleModel((("B1", 8),)), r"8 wires: allowed are numbers that fill shells"),
        (BundleModel((("B1", 7),), "loose"), r"arrangement='loose'.*allowed are packed"),
        (BundleModel((("B1", 7),), locking=0.9), r"locking=0.9: allowed are .* numbers >= 1"),
    ],
)
def test_what_is_no_bundle(bundle: BundleModel, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        bundle.law()
