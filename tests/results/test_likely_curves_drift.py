"""A zero of the force that wanders during a test, by hand: what it changes of each number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.causes import DRIFT_OF_ZERO, STEP
from labpipe.records.curve import ClockFit, Interval
from labpipe.records.signals import Clocks
from labpipe.results.cycles import PeakDisplacement, PeakForce
from labpipe.results.evidence import Evidence
from labpipe.results.likely_curves import likely_curves
from labpipe.results.stiffness import LineStiffness
from labpipe.uncertainty.intervals import Measured, measure
from labpipe.uncertainty.readings import Reading, Trace
from labpipe.uncertainty.replicates import Input, Replicates
from tests.builders.plain_records import Numbers
from tests.builders.reduced import recorded

SHARE, PEAK, WAY, COUNT = 0.01, 80.0, 8e-3, 2001
PLACES = np.pi * np.array([0.5, 1.5, 2.5])
"""Of the first three modes of a random walk."""
SCALE = SHARE * PEAK / np.sqrt(np.sum(PLACES**-2.0))


def straight(share: float = SHARE, spread: float = 0.0) -> Evidence:
    """80 N along 8 mm in 20 s, from its zero on."""
    tau = np.linspace(0.0, 1.0, COUNT)
    force = PEAK * tau + np.random.default_rng(0).normal(0.0, spread, COUNT)
    return drifting(recorded(20.0 * tau, WAY * tau, force), share)


def drifting(test: Evidence, share: float) -> Evidence:
    raw = replace(test.signals.raw["force"], zero_drift=share)
    return replace(test, signals=test.signals.with_new("force", raw))


def curves(test: Evidence) -> Replicates:
    found = likely_curves(test)
    assert found is not None
    return found


def modes(test: Evidence) -> list[Input]:
    return [each for each in curves(test).inputs if each.cause == DRIFT_OF_ZERO]


def drift_of(test: Evidence, numbers: Numbers) -> float:
    found = measure(curves(test), lambda trace: Reading(numbers, len(trace.time)))
    assert isinstance(found, tuple)
    (number,) = found
    return next(abs(row.change) for row in number.budget if row.cause == DRIFT_OF_ZERO)


def top(trace: Trace) -> tuple[Floats]:
    return (trace.force.max(axis=-1),)


def first(trace: Trace) -> tuple[Floats]:
    return (trace.force[..., 0],)


def last(trace: Trace) -> tuple[Floats]:
    return (trace.force[..., -1],)


def mean(trace: Trace) -> tuple[Floats]:
    return (trace.force.mean(axis=-1),)


def work(trace: Trace) -> tuple[Floats]:
    return (np.asarray(np.trapezoid(trace.force, trace.displacement, axis=-1)),)


def slope(trace: Trace) -> tuple[Floats]:
    lever = trace.displacement - trace.displacement.mean(axis=-1, keepdims=True)
    return (np.sum(lever * trace.force, axis=-1) / np.sum(lever**2, axis=-1),)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_force_at_the_end_is_off_by_what_is_stated(sign: float) -> None:
    """A share of the largest force, which a push counts downwards."""
    time, way, force = (
        getattr(straight().known_curve, x) for x in ("time", "displacement", "force")
    )
    test = drifting(recorded(time, way, sign * force), SHARE)
    assert drift_of(test, last) == pytest.approx(SHARE * PEAK, rel=1e-9)


def test_a_mean_and_an_energy() -> None:
    """The mean of sin(p t) / p is 1 / p^2; of a whole walk a third of the variance at its end."""
    expected = SCALE * np.sqrt(np.sum(PLACES**-4.0))
    assert drift_of(straight(), mean) == pytest.approx(expected, rel=1e-3)
    assert drift_of(straight(), work) == pytest.approx(WAY * expected, rel=1e-3)
    assert expected == pytest.approx(SHARE * PEAK / np.sqrt(3.0), rel=0.04)


def test_a_stiffness() -> None:
    """12 times the mean of (t - 1/2) sin(p t) / p; of a whole walk 6/5 of the variance."""
    signs = np.array([1.0, -1.0, 1.0])
    each = 12.0 * (signs / PLACES**3 - 0.5 / PLACES**2)
    expected = SCALE / WAY * np.sqrt(np.sum(each**2))
    assert drift_of(straight(), slope) == pytest.approx(expected, rel=1e-3)
    assert expected == pytest.approx(SHARE * PEAK / WAY * np.sqrt(1.2), rel=0.05)


def test_the_frame_gives_way_to_a_force_that_is_not_there() -> None:
    test = replace(straight(), compliance=4e-5)
    trace = curves(test).smooth
    for given in modes(test):
        moved = given.moved(trace, -2.0)
        more, less = moved.force - trace.force, moved.displacement - trace.displacement
        assert np.ptp(more) > 0.01 * PEAK * SHARE
        assert less == pytest.approx(-4e-5 * more, abs=1e-15)


def test_it_is_counted_from_where_the_zero_was_taken() -> None:
    """At the end of the record, as the mean of a rest or as the end of a line: it began off."""
    test = straight()
    rested = replace(test.signals, zeroed={"force": (19.0, 21.0)})
    for signals in (rested, replace(test.signals, lined={"force": (19.0, 20.0)})):
        late = replace(test, signals=signals)
        assert drift_of(late, first) == pytest.approx(SHARE * PEAK, rel=1e-9)
        ends = [given.moved(curves(late).smooth, 1.0).force[-1] for given in modes(late)]
        assert ends == pytest.approx([PEAK] * 3, abs=1e-9)


def test_a_line_at_the_start_has_its_zero_at_its_outer_end() -> None:
    test = straight()
    early = replace(test, signals=replace(test.signals, lined={"force": (0.0, 4.0)}))
    assert drift_of(early, top) == pytest.approx(SHARE * PEAK, rel=1e-9)
    starts = [given.moved(curves(early).smooth, 1.0).force[0] for given in modes(early)]
    assert starts == pytest.approx([0.0] * 3, abs=1e-9)


def test_a_zero_from_a_rest_on_the_clock_of_the_force() -> None:
    """Taken around 2 s of the motion: 3 s of a clock that is 1 s ahead."""
    test, sure = straight(), Interval(0.0, 0.0)
    events, errors = np.array([0.0, 10.0]), np.full(2, 1e-3)
    fit = ClockFit(1.0, 0.0, sure, sure, 0.0, events, events + 1.0, errors, "by hand")
    raw = replace(test.signals.raw["force"], clock="force", time=test.known_curve.time + 1.0)
    signals = replace(test.signals.with_new("force", raw), zeroed={"force": (2.5, 3.5)})
    test = replace(test, signals=signals, clocks=Clocks("one", fit), unfiltered=raw)
    trace = curves(test).smooth
    for given in modes(test):
        assert given.moved(trace, 1.0).force[200] == pytest.approx(trace.force[200], abs=1e-9)
    total = np.sum([(g.moved(trace, 1.0).force - trace.force) ** 2 for g in modes(test)], axis=0)
    assert np.sqrt(total[-1]) == pytest.approx(SHARE * float(trace.force.max()), rel=1e-3)


def test_a_zero_that_stands_still_is_no_input() -> None:
    assert {each.cause for each in curves(straight(0.0)).inputs} == {STEP}


def test_it_adds_to_what_there_was_and_changes_nothing_else() -> None:
    """Noise and other inputs are drawn as before; the modes independently of one another."""
    still, moved = curves(straight(0.0, 0.5)), curves(straight(SHARE, 0.5))
    assert np.array_equal(still.force, moved.force)
    (step,) = still.inputs
    again = next(each for each in moved.inputs if each.cause == STEP)
    assert np.array_equal(still.draws(step), moved.draws(again))
    drawn = [moved.draws(each) for each in moved.inputs if each.cause == DRIFT_OF_ZERO]
    assert np.abs(np.corrcoef(drawn) - np.eye(3)).max() < 0.15
    one, other = (
        measure(each, lambda trace: Reading(mean, len(trace.time))) for each in (still, moved)
    )
    assert isinstance(one, tuple)
    assert isinstance(other, tuple)
    more = SCALE * drawn[0] / PLACES[0] ** 2
    assert np.std(other[0].off - one[0].off - more) < 0.15 * np.std(more)
    assert other[0].value == one[0].value


@pytest.mark.parametrize("share", [1.0, 30.0])
def test_a_drift_as_large_as_the_force_makes_numbers_wide_or_doubtful(share: float) -> None:
    """And thirty times as large: never NaN, never a width that is too small."""
    test = straight(share, 0.5)
    test = replace(test, replicates=curves(test))
    kinds = LineStiffness(start=1e-3, stop=4e-3), PeakDisplacement(), PeakForce()
    for number in (each for kind in kinds for each in kind.compute(test).numbers):
        found = number.outcome
        assert isinstance(found, Measured)
        assert np.isfinite([found.interval.lower, found.interval.upper, found.estimate]).all()
        assert found.doubts or found.interval.upper - found.interval.lower > found.value
