"""Numbers of cycles from a loop whose numbers are known."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.causes import SCALE_OF_FORCE
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.result import Status
from labpipe.results.cycles import _when, stretch_of_cycle
from tests.builders.reduced import loop, reduced

TRUTH = {
    "peak_force": 1.0,
    "peak_displacement": 0.010,
    "unloading_stiffness": 125.0,
    "energy": 0.5 * 1.0 * 0.010 - 0.5 * 1.0 * 0.008,
    "residual_displacement": 0.002,
}


@pytest.mark.parametrize("name", sorted(TRUTH))
@pytest.mark.parametrize("cycle", [1, 2])
def test_numbers(name: str, cycle: int) -> None:
    _, results = reduced(*loop(noise=1e-3))
    found = results[f"{name}.{cycle}"]
    assert found.status is Status.OK
    assert found.value == pytest.approx(TRUTH[name], rel=0.02)
    assert found.interval is not None
    assert found.interval.lower < found.interval.upper
    assert found.n > 8
    assert found.method


def test_initial_stiffness_has_no_cycle() -> None:
    _, results = reduced(*loop(noise=1e-3))
    assert results["initial_stiffness"].value == pytest.approx(100.0, rel=0.01)
    assert results["initial_stiffness"].unit == "N/m"


@pytest.mark.parametrize("name", ["peak_force.1", "unloading_stiffness.1", "energy.1"])
def test_uncertain_gain_is_in_the_interval(name: str) -> None:
    _, results = reduced(*loop(noise=1e-4))
    interval, value = results[name].interval, results[name].value
    assert interval is not None
    assert value is not None
    (scale,) = (each.change for each in results[name].budget if each.cause == SCALE_OF_FORCE)
    assert scale == pytest.approx(0.01 * value, rel=1e-3)
    # Widths of 400 draws repeat within 5 %.
    assert interval.standard_error >= 0.95 * scale


def test_not_reached() -> None:
    more = "results:\n  - {result: initial-stiffness, from: 1 mm, to: 40 mm}\n"
    _, results = reduced(*loop(), more=more)
    found = results["initial_stiffness"]
    assert (found.value, found.status) == (None, Status.FAILED)
    assert found.why.startswith("not_reached: the branch reaches 0.00998 m, 0.04 m is asked; ")
    assert "'results.initial-stiffness.to: {value: 9." in found.why


def test_loading_alone_has_no_loop() -> None:
    time, path, force = loop(cycles=1, noise=1e-3)
    kept = time < 11.9
    _, results = reduced(time[kept], path[kept], force[kept])
    for name in ("energy.1", "residual_displacement.1", "unloading_stiffness.1"):
        assert results[name].why == "partial_cycle: the cycle has no unloading branch"
    found = results["peak_force.1"]
    assert found.status is Status.DOUBTFUL
    assert found.why.startswith("partial_cycle: the record ends at 11.8")
    assert found.why.endswith("while still loading")
    assert results["initial_stiffness"].status is Status.OK


def held_at_the_top(time: Floats, path: Floats, force: Floats) -> tuple[Floats, Floats]:
    held = time > 12.0
    noise = np.random.default_rng(1).normal(0.0, 1e-3, len(time))
    return np.where(held, 0.010 + 1e-3 * noise, path), np.where(held, 1.0 + noise, force)


def test_loading_that_ends_in_a_rest_is_whole() -> None:
    time, path, force = loop(cycles=1, noise=1e-3)
    _, results = reduced(time, *held_at_the_top(time, path, force))
    assert results["peak_force.1"].status is Status.OK
    assert results["peak_displacement.1"].value == pytest.approx(0.010, rel=5e-3)


def test_record_that_breaks_off_while_unloading() -> None:
    time, path, force = loop(cycles=2, noise=1e-3)
    kept = time < 38.0
    _, results = reduced(time[kept], path[kept], force[kept])
    assert results["energy.2"].status is Status.DOUBTFUL
    assert results["energy.2"].why.endswith("while still unloading")
    assert results["peak_force.2"].status is Status.OK
    assert results["energy.1"].status is Status.OK


def test_downwards_is_a_way_to_load() -> None:
    time, path, force = loop(noise=1e-3)
    _, up = reduced(time, path, force)
    _, down = reduced(time, -path, -force)
    for name in ("peak_force.1", "peak_displacement.2"):
        above, below = up[name].value, down[name].value
        assert above is not None
        assert below == pytest.approx(-above, rel=1e-9)
    for name in ("energy.1", "energy.2"):
        assert down[name].value == pytest.approx(up[name].value, rel=1e-9)


def test_a_gap_costs_only_its_cycle() -> None:
    time, path, force = loop(noise=1e-3)
    force[(time > 15.0) & (time < 15.1)] = np.nan
    _, results = reduced(time, path, force)
    assert results["energy.1"].why.startswith("gap: 4 samples of the cycle have no force")
    assert results["energy.2"].value == pytest.approx(TRUTH["energy"], rel=0.02)
    assert results["energy.2"].status is Status.OK
    assert results["initial_stiffness"].status is Status.OK
    assert results["peak_displacement.1"].status is Status.OK


def test_nothing_moves() -> None:
    time, path, force = loop(noise=1e-3)
    _, results = reduced(time, 0.01 * path, force)
    assert {each.value for each in results.values()} == {None}
    assert results["peak_force.1"].why.startswith("no_motion: the motion spans 0.1")


def test_cycles_part_where_a_waiting_motion_is_farthest() -> None:
    """Between the cycles the motion waits for samples 5 to 8, and is lowest at 6."""
    way = np.array([0.0, 1.0, 2.0, 1.0, 0.2, 0.1, -0.1, 0.1, 0.2, 1.0, 2.0, 1.0, 0.0])
    branches = (
        Branch(0, 2, 1, Direction.LOADING, 0.0, 2.0),
        Branch(2, 5, 1, Direction.UNLOADING, 2.0, 4.0),
        Branch(8, 10, 2, Direction.LOADING, 8.0, 10.0),
        Branch(10, 13, 2, Direction.UNLOADING, 10.0, 12.0),
    )
    flags = np.zeros(13, int)
    for sense in (1.0, -1.0):
        curve = Curve(np.arange(13.0), sense * way, way, flags, flags, branches)
        assert stretch_of_cycle(curve, [*branches[:2]]) == slice(0, 7)
        assert stretch_of_cycle(curve, [*branches[2:]]) == slice(6, 13)


@pytest.mark.parametrize(
    ("reads", "stretch"),
    [
        ((0.0, 1.0), (0.0, 2.0)),
        ((1.0, 2.0), (2.0, 5.0)),
        ((0.5, 1.5), (1.0, 3.5)),
        ((0.0, 2.0), (0.0, 5.0)),
        ((0.0, 3.0), (0.0, 5.0)),
        ((2.0, 3.0), None),
    ],
)
def test_parts_of_a_cycle_counted_in_branches(
    reads: tuple[float, float], stretch: tuple[float, float] | None
) -> None:
    """Loaded for 2 s, unloaded for 3 s."""
    up = Branch(0, 2, 1, Direction.LOADING, 0.0, 2.0)
    down = Branch(2, 5, 1, Direction.UNLOADING, 2.0, 5.0)
    assert _when([up, down], reads) == stretch
