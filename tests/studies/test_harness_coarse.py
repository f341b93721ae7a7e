"""Whether a harness says that its steps are too coarse, against eight times as many."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.rod.boundaries import Gravity, Held, Plane
from labpipe.rod.path import Reason, RodPath
from labpipe.rod.statics import follow
from labpipe.studies.harness_coarse import (
    ALLOWED,
    coarse_doubt,
    few_elements_doubt,
    kept_rows,
    remembers,
    walked_otherwise,
)
from labpipe.studies.harness_line import Laid
from labpipe.studies.harness_numbers import numbers_of
from tests.builders.rods import LENGTH, clamp, linear_section, sliding_section, straight_line

CORNERS = LENGTH * np.array(
    [[1, 0, 0], [0.9, 0.24, 0], [0.9, 0.24, 0.24], [0.9, 0, 0.24], [0.9, -0.2, 0], [0.9, 0.1, 0]]
)


def led_round(steps: int) -> Laid:
    """The end of a line with sliders is led round a space polygon, in steps for each side."""
    line = straight_line(LENGTH, 12, sliding_section())
    at = np.linspace(0.0, 5.0, 5 * steps + 1)
    way = np.column_stack([np.interp(at, range(6), axis) for axis in CORNERS.T])
    return Laid(line, (replace(clamp(line), name="foot"), Held(-1, way, name="end")), {})


def followed(ready: Laid, steps: int) -> RodPath:
    return follow(ready.line, ready.boundaries, steps=steps)


def truths(ready: Laid, steps: int) -> dict[str, float]:
    return {each.name: each.value for each in numbers_of(followed(ready, steps), ready)}


@pytest.mark.slow
def test_it_speaks_of_all_numbers_that_are_off() -> None:
    truth = truths(led_round(32), 160)
    for steps in (1, 2, 4, 16):
        ready = led_round(steps)
        path = followed(ready, 5 * steps)
        doubt = coarse_doubt(path, ready, walked_otherwise(ready, 5 * steps), {})
        numbers = {each.name: each.value for each in numbers_of(path, ready)}
        names = ("force.foot", "moment.foot", "energy_lost", "kept_curvature")
        off = {name: abs(numbers[name] / truth[name] - 1.0) / ALLOWED for name in names}
        said = set() if doubt is None else set(doubt.names)
        assert {name for name, share in off.items() if share > 1.2} <= said, (steps, off)


@pytest.mark.slow
def test_it_is_silent_where_few_steps_do() -> None:
    """An end that goes straight and does not turn back, in space: eight steps are enough."""
    truth = truths(_bent_over(64), 64)
    ready = _bent_over(8)
    path = followed(ready, 8)
    for each in numbers_of(path, ready):
        assert each.value == pytest.approx(truth[each.name], rel=ALLOWED, abs=1e-6)
    assert coarse_doubt(path, ready, walked_otherwise(ready, 8), {}) is None


def _bent_over(steps: int) -> Laid:
    line = straight_line(LENGTH, 12, sliding_section())
    share = np.linspace(0.0, 1.0, steps + 1)[:, None]
    way = line.positions[-1] + share * LENGTH * np.array([-0.2, 0.3, 0.1])
    return Laid(line, (replace(clamp(line), name="foot"), Held(-1, way, name="end")), {})


@pytest.mark.slow
def test_it_says_where_and_how_many_steps_should_do() -> None:
    ready = led_round(2)
    doubt = coarse_doubt(followed(ready, 10), ready, walked_otherwise(ready, 10), {})
    assert doubt is not None
    assert doubt.reason.code == "too_coarse"
    assert doubt.reason.message.startswith("half as many steps change it by more than 2 % (or ")
    assert ", most at step 10, 0 mm from the start: 10 steps are too few; " in doubt.reason.message
    wide = {name: Interval(-1e6, 1e6, 0.95) for name in doubt.names}
    assert coarse_doubt(followed(ready, 10), ready, walked_otherwise(ready, 10), wide) is None


def _arched(elements: int) -> Laid:
    """A line without memory between two clamps, one brought nearer and lifted."""
    line = straight_line(LENGTH, elements, linear_section(mass=0.02))
    share = np.linspace(0.2, 1.0, 9)[:, None]
    way = line.positions[-1] + share * LENGTH * np.array([-0.35, 0.1, 0.2])
    near = replace(clamp(line), name="near")
    end = Held(-1, way, line.frames[-1:], name="far")
    return Laid(line, (near, end, Gravity(name="weight")), {})


@pytest.mark.slow
def test_numbers_that_more_elements_would_change_are_doubtful() -> None:
    """Those of 160 elements are the truth: where one is off by more than 2 % that is said."""
    truth = truths(_arched(160), 8)
    for elements in (6, 10, 40):
        ready = _arched(elements)
        path = followed(ready, 8)
        doubt = few_elements_doubt(path, ready, _arched(elements // 2), {})
        named = set() if doubt is None else set(doubt.names)
        off = {
            each.name
            for each in numbers_of(path, ready)
            if not each.is_signed
            and abs(each.value - truth[each.name]) > ALLOWED * truth[each.name]
        }
        assert off <= named
        assert bool(named) is (elements < 40)
        if doubt is not None and elements == 10:
            assert doubt.reason.code == "coarse_elements"
            wanted = int(doubt.reason.message.split("too few; ")[1].split()[0])
            again = _arched(wanted)
            enough = few_elements_doubt(followed(again, 8), again, _arched(wanted // 2), {})
            assert enough is None


def test_a_walk_of_corners_alone_is_halved() -> None:
    ready = led_round(1)
    other = walked_otherwise(ready, 5)
    assert other.words == "twice as many"
    np.testing.assert_allclose(other.times, np.arange(11) / 2.0)
    np.testing.assert_allclose(_path(other.laid)[::2], _path(ready))
    middles = 0.5 * (_path(ready)[1:] + _path(ready)[:-1])
    np.testing.assert_allclose(_path(other.laid)[1::2], middles)


def _path(ready: Laid) -> Floats:
    end = ready.boundaries[1]
    assert isinstance(end, Held)
    return end.position


def test_corners_and_releases_are_kept() -> None:
    ready = led_round(4)
    assert kept_rows(ready.boundaries, 20).tolist() == list(range(0, 21, 2))
    uneven = led_round(3)
    assert kept_rows(uneven.boundaries, 15).tolist() == [0, 2, 3, 5, 6, 8, 9, 11, 12, 14, 15]
    grip = Held(-1, np.zeros(3), release=8)
    assert kept_rows([grip], 12).tolist() == [0, 2, 4, 6, 7, 8, 10, 12]
    line = ready.line
    frames = np.tile(line.frames[:1], (13, 1))
    assert kept_rows([Held(-1, np.zeros(3), frames)], 12).tolist() == list(range(0, 13, 2))


def test_a_release_stays_where_it_was() -> None:
    line = straight_line(LENGTH, 8, sliding_section())
    way = line.positions[-1] + np.linspace(0.0, 1.0, 10)[:, None] * [-0.03, 0.1, 0.0]
    path = np.concatenate([way, way[-1:]])
    ready = Laid(line, (clamp(line), Held(-1, path, release=10)), {})
    other = walked_otherwise(ready, 10)
    grip = other.laid.boundaries[1]
    assert isinstance(grip, Held)
    assert other.times.tolist() == [0, 2, 4, 6, 8, 9, 10]
    assert grip.release == 6


@pytest.mark.slow
def test_a_line_that_cannot_be_followed_otherwise_is_doubtful_throughout() -> None:
    ready = led_round(2)
    other = walked_otherwise(ready, 10)
    why = Reason("torn", "step 2: torn", 2)
    other = replace(other, path=replace(other.path, status="failed", reasons=(why,)))
    path = followed(ready, 10)
    doubt = coarse_doubt(path, ready, other, {})
    assert doubt is not None
    assert set(doubt.names) == {each.name for each in numbers_of(path, ready)}
    assert "the line cannot be followed (torn)" in doubt.reason.message
    assert doubt.reason.message.endswith("take 20")


@pytest.mark.parametrize(("friction", "does"), [(0.0, False), (0.3, True)])
def test_sliders_and_friction_remember(friction: float, does: bool) -> None:
    line = straight_line(LENGTH, 4, linear_section(mass=0.01))
    table = Plane(np.zeros(3), friction=friction)
    assert remembers(Laid(line, (table, Gravity()), {})) is does
    assert remembers(led_round(1))
