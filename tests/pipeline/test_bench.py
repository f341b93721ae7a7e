from __future__ import annotations

import numpy as np
import pytest

from labpipe.pipeline.bench import Bench, Signal, rms
from labpipe.records.curve import Branch, ClockFit, Curve, Direction, Interval
from labpipe.records.quality import Reason, Severity
from tests.builders.doubts import doubted


def test_notes_are_written_down_once() -> None:
    bench = Bench()
    for _ in range(2):
        bench.note("a", Severity.INFO, "force", "b")
    assert len(bench.notes) == 1


def test_first_doubt_and_first_block_count() -> None:
    bench = Bench()
    bench.doubt("clock", "a", "one", where="align")
    bench.doubt("clock", "b", "two", where="align")
    bench.block("c", "three", where="align")
    bench.block("d", "four", where="align")
    assert doubted(bench) == {"clock": "a: one"}
    assert bench.blocked == Reason("c", "three")
    severities = [note.severity for note in bench.notes]
    assert severities == [Severity.WARNING, Severity.WARNING, Severity.ERROR, Severity.ERROR]


def located() -> Bench:
    """A force on a clock 10 s ahead of the motion's, in doubt from 40 s to 42 s."""
    time = np.arange(0.0, 100.0)
    bench = Bench()
    for name, clock in (("force", "force"), ("displacement", "markers")):
        bench.raw[name] = bench.signals[name] = Signal(time, time, "N", clock)
    bench.doubt("force", "frozen", "stands", where="force", during=(40.0, 42.0), clock="force")
    return bench


def test_an_event_touches_what_lies_over_it_and_nothing_else() -> None:
    bench = located()
    assert bench.why_doubtful("force", (41.0, 60.0)) == (Reason("frozen", "stands"),)
    assert bench.why_doubtful("force", (0.0, 39.0)) == ()
    assert bench.why_doubtful("displacement", (41.0, 60.0)) == ()
    assert bench.why_doubtful("force") == (Reason("frozen", "stands"),)


def test_an_event_is_looked_for_on_the_clock_of_the_curve() -> None:
    bench = located()
    at = np.array([20.0])
    known = Interval(9.9, 10.1)
    bench.clock_fit = ClockFit(10.0, 0.0, known, known, 0.0, at, at + 10.0, at * 0.0 + 0.1, "")
    assert bench.why_doubtful("force", (29.0, 31.0)) == (Reason("frozen", "stands"),)
    assert bench.why_doubtful("force", (41.0, 60.0)) == ()


def test_an_event_in_the_stretch_of_the_zero_touches_all() -> None:
    bench = located()
    bench.zeroed["force"] = (39.0, 41.0)
    assert bench.why_doubtful("force", (60.0, 70.0)) == (Reason("frozen", "stands"),)


def test_branches_by_cycle() -> None:
    up, down = Direction.LOADING, Direction.UNLOADING
    branches = (
        Branch(0, 2, 1, up, 0.0, 2.0),
        Branch(2, 4, 1, down, 2.0, 4.0),
        Branch(4, 6, 2, up, 4.0, 6.0),
    )
    zeros = np.zeros(6)
    curve = Curve(np.arange(6.0), zeros, zeros, np.zeros(6, int), np.ones(6, int), branches)
    bench = Bench(curve=curve)
    assert bench.cycles() == [list(branches[:2]), [branches[2]]]
    assert bench.within(branches[1]) == slice(2, 4)
    assert Bench().cycles() == []


def test_rms_leaves_nan_out() -> None:
    assert rms(np.array([3.0, np.nan, 4.0])) == pytest.approx(np.sqrt(12.5))
    assert np.isnan(rms(np.array([np.nan])))
