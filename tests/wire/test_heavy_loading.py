"""First loading with weight, all points at once: against the path, and a separate solver."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.loading_table import LoadingTable
from labpipe.law.play_fits import polygon_law
from labpipe.law.plays import LinearLaw
from labpipe.records.arrays import Floats
from labpipe.wire.cantilever import StringRig, bend_to_travel, straight
from labpipe.wire.first_loading import force_at, load_cantilever
from labpipe.wire.heavy_loading import heavy_states, load_heavy
from tests.builders.bilinear_laws import law_of_plays
from tests.judges.reference_wires import HeavyWire, yielding

LENGTH, WEIGHT = 0.12, 0.097
RIG = StringRig(0.76, 0.0265, LENGTH, 0.76)
KNOTS: Floats = np.geomspace(1e-7, 2e-2, 300)
LAW = polygon_law(yielding(KNOTS), KNOTS)
TABLE = LoadingTable.of_plays(LAW)


@pytest.mark.parametrize("rig", [RIG, None])
def test_a_separate_solver_finds_the_same_forces(rig: StringRig | None) -> None:
    string = {} if rig is None else {"string": 0.76, "counterweight": 0.0265}
    other = HeavyWire(yielding, LENGTH, WEIGHT, **string)
    resting = found = other.rest()
    curve = load_heavy(TABLE, LENGTH, rig, WEIGHT, 0.07)
    assert curve.tension[0] == pytest.approx(other.pull(resting), rel=1e-4)
    for deflection in (0.001, 0.004, 0.02, 0.06):
        found = other.loaded(resting, deflection, found)
        force = force_at(curve, np.array([deflection]))[0][0]
        assert force == pytest.approx(other.pull(found) - other.pull(resting), rel=2e-4)


def test_it_is_the_path_station_by_station() -> None:
    state = straight(LAW, self_weight=WEIGHT)
    shape = rest = bend_to_travel(LAW, state, LENGTH, RIG, 0.0)
    curve = load_heavy(TABLE, LENGTH, RIG, WEIGHT, 0.07)
    assert curve.clamp_moment[0] == pytest.approx(rest.moment[0], rel=1e-4)
    for travel in (0.002, 0.008, 0.03, 0.06):
        shape = bend_to_travel(LAW, shape.state, LENGTH, RIG, travel)
        deflection = np.array([shape.y[-1] - rest.y[-1]])
        force = force_at(curve, deflection)[0][0]
        assert force == pytest.approx(shape.tension - rest.tension, rel=1e-4)
        at = heavy_states(TABLE, LENGTH, RIG, WEIGHT, deflection)
        assert at.moment[0, 0] == pytest.approx(shape.moment[0], rel=1e-4)


def test_without_weight_it_is_the_first_integral() -> None:
    exact = load_cantilever(law_of_plays(LAW, 1.2e-2, n_points=200), LENGTH, RIG)
    curve = load_heavy(TABLE, LENGTH, RIG, 0.0, 0.07)
    at = np.array([0.002, 0.01, 0.03, 0.06])
    assert force_at(curve, at)[0] == pytest.approx(force_at(exact, at)[0], rel=2e-4)


def test_it_ends_where_the_tip_unloads() -> None:
    curve = load_heavy(LoadingTable.of_plays(LinearLaw(2e-3)), LENGTH, None, WEIGHT, 0.1)
    assert 0.65 < curve.deflection[-1] / LENGTH < 0.75


def test_the_slope_is_that_of_the_forces() -> None:
    wanted = np.array([0.0099, 0.01, 0.0101])
    at = heavy_states(TABLE, LENGTH, RIG, WEIGHT, wanted)
    slope = (at.tension[2] - at.tension[0]) / 2e-4
    assert at.tension_change[0, 1] == pytest.approx(slope, rel=1e-3)


def test_a_deflection_beyond_the_length_is_refused() -> None:
    with pytest.raises(ValueError, match=r"length=0\.12 m: no equilibrium found up to a def"):
        load_heavy(TABLE, LENGTH, None, WEIGHT, 0.13)
