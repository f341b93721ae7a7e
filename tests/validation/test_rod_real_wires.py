"""Wires that others hung between clamps and twisted: fits of the rod, and of models without it.

Bending stiffness from the shape under the wire's own weight, free curvature from how asymmetric it
is, torsional stiffness from the turn of a clamp at which the loop snaps over.
"""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest

from tests.builders.arm_poses import POSES, distances, posed
from tests.builders.arm_poses import seen as seen_poses
from tests.builders.real_wires import (
    BLACK,
    WHITE,
    RealWire,
    by_elastica,
    mean_hang,
)
from tests.judges.rod_fits import (
    Hang,
    HangFit,
    fit_hang,
    fit_torsion,
    mean_of,
    snap_turn,
)

pytestmark = pytest.mark.slow


Seen: TypeAlias = tuple[list[Hang], list[HangFit]]


def seen(wire: RealWire, folder: Path) -> Seen:
    hangs = wire.hangs(folder)
    return hangs, [fit_hang(each) for each in hangs]


@pytest.fixture(scope="module")
def white(realdata: Path) -> Seen:
    return seen(WHITE, realdata)


@pytest.fixture(scope="module")
def black(realdata: Path) -> Seen:
    return seen(BLACK, realdata)


@pytest.mark.realdata
def test_the_elastica_fits_the_same(white: Seen, black: Seen) -> None:
    """Nothing of the rod is in it."""
    for hangs, fits in (white, black):
        by_other = fit_hang(hangs[0], hanging=by_elastica, blocks=0)
        assert fits[0].stiffness == pytest.approx(by_other.stiffness, rel=8e-3)
        assert fits[0].natural == pytest.approx(by_other.natural, abs=0.05)


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("wire", "stiffness", "half_width", "torsion", "with_slope"),
    [(WHITE, 0.793e-4, 0.17e-4, 0.988, 0.997), (BLACK, 0.827e-3, 0.20e-3, 1.63, 1.42)],
    ids=["white", "black"],
)
def test_stiffness_and_torsion(
    wire: RealWire,
    stiffness: float,
    half_width: float,
    torsion: float,
    with_slope: float,
    realdata: Path,
) -> None:
    """The black wire's free curvature helps it to snap over: a seventh of its torsion."""
    hangs, fits = seen(wire, realdata)
    found, hang, turns = wire.stiffness_of(hangs, fits), mean_hang(hangs), np.radians(wire.snaps)
    assert found.value == pytest.approx(stiffness, rel=0.01)
    assert found.half_width == pytest.approx(half_width, rel=0.05)
    assert fit_torsion(hang, turns, found).value == pytest.approx(torsion, rel=0.01)
    slope = mean_of([fit.natural[0] for fit in fits])
    assert fit_torsion(hang, turns, found, [slope]).value == pytest.approx(with_slope, rel=0.01)


@pytest.mark.realdata
def test_the_white_loop_snaps_over_as_measured(realdata: Path) -> None:
    """At the stiffnesses that are published."""
    hang = mean_hang(WHITE.hangs(realdata))
    turn, _ = snap_turn(hang, 0.793e-4, 0.988 * 0.793e-4)
    assert np.degrees(turn) == pytest.approx(np.mean(WHITE.snaps), abs=3.0)


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("wire", "torsion", "most"), [(WHITE, 0.793e-4, [7e-3] * 4), (BLACK, 1.17e-3, [11e-3] * 3)]
)
def test_poses_in_space(wire: RealWire, torsion: float, most: list[float], realdata: Path) -> None:
    """Stiffnesses of other tests, nothing fitted; in its last pose the black wire snapped over."""
    stiffness = 0.793e-4 if wire is WHITE else 0.827e-3
    for pose, points, bound in zip(POSES, seen_poses(wire, realdata), most, strict=False):
        path = posed(wire, pose, points[-1], stiffness, torsion)
        assert path.status != "failed"
        assert float(distances(points, path).mean()) < bound
