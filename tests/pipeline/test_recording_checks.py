"""What a careful person would see in a recording: seen, and doubted where it matters alone."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.pipeline.bench import Bench, Signal
from labpipe.pipeline.recording_checks import check_end
from labpipe.processing.strokes import find_strokes, split_branches
from labpipe.records.quality import Severity
from labpipe.records.result import Status
from tests.builders.plain_records import PlainRecord, up_and_down
from tests.builders.reduced import reduced

RESULTS = (
    "results:\n  - {result: peak-force}\n  - {result: peak-displacement}\n  - {result: energy}\n"
)


def doubtful(record: PlainRecord, more: str = RESULTS) -> dict[str, str]:
    """Reasons by name of the results that are not ok."""
    _, results = reduced(*record.arrays(), more=more)
    return {name: each.reason for name, each in results.items() if each.status is not Status.OK}


@pytest.mark.parametrize("rate", [10.0, 50.0, 120.0, 200.0])
@pytest.mark.parametrize("is_round", [False, True])
@pytest.mark.parametrize("noise", [1e-4, 1e-3, 5e-3])
def test_a_record_cut_while_unloading(rate: float, is_round: bool, noise: float) -> None:
    record = up_and_down(rate=rate, is_round=is_round, noise=noise).up_to(19.5)
    found = doubtful(record)
    assert set(found) == {"energy.2"}
    assert found["energy.2"].startswith("partial_cycle: the record ends at 19.")
    assert found["energy.2"].endswith(" s, while still unloading")


@pytest.mark.parametrize("rate", [10.0, 50.0, 120.0, 200.0])
@pytest.mark.parametrize("noise", [1e-4, 5e-3])
def test_a_record_cut_while_loading(rate: float, noise: float) -> None:
    found = doubtful(up_and_down(rate=rate, noise=noise).up_to(15.5))
    assert set(found) == {"peak_force.2", "peak_displacement.2", "energy.2"}
    assert found["peak_force.2"].endswith("while still loading")
    assert found["energy.2"] == "partial_cycle: the cycle has no unloading branch"


@pytest.mark.parametrize("rate", [10.0, 50.0, 200.0])
@pytest.mark.parametrize("end", [22.0, 22.5, 30.0])
@pytest.mark.parametrize("noise", [1e-4, 5e-3])
def test_a_record_that_ends_where_the_test_does(rate: float, end: float, noise: float) -> None:
    assert not doubtful(up_and_down(rate=rate, noise=noise).up_to(end))


def test_a_later_peak_ends_the_record() -> None:
    """The second loading came as far as the first."""
    assert set(doubtful(up_and_down().up_to(17.0))) == {"energy.2"}  # it has no unloading


def ended(record: PlainRecord, *codes: str, full: bool = False) -> float:
    """Where `check_end` finds the record cut."""
    time, displacement, force = record.arrays()
    motion = Signal(time, displacement, "m", "frame")
    bench = Bench(is_full_stroke=full)
    bench.signals["displacement"] = bench.raw["displacement"] = motion
    bench.raw["force"] = Signal(time, force, "N", "frame")
    for code in codes:
        bench.note(code, Severity.WARNING, "frame: file", "rows are missing")
    strokes = find_strokes(time, displacement, min_stroke=1e-3)
    check_end(bench, motion, split_branches(time, strokes))
    return bench.cut_at.get("force", np.inf)


@pytest.mark.parametrize("code", ["truncated", "rows_differ"])
def test_a_file_with_fewer_rows_than_it_promised(code: str) -> None:
    """It may have come back by chance: nobody knows what the lost rows held."""
    record = up_and_down()
    assert ended(record.up_to(21.96)) == np.inf
    assert ended(record.up_to(21.96), code) == pytest.approx(21.96)
    assert ended(record, code) == np.inf  # what is lost is rest


def test_a_stroke_that_the_rig_was_told_is_whole() -> None:
    record = up_and_down().up_to(6.8)
    assert ended(record) == pytest.approx(6.8)
    assert ended(record, full=True) == np.inf


def test_a_force_that_ends_before_the_motion() -> None:
    record = up_and_down()
    record.force[record.time > 15.5] = np.nan
    assert ended(record) == pytest.approx(15.5)
    found = doubtful(record)
    assert found["peak_force.2"].startswith("missing_samples: ")
    assert "partial_cycle: the record ends at 15.5" in found["peak_force.2"]
    assert set(found) == {"peak_force.2", "energy.2"}


def test_nothing_moved() -> None:
    bench = Bench()
    check_end(bench, Signal(np.arange(9.0), np.zeros(9), "m", "frame"), ())
    assert not bench.cut_at
