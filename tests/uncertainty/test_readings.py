"""Numbers that are made of others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.estimates import Failure
from labpipe.uncertainty.readings import Reading, Trace, combined
from tests.builders.noisy_curves import trace_of

TRACE = trace_of(np.array([1.0, 2.0, 6.0]), np.array([0.0, 1.0, 2.0]), sizes={"length": 4.0})


def largest(trace: Trace) -> Reading:
    del trace
    return Reading(lambda each: (each.force.max(axis=-1), each.force.min(axis=-1)), 3)


def reach(trace: Trace) -> Reading:
    del trace
    return Reading(lambda each: (each.displacement.max(axis=-1),), 2)


def shared(trace: Trace, force: Floats, way: Floats) -> Floats:
    return force / way * trace.sizes["length"]


def test_a_finer_curve_is_the_same_curve() -> None:
    way = np.array([0.0, np.nan, 2.0, 4.0])
    trace = replace(trace_of(np.array([1.0, 2.0, 6.0, 0.0]), way), failed_at=2)
    first, second = trace.branches[0], trace.branches[0]
    both = replace(first, start=0, stop=3), replace(second, start=2, stop=4)
    finer = replace(trace, branches=both).finer(2)
    assert finer.force.tolist() == [1.0, 1.5, 2.0, 4.0, 6.0, 3.0, 0.0]
    assert finer.time == pytest.approx(0.005 * np.arange(7))
    assert np.isnan(finer.displacement[1:4]).all()
    assert finer.displacement[[0, 4, 5, 6]].tolist() == [0.0, 2.0, 3.0, 4.0]
    assert [(each.start, each.stop) for each in finer.branches] == [(0, 5), (4, 7)]
    assert finer.failed_at == 4
    assert trace.finer(1) is trace
    assert (trace.steps, finer.steps, finer.finer(3).steps) == (1, 2, 6)


def test_a_number_of_parts_is_cut_if_all_of_them_are() -> None:
    def cut(trace: Trace) -> Reading:
        return replace(reach(trace), is_cut=True)

    for other, expected in ((cut, True), (reach, False)):
        found = combined(shared, cut, other)(TRACE)
        assert isinstance(found, Reading)
        assert found.is_cut == expected


def test_a_number_is_made_of_the_first_of_each_part() -> None:
    found = combined(shared, largest, reach)(TRACE)
    assert isinstance(found, Reading)
    assert found.n == 3
    assert found.numbers(TRACE)[0] == 6.0 / 2.0 * 4.0
    force = np.array([[1.0, 2.0, 3.0], [2.0, 8.0, 4.0]])
    way = np.array([[0.0, 1.0, 2.0], [0.0, 1.0, 4.0]])
    many = Trace(TRACE.time, way, force, sizes=TRACE.sizes)
    assert found.numbers(many)[0].tolist() == [6.0, 8.0]


def test_in_noise_each_part_is_read_as_in_noise() -> None:
    """What moves the samples that are read, where that is said; else the numbers themselves."""

    def moved(trace: Trace) -> Reading:
        del trace
        return Reading(
            lambda each: (each.force.max(axis=-1),), 3, lambda each: (each.force[..., 0],)
        )

    assert moved(TRACE).drawn(TRACE)[0] == 1.0
    assert largest(TRACE).drawn(TRACE)[0] == 6.0
    found = combined(shared, moved, reach)(TRACE)
    assert isinstance(found, Reading)
    assert found.numbers(TRACE)[0] == 12.0
    assert found.drawn(TRACE)[0] == 2.0


def test_without_one_part_there_is_no_number() -> None:
    why, later = Failure("no_peak", "none"), Failure("no_reach", "none")
    assert combined(shared, largest, lambda _: later)(TRACE) is later
    assert combined(shared, lambda _: why, lambda _: later)(TRACE) is why


def test_a_trace_without_more() -> None:
    trace = Trace(TRACE.time, TRACE.displacement, TRACE.force)
    assert (trace.branches, trace.failed_at, dict(trace.sizes), trace.beyond) == ((), None, {}, 0.0)
