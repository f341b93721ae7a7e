"""Bounds of bundles against numbers by hand, integrals over drawn circles, and chapter 4's claim.

Section 4.2.3 of the source: an asymmetric bundle of 10 B1 and 9 B2 wires is stiffer than a
symmetric one, since stiffness grows with the distance from the neutral plane.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from labpipe.records.harness_bundle import Bundle, BundleModel, BundleWire
from labpipe.wire.bundle_layout import sites
from labpipe.wire.bundle_model import bundle_model, sticking
from tests.builders.bundles import bundle, example_wires, solid_stiffnesses, solid_wire


@pytest.mark.parametrize(("rings", "wires"), [(1, 7), (2, 19), (3, 37)])
def test_hexagons_in_closed_form(rings: int, wires: int) -> None:
    """Sum of squared distances of ring k: k d^2 (5 k^2 + 1), so half of their sum about an axis.

    The second ring: six corners at 2 d and six middles at sqrt(3) d, 24 + 18 = 42 = 2 x 21.
    """
    squares = sum(k * (5 * k**2 + 1) for k in range(1, rings + 1))
    model = bundle_model(bundle(("S", wires)), {"S": solid_wire()})
    own, axial = solid_stiffnesses()
    assert model.high == pytest.approx(wires * own + 0.5 * squares * axial * 1e-6, rel=1e-6)
    assert model.low == pytest.approx(wires * own, rel=1e-6)


def test_against_an_integral_over_drawn_circles() -> None:
    """E y^2 summed over pixels of a drawing, about the centroid of E of the same drawing."""
    rng = np.random.default_rng(8)
    places = 1.2e-3 * sites(8) + rng.normal(scale=2e-5, size=(8, 2))
    moduli = np.array([1e11] * 4 + [2e11] * 4)
    radius, step = 0.4e-3, 4e-6
    edge = np.arange(-3e-3, 3e-3, step) + step / 2.0
    x, y = np.meshgrid(edge, edge)
    drawn = np.zeros_like(x)
    for place, modulus in zip(places, moduli, strict=True):
        drawn[np.hypot(x - place[0], y - place[1]) <= radius] = modulus
    drawn *= step**2
    about_x, about_y = (each - np.sum(drawn * each) / drawn.sum() for each in (x, y))
    pixels = [np.sum(drawn * a * b) for a in (about_x, about_y) for b in (about_x, about_y)]
    own, axial = moduli * np.pi * radius**4 / 4.0, moduli * np.pi * radius**2
    stuck = sticking(places[:, 0], places[:, 1], own, axial)
    assert stuck.tensor.ravel() == pytest.approx(np.array(pixels), rel=2e-3, abs=2e-3 * pixels[0])


@cache
def mixed(number: tuple[int, int], arrangement: str, diameter: float | None = None) -> BundleModel:
    kinds = tuple(
        BundleWire(name, count, diameter) for name, count in zip(("B1", "B2"), number, strict=True)
    )
    return bundle_model(Bundle(kinds, arrangement), example_wires())


def test_the_sources_claim_with_both_axes() -> None:
    """Documented in docs/explanations/bundle-model.md, N m^2: along x, along y."""
    found = {
        (number, word): np.diag(mixed(number, word).tensor)
        for number in ((10, 9), (9, 10))
        for word in ("symmetric", "asymmetric")
    }
    assert found[(10, 9), "symmetric"] == pytest.approx([1.526, 1.526], abs=5e-4)
    assert found[(10, 9), "asymmetric"] == pytest.approx([1.467, 1.554], abs=5e-4)
    assert found[(9, 10), "symmetric"] == pytest.approx([1.577, 1.577], abs=5e-4)
    assert found[(9, 10), "asymmetric"] == pytest.approx([1.527, 1.539], abs=5e-4)
