from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.mechanics.rod.boundaries import Gravity, Held, Plane
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.studies.harness_line import PreparedLine
from labpipe.mechanics.studies.harness_numbers import (
    MAX_ERROR,
    Doubt,
    compute_numbers,
    depends_on_history,
    find_change_doubt,
    select_coarse_steps,
    solve_with_resampled_steps,
)
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.records.result import Status
from tests.builders.rods import LENGTH, clamp, linear_section, sliding_section, straight_line

CORNERS = LENGTH * np.array(
    [[1, 0, 0], [0.9, 0.24, 0], [0.9, 0.24, 0.24], [0.9, 0, 0.24], [0.9, -0.2, 0], [0.9, 0.1, 0]]
)


def led(path: Floats, *, elements: int = 12) -> PreparedLine:
    """A line with sliders whose end is led along a way."""
    line = straight_line(LENGTH, elements, sliding_section())
    return PreparedLine(line, (replace(clamp(line), name="foot"), Held(-1, path, name="end")))


def led_round(steps: int, *, elements: int = 12) -> PreparedLine:
    """Its end is led round a space polygon, in steps for each side."""
    times = np.linspace(0.0, 5.0, 5 * steps + 1)
    path = np.column_stack([np.interp(times, range(6), axis) for axis in CORNERS.T])
    return led(path, elements=elements)


def arched(elements: int) -> PreparedLine:
    """A line without memory between two clamps, one brought nearer and lifted."""
    line = straight_line(LENGTH, elements, linear_section(mass=0.02))
    share = np.linspace(0.2, 1.0, 9)[:, None]
    path = line.positions[-1] + share * LENGTH * np.array([-0.35, 0.1, 0.2])
    end = Held(-1, path, line.frames[-1:], name="far")
    return PreparedLine(line, (replace(clamp(line), name="near"), end, Gravity(name="weight")))


def walk(prepared: PreparedLine, steps: int) -> tuple[RodPath, dict[str, float]]:
    path = follow(*prepared, steps=steps)
    return path, compute_numbers(path)


def doubt_of(prepared: PreparedLine, steps: int, **intervals: Interval) -> Doubt | None:
    path, _ = walk(prepared, steps)
    other, other_path = solve_with_resampled_steps(prepared, steps)
    return find_change_doubt(path, other_path, intervals, changed="steps", n_other=other)


def element_doubt_of(path: RodPath, elements: int) -> Doubt | None:
    """Of an arched line, compared with one of fewer elements."""
    coarse_path, _ = walk(arched(elements), 8)
    return find_change_doubt(path, coarse_path, {}, changed="elements", n_other=elements)


def number_names(doubt: Doubt | None) -> set[str]:
    return set() if doubt is None else set(doubt.names)


@pytest.mark.slow
def test_it_speaks_of_all_numbers_that_are_off() -> None:
    _, truth = walk(led_round(32), 160)
    for steps in (1, 2, 4, 16):
        prepared = led_round(steps)
        _, numbers = walk(prepared, 5 * steps)
        names = ("force.foot", "moment.foot", "energy_lost", "kept_curvature")
        errors = {name: abs(numbers[name] / truth[name] - 1.0) / MAX_ERROR for name in names}
        named = number_names(doubt_of(prepared, 5 * steps))
        assert {name for name, share in errors.items() if share > 1.2} <= named, (steps, errors)


@pytest.mark.slow
def test_it_says_where_and_how_many_steps_should_do() -> None:
    prepared = led_round(2)
    doubt = doubt_of(prepared, 10)
    assert doubt is not None
    assert doubt.reason.code == "too_coarse"
    assert doubt.reason.message.startswith("with 5 instead of 10 steps it changes by more than 2 %")
    assert "; moment.foot changes most: 10 steps are too few; take " in doubt.reason.message
    wide = dict.fromkeys(doubt.names, Interval(-1e6, 1e6, 0.95))
    assert doubt_of(prepared, 10, **wide) is None
    path, numbers = walk(prepared, 10)
    other, other_path = solve_with_resampled_steps(prepared, 10)
    torn = replace(other_path, status=Status.FAILED, reasons=(Reason("torn", "it is torn"),))
    doubt = find_change_doubt(path, torn, {}, changed="steps", n_other=other)
    assert doubt is not None
    assert set(doubt.names) == set(numbers)
    assert "the line cannot be solved (torn)" in doubt.reason.message
    assert doubt.reason.message.endswith("take 20")


@pytest.mark.slow
def test_numbers_that_more_elements_would_change_are_doubtful() -> None:
    """Those of 160 elements are the truth: a deviation of more than 2 % is reported."""
    _, truth = walk(arched(160), 8)
    for elements in (6, 10, 40):
        prepared = arched(elements)
        path, _ = walk(prepared, 8)
        doubt = element_doubt_of(path, elements // 2)
        inaccurate = {
            name
            for name, value in compute_numbers(path).items()
            if name != "lowest_point" and abs(value - truth[name]) > MAX_ERROR * truth[name]
        }
        assert inaccurate <= number_names(doubt)
        assert (doubt is None) is (elements == 40)
        if doubt is not None and elements == 10:
            assert doubt.reason.code == "coarse_elements"
            n_elements = int(doubt.reason.message.split("too few; take ")[1].split()[0])
            path, _ = walk(arched(n_elements), 8)
            assert element_doubt_of(path, n_elements // 2) is None


def way_of(prepared: PreparedLine | RodPath) -> Held:
    end = prepared.boundaries[1]
    assert isinstance(end, Held)
    return end


def test_a_walk_of_corners_alone_is_halved() -> None:
    prepared = led_round(1, elements=3)
    steps, finer_path = solve_with_resampled_steps(prepared, 5)
    assert steps == 10
    path, finer = way_of(prepared).position, way_of(finer_path).position
    np.testing.assert_allclose(finer[::2], path)
    np.testing.assert_allclose(finer[1::2], 0.5 * (path[1:] + path[:-1]))


def test_corners_and_releases_are_kept() -> None:
    prepared = led_round(4)
    assert select_coarse_steps(prepared.boundaries, 20).tolist() == list(range(0, 21, 2))
    uneven = led_round(3)
    assert select_coarse_steps(uneven.boundaries, 15).tolist() == [
        0,
        2,
        3,
        5,
        6,
        8,
        9,
        11,
        12,
        14,
        15,
    ]
    grip = Held(-1, np.zeros(3), release=8)
    assert select_coarse_steps([grip], 12).tolist() == [0, 2, 4, 6, 7, 8, 10, 12]
    frames = np.tile(prepared.line.frames[:1], (13, 1))
    assert select_coarse_steps([Held(-1, np.zeros(3), frames)], 12).tolist() == list(
        range(0, 13, 2)
    )


def test_a_release_stays_where_it_was() -> None:
    path = np.array([LENGTH, 0.0, 0.0]) + np.linspace(0.0, 1.0, 10)[:, None] * [
        -0.03,
        0.1,
        0.0,
    ]
    prepared = led(np.concatenate([path, path[-1:]]), elements=3)
    grip = replace(way_of(prepared), release=10)
    steps, coarse_path = solve_with_resampled_steps(
        PreparedLine(prepared.line, (prepared.boundaries[0], grip)), 10
    )
    assert steps == 6, "0, 2, 4, 6, 8, 9, 10"
    assert way_of(coarse_path).release == 6


def test_sliders_and_friction_remember() -> None:
    line = straight_line(LENGTH, 4, linear_section(mass=0.01))
    for friction in (0.0, 0.3):
        table = Plane(np.zeros(3), friction=friction)
        assert depends_on_history(PreparedLine(line, (table, Gravity()))) is bool(friction)
    assert depends_on_history(led_round(1))
