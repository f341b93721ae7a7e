"""Wires that others hung between clamps and twisted: fits of the rod, and of models without it.

Bending stiffness from the shape under the wire's own weight, free curvature from how asymmetric it
is, torsional stiffness from the turn of a clamp at which the loop snaps over.
"""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

from labpipe.records.arrays import Floats
from tests.builders.arm_poses import POSES, distances, posed
from tests.builders.arm_poses import seen as seen_poses
from tests.builders.real_wires import (
    BLACK,
    WHITE,
    RealWire,
    by_elastica,
    mean_hang,
    snap_by_loop,
)
from tests.judges.hung_wires import HungElastica
from tests.judges.rod_fits import (
    Estimate,
    Hang,
    HangFit,
    fit_hang,
    mean_of,
)
from tests.judges.rod_snaps import fit_torsion, snap_turn
from tests.judges.twisted_loops import TwistedLoop

pytestmark = pytest.mark.slow

LOOP = HungElastica(1.5, 0.17, 0.8e-4, (-0.123, 0.002))


def collocated(loop: HungElastica, places: Floats) -> Floats:
    """The loop by scipy's collocation, shape (places, 2): forces and moments, no energy."""
    stiffness, weight, length = loop.stiffness, loop.weight, loop.length

    def slopes(_: Floats, y: Floats) -> Floats:
        angle, bend, across, lift = y[:4]
        moment = across * np.sin(angle) - lift * np.cos(angle)
        zero = np.zeros_like(angle)
        rows = [bend, moment / stiffness, zero, zero + weight, np.cos(angle), np.sin(angle)]
        return np.array(rows)

    def ends(a: Floats, b: Floats) -> Floats:
        x, z = loop.chord
        return np.array([a[0], a[4], a[5], b[0] + 2 * np.pi, b[4] - x, b[5] - z])

    s = np.linspace(0, length, loop.pieces + 1)
    angles = loop.angles()
    middle = np.interp(s, (np.arange(loop.pieces) + 0.5) * loop.piece, angles)
    points = loop.shape().T
    lift = weight * (s - length / 2)
    start = np.array([middle, np.gradient(middle, s), 0 * s, lift, *points])
    found = solve_bvp(slopes, ends, s, start, tol=1e-8, max_nodes=20_000)
    assert found.success
    return np.asarray(found.sol(places * length)[4:6].T)


def test_the_elastica_is_the_one_of_collocation() -> None:
    """Of second order in the length of a piece."""
    places = np.linspace(0, 1, 51)
    exact = collocated(LOOP, places)
    off = {}
    for pieces in (100, 200):
        loop = HungElastica(LOOP.length, LOOP.weight, LOOP.stiffness, LOOP.chord, pieces=pieces)
        off[pieces] = float(np.abs(loop.at(places) - exact).max())
    assert off[200] < 1e-3
    assert off[100] / off[200] == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("torsion", [0.5, 1.0])
def test_the_twisted_loop_buckles_as_michells_ring(torsion: float) -> None:
    """A turn of 2 pi sqrt(3) B / C, of second order; the first eigenvalue is the free spin."""
    exact = 2 * np.pi * np.sqrt(3) / torsion
    off = {}
    for pieces in (40, 80):
        ring = TwistedLoop(HungElastica(2 * np.pi, 0.0, 1.0, (0.0, 0.0), pieces=pieces), torsion)

        def second(turn: float, ring: TwistedLoop = ring) -> float:
            return float(ring.least_eigenvalues(ring.flat(), np.zeros(3), turn, 2)[1])

        off[pieces] = brentq(second, 0.9 * exact, 1.2 * exact) / exact - 1
    assert off[80] == pytest.approx(0.0, abs=6e-3)
    assert off[40] / off[80] == pytest.approx(4.0, rel=0.1)


def test_the_twisted_loop_is_the_slope_of_its_energy() -> None:
    """Equilibrium away from the plane: no small change of directions lowers the energy."""
    loop = TwistedLoop(HungElastica(1.5, 0.17, 0.8e-4, (-0.123, 0.0), pieces=60), 0.8e-4)
    ways, pull, turn = loop.flat(), np.zeros(3), 0.0
    for turn in np.radians([100.0, 200.0, 300.0, 400.0, 500.0, 600.0]):
        found = loop.equilibrium(ways, pull, turn)
        assert found is not None
        ways, pull = found
    assert np.abs(loop.points(ways)[:, 1]).max() > 0.02
    rng = np.random.default_rng(20261122)
    for _ in range(5):
        change = rng.normal(size=ways.shape)
        change -= np.sum(change * ways, axis=1)[:, None] * ways
        here, there = (
            loop.energy(moved / np.linalg.norm(moved, axis=1)[:, None], pull, turn)
            for moved in (ways - 1e-4 * change, ways + 1e-4 * change)
        )
        assert abs(there - here) / 2e-4 < 1e-6 * abs(loop.energy(ways, pull, turn))


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
def test_stiffness_of_the_white_wire(white: Seen) -> None:
    found = WHITE.stiffness_of(*white)
    assert found.value == pytest.approx(0.793e-4, rel=0.01)
    assert found.half_width == pytest.approx(0.17e-4, rel=0.05)
    assert max(float(each.distances.mean()) for each in white[1]) < 4.1e-3


@pytest.mark.realdata
def test_stiffness_of_the_black_wire(black: Seen) -> None:
    found = BLACK.stiffness_of(*black)
    assert found.value == pytest.approx(0.827e-3, rel=0.01)
    assert found.half_width == pytest.approx(0.20e-3, rel=0.05)


@pytest.mark.realdata
def test_the_elastica_fits_the_same(white: Seen, black: Seen) -> None:
    """Nothing of the rod is in it."""
    for hangs, fits in (white, black):
        by_other = fit_hang(hangs[0], hanging=by_elastica, blocks=0)
        assert fits[0].stiffness == pytest.approx(by_other.stiffness, rel=8e-3)
        assert fits[0].natural == pytest.approx(by_other.natural, abs=0.05)


@pytest.mark.realdata
def test_black_is_asymmetric_by_its_free_curvature(black: Seen) -> None:
    """One slope of free curvature fits four of five hangs, and takes more than half the misfit."""
    hangs, fits = black
    slopes = np.array([each.natural[0] for each in fits])
    assert slopes[:4] == pytest.approx(5.4, abs=0.6)
    assert slopes[4] < 1.0
    for hang, fit in list(zip(hangs, fits, strict=True))[:4]:
        straight = fit_hang(hang, terms=0, blocks=0)
        assert fit.distances.mean() < 0.45 * straight.distances.mean()


@pytest.mark.realdata
def test_points_are_not_independent(white: Seen, black: Seen) -> None:
    """Scatter alone would make the interval too narrow."""
    for wire, (hangs, fits) in ((WHITE, white), (BLACK, black)):
        assert min(each.alike for each in fits) > 0.8
        found = wire.stiffness_of(hangs, fits)
        scatter = Estimate(found.value, found.parts[:1])
        assert scatter.half_width < 0.98 * found.half_width


@pytest.mark.realdata
def test_the_white_loop_snaps_over_as_measured(realdata: Path) -> None:
    """Rod and loop of directions, at the stiffnesses that are published."""
    hang = mean_hang(WHITE.hangs(realdata))
    stiffness, ratio = 0.793e-4, 0.988
    by_rod = np.degrees(snap_turn(hang, stiffness, ratio * stiffness))
    by_loop = np.degrees(snap_by_loop(hang, stiffness, ratio))
    assert by_rod == pytest.approx(np.mean(WHITE.snaps), abs=3.0)
    assert by_loop == pytest.approx(by_rod, rel=6e-3)


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("wire", "straight", "curved"), [(WHITE, 0.988, 0.997), (BLACK, 1.63, 1.42)]
)
def test_torsion(wire: RealWire, straight: float, curved: float, realdata: Path) -> None:
    """The black wire's free curvature helps it to snap over: a seventh of its torsion."""
    hangs, fits = seen(wire, realdata)
    stiffness, hang = wire.stiffness_of(hangs, fits), mean_hang(hangs)
    turns = np.radians(wire.snaps)
    slope = mean_of([each.natural[0] for each in fits])
    assert fit_torsion(hang, turns, stiffness).value == pytest.approx(straight, rel=0.01)
    assert fit_torsion(hang, turns, stiffness, [slope]).value == pytest.approx(curved, rel=0.01)


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("curl", "degrees"),
    [
        ((1.0, 0.0), 473.5),
        ((-1.0, 0.0), 474.5),
        ((0.0, 1.0), 470.5),
        ((0.0, -1.0), 485.5),
        ((2.0, 0.0), 388.5),
    ],
)
def test_the_black_loop_turns_by_a_curl_that_its_hangs_do_not_show(
    curl: tuple[float, float], degrees: float, realdata: Path
) -> None:
    """480.5 degrees without; by 2 1/m in its plane it snaps over in another way."""
    hang = mean_hang(BLACK.hangs(realdata))
    turn = snap_turn(hang, 0.827e-3, 1.42 * 0.827e-3, (4.5,), curl=curl)
    assert np.degrees(turn) == pytest.approx(degrees, abs=2.0)


@pytest.mark.realdata
def test_poses_of_the_white_wire_in_space(realdata: Path) -> None:
    """With stiffnesses of other tests, nothing fitted; points are good to 5 % of 400 mm."""
    stiffness, torsion = 0.793e-4, 0.793e-4
    for pose, points in zip(POSES, seen_poses(WHITE, realdata), strict=True):
        path = posed(WHITE, pose, points[-1], stiffness, torsion)
        assert path.status == "ok"
        off = float(distances(points, path).mean())
        assert off < 7e-3
    other_way = posed(
        WHITE, POSES[1], seen_poses(WHITE, realdata)[1][-1], stiffness, torsion, twist=-1.0
    )
    assert float(distances(seen_poses(WHITE, realdata)[1], other_way).mean()) > 3 * 7e-3


@pytest.mark.realdata
def test_poses_of_the_black_wire_in_space(realdata: Path) -> None:
    """The last one snapped over: the wire lies on itself in the picture."""
    stiffness, torsion = 0.827e-3, 1.17e-3
    off = []
    for pose, points in zip(POSES, seen_poses(BLACK, realdata), strict=True):
        path = posed(BLACK, pose, points[-1], stiffness, torsion)
        off.append(float(distances(points, path).mean()))
    assert max(off[:3]) < 11e-3
    assert off[3] > 20e-3
    assert max(path.snapped) > 40
