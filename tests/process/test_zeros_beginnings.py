"""Records whose first rows are missing: seen by what the first sample stands at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.result import Status
from tests.builders.plain_records import PlainRecord, up_and_down
from tests.builders.reduced import reduced

ASKED = """\
results:
  - {result: peak-force}
  - {result: peak-displacement}
  - {result: stiffness, from: 4 mm, to: 8 mm}
  - {result: energy}
"""
LINES = """\
steps:
  - {step: zero, channel: force, over: 0.4 s, by: line}
  - {step: zero, channel: displacement, over: 0.4 s, by: line}
"""


def late(share: float, noise: float = 1e-3, cycles: int = 2) -> PlainRecord:
    """Cycles whose first rows are missing, as a share of the first loading."""
    record = up_and_down(rest=0.0, noise=noise, cycles=cycles)
    return record.where(record.time >= 5.0 * share)


def doubtful(record: PlainRecord, more: str = ASKED) -> dict[str, str]:
    _, results = reduced(*record.arrays(), more=more)
    return {name: each.why for name, each in results.items() if each.status is not Status.OK}


@pytest.mark.parametrize("share", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_numbers_that_were_zeroed_under_load(share: float, noise: float) -> None:
    found = doubtful(late(share, noise), LINES + ASKED)
    assert {"peak_force.1", "peak_force.2", "peak_displacement.2", "stiffness"} < set(found)
    assert set(found) > {"energy.1", "energy.2"}
    assert all(why.startswith("begins_under_load: ") for why in found.values())
    assert " force and displacement zeroed there" in found["peak_force.1"]


@pytest.mark.parametrize("share", [0.05, 0.1, 0.2])
def test_only_the_work_before_is_missing_where_nothing_was_zeroed(share: float) -> None:
    found = doubtful(late(share))
    assert set(found) == {"energy.1"}
    assert found["energy.1"].startswith(
        "begins_under_load: the record begins under load and in motion: 0."
    )
    assert f" N, {1e2 * share:.0f} % of its range, at " in found["energy.1"].replace(".1 %", " %")


def test_only_the_displacement_was_zeroed() -> None:
    found = doubtful(late(0.1), LINES.replace("force, over", "displacement, over") + ASKED)
    assert {"peak_displacement.1", "peak_displacement.2", "stiffness", "energy.2"} <= set(found)
    assert not {"peak_force.1", "peak_force.2"} & set(found)


def test_slack_finds_the_zero_of_the_displacement() -> None:
    """A line through the linear region goes back to zero force, which was exported as such."""
    steps = "steps:\n  - {step: zero, channel: displacement, over: 0.4 s, by: line}\n"
    record = late(0.1, cycles=1, noise=1e-4).up_to(4.9)
    text = "curve: {force: force, displacement: displacement%s}\n"
    plain, with_slack = text % "", text % ", slack: {from: 30 %, to: 60 %}"
    _, results = reduced(*record.arrays(), more=steps + ASKED, replaced=(plain, with_slack))
    assert results["stiffness"].status is Status.OK
    assert results["stiffness"].value == pytest.approx(100.0, rel=0.01)


def test_what_begins_with_an_unloading() -> None:
    record = up_and_down(rest=0.0)
    found = doubtful(record.where(record.time >= 5.0))
    assert {"peak_force.1", "peak_displacement.1", "energy.1"} <= set(found)
    assert "begins under load, with an unloading" in found["peak_force.1"]


def offset(record: PlainRecord, force: float, path: float) -> PlainRecord:
    return replace(record, force=record.force + force, displacement=record.displacement + path)


def with_preload(record: PlainRecord) -> PlainRecord:
    """Cycles between a tenth of the load and all of it."""
    kept: Floats = 0.1 + 0.9 * record.force
    return replace(record, force=kept, displacement=1e-3 + 0.9 * record.displacement)


def test_what_does_not_begin_under_load() -> None:
    for record in (
        up_and_down(),  # at rest
        up_and_down(rest=0.0),
        offset(up_and_down(rest=0.0), 0.05, 0.0),  # load cells have offsets,
        offset(up_and_down(rest=0.0), 0.05, 3e-3),
        offset(up_and_down(rest=0.0), 0.0, 0.7),  # and crossheads count from anywhere
        offset(up_and_down(), 0.4, 4e-3),
        with_preload(up_and_down(rest=0.0, cycles=3)),
        up_and_down(rest=0.0, noise=0.05),
    ):
        for steps in ("", LINES):
            assert not [
                why for why in doubtful(record, steps + ASKED).values() if "begins_under" in why
            ]


def test_an_offset_that_no_load_cell_has() -> None:
    """Nothing tells it from a specimen that was loaded already."""
    record = up_and_down(rest=0.0, cycles=1).up_to(4.9)
    found = doubtful(offset(record, 0.3, 0.7), LINES + ASKED)
    assert found["peak_force.1"].startswith("begins_under_load: ")
    assert " N, 31 % of its range, at 700 mm in the first sample" in found["peak_force.1"]
    _, results = reduced(*offset(up_and_down(rest=0.0), 0.3, 0.7).arrays(), more=LINES + ASKED)
    assert results["peak_force.1"].status is Status.OK  # it ends where it began


def test_blanks_and_few_samples() -> None:
    record = up_and_down(rest=0.0)
    record.force[:] = np.nan
    _, results = reduced(*replace(record, force=np.ones(len(record.time))).arrays(), more=ASKED)
    assert not [each for each in results.values() if "begins" in each.why]
