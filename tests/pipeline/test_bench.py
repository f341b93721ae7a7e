from __future__ import annotations

import numpy as np
import pytest

from labpipe.pipeline.bench import Bench, rms
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.quality import Severity


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
    assert bench.doubts == {"clock": "a: one"}
    assert bench.blocked == "c: three"
    severities = [note.severity for note in bench.notes]
    assert severities == [Severity.WARNING, Severity.WARNING, Severity.ERROR, Severity.ERROR]


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
