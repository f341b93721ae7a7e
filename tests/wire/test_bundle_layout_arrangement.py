"""Where the wires of a bundle lie."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.harness_bundle import ARRANGEMENTS, BundleLayout
from labpipe.wire.bundle_layout import arrange
from labpipe.wire.cross_section import largest_overlap
from tests.builders.bundles import bundle

DIAMETERS, STIFFNESS = (1.10e-3, 1.25e-3), (37e3, 52e3)


def centres(layout: BundleLayout) -> np.ndarray:
    return np.column_stack([layout.x, layout.y])


def test_nineteen_wires_are_a_hexagon() -> None:
    layout = arrange(bundle(("B1", 19)), DIAMETERS[:1], STIFFNESS[:1])
    assert layout.radius == pytest.approx(2.5 * 1.10e-3)
    assert largest_overlap(centres(layout), layout.diameter / 2.0) < 1e-12
    assert layout.arrangement == "packed"


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_mixed_bundles(arrangement: str) -> None:
    layout = arrange(bundle(("B1", 10), ("B2", 9), arrangement=arrangement), DIAMETERS, STIFFNESS)
    assert layout.kind.tolist() == [0] * 10 + [1] * 9
    assert layout.diameter == pytest.approx(np.repeat(DIAMETERS, [10, 9]))
    assert largest_overlap(centres(layout), layout.diameter / 2.0) < 1e-12
    centroid = np.average(centres(layout), axis=0, weights=layout.diameter**2)
    assert centroid == pytest.approx([0.0, 0.0], abs=1e-9)
    assert 2.5 * 1.10e-3 < layout.radius < 2.5 * 1.25e-3
    reach = np.hypot(*centres(layout).T) + layout.diameter / 2.0
    assert layout.radius == pytest.approx(reach.max())


@pytest.mark.parametrize("diameters", [DIAMETERS, (1.10e-3, 1.1005e-3)])
def test_every_wire_touches_another(diameters: tuple[float, float]) -> None:
    """Half a micrometre makes wires unequal, too."""
    layout = arrange(bundle(("B1", 10), ("B2", 9), arrangement="asymmetric"), diameters, STIFFNESS)
    gap = np.hypot(*(centres(layout)[:, None] - centres(layout)[None]).transpose(2, 0, 1))
    gap -= 0.5 * (layout.diameter[:, None] + layout.diameter)
    np.fill_diagonal(gap, np.inf)
    assert gap.min(axis=1).max() < 1e-8


def test_stiffer_wires_of_an_asymmetric_bundle_lie_above() -> None:
    mixed = bundle(("B1", 10), ("B2", 9), arrangement="asymmetric")
    layout = arrange(mixed, DIAMETERS, STIFFNESS)
    assert layout.y[layout.kind == 1].mean() > 1e-3 > 0.0 > layout.y[layout.kind == 0].mean()


def test_same_seed_same_layout() -> None:
    mixed = bundle(("B1", 5), ("B2", 4))
    once, again, other = (arrange(mixed, DIAMETERS, STIFFNESS, seed=seed) for seed in (4, 4, 5))
    assert np.array_equal(once.x, again.x)
    assert not np.array_equal(once.x, other.x)


def test_stated_positions_are_kept_about_their_centroid() -> None:
    stated = bundle(("B1", 2), positions=((1e-3, 0.0), (1e-3, 2e-3)))
    layout = arrange(stated, DIAMETERS[:1], STIFFNESS[:1])
    assert layout.arrangement == "stated"
    assert (layout.x.tolist(), layout.y.tolist()) == ([0.0, 0.0], [-1e-3, 1e-3])
    assert layout.radius == pytest.approx(1.55e-3)


def test_stated_positions_that_overlap() -> None:
    stated = bundle(("B1", 3), positions=((0.0, 0.0), (2e-3, 0.0), (1e-3, 0.0)))
    with pytest.raises(
        ValueError, match=r"^wires 1 and 3 overlap by 0\.1 mm, allowed is 0\.011 mm$"
    ):
        arrange(stated, DIAMETERS[:1], STIFFNESS[:1])


def test_insulation_gives_a_little() -> None:
    stated = bundle(("B1", 2), positions=((0.0, 0.0), (1.092e-3, 0.0)))
    assert arrange(stated, DIAMETERS[:1], STIFFNESS[:1]).arrangement == "stated"


def test_too_few_positions() -> None:
    stated = bundle(("B1", 3), positions=((0.0, 0.0),))
    with pytest.raises(ValueError, match=r"^1 positions for 3 wires: allowed is one for each$"):
        arrange(stated, DIAMETERS[:1], STIFFNESS[:1])
