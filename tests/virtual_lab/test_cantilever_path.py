"""The path: where strings go slack, how exact looking up is, what cycles do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.units import GRAVITY
from labpipe.virtual_lab.cantilever_path import MechanicalPath, solve_path
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, MechanicalTest
from labpipe.wire.cantilever import bend_to_travel

TEST = MechanicalTest(cycles=2)
TWO_STROKES = 2 * TEST.stroke


@pytest.fixture(scope="module")
def path() -> MechanicalPath:
    return solve_path(CantileverScenario().mechanics)


def test_equal_tests_are_solved_once() -> None:
    one, other = (MechanicalTest(cycles=1, steps_per_branch=5) for _ in range(2))
    assert solve_path(one) is solve_path(other)


def test_segments_join_without_a_jump(path: MechanicalPath) -> None:
    for before, after in zip(path.segments[:-1], path.segments[1:], strict=True):
        assert before.progress[-1] == pytest.approx(after.progress[0], abs=1e-12)
        assert before.travel[-1] == pytest.approx(after.travel[0], abs=1e-12)
        assert before.tension[-1] == pytest.approx(after.tension[0], abs=1e-9)
        np.testing.assert_allclose(before.y[-1], after.y[0], atol=1e-10)


def test_travel_is_a_triangle(path: MechanicalPath) -> None:
    progress = np.array([0.0, 0.01, 0.053, 0.1, 0.106, 0.159, 0.318, 1.0])
    wanted = [0.0, 0.01, 0.053, 0.006, 0.0, 0.053, 0.0, 0.0]
    assert path.travel(progress) == pytest.approx(wanted, abs=1e-12)


def test_travel_agrees_with_the_solved_positions(path: MechanicalPath) -> None:
    for segment in path.segments:
        assert path.travel(segment.progress) == pytest.approx(segment.travel, abs=1e-12)


def test_slack_is_the_travel_before_the_first_pull(path: MechanicalPath) -> None:
    slack, first = path.segments[0], path.segments[1]
    assert slack.is_still
    assert slack.travel[-1] == pytest.approx(0.0015, abs=1e-12)
    assert np.all(slack.tension == 0.0)
    assert np.all(first.tension[1:] > 0.0)


def test_without_slack_the_string_carries_the_counterweight() -> None:
    path = solve_path(MechanicalTest(slack=None, cycles=1, steps_per_branch=20))
    assert path.rest.tension == pytest.approx(0.0027 * GRAVITY, rel=1e-9)
    assert np.max(np.abs(path.rest.y)) < 1e-12


def test_string_and_wire_keep_their_lengths(path: MechanicalPath) -> None:
    for segment in path.segments:
        rise = path.rig.anchor_height + segment.travel - segment.y[:, -1]
        span = np.hypot(path.rig.anchor_x - segment.x[:, -1], rise)
        taut = segment.tension > 0.0
        np.testing.assert_allclose(span[taut], 0.76, atol=1e-10)
        assert np.all(span <= 0.76 + 1e-10)


def test_looked_up_points_keep_the_arc_length(path: MechanicalPath) -> None:
    arc = np.linspace(0.0, 0.085, 400)
    x, y, angle = path.points(np.linspace(0.0, 0.318, 50), arc)
    lengths = np.hypot(np.diff(x, axis=1), np.diff(y, axis=1)).sum(axis=1)
    np.testing.assert_allclose(lengths, 0.085, rtol=1e-5)
    np.testing.assert_allclose(
        np.arctan2(np.diff(y, axis=1), np.diff(x, axis=1)),
        0.5 * (angle[:, 1:] + angle[:, :-1]),
        atol=2e-4,
    )


def test_looking_up_between_solved_positions_is_exact_enough(path: MechanicalPath) -> None:
    finer = solve_path(replace(path.test, steps_per_branch=400, cycles=1))
    progress = np.sort(np.random.default_rng(0).uniform(0.0, TWO_STROKES, 5000))
    assert np.max(np.abs(path.deflection(progress) - finer.deflection(progress))) < 1e-6
    assert np.max(np.abs(path.tension(progress) - finer.tension(progress))) < 2e-5
    arc = np.array([0.01, 0.04, 0.081])
    mine, better = path.points(progress, arc), finer.points(progress, arc)
    for coordinate, finer_coordinate in zip(mine[:2], better[:2], strict=True):
        assert np.max(np.abs(coordinate - finer_coordinate)) < 1e-6
    assert np.max(np.abs(mine[2] - better[2])) < 1e-5


def test_more_stations_change_little(path: MechanicalPath) -> None:
    finer = solve_path(replace(path.test, n_stations=96, cycles=1))
    progress = np.linspace(0.0, 0.106, 2000)
    assert np.max(np.abs(path.deflection(progress) - finer.deflection(progress))) < 1e-6
    assert np.max(np.abs(path.tension(progress) - finer.tension(progress))) < 5e-5


def test_default_wire_behaves_like_the_tested_ones(path: MechanicalPath) -> None:
    force = np.array([segment.tension.max() for segment in path.segments])
    assert 1.0 < force.max() < 1.5
    residual = path.deflection(np.array([TWO_STROKES]))[0]
    assert 0.010 < residual < 0.020


def test_repeated_cycles_equal_solved_ones() -> None:
    """The third cycle is a copy of the second; solving it says the same."""
    test = replace(TEST, cycles=3, steps_per_branch=40)
    path, law = solve_path(test), test.wire.law()
    state = path.rest.state
    for segment in path.segments:
        for travel, tension, tip in zip(
            segment.travel, segment.tension, segment.y[:, -1], strict=True
        ):
            shape = bend_to_travel(law, state, test.length, path.rig, float(travel))
            state = shape.state
            assert tension == pytest.approx(shape.tension, abs=1e-8)
            assert tip == pytest.approx(shape.y[-1], abs=1e-10)
