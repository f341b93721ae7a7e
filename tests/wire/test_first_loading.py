"""First loading, all points at once: the elastica, separate solvers, and the path by stations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.mechanics.law.plays import LoadingTable, PlayLaw, make_elastic_law, make_polygon_law
from labpipe.mechanics.wire.calibration.calibrate_wire import find_tested_curvature as curvature_of
from labpipe.mechanics.wire.cantilever import (
    CantileverShape,
    StringRig,
    bend_to_deflection,
    bend_to_travel,
    make_straight,
)
from labpipe.mechanics.wire.first_loading import (
    LoadingCurve,
    find_equilibria,
    interpolate_force,
    load_cantilever,
)
from labpipe.records.arrays import Floats
from tests.builders.bilinear_laws import bilinear_law
from tests.builders.cantilevers import hold_level
from tests.builders.loading_tests import DEEPEST, TRUTH, law_of, measured, rig_of, wire_of
from tests.judges.reference_wires import HeavyWire, yielding

LENGTH = 0.085

GOALS = (0.0005, 0.002, 0.005, 0.01, 0.02, 0.035, 0.05)

A2 = law_of(wire_of("A2"), n_plays=60)

LAWS = [make_elastic_law(4e-4), bilinear_law(5e-3, 4e-4, 5e-4), A2]


def curve_of(law: PlayLaw, rig: StringRig | None, deflection: float = 0.055) -> LoadingCurve:
    return load_cantilever(LoadingTable.of_plays(law), LENGTH, rig, 0.0, deflection)


def test_forces_begin_at_rest_and_nan_stays() -> None:
    curve = curve_of(A2, None)
    force, change = interpolate_force(curve, np.array([0.01, 0.0, np.nan]))
    assert force[0] > force[1] == curve.force[0] == 0.0
    assert np.isnan(force[2])
    assert change.shape == (0, 3)


HEAVY_LENGTH, WEIGHT = 0.12, 0.097

RIG = StringRig(0.76, 0.0265, HEAVY_LENGTH, 0.76)

KNOTS: Floats = np.geomspace(1e-7, 2e-2, 300)

LAW = make_polygon_law(yielding(KNOTS), KNOTS)

TABLE = LoadingTable.of_plays(LAW)


@pytest.mark.parametrize("rig", [RIG, None], ids=["string", "end load"])
def test_with_weight_a_separate_solver_finds_the_same(rig: StringRig | None) -> None:
    """All points at once, and the path station by station."""
    string = {} if rig is None else {"string": 0.76, "counterweight": 0.0265}
    other = HeavyWire(yielding, HEAVY_LENGTH, WEIGHT, **string)
    resting = found = other.rest()
    curve = load_cantilever(TABLE, HEAVY_LENGTH, rig, WEIGHT, 0.07)
    if rig is None:
        shape = hold_level(LAW, HEAVY_LENGTH, WEIGHT)
    else:
        state = make_straight(LAW, self_weight=WEIGHT)
        shape = bend_to_travel(LAW, state, HEAVY_LENGTH, rig, 0.0)
    rest, level = pull_of(shape, rig), float(shape.y[-1])
    assert (rest, curve.tension[0]) == pytest.approx([other.pull(resting)] * 2, rel=1e-4)
    assert curve.clamp_moment[0] == pytest.approx(shape.moment[0], rel=1e-4)
    for goal in (0.001, 0.004, 0.02, 0.06):
        if rig is None:
            shape = bend_to_deflection(LAW, shape.state, HEAVY_LENGTH, goal)
        else:
            shape = bend_to_travel(LAW, shape.state, HEAVY_LENGTH, rig, goal)
        deflection = float(shape.y[-1]) - level
        found = other.loaded(resting, float(shape.y[-1]), found)
        wanted = other.pull(found) - other.pull(resting)
        assert pull_of(shape, rig) - rest == pytest.approx(wanted, rel=1e-4)
        assert interpolate_force(curve, np.array([deflection]))[0][0] == pytest.approx(
            wanted, rel=2e-4
        )
        at = find_equilibria(TABLE, HEAVY_LENGTH, rig, WEIGHT, np.array([deflection]))
        assert at.clamp_moment[1] == pytest.approx(shape.moment[0], rel=1e-4, abs=2e-8)


def pull_of(shape: CantileverShape, rig: StringRig | None) -> float:
    return float(shape.force[1] if rig is None else shape.tension)


def test_it_is_that_of_the_path_station_by_station() -> None:
    wire = wire_of("A2")
    law = law_of(wire)
    shape = bend_to_travel(law, make_straight(law), 0.085, rig_of(0.085), DEEPEST)
    curves = [replace(each, deflection=np.clip(each.deflection, 0.0, None)) for each in measured()]
    deepest = max(float(curve.deflection.max()) for curve in curves)
    found = curvature_of(wire, TRUTH, curves)
    bent = float(np.abs(shape.curvature).max()) * deepest / float(shape.y[-1])
    assert found == pytest.approx(bent, rel=0.03)
    assert curvature_of(wire, np.full(3, np.nan), curves) == pytest.approx(found, rel=1e-6)


@pytest.mark.parametrize("weight", [0.0, WEIGHT])
def test_first_loading_ends_where_the_tip_unloads(weight: float) -> None:
    table = LoadingTable.of_plays(make_elastic_law(2e-3))
    curve = load_cantilever(table, HEAVY_LENGTH, None, weight, 0.1)
    assert 0.65 < curve.deflection[-1] / HEAVY_LENGTH < 0.75
    with pytest.raises(
        ValueError, match=r"deflection=0.11 m: the curve .* ends at 0.0[78]\d+ m, where"
    ):
        interpolate_force(curve, np.array([0.01, 0.11]))
    # Away from the pull, the force of this wire with weight differs by up to 12 %.
    with pytest.raises(ValueError, match=r"deflection=-0.001 m: the curve begins at rest"):
        interpolate_force(curve, np.array([0.01, -0.001]))
    with np.errstate(all="ignore"), pytest.raises(ValueError, match="length=nan m: no"):
        load_cantilever(table, np.nan, None, weight, 0.1)


def test_stiffnesses_are_the_slopes_of_the_forces() -> None:
    for table, rig, weight in ((TABLE, RIG, WEIGHT), (LoadingTable.of_plays(A2), RIG, 0.0)):
        at = find_equilibria(table, HEAVY_LENGTH, rig, weight, np.array([0.0099, 0.01, 0.0101]))
        slope = (at.tension[3] - at.tension[1]) / 2e-4
        assert at.stiffness[2] == pytest.approx(slope, rel=1e-3)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("rig", [None, rig_of(LENGTH)], ids=["end load", "string"])
def test_first_loading_is_that_of_the_path_by_stations(law: PlayLaw, rig: StringRig | None) -> None:
    """24 stations, and 64 of the path, straddle the corners of a law."""
    state, rest = make_straight(law), rig.weight if rig else 0.0
    assert curve_of(law, rig).tension[0] == rest
    for goal in GOALS:
        if rig is None:
            shape = bend_to_deflection(law, state, LENGTH, goal)
            load = shape.force[1]
        else:
            shape = bend_to_travel(law, state, LENGTH, rig, goal)
            load = shape.tension - rig.weight
        state = shape.state
        at = find_equilibria(LoadingTable.of_plays(law), LENGTH, rig, 0.0, shape.y[-1:])
        assert at.force[1] == pytest.approx(load, rel=3e-4)
        found = at.tip_angle[1], at.clamp_moment[1]
        assert found == pytest.approx((shape.angle[-1], shape.moment[0]), rel=7e-4)


def test_the_elastica_of_the_textbooks() -> None:
    """P L^2 / EI = 1, 2 and 10: deflection and tip angle (Mattiasson 1981)."""
    for alpha, printed in (
        (1.0, (0.301721, 0.461352)),
        (2.0, (0.493457, 0.781750)),
        (10.0, (0.810609, 1.430286)),
    ):
        table = LoadingTable.of_plays(make_elastic_law(3.0))
        at = find_equilibria(table, 2.0, None, 0.0, np.array([2.0 * printed[0]]))
        assert at.tension[1] * 2.0**2 / 3.0 == pytest.approx(alpha, rel=1e-5)
        assert at.tip_angle[1] == pytest.approx(printed[1], abs=2e-6)


def test_a_string_that_leans_far_pulls_a_soft_wire_straight() -> None:
    """Parts near its tip unload."""
    table, length = LoadingTable.of_plays(bilinear_law(1.2e-4, 4e-5, 1e-4)), 0.45
    at = find_equilibria(table, length, rig_of(length), 0.0, length * np.array([0.3, 0.5, 0.67]))
    assert at.count_loading_points() < 4
